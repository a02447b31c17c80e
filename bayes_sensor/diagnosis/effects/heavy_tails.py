"""The noise has heavier tails than a Gaussian: Student-t innovations, or rare large ones."""

from collections.abc import Mapping

import numpy as np

from bayes_sensor.campaign import FloatArray
from bayes_sensor.diagnosis.effects.effect import Effect, OnNoise
from bayes_sensor.diagnosis.signals.tails import SIGNAL


def _student(n: int, strength: Mapping[str, float], rng: np.random.Generator) -> FloatArray:
    dof = strength["tail_dof"]
    return np.asarray(rng.standard_t(dof, n) / np.sqrt(dof / (dof - 2.0)))


EFFECT = Effect(
    name="heavy_tails",
    family="noise law",
    stage="record",
    sentence="The noise has heavier tails than a Gaussian: {strength}.",
    plausible={"tail_dof": 4.0},
    null={"tail_dof": float("inf")},
    reference="Lange, Little and Taylor, J. Am. Stat. Assoc. 84, 1989",
    reveal="a record without gas, long enough to see the tails",
    on_noise=OnNoise(
        innovations=_student,
        above={"tail_dof": 2.0},
        reason="degrees of freedom, so that the variance exists",
        signal=SIGNAL,
    ),
)
