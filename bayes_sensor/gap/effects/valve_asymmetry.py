"""The valve shuts more slowly, or faster, than it opens.

A solenoid opens against a spring with its coil and shuts by the spring alone, so that the two
time constants differ: ``tau_v`` opening, ``closing_ratio tau_v`` shutting.
"""

from bayes_sensor.gap.effect import Effect, Form, Strength

EFFECT = Effect(
    name="valve_asymmetry",
    family="asymmetry",
    sentence="The valve shuts with another time constant than it opens with: {strength}.",
    forms=(
        Form(
            lambda s: (
                Strength(
                    "closing_ratio", "1", "log_normal", 1.0, 0.25, limits=(0.1, 10.0), scaled=True
                ),
            ),
            lambda v, s: {"closing_ratio": v["closing_ratio"]},
            starts=({"closing_ratio": 1.15}, {"closing_ratio": 0.87}),
        ),
    ),
    plausible={"closing_ratio": 1.1},
    null={"closing_ratio": 1.0},
    reference="spring-return solenoid valves",
    reveal="a second total flow: a valve's ratio does not depend on it",
)
