"""Residuals of the full pass, and the noise estimated from them."""

from __future__ import annotations

from math import log, sqrt
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy import optimize

from bayes_sensor.campaign import Experiment, FloatArray
from bayes_sensor.likelihood.density import mean_and_variance, response_at_samples
from bayes_sensor.likelihood.noise import lag_coefficient
from bayes_sensor.likelihood.problem import Problem


def residuals_of(problem: Problem, vector: FloatArray, k: int) -> tuple[FloatArray, FloatArray]:
    """r = y - m and x3, both (n_t,), of one experiment from the full pass; r is 0 where masked."""
    e = problem.campaign.experiments[k]
    mean, _ = mean_and_variance(problem, vector, k)
    r = np.where(e.used, e.values - mean, 0.0)
    if problem.chain == "exact":
        return r, response_at_samples(problem, vector, k)
    if problem.chain == "euler":
        y0, beta = vector[problem.layout.local[k, :2]]
        return r, (mean - y0) / beta if beta != 0 else np.zeros_like(mean)
    return r, problem.model.response(e.t, vector, problem.layout, e)


class Spread(NamedTuple):
    """Statistics of one experiment's residuals that the estimate of the noise needs."""

    r2: FloatArray  # r^2 of the used samples
    x: FloatArray  # weight * x3 there
    r: FloatArray  # (n_t,)
    variable: FloatArray  # (n_t,) weight * x3
    used: NDArray[np.bool_]
    steps: float
    fading: float
    places: FloatArray  # (n_t,) in sampling intervals, in hundredths of one where irregular

    def law(self, v0: float, v1: float, variable: FloatArray) -> FloatArray:
        """Variance at ``variable`` (n,) with sigma0^2 ``v0``, sigma1^2 ``v1``."""
        return v0 * (1.0 - self.fading * variable) + v1 * variable


def rough_places(e: Experiment) -> FloatArray:
    """(n_t,) :attr:`Experiment.places`, so rounded that few distances between them differ."""
    return np.round(e.places, 2)


def estimate_noise(
    problem: Problem, residuals: list[tuple[FloatArray, FloatArray]], rms: float
) -> dict[str, float]:
    """phi, sigma0, sigma1 by flat name.

    sigma0^2, sigma1^2: regression of r^2 on (1, weight x3), or where these are levels on
    (1 - weight x3, weight x3), neither negative, weighted once more by the inverse of the fitted
    variance squared.  phi: maximum of the AR(1) likelihood of r/s,
    with phi^(interval/reference) between neighbours.
    """
    campaign, layout, fading = problem.campaign, problem.layout, problem.noise.fading
    spreads = []
    for e, (r, x) in zip(campaign, residuals):
        variable = problem.noise.weight(campaign, e) * np.maximum(x, 0.0)
        if fading:
            variable = np.minimum(variable, 1.0)
        used, steps = e.used, problem.steps(e)
        spreads.append(
            Spread(r[used] ** 2, variable[used], r, variable, used, steps, fading, rough_places(e))
        )
    values: dict[str, float] = {}
    names = layout.names
    for positions in np.unique(layout.noise, axis=0):  # each set of noise parameters
        chosen = [spreads[k] for k, row in enumerate(layout.noise) if row[0] == positions[0]]
        own = rms
        if len(chosen) < len(spreads):
            own = sqrt(sum(s.r2.sum() for s in chosen) / sum(len(s.r2) for s in chosen))
        v0, v1 = fitted_variances(chosen, problem.noise.variance != "constant")
        v0 = max(v0, (1e-3 * own) ** 2, campaign.rounding**2)
        v1 = max(v1, fading * (1e-3 * own) ** 2)
        phi = 0.0
        if problem.noise.autocorrelation == "ar1":
            phi = _lag_one(chosen, v0, v1)
        for position, value in zip(positions, (phi, sqrt(v0), sqrt(v1)), strict=True):
            values[names[position]] = value
    return values


def fitted_variances(spreads: list[Spread], grows: bool) -> tuple[float, float]:
    """sigma0^2 and sigma1^2 that describe the squares ``r2`` best; ``grows``: sigma1 is free."""
    n = sum(len(s.r2) for s in spreads)
    mean = sum(float(s.r2.sum()) for s in spreads) / n
    if not grows or mean <= 0.0:
        return mean, 0.0
    v0, v1 = mean, mean * spreads[0].fading
    for _ in range(3):
        A, b = np.zeros((2, 2)), np.zeros(2)
        for s in spreads:
            w = 1.0 / np.square(s.law(max(v0, 1e-4 * mean), max(v1, s.fading * 1e-4 * mean), s.x))
            rest = 1.0 - s.fading * s.x
            wr, wx = w * rest, w * s.x
            A += [[(wr * rest).sum(), (wr * s.x).sum()], [(wr * s.x).sum(), wx @ s.x]]
            b += [wr @ s.r2, wx @ s.r2]
        scale = np.sqrt(np.maximum(np.diag(A), 1e-300))
        if A[1, 1] <= 0.0:
            return mean, 0.0
        # the square root of a positive semidefinite 2 x 2 system turns it into least squares
        solution, _ = optimize.nnls(A / np.outer(scale, scale), b / scale)
        v0, v1 = (float(v) for v in solution / scale)
    return v0, v1


def _lag_one(spreads: list[Spread], v0: float, v1: float) -> float:
    """phi from neighbouring samples; from samples further apart where most have no neighbour."""
    # what is closer than the rounding counts as that far apart: at no distance rho is 1
    distances = [np.maximum(np.round(np.diff(s.places[s.used]), 2), 0.01) for s in spreads]
    next_to_each_other = sum(int(np.sum(d == 1)) for d in distances)
    gaps = 2 * next_to_each_other < sum(len(d) for d in distances)
    gaps |= any(bool((d != np.rint(d)).any()) for d in distances)
    sums: dict[float, FloatArray] = {}
    for s, distance in zip(spreads, distances, strict=True):
        z = (s.r / np.sqrt(s.law(v0, v1, s.variable)))[s.used]
        for d in np.unique(distance) if gaps else [1]:
            a, b = z[1:][distance == d], z[:-1][distance == d]
            row = np.array([a @ a, a @ b, b @ b, len(a)])
            steps = round(s.steps * float(d), 9)
            sums[steps] = sums.get(steps, np.zeros(4)) + row
    if sum(row[3] for row in sums.values()) < 2:
        return 0.0
    if set(sums) == {1.0}:
        aa, ab, bb, _ = sums[1.0]
        return float(np.clip(ab / max(sqrt(aa * bb), 1e-300), -0.99999, 0.99999))

    def misfit(phi: float) -> float:
        total = 0.0
        for steps, (aa, ab, bb, n) in sums.items():
            rho = lag_coefficient(phi, steps)
            rest = 1.0 - rho * rho
            total += (aa - 2.0 * rho * ab + rho * rho * bb) / rest + n * log(rest)
        return total

    # a negative phi has real powers, and others than |phi|, at whole lags of which one is odd
    signs = [1.0]
    if gaps and all(steps == round(steps) for steps in sums) and any(k % 2 for k in sums):
        signs.append(-1.0)
    found = [
        optimize.minimize_scalar(
            lambda size, sign=sign: misfit(sign * size),
            bounds=(1e-9, 0.99999),
            method="bounded",
            options={"xatol": 1e-7},
        )
        for sign in signs
    ]
    best = min(range(len(found)), key=lambda i: float(found[i].fun))
    return signs[best] * float(found[best].x)


def mean_square(problem: Problem, vector: FloatArray) -> float:
    _, squares = all_residuals(problem, vector)
    return sum(squares) / problem.campaign.n_samples


def all_residuals(
    problem: Problem, vector: FloatArray
) -> tuple[list[tuple[FloatArray, FloatArray]], list[float]]:
    residuals = [residuals_of(problem, vector, k) for k in range(len(problem.campaign))]
    return residuals, [float(r @ r) for r, _ in residuals]
