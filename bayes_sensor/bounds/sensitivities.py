"""Sensitivities of one experiment's mean at every sample, fast enough for a whole campaign."""

from __future__ import annotations

from math import exp

import numpy as np
from numba import njit

from bayes_sensor.campaign import FloatArray
from bayes_sensor.likelihood.density import grid_response
from bayes_sensor.likelihood.mesh import sizes
from bayes_sensor.likelihood.problem import Problem
from bayes_sensor.rig.cascade import (
    Cascade,
    cascade_sensitivities,
    local_parameters,
    time_constants,
)

APART = 1e-3
"""relative distance of time constants below which the slow, stable form is used"""


@njit(cache=True, error_model="numpy")
def _add_edge(
    first: float, h: float, n: int, taus: FloatArray, edge: float, sign: float, out: FloatArray
) -> None:  # pragma: no cover - compiled
    # x3 = 1 - sum c_j E_j, c_j = tau_j^2 / prod (tau_j - tau_k); out (n, 5): tau_v, manifold,
    # tau, edge, x3; restarts the exponentials every 64 samples
    c = np.empty(3)
    dc = np.empty((3, 3))  # d c_k / d tau_j
    for j in range(3):
        c[j] = taus[j] * taus[j]
        for k in range(3):
            if k != j:
                c[j] /= taus[j] - taus[k]
    for k in range(3):
        dc[k, k] = 2.0 / taus[k] * c[k]
        for j in range(3):
            if j != k:
                dc[k, j] = c[k] / (taus[k] - taus[j])
                dc[k, k] -= c[k] / (taus[k] - taus[j])
    unit = np.empty(3)
    E = np.empty(3)
    for j in range(3):
        unit[j] = exp(-h / taus[j])
    slowest = max(taus[0], taus[1], taus[2])
    start = int(np.ceil((edge - first) / h))
    if start < 0:
        start = 0
    for i in range(start, n):
        s = first + i * h - edge
        if s < 0.0:
            continue
        if s > 45.0 * slowest:
            out[i, 4] += sign
            continue
        if (i - start) & 63 == 0:
            for j in range(3):
                E[j] = exp(-s / taus[j])
        x = 1.0
        rate = 0.0
        for j in range(3):
            x -= c[j] * E[j]
            rate += c[j] / taus[j] * E[j]
            out[i, j] -= sign * (
                dc[0, j] * E[0] + dc[1, j] * E[1] + dc[2, j] * E[2]
                + c[j] * s / (taus[j] * taus[j]) * E[j]
            )  # fmt: skip
        out[i, 3] -= sign * rate
        out[i, 4] += sign * x
        for j in range(3):
            E[j] *= unit[j]
            if E[j] < 1e-200:
                E[j] = 0.0


def local_jacobian(problem: Problem, vector: FloatArray, k: int) -> tuple[FloatArray, np.ndarray]:
    """Derivatives (n_t, m) of experiment ``k``'s mean by the parameters it depends on.

    Also their positions (m,) in the flat vector: tau, tau_v, V, y0, beta, t0, tf (if any), extras.
    Samples that are not used have zero rows.
    """
    layout, e = problem.layout, problem.campaign.experiments[k]
    extra = np.arange(len(layout) - len(layout.extra), len(layout))
    local = layout.local[k][layout.local[k] >= 0]
    index = np.concatenate([[0, 1, 2], local, extra]).astype(int)
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
    e = problem.campaign.experiments[k]
    _, beta, t0, tf = local_parameters(vector, problem.layout, e.name)
    taus = time_constants(vector[0], vector[1], vector[2], e.total_flow)
    gaps = np.abs(taus - np.roll(taus, 1)) / np.maximum(taus, np.roll(taus, 1))
    n = len(e.t)
    if gaps.min() < APART or not e.regular:
        dx = np.empty((n, 5))
        full = cascade_sensitivities(e.t, taus, t0, tf)
        dx[:, :4], off = full[:, :4], full[:, 4]
        dx[:, 4] = grid_response(e, taus, t0, tf)
    else:
        dx = np.zeros((n, 5))
        _add_edge(float(e.t[0]), e.interval, n, taus, t0, 1.0, dx)
        off = np.zeros(0)
        if tf is not None:
            fall = np.zeros((n, 5))
            _add_edge(float(e.t[0]), e.interval, n, taus, tf, -1.0, fall)
            off = fall[:, 3]
            dx[:, :3] += fall[:, :3]
            dx[:, 4] += fall[:, 4]
    columns = [beta * dx[:, 2], beta * dx[:, 0], beta / e.total_flow * dx[:, 1]]
    columns += [np.ones(n), dx[:, 4], beta * dx[:, 3]]
    if tf is not None:
        columns.append(beta * off)
    return np.stack(columns, axis=1)
