"""A log-likelihood over psi, and its maximum with tau^2 not below zero."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property
from math import inf, sqrt

import numpy as np

from bayes_sensor.bounds.gaussian_intervals import invert, least_tau, mean_positions
from bayes_sensor.bounds.newton import (
    gradient_by_psi,
    learnt,
    mixed,
    projected_step,
    solve,
    theta_of,
)
from bayes_sensor.campaign import FloatArray
from bayes_sensor.likelihood.coordinates import Coordinates
from bayes_sensor.likelihood.mesh import NO_NOISE, Compressed, Region, compress, default_region
from bayes_sensor.likelihood.noise import Noise
from bayes_sensor.likelihood.problem import Problem

Objective = Callable[[FloatArray], tuple[float, FloatArray]]
Curvature = Callable[[FloatArray], FloatArray]


@dataclass(frozen=True, eq=False)
class Maximum:
    """Where a constrained maximisation ended."""

    psi: FloatArray
    """(n,)"""
    value: float
    free: FloatArray
    """(n,) the same or, if it is on the floor, after one more Newton step that may cross it: an
    estimate of psi as if tau^2 could be negative"""
    converged: bool


def maximise(
    objective: Objective,
    curvature: Curvature,
    start: FloatArray,
    active: np.ndarray,
    floor: FloatArray,
    ceiling: FloatArray | None = None,
    n_iterations: int = 60,
    tolerance: float = 1e-7,
    settled: float = 3e-4,
) -> Maximum:
    """Maximum over the ``active`` coordinates by Newton steps between ``floor`` and
    ``ceiling`` (n,).

    ``curvature`` gives minus the expected Hessian (n, n) at a point; it stops if the expected gain
    in the objective is below ``tolerance``.  Projected Newton (Bertsekas, SIAM J. Control Optim.
    20, 1982): coordinates on their floor stay there if the gradient points down; steps without gain
    are damped (Levenberg and Marquardt), and the curvature is corrected after each step (BFGS).  It
    also stops after two steps in a row that gained less than ``settled``: near tau = 0 the
    likelihood of a sampled record is not smooth in tau^2, because samples pass the kink at the
    switch.
    """
    ceiling = np.full(len(floor), np.inf) if ceiling is None else ceiling
    psi = np.clip(start, floor, ceiling)
    value, gradient = objective(psi)
    if not np.isfinite(value):
        return Maximum(psi, value, psi.copy(), False)
    converged = False
    base = matrix = curvature(psi)
    last_gain, damping = np.inf, 0.0
    for _ in range(n_iterations):
        for _ in range(12):
            step, clipped = projected_step(matrix, gradient, psi, floor, ceiling, active, damping)
            expected = float(gradient @ step)
            if damping == 0.0 and not clipped and expected < 2.0 * tolerance:
                converged = True
                break
            trial = np.clip(psi + step, floor, ceiling)
            trial_value, trial_gradient = objective(trial)
            if trial_value >= value - 1e-11 * abs(value):
                break
            damping = max(10.0 * damping, 1e-3)
        else:
            break
        if converged:
            break
        gained = trial_value - value
        taken, turned = trial - psi, gradient - trial_gradient
        psi, value, gradient = trial, trial_value, trial_gradient
        if damping == 0.0:
            if abs(gained) < 0.1 * tolerance or max(gained, last_gain) < settled:
                converged = True
                break
            last_gain = gained
        damping = 0.0 if damping <= 1e-3 else 0.1 * damping
        here = curvature(psi)
        matrix, base = learnt(matrix + (here - base), here, taken, turned, active), here
    free = psi.copy()
    if np.isfinite(floor[0]) and psi[0] <= floor[0] * (1 + 1e-9):
        free[active] += solve(matrix, gradient[active], active, 0.0)
    return Maximum(psi, float(value), free, converged)


@dataclass(frozen=True, eq=False)
class Surface:
    """The log-likelihood of a compressed problem in psi."""

    compressed: Compressed

    @cached_property
    def problem(self) -> Problem:
        """The problem of the mesh."""
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

    @cached_property
    def box(self) -> tuple[FloatArray, FloatArray]:
        """Lowest and highest psi (n_psi,) each that the mesh covers."""
        region, coordinates = self.compressed.region, self.coordinates
        low, high = self.floor.copy(), np.full(len(self.floor), np.inf)
        first, most = int(coordinates.shifts), 0.0
        if coordinates.shifts:
            most = region.high[self.problem.layout.tau]
            high[0] = most**2
        n = self.problem.layout.n_shared
        low[first:n], high[first:n] = region.low[first:n], region.high[first:n]
        for i in coordinates.switch_times:
            j = coordinates.free[i]
            # t0 must stay inside whatever tau is
            low[i], high[i] = region.low[j] + most, region.high[j]
            if low[i] >= high[i]:
                low[i], high[i] = -np.inf, np.inf
        return low, high

    def at_wall(self, psi: FloatArray) -> list[str]:
        """Names of parameters at an edge of the mesh, if no maximum was found inside it.

        A square at zero is not one of them, because a maximum may be there.
        """
        low, high = self.box
        margin = 1e-6 * np.where(np.isfinite(high - low), high - low, 1.0)
        walled = (psi >= high - margin) | (psi <= low + margin) & (low > self.floor)
        return [name for name, at in zip(self.coordinates.names, walled) if at]

    def psi(self, theta: FloatArray) -> FloatArray:
        """Coordinates of theta, raised to the floor (t0 + tau stays)."""
        return np.maximum(self.coordinates.psi(theta), self.floor)

    def objective(self, psi: FloatArray) -> tuple[float, FloatArray]:
        """Log-likelihood and its gradient by psi."""
        return self._at(theta_of(psi, *self._places))

    def _at(self, theta: FloatArray) -> tuple[float, FloatArray]:
        value, gradient = self.compressed.value_and_gradient(theta)
        return value, gradient_by_psi(theta, gradient, *self._places[1:])

    @cached_property
    def _places(self) -> tuple[np.ndarray, ...]:
        """Arguments of :func:`theta_of` beside psi."""
        c = self.coordinates
        return c.theta(np.zeros(len(c.names))), c.free, c.squared, c.switches, c.phi, c.log_sigmas

    def guarded(self, psi: FloatArray) -> tuple[float, FloatArray]:
        """:meth:`objective`, but minus infinity outside the mesh instead of a slow full pass."""
        theta = theta_of(psi, *self._places)
        if not self.compressed.covers(theta):
            return -np.inf, np.zeros(len(psi))
        return self._at(theta)

    def expansion(self, psi: FloatArray) -> FloatArray:
        """psi with tau^2 raised to its own spread: where a Gaussian is matched near tau = 0.

        The information on tau^2 falls as tau grows.  Computed at zero it would give upper limits
        that are too small.
        """
        point = psi.copy()
        for _ in range(3 if self.coordinates.shifts else 0):
            variance = invert(self.information(point))[0][0, 0]
            if not np.isfinite(variance) or psi[0] >= np.sqrt(variance):
                break
            # never beyond what the mesh covers
            top = 0.5 * self.compressed.region.high[self.problem.layout.tau] ** 2
            point[0] = max(psi[0], min(float(np.sqrt(variance)), top))
        return point

    @cached_property
    def _informations(self) -> dict[bytes, FloatArray]:
        return {}

    def information(self, psi: FloatArray) -> FloatArray:
        """Expected information (n_psi, n_psi); methods ask for it at the same places."""
        theta = self.coordinates.theta(np.maximum(psi, self.floor))
        key = theta.tobytes()
        if key not in self._informations:
            free = self.coordinates.free
            slopes = self.coordinates.slopes(theta)
            by_theta = self.compressed.information(theta)[np.ix_(free, free)]
            self._informations[key] = slopes.T @ by_theta @ slopes
        return self._informations[key].copy()


def coloured_surface(problem: Problem, theta: FloatArray) -> tuple[Surface, Maximum]:
    """The problem's own likelihood, its mesh centred on the maximum, and that maximum."""
    vector = problem.flat(theta)
    for row in problem.layout.noise:
        if "phi" not in {name.split("[")[0] for name in problem.fixed}:
            vector[row[0]] = np.clip(vector[row[0]], -0.995, 0.9995)
    # a badly fitting model moves far from where it started: then with more and more room
    for attempt in range(6):
        room = 1.5 if attempt < 2 else 4.0
        surface = Surface(compress(problem, vector, _roomy(problem, vector, room)))
        maximum = _climb(surface, vector, 15)
        vector = surface.coordinates.theta(maximum.psi)
        moved = np.abs(maximum.psi - surface.psi(surface.compressed.reference))
        spread = 1.0 / np.sqrt(np.maximum(np.diag(surface.information(maximum.psi)), 1e-300))
        # conditional spreads: the mesh reaches seven marginal ones, so this is near its centre
        if maximum.converged and (moved <= 3.0 * spread).all():
            break
    recentre = attempt > 0
    lags = problem.commuting.without_volumes
    for _ in range(3):
        if not lags.in_order(vector):
            # the chain is unchanged when lags swap; they are kept by size
            vector = lags.by_size(vector)
            recentre = True
        if recentre:
            surface = Surface(compress(problem, vector, _roomy(problem, vector)))
        maximum = _climb(surface, vector)
        vector = surface.coordinates.theta(maximum.psi)
        if lags.in_order(vector):
            break
    if surface.at_wall(maximum.psi) or not lags.in_order(vector):
        maximum = replace(maximum, converged=False)
    return surface, maximum


def curvature_along_tau(surface: Surface, psi: FloatArray, n: int = 6) -> Curvature:
    """Expected information as a function of tau alone, interpolated between ``n`` values of tau.

    The information depends mainly on tau.  The rest stays at ``psi`` (n_psi,), with t0 + tau.
    Of several sensors it is taken at ``psi`` alone.
    """
    if not surface.coordinates.shifts:
        alone = surface.information(psi)
        return lambda _: alone.copy()
    least, most = (
        float(np.sqrt(surface.floor[0])),
        float(surface.compressed.region.high[surface.problem.layout.tau]),
    )
    taus = least + (most - least) * np.linspace(0.0, 1.0, n) ** 1.5
    points = np.tile(psi, (n, 1))
    points[:, 0] = taus**2
    matrices = np.stack([surface.information(point) for point in points])

    def curvature(at: FloatArray) -> FloatArray:
        matrix: FloatArray = mixed(sqrt(max(at[0], 0.0)), taus, matrices)
        return matrix

    return curvature


ORDERED = 0.5
"""tau over tau_v up to which the spread of tau^2 is computed; above it the two exchange roles"""


def spread_along_tau(
    surface: Surface, psi: FloatArray, n: int = 5
) -> tuple[FloatArray, FloatArray] | None:
    """``n`` rising values of tau and the sd of estimates of tau^2 at these values.

    As far as a Gaussian about ``psi`` (n_psi,) reaches; the rest stays there, with t0 + tau.  None
    if tau is not clearly the fastest lag, because another order is not a small step in tau^2, and
    for several sensors.
    Infinite where tau^2 is not identified.
    """
    if not surface.coordinates.shifts:
        return None
    slower = [i for i in surface.problem.commuting.without_volumes.places if i != 0]
    longest = float(psi[slower[-1]]) if slower else inf
    if psi[0] > (ORDERED * longest) ** 2:
        return None
    point = surface.expansion(psi)
    reach = 6.0 * float(np.sqrt(invert(surface.information(point))[0][0, 0]))
    q = max(float(psi[0]), 0.0)
    most = min(sqrt(q + reach), ORDERED * longest) if np.isfinite(reach) else 0.0
    most = max(most, 1.2 * sqrt(q))
    most = min(most, float(surface.compressed.region.high[surface.problem.layout.tau]))
    least = float(np.sqrt(surface.floor[0]))
    taus = least + max(most - least, least) * np.linspace(0.0, 1.0, n)
    point = psi.copy()
    spreads = np.empty(n)
    for i, tau in enumerate(taus):
        point[0] = tau**2
        spreads[i] = np.sqrt(invert(surface.information(point))[0][0, 0])
    return taus, spreads


def _roomy(problem: Problem, vector: FloatArray, room: float = 1.5) -> Region:
    """The default region, ``room`` times as wide.  The information on tau^2 falls as tau grows, so
    likelihoods have longer upper tails than the information at a small tau suggests."""
    region = default_region(problem, vector)
    low, high = region.low.copy(), region.high.copy()
    layout, wider = problem.layout, room - 1.0
    switches, first = layout.all_switches, int(layout.one_sensor)
    low[switches] -= wider * (high[layout.tau] if first else vector[switches] - low[switches])
    high[switches] += (wider - 0.5) * (high[switches] - vector[switches])
    if first:
        high[layout.tau] += wider * high[layout.tau]
    for i in range(first, layout.n_shared):
        low[i] = max(low[i] - wider * (vector[i] - low[i]), 0.1 * vector[i])
        high[i] += wider * (high[i] - vector[i])
    return Region(low, high)


def _climb(surface: Surface, theta: FloatArray, n_iterations: int = 40) -> Maximum:
    psi = surface.psi(theta)
    n_made = 0
    matrix = surface.information(psi)

    def curvature(at: FloatArray) -> FloatArray:
        nonlocal n_made, matrix
        n_made += 1
        if n_made <= 4 or n_made % 4 == 0:
            matrix = surface.information(at)
        return matrix

    every = np.arange(len(psi))
    return maximise(surface.guarded, curvature, psi, every, *surface.box, n_iterations)


def white_surface(problem: Problem, theta: FloatArray, rms: float, region: Region) -> Surface:
    """Least squares as a likelihood: iid noise ``rms`` (V), on a mesh valid in ``region``.

    Its maximum is least squares.
    """
    noise = Noise("constant", "white", per_experiment=problem.noise.per_experiment)
    white = replace(problem, noise=noise)
    vector = theta.copy()
    for row in white.layout.noise:
        vector[row] = 0.0, rms, 0.0
    return Surface(compress(white, vector, region))


def region_of(problem: Problem, surface: Surface, theta: FloatArray) -> Region:
    """A region that contains that of ``surface``, as much around ``theta``, and every noise
    level."""
    region, about = surface.compressed.region, surface.compressed.reference
    # the same widths about theta; psi's t0 + tau and tf + tau are what stays put
    shift = theta - about
    layout = problem.layout
    if layout.one_sensor:
        shift[layout.tau] = max(shift[layout.tau], 0.0)
    low = np.minimum(region.low, np.maximum(region.low + shift, 0.1 * np.minimum(theta, about)))
    switches = layout.all_switches
    low[switches] = np.minimum(region.low[switches], region.low[switches] + shift[switches])
    high = np.maximum(region.high, region.high + shift)
    free = np.ones(len(low), dtype=bool)
    free[[*range(layout.n_shared), *switches]] = False
    low[free], high[free] = -np.inf, np.inf
    if layout.one_sensor:
        low[layout.tau] = 0.0
    for row in problem.layout.noise:
        least = NO_NOISE * about[row[1]]
        low[row], high[row] = (-1.0 + 1e-9, least, 0.0), (1.0 - 1e-9, np.inf, np.inf)
    return Region(low, high)
