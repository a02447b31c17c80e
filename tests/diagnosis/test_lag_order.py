"""The diagnosis where the sensor's lag is the longer one, and where nobody knows which it is."""

import pickle
from dataclasses import replace
from functools import lru_cache
from types import SimpleNamespace

import numpy as np
import pytest

import bayes_sensor as bs
from bayes_sensor import figures
from bayes_sensor.blind_check.diagnosing import trimmed
from bayes_sensor.campaign import Campaign, FloatArray, SideInformation
from bayes_sensor.diagnosis import CATALOGUE, Gap, Strength, diagnose_gap, own_effect
from bayes_sensor.diagnosis.data.binned_campaign import BinnedCampaign
from bayes_sensor.diagnosis.data.preparation import fit_base, prepare
from bayes_sensor.diagnosis.effects.effect_model import with_effects
from bayes_sensor.diagnosis.effects.simulate_effects import simulate_with_effects
from bayes_sensor.diagnosis.evidence.laplace_evidence import Linearised
from bayes_sensor.diagnosis.evidence.refit_coordinates import Coordinates
from bayes_sensor.diagnosis.evidence.varying_parameter import embedded_rivals
from bayes_sensor.diagnosis.probabilities import Probabilities
from bayes_sensor.diagnosis.verdict import judge
from bayes_sensor.diagnosis.wording import effect_sentence, second_words, with_alternative
from bayes_sensor.fit import fit_least_squares
from bayes_sensor.report.sections.gap_section import envelope_sentences, shrink_sentences
from bayes_sensor.report.sections.gap_tables import budget_table, hidden_table, which_table
from bayes_sensor.rig.imperfections import TAU, TAU_M, TAU_V
from bayes_sensor.rig.lags import Naming, assignments
from bayes_sensor.rig.layout import Layout
from tests.support.planted_effects import design, theta
from tests.support.published_lags import THREE, TWO, assigned, commuting

SENSOR, VALVE = 2.0, 0.15
"""s, the lags of a slow sensor behind a quick valve"""


def slow_sensor(campaign: Campaign) -> dict[str, object]:
    """Parameters by name: the sensor's lag is the longer one."""
    return theta(campaign) | {"tau_s": SENSOR, "tau_v_s": VALVE}


@lru_cache(maxsize=4)
def measured(order: str, effect: str = "sorption_asymmetry", strength: float = 1.3) -> Campaign:
    """A slow sensor's campaign that says ``order`` of it, with one effect."""
    plan = replace(design(4), sensor_is=order)
    return simulate_with_effects(plan, slow_sensor(plan), {effect: strength}, seed=1)[0]


@lru_cache(maxsize=4)
def diagnosed(order: str) -> Gap:
    """Its diagnosis."""
    campaign = measured(order)
    fit = fit_least_squares(campaign, seed=1, euler=False, swarms=1)
    return diagnose_gap(campaign, fit, seed=1, bootstrap=0)


def sorted_theta(campaign: Campaign) -> FloatArray:
    """The true flat parameters, lags by size."""
    return commuting(None).by_size(Layout.of(campaign).flat(slow_sensor(campaign)))


# --------------------------------------------------------------------------- the longer lag


@pytest.mark.slow
def test_release_of_a_slow_sensor_is_the_sensors_and_tau_its_own() -> None:
    gap = diagnosed("slower")
    assert gap.verdict.effects[0] == "sorption_asymmetry" and gap.verdict.kind == "effect"
    assert gap.probabilities.effects["valve_asymmetry"] < 0.05
    record = gap.to_json()
    row = record["which"][0]
    assert row["strength"]["release_ratio"] == pytest.approx(1.3, abs=0.02)
    assert row["tau_s"] == pytest.approx(SENSOR, rel=0.02)
    shrink = record["shrink"]
    assert shrink["tau_after_lo_s"] < SENSOR < shrink["tau_after_hi_s"]
    assert shrink["tau_before_s"] > 1.05 * SENSOR  # without the effect: as slow as up and down
    low, high = record["hidden"]["tau_envelope_s"]
    assert low < SENSOR < high < 2.0 * SENSOR
    # what hides shifts it by some of itself, not by some of the valve's
    assert all(each["tau_low_s"] > 5.0 * VALVE for each in record["hidden"]["effects"])
    assert any("sensor is taken to be slower than the valve" in note for note in gap.notes)
    assert not any("lag_fast" in key for key in [*shrink, *record["hidden"], *row])


def test_a_spread_of_the_longer_lag_is_its_own() -> None:
    plan = design(2, interval=0.02)
    campaign = bs.simulate(plan, slow_sensor(plan), seed=2)
    found = {}
    for order in ("faster", "slower"):
        binned = prepare(replace(campaign, sensor_is=order), sorted_theta(campaign)).binned
        found[order] = fit_base(binned)
    faster, slower = found["faster"], found["slower"]
    # without effects the two are one model, only tau is another of its lags
    assert slower.lags == pytest.approx(faster.lags, rel=0.02)  # the kernel's grids differ
    assert (faster.tau, faster.tau_v) == faster.lags and slower.tau == slower.lags[1]
    line = Linearised(slower).evidence(None)
    assert line.log_tau == pytest.approx(np.log(slower.lags[1]), abs=0.02)
    # the law of the floor's level widens it by a few percent of some hundred bins
    covariance = np.linalg.inv(slower.normal)
    assert line.sd_log_tau == pytest.approx(np.sqrt(covariance[1, 1]), rel=0.1)
    assert Linearised(faster).evidence(None).sd_log_tau > 3.0 * line.sd_log_tau


def test_side_information_finds_its_lag() -> None:
    known = {"tau_s": SideInformation(1.9, 0.1), "V_mL": SideInformation(60.0, 3.0)}
    campaign = replace(measured("unknown"), side_information=known)
    flat, choices = sorted_theta(campaign), assignments("unknown", TWO)
    decided = prepare(
        campaign, flat, Naming("unknown", choices, (0.02, 0.98), commuting(None))
    ).binned
    assert decided.lags == ("tau_v_s", "tau_s") and decided.sensor == 1
    assert np.exp(decided.centre[1:]) == pytest.approx([1.9, 60.0])
    assert decided.sd[1:] == pytest.approx([0.1 / 1.9, 0.05])
    # where nobody knows whose a lag is, what is known of tau is of neither
    either = prepare(campaign, flat, Naming("unknown", choices, (0.4, 0.6), commuting(None))).binned
    assert not either.order_known and either.sensor == 0
    assert np.exp(either.centre[1:]) == pytest.approx([SENSOR, 60.0])
    assert either.sd[1] > 0.5


@pytest.mark.parametrize(
    ("chosen", "lags"),
    [
        (assigned(0, 2, 1), ("tau_s", "tau_v_s")),  # as the calculation has them
        (assigned(2, 0, 1), ("tau_v_s", "tau_s")),
        (assigned(1, 0, 2), ("tau_v_s", "tau_s")),  # the sensor between valve and manifold
        (assigned(1, 2, 0), ("tau_s", "tau_v_s")),
    ],
)
def test_at_one_flow_the_three_lags_go_to_their_owners(chosen, lags) -> None:
    plan = design(2, interval=0.02)
    first = plan.experiments[0]
    plan = replace(plan, sensor_is="unknown", experiments=tuple(
        replace(e, carrier_flow=first.carrier_flow, test_gas_flow=first.test_gas_flow) for e in plan
    ))  # fmt: skip
    flow = first.total_flow
    by_lag = (0.2, 0.7, 2.0)
    values = {"tau_s": by_lag[0], "tau_v_s": by_lag[2], "V_mL": by_lag[1] * flow}
    campaign = bs.simulate(plan, theta(plan) | values, seed=1)
    choices = assignments("unknown", THREE)
    shares = tuple(0.96 if a == chosen else 0.008 for a in choices)
    flat = Layout.of(campaign).flat(theta(plan) | values)
    binned = prepare(campaign, flat, Naming("unknown", choices, shares, commuting(flow))).binned
    assert binned.lags == lags
    made = Coordinates(binned)
    owners = [by_lag[i] for i in (chosen.sensor, chosen.valve, chosen.manifold)]
    single, _ = made.rig(binned.base, 0)
    assert single[[TAU, TAU_V, TAU_M]] == pytest.approx(owners)
    assert made.rigs(binned.base)[1, [TAU, TAU_V, TAU_M]] == pytest.approx(owners)
    undecided = Naming("unknown", choices, (1.0 / 6.0,) * 6, commuting(flow))
    assert prepare(campaign, flat, undecided).binned.lags == ("lag_fast_s", "lag_slow_s")


def test_derivatives_move_the_lag_that_they_say() -> None:
    campaign = measured("slower")
    binned = prepare(campaign, sorted_theta(campaign)).binned
    plan = Coordinates(binned)
    x = binned.base
    here = plan.all_means(x)
    found = plan.derivatives(x, here, finer=0.01)
    for i in range(3):
        moved = x.copy()
        moved[i] += 1e-6
        slope = binned.whitened(plan.all_means(moved) - here) / 1e-6
        scale = np.abs(slope).max()
        assert np.abs(found[:, i] - slope).max() < 0.01 * scale  # steps of 1e-4 and less


# --------------------------------------------------------------------------- nobody knows


@pytest.mark.slow
def test_where_nobody_knows_both_readings_are_said() -> None:
    gap = diagnosed("unknown")
    v = gap.verdict
    assert (v.kind, v.family) == ("family", "asymmetry") and v.probability > 0.9
    assert {"valve_asymmetry", "sorption_asymmetry"} <= set(v.effects)
    assert v.sentence.startswith(
        "valve_asymmetry if the longer lag is the valve's, or sorption_asymmetry if it is the "
        "sensor's, explains the gap"
    )
    assert "the sensor behind another valve" in v.sentence
    assert any("Nobody knows which lag is the sensor's" in note for note in gap.notes)


@pytest.mark.slow
def test_where_nobody_knows_nothing_is_said_of_tau() -> None:
    record = diagnosed("unknown").to_json()
    said = [record["budget"], record["shrink"], record["hidden"], *record["hidden"]["effects"],
            *record["which"]]  # fmt: skip
    n = 0
    for part in said:
        of_tau = [key for key in part if key.startswith("tau_")]
        assert all(part[key] is None for key in of_tau)
        assert all(key.replace("tau", "lag_fast", 1) in part for key in of_tau)
        n += len(of_tau)
    assert n > 20
    shrink = record["shrink"]
    assert shrink["lag_fast_after_lo_s"] < VALVE < shrink["lag_fast_after_hi_s"]
    low, high = record["hidden"]["lag_fast_envelope_s"]
    assert low < VALVE < high
    gap = diagnosed("unknown")
    assert gap.shrink.tau_after_s is None and gap.hidden.tau_envelope_s is None
    assert {"tau_shift_s", "lag_fast_shift_s"} <= set(gap.hidden.table.columns)
    assert "shorter lag" in repr(gap) and "tau" not in repr(gap)
    assert trimmed(record)["tau_envelope_s"] == [None, None]


def test_the_report_speaks_of_the_shorter_lag() -> None:
    record = diagnosed("unknown").to_json()
    text = " ".join([*shrink_sentences(record, "mV", 1e3), *envelope_sentences(record, False)])
    assert "The shorter lag moves from" in text and "the shorter lag lies between" in text
    tables = [budget_table(record, "mV", 1e3), which_table(record), hidden_table(record)]
    for table in tables:
        text += " ".join(
            [table.caption, *map(str, table.columns), *(str(r[0]) for r in table.rows)]
        )
    assert "the shorter lag with it (ms)" in text and "error of the shorter lag (ms)" in text
    assert "τ" not in text
    column = tables[1].columns.index("the shorter lag with it (ms)")
    assert tables[1].rows[0][column] == pytest.approx(1e3 * record["which"][0]["lag_fast_s"])
    drawn = figures.svg(figures.gap_hidden(record["hidden"], record["shrink"]["lag_fast_before_s"]))
    assert "the shorter lag with it (ms)" in drawn and "envelope of the shorter lag" in drawn
    assert "daq filter" in drawn


def test_nothing_missing_leaves_a_range_of_the_shorter_lag() -> None:
    plan = replace(design(2, interval=0.02), sensor_is="unknown")
    campaign = bs.simulate(plan, slow_sensor(plan), seed=2)
    fit = fit_least_squares(campaign, seed=1, euler=False, swarms=1)
    gap = diagnose_gap(campaign, fit, bootstrap=0, hidden=False, separate=False)
    assert gap.verdict.kind == "none"
    assert "with them the shorter lag could be anywhere from" in gap.verdict.sentence


def test_strengths_that_look_alike_are_told_once() -> None:
    campaign = measured("unknown")
    binned = prepare(campaign, sorted_theta(campaign)).binned
    drift = CATALOGUE["baseline_drift"]
    told = [
        effect_sentence(drift, {"warm_up": {"1": -0.15, "2": low}}, binned, "V")
        for low in (-0.15001, -0.2)
    ]
    assert "-0.15 V" in told[0] and " to " not in told[0]
    assert "-0.2 to -0.15 V" in told[1]


def test_a_dependence_without_a_name_is_of_a_lag_by_its_size() -> None:
    campaign = measured("unknown")
    flat = sorted_theta(campaign)
    either, known = prepare(campaign, flat).binned, prepare(measured("slower"), flat).binned
    rivals = {r.name: r for r in embedded_rivals([], True, True, True)}

    def words(name: str, binned: BinnedCampaign) -> str:
        return effect_sentence(rivals[name], {}, binned, "V")

    assert words("valve by flow", either).startswith("the longer lag's time constant depends")
    assert words("sensor by direction", either).startswith("the shorter lag releases")
    assert words("sensor by direction", known).startswith("the sensor releases")
    for name in ("volume by flow", "part later", "pulse at commands"):
        assert words(name, either) == words(name, known)


# --------------------------------------------------------------------------- the catalogue


def test_what_acts_on_a_lag_has_a_counterpart_on_the_other() -> None:
    stages = {"command", "valve", "flow", "manifold", "sensor", "readout", "record"}
    assert {effect.stage for effect in CATALOGUE.values()} == stages
    for name, effect in CATALOGUE.items():
        if effect.stage not in ("valve", "sensor"):
            assert not effect.exchanged
            continue
        other = CATALOGUE[effect.same_response or effect.exchanged]
        assert {effect.stage, other.stage} == {"valve", "sensor"}
        assert name in (other.same_response, other.exchanged) and effect.family == other.family
        assert effect.nameless.same_response == other.name
    size = Strength("mine", "V", "normal", 0.0, 1.0)
    own = own_effect("mine", [size], lambda t, _, rig: rig.mean(t), plausible={"mine": 1.0})
    assert own.nameless == own


def mean_with(effect: str, strengths: dict[str, float], tau: float, tau_v: float) -> FloatArray:
    """V (n_t,) of one experiment with an effect."""
    plan = design(1, interval=0.02)
    problem = with_effects(plan, [effect], held=strengths)
    flat = problem.layout.flat(theta(plan) | {"tau_s": tau, "tau_v_s": tau_v})
    e = plan.experiments[0]
    made: FloatArray = problem.model.mean(e.t, flat, problem.layout, e)
    return made


@pytest.mark.parametrize(
    ("effect", "strengths", "counterpart", "theirs", "null", "alike"),
    [
        # what changes with direction does not commute with the other lag: nearly the same
        ("valve_asymmetry", {"closing_ratio": 1.3}, "sorption_asymmetry", {"release_ratio": 1.3},
         {"closing_ratio": 1.0}, 0.1),
        ("two_rate_valve", {"slow_valve_share": 0.1, "slow_valve_time": 9.0}, "slow_sorption",
         {"slow_site_share": 0.1, "slow_site_time": 9.0},
         {"slow_valve_share": 1e-6, "slow_valve_time": 9.0}, 1e-3),
        # a stroke is over before the first lag begins, whosever that is
        ("finite_stroke", {"stroke": 0.5}, "finite_stroke", {"stroke": 0.5}, {"stroke": 1e-3},
         1e-3),
    ],
)  # fmt: skip
def test_an_exchanged_effect_leaves_the_same(
    effect, strengths, counterpart, theirs, null, alike
) -> None:
    of_one = mean_with(effect, strengths, VALVE, SENSOR)
    of_other = mean_with(counterpart, theirs, SENSOR, VALVE)
    size = np.abs(of_one - mean_with(effect, null, VALVE, SENSOR)).max()
    assert size > 0.02
    assert np.abs(of_one - of_other).max() < alike * size


def test_an_effect_of_one_of_two_lags_is_told_with_its_counterpart() -> None:
    nameless = {name: effect.nameless for name, effect in CATALOGUE.items()}
    for name, effect in CATALOGUE.items():
        assert with_alternative(effect) == name  # where the lags have their names
        twins = with_alternative(nameless[name])
        assert effect.exchanged in twins if effect.exchanged else twins == name
    assert with_alternative(nameless["sensor_diffusion"]) == (
        "sensor_diffusion if the shorter lag is the sensor's, or valve_second_order if it is the "
        "valve's"
    )
    effects = dict.fromkeys(CATALOGUE, 0.0) | {"baseline_drift": 0.95, "valve_asymmetry": 0.93}
    combined = SimpleNamespace(effects=effects, families={"baseline": 0.95, "asymmetry": 0.93})
    said = "".join(second_words(["baseline_drift"], combined, nameless))
    assert "most likely valve_asymmetry if the longer lag is the valve's, or sorption_asy" in said
    # nor is it named beside another
    rows = {"none": 0.0, "unlisted": 0.06, "baseline_drift+valve_asymmetry": 0.94}
    both = ("baseline_drift", "valve_asymmetry")
    assert judge(Probabilities(rows, CATALOGUE), 0.0)[:2] == ("effect", both)
    assert judge(Probabilities(rows, nameless), 0.0).kind == "family"


# --------------------------------------------------------------------------- the full model


@pytest.mark.parametrize("known", [False, True])
def test_an_effect_in_the_full_model_acts_on_its_own_lag(known) -> None:
    plan = replace(design(2, interval=0.02), sensor_is="unknown" if known else "slower")
    if known:
        plan = replace(plan, side_information={"tau_s": SideInformation(2.0, 0.1)})
    held = {"release_ratio": 1.3}
    flat = sorted_theta(plan)
    problem = with_effects(plan, ["sorption_asymmetry"], flat, held)
    e = plan.experiments[0]
    found = problem.model.mean(e.t, flat, problem.layout, e)
    assert found == pytest.approx(mean_with("sorption_asymmetry", held, SENSOR, VALVE), abs=1e-12)
    assert pickle.loads(pickle.dumps(problem.model)).assignment == assigned(1, 0)
    # told nothing, it takes the shorter lag for the sensor's
    other = with_effects(replace(plan, sensor_is="unknown"), ["sorption_asymmetry"], None, held)
    there = other.model.mean(e.t, flat, other.layout, e)
    assert there == pytest.approx(mean_with("sorption_asymmetry", held, VALVE, SENSOR), abs=1e-12)


def test_a_simulated_truth_says_itself_whose_its_lags_are() -> None:
    made = [measured(order).experiments[0].values for order in ("faster", "slower", "unknown")]
    assert np.array_equal(made[0], made[1]) and np.array_equal(made[0], made[2])
