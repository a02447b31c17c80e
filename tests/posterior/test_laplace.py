"""The coordinates, the truncated draws and the Gaussian that proposes."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from scipy import integrate
from scipy.stats import kstest, multivariate_normal

import bayes_sensor as bs
from bayes_sensor.likelihood.coordinates import Coordinates, names_of_psi
from bayes_sensor.likelihood.density import log_likelihood
from bayes_sensor.likelihood.mesh import compress
from bayes_sensor.likelihood.noise import Noise
from bayes_sensor.likelihood.prior_density import log_prior
from bayes_sensor.likelihood.priors import Prior
from bayes_sensor.likelihood.problem import Problem
from bayes_sensor.posterior.laplace import (
    Laplace,
    approximate,
    covering_region,
    draw_root,
    expand,
    log_posteriors,
    posterior_information,
    prior_gradient,
)
from tests.support.campaigns import small_problem

NOISES = [
    Noise(), Noise("constant"), Noise("signal", "white"), Noise(per_experiment=True),
    Noise("levels"),
]  # fmt: skip


@pytest.mark.parametrize("noise", NOISES, ids=str)
def test_the_coordinates_round_trip(noise: Noise) -> None:
    problem, theta = small_problem(0.6, noise=noise, n=2, fall=[True, False])
    coordinates = Coordinates(problem)
    assert len(coordinates.free) == len(theta) - len(problem.fixed)
    psi = coordinates.psi(theta)
    np.testing.assert_allclose(coordinates.theta(psi), theta, rtol=1e-12, atol=1e-15)
    np.testing.assert_allclose(coordinates.theta(np.array([psi, psi])), [theta, theta], rtol=1e-12)
    labels = dict(zip(names_of_psi(coordinates.names, noise), psi))
    assert labels["tau_s^2"] == pytest.approx(0.01)
    assert labels["t0_s[a] + tau_s"] == pytest.approx(2.1037)
    assert ("phi" in problem.fixed) or any("atanh phi" in label for label in labels)
    if noise.fading:
        assert labels["log sigma1_V"] == pytest.approx(np.log(0.02))


@pytest.mark.parametrize("noise", NOISES, ids=str)
@pytest.mark.parametrize("roots", [False, True])
def test_slopes_and_jacobian_match_differences(noise: Noise, roots: bool) -> None:
    problem, theta = small_problem(0.6, noise=noise, n=2)
    coordinates = Coordinates(problem)
    psi = coordinates.psi(theta)
    n = len(psi)
    numerical = np.empty((n, n))
    for j in range(n):
        step = np.zeros(n)
        step[j] = 1e-5 * max(abs(psi[j]), 1e-4)
        difference = coordinates.theta(psi + step) - coordinates.theta(psi - step)
        numerical[:, j] = difference[coordinates.free] / (2 * step[j])
    np.testing.assert_allclose(coordinates.slopes(theta), numerical, rtol=1e-6, atol=1e-7)
    _, log_det = np.linalg.slogdet(numerical)
    if roots:  # d(psi)/d(root) = 2 root
        log_det += np.log(2 * theta[coordinates.free][coordinates.squared]).sum()
    assert coordinates.log_jacobian(theta, roots) == pytest.approx(log_det, abs=1e-6)


def test_far_points_stay_inside_the_range() -> None:
    problem, theta = small_problem()
    coordinates = Coordinates(problem)
    psi = coordinates.psi(theta)
    psi[coordinates.squared], psi[coordinates.phi] = -1.0, 60.0
    far = coordinates.theta(psi)
    assert far[0] == 0.0 and far[problem.layout.index("phi")] < 1.0


@pytest.mark.parametrize("mean", [-20.0, -1.0, 0.0, 0.7, 30.0, 1e4])
def test_a_drawn_root_has_the_density_it_reports(mean: float) -> None:
    n = 20000
    x, log_q = draw_root(np.full(n, mean), np.ones(n), np.random.default_rng(4))
    assert (x > 0).all() if mean <= 0 else (x >= np.sqrt(max(mean - 8.5, 0.0))).all()
    top, bottom = np.sqrt(max(mean, 0) + 8.5), np.sqrt(max(mean - 8.5, 0.0))
    # E[1/q] over the draws is the length of the support, if q is normalised
    inverse = np.exp(-log_q)
    assert np.isfinite(inverse).all()
    # the floor of 1e-6 bounds 1/q, but its tail is long: trim to where q carries its mass
    order = np.argsort(x)
    mass = np.trapezoid(np.exp(log_q[order]), x[order])
    assert mass == pytest.approx(1.0, abs=0.01)  # what lies beyond the extreme draws
    # and the draws follow exp(-(x^2 - mean)^2 / 2)
    grid = np.linspace(bottom, top, 20001)
    density = np.exp(-0.5 * (grid**2 - mean) ** 2 + 0.5 * min(mean, 0.0) ** 2)
    cdf = integrate.cumulative_trapezoid(density, grid, initial=0.0)
    result = kstest(x, lambda v: np.interp(v, grid, cdf / cdf[-1]))
    # the floor adds at most a few in a thousand where the law is a narrow edge
    assert result.statistic < 2.0 / np.sqrt(n)
    # negative control: another law is told apart
    assert kstest(x, lambda v: np.interp(v, grid, (cdf / cdf[-1]) ** 1.05)).pvalue < 1e-3


@pytest.mark.parametrize("inflate", [1.0, 1.3])
def test_the_proposals_density_estimates_a_known_constant(inflate: float) -> None:
    problem, theta = small_problem(0.5, n=1)
    coordinates = Coordinates(problem)
    n = len(coordinates.free)
    rng = np.random.default_rng(2)
    psi = coordinates.psi(theta)
    scale = np.where(np.isin(np.arange(n), coordinates.squared), np.abs(psi), 0.01)
    factor = np.tril(0.3 * rng.standard_normal((n, n))) + np.eye(n)
    cov = factor @ factor.T * np.outer(scale, scale)
    mean = psi.copy()
    mean[coordinates.squared] *= [-0.5, 1.5]
    laplace = Laplace(coordinates, mean, cov, theta, 0.0, True)
    thetas, log_q = laplace.draw(40000, rng, inflate)
    # the Gaussian in psi restricted to positive squares, written in their roots, has the mass of
    # that quadrant, which the bivariate normal distribution function gives
    found = coordinates.psi(thetas)
    log_f = multivariate_normal(mean, cov).logpdf(found)
    log_f += np.log(2 * thetas[:, coordinates.free[coordinates.squared]]).sum(axis=1)
    weights = np.exp(log_f - log_q)
    square = np.ix_(coordinates.squared, coordinates.squared)
    quadrant = multivariate_normal(-mean[coordinates.squared], cov[square]).cdf([0.0, 0.0])
    error = weights.std() / np.sqrt(len(weights))
    assert error < 0.02 * quadrant
    assert weights.mean() == pytest.approx(quadrant, abs=4 * error)


@pytest.mark.parametrize("phi", [0.0, 0.9])
def test_the_expansion_is_at_the_maximum(phi: float) -> None:
    problem, theta = small_problem(phi, n=2)
    laplace, mesh = approximate(problem, theta)
    assert laplace.converged
    at = laplace.theta
    assert laplace.log_posterior == pytest.approx(
        log_likelihood(problem, at) + log_prior(problem, at), abs=1e-3
    )
    assert laplace.log_posterior >= log_likelihood(problem, theta) + log_prior(problem, theta)
    sd = np.sqrt(np.diag(np.linalg.inv(mesh.information(at))))
    slope = (mesh.gradient(at) + prior_gradient(problem, at)) * sd
    interior = at[laplace.coordinates.free] > 0
    assert np.abs(slope[interior]).max() < 0.05  # within a twentieth of a standard deviation
    draws, _ = laplace.draw(500, np.random.default_rng(9))
    assert np.mean([mesh.covers(row) for row in draws]) > 0.99
    assert mesh.error(draws[::100]) < 1e-3


def test_the_expansion_does_not_depend_on_where_it_starts() -> None:
    problem, theta = small_problem(0.5, n=2)
    first, _ = approximate(problem, theta)
    away = theta.copy()
    away[1] *= 1.05
    away[2] *= 0.97
    away[0] = 0.02
    second, _ = approximate(problem, away)
    # Newton's steps end within a few thousandths of a standard deviation
    sd = np.sqrt(np.diag(first.cov))
    np.testing.assert_allclose(second.mean, first.mean, atol=0.05 * sd.max(), rtol=0)
    assert np.abs((second.mean - first.mean) / sd).max() < 0.1
    np.testing.assert_allclose(np.sqrt(np.diag(second.cov)), sd, rtol=0.05)


def test_a_sensor_too_fast_to_see_is_survived() -> None:
    problem, theta = small_problem(0.9, n=2, tau=0.002)
    laplace, mesh = approximate(problem, theta)
    draws, log_q = laplace.draw(2000, np.random.default_rng(1))
    assert (draws[:, 0] > 0).all() and np.isfinite(log_q).all()
    values = log_posteriors(mesh, laplace.coordinates, draws, roots=True)
    assert np.isfinite(values).mean() > 0.9


def test_weights_of_the_proposal_are_even() -> None:
    problem, theta = small_problem(0.5, n=2)
    laplace, mesh = approximate(problem, theta)
    draws, log_q = laplace.draw(3000, np.random.default_rng(1), inflate=1.08)
    log_w = log_posteriors(mesh, laplace.coordinates, draws, roots=True) - log_q
    weights = np.exp(log_w - log_w.max())
    assert weights.sum() ** 2 / (weights**2).sum() > 0.5 * 3000


def test_a_gaussian_in_the_wrong_place_is_refitted_to_its_draws() -> None:
    problem, theta = small_problem(0.5, n=2)
    right, mesh = approximate(problem, theta)
    rest = right.order[2:]
    assert len(right.coordinates.squared) == 2 and not len(right.coordinates.limited)
    mean = right.mean.copy()
    mean[rest] += 0.5 * np.linalg.cholesky(right.cov)[rest] @ np.ones(len(mean))
    moved = replace(right, mean=mean, cov=1.5 * right.cov)

    def effective(laplace: Laplace) -> tuple[float, np.ndarray, np.ndarray]:
        draws, log_q = laplace.draw(1600, np.random.default_rng(1), inflate=1.1)
        log_w = log_posteriors(mesh, laplace.coordinates, draws, roots=True) - log_q
        weights = np.exp(log_w - log_w.max())
        return weights.sum() ** 2 / (weights**2).sum(), draws, log_w

    before, draws, log_w = effective(moved)
    log_w[::100] = -np.inf  # outside the priors
    after = moved
    for _ in range(4):
        after = after.refitted(draws, log_w)
        share, draws, log_w = effective(after)
    assert before < 300.0 < 700.0 < share
    # what is drawn from a cut law keeps it and gets heavier tails; the matrix stays symmetric
    assert moved.wider == 0.0 < after.wider
    cut = right.coordinates.squared
    np.testing.assert_allclose(after.cov[np.ix_(cut, cut)], moved.cov[np.ix_(cut, cut)])
    np.testing.assert_allclose(after.cov, after.cov.T, rtol=1e-12, atol=0.0)


def test_the_prior_pulls_the_expansion() -> None:
    problem, theta = small_problem(0.5, n=2)
    plain, _ = approximate(problem, theta)
    narrow = replace(problem, given_priors={"V_mL": Prior("normal", 14.4, 0.02)})
    pulled, _ = approximate(narrow, theta)
    assert abs(pulled.theta[2] - 14.4) < 0.05 < abs(plain.theta[2] - 14.4)
    assert pulled.cov[2, 2] < plain.cov[2, 2]
    mesh = compress(narrow, theta)
    assert np.isfinite(log_posteriors(mesh, pulled.coordinates, theta[None]))[0]


@pytest.mark.parametrize("wider", [0.0, 0.1])
def test_the_density_of_drawn_roots_is_the_one_they_are_drawn_from(wider: float) -> None:
    mean, sd = np.full(20_000, 0.3), np.full(20_000, 0.5)
    x, log_q = draw_root(mean, sd, np.random.default_rng(4), n_grid=32, wider=wider)
    # what lies beyond four standard deviations of the square
    assert (np.mean(x**2 > 0.3 + 4 * 0.5) > 0.003) == bool(wider)
    order = np.argsort(x)
    q = np.exp(log_q[order])
    # the density of the draws made, summed over the stretch they cover
    assert np.trapezoid(q, x[order]) == pytest.approx(1.0, abs=2e-3)
    # piecewise linear: the distribution function at the draws is uniform, sd of its mean 0.002
    cdf = np.concatenate([[0.0], np.cumsum(0.5 * (q[1:] + q[:-1]) * np.diff(x[order]))])
    assert np.abs(cdf - np.arange(len(x)) / len(x)).max() < 0.014  # Kolmogorov: 1.95 / sqrt(n)


def test_every_parameter_with_limits_is_drawn_within_them() -> None:
    # two of them, correlated, each cut on one side at half a standard deviation
    cov = np.array([[1.0, 0.2, 0.1, 0.0], [0.2, 1.0, 0.6, 0.3], [0.1, 0.6, 1.0, 0.4],
                    [0.0, 0.3, 0.4, 1.0]])  # fmt: skip
    limits = (np.array([-9.0, -0.5, -9.0, -9.0]), np.array([9.0, 9.0, 0.5, 9.0]))
    coordinates = SimpleNamespace(
        squared=np.array([0]), limited=np.array([1, 2]), limits=limits, theta=lambda psi: psi,
        signs=lambda theta: np.ones(4),
    )  # fmt: skip
    laplace = Laplace(coordinates, np.zeros(4), cov, np.zeros(4), 0.0, True)
    drawn, log_q = laplace.draw(4000, np.random.default_rng(7))
    assert (drawn[:, 1] >= -0.5).all() and (drawn[:, 2] <= 0.5).all()
    assert drawn[:, 1].max() > 2.0 and drawn[:, 2].min() < -2.0 and np.isfinite(log_q).all()


def test_a_mesh_that_was_widened_once_is_wide_enough() -> None:
    problem, theta = small_problem(n=2, interval=0.05)
    first = compress(problem, theta)
    narrow = replace(
        first.region, low=theta - 0.5 * (theta - first.region.low),
        high=theta + 0.05 * (first.region.high - theta),
    )  # fmt: skip
    _, wide = approximate(problem, theta, compress(problem, theta, narrow))
    assert (wide.region.high > narrow.high).any()
    _, again = approximate(problem, theta, wide)
    assert again is wide


def test_a_region_holds_lags_above_zero_where_every_draw_lies_below() -> None:
    problem, theta = small_problem(n=2, interval=0.05)
    laplace, mesh = approximate(problem, theta)
    volume = problem.layout.index("V_mL")
    place = laplace.coordinates.names.index("V_mL")
    mean = laplace.mean.copy()
    mean[place] = -50.0 * laplace.theta[volume]
    astray = replace(laplace, mean=mean)
    draws, _ = astray.draw(50, np.random.default_rng(1))
    assert (draws[:, volume] < 0.0).all()
    region = covering_region(mesh, astray, draws, 0.4)
    assert 0.0 < region.low[volume] < laplace.theta[volume] < region.high[volume]
    assert np.isfinite(compress(problem, laplace.theta, region).log_likelihood(laplace.theta))


def test_curvatures_are_taken_where_tau_squared_is_positive() -> None:
    problem, theta = small_problem(n=2, interval=0.05, tau=0.01)
    mesh, coordinates = compress(problem, theta), Coordinates(problem)
    psi = coordinates.psi(theta)
    info = posterior_information(mesh, coordinates, psi)
    assert psi[0] < 0.3 / np.sqrt(info[0, 0])  # a usual step would reach below zero
    asked = []

    def gradient(at: np.ndarray) -> np.ndarray:
        asked.append(at.copy())
        return -info @ (at - psi)

    mean, cov = expand(mesh, coordinates, psi, gradient)
    assert (np.array(asked)[:, coordinates.squared] > 0.0).all()
    # a Gaussian is its own expansion
    np.testing.assert_allclose(mean, psi, rtol=1e-12)
    scale = np.sqrt(np.diag(info))
    np.testing.assert_allclose(
        cov * np.outer(scale, scale), np.linalg.inv(info / np.outer(scale, scale)), rtol=1e-5
    )


def test_roots_are_drawn_to_beyond_eight_standard_deviations() -> None:
    mean, sd = np.array([-1.0, 0.0, 3.0, 40.0]), np.array([1.0, 0.5, 2.0, 4.0])

    def drawn_at(u: float) -> np.ndarray:
        drawn, log_q = draw_root(mean, sd, SimpleNamespace(random=lambda n: np.full(n, u)))
        assert np.isfinite(log_q).all()
        return drawn**2

    # where the density has sunk to its floor, so that weights stay bounded there
    assert (drawn_at(1.0 - 1e-15) > np.maximum(mean, 0.0) + 8.0 * sd).all()
    assert (drawn_at(0.0) <= np.maximum(mean - 8.0 * sd, 0.0)).all()


def test_a_tight_fit_is_where_the_expansion_starts() -> None:
    # one slow lag at a step of 500 times the noise: lags of 2 % of it would be far off
    rng = np.random.default_rng(4)
    t = np.cumsum(1.07 + 0.03 * rng.random(300))
    y = 20.0 - 10.0 * np.expm1(-np.maximum(t - 59.7, 0.0) / 40.0)
    y += 0.02 * rng.standard_normal(len(t))
    campaign = bs.Campaign.from_frames(
        {"1": (t, y)}, carrier_flow="1 L/min", test_gas_flow="0.5 L/min", commanded_on="59 s",
        signal_unit="degC",
    )  # fmt: skip
    problem = Problem(campaign)
    fit = bs.fit_least_squares(campaign, seed=1, swarms=1, euler=False)
    theta = problem.by_size(problem.layout.flat(fit.theta_hat))
    laplace, _ = approximate(problem, theta)
    assert problem.commuting.lags(laplace.theta)[-1] == pytest.approx(40.0, abs=0.5)
    assert log_likelihood(problem, laplace.theta) > log_likelihood(problem, theta) - 5.0
