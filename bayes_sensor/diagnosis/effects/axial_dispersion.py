"""The manifold is not one stirred tank: part of it follows in series.

Mixing along a tube is described by tanks in series (Levenspiel 1972); a share a of the volume in
a second tank gives the transit times a variance between the one tank's and half of it.
"""

from bayes_sensor.diagnosis.effects.effect import Effect, Form, Strength

EFFECT = Effect(
    name="axial_dispersion",
    family="mixing",
    stage="manifold",
    sentence="The manifold mixes like tanks in series, not like one: {strength}.",
    forms=(
        Form(
            lambda s: (Strength("tank_share", "1", "log_normal", 0.15, 0.8, limits=(1e-3, 0.5)),),
            lambda v, s: {"tank_share": v["tank_share"]},
            starts=({"tank_share": 0.12}, {"tank_share": 0.4}),
        ),
    ),
    plausible={"tank_share": 0.15},
    null={"tank_share": 0.0},
    reference="Levenspiel, Chemical Reaction Engineering, tanks-in-series model",
    reveal="a much higher or lower total flow: the lag scales with 1/Q, a valve's does not",
)
