"""From written times to one uniform grid: the sampling interval, jitter and dropped samples."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from bayes_sensor.campaign import CampaignError, FloatArray
from bayes_sensor.io.readers.recording import MAX_SAMPLES

MOST_JITTER = 0.3
"""share of the interval; times further than this from the uniform grid are not uniform sampling"""
LATEST = 1e12
"""s, far above the value of any clock"""
NOTED_JITTER = 0.05
"""share of the interval; jitter above this is mentioned, unless the written digits explain it"""


@dataclass(frozen=True, eq=False)
class Grid:
    """A uniform grid ``start + i * interval`` and the place of each written sample on it."""

    start: float
    """s"""
    interval: float
    """s"""
    index: NDArray[np.int64]
    """(n,) position of each written sample, strictly increasing from 0"""
    jitter: float
    """largest distance of a written time from its grid point, in intervals"""
    rounded: bool
    """whether the number of written digits explains the jitter"""


def simplest_near(value: float, tolerance: float) -> float:
    """The decimal number with fewest digits within the tolerance, or one over such a number.

    >>> simplest_near(0.00099998, 1e-7), simplest_near(0.00033333, 1e-8)
    (0.001, 0.0003333333333333333)
    """
    if value == 0.0 or abs(value) <= tolerance:
        return 0.0
    for digits in range(1, 16):
        for candidate in (float(f"{value:.{digits}g}"), 1.0 / float(f"{1.0 / value:.{digits}g}")):
            if abs(candidate - value) <= tolerance:
                return candidate
    return value


def uniform_grid(
    t: FloatArray, place: Callable[[int], str], error: Callable[[str], CampaignError]
) -> Grid:
    """The uniform grid through written times.

    Raises
    ------
    CampaignError
        If a time is not finite, times do not increase strictly or are not uniform.
    """
    if len(t) < 2:
        raise error(f"expected at least 2 samples, but got {len(t)}; record longer")
    bad = ~np.isfinite(t)
    if bad.any():
        i = int(np.argmax(bad))
        raise error(f"{place(i)}: the time is {t[i]}; expected a number: repair or remove that row")
    with np.errstate(over="ignore"):
        step = np.diff(t)
    if not np.isfinite(step).all():
        i = int(np.argmax(~np.isfinite(step)))
        raise error(f"{place(i + 1)}: the time {t[i + 1]:g} s is out of all proportion; repair it")
    if (step <= 0).any():
        i = int(np.argmax(step <= 0))
        repeated = int((step == 0).sum())
        fix = (
            "export times with more digits"
            if repeated > 0.2 * len(t)
            else "drop the repeated rows"
            if step[i] == 0
            else "sort the rows by time or split the file where the clock restarts"
        )
        raise error(
            f"time must increase strictly, but {place(i + 1)} ({t[i + 1]:.10g} s) follows "
            f"{place(i)} ({t[i]:.10g} s); {fix}"
        )
    interval = float(np.median(step))
    single = np.abs(step - interval) < 0.5 * interval
    interval = float(step[single].mean())
    for _ in range(5):
        with np.errstate(over="ignore"):
            counts = np.maximum(np.rint(step / interval), 1.0)
        if not counts.max() < MAX_SAMPLES or counts.sum() > MAX_SAMPLES:
            i = int(np.argmax(step))
            raise error(
                f"the time jumps from {t[i]:.10g} s to {t[i + 1]:.10g} s at {place(i + 1)}, "
                f"{step[i] / interval:.4g} sampling intervals; split the file there or use keep"
            )
        index = np.concatenate(([0], np.cumsum(counts).astype(np.int64)))
        slope, origin = _line(index, t)
        if slope <= 0 or abs(slope / interval - 1) < 1e-12:
            break
        interval = slope
    if not max(abs(float(t[0])), abs(float(t[-1]))) < LATEST:
        raise error(
            f"the times run from {t[0]:g} s to {t[-1]:g} s, out of all proportion; expected "
            "seconds since the recording began or since an epoch: repair them"
        )
    off = np.abs(t - (origin + index * interval))
    worst = int(np.argmax(off))
    jitter = float(off[worst] / interval)
    if jitter > MOST_JITTER:
        raise error(
            f"expected one sampling interval, but the steps in time range from {step.min():.6g} s "
            f"to {step.max():.6g} s and {place(worst)} ({t[worst]:.10g} s) is "
            f"{jitter:.2g} intervals off a uniform grid; resample the recording or split it"
        )
    least = 1e-9 * interval
    # a change of the interval moves the last sample by n times as much
    exact = simplest_near(interval, max(off[worst], least) / max(int(index[-1]), 1))
    start = float(t[0]) if jitter < 0.01 else simplest_near(origin, max(off[worst], least))
    return Grid(start, exact, index, jitter, off[worst] <= 0.51 * _resolution(t))


def _line(index: NDArray[np.int64], t: FloatArray) -> tuple[float, float]:
    """Slope and intercept of the least-squares line."""
    x = index.astype(np.float64)
    x_mean, t_mean = x.mean(), t.mean()
    # sums rather than dot products: exact enough, and no thread pool is woken for them
    slope = float(((x - x_mean) * (t - t_mean)).sum() / ((x - x_mean) ** 2).sum())
    return slope, float(t_mean - slope * x_mean)


def _resolution(t: FloatArray) -> float:
    """Value, in s, of the last decimal the times were written with."""
    for decimals in range(10):
        scaled = t * 10.0**decimals
        if np.abs(scaled - np.rint(scaled)).max() < 1e-4:
            return float(10.0**-decimals)
    return float(np.spacing(np.float32(np.abs(t).max())))


def grid_times(start: float, interval: float, n: int) -> FloatArray:
    """(n,) s, ``start + i * interval``."""
    return start + np.arange(n, dtype=np.float64) * np.float64(interval)
