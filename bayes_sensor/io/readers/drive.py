"""The valve's drive signal: when it was commanded open and shut."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from bayes_sensor.campaign import CampaignError, FloatArray

SHORTEST = 3
"""samples; a drive level held for less is a glitch"""
MOST_BETWEEN = 0.3
"""share of the samples that may lie in the middle third between the levels"""


def drive_edges(
    t: FloatArray, drive: FloatArray, error: Callable[[str], CampaignError]
) -> tuple[list[float], bool]:
    """Times in s of all edges, up and down in turn, and whether the drive starts high.

    The levels are the extremes after a median filter of five samples; the state changes above
    two thirds and below one third of the way between them, and an edge is dated by the first
    sample beyond the middle.

    Raises
    ------
    CampaignError
        If there is no edge.
    """
    finite = np.isfinite(drive)
    if finite.sum() < 5:
        raise error(
            f"the drive has {int(finite.sum())} finite samples; expected a recorded valve signal: "
            "give commanded_on instead of drive"
        )
    if not finite.all():
        drive = np.interp(t, t[finite], drive[finite])
    smooth = np.median(np.lib.stride_tricks.sliding_window_view(np.pad(drive, 2, "edge"), 5), 1)
    low, high = float(smooth.min()), float(smooth.max())
    noise = 1.4826 * float(np.median(np.abs(np.diff(smooth)))) / np.sqrt(2.0)
    if not (high - low > 8.0 * noise and high > low and np.isfinite(high - low)):
        raise error(
            f"the drive shows no edge (it stays between {low:.4g} and {high:.4g}); expected it to "
            "rise when the valve opens: choose another channel, or give commanded_on instead"
        )
    between = (smooth > low + (high - low) / 3) & (smooth < low + (high - low) * 2 / 3)
    if between.mean() > MOST_BETWEEN:
        raise error(
            f"the drive shows no edge between two levels ({100 * between.mean():.0f} % of its "
            f"samples lie in the middle between {low:.4g} and {high:.4g}); choose another channel, "
            "or give commanded_on instead"
        )
    state = np.full(len(smooth), -1)
    state[smooth > low + (high - low) * 2 / 3] = 1
    state[smooth < low + (high - low) / 3] = 0
    known = np.maximum.accumulate(np.where(state >= 0, np.arange(len(state)), 0))
    state = state[known]
    state[state < 0] = state[state >= 0][0]  # between the thresholds at the very start
    starts, levels = _steady_runs(state)
    if len(levels) == 1:
        raise error(
            f"the drive shows no edge that lasts {SHORTEST} samples (levels {low:.4g} and "
            f"{high:.4g}); choose another channel, or give commanded_on instead"
        )
    middle = (low + high) / 2
    times = [round(float(t[_crossing(smooth, int(i), middle)]), 9) for i in starts[1:]]
    return times, bool(levels[0] == 1)


def _steady_runs(state: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Start and level of each run of equal state, glitches removed."""
    starts = np.concatenate(([0], np.flatnonzero(np.diff(state)) + 1))
    lengths = np.diff(np.concatenate((starts, [len(state)])))
    steady = lengths >= SHORTEST
    if not steady.any():
        return starts[:1], state[:1]
    starts = starts[steady]
    levels = state[starts]
    first = np.concatenate(([True], np.diff(levels) != 0))
    return starts[first], levels[first]


def _crossing(smooth: np.ndarray, start: int, middle: float) -> int:
    """The first sample on the new side of the middle, at or before ``start``."""
    above = bool(smooth[start] > middle)
    while start > 0 and bool(smooth[start - 1] > middle) == above:
        start -= 1
    return start
