"""Whether chains agree and are long enough."""

from __future__ import annotations

import numpy as np

from bayes_sensor.campaign import FloatArray
from bayes_sensor.likelihood.coordinates import Coordinates
from bayes_sensor.likelihood.problem import Problem
from bayes_sensor.posterior.r_hat import diagnostics

R_HAT_LIMIT = 1.01
ESS_LIMIT = 400.0
MESH_ERROR_LIMIT = 1e-3
"""of log L, between mesh and full pass"""


def diagnose(problem: Problem, chains: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Rank R-hat, bulk and tail ESS (n_theta,) of chains; nan for what does not vary."""
    free = Coordinates(problem).free
    out = [np.full(chains.shape[-1], np.nan) for _ in range(3)]
    for target, values in zip(out, diagnostics(chains[:, :, free]), strict=True):
        target[free] = values
    return out[0], out[1], out[2]


def enough(
    problem: Problem, chains: FloatArray, target: float
) -> tuple[bool, tuple[FloatArray, FloatArray, FloatArray]]:
    """Whether the chains agree and are long enough; also their diagnostics."""
    found = diagnose(problem, chains)
    free = Coordinates(problem).free
    r_hat, bulk, tail = (values[free] for values in found)
    done = np.all(r_hat < R_HAT_LIMIT) and np.all(bulk >= target) and np.all(tail >= ESS_LIMIT)
    return bool(done), found


def out_of_reach(
    found: tuple[FloatArray, FloatArray, FloatArray], share: float, target: float
) -> bool:
    """Whether all draws allowed, of which this ``share`` is drawn, would leave less than half of
    the effective draws that are asked for; ``found`` as of :func:`enough`."""
    _, bulk, tail = found
    few = np.nanmin(bulk) < 0.5 * target * share or np.nanmin(tail) < 0.5 * ESS_LIMIT * share
    return bool(few)
