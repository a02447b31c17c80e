"""Whether the noise has the variance it is said to have, wherever it matters.

Whitened residuals have one variance everywhere where the law holds, whatever the noise's
correlation.  Their squares are averaged in bins of something that the noise may depend on
(concentration, slope of the response), and every bin is set beside the mean of all.  A misfit of
the mean is not counted: from every residual the mean of its four neighbours is taken first, which
removes what is constant or linear over five samples.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.special import erfc

from bayes_sensor.campaign import FloatArray

NEIGHBOURS = np.array([-0.25, -0.25, 1.0, -0.25, -0.25])
"""a residual less the mean of the two before and the two after it"""
GAIN = float(NEIGHBOURS @ NEIGHBOURS)
OVERLAP = 1.45
"""variance of a mean of their squares over that of independent ones, white residuals"""
FEWEST = 40
"""residuals in a bin; emptier bins join the one below"""
MEMORY = 50
"""samples over which squares may be correlated (noise that comes in bursts)"""
FACTOR = 4.0 / 3.0
"""of the variance, up or down, from which a difference matters: 15 % of the standard deviation"""
LEVEL = 1e-3
"""p-value, all bins of a check together, from which it is no chance"""


@dataclass(frozen=True, eq=False)
class VarianceCheck:
    """Measured variance over that of the fitted law, in bins; 1 where the law holds."""

    low: FloatArray
    """(n_bins,) lower edges"""
    high: FloatArray
    """(n_bins,)"""
    count: FloatArray
    """(n_bins,) residuals"""
    factor: FloatArray
    """(n_bins,) variance over the mean of all"""
    p_values: FloatArray
    """(n_bins,) two-sided, each bin alone"""

    @property
    def p_value(self) -> float | None:
        """Of all bins together (the smallest, times their number); None where there is one only."""
        if len(self.p_values) < 2:
            return None
        return float(min(1.0, len(self.p_values) * self.p_values.min()))

    @property
    def failing(self) -> np.ndarray:
        """Bins whose variance is off by more than chance and by so much that it matters."""
        if len(self.p_values) < 2:
            return np.array([], dtype=int)
        unlikely = self.p_values * len(self.p_values) < LEVEL
        much = np.abs(np.log(np.maximum(self.factor, 1e-300))) > np.log(FACTOR)
        return np.flatnonzero(unlikely & much)

    @property
    def adequate(self) -> bool:
        """Whether the law's variance describes the residuals."""
        return len(self.failing) == 0

    @property
    def worst(self) -> int | None:
        """The failing bin that is furthest off; else the one furthest off at all."""
        if len(self.factor) < 2:
            return None
        among = self.failing if len(self.failing) else np.arange(len(self.factor))
        return int(among[np.argmax(np.abs(np.log(np.maximum(self.factor[among], 1e-300))))])

    @property
    def trend(self) -> float:
        """Factor of the highest bin over that of the lowest."""
        return float(self.factor[-1] / max(self.factor[0], 1e-300)) if len(self.factor) else 1.0

    def to_json(self) -> dict[str, Any]:
        """Plain numbers, for ``residuals.json``."""
        worst = self.worst
        return {
            "adequate": self.adequate,
            "p_value": self.p_value,
            "factor": None if worst is None else float(self.factor[worst]),
            "low": None if worst is None else float(self.low[worst]),
            "high": None if worst is None else float(self.high[worst]),
            "bins": [
                {"low": float(a), "high": float(b), "count": int(n), "factor": float(f),
                 "p_value": float(p)}
                for a, b, n, f, p in zip(
                    self.low, self.high, self.count, self.factor, self.p_values, strict=True
                )
            ],
        }  # fmt: skip


def local_squares(whitened: FloatArray) -> FloatArray:
    """(n - 4,) squares of residuals (n,) less their neighbours' mean, as large as without it."""
    if len(whitened) < len(NEIGHBOURS):
        return np.array([])
    squares: FloatArray = np.convolve(whitened, NEIGHBOURS, "valid") ** 2 / GAIN
    return squares


def check_variance(
    whitened: list[FloatArray], places: list[FloatArray], edges: FloatArray, each: bool = False
) -> VarianceCheck:
    """Squares of ``whitened`` residuals (n,) in bins of ``places`` (n,), one array an experiment.

    ``edges`` (n_bins + 1,).  ``each``: every experiment is set beside its own mean, so that
    experiments of different noise do not pass for noise that depends on the place.

    With nu degrees of freedom the cube root of a mean of squares is close to normal, with mean
    1 - 2/(9 nu) and variance 2/(9 nu) (Wilson and Hilferty, Proc. Natl. Acad. Sci. 17, 684, 1931).
    nu follows from the measured spread of the squares within bins, heavy tails included, and from
    how far they are correlated.
    """
    squares, bins = [], []
    for e, x in zip(whitened, places, strict=True):
        square = local_squares(e)
        mean = float(square.mean()) if len(square) else 0.0
        if mean > 0.0:
            squares.append(square / mean if each else square)
            bins.append(np.clip(np.searchsorted(edges, x[2:-2], "right") - 1, 0, len(edges) - 2))
    if not squares:
        none = np.array([])
        return VarianceCheck(none, none, none, none, none)
    kept = _filled(np.bincount(np.concatenate(bins), minlength=len(edges) - 1))
    number = np.searchsorted(kept, np.arange(len(edges) - 1), "right") - 1
    bins = [number[b] for b in bins]
    where, square = np.concatenate(bins), np.concatenate(squares)
    count = np.bincount(where, minlength=len(kept)).astype(float)
    means = np.bincount(where, square, len(kept)) / count
    factor = means / float(square.mean())
    # squares over their bin's mean: their variance is 2 for normal noise
    scaled = [s / np.maximum(means[b], 1e-300) - 1.0 for s, b in zip(squares, bins, strict=True)]
    spread = max(float(np.mean(np.concatenate(scaled) ** 2)), 2.0)
    nu = 2.0 * count / (spread * _overlap(scaled))
    z = (np.cbrt(factor) - 1.0 + 2.0 / (9.0 * nu)) / np.sqrt(2.0 / (9.0 * nu))
    high = np.append(edges[kept[1:]], edges[-1])
    return VarianceCheck(edges[kept], high, count, factor, erfc(np.abs(z) / np.sqrt(2.0)))


def _filled(count: np.ndarray) -> np.ndarray:
    """Bins that begin a bin of at least FEWEST residuals once emptier ones have joined the one
    below; the first always begins one."""
    kept, total = [], 0
    for i in range(len(count) - 1, -1, -1):
        total += int(count[i])
        if total >= FEWEST:
            kept.append(i)
            total = 0
    if 0 not in kept:
        kept[-1:] = [0]  # too few at the lower end: they join the one above
    return np.array(kept[::-1] or [0])


def _overlap(scaled: list[FloatArray]) -> float:
    """1 + 2 times the sum of the squares' autocorrelation; at least that of white residuals."""
    n = sum(len(s) for s in scaled)
    power = sum(float(s @ s) for s in scaled)
    total = 1.0
    for lag in range(1, min(MEMORY, n // 20) + 1):
        total += 2.0 * sum(float(s[lag:] @ s[:-lag]) for s in scaled if len(s) > lag) / power
    return max(total, OVERLAP)
