"""Remarks on the choice of the signal, from what else is in its file and in the campaign."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np

from bayes_sensor.campaign import CampaignError, FloatArray
from bayes_sensor.io.readers.campaign_file import ExperimentTable
from bayes_sensor.io.readers.recording import Recording, Selection, list_names
from bayes_sensor.io.readers.roles import is_set_point
from bayes_sensor.io.steps import Step, find_steps, large_ones

MOST = 6
"""other channels that are looked at"""
COPY = 0.9
"""correlation of the steps from sample to sample above which two channels are one: two sensors
have noise of their own"""
FEWEST_VALUES = 10
"""of a measurement; a channel of fewer is a command, a code or a counter"""


def signal_remarks(
    entry: ExperimentTable, recording: Recording, read: Callable[[Selection], Recording]
) -> list[str]:
    """Sentences on a set point or a constant column as the signal, and on a second sensor.

    ``read`` reads the same file with another choice.  Where the campaign names the signal, only
    its name and its values are questioned.
    """
    others = [name for name in recording.channels if name not in (recording.signal, entry.drive)]
    y = recording.y[np.isfinite(recording.y)]
    if not others or not len(y):
        return []
    signal = recording.signal[:60]
    if entry.signal is not None and is_set_point(recording.signal):
        return [
            f"the signal '{signal}' is called like a set point; set signal to the measured column, "
            f"one of {list_names(others, 6)}"
        ]
    if len(y) >= 100 and 1 < len(np.unique(y)) <= 3:
        return [
            f"the signal '{signal}' only jumps between {len(np.unique(y))} values, as a command "
            f"does; set signal to the measured column, one of {list_names(others, 6)}"
        ]
    constant = bool(y.min() == y.max())
    if entry.signal is not None and not constant:
        return []
    mine = [] if constant else large_ones(find_steps(*_finite(recording)))
    if not (constant or mine):
        return []
    moving = [name for name in others[:MOST] if _moves_with(mine, recording, name, entry, read)]
    if not moving:
        return []
    if constant:
        return [f"the signal '{signal}' never changes; set signal to {list_names(moving)}"]
    step = "steps" if len(moving) == 1 else "step"
    return [
        f"{list_names(moving)} {step} at the same time as '{signal}', which was taken as the "
        "signal; set signal to the sensor that is meant, or name all in signals = {..}"
    ]


def _moves_with(
    mine: Sequence[Step],
    signal: Recording,
    name: str,
    entry: ExperimentTable,
    read: Callable[[Selection], Recording],
) -> bool:
    """Whether a channel is measured and shows a step while the signal does; any, without one."""
    if is_set_point(name):
        return False
    try:
        t, y = _finite(read(Selection(name, None, entry.time, entry.interval)))
    except CampaignError:
        return False
    if len(np.unique(y)) < FEWEST_VALUES or _is_copy(y, _finite(signal)[1]):
        return False
    theirs = large_ones(find_steps(t, y))
    if not mine:
        return bool(theirs)
    return len(theirs) == len(mine) and all(map(_begin_together, mine, theirs))


def _is_copy(y: FloatArray, signal: FloatArray) -> bool:
    """Whether a channel has the noise of the signal, too, as its raw codes have."""
    if len(y) != len(signal):
        return False
    a, b = np.diff(y), np.diff(signal)
    return bool(a.std() > 0 and b.std() > 0 and abs(np.corrcoef(a, b)[0, 1]) > COPY)


def _begin_together(a: Step, b: Step) -> bool:
    """Whether two responses may be those of two lags to one gas: they begin at one time."""
    shorter = min(a.end - a.start, b.end - b.start)
    return a.sudden and b.sudden and abs(a.start - b.start) <= 0.5 * shorter


def _finite(recording: Recording) -> tuple[FloatArray, FloatArray]:
    known = np.isfinite(recording.y) & np.isfinite(recording.t)
    return recording.t[known], recording.y[known]


def column_remarks(entries: Sequence[ExperimentTable]) -> list[str]:
    """Remarks on experiments that read two columns of one file with the same commands: these may be
    two sensors, which as two experiments would share one tau."""
    found = []
    of_file: dict[str, list[ExperimentTable]] = {}
    for entry in entries:
        if entry.file is None or entry.signal is None:
            continue
        earlier = of_file.setdefault(entry.file, [])
        for other in earlier:
            one_run = all(
                getattr(entry, key) == getattr(other, key)
                for key in ("time", "keep", "commanded_on", "commanded_off", "steps")
            )
            if one_run and entry.signal != other.signal:
                found.append(
                    f"experiments '{other.name}' and '{entry.name}': two columns of {entry.file} "
                    "with the same commands; if they are two sensors on one gas, write one "
                    f'experiment with signals = {{A = "{other.signal}", B = "{entry.signal}"}}: '
                    "as two experiments they share one tau"
                )
                break
        earlier.append(entry)
    return found
