"""Noise of the simulated rig: sums of processes that are each drawn by their own recursion."""

from __future__ import annotations

from math import exp, pi, sqrt

import numpy as np
from scipy.signal import lfilter

from bayes_sensor.campaign import CampaignError, FloatArray
from bayes_sensor.reality.records import Component, NoiseLaw

OPEN_LAWS = ("ar1", "white", "ar1_slow", "arma", "pink")
"""laws for every run; ``ar1`` and ``white`` are within the package's own noise model"""
RESERVE_LAWS = ("band_limited", "oscillating", "telegraph")
"""kept out of every run but the last"""


def draw_law(name: str, rng: np.random.Generator, sigma: float) -> NoiseLaw:
    """A law of one kind with correlations and sizes of its own; ``sigma`` (V) is its total rms.

    Between a fifth and all of the variance at the highest concentration is there at zero
    concentration, too.
    """
    quiet = rng.uniform(0.2, 1.0)
    sigma0, sigma1 = sigma * sqrt(quiet), sigma * sqrt(1.0 - quiet)
    short = exp(rng.uniform(np.log(5e-4), np.log(2e-2)))  # s
    share = exp(rng.uniform(np.log(0.004), np.log(0.03)))
    octaves = 2.0 ** np.arange(-6, 8)  # s
    parts = {
        "white": (Component(1.0),),
        "ar1": (Component(1.0, short),),
        "ar1_slow": (
            Component(1.0 - share, short),
            Component(share, exp(rng.uniform(np.log(0.4), np.log(2.5)))),
        ),
        "arma": (
            Component(0.35 + 0.3 * share, exp(rng.uniform(np.log(0.01), np.log(0.08)))),
            Component(0.65 - 0.3 * share),
        ),
        "pink": (
            Component(1.0 - share, short),
            *(Component(share / len(octaves), float(time)) for time in octaves),
        ),
        "band_limited": (Component(1.0, 2.0 * short, shape="smooth"),),
        "oscillating": (
            Component(1.0 - 5.0 * share, short),
            Component(5.0 * share, rng.uniform(0.05, 0.4), rng.uniform(2.0, 12.0)),
        ),
        "telegraph": (
            Component(1.0 - share, short),
            Component(share, exp(rng.uniform(np.log(0.1), np.log(3.0))), shape="telegraph"),
        ),
    }
    if name not in parts:
        raise CampaignError(f"noise law: expected one of {', '.join(parts)}, got '{name}'")
    return NoiseLaw(name, sigma0, sigma1, parts[name])


def autocorrelation(law: NoiseLaw, n: int, interval: float) -> FloatArray:
    """(n,) autocorrelation of the noise at lags 0, 1, .. n - 1 samples."""
    lags = np.arange(n) * interval
    total = np.zeros(n)
    for part in law.components:
        if part.time == 0.0:
            total[0] += part.share
            continue
        own = np.exp(-lags / part.time)
        if part.shape == "smooth":
            own *= 1.0 + lags / part.time
        elif part.frequency:
            own *= np.cos(2.0 * pi * part.frequency * lags)
        total += part.share * own
    return total


def draw_noise(
    law: NoiseLaw,
    n: int,
    interval: float,
    rng: np.random.Generator,
    tails: tuple[float, float] = (0.0, 1.0),
) -> FloatArray:
    """(n,) one stretch of unit variance.

    ``tails`` = (p, k): a share p of the first component's innovations is k times as large, all
    scaled back to unit variance.
    """
    total = np.zeros(n)
    for i, part in enumerate(law.components):
        own = _draw_part(part, n, interval, rng, tails if i == 0 else (0.0, 1.0))
        total += sqrt(part.share) * own
    return total


def _innovations(n: int, rng: np.random.Generator, tails: tuple[float, float]) -> FloatArray:
    e = rng.standard_normal(n)
    p, k = tails
    if p > 0:
        e = np.where(rng.random(n) < p, k * e, e) / sqrt(1.0 - p + p * k**2)
    return e


def _draw_part(
    part: Component, n: int, interval: float, rng: np.random.Generator, tails: tuple[float, float]
) -> FloatArray:
    if part.time == 0.0:
        return _innovations(n, rng, tails)
    decay = exp(-interval / part.time)
    if part.shape == "telegraph":
        flips = rng.random(n) < 0.5 * (1.0 - decay)
        return np.where((np.cumsum(flips) + rng.integers(2)) % 2 == 0, 1.0, -1.0)
    if part.shape == "smooth":
        # exact sampling of the critically damped process (x, v): x'' = -2 x'/T - x/T^2 + noise
        return _smooth(part.time, n, interval, rng)
    e = _innovations(n, rng, tails)
    e[1:] *= sqrt(1.0 - decay**2)
    if part.frequency == 0.0:
        return lfilter([1.0], [1.0, -decay], e)
    other = rng.standard_normal(n)
    other[1:] *= sqrt(1.0 - decay**2)
    turn = decay * np.exp(2j * pi * part.frequency * interval)
    return lfilter([1.0], [1.0, -turn], e + 1j * other).real


def _smooth(time: float, n: int, interval: float, rng: np.random.Generator) -> FloatArray:
    h = interval / time
    e = exp(-h)
    # state (x, v time): x(h) = e [(1 + h) x + h v], v(h) = e [-h x + (1 - h) v]; unit variances
    step = e * np.array([[1.0 + h, h], [-h, 1.0 - h]])
    added = np.linalg.cholesky(np.eye(2) - step @ step.T + 1e-15 * np.eye(2))
    kicks = added @ rng.standard_normal((2, n))
    start = rng.standard_normal(2)
    # x_i - 2 e x_(i-1) + e^2 x_(i-2) = kicks seen through the first row of step
    drive = np.empty(n)
    drive[0] = start[0]
    if n > 1:
        second = step @ start + kicks[:, 1]
        drive[1] = second[0] - 2.0 * e * start[0]
        drive[2:] = kicks[0, 2:] - step[1, 1] * kicks[0, 1:-1] + step[0, 1] * kicks[1, 1:-1]
    return lfilter([1.0], [1.0, -2.0 * e, e * e], drive)
