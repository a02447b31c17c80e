"""Sensitivities of one experiment's mean at every sample, fast enough for a whole campaign."""

from __future__ import annotations

import numpy as np

from bayes_sensor.campaign import FloatArray
from bayes_sensor.likelihood.mesh import sizes
from bayes_sensor.likelihood.problem import Problem
from bayes_sensor.rig.cascade import Cascade, response_slopes


def local_jacobian(problem: Problem, vector: FloatArray, k: int) -> tuple[FloatArray, np.ndarray]:
    """Derivatives (n_t, m) of experiment ``k``'s mean by the parameters it depends on.

    Also their positions (m,) in the flat vector: the shared ones, y0, beta, switch times, extras.
    Samples that are not used have zero rows.
    """
    layout, e = problem.layout, problem.campaign.experiments[k]
    extra = np.arange(len(layout) - len(layout.extra), len(layout))
    local = layout.local[k][layout.local[k] >= 0]
    index = np.concatenate([layout.shared[k], local, extra]).astype(int)
    if type(problem.model) is Cascade and problem.model.method == "exact":
        J = _cascade_jacobian(problem, vector, k)
    else:
        J = np.empty((len(e.t), len(index)))
        steps = 1e-6 * sizes(problem, vector)
        # what the mean is linear in, or nearly, far from rounding: a signal may be far from zero
        steps[local[:2]] *= 1e3
        for column, i in enumerate(index):
            step = steps[i]
            up, down = vector.copy(), vector.copy()
            up[i] += step
            down[i] -= step
            difference = problem.model.mean(e.t, up, layout, e) - problem.model.mean(
                e.t, down, layout, e
            )
            J[:, column] = difference / (2.0 * step)
    J[~e.used] = 0.0
    return J, index


def _cascade_jacobian(problem: Problem, vector: FloatArray, k: int) -> FloatArray:
    layout, e = problem.layout, problem.campaign.experiments[k]
    grid = e.interval if e.regular else None
    x, _, slopes = response_slopes(e.t, vector, layout, k, e.total_flow, grid)
    n = len(layout.shared[k])
    slopes *= vector[layout.local[k, 1]]
    levels = np.stack([np.ones(len(e.t)), x], axis=1)
    return np.concatenate([slopes[:, :n], levels, slopes[:, n:]], axis=1)
