"""The sensor releases the gas at another rate than it takes it up.

Sorption with a nonlinear isotherm lags differently up and down; release three times slower than
uptake is seen in practice.
"""

from bayes_sensor.gap.effect import Effect, Form, Strength

EFFECT = Effect(
    name="sorption_asymmetry",
    family="asymmetry",
    sentence="The sensor releases the gas at another rate than it takes it up: {strength}.",
    forms=(
        Form(
            lambda s: (
                Strength("release_ratio", "1", "log_normal", 1.0, 0.7, limits=(0.02, 50.0)),
            ),
            lambda v, s: {"release_ratio": v["release_ratio"]},
            starts=({"release_ratio": 2.0}, {"release_ratio": 0.5}, {"release_ratio": 4.0}),
        ),
    ),
    plausible={"release_ratio": 1.3},
    null={"release_ratio": 1.0},
    reference="Langmuir kinetics: uptake k_a c + k_d, release k_d",
    reveal="a faster fall (a purge), or a step between two concentrations",
)
