"""The way of the gas from the valve over the ring to the exhaust: hoses, volumes, walls."""

from __future__ import annotations

from math import pi, sqrt

import numpy as np
from scipy.special import erfcx, expit

from bayes_sensor.campaign import FloatArray
from bayes_sensor.reality.causes.cause import Causes, Rig, _begins, _between, _interpolated
from bayes_sensor.reality.knobs import Course
from bayes_sensor.reality.records import Case
from bayes_sensor.reality.rig import both_sides

CAUSES = Causes()
cause = CAUSES.cause


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
            rig[step.name].marks += both_sides(inside)


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
        rig[step.name].marks += both_sides(edges)


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


@cause((), "tail", "of V", 1.0, near=("dead_volume",))
def analyser_loop(rig: Rig, s: float, rng: np.random.Generator, case: Case) -> None:
    """An analyser on the same cell pumps gas out, through its hoses, and back in again.

    It comes back as it went out, as much later as its pump needs for the hoses' volume of ``s`` V,
    whatever the stream is.
    """
    pumped = float(np.median([step.total_flow for step in case.steps])) * _between(rng, 0.3, 1.5)
    for knobs in rig.values():
        knobs.loop, knobs.loop_pumped = s, pumped


@cause((), "fall", "share not mixed", 0.85, near=("dead_volume",))
def filling_from_below(rig: Rig, s: float, rng: np.random.Generator, case: Case) -> None:
    """Heavy gas fills the manifold from its floor, where the ring is; carrier stays at its ceiling.

    Two layers (Baines and Turner, J. Fluid Mech. 37, 51, 1969): what is heavier than the lower one
    goes there and lifts that into the upper one, whence all leaves; what is lighter passes above
    it, and only eddies bring the lower one away.  They move 1/``s`` - 1 times the stream at the
    highest concentration, and more of less heavy gas.
    """
    floor = rng.uniform(0.2, 0.6)
    for step in case.steps:
        knobs = rig[step.name]
        knobs.unmixed_layers, knobs.floor = s * case.relative_concentration(step), floor


@cause((), "mixing", "share of V", 0.5, near=("dead_volume",))
def resting_fan(rig: Rig, s: float, rng: np.random.Generator, case: Case) -> None:
    """The fan that mixes the manifold runs and rests by turns, as its timer says.

    While it rests the stream flushes all but the share ``s``, which stands behind the fan as it is
    and is mixed in at once when the fan starts: gas that seemed gone comes back, or a rise sinks.
    """
    turn, runs = _between(rng, 1.5, 12.0), rng.uniform(0.2, 0.6)
    for step in case.steps:
        begin = rng.random()

        def running(t: FloatArray, begin: float = begin) -> FloatArray:
            return np.asarray(np.mod(t / turn + begin, 1.0) < runs, dtype=float)

        rig[step.name].corner, rig[step.name].fan = s, running
        turns = np.arange(0.0, step.duration / turn + 2.0) - begin
        edges = np.concatenate([turns, turns + runs]) * turn
        inside = (edges > step.t0) & (edges < step.duration)
        rig[step.name].marks += both_sides(edges[inside].tolist())


@cause((), "fall", "share of the flow", 0.6, near=("flow_switching",))
def heavy_exhaust_riser(rig: Rig, s: float, rng: np.random.Generator, case: Case) -> None:
    """The exhaust hose goes up to the roof, and a weak blower must lift what stands in it.

    Full of the highest concentration it weighs so much that the share ``s`` of both flows is lost.
    It fills only with what has left the manifold, so that a rise is over before the flow has sunk;
    a fall begins with the sunken one, until the hose is full of carrier again.
    """
    volume = case.V * _between(rng, 0.7, 5.0)
    for step in case.steps:
        knobs = rig[step.name]
        knobs.riser, knobs.riser_volume = s * case.relative_concentration(step), volume


@cause((), "spike", "share of the gas", 0.35)
def worn_sampling_valve(rig: Rig, s: float, rng: np.random.Generator, case: Case) -> None:
    """A rotary valve draws samples from this rig and from a neighbour's by turns, and is worn.

    While it stands on the neighbour's the share ``s`` of what gets to the ring is his gas, of some
    concentration that he never changes: on a baseline there is more, on a plateau less, or more.
    The hose behind the valve must be flushed after each turn.
    """
    every, share = _between(rng, 4.0, 20.0), rng.uniform(0.25, 0.6)
    level, flush = rng.uniform(0.0, 0.9), _between(rng, 0.05, 0.5)
    for step in case.steps:
        knobs, begin = rig[step.name], every * rng.random()

        def his(t: FloatArray, begin: float = begin) -> FloatArray:
            return np.asarray(np.mod(t - begin, every) < share * every, dtype=float)

        knobs.stray, knobs.stray_turn, knobs.stray_flush = s, his, flush
        knobs.stray_level = level / case.relative_concentration(step)
        turns = begin + every * np.arange(-1.0, step.duration / every + 1.0)
        edges = np.concatenate([turns, turns + share * every])
        inside = (edges > 0.0) & (edges < step.duration)
        knobs.marks += both_sides(edges[inside].tolist())


@cause((), "fall", "of V", 1.5, near=("dead_volume", "valve_asymmetry"))
def flushed_backwards(rig: Rig, s: float, rng: np.random.Generator, case: Case) -> None:
    """A four-way valve turns the stream round when the test gas is shut off, to flush backwards.

    So the purge comes by way of the exhaust hose, and pushes what that is full of, ``s`` V of the
    plateau's gas, back into the manifold before it: along the hose's axis at once, from its wall
    ever more slowly, as a laminar stream goes.  A rise knows nothing of that hose.
    """
    for knobs in rig.values():
        knobs.flushed_back = s


@cause((), "plateau", "relative", 0.3, per_experiment=True)
def neighbours_airlock(rig: Rig, s: float, rng: np.random.Generator, case: Case) -> None:
    """The cell is pumped, and on the same line a neighbour now and then pumps down his airlock.

    Of a sudden the pressure is ``s`` too high, at most, and falls as the pump empties the lock.
    The ring feels the test gas's partial pressure; and since the controllers meter mass, the denser
    gas takes longer to go through the manifold.
    """
    pumping, certain = _between(rng, 1.5, 9.0), int(rng.integers(len(case.steps)))
    for k, step in enumerate(case.steps):
        at = step.t0 + rng.uniform(0.1, 0.9) * (step.tf - step.t0)
        size = s if k == certain else s * rng.uniform(0.3, 1.0)
        if k != certain and rng.random() < 0.3:
            continue

        def beyond(t: FloatArray, at: float = at, size: float = size) -> FloatArray:
            return np.where(t < at, 0.0, size * np.exp(-np.maximum(t - at, 0.0) / pumping))

        def thinner(t: FloatArray, beyond: Course = beyond) -> FloatArray:
            return np.asarray(1.0 / (1.0 + beyond(t)))

        rig[step.name].concentration_gain.append(beyond)
        rig[step.name].all_flow.append(thinner)
        rig[step.name].marks += both_sides([at])


@cause((), "plateau", "of V", 0.5, near=("dead_volume", "axial_dispersion"))
def heated_hose(rig: Rig, s: float, rng: np.random.Generator, case: Case) -> None:
    """The hose is heated against condensation, by a thermostat that switches on and off.

    Its wall holds as much gas as ``s`` V of the stream does where it is coldest, and less where it
    is warm: heating drives part of that out, cooling takes it up again, evenly either way.
    """
    colder, period = rng.uniform(0.5, 1.5), _between(rng, 5.0, 30.0)
    heats, begins = rng.uniform(0.2, 0.5), _begins(case) + period * rng.random()
    for begin, step in zip(begins.tolist(), case.steps, strict=False):

        def held(t: FloatArray, begin: float = begin) -> FloatArray:
            turn = np.mod((begin + t) / period, 1.0)
            warm = np.where(turn < heats, turn / heats, (1.0 - turn) / (1.0 - heats))
            return np.asarray(s * np.exp(-colder * warm))

        rig[step.name].heated = held
        n = np.arange(np.floor(begin / period), np.ceil((begin + step.duration) / period))
        turns = np.concatenate([n, n + heats]) * period - begin
        rig[step.name].marks += turns[(turns > 0.0) & (turns < step.duration)].tolist()


@cause((), "mixing", "share of V", 0.8, near=("flow_error",), per_experiment=True)
def standing_water(rig: Rig, s: float, rng: np.random.Generator, case: Case) -> None:
    """The humidifier spits, and water gathers in the manifold until the drain siphons it off.

    It rises evenly and takes the share ``s`` of V when the siphon starts, which empties it at once.
    The less room is left the faster the gas is exchanged; a plateau does not show it.
    """
    begins = _begins(case)
    fills = _between(rng, 0.3, 3.0) * float(np.mean(np.diff(begins)))
    begins = begins + fills * rng.random()
    for begin, step in zip(begins.tolist(), case.steps, strict=False):

        def standing(t: FloatArray, begin: float = begin) -> FloatArray:
            return np.asarray(s * np.mod((begin + t) / fills, 1.0))

        rig[step.name].standing = standing
        drains = np.arange(np.ceil(begin / fills), (begin + step.duration) / fills) * fills - begin
        rig[step.name].marks += both_sides(drains.tolist())


@cause((), "fall", "share of the response", 0.8, near=("optical_nonlinearity",), reserve=True)
def ripening_gas(rig: Rig, s: float, rng: np.random.Generator, case: Case) -> None:
    """Two molecules of the test gas make one of another kind, which is what the ring feels most.

    So gas must ripen in the manifold first: the thinner it is, the more slowly, with the square of
    what is not ripe yet.  Ripe or not, it is flushed as ever.  The share ``s`` of the response is
    the ripe gas's.
    """
    typical = float(np.median([step.total_flow for step in case.steps]))
    rate = _between(rng, 0.2, 2.0) * typical / case.V
    for step in case.steps:
        knobs = rig[step.name]
        knobs.ripening, knobs.ripening_rate = s, rate * case.relative_concentration(step)


@cause((), "mixing", "of V", 0.8, fast=True, reserve=True)
def tidal_stream(rig: Rig, s: float, rng: np.random.Generator, case: Case) -> None:
    """A bellows further down breathes: the stream goes to and fro in the hose in which the ring is.

    By ``s`` V either way, on top of its own pace: what has just passed comes back and passes anew.
    Where all the gas is alike nobody notices.
    """
    rate = _between(rng, 0.4, 3.0)
    for step in case.steps:
        knobs = rig[step.name]
        knobs.tide, knobs.tide_rate, knobs.tide_begin = s, rate, rng.random()
        reach = 10.0 * (case.tau_v + case.V / step.total_flow)
        for switch in (step.t0, step.tf):
            marks = np.arange(switch, min(switch + reach, step.duration), 0.1 / rate)
            knobs.marks += marks.tolist()[1:]
