"""What the coil does to the opening of the valve."""

from __future__ import annotations

from math import ceil, exp

import numpy as np
from numba import njit

from bayes_sensor.campaign import FloatArray
from bayes_sensor.reality.stages.lags import lagged


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
