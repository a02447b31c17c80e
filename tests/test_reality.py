"""The independent reality against closed forms, an ODE solver and its own promises."""

from __future__ import annotations

import ast
import sys
import time
from collections.abc import Iterator, Sequence
from dataclasses import replace
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.linalg import solve_toeplitz
from scipy.signal import lfilter, welch
from scipy.special import erf, erfc, erfcx, j0

import bayes_sensor.reality as reality
from bayes_sensor.campaign import CampaignError, FloatArray
from bayes_sensor.reality import (
    CAUSES,
    HEAVY_TAILED,
    OPEN_LAWS,
    RESERVE_LAWS,
    Case,
    Component,
    NoiseLaw,
    Step,
    acting_places,
    autocorrelation,
    clean_signals,
    draw_case,
    draw_law,
    make_campaign,
    phase_edges,
    sample_times,
    without_causes,
)
from bayes_sensor.reality.noise import draw_noise
from bayes_sensor.reality.rig import Course, Knobs, centre_of_mass, dip, voltage
from bayes_sensor.reality.simulator import prepared_rig
from bayes_sensor.reality.stages import (
    blanked,
    blind,
    burning,
    capillary,
    decades,
    envelope,
    glassy,
    islands,
    kept,
    laminar,
    layered_film,
    log_amplifier,
    looped,
    modal,
    moving_fronts,
    oscillating_lag,
    overloaded,
    parabola,
    pit,
    retarded,
    slab,
    splitting,
    windowed_average,
)

CONTRACT_NAMES = (
    "flow_switching valve_asymmetry valve_second_order two_rate_valve finite_stroke dead_volume "
    "axial_dispersion flow_settling flow_error sensor_diffusion sorption_asymmetry slow_sorption "
    "optical_nonlinearity baseline_drift baseline_step gain_drift carry_over mains_pickup "
    "daq_filter heavy_tails quantisation"
).split()
MEAN_CAUSES = [name for name, cause in CAUSES.items() if not cause.noise]


def case(**strengths: float) -> Case:
    """A small rig, the same for every call."""
    return replace(draw_case(11, size="small"), strengths=strengths)


def offsets(rig: Case, atol: float) -> Iterator[tuple[Step, Course]]:
    """Every step with an offset of its own, which is what is added to the signal, to ``atol`` V.

    The other steps' signals must be those without the cause.
    """
    seen, plain = clean_signals(rig), clean_signals(without_causes(rig))
    for step in rig.steps:
        courses = prepared_rig(rig)[step.name].offset
        if courses:
            added = courses[0](sample_times(step))
            assert np.allclose(seen[step.name] - plain[step.name], added, atol=atol)
            yield step, courses[0]
        else:
            assert np.array_equal(seen[step.name], plain[step.name])


def on_its_clock(rig: Case) -> Iterator[tuple[Step, FloatArray, FloatArray]]:
    """Every step with the times (n,) s that its record bears and those when it was measured."""
    for step in rig.steps:
        clock = prepared_rig(rig)[step.name].clock
        assert clock is not None
        t = sample_times(step)
        yield step, t, clock(t)


def solved(
    rig: Case, right_side, n_states: int, k: int = 0, inputs: Sequence[tuple[float, Any]] = ()
) -> tuple[FloatArray, FloatArray]:
    """Times and states of an ODE that scipy solves piece by piece between the switches.

    ``inputs``: (s from which it holds, what ``right_side`` is given) of every piece; the valve's
    command if there are none.
    """
    step = rig.steps[k]
    t = sample_times(step)
    states = np.zeros((len(t), n_states))
    y = np.zeros(n_states)
    inputs = inputs or [(0.0, 0.0), (step.t0, 1.0), (step.tf, 0.0)]
    edges = [at for at, _ in inputs] + [step.duration]
    for low, high, u in zip(edges[:-1], edges[1:], [u for _, u in inputs], strict=True):
        inside = (t >= low) & (t < high)
        result = solve_ivp(
            lambda s, x, u=u: right_side(u, x), (low, high), y, method="DOP853", rtol=1e-10,
            atol=1e-12, dense_output=True, max_step=0.05,
        )  # fmt: skip
        states[inside] = result.sol(t[inside]).T
        y = result.y[:, -1]
    return t, states


# --------------------------------------------------------------------------- independence


def test_reality_imports_nothing_but_the_campaign_and_numerics() -> None:
    allowed = {"bayes_sensor.campaign", "bayes_sensor.reality", "numpy", "scipy", "numba"}
    files = sorted(Path(reality.__file__).parent.rglob("*.py"))
    assert len(files) >= 5
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
                parts = name.split(".")
                root = ".".join(parts[:2]) if parts[0] == "bayes_sensor" else parts[0]
                seen.add(root)
                assert root in allowed or root in sys.stdlib_module_names, (
                    f"{file.name}:{node.lineno}: {name}"
                )
    assert "bayes_sensor.campaign" in seen  # the walk did look at imports


def test_every_effect_of_the_catalogue_has_a_counterpart_and_many_causes_have_no_name() -> None:
    listed = {name for cause in CAUSES.values() for name in cause.listed_as}
    assert listed == set(CONTRACT_NAMES)
    unlisted = [cause for cause in CAUSES.values() if not cause.listed]
    assert len(unlisted) >= 10
    assert len([cause for cause in unlisted if not cause.reserve]) >= 8
    assert len([cause for cause in unlisted if cause.reserve]) == 8
    assert not any(cause.reserve for cause in CAUSES.values() if cause.listed)
    assert (len(OPEN_LAWS), len(RESERVE_LAWS)) == (50, 3)
    assert not set(OPEN_LAWS) & set(RESERVE_LAWS)
    assert all(cause.turn.__doc__ for cause in CAUSES.values())


# --------------------------------------------------------------------------- nothing wrong


@pytest.mark.parametrize("size", ["paper", "varied", "small"])
def test_with_nothing_wrong_it_is_the_cascade(size: str) -> None:
    rig = draw_case(4, size=size)
    step = rig.steps[1]
    taus = rig.tau_v, rig.V / step.total_flow, rig.tau

    def cascade(u: float, x: FloatArray) -> list[float]:
        return [(u - x[0]) / taus[0], (x[0] - x[1]) / taus[1], (x[1] - x[2]) / taus[2]]

    _, states = solved(rig, cascade, 3, k=1)
    y = clean_signals(rig)[step.name]
    # the stated tolerance is 1e-4; straight lines between nodes leave a few 1e-6
    assert np.abs((y - step.y0) / step.beta - states[:, 2]).max() < 1e-5


def test_nodes_may_be_few() -> None:
    # the oracle asks for a few hundred times only: same values as on the full grid
    rig = case(flow_follows_valve=1.0, slow_sites=0.1, lorentzian_flank=0.5)
    full = clean_signals(rig)
    for step in rig.steps:
        t = sample_times(step)
        few = t[:: len(t) // 211]
        y = clean_signals(rig, {s.name: few if s is step else t for s in rig.steps})[step.name]
        assert np.abs(y - np.interp(few, t, full[step.name])).max() < 2e-5 * step.beta


# --------------------------------------------------------------------------- causes


@pytest.mark.parametrize("name", MEAN_CAUSES)
def test_a_cause_vanishes_with_its_strength_and_shows_without(name: str) -> None:
    rig, highest = case(), CAUSES[name].highest
    ideal = clean_signals(rig)
    off = clean_signals(replace(rig, strengths={name: 0.0}))
    weak = clean_signals(replace(rig, strengths={name: 1e-3 * highest}))
    strong = clean_signals(replace(rig, strengths={name: highest}))
    assert all(np.array_equal(off[k], ideal[k]) for k in ideal)
    assert all(np.isfinite(strong[k]).all() for k in ideal)

    def rms(other: dict[str, FloatArray]) -> float:
        return float(np.sqrt(np.mean([np.mean((other[k] - ideal[k]) ** 2) for k in ideal])))

    assert rms(strong) > 1e-4  # V
    # clocks and jumps of time move a steep signal: their effect grows like the root at worst
    assert rms(weak) < 0.1 * rms(strong)


@pytest.mark.parametrize("name", [name for name, cause in CAUSES.items() if cause.noise])
def test_a_noise_cause_leaves_the_mean_alone(name: str) -> None:
    rig = case(**{name: CAUSES[name].highest})
    ideal = without_causes(rig)
    for k, y in clean_signals(rig).items():
        assert np.array_equal(y, clean_signals(ideal)[k])
        assert not np.array_equal(make_campaign(rig)[k].y, make_campaign(ideal)[k].y)


def test_a_cause_draws_its_shape_from_the_seed_and_not_from_its_strength() -> None:
    # twice the strength of a drift that is linear in it is twice the drift
    rig = case()
    ideal = clean_signals(rig)
    one = clean_signals(replace(rig, strengths={"thermal_drift": 0.02}))
    two = clean_signals(replace(rig, strengths={"thermal_drift": 0.04}))
    for k in ideal:
        assert np.allclose(two[k] - ideal[k], 2.0 * (one[k] - ideal[k]), atol=1e-12)
    other = clean_signals(replace(rig, seed=12, strengths={"thermal_drift": 0.02}))
    assert not np.allclose(other["1"], one["1"])


def test_unknown_causes_are_refused() -> None:
    with pytest.raises(CampaignError, match="no cause 'gremlin'; there are flow_follows_valve"):
        make_campaign(case(gremlin=1.0))


def test_flow_that_follows_the_valve_against_an_ode_solver() -> None:
    rig = case()
    step = rig.steps[0]
    share = 0.7

    def rig_with_flow(u: float, x: FloatArray) -> list[float]:
        made_up = (1.0 - share) * step.test_gas_flow * (1.0 - x[0])
        flow = step.carrier_flow + step.test_gas_flow * x[0] + made_up
        inlet = step.test_gas_flow * x[0] / flow / step.concentration
        return [(u - x[0]) / rig.tau_v, flow / rig.V * (inlet - x[1]), (x[1] - x[2]) / rig.tau]

    t, states = solved(rig, rig_with_flow, 3)
    _, x = voltage(rig, step, Knobs(following=share, mixing=True), t)
    assert np.abs(x - states[:, 2]).max() < 2e-5


def test_pockets_back_mixing_mass_gates_and_site_kinetics_against_an_ode_solver() -> None:
    rig = case()
    step = rig.steps[0]
    q, V, relative = step.total_flow, rig.V, rig.relative_concentration(step)
    f, e = np.array([0.15, 0.05]), np.array([3.0, 0.6])

    def with_pockets(u: float, x: FloatArray) -> list[float]:
        main = V * (1.0 - f.sum())
        into = e @ (x[2:4] - x[1])
        pocket = e * (x[1] - x[2:4]) / (f * V)
        gas = (q * (x[0] - x[1]) + into) / main
        return [(u - x[0]) / rig.tau_v, gas, *pocket, (x[1] - x[4]) / rig.tau]

    t, states = solved(rig, with_pockets, 5)
    knobs = Knobs(pocket_fractions=tuple(f), pocket_exchange=tuple(e))
    assert np.abs(voltage(rig, step, knobs, t)[1] - states[:, 4]).max() < 2e-5

    def with_cells(u: float, x: FloatArray) -> list[float]:
        rate, back = 3 * q / V, 1.5
        c = x[1:4]
        flows = [
            x[0] - c[0] + back * (c[1] - c[0]),
            (1 + back) * (c[0] - c[1]) + back * (c[2] - c[1]),
            (1 + back) * (c[1] - c[2]),
        ]
        return [(u - x[0]) / rig.tau_v, *(rate * np.array(flows)), (c[2] - x[4]) / rig.tau]

    t, states = solved(rig, with_cells, 5)
    assert (
        np.abs(voltage(rig, step, Knobs(back_flow=1.5, n_cells=3), t)[1] - states[:, 4]).max()
        < 2e-5
    )

    def with_mass(u: float, x: FloatArray) -> list[float]:
        drag = x[1] * (1.0 + 0.25 * 0.2 * abs(x[1]))
        speed = (u - x[0] - drag) / (0.2 * rig.tau_v)
        return [x[1] / rig.tau_v, speed, q / V * (x[0] - x[2]), (x[2] - x[3]) / rig.tau]

    t, states = solved(rig, with_mass, 4)
    assert np.abs(voltage(rig, step, Knobs(inertia=0.2), t)[1] - states[:, 3]).max() < 2e-5

    def with_gates(u: float, x: FloatArray) -> list[float]:
        rate = np.exp(0.8 * np.tanh((x[1] - x[2]) / 0.05)) / rig.tau
        return [(u - x[0]) / rig.tau_v, q / V * (x[0] - x[1]), rate * (x[1] - x[2])]

    t, states = solved(rig, with_gates, 3)
    assert np.abs(voltage(rig, step, Knobs(gate=0.8), t)[1] - states[:, 2]).max() < 5e-5

    def with_sites(u: float, x: FloatArray) -> list[float]:
        K, g = 2.0, relative * x[1]
        sites = (g * (1.0 - K * x[2]) - x[2]) / rig.tau
        return [(u - x[0]) / rig.tau_v, q / V * (x[0] - x[1]), sites]

    t, states = solved(rig, with_sites, 3)
    seen = states[:, 2] / (1.0 - 2.0 * states[:, 2]) / relative
    assert np.abs(voltage(rig, step, Knobs(langmuir=2.0), t)[1] - seen).max() < 5e-5
    bent = states[:, 2] * (1.0 + 2.0 * relative) / relative
    assert np.abs(voltage(rig, step, Knobs(langmuir=2.0, curved=True), t)[1] - bent).max() < 5e-5


def test_layers_and_valve_speed_against_an_ode_solver() -> None:
    rig = case()
    step = rig.steps[0]
    q, V = step.total_flow, rig.V

    def with_layers(u: float, x: FloatArray) -> list[float]:
        gas = q / V * (x[0] - x[1]) / (1.0 + 1.7 * x[1])
        return [(u - x[0]) / (1.4 * rig.tau_v), gas, (x[1] - x[2]) / rig.tau]

    t, states = solved(rig, with_layers, 3)
    knobs = Knobs(layering=1.7, valve_factor=1.4)
    assert np.abs(voltage(rig, step, knobs, t)[1] - states[:, 2]).max() < 5e-5


def test_the_servo_ranges_and_fringes_do_what_they_say() -> None:
    rig = case()
    step = rig.steps[0]
    t = sample_times(step)
    plain, x = voltage(rig, step, Knobs(), t)

    def with_servo(u: float, z: FloatArray) -> list[float]:
        cascade = [(u - z[0]) / rig.tau_v, step.total_flow / rig.V * (z[0] - z[1])]
        return [*cascade, (z[1] - z[2]) / rig.tau, (z[2] - z[3]) / 20.0]

    _, states = solved(rig, with_servo, 4)
    pulled, _ = voltage(rig, step, Knobs(servo=0.2, servo_time=20.0), t)
    signal = (pulled - step.y0) / step.beta
    assert np.abs(signal - (states[:, 2] - 0.2 * states[:, 3])).max() < 2e-5
    assert signal[-1] < -0.01  # what was pulled off the plateau shows below the baseline

    up, down = step.y0 + 0.6 * step.beta, step.y0 + 0.4 * step.beta
    shown, _ = voltage(rig, step, Knobs(range_up=up, range_down=down, range_gap=0.05), t)
    upper = shown - plain > 0.025
    assert np.allclose(shown - plain, np.where(upper, 0.05, 0.0), atol=1e-12)
    rising, falling = np.flatnonzero(np.diff(upper.astype(int)))
    assert plain[rising] <= up < plain[rising + 1] and t[rising] < step.tf
    assert plain[falling] >= down > plain[falling + 1] and t[falling] > step.tf

    knobs = Knobs(fringe=0.03, fringe_turns=1.5, fringe_phase=lambda s: 0.1 + 0.02 * s)
    fringes = voltage(rig, step, knobs, t)[0] - plain
    assert np.allclose(fringes, 0.03 * np.sin(2 * np.pi * (1.5 * x + 0.1 + 0.02 * t)), atol=1e-9)


def test_dropped_valves_plugs_and_sites_that_keep_against_an_ode_solver() -> None:
    rig = case()
    step = rig.steps[0]
    q, V = step.total_flow, rig.V
    at, lasts = 0.5 * (step.t0 + step.tf), 0.7
    pushed, plug = step.t0 - 0.3, 1.5  # mL/s of test gas, until t0

    def with_both(u: tuple[float, float], x: FloatArray) -> list[float]:
        inlet = x[0] + u[1] / q / step.concentration
        return [(u[0] - x[0]) / rig.tau_v, q / V * (inlet - x[1]), (x[1] - x[2]) / rig.tau, x[2]]

    inputs = [
        (0.0, (0.0, 0.0)), (pushed, (0.0, plug)), (step.t0, (1.0, 0.0)), (at, (0.0, 0.0)),
        (at + lasts, (1.0, 0.0)), (step.tf, (0.0, 0.0)),
    ]  # fmt: skip
    t, states = solved(rig, with_both, 4, inputs=inputs)
    knobs = Knobs(
        dropped=[(at, lasts)], seep=[lambda s: plug * ((s >= pushed) & (s < step.t0))],
        bound=0.1, bound_time=7.0, marks=[pushed - 1e-6, pushed, step.t0 - 1e-6],
    )  # fmt: skip
    kept = 0.1 * (1.0 - np.exp(-states[:, 3] / 7.0))
    assert np.abs(voltage(rig, step, knobs, t)[1] - states[:, 2] - kept).max() < 5e-5
    assert kept[-1] > 0.05  # still there at the end of the record


def test_a_dead_leg_gives_off_what_diffuses_out_of_a_blind_branch() -> None:
    rig = case(dead_leg=0.1)
    step = rig.steps[0]
    (out,) = prepared_rig(rig)[step.name].seep
    since = np.concatenate([[0.0], np.geomspace(1e-4, 400.0, 4000)])
    flux = out(step.tf + since)
    given = np.concatenate([[0.0], np.cumsum(0.5 * (flux[1:] + flux[:-1]) * np.diff(since))])
    assert 0.85 * 0.1 * rig.V < given[-1] < 0.1 * rig.V
    # finite volumes of a branch of unit length that starts full: the same decline of what is left
    n = 200
    matrix = np.diag(np.full(n, -2.0)) + np.diag(np.ones(n - 1), 1) + np.diag(np.ones(n - 1), -1)
    matrix[0, 0], matrix[-1, -1] = -3.0, -1.0
    rates, modes = np.linalg.eigh(matrix * n**2)
    start = modes.T @ np.ones(n)

    def left(time: float) -> float:
        return float(np.mean(modes @ (np.exp(rates * time) * start)))

    half = float(np.interp(0.5 * given[-1], given, since))
    tenth = float(np.interp(0.9 * given[-1], given, since))
    times = np.linspace(0.01, 2.0, 4000)
    shares = np.array([left(s) for s in times]) / left(0.01)
    expected = [np.interp(-share, -shares, times) - 0.01 for share in (0.5, 0.1)]
    assert tenth / half == pytest.approx(expected[1] / expected[0], rel=0.02)


def test_the_lock_the_holder_and_the_contact_do_what_they_say() -> None:
    rig = case()
    step = rig.steps[0]
    t = sample_times(step)
    plain, _ = voltage(rig, step, Knobs(), t)
    fastest = 0.5 * float(np.abs(np.diff(plain)).max()) / step.interval
    slow, _ = voltage(rig, step, Knobs(fastest=fastest), t)
    speed = np.diff(slow) / step.interval
    assert np.abs(speed).max() == pytest.approx(fastest, rel=1e-6)
    behind = np.abs(slow - plain) > 1e-6 * step.beta
    # it runs at full speed for as long as it is behind, towards where it should be
    both = behind[:-1] & behind[1:]
    assert both.sum() > 20
    ahead = np.sign(plain - slow)[:-1][both]
    assert np.allclose(speed[both], ahead * fastest, rtol=1e-3)

    held, _ = voltage(rig, step, Knobs(hold=0.25, hold_begin=0.1), t)
    readings = (np.arange(-1, 1 + step.duration / 0.25)) * 0.25 + 0.1
    last = np.searchsorted(readings, t + 1e-9) - 1
    expected = np.interp(np.maximum(readings[last], 0.0), t, plain)
    inside = np.abs(t - readings[last]) > 1e-6  # on a reading rounding decides which one it is
    # straight lines between samples 10 ms apart instead of the response itself
    assert np.abs(held - expected)[inside].max() < 1e-3 * step.beta

    loose = clean_signals(case(loose_contact=0.1))[step.name]
    broken = np.abs(loose - plain) > 0.05 * np.abs(plain)
    assert np.allclose(loose, np.where(broken, 0.9, 1.0) * plain, rtol=1e-4)
    assert 0.0 < broken.mean() < 0.3
    swings = clean_signals(case(thermostat_swings=0.05))[step.name] - plain
    size = 0.05 * np.mean([each.beta for each in rig.steps])
    assert np.abs(swings).max() == pytest.approx(size, rel=0.05)
    turns = np.flatnonzero(np.diff(np.sign(np.diff(swings))))
    assert len(turns) >= 2


def test_sagging_carrier_weeping_valve_and_flipping_cages_against_an_ode_solver() -> None:
    rig = case()
    step = rig.steps[0]
    carrier, test, V = step.carrier_flow, step.test_gas_flow, rig.V
    relative = rig.relative_concentration(step)
    at, lasts = 0.5 * (step.t0 + step.tf), 1.1

    def with_sag(u: tuple[float, float], x: FloatArray) -> list[float]:
        flow = u[1] * carrier + test
        inlet = x[0] * test / flow / step.concentration
        return [(u[0] - x[0]) / rig.tau_v, flow / V * (inlet - x[1]), (x[1] - x[2]) / rig.tau]

    inputs = [
        (0.0, (0.0, 1.0)), (step.t0, (1.0, 1.0)), (at, (1.0, 0.7)), (at + lasts, (1.0, 1.0)),
        (step.tf, (0.0, 1.0)),
    ]  # fmt: skip
    t, states = solved(rig, with_sag, 3, inputs=inputs)
    knobs = Knobs(
        carrier=[lambda s: np.where((s >= at) & (s < at + lasts), 0.7, 1.0)],
        marks=[at - 1e-6, at, at + lasts - 1e-6, at + lasts],
    )
    assert np.abs(voltage(rig, step, knobs, t)[1] - states[:, 2]).max() < 5e-5
    assert states[:, 2].max() > 1.1  # less carrier, more concentration

    def with_leak(u: tuple[float, float], x: FloatArray) -> list[float]:
        q = carrier + test
        inlet = x[0] - 0.1 * test / q / step.concentration * u[1] * x[3]
        gas = q / V * (inlet - x[1])
        return [(u[0] - x[0]) / rig.tau_v, gas, (x[1] - x[2]) / rig.tau, (1.0 - u[1] - x[3]) / 3.0]

    # the fourth state is how far the pressure is from where it creeps to; before, it is there
    inputs = [(0.0, (0.0, 1.0)), (step.t0, (1.0, 0.0)), (step.tf, (0.0, 1.0))]
    t, states = solved(rig, with_leak, 4, inputs=inputs)
    full = states[t < step.tf][-1, 3]
    leak = 0.1 * test * full

    def missing(s: FloatArray) -> FloatArray:
        return np.where(s > step.tf, -leak * np.exp(-np.maximum(s - step.tf, 0.0) / 3.0), 0.0)

    assert np.abs(voltage(rig, step, Knobs(seep=[missing]), t)[1] - states[:, 2]).max() < 1e-4
    assert states[:, 2].min() < -0.02  # below the leak that y0 holds
    wept = prepared_rig(case(creeping_regulator=0.1))[step.name].seep[0](t)
    after = wept[t > step.tf]
    assert np.all(wept[t <= step.tf] == 0) and after[0] == pytest.approx(-0.1 * test, rel=0.01)
    log = np.log(-after)
    assert np.ptp(np.diff(log)) < 1e-9 and 2.0 < -0.01 / np.diff(log)[0] < 15.0

    def with_cages(u: float, x: FloatArray) -> list[float]:
        def share(c: float) -> float:
            return 1.0 / (1.0 + np.exp((0.3 - c) / 0.06))

        open_ = (share(relative * x[1]) - share(0.0)) / (1.0 - share(0.0))
        cascade = [(u - x[0]) / rig.tau_v, (carrier + test) / V * (x[0] - x[1])]
        return [*cascade, (x[1] - x[2]) / rig.tau, (open_ - x[3]) / 0.9]

    t, states = solved(rig, with_cages, 4)
    knobs = Knobs(cages=0.2, cages_at=0.3, cages_width=0.06, cages_time=0.9)
    seen = states[:, 2] + 0.2 / relative * states[:, 3]
    assert np.abs(voltage(rig, step, knobs, t)[1] - seen).max() < 5e-5
    # an experiment that stays far below the threshold sees nothing of it
    beyond = replace(knobs, cages_at=2.0 * relative, cages_width=0.02)
    assert np.abs(voltage(rig, step, beyond, t)[1] - states[:, 2]).max() < 1e-4


def test_exhaust_that_returns_is_the_whole_response_again_late_and_blurred() -> None:
    rig = case()
    step = rig.steps[0]
    delay, blur, share = 3.3, 0.8, 0.2

    def once_more(u: float, x: FloatArray) -> list[float]:
        passage = rig.V / step.total_flow
        first = [(u - x[0]) / rig.tau_v, (x[0] - x[1]) / passage, (x[1] - x[2]) / blur]
        return [*first, (x[2] - x[3]) / passage, (x[3] - x[4]) / rig.tau]

    inputs = [(0.0, 0.0), (step.t0 + delay, 1.0), (step.tf + delay, 0.0)]
    t, states = solved(rig, once_more, 5, inputs=inputs)
    plain = voltage(rig, step, Knobs(), t)[1]
    knobs = Knobs(returned=share, return_delay=delay, return_time=blur)
    seen = voltage(rig, step, knobs, t)[1] - plain
    expected = share * step.carrier_flow / step.total_flow * states[:, 4]
    assert np.abs(seen - expected).max() < 5e-5
    assert expected.max() > 0.1


def test_draughts_of_carrier_recover_and_sweeps_of_the_laser_come_back() -> None:
    rig = case(shared_nitrogen=0.3)
    found = prepared_rig(rig)
    drawn = 0
    for step in rig.steps:
        t = sample_times(step)
        for course in found[step.name].carrier:
            factor = course(t)
            first = min(found[step.name].marks)
            assert np.all(factor[t <= first] == 1.0) and step.t0 < first < step.tf
            assert 1.0 - 2.0 * 0.3 <= factor.min() < 0.95 and factor.max() == 1.0
            assert course(np.array([1e3])) == pytest.approx(1.0)
            drawn += 1
    assert drawn >= 1

    rig = case(relocking_laser=0.1)
    found = prepared_rig(rig)
    swept = clean_signals(rig)
    for step in rig.steps:
        t, marks = sample_times(step), found[step.name].marks
        plain, x = voltage(rig, step, Knobs(), t)
        stray = np.sum([course(t) for course in found[step.name].wander], axis=0)
        detuning, reach = Knobs().detuning, 0.3 * rig.relative_concentration(step)
        at = detuning + reach * x
        read = (dip(at + stray) - dip(at)) / (dip(detuning + reach) - dip(detuning))
        assert np.allclose(swept[step.name] - plain, step.beta * read, atol=1e-3 * step.beta)
        begins, middles, ends = (np.array(marks[i::3]) for i in range(3))
        outside = np.all([(t <= a) | (t >= b) for a, b in zip(begins, ends, strict=True)], axis=0)
        assert np.all(stray[outside] == 0.0) and outside.any() and not outside.all()
        for course, middle in zip(found[step.name].wander, middles, strict=True):
            assert 0.05 <= abs(float(course(np.array([middle]))[0])) <= 0.1


def test_the_swinging_column_obeys_its_length_and_stops() -> None:
    strength = 0.05
    rig = case(swinging_column=strength)
    seen, plain = clean_signals(rig), clean_signals(without_causes(rig))
    largest = max(step.test_gas_flow for step in rig.steps)
    for step in rig.steps:
        t = sample_times(step)
        (course,) = prepared_rig(rig)[step.name].concentration_gain
        swing = course(t)
        expected = (plain[step.name] - step.y0) * (1.0 + swing) + step.y0
        assert np.allclose(seen[step.name], expected, atol=2e-4 * step.beta)
        assert np.all(swing[t <= step.t0] == 0.0)
        assert np.abs(swing).max() <= strength * step.test_gas_flow / largest
        fine = step.t0 + np.linspace(1e-3, step.tf - step.t0 - 1e-3, 400_001)
        free = course(fine)
        turns = fine[1:][np.diff(np.sign(free)) != 0]
        half = np.diff(turns)
        assert np.ptp(half) < 1e-3  # damped, its period stays
        length = 2.0 * 9.81 * (half.mean() / np.pi) ** 2
        assert 0.2 < length < 0.8
        peaks = [np.abs(free[(fine > a) & (fine < b)]).max() for a, b in pairwise(turns)]
        decay = -half.mean() / np.diff(np.log(peaks))
        assert np.ptp(decay) < 0.02 * decay.mean() and 1.5 < decay.mean() < 8.0


def test_the_drivers_warmth_is_two_lags_of_the_command() -> None:
    rig = case(warm_driver=0.08)
    size = 0.08 * np.mean([step.beta for step in rig.steps])
    seen, plain = clean_signals(rig), clean_signals(without_causes(rig))
    peaks = []
    for k, step in enumerate(rig.steps):
        t = sample_times(step)
        drift = seen[step.name] - plain[step.name]
        (course,) = prepared_rig(rig)[step.name].offset
        # once the driver is off it falls in two exponentials: any three samples obey one recursion
        y = course(step.commanded_off + np.arange(60.0))
        (a, b), *_ = np.linalg.lstsq(np.column_stack([y[1:-1], y[:-2]]), y[2:], rcond=None)
        driver, bench = np.sort(-1.0 / np.log(np.roots([1.0, -a, -b]).real))[::-1]
        assert 4.0 < driver < 20.0 and 0.5 < bench < 3.0

        def warming(u: float, x: FloatArray, driver=driver, bench=bench) -> list[float]:
            return [(u - x[0]) / driver, (x[0] - x[1]) / bench]

        inputs = [(0.0, 0.0), (step.commanded_on, 1.0), (step.commanded_off, 0.0)]
        _, states = solved(rig, warming, 2, k, inputs)
        scale = drift[np.abs(drift).argmax()] / states[:, 1].max()
        assert np.abs(drift - scale * states[:, 1]).max() < 2e-4 * size
        off = np.searchsorted(t, step.commanded_off)
        assert np.abs(drift).argmax() > off  # the heat is on its way when the driver is
        peaks.append(abs(drift[off]))
    assert max(peaks) == pytest.approx(size, rel=1e-3)


def test_a_hurried_timer_shows_the_ideal_signal_at_other_times() -> None:
    rig = case(hurried_timer=0.12)
    seen = clean_signals(rig)
    for step, t, true in on_its_clock(rig):
        assert np.all(np.diff(true) > 0.0)
        assert 0.06 < np.abs(true - t).max() <= 0.12
        assert np.array_equal(seen[step.name], voltage(rig, step, Knobs(), true)[0])


def test_a_hose_that_holds_gas_back_and_one_that_is_pinched_against_an_ode_solver() -> None:
    rig = case()
    step = rig.steps[0]
    q, V = step.total_flow, rig.V
    bend = 3.0 * rig.relative_concentration(step)
    held = 0.4 * V / q / 4.0  # s, four cells

    def with_wall(u: float, x: FloatArray) -> list[float]:
        wall, before = x[1:5], x[:4]
        # d/dt of what the wall holds, held x / (1 + bend x), is what comes less what goes on
        cells = (before - wall) * (1.0 + bend * wall) ** 2 / held
        cascade = [(u - x[0]) / rig.tau_v, *cells, q / V * (wall[-1] - x[5])]
        return [*cascade, (x[5] - x[6]) / rig.tau]

    t, states = solved(rig, with_wall, 7)
    knobs = Knobs(sticky=0.4, sticky_bend=3.0, sticky_cells=4)
    assert np.abs(voltage(rig, step, knobs, t)[1] - states[:, 6]).max() < 5e-5
    # the same gas is held back on the way up as is given off later, but the front is the sharper
    up, down = (t > step.t0) & (t < step.tf), t > step.tf
    back = np.trapezoid((states[:, 0] - states[:, 4])[up], t[up])
    assert back == pytest.approx(4.0 * held / (1.0 + bend), rel=5e-3)
    assert np.trapezoid((states[:, 4] - states[:, 0])[down], t[down]) == pytest.approx(
        back, rel=5e-3
    )
    between = [np.ptp(t[part & (states[:, 4] > 0.1) & (states[:, 4] < 0.9)]) for part in (up, down)]
    assert between[1] > 1.1 * between[0]

    at, lasts = step.t0 + 0.6, 1.1

    def with_foot(u: tuple[float, float], x: FloatArray) -> list[float]:
        gas = u[1] * q / V * (x[0] - x[1])
        return [(u[0] - x[0]) / rig.tau_v, gas, (x[1] - x[2]) / rig.tau]

    inputs = [
        (0.0, (0.0, 1.0)), (step.t0, (1.0, 1.0)), (at, (1.0, 0.2)), (at + lasts, (1.0, 1.0)),
        (step.tf, (0.0, 1.0)),
    ]  # fmt: skip
    t, states = solved(rig, with_foot, 3, inputs=inputs)
    knobs = Knobs(
        all_flow=[lambda s: np.where((s >= at) & (s < at + lasts), 0.2, 1.0)],
        marks=[at - 1e-6, at, at + lasts - 1e-6, at + lasts],
    )
    assert np.abs(voltage(rig, step, knobs, t)[1] - states[:, 2]).max() < 5e-5

    pinched = prepared_rig(case(pinched_hose=0.8))
    happened = 0
    for step in rig.steps:
        s = np.linspace(0.0, step.duration, 200_001)
        for course in pinched[step.name].all_flow:
            factor = course(s)
            assert 0.2 - 1e-9 < factor.min() < 0.3 and factor.max() == pytest.approx(1.0)
            lasts = np.trapezoid(1.0 - factor, s) / 0.8
            assert 0.35 < lasts < 2.6
            shut = s[factor < 0.6]
            switch = step.t0 if shut[0] < step.tf else step.tf
            assert switch < shut[0] < switch + 1.3 * (rig.tau_v + V / step.total_flow)
            happened += 1
    assert happened >= 1


def test_a_silicone_hose_trades_gas_as_diffusion_into_a_thick_wall() -> None:
    strength = 0.2
    rig = case(permeable_hose=strength)
    found = prepared_rig(rig)
    # finite volumes of a wall 30 lengths thick; length and time in which diffusion passes the
    # resistance at its surface are the units
    n, width = 1200, 0.025
    matrix = np.diag(np.full(n, -2.0)) + np.diag(np.ones(n - 1), 1) + np.diag(np.ones(n - 1), -1)
    matrix[-1, -1], matrix[0, 0] = -1.0, -1.0 - width / (1.0 + 0.5 * width)
    rates, modes = np.linalg.eigh(matrix / width**2)
    full = modes.T @ np.ones(n)

    def top(loaded: float, emptied: float) -> float:
        """Concentration in the wall's first cell after gas for a while and none for another."""
        gas = full * -np.expm1(rates * loaded) * np.exp(rates * emptied)
        return float(modes[0] @ gas)

    for step in rig.steps:
        (course,) = found[step.name].seep
        first = course(np.array([step.t0 + 1e-7]))[0] / step.test_gas_flow
        assert first == pytest.approx(-strength, rel=0.01)
        assert course(np.array([step.t0 - 1e-6]))[0] == 0.0
        at = step.tf - step.t0

        def taken(s: float, course=course, step=step) -> float:
            return float(-course(np.array([step.t0 + s]))[0]) / step.test_gas_flow / strength

        # erfcx(sqrt(s)) is 0.5 at s = 0.5914: the time of which the cause does not tell us
        seconds = np.geomspace(1e-3, at, 20_000)
        shares = np.array([taken(float(s)) for s in seconds])
        half = np.interp(-0.5, -shares, seconds)
        unit = half / 0.5914
        assert 0.2 < unit < 4.0
        for s in (0.1 * at, 0.5 * at, 0.99 * at):
            wall = top(s / unit, 0.0)
            assert taken(s) == pytest.approx((1.0 - wall) / (1.0 + 0.5 * width), rel=0.01)
        for s in (0.2, 1.0, 4.0):
            wall = top(at / unit, s / unit)
            back = float(course(np.array([step.tf + s]))[0]) / step.test_gas_flow / strength
            assert back == pytest.approx(wall / (1.0 + 0.5 * width), rel=0.02)


def test_the_regulator_snaps_back_and_the_coating_does_not_come_back() -> None:
    rig = case(snapping_regulator=0.2)
    found = prepared_rig(rig)
    volumes = []
    for step in rig.steps:
        (course,) = found[step.name].test_gas
        t = np.linspace(step.t0, step.duration, 300_001)[1:]
        factor = course(t)
        assert np.all(course(np.linspace(0.0, step.t0 - 1e-9, 50)) == 1.0)
        assert 0.8 - 1e-9 <= factor.min() and factor.max() <= 1.0
        snaps = t[1:][np.diff(factor) > 0.1]
        assert len(snaps) >= 2
        assert np.diff(factor)[np.diff(factor) < 0.1] == pytest.approx(
            -0.2 * (t[1] - t[0]) / np.diff(snaps).mean(), rel=1e-3
        )
        assert np.ptp(np.diff(snaps)) < 1e-3 if len(snaps) > 2 else True
        volumes.append(np.diff(snaps).mean() * step.test_gas_flow)
        near = [np.abs(np.array(found[step.name].marks) - at).min() for at in snaps]
        assert max(near) < 1e-3
    assert np.ptp(volumes) < 1e-3 * np.mean(volumes)

    rig = case(peeling_coating=0.1)
    found = prepared_rig(rig)
    seen, plain = clean_signals(rig), clean_signals(without_causes(rig))
    flakes = 0
    for step in rig.steps:
        t = sample_times(step)
        left = np.ones_like(t)
        for course in found[step.name].concentration_gain:
            left = 1.0 + course(t)
            jumps = np.diff(left)
            assert np.all(jumps <= 0.0) and 1 <= np.sum(jumps < 0.0) <= 3
            fallen = t[1:][jumps < 0.0]
            assert np.all((fallen > step.t0) & (fallen < step.tf + step.interval))
            assert left[0] == 1.0 and 0.9**3 - 1e-9 <= left[-1] < 0.975
            flakes += 1
        expected = step.y0 + left * (plain[step.name] - step.y0)
        assert np.allclose(seen[step.name], expected, atol=2e-4 * step.beta)
    assert flakes >= 1


def test_the_motor_passes_the_benchs_resonance_twice() -> None:
    strength = 0.1
    rig = case(starting_motor=strength)
    size = strength * np.mean([step.beta for step in rig.steps])
    ran = 0
    for step in rig.steps:
        for course in prepared_rig(rig)[step.name].offset:
            t = np.arange(0.0, step.duration + 60.0, 2e-4)
            shaking = course(t)
            begin = t[np.flatnonzero(shaking)[0]]
            assert 0.05 * step.duration <= begin <= 0.7 * step.duration + 1e-3
            assert np.abs(shaking).max() == pytest.approx(size, rel=0.1)
            turns = t[1:][np.diff(np.sign(shaking)) != 0]
            speed, middle = 0.5 / np.diff(turns), 0.5 * (turns[1:] + turns[:-1])
            peaks = np.array(
                [np.abs(shaking[i:j]).max() for i, j in pairwise(np.searchsorted(t, turns))]
            )
            fastest = speed.max()
            assert 11.0 < fastest < 36.0
            running = speed > 0.97 * fastest
            before, after = middle < middle[running][0], middle > middle[running][-1]
            for part in (before, after):
                # loudest where the speed is the same, the bench's own, both ways
                own = speed[part][peaks[part].argmax()]
                assert 0.38 < own / fastest < 0.85
                assert peaks[part].max() > 0.75 * size
            # up to what the fine grid rounds
            assert np.all(np.diff(speed[before]) > -0.02 * fastest)
            assert np.all(np.diff(speed[after]) < 0.02 * fastest)
            assert peaks[-1] < 0.05 * size
            ran += 1
    assert ran >= 1


def test_the_detector_rises_at_once_and_falls_no_faster_than_its_capacitor() -> None:
    rig = case(diode_detector=1.0)
    seen, plain = clean_signals(rig), clean_signals(without_causes(rig))
    times, steepest = [], []
    for step in rig.steps:
        y, ideal, t = seen[step.name], plain[step.name], sample_times(step)
        assert np.all(y >= ideal - 1e-9)
        assert np.allclose(y[t < step.tf], ideal[t < step.tf], atol=1e-9)
        late = (y - ideal > 1e-4 * step.beta)[1:] & (y - ideal > 1e-4 * step.beta)[:-1]
        rate = -np.diff(np.log(y)) / step.interval
        steepest.append((-np.diff(np.log(ideal)) / step.interval).max())
        if late.any():
            assert rate[late] == pytest.approx(rate[late].mean(), rel=1e-3)
            times.append(1.0 / rate[late].mean())
    assert len(times) >= 1 and np.ptp(times) < 1e-3 * np.mean(times)
    assert np.mean(times) == pytest.approx(2.0 / max(steepest), rel=1e-2)


def test_a_repeated_buffer_shows_what_was_shown_and_then_goes_on() -> None:
    rig = case(repeated_buffer=0.5)
    seen = clean_signals(rig)
    buffers = 0
    for step, t, true in on_its_clock(rig):
        assert np.array_equal(seen[step.name], voltage(rig, step, Knobs(), true)[0])
        late = t - true
        edges = np.flatnonzero(np.diff(np.concatenate([[0.0], late, [0.0]])))
        for i, j in zip(edges[::2], edges[1::2], strict=True):
            length = late[i:j]
            assert np.ptp(length) < 1e-9 and 0.25 <= length[0] <= 0.5
            assert (j - i) * step.interval == pytest.approx(length[0], abs=1.01 * step.interval)
            assert true[i] >= step.t0 - 1e-6  # begins again where the block before began
            assert j < len(t) and true[j] == t[j]
            shown = true[i:j] <= t[i - 1]
            fine = np.interp(true[i:j], t[:i], seen[step.name][:i])
            assert np.abs(seen[step.name][i:j] - fine)[shown].max() < 1e-3 * step.beta
            assert shown.sum() >= j - i - 1
            buffers += 1
    assert buffers >= 2


def test_a_valve_that_sinks_back_and_a_bubbler_that_cools_against_an_ode_solver() -> None:
    rig = case()
    step = rig.steps[0]
    exchange = step.total_flow / rig.V

    def with_both(u: float, x: FloatArray) -> list[float]:
        inlet = x[0] * np.exp(-x[3])
        cascade = [(u - x[0]) / rig.tau_v, exchange * (inlet - x[1]), (x[1] - x[2]) / rig.tau]
        return [*cascade, (0.5 * x[0] * np.exp(-x[3]) - x[3]) / 4.0]

    inputs = [(0.0, 0.0), (step.t0, 1.0), (step.t0 + 2.5, 0.8), (step.tf, 0.0)]
    t, states = solved(rig, with_both, 4, inputs=inputs)
    knobs = Knobs(sinking=0.2, sinking_after=2.5, chill=0.5, chill_time=4.0)
    assert np.abs(voltage(rig, step, knobs, t)[1] - states[:, 2]).max() < 5e-5

    # what is lost in the end: the stated share at the largest flow, less at smaller ones
    long = replace(
        rig, steps=tuple(replace(s, tf=s.t0 + 400.0, duration=s.t0 + 401.0) for s in rig.steps)
    )
    found = prepared_rig(replace(long, strengths={"cooling_bubbler": 0.25}))
    lost = {}
    for step in long.steps:
        end = np.array([step.t0 - 1.0, step.tf - 1e-3])
        x = voltage(long, step, found[step.name], end)[1]
        assert x[0] == 0.0
        lost[step.test_gas_flow] = 1.0 - x[1]
    flows = sorted(lost)
    assert lost[flows[-1]] == pytest.approx(0.25, abs=1e-4)
    assert all(lost[a] < lost[b] for a, b in pairwise(flows))
    # heat that evaporation takes, flow times pressure, is heat that comes back: chill, log pressure
    taken = np.array([flow * (1.0 - lost[flow]) for flow in flows])
    assert np.ptp(-np.log1p([-lost[flow] for flow in flows]) / taken) < 1e-3 / taken[-1]

    after = {knobs.sinking_after for knobs in prepared_rig(case(weak_holding_current=0.2)).values()}
    assert len(after) == 1 and 1.0 <= after.pop() <= 8.0
    found = prepared_rig(replace(long, strengths={"weak_holding_current": 0.2}))
    for step in long.steps:
        x = voltage(long, step, found[step.name], np.array([step.tf - 1e-3, step.duration]))[1]
        assert x[0] == pytest.approx(0.8, abs=1e-9)


def test_gas_that_pairs_follows_riccatis_equation() -> None:
    rig = replace(case(), tau_v=1e-3, tau=1e-3)  # little but the manifold is left
    step = rig.steps[0]
    rate, exchange = 1.3, step.total_flow / rig.V

    def with_pairs(u: float, x: FloatArray) -> list[float]:
        gas = exchange * (x[0] - x[1]) - rate * x[1] ** 2
        return [(u - x[0]) / rig.tau_v, gas, (x[1] - x[2]) / rig.tau]

    t, states = solved(rig, with_pairs, 3)
    x = voltage(rig, step, Knobs(pairing=rate), t)[1]
    settled = states[t < step.tf][-1, 2]
    assert settled + rate / exchange * settled**2 == pytest.approx(1.0, abs=1e-7)
    assert np.abs(x * settled - states[:, 2]).max() < 5e-5
    # in closed form: a hyperbolic tangent up; down, 1/x grows as what is exchanged, and no faster
    root = np.sqrt(exchange**2 + 4.0 * rate * exchange)
    up, down = (t > step.t0 + 0.1) & (t < step.tf), t > step.tf + 0.1
    since = t - step.t0 - rig.tau - rig.tau_v  # the two short lags, to first order
    rise = 2.0 * exchange / (exchange + root / np.tanh(0.5 * root * since[up]))
    assert np.abs(x[up] * settled - rise).max() < 2e-3
    gone = np.exp(exchange * (t - step.tf - rig.tau - rig.tau_v)[down])
    fall = 1.0 / (gone / settled + rate / exchange * (gone - 1.0))
    assert np.abs(x[down] * settled - fall).max() < 2e-3

    found = prepared_rig(case(pairing_gas=0.6))
    typical = np.median([step.total_flow for step in case().steps])
    for step in case().steps:  # as second order has it
        share = found[step.name].pairing * rig.V / typical / 0.6
        assert share == pytest.approx(rig.relative_concentration(step))


def test_water_that_gives_way_and_a_ring_that_heats_itself_against_an_ode_solver() -> None:
    rig = case()
    step = rig.steps[0]
    relative, exchange = rig.relative_concentration(step), step.total_flow / rig.V
    damp, load, slow = 0.3, 2.0, 3.0

    def with_water(u: float, x: FloatArray) -> list[float]:
        cascade = [(u - x[0]) / rig.tau_v, exchange * (x[0] - x[1]), (x[1] - x[2]) / rig.tau]
        # x[3] is how much less water there is than at the start
        water = damp - x[3]
        gas = (1.0 - water) * load * x[2] / (1.0 + load * x[2])  # on its sites, at once
        coming = damp / (1.0 - damp) * (1.0 - water - gas)
        return [*cascade, -(coming - water) / slow]

    t, states = solved(rig, with_water, 4)
    knobs = Knobs(damp=damp, damp_time=slow, displacing=load)
    seen = states[:, 2] * (1.0 - damp + states[:, 3]) / (1.0 - damp)
    assert np.abs(voltage(rig, step, knobs, t)[1] - seen).max() < 5e-5
    K = damp / (1.0 - damp)
    least = K / (1.0 + load + K)
    # on the plateau the water runs down to what the gas leaves it, and the response up
    assert 1.1 < seen.max() <= (1.0 - least) / (1.0 - damp)
    for knobs, each in zip(
        prepared_rig(case(displaced_water=0.2)).values(), rig.steps, strict=True
    ):
        assert knobs.damp == 0.2
        assert 1.0 < knobs.displacing / rig.relative_concentration(each) < 4.0

    detuning, reach = -0.8, 0.3 * relative
    for warming in (0.4, -0.4):

        def heating(u: float, x: FloatArray, warming=warming) -> list[float]:
            cascade = [(u - x[0]) / rig.tau_v, exchange * (x[0] - x[1]), (x[1] - x[2]) / rig.tau]
            absorbed = dip(detuning + reach * x[2] + x[3]) - dip(detuning)
            return [*cascade, (warming * absorbed - x[3]) / 1.2]

        t, states = solved(rig, heating, 4)
        y = voltage(rig, step, Knobs(warming=warming, warming_time=1.2), t)[0]
        at = detuning + reach * states[:, 2]
        read = (dip(at + states[:, 3]) - dip(at)) / (dip(detuning + reach) - dip(detuning))
        expected = step.y0 + step.beta * (states[:, 2] + read)
        assert np.abs(y - expected).max() < 1e-4 * step.beta
        # towards the line's centre the light runs ahead of the gas, away from it it gives in
        assert np.sign(read[np.abs(read).argmax()]) == np.sign(warming)
        last = np.searchsorted(t, step.tf) - 1
        moved = states[last, 3]
        assert moved == pytest.approx(warming * (dip(at[last] + moved) - dip(detuning)), abs=1e-3)


def test_the_lock_hunts_and_the_two_converters_take_turns() -> None:
    rig = case()
    step = rig.steps[0]
    exchange, own, damping = step.total_flow / rig.V, 0.2, 0.25

    def hunting(u: float, x: FloatArray) -> list[float]:
        cascade = [(u - x[0]) / rig.tau_v, exchange * (x[0] - x[1]), (x[1] - x[2]) / rig.tau]
        return [*cascade, x[4] / own, (x[2] - x[3] - 2.0 * damping * x[4]) / own]

    t, states = solved(rig, hunting, 5)
    y, x = voltage(rig, step, Knobs(lock_time=own, lock_damping=damping), t)
    assert np.abs((y - step.y0) / step.beta - states[:, 3]).max() < 5e-5
    assert np.abs(x - states[:, 2]).max() < 5e-5  # the gas does not know
    # after a sudden step: overshoot exp(-pi damping / sqrt(1 - damping^2)), half a turn later
    t = np.concatenate([[0.0, 1.0 - 1e-9], np.linspace(1.0, 5.0, 40_001)])
    rung = oscillating_lag(t, (t >= 1.0).astype(float), own, damping)
    turn = np.sqrt(1.0 - damping**2)
    assert rung.max() == pytest.approx(1.0 + np.exp(-np.pi * damping / turn), abs=1e-6)
    assert t[rung.argmax()] == pytest.approx(1.0 + np.pi * own / turn, abs=2e-4)
    assert rung[-1] == pytest.approx(1.0, abs=0.01)

    rig = case(paired_converters=0.04)
    seen, plain = clean_signals(rig), clean_signals(without_causes(rig))
    lines = []
    for step in rig.steps:
        y, ideal = seen[step.name], plain[step.name]
        assert np.allclose(0.5 * (y[:-1] + y[1:]), 0.5 * (ideal[:-1] + ideal[1:]), atol=0.02)
        even, odd = (np.polyfit(ideal[k::2], y[k::2], 1) for k in (0, 1))
        assert np.abs(np.polyval(even, ideal[::2]) - y[::2]).max() < 1e-9  # a straight line each
        lines.append(odd - even)
        assert even + odd == pytest.approx([2.0, 0.0], abs=1e-9)
    gains, zeros = np.array(lines).T
    assert np.abs(gains) == pytest.approx(0.04) and np.ptp(gains) < 1e-9
    size = 0.04 * np.mean([step.beta for step in rig.steps])
    assert np.ptp(zeros) < 1e-9 and np.abs(zeros).max() <= 0.5 * size


def test_clouds_of_solvent_pass_by_the_first_passage_law() -> None:
    strength = 0.1
    rig = case(neighbours_solvent=strength)
    found = prepared_rig(rig)
    clouds = 0
    for step in rig.steps:
        for course, at in zip(found[step.name].seep, found[step.name].marks, strict=True):
            t = at + np.geomspace(1e-4, 600.0, 400_001)
            gas = course(t)
            assert np.all(course(np.linspace(0.0, at, 50)) == 0.0) and gas.min() >= 0.0
            share = gas.max() / (rig.highest_concentration * step.carrier_flow)
            assert 0.5 * strength - 1e-6 < share <= strength
            total = np.trapezoid(gas, t)
            mean = np.trapezoid(gas * (t - at), t) / total
            spread, lean, tail = (
                np.trapezoid(gas * (t - at - mean) ** k, t) / total for k in (2, 3, 4)
            )
            # cumulants of the inverse Gaussian: skewness 3 v and excess 15 v^2, v = sd over mean
            v = np.sqrt(spread) / mean
            assert 1.0 < mean < 5.0 and 0.3 < v < 1.01
            assert lean / spread**1.5 == pytest.approx(3.0 * v, rel=1e-3)
            assert tail / spread**2 - 3.0 == pytest.approx(15.0 * v**2, rel=1e-3)
            clouds += 1
    assert clouds >= 1


def test_a_valve_on_a_grain_against_an_ode_solver() -> None:
    rig = case()
    step = rig.steps[0]
    ajar, until = 0.15, step.tf + 2.6

    def with_grain(u: tuple[float, float], x: FloatArray) -> list[float]:
        target, moving = u
        plunger = moving * (target - x[0]) / rig.tau_v
        return [plunger, step.total_flow / rig.V * (x[0] - x[1]), (x[1] - x[2]) / rig.tau]

    rests = step.tf + rig.tau_v * np.log(1.0 / ajar)  # where exp(-t/tau_v) has come down to it
    inputs = [
        (0.0, (0.0, 1.0)), (step.t0, (1.0, 1.0)), (step.tf, (0.0, 1.0)), (rests, (0.0, 0.0)),
        (until, (0.0, 1.0)),
    ]  # fmt: skip
    t, states = solved(rig, with_grain, 3, inputs=inputs)
    x = voltage(rig, step, Knobs(ajar=ajar, ajar_until=until), t)[1]
    assert np.abs(x - states[:, 2]).max() < 5e-5
    assert np.interp(until, t, x) > 0.9 * ajar

    strength, happened = 0.1, 0
    rig = draw_case(11, {"grain_in_seat": strength}, size="paper")
    plain = clean_signals(without_causes(rig))
    for step, knobs in zip(rig.steps, prepared_rig(rig).values(), strict=True):
        t = sample_times(step)
        leak = (voltage(rig, step, knobs, t)[0] - plain[step.name]) / step.beta
        assert np.abs(leak[t <= step.tf]).max() < 1e-6
        if knobs.ajar == 0.0:
            assert np.abs(leak).max() < 1e-9
            continue
        happened += 1
        assert 0.5 * strength <= knobs.ajar <= strength and leak.max() <= knobs.ajar
        lies = knobs.ajar_until - step.tf
        assert 2.0 <= lies <= 20.0 and leak[-1] < 1e-3
        # no volume or lag behind the valve changes how much leaks in all; what the plunger falls
        # after the grain has gone is what it would have fallen before
        held = lies - rig.tau_v * np.log(1.0 / knobs.ajar)
        assert np.trapezoid(leak, t) == pytest.approx(knobs.ajar * held, rel=2e-3)
    assert 1 <= happened < len(rig.steps)


def test_stale_gas_comes_first_and_a_jet_does_not_mix_against_an_ode_solver() -> None:
    rig = case()
    step = rig.steps[0]
    q, V = step.total_flow, rig.V
    lost, volume, front = 0.4, 6.0, 1.5

    def with_stale_gas(u: float, x: FloatArray) -> list[float]:
        z = (x[3] - volume) / front
        inlet = x[0] * (1.0 - lost * 0.5 * (1.0 - erf(z)))
        cascade = [(u - x[0]) / rig.tau_v, q / V * (inlet - x[1]), (x[1] - x[2]) / rig.tau]
        return [*cascade, step.test_gas_flow * x[0]]

    t, states = solved(rig, with_stale_gas, 4)
    knobs = Knobs(stale=lost, stale_volume=volume, stale_front=front)
    x, plain = (voltage(rig, step, some, t)[1] for some in (knobs, Knobs()))
    assert np.abs(x - states[:, 2]).max() < 5e-5
    # what is missing in the end: the lost share of one hose of test gas, passed on by the flow
    missing = np.trapezoid(plain - x, t) * q * step.concentration
    assert missing == pytest.approx(lost * volume, rel=0.01)

    found = prepared_rig(case(stale_test_gas=0.5))
    volumes = []
    for each in rig.steps:
        t = sample_times(each)
        less = voltage(rig, each, Knobs(), t)[1] - voltage(rig, each, found[each.name], t)[1]
        assert 0.0 < less.max() < 0.5 and less.min() > -1e-9
        volumes.append(np.trapezoid(less, t) * each.test_gas_flow / 0.5)
    assert np.ptp(volumes) < 0.01 * np.mean(volumes)  # one hose, at any flow
    assert 0.08 <= np.mean(volumes) / V <= 0.41

    jet = 0.35

    def with_jet(u: float, x: FloatArray) -> list[float]:
        mixed = (1.0 - jet) * q / V * (x[0] - x[1])
        seen = jet * x[0] + (1.0 - jet) * x[1]
        return [(u - x[0]) / rig.tau_v, mixed, (seen - x[2]) / rig.tau]

    t, states = solved(rig, with_jet, 3)
    x = voltage(rig, step, Knobs(jet=jet), t)[1]
    assert np.abs(x - states[:, 2]).max() < 5e-5
    # a short cut changes no volume: the mean delay stays V over the flow
    plain = voltage(rig, step, Knobs(), t)[1]
    up = t < step.tf
    assert np.trapezoid((x - plain)[up], t[up]) == pytest.approx(0.0, abs=2e-3)
    assert (x - plain)[up].max() > 0.02
    jets = {s.total_flow: prepared_rig(case(jet_across=0.3))[s.name].jet for s in rig.steps}
    flows = np.array(sorted(jets))
    sizes = np.array([jets[flow] for flow in flows])
    power = np.diff(np.log(sizes)) / np.diff(np.log(flows))
    assert np.ptp(power) < 1e-9 and round(float(power[0]), 9) in (0.5, 1.0)
    assert sizes[-1] == pytest.approx(0.3)


def test_a_coating_that_warms_as_it_takes_up_gas_against_an_ode_solver() -> None:
    rig = case()
    step = rig.steps[0]
    heat, cooling = 0.3, 2.0

    def with_heat(u: float, x: FloatArray) -> list[float]:
        uptake = (x[1] * np.exp(-x[3]) - x[2]) / rig.tau
        cascade = [(u - x[0]) / rig.tau_v, step.total_flow / rig.V * (x[0] - x[1])]
        return [*cascade, uptake, heat * uptake - x[3] / cooling]

    t, states = solved(rig, with_heat, 4)
    x = voltage(rig, step, Knobs(sorption_heat=heat, cooling_time=cooling), t)[1]
    assert np.abs(x - states[:, 2]).max() < 5e-5
    plain = voltage(rig, step, Knobs(), t)[1]
    up, down = (t > step.t0 + 0.5) & (t < step.tf), t > step.tf + 0.5
    assert (x - plain)[up].min() < -0.05 and (x - plain)[down].max() > 0.02

    # a little heat in a coating that is quick: the warmth is heat times the gas through a
    # high-pass of the cooling time, and takes the gas there is times itself
    quick, little = replace(rig, tau=1e-3), 1e-3

    def high_pass(u: float, x: FloatArray) -> list[float]:
        cascade = [(u - x[0]) / rig.tau_v, step.total_flow / rig.V * (x[0] - x[1])]
        return [*cascade, (x[1] - x[2]) / quick.tau, (x[2] - x[3]) / cooling]

    t, states = solved(quick, high_pass, 4)
    gas, warmth = states[:, 2], states[:, 2] - states[:, 3]
    knobs = Knobs(sorption_heat=little, cooling_time=cooling)
    x, plain = (voltage(quick, step, some, t)[1] for some in (knobs, Knobs()))
    assert np.abs((plain - x) / little - gas * warmth).max() < 5e-3

    found = prepared_rig(case(heat_of_sorption=0.2))
    for each in rig.steps:
        knobs = found[each.name]
        assert knobs.sorption_heat == pytest.approx(0.2 * rig.relative_concentration(each))
        assert 1.0 <= knobs.cooling_time <= 8.0
    assert len({knobs.cooling_time for knobs in found.values()}) == 1


def test_the_fibre_creeps_back_from_every_click() -> None:
    strength = 0.1
    rig = case(jolted_fibre=strength)
    seen, plain = clean_signals(rig), clean_signals(without_causes(rig))
    laws = []
    for step in rig.steps:
        t = sample_times(step)
        left = seen[step.name] / plain[step.name] - 1.0
        assert np.abs(left[t < step.commanded_on - step.interval]).max() < 1e-12
        (course,) = prepared_rig(rig)[step.name].gain
        assert np.allclose(left, course(t), atol=1e-9)
        at = np.array([step.commanded_on, step.commanded_off])
        jumps = course(at - 1e-9) - course(at)
        # size/(1 + t/time)^power: its root is a straight line; time and power from three samples
        since = np.array([0.0, 1.0, 3.0])
        logs = np.log(course(at[0] + since) / course(at[:1]))
        powers = np.linspace(0.3, 2.0, 170_001)
        lines = [np.exp(-log / powers) - 1.0 for log in logs[1:]]
        power = powers[np.abs(lines[1] - 3.0 * lines[0]).argmin()]
        laws.append([*jumps, power, 1.0 / np.interp(power, powers, lines[0])])
        later = step.commanded_on + np.linspace(0.0, 5.0, 50)
        expected = -jumps[0] * (1.0 + (later - at[0]) / laws[-1][3]) ** -power
        assert np.allclose(course(later), expected, rtol=1e-3)
    on, off, power, time_ = np.mean(laws, axis=0)
    assert np.ptp(np.array(laws)[:, :2], axis=0).max() < 1e-6  # every click alike
    assert max(on, off) == pytest.approx(strength, abs=1e-6) and 0.5 <= min(on, off) / strength
    assert 0.5 <= power <= 1.5 and 0.2 <= time_ <= 3.0


def test_coarse_and_fine_converters_disagree_by_a_sawtooth() -> None:
    strength = 0.3
    rig = case(coarse_and_fine=strength)
    seen, plain = clean_signals(rig), clean_signals(without_causes(rig))
    level = np.concatenate([plain[step.name] for step in rig.steps])
    error = np.concatenate([seen[step.name] for step in rig.steps]) - level
    order = np.argsort(level)
    level, error = level[order], error[order]
    (width,) = {knobs.coarse_step for knobs in prepared_rig(rig).values()}
    step_ = np.mean([step.beta for step in rig.steps])
    assert 0.1 <= width / step_ <= 0.35
    # one curve for all experiments: slope s between jumps back by s times the coarse step
    jumps = np.flatnonzero(np.abs(np.diff(error)) > 0.5 * strength * width)
    assert len(jumps) >= 3
    assert np.diff(level[jumps]) == pytest.approx(width, rel=0.1)
    sign = -np.sign(np.diff(error)[jumps[0]])
    for i, j in pairwise([-1, *jumps.tolist(), len(level) - 1]):
        if level[j] - level[i + 1] < 1e-3 * width:
            continue
        slope, _ = np.polyfit(level[i + 1 : j + 1], error[i + 1 : j + 1], 1)
        assert slope == pytest.approx(sign * strength, rel=1e-6)
    assert np.abs(error).max() <= 0.5 * strength * width + 1e-12


def test_the_flash_lamp_fires_evenly_and_each_shot_dies_out() -> None:
    strength = 0.2
    rig = case(neighbours_flashlamp=strength)
    size = strength * np.mean([step.beta for step in rig.steps])
    found, runs = prepared_rig(rig), 0
    seen, plain = clean_signals(rig), clean_signals(without_causes(rig))
    for step in rig.steps:
        assert len(found[step.name].offset) <= 1
        for course in found[step.name].offset:
            s = sample_times(step)
            assert np.allclose(seen[step.name] - plain[step.name], course(s), atol=1e-9)
            t = np.arange(0.0, step.duration + 1.0, 1e-4)
            pulses = np.abs(course(t))
            shots = t[1:][np.diff(pulses) > 0.3 * size]
            period = np.diff(shots).mean()
            assert np.abs(np.diff(shots) - period).max() < 1.1e-4
            assert 2.0 < 1.0 / period < 12.1
            # each adds one pulse that dies out: undone by the recursion of one decay
            falling = (pulses[:-1] > 1e-3 * size) & (np.diff(pulses) < 0.0)
            decay = np.median(pulses[1:][falling] / pulses[:-1][falling])
            assert 5e-3 < -1e-4 / np.log(decay) < 3e-2
            struck = pulses[1:] - decay * pulses[:-1]
            hit = struck > 0.3 * size
            assert struck[hit].max() <= size * 1.001 and struck[hit].min() > 0.97 * size
            assert np.abs(struck[~hit]).max() < 1e-6 * size
            assert shots[0] < 0.5 * step.duration + 1e-3 and shots[-1] < step.duration
            assert pulses[-1] < 1e-6 * size
            runs += 1
    assert runs >= 1


def test_packets_that_overtake_come_first_and_nothing_is_lost() -> None:
    rig = case(overtaking_packets=0.5)
    swapped = 0
    for step, t, true in on_its_clock(rig):
        early, late = true > t + 1e-9, true < t - 1e-9
        assert np.all(t[early | late] >= step.t0)
        starts = np.flatnonzero(np.diff(np.concatenate([[False], early]).astype(int)) == 1)
        for i in starts:
            lasts = true[i] - t[i]
            assert 0.25 <= lasts <= 0.5
            first = (t >= t[i]) & early & (t < t[i] + 1.5 * lasts)
            second = late & (t >= t[i]) & (t < t[i] + 2.5 * lasts)
            assert np.ptp((true - t)[first]) < 1e-9 and np.ptp((true - t)[second]) < 1e-9
            n = lasts / step.interval
            assert abs(first.sum() - n) <= 1.0 and abs(second.sum() - n) <= 1.0
            both = np.sort(true[first | second])
            # in the right order they fill the time without a gap of more than two samples
            assert np.diff(both).max() < 2.01 * step.interval
            assert both[0] >= t[i] - 1.01 * step.interval
            swapped += 1
        assert np.array_equal(true[~(early | late)], t[~(early | late)])
        expected = voltage(rig, step, Knobs(), true)[0]
        assert np.array_equal(clean_signals(rig)[step.name], expected)
    assert swapped >= 2


def test_a_hose_that_throttles_and_a_needle_that_sticks_against_an_ode_solver() -> None:
    rig = case()
    step = rig.steps[0]
    q, V = step.total_flow, rig.V
    lost = 0.7

    def with_throttle(u: float, x: FloatArray) -> list[float]:
        # flow^2 times (what the valve resists, open 1 - lost, and what the hose resists) is 1
        passed = ((1.0 - lost) / max(x[0], 1e-12) ** 2 + lost) ** -0.5
        return [(u - x[0]) / rig.tau_v, q / V * (passed - x[1]), (x[1] - x[2]) / rig.tau]

    t, states = solved(rig, with_throttle, 3)
    x, plain = (voltage(rig, step, some, t)[1] for some in (Knobs(authority_lost=lost), Knobs()))
    assert np.abs(x - states[:, 2]).max() < 5e-5
    # ahead of the ideal valve all the way up, behind it all the way down
    moving = (plain > 0.02) & (plain < 0.98)
    assert np.all((x > plain)[moving]) and (x - plain).max() > 0.1
    assert {k.authority_lost for k in prepared_rig(case(throttling_hose=0.3)).values()} == {0.3}

    strength = 0.2
    rig = case(sticking_needle=strength)
    turns, begins = [], []
    for k, step in enumerate(rig.steps):
        (course,) = prepared_rig(rig)[step.name].test_gas
        fine = np.arange(0.0, step.duration, 1e-4)
        factor = course(fine)
        low, high = np.unique(np.round(factor, 12))
        assert high - low == pytest.approx(2.0 * strength)
        jumps = fine[1:][np.diff(factor) != 0.0]
        ups = fine[1:][np.diff(factor) > 0.0]
        turns.append(np.diff(ups).mean())
        assert np.ptp(np.diff(ups)) < 2.1e-4
        begins.append(ups[0] / turns[-1])
        whole = (fine >= ups[0]) & (fine < ups[-1])
        assert factor[whole].mean() == pytest.approx(1.0, abs=1e-3)  # the loop holds the mean

        def with_needle(u: tuple[float, float], x: FloatArray, step=step) -> list[float]:
            most = u[1] * step.test_gas_flow
            flow = step.carrier_flow + most * x[0] + step.test_gas_flow * (1.0 - x[0])
            inlet = x[0] * most / (step.carrier_flow + most) / step.concentration
            gas = flow / rig.V * (inlet - x[1])
            return [(u[0] - x[0]) / rig.tau_v, gas, (x[1] - x[2]) / rig.tau]

        inputs = [
            (at, (float(step.t0 <= at < step.tf), float(course(np.array([at + 1e-4]))[0])))
            for at in sorted([0.0, step.t0, step.tf, *jumps.tolist()])
        ]
        t, states = solved(rig, with_needle, 3, k, inputs)
        x = voltage(rig, step, prepared_rig(rig)[step.name], t)[1]
        assert np.abs(x - states[:, 2]).max() < 2e-4  # jumps are found to 0.1 ms
        assert np.abs(x - voltage(rig, step, Knobs(), t)[1]).max() > 0.05
    assert np.ptp(turns) < 1e-3 and 1.5 < np.mean(turns) < 8.0
    assert np.ptp(np.mod(begins, 1.0)) > 0.01


def test_vapour_condenses_in_a_cold_spot_and_dries_again() -> None:
    rig = case()
    k = int(np.argmax([step.concentration for step in rig.steps]))
    step = rig.steps[k]
    level, patch = 0.93, 0.08
    knobs = Knobs(saturated=level, film_time=patch)

    def behind(u: float, film: float) -> float:
        covered = 1.0 - np.exp(-max(film, 0.0) / patch)
        return level if u > level else u + (level - u) * covered

    def with_film(u: float, x: FloatArray) -> list[float]:
        out = behind(x[0], x[3])
        exchange = step.total_flow / rig.V * (out - x[1])
        return [(u - x[0]) / rig.tau_v, exchange, (x[1] - x[2]) / rig.tau, x[0] - out]

    t, states = solved(rig, with_film, 4, k)
    x, plain = (voltage(rig, step, some, t)[1] for some in (knobs, Knobs()))
    assert np.abs(x - states[:, 2]).max() < 1e-4
    # never beyond saturation; all that condensed comes back, as a shelf at saturation
    assert x.max() <= level + 1e-9
    assert np.trapezoid(x - plain, t) == pytest.approx(0.0, abs=2e-3)
    assert states[:, 3].max() > 5.0 * patch
    # balance of a valve that follows exp(-t/tau_v): what condensed while more than saturation came
    # dries at that rate, besides what the shutting valve still brings
    condensing = step.tf - step.t0 - rig.tau_v * np.log(1.0 / (1.0 - level))
    gone = step.tf + rig.tau_v + condensing * (1.0 - level) / level
    half = t[(t > step.tf) & (x > 0.5 * level)][-1]
    assert half == pytest.approx(gone + rig.V / step.total_flow * np.log(2.0) + rig.tau, abs=0.05)
    assert half - t[(t > step.tf) & (plain > 0.5)][-1] > 0.5

    rig = case(cold_spot=0.05)
    found, times = prepared_rig(rig), []
    for each in rig.steps:
        t, knobs = sample_times(each), found[each.name]
        assert knobs.saturated == pytest.approx(0.95)
        x, plain = (voltage(rig, each, some, t)[1] for some in (knobs, Knobs()))
        relative = rig.relative_concentration(each)
        if relative < 0.95:
            assert np.abs(x - plain).max() < 1e-5
        else:
            assert x[t < each.tf].max() * relative == pytest.approx(0.95, abs=1e-4)
        times.append(knobs.film_time * each.total_flow)
    assert np.ptp(times) < 1e-9 and 0.02 < times[0] / rig.V < 0.2


def test_a_streak_goes_round_and_molecules_split_against_an_ode_solver() -> None:
    rig = case()
    step = rig.steps[0]
    exchange, relative = step.total_flow / rig.V, rig.relative_concentration(step)
    share, turns, narrow, begin = 0.5, 2.5, 3.0, 0.3

    # two more states turn with the gas that passes: the cosine and sine of the streak's place
    angle = 2.0 * np.pi * (begin - turns * exchange * step.t0)

    def with_streak(u: float, x: FloatArray) -> list[float]:
        cosine = np.cos(angle) + x[3]
        sine = np.sin(angle) + x[4]
        rate = 2.0 * np.pi * turns * exchange
        seen = x[1] + share * np.exp(narrow * (cosine - 1.0)) * (x[0] - x[1])
        cascade = [(u - x[0]) / rig.tau_v, exchange * (x[0] - x[1]), (seen - x[2]) / rig.tau]
        return [*cascade, -rate * sine, rate * cosine]

    t, states = solved(rig, with_streak, 5)
    marks = np.concatenate([at + np.arange(0.0, 6.0, 0.01) for at in (step.t0, step.tf)])
    knobs = Knobs(swirl=share, swirl_turns=turns, swirl_narrow=narrow, swirl_begin=begin,
                  marks=marks.tolist())  # fmt: skip
    x, plain = (voltage(rig, step, some, t)[1] for some in (knobs, Knobs()))
    assert np.abs(x - states[:, 2]).max() < 2e-4
    # fresh gas only: ahead on the way up, ahead on the way down, nothing on the plateau
    assert (x - plain)[t < step.tf].min() > -1e-6 and (x - plain)[t > step.tf].max() < 1e-6
    assert (x - plain).max() > 0.05 and abs((x - plain)[np.searchsorted(t, step.tf) - 1]) < 1e-5
    found = prepared_rig(case(swirling_gas=0.3))
    assert len({(k.swirl, k.swirl_turns, k.swirl_narrow) for k in found.values()}) == 1
    assert len({k.swirl_begin for k in found.values()}) == len(found)

    split, time_ = 0.3, 0.8

    def with_halves(u: float, x: FloatArray) -> list[float]:
        cascade = [(u - x[0]) / rig.tau_v, exchange * (x[0] - x[1]), (x[1] - x[2]) / rig.tau]
        return [*cascade, (relative * x[1] - x[3] ** 2) / time_]

    t, states = solved(rig, with_halves, 4)
    x = voltage(rig, step, Knobs(split=split, split_time=time_), t)[1]
    seen = (1.0 - split) * states[:, 2] + split * states[:, 3] / np.sqrt(relative)
    assert np.abs(x - seen).max() < 5e-5
    # gas at once: a hyperbolic tangent up, and down one over time
    root = np.sqrt(0.4)
    at = np.concatenate([[0.0, 1.0 - 1e-9], np.linspace(1.0, 4.0, 301)])
    at = np.concatenate([at, [4.0 + 1e-9], np.linspace(4.01, 40.0, 301)])
    halves = splitting(at, np.where((at >= 1.0) & (at <= 4.0), 0.4, 0.0), time_)
    up, down = (at >= 1.0) & (at <= 4.0), at > 4.0
    assert np.abs(halves[up] - root * np.tanh(root * (at[up] - 1.0) / time_)).max() < 1e-7
    top = halves[at <= 4.0][-1]
    assert np.abs(halves[down] - top / (1.0 + top * (at[down] - 4.0) / time_)).max() < 1e-7

    found = prepared_rig(case(splitting_molecules=0.2))
    for each in rig.steps:  # linear and root parts, 0.8 and 0.2 at the highest concentration
        c = rig.relative_concentration(each)
        expected = 0.2 * np.sqrt(c) / (0.8 * c + 0.2 * np.sqrt(c))
        assert found[each.name].split == pytest.approx(expected)
        assert 0.2 < found[each.name].split_time < 2.0


def test_the_second_modes_line_is_crossed_at_one_concentration() -> None:
    strength = 0.15
    rig = case(second_mode=strength)
    size = strength * np.mean([step.beta for step in rig.steps])
    seen, places, widths, reached = clean_signals(rig), [], [], 0
    for step in rig.steps:
        t = sample_times(step)
        plain, x = voltage(rig, step, Knobs(), t)
        c, lost = rig.relative_concentration(step) * x, plain - seen[step.name]
        # one over what is lost is a parabola in the concentration, but for what was lost at rest
        knobs = prepared_rig(rig)[step.name]
        rest = size / (1.0 + (knobs.mode_at / knobs.mode_width) ** 2)
        inside = lost + rest > 0.2 * size
        if c.max() < knobs.mode_at - 3.0 * knobs.mode_width:  # too weak to come so far
            assert np.abs(lost).max() < 0.1 * size
        if inside.sum() < 20:
            continue
        a, b, d = np.polyfit(c[inside], size / (lost + rest)[inside], 2)
        places.append(-0.5 * b / a)
        widths.append(a**-0.5)
        assert d - 0.25 * b**2 / a == pytest.approx(1.0, abs=1e-4)  # all of it on the line
        reached += bool(inside[t < step.tf].any() and inside[t > step.tf].any())
        assert seen[step.name][0] == pytest.approx(step.y0)
    assert reached >= 1
    assert np.ptp(places) < 1e-4 and 0.15 < places[0] < 0.6
    assert np.ptp(widths) < 1e-4 and 0.03 < widths[0] < 0.12


def test_the_output_stage_warms_most_at_half_the_supply() -> None:
    rig = case()
    step = rig.steps[0]
    supply, time_, size = 1.3 * (step.y0 + step.beta), 2.5, 0.12

    def with_heat(u: float, x: FloatArray) -> list[float]:
        y = step.y0 + step.beta * x[2]
        watts = y * (supply - y) - step.y0 * (supply - step.y0)  # current times voltage left
        cascade = [(u - x[0]) / rig.tau_v, step.total_flow / rig.V * (x[0] - x[1])]
        return [*cascade, (x[1] - x[2]) / rig.tau, (watts / (0.25 * supply**2) - x[3]) / time_]

    t, states = solved(rig, with_heat, 4)
    y, x = voltage(rig, step, Knobs(heat=size, heat_supply=supply, heat_time=time_), t)
    expected = step.y0 + step.beta * states[:, 2] + size * states[:, 3]
    assert np.abs(y - expected).max() < 5e-5 * step.beta
    assert np.abs(x - states[:, 2]).max() < 5e-5  # the gas does not know
    assert np.ptp(states[:, 3]) > 0.3

    rig = case(hot_output_stage=0.1)
    (heat,), (supply,), (time_,) = (
        {getattr(knobs, name) for knobs in prepared_rig(rig).values()}
        for name in ("heat", "heat_supply", "heat_time")
    )
    assert abs(heat) == pytest.approx(0.1 * np.mean([each.beta for each in rig.steps]))
    assert 1.05 < supply / max(each.y0 + each.beta for each in rig.steps) < 1.8
    assert 1.0 < time_ < 10.0


def test_a_sparse_logger_is_right_at_its_readings_and_straight_between() -> None:
    rig = case(sparse_logger=0.6)
    seen, early = clean_signals(rig), 0
    for step in rig.steps:
        readings = prepared_rig(rig)[step.name].readings
        assert readings is not None and readings[0] <= 0.0 and readings[-1] > step.duration
        assert 0.3 <= np.diff(readings).min() and np.diff(readings).max() <= 0.6
        t = np.sort(np.concatenate([sample_times(step), readings[1:]]))
        t = t[(t >= 0.0) & (t < step.duration)]
        y = clean_signals(rig, {s.name: t for s in rig.steps})[step.name]
        plain = voltage(rig, step, Knobs(), t)[0]
        asked = np.isin(t, readings)
        assert np.abs(y - plain)[asked].max() < 1e-5 * step.beta
        # within each gap the same slope everywhere
        gaps = np.searchsorted(readings, t, side="right")
        for gap in np.unique(gaps):
            inside = (gaps == gap) & ~asked
            if inside.sum() > 3:
                line = np.polyfit(t[inside], y[inside], 1)
                assert np.abs(np.polyval(line, t[inside]) - y[inside]).max() < 1e-9
        before = (t < step.t0 - 2.0 * step.interval) & (y - step.y0 > 1e-4 * step.beta)
        early += int(before.sum())
        assert np.all(t[before] > step.t0 - 0.6)
        both = y[np.isin(t, sample_times(step))]
        assert np.abs(seen[step.name] - both).max() < 1e-5 * step.beta
    assert early > 0


def test_grease_yields_and_the_rms_is_shown_against_an_ode_solver() -> None:
    rig = case()
    step = rig.steps[0]
    exchange = step.total_flow / rig.V
    drag, sets, yields = 4.0, 12.0, 0.3

    def with_grease(u: float, x: FloatArray) -> list[float]:
        # the fourth state is by how much less than fully the grease has set
        stiff = 1.0 - x[3]
        speed = (u - x[0]) / (rig.tau_v * (1.0 + drag * stiff))
        gas = [exchange * (x[0] - x[1]), (x[1] - x[2]) / rig.tau]
        return [speed, *gas, stiff * abs(speed) / yields - x[3] / sets]

    t, states = solved(rig, with_grease, 4)
    knobs = Knobs(grease=drag, grease_time=sets, grease_stroke=yields)
    x, plain = (voltage(rig, step, some, t)[1] for some in (knobs, Knobs()))
    assert np.abs(x - states[:, 2]).max() < 1e-4
    # behind the ideal valve both ways, less so after the shorter rest
    up, down = (plain - x)[t < step.tf].max(), (x - plain)[t > step.tf].max()
    assert up > 1.1 * down > 0.1
    found = prepared_rig(case(stiff_grease=2.0))
    assert {k.grease for k in found.values()} == {2.0}
    assert len({(k.grease_time, k.grease_stroke) for k in found.values()}) == 1

    time_ = 0.5

    def with_rms(u: float, x: FloatArray) -> list[float]:
        y = step.y0 + step.beta * x[2]
        cascade = [(u - x[0]) / rig.tau_v, exchange * (x[0] - x[1]), (x[1] - x[2]) / rig.tau]
        return [*cascade, (y**2 - step.y0**2 - x[3]) / time_]

    t, states = solved(rig, with_rms, 4)
    y = voltage(rig, step, Knobs(rms_time=time_), t)[0]
    assert np.abs(y - np.sqrt(step.y0**2 + states[:, 3])).max() < 5e-5 * step.beta
    # ahead of the mean of what it follows at any time (Jensen), by more at the end of the fall
    mean = solve_mean(t, voltage(rig, step, Knobs(), t)[0], time_)
    assert (y - mean).min() > -1e-3 and (y - mean)[t > step.tf].max() > 0.1
    assert {k.rms_time for k in prepared_rig(case(rms_receiver=0.3)).values()} == {0.3}


def solve_mean(t: FloatArray, y: FloatArray, time_: float) -> FloatArray:
    """(n,) even samples ``y`` (n,) through a lag, from rest."""
    decay = np.exp(-(t[1] - t[0]) / time_)
    found: FloatArray = y[0] + lfilter([1.0 - decay], [1.0, -decay], y - y[0])
    return found


def test_water_dissolves_the_gas_and_a_pit_keeps_it_against_an_ode_solver() -> None:
    rig = case(washing_bottle=0.3)
    found, loaded = prepared_rig(rig), 0.0
    for k, step in enumerate(rig.steps):
        volume = found[step.name].dissolved_volume

        def with_water(
            u: float, x: FloatArray, step=step, start=loaded, volume=volume
        ) -> list[float]:
            # water filled to w takes 0.3 (1 - w) of what passes, and could hold 0.3 volume of gas
            gone = 0.3 * (1.0 - start - x[3])
            exchange = step.total_flow / rig.V * (x[0] * (1.0 - gone) - x[1])
            cascade = [(u - x[0]) / rig.tau_v, exchange]
            taken = step.test_gas_flow * x[0] * gone / (0.3 * volume)
            return [*cascade, (x[1] - x[2]) / rig.tau, taken]

        t, states = solved(rig, with_water, 4, k)
        x = voltage(rig, step, found[step.name], t)[1]
        assert np.abs(x - states[:, 2]).max() < 1e-4
        loaded += states[-1, 3]
        assert 0.0 < loaded < 1.0
    assert found[rig.steps[0].name].dissolved == 0.3 and loaded > 0.5

    rig = case()
    step = rig.steps[0]
    share, falling, lifted = 0.25, 20.0, 3.0

    def with_pit(u: float, x: FloatArray) -> list[float]:
        gap = x[1] - x[3]
        e = falling * max(gap, 0.0) ** 1.5 + lifted * min(gap, 0.0)
        main = (step.total_flow * (x[0] - x[1]) - e) / (rig.V * (1.0 - share))
        return [(u - x[0]) / rig.tau_v, main, (x[1] - x[2]) / rig.tau, e / (rig.V * share)]

    t, states = solved(rig, with_pit, 4)
    x = voltage(rig, step, Knobs(pit=share, pit_falling=falling, pit_lifted=lifted), t)[1]
    assert np.abs(x - states[:, 2]).max() < 1e-4
    # what came in and has not left is there: of a pulse all of it leaves in the end
    t = np.linspace(0.0, 400.0, 40_001)
    u = np.clip((t - 5.0) / 0.1, 0.0, 1.0) - np.clip((t - 25.0) / 0.1, 0.0, 1.0)
    out = pit(t, u, np.full_like(t, 60.0), 50.0, share, falling, lifted)
    assert np.trapezoid(out, t) == pytest.approx(20.0, rel=1e-5)
    held = np.cumsum(u - out) * 0.01 * 60.0 - 50.0 * (1.0 - share) * out  # mL, in the pit
    assert held[(t > 20.0) & (t < 25.0)].max() == pytest.approx(50.0 * share, rel=0.05)
    late = (t > 60.0) & (t < 100.0)
    # nothing falls in any more: the slow root of two volumes that trade linearly
    main, lower = 50.0 * (1.0 - share), 50.0 * share
    rates = np.linalg.eigvals([[-(60.0 + lifted) / main, lifted / main],
                               [lifted / lower, -lifted / lower]])  # fmt: skip
    slope = np.polyfit(t[late], np.log(out[late]), 1)[0]
    assert slope == pytest.approx(rates.max(), rel=1e-3)
    knobs = prepared_rig(case(heavy_gas_in_pit=0.2))
    heavy = [rig.relative_concentration(each) for each in rig.steps]
    fall = np.array([knobs[each.name].pit_falling for each in rig.steps])
    assert np.ptp(fall / np.sqrt(heavy)) < 1e-9 * fall.max()
    lift = [knobs[each.name].pit_lifted / each.total_flow for each in rig.steps]
    assert np.ptp(lift) < 1e-9 and {k.pit for k in knobs.values()} == {0.2}


def test_fronts_go_down_as_the_root_of_time_and_meet() -> None:
    t = np.linspace(0.0, 60.0, 60_001)
    time_ = 10.0

    def turned(*pieces: tuple[float, float]) -> FloatArray:
        drive = np.full_like(t, -0.3)
        for begin, value in pieces:
            drive[t >= begin] = value
        return moving_fronts(t, drive, time_)

    # alone: root of 2 drive t / time, whole at time / (2 drive); then back from the surface on
    x = turned((2.0, 0.5), (20.0, -0.25))
    expected = np.sqrt(np.clip((t - 2.0) / 10.0, 0.0, 1.0))
    expected -= np.sqrt(np.clip((t - 20.0) / 20.0, 0.0, 1.0))
    assert np.abs(x - expected)[(t < 1.99) | (t > 2.1)].max() < 0.01
    assert x[t < 2.0].max() == 0.0 and x[-1] == 0.0
    # given up halfway: a second front follows and catches up with the first, and all is gone
    x = turned((2.0, 0.5), (4.5, -0.5))
    at = (t > 4.6) & (t < 6.9)
    assert np.abs(x[at] - (0.5 - np.sqrt((t[at] - 4.5) / 10.0))).max() < 0.01
    assert np.all(x[t > 7.01] == 0.0)
    # and on again before it has: the third front meets the second, then the first goes on as if
    # nothing had been, its way being held up for as long as the two were there
    x = turned((2.0, 0.5), (4.5, -0.5), (5.0, 0.5))
    assert np.all(x >= 0.0)
    after = (t > 5.6) & (t < 12.9)
    assert np.abs(x[after] ** 2 - (t[after] - 3.0) / 10.0).max() < 0.01
    assert np.all(x[t > 13.1] == 1.0)

    rig = case(converting_film=0.2)
    ideal = clean_signals(without_causes(rig))
    for step in rig.steps:
        knobs = prepared_rig(rig)[step.name]
        relative = rig.relative_concentration(step)
        gained = (clean_signals(rig)[step.name] - ideal[step.name]) / step.beta * relative
        assert gained.min() > -1e-9 and gained.max() <= 0.2 + 1e-9
        assert 0.1 < knobs.converting_at < 0.35 and 3.0 < knobs.converting_time < 30.0
        # on the plateau the square of the depth is straight; too little gas turns nothing
        t, plain = sample_times(step), voltage(rig, step, Knobs(), sample_times(step))[1]
        slow = Knobs(converting=0.2, converting_at=0.15, converting_time=60.0)
        depth = (voltage(rig, step, slow, t)[1] - plain) * relative / 0.2
        flat = (t > step.t0 + 8.0) & (t < step.tf)
        slope, _ = np.polyfit(t[flat], depth[flat] ** 2, 1)
        assert slope == pytest.approx(2.0 * (relative - 0.15) / 60.0, rel=0.01)
        none = Knobs(converting=0.2, converting_at=relative + 0.01)
        assert np.array_equal(voltage(rig, step, none, t)[1], plain)


def test_gas_breaks_through_the_reference_rings_cap() -> None:
    times, weights = slab(20.0)
    assert weights.sum() == pytest.approx(1.0)
    assert weights @ times == pytest.approx(10.0, rel=5e-3)  # mean delay of half the time
    t = np.concatenate([[-1e-6], np.linspace(0.0, 60.0, 6001)])
    x = modal(t, (t >= 0).astype(float), times, weights)
    z = np.sqrt(np.maximum(t, 1e-9) / 20.0)
    images = sum(2.0 * (-1.0) ** k * erfc((2 * k + 1) / (2.0 * z)) for k in range(6))
    # short-time series of the same problem, by images; few modes see the very first moment poorly
    assert np.abs(x - images)[t > 0.3].max() < 5e-3

    strength = 0.3
    rig = case(leaking_reference=strength)
    for step in rig.steps:
        t = sample_times(step)
        x, plain = (
            voltage(rig, step, some, t)[1] for some in (prepared_rig(rig)[step.name], Knobs())
        )
        time_ = prepared_rig(rig)[step.name].reference_time
        assert 8.0 < time_ < 80.0
        gone = (plain - x) / strength
        # before a twentieth of the time nothing has come through; later the sum of both steps
        assert np.abs(gone[t < step.t0 + 0.02 * time_]).max() < 5e-3
        delay = rig.tau_v + rig.V / step.total_flow + rig.tau

        def through(since: FloatArray, time_: float = time_) -> FloatArray:
            z = np.sqrt(np.maximum(since, 1e-9) / time_)
            terms = [2.0 * (-1.0) ** k * erfc((2 * k + 1) / (2.0 * z)) for k in range(8)]
            return np.where(since > 0.0, np.sum(terms, axis=0), 0.0)

        both = through(t - step.t0 - delay) - through(t - step.tf - delay)
        assert np.abs(gone - both).max() < 0.05
        assert gone[-1] > 0.05 and x[-1] < 0.0


def test_clouds_warm_the_cell_and_a_beat_passes_through_zero() -> None:
    strength = 0.2
    rig = case(sun_on_the_cell=strength)
    seen, plain = clean_signals(rig), clean_signals(without_causes(rig))
    times = []
    for step in rig.steps:
        (course,) = prepared_rig(rig)[step.name].concentration_gain
        t = np.arange(0.0, step.duration, 1e-3)
        warmth = -np.log1p(course(t)) / strength
        assert warmth.min() >= -1e-12 and warmth.max() <= 1.0 + 1e-12
        # warming towards 1 or cooling towards 0 at one rate, and nothing else
        rate, middle = np.diff(warmth) / 1e-3, 0.5 * (warmth[1:] + warmth[:-1])
        rising, falling = rate > 1e-6, rate < -1e-6
        found = np.concatenate(
            [(1.0 - middle[rising]) / rate[rising], -middle[falling] / rate[falling]]
        )
        times.append(np.median(found))
        assert np.mean(np.abs(found / times[-1] - 1.0) < 1e-3) > 0.99
        assert np.abs(np.diff(warmth)).max() < 1e-3 / 2.0  # it never jumps
        s = sample_times(step)
        gain = (seen[step.name] - step.y0) / (plain[step.name] - step.y0 + 1e-12)
        on = (s > step.t0 + 0.5) & (s < step.tf)
        assert np.abs(gain - 1.0 - course(s))[on].max() < 1e-6
        assert np.abs(seen[step.name] - plain[step.name])[s < step.t0].max() == 0.0
    assert np.ptp(times) < 1e-3 and 2.0 < times[0] < 15.0

    rig = case(beating_supply=0.05)
    size = 0.05 * np.mean([step.beta for step in rig.steps])
    rates, pulls, begins = [], [], []
    for step in rig.steps:
        (course,) = prepared_rig(rig)[step.name].offset
        t = np.arange(0.0, step.duration, 1e-4)
        y = course(t) / size
        assert 0.99 < np.abs(y).max() <= 1.0 + 1e-12
        # sin'' = -(angle')^2 sin + angle'' cos: where the sine is 0, its slope is the frequency
        zero = np.flatnonzero(np.diff(np.sign(y)) != 0)
        f = np.abs(np.diff(y))[zero] / 1e-4 / (2.0 * np.pi)
        first = f[:2].mean()
        assert 1.5 < first < 16.0
        assert f.min() < 0.5 * f.max() or f.min() < 1.0
        # its only jumps of frequency are at the commands, of one size either way
        jumps = []
        for command in (step.commanded_on, step.commanded_off):
            h = 1e-4
            fine = np.array([command - 2 * h, command - h, command, command + h, command + 2 * h])
            angle = np.unwrap(np.arcsin(np.clip(course(fine) / size, -1.0, 1.0)))
            slopes = np.diff(angle) / h / (2.0 * np.pi)
            jumps.append(abs(abs(slopes[2]) - abs(slopes[1])))
        pulls.append(max(jumps))
        rates.append(first)
        begins.append(y[0])
        s = sample_times(step)
        moved = clean_signals(rig)[step.name] - clean_signals(without_causes(rig))[step.name]
        assert np.allclose(moved, course(s), atol=1e-9)
    assert np.ptp(begins) > 0.01
    assert 0.15 < min(pulls) and max(pulls) < 3.1


def test_two_valves_take_turns_unequally_against_an_ode_solver() -> None:
    rig = case()
    step = rig.steps[0]
    test, carrier = step.test_gas_flow, step.carrier_flow
    for on, off in ((0.9, 1.6), (-0.7, -1.1)):
        # each valve has a command of its own, and follows it in the same time
        inputs = [(0.0, (0.0, 0.0))]
        for at, valve, up in sorted(
            [(step.t0, 0, 1.0), (step.tf, 0, 0.0), (step.t0 + on, 1, 1.0), (step.tf + off, 1, 0.0)]
        ):
            both = list(inputs[-1][1])
            both[valve] = up
            inputs.append((at, (both[0], both[1])))

        def with_two(u: Any, x: FloatArray) -> list[float]:
            flow = carrier + test * x[0] + test * (1.0 - x[3])
            inlet = test * x[0] / flow / step.concentration
            gas = [flow / rig.V * (inlet - x[1]), (x[1] - x[2]) / rig.tau]
            return [(u[0] - x[0]) / rig.tau_v, *gas, (u[1] - x[3]) / rig.tau_v]

        t, states = solved(rig, with_two, 4, inputs=inputs)
        marks = [step.t0 + on, step.tf + off]
        knobs = Knobs(made_up_late=(on, off), mixing=True, marks=marks)
        x, plain = (voltage(rig, step, some, t)[1] for some in (knobs, Knobs()))
        assert np.abs(x - states[:, 2]).max() < 1e-4
        # late: thinner on the way up and kept on the way down; early: the other way round
        up, down = (x - plain)[t < step.tf - 2.0], (x - plain)[t > step.tf]
        late = on > 0.0
        assert (up.min() < -0.01) == late and (up.max() > 0.01) == (not late)
        assert (down.max() > 0.01) == late and (down.min() < -0.01) == (not late)
        # in the end both are where they belong
        assert abs(x[t < step.tf - 2.0][-1] - plain[t < step.tf - 2.0][-1]) < 1e-3
    found = {knobs.made_up_late for knobs in prepared_rig(case(unequal_valves=1.0)).values()}
    ((first, second),) = found
    assert first * second > 0.0
    assert 0.4 <= min(abs(first), abs(second)) <= max(abs(first), abs(second)) <= 1.0


def test_drops_boil_off_as_their_diameter() -> None:
    strength, largest, slopes = 0.3, [], []
    for seed in (11, 12, 13):
        rig = replace(draw_case(seed, size="small"), strengths={"spitting_bottle": strength})
        found = 0
        for step in rig.steps:
            courses = prepared_rig(rig)[step.name].test_gas
            if not courses:
                continue
            found += 1
            marks = np.sort(prepared_rig(rig)[step.name].marks)
            t = np.linspace(0.0, step.duration, 300_001)
            more = courses[0](t) - 1.0
            assert more.min() == 0.0 and np.all(more[t < marks[0]] == 0.0)
            # between edges with one drop there the square falls in a straight line, to zero
            drops = np.sum(np.diff(marks) < 1e-5)
            assert 1 <= drops <= 3
            if drops > 1:
                continue
            inside = (t > marks[1]) & (t < marks[2])
            line = np.polyfit(t[inside], more[inside] ** 2, 1)
            assert np.abs(np.polyval(line, t[inside]) - more[inside] ** 2).max() < 1e-9
            assert -line[1] / line[0] == pytest.approx(marks[2], abs=1e-6)
            slopes.append((seed, -(strength**2) / line[0]))  # s, of the largest drop there can be
            largest.append(float(more.max()))
            assert np.all(more[t > marks[2] + 1e-3] == 0.0)
        assert found >= 1
    assert len(largest) >= 2 and max(largest) <= strength
    assert all(1.5 <= longest <= 10.0 for _, longest in slopes)
    for seed in (11, 12, 13):  # all drops of one bottle boil alike
        one = [longest for name, longest in slopes if name == seed]
        assert not one or np.ptp(one) < 1e-6
    # the gas that a slow drop adds: full/(carrier + full) of the inlet, as the mixing rule has it
    rig = case()
    step = rig.steps[0]
    t = sample_times(step)
    y = voltage(rig, step, Knobs(test_gas=[lambda t: np.full_like(t, 1.2)]), t)[1]
    more = 1.2 * step.test_gas_flow
    at = np.searchsorted(t, step.tf) - 1
    expected = more / (more + step.carrier_flow) / step.concentration
    assert y[at] == pytest.approx(expected, rel=2e-3)


def test_streaks_stray_at_random_and_are_right_in_the_mean() -> None:
    strength, strays, apart = 0.2, [], []
    for seed in range(11, 21):
        rig = replace(draw_case(seed, size="small"), strengths={"streaky_inlet": strength})
        own = []
        for step in rig.steps:
            (course,) = prepared_rig(rig)[step.name].unmixed
            t = np.linspace(0.0, step.duration, 30_001)
            stray = (course(t) - 1.0) / strength
            strays.append(stray)
            # straight between knots that are evenly apart: bends there and nowhere else
            bends = t[1:-1][np.abs(np.diff(stray, 2)) > 1e-7]
            first = bends[np.concatenate([[True], np.diff(bends) > 2e-3])]
            own.append(float(np.median(np.diff(first))) * step.total_flow)
            assert np.abs(np.diff(first) * step.total_flow / own[-1] - 1.0).max() < 0.05
        assert np.ptp(own) < 0.02 * max(own)  # an eddy of one volume
        apart.append(own[0] / np.median([step.total_flow for step in rig.steps]))
    assert 0.29 < min(apart) < max(apart) < 2.05 and max(apart) > 2.0 * min(apart)
    every = np.concatenate(strays)
    assert abs(every.mean()) < 0.1 and every.std() == pytest.approx(1.0, abs=0.1)

    # the same strays through the cascade by an ODE solver
    rig = case(streaky_inlet=strength)
    knobs, step = prepared_rig(rig)["1"], rig.steps[0]
    (course,) = knobs.unmixed

    def with_streaks(u: float, x: FloatArray) -> list[float]:
        fed = x[0] * float(course(x[3:])[0])
        gas = step.total_flow / rig.V * (fed - x[1])
        return [(u - x[0]) / rig.tau_v, gas, (x[1] - x[2]) / rig.tau, 1.0]

    knots = sorted(knobs.marks)
    commands = [(0.0, 0.0), *[(at, float(step.t0 < at < step.tf)) for at in knots]]
    commands = sorted([*commands, (step.t0, 1.0), (step.tf, 0.0)])
    t, states = solved(rig, with_streaks, 4, inputs=commands)
    x, plain = (voltage(rig, step, some, t)[1] for some in (knobs, Knobs()))
    assert np.abs(x - states[:, 2]).max() < 5e-5
    assert np.array_equal(x[t < step.t0], plain[t < step.t0])
    assert np.abs(x - plain).max() > 0.03


def test_a_front_eats_its_way_evenly_into_the_glass() -> None:
    t = np.linspace(0.0, 40.0, 40_001)
    gas = np.where((t >= 5.0) & (t < 20.0), 0.6, 0.0)
    m = glassy(t, gas, 0.25, 1.5)
    up = np.minimum(0.6 * 0.25 * (t - 5.0), 0.6)  # through after 4 s
    expected = np.where(t < 5.0, 0.0, np.where(t < 20.0, up, 0.6 * np.exp(-(t - 20.0) / 1.5)))
    assert np.abs(m - expected).max() < 5e-4
    # weaker gas needs as much longer as it is weaker when the speed goes with the concentration
    half = glassy(t, np.where(t >= 5.0, 1.0, 0.0), 0.1, 1.5)
    assert t[half >= 1.0 - 1e-9][0] == pytest.approx(15.0, abs=0.01)

    strength = 0.2
    rig = case(glassy_rim=strength)
    found = prepared_rig(rig)
    assert len({(k.rim, k.rim_time, k.rim_back) for k in found.values()}) == 1
    assert 1.0 < found["1"].rim_time < 8.0
    assert 0.1 < found["1"].rim_back / found["1"].rim_time < 0.5
    for step in rig.steps:
        t, relative = sample_times(step), rig.relative_concentration(step)
        knobs = Knobs(rim=strength, rim_time=4.0, rim_back=1.0)
        x, plain = (voltage(rig, step, some, t)[1] for some in (knobs, Knobs()))
        rim = (x - (1.0 - strength) * plain) / strength
        settled = (t > step.t0 + 4.0) & (t < step.tf) & (rim < 0.99)
        if settled.sum() > 10:
            slope = np.polyfit(t[settled], rim[settled], 1)[0]
            assert slope == pytest.approx(relative / 4.0, rel=0.02)
        through = step.t0 + rig.tau_v + rig.V / step.total_flow + 4.0 / relative
        if through + 0.5 < step.tf:
            assert np.abs(x - plain)[(t > through + 0.5) & (t < step.tf)].max() < 5e-3
        down = t > step.tf + 4.5
        if rim[down][0] > 1e-3:
            rate = np.polyfit(t[down], np.log(np.maximum(rim[down], 1e-12)), 1)[0]
            assert rate < -0.5


def test_the_ring_pulses_within_a_range_of_concentrations() -> None:
    strength = 0.1
    rig = case(pulsing_ring=strength)
    found, seen = prepared_rig(rig), clean_signals(rig)
    size, begins = strength * np.mean([step.beta for step in rig.steps]), set()
    for step in rig.steps:
        knobs, t = found[step.name], sample_times(step)
        begins.add(knobs.pulsing_begin)
        assert knobs.pulsing == pytest.approx(size)
        plain, x = voltage(rig, step, Knobs(), t)
        pulse = seen[step.name] - plain
        away = (rig.relative_concentration(step) * x - knobs.pulsing_at) / knobs.pulsing_width
        inside = np.abs(away) < 1.0
        assert np.abs(pulse[~inside]).max() < 1e-6
        # a circle: the amplitude squared and the distance from the middle squared make 1
        most = size * np.sqrt(1.0 - away[inside] ** 2) * (1.0 + knobs.pulsing_second)
        assert np.all(np.abs(pulse[inside]) <= most + 1e-9)
    assert len(begins) == len(rig.steps)
    assert 0.35 < knobs.pulsing_at < 0.75 and 0.12 < knobs.pulsing_width < 0.3

    # held at a concentration it is a sine of the pulled frequency
    step = max(rig.steps, key=lambda each: each.concentration)
    still = Knobs(pulsing=0.1, pulsing_at=0.9, pulsing_width=0.2, pulsing_rate=3.0,
                  pulsing_pull=0.4, pulsing_begin=0.3)  # fmt: skip
    t = np.arange(step.tf - 4.0, step.tf, 1e-3)
    pulse = (voltage(rig, step, still, t)[0] - voltage(rig, step, Knobs(), t)[0]) / 0.1
    assert pulse.max() == pytest.approx(np.sqrt(0.75), abs=2e-3)
    ups = t[1:][(pulse[1:] > 0.0) & (pulse[:-1] <= 0.0)]
    assert np.diff(ups) == pytest.approx(1.0 / (3.0 * 1.2), abs=2e-3)
    # both harmonics: the mean square is half of 1 + share^2 of the first's
    both = replace(still, pulsing_second=0.4)
    pulse = (voltage(rig, step, both, t)[0] - voltage(rig, step, Knobs(), t)[0]) / 0.1
    turns = (t >= ups[0]) & (t < ups[-1])
    assert np.mean(pulse[turns] ** 2) == pytest.approx(0.5 * 0.75 * 1.16, rel=0.01)


def test_the_lift_passes_as_a_dipole() -> None:
    strength, asides = 0.1, []
    for seed in (11, 12, 13, 14):
        rig = replace(draw_case(seed, size="small"), strengths={"passing_lift": strength})
        seen, plain = clean_signals(rig), clean_signals(without_causes(rig))
        for step in rig.steps:
            courses = prepared_rig(rig)[step.name].gain
            if not courses:
                assert np.array_equal(seen[step.name], plain[step.name])
                continue
            t = np.linspace(0.0, 4.0 * step.duration, 200_001)
            gain = courses[0](t)
            assert gain[0] == 0.0 and np.all(gain[t < 0.05 * step.duration] == 0.0)
            assert gain.max() <= strength and gain.min() >= -strength
            assert np.abs(np.diff(gain)).max() < 2e-3  # it starts and stops softly
            # the least light when it is right here, and at rest that of floors 3.5 m apart
            rest = gain[1:][np.diff(gain) == 0.0]
            first = 1.0 + gain.min() / strength  # the field where it stood, of that here
            possible = set()
            for floor in (1, 2, 3):
                aside = 3.5 * floor / np.sqrt(first ** (-2.0 / 3.0) - 1.0)
                fields = (1.0 + (3.5 * np.arange(4) / aside) ** 2) ** -1.5
                away = np.abs((first - rest / strength)[:, None] - fields)
                if 2.0 <= aside <= 6.0 and away.min(axis=1).max() < 1e-4:
                    possible.add(round(float(aside), 2))
            asides.append((seed, possible))
            s = sample_times(step)
            moved = seen[step.name] / plain[step.name] - 1.0
            assert np.abs(moved - courses[0](s)).max() < 1e-9
    assert len(asides) >= 6
    for seed in (11, 12, 13, 14):  # of all records of a rig one
        assert set.intersection(*(some for name, some in asides if name == seed))


def test_a_logarithmic_amplifier_is_as_quick_as_its_light() -> None:
    # a step of light from a to b: the logistic curve, up and down
    t = np.linspace(0.0, 20.0, 20_001)
    for a, b in ((0.1, 2.0), (2.0, 0.1)):
        v = log_amplifier(t, np.where(t >= 1.0, b, a), 0.3)
        since = np.maximum(t - 0.9995, 0.0)  # between two nodes
        expected = np.where(t < 1.0, a, b / (1.0 + (b / a - 1.0) * np.exp(-b * since / 0.3)))
        assert np.abs(v - expected).max() < 2e-3

    rig = case()
    step = rig.steps[0]
    dark, time_ = 0.1, 0.25

    def with_amplifier(u: float, x: FloatArray) -> list[float]:
        light = step.y0 + step.beta * x[2] + dark
        own = step.y0 + dark + x[3]
        cascade = [(u - x[0]) / rig.tau_v, step.total_flow / rig.V * (x[0] - x[1])]
        return [*cascade, (x[1] - x[2]) / rig.tau, own * (light - own) / time_]

    t, states = solved(rig, with_amplifier, 4)
    y, x = voltage(rig, step, Knobs(log_time=time_, log_dark=dark), t)
    assert np.abs(y - step.y0 - states[:, 3]).max() < 5e-5 * step.beta
    assert np.abs(x - states[:, 2]).max() < 5e-5
    plain = voltage(rig, step, Knobs(), t)[0]
    assert np.all((plain - y)[t < step.tf] > -1e-6) and np.all((y - plain)[t > step.tf] > -1e-6)
    strength, full = 0.1, max(each.y0 + each.beta for each in rig.steps)
    ((time_, dark),) = {
        (k.log_time, k.log_dark) for k in prepared_rig(case(log_receiver=strength)).values()
    }
    assert 0.03 < dark / np.mean([each.y0 for each in rig.steps]) < 1.0
    assert time_ == pytest.approx(strength * (full + dark))


def test_a_meter_that_runs_down_takes_longer_far_from_its_zero() -> None:
    strength = 0.3
    rig = case(running_down_meter=strength)
    highest, zeros = max(step.beta for step in rig.steps), []
    plain = {step.name: voltage(rig, step, Knobs(), sample_times(step))[0] for step in rig.steps}
    seen = clean_signals(rig)
    for step, t, true in on_its_clock(rig):
        assert np.all(np.diff(true) > 0.0) and abs(true[0]) < 1e-9
        assert np.abs(true - t)[t < step.t0].max() < 1e-9  # right in the baseline
        # how long a reading took, as the voltage was then: a vee about one zero
        y = voltage(rig, step, Knobs(), true)[0]
        longer = (np.diff(true) / np.diff(t) - 1.0) / strength
        middle = 0.5 * (y[1:] + y[:-1])
        up = (middle > step.y0 + 0.4 * highest) & (t[1:] < step.tf)
        if up.any():
            # |y - zero| - |y0 - zero| with zero between: y + y0 - 2 zero
            zeros.append(float(np.mean(0.5 * (middle + step.y0 - longer * highest)[up])))
            spread = (middle + step.y0 - longer * highest)[up]
            if zeros[-1] > step.y0:
                assert np.ptp(spread) < 2e-3 * highest
        assert np.abs(seen[step.name] - y).max() < 1e-6
        assert not np.allclose(seen[step.name], plain[step.name], atol=0.02)
        at = np.searchsorted(true, step.tf)
        assert t[at] < step.tf  # filed too early: the pulse looks short
    assert zeros

    # in its own time every rate of the rig is as many times what it was
    zero = float(np.median(zeros))
    assert np.ptp(zeros) < 2e-3 * highest
    assert 0.0 <= zero - np.mean([step.y0 for step in rig.steps]) <= 0.35 * highest
    step = rig.steps[0]

    def rates(u: float, x: FloatArray) -> list[float]:
        away = abs(step.y0 + step.beta * x[2] - zero) - abs(step.y0 - zero)
        own = [u - x[0], x[0] - x[1], x[1] - x[2]]
        taus = (rig.tau_v, rig.V / step.total_flow, rig.tau)
        faster = 1.0 + strength * away / highest
        return [faster * rate / tau for rate, tau in zip(own, taus, strict=True)]

    t, states = solved(rig, rates, 3, inputs=[(0.0, 0.0), (step.t0, 1.0)])
    rising = t < step.tf - strength * (step.tf - step.t0) - 0.5
    y = (seen[step.name] - step.y0) / step.beta
    assert np.abs(y - states[:, 2])[rising].max() < 1e-3
    assert np.abs(y - (plain[step.name] - step.y0) / step.beta)[rising].max() > 0.01


def test_a_wound_up_controller_is_wide_open_until_it_is_unwound() -> None:
    strength, rests, wide = 0.4, [], []
    rig = case(wound_up_controller=strength)
    found, seen = prepared_rig(rig), clean_signals(rig)
    for k, step in enumerate(rig.steps):
        (flow,), (settles,) = found[step.name].test_gas, found[step.name].marks
        before = rig.steps[k - 1].duration - rig.steps[k - 1].tf if k > 0 else 0.0
        rests.append(before + step.t0)
        wide.append(settles - step.t0)
        t = np.linspace(0.0, step.duration, 60_001)
        excess = flow(t) / strength - 1.0 / strength
        assert np.all(excess[t < step.t0] == 0.0)
        at_stop = (t > step.t0) & (t < settles)
        assert at_stop.any() and np.allclose(excess[at_stop], 1.0)
        # beyond that one exponential, of one time for all
        later = t > settles
        rate = np.diff(np.log(excess[later][:2000])) / (t[1] - t[0])
        assert np.ptp(rate) < 1e-6
        assert 0.3 < -1.0 / rate[0] < 2.0
    # the longer it rested, the longer
    assert np.allclose(np.array(wide) / rests, wide[0] / rests[0]) and np.ptp(rests) > 1.0
    assert 0.8 < max(wide) < 6.0

    step, knobs = rig.steps[1], found["2"]
    full, settles = step.test_gas_flow, knobs.marks[0]
    (flow,) = knobs.test_gas

    def wound_up(u: float, x: FloatArray) -> list[float]:
        more = full * float(flow(x[3:])[0])
        inlet = x[0] * more / (step.carrier_flow + more) / step.concentration
        total = step.carrier_flow + more * x[0] + full * (1.0 - x[0])
        gas = total / rig.V * (inlet - x[1])
        return [(u - x[0]) / rig.tau_v, gas, (x[1] - x[2]) / rig.tau, 1.0]

    inputs = [(0.0, 0.0), (step.t0, 1.0), (settles, 1.0), (step.tf, 0.0)]
    t, states = solved(rig, wound_up, 4, k=1, inputs=inputs)
    assert np.abs((seen["2"] - step.y0) / step.beta - states[:, 2]).max() < 5e-5
    assert states[:, 2].max() > 1.05


def test_dryers_take_turns_and_moisture_breaks_through() -> None:
    strength = 0.1
    rig = case(alternating_dryers=strength)
    found, turns = prepared_rig(rig), []
    for step in rig.steps:
        (moist,) = found[step.name].seep
        marks = np.sort(found[step.name].marks)
        most = strength * rig.highest_concentration * step.carrier_flow
        changes = 0.5 * (marks[::2] + marks[1::2])
        turns += np.diff(changes).tolist()
        assert changes[0] <= 0.0 and changes[-1] < step.duration
        assert moist(changes - 1e-7) == pytest.approx(most, rel=1e-4)
        assert np.all(moist(changes + 1e-7) < 0.2 * most)  # a fresh column
        t = np.linspace(0.0, step.duration, 20_001)
        assert moist(t).max() <= most * (1.0 + 1e-12) and moist(t).min() > 0.0
        # a logistic curve: its inverse falls by a constant ratio to what is all of it
        s = np.linspace(changes[-1] + 1e-3, min(changes[-1] + 4.0, step.duration), 7)
        inverse = most / moist(s)
        ratios = np.diff(inverse)[1:] / np.diff(inverse)[:-1]
        assert np.ptp(ratios) < 1e-6 and 0.0 < ratios[0] < 1.0
    turn = turns[0]
    assert np.ptp(turns) < 1e-6 and 5.0 < turn < 30.0
    for knobs in found.values():
        (moist,) = knobs.seep
        t = np.linspace(0.0, 60.0, 3011)
        assert np.allclose(moist(t + 3.0 * turn), moist(t))
    assert len({round(min(knobs.marks) % turn, 6) for knobs in found.values()}) == len(rig.steps)

    # through the cascade, with a first turn that begins before the record
    step, knobs = rig.steps[0], prepared_rig(rig)["1"]
    (moist,) = knobs.seep

    def with_moisture(u: float, x: FloatArray) -> list[float]:
        inlet = x[0] + float(moist(x[3:])[0]) / step.total_flow / step.concentration
        gas = step.total_flow / rig.V * (inlet - x[1])
        return [(u - x[0]) / rig.tau_v, gas, (x[1] - x[2]) / rig.tau, 1.0]

    changes = [at for at in knobs.marks[1::2] if 0.0 < at < step.duration]
    commands = [(0.0, 0.0), (step.t0, 1.0), (step.tf, 0.0)]
    commands += [(at, float(step.t0 < at < step.tf)) for at in changes]
    t, states = solved(rig, with_moisture, 4, inputs=sorted(commands))
    x = voltage(rig, step, knobs, t)[1]
    after = t > 12.0 * rig.V / step.total_flow  # what the oracle of zero does not know is forgotten
    assert after.mean() > 0.3
    assert np.abs(x - states[:, 2])[after].max() < 1e-4


def test_gas_gurgles_past_the_water_in_gulps_of_one_volume() -> None:
    strength, gulps, begins = 0.6, [], []
    rig = case(gurgling_hose=strength)
    found, seen = prepared_rig(rig), clean_signals(rig)
    for step in rig.steps:
        (flow,) = found[step.name].all_flow
        t = np.linspace(0.0, step.duration, 600_001)
        part = flow(t)
        assert part.min() == pytest.approx(1.0 - strength)
        ups = t[1:][np.diff(part) > 0.5]
        period = np.diff(ups).mean()
        assert np.abs(np.diff(ups) / period - 1.0).max() < 0.01
        gulps.append(period * step.total_flow / rig.V)
        begins.append(ups[0] / period)
        # what is held back comes later: over whole periods nothing is lost
        whole = (t >= ups[0]) & (t < ups[-1])
        assert part[whole].mean() == pytest.approx(1.0, abs=2e-3)
        shut = np.mean(part[whole] == part.min())
        assert 0.65 < shut < 0.9
        # a burst falls to exp(-3) of what it was, and its volume is the share of a period's
        burst = part[whole] - part.min()
        assert burst[burst > 0.0].max() / burst[burst > 0.0].min() == pytest.approx(
            np.exp(3.0), rel=0.05
        )
        plain = voltage(rig, step, Knobs(), sample_times(step))[0]
        last = (sample_times(step) > step.tf - 0.5) & (sample_times(step) < step.tf)
        assert np.abs(seen[step.name] - plain)[last].max() < 1e-3 * step.beta
    assert np.ptp(gulps) < 1e-3 and 0.3 < gulps[0] < 1.5
    assert np.ptp(begins) > 0.01

    # the time of the exchange is the gas that has passed: an ODE solver, burst by burst
    step = min(rig.steps, key=lambda each: each.total_flow)
    k, (flow,) = rig.steps.index(step), found[step.name].all_flow

    def in_gulps(u: float, x: FloatArray) -> list[float]:
        gas = step.total_flow * float(flow(x[3:])[0]) / rig.V * (x[0] - x[1])
        return [(u - x[0]) / rig.tau_v, gas, (x[1] - x[2]) / rig.tau, 1.0]

    edges = [0.5 * (low + high) for low, high in zip(*[iter(sorted(found[step.name].marks))] * 2)]
    commands = [(at, float(step.t0 < at < step.tf)) for at in edges]
    commands = sorted([(0.0, 0.0), (step.t0, 1.0), (step.tf, 0.0), *commands])
    t, states = solved(rig, in_gulps, 4, k=k, inputs=commands)
    x = (seen[step.name] - step.y0) / step.beta
    assert np.abs(x - states[:, 2]).max() < 2e-4
    plain = voltage(rig, step, Knobs(), t)[1]
    assert np.abs(x - plain).max() > 0.02


def test_breaths_come_in_a_row_and_end() -> None:
    strength, periods = 0.15, []
    for seed in (11, 12, 13):
        rig = replace(draw_case(seed, size="small"), strengths={"breathing_operator": strength})
        seen, plain = clean_signals(rig), clean_signals(without_causes(rig))
        found = 0
        for step in rig.steps:
            courses, marks = prepared_rig(rig)[step.name].seep, prepared_rig(rig)[step.name].marks
            if not courses:
                assert np.array_equal(seen[step.name], plain[step.name])
                continue
            found += 1
            t = np.linspace(0.0, 2.0 * step.duration, 200_001)
            breath = courses[0](t) / (strength * rig.highest_concentration * step.total_flow)
            out = breath > 1e-9
            begins, ends = t[1:][np.diff(out.astype(int)) > 0], t[1:][np.diff(out.astype(int)) < 0]
            assert 2 <= len(begins) == len(ends) <= 7
            assert np.allclose(marks[::2], begins[begins < step.duration], atol=2e-3)
            periods += [(seed, gap) for gap in np.diff(begins)]
            for begin, end in zip(begins, ends, strict=True):
                own = breath[(t >= begin - 1e-3) & (t <= end + 1e-3)]
                assert 0.6 - 1e-6 <= own.max() <= 1.0
                # half a sine: its mean is 2/pi of its height
                assert own.mean() / own.max() == pytest.approx(2.0 / np.pi, rel=0.01)
            # all that was breathed in passes the sensor: an integral over the flow
            if ends[-1] < step.duration - 15.0 * (rig.V / step.total_flow + rig.tau):
                s = sample_times(step)
                extra = (seen[step.name] - plain[step.name]) / step.beta
                fed = np.trapezoid(courses[0](t), t) / step.total_flow / step.concentration
                assert np.trapezoid(extra, s) == pytest.approx(fed, rel=2e-3)
        assert found >= 1
    for seed in (11, 12, 13):
        own = [gap for name, gap in periods if name == seed]
        assert max(own) / min(own) < 1.15 / 0.85 + 1e-2 and 2.1 < min(own) and max(own) < 5.8


def test_islands_spread_evenly_and_shrink_again() -> None:
    t = np.linspace(0.0, 60.0, 60_001)
    gas = np.where((t >= 5.0) & (t < 15.0), 0.8, 0.0)
    covered = islands(t, gas - 0.3, 4.0)
    r = np.clip(0.5 / 4.0 * (t - 5.0), 0.0, None)
    r = np.where(t < 15.0, r, np.maximum(1.25 - 0.3 / 4.0 * (t - 15.0), 0.0))
    assert np.abs(covered - (1.0 - np.exp(-(r**2)))).max() < 1e-3
    assert np.all(covered[t < 5.0] == 0.0) and np.all(covered[t > 32.0] == 0.0)
    assert np.all(islands(t, np.full(len(t), -0.1), 1.0) == 0.0)
    # they meet: after any time above their vapour pressure they take as long to go
    for end in (15.0, 30.0):
        met = islands(t, np.where(t < end, 0.7, -0.3), 1.0)
        assert met.max() == pytest.approx(1.0 - np.exp(-4.0))
        assert t[met > 0.0].max() - end == pytest.approx(2.0 / 0.3, abs=0.01)

    strength = 0.2
    rig = case(spreading_islands=strength)
    ((vapour, time_),) = {
        (knobs.islands_vapour, knobs.islands_time) for knobs in prepared_rig(rig).values()
    }
    assert 0.1 < vapour < 0.35 and 0.2 < time_ < 2.0
    for step in rig.steps:
        t, relative = sample_times(step), rig.relative_concentration(step)
        fine = np.linspace(0.0, step.duration, 60_001)
        # without the sensor's own delay the response is the gas
        quick = replace(rig, tau=1e-9)
        gas = voltage(quick, step, Knobs(), fine)[1]
        r, radius = 0.0, []
        for drive in (relative * gas - vapour) / time_ * (fine[1] - fine[0]):
            radius.append(r)
            r = min(max(r + drive, 0.0), 2.0)
        expected = strength / relative * (1.0 - np.exp(-np.square(radius)))
        x, plain = (
            voltage(rig, step, some, t)[1] for some in (prepared_rig(rig)[step.name], Knobs())
        )
        assert np.abs(x - plain - np.interp(t, fine, expected)).max() < 5e-3
        below = relative * gas.max() < vapour
        assert (np.abs(x - plain).max() == 0.0) == below


def test_the_table_is_levelled_evenly_and_tilts_back() -> None:
    strength, rates = 0.1, []
    for seed in (11, 12, 13, 14):
        rig = replace(draw_case(seed, size="small"), strengths={"leaning_visitor": strength})
        seen, plain = clean_signals(rig), clean_signals(without_causes(rig))
        for step in rig.steps:
            courses, marks = prepared_rig(rig)[step.name].gain, prepared_rig(rig)[step.name].marks
            if not courses:
                assert np.array_equal(seen[step.name], plain[step.name])
                continue
            t = np.linspace(0.0, 100.0, 400_001)
            gain = 1.0 + courses[0](t)
            assert gain[0] == 1.0 and gain[-1] == 1.0 and gain.min() >= 1.0 - strength - 1e-12
            tilt = np.sqrt(np.log(gain) / np.log(1.0 - strength))
            slope = np.diff(tilt) / (t[1] - t[0])
            jumps = np.flatnonzero(np.abs(np.diff(tilt)) > 0.05)
            assert len(jumps) in (2, 4)
            # between, never anything but rest and one rate
            steady = slope[slope < -1e-6]
            steady = steady[steady > -1.1]
            rates.append((seed, -1.0 / float(np.median(steady))))
            moves = np.delete(slope, jumps)
            at_rest, even = np.abs(moves) < 1e-6, np.abs(moves * rates[-1][1] + 1.0) < 1e-4
            assert np.sum(~(at_rest | even)) <= 2 * len(jumps)  # where it comes to rest
            first, back = jumps[0], jumps[1]
            weight = tilt[first + 1]
            assert 0.5 <= weight <= 1.0
            # letting go is a push of the same weight the other way
            assert tilt[back + 1] == pytest.approx(weight - tilt[back], abs=1e-3)
            edges = np.array([at for at in t[jumps + 1] if at < step.duration])
            assert np.allclose(np.asarray(marks)[1::2], edges, atol=1e-3)
            s = sample_times(step)
            away = np.min(np.abs(s[:, None] - edges), axis=1) > 1e-5 if len(edges) else s >= 0.0
            shown = seen[step.name] / plain[step.name] - 1.0
            assert np.abs(shown - courses[0](s))[away].max() < 1e-6
    assert len({seed for seed, _ in rates}) == 4
    for seed in (11, 12, 13, 14):
        own = [rate for name, rate in rates if name == seed]
        assert np.ptp(own) < 1e-3 * own[0] and 1.0 < own[0] < 8.0


def test_an_undecided_laser_hesitates_near_its_border_only() -> None:
    strength = 0.1
    rig = case(undecided_laser=strength)
    found, seen = prepared_rig(rig), clean_signals(rig)
    size = strength * np.mean([step.beta for step in rig.steps])
    borders = np.concatenate([knobs.borders for knobs in found.values()])
    for step in rig.steps:
        knobs, t = found[step.name], sample_times(step)
        gap = knobs.border_gap
        assert abs(gap) == pytest.approx(size)
        plain, x = voltage(rig, step, Knobs(), t)
        more = (seen[step.name] - plain) / gap
        upper = more > 0.5
        assert np.abs(more - upper).max() < 1e-9
        at = rig.relative_concentration(step) * x
        assert not upper[at < borders.min()].any() and upper[at > borders.max()].all()
        # between two decisions the mode depends on the response alone
        for low, high in pairwise(knobs.decisions):
            inside = (t >= low) & (t < high)
            if upper[inside].any() and not upper[inside].all():
                assert at[inside][upper[inside]].min() >= at[inside][~upper[inside]].max()
    # how often it is the upper mode, held at the middle and to either side: 1/(1 + exp(-away))
    drawn = prepared_rig(replace(draw_case(7), strengths={"undecided_laser": strength})).values()
    every = np.concatenate([knobs.borders for knobs in drawn])
    apart = np.concatenate([np.diff(knobs.decisions) for knobs in drawn])
    middle, width = np.median(every), every.std() / (np.pi / np.sqrt(3.0))
    assert 0.25 < middle < 0.85 and 0.025 < width < 0.14
    for away in (-2.0, -1.0, 1.0, 2.0):
        share = np.mean(every < middle + away * width)
        assert share == pytest.approx(1.0 / (1.0 + np.exp(-away)), abs=0.06)
    assert 0.08 < apart.mean() < 1.2 and apart.std() == pytest.approx(apart.mean(), rel=0.15)
    held = Knobs(border_gap=0.2, borders=np.array([0.2, 2.0]), decisions=np.array([0.0, 15.0]))
    rig = case()
    step = max(rig.steps, key=lambda each: each.concentration)
    t = np.array([0.5, 14.99, 15.01])
    more = voltage(rig, step, held, t)[0] - voltage(rig, step, Knobs(), t)[0]
    assert step.t0 < 12.0 and step.tf > 16.0
    assert more == pytest.approx([0.0, 0.2, 0.0], abs=1e-9)


def test_a_meter_begins_its_average_anew_outside_its_window() -> None:
    t = np.linspace(0.0, 30.0, 30_001)
    # a step beyond the window is followed at once, one within it as a lag
    high = windowed_average(t, np.where(t >= 1.0, 1.0, 0.0), 2.0, 0.4)
    assert np.all(high[t < 0.999] == 0.0) and np.all(np.abs(high[t > 1.001] - 1.0) < 1e-3)
    low = windowed_average(t, np.where(t >= 1.0, 0.3, 0.0), 2.0, 0.4)
    expected = np.where(t > 1.0, -0.3 * np.expm1(-np.maximum(t - 0.9995, 0.0) / 2.0), 0.0)
    assert np.abs(low - expected).max() < 5e-4
    # along a ramp it falls behind by v T (1 - exp(-s/T)) and starts anew when that is the window
    ramp = windowed_average(t, 0.5 * t, 2.0, 0.4)
    resets = t[1:][np.diff(ramp) > 0.2]
    assert np.diff(resets) == pytest.approx(-2.0 * np.log(1.0 - 0.4 / (0.5 * 2.0)), abs=3e-3)
    assert np.abs(ramp - 0.5 * t).max() <= 0.4
    slow = windowed_average(t, 0.1 * t, 2.0, 0.4)  # never out of the window
    assert np.abs(slow - 0.1 * (t - 2.0 * -np.expm1(-t / 2.0))).max() < 1e-9

    strength = 0.15
    rig = case(averaging_meter=strength)
    found, seen = prepared_rig(rig), clean_signals(rig)
    window = strength * np.mean([step.beta for step in rig.steps])
    ((own, time_),) = {(knobs.average_window, knobs.average_time) for knobs in found.values()}
    assert own == pytest.approx(window) and 0.5 < time_ < 6.0
    for step in rig.steps:
        t = sample_times(step)
        plain = voltage(rig, step, Knobs(), t)[0]
        behind = plain - seen[step.name]
        assert np.abs(behind).max() <= window * (1.0 + 1e-9)
        assert np.abs(behind[t < step.t0]).max() < 1e-9
        up, down = (t > step.t0) & (t < step.tf), t > step.tf
        assert behind[up].max() > 0.5 * window and behind[down].min() < -0.5 * window
        # the last of the way, once nothing else moves: an exponential
        settled = up & (t > step.tf - 2.0) & (behind > 1e-6)
        if settled.sum() > 50 and behind[settled].max() < 0.9 * window:
            rate = np.diff(np.log(behind[settled]))
            assert np.median(rate) == pytest.approx(-step.interval / time_, rel=0.05)


def test_a_chromatograph_sips_the_same_volume_each_time() -> None:
    strength, aparts, begins = 0.2, [], []
    rig = case(sipping_chromatograph=strength)
    found, seen = prepared_rig(rig), clean_signals(rig)
    for step in rig.steps:
        (thinned,), (more,) = found[step.name].unmixed, found[step.name].all_flow
        t = np.linspace(0.0, 5.0 * step.duration, 1_500_001)
        air = step.total_flow * (more(t) - 1.0)  # mL/s
        # what comes in besides is air
        assert np.allclose(thinned(t) * more(t), 1.0)
        on = np.flatnonzero(np.diff((air > 0.0).astype(int)) > 0)
        assert len(on) >= 6
        aparts += np.diff(t[on]).tolist()
        begins.append(t[on[0]] / aparts[0])
        volumes = np.add.reduceat(air, on + 1)[:-1] * (t[1] - t[0])
        assert np.allclose(volumes, strength * rig.V, rtol=2e-3)
        plain = voltage(rig, step, Knobs(), sample_times(step))[0]
        assert np.abs(seen[step.name] - plain)[sample_times(step) < step.t0].max() < 1e-9
        assert (seen[step.name] - plain).min() < -0.05 * step.beta
        assert (seen[step.name] - plain).max() < 1e-6
    assert np.ptp(aparts) < 1e-3 and 4.0 < aparts[0] < 20.0
    assert np.ptp(begins) > 0.01

    step = min(rig.steps, key=lambda each: each.total_flow)
    k, marks = rig.steps.index(step), sorted(found[step.name].marks)
    (more,) = found[step.name].all_flow

    def sipping(u: tuple[float, float], x: FloatArray) -> list[float]:
        gas = (step.total_flow * x[0] - (step.total_flow + u[1]) * x[1]) / rig.V
        return [(u[0] - x[0]) / rig.tau_v, gas, (x[1] - x[2]) / rig.tau]

    edges = sorted([0.0, step.t0, step.tf, *(0.5 * (a + b) for a, b in zip(*[iter(marks)] * 2))])
    inputs = []
    for at in edges:
        air = step.total_flow * float(more(np.array([at + 2e-6]))[0] - 1.0)
        inputs.append((at, (float(step.t0 <= at < step.tf), air)))
    assert len(inputs) >= 5
    _, states = solved(rig, sipping, 3, k=k, inputs=inputs)
    assert np.abs((seen[step.name] - step.y0) / step.beta - states[:, 2]).max() < 1e-4


def test_a_laminar_stream_leaves_the_wall_behind() -> None:
    passed = np.linspace(-20.0, 400.0, 42_001)
    out = laminar(passed, (passed >= 0.0).astype(float), 30.0, 4000)
    # Poiseuille: behind the axis, which comes after half the volume
    expected = np.where(passed > 0.0, 1.0 - (15.0 / (np.maximum(passed, 0.0) + 15.0)) ** 2, 0.0)
    assert np.abs(out - expected).max() < 2e-3
    # on the whole it is late by the volume, of which the axis's half is not counted here
    ramp = laminar(passed, passed, 3.0)
    assert (passed - ramp)[-1] == pytest.approx(0.5 * 3.0, rel=1e-9)

    strength = 0.8
    rig = case(laminar_hose=strength)
    seen = clean_signals(rig)
    for step in rig.steps:
        q, half = step.total_flow, 0.5 * strength * rig.V
        t = sample_times(step)
        h = 2e-3
        fine = np.arange(0.0, step.duration, h)
        opening = np.where(
            fine < step.tf,
            -np.expm1(-np.maximum(fine - step.t0, 0.0) / rig.tau_v),
            -np.expm1(-(step.tf - step.t0) / rig.tau_v)
            * np.exp(-np.maximum(fine - step.tf, 0.0) / rig.tau_v),
        )
        # what has left by then: a convolution with 2 half^2/(half + volume)^3
        arrived = 1.0 - (half / (half + q * fine)) ** 2
        inlet = np.convolve(opening, np.diff(arrived, prepend=0.0))[: len(fine)]
        x = inlet
        for tau in (rig.V / q, rig.tau):
            x = lfilter([-np.expm1(-h / tau)], [1.0, -np.exp(-h / tau)], x)
        expected = np.interp(t, fine, x)
        shown = (seen[step.name] - step.y0) / step.beta
        assert np.abs(shown - expected).max() < 6e-3
        assert np.abs(shown - voltage(rig, step, Knobs(), t)[1]).max() > 0.05


def test_an_impurity_comes_late_and_takes_its_share() -> None:
    t = np.linspace(0.0, 40.0, 40_001)
    one = np.ones(len(t))
    # n equal cells that are flushed at a constant flow: a gamma distribution of their passage
    out = retarded(t, one, 3.0 * one, 24.0, 12)
    rate = t * 3.0 / 24.0 * 12.0
    terms = np.cumprod(np.vstack([one, rate / np.arange(1, 12)[:, None]]), axis=0)
    assert np.abs(out - (1.0 - np.exp(-rate) * terms.sum(axis=0))).max() < 1e-6
    late = np.trapezoid(1.0 - out, t)
    assert late == pytest.approx(24.0 / 3.0, rel=1e-3)

    strength, passed = 0.25, []
    rig = case(late_impurity=strength)
    # so that it comes through everywhere
    long = replace(rig, steps=tuple(replace(p, tf=2e3 + p.t0, duration=2.1e3) for p in rig.steps))
    for step, own in zip(rig.steps, long.steps, strict=True):
        t = sample_times(step)
        knobs = prepared_rig(rig)[step.name]
        x, plain = (voltage(rig, step, some, t)[1] for some in (knobs, Knobs()))
        assert np.all(x <= plain + 1e-12)
        early = (t > step.t0) & ((t - step.t0) * step.total_flow < 0.2 * knobs.impurity_volume)
        assert early.sum() > 5 and np.all((plain - x)[early] <= 0.01 * plain[early])
        # Langmuir: what is left in the end at the set concentration
        s = np.linspace(step.t0, step.t0 + 400.0, 40_001)
        x, plain = (voltage(long, own, some, s)[1] for some in (knobs, Knobs()))
        full = strength / (1.0 - strength) * rig.relative_concentration(step)
        assert x[-1] == pytest.approx(1.0 / (1.0 + full), rel=1e-6)
        if rig.relative_concentration(step) == 1.0:
            assert x[-1] == pytest.approx(1.0 - strength, rel=1e-6)
        # the area above its front is the mean delay: the valve's, the manifold's and the filter's
        arrived = (plain[plain > 1e-3] / x[plain > 1e-3] - 1.0) / full
        late = np.sum(plain <= 1e-3) * 0.01 + np.trapezoid(1.0 - arrived, dx=0.01)
        passed.append((late - rig.tau_v - rig.V / step.total_flow) * step.total_flow)
    # the same volume everywhere, though not the same time
    assert passed == pytest.approx([knobs.impurity_volume] * len(passed), rel=0.01)


def test_a_piezo_creeps_as_the_logarithm_of_time() -> None:
    times, weights = decades(0.1)
    assert times[0] == pytest.approx(0.1) and times[-1] == pytest.approx(1000.0)
    s = np.array([0.5, 5.0, 50.0])
    crept = [float(weights @ -np.expm1(-since / times)) for since in s]
    assert np.diff(crept) == pytest.approx([1.0, 1.0], abs=0.03)

    strength = 0.06
    rig = case(creeping_piezo=strength)
    seen = clean_signals(rig)
    ((first,),) = {(knobs.creep_first,) for knobs in prepared_rig(rig).values()}
    assert 0.05 < first < 0.5
    for step in rig.steps:
        t = sample_times(step)
        plain = voltage(rig, step, Knobs(), t)[0]
        missing = (plain - seen[step.name]) / step.beta
        assert np.abs(missing[t < step.t0]).max() < 1e-9
        assert missing.min() > -1e-9
        # a superposition of what each small rise has let creep since: a sum over the past
        expected, h = np.zeros(len(t)), step.interval
        moves = np.diff((plain - step.y0) / step.beta, prepend=0.0)
        for k in range(13):
            tau = first * 10.0 ** (k / 3.0)
            expected += lfilter([1.0], [1.0], np.cumsum(moves)) / 3.0
            expected -= lfilter([1.0], [1.0, -np.exp(-h / tau)], moves) / 3.0
        assert np.abs(missing - strength * expected).max() < 2e-3
        # on the plateau and on the way back it still goes on, by some of a decade
        late = (t > 0.5 * (step.t0 + step.tf)) & (t < step.tf)
        assert np.all(np.diff(missing[late]) > 0.0)
        assert missing[-1] > 0.01


def test_the_warmth_of_a_hand_diffuses_to_the_ring() -> None:
    strength, depths = 0.1, []
    for seed in (11, 12, 13, 14):
        rig = replace(draw_case(seed, size="small"), strengths={"touching_hand": strength})
        size, touched = strength * np.mean([step.beta for step in rig.steps]), 0
        for step, course in offsets(rig, atol=1e-7):
            marks = prepared_rig(rig)[step.name].marks
            touched += 1
            on = marks[0]
            off = marks[1] if len(marks) > 1 else step.duration
            t = np.linspace(on, min(off, step.duration), 2001)
            warm = np.abs(course(t)) / size
            assert warm[0] < 1e-12 and warm.max() < 1.0 and np.all(np.diff(warm) >= -1e-12)
            assert np.all(course(np.linspace(0.0, on, 50)) == 0.0)
            # erfc(sqrt(a/t)): the ratio at two times has but one root in a
            a = np.geomspace(0.05, 4.0, 4001)
            ratio = erfc(np.sqrt(a / (0.4 * (t[-1] - on)))) / erfc(np.sqrt(a / (t[-1] - on)))
            depth = float(
                np.interp(-np.interp(0.4, np.linspace(0, 1, 2001), warm) / warm[-1], -ratio, a)
            )
            depths.append((seed, depth))
            own = warm[-1] / erfc(np.sqrt(depth / (t[-1] - on)))
            assert 0.5 - 1e-3 < own < 1.0 + 1e-3
            assert np.abs(warm[1:] - own * erfc(np.sqrt(depth / (t[1:] - on)))).max() < 1e-4
            # long after, what is left falls as time^-3/2
            late = np.abs(course(np.array([4e4, 1.6e5])))
            assert late[0] / late[1] == pytest.approx(8.0, rel=0.01)
        assert touched >= 1
    for seed in (11, 12, 13, 14):
        each = [depth for name, depth in depths if name == seed]
        assert np.ptp(each) < 5e-3 * each[0] and 0.1 < each[0] < 2.0


def test_footsteps_come_near_and_go_away() -> None:
    strength, once, closest = 0.2, 0, 0.0
    for seed in (11, 12, 13, 14):
        rig = replace(draw_case(seed, size="small"), strengths={"passing_footsteps": strength})
        size = strength * np.mean([step.beta for step in rig.steps])
        assert any(knobs.offset for knobs in prepared_rig(rig).values())
        for step, course in offsets(rig, atol=1e-9):
            t = np.arange(-60.0, step.duration + 60.0, 5e-4)
            y = course(t) / size
            # each foot sets off e^(-t/T) sin(wt), where two samples tell the next one
            live = np.abs(y) > 1e-4
            rows = np.flatnonzero(live[2:] & live[1:-1] & live[:-2])
            design = np.column_stack([y[rows + 1], -y[rows]])
            half = np.abs(y[rows + 2] - design @ np.linalg.lstsq(design, y[rows + 2])[0])
            rows = rows[half < np.quantile(half, 0.9)]
            design = np.column_stack([y[rows + 1], -y[rows]])
            a, b = np.linalg.lstsq(design, y[rows + 2])[0]
            struck = np.abs(np.convolve(y, [1.0, -a, b])[: len(y)])
            damping = -5e-4 / (0.5 * np.log(b))
            frequency = np.arccos(a / (2.0 * np.sqrt(b))) / (2.0 * np.pi * 5e-4)
            assert 0.04 < damping < 0.2 and 6.0 < frequency < 25.0
            hits = struck / np.sin(2.0 * np.pi * frequency * 5e-4)
            feet = t[hits > 3e-4 * hits.max()]
            feet = feet[np.diff(feet, prepend=-1e3) > 2e-3]
            assert 20 <= len(feet) <= 82
            # walked once: one foot after the other, nearly evenly
            if len(feet) <= 41:
                once += 1
                assert 1.0 / 2.3 / 1.1 < np.median(np.diff(feet)) < 1.1 / 1.5
                assert np.ptp(np.diff(feet)) < 0.2 * np.median(np.diff(feet))
            ends = np.abs(y[(t < feet[0] + 1.0) | (t > feet[-1] - 1.0)]).max()
            assert ends < 0.25 * np.abs(y).max()
            closest = max(closest, np.abs(y).max())
    assert once >= 2 and 0.3 < closest < 2.0


def test_an_overloaded_amplifier_stays_at_its_rail_until_its_charge_is_gone() -> None:
    t = np.linspace(0.0, 20.0, 20_001)
    y = np.interp(t, [0.0, 2.0, 4.0, 10.0, 14.0, 20.0], [0.0, 0.0, 1.0, 1.0, 0.0, 0.0])
    shown = overloaded(t, y, 0.8, 0.5, 0.1)
    assert np.array_equal(shown[y <= 0.8][:3600], y[y <= 0.8][:3600])  # on the way up
    # falls below at 10.8 s at 0.25 per s: the charge is gone when 0.125 since^2/0.5 = 0.1
    gone = 10.8 + np.sqrt(0.1 * 0.5 / 0.125)
    at_rail = (t > 3.6) & (t < gone - 2e-3)
    assert np.all(shown[at_rail] == 0.8)
    assert np.array_equal(shown[t > gone + 2e-3], y[t > gone + 2e-3])
    # a charge that had no time to fill up: 0.05 s of 0.2
    short = overloaded(t, np.where((t >= 5.0) & (t < 5.05), 1.0, 0.6), 0.8, 0.5, 0.1)
    assert np.sum(short == 0.8) == pytest.approx(100, abs=3)

    strength = 0.2
    rig = case(overloaded_amplifier=strength)
    seen, plain = clean_signals(rig), clean_signals(without_causes(rig))
    rail = max(p.y0 + p.beta for p in rig.steps) - strength * np.mean([p.beta for p in rig.steps])
    over = 0
    for step in rig.steps:
        s, high = sample_times(step), plain[step.name]
        if high.max() < rail:
            assert np.array_equal(seen[step.name], high)
            continue
        over += 1
        assert seen[step.name].max() == pytest.approx(rail)
        last = s[high > rail].max()
        before, after = s <= last, s > last
        assert np.allclose(seen[step.name][before], np.minimum(high[before], rail), atol=1e-6)
        stays = after & (np.abs(seen[step.name] - rail) < 1e-9)
        assert 0.02 < stays.sum() * step.interval < 6.0
        freed = s > s[stays].max() + 2.0 * step.interval
        assert np.allclose(seen[step.name][freed], high[freed], atol=1e-6)
    assert 1 <= over < len(rig.steps)


def test_a_historian_keeps_what_differs_and_draws_lines() -> None:
    t = np.linspace(0.0, 20.0, 2001)
    y = np.where(t < 10.0, 0.0, 0.5 * (t - 10.0))
    mask = kept(t, y, 0.2, 7.0, 3.0)
    assert mask[0] and mask[-1]
    times = t[mask]
    # by its own clock at 3, 10 and 17 s; every 0.4 s of the ramp from the last one kept on
    assert np.isin([3.0, 10.0, 17.0], np.round(times, 6)).all()
    ramp = times[(times > 10.0) & (times < 17.0)]
    assert np.diff(ramp) == pytest.approx(0.4, abs=0.011)
    assert len(times[times < 10.0]) == 2

    strength = 0.2
    rig = case(thrifty_historian=strength)
    seen, found = clean_signals(rig), prepared_rig(rig)
    band = strength * np.mean([step.beta for step in rig.steps])
    begins = {knobs.kept_begin for knobs in found.values()}
    assert len(begins) == len(rig.steps)
    ((longest,),) = {(knobs.kept_longest,) for knobs in found.values()}
    assert 2.0 < longest < 20.0
    for step in rig.steps:
        s = sample_times(step)
        plain = voltage(rig, step, Knobs(), s)[0]
        shown = seen[step.name]
        # lines: few bends
        bends = np.abs(np.diff(shown, 2)) > 1e-7 * step.beta
        assert 3 <= bends.sum() <= 2 * (2 * step.beta / band + step.duration / longest + 6)
        # a reading differs by less than the band while nothing is kept, and so does the line
        assert np.abs(shown - plain).max() < 1.2 * band
        # before the gas it rises already, from the last one that the clock had it keep
        phase = (step.t0 - found[step.name].kept_begin) % longest
        rising = (s > max(step.t0 - phase, 0.0) + 0.1) & (s < step.t0)
        if phase > 0.3:
            assert np.all(np.diff(shown[rising]) > 0.0)
            slope = np.diff(shown[rising])
            assert np.ptp(slope) < 1e-6 * slope.mean() + 1e-12


def test_a_soft_start_is_a_ramp_and_a_purge_a_faster_end_against_an_ode_solver() -> None:
    strength, slopes = 2.0, []
    for seed in (11, 12, 13, 14, 15):
        rig = replace(draw_case(seed, size="small"), strengths={"soft_start": strength})
        lasts = [prepared_rig(rig)[p.name].marks[0] - p.t0 for p in rig.steps]
        gas = np.array([p.test_gas_flow for p in rig.steps])
        even = np.allclose(lasts, strength)
        assert even or np.allclose(lasts, strength * gas / gas.max())
        slopes.append(not even)
        seen = clean_signals(rig)
        k = int(np.argmin(gas))
        step = rig.steps[k]

        def ramped(
            u: tuple[float, float, float], x: FloatArray, step: Step = step, rig: Case = rig
        ) -> list[float]:
            # the ramp as a state of its own; what the valve does not let pass is carrier
            full = step.test_gas_flow * min(x[3], 1.0)
            inlet = x[0] * full / (step.carrier_flow + full) / step.concentration
            flow = step.carrier_flow + full * x[0] + step.test_gas_flow * (1.0 - x[0])
            gas = flow * (inlet - x[1]) / rig.V
            return [(u[0] - x[0]) / rig.tau_v, gas, (x[1] - x[2]) / rig.tau, u[1]]

        inputs = [
            (0.0, (0.0, 0.0)), (step.t0, (1.0, 1.0 / lasts[k])),
            (step.t0 + lasts[k], (1.0, 0.0)), (step.tf, (0.0, 0.0)),
        ]  # fmt: skip
        _, states = solved(rig, ramped, 4, k=k, inputs=inputs)
        assert np.abs((seen[step.name] - step.y0) / step.beta - states[:, 2]).max() < 1e-4
    assert 0 < sum(slopes) < 5

    strength, purged = 2.0, 0
    rig = replace(draw_case(11, size="varied"), strengths={"hasty_purge": strength})
    found, seen, plain = prepared_rig(rig), clean_signals(rig), clean_signals(without_causes(rig))
    for k, step in enumerate(rig.steps):
        if not found[step.name].carrier:
            assert np.array_equal(seen[step.name], plain[step.name])
            continue
        purged += 1
        (carrier,), (at,) = found[step.name].carrier, found[step.name].marks
        reach = rig.tau_v + rig.V / step.total_flow
        assert step.tf + 0.19 * reach < at < step.tf + 1.21 * reach
        time_ = -0.2 / np.log(1.0 - (carrier(np.array([at + 0.2]))[0] - 1.0) / strength)
        assert 0.1 < time_ < 0.6
        if purged > 1:
            continue

        def flushed(
            u: tuple[float, float], x: FloatArray, step: Step = step, time_: float = time_
        ) -> list[float]:
            carrier = step.carrier_flow * (1.0 + strength * x[3])
            inlet = x[0] * step.test_gas_flow / (carrier + step.test_gas_flow) / step.concentration
            gas = (carrier + step.test_gas_flow) * (inlet - x[1]) / rig.V
            more = (u[1] - x[3]) / time_
            return [(u[0] - x[0]) / rig.tau_v, gas, (x[1] - x[2]) / rig.tau, more]

        inputs = [(0.0, (0.0, 0.0)), (step.t0, (1.0, 0.0)), (step.tf, (0.0, 0.0)), (at, (0.0, 1.0))]
        _, states = solved(rig, flushed, 4, k=k, inputs=inputs)
        assert np.abs((seen[step.name] - step.y0) / step.beta - states[:, 2]).max() < 1e-4
    assert 1 <= purged < len(rig.steps)


def test_pores_empty_at_the_square_of_the_pressure_at_which_they_filled() -> None:
    # up to 0.6, some way back, and down: full up to 0.6 until the root is below
    pressure = np.concatenate([np.linspace(0.0, 0.6, 601), np.linspace(0.6, 0.0, 601)])
    reach = capillary(pressure)
    assert np.array_equal(reach[:601], pressure[:601])
    down = pressure[601:]
    assert np.allclose(reach[601:], np.where(down > 0.36, 0.6, np.sqrt(down)))
    # a small turn within the loop changes nothing
    turn = np.array([0.0, 0.6, 0.4, 0.55, 0.4, 0.25, 0.4, 0.6])
    assert capillary(turn) == pytest.approx([0.0, 0.6, 0.6, 0.6, 0.6, 0.5, 0.5, 0.6])

    strength, late = 0.3, 0
    rig = case(capillary_condensation=strength)
    seen = clean_signals(rig)
    for step in rig.steps:
        t, relative = sample_times(step), rig.relative_concentration(step)
        knobs = prepared_rig(rig)[step.name]
        assert 0.5 < knobs.pores_vapour < 0.9 and 0.05 < knobs.pores_width < 0.2
        plain = (voltage(rig, step, Knobs(), t)[0] - step.y0) / step.beta
        more = ((seen[step.name] - step.y0) / step.beta - plain) * relative / strength
        assert more.min() > -1e-9 and more.max() < 1.0
        # on the plateau a log-normal share of the pores is full, for the pressure that is there
        z = np.log(knobs.pores_vapour * relative / knobs.pores_at) / knobs.pores_width
        full = 0.5 * erfc(-z / np.sqrt(2.0))
        end = t < step.tf
        assert more[end][-1] == pytest.approx(full, abs=1e-3)
        if full < 0.2:
            continue
        late += 1
        # half of it comes and goes at pressures of which one is the other's square, or as little
        # as there was when it was left
        half, rises, falls = 0.5 * full, end & (t > step.t0), t > step.tf
        top = knobs.pores_vapour * relative
        up = top * np.interp(half, more[rises], plain[rises])
        down = top * np.interp(-half, -more[falls], plain[falls])
        assert down == pytest.approx(up**2, rel=0.25)
        assert down < 0.8 * up
    assert late >= 1


def test_a_line_on_dead_pixels_is_found_where_it_was() -> None:
    y = np.array([0.0, 0.2, 0.35, 0.45, 0.55, 0.9, 0.52, 0.41, 0.45, 0.3, 0.5, 0.1])
    shown = blind(y, 0.4, 0.2)
    assert shown == pytest.approx([0.0, 0.2, 0.35, 0.35, 0.35, 0.9, 0.9, 0.9, 0.9, 0.3, 0.3, 0.1])

    strength, crossed = 0.2, 0
    rig = case(dead_pixels=strength)
    seen, plain = clean_signals(rig), clean_signals(without_causes(rig))
    for step in rig.steps:
        at = prepared_rig(rig)[step.name].dead_from
        assert 0.1 <= at <= 0.6
        t, relative = sample_times(step), rig.relative_concentration(step)
        place, shown = (
            relative * (some[step.name] - step.y0) / step.beta for some in (plain, seen)
        )
        within = (place > at + 1e-6) & (place < at + strength - 1e-6)
        outside = (place < at - 1e-6) | (place > at + strength + 1e-6)
        assert np.allclose(shown[outside], place[outside], atol=1e-9)
        up, down = within & (t < step.tf), within & (t > step.tf)
        assert up.sum() > 1 and np.allclose(shown[up], at, atol=5e-3)
        if place.max() > at + strength:
            crossed += 1
            assert np.allclose(shown[down], at + strength, atol=5e-3)
    assert crossed >= 1


def test_a_tube_lamp_flashes_until_it_burns_and_then_grows_brighter() -> None:
    strength, lit, counts = 0.1, 0, set()
    for seed in (11, 12, 13):
        rig = replace(draw_case(seed, size="small"), strengths={"flickering_tube_lamp": strength})
        size = strength * np.mean([step.beta for step in rig.steps])
        for _, course in offsets(rig, atol=5e-6):
            lit += 1
            t = np.arange(0.0, 400.0, 5e-4)
            light = course(t) / size
            edges = np.flatnonzero(np.diff((light > 0.0).astype(int)))
            assert light[0] == 0.0 and len(edges) % 2 == 1  # on for good in the end
            lengths, gaps = np.diff(t[edges])[::2], np.diff(t[edges][::2])
            counts.add(len(lengths))
            assert 2 <= len(lengths) <= 7
            assert np.all((lengths > 0.049) & (lengths < 0.251))
            assert np.all((gaps > 0.39) & (gaps < 1.31))
            # of its hundred or so swings a second, whole tenths of a second know nothing
            burns = light[edges[-1] + 1 :]
            mean = burns[: len(burns) // 200 * 200].reshape(-1, 200).mean(axis=1)
            swing = burns[-20_000:] / mean[-1] - 1.0
            assert 0.15 < swing.max() < 0.4 and swing.min() == pytest.approx(-swing.max(), rel=0.05)
            f, power = welch(swing, 2000.0, nperseg=20_000)
            assert f[power.argmax()] == pytest.approx(100.0, abs=0.2) or f[
                power.argmax()
            ] == pytest.approx(120.0, abs=0.2)
            # from 0.4 to 0.7 of its light to all of it, as one exponential
            assert 0.38 < mean[0] < 0.73 and mean[-1] == pytest.approx(1.0, abs=1e-3)
            left = np.log(1.0 - mean[:50])
            time_ = -0.1 / np.diff(left).mean()
            assert 4.9 < time_ < 30.5 and np.ptp(np.diff(left)) < 1e-3
    assert lit >= 3 and len(counts) > 1


def test_an_automatic_gain_turns_down_quickly_and_up_slowly() -> None:
    t = np.linspace(0.0, 60.0, 6001)
    level = envelope(t, np.where((t >= 10.0) & (t < 30.0), 5.0, 1.0), 2.0, 8.0)
    on, off = (t > 10.01) & (t < 29.99), t > 30.01
    assert level[on] == pytest.approx(5.0 - 4.0 * np.exp(-(t[on] - 10.0) / 2.0), abs=0.02)
    high = 5.0 - 4.0 * np.exp(-10.0)
    assert level[off] == pytest.approx(
        1.0 + (high - 1.0) * np.exp(-(t[off] - 30.0) / 8.0), abs=0.02
    )

    strength = 0.15
    rig = case(automatic_gain=strength)
    seen, plain = clean_signals(rig), clean_signals(without_causes(rig))
    for step in rig.steps:
        t, knobs = sample_times(step), prepared_rig(rig)[step.name]
        attack, release = knobs.gain_attack, knobs.gain_release
        assert 0.5 < attack < 4.0 and 5.0 < release < 30.0
        ideal, gain = plain[step.name], seen[step.name] / plain[step.name]
        assert np.allclose(gain[t < step.t0], 1.0)

        def follow(
            s: float,
            x: FloatArray,
            t: FloatArray = t,
            ideal: FloatArray = ideal,
            times: tuple[float, float] = (attack, release),
        ) -> Any:
            y = np.interp(s, t, ideal)
            return (y - x) / times[0 if y > x[0] else 1]

        found = solve_ivp(
            follow, (0.0, t[-1]), [step.y0], t_eval=t, rtol=1e-8, atol=1e-10, max_step=0.02
        )
        expected = (step.y0 / found.y[0]) ** strength
        assert np.abs(gain - expected).max() < 2e-3
        # it overshoots, and is too low long after
        shown = seen[step.name]
        assert shown.max() > 1.03 * shown[t < step.tf][-1]
        assert shown[t > step.tf + 4.0].min() < step.y0 * (1.0 - 0.3 * strength)


def test_the_channel_before_shines_in_run_after_run() -> None:
    strength, checked, h = 0.08, 0, 5e-3
    t = np.arange(0.0, 130.0, h)
    for seed in range(11, 23):
        rig = replace(draw_case(seed, size="small"), strengths={"ghosting_multiplexer": strength})
        size = strength * np.mean([step.beta for step in rig.steps])
        seen, plain = clean_signals(rig), clean_signals(without_causes(rig))
        found, begins = prepared_rig(rig), []
        for step in rig.steps:
            (course,) = found[step.name].offset
            shone = course(sample_times(step))
            assert np.allclose(seen[step.name] - plain[step.name], shone, atol=1e-9)
            begins.append(t[np.argmax(course(t)[: int(40.0 / h)])])
        assert np.ptp(begins) > 0.05  # it knows nothing of the experiments
        y = course(t) / size
        assert y.min() >= 0.0 and 0.999 < y.max() < 3.0
        logs = np.log(np.maximum(y, 1e-12))
        tops = np.flatnonzero((y[1:-1] > y[:-2]) & (y[1:-1] >= y[2:]) & (y[1:-1] > 0.1)) + 1
        bends = (logs[tops + 1] - 2.0 * logs[tops] + logs[tops - 1]) / h**2
        at = t[tops] - (logs[tops + 1] - logs[tops - 1]) / (2.0 * h * bends)
        widths = np.sqrt(-1.0 / bends)
        # the tallest one comes again in every run
        tallest = at[y[tops] > y[tops].max() - 1e-3]
        run = float(np.diff(tallest).min())
        assert 8.0 < run < 40.0
        assert np.allclose(course(t), course(t + run), atol=2e-3 * size)
        # Gaussians as wide as they are late: with those that stand alone, all by one factor
        gaps = np.minimum(np.diff(at, prepend=-1e3), np.diff(at, append=1e3))
        alone = (gaps > 8.0 * np.median(widths)) & (gaps > 8.0 * widths)
        alone &= (at > 0.02 * run) & (at < 1.02 * run)
        if alone.sum() < 3:
            continue
        order = np.argsort(widths[alone])
        at, widths = at[alone][order], widths[alone][order]
        behind = np.mod(at - at[0], run)[1:]
        root = float(behind @ (widths[1:] - widths[0]) / np.sum((widths[1:] - widths[0]) ** 2))
        assert np.abs(behind - root * (widths[1:] - widths[0])).max() < 0.02 * run
        assert 300.0 * 0.9 < root**2 < 3000.0 * 1.1
        checked += 1
    assert checked >= 3


def test_a_mobile_phone_sends_four_slots_in_a_row_and_then_twenty_five_of_twenty_six() -> None:
    strength, frame, signalled, talked = 0.2, 60e-3 / 13.0, 0, 0
    for seed in (11, 12, 13, 14):
        rig = replace(draw_case(seed, size="small"), strengths={"calling_mobile_phone": strength})
        size = strength * np.mean([step.beta for step in rig.steps])
        for step, course in offsets(rig, atol=5e-6):
            h = 2e-5
            t = np.arange(0.0, step.duration, h)
            y = course(t) / size
            on = np.abs(y) > 0.5
            assert np.allclose(np.abs(y[on]), 1.0) and np.ptp(y[on]) == 0.0
            begins = t[1:][on[1:] & ~on[:-1]]
            lengths = np.sum(on) * h / len(begins)
            assert lengths == pytest.approx(15e-3 / 26.0, rel=0.05)
            frames = np.rint(np.diff(begins) / frame).astype(int)
            assert np.diff(begins) == pytest.approx(frames * frame, abs=2.5 * h)
            if len(frames) < 60:
                continue
            # three neighbours, then a pause of 48 frames; in the call every 26th is missing
            pauses = np.flatnonzero(frames == 48)
            if len(pauses) > 2:
                signalled += 1
                assert np.all(np.diff(pauses) == 4) and pauses[0] == 3
                assert 1.0 < begins[pauses[-1] + 1] - begins[0] < 4.0
            call = frames[pauses[-1] + 4 :] if len(pauses) else frames
            if len(call) > 80:
                talked += 1
                missing = np.flatnonzero(call[1:] == 2)
                assert np.all(np.diff(missing) == 25)
                assert set(call[1:].tolist()) == {1, 2}
    assert signalled >= 2 and talked >= 2


def test_a_filter_clogs_and_a_float_bobs_against_an_ode_solver() -> None:
    strength = 1.0
    rig = case(clogging_filter=strength)
    seen = clean_signals(rig)
    k_cake = 1.5 / sum(step.total_flow * step.duration for step in rig.steps)
    passed = 0.0
    for k, step in enumerate(rig.steps):

        def clogging(
            u: float, x: FloatArray, step: Step = step, passed: float = passed
        ) -> list[float]:
            # the flow that the pressure drives through what has grown so far
            flow = step.total_flow / (1.0 + k_cake * (passed + x[3]))
            cascade = [
                (u - x[0]) / rig.tau_v,
                flow / rig.V * (x[0] - x[1]),
                (x[1] - x[2]) / rig.tau,
            ]
            return [*cascade, flow]

        t, states = solved(rig, clogging, 4, k=k)
        assert np.abs((seen[step.name] - step.y0) / step.beta - states[:, 2]).max() < 1e-4
        flow = step.total_flow / (1.0 + k_cake * (passed + states[-1, 3]))
        passed += states[-1, 3] + (step.duration - t[-1]) * flow
    assert k_cake * passed == pytest.approx(strength, rel=1e-4)

    strength, times = 0.4, []
    for seed in (11, 12, 13):
        rig = replace(draw_case(seed, size="small"), strengths={"bobbing_float": strength})
        seen, found = clean_signals(rig), prepared_rig(rig)
        for k, step in enumerate(rig.steps):
            (flow,) = found[step.name].test_gas
            since = np.arange(0.0, 6.0, 1e-4)
            away = flow(step.t0 + since) - 1.0
            assert np.all(flow(np.array([0.0, step.t0])) == 1.0)
            zeros = since[1:][np.diff(np.sign(away)) != 0]
            half = float(np.diff(zeros[zeros > 1e-3]).mean())
            fades = half / np.log(-away[1000] / np.interp(0.1 + half, since, away))
            assert 0.3 < 0.5 / half < 1.2 and 2.0 < fades < 10.0
            times.append((round(half, 3), round(fades, 1)))
            if k > 0:
                continue
            turn, fade = np.pi / half, 1.0 / fades

            def bobbing(
                u: float,
                x: FloatArray,
                step: Step = step,
                rig: Case = rig,
                spring: float = turn**2 + fade**2,
                fade: float = fade,
            ) -> list[float]:
                full = step.test_gas_flow * (1.0 + x[3])
                inlet = x[0] * full / (step.carrier_flow + full) / step.concentration
                total = step.carrier_flow + x[0] * full + (1.0 - x[0]) * step.test_gas_flow
                cascade = [(u - x[0]) / rig.tau_v, total / rig.V * (inlet - x[1])]
                return [*cascade, (x[1] - x[2]) / rig.tau, x[4], -spring * x[3] - 2.0 * fade * x[4]]

            t = sample_times(step)
            inside = (t >= step.t0) & (t < step.tf)
            result = solve_ivp(
                lambda s, x, bobbing=bobbing: bobbing(1.0, x), (step.t0, step.tf),
                [0.0, 0.0, 0.0, 0.0, strength * turn], rtol=1e-9, atol=1e-11, dense_output=True,
            )  # fmt: skip
            x = (seen[step.name] - step.y0) / step.beta
            assert np.abs(x[inside] - result.sol(t[inside])[2]).max() < 2e-3
            assert x[inside].max() > 1.01
    assert len(set(times)) >= 3


def test_a_wet_hose_dries_once_and_for_all() -> None:
    strength, lasted = 0.1, set()
    for seed in range(11, 19):
        rig = replace(draw_case(seed, size="small"), strengths={"wet_hose": strength})
        found, seen = prepared_rig(rig), clean_signals(rig)
        plain = clean_signals(without_causes(rig))
        wet = [step for step in rig.steps if found[step.name].seep]
        lasted.add(len(wet))
        assert wet == list(rig.steps[: len(wet)])
        for step in rig.steps[len(wet) :]:
            assert np.array_equal(seen[step.name], plain[step.name])
        end, slope = None, None
        for step in wet:
            (vapour,) = found[step.name].seep
            most = strength * rig.highest_concentration * step.total_flow
            t = np.linspace(0.0, step.duration, 3001)
            left = np.clip(vapour(t) / most, 1e-12, 1.0 - 1e-12)
            odds = np.log(left / (1.0 - left))
            some = np.abs(odds) < 10.0
            if some.sum() > 10:
                slopes = np.diff(odds[some]) / (t[1] * step.total_flow)
                own = float(slopes.mean())
                assert (
                    own < 0.0
                    and np.ptp(slopes) < 1e-6 * abs(own)
                    and (slope is None or own == pytest.approx(slope, rel=1e-3))
                )
                # the film gives off what it still covers: m' = -(1 - exp(-m)) a patch's volume
                film = -np.log1p(-left[some])
                speed = np.gradient(film, t[some])[1:-1]
                rate = own * step.total_flow * left[some][1:-1]
                assert np.abs(speed - rate).max() < 2e-2 * np.abs(own * step.total_flow)
                if end is not None and abs(end) < 10.0:  # it goes on where it was
                    assert odds[0] == pytest.approx(end, abs=1e-6)
                slope = own
            end = float(odds[-1])
            # it is there before the record begins: a moist baseline, and no rise to it
            added = (seen[step.name] - plain[step.name]) / step.beta
            full = strength / rig.relative_concentration(step)
            if left[:300].min() > 0.999:
                assert np.allclose(added[:100], full, rtol=2e-3)
        assert left[-1] < 0.5 < left[0]
        at = t[np.argmin(np.abs(left - 0.5))] / step.duration
        assert 0.14 < at < 0.86
    assert lasted == {1, 2}


def test_bubbles_of_nearly_one_volume_leave_the_exhaust() -> None:
    strength, means = 0.06, []
    for seed in (11, 12, 13):
        rig = replace(draw_case(seed, size="small"), strengths={"bubbling_exhaust": strength})
        found, seen = prepared_rig(rig), clean_signals(rig)
        plain, volumes, widest = clean_signals(without_causes(rig)), [], []
        for step in rig.steps:
            (pressure,) = found[step.name].concentration_gain
            s = sample_times(step)
            moved = (plain[step.name] - step.y0) * (1.0 + pressure(s))
            assert np.allclose(seen[step.name] - step.y0, moved, atol=1e-9)
            t = np.arange(0.0, step.duration, 2e-4)
            y = pressure(t) / strength
            assert y.min() == pytest.approx(-0.5, abs=0.02) and y.max() == pytest.approx(
                0.5, abs=0.02
            )
            falls = np.diff(y) < 0.0
            begins = t[1:-1][falls[1:] & ~falls[:-1]]  # of a bubble's end
            assert 0.08 < falls.mean() < 0.32
            own = np.diff(begins) * step.total_flow
            volumes.append(own.mean())
            widest.append(np.ptp(own) / own.mean())
        assert np.ptp(volumes) < 0.15 * np.mean(volumes)  # the same at any flow
        assert 0.05 < min(widest) and max(widest) < 0.6
        means.append(np.median([step.total_flow for step in rig.steps]) / np.mean(volumes))
    assert min(means) > 1.8 and max(means) < 11.0 and np.ptp(means) > 0.5


def test_a_poisoned_coating_loses_sites_with_the_dose_against_an_ode_solver() -> None:
    strength = 0.5
    rig = case(poisoned_coating=strength)
    seen, alive = clean_signals(rig), 1.0
    doses = [rig.relative_concentration(step) * (step.tf - step.t0) for step in rig.steps]
    for k, step in enumerate(rig.steps):
        rate = np.log(2.0) / sum(doses) * rig.relative_concentration(step)

        def dying(u: float, x: FloatArray, step: Step = step, rate: float = rate) -> list[float]:
            cascade = [(u - x[0]) / rig.tau_v, step.total_flow / rig.V * (x[0] - x[1])]
            return [*cascade, (x[1] - x[2]) / rig.tau, -rate * x[2] * (1.0 + x[3])]

        _, states = solved(rig, dying, 4, k=k)  # x[3]: what has died in this record
        x = alive * states[:, 2] * (1.0 + states[:, 3])
        assert np.abs((seen[step.name] - step.y0) / step.beta - x).max() < 1e-3
        alive *= 1.0 + states[-1, 3]
    assert alive == pytest.approx(1.0 - strength, abs=2e-3)


def test_a_parabola_shows_a_step_before_it_comes() -> None:
    t = np.sort(np.random.default_rng(3).uniform(0.0, 10.0, 20_001))
    inside = (t > 1.0) & (t < 9.0)
    cubic = 1.0 + t - 0.3 * t**2 + 0.02 * t**3
    assert np.allclose(parabola(t, cubic, 2.0)[inside], cubic[inside], atol=1e-5)
    # what is too quick for it fades, as a fit of its own says
    quick = np.cos(3.0 * t)
    around = np.linspace(4.0, 6.0, 4001)
    middle = np.polyval(np.polyfit(around - 5.0, np.cos(3.0 * around), 2), 0.0)
    assert np.interp(5.0, t, parabola(t, quick, 2.0)) == pytest.approx(middle, abs=1e-3)
    assert abs(middle - np.cos(15.0)) > 0.05

    strength = 3.0
    rig = case(smoothing_parabola=strength)
    seen, plain = clean_signals(rig), clean_signals(without_causes(rig))
    for step in rig.steps:
        s = sample_times(step)
        for at in (step.t0 - 0.8, step.t0 + 0.5, step.t0 + 1.5, step.tf + 0.4, step.tf + 2.0):
            i = int(at / step.interval)
            near = np.abs(s - s[i]) < 0.5 * strength
            fitted = np.polyfit(s[near] - s[i], plain[step.name][near], 2)[-1]
            assert seen[step.name][i] == pytest.approx(fitted, abs=5e-3 * step.beta)
        before = (seen[step.name] - step.y0) / step.beta
        assert before[s < step.t0].min() < -0.01
        assert np.abs(before[s < step.t0 - 0.5 * strength]).max() < 1e-12


def test_an_uncleared_screen_shows_the_record_before() -> None:
    strength = 0.1
    rig = case(uncleared_screen=strength)
    seen, plain = clean_signals(rig), clean_signals(without_causes(rig))
    first = rig.steps[0].name
    assert np.array_equal(seen[first], plain[first])
    for before, step in pairwise(rig.steps):
        both = (1.0 - strength) * plain[step.name] + strength * plain[before.name]
        assert np.abs(seen[step.name] - both).max() < 1e-4
        assert np.abs(seen[step.name] - plain[step.name]).max() > 0.03 * step.beta


def test_a_heaters_bursts_are_whole_periods_of_the_mains() -> None:
    strength, kinds, shares = 0.05, set(), []
    for seed in (11, 12, 13, 14):
        rig = replace(draw_case(seed, size="small"), strengths={"burst_fired_heater": strength})
        size, cycles = strength * np.mean([step.beta for step in rig.steps]), set()
        for step, hum in offsets(rig, 1e-9):
            t = np.arange(0.0, step.duration, 2e-4)
            y = hum(t) / size
            assert 0.99 < np.abs(y).max() <= 1.0
            quiet = np.convolve(y == 0.0, np.ones(10), "same") > 9.5
            quiet[:10], quiet[-10:] = quiet[10], quiet[-11]  # where the record is cut off
            begins = t[1:][quiet[:-1] & ~quiet[1:]]
            ends = t[1:][~quiet[:-1] & quiet[1:]]
            f, power = welch(y[~quiet], 5000.0, nperseg=5000)
            mains = 50.0 if f[power.argmax()] < 55.0 else 60.0
            assert f[power.argmax()] == pytest.approx(mains, abs=1.0)
            kinds.add(mains)
            ends = ends[ends > begins[0]]
            lasts = (ends - begins[: len(ends)]) * mains
            every = np.diff(begins) * mains
            assert np.ptp(lasts) < 0.3 and np.ptp(every) < 0.3
            cycles.add(round(float(every.mean())))
            assert every.mean() == pytest.approx(np.rint(every.mean()), abs=0.1)
            shares.append(lasts.mean() / every.mean())
            # it begins from zero, upwards, and stops there
            assert abs(np.mean(y)) < 5e-3
            assert np.all(np.interp(begins + 0.2 / mains, t, y) > 0.5)
        assert len(cycles) == 1
    assert kinds == {50.0, 60.0} and min(shares) > 0.1 and max(shares) < 0.75
    assert np.ptp(shares) > 0.1


def test_a_pilot_hole_opens_first_and_a_click_lets_a_whiff_through() -> None:
    strength, holes = 1.5, []
    for seed in (11, 12, 13):
        rig = replace(draw_case(seed, size="small"), strengths={"late_main_stage": strength})
        pilot = prepared_rig(rig)["1"].pilot
        holes.append(pilot)
        step, seen = rig.steps[0], clean_signals(rig)["1"]
        taus = rig.tau_v, rig.V / step.total_flow, rig.tau

        def cascade(u: float, x: FloatArray, taus: tuple[float, ...] = taus) -> list[float]:
            return [(a - b) / tau for a, b, tau in zip((u, *x[:2]), x, taus, strict=True)]

        inputs = [(0.0, 0.0), (step.t0, pilot), (step.t0 + strength, 1.0), (step.tf, 0.0)]
        _, states = solved(rig, cascade, 3, inputs=inputs)
        assert np.abs((seen - step.y0) / step.beta - states[:, 2]).max() < 1e-4
    assert 0.06 < min(holes) < max(holes) < 0.25

    strength, clicked, all_ = 0.6, 0, 0
    for seed in range(11, 17):
        rig = replace(draw_case(seed, size="small"), strengths={"trial_click": strength})
        found, seen = prepared_rig(rig), clean_signals(rig)
        plain = clean_signals(without_causes(rig))
        for step in rig.steps:
            all_ += 1
            if not found[step.name].tried:
                assert np.array_equal(seen[step.name], plain[step.name])
                continue
            clicked += 1
            ((at, lasts),) = found[step.name].tried
            assert 0.6 * strength <= lasts <= strength and 0.0 < at < 0.7 * step.commanded_on
            # what comes is as much as the switch was on for, of which each lag keeps the area
            added = (seen[step.name] - plain[step.name]) / step.beta
            if step.t0 - at > 12.0 * rig.tau_v:
                early = sample_times(step) < step.t0
                assert added[early].sum() * step.interval == pytest.approx(lasts, rel=5e-3)
                assert added[early].max() < 1.0 - np.exp(-lasts / rig.tau_v)
            assert np.abs(added[sample_times(step) < at]).max() == 0.0
    assert len(rig.steps) <= clicked < all_


def test_a_dammed_hose_empties_against_an_ode_solver() -> None:
    strength, times = 1.2, []
    for seed in (11, 12, 13):
        rig = replace(draw_case(seed, size="small"), strengths={"dammed_test_gas": strength})
        found, seen, brings = prepared_rig(rig), clean_signals(rig), []
        for k, step in enumerate(rig.steps):
            (flow,) = found[step.name].test_gas
            assert flow(np.array([step.t0]))[0] == pytest.approx(1.0 + strength)
            # pressure falls by what leaves more than comes: its slope gives the hose's content
            t = step.t0 + np.linspace(0.0, 1e-4, 2)
            fallen = -np.diff(flow(t) ** 2)[0] / 1e-4
            brings.append(step.test_gas_flow * strength / fallen)
            times.append(brings[-1] / step.test_gas_flow)
            if k > 0:
                continue

            def emptying(
                u: float, x: FloatArray, step: Step = step, rig: Case = rig, mL: float = brings[0]
            ) -> list[float]:
                q = np.sqrt(x[3])
                test = step.test_gas_flow * q
                inlet = x[0] * test / (step.carrier_flow + test) / step.concentration
                total = step.total_flow + x[0] * (test - step.test_gas_flow)
                cascade = [(u - x[0]) / rig.tau_v, total / rig.V * (inlet - x[1])]
                return [*cascade, (x[1] - x[2]) / rig.tau, (1.0 - q) * step.test_gas_flow / mL]

            t = sample_times(step)
            inside = (t >= step.t0) & (t < step.tf)
            result = solve_ivp(
                lambda s, x, emptying=emptying: emptying(1.0, x), (step.t0, step.tf),
                [0.0, 0.0, 0.0, (1.0 + strength) ** 2], rtol=1e-9, atol=1e-11, dense_output=True,
            )  # fmt: skip
            x = (seen[step.name] - step.y0) / step.beta
            assert np.abs(x[inside] - result.sol(t[inside])[2]).max() < 2e-3
            assert x[inside].max() > 1.01
        assert np.ptp(brings) < 1e-2 * np.mean(brings)  # one hose
    assert np.ptp(times) > 0.2


def test_a_trap_and_walls_that_hold_water_against_an_ode_solver() -> None:
    strength = 0.5
    rig = case(condensate_trap=strength)
    seen = clean_signals(rig)
    for k, step in enumerate(rig.steps):
        exchange = step.total_flow / rig.V

        def trapped(u: float, x: FloatArray, exchange: float = exchange) -> list[float]:
            cascade = [(u - x[0]) / rig.tau_v, exchange * (x[3] - x[1]), (x[1] - x[2]) / rig.tau]
            return [*cascade, exchange / strength * (x[0] - x[3])]

        _, states = solved(rig, trapped, 4, k=k)
        assert np.abs((seen[step.name] - step.y0) / step.beta - states[:, 2]).max() < 1e-4

    strength, rows = 0.3, set()
    for seed in (11, 12, 13, 14):
        rig = replace(draw_case(seed, size="small"), strengths={"dry_test_gas": strength})
        knobs, seen = prepared_rig(rig)["1"], clean_signals(rig)
        rows.add(n := knobs.dried_cells)
        for k, step in enumerate(rig.steps):
            exchange, wall = step.total_flow / rig.V, n * step.total_flow / knobs.dried_volume

            def drying(
                u: float, x: FloatArray, rig: Case = rig, exchange: float = exchange,
                wall: float = wall,
            ) -> list[float]:  # fmt: skip
                cascade = [(u - x[0]) / rig.tau_v, exchange * (x[0] - x[1])]
                water = [wall * (a - b) for a, b in pairwise((x[1], *x[3:]))]
                # gas is taken up, and water that has gone is missed, by one and the same coating
                return [*cascade, (x[1] - strength * x[-1] - x[2]) / rig.tau, *water]

            _, states = solved(rig, drying, 3 + n, k=k)
            assert np.abs((seen[step.name] - step.y0) / step.beta - states[:, 2]).max() < 1e-4
            late = knobs.dried_volume / step.total_flow
            assert 0.2 < late < 30.0
    assert len(rows) > 1 and rows <= {1, 2, 3, 4}


def test_a_centre_of_mass_lags_at_the_edge_of_its_window() -> None:
    for z, window in ((0.0, 4.0), (1.3, 4.0), (-3.5, 5.0)):
        u = np.linspace(-window, window, 400_001)
        line = dip(u - z)
        expected = (u * line).sum() / line.sum()
        assert centre_of_mass(z, window) == pytest.approx(expected, abs=1e-4)

    strength, directions = 0.7, []
    for seed in (11, 12, 13):
        rig = replace(draw_case(seed, size="small"), strengths={"fixed_window": strength})
        seen, plain = clean_signals(rig), clean_signals(without_causes(rig))
        knobs = prepared_rig(rig)["1"]
        assert 3.0 < knobs.window < 10.0 and abs(knobs.window_begin) < 0.3 * knobs.window
        u = np.linspace(-knobs.window, knobs.window, 20_001)
        for step in rig.steps:
            x = (plain[step.name] - step.y0) / step.beta

            shift = strength * knobs.window * rig.relative_concentration(step)

            def middle(
                x: float, u: FloatArray = u, begin: float = knobs.window_begin, shift: float = shift
            ) -> Any:
                line = dip(u - begin - shift * x)
                return (u * line).sum() / line.sum()

            some = np.arange(0, len(x), 97)
            found = np.array([middle(x[i]) for i in some])
            expected = (found - middle(0.0)) / (middle(1.0) - middle(0.0))
            assert np.abs((seen[step.name][some] - step.y0) / step.beta - expected).max() < 2e-3
            directions.append(float(np.max((seen[step.name] - plain[step.name]) / step.beta)))
    assert max(directions) > 0.02  # ahead of the straight line below the plateau


def test_a_fibre_between_polarisers_turns_its_phase_evenly() -> None:
    strength, turned = 0.2, []
    for seed in (11, 12, 13, 14):
        rig = replace(draw_case(seed, size="small"), strengths={"birefringent_fibre": strength})
        found, seen = prepared_rig(rig), clean_signals(rig)
        plain = clean_signals(without_causes(rig))
        for step in rig.steps:
            (light,) = found[step.name].gain
            y = seen[step.name] / plain[step.name]
            assert y[0] == pytest.approx(1.0, abs=1e-12)
            assert np.allclose(y, 1.0 + light(sample_times(step)), atol=1e-9)
            # crossed axes: 1 + s cos over 1 + s cos at first; beyond its mean it is a sine
            t = np.linspace(0.0, 20.0 * step.duration, 40_001)
            wave = 1.0 + light(t)
            low, high = wave.min(), wave.max()
            assert (high - low) / (high + low) == pytest.approx(strength, rel=1e-3)
            phase = np.unwrap(np.angle(np.exp(1j * np.arccos(
                np.clip((2.0 * wave - high - low) / (high - low), -1.0, 1.0)
            ))))  # fmt: skip
            ways = np.abs(np.diff(phase))
            turned.append(np.median(ways) * 2000.0 / (2.0 * np.pi))
            assert np.mean(np.abs(ways - np.median(ways)) < 0.02 * np.median(ways)) > 0.9
    assert 0.29 < min(turned) and max(turned) < 3.1 and max(turned) > 2.0 * min(turned)


def test_averaged_repeats_are_a_stair_where_one_switch_was() -> None:
    strength, counts = 0.8, set()
    for seed in (11, 12, 13, 14):
        rig = replace(draw_case(seed, size="small"), strengths={"averaged_repeats": strength})
        found, seen = prepared_rig(rig), clean_signals(rig)
        for step in rig.steps:
            late = found[step.name].repeats
            assert late is not None and late.std() == pytest.approx(strength)
            assert late.mean() == pytest.approx(0.0, abs=1e-12)
            counts.add(len(late))
            # each repeat on its own: the same rig, its valve switched at another time
            records = []
            for d in late.tolist():
                own = replace(step, t0=step.t0 + d, tf=step.tf + d)
                records.append(voltage(rig, own, Knobs(), sample_times(step))[0])
            assert np.abs(seen[step.name] - np.mean(records, axis=0)).max() < 1e-3 * step.beta
    assert counts <= {3, 4, 5, 6} and len(counts) > 1


def test_a_diaphragm_snaps_through_and_back_against_an_ode_solver() -> None:
    strength, ways = 0.8, []
    for seed in (11, 12, 13):
        rig = replace(draw_case(seed, size="small"), strengths={"snapping_diaphragm": strength})
        knobs, step, seen = prepared_rig(rig)["1"], rig.steps[0], clean_signals(rig)["1"]
        taus = rig.tau_v, rig.V / step.total_flow, rig.tau

        def snapping(
            u: tuple[float, float], x: FloatArray, taus: tuple[float, ...] = taus
        ) -> list[float]:
            pressure, through = u
            opening = (1.0 - strength) * x[0] + strength * through
            first = (pressure - x[0]) / taus[0]
            return [first, (opening - x[1]) / taus[1], (x[1] - x[2]) / taus[2]]

        # a lag has come up to the share a after -log(1 - a) of its time, down to it after -log a
        through = step.t0 - rig.tau_v * np.log(1.0 - knobs.snap_up)
        back = step.tf - rig.tau_v * np.log(knobs.snap_down)
        inputs = [
            (0.0, (0.0, 0.0)), (step.t0, (1.0, 0.0)), (through, (1.0, 1.0)),
            (step.tf, (0.0, 1.0)), (back, (0.0, 0.0)),
        ]  # fmt: skip
        _, states = solved(rig, snapping, 3, inputs=inputs)
        assert np.abs((seen - step.y0) / step.beta - states[:, 2]).max() < 1e-3
        ways.append(knobs.snap_up - knobs.snap_down)
    assert 0.2 < min(ways) < max(ways) < 0.7


def test_a_carrier_that_yields_to_the_test_gas_against_an_ode_solver() -> None:
    strength, times = 0.5, []
    for seed in (11, 12, 13):
        rig = replace(draw_case(seed, size="small"), strengths={"yielding_carrier": strength})
        found, seen = prepared_rig(rig), clean_signals(rig)
        largest = max(step.test_gas_flow for step in rig.steps)
        for k, step in enumerate(rig.steps):
            (flow,) = found[step.name].carrier
            t = np.linspace(0.0, step.tf, 200_001)
            deepest = strength * step.test_gas_flow / largest
            time = float(t[np.argmin(flow(t))] - step.t0)
            times.append(time)
            assert flow(t).min() == pytest.approx(1.0 - deepest)
            assert flow(t).max() == 1.0  # it yields first and gives too much at the end only
            # then as much too much, but for what is left of the first
            late = np.array([step.tf + time])
            left = (late - step.t0) / time
            expected = 1.0 + deepest * (1.0 - left * np.exp(1.0 - left))
            assert flow(late) == pytest.approx(expected, abs=1e-5)
            if k > 0:
                continue

            def upset(at: float, time: float = time) -> float:
                return max(at, 0.0) / time * float(np.exp(1.0 - max(at, 0.0) / time))

            def yielding(
                at: float, x: FloatArray, u: float, step: Step = step, rig: Case = rig,
                deepest: float = deepest, upset: Any = upset,
            ) -> list[float]:  # fmt: skip
                factor = 1.0 - deepest * (upset(at - step.t0) - upset(at - step.tf))
                total = step.carrier_flow * factor + step.test_gas_flow
                inlet = x[0] * step.test_gas_flow / total / step.concentration
                gas = total / rig.V * (inlet - x[1])
                return [(u - x[0]) / rig.tau_v, gas, (x[1] - x[2]) / rig.tau]

            y, t = np.zeros(3), sample_times(step)
            for low, high, u in ((step.t0, step.tf, 1.0), (step.tf, step.duration, 0.0)):
                inside = (t >= low) & (t < high)
                result = solve_ivp(
                    yielding, (low, high), y, rtol=1e-9, atol=1e-11, dense_output=True,
                    max_step=0.1, args=(u,),
                )  # fmt: skip
                y = result.y[:, -1]
                x = (seen[step.name] - step.y0) / step.beta
                assert np.abs(x[inside] - result.sol(t[inside])[2]).max() < 1e-3
        assert np.ptp(times[-len(rig.steps) :]) < 2e-3  # one controller
    assert 0.39 < min(times) < max(times) < 3.01


def test_what_an_analyser_pumps_comes_back_as_it_went() -> None:
    # round and round: each time through a lag and late by the way, less what the stream took
    strength = 0.8
    for seed in (11, 12):
        rig = replace(draw_case(seed, size="small"), strengths={"analyser_loop": strength})
        seen, pumped = clean_signals(rig), prepared_rig(rig)["1"].loop_pumped
        late = strength * rig.V / pumped
        for k, step in enumerate(rig.steps):
            both, rounds = step.total_flow + pumped, 50

            def turning(
                u: float, x: FloatArray, q: float = step.total_flow, r: float = pumped,
                rig: Case = rig,
            ) -> list[float]:  # fmt: skip
                change = [(u - x[0]) / rig.tau_v]
                change.append((q * x[0] - (q + r) * x[1]) / rig.V)
                change += ((r * x[1:-1] - (q + r) * x[2:]) / rig.V).tolist()
                return change

            t, states = solved(rig, turning, rounds + 1, k=k)
            gas = sum(
                np.interp(t - turn * late, t, states[:, 1 + turn], left=0.0)
                for turn in range(rounds)
            )
            assert (pumped / both) ** rounds < 1e-4
            x = lagged(t, gas, rig.tau)
            assert np.abs((seen[step.name] - step.y0) / step.beta - x).max() < 2e-3
    # the loop's volume delays a step by as much as if it lay in the stream
    t = np.linspace(0.0, 60.0, 60_001)
    x = looped(t, np.ones_like(t), np.full(len(t), 40.0), 30.0, 25.0, 0.7)
    assert np.trapezoid(1.0 - x, t) == pytest.approx((30.0 + 25.0 * 0.7) / 40.0, rel=1e-4)
    # and a way that takes no time is none, even on steps that are longer
    coarse = np.linspace(0.0, 5.0, 101)
    short = looped(coarse, np.ones(101), np.full(101, 40.0), 30.0, 25.0, 1e-4)
    assert short == pytest.approx(1.0 - np.exp(-coarse * 40.0 / 30.0), abs=2e-3)


def lagged(t: FloatArray, u: FloatArray, tau: float) -> FloatArray:
    """(n,) first-order lag of straight lines between even samples, from 0."""
    h = t[1] - t[0]
    e = np.exp(-h / tau)
    # what an interval adds: of the sample before, and of the one at its end
    last = 1.0 - tau / h * (1.0 - e)
    first = 1.0 - e - last
    return np.asarray(lfilter([last, first], [1.0, -e], u))


def test_a_coating_ignites_and_goes_on_burning_below() -> None:
    strength, borders = 0.3, []
    for seed in (11, 12, 13):
        rig = replace(draw_case(seed, size="small"), strengths={"igniting_coating": strength})
        knobs, seen = prepared_rig(rig)["1"], clean_signals(rig)
        burns, brought, time = knobs.glow_burns, knobs.glow_brought, knobs.glow_time

        def steady(w: FloatArray, burns: float = burns, brought: float = brought) -> FloatArray:
            return w * (np.exp(-w) / burns + 1.0 / brought)  # the gas that keeps it as warm

        w = np.linspace(0.0, 2.0 * brought, 400_001)
        slopes = np.sign(np.diff(steady(w)))
        (up,) = np.flatnonzero((slopes[1:] < 0) & (slopes[:-1] > 0)) + 1
        (down,) = np.flatnonzero((slopes[1:] > 0) & (slopes[:-1] < 0)) + 1
        ignites, dies = float(steady(w)[up]), float(steady(w)[down])
        borders.append(ignites)
        assert dies < ignites
        # all of it at the highest concentration
        assert knobs.glow * np.interp(1.0, steady(w)[down:], w[down:]) == pytest.approx(
            strength, rel=1e-4
        )
        # slowly up and down again: it jumps where it must, and elsewhere on the way back
        t = np.linspace(0.0, 4000.0 * time, 400_001)
        g = 1.0 - np.abs(t / (2000.0 * time) - 1.0)
        warmth = burning(t, g, burns, brought, time)
        hot = warmth > 0.5 * (w[up] + w[down])
        assert g[np.argmax(hot)] == pytest.approx(ignites, abs=0.03)
        assert g[len(hot) - 1 - np.argmax(hot[::-1])] == pytest.approx(dies, abs=0.03)

        for k, step in enumerate(rig.steps):
            relative, exchange = rig.relative_concentration(step), step.total_flow / rig.V

            def glowing(
                u: float, x: FloatArray, rig: Case = rig, relative: float = relative,
                exchange: float = exchange, burns: float = burns, brought: float = brought,
                time: float = time,
            ) -> list[float]:  # fmt: skip
                heat = relative * x[1] / (np.exp(-x[3]) / burns + 1.0 / brought)
                cascade = [(u - x[0]) / rig.tau_v, exchange * (x[0] - x[1])]
                return [*cascade, (x[1] - x[2]) / rig.tau, (heat - x[3]) / time]

            _, states = solved(rig, glowing, 4, k=k)
            x = states[:, 2] + knobs.glow / relative * states[:, 3]
            assert np.abs((seen[step.name] - step.y0) / step.beta - x).max() < 1e-3
    assert 0.3 < min(borders) < max(borders) < 0.7


def test_a_beam_is_bent_while_fresh_gas_lies_beside_old() -> None:
    strength = 0.4
    rig = case(bent_beam=strength)
    seen, darkest = clean_signals(rig), []
    for k, step in enumerate(rig.steps):
        exchange = step.total_flow / rig.V

        def cascade(u: float, x: FloatArray, exchange: float = exchange) -> list[float]:
            return [(u - x[0]) / rig.tau_v, exchange * (x[0] - x[1]), (x[1] - x[2]) / rig.tau]

        t, states = solved(rig, cascade, 3, k=k)
        differs = rig.relative_concentration(step) * (states[:, 0] - states[:, 1])
        light = np.exp(np.log(1.0 - strength) * differs**2)  # a Gaussian in the way it goes off
        y = (step.y0 + step.beta * states[:, 2]) * light
        assert np.abs(seen[step.name] - y).max() < 1e-4 * step.beta
        darkest.append(light.min())
        # less light both ways, and all of it where the gas is mixed
        mixed = (t < step.t0) | ((t > step.tf - 0.5) & (t < step.tf))
        assert light[mixed].min() > 0.999
    # the more of it, the stronger the gas
    relative = [rig.relative_concentration(step) for step in rig.steps]
    assert np.argmin(darkest) == np.argmax(relative) and min(darkest) < 0.97


def test_a_choppers_openings_go_round_with_its_wheel() -> None:
    strength, wheels = 0.07, []
    for seed in (11, 12, 13, 14):
        rig = replace(draw_case(seed, size="small"), strengths={"uneven_chopper": strength})
        found, seen = prepared_rig(rig), clean_signals(rig)
        plain, turns = clean_signals(without_causes(rig)), []
        for step in rig.steps:
            (light,) = found[step.name].gain
            at = sample_times(step)
            assert np.allclose(seen[step.name], plain[step.name] * (1.0 + light(at)), atol=1e-9)
            t = np.linspace(0.0, 60.0, 600_001)
            w = light(t)
            assert np.abs(w).max() == pytest.approx(strength, rel=1e-2)
            assert abs(w.mean()) < 0.02 * strength
            # the opening that is most off passes once a turn
            sharp = np.flatnonzero(np.abs(w) > 0.98 * np.abs(w).max())
            passes = np.split(t[sharp], np.flatnonzero(np.diff(sharp) > 1) + 1)
            middles = np.array([part.mean() for part in passes[1:-1]])
            each = np.diff(middles)
            turns.append(1.0 / each.mean())
            assert 1e-3 < np.ptp(each) / each.mean() < 0.06  # hardly even
            # turn for turn the same openings
            quarter = middles[:-1, None] + np.outer(each, np.linspace(0.05, 0.95, 19))
            assert np.ptp(light(quarter[3:8]), axis=0).max() < 0.15 * strength
        assert np.ptp(turns) < 0.01 * np.mean(turns)
        wheels.append(np.mean(turns))
    assert 1.9 < min(wheels) and max(wheels) < 12.1 and max(wheels) > 1.3 * min(wheels)


def test_a_meter_that_looks_for_its_range_shows_its_last_reading() -> None:
    t = np.arange(1000) * 0.01
    y = 5.0 - np.abs(t - 5.0)
    out = blanked(t, y, 3.004, 2.496, 1.0)
    up, down = (t > 3.005) & (t < 4.005), (t > 7.505) & (t < 8.505)
    assert out[up] == pytest.approx(3.0) and out[down] == pytest.approx(2.5)
    assert np.array_equal(out[~(up | down)], y[~(up | down)])

    strength, stood = 0.9, 0
    for seed in (11, 12, 13):
        rig = replace(draw_case(seed, size="small"), strengths={"blanked_ranging": strength})
        knobs, seen = prepared_rig(rig)["1"], clean_signals(rig)
        plain = clean_signals(without_causes(rig))
        assert knobs.blank_down < knobs.blank_up
        for step in rig.steps:
            t, y, shown = sample_times(step), plain[step.name], seen[step.name]
            blank = np.zeros(len(t), dtype=bool)
            if y.max() > knobs.blank_up:
                # between samples the meter has gone on, by a step of the grid at most
                rises = t[np.argmax(y > knobs.blank_up)]
                falls = t[len(y) - np.argmax(y[::-1] > knobs.blank_down)]
                for at, level in ((rises, knobs.blank_up), (falls, knobs.blank_down)):
                    inside = (t > at + 0.01) & (t < at + strength - 0.02)
                    assert np.ptp(shown[inside]) < 1e-12
                    assert shown[inside][0] == pytest.approx(level, abs=0.03 * step.beta)
                    blank |= (t > at - 0.02) & (t < at + strength + 0.02)
                    stood += 1
            assert np.abs(shown - y)[~blank].max() < 1e-12
    assert stood >= 2 * len(rig.steps)


def test_a_display_in_a_hurry_goes_too_far() -> None:
    strength, shorts = 1.2, []
    for seed in (11, 12, 13):
        rig = replace(draw_case(seed, size="small"), strengths={"hurried_display": strength})
        seen, short = clean_signals(rig), prepared_rig(rig)["1"].lead_lag
        shorts.append(short / strength)
        for k, step in enumerate(rig.steps):
            exchange = step.total_flow / rig.V

            def hurried(
                u: float, x: FloatArray, rig: Case = rig, exchange: float = exchange,
                short: float = short,
            ) -> list[float]:  # fmt: skip
                cascade = [(u - x[0]) / rig.tau_v, exchange * (x[0] - x[1])]
                return [*cascade, (x[1] - x[2]) / rig.tau, (x[2] - x[3]) / short]

            _, states = solved(rig, hurried, 4, k=k)
            shown = states[:, 2] + strength * (states[:, 2] - states[:, 3]) / short
            assert np.abs((seen[step.name] - step.y0) / step.beta - shown).max() < 1e-3
            assert shown.max() > 1.02 and shown.min() < -0.02
    assert 0.05 < min(shorts) < max(shorts) < 0.25


def test_the_layered_film_is_a_delay_of_the_stated_mean_and_not_one_lag() -> None:
    times, weights = layered_film(0.05)
    assert weights.sum() == pytest.approx(1.0, abs=1e-12)  # settles at the gas's concentration
    assert weights @ times == pytest.approx(0.05)
    t = np.concatenate([[-1e-6], np.linspace(0.0, 1.0, 4001)])
    x = modal(t, (t >= 0).astype(float), times, weights)
    assert np.all(np.diff(x) > -1e-10)  # rounding of the modes' sum
    # a film holds back at first: far less than the lag's 1 - exp(-0.1) after a tenth of its mean
    assert np.interp(0.005, t, x) < 0.3 * (1.0 - np.exp(-0.1))


def test_the_whole_lorentzian_is_read() -> None:
    rig = case()
    step = rig.steps[0]
    t = sample_times(step)
    straight, x = voltage(rig, step, Knobs(), t)
    y, _ = voltage(rig, step, Knobs(shift=0.6, detuning=-1.0), t)
    z = -1.0 + 0.6 * rig.relative_concentration(step) * x
    scaled = (1 / (1 + z**2) - 0.5) / (1 / (1 + z.max() ** 2) - 0.5)
    assert dip(-1.0) == 0.5
    # the plateau is reached to exp(-tens of time constants) only
    assert np.abs((y - step.y0) / step.beta - scaled).max() < 1e-5
    assert np.abs(y - straight).max() > 0.02 * step.beta


# --------------------------------------------------------------------------- noise


@pytest.mark.parametrize("name", [*OPEN_LAWS, *RESERVE_LAWS])
def test_noise_has_the_stated_autocorrelation(name: str) -> None:
    rng = np.random.default_rng(5)
    law = draw_law(name, rng, 0.05)
    assert law.sigma0**2 + law.sigma1**2 == pytest.approx(0.05**2)
    assert sum(part.share for part in law.components) == pytest.approx(1.0)
    n, interval, stretches = 4000, 2e-3, 150
    stated = autocorrelation(law, n, interval)
    z = np.array([draw_noise(law, n, interval, rng) for _ in range(stretches)])
    for lag in (0, 1, 3, 10, 40, 200, 1000):
        each = (z[:, : n - lag] * z[:, lag:]).mean(axis=1)
        error = each.std(ddof=1) / np.sqrt(stretches)
        # five standard errors of the mean over stretches: seven lags a law, none should fail
        assert abs(each.mean() - stated[lag]) < 5.0 * error + 1e-4


def test_shot_noise_leans_to_one_side_and_gusts_come_and_go() -> None:
    rng = np.random.default_rng(8)
    shot = NoiseLaw("shot", 1.0, components=(Component(1.0, 0.01, shape="shot", rate=0.5),))
    z = draw_noise(shot, 400_000, 1e-3, rng)
    # cumulants of pulses h exp(-s/T), heights with <h^k> = k!: rate k!/k, here (k - 1)! / 2
    assert abs(z.mean()) < 0.03
    assert np.mean(z**3) == pytest.approx(2.0 * 0.5**-0.5, rel=0.15)
    assert z.min() > -(0.5**0.5) - 1e-9  # no pulse: the mean is missing, nothing more

    gusty = Component(1.0, 1e-3, shape="gusts", depth=0.8, gust_time=1.0)
    law = NoiseLaw("gusty", 1.0, components=(gusty,))
    z = draw_noise(law, 400_000, 1e-3, rng)
    assert not law.is_ar1 and not shot.is_ar1
    # the variance is 0.2 or 1.8: kurtosis 3 (1 + 0.8^2), and the squares stay correlated
    assert np.mean(z**4) == pytest.approx(3.0 * 1.64, rel=0.1)
    loud = (z**2).reshape(-1, 100).mean(axis=1)  # 0.1 s each
    assert np.mean(loud < 0.6) > 0.3 and np.mean(loud > 1.2) > 0.3


def test_sparks_echoes_and_double_samples_are_what_they_say() -> None:
    rng = np.random.default_rng(9)
    part = Component(1.0, 0.01, 50.0, shape="sparks", rate=2.0)
    sparks = NoiseLaw("sparks", 1.0, components=(part,))
    z = draw_noise(sparks, 400_000, 1e-3, rng)
    # Campbell: fourth cumulant rate/4 <h^4> <cos^4> over (rate/4 <h^2>)^2, <h^k> = k!: 9 / rate
    assert np.mean(z**4) / np.mean(z**2) ** 2 - 3.0 == pytest.approx(4.5, rel=0.25)
    assert abs(np.mean(z**3)) < 0.5  # to both sides

    # an echo undone: z_i - r z_(i - m) + r^2 z_(i - 2 m) .. is the process itself again
    echo = NoiseLaw("echo", 1.0, components=(Component(1.0, 0.02, 50.0, "echo", depth=0.5),))
    z = draw_noise(echo, 200_000, 1e-3, rng)
    undone = lfilter([1.0], np.concatenate([[1.0], np.zeros(19), [0.5]]), z)[1000:]
    after = [float(np.mean(undone[lag:] * undone[:-lag])) / float(undone.var()) for lag in (5, 20)]
    assert after == pytest.approx(np.exp([-0.25, -1.0]), abs=0.04)

    pair = Component(1.0, shape="difference", depth=0.8)
    law = NoiseLaw("double_sampling", 1.0, components=(pair,))
    z = draw_noise(law, 200_000, 1e-3, rng)
    assert np.mean(z[1:] * z[:-1]) == pytest.approx(-0.8 / 1.64, abs=0.02)
    # what is averaged over is nearly gone: (1 - 0.8)^2 / (1 + 0.8^2) of white noise
    assert z.reshape(-1, 500).mean(axis=1).var() * 500 < 0.1
    assert not (sparks.is_ar1 or echo.is_ar1 or law.is_ar1)


def test_turbulence_walks_set_back_and_pulsing_noise_are_what_they_say() -> None:
    rng = np.random.default_rng(10)
    stirred = NoiseLaw("turbulent", 1.0, components=(Component(1.0, 5.0, shape="turbulent"),))
    z = draw_noise(stirred, 400_000, 1e-3, rng)
    # Kolmogorov: squared differences grow as the 2/3 power of the distance
    near, far = (np.mean((z[lag:] - z[:-lag]) ** 2) for lag in (4, 32))
    assert far / near == pytest.approx(8.0 ** (2.0 / 3.0), rel=0.05)

    walk = NoiseLaw("zeroed_walk", 1.0, components=(Component(1.0, 0.5, shape="zeroed"),))
    z = draw_noise(walk, 500_000, 1e-3, rng)
    folded = np.mean(z.reshape(-1, 500) ** 2, axis=0)
    since = np.roll(folded, -int(folded.argmin()))  # variance 2 lag / period since the last zero
    # a thousand walks, whose squares scatter by 4.5 % of the variance
    assert np.abs(since - 2.0 * np.arange(500) / 500.0).max() < 0.35
    assert since[0] < 0.01

    part = Component(1.0, 2e-3, 4.0, shape="pulsing", depth=0.8)
    law = NoiseLaw("pulsing", 1.0, components=(part,))
    z = draw_noise(law, 500_000, 1e-3, rng)
    # (1 + d cos)^k averaged over a turn: k = 2: 1 + d^2/2, k = 4: 1 + 3 d^2 + 3/8 d^4
    kurtosis = 3.0 * (1.0 + 3.0 * 0.64 + 0.375 * 0.64**2) / 1.32**2
    assert np.mean(z**4) == pytest.approx(kurtosis, rel=0.1)
    loud = np.sqrt(np.mean(z.reshape(-1, 250) ** 2, axis=0) * 1.32)  # over one turn
    turn = np.fft.rfft(loud) / 250
    assert 2.0 * abs(turn[1]) == pytest.approx(0.8, rel=0.1) and turn[0].real > 0.9
    assert not (stirred.is_ar1 or walk.is_ar1 or law.is_ar1)


def test_coupled_noise_drawn_lines_and_fringes_are_what_they_say() -> None:
    rng = np.random.default_rng(12)
    # what the capacitor took is the integral of what it left over its time
    corner = 1.0 / (2.0 * np.pi * 0.2)
    coupled = NoiseLaw("ac_coupled", 1.0, components=(Component(1.0, 0.02, corner, "coupled"),))
    z = draw_noise(coupled, 400_000, 1e-3, rng)
    undone = z + np.cumsum(z) * 1e-3 / 0.2
    undone -= undone.mean()
    after = [float(np.mean(undone[lag:] * undone[:-lag])) / float(undone.var()) for lag in (5, 20)]
    assert after == pytest.approx(np.exp([-0.25, -1.0]), abs=0.04)
    # nothing is left of what is slow: white noise of the same density would have 2 * 0.02 s
    assert z.reshape(-1, 10_000).mean(axis=1).var() * 10.0 < 0.1 * 0.04

    lines = NoiseLaw("interpolated", 1.0, components=(Component(1.0, 0.02, shape="interpolated"),))
    z = draw_noise(lines, 400_000, 1e-3, rng)
    bends = np.abs(np.diff(z, 2)) > 1e-9
    assert bends.mean() == pytest.approx(2.0 / 20.0, rel=0.01)  # about a reading only
    folded = np.mean(z.reshape(-1, 20) ** 2, axis=0)  # 3/2 at the readings, half between them
    assert folded.max() == pytest.approx(1.5, rel=0.06)
    assert folded.min() == pytest.approx(0.75, rel=0.06)

    part = Component(1.0, 0.05, shape="fringes", depth=0.5)
    etalon = NoiseLaw("etalon", 1.0, components=(part,))
    z = draw_noise(etalon, 400_000, 1e-3, rng)
    # sum of r^k cos(k phase) lies between -r/(1 + r) and r/(1 - r); its variance is r^2/(1-r^2)/2
    bounds = np.array([-0.5 / 1.5, 0.5 / 0.5]) / np.sqrt(0.5 * 0.25 / 0.75)
    assert [z.min(), z.max()] == pytest.approx(bounds, abs=0.01)
    # lopsided as that sum is when any phase is as likely
    phase = np.linspace(0.0, 2.0 * np.pi, 20_000, endpoint=False)
    sums = np.sum([0.5**k * np.cos(k * phase) for k in range(1, 40)], axis=0)
    assert np.mean(z**3) == pytest.approx(np.mean(sums**3) / sums.std() ** 3, rel=0.1)
    assert not (coupled.is_ar1 or lines.is_ar1 or etalon.is_ar1)


def test_molecules_speckle_and_whistling_are_what_they_say() -> None:
    rng = np.random.default_rng(14)
    part = Component(1.0, 0.05, shape="diffusing")
    molecules = NoiseLaw("molecules", 1.0, components=(part,))
    z = draw_noise(molecules, 400_000, 1e-3, rng)
    assert np.mean(z**4) == pytest.approx(3.0, rel=0.05)  # many of them: Gaussian
    # 1/(1 + lag/T) has no time of its own beyond T: the variance of means over n T falls as
    # 2 [(1 + n) ln(1 + n) - n] / n^2, far more slowly than 2/n
    for n in (4, 40):
        means = z[: 400_000 // (50 * n) * 50 * n].reshape(-1, 50 * n).mean(axis=1)
        expected = 2.0 * ((1.0 + n) * np.log1p(n) - n) / n**2
        error = expected * np.sqrt(2.0 / len(means))
        assert np.mean(means**2) == pytest.approx(expected, abs=5.0 * error)

    speckle = NoiseLaw("speckle", 1.0, components=(Component(1.0, 0.005, shape="speckle"),))
    z = draw_noise(speckle, 600_000, 1e-3, rng)
    # exponentially distributed: never below no light at all, lopsided by 2, kurtosis 9
    assert z.min() >= -1.0 and z.min() == pytest.approx(-1.0, abs=1e-3)
    assert np.mean(z > 2.0) == pytest.approx(np.exp(-3.0), rel=0.06)
    assert np.mean(z**3) == pytest.approx(2.0, rel=0.15)
    assert np.mean(z**4) == pytest.approx(9.0, rel=0.3)

    part = Component(1.0, 0.5, 10.0, shape="whistling", depth=0.5)
    whistling = NoiseLaw("whistling", 1.0, components=(part,))
    z = draw_noise(whistling, 400_000, 1e-3, rng)
    assert np.abs(z).max() <= np.sqrt(2.0)
    assert np.mean(z**4) == pytest.approx(1.5, rel=0.02)  # of a sine
    power = np.abs(np.fft.rfft(z.reshape(-1, 4000), axis=1)).mean(axis=0) ** 2
    frequency = np.fft.rfftfreq(4000, 1e-3)
    inside = power[(frequency > 6.0) & (frequency < 14.0)]
    outside = power[(frequency > 20.0) | (frequency < 1.0)]
    assert inside.min() > 10.0 * outside.max()
    assert inside.max() < 2.0 * inside.min()  # any pitch as likely
    # a tone obeys x_(i+1) = 2 cos(w) x_i - x_(i-1) but for its breaks, two of them a second
    ratio = (z[2:] + z[:-2])[np.abs(z[1:-1]) > 0.3] / z[1:-1][np.abs(z[1:-1]) > 0.3] / 2.0
    pitch = np.arccos(np.clip(ratio, -1.0, 1.0)) / (2.0 * np.pi * 1e-3)
    assert np.mean((pitch > 4.99) & (pitch < 15.01)) > 0.99
    assert not (molecules.is_ar1 or speckle.is_ar1 or whistling.is_ar1)


def test_notched_interleaved_and_charging_noise_are_what_they_say() -> None:
    rng = np.random.default_rng(16)
    h, time_, frequency = 1e-3, 0.1, 12.0
    part = Component(1.0, time_, frequency, "notched")
    notched = NoiseLaw("notched", 1.0, components=(part,))
    z = draw_noise(notched, 1_000_000, h, rng)
    f, power = welch(z, 1.0 / h, nperseg=20_000, detrend=False)
    # nothing at its frequency, half at 1/(2 pi time) to either side, all of it far away
    far = np.median(power[(f > 100.0) & (f < 400.0)])
    assert power[np.abs(f - frequency).argmin()] < 0.01 * far
    for side in (-1.0, 1.0):
        at = frequency + side / (2.0 * np.pi * time_)
        assert np.mean(power[np.abs(f - at) < 0.16]) == pytest.approx(0.5 * far, rel=0.15)
    # variance 1: what is taken away is pi/2 times the notch's full width, of the whole band
    assert 0.5 / h * far == pytest.approx(1.0 + 2.0 * h / time_ / 2.0, rel=0.03)
    # the closed form of the sampled filter: the spectrum is its autocorrelation's transform
    R = autocorrelation(notched, 4000, h)
    grid = np.array([3.0, 8.0, 12.0, 20.0, 100.0])
    k = np.arange(1, 4000)
    density = [R[0] + 2.0 * np.sum(R[1:] * np.cos(2.0 * np.pi * x * h * k)) for x in grid]
    t2 = (np.tan(np.pi * grid * h) ** 2 - np.tan(np.pi * frequency * h) ** 2) ** 2
    # bilinear transform of (s^2 + w^2)/(s^2 + b s + w^2), the textbook notch
    r2 = np.exp(-2.0 * h / time_)
    b = (1.0 - r2) / (1.0 + r2) * (1.0 + np.tan(np.pi * frequency * h) ** 2)
    expected = t2 / (t2 + (b * np.tan(np.pi * grid * h)) ** 2) * 2.0 / (1.0 + r2)
    assert density == pytest.approx(expected, abs=2e-3)
    assert np.mean(z**4) == pytest.approx(3.0, rel=0.03)

    law = NoiseLaw("interleaved", 1.0, components=(Component(1.0, shape="interleaved", depth=0.8),))
    z = draw_noise(law, 200_000, h, rng)
    pair = np.sort([z[::2].var(), z[1::2].var()])
    assert pair == pytest.approx([0.2, 1.8], rel=0.03)
    assert np.mean(z**4) == pytest.approx(3.0 * 1.64, rel=0.05)
    for half in (z[::2], z[1::2]):  # each converter by itself is Gaussian
        assert np.mean(half**4) / half.var() ** 2 == pytest.approx(3.0, rel=0.05)
    firsts = [np.abs(draw_noise(law, 400, h, rng)[::2]).mean() > 0.6 for _ in range(40)]
    assert 8 < sum(firsts) < 32  # either begins

    charging = NoiseLaw("charging", 1.0, components=(Component(1.0, 0.05, shape="charging"),))
    z = draw_noise(charging, 1_000_000, h, rng)
    # exponentially distributed above the level it falls to: standard deviation, lean and tail
    assert z.min() >= -1.0 and z.min() == pytest.approx(-1.0, abs=1e-3)
    assert np.mean(z > 1.0) == pytest.approx(np.exp(-2.0), rel=0.05)
    assert np.mean(z**3) == pytest.approx(2.0, rel=0.1)
    falls = np.diff(z) < 0.0
    # a rise that breaks down within the next interval shows there unless it was so young
    assert falls.mean() == pytest.approx(-np.expm1(-h / 0.05), rel=0.05)
    assert np.allclose(np.diff(z)[~falls & (z[:-1] > -1.0 + h / 0.05)], h / 0.05, atol=1e-9)
    assert not (notched.is_ar1 or law.is_ar1 or charging.is_ar1)


def test_shaped_noise_motes_and_rollers_are_what_they_say() -> None:
    rng = np.random.default_rng(18)
    h = 1e-3
    shaping = NoiseLaw("noise_shaping", 1.0, components=(Component(1.0, shape="shaped"),))
    z = draw_noise(shaping, 400_000, h, rng)
    # what is passed on twice nearly cancels: a sum over any stretch has the variance 4/6 only
    for n in (20, 200):
        sums = z.reshape(-1, n).sum(axis=1)
        assert sums.var() == pytest.approx(4.0 / 6.0, rel=5.0 * np.sqrt(2.0 / len(sums)))
    f, power = welch(z, 1.0 / h, nperseg=400, detrend=False)
    grid = (f > 20.0) & (f < 480.0)
    assert power[grid] == pytest.approx(2.0 * h / 6.0 * (2.0 * np.sin(np.pi * f[grid] * h)) ** 4,
                                        rel=0.25, abs=2e-6)  # fmt: skip
    assert autocorrelation(shaping, 5, h) == pytest.approx([1.0, -4 / 6, 1 / 6, 0.0, 0.0])
    assert len(autocorrelation(shaping, 1, h)) == 1

    part = Component(1.0, 0.1, shape="motes", rate=0.5)
    dusty = NoiseLaw("dusty", 1.0, components=(part,))
    z = draw_noise(dusty, 1_000_000, h, rng)
    # Poisson's numbers with the mean rate times a disc's mean chord over its diameter
    mean = 0.5 * np.pi / 4.0
    count = mean - z * np.sqrt(mean)
    assert np.abs(count - np.rint(count)).max() < 1e-9 and count.min() > -0.5
    for k, share in enumerate(np.exp(-mean) * np.array([1.0, mean, mean**2 / 2.0])):
        assert np.mean(np.rint(count) == k) == pytest.approx(share, abs=0.015)
    assert np.mean(z**3) == pytest.approx(-(mean**-0.5), rel=0.1)
    # so few that they hardly meet: chords longer than u diameters are sqrt(1 - u^2) of all
    alone = NoiseLaw("dusty", 1.0, components=(replace(part, rate=0.02),))
    dark = draw_noise(alone, 4_000_000, h, rng) < 0.0
    edges = np.flatnonzero(np.diff(np.concatenate([[False], dark, [False]]).astype(int)))
    assert len(edges) > 1000
    lasts = (edges[1::2] - edges[::2]) * h / 0.1
    assert np.mean(lasts > 1.01) < 0.03
    for u in (0.3, 0.6, 0.9):
        error = np.sqrt(u**2 * (1.0 - u**2) / len(lasts))
        assert np.mean(lasts > u) == pytest.approx(np.sqrt(1.0 - u**2), abs=5.0 * error + 0.02)
    # two discs a diameter and more apart do not meet
    assert np.all(autocorrelation(dusty, 300, h)[100:] == 0.0)

    part = Component(1.0, 20.0, 5.0, "strokes", depth=0.5)
    rollers = NoiseLaw("roller_pump", 1.0, components=(part,))
    z = draw_noise(rollers, 400_000, h, rng)
    bounds = np.array([-0.5 / 1.5, 0.5 / 0.5]) / np.sqrt(0.5 * 0.25 / 0.75)
    assert [z.min(), z.max()] == pytest.approx(bounds, abs=0.01)
    f, power = welch(z, 1.0 / h, nperseg=20_000, detrend=False)
    lines = [power[np.abs(f - k * 5.0) < 2.0].sum() for k in (1, 2, 3)]
    # a quarter of the power from each harmonic to the next, and nothing between
    assert lines[1] / lines[0] == pytest.approx(0.25, rel=0.05)
    assert lines[2] / lines[1] == pytest.approx(0.25, rel=0.05)
    assert lines[0] * (f[1] - f[0]) == pytest.approx(0.75, rel=0.05)
    assert power[(f > 2.0) & (f < 3.0)].max() < 0.02 * power.max()
    strokes = np.sum((z[1:] > 1.0) & (z[:-1] <= 1.0))
    assert strokes == pytest.approx(5.0 * 400.0, abs=60)  # its phase walks by some turns only
    # how soon lines forget: after a fifth of the time exp(-1/5) and exp(-4/5) of them are left
    R = autocorrelation(rollers, 4001, h)
    first, second = 0.75 * np.exp(-0.2), 0.75 / 4.0 * np.exp(-0.8)
    later = 0.75 / 16.0 * np.exp(-1.8) + 0.75 / 64.0 * np.exp(-3.2)
    assert R[4000] == pytest.approx(first + second + later, abs=1e-3)  # whole turns of all of them
    assert not (shaping.is_ar1 or dusty.is_ar1 or rollers.is_ar1)


def test_bells_bits_and_intermittent_noise_are_what_they_say() -> None:
    rng = np.random.default_rng(20)
    h = 1e-3
    bell = NoiseLaw("beam_crossing", 1.0, components=(Component(1.0, 0.02, shape="bell"),))
    z = draw_noise(bell, 400_000, h, rng)
    # as smooth as can be: mean square slope 2/T^2, and a spectrum that falls as exp(-(pi f T)^2)
    slopes = np.diff(z) / h
    assert np.mean(slopes**2) == pytest.approx(2.0 / 0.02**2, rel=0.03)
    f, power = welch(z, 1.0 / h, nperseg=4000, detrend=False)
    grid = f < 45.0
    expected = 2.0 * np.sqrt(np.pi) * 0.02 * np.exp(-((np.pi * f * 0.02) ** 2))
    assert power[grid][1:] == pytest.approx(expected[grid][1:], rel=0.6)
    assert np.sum(power[grid][1:]) == pytest.approx(np.sum(expected[grid][1:]), rel=0.05)
    assert power[f > 120.0].max() < 1e-5 * power.max()
    # Rice: how often it comes up through zero
    ups = np.sum((z[1:] > 0.0) & (z[:-1] <= 0.0))
    rate = 400.0 * np.sqrt(2.0) / 0.02 / (2.0 * np.pi)
    assert ups == pytest.approx(rate, rel=0.03)
    # of a stretch shorter than its time the variance over many is 1 still
    short = np.array([draw_noise(bell, 5, h, rng)[[0, -1]] for _ in range(4000)])
    assert np.mean(short**2) == pytest.approx(1.0, abs=0.08)
    assert np.mean(short[:, 0] * short[:, 1]) == pytest.approx(np.exp(-0.04), abs=0.08)

    bits = NoiseLaw("one_bit", 1.0, components=(Component(1.0, 5e-3, shape="bits"),))
    z = draw_noise(bits, 400_000, h, rng)
    decay = np.exp(-h / 5e-3)
    steps = (z[1:] - decay * z[:-1]) / np.sqrt(1.0 - decay**2)
    assert np.abs(np.abs(steps) - 1.0).max() < 1e-9  # up or down, never anything else
    assert abs(np.mean(steps)) < 5.0 / np.sqrt(len(steps))
    assert abs(np.mean(steps[1:] * steps[:-1])) < 5.0 / np.sqrt(len(steps))
    # fourth cumulant of a sum of decay^k e_k: -2 (1 - decay^2)^2 / (1 - decay^4)
    excess = -2.0 * (1.0 - decay**2) / (1.0 + decay**2)
    assert np.mean(z**4) - 3.0 == pytest.approx(excess, abs=0.05)
    assert np.abs(z).max() < np.sqrt((1.0 + decay) / (1.0 - decay))

    part = Component(1.0, 2e-3, shape="lognormal", depth=0.5, gust_time=0.1)
    law = NoiseLaw("intermittent", 1.0, components=(part,))
    z = draw_noise(law, 1_000_000, h, rng)
    assert z.var() == pytest.approx(1.0, rel=0.05)
    assert np.mean(z**4) / z.var() ** 2 == pytest.approx(3.0 * np.exp(4.0 * 0.25), rel=0.15)
    # ln z^2 adds what the Gaussian has by itself to 2 depth times the slow one: far apart only
    # that is correlated, with variance 4 depth^2
    logs = np.log(z**2)
    logs -= logs.mean()
    for lag in (40, 100):
        expected = 4.0 * 0.25 * np.exp(-lag * h / 0.1)
        assert np.mean(logs[lag:] * logs[:-lag]) == pytest.approx(expected, abs=0.06)
    assert not (bell.is_ar1 or bits.is_ar1 or law.is_ar1)


def test_conducted_latched_and_waning_noise_are_what_they_say() -> None:
    rng = np.random.default_rng(22)
    h = 1e-3
    bar = NoiseLaw("conducting", 1.0, components=(Component(1.0, 0.1, shape="conducting"),))
    z = draw_noise(bar, 1_000_000, h, rng)
    assert np.mean(z**4) / z.var() ** 2 == pytest.approx(3.0, rel=0.05)
    # a bar's impedance 1/(1 + sqrt(i w T)): its real part is the spectrum but for w itself,
    # rough as the root of the lag when near, and 1/sqrt(pi lag) when far
    for lag, expected in ((1, erfcx(0.1)), (100, erfcx(1.0)), (2000, 1.0 / np.sqrt(20.0 * np.pi))):
        assert np.mean(z[lag:] * z[:-lag]) == pytest.approx(expected, abs=0.06)
    f, power = welch(z, 1.0 / h, nperseg=50_000, detrend=False)
    w = 2.0 * np.pi * f[1:] * 0.1
    # transform of erfcx(sqrt(t)): 1/(s + sqrt(s))
    density = 4.0 * 0.1 * np.real(1.0 / (1j * w + np.sqrt(1j * w)))
    for low, high in ((0.1, 0.5), (0.5, 5.0), (5.0, 50.0)):
        band = (f[1:] > low) & (f[1:] < high)
        assert power[1:][band].mean() == pytest.approx(density[band].mean(), rel=0.2)

    latch = NoiseLaw("latching", 1.0, components=(Component(1.0, 0.05, shape="latching"),))
    z = draw_noise(latch, 1_000_000, h, rng)
    assert np.all(np.abs(z) == 1.0) and abs(z.mean()) < 0.05
    # dwells of two exponentials in a row: mean twice, variance twice the square of their time
    edges = np.flatnonzero(np.diff(z) != 0.0)
    dwells = np.diff(edges) * h / 0.05
    assert dwells.mean() == pytest.approx(2.0, rel=0.05)
    assert dwells.std() == pytest.approx(np.sqrt(2.0), rel=0.05)
    for u in (0.5, 2.0, 5.0):
        assert np.mean(dwells > u) == pytest.approx((1.0 + u) * np.exp(-u), abs=0.02)
    # a quarter of a turn later it has forgotten, and then it is rather on the other side
    for lag, expected in ((79, 0.0), (118, np.exp(-0.75 * np.pi) * np.cos(0.75 * np.pi))):
        assert np.mean(z[lag:] * z[:-lag]) == pytest.approx(expected, abs=0.02)

    waning = NoiseLaw("waning", 1.0, components=(Component(1.0, 2e-3, shape="waning", depth=0.9),))
    records = np.array([draw_noise(waning, 20_000, h, rng) for _ in range(40)])
    assert np.mean(records**2) == pytest.approx(1.0, rel=0.02)
    up = np.mean(records[:, 10_000:] ** 2, axis=1) > np.mean(records[:, :10_000] ** 2, axis=1)
    assert 8 < up.sum() < 32  # either way
    course = np.mean(np.where(up[:, None], records, records[:, ::-1]) ** 2, axis=0)
    tenths = course.reshape(10, -1).mean(axis=1)
    assert tenths == pytest.approx(1.0 + 0.9 * (np.arange(10) - 4.5) / 5.0, abs=0.06)
    # Gaussian of a variance between 0.1 and 1.9, any as likely
    assert np.mean(records**4) == pytest.approx(3.0 * (1.0 + 0.81 / 3.0), rel=0.05)
    after = [float(np.mean(records[:, lag:] * records[:, :-lag])) for lag in (1, 4)]
    assert after == pytest.approx(np.exp([-0.5, -2.0]), abs=0.02)
    assert not (bar.is_ar1 or latch.is_ar1 or waning.is_ar1)


def test_rattling_coded_and_two_paced_noise_are_what_they_say() -> None:
    rng = np.random.default_rng(24)
    h = 1e-3
    rattle = NoiseLaw("rattling", 1.0, components=(Component(1.0, 0.1, shape="stops"),))
    z = draw_noise(rattle, 1_000_000, h, rng)
    # anywhere between its stops as likely, and never beyond
    assert np.abs(z).max() <= np.sqrt(3.0) and np.abs(z).max() > 1.73
    shares = np.histogram(z, np.linspace(-np.sqrt(3.0), np.sqrt(3.0), 11))[0] / len(z)
    assert shares == pytest.approx(0.1, abs=0.01)
    # in the middle it walks freely: steps of one variance, pi^2 D = 1/time for a distance of 1
    middle = np.abs(z[:-1]) < 1.0
    steps = np.diff(z)[middle]
    assert steps.var() == pytest.approx(12.0 * 2.0 * h / (np.pi**2 * 0.1), rel=0.02)
    assert np.mean(steps**4) / steps.var() ** 2 == pytest.approx(3.0, rel=0.03)
    R, near = autocorrelation(rattle, 501, h), autocorrelation(rattle, 3, 1e-5)
    assert R[0] == near[0] == pytest.approx(1.0, abs=1e-5)
    # near: half the mean squared step; far: the slowest mode alone
    assert 1.0 - near[2] == pytest.approx(2.0 * 12.0 * 1e-5 / (np.pi**2 * 0.1), rel=0.02)
    assert R[500] / R[400] == pytest.approx(np.exp(-1.0), rel=1e-6)

    bus = NoiseLaw("coded", 1.0, components=(Component(1.0, 0.02, shape="coded"),))
    z = draw_noise(bus, 500_000, h, rng)
    assert np.all(np.abs(z) == 1.0)
    # level for half a bit, or for a whole one where a half is followed by its like
    dwells = np.diff(np.flatnonzero(np.diff(z) != 0.0))
    assert set(dwells.tolist()) <= {9, 10, 11, 19, 20, 21}
    assert np.mean(dwells > 15) == pytest.approx(1.0 / 3.0, abs=0.02)
    # over whole bits nothing is left, wherever they begin but for one half at either end
    assert np.abs(np.cumsum(z)).max() <= 22.0
    # no line: of one half-bit pulse and its opposite, 4 sin^4(x)/(x^2) at x = pi f T/2
    f, power = welch(z, 1.0 / h, nperseg=10_000, detrend=False)
    x = 0.5 * np.pi * f[1:] * 0.02
    density = 2.0 * 0.02 * np.sin(x) ** 4 / x**2
    band = (f[1:] > 5.0) & (f[1:] < 90.0)
    smooth = np.convolve(power[1:][band] - density[band], np.ones(21) / 21.0, "valid")
    assert np.abs(smooth).max() < 0.15 * density.max()
    assert power.max() < 2.0 * density.max()
    firsts = np.array([draw_noise(bus, 3, h, rng)[0] for _ in range(400)])
    assert abs(firsts.mean()) < 0.25

    part = Component(1.0, 0.1, shape="paces", depth=0.1, gust_time=0.5)
    paced = NoiseLaw("two_paced", 1.0, components=(part,))
    z = draw_noise(paced, 1_000_000, h, rng)
    # one Gaussian all the time, of which the steps alone tell how quick it is
    assert np.mean(z**2) == pytest.approx(1.0, rel=0.05)
    assert np.mean(z**4) / z.var() ** 2 == pytest.approx(3.0, rel=0.1)
    steps = np.diff(z)
    slow, quick = 2.0 * -np.expm1(-h / 0.1), 2.0 * -np.expm1(-h / 0.01)
    assert np.mean(steps**2) == pytest.approx(0.5 * (slow + quick), rel=0.05)
    ratio = 1.0 + ((quick - slow) / (quick + slow)) ** 2
    assert np.mean(steps**4) / np.mean(steps**2) ** 2 == pytest.approx(3.0 * ratio, rel=0.07)
    loud = np.mean(steps[:999_900].reshape(-1, 50) ** 2, axis=1)
    pace = np.where(loud > np.sqrt(slow * quick), 1.0, -1.0)
    # paces are kept: the telegraph's own memory, a tenth of a second and one later
    for lag in (2, 10):
        kept = np.mean(pace[lag:] * pace[:-lag])
        assert kept == pytest.approx(np.exp(-lag * 0.05 / 0.5), abs=0.1)
    # limits: paces that last for ever, and paces that change at once
    lags = np.arange(200) * h
    for gust_time, expected in (
        (1e6, 0.5 * (np.exp(-lags / 0.1) + np.exp(-lags / 0.01))),
        (1e-8, np.exp(-0.5 * lags * (10.0 + 100.0))),
    ):
        law = NoiseLaw("two_paced", 1.0, components=(replace(part, gust_time=gust_time),))
        assert np.abs(autocorrelation(law, 200, h) - expected).max() < 1e-4
    assert not (rattle.is_ar1 or bus.is_ar1 or paced.is_ar1)


def test_decimated_hopping_and_drilling_noise_are_what_they_say() -> None:
    rng = np.random.default_rng(26)
    h = 1e-3
    steep = NoiseLaw("decimated", 1.0, components=(Component(1.0, 0.01, shape="cut_off"),))
    z = draw_noise(steep, 500_000, h, rng)
    assert z.var() == pytest.approx(1.0, rel=0.03)
    assert np.mean(z**4) / z.var() ** 2 == pytest.approx(3.0, rel=0.05)
    # white up to 50 Hz, nothing beyond
    f, power = welch(z, 1.0 / h, nperseg=5000, detrend=False)
    assert power[(f > 1.0) & (f < 48.0)].mean() == pytest.approx(1.0 / 50.0, rel=0.03)
    for low in (1.0, 16.0, 32.0):
        assert power[(f > low) & (f < low + 15.0)].mean() == pytest.approx(1.0 / 50.0, rel=0.08)
    assert power[f > 52.0].max() < 1e-3 / 50.0
    # a recorder that is slower sees white at 0.01 s, and turns of the other sign between
    slow = np.array([draw_noise(steep, 400, 0.025, rng) for _ in range(100)])
    for lag, expected in ((0, 1.0), (1, np.sin(2.5 * np.pi) / (2.5 * np.pi)), (2, 0.0)):
        own = slow[:, lag:] * slow[:, : 400 - lag]
        assert own.mean() == pytest.approx(expected, abs=0.03)
    short = np.array([draw_noise(steep, 5, h, rng)[[0, -1]] for _ in range(4000)])
    assert np.mean(short**2) == pytest.approx(1.0, abs=0.08)
    assert np.mean(short[:, 0] * short[:, 1]) == pytest.approx(np.sinc(0.4), abs=0.08)

    part = Component(1.0, 0.05, shape="settling", depth=0.7)
    hops = NoiseLaw("mode_hopping", 1.0, components=(part,))
    z = draw_noise(hops, 2_000_000, h, rng)
    edges = np.flatnonzero(np.diff(z) != 0.0)
    assert np.mean(z[edges[1:]] ** 2) == pytest.approx(1.0, rel=0.05)
    assert abs(np.mean(z[edges[1:]] * z[edges[:-1]])) < 0.05  # of levels one after the other
    # the longer it has stayed, the longer it stays
    dwells = np.diff(edges) * h
    for at in (0.02, 0.1, 0.5):
        assert np.mean(dwells > at) == pytest.approx((1.0 + at / 0.05) ** -1.7, abs=0.02)
    assert np.mean(dwells[dwells > 0.1] > 0.2) > 1.4 * np.mean(dwells > 0.1)
    # the first one is no exception: at any instant the wait is the longer one's
    firsts = np.array([draw_noise(hops, 200, h, rng)[[0, 50, 150]] for _ in range(3000)])
    for k, at in ((1, 0.05), (2, 0.15)):
        held = np.mean(firsts[:, 0] == firsts[:, k])
        assert held == pytest.approx((1.0 + at / 0.05) ** -0.7, abs=0.03)

    part = Component(1.0, 2e-3, shape="drilled", rate=0.25, depth=0.8)
    drill = NoiseLaw("drilling", 1.0, components=(part,))
    records = np.array([draw_noise(drill, 20_000, h, rng) for _ in range(40)])
    assert np.mean(records**2) == pytest.approx(1.0, rel=0.03)
    loudness = np.mean(records.reshape(40, 200, 100) ** 2, axis=2)
    loud = loudness > 1.0
    # 0.2 most of the time and 1 + 0.8 * 3 for a quarter of it, at one stretch
    assert np.mean(loud, axis=1) == pytest.approx(np.full(40, 0.25), abs=0.02)
    turns = np.sum(loud != np.roll(loud, 1, axis=1), axis=1)
    assert np.mean(turns == 2) > 0.8
    assert np.median(loudness[loud]) == pytest.approx(3.4, rel=0.1)
    assert np.median(loudness[~loud]) == pytest.approx(0.2, rel=0.1)
    assert np.ptp(np.mean(loud.reshape(40, 4, 50), axis=(0, 2))) < 0.3  # anywhere
    assert not (steep.is_ar1 or hops.is_ar1 or drill.is_ar1)


def test_hunting_chattering_and_replugged_noise_are_what_they_say() -> None:
    rng = np.random.default_rng(28)
    h = 1e-3
    part = Component(1.0, 50.0, 20.0, "hunting", depth=0.2, gust_time=2.0)
    fan = NoiseLaw("hunting_fan", 1.0, components=(part,))
    z = draw_noise(fan, 400_000, h, rng)
    assert np.abs(z).max() == pytest.approx(np.sqrt(2.0), abs=1e-3)  # a tone, all the time as loud
    assert z.var() == pytest.approx(1.0, rel=0.01)
    # how fast its phase turns, by pairs of ups through zero: between 16 and 24 Hz and back in 2 s
    ups = np.flatnonzero((z[1:] > 0.0) & (z[:-1] <= 0.0))
    exact = (ups - z[ups] / (z[ups + 1] - z[ups])) * h
    pitch = np.interp(
        np.arange(1.0, 399.0, 0.05), 0.5 * (exact[1:] + exact[:-1]), 1 / np.diff(exact)
    )
    lines = np.abs(np.fft.rfft(pitch - pitch.mean()))
    f = np.fft.rfftfreq(len(pitch), 0.05)
    assert f[lines.argmax()] == pytest.approx(0.5, abs=0.01)
    assert pitch.mean() == pytest.approx(20.0, abs=0.1)
    assert 2.0 * lines.max() / len(pitch) == pytest.approx(4.0, rel=0.05)
    # half a swing later the turns that it is ahead or behind decide: Bessel's function
    R = autocorrelation(fan, 2001, h)
    assert R[1000] == pytest.approx(np.exp(-0.02) * j0(2.0 * 0.2 * 20.0 * 2.0), abs=1e-9)
    assert R[2000] == pytest.approx(np.exp(-0.04), abs=1e-9)
    for lag in (5, 400, 1000, 2000):
        assert np.mean(z[lag:] * z[:-lag]) == pytest.approx(R[lag], abs=0.05)

    relay = NoiseLaw("chattering_relay", 1.0, components=(Component(1.0, 0.1, shape="chattering"),))
    z = draw_noise(relay, 1_000_000, h, rng)
    assert np.all(np.abs(z) == 1.0) and abs(z.mean()) < 0.06
    for lag in (1, 20, 100, 300):
        expected = 2.0 / np.pi * np.arcsin(np.exp(-lag * h / 0.1))
        assert np.mean(z[lag:] * z[:-lag]) == pytest.approx(expected, abs=0.05)
    # it chatters: most stays are over in a few samples, and a few last for most of the time
    stays = np.diff(np.flatnonzero(np.diff(z) != 0.0)) * h
    assert np.median(stays) < 0.2 * stays.mean()
    assert stays[stays > 0.1].sum() > 0.5 * stays.sum()
    # an excursion's length goes as t^-1/2 while it is short
    ratio = np.mean(stays > 0.008) / np.mean(stays > 0.032)
    assert ratio == pytest.approx(2.0, rel=0.2)

    part = Component(1.0, 2e-3, shape="replugged", depth=0.8)
    fibre = NoiseLaw("replugged_fibre", 1.0, components=(part,))
    records = np.array([draw_noise(fibre, 10_000, h, rng) for _ in range(300)])
    loud = np.mean(records**2, axis=1)
    assert loud.mean() == pytest.approx(1.0, abs=0.1)
    assert 0.15 < loud.min() < 0.3 and 1.65 < loud.max() < 2.1
    quarters = np.histogram(loud, bins=[0.0, 0.6, 1.0, 1.4, 3.0])[0]  # any as likely
    assert np.all(np.abs(quarters - 75) < 35)
    # a Gaussian within each, as loud at its end as at its beginning
    own = records / np.sqrt(loud)[:, None]
    assert np.mean(own**4) == pytest.approx(3.0, rel=0.03)
    halves = np.mean(records[:, :5000] ** 2, axis=1) / np.mean(records[:, 5000:] ** 2, axis=1)
    assert np.abs(np.log(halves)).max() < 0.5
    for lag in (1, 4):
        expected = np.exp(-lag * h / 2e-3)
        assert np.mean(own[:, lag:] * own[:, :-lag]) == pytest.approx(expected, abs=0.02)
    assert not (fan.is_ar1 or relay.is_ar1 or fibre.is_ar1)


def test_beating_held_and_crackling_noise_are_what_they_say() -> None:
    rng = np.random.default_rng(29)
    h = 1e-3
    part = Component(1.0, 200.0, 20.0, "beating", depth=0.05)
    fans = NoiseLaw("two_fans", 1.0, components=(part,))
    z = draw_noise(fans, 400_000, h, rng)
    assert np.abs(z).max() == pytest.approx(2.0, abs=0.01)
    assert z.var() == pytest.approx(1.0, abs=0.02)
    f, power = welch(z, 1.0 / h, nperseg=40_000)
    assert np.sort(f[np.argsort(power)[-2:]]) == pytest.approx([19.0, 21.0], abs=0.03)
    # the hum swells and fades twice a second: a twentieth of a second is a whole turn
    loud = (z**2).reshape(-1, 50).mean(axis=1)
    assert loud.min() < 0.05 and loud.max() > 1.9
    swell = np.abs(np.fft.rfft(loud - loud.mean()))
    assert np.fft.rfftfreq(len(loud), 0.05)[swell.argmax()] == pytest.approx(2.0, abs=0.02)

    meter = NoiseLaw("slow_meter", 1.0, components=(Component(1.0, 0.025, shape="held"),))
    z = draw_noise(meter, 400_000, h, rng)
    changes = np.flatnonzero(np.diff(z) != 0.0)
    assert np.all(np.diff(changes) == 25)
    levels = z[changes]
    assert levels.var() == pytest.approx(1.0, abs=0.05)
    assert np.mean(levels**4) == pytest.approx(3.0, abs=0.3)
    assert abs(np.mean(levels[1:] * levels[:-1])) < 0.04
    firsts = {int(np.flatnonzero(np.diff(draw_noise(meter, 100, h, rng)))[0]) for _ in range(60)}
    assert len(firsts) > 15  # the recorder begins anywhere

    part = Component(1.0, 0.01, shape="trains", rate=0.5, depth=50.0, gust_time=0.05)
    cable = NoiseLaw("crackling_cable", 1.0, components=(part,))
    z = draw_noise(cable, 1_000_000, h, rng)
    # 10 trains a second, 500 pulses, of 5 in the mean at a time; variance 5 and 5 50/12 besides
    mean, alone, together = 5.0, 5.0, 5.0 * 25.0 * 0.01 / 0.06
    assert z.min() == pytest.approx(-mean / np.sqrt(alone + together), abs=1e-3)
    assert abs(z.mean()) < 0.05 and z.var() == pytest.approx(1.0, abs=0.08)
    assert np.mean(z**3) > 0.5  # to one side
    R = autocorrelation(cable, 400, h)
    for lag in (5, 20, 60, 150):
        # the mean course of a train is a lag of 10 ms after one of 50 ms
        train = (0.05 * np.exp(-lag * h / 0.05) - 0.01 * np.exp(-lag * h / 0.01)) / 0.04
        stated = (alone * np.exp(-lag * h / 0.01) + together * train) / (alone + together)
        assert R[lag] == pytest.approx(stated, abs=1e-9)
        assert np.mean(z[lag:] * z[:-lag]) == pytest.approx(R[lag], abs=0.06)
    assert not (fans.is_ar1 or meter.is_ar1 or cable.is_ar1)


def test_sparkling_weighed_and_dimmed_noise_are_what_they_say() -> None:
    rng = np.random.default_rng(31)
    h = 1e-3
    part = Component(1.0, shape="sparkling", rate=0.01)
    codes = NoiseLaw("sparkling_codes", 1.0, components=(part,))
    z = draw_noise(codes, 400_000, h, rng)
    assert set(np.round(z, 9).tolist()) == {-10.0, 0.0, 10.0}
    assert np.mean(z != 0.0) == pytest.approx(0.01, rel=0.08)
    assert np.mean(z > 0.0) == pytest.approx(0.005, rel=0.12)
    both = (z[1:] != 0.0) & (z[:-1] != 0.0)
    assert both.mean() == pytest.approx(1e-4, rel=0.7)  # they come alone

    readings = NoiseLaw("weighed_readings", 1.0, components=(Component(1.0, shape="binomial"),))
    z = draw_noise(readings, 400_000, h, rng)
    R = [float(np.mean(z[lag:] * z[: len(z) - lag])) for lag in range(4)]
    assert pytest.approx([1.0, 2.0 / 3.0, 1.0 / 6.0, 0.0], abs=0.02) == R
    assert autocorrelation(readings, 4, h) == pytest.approx([1.0, 2.0 / 3.0, 1.0 / 6.0, 0.0])
    assert autocorrelation(readings, 2, h) == pytest.approx([1.0, 2.0 / 3.0])
    f, power = welch(z, 1.0 / h, nperseg=1000)
    # cos^4 of a quarter turn at the highest frequency: next to nothing is left there
    expected = 8.0 / 3.0 * np.cos(0.5 * np.pi * f / f[-1]) ** 4 / f[-1]
    assert np.abs(power - expected)[1:-1].max() < 0.25 * expected.max()
    assert power[-20:-1].mean() < 1e-3 * power[1:20].mean()

    part = Component(1.0, 0.05, shape="dimmed")
    lamps = NoiseLaw("dimmed_lamps", 1.0, components=(part,))
    z = draw_noise(lamps, 500_000, h, rng)
    assert set(z.tolist()) == {-1.0, 1.0}
    begins = np.flatnonzero((z[1:] > 0.0) & (z[:-1] < 0.0))
    assert np.mean(np.diff(begins) % 50 == 0) > 0.99  # by the clock, but for pulses unseen
    first = int(np.median(begins % 50)) + 1
    lit = (z[first : first + 50 * 9998].reshape(-1, 50) > 0.0).mean(axis=1)
    assert lit.mean() == pytest.approx(0.5, abs=0.02)
    assert lit.var() == pytest.approx(1.0 / 12.0, abs=0.005)  # any length as likely
    assert abs(np.corrcoef(lit[1:], lit[:-1])[0, 1]) < 0.05
    R = autocorrelation(lamps, 200, h)
    assert R[50] == pytest.approx(1.0 / 3.0) and R[150] == pytest.approx(R[50])
    assert R[75] == pytest.approx(-1.0 / 6.0)
    for lag in (5, 25, 40, 60, 75, 100):
        assert np.mean(z[lag:] * z[:-lag]) == pytest.approx(R[lag], abs=0.03)
    assert not (codes.is_ar1 or readings.is_ar1 or lamps.is_ar1)


def test_overcorrected_rectified_and_stretched_noise_are_what_they_say() -> None:
    rng = np.random.default_rng(37)
    h = 1e-3
    part = Component(1.0, shape="overcorrected", depth=0.7)
    zero = NoiseLaw("overcorrecting_zero", 1.0, components=(part,))
    z = draw_noise(zero, 400_000, h, rng)
    R = [float(np.mean(z[lag:] * z[: len(z) - lag])) for lag in range(5)]
    assert pytest.approx([1.0, -0.7, 0.49, -0.343, 0.2401], abs=0.02) == R
    assert autocorrelation(zero, 4, h) == pytest.approx([1.0, -0.7, 0.49, -0.343])
    assert autocorrelation(zero, 1, h) == pytest.approx([1.0])
    # with the share taken back given back nothing is left but what is new, from the first sample
    new = z[1:] + 0.7 * z[:-1]
    assert new.std() == pytest.approx(np.sqrt(1.0 - 0.49), rel=0.01)
    assert abs(np.mean(new[1:] * new[:-1])) < 0.01
    first = [draw_noise(zero, 2, h, rng)[0] for _ in range(4000)]
    assert np.std(first) == pytest.approx(1.0, abs=0.05)

    part = Component(1.0, 0.02, shape="rectified")
    pickup = NoiseLaw("rectified_pickup", 1.0, components=(part,))
    z = draw_noise(pickup, 1_000_000, h, rng)
    lowest = -1.0 / np.sqrt(0.5 * np.pi - 1.0)
    assert lowest - 1e-9 <= z.min() < lowest + 0.01
    # a half-normal distribution
    skewness = np.sqrt(2.0) * (4.0 - np.pi) / (np.pi - 2.0) ** 1.5
    assert np.mean(z) == pytest.approx(0.0, abs=0.03)
    assert np.mean(z**2) == pytest.approx(1.0, abs=0.05)
    assert np.mean(z**3) == pytest.approx(skewness, abs=0.15)
    assert np.mean(z < lowest * (1.0 - 0.6745 / np.sqrt(2.0 / np.pi))) == pytest.approx(
        0.5, abs=0.02
    )
    R = autocorrelation(pickup, 100, h)
    assert R[0] == pytest.approx(1.0) and (np.diff(R) < 0.0).all()
    for lag in (1, 5, 14, 40):
        r = np.exp(-lag * h / 0.02)
        # of two moduli: polar coordinates of the half plane in which both have one sign, and not
        angle = np.linspace(0.0, 0.5 * np.pi, 20_001)
        mean = sum(
            np.trapezoid(
                np.sin(2.0 * angle) / (1.0 - sign * r * np.sin(2.0 * angle)) ** 2, angle
            ) for sign in (1.0, -1.0)
        ) * (1.0 - r**2) ** 1.5 / np.pi  # fmt: skip
        assert R[lag] == pytest.approx((mean - 2.0 / np.pi) / (1.0 - 2.0 / np.pi), abs=1e-4)
        assert np.mean(z[lag:] * z[:-lag]) == pytest.approx(R[lag], abs=0.04)

    part = Component(1.0, 0.02, shape="stretched", depth=0.4)
    insulation = NoiseLaw("glassy_dielectric", 1.0, components=(part,))
    z = draw_noise(insulation, 2_000_000, h, rng)
    R = autocorrelation(insulation, 1001, h)
    assert R[20] == pytest.approx(np.exp(-1.0))
    # ten times as late, 10^0.4 times as much of the logarithm is gone
    assert np.log(R[1000]) / np.log(R[100]) == pytest.approx(10.0**0.4)
    for lag in (1, 5, 20, 100, 400):
        assert np.mean(z[lag:] * z[:-lag]) == pytest.approx(R[lag], abs=0.04)
    assert np.mean(z**4) / np.mean(z**2) ** 2 == pytest.approx(3.0, abs=0.15)
    assert not (zero.is_ar1 or pickup.is_ar1 or insulation.is_ar1)


@pytest.mark.parametrize("name", [*OPEN_LAWS, *RESERVE_LAWS])
def test_the_laws_called_heavy_tailed_are_those_whose_innovations_are(name: str) -> None:
    for seed in range(3):
        for interval in (1e-3, 1e-2):
            rng = np.random.default_rng(seed)
            law = draw_law(name, rng, 1.0)
            R = autocorrelation(law, 61, interval)
            predictor = solve_toeplitz(R[:-1], R[1:])
            z = draw_noise(law, 60_000, interval, rng)
            e = lfilter(np.concatenate([[1.0], -predictor]), [1.0], z)[60:]
            excess = np.mean(e**4) / np.mean(e**2) ** 2 - 3.0
            # two standard errors of 1500 independent samples; 60 000 leave one of 0.02
            assert (excess > 2.0 * np.sqrt(24.0 / 1500)) == (name in HEAVY_TAILED)


def test_wild_samples_keep_the_variance_and_fatten_the_tails() -> None:
    rig = case(wild_samples=4.0)
    rng = np.random.default_rng(2)
    plain = draw_noise(rig.noise, 200_000, 0.01, rng)
    wild = draw_noise(rig.noise, 200_000, 0.01, rng, (0.01, 5.0))
    assert wild.std() == pytest.approx(plain.std(), rel=0.05)
    assert np.mean(np.abs(wild) > 5.0) > 1e-3
    assert np.mean(np.abs(plain) > 5.0) < 1e-4


def test_noise_grows_with_concentration() -> None:
    rig = replace(draw_case(3, size="small"), tau_v=0.1, lsb=0.0)
    rig = replace(rig, noise=replace(rig.noise, sigma0=0.01, sigma1=0.03))
    campaign, ideal = make_campaign(rig), clean_signals(rig)
    for step in rig.steps:
        edges = phase_edges(rig, step)
        t = sample_times(step)
        residual = campaign[step.name].values - ideal[step.name]
        expected = {"baseline": 0.01, "plateau": 0.0}
        grown = 0.03**2 * rig.relative_concentration(step)
        expected["plateau"] = np.sqrt(0.01**2 + grown)
        for phase, sd in expected.items():
            part = residual[(t > edges[phase][0] + 1) & (t < edges[phase][1])]
            # several hundred samples, correlated over a few at most
            assert part.std() == pytest.approx(sd, rel=0.2)


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


def test_switches_follow_commands_even_on_a_bad_clock() -> None:
    for name in (
        "running_off_clock",
        "lost_samples",
        "hurried_timer",
        "repeated_buffer",
        "overtaking_packets",
        "running_down_meter",
    ):
        rig = draw_case(21, {name: CAUSES[name].highest}, size="small")
        seen = reality.as_recorded(rig)
        for e, step in zip(make_campaign(rig), seen.steps, strict=True):
            assert e.commanded_on is not None and e.commanded_off is not None
            assert e.commanded_on < step.t0 < e.commanded_off < step.tf < step.duration


@pytest.mark.parametrize(
    ("name", "phases", "least"),
    [
        ("flow_follows_valve", {"rise", "fall"}, 0.95),
        ("closing_spring", {"fall"}, 0.9),
        ("emptying_bottle", {"plateau", "fall"}, 0.95),
        ("plunger_stroke", {"rise", "fall"}, 0.95),
        ("residue", {"baseline", "onset", "rise", "plateau"}, 0.9),
        ("mains_dip", {"plateau"}, 0.95),
        ("dead_leg", {"fall", "tail"}, 0.999),
        ("trapped_plug", {"onset", "rise"}, 0.95),
        ("sites_that_keep", {"plateau", "fall", "tail"}, 0.95),
        ("sluggish_lock", {"rise", "fall"}, 0.999),
        ("held_readings", {"rise", "fall"}, 0.95),
        ("shared_nitrogen", {"plateau", "fall"}, 0.9),
        ("creeping_regulator", {"fall", "tail"}, 0.999),
        ("returning_exhaust", {"plateau", "fall", "tail"}, 0.95),
        ("flipping_cages", {"rise", "plateau", "fall"}, 0.99),
        ("swinging_column", {"rise", "plateau", "fall"}, 0.99),
        ("warm_driver", {"plateau", "fall", "tail"}, 0.95),
        ("hurried_timer", {"rise", "fall"}, 0.95),
        ("snapping_regulator", {"rise", "plateau", "fall"}, 0.999),
        ("pinched_hose", {"rise", "fall"}, 0.99),
        ("sticky_hose", {"rise", "fall"}, 0.99),
        ("permeable_hose", {"rise", "plateau", "fall", "tail"}, 0.999),
        ("peeling_coating", {"plateau", "fall"}, 0.99),
        ("diode_detector", {"fall", "tail"}, 0.999),
        ("repeated_buffer", {"rise", "fall"}, 0.99),
        ("weak_holding_current", {"rise", "plateau", "fall"}, 0.999),
        ("cooling_bubbler", {"rise", "plateau", "fall"}, 0.999),
        ("pairing_gas", {"rise", "fall"}, 0.9),
        ("displaced_water", {"rise", "plateau", "fall"}, 0.999),
        ("self_heating_ring", {"rise", "plateau", "fall"}, 0.95),
        ("hunting_lock", {"rise", "fall"}, 0.9),
        ("grain_in_seat", {"fall", "tail"}, 0.999),
        ("stale_test_gas", {"rise", "plateau"}, 0.99),
        ("jet_across", {"rise", "fall"}, 0.95),
        ("heat_of_sorption", {"rise", "plateau", "fall", "tail"}, 0.999),
        ("jolted_fibre", {"rise", "plateau", "fall"}, 0.9),
        ("overtaking_packets", {"rise", "fall"}, 0.95),
        ("throttling_hose", {"rise", "fall"}, 0.9),
        ("sticking_needle", {"rise", "plateau", "fall"}, 0.99),
        ("cold_spot", {"plateau", "fall"}, 0.95),
        ("swirling_gas", {"rise", "fall"}, 0.99),
        ("splitting_molecules", {"rise", "plateau", "fall", "tail"}, 0.999),
        ("second_mode", {"rise", "plateau", "fall"}, 0.95),
        ("hot_output_stage", {"rise", "plateau", "fall", "tail"}, 0.999),
        ("sparse_logger", {"rise", "fall"}, 0.8),
        ("stiff_grease", {"rise", "fall"}, 0.95),
        ("washing_bottle", {"rise", "plateau"}, 0.95),
        ("heavy_gas_in_pit", {"rise", "fall"}, 0.9),
        ("converting_film", {"rise", "plateau", "fall", "tail"}, 0.999),
        ("sun_on_the_cell", {"rise", "plateau", "fall"}, 0.99),
        ("leaking_reference", {"plateau", "fall", "tail"}, 0.99),
        ("rms_receiver", {"rise", "fall"}, 0.95),
        ("unequal_valves", {"onset", "rise", "plateau", "fall"}, 0.99),
        ("spitting_bottle", {"rise", "plateau", "fall"}, 0.999),
        ("streaky_inlet", {"rise", "plateau", "fall"}, 0.999),
        ("glassy_rim", {"rise", "plateau", "fall", "tail"}, 0.999),
        ("pulsing_ring", {"rise", "plateau", "fall"}, 0.99),
        ("log_receiver", {"rise", "fall", "tail"}, 0.95),
        ("running_down_meter", {"rise", "fall"}, 0.95),
        ("wound_up_controller", {"rise", "plateau"}, 0.999),
        ("alternating_dryers", {"baseline", "plateau", "tail"}, 0.5),
        ("gurgling_hose", {"rise", "fall"}, 0.99),
        ("spreading_islands", {"rise", "plateau", "fall", "tail"}, 0.999),
        ("undecided_laser", {"rise", "plateau", "fall"}, 0.99),
        ("averaging_meter", {"rise", "fall"}, 0.95),
        ("sipping_chromatograph", {"rise", "plateau", "fall"}, 0.999),
        ("laminar_hose", {"rise", "fall"}, 0.99),
        ("late_impurity", {"plateau", "fall"}, 0.95),
        ("creeping_piezo", {"rise", "plateau", "fall", "tail"}, 0.999),
        ("overloaded_amplifier", {"rise", "plateau", "fall"}, 0.999),
        ("thrifty_historian", {"baseline", "onset", "plateau", "tail"}, 0.6),
        ("soft_start", {"rise", "plateau"}, 0.999),
        ("hasty_purge", {"fall"}, 0.99),
        ("capillary_condensation", {"rise", "plateau", "fall"}, 0.99),
        ("dead_pixels", {"rise", "plateau", "fall"}, 0.999),
        ("automatic_gain", {"rise", "plateau", "fall", "tail"}, 0.999),
        ("clogging_filter", {"rise", "fall"}, 0.99),
        ("bobbing_float", {"rise", "plateau"}, 0.99),
        ("bubbling_exhaust", {"rise", "plateau", "fall"}, 0.99),
        ("poisoned_coating", {"rise", "plateau", "fall"}, 0.99),
        ("smoothing_parabola", {"baseline", "onset", "rise", "plateau", "fall"}, 0.99),
        ("late_main_stage", {"rise", "plateau"}, 0.99),
        ("trial_click", {"baseline", "onset"}, 0.99),
        ("dammed_test_gas", {"rise", "plateau"}, 0.99),
        ("condensate_trap", {"rise", "fall"}, 0.99),
        ("dry_test_gas", {"rise", "plateau", "fall", "tail"}, 0.999),
        ("fixed_window", {"rise", "fall"}, 0.99),
        ("averaged_repeats", {"baseline", "onset", "rise", "plateau", "fall"}, 0.99),
        ("snapping_diaphragm", {"rise", "fall"}, 0.99),
        ("yielding_carrier", {"rise", "plateau", "fall"}, 0.999),
        ("analyser_loop", {"rise", "fall"}, 0.99),
        ("igniting_coating", {"plateau", "fall"}, 0.98),
        ("bent_beam", {"rise", "fall"}, 0.999),
        ("blanked_ranging", {"rise", "fall"}, 0.99),
        ("hurried_display", {"rise", "fall"}, 0.99),
    ],
)
def test_places_where_causes_act(name: str, phases: set[str], least: float) -> None:
    shares = acting_places(case(**{name: 0.5 * CAUSES[name].highest}))
    assert sum(shares.values()) == pytest.approx(1.0)
    assert sum(v for (_, phase), v in shares.items() if phase in phases) > least


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


def test_seven_minutes_of_experiments_at_a_millisecond_take_less_than_two_seconds() -> None:
    rig = draw_case(2, {"flow_follows_valve": 1.0, "slow_sites": 0.1, "layered_coating": 1.0})
    make_campaign(case(flow_follows_valve=1.0, slow_sites=0.1, layered_coating=1.0))  # compile
    begin = time.process_time()
    campaign = make_campaign(rig)
    assert time.process_time() - begin < 2.0
    assert campaign.n_samples == 840_000
