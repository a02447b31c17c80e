"""The resonance's flank is curved: the voltage is not proportional to the concentration.

With v = beta x3 the readout is ``v + k v (v - beta)``: beta is the height of the step, with or
without the bend.  The steepest point of the flank is its inflexion, so that k depends on where the
laser sits (:mod:`bayes_sensor.coating.readout`).  A shift that is not small beside the resonance's
width also shows how the curvature changes: ``v + k v (v - beta) + m v (v^2 - beta^2)``.
"""

from bayes_sensor.diagnosis.effects.effect import Effect, Form, Strength
from bayes_sensor.diagnosis.effects.setting import Setting


def _square(s: Setting) -> tuple[Strength, ...]:
    return (
        Strength("curvature", "1/V", "normal", 0.0, 0.06 / s.signal_scale,
                 limits=(-0.9 / s.signal_scale, 0.9 / s.signal_scale), scaled=True),
    )  # fmt: skip


def _cubic(s: Setting) -> tuple[Strength, ...]:
    size = s.signal_scale**2
    cubic = Strength("cubic", "1/V^2", "normal", 0.0, 0.02 / size,
                     limits=(-0.2 / size, 1.0 / size), scaled=True)  # fmt: skip
    return (*_square(s), cubic)


EFFECT = Effect(
    name="optical_nonlinearity",
    family="asymmetry",
    stage="readout",
    sentence="The readout bends: the signal is not proportional to the concentration, {strength}.",
    forms=(
        Form(_square, lambda v, s: dict(v)),
        Form(_cubic, lambda v, s: dict(v), name="cubic", weight=0.5),
    ),
    affine=False,
    plausible={"curvature": 0.02},
    null={"curvature": 0.0, "cubic": 0.0},
    reference="Lorentzian line shape; bayes_sensor.coating.readout",
    reveal="plateaus at several known concentrations",
)
