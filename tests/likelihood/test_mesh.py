"""The mesh against the full pass: values, gradients, marginals, information, fall-back."""

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import pytest

import bayes_sensor.likelihood.mesh.compressed as compressed
from bayes_sensor.campaign import CampaignError
from bayes_sensor.likelihood.coordinates import Coordinates
from bayes_sensor.likelihood.density import experiment_log_likelihood, mean_and_variance, simulate
from bayes_sensor.likelihood.density import log_likelihood as full_pass
from bayes_sensor.likelihood.mesh import Region, compress, default_region, log_likelihood
from bayes_sensor.likelihood.mesh.blocks import blocks_of_run
from bayes_sensor.likelihood.noise import Noise
from bayes_sensor.likelihood.problem import Problem
from bayes_sensor.rig.cascade import Cascade
from tests.support.campaigns import (
    dense_covariance,
    paper_design,
    paper_theta,
    small_design,
    small_problem,
    small_theta,
)

GAPS = [(1.95, 1.96), (2.3, 2.31), (3.0, 3.4), (7.2, 7.27), (9.0, 9.001)]

DESIGNS = {
    "coarse": {"n": 2, "interval": 1e-2, "masked": GAPS},
    "1 kHz": {"n": 2, "interval": 1e-3},
    "10 kHz": {"n": 1, "interval": 1e-4, "duration": 9.0},
    "no step down": {"n": 2, "interval": 1e-3, "fall": False},
    "one step down": {"n": 2, "interval": 1e-3, "fall": [False, True]},
    "masks": {"n": 2, "interval": 1e-3, "masked": GAPS},
    "intervals": {"n": 3, "interval": [1e-3, 1e-3, 4e-3]},
    "odd intervals": {"n": 3, "interval": [1e-3, 1e-3, 2.5e-3], "masked": GAPS},
}


def principal_points(problem, mesh, theta, spread: float = 5.0) -> np.ndarray:
    """Points at +- spread standard deviations along every principal axis, in theta and in psi."""
    coordinates = Coordinates(problem)
    free = coordinates.free
    information = mesh.information(theta)[np.ix_(free, free)]
    slopes = coordinates.slopes(theta)
    found = []
    for in_psi in (False, True):
        info = slopes.T @ information @ slopes if in_psi else information
        scale = 1 / np.sqrt(np.diag(info))
        values, vectors = np.linalg.eigh(info * np.outer(scale, scale))
        axes = scale[:, None] * vectors / np.sqrt(values)
        for axis in axes.T:
            for fraction in (-1.0, -0.6, 0.6, 1.0):
                if in_psi:
                    psi = coordinates.psi(theta) + fraction * spread * axis
                    psi[coordinates.squared] = np.maximum(psi[coordinates.squared], 1e-8)
                    point = coordinates.theta(psi)
                else:
                    point = theta.copy()
                    point[free] += fraction * spread * axis
                    point[0] = max(point[0], 1e-4)
                found.append(point)
    return np.array(found)


@pytest.mark.parametrize("phi", [0.0, 0.5, 0.95])
@pytest.mark.parametrize("name", DESIGNS)
def test_the_mesh_agrees_with_the_full_pass_over_the_posterior(name: str, phi: float) -> None:
    problem, theta = small_problem(phi, **DESIGNS[name])
    mesh = compress(problem, theta)
    points = principal_points(problem, mesh, theta)
    covered = np.array([mesh.covers(point) for point in points])
    full = np.array([full_pass(problem, point) for point in points])
    fast = mesh.log_likelihoods(points).sum(axis=1)
    # a far corner of a long axis may lie outside: there the full pass has answered
    assert (~covered).sum() <= 2 and mesh.n_full_passes == (~covered).sum()
    np.testing.assert_array_equal(fast[~covered], full[~covered])
    # a negative phi has no law at 2.5 times the interval: both say so
    exists = np.isfinite(full)
    np.testing.assert_array_equal(exists, np.isfinite(fast))
    assert exists.mean() >= 0.5
    # five standard deviations cost 12.5 in log L, times the curvature's change: a real excursion
    assert full_pass(problem, theta) - full[exists].min() > 8.0
    error = np.abs(np.where(exists, fast, 0.0) - np.where(exists, full, 0.0))
    # promised is 1e-3, and that is needed only where the sensor is so fast that the response all
    # but starts with a kink inside a block
    kinked = exists & (points[:, 0] < 1e-3)
    assert error[exists & ~kinked].max() < 2e-5
    assert error[kinked].max(initial=0.0) < 5e-4
    one = mesh.log_likelihood(points[0])
    assert one == pytest.approx(fast[0], rel=1e-14)
    assert mesh.value_and_gradient(points[0])[0] == pytest.approx(one, rel=1e-12)


@pytest.mark.parametrize("variance", ["signal", "constant"])
def test_the_other_variances(variance: str) -> None:
    problem, theta = small_problem(0.6, noise=Noise(variance), n=2, interval=1e-3)
    mesh = compress(problem, theta)
    points = principal_points(problem, mesh, theta)
    assert mesh.error(points) < 2e-4


class AnyModel(Cascade):
    """The cascade, not known to be one."""

    def mean(self, t, theta, layout, experiment):
        return super().mean(t, theta, layout, experiment)


@pytest.mark.slow
@pytest.mark.parametrize("sigma1", [0.002, 0.06])
@pytest.mark.parametrize("per_experiment", [False, True])
def test_levels_of_noise_rise_and_fall(sigma1: float, per_experiment: bool) -> None:
    noise = Noise("levels")
    problem, theta = small_problem(0.6, noise=noise, sigma1=sigma1, **DESIGNS["masks"])
    if per_experiment:
        problem = replace(problem, noise=replace(noise, per_experiment=True))
        theta = np.concatenate([theta[:-3], np.tile(theta[-3:], 2)])
    mesh = compress(problem, theta)
    assert mesh.error(principal_points(problem, mesh, theta)) < 2e-4
    points = scattered(problem, mesh, theta, 2, seed=5)
    assert_gradients_agree(problem, mesh, points)
    assert mesh.n_full_passes == 0
    # the other route, which serves models that are not the cascade
    general = compress(replace(problem, model=AnyModel()), theta)
    one, other = mesh.gradient(points[0]), general.gradient(points[0])
    sd = 1 / np.sqrt(np.maximum(np.diag(mesh.information(theta)), 1e-12))
    np.testing.assert_allclose(one * sd, other * sd, atol=2e-3, rtol=1e-4)
    assert mesh.marginal(theta)[0] == pytest.approx(general.marginal(theta)[0], abs=1e-5)
    # without noise at the highest concentration there is no density
    theta[problem.layout.noise[:, 2]] = 0.0
    assert mesh.log_likelihood(theta) == full_pass(problem, theta) == -np.inf


def test_the_information_under_levels_is_slepian_bangs() -> None:
    problem, theta = small_problem(
        0.6, noise=Noise("levels"), sigma1=0.008, n=2, interval=0.02, duration=9.0
    )
    expected = dense_information(problem, theta)
    found = compress(problem, theta).information(theta)
    scale = np.sqrt(np.diag(expected))
    np.testing.assert_allclose(
        found / np.outer(scale, scale), expected / np.outer(scale, scale), atol=1e-4
    )


def test_noise_per_experiment() -> None:
    problem, theta = small_problem(0.6, noise=Noise(per_experiment=True), n=2, interval=1e-3)
    mesh = compress(problem, theta)
    assert mesh.error(principal_points(problem, mesh, theta)) < 2e-4


def test_negative_phi() -> None:
    problem, theta = small_problem(-0.5, n=2, interval=1e-3, masked=GAPS)
    mesh = compress(problem, theta)
    assert mesh.error(principal_points(problem, mesh, theta)) < 2e-4
    # and where a shorter interval has no such law, both ways say so
    mixed, at = small_problem(0.5, n=3, interval=[2e-3, 2e-3, 1e-3])
    mesh = compress(mixed, at)
    at[mixed.layout.index("phi")] = -0.5
    assert mesh.covers(at)
    assert mesh.log_likelihood(at) == mesh.log_likelihoods(at[None]).sum() == -np.inf
    assert full_pass(mixed, at) == -np.inf and mesh.marginal(at)[0] == -np.inf


def test_a_mesh_is_small_and_does_not_grow_with_the_sampling_rate() -> None:
    sizes = []
    for interval in (1e-3, 1e-4):
        campaign = small_design(n=1, interval=interval)
        theta = small_theta(campaign)
        sizes.append(compress(campaign, theta).n_nodes)
    assert sizes[0] < 12000 / 8 and sizes[1] < 1.3 * sizes[0]


def test_a_wrong_mesh_would_be_noticed() -> None:
    # negative control: blocks sixteen times too wide break the agreement asserted above
    problem, theta = small_problem(0.5, n=1, interval=1e-3)
    region = replace(default_region(problem, theta), fineness=1 / 16)
    mesh = compress(problem, theta, region)
    points = principal_points(problem, mesh, theta)
    assert mesh.error(points) > 2e-4
    # and mended: narrower blocks until the error is small
    mended = mesh.accurate(points[:4], 1e-5)
    assert mended.region.fineness > 1 / 16 and mended.error(points[:4]) <= 1e-5
    assert mended.accurate(points[:4], 1e-5) is mended


def test_a_variance_that_all_but_vanishes_before_the_step() -> None:
    # sigma0 a hundredth of sigma1: 1/s^2 changes ten-thousandfold while x3 rises and decays
    plan = small_design(n=2, interval=1e-3)
    problem = Problem(plan)
    nested = small_theta(plan, 0.5, 2e-4, 0.02)
    problem = replace(problem, campaign=simulate(problem, nested, seed=3))
    theta = problem.layout.flat(nested)
    mesh = compress(problem, theta)
    points = principal_points(problem, mesh, theta)
    assert mesh.accurate(points, 1e-3).error(points) < 1e-3


# --- outside the region


@pytest.mark.parametrize("name", ["tau_s", "tau_v_s", "V_mL", "t0_s[a]", "tf_s[b]"])
def test_outside_the_region_the_full_pass_answers(name: str) -> None:
    problem, theta = small_problem(0.5, n=2, interval=1e-3)
    mesh = compress(problem, theta)
    i = problem.layout.index(name)
    theta[i] = mesh.region.high[i] + 1e-3
    assert not mesh.covers(theta)
    assert mesh.log_likelihood(theta) == full_pass(problem, theta)
    assert mesh.n_full_passes == 1
    each = mesh.log_likelihoods(theta[None])[0]
    assert mesh.n_full_passes == 2
    assert each.tolist() == [experiment_log_likelihood(problem, theta, k) for k in range(2)]
    value, gradient = mesh.value_and_gradient(theta)
    assert value == full_pass(problem, theta)
    np.testing.assert_allclose(gradient, differences(problem, theta), rtol=1e-4, atol=1e-2)
    wide = Region(
        mesh.region.low, np.where(np.arange(len(theta)) == i, theta + 0.1, mesh.region.high)
    )
    inside = compress(problem, theta, wide)
    assert inside.covers(theta)
    for outer, inner in zip(mesh.marginal(theta), inside.marginal(theta)):
        # the quadratic through six full passes against the sums on a mesh
        np.testing.assert_allclose(outer, inner, rtol=1e-5)


def test_a_mesh_built_on_request_answers_once() -> None:
    problem, theta = small_problem(0.5, n=1, interval=1e-3)
    assert log_likelihood(problem, theta, compressed=True) == pytest.approx(
        log_likelihood(problem, theta), abs=2e-4
    )


def test_the_default_region_is_wide_enough_at_the_papers_design() -> None:
    problem = Problem(paper_design(interval=5e-3))
    theta = problem.layout.flat(paper_theta(0.8, 0.045, 0.05))
    region = default_region(problem, theta)
    width = (region.high - region.low)[problem.layout.local[:, 2:]]
    assert region.low[0] == 0.0 and region.high[0] > 0.15
    assert (width > 0.3).all() and (width < 3.0).all()


# --- gradients


def differences(problem: Problem, theta: np.ndarray, value=None) -> np.ndarray:
    """Central differences of the full pass (or of ``value``) with one extrapolation."""
    value = value or (lambda p: full_pass(problem, p))
    gradient = np.zeros(len(theta))
    for i in range(len(theta)):
        step = np.zeros(len(theta))
        step[i] = 2e-5 * max(abs(theta[i]), 1e-2)
        one = value(theta + step) - value(theta - step)
        two = value(theta + 2 * step) - value(theta - 2 * step)
        gradient[i] = (8 * one - two) / (12 * step[i])
    return gradient


def scattered(problem, mesh, theta, n: int, seed: int) -> np.ndarray:
    """(n, n_theta) points of about three posterior standard deviations, tau well above zero."""
    rng = np.random.default_rng(seed)
    info = mesh.information(theta) + np.diag(1e-6 / np.maximum(theta, 1e-3) ** 2)
    points = rng.multivariate_normal(theta, 3 * np.linalg.inv(info), size=n)
    points[:, 0] = np.maximum(points[:, 0], 0.3 * theta[0])
    return points


def assert_gradients_agree(problem, mesh, points) -> None:
    for point in points:
        found = mesh.gradient(point)
        expected = differences(problem, point)
        # in units of what one posterior standard deviation does to log L
        sd = 1 / np.sqrt(np.maximum(np.diag(mesh.information(point)), 1e-12))
        np.testing.assert_allclose(found * sd, expected * sd, atol=2e-3, rtol=1e-4)


@pytest.mark.parametrize(
    "name", ["1 kHz", "no step down", "one step down", "masks", "odd intervals"]
)
def test_the_gradient_is_that_of_the_full_pass(name: str) -> None:
    problem, theta = small_problem(0.6, **DESIGNS[name])
    mesh = compress(problem, theta)
    assert_gradients_agree(problem, mesh, scattered(problem, mesh, theta, 4, seed=5))
    assert mesh.n_full_passes == 0


@pytest.mark.parametrize("gap", [0.0, 1e-12, 1e-5, 9e-4, 1.1e-3, 1e-2])
def test_the_gradient_where_time_constants_coincide(gap: float) -> None:
    problem, theta = small_problem(0.6, n=2, interval=1e-3, masked=GAPS)
    theta[2] = theta[1] * (1 + gap) * problem.campaign["a"].total_flow  # V/Q of one experiment
    mesh = compress(problem, theta)
    assert_gradients_agree(problem, mesh, [theta])


def test_coincidence_in_one_experiment_slows_that_one_alone(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    problem, theta = small_problem(0.6, n=3, interval=1e-2)
    theta[2] = theta[1] * problem.campaign["a"].total_flow
    taken: list[int] = []
    slow = compressed.mean_derivatives

    def noted(problem: Problem, vector: np.ndarray, k: int, times: np.ndarray) -> Any:
        taken.append(k)
        return slow(problem, vector, k, times)

    mesh = compress(problem, theta)
    monkeypatch.setattr(compressed, "mean_derivatives", noted)
    mesh.value_and_gradient(theta)
    assert taken == [0]


def test_all_three_time_constants_coincide() -> None:
    problem, theta = small_problem(0.6, n=1, interval=1e-3)
    theta[0] = theta[1]
    theta[2] = theta[1] * problem.campaign["a"].total_flow
    mesh = compress(problem, theta)
    assert mesh.error(theta) < 2e-4
    assert_gradients_agree(problem, mesh, [theta])


@pytest.mark.parametrize("fraction", [0.05, 0.5, 0.99, 1.01])
def test_a_sensor_faster_than_a_block(fraction: float) -> None:
    problem, theta = small_problem(0.6, n=2, interval=1e-3, masked=GAPS)
    mesh = compress(problem, theta)
    least = mesh.arrays.setting[0, 4]
    theta[0] = fraction * least  # below it, a delay stands for the lag
    assert mesh.error(theta) < 3e-4  # promised: 1e-3
    points = theta[None] * np.where(np.arange(len(theta)) == 0, 1.0, 1.0 + 1e-3)
    i_tau = 0
    sd = 1 / np.sqrt(np.maximum(np.diag(mesh.information(points[0])), 1e-12))
    found, expected = mesh.gradient(points[0]), differences(problem, points[0])
    # by tau the full pass goes smoothly on to tau^2 terms that the delay leaves out; they are
    # below the block's resolution
    np.testing.assert_allclose((found * sd)[1:], (expected * sd)[1:], atol=2e-3, rtol=1e-3)
    assert found[i_tau] * theta[0] == pytest.approx(expected[i_tau] * theta[0], abs=2e-3)


# --- marginals


@pytest.mark.parametrize("name", ["coarse", "1 kHz", "one step down", "odd intervals"])
def test_the_marginal_is_the_integral_over_y0_and_beta(name: str) -> None:
    problem, theta = small_problem(0.7, **DESIGNS[name])
    mesh = compress(problem, theta)
    theta[1] *= 1.01  # not at the reference
    value, best, factor = mesh.marginal(theta)
    n = 33
    u = np.linspace(-7.0, 7.0, n)  # trapezia converge geometrically for a Gaussian
    grid = np.stack(np.meshgrid(u, u, indexing="ij"), axis=-1).reshape(-1, 2)
    total = 0.0
    for k, e in enumerate(problem.campaign):
        lower = np.array([[factor[k, 0], 0.0], [factor[k, 1], factor[k, 2]]])
        offsets = np.linalg.solve(lower.T, grid.T).T
        points = np.tile(theta, (len(grid), 1))
        points[:, problem.layout.local[k, :2]] = best[k] + offsets
        logs = mesh.log_likelihoods(points)[:, k]
        area = (u[1] - u[0]) ** 2 / (factor[k, 0] * factor[k, 2])
        total += logs.max() + np.log(np.exp(logs - logs.max()).sum() * area)
        # and the conditional law itself, by generalised least squares on the full series
        if e.n_samples < 4000:
            basis = np.stack(
                [np.ones(len(e.t)), problem.model.response(e.t, theta, problem.layout, e)]
            )
            inverse = np.linalg.inv(dense_covariance(problem, theta, k))
            gram = basis[:, e.used] @ inverse @ basis[:, e.used].T
            np.testing.assert_allclose(lower @ lower.T, gram, rtol=1e-6)
            centre = np.linalg.solve(gram, basis[:, e.used] @ inverse @ e.values[e.used])
            np.testing.assert_allclose(best[k], centre, rtol=1e-7)
    assert value == pytest.approx(total, abs=1e-6)
    values, bests, factors = mesh.marginals(np.array([theta, theta]))
    np.testing.assert_allclose(values, value, rtol=1e-14)
    np.testing.assert_allclose(bests[1], best)
    np.testing.assert_allclose(factors[0], factor)


# --- information


@pytest.mark.parametrize("phi", [0.0, 0.6, -0.4])
@pytest.mark.parametrize("fall", [True, False])
def test_the_information_is_slepian_bangs(phi: float, fall: bool) -> None:
    problem, theta = small_problem(phi, n=2, interval=0.02, duration=9.0, fall=fall)
    theta[problem.layout.index("t0_s[a]")] += 0.003  # between samples
    expected = dense_information(problem, theta)
    found = compress(problem, theta).information(theta)
    scale = np.sqrt(np.diag(expected))
    scale[scale == 0] = 1.0
    # the sums over nodes stand for the sums over samples
    np.testing.assert_allclose(
        found / np.outer(scale, scale), expected / np.outer(scale, scale), atol=1e-4
    )


def dense_information(problem: Problem, theta: np.ndarray) -> np.ndarray:
    """m_a' C^-1 m_b + tr(C^-1 C_a C^-1 C_b)/2 with C_a by differences (Kay, eq. 3.31)."""
    n = len(theta)
    total = np.zeros((n, n))
    for k, e in enumerate(problem.campaign):
        inverse = np.linalg.inv(dense_covariance(problem, theta, k))
        slopes, products = [], []
        for i in range(n):
            step = np.zeros(n)
            step[i] = 1e-6 * max(abs(theta[i]), 1e-2)
            up, down = theta + step, theta - step
            means = [problem.model.mean(e.t[e.used], p, problem.layout, e) for p in (up, down)]
            slopes.append((means[0] - means[1]) / (2 * step[i]))
            change = dense_covariance(problem, up, k) - dense_covariance(problem, down, k)
            products.append(inverse @ change / (2 * step[i]))
        slopes = np.array(slopes)
        total += slopes @ inverse @ slopes.T
        total += 0.5 * np.array([[(a * b.T).sum() for b in products] for a in products])
    return total


def test_the_information_with_gaps_and_intervals() -> None:
    problem, theta = small_problem(
        0.6, n=3, interval=[0.02, 0.02, 0.04], duration=9.0, masked=[(3.0, 3.4), (8.0, 8.1)]
    )
    expected = dense_information(problem, theta)
    found = compress(problem, theta).information(theta)
    scale = np.sqrt(np.diag(expected))
    np.testing.assert_allclose(
        found / np.outer(scale, scale), expected / np.outer(scale, scale), atol=1e-4
    )


def test_the_gradient_off_the_mesh_is_finite_without_concentration_noise() -> None:
    problem, theta = small_problem(0.6, n=2, interval=0.02, duration=9.0)
    mesh = compress(problem, theta)
    away = theta.copy()
    away[problem.layout.index("t0_s[a]")] -= 1.5
    away[problem.layout.index("sigma1_V")] = 0.0
    assert not mesh.covers(away)
    value, gradient = mesh.value_and_gradient(away)
    assert np.isfinite(value) and np.isfinite(gradient).all()


@pytest.mark.parametrize("kept", [1, 2, 3, 7])
def test_a_record_full_of_gaps_and_strong_correlation_tells_no_more_than_there_is(
    kept: int,
) -> None:
    # every pair across a gap, and both ends of every run, are most of what there is
    problem, theta = small_problem(0.97, n=2, interval=0.02, duration=9.0)
    masked = []
    for e in problem.campaign:
        mask = np.arange(len(e.t)) % (kept + 1) != kept
        masked.append(replace(e, mask=mask))
    problem = replace(problem, campaign=replace(problem.campaign, experiments=tuple(masked)))
    expected = dense_information(problem, theta)
    found = compress(problem, theta).information(theta)
    sd = [np.sqrt(np.diag(np.linalg.pinv(info))) for info in (found, expected)]
    np.testing.assert_allclose(sd[0], sd[1], rtol=2e-3)


def test_the_score_has_the_information_as_its_covariance() -> None:
    problem, theta = small_problem(0.6, n=2)
    scores = []
    for seed in range(150):
        drawn = replace(problem, campaign=simulate(problem, theta, seed=seed))
        scores.append(compress(drawn, theta, default_region(problem, theta)).gradient(theta))
    scores = np.array(scores)
    info = compress(problem, theta).information(theta)
    scale = np.sqrt(np.diag(info))
    z = scores / scale
    # means of 150 unit-variance scores, and their products: standard errors .08 and about .12
    assert np.abs(z.mean(axis=0)).max() < 4 * 0.082
    np.testing.assert_allclose(np.cov(z.T), info / np.outer(scale, scale), atol=4.5 * 0.115)


# --- nodes and designs


def test_nodes_stand_for_the_samples() -> None:
    problem, theta = small_problem(0.5, n=1, interval=1e-3, masked=GAPS)
    e = problem.campaign["a"]
    nodes = compress(problem, theta).nodes(0)
    assert nodes.count.sum() == pytest.approx(e.n_samples)
    mean, _ = mean_and_variance(problem, theta, 0)
    moved = theta.copy()
    moved[problem.layout.index("V_mL")] *= 1.02
    other, _ = mean_and_variance(problem, moved, 0)
    at = [problem.model.mean(nodes.t, p, problem.layout, e) for p in (theta, moved)]
    change = ((e.values - other)[e.used] ** 2).sum() - ((e.values - mean)[e.used] ** 2).sum()
    by_nodes = (nodes.count * ((nodes.y - at[1]) ** 2 - (nodes.y - at[0]) ** 2)).sum()
    assert by_nodes == pytest.approx(change, rel=1e-5)


def test_a_design_has_information_but_no_likelihood() -> None:
    design = small_design(n=2)
    theta = small_theta(design)
    mesh = compress(design, theta)
    problem, at = small_problem(0.5, n=2)
    np.testing.assert_allclose(mesh.information(theta), compress(problem, at).information(at))
    with pytest.raises(CampaignError, match="is a design: theta needs phi"):
        compress(design, {k: v for k, v in theta.items() if k[:5] not in ("sigma", "phi")})


def test_without_noise_parameters_the_residuals_stand_in() -> None:
    problem, theta = small_problem(0.7, noise=Noise("constant"), n=2)
    mesh = compress(problem, theta[: problem.layout.n_mean])
    reference = mesh.reference[problem.layout.n_mean :]
    assert reference[0] == pytest.approx(0.7, abs=0.05)
    assert reference[1] == pytest.approx(0.02, rel=0.1)


# --- general means


@dataclass(frozen=True)
class Drifting(Cascade):
    """The cascade on a baseline that drifts, as an effect would bring it."""

    extra: tuple[str, ...] = ("drift_V_per_s",)

    def mean(self, t, theta, layout, experiment):
        drift = theta[layout.index("drift_V_per_s")]
        return super().mean(t, theta, layout, experiment) + drift * (t - 6.0)


@pytest.mark.parametrize("design", ["1 kHz", "odd intervals"])
def test_a_general_mean_uses_the_same_moments(design: str) -> None:
    plain, theta = small_problem(0.6, **DESIGNS[design])
    problem = Problem(plain.campaign, model=Drifting())
    theta = np.append(theta, 1e-3)
    problem = replace(problem, campaign=simulate(problem, theta, seed=8))
    mesh = compress(problem, theta)
    for point in scattered(problem, mesh, theta, 3, seed=2):
        assert mesh.covers(point)
        full = full_pass(problem, point)
        assert mesh.log_likelihood(point) == pytest.approx(full, abs=2e-4)
        assert mesh.log_likelihoods(point[None]).sum() == pytest.approx(full, abs=2e-4)
    assert mesh.n_full_passes == 0
    gradient = mesh.gradient(point)
    sd = 1 / np.sqrt(np.diag(mesh.information(point)))
    expected = differences(problem, point)
    np.testing.assert_allclose(gradient * sd, expected * sd, atol=5e-3, rtol=1e-3)
    assert expected[-1] != 0.0
    # with no drift it is the cascade
    theta[-1] = 0.0
    assert mesh.log_likelihood(theta) == pytest.approx(
        full_pass(problem.campaign, theta[:-1]), abs=2e-4
    )


def test_the_marginal_of_a_general_mean() -> None:
    plain, theta = small_problem(0.6, n=2)
    problem = Problem(plain.campaign, model=Drifting())
    mesh, cascade = compress(problem, np.append(theta, 0.0)), compress(plain, theta)
    for general, special in zip(mesh.marginal(np.append(theta, 0.0)), cascade.marginal(theta)):
        np.testing.assert_allclose(general, special, rtol=1e-6)
    assert mesh.n_full_passes == 0


@pytest.mark.parametrize(
    "changes",
    [
        {"tau_s": 0.0}, {"tau_s": -0.1}, {"tau_v_s": 0.0}, {"V_mL": -1.0}, {"phi": 1.0},
        {"phi": -1.5}, {"sigma0_V": 0.0}, {"sigma1_V": -0.1},
    ],
)  # fmt: skip
def test_both_forms_are_minus_infinity_outside_the_range(changes) -> None:
    problem, theta = small_problem(n=2, interval=0.02)
    at = {**problem.layout.nested(theta), **changes}
    assert log_likelihood(problem, at) == log_likelihood(problem, at, compressed=True) == -np.inf
    assert compress(problem, theta).log_likelihood(at) == -np.inf


def test_what_a_mesh_cannot_be_made_about_is_said() -> None:
    problem, theta = small_problem(n=2, interval=0.02)
    nested = problem.layout.nested(theta)
    with pytest.raises(CampaignError, match="time constants must be positive"):
        compress(problem, {**nested, "V_mL": -1.0})
    with pytest.raises(CampaignError, match="phi is 1; expected a value above -1 and below 1"):
        compress(problem, {**nested, "phi": 1.0})
    with pytest.raises(CampaignError, match="this is a design without data"):
        log_likelihood(small_design(), nested, compressed=True)


def test_a_mesh_about_no_tau_at_all_is_one_about_a_tiny_tau() -> None:
    problem, theta = small_problem(n=2, interval=0.02, tau=0.01)
    mesh = compress(problem, {**problem.layout.nested(theta), "tau_s": 0.0})
    assert mesh.log_likelihood(theta) == pytest.approx(full_pass(problem, theta), abs=1e-3)
    assert mesh.n_full_passes == 0


def test_the_gradient_across_gaps_under_alternating_noise() -> None:
    problem, theta = small_problem(
        -0.4, n=2, interval=0.02, masked=[(3.0, 3.04), (4.0, 4.06), (5.5, 5.52)]
    )
    mesh = compress(problem, theta)
    i = problem.layout.index("phi")
    h = 1e-5
    up, down = theta.copy(), theta.copy()
    up[i] += h
    down[i] -= h
    expected = (mesh.log_likelihood(up) - mesh.log_likelihood(down)) / (2 * h)
    assert mesh.gradient(theta)[i] == pytest.approx(expected, rel=1e-6)


def test_blocks_reach_into_no_stretch_that_is_wanted_sample_by_sample() -> None:
    h, kinks = 0.01, np.array([[3.0, 3.2], [6.0, 6.005]])
    none = np.empty((0, 2))
    blocks = blocks_of_run(0, 1000, 0.0, h, none, 0.1, np.ones((3, 2)), 1.0, kinks, 1.0)
    starts, sizes, kinds = np.array(blocks).T
    assert starts[0] == 0 and (starts[1:] == (starts + sizes)[:-1]).all() and sizes.sum() == 1000
    within = np.zeros(len(starts), dtype=bool)
    for low, high in kinks:
        within |= (starts * h < high) & ((starts + sizes) * h > low)
    assert within.sum() > 3 and (kinds[within] == 0).all() and (sizes[within] <= 8).all()
    assert kinds[~within].max() > 2
