"""Noise: nineteen laws, each a sum of components: how a component correlates and is drawn."""

from __future__ import annotations

from math import ceil, exp, pi, sqrt

import numpy as np
from scipy.signal import lfilter
from scipy.special import exp1, gamma, kv

from bayes_sensor.blind_check.simulator.case import Component, NoiseLaw
from bayes_sensor.campaign import CampaignError, FloatArray

OPEN_LAWS = (
    "ar1", "white", "ar1_slow", "arma", "pink", "band_limited", "oscillating", "telegraph", "shot",
    "gusty", "turbulent", "mode_hopping", "drilling", "few_photons", "retuned_filter",
)  # fmt: skip
"""laws for every run; ``ar1`` and ``white`` are within the package's own noise model"""
RESERVE_LAWS = ("bench_fan", "waking_laser", "trembling_speckle", "shaped_converter")
"""kept out of every run but the last"""
HEAVY_TAILED = ("shot", "gusty", "drilling", "few_photons", "waking_laser", "trembling_speckle")
"""laws whose innovations have clearly more large values than a Gaussian's"""


def draw_law(name: str, rng: np.random.Generator, sigma: float) -> NoiseLaw:
    """A law of one kind with correlations and sizes of its own; ``sigma`` (V) is its total rms.

    Between a fifth and all of the variance at the highest concentration is there at zero
    concentration, too.

    Raises
    ------
    CampaignError
        If the law is not known.
    """
    quiet = rng.uniform(0.2, 1.0)
    sigma0, sigma1 = sigma * sqrt(quiet), sigma * sqrt(1.0 - quiet)

    def between(low: float, high: float, where: np.random.Generator = rng) -> float:
        return exp(where.uniform(np.log(low), np.log(high)))

    short = between(5e-4, 2e-2)  # s
    share = between(0.004, 0.03)
    octaves = 2.0 ** np.arange(-6, 8)  # s
    # every law is drawn each time, so that what is drawn next does not depend on the law
    parts: dict[str, tuple[Component, ...]] = {
        "white": (Component(1.0),),
        "ar1": (Component(1.0, short),),
        "ar1_slow": (Component(1.0 - share, short), Component(share, between(0.4, 2.5))),
        "arma": (
            Component(0.35 + 0.3 * share, between(0.01, 0.08)),
            Component(0.65 - 0.3 * share),
        ),
        "pink": (  # 1/f, from Ornstein-Uhlenbeck processes an octave apart
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
            Component(share, between(0.1, 3.0), shape="telegraph"),
        ),
    }
    (own,) = rng.spawn(1)
    stirred, hopping = own.uniform(0.05, 0.3), own.uniform(0.05, 0.15)
    counted = own.uniform(0.7, 0.95)
    parts |= {
        # single events: cosmic rays, sparks
        "shot": (
            Component(0.4),
            Component(0.6, short, shape="shot", rate=between(0.1, 2.0, own)),
        ),
        # a draught that comes and goes
        "gusty": (
            Component(
                1.0, short, shape="gusts", depth=own.uniform(0.5, 0.95),
                gust_time=between(0.1, 4.0, own),
            ),
        ),
        # density fluctuations of a turbulent stream carried past the ring
        "turbulent": (
            Component(1.0 - stirred, short),
            Component(stirred, between(0.02, 0.3, own), shape="turbulent"),
        ),
        # a laser of many modes: the longer it has kept to one, the longer it will
        "mode_hopping": (
            Component(1.0 - hopping),
            Component(
                hopping, between(0.05, 0.4, own), shape="settling", depth=own.uniform(0.5, 0.9)
            ),
        ),
        # somebody drills into the wall next door, once for a while
        "drilling": (
            Component(
                1.0, short, shape="drilled", rate=own.uniform(0.1, 0.4), depth=own.uniform(0.6, 0.9)
            ),
        ),
        # a counter that finds but a few photons, or none, in the time of a reading
        "few_photons": (
            Component(1.0 - counted, between(0.02, 0.2, own)),
            Component(counted, shape="counts", rate=between(0.3, 1.5, own)),
        ),
        # a receiver whose filter somebody turns between the records, quicker or slower
        "retuned_filter": (
            Component(
                1.0, between(0.02, 0.1, own), shape="retuned", depth=between(0.02, 0.1, own)
            ),
        ),
    }  # fmt: skip
    (kept,) = own.spawn(1)
    turned, grainy = kept.uniform(0.02, 0.1), kept.uniform(0.3, 0.7)
    parts |= {
        # a fan turns on the same bench, at a speed that wanders
        "bench_fan": (
            Component(1.0 - turned, short),
            Component(turned, between(1.0, 8.0, kept), kept.uniform(9.0, 35.0)),
        ),
        # a laser that is loud when a record begins and calms down as it warms up
        "waking_laser": (
            Component(
                1.0, short, shape="calming", depth=kept.uniform(0.7, 0.9),
                rate=kept.uniform(5.0, 15.0),
            ),
        ),
        # grains of speckle that tremble across the end of a fibre, itself lit by such grains
        "trembling_speckle": (
            Component(1.0 - grainy),
            Component(grainy, between(2e-3, 3e-2, kept), shape="speckle"),
        ),
        # a converter that pushes its noise towards the high frequencies
        "shaped_converter": (Component(1.0, shape="shaped", depth=kept.uniform(0.3, 0.7)),),
    }  # fmt: skip
    if name not in parts:
        raise CampaignError(f"noise law: expected one of {', '.join(parts)}, got '{name}'")
    return NoiseLaw(name, sigma0, sigma1, parts[name])


# --------------------------------------------------------------------------- autocorrelation


def autocorrelation(law: NoiseLaw, n: int, interval: float) -> FloatArray:
    """(n,) autocorrelation of the noise at lags 0, 1, .. n - 1 samples, exact."""
    lags = np.arange(n, dtype=float) * interval
    return sum((part.share * _correlation(part, lags) for part in law.components), np.zeros(n))


def _correlation(part: Component, lags: FloatArray) -> FloatArray:
    """(n,) autocorrelation of one component at ``lags`` (n,) s."""
    if part.shape == "shaped":
        shaped: FloatArray = np.where(lags == 0.0, 1.0, 0.0)
        shaped[1:2] = -part.depth / (1.0 + part.depth**2)
        return shaped
    if part.time == 0.0:
        return np.where(lags == 0.0, 1.0, 0.0)
    own: FloatArray = np.exp(-lags / part.time)
    if part.shape == "smooth":
        own *= 1.0 + lags / part.time
    elif part.shape == "gusts":
        loud, calm = np.sqrt(1.0 + part.depth), np.sqrt(1.0 - part.depth)
        mean, swing = 0.5 * (loud + calm), 0.5 * (loud - calm)
        own *= mean**2 + swing**2 * np.exp(-lags / part.gust_time)
    elif part.shape == "turbulent":
        own = _von_karman(lags / part.time)
    elif part.shape == "settling":
        own = (1.0 + lags / part.time) ** -part.depth
    elif part.shape == "retuned":
        # the mean of exp(-lag/T) over times T from depth time to time, even in the logarithm
        slow = np.maximum(lags / part.time, 1e-15)  # its logarithm at 0 cancels
        quick = np.minimum(slow / part.depth, 700.0)
        own = (exp1(slow) - exp1(quick)) / -np.log(part.depth)
    elif part.frequency:
        own *= np.cos(2.0 * pi * part.frequency * lags)
    return own


def _von_karman(lags: FloatArray) -> FloatArray:
    """Autocorrelation of a turbulent stream's fluctuations along it; lags in units of ``time``.

    2^(2/3)/Gamma(1/3) l^(1/3) K_1/3(l), with the spectrum (1 + (2 pi f)^2)^(-5/6) (von Karman,
    Proc. Natl. Acad. Sci. 34, 530, 1948).
    """
    total = np.ones_like(lags)
    later = lags > 0
    total[later] = 2.0 ** (2.0 / 3.0) / gamma(1.0 / 3.0) * np.cbrt(lags[later])
    total[later] *= kv(1.0 / 3.0, lags[later])
    return total


# --------------------------------------------------------------------------- drawing


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
        own = _draw_component(part, n, interval, rng, tails if i == 0 else (0.0, 1.0))
        total += sqrt(part.share) * own
    return total


def _draw_component(
    part: Component, n: int, interval: float, rng: np.random.Generator, tails: tuple[float, float]
) -> FloatArray:
    if part.shape == "counts":
        return (rng.poisson(part.rate, n).astype(float) - part.rate) / sqrt(part.rate)
    if part.shape == "shaped":
        e = _innovations(n + 1, rng, tails)
        return (e[1:] - part.depth * e[:-1]) / sqrt(1.0 + part.depth**2)
    if part.time == 0.0:
        return _innovations(n, rng, tails)
    decay = exp(-interval / part.time)
    if part.shape == "telegraph":
        return _telegraph(decay, n, rng)
    if part.shape == "shot":
        return _shot(part, n, interval, rng)
    if part.shape == "turbulent":
        return _embedded(_correlation(part, np.arange(n + 1.0) * interval), rng)
    if part.shape == "settling":
        return _settling(part, n, interval, rng)
    if part.shape == "retuned":
        time = part.time * part.depth ** rng.random()
        return _remembering(_innovations(n, rng, tails), exp(-interval / time))
    if part.shape == "smooth":
        # not convex, but over by then: on a circle as on a line, to rounding
        length = max(n, ceil(40.0 * part.time / interval))
        return _embedded(_correlation(part, np.arange(length + 1.0) * interval), rng)[:n]
    if part.shape == "speckle":
        half = exp(-interval / (2.0 * part.time))
        return _remembering(rng.standard_normal(n), half) * _remembering(
            rng.standard_normal(n), half
        )
    e = _innovations(n, rng, tails)
    if part.frequency:
        # the real part of a complex process that turns
        kicks = e + 1j * rng.standard_normal(n)
        kicks[1:] *= sqrt(1.0 - decay**2)
        turn = np.exp(2j * pi * part.frequency * interval)
        return np.asarray(lfilter([1.0], [1.0, -decay * turn], kicks).real)
    x = _remembering(e, decay)
    if part.shape == "gusts":
        gusts = _telegraph(exp(-interval / part.gust_time), n, rng)
        x *= np.sqrt(1.0 + part.depth * gusts)
    elif part.shape == "calming":
        x *= _calming(part, n)
    elif part.shape == "drilled":
        # the stretch may begin at the record's end and go on at its beginning
        within = np.mod(np.arange(n) / n + rng.random(), 1.0) < part.rate
        loud = 1.0 + part.depth * (1.0 - part.rate) / part.rate
        x *= np.sqrt(np.where(within, loud, 1.0 - part.depth))
    return x


def _calming(part: Component, n: int) -> FloatArray:
    """(n,) scale of a noise that calms down in the course of a record; its mean square is 1."""
    variance = 1.0 - part.depth + part.depth * np.exp(-part.rate * np.arange(n) / n)
    return np.asarray(np.sqrt(variance / variance.mean()))


def _innovations(n: int, rng: np.random.Generator, tails: tuple[float, float]) -> FloatArray:
    e = rng.standard_normal(n)
    p, k = tails
    if p > 0:
        e = np.where(rng.random(n) < p, k * e, e) / sqrt(1.0 - p + p * k**2)
    return e


def _remembering(e: FloatArray, decay: float) -> FloatArray:
    """First-order recursion, stationary from the first sample, on independent ``e`` (n,)."""
    kicks = e.copy()
    kicks[1:] *= sqrt(1.0 - decay**2)
    x: FloatArray = lfilter([1.0], [1.0, -decay], kicks)
    return x


def _telegraph(decay: float, n: int, rng: np.random.Generator) -> FloatArray:
    """(n,) 1 or -1; ``decay`` is its correlation from sample to sample."""
    flips = rng.random(n) < 0.5 * (1.0 - decay)
    return np.where((np.cumsum(flips) + rng.integers(2)) % 2 == 0, 1.0, -1.0)


def _shot(part: Component, n: int, interval: float, rng: np.random.Generator) -> FloatArray:
    """(n,) pulses that come at random and die out, of exponentially distributed heights.

    Their mean, ``rate`` times the mean height, is taken off (Campbell's theorem: the variance is
    ``rate``/2 times the mean squared height).
    """
    before = ceil(20.0 * part.time / interval)
    total = n + before
    count = rng.poisson(part.rate * total * interval / part.time)
    at = rng.uniform(0.0, total, count)  # in samples; a pulse is seen from the next sample on
    seen = at.astype(np.int64)
    late = (seen + 1 - at) * interval
    heights = rng.exponential(size=count) * np.exp(-late / part.time)
    arriving = np.bincount(seen, heights, total)[:total]
    x: FloatArray = lfilter([1.0], [1.0, -exp(-interval / part.time)], arriving)[before:]
    return (x - part.rate) / sqrt(part.rate)


def _embedded(R: FloatArray, rng: np.random.Generator) -> FloatArray:
    """(n,) by circulant embedding, exact as the autocorrelation ``R`` (n + 1,) is convex.

    Dietrich and Newsam, SIAM J. Sci. Comput. 18, 1088, 1997.
    """
    n = len(R) - 1
    spectrum = np.fft.rfft(np.concatenate([R, R[-2:0:-1]])).real
    white = np.fft.rfft(rng.standard_normal(2 * n))
    x: FloatArray = np.fft.irfft(np.sqrt(np.maximum(spectrum, 0.0)) * white, 2 * n)[:n]
    return x


def _settling(part: Component, n: int, interval: float, rng: np.random.Generator) -> FloatArray:
    """(n,) independent levels; the share (1 + t/time)^-(1 + ``depth``) of them lasts beyond t.

    At any instant the share (1 + t/time)^-depth lasts another t (renewal theory), which is the
    autocorrelation, as a new level has nothing of the one before.
    """
    length = n * interval / part.time
    edges = [float(rng.random() ** (-1.0 / part.depth) - 1.0)]
    while edges[-1] < length:
        more = rng.random(256) ** (-1.0 / (1.0 + part.depth)) - 1.0
        edges += (edges[-1] + np.cumsum(more)).tolist()
    at = np.arange(n) * (interval / part.time)
    levels: FloatArray = rng.standard_normal(len(edges) + 1)
    return levels[np.searchsorted(edges, at, side="right")]
