"""Parameters that a campaign cannot tell apart are named, others are not."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from bayes_sensor.campaign import Campaign, SideInformation
from bayes_sensor.fit import fit_least_squares
from bayes_sensor.fit.inseparable import common_to_sensors, left_open
from bayes_sensor.likelihood.density import log_likelihood, mean_and_variance
from bayes_sensor.likelihood.problem import Problem
from tests.support.other_rigs import CASES, Case, experiment


def one_lag(tau: float) -> Case:
    """One step up, none down."""
    return Case(Campaign("a lag", (experiment("1", off=None),), stages=("sensor",)), {"tau_s": tau})


def two_sensors(other: float) -> Case:
    pair = tuple(experiment(f"1,{s}", record="1", sensor=s) for s in "AB")
    rig = Campaign("two sensors", pair, stages=("valve", "sensor"))
    return Case(rig, {"tau_s[A]": 2.0, "tau_s[B]": other, "tau_v_s": 0.7})


def two_volumes() -> Case:
    pair = experiment("1", 50.0), experiment("2", 100.0)
    rig = Campaign("line, cell, sensor", pair, stages=("line", "cell", "sensor"))
    return Case(rig, {"tau_s": 5.0, "V_line_mL": 300.0, "V_cell_mL": 80.0})


@pytest.mark.parametrize("name", CASES)
def test_no_false_alarm(name: str) -> None:
    case = CASES[name]()
    problem = Problem(case.design)
    assert not left_open(problem, case.theta)
    assert common_to_sensors(problem, case.theta) is None


def test_a_record_that_ends_on_the_slope() -> None:
    case = one_lag(3000.0)
    (found,) = left_open(Problem(case.design), case.theta)
    assert {"tau_s", "beta_V[1]"} <= set(found.parameters)
    assert "longer record" in found.measure and "step down" in found.measure
    assert not left_open(Problem(one_lag(100.0).design), one_lag(100.0).theta)


def test_what_is_left_open_is_open_in_the_likelihood() -> None:
    # an independent route: means of another tau, the best y0, beta and t0 for it by linear
    # least squares, differ by less than the noise can tell
    case = one_lag(3000.0)
    problem = Problem(case.design)
    data = case.design.with_data({"1": mean_and_variance(problem, case.theta, 0)[0]})
    other = case.theta.copy()
    other[0] *= 1.5
    other[2] *= 1.5
    assert log_likelihood(data, case.theta) - log_likelihood(data, other) < 0.5
    settled = one_lag(20.0)
    mean = mean_and_variance(Problem(settled.design), settled.theta, 0)[0]
    data, other = settled.design.with_data({"1": mean}), settled.theta.copy()
    other[0], other[2] = 1.5 * other[0], 1.5 * other[2]
    assert log_likelihood(data, settled.theta) - log_likelihood(data, other) > 100.0


def test_a_lag_shorter_than_the_sampling() -> None:
    case = one_lag(0.02)
    (found,) = left_open(Problem(case.design), case.theta)
    assert found.parameters == ("tau_s", "t0_s[1]")
    assert "faster sampling" in found.measure


def test_sensors_of_one_speed() -> None:
    same = two_sensors(2.01)
    found = common_to_sensors(Problem(same.design), same.theta)
    assert found is not None and set(found.parameters) == {"tau_s[A]", "tau_s[B]", "tau_v_s"}
    fit = fit_least_squares(same.simulated(seed=1), swarms=1, euler=False)
    assert any("tau[A], tau[B] and tau_v" in text for text in fit.caveats)
    # exchanged, the response is the same
    other = same.theta.copy()
    other[:3] = 0.7, 0.7, 2.0
    equal = same.theta.copy()
    equal[:3] = 2.0, 2.0, 0.7
    problem = Problem(same.design)
    for k in range(2):
        first, second = (mean_and_variance(problem, theta, k)[0] for theta in (equal, other))
        np.testing.assert_allclose(first, second, atol=1e-12)
    apart = two_sensors(9.0)
    assert common_to_sensors(Problem(apart.design), apart.theta) is None


def test_two_volumes_have_no_names_unless_one_is_known() -> None:
    data = two_volumes().simulated(seed=1)
    fit = fit_least_squares(data, swarms=1, euler=False)
    (found,) = [each for each in fit.inseparable if "V_line_mL" in each.parameters]
    assert found.parameters == ("V_line_mL", "V_cell_mL") and found.sentence in fit.caveats
    assert fit.parameters["V_line_mL"] < fit.parameters["V_cell_mL"]
    assert {"parameters": ["V_line_mL", "V_cell_mL"], "measure": found.measure} in (
        fit.to_json()["cannot_tell_apart"]
    )
    known = replace(data, side_information={"V_line_mL": SideInformation(290.0, 20.0)})
    told = fit_least_squares(known, swarms=1, euler=False)
    assert not told.caveats and not told.inseparable
    assert told.parameters["V_line_mL"] == pytest.approx(300.0, rel=0.05)
    assert told.cost == pytest.approx(fit.cost, rel=1e-9)


def test_lags_without_names_say_what_would_name_them() -> None:
    case = CASES["four stages"]()
    fit = fit_least_squares(case.simulated(seed=1), swarms=1, euler=False)
    (found,) = fit.inseparable
    assert found.parameters == ("tau_v_s", "tau_probe_s")
    assert any("tau_v measured elsewhere" in text for text in fit.warnings)


def test_a_size_of_noise_at_zero_has_a_huge_variance_that_is_still_a_number() -> None:
    case = replace(two_sensors(9.0), sigma1=0.0)
    assert common_to_sensors(Problem(case.design), case.theta) is None
