"""Forward Euler at any time, so that switch times can be refined."""

from __future__ import annotations

from math import exp, inf, log1p
from typing import Any

import numpy as np
from numba import njit
from numpy.typing import NDArray

from bayes_sensor.campaign import Experiment, FloatArray
from bayes_sensor.compiled import forget_older
from bayes_sensor.rig import partial_fractions as fractions
from bayes_sensor.rig.layout import Layout
from bayes_sensor.rig.partial_fractions import partial_fractions, sorted_apart


@njit(cache=True, error_model="numpy")
def _euler_step(
    s: float, h: float, taus: FloatArray, c: FloatArray
) -> float:  # pragma: no cover - compiled
    # Forward Euler's response n = s/h samples after the switch is 1 - sum c_j (1 - h/tau_j)^n with
    # the c_j of the continuous cascade; n is let real, so that switch times can be refined.
    if s <= 0.0:
        return 0.0
    x = 1.0
    for j in range(3):
        x -= c[j] * exp(s / h * log1p(-h / taus[j]))
    return x


@njit(cache=True, error_model="numpy")
def euler_relaxed(
    t: Any, h: float, given: Any, t0: float, tf: float, out: Any
) -> None:  # pragma: no cover - compiled
    taus, c = np.sort(given), np.empty(3)
    sorted_apart(taus)
    partial_fractions(taus, c)
    for i in range(len(t)):
        out[i] = _euler_step(t[i] - t0, h, taus, c)
        if t[i] > tf:
            out[i] -= _euler_step(t[i] - tf, h, taus, c)


forget_older((euler_relaxed,), (fractions,))


def euler_slopes(
    t: FloatArray, theta: FloatArray, layout: Layout, k: int, e: Experiment
) -> tuple[FloatArray, NDArray[np.int64], FloatArray]:
    """Relaxed forward Euler of the published rig at ``t`` (n_t,), positions in theta (m,) of what
    moves it, and one-sided difference quotients by these (n_t, m)."""
    places = np.concatenate([layout.shared[k], layout.switches(k)])
    scale = np.append(theta[layout.shared[k]], [layout.slowest(theta, k, e.total_flow)] * 2)

    def at(vector: FloatArray) -> FloatArray:
        switches, x = vector[layout.switches(k)], np.empty_like(t)
        tf = float(switches[1]) if len(switches) > 1 else inf
        taus = layout.taus(vector, k, e.total_flow)
        euler_relaxed(t, e.interval, taus, float(switches[0]), tf, x)
        return x

    x, slopes = at(theta), np.zeros((len(t), len(places)))
    for j, place in enumerate(places):
        moved = theta.copy()
        moved[place] += 1e-6 * scale[j]
        slopes[:, j] = (at(moved) - x) / (moved[place] - theta[place])
    return x, places, slopes
