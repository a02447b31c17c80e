"""Noise laws of the independent simulator: what is drawn against what is said of it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.integrate import quad

from bayes_sensor.blind_check.simulator import (
    CAUSES,
    HEAVY_TAILED,
    OPEN_LAWS,
    RESERVE_LAWS,
    Component,
    NoiseLaw,
    autocorrelation,
    draw_case,
    draw_law,
    draw_noise,
    make_campaign,
    noise_scale,
    prepared_rigs,
    sample_times,
    tail_mixture,
)
from bayes_sensor.campaign import CampaignError, FloatArray

LAWS = (*OPEN_LAWS, *RESERVE_LAWS)
INTERVAL = 1e-3

# one of each shape, quick enough that a stretch of 20 s holds many of its times
SHAPES = {
    "white": Component(1.0),
    "near": Component(1.0, 5e-3),
    "turning": Component(1.0, 0.03, 20.0),
    "smooth": Component(1.0, 8e-3, shape="smooth"),
    "telegraph": Component(1.0, 0.02, shape="telegraph"),
    "shot": Component(1.0, 6e-3, shape="shot", rate=0.5),
    "gusts": Component(1.0, 8e-3, shape="gusts", depth=0.9, gust_time=0.05),
    "drilled": Component(1.0, 5e-3, shape="drilled", rate=0.3, depth=0.8),
    "turbulent": Component(1.0, 0.02, shape="turbulent"),
    "settling": Component(1.0, 0.02, shape="settling", depth=0.9),
    "counts": Component(1.0, shape="counts", rate=0.7),
    "retuned": Component(1.0, 0.03, shape="retuned", depth=0.1),
    "calming": Component(1.0, 5e-3, shape="calming", depth=0.8, rate=8.0),
    "speckle": Component(1.0, 8e-3, shape="speckle"),
    "shaped": Component(1.0, shape="shaped", depth=0.6),
}


def stretches(law: NoiseLaw, n_stretches: int = 60, n: int = 20_000) -> FloatArray:
    """(n_stretches, n) drawn one after the other."""
    rng = np.random.default_rng(3)
    return np.array([draw_noise(law, n, INTERVAL, rng) for _ in range(n_stretches)])


def law_of(*parts: Component) -> NoiseLaw:
    return NoiseLaw("own", 1.0, 0.0, parts)


def moments(z: FloatArray, lags: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Products (n_lags,) of samples ``lags`` apart, in the mean, and their standard errors."""
    n = z.shape[1]
    products = np.array([np.mean(z[:, : n - lag] * z[:, lag:], axis=1) for lag in lags])
    return products.mean(axis=1), products.std(axis=1, ddof=1) / np.sqrt(len(z))


def test_there_are_nineteen_laws_and_some_are_kept_back() -> None:
    assert len(set(LAWS)) == len(LAWS) == 19
    assert len(RESERVE_LAWS) == 4 and set(HEAVY_TAILED) < set(LAWS)
    ar1 = {law for law in LAWS if draw_law(law, np.random.default_rng(1), 0.1).is_ar1}
    assert ar1 == {"white", "ar1"}
    with pytest.raises(CampaignError, match="noise law: expected one of white, ar1, .* 'loud'"):
        draw_law("loud", np.random.default_rng(1), 0.1)


@pytest.mark.parametrize("shape", SHAPES)
def test_each_shape_has_the_variance_and_correlation_that_are_said(shape: str) -> None:
    law = law_of(SHAPES[shape])
    z = stretches(law)
    lags = np.array([0, 1, 2, 5, 12, 30, 80])
    found, error = moments(z, lags)
    expected = autocorrelation(law, 81, INTERVAL)[lags]
    assert expected[0] == pytest.approx(1.0)
    # five standard errors, of seven lags of fifteen shapes; a per mille for the finite stretch
    assert np.all(np.abs(found - expected) < 5.0 * error + 1e-3)
    assert np.abs(z.mean()) < 5.0 * z.mean(axis=1).std() / np.sqrt(len(z)) + 1e-3


def test_a_wrong_correlation_would_be_noticed() -> None:
    found, error = moments(stretches(law_of(SHAPES["near"])), np.array([5]))
    wrong = autocorrelation(law_of(replace(SHAPES["near"], time=6e-3)), 6, INTERVAL)[5]
    assert abs(found[0] - wrong) > 5.0 * error[0] + 1e-3


@pytest.mark.parametrize("name", LAWS)
def test_laws_add_up_and_begin_stationary(name: str) -> None:
    law = draw_law(name, np.random.default_rng(7), 0.2)
    assert sum(part.share for part in law.components) == pytest.approx(1.0)
    assert all(part.share > 0 for part in law.components)
    assert np.hypot(law.sigma0, law.sigma1) == pytest.approx(0.2)
    R = autocorrelation(law, 500, INTERVAL)
    assert R[0] == pytest.approx(1.0) and np.all(np.abs(R) <= 1.0 + 1e-12)
    # first and last samples of many short stretches vary alike
    rng = np.random.default_rng(8)
    z = np.array([draw_noise(law, 60, INTERVAL, rng) for _ in range(4000)])
    first, last = np.mean(z[:, :5] ** 2), np.mean(z[:, -5:] ** 2)
    if name == "waking_laser":  # which is loud when a record begins
        assert first > 1.5 and last < 0.9 and np.mean(z**2) == pytest.approx(1.0, rel=0.1)
        return
    assert first == pytest.approx(1.0, abs=0.25) and last == pytest.approx(first, abs=0.3)


def test_what_is_drawn_after_a_law_does_not_depend_on_it() -> None:
    rigs = [draw_case(5, law=law, size="small") for law in LAWS]
    assert len({rig.lsb for rig in rigs}) == 1
    assert len({rig.noise.sigma0 for rig in rigs}) == 1


def test_one_over_f_is_flat_in_octaves() -> None:
    law = draw_law("pink", np.random.default_rng(2), 1.0)
    slow = law_of(*(replace(part, share=1.0 / 14.0) for part in law.components[1:]))
    frequency = np.array([0.05, 0.2, 0.8])  # Hz, well inside the band

    def spectrum(f: float) -> float:
        return float(sum(p.share * p.time / (1 + (2 * np.pi * f * p.time) ** 2)
                         for p in slow.components))  # fmt: skip

    product = [f * spectrum(f) for f in frequency]
    assert max(product) / min(product) < 1.1


def test_turbulence_falls_as_five_thirds() -> None:
    time = 0.05
    # the spectrum of the said correlation, by quadrature, far beyond the corner
    R = autocorrelation(law_of(Component(1.0, time, shape="turbulent")), 40_000, 2e-5)
    lags = np.arange(40_000) * 2e-5

    def power(f: float) -> float:
        value, _ = quad(lambda s: np.interp(s, lags, R), 0.0, 0.79, weight="cos",
                        wvar=2 * np.pi * f, limit=400)  # fmt: skip
        return float(value)

    slope = np.log(power(160.0) / power(40.0)) / np.log(4.0)
    assert slope == pytest.approx(-5.0 / 3.0, abs=0.05)


def test_long_memory_lasts_longer_than_any_exponential() -> None:
    law = law_of(SHAPES["settling"])
    R = autocorrelation(law, 20_000, INTERVAL)
    assert R[19_999] / R[9_999] == pytest.approx(2.0**-0.9, rel=1e-2)


@pytest.mark.parametrize("name", LAWS)
def test_heavy_tails_are_where_they_are_said_to_be(name: str) -> None:
    # of the innovations: what a first-order prediction leaves over
    excess = []
    for seed in range(4):
        law = draw_law(name, np.random.default_rng(seed), 1.0)
        r = autocorrelation(law, 2, INTERVAL)[1]
        z = stretches(law, 8)
        left = (z[:, 1:] - r * z[:, :-1]).ravel()
        excess.append(np.mean(left**4) / np.mean(left**2) ** 2 - 3.0)
    if name in HEAVY_TAILED:
        assert np.mean(excess) > 0.3
    elif name == "retuned_filter":  # whose innovations are larger in some records than in others
        assert np.mean(excess) > -0.05
    else:
        assert np.abs(np.mean(excess)) < 0.1


def test_levels_counts_and_stretches_are_what_their_names_say() -> None:
    telegraph, counts = (stretches(law_of(SHAPES[k]), 1)[0] for k in ("telegraph", "counts"))
    assert set(np.unique(telegraph)) == {-1.0, 1.0}
    whole = counts * np.sqrt(0.7) + 0.7
    assert np.allclose(whole, np.rint(whole)) and whole.min() > -1e-9
    drilled = stretches(law_of(replace(SHAPES["drilled"], time=1e-5)), 40)
    loud = np.mean(drilled.reshape(40, 20, 1000) ** 2, axis=2)
    calm = np.sort(loud, axis=1)[:, :10].mean()
    assert calm == pytest.approx(0.2, rel=0.05)
    assert loud.max(axis=1).mean() == pytest.approx(0.2 + 0.8 / 0.3, rel=0.1)
    calming = stretches(law_of(replace(SHAPES["calming"], time=1e-5)), 40)
    loud = np.mean(calming.reshape(40, 20, 1000) ** 2, axis=(0, 2))
    expected = 0.2 + 0.8 * np.exp(-8.0 * (np.arange(20) + 0.5) / 20)
    assert np.allclose(loud, expected / expected.mean(), rtol=0.08)
    retuned = stretches(law_of(SHAPES["retuned"]), 40)
    times = -INTERVAL / np.log(np.mean(retuned[:, 1:] * retuned[:, :-1], axis=1)
                               / np.mean(retuned**2, axis=1))  # fmt: skip
    assert times.min() < 8e-3 and times.max() > 0.018 and times.max() < 0.04


def test_wild_samples_make_the_tails_heavy_and_leave_the_variance() -> None:
    law = NoiseLaw("own", 1.0, 0.0, (Component(1.0, 5e-3),))
    z = draw_noise(law, 400_000, INTERVAL, np.random.default_rng(1), (0.01, 6.0))
    assert np.var(z) == pytest.approx(1.0, rel=0.05)
    e = z[1:] - np.exp(-0.2) * z[:-1]
    plain = 1.0 - 0.01 + 0.01 * 36.0
    kurtosis = 3.0 * (0.99 + 0.01 * 6.0**4) / plain**2
    assert np.mean(e**4) / np.mean(e**2) ** 2 == pytest.approx(kurtosis, rel=0.15)
    rig = draw_case(3, {"wild_samples": 5.0}, size="small")
    share, times = tail_mixture(rig)
    assert 0.003 <= share <= 0.03 and times == 6.0
    assert tail_mixture(replace(rig, strengths={})) == (0.0, 1.0)


def test_noise_grows_with_the_response_and_is_rounded_by_the_recorder() -> None:
    rig = draw_case(5, law="white", size="paper")
    rig = replace(rig, noise=NoiseLaw("white", 0.02, 0.06), lsb=0.0)
    highest = max(rig.steps, key=lambda step: step.concentration)
    assert noise_scale(rig, highest, np.array([-0.1, 0.0, 1.0])) == pytest.approx(
        [0.02, 0.02, np.hypot(0.02, 0.06)]
    )
    experiments = make_campaign(rig)
    for prepared, e in zip(prepared_rigs(rig), experiments, strict=True):
        y, x = prepared.voltage(sample_times(prepared.step))
        z = (e.values - y) / noise_scale(rig, prepared.step, x)
        for part in (z[x < 0.01], z[x > 0.99]):
            assert np.std(part) == pytest.approx(1.0, rel=0.03)
    coarse = replace(rig, strengths={"coarse_range": CAUSES["coarse_range"].highest})
    values = make_campaign(coarse)["1"].values / (3.0 * 0.02)
    assert np.allclose(values, np.rint(values), atol=1e-9)
