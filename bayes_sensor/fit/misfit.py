"""Misfit: residuals of the fit against the noise of quiet stretches, measured without the model.

A record is quiet before its command, at the settled end of its plateau and at the settled end of
its fall.  The noise there is split by time scale: half the mean square of the difference of
neighbouring averages over m samples, the Allan variance A(m) (Allan 1966, Proc. IEEE 54, 221).
Taken at m = 1, 2, 4 .. it adds up to the variance of N samples about their mean, whatever the
correlation, since the Haar transform keeps sums of squares::

    V(N) = 1/2 sum over j of A(2^j),    j = 0 .. log2(N) - 1

This makes a short quiet stretch and a long record comparable. Up to a quarter of the stretch A is
measured. Beyond that, it is extrapolated by the power of m of the longest measured scales: A falls
as 1/m for white noise and is constant for 1/f noise.

The misfit is the RMS of the residuals over the RMS that this noise predicts for the same samples.
The noise at the baseline and that under gas are mixed in proportion to x3. The misfit is None where
chance, or noise that grows towards longer scales than the quiet stretches show, may bring it above
:data:`TOLERATED`.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from math import ceil, log, sqrt

import numpy as np
from scipy.ndimage import median_filter
from scipy.special import fdtri, polygamma, psi

from bayes_sensor.campaign import Experiment, FloatArray
from bayes_sensor.fit.first_estimates import Look
from bayes_sensor.likelihood.problem import Problem

TOLERATED = 1.5
"""RMS of the residuals over that of the noise, above which the fit does not describe the record"""
CHANCE = 0.02
"""probability of a warning from noise alone, in all experiments of a campaign together"""
SPARE = 4
"""averages that a stretch must hold at the longest scale measured in it"""
FEWEST = 12
"""samples of a quiet stretch"""
SHARES = (1.0, 0.5, 0.25, 0.125)
"""shares of a stretch, from its end back: the longest quiet part is used"""
STILL = 0.05
"""probability that a stretch of 1/f noise is taken for one with a drift"""
LONGEST = 3
"""number of the longest measured scales from which the growth towards longer ones is estimated"""
GROWTH = (-0.5, 1.0)
"""mean and sd of d ln A / d ln m before anything is measured: white noise has -1, 1/f noise 0"""
STANDARD_ERRORS = 1.5
"""by which A may grow faster towards longer scales than estimated, before a misfit counts"""
SPIKE = 8.0
"""robust standard deviations between a spike and the median of the samples around it"""
MOST_NAMES = 5
"""experiments that a warning names"""
FINEST = 1e-5
"""share of a record's range; smaller misfits do not count (simulations without noise)"""


@dataclass(frozen=True)
class Misfit:
    """The residuals of one experiment against the noise of its quiet stretches."""

    rms: float
    """V, of the residuals without single spikes"""
    noise: float | None = None
    """V, RMS of the noise of the quiet stretches over the same samples; None where there is no
    quiet stretch"""
    baseline: float | None = None
    """V, the same without test gas"""
    ratio: float | None = None
    """rms over noise; None where it cannot be told"""


@dataclass(frozen=True)
class NoiseScales:
    """Noise by time scale."""

    a: FloatArray
    """(n_scales,) V^2, Allan variance of averages over 1, 2, 4 .. samples"""
    dof: FloatArray
    """(n_scales,) degrees of freedom of each"""

    def scaled(self, factor: float) -> NoiseScales:
        """The same with a variance ``factor`` times as large."""
        return NoiseScales(factor * self.a, self.dof)


def scales_of(y: FloatArray, rounding: float = 0.0) -> NoiseScales:
    """Noise of a stretch of samples ``y`` (n,) in V about its straight line.

    ``rounding``, V^2: variance that a converter adds to every sample. A stretch within one of its
    steps does not show it.
    """
    m = 2 ** np.arange(int(np.log2(len(y) / SPARE)) + 1)
    total = _sums(y)
    a = np.array([0.5 * float(np.mean(_differences(total, int(each)) ** 2)) for each in m])
    averages = len(y) / m
    # the straight line takes a fifth of A where there are four averages (white .1, 1/f .26)
    a /= 1.0 - 0.2 * (SPARE / averages) ** 2
    # overlapping averages of white noise have this many (nearly so for 1/f noise, too)
    return NoiseScales(a + rounding / m, 2.0 / 3.0 * (averages - 1.0))


def _sums(y: FloatArray) -> FloatArray:
    """(n + 1,) cumulative sums of ``y`` (n,) about its straight line."""
    time = np.arange(len(y)) - 0.5 * (len(y) - 1)
    y = y - y.mean()
    return np.concatenate([[0.0], np.cumsum(y - time * (time @ y) / (time @ time))])


def _differences(total: FloatArray, m: int) -> FloatArray:
    """Differences of neighbouring averages over ``m`` samples, from their sums ``total``."""
    start = np.arange(0, len(total) - 2 * m, max(m // 8, 1))
    d: FloatArray = (total[start + 2 * m] - 2.0 * total[start + m] + total[start]) / m
    return d


def is_still(y: FloatArray, rounding: float) -> bool:
    """Whether a stretch ``y`` (n,) is noise alone, without step or curvature.

    Compares A at the longest scale with A at a quarter of it, from the median of the squares, which
    a step within the stretch does not change. The ratio is a quarter for white noise, one for 1/f
    noise and sixteen for a smooth curve.
    """
    found = scales_of(y, rounding)
    fine = max(len(found.a) - 3, 0)
    middle = float(np.median(_differences(_sums(y), 2**fine) ** 2))
    usual = 0.5 * middle / 0.4549 + rounding / 2**fine  # the median of chi-squared with 1 dof
    # a median of squares is worth .37 of as many means
    most = float(fdtri(found.dof[-1], 0.37 * found.dof[fine], 1.0 - STILL))
    return bool(found.a[-1] <= most * usual)


def quiet_end(y: FloatArray, shares: Sequence[float], rounding: float) -> NoiseScales | None:
    """Noise of the longest of the ``shares`` of ``y`` (n,), from its end back, that is still."""
    for share in shares:
        part = y[len(y) - int(share * len(y)) :]
        if len(part) >= FEWEST and is_still(part, rounding):
            return scales_of(part, rounding)
    return None


def together(parts: Sequence[NoiseScales]) -> NoiseScales:
    """Noise of several stretches, each with the weight of its degrees of freedom."""
    n = max(len(part.a) for part in parts)
    dof, weighted = np.zeros(n), np.zeros(n)
    for part in parts:
        dof[: len(part.a)] += part.dof
        weighted[: len(part.a)] += part.dof * part.a
    return NoiseScales(weighted / dof, dof)


def lengthened(short: NoiseScales, long: NoiseScales) -> NoiseScales:
    """``short`` with the longer scales of ``long``, scaled to agree at the common ones."""
    n = len(short.a)
    if len(long.a) <= n:
        return short
    weight = 1.0 / (1.0 / short.dof + 1.0 / long.dof[:n])
    level = float(np.exp(weight @ np.log(short.a / long.a[:n]) / weight.sum()))
    dof = 1.0 / (1.0 / long.dof[n:] + 1.0 / weight.sum())
    return NoiseScales(
        np.concatenate([short.a, level * long.a[n:]]), np.concatenate([short.dof, dof])
    )


@dataclass(frozen=True)
class Variance:
    """Variance of n samples of noise about their mean."""

    value: float
    """V^2"""
    dof: float
    """degrees of freedom of the stretches it was predicted from"""
    own: float
    """degrees of freedom of n samples of such noise"""


def variance(scales: NoiseScales, n: int, cautious: bool) -> Variance:
    """V(n), from the scales measured and their continuation ``level * m^growth`` to longer ones.

    The growth is estimated from the :data:`LONGEST` scales measured, with :data:`GROWTH` as prior.
    It is kept between white and 1/f noise or, ``cautious``, between 1/f noise and a random walk
    after two standard errors were added.
    """
    n_seen, octaves = len(scales.a), float(np.log2(max(n, 2)))
    last = np.arange(max(n_seen - LONGEST, 0), n_seen)
    half = scales.dof[last] / 2.0
    log_a = np.log(scales.a[last]) - psi(half) + np.log(half)  # of a chi-squared variable
    weight = 1.0 / polygamma(1, half)
    design = np.stack([np.ones(len(last)), log(2.0) * (last - n_seen + 1)], axis=1)
    prior = np.array([0.0, GROWTH[1] ** -2])
    cov = np.linalg.inv(design.T * weight @ design + np.diag(prior))
    level, growth = cov @ (design.T * weight @ log_a + prior * GROWTH[0])
    if cautious:
        growth = min(max(growth + STANDARD_ERRORS * sqrt(cov[1, 1]), 0.0), 1.0)
    else:
        growth = min(max(growth, -1.0), 0.0)

    scale = np.arange(ceil(octaves))
    a = np.exp(level + growth * log(2.0) * (scale - n_seen + 1))
    seen = min(n_seen, len(scale))
    a[:seen] = scales.a[:seen]
    share = 0.5 * np.minimum(octaves - scale, 1.0) * a
    value = float(share.sum())
    error = float(np.sum(share[:seen] ** 2 / scales.dof[:seen]))
    error += float(share[seen:].sum() ** 2) / (2.0 / cov[0, 0])  # dof of the level: var ln = 2/dof
    own = 2.0 / 3.0 * np.maximum(n / 2.0**scale - 1.0, 1.0)
    return Variance(value, value**2 / error, value**2 / float(np.sum(share**2 / own)))


def quiet_stretches(e: Experiment, look: Look) -> tuple[NoiseScales | None, NoiseScales | None]:
    """Noise of one record without and with test gas; None where no stretch is quiet.

    If the plateau drifts, its shortest scales give the level of its noise, and the baseline gives
    the longer scales.
    """
    y = e.values[e.used]
    if np.ptp(y) == 0.0:
        return None, None
    smallest = rounding_step(y) ** 2 / 12.0 + (FINEST * float(np.ptp(y))) ** 2
    y = without_spikes(y, sqrt(smallest))
    at = np.searchsorted(e.t[e.used], [until(e, look), look.start_by, look.off, look.end_by])
    before, under, after = y[: at[0]], y[at[1] : at[2]], y[at[3] :]
    found = [quiet_end(before, SHARES, smallest)]
    if e.has_fall:
        found.append(quiet_end(after, SHARES[1:], smallest))
    known = [part for part in found if part is not None]
    gas = quiet_end(under, SHARES[1:], smallest)
    if not known:
        return gas, gas
    base = together(known)
    if gas is not None:
        return lengthened(base, gas), lengthened(gas, base)
    end = under[len(under) // 2 :]
    if min(len(before), len(end)) < FEWEST:
        return base, base
    return base, base.scaled(jitter(end, smallest) / jitter(before, smallest))


def until(e: Experiment, look: Look) -> float:
    """s, when the baseline ends: at the command or, where none is known, before the rise seen."""
    if e.commanded_on is not None:
        return look.on
    return look.start_by - 1.5 * (look.rise or 0.0)


def rounding_step(y: FloatArray) -> float:
    """V, the least difference of two samples: the step of a converter, or nearly zero."""
    steps = np.diff(np.unique(y))
    steps = steps[steps > 1e-9 * float(np.ptp(y))]  # what is less is rounding of the computer
    return float(steps.min()) if len(steps) else 0.0


def jitter(y: FloatArray, smallest: float) -> float:
    """V^2, from the median square of the second differences of ``y``, which drifts do not
    affect."""
    return float(np.median(np.diff(y, 2) ** 2)) + smallest


def without_spikes(y: FloatArray, smallest: float) -> FloatArray:
    """``y`` (n,) with isolated outliers replaced by the median of five samples around them."""
    middle: FloatArray = median_filter(y, 5, mode="nearest")
    away = np.abs(y - middle)
    spread = max(1.4826 * float(np.median(away)), smallest)
    return np.where(away > SPIKE * spread, middle, y)


def misfits(
    problem: Problem, residuals: Sequence[tuple[FloatArray, FloatArray]], looks: Sequence[Look]
) -> dict[str, Misfit]:
    """The misfit of every experiment by name.

    ``residuals``: of every experiment r (n_t,) in V and x3 (n_t,).
    """
    chance = CHANCE / len(looks)
    return {
        e.name: misfit_of(e, look, r[e.used], x[e.used], chance)
        for e, look, (r, x) in zip(problem.campaign, looks, residuals, strict=True)
    }


def misfit_of(e: Experiment, look: Look, r: FloatArray, x: FloatArray, chance: float) -> Misfit:
    """The misfit of one experiment with residuals ``r`` and response ``x`` (n_samples,).

    A ratio above :data:`TOLERATED` is given only if the noise that agrees with the quiet stretches
    reaches it with a probability below ``chance``.
    """
    square = float(np.mean(without_spikes(r, 0.0) ** 2))
    base, gas = quiet_stretches(e, look)
    if base is None or gas is None:
        return Misfit(sqrt(square))
    share = float(np.clip(x, 0.0, 1.0).mean())
    usual, most = (
        mixed(variance(base, len(r), cautious), variance(gas, len(r), cautious), share)
        for cautious in (False, True)
    )
    # the ratio of two mean squares of such noise follows an F law
    by_chance = most.value * float(fdtri(most.own, most.dof, 1.0 - chance))
    told = square <= TOLERATED**2 * usual.value or square > TOLERATED**2 * by_chance
    return Misfit(
        sqrt(square),
        sqrt(usual.value),
        sqrt(variance(base, len(r), False).value),
        sqrt(square / usual.value) if told else None,
    )


def mixed(base: Variance, gas: Variance, share: float) -> Variance:
    """The variance of a record of which ``share`` is under gas."""
    parts = (1.0 - share) * base.value, share * gas.value
    value = sum(parts)
    return Variance(
        value,
        value / (parts[0] / base.dof + parts[1] / gas.dof),
        value / (parts[0] / base.own + parts[1] / gas.own),
    )


def overall(problem: Problem, found: Mapping[str, Misfit]) -> tuple[float | None, float | None]:
    """Noise without gas in V, and misfit, of a campaign; None where no experiment has them.

    The first is the root mean square over the samples of all experiments with quiet stretches, the
    second the ratio of two such, over those with a ratio.
    """

    def squares(chosen: list[tuple[int, float]]) -> float:
        return sum(n * value**2 for n, value in chosen)

    each = [(e.n_samples, found[e.name]) for e in problem.campaign]
    quiet = [(n, m.baseline) for n, m in each if m.baseline is not None]
    told = [(n, m.rms, m.rms / m.ratio) for n, m in each if m.ratio]
    noise = sqrt(squares(quiet) / sum(n for n, _ in quiet)) if quiet else None
    if not told:
        return noise, None
    missed, left = (squares([(row[0], row[i]) for row in told]) for i in (1, 2))
    return noise, sqrt(missed / left)


def warning(found: Mapping[str, Misfit], unit: str) -> str:
    """Sentence: experiments with a misfit, its size, and what to check; else empty."""
    missed = {
        name: misfit.ratio
        for name, misfit in found.items()
        if misfit.ratio is not None and misfit.ratio > TOLERATED
    }
    if not missed:
        return ""
    names = sorted(missed, key=lambda name: -missed[name])
    worst = found[names[0]]
    listed = ", ".join(f"'{name}'" for name in names[:MOST_NAMES])
    if len(names) > MOST_NAMES:
        listed += f" and {len(names) - MOST_NAMES} more"
    several = len(names) > 1
    return (
        f"Experiment{'s' if several else ''} {listed}: the fit misses the record by "
        f"{'up to ' if several else ''}{missed[names[0]]:.3g} times its noise "
        f"(RMS {worst.rms:.3g} {unit}; quiet stretches {worst.noise:.3g} {unit}), so the time "
        "constants and their intervals are not to be trusted: several steps in the record? several "
        "sensors in one campaign? a readout that is not proportional (resistance, logarithm)? a "
        "slow recovery? a drift or a jump of the level?"
    )
