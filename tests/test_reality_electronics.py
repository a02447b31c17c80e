"""Causes of receiver, converter and recorder against closed forms and their own promises."""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise
from typing import Any

import numpy as np
import pytest
from scipy.fft import dct, idct
from scipy.integrate import solve_ivp
from scipy.signal import welch

from bayes_sensor.campaign import FloatArray
from bayes_sensor.reality import Case, clean_signals, draw_case, sample_times, without_causes
from bayes_sensor.reality.knobs import Knobs
from bayes_sensor.reality.rig import voltage
from bayes_sensor.reality.simulator import prepared_rig
from bayes_sensor.reality.stages.readout import (
    blanked,
    clamped,
    cosine_blocks,
    counted,
    distrusted,
    envelope,
    kept,
    log_amplifier,
    miscounted,
    one_bit,
    oscillating_lag,
    overloaded,
    parabola,
    phase_locked,
    slowest_waves,
    windowed_average,
)
from tests.reality_cases import assert_added_between_marks, case, offsets, on_its_clock, solved


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


def test_a_hurried_timer_shows_the_ideal_signal_at_other_times() -> None:
    rig = case(hurried_timer=0.12)
    seen = clean_signals(rig)
    for step, t, true in on_its_clock(rig):
        assert np.all(np.diff(true) > 0.0)
        assert 0.06 < np.abs(true - t).max() <= 0.12
        assert np.array_equal(seen[step.name], voltage(rig, step, Knobs(), true)[0])


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


def test_a_pen_on_a_pivot_is_late_by_its_arc() -> None:
    strength, signs = 0.4, set()
    for seed in (11, 12, 13, 14):
        rig = replace(draw_case(seed, size="small"), strengths={"swinging_pen": strength})
        knobs, seen = prepared_rig(rig)["1"], clean_signals(rig)
        signs.add(np.sign(knobs.pen_late))
        ends = [y for step in rig.steps for y in (step.y0, step.y0 + step.beta)]
        swing = max(abs(y - knobs.pen_rest) for y in ends)
        widest = np.arcsin(knobs.pen_sine)
        for step in rig.steps:
            t, shown = sample_times(step), seen[step.name]
            fine = np.linspace(0.0, step.duration, 60_001)
            plain, _ = voltage(rig, step, Knobs(), fine)
            # where the pen's tip is on the paper, as it turns about its pivot
            angle = np.arcsin(np.sin(widest) * (plain - knobs.pen_rest) / swing)
            along = 1.0 - np.cos(angle)
            drawn = fine + np.sign(knobs.pen_late) * strength * along / (1.0 - np.cos(widest))
            assert np.abs(drawn - fine).max() <= strength * (1.0 + 1e-9)
            for switch, up in ((step.t0, True), (step.tf, False)):
                for share in (0.2, 0.5, 0.8):
                    level = step.y0 + share * step.beta
                    inside = (t > switch - 2.0) & (t < switch + 6.0)
                    beyond = shown[inside] > level if up else shown[inside] < level
                    crossed = t[inside][np.argmax(beyond)]
                    past = (fine > switch) & ((plain >= level) if up else (plain <= level))
                    first = np.argmax(past)
                    assert crossed == pytest.approx(drawn[: first + 1].max(), abs=0.012)
            assert shown[t < step.t0 - 1.0] == pytest.approx(step.y0, abs=1e-9)
            before = np.argmin(np.abs(t - (step.tf - 1.0)))
            assert shown[before] == pytest.approx(step.y0 + step.beta, abs=0.02 * step.beta)
    assert signs == {-1.0, 1.0}


def test_a_driver_doubts_what_is_steep_and_shows_a_stair() -> None:
    t = np.arange(0.0, 4.0, 1e-3)
    slow, steep = 0.4 * t, 1.0 * t
    assert np.array_equal(distrusted(t, slow, slow - 0.04, 0.05, 0.5), slow)
    stair = distrusted(t, steep, steep - 0.1, 0.05, 0.5)
    jumps = t[1:][np.diff(stair) > 0.01]
    assert jumps == pytest.approx(0.001 + 0.5 * np.arange(1.0, 8.0), abs=2e-3)
    assert stair[np.isin(t, jumps)] == pytest.approx(jumps)

    strength, stood = 0.15, 0
    for seed in (11, 12, 13):
        rig = replace(draw_case(seed, size="small"), strengths={"distrustful_filter": strength})
        knobs, seen = prepared_rig(rig)["1"], clean_signals(rig)
        plain = clean_signals(without_causes(rig))
        slopes = []
        for step in rig.steps:
            y, shown, t = plain[step.name], seen[step.name], sample_times(step)
            change = np.abs(y - np.interp(t - knobs.distrust_within, t, y))
            sure = change < 0.98 * knobs.distrust_band
            assert np.array_equal(shown[sure], y[sure])
            # in doubt it stands, or has just jumped to what it reads
            doubt = np.flatnonzero(change > 1.02 * knobs.distrust_band)
            stands = np.abs(np.diff(shown, prepend=shown[0])) < 1e-12
            jumped = np.abs(shown - y) < 0.02 * step.beta
            assert np.all(stands[doubt] | jumped[doubt])
            runs = np.split(doubt, np.flatnonzero(np.diff(doubt) > 1) + 1)
            for run in runs:
                jumps = np.flatnonzero(~stands[run][1:])
                if len(jumps) > 2:
                    # from jump to jump; one between two samples shows in both
                    apart = np.diff(t[run][jumps])
                    assert max(apart) == pytest.approx(strength, abs=2.1 * step.interval)
                    stood += len(jumps)
            slopes.append(np.abs(np.diff(y)).max() / step.interval)
        share = knobs.distrust_band / knobs.distrust_within / max(slopes)
        assert 0.19 < share < 0.51
    assert stood > 6


def test_a_ramped_magnet_induces_two_even_voltages_that_cancel() -> None:
    strength, taken = 0.1, 0
    for seed in (11, 12, 13, 14, 15):
        rig = replace(draw_case(seed, size="small"), strengths={"neighbours_magnet": strength})
        size = strength * np.mean([step.beta for step in rig.steps])
        times = set()
        for _, induced in offsets(rig, atol=1e-6):
            taken += 1
            t = np.linspace(0.0, 120.0, 240_001)
            v = induced(t)
            # what is left at the end dies away in one time; with it undone there are even levels
            late = np.flatnonzero(np.abs(v) > 1e-4 * size)[-1]
            eddies = -v[late] / np.gradient(v, t)[late]
            box = v + eddies * np.gradient(v, t)
            level = np.round(box / size, 3)
            ways = [float(w) for w, n in zip(*np.unique(level, return_counts=True)) if n > 500]
            assert 0.0 in ways and len(ways) == 3
            first, second = sorted((w for w in ways if w != 0.0), key=abs)
            assert abs(second) == pytest.approx(1.0, abs=2e-3) and first * second < 0.0
            assert 0.4 < abs(first) < 1.0
            times.add((round(float(eddies), 2), ways[0]))
            # the field comes back to what it was, and stood still in between
            field = np.cumsum(v) * (t[1] - t[0])
            assert abs(field[-1]) < 2e-3 * np.abs(field).max()
            ramp = np.count_nonzero(level == first) * (t[1] - t[0])
            assert np.abs(field).max() == pytest.approx(abs(first) * size * ramp, rel=0.05)
            assert 1.9 < ramp < 12.1 and 0.1 < eddies < 1.0
        assert len(times) == 1  # one magnet, one loop
    assert taken >= 6


def test_a_counter_loses_the_fringes_that_come_too_fast() -> None:
    # twice as fast as it counts: it loses every other one, and what is slow brings none back
    t = np.linspace(0.0, 6.0, 6001)
    y = np.interp(t, [1.0, 2.03, 4.0, 4.52, 6.0], [0.0, 2.06, 2.06, 1.02, 1.02])
    counted = miscounted(t, y, 1.0, 0.1)
    assert counted[t < 1.0].max() == 0.0
    assert counted[3000] == pytest.approx(2.06 - 10 * 0.1)
    assert counted[-1] == pytest.approx(1.02 - 5 * 0.1)
    assert np.array_equal(miscounted(t, y, 2.1, 0.1), y)

    strength, counts = 1.2, []
    for seed in (11, 12, 13):
        rig = replace(draw_case(seed, size="small"), strengths={"missed_fringes": strength})
        knobs, seen = prepared_rig(rig)["1"], clean_signals(rig)
        fringe, steepest = knobs.fringe_width, []
        assert 0.01 < fringe / np.mean([step.beta for step in rig.steps]) < 0.06
        for step in rig.steps:
            t = sample_times(step)
            y, _ = voltage(rig, step, Knobs(), t)
            lost = (y - seen[step.name]) / fringe
            assert lost == pytest.approx(np.rint(lost), abs=1e-6)
            # as many as an integral over the steep part holds
            for begin, end, way in ((0.0, step.tf, 1), (step.tf, step.duration, -1)):
                fine = np.linspace(begin, end, 200_001)
                slope = np.abs(np.gradient(voltage(rig, step, Knobs(), fine)[0], fine))
                steepest.append(slope.max())
                beyond = np.trapezoid(np.maximum(slope - knobs.countable, 0.0), fine) / fringe
                inside = lost[(t >= begin) & (t < end)]
                found = way * (inside[-1] - inside[0])
                assert abs(found - np.floor(beyond)) < 0.1 or abs(beyond - np.rint(beyond)) < 0.05
                counts.append(found)
        assert knobs.countable * (1.0 + strength) == pytest.approx(max(steepest), rel=1e-2)
    assert min(counts) < 2.0 and max(counts) > 4.0  # slow experiments lose none or few


def test_a_lock_in_amplifier_reads_the_length_of_light_and_leak() -> None:
    strength, angles = 0.5, []
    for seed in (11, 12, 13):
        rig = replace(draw_case(seed, size="small"), strengths={"lock_in_magnitude": strength})
        seen, plain = clean_signals(rig), clean_signals(without_causes(rig))
        size = strength * np.mean([step.beta for step in rig.steps])
        # by the law of cosines what is added to the square is linear in the voltage
        y = np.concatenate([plain[step.name] for step in rig.steps])
        R = np.concatenate([seen[step.name] for step in rig.steps])
        slope, square = np.polyfit(y, R**2 - y**2, 1)
        assert np.sqrt(square) == pytest.approx(size, rel=1e-6)
        angle = np.arccos(0.5 * slope / size)
        angles.append(angle / np.pi)
        # and the crest of both oscillations together
        turn = np.linspace(0.0, 2.0 * np.pi, 2001)
        for i in range(0, len(y), len(y) // 50):
            crest = np.max(y[i] * np.cos(turn) + size * np.cos(turn - angle))
            assert R[i] == pytest.approx(crest, rel=1e-5)
    assert 0.4 < min(angles) < max(angles) < 0.8


def test_a_dying_battery_cuts_off_late_plateaus() -> None:
    strength, cut, whole = 0.25, 0, 0
    for seed in range(11, 19):
        rig = replace(draw_case(seed, size="small"), strengths={"dying_battery": strength})
        size = strength * np.mean([step.beta for step in rig.steps])
        seen, plain = clean_signals(rig), clean_signals(without_causes(rig))
        begin, last, most, voltages = 0.0, np.inf, 0.0, []
        for step in rig.steps:
            t, battery = sample_times(step), prepared_rig(rig)[step.name].battery
            assert battery is not None
            limit = battery(t)
            assert np.all(np.diff(limit) <= 0.0) and limit[0] <= last + 1e-12
            last = limit[-1]
            missing = plain[step.name] - seen[step.name]
            assert np.abs(missing - np.maximum(plain[step.name] - limit, 0.0)).max() < 1e-4
            gas = t < step.tf
            most = max(most, missing[gas][-1])
            cut += missing.max() > 1e-3
            whole += missing.max() == 0.0
            voltages.append((begin + t, limit))
            begin += step.duration
        assert most == pytest.approx(size, rel=5e-3)
        # what it has fallen by is a power of the time on, to the end of the last plateau
        on, volts = (np.concatenate(both) for both in zip(*voltages, strict=True))
        end = begin - step.duration + step.tf
        assert np.ptp(volts[on > end]) == 0.0
        fallen = volts[0] - np.interp(np.array([0.25, 0.5, 1.0]) * end, on, volts)
        orders = np.log2(fallen[1:] / fallen[:-1])
        assert orders[0] == pytest.approx(orders[1], rel=1e-3) and 2.0 <= orders[0] <= 4.0
    assert cut >= 8 and whole >= 4


def test_between_two_transistors_without_bias_the_output_stands() -> None:
    strength, places = 0.2, []
    for seed in (11, 12, 13, 14):
        rig = replace(draw_case(seed, size="small"), strengths={"dead_crossover": strength})
        seen, plain = clean_signals(rig), clean_signals(without_causes(rig))
        size = float(np.mean([step.beta for step in rig.steps]))
        y, z = (np.concatenate([some[s.name] for s in rig.steps]) for some in (plain, seen))
        order = np.argsort(y)
        y, z = y[order], z[order]
        # the same up and down, in all experiments
        assert np.all(np.diff(z) > -1e-9)
        middle = prepared_rig(rig)["1"].crossover_at
        inside = np.abs(y - middle) < 0.5 * strength * size
        assert np.abs(z[inside] - middle).max() < 1e-4 and np.count_nonzero(inside) > 20
        below, above = y < middle - 0.51 * strength * size, y > middle + 0.51 * strength * size
        assert (z - y)[below] == pytest.approx(0.5 * strength * size, abs=1e-6)
        assert (z - y)[above] == pytest.approx(-0.5 * strength * size, abs=1e-6)
        places.append((middle - np.mean([step.y0 for step in rig.steps])) / size)
    assert 0.25 < min(places) < max(places) < 0.75


def test_a_phase_lock_slips_where_the_signal_is_too_fast_against_an_ode_solver() -> None:
    # even slopes: below its fastest it follows, with an error of phase, above it never locks
    t = np.arange(0.0, 40.0, 2e-3)
    for share in (0.8, 1.3):
        slope = share * 0.1 / 0.5
        v = phase_locked(t, slope * t, 0.1, 0.5, 0.01)
        behind = slope * t - v
        if share < 1.0:
            assert np.abs(behind[t > 10.0]).max() < 1e-6
        else:
            assert behind[-1] > 3.0 * behind[np.searchsorted(t, 10.0)] > 1.0
    assert np.array_equal(phase_locked(t, np.sin(t), 0.1, 1e-7, 1e-8), np.sin(t))

    slipped = set()
    for seed, strength in ((11, 0.7), (11, 2.5), (17, 0.7), (17, 2.5)):
        rig = replace(draw_case(seed, size="small"), strengths={"slipping_phase_lock": strength})
        seen, plain = clean_signals(rig), clean_signals(without_causes(rig))
        knobs, slips, steepest = prepared_rig(rig)["1"], [], []
        width, time, beat = knobs.loop_width, knobs.loop_time, knobs.loop_beat
        for k, step in enumerate(rig.steps):

            def loop(u: float, x: FloatArray, step=step, rig=rig, w=width, T=time, b=beat):
                cascade = [(u - x[0]) / rig.tau_v, step.total_flow / rig.V * (x[0] - x[1])]
                pulls = w * np.sin(x[3])
                error = (step.y0 + step.beta * x[2] - x[4] - pulls) / b
                return [*cascade, (x[1] - x[2]) / rig.tau, error, pulls / T]

            t, states = solved(rig, loop, 5, k=k, begin=[0.0, 0.0, 0.0, 0.0, step.y0])
            v = states[:, 4] + width * np.sin(states[:, 3])
            assert np.abs(seen[step.name] - v).max() < 2e-3
            slips.append(np.abs(states[:, 3]).max() > np.pi)
            rises = t < step.tf
            steepest.append(np.diff(plain[step.name][rises]).max() / step.interval)
        # what it can follow for long is the stated share of the steepest rise
        assert max(steepest) * time / width == pytest.approx(strength, rel=1e-2)
        assert any(slips) or strength < 1.0
        assert not any(slips) or strength > 1.0
        slipped |= set(slips)
        damping = 0.5 * np.sqrt(width * time / beat)
        assert 0.6 < damping < 1.5
    assert slipped == {False, True}


def test_an_archive_keeps_the_first_cosines_of_every_block() -> None:
    t = np.linspace(0.0, 7.0, 70_001)
    for order in range(5):
        wave = np.cos(np.pi * order * np.mod(t + 0.3, 2.0) / 2.0)
        left = cosine_blocks(t, wave, -0.3, 2.0, 3)
        whole = (t > 1.75) & (t < 5.65)  # of these blocks there is all
        expected = wave if order < 3 else np.zeros(len(t))
        assert np.abs(left - expected)[whole].max() < 1e-3

    strength, kept, early = 3.0, set(), 0
    for seed in range(11, 17):
        rig = replace(draw_case(seed, size="small"), strengths={"lossy_archive": strength})
        found, plain = prepared_rig(rig), without_causes(rig)
        kept.add(found["1"].archive_kept)
        middles = (np.arange(200) + 0.5) / 200.0 * strength
        whole_blocks = strength * np.arange(1.0, 9.0)
        times = {
            name: np.add.outer(knobs.archive_begin + whole_blocks, middles).ravel()
            for name, knobs in found.items()
        }
        seen, y = clean_signals(rig, times), clean_signals(plain, times)
        for step in rig.steps:
            blocks = dct(y[step.name].reshape(8, -1), norm="ortho")
            blocks[:, found[step.name].archive_kept :] = 0.0
            packed = idct(blocks, norm="ortho")
            assert np.abs(seen[step.name] - packed.ravel()).max() < 3e-3 * step.beta
            # a step shows before it is there, and the block's mean stays
            lost = (seen[step.name] - y[step.name]).reshape(8, -1)
            into = np.mod(step.t0 - found[step.name].archive_begin, strength)
            before = times[step.name] < step.t0
            if 0.2 * strength < into < 0.8 * strength:
                early += 1
                assert np.abs(lost.ravel()[before]).max() > 0.01 * step.beta
            else:
                assert np.abs(lost.ravel()[times[step.name] < step.t0 - into]).max() < 1e-9
            assert np.abs(lost.mean(axis=1)).max() < 1e-3 * step.beta
    assert len(kept) > 1 and kept <= {2, 3, 4, 5} and early > 5
    # blocks of no more samples than cosines lose nothing
    tiny = replace(rig, strengths={"lossy_archive": 1.5 * rig.steps[0].interval})
    assert all(np.array_equal(y, clean_signals(plain)[k]) for k, y in clean_signals(tiny).items())


def test_a_leaking_shutter_takes_light_for_its_zero_until_the_next_one() -> None:
    strength, drawn = 0.2, []
    for seed in (11, 12, 13, 14, 15):
        rig = replace(draw_case(seed, size="small"), strengths={"leaking_shutter": strength})
        times = {step.name: np.arange(0.0, step.duration, 1e-3) for step in rig.steps}
        seen, plain = clean_signals(rig, times), clean_signals(without_causes(rig), times)
        every = prepared_rig(rig)["1"].zero_every
        drawn.append(every)
        for step in rig.steps:
            t, y = times[step.name], plain[step.name]
            taken = (y - seen[step.name]) / strength
            # it stands between zeros: nothing in between but rounding
            moves = np.abs(np.diff(taken)) > 1e-7 * step.beta
            assert np.count_nonzero(moves) <= 30.0 / every + 1.0
            zeros = np.flatnonzero(moves)
            for i in zeros:
                # what is taken from then on is the light of that instant
                assert min(y[i : i + 2]) - 1e-6 <= taken[i + 1] <= max(y[i : i + 2]) + 1e-6
            turns = (t[zeros] - t[zeros[0]]) / every
            assert np.abs(turns - np.rint(turns)).max() < 2e-3 / every
            # what was before the record was a baseline
            assert taken[0] == pytest.approx(step.y0, abs=1e-6)
            # and once the fall has been zeroed it is one again
            if step.duration - step.tf > every + 6.0 * (rig.tau_v + rig.V / step.total_flow):
                assert taken[-1] == pytest.approx(step.y0, abs=0.02 * step.beta)
    assert 4.0 < min(drawn) < max(drawn) < 30.0 and max(drawn) > 1.5 * min(drawn)


def test_a_charge_is_counted_and_shown_until_the_next_one_is_full() -> None:
    # an even light is read as it is, and an even slope by the roots of its integral
    t = np.linspace(0.0, 10.0, 20_001)
    assert counted(t, np.full(len(t), 0.7), 0.5, 0.3) == pytest.approx(0.7)
    ramp = counted(t, 0.5 + t, 2.0, 0.0)
    fills = np.sqrt(0.25 + 2.0 * 2.0 * np.arange(28.0)) - 0.5
    means = 2.0 / np.diff(fills)
    k = np.searchsorted(fills, t[1:], side="right") - 2
    late = (k >= 0) & (np.abs(t[1:, None] - fills).min(axis=1) > 1e-3)
    assert ramp[1:][late] == pytest.approx(means[k[late]], rel=1e-5)

    strength, parts = 0.15, set()
    for seed in (11, 12, 13):
        rig = replace(draw_case(seed, size="small"), strengths={"counted_charges": strength})
        times = {step.name: np.arange(0.0, step.duration, 4e-4) for step in rig.steps}
        seen, plain = clean_signals(rig, times), clean_signals(without_causes(rig), times)
        charge = strength * np.mean([step.beta for step in rig.steps])
        for step in rig.steps:
            t, y, shown = times[step.name], plain[step.name], seen[step.name]
            jumps = np.flatnonzero(np.abs(np.diff(shown)) > 1e-5)
            parts.add(round(prepared_rig(rig)[step.name].charge_begin, 6))
            # while it moves each stand is one charge, and what the next one shows is its mean
            moving = [
                (i, j) for i, j in pairwise(jumps)
                if step.t0 < t[i] and np.ptp(y[i : j + 1]) > 0.02 * step.beta
            ]  # fmt: skip
            assert len(moving) > 5
            for i, j in moving:
                whole = np.trapezoid(y[i : j + 1], t[i : j + 1])
                if whole > 1.5 * charge:  # two of them that are the same by chance
                    continue
                assert whole == pytest.approx(charge, abs=1e-3 * step.beta + 1e-9)
                assert shown[j + 2] == pytest.approx(charge / (t[j] - t[i]), rel=0.02)
            # in the faint light of the baseline it is slow: nothing of the rise shows for long
            onset = t[np.argmax(shown > step.y0 + 0.01 * step.beta)]
            assert onset > t[np.argmax(y > step.y0 + 0.01 * step.beta)]
    assert len(parts) == 9  # no record begins with as much as another
    # fillings that are all shorter than the recorder's interval are not told apart
    tiny = replace(rig, strengths={"counted_charges": 1e-3 * rig.steps[0].interval})
    plain = clean_signals(without_causes(rig))
    assert all(np.array_equal(y, plain[k]) for k, y in clean_signals(tiny).items())


def test_a_clamp_empties_the_capacitor_that_droops_between_against_an_ode_solver() -> None:
    # an even light droops to 1 - s of itself, again and again
    t = np.linspace(0.0, 10.0, 10_001)
    time = -2.0 / np.log(1.0 - 0.2)
    even = clamped(t, np.full(len(t), 0.7), time, 2.0, -0.5)
    since = np.mod(t + 0.5, 2.0)
    inside = (t > 1.5) & (since > 1e-6) & (since < 2.0 - 1e-6)
    assert even[inside] == pytest.approx(0.7 * np.exp(-since[inside] / time), abs=1e-9)
    assert even[inside].min() == pytest.approx(0.7 * 0.8, abs=1e-3)

    strength, drawn = 0.25, []
    for seed in (11, 12, 13, 14, 15):
        rig = replace(draw_case(seed, size="small"), strengths={"drooping_clamp": strength})
        found, seen = prepared_rig(rig), clean_signals(rig)
        for k, step in enumerate(rig.steps):
            knobs = found[step.name]
            every, begin = knobs.clamp_every, knobs.clamp_begin
            drawn.append((every, -begin / every))
            clamps = np.arange(begin + every, step.duration, every)
            light = step.y0  # of a baseline the capacitor has some since the clamp before
            had = light * (1.0 - (1.0 - strength) ** (-begin / every))
            time = -every / np.log(1.0 - strength)
            cuts = sorted([(0.0, 0.0), (step.t0, 1.0), (step.tf, 0.0)])
            pieces = [(at, (u, 0)) for at, u in cuts]
            for number, at in enumerate(clamps.tolist(), start=1):
                open_ = float(step.t0 <= at < step.tf)
                pieces.append((at, (open_, number)))
            pieces.sort(key=lambda piece: piece[0])

            def coupled(
                u: tuple[float, int], x: FloatArray, step=step, rig=rig, time=time
            ) -> list[float]:
                gas = [(u[0] - x[0]) / rig.tau_v, step.total_flow / rig.V * (x[0] - x[1])]
                return [*gas, (x[1] - x[2]) / rig.tau, (step.y0 + step.beta * x[2] - x[3]) / time]

            # what has been charged in all, without a clamp; each takes it off, and its decay too
            s, states = solved(rig, coupled, 4, k=k, inputs=pieces, begin=[0.0, 0.0, 0.0, had])
            y, q = step.y0 + step.beta * states[:, 2], states[:, 3]
            charge = q.copy()
            for at in clamps.tolist():
                late = s >= at
                taken = np.interp(at, s, charge)
                charge[late] -= taken * np.exp(-(s[late] - at) / time)
            clear = np.abs(s[:, None] - clamps).min(axis=1) > 0.015
            off = np.abs(seen[step.name] - (y - charge))
            assert off[clear].max() < 3e-3 * step.beta
            assert np.median(off[clear]) < 3e-4 * step.beta
    low, high = np.min(drawn, axis=0), np.max(drawn, axis=0)
    assert np.all(low > [1.49, 0.0]) and np.all(high < [12.01, 1.0]) and np.all(high > 1.5 * low)


def test_a_baseline_climbs_evenly_under_a_plateau_and_the_fall_ends_on_it() -> None:
    strength, met = 0.3, 0
    for seed in (11, 12, 13):
        rig = replace(draw_case(seed, size="small"), strengths={"climbing_baseline": strength})
        seen, plain = clean_signals(rig), clean_signals(without_causes(rig))
        typical = float(np.median([step.tf - step.t0 for step in rig.steps]))
        climbs = strength * np.mean([step.beta for step in rig.steps]) / typical
        for step in rig.steps:
            t, y, shown = sample_times(step), plain[step.name], seen[step.name]
            # reading by reading: up by no more than it climbs, down with the signal at once
            floor = np.empty(len(t))
            floor[0] = y[0]
            for i in range(1, len(t)):
                floor[i] = min(floor[i - 1] + climbs * step.interval, y[i])
            assert np.abs(shown - (y - floor + step.y0)).max() < 1e-3 * step.beta
            assert shown.min() > step.y0 - 1e-9  # nothing is ever below its baseline
            flat = (t > step.tf - 2.0) & (t < step.tf)
            assert np.polyfit(t[flat], (shown - y)[flat], 1)[0] == pytest.approx(-climbs, rel=0.01)
            # where the fall has come down to it there is nothing left, of the tail neither
            ends = t[(t > step.tf) & (shown < step.y0 + 1e-6)][0]
            there = float(np.interp(ends, t, y)) - step.y0
            reach = climbs * (ends - step.t0)
            assert there == pytest.approx(reach, rel=0.05)
            assert np.abs(shown[t > ends + 0.1] - step.y0).max() < 1e-4
            met += int(there > 0.1 * step.beta)
    assert met >= 6


def test_a_missing_bit_is_taken_off_wherever_the_code_has_it() -> None:
    strength, zeros = 0.3, []
    for seed in (11, 12, 13, 14, 15):
        rig = replace(draw_case(seed, size="small"), strengths={"missing_bit": strength})
        seen, plain = clean_signals(rig), clean_signals(without_causes(rig))
        weight = strength * np.mean([s.beta for s in rig.steps])
        zero = prepared_rig(rig)["1"].bit_zero
        zeros.append(zero / weight)
        for step in rig.steps:
            y, shown = plain[step.name], seen[step.name]
            # a converter of 16 bits, of which the twelfth is always zero, to its own step
            lsb = weight / 2**11
            codes = np.floor((y - zero) / lsb).astype(np.int64)
            assert codes.min() >= 0 and codes.max() < 2**16
            spoilt = codes & ~(1 << 11)
            rest = (y - zero) / lsb - codes
            assert shown == pytest.approx(zero + lsb * (spoilt + rest), abs=1e-9)
            off = y - shown
            assert np.all((np.abs(off) < 1e-9) | (np.abs(off - weight) < 1e-9))
            # up and down cross the same levels, twice as high apart as the bit is worth
            leaps = np.flatnonzero(np.abs(np.diff(off)) > 0.5 * weight)
            assert len(leaps) >= 4 and len(leaps) % 2 == 0
            where = np.abs((0.5 * (y[leaps] + y[leaps + 1]) - zero) / weight)
            steep = np.abs(y[leaps] - y[leaps + 1]) / weight
            assert np.all(np.abs(where - np.rint(where)) < 0.5 * steep + 1e-9)
    assert -2.0 < min(zeros) < -0.7 and np.ptp(zeros) > 0.4 and max(zeros) < 0.0


def test_a_cables_insulation_gives_its_charge_back_as_a_power_of_time() -> None:
    strength, drawn, signs = 0.4, [], set()
    for seed in range(11, 19):
        rig = replace(draw_case(seed, size="paper"), strengths={"static_discharge": strength})
        size, found = strength * np.mean([s.beta for s in rig.steps]), prepared_rig(rig)
        t = np.arange(0.0, 120.0 * len(rig.steps), 0.01)
        charge, shocks = np.zeros(len(t)), []
        for k, step in enumerate(rig.steps):
            own = (t >= 120.0 * k) & (t < 120.0 * (k + 1))
            for course in found[step.name].offset:
                charge[own] = course(t[own] - 120.0 * k) / size
            shocks += [120.0 * k + at for at in found[step.name].marks[::2]]
        assert len(shocks) == len(rig.steps) // 2 + 1 and shocks == sorted(shocks)
        assert np.all(charge[t < shocks[0] - 1e-5] == 0.0)
        # the first one alone: its logarithmic slope is that of a power of the time since
        alone = (t > shocks[0] + 1e-5) & (t < shocks[1] - 0.01)
        since, back = t[alone] - shocks[0], charge[alone]
        sign = float(np.sign(back[0]))
        # 1/(log slope) = -(first + since)/power, a straight line
        turned = -back[1:-1] / ((back[2:] - back[:-2]) / 0.02)
        late = since[1:-1] > 0.2
        slope, begin = np.polyfit(since[1:-1][late], turned[late], 1)
        power, first = 1.0 / slope, begin / slope
        law = (1.0 + since / first) ** -power
        assert sign * back == pytest.approx(law, abs=2e-3)
        # each of the others adds the same, of either sign
        total = np.zeros(len(t))
        for at in shocks:
            after = t > at
            place = np.searchsorted(t, at)
            way = float(np.sign(charge[place + 1] - charge[place - 1]))
            signs.add(way)
            total[after] += way * (1.0 + (t[after] - at) / first) ** -power
        clear = np.min(np.abs(t[:, None] - np.array(shocks)), axis=1) > 0.02
        assert np.abs(total - charge)[clear].max() < 5e-3
        drawn.append((power, first))
    low, high = np.min(drawn, axis=0), np.max(drawn, axis=0)
    assert np.all(low > [0.49, 0.19]) and np.all(high < [1.01, 2.02]) and np.all(high > 1.3 * low)
    assert signs == {-1.0, 1.0}
    # and it is added to the signal as it is, but for what the grid makes of a leap
    assert_added_between_marks(case(static_discharge=strength))


def test_a_flattened_record_has_lost_some_of_its_slowest_waves_and_nothing_else() -> None:
    strength, counts = 0.3, []
    for seed in range(11, 19):
        rig = replace(draw_case(seed, size="small"), strengths={"flattened_record": strength})
        seen, plain = clean_signals(rig), clean_signals(without_causes(rig))
        for step in rig.steps:
            n = len(plain[step.name])
            was, is_ = (np.fft.rfft(found[step.name]) / n for found in (plain, seen))
            gone = 1.0 - np.abs(is_[1:7]) / np.abs(was[1:7])
            waves = prepared_rig(rig)[step.name].flattened_waves
            # the mean stays, and every wave but those; sums over samples are off by 1e-3
            assert is_[0] == pytest.approx(was[0], abs=1e-3 * step.beta)
            lost = was[1:7] - is_[1:7]
            expected = np.where(np.arange(6) < waves, strength, 0.0) * was[1:7]
            assert np.abs(lost - expected).max() < 1e-3 * step.beta
            strong = np.abs(was[1:7]) > 0.05 * step.beta
            assert np.abs(gone - np.where(np.arange(6) < waves, strength, 0.0))[strong].max() < 0.03
            counts.append(waves)
    assert set(counts) <= {1, 2, 3, 4} and len(set(counts)) > 1
    t = np.unique(np.random.default_rng(3).uniform(0.0, 20.0, 20_000))
    wave = np.cos(2.0 * np.pi * t / 20.0 + 0.4) - 0.5 * np.sin(6.0 * np.pi * t / 20.0)
    assert np.abs(slowest_waves(t, 0.7 + wave, 20.0, 3) - wave).max() < 1e-4
    assert np.abs(slowest_waves(t, 0.7 + wave, 20.0, 2)).max() > 0.9


def test_an_idle_tone_is_as_high_as_the_signal_is_off_its_zero_and_as_loud_everywhere() -> None:
    strength, pitches = 0.2, []
    for seed in range(11, 19):
        rig = replace(draw_case(seed, size="small"), strengths={"whining_converter": strength})
        size = strength * np.mean([step.beta for step in rig.steps])
        step = rig.steps[0]
        knobs = prepared_rig(rig)[step.name]
        pitches.append(knobs.whine_rate * size / strength)
        # as often as it takes to follow the tone
        t = np.arange(0.0, step.duration, 5e-4)
        times = {s.name: t for s in rig.steps}
        seen, plain = (clean_signals(c, times) for c in (rig, without_causes(rig)))
        tone = seen[step.name] - plain[step.name]
        assert np.abs(tone).max() <= size * (1.0 + 1e-9)
        rate = knobs.whine_rate * np.abs(plain[step.name] - knobs.whine_zero)
        turns = np.concatenate([[0.0], np.cumsum(0.5 * (rate[1:] + rate[:-1])) * 5e-4])
        expected = size * np.sin(2.0 * np.pi * (turns + knobs.whine_begin))
        assert np.abs(tone - expected).max() < 0.02 * size
        # at rest it is one pure tone, of which any three readings tell the pitch
        rest = t < step.t0
        y = tone[rest]
        (a,), *_ = np.linalg.lstsq(y[1:-1, None], y[2:] + y[:-2], rcond=None)
        found = np.arccos(np.clip(0.5 * a, -1.0, 1.0)) / (2.0 * np.pi * 5e-4)
        assert found == pytest.approx(rate[0], rel=0.01, abs=0.05)
        # every experiment's begins anywhere
        assert len({prepared_rig(rig)[s.name].whine_begin for s in rig.steps}) == len(rig.steps)
    assert 2.99 < min(pitches) < 15.0 < max(pitches) < 40.01


def test_a_link_of_one_bit_gets_away_slowly_and_overshoots() -> None:
    # to and fro about a level by the smallest steps, and after a leap by steps that grow by half
    y = np.concatenate([np.full(6, 0.5), np.full(9, 100.0)])
    said = one_bit(y, 1.0)
    assert said[:6] == pytest.approx([0.5, 2.0, 1.0, -0.5, 0.5, 2.0])
    assert np.diff(said)[6:14] == pytest.approx(1.5 ** np.arange(8.0))
    strength, drawn, over = 0.12, [], 0
    for seed in (11, 12, 13, 14, 15):
        rig = replace(draw_case(seed, size="small"), strengths={"one_bit_link": strength})
        found, seen = prepared_rig(rig), clean_signals(rig)
        plain = clean_signals(without_causes(rig))
        least = found["1"].link_least
        # what the link reads: single bits may hang on little
        reads = {
            step.name: np.arange(found[step.name].link_begin - strength, step.duration, strength)
            for step in rig.steps
        }
        exact = clean_signals(
            without_causes(rig), {k: np.maximum(v, 0.0) for k, v in reads.items()}
        )
        drawn.append(least / strength / np.mean([step.beta for step in rig.steps]))
        for step in rig.steps:
            t, ticks = sample_times(step), reads[step.name]
            assert found[step.name].link_every == strength and -strength <= ticks[0] < 0.0
            signal = exact[step.name]
            # bit by bit, as the far end has it
            far, size, last = [signal[0]], least, True
            for reading in signal[:-1]:
                bit = bool(reading >= far[-1] - 1e-9)
                size = size * 1.5 if bit == last else max(size / 1.5, least)
                size, last = max(size, least), bit
                far.append(far[-1] + (size if bit else -size))
            before = t < step.t0
            assert np.abs(seen[step.name] - step.y0)[before].max() <= 1.5 * least * (1.0 + 1e-9)
            expected = np.interp(t, ticks, far)
            assert np.abs(expected - seen[step.name])[t < ticks[-1]].max() < 1e-3 * step.beta
            # on its way up it is behind at first, and then it goes too far
            up = (t > step.t0) & (t < step.tf)
            off = (seen[step.name] - plain[step.name])[up] / step.beta
            over += int(off.max() > 0.02 and off.argmin() < off.argmax())
            assert off.min() < -0.01
    assert over >= 10
    assert 0.019 < min(drawn) < max(drawn) < 0.101 and max(drawn) > 1.3 * min(drawn)
