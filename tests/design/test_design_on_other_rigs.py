"""Predictions on rigs other than the published one: the bound they rest on, and what is refused."""

from __future__ import annotations

import numpy as np
import pytest

from bayes_sensor.bounds import cramer_rao
from bayes_sensor.campaign import CampaignError
from bayes_sensor.design import design_experiments, what_if
from bayes_sensor.design.planned_experiments import settings_of, truth_of
from bayes_sensor.design.record_information import common_names, sum_information
from bayes_sensor.design.tau_interval import predict_tau
from bayes_sensor.likelihood.problem import Problem
from tests.support.other_rigs import CASES

TIED = [name for name in CASES if CASES[name]().design.ties]
ONE_SENSOR = [name for name in CASES if name not in ("two sensors", *TIED)]


@pytest.mark.parametrize("name", ONE_SENSOR)
def test_prediction_rests_on_the_coloured_bound(name: str) -> None:
    case = CASES[name]()
    problem = Problem(case.design)
    truth = truth_of(problem, case.theta)
    common = sum_information(settings_of(problem, case.theta), truth, truth.tau)
    assert len(common) == len(common_names(truth.rig))
    bound = cramer_rao(case.design, case.theta, noise="ar1")["tau_s"]
    assert predict_tau(common, truth.tau).sd == pytest.approx(bound, rel=1e-4)


def test_a_second_record_of_each_narrows_by_the_root_of_two() -> None:
    case = CASES["cell and sensor"]()
    table = what_if(case.design, Problem(case.design).layout.nested(case.theta))
    # tau is many standard errors from zero
    (gain,) = table[table["change"] == "2 times the experiments"]["gain"]
    assert gain == pytest.approx(np.sqrt(2.0), rel=0.01)
    assert {"V_cell measured to +-2 mL", "2 times the flow"} <= set(table["change"])


def test_rows_without_a_meaning_are_left_out() -> None:
    case = CASES["staircase"]()
    kinds = set(what_if(case.design, Problem(case.design).layout.nested(case.theta))["kind"])
    assert kinds == {"none", "trigger", "repeats", "rate"}


def test_proposals_keep_the_rig() -> None:
    case = CASES["four stages"]()
    nested = Problem(case.design).layout.nested(case.theta)
    found = design_experiments(
        case.design, nested, 0.1, (50.0, 200.0), (0.05, 0.2), (100.0, 200.0), n_grid=(2, 2, 2)
    )
    assert found.campaign.stages == case.design.stages
    assert found.campaign.sensor_is == "slower"
    assert found.reached and found.after.half_width95 <= 0.1 < found.before.half_width95
    assert found.truth["tau_probe_s"] == 2.0


@pytest.mark.parametrize(("name", "match"), [("sensor", "gives none"), ("two sensors", "one")])
def test_what_cannot_be_planned_is_one_message(name: str, match: str) -> None:
    case = CASES[name]()
    nested = Problem(case.design).layout.nested(case.theta)
    with pytest.raises(CampaignError, match=match):
        design_experiments(case.design, nested, 0.1, (50.0, 90.0), (0.1, 0.2), (100.0, 200.0))


def test_two_sensors_have_no_prediction() -> None:
    case = CASES["two sensors"]()
    with pytest.raises(CampaignError, match="there are 2"):
        what_if(case.design, Problem(case.design).layout.nested(case.theta))


@pytest.mark.parametrize("name", TIED)
def test_what_is_tied_cannot_be_planned(name: str) -> None:
    case = CASES[name]()
    with pytest.raises(CampaignError, match="there are|parameters are tied"):
        what_if(case.design, Problem(case.design).layout.nested(case.theta))
