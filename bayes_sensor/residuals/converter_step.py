"""The lattice that a converter puts a record on."""

from __future__ import annotations

import numpy as np

from bayes_sensor.campaign import FloatArray


def lattice_step(values: FloatArray) -> float:
    """The step of the lattice that all values (n,) lie on, or 0 where they lie on none.

    >>> round(lattice_step(np.array([0.1, 0.3, 0.1, 0.2, 0.3, 0.1, 0.2, 0.1])), 12)
    0.1
    """
    distinct = np.unique(values)
    if len(distinct) < 3 or len(distinct) > 0.5 * len(values):
        return 0.0
    gaps = np.diff(distinct)
    span = float(distinct[-1] - distinct[0])
    gaps = gaps[gaps > 1e-9 * span]
    if len(gaps) == 0:
        return 0.0
    step = float(np.min(gaps))
    # converted values carry rounding: the mean over many steps is sharper than one
    step = span / round(span / step) if span / step < 1e6 else step
    away = np.abs((distinct - distinct[0]) / step - np.rint((distinct - distinct[0]) / step))
    return step if float(np.max(away)) < 0.02 else 0.0
