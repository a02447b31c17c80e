"""R-hat, effective sample size and k-hat where the answer is known (ArviZ: test_arviz_compat)."""

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
