"""The noise law: its weights, its powers across intervals, its simulated moments."""

import numpy as np
import pytest
from campaigns import small_design

from bayes_sensor.campaign import CampaignError
from bayes_sensor.noise import (
    Noise,
    check_phi,
    lag_coefficient,
    scale_squared,
    simulate_noise,
)


def test_the_variance_grows_with_concentration_as_asked() -> None:
    campaign = small_design(n=3)
    fractions = [e.test_gas_flow / (e.test_gas_flow + e.carrier_flow) for e in campaign]
    assert campaign.reference_concentration == pytest.approx(max(fractions))
    for e, fraction in zip(campaign, fractions):
        weight = Noise("concentration").weight(campaign, e)
        assert weight == pytest.approx(fraction / max(fractions))
        assert Noise("signal").weight(campaign, e) == 1.0
        assert Noise("constant").weight(campaign, e) == 0.0
    x = np.array([-0.1, 0.0, 0.5, 1.0])
    np.testing.assert_allclose(scale_squared(x, 2.0, 3.0, 0.5), [4.0, 4.0, 6.25, 8.5])


def test_options_pin_parameters_and_unknown_ones_are_refused() -> None:
    assert Noise("signal", "white").fixed == {"phi": 0.0}
    assert Noise("constant", "ar1").fixed == {"sigma1_V": 0.0}
    assert Noise().fixed == {}
    with pytest.raises(CampaignError, match="noise variance must be one of .* but is 'linear'"):
        Noise("linear")
    with pytest.raises(CampaignError, match="noise autocorrelation must be one of .*'arma'"):
        Noise("signal", "arma")


def test_phi_across_intervals() -> None:
    assert lag_coefficient(0.64, 0.5) == pytest.approx(0.8)
    assert lag_coefficient(0.5, 3) == 0.125
    assert lag_coefficient(-0.5, 3) == -0.125
    assert lag_coefficient(-0.5, 2.0 + 1e-12) == 0.25  # rounding of the ratio does not matter
    assert np.isnan(lag_coefficient(-0.5, 0.5))  # there is no such AR(1)
    assert lag_coefficient(0.0, 1) == 0.0


@pytest.mark.parametrize("phi", [-0.6, 0.0, 0.5, 0.95])
def test_simulated_noise_has_the_stated_moments_from_its_first_sample(phi: float) -> None:
    rng = np.random.default_rng(7)
    n = 20000
    scale = np.linspace(0.5, 2.0, 12)
    z = np.array([simulate_noise(scale, phi, rng) for _ in range(n)]) / scale
    # a mean of n squares or products of unit normals has standard error sqrt(2/n) at most
    tolerance = 5 * np.sqrt(2 / n)
    for lag in range(4):
        products = z[:, lag:] * z[:, : 12 - lag]
        np.testing.assert_allclose(products.mean(axis=0), phi**lag, atol=tolerance)
    assert simulate_noise(scale, phi, rng, burn_in=100).shape == (12,)


def test_a_phi_that_noise_cannot_have_is_refused() -> None:
    check_phi(-0.5, 2.0, "a")
    for phi in (1.0, -1.2, np.nan):
        with pytest.raises(CampaignError, match="theta: phi is .*; expected a value above -1"):
            check_phi(phi, 1.0, "a")
    with pytest.raises(CampaignError, match="experiment 'a': phi is -0.5, .* 1.5 reference"):
        check_phi(-0.5, 1.5, "a")
