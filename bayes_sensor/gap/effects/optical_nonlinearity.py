"""The resonance's flank is curved: the voltage is not proportional to the concentration.

With v = beta x3 the readout is ``v + k v^2``.  The steepest point of the flank is its inflexion,
so that k depends on where the laser sits (:mod:`bayes_sensor.readout`).
"""

from bayes_sensor.gap.effect import Effect, Form, Strength

EFFECT = Effect(
    name="optical_nonlinearity",
    family="asymmetry",
    sentence="The readout bends: the voltage is not proportional to the concentration, {strength}.",
    forms=(
        Form(
            lambda s: (
                Strength("curvature", "1/V", "normal", 0.0, 0.06 / s.signal_scale,
                         limits=(-0.4 / s.signal_scale, 2.0 / s.signal_scale), scaled=True),
            ),
            lambda v, s: {"curvature": v["curvature"]},
            starts=({"curvature": 0.0},),
        ),
    ),
    plausible={"curvature": 0.02},
    null={"curvature": 0.0},
    reference="Lorentzian line shape; bayes_sensor.readout",
    reveal="plateaus at several known concentrations",
)  # fmt: skip
