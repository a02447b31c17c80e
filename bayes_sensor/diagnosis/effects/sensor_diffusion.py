"""Gas diffuses through the layered coating instead of following a single lag.

The coating's step response is a sum of exponentials (:mod:`bayes_sensor.coating`), scaled so
that tau keeps its meaning of the time to 63.2 %.
"""

from bayes_sensor.diagnosis.effects.effect import Effect, Form, Strength

EFFECT = Effect(
    name="sensor_diffusion",
    family="fast shape",
    stage="sensor",
    exchanged="valve_second_order",
    sentence="The sensor follows the diffusion through its coating, not a single lag.",
    forms=(
        Form(lambda s: (), lambda v, s: {"coating": 1.0}, name="full", weight=0.7),
        Form(
            lambda s: (Strength("coating", "1", "normal", 0.6, 0.4, limits=(0.0, 1.3)),),
            lambda v, s: {"coating": v["coating"]},
            name="partial",
            weight=0.3,
        ),
    ),
    plausible={"coating": 1.0},
    null={"coating": 0.0},
    reference="the paper, Sec. III-D; bayes_sensor.coating",
    reveal="a much faster step at the sensor (a gas jet), or a thicker coating",
)
