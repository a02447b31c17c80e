"""How bounds search: compiled Newton steps against linear algebra, two branches, weak steps."""

from dataclasses import replace

import numpy as np
import pytest

from bayes_sensor.bounds import METHODS, compare_bounds
from bayes_sensor.bounds.likelihood_surface import coloured_surface, maximise
from bayes_sensor.bounds.newton import (
    factor,
    gradient_by_psi,
    learnt,
    mixed,
    projected_step,
    solve,
    theta_of,
)
from bayes_sensor.bounds.sandwich_covariance import ar1_middle
from bayes_sensor.checks.coverage import SETTINGS, BoundsStudy, simulate_setting, small_design
from bayes_sensor.fit import fit_least_squares
from bayes_sensor.likelihood.coordinates import Coordinates
from bayes_sensor.likelihood.problem import Problem

RNG = np.random.default_rng(11)


def positive(n: int) -> np.ndarray:
    A = RNG.standard_normal((n + 3, n))
    return A.T @ A * np.outer(s := 10.0 ** RNG.uniform(-3, 3, n), s)


def test_cholesky_and_solution_are_those_of_linear_algebra() -> None:
    A = positive(6)
    L = A.copy()
    assert factor(L)
    np.testing.assert_allclose(np.tril(L), np.linalg.cholesky(A), rtol=1e-9)
    assert not factor(-A)
    some = np.array([0, 2, 5])
    b = RNG.standard_normal(3)
    # the ridge moves the solution by its own size times the scaled condition number
    np.testing.assert_allclose(
        solve(A, b, some, 0.0), np.linalg.solve(A[np.ix_(some, some)], b), rtol=1e-4
    )
    damped = A[np.ix_(some, some)] + np.diag(2.0 * np.diag(A)[some])
    np.testing.assert_allclose(solve(A, b, some, 2.0), np.linalg.solve(damped, b), rtol=1e-6)
    assert np.isfinite(solve(np.ones((3, 3)), b, np.arange(3), 0.0)).all()  # singular


def test_a_projected_step_maximises_the_quadratic_in_its_box() -> None:
    from scipy.optimize import minimize

    A, g = positive(4) / 1e3, RNG.standard_normal(4)
    A = np.diag(1 / np.sqrt(np.diag(A))) @ A @ np.diag(1 / np.sqrt(np.diag(A)))
    psi = np.zeros(4)
    free, cut = projected_step(A, g, psi, psi - 1e3, psi + 1e3, np.arange(4), 0.0)
    assert not cut
    np.testing.assert_allclose(A @ free, g, rtol=1e-3, atol=1e-5)
    floor, ceiling = np.full(4, -1e3), np.full(4, 1e3)
    floor[0] = 0.5 * free[0] if free[0] < 0 else -1e3
    ceiling[0] = 0.5 * free[0] if free[0] > 0 else 1e3
    step, cut = projected_step(A, g, psi, floor, ceiling, np.arange(4), 0.0)
    assert cut
    best = minimize(
        lambda p: 0.5 * p @ A @ p - g @ p, psi, jac=lambda p: A @ p - g, method="L-BFGS-B",
        bounds=list(zip(floor, ceiling)), options={"gtol": 1e-10, "ftol": 1e-15},
    )  # fmt: skip
    np.testing.assert_allclose(step, best.x, rtol=1e-3, atol=1e-5)


def test_a_wall_that_the_gradient_pushes_against_holds() -> None:
    A, g = np.array([[2.0, 0.5], [0.5, 1.0]]), np.array([-1.0, 1.0])
    step, cut = projected_step(
        A, g, np.zeros(2), np.array([0.0, -9.0]), np.full(2, 9.0), np.arange(2), 0.0
    )
    assert not cut
    np.testing.assert_allclose(step, [0.0, 1.0], rtol=1e-6)


def test_curvature_is_learnt_as_bfgs_does_and_left_alone_where_that_fails() -> None:
    base, true = positive(3) / 1e3, positive(3) / 1e3
    base, true = (M / np.sqrt(np.outer(np.diag(M), np.diag(M))) for M in (base, true))
    s = RNG.standard_normal(3)
    y = true @ s
    found = learnt(base, base, s, y, np.arange(3))
    expected = base + np.outer(y, y) / (s @ y) - np.outer(base @ s, base @ s) / (s @ base @ s)
    np.testing.assert_allclose(found, expected, rtol=1e-10)
    np.testing.assert_allclose(found @ s, y, rtol=1e-10)  # the secant condition
    np.testing.assert_array_equal(learnt(base, base, s, -y, np.arange(3)), base)


def test_coordinates_are_those_of_the_laplace_approximation() -> None:
    design, theta = small_design()
    coordinates = Coordinates(Problem(design))
    vector = np.concatenate([theta, [0.4, 0.02, 0.01]])
    psi = coordinates.psi(vector)
    places = (
        coordinates.free, coordinates.squared, coordinates.switches, coordinates.phi,
        coordinates.log_sigmas,
    )  # fmt: skip
    for point in (psi, np.where(np.arange(len(psi)) == 0, -1.0, psi)):
        np.testing.assert_allclose(
            theta_of(point, np.zeros(len(vector)), *places), coordinates.theta(point), rtol=1e-14
        )
    g = RNG.standard_normal(len(vector))
    np.testing.assert_allclose(
        gradient_by_psi(vector, g, *places), coordinates.slopes(vector).T @ g, rtol=1e-12
    )


def test_matrices_are_mixed_linearly_and_held_beyond_the_ends() -> None:
    taus = np.array([0.0, 1.0, 3.0])
    M = np.arange(3.0)[:, None, None] * np.ones((3, 2, 2))
    for tau, expected in ((-1.0, 0.0), (0.5, 0.5), (1.0, 1.0), (2.0, 1.5), (9.0, 2.0)):
        assert mixed(tau, taus, M)[0, 1] == pytest.approx(expected)


def test_a_ridge_of_rosenbrock_is_climbed_between_walls() -> None:
    def objective(p: np.ndarray) -> tuple[float, np.ndarray]:
        x, y = p
        value = -((1 - x) ** 2) - 10 * (y - x**2) ** 2
        return value, np.array([2 * (1 - x) + 40 * x * (y - x**2), -20 * (y - x**2)])

    rough = np.array([[50.0, 0.0], [0.0, 20.0]])  # far from the true curvature: it must learn
    low = np.full(2, -np.inf)
    for ceiling, best in ((np.full(2, np.inf), (1.0, 1.0)), (np.array([0.5, 9.0]), (0.5, 0.25))):
        found = maximise(
            objective, lambda _: rough, np.array([-1.0, 1.0]), np.arange(2), low, ceiling, 200,
            1e-9, 0.0,
        )  # fmt: skip
        assert found.converged
        np.testing.assert_allclose(found.psi, best, atol=2e-3)


def test_least_squares_of_a_mean_under_ar1_noise_has_its_exact_variance() -> None:
    n, phi = 50, 0.7
    ones = np.ones((n, 1))
    k = np.arange(1, n)
    exact = (n + 2 * np.sum((n - k) * phi**k)) / n**2
    assert ar1_middle(ones, phi)[0, 0] / n**2 == pytest.approx(exact, rel=1e-12)


@pytest.mark.parametrize("number", [19, 33])
def test_profiles_follow_the_higher_of_two_branches(number: int) -> None:
    # at these campaigns tau at zero and tau above it are both maxima over the rest
    study = BoundsStudy(SETTINGS["ar1_0.9"], methods=("profile", "crlb_ar1"))
    found = study(number)
    assert np.isfinite(found["low"]).all() and np.isfinite(found["high"]).all()
    assert (np.diff(found["low"][0], axis=1) <= 0).all()
    assert (np.diff(found["high"][0], axis=1) >= 0).all()
    width = found["high"][..., 1] - found["low"][..., 1]
    linear = [i for i, name in enumerate(study.names) if name[:2] in ("y0", "be", "V_", "ta")][1:]
    np.testing.assert_allclose(width[0, linear], width[1, linear], rtol=0.25)


def test_the_faster_lag_is_the_sensor() -> None:
    design, theta = small_design()
    theta[0] = 0.7  # near the valve's .86
    setting = replace(SETTINGS["ar1_0.5"], sigma0=0.05, sigma1=0.05)
    campaign = simulate_setting(design, theta, setting, 3)
    start = np.concatenate([theta, [0.5, 0.05, 0.05]])
    start[:2] = 0.9, 0.6
    surface, maximum = coloured_surface(Problem(campaign), start)
    tau, tau_v = surface.coordinates.theta(maximum.psi)[:2]
    assert tau <= tau_v


def test_a_step_lost_in_the_noise_leaves_every_interval_sound_or_null() -> None:
    design, theta = small_design()
    weak = 3 + 4 * 1 + 1  # beta of the second experiment
    theta[weak] = 0.002
    campaign = simulate_setting(design, theta, SETTINGS["ar1_0.9"], 8)
    fit = fit_least_squares(campaign, seed=1, swarms=1, euler=False)
    bounds = compare_bounds(campaign, fit, n_resamples=60)
    assert set(bounds.methods) == set(METHODS) - {"posterior"}
    for method, bound in bounds.methods.items():
        given = np.isfinite(bound.low) & np.isfinite(bound.high)
        assert (bound.low[given] <= bound.high[given]).all(), method
        both = given[:, 0] & given[:, 1]
        assert (bound.low[both, 1] <= bound.low[both, 0]).all(), method
        assert (bound.high[both, 1] >= bound.high[both, 0]).all(), method
        if not given.all() and method != "jackknife_experiments":
            assert bound.status != "ok", method
        if given[2, 1] and not method.startswith("crlb_iid"):
            assert bound.low[2, 2] < theta[2] < bound.high[2, 2], method
    assert sum(np.isfinite(b.high[2, 1]) for b in bounds.methods.values()) >= 5


@pytest.mark.slow
def test_lags_that_coincide_at_equal_flows_get_no_narrow_interval() -> None:
    design, theta = small_design()
    flow = design.experiments[0].total_flow
    same = [replace(e, carrier_flow=flow - e.test_gas_flow) for e in design]
    design = replace(design, experiments=tuple(same))
    theta[2] = theta[1] * flow  # a manifold as slow as the valve: their sensitivities are parallel
    campaign = simulate_setting(design, theta, SETTINGS["ar1_0.5"], 2)
    fit = fit_least_squares(campaign, seed=1, swarms=1, euler=False)
    bounds = compare_bounds(campaign, fit, n_resamples=40)
    for method, bound in bounds.methods.items():
        low, high = bound.low[1:3], bound.high[1:3]
        told = np.isfinite(low).all(axis=1) & np.isfinite(high).all(axis=1)
        assert bound.status != "ok", method
        assert ((high - low)[told, 1] > theta[1]).all(), method  # both lags, in seconds
        # what the coincidence does not touch is bounded all the same by least squares
        if method in ("crlb_iid", "sandwich", "block_bootstrap"):
            i = bound.names.index("y0_V[1]")
            assert bound.low[i, 2] < theta[3] < bound.high[i, 2], method
