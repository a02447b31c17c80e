"""A low-pass in front of the converter acts on the signal and on its noise.

On the mean it is one more lag, much faster than the others; on the noise it is what any
autocorrelation may be, so that the noise cannot name it.  It has one pole or two.
"""

from collections.abc import Mapping

import numpy as np
from scipy.signal import lfilter

from bayes_sensor.campaign import FloatArray
from bayes_sensor.diagnosis.effects.effect import Effect, Form, OnNoise, Strength
from bayes_sensor.diagnosis.effects.setting import Setting

STARTS = ({"filter*": 0.02}, {"filter*": 0.1})


def _low_pass(noise: FloatArray, interval: float, strength: Mapping[str, float]) -> FloatArray:
    decay = float(np.exp(-interval / strength["filter"]))
    made, _ = lfilter([1.0 - decay], [1.0, -decay], noise, zi=noise[:1] * decay)
    return np.asarray(made)


def _time(s: Setting) -> tuple[Strength, ...]:
    return (
        Strength("filter", "s", "log_normal", 0.02 * s.time_scale, 1.0,
                 limits=(1e-4 * s.time_scale, 2.0 * s.time_scale)),
    )  # fmt: skip


EFFECT = Effect(
    name="daq_filter",
    family="fast shape",
    stage="record",
    sentence="A low-pass in the acquisition slows the signal: {strength}.",
    forms=(
        Form(_time, lambda v, s: {"filter": v["filter"]}, name="one pole", starts=STARTS),
        Form(
            _time,
            lambda v, s: {"filter": v["filter"], "filter_second": v["filter"]},
            name="two poles",
            weight=0.5,
            starts=(*STARTS, {"filter*": 0.3}),
        ),
        Form(
            _time,
            lambda v, s: {"filter_butterworth": v["filter"]},
            name="Butterworth",
            weight=0.5,
            starts=(*STARTS, {"filter*": 0.3}),
        ),
    ),
    on_noise=OnNoise(filtered=_low_pass),
    plausible={"filter": 0.015},
    null={"filter": 0.0},
    reference="photoreceiver and anti-alias filters",
    reveal="the recorder's response to a step of its own input",
)  # fmt: skip
