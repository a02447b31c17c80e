"""Ring, fibre and laser: what is read of the resonance, and what else moves it or the light."""

from __future__ import annotations

from math import pi

import numpy as np
from scipy.signal import lfilter
from scipy.special import erfc

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
from bayes_sensor.reality.records import Case
from bayes_sensor.reality.rig import both_sides, voltage

CAUSES = Causes()
cause = CAUSES.cause


@cause(("optical_nonlinearity",), "fall", "half-widths", 0.5)
def lorentzian_flank(rig: Rig, s: float, rng: np.random.Generator, case: Case) -> None:
    """The dip moves past the laser: the whole Lorentzian, not its tangent, is read."""
    detuning = rng.choice([rng.uniform(-2.0, -1.2), rng.uniform(0.15, 0.3)])
    for knobs in rig.values():
        knobs.shift, knobs.detuning = s, float(detuning)


def _times(size: float, shape: Course) -> Course:
    """``size`` times ``shape``."""
    return lambda t: size * shape(t)


def _soft_step(at: float, width: float) -> Course:
    """0 before, 1 after ``at`` (s)."""
    return lambda t: np.asarray(0.5 * (1.0 + np.tanh((t - at) / width)))


def _window(begin: float, end: float) -> Course:
    """1 between ``begin`` and ``end`` (s), else 0."""
    return lambda t: ((t >= begin) & (t < end)).astype(float)


def _thermal(rng: np.random.Generator, duration: float) -> Course:
    """A drift of unit size: warming up, or half a swing of the room's temperature."""
    if rng.random() < 0.6:
        time = rng.uniform(0.3, 2.0) * duration
        return lambda t: (
            (1.0 - np.exp(-np.maximum(t, 0.0) / time)) / (1.0 - np.exp(-duration / time))
        )
    period, phase = rng.uniform(1.2, 3.0) * duration, rng.uniform(0.0, 2.0 * pi)
    return lambda t: np.sin(2.0 * pi * t / period + phase) - np.sin(phase)


@cause(("baseline_drift",), "drift", "share of the step", 0.1, per_experiment=True)
def thermal_drift(rig: Rig, s: float, rng: np.random.Generator, case: Case) -> None:
    """The resonance drifts with the room's temperature."""
    size, shared = s * _mean_step(case), rng.standard_normal()
    for step in case.steps:
        own = size * float(0.7 * shared + rng.standard_normal())
        shape = _thermal(rng, step.duration)
        rig[step.name].offset.append(_times(own, shape))


@cause(("baseline_step",), "drift", "share of the step", 0.1, per_experiment=True)
def knocked_fibre(rig: Rig, s: float, rng: np.random.Generator, case: Case) -> None:
    """The alignment moves once and stays: at the end of the pulse, or at a time of its own."""
    size, after_pulse = s * _mean_step(case), rng.random() < 0.6
    width, sign = _between(rng, 0.05, 1.0), _sign(rng)
    when = rng.uniform(0.1, 0.9)
    for step in case.steps:
        own = sign * size * rng.uniform(0.5, 1.5)
        at = step.tf + 2.0 * width if after_pulse else when * step.duration
        rig[step.name].offset.append(_times(own, _soft_step(at, width)))
        rig[step.name].marks.append(float(at))


@cause(("gain_drift",), "drift", "relative", 0.1, per_experiment=True)
def fading_laser(rig: Rig, s: float, rng: np.random.Generator, case: Case) -> None:
    """The optical power, and with it the whole voltage, fades or recovers."""
    shared = rng.standard_normal()
    for step in case.steps:
        own = s * float(0.8 * shared + 0.6 * rng.standard_normal())
        shape = _thermal(rng, step.duration)
        rig[step.name].gain.append(_times(own, shape))


@cause((), "drift", "half-widths", 0.08, per_experiment=True)
def wandering_laser(rig: Rig, s: float, rng: np.random.Generator, case: Case) -> None:
    """The wavelength walks at random; how much voltage that makes depends on the flank."""
    for step in case.steps:
        times = np.arange(0.0, step.duration + 1.0, 0.5)
        walk = np.cumsum(rng.standard_normal(len(times))) * np.sqrt(0.5 / step.duration)
        rig[step.name].wander.append(_interpolated(times, s * walk))


@cause((), "drift", "relative", 0.1, per_experiment=True)
def mode_hop(rig: Rig, s: float, rng: np.random.Generator, case: Case) -> None:
    """The laser hops to another mode and back: its power differs for a while."""
    for step in case.steps:
        if rng.random() < 0.3:
            continue
        begin = rng.uniform(step.t0, step.tf - 3.0)
        lasts = _between(rng, 1.0, 10.0)
        size = s * _sign(rng)
        rig[step.name].gain.append(_times(size, _window(begin, begin + lasts)))
        rig[step.name].marks += [begin, begin + lasts]


@cause((), "tail", "share of the step", 0.15)
def gas_cooling(rig: Rig, s: float, rng: np.random.Generator, case: Case) -> None:
    """Expanding gas cools the ring after every switch; the dip moves and comes back."""
    fast, slow = _between(rng, 0.4, 1.5), _between(rng, 2.5, 8.0)
    sign, same = _sign(rng), rng.choice([1.0, -1.0])
    largest = max(step.test_gas_flow for step in case.steps)
    for step in case.steps:
        size = sign * s * abs(step.beta) * step.test_gas_flow / largest

        def swing(
            t: FloatArray, t0: float = step.t0, tf: float = step.tf, size: float = size
        ) -> FloatArray:
            total = np.zeros_like(t)
            for at, weight in ((t0, 1.0), (tf, same)):
                since = np.maximum(t - at, 0.0)
                total += weight * (np.exp(-since / slow) - np.exp(-since / fast))
            return size * total

        rig[step.name].offset.append(swing)


@cause((), "spike", "share of the step", 0.2)
def pressure_spike(rig: Rig, s: float, rng: np.random.Generator, case: Case) -> None:
    """A pressure wave runs ahead of the gas and presses on the ring before it arrives."""
    width, lead = _between(rng, 0.05, 0.4), rng.uniform(0.1, 0.5)
    sign = _sign(rng)
    for step in case.steps:
        size = sign * s * abs(step.beta)

        def spike(
            t: FloatArray, t0: float = step.t0, tf: float = step.tf, size: float = size
        ) -> FloatArray:
            first = np.exp(-0.5 * ((t - t0 + lead) / width) ** 2)
            return size * (first - 0.7 * np.exp(-0.5 * ((t - tf + lead) / width) ** 2))

        rig[step.name].offset.append(spike)
        rig[step.name].marks += [step.t0 - lead - 3.0 * width, step.tf - lead - 3.0 * width]


@cause((), "spike", "share of the step", 0.3, per_experiment=True)
def passing_bubble(rig: Rig, s: float, rng: np.random.Generator, case: Case) -> None:
    """Droplets pass the ring now and then: the signal dips and recovers."""
    for step in case.steps:
        for _ in range(int(rng.integers(1, 4))):
            at, lasts = rng.uniform(0.05, 0.95) * step.duration, _between(rng, 0.3, 3.0)
            size = -s * abs(step.beta) * rng.uniform(0.4, 1.0)

            def dip_of(
                t: FloatArray, at: float = at, lasts: float = lasts, size: float = size
            ) -> FloatArray:
                since = np.maximum(t - at, 0.0) / lasts
                return size * since * np.exp(1.0 - since)

            rig[step.name].offset.append(dip_of)
            rig[step.name].marks.append(at)


@cause((), "drift", "share of the step", 0.1, per_experiment=True)
def stray_light(rig: Rig, s: float, rng: np.random.Generator, case: Case) -> None:
    """Stray light interferes; its phase turns as the bench warms and as the test gas comes."""
    size, turns = s * _mean_step(case), _sign(rng) * rng.uniform(1.0, 3.0)
    in_a_record = rng.uniform(1.5, 5.0)
    for step in case.steps:
        begin, rate = rng.random(), in_a_record * rng.uniform(0.7, 1.3) / step.duration

        def phase(t: FloatArray, begin: float = begin, rate: float = rate) -> FloatArray:
            return begin + rate * t

        knobs = rig[step.name]
        knobs.fringe, knobs.fringe_phase = size, phase
        knobs.fringe_turns = turns * case.relative_concentration(step)


@cause((), "drift", "share of the step", 0.06)
def thermostat_swings(rig: Rig, s: float, rng: np.random.Generator, case: Case) -> None:
    """A thermostat heats and rests by turns; the resonance follows the temperature up and down."""
    size = _sign(rng) * s * _mean_step(case)
    period, hot, bend = _between(rng, 3.0, 20.0), rng.uniform(0.15, 0.6), rng.uniform(0.5, 2.0)

    def settled(share: FloatArray) -> FloatArray:
        """0 to 1 as ``share`` of a heating or of a rest passes."""
        return np.asarray(np.expm1(-bend * share) / np.expm1(-bend))

    for step in case.steps:
        begin = rng.random()

        def swing(t: FloatArray, begin: float = begin) -> FloatArray:
            turn = np.mod(t / period + begin, 1.0)
            rest = 1.0 - settled((turn - hot) / (1.0 - hot))
            return size * (2.0 * np.where(turn < hot, settled(turn / hot), rest) - 1.0)

        rig[step.name].offset.append(swing)


@cause((), "spike", "half-widths", 0.15, per_experiment=True)
def relocking_laser(rig: Rig, s: float, rng: np.random.Generator, case: Case) -> None:
    """The laser's lock lets go: it is swept off the flank to find the line, and comes back.

    The sweep is a triangle in wavelength; on the flank's bend it is none in voltage.
    """
    for step in case.steps:
        for _ in range(int(rng.integers(1, 4))):
            at, lasts = rng.uniform(0.05, 0.95) * step.duration, _between(rng, 0.3, 3.0)
            size = _sign(rng) * s * rng.uniform(0.5, 1.0)

            def sweep(
                t: FloatArray, at: float = at, lasts: float = lasts, size: float = size
            ) -> FloatArray:
                return size * (1.0 - np.abs(2.0 * np.clip((t - at) / lasts, 0.0, 1.0) - 1.0))

            rig[step.name].wander.append(sweep)
            rig[step.name].marks += [at, at + 0.5 * lasts, at + lasts]


@cause((), "drift", "share of the step", 0.1, near=("baseline_drift",))
def warm_driver(rig: Rig, s: float, rng: np.random.Generator, case: Case) -> None:
    """The valve's driver warms while it drives; through the bench its heat reaches the ring late.

    Two lags in a row: the transistor's, and that of the metal between; silicon rings move by some
    70 pm/K (Bogaerts et al., Laser Photonics Rev. 6, 47, 2012).
    """
    driver, bench = _between(rng, 4.0, 20.0), _between(rng, 0.5, 3.0)

    def warmth(since: FloatArray | float) -> FloatArray:
        """How far the ring is warmed ``since`` (s) after the driver was switched on."""
        on = np.maximum(since, 0.0)
        return np.asarray(
            1.0 - (driver * np.exp(-on / driver) - bench * np.exp(-on / bench)) / (driver - bench)
        )

    warmest = float(warmth(max(step.commanded_off - step.commanded_on for step in case.steps)))
    size = _sign(rng) * s * _mean_step(case) / warmest
    for step in case.steps:

        def drift(
            t: FloatArray, on: float = step.commanded_on, off: float = step.commanded_off
        ) -> FloatArray:
            return size * (warmth(t - on) - warmth(t - off))

        rig[step.name].offset.append(drift)


@cause((), "level", "half-widths", 0.5, near=("optical_nonlinearity",))
def self_heating_ring(rig: Rig, s: float, rng: np.random.Generator, case: Case) -> None:
    """Light that the ring absorbs warms its chip and moves the line: more light, or less, gets in.

    The feedback of Carmon, Yang and Vahala (Opt. Express 12, 4742, 2004), below the strength from
    which it would be bistable; the chip's own time makes it lag.  ``s`` would be its shift with the
    laser on the line's centre.
    """
    sign, time = _sign(rng), _between(rng, 0.4, 5.0)
    for knobs in rig.values():
        knobs.warming, knobs.warming_time = sign * s, time


@cause((), "spike", "relative", 0.15)
def jolted_fibre(rig: Rig, s: float, rng: np.random.Generator, case: Case) -> None:
    """The valve's click jolts the fibre out of its best place; its soft glue creeps back.

    Less light comes in from the click on, before any gas.  Glue has no single time: what is left
    falls as a power of time.  The coil and the spring do not click alike.
    """
    time, power = _between(rng, 0.2, 3.0), rng.uniform(0.5, 1.5)
    other = _between(rng, 0.5, 1.0)
    sizes = (s, other * s) if rng.random() < 0.5 else (other * s, s)
    for step in case.steps:
        clicks = tuple(zip((step.commanded_on, step.commanded_off), sizes, strict=True))

        def lost(t: FloatArray, clicks: tuple[tuple[float, float], ...] = clicks) -> FloatArray:
            total = np.zeros_like(t)
            for at, size in clicks:
                back = (1.0 + np.maximum(t - at, 0.0) / time) ** -power
                total -= np.where(t >= at, size * back, 0.0)
            return total

        rig[step.name].gain.append(lost)
        rig[step.name].marks += [edge for at, _ in clicks for edge in (at - 1e-6, at)]


@cause((), "level", "share of the step", 0.25, near=("optical_nonlinearity",))
def second_mode(rig: Rig, s: float, rng: np.random.Generator, case: Case) -> None:
    """The ring carries a second mode, and its line crosses the laser's wavelength on the way.

    There it takes light away, on the way up and on the way down, always at the same concentration;
    experiments that do not come so far never see it.
    """
    at, width = rng.uniform(0.15, 0.6), _between(rng, 0.03, 0.12)
    for knobs in rig.values():
        knobs.mode_depth, knobs.mode_at, knobs.mode_width = s * _mean_step(case), at, width


@cause((), "plateau", "share of the response", 0.4)
def leaking_reference(rig: Rig, s: float, rng: np.random.Generator, case: Case) -> None:
    """A second ring under a polymer cap is subtracted, and the gas gets through the cap.

    By diffusion across a slab: nothing at first, then the reading sinks, and when the gas has gone
    it is too low until the cap is empty.
    """
    time = _between(rng, 8.0, 80.0)
    for knobs in rig.values():
        knobs.reference, knobs.reference_time = s, time


@cause((), "ripple", "share of the step", 0.2, fast=True)
def pulsing_ring(rig: Rig, s: float, rng: np.random.Generator, case: Case) -> None:
    """Light warms the ring's core and its polymer coating, which move the line opposite ways.

    The coating is the slower one, and where the line lies right for the laser the two chase each
    other without end (He, Xiao, Zhu, Ozdemir and Yang, Opt. Express 17, 9571, 2009): within a range
    of concentrations the reading pulses, with an amplitude that is the root of the way in.
    """
    at, width = rng.uniform(0.35, 0.75), rng.uniform(0.12, 0.3)
    rate, pull, second = _between(rng, 1.5, 8.0), rng.uniform(-0.4, 0.4), rng.uniform(0.0, 0.4)
    for knobs in rig.values():
        knobs.pulsing, knobs.pulsing_at, knobs.pulsing_width = s * _mean_step(case), at, width
        knobs.pulsing_rate, knobs.pulsing_pull, knobs.pulsing_second = rate, pull, second
        knobs.pulsing_begin = rng.random()


@cause((), "drift", "relative", 0.15, per_experiment=True)
def passing_lift(rig: Rig, s: float, rng: np.random.Generator, case: Case) -> None:
    """The building's lift passes: its iron pulls at the isolator's magnet, and less light comes.

    The field of a dipole at a distance, less that where it stood at first; the lift starts and
    stops softly, and may stop right here.  Every ride leads to this floor or past it.
    """
    aside, certain = _between(rng, 2.0, 6.0), int(rng.integers(len(case.steps)))
    for k, step in enumerate(case.steps):
        at, floor = rng.uniform(0.05, 0.6) * step.duration, int(rng.choice([-3, -2, -1, 1, 2, 3]))
        rides: list[tuple[float, float, float, float]] = []
        for _ in range(int(rng.integers(1, 4))):
            above = floor < 0 if floor != 0 else rng.random() < 0.5
            to = int(rng.integers(1 if floor == 0 else 0, 4)) * (1 if above else -1)
            metres = 3.5 * abs(to - floor)
            lasts = 1.5 + metres / rng.uniform(1.0, 2.5)
            rides.append((at, lasts, 3.5 * floor, 3.5 * to))
            at, floor = at + lasts + _between(rng, 1.0, 15.0), to
        if k != certain and rng.random() < 0.4:
            continue

        def lost(
            t: FloatArray, rides: tuple[tuple[float, float, float, float], ...] = tuple(rides)
        ) -> FloatArray:
            height = np.full_like(t, rides[0][2])
            for at, lasts, low, high in rides:
                done = np.clip((t - at) / lasts, 0.0, 1.0)
                height += (high - low) * done**2 * (3.0 - 2.0 * done)
            field = (1.0 + (height / aside) ** 2) ** -1.5
            return np.asarray(s * ((1.0 + (rides[0][2] / aside) ** 2) ** -1.5 - field))

        rig[step.name].gain.append(lost)


@cause((), "spike", "relative", 0.15, per_experiment=True)
def leaning_visitor(rig: Rig, s: float, rng: np.random.Generator, case: Case) -> None:
    """A visitor leans on the floating table, and later lets go: it tilts, then the other way.

    Its valves let air in or out at an even rate until it is level again.  Of the light, a Gaussian
    beam before a fibre, the share 1 - (1 - ``s``)^(tilt^2) is lost.
    """
    levelling, certain = _between(rng, 1.0, 8.0), int(rng.integers(len(case.steps)))
    for k, step in enumerate(case.steps):
        at = rng.uniform(0.02, 0.7) * step.duration
        pushes = []
        for _ in range(int(rng.integers(1, 3))):
            weight, stays = _sign(rng) * rng.uniform(0.5, 1.0), _between(rng, 1.0, 15.0)
            pushes += [(at, weight), (at + stays, -weight)]
            at += stays + _between(rng, 3.0, 20.0)
        if k != certain and rng.random() < 0.4:
            continue
        times, tilts = [0.0], [0.0]
        for at, weight in pushes:
            left = max(abs(tilts[-1]) - (at - times[-1]) / levelling, 0.0)
            tilts.append(float(np.copysign(left, tilts[-1])) + weight)
            times.append(at)

        def lost(
            t: FloatArray,
            times: tuple[float, ...] = tuple(times),
            tilts: tuple[float, ...] = tuple(tilts),
        ) -> FloatArray:
            i = np.maximum(np.searchsorted(times, t, side="right") - 1, 0)
            left = np.abs(np.take(tilts, i)) - np.maximum(t - np.take(times, i), 0.0) / levelling
            return np.asarray(np.expm1(np.log1p(-s) * np.maximum(left, 0.0) ** 2))

        rig[step.name].gain.append(lost)
        inside = [at for at in times[1:] if at < step.duration]
        rig[step.name].marks += [edge for at in inside for edge in (at - 1e-6, at)]


@cause((), "level", "share of the step", 0.2, fast=True)
def undecided_laser(rig: Rig, s: float, rng: np.random.Generator, case: Case) -> None:
    """Light that the ring sends back decides between two modes of the laser, of unequal power.

    How much it is goes with the response: far below the border it is one mode, far above the other,
    and about it chance decides, again and again.
    """
    at, width = rng.uniform(0.3, 0.8), _between(rng, 0.03, 0.12)
    gap, lasting = _sign(rng) * s * _mean_step(case), _between(rng, 0.1, 1.0)
    for step in case.steps:
        knobs, decisions = rig[step.name], [0.0]
        while decisions[-1] < step.duration:
            decisions.append(decisions[-1] + float(rng.exponential(lasting)))
        knobs.border_gap, knobs.decisions = gap, np.array(decisions)
        knobs.borders = at + width * rng.logistic(size=len(decisions))


@cause((), "tail", "share a decade of time", 0.1)
def creeping_piezo(rig: Rig, s: float, rng: np.random.Generator, case: Case) -> None:
    """A piezo tunes the laser after the line, and its voltage is what is read; but a piezo creeps.

    It goes on in the direction it was sent in, by the share ``s`` of the way in each tenfold of
    time, and the lock takes the voltage back: after a rise the reading sinks as the logarithm of
    time, after a fall it comes up again from too low (Jung and Gweon, Rev. Sci. Instrum. 71, 1896,
    2000).
    """
    first = _between(rng, 0.05, 0.5)
    for knobs in rig.values():
        knobs.creep, knobs.creep_first = s, first


@cause((), "drift", "share of the step", 0.15, per_experiment=True)
def touching_hand(rig: Rig, s: float, rng: np.random.Generator, case: Case) -> None:
    """Somebody holds on to the cell for a while, and the warmth of the hand creeps to the ring.

    Of a wall whose surface is warm it reaches the depth d as erfc(sqrt(d^2/4Dt)): nothing at first,
    and long after the hand is gone still some, which dies away as a power of time.
    """
    depth, size = _between(rng, 0.1, 2.0), _sign(rng) * s * _mean_step(case)  # d^2/4D in s
    certain = int(rng.integers(len(case.steps)))
    for k, step in enumerate(case.steps):
        at, touches = rng.uniform(0.02, 0.6) * step.duration, []
        for _ in range(int(rng.integers(1, 4))):
            lasts = _between(rng, 1.0, 8.0)
            touches.append((at, at + lasts, rng.uniform(0.5, 1.0)))
            at += lasts + _between(rng, 2.0, 15.0)
        if k != certain and rng.random() < 0.4:
            continue

        def warmth(
            t: FloatArray, touches: tuple[tuple[float, float, float], ...] = tuple(touches)
        ) -> FloatArray:
            total = np.zeros_like(t)
            for on, off, warm in touches:
                for edge, sign in ((on, 1.0), (off, -1.0)):
                    since = np.maximum(t - edge, 1e-3 * depth)  # nothing has come so early
                    total += sign * warm * erfc(np.sqrt(depth / since))
            return size * total

        rig[step.name].offset.append(warmth)
        edges = [edge for on, off, _ in touches for edge in (on, off)]
        rig[step.name].marks += [edge for edge in edges if edge < step.duration]


@cause((), "line", "share of the step", 0.3, per_experiment=True, fast=True)
def passing_footsteps(rig: Rig, s: float, rng: np.random.Generator, case: Case) -> None:
    """Somebody walks past the bench: at every step the floor quivers, and the fibre with it.

    Steps follow each other almost evenly, one foot the harder; each sets off a few damped swings of
    the floor, the stronger the nearer it falls.  He may come back.
    """
    pace, aside, other = 1.0 / _between(rng, 1.5, 2.3), _between(rng, 1.0, 3.0), rng.uniform(0.4, 1)
    frequency, damping = _between(rng, 6.0, 25.0), _between(rng, 0.04, 0.2)
    size, certain = s * _mean_step(case), int(rng.integers(len(case.steps)))
    for k, step in enumerate(case.steps):
        steps: list[tuple[float, float]] = []
        for _ in range(int(rng.integers(1, 3))):
            nearest, beside = rng.uniform(0.05, 0.95) * step.duration, rng.uniform(-0.5, 0.5)
            for number in range(-20, 21):
                away = 0.75 * (number + beside)  # m along his way
                foot = 1.0 if number % 2 == 0 else other
                at = nearest + pace * (number + beside + 0.04 * rng.uniform(-1.0, 1.0))
                steps.append((at, foot / (1.0 + (away / aside) ** 2)))
        if k != certain and rng.random() < 0.4:
            continue

        def quiver(
            t: FloatArray, steps: tuple[tuple[float, float], ...] = tuple(steps)
        ) -> FloatArray:
            total = np.zeros_like(t)
            for at, strong in steps:
                live = (t > at) & (t < at + 20.0 * damping)
                since = t[live] - at
                swings = np.sin(2.0 * pi * frequency * since)
                total[live] += strong * np.exp(-since / damping) * swings
            return size * total

        rig[step.name].offset.append(quiver)


@cause((), "level", "share of the highest shift", 0.3)
def dead_pixels(rig: Rig, s: float, rng: np.random.Generator, case: Case) -> None:
    """A spectrometer's camera follows the line, and a row of its pixels is dead.

    While the line lies on them the peak finder keeps what it found last: the reading stands still,
    then jumps to where the line comes out, on the way up from below and on the way down from above.
    """
    at = rng.uniform(0.1, 0.6)
    for knobs in rig.values():
        knobs.dead_from, knobs.dead_width = at, s


@cause(
    (), "drift", "share of the step", 0.15, near=("baseline_step", "mains_pickup"),
    per_experiment=True, fast=True,
)  # fmt: skip
def flickering_tube_lamp(rig: Rig, s: float, rng: np.random.Generator, case: Case) -> None:
    """Somebody turns on the room's tube lamp, which flashes some times until it burns.

    Its light gets into the photodiode: at first part of it, more as the mercury evaporates, and
    with twice the frequency of the mains.  It is off again when the next record begins.
    """
    certain, mains = int(rng.integers(len(case.steps))), float(rng.choice([50.0, 60.0]))
    size, ripple = s * _mean_step(case), rng.uniform(0.15, 0.4)
    cold, time = rng.uniform(0.3, 0.6), _between(rng, 5.0, 30.0)
    for k, step in enumerate(case.steps):
        at, begin = rng.uniform(0.05, 0.8) * step.duration, rng.random()
        count = int(rng.integers(2, 8))
        flashes = at + np.cumsum(rng.uniform(0.4, 1.3, count + 1)) - 0.4
        lasts = rng.uniform(0.05, 0.25, count)
        if k != certain and rng.random() < 0.4:
            continue

        def light(
            t: FloatArray,
            begin: float = begin,
            flashes: FloatArray = flashes,
            lasts: FloatArray = lasts,
        ) -> FloatArray:
            burning = 1.0 - cold * np.exp(-np.maximum(t - flashes[-1], 0.0) / time)
            bright = np.where(t >= flashes[-1], burning, 0.0)
            for on, long in zip(flashes[:-1], lasts, strict=True):
                bright = np.where((t >= on) & (t < on + long), 1.0 - cold, bright)
            return size * bright * (1.0 + ripple * np.cos(2.0 * pi * (2.0 * mains * t + begin)))

        rig[step.name].offset.append(light)
        edges = np.concatenate([flashes, flashes[:-1] + lasts])
        rig[step.name].marks += both_sides(edges[edges < step.duration].tolist())


@cause((), "level", "of half the window", 0.8, near=("optical_nonlinearity",))
def fixed_window(rig: Rig, s: float, rng: np.random.Generator, case: Case) -> None:
    """A spectrometer takes the line's centre of mass within a window that does not move along.

    The nearer the line is to the window's edge, the more of its wing is cut off and the less the
    centre of mass moves.  ``s`` is how far the highest concentration shifts the line.
    """
    window, begin = _between(rng, 3.0, 10.0), rng.uniform(-0.3, 0.15)
    for knobs in rig.values():
        knobs.window, knobs.window_begin = window, begin * window
        knobs.window_shift = s * window


@cause((), "drift", "contrast", 0.3, near=("gain_drift",), per_experiment=True)
def birefringent_fibre(rig: Rig, s: float, rng: np.random.Generator, case: Case) -> None:
    """The fibre carries both polarisations at unequal speeds; the chip takes only one of its own.

    As the fibre warms evenly, their phase turns, and the light that gets in goes up and down as
    1 + ``s`` cos(phase): a fibre between polarisers.
    """
    for step in case.steps:
        turns = _sign(rng) * _between(rng, 0.3, 3.0) / step.duration
        begin = rng.random()

        def light(t: FloatArray, turns: float = turns, begin: float = begin) -> FloatArray:
            first = 1.0 + s * np.cos(2.0 * pi * begin)
            return np.asarray((1.0 + s * np.cos(2.0 * pi * (begin + turns * t))) / first - 1.0)

        rig[step.name].gain.append(light)


@cause((), "fall", "share lost", 0.7)
def bent_beam(rig: Rig, s: float, rng: np.random.Generator, case: Case) -> None:
    """The light crosses the cell on its way to the chip; fresh gas beside old gas bends it.

    As the air over a hot road does: it goes off as far as the inlet's gas differs from what is in
    the cell, and of a Gaussian beam before a fibre 1 - (1 - ``s``)^(difference^2) is lost, a whole
    one that of the highest concentration.  Once the gas is mixed nobody notices.
    """
    for knobs in rig.values():
        knobs.bending = s


@cause((), "line", "relative", 0.1, fast=True)
def uneven_chopper(rig: Rig, s: float, rng: np.random.Generator, case: Case) -> None:
    """The light is chopped, and the wheel's openings are not of one width: each lets through more.

    Of all the light, not of the step: the reading goes up and down with the wheel's turns, whose
    motor never keeps quite one speed.
    """
    openings, turns = int(rng.integers(3, 9)), _between(rng, 2.0, 12.0)
    width = rng.uniform(-1.0, 1.0, openings)
    width -= width.mean()
    width /= np.abs(width).max()
    strays, period = _between(rng, 0.002, 0.02), _between(rng, 5.0, 20.0)
    for step in case.steps:
        begin, phase = rng.random(), 2.0 * pi * rng.random()

        def light(t: FloatArray, begin: float = begin, phase: float = phase) -> FloatArray:
            # the integral of turns (1 + strays cos)
            swing = strays * period / (2.0 * pi) * np.sin(2.0 * pi * t / period + phase)
            place = np.mod(begin + turns * (t + swing), 1.0) * openings
            return np.asarray(s * np.interp(place, np.arange(openings + 1), [*width, width[0]]))

        rig[step.name].gain.append(light)


@cause((), "line", "share of the step", 0.15, fast=True)
def two_way_sweep(rig: Rig, s: float, rng: np.random.Generator, case: Case) -> None:
    """A piezo sweeps the laser across the line, to and fro; it lags behind its voltage either way.

    So the line is found too high on the way up and too low on the way down: by a lens, whose middle
    is the widest, and nothing where the sweep turns.  The readings of both ways come by turns.
    """
    rate, begin, reach = _between(rng, 2.0, 15.0), rng.uniform(0.05, 0.3), rng.uniform(0.3, 0.7)
    for knobs in rig.values():
        knobs.sweep_gap, knobs.sweep_rate = s * _mean_step(case), rate
        knobs.sweep_from, knobs.sweep_reach = begin, reach
        knobs.sweep_begin = rng.random()


@cause((), "drift", "share of the step", 0.15)
def slipping_clamp(rig: Rig, s: float, rng: np.random.Generator, case: Case) -> None:
    """The bench warms or cools evenly and pulls at the fibre, which slips in its clamp by and by.

    The reading drifts in a straight line and jumps back where the clamp lets go, each time at
    another strain: ``s`` in the mean.  How fast the bench is differs from record to record.
    """
    lasting, size = _between(rng, 2.5, 20.0), s * _mean_step(case)
    for step in case.steps:
        rate = _sign(rng) / (lasting * _between(rng, 0.6, 1.6))  # strains in the mean, per s
        strains = rng.uniform(0.4, 1.6, int(2.5 * step.duration * abs(rate)) + 2)
        slips = np.cumsum(strains) / abs(rate) - strains[0] * rng.random() / abs(rate)
        since = np.concatenate([[slips[0] - strains[0] / abs(rate)], slips])

        def strain(t: FloatArray, since: FloatArray = since, rate: float = rate) -> FloatArray:
            last = np.maximum(np.searchsorted(since, t, side="right") - 1, 0)
            return np.asarray(size * rate * (t - since[last]))

        rig[step.name].offset.append(strain)
        rig[step.name].marks += both_sides(slips[slips < step.duration].tolist())


@cause((), "fall", "share absorbed", 0.3)
def light_across_inlet(rig: Rig, s: float, rng: np.random.Generator, case: Case) -> None:
    """On its way to the chip the light crosses the inlet's tube, and the test gas absorbs it.

    Carbon dioxide has weak bands about 1.6 um; the highest concentration takes ``s`` (Lambert and
    Beer).  It is in the tube before it is at the ring and gone from there sooner: the reading first
    sinks a little, and before it falls it rises.
    """
    for knobs in rig.values():
        knobs.absorbed = s


@cause((), "fall", "share lost", 0.6)
def searching_stage(rig: Rig, s: float, rng: np.random.Generator, case: Case) -> None:
    """A stage that keeps the fibre aligned takes the falling signal for its own and searches.

    It goes to and fro about its best place, less and less far, until it has found that again; of
    the light, a Gaussian beam before a fibre, 1 - (1 - ``s``)^(distance^2) is lost.  A rise is none
    of its business.
    """
    drop, period, turns = rng.uniform(0.05, 0.3), _between(rng, 0.6, 3.0), int(rng.integers(2, 6))
    for step in case.steps:
        reach = 8.0 * (case.tau_v + case.V / step.total_flow + case.tau)
        t = step.tf + np.linspace(0.0, reach, 4001)
        y, _ = voltage(case, step, Knobs(), t)
        fallen = np.flatnonzero(y < (1.0 - drop) * y[0])
        if len(fallen) == 0:
            continue
        begin = float(t[fallen[0]])

        def lost(t: FloatArray, begin: float = begin) -> FloatArray:
            searched = np.clip((t - begin) / (turns * period), 0.0, 1.0)
            off = (1.0 - searched) * np.sin(2.0 * pi * turns * searched)
            return np.asarray(np.expm1(np.log1p(-s) * off**2))

        rig[step.name].gain.append(lost)
        rig[step.name].marks.append(begin)


@cause((), "plateau", "share lost", 0.5, near=("optical_nonlinearity",))
def bowing_chip(rig: Rig, s: float, rng: np.random.Generator, case: Case) -> None:
    """A thick coating swells and bows the chip like a bimetal, away from the fibre before it.

    It swells as the gas gets to its bottom, by diffusion across a slab.  Of the light, a Gaussian
    beam before a fibre, 1 - (1 - ``s``)^(bow^2) is lost, the bow being 1 at the highest
    concentration; the fibre's best place may lie on the way, so that there is more light at first.
    """
    at, time = rng.uniform(0.0, 0.3), _between(rng, 1.0, 15.0)
    for knobs in rig.values():
        knobs.bow, knobs.bow_at, knobs.bow_time = s, at, time


@cause((), "drift", "share of the step", 0.3, per_experiment=True)
def distant_earthquake(rig: Rig, s: float, rng: np.random.Generator, case: Case) -> None:
    """Waves of a distant earthquake pass and tilt the table, the long ones first.

    A Gaussian band of them, all set off at once, whose delay grows evenly with the frequency: on
    the way the shock has become a train, in which they follow each other ever faster.  It takes no
    notice of where a record ends.
    """
    rate, spread = 2.0 * pi / _between(rng, 1.5, 6.0), rng.uniform(0.15, 0.3)
    band, lasts = spread * rate, _between(rng, 1.5, 4.0)  # rad/s; times what the shock did
    delay = np.sqrt(lasts**2 - 1.0) / band**2  # s per rad/s
    begins = _begins(case)
    arrives, turn = rng.uniform(0.1, 0.9) * begins[-1], 2.0 * pi * rng.random()
    size = s * _mean_step(case)
    for begin, step in zip(begins.tolist(), case.steps, strict=False):

        def tilt(t: FloatArray, begin: float = begin) -> FloatArray:
            since = begin + t - arrives
            # the Fourier integral of the band, each frequency turned by what it is late
            train = np.exp(-0.5 * since**2 / complex(band**-2, delay))
            return np.asarray(size * (train * np.exp(1j * (rate * since + turn))).real)

        reach = 8.0 * lasts / band
        if begin - reach < arrives < begin + step.duration + reach:
            rig[step.name].offset.append(tilt)


@cause((), "tail", "share of the light", 0.5, near=("slow_sorption",))
def glowing_phosphor(rig: Rig, s: float, rng: np.random.Generator, case: Case) -> None:
    """Part of the light falls on a phosphor before the photodiode, and that glows on.

    Light frees charges, and these glow where two of them meet (Becquerel's law): bright light shows
    sooner than faint light, and the glow fades as one over the square of time.  ``s`` of what is
    read is that glow; at the mean step it follows in some seconds.
    """
    time, level = _between(rng, 0.5, 6.0), _mean_step(case)
    for knobs in rig.values():
        knobs.glowing, knobs.glowing_time, knobs.glowing_level = s, time, level


@cause((), "drift", "share of the step", 0.2, near=("baseline_drift",), per_experiment=True)
def dripping_ceiling(rig: Rig, s: float, rng: np.random.Generator, case: Case) -> None:
    """The ceiling leaks, and from some time on water drips on to the cell: each drop cools its lid.

    Nearly evenly, and never two drops alike.  The cold of one spreads into a thick lid as from a
    plane that was touched once, exp(-a/t) sqrt(a/t) at the ring's depth, and the room warms it
    away: none comes at first, and for long some of it is left, on which the next ones add up.  It
    drips on from record to record.
    """
    deep, every = _between(rng, 0.15, 1.5), _between(rng, 3.0, 15.0)  # s
    warmed = _between(rng, 4.0, 30.0)  # s
    begins = _begins(case)
    leaks, size = rng.uniform(0.02, 0.6) * begins[-1], _sign(rng) * s * _mean_step(case)
    count = int(1.5 * begins[-1] / every) + 2
    falls = leaks + every * np.cumsum(rng.uniform(0.75, 1.25, count))
    heavy = rng.uniform(0.6, 1.0, count)
    most = float(np.sqrt(0.5) * np.exp(-0.5))  # a drop's cold at t = 2 a, if none is lost
    for begin, step in zip(begins.tolist(), case.steps, strict=False):
        before = falls < begin + step.duration
        if not before.any():
            continue

        def cold(
            t: FloatArray, falls: FloatArray = falls[before] - begin,
            heavy: FloatArray = heavy[before],
        ) -> FloatArray:  # fmt: skip
            total = np.zeros_like(t)
            for at, weight in zip(falls, heavy, strict=True):
                late = deep / np.maximum(t - at, 1e-3 * deep)  # nothing has come so early
                total += weight * np.sqrt(late) * np.exp(-late - deep / late / warmed)
            return size / most * total

        rig[step.name].offset.append(cold)
        inside = falls[before] - begin
        rig[step.name].marks += inside[inside > 0.0].tolist()


@cause((), "drift", "share of the step", 0.25, near=("baseline_drift",), per_experiment=True)
def creeping_sunbeam(rig: Rig, s: float, rng: np.random.Generator, case: Case) -> None:
    """A sunbeam through a gap of the blind creeps across the photodiode, and adds ``s`` at most.

    The gap lets through what it uncovers of the sun's disc, whose half degree takes 128 s, or half
    of that by way of a mirror: more and more of it, all of it for a while, less and less.  It takes
    no notice of where a record ends.
    """
    across = 128.0 * rng.uniform(0.5, 1.0)  # s from the disc's one limb to the other
    wide = across * rng.uniform(0.5, 3.0)
    begins = _begins(case)
    comes = rng.uniform(0.05, 0.6) * begins[-1]  # when an edge of the gap is at the disc's middle
    size = s * _mean_step(case)

    def uncovered(since: FloatArray) -> FloatArray:
        """Share of a disc that an edge has gone over, ``since`` (n,) s after its middle."""
        z = np.clip(2.0 * since / across, -1.0, 1.0)
        return 1.0 - (np.arccos(z) - z * np.sqrt(1.0 - z**2)) / pi

    for begin, step in zip(begins.tolist(), case.steps, strict=False):

        def light(t: FloatArray, begin: float = begin) -> FloatArray:
            since = begin + t - comes
            return np.asarray(size * (uncovered(since) - uncovered(since - wide)))

        first, last = comes - 0.5 * across, comes + wide + 0.5 * across
        if first < begin + step.duration and begin < last:
            rig[step.name].offset.append(light)
            limbs = [at + sign * 0.5 * across for at in (comes, comes + wide) for sign in (-1, 1)]
            inside = [at - begin for at in limbs if begin < at < begin + step.duration]
            rig[step.name].marks += inside


@cause((), "spike", "share of the light", 0.5)
def compressor_on_mains(rig: Rig, s: float, rng: np.random.Generator, case: Case) -> None:
    """The light is a halogen lamp's, and a neighbour's compressor pulls down the mains it is on.

    Starting, a motor draws several times what it needs once it has run up; a lamp gives light as
    the voltage to the power of 3.4, and its filament follows in its own time.  A standing motor
    would cost ``s`` of the light.  It fills its tank and rests, from record to record.
    """
    turn, share = _between(rng, 6.0, 30.0), rng.uniform(0.25, 0.55)
    running, up = rng.uniform(0.1, 0.25), _between(rng, 0.3, 1.5)
    filament, sag = _between(rng, 0.04, 0.12), -float(np.expm1(np.log1p(-s) / 3.4))
    begins = _begins(case)
    turns = turn * np.cumsum(rng.uniform(0.8, 1.2, int(1.3 * begins[-1] / turn) + 3))
    starts = turns - turn * (1.0 + rng.random())
    stops = starts + share * turn * rng.uniform(0.8, 1.2, len(starts))

    def current(since: FloatArray) -> FloatArray:
        """Of the motor as the filament sees it, ``since`` (n,) s; that of one at rest is 1."""
        hot = np.exp(-since / filament)
        inrush = up / (up - filament) * (np.exp(-since / up) - hot)
        return np.asarray(running * (1.0 - hot) + (1.0 - running) * inrush)

    for begin, step in zip(begins.tolist(), case.steps, strict=False):

        def light(t: FloatArray, begin: float = begin) -> FloatArray:
            k = np.maximum(np.searchsorted(starts, begin + t, side="right") - 1, 0)
            on = np.maximum(begin + t - starts[k], 0.0)
            ran = stops[k] - starts[k]
            off = np.exp(-np.maximum(on - ran, 0.0) / filament)
            drawn = current(np.minimum(on, ran)) * off
            return np.asarray(np.expm1(3.4 * np.log1p(-sag * drawn)))

        rig[step.name].gain.append(light)
        edges = np.concatenate([starts, stops]) - begin
        rig[step.name].marks += edges[(edges > 0.0) & (edges < step.duration)].tolist()


@cause((), "drift", "share of the step", 0.25, per_experiment=True)
def swaying_lamp(rig: Rig, s: float, rng: np.random.Generator, case: Case) -> None:
    """Somebody bumps his head on the pendent lamp, which sways and comes to rest.

    Its light on the photodiode comes and goes with it, by ``s`` at first: as slowly as a pendulum
    of its length is, and less and less.  It sways on while a record ends and the next one begins.
    """
    omega, rests = float(np.sqrt(9.81 / rng.uniform(0.5, 2.2))), _between(rng, 15.0, 60.0)
    begins, size = _begins(case), s * _mean_step(case)
    bumps = begins[-1] * (np.arange(3) + rng.uniform(0.1, 0.9, 3)) / 3.0
    turning = omega * np.sqrt(1.0 - 1.0 / (omega * rests) ** 2)
    for begin, step in zip(begins.tolist(), case.steps, strict=False):

        def light(t: FloatArray, begin: float = begin) -> FloatArray:
            since = np.maximum(begin + t - bumps[:, None], 0.0)
            return np.asarray(size * (np.exp(-since / rests) * np.sin(turning * since)).sum(axis=0))

        if bumps[0] < begin + step.duration:
            rig[step.name].offset.append(light)
            rig[step.name].marks += [at - begin for at in bumps if 0 < at - begin < step.duration]


@cause((), "level", "relative", 0.2, near=("optical_nonlinearity",))
def grainy_fibre(rig: Rig, s: float, rng: np.random.Generator, case: Case) -> None:
    """A fibre of many modes leads the light on, and some edge cuts part of its end off.

    Which grains of its speckle pass depends on the wavelength, which follows the line: more light
    or less, by ``s`` in the mean, the same whenever the line is there again.
    """
    n = 24
    waves, begins = rng.standard_normal(n) / _between(rng, 0.05, 0.3), rng.uniform(0.0, 2.0 * pi, n)
    for knobs in rig.values():
        knobs.grain, knobs.grain_waves, knobs.grain_begins = s, waves, begins


@cause((), "tail", "share of the light", 0.3, near=("slow_sorption",))
def chart_on_screen(rig: Rig, s: float, rng: np.random.Generator, case: Case) -> None:
    """The record is drawn on a screen beside the photodiode, white below its line as it goes by.

    The higher the line was in the time that the screen shows, the more light comes from there, and
    is recorded: ``s`` of the signal if it stayed.
    """
    time = _between(rng, 4.0, 40.0)
    for knobs in rig.values():
        knobs.screen, knobs.screen_time = s, time


@cause((), "drift", "share of the step", 0.25, per_experiment=True, reserve=True)
def slideshow_screen(rig: Rig, s: float, rng: np.random.Generator, case: Case) -> None:
    """The light of a computer's screen gets into the photodiode, and its screensaver shows slides.

    It begins when no key has been touched for some time, which is what begins a record.  Each slide
    stands as long as the others, is brighter or darker than the desktop by up to ``s``, and goes
    over into the next one evenly.
    """
    shortest = min(step.duration for step in case.steps)
    idle, stands = rng.uniform(0.05, 0.4) * shortest, _between(rng, 2.0, 12.0)
    fades, size = rng.uniform(0.05, 0.5) * stands, s * _mean_step(case)
    for step in case.steps:
        begins = np.arange(idle, step.duration, stands)
        levels = size * rng.uniform(-1.0, 1.0, len(begins))
        times = np.column_stack([begins, begins + fades]).ravel()
        values = np.column_stack([np.append(0.0, levels[:-1]), levels]).ravel()
        rig[step.name].offset.append(_interpolated(times, values))
        rig[step.name].marks += times[times < step.duration].tolist()


@cause((), "line", "share of the step", 0.3, per_experiment=True, fast=True, reserve=True)
def rolling_lid(rig: Rig, s: float, rng: np.random.Generator, case: Case) -> None:
    """Somebody drops a round lid on the bench, which rolls on its rim ever faster and shakes it.

    The air below takes its height as the cube root of the time that is left, and it goes round as
    one over the root of its height (Moffatt, Nature 404, 833, 2000): it shakes the fibre by up to
    ``s`` as hard to the end, and is at rest at once.  That happens some times in a campaign.
    """
    begins, rate, rolls = _begins(case), _between(rng, 2.5, 8.0), _between(rng, 2.0, 8.0)
    n = len(case.steps) // 2 + 1
    drops = begins[-1] * (np.arange(n) + rng.uniform(0.05, 0.9, n)) / n
    lasts, sizes = rolls * rng.uniform(0.5, 1.0, n), rng.uniform(0.5, 1.0, n)
    sizes *= s * _mean_step(case) / sizes.max()
    for begin, step in zip(begins.tolist(), case.steps, strict=False):
        seen = (drops < begin + step.duration) & (drops + lasts > begin)

        def shaken(
            t: FloatArray, at: FloatArray = drops[seen] - begin, lasts: FloatArray = lasts[seen],
            sizes: FloatArray = sizes[seen],
        ) -> FloatArray:  # fmt: skip
            left = 1.0 - (t - at[:, None]) / lasts[:, None]
            rolling = (left > 0.0) & (left <= 1.0)
            # turns with the rate left^(-1/6)
            turns = 1.2 * rate * lasts[:, None] * (1.0 - np.clip(left, 0.0, 1.0) ** (5.0 / 6.0))
            return np.asarray(sizes @ np.where(rolling, np.sin(2.0 * pi * turns), 0.0))

        if seen.any():
            edges = np.concatenate([drops[seen], (drops + lasts)[seen]]) - begin
            rig[step.name].offset.append(shaken)
            rig[step.name].marks += both_sides(edges[(edges > 0.0) & (edges < step.duration)])


@cause((), "drift", "share of the step", 0.2, per_experiment=True, reserve=True)
def tower_in_the_wind(rig: Rig, s: float, rng: np.random.Generator, case: Case) -> None:
    """The laboratory is high up in a tower, which sways in the wind and tilts the table.

    At the tower's own slow rate, hardly damped, and kept going by gusts: swings grow and fade as
    these happen to come.  The light goes with the tilt, by ``s`` rms; records begin and end as they
    may.
    """
    rate = 2.0 * pi * _between(rng, 0.1, 0.5)
    damping, size = rate * rng.uniform(0.01, 0.04), s * _mean_step(case)
    begins = _begins(case)
    h = 0.02 * 2.0 * pi / rate
    times = np.arange(0.0, begins[-1] + 2.0 * h, h)
    # swings as they are seen from a frame that turns along: they change slowly
    gusts = rng.standard_normal((2, len(times)))
    gusts[:, 1:] *= np.sqrt(-np.expm1(-2.0 * damping * h))
    swings = lfilter([1.0], [1.0, -np.exp(-damping * h)], gusts)
    for begin, step in zip(begins.tolist(), case.steps, strict=False):

        def tilt(t: FloatArray, begin: float = begin) -> FloatArray:
            along, across = (np.interp(begin + t, times, part) for part in swings)
            angle = rate * (begin + t)
            return np.asarray(size * (along * np.cos(angle) + across * np.sin(angle)))

        rig[step.name].offset.append(tilt)
