"""Restored inputs of simulated records: right, calibrated, and the same in any unit."""

import numpy as np
import pytest
from scipy.integrate import quad
from scipy.signal import lfilter

import bayes_sensor as bs
from bayes_sensor.campaign import CampaignError
from bayes_sensor.restoration.hyperparameters import InputPosterior, fit_orders
from bayes_sensor.restoration.state_space import Model, make_samples


def record(
    rng: np.random.Generator, n: int = 400, lag: float = 20.0, noise: float = 0.02, phi: float = 0.5
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Times, input (Matern 3/2 over two lags) and record (n,), a sample a second."""
    fine = 10
    a = np.exp(-np.sqrt(3.0) / (2.0 * lag * fine))
    u = lfilter([1.0], [1.0, -2.0 * a, a * a], rng.standard_normal((n + 400) * fine))
    u = (u / u.std())[400 * fine :]
    b = np.exp(-1.0 / (lag * fine))
    x = lfilter([1.0 - b], [1.0, -b], u, zi=[b * u[0]])[0]
    e = lfilter([1.0], [1.0, -phi], rng.standard_normal(n + 100))[100:]
    return np.arange(n) * 1.0, u[::fine], x[::fine] + noise * np.sqrt(1.0 - phi**2) * e


def inside(found: bs.Restored, u: np.ndarray) -> float:
    """Share of times at which the 95 % band holds the input."""
    return float(np.mean((found.quantile(0.025) < u) & (u < found.quantile(0.975))))


@pytest.mark.slow
def test_bands_hold_the_input_as_often_as_they_say_where_the_lag_is_uncertain() -> None:
    rng = np.random.default_rng(10)
    shares, blind = [], []
    for _ in range(12):
        t, u, y = record(rng, lag=20.0 * np.exp(0.2 * rng.standard_normal()))
        shares.append(inside(bs.restore("20 +- 4 s", (t, y)), u))
        blind.append(inside(bs.restore("20 s", (t, y)), u))
    # the share of one record has a spread of 0.06 (its times are correlated): 0.02 for twelve
    assert 0.90 < np.mean(shares) < 0.99
    assert np.mean(blind) < np.mean(shares) - 0.04  # a band that takes the lag as known


def test_the_same_in_any_unit_on_any_clock_and_with_any_jobs() -> None:
    t, u, y = record(np.random.default_rng(11))
    y[100:150] = np.nan
    usual = bs.restore("20 +- 2 s", (t, y))
    other = bs.restore("20 +- 2 s", (t + 1e6, 3.0 - 1e9 * y), jobs=3)
    np.testing.assert_allclose((3.0 - other.value) / 1e9, usual.value, atol=1e-5)
    np.testing.assert_allclose(other.sd / 1e9, usual.sd, rtol=1e-4)
    assert other.resolution_s == pytest.approx(usual.resolution_s, rel=1e-4)
    again = bs.restore("20 +- 2 s", (t, y), jobs=2)
    np.testing.assert_array_equal(again.table().to_numpy(), usual.table().to_numpy())
    # in the gap the band is wider, and it still holds the input
    assert usual.sd[110:140].mean() > 2.0 * np.median(usual.sd)
    assert (np.abs(usual.mean - u) < 4.0 * usual.sd).all()


def test_fewer_samples_at_irregular_times_restore_the_same_input() -> None:
    rng = np.random.default_rng(12)
    t, u, y = record(rng, n=1000, noise=0.005)
    kept = np.sort(rng.choice(1000, 500, replace=False))
    found = bs.restore("20 +- 0.2 s", (t[kept], y[kept]))
    assert np.sqrt(np.mean((found.value - u[kept]) ** 2)) < 0.1  # the input has an sd of 1
    assert 0.85 < inside(found, u[kept]) <= 1.0


def test_non_negative_inputs() -> None:
    t = np.arange(400.0)
    u = np.where((t > 100) & (t < 150), 1.0, 0.0) + np.where((t > 250) & (t < 260), 2.0, 0.0)
    b = np.exp(-1.0 / 15.0)
    y = lfilter([1.0 - b], [1.0, -b], u) + 0.02 * np.random.default_rng(13).standard_normal(400)
    free = bs.restore("15 +- 0.5 s", (t, y))
    held = bs.restore("15 +- 0.5 s", (t, y), nonnegative=True)
    assert (free.quantile(0.025) < -0.02).any()
    assert (held.quantile(0.025) >= 0.0).all() and (held.value >= 0.0).all()
    quiet = u == 0.0
    assert held.sd[quiet].mean() < 0.9 * free.sd[quiet].mean()
    assert held.warnings == free.warnings
    wrong = bs.restore("15 +- 0.5 s", (t, y - 1.0), nonnegative=True)
    assert "contradicts an input that is not negative" in wrong.warnings[0]
    error = [np.sqrt(np.mean((each.value - u) ** 2)) for each in (held, free)]
    assert error[0] < error[1]


def test_a_record_shorter_than_its_lag_is_doubted() -> None:
    t, _, y = record(np.random.default_rng(18), n=100)
    found = bs.restore("20 +- 1 min", (t, y))
    assert "less than the longest lag" in found.warnings[0]


def test_resolution_is_where_the_spectra_cross() -> None:
    rng = np.random.default_rng(14)
    fine = [
        bs.restore("20 +- 0.2 s", record(rng, noise=noise)[::2]).resolution_s
        for noise in (0.002, 0.05)
    ]
    assert fine[0] is not None and fine[1] is not None and fine[0] < 0.7 * fine[1]
    pure = bs.restore("20 +- 0.2 s", (np.arange(300.0), rng.standard_normal(300)))
    assert pure.resolution_s is None or pure.resolution_s > 30.0


def test_noise_that_grows_with_the_signal_is_seen() -> None:
    rng = np.random.default_rng(15)
    t, _, y = record(rng, n=1500, noise=0.0)
    level = (y - y.min()) / np.ptp(y)
    noisy = y + 0.005 * np.sqrt(1.0 + (6.0 * level) ** 2) * rng.standard_normal(1500)
    found = bs.restore("20 +- 0.2 s", (t, noisy)).to_json()["noise"]
    assert found["sigma"]["q50"] == pytest.approx(0.005, rel=0.4)
    assert found["sigma_at_highest"]["q50"] == pytest.approx(0.005 * np.sqrt(37.0), rel=0.3)
    flat = y + 0.01 * rng.standard_normal(1500)
    same = bs.restore("20 +- 0.2 s", (t, flat)).to_json()["noise"]
    assert same["sigma"]["q50"] == pytest.approx(0.01, rel=0.1)
    assert same["sigma_at_highest"]["q50"] < 1.4 * same["sigma"]["q50"]


def test_innovations_tell_a_record_that_is_not_as_the_model_says() -> None:
    rng = np.random.default_rng(16)
    t, _, y = record(rng, n=1000)
    good = bs.restore("20 +- 0.2 s", (t, y))
    assert good.innovations.p_value > 1e-3 and good.warnings == []
    hum = y + 0.05 * np.sin(2.0 * np.pi * t / 5.0)
    bad = bs.restore("20 +- 0.2 s", (t, hum))
    assert bad.innovations.p_value < 1e-10 and "correlated" in bad.warnings[0]
    y[400] += 1.0
    spike = bs.restore("20 +- 0.2 s", (t, y))
    assert spike.innovations.largest_at == 400.0 and spike.innovations.largest_p_value < 1e-6
    assert any("at 400 s" in text for text in spike.warnings)


def test_the_gaussian_about_the_maximum_is_that_of_the_likelihood() -> None:
    """Evidence and spread of sigma, against integration over sigma alone."""
    t, _, y = record(np.random.default_rng(17), n=300, phi=0.0)
    samples, _, _ = make_samples(t, y, 20.0)
    lags = np.array([20.0])
    (best, *_) = fit_orders(samples, lags, lambda fraction, text: None)
    peak, target = best.peak, InputPosterior(samples, best.order, lags)
    top = target.log_posterior(peak)
    conditional = 1.0 / np.linalg.inv(best.cov)[2, 2]  # variance of log sigma, all others held

    def density(x: float) -> float:
        moved = peak.copy()
        moved[2] += x
        return float(np.exp(target.log_posterior(moved) - top))

    area = quad(density, -0.5, 0.5)[0]
    assert area == pytest.approx(np.sqrt(2.0 * np.pi * conditional), rel=0.05)
    # at another lag the maximum is where the moved one is said to be
    moved = target.maximum([peak])[0]
    np.testing.assert_allclose(moved, peak, atol=0.1)
    (other, *_) = [
        each
        for each in fit_orders(samples, 1.1 * lags, lambda fraction, text: None)
        if each.order == best.order
    ]
    step = best.at(1.1 * lags) - peak
    sd = np.sqrt(np.diag(best.cov))
    assert np.abs((other.peak - peak - step) / sd).max() < 0.3
    assert isinstance(best.model(lags), Model)


@pytest.mark.parametrize(
    ("lags", "made", "words"),
    [
        ("20 s", (np.arange(5.0), np.arange(5.0)), "at least 20 samples"),
        ("20 s", (np.arange(50.0), np.ones(50)), "every sample is 1"),
        ("20 ms", (np.arange(50.0), np.arange(50.0)), "shorter than half the sampling interval"),
        ("20 s", (np.zeros(50), np.arange(50.0)), "times .* that increase"),
        (7.0, (np.arange(50.0), np.arange(50.0)), "expected a text"),
    ],
)
def test_what_cannot_be_restored_is_refused(lags: object, made: object, words: str) -> None:
    with pytest.raises(CampaignError, match=words):
        bs.restore(lags, made)
