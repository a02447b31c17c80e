"""Lags on a grid of cells: each advanced exactly for an input that is quadratic within a cell.

Time constants far below the grid's steps are therefore no trouble.
"""

from __future__ import annotations

from math import exp, sqrt
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from bayes_sensor.campaign import FloatArray
from bayes_sensor.compiled import compiled
from bayes_sensor.rig.exponential import exponentials

GROWTH = 1.06
"""each cell is this much longer than the one before"""
SHORT = 1e-3
"""time constants below which a step's moments come from their series"""


class Cells(NamedTuple):
    """The cells of a grid, and the input of a lag in them: quadratic in each."""

    h: FloatArray
    """(n,) s, their lengths"""
    a: FloatArray
    """(n,) input at their begins"""
    m: FloatArray
    """(n,) in their middles"""
    b: FloatArray
    """(n,) at their ends; it may jump to the next begin"""


@compiled(inside=True, forceinline=True)
def _moments(r: float, decay: float) -> tuple[float, float]:
    # what a lag makes, over a step of r time constants in which it decays by the factor ``decay``,
    # of inputs q and q^2, q the part of the step
    per = 1.0 / max(r, SHORT)
    m1 = 1.0 - (1.0 - decay) * per
    m2 = 1.0 - 2.0 * m1 * per
    if r < SHORT:
        return _short_moments(r)
    return m1, m2


@compiled(inside=True, forceinline=True)
def _short_moments(r: float) -> tuple[float, float]:
    # the same by their series
    return (
        r * (0.5 - r / 6.0 * (1.0 - 0.25 * r)),
        r * (1.0 / 3.0 - r / 12.0 * (1.0 - 0.2 * r)),
    )


@compiled(inside=True, forceinline=True)
def _curve(a: float, m: float, b: float) -> tuple[float, float]:
    # rise and bend of the quadratic a + rise q + bend q^2 that passes a, m, b at q = 0, 1/2, 1
    return 4.0 * m - 3.0 * a - b, 2.0 * a - 4.0 * m + 2.0 * b


@compiled(inside=True, forceinline=True)
def advance(x: float, r: float, a: float, m: float, b: float) -> float:
    # a lag's state after r time constants under an input that passes a, m, b
    decay = exp(-r)
    m1, m2 = _moments(r, decay)
    rise, bend = _curve(a, m, b)
    return a + decay * (x - a) + m1 * rise + m2 * bend


@compiled(inside=True)
def lag_states(cells: Cells, rates: FloatArray, states: FloatArray) -> None:
    # a lag's states (n + 1,) at the ends of n cells, its rate another one in each
    h, a, m, b = cells
    n = len(h)
    decay = np.empty(n)
    for i in range(n):
        decay[i] = -rates[i] * h[i]
    exponentials(decay)
    driven = np.empty(n)
    for i in range(n):
        m1, m2 = _moments(rates[i] * h[i], decay[i])
        rise, bend = _curve(a[i], m[i], b[i])
        driven[i] = a[i] * (1.0 - decay[i]) + m1 * rise + m2 * bend
    states[0] = 0.0
    for i in range(n):
        states[i + 1] = decay[i] * states[i] + driven[i]


@compiled(inside=True)
def add_within(
    share: float,
    places: NDArray[np.int64],
    since: FloatArray,
    cells: Cells,
    rates: FloatArray,
    states: FloatArray,
    out: FloatArray,
) -> None:
    # adds a share of the states that a lag (see :func:`lag_states`) has at times (n_t,) ``since``
    # the begins of the cells at these ``places`` (n_t,)
    h, a, m, b = cells
    n = len(h)
    of_cell = np.empty((n, 6))
    for i in range(n):
        rise, bend = _curve(a[i], m[i], b[i])
        per = 1.0 / h[i]
        of_cell[i, 0] = share * a[i]
        of_cell[i, 1] = share * (states[i] - a[i])
        of_cell[i, 2] = share * rise * per
        of_cell[i, 3] = share * bend * per * per
        of_cell[i, 4] = rates[i]
        of_cell[i, 5] = 1.0 / rates[i]
    decay = np.empty(len(places))
    for q in range(len(places)):
        decay[q] = -rates[places[q]] * since[q]
    exponentials(decay)
    for q in range(len(places)):
        cell, s = of_cell[places[q]], since[q]
        start, away, rise, bend, tau = cell[0], cell[1], cell[2], cell[3], cell[5]
        r = cell[4] * s
        s1 = s - (1.0 - decay[q]) * tau  # what the lag makes of inputs s and s^2
        s2 = s * s - 2.0 * s1 * tau
        if r < SHORT:
            m1, m2 = _short_moments(r)
            s1, s2 = s * m1, s * s * m2
        out[q] += start + decay[q] * away + rise * s1 + bend * s2


@compiled()
def add_butterworth(
    places: NDArray[np.int64], since: FloatArray, cells: Cells, time: float, out: FloatArray
) -> None:
    # adds what a low-pass of two poles makes of the cells at times (n_t,) as in add_within, exact:
    # T^2 y'' + sqrt(2) T y' + y = u, at rest before the first cell
    h, a, m, b = cells
    n = len(h)
    sigma = np.sqrt(0.5) / time
    y, v = 0.0, 0.0
    of_cell = np.empty((n, 5))
    for i in range(n):
        rise, bend = _curve(a[i], m[i], b[i])
        per = 1.0 / h[i]
        square = bend * per * per
        slope = rise * per - 2.0 * np.sqrt(2.0) * square * time
        level = a[i] - np.sqrt(2.0) * slope * time - 2.0 * square * time * time
        cosine = y - level
        sine = (v - slope) / sigma + cosine
        of_cell[i, 0], of_cell[i, 1], of_cell[i, 2] = level, slope, square
        of_cell[i, 3], of_cell[i, 4] = cosine, sine
        s = h[i]
        decay, c, d = np.exp(-sigma * s), np.cos(sigma * s), np.sin(sigma * s)
        y = level + s * (slope + s * square) + decay * (cosine * c + sine * d)
        v = slope + 2.0 * s * square + sigma * decay * ((sine - cosine) * c - (sine + cosine) * d)
    for q in range(len(places)):
        cell, s = of_cell[places[q]], since[q]
        swing = cell[3] * np.cos(sigma * s) + cell[4] * np.sin(sigma * s)
        out[q] += cell[0] + s * (cell[1] + s * cell[2]) + np.exp(-sigma * s) * swing


@compiled(inside=True)
def grow_grid(grid: FloatArray, at: int, end: float, first: float) -> int:
    # continues a grid, whose last point is number ``at``, to ``end``; returns that one's number
    begin, step, s, away = at, first, 0.0, end - grid[at]
    while s < away:
        at += 1
        grid[at] = grid[at - 1] + step
        s += step
        step *= GROWTH
    grid[at] = end
    if at - begin > 1 and grid[at] - grid[at - 1] < 0.3 * (grid[at - 1] - grid[at - 2]):
        grid[at - 1] = 0.5 * (grid[at] + grid[at - 2])  # no sliver before the next switch
    return at


@compiled(inside=True)
def fill_middles(
    h: FloatArray,
    x: FloatArray,
    a: FloatArray,
    b: FloatArray,
    rates_a: FloatArray,
    rates_b: FloatArray,
    mid: FloatArray,
) -> None:
    # states (n,) of a lag in the middles of n cells, from those at their ends (n + 1,): by the
    # cubic through values and slopes, which jump where input (a, b) or rate do at a switch; the
    # slopes are limited where the lag is much faster than the cell
    for i in range(len(h)):
        step = x[i + 1] - x[i]
        slopes = rates_a[i] * (a[i] - x[i]) - rates_b[i] * (b[i] - x[i + 1])
        bend, limit = 0.125 * h[i] * slopes, 0.5 * abs(step)
        mid[i] = 0.5 * (x[i] + x[i + 1]) + min(max(bend, -limit), limit)


@compiled(inside=True)
def with_pocket(
    cells: Cells, rates: FloatArray, share: float, time: float, x2: FloatArray, pocket: FloatArray
) -> None:
    # fills x2 (n + 1,) and the concentration in a stagnant pocket (n + 1,), both from 0, at the
    # ends of n cells:
    # x2' = rate (g - x2) + k (pocket - x2), pocket' = (x2 - pocket)/time, k = share/time:
    # two decaying modes, both driven by g
    h, a, m, b = cells
    exchange = 1.0 / time
    k = share * exchange
    for i in range(len(h)):
        rate = rates[i]
        trace = rate + k + exchange
        root = sqrt(trace * trace - 4.0 * rate * exchange)
        fast, slow = 0.5 * (trace + root), 2.0 * rate * exchange / (trace + root)
        # left eigenvectors (1, v): v = k/(lambda - exchange) of x2, pocket
        vf, vs = -k / (fast - exchange), -k / (slow - exchange)
        zf, zs = x2[i] + vf * pocket[i], x2[i] + vs * pocket[i]
        gf, gs = rate / fast, rate / slow
        zf = advance(zf, fast * h[i], gf * a[i], gf * m[i], gf * b[i])
        zs = advance(zs, slow * h[i], gs * a[i], gs * m[i], gs * b[i])
        pocket[i + 1] = (zf - zs) / (vf - vs)
        x2[i + 1] = zf - vf * pocket[i + 1]


@compiled(inside=True)
def passed(cells: Cells, rates: FloatArray) -> tuple[FloatArray, FloatArray]:
    # what a lag makes of the cells, at their ends (n + 1,) and in their middles (n,)
    n = len(rates)
    states, mid = np.zeros(n + 1), np.zeros(n)
    lag_states(cells, rates, states)
    add_within(1.0, np.arange(n), 0.5 * cells.h, cells, rates, states, mid)
    return states, mid


@compiled(inside=True)
def _swinging(cells: Cells, time: float, damping: float) -> tuple[FloatArray, FloatArray]:
    # T^2 y'' + 2 z T y' + y = u at the ends (n + 1,) and in the middles (n,) of cells, exact; the
    # damping z below 1, T the time; at rest before the first cell
    h, a, m, b = cells
    n = len(h)
    sigma, omega = damping / time, sqrt(1.0 - damping * damping) / time
    ends, mid = np.zeros(n + 1), np.zeros(n)
    y, v = 0.0, 0.0
    for i in range(n):
        per = 1.0 / h[i]
        rise, bend = 4.0 * m[i] - 3.0 * a[i] - b[i], 2.0 * a[i] - 4.0 * m[i] + 2.0 * b[i]
        square = bend * per * per
        slope = rise * per - 4.0 * damping * time * square
        level = a[i] - 2.0 * damping * time * slope - 2.0 * time * time * square
        cosine = y - level
        sine = (v - slope + sigma * cosine) / omega
        for half in range(2):
            s = h[i] * (0.5 + 0.5 * half)
            decay, c, d = np.exp(-sigma * s), np.cos(omega * s), np.sin(omega * s)
            y = level + s * (slope + s * square) + decay * (cosine * c + sine * d)
            v = slope + 2.0 * s * square
            v += decay * ((omega * sine - sigma * cosine) * c - (omega * cosine + sigma * sine) * d)
            if half == 0:
                mid[i] = y
        ends[i + 1] = y
    return ends, mid


@compiled(inside=True)
def of_two_poles(cells: Cells, time: float, damping: float) -> tuple[FloatArray, FloatArray]:
    # the same for any damping; above 1 it is two lags in a row
    if damping < 1.0 - 1e-9:
        return _swinging(cells, time, damping)
    apart = sqrt(max(damping * damping - 1.0, 0.0))
    n = len(cells.h)
    states, mid = passed(cells, np.full(n, 1.0 / (time * (damping + apart))))
    inner = Cells(cells.h, states[:-1], mid, states[1:])
    return passed(inner, np.full(n, (damping + apart) / time))
