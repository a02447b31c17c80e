"""Derivatives of any model's mean and response at given times."""

from __future__ import annotations

import numpy as np

from bayes_sensor.campaign import FloatArray
from bayes_sensor.likelihood import (
    Prior,
    Problem,
    has_plain_mean,
    is_affine,
    mean_and_response,
)


def mean_derivatives(
    problem: Problem, vector: FloatArray, k: int, t: FloatArray
) -> tuple[FloatArray, FloatArray, np.ndarray, FloatArray, FloatArray]:
    """Mean and response of any model at times ``t`` (n_t,), and their derivatives.

    Returns mean (n_t,) V, response (n_t,), positions in theta (m,) of the parameters that move
    either, and the derivatives (m, n_t) of both by central differences.  Steps are a thousandth
    of a time constant or of a prior's width: their error is a millionth, and a model that is
    computed numerically to five digits still gives a slope.
    """
    layout = problem.layout
    e = problem.campaign.experiments[k]
    mean, x = mean_and_response(problem, vector, e, t)
    i_y0, i_beta, *switches = (int(i) for i in layout.local[k])
    slowest = max(vector[0], vector[1], vector[2] / e.total_flow)
    moves = {i: (1e-3 * vector[i], 1e-12, np.inf) for i in range(3)}
    moves |= {i: (1e-3 * slowest, -np.inf, np.inf) for i in switches if i >= 0}
    for i, name in enumerate(layout.extra, len(layout) - len(layout.extra)):
        if name.endswith("]") and not name.endswith(f"[{e.name}]"):
            continue  # another experiment's own parameter
        moves[i] = _extra_step(problem.priors.get(name), float(vector[i]))
    plain = has_plain_mean(problem)
    if not plain:
        size = (1.0 if is_affine(problem) else 1e-3) * max(abs(vector[i_beta]), 1e-3)
        moves |= {i: (size, -np.inf, np.inf) for i in (i_y0, i_beta)}
    index = np.array([*moves, *([i_y0, i_beta] if plain else [])])
    d_mean, d_x = np.zeros((len(index), len(t))), np.zeros((len(index), len(t)))
    for row, (i, (step, low, high)) in enumerate(moves.items()):
        up, down = vector.copy(), vector.copy()
        up[i], down[i] = min(vector[i] + step, high), max(vector[i] - step, low)
        m_up, x_up = mean_and_response(problem, up, e, t)
        m_down, x_down = mean_and_response(problem, down, e, t)
        d_mean[row] = (m_up - m_down) / (up[i] - down[i])
        d_x[row] = (x_up - x_down) / (up[i] - down[i])
    if plain:
        d_mean[-2], d_mean[-1] = 1.0, x
    return mean, x, index, d_mean, d_x


def _extra_step(prior: Prior | None, value: float) -> tuple[float, float, float]:
    """Step of a difference quotient in a model's own parameter, and where that parameter ends."""
    if prior is None or np.isnan(prior.width):
        return 1e-3 * max(abs(value), 1e-2), -np.inf, np.inf
    return 1e-3 * prior.width, *prior.support
