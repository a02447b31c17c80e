"""The algebra of a refit, compiled: every experiment depends on shared coordinates and its own.

Derivatives (n_bins in all, n_columns) have a column for each shared coordinate and then one for
each of the experiment's own; ``places`` (n_experiments, n_columns) says which coordinates those
are, -1 where an experiment has fewer than others.  ``of_bins`` (n_experiments + 1,) says where
each experiment's bins begin and the last one's end.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from bayes_sensor.campaign import FloatArray
from bayes_sensor.compiled import compiled


def own_units(matrix: FloatArray) -> FloatArray:
    """(.., n) factors that give a normal matrix (.., n, n) a diagonal of ones.

    Volts, seconds and logarithms stand side by side in it: elimination compares its rows, and would
    lose another number of digits in every unit of the signal.
    """
    diagonal = np.diagonal(matrix, axis1=-2, axis2=-1)
    return np.asarray(1.0 / np.sqrt(np.where(diagonal > 0.0, diagonal, 1.0)))


def solved(matrix: FloatArray, right: FloatArray) -> FloatArray:
    """Solution of normal equations (.., n, n) for right-hand sides (n,) or (.., n, m)."""
    unit = own_units(matrix)
    scaled = matrix * unit[..., :, None] * unit[..., None, :]
    if right.ndim == 1:
        return np.asarray(unit * np.linalg.solve(scaled, unit * right))
    return np.asarray(unit[..., None] * np.linalg.solve(scaled, unit[..., None] * right))


def inverted(matrix: FloatArray) -> FloatArray:
    """Inverse of a normal matrix (n, n).

    >>> inverted(np.array([[1e24, 1e12], [1e12, 2.0]])).round(3).tolist()
    [[0.0, -0.0], [-0.0, 1.0]]
    """
    unit = own_units(matrix)
    both = np.outer(unit, unit)
    return np.asarray(np.linalg.inv(matrix * both) * both)


def whiten(factors: FloatArray, of_bins: NDArray[np.int64], values: FloatArray) -> FloatArray:
    """(n_bins in all, m) values over the floor.

    ``factors``: the inverses of its Cholesky factors, row by row, one experiment's after the
    other's.
    """
    made = np.empty_like(values)
    at = 0
    for k in range(len(of_bins) - 1):
        a, b = of_bins[k], of_bins[k + 1]
        n = b - a
        np.dot(factors[at : at + n * n].reshape(n, n), values[a:b], out=made[a:b])
        at += n * n
    return made


@compiled()
def normal_equations(
    derivatives: FloatArray,
    residual: FloatArray,
    of_bins: NDArray[np.int64],
    places: NDArray[np.int64],
    n: int,
) -> tuple[FloatArray, FloatArray]:
    """(n, n) the derivatives' products with each other, (n,) with the residual (n_bins in all,)."""
    normal, gradient = np.zeros((n, n)), np.zeros(n)
    for k in range(len(places)):
        here = derivatives[of_bins[k] : of_bins[k + 1]]
        products = np.dot(here.T, here)
        slopes = np.dot(here.T, residual[of_bins[k] : of_bins[k + 1]])
        for i, p in enumerate(places[k]):
            if p < 0:
                continue
            gradient[p] += slopes[i]
            for j, q in enumerate(places[k]):
                if q >= 0:
                    normal[p, q] += products[i, j]
    return normal, gradient


@compiled()
def broyden_update(
    derivatives: FloatArray,
    gained: FloatArray,
    moved: FloatArray,
    scale: FloatArray,
    of_bins: NDArray[np.int64],
    places: NDArray[np.int64],
) -> None:
    """Broyden's rule, in place: the derivatives as a step ``moved`` (n,) has shown them.

    ``gained`` (n_bins in all,): by how much the step has lowered the residual, where the
    derivatives promise their product with the step.  ``scale`` (n,): squares of the coordinates'
    derivatives, by which steps along them are compared.
    """
    width = places.shape[1]
    by, weights = np.empty(width), np.empty(width)
    for k in range(len(places)):
        length = 0.0
        for i, p in enumerate(places[k]):
            by[i] = moved[p] if p >= 0 else 0.0
            weights[i] = scale[p] * moved[p] if p >= 0 else 0.0
            length += by[i] * weights[i]
        if length == 0.0:  # an experiment whose coordinates are held, or at rest
            continue
        for b in range(of_bins[k], of_bins[k + 1]):
            missed = gained[b]
            for i in range(width):
                missed -= derivatives[b, i] * by[i]
            missed /= length
            for i in range(width):
                derivatives[b, i] += missed * weights[i]
