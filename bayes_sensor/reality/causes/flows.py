"""The flows: bottles, regulators, controllers and hoses that bring carrier and test gas."""

from __future__ import annotations

from collections.abc import Callable
from itertools import pairwise
from math import pi

import numpy as np
from scipy.special import exprel, lambertw

from bayes_sensor.campaign import FloatArray
from bayes_sensor.reality.causes.cause import Causes, Rig, _between, _sign
from bayes_sensor.reality.records import Case, Step
from bayes_sensor.reality.rig import both_sides

CAUSES = Causes()
cause = CAUSES.cause


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
        rig[step.name].marks += both_sides(snaps.tolist())


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
        rig[step.name].marks += both_sides(inside)


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
        rig[step.name].marks += both_sides(turns)


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


@cause((), "tail", "relative", 0.6, near=("flow_settling",))
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


@cause((), "plateau", "log of the output", 0.6, near=("flow_settling",))
def ozone_lamp(rig: Rig, s: float, rng: np.random.Generator, case: Case) -> None:
    """The test gas is ozone, made by a mercury lamp that is turned on with the valve, and cold.

    Its coldest spot sets the vapour's pressure: with too little of it there is little to glow, with
    too much the light is caught again.  So the output comes up to its best, exp(``s``) times that
    of a warm lamp, and goes past it (bell-shaped in temperature); by the next record it is cold.
    """
    best, time = rng.uniform(0.35, 0.7), _between(rng, 1.5, 12.0)
    for step in case.steps:

        def output(t: FloatArray, on: float = step.commanded_on) -> FloatArray:
            warmth = -np.expm1(-np.maximum(t - on, 0.0) / time)
            return np.asarray(np.exp(s * (1.0 - ((warmth - best) / (1.0 - best)) ** 2)))

        rig[step.name].unmixed.append(output)


@cause((), "flow", "log of the flow", 0.9, near=("flow_error", "flow_switching"))
def foreign_gas_factor(rig: Rig, s: float, rng: np.random.Generator, case: Case) -> None:
    """The test gas's controller was calibrated for another gas, and nobody has entered the factor.

    Thermal controllers count heat: of a gas that carries more they let through less, in all
    experiments by the same factor, exp(``s``) or one over it.  The carrier's is right, so that the
    exchange is off while the test gas flows, the more the more of it there is, and right after it.
    """
    factor = float(np.exp(_sign(rng) * s))
    for knobs in rig.values():
        knobs.test_gas.append(lambda t: np.full_like(t, factor))
        knobs.mixing = True


@cause((), "ripple", "relative", 0.4)
def unstable_controller(rig: Rig, s: float, rng: np.random.Generator, case: Case) -> None:
    """The test gas's controller has too much gain: above some flow it begins to swing by itself.

    The opening line sets it off; from there the swing grows exponentially up to a size that is the
    root of what the flow is beyond that, ``s`` at the largest (Hopf's bifurcation: r' = growth r
    (beyond - r^2)).  Below it dies away, the more slowly the nearer.
    """
    onset, rate = rng.uniform(0.3, 0.75), _between(rng, 0.15, 0.8)
    growth, kick = _between(rng, 0.3, 2.0), rng.uniform(0.05, 0.3)
    largest = max(step.test_gas_flow for step in case.steps)
    for step in case.steps:
        beyond = (step.test_gas_flow / largest - onset) / (1.0 - onset)

        def flow(t: FloatArray, t0: float = step.t0, beyond: float = beyond) -> FloatArray:
            since = np.maximum(t - t0, 0.0)
            z = 2.0 * growth * beyond * since
            # (1 - exp(-z))/beyond, which has a limit where that is 0
            grown = 2.0 * growth * since * exprel(-z)
            size = kick / np.sqrt(np.exp(-z) + kick**2 * grown)
            return np.asarray(1.0 + s * size * np.sin(2.0 * pi * rate * since))

        rig[step.name].test_gas.append(flow)


@cause((), "plateau", "share of the balloon", 0.7)
def rubber_balloon(rig: Rig, s: float, rng: np.random.Generator, case: Case) -> None:
    """The test gas comes out of a rubber balloon, of which the campaign draws the share ``s``.

    A balloon's pressure goes as 1/stretch - 1/stretch^7 (Mueller and Strehlow, Rubber and Rubber
    Balloons, 2004): it rises as the balloon shrinks, ever faster, up to a stretch of 7^(1/6), and
    then it collapses.  Through a needle that is set anew at each beginning the flow goes with it.
    """
    stretch = rng.uniform(1.6, 2.6)
    drawn = sum(step.test_gas_flow * (step.tf - step.t0) for step in case.steps)
    slack = drawn / (s * stretch**3)  # mL of the balloon that is not stretched

    def pressure(stretch: FloatArray | float) -> FloatArray:
        return np.asarray(stretch**-1.0 - stretch**-7.0)

    for step in case.steps:
        shrinks = 1.0 + (stretch - 1.0) * np.exp(-np.linspace(0.0, 12.0, 6001))
        set_to = float(pressure(stretch))
        # slack 3 stretch^2 stretch' = -flow pressure/set_to, by separation
        slowness = 3.0 * shrinks**2 / pressure(shrinks) * slack * set_to / step.test_gas_flow
        middle = 0.5 * (slowness[1:] + slowness[:-1])
        passed = np.concatenate([[0.0], np.cumsum(-middle * np.diff(shrinks))])

        def flow(
            t: FloatArray, step: Step = step, passed: FloatArray = passed,
            shrinks: FloatArray = shrinks, set_to: float = set_to,
        ) -> FloatArray:  # fmt: skip
            since = np.clip(t, step.t0, step.tf) - step.t0
            return pressure(np.interp(since, passed, shrinks)) / set_to

        rig[step.name].test_gas.append(flow)
        stretch = float(np.interp(step.tf - step.t0, passed, shrinks))


@cause((), "plateau", "share of the vapour", 0.5)
def drying_wick(rig: Rig, s: float, rng: np.random.Generator, case: Case) -> None:
    """The test gas takes up its vapour from a wick, which its liquid climbs too slowly.

    At the largest flow it brings the share ``s`` less than is carried off.  What the wick holds
    makes up for that, until it falls dry from its end on; then as much of it stays wet as the
    climbing liquid can keep so.  Weaker flows may never dry it; shut off, it soaks up again.
    """
    largest = max(step.test_gas_flow for step in case.steps)
    typical = float(np.median([step.tf - step.t0 for step in case.steps]))
    brought = (1.0 - s) * largest
    patch = largest * _between(rng, 0.5, 4.0)  # held where all of it is only just wet
    full = patch + s * largest * rng.uniform(0.15, 0.5) * typical
    held, rested = full, 0.0
    for step in case.steps:
        flow, lasts = step.test_gas_flow, step.tf - step.t0
        # all of it is wet again: a rest is longer than the patch takes to fill
        at_start = min(full, max(held + brought * (rested + step.t0), patch))
        stays = min(brought / flow, 1.0)
        dries = (at_start - patch) / (flow - brought) if stays < 1.0 else np.inf

        def wet(
            since: FloatArray | float, dries: float = dries, stays: float = stays,
            flow: float = flow,
        ) -> FloatArray:  # fmt: skip
            dry = np.maximum(np.asarray(since) - dries, 0.0)
            return np.asarray(stays + (1.0 - stays) * np.exp(-dry * flow / patch))

        if dries < lasts:
            held = float(wet(lasts)) * patch
            rig[step.name].marks.append(step.t0 + dries)
        else:
            held = min(full, at_start + (brought - flow) * lasts)

        def vapour(
            t: FloatArray, t0: float = step.t0, tf: float = step.tf, held: float = held,
            wet: Callable[[FloatArray], FloatArray] = wet,
        ) -> FloatArray:  # fmt: skip
            soaked = np.minimum((held + brought * (t - tf)) / patch, 1.0)
            return np.where(t < tf, wet(np.maximum(t - t0, 0.0)), soaked)

        rig[step.name].unmixed.append(vapour)
        rested = step.duration - step.tf


@cause((), "plateau", "s", 0.6)
def twin_syringes(rig: Rig, s: float, rng: np.random.Generator, case: Case) -> None:
    """Two syringes bring the test gas by turns, and their nut has play.

    When one of them is empty the pump turns round, and until the nut bears on the other flank of
    its thread the screw turns for nothing: no test gas comes, for ``s`` at the largest flow and the
    longer, the slower the pump is.  It stands while the valve is shut, and goes on where it stood.
    """
    largest = max(step.test_gas_flow for step in case.steps)
    typical = float(np.median([step.test_gas_flow for step in case.steps]))
    stroke, play = typical * _between(rng, 4.0, 16.0), s * largest  # mL of the screw's way
    gone = stroke * rng.random()
    for step in case.steps:
        q, lasts = step.test_gas_flow, step.tf - step.t0

        def flow(t: FloatArray, step: Step = step, q: float = q, gone: float = gone) -> FloatArray:
            way = gone + q * (np.clip(t, step.t0, step.tf) - step.t0)
            return np.asarray(np.mod(way, stroke) >= play, dtype=float)

        rig[step.name].test_gas.append(flow)
        turns = stroke * np.arange(np.floor(gone / stroke), np.ceil((gone + q * lasts) / stroke))
        edges = step.t0 + (np.concatenate([turns, turns + play]) - gone) / q
        inside = (edges > step.t0) & (edges < step.tf)
        rig[step.name].marks += both_sides(edges[inside].tolist())
        gone += q * lasts


@cause((), "ripple", "relative", 0.9)
def squeezed_bag(rig: Rig, s: float, rng: np.random.Generator, case: Case) -> None:
    """The test gas is pressed out of a bag by hand, one squeeze after the other.

    Each begins with ``s`` too much flow, and ends with as much too little since the fingers give
    way evenly.  The hand keeps no time, but minds that every squeeze brings what its time should.
    """
    mean = _between(rng, 1.2, 6.0)
    for step in case.steps:
        n = int(np.ceil((step.duration - step.t0) / (0.5 * mean))) + 1
        begins = step.t0 + np.concatenate([[0.0], np.cumsum(mean * rng.uniform(0.5, 1.5, n))])

        def flow(t: FloatArray, begins: FloatArray = begins) -> FloatArray:
            k = np.clip(np.searchsorted(begins, t, side="right") - 1, 0, len(begins) - 2)
            share = (t - begins[k]) / (begins[k + 1] - begins[k])
            return np.where(t < begins[0], 1.0, 1.0 + s * (1.0 - 2.0 * share))

        rig[step.name].test_gas.append(flow)
        rig[step.name].marks += both_sides(begins[begins < step.duration].tolist())
