"""How fast the records rise: the scale of the default priors of lags."""

from __future__ import annotations

from math import log, sqrt

import numpy as np

from bayes_sensor.campaign import Campaign, Experiment, FloatArray
from bayes_sensor.likelihood.switch_ranges import after_step, step_begin, step_end
from bayes_sensor.rig.cascade import cascade_response

PUBLISHED_TIMES = (0.0481, 0.8577, 0.05823 / 0.15)

FEWEST_OF_RISE = 16
"""samples of a step from which its rise may be read off"""
DRIFT = 0.2
"""of the step, between the two halves after its middle; above it the plateau is not reached (the
step lasts less than three lags)"""
UNSETTLED = 10.0
"""longest lag looked for where no plateau is reached, in lengths of the step"""
LN_NINE = log(9.0)
"""10 to 90 % time of an exponential over its lag"""
AVERAGES = (600, 200, 60, 20)
"""how many averages of a step are looked at: the most that noise allows, since they must be short
against a rise"""


def rise_time(t: FloatArray, x: FloatArray) -> float | None:
    """10 to 90 % time of the last lasting rise through one half; earlier spikes do not count."""
    below = np.flatnonzero(x < 0.5)
    if len(below) == 0 or below[-1] + 1 >= len(x):
        return None
    half = below[-1] + 1
    low = np.flatnonzero(x[:half] < 0.1)
    high = np.flatnonzero(x[half:] > 0.9)
    if len(low) == 0 or len(high) == 0:
        return None
    return float(t[half + high[0]] - t[low[-1]])


def published_rise_time() -> float:
    """s, 10 to 90 % of the published model at 9 L/min."""
    t = np.linspace(0.0, 20.0, 20001)
    rise = rise_time(t, cascade_response(t, PUBLISHED_TIMES, 0.0))
    assert rise is not None  # the published response rises
    return rise


def fastest_rise(campaign: Campaign) -> float:
    """s, the shortest 10 to 90 % time among the measured steps.

    Each record is averaged in blocks so that noise hides neither end.  Steps smaller than a tenth
    of the largest, or than twenty times the scatter of these averages, are left out.  Without any
    usable step it is the length of the longest; for a design the published rig's time.
    """
    if all(e.y is None for e in campaign):
        return published_rise_time()
    seen = [found for e in campaign if e.y is not None and (found := _measured_rise(e))]
    largest = max((step for step, _ in seen), default=0.0)
    rises = [rise for step, rise in seen if step >= 0.1 * largest]
    return min(rises) if rises else max(step_end(e) - step_begin(e) for e in campaign)


def longest_watch(campaign: Campaign) -> float:
    """s, to one digit: the longest time from the first command to the end of a record."""
    return float(f"{max(float(e.t[-1]) + e.interval - step_begin(e) for e in campaign):.0e}")


def _measured_rise(e: Experiment) -> tuple[float, float] | None:
    """Size of the step (V) and its 10 to 90 % time (s), or None where it cannot be seen."""
    t, y = e.t[e.used], e.values[e.used]
    first, last = np.searchsorted(t, [step_begin(e), step_end(e)])
    back, end = np.searchsorted(t, after_step(e))
    if last - first < FEWEST_OF_RISE:
        return None
    for n_means in AVERAGES:
        n_bin = max(1, (last - first) // n_means)
        n = (last - first) // n_bin * n_bin
        means = y[first : first + n].reshape(-1, n_bin).mean(axis=1)
        times = t[first : first + n].reshape(-1, n_bin).mean(axis=1)
        tenth = max(min(5, len(means) // 4), len(means) // 10)
        low = float(np.median(means[:3] if first < 20 else y[:first]))
        high = float(np.median(means[-tenth:]))
        scatter = float(np.std(np.diff(means[-tenth:]))) / sqrt(2.0)
        m = (end - back) // n_bin * n_bin
        later = y[back : back + m].reshape(-1, n_bin).mean(axis=1)
        after = moves_on(means - low, later - low, scatter)
        if after is not None:
            high = float(later[after])
        if abs(high - low) >= 20.0 * scatter and high != low:
            if after is not None:
                # two lags are farthest after one lag or so, as an exponential rises
                return abs(high - low), LN_NINE * (n + (after + 1) * n_bin) * e.interval
            x = (means - low) / (high - low)
            rise = rise_time(times, x)
            if rise is None:
                return None
            return abs(high - low), max(rise, n_bin * e.interval, _unfinished_rise(times, x, tenth))
    return None


def moves_on(x: FloatArray, later: FloatArray, noise: float) -> int | None:
    """Where in ``later`` a signal is farthest, if that is beyond the end of its step ``x`` (n,):
    of lags as long as the step, or of a delay nearly so long; else None.

    Both from the quiet level; ``noise``: standard deviation of a value.
    """
    width = max(len(x) // 10, 1)
    m = len(later) // width
    if not m:
        return None
    end = abs(float(np.median(x[-width:])))
    parts = np.abs(np.median(later[: m * width].reshape(m, width), axis=1))
    if parts.max() <= end + max(DRIFT * end, 6.0 * noise / sqrt(width)):
        return None
    return int(parts.argmax()) * width + width // 2


def _unfinished_rise(t: FloatArray, x: FloatArray, width: int) -> float:
    """s, 10 to 90 % time of the exponential that goes on when the step ends; 0 where none does.

    Of an exponential the second half of a stretch moves exp(-half / tau) times as far as the first.
    ``width``: how many averages of ``x`` (n,), 0 before the step and 1 at its end, serve as middle.
    """
    half = np.flatnonzero(x < 0.5)[-1]
    begin = int(np.flatnonzero(x[: half + 1] < 0.1)[-1])
    end = len(x) - 1 - width // 2  # the height is that of the last averages' median
    middle = (begin + end) // 2
    at_middle = float(np.median(x[max(middle - width // 2, begin) : middle + width // 2 + 1]))
    left = max(1.0 - at_middle, 0.0) / max(at_middle - 0.1, 1e-3)
    if left < DRIFT:
        return 0.0
    span = float(t[end] - t[begin])
    return min(LN_NINE * 0.5 * span / max(-log(left), 1e-3), UNSETTLED * span)
