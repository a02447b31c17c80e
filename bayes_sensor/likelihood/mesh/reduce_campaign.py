"""Reduce a campaign to its mesh, and what is computed on a mesh made for one theta."""

from __future__ import annotations

from math import sqrt

import numpy as np

from bayes_sensor.campaign import Campaign, CampaignError, FloatArray
from bayes_sensor.likelihood.density import log_likelihood as full_log_likelihood
from bayes_sensor.likelihood.density import (
    mean_and_variance,
    noise_in_range,
)
from bayes_sensor.likelihood.mesh.blocks import Region
from bayes_sensor.likelihood.mesh.compressed import Compressed
from bayes_sensor.likelihood.mesh.mesh_region import default_region, narrow_region
from bayes_sensor.likelihood.problem import Problem, as_problem
from bayes_sensor.rig.layout import Theta

NO_TAU = 1e-6
"""of the fastest other time constant: a tau that no data tell from zero"""


def fastest_beside_tau(problem: Problem, vector: FloatArray) -> float:
    """s, the shortest time constant beside theta's first lag at the flat vector (n_theta,); the
    shortest sampling interval where there is none."""
    layout, some = problem.layout, vector.copy()
    some[layout.tau] = 1.0
    others = [
        np.delete(layout.taus(some, k, e.total_flow), layout.rig.sensor_lag)
        for k, e in enumerate(problem.campaign)
    ]
    return min(
        (float(taus.min()) for taus in others if taus.size),
        default=min(e.interval for e in problem.campaign),
    )


def above_zero(problem: Problem, vector: FloatArray) -> float:
    """s, theta's first lag of the flat vector (n_theta,); zero raised to a value that no data tell
    from it."""
    tau = float(vector[problem.layout.tau])
    return tau if tau != 0.0 else NO_TAU * fastest_beside_tau(problem, vector)


def compress(
    campaign: Campaign | Problem, theta: Theta, region: Region | None = None
) -> Compressed:
    """Reduce a campaign's data to a mesh around ``theta`` for fast likelihoods.

    ``theta`` should be near the maximum; without noise parameters the residuals' scatter and
    lag-one correlation stand in.  ``region`` (default: :func:`default_region`) is where the mesh
    is valid; outside, the full pass answers.  A design gives a mesh without data, good for
    ``information`` and ``nodes``.  A tau of zero, which has no response of its own, stands for one
    too small to tell from it.

    Raises CampaignError for a malformed theta, for time constants that are not positive, for a phi
    that is not between -1 and 1 where there is no ``region``, or for forward Euler.
    """
    problem = as_problem(campaign)
    vector = _place(problem, theta)
    return Compressed(problem, vector, region or default_region(problem, vector))


def _place(problem: Problem, theta: Theta) -> FloatArray:
    """The flat vector (n_theta,) that a mesh may be built around; raises as :func:`compress`."""
    if problem.chain == "euler":
        raise CampaignError(
            "forward Euler has its switches on samples and cannot be compressed; "
            "use the exact response, Cascade()"
        )
    vector = problem.flat(theta)
    vector[problem.layout.tau] = above_zero(problem, vector)
    for k, e in enumerate(problem.campaign):
        problem.layout.taus(vector, k, e.total_flow)  # raises where one is not positive
    if np.isnan(vector).any():
        vector = _with_rough_noise(problem, vector)
    return vector


def _with_rough_noise(problem: Problem, vector: FloatArray) -> FloatArray:
    vector = vector.copy()
    layout = problem.layout
    squares, lags, n = 0.0, 0.0, 0
    for k, e in enumerate(problem.campaign):
        if e.y is None:
            raise CampaignError(
                f"experiment '{e.name}' is a design: theta needs phi, sigma0_V and sigma1_V"
            )
        zeroed = np.where(np.isnan(vector), 1.0, vector)
        r = (e.values - mean_and_variance(problem, zeroed, k)[0])[e.used]
        squares += float(r @ r)
        lags += float(r[1:] @ r[:-1])
        n += len(r)
    for row in layout.noise:
        if np.isnan(vector[row[1]]):
            vector[row[1]] = sqrt(max(squares / n, 1e-300))
            if vector[row[0]] == 0.0 and problem.noise.autocorrelation == "ar1":
                vector[row[0]] = float(np.clip(lags / max(squares, 1e-300), 0.0, 0.99))
    return vector


def log_likelihood(campaign: Campaign | Problem, theta: Theta, compressed: bool = False) -> float:
    """Exact Gaussian log-likelihood of all samples at ``theta``; -inf outside its range.

    ``compressed=True`` evaluates the same on a mesh built around ``theta``; for many evaluations
    keep the object that :func:`compress` returns instead.  What the problem's noise law pins has
    its pinned value in both (:meth:`Problem.flat`).

    Raises CampaignError for a malformed ``theta`` or a design without data.
    """
    if compressed:
        problem = as_problem(campaign)
        vector = problem.flat(theta)
        if any(noise_in_range(problem, vector, k) is None for k in range(len(problem.campaign))):
            return -np.inf
        for e in problem.campaign:
            e.values  # noqa: B018 - raises CampaignError for a design
        return compress(problem, vector).log_likelihood(vector)
    return full_log_likelihood(campaign, theta)


def expected_information(problem: Problem, vector: FloatArray) -> FloatArray:
    """Expected Fisher information (n_theta, n_theta) at ``vector``, on a mesh made for it alone.

    A tau of zero is raised to one too small to tell from it.
    """
    longest = max(e.interval for e in problem.campaign)
    vector = _place(problem, vector)
    region = narrow_region(problem.layout, vector, 2.0 * longest)
    return Compressed(problem, vector, region, data=False).information(vector)
