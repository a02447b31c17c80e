"""The diagnosis from end to end on small campaigns with a known effect."""

import json
from dataclasses import replace

import numpy as np
import pytest
from scipy.signal import lfilter

import bayes_sensor as bs
from bayes_sensor.campaign import CampaignError
from bayes_sensor.diagnosis import CATALOGUE, Gap, Strength, diagnose_gap, own_effect
from bayes_sensor.diagnosis.budget import ar1_whiteness
from bayes_sensor.diagnosis.data.bins import PHASES
from bayes_sensor.diagnosis.effects.effect_model import with_effects
from bayes_sensor.diagnosis.effects.simulate_effects import (
    default_strengths,
    simulate_with_effects,
)
from bayes_sensor.diagnosis.effects.user_effects import read_effects
from bayes_sensor.diagnosis.evidence.compared_hypotheses import LEFT
from bayes_sensor.diagnosis.evidence.form_mismatch import OTHER_FORM, simpler_explanation
from bayes_sensor.diagnosis.verdict import NAMED
from bayes_sensor.diagnosis.wording import WANDERS
from bayes_sensor.likelihood.density import simulate
from bayes_sensor.likelihood.noise import Noise
from bayes_sensor.likelihood.problem import Problem
from bayes_sensor.rig.cascade import Cascade, cascade_response
from tests.support.planted_effects import design, diagnosed, measured, theta

NAMES = (
    "flow_switching", "valve_asymmetry", "valve_second_order", "two_rate_valve", "finite_stroke",
    "dead_volume", "axial_dispersion", "flow_settling", "flow_error", "sensor_diffusion",
    "sorption_asymmetry", "slow_sorption", "optical_nonlinearity", "baseline_drift",
    "baseline_step", "gain_drift", "carry_over", "mains_pickup", "daq_filter", "heavy_tails",
    "quantisation",
)  # fmt: skip


def test_the_catalogue_is_the_contract():
    assert tuple(CATALOGUE) == NAMES
    for name, effect in CATALOGUE.items():
        assert effect.name == name
        assert effect.plausible and effect.null and effect.reference and effect.reveal


@pytest.mark.slow
@pytest.mark.parametrize("seed", [1, 2, 3])
def test_nothing_is_named_where_nothing_is_wrong(seed):
    gap = diagnosed("none", seed=seed)
    assert gap.verdict.kind == "none"
    assert gap.budget["p_value"] > 0.01
    assert gap.shrink.closure.withheld
    low, high = gap.hidden.tau_envelope_s
    assert low < 0.06 < high


# strengths at which these four short records show the effect well
@pytest.mark.slow
@pytest.mark.parametrize(
    ("effect", "strength"),
    [
        ("valve_asymmetry", 1.25),
        ("flow_switching", 1.0),
        ("dead_volume", 0.25),
        ("two_rate_valve", 0.06),
        ("finite_stroke", 2.0),
        ("flow_error", 1.15),
        ("optical_nonlinearity", 0.06),
        ("baseline_drift", 1.2e-3),
        ("baseline_step", 0.03),
        ("gain_drift", 1.2e-3),
        ("carry_over", 0.06),
        ("heavy_tails", 3.0),
        ("quantisation", 0.03),
    ],
)
def test_a_visible_effect_or_its_family_is_named(effect, strength):
    gap = diagnosed(effect, strength)
    row = gap.which.set_index("effect").loc[effect]
    family = CATALOGUE[effect].family
    assert gap.verdict.kind in ("effect", "family")
    assert {CATALOGUE[n].family for n in gap.verdict.effects} >= {family}
    assert gap.probabilities.families[family] > 0.8
    if gap.verdict.kind == "effect":
        # an unlisted cause of the mean tells nothing of the noise
        told = 1.0 if CATALOGUE[effect].on_mean else 1.0 - gap.probabilities.unlisted
        assert min(gap.probabilities.effects[n] for n in gap.verdict.effects) > NAMED * told
    if CATALOGUE[effect].on_mean:
        assert gap.shrink.closure.fraction > 0.8
        assert gap.budget["p_value"] < 0.01
        assert row["d"] > 5
    assert gap.verdict.sentence[0].isupper() and gap.verdict.sentence.endswith(".")


@pytest.mark.slow
def test_fitted_strengths_are_the_true_ones():
    strength = diagnosed("valve_asymmetry", 1.25).which.set_index("effect").strength
    assert strength["valve_asymmetry"]["closing_ratio"] == pytest.approx(1.25, abs=0.03)
    strength = diagnosed("quantisation", 0.03).which.set_index("effect").strength["quantisation"]
    assert strength["adc_step"] == pytest.approx(0.03, rel=1e-6)


def test_the_mains_amplitude_is_estimated_also_where_they_are_folded():
    for interval in (0.004, 0.012):  # 250 Hz; 83 Hz, where 50 Hz appears at 33 Hz
        campaign = measured({"mains_pickup": 0.01}, seed=2, n=2, interval=interval)
        gap = diagnose_gap(campaign, bootstrap=0, hidden=False, separate=False)
        strength = gap.which.set_index("effect").strength["mains_pickup"]
        assert gap.verdict.effects == ("mains_pickup",)
        assert strength["mains_V"] == pytest.approx(0.01, rel=0.15)
        assert strength["mains_Hz"] == 50.0


@pytest.mark.slow
def test_an_unlisted_cause_is_not_given_a_name():
    campaign = measured({}, seed=4)
    values = {}
    for e in campaign:  # a valve that couples into the signal for a moment at both commands
        since = [e.t - e.commanded_on, e.t - e.commanded_off]
        pulse = sum(np.where(s > 0, np.exp(-np.maximum(s, 0) / 0.4), 0.0) for s in since)
        values[e.name] = e.values + 0.06 * pulse
    gap = diagnose_gap(campaign.with_data(values), bootstrap=0, separate=False)
    assert gap.verdict.kind == "unlisted"
    assert gap.verdict.effects == ()
    phases = gap.where.groupby("phase")["share"].sum()
    assert phases["onset"] + phases["fall"] + phases["rise"] > 0.8


def beside(extra):
    """A faultless campaign, and what ``extra(experiment, own parameters)`` (n_t,) V adds."""
    campaign = measured({}, seed=3)
    own = theta(campaign)["experiments"]
    return campaign.with_data({e.name: e.values + extra(e, own[e.name]) for e in campaign})


@pytest.mark.slow
@pytest.mark.parametrize(("seed", "share"), [(3, 0.0025), (6, 0.004)])
def test_gas_of_the_record_before_is_not_taken_for_the_baseline(seed, share):
    # hardly seen, it looks like a level that is higher before the pulse than after it; that the
    # records have as much of it as the one before them had gas tells
    campaign = measured({}, seed=seed)
    own, values, before = theta(campaign)["experiments"], {}, 0.0
    for e in campaign:
        since = e.t - e.t[0]
        left = 0.5 * np.exp(-since / 3.0) + 0.5 * np.exp(-since / 15.0)
        size = share * own[e.name]["beta_V"] * before / e.concentration
        values[e.name], before = e.values + size * left, e.concentration
    gap = diagnose_gap(
        campaign.with_data(values), bootstrap=0, hidden=False, separate=False, follow=False
    )
    assert gap.verdict.effects == ("carry_over",)
    assert (
        gap.probabilities.families["initial state"] > 3.0 * gap.probabilities.families["baseline"]
    )


@pytest.mark.slow
def test_a_part_that_comes_later_is_described():
    share, lateness = 0.1, 1.1  # s at the median flow: a way of a fixed volume
    plan = design()
    reference = np.median([e.total_flow for e in plan])

    def late(e, own):
        taus = [0.8577, 58.23 / e.total_flow, 0.06]
        delay = lateness * reference / e.total_flow
        shift = (
            cascade_response(e.t, taus, own["t0_s"] + d, own["tf_s"] + d) for d in (delay, 0.0)
        )
        return share * own["beta_V"] * (next(shift) - next(shift))

    gap = diagnose_gap(beside(late), seed=1, bootstrap=0, separate=False, hidden=False)
    assert gap.verdict.kind == "unlisted"
    assert "It acts as if a part of the response comes later" in gap.verdict.sentence
    likely = max(gap.comparison.hypotheses, key=lambda h: h.log_weight)
    assert (
        likely.within == "part later" and likely.refit.coords.parts[0].form.name == "by the stream"
    )
    strength = likely.refit.strength()
    assert strength["late_share"] == pytest.approx(share, rel=0.15)
    assert strength["lateness"] == pytest.approx(lateness, rel=0.1)
    assert likely.log_tau == pytest.approx(np.log(0.06), abs=3.0 * likely.sd_log_tau)


@pytest.mark.slow
def test_a_pulse_at_the_commands_is_described():
    def pulse(e, _own):
        on, off = (np.maximum(e.t - t, 0.0) for t in (e.commanded_on, e.commanded_off))
        made = 0.03 * (on > 0.0) * np.exp(-on / 0.25) - 0.02 * (off > 0.0) * np.exp(-off / 0.25)
        return made

    gap = diagnose_gap(beside(pulse), seed=1, bootstrap=0, separate=False, hidden=False)
    assert gap.verdict.kind == "unlisted"
    assert "It acts as if a pulse that fades follows the valve's commands" in gap.verdict.sentence
    likely = max(gap.comparison.hypotheses, key=lambda h: h.log_weight)
    strength = likely.refit.strength()
    assert strength["pulse_on"] == pytest.approx(0.03, rel=0.25)
    assert strength["pulse_off"] == pytest.approx(-0.02, rel=0.4)
    assert strength["pulse_time"] == pytest.approx(0.25, rel=0.5)


@pytest.mark.slow
def test_a_withheld_effect_is_never_named_with_confidence():
    campaign = measured({"valve_asymmetry": 1.25}, seed=1)
    gap = diagnose_gap(
        campaign, without=["valve_asymmetry"], bootstrap=0, hidden=False, separate=False
    )
    assert "valve_asymmetry" not in set(gap.which.effect)
    assert gap.verdict.kind == "unlisted" or (
        {CATALOGUE[n].family for n in gap.verdict.effects} == {"asymmetry"}
    )


@pytest.mark.slow
def test_two_effects_of_one_response_are_never_told_apart():
    # with the other taken out of the catalogue, too: it may be the cause all the same
    campaign = measured({"two_rate_valve": 0.08}, seed=3)
    gap = diagnose_gap(
        campaign, without=["two_rate_valve"], bootstrap=0, hidden=False, separate=False
    )
    assert gap.probabilities.effects["slow_sorption"] > 0.9
    assert gap.verdict.kind == "family" and gap.verdict.effects[0] == "slow_sorption"
    assert "two_rate_valve, whose response is the same" in gap.verdict.sentence


@pytest.mark.slow
@pytest.mark.parametrize("seconds", [4.0, 12.0])
def test_a_step_of_the_baseline_at_any_common_time_is_named(seconds):
    campaign = measured({}, seed=4)
    stepped = [
        replace(e, y=e.y + 0.02 * (e.t >= e.commanded_off + 0.5 + seconds)) for e in campaign
    ]
    gap = diagnose_gap(
        replace(campaign, experiments=tuple(stepped)), bootstrap=0, hidden=False, separate=False
    )
    assert gap.verdict.kind in ("effect", "family")
    assert gap.verdict.effects[0] == "baseline_step"
    assert gap.probabilities.effects["baseline_step"] > 0.7


@pytest.mark.slow
def test_two_effects_of_different_families_are_found():
    campaign = measured({"valve_asymmetry": 1.25, "baseline_drift": 4e-4}, seed=2)
    gap = diagnose_gap(campaign, bootstrap=0, hidden=False, separate=False)
    families = {CATALOGUE[n].family for n in gap.verdict.effects}
    assert families == {"asymmetry", "baseline"}
    assert "+" in gap.which.effect.iloc[0]
    assert gap.rounds[0].p_left > 0.01
    at_once = diagnose_gap(campaign, bootstrap=0, hidden=False, separate=False, follow=False)
    assert at_once.rounds == ()
    assert at_once.to_json() | {"rounds": gap.to_json()["rounds"]} == gap.to_json()


@pytest.mark.slow
def test_two_effects_of_one_family_are_not_taken_for_something_else():
    truth = {"flow_settling": 0.7, "optical_nonlinearity": 0.06}
    gap = diagnose_gap(measured(truth, seed=2), bootstrap=0, hidden=False, separate=False)
    assert gap.comparison.find(*truth).log_z > max(
        h.log_z for h in gap.comparison.hypotheses if h.incomplete or len(h.effects) < 2
    )
    assert gap.probabilities.unlisted < 0.1
    # both are likely, but the family is what is said: two members may be a third in another form
    assert min(gap.probabilities.effects[name] for name in truth) > NAMED
    assert gap.verdict.kind == "family" and gap.verdict.family == "asymmetry"
    assert set(gap.verdict.effects[:2]) == set(truth)
    assert " and ".join(truth) + " together explain the gap best" in gap.verdict.sentence
    assert gap.shrink.closure.fraction > 0.9


def beside_two_effects(size: float) -> Gap:
    """Of a campaign with two effects and a bump of ``size`` V that is none."""
    campaign = measured({"valve_asymmetry": 1.25, "baseline_drift": 4e-4}, seed=2)
    bump = {e.name: np.exp(-0.5 * ((e.t - e.commanded_on - 6.0) / 1.5) ** 2) for e in campaign}
    more = campaign.with_data({e.name: e.values + size * bump[e.name] for e in campaign})
    return diagnose_gap(more, bootstrap=0, hidden=False, separate=False, follow=False)


@pytest.mark.slow
def test_something_else_beside_two_effects_is_seen():
    gap = beside_two_effects(0.04)
    assert gap.verdict.kind == "unlisted"
    likely = gap.comparison.hypotheses[int(np.argmax(gap.comparison.probabilities))]
    assert likely.incomplete and len(likely.effects) == 2
    assert likely.leftover > LEFT
    # by the mean, not only by what is left as a break
    assert gap.probabilities.looks("unlisted") > NAMED


@pytest.mark.slow
def test_something_small_beside_two_effects_may_be_their_form():
    gap = beside_two_effects(0.03)
    likely = gap.comparison.hypotheses[int(np.argmax(gap.comparison.probabilities))]
    assert likely.incomplete and len(likely.effects) == 2
    form = simpler_explanation(likely, gap.comparison)
    assert form is not None and form.effects == likely.effects and form.left < OTHER_FORM
    assert gap.probabilities.looks("form") > 0.95


@pytest.mark.slow
def test_an_effect_of_the_mean_and_one_of_the_noise_stand_together():
    campaign = measured({"valve_asymmetry": 1.3, "mains_pickup": 0.02}, seed=2)
    gap = diagnose_gap(campaign, bootstrap=0, hidden=False, separate=False)
    assert "mains_pickup" in gap.verdict.effects
    assert any(CATALOGUE[n].family == "asymmetry" for n in gap.verdict.effects)


# --- the record


def test_gap_json_has_the_contract_keys():
    gap = diagnosed("valve_asymmetry", 1.25)
    record = json.loads(json.dumps(gap.to_json(), allow_nan=False))
    assert {"budget", "where", "which", "verdict", "shrink", "hidden"} <= set(record)
    assert {"calibrated_rms_V", "noise_floor_rms_V", "excess_rms_V", "excess_d", "p_value",
            "nominal_rms_V"} <= set(record["budget"])  # fmt: skip
    for cell in record["where"]:
        assert {"experiment", "phase", "t_start_s", "t_end_s", "excess_rms_V", "share",
                "p_value"} <= set(cell)  # fmt: skip
        assert cell["phase"] in PHASES and cell["t_start_s"] < cell["t_end_s"]
    assert sum(c["share"] for c in record["where"]) == pytest.approx(1.0)
    names = [row["effect"] for row in record["which"]]
    assert {"none", "unlisted", *NAMES} <= set(names) and len(names) == len(set(names))
    assert sum(row["probability"] for row in record["which"]) == pytest.approx(1.0)
    for row in record["which"]:
        assert {"effect", "family", "probability", "d", "strength", "tau_s", "fraction_closed",
                "confusable_with"} <= set(row)  # fmt: skip
    strengths = [effect.plausible for effect in CATALOGUE.values()]
    strengths += [row["strength"] for row in record["which"] + record["full_rate"]]
    strengths += [row["strength"] for row in record["hidden"]["effects"]]
    assert {name for strength in strengths for name in strength} <= set(record["strength_units"])
    assert {record["strength_units"][name] for name in ("closing_ratio", "drift", "mains_V")} == {
        "1", "V/s", "V"
    }  # fmt: skip
    assert {"kind", "effects", "family", "probability", "sentence"} <= set(record["verdict"])
    assert {"before_excess_rms_V", "after_excess_rms_V", "fraction_closed", "fraction_closed_lo",
            "fraction_closed_hi", "held_out_fraction_closed", "tau_before_s", "tau_after_s",
            "withheld"} <= set(record["shrink"])  # fmt: skip
    assert {e["effect"] for e in record["hidden"]["effects"]} <= set(NAMES)
    low, high = record["hidden"]["tau_envelope_s"]
    assert 0 < low < high


def test_nothing_is_shared_out_where_nothing_exceeds_the_floor():
    assert diagnosed("none", seed=1).where.share.sum() == 0.0


def test_effects_of_the_noise_have_no_d():
    rows = diagnosed("none", seed=1).which.set_index("effect")
    assert np.isnan(rows.d["heavy_tails"]) and np.isnan(rows.d["quantisation"])


@pytest.mark.slow
def test_the_same_seed_gives_the_same_record():
    campaign = measured({"dead_volume": 0.2}, seed=6)
    fit = bs.fit_least_squares(campaign, seed=1, euler=False)
    records = [
        diagnose_gap(campaign, fit, seed=3, bootstrap=10, separate=False).to_json()
        for _ in range(2)
    ]
    assert records[0] == records[1]


@pytest.mark.slow
def test_closure_and_held_out_agree_where_the_cause_is_right():
    gap = diagnosed("flow_switching", 1.0)
    closed = gap.shrink.closure
    assert closed.low < closed.fraction < closed.high
    assert closed.after_V < closed.before_V
    assert gap.shrink.held_out_fraction_closed == pytest.approx(closed.fraction, abs=0.25)


@pytest.mark.slow
def test_look_alikes_are_listed_with_what_would_separate_them():
    campaign = measured({"slow_sorption": 0.05}, seed=1)
    gap = diagnose_gap(campaign, bootstrap=0, hidden=False)
    rows = gap.which.set_index("effect")
    assert "two_rate_valve" in rows.confusable_with["slow_sorption"]
    (first, *_) = gap.separations
    assert first.isolability < 3.0
    assert gap.verdict.kind == "family" and len(gap.verdict.effects) <= 5


@pytest.mark.slow
def test_no_measurement_is_advised_that_tells_one_response_from_itself():
    # a volume far from the plausible one: knowing it better says nothing of two lags behind it
    plan = design()
    rig = {**theta(plan), "V_mL": 95.0}
    campaign, _ = simulate_with_effects(plan, rig, {"slow_sorption": 0.06}, seed=1)
    gap = diagnose_gap(campaign, bootstrap=0, hidden=False, follow=False)
    assert {"slow_sorption", "two_rate_valve"} <= set(gap.verdict.effects)
    pair, *others = gap.separations
    assert {pair.effect, pair.rival} == {"slow_sorption", "two_rate_valve"}
    assert pair.isolability < 0.3 and pair.addition == ""
    assert all(s.rival != pair.rival for s in others)


def test_nominal_parameters_fill_the_budget():
    campaign = measured({}, seed=1)
    nominal = {**theta(campaign), "V_mL": 80.0}
    gap = diagnose_gap(campaign, nominal=nominal, bootstrap=0, hidden=False, separate=False)
    assert gap.budget["nominal_rms_V"] > gap.budget["calibrated_rms_V"]
    floor, calibrated = gap.budget["noise_floor_rms_V"], gap.budget["calibrated_rms_V"]
    assert floor == pytest.approx(calibrated, rel=0.05)


# --- what may hide


def test_hidden_effects_shift_tau_without_a_trace():
    gap = diagnosed("none", seed=1)
    table = gap.hidden.table.set_index("effect")
    assert table.d["sensor_diffusion"] < 3 and table.d["daq_filter"] < 3
    assert table.d["slow_sorption"] > 3
    assert table.tau_shift_s["valve_second_order"] > 0.01  # inertia looks like a slower sensor


@pytest.mark.slow
def test_the_envelope_holds_tau_where_what_hides_is_stronger_than_plausible():
    # a valve near its critical damping: the fit has no misfit and calls the inertia a slow sensor
    gap = diagnose_gap(measured({"valve_second_order": 0.25}, seed=2), bootstrap=0, separate=False)
    assert gap.shrink.tau_before_s > 0.2
    low, high = gap.hidden.tau_envelope_s
    assert low < 0.06 < gap.shrink.tau_before_s < high
    table = gap.hidden.table.set_index("effect")
    valve = table.loc["valve_second_order"]
    assert valve.tau_free_low_s < 0.06 < valve.tau_free_high_s
    # what the data speak against has no such interval
    loud = diagnosed("flow_switching", 1.0).hidden.table.set_index("effect")
    assert loud.tau_free_low_s.isna().any()


# --- robustness


def test_one_experiment_step_up_only():
    plan = design(1, fall=False)
    campaign = simulate(plan, theta(plan), seed=1)
    gap = diagnose_gap(campaign, bootstrap=0, separate=False)
    assert gap.verdict.kind == "none"
    assert gap.shrink.held_out_fraction_closed is None
    text = " ".join(gap.notes)
    assert "No step down" in text and "One experiment" in text
    assert set(gap.where.phase) <= {"baseline", "onset", "rise", "plateau"}


def test_without_commanded_times_and_with_unequal_intervals():
    plan = design(3)
    t = np.arange(1500) * 0.04
    experiments = list(plan.experiments)
    experiments[1] = replace(experiments[1], t=t, mask=None, interval=0.04)
    plan = replace(plan, experiments=tuple(experiments))
    campaign = simulate(plan, theta(plan), seed=2)
    campaign = replace(
        campaign,
        experiments=tuple(replace(e, commanded_on=None, commanded_off=None) for e in campaign),
    )
    gap = diagnose_gap(campaign, bootstrap=0, separate=False, hidden=False)
    assert gap.verdict.kind in ("none", "unlisted")
    assert any("commanded" in note for note in gap.notes)


def test_masked_and_spoilt_samples_do_not_name_anything():
    campaign = measured({}, seed=8)
    rng = np.random.default_rng(1)
    experiments = []
    for e in campaign:
        y = e.values.copy()
        y[rng.integers(0, len(y), 5)] += 2.0
        used = np.ones(len(y), dtype=bool)
        used[2000:2200] = False
        experiments.append(replace(e, y=y, mask=used))
    campaign = replace(campaign, experiments=tuple(experiments))
    gap = diagnose_gap(campaign, bootstrap=0, separate=False, hidden=False)
    assert gap.budget["spikes_replaced"] >= 15
    assert gap.verdict.kind == "none" or set(gap.verdict.effects) <= {"heavy_tails"}


def test_whiteness_of_an_ar1_and_of_something_else():
    rng = np.random.default_rng(1)
    e = rng.standard_normal(20_000)
    ar1 = np.zeros_like(e)
    for i in range(1, len(e)):
        ar1[i] = 0.7 * ar1[i - 1] + e[i]
    assert ar1_whiteness([ar1]) > 0.001
    assert ar1_whiteness([e[2:] + 0.5 * e[:-2]]) < 1e-6


# --- errors and own effects


def test_bad_requests_are_explained():
    plan = design(2)
    with pytest.raises(CampaignError, match="design without data"):
        diagnose_gap(plan)
    campaign = simulate(plan, theta(plan), seed=1)
    with pytest.raises(CampaignError, match="did you mean 'flow_error'"):
        diagnose_gap(campaign, without=["flow_eror"])
    with pytest.raises(CampaignError, match="already in the catalogue"):
        diagnose_gap(campaign, effects=[CATALOGUE["flow_error"]])
    with pytest.raises(CampaignError, match="between"):
        simulate_with_effects(plan, theta(plan), {"axial_dispersion": 0.9})
    with pytest.raises(CampaignError, match="degrees of freedom"):
        simulate_with_effects(plan, theta(plan), {"heavy_tails": 1.5})


def ripple(t, strength, rig):
    """A wave that begins with the gas."""
    since = np.maximum(t - rig.t0, 0.0)
    return rig.mean(t) + strength["ripple_V"] * np.sin(2 * np.pi * since / 9.0) * (t > rig.t0)


RIPPLE = own_effect(
    "ripple", [Strength("ripple_V", "V", "normal", 0.0, 0.02)], ripple, plausible={"ripple_V": 0.02}
)


@pytest.mark.slow
def test_an_effect_of_ones_own_is_named():
    campaign = measured({}, seed=9)
    values = {}
    for e in campaign:
        since = np.maximum(e.t - e.commanded_on - 0.8, 0.0)
        values[e.name] = e.values + 0.02 * np.sin(2 * np.pi * since / 9.0)
    campaign = campaign.with_data(values)
    with_it = diagnose_gap(campaign, effects=[RIPPLE], bootstrap=0, hidden=False, separate=False)
    assert with_it.verdict.kind == "effect" and with_it.verdict.effects == ("ripple",)
    assert with_it.to_json()["strength_units"]["ripple_V"] == "V"
    without = diagnose_gap(campaign, bootstrap=0, hidden=False, separate=False)
    # a wave on the plateau alone also raises the floor: nothing may be named, whatever is seen
    assert without.verdict.effects == ()


def test_own_effects_are_read_from_a_file(tmp_path):
    path = tmp_path / "leak.py"
    path.write_text(
        "from bayes_sensor.diagnosis import Strength, own_effect\n"
        "LEAK = own_effect('leak', [Strength('leak_V', 'V', 'normal', 0.0, 0.02)],\n"
        "    lambda t, s, rig: rig.mean(t) + s['leak_V'] * (t > rig.t0),\n"
        "    plausible={'leak_V': 0.02})\n"
    )
    (effect,) = read_effects(path)
    assert effect.name == "leak"
    path.write_text("x = 1\n")
    with pytest.raises(CampaignError, match="defines no effect"):
        read_effects(path)
    path.write_text("raise RuntimeError('no')\n")
    with pytest.raises(CampaignError, match="RuntimeError: no"):
        read_effects(path)
    with pytest.raises(CampaignError, match="no such file"):
        read_effects(tmp_path / "other.py")


# --- simulation


def test_simulation_without_effects_is_the_models():
    plan = design(2)
    one, _ = simulate_with_effects(plan, theta(plan), {}, seed=4)
    other = simulate(plan, theta(plan), seed=4)
    for a, b in zip(one, other, strict=True):
        assert np.allclose(a.values, b.values, atol=1e-12)


def test_every_effect_can_be_simulated_and_changes_the_record():
    plan = design(2)
    plain, _ = simulate_with_effects(plan, theta(plan), {}, seed=4)
    for name in NAMES:
        made, strengths = simulate_with_effects(plan, theta(plan), {name: None}, seed=4)
        away = max(np.max(np.abs(a.values - b.values)) for a, b in zip(made, plain, strict=True))
        assert away > 1e-4, name
        assert set(strengths[name]) == set(CATALOGUE[name].plausible)


def test_plausible_strengths_follow_the_rig():
    from bayes_sensor.diagnosis.effects.effect_model import Scales

    slow = Scales(time_scale=8.577, reference_flow=100.0, signal_scale=1.88, duration=1200.0)
    assert default_strengths("finite_stroke", slow)["stroke"] == pytest.approx(3.0)
    assert default_strengths("gain_drift", slow)["gain_drift"] == pytest.approx(1e-5)
    assert default_strengths("valve_asymmetry", slow)["closing_ratio"] == 1.1


@pytest.mark.slow
def test_a_notebook_shows_the_verdict_and_the_explanations():
    gap = diagnosed("carry_over", 0.12)
    text = gap._repr_html_()
    assert gap.verdict.kind in text and "carry_over" in text
    for row in gap.rows[:3]:
        assert row["effect"] in text
    assert text.count("<tr") >= min(len(gap.rows), 8)


@pytest.mark.parametrize("name", ["a+b", "", "unlisted", "with space"])
def test_names_of_own_effects_must_not_be_mistaken(name):
    with pytest.raises(CampaignError, match="expected a name of letters"):
        own_effect(
            name, [Strength("s", "V", "normal", 0.0, 1.0)], lambda t, s, rig: rig.mean(t),
            plausible={"s": 1.0},
        )  # fmt: skip


def test_nothing_is_certified_where_the_fit_sees_no_step() -> None:
    campaign = measured({}, seed=1)  # the falls are in the records, but nobody said so
    untold = tuple(replace(e, commanded_on=None, commanded_off=None) for e in campaign)
    gap = diagnose_gap(replace(campaign, experiments=untold), bootstrap=0, separate=False)
    said = gap.verdict.sentence
    assert said.startswith("No step is seen beyond what the model misses, in any experiment")
    assert "Nothing is missing" not in said
    assert gap.verdict.kind == "none"
    assert said.endswith("in any experiment: whether anything is missing cannot be told.")


@pytest.mark.slow
def test_flows_written_to_each_others_records_are_explained_by_their_factors() -> None:
    # the fit bends V away, where no flow makes any difference: the factors need another start
    campaign = measured({}, seed=3, sigma=0.004)
    one, first, second, last = campaign.experiments
    exchanged = [
        replace(a, carrier_flow=b.carrier_flow, test_gas_flow=b.test_gas_flow)
        for a, b in ((first, second), (second, first))
    ]
    mixed = replace(campaign, experiments=(one, *exchanged, last))
    gap = diagnose_gap(mixed, bootstrap=0, separate=False, hidden=False)
    row = next(r for r in gap.rows if r["effect"] == "flow_error")
    assert row["fraction_closed"] > 0.999
    factors = row["strength"]["flow_factor"]
    assert factors["2"] == pytest.approx(1.0 / 3.0, rel=0.05)  # 3 L/min, said to be 9
    assert factors["3"] == pytest.approx(3.0, rel=0.05)


@pytest.mark.slow
def test_commands_that_switch_times_lean_on_are_told_before_the_verdict() -> None:
    campaign = measured({}, seed=3)
    late = tuple(  # written later than the response begins
        replace(e, commanded_on=e.commanded_on + 0.9, commanded_off=e.commanded_off + 0.9)
        for e in campaign
    )
    gap = diagnose_gap(
        replace(campaign, experiments=late), bootstrap=0, separate=False, hidden=False
    )
    assert gap.verdict.sentence.startswith("4 of 8 switch times sit at the earliest")
    assert "commands allow" not in diagnosed("none", seed=3).verdict.sentence


@pytest.mark.slow
def test_a_family_that_leaves_what_no_process_knows_is_not_stated() -> None:
    campaign = measured({"slow_sorption": 0.03}, seed=2, sigma=0.02)
    smooth = diagnose_gap(campaign, bootstrap=0, separate=False, hidden=False)
    assert smooth.verdict.kind == "family" and "slow_sorption" in smooth.verdict.effects
    # every switch another course, which changes as fast as the bins: too rough for a discrepancy
    rng, piece, pieces = np.random.default_rng(3), 0.15, 50
    values = {e.name: e.values.copy() for e in campaign}
    for e in campaign:
        for at in (e.commanded_on, e.commanded_off):
            steps, k = rng.normal(0.0, 0.02, pieces), np.floor((e.t - at) / piece).astype(int)
            within = (k >= 0) & (k < pieces)
            values[e.name][within] += steps[k[within]]
    gap = diagnose_gap(campaign.with_data(values), bootstrap=0, separate=False, hidden=False)
    assert gap.verdict.kind == "unlisted"
    assert "% of the gap" in gap.verdict.sentence
    assert "standard deviations of misfit are left: the cause is not" in gap.verdict.sentence


@pytest.mark.slow
def test_an_event_beside_an_effect_is_a_note() -> None:
    campaign = measured({"gain_drift": 0.0025}, seed=2, sigma=0.02)
    values = {e.name: e.values.copy() for e in campaign}
    e = campaign.experiments[1]
    values[e.name] += 0.12 * ((e.t > 24.0) & (e.t < 24.6))
    gap = diagnose_gap(campaign.with_data(values), bootstrap=0, separate=False, hidden=False)
    assert gap.verdict.kind in ("effect", "family") and gap.verdict.effects[0] == "gain_drift"
    assert any("something happens once" in said for said in (gap.verdict.sentence, *gap.notes))
    event = next(f for f in gap.to_json()["findings"] if f["signal"] == "event")
    assert event["place"].startswith("experiment 2, 24") and event["log_bayes_factor"] > 3.0


@pytest.mark.slow
def test_a_wander_that_slow_noise_may_be_is_said_to_look_like_it() -> None:
    # 6 mV with a memory of ten seconds: no stretch of these records is long enough to know it
    campaign = measured({}, seed=40, sigma=0.02)
    rng = np.random.default_rng(0)
    values = {}
    for e in campaign:
        phi = np.exp(-e.interval / 10.0)
        z = lfilter([np.sqrt(1 - phi**2)], [1, -phi], rng.standard_normal(len(e.t) + 4000))[4000:]
        values[e.name] = e.values + 0.006 * z
    gap = diagnose_gap(campaign.with_data(values), bootstrap=0, separate=False, hidden=False)
    assert gap.verdict.kind == "unlisted" and WANDERS in gap.verdict.sentence
    # a bump after every opening is no wander
    bump = {e.name: e.values + 0.08 * np.exp(-0.5 * ((e.t - e.commanded_on - 5.0) / 0.8) ** 2)
            for e in campaign}  # fmt: skip
    other = diagnose_gap(campaign.with_data(bump), bootstrap=0, separate=False, hidden=False)
    assert other.verdict.kind == "unlisted" and WANDERS not in other.verdict.sentence


@pytest.mark.slow
def test_a_fit_under_another_noise_law_or_with_effects_serves_as_well_and_a_foreign_one_does_not():
    campaign = measured({"valve_asymmetry": 1.3}, n=3)
    plain = bs.fit_least_squares(campaign, swarms=1)
    own = bs.fit_least_squares(Problem(campaign, noise=Noise(per_experiment=True)), swarms=1)
    problem = with_effects(Problem(campaign), ["valve_asymmetry"], plain.theta_hat)
    told = bs.fit_least_squares(problem, swarms=1)
    euler = bs.fit_least_squares(Problem(campaign, model=Cascade("euler")), swarms=1)
    assert len({len(f.names) for f in (plain, own, told)}) == 3
    quick = {"bootstrap": 0, "separate": False, "hidden": False, "follow": False}
    found = [diagnose_gap(campaign, f, **quick).verdict for f in (plain, own, told, euler)]
    assert all("valve_asymmetry" in v.effects for v in found)
    assert found[0].probability == found[1].probability
    # bounds know such a fit for the campaign's, too
    low, high = bs.compare_bounds(problem, told, methods=["crlb_ar1"])["crlb_ar1"].interval("tau_s")
    assert low < 0.06 < high

    other = measured({"valve_asymmetry": 1.3}, seed=2, n=3)
    with pytest.raises(CampaignError, match="it is of other data; fit this campaign first"):
        diagnose_gap(other, plain, **quick)
    fewer = replace(campaign, experiments=campaign.experiments[:2])
    with pytest.raises(CampaignError, match="gap: the fit has the parameters tau_s, .*fit this"):
        diagnose_gap(fewer, plain, **quick)


@pytest.mark.slow
def test_an_instrument_that_warms_up_is_a_drift_of_the_baseline() -> None:
    campaign = measured({}, seed=3)
    warm = {e.name: e.values - 0.15 * (1.0 - np.exp(-e.t / 45.0)) for e in campaign}
    gap = diagnose_gap(campaign.with_data(warm), bootstrap=0, separate=False, hidden=False)
    assert gap.verdict.kind in ("effect", "family")
    assert gap.verdict.effects[0] == "baseline_drift" and gap.verdict.family == "baseline"
    tau = gap.shrink.tau_after_low_s, gap.shrink.tau_after_high_s
    assert tau[0] < 0.06 < tau[1]
    assert gap.to_json()["verdict"]["sets_in"] == []  # it has begun before the records
