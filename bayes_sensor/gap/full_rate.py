"""Causes that bins cannot show: lines, heavy tails and the converter's steps, at full rate.

They leave the mean over a bin alone (or nearly so) and act on single samples; each has a test of
its own on the quiet stretches, and each adds its probability to whatever explains the mean.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import uniform_filter1d
from scipy.signal import lfilter, windows
from scipy.special import gammaln, logsumexp
from scipy.stats import gamma

from bayes_sensor.campaign import Campaign, FloatArray
from bayes_sensor.gap.floor import Stretch, detrended, lattice_step

MAINS = (50.0, 60.0)
"""Hz"""
NEAR_MAINS = 0.15
"""Hz; a line this close to the mains or a harmonic is the mains"""
MAINS_SPREAD = 0.05
"""Hz; spread of the mains' frequency, and of a harmonic's in proportion"""
LOWEST_LINE = 0.2
"""Hz; below, a spectrum's own slope looks like a line"""
FEWEST_CYCLES = 6.0
"""of a line in the longest stretch"""
RATIOS = (1.0, 2.5, 6.0, 15.0, 40.0)
"""a line's plausible power over the noise's, per stretch and resolution"""
TAIL_DOF = (2.5, 3.0, 4.0, 5.0, 7.0, 10.0)
"""degrees of freedom that count as heavy tails"""
COARSE = 0.02
"""share of the sample-to-sample variance from which the converter's steps are called coarse"""
LUMPY = -25.0
"""ln Bayes factor of coarse steps from which the test of tails spreads the samples"""
COARSE_OF_ALL = 0.001
"""share of the noise's whole variance below which the steps do not matter, fine as they may look"""
TOO_COARSE = 1.0
"""steps over the innovations' standard deviation from which tails cannot be told"""
PRIOR = {
    "mains_pickup": 0.03, "heavy_tails": 0.03, "quantisation": 0.03,
    "line": 0.02, "event": 0.025, "patch": 0.025, "break": 0.025, "ringing": 0.01,
}  # fmt: skip
AROUND = 400
"""samples over which the size of the innovations is taken"""
HARDLY_CROSSED = 0.7
"""steps over the noise's standard deviation from which it hardly crosses them"""
UNITS = {
    "mains_V": "V", "mains_Hz": "Hz", "adc_step": "V", "tail_dof": "1", "line_V": "V",
    "line_Hz": "Hz", "ringing_Hz": "Hz", "patch_s": "s", "break_s": "s", "event_s": "s",
}  # fmt: skip
"""of the strengths that are found here"""
OF_UNLISTED_ORIGIN = ("line", "event", "patch", "break", "ringing")
"""findings that have no name in the catalogue"""


@dataclass(frozen=True)
class FullRate:
    """What the samples themselves say."""

    name: str
    """an effect's name, or one of :data:`OF_UNLISTED_ORIGIN`"""
    log_bayes_factor: float
    strength: dict[str, float]
    d: float | None
    """detectability where there is a signature in the mean, else None"""

    @property
    def probability(self) -> float:
        """Given its prior, whatever explains the rest."""
        prior = PRIOR[self.name]
        odds = np.log(prior / (1.0 - prior)) + self.log_bayes_factor
        return float(1.0 / (1.0 + np.exp(-np.clip(odds, -60.0, 60.0))))


def look_at_full_rate(
    campaign: Campaign,
    stretches: Sequence[Stretch],
    raw: Sequence[Stretch],
    residuals: Sequence[FloatArray],
    deviations: Sequence[FloatArray],
) -> list[FullRate]:
    """Mains, other lines, tails and quantisation.

    ``raw`` still has its spikes; ``residuals`` (n_t,) V and ``deviations`` (n_t,) V of the noise
    are those of whole records, over which the mains keep their phase.
    """
    coarse = look_for_steps(campaign, stretches)
    # on a coarse lattice the innovations are lumps, not tails: spread them over the step again
    step = coarse.strength["adc_step"] if coarse.log_bayes_factor > LUMPY else 0.0
    found = [look_at_tails(raw, step), coarse]
    if rounds_away(stretches, coarse.strength["adc_step"]):
        return found
    return [
        *_look_for_lines(_pieces_of_records(campaign, residuals, deviations), mains=True),
        *_other_lines(_pieces_of_stretches(campaign, stretches)),
        *found,
    ]


def _other_lines(pieces: Sequence[Piece]) -> list[FullRate]:
    """A line in all quiet stretches, or (a pump's, a controller's) in the plateaus alone."""
    everywhere = _look_for_lines(pieces, mains=False)
    plateaus = _look_for_lines([p for p in pieces if p.group == 1], mains=False)
    if not everywhere or not plateaus:
        return everywhere or plateaus
    both = (everywhere[0], plateaus[0])
    value = float(logsumexp([f.log_bayes_factor for f in both]) - np.log(2.0))
    clearer = max(both, key=lambda f: f.log_bayes_factor)
    return [replace(clearer, log_bayes_factor=value)]


def rounds_away(stretches: Sequence[Stretch], step: float) -> bool:
    """Whether the converter's step V is so coarse that the noise hardly crosses it.

    Rounding then makes lines, plateaus and jumps of its own.
    """
    spreads = [float(np.std(s.samples)) for s in stretches]
    return bool(spreads) and step > HARDLY_CROSSED * min(spreads)


# --------------------------------------------------------------------------- lines


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


def _pieces_of_records(
    campaign: Campaign, residuals: Sequence[FloatArray], deviations: Sequence[FloatArray]
) -> list[Piece]:
    found = []
    for e, r, d in zip(campaign, residuals, deviations, strict=True):
        for a, b in e.runs:
            if b - a >= 512:
                samples = np.where(e.used[a:b], r[a:b], 0.0)
                # the weights of least squares: less where the noise is larger
                weights = windows.tukey(b - a, 0.05) * (np.min(d) / d[a:b]) ** 2 * e.used[a:b]
                found.append(Piece(detrended(samples, 4), weights, e.interval, 0))
    return found


def _look_for_lines(pieces: Sequence[Piece], mains: bool) -> list[FullRate]:
    """The mains, or any other line, from the periodograms of all pieces together.

    A line of any phase makes a periodogram ordinate, exponential under noise, ``1 + c`` times as
    large on average; ``ln B(f) = ln mean_c exp(sum_k [P_k c/(1 + c) - ln(1 + c)])``, averaged over
    frequency with the weight 1/max(f, 1 Hz).
    """
    if not pieces:
        return []
    common = float(np.median([p.interval for p in pieces]))
    used = [p for p in pieces if abs(p.interval - common) < 1e-9 * common]
    if not used:
        return []
    longest = max(len(p.samples) for p in used)
    n = 1 << int(np.ceil(np.log2(longest)))
    f = np.asarray(np.fft.rfftfreq(n, common), dtype=float)
    total, level_sum = _sum_over_pieces(used, n)
    k = len(used)
    c = np.array(RATIOS)[:, None]
    log_b = logsumexp(total * c / (1.0 + c) - k * np.log1p(c), axis=0) - np.log(len(RATIOS))
    lowest = max(LOWEST_LINE, FEWEST_CYCLES / (longest * common))
    near, nominal, closeness = _mains_bands(f, common)
    where = (near if mains else ~near) & (f >= lowest) & (f <= 0.498 / common)
    if not where.any():
        return []
    # the grid keeps its frequency within a few hundredths of a hertz; fundamentals come first
    weight = closeness[where] if mains else 1.0 / np.maximum(f[where], 1.0)
    weight /= weight.sum()
    value = float(logsumexp(log_b[where] + np.log(weight)))
    peak = np.flatnonzero(where)[int(np.argmax(log_b[where]))]
    excess = max(float(total[peak]) - k, 0.0)
    # a line of amplitude A gives |sum w y|^2 = A^2 (sum w)^2 / 4
    amplitude = 2.0 * np.sqrt(excess / k * level_sum[peak] / k)
    strength = (
        {"mains_V": float(amplitude), "mains_Hz": float(nominal[peak])}
        if mains
        else {"line_V": float(amplitude), "line_Hz": float(f[peak])}
    )
    name = "mains_pickup" if mains else "line"
    return [FullRate(name, value, strength, float(np.sqrt(2.0 * excess)))]


def _sum_over_pieces(used: Sequence[Piece], n: int) -> tuple[FloatArray, FloatArray]:
    """Sums over pieces of ordinates (n/2 + 1,) over the noise level, and of squared levels.

    The level's shape is pooled over a group: one piece alone has too few ordinates at low
    frequencies for the ratio to be exponential.
    """
    total = np.zeros(n // 2 + 1)
    level_sum = np.zeros(n // 2 + 1)
    for which in {p.group for p in used}:
        group = [p for p in used if p.group == which]
        powers, sizes = [], []
        for p in group:
            power = np.abs(np.fft.rfft(p.samples * p.weights, n)) ** 2
            scale = float(np.mean(power[1:])) or 1e-300
            powers.append(power / scale)
            sizes.append(scale / float(np.sum(p.weights)) ** 2)
        k = len(group)
        resolution = n / float(np.median([len(p.samples) for p in group]))
        level = _local_level(np.mean(powers, axis=0), resolution, k)
        for power, size in zip(powers, sizes, strict=True):
            total += power / level
            level_sum += level * size
    return total, level_sum


def _local_level(power: FloatArray, per_resolution: float, k: int) -> FloatArray:
    """The noise level (n_f,) around every ordinate, blind to lines and to a spectrum's slope.

    ``power``: mean of ``k`` periodograms.  The level is the median over a window 20 native
    resolutions or a tenth of the frequency wide, over that of a gamma law: a resonance of the
    noise is wider than that and is no line.
    """
    index = np.arange(len(power), dtype=float)
    centres = [1.0]
    while centres[-1] < len(power):
        centres.append(max(centres[-1] * 1.03, centres[-1] + 4.0 * per_resolution))
    levels = []
    for centre in centres:
        half = max(0.05 * centre, 10.0 * per_resolution)
        low, high = int(max(centre - half, 1)), int(min(centre + half, len(power))) + 1
        window = power[low:high]
        step = max(1, len(window) // 400)
        levels.append(float(np.median(window[::step])) / float(gamma.median(k) / k))
    smooth = np.interp(
        np.log(np.maximum(index, 0.5)), np.log(centres), np.log(np.maximum(levels, 1e-300))
    )
    expected: FloatArray = np.maximum(np.exp(smooth), 1e-300)
    return expected


def _mains_bands(
    f: FloatArray, interval: float
) -> tuple[NDArray[np.bool_], FloatArray, FloatArray]:
    """Whether a frequency is the mains' or a harmonic's, folded at half the sampling rate.

    Also the line's own frequency, and how plausible each frequency is.
    """
    near = np.zeros(len(f), dtype=bool)
    nominal = np.zeros(len(f))
    closeness = np.full(len(f), 1e-300)
    rate = 1.0 / interval
    # the lowest line that folds to a frequency is the likeliest there
    lines = sorted((harmonic * mains, harmonic) for mains in MAINS for harmonic in range(1, 10))
    for true, harmonic in lines:
        if true > max(0.5 * rate, 10.0 * MAINS[1]):
            break
        folded = abs(true - rate * round(true / rate))
        if folded < LOWEST_LINE:
            continue
        close = (np.abs(f - folded) < NEAR_MAINS * harmonic**0.5) & ~near
        nominal[close] = true
        away = (f[close] - folded) / (MAINS_SPREAD * harmonic)
        closeness[close] = np.exp(-0.5 * away**2) / harmonic**3
        near |= close
    return near, nominal, np.maximum(closeness, 1e-300)


# --------------------------------------------------------------------------- tails


def look_at_tails(stretches: Sequence[Stretch], step: float = 0.0) -> FullRate:
    """Student-t against Gaussian innovations of an AR(4) fitted to each stretch.

    In units of their size around, so that noise that swells and fades is not taken for wild.
    ``step`` V: the samples are spread evenly over the converter's step first.
    """
    values, spreads = [], []
    rng = np.random.default_rng(1)  # the same dither in every run
    for s in stretches:
        if len(s.samples) < 200:
            continue
        samples = s.samples + step * (rng.random(len(s.samples)) - 0.5) if step else s.samples
        e = _innovations(detrended(samples), 4)
        spread = float(np.std(e))
        if spread > 0:
            width = min(AROUND, len(e))
            around = np.sqrt(uniform_filter1d(e**2, width, mode="reflect"))
            values.append(e / np.maximum(around, 1e-3 * spread))
            spreads.append(spread)
    if not values:
        return FullRate("heavy_tails", 0.0, {"tail_dof": float("inf")}, None)
    e = np.concatenate(values)
    if len(e) > 200_000:  # evenly thinned: more changes nothing
        e = e[:: len(e) // 200_000]
    n = len(e)
    gaussian = -0.5 * n * (np.log(2.0 * np.pi * np.mean(e**2)) + 1.0)
    logs, scales = [], []
    for dof in TAIL_DOF:
        log_like, scale = _t_likelihood(e, dof)
        logs.append(log_like)
        scales.append(scale)
    best = TAIL_DOF[int(np.argmax(logs))]
    value = float(logsumexp(logs) - np.log(len(logs)) - gaussian)
    if step > TOO_COARSE * float(np.median(spreads)):
        value = min(value, 0.0)
    return FullRate("heavy_tails", value, {"tail_dof": best}, None)


def _innovations(x: FloatArray, order: int) -> FloatArray:
    n = len(x)
    gamma = np.array([float(x[: n - k] @ x[k:]) / n for k in range(order + 1)])
    if gamma[0] <= 0:
        return x
    toeplitz = gamma[np.abs(np.subtract.outer(np.arange(order), np.arange(order)))]
    a = np.linalg.solve(toeplitz + 1e-9 * gamma[0] * np.eye(order), gamma[1:])
    whitened: FloatArray = lfilter(np.concatenate([[1.0], -a]), [1.0], x)
    return whitened[order:]


def _t_likelihood(e: FloatArray, dof: float) -> tuple[float, float]:
    """Largest log-likelihood of a scaled t law, and its scale (a few EM steps)."""
    square = e**2
    s2 = float(np.median(square)) / 0.5
    for _ in range(12):
        s2 = float(np.mean((dof + 1.0) * square / (dof + square / s2)))
    n = len(e)
    constant = gammaln(0.5 * (dof + 1.0)) - gammaln(0.5 * dof) - 0.5 * np.log(dof * np.pi * s2)
    return float(n * constant - 0.5 * (dof + 1.0) * np.sum(np.log1p(square / (dof * s2)))), s2


# --------------------------------------------------------------------------- the converter


def look_for_steps(campaign: Campaign, stretches: Sequence[Stretch]) -> FullRate:
    """Coarse steps: a lattice whose rounding makes up a share of the sample-to-sample variance."""
    steps = [lattice_step(e.values[e.used]) for e in campaign]
    known = [s for s in steps if s > 0]
    if not known or not stretches:
        return FullRate("quantisation", -5.0, {"adc_step": 0.0}, None)
    step = float(np.median(known))
    innovations = [float(np.var(_innovations(detrended(s.samples), 4))) for s in stretches]
    share = step**2 / 12.0 / max(float(np.median(innovations)), 1e-300)
    whole = float(np.median([np.var(s.samples) for s in stretches]))
    of_all = step**2 / 12.0 / max(whole, 1e-300)
    # the lattice itself is certain; what is judged is whether it matters
    value = 8.0 * np.log(min(share / COARSE, of_all / COARSE_OF_ALL))
    value = float(np.clip(value, -30.0, 30.0))
    return FullRate("quantisation", value, {"adc_step": step}, None)
