"""The independent simulator: what it rests on, nothing wrong, every cause, campaigns."""

from __future__ import annotations

import ast
import sys
import time
from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import replace
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.integrate import solve_ivp

import bayes_sensor.blind_check.simulator as simulator
import bayes_sensor.blind_check.simulator.simulated_rig as rig_module
from bayes_sensor import read_campaign
from bayes_sensor.blind_check.plan import HIDING
from bayes_sensor.blind_check.simulator import (
    CAUSES,
    Case,
    acting_places,
    as_recorded,
    clean_signals,
    draw_case,
    make_campaign,
    phase_spans,
    prepared_rigs,
    sample_times,
    without_causes,
)
from bayes_sensor.blind_check.simulator.numerics import layered_film, nodes
from bayes_sensor.blind_check.simulator.simulated_rig import Rig
from bayes_sensor.campaign import CampaignError, FloatArray
from bayes_sensor.io.json_files import read_json

CONTRACT_NAMES = (
    "flow_switching valve_asymmetry valve_second_order two_rate_valve finite_stroke dead_volume "
    "axial_dispersion flow_settling flow_error sensor_diffusion sorption_asymmetry slow_sorption "
    "optical_nonlinearity baseline_drift baseline_step gain_drift carry_over mains_pickup "
    "daq_filter heavy_tails quantisation"
).split()
MEAN_CAUSES = [name for name, cause in CAUSES.items() if not cause.noise]
PLACES = ("valve", "flow", "manifold", "sensor", "readout", "electronics")
WITHHELD = Path(__file__).resolve().parents[2] / "data" / "withheld"


def case(**strengths: float) -> Case:
    """A small rig, the same for every call."""
    return replace(draw_case(11, size="small"), strengths=strengths)


def rms(some: dict[str, FloatArray], others: dict[str, FloatArray]) -> float:
    """V, of the difference of two campaigns' signals."""
    return float(np.sqrt(np.mean([np.mean((some[k] - others[k]) ** 2) for k in some])))


def step_response(since: FloatArray, taus: Sequence[float]) -> FloatArray:
    """Response (n,) of lags in a row to a step at 0: 1 - sum_i w_i exp(-t/tau_i)."""
    left = np.zeros(len(since))
    for i, tau in enumerate(taus):
        weight = np.prod([tau / (tau - other) for j, other in enumerate(taus) if j != i])
        left += weight * np.exp(-np.maximum(since, 0.0) / tau)
    return np.where(since > 0.0, 1.0 - left, 0.0)


def cascade(rig: Case, k: int, taus: Sequence[float] | None = None) -> FloatArray:
    """(n_t,) V of one experiment's cascade, in closed form."""
    step = rig.steps[k]
    t, taus = sample_times(step), taus or (rig.tau_v, rig.V / step.total_flow, rig.tau)
    x = step_response(t - step.t0, taus) - step_response(t - step.tf, taus)
    return step.y0 + step.beta * x


# --------------------------------------------------------------------------- independence


def test_the_simulator_imports_nothing_but_the_campaign_and_numerics() -> None:
    own = "bayes_sensor.blind_check.simulator"
    files = sorted(Path(simulator.__file__).parent.rglob("*.py"))
    assert len(files) >= 10
    seen = set()
    for file in files:
        for node in ast.walk(ast.parse(file.read_text(encoding="utf-8"))):
            names = []
            if isinstance(node, ast.Import):
                names = [alias.name for alias in node.names]
            elif isinstance(node, ast.ImportFrom):
                assert node.level == 0, f"{file.name}:{node.lineno}: relative import"
                names = [node.module or ""]
            for name in names:
                seen.add(name)
                root = name.split(".")[0]
                libraries = ("numpy", "scipy", "numba", "pydantic")
                allowed = root in libraries or root in sys.stdlib_module_names
                inside = name == own or name.startswith(f"{own}.")
                assert (
                    allowed or inside or name in ("bayes_sensor.campaign", "bayes_sensor.compiled")
                ), f"{file.name}:{node.lineno}: {name}"
    assert "bayes_sensor.campaign" in seen  # the walk did look at imports


def test_the_causes_span_places_and_kinds() -> None:
    assert {name for cause in CAUSES.values() for name in cause.listed_as} == set(CONTRACT_NAMES)
    assert 45 <= len(CAUSES) <= 55
    unlisted = [cause for cause in CAUSES.values() if not cause.listed]
    assert 27 <= len(unlisted) <= 32
    assert [cause.place for cause in CAUSES.values()] == sorted(
        (cause.place for cause in CAUSES.values()), key=PLACES.index
    )
    for some in (unlisted, [cause for cause in CAUSES.values() if cause.listed]):
        assert set(PLACES) == {cause.place for cause in some}
    # the oracle's kinds: fast ones, some that look like a listed effect, clocks, single records
    assert sum(cause.fast for cause in unlisted) >= 2
    assert sum(bool(cause.near) for cause in unlisted) >= 4
    assert sum(cause.per_experiment for cause in unlisted) >= 5
    assert "clock" in {cause.family for cause in unlisted}
    kept = [cause for cause in unlisted if cause.reserve]
    assert len(kept) == 12 and Counter(cause.place for cause in kept) == dict.fromkeys(PLACES, 2)
    assert not any(cause.reserve for cause in CAUSES.values() if cause.listed)
    assert all(name in CONTRACT_NAMES for cause in unlisted for name in cause.near)
    assert all(CAUSES[name].listed for name in HIDING)
    assert all(cause.turn.__doc__ and cause.name == name for name, cause in CAUSES.items())


# --------------------------------------------------------------------------- nothing wrong


@pytest.mark.parametrize("size", ["paper", "varied", "small"])
def test_with_nothing_wrong_it_is_the_cascade(size: str) -> None:
    rig = draw_case(4, size=size)
    for k, (name, y) in enumerate(clean_signals(rig).items()):
        # straight lines between nodes leave a few 1e-6 of the step; the stated tolerance is 1e-4
        assert np.abs(y - cascade(rig, k)).max() < 1e-5 * rig.steps[k].beta, name


def test_nodes_may_be_few() -> None:
    # the oracle asks for a few hundred times only: the same values as at all samples
    rig = case(flow_follows_valve=1.0, slow_sites=0.1, lorentzian_flank=0.5)
    full = clean_signals(rig)
    for step in rig.steps:
        t = sample_times(step)
        few = t[:: len(t) // 211]
        y = clean_signals(rig, {s.name: few if s is step else t for s in rig.steps})[step.name]
        assert np.abs(y - np.interp(few, t, full[step.name])).max() < 2e-5 * step.beta


@pytest.mark.parametrize("name", ["", *MEAN_CAUSES])
def test_signals_converge_in_the_time_step(name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    rig = case(**({name: 0.7 * CAUSES[name].highest} if name else {}))
    times = {s.name: np.linspace(0.0, s.duration, 61) + 0.003 for s in rig.steps}

    def with_steps(share: float) -> dict[str, FloatArray]:
        def finer(times: FloatArray, events: list[float], quick: float) -> FloatArray:
            grid = nodes(times, events, quick)
            cuts = np.arange(1, round(1.0 / share)) * share
            between = grid[:-1, None] + np.diff(grid)[:, None] * cuts
            return np.unique(np.concatenate([grid, between.ravel()]))

        monkeypatch.setattr(rig_module, "nodes", finer)
        return clean_signals(rig, times)

    coarse, fine, finest = (with_steps(share) for share in (1.0, 0.5, 0.125))
    # where something slips or switches when a level is passed, it does so at the next node
    first, second = rms(coarse, finest) / rig.mean_step, rms(fine, finest) / rig.mean_step
    jumps = name in ("sticking_valve", "range_change")
    assert first < (5e-3 if jumps else 2e-5)
    # of second order, or exact to rounding; of first where something begins within an interval
    order = 0.6 if name in ("residue", "dead_leg") else 0.4
    assert jumps or first < 1e-9 or second < order * first


# --------------------------------------------------------------------------- any cause


@pytest.mark.parametrize("name", MEAN_CAUSES)
def test_a_cause_vanishes_with_its_strength_and_shows_without(name: str) -> None:
    rig, highest = case(), CAUSES[name].highest
    ideal, off, weak, strong = (
        clean_signals(replace(rig, strengths=strengths))
        for strengths in ({}, {name: 0.0}, {name: 1e-3 * highest}, {name: highest})
    )
    assert all(np.array_equal(off[k], ideal[k]) for k in ideal)
    assert all(np.isfinite(strong[k]).all() for k in ideal)
    assert rms(strong, ideal) > 1e-4  # V
    # clocks and jumps move a steep signal: their effect grows like the root at worst
    assert rms(weak, ideal) < 0.1 * rms(strong, ideal)


@pytest.mark.parametrize("name", MEAN_CAUSES)
def test_a_cause_acts_in_the_place_that_it_names(name: str) -> None:
    def states(strengths: dict[str, float]) -> list[dict[str, FloatArray]]:
        found = []
        for rig in prepared_rigs(case(**strengths)):
            t = sample_times(rig.step)
            trace = rig.trace(t)
            parts = ("opening", "inlet", "flow", "gas", "x", "y")
            seen = {part: np.interp(t, trace.t, getattr(trace, part)) for part in parts}
            found.append({**seen, "record": rig.voltage(t)[0]})
        return found

    before = {
        "valve": (), "flow": ("opening",), "manifold": ("opening", "flow"),
        "sensor": ("opening", "inlet", "flow", "gas"),
        "readout": ("opening", "inlet", "flow", "gas", "x"),
        "electronics": ("opening", "inlet", "flow", "gas", "x"),
    }  # fmt: skip
    first = {
        "valve": ("opening",), "flow": ("inlet", "flow"), "manifold": ("gas",), "sensor": ("x",),
        "readout": ("y",), "electronics": ("record",),
    }  # fmt: skip
    place, acted = CAUSES[name].place, False
    for ideal, real in zip(states({}), states({name: CAUSES[name].highest}), strict=True):
        for part in before[place]:  # but for straight lines between other nodes
            assert np.abs(real[part] - ideal[part]).max() < 1e-4 * ideal[part].max(), part
        acted |= any(np.abs(real[p] - ideal[p]).max() > 1e-3 * ideal[p].max() for p in first[place])
    assert acted


@pytest.mark.parametrize("name", [name for name, cause in CAUSES.items() if cause.noise])
def test_a_noise_cause_leaves_the_mean_alone(name: str) -> None:
    rig = case(**{name: CAUSES[name].highest})
    ideal = without_causes(rig)
    for k, y in clean_signals(rig).items():
        assert np.array_equal(y, clean_signals(ideal)[k])
        assert not np.array_equal(make_campaign(rig)[k].y, make_campaign(ideal)[k].y)


@pytest.mark.parametrize(
    ("name", "phases", "least"),
    [
        ("closing_spring", "fall", 0.9),
        ("seat_creep", "rise plateau fall tail", 0.99),
        ("plunger_stroke", "rise fall", 0.95),
        ("bouncing_valve", "rise fall", 0.95),
        ("grain_in_seat", "fall tail", 0.999),
        ("flow_follows_valve", "rise fall", 0.95),
        ("controller_settling", "rise plateau", 0.95),
        ("emptying_bottle", "plateau fall", 0.95),
        ("soft_start", "rise plateau", 0.999),
        ("residue", "baseline onset rise plateau", 0.9),
        ("dead_leg", "fall tail", 0.999),
        ("trapped_plug", "onset rise", 0.95),
        ("slow_sites", "rise plateau fall tail", 0.99),
        ("mode_hop", "rise plateau fall", 0.99),
        ("range_change", "rise plateau fall", 0.99),
        ("clipped_range", "rise plateau fall", 0.99),
        ("held_readings", "rise fall", 0.95),
        ("warming_coil", "rise plateau fall", 0.95),
        ("pilot_stage", "rise plateau", 0.999),
        ("hunting_controller", "rise plateau fall", 0.999),
        ("pent_up_line", "rise plateau", 0.99),
        ("silicone_hose", "rise plateau fall tail", 0.999),
        ("fresh_coating", "rise plateau fall tail", 0.999),
        ("fringes", "rise plateau fall", 0.99),
        ("smoothed_export", "onset rise plateau fall", 0.95),
    ],
)
def test_causes_act_where_they_should(name: str, phases: str, least: float) -> None:
    shares = acting_places(case(**{name: 0.5 * CAUSES[name].highest}))
    assert sum(shares.values()) == pytest.approx(1.0)
    assert sum(v for (_, phase), v in shares.items() if phase in phases.split()) > least


def test_phases_follow_each_other() -> None:
    rig = case()
    for step in rig.steps:
        spans = phase_spans(rig, step)
        assert tuple(phase for phase, _, _ in spans) == simulator.PHASES
        assert spans[0][1] == 0.0 and spans[-1][2] == step.duration
        assert all(a[2] == b[1] for a, b in pairwise(spans))
        assert spans[2][1] == step.t0 and spans[4][1] == step.tf


def test_a_cause_draws_its_choices_from_the_seed_and_not_from_its_strength() -> None:
    # twice the strength of a drift that is linear in it is twice the drift
    rig = case()
    ideal, one, two = (
        clean_signals(replace(rig, strengths={"thermal_drift": s})) for s in (0.0, 0.02, 0.04)
    )
    for k in ideal:
        assert np.allclose(two[k] - ideal[k], 2.0 * (one[k] - ideal[k]), atol=1e-12)
    other = clean_signals(replace(rig, seed=12, strengths={"thermal_drift": 0.02}))
    assert not np.allclose(other["1"], one["1"])
    # what is drawn for one experiment is not what is drawn for all, or for another one
    cause = CAUSES["thermal_drift"]
    draws = [cause.generator(rig, *number).random() for number in ((), (1,), (2,))]
    assert len(set(draws)) == 3


def test_several_causes_act_in_the_rigs_order_whatever_theirs_is() -> None:
    strengths = {"mains_hum": 0.02, "thermal_drift": 0.05, "seat_creep": 0.1, "gated_pores": 0.5}
    forth = clean_signals(case(**strengths))
    back = clean_signals(case(**dict(reversed(strengths.items()))))
    assert all(np.array_equal(forth[k], back[k]) for k in forth)


def test_unknown_causes_are_refused() -> None:
    with pytest.raises(CampaignError, match="no cause 'gremlin'; there are closing_spring"):
        make_campaign(case(gremlin=1.0))


# --------------------------------------------------------------------------- single causes


def integrated(
    rig: Rig, right_side: Callable[[float, FloatArray], list[float]], n_states: int
) -> tuple[FloatArray, FloatArray]:
    """Samples (n,) and states (n, n_states) of x' = f(u, x), u the valve's command, from rest."""
    step = rig.step
    t, y = sample_times(step), np.zeros(n_states)
    states = np.zeros((len(t), n_states))
    edges = [0.0, step.t0, step.tf, step.duration]
    for (low, high), u in zip(pairwise(edges), (0.0, 1.0, 0.0), strict=True):
        inside = (t >= low) & (t < high)
        result = solve_ivp(
            lambda _, x, u=u: right_side(u, x), (low, high), y, method="DOP853", rtol=1e-10,
            atol=1e-12, dense_output=True, max_step=0.05,
        )  # fmt: skip
        states[inside] = result.sol(t[inside]).T
        y = result.y[:, -1]
    return t, states


def one_rig(k: int = 1, **strengths: float) -> Rig:
    """The rig of one experiment."""
    return prepared_rigs(case(**strengths))[k]


def closing(rig: Rig) -> Callable[[float, FloatArray], list[float]]:
    # the sign is the cause's own choice: whether the way down is slower
    trace = rig.trace(sample_times(rig.step))
    at = np.interp(rig.step.tf + 0.5 * rig.case.tau_v, trace.t, trace.opening)
    sign = 1.0 if at > np.exp(-0.5) else -1.0

    def f(u: float, x: FloatArray) -> list[float]:
        slower = 1.0 + sign * 0.4 * (0.6 + 0.8 * x[0]) if u < x[0] else 1.0
        return [(u - x[0]) / (rig.case.tau_v * max(0.05, slower))]

    return f


def heavy(rig: Rig) -> Callable[[float, FloatArray], list[float]]:
    kappa, tau = 0.4, rig.case.tau_v

    def f(u: float, x: FloatArray) -> list[float]:
        drag = x[1] * (1.0 + 0.25 * kappa * abs(x[1]))
        return [x[1] / tau, (u - x[0] - drag) / (kappa * tau)]

    return f


def creeping(rig: Rig) -> Callable[[float, FloatArray], list[float]]:
    time = np.exp(CAUSES["seat_creep"].generator(rig.case).uniform(np.log(2.0), np.log(8.0)))
    taus = (rig.case.tau_v, 0.6 * time, 1.6 * time)
    return lambda u, x: [(u - x[i]) / tau for i, tau in enumerate(taus)]


@pytest.mark.parametrize(
    ("name", "strength", "equations", "n", "seen"),
    [
        ("closing_spring", 0.4, closing, 1, lambda x: x[:, 0]),
        ("heavy_plunger", 0.4, heavy, 2, lambda x: x[:, 0]),
        ("seat_creep", 0.2, creeping, 3, lambda x: x @ [0.8, 0.1, 0.1]),
    ],
)
def test_valves_obey_their_equations(
    name: str, strength: float, equations: Any, n: int, seen: Any
) -> None:
    rig = one_rig(**{name: strength})
    t, states = integrated(rig, equations(rig), n)
    trace = rig.trace(t)
    assert np.abs(np.interp(t, trace.t, trace.opening) - seen(states)).max() < 3e-5


@pytest.mark.parametrize(("name", "highest"), [("wall_pockets", 0.3), ("back_mixing", 0.6)])
def test_divided_manifolds_hold_their_volume_and_lose_no_gas(name: str, highest: float) -> None:
    # the mean time through any vessel that lets everything out is its volume over the flow
    whole = {}
    for strength in (0.0, highest):
        rig = one_rig(**{name: strength})
        trace = rig.trace(sample_times(rig.step))
        on = (trace.t >= rig.step.t0) & (trace.t <= rig.step.tf)
        whole[strength] = np.trapezoid(1.0 - trace.gas[on], trace.t[on])
    assert whole[highest] == pytest.approx(whole[0.0], rel=1e-3)


def test_little_back_mixing_is_tanks_in_series() -> None:
    rig = case(back_mixing=0.9999)
    n = int(CAUSES["back_mixing"].generator(rig).integers(3, 7))
    # equal lags have no sum of exponentials: spread by a thousandth
    taus = rig.V / rig.steps[1].total_flow / n * (1.0 + 1e-2 * np.arange(n))
    trace = prepared_rigs(rig)[1].trace(sample_times(rig.steps[1]))
    expected = step_response(trace.t - rig.steps[1].t0, [*taus / taus.mean() * taus[0], rig.tau_v])
    before = trace.t < rig.steps[1].tf
    assert np.abs(trace.gas - expected)[before].max() < 2e-3


def test_langmuir_sites_obey_their_equation() -> None:
    K, rig = 1.0, one_rig(saturating_sites=1.0)
    tau, c, tau_v = rig.case.tau, rig.relative, rig.case.tau_v
    passage = rig.case.V / rig.step.total_flow

    def f(u: float, x: FloatArray) -> list[float]:
        gas = c * x[1]
        uptake = (gas * (1.0 - K * x[2]) - x[2]) / tau
        return [(u - x[0]) / tau_v, (x[0] - x[1]) / passage, uptake]

    t, states = integrated(rig, f, 3)
    y, _ = rig.voltage(t)
    expected = states[:, 2] * (1.0 + K * c) / c
    assert np.abs((y - rig.step.y0) / rig.step.beta - expected).max() < 3e-5


def test_a_layered_film_delays_by_its_share_on_the_whole() -> None:
    times, weights = layered_film(0.05)
    assert (times > 0).all() and weights.sum() == pytest.approx(1.0)
    assert times @ weights == pytest.approx(0.05)
    for strength in (0.5, 1.0):
        plain, layered = one_rig(), one_rig(layered_coating=strength)
        t = sample_times(plain.step)
        t = t[t < plain.step.tf]
        late = [np.trapezoid(1.0 - rig.voltage(t)[1], t) for rig in (plain, layered)]
        assert late[1] == pytest.approx(late[0], abs=1e-4)


def test_pores_that_open_under_load_are_faster_up_than_down() -> None:
    lags = {}
    for strength in (0.0, 0.5):
        rig = one_rig(gated_pores=strength)
        trace = rig.trace(sample_times(rig.step))
        behind, up = trace.gas - trace.x, (trace.t > rig.step.t0) & (trace.t < rig.step.tf)
        lags[strength] = [abs(np.trapezoid(behind[on], trace.t[on])) for on in (up, ~up)]
    assert lags[0.0] == pytest.approx([rig.tau, rig.tau], rel=2e-2)
    faster, slower = sorted(np.array(lags[0.5]) / np.array(lags[0.0]))
    # rates exp(0.5) times as high and as low, but for the ends, where the gates half close
    assert np.exp(-0.5) < faster < 0.7 and 1.5 < slower < np.exp(0.5)


def test_a_film_with_backlash_comes_back_on_another_line() -> None:
    rig = one_rig(sensor_hysteresis=0.3)
    trace = rig.trace(sample_times(rig.step))
    straight = one_rig().trace(sample_times(rig.step))
    moved = np.interp(trace.t, straight.t, straight.x) - trace.x
    rising = (trace.t > rig.step.t0 + 2.0) & (trace.t < rig.step.tf)
    assert moved[rising].min() == pytest.approx(0.3 * 0.25, abs=1e-3)
    assert moved[trace.t > rig.step.duration - 0.1].mean() == pytest.approx(-0.3 * 0.25, abs=1e-3)


def test_ageing_slows_the_sensor_down_from_experiment_to_experiment() -> None:
    taus = [rig.tau for rig in prepared_rigs(case(ageing_coating=0.2))]
    ratios = np.array(taus[1:]) / np.array(taus[:-1])
    assert taus[0] == case().tau
    assert np.allclose(np.abs(np.log(ratios)), np.log(1.2))


def test_a_flank_bends_and_keeps_both_ends() -> None:
    rig, plain = one_rig(lorentzian_flank=0.4), one_rig()
    y0, beta = rig.step.y0, rig.step.beta
    x = np.linspace(0.0, 1.0, 11)
    y = rig.readout(x, x)
    assert y[[0, -1]] == pytest.approx([y0, y0 + beta])
    assert np.abs(y - plain.readout(x, x)).max() > 0.01 * beta and (np.diff(y) > 0).all()


def test_a_filter_of_four_poles_delays_by_its_time() -> None:
    rig, k = case(anti_alias_filter=0.06), 1
    step = rig.steps[k]
    before = sample_times(step) < step.tf
    late = np.trapezoid(cascade(rig, k)[before] - clean_signals(rig)[step.name][before], dx=0.01)
    assert late == pytest.approx(0.06 * step.beta, rel=1e-2)


def test_ranges_readings_and_plateaus_are_cut_as_they_should() -> None:
    top = max(step.y0 + step.beta for step in case().steps)
    clipped = clean_signals(case(clipped_range=0.2))
    assert max(y.max() for y in clipped.values()) == pytest.approx(top - 0.2 * case().mean_step)
    held = clean_signals(case(held_readings=0.25))["2"]
    assert len(np.unique(held)) <= case().steps[1].duration / 0.25 + 2
    change = clean_signals(case(range_change=0.1))["2"] - clean_signals(case())["2"]
    gap = 0.1 * case().mean_step
    assert np.all((np.abs(change) < 1e-3) | (np.abs(np.abs(change) - gap) < 1e-3))


def test_a_mode_hop_dims_and_a_loose_plug_breaks_the_light_off() -> None:
    for name, strength in (("mode_hop", 0.1), ("loose_contact", 0.2)):
        real, ideal = clean_signals(case(**{name: strength})), clean_signals(case())
        changes = np.concatenate([real[k] / ideal[k] - 1.0 for k in ideal])
        sizes = Counter(np.round(np.abs(changes), 3))
        assert sizes[strength] > 20 and sizes[0.0] > 1000
        assert sizes[strength] + sizes[0.0] > 0.99 * len(changes)


def test_the_room_lamp_shines_for_a_while() -> None:
    rig = case(room_lamp=0.1)
    real, ideal = clean_signals(rig), clean_signals(case())
    lit = [np.flatnonzero(np.abs(real[k] - ideal[k]) > 1e-3) for k in ideal]
    assert any(len(samples) for samples in lit)
    for k, samples in zip(ideal, lit, strict=True):
        if len(samples):
            assert (np.diff(samples) == 1).all()  # one stretch
            light = (real[k] - ideal[k])[samples[1:-1]]
            assert (light > 0.045 * rig.mean_step).all()
            assert (light <= 0.1 * rig.mean_step + 1e-9).all() and (np.diff(light) > -1e-9).all()


def response_of(k: int, **strengths: float) -> tuple[FloatArray, FloatArray, FloatArray, Rig]:
    """Nodes (n,), normalised response (n,) and signal (n,) of one experiment."""
    rig = one_rig(k, **strengths)
    trace = rig.trace(sample_times(rig.step))
    return trace.t, trace.x, trace.y, rig


def test_a_pilot_lets_the_rest_of_the_stroke_wait_and_shuts_with_it() -> None:
    rig = one_rig(1, pilot_stage=0.3)
    t = np.unique(np.concatenate([sample_times(rig.step), rig.marks]))
    first, last = rig.command(t)
    middle, (wait,) = 0.5 * (t[1:] + t[:-1]), (rig.marks[0] - rig.step.t0,)
    assert np.array_equal(first, last) and set(np.round(np.unique(first), 9)) == {0.0, 0.7, 1.0}
    assert np.all(first[(middle > rig.step.t0) & (middle < rig.step.t0 + wait)] == 0.7)
    assert np.all(first[middle > rig.step.tf] == 0.0)


def test_a_pool_fills_and_empties_in_a_straight_line() -> None:
    t, _, _, rig = response_of(1, heavy_gas_pool=0.4)
    trace = rig.trace(sample_times(rig.step))
    stirred = one_rig(1).trace(sample_times(rig.step))
    gas = np.interp(trace.t, stirred.t, stirred.gas)
    pool = (trace.gas - 0.6 * gas) / 0.4
    slope = np.diff(pool) / np.diff(t)
    sinks = (t[1:] > rig.step.tf + 0.3) & (pool[1:] > gas[1:] + 0.02)
    assert sinks.sum() > 20 and np.ptp(slope[sinks]) < 1e-2 * abs(slope[sinks].mean())
    assert slope[sinks].mean() < 0.0


def test_a_fresh_coating_keeps_gas_in_the_first_experiment_alone() -> None:
    kept = [response_of(k, fresh_coating=0.2)[1][-1] for k in range(3)]
    assert 0.05 < kept[0] < 0.201 and max(abs(x) for x in kept[1:]) < 1e-3


def test_water_comes_back_and_a_capacitor_leaks_the_level_away() -> None:
    wet, dry = response_of(1, driven_out_water=0.3), response_of(1)
    assert np.interp(wet[3].step.tf, wet[0], wet[1]) < np.interp(wet[3].step.tf, *dry[:2]) - 0.1
    t, _, y, rig = response_of(1, coupling_capacitor=1.0)
    plateau = y[(t > rig.step.t0 + 6.0) & (t < rig.step.tf)]
    assert np.all(np.diff(plateau) < 0.0) and y[-1] < rig.step.y0 - 0.05 * rig.step.beta


def test_an_export_is_a_running_mean_that_knows_what_comes() -> None:
    width = 0.4
    rig, plain = one_rig(1, smoothed_export=width), one_rig(1)
    t = np.arange(0.0, rig.step.duration, 1e-3)
    y, smooth = plain.voltage(t)[0], rig.voltage(t)[0]
    expected = np.convolve(y, np.ones(401) / 401, "same")
    inside = (t > 1.0) & (t < rig.step.duration - 1.0)
    # the mean of samples has half an interval at either end too much
    assert np.abs(smooth - expected)[inside].max() < 2e-3 * rig.step.beta
    before = int(np.searchsorted(t, rig.step.t0)) - 20
    assert smooth[before] > y[before] + 1e-4 * rig.step.beta


def test_a_fibre_sways_in_one_experiment_at_least_and_fringes_pass_with_the_signal() -> None:
    rig = case(swaying_fibre=0.2)
    moved = clean_signals(rig)
    ideal = clean_signals(without_causes(rig))
    assert any(np.abs(moved[k] - ideal[k]).max() > 0.02 * rig.mean_step for k in ideal)
    t, x, y, one = response_of(1, fringes=0.1)
    left = (y - one.step.y0 - one.step.beta * x) / one.case.mean_step
    turns = np.count_nonzero(np.diff(np.sign(np.diff(left[(t > one.step.t0) & (x < 0.999)]))))
    assert turns >= 1 and np.abs(left).max() < 0.2 + 1e-9


# --------------------------------------------------------------------------- campaigns


def test_a_case_makes_the_same_campaign_again_and_survives_json() -> None:
    rig = case(wall_pockets=0.1, mains_hum=0.02)
    again = Case.from_json(rig.to_json())
    assert again == rig
    one, two = make_campaign(rig), make_campaign(again)
    for a, b in zip(one, two, strict=True):
        assert np.array_equal(a.values, b.values)
        assert np.allclose(a.values / rig.lsb, np.rint(a.values / rig.lsb), atol=1e-6)
    other = make_campaign(replace(rig, seed=rig.seed + 1))
    assert not np.array_equal(other["1"].values, one["1"].values)


def test_the_recipe_of_the_withheld_campaign_makes_its_recordings() -> None:
    rig = Case.from_json(read_json(WITHHELD / "sealed.json")["recipe"])
    recorded = read_campaign(WITHHELD / "campaign.toml")
    for made, kept in zip(make_campaign(rig), recorded, strict=True):
        # the recordings hold counts of the converter as single-precision floats
        assert np.abs(made.values - kept.values).max() < 0.01 * rig.lsb


def test_a_case_needs_experiments_and_positive_parameters() -> None:
    with pytest.raises(CampaignError, match="expected at least one experiment and positive tau"):
        replace(case(), steps=())
    with pytest.raises(CampaignError, match="got 3 experiments, 0.0 s"):
        replace(case(), tau=0.0)


def test_lost_samples_shift_what_the_recorder_calls_the_time() -> None:
    rig = draw_case(22, {"lost_samples": 1.0}, size="small")
    seen = as_recorded(rig)
    late = 0.0
    for e, true, step in zip(make_campaign(rig), rig.steps, seen.steps, strict=True):
        assert (e.commanded_on, e.commanded_off) == (step.commanded_on, step.commanded_off)
        assert step.commanded_on < step.t0 < step.commanded_off < step.tf < step.duration
        assert step.t0 == pytest.approx(true.t0, abs=2e-3)  # nothing is lost before
        assert true.tf - step.tf > -2e-3
        late = max(late, true.tf - step.tf)
    assert 0.4 < late <= 1.002
    ideal = without_causes(rig)
    assert as_recorded(ideal) == ideal


def test_parameters_are_drawn_afresh() -> None:
    some = [draw_case(seed, size="varied") for seed in range(12)]
    assert len({len(rig.steps) for rig in some}) > 2
    assert len({rig.steps[0].interval for rig in some}) > 1
    assert np.std(np.log([rig.tau for rig in some])) > 0.2
    for rig in some:
        assert rig.tau < rig.tau_v
        flows = [step.total_flow for step in rig.steps]
        assert max(flows) > 1.6 * min(flows)
    with pytest.raises(CampaignError, match="expected one of paper, varied, small"):
        draw_case(1, size="huge")


def test_seven_experiments_of_two_minutes_at_a_millisecond_take_less_than_two_seconds() -> None:
    strengths = {"flow_follows_valve": 1.0, "slow_sites": 0.1, "layered_coating": 1.0}
    make_campaign(case(**strengths))  # compile
    begin = time.process_time()
    campaign = make_campaign(draw_case(2, strengths))
    assert time.process_time() - begin < 2.0
    assert campaign.n_samples == 840_000
