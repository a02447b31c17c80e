"""Samples that were clipped at a rail of the recorder.

A clipped stretch is a long run of the same extreme value.  A quiet or noise-free signal is
constant, too, and a coarse converter repeats its codes; neither is clipping.  So a run counts for
one of two reasons:

- noise: the unclipped samples near that level have noise of at least 3/4 of the smallest step
  between values.  Then the next sample differs half of the time or more, and a long run cannot
  be chance.
- a kink: the signal runs into the level at nearly full speed and stands still at once.  A cascade
  of lags closes the second half of the remaining way logarithmically, in
  ``tau * log(d / resolution)``, the first half in ``tau * log(2)``; a clipped one takes about as
  long for both.
"""

from __future__ import annotations

import numpy as np

from bayes_sensor.campaign import BoolArray, FloatArray
from bayes_sensor.experiment import runs_of

NEAR = 0.35
"""part of the signal's range next to the rail, where its noise is measured"""
FEWEST = 30
"""samples needed to measure the noise"""
CHANCE = 1e-6
"""largest probability that a record without clipping is flagged"""
ABRUPT = 0.4
"""share of the time that a lag needs for the second half of its approach; less is a kink"""
WINDOW = 50
"""samples before and after a sample in which clipped ones make it suspicious"""
CROWDED = 0.1
"""part of either window that is clipped, above which a sample between them is left out too"""


def clipped_samples(y: FloatArray, used: BoolArray) -> BoolArray:
    """(n,) True where a used sample is clipped, or is among many that are.

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
    # noise dips below the rail where the plateau is clipped: what is left there is not fair
    counts = np.concatenate(([0], np.cumsum(at_rail)))
    i = np.arange(len(y))
    before = counts[i] - counts[np.maximum(i - WINDOW, 0)]
    after = counts[np.minimum(i + 1 + WINDOW, len(y))] - counts[i + 1]
    crowded = np.minimum(before, after) > CROWDED * WINDOW
    clipped: BoolArray = (at_rail | crowded) & used
    return clipped


def _is_rail(values: FloatArray, rail: float) -> bool:
    """Whether the extreme value ``rail`` lasts longer than noise allows."""
    low, high = float(values.min()), float(values.max())
    if not high > low:
        return False
    held = values == rail
    starts, ends = runs_of(held).T
    longest = int((ends - starts).max())
    if longest < 4:
        return False
    distance = np.abs(values - rail) / (high - low)
    least = _least_step(values)
    return _too_quiet(values, distance, longest, least) or _runs_into(
        distance, held, least / (high - low)
    )


def _too_quiet(values: FloatArray, distance: FloatArray, longest: int, least: float) -> bool:
    """Whether the noise next to the rail rules out a run of this length."""
    noise = _noise(values, (distance > 0) & (distance <= NEAR))
    if distance[0] >= 0.5:
        # noise does not shrink with concentration, so the baseline's (where the record starts)
        # stands for the other rail, where the signal may be too steep to judge
        noise = max(noise, _noise(values, distance >= 1 - NEAR))
    if noise < 0.75 * least:
        return False
    same = min(0.5, least / (2.0 * noise))
    return longest >= max(4.0, float(np.log(CHANCE / len(distance)) / np.log(same)))


def _runs_into(distance: FloatArray, held: BoolArray, resolution: float) -> bool:
    """Whether the signal stops at the rail in a kink; distances are in parts of the range."""
    starts, ends = runs_of(held).T
    for start, end in zip(starts[ends - starts >= 100], ends[ends - starts >= 100], strict=True):
        far = np.flatnonzero(distance[:start] > NEAR)
        if not len(far):
            continue
        half = int(np.flatnonzero(distance[:start] > NEAR / 2)[-1])
        first, second = half - int(far[-1]), int(start) - half
        lag = np.log(NEAR / 2 / resolution) / np.log(2.0)
        if first >= 10 and end - start >= 3 * (first + second) and second < ABRUPT * lag * first:
            return True
    return False


def _noise(values: FloatArray, chosen: BoolArray) -> float:
    """Spread of the fast noise among the chosen samples, from second differences.

    It is 0 if there are too few samples, or if the signal rarely reverses, as on a smooth ramp or a
    staircase.
    """
    inside = chosen[2:] & chosen[1:-1] & chosen[:-2]
    bend = np.diff(values, 2)[inside]
    if len(bend) < FEWEST:
        return 0.0
    steps = np.diff(values)
    turns = (steps[1:] * steps[:-1] < 0)[inside]
    return float(1.4826 * np.median(np.abs(bend)) / np.sqrt(6.0)) if turns.mean() >= 0.1 else 0.0


def _least_step(values: FloatArray) -> float:
    """Smallest step between two values that occur: the converter's resolution.

    Rounding in the last digits can split one code in two, so steps below a thousandth of the
    median one are ignored.
    """
    steps = np.diff(np.unique(values))
    return float(steps[steps > 1e-3 * np.median(steps)].min())
