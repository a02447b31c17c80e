"""Steps of a record, found in the samples alone: when the signal leaves a level, and how far.

The record is averaged until its noise is small beside its range.  Turning points part it into legs
that rise or fall.  In a leg the time that the signal spends at each height tells whether it is one
step or several: a response of first-order lags slows down towards its end, so where it slows down
and then is fast again, another step began.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from statistics import NormalDist

import numpy as np
from numpy.typing import NDArray

from bayes_sensor.campaign import FloatArray

IntArray = NDArray[np.int64]

MOST_BLOCKS = 4000
"""blocks into which a record is averaged: enough to place a step within a thousandth of it"""
FEWEST = 16
"""blocks; of fewer no step is told"""
NOISE = 0.02
"""of the range: what averaging brings the noise down to"""
LEAST = 0.1
"""of the range: a smaller change is no step"""
WANDER = 8.0
"""times the noise: the extremes of a long record of noise are as far apart"""
HIDDEN = 0.8
"""of the range: where a step would have to be larger than that, all that is seen may be wander"""
PART = 100
"""parts of a record, over one of which its wander is measured"""
SHORTEST = 0.01
"""of the record: a level that is held for less is a transient"""
HEIGHTS = 20
"""parts of a leg, in which the time that is spent there is compared"""
FASTER = 4.0
"""times as fast as before, where another step began"""
HOLD = 0.5
"""of the time that a step took: a level within a rise that is held for less is noise"""
AS_LARGE = 0.4
"""of the largest step: a smaller one is not counted, as it may be a disturbance"""


@dataclass(frozen=True)
class Step:
    """A change of level."""

    start: float
    """s, when the signal was last seen at the level before"""
    tenth: float
    """s, when a tenth of the change was passed"""
    half: float
    """s, when half of it was passed"""
    end: float
    """s, when nine tenths of it were passed"""
    height: float
    """V, with its sign"""

    @property
    def sudden(self) -> bool:
        """Whether it slows down towards its end, as lags do; a drift does not."""
        return bool(self.half - self.tenth < 0.45 * (self.end - self.tenth))


def find_steps(t: FloatArray, y: FloatArray) -> tuple[Step, ...]:
    """Steps of a record, in time.

    Parameters
    ----------
    t, y
        (n,) s and V, finite samples in use.

    Returns
    -------
    tuple of Step
        Empty where the noise is as large as what happens, or nothing happens.

    Examples
    --------
    >>> t = np.linspace(0.0, 100.0, 2001)
    >>> y = np.where(t > 20.0, 1.0 - np.exp(-(t - 20.0) / 5.0), 0.0)
    >>> [(round(step.half, 1), round(step.height, 2)) for step in find_steps(t, y)]
    [(23.5, 1.0)]
    """
    t, y = _averaged(t, y)
    if len(t) < FEWEST:
        return ()
    t, y, noise = _smooth(t, y)
    span = float(np.ptp(y)) if len(y) else 0.0
    if not span > 0 or not noise <= 2 * NOISE * span:
        return ()
    wander = _wander(y)
    least = max(LEAST * span, WANDER * max(noise, wander))
    if least > HIDDEN * span:
        return ()
    noise = max(noise, wander)
    turns = _turning_points(y, least)
    steps: list[Step] = []
    for first, last in pairwise(turns):
        sign = 1.0 if y[last] > y[first] else -1.0
        for a, b in _parts(sign * y[first : last + 1], least):
            found = _step(t, y, first + a, first + b, steps[-1].end if steps else -np.inf, noise)
            if found is not None:
                steps.append(found)
    return _held(t, y, steps, least)


def largest_change(t: FloatArray, y: FloatArray) -> float:
    """V, from the lowest to the highest of what :func:`find_steps` sees of a record."""
    _, means, _ = _smooth(*_averaged(t, y))
    return float(np.ptp(means)) if len(means) else 0.0


def large_ones(steps: Sequence[Step]) -> list[Step]:
    """Those that are as large as :data:`AS_LARGE` says."""
    largest = max((abs(step.height) for step in steps), default=0.0)
    return [step for step in steps if abs(step.height) >= AS_LARGE * largest]


def _wander(y: FloatArray) -> float:
    """V, standard deviation of what a record does over a hundredth of its length, steps apart.

    From the median of its changes, or from their lower quartile where that says less: in a train of
    pulses the signal moves for most of the time.
    """
    apart = max(len(y) // PART, 1)
    changes = np.abs(y[apart:] - y[:-apart]) / np.sqrt(2.0)
    ends = [NormalDist().inv_cdf(p) for p in (0.75, 0.625)]
    return float(np.min(np.percentile(changes, [50, 25]) / ends))


def _held(t: FloatArray, y: FloatArray, steps: list[Step], least: float) -> tuple[Step, ...]:
    """The steps between levels that are held; a spike and its return are none."""
    if not steps:
        return ()
    widths = np.diff([step.half for step in steps])
    shortest = SHORTEST * float(t[-1] - t[0])
    if len(widths) > 2:  # a train of short pulses
        shortest = min(shortest, 0.25 * float(np.median(widths)))
    level = _level(y[t <= steps[0].start], y[:1])
    held: list[Step] = []
    group: list[Step] = []
    for i, step in enumerate(steps):
        group.append(step)
        if i + 1 < len(steps) and widths[i] < shortest:
            continue
        end = steps[i + 1].start if i + 1 < len(steps) else float(t[-1])
        late = (t >= max(step.end, (step.half + end) / 2)) & (t <= end)
        there = _level(y[late], y[t <= end][-1:])
        change = there - level
        if abs(change) >= least:
            # the largest that goes that way, and its times; the change as a whole
            same = [one for one in group if one.height * change > 0] or group
            held.append(replace(max(same, key=lambda one: abs(one.height)), height=change))
            level = there
        group = []
    return tuple(held)


def _level(y: FloatArray, otherwise: FloatArray) -> float:
    return float(np.median(y if len(y) else otherwise))


def _averaged(t: FloatArray, y: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Times and means of at most MOST_BLOCKS blocks, single outliers taken out."""
    if len(t) > MOST_BLOCKS:
        edges = np.linspace(0, len(t), MOST_BLOCKS + 1).astype(np.int64)
        counts = np.diff(edges)
        t = np.add.reduceat(t, edges[:-1]) / counts
        y = np.add.reduceat(y, edges[:-1]) / counts
    if len(y) >= 5:
        y = np.median(np.lib.stride_tricks.sliding_window_view(np.pad(y, 1, "edge"), 3), axis=1)
    return t, y


def _smooth(t: FloatArray, y: FloatArray) -> tuple[FloatArray, FloatArray, float]:
    """Times, running means and their noise (V), over the fewest blocks that make it small."""
    total = np.concatenate(([0.0], np.cumsum(y - y[0])))
    times = np.concatenate(([0.0], np.cumsum(t)))
    h = 1
    while True:
        means = (total[h:] - total[:-h]) / h + y[0]
        # neighbours that share no block; where most of the record is a response, this is too much
        noise = 1.4826 * float(np.median(np.abs(means[h:] - means[:-h]))) / np.sqrt(2.0)
        span = float(np.ptp(means))
        if noise <= NOISE * span or h * FEWEST > len(y):
            return (times[h:] - times[:-h]) / h, means, noise
        h *= 2


def _turning_points(y: FloatArray, least: float) -> list[int]:
    """Places of the extremes between which the signal moves by ``least`` or more."""
    low = high = 0
    turns: list[int] = []
    direction = 0
    for i, value in enumerate(y):
        if direction >= 0 and value > y[high]:
            high = i
        if direction <= 0 and value < y[low]:
            low = i
        if direction == 0:
            high = i if value > y[high] else high
            low = i if value < y[low] else low
            if y[high] - y[low] >= least:
                direction = 1 if high > low else -1
                turns.append(min(low, high))
        elif direction > 0 and y[high] - value >= least:
            turns.append(high)
            direction, low = -1, i
        elif direction < 0 and value - y[low] >= least:
            turns.append(low)
            direction, high = 1, i
    if direction:
        turns.append(high if direction > 0 else low)
    return turns


def _parts(rise: FloatArray, least: float) -> list[tuple[int, int]]:
    """Places of first and last block of each step of a leg that rises."""
    whole = [(0, len(rise) - 1)]
    height = float(rise[-1] - rise[0])
    n = min(HEIGHTS, int(height / least * 4))
    if n < 4:
        return whole
    top = np.maximum.accumulate(rise) - rise[0]
    marks = height * np.arange(1, n) / n
    passed = np.searchsorted(top, marks)
    spent = np.diff(np.concatenate(([0], passed, [len(rise) - 1]))) + 1
    cuts: list[int] = []
    begin = 0  # the part of the height at which the step before ends
    for i in range(1, n - 1):
        low = marks[begin - 1] if begin else 0.0
        if marks[i] - low < least or height - marks[i - 1] < least:
            continue
        fast = max(_least_before(spent[i + 1 :], spent[i]),
                   _least_before(spent[begin:i][::-1], spent[i]))  # fmt: skip
        if spent[i] >= FASTER * fast and spent[i] >= HOLD * spent[begin:i].sum():
            cuts.append(i)
            begin = i + 1
    if not cuts:
        return whole
    # a plateau lies within its part of the height: the signal leaves it where that part ends
    places = [0, *(int(passed[i]) - 1 for i in cuts), len(rise) - 1]
    return [(a, b) for a, b in pairwise(places) if b > a]


def _least_before(spent: IntArray, limit: int) -> float:
    """The least of ``spent`` before it first exceeds ``limit``; infinite where that is at once."""
    beyond = np.flatnonzero(spent > limit)
    part = spent[: beyond[0]] if len(beyond) else spent
    return float(part.min()) if len(part) else np.inf


def _step(
    t: FloatArray, y: FloatArray, first: int, last: int, after: float, noise: float
) -> Step | None:
    """The step between two places; ``after`` (s): the end of the step before it."""
    height = float(y[last] - y[first])
    sign = np.sign(height)
    way = np.maximum.accumulate(sign * (y[first : last + 1] - y[first])) / abs(height)
    # first guesses from the turning point, which in noise lies beyond the level before
    tenth, half, end = (first + int(np.searchsorted(way, share)) for share in (0.1, 0.5, 0.9))
    # the level before: a quarter of the quiet time, not too near
    begin = int(np.searchsorted(t, max(after, t[0])))
    near = max(tenth - (half - tenth), begin)
    far = near - max((near - begin) // 4, 1)
    level = float(np.median(y[max(far, 0) : near])) if near > max(far, 0) else float(y[first])
    if abs(level - y[first]) > 0.1 * abs(height):
        level = float(y[first])
    below = np.flatnonzero(sign * (y[begin:half] - level) < 0.1 * abs(float(y[last] - level)))
    tenth = min(begin + int(below[-1]) + 1, half) if len(below) else tenth
    away = sign * (y[begin : tenth + 1] - level) > max(0.02 * abs(height), 3.0 * noise)
    quiet = np.flatnonzero(~away)
    start = begin + int(quiet[-1]) if len(quiet) else begin
    return Step(
        float(t[start]), float(t[tenth]), float(t[half]), float(t[end]), float(y[last] - level)
    )
