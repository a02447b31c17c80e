"""Remarks where the steps that are seen in a record do not agree with the commands given for it."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from bayes_sensor.campaign import Experiment
from bayes_sensor.io.steps import Step, find_steps

AS_LARGE = 0.4
"""of the largest step: a smaller one is not counted, as it may be a disturbance"""
RETURN = 0.8
"""of a step: where less comes back at once, the step overshot, which is no second step"""


def step_remarks(e: Experiment, where: str, *, falls_back: bool = False) -> list[str]:
    """Sentences on a command later than its step, and on more steps than commands.

    ``falls_back``: whether it was said already that a fall has no command.
    """
    if e.y is None:
        return []
    steps = find_steps(e.t[e.used], e.y[e.used])
    if not steps:
        return []
    largest = max(abs(step.height) for step in steps)
    steps = tuple(
        step
        for before, step in zip((None, *steps), steps)
        if abs(step.height) >= AS_LARGE * largest and not _settles(before, step)
    )
    late = _late(e, steps, where)
    return late or ([] if falls_back else _uncommanded(e, steps, where))


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
    on, off = e.commanded_on, e.commanded_off
    remarks = []
    for key, command, mine in (
        ("commanded_on", on, steps[0]),
        ("commanded_off", off, steps[1] if len(steps) > 1 else None),
    ):
        if command is None or mine is None or len(steps) > 2:
            continue
        if mine.tenth < command - e.interval:
            remarks.append(
                f"{where}: {key} = {command:.10g} s comes after the step that it commands, whose "
                f"first tenth is over at {mine.tenth:.6g} s; correct {key}, because a command "
                "that is too late makes the lags too short"
            )
    return remarks


def _uncommanded(e: Experiment, steps: Sequence[Step], where: str) -> list[str]:
    """A remark if there are more steps than commands."""
    n_commands = sum(time is not None for time in (e.commanded_on, e.commanded_off))
    if len(steps) <= max(n_commands, 1):
        return []
    shown = ", ".join(f"{step.half:.6g}" for step in steps[:6]) + (", .." if len(steps) > 6 else "")
    given = {0: "none is", 1: "one is"}.get(n_commands, f"{n_commands} are")
    crop = f'keep = ["{e.t[0]:.6g} s", "{steps[max(n_commands, 1)].start:.6g} s"] or the like'
    return [
        f"{where}: {len(steps)} steps are seen (half way at {shown} s), but {given} commanded; "
        f"crop with {crop}, or give the commands that are missing"
    ]
