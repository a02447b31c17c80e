"""Samples that stand for no measurement: -9999 and its like."""

from __future__ import annotations

import re
from collections.abc import Callable

import numpy as np

from bayes_sensor.campaign import FloatArray

_NINES = re.compile(r"-?9{2,}(\.9+)?")
_ENDS = frozenset((-(2.0**15), 2.0**15 - 1, 2.0**16 - 1, -(2.0**31), 2.0**31 - 1, 2.0**32 - 1))
"""the last whole numbers of 16 and 32 bits"""


def without_fill_codes(y: FloatArray, place: Callable[[int], str]) -> tuple[FloatArray, list[str]]:
    """The samples (n,) with NaN for codes such as -9999, and a remark for each code.

    A code is a number of nines, or the last of 16 or 32 bits, that lies further beyond all other
    samples than they lie from each other.

    >>> without_fill_codes(np.array([0.1, -9999.0, 0.4]), lambda i: f"row {i + 2}")
    (array([0.1, nan, 0.4]), ['1 sample is -9999, a code for no measurement, at row 3; left out'])
    """
    remarks = []
    found = True
    while found:
        found = False
        finite = y[np.isfinite(y)]
        for edge in (finite.min(), finite.max()) if len(finite) else ():
            rest = finite[finite != edge]
            if len(rest) < 2 or not _is_code(float(edge)):
                continue
            low, high = rest.min(), rest.max()
            if max(low - edge, edge - high) > high - low:
                code = y == edge
                n, at = int(code.sum()), place(int(np.argmax(code)))
                words = f"1 sample is {edge:g}" if n == 1 else f"{n} samples are {edge:g}"
                first = "at" if n == 1 else "the first at"
                remarks.append(f"{words}, a code for no measurement, {first} {at}; left out")
                y, found = np.where(code, np.nan, y), True
                break
    return y, remarks


def _is_code(value: float) -> bool:
    return value in _ENDS or _NINES.fullmatch(f"{value:.12g}") is not None
