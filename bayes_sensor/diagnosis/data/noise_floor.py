"""The noise floor, estimated without the model, and what it means for means over bins.

Quiet stretches - baseline, plateau, tail - are detrended and their spectra averaged in bands,
separately for the carrier gas alone and for the plateaus.  The covariance of bin means follows
from these spectra, not from an AR(1) law: a little slow noise under fast noise makes an AR(1)
floor far too low where an effect would show.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import solve_triangular
from scipy.ndimage import median_filter, uniform_filter1d
from scipy.signal import windows

from bayes_sensor.campaign import Campaign, CampaignError, Experiment, FloatArray
from bayes_sensor.diagnosis.data.bins import ExperimentBins
from bayes_sensor.residuals.converter_step import lattice_step

SPIKE = 6.5
"""robust standard deviations beyond which a sample is taken for a glitch"""
SPELL = 200
"""samples in a row that tell whether all of them are large, and none of them a glitch"""
MUCH = 1.5
"""times the usual spread from which they are"""
SHRINK = 20.0
"""degrees of freedom of the neighbouring band, or of the common shape, in a band's estimate"""
DOF = 60.0
"""degrees of freedom of the floor's level: evidences use a t law with so many"""
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
LAGS_PER_BIN = 24.0
"""lags of the covariance within the shortest bin"""
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


Shape = Callable[[FloatArray], FloatArray]
"""frequencies (n_f,) Hz -> a spectral density of any scale"""


@dataclass(frozen=True, eq=False)
class Stretch:
    """A quiet part of one record."""

    experiment: int
    level: int
    """0 carrier gas alone, 1 plateau"""
    samples: FloatArray
    """(n,) V, residual of the fit, spikes replaced"""
    begin: float = 0.0
    """s, time of the first sample"""


@dataclass(frozen=True)
class Quiet:
    """Where one record is quiet, and what to scale it by."""

    switches: tuple[float, ...]
    """s"""
    spans: tuple[tuple[float, float], ...]
    """s, from settling to the next switch"""
    deviation: FloatArray
    """(n_t,) V, the noise's standard deviation at every sample"""
    step: float = 1.0
    """V, height of the plateau over the baseline"""


@dataclass(frozen=True, eq=False)
class Floor:
    """Spectral densities of the noise per experiment and level, and the bins' covariance."""

    edges: FloatArray
    """(n_bands + 1,) Hz"""
    density: FloatArray
    """(n_experiments, 2, n_bands) V^2/Hz, one-sided, at carrier and plateau"""
    dof: FloatArray
    """(n_bands,) degrees of freedom of each band"""
    cholesky: tuple[FloatArray, ...]
    """(n_bins, n_bins) V, lower factor of each experiment's covariance of bin means"""
    spikes: int
    """samples replaced"""
    loudness: tuple[FloatArray, ...]
    """(n_bins,) of each experiment: times by which its noise is louder there than usual, or one"""

    def whiten(self, k: int, values: FloatArray) -> FloatArray:
        """Bin values (n_bins,) or (n_bins, m) of experiment ``k`` in standard deviations."""
        e: FloatArray = solve_triangular(self.cholesky[k], values, lower=True, check_finite=False)
        return e

    def deviation(self, k: int) -> FloatArray:
        """(n_bins,) V, standard deviation of each bin mean of experiment ``k``."""
        deviation: FloatArray = np.sqrt(np.sum(self.cholesky[k] ** 2, axis=1))
        return deviation

    def rms(self) -> float:
        """V, of the noise itself, averaged over experiments and levels."""
        width = np.diff(self.edges)
        return float(np.sqrt(np.mean(self.density @ width)))


def clean(
    residual: FloatArray, used: NDArray[np.bool_], resolution: float = 0.0
) -> tuple[FloatArray, int]:
    """The residual with unused samples and spikes set to the local median, and how many spikes.

    ``resolution`` V: the converter's step.  Where the noise hardly crosses it most samples are
    equal, and a median would take every sample a step away for a spike.
    """
    out = np.where(used, residual, 0.0)
    values = out[used]
    if len(values) < 8:
        return out, 0
    centre = np.median(values)
    # differences see spikes even where the model misses the trace
    step = np.diff(values)
    spread = float(_spread_of(step))
    scale = 1.4826 * np.median(np.abs(values - centre))
    if scale <= 0.0 or spread <= 0.0:
        return out, 0
    width = 5
    padded = np.pad(out, width, mode="edge")
    local = (
        np.median(np.lib.stride_tricks.sliding_window_view(padded, 2 * width + 1)[::1], axis=1)
        if len(out) <= 20000
        else _running_median(out, width)
    )
    usual = max(spread, scale, 0.5 * resolution)
    away = np.abs(out - local) > SPIKE * np.maximum(usual, _spread_nearby(out, spread))
    return np.where(away & used, local, out), int(np.sum(away & used))


def _spread_of(steps: FloatArray) -> FloatArray:
    """(..,) standard deviation of values that differ by ``steps`` (.., n) from their neighbours.

    By the median, which neither glitches nor a misfit move.
    """
    return np.asarray(1.4826 * np.median(np.abs(steps), axis=-1) / np.sqrt(2.0), dtype=float)


def _spread_nearby(values: FloatArray, usual: float) -> FloatArray:
    """(n,) V, spread of the noise where it is much louder than ``usual`` for a while; or zero."""
    n = len(values) // SPELL
    if n < 2:
        return np.zeros(len(values))
    nearby = _spread_of(np.diff(values, append=values[-1])[: n * SPELL].reshape(n, SPELL))
    nearby = np.where(nearby > MUCH * usual, nearby, 0.0)
    return np.asarray(nearby[np.minimum(np.arange(len(values)) // SPELL, n - 1)], dtype=float)


def _running_median(values: FloatArray, width: int) -> FloatArray:
    median: FloatArray = median_filter(values, size=2 * width + 1, mode="nearest")
    return median


def quiet_stretches(
    campaign: Campaign,
    residuals: Sequence[FloatArray],
    bins: Sequence[ExperimentBins],
    settle: Sequence[float],
) -> list[Stretch]:
    """The quiet parts of all records; ``settle`` s after a switch are left out."""
    found = []
    for k, (e, r, b) in enumerate(zip(campaign, residuals, bins, strict=True)):
        on = float(e.t[b.first[b.phase >= 1].min()]) if np.any(b.phase >= 1) else float(e.t[-1])
        fall = b.phase >= 4
        off = float(e.t[b.first[fall].min()]) if np.any(fall) else float(e.t[-1]) + e.interval
        spans = [(float(e.t[0]), on, 0), (on + settle[k], off, 1)]
        if np.any(fall):
            spans.append((off + settle[k], float(e.t[-1]) + e.interval, 0))
        for low, high, level in spans:
            a, z = np.searchsorted(e.t, (low, high))
            for run_a, run_b in e.runs:
                i, j = max(a, run_a), min(z, run_b)
                if (j - i) >= 64:
                    found.append(Stretch(k, level, np.asarray(r[i:j], dtype=float), float(e.t[i])))
    return found


def detrended(samples: FloatArray, degree: int = 2) -> FloatArray:
    """The samples (n,) minus their least-squares polynomial."""
    x = np.linspace(-1.0, 1.0, len(samples))
    basis = np.polynomial.legendre.legvander(x, degree)
    # Legendre polynomials are nearly orthogonal on a grid: the normal equations are harmless
    coefficients = np.linalg.solve(basis.T @ basis, basis.T @ samples)
    return np.asarray(samples - basis @ coefficients, dtype=float)


def band_edges(campaign: Campaign, stretches: Sequence[Stretch]) -> FloatArray:
    """Octave bands from what the longest stretch resolves to half the sampling rate, Hz."""
    longest = max(len(s.samples) * campaign.experiments[s.experiment].interval for s in stretches)
    top = 0.5 / min(e.interval for e in campaign)
    low = 3.0 / longest
    n = max(int(np.ceil(np.log2(top / low))), 1)
    return np.asarray(top / 2.0 ** np.arange(n, -1, -1), dtype=float)


def estimate_floor(
    campaign: Campaign,
    residuals: Sequence[FloatArray],
    bins: Sequence[ExperimentBins],
    settle: Sequence[float],
    level_of_bins: Sequence[FloatArray],
    spikes: int = 0,
    fits: Sequence[FloatArray] | None = None,
) -> Floor:
    """The floor of a campaign from the residuals (n_t,) V of its fit.

    ``level_of_bins``: the normalised concentration (n_bins,) in 0..1 of every bin.  ``fits``
    (n_t,) V: the fitted means, for the bias of a coarse converter's rounding.

    Raises
    ------
    CampaignError
        If no stretch of any record is quiet and long enough, or the noise outlasts them all.
    """
    stretches = quiet_stretches(campaign, residuals, bins, settle)
    if not stretches:
        raise CampaignError(
            "gap: no stretch of 64 samples lies outside the switching, so that the noise floor "
            "cannot be estimated; expected a baseline or a plateau: record longer"
        )
    edges = band_edges(campaign, stretches)
    n_e, n_b = len(campaign), len(edges) - 1
    power = np.zeros((n_e, 2, n_b))
    count = np.zeros((n_e, 2, n_b))
    intervals = [campaign.experiments[s.experiment].interval for s in stretches]
    noises = [detrended(s.samples) for s in stretches]
    for s, h, noise in zip(stretches, intervals, noises, strict=True):
        f, p = periodogram(noise, h)
        keep = f >= 1.6 / (len(s.samples) * h)
        band = np.searchsorted(edges, f[keep], side="right") - 1
        inside = (band >= 0) & (band < n_b)
        np.add.at(power[s.experiment, s.level], band[inside], p[keep][inside])
        np.add.at(count[s.experiment, s.level], band[inside], 1.0)
    missing = len({s.level for s in stretches}) < 2
    louder = _louder(campaign, residuals, bins, level_of_bins) if missing else 1.0
    _check_memory(noises)
    shape = _correlated(noises, intervals)
    below = shape if _like_a_walk(noises) else np.ones_like
    middles = np.sqrt(edges[:-1] * edges[1:])
    density, dof = _shrunk(power, count, edges, shape(middles), louder)
    own = density * _own_memory(campaign, stretches, noises, middles, count)
    width = np.diff(edges)
    density = own * ((density @ width) / (own @ width))[:, :, None]  # as loud as before
    louder_bins = tuple(
        loudness(e, r, b, level)
        for e, r, b, level in zip(campaign, residuals, bins, level_of_bins, strict=True)
    )
    factors = tuple(
        louder_bins[k][:, None] * _bin_cholesky(
            e, b, edges, density[k], level, below,
            None if fits is None else rounding_bias(e, b, edges, density[k], fits[k]),
        )
        for k, (e, b, level) in enumerate(zip(campaign, bins, level_of_bins, strict=True))
    )  # fmt: skip
    return Floor(edges, density, dof, factors, spikes, louder_bins)


def periodogram(noise: FloatArray, interval: float) -> tuple[FloatArray, FloatArray]:
    """Frequencies Hz above 0, and the one-sided spectral density V^2/Hz of tapered samples (n,)."""
    n = len(noise)
    taper = windows.tukey(n, 0.2)
    spectrum = np.fft.rfft(noise * taper)
    power = 2.0 * interval * np.abs(spectrum) ** 2 / np.sum(taper**2)
    return np.asarray(np.fft.rfftfreq(n, interval)[1:], dtype=float), power[1:]


def _correlated(noises: Sequence[FloatArray], intervals: Sequence[float]) -> Shape:
    """The spectrum, of any scale, of an AR(1) with the detrended noises' correlation.

    Neighbouring samples tell it even where the stretches are too short for low frequencies.  A
    parabola taken out of n samples takes about (3 + 5 phi)/n of the correlation with it, which is
    put back (Kendall 1954, with two further coefficients): noise that wanders for longer than a
    stretch lasts must not look as if it did not.
    """
    parts = []
    for h in sorted(set(intervals)):
        some = [x for x, own in zip(noises, intervals, strict=True) if own == h]
        parts.append((h, sum(float(x @ x) for x in some), _correlation(some)))

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


def _own_memory(
    campaign: Campaign,
    stretches: Sequence[Stretch],
    noises: Sequence[FloatArray],
    f: FloatArray,
    count: FloatArray,
) -> FloatArray:
    """What the memory of each record's noise makes of the common spectra, (n_e, 2, n_f).

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
    width = round(SLOW_MEMORIES / (1.0 - min(_correlation(noises), SMOOTH)))
    for level in (0, 1):
        quick: list[list[FloatArray]] = [[] for _ in campaign]
        for s, x in zip(stretches, noises, strict=True):
            if s.level == level and len(x) >= width:
                quick[s.experiment].append(x - uniform_filter1d(x, width))
        told = [_correlation(some) for some in quick if some]
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
    phi = seen = _correlation(quick)
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


def _correlation(noises: Sequence[FloatArray]) -> float:
    """From sample to sample, what detrending took of it put back; at most WANDERING."""
    phi = _from_one_to_the_next(noises)
    if not _like_a_walk(noises):  # a smooth misfit is no stationary noise that detrending bent
        return min(max(phi, 0.0), SMOOTH)
    lost = (3.0 + 5.0 * phi) * len(noises) / sum(len(x) for x in noises)
    return min(max(phi + lost, 0.0), WANDERING)


def _check_memory(noises: Sequence[FloatArray]) -> None:
    """Refuse noise that may keep its value for longer than the quiet stretches last.

    The test is that for a unit root, n (1 - phi) of stretches of n samples, about 14 for a random
    walk without its parabola.  It must also look like a walk at short times, where changes follow
    each other without correlation: those of white noise over a smooth misfit alternate, and those
    of the misfit itself go on in one direction.
    """
    phi = _from_one_to_the_next(noises)
    mean_length = sum(len(x) for x in noises) / len(noises)
    if mean_length * (1.0 - phi) < ROOT and _like_a_walk(noises):
        raise CampaignError(
            f"gap: the noise wanders: its value persists (correlation {phi:.3f} from sample to "
            f"sample) throughout quiet stretches of {mean_length:.0f} samples, so that it cannot "
            "be told from a gap; expected stretches that outlast the noise's memory many times: "
            "record longer baselines and plateaus, or remove what makes the signal wander"
        )


def _like_a_walk(noises: Sequence[FloatArray]) -> bool:
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


def _louder(
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
    scatter = float(_spread_of(np.diff(relative[known])))
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


def _shrunk(
    power: FloatArray,
    count: FloatArray,
    edges: FloatArray,
    correlated: FloatArray,
    louder: float,
) -> tuple[FloatArray, FloatArray]:
    """Densities (n_e, 2, n_b): a level per experiment, a spectral shape per level.

    The shape of a level is pooled over experiments; where a band holds few ordinates it leans on
    the common shape of both levels, and below a few hertz on the band above it, as a noise
    ``correlated`` (n_b,) from sample to sample continues from there.  Where one level has no
    quiet stretch, the plateaus are ``louder`` than the carrier by this factor.
    """
    n_e, _, n_b = power.shape
    width = np.diff(edges)
    # scale of each experiment and level: broad-band, where ordinates abound
    seen = count.sum(axis=2)
    mean = np.divide(power, count, out=np.zeros_like(power), where=count > 0)
    pooled = power.sum(axis=(0, 1)) / np.maximum(count.sum(axis=(0, 1)), 1.0)
    pooled = _filled(pooled, count.sum(axis=(0, 1)) > 0)
    scale = np.ones((n_e, 2))
    for k in range(n_e):
        for level in range(2):
            if seen[k, level] > 0:
                have = count[k, level] > 0
                scale[k, level] = np.sum((mean[k, level] * width)[have]) / np.sum(
                    (pooled * width)[have]
                )
    for level in range(2):  # a level that a record lacks: as in the others
        have = seen[:, level] > 0
        if not have.any():
            scale[:, level] = scale[:, 1 - level] * (louder if level else 1.0 / louder)
        elif not have.all():
            scale[~have, level] = np.mean(scale[have, level])
    scale = np.maximum(scale, 1e-12)
    relative = power / scale[:, :, None]
    n_all = count.sum(axis=(0, 1))
    common = _filled(relative.sum(axis=(0, 1)) / np.maximum(n_all, 1.0), n_all > 0)
    common = _lean_down(common, n_all, edges, correlated)
    shapes = np.empty((2, n_b))
    for level in range(2):
        n_l = count[:, level].sum(axis=0)
        own = relative[:, level].sum(axis=0) / np.maximum(n_l, 1.0)
        shapes[level] = (n_l * own + SHRINK * common) / (n_l + SHRINK)
    density = np.maximum(scale[:, :, None] * shapes[None], 1e-300)
    return density, np.maximum(n_all, 1.0) * 2.0


def _filled(values: FloatArray, have: NDArray[np.bool_]) -> FloatArray:
    index = np.arange(len(values))
    return np.interp(index, index[have], values[have]) if have.any() else np.ones_like(values)


def _lean_down(
    common: FloatArray, count: FloatArray, edges: FloatArray, correlated: FloatArray
) -> FloatArray:
    out = common.copy()
    for b in range(len(out) - 2, -1, -1):
        if edges[b + 1] <= 8.0:
            expected = out[b + 1] * correlated[b] / correlated[b + 1]
            out[b] = (count[b] * common[b] + SHRINK * expected) / (count[b] + SHRINK)
    return out


def rounding_bias(
    e: Experiment, bins: ExperimentBins, edges: FloatArray, density: FloatArray, fit: FloatArray
) -> FloatArray | None:
    """(n_bins, m) V, factor of the covariance that rounding to a converter's step gives bin means.

    Gaussian noise of standard deviation sigma around y rounds, on average, to y plus
    sum_m (-1)^m step/(pi m) exp(-2 (pi m sigma/step)^2) sin(2 pi m y/step): nothing where the
    noise crosses several steps, a bias that follows the signal where it does not (Widrow, Kollar
    and Liu 1996).  The phase is taken for unknown.  None where the bias is negligible.  ``density``
    (2, n_bands) V^2/Hz is that of the record, which holds the step^2/12 that rounding adds.
    """
    step = lattice_step(e.values[e.used])
    if step <= 0.0:
        return None
    recorded = float(np.min(density @ np.diff(edges)))
    sigma = float(np.sqrt(max(recorded - step**2 / 12.0, 0.01 * recorded)))
    columns = []
    for m in (1, 2, 3):
        size = step / (np.pi * m) * np.exp(-2.0 * (np.pi * m * sigma / step) ** 2)
        if size > 1e-3 * sigma:
            angle = 2.0 * np.pi * m * fit / step
            columns += [size * bins.average(np.cos(angle)), size * bins.average(np.sin(angle))]
    return np.column_stack(columns) / np.sqrt(2.0) if columns else None


def _bin_cholesky(
    e: Experiment,
    bins: ExperimentBins,
    edges: FloatArray,
    density: FloatArray,
    level: FloatArray,
    shape: Shape,
    extra: FloatArray | None = None,
) -> FloatArray:
    """Lower factor (n_bins, n_bins) of the covariance of bin means of one experiment.

    ``extra`` (n_bins, m) V: factor of what is added to it.
    """
    # lags are needed on a grid that is fine beside the shortest bin only; the bins' ends are moved
    # onto it, so that what follows is the covariance of a real process and positive definite
    shortest = float(np.min(bins.count)) * e.interval
    step = e.interval * max(1, int(shortest / (LAGS_PER_BIN * e.interval)))
    n = 1 << int(np.ceil(np.log2(2.2 * len(e.t) * e.interval / step)))
    f = np.asarray(np.fft.rfftfreq(n, step), dtype=float)
    low = _density_at(f, edges, density[0], shape)
    high = _density_at(f, edges, density[1], shape)
    a = np.rint(bins.first * e.interval / step).astype(np.int64)
    b = np.maximum(np.rint(bins.last * e.interval / step).astype(np.int64), a + 1)
    index = [np.abs(np.subtract.outer(p, q)) for p, q in ((b, a), (a, b), (b, b), (a, a))]
    norm = np.outer(b - a, b - a)

    def covariance(spectrum: FloatArray) -> FloatArray:
        # G with second differences equal to the autocovariance: then
        # cov(mean over [a, b), mean over [c, d)) n m = G(b - c) + G(a - d) - G(b - d) - G(a - c)
        gamma = np.fft.irfft(spectrum, n)[: n // 2] / (2.0 * step)
        slope = np.cumsum(gamma) - 0.5 * gamma[0]
        second = np.concatenate([[0.0], np.cumsum(slope)])
        made = second[index[0]] + second[index[1]] - second[index[2]] - second[index[3]]
        return np.asarray(made / norm, dtype=float)

    level = np.clip(level, 0.0, 1.0)
    ratio = max(
        float(np.sum(density[1] * np.diff(edges)) / np.sum(density[0] * np.diff(edges))), 1e-6
    )
    if abs(ratio - 1.0) < 1e-6:
        w = level
    else:
        w = (np.sqrt(1.0 - level + level * ratio) - 1.0) / (np.sqrt(ratio) - 1.0)
    total = (
        np.outer(1.0 - w, 1.0 - w) * covariance(low)
        + np.outer(w, w) * covariance(high)
        + (np.outer(1.0 - w, w) + np.outer(w, 1.0 - w)) * covariance(np.sqrt(low * high))
    )
    # white beyond the grid of lags: what single samples keep of it
    total = 0.5 * (total + total.T)
    floor = np.maximum(np.diag(total), 0.0)
    white = _white_variance(e, edges, density, w) / bins.count
    total[np.diag_indices_from(total)] = np.maximum(floor, white)
    if extra is not None:
        total += extra @ extra.T
    # rounding alone may take the smallest eigenvalue below zero
    total[np.diag_indices_from(total)] *= 1.0 + 1e-9
    return np.asarray(np.linalg.cholesky(total), dtype=float)


def _white_variance(
    e: Experiment, edges: FloatArray, density: FloatArray, w: FloatArray
) -> FloatArray:
    # variance of one sample if its spectrum were flat at the level of the highest band: a bin of
    # n samples cannot do better than this over n
    top = 0.5 / e.interval
    band = min(max(int(np.searchsorted(edges, top)) - 2, 0), density.shape[1] - 1)
    root: FloatArray = (1.0 - w) * np.sqrt(density[0, band]) + w * np.sqrt(density[1, band])
    return 0.5 * root**2 * top


def _density_at(f: FloatArray, edges: FloatArray, density: FloatArray, shape: Shape) -> FloatArray:
    """One-sided density (n_f,) V^2/Hz, in log frequency between the bands' centres.

    Below the first band it grows as 1/f as far as the first band exceeds those at .5-4 Hz, by at
    most a factor of nine, or as noise of this ``shape`` does, where that is more.
    """
    centre = np.sqrt(edges[:-1] * edges[1:])
    logs = np.log(np.maximum(f, 1e-12))
    made = np.exp(np.interp(logs, np.log(centre), np.log(density)))
    low = f < edges[0]
    if low.any():
        mid = (centre > 0.5) & (centre < 4.0)
        above = float(density[0] - np.mean(density[mid])) if mid.any() else 0.0
        lowest = 0.5 * f[1] if len(f) > 1 else 1e-9  # the constant stands for half a spacing
        grow = np.clip(edges[0] / np.maximum(f[low], lowest) - 1.0, 0.0, 8.0)
        made[low] = density[0] + max(above, 0.0) * grow
        as_shaped = shape(np.maximum(f[low], lowest)) / shape(centre[:1])
        made[low] = np.maximum(made[low], density[0] * as_shaped)
    return made
