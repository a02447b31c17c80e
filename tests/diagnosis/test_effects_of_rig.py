"""Which effects a rig and its inputs can have, in which forms, and in which words."""

from dataclasses import replace

import pytest

from bayes_sensor.campaign import Campaign, CampaignError
from bayes_sensor.diagnosis import CATALOGUE
from bayes_sensor.diagnosis.effects.effect import Effect
from bayes_sensor.diagnosis.effects.effect_model import Scales
from bayes_sensor.diagnosis.effects.effects_of_rig import (
    ALL,
    INPUT_TAKES_TIME,
    LONGER_STEP,
    MISSING_STAGE,
    OF_ANOTHER,
    Possible,
)
from bayes_sensor.diagnosis.effects.setting import Setting
from tests.support.campaigns import small_problem
from tests.support.other_rigs import CASES, experiment


def on(rig: str) -> tuple[Possible, Setting]:
    return of(CASES[rig]().simulated())


def of(campaign: Campaign) -> tuple[Possible, Setting]:
    return Possible.of(campaign), Scales.of(campaign).setting(campaign.experiments[0], 20.0, 70.0)


def effects(rig: str) -> dict[str, Effect]:
    possible, setting = on(rig)
    return possible.effects(CATALOGUE, setting)


@pytest.mark.parametrize(
    ("rig", "stages"),
    [
        ("sensor", set()),
        ("filter and sensor", set()),
        ("cell and sensor", {"flow", "manifold"}),
        ("four stages", {"valve", "flow", "manifold"}),
        ("two sensors", {"valve"}),
    ],
)
def test_a_rig_has_stages_for_effects_to_act_on(rig: str, stages: set[str]) -> None:
    found, _ = on(rig)
    assert found.any_rig
    assert found.stages & {"valve", "flow", "manifold"} == stages
    assert "command" in found.stages and "sensor" in found.stages


def test_a_recorded_input_is_not_commanded() -> None:
    found, _ = on("recorded input")
    assert "command" not in found.stages
    switched = replace(CASES["sensor"]().design.experiments[0], name="2")
    recorded = CASES["recorded input"]().design
    mixed = replace(recorded, experiments=(*recorded.experiments, switched))
    assert "command" not in Possible.of(mixed).stages


def test_the_published_rig_has_them_all() -> None:
    problem, _ = small_problem()
    found, setting = of(problem.campaign)
    assert not found.any_rig and found.stages == ALL
    assert found.effects(CATALOGUE, setting) == dict(CATALOGUE)


def test_what_falls_has_a_switch_downwards() -> None:
    down, _ = on("filter and sensor")
    assert down.falls
    up, _ = of(
        replace(
            CASES["sensor"]().design,
            experiments=(experiment("1", off=None), experiment("2", off=None)),
        )
    )
    assert not up.falls
    assert Possible.of(CASES["sensor"]().design).falls  # one record of two has one


def test_forms_are_those_that_kernel_and_input_have() -> None:
    possible, setting = on("two sensors")
    whole = CATALOGUE["valve_asymmetry"]
    ours = possible.effects(CATALOGUE, setting)["valve_asymmetry"]
    assert 0 < len(ours.forms) < len(whole.forms)  # without the bend
    step = CATALOGUE["baseline_step"]
    with_fall = [
        form for form in step.forms if not replace(possible, falls=False).has(form, setting)
    ]
    assert 0 < len(with_fall) < len(step.forms) and possible.has(with_fall[0], setting)
    assert replace(possible, any_rig=False).has(whole.forms[-1], setting)
    alone = replace(possible, falls=False)
    with pytest.raises(CampaignError, match="cannot act in the form"):
        alone.check(step, with_fall[0], setting)
    only = replace(step, forms=(with_fall[0],))
    assert step.name not in alone.effects({step.name: only}, setting)
    assert step.name in possible.effects({step.name: only}, setting)


def test_gas_that_is_left_may_be_in_any_stage() -> None:
    possible, setting = on("sensor")
    carried = CATALOGUE["carry_over"]
    assert carried.stage not in possible.stages and possible.stage_of(carried) in possible.stages
    possible.check(carried, carried.forms[0], setting)
    valve = CATALOGUE["valve_asymmetry"]
    with pytest.raises(CampaignError, match="valve_asymmetry needs a stage called valve"):
        possible.check(valve, valve.forms[0], setting)


def test_words_speak_of_stages_that_are_there() -> None:
    alone, pair, valve = effects("sensor"), effects("filter and sensor"), effects("two sensors")
    for found in (alone, pair, valve):
        assert found["daq_filter"].same_response == MISSING_STAGE
    stroke = CATALOGUE["finite_stroke"]
    assert alone["finite_stroke"].sentence == INPUT_TAKES_TIME != stroke.sentence
    assert valve["finite_stroke"].sentence == stroke.sentence
    slow = CATALOGUE["slow_sorption"]
    assert alone["slow_sorption"].reveal == LONGER_STEP
    assert pair["slow_sorption"].reveal == slow.reveal
    twins = [name for name in pair if CATALOGUE[name].same_response and name != "daq_filter"]
    assert twins
    for name in twins:
        assert pair[name].same_response == OF_ANOTHER and not alone[name].same_response
        assert valve[name].same_response == CATALOGUE[name].same_response
    assert not pair["baseline_drift"].same_response
