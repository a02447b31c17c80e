"""Other rigs, drawn at random: a sensor alone, a cell with flows, staircases, trains of pulses.

They are made of the same parts.  A rig that has no valve passes the command on at once, one that
has no volume the gas.  A cause has a meaning where its part is there; causes that know of one pulse
only do not act on longer programmes.
"""

from __future__ import annotations

from dataclasses import replace
from math import sqrt

import numpy as np

from bayes_sensor.blind_check.simulator.case import PUBLISHED, Case, NoiseLaw, Step, Switch
from bayes_sensor.blind_check.simulator.causes import Cause
from bayes_sensor.blind_check.simulator.noise_laws import draw_law

OTHER_RIGS = ("sensor", "cell", "staircase", "train")
"""a sensor that is dipped into the gas, by hand or by a switch, at no known flow; a swept cell with
a sensor; several levels, or several pulses, in a record, on a valve, a manifold and a sensor, or on
a manifold and a sensor"""
PROGRAMMES = ("staircase", "train")
OF_ONE_PULSE = (
    "plunger_stroke", "bouncing_valve", "grain_in_seat", "controller_settling", "emptying_bottle",
    "soft_start", "dead_leg", "trapped_plug",
)  # fmt: skip
"""causes that are told when one pulse begins or ends"""
QUICK = 1e-3
"""s, sampling interval that the noise laws are made for"""
OF_QUICK_RECORDS = ("mains_hum",)
"""causes that such slow records cannot show as what they are"""


def has_meaning(cause: Cause, kind: str) -> bool:
    """Whether a cause can act on a kind of rig.

    A programme may be on a rig without a valve; it has one where the cause is a valve's.
    """
    if cause.name in OF_QUICK_RECORDS or (kind in PROGRAMMES and cause.name in OF_ONE_PULSE):
        return False
    if cause.place == "valve":
        return kind in PROGRAMMES
    return kind != "sensor" or cause.place not in ("flow", "manifold")


def other_rig(kind: str, seed: int, law: str = "ar1", needs_valve: bool = False) -> Case:
    """A rig of one of :data:`OTHER_RIGS` with fresh parameters.

    Its noise is slower as the root of the sampling interval: it correlates over fewer samples than
    on the published rig, and over a longer time.
    """
    rng = np.random.default_rng([seed, 8, 1000 + OTHER_RIGS.index(kind)])
    draw = {"sensor": _sensor, "cell": _cell}.get(kind)
    stages, times, steps = draw(rng) if draw else _programmes(kind, rng, needs_valve)
    sigma = max(step.beta for step in steps) * _log_normal(rng, 0.01, 0.4)
    interval = steps[0].interval
    noise = _slowed(draw_law(law, rng, sigma), sqrt(interval / QUICK))
    return Case(
        seed, *times, tuple(steps), noise,
        lsb=sigma / rng.uniform(40, 400), title=f"simulated rig ({kind})", stages=stages,
        flows_told=kind != "sensor",
    )  # fmt: skip


Drawn = tuple[tuple[str, ...], tuple[float, float, float], list[Step]]
"""stages; tau, tau_v, V; experiments"""


def _sensor(rng: np.random.Generator) -> Drawn:
    """One lag, and pulses that are long against it; one concentration, of which nothing is told."""
    tau = _log_normal(rng, 2.0, 0.7)
    interval = float(rng.choice([0.01, 0.02, 0.05, 0.1])) if tau > 1.0 else 0.01
    steps = []
    for k in range(int(rng.integers(2, 6))):
        on = float(np.round(rng.uniform(4.0, 8.0) * max(tau, 0.5), 2))
        off = on + float(np.round(rng.uniform(9.0, 15.0) * max(tau, 0.5), 2))
        duration = float(np.round(off + rng.uniform(9.0, 14.0) * max(tau, 0.5), 1))
        late = rng.uniform(0.0, 0.3, 2) * min(tau, 1.0)
        steps.append(_step(k, rng, (50.0, 5.0), interval, duration, [
            Switch(on, on + late[0], 1.0), Switch(off, off + late[1], 0.0),
        ]))  # fmt: skip
    return ("sensor",), (tau, tau, 50.0 * tau), steps


def _cell(rng: np.random.Generator) -> Drawn:
    """A cell that is swept at several flows, and a sensor slower or faster than that."""
    V, tau = _log_normal(rng, 30.0, 0.5), _log_normal(rng, 1.0, 0.6)
    flows = _flows(rng, int(rng.integers(3, 7)))
    slowest = V / min(sum(each) for each in flows) + tau
    interval = 0.01 if slowest < 6.0 else 0.02
    steps = []
    for k, flow in enumerate(flows):
        delay = rng.uniform(5.0, 15.0) / sum(flow)
        on = float(np.round(rng.uniform(2.0, 5.0) * slowest, 2))
        off = on + float(np.round(rng.uniform(8.0, 12.0) * slowest, 2))
        duration = float(np.round(off + rng.uniform(8.0, 12.0) * slowest, 1))
        steps.append(_step(k, rng, flow, interval, duration, [
            Switch(on, on + delay, 1.0), Switch(off, off + delay, 0.0),
        ]))  # fmt: skip
    return ("cell", "sensor"), (tau, tau, V), steps


def _programmes(kind: str, rng: np.random.Generator, needs_valve: bool) -> Drawn:
    """Records of several levels, or of several pulses."""
    has_valve = bool(rng.random() < 0.5) or needs_valve
    stages = PUBLISHED if has_valve else PUBLISHED[1:]
    tau = _log_normal(rng, 0.15, 0.7)
    tau_v = tau * float(np.exp(rng.choice([-1.0, 1.0]) * rng.uniform(0.7, 2.0)))
    V = _log_normal(rng, 40.0, 0.3)
    flows = _flows(rng, int(rng.integers(2, 5)))
    slowest = V / min(sum(each) for each in flows) + tau + tau_v * has_valve
    interval = 5e-3 if slowest < 3.0 else 1e-2
    if kind == "staircase":
        n = int(rng.integers(2, 4))
        levels = [*(np.arange(1, n + 1) / n + np.append(rng.uniform(-0.1, 0.1, n - 1), 0.0)), 0.0]
    else:
        levels = [1.0, 0.0] * int(rng.integers(2, 6))
    shared = len(levels) > 4
    steps = []
    for k, flow in enumerate(flows):
        lines = np.array([60.0, 40.0]) / sum(flow) * rng.uniform(0.9, 1.1, 2)
        at, level = float(np.round(rng.uniform(3.0, 5.0) * slowest, 3)), 0.0
        switches = []
        for to in levels:
            delay = lines[0] if to > level else lines[1]
            scatter = 0.0 if shared else rng.uniform(0.0, 0.1)
            switches.append(Switch(at, at + delay + scatter, float(to)))
            at = float(np.round(at + rng.uniform(6.0, 9.0) * slowest, 3))
            level = to
        duration = float(np.round(at + 2.0 * slowest, 2))
        steps.append(_step(k, rng, flow, interval, duration, switches, shared))
    return stages, (tau, tau_v, V), steps


def _step(
    k: int, rng: np.random.Generator, flow: tuple[float, float], interval: float, duration: float,
    switches: list[Switch], shared: bool = False,
) -> Step:  # fmt: skip
    first, last = switches[0], switches[-1]
    return Step(
        name=str(k + 1), carrier_flow=flow[0], test_gas_flow=flow[1], interval=interval,
        duration=duration, commanded_on=first.commanded, commanded_off=last.commanded,
        t0=first.at, tf=last.at, y0=float(rng.uniform(0.1, 0.35)),
        beta=float(rng.uniform(1.0, 2.0)), programme=tuple(switches) if len(switches) > 2 else (),
        shared_delays=shared,
    )  # fmt: skip


def _slowed(law: NoiseLaw, factor: float) -> NoiseLaw:
    """The law with every time ``factor`` times as long."""
    return replace(law, components=tuple(
        replace(part, time=part.time * factor, gust_time=part.gust_time * factor,
                frequency=part.frequency / factor)
        for part in law.components
    ))  # fmt: skip


def _flows(rng: np.random.Generator, n: int) -> list[tuple[float, float]]:
    """(carrier, test gas) mL/s of n experiments: flows over a factor of two to four, shares too."""
    total = rng.uniform(15.0, 40.0) * np.exp(np.linspace(0.0, np.log(rng.uniform(2.0, 4.0)), n))
    shares = rng.permutation(np.linspace(rng.uniform(0.05, 0.1), rng.uniform(0.15, 0.3), n))
    return [
        (float(q * (1.0 - c)), float(q * c))
        for q, c in zip(rng.permutation(total), shares, strict=True)
    ]


def _log_normal(rng: np.random.Generator, median: float, spread: float) -> float:
    """Within two and a half standard deviations."""
    return float(median * np.exp(spread * np.clip(rng.standard_normal(), -2.5, 2.5)))
