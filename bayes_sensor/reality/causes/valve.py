"""The valve and what drives it: how it opens and shuts, and how tightly."""

from __future__ import annotations

import numpy as np

from bayes_sensor.campaign import FloatArray
from bayes_sensor.reality.causes.cause import Causes, Rig, _between, _sign
from bayes_sensor.reality.records import Case
from bayes_sensor.reality.rig import both_sides

CAUSES = Causes()
cause = CAUSES.cause


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


@cause((), "delay", "share of the stroke", 0.9, near=("finite_stroke",))
def snapping_diaphragm(rig: Rig, s: float, rng: np.random.Generator, case: Case) -> None:
    """The valve's diaphragm is bowed like an oil can's lid: it gives a little, then snaps through.

    What drives it comes and goes as ever; the share ``s`` of the stroke is done at once, and on the
    way back at a lower pressure than on the way there.
    """
    up, down = rng.uniform(0.6, 0.85), rng.uniform(0.15, 0.4)
    for knobs in rig.values():
        knobs.snap, knobs.snap_up, knobs.snap_down = s, up, down


@cause((), "delay", "s", 2.0, near=("dead_volume",))
def shut_between_ports(rig: Rig, s: float, rng: np.random.Generator, case: Case) -> None:
    """A rotary valve is shut between its ports, and turns for ``s``, while both gases press on.

    Nothing moves meanwhile, and nobody notices, as nothing would have changed; then all that has
    been dammed up comes at once, on top of the stream, and dies away as its pressure does.
    """
    time = _between(rng, 0.15, 1.0)
    for step in case.steps:

        def flow(t: FloatArray, t0: float = step.t0, tf: float = step.tf) -> FloatArray:
            since = t - np.where(t < tf, t0, tf)
            return 1.0 + np.where(since >= 0.0, s / time * np.exp(-np.abs(since) / time), 0.0)

        rig[step.name].all_flow.append(flow)


@cause((), "fall", "of the pressure", 0.5, near=("valve_asymmetry",))
def stiff_check_valve(rig: Rig, s: float, rng: np.random.Generator, case: Case) -> None:
    """A check valve behind the valve keeps the gas from coming back, and its spring is stiff.

    It pops open where the pressure behind the valve has come to the share ``s``, and sits down
    again lower; between it passes what is above that.  So the gas comes late and with a jump, and
    it goes earlier and altogether, where a valve alone would never quite have shut.
    """
    reseats = s * rng.uniform(0.4, 0.9)
    for knobs in rig.values():
        knobs.check_cracks, knobs.check_reseats = s, reseats


@cause((), "plateau", "share of the lift", 0.4, near=("flow_settling",))
def warming_coil(rig: Rig, s: float, rng: np.random.Generator, case: Case) -> None:
    """A proportional valve is held by a coil on a constant voltage, and copper that warms resists.

    Its current, and the lift with it, falls as 1/(1 + k warmth), the power likewise; the share
    ``s`` is lost in the end.  What it has not cooled by until the next experiment is missing there.
    """
    time, end = _between(rng, 5.0, 40.0), 1.0 - s  # of the warmth that the cold coil would come to
    k, other = s / end**2, end / s  # the warmth comes to rest at ``end``, and would at -``other``
    slow = (1.0 + k * end) / (k * (end + other))
    quick = (1.0 - k * other) / (k * (end + other))
    lags = np.linspace(0.0, 30.0, 3001)
    warmth, last = 0.0, -np.inf  # s, when it was shut last on this record's clock
    for step in case.steps:
        on, off = step.commanded_on, step.commanded_off
        cold = warmth * float(np.exp((last - on) / time))
        warm = end - (end - cold) * np.exp(-lags)
        # time warmth' = 1/(1 + k warmth) - warmth, by separation
        passed = time * (slow * lags + quick * np.log((warm + other) / (cold + other)))
        hot = float(np.interp(off - on, passed, warm))

        def lift(
            t: FloatArray, on: float = on, off: float = off, cold: float = cold, hot: float = hot,
            passed: FloatArray = passed, warm: FloatArray = warm,
        ) -> FloatArray:  # fmt: skip
            heated = np.interp(t - on, passed, warm)
            before, after = (np.maximum(side, 0.0) for side in (on - t, t - off))
            now = np.where(t < on, cold * np.exp(before / time), heated)
            return 1.0 / (1.0 + k * np.where(t < off, now, hot * np.exp(-after / time)))

        rig[step.name].unmixed.append(lift)
        warmth, last = hot, off - step.duration


@cause((), "delay", "s", 3.0, near=("finite_stroke",), per_experiment=True)
def valve_turned_by_hand(rig: Rig, s: float, rng: np.random.Generator, case: Case) -> None:
    """The valve is turned by hand, by some turns of the wrist, between which one takes hold anew.

    Within a turn it opens evenly, in between it stands; the way there takes up to ``s``, and so
    does the way back, each time with other turns.
    """
    for step in case.steps:
        ways: list[tuple[FloatArray, FloatArray]] = []
        for switch in (step.t0, step.tf):
            turns = int(rng.integers(2, 5))
            turning, holding = rng.uniform(0.6, 1.4, turns), rng.uniform(0.4, 1.6, turns)
            lasts = np.column_stack([turning, holding]).ravel()[:-1]
            opened = np.column_stack([turning, np.zeros(turns)]).ravel()[:-1]
            both = [np.append(0.0, np.cumsum(some) / some.sum()) for some in (lasts, opened)]
            ways.append((switch + s * rng.uniform(0.5, 1.0) * both[0], both[1]))

        def wheel(
            t: FloatArray, ways: tuple[tuple[FloatArray, FloatArray], ...] = tuple(ways)
        ) -> FloatArray:
            there, back = (np.interp(t, *way) for way in ways)
            return np.asarray(there - back)

        rig[step.name].wheel = wheel
        rig[step.name].marks += [at for times, _ in ways for at in times.tolist()]


@cause((), "delay", "s a port", 0.6, near=("finite_stroke",))
def sweeping_selector(rig: Rig, s: float, rng: np.random.Generator, case: Case) -> None:
    """A selector valve has the bottles of all experiments in a row, and the carrier at its end.

    To get to a bottle it goes over the ports of those before, each of which flows for ``s``, and
    back the same way.  They stand as they are used, or by their concentration; from the first one
    it is no way.
    """
    row = list(case.steps)
    if rng.random() < 0.5:
        row.sort(key=lambda step: step.concentration)
    for place, step in enumerate(row):
        knobs = rig[step.name]
        for passed, other in enumerate(row[:place]):
            level = other.concentration / step.concentration
            knobs.swept.append((step.t0 + passed * s, s, level))
            knobs.swept.append((step.tf + (place - 1 - passed) * s, s, level))
        # every port's begin is the end of the one before
        knobs.marks += [at for at, _, _ in knobs.swept]
        knobs.marks += [switch + place * s for switch in (step.t0, step.tf)]


@cause((), "delay", "s", 7.5, near=("finite_stroke", "valve_asymmetry"))
def shape_memory_valve(rig: Rig, s: float, rng: np.random.Generator, case: Case) -> None:
    """A wire of nitinol pulls the valve open when a current warms it, and lets go as it cools.

    It shortens while its crystal turns, as half a cosine of the temperature between the two at
    which that begins and ends; cooling, it turns back at lower ones (Liang and Rogers, J. Intell.
    Mater. Syst. Struct. 1, 207, 1990).  The wire warms and cools exponentially, in ``s``; the
    current would make it far hotter than it must be, so that it is quicker to open than to shut.
    What passes before it begins to turn is a delay as any other, and within that of the switches.
    """
    ends, wide, lower = rng.uniform(0.65, 0.85), rng.uniform(0.15, 0.3), rng.uniform(0.1, 0.2)
    begins, hot = ends - wide, rng.uniform(1.5, 3.0)

    def turned(above: FloatArray) -> FloatArray:
        """Share of the crystal, ``above`` (n,) the temperature at which it begins to turn."""
        return np.asarray(0.5 * (1.0 - np.cos(np.pi * np.clip(above / wide, 0.0, 1.0))))

    for step in case.steps:

        def opened(t: FloatArray, t0: float = step.t0, tf: float = step.tf) -> FloatArray:
            warms = hot + (begins - hot) * np.exp(-np.maximum(t - t0, 0.0) / s)
            cools = (ends - lower) * np.exp(-np.maximum(t - tf, 0.0) / s)
            return np.where(t < tf, turned(warms - begins), turned(cools - begins + lower))

        up = s * float(np.log((hot - begins) / (hot - ends)))
        down = s * float(np.log((ends - lower) / (begins - lower)))
        rig[step.name].wheel = opened
        rig[step.name].marks += [at for at in (step.t0 + up, step.tf + down) if at < step.duration]


@cause((), "fall", "share of the stroke", 0.6, near=("valve_asymmetry",))
def slamming_plunger(rig: Rig, s: float, rng: np.random.Generator, case: Case) -> None:
    """The stream sucks the plunger on to its seat, which it meets with a slam, as water taps do.

    The narrower the gap is, the faster the gas in it and the lower its pressure: from the share
    ``s`` of the stroke on nothing holds the plunger any more.  Opening it is lifted off as ever.
    """
    for step in case.steps:
        at = step.tf - case.tau_v * float(np.log(s))
        rig[step.name].slam = s
        rig[step.name].marks += both_sides([at]) if at < step.duration else []
