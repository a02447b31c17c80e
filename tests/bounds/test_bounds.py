"""Bounds: the published table, closed forms, other implementations, and tau at its bound."""

import json
from dataclasses import replace
from functools import cache
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from scipy import stats
from scipy.integrate import quad
from scipy.optimize import least_squares
from scipy.signal import lfilter

from bayes_sensor.bounds import (
    LEVELS,
    METHODS,
    Bound,
    CramerRao,
    Profiler,
    compare_bounds,
    cramer_rao,
    explain_tau,
    profile_curve,
    step_study,
)
from bayes_sensor.bounds.context import Evidence
from bayes_sensor.bounds.gaussian_intervals import (
    gaussian_bound,
    invert,
    square_ends,
    switch_quantiles,
)
from bayes_sensor.bounds.hardness import multiple_correlation
from bayes_sensor.bounds.likelihood_surface import maximise, spread_along_tau, white_surface
from bayes_sensor.bounds.methods.block_bootstrap import (
    optimal_block_length,
    resample_and_refit,
    residual_series,
    stationary_indices,
)
from bayes_sensor.bounds.methods.jackknife_experiments import leave_one_out
from bayes_sensor.bounds.profile import Point, next_value
from bayes_sensor.bounds.sandwich_covariance import (
    andrews_bandwidth,
    ar1_middle,
    judged,
    newey_west,
    scores_of,
)
from bayes_sensor.campaign import Campaign, CampaignError, Experiment
from bayes_sensor.fit import fit_least_squares
from bayes_sensor.fit.identifiability import coloured_noise
from bayes_sensor.likelihood.density import log_likelihood, mean_and_variance, simulate
from bayes_sensor.likelihood.mesh import mean_derivatives
from bayes_sensor.likelihood.noise import Noise
from bayes_sensor.likelihood.problem import Problem
from bayes_sensor.posterior.draws import percentiles
from tests.support import campaigns
from tests.support.campaigns import small_design as long_design
from tests.support.campaigns import small_theta as its_theta

CONTRACT = (
    "crlb_iid",
    "crlb_iid_one_percent_step",
    "crlb_ar1",
    "sandwich",
    "block_bootstrap",
    "jackknife_experiments",
    "profile",
    "posterior",
)
PUBLISHED = {
    "total": (4.5, 3.5, 3.0, 9.0, 7.0, 6.0, 9.0),
    "carrier": (4.0, 3.0, 2.5, 8.0, 6.0, 5.0, 7.5),
    "y0": (0.296, 0.267, 0.263, 0.219, 0.194, 0.175, 0.121),
    "beta": (1.78, 1.92, 2.13, 1.41, 1.88, 2.11, 1.85),
    "t0": (24.6699, 20.3555, 25.3647, 31.0635, 29.3724, 30.1734, 24.5127),
    "tf": (83.8527, 79.3072, 84.7885, 89.5093, 88.9165, 89.9908, 84.1776),
}


@cache
def published_design(first: float = 0.0) -> Campaign:
    """The paper's seven experiments without data: 120 s at 1 ms."""
    t = first + 1e-3 * np.arange(120_000)
    experiments = [
        Experiment(
            str(i + 1),
            t,
            None,
            PUBLISHED["carrier"][i] / 0.06,
            (PUBLISHED["total"][i] - PUBLISHED["carrier"][i]) / 0.06,
            1e-3,
            PUBLISHED["t0"][i] - 0.6,
            PUBLISHED["tf"][i] - 0.6,
        )
        for i in range(7)
    ]
    return Campaign("published", tuple(experiments), sensor_is="faster")


def published_theta(*noise: float) -> np.ndarray:
    rows = zip(PUBLISHED["y0"], PUBLISHED["beta"], PUBLISHED["t0"], PUBLISHED["tf"])
    return np.array([0.0481, 0.8577, 58.23, *(v for row in rows for v in row), *noise])


@cache
def published_bound(**options: Any) -> CramerRao:
    return cramer_rao(published_design(), published_theta(), **options)


def small_design(
    n: int = 4, interval: float = 5e-3, fall: bool = True, masked: bool = False
) -> Campaign:
    """A few short experiments at different flows, with the step early in the record."""
    t = interval * np.arange(int(22.0 / interval))
    experiments = []
    for i in range(n):
        mask = np.ones(len(t), dtype=bool)
        if masked:
            mask[len(t) // 3 : len(t) // 3 + 40 + i] = False
        flow = (50.0, 90.0, 140.0, 70.0, 110.0)[i]
        experiments.append(
            Experiment(
                f"e{i}",
                t,
                None,
                0.85 * flow,
                0.15 * flow,
                interval,
                1.6,
                12.0 if fall else None,
                mask=mask,
            )
        )
    return Campaign("small", tuple(experiments), sensor_is="faster")


def small_theta(
    campaign: Campaign, tau: float = 0.3, phi: float = 0.6, sigma: float = 0.03
) -> np.ndarray:
    theta = [tau, 0.8, 40.0]
    for i, e in enumerate(campaign):
        theta += [0.1 + 0.02 * i, 1.5 + 0.1 * i, 2.0 + 0.03 * i]
        if e.has_fall:
            theta.append(12.4 + 0.02 * i)
    return np.array([*theta, phi, sigma, 0.8 * sigma])


@pytest.fixture(scope="module")
def small() -> SimpleNamespace:
    """A small campaign whose tau is well away from zero, with its fit and all bounds."""
    design = small_design()
    theta = small_theta(design)
    campaign = simulate(design, theta, seed=3)
    fit = fit_least_squares(campaign, seed=1, swarms=1, euler=False)
    rng = np.random.default_rng(5)
    posterior = SimpleNamespace(
        names=list(fit.names), draws=fit.theta_hat + 0.01 * rng.standard_normal((4000, len(theta)))
    )
    bounds = compare_bounds(campaign, fit, posterior, n_resamples=300)
    evidence = Evidence(Problem(campaign), fit)
    return SimpleNamespace(
        campaign=campaign, theta=theta, fit=fit, posterior=posterior, bounds=bounds,
        evidence=evidence,
    )  # fmt: skip


# --------------------------------------------------------------------------- the published table


@pytest.mark.parametrize(
    ("options", "expected", "digits"),
    [
        ({}, (32.74, 7.26, 0.576), (2, 2, 3)),
        ({"step": 0.01}, (5.6113, 8.6181, 0.6829), (4, 4, 4)),
        ({"step": -0.01}, (6.0807, 6.6409, 0.5224), (4, 4, 4)),
        ({"step": 0.01, "difference": "central"}, (8.4811, 7.2194, 0.6027), (4, 4, 4)),
        ({"fixed": ("t0_s", "tf_s")}, (3.16, 5.78, 0.415), (2, 2, 3)),
    ],
)
def test_published_table(options, expected, digits):
    bound = published_bound(**options)
    three_sigma = 3.0 * bound.sd[:3] * [1e3, 1e3, 1.0]
    for value, printed, places in zip(three_sigma, expected, digits):
        assert round(value, places) == printed


def test_table_three_of_the_paper_within_half_a_percent():
    bound = published_bound(step=0.01)
    three_sigma = 3.0 * bound.sd[:3] * [1e3, 1e3, 1.0]
    np.testing.assert_allclose(three_sigma, [5.6049, 8.6029, 0.6817], rtol=0.005)


def test_the_recipe_depends_on_where_time_starts_and_the_converged_bound_does_not():
    shift = 10.0
    moved = published_theta()
    moved[5::4] += shift
    moved[6::4] += shift
    design = published_design(first=shift)
    here = published_bound()
    there = cramer_rao(design, moved)
    # the mesh has other blocks when rounding shifts a sample: far below a printed digit
    np.testing.assert_allclose(there.sd, here.sd, rtol=1e-5)
    recipe = published_bound(step=0.01)
    assert abs(cramer_rao(design, moved, step=0.01)["tau_s"] / recipe["tau_s"] - 1.0) > 0.05


def test_small_steps_converge_for_the_closed_form_and_not_for_euler():
    table = step_study(published_design(), published_theta(), steps=[1e-6, 0.01])
    assert len(table) == 8
    at = table.set_index(["step", "method", "difference"])
    converged = published_bound()["tau_s"]
    assert at.loc[(1e-6, "exact", "central"), "tau_s"] == pytest.approx(converged, rel=1e-3)
    # Euler does not see t0 move by less than a sample: the bound of known switch times results
    known = published_bound(fixed=("t0_s", "tf_s"))["tau_s"]
    assert at.loc[(1e-6, "euler", "forward"), "tau_s"] == pytest.approx(known, rel=0.01)
    assert not at.loc[(1e-6, "euler", "forward"), "identified"]
    assert at.loc[(0.01, "euler", "forward"), "tau_s"] == pytest.approx(5.6113e-3 / 3, rel=1e-4)


# --------------------------------------------------------------------------- closed forms


def test_bound_of_a_mean_under_iid_and_ar1_noise():
    design = small_design(1)
    n = design.n_samples
    others = [name for name in ("tau_s", "tau_v_s", "V_mL", "beta_V", "t0_s", "tf_s")]
    phi, sigma = 0.7, 0.02
    theta = small_theta(design, phi=phi, sigma=sigma)
    theta[-1] = 0.0
    iid = cramer_rao(design, theta, sigma=sigma, fixed=others)
    assert iid["y0_V[e0]"] == pytest.approx(sigma / np.sqrt(n), rel=1e-9)
    assert iid["tau_s"] == 0.0
    ar1 = cramer_rao(design, theta, noise="ar1", fixed=others)
    # 1' R^-1 1 of a stationary AR(1)
    known = sigma / np.sqrt((n - (n - 2) * phi) / (1 + phi))
    assert ar1["y0_V[e0]"] == pytest.approx(known, rel=1e-9)


def test_linear_parameters_have_the_least_squares_covariance():
    design = small_design(2)
    theta = small_theta(design)
    bound = cramer_rao(design, theta, 0.05, fixed=("tau_s", "tau_v_s", "V_mL", "t0_s", "tf_s"))
    problem = Problem(design)
    _, _, index, slopes, _ = mean_derivatives(problem, theta, 1, design.experiments[1].t)
    X = slopes[-2:]  # by y0 and beta
    expected = 0.05**2 * np.linalg.inv(X @ X.T)
    part = bound.cov[np.ix_(index[-2:], index[-2:])]
    np.testing.assert_allclose(part, expected, rtol=1e-6)  # the mesh's own accuracy


@pytest.mark.parametrize("tau", [0.3, 0.799, 1e-3])
@pytest.mark.parametrize("fall", [True, False])
def test_fast_sensitivities_match_the_stable_ones(tau, fall):
    design = small_design(2, fall=fall)
    problem = Problem(design)
    theta = small_theta(design, tau=tau)
    e = design.experiments[1]
    _, _, index, slopes, _ = mean_derivatives(problem, theta, 1, e.t, e.interval)
    expected = problem.model.jacobian(e.t, theta, problem.layout, e)[:, index]
    # tau = 0.799 against 0.8: partial fractions lose six digits there
    np.testing.assert_allclose(slopes.T, expected, atol=1e-8 * np.abs(expected).max())
    assert len(slopes) == (7 if fall else 6)


def test_parameters_without_information_are_said_so():
    cov, identified = invert(np.diag([4.0, 0.0, 1.0]))
    assert identified.tolist() == [True, False, True]
    assert cov[0, 0] == 0.25 and np.isinf(cov[1, 1]) and cov[2, 2] == 1.0
    same = np.array([[1.0, 1.0, 0.0], [1.0, 1.0, 0.0], [0.0, 0.0, 1.0]])
    cov, identified = invert(same)
    assert identified.tolist() == [False, False, True]
    assert cov[2, 2] == pytest.approx(1.0)


def test_zero_values_and_missing_falls_get_an_absolute_step():
    design = small_design(2, fall=False)
    theta = small_theta(design)
    theta[3] = 0.0  # y0
    bound = cramer_rao(design, theta, step=0.01)
    assert np.isfinite(bound.sd).all()
    assert not any(name.startswith("tf_s") for name in bound.names)


@pytest.mark.parametrize(
    ("options", "match"),
    [
        ({"method": "euler"}, "piecewise constant"),
        ({"difference": "both"}, "difference must be one of"),
        ({"noise": "pink"}, "noise must be one of"),
        ({"fixed": ("V",)}, "nothing called V"),
        ({"noise": "ar1", "step": 0.01}, "needs noise='iid'"),
    ],
)
def test_cramer_rao_refuses(options, match):
    design = small_design(1)
    with pytest.raises(CampaignError, match=match):
        cramer_rao(design, small_theta(design), **options)


def test_unstable_euler_is_refused_with_the_way_out():
    design = small_design(1)
    with pytest.raises(CampaignError, match="use method='exact'"):
        cramer_rao(design, small_theta(design, tau=0.002), step=0.01)


# --------------------------------------------------------------------------- sandwich


def test_newey_west_equals_statsmodels_for_a_linear_regression():
    import statsmodels.api as sm

    rng = np.random.default_rng(2)
    X = np.column_stack([np.ones(400), np.linspace(0, 1, 400), rng.standard_normal(400)])
    noise = np.zeros(400)
    for i in range(1, 400):
        noise[i] = 0.7 * noise[i - 1] + rng.standard_normal()
    y = X @ [1.0, 2.0, 3.0] + noise
    fitted = sm.OLS(y, X).fit(cov_type="HAC", cov_kwds={"maxlags": 9, "use_correction": False})
    bread = np.linalg.inv(X.T @ X)
    ours = bread @ newey_west(X * (y - X @ fitted.params)[:, None], 9) @ bread
    np.testing.assert_allclose(ours, fitted.cov_params(), rtol=1e-9)


def test_parametric_middle_equals_the_dense_one():
    rng = np.random.default_rng(3)
    G = rng.standard_normal((60, 3))
    G[20:24] = 0.0  # a gap
    lag = np.abs(np.subtract.outer(np.arange(60), np.arange(60)))
    np.testing.assert_allclose(ar1_middle(G, 0.8), G.T @ 0.8**lag @ G, rtol=1e-10)


def bumps(n: int) -> np.ndarray:
    """(n, 3) a constant, and two short pulses as a switch makes them."""
    t = np.arange(n)
    first = np.where(t > n // 3, np.exp(-(t - n // 3) / 8.0), 0.0)
    second = np.where(t > n // 3, (t - n // 3) * np.exp(-(t - n // 3) / 6.0), 0.0)
    return np.column_stack([np.ones(n), first, second])


@pytest.mark.parametrize(("phi", "lags"), [(0.6, 12), (-0.7, 5), (0.0, 3), (0.5, 0)])
def test_what_the_sandwich_misses_equals_the_dense_average(phi, lags):
    n = 90
    J, scale = bumps(n), 1.0 + 0.5 * np.sin(np.arange(n) / 9.0)
    J[50:53] = 0.0  # a gap
    lag = np.abs(np.subtract.outer(np.arange(n), np.arange(n)))
    cov = np.outer(scale, scale) * np.where(lag == 0, 1.0, phi ** np.maximum(lag, 1))
    kernel = np.maximum(1.0 - lag / (lags + 1), 0.0)
    inverse = np.linalg.inv(J.T @ J)
    left = np.eye(n) - J @ inverse @ J.T
    modelled = inverse @ (J.T @ cov @ J) @ inverse
    found = scores_of(J, np.ones(n), scale, phi, lags, np.arange(3))
    np.testing.assert_allclose(found.unfitted, J.T @ (kernel * cov) @ J, rtol=1e-8)
    np.testing.assert_allclose(
        found.expected(inverse, modelled), J.T @ (kernel * (left @ cov @ left.T)) @ J, rtol=1e-7
    )
    mean, half = found.tally(inverse)
    for c in range(3):
        weighted = kernel * np.outer(J @ inverse[c], J @ inverse[c]) * scale**2
        assert mean[c] == pytest.approx(np.trace(weighted))
        assert half[c] == pytest.approx(np.trace(weighted @ weighted))


def test_sums_by_blocks_are_near_those_by_samples():
    n, phi, lags = 1200, 0.8, 160
    J, scale = bumps(60)[np.arange(n) // 20], np.ones(n)
    lag = np.abs(np.subtract.outer(np.arange(n), np.arange(n)))
    kernel, cov = np.maximum(1.0 - lag / (lags + 1), 0.0), phi**lag
    inverse = np.linalg.inv(J.T @ J)
    left = np.eye(n) - J @ inverse @ J.T
    modelled = inverse @ (J.T @ cov @ J) @ inverse
    found = scores_of(J, np.ones(n), scale, phi, lags, np.arange(3))
    assert len(found.squares) == n / 20
    expected = inverse @ found.expected(inverse, modelled) @ inverse
    dense = inverse @ (J.T @ (kernel * (left @ cov @ left.T)) @ J) @ inverse
    # a block is an eighth of the bandwidth, and half of the second pulse
    np.testing.assert_allclose(np.diag(expected), np.diag(dense), rtol=0.06)
    assert (np.diag(dense) < 0.9 * np.diag(modelled)).any()  # against what is made up for


def test_the_sandwich_covers_where_few_samples_decide():
    n, phi, n_draws = 150, 0.5, 600
    J = bumps(n)
    inverse = np.linalg.inv(J.T @ J)
    rng = np.random.default_rng(5)
    steps = rng.standard_normal((n_draws, n + 100)) * np.sqrt(1 - phi**2)
    noise = lfilter([1.0], [1.0, -phi], steps, axis=1)[:, 100:]
    covered, naive = np.zeros(3), np.zeros(3)
    for u in noise:
        b = inverse @ (J.T @ u)
        r = u - J @ b
        lags = round(andrews_bandwidth(J * r[:, None]))
        record = scores_of(J, r, np.ones(n), phi, lags, np.arange(3))
        found = judged([record], J.T @ J, ar1_middle(J, phi), {})
        covered += np.abs(b) < found.factor(0.95) * np.sqrt(np.diag(found.cov))
        naive += np.abs(b) < 1.96 * np.sqrt(np.diag(inverse @ record.measured @ inverse))
    assert (naive[1:] < 0.88 * n_draws).all()  # what it was without
    # Monte Carlo error .009; one degree of freedom is left to the shorter pulse, t is then cautious
    assert (covered > 0.925 * n_draws).all() and (covered[[0, 2]] < 0.985 * n_draws).all()


def test_what_is_not_identified_leaves_the_rest_of_the_sandwich_alone():
    n, phi = 200, 0.5
    J, rng = bumps(n), np.random.default_rng(6)
    r = lfilter([1.0], [1.0, -phi], rng.standard_normal(n))
    r -= J @ np.linalg.lstsq(J, r, rcond=None)[0]
    twice = np.column_stack([J, J[:, 2]])  # two parameters that act alike
    alone = judged(
        [scores_of(J, r, np.ones(n), phi, 9, np.arange(3))], J.T @ J, ar1_middle(J, phi), {}
    )
    both = judged(
        [scores_of(twice, r, np.ones(n), phi, 9, np.arange(4))],
        twice.T @ twice, ar1_middle(twice, phi), {},
    )  # fmt: skip
    assert both.identified.tolist() == [True, True, False, False]
    np.testing.assert_allclose(both.cov[:2, :2], alone.cov[:2, :2], rtol=1e-6)


def test_andrews_bandwidth_of_an_ar1():
    rng = np.random.default_rng(4)
    n, rho = 200_000, 0.6
    x = lfilter([1.0], [1.0, -rho], rng.standard_normal(n))[:, None]
    alpha = 4 * rho**2 / ((1 - rho) ** 2 * (1 + rho) ** 2)
    # rho is estimated to a few thousandths
    assert andrews_bandwidth(x) == pytest.approx(1.1447 * (alpha * n) ** (1 / 3), rel=0.02)


# --------------------------------------------------------------------------- bootstrap


def test_bootstrap_of_a_mean_has_its_exact_variance():
    rng = np.random.default_rng(6)
    x = np.array([3.0, 1.0, 4.0, 1.0, 5.0, 9.0, 2.0, 6.0])
    n, length = len(x), 2.5
    means = np.array([x[stationary_indices(n, length, rng)].mean() for _ in range(40_000)])
    d = x - x.mean()
    circular = np.array([np.mean(d * np.roll(d, -k)) for k in range(n)])
    q = 1.0 - 1.0 / length
    # Politis and Romano (1994), eq. 7: weights of the circular autocovariances
    k = np.arange(1, n)
    weight = (1 - k / n) * q**k + k / n * q ** (n - k)
    exact = (circular[0] + np.sum(weight * circular[1:])) / n
    # without blocks the variance differs visibly: this would fail were the blocks ignored
    assert abs(exact / (circular[0] / n) - 1) > 0.1
    assert means.mean() == pytest.approx(x.mean(), abs=4 * np.sqrt(exact / 40_000))
    assert means.var() == pytest.approx(exact, rel=0.03)  # sd of a variance: sqrt(2/40000)


def test_resamples_are_blocks_of_the_asked_mean_length():
    index = stationary_indices(1000, 20.0, np.random.default_rng(1), 100_000)
    breaks = np.sum((np.diff(index) % 1000) != 1)
    assert 100_000 / (breaks + 1) == pytest.approx(20.0, rel=0.05)
    assert len(np.unique(index)) == 1000


@pytest.mark.parametrize("rho", [0.0, 0.6])
def test_resamples_are_those_of_arch(rho):
    arch = pytest.importorskip("arch.bootstrap")
    n, length, n_resamples = 400, 12.0, 3000
    x = lfilter([1.0], [1.0, -rho], np.random.default_rng(8).standard_normal(n))

    def mean_and_correlation(values):
        d = values - values.mean()
        return values.mean(), d[1:] @ d[:-1] / (d @ d)

    def of_arch(length):
        resamples = arch.StationaryBootstrap(length, x, seed=10).bootstrap(n_resamples)
        return np.array([mean_and_correlation(*values) for values, _ in resamples])

    rng = np.random.default_rng(9)
    ours = np.array([
        mean_and_correlation(x[stationary_indices(n, length, rng)]) for _ in range(n_resamples)
    ])  # fmt: skip
    for mine, other in zip(ours.T, of_arch(length).T, strict=True):
        # the same law: one of a thousand pairs of samples would be told apart
        assert stats.ks_2samp(mine, other).pvalue > 1e-3
    # a negative control: shorter blocks are told apart where samples are correlated
    assert stats.ks_2samp(ours[:, 1], of_arch(length / 4)[:, 1]).pvalue < 1e-6 or rho == 0.0


@pytest.mark.parametrize("rho", [-0.5, 0.3, 0.9])
def test_block_length_is_that_of_arch(rho):
    arch = pytest.importorskip("arch.bootstrap")
    x = lfilter([1.0], [1.0, -rho], np.random.default_rng(3).standard_normal(50_000))
    # arch divides correlations by the variances of both parts: another lag may be the last to count
    expected = float(arch.optimal_block_length(x)["stationary"].iloc[0])
    assert optimal_block_length(x) == pytest.approx(expected, rel=0.1)


@pytest.mark.parametrize("rho", [0.4, 0.8])
def test_block_length_of_an_ar1_is_the_theoretical_one(rho):
    n = 60_000
    x = lfilter([1.0], [1.0, -rho], np.random.default_rng(7).standard_normal(n))
    # G = sum |k| R(k), g = sum R(k): for an AR(1) their ratio is 2 rho/(1 - rho^2)
    expected = (2 * (2 * rho / (1 - rho**2)) ** 2 / 2) ** (1 / 3) * n ** (1 / 3)
    assert optimal_block_length(x) == pytest.approx(expected, rel=0.15)


def test_a_refit_on_node_sums_equals_a_refit_of_the_samples(small):
    evidence = Evidence(Problem(small.campaign), small.fit, seed=9)
    refitted, _, details = resample_and_refit(evidence, 1)
    assert details["n_failed"] == 0
    problem = evidence.problem
    vector = small.fit.theta_hat
    rng = np.random.default_rng(np.random.SeedSequence([9, 71]))
    values = {}
    for k, e in enumerate(problem.campaign):
        own = residual_series(problem, vector, k, True)
        index = stationary_indices(len(own.e), own.length, rng)
        innovations = own.e[index]
        innovations[1:] *= np.sqrt(1.0 - own.phi**2)
        z = lfilter([1.0], [1.0, -own.phi], innovations)  # no gaps here: one run each
        values[e.name] = mean_and_variance(problem, vector, k)[0] + own.scale * z
    again = Problem(small.campaign.with_data(values))
    region = evidence.white.compressed.region
    surface = white_surface(again, vector, small.fit.rms, region)
    psi = surface.psi(vector)
    matrix = surface.information(psi)
    maximum = maximise(surface.guarded, lambda _: matrix, psi, surface.mean, *surface.box)
    sd = np.sqrt(np.diag(invert(surface.information(maximum.psi))[0]))
    gap = np.abs(refitted[0] - maximum.psi)[surface.mean] / sd[surface.mean]
    assert gap.max() < 0.02
    moved = np.abs(refitted[0] - evidence.psi_white)[surface.mean] / sd[surface.mean]
    assert moved.max() > 0.5


# --------------------------------------------------------------------------- jackknife, profile


def test_leaving_one_out_equals_a_separate_fit(small):
    evidence = Evidence(Problem(small.campaign), small.fit)
    found, settled = leave_one_out(evidence.white, evidence.psi_white)
    assert settled
    name = "e1"
    rest = Problem(small.campaign.without(name))
    keep = [i for i, n in enumerate(small.fit.names) if f"[{name}]" not in n]
    start = small.fit.theta_hat[keep]
    n = rest.layout.n_mean
    scale = np.maximum(np.abs(start[:n]), 1e-3)

    def residuals(p):
        vector = np.concatenate([p * scale, start[n:]])
        return np.concatenate(
            [e.values - mean_and_variance(rest, vector, k)[0] for k, e in enumerate(rest.campaign)]
        )

    other = least_squares(residuals, start[:n] / scale, xtol=1e-12, ftol=1e-12)
    theta = evidence.white.coordinates.theta(found[1])
    sd = cramer_rao(small.campaign, small.fit.theta_hat, small.fit.rms).sd
    assert np.abs(theta[:3] - (other.x * scale)[:3]) == pytest.approx(np.zeros(3), abs=0.02 * sd[0])


def test_profile_equals_lmfit_under_iid_noise():
    import lmfit

    design = small_design(2, interval=0.05)
    theta = small_theta(design, tau=0.3, phi=0.0, sigma=0.02)
    theta[-1] = 0.0
    campaign = simulate(design, theta, seed=8)
    problem = Problem(campaign, noise=Noise("constant", "white"))
    fit = fit_least_squares(problem, seed=1, swarms=1, euler=False)
    bounds = compare_bounds(problem, fit, methods=["profile"])
    ours = bounds["profile"]
    names = problem.layout.mean_names
    params = lmfit.Parameters()
    plain = [f"p{i}" for i in range(len(names))]
    for key, value in zip(plain, fit.theta_hat):
        params.add(key, value=value)
    params["p0"].min = 1e-6

    def residual(p):
        vector = np.concatenate([[p[key].value for key in plain], fit.theta_hat[-3:]])
        parts = [
            (e.values - mean_and_variance(problem, vector, k)[0]) / fit.rms
            for k, e in enumerate(problem.campaign)
        ]
        return np.concatenate(parts)

    minimizer = lmfit.Minimizer(residual, params)
    result = minimizer.minimize()
    wanted = {"V_mL": "p2", "tau_v_s": "p1", "beta_V[e0]": "p4"}
    found = lmfit.conf_interval(
        minimizer, result, p_names=list(wanted.values()), sigmas=[0.68, 0.95]
    )
    for name, key in wanted.items():
        # entries: lower 95, lower 68, best, upper 68, upper 95
        low95, low68, _, high68, high95 = (value for _, value in found[key])
        for level, low, high in (("68", low68, high68), ("95", low95, high95)):
            a, b = ours.interval(name, level)
            # lmfit uses the F distribution (880 samples) and interpolates: a hundredth of the width
            assert a == pytest.approx(low, abs=0.015 * (high - low)), (name, level)
            assert b == pytest.approx(high, abs=0.015 * (high - low)), (name, level)


def test_maximise_keeps_a_square_above_its_floor():
    A = np.array([[2.0, 0.9], [0.9, 1.0]])
    top = np.array([-1.0, 2.0])

    def objective(p):
        return -0.5 * (p - top) @ A @ (p - top), -A @ (p - top)

    floor = np.array([0.25, -np.inf])
    found = maximise(objective, lambda _: A, np.array([3.0, 0.0]), np.arange(2), floor)
    assert found.converged
    # on the floor the other coordinate answers: 2 - 0.9 (0.25 + 1)
    np.testing.assert_allclose(found.psi, [0.25, 2.0 - 0.9 * 1.25], rtol=1e-6)
    np.testing.assert_allclose(found.free, top, rtol=1e-6)


# --------------------------------------------------------------------------- intervals


def test_intervals_in_the_square_match_their_definition():
    q, sd_q, variance, covariance = 0.002, 0.003, 1e-4, 1e-7
    z = np.array([1.0, 2.0])
    low, high = switch_quantiles(5.0, q, sd_q, variance, covariance, z)
    rng = np.random.default_rng(1)
    draws = rng.multivariate_normal(
        [q, 5.0], [[sd_q**2, covariance], [covariance, variance]], 10**6
    )
    t0 = draws[:, 1] - np.sqrt(np.maximum(draws[:, 0], 0.0))
    expected = np.quantile(t0, stats.norm.cdf([-1, -2, 1, 2]))
    # Monte Carlo error of a quantile of 1e6 draws of spread 0.03
    np.testing.assert_allclose([*low, *high], expected, atol=2e-4)


def test_ends_in_the_square_are_measured_by_the_local_spread():
    taus = np.linspace(0.01, 0.4, 6)
    z = np.array([1.0, 1.96, 2.97])

    def rate(x: float) -> float:
        return 1.0 / (0.004 + 0.03 * max(np.sqrt(x), 0.01))

    for q in (0.0, 0.002, 0.02, 0.1, 0.3):
        low, high = square_ends(q, z, taus, 0.004 + 0.03 * taus)
        for end, sign in ((low, 1.0), (high, -1.0)):
            for x, factor in zip(end, z):
                away = sign * quad(rate, x, q, epsabs=1e-10)[0]
                # 2001 places on a stretch of about .5 s
                assert away == pytest.approx(factor, rel=1e-3) or (x == 0.0 and away < factor)
        assert (np.diff(low) <= 0).all() and (np.diff(high) > 0).all()


def test_an_upper_limit_covers_where_the_spread_grows_with_tau():
    # estimates of tau^2 whose spread depends on it, read as if it did not, and as it does
    rng = np.random.default_rng(4)
    taus = np.linspace(0.001, 0.3, 9)
    spreads = 0.001 + 0.05 * taus
    names, missed = ["tau_s"], {"one": 0, "own": 0}
    for tau in rng.uniform(0.05, 0.15, 600):
        q = tau**2 + rng.standard_normal() * float(np.interp(tau, taus, spreads))
        tau_hat = np.sqrt(max(q, 0.0))
        cov = np.array([[float(np.interp(tau_hat, taus, spreads)) ** 2]])
        for name, along in (("one", None), ("own", (taus, spreads))):
            bound = gaussian_bound(names, np.array([tau_hat]), cov, q <= 0.0, along_tau=along)
            missed[name] += not bound.low[0, 1] <= tau <= bound.high[0, 1]
    # nominal 30 of 600, sd 5
    assert missed["one"] > 42 and 15 < missed["own"] < 42


def test_the_spread_along_tau_is_that_of_the_information(small):
    surface, maximum = small.evidence.coloured, small.evidence.coloured_maximum
    taus, spreads = spread_along_tau(surface, maximum.psi)
    assert (np.diff(taus) > 0).all() and taus[-1] <= 0.5001 * maximum.psi[1]
    for tau, spread in zip(taus, spreads):
        psi = maximum.psi.copy()
        psi[0] = tau**2
        expected = np.linalg.inv(surface.information(psi))[0, 0]
        assert spread**2 == pytest.approx(expected, rel=1e-6)
    # where tau may be the slower lag nothing is followed
    near = maximum.psi.copy()
    near[0] = (0.6 * near[1]) ** 2
    assert spread_along_tau(surface, near) is None


@pytest.mark.parametrize(
    ("phi", "words"), [(0.5, "too narrow, by a factor of about 1.73"), (0.02, ""), (0.0, ""),
                       (-0.6, "too wide, by a factor of about 2")],
)  # fmt: skip
def test_residuals_that_are_not_white_are_said_to_be_so(small, phi, words):
    vector = small.fit.theta_hat.copy()
    vector[small.evidence.problem.layout.noise[:, 0]] = phi
    said = coloured_noise(small.evidence.problem, vector)
    assert (words in said) if words else said == ""


@pytest.mark.parametrize("tau", [0.0, 1e-4, 0.05, 1.0])
def test_gaussian_intervals_are_nested_and_never_divide_by_zero(tau):
    names = ["tau_s", "t0_s[a]"]
    cov = np.array([[1e-5, 1e-8], [1e-8, 1e-6]])
    bound = gaussian_bound(names, np.array([tau, 2.0]), cov, at_bound=tau == 0.0)
    assert np.isfinite(bound.low).all() and np.isfinite(bound.high).all()
    assert (np.diff(bound.low, axis=1) <= 0).all() and (np.diff(bound.high, axis=1) >= 0).all()
    assert (bound.low[0] >= 0).all()
    assert bound.high[0, 1] == pytest.approx(np.sqrt(tau**2 + 1.959964 * np.sqrt(1e-5)), rel=1e-6)
    assert np.isnan(bound.sd[0]) == (tau < 0.04)
    if tau == 1.0:  # far from zero it is the usual interval
        usual = 1.959964 * np.sqrt(1e-5) / 2.0
        assert bound.interval("tau_s")[0] == pytest.approx(1.0 - usual, abs=0.01 * usual)


def test_every_method_says_something_about_every_parameter(small):
    bounds = small.bounds
    assert set(CONTRACT) <= set(bounds.methods) and set(bounds.methods) == set(METHODS)
    n_mean = len(small.campaign) * 4 + 3
    for method, bound in bounds.methods.items():
        assert isinstance(bound, Bound)
        assert bound.assumes and bound.reference
        assert len(bound.names) == n_mean
        shown = 3 if method == "jackknife_experiments" else n_mean
        assert np.isfinite(bound.high[:shown]).all(), method
        assert np.isfinite(bound.low[:shown]).all(), method
        assert np.isnan(bound.high[shown:]).all()
        assert (np.diff(bound.low[:shown], axis=1) <= 0).all(), method
        assert (np.diff(bound.high[:shown], axis=1) >= 0).all(), method
        assert (bound.low[:shown, 0] <= bound.estimate[:shown]).all(), method
        assert (bound.high[:shown, 0] >= bound.estimate[:shown]).all(), method


def test_coloured_methods_agree_and_the_iid_bound_is_too_narrow(small):
    widths = {
        method: np.subtract(*small.bounds[method].interval("V_mL")[::-1])
        for method in ("crlb_iid", "crlb_ar1", "sandwich", "sandwich_ar1", "profile")
    }
    # correlation widens by sqrt((1 + phi)/(1 - phi)) = 2 for slow sensitivities
    assert widths["crlb_ar1"] / widths["crlb_iid"] == pytest.approx(2.0, rel=0.1)
    for method in ("sandwich", "sandwich_ar1", "profile"):
        assert widths[method] == pytest.approx(widths["crlb_ar1"], rel=0.15), method
    bootstrap = np.subtract(*small.bounds["block_bootstrap"].interval("V_mL")[::-1])
    # 300 resamples give a 95 % interval to some 10 %
    assert bootstrap == pytest.approx(widths["crlb_ar1"], rel=0.25)


def test_the_iid_bounds_say_that_the_noise_is_not_white(small):
    for method, bound in small.bounds.methods.items():
        assert ("not white" in bound.status) == method.startswith("crlb_iid")
    record = small.bounds.to_json()["methods"]["crlb_iid"]
    assert "too narrow, by a factor of about 1.98" in record["status"]  # phi is .59


def test_the_truth_lies_inside_the_coloured_intervals(small):
    names = small.fit.names
    for method in ("crlb_ar1", "sandwich", "block_bootstrap", "profile"):
        bound = small.bounds[method]
        inside = [
            low <= small.theta[names.index(name)] <= high
            for name, low, high in zip(bound.names, bound.low[:, 2], bound.high[:, 2])
        ]
        assert all(inside), method


def test_information_of_the_variance_narrows_the_coloured_bound(small):
    bound = small.bounds["crlb_ar1"]
    problem = Problem(small.campaign)
    evidence = Evidence(problem, small.fit)
    vector = evidence.coloured.coordinates.theta(evidence.coloured_maximum.psi)
    reference = cramer_rao(problem, vector, noise="ar1")
    np.testing.assert_allclose(bound.sd, reference.sd, rtol=1e-5)


def test_posterior_intervals_are_quantiles_of_the_draws(small):
    bound = small.bounds["posterior"]
    draws = small.posterior.draws[:, small.posterior.names.index("V_mL")]
    for level, tail in ((0.95, 0.025), ("997", 0.0015)):
        ends = np.quantile(draws, [tail, 1.0 - tail])
        assert bound.interval("V_mL", level) == pytest.approx(tuple(ends))
    row = percentiles(draws)  # the posterior's own, so that one interval has one number
    assert bound.interval("V_mL") == pytest.approx((row["q2.5"], row["q97.5"]), rel=1e-12)


def test_json_follows_the_contract(small, tmp_path):
    text = json.dumps(small.bounds.to_json(), allow_nan=False)
    methods = json.loads(text)["methods"]
    for method in CONTRACT:
        entry = methods[method]
        assert isinstance(entry["assumes"], str)
        tau = entry["parameters"]["tau_s"]
        keys = {"estimate", "sd"} | {f"{end}{level}" for level in LEVELS for end in ("lo", "hi")}
        assert set(tau) == keys
    assert methods["jackknife_experiments"]["parameters"]["y0_V[e0]"] is None
    assert methods["profile"]["parameters"]["V_mL"]["sd"] is None
    table = small.bounds.table()
    assert table.loc[("V_mL", "crlb_iid"), "sd"] == methods["crlb_iid"]["parameters"]["V_mL"]["sd"]
    path = tmp_path / "bounds.csv"
    small.bounds.to_csv(path)
    lines = path.read_text().splitlines()
    assert lines[0].startswith("parameter,method,estimate,sd,lo68,hi68")
    assert len(lines) == 1 + len(table)


def test_same_seed_same_bounds(small):
    again = compare_bounds(small.campaign, small.fit, methods=["block_bootstrap"], n_resamples=30)
    more = compare_bounds(small.campaign, small.fit, methods=["block_bootstrap"], n_resamples=30)
    other = compare_bounds(
        small.campaign, small.fit, methods=["block_bootstrap"], n_resamples=30, seed=2
    )
    a, b, c = (x["block_bootstrap"].sd for x in (again, more, other))
    np.testing.assert_array_equal(a, b)
    assert (a != c).any()


def test_compare_refuses_what_it_cannot_do(small):
    with pytest.raises(CampaignError, match="no bound method 'jackknife'"):
        compare_bounds(small.campaign, small.fit, methods=["jackknife"])
    with pytest.raises(CampaignError, match="needs the posterior"):
        compare_bounds(small.campaign, small.fit, methods=["posterior"])
    with pytest.raises(CampaignError, match="without data"):
        compare_bounds(small_design(), small.fit)
    with pytest.raises(CampaignError, match="fit this campaign"):
        compare_bounds(small.campaign.without("e0"), small.fit)
    with pytest.raises(KeyError, match="no level '90'; there are 68, 95, 997"):
        small.bounds["crlb_iid"].interval("V_mL", "90")


def test_progress_rises_to_one(small):
    seen = []
    compare_bounds(
        small.campaign, small.fit, methods=["crlb_iid", "profile"],
        progress=lambda fraction, text: seen.append((fraction, text)),
    )  # fmt: skip
    fractions = [fraction for fraction, _ in seen]
    assert fractions == sorted(fractions) and fractions[-1] == 1.0
    assert {"crlb_iid", "profile"} <= {text for _, text in seen}


def test_step_up_only_gaps_and_unequal_intervals():
    up = small_design(3, interval=0.01, fall=False, masked=True)
    slower = replace(up.experiments[2], t=up.experiments[2].t[::2], interval=0.02, mask=None)
    design = replace(up, experiments=(*up.experiments[:2], slower))
    campaign = simulate(design, small_theta(design), seed=4)
    fit = fit_least_squares(campaign, seed=1, swarms=1, euler=False)
    bounds = compare_bounds(campaign, fit, n_resamples=40)
    for method, bound in bounds.methods.items():
        low, high = bound.interval("V_mL")
        assert low < 40.0 < high or method.startswith("crlb_iid"), method
        assert not any(name.startswith("tf_s") for name in bound.names)
        assert np.isfinite(bound.high[:3]).all(), method


# --------------------------------------------------------------------------- tau at its bound


@pytest.fixture(scope="module")
def at_bound() -> SimpleNamespace:
    """A campaign whose least-squares tau sits at its lower bound."""
    design = small_design(4, interval=0.01)
    theta = small_theta(design, tau=0.004, phi=0.8, sigma=0.05)
    for seed in range(1, 30):
        campaign = simulate(design, theta, seed)
        fit = fit_least_squares(campaign, seed=1, swarms=1, euler=False)
        if "tau_s" in fit.at_bound:
            break
    assert "tau_s" in fit.at_bound
    return SimpleNamespace(
        campaign=campaign,
        theta=theta,
        fit=fit,
        bounds=compare_bounds(campaign, fit, n_resamples=120),
    )


def test_at_the_bound_every_method_gives_an_upper_limit(at_bound):
    for method, bound in at_bound.bounds.methods.items():
        row = bound.row("tau_s")
        assert row["lo95"] == 0.0 and row["lo997"] == 0.0, method
        assert np.isnan(row["sd"]), method
        assert 0.0 < row["hi68"] < row["hi95"] < row["hi997"], method
        assert "upper limit" in bound.status, method
        if not method.startswith("crlb_iid"):
            assert row["hi95"] > 0.004, method
            assert 0.02 < row["hi95"] < 0.6, method
        others = bound.low[1:3], bound.high[1:3]
        assert np.isfinite(others).all(), method


def test_at_the_bound_the_switch_times_have_one_sided_room(at_bound):
    for method in ("crlb_ar1", "sandwich", "block_bootstrap", "profile"):
        bound = at_bound.bounds[method]
        i = bound.names.index("t0_s[e0]")
        below = bound.estimate[i] - bound.low[i, 1]
        above = bound.high[i, 1] - bound.estimate[i]
        # a slower sensor may be traded for an earlier switch, never for a later one
        assert below > 1.2 * above > 0.0, method
        assert np.isnan(bound.sd[i]), method


# --------------------------------------------------------------------------- what makes tau hard


def test_multiple_correlation_is_that_of_a_regression():
    rng = np.random.default_rng(1)
    X = rng.standard_normal((500, 3))
    X[:, 0] += X[:, 1] - 0.5 * X[:, 2]
    fitted = X[:, 1:] @ np.linalg.lstsq(X[:, 1:], X[:, 0], rcond=None)[0]
    share = fitted @ fitted / (X[:, 0] @ X[:, 0])
    assert multiple_correlation(X.T @ X, 0, [1, 2]) == pytest.approx(np.sqrt(share))
    assert multiple_correlation(X.T @ X, 0, []) == 0.0


def test_tau_is_hard_at_the_published_design():
    told = explain_tau(published_design(), published_theta())
    assert 3 * told.known["nothing"] == pytest.approx(0.03274, abs=5e-6)
    assert 3 * told.known["t0, tf"] == pytest.approx(0.00316, abs=5e-6)
    assert told.known["nothing"] / told.known["V"] < 1.01
    assert told.collinearity["switches"] > 0.99 > told.collinearity["others"]
    assert (np.diff(told.eigenvalues) >= 0).all() and told.eigenvalues[0] < 0.01
    assert next(iter(told.weakest)) == "tau_s"
    assert sum(v**2 for v in told.weakest.values()) == pytest.approx(1.0)
    # sd(tau) = sd(tau^2)/(2 tau), and sd(tau^2) hardly depends on tau where sd(tau) explodes
    assert told.sd_square == pytest.approx(2 * 0.0481 * told.known["nothing"], rel=1e-6)
    first, last = told.by_tau.iloc[0], told.by_tau.iloc[-1]
    assert first.sd_square_s2 / last.sd_square_s2 > 0.4
    assert first.sd_tau_s / last.sd_tau_s > 50
    text = " ".join(told.sentences)
    assert "switch times known, the bound on tau would be 1.1 ms in place of 11 ms" in text
    json.dumps(told.to_json(), allow_nan=False)


def test_tau_of_zero_can_be_explained():
    design = small_design(2, fall=False)
    theta = small_theta(design, tau=0.0)
    told = explain_tau(design, theta)
    assert np.isfinite(told.sd_square) and told.sd_square > 0
    assert any("upper limit" in sentence for sentence in told.sentences)
    assert "tf" not in told.known and told.known["t0"] < 0.2 * told.known["nothing"]


@pytest.mark.parametrize("tau", [10.0, 1e-4])
def test_a_tau_that_no_sample_sees_is_explained(tau):
    # the switch lies between two samples; short lags are over before the next one
    t = np.arange(0.0, 600.0, 10.0)
    design = Campaign.from_frames({"1": (t, 0.0 * t)}, stages=["sensor"], commanded_on="290 s")
    step = {"y0_V": 1.0, "beta_V": -0.5, "t0_s": 295.0}
    noise = {"phi": 0.3, "sigma0_V": 0.01, "sigma1_V": 0.01}
    told = explain_tau(design, {"tau_s": tau, **noise, "experiments": {"1": step}})
    assert np.isinf(told.by_tau.iloc[0][["sd_square_s2", "sd_tau_s"]]).all()
    assert np.isfinite(told.sd_square) == (tau > 1.0)
    json.dumps(told.to_json(), allow_nan=False)
    assert told.sentences


def test_the_profile_of_data_follows_the_square_and_not_the_gaussian(at_bound):
    told = explain_tau(at_bound.campaign, at_bound.fit.theta_hat, n_curve=9)
    curve = told.curve
    assert curve["drop"].iloc[0] < 0.2
    assert (np.diff(curve["drop"]) > -1e-3).all()
    end = curve.iloc[-1]
    assert 0.3 < end["drop"] / end["square"] < 2.0
    evidence = Evidence(Problem(at_bound.campaign), at_bound.fit)
    profiler = Profiler.of(evidence.coloured, evidence.coloured_maximum)
    limit = at_bound.bounds["profile"].interval("tau_s")[1]
    drop = profile_curve(profiler, np.array([limit]))[0]
    assert drop == pytest.approx(0.5 * 1.959964**2, abs=0.02)


# --------------------------------------------------------------------------- edges, conventions


def test_the_bound_takes_what_the_noise_law_pins_as_pinned():
    design = campaigns.small_design(n=2, interval=0.02)
    white = Problem(design, noise=Noise(autocorrelation="white"))
    theta = campaigns.small_theta(design, phi=0.7)
    expected = cramer_rao(white, {**theta, "phi": 0.0}, noise="ar1")
    np.testing.assert_array_equal(cramer_rao(white, theta, noise="ar1").cov, expected.cov)
    assert cramer_rao(design, theta, noise="ar1")["V_mL"] > 1.2 * expected["V_mL"]


@pytest.mark.parametrize("noise", ["iid", "ar1"])
def test_a_tau_of_zero_is_not_identified_and_the_rest_is_its_limit(noise: str):
    design = campaigns.small_design(n=2, interval=0.02)
    none, little = (
        cramer_rao(design, campaigns.small_theta(design, tau=tau), noise=noise)
        for tau in (0.0, 1e-4)
    )
    lost = [name for name in none.names if np.isinf(none[name])]
    assert lost == ["tau_s", "t0_s[a]", "tf_s[a]", "t0_s[b]", "tf_s[b]"]
    assert none.status == f"the data do not identify {', '.join(lost)}"
    for name in ("tau_v_s", "y0_V[a]", "beta_V[b]"):
        assert none[name] == pytest.approx(little[name], rel=0.02)


def test_a_finite_step_moves_a_tau_of_zero():
    design = campaigns.small_design(n=2, interval=0.02)
    theta = campaigns.small_theta(design, tau=0.0)
    known = {"method": "exact", "fixed": ("t0_s", "tf_s")}
    converged = cramer_rao(design, {**theta, "tau_s": 5e-4}, **known)["tau_s"]
    for difference in ("forward", "central"):
        found = cramer_rao(design, theta, step=0.01, difference=difference, **known)["tau_s"]
        assert found == pytest.approx(converged, rel=0.03)
    with pytest.raises(CampaignError, match="forward Euler is unstable for a time constant of 0 s"):
        cramer_rao(design, theta, step=0.01)


@pytest.mark.parametrize(
    ("changes", "options", "said"),
    [
        ({}, {"sigma": 0.0}, "sigma is 0.0 V; expected the noise's size, above zero"),
        ({}, {"sigma": -0.05}, "sigma is -0.05 V"),
        ({}, {"sigma": np.nan, "step": 0.01}, "sigma is nan V"),
        ({"phi": 1.0}, {"noise": "ar1"}, "phi is 1; expected a value above -1 and below 1"),
        ({"sigma0_V": 0.0}, {"noise": "ar1"}, "sigma0_V is 0 V; expected noise of some size"),
        ({"sigma1_V": -0.1}, {"noise": "ar1"}, "sigma1_V is -0.1 V"),
        ({"tau_s": -0.1}, {}, "time constants must be positive"),
        ({"V_mL": 0.0}, {}, "time constants must be positive"),
    ],
)
def test_the_bound_refuses_values_that_nothing_has(changes, options, said: str):
    design = campaigns.small_design(n=2, interval=0.02)
    with pytest.raises(CampaignError, match=said):
        cramer_rao(design, {**campaigns.small_theta(design), **changes}, **options)


@pytest.mark.parametrize("n_resamples", [0, 1])
def test_a_bootstrap_without_spread_is_refused(at_bound, n_resamples: int):
    campaign, fit = at_bound.campaign, at_bound.fit
    with pytest.raises(CampaignError, match=f"n_resamples is {n_resamples}; expected at least 2"):
        compare_bounds(campaign, fit, methods=["block_bootstrap"], n_resamples=n_resamples)


def test_the_profile_keeps_to_the_order_of_tau_and_tau_v():
    design = campaigns.small_design(n=2, interval=0.02)
    campaign = simulate(design, campaigns.small_theta(design, sigma0=0.03, tau=0.16), seed=2)
    fit = fit_least_squares(campaign, seed=1, swarms=1, euler=False)
    problem = Problem(campaign)
    evidence = Evidence(problem, fit)
    profiler = Profiler.of(evidence.coloured, evidence.coloured_maximum)
    tau, tau_v = evidence.coloured_theta[:2]
    swapped = evidence.coloured_theta.copy()
    swapped[:2] = tau_v, tau
    # the likelihood itself does not know which is which
    at_maximum = log_likelihood(problem, evidence.coloured_theta)
    assert log_likelihood(problem, swapped) == pytest.approx(at_maximum, abs=1e-9)
    assert profiler.drop(0, tau_v**2) > 3.0 and profiler.drop(1, tau) > 3.0
    middle = 0.5 * (tau + tau_v)
    assert profiler.best(0, middle**2).psi[1] >= middle * (1 - 1e-9)
    assert profiler.best(1, middle).psi[0] <= middle**2 * (1 + 1e-9)
    bound = compare_bounds(campaign, fit, methods=["profile"])["profile"]
    assert bound.status == "ok"
    assert tau < bound.interval("tau_s")[1] < tau_v and tau < bound.interval("tau_v_s")[0] < tau_v
    # an end is where the best in that order has fallen so far
    for i, name, end in ((0, "tau_s", 1), (1, "tau_v_s", 0)):
        value = bound.interval(name)[end]
        assert profiler.drop(i, value**2 if i == 0 else value) == pytest.approx(1.96, abs=5e-3)


def test_whitening_across_a_gap_leaves_white_noise() -> None:
    # phi .95 and two samples missing in every twenty: a wrong neighbour across the gap shows
    masked = [(0.2 * k, 0.2 * k + 0.0199) for k in range(1, 600)]
    campaign = long_design(n=1, interval=0.01, duration=120.0, masked=masked)
    problem = Problem(campaign)
    theta = its_theta(campaign, phi=0.95)
    problem = replace(problem, campaign=simulate(problem, theta, seed=3))
    e = problem.campaign.experiments[0]
    series = residual_series(problem, problem.layout.flat(theta), 0, whitened=True)
    starts = np.cumsum([0, *(b - a for a, b in e.runs[:-1])])[1:]
    assert len(starts) > 500
    # variance 1 within and across, sd of the mean square across sqrt(2/n)
    assert np.mean(series.e[starts] ** 2) == pytest.approx(1.0, abs=4 * np.sqrt(2 / len(starts)))
    z = (e.values - e.values.mean())[e.used]
    assert z.std() > 0  # the raw series is not what is resampled
    np.testing.assert_allclose(
        series.across[1:], 0.95 ** (e.runs[1:, 0] - e.runs[:-1, 1] + 1), rtol=1e-12
    )


def test_a_profile_is_followed_outwards_in_proportion() -> None:
    def at(value: float, drop: float) -> Point:
        return Point(value, drop, np.zeros(1))

    for centre, sign in ((2.0, 1.0), (2.0, -1.0), (-0.5, 1.0)):
        near = at(centre + sign * 0.25, 1.0)
        # a Gaussian profile: the drop is proportional to the distance; 2 % beyond the target
        assert next_value(centre, near, None, 9.0, 1.96) == pytest.approx(
            centre + sign * 0.25 * 1.02 * 1.96
        )
        assert next_value(centre, at(centre, 0.0), None, 9.0, 1.96) == 9.0
        # at most three times as far
        assert next_value(centre, near, None, 9.0, 100.0) == pytest.approx(centre + sign * 0.75)
