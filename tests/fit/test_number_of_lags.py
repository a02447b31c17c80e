"""The number of lags: as many as were simulated, none more."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.optimize import minimize

from bayes_sensor.campaign import Campaign
from bayes_sensor.fit import count_lags, fit_least_squares
from bayes_sensor.fit.lag_count import supported
from bayes_sensor.fit.likelihood_maximum import likelihood_maximum
from bayes_sensor.likelihood.density import log_likelihood
from bayes_sensor.likelihood.problem import Problem
from tests.support.other_rigs import CASES, Case, experiment


@pytest.mark.parametrize(
    ("name", "n", "phi", "seed"),
    [
        ("sensor", 1, 0.5, 102),
        ("sensor", 1, 0.9, 102),  # one lag has several maxima in these two
        ("sensor", 1, 0.9, 111),
        ("filter and sensor", 2, 0.5, 102),
        ("cell and sensor", 2, 0.9, 102),
        ("staircase", 1, 0.9, 102),
        ("staircase", 1, 0.9, 111),
        ("two sensors", 2, 0.5, 102),
    ],
)
def test_as_many_as_were_simulated(name: str, n: int, phi: float, seed: int) -> None:
    data = Case(CASES[name]().design, CASES[name]().shared, phi=phi).simulated(seed)
    found = count_lags(data, fit_least_squares(data, swarms=1, particles=12, euler=False))
    assert found is not None and found.supported == n, found
    assert set(found.log_evidence) == {1, 2, 3, 4}
    assert max(found.log_evidence.values()) == 0.0


def test_the_published_rig_with_one_lag_only() -> None:
    """A sensor of 20 s read with the default rig: one lag suffices, and how to write that."""
    flow = (experiment("1", 50.0, off=None),)
    alone = Case(Campaign("one", flow, stages=("sensor",)), {"tau_s": 20.0}).simulated(3)
    data = Campaign("default rig", alone.experiments)
    found = count_lags(data, fit_least_squares(data, swarms=1, euler=False))
    assert found is not None and found.supported == 1 and found.present == 3
    assert "one lag suffices" in found.sentence and 'stages = ["sensor"]' in found.sentence


def test_a_rig_with_a_stage_too_few() -> None:
    case = CASES["cell and sensor"]()
    short = Campaign("without the cell", case.simulated(1).experiments, stages=("sensor",))
    found = count_lags(short, fit_least_squares(short, swarms=1, euler=False))
    assert found is not None and found.supported == 2
    assert "at least two lags" in found.sentence
    assert found.stages[2] == ("line", "sensor")  # it is seen that it depends on flow


def test_maximum_agrees_with_a_simplex() -> None:
    case = CASES["cell and sensor"]()
    problem = Problem(case.simulated(4))
    unlimited = np.full(len(case.theta), np.inf)
    low = np.where([n in problem.layout.shared_names for n in problem.layout.names], 1e-3, -np.inf)
    value, at = likelihood_maximum(problem, case.theta, low, unlimited)
    assert value == pytest.approx(log_likelihood(problem, at), abs=1e-3)
    scale = 1e-3 + 0.02 * np.abs(case.theta)

    def cost(z: np.ndarray) -> float:
        found = log_likelihood(problem, at + z * scale)
        return -found if np.isfinite(found) else 1e9

    other = minimize(cost, np.zeros(len(at)), method="Powell", options={"maxiter": 6})
    # a step that gains less than .01 ends the search
    assert -other.fun < value + 0.05


def test_more_lags_must_earn_odds() -> None:
    assert supported({1: 0.0, 2: 2.9}) == 1  # odds of 18
    assert supported({1: 0.0, 2: 3.0}) == 2
    assert supported({1: -50.0, 2: 0.0, 3: -3.0, 4: -6.0}) == 2
    assert supported({1: -9.0, 2: -8.0, 3: -7.0, 4: 0.0}) == 4


def test_nothing_to_count_where_nothing_is_seen() -> None:
    case = CASES["sensor"]()
    quiet = Case(case.design, case.shared, sigma0=50.0)
    data = quiet.simulated(1)
    fit = fit_least_squares(data, swarms=1, euler=False)
    assert not fit.step_seen and count_lags(data, fit) is None
    assert fit.to_json()["n_lags"] is None


def test_a_number_from_a_model_that_misses_is_not_relied_on() -> None:
    data = CASES["sensor"]().simulated(1)
    fit = fit_least_squares(data, swarms=1, euler=False)
    assert fit.misfit is not None and fit.misfit < 1.5
    plain, missed = count_lags(data, fit), count_lags(data, replace(fit, misfit=3.0))
    assert plain is not None and missed is not None
    assert plain.sentence == "one lag suffices"
    assert "do not rely" in missed.sentence and missed.log_evidence == plain.log_evidence


def test_a_further_lag_costs_no_more_than_a_parameter() -> None:
    # three steps read as one: no chain of lags is that, and maxima are hard to find
    (record,) = CASES["staircase"]().simulated(1).experiments
    one = replace(record, commands=None, commanded_on=15.0)
    data = Campaign("a staircase read as one step", (one,), stages=("sensor",))
    found = count_lags(data, fit_least_squares(data, swarms=1, euler=False))
    assert found is not None
    values = [found.log_evidence[n] for n in (1, 2, 3, 4)]
    assert np.diff(values).min() > -0.5 * np.log(data.n_samples) - 0.01
