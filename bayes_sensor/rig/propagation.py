"""How the state of a chain of lags advances from event to event of its input, compiled.

The state x (n,) has the lags by falling time constant; their rates (1/s) rise.  While the input is
a level plus a slope, x advances by the exponential of a lower bidiagonal matrix, whose entries are
products of rates and divided differences of exp(-a s) (Opitz).  They stay exact where lags
coincide, and for inputs of one sign no sum cancels.  Cost grows with samples, not with switches.
"""

from __future__ import annotations

import numpy as np

from bayes_sensor.campaign import FloatArray
from bayes_sensor.compiled import compiled
from bayes_sensor.rig.divided_differences import TERMS, divided, divided_tails

BLOCK = 64
"""samples of a uniform grid that are advanced with one table of exponentials"""
ANCHORED = 64
"""blocks after which the state is computed from the last switch again, so that no rounding adds
up"""


# ----------------------------------------------------------------- the state between events


@compiled(inside=True)
def _copy(values: FloatArray, into: FloatArray) -> None:
    # (to assign an array to a slice takes seconds to compile)
    for i in range(len(values)):
        into[i] = values[i]


@compiled(inside=True)
def _settled(rates: FloatArray) -> float:
    # s after which a step of n equal lags is over: e^-60 times 60^2 is below rounding for three
    over: float = (51.0 + 3.0 * len(rates)) / rates[0]
    return over


@compiled(inside=True)
def _after(
    nodes: FloatArray,
    i: int,
    s: float,
    x: FloatArray,
    level: float,
    slope: float,
    table: FloatArray,
    h: FloatArray,
) -> float:
    # Lag number i (from 0) a time s after the state x (n,), with the input level + slope s.
    # nodes (n + 2,): 0, 0 and the sorted rates; two zeros for the ramp, one for the level.
    end = i + 3
    filled = 0
    for j in range(i + 1):
        if x[j] != 0.0:
            filled = j + 1
    scale = 1.0
    if slope == 0.0 and filled == 0:
        if level == 0.0:
            return 0.0
        for j in range(2, end):
            scale *= -nodes[j]
        value: float = level * (scale * divided(nodes[1:end], s, table, h))
        return value
    if slope == 0.0 and level == 0.0 and filled == 1:
        for j in range(3, end):
            scale *= -nodes[j]
        value = x[0] * (scale * divided(nodes[2:end], s, table, h))
        return value
    begin = 0 if slope != 0.0 else 1
    divided_tails(nodes[begin:end], s, table, h)
    value = 0.0
    for j in range(i, -1, -1):
        value += scale * table[2 + j - begin] * x[j]
        scale *= -nodes[2 + j]
    value += level * scale * table[1 - begin]
    if begin == 0:
        value -= slope * scale * table[0]
    return value


@compiled(inside=True)
def _weights(
    nodes: FloatArray,
    x: FloatArray,
    level: float,
    slope: float,
    weights: FloatArray,
) -> None:
    # (n + 2,) of the divided differences over the last nodes in the response after state x (n,)
    n = len(x)
    scale = 1.0
    for j in range(n - 1, -1, -1):
        weights[2 + j] = scale * x[j]
        scale *= -nodes[2 + j]
    weights[1] = level * scale
    weights[0] = -slope * scale


@compiled()
def at_any_times(
    t: FloatArray,
    rates: FloatArray,
    times: FloatArray,
    kicks: FloatArray,
    level: FloatArray,
    slope: FloatArray,
    out: FloatArray,
) -> None:
    # Each sample from the state at the last event before it: rest + weights . divided differences
    # over nodes[e, begin:].  Where one weight alone is not zero, only the first of these is needed.
    n, n_events = len(rates), len(times)
    nodes, table, h = np.zeros(n + 2), np.empty(n + 2), np.empty(TERMS)
    _copy(rates, nodes[2:])
    with_level, lags_only = nodes[1:], rates
    weights, rest = np.zeros((n_events, n + 2)), np.zeros(n_events)
    begin = np.zeros(n_events, np.int64)
    alone = np.zeros(n_events, np.bool_)
    x, found = np.zeros(n), np.empty(n)
    over = _settled(rates)
    for e in range(n_events):
        if e > 0:
            s = times[e] - times[e - 1]
            lag = 0.0
            for i in range(n):
                lag += 1.0 / rates[i]
                if s > over:
                    found[i] = level[e - 1] + slope[e - 1] * (s - lag)
                else:
                    found[i] = _after(nodes, i, s, x, level[e - 1], slope[e - 1], table, h)
            _copy(found, x)
        steady = True
        for i in range(n):
            if x[i] != x[0]:
                steady = False
        rest[e] = x[0] if steady else 0.0
        begin[e] = 0 if slope[e] != 0.0 else (1 if level[e] != rest[e] else 2)
        alone[e] = steady and (kicks[e] == 0.0 or begin[e] == 2) and begin[e] > 0
        if steady:
            found[:] = 0.0
        else:
            _copy(x, found)
        found[0] += kicks[e] * rates[0]
        x[0] += kicks[e] * rates[0]
        _weights(nodes, found, level[e] - rest[e], slope[e], weights[e])
    lag = 0.0
    for i in range(n):
        lag += 1.0 / rates[i]
    e, i = -1, 0
    while i < len(t):
        while e + 1 < n_events and times[e + 1] < t[i]:
            e += 1
        while e >= 0 and not times[e] < t[i]:
            e -= 1
        since = times[e] if e >= 0 else -np.inf
        until = times[e + 1] if e + 1 < n_events else np.inf
        end = i + 1  # of the samples between these two events
        while end < len(t) and since < t[end] <= until:
            end += 1
        if e < 0:
            out[i:end] = 0.0
        elif alone[e]:
            here = with_level if begin[e] == 1 else lags_only
            weight = weights[e, begin[e]]
            for k in range(i, end):
                s = t[k] - since
                if s > over or weight == 0.0:
                    out[k] = level[e]
                else:
                    out[k] = rest[e] + weight * divided(here, s, table, h)
        else:
            here, weight_of = nodes[begin[e] :], weights[e, begin[e] :]
            for k in range(i, end):
                s = t[k] - since
                if s > over:
                    out[k] = level[e] + slope[e] * (s - lag)
                    continue
                divided_tails(here, s, table, h)
                value = rest[e]
                for j in range(len(here)):
                    value += weight_of[j] * table[j]
                out[k] = value
        i = end


@compiled()
def by_switches(
    t: FloatArray, rates: FloatArray, times: FloatArray, heights: FloatArray, out: FloatArray
) -> None:
    # out (n_switches, n_t)
    table, h = np.empty(len(rates)), np.empty(TERMS)
    over = _settled(rates)
    product = -rates[0]
    for j in range(1, len(rates)):
        product *= -rates[j]
    for e in range(len(times)):
        for i in range(len(t)):
            s = t[i] - times[e]
            out[e, i] = 0.0
            if 0.0 < s < over:
                out[e, i] = heights[e] * (product * divided(rates, s, table, h))


# ----------------------------------------------------------------- uniform grids


@compiled(inside=True)
def _propagator(
    rates: FloatArray, s: float, matrix: FloatArray, table: FloatArray, h: FloatArray
) -> None:
    # matrix (n, n), lower: the state after s is matrix @ state where the input is zero
    for i in range(len(rates)):
        divided_tails(rates[: i + 1], s, table, h)
        scale = 1.0
        for j in range(i, -1, -1):
            matrix[i, j] = scale * table[j]
            scale *= -rates[j]


@compiled(inside=True)
def _advance(matrix: FloatArray, x: FloatArray, found: FloatArray) -> None:
    # found = matrix @ x, lower triangular; not in place
    for i in range(len(x)):
        total = 0.0
        for j in range(i + 1):
            total += matrix[i, j] * x[j]
        found[i] = total


@compiled()
def on_grid(
    first: float,
    interval: float,
    rates: FloatArray,
    times: FloatArray,
    kicks: FloatArray,
    level: FloatArray,
    out: FloatArray,
) -> None:
    # Few events, levels and impulses.  Kept is the distance d of the lags from the input's level,
    # which decays between events: anchor at the last event, d at the first sample of a block.
    n, n_t, n_events = len(rates), len(out), len(times)
    table, h = np.empty(n), np.empty(TERMS)
    matrix, stride = np.empty((n, n)), np.empty((n, n))
    rows = np.empty((n, BLOCK))
    for k in range(min(BLOCK, n_t)):
        divided_tails(rates, k * interval, table, h)
        scale = 1.0
        for j in range(n - 1, -1, -1):
            rows[j, k] = scale * table[j]
            scale *= -rates[j]
    _propagator(rates, BLOCK * interval, stride, table, h)
    least = 0.0
    for e in range(n_events):
        least = max(least, 1e-17 * max(abs(level[e]), abs(kicks[e]) * rates[0]))
    anchor, d, found = np.zeros(n), np.empty(n), np.empty(n)
    at, now = first, 0.0  # at rest before the first event
    i = e = 0
    while i < n_t:
        while e < n_events and times[e] < first + i * interval:
            if e > 0:
                _propagator(rates, times[e] - at, matrix, table, h)
                _advance(matrix, anchor, found)
                _copy(found, anchor)
            at = times[e]
            for j in range(n):
                anchor[j] += level[e] - now
            anchor[0] -= kicks[e] * rates[0]
            now = level[e]
            e += 1
        end = n_t
        if e < n_events and times[e] < first + n_t * interval:
            # the first sample after the next event; the loop above settles which it is
            end = min(max(int((times[e] - first) / interval), i + 1), n_t)
            while end < n_t and not times[e] < first + end * interval:
                end += 1
            while end > i + 1 and times[e] < first + (end - 1) * interval:
                end -= 1
        block = 0
        while i < end:
            if block % ANCHORED == 0:
                _propagator(rates, first + i * interval - at, matrix, table, h)
                _advance(matrix, anchor, d)
            else:
                _advance(stride, d, found)
                _copy(found, d)
            left = 0.0
            for j in range(n):
                left += abs(d[j])
            if left <= least:
                out[i:end] = now
                i = end
                break
            m = min(BLOCK, end - i)
            part = out[i : i + m]
            part[:] = now
            for j in range(n):
                row, weight = rows[j], d[j]
                for k in range(m):
                    part[k] -= row[k] * weight
            i += m
            block += 1


@compiled()
def recorded(
    ahead: float,
    interval: float,
    rates: FloatArray,
    level: FloatArray,
    slope: FloatArray,
    out: FloatArray,
) -> None:
    # An input with an event in every interval: event k is ``ahead`` + k intervals after the first
    # sample.  A sample's state follows from that of the sample before, in two parts: to the event
    # between them, and from it.
    n, n_events = len(rates), len(level)
    nodes, table, h = np.zeros(n + 2), np.empty(n + 2), np.empty(TERMS)
    _copy(rates, nodes[2:])
    whole = np.floor(ahead / interval)
    part = ahead - whole * interval
    first, second, step = np.empty((n, n)), np.empty((n, n)), np.empty((n, n))
    _propagator(rates, part, first, table, h)
    _propagator(rates, interval - part, second, table, h)
    _propagator(rates, interval, step, table, h)
    # what a unit of the level and of the slope before and after the event adds to the state
    rest, held = np.zeros(n), np.empty((4, n))
    early = np.empty((2, n))
    for i in range(n):
        early[0, i] = _after(nodes, i, part, rest, 1.0, 0.0, table, h)
        early[1, i] = (interval - part) * early[0, i]
        early[1, i] += _after(nodes, i, part, rest, 0.0, 1.0, table, h)
        held[2, i] = _after(nodes, i, interval - part, rest, 1.0, 0.0, table, h)
        held[3, i] = _after(nodes, i, interval - part, rest, 0.0, 1.0, table, h)
    _advance(second, early[0], held[0])
    _advance(second, early[1], held[1])
    x, found = np.zeros(n), np.empty(n)
    # events before the first sample, one at a time: k is that in the interval that follows
    begin = min(0, int(whole))
    for i in range(begin, len(out)):
        if i >= 0:
            out[i] = x[n - 1]
        k = i - int(whole)
        _advance(step, x, found)
        if 0 < k <= n_events:
            for j in range(n):
                found[j] += held[0, j] * level[k - 1] + held[1, j] * slope[k - 1]
        elif k > n_events:
            ended = level[n_events - 1]
            for j in range(n):
                found[j] += held[0, j] * ended
        if 0 <= k < n_events:
            for j in range(n):
                found[j] += held[2, j] * level[k] + held[3, j] * slope[k]
        elif k >= n_events:
            ended = level[n_events - 1]
            for j in range(n):
                found[j] += held[2, j] * ended
        _copy(found, x)
