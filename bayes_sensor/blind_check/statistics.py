"""Shares, means, areas and calibration of many cases, each with what chance leaves open.

Proportions have Wilson's interval; everything else one from the bootstrap over cases.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from math import sqrt
from typing import Any

import numpy as np

Row = dict[str, Any]
DRAWS = 2000
"""bootstrap samples"""
SEED = 20260602
"""of the bootstrap: the same cases give the same card"""


def wilson(k: int, n: int) -> tuple[float, float]:
    """95 % interval of a proportion after ``k`` of ``n`` (Wilson, J. Am. Stat. Assoc. 22, 1927).

    >>> [round(v, 4) for v in wilson(0, 200)]
    [0.0, 0.0188]
    >>> wilson(0, 7)[0], wilson(7, 7)[1]
    (0.0, 1.0)
    """
    from scipy.stats import binomtest

    if n == 0:
        return 0.0, 1.0
    interval = binomtest(k, n).proportion_ci(0.95, "wilson")
    return float(interval.low), float(interval.high)


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


def roc(positive: Iterable[float | None], negative: Iterable[float | None]) -> Row:
    """Curve of a score that is high for positives, and its area.

    ``se``: the area's standard error (Hanley and McNeil, Radiology 143, 1982); ``area_lo95``,
    ``area_hi95``: positives and negatives drawn anew, each among themselves.
    """
    yes = np.array([v for v in positive if v is not None], dtype=float)
    no = np.array([v for v in negative if v is not None], dtype=float)
    n, m = len(yes), len(no)
    if n == 0 or m == 0:
        nothing = dict.fromkeys(("area", "area_lo95", "area_hi95", "se"))
        return {**nothing, "area_n": n + m, "false": [], "true": []}
    cuts = np.unique(np.concatenate([yes, no]))[::-1]
    wins = (yes[:, None] > no[None, :]) + 0.5 * (yes[:, None] == no[None, :])
    area = float(wins.mean())
    q1, q2 = area / (2.0 - area), 2.0 * area**2 / (1.0 + area)
    variance = area * (1 - area) + (n - 1) * (q1 - area**2) + (m - 1) * (q2 - area**2)
    rng = np.random.default_rng(SEED)
    times_yes = rng.multinomial(n, np.full(n, 1.0 / n), size=DRAWS)
    times_no = rng.multinomial(m, np.full(m, 1.0 / m), size=DRAWS)
    anew = ((times_yes @ wins) * times_no).sum(axis=1) / (n * m)
    low, high = (float(q) for q in np.quantile(anew, [0.025, 0.975]))
    return {
        "area": area,
        "area_n": n + m,
        "area_lo95": low,
        "area_hi95": high,
        "se": sqrt(max(variance, 0.0) / (n * m)),
        "false": [float(np.mean(no >= cut)) for cut in cuts],
        "true": [float(np.mean(yes >= cut)) for cut in cuts],
    }


def f1(precision: float | None, recall: float) -> float:
    """Harmonic mean; 0 where no place was stated, or none of the right ones."""
    return 2.0 * precision * recall / (precision + recall) if precision and recall else 0.0


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

    rng = np.random.default_rng(20260601)
    drawn = error((rng.random((4000, len(p))) < p).astype(float))
    ece, band = float(error(hit.astype(float))), float(np.quantile(drawn, 0.95))
    table = [
        {"stated": float(p[bins == b].mean()), "right": proportion(hit[bins == b])}
        for b in np.unique(bins)
    ]
    return {"n": len(p), "ece": ece, "band95": band, "inside": ece <= band, "bins": table}
