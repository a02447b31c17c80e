"""From what the coating holds to the recorded voltage."""

from __future__ import annotations

from math import ceil, exp, log, pi

import numpy as np
from numba import njit
from numpy.typing import NDArray

from bayes_sensor.campaign import FloatArray
from bayes_sensor.reality.stages.lags import lagged


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


@njit(cache=True)
def one_bit(y: FloatArray, least: float) -> FloatArray:  # pragma: no cover - compiled
    """(n,) what a link makes of readings ``y`` (n,) of each of which it says whether it is higher.

    The far end goes up or down by a step, from the first reading on; the step grows by half after
    two bits that are the same, and falls back by as much after two that are not, but never below
    ``least`` (V).
    """
    n = len(y)
    out = np.empty(n)
    out[0] = y[0]
    step, last = least, 1.0
    for i in range(n - 1):
        # a tie goes up, whatever rounding has made of it
        bit = 1.0 if y[i] > out[i] - 1e-12 else -1.0
        step = max(1.5 * step if bit == last else step / 1.5, least)
        last = bit
        out[i + 1] = out[i] + bit * step
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


def shone_back(t: FloatArray, y: FloatArray, share: float, time: float) -> FloatArray:
    """(n,) z = ``y`` + ``share`` times the mean of z - y[0] over the ``time`` (s) before.

    Before the first time there is y[0].  By as many passes as it takes until what one more would
    add is less than 1e-7 of that; share < 1.
    """
    begins = np.maximum(t - time, t[0])
    z = y
    for _ in range(ceil(log(1e-7) / log(share))):
        gone = z - y[0]
        whole = np.concatenate([[0.0], np.cumsum(0.5 * (gone[1:] + gone[:-1]) * np.diff(t))])
        z = y + share * (whole - np.interp(begins, t, whole)) / time
    return z


def slowest_waves(t: FloatArray, y: FloatArray, lasts: float, n: int) -> FloatArray:
    """(n_t,) sum of the first ``n`` of ``y``'s Fourier series over a record that ``lasts`` so long.

    The record begins at 0 s, and after the last time it goes on as it is then.
    """
    within = np.unique(np.concatenate([[0.0, lasts], t[(t > 0.0) & (t < lasts)]]))
    there = np.interp(within, t, y)
    out = np.zeros(len(t))
    for k in range(1, n + 1):
        wave = np.exp(-2j * pi * k / lasts * within)
        size = 2.0 / lasts * complex(np.trapezoid(there * wave, within))
        out += np.real(size * np.exp(2j * pi * k / lasts * t))
    return out
