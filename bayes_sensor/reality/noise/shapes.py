"""What correlations and processes of one shape have in common: the constants of a component."""

from __future__ import annotations

from math import cos, exp, pi, sqrt

import numpy as np
from scipy.special import erfc, gamma, kv

from bayes_sensor.campaign import FloatArray
from bayes_sensor.reality.records import Component


def gusts(part: Component) -> tuple[float, float]:
    """Standard deviations where it is loud and where it is not."""
    return sqrt(1.0 + part.depth), sqrt(1.0 - part.depth)


def paces(part: Component) -> tuple[float, float, float]:
    """(mean of both rates, half their difference, changes to the other one) per s."""
    slow, quick = 1.0 / part.time, 1.0 / (part.depth * part.time)
    return 0.5 * (quick + slow), 0.5 * (quick - slow), 0.5 / part.gust_time


def train_shares(part: Component) -> tuple[float, float]:
    """Of the variance: of pulses on their own, and of their coming together."""
    together = 0.5 * part.depth * part.time / (part.time + part.gust_time)
    return 1.0 / (1.0 + together), together / (1.0 + together)


def antipersistent(H: float, n: int) -> FloatArray:
    """(n,) autocorrelation of the steps of fractional Brownian motion, a sample each.

    Their spectrum goes as f^(1 - 2 ``H``) (Mandelbrot and Van Ness, SIAM Rev. 10, 422, 1968).
    """
    k = np.arange(n, dtype=float)
    R: FloatArray = 0.5 * ((k + 1.0) ** (2.0 * H) + np.abs(k - 1.0) ** (2.0 * H)) - k ** (2.0 * H)
    return R


def bubbling_covariance(rate: float, lags: FloatArray) -> FloatArray:
    """Of unit pulses that die out and come ``rate`` in a time; lags in units of that.

    Waits of two exponential stages: after one the next is missing, rate (1 - exp(-4 rate lag)) is
    how densely others come (Cox and Lewis, The Statistical Analysis of Series of Events, 1966).
    """
    gap = 4.0 * rate
    missing = (gap * np.exp(-lags) - np.exp(-gap * lags)) / (gap**2 - 1.0)
    return np.asarray(0.5 * rate * np.exp(-lags) - rate**2 * missing)


def clipped_variance(level: float) -> float:
    """Of a unit Gaussian that is cut off at ``level``, up and down."""
    beyond, density = erfc(level / sqrt(2.0)), exp(-0.5 * level**2) / sqrt(2.0 * pi)
    return float(1.0 - beyond - 2.0 * level * density + level**2 * beyond)


def echo_variance(part: Component) -> float:
    """Of a process of unit variance together with its echo."""
    return 1.0 + part.depth**2 + 2.0 * part.depth * exp(-1.0 / (part.frequency * part.time))


def von_karman(lags: FloatArray) -> FloatArray:
    """Autocorrelation of a turbulent stream's fluctuations along it; lags in units of ``time``.

    2^(2/3)/Gamma(1/3) l^(1/3) K_1/3(l), with the spectrum (1 + (2 pi f)^2)^(-5/6) (von Karman,
    Proc. Natl. Acad. Sci. 34, 530, 1948).
    """
    total = np.ones_like(lags)
    later = lags > 0
    total[later] = 2.0 ** (2.0 / 3.0) / gamma(1.0 / 3.0) * np.cbrt(lags[later])
    total[later] *= kv(1.0 / 3.0, lags[later])
    return total


def coupling_time(part: Component) -> float:
    """s of the capacitor; the noise itself is always faster."""
    return max(1.0 / (2.0 * pi * part.frequency), 1.5 * part.time)


def all_pass(part: Component, interval: float) -> tuple[list[float], list[float]]:
    """Coefficients (3,) above and below of a filter that turns ``frequency`` by half a turn.

    It lets all frequencies pass; how soon it forgets is ``time``.
    """
    r2 = exp(-2.0 * interval / part.time)
    middle = -(1.0 + r2) * cos(2.0 * pi * part.frequency * interval)
    return [r2, middle, 1.0], [1.0, middle, r2]
