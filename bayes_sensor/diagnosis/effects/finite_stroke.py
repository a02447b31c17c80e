"""The valve's stroke takes a finite time: its command does not jump from shut to open.

A needle or a proportional valve is driven at a finite speed, a plunger is accelerated over its
whole way; the lag then follows a ramp or a parabola.  That is what enters the chain: the response
is the same whichever of its lags comes first.
"""

from collections.abc import Mapping

from bayes_sensor.diagnosis.effects.effect import Effect, Form, Strength
from bayes_sensor.diagnosis.effects.setting import Setting


def _strengths(s: Setting) -> tuple[Strength, ...]:
    limits = (1e-3 * s.time_scale, 20.0 * s.time_scale)
    return (Strength("stroke", "s", "log_normal", 0.4 * s.time_scale, 0.9, limits=limits),)


def _accelerating(v: Mapping[str, float], s: Setting) -> Mapping[str, float]:
    return {"stroke": v["stroke"], "stroke_bend": 1.0}


STARTS = ({"stroke*": 0.4}, {"stroke*": 1.5})

EFFECT = Effect(
    name="finite_stroke",
    family="fast shape",
    stage="command",
    sentence="The valve takes a finite stroke to open and shut: {strength}.",
    forms=(
        Form(_strengths, lambda v, s: {"stroke": v["stroke"]}, name="even", starts=STARTS),
        Form(_strengths, _accelerating, name="accelerating", starts=STARTS),
    ),
    plausible={"stroke": 0.3},
    null={"stroke": 0.0},
    reference="motor-driven and proportional valves",
    reveal="a trigger that times the valve, or a displacement sensor on it",
)
