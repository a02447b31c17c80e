"""Small arrays in rising order, compiled: numpy's sort takes a second to compile, for every use."""

from __future__ import annotations

import numpy as np

from bayes_sensor.campaign import FloatArray
from bayes_sensor.compiled import compiled


@compiled(inside=True)
def sort(values: FloatArray) -> None:
    """Put ``values`` (n,) in rising order, by insertion."""
    for i in range(1, len(values)):
        for j in range(i, 0, -1):
            if values[j] >= values[j - 1]:
                break
            values[j - 1], values[j] = values[j], values[j - 1]


@compiled(inside=True)
def rising_rates(taus: FloatArray) -> FloatArray:
    """(n,) 1/s, of time constants ``taus`` (n,) s, in rising order."""
    rates = np.empty(len(taus))
    for i in range(len(taus)):
        rates[i] = 1.0 / taus[i]
    sort(rates)
    return rates
