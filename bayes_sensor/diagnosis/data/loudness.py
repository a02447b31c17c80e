"""Where noise is louder: on the plateaus than at the carrier gas, and for a while."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np
from scipy.ndimage import uniform_filter1d

from bayes_sensor.campaign import Campaign, Experiment, FloatArray
from bayes_sensor.diagnosis.data.bins import ExperimentBins
from bayes_sensor.diagnosis.data.quiet_stretches import spread_of

LOUD_BLOCK = (0.25, 50)
"""s, and samples: at least so much tells how loud a record is somewhere"""
LOUD_BLOCKS = (6, 12, 24, 48, 96)
"""blocks in a row that are asked whether they are louder than the record usually is"""
LOUDER = 1.25
"""times the usual power from which noise may be called louder"""
LOUD_ERRORS = 5.0
"""standard errors above the usual from which it is"""
LOUD_EDGE = 2
"""blocks on either side over which power is averaged to say how much louder"""


def plateau_over_carrier(
    campaign: Campaign,
    residuals: Sequence[FloatArray],
    bins: Sequence[ExperimentBins],
    level_of_bins: Sequence[FloatArray],
) -> float:
    """The plateaus' noise power over the carrier's, from changes from sample to sample.

    These are the noise's alone, since what a model misses changes slowly; so they compare the two
    levels also where one is too short to be quiet.
    """
    square, n = np.zeros(2), np.zeros(2)
    for e, r, b, level in zip(campaign, residuals, bins, level_of_bins, strict=True):
        for first, last, share in zip(b.first, b.last, level, strict=True):
            if 0.1 < share < 0.9:
                continue
            both = e.used[first : last - 1] & e.used[first + 1 : last]
            change = np.diff(r[first:last])[both]
            square[int(share >= 0.9)] += float(change @ change)
            n[int(share >= 0.9)] += len(change)
    carrier, plateau = square / np.maximum(n, 1.0)
    return float(plateau / carrier) if carrier > 0.0 and plateau > 0.0 else 1.0


def loudness(
    e: Experiment, residual: FloatArray, bins: ExperimentBins, level: FloatArray
) -> FloatArray:
    """(n_bins,) times by which noise exceeds the floor where it is louder for a while; else one.

    Somebody drills next door, a pump runs for a minute: the floor is the mean of a whole record,
    and what stands out of it there is noise.  Changes of the ``residual`` (n_t,) V from sample to
    sample tell, being the noise's alone, block by block and at the bins' ``level`` (n_bins,) of the
    gas.  Blocks usually have the median's power, give or take what neighbours differ by; runs of
    them that have clearly more are louder.  That noise is quieter somewhere is not relied upon.
    """
    size = max(round(LOUD_BLOCK[0] / e.interval), LOUD_BLOCK[1])
    power = _power_of_changes(e, residual, size)
    n, known = len(power), np.isfinite(power)
    at = np.interp((np.arange(n) + 0.5) * size, 0.5 * (bins.first + bins.last), level)
    usual, mean = (_over_levels(power, at, of) for of in (np.median, np.mean))
    if int(known.sum()) < 2 * LOUD_BLOCKS[0] or np.min(usual) <= 0.0:
        return np.ones(len(level))
    relative = np.where(known, power / usual, 1.0)
    scatter = float(spread_of(np.diff(relative[known])))
    total = np.concatenate([[0.0], np.cumsum(relative)])
    loud = np.zeros(n, dtype=bool)
    for m in (m for m in LOUD_BLOCKS if 2 * m <= n):
        enough = max(LOUDER, 1.0 + LOUD_ERRORS * scatter / np.sqrt(m))
        for i in np.flatnonzero(total[m:] - total[:-m] > enough * m):
            loud[i : i + m] = True
    width = 2 * LOUD_EDGE + 1
    locally, times = (
        uniform_filter1d(np.where(known, power / x, 1.0), width, mode="nearest")
        for x in (usual, mean)
    )
    times = np.where(loud & (locally > LOUDER), np.maximum(times, 1.0), 1.0)
    block = np.minimum(np.arange(len(residual)) // size, n - 1)
    return np.asarray(np.sqrt(bins.average(times[block])), dtype=float)


def _power_of_changes(e: Experiment, residual: FloatArray, size: int) -> FloatArray:
    """(n,) V^2, mean squared change from sample to sample of blocks of ``size``; NaN where unknown.

    A block is unknown where most of its samples are unused.
    """
    n = max(len(residual) // size, 1)
    both = np.append(e.used[1:] & e.used[:-1], False)[: n * size]
    square = np.where(both, np.diff(residual, append=0.0)[: n * size] ** 2, 0.0)
    of_block = np.arange(len(both)) // size
    count, power = np.bincount(of_block, both), np.bincount(of_block, square)
    return np.where(count > 0.5 * size, power / np.maximum(count, 1), np.nan)


def _over_levels(
    power: FloatArray, at: FloatArray, of: Callable[[FloatArray], np.floating]
) -> FloatArray:
    """(n,) median or mean ``power`` at the carrier and on the plateau, and between the two."""
    sides = [power[here & np.isfinite(power)] for here in (at < 0.1, at > 0.9)]
    found = [float(of(some)) for some in sides if len(some)] or [0.0]
    return np.asarray(found[0] + (found[-1] - found[0]) * np.clip(at, 0.0, 1.0), dtype=float)
