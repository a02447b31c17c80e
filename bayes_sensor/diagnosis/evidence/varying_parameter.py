"""Embedded rivals of the effects: a parameter of the model that is not constant.

An additive discrepancy sees what is left in the traces.  Many unlisted causes act inside the model
instead: a lag that depends on the flow, on the concentration, on the direction of the step, or that
changes from one experiment to the next (embedded discrepancy; Sargsyan, Najm and Ghanem 2015).  Two
paths of the gas, or a valve that moves in two steps, are two delays in place of one.  A drive that
couples into the signal makes pulses too short for a smooth process.  These rivals have no name and
count as unlisted.  Where a listed effect is the same dependence, the rival is left out while that
effect is in the catalogue.
"""

from __future__ import annotations

from collections.abc import Collection, Iterable, Mapping
from dataclasses import dataclass

import numpy as np

from bayes_sensor.campaign import Experiment, FloatArray
from bayes_sensor.diagnosis.effects.effect import Effect, Form, Strength
from bayes_sensor.diagnosis.effects.rig_view import RigView
from bayes_sensor.diagnosis.effects.setting import Setting

WEIGHT = 0.35
"""share of "something else" that is embedded; the rest is additive"""
EXPONENT_SD = 0.15
"""spread of the exponent of a dependence on flow or concentration"""
PULSE_SD = 0.01
"""spread of a pulse's height over that of the step"""
RATIO_SD = 0.25
"""spread of the logarithm of a ratio between step down and step up"""


def _by_flow(setting: Setting) -> float:
    flow = setting.experiment.total_flow
    return flow / setting.reference_flow if np.isfinite(flow) else 1.0


def _exponent(name: str) -> Strength:
    return Strength(name, "1", "normal", 0.0, EXPONENT_SD, limits=(-3.0, 3.0), scaled=True)


def _ratio(name: str, sd: float = RATIO_SD) -> Strength:
    return Strength(name, "1", "log_normal", 1.0, sd, limits=(0.05, 20.0), scaled=True)


def _power(target: str, name: str) -> Form:
    def settings(v: Mapping[str, float], s: Setting) -> Mapping[str, float]:
        return {target: _by_flow(s) ** v[name]}

    return Form(lambda s: (_exponent(name),), settings, starts=({name: 0.05}, {name: -0.05}))


def _direction(name: str) -> Form:
    return Form(lambda s: (_ratio(name),), lambda v, s: dict(v), starts=({name: 1.1}, {name: 0.9}))


def _by_experiment(target: str, sd: float) -> Form:
    name = f"{target}_of_its_own"
    own = Strength(name, "1", "log_normal", 1.0, sd, per_experiment=True, limits=(0.05, 20.0),
                   scaled=True)  # fmt: skip
    return Form(lambda s: (own,), lambda v, s: {target: v[name]})


def _another_way(name: str, by_stream: bool) -> Form:
    """A share of the gas takes a longer way, of a fixed volume or of a fixed time."""

    def strengths(s: Setting) -> tuple[Strength, ...]:
        return (Strength("late_share", "1", "log_normal", 0.1, 1.2, limits=(1e-4, 0.98)), _late(s))

    def settings(v: Mapping[str, float], s: Setting) -> Mapping[str, float]:
        late = v["lateness"] / (_by_flow(s) if by_stream else 1.0)
        return {"late_share": v["late_share"], "late_rise": late, "late_fall": late}

    starts = (
        {"late_share": 0.1, "lateness*": 0.4},
        {"late_share": 0.1, "lateness*": 1.5},
        {"late_share": 0.03, "lateness*": 6.0},
    )
    return Form(strengths, settings, name=name, starts=starts)


def _two_steps(name: str, edge: str) -> Form:
    """About half of the valve's motion waits: a small rest that does is a flow that settles."""

    def strengths(s: Setting) -> tuple[Strength, ...]:
        return (Strength("late_share", "1", "log_normal", 0.5, 0.4, limits=(1e-4, 0.98)), _late(s))

    def settings(v: Mapping[str, float], s: Setting) -> Mapping[str, float]:
        return {"late_share": v["late_share"], edge: v["lateness"]}

    starts = ({"late_share": 0.5, "lateness*": 0.4}, {"late_share": 0.5, "lateness*": 1.2})
    return Form(strengths, settings, name=name, starts=starts)


def _late(s: Setting) -> Strength:
    return Strength("lateness", "s", "log_normal", s.time_scale, 1.0)


def _pulse_strengths(s: Setting) -> tuple[Strength, ...]:
    size = PULSE_SD * s.signal_scale
    return (
        Strength("pulse_on", "V", "normal", 0.0, size, scaled=True),
        Strength("pulse_off", "V", "normal", 0.0, size, scaled=True),
        Strength("pulse_time", "s", "log_normal", 0.3 * s.time_scale, 0.8),
    )


def _pulsed(t: FloatArray, v: Mapping[str, float], rig: RigView) -> FloatArray:
    made = rig.mean(t)
    for at, up in commanded_switches(rig.experiment):
        size = v["pulse_on"] if up else v["pulse_off"]
        made = made + size * (t >= at) * np.exp(-np.maximum(t - at, 0.0) / v["pulse_time"])
    return made


def commanded_switches(e: Experiment) -> list[tuple[float, bool]]:
    """s, when each switch of a record was commanded, and whether it leads up."""
    if e.commands is not None:
        return list(
            zip(e.commands.times.tolist(), (e.commands.heights > 0.0).tolist(), strict=True)
        )
    told = ((e.commanded_on, True), (e.commanded_off, False))
    return [(at, up) for at, up in told if at is not None]


_PULSE = Form(
    _pulse_strengths,
    lambda v, s: {},
    starts=tuple({"pulse_time*": w} for w in (0.1, 0.4, 1.5)),
    mean=_pulsed,
)

_BY_CONCENTRATION = Form(
    lambda s: (_exponent("sensor_by_concentration"),),
    lambda v, s: {
        "sensor_factor": (s.experiment.concentration / 0.15) ** v["sensor_by_concentration"]
    },
    starts=({"sensor_by_concentration": 0.3}, {"sensor_by_concentration": -0.3}),
)


@dataclass(frozen=True)
class Rival:
    """A dependence without a name of its own."""

    forms: tuple[Form, ...]
    sentence: str
    """in plain words; may hold ``{strength}``"""
    stage: str = ""
    """whose lag it is of, ``valve`` or ``sensor``; or what it needs: ``manifold``, ``command``"""


RIVALS = {
    "valve by flow": Rival(
        (_power("valve_factor", "valve_by_flow"),),
        "the valve's time constant depends on the flow ({strength})",
        stage="valve",
    ),
    "volume by flow": Rival(
        (_power("flow_factor", "volume_by_flow"),),
        "the manifold's time constant follows another power of the flow ({strength})",
        stage="manifold",
    ),
    "sensor by concentration": Rival(
        (_BY_CONCENTRATION,),
        "the sensor's time constant depends on the concentration ({strength})",
        stage="sensor",
    ),
    "valve by experiment": Rival(
        (_by_experiment("valve_factor", 0.05),),
        "the valve's time constant differs from experiment to experiment ({strength})",
        stage="valve",
    ),
    "sensor by experiment": Rival(
        (_by_experiment("sensor_factor", 0.3),),
        "the sensor's time constant differs from experiment to experiment ({strength})",
        stage="sensor",
    ),
    "valve by direction": Rival(
        (_direction("closing_ratio"),),
        "the valve shuts at another speed than it opens ({strength})",
        stage="valve",
    ),
    "volume by direction": Rival(
        (_direction("emptying_ratio"),),
        "the manifold empties at another speed than it fills ({strength})",
        stage="manifold",
    ),
    "sensor by direction": Rival(
        (_direction("release_ratio"),),
        "the sensor releases at another speed than it takes up ({strength})",
        stage="sensor",
    ),
    "part later": Rival(
        (
            _another_way("by the stream", by_stream=True),
            _another_way("by the clock", by_stream=False),
            _two_steps("as the gas comes", "late_rise"),
            _two_steps("as it goes", "late_fall"),
        ),
        "a part of the response comes later than the rest ({strength})",
        stage="command",
    ),
    "pulse at commands": Rival(
        (_PULSE,), "a pulse that fades follows the valve's commands ({strength})"
    ),
}


def embedded_rivals(
    effects: Iterable[Effect],
    several_flows: bool,
    has_fall: bool,
    commanded: bool,
    stages: Collection[str] = ("valve", "manifold", "sensor", "command"),
) -> list[Effect]:
    """The rivals that a campaign can have and that none of the ``effects`` is.

    ``stages``: what its rig has, :class:`~bayes_sensor.diagnosis.effects.effects_of_rig.Possible`.
    """
    known = {name for effect in effects for name in effect.names_rivals}
    found = []
    for name, rival in RIVALS.items():
        if name in known or (rival.stage and rival.stage not in stages):
            continue
        if not several_flows and any(w in name for w in ("flow", "concentration", "experiment")):
            continue
        if "direction" in name and not has_fall:
            continue
        if "command" in name and not commanded:
            continue
        found.append(
            Effect(
                name=name,
                family="unlisted",
                stage=rival.stage if rival.stage in ("valve", "sensor") else "",
                sentence=rival.sentence,
                forms=rival.forms,
                plausible={},
                reference="",
                reveal="",
            )
        )
    return found
