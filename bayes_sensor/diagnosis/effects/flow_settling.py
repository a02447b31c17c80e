"""The mass-flow controller takes time to settle after the valve opens.

The controller sees its line open, overshoots or lags, and settles with a time constant of its
own: the inlet's concentration is ``x1 (1 - a exp(-s/T) cos(w s))``, s after opening; w is 0 for a
controller that settles without swinging.  Nothing flows through it once the valve is shut, so that
the fall is not affected.  With a settling time near the valve's it is a valve that opens at another
rate than it shuts: no step experiment separates the two, so that it belongs to that family.
"""

from bayes_sensor.diagnosis.effects.effect import Effect, Form, Strength
from bayes_sensor.diagnosis.effects.setting import Setting


def _strengths(s: Setting) -> tuple[Strength, ...]:
    return (
        Strength("settling_share", "1", "normal", 0.0, 0.2, limits=(-3.0, 1.0), scaled=True),
        Strength("settling_time", "s", "log_normal", 0.8 * s.time_scale, 0.8,
                 limits=(0.02 * s.time_scale, 8.0 * s.time_scale)),
    )  # fmt: skip


def _swinging(s: Setting) -> tuple[Strength, ...]:
    return (*_strengths(s), Strength("settling_turn", "rad", "log_normal", 0.7, 0.7))


_STARTS = (
    {"settling_share": 0.1, "settling_time*": 0.6},
    {"settling_share": 0.05, "settling_time*": 2.5},
    {"settling_share": -0.1, "settling_time*": 0.6},
    {"settling_share": -0.05, "settling_time*": 2.5},
)

EFFECT = Effect(
    name="flow_settling",
    family="asymmetry",
    stage="flow",
    sentence="The flow controller needs time to settle after the valve has opened: {strength}.",
    forms=(
        Form(_strengths, lambda v, s: dict(v), starts=_STARTS),
        Form(
            _swinging,
            lambda v, s: {
                "settling_share": v["settling_share"],
                "settling_time": v["settling_time"],
                "settling_swing": v["settling_turn"] / v["settling_time"],
            },
            name="swinging",
            weight=0.5,
            starts=_STARTS,
        ),
    ),
    plausible={"settling_share": 0.3, "settling_time": 0.5},
    null={"settling_share": 0.0},
    reference="step response of thermal mass-flow controllers",
    reveal="the controller's own flow reading, recorded with the signal",
)  # fmt: skip
