"""The noise law: its weights, its powers across intervals, its simulated moments."""

import numpy as np
import pytest

from bayes_sensor.campaign import CampaignError
from bayes_sensor.likelihood.noise import (
    Noise,
    check_phi,
    lag_coefficient,
    scale_slopes,
    scale_squared,
    simulate_noise,
)
from tests.support.campaigns import small_design


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


def test_levels_are_those_at_the_baseline_and_at_the_highest_concentration() -> None:
    campaign, law = small_design(n=3), Noise("levels")
    weights = [law.weight(campaign, e) for e in campaign]
    assert weights == [Noise("concentration").weight(campaign, e) for e in campaign]
    assert max(weights) == 1.0 and law.fading == 1.0 and Noise().fading == 0.0
    x = np.array([-0.1, 0.0, 0.5, 1.0, 1.2])
    for sigma0, sigma1 in ((2.0, 3.0), (3.0, 0.5)):
        a, b = sigma0**2, sigma1**2
        ends = scale_squared(x, sigma0, sigma1, 1.0, law.fading)
        np.testing.assert_allclose(ends, [a, a, 0.5 * (a + b), b, b])
        half = scale_squared(x, sigma0, sigma1, 0.5, law.fading)
        np.testing.assert_allclose(half[:4], [a, a, 0.75 * a + 0.25 * b, 0.5 * (a + b)])


@pytest.mark.parametrize("noise", [Noise(), Noise("levels")], ids=str)
@pytest.mark.parametrize("weight", [0.4, 1.0])
def test_slopes_of_the_variance_match_differences(noise: Noise, weight: float) -> None:
    x = np.array([-0.2, 0.1, 0.6, 0.9, 1.3])
    at, step = (x, 0.3, 0.2), 1e-6
    slopes = scale_slopes(*at, weight, noise.fading)
    for i, slope in enumerate(slopes):
        up, down = ([v + sign * step * (i == j) for j, v in enumerate(at)] for sign in (1, -1))
        difference = scale_squared(*up, weight, noise.fading)
        difference = difference - scale_squared(*down, weight, noise.fading)
        np.testing.assert_allclose(slope, difference / (2 * step), atol=1e-9)


def test_a_level_moves_with_the_concentration_it_refers_to() -> None:
    law = Noise("levels")
    for sigma0, sigma1, times in ((0.3, 0.5, 0.4), (0.5, 0.3, 0.4), (0.3, 0.5, 2.0)):
        moved = law.referred(sigma0, sigma1, times)
        expected = scale_squared(np.array([0.2]), sigma0, sigma1, 1.0, 1.0)
        found = scale_squared(np.array([0.2 / times]), sigma0, moved, 1.0, 1.0)
        np.testing.assert_allclose(found, expected)
        step = 1e-6
        slopes = law.referred_slopes(sigma0, sigma1, times)
        for i, slope in enumerate(slopes):
            move = step * np.eye(2)[i]
            up = law.referred(sigma0 + move[0], sigma1 + move[1], times)
            down = law.referred(sigma0 - move[0], sigma1 - move[1], times)
            assert slope == pytest.approx((up - down) / (2 * step), rel=1e-6)
    # noise that falls is not taken to fall on to nothing
    assert law.referred(0.5, 0.3, 2.0) == pytest.approx(0.3)


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
