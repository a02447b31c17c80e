"""Causes of the valve against an ODE solver and their own promises."""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise
from typing import Any

import numpy as np
import pytest
from scipy.signal import lfilter

from bayes_sensor.campaign import FloatArray
from bayes_sensor.reality import Case, clean_signals, draw_case, sample_times, without_causes
from bayes_sensor.reality.knobs import Knobs
from bayes_sensor.reality.rig import voltage
from bayes_sensor.reality.simulator import prepared_rig
from tests.reality_cases import case, solved


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


def test_what_a_turning_valve_dams_up_comes_at_once_against_an_ode_solver() -> None:
    strength, times = 1.2, []
    for seed in (11, 12, 13):
        rig = replace(draw_case(seed, size="small"), strengths={"shut_between_ports": strength})
        seen, found = clean_signals(rig), prepared_rig(rig)
        for k, step in enumerate(rig.steps):
            (flow,) = found[step.name].all_flow
            # as much more as the set flow brings in that time, after either switch
            since = np.linspace(0.0, 20.0, 200_001)
            for switch, lasts in ((step.t0, step.tf - step.t0 - 1e-6), (step.tf, 20.0)):
                t = switch + since[since < lasts]
                more = flow(t) - 1.0
                assert np.trapezoid(more, t) == pytest.approx(strength, rel=1e-3)
                time = strength / more[0]
                assert np.interp(time, since[: len(t)], more) == pytest.approx(
                    more[0] * np.exp(-1.0), rel=1e-4
                )
            times.append(time)
            assert np.all(flow(np.linspace(0.0, step.t0 - 1e-6, 100)) == 1.0)

            def pressing(
                u: tuple[float, float], x: FloatArray, exchange: float = step.total_flow / rig.V,
                time: float = time, rig: Case = rig,
            ) -> list[float]:  # fmt: skip
                more = strength / time * np.exp(-(x[3] - u[1]) / time)  # x[3] is the time itself
                cascade = [(u[0] - x[0]) / rig.tau_v, exchange * (1.0 + more) * (x[0] - x[1])]
                return [*cascade, (x[1] - x[2]) / rig.tau, 1.0]

            inputs = [(0.0, (0.0, -1e3)), (step.t0, (1.0, step.t0)), (step.tf, (0.0, step.tf))]
            _, states = solved(rig, pressing, 4, k=k, inputs=inputs)
            assert np.abs((seen[step.name] - step.y0) / step.beta - states[:, 2]).max() < 1e-3
    assert 0.15 < min(times) < 0.8 * max(times) < 0.8


def test_a_check_valve_pops_open_and_shuts_altogether_against_an_ode_solver() -> None:
    strength, shares = 0.4, []
    for seed in (11, 12, 13):
        rig = replace(draw_case(seed, size="small"), strengths={"stiff_check_valve": strength})
        seen, reseats = clean_signals(rig), prepared_rig(rig)["1"].check_reseats
        shares.append(reseats / strength)
        for k, step in enumerate(rig.steps):

            def checked(
                u: tuple[float, bool], x: FloatArray, exchange: float = step.total_flow / rig.V,
                reseats: float = reseats, rig: Case = rig,
            ) -> list[float]:  # fmt: skip
                passed = (x[0] - reseats) / (1.0 - reseats) if u[1] else 0.0
                cascade = [(u[0] - x[0]) / rig.tau_v, exchange * (passed - x[1])]
                return [*cascade, (x[1] - x[2]) / rig.tau]

            # as a lag comes up to one share and down to another
            opens = step.t0 - rig.tau_v * np.log(1.0 - strength)
            shuts = step.tf - rig.tau_v * np.log(reseats)
            inputs = [
                (0.0, (0.0, False)), (step.t0, (1.0, False)), (opens, (1.0, True)),
                (step.tf, (0.0, True)), (shuts, (0.0, False)),
            ]  # fmt: skip
            t, states = solved(rig, checked, 3, k=k, inputs=inputs)
            x = (seen[step.name] - step.y0) / step.beta
            assert np.abs(x - states[:, 2]).max() < 1e-3
            assert np.abs(x[t < opens]).max() < 1e-9
    assert 0.4 < min(shares) < max(shares) < 0.9


def test_a_warming_coil_lets_the_valve_sink_against_an_ode_solver() -> None:
    strength, times = 0.3, []
    end = 1.0 - strength
    k = strength / end**2
    for seed in (11, 12, 13):
        rig = replace(draw_case(seed, size="small"), strengths={"warming_coil": strength})
        seen, found = clean_signals(rig), prepared_rig(rig)
        first = rig.steps[0]
        (lift,) = found[first.name].unmixed
        # once its current is off it cools as one lag
        left = 1.0 / lift(first.commanded_off + np.array([0.0, 3.0])) - 1.0
        time = 3.0 / np.log(left[0] / left[1])
        times.append(time)
        warmth = 0.0
        for number, step in enumerate(rig.steps):
            (lift,) = found[step.name].unmixed

            def sinking(
                u: tuple[float, float], x: FloatArray, exchange: float = step.total_flow / rig.V,
                time: float = time, rig: Case = rig,
            ) -> list[float]:  # fmt: skip
                current = 1.0 / (1.0 + k * x[3])
                cascade = [(u[0] - x[0]) / rig.tau_v, exchange * (x[0] * current - x[1])]
                return [*cascade, (x[1] - x[2]) / rig.tau, (u[1] * current - x[3]) / time]

            on, off = step.commanded_on, step.commanded_off
            inputs = [
                (0.0, (0.0, 0.0)), (on, (0.0, 1.0)), (step.t0, (1.0, 1.0)), (off, (1.0, 0.0)),
                (step.tf, (0.0, 0.0)),
            ]  # fmt: skip
            begin = [0.0, 0.0, 0.0, warmth]
            t, states = solved(rig, sinking, 4, k=number, inputs=inputs, begin=begin)
            # the next experiment begins with what is left at the end of this one
            warmth = states[-1, 3] * np.exp((t[-1] - step.duration) / time)
            x = (seen[step.name] - step.y0) / step.beta
            assert np.abs(x - states[:, 2]).max() < 1e-3
            assert lift(np.array([on]))[0] == pytest.approx(1.0) if number == 0 else warmth > 0.0
        # in the end the share is lost
        assert lift(np.array([on + 0.999 * (off - on)]))[0] > end
    assert 4.9 < min(times) < max(times) < 40.1


def test_a_hand_opens_the_valve_turn_by_turn_against_an_ode_solver() -> None:
    strength, counts, lengths = 2.0, set(), []
    for seed in (11, 12, 13, 14):
        rig = replace(draw_case(seed, size="small"), strengths={"valve_turned_by_hand": strength})
        seen, found = clean_signals(rig), prepared_rig(rig)
        for k, step in enumerate(rig.steps):
            wheel = found[step.name].wheel
            assert wheel is not None
            inputs: list[tuple[float, Any]] = [(0.0, (0.0, 0.0, 0.0))]
            for switch, way in ((step.t0, 1.0), (step.tf, -1.0)):
                fine = switch + np.linspace(0.0, strength, 200_001)
                rates = np.diff(wheel(fine)) / (fine[1] - fine[0])
                turning = np.abs(rates) > 1e-6
                # one speed, at which it goes all the way, and standing still in between
                speeds = way * rates[turning]
                assert np.ptp(np.sort(speeds)[20:-20]) < 1e-4 * speeds.max()
                assert rates.sum() * (fine[1] - fine[0]) == pytest.approx(way)
                begins = np.flatnonzero(np.diff(turning.astype(int), prepend=0) == 1)
                ends = np.flatnonzero(np.diff(turning.astype(int), append=0) == -1) + 1
                counts.add(len(begins))
                lengths.append((fine[ends[-1]] - switch) / strength)
                for begin, end in zip(fine[begins], fine[ends], strict=True):
                    now, then = wheel(np.array([begin, end]))
                    inputs += [(begin, (now, (then - now) / (end - begin), begin))]
                    inputs += [(end, (then, 0.0, end))]

            def turned(
                u: tuple[float, float, float], x: FloatArray,
                exchange: float = step.total_flow / rig.V, rig: Case = rig,
            ) -> list[float]:  # fmt: skip
                target = u[0] + u[1] * (x[3] - u[2])  # x[3] is the time itself
                cascade = [(target - x[0]) / rig.tau_v, exchange * (x[0] - x[1])]
                return [*cascade, (x[1] - x[2]) / rig.tau, 1.0]

            _, states = solved(rig, turned, 4, k=k, inputs=inputs)
            assert np.abs((seen[step.name] - step.y0) / step.beta - states[:, 2]).max() < 1e-3
    assert counts == {2, 3, 4}
    assert 0.5 <= min(lengths) < 0.7 and 0.8 < max(lengths) <= 1.0


def test_a_selector_goes_over_the_other_ports_against_an_ode_solver() -> None:
    strength, rows = 0.4, set()
    for seed in (11, 12, 16, 18, 19):
        rig = replace(draw_case(seed, size="small"), strengths={"sweeping_selector": strength})
        seen, t = clean_signals(rig), sample_times(rig.steps[0])
        rising = sorted(rig.steps, key=lambda step: step.concentration)
        off = {}
        for name, row in (("as used", list(rig.steps)), ("rising", rising)):
            off[name] = 0.0
            for k, step in enumerate(rig.steps):
                before = [
                    other.concentration / step.concentration for other in row[: row.index(step)]
                ]
                ways = ((step.t0, [*before, 1.0]), (step.tf, [*before[::-1], 0.0]))
                inputs: list[tuple[float, Any]] = [(0.0, 0.0)]
                for switch, levels in ways:
                    inputs += [(switch + i * strength, level) for i, level in enumerate(levels)]

                def cascade(
                    u: float, x: FloatArray, exchange: float = step.total_flow / rig.V, rig=rig
                ) -> list[float]:
                    first = [(u - x[0]) / rig.tau_v, exchange * (x[0] - x[1])]
                    return [*first, (x[1] - x[2]) / rig.tau]

                _, states = solved(rig, cascade, 3, k=k, inputs=inputs)
                x = (seen[step.name] - step.y0) / step.beta
                off[name] = max(off[name], np.abs(x - states[:, 2]).max())
                if off[name] < 1e-4:
                    # as much gas as all the ports that were open have let in
                    let_in = step.tf - step.t0 + strength * (2.0 * sum(before) - len(before))
                    assert np.trapezoid(x, t) == pytest.approx(let_in, rel=2e-3)
        fitting = {name for name in off if off[name] < 1e-4}
        assert len(fitting) == 1 or rising == list(rig.steps)
        rows |= fitting if len(fitting) == 1 else set()
    assert rows == {"as used", "rising"}


def test_a_shape_memory_wire_turns_as_a_cosine_of_its_temperature_lower_on_its_way_back() -> None:
    strength, drawn = 2.0, []
    for seed in (11, 12, 13, 14, 15):
        rig = replace(draw_case(seed, size="small"), strengths={"shape_memory_valve": strength})
        found, seen = prepared_rig(rig), clean_signals(rig)
        for k, step in enumerate(rig.steps):
            wheel = found[step.name].wheel
            assert wheel is not None
            t = np.arange(0.0, step.duration, 1e-3)
            z = wheel(t)
            assert np.abs(z[t < step.t0]).max() == 0.0 and z.max() == 1.0 and z[-1] == 0.0
            # what the wire's temperature still lacks, and has left, over that at the switch
            left = [np.exp(-np.abs(t - at) / strength) for at in (step.t0, step.tf)]
            lines, times = [], []
            for way, other in zip((t < step.tf, t > step.tf), left, strict=True):
                moves = way & (z > 1e-3) & (z < 1.0 - 1e-3)
                angle = np.arccos(1.0 - 2.0 * z[moves]) / np.pi
                slope, first = np.polyfit(angle, other[moves], 1)
                assert np.abs(first + slope * angle - other[moves]).max() < 1e-6
                lines.append((first, slope))
                times.append(np.count_nonzero(moves))
            (up, warming), (down, cooling) = lines
            # it moves from the switch on: 1 there, with nothing turned and with all of it
            assert up == pytest.approx(1.0, abs=1e-6)
            assert down + cooling == pytest.approx(1.0, abs=1e-6)
            # cooling its way goes down an exponential's end, warming only along its beginning
            assert times[1] > 1.3 * times[0]
            drawn.append((-warming, cooling))
            if k > 0:
                continue

            def valve(
                u: float, x: FloatArray, step=step, rig=rig, warming=warming, cooling=cooling
            ) -> list[float]:
                # x[3] is the time itself
                since = x[3] - (step.t0 if u > 0.0 else step.tf)
                lacks = 1.0 - np.exp(-max(since, 0.0) / strength)
                share = lacks / -warming if u > 0.0 else 1.0 - lacks / cooling
                turned = 0.5 - 0.5 * np.cos(np.pi * np.clip(share, 0.0, 1.0))
                own = (turned - x[0]) / rig.tau_v if x[3] >= step.t0 else 0.0
                flushed = step.total_flow / rig.V * (x[0] - x[1])
                return [own, flushed, (x[1] - x[2]) / rig.tau, 1.0]

            _, states = solved(rig, valve, 4, k=k)
            assert np.abs((seen[step.name] - step.y0) / step.beta - states[:, 2]).max() < 2e-4
    low, high = np.min(drawn, axis=0), np.max(drawn, axis=0)
    assert np.all(low > [0.15 / 2.65, 0.15 / 0.75]) and np.all(high < [0.3 / 0.95, 0.3 / 0.45])
    assert np.all(high > 1.1 * low)
    # a wire that is quick has its temperature at once, and the valve moves as if there were none
    quick = clean_signals(replace(rig, strengths={"shape_memory_valve": 1e-4}))
    plain = clean_signals(without_causes(rig))
    assert all(np.abs(quick[k] - plain[k]).max() < 1e-3 for k in plain)


def test_a_plunger_that_is_sucked_shut_leaves_out_the_end_of_its_exponential() -> None:
    for seed, strength in ((11, 0.3), (12, 0.5), (13, 0.1)):
        rig = replace(draw_case(seed, size="small"), strengths={"slamming_plunger": strength})
        seen, plain = clean_signals(rig), clean_signals(without_causes(rig))
        for k, step in enumerate(rig.steps):
            t = sample_times(step)
            slams = step.tf + rig.tau_v * np.log(1.0 / strength)

            def sucked(
                u: tuple[float, float], x: FloatArray, step: Any = step, rig: Case = rig
            ) -> list[float]:
                opened = u[1] * x[0]  # the free lag, and whether the plunger is off its seat
                gas = [step.total_flow / rig.V * (opened - x[1]), (x[1] - x[2]) / rig.tau]
                return [(u[0] - x[0]) / rig.tau_v, *gas]

            pieces = [
                (0.0, (0.0, 1.0)), (step.t0, (1.0, 1.0)), (step.tf, (0.0, 1.0)),
                (slams, (0.0, 0.0)),
            ]  # fmt: skip
            _, states = solved(rig, sucked, 3, k=k, inputs=pieces)
            x = (seen[step.name] - step.y0) / step.beta
            assert np.abs(x - states[:, 2]).max() < 1e-4
            # it has opened as ever, and up to the slam it closes as ever
            before = t < slams - 1e-3
            assert np.abs(seen[step.name] - plain[step.name])[before].max() < 1e-5
            # what the manifold and the sensor never get is the end of the valve's own way
            short = np.sum(plain[step.name] - seen[step.name]) * step.interval / step.beta
            assert short == pytest.approx(strength * rig.tau_v, rel=0.02)
