"""Remarks on the times, from what else in the file counts time, and from their size."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from bayes_sensor.campaign import CampaignError, FloatArray
from bayes_sensor.io.readers.campaign_file import ExperimentTable
from bayes_sensor.io.readers.recording import Recording, Selection
from bayes_sensor.io.readers.table import FIRST_DAY, LAST_DAY

MOST = 4
"""other times that are looked at"""
LIKE = 0.01
"""share by which the lengths of one record by two clocks may differ"""


def time_remarks(
    entry: ExperimentTable, recording: Recording, read: Callable[[Selection], Recording]
) -> list[str]:
    """Sentences on times that contradict each other, and on days that were taken as seconds.

    ``read`` reads the same file with another choice.  A campaign that names the times, or states
    the interval, has chosen.
    """
    found = []
    t = recording.t[np.isfinite(recording.t)]
    unstated = recording.interval is None and recording.clock is None and not recording.timed
    if unstated and len(t) > 1 and t[0] >= FIRST_DAY and t[-1] - t[0] < 1.0:
        fix = "convert them to seconds"
        if t[-1] <= LAST_DAY:  # those of MATLAB and of astronomers are larger still
            fix = f"call them datetime, so that they are read as days, or {fix}"
        found.append(
            f"the times run from {t[0]:.10g} to {t[-1]:.10g} and were taken as seconds, but look "
            f"like days; {fix}"
        )
    if entry.time is not None or entry.interval is not None:
        return found
    for name in recording.times[:MOST]:
        try:
            other = read(Selection(entry.signal, None, name, None))
        except CampaignError:
            continue
        if not bool((np.diff(other.t) > 0).all()):
            continue  # as milliseconds beside whole seconds, which begin again
        lasts, coarse = _length_and_step(other.t)
        taken, step = _length_and_step(recording.t)
        if abs(lasts - taken) > LIKE * max(lasts, taken) + max(coarse, step):
            found.append(
                f"'{name[:60]}' counts time, too, but by it the record lasts {lasts:.6g} s, and by "
                f"the times that were taken {taken:.6g} s; set time to the right one"
            )
    return found


def _length_and_step(t: FloatArray) -> tuple[float, float]:
    """s, from the first sample to the last, and the usual step between times that differ."""
    known = t[np.isfinite(t)]
    if len(known) < 2:
        return 0.0, 0.0
    step = np.abs(np.diff(known))
    return float(known[-1] - known[0]), float(np.median(step[step > 0])) if step.any() else 0.0
