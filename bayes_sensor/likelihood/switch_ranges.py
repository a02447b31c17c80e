"""Where each switch time of a record may lie, by its commands."""

from __future__ import annotations

import numpy as np

from bayes_sensor.campaign import Experiment


def step_begin(e: Experiment) -> float:
    """s, the first command; the start of the record where none is known."""
    return float(e.t[0]) if e.commanded_on is None else e.commanded_on


def step_end(e: Experiment) -> float:
    """s, the command after the first; the end of the record where there is none."""
    if e.commands is not None and not e.commands.recorded and len(e.commands.times) > 1:
        return float(e.commands.times[1])
    return float(e.t[-1]) if e.commanded_off is None else e.commanded_off


def after_step(e: Experiment) -> tuple[float, float]:
    """s, from the end of the first step to the next command, where the input goes back meanwhile;
    else an empty stretch."""
    begin, end, done = step_end(e), float(e.t[-1]) + e.interval, e.commands
    if done is not None:
        times = done.times
        if done.recorded or len(times) < 2 or done.heights[0] * done.heights[1] > 0.0:
            return begin, begin
        end = float(times[2]) if len(times) > 2 else end
    return begin, max(begin, end)


def switch_ranges(e: Experiment) -> list[tuple[float, float]]:
    """s, lowest and highest value of each parameter that moves the record's switches.

    A switch comes after its command and before the next one. A delay that several switches share
    is shorter than the shortest time between two commands of the record. The input that a recorder
    saw may come late or early against the signal by up to a quarter of the record.
    """
    end, done = float(e.t[-1]), e.commands
    if done is None:
        ranges = [(step_begin(e), step_end(e)), (step_end(e), end)]
        return ranges[: 1 + e.has_fall]
    if done.recorded:
        quarter = 0.25 * (end - float(e.t[0]))
        return [(-quarter, quarter)]
    times = np.append(done.times, max(end, float(done.times[-1]) + e.interval))
    if done.delays == "free":
        return list(zip(times[:-1].tolist(), times[1:].tolist(), strict=True))
    shortest = float(np.diff(times).min())
    up = done.heights > 0.0
    return [(0.0, shortest)] * (int(up.any()) + int((~up).any()))
