"""Lags much longer than the step that shows them: found, with intervals as long as they are."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

import bayes_sensor as bs
from bayes_sensor.likelihood.mesh import compress
from bayes_sensor.likelihood.prior_density import log_priors
from bayes_sensor.posterior.laplace import approximate
from bayes_sensor.posterior.samplers.emcee_ensembles import bends
from bayes_sensor.report import Saved, headline
from bayes_sensor.report.stage_values import stage_values
from tests.support.campaigns import small_problem

DESIGN = """
title = "a pulse of one second"
[rig]
stages = ["sensor"]
[[experiment]]
name = "1"
commanded_on = "1 s"
commanded_off = "2 s"
interval = "20 ms"
duration = "6 s"
"""
STEP = {"1": {"y0_V": 0.2, "beta_V": 2.0, "t0_s": 1.2, "tf_s": 2.2}}


def simulated(folder: Path, tau: float, noise: float, seed: int) -> bs.Campaign:
    path = folder / "design.toml"
    path.write_text(DESIGN)
    sizes = {"phi": 0.4, "sigma0_V": noise, "sigma1_V": noise}
    return bs.simulate(bs.read_campaign(path), {"tau_s": tau, **sizes, "experiments": STEP}, seed)


@pytest.mark.parametrize("seed", range(3, 6))
@pytest.mark.parametrize("tau", [4.0, 8.0])
def test_least_squares_look_as_far_as_the_lag_is(tau: float, seed: int, tmp_path: Path) -> None:
    # noise hides that the signal still moves when the pulse ends, and with it how far to look
    campaign = simulated(tmp_path, tau, 0.05, seed)
    fit = bs.fit_least_squares(campaign, seed=1)
    assert "tau_s" not in fit.at_bound
    assert fit.theta_hat[0] == pytest.approx(tau, rel=0.45)
    assert fit.rms < 1.05 * 0.05


def by_random_walk(campaign: bs.Campaign, theta: np.ndarray, spread: np.ndarray) -> np.ndarray:
    """Draws of tau by plain Metropolis steps in theta, many chains at once."""
    problem = bs.make_problem(campaign)
    mesh = compress(problem, theta)
    rng = np.random.default_rng(1)
    free = np.array([0, 3, 4, 5, 6, 7])  # y0 and beta are integrated out

    def density(thetas: np.ndarray) -> np.ndarray:
        values = log_priors(problem, thetas)
        inside = np.isfinite(values)
        values[inside] += mesh.marginals(thetas[inside])[0]
        return values

    here = np.tile(theta, (400, 1))
    here[:, free] += 0.05 * spread[:, free].std(axis=0) * rng.standard_normal((400, len(free)))
    value, kept = density(here), []
    root = np.linalg.cholesky(np.cov(spread[:, free].T))
    for i in range(3000):
        there = here.copy()
        there[:, free] += 0.9 * rng.standard_normal((400, len(free))) @ root.T
        new = density(there)
        moves = np.log(rng.random(400)) < new - value
        here[moves], value[moves] = there[moves], new[moves]
        if i >= 1000:
            kept.append(here[:, 0].copy())
    return np.concatenate(kept)


@pytest.mark.slow
def test_walkers_fill_the_valley_of_a_long_lag(tmp_path: Path) -> None:
    campaign = simulated(tmp_path, 20.0, 0.01, 1)
    fit = bs.fit_least_squares(campaign, seed=1)
    posterior = bs.sample_posterior(campaign, fit, seed=1)
    assert posterior.converged and posterior.no_upper_limit == {}
    row = posterior.rows["tau_s"]
    assert row["q2.5"] < 20.0 < row["q97.5"]
    plain = by_random_walk(campaign, np.median(posterior.draws, axis=0), posterior.draws)
    expected = np.percentile(plain, [2.5, 50.0, 97.5])
    assert [row["q2.5"], row["q50"], row["q97.5"]] == pytest.approx(expected, rel=0.04)


def test_where_the_valley_bends(tmp_path: Path) -> None:
    campaign = simulated(tmp_path, 20.0, 0.01, 1)
    fit = bs.fit_least_squares(campaign, seed=1)
    assert bends(approximate(bs.make_problem(campaign), fit.theta_hat)[0])
    problem, theta = small_problem(0.5, n=2, interval=0.02)
    assert not bends(approximate(problem, theta)[0])


@pytest.mark.slow
def test_an_interval_that_ends_where_its_prior_does_is_none(tmp_path: Path) -> None:
    # nothing tells this record from a ramp
    campaign = simulated(tmp_path, 20.0, 0.1, 1)
    posterior = bs.sample_posterior(campaign, seed=1)
    assert posterior.no_upper_limit == {"tau_s": 50.0}
    assert any(text.startswith("the data give no upper limit") for text in posterior.warnings)
    record: dict[str, Any] = posterior.to_json()
    found = headline(record, None)
    assert found is not None and not found.is_limit and found.ends_s is None
    assert found.text.startswith("tau is longer than ")
    assert "the data give no upper limit: its prior ends at 50 s" in found.text
    run = {"commands": {"posterior": {}}, "last": "posterior"}
    saved = Saved({"experiments": [], "stages": ["sensor"]}, run, posterior=record)
    assert stage_values(saved)[0].lines[0].startswith("τ > ")


CHAIN = """
title = "pulses shorter than each of three lags"
[rig]
sensor_is = "faster"
""" + "".join(
    f'[[experiment]]\nname = "{name}"\ncarrier_flow = "{flow} L/min"\ntest_gas_flow = "0.5 L/min"\n'
    'commanded_on = "2 s"\ncommanded_off = "4 s"\ninterval = "10 ms"\nduration = "12 s"\n'
    for name, flow in (("1", 4.0), ("2", 8.5))
)


def of_a_chain(folder: Path, tau: float, seed: int, duration: str = "12 s") -> bs.Campaign:
    path = folder / "design.toml"
    path.write_text(CHAIN.replace("12 s", duration))
    step = {"y0_V": 0.2, "beta_V": 2.0, "t0_s": 2.2, "tf_s": 4.2}
    truth = {
        "tau_s": tau, "tau_v_s": 1.5 * tau, "V_mL": 75.0 * tau,
        "phi": 0.4, "sigma0_V": 0.005, "sigma1_V": 0.005, "experiments": {"1": step, "2": step},
    }  # fmt: skip
    return bs.simulate(bs.read_campaign(path), truth, seed)


@pytest.mark.parametrize("tau", [2.0, 4.0, 6.0])
def test_a_signal_that_is_farthest_after_its_pulse_is_fitted(tau: float, tmp_path: Path) -> None:
    campaign = of_a_chain(tmp_path, tau, 1)
    fit = bs.fit_least_squares(campaign, seed=1)
    assert fit.rms < 0.0055
    assert any("the signal still moves when the step ends" in text for text in fit.warnings)


def test_a_response_that_has_hardly_begun_gives_no_interval(tmp_path: Path) -> None:
    campaign = of_a_chain(tmp_path, 200.0, 1)
    step = {"y0_V": 0.2, "beta_V": 2.0, "t0_s": 2.2, "tf_s": 4.2}
    slow = {
        "tau_s": 200.0, "tau_v_s": 300.0, "V_mL": 15000.0,
        "phi": 0.4, "sigma0_V": 0.005, "sigma1_V": 0.005, "experiments": {"1": step, "2": step},
    }  # fmt: skip
    with pytest.raises(bs.CampaignError, match="less than 2 % of the step's response"):
        bs.sample_posterior(campaign, slow, seed=1)


def test_a_switch_late_in_its_pulse_is_looked_for(tmp_path: Path) -> None:
    # no step shows before the pulse ends, and then neither where its first half ends
    path = tmp_path / "design.toml"
    path.write_text(CHAIN.replace("12 s", "7 s"))
    step = {"y0_V": 0.2, "beta_V": 2.0, "t0_s": 3.6, "tf_s": 5.0}
    truth = {
        "tau_s": 0.05, "tau_v_s": 0.9, "V_mL": 60.0,
        "phi": 0.8, "sigma0_V": 0.05, "sigma1_V": 0.05, "experiments": {"1": step, "2": step},
    }  # fmt: skip
    fit = bs.fit_least_squares(bs.simulate(bs.read_campaign(path), truth, 3), seed=1)
    assert fit.converged and fit.rms < 0.06
    assert not any("t0_s" in name or "tf_s" in name for name in fit.at_bound)


@pytest.mark.slow
@pytest.mark.parametrize(("duration", "decided"), [("12 s", False), ("7 s", True)])
def test_a_default_prior_that_decides_is_said(duration: str, decided: bool, tmp_path: Path) -> None:
    campaign = of_a_chain(tmp_path, 4.0, 1, duration)
    fit = bs.fit_least_squares(campaign, seed=1)
    quick = bs.Settings(max_steps=2000, target_ess=500.0)
    problem = bs.make_problem(campaign)
    posterior = bs.sample_posterior(problem, fit, seed=1, settings=quick)
    said = headline(posterior.to_json(), None)
    assert said is not None and ("default priors decide" in said.text) == decided
    assert any("default priors decide" in text for text in posterior.warnings) == decided
    # sampled without the default law of tau_v, most draws lie beyond its interval, or few do
    own = bs.make_problem(campaign, {"tau_v_s": bs.Prior("uniform", 0.0, 1e4)})
    free = bs.sample_posterior(own, fit, seed=1, settings=quick).of("tau_v_s")
    low, high = (posterior.rows["tau_v_s"][key] for key in ("q2.5", "q97.5"))
    outside = np.mean((free < low) | (free > high))
    assert outside > 0.6 if decided else outside < 0.15
    assert ("tau_v_s" in posterior.decided_by_prior) == bool(posterior.decided_by_prior) == decided
