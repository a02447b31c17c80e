"""Quantiles and shortest intervals of weighted draws."""

from __future__ import annotations

import numpy as np

from bayes_sensor.campaign import FloatArray


def weighted_quantiles(x: FloatArray, w: FloatArray, probabilities: list[float]) -> list[float]:
    order = np.argsort(x)
    cumulative = np.cumsum(w[order]) - 0.5 * w[order]
    return [float(v) for v in np.interp(probabilities, cumulative, x[order])]


def highest_density(x: FloatArray, w: FloatArray, level: float) -> tuple[float, float]:
    """Shortest interval that holds ``level`` of the weighted draws."""
    order = np.argsort(x)
    x, cumulative = x[order], np.concatenate([[0.0], np.cumsum(w[order])])
    starts = np.flatnonzero(cumulative[:-1] <= cumulative[-1] - level)
    ends = np.searchsorted(cumulative, cumulative[starts] + level) - 1
    ends = np.minimum(ends, len(x) - 1)
    best = int(np.argmin(x[ends] - x[starts]))
    return float(x[starts[best]]), float(x[ends[best]])


BEYOND = 1e-3
"""probability beyond an end of the support that counts as zero"""


def reaches_end(x: FloatArray, w: FloatArray, low: float, high: float) -> bool:
    """Whether draws ``x`` (n,) >= 0 of weights ``w`` (n,) would extend beyond the support, ``low``
    to ``high``, in which they were made.

    Beyond ``high`` as much is expected as within a tenth of their 95 % interval below it; between
    zero and ``low`` the density that they have as close above ``low``.

    >>> x = np.linspace(0.0, 1.0, 1000)
    >>> w = np.full(1000, 1e-3)
    >>> reaches_end(x, w, 0.0, 2.0), reaches_end(x, w, 0.0, 1.0)
    (False, True)
    """
    first, last = weighted_quantiles(x, w, [0.025, 0.975])
    near = 0.1 * (last - first)
    above = float(w[x > high - near].sum())
    below = float(w[x < low + near].sum()) * low if low > 0.0 else 0.0
    return above > BEYOND or below > BEYOND * near
