"""Trust-region refinement on weighted points, in the coordinates where the valley is straight."""

from __future__ import annotations

from itertools import pairwise
from math import sqrt
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy import optimize

from bayes_sensor.campaign import FloatArray
from bayes_sensor.fit.block_averages import Points, joined
from bayes_sensor.fit.euler import euler_slopes
from bayes_sensor.likelihood.mesh import Region, compress, mean_derivatives
from bayes_sensor.likelihood.problem import Problem
from bayes_sensor.rig.cascade import response_slopes
from bayes_sensor.rig.layout import Layout


class Squares:
    """Residuals and Jacobian on points in the coordinates of the refinement.

    Coordinates: tau^2, other shared parameters, per experiment y0, beta, t0 + tau, tf + tau, then
    extra parameters; ``straight=False``, or several sensors: theta itself.  Times count from the
    start of each record, and the signal from its level in its own unit. Tolerances on steps and
    gradients are then the same for every clock, offset and unit.  Each experiment's block [J r] is
    replaced by the triangular factor of its QR decomposition: it has the same norm, the same J'J
    and J'r, and a few rows in place of hundreds.
    """

    def __init__(self, problem: Problem, points: Points, straight: bool = True) -> None:
        self.problem, self.points = problem, points
        self.layout: Layout = problem.layout
        self.straight = straight and self.layout.one_sensor
        self.edges, self.tau = self.layout.all_switches, self.layout.tau
        self.starts = np.array([float(e.t[0]) for e in problem.campaign])
        begin = np.zeros(self.layout.n_mean)
        for k, start in enumerate(self.starts):
            # times, not delays, are of the record's own clock
            if not any(self.layout.switching[k].offsets) and self.layout.switching[k].moves:
                begin[self.layout.switches(k)] = start
        self.begin = begin[self.edges]
        self.levels, self.unit = own_units(points)
        self.n_evaluations = 0
        self._at: bytes = b""
        self._last: tuple[FloatArray, FloatArray] = (np.empty(0), np.empty((0, 0)))
        self.chain = problem.chain

    def coordinates(self, theta: FloatArray) -> FloatArray:
        """From (tau, .., t0, tf, ..) to the refinement's coordinates."""
        p = np.array(theta, dtype=float)
        y0, beta = self.layout.local[:, 0], self.layout.local[:, 1]
        p[self.edges] -= self.begin
        p[y0] = (p[y0] - self.levels) / self.unit
        p[beta] /= self.unit
        if self.straight:
            p[self.edges] += p[self.tau]
            p[self.tau] = p[self.tau] ** 2
        return p

    def _own(self, p: FloatArray) -> FloatArray:
        """(tau, .., t0, tf, ..) with time and signal as the coordinates count them."""
        theta = np.array(p, dtype=float)
        if self.straight:
            theta[self.tau] = sqrt(max(theta[self.tau], 0.0))
            theta[self.edges] -= theta[self.tau]
        return theta

    def theta(self, p: FloatArray) -> FloatArray:
        """Back to (tau, .., t0, tf, ..)."""
        theta = self._own(p)
        y0, beta = self.layout.local[:, 0], self.layout.local[:, 1]
        theta[self.edges] += self.begin
        theta[y0] = self.levels + theta[y0] * self.unit
        theta[beta] *= self.unit
        return theta

    def _block(self, p: FloatArray, k: int) -> tuple[FloatArray, FloatArray, list[int]]:
        # residual, its derivatives by the columns it depends on, and which those are
        e = self.problem.campaign.experiments[k]
        part = slice(self.points.first[k], self.points.first[k + 1])
        i_y0, i_beta = (int(i) for i in self.layout.local[k, :2])
        if self.chain is None:
            return self._block_general(self.theta(p), k, part)
        theta, t = self._own(p), self.points.t[part] - self.starts[k]
        y = (self.points.y[part] - self.levels[k]) / self.unit
        y0, beta = theta[i_y0], theta[i_beta]
        if self.chain == "exact":
            t, theta = self._on_clock(t, theta, k)
            x, index, slopes = response_slopes(t, theta, self.layout, k, e.total_flow)
        else:
            x, index, slopes = euler_slopes(t, theta, self.layout, k, e)
        n = len(self.layout.shared[k])
        columns = [*index[:n].tolist(), i_y0, i_beta, *index[n:].tolist()]
        J = np.empty((len(t), len(columns)))
        J[:, :n] = beta * slopes[:, :n]
        J[:, n] = 1.0
        J[:, n + 1] = x
        J[:, n + 2 :] = beta * slopes[:, n:]
        if self.straight:
            J[:, 0] = (J[:, 0] - J[:, n + 2 :].sum(axis=1)) / (2.0 * theta[self.tau])
        return y0 + beta * x - y, J, columns

    def _on_clock(self, t: FloatArray, theta: FloatArray, k: int) -> tuple[FloatArray, FloatArray]:
        """Times and theta on the clock of the commands, where switches are moved by delays."""
        switching = self.layout.switching[k]
        if any(switching.offsets) or not switching.moves:
            return t + self.starts[k], theta
        return t, theta

    def _block_general(
        self, theta: FloatArray, k: int, part: slice
    ) -> tuple[FloatArray, FloatArray, list[int]]:
        layout = self.layout
        full = with_noise(layout, theta)
        mean, _, index, slopes, _ = mean_derivatives(self.problem, full, k, self.points.t[part])
        # the levels count in the same unit as the residual
        slopes[~np.isin(index, layout.local[k, :2])] /= self.unit
        n_noise = len(layout.noise_names)
        columns = [int(i) if i < layout.n_mean else int(i) - n_noise for i in index]
        if self.straight:
            switches = [row for row, i in enumerate(columns) if i in self.edges]
            slopes[0] = (slopes[0] - slopes[switches].sum(axis=0)) / (2.0 * theta[self.tau])
        return (mean - self.points.y[part]) / self.unit, slopes.T, columns

    def evaluate(self, p: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Reduced residuals (n_rows,) and Jacobian (n_rows, n) at coordinates ``p`` (n,), in units
        of the signal."""
        key = p.tobytes()
        if key == self._at:
            return self._last
        self.n_evaluations += 1
        rows, values = [], []
        for k in range(len(self.points.first) - 1):
            part = slice(self.points.first[k], self.points.first[k + 1])
            residual, J, columns = self._block(p, k)
            weight = np.sqrt(self.points.weight[part])
            block = np.empty((len(residual), J.shape[1] + 1))
            block[:, :-1] = J * weight[:, None]
            block[:, -1] = residual * weight
            R: Any = np.linalg.qr(block, mode="r")
            wide = np.zeros((len(R), len(p)))
            wide[:, columns] = R[:, :-1]
            rows.append(wide)
            values.append(R[:, -1])
        self._last = np.concatenate(values), np.concatenate(rows)
        self._at = key
        return self._last

    def cost(self, theta: FloatArray) -> float:
        """Sum of squares on the points (without the scatter inside them), V^2."""
        return float(np.sum(self.evaluate(self.coordinates(theta))[0] ** 2)) * self.unit**2


def own_units(points: Points) -> tuple[FloatArray, float]:
    """A level of every experiment (n_exp,) V and the signal's unit V, a power of two.

    Division by the unit, and subtraction of a level far from zero, cause no rounding. Results are
    then the same in any other unit.
    """
    parts = [points.y[a:b] for a, b in pairwise(points.first)]
    widest = max(float(np.ptp(y)) for y in parts)
    largest = float(np.abs(points.y).max())
    unit = 2.0 ** np.floor(np.log2(widest or largest or 1.0))
    return np.array([float(y[0]) for y in parts]), float(unit)


def with_noise(layout: Layout, theta: FloatArray) -> FloatArray:
    """The flat vector with placeholder noise parameters, from mean and extra parameters."""
    noise = np.tile([0.0, 1.0, 0.0], len(layout.noise_names) // 3)
    return np.concatenate([theta[: layout.n_mean], noise, theta[layout.n_mean :]])


class Refined(NamedTuple):
    theta: FloatArray
    cost: float
    success: bool
    n_evaluations: int


def refine(
    problem: Problem,
    points: Points,
    theta: FloatArray,
    low: FloatArray,
    high: FloatArray,
    free: NDArray[np.bool_] | None = None,
    max_evaluations: int = 60,
    tolerance: float = 1e-10,
) -> Refined:
    """Trust-region refinement (scipy's ``trf``) inside the box; ``free`` False: held fixed."""
    free = np.ones(len(theta), dtype=bool) if free is None else free.copy()
    held = [problem.layout.index(name) for name in problem.held]
    free[held] = False
    # where a switch time is held, that is one without tau added
    straight = bool(free[0]) and all(i < problem.layout.n_shared for i in held)
    squares = Squares(problem, points, straight)
    straight = squares.straight
    box_low, box_high = squares.coordinates(low), squares.coordinates(high)
    result = _trust_region(
        squares, np.clip(theta, low, high), box_low, box_high, free, max_evaluations, tolerance
    )
    edges = squares.edges
    if straight and (
        (result.theta[edges] < low[edges]).any() or (result.theta[edges] > high[edges]).any()
    ):
        # a switch time left its own bounds: those are a box only in theta itself
        squares = Squares(problem, points, straight=False)
        box_low, box_high = squares.coordinates(low), squares.coordinates(high)
        again = _trust_region(
            squares, np.clip(result.theta, low, high), box_low, box_high, free, max_evaluations,
            tolerance,
        )  # fmt: skip
        return again._replace(n_evaluations=again.n_evaluations + result.n_evaluations)
    return result


def _trust_region(
    squares: Squares,
    theta: FloatArray,
    low: FloatArray,
    high: FloatArray,
    free: NDArray[np.bool_],
    max_evaluations: int,
    tolerance: float,
) -> Refined:
    start = squares.coordinates(theta)
    # trf wants an interior start
    inner = 1e-9 * np.where(np.isfinite(high - low), high - low, 1.0)
    start = np.clip(start, low + inner, high - inner)
    p = start.copy()

    def residuals(values: FloatArray) -> FloatArray:
        p[free] = values
        return squares.evaluate(p)[0]

    def jacobian(values: FloatArray) -> FloatArray:
        p[free] = values
        return squares.evaluate(p)[1][:, free]

    result = optimize.least_squares(
        residuals, start[free], jacobian, (low[free], high[free]), method="trf", x_scale="jac",
        ftol=tolerance, xtol=tolerance, gtol=1e-14, max_nfev=max_evaluations,
    )  # fmt: skip
    p[free] = result.x
    return Refined(
        squares.theta(p), float(2.0 * result.cost) * squares.unit**2, result.status > 0,
        squares.n_evaluations,
    )  # fmt: skip


def mesh_points(problem: Problem, theta: FloatArray, low: FloatArray, high: FloatArray) -> Points:
    """The compressed mesh around ``theta`` (mean and extra parameters) as points.

    ``low`` and ``high`` (n_mean,): limits of the mean's parameters; extra parameters have none.
    """
    if problem.chain is not None:
        problem = Problem(problem.campaign, noise=problem.noise)
    layout = problem.layout
    vector = with_noise(layout, theta)  # sums of squares do not depend on the noise
    box_low, box_high = vector - 1.0, vector + 1.0
    box_low[: layout.n_mean], box_high[: layout.n_mean] = low, high
    for i, name in enumerate(layout.extra, len(layout) - len(layout.extra)):
        prior = problem.priors.get(name)
        if prior is not None and prior.law is not None:
            box_low[i], box_high[i] = prior.law.ppf([1e-4, 1.0 - 1e-4])
    compressed = compress(problem, vector, Region(box_low, box_high))
    nodes = [compressed.nodes(k) for k in range(len(problem.campaign))]
    return joined([(n.t, n.count, n.y) for n in nodes])


def around(layout: Layout, theta: FloatArray, rise: float) -> tuple[FloatArray, FloatArray]:
    """A box (n_mean,) about an estimate that its refinement should not leave."""
    n, shared, edges = layout.n_mean, layout.n_shared, layout.all_switches
    low, high = theta[:n] - 1.0, theta[:n] + 1.0
    low[:shared], high[:shared] = 0.5 * theta[:shared], 2.0 * theta[:shared]
    room = 0.05 * rise
    if layout.one_sensor:
        tau = float(theta[layout.tau])
        low[layout.tau], high[layout.tau] = 0.0, max(2.0 * tau, room)
        room = max(tau, room)
    low[edges], high[edges] = theta[edges] - room, theta[edges] + room
    return low, high
