"""The valve's stroke takes a finite time: its command ramps from shut to open.

A needle or a proportional valve is driven at a finite speed; the lag then follows a ramp.
"""

from bayes_sensor.gap.effect import Effect, Form, Strength

EFFECT = Effect(
    name="finite_stroke",
    family="fast shape",
    sentence="The valve takes a finite stroke to open and shut: {strength}.",
    forms=(
        Form(
            lambda s: (
                Strength("stroke", "s", "log_normal", 0.4 * s.time_scale, 0.9,
                         limits=(1e-3 * s.time_scale, 20.0 * s.time_scale)),
            ),
            lambda v, s: {"stroke": v["stroke"]},
            starts=({"stroke*": 0.4}, {"stroke*": 1.5}),
        ),
    ),
    plausible={"stroke": 0.3},
    null={"stroke": 0.0},
    reference="motor-driven and proportional valves",
    reveal="a trigger that times the valve, or a displacement sensor on it",
)  # fmt: skip
