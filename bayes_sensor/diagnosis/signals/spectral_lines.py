"""Lines in the spectrum: the mains', a pump's, a thermostat's, and how much of them is explained.

Bins average a line away, so that each kind has a test of its own on the periodograms of quiet
stretches or of whole records, and the mains a closed fraction of their own.
"""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numba import njit
from numpy.typing import NDArray
from scipy.optimize import minimize_scalar
from scipy.signal import windows
from scipy.special import logsumexp
from scipy.stats import gamma

from bayes_sensor.campaign import Campaign, FloatArray
from bayes_sensor.diagnosis.closure import VISIBLE, Closure
from bayes_sensor.diagnosis.data.noise_floor import Stretch, detrended
from bayes_sensor.diagnosis.signals.tails_and_converter import FOUND, FullRate, any_of

MAINS = (50.0, 60.0)
"""Hz"""
HARMONICS = 9
"""of the mains that are looked at"""
SIDE = 3.0
"""native resolutions around a line that hold its power"""
EDGE = 2.0
"""times the level around from which that of one side alone is taken"""
LEVEL_ERROR = 0.25
"""relative, of the level that 20 resolutions of one record give"""
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
FASTEST_SWING = 1.0
"""Hz; whole records are looked at below, where stretches are too short"""
SWING_BLOCK = 0.05
"""s, means over which swings are looked for"""
HIGHEST_LINE = 0.498
"""of the sampling rate; closer to half of it an ordinate is neither complex nor real"""
FOLDED = 2.0
"""native resolutions from half the sampling rate within which an ordinate counts as real"""
UNTOLD = 0.1
"""of the larger eigenvalue, below which samples do not tell a sine's other phase"""
TAKING_TURNS = 0.05
"""prior share of the line at half the sampling rate itself, where two converters take turns"""
ALL_HARMONICS = 20
"""of the mains that are no sign of bursts"""
BURSTS = (0.2, 5.0)
"""Hz; how often the mains may come and go"""
LEAKED = 0.1
"""of the noise's power; what a window may leave of the mains where their bursts are looked for"""
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


def look_for_mains(
    campaign: Campaign, residuals: Sequence[FloatArray], deviations: Sequence[FloatArray]
) -> list[FullRate]:
    """The mains in ``residuals`` (n_t,) V of whole records, over which they keep their phase.

    ``deviations`` (n_t,) V: of the noise.
    """
    return _look_for_lines(pieces_of_records(campaign, residuals, deviations), "mains_pickup")


def look_for_bursts(
    campaign: Campaign,
    residuals: Sequence[FloatArray],
    deviations: Sequence[FloatArray],
    mains: FullRate,
) -> list[FullRate]:
    """Whether the ``mains`` that were found come and go, as a heater's do that is fired in bursts.

    Whatever comes and goes has a line as far above the mains as below: as in :func:`look_for_mains`
    for every distance, of both together, averaged with the weight 1/distance.  Empty where no mains
    were found or records are too short.
    """
    if mains.probability < FOUND:
        return []
    return _bursts(pieces_of_records(campaign, residuals, deviations))


def _bursts(pieces: Sequence[Piece]) -> list[FullRate]:
    used, n, f = _transformed(pieces)
    total, _ = _sum_over_pieces(used, n)
    near, nominal, _ = mains_bands(f, used[0].interval)
    k = len(used)
    at = int(np.argmax(np.where(near, total, 0.0)))
    seconds = max(len(p.samples) for p in used) * used[0].interval
    least = max(2.0 / seconds, _leaks(float(total[at]) / k / LEAKED, seconds))
    first = max(BURSTS[0], FEWEST_CYCLES / seconds, least)
    away = np.arange(int(np.ceil(first / f[1])), int(BURSTS[1] / f[1]) + 1)
    away = away[away < at]
    below, above = at - away, at + away
    above = np.where(above < len(f), above, 2 * (len(f) - 1) - above)  # folded at half the rate
    rate = 1.0 / used[0].interval
    harmonics = _harmonics(float(f[at]), float(nominal[at]), rate)
    clear = [np.abs(f[there, None] - harmonics) > least for there in (below, above)]
    seen = np.all(clear[0] & clear[1], axis=1)
    away, below, above = away[seen], below[seen], above[seen]
    if not len(away):
        return []
    apart = np.abs(above - below) * f[1] * seconds > 1.0  # where they fold onto each other, one
    # one alone would be another line
    power = np.where(apart, 2.0 * np.minimum(total[below], total[above]), total[below])
    count = k * (1 + apart)
    each = _log_b(power, count)
    weight = (1.0 / away) / np.sum(1.0 / away)
    value, most = float(logsumexp(each, b=weight)), int(np.argmax(each + np.log(weight)))
    return [FullRate("bursts", value, {"bursts_Hz": float(f[away[most]])}, None)]


def _harmonics(found: float, nominal: float, rate: float) -> FloatArray:
    """Hz (n,) where the mains and their harmonics fold at half the sampling ``rate`` Hz.

    ``found``: Hz of the line that is at ``nominal`` Hz where the mains are at 50 or 60 Hz.
    """
    turns = round(nominal / rate)
    line = rate * turns + (found if nominal >= rate * turns else -found)
    made = [line * h / round(nominal / m) for m in MAINS for h in range(1, ALL_HARMONICS + 1)
            if nominal % m == 0.0]  # fmt: skip
    true = np.array(made)
    folded: FloatArray = np.abs(true - rate * np.round(true / rate))
    return folded


def look_for_lines(campaign: Campaign, stretches: Sequence[Stretch]) -> list[FullRate]:
    """A line in all quiet stretches, or (a pump's, a controller's) in the plateaus alone."""
    pieces = _pieces_of_stretches(campaign, stretches)
    everywhere = _look_for_lines(pieces, "line")
    plateaus = _look_for_lines([p for p in pieces if p.group == 1], "line")
    if not everywhere or not plateaus:
        return everywhere or plateaus
    return [any_of([everywhere[0], plateaus[0]])]


def look_for_swings(
    campaign: Campaign, residuals: Sequence[FloatArray], deviations: Sequence[FloatArray]
) -> list[FullRate]:
    """A slow line (a thermostat's, a pressure controller's) in what an explanation leaves.

    ``residuals`` (n_t,) V and ``deviations`` (n_t,) V of whole records: a quiet stretch holds too
    few cycles of it, and counts them as its floor.
    """
    found = []
    for piece in pieces_of_records(campaign, residuals, deviations):
        size = max(1, round(SWING_BLOCK / piece.interval))
        n = len(piece.samples) // size
        samples, weights = (
            v[: n * size].reshape(n, size).mean(axis=1) for v in (piece.samples, piece.weights)
        )
        found.append(replace(piece, samples=samples, weights=weights,
                             interval=size * piece.interval))  # fmt: skip
    return _look_for_lines(found, "swing")


def _pieces_of_stretches(campaign: Campaign, stretches: Sequence[Stretch]) -> list[Piece]:
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


def _look_for_lines(pieces: Sequence[Piece], name: str) -> list[FullRate]:
    """The mains, a swing, or any other line, from the periodograms of all pieces together.

    A line of any phase makes a periodogram ordinate, exponential under noise, ``1 + c`` times as
    large on average; ``ln B(f) = ln mean_c exp(sum_k [P_k c/(1 + c) - ln(1 + c)])``, averaged over
    frequency with the weight 1/max(f, 1 Hz).
    """
    if not pieces:
        return []
    used, n, f = _transformed(pieces)
    if not used:
        return []
    common, longest = used[0].interval, max(len(p.samples) for p in used)
    total, per_volt = _sum_over_pieces(used, n, sloping=name == "swing")
    k = len(used)
    mains = name == "mains_pickup"
    near, nominal, closeness = mains_bands(f, common)
    if not mains and near.any() and (leak := float(total[near].max()) / k) > LOUD:
        near = mains_bands(f, common, min(_leaks(leak, longest * common), FARTHEST))[0]
    where = (near if mains else ~near) & (f >= FEWEST_CYCLES / (longest * common))
    real = np.ones(len(f))
    if mains:  # may fold onto half the rate itself, as 50 Hz do at 100 samples a second
        real[f > 0.5 / common - FOLDED / (longest * common)] = 0.5
    else:
        where &= f <= HIGHEST_LINE / common
    where &= f <= FASTEST_SWING if name == "swing" else f >= LOWEST_LINE
    if not where.any():
        return []
    # the grid keeps its frequency within a few hundredths of a hertz; fundamentals come first
    weight = np.zeros(len(f))
    weight[where] = closeness[where] if mains else 1.0 / np.maximum(f[where], 1.0)
    weight /= weight.sum()
    if name == "line" and not near[-1]:  # every other sample: a real ordinate, at half the rate
        weight *= 1.0 - TAKING_TURNS
        weight[-1], real[-1] = TAKING_TURNS, 0.5
        where[-1] = True
    log_b = _log_b(real * total, real * k)
    weighted = log_b[where] + np.log(weight[where])
    value = float(logsumexp(weighted))
    peak = np.flatnonzero(where)[int(np.argmax(weighted))]
    excess = max(float(total[peak]) - k, 0.0)
    # a line of amplitude A gives |sum w y|^2 = A^2 (sum w)^2 / 4, and all of it at half the rate
    halves = 2.0 * float(real[peak])
    amplitude = halves * np.sqrt(excess / per_volt[peak])
    frequency = nominal[peak] if mains else f[peak]
    short = name.removesuffix("_pickup")
    strength = {f"{short}_V": float(amplitude), f"{short}_Hz": float(frequency)}
    return [FullRate(name, value, strength, float(np.sqrt(halves * excess)))]


def _log_b(power: FloatArray, count: FloatArray) -> FloatArray:
    """ln B (n_f,) of a line, from sums (n_f,) of ``count`` ordinates over the noise level."""
    c = np.array(RATIOS)[:, None]
    each = power * c / (1.0 + c) - count * np.log1p(c)
    return np.asarray(logsumexp(each, axis=0) - np.log(len(c)))


def _leaks(ratio: float, seconds: float) -> float:
    """Hz away from a line of so many times the noise's power where it leaks no more than that.

    A window of ``seconds`` spreads a line r resolutions away to at most 1/(pi r)^2 of its power.
    """
    return float(np.sqrt(ratio) / (np.pi * seconds))


def _transformed(pieces: Sequence[Piece]) -> tuple[list[Piece], int, FloatArray]:
    """Pieces of the commonest interval, samples to pad them to, and the ordinates' Hz (n_f,)."""
    common = float(np.median([p.interval for p in pieces]))
    used = [p for p in pieces if abs(p.interval - common) < 1e-9 * common]
    longest = max((len(p.samples) for p in used), default=1)
    n = 1 << int(np.ceil(np.log2(2 * longest)))  # twice: a line between two ordinates is seen
    return used, n, np.asarray(np.fft.rfftfreq(n, common), dtype=float)


def _sum_over_pieces(
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
    for p, power, level in _levels(used, n, sloping):
        total += power / level
        per_volt += float(np.sum(p.weights)) ** 2 / np.maximum(level, 1e-280)
    return total, per_volt


def _levels(
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
    """The median; of very many, of some of them."""
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


@njit(cache=True)
def _medians(
    power: FloatArray, centres: FloatArray, halves: FloatArray
) -> FloatArray:  # pragma: no cover
    # (n_centres,) of the power around each centre, to half a width on both sides
    found = np.empty(len(centres))
    for i in range(len(centres)):
        centre, half = centres[i], halves[i]
        low, high = int(max(centre - half, 1.0)), int(min(centre + half, float(len(power)))) + 1
        window = power[low:high]
        step = max(1, len(window) // 400)
        middle = np.median(window[::step])
        # where a filter cuts the noise off, the louder side is no line above the quieter one
        louder = 0.0
        at = int(centre) - low
        for side in (window[:at], window[at:]):
            if len(side) > 0.5 * half:
                louder = max(louder, np.median(side))
        found[i] = louder if louder > EDGE * middle else middle
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


# --------------------------------------------------------------------------- how far


def mains_closure(pieces: Sequence[Piece], found: FullRate) -> tuple[Closure, float | None]:
    """The closed fraction of the line's power with its 95 % interval, and the held-out fraction.

    ``pieces`` are whole records, ``found`` the mains as the test at full rate reports them.  In
    sample a sine with the record's own amplitude and phase is taken off every record; held out,
    the sine of one half of the record is taken off the other, unless half a record does not tell
    its phase.  The interval is that of exponential ordinates around their expectation.
    """
    n = 1 << int(np.ceil(np.log2(max(len(p.samples) for p in pieces))))
    levels = _levels(pieces, n)
    pieces = [p for p, _, _ in levels]
    level = [
        (np.asarray(np.fft.rfftfreq(n, p.interval)), usual / float(np.sum(p.weights**2)))
        for p, _, usual in levels
    ]
    frequency = _sharpened(pieces, level, found.strength["mains_Hz"])
    order = next(
        k for k in range(1, HARMONICS + 1) for m in MAINS if found.strength["mains_Hz"] == k * m
    )
    harmonics = frequency / order * np.arange(1.0, HARMONICS + 1.0)
    before, after = np.zeros(2), np.zeros(2)
    amplitudes, apart, noise, told = [], [], [], True
    for p, own in zip(pieces, level, strict=True):
        t = np.arange(len(p.samples), dtype=float) * p.interval
        a = _fitted_sine(p, t, frequency, own).amplitude
        amplitudes.append(abs(a))
        sine = a.real * np.cos(2.0 * np.pi * frequency * t)
        sine -= a.imag * np.sin(2.0 * np.pi * frequency * t)
        before += _power_near(p, p.samples, own, harmonics)
        after += _power_near(p, p.samples - sine, own, harmonics)
        half = len(t) // 2
        one, two = (
            _fitted_sine(
                replace(p, samples=p.samples[s], weights=p.weights[s]), t[s], frequency, own
            )
            for s in (slice(0, half), slice(half, None))
        )
        uncertain = one.variance + two.variance
        apart.append(2.0 * (abs(one.amplitude - two.amplitude) ** 2 - uncertain))
        noise.append(abs(one.amplitude) ** 2 + abs(two.amplitude) ** 2 - uncertain)
        told = told and one.told and two.told
    volts = float(np.sqrt(np.mean(np.square(amplitudes)) / 2.0))
    excess, spread = before[0], float(np.sqrt(before[1]))
    d = [float(np.sqrt(max(2.0 * x, 0.0))) for x in (before[0], after[0])]
    if excess <= VISIBLE * spread:
        return Closure(None, None, None, volts, 0.0, d[0], d[1]), None
    fraction = 1.0 - after[0] / excess
    # an ordinate of the line varies by sqrt(2 P) besides what noise alone leaves
    of_line = 2.0 * excess
    # and the level is a median over at least 20 resolutions of all records together
    of_level = (before[1] * LEVEL_ERROR) ** 2 / len(pieces)
    sd = np.sqrt(after[1] + of_level + (1.0 - fraction) ** 2 * (before[1] + of_line)) / excess
    known = told and np.sum(noise) > 0
    out = 1.0 - float(np.sum(apart)) / float(np.sum(noise)) if known else None
    left = volts * float(np.sqrt(max(1.0 - fraction, 0.0)))
    low, high = float(fraction - 1.96 * sd), float(fraction + 1.96 * sd)
    return Closure(float(fraction), low, high, volts, left, d[0], d[1]), out


@dataclass(frozen=True)
class _Sine:
    """Re(A exp(2 pi i f t)) fitted to samples."""

    amplitude: complex
    """A in V; the smallest that explains the samples where they do not tell its phase"""
    variance: float
    """V^2, of A under noise"""
    power: float
    """what it explains, over the mean of that under noise"""
    told: bool = True
    """whether the samples tell A's phase"""


def _fitted_sine(
    p: Piece, t: FloatArray, frequency: float, level: tuple[FloatArray, FloatArray]
) -> _Sine:
    """The sine of a ``frequency`` Hz that comes nearest to the samples at ``t`` (n,) s.

    Where the line folds onto half the sampling rate, sine and cosine are not orthogonal there.
    """
    w = p.weights
    rate = 1.0 / p.interval
    folded = abs(frequency - rate * round(frequency / rate))
    density = float(np.interp(folded, *level))
    if folded <= 0.5 * rate - FOLDED / (len(t) * p.interval):
        total = float(np.sum(w))
        a = 2.0 * complex(np.sum(w * p.samples * np.exp(-2j * np.pi * frequency * t))) / total
        # the level is that of |sum w y e|^2 for the whole record: scaled to these samples
        variance = 4.0 * density * float(np.sum(w**2)) / total**2
        return _Sine(a, variance, abs(a) ** 2 / variance)
    angle = 2.0 * np.pi * frequency * t
    X = np.column_stack([np.cos(angle), -np.sin(angle)])
    seen = X.T @ (w * p.samples)
    noise = density * (X.T @ (w[:, None] ** 2 * X))
    normal = X.T @ (w[:, None] * X)
    solve = np.linalg.pinv(normal, rcond=UNTOLD, hermitian=True)
    real, imaginary = solve @ seen
    per_noise = np.linalg.pinv(noise, rcond=UNTOLD, hermitian=True)
    return _Sine(
        complex(real, imaginary),
        float(np.trace(solve @ noise @ solve)),
        0.5 * float(seen @ per_noise @ seen),
        bool(np.linalg.cond(normal) < 1.0 / UNTOLD),
    )


def _power_near(
    p: Piece, samples: FloatArray, level: tuple[FloatArray, FloatArray], lines: FloatArray
) -> FloatArray:
    """(2,) excess of the periodogram over the level around ``lines`` (n,) Hz, and its variance."""
    f = np.asarray(np.fft.rfftfreq(len(samples), p.interval), dtype=float)
    rate = 1.0 / p.interval
    folded = np.abs(lines - rate * np.rint(lines / rate))
    folded = folded[folded > LOWEST_LINE]
    reach = SIDE / (len(samples) * p.interval)
    near = np.any(np.abs(np.subtract.outer(f, folded)) <= reach, axis=1)
    power = np.abs(np.fft.rfft(samples * p.weights)[near]) ** 2
    usual = np.interp(f[near], *level) * float(np.sum(p.weights**2))
    return np.array([float(np.sum(power / usual - 1.0)), float(np.count_nonzero(near))])


def _sharpened(
    pieces: Sequence[Piece], level: Sequence[tuple[FloatArray, FloatArray]], nominal: float
) -> float:
    """Hz, the frequency near the nominal one where all records together are largest."""
    longest = max(len(p.samples) * p.interval for p in pieces)

    def less(frequency: float) -> float:
        total = 0.0
        for p, own in zip(pieces, level, strict=True):
            t = np.arange(len(p.samples), dtype=float) * p.interval
            total -= _fitted_sine(p, t, frequency, own).power
        return total

    grid = nominal + np.arange(-0.15, 0.15, 0.4 / longest)
    best = float(grid[int(np.argmin([less(float(f)) for f in grid]))])
    step = 0.5 / longest
    made = minimize_scalar(less, bounds=(best - step, best + step), method="bounded")
    return float(made.x)
