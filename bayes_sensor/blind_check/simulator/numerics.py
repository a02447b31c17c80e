"""Time stepping: nodes in time, lags followed exactly from node to node, Runge-Kutta for the rest.

Every function takes nodes ``t`` (n,) s and inputs that are straight lines between them.
"""

from __future__ import annotations

from math import ceil, exp, tanh

import numpy as np

from bayes_sensor.campaign import FloatArray
from bayes_sensor.compiled import compiled


def nodes(times: FloatArray, events: list[float], quick: float) -> FloatArray:
    """(n,) s: the times asked for, every event, and steps that are short after each event.

    ``quick`` (s) is the fastest of the slow parts; steps stay below a hundredth of it while the
    response moves and grow in proportion to the time since the event later.
    """
    events = sorted(set(events))
    first = min(min(float(times[0]), *events) - 1.0, 0.0)
    last = float(times[-1])
    pieces = [times, np.array([first, *events])]
    for event, end in zip(events, [*events[1:], last], strict=True):
        pieces.append(event + _growing_steps(end - event, quick))
    grid = np.unique(np.concatenate(pieces))
    grid = grid[grid <= last]
    # times that differ by rounding only would make intervals of no length
    kept: FloatArray = grid[np.concatenate([[True], np.diff(grid) > 1e-9])]
    return kept


@compiled()
def _growing_steps(length: float, quick: float) -> FloatArray:
    """(n,) s from 0 to ``length``: 0.1 ms at first, then up to ``quick``/100, later growing."""
    count, s = 0, 0.0
    for counting in (True, False):
        if not counting:
            offsets = np.empty(count)
            count, s = 0, 0.0
        while s < length:
            if not counting:
                offsets[count] = s
            count += 1
            s += max(min(1e-4 + 0.02 * s, 0.01 * quick), 0.004 * (s - 25.0 * quick))
    return offsets


@compiled()
def lagged(x: float, a: float, b: float, h: float, tau: float) -> float:
    """End of a step h (s) of x' = (u - x)/``tau`` while u goes straight from ``a`` to ``b``."""
    behind = tau * ((b - a) / h)
    return b - behind + (x - a + behind) * exp(-h / tau)


@compiled()
def lag(t: FloatArray, u: FloatArray, tau: FloatArray, start: float) -> FloatArray:
    """(n,) state of x' = (u - x)/tau from ``start``; ``tau`` (n - 1,) s holds between nodes."""
    n = len(t)
    x = np.empty(n)
    x[0] = start
    old_h, old_tau, e = -1.0, -1.0, 0.0
    for i in range(n - 1):
        h = t[i + 1] - t[i]
        if abs(h - old_h) > 1e-13 or tau[i] != old_tau:
            e = exp(-h / tau[i])
            old_h, old_tau = h, tau[i]
        slope = (u[i + 1] - u[i]) / h
        x[i + 1] = u[i + 1] - tau[i] * slope + (x[i] - u[i] + tau[i] * slope) * e
    return x


def steady_lag(t: FloatArray, u: FloatArray, tau: float) -> FloatArray:
    """(n,) :func:`lag` of one time constant (s), from rest at ``u[0]``; ``u`` if that is 0."""
    if tau <= 0.0:
        return u
    return np.asarray(lag(t, u, np.full(len(t) - 1, tau), float(u[0])))


@compiled()
def valve(
    t: FloatArray, first: FloatArray, last: FloatArray, tau_v: float, closing: float
) -> FloatArray:
    """(n,) opening x1 of a valve drawn towards a target that may jump at nodes.

    ``first``, ``last`` (n - 1,): the target at both ends of each interval.  While it closes, its
    time constant is tau_v (1 + closing (0.6 + 0.8 x1)): the spring pushes the less, the further it
    has come.
    """
    n = len(t)
    x = np.zeros(n)
    for i in range(n - 1):
        h = t[i + 1] - t[i]
        middle = x[i]
        for _ in range(2):  # predictor, corrector of the state that sets the rate
            tau = tau_v
            if closing != 0.0 and 0.5 * (first[i] + last[i]) < middle:
                tau = tau_v * max(0.05, 1.0 + closing * (0.6 + 0.8 * middle))
            end = lagged(x[i], first[i], last[i], h, tau)
            middle = 0.5 * (x[i] + end)
        x[i + 1] = end
    return x


@compiled()
def heavy_valve(
    t: FloatArray, first: FloatArray, last: FloatArray, tau_v: float, inertia: float
) -> FloatArray:
    """(n,) opening of a valve that moves a mass.

    kappa tau_v^2 x'' + tau_v x' (1 + kappa/4 |tau_v x'|) + x = u with kappa = ``inertia``: the
    drag grows a little with speed.
    """
    n = len(t)
    out = np.zeros(n)
    x, v = 0.0, 0.0  # v = tau_v x'
    share = (0.0, 0.5, 0.5, 1.0)
    for i in range(n - 1):
        steps = max(1, ceil((t[i + 1] - t[i]) / (0.2 * inertia * tau_v)))
        h = (t[i + 1] - t[i]) / steps
        for step in range(steps):
            dx, dv, sum_x, sum_v = 0.0, 0.0, 0.0, 0.0
            for stage in range(4):
                u = first[i] + (step + share[stage]) / steps * (last[i] - first[i])
                p, w = x + share[stage] * h * dx, v + share[stage] * h * dv
                drag = w * (1.0 + 0.25 * inertia * abs(w))
                dx, dv = w / tau_v, (u - p - drag) / (inertia * tau_v)
                weight = 1.0 if stage in (0, 3) else 2.0
                sum_x += weight * dx
                sum_v += weight * dv
            x += h / 6.0 * sum_x
            v += h / 6.0 * sum_v
        out[i + 1] = x
    return out


@compiled()
def stick_slip(x: FloatArray, band: float) -> FloatArray:
    """(n,) ``x`` followed by a part that sticks until it is ``band`` behind, then slips onto it.

    The band shrinks near the ends of the stroke, where the stop holds the part in place.
    """
    out = np.empty(len(x))
    place = x[0]
    for i in range(len(x)):
        if abs(x[i] - place) > band * (0.02 + 4.0 * x[i] * (1.0 - x[i])):
            place = x[i]
        out[i] = place
    return out


@compiled()
def connected_volumes(
    t: FloatArray,
    u: FloatArray,
    flow: FloatArray,
    through: FloatArray,
    between: FloatArray,
    longest: float,
) -> FloatArray:
    """(n, m) concentrations from 0 in m volumes that the gas ``u`` (n,) flows through.

    x' = flow (through x + inflow u) + between x with ``flow`` (n,) mL/s, ``through`` (m, m) 1/mL
    and ``between`` (m, m) 1/s; the rows of ``through`` and inflow together add up to 0.  Classical
    Runge-Kutta with steps of at most ``longest`` (s).
    """
    n, m = len(t), len(through)
    x = np.zeros((n, m))
    inflow = -through.sum(axis=1)
    slope, trial, total = np.zeros(m), np.zeros(m), np.zeros(m)
    share = (0.0, 0.5, 0.5, 1.0)
    for i in range(n - 1):
        steps = max(1, ceil((t[i + 1] - t[i]) / longest))
        h = (t[i + 1] - t[i]) / steps
        x[i + 1] = x[i]
        for step in range(steps):
            total[:] = 0.0
            for stage in range(4):
                at = (step + share[stage]) / steps
                inlet = u[i] + at * (u[i + 1] - u[i])
                q = flow[i] + at * (flow[i + 1] - flow[i])
                for j in range(m):
                    trial[j] = x[i + 1, j] + share[stage] * h * slope[j] * (stage > 0)
                for j in range(m):
                    slope[j] = q * inflow[j] * inlet
                    for k in range(m):
                        slope[j] += (q * through[j, k] + between[j, k]) * trial[k]
                    total[j] += slope[j] if stage in (0, 3) else 2.0 * slope[j]
            for j in range(m):
                x[i + 1, j] += h / 6.0 * total[j]
    return x


@compiled()
def langmuir(
    t: FloatArray, g: FloatArray, tau: float, K: float, bend: float, gate: float, width: float
) -> FloatArray:
    """(n,) coverage over K of sites that fill as r' = [g (1 - K r) - r] e/tau.

    ``g`` (n,) is the gas concentration in units in which K is Langmuir's constant (J. Am. Chem.
    Soc. 40, 1361, 1918); e = exp(bend (r - 1/2) + gate tanh((g - r)/width)): the rate grows with
    coverage (a film that swells) or with what drives the uptake (pores that open under load and
    close behind it).  K, bend and gate 0: a first-order lag.
    """
    n = len(t)
    r = np.empty(n)
    r[0] = g[0] / (1.0 + K * g[0])
    for i in range(n - 1):
        h = t[i + 1] - t[i]
        middle = r[i]
        centre = 0.5 * (g[i] + g[i + 1])
        fill = 1.0 + K * centre
        a = g[i] / (1.0 + K * g[i])
        b = g[i + 1] / (1.0 + K * g[i + 1])
        end = r[i]
        for _ in range(2):
            local = tau / fill
            if bend != 0.0 or gate != 0.0:
                drive = tanh((centre / fill - middle) / width)
                local *= exp(-bend * (middle - 0.5) - gate * drive)
            end = lagged(r[i], a, b, h, local)
            middle = 0.5 * (r[i] + end)
        r[i + 1] = end
    return r


@compiled()
def backlash(x: FloatArray, width: float) -> FloatArray:
    """(n,) ``x`` through a backlash of half-width ``width``."""
    out = np.empty(len(x))
    place = x[0]
    for i in range(len(x)):
        place = max(x[i] - width, min(x[i] + width, place))
        out[i] = place
    return out


@compiled()
def slowly_followed(t: FloatArray, x: FloatArray, rate: FloatArray) -> FloatArray:
    """(n,) what follows ``x`` (n,) no faster than ``rate`` (n,) 1/s."""
    out = np.empty(len(x))
    place = x[0]
    for i in range(len(x)):
        most = rate[i] * (t[i] - t[i - 1]) if i > 0 else 0.0
        place += max(-most, min(most, x[i] - place))
        out[i] = place
    return out


@compiled()
def kept_for_good(t: FloatArray, x: FloatArray, time: float) -> FloatArray:
    """(n,) share of sites that have caught something and never let go: r' = x (1 - r)/``time``."""
    out = np.zeros(len(x))
    exposure = 0.0
    for i in range(1, len(x)):
        exposure += 0.5 * (max(x[i], 0.0) + max(x[i - 1], 0.0)) * (t[i] - t[i - 1])
        out[i] = 1.0 - exp(-exposure / time)
    return out


@compiled()
def two_ranges(y: FloatArray, up: float, down: float, gap: float) -> FloatArray:
    """(n,) ``y``, plus ``gap`` from where it rises above ``up`` until it falls below ``down``."""
    out = np.empty(len(y))
    upper = y[0] > up
    for i in range(len(y)):
        if y[i] > up:
            upper = True
        elif y[i] < down:
            upper = False
        out[i] = y[i] + gap if upper else y[i]
    return out


def layered_film(mean_time: float, n_cells: int = 18) -> tuple[FloatArray, FloatArray]:
    """Time constants (n,) s and weights (n,) of a two-layer film, seen near its bottom.

    Finite volumes across a permeable cover (four fifths of the height, 25 times the diffusivity)
    on a dense layer, gas at the top, none through the bottom.  The space is gridded, time is left
    to the modes of the grid.  Diffusivities are scaled so that the mean delay is ``mean_time``.
    """
    width = 1.0 / n_cells
    dense = round(0.2 * n_cells)
    diffusivity = np.where(np.arange(n_cells) < dense, 1.0 / 25.0, 1.0)
    # between cell centres resistances add; the top face lies half a cell away from its centre
    between = 1.0 / (0.5 * width / diffusivity[:-1] + 0.5 * width / diffusivity[1:])
    upwards = np.append(between, diffusivity[-1] / (0.5 * width)) / width
    downwards = np.append(0.0, upwards[:-1])
    matrix = np.diag(upwards + downwards) - np.diag(upwards[:-1], 1) - np.diag(upwards[:-1], -1)
    rates, modes = np.linalg.eigh(matrix)
    weights = modes[0] * modes[-1] * upwards[-1] / rates
    times = 1.0 / rates
    return times * mean_time / float(weights @ times), weights
