"""Coverage counted over simulated campaigns, with the interval of a proportion."""

from __future__ import annotations

import numpy as np


def binomial_interval(k: float, n: float, level: float = 0.95) -> tuple[float, float]:
    """Clopper and Pearson's interval of a proportion after ``k`` of ``n`` (Biometrika 26, 1934).

    Neither need be whole: n may be an effective number.

    >>> [round(v, 4) for v in binomial_interval(0, 10)]
    [0.0, 0.3085]
    """
    from statsmodels.stats.proportion import proportion_confint

    low, high = proportion_confint(k, n, 1.0 - level, method="beta")
    return float(low), float(high)


def coverage_row(inside: np.ndarray, nominal: float) -> dict[str, float]:
    """n, covered, coverage, its 95 % binomial interval, whether the nominal level lies in it."""
    n, k = len(inside), int(np.sum(inside))
    low, high = binomial_interval(k, n)
    return {
        "nominal": nominal, "n": n, "covered": k, "coverage": k / n,
        "coverage_lo95": low, "coverage_hi95": high, "agrees": int(low <= nominal <= high),
    }  # fmt: skip
