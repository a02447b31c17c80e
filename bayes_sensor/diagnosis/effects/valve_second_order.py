"""The valve's moving part has inertia: ``kappa tau_v^2 x'' + tau_v x' + x = u``.

kappa 0 is the published first-order valve, 1/4 is critically damped, above it the valve rings.
"""

from bayes_sensor.diagnosis.effects.effect import Effect, Form, Strength

EFFECT = Effect(
    name="valve_second_order",
    family="fast shape",
    stage="valve",
    exchanged="sensor_diffusion",
    sentence="The valve moves like a mass on a spring, not like a single lag: {strength}.",
    forms=(
        Form(
            lambda s: (Strength("inertia", "1", "log_normal", 0.12, 1.0, limits=(1e-4, 3.0)),),
            lambda v, s: {"inertia": v["inertia"]},
            starts=({"inertia": 0.1}, {"inertia": 0.35}, {"inertia": 0.8}),
        ),
    ),
    plausible={"inertia": 0.1},
    null={"inertia": 0.0},
    reference="Newton's law for the plunger",
    reveal="a trigger that times the valve, or a displacement sensor on it",
)
