"""Commands that do not agree with the steps of their record; silence where they do."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from bayes_sensor.campaign import Experiment
from bayes_sensor.experiment import Commands
from bayes_sensor.io.step_remarks import step_remarks

T = np.round(0.01 * np.arange(9000), 6)


def record(steps: list[tuple[float, float]], lag: float = 1.0, **changes: object) -> Experiment:
    """A first-order response to changes of height at times, with noise."""
    y = np.random.default_rng(3).normal(0.2, 0.03, len(T))
    for start, height in steps:
        y += height * np.where(T > start, -np.expm1(-np.maximum(T - start, 0.0) / lag), 0.0)
    plain = Experiment("1", T, y, 60.0, 10.0, 0.01)
    return replace(plain, **changes)  # type: ignore[arg-type]


PULSE = [(20.0, 1.0), (60.0, -1.0)]


@pytest.mark.parametrize("lag", [0.05, 1.0, 8.0])
def test_commands_before_their_steps_are_not_remarked_on(lag: float) -> None:
    for on, off in ((20.0, 60.0), (18.0, 59.0), (20.0 + 0.02 * lag, 60.0)):
        assert step_remarks(record(PULSE, lag, commanded_on=on, commanded_off=off), "x") == []


@pytest.mark.parametrize("late", [0.6, 10.0])
@pytest.mark.parametrize("key", ["commanded_on", "commanded_off"])
def test_a_command_later_than_its_step_is_named(key: str, late: float) -> None:
    commands = {"commanded_on": 20.0, "commanded_off": 60.0}
    commands[key] += late
    (said,) = step_remarks(record(PULSE, **commands), "experiment '1'")
    assert said.startswith(f"experiment '1': {key} = {commands[key]:.10g} s comes after the step")
    assert f"correct {key}" in said


@pytest.mark.parametrize(
    ("commands", "words"),
    [
        ({"commanded_on": 10.0}, "3 steps are seen (half way at 10."),
        ({"commanded_on": 10.0}, "but one is commanded; crop with keep"),
        ({"commanded_on": 10.0, "commanded_off": 50.0}, "but 2 are commanded"),
        ({}, "but none is commanded"),
    ],
)
def test_more_steps_than_commands(commands: dict[str, float], words: str) -> None:
    (said,) = step_remarks(record([(10.0, 1.0), (30.0, 0.8), (50.0, -1.8)], **commands), "x")
    assert words in said


def test_a_small_disturbance_an_overshoot_and_an_unknown_command_are_left_alone() -> None:
    bump = [*PULSE, (40.0, 0.2)]
    assert step_remarks(record(bump, commanded_on=19.0, commanded_off=59.0), "x") == []
    overshoot = record([(20.0, 1.5)], 0.3, commanded_on=19.0)
    decay = 0.6 * np.where(T > 22.0, -np.expm1(-np.maximum(T - 22.0, 0) / 2.0), 0.0)
    assert step_remarks(replace(overshoot, y=overshoot.values - decay), "x") == []
    assert step_remarks(record([(20.0, 1.0)]), "x") == []
    assert step_remarks(record(PULSE, commanded_on=19.0), "x", falls_back=True) == []
    assert step_remarks(replace(record(PULSE), y=None), "x") == []


def test_a_pulse_of_a_train_without_its_commands_is_remarked_on() -> None:
    switches = [10.0, 20.0, 30.0, 40.0, 50.0, 60.0]
    steps = [(at, 1.0 if i % 2 == 0 else -1.0) for i, at in enumerate(switches)]

    def commanded(times: list[float]) -> Commands:
        return Commands(np.array(times), np.tile([1.0, 0.0], len(times) // 2))

    assert step_remarks(record(steps, commands=commanded(switches)), "x") == []
    (said,) = step_remarks(record(steps, commands=commanded(switches[:2] + switches[4:])), "x")
    assert "6 steps are seen" in said and "4 are commanded" in said
    (late,) = step_remarks(record(steps, commands=commanded([13.0, *switches[1:]])), "x")
    assert "13 s comes after the step that it commands" in late
    # a small step of a staircase, which is not counted, moves no command to another step
    stairs = [(10.0, 1.0), (30.0, 0.2), (50.0, 1.0)]
    told = Commands(np.array([10.0, 30.0, 50.0]), np.array([1.0, 1.2, 2.2]))
    assert step_remarks(record(stairs, commands=told), "x") == []
