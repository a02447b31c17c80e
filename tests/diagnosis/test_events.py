"""Events, ringing, patches and lines of unlisted origin, and the bias of coarse rounding."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.signal import lfilter

from bayes_sensor.blind_check.simulator import Component, NoiseLaw, draw_case, make_campaign
from bayes_sensor.campaign import Campaign
from bayes_sensor.diagnosis import diagnose_gap
from bayes_sensor.diagnosis.closed_fraction import VISIBLE
from bayes_sensor.diagnosis.data.bin_covariance import rounding_bias
from bayes_sensor.diagnosis.data.bins import PHASES
from bayes_sensor.diagnosis.data.preparation import fit_base, prepare
from bayes_sensor.diagnosis.data.quiet_stretches import QuietSpans, Stretch, hides_the_noise
from bayes_sensor.diagnosis.effects import CATALOGUE
from bayes_sensor.diagnosis.evidence.form_mismatch import ELSEWHERE, leaves_explanation_alone
from bayes_sensor.diagnosis.probabilities import combine
from bayes_sensor.diagnosis.signals.events import look_for_events
from bayes_sensor.diagnosis.signals.level_changes import look_for_level_changes
from bayes_sensor.diagnosis.signals.lines import look_for_lines
from bayes_sensor.diagnosis.signals.local_misfit import (
    find_runs_of_bins,
    find_short_bumps,
    look_for_local_misfit,
)
from bayes_sensor.diagnosis.signals.ringing import look_for_ringing
from bayes_sensor.diagnosis.signals.signal import Finding, Place
from bayes_sensor.diagnosis.signals.tails import look_at_tails
from bayes_sensor.residuals.converter_step import lattice_step
from bayes_sensor.rig.layout import Layout
from tests.support.planted_effects import SIGNALS, design, diagnosed, measured, noise, theta

INTERVAL = 0.01


def stretches(rng, kind="white", n=2000):
    return [
        Stretch(k, level, noise(n, rng, kind), 30.0 * level) for k in range(4) for level in (0, 1)
    ]


@pytest.mark.parametrize("kind", ["white", "ar1", "slow", "resonance", "paced"])
def test_noise_of_any_spectrum_holds_no_event(kind):
    rng = np.random.default_rng(3)
    # how unlike spells of noise are shows only in many of them
    n = 4000 if kind == "paced" else 2000
    values = [
        look_for_events(design(), stretches(rng, kind, n)).log_bayes_factor for _ in range(12)
    ]
    assert max(values) < 2.0 and np.median(values) < -0.5


def test_records_whose_white_noise_differs_hold_no_event():
    # a converter's range is a record's own; a bump in one of them is one still
    rng = np.random.default_rng(6)
    quiet, loud = 0.2, 1.5

    def made(kind, n=500):
        some = stretches(rng, "ar1", n)
        for i, s in enumerate(some):
            white = (quiet if s.experiment in (0, 2) else loud) * 2.3  # of the slow part
            some[i] = replace(s, samples=s.samples + white * rng.standard_normal(len(s.samples)))
        if kind == "bump":
            t = np.arange(n) * INTERVAL
            added = 12.0 * ((t >= 2.0) & (t < 2.5))
            some[2] = replace(some[2], samples=some[2].samples + added)
        return look_for_events(design(), some)

    values = [made("none").log_bayes_factor for _ in range(10)]
    assert max(values) < 2.0 and np.median(values) < 0.0, values
    found = made("bump", 2000)
    assert found.log_bayes_factor > 3.0 and found.places[0].experiment == 1


@pytest.mark.parametrize("shape", ["bump", "jump"])
def test_one_event_in_one_stretch_is_found_where_it_is(shape):
    some = stretches(np.random.default_rng(4))
    t = np.arange(2000) * INTERVAL
    # 1.2 s long, twelve standard deviations of its mean
    size = 12.0 * np.sqrt(INTERVAL / 1.2)
    added = size * ((t >= 7.0) & (t < 8.2)) if shape == "bump" else 1.5 * size * (t > 12.0)
    spoilt = [*some[:5], replace(some[5], samples=some[5].samples + added), *some[6:]]
    before, after = (look_for_events(design(), x) for x in (some, spoilt))
    assert before.log_bayes_factor < 0.0 and after.log_bayes_factor > 5.0
    assert after.strength["event_experiment"] == some[5].experiment
    assert after.strength["event_s"] == pytest.approx(30.0 + (7.6 if shape == "bump" else 12.0),
                                                      abs=0.5)  # fmt: skip


def test_the_contaminated_floor_does_not_hide_events_that_are_everywhere():
    # in every plateau: the mean spectrum of the plateaus holds them, the median in time does not
    rng = np.random.default_rng(5)
    t = np.arange(2000) * INTERVAL
    made = []
    for s in stretches(rng):
        at = rng.uniform(4.0, 14.0)
        made.append(replace(s, samples=s.samples + 1.0 * s.level * ((t > at) & (t < at + 1.5))))
    assert look_for_events(design(), made).log_bayes_factor > 8.0


def ringing_case(rng, kind, amplitude, hertz=9.0, fades=0.5, early=0.1, sign=1.0, misfit=0.0):
    campaign = design()
    residuals, quiet = [], []
    for e in campaign:
        on, off = e.commanded_on + 0.8, e.commanded_off + 0.5
        r = noise(len(e.t), rng, kind)
        for at, up in ((on, 1.0), (off, sign)):
            since = np.maximum(e.t - at + early, 0.0)
            r = r + up * amplitude * np.exp(-since / fades) * np.sin(2 * np.pi * hertz * since)
            since = np.maximum(e.t - at, 0.0)
            r = r + misfit * up * since / 0.4 * np.exp(-since / 0.4)
        residuals.append(r)
        spans = ((0.0, on), (on + 6.0, off), (off + 6.0, float(e.t[-1])))
        quiet.append(QuietSpans((on, off), spans, np.full(len(e.t), float(np.std(r)))))
    return look_for_ringing(campaign, residuals, quiet)


@pytest.mark.parametrize("kind", ["white", "ar1", "slow", "resonance", "paced"])
def test_only_a_ringing_that_follows_the_switches_is_one(kind):
    rng = np.random.default_rng(6)
    values = [ringing_case(rng, kind, 0.0).log_bayes_factor for _ in range(12)]
    assert max(values) < 3.5 and np.median(values) < 0.0


def test_a_ringing_and_its_frequency_are_found():
    found = ringing_case(np.random.default_rng(7), "white", 1.4)
    assert found.log_bayes_factor > 10.0
    assert found.strength["ringing_Hz"] == pytest.approx(9.0, abs=0.5)


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_a_faint_ringing_is_found_by_its_phase(sign):
    # eight windows with d = 3.9 in each, as after a push on a bubbler's water: none stands out
    rng = np.random.default_rng(8)
    swing = {"hertz": 1.1, "fades": 3.0, "early": 0.0, "sign": sign}
    found = [ringing_case(rng, "white", 0.45, **swing) for _ in range(4)]
    assert np.median([f.log_bayes_factor for f in found]) > 8.0
    for f in found:
        assert f.strength["ringing_Hz"] == pytest.approx(1.1, abs=0.15)


@pytest.mark.parametrize("interval", [0.02, 0.06, 0.2])
def test_slow_records_are_looked_at_as_far_as_they_go(interval):
    campaign = design(interval=interval)
    rng = np.random.default_rng(10)
    residuals = [noise(len(e.t), rng, "white") for e in campaign]
    quiet = [
        QuietSpans((e.commanded_on, e.commanded_off), ((0.0, e.commanded_on),), np.ones(len(e.t)))
        for e in campaign
    ]
    assert look_for_ringing(campaign, residuals, quiet).log_bayes_factor < 2.0


def test_a_misfit_of_the_rise_is_no_ringing():
    rng = np.random.default_rng(9)
    values = [ringing_case(rng, "white", 0.0, misfit=3.0).log_bayes_factor for _ in range(6)]
    assert max(values) < 2.0


def prepared_of(campaign):
    from bayes_sensor.fit import fit_least_squares

    fit = fit_least_squares(campaign, seed=1, euler=False)
    return prepare(campaign, Layout.of(campaign).flat(fit.theta_hat))


def patches_of(prepared, base=None, tail=np.inf):
    base = base or fit_base(prepared.binned)
    return look_for_local_misfit(base, prepared.residuals_of(base), prepared.quiet, tail)


def breaks_of(prepared, base=None, tail=np.inf):
    return look_for_level_changes(base or fit_base(prepared.binned), tail)


@pytest.mark.slow
def test_a_block_lost_in_one_step_is_a_patch():
    campaign = measured({}, seed=8)
    kept = patches_of(prepared_of(campaign))
    first, *others = campaign.experiments
    # a quarter second is missing while the signal rises, and the clock does not know
    i = int(np.searchsorted(first.t, first.commanded_on + 1.9))
    values = np.concatenate([first.y[:i], first.y[i + 25 :], first.y[-25:]])
    spoilt = replace(campaign, experiments=(replace(first, y=values), *others))
    found = patches_of(prepared_of(spoilt))
    assert kept.log_bayes_factor < 0.0 and found.log_bayes_factor > 5.0
    assert found.strength["patch_experiment"] == 0.0
    gap = diagnose_gap(spoilt, bootstrap=0, separate=False, hidden=False)
    assert gap.verdict.kind == "unlisted" and "experiment 1" in gap.verdict.sentence


@pytest.mark.slow
def test_a_reading_that_stands_for_less_than_a_bin_is_a_patch():
    # while the relays of a meter settle its last reading stands, in every rise at a time of its own
    campaign = measured({}, seed=8, sigma=0.008, interval=0.001)
    assert patches_of(prepared_of(campaign)).log_bayes_factor < 0.0
    stood, begins = [], []
    for e, share in zip(campaign, (0.3, 0.45, 0.4, 0.35), strict=True):
        smooth = theta(campaign)["experiments"][e.name]
        level = smooth["y0_V"] + share * smooth["beta_V"]
        i = int(np.argmax(np.convolve(e.y, np.ones(50) / 50.0, "same") > level))
        y = e.y.copy()
        slope = (np.mean(y[i + 80 : i + 130]) - np.mean(y[i - 50 : i])) / 0.13
        y[i : i + 45] -= slope * np.arange(45) * e.interval
        stood.append(replace(e, y=y))
        begins.append(float(e.t[i]))
    prepared = prepared_of(replace(campaign, experiments=tuple(stood)))
    base = fit_base(prepared.binned)
    found = patches_of(prepared, base)
    assert found.log_bayes_factor > 10.0
    assert find_runs_of_bins(base, np.inf).log_bayes_factor < 2.0  # bins average it
    assert {p.experiment for p in found.places} >= {0, 1, 2, 3}
    near = [min(abs(p.time - begins[p.experiment] - 0.03) for p in found.places
                if p.experiment == k) for k in range(4)]  # fmt: skip
    assert max(near) < 0.1
    assert found.strength["patch_s"] in [p.time for p in found.places]
    gap = diagnose_gap(replace(campaign, experiments=tuple(stood)), bootstrap=0, separate=False)
    assert gap.verdict.kind == "unlisted" and "Single switches" in gap.verdict.sentence
    shares = {}
    for cell in gap.map.cells:
        shares[cell.phase] = shares.get(cell.phase, 0.0) + cell.share
    assert gap.map.shared_by == "findings" and shares["rise"] > 0.9


@pytest.mark.parametrize("kind", ["white", "ar1", "slow", "resonance", "paced", "gust"])
def test_noise_of_any_kind_holds_no_short_patch(kind):
    rng = np.random.default_rng(5)
    plan = measured({}, seed=8, sigma=1e-6)
    values = []
    for _ in range(5):
        made = []
        for e in plan:
            own = noise(len(e.t), rng, "white" if kind == "gust" else kind)
            if kind == "gust":  # somebody drills next door while the signal rises
                own *= np.where(np.abs(e.t - e.commanded_on - 1.5) < 1.0, 4.0, 1.0)
            made.append(replace(e, y=e.y + 0.01 * own / np.std(own)))
        prepared = prepared_of(replace(plan, experiments=tuple(made)))
        base = fit_base(prepared.binned)
        found = find_short_bumps(base, prepared.residuals_of(base), prepared.quiet, np.inf)
        values.append(found.log_bayes_factor)
    assert max(values) < 2.0 and np.median(values) < (0.5 if kind == "gust" else -0.5)


def test_shots_and_gusts_are_no_events():
    rng = np.random.default_rng(12)

    def shots(n):
        # one in thirty samples is ten times as large, and each lasts a tenth of a second
        pulses = rng.standard_normal(n) * np.where(rng.random(n) < 1.0 / 30.0, 10.0, 1.0)
        return lfilter([1.0], [1.0, -0.9], pulses)

    made = [Stretch(k, level, shots(4000), 0.0) for k in range(4) for level in (0, 1)]
    plain = look_for_events(design(), made)
    assert look_for_events(design(), made, heavy_tailed=True).log_bayes_factor < 2.0
    assert plain.log_bayes_factor < 8.0  # the tails' length alone takes most of it


def levels(rng, n, least=5.0, tail=1.4):
    """(n,) samples of levels, of which the share (length/``least``)^-``tail`` lasts longer."""
    lengths = np.ceil(least * rng.random(n) ** (-1.0 / tail)).astype(int)
    return np.repeat(rng.standard_normal(n), lengths)[:n]


def test_means_have_long_tails_where_levels_last_very_differently():
    rng = np.random.default_rng(17)

    def tails(*loudness):
        return look_for_events(design(), [
            replace(s, samples=s.samples + loudness[s.level] * levels(rng, len(s.samples)))
            for s in stretches(rng, n=12_000)
        ]).tails  # fmt: skip

    for kind in ("white", "ar1", "slow", "resonance"):
        assert look_for_events(design(), stretches(rng, kind, 6000)).lasting == np.inf
    everywhere, plateaus = tails(1.0, 1.0), tails(0.0, 1.0)
    assert max(everywhere) < 6.0
    assert plateaus[0] == np.inf and plateaus[1] < 6.0  # something is wrong with the gas


@pytest.mark.slow
def test_levels_that_last_are_no_breaks_no_patches_and_not_unsteady():
    # a laser of many modes: white noise, of which a tenth keeps its level for power-law times
    hopping = Component(0.144, 0.1653, shape="settling", depth=0.75)
    law = NoiseLaw("mode_hopping", 0.02755, 0.02721, (Component(0.856), hopping))
    campaign = make_campaign(replace(draw_case(7020161), noise=law))
    prepared = prepared_of(campaign)
    base = fit_base(prepared.binned)
    events = look_for_events(campaign, prepared.stretches)
    assert events.log_bayes_factor < 0.0 and events.lasting < 3.0
    for look in (breaks_of, patches_of):
        as_if_gaussian, as_it_is = look(prepared, base), look(prepared, base, events.lasting)
        assert as_if_gaussian.log_bayes_factor > 4.0
        assert as_it_is.log_bayes_factor < 0.0
        if look is breaks_of:
            assert as_it_is.d == as_if_gaussian.d
    found = diagnose_gap(campaign, bootstrap=0, separate=False, hidden=False)
    assert found.verdict.kind == "none"
    assert "unsteady" not in [f.name for f in found.findings]


@pytest.mark.parametrize("n", [250, 400, 800])
def test_the_ends_of_short_stretches_are_no_tails(n):
    # the local size of the innovations must not rest on the one sample at the end
    rng = np.random.default_rng(13)
    values = []
    for _ in range(60):
        made = [Stretch(k, 0, noise(n, rng, "ar1"), 0.0) for k in range(3)]
        values.append(look_at_tails(made).log_bayes_factor)
    assert max(values) < 2.0


def test_a_level_that_changes_in_one_record_is_found_when_it_does():
    campaign = measured({}, seed=8)
    base = fit_base(prepared_of(campaign).binned)
    kept = look_for_level_changes(base)
    assert kept.log_bayes_factor < 0.0
    third = campaign.experiments[2]
    at = 0.5 * (third.commanded_on + third.commanded_off)
    # from the middle of the plateau to the fall, as after a setting that was corrected
    jump = 0.012 * ((third.t > at) & (third.t < third.commanded_off))
    experiments = list(campaign.experiments)
    experiments[2] = replace(third, y=third.y + jump)
    found = look_for_level_changes(
        fit_base(prepared_of(replace(campaign, experiments=tuple(experiments))).binned)
    )
    assert found.log_bayes_factor > 6.0 and found.strength["break_experiment"] == 2.0
    assert found.strength["break_s"] == pytest.approx(at, abs=2.5)


@pytest.mark.parametrize("look", [breaks_of, patches_of])
def test_what_strikes_again_alike_counts_together(look):
    # the same small offsets after the falls, for the same time in all records or for its own
    campaign = measured({}, seed=8)

    def spoilt(begins):
        struck = [
            replace(e, y=e.y + 0.013 * (np.abs(e.t - e.commanded_off - at) < 0.45))
            for e, at in zip(campaign, begins, strict=True)
        ]
        changed = replace(campaign, experiments=tuple(struck))
        return look(prepared_of(changed)).log_bayes_factor

    alike, apart = spoilt([5.0, 5.0, 5.0, 5.0]), spoilt([2.7, 4.1, 5.0, 6.2])
    assert alike > apart + 2.0 and alike > 4.0, (alike, apart)


@pytest.mark.slow
def test_scores_of_changes_have_unit_variance_where_nothing_changes():
    # the refit's own freedom is left out: over noises the squares average to one
    from bayes_sensor.diagnosis.signals.level_changes import level_changes

    squares = []
    for seed in range(6):
        found = fit_base(prepared_of(measured({}, seed=20 + seed)).binned)
        binned = found.coords.binned
        normal = found.jacobian.T @ found.jacobian + found.coords.own_prior_matrix
        covariance = np.linalg.inv(normal)
        for k, (rows, b) in enumerate(zip(binned.rows, binned.bins, strict=True)):
            templates = binned.inverse_factors[k] @ level_changes(b.falling)[0]
            columns = found.coords.columns(k)
            inside = found.jacobian[rows, columns].T @ templates
            left = np.sum(templates**2, axis=0) - np.sum(
                inside * (covariance[np.ix_(columns, columns)] @ inside), axis=0
            )
            use = left > 0.1 * np.sum(templates**2, axis=0)
            squares.append(np.mean((found.residual[rows] @ templates[:, use]) ** 2 / left[use]))
    assert np.mean(squares) == pytest.approx(1.0, abs=0.2)


def test_a_line_on_the_plateaus_alone_is_found():
    campaign = measured({}, seed=9)
    experiments = []
    for e in campaign:
        on = (e.t > e.commanded_on + 3.0) & (e.t < e.commanded_off)
        pump = 0.0035 * np.sin(2.0 * np.pi * 1.7 * e.t + float(e.name)) * on
        experiments.append(replace(e, y=e.y + pump))
    for name, these in (("quiet", campaign.experiments), ("pumped", tuple(experiments))):
        p = prepared_of(replace(campaign, experiments=these))
        line = look_for_lines(p.binned.campaign, p.stretches)[0]
        if name == "quiet":
            assert line.log_bayes_factor < 1.0
        else:
            assert line.log_bayes_factor > 5.0
            assert line.strength["line_Hz"] == pytest.approx(1.7, abs=0.05)


@pytest.mark.slow
def test_the_mains_are_a_line_where_they_have_no_name():
    campaign = measured({"mains_pickup": 0.004}, seed=10, interval=0.004)
    named = diagnose_gap(campaign, bootstrap=0, separate=False, hidden=False)
    assert named.verdict.effects == ("mains_pickup",)
    other = diagnose_gap(
        campaign, bootstrap=0, separate=False, hidden=False, without=["mains_pickup"]
    )
    assert other.verdict.kind == "unlisted" and "line of unlisted origin" in other.verdict.sentence


def humming(effects: dict[str, float | None], hertz: float, volts: float) -> Campaign:
    """A measured campaign with a line that runs on through all records."""
    campaign = measured(effects, seed=3)
    experiments = tuple(
        replace(e, y=e.y + volts * np.sin(2.0 * np.pi * hertz * e.t + float(e.name)))
        for e in campaign
    )
    return replace(campaign, experiments=experiments)


@pytest.mark.slow
def test_a_line_stands_beside_an_effect_on_the_mean_and_is_unlisted_by_itself():
    alone = diagnose_gap(humming({}, 17.3, 0.004), bootstrap=0, separate=False, hidden=False)
    assert alone.verdict.kind == "unlisted" and "line of unlisted origin" in alone.verdict.sentence
    # a line tells it, not the mean; it may be the noise of the place, as the map says
    line = next(f for f in alone.findings if f.name == "line")
    assert alone.verdict.probability == pytest.approx(line.probability, abs=0.05)
    assert alone.budget["p_value"] < 0.2
    quiet, hum = (
        diagnose_gap(humming({"flow_error": 1.15}, 17.3, volts), bootstrap=0, separate=False,
                     hidden=False)
        for volts in (0.0, 0.004)
    )  # fmt: skip
    assert quiet.verdict.effects == hum.verdict.effects == ("flow_error",)
    assert hum.probabilities.unlisted == pytest.approx(quiet.probabilities.unlisted, abs=0.02)
    assert "17.3" in hum.verdict.sentence and "Hz" not in quiet.verdict.sentence
    # tau is that of the effect, as without the hum
    assert hum.shrink.tau_after_s == pytest.approx(quiet.shrink.tau_after_s, rel=0.05)


@pytest.mark.slow
def test_a_line_that_moves_the_bins_is_a_rival_of_the_effects():
    line = Finding(SIGNALS["line"], 20.0, {"line_V": 0.004, "line_Hz": 17.3}, 10.0)
    assert line.beside_the_mean
    assert not replace(line, strength={"line_V": 0.004, "line_Hz": 0.6}).beside_the_mean
    assert not replace(line, signal=SIGNALS["swing"], strength={"swing_Hz": 17.3}).beside_the_mean
    comparison = diagnosed("flow_error").comparison
    fast = combine(comparison, [line], CATALOGUE)
    slow = combine(comparison, [replace(line, strength={"line_Hz": 0.6})], CATALOGUE)
    assert fast.unlisted < 0.3
    likely = replace(line, strength={"line_Hz": 0.6}).probability
    assert slow.unlisted == pytest.approx(likely + (1.0 - likely) * fast.unlisted, abs=0.02)
    assert sum(fast.rows.values()) == pytest.approx(sum(slow.rows.values())) == pytest.approx(1.0)


def bumped(effects: dict[str, float | None], volts: float = 0.06) -> Campaign:
    """A measured campaign with a bump on the plateau of its second record."""
    campaign = measured(effects, seed=3)
    experiments = list(campaign)
    e = experiments[1]
    middle = 0.5 * (e.commanded_on + e.commanded_off) + 4.0
    experiments[1] = replace(e, y=e.y + volts * np.exp(-0.5 * ((e.t - middle) / 0.3) ** 2))
    return replace(campaign, experiments=tuple(experiments))


@pytest.mark.slow
def test_an_event_stands_beside_an_effect_that_shows_elsewhere_and_is_unlisted_by_itself():
    # a clear one; a smaller one is a note
    alone = diagnose_gap(bumped({}, 0.12), bootstrap=0, separate=False, hidden=False)
    assert alone.verdict.kind == "unlisted" and "something happens once" in alone.verdict.sentence
    both = diagnose_gap(bumped({"flow_error": 1.15}), bootstrap=0, separate=False, hidden=False)
    assert both.verdict.effects == ("flow_error",) and both.probabilities.unlisted < 0.3
    assert any("In experiment 2 something happens once" in said for said in both.notes)
    # tau is that of the effect: without it the fit has lost it
    tau = 0.06
    assert both.shrink.tau_after_low_s < tau < both.shrink.tau_after_high_s
    assert abs(np.log(both.shrink.tau_after_s / tau)) < 0.2
    assert abs(np.log(both.shrink.tau_before_s / tau)) > 0.4


def test_an_effect_that_lives_by_an_event_does_not_stand_beside_it():
    comparison = diagnosed("flow_error").comparison
    base, binned = comparison.base, comparison.binned
    fitted = comparison.find("flow_error").refit
    gain = base.residual**2 - fitted.residual**2
    plateaus = np.concatenate([b.phase == PHASES.index("plateau") for b in binned.bins])
    event = Finding(SIGNALS["event"], 20.0, {}, 5.0, (Place(1, 20.0, 30.0),))
    steady = Finding(SIGNALS["unsteady"], 20.0, {"unsteady_Hz": 0.2}, None)
    assert gain[~plateaus].sum() > max(VISIBLE**2, ELSEWHERE * gain.sum())
    assert leaves_explanation_alone(event, fitted, base) and leaves_explanation_alone(
        steady, fitted, base
    )
    # nothing explains nothing beside it, and what acts on the mean itself is a rival
    assert not leaves_explanation_alone(event, base, base)
    assert not leaves_explanation_alone(replace(event, places=()), fitted, base)
    for name in ("patch", "break", "ringing", "swing"):
        assert not leaves_explanation_alone(replace(event, signal=SIGNALS[name]), fitted, base)
    # the same gain, where the event is
    at = np.flatnonzero(binned.bins[1].phase == PHASES.index("plateau")) + binned.rows[1].start
    moved = base.residual.copy()
    moved[at[0]] = 0.0
    was = base.residual.copy()
    was[at[0]] = np.sqrt(gain.sum())
    assert not leaves_explanation_alone(
        event, replace(fitted, residual=moved), replace(base, residual=was)
    )
    unstruck = replace(event, places=(Place(2, 20.0, 30.0),))
    assert leaves_explanation_alone(
        unstruck, replace(fitted, residual=moved), replace(base, residual=was)
    )


def test_rounding_biases_bins_as_the_covariance_says():
    plan = design(1)
    values = theta(plan, sigma=0.012)
    from bayes_sensor.likelihood.density import simulate

    step = 0.05  # four standard deviations: the noise hardly crosses it
    campaign = simulate(plan, values, seed=1)
    smooth = simulate(plan, {**values, "sigma0_V": 0.0, "sigma1_V": 0.0}, seed=1)
    (e,), (mean,) = campaign.experiments, [x.values for x in smooth.experiments]
    e = replace(e, y=np.round(e.values / step) * step)
    assert lattice_step(e.values) == pytest.approx(step)
    p = prepared_of(replace(campaign, experiments=(e,)))
    (b,), edges = p.binned.bins, p.binned.floor.edges
    flat = np.full((2, len(edges) - 1), 2.0 * INTERVAL * (0.012**2 + step**2 / 12.0))
    factor = rounding_bias(e, b, edges, flat, mean)
    assert factor is not None
    # an independent route: round many noisy copies of the true mean, at any offset of the lattice
    rng = np.random.default_rng(2)
    bias = []
    for _ in range(300):
        offset = step * rng.random()
        noisy = mean + 0.012 * rng.standard_normal(len(mean))
        bias.append(b.average(np.round((noisy + offset) / step) * step - offset - noisy))
    said = np.sqrt(np.sum(factor**2, axis=1))
    seen = np.sqrt(np.mean(np.square(bias), axis=0))
    long = b.count > 100  # elsewhere the rounding of single samples adds its own
    assert np.median(np.abs(said[long] / seen[long] - 1.0)) < 0.1
    fine = replace(e, y=np.round(campaign.experiments[0].values / 0.002) * 0.002)
    assert rounding_bias(fine, b, edges, flat, mean) is None


@pytest.mark.slow
def test_on_a_lattice_that_the_noise_hardly_crosses_only_the_steps_are_judged():
    campaign = measured({}, seed=11)
    coarse = replace(
        campaign,
        experiments=tuple(replace(e, y=np.round(e.values / 0.03) * 0.03) for e in campaign),
    )
    p = prepared_of(coarse)
    assert hides_the_noise(p.stretches, 0.03)
    assert not hides_the_noise(prepared_of(campaign).stretches, 0.002)
    gap = diagnose_gap(coarse, bootstrap=0, separate=False, hidden=False)
    assert {f.name for f in gap.findings} == {"heavy_tails", "quantisation"}
    assert gap.verdict.kind == "effect" and gap.verdict.effects == ("quantisation",)
    assert set(gap.verdict.effects) <= set(CATALOGUE)
