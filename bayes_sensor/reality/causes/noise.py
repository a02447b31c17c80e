"""What changes the noise or the converter and leaves the mean alone."""

from __future__ import annotations

import numpy as np

from bayes_sensor.reality.causes.cause import Cause, Causes, Rig
from bayes_sensor.reality.records import Case

CAUSES = Causes()


def _noise_only(rig: Rig, s: float, rng: np.random.Generator, case: Case) -> None:
    """Nothing to turn on the rig: the noise or the converter changes."""


def tail_mixture(case: Case) -> tuple[float, float]:
    """(share of wild innovations, how many times as large they are) of a case."""
    strength = case.strengths.get("wild_samples", 0.0)
    if strength == 0.0:
        return 0.0, 1.0
    share = CAUSES["wild_samples"].generator(case).uniform(0.003, 0.03)
    return float(share), 1.0 + strength


def converter_step(case: Case) -> float:
    """V, the recorder's step, coarse where the range is set too wide."""
    strength = case.strengths.get("coarse_range", 0.0)
    return max(case.lsb, strength * case.noise.sigma0)


CAUSES["wild_samples"] = Cause(
    "wild_samples", ("heavy_tails",), "noise", "times sigma beyond 1", 8.0, _noise_only, noise=True
)
CAUSES["coarse_range"] = Cause(
    "coarse_range", ("quantisation",), "noise", "sigma0 a step", 3.0, _noise_only, noise=True
)
