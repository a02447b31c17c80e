"""The converter's step is not small beside the noise: the samples lie on a coarse lattice.

An 8-bit scope at +-5 V has steps of 39 mV.  Tested on the sample values themselves
(:mod:`bayes_sensor.diagnosis.signals.tails_and_converter`).
"""

from bayes_sensor.diagnosis.effects.effect import Effect

EFFECT = Effect(
    name="quantisation",
    family="converter",
    stage="record",
    sentence="The converter's steps are coarse beside the noise: {strength}.",
    forms=(),
    plausible={"adc_step": 0.039},
    null={"adc_step": 0.0},
    reference="Widrow and Kollar, Quantization Noise, 2008",
    reveal="a smaller input range of the converter",
    on_mean=False,
)
