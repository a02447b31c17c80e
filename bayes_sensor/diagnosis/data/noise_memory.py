"""How long the noise remembers: its correlation from sample to sample, in each record and in all.

Noise that wanders for longer than the quiet stretches last cannot be told from a gap."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np
from scipy.ndimage import uniform_filter1d

from bayes_sensor.campaign import Campaign, CampaignError, FloatArray
from bayes_sensor.diagnosis.data.quiet_stretches import Stretch

WANDERING = 0.9999
"""largest correlation from sample to sample: below, noise is stationary"""
SMOOTH = 0.999
"""the same where the changes tell of a misfit, or of smooth or white noise"""
ROOT = 20.0
"""samples in a stretch times (1 - correlation) below which noise may be a random walk"""
OTHER_MEMORY = 1.5
"""times by which a record's memory differs from the common one before it has its own"""
MEMORY_ERRORS = 5.0
"""standard errors by which it does"""
NO_AR1 = 0.1
"""by which a record's correlations may differ from an AR(1)'s before its memory is not told"""
SLOW_MEMORIES = 60.0
"""memories of the noise over which what is slower is taken out before records are compared"""
WALK = 0.2
"""correlation of neighbouring changes, of either sign, up to which it looks like one"""
TURNS = 8.0
"""share of a stretch, as one over this, at which a walk less its parabola turns back"""
Shape = Callable[[FloatArray], FloatArray]
"""frequencies (n_f,) Hz -> a spectral density of any scale"""


def ar1_shape(noises: Sequence[FloatArray], intervals: Sequence[float]) -> Shape:
    """The spectrum, of any scale, of an AR(1) with the detrended noises' correlation.

    Neighbouring samples tell it even where the stretches are too short for low frequencies.  A
    parabola taken out of n samples takes about (3 + 5 phi)/n of the correlation with it, which is
    put back (Kendall 1954, with two further coefficients): noise that wanders for longer than a
    stretch lasts must not look as if it did not.
    """
    parts = []
    for h in sorted(set(intervals)):
        some = [x for x, own in zip(noises, intervals, strict=True) if own == h]
        parts.append((h, sum(float(x @ x) for x in some), common_correlation(some)))

    def shape(f: FloatArray) -> FloatArray:
        made = np.zeros(len(f))
        for h, square, phi in parts:
            made += square * _of_ar1(f * h, phi)
        return np.maximum(made, 1e-300)

    return shape


def _of_ar1(f: FloatArray, phi: float) -> FloatArray:
    """The spectrum (n_f,) of an AR(1), one on average, at ``f`` (n_f,) cycles a sample."""
    cosine = np.cos(2.0 * np.pi * np.minimum(f, 0.5))
    return np.asarray((1.0 - phi**2) / (1.0 + phi**2 - 2.0 * phi * cosine))


def own_memory(
    campaign: Campaign,
    stretches: Sequence[Stretch],
    noises: Sequence[FloatArray],
    f: FloatArray,
    count: FloatArray,
) -> FloatArray:
    """Factors (n_e, 2, n_f) on the common spectra from the memory of each record's noise.

    Of two records that are as loud, one through a filter ten times as slow, this one has ten times
    the power at low frequencies, where an effect shows.  Neighbouring samples tell the memory, not
    the low frequencies themselves: there a cause may act in one record alone.  ``count``
    (n_e, 2, n_f): ordinates in the common spectra of carrier and plateaus.  All one where records
    are alike, or where what differs is no AR(1), as a line in one record is not.
    """
    own = np.ones(count.shape)
    if not campaign.same_interval:
        return own
    # what is much slower than the noise may be a cause's
    width = round(SLOW_MEMORIES / (1.0 - min(common_correlation(noises), SMOOTH)))
    for level in (0, 1):
        quick: list[list[FloatArray]] = [[] for _ in campaign]
        for s, x in zip(stretches, noises, strict=True):
            if s.level == level and len(x) >= width:
                quick[s.experiment].append(x - uniform_filter1d(x, width))
        told = [common_correlation(some) for some in quick if some]
        if not told:
            continue
        common = float(np.median(told))  # whatever one record has beside its noise
        phi = [_memory_of(some, common, width) if some else common for some in quick]
        if set(phi) == {common} or max(phi) >= SMOOTH:
            continue
        each = np.array([_of_ar1(f * campaign.reference_interval, one) for one in phi])
        weight = count[:, level] + 1e-9  # where there is none all count alike
        own[:, level] = each / (np.sum(weight * each, axis=0) / np.sum(weight, axis=0))
    return own


def _memory_of(quick: Sequence[FloatArray], common: float, width: int) -> float:
    """The correlation of neighbours in one record, where it is an AR(1)'s other than the common.

    ``quick`` is without its means over ``width`` samples, and these hold the share of an AR(1)'s
    variance that two of its memories are of the width.
    """
    n = sum(map(len, quick))
    phi = seen = common_correlation(quick)
    lost = 0.0
    for _ in range(5):
        lost = min(2.0 / (width * (1.0 - phi)), 0.5)
        phi = 1.0 - (1.0 - seen) * (1.0 - lost)
    other = abs(np.log((1.0 - phi) / (1.0 - common))) > np.log(OTHER_MEMORY)
    if not other or abs(phi - common) < MEMORY_ERRORS * np.sqrt((1.0 - common**2) / n):
        return common
    square = max(sum(float(x @ x) for x in quick), 1e-300)
    memory = -1.0 / np.log(max(phi, 0.05))
    for lag in {max(round(times * memory), 2) for times in (0.5, 1.0, 2.0)}:
        found = sum(float(x[lag:] @ x[:-lag]) for x in quick) / square
        if abs(1.0 - (1.0 - found) * (1.0 - lost) - phi**lag) > NO_AR1:
            return common
    return phi


def _from_one_to_the_next(series: Sequence[FloatArray]) -> float:
    """Correlation of neighbours, all series together."""
    square = max(sum(float(x @ x) for x in series), 1e-300)
    return sum(float(x[1:] @ x[:-1]) for x in series) / square


def common_correlation(noises: Sequence[FloatArray]) -> float:
    """Correlation from sample to sample, corrected for detrending; at most WANDERING."""
    phi = _from_one_to_the_next(noises)
    if not like_a_walk(noises):  # a smooth misfit is no stationary noise that detrending bent
        return min(max(phi, 0.0), SMOOTH)
    lost = (3.0 + 5.0 * phi) * len(noises) / sum(len(x) for x in noises)
    return min(max(phi + lost, 0.0), WANDERING)


def check_memory(noises: Sequence[FloatArray]) -> None:
    """Refuse noise that may keep its value for longer than the quiet stretches last.

    The test is that for a unit root, n (1 - phi) of stretches of n samples, about 14 for a random
    walk without its parabola.  It must also look like a walk at short times, where changes follow
    each other without correlation: those of white noise over a smooth misfit alternate, and those
    of the misfit itself go on in one direction.
    """
    phi = _from_one_to_the_next(noises)
    mean_length = sum(len(x) for x in noises) / len(noises)
    if mean_length * (1.0 - phi) < ROOT and like_a_walk(noises):
        raise CampaignError(
            f"gap: the noise wanders: its value persists (correlation {phi:.3f} from sample to "
            f"sample) throughout quiet stretches of {mean_length:.0f} samples, so that it cannot "
            "be told from a gap; expected stretches that outlast the noise's memory many times: "
            "record longer baselines and plateaus, or remove what makes the signal wander"
        )


def like_a_walk(noises: Sequence[FloatArray]) -> bool:
    """Whether successive changes are hardly correlated at the shortest times, and turn later.

    A walk less its parabola comes back within a stretch; a smooth misfit beside noise goes on in
    one direction.
    """
    whole = sum(len(x) for x in noises) / len(noises)
    shortest = [_going_on(noises, m) for m in (1, 2, 5)]
    if shortest[0] <= -WALK or max(shortest) >= WALK:
        return False
    return _going_on(noises, max(int(whole / TURNS), 1)) < 0.0


def _going_on(noises: Sequence[FloatArray], m: int) -> float:
    """Correlation of changes over ``m`` samples with those over the next ``m``."""
    changes = [x[m:] - x[:-m] for x in noises]
    square = max(sum(float(d @ d) for d in changes), 1e-300)
    return sum(float(d[m:] @ d[:-m]) for d in changes) / square
