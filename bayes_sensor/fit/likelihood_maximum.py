"""The highest likelihood near a start, noise included, by Fisher scoring."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from bayes_sensor.campaign import FloatArray
from bayes_sensor.likelihood.coordinates import Coordinates
from bayes_sensor.likelihood.mesh import Compressed, compress, default_region
from bayes_sensor.likelihood.problem import Problem

MOST_STEPS = 60
GAIN = 0.01
"""of the log-likelihood, below which a step ends the search"""
ROOM = 0.2
"""of the longest lag, to which the mesh holds for every shorter one"""


def likelihood_maximum(
    problem: Problem, vector: FloatArray, low: FloatArray, high: FloatArray
) -> tuple[float, FloatArray]:
    """Highest log-likelihood and where it is, (n_theta,).

    Steps of the expected information in the coordinates (tau^2, t0 + tau, .., atanh phi, log
    sigma0), damped until they climb (Levenberg's rule).  ``vector`` (n_theta,): the start, near the
    maximum; ``low``, ``high`` (n_theta,): limits, infinite where there are none.
    """
    vector = np.clip(vector, low, high)
    mesh = _mesh(problem, vector, low)
    vector[problem.layout.tau] = mesh.reference[problem.layout.tau]
    search = _Search(mesh, Coordinates(problem), low, high)
    value, damping = mesh.log_likelihood(vector), 1e-6
    information = search.information(vector)
    for _ in range(MOST_STEPS):
        found = search.step(value, vector, information, damping)
        if found is None:
            break
        gain, slow = found[0] - value, found[2] >= damping
        value, vector, damping = found
        if gain < GAIN:
            break
        if slow:  # the information changes little, but for a start that is far away
            information = search.information(vector)
    return float(value), vector


def _mesh(problem: Problem, vector: FloatArray, low: FloatArray) -> Compressed:
    """The data reduced to a mesh that also holds where the shorter lags vanish."""
    layout = problem.layout
    n, region = layout.n_shared, default_region(problem, vector)
    pairs = [(layout.slowest(vector, k, e.total_flow), e) for k, e in enumerate(problem.campaign)]
    room = ROOM * max(longest for longest, _ in pairs)
    flow = max(e.total_flow for _, e in pairs)
    sizes = np.array([flow if name.startswith("V_") else 1.0 for name in layout.shared_names])
    lowest, highest = region.low.copy(), region.high.copy()
    short = vector[:n] < room * sizes
    lowest[:n][short] = np.minimum(lowest[:n], low[:n])[short]
    highest[:n][short] = np.maximum(highest[:n], room * sizes)[short]
    lowest[layout.all_switches] -= room
    return compress(problem, vector, replace(region, low=lowest, high=highest))


@dataclass(frozen=True, eq=False)
class _Search:
    mesh: Compressed
    coordinates: Coordinates
    low: FloatArray
    high: FloatArray

    def information(self, vector: FloatArray) -> FloatArray:
        """Expected information (n_psi, n_psi) in the coordinates."""
        slopes, free = self.coordinates.slopes(vector), self.coordinates.free
        found: FloatArray = slopes.T @ self.mesh.information(vector)[np.ix_(free, free)] @ slopes
        return found

    def step(
        self, value: float, vector: FloatArray, information: FloatArray, damping: float
    ) -> tuple[float, FloatArray, float] | None:
        """The next value, its place and damping; None where no step climbs."""
        free = self.coordinates.free
        g = self.coordinates.slopes(vector).T @ self.mesh.gradient(vector)[free]
        edge = (vector[free] <= self.low[free]) & (g < 0.0)
        edge |= (vector[free] >= self.high[free]) & (g > 0.0)
        moves = ~edge & (np.diag(information) > 0.0)
        if not moves.any():
            return None
        scale = 1.0 / np.sqrt(np.diag(information)[moves])
        matrix = information[np.ix_(moves, moves)] * np.outer(scale, scale)
        psi = self.coordinates.psi(vector)
        while damping < 1e8:
            step = np.zeros(len(g))
            damped = matrix + damping * np.eye(len(matrix))
            step[moves] = scale * np.linalg.solve(damped, scale * g[moves])
            new = np.clip(self.coordinates.theta(psi + step), self.low, self.high)
            there = self.mesh.log_likelihood(new)
            if np.isfinite(there) and there > value:
                return there, new, max(0.1 * damping, 1e-9)
            damping *= 10.0
        return None
