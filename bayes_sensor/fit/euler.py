"""Forward Euler at any time, so that switch times can be refined."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from bayes_sensor.campaign import Experiment, FloatArray
from bayes_sensor.rig.layout import Layout
from bayes_sensor.rig.partial_fractions import partial_fractions, sorted_apart


def euler_relaxed(
    t: FloatArray, h: float, taus: FloatArray, times: FloatArray, heights: FloatArray
) -> FloatArray:
    """(n_t,) forward Euler's response at ``t`` (n_t,) s to steps of the input.

    Its response n = s/h samples after a switch is 1 - sum c_j (1 - h/tau_j)^n with the c_j of the
    continuous cascade; n is let real, so that switch times can be refined.  ``h`` s, its step;
    ``taus`` (n_lags,) s, each above h; ``times`` (n,) s and ``heights`` (n,) of the steps.
    """
    taus, c = np.array(taus, dtype=float), np.empty(len(taus))
    sorted_apart(taus)
    partial_fractions(taus, c)
    rates = np.log1p(-h / taus) / h
    x = np.zeros(len(t))
    for time, height in zip(times, heights, strict=True):
        later = t > time
        x[later] += height * (1.0 - np.exp(np.outer(t[later] - time, rates)) @ c)
    return x


def euler_slopes(
    t: FloatArray, theta: FloatArray, layout: Layout, k: int, e: Experiment
) -> tuple[FloatArray, NDArray[np.int64], FloatArray]:
    """Relaxed forward Euler of the published rig at ``t`` (n_t,), positions in theta (m,) of what
    moves it, and one-sided difference quotients by these (n_t, m)."""
    switching, switches = layout.switching[k], layout.switches(k)
    places = np.concatenate([layout.shared[k], switches])
    scale = np.append(theta[layout.shared[k]], [layout.slowest(theta, k, e.total_flow)] * 2)

    def at(vector: FloatArray) -> FloatArray:
        taus, times = layout.taus(vector, k, e.total_flow), switching.times(vector[switches])
        return euler_relaxed(t, e.interval, taus, times, np.array(switching.heights))

    x, slopes = at(theta), np.zeros((len(t), len(places)))
    for j, place in enumerate(places):
        moved = theta.copy()
        moved[place] += 1e-6 * scale[j]
        slopes[:, j] = (at(moved) - x) / (moved[place] - theta[place])
    return x, places, slopes
