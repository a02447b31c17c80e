"""Bins and the noise floor: bin means, their covariance, the whitened residual of pure noise."""

import re
from dataclasses import replace

import numpy as np
import pytest
from scipy.linalg import toeplitz
from scipy.signal import lfilter

from bayes_sensor.blind_check.simulator import Component, NoiseLaw, draw_case, make_campaign
from bayes_sensor.campaign import Campaign, CampaignError, Experiment
from bayes_sensor.diagnosis import diagnose_gap
from bayes_sensor.diagnosis.data import noise_floor
from bayes_sensor.diagnosis.data.bin_covariance import bin_cholesky
from bayes_sensor.diagnosis.data.bins import PHASES, make_bins
from bayes_sensor.diagnosis.data.loudness import loudness
from bayes_sensor.diagnosis.data.noise_memory import ROOT, check_memory, common_correlation
from bayes_sensor.diagnosis.data.preparation import fit_base, full_rate_residuals, prepare
from bayes_sensor.diagnosis.data.quiet_stretches import clean, detrended, quiet_stretches
from bayes_sensor.diagnosis.signals.level_changes import look_for_level_changes
from bayes_sensor.fit import fit_least_squares
from bayes_sensor.likelihood.density import simulate
from bayes_sensor.rig.cascade import cascade_response
from bayes_sensor.rig.layout import Layout
from tests.support.planted_effects import design, theta

TAUS = np.array([0.8577, 0.7, 0.06])


def bins_of(campaign):
    switches = [(e.commanded_on + 0.8, e.commanded_off + 0.5) for e in campaign]
    return make_bins(campaign, switches, [TAUS] * len(campaign), 0.8577), switches


def test_bins_cover_every_sample_once_and_average_exactly():
    campaign = design(1)
    (b,), ((t0, tf),) = bins_of(campaign)
    e = campaign.experiments[0]
    assert b.first[0] == 0 and b.last[-1] == len(e.t)
    assert np.all(b.first[1:] == b.last[:-1])
    x = cascade_response(e.t, TAUS, t0, tf)
    by_nodes = b.reduce(cascade_response(b.times, TAUS, t0, tf))
    assert np.max(np.abs(by_nodes - b.average(x))) < 2e-5
    names = [PHASES[p] for p in b.phase]
    assert [p for p in PHASES if p in names] == list(PHASES)
    assert np.all(np.diff(b.phase) >= 0)


def test_a_short_time_scale_does_not_cut_records_into_thousands_of_bins():
    campaign = design(1)
    e = campaign.experiments[0]
    switches = [(e.commanded_on + 0.8, e.commanded_off + 0.5)]
    for scale in (1e-1, 1e-2, 1e-3):
        (b,) = make_bins(campaign, switches, [TAUS * scale], scale)
        assert b.first[0] == 0 and b.last[-1] == len(e.t)
        assert np.all(b.first[1:] == b.last[:-1])
        longest = float(np.max(b.last - b.first)) * e.interval
        # drifts stay visible, and the finest bins are as fine as samples are
        assert len(b.first) < 250 and longest < 1.05 * max(
            17.0 * scale, len(e.t) * e.interval / 100
        )
        assert np.min(b.last - b.first) * e.interval < max(0.07 * scale, 2.0 * e.interval)


def test_bins_respect_masks():
    from dataclasses import replace

    campaign = design(1)
    e = campaign.experiments[0]
    used = ~((e.t > 13.0) & (e.t < 14.05))
    campaign = replace(campaign, experiments=(replace(e, mask=used),))
    (b,), _ = bins_of(campaign)
    inside = np.concatenate([np.arange(i, j) for i, j in zip(b.first, b.last, strict=True)])
    assert np.array_equal(inside, np.flatnonzero(used))


def test_restricted_bins_keep_their_means():
    campaign = design(1)
    (b,), (s,) = bins_of(campaign)
    keep = np.arange(len(b.first)) % 3 != 0
    values = cascade_response(b.times, TAUS, *s)
    fewer = b.restricted(keep)
    assert np.allclose(
        fewer.reduce(cascade_response(fewer.times, TAUS, *s)), b.reduce(values)[keep]
    )


@pytest.mark.parametrize("phi", [0.0, 0.5, 0.95])
def test_covariance_of_bin_means_is_that_of_the_process(phi):
    campaign = design(1)
    (b,), _ = bins_of(campaign)
    e = campaign.experiments[0]
    h = e.interval
    # the process's own spectrum in narrow bands; its covariance from the definition
    edges = 0.5 / h / 1.15 ** np.arange(70, -1, -1)
    f = np.sqrt(edges[:-1] * edges[1:])
    spectrum = 2.0 * h * (1 - phi**2) / (1 + phi**2 - 2 * phi * np.cos(2 * np.pi * f * h))
    factor = bin_cholesky(
        e, b, edges, np.array([spectrum, spectrum]), np.zeros(len(b.first)), np.ones_like
    )
    covariance = toeplitz(phi ** np.arange(len(e.t)))
    total = np.zeros((len(e.t) + 1, len(e.t) + 1))
    total[1:, 1:] = np.cumsum(np.cumsum(covariance, axis=0), axis=1)
    exact = (
        total[np.ix_(b.last, b.last)] - total[np.ix_(b.first, b.last)]
        - total[np.ix_(b.last, b.first)] + total[np.ix_(b.first, b.first)]
    ) / np.outer(b.count, b.count)  # fmt: skip
    made = factor @ factor.T
    sd = np.sqrt(np.diag(exact))
    assert np.max(np.abs(made - exact) / np.outer(sd, sd)) < 0.04


@pytest.mark.parametrize("kind", ["ar1", "slow"])
def test_pure_noise_whitens_to_one(kind):
    plan = design(4)
    parameters = theta(plan, sigma=0.03, phi=0.6)
    ratios = []
    for seed in range(6):
        campaign = simulate(plan, parameters, seed=seed)
        if kind == "slow":
            rng = np.random.default_rng(seed)
            values = {}
            for e in campaign:
                decay = np.exp(-e.interval)
                slow = lfilter([1], [1, -decay], rng.standard_normal(len(e.t) + 2000))[2000:]
                values[e.name] = e.values + 0.004 * np.sqrt(1 - decay**2) * slow
            campaign = campaign.with_data(values)
        binned = prepare(campaign, Layout.of(plan).flat(parameters)).binned
        fitted = fit_base(binned)
        ratios.append(fitted.misfit / (binned.n_bins - fitted.coords.size))
    # each has a spread of about .1 from the floor's own uncertainty
    assert np.mean(ratios) == pytest.approx(1.0, abs=0.15)
    assert max(ratios) < 1.45


@pytest.mark.parametrize("phi", [0.0, 0.9])
@pytest.mark.parametrize("interval", [1e-3, 1e-2])
def test_noise_counts_less_where_it_is_louder_for_a_while(interval, phi):
    campaign = design(6, interval=interval)
    rng = np.random.default_rng(5)
    bins, switches = bins_of(campaign)
    alarms = 0
    for e, b, (t0, tf) in zip(campaign, bins, switches, strict=True):
        n = len(e.t)
        x = lfilter([1.0], [1.0, -phi], rng.standard_normal(n + 500))[500:]
        on = (e.t > t0) & (e.t < tf)
        x *= np.where(on, 1.5, 1.0)  # gas makes it louder, which is no spell of noise
        level = b.average(on.astype(float))
        alarms += np.any(loudness(e, x, b, level) > 1.0)
        middle = 0.5 * (t0 + tf)
        loud = np.abs(e.t - middle) < 3.0
        found = loudness(e, x * np.where(loud, 3.0, 1.0), b, level)
        inside = loud[b.first] & loud[b.last - 1]
        away = np.abs(b.centre - middle) > 6.0
        expected = 3.0 / np.sqrt(np.mean(np.where(loud, 9.0, 1.0)[on]))
        assert np.mean(found[away] > 1.0) < 0.1 and np.max(found[away]) < 1.2
        assert np.median(found[inside]) == pytest.approx(expected, rel=0.1)
    assert alarms <= 1


@pytest.mark.slow
def test_a_drill_next_door_breaks_nothing_and_is_told(monkeypatch):
    drilled = Component(1.0, 6e-4, shape="drilled", rate=0.24, depth=0.82)
    law = NoiseLaw("drilling", 0.0916, 0.0717, (drilled,))
    campaign = make_campaign(replace(draw_case(7088915), noise=law))
    gap = diagnose_gap(campaign, bootstrap=0, separate=False, hidden=False)
    assert gap.verdict.kind == "none"
    (told,) = (note for note in gap.notes if "louder for a while" in note)
    assert " times)" in told and "counts less" in told
    spans = re.findall(r"from (\d+) to (\d+) s", told)
    assert spans and all(int(begin) < int(end) for begin, end in spans)
    parameters = Layout.of(campaign).flat(fit_least_squares(campaign, euler=False).theta_hat)

    def found():
        base = fit_base(prepare(campaign, parameters).binned)
        return look_for_level_changes(
            base
        ).log_bayes_factor, base.misfit / base.coords.binned.n_bins

    counted, ratio = found()
    assert counted < 1.0 and ratio < 1.2
    monkeypatch.setattr(noise_floor, "loudness", lambda _e, _r, _b, level: np.ones(len(level)))
    as_usual, ratio = found()
    assert as_usual > 20.0 and ratio > 1.3


def test_glitches_are_replaced_and_counted():
    rng = np.random.default_rng(1)
    r = rng.standard_normal(5000)
    r[[100, 2000, 2001]] += 30.0
    cleaned, n = clean(r, np.ones(5000, dtype=bool))
    assert n == 3
    assert np.max(np.abs(cleaned)) < 6.0
    assert clean(r * 0.0, np.ones(5000, dtype=bool))[1] == 0


def test_noise_that_is_louder_for_a_while_holds_no_glitches_but_its_own():
    rng = np.random.default_rng(2)
    r = rng.standard_normal(10_000)
    r[4000:6000] *= 6.0
    r[[1000, 5000]] += 60.0
    cleaned, n = clean(r, np.ones(10_000, dtype=bool))
    assert n == 2
    assert np.array_equal(np.flatnonzero(cleaned != r), [1000, 5000])


def test_samples_a_converter_step_away_are_no_spikes():
    # noise of a third of a step around a lattice point: nine of ten samples are equal
    rng = np.random.default_rng(1)
    values = np.round(0.35 * rng.standard_normal(5000))
    residual = values - 1e-3 * np.sin(np.arange(5000) / 300.0)
    used = np.ones(5000, dtype=bool)
    assert np.mean(values == 0.0) > 0.8
    assert clean(residual, used)[1] > 100  # without the step they would be
    cleaned, n = clean(residual, used, resolution=1.0)
    assert n == 0 and np.array_equal(cleaned, residual)
    residual[700] += 9.0
    assert clean(residual, used, resolution=1.0)[1] == 1


def test_detrending_removes_a_parabola_exactly():
    x = np.linspace(-1, 1, 300)
    assert np.max(np.abs(detrended(3.0 + 2.0 * x - 5.0 * x**2))) < 1e-10


def test_a_record_without_a_quiet_stretch_is_refused():
    from dataclasses import replace

    plan = design(1)
    campaign = simulate(plan, theta(plan), seed=1)
    e = campaign.experiments[0]
    near = (np.abs(e.t - 12.5) < 0.6) | (np.abs(e.t - 35.2) < 0.6)
    campaign = replace(campaign, experiments=(replace(e, mask=near),))
    with pytest.raises(CampaignError, match="record longer"):
        prepare(campaign, Layout.of(plan).flat(theta(plan)))


def short_record(seed):
    """One record of 16 s at 20 ms: a short baseline is quiet, the plateau never."""
    t = np.arange(800) * 0.02
    plan = Campaign("short", (Experiment("1", t, None, 66.7, 8.33, 0.02, 3.1, 11.04),))
    parameters = {
        "tau_s": 0.048, "tau_v_s": 0.858, "V_mL": 58.2, "phi": 0.85, "sigma0_V": 0.045,
        "sigma1_V": 0.072,
        "experiments": {"1": {"y0_V": 0.3, "beta_V": 1.78, "t0_s": 4.54, "tf_s": 12.07}},
    }  # fmt: skip
    return simulate(plan, parameters, seed=seed), Layout.of(plan).flat(parameters)


def test_the_floor_of_a_record_that_is_never_quiet_on_its_plateau():
    ratios = []
    for seed in range(8):
        campaign, flat = short_record(seed)
        noise_floor = prepare(campaign, flat).binned.floor
        f = np.sqrt(noise_floor.edges[:-1] * noise_floor.edges[1:])
        # one-sided density of an AR(1)
        shape = 2.0 * 0.02 * (1 - 0.85**2) / (1 + 0.85**2 - 1.7 * np.cos(2 * np.pi * f * 0.02))
        known = np.outer([0.045**2, 0.045**2 + 0.072**2], shape)
        ratios.append(np.log(noise_floor.density[0] / known))
    typical = np.exp(np.median(ratios, axis=0))
    # taking out the trend takes some of the slowest noise with it
    assert np.all(typical > 0.35) and np.all(typical < 1.6)


@pytest.mark.parametrize("seed", range(4))
def test_a_short_record_with_nothing_wrong_raises_no_confident_alarm(seed):
    campaign, _ = short_record(seed)
    verdict = diagnose_gap(campaign, seed=1, bootstrap=0, separate=False).verdict
    assert verdict.kind == "none" or verdict.probability < 0.9


def test_noise_that_outlasts_the_quiet_stretches_is_refused():
    # a random walk in records of 60 s, with stretches of ten seconds and more
    campaign = design(2)
    rng = np.random.default_rng(4)
    values = theta(campaign, sigma=5e-4)
    ideal = simulate(campaign, Layout.of(campaign).flat(values), seed=1)
    for walk, refused in ((0.002, True), (0.0, False)):
        noisy = [replace(e, y=e.y + walk * np.cumsum(rng.standard_normal(len(e.t)))) for e in ideal]
        walking = replace(ideal, experiments=tuple(noisy))
        if refused:
            with pytest.raises(CampaignError, match="the noise wanders"):
                diagnose_gap(walking, bootstrap=0, hidden=False, separate=False)
        else:
            diagnose_gap(walking, bootstrap=0, hidden=False, separate=False)


@pytest.mark.parametrize("phi", [0.8, 0.9, 0.97])
def test_the_correlation_that_a_parabola_takes_is_put_back(phi):
    rng = np.random.default_rng(5)
    found = []
    for _ in range(200):
        noise = lfilter([1.0], [1.0, -phi], rng.standard_normal(700))[300:]
        found.append(detrended(noise))
    plain = np.mean([x[1:] @ x[:-1] / (x @ x) for x in found])
    assert plain < phi - 0.005
    assert common_correlation(found) == pytest.approx(phi, abs=0.006)


def test_a_smooth_misfit_is_not_taken_for_a_walk():
    # neighbours are nearly alike in it, too, but it goes on in one direction
    rng = np.random.default_rng(6)
    t = np.linspace(0.0, 1.0, 4000)
    waves = [np.sin(2.0 * np.pi * (5.0 * t + rng.random())) for _ in range(4)]
    smooth = [detrended(w + 1e-3 * rng.standard_normal(4000)) for w in waves]
    walks = [detrended(np.cumsum(rng.standard_normal(4000))) for _ in range(4)]
    for noises in (smooth, walks):
        assert np.mean([x[1:] @ x[:-1] / (x @ x) for x in noises]) > 0.99
    check_memory(smooth)
    with pytest.raises(CampaignError, match="the noise wanders"):
        check_memory(walks)


def test_a_strong_misfit_beside_slow_noise_is_not_taken_for_a_walk():
    # as a valve leaves it that shuts much faster than was thought; the noise is AR(1) of 0.8
    rng = np.random.default_rng(7)
    t = np.arange(320) * 0.01
    misfits, walks = [], []
    for _ in range(6):
        noise = lfilter([1.0], [1.0, -0.8], rng.standard_normal(420))[100:]
        misfits.append(detrended(noise + 10.0 * np.sin(2.0 * np.pi * (t / 2.2 + rng.random()))))
        walks.append(detrended(np.cumsum(rng.standard_normal(320))))
    for noises in (misfits, walks):
        phi = np.mean([x[1:] @ x[:-1] / (x @ x) for x in noises])
        assert 320 * (1.0 - phi) < ROOT
    check_memory(misfits)
    with pytest.raises(CampaignError, match="the noise wanders"):
        check_memory(walks)


def remembering(rng, memories, misfit=0.0, hertz=1.0):
    """Campaign and parameters; noise of one size, and of each record's own memory (s)."""
    plan = design(len(memories), interval=0.002)
    parameters = theta(plan, sigma=0.01, phi=0.0)
    exact = simulate(plan, theta(plan, sigma=1e-9, phi=0.0), seed=1)
    values = {}
    for e, memory in zip(exact, memories, strict=True):
        phi = np.exp(-e.interval / memory)
        drawn = rng.standard_normal(len(e.t) + 2000)
        noise = 0.01 * np.sqrt(1.0 - phi**2) * lfilter([1.0], [1.0, -phi], drawn)[2000:]
        if e.name == "1":
            noise += misfit * np.sin(2.0 * np.pi * hertz * e.t)
        values[e.name] = e.values + noise
    return plan.with_data(values), Layout.of(plan).flat(parameters)


MEMORIES = (0.02, 0.1, 0.02, 0.1)


def test_records_of_other_memories_whiten_to_one_each(monkeypatch):
    def spreads():
        rng = np.random.default_rng(41)
        found = []
        for _ in range(5):
            campaign, vector = remembering(rng, MEMORIES)
            base = fit_base(prepare(campaign, vector).binned)
            rows = base.coords.binned.rows
            found.append([np.mean(base.residual[own] ** 2) for own in rows])
        return np.mean(found, axis=0)

    assert spreads() == pytest.approx(np.full(4, 0.93), abs=0.25)  # less what the fit takes
    # one spectrum for all would make the slower ones look like a misfit
    monkeypatch.setattr(noise_floor, "own_memory", lambda campaign, *rest: np.ones(rest[-1].shape))
    alike = spreads()
    assert min(alike[1], alike[3]) > 1.7 * max(alike[0], alike[2])


def test_a_memory_is_told_by_what_is_quick():
    f = np.array([0.3, 30.0])
    rng = np.random.default_rng(42)

    def of(memories, misfit=0.0, hertz=1.0, counts=(1.0,) * 4):
        campaign, vector = remembering(rng, memories, misfit, hertz)
        residuals = full_rate_residuals(campaign, vector)
        bins, _ = bins_of(campaign)
        stretches = quiet_stretches(campaign, residuals, bins, [4.0] * len(campaign))
        noises = [detrended(s.samples) for s in stretches]
        ordinates = np.ones((len(campaign), 2, 2)) * np.array(counts)[:, None, None]
        return noise_floor.own_memory(campaign, stretches, noises, f, ordinates)[:, 0]

    own = of(MEMORIES)
    # at low frequencies the densities go as the memories, at high ones against them
    assert own[1] / own[0] == pytest.approx([5.0, 0.2], rel=0.15)
    assert own.mean(axis=0) == pytest.approx(1.0)
    # neither alike ones nor a slow misfit in one record, nor a line, make any difference
    for misfit, hertz in ((0.0, 1.0), (0.02, 1.0 / 9.0), (0.03, 25.0)):
        assert np.all(of((0.05,) * 4, misfit, hertz) == 1.0)
    # the common spectrum is mostly that of the longest record
    weighed = of(MEMORIES, counts=[1.0, 10.0, 1.0, 1.0])
    assert np.average(weighed, axis=0, weights=[1.0, 10.0, 1.0, 1.0]) == pytest.approx(1.0)
    assert weighed[1] / weighed[0] == pytest.approx([5.0, 0.2], rel=0.2)
