"""A low-pass in front of the converter acts on the signal and on its noise.

On the mean it is one more lag, much faster than the others; on the noise it is what any
autocorrelation may be, so that the noise cannot name it.
"""

from collections.abc import Mapping

import numpy as np
from scipy.signal import lfilter

from bayes_sensor.campaign import FloatArray
from bayes_sensor.diagnosis.effects.effect import Effect, Form, OnNoise, Strength


def _low_pass(noise: FloatArray, interval: float, strength: Mapping[str, float]) -> FloatArray:
    decay = float(np.exp(-interval / strength["filter"]))
    made, _ = lfilter([1.0 - decay], [1.0, -decay], noise, zi=noise[:1] * decay)
    return np.asarray(made)


EFFECT = Effect(
    name="daq_filter",
    family="fast shape",
    stage="record",
    sentence="A low-pass in the acquisition slows the signal: {strength}.",
    forms=(
        Form(
            lambda s: (
                Strength("filter", "s", "log_normal", 0.02 * s.time_scale, 1.0,
                         limits=(1e-4 * s.time_scale, 2.0 * s.time_scale)),
            ),
            lambda v, s: {"filter": v["filter"]},
            starts=({"filter*": 0.02}, {"filter*": 0.1}),
        ),
    ),
    on_noise=OnNoise(filtered=_low_pass),
    plausible={"filter": 0.015},
    null={"filter": 0.0},
    reference="photoreceiver and anti-alias filters",
    reveal="the receiver's response to a switched light",
)  # fmt: skip
