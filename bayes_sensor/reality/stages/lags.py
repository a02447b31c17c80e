"""Linear lags, and the grids and sums that are made of them."""

from __future__ import annotations

from math import exp, pi

import numpy as np
from numba import njit

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
