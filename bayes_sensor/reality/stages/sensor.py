"""What the coating takes up, and how soon."""

from __future__ import annotations

from math import ceil, exp, tanh

import numpy as np
from numba import njit

from bayes_sensor.campaign import FloatArray
from bayes_sensor.reality.stages.lags import lag, lagged


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


@njit(cache=True)
def pinned(x: FloatArray, at: FloatArray) -> FloatArray:  # pragma: no cover - compiled
    """(n,) ``x`` that rests at one of the places ``at`` (m,) until x has come to another one.

    They are in order; it begins at the first one, and the last one is beyond all x.
    """
    out = np.empty(len(x))
    place = 0
    for i in range(len(x)):
        while x[i] >= at[place + 1]:
            place += 1
        while place > 0 and x[i] <= at[place - 1]:
            place -= 1
        out[i] = at[place]
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
def starved(
    t: FloatArray, g: FloatArray, time: FloatArray, bend: float
) -> FloatArray:  # pragma: no cover - compiled
    """(n,) load w of grains from 0, which gas reaches through a film: ``time`` w' = g - c.

    c = w/(1 + ``bend`` (1 - w)) is above the grains what their load holds there (Langmuir's
    isotherm, 1 at a load of 1), ``g`` (n,) the gas outside, and ``time`` (n - 1,) s.
    """
    n = len(t)
    w = np.zeros(n)
    for i in range(n - 1):
        middle = w[i]
        for _ in range(2):  # predictor, corrector of the load that sets the rate
            spare = 1.0 + bend * (1.0 - middle)
            low, high = spare * g[i], spare * g[i + 1]
            end = lagged(w[i], low, high, t[i + 1] - t[i], spare * time[i])
            middle = 0.5 * (w[i] + end)
        w[i + 1] = end
    return w


@njit(cache=True)
def crystallising(
    t: FloatArray, drive: FloatArray, wait: float, time: float
) -> FloatArray:  # pragma: no cover - compiled
    """(n,) share r that a crystal covers, with ``time`` r' = ``drive`` (n,), from 0 to 1.

    It needs a nucleus, which is there when the integral of the drive has come to ``wait`` (s); when
    all of it has gone the wait begins anew.
    """
    n = len(t)
    out = np.zeros(n)
    r, waited = 0.0, 0.0
    for i in range(n - 1):
        more = 0.5 * (drive[i] + drive[i + 1]) * (t[i + 1] - t[i])
        if waited < wait:
            waited += max(more, 0.0)
            more = max(waited - wait, 0.0)
        r = min(max(r + more / time, 0.0), 1.0)
        if r <= 0.0 and more < 0.0:
            waited = 0.0
        out[i + 1] = r
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


def reagent(t: FloatArray, g: FloatArray, uses: float, creeps: float, left: float) -> FloatArray:
    """(n,) state r of r' = (1 - r)/``creeps`` - ``g`` r/``uses``: what gas has left of a reagent.

    It is ``left`` when the record begins, at 0 s, before which there is no gas.
    """
    times = 1.0 / (1.0 / creeps + g / uses)
    middle = 0.5 * (times[1:] + times[:-1])
    first = 1.0 + (left - 1.0) * exp(-t[0] / creeps)
    return np.asarray(lag(t, times / creeps, middle, first))
