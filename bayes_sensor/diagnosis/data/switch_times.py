"""When the switches of a record act: their onset, the response's way, and when it has settled."""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from bayes_sensor.campaign import Experiment, FloatArray
from bayes_sensor.rig.cascade import cascade_response
from bayes_sensor.rig.chain import Drive, chain_response

EARLY = 0.25
"""of the sum of all lags, before a switch: from there on its onset is looked for"""
TENTH, MOST = 0.1, 0.99
"""of the way: where the rise begins, and where it ends"""
TURN = 0.1
"""of the range of a recorded input: shorter ways are no switches"""
SETTLED = 3e-3
"""of the way, within which the response has settled"""


class SwitchTimes(NamedTuple):
    """One switch of the input; times in s on the record's clock."""

    at: float
    """when the response begins"""
    height: float
    """change of the input, over the largest level of the campaign; negative: down"""
    onset: float
    """when it was commanded, or a little before the response where that is not known"""
    risen: float
    """when a tenth of the way is made"""
    reached: float
    """when 99 % of it are"""
    settle: float
    """s, from the onset until the response is within .3 % of its end"""
    high: bool
    """whether it leads to more than half of the largest level"""
    commanded: float | None = None
    """when it was commanded"""


def pulse_times(
    e: Experiment, t0: float, tf: float | None, taus: FloatArray, response: float
) -> list[SwitchTimes]:
    """Of a pulse on the published rig: up at ``t0`` and, unless None, down at ``tf``, s.

    ``response``: s, when the onset ends if not at ``t0``.
    """
    lags = float(np.sum(taus))
    tenth, most = _way(taus)
    settle = settling_time(taus)

    def onset(at: float, commanded: float | None) -> float:
        return min(at - EARLY * lags, at if commanded is None else commanded)

    begins = [SwitchTimes(t0, 1.0, onset(response, e.commanded_on), response + tenth,
                          response + most, settle, True, e.commanded_on)]  # fmt: skip
    if tf is not None:
        begins.append(SwitchTimes(tf, -1.0, onset(tf, e.commanded_off), tf + tenth, tf + most,
                                  settle, False, e.commanded_off))  # fmt: skip
    return begins


def _way(taus: FloatArray) -> tuple[float, float]:
    """s after a switch until a tenth and 99 % of the way are made."""
    grid = np.linspace(0.0, 12.0 * float(np.sum(taus)), 1200)
    x = cascade_response(grid, taus, 0.0)
    tenth, most = (float(grid[min(int(np.searchsorted(x, s)), 1199)]) for s in (TENTH, MOST))
    return tenth, most


def settling_time(taus: FloatArray) -> float:
    """s after a switch until the cascade is within .3 % of its end."""
    grid = np.linspace(0.0, 20.0 * float(np.sum(taus)), 2000)
    away = np.abs(1.0 - cascade_response(grid, taus, 0.0)) > SETTLED
    return float(grid[np.flatnonzero(away)[-1]])


def programme_times(
    times: FloatArray,
    heights: FloatArray,
    levels: FloatArray,
    commanded: Sequence[float | None],
    taus: FloatArray,
) -> list[SwitchTimes]:
    """Of a programme of switches on a chain of lags ``taus`` (n_lags,) s.

    ``times`` (n_switches,) s, ``heights`` (n_switches,) over the campaign's range of levels, and
    ``levels`` (n_switches,) after each, 0 to 1 over that range.
    """
    lags = float(np.sum(taus))
    grid = np.linspace(0.0, 20.0 * lags, 2000)
    away = 1.0 - chain_response(grid, taus, Drive.of([0.0], level=[1.0]))
    tenth, most, settle = (
        float(grid[np.flatnonzero(np.abs(away) > s)[-1]])
        for s in (1.0 - TENTH, 1.0 - MOST, SETTLED)
    )
    order = np.argsort(times, kind="stable")
    found = []
    for j in order.tolist():
        at, told = float(times[j]), commanded[j]
        onset = min(at - EARLY * lags, at if told is None else told)
        found.append(
            SwitchTimes(at, float(heights[j]), onset, at + tenth, at + most, settle,
                        bool(levels[j] > 0.5), told)
        )  # fmt: skip
    return found


def recorded_times(t: FloatArray, x: FloatArray, interval: float) -> list[SwitchTimes]:
    """Of a recorded input, from the response to it ``x`` (n_t,), 0 to 1, at times ``t`` (n_t,) s.

    A switch is a way between two turning points that is longer than :data:`TURN`; it begins where
    2 % of the way are made.  Where the input never turns so far, the whole record is one.
    """
    turns, last, up = [0], 0, x[-1] >= x[0]
    for i in range(1, len(x)):
        if (x[i] > x[last]) == up and x[i] != x[last]:
            last = i
        elif abs(x[i] - x[last]) > TURN:
            turns.append(last)
            last, up = i, not up
    turns.append(last)
    found = []
    for a, b in itertools.pairwise(turns):
        way = float(x[b] - x[a])
        if abs(way) <= TURN and len(turns) > 2:
            continue
        share = (x[a : b + 1] - x[a]) / (way or 1.0)
        onset, risen, reached = (
            float(t[a + min(int(np.argmax(share >= s)), b - a)]) for s in (1.0 - MOST, TENTH, MOST)
        )
        found.append(
            SwitchTimes(onset, way or 1.0, onset, risen, reached,
                        max(reached - onset, interval), bool(x[b] > 0.5))
        )  # fmt: skip
    return found
