"""A rig with every imperfection of the catalogue: one kernel, from the valve to the voltage.

The published model is a cascade of three first-order lags.  Real rigs depart from it stage by
stage, so the stages are computed one after the other on a time grid that starts at each switch
and grows geometrically::

    command -> valve x1 -> manifold x2 -> sensor x3 -> low-pass -> readout y

Every lag is advanced exactly for an input that is quadratic within a cell, so that time constants
far below the grid's steps are no trouble.  With the neutral settings the response is the closed
form of :mod:`bayes_sensor.rig.cascade` (a test compares them).  An effect only says which settings
it changes; effects on different settings can therefore act together.
"""

from __future__ import annotations

from math import cos, exp, log, sin, sqrt

import numpy as np
from numpy.typing import NDArray

from bayes_sensor.campaign import FloatArray
from bayes_sensor.compiled import compiled
from bayes_sensor.rig.exponential import exponentials
from bayes_sensor.rig.imperfections import (
    BEFORE_THE_READOUT,
    BEND,
    CARRY,
    CARRY_SPREAD,
    CARRY_TIME,
    CLOSING,
    CLOSING_BEND,
    CONCENTRATION,
    EMPTYING,
    FILTER,
    FILTER_BUTTERWORTH,
    FILTER_SECOND,
    FLOW,
    INERTIA,
    LATE,
    LATE_FALL,
    LATE_RISE,
    OF_THE_GAS,
    POCKET,
    POCKET_TIME,
    PREMIXED,
    RELEASE,
    RELEASE_WIDTH,
    SETTLING,
    SETTLING_SWING,
    SETTLING_TIME,
    SLOW_V,
    SLOW_V_TIME,
    START,
    STEP,
    STROKE,
    SWITCHING,
    T0,
    TANK,
    TAU,
    TAU_M,
    TAU_V,
    TF,
    VALVE_FACTOR,
)
from bayes_sensor.rig.lag_cells import (
    GROWTH,
    Cells,
    add_butterworth,
    add_within,
    fill_middles,
    grow_grid,
    lag_states,
    with_pocket,
)
from bayes_sensor.rig.sensor_and_readout import (
    cells_of,
    factor_of,
    read_volts,
    sensor_modes,
    sensor_states,
    share_of,
    step_mean,
)
from bayes_sensor.rig.sorting import sort

CELLS_PER_TIME_CONSTANT = 14.0


# --------------------------------------------------------------------------- the valve


@compiled(inside=True)
def _opening(s: float, tau: float, inertia: float, stroke: float, bend: float) -> float:
    # step response of the valve s after the command; 0 before it
    if s <= 0.0:
        return 0.0
    if stroke > 0.0:  # the lag's response to a command (1 - bend) q + bend q^2, q = s/stroke
        ramping = min(s, stroke)
        left = ramping - tau * (1.0 - exp(-ramping / tau))
        x = left / stroke
        square = ramping * ramping - 2.0 * tau * left
        x += bend * (square / (stroke * stroke) - x)
        return 1.0 - (1.0 - x) * exp((ramping - s) / tau)
    if inertia <= 1e-9:
        return 1.0 - exp(-s / tau)
    gap = 1.0 - 4.0 * inertia
    if gap > 1e-6:
        slow = 0.5 * tau * (1.0 + sqrt(gap))
        fast = inertia * tau * tau / slow
        return 1.0 - (slow * exp(-s / slow) - fast * exp(-s / fast)) / (slow - fast)
    rate = 0.5 / (inertia * tau)
    swing = 1.0 + rate * s
    if gap < -1e-6:
        omega = rate * sqrt(-gap)
        swing = cos(omega * s) + rate / omega * sin(omega * s)
    return 1.0 - exp(-rate * s) * swing


@compiled(inside=True)
def _still_open(even: float, bend: float) -> float:
    # y of tau (1 + bend (y - 1/2)) y' = -y where without the bend it would be ``even``:
    # (1 - bend/2) ln y + bend (y - 1) = ln even, by Newton's method
    if bend == 0.0 or even <= 1e-12:
        return even
    end = log(even)
    u = end
    for _ in range(30):
        y = exp(u)
        step = ((1.0 - 0.5 * bend) * u + bend * (y - 1.0) - end) / (1.0 - 0.5 * bend + bend * y)
        u = min(u - step, 0.0)
        if abs(step) < 1e-12:
            break
    return exp(u)


@compiled(inside=True)
def _valve(t: FloatArray, p: FloatArray) -> FloatArray:
    # x1 (n,) at times (n,); a way that is longer for a part of the gas is a valve that opens late
    # for it
    n, x, decay = len(t), np.zeros(len(t)), np.empty(len(t))
    tau, share = p[TAU_V] * p[VALVE_FACTOR], p[SLOW_V]
    inertia, stroke, bend = p[INERTIA], p[STROKE], p[BEND]
    alike = p[CLOSING] == 1.0 and p[CLOSING_BEND] == 0.0
    plain = alike and inertia <= 1e-9 and stroke <= 0.0  # one exponential up, one down
    for part in range(2 if p[LATE] != 0.0 else 1):
        t0, tf = p[T0] + part * p[LATE_RISE], p[TF] + part * p[LATE_FALL]
        reached = _opening(tf - t0, tau, inertia, stroke, bend)
        if plain:
            for i in range(n):
                decay[i] = (tf - t[i] if t[i] > tf else min(t0 - t[i], 0.0)) / tau
            exponentials(decay)
        for i in range(n):
            since, after = t[i] - t0, t[i] - tf
            if plain:
                y = reached * decay[i] if after > 0.0 else 1.0 - decay[i]
            else:
                y = _opening(since, tau, inertia, stroke, bend)
                shut = _opening(after, tau * p[CLOSING], inertia, stroke, bend)
                if alike:  # linear: opening minus shutting
                    y -= shut
                elif after > 0.0:
                    y = reached * _still_open(1.0 - shut, p[CLOSING_BEND])
            if share != 0.0 and since > 0.0:
                slow = -exp(-since / p[SLOW_V_TIME])
                slow += exp(-after / p[SLOW_V_TIME]) if after > 0.0 else 1.0
                y += share * (slow - y)
            if p[SETTLING] != 0.0 and since > 0.0:
                gone = exp(-since / p[SETTLING_TIME])
                y *= 1.0 - p[SETTLING] * gone * cos(p[SETTLING_SWING] * since)
            x[i] += (y - x[i]) * (p[LATE] if part else 1.0)
    return x


@compiled(inside=True)
def _manifold(
    t: FloatArray, x1: FloatArray, x1_mid: FloatArray, p: FloatArray
) -> tuple[FloatArray, FloatArray]:
    # x2 (n,) and its middles (n - 1,) on the grid
    n = len(t) - 1
    cells = Cells(np.empty(n), np.empty(n), np.empty(n), np.empty(n))
    h, a, m, b = cells
    rates, rates_a, rates_b = np.empty(n), np.empty(n), np.empty(n)
    filling = p[FLOW] / (p[TAU_M] * (1.0 - p[TANK]))
    lost = p[SWITCHING] * p[CONCENTRATION]
    for i in range(n):
        h[i] = t[i + 1] - t[i]
        a[i], m[i], b[i] = x1[i], x1_mid[i], x1[i + 1]
        rate = filling / p[EMPTYING] if t[i] >= p[TF] else filling
        rates[i] = rates_a[i] = rates_b[i] = rate
        if lost != 0.0:
            # the flow through the manifold follows the valve; what enters is Q x1 where the valve
            # is in the test gas's line, and of concentration x1 where the gases are mixed before it
            rates_a[i] = rate * (1.0 - lost + lost * a[i])
            rate_m = rate * (1.0 - lost + lost * m[i])
            rates_b[i] = rate * (1.0 - lost + lost * b[i])
            if p[PREMIXED] == 0.0:
                a[i] *= rate / rates_a[i]
                m[i] *= rate / rate_m
                b[i] *= rate / rates_b[i]
            rates[i] = (rates_a[i] + 4.0 * rate_m + rates_b[i]) / 6.0
    x2, mid = np.zeros(n + 1), np.empty(n)
    if p[POCKET] > 0.0:  # what the pocket gives back is a second input
        pocket, k = np.zeros(n + 1), p[POCKET] / p[POCKET_TIME]
        with_pocket(cells, rates, p[POCKET], p[POCKET_TIME], x2, pocket)
        for i in range(n):
            a[i] = (rates_a[i] * a[i] + k * pocket[i]) / (rates_a[i] + k)
            b[i] = (rates_b[i] * b[i] + k * pocket[i + 1]) / (rates_b[i] + k)
            rates_a[i] += k
            rates_b[i] += k
    for tank in range(2 if p[TANK] > 0.0 else 1):
        if tank:
            for i in range(n):
                a[i], m[i], b[i] = x2[i], mid[i], x2[i + 1]
                rates[i] = rates_a[i] = rates_b[i] = p[FLOW] / (p[TAU_M] * p[TANK])
        if tank or p[POCKET] <= 0.0:
            lag_states(cells, rates, x2)
        fill_middles(h, x2, a, b, rates_a, rates_b, mid)
    return x2, mid


# --------------------------------------------------------------------------- from gas to volts


@compiled(inside=True)
def _grid(last: float, p: FloatArray) -> FloatArray:
    # (n,) s, from t0 to the last time
    first = min(p[TAU_V] * p[VALVE_FACTOR], p[TAU_M] / p[FLOW] * min(1.0, p[EMPTYING]))
    if p[CLOSING] < 1.0 or p[CLOSING_BEND] != 0.0:
        first = min(first, p[CLOSING] * p[TAU_V] * (1.0 - 0.5 * abs(p[CLOSING_BEND])))
    if p[INERTIA] > 0.0:
        first = min(first, 2.0 * p[TAU_V] * sqrt(p[INERTIA]) + 0.2 * p[TAU_V])
    if p[STROKE] > 0.0:
        first = min(first, 2.0 * p[STROKE] + 0.2 * p[TAU_V])
    if p[TANK] > 0.0:
        first = min(first, 2.0 * p[TAU_M] * p[TANK] + 0.3 * first)
    if p[SETTLING] != 0.0:
        first = min(first, 2.0 * p[SETTLING_TIME])
    first /= CELLS_PER_TIME_CONSTANT
    # the valve's motion breaks off at these times: a new grid begins at each
    events = np.array([p[T0], p[TF], p[T0] + p[LATE_RISE], p[TF] + p[LATE_FALL]])
    used = 4 if p[LATE] != 0.0 else 2
    sort(events[:used])
    most = log(1.0 + (GROWTH - 1.0) * max(last - p[T0], 0.0) / first) / log(GROWTH)
    t, at = np.empty(int(used * (most + 3.0)) + 1), 0
    t[0] = p[T0]
    for i in range(used):
        until = min(events[i + 1], last) if i + 1 < used else last
        if until - t[at] > 1e-3 * first:
            at = grow_grid(t, at, until, first)
    return t[: at + 1]


@compiled()
def _gas(last: float, p: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
    # a grid (n,) s from t0 to the last time, x2 (n,) on it and (n - 1,) in the middles of its cells
    t = _grid(last, p)
    n = len(t)
    both = np.empty(2 * n - 1)  # the grid, then its middles
    for i in range(n):
        both[i] = t[i]
        if i:
            both[n + i - 1] = 0.5 * (t[i - 1] + t[i])
    x1 = _valve(both, p)
    x2, x2_mid = _manifold(t, x1[:n], x1[n:], p)
    return t, x2, x2_mid


@compiled()
def _sensed(
    times: FloatArray,
    p: FloatArray,
    t: FloatArray,
    x2: FloatArray,
    x2_mid: FloatArray,
    mode_share: FloatArray,
    mode_ratio: FloatArray,
) -> FloatArray:
    # x3 at sorted times, of the gas x2 on the grid t
    out, before, n = np.zeros(len(times)), 0, len(t) - 1
    while before < len(times) and times[before] <= p[T0]:
        before += 1
    if before < len(times) and n > 0:
        places, since = cells_of(times[before:], t)
        _add_response(places, since, p, t, x2, x2_mid, mode_share, mode_ratio, out[before:])
    if p[CARRY] != 0.0:
        _add_carried(times, p, out)
    return out


@compiled(inside=True)
def _add_response(
    places: NDArray[np.int64],
    since: FloatArray,
    p: FloatArray,
    t: FloatArray,
    x2: FloatArray,
    x2_mid: FloatArray,
    mode_share: FloatArray,
    mode_ratio: FloatArray,
    out: FloatArray,
) -> None:
    # the sensor's lags in parallel, then the low-passes in a row: each is a round, which takes what
    # the one before makes at the ends and in the middles of the cells
    n = len(t) - 1
    share, tau = sensor_modes(p, mode_share, mode_ratio)
    cells = Cells(np.empty(n), x2[:-1], x2_mid, x2[1:])
    all_places, half = np.empty(n, np.int64), np.empty(n)
    for i in range(n):
        all_places[i] = i
        cells.h[i] = t[i + 1] - t[i]
        half[i] = 0.5 * cells.h[i]
    filters = (p[FILTER], p[FILTER_SECOND] if p[FILTER] > 0.0 else 0.0)
    n_filters = int(filters[0] > 0.0) + int(filters[1] > 0.0)
    swings = p[FILTER_BUTTERWORTH] > 0.0
    if swings:
        n_filters = 1
    rates, states = np.empty(n), np.empty(n + 1)
    for lag in range(n_filters + 1):
        if lag and swings:
            add_butterworth(places, since, cells, max(p[FILTER], p[FILTER_BUTTERWORTH]), out)
            return
        last = lag == n_filters
        x3, mid = np.zeros(n + 1), np.zeros(n)
        for j in range(1 if lag else len(share)):
            part = 1.0 if lag else share[j]
            time = filters[lag - 1] if lag else tau[j]
            sensor_states(cells, time, 1.0 if lag else p[RELEASE], p[RELEASE_WIDTH], rates, states)
            if last:
                add_within(part, places, since, cells, rates, states, out)
            else:
                add_within(part, all_places, half, cells, rates, states, mid)
                for i in range(n + 1):
                    x3[i] += part * states[i]
        cells = Cells(cells.h, x3[:-1], mid, x3[1:])


@compiled(inside=True)
def _add_carried(times: FloatArray, p: FloatArray, out: FloatArray) -> None:
    # gas left from before: it leaves with the manifold's time constant, or with one of its own or
    # a spread of them, and lags in the sensor, which was in equilibrium with it when the record
    # began
    spread = p[CARRY_SPREAD]
    for part in range(1 if spread == 1.0 else 3):
        share = p[CARRY] * share_of(part, spread)
        slow = p[CARRY_TIME] if p[CARRY_TIME] > 0.0 else p[TAU_M] / p[FLOW]
        slow *= factor_of(part, spread)
        fast = p[TAU]
        if abs(slow - fast) < 1e-6 * slow:
            fast = slow * (1.0 - 1e-6)
        for i in range(len(times)):
            s = times[i] - p[START]
            if s >= 0.0:
                out[i] += share * (slow * exp(-s / slow) - fast * exp(-s / fast)) / (slow - fast)


def rig_response(
    times: FloatArray, p: FloatArray, mode_share: FloatArray, mode_ratio: FloatArray
) -> FloatArray:
    """x3 (n_t,), the concentration that the readout sees, at sorted ``times`` (n_t,) s."""
    x3: FloatArray = _sensed(times, p, *_gas(times[-1], p), mode_share, mode_ratio)
    return x3


def rig_mean(
    times: FloatArray, p: FloatArray, mode_share: FloatArray, mode_ratio: FloatArray
) -> FloatArray:
    """The mean voltage (n_t,) at sorted ``times`` (n_t,) s."""
    volts: FloatArray = read_volts(
        times, p, rig_response(times, p, mode_share, mode_ratio), p[STEP]
    )
    return volts


@compiled()
def rig_means(
    times: FloatArray,
    weights: FloatArray,
    starts: NDArray[np.int64],
    low: FloatArray,
    high: FloatArray,
    of_times: NDArray[np.int64],
    of_bins: NDArray[np.int64],
    p: FloatArray,
    of_rigs: NDArray[np.int64],
    mode_share: FloatArray,
    mode_ratio: FloatArray,
) -> FloatArray:
    """(n_bins, most rigs of an experiment) V: means of the bins of all experiments.

    Of each bin, from ``low`` to ``high`` (n_bins,) s, the voltage at its ``times`` (n_times,) s is
    summed with the ``weights`` (n_times,).  One experiment comes after the other: ``of_times`` and
    ``of_bins`` (n_experiments + 1,) say where each begins and the last ends, and ``starts``
    (n_bins,) which of its experiment's times is a bin's first.  Its rigs are the rows of ``p`` from
    ``of_rigs[k]`` to ``of_rigs[k + 1]`` (n_experiments + 1,): what the others have in common with
    the first is computed once.  Where an experiment has fewer rigs than another, zeros fill up.
    """
    most = 0
    for k in range(len(of_rigs) - 1):
        most = max(most, of_rigs[k + 1] - of_rigs[k])
    made = np.zeros((len(starts), most))
    no_gas = (np.empty(0), np.empty(0), np.empty(0))
    for k in range(len(of_rigs) - 1):
        at = times[of_times[k] : of_times[k + 1]]
        weight = weights[of_times[k] : of_times[k + 1]]
        first, first_gas, first_x3 = of_rigs[k], no_gas, at
        for i in range(first, of_rigs[k + 1]):
            gas, x3 = first_gas, first_x3
            if i == first or not _same(p[i], p[first], OF_THE_GAS):
                gas = _gas(at[-1], p[i])
            if i == first or not _same(p[i], p[first], BEFORE_THE_READOUT):
                x3 = _sensed(at, p[i], gas[0], gas[1], gas[2], mode_share, mode_ratio)
            if i == first:
                first_gas, first_x3 = gas, x3
            volts = read_volts(at, p[i], x3, 0.0)
            for b in range(of_bins[k], of_bins[k + 1]):
                end = starts[b + 1] if b + 1 < of_bins[k + 1] else len(at)
                for q in range(starts[b], end):
                    made[b, i - first] += weight[q] * volts[q]
                if p[i, STEP] != 0.0:
                    made[b, i - first] += step_mean(low[b], high[b], p[i])
    return made


@compiled(inside=True)
def _same(p: FloatArray, q: FloatArray, which: NDArray[np.int64]) -> bool:
    for i in which:
        if p[i] != q[i]:
            return False
    return True
