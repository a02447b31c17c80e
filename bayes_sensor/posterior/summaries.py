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
