"""The posterior with an effect, and with a discrepancy, of a rig that is not the published one."""

from __future__ import annotations

import pickle
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

import bayes_sensor as bs
from bayes_sensor.diagnosis import Strength
from bayes_sensor.diagnosis.discrepancy_posterior import with_discrepancy
from bayes_sensor.diagnosis.effects import CATALOGUE
from bayes_sensor.diagnosis.effects.effect_model import with_effects
from bayes_sensor.likelihood.problem import Problem
from tests.support.other_rigs import CASES

DRIFT = 2e-4
"""V/s, added to the records"""


def test_the_drift_that_biases_a_probes_lag_is_taken_into_its_posterior() -> None:
    case = CASES["sensor"]()
    data = case.simulated()
    drifting = tuple(replace(e, y=e.y + DRIFT * (e.t - e.t[0])) for e in data)
    problem = Problem(replace(data, experiments=drifting))
    fit = bs.fit_least_squares(problem, seed=1, swarms=1, euler=False)
    start = problem.layout.flat(fit.theta_hat[: problem.layout.n_mean])
    plain = bs.sample_posterior(problem, fit, seed=1, sampler="independence")
    effect = bs.sample_posterior(
        with_effects(problem, ["baseline_drift"], start), fit, seed=1, sampler="independence"
    )
    wide = with_discrepancy(plain, fit, 1)
    tau = case.shared["tau_s"]
    low, high = plain.quantiles("tau_s", [0.025, 0.975])
    assert low > tau, "the drift is too weak for this test"
    width = high - low
    low, high = effect.quantiles("tau_s", [0.025, 0.975])
    assert low < tau < high and high - low == pytest.approx(width, rel=0.5)
    low, high = effect.quantiles("drift_V_per_s", [0.025, 0.975])
    assert 0.0 < low < DRIFT < high
    # a smooth discrepancy does not know what the drift is, but that something is there
    low, high = wide.quantiles("tau_s", [0.025, 0.975])
    assert low < tau < high and high - low > 1.5 * width


def drift(t: Any, strength: Any, rig: Any) -> Any:
    """A drift of one's own."""
    return rig.mean(t) + strength["slope"] * (t - rig.t0)


OWN = bs.own_effect(
    "sinking", [Strength("slope", "V/s", "normal", 0.0, 1e-3)], drift, plausible={"slope": DRIFT}
)
QUICK = bs.Settings(n_draws=60, target_ess=60.0)


@pytest.fixture(scope="module")
def small() -> tuple[bs.Problem, bs.Fit]:
    """One record of a probe, and its fit."""
    problem = bs.Problem(CASES["sensor"]().simulated().without("2"))
    return problem, bs.fit_least_squares(problem, swarms=1, euler=False)


@pytest.mark.parametrize(
    ("effect", "parameter"),
    [
        ("baseline_drift", "drift_V_per_s"),
        (["baseline_drift:own"], "drift_V_per_s[1]"),
        (CATALOGUE["baseline_drift"], "drift_V_per_s"),
        (CATALOGUE["baseline_drift"].forms[1], "drift_V_per_s[1]"),
        ([OWN], "slope_V_per_s"),
        (OWN.forms[0], "slope_V_per_s"),
    ],
)
def test_an_effect_is_put_into_the_posterior_however_it_is_given(
    small: tuple[bs.Problem, bs.Fit], effect: Any, parameter: str
) -> None:
    problem, fit = small
    start = fit if isinstance(effect, list) else fit.parameters
    posterior = bs.sample_posterior(
        problem, start, sampler="independence", settings=QUICK, with_effect=effect
    )
    assert posterior.sampler == "independence"
    assert abs(posterior.mean(parameter)) < 5.0 * posterior.sd(parameter) < 1e-3
    # its prior is scaled to the fit, as that of the command is
    flat = problem.layout.flat(fit.theta_hat)
    assert posterior.problem.given_priors == with_effects(problem, effect, flat).given_priors


@pytest.mark.parametrize("effect", [drift, [drift], 3])
def test_what_is_no_effect_is_told_how_to_become_one(
    small: tuple[bs.Problem, bs.Fit], effect: Any
) -> None:
    with pytest.raises(bs.CampaignError, match=r"with_effect: expected .* bayes_sensor.own_effect"):
        bs.sample_posterior(*small, with_effect=effect)


def test_results_go_to_another_process_and_back(small: tuple[bs.Problem, bs.Fit]) -> None:
    problem, fit = small
    posterior = bs.sample_posterior(
        problem, fit, sampler="independence", settings=QUICK, with_effect=[OWN, "gain_drift"]
    )
    copy = pickle.loads(pickle.dumps(posterior))
    np.testing.assert_array_equal(copy.chains, posterior.chains)
    theta = posterior.draws[0]
    assert bs.log_likelihood(copy.problem, theta) == bs.log_likelihood(posterior.problem, theta)
    bounds = bs.compare_bounds(problem, fit, methods=["crlb_iid", "profile"])
    assert pickle.loads(pickle.dumps(bounds)).to_json() == bounds.to_json()
    gap = bs.diagnose_gap(problem, fit, effects=OWN, bootstrap=0, separate=False, hidden=False)
    back = pickle.loads(pickle.dumps(gap))
    assert back.to_json() == gap.to_json()
    # what is told by identity stays what it is
    mine = CATALOGUE["flow_switching"], CATALOGUE["mains_pickup"].on_noise
    assert all(pickle.loads(pickle.dumps(each)) is each for each in mine)
