"""The compressed campaign as an object: likelihoods, gradients, marginals and information."""

# mypy: allow-untyped-calls
# Numba types the kernels when it compiles them.

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from math import log, pi

import numpy as np

from bayes_sensor.campaign import FloatArray
from bayes_sensor.likelihood.density import (
    experiment_log_likelihood,
    mean_and_response,
    noise_in_range,
    over_levels,
)
from bayes_sensor.likelihood.mesh import cascade_kernels, general_kernels
from bayes_sensor.likelihood.mesh.blocks import Region, at_times, build
from bayes_sensor.likelihood.mesh.mean_derivatives import height, mean_derivatives, sizes
from bayes_sensor.likelihood.mesh.mesh_arrays import K, make_room
from bayes_sensor.likelihood.noise import check_phi, lag_coefficient, scale_slopes, scale_squared
from bayes_sensor.likelihood.problem import Problem
from bayes_sensor.rig.layout import Theta


@dataclass(frozen=True)
class Nodes:
    """Weighted points that stand for the samples of one experiment.

    For a mean m that is smooth between switches, ``sum_i (y_i - m(t_i))^2`` is a constant plus
    ``sum count (y - m(t))^2``, and ``sum_i f(t_i)`` is ``sum count f(t)``.
    """

    t: FloatArray
    """(n,) s"""
    count: FloatArray
    """(n,) how many samples the point stands for"""
    y: FloatArray
    """(n,) V, their weighted mean; the reference mean for a design"""


def is_cascade(problem: Problem) -> bool:
    """Whether the compiled response may stand for the model: a chain of single lags and switches,
    not a recorded input."""
    layout = problem.layout
    switched = all(each.recorded is None for each in layout.switching)
    return problem.chain == "exact" and switched and set(layout.rig.kinds) <= {"lag", "volume"}


def _slope_of_lag(phi: float, steps: float) -> float:
    """Derivative of phi^steps with respect to phi; 0 at phi = 0 where it has no meaning there."""
    if steps == 1.0:
        return 1.0
    return steps * lag_coefficient(phi, steps) / phi if phi != 0.0 else 0.0


class Compressed:
    """A campaign's data reduced to a mesh; evaluates likelihoods in microseconds.

    Made by :func:`compress`.  ``region`` is the box of theta for which the mesh was built: outside
    it, :meth:`log_likelihood` and the others use the exact full pass (slow, never wrong);
    ``n_full_passes`` counts how often that happened.  What the problem's noise law pins has its
    pinned value in every theta.  Without ``data`` it is good for :meth:`information` alone.  One
    object is not to be shared by threads.
    """

    def __init__(
        self, problem: Problem, vector: FloatArray, region: Region, data: bool = True
    ) -> None:
        self.problem = problem
        self.reference = vector
        self.region = region
        self.arrays = build(problem, vector, region, data)
        self.n_full_passes = 0
        self._room = make_room(self.n_nodes)
        self._each, self._inside = np.zeros((1, len(problem.campaign))), np.zeros(1, dtype=bool)
        self._parts = self._each[0]
        self._cascade = is_cascade(problem)
        self._known_times: dict[int, FloatArray] = {}

    @property
    def n_nodes(self) -> int:
        """Nodes of all experiments together."""
        return len(self.arrays.base) * K

    @property
    def n_points(self) -> int:
        """What one likelihood visits: nodes, and the first and last samples of all even runs.

        These ends have exponentials of their own and count as four.
        """
        return self.n_nodes + 4 * self.arrays.edge_t.size

    @property
    def has_compiled_gradient(self) -> bool:
        """Whether a gradient costs little more than a value; else it costs tens of them."""
        return self._cascade and self.arrays.is_pulse

    def covers(self, theta: FloatArray) -> bool:
        """Whether the mesh was built for this flat vector (n_theta,)."""
        return bool(cascade_kernels.inside_box(theta, self.arrays.low, self.arrays.high))

    def _vector(self, theta: Theta) -> FloatArray:
        # a flat vector with nothing to pin is not copied: this runs once per evaluation
        vector = theta if isinstance(theta, np.ndarray) else self.problem.flat(theta)
        if self.problem.fixed or vector.shape != self.arrays.low.shape:
            vector = self.problem.flat(vector)
        return np.ascontiguousarray(vector, dtype=float)

    def _rows(self, thetas: FloatArray) -> FloatArray:
        """A copy of rows (n, n_theta), with what the noise law pins in place."""
        rows = np.array(thetas, dtype=float, order="C")
        for name, value in self.problem.fixed.items():
            rows[:, self.problem.layout.index(name)] = value
        return rows

    def _full(self, theta: FloatArray) -> float:
        self.n_full_passes += 1
        n_exp = len(self.problem.campaign)
        return sum(experiment_log_likelihood(self.problem, theta, k) for k in range(n_exp))

    def log_likelihood(self, theta: Theta) -> float:
        """The exact log-likelihood to within the mesh's error (see :meth:`error`)."""
        vector = self._vector(theta)
        if self._cascade:
            cascade_kernels.values(vector[None], self.arrays, self._room, self._each, self._inside)
            return sum(self._parts.tolist()) if self._inside[0] else self._full(vector)
        if not self.covers(vector):
            return self._full(vector)
        return float(sum(self._general(vector, k) for k in range(len(self.problem.campaign))))

    def _times(self, k: int) -> FloatArray:
        """(n_t,) s: nodes of experiment number ``k``, one sample before them, edge samples."""
        if k not in self._known_times:
            mesh, nodes = self.arrays, self.node_times(k).ravel()
            edges = mesh.edge_t[mesh.runs[k] : mesh.runs[k + 1]].ravel()
            self._known_times[k] = np.concatenate([nodes, nodes - mesh.setting[k, 0], edges])
        return self._known_times[k]

    def _split(self, values: FloatArray, k: int) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Values at :meth:`_times` as (n_blocks, K) at nodes and before them, (n_runs, 2)."""
        n = (self.arrays.blocks[k + 1] - self.arrays.blocks[k]) * K
        nodes, before, edges = values[:n], values[n : 2 * n], values[2 * n :]
        return nodes.reshape(-1, K), before.reshape(-1, K), edges.reshape(-1, 2)

    def _density(
        self, k: int, noise: tuple[float, float, float, float], mean: FloatArray, x: FloatArray
    ) -> float:
        """Log-likelihood of an experiment with ``mean`` and response ``x`` at :meth:`_times`."""
        phi, phi_reference, sigma0, sigma1 = noise
        s2 = scale_squared(x, sigma0, sigma1, *self._law(k))
        parts = [*self._split(mean - self.arrays.setting[k, 5], k), *self._split(s2, k)]
        return float(general_kernels.general(k, self.arrays, phi, phi_reference, *parts))

    def _law(self, k: int) -> tuple[float, float]:
        """Weight of the response in the variance of experiment ``k``, what fades of sigma0^2."""
        noise, campaign = self.problem.noise, self.problem.campaign
        return noise.weight(campaign, campaign.experiments[k]), noise.fading

    def _general(self, vector: FloatArray, k: int) -> float:
        # experiment number k under any model, inside the region
        noise = noise_in_range(self.problem, vector, k)
        if noise is None:
            return -np.inf
        e = self.problem.campaign.experiments[k]
        return self._density(k, noise, *mean_and_response(self.problem, vector, e, self._times(k)))

    def _general_gradient(self, vector: FloatArray, k: int, gradient: FloatArray) -> float:
        """Log-likelihood of experiment ``k`` under any model; its gradient is added."""
        noise = noise_in_range(self.problem, vector, k)
        if noise is None:
            return -np.inf
        phi, phi_reference, sigma0, sigma1 = noise
        mean, x, index, d_mean, d_x = mean_derivatives(self.problem, vector, k, self._times(k))
        s2 = scale_squared(x, sigma0, sigma1, *self._law(k))
        by_x, by_sigma0, by_sigma1 = scale_slopes(x, sigma0, sigma1, *self._law(k))
        g_mean, g_s2 = np.empty_like(mean), np.empty_like(mean)
        parts = [*self._split(mean - self.arrays.setting[k, 5], k), *self._split(s2, k)]
        slopes = [*self._split(g_mean, k), *self._split(g_s2, k)]
        value, g_phi = general_kernels.general_gradient(
            k, self.arrays, phi, phi_reference, *parts, *slopes
        )
        i_phi, i_sigma0, i_sigma1 = self.problem.layout.noise[k]
        gradient[index] += d_mean @ g_mean
        gradient[index] += d_x @ (by_x * g_s2)
        gradient[i_phi] += g_phi
        gradient[i_sigma0] += float(g_s2 @ by_sigma0)
        gradient[i_sigma1] += float(g_s2 @ by_sigma1)
        return float(value)

    def value_and_gradient(self, theta: Theta) -> tuple[float, FloatArray]:
        """Log-likelihood and its gradient (n_theta,) by the flat vector."""
        vector = self._vector(theta)
        if not self.covers(vector):
            return self._full(vector), self._full_gradient(vector)
        gradient, value = np.zeros(len(vector)), 0.0
        done = np.zeros(len(self.problem.campaign), dtype=bool)
        if self.has_compiled_gradient:
            value = cascade_kernels.value_and_gradient(
                vector, self.arrays, self._room, gradient, done
            )
        for k in np.flatnonzero(~done):
            value += self._general_gradient(vector, int(k), gradient)
        return value, gradient

    def gradient(self, theta: Theta) -> FloatArray:
        """Gradient (n_theta,) of the log-likelihood."""
        return self.value_and_gradient(theta)[1]

    def _full_gradient(self, vector: FloatArray) -> FloatArray:
        # central differences of the full pass, with the step that balances rounding against
        # curvature; a parameter of one experiment moves only its part
        layout, n_exp = self.problem.layout, len(self.problem.campaign)
        owner = {int(i): k for k in range(n_exp) for i in layout.local[k] if i >= 0}
        if layout.records != layout.experiments:  # several sensors share their record's switches
            owner = {i: k for i, k in owner.items() if i not in layout.all_switches}
        if layout.noise_per_experiment:
            owner |= {int(i): k for k in range(n_exp) for i in layout.noise[k]}
        gradient, steps = np.zeros(len(vector)), 1e-5 * sizes(self.problem, vector)
        for i in range(len(vector)):
            step = steps[i]
            up, down = vector.copy(), vector.copy()
            up[i] += step
            down[i] -= step
            if i in layout.noise[:, 2]:  # no likelihood is below sigma1 = 0
                down[i] = max(down[i], 0.0)
            for k in [owner[i]] if i in owner else range(n_exp):
                difference = experiment_log_likelihood(self.problem, up, k)
                difference -= experiment_log_likelihood(self.problem, down, k)
                gradient[i] += difference / (up[i] - down[i])
        return gradient

    def marginal(self, theta: Theta) -> tuple[float, FloatArray, FloatArray]:
        """Log-likelihood with every y0 and beta integrated out under flat priors.

        Returns (value, best, factor): ``best`` (n_experiments, 2) the conditional means of y0 and
        beta, ``factor`` (n_experiments, 3) the Cholesky factor (l11, l21, l22) of their
        conditional precision.  ``theta``'s own y0 and beta are not used.  Exact for models whose
        mean is ``y0 + beta x`` with ``x`` free of both.
        """
        vector = self._vector(theta)
        values, best, factor = self.marginals(vector[None])
        return float(values[0]), best[0], factor[0]

    def log_likelihoods(self, thetas: FloatArray) -> FloatArray:
        """(n, n_experiments) log-likelihood of every experiment at each row of ``thetas``."""
        thetas = self._rows(thetas)
        each = np.zeros((len(thetas), len(self.problem.campaign)))
        inside = np.zeros(len(thetas), dtype=bool)
        if self._cascade:
            cascade_kernels.values(thetas, self.arrays, self._room, each, inside)
        for i in np.flatnonzero(~inside):
            each[i] = self._one_by_one(thetas[i])
        return each

    def _one_by_one(self, vector: FloatArray) -> list[float]:
        # every experiment's part where the compiled cascade does not apply
        experiments = range(len(self.problem.campaign))
        if not self._cascade and self.covers(vector):
            return [self._general(vector, k) for k in experiments]
        self.n_full_passes += 1
        return [experiment_log_likelihood(self.problem, vector, k) for k in experiments]

    def marginals(self, thetas: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
        """:meth:`marginal` at every row of ``thetas`` (n, n_theta); a leading axis n is added."""
        local = self.problem.layout.local
        thetas = self._rows(thetas)
        thetas[:, local[:, :2]] = self.reference[local[:, :2]]
        n_exp = len(self.problem.campaign)
        values = np.zeros(len(thetas))
        best, factor = np.zeros((len(thetas), n_exp, 2)), np.ones((len(thetas), n_exp, 3))
        inside = np.zeros(len(thetas), dtype=bool)
        if self._cascade:
            cascade_kernels.marginals(
                thetas, self.arrays, self._room,
                values, best, factor, inside,
            )  # fmt: skip
        for i in np.flatnonzero(~inside):
            values[i], best[i], factor[i] = self._marginal_by_values(thetas[i])
        return values, best, factor

    def _marginal_by_values(self, vector: FloatArray) -> tuple[float, FloatArray, FloatArray]:
        # log L is quadratic in (y0, beta) of each experiment: six values fix it
        problem = self.problem
        local = problem.layout.local
        n_exp = len(problem.campaign)
        best, factor = np.zeros((n_exp, 2)), np.ones((n_exp, 3))
        total = 0.0
        inside = not self._cascade and self.covers(vector)
        self.n_full_passes += not inside
        for k in range(n_exp):
            origin = vector[local[k, :2]]
            unit = height(problem, vector, k)
            at = self._along(vector, k, unit, inside)
            f00 = at(0.0, 0.0)
            if not np.isfinite(f00):
                return -np.inf, best, factor
            fp0, fm0, f0p, f0m, fpp = at(1, 0), at(-1, 0), at(0, 1), at(0, -1), at(1, 1)
            g = np.array([fp0 - fm0, f0p - f0m]) / 2.0
            hxx, hyy = 2 * f00 - fp0 - fm0, 2 * f00 - f0p - f0m
            hxy = fp0 + f0p - fpp - f00
            precision = np.array([[hxx, hxy], [hxy, hyy]])
            if not (hxx > 0 and np.linalg.det(precision) > 0):
                return -np.inf, best, factor
            move = np.linalg.solve(precision, g)
            best[k] = origin + unit * move
            lower = np.linalg.cholesky(precision / unit**2)
            factor[k] = (lower[0, 0], lower[1, 0], lower[1, 1])
            total += f00 + 0.5 * float(g @ move) - log(lower[0, 0] * lower[1, 1]) + log(2.0 * pi)
        return total, best, factor

    def _along(
        self, vector: FloatArray, k: int, unit: float, inside: bool
    ) -> Callable[[float, float], float]:
        """Log-likelihood of experiment ``k`` as a function of moves of y0 and beta in ``unit``."""
        problem = self.problem
        i_y0, i_beta = problem.layout.local[k, :2]

        def moved(u: float, w: float) -> FloatArray:
            trial = vector.copy()
            trial[i_y0] += u * unit
            trial[i_beta] += w * unit
            return trial

        if not inside and problem.is_affine:
            return over_levels(problem, vector, k, unit)
        if not inside:
            return lambda u, w: experiment_log_likelihood(problem, moved(u, w), k)
        noise = noise_in_range(problem, vector, k)
        if noise is None:
            return lambda u, w: -np.inf
        if not problem.is_affine:
            return lambda u, w: self._general(moved(u, w), k)
        e, t, known = problem.campaign.experiments[k], self._times(k), noise
        mean, x = mean_and_response(problem, vector, e, t)
        slope = unit * x
        if not problem.has_plain_mean:
            slope = mean_and_response(problem, moved(0.0, 1.0), e, t)[0] - mean
        return lambda u, w: self._density(k, known, mean + (u * unit + w * slope), x)

    def _part(self, k: int) -> slice:
        """The nodes of experiment number ``k`` among all."""
        return slice(self.arrays.blocks[k] * K, self.arrays.blocks[k + 1] * K)

    def node_times(self, k: int) -> FloatArray:
        """(n_blocks, K) s, the nodes of experiment number ``k``."""
        return self.arrays.time[self._part(k)].reshape(-1, K)

    def nodes(self, k: int) -> Nodes:
        """The weighted points of experiment number ``k``; points of weight 0 are left out."""
        mesh, part = self.arrays, self._part(k)
        count = mesh.moments[0, part]
        keep = count > 1e-9
        level = mesh.setting[k, 5]
        mean = level + mesh.reference[0, part][keep] + mesh.moments[1, part][keep] / count[keep]
        runs = slice(mesh.runs[k], mesh.runs[k + 1])
        first = level + mesh.edge_y[runs, 0]
        if self.problem.campaign.experiments[k].y is None:
            e = self.problem.campaign.experiments[k]
            first, _ = at_times(self.problem, self.reference, e, k, mesh.edge_t[runs, 0])
        return Nodes(
            np.concatenate([mesh.edge_t[runs, 0], self.node_times(k).ravel()[keep]]),
            np.concatenate([np.ones(len(first)), count[keep]]),
            np.concatenate([first, mean]),
        )

    def error(self, thetas: FloatArray) -> float:
        """Largest |compressed - full pass| of log L over the rows of ``thetas`` (n, n_theta)."""
        worst = 0.0
        passes = self.n_full_passes
        for row in np.atleast_2d(thetas):
            row = self._vector(row)
            full, fast = self._full(row), self.log_likelihood(row)
            if np.isfinite(full) or np.isfinite(fast):
                worst = max(worst, abs(full - fast))
        self.n_full_passes = passes
        return worst

    def accurate(self, thetas: FloatArray, limit: float) -> Compressed:
        """This mesh, or one with narrower blocks, whose error at ``thetas`` is at most ``limit``.

        The error falls with the eighth power of the width, so a quarter narrower mostly does;
        sixteen times narrower is the end, and what error remains is for the caller to state.
        """
        mesh = self
        for factor in (1.25, 1.6, 2.0, 2.0, 2.0):
            if mesh.error(thetas) <= limit:
                break
            region = replace(mesh.region, fineness=factor * mesh.region.fineness)
            mesh = Compressed(mesh.problem, mesh.reference, region)
        return mesh

    def information(self, theta: Theta) -> FloatArray:
        """Expected Fisher information (n_theta, n_theta) of the flat vector.

        Slepian-Bangs formula for a Gaussian with mean and covariance both depending on theta
        (Kay, Fundamentals of Statistical Signal Processing I, 1993, eq. 3.31):
        I_ab = m_a' C^-1 m_b + 1/2 tr(C^-1 C_a C^-1 C_b), with C = S R S, R of an AR(1).  R^-1 is
        tridiagonal, across gaps as well, where neighbours have the correlation phi^distance: every
        pair of neighbours adds a term of its own.

        Raises CampaignError for a phi that is not between -1 and 1.
        """
        vector = self._vector(theta)
        problem, mesh = self.problem, self.arrays
        layout = problem.layout
        total = np.zeros((len(vector), len(vector)))
        for k, e in enumerate(problem.campaign):
            phi_reference = float(vector[layout.noise[k, 0]])
            steps = problem.steps(e)
            check_phi(phi_reference, steps, e.name)
            phi = lag_coefficient(phi_reference, steps)
            rest = 1.0 - phi**2
            index, J, u = self._standardised(vector, k)
            # nodes, one sample before them, first and last sample of each run; (m, n) each
            count = mesh.moments[0, self._part(k)]
            n = len(count)
            (J, Jl, f, last), (u, ul, uf, ulast) = (
                (each[:, :n], each[:, n : 2 * n], each[:, 2 * n :: 2], each[:, 2 * n + 1 :: 2])
                for each in (J, u)
            )
            weighted = J * count
            cross = weighted @ Jl.T
            info = ((1 + phi**2) * weighted @ J.T - phi * (cross + cross.T)) / rest
            info += phi**2 / rest * (f @ f.T - last @ last.T)
            info += np.outer(f[:, 0], f[:, 0])
            # covariance: u = d log s by the parameters
            weighted = u * count
            cross = weighted @ ul.T
            info += (1.0 + (1 + phi**2) / rest) * weighted @ u.T
            info -= phi**2 / rest * (cross + cross.T)
            info += (1.0 + 1.0 / rest) * uf @ uf.T - phi**2 / rest * ulast @ ulast.T
            slope = _slope_of_lag(phi_reference, steps)
            of_phi = mesh.totals[k, 1] * (1 + phi**2) / rest**2 * slope**2
            mixed = -2.0 * phi / rest * slope * (u @ count)
            mixed -= phi / rest * slope * (uf.sum(axis=1) - ulast.sum(axis=1))
            # over the gaps between runs
            distances = steps * mesh.distance[mesh.runs[k] + 1 : mesh.runs[k + 1]]
            across = np.array([lag_coefficient(phi_reference, each) for each in distances])
            slopes = np.array([_slope_of_lag(phi_reference, each) for each in distances])
            left = 1.0 - across**2
            gap, change = f[:, 1:] - across * last[:, :-1], uf[:, 1:] - ulast[:, :-1]
            info += gap / left @ gap.T + across**2 / left * change @ change.T
            of_phi += float(((1.0 + across**2) / left**2 * slopes**2).sum())
            mixed -= (uf[:, 1:] + ulast[:, :-1]) @ (across / left * slopes)
            i_phi = layout.noise[k, 0]
            total[np.ix_(index, index)] += info
            total[i_phi, index] += mixed
            total[index, i_phi] += mixed
            total[i_phi, i_phi] += of_phi
        return total

    def _standardised(
        self, vector: FloatArray, k: int
    ) -> tuple[np.ndarray, FloatArray, FloatArray]:
        """At :meth:`_times`: positions in theta (m,) of all but phi that moves experiment ``k``,
        derivatives of the mean over s and of log s (m, n_t)."""
        _, x, index, d_mean, d_x = mean_derivatives(self.problem, vector, k, self._times(k))
        _, i_sigma0, i_sigma1 = self.problem.layout.noise[k]
        sigma0, sigma1 = vector[i_sigma0], vector[i_sigma1]
        s2 = scale_squared(x, sigma0, sigma1, *self._law(k))
        by_x, by_sigma0, by_sigma1 = scale_slopes(x, sigma0, sigma1, *self._law(k))
        m = len(index)
        J, u = np.zeros((m + 2, len(x))), np.zeros((m + 2, len(x)))
        J[:m] = d_mean / np.sqrt(s2)
        u[:m] = 0.5 * by_x / s2 * d_x
        u[m], u[m + 1] = 0.5 * by_sigma0 / s2, 0.5 * by_sigma1 / s2
        return np.append(index, [i_sigma0, i_sigma1]), J, u
