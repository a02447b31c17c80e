"""Fit, posterior and bounds of other rigs find the truth, and one independent fit."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from scipy.optimize import least_squares

import bayes_sensor as bs
from bayes_sensor.bounds import compare_bounds
from bayes_sensor.fit import Fit, fit_least_squares
from bayes_sensor.likelihood.problem import Problem
from bayes_sensor.posterior import sample_posterior
from tests.support.other_rigs import CASES, Case

QUICK = ("sensor", "cell and sensor", "two sensors")
"""rigs whose posterior the suite samples; the study of calibration has all"""


@pytest.fixture(scope="module")
def fitted() -> dict[str, tuple[Case, Any, Fit]]:
    found = {}
    for name, make in CASES.items():
        case = make()
        data = case.simulated(seed=5)
        found[name] = case, data, fit_least_squares(data, seed=1, swarms=2)
    return found


@pytest.mark.parametrize("name", CASES)
def test_the_truth_is_found(name: str, fitted: dict[str, Any]) -> None:
    case, _, fit = fitted[name]
    assert fit.converged, fit.status
    assert fit.order == "given" or name in ("cell and sensor",), fit.order
    for parameter, true in case.shared.items():
        if parameter in ("tau_v_s", "tau_probe_s") and name == "four stages":
            continue  # two lags without names
        assert fit.parameters[parameter] == pytest.approx(true, rel=0.15, abs=0.1), parameter
    # residuals are as large as the noise
    assert fit.rms == pytest.approx(np.hypot(case.sigma0, 0.6 * case.sigma1), rel=0.3)


def test_one_lag_agrees_with_a_fit_by_hand(fitted: dict[str, Any]) -> None:
    _, data, fit = fitted["sensor"]
    t, parts = data["1"].t, [data["1"].values, data["2"].values]

    def residuals(p: np.ndarray) -> np.ndarray:
        tau, y0, b0, s0, y1, b1, s1, e1 = p
        up, down = np.clip(t - s0, 0, None), np.clip(t - s1, 0, None)
        first = y0 + b0 * (1 - np.exp(-up / tau)) - parts[0]
        end = np.clip(t - e1, 0, None)
        second = y1 + b1 * (np.exp(-end / tau) - np.exp(-down / tau)) - parts[1]
        return np.concatenate([first, second])

    start = [6.0, 0.3, 1.5, 20.0, 0.3, 1.5, 20.0, 70.0]
    by_hand = least_squares(residuals, start, x_scale="jac", xtol=1e-14, ftol=1e-14)
    assert fit.parameters["tau_s"] == pytest.approx(by_hand.x[0], rel=1e-4)
    assert fit.cost == pytest.approx(2.0 * by_hand.cost, rel=1e-6)


@pytest.mark.slow
@pytest.mark.parametrize("name", QUICK)
def test_posterior_and_bounds_hold_the_truth(name: str, fitted: dict[str, Any]) -> None:
    case, data, fit = fitted[name]
    posterior = sample_posterior(data, fit, seed=1, sampler="independence")
    assert posterior.converged, posterior.status
    bounds = compare_bounds(data, fit, posterior, n_resamples=40)
    for parameter, true in case.shared.items():
        row = posterior.rows[parameter]
        assert abs(true - row["q50"]) < 4.0 * row["sd"], parameter
        for method in ("crlb_iid", "crlb_ar1", "sandwich", "profile", "block_bootstrap"):
            sd = row["sd"]
            low, high = bounds[method].interval(parameter, "95")
            assert low < row["q50"] + 2.0 * sd and high > row["q50"] - 2.0 * sd, (method, low, high)
            assert 0.3 * sd < high - low < 12.0 * sd, (method, parameter, low, high)
    assert not np.isfinite(bounds["crlb_iid_one_percent_step"].sd).any()
    sensors = {e.sensor for e in data}
    for e in data:
        times = posterior.chain[e.name]
        assert times["t63_s"]["q50"] < times["t90_s"]["q50"]
    if sensors != {""}:  # two sensors: their own lags are told, whatever the valve's is
        assert posterior.naming.order == "given" and posterior.assignments == []


def test_an_undecided_order_is_both() -> None:
    from dataclasses import replace

    case = CASES["filter and sensor"]()
    data = replace(case.simulated(seed=5), sensor_is="unknown")
    fit = fit_least_squares(data, seed=1, swarms=1)
    assert fit.order == "undecided"
    assert fit.names[:2] == ["lag_fast_s", "lag_slow_s"]
    assert fit.lags == pytest.approx([1.5, 6.0], rel=0.15)
    record = fit.to_json()
    assert set(record["estimates"]) == {"lag_fast_s", "lag_slow_s"}
    assert Problem(data).naming().order == "undecided"


@pytest.mark.slow
def test_samples_that_nearly_coincide_have_a_noise_law_and_bounded_chains() -> None:
    rng = np.random.default_rng(3)
    t = np.r_[0.0, np.sort(rng.uniform(0.0, 1200.0, 149))]
    assert np.diff(t).min() < 0.005 * np.median(np.diff(t))
    # two lags read as one: slow noise takes up the misfit, and the posterior is a narrow valley
    rise = -0.8 * np.expm1(-t / 180.0) - 0.2 * np.expm1(-t / 600.0)
    y = -45.0 + 84.0 * rise + 0.05 * rng.standard_normal(len(t))
    campaign = bs.Campaign.from_frames({"1": (t, y)}, stages=["sensor"], commanded_on="1 s")
    fit = bs.fit_least_squares(campaign, seed=1)
    assert 0.0 < fit.parameters["phi"] < 1.0
    settings = bs.Settings(n_chains=2, n_walkers=32, max_steps=200)
    posterior = bs.sample_posterior(campaign, fit, seed=1, sampler="hmc", settings=settings)
    assert posterior.sampler == "emcee" and "too short for a trajectory" in posterior.reasons[0]
