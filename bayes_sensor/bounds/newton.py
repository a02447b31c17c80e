"""Compiled pieces of the projected Newton method: its step, its curvature, its coordinates.

A refit of a compressed campaign takes some ten microseconds a step in the likelihood.  These
functions keep the rest of the step as short.
"""

from __future__ import annotations

from math import exp, sqrt, tanh

import numpy as np
from numpy.typing import NDArray

from bayes_sensor.campaign import FloatArray
from bayes_sensor.compiled import compiled

IntArray = NDArray[np.int64]
RIDGE = 1e-7
"""of scaled curvature, far below any useful information; unidentified directions do not move"""


@compiled()
def factor(matrix: FloatArray) -> bool:
    """Cholesky factor in place, in the lower triangle; False where it does not exist."""
    n = len(matrix)
    for j in range(n):
        rest = matrix[j, j]
        for k in range(j):
            rest -= matrix[j, k] * matrix[j, k]
        if not rest > 0.0:
            return False
        root = sqrt(rest)
        matrix[j, j] = root
        for i in range(j + 1, n):
            rest = matrix[i, j]
            for k in range(j):
                rest -= matrix[i, k] * matrix[j, k]
            matrix[i, j] = rest / root
    return True


@compiled()
def solve(matrix: FloatArray, vector: FloatArray, some: IntArray, damping: float) -> FloatArray:
    """matrix^-1 vector (len(some),) of the rows and columns ``some``, scaled and with a ridge.

    If rounding makes the matrix indefinite, the ridge is raised until it is positive definite.
    """
    n = len(some)
    scale = np.empty(n)
    found = np.empty(n)
    for i in range(n):
        scale[i] = 1.0 / sqrt(max(matrix[some[i], some[i]], 1e-300))
    scaled = np.empty((n, n))
    ridge = RIDGE + damping
    while True:
        for i in range(n):
            for j in range(i + 1):
                scaled[i, j] = matrix[some[i], some[j]] * scale[i] * scale[j]
            scaled[i, i] += ridge
        if factor(scaled):
            break
        ridge *= 10.0
        if not ridge < 1e6:  # nothing finite to solve
            found[:] = 0.0
            return found
    for i in range(n):
        rest = vector[i] * scale[i]
        for k in range(i):
            rest -= scaled[i, k] * found[k]
        found[i] = rest / scaled[i, i]
    for i in range(n - 1, -1, -1):
        rest = found[i]
        for k in range(i + 1, n):
            rest -= scaled[k, i] * found[k]
        found[i] = rest / scaled[i, i]
    return found * scale


@compiled()
def projected_step(
    matrix: FloatArray,
    gradient: FloatArray,
    psi: FloatArray,
    floor: FloatArray,
    ceiling: FloatArray,
    active: IntArray,
    damping: float,
) -> tuple[FloatArray, bool]:
    """Newton step (n,) that keeps inside the box, and whether it had to be cut there.

    Coordinates on a wall stay there if the gradient points outwards.  A step through a wall ends at
    the wall, and the other coordinates are adjusted to that displacement.
    """
    step = np.zeros(len(psi))
    moving = np.empty(len(active), dtype=np.int64)
    n = 0
    for i in active:
        margin = 1e-9 * abs(psi[i])
        down = psi[i] <= floor[i] + margin and gradient[i] <= 0.0
        up = psi[i] >= ceiling[i] - margin and gradient[i] >= 0.0
        if not (down or up):
            moving[n] = i
            n += 1
    moving = moving[:n]
    found = solve(matrix, gradient[moving], moving, damping)
    rest = np.empty(n, dtype=np.int64)
    n_rest = 0
    for j in range(n):
        i = moving[j]
        step[i] = found[j]
        if floor[i] <= psi[i] + step[i] <= ceiling[i]:
            rest[n_rest] = i
            n_rest += 1
    if n_rest == n:
        return step, False
    rest = rest[:n_rest]
    for i in moving:
        reached = min(max(psi[i] + step[i], floor[i]), ceiling[i])
        step[i] = reached - psi[i]
    push = np.empty(n_rest)
    for j in range(n_rest):
        step[rest[j]] = 0.0
    for j in range(n_rest):
        push[j] = gradient[rest[j]]
        for i in moving:
            push[j] -= matrix[rest[j], i] * step[i]
    found = solve(matrix, push, rest, damping)
    for j in range(n_rest):
        step[rest[j]] = found[j]
    return step, True


@compiled()
def learnt(
    matrix: FloatArray,
    base: FloatArray,
    taken: FloatArray,
    turned: FloatArray,
    active: IntArray,
) -> FloatArray:
    """BFGS update of ``matrix`` (n, n): if the model fits badly, the expected curvature ``base``
    differs from the true one.  ``base`` itself where the update would not be positive definite."""
    n = len(active)
    pull = np.zeros(n)
    along = bent = 0.0
    for i in range(n):
        for j in range(n):
            pull[i] += matrix[active[i], active[j]] * taken[active[j]]
        along += taken[active[i]] * pull[i]
        bent += taken[active[i]] * turned[active[i]]
    if not (along > 0.0 and bent > 0.05 * along):
        return base
    result = matrix.copy()
    scaled = np.empty((n, n))
    for i in range(n):
        for j in range(n):
            result[active[i], active[j]] += (
                turned[active[i]] * turned[active[j]] / bent - pull[i] * pull[j] / along
            )
    for i in range(n):
        if not result[active[i], active[i]] > 1e-6 * base[active[i], active[i]]:
            return base
    for i in range(n):
        for j in range(i + 1):
            product = result[active[i], active[i]] * result[active[j], active[j]]
            scaled[i, j] = result[active[i], active[j]] / sqrt(product)
        scaled[i, i] -= 1e-9
    return result if factor(scaled) else base


@compiled()
def theta_of(
    psi: FloatArray,
    template: FloatArray,
    free: IntArray,
    squared: IntArray,
    switches: IntArray,
    phi: IntArray,
    log_sigmas: IntArray,
) -> FloatArray:
    """(n_theta,) of psi: ``Coordinates.theta`` for one vector; ``template`` holds what is fixed."""
    theta = template.copy()
    for i in range(len(free)):
        theta[free[i]] = psi[i]
    for i in squared:
        theta[free[i]] = sqrt(max(psi[i], 0.0))
    for i in switches:
        theta[free[i]] -= theta[free[0]]
    for i in phi:
        theta[free[i]] = min(max(tanh(psi[i]), -1.0 + 1e-12), 1.0 - 1e-12)
    for i in log_sigmas:
        theta[free[i]] = exp(min(psi[i], 300.0))
    return theta


@compiled()
def gradient_by_psi(
    theta: FloatArray,
    gradient: FloatArray,
    free: IntArray,
    squared: IntArray,
    switches: IntArray,
    phi: IntArray,
    log_sigmas: IntArray,
) -> FloatArray:
    """(n_psi,) of a gradient by theta: the transposed ``Coordinates.slopes`` without its matrix."""
    result = gradient[free]
    pulled = 0.0
    for i in switches:
        pulled += result[i]
    least = np.inf
    for i in log_sigmas:
        least = min(least, 1e-12 * theta[free[i]])
    for i in squared:
        result[i] *= 0.5 / max(theta[free[i]], 1e-12 if i == 0 else least)
    for i in phi:
        result[i] *= 1.0 - theta[free[i]] ** 2
    for i in log_sigmas:
        result[i] *= theta[free[i]]
    result[0] -= 0.5 / max(theta[free[0]], 1e-12) * pulled
    return result


@compiled()
def mixed(tau: float, taus: FloatArray, matrices: FloatArray) -> FloatArray:
    """The matrix (n, n) at ``tau``, linear between those of ``taus`` (m,)."""
    last = len(taus) - 1
    j = 0
    while j < last - 1 and taus[j + 1] < tau:
        j += 1
    share = min(max((tau - taus[j]) / (taus[j + 1] - taus[j]), 0.0), 1.0)
    matrix: FloatArray = (1.0 - share) * matrices[j] + share * matrices[j + 1]
    return matrix
