"""The converter's steps are coarse: an 8-bit scope at +-5 V has steps of 39 mV."""

from collections.abc import Mapping

import numpy as np

from bayes_sensor.campaign import FloatArray
from bayes_sensor.diagnosis.effects.effect import Effect, OnNoise
from bayes_sensor.diagnosis.signals.converter import SIGNAL


def _rounded(
    y: FloatArray, t: FloatArray, strength: Mapping[str, float], rng: np.random.Generator
) -> FloatArray:
    step = strength["adc_step"]
    return np.asarray(step * np.rint(y / step))


EFFECT = Effect(
    name="quantisation",
    family="converter",
    stage="record",
    sentence="The converter's steps are coarse beside the noise: {strength}.",
    plausible={"adc_step": 0.039},
    null={"adc_step": 0.0},
    reference="Widrow and Kollar, Quantization Noise, 2008",
    reveal="a smaller input range of the converter",
    on_noise=OnNoise(record=_rounded, above={"adc_step": 0.0}, signal=SIGNAL),
)
