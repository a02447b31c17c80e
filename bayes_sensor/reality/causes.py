"""What can go wrong on the simulated rig: one entry a cause, each turned on by one strength.

A cause turns the knobs of every experiment.  What it has to choose besides its strength (signs,
times, variants) it draws from a generator that depends on the case's seed and the cause's name
only, so that the same case with another strength differs in the strength alone.

``listed_as`` holds the names in the catalogue of effects that are a right answer, most fitting
first; it is empty for a cause outside the catalogue.
"""

from __future__ import annotations

import zlib
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from itertools import pairwise
from math import pi, sqrt

import numpy as np
from scipy.special import erfc, erfcx, expit, lambertw

from bayes_sensor.campaign import FloatArray
from bayes_sensor.reality.records import Case, Step
from bayes_sensor.reality.rig import Course, Knobs, voltage

Rig = dict[str, Knobs]
Apply = Callable[[Rig, float, np.random.Generator, Case], None]


@dataclass(frozen=True)
class Cause:
    """One thing that can go wrong."""

    name: str
    listed_as: tuple[str, ...]
    family: str
    """what it resembles: causes of one family are hard to tell apart"""
    unit: str
    """of the strength"""
    highest: float
    """the largest strength that is still plausible in a laboratory"""
    turn: Apply
    near: tuple[str, ...] = ()
    """names that would not be wrong, although the catalogue's form does not cover the cause"""
    per_experiment: bool = False
    """whether its size differs from experiment to experiment"""
    fast: bool = False
    """whether it oscillates faster than the response moves"""
    noise: bool = False
    """whether it changes the noise and leaves the mean alone"""
    reserve: bool = False
    """kept out of every run but the last"""

    @property
    def listed(self) -> bool:
        """Whether the catalogue has a name for it."""
        return bool(self.listed_as)

    def generator(self, case: Case) -> np.random.Generator:
        """Where its own choices come from."""
        return np.random.default_rng([case.seed, zlib.crc32(self.name.encode())])

    def apply(self, rig: Rig, strength: float, case: Case) -> None:
        """Turn the knobs of ``rig``; nothing happens at strength 0."""
        if strength != 0.0:
            self.turn(rig, float(strength), self.generator(case), case)


CAUSES: dict[str, Cause] = {}


def cause(
    listed_as: tuple[str, ...],
    family: str,
    unit: str,
    highest: float,
    near: tuple[str, ...] = (),
    **flags: bool,
) -> Callable[[Apply], Apply]:
    """Register the decorated function under its own name."""

    def register(turn: Apply) -> Apply:
        name = turn.__name__
        CAUSES[name] = Cause(name, listed_as, family, unit, highest, turn, near, **flags)
        return turn

    return register


def _sign(rng: np.random.Generator) -> float:
    return 1.0 if rng.random() < 0.5 else -1.0


def _between(rng: np.random.Generator, low: float, high: float) -> float:
    """Uniform in the logarithm."""
    return float(np.exp(rng.uniform(np.log(low), np.log(high))))


def _mean_step(case: Case) -> float:
    """V, the campaign's mean step."""
    return float(np.mean([abs(step.beta) for step in case.steps]))


def _both_sides(edges: Iterable[float]) -> list[float]:
    """s, just before and after each of the ``edges``, where what acts is cut off sharply."""
    return [side for at in edges for side in (at - 1e-6, at + 1e-6)]


# --------------------------------------------------------------------------- valve


@cause(("flow_switching",), "fall", "share of the test gas", 1.0)
def flow_follows_valve(rig: Rig, s: float, rng: np.random.Generator, case: Case) -> None:
    """The test gas stops when its valve shuts, gradually as the valve does; so does its flow."""
    mixing = rng.random() < 0.5
    for knobs in rig.values():
        knobs.following, knobs.mixing = s, mixing


@cause(("valve_asymmetry",), "fall", "relative", 0.6)
def closing_spring(rig: Rig, s: float, rng: np.random.Generator, case: Case) -> None:
    """A spring that weakens as it relaxes shuts the valve more slowly (or faster) than it opens."""
    sign = 1.0 if rng.random() < 0.7 else -1.0
    for knobs in rig.values():
        knobs.closing = sign * s


@cause(("valve_second_order",), "delay", "tau_v squared", 0.6)
def heavy_plunger(rig: Rig, s: float, rng: np.random.Generator, case: Case) -> None:
    """The plunger and the gas it pushes have mass, and their drag grows with speed."""
    for knobs in rig.values():
        knobs.inertia = s


@cause(("two_rate_valve",), "tail", "share", 0.25)
def seat_creep(rig: Rig, s: float, rng: np.random.Generator, case: Case) -> None:
    """The last part of the valve's opening creeps, with a spread of times."""
    slow = _between(rng, 2.0, 8.0)
    for knobs in rig.values():
        knobs.slow_opening, knobs.slow_opening_time = s, slow


@cause(("finite_stroke",), "delay", "s", 0.8)
def plunger_stroke(rig: Rig, s: float, rng: np.random.Generator, case: Case) -> None:
    """The plunger accelerates evenly from stop to stop."""
    for knobs in rig.values():
        knobs.stroke_time = s


@cause((), "valve", "share of the stroke", 0.4)
def sticking_valve(rig: Rig, s: float, rng: np.random.Generator, case: Case) -> None:
    """The valve sticks and slips: it moves in jumps."""
    for knobs in rig.values():
        knobs.stick_band = s * _between(rng, 0.7, 1.4)


@cause((), "valve", "s", 0.6)
def bouncing_valve(rig: Rig, s: float, rng: np.random.Generator, case: Case) -> None:
    """The valve springs back once, at either end."""
    after = rng.uniform(0.1, 0.8)
    for knobs in rig.values():
        knobs.bounces = [(after, s)]


@cause((), "valve", "log of the time", 0.6, per_experiment=True)
def uneven_air(rig: Rig, s: float, rng: np.random.Generator, case: Case) -> None:
    """Compressed air drives the valve; its pressure, and the valve's speed, differ each time."""
    for knobs in rig.values():
        knobs.valve_factor = float(np.exp(s * np.clip(rng.standard_normal(), -2.0, 2.0)))


@cause((), "valve", "s", 0.8, per_experiment=True)
def mains_dip(rig: Rig, s: float, rng: np.random.Generator, case: Case) -> None:
    """The mains fail for a moment while test gas flows; the valve falls shut and opens again."""
    certain = int(rng.integers(len(case.steps)))
    for k, step in enumerate(case.steps):
        at = step.t0 + rng.uniform(0.2, 0.9) * (step.tf - step.t0)
        lasts = s * rng.uniform(0.5, 1.0)
        if k == certain or rng.random() < 0.6:
            rig[step.name].dropped.append((at, lasts))


@cause((), "plateau", "share of the stroke", 0.3)
def weak_holding_current(rig: Rig, s: float, rng: np.random.Generator, case: Case) -> None:
    """The driver pulls the valve in with full current, then saves current and only holds it.

    Held too weakly, the plunger sinks back by part of its stroke until the valve shuts altogether.
    """
    after = _between(rng, 1.0, 8.0)
    for knobs in rig.values():
        knobs.sinking, knobs.sinking_after = s, after


@cause((), "tail", "share of the stroke", 0.2, per_experiment=True)
def grain_in_seat(rig: Rig, s: float, rng: np.random.Generator, case: Case) -> None:
    """A grain of dust lies in the seat: the valve comes to rest on it, ajar, and test gas leaks.

    Sooner or later the stream carries the grain off and the plunger falls the rest of its way; some
    grains stay until after the record.
    """
    certain = int(rng.integers(len(case.steps)))
    for k, step in enumerate(case.steps):
        size, lies = s * rng.uniform(0.5, 1.0), _between(rng, 2.0, 20.0)
        if k != certain and rng.random() < 0.4:
            continue
        rig[step.name].ajar, rig[step.name].ajar_until = size, step.tf + lies


@cause((), "fall", "authority lost", 0.8, near=("valve_asymmetry",))
def throttling_hose(rig: Rig, s: float, rng: np.random.Generator, case: Case) -> None:
    """The hose behind the valve throttles, too: with the valve half open most of the gas flows.

    Both share one pressure, which falls with the square of the flow; the valve's authority, its
    part of that when it is open, is 1 - ``s``.  Its last half of the way up changes little, as does
    its first half of the way down.
    """
    for knobs in rig.values():
        knobs.authority_lost = s


@cause((), "delay", "times the drag", 6.0, near=("valve_second_order",))
def stiff_grease(rig: Rig, s: float, rng: np.random.Generator, case: Case) -> None:
    """The valve's grease sets while it rests and yields as it is sheared (thixotropy).

    Each way begins against 1 + ``s`` times the drag, or less if the rest before it was short, and
    ends against hardly more than none of it.
    """
    time, stroke = _between(rng, 5.0, 60.0), _between(rng, 0.15, 0.6)
    for knobs in rig.values():
        knobs.grease, knobs.grease_time, knobs.grease_stroke = s, time, stroke


@cause((), "fall", "s", 2.0, near=("flow_switching",))
def unequal_valves(rig: Rig, s: float, rng: np.random.Generator, case: Case) -> None:
    """Two valves take turns, for the test gas and for the carrier gas in its place; one is slower.

    If that is the carrier's, both flow for a while when the test gas comes, which thins it, and
    neither when it goes, when little flushes the manifold; if it is the test gas's, the other way
    round.  A coil pulls in and drops out with unequal delays.
    """
    sign, on, off = _sign(rng), rng.uniform(0.4, 1.0), rng.uniform(0.4, 1.0)
    for step in case.steps:
        knobs, late = rig[step.name], (sign * s * on, sign * s * off)
        knobs.made_up_late, knobs.mixing = late, True
        knobs.marks += [step.t0 + late[0], step.tf + late[1]]


@cause((), "delay", "s", 2.0, near=("finite_stroke",))
def late_main_stage(rig: Rig, s: float, rng: np.random.Generator, case: Case) -> None:
    """A servo valve opens its pilot hole first, and ``s`` later, its chamber empty, the main seat.

    Until then the pilot hole passes what its cross-section is of the whole.  Shut, the spring
    throws both onto their seats at once.
    """
    pilot = rng.uniform(0.06, 0.25)
    for knobs in rig.values():
        knobs.pilot, knobs.pilot_alone = pilot, s


@cause((), "spike", "s", 0.8, per_experiment=True)
def trial_click(rig: Rig, s: float, rng: np.random.Generator, case: Case) -> None:
    """The operator clicks the valve's switch to hear that it works, before the experiment begins.

    A whiff of test gas comes, as long as the click of up to ``s`` lets it.
    """
    certain = int(rng.integers(len(case.steps)))
    for k, step in enumerate(case.steps):
        at, lasts = step.commanded_on * rng.uniform(0.1, 0.7), s * rng.uniform(0.6, 1.0)
        if k == certain or rng.random() < 0.5:
            rig[step.name].tried.append((at, lasts))


@cause((), "delay", "share of the stroke", 0.9, near=("finite_stroke",), reserve=True)
def snapping_diaphragm(rig: Rig, s: float, rng: np.random.Generator, case: Case) -> None:
    """The valve's diaphragm is bowed like an oil can's lid: it gives a little, then snaps through.

    What drives it comes and goes as ever; the share ``s`` of the stroke is done at once, and on the
    way back at a lower pressure than on the way there.
    """
    up, down = rng.uniform(0.6, 0.85), rng.uniform(0.15, 0.4)
    for knobs in rig.values():
        knobs.snap, knobs.snap_up, knobs.snap_down = s, up, down


# --------------------------------------------------------------------------- flows


@cause(("flow_settling",), "tail", "relative", 0.6)
def controller_settling(rig: Rig, s: float, rng: np.random.Generator, case: Case) -> None:
    """The test gas's controller settles after its line opens; the flow is off meanwhile."""
    time = _between(rng, 0.4, 3.0)
    omega = rng.uniform(0.0, 0.7) / time
    sign = _sign(rng)
    for step in case.steps:

        def settle(t: FloatArray, t0: float = step.t0) -> FloatArray:
            since = np.maximum(t - t0, 0.0)
            bump = np.exp(-since / time) * np.cos(omega * since)
            return np.where(t >= t0, 1.0 + 0.8 * sign * s * bump, 1.0)

        rig[step.name].test_gas.append(settle)


@cause(("flow_error",), "flow", "relative", 0.15, per_experiment=True)
def controller_offsets(rig: Rig, s: float, rng: np.random.Generator, case: Case) -> None:
    """Flows differ from their set points: an offset of the controller and one a setting."""
    low = min(step.total_flow for step in case.steps)
    offset = 0.5 * rng.standard_normal() * low  # the same mL/s everywhere: more at small flows
    for step in case.steps:
        own = offset / step.total_flow + rng.standard_normal()
        rig[step.name].flow_factor *= float(np.exp(s * np.clip(own, -2.5, 2.5)))


@cause((), "plateau", "share lost", 0.4)
def emptying_bottle(rig: Rig, s: float, rng: np.random.Generator, case: Case) -> None:
    """The bottle's pressure falls while test gas flows; its flow gives way ever faster."""
    begin = rng.uniform(0.0, 0.7)
    order = rng.uniform(1.5, 4.0)
    for step in case.steps:
        length = step.tf - step.t0

        def flow(t: FloatArray, t0: float = step.t0, length: float = length) -> FloatArray:
            used = np.clip(((t - t0) / length - begin) / (1.0 - begin), 0.0, 1.0)
            return 1.0 - s * used**order

        rig[step.name].test_gas.append(flow)


@cause((), "ripple", "relative", 0.3, fast=True)
def neighbours_pump(rig: Rig, s: float, rng: np.random.Generator, case: Case) -> None:
    """A pump on the same exhaust modulates the test-gas flow, stroke by stroke."""
    frequency = _between(rng, 0.25, 2.5)
    for step in case.steps:
        phase = rng.uniform(0.0, 2.0 * pi)

        def flow(t: FloatArray, phase: float = phase) -> FloatArray:
            angle = 2.0 * pi * frequency * t + phase
            return 1.0 + s * (np.sin(angle) + 0.4 * np.sin(2.0 * angle + 1.0))

        rig[step.name].test_gas.append(flow)
        rig[step.name].marks += list(np.arange(0.0, step.duration, 0.04 / frequency)[1:])


@cause((), "plateau", "relative", 0.3, per_experiment=True)
def corrected_setting(rig: Rig, s: float, rng: np.random.Generator, case: Case) -> None:
    """In some experiments the operator corrects the test gas's set point on the way."""
    certain = int(rng.integers(len(case.steps)))
    time = _between(rng, 0.2, 2.0)
    for k, step in enumerate(case.steps):
        size = _sign(rng) * s * rng.uniform(0.5, 1.0)
        at = step.t0 + rng.uniform(0.15, 0.85) * (step.tf - step.t0)
        if k != certain and rng.random() < 0.5:
            continue

        def flow(t: FloatArray, at: float = at, size: float = size) -> FloatArray:
            return 1.0 - size * np.expm1(-np.maximum(t - at, 0.0) / time)

        rig[step.name].test_gas.append(flow)
        rig[step.name].marks.append(at)


@cause((), "tail", "share of the test gas", 0.15)
def creeping_regulator(rig: Rig, s: float, rng: np.random.Generator, case: Case) -> None:
    """The shut valve weeps, and the more, the higher the bottle's regulator lets pressure creep.

    A worn regulator does not hold its pressure without flow: it creeps up as 1 - exp(-t/time).  It
    is up when a record begins, and y0 holds the leak, from which gas is counted here; there is none
    while the valve is open, and when it shuts the leak is missing until the pressure is up again.
    """
    time = _between(rng, 2.0, 15.0)
    for step in case.steps:
        leak = s * step.test_gas_flow

        def missing(t: FloatArray, tf: float = step.tf, leak: float = leak) -> FloatArray:
            return np.where(t > tf, -leak * np.exp(-np.maximum(t - tf, 0.0) / time), 0.0)

        rig[step.name].seep.append(missing)


@cause((), "tail", "share", 0.2)
def returning_exhaust(rig: Rig, s: float, rng: np.random.Generator, case: Case) -> None:
    """The carrier is air from a compressor, whose intake draws in part of the rig's own exhaust.

    It comes late, blurred by the air about the intake: a second, smaller step behind each step.
    Less and less goes round more than once, which is left out.
    """
    delay, time = _between(rng, 3.0, 9.0), _between(rng, 0.4, 2.0)
    for knobs in rig.values():
        knobs.returned, knobs.return_delay, knobs.return_time = s, delay, time


@cause((), "plateau", "relative", 0.3, per_experiment=True)
def shared_nitrogen(rig: Rig, s: float, rng: np.random.Generator, case: Case) -> None:
    """Somebody else draws nitrogen from the house line: the carrier sags for seconds and recovers.

    A controller holds its flow only while its inlet has pressure; with less carrier the test gas is
    less diluted and stays longer.  Without test gas nobody notices.
    """
    sag, back = _between(rng, 0.1, 0.6), _between(rng, 0.5, 3.0)
    certain = int(rng.integers(len(case.steps)))
    for k, step in enumerate(case.steps):
        draughts = []
        for _ in range(int(rng.integers(1, 3))):
            at = step.t0 + rng.uniform(0.1, 0.9) * (step.tf - step.t0)
            draughts.append((at, _between(rng, 0.5, 4.0), s * rng.uniform(0.5, 1.0)))
        if k != certain and rng.random() < 0.4:
            continue

        def flow(
            t: FloatArray, draughts: tuple[tuple[float, float, float], ...] = tuple(draughts)
        ) -> FloatArray:
            left = np.ones_like(t)
            for at, lasts, size in draughts:
                since = np.maximum(t - at, 0.0)
                drawn = -np.expm1(-np.minimum(since, lasts) / sag)
                left -= size * drawn * np.exp(-np.maximum(since - lasts, 0.0) / back)
            return left

        rig[step.name].carrier.append(flow)
        rig[step.name].marks += [edge for at, lasts, _ in draughts for edge in (at, at + lasts)]


@cause((), "plateau", "relative", 0.3)
def snapping_regulator(rig: Rig, s: float, rng: np.random.Generator, case: Case) -> None:
    """A dry regulator sticks while gas is drawn: its pressure sags evenly, then snaps back.

    It snaps whenever the same amount of gas has been drawn, the more often the larger the flow.
    """
    typical = float(np.median([step.test_gas_flow for step in case.steps]))
    drawn = typical * _between(rng, 1.5, 8.0)  # mL from snap to snap
    for step in case.steps:
        period, begin = drawn / step.test_gas_flow, rng.random()

        def flow(
            t: FloatArray, t0: float = step.t0, period: float = period, begin: float = begin
        ) -> FloatArray:
            turns = np.maximum(t - t0, 0.0) / period + begin
            return np.where(t >= t0, 1.0 - s * (turns - np.floor(turns)), 1.0)

        rig[step.name].test_gas.append(flow)
        snaps = np.arange(step.t0 + (1.0 - begin) * period, step.duration, period)
        rig[step.name].marks += _both_sides(snaps.tolist())


@cause((), "valve", "share of the flow", 0.9, per_experiment=True)
def pinched_hose(rig: Rig, s: float, rng: np.random.Generator, case: Case) -> None:
    """Somebody steps on the hose that brings both gases and off again: all flow falls meanwhile.

    What the manifold holds stands nearly still; on a plateau nobody would notice, hence it happens
    while the gas is being exchanged, certainly once.
    """
    certain, edge = int(rng.integers(len(case.steps))), _between(rng, 0.03, 0.15)
    for k, step in enumerate(case.steps):
        switch = step.t0 if rng.random() < 0.5 else step.tf
        reach = case.tau_v + case.V / step.total_flow
        at, lasts = switch + rng.uniform(0.2, 1.2) * reach, _between(rng, 0.4, 2.5)
        if k != certain and rng.random() < 0.6:
            continue

        def flow(t: FloatArray, at: float = at, lasts: float = lasts) -> FloatArray:
            down, up = np.tanh((t - at) / edge), np.tanh((t - at - lasts) / edge)
            return np.asarray(1.0 - 0.5 * s * (down - up))

        rig[step.name].all_flow.append(flow)
        rig[step.name].marks += [at - 3.0 * edge, at + lasts - 3.0 * edge]


@cause((), "tail", "share of the vapour", 0.3, near=("flow_settling",))
def cooling_bubbler(rig: Rig, s: float, rng: np.random.Generator, case: Case) -> None:
    """The test gas takes up its vapour in a bubbler, whose liquid cools as it evaporates.

    Its vapour pressure falls exponentially with its temperature (Clausius-Clapeyron), and with it
    what evaporates; a bath brings the heat back.  At the largest flow the share ``s`` is lost in
    the end.
    """
    time = _between(rng, 3.0, 20.0)
    largest = max(step.test_gas_flow for step in case.steps)
    for step in case.steps:
        knobs = rig[step.name]
        # vapour pressure 1 - s = exp(-cold) and cold = chill exp(-cold) in the end
        knobs.chill = -np.log1p(-s) / (1.0 - s) * step.test_gas_flow / largest
        knobs.chill_time = time


@cause((), "plateau", "share of the highest gas", 0.15, per_experiment=True)
def neighbours_solvent(rig: Rig, s: float, rng: np.random.Generator, case: Case) -> None:
    """A neighbour opens a bottle of solvent; the compressor that makes the carrier inhales it.

    The cloud spreads on its way to the intake, z^-3/2 exp(-P (z - 1)^2/z) with z the time since,
    over that of the drift (first passage of diffusion with drift).  The ring does not tell the
    vapour from the test gas.
    """
    certain, highest = int(rng.integers(len(case.steps))), case.highest_concentration
    for k, step in enumerate(case.steps):
        clouds = [
            (
                rng.uniform(0.0, 0.8) * step.duration,
                _between(rng, 1.0, 5.0),
                _between(rng, 0.5, 5.0),
            )
            for _ in range(int(rng.integers(1, 3)))
        ]
        most = [s * highest * step.carrier_flow * rng.uniform(0.5, 1.0) for _ in clouds]
        if k != certain and rng.random() < 0.4:
            continue
        for (at, drift, spread), size in zip(clouds, most, strict=True):
            thickest = (np.sqrt(2.25 + 4.0 * spread**2) - 1.5) / (2.0 * spread)

            def cloud(
                t: FloatArray,
                at: float = at,
                drift: float = drift,
                spread: float = spread,
                size: float = size,
                thickest: float = float(thickest),
            ) -> FloatArray:
                def log_density(z: FloatArray | float) -> FloatArray:
                    return np.asarray(-1.5 * np.log(z) - spread * (z - 1.0) ** 2 / z)

                z = np.maximum((t - at) / drift, 1e-3)  # nothing has come so early
                density = np.exp(log_density(z) - log_density(thickest))
                return np.where(t > at, size * density, 0.0)

            rig[step.name].seep.append(cloud)
            rig[step.name].marks.append(at)


@cause((), "delay", "share lost", 0.6)
def stale_test_gas(rig: Rig, s: float, rng: np.random.Generator, case: Case) -> None:
    """Test gas that stood in its hose before the valve has lost part of its vapour to the wall.

    Each experiment gets the stale gas first, whatever time it takes to push the hose's volume out;
    fresh gas follows behind a front that has spread on its way (Taylor's dispersion).
    """
    volume, spread = case.V * _between(rng, 0.08, 0.4), rng.uniform(0.1, 0.4)
    for knobs in rig.values():
        knobs.stale, knobs.stale_volume, knobs.stale_front = s, volume, spread * volume


@cause((), "plateau", "relative", 0.25)
def sticking_needle(rig: Rig, s: float, rng: np.random.Generator, case: Case) -> None:
    """The needle of the test gas's controller sticks: its loop pushes ever harder until it jumps.

    It jumps too far, sticks again and is pushed back: the flow goes to and fro between two values,
    whose mean the loop holds at the set point (Choudhury, Thornhill and Shah, Control Eng. Pract.
    13, 641, 2005).  Friction is not the same both ways, nor is how long it sticks.
    """
    period, high = _between(rng, 1.5, 8.0), rng.uniform(0.3, 0.7)
    for step in case.steps:
        begin = rng.random()

        def flow(t: FloatArray, begin: float = begin) -> FloatArray:
            above = np.mod(t / period + begin, 1.0) < high
            return np.asarray(1.0 + 2.0 * s * (above - high), dtype=float)

        rig[step.name].test_gas.append(flow)
        turns = np.arange(1.0, step.duration / period + 1.0)
        jumps = np.concatenate([turns - begin, turns - begin + high - 1.0]) * period
        inside = jumps[(jumps > 0.0) & (jumps < step.duration)].tolist()
        rig[step.name].marks += _both_sides(inside)


@cause((), "plateau", "share dissolved", 0.4, near=("flow_settling",))
def washing_bottle(rig: Rig, s: float, rng: np.random.Generator, case: Case) -> None:
    """The test gas bubbles through water before its valve, which dissolves it until saturated.

    A stirred bottle: at first it takes the share ``s``, and exp(-gas passed/volume) of that later.
    It stays as loaded while the valve is shut, so that each experiment finds it as the one before
    has left it.
    """
    typical = float(np.median([p.test_gas_flow * (p.tf - p.t0) for p in case.steps]))
    volume, takes = typical * _between(rng, 0.3, 2.0), s
    for step in case.steps:
        rig[step.name].dissolved, rig[step.name].dissolved_volume = takes, volume
        takes *= float(np.exp(-step.test_gas_flow * (step.tf - step.t0) / volume))


@cause((), "plateau", "relative", 0.5, per_experiment=True)
def spitting_bottle(rig: Rig, s: float, rng: np.random.Generator, case: Case) -> None:
    """A bottle of liquefied gas, overfilled, spits: drops boil off in the hose before the valve.

    A drop's surface, diameter squared, shrinks evenly, and the vapour that it adds goes as its
    diameter (Spalding, 4th Symp. Combust. 847, 1953): at once as much as it will ever be, falling
    ever faster, and suddenly none.  Larger drops give more, for longer.
    """
    longest, certain = _between(rng, 1.5, 10.0), int(rng.integers(len(case.steps)))
    for k, step in enumerate(case.steps):
        count = int(rng.integers(1, 4))
        begin = step.t0 + rng.uniform(0.1, 0.9, count) * (step.tf - step.t0)
        lasts = longest * rng.uniform(0.2, 1.0, count)
        if k != certain and rng.random() < 0.4:
            continue

        def flow(t: FloatArray, begin: FloatArray = begin, lasts: FloatArray = lasts) -> FloatArray:
            more = np.ones_like(t)
            for at, life in zip(begin, lasts, strict=True):
                surface = np.where(t >= at, life - (t - at), 0.0) / longest
                more += s * np.sqrt(np.maximum(surface, 0.0))
            return more

        rig[step.name].test_gas.append(flow)
        edges = [(at - 1e-6, at, at + life) for at, life in zip(begin, lasts, strict=True)]
        rig[step.name].marks += [float(edge) for some in edges for edge in some]


@cause((), "tail", "relative", 0.5, near=("flow_settling",))
def wound_up_controller(rig: Rig, s: float, rng: np.random.Generator, case: Case) -> None:
    """The test gas's controller integrates its error while the line is shut, and winds itself up.

    When the line opens its needle stands at its stop, 1 + ``s`` times the set point, until the
    integral is unwound, which takes the longer, the longer it rested; only then it settles (Astrom
    and Rundqwist, Proc. Am. Control Conf., 1693, 1989).
    """
    longest, time = _between(rng, 0.8, 6.0), _between(rng, 0.3, 2.0)
    rests = [case.steps[0].t0]
    rests += [before.duration - before.tf + step.t0 for before, step in pairwise(case.steps)]
    for step, rest in zip(case.steps, rests, strict=True):
        settles = step.t0 + longest * rest / max(rests)

        def flow(t: FloatArray, t0: float = step.t0, settles: float = settles) -> FloatArray:
            left = np.exp(-np.maximum(t - settles, 0.0) / time)
            return np.where(t >= t0, 1.0 + s * left, 1.0)

        rig[step.name].test_gas.append(flow)
        rig[step.name].marks.append(settles)


@cause((), "drift", "share of the highest gas", 0.15)
def alternating_dryers(rig: Rig, s: float, rng: np.random.Generator, case: Case) -> None:
    """The carrier is dried in two columns that take turns, each a little longer than it lasts.

    Moisture breaks through ever faster, as a logistic curve (Thomas, J. Am. Chem. Soc. 66, 1664,
    1944), until the other column, fresh again, takes over.  The ring does not tell it from the test
    gas.
    """
    turn, half, width = _between(rng, 5.0, 30.0), rng.uniform(0.6, 1.1), rng.uniform(0.04, 0.15)
    for step in case.steps:
        begin, most = rng.random(), s * case.highest_concentration * step.carrier_flow

        def moist(t: FloatArray, begin: float = begin, most: float = most) -> FloatArray:
            used = np.mod(t / turn + begin, 1.0)
            through = (1.0 + np.exp((half - 1.0) / width)) / (1.0 + np.exp((half - used) / width))
            return np.asarray(most * through)

        rig[step.name].seep.append(moist)
        # from the turn on that the record finds begun
        turns = np.arange(-begin * turn, step.duration, turn).tolist()
        rig[step.name].marks += _both_sides(turns)


@cause((), "delay", "s", 4.0, near=("flow_settling",))
def soft_start(rig: Rig, s: float, rng: np.random.Generator, case: Case) -> None:
    """The test gas's controller ramps its set point up evenly when the line opens: a soft start.

    The ramp lasts ``s`` in every experiment, or has one slope and lasts ``s`` at the largest flow.
    The valve shuts as ever, so that the fall knows nothing of it.
    """
    largest, one_slope = max(step.test_gas_flow for step in case.steps), rng.random() < 0.5
    for step in case.steps:
        lasts = s * (step.test_gas_flow / largest if one_slope else 1.0)

        def flow(t: FloatArray, t0: float = step.t0, lasts: float = lasts) -> FloatArray:
            return np.where(t >= t0, np.minimum((t - t0) / lasts, 1.0), 1.0)

        rig[step.name].test_gas.append(flow)
        rig[step.name].marks.append(step.t0 + lasts)


@cause((), "fall", "times the carrier flow", 4.0, per_experiment=True)
def hasty_purge(rig: Rig, s: float, rng: np.random.Generator, case: Case) -> None:
    """The operator cannot wait for the gas to go and turns the carrier up by ``s`` to purge.

    He does so a moment after the valve has shut, in most experiments, and leaves it until the
    record ends: from there the fall goes faster.
    """
    certain, time = int(rng.integers(len(case.steps))), _between(rng, 0.1, 0.6)
    for k, step in enumerate(case.steps):
        at = step.tf + rng.uniform(0.2, 1.2) * (case.tau_v + case.V / step.total_flow)
        if k != certain and rng.random() < 0.3:
            continue

        def flow(t: FloatArray, at: float = at) -> FloatArray:
            return 1.0 - s * np.expm1(-np.maximum(t - at, 0.0) / time)

        rig[step.name].carrier.append(flow)
        rig[step.name].marks.append(at)


@cause((), "fall", "relative", 1.5, near=("flow_error",))
def clogging_filter(rig: Rig, s: float, rng: np.random.Generator, case: Case) -> None:
    """A dust filter before the manifold clogs: a cake grows with all the gas that comes through.

    Its resistance grows evenly with the volume that has passed and the pressure stays, so that the
    flow falls as 1/sqrt(1 + 2 k volume), of both gases alike (Ruth, Ind. Eng. Chem. 27, 708, 1935).
    At the end of the campaign the resistance has grown by ``s``.
    """
    k = 0.5 * ((1.0 + s) ** 2 - 1.0) / sum(step.total_flow * step.duration for step in case.steps)
    passed = 0.0  # as much as would have without a cake
    for step in case.steps:

        def flow(t: FloatArray, passed: float = passed, q: float = step.total_flow) -> FloatArray:
            return np.asarray(1.0 / np.sqrt(1.0 + 2.0 * k * (passed + q * np.maximum(t, 0.0))))

        rig[step.name].all_flow.append(flow)
        passed += step.total_flow * step.duration


@cause((), "plateau", "relative", 0.6, near=("flow_settling",))
def bobbing_float(rig: Rig, s: float, rng: np.random.Generator, case: Case) -> None:
    """The test gas comes through a rotameter, whose float bobs up and down when the line opens.

    Its flow passes by what is set, and swings about it until the float stands still.
    """
    rate, time = _between(rng, 0.3, 1.2), _between(rng, 2.0, 10.0)
    for step in case.steps:

        def flow(t: FloatArray, t0: float = step.t0) -> FloatArray:
            since = np.maximum(t - t0, 0.0)
            return 1.0 + s * np.exp(-since / time) * np.sin(2.0 * pi * rate * since)

        rig[step.name].test_gas.append(flow)


@cause((), "tail", "relative", 2.0, near=("flow_settling",))
def dammed_test_gas(rig: Rig, s: float, rng: np.random.Generator, case: Case) -> None:
    """The controller has pumped up the hose before the shut valve, which lets go when it opens.

    Through the valve's seat the flow goes as the root of the pressure; it is 1 + ``s`` times what
    is set at first, and comes down as the hose empties, sooner at larger flow.
    """
    typical = float(np.median([step.test_gas_flow for step in case.steps]))
    brings = typical * _between(rng, 0.2, 2.0)  # mL that the set flow's pressure keeps in the hose
    for step in case.steps:
        time = 2.0 * brings / step.test_gas_flow

        def flow(t: FloatArray, t0: float = step.t0, time: float = time) -> FloatArray:
            # 2 q q' = (1 - q) flow/brings, hence (q - 1) exp(q - 1) falls exponentially
            left = s * np.exp(s - np.maximum(t - t0, 0.0) / time)
            return np.asarray(1.0 + lambertw(left).real)

        rig[step.name].test_gas.append(flow)


@cause((), "tail", "relative", 0.6, near=("flow_settling",), reserve=True)
def yielding_carrier(rig: Rig, s: float, rng: np.random.Generator, case: Case) -> None:
    """The carrier's controller yields to the pressure that comes with the test gas, and recovers.

    Pressed back, it lets less through until its loop has found the set flow again; when the test
    gas stops, the pressure falls and it lets too much through.  Both go as t exp(-t), and with the
    test gas's flow, at most by ``s``.
    """
    time = _between(rng, 0.4, 3.0)
    largest = max(step.test_gas_flow for step in case.steps)

    def upset(since: FloatArray) -> FloatArray:
        past = np.maximum(since, 0.0) / time
        return np.asarray(past * np.exp(1.0 - past))

    for step in case.steps:
        size = s * step.test_gas_flow / largest

        def flow(
            t: FloatArray, t0: float = step.t0, tf: float = step.tf, size: float = size
        ) -> FloatArray:
            return 1.0 - size * (upset(t - t0) - upset(t - tf))

        rig[step.name].carrier.append(flow)


# --------------------------------------------------------------------------- manifold


@cause(("dead_volume",), "tail", "share of V", 0.35)
def wall_pockets(rig: Rig, s: float, rng: np.random.Generator, case: Case) -> None:
    """Two pockets of the manifold trade gas with the stream, faster at larger flow."""
    time = _between(rng, 0.8, 4.0)
    power = rng.choice([0.0, 0.5, 1.0])
    typical = float(np.median([step.total_flow for step in case.steps]))
    fractions = (0.7 * s, 0.3 * s)
    for step in case.steps:
        quicker = (step.total_flow / typical) ** power
        rates = tuple(
            f * case.V / (time * k) * quicker for f, k in zip(fractions, (0.8, 2.2), strict=True)
        )
        rig[step.name].pocket_fractions = fractions
        rig[step.name].pocket_exchange = rates


@cause(("axial_dispersion",), "mixing", "share", 0.7)
def back_mixing(rig: Rig, s: float, rng: np.random.Generator, case: Case) -> None:
    """The manifold is a row of cells that mix imperfectly: flow forward, less flow back."""
    n_cells = int(rng.integers(3, 7))
    for knobs in rig.values():
        knobs.back_flow, knobs.n_cells = (1.0 - s) / s, n_cells


@cause(("carry_over",), "start", "share of the step", 0.25, per_experiment=True)
def residue(rig: Rig, s: float, rng: np.random.Generator, case: Case) -> None:
    """Gas from the experiment before still leaves the walls when the next one starts."""
    times = (_between(rng, 1.5, 6.0), _between(rng, 8.0, 30.0))
    for before, step in zip(case.steps[:-1], case.steps[1:], strict=True):
        ratio = before.concentration / step.concentration
        rig[step.name].left_over = s * ratio * rng.uniform(0.6, 1.4)
        rig[step.name].left_over_times = times


@cause((), "tail", "share", 0.3)
def late_bypass(rig: Rig, s: float, rng: np.random.Generator, case: Case) -> None:
    """Part of the gas takes a detour and comes late."""
    volume = rng.uniform(0.5, 4.0) * case.V
    typical = float(np.median([step.total_flow for step in case.steps]))
    shared = rng.random() < 0.5  # a detour of fixed time, or of fixed volume
    for step in case.steps:
        rig[step.name].bypass = s
        rig[step.name].bypass_delay = volume / (typical if shared else step.total_flow)


@cause((), "mixing", "relative", 2.0)
def layered_gas(rig: Rig, s: float, rng: np.random.Generator, case: Case) -> None:
    """Heavy gas lies in layers: the more of it there is, the less mixes; above all at low flow."""
    power = rng.choice([0.0, 0.5, 1.0])
    lowest = min(step.total_flow for step in case.steps)
    for step in case.steps:
        heavy = case.relative_concentration(step)
        rig[step.name].layering = s * heavy * (lowest / step.total_flow) ** power


@cause((), "tail", "share of V", 0.3, near=("dead_volume",))
def dead_leg(rig: Rig, s: float, rng: np.random.Generator, case: Case) -> None:
    """The shut valve leaves a blind branch full of test gas, which diffuses out of it."""
    time = _between(rng, 1.0, 10.0)
    volume = s * case.V
    for step in case.steps:

        def out(t: FloatArray, tf: float = step.tf) -> FloatArray:
            since = np.maximum(t - tf, 0.0) / time
            # what a branch with one open end gives off, mode by mode, the valve not shut at once
            flux = sum(2.0 * np.exp(-((k + 0.5) ** 2) * pi**2 * (since + 0.01)) for k in range(12))
            return np.where(t > tf, volume / time * flux, 0.0)

        rig[step.name].seep.append(out)


@cause((), "spike", "share of V", 0.1)
def trapped_plug(rig: Rig, s: float, rng: np.random.Generator, case: Case) -> None:
    """Test gas trapped in the hose is pushed out ahead of the gas that pushes it."""
    volume, sits, reach = s * case.V, rng.uniform(0.1, 0.6), rng.uniform(0.2, 1.0)
    for step in case.steps:
        # the hose empties from the command on; what it held sits between its end and the valve
        begin = step.commanded_on + sits * (step.t0 - step.commanded_on)
        end = begin + reach * (step.t0 - begin)

        def plug(t: FloatArray, begin: float = begin, end: float = end) -> FloatArray:
            done = np.clip((t - begin) / (end - begin), 0.0, 1.0)  # blurred on its way
            return 2.0 * volume / (end - begin) * np.sin(pi * done) ** 2

        rig[step.name].seep.append(plug)
        rig[step.name].marks += [begin, end]


@cause((), "fall", "share of V", 1.0)
def sticky_hose(rig: Rig, s: float, rng: np.random.Generator, case: Case) -> None:
    """The gas sticks to the hose's wall, less readily the more is there: its front sharpens.

    As in a chromatograph that is overloaded: little gas is held back longer than much, so that the
    end of a pulse is drawn out.  ``s`` V of gas would be as much as the wall takes up at first.
    """
    bend, n_cells = _between(rng, 1.0, 5.0), int(rng.integers(5, 11))
    for knobs in rig.values():
        knobs.sticky, knobs.sticky_bend, knobs.sticky_cells = s, bend, n_cells


@cause((), "tail", "share of the test gas", 0.3, near=("dead_volume",))
def permeable_hose(rig: Rig, s: float, rng: np.random.Generator, case: Case) -> None:
    """Gas diffuses into the thick wall of a silicone hose and, for long, out of it again.

    Flux into a half-space through a resistance at its surface, erfcx(sqrt(t/time)): no exponential,
    in the end it falls as the root of time (Crank, The Mathematics of Diffusion, 1975, Sec. 3.3).
    """
    time = _between(rng, 0.2, 4.0)

    def taken(since: FloatArray) -> FloatArray:
        return np.where(since > 0.0, erfcx(np.sqrt(np.maximum(since, 0.0) / time)), 0.0)

    for step in case.steps:
        most = s * step.test_gas_flow

        def given(
            t: FloatArray, t0: float = step.t0, tf: float = step.tf, most: float = most
        ) -> FloatArray:
            return np.asarray(most * (taken(t - tf) - taken(t - t0)))

        rig[step.name].seep.append(given)


@cause((), "fall", "over the exchange", 1.5)
def pairing_gas(rig: Rig, s: float, rng: np.random.Generator, case: Case) -> None:
    """Molecules of the test gas react with each other in the manifold: twice the gas, four times.

    What is left settles sooner than the gas is exchanged, and the sooner, the more there is; the
    last of it leaves as if nothing happened.  At the highest concentration and a middling flow as
    much as ``s`` times what is flushed would react.
    """
    typical = float(np.median([step.total_flow for step in case.steps]))
    for step in case.steps:
        rig[step.name].pairing = s * case.relative_concentration(step) * typical / case.V


@cause((), "mixing", "share of the flow", 0.75)
def jet_across(rig: Rig, s: float, rng: np.random.Generator, case: Case) -> None:
    """The gas enters as a jet, part of which shoots across the manifold to the sensor unmixed.

    What does not take the short cut flushes the manifold, more slowly (Cholette and Cloutier, Can.
    J. Chem. Eng. 37, 105, 1959).  The jet reaches further at larger flow.
    """
    power = rng.choice([0.5, 1.0])
    largest = max(step.total_flow for step in case.steps)
    for step in case.steps:
        rig[step.name].jet = s * (step.total_flow / largest) ** power


@cause((), "fall", "share condensed", 0.1)
def cold_spot(rig: Rig, s: float, rng: np.random.Generator, case: Case) -> None:
    """The hose passes a cold spot, where the vapour is saturated below the highest concentration.

    What is beyond saturation condenses: ``s`` of the gas at the highest concentration, nothing
    where there is less than it takes.  When the test gas stops, the film keeps the gas at
    saturation until it has dried; towards its end it breaks up into droplets.
    """
    patch = case.V * _between(rng, 0.02, 0.2)
    for step in case.steps:
        knobs, relative = rig[step.name], case.relative_concentration(step)
        knobs.saturated, knobs.film_time = 1.0 - s, patch / step.total_flow
        beyond = relative - knobs.saturated
        if beyond > 0.0:
            # what condenses until the valve shuts is what has dried when the film is gone
            lasts = step.tf - step.t0 - case.tau_v * np.log(relative / beyond)
            gone = step.tf + case.tau_v + max(lasts, 0.0) * beyond / knobs.saturated
            knobs.marks.append(max(step.tf, gone - 3.0 * knobs.film_time))


@cause((), "mixing", "share of the gas", 0.6, fast=True)
def swirling_gas(rig: Rig, s: float, rng: np.random.Generator, case: Case) -> None:
    """The gas enters off the chamber's axis and swirls: a streak not yet mixed goes round.

    It passes the ring once a turn, and shows for as long as fresh gas differs from what is there.
    The swirl turns the faster the larger the flow.
    """
    turns, narrow = _between(rng, 1.0, 4.0), _between(rng, 1.0, 5.0)
    for step in case.steps:
        knobs, exchange = rig[step.name], case.V / step.total_flow
        knobs.swirl, knobs.swirl_turns, knobs.swirl_narrow = s, turns, narrow
        knobs.swirl_begin = rng.random()
        reach = 10.0 * (case.tau_v + exchange)
        for switch in (step.t0, step.tf):
            marks = np.arange(switch, min(switch + reach, step.duration), 0.1 * exchange / turns)
            knobs.marks += marks.tolist()[1:]


@cause((), "tail", "share of V", 0.4, near=("dead_volume",))
def heavy_gas_in_pit(rig: Rig, s: float, rng: np.random.Generator, case: Case) -> None:
    """Below the stream the manifold has a pit: heavy gas falls in, and must be lifted out again.

    It falls as fast as the root of its concentration; carrier above it lies at rest, and eddies
    bring up little, the more the larger the flow.
    """
    fast, slow = _between(rng, 0.15, 1.0), _between(rng, 2.0, 12.0)
    typical = float(np.median([step.total_flow for step in case.steps]))
    for step in case.steps:
        knobs, heavy = rig[step.name], sqrt(case.relative_concentration(step))
        knobs.pit, knobs.pit_falling = s, s * case.V / fast * heavy
        knobs.pit_lifted = s * case.V / slow * step.total_flow / typical


@cause((), "plateau", "relative", 0.3, per_experiment=True)
def streaky_inlet(rig: Rig, s: float, rng: np.random.Generator, case: Case) -> None:
    """Test gas and carrier meet in a tee too close to the manifold and arrive as streaks.

    Their eddies let in too much of one and then of the other, of no regularity: what gets in
    strays by ``s`` rms for as long as an eddy takes to pass, which is shorter at larger flow.  In
    the mean it is right.
    """
    typical = float(np.median([step.total_flow for step in case.steps]))
    lasting = _between(rng, 0.3, 2.0)
    for step in case.steps:
        apart = lasting * typical / step.total_flow
        times = np.arange(-apart * (1.0 + rng.random()), step.duration + 2.0 * apart, apart)
        # straight lines between values at random have two thirds of their variance
        strays = sqrt(1.5) * np.clip(rng.standard_normal(len(times)), -2.5, 2.5)
        rig[step.name].unmixed.append(_interpolated(times, 1.0 + s * strays))
        inside = times[(times > step.t0) & (times < step.duration)]
        rig[step.name].marks += inside.tolist()


@cause((), "valve", "share of the flow", 0.9)
def gurgling_hose(rig: Rig, s: float, rng: np.random.Generator, case: Case) -> None:
    """Water stands where the hose before the manifold sags, and both gases get past it in gulps.

    Behind it pressure builds up until it gives way and falls back: the share ``s`` of the flow
    comes in bursts that die out, each of the same volume, the more often the larger the flow.  On a
    plateau nobody notices.
    """
    volume, opens, fall = case.V * _between(rng, 0.3, 1.5), rng.uniform(0.1, 0.35), 3.0
    for step in case.steps:
        period, begin = volume / step.total_flow, rng.random()

        def flow(t: FloatArray, period: float = period, begin: float = begin) -> FloatArray:
            opened = np.mod(t / period + begin, 1.0) / opens  # from 0 to 1 while it is
            burst = fall / (opens * -np.expm1(-fall)) * np.exp(-fall * opened)
            return np.asarray(1.0 - s + s * np.where(opened < 1.0, burst, 0.0))

        rig[step.name].all_flow.append(flow)
        for switch in (step.t0, step.tf):
            end = min(switch + 10.0 * (case.tau_v + case.V / step.total_flow), step.duration)
            first = np.ceil(switch / period + begin) - begin
            gulps = np.arange(first * period, end, period)
            edges = np.concatenate([gulps, gulps + opens * period]).tolist()
            inside = [at for at in edges if at < step.duration]
            rig[step.name].marks += _both_sides(inside)


@cause((), "spike", "share of the highest gas", 0.2, per_experiment=True)
def breathing_operator(rig: Rig, s: float, rng: np.random.Generator, case: Case) -> None:
    """The operator bends over the cell to look after it; its seal leaks, and his breath gets in.

    Exhaled air is rich in carbon dioxide and vapour.  He breathes some times, not quite evenly, and
    goes away; a breath flows out as half a sine.
    """
    period, out = _between(rng, 2.5, 5.0), rng.uniform(0.35, 0.55)
    certain = int(rng.integers(len(case.steps)))
    for k, step in enumerate(case.steps):
        at = rng.uniform(0.02, 0.7) * step.duration
        breaths = []
        for _ in range(int(rng.integers(2, 8))):
            lasts = period * rng.uniform(0.85, 1.15)
            breaths.append((at, out * lasts, rng.uniform(0.6, 1.0)))
            at += lasts
        most = s * case.highest_concentration * step.total_flow
        if k != certain and rng.random() < 0.4:
            continue

        def breath(
            t: FloatArray,
            breaths: tuple[tuple[float, float, float], ...] = tuple(breaths),
            most: float = most,
        ) -> FloatArray:
            total = np.zeros_like(t)
            for at, lasts, depth in breaths:
                total += depth * np.sin(pi * np.clip((t - at) / lasts, 0.0, 1.0))
            return most * total

        rig[step.name].seep.append(breath)
        edges = [edge for at, lasts, _ in breaths for edge in (at, at + lasts)]
        rig[step.name].marks += [edge for edge in edges if edge < step.duration]


@cause((), "plateau", "share of V", 0.3)
def sipping_chromatograph(rig: Rig, s: float, rng: np.random.Generator, case: Case) -> None:
    """A gas chromatograph on the same cell sucks in its sample now and then, as its program says.

    It takes more than the stream brings, and as much air as is missing, ``s`` V a sip, comes back
    through the exhaust.  That thins what is there, which recovers as the manifold is exchanged;
    without test gas nobody notices.
    """
    apart, lasts, air = _between(rng, 4.0, 20.0), _between(rng, 0.15, 1.0), s * case.V
    for step in case.steps:
        begin = apart * rng.random()
        sips = np.arange(begin, step.duration - lasts, apart)

        def drawn_in(
            t: FloatArray, begin: float = begin, flow: float = step.total_flow
        ) -> FloatArray:
            sipping = (t >= begin) & (np.mod(t - begin, apart) < lasts)
            return np.asarray(air / lasts / flow * sipping)

        def thinned(t: FloatArray, drawn_in: Course = drawn_in) -> FloatArray:
            return 1.0 / (1.0 + drawn_in(t))

        def more(t: FloatArray, drawn_in: Course = drawn_in) -> FloatArray:
            return 1.0 + drawn_in(t)

        rig[step.name].unmixed.append(thinned)
        rig[step.name].all_flow.append(more)
        edges = np.concatenate([sips, sips + lasts]).tolist()
        rig[step.name].marks += _both_sides(edges)


@cause((), "mixing", "share of V", 1.0, near=("axial_dispersion",))
def laminar_hose(rig: Rig, s: float, rng: np.random.Generator, case: Case) -> None:
    """The hose before the manifold is wide and short: the stream in it is laminar and never mixes.

    In the middle it is twice as fast as in the mean, at the wall it stands (Poiseuille): the share
    (volume of the hose/2/volume passed)^2 of a step is still on its way.  ``s`` V is that volume.
    """
    for knobs in rig.values():
        knobs.laminar = s


@cause((), "drift", "share of the highest gas", 0.15, near=("baseline_step",), per_experiment=True)
def wet_hose(rig: Rig, s: float, rng: np.random.Generator, case: Case) -> None:
    """The hose was rinsed, and water is left in it, which the stream takes up until it is dry.

    The ring does not tell its vapour from the test gas.  The film m gives off ``s`` (1 - exp(-m))
    where the wall is still covered, so that its end is a logistic curve of the volume passed.  It
    dries in the course of the first record, or of the second one.
    """
    last = 0 if rng.random() < 0.6 else min(1, len(case.steps) - 1)
    ending = case.steps[last]
    dry = rng.uniform(0.15, 0.85) * ending.duration * ending.total_flow
    patch = dry * _between(rng, 0.02, 0.2)
    dry += sum(step.total_flow * step.duration for step in case.steps[:last])
    passed = 0.0
    for step in case.steps[: last + 1]:
        q, most = step.total_flow, s * case.highest_concentration * step.total_flow

        def vapour(
            t: FloatArray, q: float = q, most: float = most, passed: float = passed
        ) -> FloatArray:
            return np.asarray(most * expit((dry - passed - q * t) / patch))

        rig[step.name].seep.append(vapour)
        rig[step.name].marks.append(-15.0 * case.V / q)  # the stream is moist before the record
        passed += q * step.duration


@cause((), "ripple", "relative", 0.08, fast=True)
def bubbling_exhaust(rig: Rig, s: float, rng: np.random.Generator, case: Case) -> None:
    """The exhaust hose hangs in a bucket of water: the gas leaves it bubble by bubble.

    While a bubble grows the pressure rises, and when it is gone it falls, by ``s`` of all of it;
    the coating takes up what the partial pressure is.  Bubbles are of nearly one volume, hence they
    come the more often, the larger the flow.
    """
    typical = float(np.median([step.total_flow for step in case.steps]))
    volume, grows = typical / _between(rng, 2.0, 10.0), rng.uniform(0.7, 0.9)
    uneven = rng.uniform(0.05, 0.25)
    for step in case.steps:
        count = int(step.total_flow * (step.duration + 6.0) / (volume * (1.0 - uneven))) + 2
        volumes = volume * (1.0 + uneven * rng.uniform(-1.0, 1.0, count))
        gone = np.cumsum(volumes) - 4.0 * step.total_flow - volumes[0] * rng.random()

        def pressure(
            t: FloatArray, gone: FloatArray = gone, q: float = step.total_flow
        ) -> FloatArray:
            bubble = np.mod(np.interp(q * t, gone, np.arange(len(gone))), 1.0)
            return np.asarray(s * np.interp(bubble, [0.0, grows, 1.0], [-0.5, 0.5, -0.5]))

        rig[step.name].concentration_gain.append(pressure)


@cause((), "mixing", "of V", 0.6, near=("axial_dispersion",))
def condensate_trap(rig: Rig, s: float, rng: np.random.Generator, case: Case) -> None:
    """Both gases pass a trap for condensate on their way, a second stirred volume of ``s`` V."""
    for knobs in rig.values():
        knobs.trap = s


@cause((), "plateau", "share of the response", 0.4, near=("slow_sorption",))
def dry_test_gas(rig: Rig, s: float, rng: np.random.Generator, case: Case) -> None:
    """The carrier is damp, the test gas is dry and thins its water, which the ring sees as well.

    Walls hold water: each change of humidity comes behind the gas, by as much volume as frees them
    of it, and takes ``s`` of the response in the end.
    """
    typical = float(np.median([step.total_flow for step in case.steps]))
    volume, n_cells = typical * _between(rng, 1.0, 6.0), int(rng.integers(1, 5))
    for knobs in rig.values():
        knobs.dried, knobs.dried_volume, knobs.dried_cells = s, volume, n_cells


@cause((), "tail", "of V", 1.0, near=("dead_volume",), reserve=True)
def analyser_loop(rig: Rig, s: float, rng: np.random.Generator, case: Case) -> None:
    """An analyser on the same cell pumps gas out, through its hoses, and back in again.

    It comes back as it went out, as much later as its pump needs for the hoses' volume of ``s`` V,
    whatever the stream is.
    """
    pumped = float(np.median([step.total_flow for step in case.steps])) * _between(rng, 0.3, 1.5)
    for knobs in rig.values():
        knobs.loop, knobs.loop_pumped = s, pumped


# --------------------------------------------------------------------------- sensor


@cause(("sensor_diffusion",), "delay", "share of tau", 1.0)
def layered_coating(rig: Rig, s: float, rng: np.random.Generator, case: Case) -> None:
    """Part of the sensor's delay is diffusion through a film of two layers."""
    for knobs in rig.values():
        knobs.film_share = s


@cause(("sorption_asymmetry",), "fall", "log of the rates", 1.2)
def gated_pores(rig: Rig, s: float, rng: np.random.Generator, case: Case) -> None:
    """Pores open under load and close behind it: uptake is faster than release, or slower."""
    sign = 1.0 if rng.random() < 0.7 else -1.0
    width = _between(rng, 0.002, 0.012)
    for knobs in rig.values():
        knobs.gate, knobs.gate_width = sign * s, width


@cause((), "fall", "K c", 3.0, near=("sorption_asymmetry",))
def site_kinetics(rig: Rig, s: float, rng: np.random.Generator, case: Case) -> None:
    """Langmuir kinetics read on a calibrated scale: the more gas, the faster the sensor."""
    for knobs in rig.values():
        knobs.langmuir = s


@cause((), "fall", "log of the rates", 2.0, near=("sorption_asymmetry",))
def swelling_film(rig: Rig, s: float, rng: np.random.Generator, case: Case) -> None:
    """The coating swells: the more it has taken up, the faster it takes up and gives off."""
    sign = _sign(rng)
    for knobs in rig.values():
        knobs.swelling = sign * s


@cause(("optical_nonlinearity", "sorption_asymmetry"), "fall", "K c", 1.0)
def saturating_sites(rig: Rig, s: float, rng: np.random.Generator, case: Case) -> None:
    """Langmuir kinetics seen as they are: the isotherm's bend shows in the voltage, too."""
    for knobs in rig.values():
        knobs.langmuir, knobs.curved = s, True


@cause(("slow_sorption",), "tail", "share", 0.2)
def slow_sites(rig: Rig, s: float, rng: np.random.Generator, case: Case) -> None:
    """Some sites fill and empty slowly, with a spread of times and a bent isotherm."""
    time = _between(rng, 3.0, 15.0)
    for knobs in rig.values():
        knobs.slow_sites, knobs.slow_sites_time = s, time


@cause((), "ageing", "relative, an experiment", 0.4, per_experiment=True)
def ageing_coating(rig: Rig, s: float, rng: np.random.Generator, case: Case) -> None:
    """The sensor slows down from experiment to experiment."""
    sign = 1.0 if rng.random() < 0.8 else -1.0
    for k, knobs in enumerate(rig.values()):
        knobs.tau_factor = float(np.exp(sign * np.log1p(s) * k))


@cause((), "fall", "share", 0.3)
def sensor_hysteresis(rig: Rig, s: float, rng: np.random.Generator, case: Case) -> None:
    """Uptake and release do not follow one line: part of the response has backlash."""
    for knobs in rig.values():
        knobs.backlash = s


@cause((), "tail", "share", 0.2, near=("slow_sorption",), per_experiment=True)
def sites_that_keep(rig: Rig, s: float, rng: np.random.Generator, case: Case) -> None:
    """Some sites bind the gas for good; experiment by experiment fewer of them are free."""
    time = _between(rng, 20.0, 200.0)
    free = s
    for step in case.steps:
        relative = case.relative_concentration(step)
        knobs = rig[step.name]
        knobs.bound, knobs.bound_time = free / relative, time / relative
        free *= float(np.exp(-(step.tf - step.t0) / knobs.bound_time))


@cause((), "plateau", "share lost", 0.3)
def condensation(rig: Rig, s: float, rng: np.random.Generator, case: Case) -> None:
    """Water condenses on the ring while test gas flows, blocks it in part, and dries off later."""
    onset, speed = rng.uniform(0.15, 0.7), rng.uniform(0.03, 0.12)
    drying = _between(rng, 2.0, 12.0)
    for step in case.steps:
        length = step.tf - step.t0
        size = s * rng.uniform(0.6, 1.4)

        def blocked(
            t: FloatArray,
            t0: float = step.t0,
            tf: float = step.tf,
            length: float = length,
            size: float = size,
        ) -> FloatArray:
            grown = 1.0 / (1.0 + np.exp(-((np.minimum(t, tf) - t0) / length - onset) / speed))
            return -size * grown * np.exp(-np.maximum(t - tf, 0.0) / drying)

        rig[step.name].concentration_gain.append(blocked)


@cause((), "level", "share of the highest step", 0.3, near=("slow_sorption",))
def flipping_cages(rig: Rig, s: float, rng: np.random.Generator, case: Case) -> None:
    """Above some concentration the crystal's cages flip open, in their own time, and take up more.

    The gate of ZIF-8 (Fairen-Jimenez et al., J. Am. Chem. Soc. 133, 8900, 2011); the weaker
    experiments may never reach it.
    """
    at, width = rng.uniform(0.35, 0.75), _between(rng, 0.03, 0.08)
    time = _between(rng, 0.3, 3.0)
    for knobs in rig.values():
        knobs.cages, knobs.cages_at, knobs.cages_width, knobs.cages_time = s, at, width, time


@cause((), "ripple", "relative", 0.08, fast=True)
def swinging_column(rig: Rig, s: float, rng: np.random.Generator, case: Case) -> None:
    """Each switch sets the water of the relief bubbler swinging; the ring feels partial pressure.

    A column of length l between two open ends swings at omega^2 = 2 g/l; 5 cm of water are half a
    per cent of the pressure, and of what the coating takes up.
    """
    omega, damping = sqrt(2.0 * 9.81 / rng.uniform(0.2, 0.8)), _between(rng, 1.5, 8.0)
    largest = max(step.test_gas_flow for step in case.steps)
    for step in case.steps:
        size = s * step.test_gas_flow / largest

        def pressure(
            t: FloatArray, t0: float = step.t0, tf: float = step.tf, size: float = size
        ) -> FloatArray:
            up, down = np.maximum(t - t0, 0.0), np.maximum(t - tf, 0.0)
            rising = np.exp(-up / damping) * np.sin(omega * up)
            return np.asarray(size * (rising - np.exp(-down / damping) * np.sin(omega * down)))

        rig[step.name].concentration_gain.append(pressure)


@cause((), "plateau", "share lost", 0.2, per_experiment=True)
def peeling_coating(rig: Rig, s: float, rng: np.random.Generator, case: Case) -> None:
    """Swollen with gas, the coating comes off in flakes: each takes a share of the response along.

    It does not come back; the next experiment begins with what is left.
    """
    certain = int(rng.integers(len(case.steps)))
    for k, step in enumerate(case.steps):
        times = np.sort(rng.uniform(0.1, 1.0, int(rng.integers(1, 4))))
        at = step.t0 + times * (step.tf - step.t0)
        left = np.append(1.0, np.cumprod(1.0 - s * rng.uniform(0.3, 1.0, len(at))))
        if k != certain and rng.random() < 0.5:
            continue

        def lost(t: FloatArray, at: FloatArray = at, left: FloatArray = left) -> FloatArray:
            return np.asarray(left[np.searchsorted(at, t, side="right")] - 1.0)

        rig[step.name].concentration_gain.append(lost)
        rig[step.name].marks += [edge for flake in at.tolist() for edge in (flake - 1e-6, flake)]


@cause((), "plateau", "share of the sites", 0.4, near=("slow_sorption",))
def displaced_water(rig: Rig, s: float, rng: np.random.Generator, case: Case) -> None:
    """The carrier is damp: water holds the share ``s`` of the sites until the gas displaces it.

    Both compete for free sites (Langmuir); the gas settles at once with the water, which comes and
    goes slowly.  While it goes the response grows; without gas nobody sees it come back.
    """
    time, load = _between(rng, 2.0, 15.0), _between(rng, 1.0, 4.0)
    for step in case.steps:
        knobs = rig[step.name]
        knobs.damp, knobs.damp_time = s, time
        knobs.displacing = load * case.relative_concentration(step)


@cause((), "tail", "log of the uptake", 0.4, near=("slow_sorption",))
def heat_of_sorption(rig: Rig, s: float, rng: np.random.Generator, case: Case) -> None:
    """Gas that settles warms the coating, which then holds less; leaving, it cools it and is kept.

    Non-isothermal sorption (Ruthven, Lee and Yucel, AIChE J. 26, 16, 1980): the more gas, the
    warmer.  The last of the way is as slow as the heat that goes into the chip.
    """
    time = _between(rng, 1.0, 8.0)
    for step in case.steps:
        knobs = rig[step.name]
        knobs.sorption_heat, knobs.cooling_time = s * case.relative_concentration(step), time


@cause((), "tail", "share", 0.3, near=("slow_sorption",))
def splitting_molecules(rig: Rig, s: float, rng: np.random.Generator, case: Case) -> None:
    """On some sites the molecules split; the halves must meet again before they can leave.

    They settle at the root of the concentration (Sieverts' law) and leave in pairs: what is left
    falls as one over time, and fills the more slowly, the less gas there is.  At the highest
    concentration such sites make the share ``s`` of the response.
    """
    time = _between(rng, 0.2, 2.0)
    for step in case.steps:
        knobs, root = rig[step.name], sqrt(case.relative_concentration(step))
        knobs.split, knobs.split_time = s / ((1.0 - s) * root + s), time


@cause((), "tail", "share of the highest step", 0.3, near=("slow_sorption",))
def converting_film(rig: Rig, s: float, rng: np.random.Generator, case: Case) -> None:
    """Above some concentration the coating turns into another phase, below it back again.

    As a hydride does: behind a sharp front, which gas must reach through what has turned already.
    It goes as the root of time and stops at the bottom; the way back starts at the surface anew.
    """
    level, time = rng.uniform(0.1, 0.35), _between(rng, 3.0, 30.0)
    for knobs in rig.values():
        knobs.converting, knobs.converting_at, knobs.converting_time = s, level, time


@cause((), "plateau", "log of the uptake", 0.25, near=("gain_drift",), per_experiment=True)
def sun_on_the_cell(rig: Rig, s: float, rng: np.random.Generator, case: Case) -> None:
    """The sun shines on the cell whenever no cloud is before it; warm, the coating takes up less.

    Uptake falls exponentially with temperature (van 't Hoff), which follows the sun in the cell's
    time.  Without gas nobody notices.
    """
    time, lasting = _between(rng, 2.0, 15.0), _between(rng, 4.0, 20.0)
    for step in case.steps:
        edges, sun = [0.0, lasting * rng.random()], [float(rng.random() < 0.5)]
        while edges[-1] < step.duration:
            edges.append(edges[-1] + lasting * rng.uniform(0.3, 1.7))
        warmth = [sun[0]]  # at every edge
        for begin, end in pairwise(edges):
            warmth.append(sun[-1] + (warmth[-1] - sun[-1]) * float(np.exp((begin - end) / time)))
            sun.append(1.0 - sun[-1])

        def less(
            t: FloatArray,
            edges: tuple[float, ...] = tuple(edges),
            sun: tuple[float, ...] = tuple(sun),
            warmth: tuple[float, ...] = tuple(warmth),
        ) -> FloatArray:
            k = np.maximum(np.searchsorted(edges, t, side="right") - 1, 0)
            left = np.exp(-np.maximum(t - np.take(edges, k), 0.0) / time)
            level = np.take(sun, k)
            return np.asarray(np.expm1(-s * (level + (np.take(warmth, k) - level) * left)))

        rig[step.name].concentration_gain.append(less)


@cause((), "tail", "share", 0.3, near=("slow_sorption",))
def glassy_rim(rig: Rig, s: float, rng: np.random.Generator, case: Case) -> None:
    """The coating has dried to a thick glassy rim, into which the gas eats its way evenly.

    Case II transport (Thomas and Windle, Polymer 23, 529, 1982): the front's speed is the
    swelling's, which goes with the concentration, so that this share of the response rises in a
    straight line and stops when the rim is through.  From the soft rim the gas leaves by diffusion.
    """
    time, quicker = _between(rng, 1.0, 8.0), rng.uniform(0.1, 0.5)
    for knobs in rig.values():
        knobs.rim, knobs.rim_time, knobs.rim_back = s, time, quicker * time


@cause((), "tail", "share of the highest step", 0.3, near=("slow_sorption",))
def spreading_islands(rig: Rig, s: float, rng: np.random.Generator, case: Case) -> None:
    """On the coating the gas condenses in islands, which spread evenly until they have met.

    Above their vapour pressure they grow, below it they shrink, each in proportion to what is too
    much or missing; 1 - exp(-radius^2) is covered (Avrami, J. Chem. Phys. 8, 212, 1940).  So little
    comes at first, and when the gas has gone most of it stays for a while.
    """
    vapour, time = _between(rng, 0.1, 0.35), _between(rng, 0.2, 2.0)
    for knobs in rig.values():
        knobs.islands, knobs.islands_vapour, knobs.islands_time = s, vapour, time


@cause((), "plateau", "share displaced", 0.35)
def late_impurity(rig: Rig, s: float, rng: np.random.Generator, case: Case) -> None:
    """The test gas brings an impurity along, which a filter before the ring holds back for long.

    As in a chromatograph it comes through after the same volume of gas, sooner at larger flow, or
    not at all while the test gas lasts.  On the ring it competes for the sites (Langmuir): ``s`` of
    the response is gone at the highest concentration once all of it has arrived.
    """
    typical = float(np.median([p.total_flow * (p.tf - p.t0) for p in case.steps]))
    volume, n_cells = typical * _between(rng, 0.12, 0.6), int(rng.integers(10, 31))
    for step in case.steps:
        knobs = rig[step.name]
        knobs.impurity = s / (1.0 - s) * case.relative_concentration(step)
        knobs.impurity_volume, knobs.impurity_cells = volume, n_cells


@cause((), "fall", "share of the highest step", 0.4, near=("sorption_asymmetry",))
def capillary_condensation(rig: Rig, s: float, rng: np.random.Generator, case: Case) -> None:
    """In the coating's pores vapour condenses, in narrow ones first, and leaves them far later.

    An open pore fills from its wall, a full one empties from its ends, whose meniscus is the more
    bent: at the square of the relative pressure at which it filled (Cohan, J. Am. Chem. Soc. 60,
    433, 1938).  All of them together add the share ``s`` of the highest response.
    """
    vapour, width = rng.uniform(0.5, 0.9), _between(rng, 0.05, 0.2)
    at = vapour * rng.uniform(0.3, 0.75)
    for knobs in rig.values():
        knobs.pores, knobs.pores_vapour = s, vapour
        knobs.pores_at, knobs.pores_width = at, width


@cause((), "plateau", "share lost", 0.6)
def poisoned_coating(rig: Rig, s: float, rng: np.random.Generator, case: Case) -> None:
    """Something in the test gas poisons the coating: sites that hold it die, and do not come back.

    Each as likely at any time, so that what is left falls exponentially with the dose; all
    experiments together cost the share ``s``.
    """
    doses = [case.relative_concentration(step) * (step.tf - step.t0) for step in case.steps]
    rate = -np.log1p(-s) / sum(doses)
    had = 0.0
    for step, dose in zip(case.steps, doses, strict=True):
        rig[step.name].poisoning, rig[step.name].alive = float(rate), float(np.exp(-rate * had))
        had += dose


@cause((), "level", "share of the highest step", 0.4, near=("slow_sorption",), reserve=True)
def igniting_coating(rig: Rig, s: float, rng: np.random.Generator, case: Case) -> None:
    """The coating is a catalyst on which the gas burns: beyond some concentration it ignites.

    Burning goes exponentially with its warmth until it takes all that diffusion brings (Frank-
    Kamenetskii, Diffusion and Heat Transfer in Chemical Kinetics, 1969).  Just beyond, the heat
    takes long to run away; once hot it goes on burning below.  Heat moves the line, at the highest
    concentration by ``s`` of the response.
    """
    ignites, time = rng.uniform(0.3, 0.7), _between(rng, 0.5, 4.0)
    brought = rng.uniform(4.5, 8.0) / ignites
    # with warmth = gas/(exp(-warmth)/burns + 1/brought) the gas is at its most where it ignites
    product = ignites * brought
    warmth = 0.5 * (product - sqrt(product**2 - 4.0 * product))
    burns = brought * (warmth - 1.0) * float(np.exp(-warmth))
    hottest = brought
    for _ in range(100):
        hottest = 1.0 / (float(np.exp(-hottest)) / burns + 1.0 / brought)
    for knobs in rig.values():
        knobs.glow, knobs.glow_time = s / hottest, time
        knobs.glow_burns, knobs.glow_brought = burns, brought


# --------------------------------------------------------------------------- readout


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


def _interpolated(times: FloatArray, values: FloatArray) -> Course:
    return lambda t: np.asarray(np.interp(t, times, values), dtype=float)


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
        rig[step.name].marks += _both_sides(edges[edges < step.duration].tolist())


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


@cause((), "fall", "share lost", 0.7, reserve=True)
def bent_beam(rig: Rig, s: float, rng: np.random.Generator, case: Case) -> None:
    """The light crosses the cell on its way to the chip; fresh gas beside old gas bends it.

    As the air over a hot road does: it goes off as far as the inlet's gas differs from what is in
    the cell, and of a Gaussian beam before a fibre 1 - (1 - ``s``)^(difference^2) is lost, a whole
    one that of the highest concentration.  Once the gas is mixed nobody notices.
    """
    for knobs in rig.values():
        knobs.bending = s


@cause((), "line", "relative", 0.1, fast=True, reserve=True)
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


# --------------------------------------------------------------------------- electronics


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


@cause((), "delay", "times too slow", 2.0)
def sluggish_lock(rig: Rig, s: float, rng: np.random.Generator, case: Case) -> None:
    """The laser's lock follows the resonance no faster than its piezo moves: steep parts lag."""
    steepest = 0.0
    for step in case.steps:
        reach = 8.0 * (case.tau_v + case.V / step.total_flow)
        t = step.t0 + np.linspace(0.0, min(reach, step.tf - step.t0), 2001)
        y, _ = voltage(case, step, Knobs(), t)
        steepest = max(steepest, float(np.abs(np.diff(y)).max() / (t[1] - t[0])))
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
        rig[step.name].marks += _both_sides(np.concatenate([slots, slots + frame / 8.0]).tolist())


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


@cause((), "level", "s", 1.5, reserve=True)
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


@cause((), "delay", "s", 1.5, reserve=True)
def hurried_display(rig: Rig, s: float, rng: np.random.Generator, case: Case) -> None:
    """The meter adds ``s`` times the slope, to show at once where a slow probe would end up.

    It was made for another probe; with this one a step comes too early and goes too far.  The slope
    is that behind a short lag, and the noise comes behind it.
    """
    short = rng.uniform(0.05, 0.25)
    for knobs in rig.values():
        knobs.lead, knobs.lead_lag = s, short * s


# --------------------------------------------------------------------------- noise


def _noise_only(rig: Rig, s: float, rng: np.random.Generator, case: Case) -> None:
    """Nothing to turn on the rig: the noise or the converter changes."""


def tail_mixture(case: Case) -> tuple[float, float]:
    """(share of wild innovations, how many times as large they are) of a case."""
    strength = case.strengths.get("wild_samples", 0.0)
    if strength == 0.0:
        return 0.0, 1.0
    share = CAUSES["wild_samples"].generator(case).uniform(0.003, 0.03)
    return float(share), 1.0 + strength


def converter_step(case: Case) -> float:
    """V, the recorder's step, coarse where the range is set too wide."""
    strength = case.strengths.get("coarse_range", 0.0)
    return max(case.lsb, strength * case.noise.sigma0)


CAUSES["wild_samples"] = Cause(
    "wild_samples", ("heavy_tails",), "noise", "times sigma beyond 1", 8.0, _noise_only, noise=True
)
CAUSES["coarse_range"] = Cause(
    "coarse_range", ("quantisation",), "noise", "sigma0 a step", 3.0, _noise_only, noise=True
)
