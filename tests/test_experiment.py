"""Experiments and commands say what is wrong when they are made."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from bayes_sensor.experiment import CampaignError, Commands, Experiment

T = np.arange(0.0, 10.0, 0.1)
PLAN = Experiment("1", T, None, None, None, 0.1, commanded_on=2.0, commanded_off=6.0)


@pytest.mark.parametrize(
    ("commands", "said"),
    [
        (lambda: Commands([1.0, 1.0], [1.0, 0.0]), "times must rise"),
        (lambda: Commands([1.0], [1.0, 0.0]), "as many levels as times"),
        (lambda: Commands([1.0, np.nan], [1.0, 0.0]), "time 2 is nan"),
        (lambda: Commands([1.0, 2.0], [1.0, 1.0]), "step 2 goes to the level"),
        (lambda: Commands([1.0, 2.0], [1.0, 0.0], delays="one"), "'free' or 'shared'"),
        (lambda: Commands([1.0, 2.0], [3.0, 3.0], recorded=True), "expected an input that changes"),
    ],
)
def test_commands_are_checked(commands: object, said: str) -> None:
    with pytest.raises(CampaignError, match=said):
        commands()  # type: ignore[operator]


def test_heights_are_changes_of_the_input() -> None:
    assert Commands([1.0, 2.0, 3.0], [0.2, 1.0, 0.0]).heights.round(9).tolist() == [0.2, 0.8, -1.0]
    assert Commands([1.0, 2.0], [0.0, 1.0], rest=1.0).heights.tolist() == [-1.0, 1.0]


def test_flows_are_known_both_or_neither() -> None:
    assert not PLAN.flow_known and np.isnan(PLAN.total_flow) and PLAN.concentration == 1.0
    assert PLAN.with_flow(2.0) is PLAN
    known = replace(PLAN, carrier_flow=60.0, test_gas_flow=15.0)
    assert (known.total_flow, known.concentration) == (75.0, 0.2)
    assert known.with_flow(2.0).total_flow == 150.0
    with pytest.raises(CampaignError, match="got carrier_flow alone; .* add test_gas_flow"):
        replace(PLAN, carrier_flow=60.0)


def test_the_first_command_is_that_of_the_programme() -> None:
    two = replace(PLAN, commanded_on=None, commanded_off=None, commands=Commands([3.0], [1.0]))
    assert two.commanded_on == 3.0 and not two.has_fall
    assert "flow unknown" in repr(two)
    assert (two.record_name, replace(two, record="r").record_name) == ("1", "r")
