"""Derivatives of any model's mean and response at given times."""

from __future__ import annotations

import numpy as np

from bayes_sensor.campaign import FloatArray
from bayes_sensor.likelihood.density import mean_and_response
from bayes_sensor.likelihood.priors import Prior
from bayes_sensor.likelihood.problem import Problem
from bayes_sensor.rig.cascade import response_slopes


def mean_derivatives(
    problem: Problem, vector: FloatArray, k: int, t: FloatArray, interval: float | None = None
) -> tuple[FloatArray, FloatArray, np.ndarray, FloatArray, FloatArray]:
    """Mean and response of any model at times ``t`` (n_t,), and their derivatives.

    Returns mean (n_t,) V, response (n_t,), positions in theta (m,) of the parameters that move
    either, and the derivatives (m, n_t) of both: exact for the chain itself, by central differences
    for any other model.  Steps are then a thousandth of a time constant, of the step's height or of
    a prior's width: their error is a millionth, and a model that is computed numerically to five
    digits still gives a slope.  ``interval`` s: of times that are uniform, which makes the exact
    ones quicker.
    """
    layout = problem.layout
    e = problem.campaign.experiments[k]
    i_y0, i_beta = (int(i) for i in layout.local[k, :2])
    if problem.chain == "exact":
        x, index, slopes = response_slopes(t, vector, layout, k, e.total_flow, interval)
        d_x = np.zeros((len(index) + 2, len(t)))
        d_x[:-2] = slopes.T
        d_mean = vector[i_beta] * d_x
        d_mean[-2], d_mean[-1] = 1.0, x
        mean = vector[i_y0] + vector[i_beta] * x
        return mean, x, np.append(index, [i_y0, i_beta]), d_mean, d_x
    mean, x = mean_and_response(problem, vector, e, t)
    slowest = layout.slowest(vector, k, e.total_flow)
    moves = {int(i): (1e-3 * vector[i], 1e-12, np.inf) for i in layout.shared[k]}
    moves |= {int(i): (1e-3 * slowest, -np.inf, np.inf) for i in layout.switches(k)}
    for i, name in enumerate(layout.extra, len(layout) - len(layout.extra)):
        if name.endswith("]") and not name.endswith(f"[{e.name}]"):
            continue  # another experiment's own parameter
        moves[i] = _extra_step(problem.priors.get(name), float(vector[i]))
    plain = problem.has_plain_mean
    if not plain:
        size = (1.0 if problem.is_affine else 1e-3) * height(problem, vector, k)
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


def height(problem: Problem, vector: FloatArray, k: int) -> float:
    """V, the step of experiment number ``k``, by which its levels are moved; its noise where the
    step is smaller."""
    layout = problem.layout
    sigma0 = float(vector[layout.noise[k, 1]])
    return max(abs(float(vector[layout.local[k, 1]])), sigma0 if sigma0 > 0.0 else 0.0) or 1.0


def sizes(problem: Problem, vector: FloatArray) -> FloatArray:
    """(n_theta,) what a change of each parameter is small or large beside.

    Its own size; for y0 and beta the step's height, for switch times the slowest lag, for noise
    sigma0, for a model's own parameters the width of their prior.
    """
    layout = problem.layout
    found = np.maximum(np.abs(vector), 1e-3)
    for k, e in enumerate(problem.campaign):
        found[layout.local[k, :2]] = height(problem, vector, k)
        found[layout.switches(k)] = layout.slowest(vector, k, e.total_flow)
        found[layout.noise[k, 1:]] = vector[layout.noise[k, 1]]
    for i, name in enumerate(layout.extra, len(layout) - len(layout.extra)):
        prior = problem.priors.get(name)
        if prior is not None and not np.isnan(prior.width):
            found[i] = prior.width
    return found


def _extra_step(prior: Prior | None, value: float) -> tuple[float, float, float]:
    """Step of a difference quotient in a model's own parameter, and where that parameter ends."""
    if prior is None or np.isnan(prior.width):
        return 1e-3 * max(abs(value), 1e-2), -np.inf, np.inf
    return 1e-3 * prior.width, *prior.support
