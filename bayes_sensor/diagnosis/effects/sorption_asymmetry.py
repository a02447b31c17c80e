"""The sensor releases the gas at another rate than it takes it up.

Sorption with a nonlinear isotherm lags differently up and down; release three times slower than
uptake is seen in practice.  The rate changes where the direction does, or, with pores that open
under load and close behind it, over a small distance from equilibrium.
"""

from bayes_sensor.diagnosis.effects.effect import Effect, Form, Strength
from bayes_sensor.diagnosis.effects.setting import Setting


def _strengths(s: Setting) -> tuple[Strength, ...]:
    return (Strength("release_ratio", "1", "log_normal", 1.0, 0.7, limits=(0.02, 50.0)),)


def _gradual(s: Setting) -> tuple[Strength, ...]:
    width = Strength("release_width", "1", "log_normal", 0.01, 1.0, limits=(1e-4, 0.3))
    return (*_strengths(s), width)


_STARTS = ({"release_ratio": 2.0}, {"release_ratio": 0.5}, {"release_ratio": 4.0})

EFFECT = Effect(
    name="sorption_asymmetry",
    family="asymmetry",
    stage="sensor",
    exchanged="valve_asymmetry",
    names_rivals=("sensor by direction",),
    sentence="The sensor releases the gas at another rate than it takes it up: {strength}.",
    forms=(
        Form(_strengths, lambda v, s: dict(v), starts=_STARTS),
        Form(_gradual, lambda v, s: dict(v), name="gradual", weight=0.5, starts=_STARTS),
    ),
    plausible={"release_ratio": 1.3},
    null={"release_ratio": 1.0},
    reference="Langmuir kinetics: uptake k_a c + k_d, release k_d",
    reveal="a faster fall (a purge), or a step between two concentrations",
)
