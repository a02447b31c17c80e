"""Divided differences of exp(-a s) over rates a: the stable closed form of lags in a row, compiled.

A chain of lags with rates a_1 .. a_n answers every simple input with such a divided difference
times a product of rates.  Recursion where the rates are spread over more than 1/s; otherwise the
series exp(-m s) (-s)^(n-1) sum_k h_k(a - m) (-s)^k / (n - 1 + k)! with h_k the complete homogeneous
symmetric polynomials, which has no cancellation when rates coincide.  (McCurdy, Ng and Parlett,
Math. Comp. 43, 1984, discuss why both are needed.)
"""

from __future__ import annotations

from math import exp, expm1

from bayes_sensor.campaign import FloatArray
from bayes_sensor.compiled import compiled

TERMS = 24
"""of the series, which reach rounding where rates are spread over up to 1/s"""


@compiled(inside=True)
def _series(a: FloatArray, i: int, n: int, s: float, h: FloatArray) -> float:
    # divided difference over a[i : i + n] where its spread times s is at most 1; h: scratch (24,)
    spread = (a[i + n - 1] - a[i]) * s
    # the terms fall like spread^k / k!: so many reach rounding
    terms = 24 if spread > 0.3 else (14 if spread > 0.01 else 7)
    middle = 0.0
    for j in range(i, i + n):
        middle += a[j] / n
    h[0] = 1.0
    for k in range(1, terms):
        h[k] = 0.0
    for j in range(i, i + n):
        delta = a[j] - middle
        for k in range(1, terms):
            h[k] += delta * h[k - 1]
    factor = exp(-middle * s)
    for k in range(1, n):
        factor *= -s / k
    total = 0.0
    for k in range(terms):
        total += h[k] * factor
        factor *= -s / (n + k)
    return total


@compiled(inside=True, forceinline=True)
def _recursion(a: FloatArray, s: float, table: FloatArray, h: FloatArray) -> None:
    # table[j] = f[a_j, .., a_n] for every j
    n = len(a)
    table[0] = exp(-a[0] * s) if a[0] != 0.0 else 1.0
    for i in range(1, n):
        table[i] = exp(-a[i] * s) if a[i] != a[i - 1] else table[i - 1]
    for i in range(n - 1):
        gap = a[i + 1] - a[i]
        if gap * s > 0.5:
            table[i] = (table[i + 1] - table[i]) / gap
        elif gap > 0.0:
            table[i] *= expm1(-gap * s) / gap
        else:
            table[i] *= -s
    for k in range(2, n):
        for i in range(n - k):
            spread = a[i + k] - a[i]
            if spread * s > 1.0:
                table[i] = (table[i + 1] - table[i]) / spread
            else:
                table[i] = _series(a, i, k + 1, s, h)


@compiled(inside=True, forceinline=True)
def divided(a: FloatArray, s: float, table: FloatArray, h: FloatArray) -> float:
    """Divided difference f[a_1, .., a_n] over sorted rates ``a`` (n,), s >= 0.

    Scratch: ``table`` (n,) and ``h`` (:data:`TERMS`,).
    """
    n = len(a)
    if n > 1 and (a[n - 1] - a[0]) * s <= 1.0:
        return _series(a, 0, n, s, h)
    _recursion(a, s, table, h)
    highest: float = table[0]
    return highest


@compiled(inside=True)
def divided_tails(a: FloatArray, s: float, table: FloatArray, h: FloatArray) -> None:
    """Leave the divided difference over the last rates, from the j-th on, in ``table[j]``."""
    n = len(a)
    if n > 1 and (a[n - 1] - a[0]) * s <= 1.0:
        for j in range(n - 1):
            table[j] = _series(a, j, n - j, s, h)
        table[n - 1] = exp(-a[n - 1] * s)
        return
    _recursion(a, s, table, h)
