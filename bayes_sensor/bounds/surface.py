"""A log-likelihood over psi, and its maximum with tau^2 kept from going below zero."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from bayes_sensor.bounds.gaussian import invert, least_tau, mean_positions
from bayes_sensor.campaign import FloatArray
from bayes_sensor.compression import Compressed, Region, compress, default_region
from bayes_sensor.laplace import Coordinates
from bayes_sensor.likelihood import Problem
from bayes_sensor.noise import Noise

Objective = Callable[[FloatArray], tuple[float, FloatArray]]
Curvature = Callable[[FloatArray], FloatArray]


@dataclass(frozen=True, eq=False)
class Maximum:
    """Where a constrained maximisation ended."""

    psi: FloatArray
    """(n,)"""
    value: float
    free: FloatArray
    """(n,) the same with one more Newton step that may cross the floor: an estimate of psi as if
    tau^2 could be negative"""
    converged: bool


def maximise(
    objective: Objective,
    curvature: Curvature,
    start: FloatArray,
    active: np.ndarray,
    floor: FloatArray,
    n_iterations: int = 60,
    tolerance: float = 1e-7,
    settled: float = 3e-4,
) -> Maximum:
    """Maximum over the ``active`` coordinates by Newton steps, none below ``floor`` (n,).

    ``curvature`` gives minus the expected Hessian (n, n) at a point; ``tolerance`` is the gain in
    the objective still to be had at which it stops.  Projected Newton (Bertsekas, SIAM J. Control
    Optim. 20, 1982): coordinates on their floor that the gradient pushes down stay there.  It also
    stops after two steps in a row that gained less than ``settled``: near tau = 0 the likelihood of
    a sampled record is finely jagged in tau^2, because samples pass the kink at the switch.
    """
    psi = np.maximum(start, floor)
    value, gradient = objective(psi)
    converged = False
    matrix = curvature(psi)
    last_gain = np.inf
    for _ in range(n_iterations):
        held = (psi <= floor * (1 + 1e-9)) & (gradient <= 0) & np.isfinite(floor)
        moving = active[~held[active]]
        step = np.zeros(len(psi))
        step[moving] = _solve(matrix[np.ix_(moving, moving)], gradient[moving])
        below = moving[psi[moving] + step[moving] < floor[moving]]
        if len(below):
            # go to the floor and let the others answer to that displacement
            step[:] = 0.0
            step[below] = floor[below] - psi[below]
            rest = np.setdiff1d(moving, below)
            push = gradient[rest] - matrix[np.ix_(rest, below)] @ step[below]
            step[rest] = _solve(matrix[np.ix_(rest, rest)], push)
        expected = float(gradient @ step)
        if not len(below) and expected < 2.0 * tolerance:
            converged = True
            break
        scale = 1.0
        for _ in range(25):
            trial = np.maximum(psi + scale * step, floor)
            trial_value, trial_gradient = objective(trial)
            if trial_value >= value - 1e-11 * abs(value):
                break
            scale *= 0.5
        else:
            break
        gained = trial_value - value
        psi, value, gradient = trial, trial_value, trial_gradient
        if abs(gained) < 0.1 * tolerance or max(gained, last_gain) < settled:
            converged = True
            break
        last_gain = gained
        matrix = curvature(psi)
    free = psi.copy()
    free[active] += _solve(matrix[np.ix_(active, active)], gradient[active])
    return Maximum(psi, float(value), free, converged)


def _solve(matrix: FloatArray, vector: FloatArray) -> FloatArray:
    if not len(vector):
        return vector
    scale = 1.0 / np.sqrt(np.maximum(np.diag(matrix), 1e-300))
    scaled = matrix * np.outer(scale, scale)
    # a ridge far below any information that counts, so that unidentified directions stay put
    scaled[np.diag_indices(len(scaled))] += 1e-12
    return scale * np.linalg.solve(scaled, scale * vector)


@dataclass(frozen=True, eq=False)
class Surface:
    """The log-likelihood of a compressed problem in psi."""

    compressed: Compressed

    @cached_property
    def problem(self) -> Problem:
        """What the mesh was made for."""
        return self.compressed.problem

    @cached_property
    def coordinates(self) -> Coordinates:
        """The map between theta and psi."""
        return Coordinates(self.problem)

    @cached_property
    def mean(self) -> np.ndarray:
        """Positions in psi of the mean's parameters (and extras)."""
        return mean_positions(self.coordinates)

    @cached_property
    def mean_names(self) -> list[str]:
        """Their flat names."""
        return [self.coordinates.names[i] for i in self.mean]

    @cached_property
    def floor(self) -> FloatArray:
        """(n_psi,) lowest value of each square: a tau that is a pure delay, a negligible sigma1."""
        floor = np.full(len(self.coordinates.names), -np.inf)
        sigma0 = self.compressed.reference[self.problem.layout.noise[0, 1]]
        for i in self.coordinates.squared:
            name = self.coordinates.names[i]
            floor[i] = (least_tau(self.compressed) if name == "tau_s" else 0.02 * sigma0) ** 2
        return floor

    def psi(self, theta: FloatArray) -> FloatArray:
        """Coordinates of theta, raised to the floor (t0 + tau stays)."""
        return np.maximum(self.coordinates.psi(theta), self.floor)

    def objective(self, psi: FloatArray) -> tuple[float, FloatArray]:
        """Log-likelihood and its gradient by psi."""
        theta = self.coordinates.theta(psi)
        value, gradient = self.compressed.value_and_gradient(theta)
        slopes = self.coordinates.slopes(theta)
        return value, slopes.T @ gradient[self.coordinates.free]

    def guarded(self, psi: FloatArray) -> tuple[float, FloatArray]:
        """:meth:`objective`, but minus infinity outside the mesh instead of a slow full pass."""
        theta = self.coordinates.theta(psi)
        region = self.compressed.region
        if not ((theta >= region.low) & (theta <= region.high)).all():
            return -np.inf, np.zeros(len(psi))
        return self.objective(psi)

    def expansion(self, psi: FloatArray) -> FloatArray:
        """psi with tau^2 raised to its own spread: where a Gaussian is matched near tau = 0.

        The information on tau^2 falls as tau grows; taken at zero it would promise upper limits
        that the likelihood does not keep.
        """
        point = psi.copy()
        for _ in range(3):
            variance = invert(self.information(point))[0][0, 0]
            if not np.isfinite(variance) or psi[0] >= np.sqrt(variance):
                break
            # never beyond what the mesh covers
            top = 0.5 * self.compressed.region.high[0] ** 2
            point[0] = max(psi[0], min(float(np.sqrt(variance)), top))
        return point

    def information(self, psi: FloatArray) -> FloatArray:
        """Expected information (n_psi, n_psi)."""
        theta = self.coordinates.theta(np.maximum(psi, self.floor))
        free = self.coordinates.free
        slopes = self.coordinates.slopes(theta)
        return slopes.T @ self.compressed.information(theta)[np.ix_(free, free)] @ slopes


def coloured_surface(problem: Problem, theta: FloatArray) -> tuple[Surface, Maximum]:
    """The problem's own likelihood, its mesh centred on the maximum, and that maximum."""
    vector = theta.copy()
    layout = problem.layout
    for name, value in problem.fixed.items():
        vector[layout.index(name)] = value
    for row in layout.noise:
        if "phi" not in {name.split("[")[0] for name in problem.fixed}:
            vector[row[0]] = np.clip(vector[row[0]], -0.995, 0.9995)
    surface = Surface(compress(problem, vector, _roomy(problem, vector)))
    for _ in range(4):
        maximum = _climb(surface, vector)
        vector = surface.coordinates.theta(maximum.psi)
        moved = np.abs(maximum.psi - surface.psi(surface.compressed.reference))
        spread = 1.0 / np.sqrt(np.maximum(np.diag(surface.information(maximum.psi)), 1e-300))
        # conditional spreads: the mesh reaches seven marginal ones, so this is near its centre
        near = bool((moved <= 3.0 * spread).all())
        surface = Surface(compress(problem, vector, _roomy(problem, vector)))
        if near:
            break
    return surface, _climb(surface, vector)


def curvature_along_tau(surface: Surface, psi: FloatArray, n: int = 9) -> Curvature:
    """Expected information as a function of tau alone, interpolated between ``n`` values of tau.

    tau is what the information depends on most; the rest stays at ``psi`` (n_psi,), with t0 + tau.
    """
    least, most = float(np.sqrt(surface.floor[0])), float(surface.compressed.region.high[0])
    taus = least + (most - least) * np.linspace(0.0, 1.0, n) ** 1.5
    matrices = []
    for tau in taus:
        point = psi.copy()
        point[0] = tau**2
        matrices.append(surface.information(point))

    def curvature(at: FloatArray) -> FloatArray:
        tau = float(np.sqrt(max(at[0], surface.floor[0])))
        j = int(np.clip(np.searchsorted(taus, tau) - 1, 0, n - 2))
        share = min(max((tau - taus[j]) / (taus[j + 1] - taus[j]), 0.0), 1.0)
        mixed: FloatArray = (1.0 - share) * matrices[j] + share * matrices[j + 1]
        return mixed

    return curvature


def _roomy(problem: Problem, vector: FloatArray) -> Region:
    """The default region half as wide again: the information on tau^2 falls as tau grows, so that
    likelihoods have longer tails upwards than it tells at a small tau."""
    region = default_region(problem, vector)
    low, high = region.low.copy(), region.high.copy()
    switches = problem.layout.local[:, 2:].ravel()
    switches = switches[switches >= 0]
    more = 0.5 * high[0]
    high[0] += more
    low[switches] -= more
    for i in (1, 2):
        low[i] = max(low[i] - 0.5 * (vector[i] - low[i]), 0.1 * vector[i])
        high[i] += 0.5 * (high[i] - vector[i])
    return Region(low, high)


def _climb(surface: Surface, theta: FloatArray) -> Maximum:
    psi = surface.psi(theta)
    n_made = 0
    matrix = surface.information(psi)

    def curvature(at: FloatArray) -> FloatArray:
        nonlocal n_made, matrix
        n_made += 1
        if n_made <= 3 or n_made % 5 == 0:
            matrix = surface.information(at)
        return matrix

    return maximise(surface.objective, curvature, psi, np.arange(len(psi)), surface.floor)


def white_problem(problem: Problem) -> Problem:
    """The same mean under iid noise: its maximum likelihood is least squares."""
    return replace(
        problem, noise=Noise("constant", "white", per_experiment=problem.noise.per_experiment)
    )


def white_surface(
    problem: Problem, theta: FloatArray, rms: float, region: Region
) -> tuple[Surface, Maximum]:
    """Least squares as a likelihood of noise ``rms`` (V) on a mesh valid in ``region``."""
    white = white_problem(problem)
    vector = theta.copy()
    for row in white.layout.noise:
        vector[row] = 0.0, rms, 0.0
    surface = Surface(compress(white, vector, region))
    psi = surface.psi(vector)
    matrix = surface.information(psi)
    maximum = maximise(surface.objective, lambda _: matrix, psi, surface.mean, surface.floor)
    return surface, maximum


def region_of(problem: Problem, surface: Surface) -> Region:
    """The mesh region of ``surface`` with every noise level allowed."""
    low, high = surface.compressed.region.low.copy(), surface.compressed.region.high.copy()
    for row in problem.layout.noise:
        low[row], high[row] = (-1.0 + 1e-9, 1e-12, 0.0), (1.0 - 1e-9, np.inf, np.inf)
    return Region(low, high)
