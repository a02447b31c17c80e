"""Causes that bins cannot show: lines, heavy tails and the converter's steps, at full rate.

They leave the mean over a bin alone (or nearly so) and act on single samples; each has a test of
its own on the quiet stretches, and each adds its probability to whatever explains the mean.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.signal import lfilter, windows
from scipy.special import gammaln, logsumexp
from scipy.stats import gamma

from bayes_sensor.campaign import Campaign, FloatArray
from bayes_sensor.gap.floor import Stretch, detrended

MAINS = (50.0, 60.0)
"""Hz"""
NEAR_MAINS = 0.15
"""Hz; a line this close to the mains or a harmonic is the mains"""
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
PRIOR = {"mains_pickup": 0.03, "heavy_tails": 0.03, "quantisation": 0.03, "line": 0.02}


@dataclass(frozen=True)
class FullRate:
    """What the samples themselves say."""

    name: str
    """an effect's name, or ``line`` for one of unlisted origin"""
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
    campaign: Campaign, stretches: Sequence[Stretch], raw: Sequence[Stretch]
) -> list[FullRate]:
    """Mains, other lines, tails and quantisation; ``raw`` still has its spikes."""
    coarse = look_for_steps(campaign, stretches)
    # on a coarse lattice the innovations are lumps, not tails: spread them over the step again
    step = coarse.strength["adc_step"] if coarse.log_bayes_factor > LUMPY else 0.0
    return [*look_for_lines(campaign, stretches), look_at_tails(raw, step), coarse]


# --------------------------------------------------------------------------- lines


def look_for_lines(campaign: Campaign, stretches: Sequence[Stretch]) -> list[FullRate]:
    """Mains and other lines from the periodograms of all stretches together.

    A line of any phase makes a periodogram ordinate, exponential under noise, ``1 + c`` times as
    large on average; ``ln B(f) = ln mean_c exp(sum_k [P_k c/(1 + c) - ln(1 + c)])``, averaged over
    frequency with the weight 1/max(f, 1 Hz).
    """
    intervals = [campaign.experiments[s.experiment].interval for s in stretches]
    common = float(np.median(intervals)) if intervals else 1.0
    used = [
        s for s, h in zip(stretches, intervals, strict=True)
        if abs(h - common) < 1e-9 * common and len(s.samples) >= 512
    ]  # fmt: skip
    if not used:
        return []
    longest = max(len(s.samples) for s in used)
    n = 1 << int(np.ceil(np.log2(longest)))
    f = np.asarray(np.fft.rfftfreq(n, common), dtype=float)
    total, level_sum = _sum_over_stretches(used, n)
    k = len(used)
    c = np.array(RATIOS)[:, None]
    log_b = logsumexp(total * c / (1.0 + c) - k * np.log1p(c), axis=0) - np.log(len(RATIOS))
    lowest = max(LOWEST_LINE, FEWEST_CYCLES / (longest * common))
    sane = (f >= lowest) & (f <= 0.498 / common)
    near, nominal = _mains_bands(f, common)
    found = []
    for name, where in (("mains_pickup", near & sane), ("line", ~near & sane)):
        if not where.any():
            continue
        weight = 1.0 / np.maximum(f[where], 1.0)
        weight /= weight.sum()
        value = float(logsumexp(log_b[where] + np.log(weight)))
        peak = np.flatnonzero(where)[int(np.argmax(log_b[where]))]
        excess = max(float(total[peak]) - k, 0.0)
        # a line of amplitude A gives |sum w y|^2 = A^2 (sum w)^2 / 4
        amplitude = 2.0 * np.sqrt(excess / k * level_sum[peak] / k)
        strength = (
            {"mains_V": float(amplitude), "mains_Hz": float(nominal[peak])}
            if name == "mains_pickup"
            else {"line_V": float(amplitude), "line_Hz": float(f[peak])}
        )
        found.append(FullRate(name, value, strength, float(np.sqrt(2.0 * excess))))
    return found


def _sum_over_stretches(used: Sequence[Stretch], n: int) -> tuple[FloatArray, FloatArray]:
    """Sums over stretches of ordinates (n/2 + 1,) over the noise level, and of squared levels.

    The level's shape is pooled over the stretches with the same gas: one stretch alone has too
    few ordinates at low frequencies for the ratio to be exponential.
    """
    total = np.zeros(n // 2 + 1)
    level_sum = np.zeros(n // 2 + 1)
    for gas in {s.level for s in used}:
        group = [s for s in used if s.level == gas]
        powers, sizes = [], []
        for s in group:
            taper = windows.tukey(len(s.samples), 0.2)
            power = np.abs(np.fft.rfft(detrended(s.samples, 4) * taper, n)) ** 2
            scale = float(np.mean(power[1:])) or 1e-300
            powers.append(power / scale)
            sizes.append(scale / float(np.sum(taper)) ** 2)
        k = len(group)
        resolution = n / float(np.median([len(s.samples) for s in group]))
        level = _local_level(np.mean(powers, axis=0), resolution, k)
        for power, size in zip(powers, sizes, strict=True):
            total += power / level
            level_sum += level * size
    return total, level_sum


def _local_level(power: FloatArray, per_resolution: float, k: int) -> FloatArray:
    """The noise level (n_f,) around every ordinate, blind to lines and to a spectrum's slope.

    ``power``: mean of ``k`` periodograms.  The level is the median over a window that is even in
    the logarithm of the frequency, at least 16 native resolutions wide, over that of a gamma law.
    """
    index = np.arange(len(power), dtype=float)
    centres = [1.0]
    while centres[-1] < len(power):
        centres.append(max(centres[-1] * 1.12, centres[-1] + 2.0 * per_resolution))
    levels = []
    for centre in centres:
        half = max(0.4 * centre, 8.0 * per_resolution)
        low, high = int(max(centre - half * 0.8, 1)), int(min(centre + half, len(power))) + 1
        window = power[low:high]
        step = max(1, len(window) // 400)
        levels.append(float(np.median(window[::step])) / float(gamma.median(k) / k))
    smooth = np.interp(
        np.log(np.maximum(index, 0.5)), np.log(centres), np.log(np.maximum(levels, 1e-300))
    )
    return np.maximum(np.exp(smooth), 1e-300)


def _mains_bands(f: FloatArray, interval: float) -> tuple[np.ndarray, FloatArray]:
    """Whether a frequency is the mains' or a harmonic's, folded at half the sampling rate."""
    near = np.zeros(len(f), dtype=bool)
    nominal = np.zeros(len(f))
    rate = 1.0 / interval
    # the lowest line that folds to a frequency is the likeliest there
    lines = sorted((harmonic * mains, harmonic) for mains in MAINS for harmonic in range(1, 10))
    for true, harmonic in lines:
        if true > max(0.5 * rate, 10.0 * MAINS[1]):
            break
        folded = abs(true - rate * round(true / rate))
        if folded < LOWEST_LINE:
            continue
        close = np.abs(f - folded) < NEAR_MAINS * harmonic**0.5
        nominal[close & ~near] = true
        near |= close
    return near, nominal


# --------------------------------------------------------------------------- tails


def look_at_tails(stretches: Sequence[Stretch], step: float = 0.0) -> FullRate:
    """Student-t against Gaussian innovations of an AR(4) fitted to each stretch.

    ``step`` V: the samples are spread evenly over the converter's step first.
    """
    values = []
    rng = np.random.default_rng(1)  # the same dither in every run
    for s in stretches:
        if len(s.samples) < 200:
            continue
        samples = s.samples + step * (rng.random(len(s.samples)) - 0.5) if step else s.samples
        e = _innovations(detrended(samples), 4)
        spread = float(np.std(e))
        if spread > 0:
            values.append(e / spread)
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
    return FullRate("heavy_tails", value, {"tail_dof": best}, None)


def _innovations(x: FloatArray, order: int) -> FloatArray:
    n = len(x)
    gamma = np.array([float(x[: n - k] @ x[k:]) / n for k in range(order + 1)])
    if gamma[0] <= 0:
        return x
    toeplitz = gamma[np.abs(np.subtract.outer(np.arange(order), np.arange(order)))]
    a = np.linalg.solve(toeplitz + 1e-9 * gamma[0] * np.eye(order), gamma[1:])
    return lfilter(np.concatenate([[1.0], -a]), [1.0], x)[order:]


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


def lattice_step(values: FloatArray) -> float:
    """The step of the lattice that all values (n,) lie on, or 0 where they lie on none."""
    distinct = np.unique(values)
    if len(distinct) < 3 or len(distinct) > 0.5 * len(values):
        return 0.0
    gaps = np.diff(distinct)
    span = float(distinct[-1] - distinct[0])
    gaps = gaps[gaps > 1e-9 * span]
    if len(gaps) == 0:
        return 0.0
    step = float(np.min(gaps))
    # converted values carry rounding: the mean over many steps is sharper than one
    step = span / round(span / step) if span / step < 1e6 else step
    away = np.abs((distinct - distinct[0]) / step - np.rint((distinct - distinct[0]) / step))
    return step if float(np.max(away)) < 0.02 else 0.0


def look_for_steps(campaign: Campaign, stretches: Sequence[Stretch]) -> FullRate:
    """Coarse steps: a lattice whose rounding makes up a share of the sample-to-sample variance."""
    steps = [lattice_step(e.values[e.used]) for e in campaign]
    known = [s for s in steps if s > 0]
    if not known or not stretches:
        return FullRate("quantisation", -5.0, {"adc_step": 0.0}, None)
    step = float(np.median(known))
    innovations = [float(np.var(_innovations(detrended(s.samples), 4))) for s in stretches]
    share = step**2 / 12.0 / max(float(np.median(innovations)), 1e-300)
    # the lattice itself is certain; what is judged is whether it matters
    value = float(np.clip(8.0 * np.log(share / COARSE), -30.0, 30.0))
    return FullRate("quantisation", value, {"adc_step": step}, None)
