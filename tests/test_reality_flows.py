"""Causes of the flows against an ODE solver and their own promises."""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise
from typing import Any

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.optimize import brentq
from scipy.special import erf

from bayes_sensor.campaign import FloatArray
from bayes_sensor.reality import Case, Step, clean_signals, draw_case, sample_times, without_causes
from bayes_sensor.reality.knobs import Knobs
from bayes_sensor.reality.rig import dip, voltage
from bayes_sensor.reality.simulator import prepared_rig
from bayes_sensor.reality.stages.manifold import pit
from tests.reality_cases import case, solved


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


def test_a_cold_lamp_goes_past_its_best_against_an_ode_solver() -> None:
    strength, bests = 0.4, []
    for seed in (11, 12, 13):
        rig = replace(draw_case(seed, size="small"), strengths={"ozone_lamp": strength})
        seen, found = clean_signals(rig), prepared_rig(rig)
        for k, step in enumerate(rig.steps):
            (output,) = found[step.name].unmixed
            since = np.linspace(0.0, 400.0, 400_001)
            made = output(step.commanded_on + since)
            assert made.max() == pytest.approx(np.exp(strength), rel=1e-6)
            assert made[-1] == pytest.approx(1.0, abs=1e-6)
            # what it makes when it is still cold tells where its best is, and when that comes how
            # soon it warms
            ratio = np.sqrt(1.0 - np.log(made[0]) / strength)
            best = ratio / (1.0 + ratio)
            time = -since[made.argmax()] / np.log1p(-best)

            def glowing(
                u: tuple[float, float], x: FloatArray, best: float = best, time: float = time,
                exchange: float = step.total_flow / rig.V, rig: Case = rig,
            ) -> list[float]:  # fmt: skip
                # Gauss's bell in temperature, of width 1 - best over the root of twice the strength
                width = (1.0 - best) / np.sqrt(2.0 * strength)
                ozone = np.exp(strength - 0.5 * ((x[3] - best) / width) ** 2)
                cascade = [(u[0] - x[0]) / rig.tau_v, exchange * (x[0] * ozone - x[1])]
                return [*cascade, (x[1] - x[2]) / rig.tau, (u[1] - x[3]) / time]

            on = [(0.0, (0.0, 0.0)), (step.commanded_on, (0.0, 1.0))]
            _, states = solved(
                rig, glowing, 4, k=k, inputs=[*on, (step.t0, (1.0, 1.0)), (step.tf, (0.0, 1.0))]
            )
            x = (seen[step.name] - step.y0) / step.beta
            assert np.abs(x - states[:, 2]).max() < 1e-3
            assert x.max() > 1.02
        bests.append(best)
    assert 0.35 < min(bests) < max(bests) < 0.7


def test_a_foreign_gas_factor_is_off_only_while_there_is_test_gas_against_an_ode_solver() -> None:
    strength, factors = 0.6, set()
    for seed in (11, 12, 13, 14):
        rig = replace(draw_case(seed, size="small"), strengths={"foreign_gas_factor": strength})
        seen, ends = clean_signals(rig), []
        for step in rig.steps:
            level = seen[step.name][np.searchsorted(sample_times(step), step.tf) - 1]
            ends.append((level - step.y0) / step.beta)
        up = ends[0] > 1.0
        factor = np.exp(strength if up else -strength)
        factors.add(up)
        for k, (step, end) in enumerate(zip(rig.steps, ends, strict=True)):
            c = step.concentration
            # one factor throughout, of which the other gas is thinned
            assert end == pytest.approx(factor / (1.0 + (factor - 1.0) * c), rel=2e-3)

            def off(
                u: float, x: FloatArray, carrier: float = step.carrier_flow,
                test: float = step.test_gas_flow, c: float = c, factor: float = factor,
                rig: Case = rig,
            ) -> list[float]:  # fmt: skip
                gas = factor * test * x[0]
                flow = carrier + gas + test * (1.0 - x[0])  # as much carrier as was to be test gas
                inlet = gas / flow / c
                return [(u - x[0]) / rig.tau_v, flow / rig.V * (inlet - x[1]),
                        (x[1] - x[2]) / rig.tau]  # fmt: skip

            _, states = solved(rig, off, 3, k=k)
            assert np.abs((seen[step.name] - step.y0) / step.beta - states[:, 2]).max() < 1e-3
    assert factors == {False, True}


def test_an_unstable_controller_swings_up_to_the_root_of_what_is_beyond_its_onset() -> None:
    strength, onsets, decayed = 0.2, [], 0
    for seed in range(11, 21):
        rig = draw_case(seed, {"unstable_controller": strength}, size="paper")
        largest = max(step.test_gas_flow for step in rig.steps)
        found, rates, growths, beyond, flows = prepared_rig(rig), [], [], [], []
        for step in rig.steps:
            (course,) = found[step.name].test_gas
            assert np.all(course(np.linspace(0.0, step.t0, 100)) == 1.0)
            fine = step.t0 + np.linspace(0.0, 6.0, 600_001)
            swing = (course(fine) - 1.0) / strength
            zeros = fine[1:-1][(swing[1:-1] * swing[2:] <= 0.0)] - step.t0
            half = np.median(np.diff(zeros[zeros > 0.01]))
            rates.append(0.5 / half)
            # its size wherever the sine is at its crest
            since = half * (np.arange(int(step.duration / half)) + 0.5)
            size = np.abs(course(step.t0 + since) - 1.0) / strength
            live = (size > 1e-3) & (np.arange(len(size)) < 40)
            # r' = growth r (beyond - r^2): 1/r^2 follows a lag, from crest to crest
            a = 1.0 / size[live] ** 2
            if len(a) < 5 or np.ptp(a[:-1]) < 1e-3 * a[0]:  # it was there at once, or never
                continue
            flows.append(step.test_gas_flow / largest)
            slope, start = np.polyfit(a[:-1], a[1:], 1)
            assert np.abs(a[1:] - slope * a[:-1] - start).max() < 3e-2 * a.max()
            rate = -np.log(slope) / (2.0 * half)
            beyond.append((1.0 - slope) / start)
            if 1e-2 < slope < 0.98 or slope > 1.02:
                growths.append(rate / beyond[-1])
            if beyond[-1] < -0.05:
                decayed += 1
                assert size[-1] < size[0]
            elif 2.0 * rate * since[-1] > 20.0:
                assert size[-1] == pytest.approx(np.sqrt(beyond[-1]), rel=1e-2)
        assert np.ptp(rates) < 2e-3 * np.mean(rates) and 0.15 < np.mean(rates) < 0.8
        assert np.ptp(growths) < 0.1 * np.mean(growths) and 0.3 < np.mean(growths) < 2.0
        slope, start = np.polyfit(flows, beyond, 1)
        assert slope + start == pytest.approx(1.0, abs=0.02)  # at the largest flow
        onsets.append(-start / slope)
    assert 0.28 < min(onsets) < 0.45 < 0.6 < max(onsets) < 0.77
    assert decayed > 5


@pytest.mark.parametrize("name", ["unstable_controller", "rubber_balloon"])
def test_a_changing_flow_of_test_gas_reaches_the_ring_against_an_ode_solver(name: str) -> None:
    rig = case(**{name: 0.3})
    found, seen = prepared_rig(rig), clean_signals(rig)
    for k, step in enumerate(rig.steps):
        (course,) = found[step.name].test_gas

        def changing(
            u: float, x: FloatArray, step: Step = step, course: Any = course
        ) -> list[float]:
            most = step.test_gas_flow * float(course(np.array([x[3]]))[0])
            flow = step.carrier_flow + most * x[0] + step.test_gas_flow * (1.0 - x[0])
            inlet = x[0] * most / (step.carrier_flow + most) / step.concentration
            gas = [flow / rig.V * (inlet - x[1]), (x[1] - x[2]) / rig.tau]
            return [(u - x[0]) / rig.tau_v, *gas, 1.0]  # x[3] is the time itself

        _, states = solved(rig, changing, 4, k=k)
        assert np.abs((seen[step.name] - step.y0) / step.beta - states[:, 2]).max() < 1e-4


def test_a_balloon_presses_the_more_the_smaller_it_is_until_it_collapses() -> None:
    strength, starts, turned = 0.65, [], 0

    def pressure(volume: float, slack: float) -> float:
        stretch = np.cbrt(volume / slack)
        return float(1.0 / stretch - 1.0 / stretch**7)

    def emptied(volume: float, slack: float, step: Step) -> Any:
        def shrinking(_: float, left: FloatArray) -> list[float]:
            return [-step.test_gas_flow * pressure(left[0], slack) / pressure(volume, slack)]

        return solve_ivp(
            shrinking, (step.t0, step.tf), [volume], dense_output=True, rtol=1e-9, atol=1e-9
        )

    for seed in (11, 13, 14, 19, 21, 22):
        rig = draw_case(seed, {"rubber_balloon": strength}, size="paper")
        courses = [prepared_rig(rig)[step.name].test_gas[0] for step in rig.steps]
        drawn = sum(step.test_gas_flow * (step.tf - step.t0) for step in rig.steps)
        full = drawn / strength  # mL

        def missed(
            start: float, full: float = full, step: Step = rig.steps[0], course: Any = courses[0]
        ) -> float:
            slack = full / start**3
            left = emptied(full, slack, step).y[0, -1]
            return pressure(left, slack) / pressure(full, slack) - float(course(step.tf))

        # the stretch that the first experiment tells of must do for all of them
        start = brentq(missed, 1.5, 2.8)
        starts.append(start)
        volume, slack, rest, presses = full, full / start**3, full, []
        for step, course in zip(rig.steps, courses, strict=True):
            solution = emptied(volume, slack, step)
            t = np.linspace(step.t0, step.tf, 200)
            volumes = solution.sol(t)[0]
            expected = [pressure(v, slack) / pressure(volume, slack) for v in volumes]
            assert course(t) == pytest.approx(np.array(expected), rel=1e-3)
            assert np.all(course(np.array([0.0, step.t0])) == 1.0)
            assert course(np.array([step.duration]))[0] == course(np.array([step.tf]))[0]
            # what has flowed is missing in the balloon
            rest -= step.test_gas_flow * np.trapezoid(course(t), t)
            volume = solution.y[0, -1]
            assert rest == pytest.approx(volume, rel=2e-3)
            presses += [pressure(v, slack) for v in volumes]
        most = int(np.argmax(presses))
        if np.cbrt(volume / slack) < 1.3:
            turned += 1
            assert presses[most] == pytest.approx(7.0 ** (-1 / 6) - 7.0 ** (-7 / 6), rel=1e-4)
            assert np.all(np.diff(presses[:most]) > -1e-9) and presses[-1] < presses[most]
        elif np.cbrt(volume / slack) > 1.39:
            assert most == len(presses) - 1
    assert 1.59 < min(starts) < 1.9 < 2.2 < max(starts) < 2.61 and turned >= 2


def test_a_wick_falls_dry_where_its_liquid_climbs_too_slowly_against_its_inventory() -> None:
    dried, spared, places = 0, 0, []
    for seed, strength in ((11, 0.5), (12, 0.3), (15, 0.5), (18, 0.3), (22, 0.5)):
        rig = replace(draw_case(seed, size="small"), strengths={"drying_wick": strength})
        found, seen = prepared_rig(rig), clean_signals(rig)
        largest = max(rig.steps, key=lambda step: step.test_gas_flow)
        brought = (1.0 - strength) * largest.test_gas_flow
        # what the strongest flow's experiment tells of the wick must do for all of them
        (course,) = found[largest.name].unmixed
        t = np.arange(largest.t0, largest.tf, 1e-4)
        wet = course(t)
        dries = t[np.argmax(wet < 1.0)] - largest.t0
        falling = (t > largest.t0 + dries + 0.01) & (wet > 1.0 - 0.9 * strength)
        slope = np.polyfit(t[falling], np.log(wet[falling] - (1.0 - strength)), 1)[0]
        patch = -largest.test_gas_flow / slope
        full = patch + (largest.test_gas_flow - brought) * dries
        places.append((dries / (largest.tf - largest.t0), patch / largest.test_gas_flow))
        # liquid that climbs and is carried off, from the campaign's beginning to its end
        held, h = full, 2e-3
        for k, step in enumerate(rig.steps):
            (course,) = found[step.name].unmixed
            at = np.arange(0.0, step.duration, h)
            open_ = (at + 0.5 * h > step.t0) & (at + 0.5 * h < step.tf)
            share = np.empty(len(at))
            for i in range(len(at)):
                share[i] = min(held / patch, 1.0)
                held += h * (brought - step.test_gas_flow * share[i] * open_[i])
                held = min(held, full)
            assert np.abs(course(at) - share)[at >= step.t0].max() < 4e-3
            spared += int(step.test_gas_flow < brought and share.min() == 1.0)
            dried += int(step is not largest and share[at >= step.t0].min() < 0.99)

            def thinner(
                u: float, x: FloatArray, step: Step = step, course: Any = course, rig: Case = rig
            ) -> list[float]:
                inlet = x[0] * float(course(np.array([x[3]]))[0])
                gas = [step.total_flow / rig.V * (inlet - x[1]), (x[1] - x[2]) / rig.tau]
                return [(u - x[0]) / rig.tau_v, *gas, 1.0]  # x[3] is the time itself

            if seed < 13:
                _, states = solved(rig, thinner, 4, k=k)
                assert np.abs((seen[step.name] - step.y0) / step.beta - states[:, 2]).max() < 2e-4
    low, high = np.min(places, axis=0), np.max(places, axis=0)
    assert np.all(low > [0.13, 0.49]) and np.all(high < [0.6, 4.05])
    assert spared > 0 and dried > 0


def test_a_nuts_play_takes_the_same_volume_at_every_turn_of_twin_syringes() -> None:
    strength, strokes, gaps = 0.4, [], 0
    for seed in (11, 12, 13, 14, 15):
        rig = replace(draw_case(seed, size="small"), strengths={"twin_syringes": strength})
        found, seen = prepared_rig(rig), clean_signals(rig)
        largest = max(step.test_gas_flow for step in rig.steps)
        typical = float(np.median([step.test_gas_flow for step in rig.steps]))
        ways, comes = [], []
        gone = 0.0
        for step in rig.steps:
            (course,) = found[step.name].test_gas
            t = np.arange(step.t0, step.tf, 1e-3)
            ways.append(gone + step.test_gas_flow * (t - step.t0))
            comes.append(course(t))
            gone += step.test_gas_flow * (step.tf - step.t0)
            # the pump stands while the valve is shut
            late = course(np.array([step.tf, step.duration]))
            assert late[0] == late[1]
        way, on = np.concatenate(ways), np.concatenate(comes)
        assert set(np.unique(on)) == {0.0, 1.0}
        change = np.flatnonzero(np.diff(on))
        stops, goes = (change[np.diff(on)[change] == sign] for sign in (-1.0, 1.0))
        goes = goes[goes > stops[0]]
        # on the screw's way, over records and rests, all turns are alike
        stroke = np.diff(way[stops])
        assert np.ptp(stroke) < 3e-3 * largest
        lost = way[goes] - way[stops[: len(goes)]]
        assert lost == pytest.approx(strength * largest, abs=2e-3 * largest)
        gaps += len(lost)
        strokes.append(stroke[0] / typical)

        step = max(rig.steps, key=lambda step: step.test_gas_flow)
        (course,) = found[step.name].test_gas

        def pumped(
            u: float, x: FloatArray, step: Step = step, course: Any = course, rig: Case = rig
        ) -> list[float]:
            full = step.test_gas_flow * float(course(np.array([x[3]]))[0])
            share = full / (step.carrier_flow + full) / step.concentration
            # with no test gas the carrier alone flushes
            flow = step.carrier_flow + full * x[0] + step.test_gas_flow * (1.0 - x[0])
            gas = [flow / rig.V * (share * x[0] - x[1]), (x[1] - x[2]) / rig.tau]
            return [(u - x[0]) / rig.tau_v, *gas, 1.0]  # x[3] is the time itself

        if seed < 13:
            k = rig.steps.index(step)
            _, states = solved(rig, pumped, 4, k=k)
            assert np.abs((seen[step.name] - step.y0) / step.beta - states[:, 2]).max() < 5e-4
    assert 3.99 < min(strokes) < 8.0 < max(strokes) < 16.01 and gaps > 10


def test_a_squeezed_bag_brings_what_it_should_in_each_squeeze_against_an_ode_solver() -> None:
    strength, lengths = 0.6, []
    for seed in (11, 12, 13, 14, 15):
        rig = replace(draw_case(seed, size="small"), strengths={"squeezed_bag": strength})
        found, seen = prepared_rig(rig), clean_signals(rig)
        own = []
        for k, step in enumerate(rig.steps):
            (course,) = found[step.name].test_gas
            t = np.arange(step.t0 - 1.0, step.duration, 1e-4)
            flow = course(t)
            assert np.all(flow[t < step.t0 - 1e-9] == 1.0)
            leaps = 0.5 * (t[1:] + t[:-1])[np.diff(flow) > strength]
            assert len(leaps) >= 2
            # from one leap to the next: evenly down by as much as it began too high
            for low, high in pairwise([step.t0, *leaps.tolist()]):
                inside = (t > low + 2e-4) & (t < high - 2e-4)
                share = (t[inside] - low) / (high - low)
                assert flow[inside] == pytest.approx(
                    1.0 + strength * (1.0 - 2.0 * share), abs=2.0 * strength * 3e-4 / (high - low)
                )
                dose = np.trapezoid(flow[inside], t[inside]) / np.ptp(t[inside])
                assert dose == pytest.approx(1.0, abs=1e-3)
            own += np.diff([step.t0, *leaps]).tolist()
            if k > 0 or seed > 12:
                continue

            def pressed(
                u: tuple[float, float, float], x: FloatArray, step: Step = step, rig: Case = rig
            ) -> list[float]:
                full = step.test_gas_flow
                if u[2] > u[1]:
                    full *= 1.0 + strength * (1.0 - 2.0 * (x[3] - u[1]) / (u[2] - u[1]))
                share = full / (step.carrier_flow + full) / step.concentration
                flow = step.carrier_flow + full * x[0] + step.test_gas_flow * (1.0 - x[0])
                gas = [flow / rig.V * (share * x[0] - x[1]), (x[1] - x[2]) / rig.tau]
                return [(u[0] - x[0]) / rig.tau_v, *gas, 1.0]  # x[3] is the time itself

            pieces: list[tuple[float, Any]] = [(0.0, (0.0, 0.0, 0.0))]
            edges = [step.t0, *leaps.tolist()]
            for low, high in pairwise(edges):
                pieces.append((low, (float(low < step.tf), low, high)))
                if low < step.tf < high:
                    pieces.append((step.tf, (0.0, low, high)))
            _, states = solved(rig, pressed, 4, k=k, inputs=pieces)
            s = sample_times(step)
            compared = s < edges[-1]
            off = (seen[step.name] - step.y0) / step.beta - states[:, 2]
            # every leap is known to half of 0.1 ms only
            assert edges[-1] > step.tf + 1.0 and np.abs(off[compared]).max() < 2e-4
        # of one hand, no two squeezes of which are alike
        assert max(own) < 3.05 * min(own) and np.std(own) > 0.1 * np.mean(own)
        lengths.append(np.mean(own))
    assert 1.0 < min(lengths) < 3.0 < max(lengths) < 7.0
