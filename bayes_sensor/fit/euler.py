"""Forward Euler at any time, so that switch times can be refined."""

from __future__ import annotations

from math import exp, inf, log1p
from typing import Any

import numpy as np
from numba import njit

from bayes_sensor.campaign import FloatArray
from bayes_sensor.compiled import forget_older
from bayes_sensor.rig import cascade
from bayes_sensor.rig.cascade import partial_fractions, sorted_apart


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


forget_older((euler_relaxed,), (cascade,))


def euler_sensitivities(
    t: FloatArray, h: float, taus: FloatArray, t0: float, tf: float | None
) -> tuple[FloatArray, FloatArray]:
    """Relaxed forward Euler at ``t`` (n_t,) and its (n_t, 5) one-sided difference quotients."""
    arguments = np.array([*taus, t0, inf if tf is None else tf])
    x, dx = np.empty_like(t), np.zeros((len(t), 5))
    euler_relaxed(t, h, arguments[:3], arguments[3], arguments[4], x)
    for j in range(5 if tf is not None else 4):
        moved = arguments.copy()
        moved[j] += 1e-6 * taus[j] if j < 3 else 1e-6 * float(taus.max())
        euler_relaxed(t, h, moved[:3], moved[3], moved[4], dx[:, j])
        dx[:, j] = (dx[:, j] - x) / (moved[j] - arguments[j])
    return x, dx
