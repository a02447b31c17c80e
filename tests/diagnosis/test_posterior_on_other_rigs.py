"""The posterior with an effect, and with a discrepancy, of a rig that is not the published one."""

from __future__ import annotations

from dataclasses import replace

import pytest

import bayes_sensor as bs
from bayes_sensor.diagnosis.discrepancy_posterior import with_discrepancy
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
