"""From the light to the record: receiver, converter, clock, and what is picked up on the way."""

from __future__ import annotations

from collections.abc import Iterator
from itertools import pairwise
from math import pi, sqrt

import numpy as np

from bayes_sensor.campaign import FloatArray
from bayes_sensor.reality.causes.cause import (
    Causes,
    Rig,
    _begins,
    _between,
    _interpolated,
    _mean_step,
    _sign,
)
from bayes_sensor.reality.knobs import Course, Knobs
from bayes_sensor.reality.records import Case, Step
from bayes_sensor.reality.rig import both_sides, voltage

CAUSES = Causes()
cause = CAUSES.cause


@cause(("mains_pickup",), "line", "share of the step", 0.05, fast=True)
def mains_hum(rig: Rig, s: float, rng: np.random.Generator, case: Case) -> None:
    """The mains and its third harmonic, with a frequency that is never quite 50 or 60 Hz."""
    frequency = rng.choice([50.0, 60.0]) + 0.03 * rng.standard_normal()
    third, size = rng.uniform(0.0, 0.5), s * _mean_step(case)
    for step in case.steps:
        phases = rng.uniform(0.0, 2.0 * pi, 2)

        def hum(t: FloatArray, phases: FloatArray = phases) -> FloatArray:
            angle = 2.0 * pi * frequency * t
            sines: FloatArray = np.sin(angle + phases[0]) + third * np.sin(3.0 * angle + phases[1])
            return size * sines

        rig[step.name].offset.append(hum)


@cause((), "line", "share of the step", 0.2, fast=True)
def ringing_bench(rig: Rig, s: float, rng: np.random.Generator, case: Case) -> None:
    """The click of the valve sets the optical bench ringing."""
    frequency, damping = _between(rng, 4.0, 18.0), _between(rng, 0.3, 2.0)
    lead, size = rng.uniform(0.05, 0.3), s * _mean_step(case)
    for step in case.steps:

        def ring(t: FloatArray, t0: float = step.t0, tf: float = step.tf) -> FloatArray:
            total = np.zeros_like(t)
            for at in (t0 - lead, tf - lead):
                since = t - at
                live = since > 0
                total[live] += np.exp(-since[live] / damping) * np.sin(
                    2.0 * pi * frequency * since[live]
                )
            return size * total

        rig[step.name].offset.append(ring)


@cause((), "line", "share of the step", 0.2, fast=True)
def fluttering_hose(rig: Rig, s: float, rng: np.random.Generator, case: Case) -> None:
    """A hose flutters in the stream and shakes the fibre: faster and harder at larger flow."""
    largest = max(step.total_flow for step in case.steps)
    frequency, unsteady = _between(rng, 6.0, 35.0), _between(rng, 0.1, 1.0)
    for step in case.steps:
        flow = step.total_flow / largest
        size = s * _mean_step(case) * flow**2
        times = np.arange(0.0, step.duration + 1.0, 0.02)
        walk = np.cumsum(rng.standard_normal(len(times))) * np.sqrt(0.02 * unsteady)
        stray = _interpolated(times, walk + rng.uniform(0.0, 2.0 * pi))

        def flutter(
            t: FloatArray,
            size: float = size,
            frequency: float = flow * frequency,
            stray: Course = stray,
        ) -> FloatArray:
            return size * np.sin(2.0 * pi * frequency * t + stray(t))

        rig[step.name].offset.append(flutter)


@cause((), "line", "share of the step", 0.2, per_experiment=True, fast=True)
def starting_motor(rig: Rig, s: float, rng: np.random.Generator, case: Case) -> None:
    """A motor with an unbalance starts, runs for a while and coasts: the bench shakes along.

    Its speed passes the bench's resonance on the way up and, more slowly, on the way down; the
    bench answers as r^2 / sqrt((1 - r^2)^2 + (r/Q)^2) at r times its own frequency.
    """
    fastest, Q = _between(rng, 12.0, 35.0), _between(rng, 4.0, 15.0)
    own = fastest * rng.uniform(0.4, 0.8)  # Hz, of the bench
    up = _between(rng, 0.5, 2.5)
    down = up * rng.uniform(1.5, 3.0)
    largest = Q / sqrt(1.0 - 0.25 / Q**2)
    size, certain = s * _mean_step(case), int(rng.integers(len(case.steps)))
    for k, step in enumerate(case.steps):
        at, lasts = rng.uniform(0.05, 0.7) * step.duration, up * rng.uniform(3.0, 10.0)
        begin = rng.random()
        if k != certain and rng.random() < 0.4:
            continue

        def shaking(
            t: FloatArray, at: float = at, lasts: float = lasts, begin: float = begin
        ) -> FloatArray:
            on, off = np.clip(t - at, 0.0, lasts), np.maximum(t - at - lasts, 0.0)
            coasting = np.exp(-off / down)
            speed = -fastest * np.expm1(-on / up) * coasting
            turned = fastest * (on + up * np.expm1(-on / up))
            turned += -fastest * np.expm1(-lasts / up) * down * (1.0 - coasting)
            r2 = (speed / own) ** 2
            answer = r2 / np.sqrt((1.0 - r2) ** 2 + r2 / Q**2) / largest
            return np.asarray(size * answer * np.sin(2.0 * pi * (turned + begin)))

        rig[step.name].offset.append(shaking)


@cause((), "fall", "times too slow", 2.0)
def diode_detector(rig: Rig, s: float, rng: np.random.Generator, case: Case) -> None:
    """A diode charges the receiver's capacitor at once; it empties through a resistor only.

    The reading follows every rise, but falls no faster than the whole voltage does in the
    resistor's time, which is 1 + ``s`` times what the steepest fall would need.
    """
    steepest = 0.0  # 1/s, of the voltage's logarithm
    for step in case.steps:
        reach = 8.0 * (case.tau_v + case.V / step.total_flow)
        t = step.tf + np.linspace(0.0, reach, 2001)
        y, _ = voltage(case, step, Knobs(), t)
        steepest = max(steepest, float(np.max(-np.diff(np.log(y)) / (t[1] - t[0]))))
    for knobs in rig.values():
        knobs.detector_time = (1.0 + s) / steepest


@cause((), "fall", "s", 0.8, near=("daq_filter",))
def rms_receiver(rig: Rig, s: float, rng: np.random.Generator, case: Case) -> None:
    """The light is chopped and the receiver shows its rms: it squares, averages, takes the root.

    A rise is ahead of what the average of the voltage would show, a fall takes up to twice as long.
    """
    for knobs in rig.values():
        knobs.rms_time = s


@cause((), "fall", "s", 0.15, near=("daq_filter",))
def log_receiver(rig: Rig, s: float, rng: np.random.Generator, case: Case) -> None:
    """The receiver is a logarithmic amplifier, as quick as its photocurrent is large.

    ``s`` is by how much it lags at the campaign's highest voltage; in the dim it is many times as
    slow, and a fall never seems to end.  A current in the dark, which helps, is subtracted.
    """
    full = max(step.y0 + step.beta for step in case.steps)
    dark = float(np.mean([step.y0 for step in case.steps])) * _between(rng, 0.03, 1.0)
    for knobs in rig.values():
        knobs.log_time, knobs.log_dark = s * (full + dark), dark


@cause((), "plateau", "share", 0.4)
def zero_servo(rig: Rig, s: float, rng: np.random.Generator, case: Case) -> None:
    """A servo in the receiver takes part of any change for drift and slowly pulls it to zero."""
    time = _between(rng, 10.0, 80.0)
    for knobs in rig.values():
        knobs.servo, knobs.servo_time = s, time


@cause((), "fall", "share of the step", 0.3, near=("optical_nonlinearity",))
def overloaded_amplifier(rig: Rig, s: float, rng: np.random.Generator, case: Case) -> None:
    """The highest plateaus drive the amplifier to its rail, by ``s`` too far, and it must recover.

    What it cannot follow charges a capacitor of its loop up to a diode's voltage.  When the signal
    falls below the rail, the output stays there until that charge is gone, then jumps to where the
    signal is.  Weaker experiments never come near.
    """
    step = _mean_step(case)
    rail, time = max(p.y0 + p.beta for p in case.steps) - s * step, _between(rng, 0.1, 1.5)
    for knobs in rig.values():
        knobs.rail, knobs.rail_time, knobs.rail_charge = rail, time, s * step


@cause((), "level", "share of the step", 0.15)
def range_change(rig: Rig, s: float, rng: np.random.Generator, case: Case) -> None:
    """The recorder changes its range on the way up, and back lower down; the two do not agree."""
    step = _mean_step(case)
    up = float(np.mean([each.y0 for each in case.steps])) + rng.uniform(0.35, 0.65) * step
    down = up - rng.uniform(0.1, 0.25) * step
    gap = _sign(rng) * s * step
    for knobs in rig.values():
        knobs.range_up, knobs.range_down, knobs.range_gap = up, down, gap


def _steepest(case: Case) -> float:
    """V/s, of the rises of all experiments with nothing wrong."""
    steepest = 0.0
    for step in case.steps:
        reach = 8.0 * (case.tau_v + case.V / step.total_flow)
        t = step.t0 + np.linspace(0.0, min(reach, step.tf - step.t0), 2001)
        y, _ = voltage(case, step, Knobs(), t)
        steepest = max(steepest, float(np.abs(np.diff(y)).max() / (t[1] - t[0])))
    return steepest


@cause((), "delay", "times too slow", 2.0)
def sluggish_lock(rig: Rig, s: float, rng: np.random.Generator, case: Case) -> None:
    """The laser's lock follows the resonance no faster than its piezo moves: steep parts lag."""
    steepest = _steepest(case)
    for knobs in rig.values():
        knobs.fastest = steepest / (1.0 + s)


@cause((), "delay", "s", 0.25)
def hunting_lock(rig: Rig, s: float, rng: np.random.Generator, case: Case) -> None:
    """The loop that locks the laser to the line has too much gain: it overshoots and rings down.

    Its own oscillation has the angular frequency 1/``s`` and little damping.
    """
    damping = rng.uniform(0.1, 0.4)
    for knobs in rig.values():
        knobs.lock_time, knobs.lock_damping = s, damping


@cause((), "line", "relative", 0.1, fast=True)
def paired_converters(rig: Rig, s: float, rng: np.random.Generator, case: Case) -> None:
    """The recorder has two converters that take turns; their gains and zeros do not quite agree."""
    zero = rng.uniform(-0.5, 0.5) * s * _mean_step(case)
    sign = _sign(rng)
    for knobs in rig.values():
        knobs.pair_gain, knobs.pair_zero = sign * s, zero


@cause((), "line", "share of the step", 0.08, fast=True)
def beating_supply(rig: Rig, s: float, rng: np.random.Generator, case: Case) -> None:
    """Ripple of a switching supply, near a multiple of the sampling rate, beats with the converter.

    The beat is slow where the two agree: it passes through zero as the supply warms, and is pulled
    to another frequency while the supply feeds the valve's coil.
    """
    size, pulled = s * _mean_step(case), _sign(rng) * _between(rng, 0.2, 3.0)
    first, last = _between(rng, 2.0, 12.0), -_between(rng, 0.5, 6.0)  # Hz
    for step in case.steps:
        time, begin = step.duration * rng.uniform(0.2, 0.8), rng.random()

        def beat(
            t: FloatArray,
            on: float = step.commanded_on,
            off: float = step.commanded_off,
            time: float = time,
            begin: float = begin,
        ) -> FloatArray:
            turns = begin + last * t - (first - last) * time * np.expm1(-t / time)
            turns = turns + pulled * (np.clip(t, on, off) - on)
            return np.asarray(size * np.sin(2.0 * pi * turns))

        rig[step.name].offset.append(beat)


@cause((), "level", "of a coarse step", 0.4)
def coarse_and_fine(rig: Rig, s: float, rng: np.random.Generator, case: Case) -> None:
    """The converter measures in coarse steps, then what is left; the two scales do not match.

    The gain between its stages is off by ``s``: the error is a sawtooth over the voltage and jumps
    wherever the coarse part takes the next step.
    """
    width, sign = _mean_step(case) * _between(rng, 0.1, 0.35), _sign(rng)
    begin = width * rng.random()
    for knobs in rig.values():
        knobs.coarse_step, knobs.coarse_begin, knobs.coarse_gain = width, begin, sign * s


@cause((), "tail", "share of the step", 0.15)
def hot_output_stage(rig: Rig, s: float, rng: np.random.Generator, case: Case) -> None:
    """The amplifier's output transistor warms its input, which shifts the zero with temperature.

    What the transistor turns into heat is its current times the voltage that is left of the supply:
    most at half the supply, little at either end.  The package follows in its own time.
    """
    supply = max(step.y0 + step.beta for step in case.steps) * rng.uniform(1.05, 1.8)
    time, size = _between(rng, 1.0, 10.0), _sign(rng) * s * _mean_step(case)
    for knobs in rig.values():
        knobs.heat, knobs.heat_supply, knobs.heat_time = size, supply, time


@cause((), "line", "share of the step", 0.3, per_experiment=True, fast=True)
def neighbours_flashlamp(rig: Rig, s: float, rng: np.random.Generator, case: Case) -> None:
    """A neighbour's pulsed laser: each discharge of its flash lamp gets into the receiver.

    Even pulses, as its quartz makes them, that die out in the receiver's time; in runs, as the
    neighbour needs them.
    """
    period, time = 1.0 / _between(rng, 2.0, 12.0), _between(rng, 5e-3, 3e-2)
    size, certain = _sign(rng) * s * _mean_step(case), int(rng.integers(len(case.steps)))
    for k, step in enumerate(case.steps):
        begin = rng.uniform(0.0, 0.5) * step.duration
        shots = int(rng.uniform(0.3, 0.9) * (step.duration - begin) / period)
        if k != certain and rng.random() < 0.4:
            continue

        def pulses(t: FloatArray, begin: float = begin, shots: int = shots) -> FloatArray:
            # the last shot and, as a geometric series, what is left of those before
            last = np.clip(np.floor((t - begin) / period), 0.0, shots)
            since, left = np.maximum(t - begin - last * period, 0.0), np.exp(-period / time)
            sums = (1.0 - left ** (last + 1.0)) / (1.0 - left)
            return np.where(t >= begin, size * sums * np.exp(-since / time), 0.0)

        rig[step.name].offset.append(pulses)


@cause((), "delay", "share of the step", 0.3, near=("daq_filter",))
def averaging_meter(rig: Rig, s: float, rng: np.random.Generator, case: Case) -> None:
    """The meter shows a running average, and begins it anew when a reading is out of its window.

    So it keeps up where the signal is steep, in jumps as high as the window ``s``, and creeps along
    the last part of the way, which lies within.
    """
    window, time = s * _mean_step(case), _between(rng, 0.5, 6.0)
    for knobs in rig.values():
        knobs.average_window, knobs.average_time = window, time


@cause((), "delay", "share of the step", 0.3)
def thrifty_historian(rig: Rig, s: float, rng: np.random.Generator, case: Case) -> None:
    """The plant's historian keeps a reading only if it differs by ``s`` from the last one it kept.

    Besides it keeps one every so often; the export draws lines between.  So a step seems to begin
    with a slow rise, from the last reading kept before it, and a plateau is crossed aslant.
    """
    longest = _between(rng, 2.0, 20.0)
    for knobs in rig.values():
        knobs.kept_band, knobs.kept_longest = s * _mean_step(case), longest
        knobs.kept_begin = longest * rng.random()


@cause((), "delay", "s", 0.5)
def held_readings(rig: Rig, s: float, rng: np.random.Generator, case: Case) -> None:
    """The instrument renews its output now and then only; between, the recorder sees it stand."""
    for knobs in rig.values():
        knobs.hold, knobs.hold_begin = s, s * rng.random()


@cause((), "line", "relative", 0.2, per_experiment=True, fast=True)
def loose_contact(rig: Rig, s: float, rng: np.random.Generator, case: Case) -> None:
    """A plug is loose: now and then it crackles, and the signal breaks down for split seconds."""
    for step in case.steps:
        gaps: list[tuple[float, float]] = []
        for _ in range(int(rng.integers(1, 4))):
            at = rng.uniform(0.02, 0.9) * step.duration
            for _ in range(int(rng.integers(3, 12))):
                lasts = _between(rng, 0.03, 0.4)
                gaps.append((at, at + lasts))
                at += lasts + rng.exponential(0.4)

        def broken(
            t: FloatArray, gaps: tuple[tuple[float, float], ...] = tuple(gaps)
        ) -> FloatArray:
            open_ = np.zeros(len(t), dtype=bool)
            for begin, end in gaps:
                open_ |= (t >= begin) & (t < end)
            return -s * open_

        rig[step.name].gain.append(broken)
        rig[step.name].marks += [edge for gap in gaps for edge in gap]


@cause((), "drive", "share of the step", 0.1)
def drive_crosstalk(rig: Rig, s: float, rng: np.random.Generator, case: Case) -> None:
    """The valve's drive leaks into the signal: a step at the command and a spike at its edges."""
    spike, time = rng.uniform(0.0, 2.0), _between(rng, 0.02, 0.2)
    size = _sign(rng) * s * _mean_step(case)
    for step in case.steps:
        on, off = step.commanded_on, step.commanded_off

        def leak(t: FloatArray, on: float = on, off: float = off) -> FloatArray:
            high = ((t >= on) & (t < off)).astype(float)
            up = np.where(t >= on, np.exp(-np.maximum(t - on, 0.0) / time), 0.0)
            down = np.where(t >= off, np.exp(-np.maximum(t - off, 0.0) / time), 0.0)
            return size * (high + spike * (up - down))

        rig[step.name].offset.append(leak)
        rig[step.name].marks += [on, off]


@cause(("daq_filter",), "delay", "s", 0.08)
def anti_alias_filter(rig: Rig, s: float, rng: np.random.Generator, case: Case) -> None:
    """A four-pole filter before the converter."""
    for knobs in rig.values():
        knobs.filter_time = s


@cause((), "clock", "relative", 0.08, per_experiment=True)
def running_off_clock(rig: Rig, s: float, rng: np.random.Generator, case: Case) -> None:
    """The recorder's clock runs at another rate each time and changes it on the way."""
    for step in case.steps:
        rate, bend = rng.standard_normal(), rng.standard_normal()
        rate, bend = np.clip([rate, bend], -2.0, 2.0)

        def clock(
            t: FloatArray, rate: float = rate, bend: float = bend, length: float = step.duration
        ) -> FloatArray:
            return t + s * (rate * t + bend * t * (t / length - 1.0))

        rig[step.name].clock = clock


@cause((), "clock", "s", 1.0, per_experiment=True)
def lost_samples(rig: Rig, s: float, rng: np.random.Generator, case: Case) -> None:
    """The recorder loses a block of samples while the signal moves, and does not say so."""
    reach = 1.5 * (case.tau_v + case.V / float(np.mean([p.total_flow for p in case.steps])))
    for step in case.steps:
        gaps = []
        for switch in (step.t0, step.tf):
            if rng.random() < 0.6:
                gaps.append((switch + rng.uniform(0.1, 1.0) * reach, s * rng.uniform(0.4, 1.0)))

        def clock(t: FloatArray, gaps: tuple[tuple[float, float], ...] = tuple(gaps)) -> FloatArray:
            true = t.copy()
            for at, lasts in gaps:
                true += lasts * (true >= at)
            return true

        rig[step.name].clock = clock
        rig[step.name].marks += [edge for at, lasts in gaps for edge in (at, at + lasts)]


@cause((), "clock", "s", 0.45, per_experiment=True)
def hurried_timer(rig: Rig, s: float, rng: np.random.Generator, case: Case) -> None:
    """A busy computer reads the converter: it falls behind and catches up, but stamps evenly.

    The true time strays by up to s to either side, with knots a second apart or more, so that no
    reading overtakes the one before.
    """
    apart = _between(rng, 1.0, 2.5)
    for step in case.steps:
        times = np.arange(-apart, step.duration + 2.0 * apart, apart)
        strays = _interpolated(times, s * rng.uniform(-1.0, 1.0, len(times)))

        def clock(t: FloatArray, strays: Course = strays) -> FloatArray:
            return t + strays(t)

        rig[step.name].clock = clock


@cause((), "clock", "relative", 0.8)
def running_down_meter(rig: Rig, s: float, rng: np.random.Generator, case: Case) -> None:
    """A dual-slope converter runs freely: the further its input from its zero, the longer it takes.

    It charges a capacitor with the input and counts how long that takes to run down; the recorder
    files the readings evenly, at the rate that it finds in the baseline.  Its zero may lie anywhere
    in the lower part of the range.  ``s``: over the range of the highest step.
    """
    highest = max(step.beta for step in case.steps)
    zero = float(np.mean([step.y0 for step in case.steps])) + rng.uniform(0.0, 0.35) * highest
    for step in case.steps:
        true = np.linspace(0.0, (1.0 + s) * step.duration + 1.0, 20001)
        y, _ = voltage(case, step, Knobs(), true)
        longer = (np.abs(y - zero) - abs(step.y0 - zero)) / highest
        rate = 1.0 / (1.0 + s * longer)
        filed = np.cumsum(0.5 * (rate[1:] + rate[:-1]) * np.diff(true))
        rig[step.name].clock = _interpolated(np.append(0.0, filed), true)


def _blocks_after_switches(
    rng: np.random.Generator, case: Case, longest: float
) -> Iterator[tuple[Step, list[tuple[float, float, float]]]]:
    """Of every experiment: switch, how long a block of samples lasts, how late it comes, all in s.

    Some switches are spared, none of one experiment.
    """
    reach = case.tau_v + case.V / float(np.mean([p.total_flow for p in case.steps]))
    certain = int(rng.integers(len(case.steps)))
    for k, step in enumerate(case.steps):
        found = []
        for switch in (step.t0, step.tf):
            lasts, after = longest * rng.uniform(0.5, 1.0), rng.uniform(0.0, 1.0) * reach
            if k == certain or rng.random() < 0.6:
                found.append((switch, lasts, after))
        yield step, found


@cause((), "clock", "s", 0.8, per_experiment=True)
def repeated_buffer(rig: Rig, s: float, rng: np.random.Generator, case: Case) -> None:
    """The driver hands over a full buffer twice and overwrites the one after it unread.

    For as long as a buffer lasts the record shows again what it has just shown; then it goes on as
    if nothing had been.
    """
    for step, blocks in _blocks_after_switches(rng, case, s):
        # both buffers after the switch, so that no command is recorded twice
        again = [
            (min(switch + lasts + after, step.duration - 1.0), lasts)
            for switch, lasts, after in blocks
        ]

        def clock(
            t: FloatArray, again: tuple[tuple[float, float], ...] = tuple(again)
        ) -> FloatArray:
            true = t.copy()
            for at, lasts in again:
                true[(t >= at) & (t < at + lasts)] -= lasts
            return true

        rig[step.name].clock = clock


@cause((), "clock", "s", 0.6, per_experiment=True)
def overtaking_packets(rig: Rig, s: float, rng: np.random.Generator, case: Case) -> None:
    """The recorder sends its samples over a network, where one packet overtakes the one before.

    They are filed as they arrive, evenly: what was measured later comes first, and nothing is lost.
    """
    for step, blocks in _blocks_after_switches(rng, case, s):
        # both packets after the switch, so that no command is filed out of turn
        pairs = [
            (min(switch + after, step.duration - 2.0 * lasts), lasts)
            for switch, lasts, after in blocks
        ]

        def clock(
            t: FloatArray, pairs: tuple[tuple[float, float], ...] = tuple(pairs)
        ) -> FloatArray:
            true = t.copy()
            for at, lasts in pairs:
                true[(t >= at) & (t < at + lasts)] += lasts
                true[(t >= at + lasts) & (t < at + 2.0 * lasts)] -= lasts
            return true

        rig[step.name].clock = clock


@cause((), "delay", "s", 0.8)
def sparse_logger(rig: Rig, s: float, rng: np.random.Generator, case: Case) -> None:
    """The logger asks for a reading whenever the bus is free, and exports lines drawn between them.

    Readings are up to ``s`` apart, and right; between them bends are cut, and what happens after
    one shows before it happens.
    """
    for step, own in zip(case.steps, rng.spawn(len(case.steps)), strict=True):
        apart = s * own.uniform(0.5, 1.0, int(2.0 * step.duration / s) + 3)
        rig[step.name].readings = np.cumsum(apart) - apart[0] * (1.0 + rng.random())


@cause((), "plateau", "of the logarithm", 0.25)
def automatic_gain(rig: Rig, s: float, rng: np.random.Generator, case: Case) -> None:
    """The receiver has an automatic gain, which turns down when the level is high.

    It follows the level quickly upwards and slowly downwards, and takes the share ``s`` off its
    logarithm: a rise overshoots for a moment, and after a fall the reading is too low for long.
    """
    attack, release = _between(rng, 0.5, 4.0), _between(rng, 5.0, 30.0)
    for knobs in rig.values():
        knobs.gain_control, knobs.gain_attack, knobs.gain_release = s, attack, release


@cause((), "spike", "share of the step", 0.1)
def ghosting_multiplexer(rig: Rig, s: float, rng: np.random.Generator, case: Case) -> None:
    """The recorder's multiplexer has not settled yet when it reads: the channel before shines in.

    There a chromatograph's detector is recorded, which runs by itself: the same peaks run after
    run, Gaussian, and as wide as they are late (a column of so many plates).
    """
    run, count = _between(rng, 8.0, 40.0), int(rng.integers(3, 7))
    at, size = rng.uniform(0.1, 0.9, count) * run, s * _mean_step(case)
    width, heights = at / sqrt(_between(rng, 300.0, 3000.0)), rng.uniform(0.2, 1.0, count)
    heights /= heights.max()
    for step in case.steps:
        begin = run * rng.random()

        def chromatogram(t: FloatArray, begin: float = begin) -> FloatArray:
            total = np.zeros_like(t)
            for late, wide, height in zip(at, width, heights, strict=True):
                away = np.mod(t + begin - late + 0.5 * run, run) - 0.5 * run
                total += height * np.exp(-0.5 * (away / wide) ** 2)
            return size * total

        rig[step.name].offset.append(chromatogram)


@cause((), "line", "share of the step", 0.4, per_experiment=True, fast=True)
def calling_mobile_phone(rig: Rig, s: float, rng: np.random.Generator, case: Case) -> None:
    """A mobile phone next to the amplifier gets a call; each of its bursts is rectified there.

    Time slots of 15/26 ms in frames eight times as long (GSM): while it signals four in a row every
    51 frames, and while somebody talks one a frame, but every 26th.
    """
    frame, size, sign = 60e-3 / 13.0, s * _mean_step(case), _sign(rng)
    certain = int(rng.integers(len(case.steps)))
    for k, step in enumerate(case.steps):
        at, rings = rng.uniform(0.02, 0.9) * step.duration, int(rng.uniform(1.0, 4.0) / frame)
        talks = int(rng.uniform(1.0, 6.0) / frame) if rng.random() < 0.6 else 0
        if k != certain and rng.random() < 0.4:
            continue
        first, later = np.arange(rings), np.arange(talks)
        sent = np.concatenate([first[first % 51 < 4], rings + later[later % 26 < 25]])
        slots = at + frame * sent[sent * frame < step.duration - at]

        def bursts(t: FloatArray, slots: FloatArray = slots) -> FloatArray:
            last = np.maximum(np.searchsorted(slots, t, side="right") - 1, 0)
            since = t - slots[last]
            return np.asarray(sign * size * ((since >= 0.0) & (since < frame / 8.0)))

        rig[step.name].offset.append(bursts)
        rig[step.name].marks += both_sides(np.concatenate([slots, slots + frame / 8.0]).tolist())


@cause((), "delay", "s", 4.0, near=("daq_filter",))
def smoothing_parabola(rig: Rig, s: float, rng: np.random.Generator, case: Case) -> None:
    """The meter smooths: it shows the middle of a parabola through its readings of the last ``s``.

    (Savitzky and Golay, Anal. Chem. 36, 1627, 1964.)  Its delay of half of that is known and taken
    off, so that a step shows before it comes, first the wrong way.  The noise comes behind it.
    """
    for knobs in rig.values():
        knobs.parabola = s


@cause((), "drift", "share of the record before", 0.15, per_experiment=True)
def uncleared_screen(rig: Rig, s: float, rng: np.random.Generator, case: Case) -> None:
    """The oscilloscope averages its sweeps, and nobody clears its screen between the experiments.

    So each record holds the share ``s`` of the one before, whose valve was switched at other times.
    """
    for before, step in pairwise(case.steps):

        def ghost(t: FloatArray, before: Step = before) -> FloatArray:
            return s * voltage(case, before, Knobs(), t)[0]

        rig[step.name].gain.append(lambda t: np.full_like(t, -s))
        rig[step.name].offset.append(ghost)
        rig[step.name].marks += [before.t0, before.tf]


@cause(
    (), "line", "share of the step", 0.08, near=("mains_pickup",),
    per_experiment=True, fast=True,
)  # fmt: skip
def burst_fired_heater(rig: Rig, s: float, rng: np.random.Generator, case: Case) -> None:
    """A heating tape's controller lets through whole periods of the mains, some of every so many.

    The more heat is wanted, the more of them; the cable hums into the receiver as long as they are.
    """
    mains = float(rng.choice([50.0, 60.0]) + 0.03 * rng.standard_normal())
    every, size = int(mains * _between(rng, 0.5, 3.0)), s * _mean_step(case)
    for step in case.steps:
        heated, begin = int(every * rng.uniform(0.15, 0.7)), every * rng.random()

        def hum(t: FloatArray, heated: int = heated, begin: float = begin) -> FloatArray:
            periods = mains * t + begin
            on = np.mod(np.floor(periods), every) < heated
            return np.asarray(size * on * np.sin(2.0 * pi * periods))

        rig[step.name].offset.append(hum)


@cause((), "delay", "s", 1.2, near=("daq_filter",))
def averaged_repeats(rig: Rig, s: float, rng: np.random.Generator, case: Case) -> None:
    """What is exported is the mean of some repeats, whose records were all started by hand.

    So one and the same switch lies elsewhere in each of them, by ``s`` rms.
    """
    for step in case.steps:
        early = rng.standard_normal(int(rng.integers(3, 7)))
        early -= early.mean()
        knobs = rig[step.name]
        knobs.repeats = s * early / float(np.sqrt(np.mean(early**2)))
        knobs.marks += [at + late for at in (step.t0, step.tf) for late in knobs.repeats.tolist()]


@cause((), "level", "s", 1.5)
def blanked_ranging(rig: Rig, s: float, rng: np.random.Generator, case: Case) -> None:
    """The meter looks for its range by itself, and while its relays settle it shows nothing new.

    Its last reading stands for ``s`` where the signal leaves the lower range, and where it comes
    back into it, which is a little lower.  Both ranges are right.
    """
    step = _mean_step(case)
    up = float(np.mean([each.y0 for each in case.steps])) + rng.uniform(0.3, 0.7) * step
    down = up - rng.uniform(0.02, 0.15) * step
    for knobs in rig.values():
        knobs.blank_up, knobs.blank_down, knobs.blank_lasts = up, down, s


@cause((), "delay", "s", 1.5)
def hurried_display(rig: Rig, s: float, rng: np.random.Generator, case: Case) -> None:
    """The meter adds ``s`` times the slope, to show at once where a slow probe would end up.

    It was made for another probe; with this one a step comes too early and goes too far.  The slope
    is that behind a short lag, and the noise comes behind it.
    """
    short = rng.uniform(0.05, 0.25)
    for knobs in rig.values():
        knobs.lead, knobs.lead_lag = s, short * s


@cause((), "fall", "s", 1.0, near=("sorption_asymmetry", "valve_asymmetry"))
def swinging_pen(rig: Rig, s: float, rng: np.random.Generator, case: Case) -> None:
    """The record was read off a paper chart, as if its pen went straight; it swings about a pivot.

    The further from the middle of its arc, the later, or earlier, on the paper: at the campaign's
    largest swing by ``s``.  Where that would lead back, the eye follows the outer edge.
    """
    highest = max(step.beta for step in case.steps)
    rest = float(np.mean([step.y0 for step in case.steps])) + rng.uniform(-0.1, 0.6) * highest
    sine, sign = rng.uniform(0.3, 0.8), _sign(rng)
    levels = [level for step in case.steps for level in (step.y0, step.y0 + step.beta)]
    reach = float(np.abs(np.array(levels) - rest).max())
    for knobs in rig.values():
        knobs.pen_late, knobs.pen_rest = sign * s, rest
        knobs.pen_reach, knobs.pen_sine = reach, sine


@cause((), "delay", "s", 1.5)
def distrustful_filter(rig: Rig, s: float, rng: np.random.Generator, case: Case) -> None:
    """The driver takes a signal that is too steep for a spike, and shows the last good reading.

    When that has stood for ``s`` it believes what it reads, and is soon in doubt again: what is
    steep becomes a stair.  A weak experiment may never rouse it.
    """
    within, share = _between(rng, 0.05, 0.3), rng.uniform(0.2, 0.5)
    steepest = _steepest(case)
    for knobs in rig.values():
        knobs.distrust, knobs.distrust_within = s, within
        knobs.distrust_band = share * within * steepest


@cause((), "drift", "share of the step", 0.15, per_experiment=True)
def neighbours_magnet(rig: Rig, s: float, rng: np.random.Generator, case: Case) -> None:
    """A neighbour ramps his magnet up, keeps it there for a while and ramps it down again.

    The earthing makes a loop, in which a field induces a voltage for as long as it changes: an even
    one, and the other way round on the way down, which may be quicker.  Eddy currents in the iron
    round off its edges.
    """
    up, down, eddies = _between(rng, 2.0, 12.0), rng.uniform(0.4, 1.0), _between(rng, 0.1, 1.0)
    size, certain = _sign(rng) * s * _mean_step(case), int(rng.integers(len(case.steps)))
    for k, step in enumerate(case.steps):
        at, kept = rng.uniform(0.02, 0.7) * step.duration, _between(rng, 2.0, 20.0)
        if k != certain and rng.random() < 0.4:
            continue
        edges = at + np.array([0.0, up, up + kept, up + kept + down * up])
        rates = np.array([1.0, -1.0, -1.0 / down, 1.0 / down])

        def induced(
            t: FloatArray, edges: FloatArray = edges, rates: FloatArray = rates
        ) -> FloatArray:
            since = np.maximum(t - edges[:, None], 0.0)
            return np.asarray(size * down * (rates @ -np.expm1(-since / eddies)))

        rig[step.name].offset.append(induced)
        rig[step.name].marks += [edge for edge in edges.tolist() if edge < step.duration]


@cause((), "delay", "times too fast", 2.0)
def missed_fringes(rig: Rig, s: float, rng: np.random.Generator, case: Case) -> None:
    """An interferometer follows the line, and its counter misses the fringes that come too fast.

    Whole ones are lost, and for good: the plateau is too low, and the way down loses others.  The
    steepest rise brings 1 + ``s`` times as many in a second as the counter can count.
    """
    fringe, fastest = _mean_step(case) * _between(rng, 0.01, 0.06), _steepest(case) / (1.0 + s)
    for knobs in rig.values():
        knobs.fringe_width, knobs.countable = fringe, fastest


@cause((), "level", "share of the step", 0.8, near=("optical_nonlinearity",))
def lock_in_magnitude(rig: Rig, s: float, rng: np.random.Generator, case: Case) -> None:
    """A lock-in amplifier is set to the magnitude, and the reference leaks into its input.

    What is picked up is not in phase with the light: of the sum of both the length is read, which
    is a hyperbola over the voltage, flat or even falling in the dim and straight in the bright.
    """
    size, angle = s * _mean_step(case), pi * rng.uniform(0.4, 0.8)
    for knobs in rig.values():
        knobs.leak_along = size * float(np.cos(angle))
        knobs.leak_across = size * float(np.sin(angle))


@cause((), "plateau", "share of the step", 0.35)
def dying_battery(rig: Rig, s: float, rng: np.random.Generator, case: Case) -> None:
    """The receiver's battery runs down in the course of the campaign, at last ever faster.

    What is above its voltage is cut off, whatever the experiment is: of late ones the plateau, by
    up to ``s``, which is no longer flat but follows the battery.  Below nothing is wrong, and once
    the last of the gas has gone the battery has its rest.
    """
    size, order = s * _mean_step(case), rng.uniform(2.0, 4.0)
    fresh = max(step.y0 + step.beta for step in case.steps)
    fresh += rng.uniform(0.02, 0.1) * _mean_step(case)
    begins = _begins(case)[:-1].tolist()
    life = begins[-1] + case.steps[-1].tf
    # as far as it must fall for one of the plateaus, where it ends, to be cut off by as much
    falls = min(
        (size + fresh - step.y0 - step.beta) / ((begin + step.tf) / life) ** order
        for begin, step in zip(begins, case.steps, strict=True)
    )
    for begin, step in zip(begins, case.steps, strict=True):

        def battery(t: FloatArray, begin: float = begin) -> FloatArray:
            used = np.clip((begin + t) / life, 0.0, 1.0)
            return np.asarray(fresh - falls * used**order)

        rig[step.name].battery = battery


@cause(
    (), "level", "share of the step", 0.3, near=("optical_nonlinearity",),
)  # fmt: skip
def dead_crossover(rig: Rig, s: float, rng: np.random.Generator, case: Case) -> None:
    """The amplifier's two output transistors have lost their bias: between them neither conducts.

    There the output stands, for ``s`` of its way, as each needs its threshold first; beyond it goes
    on without a jump, in both directions alike.
    """
    step = _mean_step(case)
    at = float(np.mean([each.y0 for each in case.steps])) + rng.uniform(0.25, 0.75) * step
    for knobs in rig.values():
        knobs.crossover, knobs.crossover_at = s * step, at


@cause((), "delay", "times too fast", 3.0)
def slipping_phase_lock(rig: Rig, s: float, rng: np.random.Generator, case: Case) -> None:
    """The signal comes as a frequency, which an oscillator in a phase-locked loop is to follow.

    The loop can turn it no faster than the sine of the phase error allows: where the signal is
    ``s`` > 1 times too fast the loop falls out of lock, slips cycle by cycle, beats, and pulls in
    again (Gardner, Phaselock Techniques, 1979).  Below that it follows with an error of phase.
    """
    width, damping = _mean_step(case) * _between(rng, 0.3, 0.8), rng.uniform(0.6, 1.5)
    time = s * width / _steepest(case)
    for knobs in rig.values():
        knobs.loop_width, knobs.loop_time = width, time
        knobs.loop_beat = 0.25 * width * time / damping**2


@cause((), "delay", "s", 8.0, near=("daq_filter",))
def lossy_archive(rig: Rig, s: float, rng: np.random.Generator, case: Case) -> None:
    """The archive packs the record as cameras pack their pictures: in blocks of ``s``, as cosines.

    Of each block the first few are kept, the rest is thrown away (Ahmed, Natarajan and Rao, IEEE
    Trans. Comput. C-23, 90, 1974).  So a step rings within its block, before it, too, and where two
    blocks meet there is an edge.
    """
    kept = int(rng.integers(2, 6))
    for knobs in rig.values():
        knobs.archive, knobs.archive_kept = s, kept
        knobs.archive_begin = -s * rng.random()


@cause((), "plateau", "share let through", 0.3)
def leaking_shutter(rig: Rig, s: float, rng: np.random.Generator, case: Case) -> None:
    """The receiver shuts the light off now and then to find its zero; but its shutter leaks.

    It takes ``s`` of the light of that instant for its zero and subtracts it until the next time,
    whatever comes meanwhile: what is read on a plateau, and after it, falls at the next zero.
    """
    every = _between(rng, 4.0, 30.0)
    for step in case.steps:
        knobs = rig[step.name]
        knobs.zero_leak, knobs.zero_every = s, every
        knobs.zero_begin = -every * rng.random()
        zeros = np.arange(knobs.zero_begin + every, step.duration, every)
        knobs.marks += both_sides(zeros.tolist())


@cause((), "delay", "s", 0.3, near=("daq_filter",))
def counted_charges(rig: Rig, s: float, rng: np.random.Generator, case: Case) -> None:
    """The photocurrent fills a capacitor, is let out when that is full, and its time is read.

    What is shown is the mean of the last filling, until the next one is complete: ``s`` at the mean
    step, and many times as long in the faint light of a baseline.
    """
    charge = s * _mean_step(case)
    for knobs in rig.values():
        knobs.charge, knobs.charge_begin = charge, rng.random()


@cause((), "plateau", "share of the light", 0.35)
def drooping_clamp(rig: Rig, s: float, rng: np.random.Generator, case: Case) -> None:
    """The receiver is coupled by a capacitor, and a clamp sets it right again now and then.

    Between two clamps, each in a moment's darkness, the capacitor charges itself up to what stands
    before it, and the reading droops: by the share ``s`` of a light that stays.  The next clamp
    empties it, and the reading leaps back to where it belongs.
    """
    every = _between(rng, 1.5, 12.0)
    time = -every / float(np.log1p(-s))
    for step in case.steps:
        knobs = rig[step.name]
        knobs.clamp_time, knobs.clamp_every = time, every
        knobs.clamp_begin = -every * rng.random()
        clamps = np.arange(knobs.clamp_begin, step.duration, every)
        knobs.marks += both_sides(clamps.tolist())


@cause((), "plateau", "share of the step", 0.4)
def climbing_baseline(rig: Rig, s: float, rng: np.random.Generator, case: Case) -> None:
    """The software subtracts a baseline of its own, which follows a signal down, but hardly up.

    As for a chromatogram, whose peaks are short: it climbs evenly wherever the signal is above, by
    ``s`` while the typical gas flows.  So a plateau sinks, and a fall ends where it meets the
    baseline, before it should; from there on all is as if nothing had been.
    """
    typical = float(np.median([step.tf - step.t0 for step in case.steps]))
    for knobs in rig.values():
        knobs.floor_climbs = s * _mean_step(case) / typical


@cause((), "level", "share of the step", 0.35)
def missing_bit(rig: Rig, s: float, rng: np.random.Generator, case: Case) -> None:
    """A wire of the bus between converter and recorder is broken: one of its bits is always zero.

    Wherever it should be set the reading is too low by its worth, ``s``: that climbs, leaps back,
    and climbs over the same levels once more.
    """
    weight = s * _mean_step(case)
    zero = weight * rng.uniform(-2.0, 0.0)
    for knobs in rig.values():
        knobs.bit, knobs.bit_zero = weight, zero


@cause((), "spike", "share of the step", 0.6, per_experiment=True)
def static_discharge(rig: Rig, s: float, rng: np.random.Generator, case: Case) -> None:
    """Somebody's pullover discharges itself into a cable, whose insulation keeps charge for long.

    That is given back by dipoles of every pace: as a power of the time since (Curie and von
    Schweidler), at first ``s``, either way.  There are some such shocks in a campaign, at any time.
    """
    power, begins = rng.uniform(0.5, 1.0), _begins(case)
    first, size = _between(rng, 0.2, 2.0), s * _mean_step(case)
    n = len(case.steps) // 2 + 1
    shocks = begins[-1] * (np.arange(n) + rng.uniform(0.05, 0.95, n)) / n
    signs = np.where(rng.random(n) < 0.5, size, -size)
    for begin, step in zip(begins.tolist(), case.steps, strict=False):

        def charge(t: FloatArray, begin: float = begin) -> FloatArray:
            since = begin + t - shocks[:, None]
            back = (1.0 + np.maximum(since, 0.0) / first) ** -power
            return np.asarray(signs @ np.where(since < 0.0, 0.0, back))

        if shocks[0] < begin + step.duration:
            rig[step.name].offset.append(charge)
            inside = [at - begin for at in shocks if 0 < at - begin < step.duration]
            rig[step.name].marks += both_sides(inside)


@cause((), "plateau", "share of the waves", 0.4, near=("baseline_drift",))
def flattened_record(rig: Rig, s: float, rng: np.random.Generator, case: Case) -> None:
    """The software takes drift for what is slowest in a record, and filters that out of it.

    By Fourier's series of all of it: of its first few waves, a whole number in the record, only
    1 - ``s`` is left, before the gas as well as after it.
    """
    waves = int(rng.integers(1, 5))
    for knobs in rig.values():
        knobs.flattened, knobs.flattened_waves = s, waves


@cause((), "line", "share of the step", 0.3, fast=True)
def whining_converter(rig: Rig, s: float, rng: np.random.Generator, case: Case) -> None:
    """The converter counts how often its input is above a threshold, and what is left over whines.

    The further the input is from a simple fraction of the range, the higher is that idle tone
    (Candy and Benjamin, IEEE Trans. Commun. 29, 1316, 1981): it glides with the signal.
    """
    size, pitch = _mean_step(case), _between(rng, 3.0, 40.0)
    zero = float(np.mean([step.y0 for step in case.steps])) + rng.uniform(-0.4, 1.2) * size
    for knobs in rig.values():
        knobs.whine, knobs.whine_rate = s * size, pitch / size
        knobs.whine_zero, knobs.whine_begin = zero, rng.random()


@cause((), "delay", "s a bit", 0.2, reserve=True)
def one_bit_link(rig: Rig, s: float, rng: np.random.Generator, case: Case) -> None:
    """The reading comes over a link that says only whether it is higher than what was said before.

    The far end goes up or down by a step, which grows as long as the bits are the same, and shrinks
    when they are not (Jayant, Bell Syst. Tech. J. 49, 321, 1970): a steep signal gets away at
    first, is overtaken, and is found again to and fro.  A bit takes ``s``; at rest the smallest
    steps go up and down.
    """
    least = _between(rng, 0.02, 0.1) * _mean_step(case) * s
    for knobs in rig.values():
        knobs.link_every, knobs.link_begin, knobs.link_least = s, s * rng.random(), least
