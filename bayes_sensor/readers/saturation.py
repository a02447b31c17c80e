"""Samples that were clipped at a rail of the recorder.

A clipped stretch is a long run of one and the same extreme value in a signal that is noisy
everywhere else.  A quiet or noise-free signal stands still too, and a coarse converter repeats
its codes; neither is clipping.  So a run counts only where the unclipped samples near that level
have noise of at least 3/4 of the smallest step between values: then the next sample differs
half of the time or more, and a long run cannot be chance.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from bayes_sensor.campaign import BoolArray, FloatArray

NEAR = 0.35
"""part of the signal's range next to the rail, where its noise is judged"""
FEWEST = 30
"""samples needed to judge the noise"""
CHANCE = 1e-6
"""largest probability that a record without clipping is flagged"""
WINDOW = 101
"""samples over which clipped samples make their neighbours suspect"""
CROWDED = 0.1
"""part of the window that is clipped, above which the rest of it is left out too"""


def clipped_samples(y: FloatArray, used: BoolArray) -> BoolArray:
    """(n,) True where a used sample is clipped, or stands among many that are.

    ``+-inf`` is how some recorders write a sample beyond the range; it counts as clipped.
    """
    at_rail = np.isinf(y) & used
    finite = used & np.isfinite(y)
    values = y[finite]
    if len(values) >= FEWEST:
        index = np.flatnonzero(finite)
        for rail in (values.max(), values.min()):
            if _is_rail(values, rail):
                at_rail[index[values == rail]] = True
    if not at_rail.any():
        return at_rail
    window = min(WINDOW, len(y))
    share = np.convolve(at_rail.astype(float), np.ones(window) / window, mode="same")
    return (at_rail | (share > CROWDED)) & used


def _is_rail(values: FloatArray, rail: float) -> bool:
    """Whether the extreme value ``rail`` is held longer than noise allows."""
    low, high = float(values.min()), float(values.max())
    if not high > low:
        return False
    held = values == rail
    longest = _longest_run(held)
    if longest < 4:
        return False
    distance = np.abs(values - rail) / (high - low)
    near = (distance > 0) & (distance <= NEAR)
    noise, n = _noise(values, near)
    if n < FEWEST:
        # too steep to judge next to the rail; but noise grows with concentration, so the
        # baseline's noise (where the record starts) stands for the other rail at least
        if abs(values[0] - rail) < 0.5 * (high - low):
            return False
        noise, n = _noise(values, (distance >= 1 - NEAR) & (distance > 0))
        if n < FEWEST:
            return False
    least = _least_step(values)
    if noise < 0.75 * least:
        return False
    same = min(0.5, least / (2.0 * noise))
    return longest >= max(4.0, np.log(CHANCE / len(values)) / np.log(same))


def _noise(values: FloatArray, chosen: BoolArray) -> tuple[float, int]:
    """Spread of the fast noise from second differences, and how many of them there were.

    Only differences inside the chosen samples count.  A smooth ramp or a staircase has none;
    the quarter nearest zero is looked at as well, so that a few jumps do not make noise.
    """
    inside = chosen[2:] & chosen[1:-1] & chosen[:-2]
    bend = np.diff(values, 2)[inside]
    if len(bend) < FEWEST:
        return 0.0, len(bend)
    steps = np.diff(values)
    turns = (steps[1:] * steps[:-1] < 0)[inside]
    if turns.mean() < 0.1:
        return 0.0, len(bend)
    return float(1.4826 * np.median(np.abs(bend)) / np.sqrt(6.0)), len(bend)


def _least_step(values: FloatArray) -> float:
    """Smallest step between two values that occur: the converter's resolution.

    Rounding in the last digits can split one code in two, so steps below a thousandth of the
    median one are ignored.
    """
    steps = np.diff(np.unique(values))
    return float(steps[steps > 1e-3 * np.median(steps)].min())


def _longest_run(held: NDArray[np.bool_]) -> int:
    edges = np.flatnonzero(np.diff(np.concatenate(([False], held, [False])).astype(np.int8)))
    return int((edges[1::2] - edges[::2]).max()) if len(edges) else 0
