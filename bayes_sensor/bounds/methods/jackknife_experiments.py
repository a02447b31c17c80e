"""Jackknife over experiments: refits with one experiment left out.

It includes run-to-run variation, which no noise model within a run contains.  Shared parameters
only. Variance (n - 1)/n sum (psi_(-k) - mean)^2 with Student's t on n - 1 degrees of freedom
(Tukey, Ann. Math. Stat. 29, 614, 1958; Efron and Tibshirani, An Introduction to the Bootstrap,
1993, eq. 11.5).
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from scipy import stats

from bayes_sensor.bounds.bound import Bound
from bayes_sensor.bounds.context import Evidence
from bayes_sensor.bounds.gaussian_intervals import gaussian_bound
from bayes_sensor.bounds.likelihood_surface import Surface, maximise
from bayes_sensor.bounds.methods.bound_method import BoundMethod
from bayes_sensor.campaign import FloatArray
from bayes_sensor.likelihood.mesh import Compressed, Region, compress


def _parts(surface: Surface, theta: FloatArray) -> list[tuple[Compressed, np.ndarray]]:
    """Every experiment compressed alone, with the positions of its parameters in theta."""
    problem, region = surface.problem, surface.compressed.region
    parts = []
    for e in problem.campaign:
        alone = replace(problem, campaign=replace(problem.campaign, experiments=(e,)))
        index = np.array([problem.layout.index(name) for name in alone.layout.names])
        box = Region(region.low[index], region.high[index])
        parts.append((compress(alone, theta[index], box), index))
    return parts


def leave_one_out(surface: Surface, psi: FloatArray) -> tuple[FloatArray, bool]:
    """(n_experiments, n_psi) least squares without each experiment, as if tau^2 could be negative;
    entries of the experiment left out are not fitted.  Also whether all refits converged; it stops
    at the first that does not."""
    problem, coordinates = surface.problem, surface.coordinates
    theta = coordinates.theta(psi)
    parts = _parts(surface, theta)
    informations = []
    slopes = coordinates.slopes(theta)
    for compressed, index in parts:
        full = np.zeros((len(theta), len(theta)))
        full[np.ix_(index, index)] = compressed.information(theta[index])
        part = full[np.ix_(coordinates.free, coordinates.free)]
        informations.append(slopes.T @ part @ slopes)
    found = np.empty((len(parts), len(psi)))
    settled = True
    for left_out, e in enumerate(problem.campaign):
        kept = [i for i in range(len(parts)) if i != left_out]
        matrix = np.sum([informations[i] for i in kept], axis=0)
        active = np.array([i for i in surface.mean if f"[{e.name}]" not in coordinates.names[i]])

        def objective(at: FloatArray, kept: list[int] = kept) -> tuple[float, FloatArray]:
            vector = coordinates.theta(at)
            value, gradient = 0.0, np.zeros(len(vector))
            if not surface.compressed.covers(vector):  # a full pass over the samples otherwise
                return -np.inf, gradient[coordinates.free]
            for i in kept:
                compressed, index = parts[i]
                part_value, part_gradient = compressed.value_and_gradient(vector[index])
                value += part_value
                gradient[index] += part_gradient
            return value, coordinates.slopes(vector).T @ gradient[coordinates.free]

        def curvature(at: FloatArray, matrix: FloatArray = matrix) -> FloatArray:
            return matrix

        maximum = maximise(objective, curvature, psi, active, *surface.box, 30, 1e-6)
        found[left_out] = maximum.free
        settled = maximum.converged
        if not settled:
            break
    return found, settled


def jackknife_experiments(evidence: Evidence) -> Bound:
    """Leave one experiment out; the shared parameters."""
    surface = evidence.white
    names = surface.mean_names
    n = len(evidence.problem.campaign)
    if n < 3:
        reason = f"needs at least 3 experiments, there are {n}"
        return Bound.without_values(names, evidence.estimate, reason)
    found, settled = leave_one_out(surface, evidence.psi_white)
    own = evidence.problem.layout.shared_names
    shared = [i for i, name in enumerate(names) if name in own]
    values = found[:, surface.mean[shared]]
    deviation = values - values.mean(axis=0)
    cov = (n - 1) / n * deviation.T @ deviation
    short = gaussian_bound(
        [names[i] for i in shared],
        evidence.estimate[shared],
        cov,
        evidence.at_bound,
        lambda level: float(stats.t.ppf(0.5 + 0.5 * level, n - 1)),
        identified=evidence.white_cov[1][shared],
        status="" if settled else "a refit without one experiment did not settle",
        details={"n_experiments": n},
    )
    bound = Bound.without_values(names, evidence.estimate, short.status)
    sd, low, high = bound.sd.copy(), bound.low.copy(), bound.high.copy()
    if settled:  # a spread of unfinished fits would say nothing
        sd[shared], low[shared], high[shared] = short.sd, short.low, short.high
    return replace(bound, sd=sd, low=low, high=high, details=short.details)


METHOD = BoundMethod(
    name="jackknife_experiments",
    label="jackknife, experiments",
    assumes="least squares; experiments are exchangeable repeats, whatever the noise within them",
    compute=jackknife_experiments,
    reference="Tukey (1958); Efron and Tibshirani (1993), ch. 11",
    noise="any",
    shared_only=True,
)
