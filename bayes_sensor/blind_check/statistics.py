"""Shares, means, areas and calibration of many cases, each with what chance leaves open.

Proportions have Wilson's interval, everything else one from the bootstrap over cases.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import Any

import numpy as np
from scipy.stats import mannwhitneyu
from statsmodels.stats.proportion import proportion_confint

Row = dict[str, Any]
DRAWS, SEED = 2000, 20260602
"""of the bootstrap: the same cases give the same card"""


def wilson(k: int, n: int) -> tuple[float, float]:
    """95 % interval of a proportion after ``k`` of ``n`` (Wilson, J. Am. Stat. Assoc. 22, 1927).

    >>> [round(v, 4) for v in wilson(0, 200)]
    [0.0, 0.0188]
    """
    if n == 0:
        return 0.0, 1.0
    low, high = proportion_confint(k, n, method="wilson")
    # at either end the bound is exact, which rounding would miss
    return 0.0 if k == 0 else float(low), 1.0 if k == n else float(high)


def proportion(values: Iterable[Any]) -> Row:
    """k of n with its interval; values that are None do not count."""
    known = [bool(v) for v in values if v is not None]
    k, n = sum(known), len(known)
    low, high = wilson(k, n)
    return {"k": k, "n": n, "rate": k / n if n else None, "lo95": low, "hi95": high}


def drawn_anew(n: int) -> np.ndarray:
    """(DRAWS, n) indices of ``n`` cases drawn with replacement, the same in every call."""
    return np.random.default_rng(SEED).integers(n, size=(DRAWS, n))


def average(name: str, values: Iterable[float | None], *, median: bool = False) -> Row:
    """``name``: mean or median; ``name_n``: of how many values; ``name_lo95``, ``name_hi95``.

    Values that are None do not count; one value alone has no interval.
    """
    known = np.array([v for v in values if v is not None], dtype=float)
    of = np.median if median else np.mean
    found = float(of(known)) if len(known) else None
    low = high = None
    if len(known) > 1:
        anew = of(known[drawn_anew(len(known))], axis=1)
        low, high = (float(q) for q in np.quantile(anew, [0.025, 0.975]))
    return {name: found, f"{name}_n": len(known), f"{name}_lo95": low, f"{name}_hi95": high}


def area(positive: Iterable[float | None], negative: Iterable[float | None]) -> Row:
    """Area under the ROC curve of a score that is high for positives.

    Its interval rests on the standard error of Hanley and McNeil (Radiology 143, 1982).
    """
    yes, no = ([v for v in values if v is not None] for values in (positive, negative))
    n, m = len(yes), len(no)
    if n == 0 or m == 0:
        return {"area": None, "area_n": n + m, "area_lo95": None, "area_hi95": None}
    a = float(mannwhitneyu(yes, no).statistic) / (n * m)
    q1, q2 = a / (2.0 - a), 2.0 * a**2 / (1.0 + a)
    variance = a * (1.0 - a) + (n - 1) * (q1 - a**2) + (m - 1) * (q2 - a**2)
    half = 1.96 * float(np.sqrt(max(variance, 0.0) / (n * m)))
    return {"area": a, "area_n": n + m, "area_lo95": max(a - half, 0.0),
            "area_hi95": min(a + half, 1.0)}  # fmt: skip


def calibration(rows: Sequence[Row], stated: str, right: str) -> Row:
    """Reliability in ten bins, expected calibration error and its band under calibration.

    The band: 95 % of what the error would be if each answer were right with just the probability
    stated (4000 draws).
    """
    known = [r for r in rows if r[stated] is not None]
    if not known:
        return {"n": 0, "ece": None, "band95": None, "inside": None, "bins": []}
    p = np.array([float(r[stated]) for r in known])
    hit = np.array([bool(r[right]) for r in known])
    bins = np.minimum((p * 10).astype(int), 9)

    def error(outcome: np.ndarray) -> np.ndarray:
        total = np.zeros(outcome.shape[:-1])
        for b in np.unique(bins):
            inside = bins == b
            total += np.abs((outcome[..., inside] - p[inside]).sum(axis=-1))
        return total / len(p)

    drawn = error((np.random.default_rng(SEED).random((4000, len(p))) < p).astype(float))
    ece, band = float(error(hit.astype(float))), float(np.quantile(drawn, 0.95))
    table = [
        {"stated": float(p[bins == b].mean()), "right": proportion(hit[bins == b])}
        for b in np.unique(bins)
    ]
    return {"n": len(p), "ece": ece, "band95": band, "inside": ece <= band, "bins": table}
