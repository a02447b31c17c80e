"""Priors that a user gives and the data contradict are named and left out."""

from __future__ import annotations

import re
from functools import cache
from pathlib import Path

import numpy as np
import pytest

import bayes_sensor as bs

TRUE_TAU = 4.0


@cache
def probe(command: str) -> tuple[bs.Campaign, bs.Fit]:
    t = np.arange(0.0, 60.0, 0.05)
    y = 1.0 - 2.0 * np.expm1(-np.maximum(t - 10.3, 0.0) / TRUE_TAU)
    y += 0.02 * np.random.default_rng(1).standard_normal(len(t))
    campaign = bs.Campaign.from_frames({"1": (t, y)}, stages=["sensor"], commanded_on=command)
    return campaign, bs.fit_least_squares(campaign, seed=1)


@pytest.mark.parametrize(
    ("command", "name", "law", "given"),
    [
        ("10 s", "t0", "uniform(0 s, 5 s)", "a prior and data .* t0.1.: uniform.0, 5. s is given"),
        ("10 s", "tau", "uniform(10, 20) s", "a prior and data .* tau: uniform.10, 20. s is given"),
        ("10 s", "tau", "log-normal(1, 0.1) s", "a prior and data .* tau: log-normal.1, 0.1. s"),
        ("10 s", "tau", "half-normal(0.2) s", "a prior and data .* tau: half-normal.0.2. s"),
        ("10 s", "y0", "uniform(2, 3) V", "a prior and data .* y0.1.: uniform.2, 3. V is given"),
        ("10 s", "beta", "normal(2.1, 0.001) V", "side information .* beta.1.: 2.1 .- 0.001 V is"),
        ("9 s", "t0", "normal(10.25, 0.005) s", "side information .* t0.1.: 10.25 .- 0.005 s is"),
    ],
)
def test_a_prior_that_the_data_contradict_is_named_and_left_out(
    command: str, name: str, law: str, given: str
) -> None:
    campaign, fit = probe(command)  # which knew of no prior
    posterior = bs.sample_posterior(
        bs.make_problem(campaign, {name: law}), fit, seed=1, sampler="independence"
    )
    (text,) = posterior.warnings
    assert re.search(given, text) and "joint standard deviations apart" in text
    row = posterior.rows["tau_s"]
    assert row["q2.5"] < TRUE_TAU < row["q97.5"] and row["q97.5"] - row["q2.5"] < 0.1


@pytest.mark.parametrize(
    "priors",
    [
        {"tau": "half-normal(2) s"},
        {"tau": "uniform(0, 10) s", "t0": "uniform(10.2, 10.4) s"},
        {"tau": "log-normal(3, 0.5) s", "y0": "normal(1, 0.1) V", "beta": "normal(2, 0.1) V"},
        {"t0": "normal(10.3, 0.005) s"},
    ],
)
def test_a_prior_that_agrees_is_kept(priors: dict[str, str]) -> None:
    campaign, fit = probe("10 s")
    problem = bs.make_problem(campaign, priors)
    posterior = bs.sample_posterior(problem, fit, seed=1, sampler="independence")
    assert posterior.warnings == ()
    assert posterior.problem.given_priors == problem.given_priors


def test_a_prior_that_ends_the_interval_is_not_taken_for_the_data() -> None:
    campaign, fit = probe("10 s")
    problem = bs.make_problem(campaign, {"tau": "uniform(1, 4) s"})
    posterior = bs.sample_posterior(problem, fit, seed=1, sampler="independence")
    assert posterior.no_upper_limit == {}
    (text,) = posterior.warnings
    assert text.startswith("the prior that was given of tau_s, uniform(1, 4), ends its interval")


@pytest.mark.parametrize("law", ["uniform(-0.9, -0.5)", "uniform(0.9, 0.95)"])
def test_a_prior_that_ends_the_interval_of_the_noise_is_said(law: str) -> None:
    campaign, fit = probe("10 s")
    problem = bs.make_problem(campaign, {"phi": law})
    posterior = bs.sample_posterior(problem, fit, seed=1, sampler="independence")
    said = f"the prior that was given of phi, {law}, ends its interval"
    assert any(text.startswith(said) for text in posterior.warnings)


def test_a_prior_between_two_lags_is_named(tmp_path: Path) -> None:
    path = tmp_path / "design.toml"
    pulse = 'commanded_on = "2 s"\ncommanded_off = "8 s"\ninterval = "10 ms"\nduration = "16 s"\n'
    path.write_text(
        '[rig]\nsensor_is = "faster"\n'
        + "".join(
            f'[[experiment]]\nname = "{flow}"\ncarrier_flow = "{flow} L/min"\n'
            f'test_gas_flow = "0.5 L/min"\n{pulse}'
            for flow in (4.0, 8.5)
        )
    )
    step = {"y0_V": 0.2, "beta_V": 2.0, "t0_s": 2.2, "tf_s": 8.2}
    truth = {
        "tau_s": 0.3, "tau_v_s": 1.0, "V_mL": 40.0, "phi": 0.4, "sigma0_V": 0.005,
        "sigma1_V": 0.005, "experiments": {"4.0": step, "8.5": step},
    }  # fmt: skip
    campaign = bs.simulate(bs.read_campaign(path), truth, 1)
    problem = bs.make_problem(campaign, {"tau": "uniform(0.8, 1.2) s"})
    fit = bs.fit_least_squares(problem, seed=1)
    (text,) = fit.caveats
    assert "for any lag of that place, but it suits the other lag, of 0.99" in text
    (compared,) = fit.to_json()["side_information"]
    assert compared["contradicts"] and compared["distance_sd"] is None
    posterior = bs.sample_posterior(problem, fit, seed=1, sampler="independence")
    assert posterior.rows["tau_s"]["q2.5"] < 0.3 < posterior.rows["tau_s"]["q97.5"]
    # from a theta that no fit stands behind it is one message
    other = bs.make_problem(campaign, {"tau": "uniform(5, 6) s"})
    with pytest.raises(bs.CampaignError, match="the priors .* contradict the data"):
        bs.sample_posterior(other, fit.parameters, seed=1, sampler="independence")
