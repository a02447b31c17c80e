"""R-hat, effective sample size and k-hat where the answer is known (ArviZ: test_arviz_compat)."""

from math import floor, sqrt

import numpy as np
import pytest

from bayes_sensor.posterior.r_hat import diagnostics, pareto_k


def test_independent_draws_and_stuck_chains() -> None:
    rng = np.random.default_rng(5)
    good = rng.standard_normal((4, 1000, 2))
    r_hat, bulk, tail = diagnostics(good)
    assert (r_hat < 1.005).all() and (bulk > 3200).all() and (tail > 3000).all()
    apart = good + np.array([0.0, 0.0, 0.0, 1.0])[:, None, None]
    r_hat, bulk, _ = diagnostics(apart)
    assert (r_hat > 1.05).all() and (bulk < 100).all()


@pytest.mark.parametrize("rho", [-0.5, 0.0, 0.5, 0.8])
def test_an_ar1_chain_has_the_sample_size_of_its_closed_form(rho: float) -> None:
    rng = np.random.default_rng(5)
    draws = rng.standard_normal((4, 4000, 2))
    for i in range(1, 4000):
        draws[:, i] = rho * draws[:, i - 1] + np.sqrt(1 - rho**2) * draws[:, i]
    _, bulk, _ = diagnostics(draws)
    # n (1 - rho)/(1 + rho); the estimate itself scatters by about a tenth
    np.testing.assert_allclose(bulk, 16000 * (1 - rho) / (1 + rho), rtol=0.3)


def test_a_constant_parameter() -> None:
    r_hat, bulk, tail = diagnostics(np.ones((2, 100, 1)))
    assert np.isnan(r_hat).all() and bulk[0] == tail[0] == 200


@pytest.mark.parametrize("k", [0.2, 0.5, 0.8])
def test_pareto_k_is_recovered(k: float) -> None:
    rng = np.random.default_rng(6)
    # weights with a generalised Pareto tail; the estimate's error is about (1 + k)/sqrt(3 sqrt(n))
    weights = (rng.random(40000) ** -k - 1) / k + 1
    assert pareto_k(np.log(weights)) == pytest.approx(k, abs=0.15)


def test_pareto_k_of_hopeless_and_of_equal_weights() -> None:
    assert pareto_k(np.zeros(50)) == np.inf
    assert pareto_k(np.full(500, -np.inf)) == np.inf
    assert pareto_k(np.zeros(500)) == -np.inf
    # eight weights of 408 count: had been nan, which is not above any limit
    assert pareto_k(np.r_[np.linspace(-744, -730, 400), np.linspace(-10, 0, 8)]) == np.inf


def test_chains_that_differ_in_spread_alone_are_seen() -> None:
    draws = np.random.default_rng(2).standard_normal((4, 1000, 1)) + 7.0
    draws[2:] = 7.0 + 3.0 * (draws[2:] - 7.0)
    r_hat, _, _ = diagnostics(draws)
    assert r_hat[0] > 1.1


def test_the_tail_of_nearly_equal_weights_is_judged_like_any_other() -> None:
    # excesses of an exponential law have k = 0 in any unit; sd of the estimate about 0.07
    x = np.random.default_rng(8).exponential(size=20_000)
    assert pareto_k(np.log1p(1e-4 * x)) == pytest.approx(pareto_k(np.log1p(1e4 * x)), abs=1e-3)
    assert pareto_k(np.log1p(1e-4 * x)) == pytest.approx(0.0, abs=0.2)


def published_shape(excess: np.ndarray) -> float:
    """Shape of the generalised Pareto law by Zhang and Stephens (2009), step by step."""
    x = np.sort(excess)
    n = len(x)
    m = 30 + floor(sqrt(n))
    quartile = x[floor(n / 4 + 0.5) - 1]
    thetas, logs = [], []
    for j in range(1, m + 1):
        theta = 1.0 / x[-1] + (1.0 - sqrt(m / (j - 0.5))) / (3.0 * quartile)
        k = -np.mean(np.log(1.0 - theta * x))
        thetas.append(theta)
        logs.append(n * (np.log(theta / k) + k - 1.0))
    weights = [1.0 / sum(np.exp(other - own) for other in logs) for own in logs]
    best = sum(w * theta for w, theta in zip(weights, thetas))
    return float(np.mean(np.log(1.0 - best * x)))


@pytest.mark.parametrize("power", [0.2, 0.5, 0.9])
def test_the_tail_of_weights_has_the_shape_of_the_published_estimate(power: float) -> None:
    log_weights = power * np.random.default_rng(3).exponential(size=1000)
    weights = np.sort(np.exp(log_weights - log_weights.max()))
    n = 95  # ceil(3 sqrt(1000)) of the largest
    expected = published_shape(weights[-n:] - weights[-n - 1])
    # drawn to one half with the weight of ten observations
    assert pareto_k(log_weights) == pytest.approx((n * expected + 5.0) / (n + 10.0), rel=1e-9)
    assert pareto_k(log_weights) == pytest.approx(power, abs=0.3)
