"""Stages of the rig, each stepped through time: input at the nodes in, state at the nodes out.

``t`` (n,) s are increasing nodes, unevenly spaced, with a node at every jump of an input.  Between
nodes an input runs in a straight line and a linear stage follows it exactly (exponential
integrator, Hochbruck and Ostermann, Acta Numerica 19, 2010); coupled or bent stages take classical
Runge-Kutta steps inside, as many as stability wants.
"""

from __future__ import annotations

from math import ceil, exp, pi, tanh

import numpy as np
from numba import njit
from numpy.typing import NDArray

from bayes_sensor.campaign import FloatArray


@njit(cache=True)
def growing_steps(length: float, quick: float) -> FloatArray:  # pragma: no cover - compiled
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


@njit(cache=True, error_model="numpy")
def lagged(
    x: float, a: float, b: float, h: float, tau: float
) -> float:  # pragma: no cover - compiled
    """End of a step h (s) of x' = (u - x)/``tau`` while u goes straight from ``a`` to ``b``."""
    behind = tau * ((b - a) / h)
    return b - behind + (x - a + behind) * exp(-h / tau)


@njit(cache=True, error_model="numpy")
def lag(
    t: FloatArray, u: FloatArray, tau: FloatArray, start: float
) -> FloatArray:  # pragma: no cover - compiled
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


@njit(cache=True, error_model="numpy")
def layers(
    t: FloatArray, u: FloatArray, tau: FloatArray, hindrance: float, start: float
) -> FloatArray:  # pragma: no cover - compiled
    """(n,) state of x' = (u - x)/(tau (1 + ``hindrance`` x)); ``tau`` as in :func:`lag`."""
    n = len(t)
    x = np.empty(n)
    x[0] = start
    for i in range(n - 1):
        h = t[i + 1] - t[i]
        middle = x[i]
        for _ in range(2):  # predictor, corrector of the state that sets the rate
            end = lagged(x[i], u[i], u[i + 1], h, tau[i] * (1.0 + hindrance * middle))
            middle = 0.5 * (x[i] + end)
        x[i + 1] = end
    return x


@njit(cache=True, error_model="numpy")
def fanned(
    t: FloatArray, u: FloatArray, passage: FloatArray, runs: FloatArray, corner: float
) -> FloatArray:  # pragma: no cover - compiled
    """(n,) state from 0 of a volume whose share ``corner`` is mixed in only while a fan ``runs``.

    Between nodes passage x' = u - x with ``passage`` (n - 1,) s of the whole volume, or without the
    corner where ``runs`` (n - 1,) is 0; both are mixed at the node where it is no longer.
    """
    n = len(t)
    out = np.zeros(n)
    x, left = 0.0, 0.0
    for i in range(n - 1):
        time = passage[i]
        if runs[i] > 0.0:
            x += corner * (left - x)
        else:
            time *= 1.0 - corner
        x = lagged(x, u[i], u[i + 1], t[i + 1] - t[i], time)
        if runs[i] > 0.0:
            left = x
        out[i + 1] = x
    return out


@njit(cache=True, error_model="numpy")
def weighed_down(
    t: FloatArray, u: FloatArray, flow: FloatArray, V: float, riser: float, weight: float
) -> FloatArray:  # pragma: no cover - compiled
    """(n,) state from 0 of V x' = q (u - x) with q = ``flow`` (1 - ``weight`` m).

    m is the mean of x in a hose of ``riser`` (mL) behind the volume V (mL), through which it goes
    without mixing; ``flow`` (n,) mL/s.
    """
    n = len(t)
    x, passed, had = np.zeros(n), np.zeros(n), np.zeros(n)
    m, k = 0.0, 0
    for i in range(n - 1):
        h = t[i + 1] - t[i]
        begin, middle = flow[i] * (1.0 - weight * m), m
        for _ in range(3):  # predictor, correctors of the mean that sets the rate
            q = 0.5 * (begin + flow[i + 1] * (1.0 - weight * middle))
            x[i + 1] = lagged(x[i], u[i], u[i + 1], h, V / q)
            passed[i + 1] = passed[i] + q * h
            had[i + 1] = had[i] + 0.5 * (x[i] + x[i + 1]) * q * h
            top, left = passed[i + 1] - riser, 0.0
            if top > 0.0:
                while passed[k + 1] < top:
                    k += 1
                share = (top - passed[k]) / (passed[k + 1] - passed[k])
                left = had[k] + share * (had[k + 1] - had[k])
            middle = (had[i + 1] - left) / riser
        m = middle
    return x


@njit(cache=True, error_model="numpy")
def sticky_wall(
    t: FloatArray, u: FloatArray, held: FloatArray, bend: float, n_cells: int
) -> FloatArray:  # pragma: no cover - compiled
    """(n,) outlet of ``n_cells`` cells in a row whose wall holds x/(1 + ``bend`` x) at once.

    held x'/(1 + bend x)^2 = u - x in every cell; ``held`` (n - 1,) s holds between nodes.  The gas
    in a cell is little, and its passage counted elsewhere.
    """
    n = len(t)
    x = u.copy()
    for _ in range(n_cells):
        before = x.copy()
        for i in range(n - 1):
            h = t[i + 1] - t[i]
            middle = x[i]
            for _ in range(3):  # predictor, correctors of the state that sets the rate
                local = held[i] / (1.0 + bend * middle) ** 2
                end = lagged(x[i], before[i], before[i + 1], h, local)
                middle = 0.5 * (x[i] + end)
            x[i + 1] = end
    return x


@njit(cache=True)
def condensing(
    t: FloatArray, u: FloatArray, level: float, patch: float
) -> FloatArray:  # pragma: no cover - compiled
    """(n,) gas behind a spot where it is saturated at ``level``: what is beyond makes a film.

    The film m' = u - out grows by all that is too much, and gives back what is missing where it
    covers the wall: out = u + (level - u) (1 - exp(-m/patch)).  With E = exp(m/patch) - 1 drying is
    E' = -(level - u) E/patch.
    """
    n = len(t)
    out = np.empty(n)
    m = 0.0
    for i in range(n):
        if i > 0:
            h = t[i] - t[i - 1]
            missing = level - 0.5 * (u[i - 1] + u[i])
            if missing <= 0.0:
                m -= missing * h
            elif m > 0.0:
                left = (m - missing * h) / patch + np.log(-np.expm1(-m / patch))  # log E
                m = patch * (max(left, 0.0) + np.log1p(exp(-abs(left))))
        out[i] = level if u[i] > level else u[i] - (level - u[i]) * np.expm1(-m / patch)
    return out


@njit(cache=True, error_model="numpy")
def pairing(
    t: FloatArray, u: FloatArray, passage: FloatArray, rate: float
) -> FloatArray:  # pragma: no cover - compiled
    """(n,) state of x' = (u - x)/passage - ``rate`` x^2 from 0; ``passage`` (n - 1,) s."""
    n = len(t)
    x = np.zeros(n)
    for i in range(n - 1):
        h = t[i + 1] - t[i]
        middle = x[i]
        for _ in range(2):  # predictor, corrector of the state that sets the rate
            share = 1.0 / (1.0 + passage[i] * rate * middle)
            local = passage[i] * share
            end = lagged(x[i], share * u[i], share * u[i + 1], h, local)
            middle = 0.5 * (x[i] + end)
        x[i + 1] = end
    return x


@njit(cache=True, error_model="numpy")
def evaporating(
    t: FloatArray, drawn: FloatArray, chill: float, time: float
) -> FloatArray:  # pragma: no cover - compiled
    """(n,) state of time x' = ``chill`` drawn exp(-x) - x from 0: how cold the liquid is.

    In units in which its vapour pressure is exp(-x); ``drawn`` (n,) is the flow through it.
    """
    n = len(t)
    out = np.zeros(n)
    x = 0.0
    share = (0.0, 0.5, 0.5, 1.0)
    for i in range(n - 1):
        steps = max(1, ceil((t[i + 1] - t[i]) * (1.0 + chill) / (0.2 * time)))
        h = (t[i + 1] - t[i]) / steps
        for step in range(steps):
            before, total = 0.0, 0.0
            for stage in range(4):
                at = (step + share[stage]) / steps
                u = drawn[i] + at * (drawn[i + 1] - drawn[i])
                trial = x + share[stage] * h * before
                before = (chill * u * exp(-trial) - trial) / time
                total += before if stage in (0, 3) else 2.0 * before
            x += h / 6.0 * total
        out[i + 1] = x
    return out


@njit(cache=True, error_model="numpy")
def displaced(
    t: FloatArray, load: FloatArray, damp: float, time: float
) -> FloatArray:  # pragma: no cover - compiled
    """(n,) share of the sites that water holds, from ``damp`` where there is no gas.

    time w' = K (1 - w)/(1 + load) - w with K = damp/(1 - damp): of the sites without water the
    share load/(1 + load) is under gas at once; ``load`` (n,) is Langmuir's constant times the gas.
    """
    n = len(t)
    w = np.empty(n)
    K = damp / (1.0 - damp)
    w[0] = K / (1.0 + load[0] + K)
    for i in range(n - 1):
        back = K / (1.0 + 0.5 * (load[i] + load[i + 1]))
        level = back / (1.0 + back)
        w[i + 1] = level + (w[i] - level) * exp(-(t[i + 1] - t[i]) * (1.0 + back) / time)
    return w


@njit(cache=True, error_model="numpy")
def warming_coating(
    t: FloatArray, g: FloatArray, tau: float, heat: float, time: float
) -> FloatArray:  # pragma: no cover - compiled
    """(n,) state of tau x' = g exp(-w) - x from 0 with the warmth w' = ``heat`` x' - w/``time``.

    In units in which the warmth takes exp(-w) of the uptake that the gas ``g`` (n,) would have.
    """
    n = len(t)
    out = np.zeros(n)
    x, w = 0.0, 0.0
    share = (0.0, 0.5, 0.5, 1.0)
    for i in range(n - 1):
        steps = max(1, ceil((t[i + 1] - t[i]) * ((1.0 + heat) / tau + 1.0 / time) / 0.3))
        h = (t[i + 1] - t[i]) / steps
        for step in range(steps):
            dx, dw, total_x, total_w = 0.0, 0.0, 0.0, 0.0
            for stage in range(4):
                gas = g[i] + (step + share[stage]) / steps * (g[i + 1] - g[i])
                at, warm = x + share[stage] * h * dx, w + share[stage] * h * dw
                dx = (gas * exp(-warm) - at) / tau
                dw = heat * dx - warm / time
                weight = 1.0 if stage in (0, 3) else 2.0
                total_x += weight * dx
                total_w += weight * dw
            x += h / 6.0 * total_x
            w += h / 6.0 * total_w
        out[i + 1] = x
    return out


@njit(cache=True)
def splitting(
    t: FloatArray, g: FloatArray, time: float
) -> FloatArray:  # pragma: no cover - compiled
    """(n,) state of time x' = g - x^2, at rest at g[0]: gas ``g`` (n,) that leaves in pairs.

    Riccati's equation, followed exactly with the mean of g between nodes.
    """
    n = len(t)
    x = np.zeros(n)
    x[0] = np.sqrt(max(g[0], 0.0))
    for i in range(n - 1):
        h = (t[i + 1] - t[i]) / time
        gas = max(0.5 * (g[i] + g[i + 1]), 0.0)
        root = np.sqrt(gas)
        reach = tanh(root * h) / root if root > 1e-9 else h
        x[i + 1] = (x[i] + gas * reach) / (1.0 + x[i] * reach)
    return x


@njit(cache=True)
def moving_fronts(
    t: FloatArray, drive: FloatArray, time: float
) -> FloatArray:  # pragma: no cover - compiled
    """(n,) share of a film that has turned, under a ``drive`` (n,) at its surface of either sign.

    Whatever the drive's sign is, a front goes down from the surface, the film behind it turned or
    turned back: depth p with ``time`` p p' = |drive|.  Where it meets the front before it, both
    are gone and the one before those goes on; at depth 1 the film ends.
    """
    n = len(t)
    out = np.zeros(n)
    fronts = np.zeros(64)  # the deepest one first; every other one turns back
    count = 0
    for i in range(n - 1):
        middle = 0.5 * (drive[i] + drive[i + 1])
        forth = count % 2 == 1
        if (middle > 0.0) != forth and (count > 0 or middle > 0.0) and count < 64:
            fronts[count] = 0.0
            count += 1
        if count > 0:
            step = 2.0 * abs(middle) * (t[i + 1] - t[i]) / time
            fronts[count - 1] = min(np.sqrt(fronts[count - 1] ** 2 + step), 1.0)
            if count > 1 and fronts[count - 1] >= fronts[count - 2]:
                count -= 2
        turned = 0.0
        for k in range(count):
            turned += fronts[k] if k % 2 == 0 else -fronts[k]
        out[i + 1] = turned
    return out


@njit(cache=True, error_model="numpy")
def self_heating(
    t: FloatArray, at: FloatArray, rest: float, warming: float, time: float
) -> FloatArray:  # pragma: no cover - compiled
    """(n,) half-widths x by which absorbed light moves a line that gas moves to ``at`` (n,).

    time x' = warming [L(at + x) - L(rest)] - x with the Lorentzian L(z) = 1/(1 + z^2); x is 0
    where the line rests.
    """
    n = len(t)
    out = np.zeros(n)
    dark = 1.0 / (1.0 + rest * rest)
    x = 0.0
    share = (0.0, 0.5, 0.5, 1.0)
    for i in range(n - 1):
        steps = max(1, ceil((t[i + 1] - t[i]) * (1.0 + abs(warming)) / (0.2 * time)))
        h = (t[i + 1] - t[i]) / steps
        for step in range(steps):
            before, total = 0.0, 0.0
            for stage in range(4):
                place = at[i] + (step + share[stage]) / steps * (at[i + 1] - at[i])
                trial = x + share[stage] * h * before
                light = 1.0 / (1.0 + (place + trial) ** 2)
                before = (warming * (light - dark) - trial) / time
                total += before if stage in (0, 3) else 2.0 * before
            x += h / 6.0 * total
        out[i + 1] = x
    return out


@njit(cache=True, error_model="numpy")
def oscillating_lag(
    t: FloatArray, u: FloatArray, time: float, damping: float
) -> FloatArray:  # pragma: no cover - compiled
    """(n,) state of time^2 x'' + 2 damping time x' + x = u, at rest at ``u[0]``; damping < 1.

    x = u[0] + Im(w)/sqrt(1 - damping^2) with w' = pole w + (u - u[0])/time, followed
    exactly like :func:`lag`.
    """
    n = len(t)
    x = np.empty(n)
    x[0] = u[0]
    turn = np.sqrt(1.0 - damping * damping)
    pole = complex(-damping, turn) / time
    w = complex(0.0, 0.0)
    for i in range(n - 1):
        h = t[i + 1] - t[i]
        slope = (u[i + 1] - u[i]) / h / time
        # a + b t solves w' = pole w + f + slope t where pole b = -slope, pole a = b - f
        b = -slope / pole
        a = (b - (u[i] - u[0]) / time) / pole
        w = a + b * h + (w - a) * np.exp(pole * h)
        x[i + 1] = u[0] + w.imag / turn
    return x


@njit(cache=True, error_model="numpy")
def valve(
    t: FloatArray, first: FloatArray, last: FloatArray, tau_v: float, closing: float
) -> FloatArray:  # pragma: no cover - compiled
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


@njit(cache=True, error_model="numpy")
def greased_valve(
    t: FloatArray,
    first: FloatArray,
    last: FloatArray,
    tau_v: float,
    grease: float,
    sets: float,
    yields: float,
) -> FloatArray:  # pragma: no cover - compiled
    """(n,) opening of a valve whose grease has set to the share w, which is 1 at first.

    tau_v (1 + ``grease`` w) x' = u - x and w' = (1 - w)/``sets`` - w |x'|/``yields``; targets as in
    :func:`valve`.
    """
    n = len(t)
    x = np.zeros(n)
    w, old_h, e = 1.0, -1.0, 0.0
    for i in range(n - 1):
        h = t[i + 1] - t[i]
        if first[i] == last[i] and abs(last[i] - x[i]) < 1e-6:  # at rest
            if abs(h - old_h) > 1e-13:
                old_h, e = h, exp(-h / sets)
            x[i + 1], w = last[i], 1.0 + (w - 1.0) * e
            continue
        stiff, end, end_w = w, x[i], w
        for _ in range(2):  # predictor, corrector of the state that sets the rate
            tau = tau_v * (1.0 + grease * stiff)
            end = lagged(x[i], first[i], last[i], h, tau)
            rate = 1.0 / sets + abs(end - x[i]) / (h * yields)
            level = 1.0 / (sets * rate)
            end_w = level + (w - level) * exp(-h * rate)
            stiff = 0.5 * (w + end_w)
        x[i + 1], w = end, end_w
    return x


@njit(cache=True, error_model="numpy")
def heavy_valve(
    t: FloatArray, first: FloatArray, last: FloatArray, tau_v: float, inertia: float
) -> FloatArray:  # pragma: no cover - compiled
    """(n,) opening of a valve that moves a mass.

    kappa tau_v^2 x'' + tau_v x' (1 + kappa/4 |tau_v x'|) + x = u with kappa = ``inertia``: the
    drag grows a little with speed.
    """
    n = len(t)
    out = np.zeros(n)
    x, v = 0.0, 0.0  # v = tau_v x'
    k = np.zeros((4, 2))
    share = (0.0, 0.5, 0.5, 1.0)
    for i in range(n - 1):
        steps = max(1, ceil((t[i + 1] - t[i]) / (0.2 * inertia * tau_v)))
        h = (t[i + 1] - t[i]) / steps
        for step in range(steps):
            for stage in range(4):
                u = first[i] + (step + share[stage]) / steps * (last[i] - first[i])
                p = x + (share[stage] * h * k[stage - 1, 0] if stage else 0.0)
                w = v + (share[stage] * h * k[stage - 1, 1] if stage else 0.0)
                k[stage, 0] = w / tau_v
                drag = w * (1.0 + 0.25 * inertia * abs(w))
                k[stage, 1] = (u - p - drag) / (inertia * tau_v)
            x += h / 6.0 * (k[0, 0] + 2.0 * k[1, 0] + 2.0 * k[2, 0] + k[3, 0])
            v += h / 6.0 * (k[0, 1] + 2.0 * k[1, 1] + 2.0 * k[2, 1] + k[3, 1])
        out[i + 1] = x
    return out


@njit(cache=True)
def stick_slip(x: FloatArray, band: float) -> FloatArray:  # pragma: no cover - compiled
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


@njit(cache=True)
def two_ranges(
    y: FloatArray, up: float, down: float, gap: float
) -> FloatArray:  # pragma: no cover - compiled
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


@njit(cache=True)
def no_faster(
    t: FloatArray, y: FloatArray, fastest: float
) -> FloatArray:  # pragma: no cover - compiled
    """(n,) ``y`` followed at a speed of at most ``fastest`` (per s)."""
    out = np.empty(len(y))
    out[0] = y[0]
    for i in range(len(y) - 1):
        reach = fastest * (t[i + 1] - t[i])
        out[i + 1] = out[i] + max(-reach, min(reach, y[i + 1] - out[i]))
    return out


@njit(cache=True)
def peak_detector(
    t: FloatArray, y: FloatArray, time: float
) -> FloatArray:  # pragma: no cover - compiled
    """(n,) ``y`` wherever it is above what is left of earlier values after their decay."""
    out = np.empty(len(y))
    out[0] = y[0]
    for i in range(len(y) - 1):
        out[i + 1] = max(y[i + 1], out[i] * exp(-(t[i + 1] - t[i]) / time))
    return out


@njit(cache=True)
def play(x: FloatArray, width: float) -> FloatArray:  # pragma: no cover - compiled
    """(n,) ``x`` through a backlash of half-width ``width``."""
    out = np.empty(len(x))
    place = x[0]
    for i in range(len(x)):
        place = max(x[i] - width, min(x[i] + width, place))
        out[i] = place
    return out


@njit(cache=True, error_model="numpy")
def pockets(
    t: FloatArray,
    u: FloatArray,
    flow: FloatArray,
    V: float,
    fractions: FloatArray,
    exchange: FloatArray,
    start: float,
) -> FloatArray:  # pragma: no cover - compiled
    """(n,) concentration of a manifold whose volume V (mL) partly lies in pockets.

    V (1 - sum f) x' = flow (u - x) + sum_j e_j (p_j - x),   f_j V p_j' = e_j (x - p_j)

    ``fractions`` (m,) of V, ``exchange`` (m,) mL/s, ``flow`` (n,) mL/s.
    """
    n, m = len(t), len(fractions)
    main = V * (1.0 - fractions.sum())
    fastest = (flow.max() + exchange.sum()) / main
    for j in range(m):
        fastest = max(fastest, exchange[j] / (fractions[j] * V))
    x = np.empty(n)
    state = np.full(m + 1, start)
    k = np.zeros((4, m + 1))
    trial = np.empty(m + 1)
    x[0] = start
    share = (0.0, 0.5, 0.5, 1.0)
    for i in range(n - 1):
        steps = max(1, ceil((t[i + 1] - t[i]) * fastest / 0.2))
        h = (t[i + 1] - t[i]) / steps
        for step in range(steps):
            for stage in range(4):
                at = (step + share[stage]) / steps
                inlet = u[i] + at * (u[i + 1] - u[i])
                q = flow[i] + at * (flow[i + 1] - flow[i])
                for j in range(m + 1):
                    before = k[stage - 1, j] if stage > 0 else 0.0
                    trial[j] = state[j] + share[stage] * h * before
                k[stage, 0] = q * (inlet - trial[0]) / main
                for j in range(m):
                    gap = exchange[j] * (trial[j + 1] - trial[0])
                    k[stage, 0] += gap / main
                    k[stage, j + 1] = -gap / (fractions[j] * V)
            for j in range(m + 1):
                state[j] += h / 6.0 * (k[0, j] + 2.0 * k[1, j] + 2.0 * k[2, j] + k[3, j])
        x[i + 1] = state[0]
    return x


@njit(cache=True, error_model="numpy")
def pit(
    t: FloatArray,
    u: FloatArray,
    flow: FloatArray,
    V: float,
    fraction: float,
    falling: float,
    lifted: float,
) -> FloatArray:  # pragma: no cover - compiled
    """(n,) concentration of a manifold with a pit, part of its volume V (mL), for heavy gas.

    V (1 - f) x' = flow (u - x) - e,   f V p' = e with e = ``falling`` (x - p)^(3/2) where x > p,
    ``lifted`` (x - p) else (mL/s): a current as fast as the root of what drives it carries that in,
    and only the stream's eddies bring it out.
    """
    n = len(t)
    main, lower = V * (1.0 - fraction), V * fraction
    fastest = (flow.max() + 1.5 * falling) / main + max(1.5 * falling, lifted) / lower
    out = np.zeros(n)
    x, p = 0.0, 0.0
    share = (0.0, 0.5, 0.5, 1.0)
    for i in range(n - 1):
        steps = max(1, ceil((t[i + 1] - t[i]) * fastest / 0.5))
        h = (t[i + 1] - t[i]) / steps
        for step in range(steps):
            dx, dp, total_x, total_p = 0.0, 0.0, 0.0, 0.0
            for stage in range(4):
                at = (step + share[stage]) / steps
                inlet = u[i] + at * (u[i + 1] - u[i])
                q = flow[i] + at * (flow[i + 1] - flow[i])
                above, below = x + share[stage] * h * dx, p + share[stage] * h * dp
                gap = above - below
                exchange = falling * gap * np.sqrt(gap) if gap > 0.0 else lifted * gap
                dx = (q * (inlet - above) - exchange) / main
                dp = exchange / lower
                weight = 1.0 if stage in (0, 3) else 2.0
                total_x += weight * dx
                total_p += weight * dp
            x += h / 6.0 * total_x
            p += h / 6.0 * total_p
        out[i + 1] = x
    return out


@njit(cache=True, error_model="numpy")
def cells(
    t: FloatArray, u: FloatArray, flow: FloatArray, V: float, n_cells: int, back: float
) -> FloatArray:  # pragma: no cover - compiled
    """(n,) outlet of ``n_cells`` equal cells in a row with back flow ``back`` times the flow.

    Flow (1 + back) runs forward between cells, ``back`` backward; back -> infinity is one
    well-stirred volume V (mL), back = 0 tanks in series.
    """
    n = len(t)
    fastest = n_cells * flow.max() / V * (1.0 + 2.0 * back)
    x = np.zeros(n)
    state = np.zeros(n_cells)
    k = np.zeros((4, n_cells))
    trial = np.empty(n_cells)
    share = (0.0, 0.5, 0.5, 1.0)
    for i in range(n - 1):
        steps = max(1, ceil((t[i + 1] - t[i]) * fastest / 1.0))
        h = (t[i + 1] - t[i]) / steps
        for step in range(steps):
            for stage in range(4):
                at = (step + share[stage]) / steps
                inlet = u[i] + at * (u[i + 1] - u[i])
                rate = (flow[i] + at * (flow[i + 1] - flow[i])) * n_cells / V
                for j in range(n_cells):
                    before = k[stage - 1, j] if stage > 0 else 0.0
                    trial[j] = state[j] + share[stage] * h * before
                for j in range(n_cells):
                    if j == 0:
                        change = inlet - trial[0]
                    else:
                        change = (1.0 + back) * (trial[j - 1] - trial[j])
                    if j < n_cells - 1:
                        change += back * (trial[j + 1] - trial[j])
                    k[stage, j] = rate * change
            for j in range(n_cells):
                state[j] += h / 6.0 * (k[0, j] + 2.0 * k[1, j] + 2.0 * k[2, j] + k[3, j])
        x[i + 1] = state[n_cells - 1]
    return x


@njit(cache=True, error_model="numpy")
def looped(
    t: FloatArray, u: FloatArray, flow: FloatArray, V: float, pumped: float, late: float
) -> FloatArray:  # pragma: no cover - compiled
    """(n,) state of V x' = flow (u - x) + ``pumped`` (x(t - ``late``) - x) from 0.

    A stirred volume V (mL) some of whose gas comes back ``late`` (s); flows in mL/s.
    """
    n = len(t)
    x = np.zeros(n)
    j, old = 0, 0.0  # what comes back at the node before
    for i in range(n - 1):
        h = t[i + 1] - t[i]
        at = t[i + 1] - late
        while j < i and t[j + 1] <= at:
            j += 1
        share = min(max((at - t[j]) / (t[j + 1] - t[j]), 0.0), 1.0)
        a = (flow[i] * u[i] + pumped * old) / (flow[i] + pumped)
        time = V / (0.5 * (flow[i] + flow[i + 1]) + pumped)
        back, end = old, x[i]
        for _ in range(4):  # of a step longer than the way round the end itself comes back
            if j == i:
                back = x[i] + share * (end - x[i])
            else:
                back = x[j] + share * (x[j + 1] - x[j])
            b = (flow[i + 1] * u[i + 1] + pumped * back) / (flow[i + 1] + pumped)
            end = lagged(x[i], a, b, h, time)
        x[i + 1], old = end, back
    return x


@njit(cache=True, error_model="numpy")
def langmuir(
    t: FloatArray, g: FloatArray, tau: float, K: float, bend: float, gate: float, width: float
) -> FloatArray:  # pragma: no cover - compiled
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


@njit(cache=True)
def two_layers(
    t: FloatArray, u: FloatArray, rate: FloatArray, floor: float, eddies: float
) -> FloatArray:  # pragma: no cover - compiled
    """(n,) gas a in the lower one of two layers, from 0 in both; the upper one b flows off.

    Into the lower one, the share ``floor`` of the volume, goes what is heavier, u > a, and lifts as
    much of it into the upper one; lighter gas goes there at once.  Eddies exchange both at
    ``eddies`` times the stream, ``rate`` (n,) volumes per s.  Followed exactly with the means of u
    and the rate between nodes: a - u and b - u obey a linear equation of two real rates.
    """
    n = len(t)
    out = np.zeros(n)
    a, b = 0.0, 0.0
    for i in range(n - 1):
        h, passes = t[i + 1] - t[i], 0.5 * (rate[i] + rate[i + 1])
        gas = 0.5 * (u[i] + u[i + 1])
        lifted = 1.0 if gas > a else 0.0
        away = passes * (lifted + eddies) / floor
        back = passes * eddies / floor
        gain = passes * (lifted + eddies) / (1.0 - floor)
        loss = passes * (1.0 + eddies) / (1.0 - floor)
        middle = -0.5 * (away + loss)
        root = np.sqrt(0.25 * (away - loss) ** 2 + back * gain)
        slow, quick = exp((middle + root) * h), exp((middle - root) * h)
        even, odd = 0.5 * (slow + quick), 0.5 * (slow - quick) / root
        p, q = a - gas, b - gas
        a = gas + even * p + odd * ((-away - middle) * p + back * q)
        b = gas + even * q + odd * (gain * p + (-loss - middle) * q)
        out[i + 1] = a
    return out


@njit(cache=True, error_model="numpy")
def elovich(
    t: FloatArray, g: FloatArray, bend: float, time: float
) -> FloatArray:  # pragma: no cover - compiled
    """(n,) coverage x from 0 of bonds as firm as they are free: 1 under the gas ``g`` (n,) of 1.

    2 bend time x' = g exp(bend (1 - x)) - exp(bend (x - 1)), and none leaves where there is none.
    With w = exp(bend (x - 1)) this is Riccati's 2 time w' = g - w^2, followed exactly with the mean
    of g between nodes.
    """
    n = len(t)
    out = np.zeros(n)
    bare = exp(-bend)
    w = bare
    for i in range(n - 1):
        h = 0.5 * (t[i + 1] - t[i]) / time
        gas = max(0.5 * (g[i] + g[i + 1]), 0.0)
        root = np.sqrt(gas)
        reach = tanh(root * h) / root if root > 1e-9 else h
        w = max((w + gas * reach) / (1.0 + w * reach), bare)
        out[i + 1] = 1.0 + np.log(w) / bend
    return out


@njit(cache=True, error_model="numpy")
def deliquescing(
    t: FloatArray, a: FloatArray, dissolves: float, comes_out: float, time: float
) -> FloatArray:  # pragma: no cover - compiled
    """(n,) water w from 0 on a salt, as much as there is salt being 1, under its activity ``a``.

    ``time`` w' = a - w/(1 + w) in a solution, until that is down to ``comes_out``; then, and at
    first, a - ``dissolves`` as long as there are crystals, which are gone where w/(1 + w) is that.
    """
    n = len(t)
    out = np.zeros(n)
    w, crystals = 0.0, True
    gone, out_again = dissolves / (1.0 - dissolves), comes_out / (1.0 - comes_out)
    for i in range(n - 1):
        steps = max(1, ceil((t[i + 1] - t[i]) / (0.3 * time)))
        for step in range(steps):
            at, end = step / steps, (step + 1.0) / steps
            while at < end:
                h = (end - at) * (t[i + 1] - t[i]) / time
                now = a[i] + at * (a[i + 1] - a[i])
                then = a[i] + end * (a[i + 1] - a[i])
                first = now - (dissolves if crystals else w / (1.0 + w))
                guess = max(w + h * first, 0.0)
                second = then - (dissolves if crystals else guess / (1.0 + guess))
                new = w + 0.5 * h * (first + second)
                border = gone if crystals else out_again
                turned = new >= border if crystals else new <= border
                if turned and new != w:
                    at += (end - at) * (border - w) / (new - w)
                    w, crystals = border, not crystals
                else:
                    w, at = max(new, 0.0), end
        out[i + 1] = w
    return out


@njit(cache=True, error_model="numpy")
def burning(
    t: FloatArray, g: FloatArray, burns: float, brought: float, time: float
) -> FloatArray:  # pragma: no cover - compiled
    """(n,) warmth w from 0 of a catalyst: time w' = g/(exp(-w)/``burns`` + 1/``brought``) - w.

    What burns of the gas ``g`` (n,) grows as exp(w), until it is all that is brought.
    """
    n = len(t)
    out = np.zeros(n)
    w = 0.0
    share = (0.0, 0.5, 0.5, 1.0)
    for i in range(n - 1):
        steps = max(1, ceil((t[i + 1] - t[i]) * (1.0 + 0.25 * brought) / (0.3 * time)))
        h = (t[i + 1] - t[i]) / steps
        for step in range(steps):
            before, total = 0.0, 0.0
            for stage in range(4):
                gas = g[i] + (step + share[stage]) / steps * (g[i + 1] - g[i])
                trial = w + share[stage] * h * before
                before = (gas / (exp(-trial) / burns + 1.0 / brought) - trial) / time
                total += before if stage in (0, 3) else 2.0 * before
            w += h / 6.0 * total
        out[i + 1] = w
    return out


@njit(cache=True, error_model="numpy")
def flaring(
    t: FloatArray,
    g: FloatArray,
    oxidises: float,
    reduces: float,
    low: float,
    high: float,
    cooling: float,
) -> FloatArray:  # pragma: no cover - compiled
    """(n,) warmth from 0, ``cooling`` x' = g - x while the gas ``g`` (n,) burns, else -x.

    It burns while the share w of oxide grows, ``oxidises`` w' = 1 - w, up to ``high``, and is out
    while the gas reduces that, ``reduces`` w' = -g w, down to ``low``; at first it is out.
    Followed exactly from turn to turn with the mean of g between nodes.
    """
    n = len(t)
    out = np.zeros(n)
    w, x, burns = high, 0.0, False
    for i in range(n - 1):
        gas = max(0.5 * (g[i] + g[i + 1]), 0.0)
        left = t[i + 1] - t[i]
        while left > 0.0:
            if burns:
                until = oxidises * np.log((1.0 - w) / (1.0 - high))
            else:
                until = reduces / gas * np.log(w / low) if gas > 0.0 else np.inf
            h = min(left, until)
            warm = gas if burns else 0.0
            x = warm + (x - warm) * exp(-h / cooling)
            if until <= left:
                w, burns = (high, False) if burns else (low, True)
            elif burns:
                w = 1.0 + (w - 1.0) * exp(-h / oxidises)
            else:
                w *= exp(-h * gas / reduces)
            left -= h
        out[i + 1] = x
    return out


@njit(cache=True)
def glassy(
    t: FloatArray, g: FloatArray, speed: float, back: float
) -> FloatArray:  # pragma: no cover - compiled
    """(n,) uptake m of a glassy film, from 0: m' = ``speed`` g while m < g, then m = g.

    Where there is more than the gas ``g`` (n,) would hold it leaves the softened film as a lag of
    ``back`` (s).
    """
    n = len(t)
    m = np.zeros(n)
    for i in range(n - 1):
        h = t[i + 1] - t[i]
        grown = m[i] + speed * h * max(0.5 * (g[i] + g[i + 1]), 0.0)
        left = g[i + 1] + (m[i] - g[i + 1]) * exp(-h / back)
        m[i + 1] = left if m[i] > g[i + 1] else min(grown, g[i + 1])
    return m


@njit(cache=True)
def islands(
    t: FloatArray, drive: FloatArray, time: float
) -> FloatArray:  # pragma: no cover - compiled
    """(n,) share 1 - exp(-r^2) that islands cover, with ``time`` r' = ``drive`` (n,) from r = 0.

    At r = 2 hardly a gap is left between them: they grow no further.
    """
    n = len(t)
    out = np.zeros(n)
    r = 0.0
    for i in range(n - 1):
        r += 0.5 * (drive[i] + drive[i + 1]) * (t[i + 1] - t[i]) / time
        r = min(max(r, 0.0), 2.0)
        out[i + 1] = -np.expm1(-r * r)
    return out


@njit(cache=True)
def capillary(pressure: FloatArray) -> FloatArray:  # pragma: no cover - compiled
    """(n,) relative pressure up to which pores have filled: those that fill at x empty at x^2.

    So it is at least the ``pressure`` (n,), at most its root, and else stays what it was.
    """
    out = np.empty(len(pressure))
    x = pressure[0]
    for i, p in enumerate(pressure):
        x = min(max(x, p), np.sqrt(p))
        out[i] = x
    return out


@njit(cache=True)
def blind(y: FloatArray, begin: float, width: float) -> FloatArray:  # pragma: no cover - compiled
    """(n,) ``y``, but what it was last outside while it is within ``width`` from ``begin`` on."""
    out = y.copy()
    for i in range(1, len(y)):
        if begin < y[i] < begin + width:
            out[i] = out[i - 1]
    return out


@njit(cache=True)
def blanked(
    t: FloatArray, y: FloatArray, up: float, down: float, lasts: float
) -> FloatArray:  # pragma: no cover - compiled
    """(n,) ``y``, but for ``lasts`` (s) what it was just before it rose above ``up``.

    Likewise where it then falls below ``down``, and so on by turns.
    """
    out = y.copy()
    upper, until = y[0] > up, t[0]
    for i in range(1, len(y)):
        if t[i] < until:
            out[i] = out[i - 1]
        elif (y[i] < down) if upper else (y[i] > up):
            upper, until = not upper, t[i] + lasts
            out[i] = out[i - 1]
    return out


@njit(cache=True)
def miscounted(
    t: FloatArray, y: FloatArray, fastest: float, fringe: float
) -> FloatArray:  # pragma: no cover - compiled
    """(n,) ``y`` (n,) V by a counter of ``fringe`` (V) that counts no more than ``fastest`` (V/s).

    What comes beyond that is lost as soon as it makes a fringe; less than one is not once it is
    slow again.
    """
    out = y.copy()
    lost, beyond = 0, 0.0
    for i in range(1, len(y)):
        change = y[i] - y[i - 1]
        over = abs(change) - fastest * (t[i] - t[i - 1])
        beyond = beyond + over if over > 0.0 else 0.0
        while beyond >= fringe:
            beyond -= fringe
            lost += 1 if change > 0.0 else -1
        out[i] = y[i] - lost * fringe
    return out


@njit(cache=True, error_model="numpy")
def phase_locked(
    t: FloatArray, y: FloatArray, width: float, time: float, beat: float
) -> FloatArray:  # pragma: no cover - compiled
    """(n,) v = m + ``width`` sin(p) with ``beat`` p' = y - v, ``time`` m' = width sin(p).

    A loop of second order, locked at ``y[0]`` at first; p (rad) is its error of phase.
    """
    n = len(t)
    out = y.copy()
    if beat < 1e-5 * width:  # quicker than anything is read
        return out
    p, m = 0.0, y[0]
    share = (0.0, 0.5, 0.5, 1.0)
    for i in range(n - 1):
        off = abs(y[i] - m) + abs(y[i + 1] - y[i])
        if off < 1e-12 and abs(p) < 1e-12:  # at rest
            out[i + 1] = m
            continue
        steps = max(1, ceil((t[i + 1] - t[i]) * (width + off) / (0.15 * beat)))
        h = (t[i + 1] - t[i]) / steps
        for step in range(steps):
            dp, dm, total_p, total_m = 0.0, 0.0, 0.0, 0.0
            for stage in range(4):
                now = y[i] + (step + share[stage]) / steps * (y[i + 1] - y[i])
                pulls = width * np.sin(p + share[stage] * h * dp)
                dp, dm = (now - m - share[stage] * h * dm - pulls) / beat, pulls / time
                weight = 1.0 if stage in (0, 3) else 2.0
                total_p += weight * dp
                total_m += weight * dm
            p += h / 6.0 * total_p
            m += h / 6.0 * total_m
        out[i + 1] = m + width * np.sin(p)
    return out


@njit(cache=True)
def distrusted(
    t: FloatArray, y: FloatArray, before: FloatArray, band: float, longest: float
) -> FloatArray:  # pragma: no cover - compiled
    """(n,) ``y``, but while it is off ``before`` (n,) by more than ``band`` its last good reading.

    That is the first one in doubt, and after every ``longest`` (s) of doubt what is read by then.
    """
    out = y.copy()
    doubted, begin = False, t[0]
    for i in range(1, len(y)):
        if abs(y[i] - before[i]) <= band:
            doubted = False
        elif doubted and t[i] - begin < longest:
            out[i] = out[i - 1]
        else:
            doubted, begin = True, t[i]
    return out


@njit(cache=True)
def envelope(
    t: FloatArray, y: FloatArray, attack: float, release: float
) -> FloatArray:  # pragma: no cover - compiled
    """(n,) lag of ``y`` (n,) that takes ``attack`` (s) upwards and ``release`` downwards."""
    out = np.empty(len(y))
    out[0] = y[0]
    for i in range(1, len(y)):
        middle = 0.5 * (y[i - 1] + y[i])
        time = attack if middle > out[i - 1] else release
        out[i] = middle + (out[i - 1] - middle) * exp(-(t[i] - t[i - 1]) / time)
    return out


@njit(cache=True, error_model="numpy")
def windowed_average(
    t: FloatArray, y: FloatArray, time: float, window: float
) -> FloatArray:  # pragma: no cover - compiled
    """(n,) ``y`` through a lag of ``time`` that starts anew at y where it is off by the window."""
    n = len(t)
    out = np.empty(n)
    out[0] = y[0]
    for i in range(n - 1):
        out[i + 1] = lagged(out[i], y[i], y[i + 1], t[i + 1] - t[i], time)
        if abs(out[i + 1] - y[i + 1]) > window:
            out[i + 1] = y[i + 1]
    return out


@njit(cache=True)
def kept(
    t: FloatArray, y: FloatArray, band: float, longest: float, begin: float
) -> NDArray[np.bool_]:  # pragma: no cover - compiled
    """(n,) whether a reading is kept: where ``y`` is off by the ``band`` from the last one kept.

    Kept are also the first and the last one, and those next after ``begin`` and every ``longest``
    (s) from there.
    """
    n = len(t)
    out = np.zeros(n, dtype=np.bool_)
    out[0] = out[n - 1] = True
    last = y[0]
    for i in range(1, n):
        turn = np.floor((t[i] - begin) / longest) > np.floor((t[i - 1] - begin) / longest)
        if turn or abs(y[i] - last) >= band:
            out[i] = True
            last = y[i]
    return out


@njit(cache=True)
def overloaded(
    t: FloatArray, y: FloatArray, rail: float, time: float, most: float
) -> FloatArray:  # pragma: no cover - compiled
    """(n,) ``y``, but the ``rail`` where y is above it and until the charge q of that is gone.

    ``time`` q' = y - rail, between 0 and ``most``.
    """
    out = y.copy()
    charge = 0.0
    for i in range(1, len(t)):
        over = 0.5 * (y[i - 1] + y[i]) - rail
        charge = min(max(charge + over * (t[i] - t[i - 1]) / time, 0.0), most)
        if charge > 0.0 or y[i] > rail:
            out[i] = rail
    return out


@njit(cache=True)
def log_amplifier(
    t: FloatArray, y: FloatArray, time: float
) -> FloatArray:  # pragma: no cover - compiled
    """(n,) state of v' = v (y - v)/``time`` from y[0]: a lag as fast as the level is high.

    Bernoulli's equation, followed exactly with the mean of y > 0 between nodes; ``time`` is that at
    level 1.
    """
    n = len(t)
    v = np.empty(n)
    v[0] = y[0]
    for i in range(n - 1):
        level = 0.5 * (y[i] + y[i + 1])
        e = exp(-level * (t[i + 1] - t[i]) / time)
        v[i + 1] = level * v[i] / (v[i] + (level - v[i]) * e)
    return v


@njit(cache=True, error_model="numpy")
def loosening(
    t: FloatArray, x: FloatArray, bend: float, time: float
) -> FloatArray:  # pragma: no cover - compiled
    """(n,) state of ``time`` w' = (x - w) exp(``bend`` w) from 0: the looser, the faster."""
    n = len(t)
    w = np.zeros(n)
    for i in range(n - 1):
        h = t[i + 1] - t[i]
        middle = w[i]
        for _ in range(3):  # predictor, correctors of the state that sets the rate
            end = lagged(w[i], x[i], x[i + 1], h, time * exp(-bend * middle))
            middle = 0.5 * (w[i] + end)
        w[i + 1] = end
    return w


@njit(cache=True, error_model="numpy")
def chained(
    t: FloatArray, g: FloatArray, level: float, seeds: float, time: float
) -> FloatArray:  # pragma: no cover - compiled
    """(n,) share w of sites whose gas is bound in chains, from 0.

    ``time`` w' = (g - ``level``) w (1 - w) + ``seeds`` (g (1 - w) - level w): links are bound and
    freed at the ends of chains, of which there are most at half, and here and there without one.
    Riccati's equation, followed exactly with the mean of the gas ``g`` (n,) between nodes.
    """
    n = len(t)
    w = np.zeros(n)
    for i in range(n - 1):
        h = (t[i + 1] - t[i]) / time
        gas = max(0.5 * (g[i] + g[i + 1]), 0.0)
        beyond = gas - level
        linear = beyond - seeds * (gas + level)
        root = np.sqrt(linear * linear + 4.0 * beyond * seeds * gas)
        rate = (beyond * w[i] + seeds * gas) * (1.0 - w[i]) - seeds * level * w[i]
        slope = linear - 2.0 * beyond * w[i]
        reach = tanh(0.5 * root * h) / root if root > 1e-9 else 0.5 * h
        w[i + 1] = w[i] + 2.0 * rate * reach / (1.0 - slope * reach)
    return w


@njit(cache=True, error_model="numpy")
def clamped(
    t: FloatArray, y: FloatArray, time: float, every: float, begin: float
) -> FloatArray:  # pragma: no cover - compiled
    """(n,) ``y`` less the charge q of a capacitor: ``time`` q' = y - q, and 0 at each clamp.

    They come ``every`` (s), one of them at ``begin``; at the first time it is empty.
    """
    n = len(t)
    out = y.copy()
    q = 0.0
    for i in range(n - 1):
        q = lagged(q, y[i], y[i + 1], t[i + 1] - t[i], time)
        if np.floor((t[i + 1] - begin) / every) > np.floor((t[i] - begin) / every):
            q = 0.0
        out[i + 1] = y[i + 1] - q
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
    top = diffusivity[-1] / (0.5 * width)
    matrix = np.zeros((n_cells, n_cells))
    for j, conductance in enumerate(between):
        matrix[j, j] += conductance / width
        matrix[j + 1, j + 1] += conductance / width
        matrix[j, j + 1] -= conductance / width
        matrix[j + 1, j] -= conductance / width
    matrix[-1, -1] += top / width
    rates, modes = np.linalg.eigh(matrix)
    probe = 0
    inflow = np.zeros(n_cells)
    inflow[-1] = top / width
    weights = modes[probe] * (modes.T @ inflow) / rates
    times = 1.0 / rates
    return times * mean_time / float(weights @ times), weights


def slab(time: float, n_modes: int = 8) -> tuple[FloatArray, FloatArray]:
    """Time constants (n,) s and weights (n,) of diffusion to the sealed face of a slab.

    ``time`` (s) is its thickness squared over the diffusivity (Crank, The Mathematics of Diffusion,
    1975, Sec. 2.3); the last mode stands for all faster ones.
    """
    odd = 2.0 * np.arange(n_modes, dtype=float) + 1.0
    weights = 4.0 / pi * np.cos(pi * np.arange(n_modes)) / odd
    weights[-1] += 1.0 - weights.sum()
    times: FloatArray = 4.0 * time / (pi * odd) ** 2
    return times, weights


def decades(first: float, n_decades: int = 4) -> tuple[FloatArray, FloatArray]:
    """Time constants (n,) s and weights (n,) of a creep as the logarithm of time, 1 a decade."""
    times: FloatArray = first * 10.0 ** (np.arange(3 * n_decades + 1, dtype=float) / 3.0)
    return times, np.full(len(times), 1.0 / 3.0)


def laminar(passed: FloatArray, u: FloatArray, volume: float, n_tubes: int = 80) -> FloatArray:
    """(n,) outlet of a hose of ``volume`` (mL) in laminar flow, less the delay on its axis.

    ``passed`` (n,) mL have flowed by then.  In tubes of equal flow: behind the share F of it a step
    is late by volume/2 (1/sqrt(1 - F) - 1); each tube takes the mean of its own.
    """
    root = np.sqrt(1.0 - np.arange(n_tubes + 1) / n_tubes)
    late = 0.5 * volume * (2.0 * n_tubes * (root[:-1] - root[1:]) - 1.0)
    out = np.zeros(len(u))
    for behind in late:
        out += np.interp(passed - behind, passed, u) / n_tubes
    return out


def parabola(t: FloatArray, y: FloatArray, window: float, n_readings: int = 32) -> FloatArray:
    """(n,) middle of the parabola that fits ``y`` (n,) best within half a ``window`` (s) around.

    Least squares weigh what is off the middle by u half windows by (9 - 15 u^2)/8; before the first
    and after the last time there is what is there.
    """
    off, shares = np.polynomial.legendre.leggauss(n_readings)
    out = np.zeros(len(t))
    for u, share in zip(off, shares, strict=True):
        out += share * (9.0 - 15.0 * u**2) / 8.0 * np.interp(t + 0.5 * window * u, t, y)
    return out


def cosine_blocks(
    t: FloatArray, y: FloatArray, begin: float, length: float, kept: int, n_readings: int = 64
) -> FloatArray:
    """(n,) ``y`` in blocks of ``length`` (s), of each of which the first ``kept`` cosines are left.

    One of the blocks begins at ``begin`` (s); they are taken from even readings within, and before
    the first and after the last time there is what is there.
    """
    block = np.floor((t - begin) / length).astype(np.int64)
    first = int(block[0])
    reading = (np.arange(n_readings) + 0.5) / n_readings
    number = np.arange(first, int(block[-1]) + 1)
    readings = np.interp(begin + (number[:, None] + reading) * length, t, y)
    within = (t - begin) / length - block
    out = np.zeros(len(t))
    for k in range(kept):
        norm = n_readings if k == 0 else 0.5 * n_readings
        size = readings @ np.cos(pi * k * reading) / norm
        out += size[block - first] * np.cos(pi * k * within)
    return out


def counted(t: FloatArray, light: FloatArray, charge: float, begin: float) -> FloatArray:
    """(n,) mean of ``light`` (n,) V > 0 over the last complete filling with a ``charge`` (V s).

    At the first time the share ``begin`` of one is there; before it all was as it is then.
    """
    filled = np.concatenate([[0.0], np.cumsum(0.5 * (light[1:] + light[:-1]) * np.diff(t))])
    fillings = begin + filled / charge
    whole = np.interp(np.arange(1.0, np.floor(fillings[-1]) + 1.0), fillings, t)
    # the last two before, by the light of the first time
    early = t[0] - charge / light[0] * (begin + np.array([1.0, 0.0]))
    ends = np.concatenate([early, whole])
    last = np.searchsorted(ends, t, side="right") - 1
    shown: FloatArray = charge / (ends[last] - ends[last - 1])
    return shown


def retarded(
    t: FloatArray, u: FloatArray, flow: FloatArray, volume: float, n_cells: int
) -> FloatArray:
    """(n,) ``u`` behind ``n_cells`` cells in a row that are each exchanged by the same volume.

    All of them together hold as much as ``volume`` (mL) brings; ``flow`` (n,) mL/s.
    """
    held = volume / n_cells / (0.5 * (flow[1:] + flow[:-1]))
    out = u
    for _ in range(n_cells):
        out = lag(t, out, held, 0.0)
    return out


def steady_lag(t: FloatArray, u: FloatArray, tau: float) -> FloatArray:
    """(n,) :func:`lag` of one time constant (s), from rest at ``u[0]``."""
    return np.asarray(lag(t, u, np.full(len(t) - 1, tau), float(u[0])))


def modal(t: FloatArray, u: FloatArray, times: FloatArray, weights: FloatArray) -> FloatArray:
    """(n,) weighted sum of first-order lags from rest at ``u[0]``."""
    out = np.zeros(len(t))
    for tau, weight in zip(times, weights, strict=True):
        out += weight * steady_lag(t, u, tau)
    return out
