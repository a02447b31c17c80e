"""Coordinates in which the posterior is almost Gaussian, and the Gaussian that matches it there.

The data hold tau through tau^2 and trade it against the switch times, so in
psi = (tau^2, tau_v, V, y0, beta, t0 + tau, tf + tau, atanh phi, log sigma0, sigma1^2) the
log-likelihood is nearly quadratic.  The Gaussian is expanded at a positive tau, may have a negative
mean of tau^2, and is re-expanded once; tau (and sigma1 likewise) is drawn from the Gaussian in its
square cut at zero, the rest conditionally.  Where sigma1 is a level of its own (``levels``), which
cannot be zero, its coordinate is log sigma1.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property
from math import log, pi, sqrt

import numpy as np

from bayes_sensor.campaign import CampaignError, FloatArray
from bayes_sensor.likelihood.coordinates import Coordinates
from bayes_sensor.likelihood.mesh import Compressed, Region, compress
from bayes_sensor.likelihood.prior_density import log_prior_derivatives, log_priors
from bayes_sensor.likelihood.problem import Problem

NO_START = (
    "no starting point with a positive posterior density was found; "
    "the priors (side information, commanded times) contradict the data"
)
MESH_LIMIT = 5e-4
"""error in log L at a few draws above which blocks are made narrower; promised is 1e-3"""
WIDER_LAW = 3.0
"""times the standard deviation, of the law that keeps the tails of a refitted one heavy"""
DEFENSIVE = 0.1
"""height of that law beside the other"""
HALVINGS = 12
"""of the least tau to start from: below 1e-5 of the longest lag it is zero to the data"""


def draw_root(
    mean: FloatArray,
    sd: FloatArray,
    rng: np.random.Generator,
    n_grid: int = 512,
    wider: float = 0.0,
) -> tuple[FloatArray, FloatArray]:
    """Draw x > 0 (n,) with density proportional to exp(-(x^2 - mean)^2 / (2 sd^2)).

    ``wider``: height, beside that, of the same with three times the ``sd`` (a defensive mixture:
    Hesterberg, Technometrics 37, 1995).

    Returns the draws and the log of their normalised (piecewise-linear) density, which is exact for
    the draws made, so that an independence sampler may rely on it.

    >>> x, log_q = draw_root(np.zeros(2), np.ones(2), np.random.default_rng(1))
    >>> bool((x > 0).all())
    True
    """
    mean, sd = np.atleast_1d(mean).astype(float), np.atleast_1d(sd).astype(float)
    far = 8.5 * sd * (WIDER_LAW if wider else 1.0)
    top = np.sqrt(np.maximum(mean, 0.0) + far)
    # below the mode of a far-off positive mean nothing is drawn either
    bottom = np.sqrt(np.maximum(mean - far, 0.0))
    u = np.linspace(0.0, 1.0, n_grid)
    x = bottom[:, None] + (top - bottom)[:, None] * u
    exponent = -0.5 * ((x**2 - mean[:, None]) / sd[:, None]) ** 2
    exponent -= exponent.max(axis=1, keepdims=True)
    # a floor keeps the proposal's tails heavier than any target's, so that weights stay bounded
    density = np.exp(exponent) + wider * np.exp(exponent / WIDER_LAW**2) + 1e-6
    width = (top - bottom) / (n_grid - 1)
    mass = np.zeros_like(density)
    mass[:, 1:] = np.cumsum(0.5 * (density[:, 1:] + density[:, :-1]), axis=1) * width[:, None]
    target = rng.random(len(mean)) * mass[:, -1]
    cell = np.clip((mass <= target[:, None]).sum(axis=1) - 1, 0, n_grid - 2)
    rows = np.arange(len(mean))
    left, right = density[rows, cell], density[rows, cell + 1]
    slope = (right - left) / width
    rest = target - mass[rows, cell]
    # solve left d + slope d^2 / 2 = rest without cancellation
    d = 2.0 * rest / (left + np.sqrt(np.maximum(left**2 + 2.0 * slope * rest, 0.0)))
    drawn = x[rows, cell] + d
    log_q = np.log(left + slope * d) - np.log(mass[:, -1])
    return drawn, log_q


def draw_between(
    mean: FloatArray, sd: float, low: float, high: float, rng: np.random.Generator
) -> tuple[FloatArray, FloatArray]:
    """Draws (n,) of normal laws with ``mean`` (n,) and ``sd``, cut to [low, high].

    Also the log of their density (n,).
    """
    from scipy.special import ndtr, ndtri

    a, b = (low - mean) / sd, (high - mean) / sd
    # the left tail keeps its digits: mirror where the interval lies right of the mean
    mirrored = a + b > 0.0
    left, right = np.where(mirrored, -b, a), np.where(mirrored, -a, b)
    left = np.minimum(left, np.maximum(right, -36.0) - 1e-6)
    right = np.maximum(right, -36.0)
    below, above = ndtr(left), ndtr(right)
    z = ndtri(below + (above - below) * rng.random(len(mean)))
    z = np.clip(z, left, right)
    log_q = -0.5 * z**2 - 0.5 * log(2 * pi) - log(sd) - np.log(above - below)
    drawn = mean + sd * np.where(mirrored, -z, z)
    return np.clip(drawn, low, high), log_q


@dataclass(frozen=True)
class Laplace:
    """A Gaussian in psi: mean (n_psi,), covariance (n_psi, n_psi) in ``coordinates``."""

    coordinates: Coordinates
    mean: FloatArray
    cov: FloatArray
    theta: FloatArray
    """(n_theta,) where it was expanded: the maximum, or nearly so with tau held above zero"""
    log_posterior: float
    """log likelihood + log prior there"""
    converged: bool
    wider: float = 0.0
    """height of the wider law that the squares are drawn from, too; of :func:`draw_root`"""

    @cached_property
    def order(self) -> np.ndarray:
        """Positions of psi as drawn: the squares, what has limits, the rest."""
        first = np.concatenate([self.coordinates.squared, self.coordinates.limited])
        rest = [i for i in range(len(self.mean)) if i not in set(first)]
        return np.concatenate([first, np.array(rest, dtype=int)])

    @cached_property
    def _factor(self) -> FloatArray:
        return np.linalg.cholesky(self.cov[np.ix_(self.order, self.order)])

    def draw(
        self, n: int, rng: np.random.Generator, inflate: float = 1.0
    ) -> tuple[FloatArray, FloatArray]:
        """``n`` draws of theta (n, n_theta) and the log density (n,) they were drawn from.

        The density is that of (tau, sigma1, rest of psi): squares are replaced by their roots.
        """
        order, n_psi = self.order, len(self.mean)
        L = self._factor * sqrt(inflate)
        z = np.empty((n, n_psi))
        psi = np.empty((n, n_psi))
        log_q = np.zeros(n)
        n_squared, (low, high) = len(self.coordinates.squared), self.coordinates.limits
        n_limited = len(self.coordinates.limited)
        for j in range(n_psi):
            if n_squared <= j < n_squared + n_limited:
                centre, i = self.mean[order[j]] + z[:, :j] @ L[j, :j], order[j]
                value, log_cut = draw_between(centre, L[j, j], low[i], high[i], rng)
                log_q += log_cut
                z[:, j] = (value - centre) / L[j, j]
            elif j < n_squared:
                centre = self.mean[order[j]] + z[:, :j] @ L[j, :j]
                root, log_root = draw_root(centre, np.full(n, L[j, j]), rng, wider=self.wider)
                log_q += log_root
                z[:, j] = (root**2 - centre) / L[j, j]
            else:
                z[:, j:] = rng.standard_normal((n, n_psi - j))
                log_q += -0.5 * (z[:, j:] ** 2).sum(axis=1)
                log_q -= 0.5 * (n_psi - j) * log(2 * pi) + np.log(np.diag(L)[j:]).sum()
                break
        psi[:, order] = self.mean[order] + (z * self.coordinates.signs(self.theta)[order]) @ L.T
        return self.coordinates.theta(psi), log_q

    def refitted(self, thetas: FloatArray, log_weights: FloatArray) -> Laplace:
        """The Gaussian fitted to draws (n, n_theta) of this one by their log weights (n,).

        What is drawn from a cut law (squares, what has limits) keeps its law; mean and spread of
        the rest are regressed on it.  Weights are cut at sqrt(n) of their mean (Ionides, J.
        Comput. Graph. Stat. 17, 2008), and the old Gaussian counts as one draw a coordinate.
        """
        inside = np.isfinite(log_weights)
        weight = np.exp(log_weights[inside] - np.max(log_weights[inside]))
        weight = np.minimum(weight, weight.mean() * sqrt(len(weight)))
        weight /= weight.sum()
        psi = self.coordinates.psi(thetas[inside])
        n_cut = len(self.coordinates.squared) + len(self.coordinates.limited)
        cut, rest = self.order[:n_cut], self.order[n_cut:]
        away, kept = psi[:, cut] - self.mean[cut], self.cov[np.ix_(cut, cut)]
        known = np.column_stack([np.ones(len(psi)), away / np.sqrt(np.diag(kept))])
        root = np.sqrt(weight)[:, None]
        slopes = np.linalg.lstsq(known * root, psi[:, rest] * root, rcond=None)[0]
        left = psi[:, rest] - known @ slopes
        slopes[1:] /= np.sqrt(np.diag(kept))[:, None]
        mean, cov = self.mean.copy(), self.cov.copy()
        mean[rest] = slopes[0]
        cov[np.ix_(cut, rest)] = kept @ slopes[1:]
        cov[np.ix_(rest, cut)] = cov[np.ix_(cut, rest)].T
        cov[np.ix_(rest, rest)] = (left.T * weight) @ left + slopes[1:].T @ kept @ slopes[1:]
        n = 1.0 / float(np.sum(weight**2))
        share = n / (n + len(mean))
        return replace(
            self,
            mean=share * mean + (1.0 - share) * self.mean,
            cov=share * cov + (1.0 - share) * self.cov,
            wider=DEFENSIVE,
        )


def log_posteriors(
    compressed: Compressed, coordinates: Coordinates, thetas: FloatArray, roots: bool = False
) -> FloatArray:
    """(n,) log posterior density in psi (or in psi with roots) up to a constant."""
    return log_posteriors_and_likelihoods(compressed, coordinates, thetas, roots)[0]


def log_posteriors_and_likelihoods(
    compressed: Compressed, coordinates: Coordinates, thetas: FloatArray, roots: bool = False
) -> tuple[FloatArray, FloatArray]:
    """:func:`log_posteriors`, and the log-likelihood (n, n_experiments) of every experiment."""
    problem = coordinates.problem
    total = log_priors(problem, thetas) + coordinates.log_jacobian(thetas, roots)
    good = np.isfinite(total)
    each = np.full((len(thetas), len(problem.campaign)), -np.inf)
    if good.any():
        each[good] = compressed.log_likelihoods(thetas[good])
        total[good] += each[good].sum(axis=1)
    return np.where(np.isnan(total), -np.inf, total), each


def approximate(
    problem: Problem, start: FloatArray, compressed: Compressed | None = None
) -> tuple[Laplace, Compressed]:
    """Expand the log posterior in psi about its maximum; also the mesh that covers it.

    Newton steps with the expected information from ``start`` (n_theta,), then the Hessian from
    differences of the analytic gradient.  tau is kept above a fraction of the spread of tau^2, so
    that the expansion never divides by a vanishing derivative.
    """
    coordinates = Coordinates(problem)
    mesh = compressed or compress(problem, start)
    given = np.array(mesh.reference if np.isnan(start).any() else start, dtype=float)
    free = coordinates.free

    def objective(psi: FloatArray) -> float:
        candidate = coordinates.theta(psi)
        prior = log_priors(problem, candidate[None])[0]
        # flat measure in theta: maxima do not depend on the coordinates
        return prior + mesh.log_likelihood(candidate) if np.isfinite(prior) else -np.inf

    def gradient(psi: FloatArray) -> FloatArray:
        candidate = coordinates.theta(psi)
        _, g = mesh.value_and_gradient(candidate)
        g = g + prior_gradient(problem, candidate)
        if not np.isfinite(g).all():  # outside the support of a prior
            raise CampaignError(NO_START)
        slopes: FloatArray = coordinates.slopes(candidate).T @ g[free]
        return slopes

    theta = _with_tau_above_zero(coordinates, given, objective)
    psi = coordinates.psi(theta)
    value = objective(psi)
    converged = False
    floor = psi.copy()
    info = posterior_information(mesh, coordinates, psi)
    low, high = coordinates.limits
    for _ in range(30):
        g = gradient(psi)
        # what sits at its limit and wants beyond stays there
        near = 1e-5 / np.sqrt(np.diag(info))
        held = ((psi <= low + near) & (g < 0.0)) | ((psi >= high - near) & (g > 0.0))
        step = np.zeros(len(psi))
        move = np.flatnonzero(~held)
        spread = 1.0 / np.sqrt(np.diag(info)[move])  # parameters have units of their own
        scaled = info[np.ix_(move, move)] * np.outer(spread, spread)
        step[move] = spread * np.linalg.solve(scaled, spread * g[move])
        expected = float(g @ step)
        if expected < 1e-6:
            converged = True
            break
        scale = 1.0
        for _ in range(30):
            trial = psi + scale * step
            for i in coordinates.squared:
                floor[i] = 0.05 / sqrt(info[i, i])  # a twentieth of the conditional spread
                trial[i] = max(trial[i], min(psi[i], floor[i]))
            trial = coordinates.psi(_into_support(problem, coordinates.theta(trial)))
            trial_value = objective(trial)
            if trial_value > value - 1e-9:
                break
            scale *= 0.5
        else:
            break
        gained = trial_value - value
        psi, value = trial, trial_value
        if gained < 1e-7 * max(1.0, expected) or gained < 1e-6:
            converged = True
            break
        if not mesh.covers(coordinates.theta(psi)):
            mesh = compress(problem, coordinates.theta(psi))
        info = posterior_information(mesh, coordinates, psi)
    theta = coordinates.theta(psi)
    mean, cov = expand(mesh, coordinates, psi, gradient)
    if coordinates.shifts and mean[0] < 0.25 * sqrt(cov[0, 0]):
        # re-expand where the bulk of the truncated Gaussian lies, not at the edge
        middle = psi.copy()
        middle[0] = max(mean[0], 0.0) + 0.5 * sqrt(cov[0, 0])
        shift = cov[1:, 0] / cov[0, 0] * (middle[0] - mean[0])
        middle[1:] = mean[1:] + shift
        if np.isfinite(objective(middle)):
            mean, cov = expand(mesh, coordinates, middle, gradient)
    laplace = Laplace(coordinates, mean, cov, theta, float(value), converged)
    drawn, _ = laplace.draw(400, np.random.default_rng(0), inflate=1.5)
    needed = covering_region(mesh, laplace, drawn, 0.2)
    if (needed.low < mesh.region.low).any() or (needed.high > mesh.region.high).any():
        mesh = compress(problem, theta, covering_region(mesh, laplace, drawn, 0.4))
    return laplace, mesh.accurate(drawn[:3], MESH_LIMIT)


def _with_tau_above_zero(
    coordinates: Coordinates, given: FloatArray, objective: Callable[[FloatArray], float]
) -> FloatArray:
    """``given`` (n_theta,) inside its priors, with the shortest lag as far above zero as it may be.

    At most 2 % of the longest lag, and less where the data hold that lag more tightly: a start far
    below the fit would end in the mode in which all is noise.
    """

    tau = coordinates.problem.layout.tau

    def lifted(lowest: float) -> FloatArray:
        theta = given.copy()
        theta[tau] = max(theta[tau], lowest)
        return _ready(coordinates.problem, theta)

    theta = _ready(coordinates.problem, given)
    if not coordinates.shifts:
        return theta
    best = objective(coordinates.psi(theta))
    lowest = 0.02 * coordinates.problem.commuting.lags(given).max(initial=0.0)
    # draws of a posterior lie about n / 2 below its maximum
    allowed = 0.5 * len(coordinates.free)
    for _ in range(HALVINGS):
        theta = lifted(lowest)
        if objective(coordinates.psi(theta)) >= best - allowed or lowest <= given[tau]:
            break
        lowest *= 0.5
    return theta


def _ready(problem: Problem, theta: FloatArray) -> FloatArray:
    """``theta`` moved just inside its priors, with noise that can be differentiated."""
    theta = _into_support(problem, theta)
    for row in problem.layout.noise:
        theta[row[2]] = max(theta[row[2]], 0.05 * theta[row[1]])
        theta[row[0]] = np.clip(theta[row[0]], -0.99, 0.9999)
    return problem.flat(theta)


def _into_support(problem: Problem, theta: FloatArray) -> FloatArray:
    """``theta`` moved just inside its priors, with its lags by size where they are not."""
    theta = theta.copy()
    for i, name in enumerate(problem.layout.names):
        prior = problem.priors[name]
        if name in problem.fixed:
            continue
        if prior.kind in ("uniform", "log_uniform"):
            margin = 1e-6 * (prior.b - prior.a)
            theta[i] = np.clip(theta[i], prior.a + margin, prior.b - margin)
        elif name in problem.layout.extra and prior.kind in ("half_normal", "log_normal"):
            theta[i] = max(theta[i], 1e-6 * prior.a)
    commuting = problem.commuting
    lags = commuting.lags(theta)
    if len(lags) < 2:
        return theta
    # the ends first, then what lies between them
    shortest, longest = min(lags[0], 0.999 * lags[-1]), lags[-1]
    margin = 1e-3 * (longest - shortest)
    inner = np.sort(np.clip(lags[1:-1], shortest + margin, longest - margin))
    for j, lag in zip(range(len(lags) - 1), [shortest, *inner], strict=True):
        theta[commuting.places[j]] = lag / commuting.to_lag[j]
    return theta


def covering_region(
    compressed: Compressed, laplace: Laplace, thetas: FloatArray, spare: float
) -> Region:
    """A mesh region that holds draws ``thetas`` and ``spare`` of their range on either side.

    It also holds the point of expansion: where the data hardly hold a lag, all draws of the
    Gaussian may lie below zero, and a region without any lag would be none.
    """
    thetas = np.concatenate([thetas, laplace.theta[None]])
    low, high = compressed.region.low.copy(), compressed.region.high.copy()
    layout = laplace.coordinates.problem.layout
    extra = range(len(layout) - len(layout.extra), len(layout))
    held = {layout.index(name) for name in laplace.coordinates.problem.held}
    first = int(layout.one_sensor)
    rest = [i for i in range(first, layout.n_shared) if i not in held]
    for i in [*rest, *(i for i in layout.all_switches if i not in held), *extra]:
        a, b = thetas[:, i].min(), thetas[:, i].max()
        low[i], high[i] = a - spare * (b - a), b + spare * (b - a)
    if layout.one_sensor:
        tau = layout.tau
        low[tau], high[tau] = 0.0, (1.0 + spare) * thetas[:, tau].max()
    for i in rest:
        low[i] = max(low[i], 0.2 * laplace.theta[i])
    for i in extra:
        support = laplace.coordinates.problem.priors[layout.names[i]].support
        low[i], high[i] = max(low[i], support[0]), min(high[i], support[1])
    return Region(low, high, compressed.region.fineness)


def posterior_information(
    compressed: Compressed, coordinates: Coordinates, psi: FloatArray
) -> FloatArray:
    """(n, n) expected information of the data and curvature of the priors at psi (n,)."""
    theta = coordinates.theta(psi)
    free = coordinates.free
    info = compressed.information(theta)[np.ix_(free, free)]
    info = info + np.diag(_prior_curvature(coordinates.problem, theta)[free])
    slopes = coordinates.slopes(theta)
    return _positive(slopes.T @ info @ slopes)


def _positive(matrix: FloatArray) -> FloatArray:
    """The symmetric matrix with eigenvalues of its scaled form lifted to at least 1e-8."""
    matrix = 0.5 * (matrix + matrix.T)
    diagonal = np.diag(matrix).copy()
    diagonal = np.where(diagonal > 0, diagonal, max(diagonal.max(), 1.0) * 1e-12)
    scale = np.sqrt(diagonal)
    values, vectors = np.linalg.eigh(matrix / np.outer(scale, scale))
    values = np.maximum(values, 1e-8)
    mended: FloatArray = (vectors * values) @ vectors.T * np.outer(scale, scale)
    return mended


def expand(
    compressed: Compressed,
    coordinates: Coordinates,
    psi: FloatArray,
    gradient: Callable[[FloatArray], FloatArray],
) -> tuple[FloatArray, FloatArray]:
    """Mean and covariance of the Gaussian matched to gradient and Hessian at psi."""
    info = posterior_information(compressed, coordinates, psi)
    step = 0.3 / np.sqrt(np.diag(info))  # conditional spreads: wide enough to average rounding
    for i in coordinates.squared:
        step[i] = min(step[i], 0.5 * psi[i])
    region = compressed.region
    width = np.minimum(region.high - region.low, 1e300)[coordinates.free]
    for i in coordinates.switch_times:  # stay on the mesh where the data hardly hold a switch time
        step[i] = min(step[i], 0.2 * width[i])
    n = len(psi)
    hessian = np.empty((n, n))
    low, high = coordinates.limits
    for i in range(n):
        up, down = psi.copy(), psi.copy()
        up[i] = min(psi[i] + step[i], high[i])
        down[i] = max(psi[i] - step[i], low[i])
        hessian[i] = -(gradient(up) - gradient(down)) / (up[i] - down[i])
    hessian = 0.5 * (hessian + hessian.T)
    scale = np.sqrt(np.diag(info))
    scaled = hessian / np.outer(scale, scale)
    # the observed Hessian is the better Gaussian; far from the maximum it may not be positive, and
    # where a step leaves what can be evaluated it is none
    observed = np.isfinite(scaled).all() and np.linalg.eigvalsh(scaled).min() > 1e-4
    precision = scaled if observed else info / np.outer(scale, scale)
    cov = np.linalg.inv(precision) / np.outer(scale, scale)
    return psi + cov @ gradient(psi), 0.5 * (cov + cov.T)


def prior_gradient(problem: Problem, theta: FloatArray) -> FloatArray:
    """(n_theta,) derivatives of the log prior."""
    return log_prior_derivatives(problem, theta)[0]


def _prior_curvature(problem: Problem, theta: FloatArray) -> FloatArray:
    return log_prior_derivatives(problem, theta)[1]
