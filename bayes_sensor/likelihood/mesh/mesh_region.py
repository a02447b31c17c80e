"""The region of theta for which a mesh is built."""

from __future__ import annotations

from math import sqrt

import numpy as np

from bayes_sensor.campaign import FloatArray
from bayes_sensor.likelihood.mesh.blocks import Region, build
from bayes_sensor.likelihood.mesh.compressed import Compressed, is_cascade
from bayes_sensor.likelihood.problem import Problem
from bayes_sensor.rig.layout import Layout

NO_NOISE = 1e-10
"""of sigma0: another sigma0 that no data tell from zero"""


def default_region(problem: Problem, vector: FloatArray, spread: float = 7.0) -> Region:
    """The box that holds the posterior around ``vector`` to ``spread`` standard deviations.

    Spreads come from the expected information in the coordinates (tau^2, t0 + tau, tf + tau),
    in which the likelihood is close to Gaussian; t0 and tf may in addition move by all that tau
    can.  Directions about which the data say nothing are capped.
    """
    layout, n = problem.layout, problem.layout.n_shared
    low, high = np.full(len(vector), -np.inf), np.full(len(vector), np.inf)
    slowest = [layout.slowest(vector, k, e.total_flow) for k, e in enumerate(problem.campaign)]
    low[:n], high[:n] = 0.5 * vector[:n], 2.0 * vector[:n]
    for k, width in enumerate(slowest):
        for i in layout.switches(k):
            low[i], high[i] = vector[i] - 0.05 * width, vector[i] + 0.05 * width
    rough = Compressed.__new__(Compressed)
    rough.problem, rough.reference = problem, vector
    rough.region = Region(low, high)
    rough.arrays = build(problem, vector, rough.region, data=False)
    rough._cascade, rough._known_times = is_cascade(problem), {}
    variances = _psi_variances(problem, vector, rough.information(vector))
    tau = tau_high = 0.0
    if layout.one_sensor:
        tau, fastest = vector[layout.tau], min(slowest)
        sd_square = min(sqrt(variances[layout.tau]), fastest**2)
        tau_high = min(sqrt(tau**2 + spread * sd_square), max(2.0 * tau, 3.0 * fastest))
        low[layout.tau], high[layout.tau] = 0.0, tau_high
    for i in range(int(layout.one_sensor), n):
        sd = min(spread * sqrt(variances[i]), 4.0 * vector[i])
        low[i], high[i] = max(vector[i] - sd, 0.2 * vector[i]), vector[i] + sd
    for k, width in enumerate(slowest):
        for i in layout.switches(k):
            sd = min(spread * sqrt(variances[i]), 3.0 * width)
            low[i] = vector[i] + tau - tau_high - sd
            high[i] = vector[i] + tau + sd
    for row in layout.noise:
        low[row[0]], high[row[0]] = -1.0 + 1e-9, 1.0 - 1e-9
        least = NO_NOISE * vector[row[1]]
        low[row[1]], low[row[2]] = least, least * problem.noise.fading
    for i, name in enumerate(layout.extra, len(layout) - len(layout.extra)):
        prior = problem.priors.get(name)
        if prior is not None and prior.law is not None:
            low[i], high[i] = prior.law.ppf(1e-7), prior.law.ppf(1.0 - 1e-7)
            low[i], high[i] = min(low[i], vector[i]), max(high[i], vector[i])
    return Region(low, high)


def _psi_variances(problem: Problem, vector: FloatArray, information: FloatArray) -> FloatArray:
    """Variances of (tau^2, .., t0 + tau, tf + tau, ..) from the information on theta."""
    layout = problem.layout
    transform = np.eye(len(vector))  # d theta / d psi
    if layout.one_sensor:
        longest = float(problem.commuting.lags(vector).max(initial=vector[layout.tau]))
        tau = max(vector[layout.tau], 1e-3 * max(longest, 1e-12))
        transform[layout.tau, layout.tau] = 0.5 / tau
        transform[layout.all_switches, layout.tau] = -0.5 / tau
    info = transform.T @ information @ transform
    free = np.flatnonzero(np.diag(info) > 0)
    scale = 1.0 / np.sqrt(np.diag(info)[free])
    scaled = info[np.ix_(free, free)] * np.outer(scale, scale)
    values, vectors = np.linalg.eigh(scaled)
    values = np.maximum(values, 1e-12)
    variances = np.full(len(vector), np.inf)
    variances[free] = ((vectors**2) / values).sum(axis=1) * scale**2
    return variances


def narrow_region(layout: Layout, vector: FloatArray, width: float) -> Region:
    """A box about ``vector``, no wider than it must be; switch times within ``width`` s."""
    low, high = np.full(len(vector), -np.inf), np.full(len(vector), np.inf)
    n, i = layout.n_shared, layout.all_switches
    low[:n], high[:n] = 0.9 * vector[:n], 1.1 * vector[:n]
    low[i], high[i] = vector[i] - width, vector[i] + width
    for row in layout.noise:
        low[row[0]], high[row[0]] = -1.0, 1.0
        low[row[1:]] = 0.0
    return Region(low, high)
