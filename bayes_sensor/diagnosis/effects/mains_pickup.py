"""The mains couple into the signal: lines at 50 or 60 Hz and their harmonics.

The gap that they make is one of power at their frequencies, not of the mean,
and has a closed fraction of its own.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.optimize import minimize_scalar

from bayes_sensor.campaign import FloatArray
from bayes_sensor.diagnosis.closed_fraction import VISIBLE, Closure
from bayes_sensor.diagnosis.effects.effect import Effect, OnNoise
from bayes_sensor.diagnosis.signals.mains import SIGNAL
from bayes_sensor.diagnosis.signals.periodograms import (
    FOLDED,
    HARMONICS,
    LOWEST_LINE,
    MAINS,
    Piece,
    noise_levels,
    pieces_of_records,
)
from bayes_sensor.diagnosis.signals.signal import Finding, Samples

SIDE = 3.0
"""native resolutions around a line that hold its power"""
LEVEL_ERROR = 0.25
"""relative, of the level that 20 resolutions of one record give"""
UNTOLD = 0.1
"""of the larger eigenvalue, below which samples do not tell a sine's other phase"""


def mains_closure(pieces: Sequence[Piece], found: Finding) -> tuple[Closure, float | None]:
    """The closed fraction of the line's power with its 95 % interval, and the held-out fraction.

    ``pieces`` are whole records, ``found`` the mains as the test at full rate reports them.  In
    sample a sine with the record's own amplitude and phase is taken off every record; held out,
    the sine of one half of the record is taken off the other, unless half a record does not tell
    its phase.  The interval is that of exponential ordinates around their expectation.
    """
    n = 1 << int(np.ceil(np.log2(max(len(p.samples) for p in pieces))))
    levels = noise_levels(pieces, n)
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


def _added(
    y: FloatArray, t: FloatArray, strength: Mapping[str, float], rng: np.random.Generator
) -> FloatArray:
    phase = rng.uniform(0.0, 2.0 * np.pi)
    sine: FloatArray = np.sin(2.0 * np.pi * strength["mains_Hz"] * t + phase)
    return y + strength["mains_V"] * sine


def _closure(samples: Samples, found: Finding) -> tuple[Closure, float | None]:
    return mains_closure(
        pieces_of_records(samples.campaign, samples.residuals, samples.deviations), found
    )


EFFECT = Effect(
    name="mains_pickup",
    family="interference",
    stage="record",
    sentence="The mains couple into the signal: {strength}.",
    plausible={"mains_V": 0.01, "mains_Hz": 50.0},
    labels={"mains_V": "amplitude", "mains_Hz": "frequency"},
    null={"mains_V": 0.0},
    reference="line spectra; Percival and Walden 1993, ch. 10",
    reveal="a battery-powered recorder, or a record without gas",
    on_noise=OnNoise(record=_added, above={"mains_Hz": 0.0}, signal=SIGNAL, closure=_closure),
)
