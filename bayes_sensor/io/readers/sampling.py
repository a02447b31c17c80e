"""From written times to a grid: the sampling interval, jitter and dropped samples.

Times that lie near a uniform grid are put on it, with places for the samples that are missing.
Other times that increase strictly are kept as they are: the sampling is irregular.
"""

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
FIRST_EPOCH = 1e8
"""s; larger times count from an epoch such as 1970, and the first sample is taken as 0"""
NOTED_JITTER = 0.05
"""share of the interval; jitter above this is mentioned, unless the written digits explain it"""


@dataclass(frozen=True, eq=False)
class Grid:
    """A uniform grid ``start + i * interval`` and the place of each written sample on it.

    Where the sampling is irregular, ``times`` holds the samples' own times.
    """

    start: float
    """s"""
    interval: float
    """s; the median step where the sampling is irregular"""
    index: NDArray[np.int64]
    """(n,) position of each written sample, strictly increasing from 0"""
    jitter: float
    """largest distance of a written time from its grid point, in intervals"""
    rounded: bool
    """whether the number of written digits explains the jitter"""
    times: FloatArray | None = None
    """(n,) s, where the sampling is irregular"""

    @property
    def t(self) -> FloatArray:
        """(n_t,) s, all times of the grid."""
        if self.times is not None:
            return self.times
        return grid_times(self.start, self.interval, int(self.index[-1]) + 1)


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


def grid_through(
    t: FloatArray, place: Callable[[int], str], error: Callable[[str], CampaignError]
) -> Grid:
    """The grid of written times: uniform where they are near one, else the times themselves.

    Raises
    ------
    CampaignError
        If a time is not finite or times do not increase strictly.
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
        raise error(
            f"time must increase strictly, but {place(i + 1)} ({t[i + 1]:.10g} s) follows "
            f"{place(i)} ({t[i]:.10g} s); {_advice(step, i)}"
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
        median = float(np.median(step))
        places = np.arange(len(t), dtype=np.int64)
        nearest = simplest_near(median, 1e-3 * median)
        return Grid(float(t[0]), nearest, places, jitter, False, np.asarray(t, dtype=np.float64))
    least = 1e-9 * interval
    # a change of the interval moves the last sample by n times as much
    exact = simplest_near(interval, max(off[worst], least) / max(int(index[-1]), 1))
    start = float(t[0]) if jitter < 0.01 else simplest_near(origin, max(off[worst], least))
    return Grid(start, exact, index, jitter, off[worst] <= 0.51 * _resolution(t))


def _advice(step: FloatArray, i: int) -> str:
    """What to do about times that do not increase at step ``i``."""
    if int((step == 0).sum()) > 0.2 * len(step):
        return "export times with more digits, or give the sampling interval as interval"
    if step[i] == 0:
        return "drop the repeated rows"
    if abs(step[i] + 3600.0) < 60.0:
        return (
            "the clock goes back by an hour, as at the end of summer time: split the file there, "
            "or export times with their offset from UTC"
        )
    return "sort the rows by time or split the file where the clock restarts"


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
