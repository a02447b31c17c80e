"""The autocorrelation of a law, exact or by quadrature, shape by shape."""

from __future__ import annotations

from math import exp, pi, sqrt

import numpy as np
from scipy.signal import lfilter
from scipy.special import erfc, erfcx, exp1, j0, spence

from bayes_sensor.campaign import FloatArray
from bayes_sensor.reality.noise.shapes import (
    all_pass,
    antipersistent,
    bubbling_covariance,
    clipped_variance,
    coupling_time,
    echo_variance,
    gusts,
    paces,
    train_shares,
    von_karman,
)
from bayes_sensor.reality.records import Component, NoiseLaw

MEDIAN_CORRELATION = (0.552838, 0.262352)
"""of the medians of three of white noise, a sample and two apart, by quadrature"""


def autocorrelation(law: NoiseLaw, n: int, interval: float) -> FloatArray:
    """(n,) autocorrelation of the noise at lags 0, 1, .. n - 1 samples."""
    lags = np.arange(n, dtype=float) * interval
    total = np.zeros(n)
    for part in law.components:
        if part.time == 0.0:
            total[0] += part.share
            if part.shape == "difference" and n > 1:
                total[1] -= part.share * part.depth / (1.0 + part.depth**2)
            elif part.shape == "shaped":
                total[1:3] += part.share * np.array([-4.0, 1.0])[: n - 1] / 6.0
            elif part.shape == "binomial":
                total[1:3] += part.share * np.array([4.0, 1.0])[: n - 1] / 6.0
            elif part.shape == "median":
                total[1:3] += part.share * np.array(MEDIAN_CORRELATION)[: n - 1]
            elif part.shape == "overcorrected":
                total[1:] += part.share * (-part.depth) ** np.arange(1.0, n)
            elif part.shape == "repeated":
                total[1:] += part.share * part.depth ** np.arange(1.0, n)
            elif part.shape == "chaos":
                total[1:] += part.share * (2.0 * part.depth - 1.0) ** np.arange(1.0, n)
            elif part.shape == "diffused":
                total[1:] += part.share * antipersistent(part.depth, n)[1:]
            continue
        own = np.exp(-lags / part.time)
        if part.shape == "smooth":
            own *= 1.0 + lags / part.time
        elif part.shape == "window":
            own = np.maximum(1.0 - lags / part.time, 0.0)
        elif part.shape == "gusts":
            strong, calm = gusts(part)
            mean, swing = 0.5 * (strong + calm), 0.5 * (strong - calm)
            own *= mean**2 + swing**2 * np.exp(-lags / part.gust_time)
        elif part.shape == "lognormal":
            own *= np.exp(part.depth**2 * np.expm1(-lags / part.gust_time))
        elif part.shape == "bell":
            own = np.exp(-((lags / part.time) ** 2))
        elif part.shape == "echo":
            around = np.exp(-np.abs(lags - 1.0 / part.frequency) / part.time)
            beyond = np.exp(-(lags + 1.0 / part.frequency) / part.time)
            own = (1.0 + part.depth**2) * own + part.depth * (around + beyond)
            own /= echo_variance(part)
        elif part.shape == "turbulent":
            own = von_karman(lags / part.time)
        elif part.shape == "zeroed":
            own = np.maximum(1.0 - lags / part.time, 0.0) ** 2
        elif part.shape == "pulsing":
            swell = 0.5 * part.depth**2
            own *= (1.0 + swell * np.cos(2.0 * pi * part.frequency * lags)) / (1.0 + swell)
        elif part.shape == "coupled":
            slow = coupling_time(part)
            own = (slow * own - part.time * np.exp(-lags / slow)) / (slow - part.time)
        elif part.shape == "interpolated":
            own = _hat_with_hat(lags / part.time)
        elif part.shape in ("fringes", "strokes"):
            turn = 2.0 * pi * part.frequency * lags
            own = sum(
                weight * own ** (k * k) * np.cos(k * turn)
                for k, weight in enumerate(_orders(part), start=1)
            )
        elif part.shape == "motes":
            own = _discs(lags / part.time)
        elif part.shape == "conducting":
            own = erfcx(np.sqrt(lags / part.time))
        elif part.shape == "latching":
            own *= np.cos(lags / part.time)
        elif part.shape == "stops":
            own = _stopped_correlation(lags / part.time)
        elif part.shape == "coded":
            bits = lags / part.time
            own = np.where(bits < 0.5, 1.0 - 3.0 * bits, np.minimum(bits - 1.0, 0.0))
        elif part.shape == "paces":
            own = _paced_correlation(part, lags)
        elif part.shape == "cut_off":
            own = np.sinc(lags / part.time)
        elif part.shape == "settling":
            own = (1.0 + lags / part.time) ** -part.depth
        elif part.shape == "hunting":
            swing = 2.0 * part.depth * part.frequency * part.gust_time
            own *= np.cos(2.0 * pi * part.frequency * lags)
            own *= j0(swing * np.sin(pi * lags / part.gust_time))
        elif part.shape == "beating":
            turn = 2.0 * pi * part.frequency * lags
            own *= np.cos(turn) * np.cos(part.depth * turn)
        elif part.shape == "held":
            own = np.maximum(1.0 - lags / part.time, 0.0)
        elif part.shape == "trains":
            alone, together = train_shares(part)
            train = part.gust_time * np.exp(-lags / part.gust_time) - part.time * own
            own = alone * own + together * train / (part.gust_time - part.time)
        elif part.shape == "dimmed":
            own = _dimmed_correlation(lags / part.time)
        elif part.shape == "rectified":
            own = _rectified_correlation(own)
        elif part.shape == "teeth":
            own = _toothed_correlation(part, lags)
        elif part.shape == "flapping":
            level = part.gust_time * np.exp(-lags / part.gust_time)
            own = (level - part.time * own) / (part.gust_time - part.time)
        elif part.shape == "bubbles":
            own = bubbling_covariance(part.rate, lags / part.time)
            own /= bubbling_covariance(part.rate, np.zeros(1))
        elif part.shape == "resting":
            own = _resting_correlation(lags / part.time)
        elif part.shape == "balanced":
            own *= np.exp(-lags / part.gust_time)
        elif part.shape == "crests":
            own = 1.0 - spence(own) / (pi**2 / 6.0)
        elif part.shape == "phase":
            own = _phase_correlation(own)
        elif part.shape == "restarted":
            own = _restarted_correlation(exp(-interval / part.time), n)
        elif part.shape == "dry":
            own = _dry_correlation(lags / part.time)
        elif part.shape == "larger":
            # of half their sum, and half the modulus of their difference
            own = (0.5 * own + (0.5 - 1.0 / pi) * _rectified_correlation(own)) / (1.0 - 1.0 / pi)
        elif part.shape == "clipped":
            own = _clipped_correlation(part.depth, own)
        elif part.shape == "thrice":
            own *= 1.0 + lags / part.time + (lags / part.time) ** 2 / 3.0
        elif part.shape == "fitful":
            own = (1.0 + part.gust_time / part.time) ** (-lags / part.gust_time)
        elif part.shape == "fading":
            own = spence(1.0 - own**2) / (pi**2 / 6.0)  # the dilogarithm, as logarithms' covariance
        elif part.shape == "landscape":
            own = erfcx(np.sqrt(lags / part.time))
        elif part.shape == "retuned":
            own = _retuned_correlation(part, lags)
        elif part.shape == "slowing":
            own = _slowing_correlation(part, lags)
        elif part.shape == "passing":
            own = (1.0 - 0.5 * (lags / part.time) ** 2) * np.exp(-0.25 * (lags / part.time) ** 2)
        elif part.shape == "squared":
            own = (own * np.cos(2.0 * pi * part.frequency * lags)) ** 2
        elif part.shape == "stretched":
            own = np.exp(-((lags / part.time) ** part.depth))
        elif part.shape == "chattering":
            own = 2.0 / pi * np.arcsin(own)
        elif part.shape == "diffusing":
            own = 1.0 / (1.0 + lags / part.time)
        elif part.shape == "notched":
            own = _notched_correlation(part, n, interval)
        elif part.shape == "whistling":
            # pitches between (1 - depth) and (1 + depth) times the middle one, any as likely
            own *= np.cos(2.0 * pi * part.frequency * lags)
            own *= np.sinc(2.0 * part.depth * part.frequency * lags)
        elif part.frequency:
            own *= np.cos(2.0 * pi * part.frequency * lags)
        total += part.share * own
    return total


def _stopped_correlation(lags: FloatArray) -> FloatArray:
    """Of a random walk between two stops; lags in units of its slowest mode's time."""
    total = np.zeros_like(lags)
    for k in range(1, 60, 2):
        total += 96.0 / (pi * k) ** 4 * np.exp(-(k**2) * lags)
    return total


def _paced_correlation(part: Component, lags: FloatArray) -> FloatArray:
    """Mean of exp(-(own time passed)): two states, of which the quick one forgets more."""
    mean, half, change = paces(part)
    root = sqrt(half**2 + change**2)
    late, soon = np.exp(-(mean + change - root) * lags), np.exp(-(mean + change + root) * lags)
    own: FloatArray = 0.5 * ((1.0 + change / root) * late + (1.0 - change / root) * soon)
    return own


def _dimmed_correlation(lags: FloatArray) -> FloatArray:
    """Of pulses that begin evenly and last anything up to a period; lags in periods.

    Both of two instants a < b of one period are lit in 1 - b of all cases, those of two periods in
    (1 - a)(1 - b); a is anywhere, half is the mean and a quarter the variance.
    """
    f = np.mod(lags, 1.0)
    same = np.where(lags < 1.0, 0.5 * (1.0 - f) ** 2, (1.0 - f**3) / 3.0 - 0.5 * f * (1.0 - f**2))
    return np.asarray(4.0 * (same + 0.5 * f**2 * (1.0 - f) + f**3 / 3.0) - 1.0)


def _rectified_correlation(r: FloatArray) -> FloatArray:
    """Of the modulus of Gaussian noise whose own correlation is ``r``.

    The mean of |x y| is 2/pi (sqrt(1 - r^2) + r arcsin r), of |x| it is sqrt(2/pi).
    """
    return np.asarray((np.sqrt(1.0 - r**2) + r * np.arcsin(r) - 1.0) / (0.5 * pi - 1.0))


def _toothed_correlation(part: Component, lags: FloatArray) -> FloatArray:
    """Of levels that stand for a ``time`` and come again every ``gust_time``, ``depth`` of them."""
    turn = np.floor(lags / part.gust_time)
    late = lags - turn * part.gust_time
    here = np.maximum(1.0 - late / part.time, 0.0)
    there = np.maximum(1.0 - (part.gust_time - late) / part.time, 0.0)
    return np.asarray(part.depth**turn * (here + part.depth * there))


def _resting_correlation(lags: FloatArray) -> FloatArray:
    """Of a random walk that drifts on to a stop; lags in units of its variance over drift squared.

    Abate and Whitt, Adv. Appl. Prob. 19, 560, 1987; what is beyond 80 is less than rounding.
    """
    t = np.minimum(lags, 80.0)
    root = np.sqrt(t)
    beyond, density = 0.5 * erfc(root / sqrt(2.0)), np.exp(-0.5 * t) / sqrt(2.0 * pi)
    return np.asarray(2.0 * (1.0 - 2.0 * t - t**2) * beyond + 2.0 * root * (1.0 + t) * density)


def _clipped_correlation(level: float, own: FloatArray, n_angles: int = 60) -> FloatArray:
    """Of two that are cut off at ``level`` and correlate by ``own`` (n,) before.

    The second derivative of their covariance by that is the density of both at one of the levels
    (Price, IRE Trans. Inf. Theory 4, 69, 1958), the first one at 0 the share that is within.
    """
    nodes, weights = np.polynomial.legendre.leggauss(n_angles)
    # correlations as sines of angles: the density's pole at 1 goes
    whole = np.arcsin(np.minimum(own, 1.0))
    angle = 0.5 * whole[:, None] * (nodes + 1.0)
    r = np.sin(angle)
    same, other = np.exp(-(level**2) / (1.0 + r)), np.exp(-(level**2) / np.maximum(1.0 - r, 1e-15))
    bent = (own[:, None] - r) * (same - other) @ weights * 0.5 * whole / pi
    within = 1.0 - erfc(level / sqrt(2.0))
    return np.asarray((within**2 * own + bent) / clipped_variance(level))


def _dry_correlation(lags: FloatArray) -> FloatArray:
    """Of a speed under dry friction; lags in units of its variance over the friction squared.

    2 exp(-t/2) times the integral of (1 + s - s^3/3) exp(-s) over a Gaussian of variance t, from 0
    on: what has not yet come to rest (Touchette, Van der Straeten and Just, J. Phys. A 43, 445002,
    2010); what is beyond 80 is less than rounding.
    """
    t = np.minimum(lags, 80.0)
    root = np.sqrt(t)
    beyond, density = 0.5 * erfc(root / sqrt(2.0)), np.exp(-0.5 * t) / sqrt(2.0 * pi)
    still = beyond * (1.0 - t + t**2 + t**3 / 3.0)
    return np.asarray(2.0 * (still + density * root * (1.0 - (2.0 * t + t**2) / 3.0)))


def _phase_correlation(r: FloatArray) -> FloatArray:
    """Of the phase between -pi and pi of light whose field remembers ``r``.

    As a Fourier series of the phase it is 1 - 3 |d|/pi + 3/2 (d/pi)^2 in the mean over differences
    d, with both of their moments known (Middleton, Statistical Communication Theory, 1960, 9.1).
    """
    turned = np.arcsin(r) / pi
    return np.asarray(1.5 * turned * (1.0 + turned) - 0.75 * spence(1.0 - r**2) / pi**2)


def _restarted_correlation(decay: float, n: int) -> FloatArray:
    """(n,) of means that each go on with the share ``decay`` of a chance.

    Means of k and of k + lag readings share k of them, their covariance is 1/(k + lag); k of them
    there are with (1 - decay) decay^(k - 1), so that all of it is what is left of a logarithm.
    """
    whole = -np.log1p(-decay)
    k = np.arange(1.0, float(n))
    return np.asarray(1.0 - np.concatenate([[0.0], np.cumsum(decay**k / k)]) / whole)


def _slowing_correlation(part: Component, lags: FloatArray) -> FloatArray:
    """Mean of exp(-rate lag) over rates between 1/time and 1/(depth time), any as likely."""
    slow = lags / part.time
    wide = np.maximum((1.0 / part.depth - 1.0) * slow, 1e-12)
    return np.asarray(-np.exp(-slow) * np.expm1(-wide) / wide)


def _retuned_correlation(part: Component, lags: FloatArray) -> FloatArray:
    """Mean of exp(-lag/T) over times T from ``depth`` ``time`` to ``time``, even in logarithms."""
    slow = np.maximum(lags / part.time, 1e-15)  # it has a logarithm at 0, which both share
    quick = np.minimum(slow / part.depth, 700.0)
    return np.asarray((exp1(slow) - exp1(quick)) / -np.log(part.depth))


def _hat_with_hat(lags: FloatArray) -> FloatArray:
    """Autocorrelation of straight lines between independent values at unit distance.

    The hat function with itself, a cubic B-spline, over its value at 0.
    """
    near = 1.0 - 1.5 * lags**2 + 0.75 * lags**3
    far = 0.25 * np.maximum(2.0 - lags, 0.0) ** 3
    return np.where(lags < 1.0, near, far)


def _orders(part: Component) -> FloatArray:
    """Shares of the variance (30,) of the fringes' harmonics."""
    weights = part.depth ** (2.0 * np.arange(1, 31))
    shares: FloatArray = weights / weights.sum()
    return shares


def _discs(distance: FloatArray) -> FloatArray:
    """Area that two discs share whose centres are ``distance`` diameters apart, over one disc's."""
    d = np.minimum(distance, 1.0)
    shared: FloatArray = (np.arccos(d) - d * np.sqrt(1.0 - d**2)) * 2.0 / pi
    return shared


def _notched_correlation(part: Component, n: int, interval: float) -> FloatArray:
    """(n,) autocorrelation of white noise with what an all-pass filter A makes of it.

    |1 + A|^2 = 2 + A + A* with |A| = 1, hence at lags beyond 0 half the answer of A to one pulse
    over 1 + its first sample (Regalia, Mitra and Vaidyanathan, Proc. IEEE 76, 19, 1988).
    """
    above, below = all_pass(part, interval)
    pulse = np.zeros(n)
    pulse[0] = 1.0
    R: FloatArray = 0.5 * lfilter(above, below, pulse) / (1.0 + above[0])
    R[0] = 1.0
    return R
