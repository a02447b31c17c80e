"""The compiled filter and smoother against a dense Gaussian and against statsmodels."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pytest
from scipy.linalg import expm, solve_discrete_lyapunov
from scipy.stats import multivariate_normal

from bayes_sensor.restoration.kalman import discretise
from bayes_sensor.restoration.state_space import FilterSamples, Model, make_samples

CHAINS = [(1, (3.0,)), (2, (3.0, 0.7)), (1, (3.0, 3.0, 0.01)), (2, (0.2, 5.0, 1.0))]
"""order of the input and lags: equal ones and very short ones, too"""


def samples_of(t: np.ndarray, y: np.ndarray, level: np.ndarray | None = None) -> FilterSamples:
    """The samples with their mean and spread left out of account."""
    made = make_samples(t, y, slowest=1.0)[0]
    level = np.zeros(len(t)) if level is None else level
    return replace(made, y=y, level=level)


def irregular(n: int, rng: np.random.Generator) -> np.ndarray:
    """Times in s with small steps, large ones and a long gap, on a grid of 1 ms."""
    steps = rng.choice([0.001, 0.02, 0.5, 0.5, 0.5, 1.3, 40.0], size=n - 1)
    return np.concatenate([[0.0], np.cumsum(steps)]).round(3)


def dense(model: Model, t: np.ndarray, level: np.ndarray) -> tuple[np.ndarray, ...]:
    """Covariances of the samples, of input and samples, and of the input, (n, n) each.

    x(t) = exp(A (t - s)) x(s) + what comes after s; the covariance at s is the stationary one and
    what is left of the start.
    """
    drift, _, stationary = model.matrices()
    m, n = len(drift), len(t)
    extra = np.diag([0.0] * model.order + [1.0] * (m - model.order))
    at = [stationary + (e := expm(drift * s)) @ extra @ e.T for s in t]
    phi = model.phi
    interval = float(np.median(np.diff(t)))
    scale = model.sigma * np.sqrt(1.0 + (model.growth * level) ** 2)
    yy, uy, uu = np.empty((n, n)), np.empty((n, n)), np.empty((n, n))
    for i in range(n):
        for j in range(i + 1):
            c = expm(drift * (t[i] - t[j])) @ at[j]  # of x(t_i) and x(t_j)
            noise = scale[i] * scale[j] * phi ** ((t[i] - t[j]) / interval)
            yy[i, j] = yy[j, i] = c[-1, -1] + noise
            uy[i, j], uy[j, i] = c[0, -1], c[-1, 0]
            uu[i, j] = uu[j, i] = c[0, 0]
    return yy, uy, uu


@pytest.mark.slow
@pytest.mark.parametrize(("order", "lags"), CHAINS)
@pytest.mark.parametrize(("phi", "growth"), [(0.0, 0.0), (0.7, 2.0)])
def test_filter_and_smoother_are_those_of_a_dense_gaussian(
    order: int, lags: Sequence[float], phi: float, growth: float
) -> None:
    rng = np.random.default_rng(3)
    t = irregular(60, rng)
    level = rng.uniform(size=60)
    model = Model(order, 1.3, 4.0, tuple(lags), 0.1, phi, growth)
    yy, uy, uu = dense(model, t, level)
    y = np.linalg.cholesky(yy) @ rng.standard_normal(60)
    y[[7, 8, 30]] = np.nan  # samples that were not taken
    seen = np.isfinite(y)
    samples = samples_of(t, y, level)
    inner = yy[np.ix_(seen, seen)]
    expected = multivariate_normal(np.zeros(seen.sum()), inner).logpdf(y[seen])
    # times are on a grid of 1 ms, so that no rounding of theirs is left
    assert samples.log_likelihood(model) == pytest.approx(expected, abs=1e-5)
    weights = np.linalg.solve(inner, uy[:, seen].T)
    mean, variance = samples.smooth(model)
    np.testing.assert_allclose(mean, weights.T @ y[seen], atol=1e-6)
    np.testing.assert_allclose(variance, np.diag(uu - uy[:, seen] @ weights), atol=1e-6)
    # innovations of a Gaussian are white with variance one: their sum of squares is y' K^-1 y
    e = samples.innovations(model)[seen]
    assert e @ e == pytest.approx(y[seen] @ np.linalg.solve(inner, y[seen]), abs=1e-5)


@pytest.mark.slow
def test_values_of_the_input_act_as_measurements_of_it() -> None:
    rng = np.random.default_rng(4)
    t = irregular(40, rng)
    model = Model(2, 1.0, 4.0, (3.0,), 0.1, 0.5)
    yy, uy, uu = dense(model, t, np.zeros(40))
    y = np.linalg.cholesky(yy) @ rng.standard_normal(40)
    places, values, errors = (
        np.array([3, 20, 39]),
        np.array([0.5, -1.0, 2.0]),
        np.array([1.0, 0.2, 3.0]),
    )
    held = samples_of(t, y).with_input(places, values, errors)
    joint = np.block(
        [[yy, uy[places].T], [uy[places], uu[np.ix_(places, places)] + np.diag(errors**2)]]
    )
    cross = np.concatenate([uy, uu[:, places]], axis=1)
    weights = np.linalg.solve(joint, cross.T)
    mean, variance = held.smooth(model)
    np.testing.assert_allclose(mean, weights.T @ np.concatenate([y, values]), atol=1e-6)
    np.testing.assert_allclose(variance, np.diag(uu - cross @ weights), atol=1e-6)


@pytest.mark.slow
def test_covariances_that_settle_change_no_result() -> None:
    """On a regular record only means are carried on after a while; statsmodels never does so."""
    from statsmodels.tsa.statespace.kalman_smoother import KalmanSmoother

    rng = np.random.default_rng(5)
    n = 3000
    y = np.cumsum(rng.standard_normal(n)) / 30.0
    y[1000:1010] = np.nan
    model = Model(2, 1.3, 40.0, (30.0, 7.0), 0.1, 0.6)
    samples = samples_of(np.arange(n) * 0.5, y)
    drift, diffusion, stationary = model.matrices()
    phi, q = discretise(drift, diffusion, np.array([0.5]))
    m = len(drift)
    other = KalmanSmoother(k_endog=1, k_states=m + 1, k_posdef=m + 1)
    other.bind(y[:, None])
    other["design"] = np.r_[np.zeros(m - 1), 1.0, model.sigma][None]
    other["transition"] = np.block([[phi[0], np.zeros((m, 1))], [np.zeros((1, m)), 0.6]])
    other["selection"] = np.eye(m + 1)
    other["state_cov"] = np.block([[q[0], np.zeros((m, 1))], [np.zeros((1, m)), 1.0 - 0.6**2]])
    start = np.zeros((m + 1, m + 1))
    start[:m, :m] = stationary + np.diag([0.0] * model.order + [1.0] * (m - model.order))
    start[m, m] = 1.0
    other.initialize_known(np.zeros(m + 1), start)
    found = other.smooth()
    # settled covariances differ by 1e-12 of a correlation from one sample to the next
    assert samples.log_likelihood(model) == pytest.approx(found.llf, abs=1e-5)
    mean, variance = samples.smooth(model)
    np.testing.assert_allclose(mean, found.smoothed_state[0], atol=1e-7)
    np.testing.assert_allclose(variance, found.smoothed_state_cov[0, 0], atol=1e-7)


def test_discretisation_keeps_its_accuracy_for_short_and_for_stiff_steps() -> None:
    model = Model(2, 1.0, 3.0, (2.0, 1e-4), 0.1, 0.0)
    drift, diffusion, stationary = model.matrices()
    steps = np.array([1e-5, 0.1, 7.0, 1e4])
    phi, q = discretise(drift, diffusion, steps)
    for i, h in enumerate(steps):
        np.testing.assert_allclose(phi[i], expm(drift * h), atol=1e-11)
        # the stationary covariance stays: P = Phi P Phi' + Q; 27 doublings lose 4 digits
        np.testing.assert_allclose(phi[i] @ stationary @ phi[i].T + q[i], stationary, atol=1e-11)
    assert np.linalg.eigvalsh(q[0]).min() > -1e-25  # differences of large numbers would be 1e-17
    np.testing.assert_allclose(solve_discrete_lyapunov(phi[1], q[1]), stationary, atol=1e-10)


def test_steps_made_of_two_parts_are_those_made_at_once() -> None:
    """Times without a common step have thousands of distinct ones."""
    rng = np.random.default_rng(8)
    steps = np.concatenate([1 + rng.integers(0, 9000, 4000), [10**6, 3 * 10**8]])
    t = np.concatenate([[0.0], np.cumsum(steps * 1e-3)])
    samples = samples_of(t, rng.standard_normal(len(t)))
    assert len(samples.counts) > 2000
    for order, lags in CHAINS:
        drift, diffusion, _ = Model(order, 1.3, 4.0, lags, 0.1, 0.0).matrices()
        phi, q = samples.over_steps(drift, diffusion)
        one, spread = discretise(drift, diffusion, samples.steps)
        np.testing.assert_allclose(phi, one, atol=1e-13)
        np.testing.assert_allclose(q, spread, rtol=1e-9, atol=1e-14)


def test_the_input_is_a_matern_process() -> None:
    for order, kernel in (
        (1, lambda r: np.exp(-r)),
        (2, lambda r: (1.0 + np.sqrt(3.0) * r) * np.exp(-np.sqrt(3.0) * r)),
    ):
        model = Model(order, 1.7, 4.0, (1.0,), 0.1, 0.0)
        drift, _, stationary = model.matrices()
        for step in (0.0, 1.0, 10.0):
            assert (expm(drift * step) @ stationary)[0, 0] == pytest.approx(
                1.7**2 * kernel(step / 4.0)
            )
        frequencies = np.linspace(0.0, 40.0, 400_001)
        for spectrum, variance in (
            (model.input_spectrum(frequencies), 1.7**2),
            (
                model.input_spectrum(frequencies) * model.gain_squared(frequencies),
                stationary[-1, -1],
            ),
        ):
            # what lies above 40 Hz is 2e-3 of a random walk's variance
            assert np.trapezoid(spectrum, frequencies) == pytest.approx(variance, rel=3e-3)
    noise = Model(1, 1.0, 1.0, (1.0,), 0.3, 0.8)
    frequencies = np.linspace(0.0, 0.5 / 0.2, 20_001)
    area = np.trapezoid(noise.noise_spectrum(frequencies, 0.2), frequencies)
    assert area == pytest.approx(0.3**2, rel=1e-6)
