"""Step response of lags in a row as a sum of exponentials, compiled: for lags that are apart.

It is quick.  Its coefficients cancel where lags nearly coincide: it serves where few digits are
enough or the lags are known to be apart; :mod:`bayes_sensor.rig.chain` has the exact one.
"""

from __future__ import annotations

from math import exp

from bayes_sensor.campaign import FloatArray
from bayes_sensor.compiled import compiled
from bayes_sensor.rig.sorting import sort


@compiled()
def sorted_apart(taus: FloatArray) -> None:
    """Sort ``taus`` (n,), rising, and move them apart: three by a thousandth at least.

    Partial fractions, which grow with the power n - 1 of the inverse distance, then keep ten
    digits.
    """
    sort(taus)
    factor = 1.001
    if len(taus) > 3:
        factor += 10.0 ** (-6.0 / (len(taus) - 1)) - 0.001
    for j in range(1, len(taus)):
        if taus[j] < taus[j - 1] * factor:
            taus[j] = taus[j - 1] * factor


@compiled(forceinline=True)
def partial_fractions(taus: FloatArray, c: FloatArray) -> None:
    """c_j (n,) of the step response 1 - sum_j c_j exp(-s/tau_j), for ``taus`` that are apart."""
    n = len(taus)
    for j in range(n):
        c[j] = 1.0
        for m in range(n):
            if m != j:
                c[j] *= taus[j] / (taus[j] - taus[m])


@compiled()
def quick_step_response(s: float, taus: FloatArray, c: FloatArray) -> float:
    """The step response by :func:`partial_fractions` ``c`` of rising ``taus``; 1 after 30 of the
    slowest."""
    if s <= 0.0:
        return 0.0
    if s > 30.0 * taus[-1]:
        return 1.0
    x = 1.0
    for tau, weight in zip(taus, c):
        u = s / tau
        if u < 40.0:
            x -= weight * exp(-u)
    return x
