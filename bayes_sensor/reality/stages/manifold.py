"""What becomes of the gas between valve and sensor."""

from __future__ import annotations

from math import ceil, exp, sqrt, tanh

import numpy as np
from numba import njit

from bayes_sensor.campaign import FloatArray
from bayes_sensor.reality.stages.lags import lagged


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
def ripening(
    t: FloatArray, x: FloatArray, passage: FloatArray, rate: float
) -> FloatArray:  # pragma: no cover - compiled
    """(n,) state of p' = ``rate`` (x - p)^2 - p/passage from 0; ``passage`` (n - 1,) s.

    Riccati's equation, followed exactly with the mean of ``x`` (n,) between nodes.
    """
    n = len(t)
    p = np.zeros(n)
    for i in range(n - 1):
        h = t[i + 1] - t[i]
        gas = max(0.5 * (x[i] + x[i + 1]), 0.0)
        leaves = 1.0 / passage[i]
        root = sqrt(leaves * (leaves + 4.0 * rate * gas))
        rise = rate * (gas - p[i]) ** 2 - leaves * p[i]
        slope = -2.0 * rate * (gas - p[i]) - leaves
        reach = tanh(0.5 * root * h) / root
        p[i + 1] = p[i] + 2.0 * rise * reach / (1.0 - slope * reach)
    return p


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
