"""Periodograms of records and of quiet stretches, their noise level, and a search for a line.

Bins average a line away, so that lines are looked for in the samples.  The noise level around
every ordinate is estimated so that neither a line nor a slope of the spectrum moves it.
"""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.signal import windows
from scipy.special import logsumexp
from scipy.stats import gamma

from bayes_sensor.campaign import Campaign, FloatArray
from bayes_sensor.diagnosis.data.quiet_stretches import Stretch, detrended
from bayes_sensor.diagnosis.signals.signal import Finding, Signal

MAINS = (50.0, 60.0)
"""Hz"""
HARMONICS = 9
"""of the mains that are looked at"""
EDGE = 2.0
"""times the level around from which that of one side alone is taken"""
NEAR_MAINS = 0.15
"""Hz; a line this close to the mains or a harmonic is the mains"""
LOUD, FARTHEST = 10.0, 2.0
"""power over the noise's from which the mains are expected to leak, and Hz to which at most"""
MAINS_SPREAD = 0.05
"""Hz; spread of the mains' frequency, and of a harmonic's in proportion"""
LOWEST_LINE = 0.2
"""Hz; below, a spectrum's own slope looks like a line"""
FEWEST_CYCLES = 6.0
"""of a line in the longest stretch"""
HIGHEST_LINE = 0.498
"""of the sampling rate; closer to half of it an ordinate is neither complex nor real"""
FOLDED = 2.0
"""native resolutions from half the sampling rate within which an ordinate counts as real"""
TAKING_TURNS = 0.05
"""prior share of the line at half the sampling rate itself, where two converters take turns"""
BAND = 40.0
"""native resolutions, or half its frequency, in which a spectrum has a level of its own"""
STEEPEST = 2.0
"""power of the frequency with which one spectrum leaves another below the lowest band"""
FARTHEST_APART = 20.0
"""ln of the usual level over that of a record without noise, which has no shape to tell"""
SMALL_ERROR = 0.01
"""variance of a band's ln level below which bands count alike"""
APART = 3.0
"""standard errors from which the spectra of pieces are taken to differ"""
RATIOS = (1.0, 2.5, 6.0, 15.0, 40.0)
"""a line's plausible power over the noise's, per stretch and resolution"""


@dataclass(frozen=True, eq=False)
class Piece:
    """Samples in which a line keeps its phase."""

    samples: FloatArray
    """(n,) V"""
    weights: FloatArray
    """(n,) of every sample in the transform"""
    interval: float
    """s"""
    group: int
    """pieces of one group share a spectral shape"""
    record: int = 0
    """number of the experiment that it is part of"""


@dataclass(frozen=True)
class LineSearch:
    """What kind of line is looked for, and where."""

    signal: Signal
    prefix: str
    """of the names of its strengths"""
    of_the_mains: bool = False
    """whether at the mains and their harmonics only; everywhere else otherwise"""
    slowest: float = 0.0
    """Hz"""
    fastest: float = np.inf
    """Hz"""
    sloping: bool = False
    """whether a smooth slope of the spectrum is taken out first"""
    at_half_rate: bool = False
    """whether at half the sampling rate itself, too"""


def pieces_of_records(
    campaign: Campaign, residuals: Sequence[FloatArray], deviations: Sequence[FloatArray]
) -> list[Piece]:
    """Whole records without gaps, weighted by the ``deviations`` (n_t,) V of their noise."""
    found = []
    for k, (e, r, d) in enumerate(zip(campaign, residuals, deviations, strict=True)):
        for a, b in e.runs:
            if b - a >= 512:
                samples = np.where(e.used[a:b], r[a:b], 0.0)
                # the weights of least squares: less where the noise is larger
                weights = windows.tukey(b - a, 0.05) * (np.min(d) / d[a:b]) ** 2 * e.used[a:b]
                found.append(Piece(detrended(samples, 4), weights, e.interval, 0, k))
    return found


def pieces_of_stretches(campaign: Campaign, stretches: Sequence[Stretch]) -> list[Piece]:
    return [
        Piece(
            detrended(s.samples, 4),
            windows.tukey(len(s.samples), 0.2),
            campaign.experiments[s.experiment].interval,
            s.level,
        )
        for s in stretches
        if len(s.samples) >= 512
    ]


def find_line(pieces: Sequence[Piece], search: LineSearch) -> list[Finding]:
    """The clearest line of a kind, from the periodograms of all pieces together.

    A line of any phase makes a periodogram ordinate, exponential under noise, ``1 + c`` times as
    large on average; ``ln B(f) = ln mean_c exp(sum_k [P_k c/(1 + c) - ln(1 + c)])``, averaged over
    frequency with the weight 1/max(f, 1 Hz).
    """
    if not pieces:
        return []
    used, n, f = commonest(pieces)
    if not used:
        return []
    common, longest = used[0].interval, max(len(p.samples) for p in used)
    total, per_volt = sum_over_pieces(used, n, search.sloping)
    k = len(used)
    mains = search.of_the_mains
    near, nominal, closeness = mains_bands(f, common)
    if not mains and near.any() and (leak := float(total[near].max()) / k) > LOUD:
        near = mains_bands(f, common, min(leakage_reach(leak, longest * common), FARTHEST))[0]
    where = (near if mains else ~near) & (f >= FEWEST_CYCLES / (longest * common))
    real = np.ones(len(f))
    if mains:  # may fold onto half the rate itself, as 50 Hz do at 100 samples a second
        real[f > 0.5 / common - FOLDED / (longest * common)] = 0.5
    else:
        where &= f <= HIGHEST_LINE / common
    where &= (f >= search.slowest) & (f <= search.fastest)
    if not where.any():
        return []
    # the grid keeps its frequency within a few hundredths of a hertz; fundamentals come first
    weight = np.zeros(len(f))
    weight[where] = closeness[where] if mains else 1.0 / np.maximum(f[where], 1.0)
    weight /= weight.sum()
    if (
        search.at_half_rate and not near[-1]
    ):  # every other sample: a real ordinate, at half the rate
        weight *= 1.0 - TAKING_TURNS
        weight[-1], real[-1] = TAKING_TURNS, 0.5
        where[-1] = True
    log_b = log_bayes_factors(real * total, real * k)
    weighted = log_b[where] + np.log(weight[where])
    value = float(logsumexp(weighted))
    peak = np.flatnonzero(where)[int(np.argmax(weighted))]
    excess = max(float(total[peak]) - k, 0.0)
    # a line of amplitude A gives |sum w y|^2 = A^2 (sum w)^2 / 4, and all of it at half the rate
    halves = 2.0 * float(real[peak])
    amplitude = halves * np.sqrt(excess / per_volt[peak])
    frequency = nominal[peak] if mains else f[peak]
    strength = {f"{search.prefix}_V": float(amplitude), f"{search.prefix}_Hz": float(frequency)}
    return [Finding(search.signal, value, strength, float(np.sqrt(halves * excess)))]


def log_bayes_factors(power: FloatArray, count: FloatArray) -> FloatArray:
    """ln B (n_f,) of a line, from sums (n_f,) of ``count`` ordinates over the noise level."""
    c = np.array(RATIOS)[:, None]
    each = power * c / (1.0 + c) - count * np.log1p(c)
    return np.asarray(logsumexp(each, axis=0) - np.log(len(c)))


def leakage_reach(ratio: float, seconds: float) -> float:
    """Hz away from a line of so many times the noise's power where it leaks no more than that.

    A window of ``seconds`` spreads a line r resolutions away to at most 1/(pi r)^2 of its power.
    """
    return float(np.sqrt(ratio) / (np.pi * seconds))


def commonest(pieces: Sequence[Piece]) -> tuple[list[Piece], int, FloatArray]:
    """Pieces of the commonest interval, samples to pad them to, and the ordinates' Hz (n_f,)."""
    common = float(np.median([p.interval for p in pieces]))
    used = [p for p in pieces if abs(p.interval - common) < 1e-9 * common]
    longest = max((len(p.samples) for p in used), default=1)
    n = 1 << int(np.ceil(np.log2(2 * longest)))  # twice: a line between two ordinates is seen
    return used, n, np.asarray(np.fft.rfftfreq(n, common), dtype=float)


def sum_over_pieces(
    used: Sequence[Piece], n: int, sloping: bool = False
) -> tuple[FloatArray, FloatArray]:
    """Sums over pieces of ordinates (n/2 + 1,) over the noise level, and of what 1 V^2 adds there.

    The level's shape is pooled over a group: one piece alone has too few ordinates at low
    frequencies for the ratio to be exponential; what is smooth is its own (:func:`own_shapes`).
    ``sloping``: a smooth slope of the spectrum is
    taken out first, which matters where the lowest frequencies are looked at.
    """
    total = np.zeros(n // 2 + 1)
    per_volt = np.zeros(n // 2 + 1)
    for p, power, level in noise_levels(used, n, sloping):
        total += power / level
        per_volt += float(np.sum(p.weights)) ** 2 / np.maximum(level, 1e-280)
    return total, per_volt


def noise_levels(
    used: Sequence[Piece], n: int, sloping: bool = False
) -> list[tuple[Piece, FloatArray, FloatArray]]:
    """Every piece with its periodogram (n/2 + 1,) and the noise level of that."""
    found = []
    for which in sorted({p.group for p in used}):
        group = [p for p in used if p.group == which]
        powers = [np.abs(np.fft.rfft(p.samples * p.weights, n)) ** 2 for p in group]
        scales = [float(np.mean(power[1:])) or 1e-300 for power in powers]
        resolution = n / float(np.median([len(p.samples) for p in group]))
        mean = np.mean([power / own for power, own in zip(powers, scales, strict=True)], axis=0)
        slope = _slope(mean, resolution) if sloping else np.ones(len(mean))
        level = slope * _local_level(mean / slope, resolution, len(group))
        levels = [own * level for own in scales]
        ratios = [(power / own)[None, :] for power, own in zip(powers, levels, strict=True)]
        shapes = own_shapes(ratios, [n / len(p.samples) for p in group], BAND)
        found += [
            (p, power, own * shape)
            for p, power, own, shape in zip(group, powers, levels, shapes, strict=True)
        ]
    return found


def own_shapes(
    ratios: Sequence[FloatArray], resolutions: Sequence[float], least: float
) -> list[FloatArray]:
    """How far each spectrum lies from what is usual, (n_f,) one a member, smooth in frequency.

    ``ratios``: of every member (n_periodograms, n_f), to what is usual; ``resolutions``: ordinates
    in the native resolution of each.  Noise whose memory differs from record to record (a filter
    that was turned between them) would else have lines where some are louder than the others.
    Medians of bands, which no line moves, ``least`` native resolutions or half their frequency
    wide, joined in ln f, as far as they vary by more than chance; all one where they do not.
    """
    n_f, usual = ratios[0].shape[1], float(np.median(resolutions))
    edges = [usual]
    while edges[-1] < n_f:
        edges.append(max(1.5 * edges[-1], edges[-1] + least * usual))
    bands = [(int(a), min(int(b), n_f)) for a, b in itertools.pairwise(edges)]
    # the last one may be cut short
    bands = [(a, b) for a, b in bands if b - a >= 0.5 * least * usual]
    if not bands or len(ratios) < 2:
        return [np.ones(n_f) for _ in ratios]
    logs = np.array([[np.log(_middle(r[:, a:b]) / np.log(2.0)) for a, b in bands] for r in ratios])
    logs = np.where(logs < -FARTHEST_APART, 0.0, logs)  # a record may be without noise
    count = np.array([
        [len(r) * (b - a) / own for a, b in bands]
        for r, own in zip(ratios, resolutions, strict=True)
    ])  # fmt: skip
    # of the median of so many exponential ordinates
    error = 1.0 / (np.log(2.0) ** 2 * count)
    weight = (error + SMALL_ERROR) ** -2.0  # else the many ordinates of high frequencies decide
    spread = float(np.average(logs**2 - error, weights=weight))
    if spread < APART * float(np.sqrt(2.0 * np.sum((weight * error) ** 2)) / weight.sum()):
        return [np.ones(n_f) for _ in ratios]
    logs *= spread / (spread + error)
    centres = np.log([0.5 * (a + b) for a, b in bands])
    at = np.log(np.maximum(np.arange(n_f), 0.5 * usual))
    shapes = []
    for own in logs:
        shape = np.interp(at, centres, own)
        if len(bands) > 1:
            slope = (own[1] - own[0]) / (centres[1] - centres[0])
            slope = min(max(slope, -STEEPEST), STEEPEST)
            shape += slope * np.minimum(at - centres[0], 0.0)
        shapes.append(np.exp(shape))
    return shapes


def _middle(values: FloatArray) -> float:
    """The median, of every so many values where there are thousands."""
    flat = values.ravel()
    return max(float(np.median(flat[:: 1 + len(flat) // 4000])), 1e-300)


def _slope(power: FloatArray, per_resolution: float) -> FloatArray:
    """(n_f,) parabola in ln f through ln ``power``; medians of bands, so that no line bends it.

    Bands are at least four native resolutions wide and a quarter of their frequency.
    """
    edges = [0.5 * per_resolution]
    while edges[-1] < len(power):
        edges.append(max(edges[-1] * 1.25, edges[-1] + 4.0 * per_resolution))
    middles, medians, weights = [], [], []
    for low, high in itertools.pairwise(edges):
        band = power[max(int(low), 1) : int(high)]
        if len(band) > per_resolution:
            middles.append(np.log(0.5 * (low + high)))
            medians.append(np.log(max(float(np.median(band)), 1e-300)))
            weights.append(np.sqrt(min(len(band) / per_resolution, 40.0)))
    if len(middles) < 4:
        return np.ones(len(power))
    parabola = np.polynomial.Polynomial.fit(middles, medians, 2, w=weights)
    at = np.clip(np.log(np.maximum(np.arange(len(power)), 0.5)), middles[0], middles[-1])
    return np.asarray(np.exp(parabola(at)))


def _local_level(power: FloatArray, per_resolution: float, k: int) -> FloatArray:
    """The noise level (n_f,) around every ordinate, blind to lines and to a spectrum's slope.

    ``power``: mean of ``k`` periodograms.  The level is the median over a window of 20 to 80
    native resolutions, a tenth of the frequency in between, over that of a gamma law: resonances
    of the noise, and the ripples that an echo makes in its spectrum, are wider and are no lines.
    """
    index = np.arange(len(power), dtype=float)

    def half_width(centre: float) -> float:
        return per_resolution * min(max(0.05 * centre / per_resolution, 10.0), 40.0)

    centres = [1.0]
    while centres[-1] < len(power):
        centres.append(centres[-1] + 0.4 * half_width(centres[-1]))
    levels = _medians(power, np.array(centres), np.array([half_width(c) for c in centres]))
    levels /= float(gamma.median(k) / k)
    smooth = np.interp(
        np.log(np.maximum(index, 0.5)), np.log(centres), np.log(np.maximum(levels, 1e-300))
    )
    expected: FloatArray = np.maximum(np.exp(smooth), 1e-300)
    return expected


def _medians(power: FloatArray, centres: FloatArray, halves: FloatArray) -> FloatArray:
    # (n_centres,) of the power around each centre, to half a width on both sides
    low = np.maximum(centres - halves, 1.0).astype(int)
    high = np.minimum((centres + halves).astype(int) + 1, len(power))
    middle = _median_of_each(power, low, high, most=400)
    # where a filter cuts the noise off, the louder side is no line above the quieter one
    louder = np.zeros(len(centres))
    at = np.minimum(centres.astype(int), high)
    for first, last in ((low, at), (at, high)):
        long = last - first > 0.5 * halves
        louder[long] = np.maximum(louder[long], _median_of_each(power, first[long], last[long]))
    return np.where(louder > EDGE * middle, louder, middle)


def _median_of_each(
    values: FloatArray, first: NDArray[np.int64], last: NDArray[np.int64], most: int | None = None
) -> FloatArray:
    """(n_windows,) medians of ``values[first:last]``, of about ``most`` values of each window."""
    found = np.empty(len(first))
    for length in np.unique(last - first):  # windows of one length at once
        rows = last - first == length
        step = max(1, length // most) if most else 1
        at = first[rows, None] + np.arange(0, length, step)
        found[rows] = np.median(values[at], axis=1)
    return found


def mains_bands(
    f: FloatArray, interval: float, wider: float = 0.0
) -> tuple[NDArray[np.bool_], FloatArray, FloatArray]:
    """Whether a frequency is the mains' or a harmonic's, folded at half the sampling rate.

    Also the line's own frequency, and how plausible each frequency is.  ``wider`` Hz: as blurred.
    """
    near = np.zeros(len(f), dtype=bool)
    nominal = np.zeros(len(f))
    closeness = np.full(len(f), 1e-300)
    rate = 1.0 / interval
    # the lowest line that folds to a frequency is the likeliest there
    lines = sorted(
        (harmonic * mains, harmonic) for mains in MAINS for harmonic in range(1, HARMONICS + 1)
    )
    for true, harmonic in lines:
        if true > max(0.5 * rate, 10.0 * MAINS[1]):
            break
        folded = abs(true - rate * round(true / rate))
        if folded < LOWEST_LINE:
            continue
        close = (np.abs(f - folded) < NEAR_MAINS * harmonic**0.5 + wider) & ~near
        nominal[close] = true
        away = (f[close] - folded) / (MAINS_SPREAD * harmonic)
        closeness[close] = np.exp(-0.5 * away**2) / harmonic**3
        near |= close
    return near, nominal, np.maximum(closeness, 1e-300)
