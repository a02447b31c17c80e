"""The log prior density of a problem, and its derivatives."""

from __future__ import annotations

from math import log, pi

import numpy as np
from numpy.typing import NDArray

from bayes_sensor.campaign import Campaign, FloatArray
from bayes_sensor.compiled import compiled
from bayes_sensor.likelihood.problem import Problem, as_problem
from bayes_sensor.rig.layout import Theta


def log_priors(problem: Problem, thetas: FloatArray) -> FloatArray:
    """(n,) natural log of the prior density at each row of ``thetas`` (n, n_theta).

    Flat laws count as 0, pinned parameters are left out; -inf outside the support, which holds
    lags by size only: tau <= tau_v for the published rig, and V/Q between them at one flow.
    """
    thetas = np.ascontiguousarray(np.atleast_2d(thetas), dtype=float)
    total = np.empty(len(thetas))
    places = np.array(problem.commuting.places, dtype=np.int64)
    to_lag = np.array(problem.commuting.to_lag, dtype=float)
    _sum_log_priors(thetas, *problem.prior_table, places, to_lag, total)
    if len(problem.name_factors[1]):
        total += np.logaddexp.reduce(problem.log_weights(thetas), axis=-1)
        total -= log(len(problem.assignments))
    return total


@compiled()
def _sum_log_priors(
    thetas: FloatArray,
    kinds: NDArray[np.int64],
    table: FloatArray,
    places: NDArray[np.int64],
    to_lag: FloatArray,
    total: FloatArray,
) -> None:
    # Prior.log_density for every parameter, in the order of KINDS; -inf where lags are not by size
    # (places, to_lag: where they stand, and what makes them lags)
    for n in range(len(thetas)):
        total[n] = 0.0
        for j in range(1, len(places)):
            shorter = thetas[n, places[j - 1]] * to_lag[j - 1]
            if not shorter <= thetas[n, places[j]] * to_lag[j]:
                total[n] = -np.inf
        for i in range(len(kinds)):
            x, a, b = thetas[n, i], table[i, 0], table[i, 1]
            if kinds[i] == 0:
                continue
            elif kinds[i] == 1:
                value = -0.5 * log(2 * pi) - log(b) - 0.5 * ((x - a) / b) ** 2
            elif kinds[i] == 2:
                value = 0.5 * log(2 / pi) - log(a) - 0.5 * (x / a) ** 2 if x >= 0.0 else -np.inf
            elif kinds[i] == 3:
                value = -np.inf
                if x > 0.0:
                    value = -0.5 * log(2 * pi) - log(b * x) - 0.5 * (log(x / a) / b) ** 2
            elif not a <= x <= b:
                value = -np.inf
            elif kinds[i] == 4:
                value = -log(b - a)
            else:
                value = -log(x * log(b / a))
            total[n] += value


def log_prior_derivatives(problem: Problem, theta: FloatArray) -> tuple[FloatArray, FloatArray]:
    """First derivative of the log prior and minus the second where that is positive, (n,) each."""
    first, second = np.zeros(len(theta)), np.zeros(len(theta))
    _prior_derivatives(theta, *problem.prior_table, first, second)
    place, kind, numbers, scale = problem.name_factors
    if len(kind):
        weights = problem.log_weights(theta)
        with np.errstate(invalid="ignore"):  # where none is possible the prior is zero anyway
            share = np.exp(weights - np.logaddexp.reduce(weights))
        slopes, curves = np.zeros((2, len(weights), len(theta)))
        for a in np.flatnonzero(share > 0.0):
            slope, curve = np.zeros(len(kind)), np.zeros(len(kind))
            _prior_derivatives(theta[place[a]] * scale[a], kind, numbers, slope, curve)
            np.add.at(slopes[a], place[a], slope * scale[a])
            np.add.at(curves[a], place[a], curve * scale[a] ** 2)
        mean = share @ slopes
        first += mean
        # the mixture is flatter than its parts by the spread of their slopes
        second += np.maximum(share @ curves - (share @ slopes**2 - mean**2), 0.0)
    return first, second


@compiled()
def _prior_derivatives(
    theta: FloatArray,
    kinds: NDArray[np.int64],
    table: FloatArray,
    first: FloatArray,
    second: FloatArray,
) -> None:
    for i in range(len(kinds)):
        x, a, b = theta[i], table[i, 0], table[i, 1]
        if kinds[i] == 1:
            second[i] = 1.0 / b**2
            first[i] = (a - x) * second[i]
        elif kinds[i] == 2:
            second[i] = 1.0 / a**2
            first[i] = -x * second[i]
        elif kinds[i] == 3:
            u = log(x / a) / b**2
            first[i] = -(1.0 + u) / x
            second[i] = max(1.0 / b**2 - 1.0 - u, 0.0) / x**2
        elif kinds[i] == 5:
            first[i] = -1.0 / x


def log_prior(campaign: Campaign | Problem, theta: Theta) -> float:
    """Natural log of the prior density at ``theta``; -inf outside the support.

    Lags may be given in any order, but where the campaign says that the sensor is the faster one.
    """
    problem = as_problem(campaign)
    return float(log_priors(problem, problem.by_size(theta)[None])[0])
