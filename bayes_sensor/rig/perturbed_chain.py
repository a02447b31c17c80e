"""Any chain of stages under any programme, with the imperfections of its stages: one kernel.

:mod:`bayes_sensor.rig.perturbed` is written for the published rig and one pulse a record.  Here the
stages are those of :class:`~bayes_sensor.rig.rig.Rig`, in their order, and the input is a programme
of switches or a recorded channel.  The settings are the same.  They act on what they are of: the
valve, the first volume, the sensor, the readout.

Each stage is computed on one grid of cells, which starts anew at each event of the input and grows
geometrically.  A lag is advanced exactly for an input that is quadratic in a cell.
"""

from __future__ import annotations

from math import exp, log, sqrt
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from bayes_sensor.campaign import FloatArray
from bayes_sensor.compiled import compiled
from bayes_sensor.rig.imperfections import BEND as STROKE_BEND
from bayes_sensor.rig.imperfections import (
    CARRY,
    CARRY_SPREAD,
    CARRY_TIME,
    CLOSING,
    CONCENTRATION,
    EMPTYING,
    FILTER,
    FILTER_BUTTERWORTH,
    FILTER_SECOND,
    FIRST,
    FLOW,
    INERTIA,
    LATE,
    LATE_FALL,
    LATE_RISE,
    NEUTRAL,
    POCKET,
    POCKET_TIME,
    PREMIXED,
    RELEASE,
    RELEASE_WIDTH,
    SENSOR_FACTOR,
    SETTLING,
    SETTLING_SWING,
    SETTLING_TIME,
    SLOW_V,
    SLOW_V_TIME,
    START,
    STEP,
    STROKE,
    SWITCHING,
    TANK,
    TAU,
    VALVE_FACTOR,
)
from bayes_sensor.rig.lag_cells import (
    GROWTH,
    Cells,
    add_within,
    fill_middles,
    grow_grid,
    lag_states,
    of_two_poles,
    passed,
    with_pocket,
)
from bayes_sensor.rig.perturbed import CELLS_PER_TIME_CONSTANT
from bayes_sensor.rig.sensor_and_readout import (
    cells_of,
    factor_of,
    read_volts,
    sensor_modes,
    sensor_states,
    share_of,
    step_mean,
)

PLAIN, VALVE, FIRST_VOLUME, VOLUME, SENSOR = range(5)
"""what a lag of the chain is of"""
LAGS = FIRST + len(NEUTRAL)
"""place in the parameter vector of the chain's first lag; its lags are followed by the times of the
switches, or by the delay of a recorded input, s"""
SHORTEST = 0.02
"""of the longest lag: a shorter one does not make the cells shorter"""
COARSE = 0.3
"""of the shortest lag, or of what counts as such: longest cell of a recorded input"""
MOST_PARTS = 4
"""into which an interval of a recorded input is divided at most"""


class Chain(NamedTuple):
    """What of a rig and an input no parameter changes, as the kernel takes it."""

    codes: NDArray[np.int64]
    """(n_lags,) what each lag is of"""
    heights: FloatArray
    """(n_switches,) change of the input at each; none for a recorded one"""
    rest: float
    """input before everything"""
    knots: FloatArray
    """(n_knots,) s, times of the recorded input without its delay; empty for a programme"""
    levels: FloatArray
    """(n_knots,) the input at these"""


class _Input(NamedTuple):
    """The input on the grid, above its rest."""

    t: FloatArray
    """(n + 1,) s, ends of the cells"""
    a: FloatArray
    """(n,) at their begins"""
    m: FloatArray
    """(n,) in their middles"""
    b: FloatArray
    """(n,) at their ends"""
    up: NDArray[np.bool_]
    """(n,) whether the last change was upwards"""
    since: FloatArray
    """(n,) s, from the last switch upwards to a cell's begin; negative where there was none"""


@compiled()
def _ramp(s: float, stroke: float, bend: float) -> float:
    # share of a switch that has happened s after it begins
    if s <= 0.0:
        return 0.0
    if s >= stroke:
        return 1.0
    q = s / stroke
    return q + bend * (q * q - q)


@compiled()
def _events(p: FloatArray, chain: Chain) -> tuple[FloatArray, FloatArray]:
    # times (n,) s, rising, and heights (n,) of all that switches, what comes late included
    n = len(chain.heights)
    begin = LAGS + len(chain.codes)
    late = p[LATE]
    times, heights = np.empty(2 * n), np.empty(2 * n)
    for j in range(n):
        height, at = chain.heights[j], p[begin + j]
        times[j], heights[j] = at, height * (1.0 - late)
        later = p[LATE_RISE] if height > 0.0 else p[LATE_FALL]
        times[n + j], heights[n + j] = at + later, height * late
    if late == 0.0:
        times, heights = times[:n], heights[:n]
    order = np.argsort(times)
    return times[order], heights[order]


@compiled()
def _grown(t: FloatArray, until: float, first: float) -> FloatArray:
    # the grid (n,) carried on to ``until``
    most = int(log(1.0 + (GROWTH - 1.0) * (until - t[-1]) / first) / log(GROWTH)) + 4
    made = np.empty(len(t) + most)
    made[: len(t)] = t
    return made[: grow_grid(made, len(t) - 1, until, first) + 1]


@compiled()
def _programme(p: FloatArray, chain: Chain, first: float, last: float) -> _Input:
    times, heights = _events(p, chain)
    stroke, bend, n = p[STROKE], p[STROKE_BEND], len(times)
    breaks = times.copy()
    if stroke > 0.0:
        breaks = np.sort(np.concatenate((times, times + stroke)))
    t = np.array([breaks[0]])
    for i in range(len(breaks)):
        until = min(breaks[i + 1], last) if i + 1 < len(breaks) else last
        if until - t[-1] > 1e-3 * first:
            t = _grown(t, until, first)
    n_cells = len(t) - 1
    a, m, b = np.zeros(n_cells), np.zeros(n_cells), np.zeros(n_cells)
    up, since = np.zeros(n_cells, np.bool_), np.full(n_cells, -1.0)
    level, opened, j = 0.0, np.inf, 0
    rises = False
    for i in range(n_cells):
        middle = 0.5 * (t[i] + t[i + 1])
        while j < n and times[j] < middle:
            rises = heights[j] > 0.0
            if rises:
                opened = times[j]
            level += heights[j]
            j += 1
        up[i] = rises
        if opened < np.inf:
            since[i] = max(t[i] - opened, 0.0)
        a[i] = m[i] = b[i] = level
        if stroke > 0.0:  # what of the last switches has not happened yet
            for k in range(j - 1, -1, -1):
                if times[k] + stroke <= t[i]:
                    break
                a[i] -= heights[k] * (1.0 - _ramp(t[i] - times[k], stroke, bend))
                m[i] -= heights[k] * (1.0 - _ramp(middle - times[k], stroke, bend))
                b[i] -= heights[k] * (1.0 - _ramp(t[i + 1] - times[k], stroke, bend))
    return _Input(t, a, m, b, up, since)


@compiled()
def _recorded(p: FloatArray, chain: Chain, first: float, last: float) -> _Input:
    knots = chain.knots + p[LAGS + len(chain.codes)]
    n_knots = len(knots)
    longest = COARSE * CELLS_PER_TIME_CONSTANT * first
    t = np.empty(MOST_PARTS * n_knots + 400)
    t[0] = knots[0]
    n = 1
    for i in range(n_knots - 1):
        if knots[i] >= last:
            break
        h = knots[i + 1] - knots[i]
        parts = min(max(int(np.ceil(h / longest)), 1), MOST_PARTS)
        for q in range(1, parts + 1):
            t[n] = knots[i] + h * q / parts
            n += 1
    t = t[:n]
    if t[-1] < last:
        t = _grown(t, last, longest)
    middle = 0.5 * (t[:-1] + t[1:])
    above = chain.levels - chain.levels[0]
    at = np.interp(t, knots, above)
    up = at[1:] >= at[:-1]
    return _Input(
        t, at[:-1].copy(), np.interp(middle, knots, above), at[1:].copy(), up,
        np.full(len(middle), -1.0),
    )  # fmt: skip


@compiled()
def _valve(
    cells: Cells, tau: float, p: FloatArray, up: NDArray[np.bool_]
) -> tuple[FloatArray, FloatArray]:
    n = len(cells.h)
    if p[INERTIA] > 1e-9:
        root = sqrt(p[INERTIA])
        states, mid = of_two_poles(cells, tau * root, 0.5 / root)
    else:
        rates = np.full(n, 1.0 / tau)
        if p[CLOSING] != 1.0:
            rates[~up] /= p[CLOSING]
        states, mid = passed(cells, rates)
    share = p[SLOW_V]
    if share != 0.0:
        slow, slow_mid = passed(cells, np.full(n, 1.0 / p[SLOW_V_TIME]))
        states = states + share * (slow - states)
        mid = mid + share * (slow_mid - mid)
    return states, mid


@compiled()
def _settling(
    p: FloatArray, made: _Input, rest: float, a: FloatArray, m: FloatArray, b: FloatArray
) -> None:
    # what the last switch upwards lets in is low for a while, in place
    h = made.t[1:] - made.t[:-1]
    for i in range(len(h)):
        if made.since[i] >= 0.0:
            for part, of in ((0.0, a), (0.5, m), (1.0, b)):
                s = made.since[i] + part * h[i]
                gone = np.exp(-s / p[SETTLING_TIME]) * np.cos(p[SETTLING_SWING] * s)
                of[i] -= p[SETTLING] * gone * (of[i] + rest)


@compiled()
def _volume(
    cells: Cells,
    lag: float,
    p: FloatArray,
    first: bool,
    up: NDArray[np.bool_],
    rest: float,
    opened: tuple[FloatArray, FloatArray, FloatArray],
) -> tuple[FloatArray, FloatArray]:
    # a swept volume; a pocket and a second tank are the first one's.  ``opened``: the valve's
    # state at begins, middles and ends of the cells
    h, a, m, b = cells
    tank = p[TANK] if first else 0.0
    rates = np.full(len(h), p[FLOW] / (lag * (1.0 - tank)))
    rates[~up] /= p[EMPTYING]
    rates_a, rates_b = rates, rates
    lost = p[SWITCHING] * p[CONCENTRATION]
    if lost != 0.0:
        flows_a, flows_m, flows_b = [1.0 - lost + lost * (rest + x) for x in opened]
        rates_a, rates_m, rates_b = rates * flows_a, rates * flows_m, rates * flows_b
        if p[PREMIXED] == 0.0 and first:
            a = (a + rest) / flows_a - rest
            m = (m + rest) / flows_m - rest
            b = (b + rest) / flows_b - rest
        rates = (rates_a + 4.0 * rates_m + rates_b) / 6.0
    if first and p[POCKET] > 0.0:
        states, pocket, mid = np.zeros(len(h) + 1), np.zeros(len(h) + 1), np.zeros(len(h))
        with_pocket(Cells(h, a, m, b), rates, p[POCKET], p[POCKET_TIME], states, pocket)
        k = p[POCKET] / p[POCKET_TIME]
        a = (rates_a * a + k * pocket[:-1]) / (rates_a + k)
        b = (rates_b * b + k * pocket[1:]) / (rates_b + k)
        fill_middles(h, states, a, b, rates_a + k, rates_b + k, mid)
    elif lost != 0.0:
        states, mid = np.zeros(len(h) + 1), np.zeros(len(h))
        lag_states(Cells(h, a, m, b), rates, states)
        fill_middles(h, states, a, b, rates_a, rates_b, mid)
    else:
        states, mid = passed(Cells(h, a, m, b), rates)
    if tank > 0.0:
        second = np.full(len(h), p[FLOW] / (lag * tank))
        return passed(Cells(h, states[:-1], mid, states[1:]), second)
    return states, mid


@compiled()
def _sensor(
    cells: Cells, lag: float, p: FloatArray, mode_share: FloatArray, mode_ratio: FloatArray
) -> tuple[FloatArray, FloatArray]:
    q = p.copy()
    q[TAU] = lag
    share, tau = sensor_modes(q, mode_share, mode_ratio)
    n = len(cells.h)
    ends, mid = np.zeros(n + 1), np.zeros(n)
    half, at = 0.5 * cells.h, np.arange(n)
    rates, states = np.empty(n), np.empty(n + 1)
    for j in range(len(share)):
        sensor_states(cells, tau[j], p[RELEASE], p[RELEASE_WIDTH], rates, states)
        ends += share[j] * states
        add_within(share[j], at, half, cells, rates, states, mid)
    return ends, mid


@compiled()
def _first_cell(p: FloatArray, lags: FloatArray, codes: NDArray[np.int64]) -> float:
    # s: the shortest of what the cells have to follow, over CELLS_PER_TIME_CONSTANT
    longest, shortest = np.max(lags), np.inf
    for i in range(len(lags)):
        lag = lags[i]
        if codes[i] == VALVE:
            lag *= p[VALVE_FACTOR] * min(1.0, p[CLOSING])
            if p[INERTIA] > 0.0:
                lag = min(lag, 2.0 * lag * sqrt(p[INERTIA]) + 0.2 * lag)
        elif codes[i] == FIRST_VOLUME:
            lag *= min(1.0, p[EMPTYING]) / p[FLOW]
            if p[TANK] > 0.0:
                lag = min(lag, 2.0 * lag * p[TANK] + 0.2 * lag)
        elif codes[i] == SENSOR:
            lag *= p[SENSOR_FACTOR] * min(1.0, p[RELEASE])
        shortest = min(shortest, lag)
    first = max(shortest, SHORTEST * longest)
    if p[STROKE] > 0.0:
        first = min(first, 2.0 * p[STROKE] + 0.2 * first)
    if p[SETTLING] != 0.0:
        first = min(first, 2.0 * p[SETTLING_TIME])
    return first / CELLS_PER_TIME_CONSTANT


@compiled()
def chain_response_of(
    times: FloatArray, p: FloatArray, chain: Chain, mode_share: FloatArray, mode_ratio: FloatArray
) -> FloatArray:
    """The response (n_t,) at sorted ``times`` (n_t,) s, in the unit of the input."""
    codes, rest = chain.codes, chain.rest
    n = len(codes)
    lags = p[LAGS : LAGS + n]
    first = _first_cell(p, lags, codes)
    out = np.full(len(times), rest)
    if len(chain.knots):
        begin = chain.knots[0] + p[LAGS + n]
    else:
        begin = np.min(_events(p, chain)[0])
    last = times[-1]
    if last - begin > 1e-2 * first:
        if len(chain.knots):
            made = _recorded(p, chain, first, last)
        else:
            made = _programme(p, chain, first, last)
        h = made.t[1:] - made.t[:-1]
        a, m, b = made.a, made.m, made.b
        has_valve = np.any(codes == VALVE)
        if p[SETTLING] != 0.0 and not has_valve:
            _settling(p, made, rest, a, m, b)
        opened = (a, m, b)
        for i in range(n):
            cells = Cells(h, a, m, b)
            if codes[i] == VALVE:
                ends, mid = _valve(cells, lags[i] * p[VALVE_FACTOR], p, made.up)
            elif codes[i] == FIRST_VOLUME or codes[i] == VOLUME:
                is_first = codes[i] == FIRST_VOLUME
                ends, mid = _volume(cells, lags[i], p, is_first, made.up, rest, opened)
            elif codes[i] == SENSOR:
                ends, mid = _sensor(cells, lags[i], p, mode_share, mode_ratio)
            else:
                ends, mid = passed(cells, np.full(len(h), 1.0 / lags[i]))
            a, m, b = ends[:-1].copy(), mid, ends[1:].copy()
            if codes[i] == VALVE:
                if p[SETTLING] != 0.0:
                    _settling(p, made, rest, a, m, b)
                opened = (a, m, b)
        for time in (p[FILTER], p[FILTER_SECOND]):
            if time > 0.0:
                ends, mid = passed(Cells(h, a, m, b), np.full(len(h), 1.0 / time))
                a, m, b = ends[:-1], mid, ends[1:]
        if p[FILTER_BUTTERWORTH] > 0.0:
            ends, mid = of_two_poles(Cells(h, a, m, b), p[FILTER_BUTTERWORTH], np.sqrt(0.5))
            a, m, b = ends[:-1], mid, ends[1:]
        k = 0
        while k < len(times) and times[k] <= begin:
            k += 1
        if k < len(times):
            places, since = cells_of(times[k:], made.t)
            for q in range(len(places)):
                i = places[q]
                s = since[q] / h[i]
                rise, bend = 4.0 * m[i] - 3.0 * a[i] - b[i], 2.0 * a[i] - 4.0 * m[i] + 2.0 * b[i]
                out[k + q] += a[i] + s * (rise + s * bend)
    if p[CARRY] != 0.0:
        _add_carried(times, p, lags, codes, out)
    return out


@compiled()
def _add_carried(
    times: FloatArray, p: FloatArray, lags: FloatArray, codes: NDArray[np.int64], out: FloatArray
) -> None:
    # what was there before leaves the first volume, or the slowest stage before the sensor, and
    # lags in the sensor; a sensor alone gives off what it holds itself
    slow, fast = 0.0, 0.0
    for i in range(len(lags)):
        if codes[i] == SENSOR:
            fast = lags[i]
        elif codes[i] == FIRST_VOLUME:
            slow = lags[i] / p[FLOW]
    if slow == 0.0:
        for i in range(len(lags)):
            if codes[i] != SENSOR:
                slow = max(slow, lags[i])
    if slow == 0.0:
        slow, fast = fast, 1e-9 * fast
    if p[CARRY_TIME] > 0.0:
        slow = p[CARRY_TIME]
    spread = p[CARRY_SPREAD]
    for part in range(1 if spread == 1.0 else 3):
        share, late = p[CARRY] * share_of(part, spread), slow * factor_of(part, spread)
        soon = late * (1.0 - 1e-6) if abs(late - fast) < 1e-6 * late else fast
        for i in range(len(times)):
            s = times[i] - p[START]
            if s >= 0.0:
                out[i] += share * (late * exp(-s / late) - soon * exp(-s / soon)) / (late - soon)


@compiled()
def chain_mean(
    times: FloatArray, p: FloatArray, chain: Chain, mode_share: FloatArray, mode_ratio: FloatArray
) -> FloatArray:
    """The mean of the signal (n_t,) V at sorted ``times`` (n_t,) s."""
    return read_volts(times, p, chain_response_of(times, p, chain, mode_share, mode_ratio), p[STEP])


@compiled()
def chain_bin_means(
    times: FloatArray,
    weights: FloatArray,
    starts: NDArray[np.int64],
    low: FloatArray,
    high: FloatArray,
    rows: FloatArray,
    same_response: NDArray[np.bool_],
    chain: Chain,
    mode_share: FloatArray,
    mode_ratio: FloatArray,
) -> FloatArray:
    """(n_bins, n_rows) V: means over one experiment's bins for every row of parameters.

    ``same_response`` (n_rows,): whether a row has the response of the first.
    """
    made = np.zeros((len(starts), len(rows)))
    usual = chain_response_of(times, rows[0], chain, mode_share, mode_ratio)
    for i in range(len(rows)):
        x = usual
        if not same_response[i]:
            x = chain_response_of(times, rows[i], chain, mode_share, mode_ratio)
        volts = read_volts(times, rows[i], x, 0.0)
        for b in range(len(starts)):
            end = starts[b + 1] if b + 1 < len(starts) else len(times)
            for q in range(starts[b], end):
                made[b, i] += weights[q] * volts[q]
            if rows[i, STEP] != 0.0:
                made[b, i] += step_mean(low[b], high[b], rows[i])
    return made
