"""Remarks where the steps that are seen in a record do not agree with the commands given for it."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from bayes_sensor.campaign import Experiment
from bayes_sensor.io.steps import Step, find_steps, large_ones

RETURN = 0.8
"""of a step: where less comes back at once, the step overshot, which is no second step"""


def step_remarks(e: Experiment, where: str, *, falls_back: bool = False) -> list[str]:
    """Sentences on a command later than its step, and on more steps than commands.

    ``falls_back``: whether it was said already that a fall has no command.
    """
    if e.y is None or (e.commands is not None and e.commands.recorded):
        return []
    steps = find_steps(e.t[e.used], e.y[e.used])
    if not steps:
        return []
    large = large_ones(steps)
    steps = tuple(
        step
        for before, step in zip((None, *steps), steps)
        if step in large and not _settles(before, step)
    )
    late = _late(e, steps, where)
    return late or ([] if falls_back else _uncommanded(e, steps, where))


def commands_of(e: Experiment) -> list[tuple[str, float]]:
    """Key and time (s) of every command, in time; none where the input was recorded."""
    if e.commands is not None:
        return [] if e.commands.recorded else [("a command", float(t)) for t in e.commands.times]
    told = (("commanded_on", e.commanded_on), ("commanded_off", e.commanded_off))
    return [(key, time) for key, time in told if time is not None]


def _settles(before: Step | None, step: Step) -> bool:
    """Whether a step takes back a part of the one before, which was held for no time."""
    if (
        before is None
        or not -RETURN * abs(before.height) < step.height * np.sign(before.height) < 0
    ):
        return False
    return step.start - before.end < before.end - before.start


def _late(e: Experiment, steps: Sequence[Step], where: str) -> list[str]:
    """A remark if the signal has passed a tenth of a step before the step was commanded."""
    remarks = []
    commands = commands_of(e)
    # of a programme each step has a command only where none is small, merged or a disturbance
    if len(steps) > max(len(commands), 2) or (
        e.commands is not None and len(steps) != len(commands)
    ):
        return []
    for (key, command), mine in zip(commands, steps):
        if mine.tenth < command - e.interval:
            remarks.append(
                f"{where}: {key} = {command:.10g} s comes after the step that it commands, whose "
                f"first tenth is over at {mine.tenth:.6g} s; correct {key}, because a command "
                "that is too late makes the lags too short"
            )
    return remarks


def _uncommanded(e: Experiment, steps: Sequence[Step], where: str) -> list[str]:
    """A remark if there are more steps than commands."""
    n_commands = len(commands_of(e))
    if len(steps) <= max(n_commands, 1):
        return []
    shown = ", ".join(f"{step.half:.6g}" for step in steps[:6]) + (", .." if len(steps) > 6 else "")
    given = {0: "none is", 1: "one is"}.get(n_commands, f"{n_commands} are")
    crop = f'keep = ["{e.t[0]:.6g} s", "{steps[max(n_commands, 1)].start:.6g} s"] or the like'
    return [
        f"{where}: {len(steps)} steps are seen (half way at {shown} s), but {given} commanded; "
        f"crop with {crop}, or give the commands that are missing"
    ]
