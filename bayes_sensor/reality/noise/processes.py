"""Stretches of noise: each component is drawn by a recursion of its own."""

from __future__ import annotations

from math import ceil, exp, pi, sqrt
from typing import Any

import numpy as np
from numba import njit
from numpy.typing import NDArray
from scipy.signal import lfilter
from scipy.special import erfcx

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
    if part.shape == "difference":
        e = _innovations(n + 1, rng, tails)
        return (e[1:] - part.depth * e[:-1]) / sqrt(1.0 + part.depth**2)
    if part.shape == "shaped":
        return np.diff(_innovations(n + 2, rng, tails), 2) / sqrt(6.0)
    if part.shape == "binomial":
        return np.convolve(_innovations(n + 2, rng, tails), [1.0, 2.0, 1.0], "valid") / sqrt(6.0)
    if part.shape == "median":
        e = _innovations(n + 2, rng, tails)
        shown: FloatArray = np.median([e[:-2], e[1:-1], e[2:]], axis=0)
        return shown / sqrt(1.0 - sqrt(3.0) / pi)
    if part.shape == "overcorrected":
        alternating: FloatArray = _remembering(_innovations(n, rng, tails), -part.depth)
        return alternating
    if part.shape == "diffused":
        return _embedded(antipersistent(part.depth, n + 1), rng)
    if part.shape == "referred":
        e = _innovations(n, rng, tails)
        loud = np.sqrt(rng.chisquare(part.rate, n) / (part.rate - 2.0))
        return e / loud
    if part.shape == "repeated":
        e = _innovations(n, rng, tails)
        fresh = rng.random(n) >= part.depth
        fresh[0] = True
        return e[_last_marked(fresh)]
    if part.shape == "counts":
        counts = rng.poisson(part.rate, n).astype(float)
        return (counts - part.rate) / sqrt(part.rate)
    if part.shape == "chaos":
        anywhere: FloatArray = _kneaded(rng.random(), part.depth, n)
        return sqrt(12.0) * (anywhere - 0.5)
    if part.shape == "startled":
        return _startled(_innovations(n + 60, rng, tails), part.depth)[60:]
    if part.shape == "sparkling":
        off = np.where(rng.random(n) < part.rate, 1.0 / sqrt(part.rate), 0.0)
        return np.where(rng.random(n) < 0.5, off, -off)
    if part.shape == "interleaved":
        louder = np.where((np.arange(n) + rng.integers(2)) % 2 == 0, *gusts(part))
        return louder * _innovations(n, rng, tails)
    if part.time == 0.0:
        return _innovations(n, rng, tails)
    decay = exp(-interval / part.time)
    if part.shape == "telegraph":
        return _telegraph(decay, n, rng)
    if part.shape == "window":
        return _window(part.time, n, interval, rng)
    if part.shape == "shot":
        return _shot(part, n, interval, rng)
    if part.shape == "sparks":
        return _sparks(part, n, interval, rng)
    if part.shape == "echo":
        return _echo(part, n, interval, rng, tails)
    if part.shape == "turbulent":
        R = von_karman(np.arange(n + 1, dtype=float) * interval / part.time)
        return _embedded(R, rng)
    if part.shape == "diffusing":
        R = 1.0 / (1.0 + np.arange(n + 1, dtype=float) * interval / part.time)
        return _embedded(R, rng)
    if part.shape == "conducting":
        return _embedded(erfcx(np.sqrt(np.arange(n + 1, dtype=float) * interval / part.time)), rng)
    if part.shape == "latching":
        return _latching(interval / part.time, n, rng)
    if part.shape == "stops":
        return _between_stops(interval / part.time, n, rng)
    if part.shape == "coded":
        return _coded(interval / part.time, n, rng)
    if part.shape == "paces":
        return _paced(part, n, interval, rng, tails)
    if part.shape == "cut_off":
        return _cut_off(interval / part.time, n, rng)
    if part.shape == "settling":
        return _settling(part, n, interval, rng)
    if part.shape == "hunting":
        return _hunting(part, n, interval, rng)
    if part.shape == "beating":
        return _beating(part, n, interval, rng)
    if part.shape == "held":
        at = np.arange(n) * (interval / part.time) + rng.random()
        levels: FloatArray = rng.standard_normal(int(at[-1]) + 1)
        return levels[at.astype(np.int64)]
    if part.shape == "trains":
        return _trains(part, n, interval, rng)
    if part.shape == "dimmed":
        return _dimmed(interval / part.time, n, rng)
    if part.shape == "rectified":
        modulus: FloatArray = np.abs(_remembering(rng.standard_normal(n), decay))
        return (modulus - sqrt(2.0 / pi)) / sqrt(1.0 - 2.0 / pi)
    if part.shape == "teeth":
        return _teeth(part, n, interval, rng)
    if part.shape == "flapping":
        return _flapping(part, n, interval, rng)
    if part.shape == "bubbles":
        return _bubbles(part, n, interval, rng)
    if part.shape == "resting":
        return _resting(interval / part.time, n, rng)
    if part.shape == "dry":
        return _dry(interval / part.time, n, rng)
    if part.shape == "larger":
        higher: FloatArray = np.max(_remembering(rng.standard_normal((2, n)), decay), axis=0)
        return (higher - 1.0 / sqrt(pi)) / sqrt(1.0 - 1.0 / pi)
    if part.shape == "clipped":
        within: FloatArray = np.clip(
            _remembering(rng.standard_normal(n), decay), -part.depth, part.depth
        )
        return within / sqrt(clipped_variance(part.depth))
    if part.shape == "thrice":
        # long enough to be the same on a circle as on a line, to rounding
        s = np.arange(max(n, ceil(40.0 * part.time / interval)) + 1) * (interval / part.time)
        return _embedded(np.exp(-s) * (1.0 + s + s**2 / 3.0), rng)[:n]
    if part.shape == "fitful":
        passed = rng.gamma(interval / part.gust_time, part.gust_time / part.time, n)
        kicks = _innovations(n, rng, tails)
        kicks[1:] *= np.sqrt(-np.expm1(-2.0 * passed[1:]))
        fits: FloatArray = _forgetting(np.exp(-passed), kicks)
        return fits
    if part.shape == "fading":
        field = _remembering(rng.standard_normal(n) + 1j * rng.standard_normal(n), decay)
        brightness: FloatArray = np.log(0.5 * np.abs(field) ** 2)
        return (brightness + np.euler_gamma) * (sqrt(6.0) / pi)
    if part.shape == "landscape":
        return _over_a_landscape(interval / part.time, n, rng)
    if part.shape == "fluttering":
        return _fluttering(part, n, interval, rng, tails)
    if part.shape == "retuned":
        turned = part.time * part.depth ** rng.random()
        filtered: FloatArray = _remembering(_innovations(n, rng, tails), exp(-interval / turned))
        return filtered
    if part.shape == "crests":
        return _sinking(interval / part.time, n, rng)
    if part.shape == "phase":
        light = rng.standard_normal(n) + 1j * rng.standard_normal(n)
        phase: FloatArray = np.angle(_remembering(light, decay))
        return phase * (sqrt(3.0) / pi)
    if part.shape == "passing":
        return _passing(part, n, interval, rng)
    if part.shape == "restarted":
        return _restarted(decay, _innovations(n, rng, tails), rng)
    if part.shape == "slowing":
        return _slowing(part, n, interval, rng, tails)
    if part.shape == "squared":
        turn = np.exp(2j * pi * part.frequency * interval)
        kicks = rng.standard_normal(n) + 1j * rng.standard_normal(n)
        away: FloatArray = _remembering(kicks, decay, turn).real
        return (1.0 - away**2) / sqrt(2.0)
    if part.shape == "stretched":
        # convex, as a mixture of exponentials is
        lags = np.arange(n + 1, dtype=float) * interval
        return _embedded(np.exp(-((lags / part.time) ** part.depth)), rng)
    if part.shape == "chattering":
        return np.where(_remembering(rng.standard_normal(n), decay) > 0.0, 1.0, -1.0)
    if part.shape == "bell":
        return _bell(part.time, n, interval, rng)
    if part.shape == "bits":
        return _bits(decay, n, rng)
    if part.shape == "speckle":
        return _speckle(part.time, n, interval, rng)
    if part.shape == "whistling":
        return _whistling(part, n, interval, rng)
    if part.shape == "notched":
        return _notched(part, n, interval, rng, tails)
    if part.shape == "charging":
        return _charging(part.time, n, interval, rng)
    if part.shape == "zeroed":
        return _zeroed(part.time, n, interval, rng)
    if part.shape == "coupled":
        return _coupled(part, n, interval, rng, tails)
    if part.shape == "interpolated":
        return _drawn_lines(part.time, n, interval, rng)
    if part.shape in ("fringes", "strokes"):
        return _fringes(part, n, interval, rng)
    if part.shape == "motes":
        return _motes(part, n, interval, rng)
    if part.shape == "smooth":
        # exact sampling of the critically damped process (x, v): x'' = -2 x'/T - x/T^2 + noise
        return _smooth(part.time, n, interval, rng)
    e = _innovations(n, rng, tails)
    if part.frequency == 0.0 or part.shape == "pulsing":
        x: FloatArray = _remembering(e, decay)
        if part.shape == "gusts":
            x *= np.where(_telegraph(exp(-interval / part.gust_time), n, rng) > 0, *gusts(part))
        elif part.shape == "lognormal":
            x *= _loudness(part, n, interval, rng)
        elif part.shape == "balanced":
            x *= _remembering(rng.standard_normal(n), exp(-interval / part.gust_time))
        elif part.shape == "waning":
            x *= _waning(part.depth, n, rng)
        elif part.shape == "drilled":
            x *= _drilled(part, n, rng)
        elif part.shape == "replugged":
            x *= sqrt(1.0 + part.depth * rng.uniform(-1.0, 1.0))
        elif part.shape == "pulsing":
            turns = part.frequency * interval * np.arange(n) + rng.random()
            x *= (1.0 + part.depth * np.cos(2.0 * pi * turns)) / sqrt(1.0 + 0.5 * part.depth**2)
        return x
    turn = np.exp(2j * pi * part.frequency * interval)
    turning: FloatArray = _remembering(e + 1j * rng.standard_normal(n), decay, turn).real
    return turning


def _remembering(e: Any, decay: float, turn: complex = 1.0) -> Any:
    """First-order recursion, stationary from the first sample, on independent ``e`` (.., n)."""
    kicks = np.array(e)
    kicks[..., 1:] *= sqrt(1.0 - decay**2)
    return lfilter([1.0], [1.0, -decay * turn], kicks)


def _telegraph(decay: float, n: int, rng: np.random.Generator) -> FloatArray:
    """(n,) 1 or -1; ``decay`` is its correlation from sample to sample."""
    flips = rng.random(n) < 0.5 * (1.0 - decay)
    return np.where((np.cumsum(flips) + rng.integers(2)) % 2 == 0, 1.0, -1.0)


def _latching(knocks: float, n: int, rng: np.random.Generator) -> FloatArray:
    """(n,) 1 or -1, the other one after every second of the ``knocks`` that come in an interval.

    Four states in a ring, two of them up: of the ring's modes the two that turn by a quarter are
    seen, hence exp(-lag/time) cos(lag/time) with the mean time from knock to knock.
    """
    state = rng.integers(4) + np.cumsum(rng.poisson(knocks, n))
    return np.where(state % 4 < 2, 1.0, -1.0)


def _between_stops(interval: float, n: int, rng: np.random.Generator) -> FloatArray:
    """(n,) random walk between two stops that throw it back, anywhere as likely.

    A free walk, folded; with ``interval`` in units of its time the distance of its stops has the
    modes exp(-k^2 lag) of odd k, in shares of 96/(pi k)^4.
    """
    walk = sqrt(2.0 * interval) / pi * rng.standard_normal(n)
    walk[0] = 2.0 * rng.random()
    folded = np.abs(np.mod(np.cumsum(walk), 2.0) - 1.0)  # of stops at 0 and 1
    place: FloatArray = sqrt(12.0) * (folded - 0.5)
    return place


def _coded(bits: float, n: int, rng: np.random.Generator) -> FloatArray:
    """(n,) 1 or -1: bits at random, ``bits`` of them an interval, the other sign in second halves.

    Manchester's code; the first sample lies anywhere in its bit.
    """
    at = np.arange(n) * bits + rng.random()
    number = at.astype(np.int64)
    signs = np.where(rng.random(int(number[-1]) + 1) < 0.5, 1.0, -1.0)
    return np.where(at - number < 0.5, 1.0, -1.0) * signs[number]


def _paced(
    part: Component, n: int, interval: float, rng: np.random.Generator, tails: tuple[float, float]
) -> FloatArray:
    """(n,) Ornstein-Uhlenbeck process whose own time passes quickly or slowly, by turns."""
    mean, half, change = paces(part)
    changes = np.sort(rng.uniform(0.0, n * interval, rng.poisson(change * n * interval)))
    edges = np.concatenate([[0.0], changes, [n * interval]])
    sign = 1.0 if rng.random() < 0.5 else -1.0
    rates = mean + half * sign * np.where(np.arange(len(edges) - 1) % 2 == 0, 1.0, -1.0)
    passed = np.concatenate([[0.0], np.cumsum(rates * np.diff(edges))])
    own = np.diff(np.interp(np.arange(n) * interval, edges, passed), prepend=0.0)
    kicks = _innovations(n, rng, tails)
    kicks[1:] *= np.sqrt(-np.expm1(-2.0 * own[1:]))
    x: FloatArray = _forgetting(np.exp(-own), kicks)
    return x


@njit(cache=True)
def _forgetting(decays: FloatArray, kicks: FloatArray) -> FloatArray:  # pragma: no cover
    """(n,) first-order recursion whose ``decays`` (n,) differ; the first one does not count."""
    x = kicks.copy()
    for i in range(1, len(x)):
        x[i] += decays[i] * x[i - 1]
    return x


def _fluttering(
    part: Component, n: int, interval: float, rng: np.random.Generator, tails: tuple[float, float]
) -> FloatArray:
    """(n,) Ornstein-Uhlenbeck process whose rate is white noise itself: ``depth`` of the variance.

    In steps of a fifth of its ``time`` at most, as it is no chain of its own readings: the larger
    it is, the more it is thrown about (Student's law in the end, Wong, Proc. Symp. Appl. Math. 16,
    264, 1964).  What it began with is forgotten by the first sample.
    """
    steps = ceil(5.0 * interval / part.time)
    decay = exp(-interval / steps / part.time)
    before = ceil(20.0 * part.time / interval)
    total = (before + n) * steps
    loss = 1.0 - decay**2
    fed_back = decay + sqrt(part.depth * loss) * rng.standard_normal(total)
    kicks = sqrt((1.0 - part.depth) * loss) * _innovations(total, rng, tails)
    x: FloatArray = _forgetting(fed_back, kicks)
    return x[steps - 1 :: steps][before:]


def _over_a_landscape(step: float, n: int, rng: np.random.Generator) -> FloatArray:
    """(n,) height of a frozen landscape where a random walk goes; ``step`` in units of its time.

    Heights a distance d apart remember exp(-d); after a lag the walk has come a Gaussian distance
    whose variance is twice that, hence erfcx(sqrt(lag)) in the mean.
    """
    place = np.cumsum(sqrt(2.0 * step) * rng.standard_normal(n))
    order = np.argsort(place)
    decays = np.exp(-np.diff(place[order], prepend=place[order[0]]))
    kicks = rng.standard_normal(n)
    kicks[1:] *= np.sqrt(1.0 - decays[1:] ** 2)
    heights = np.empty(n)
    heights[order] = _forgetting(decays, kicks)
    return heights


def _waning(depth: float, n: int, rng: np.random.Generator) -> FloatArray:
    """(n,) loudness whose square runs evenly from 1 + ``depth`` to 1 - ``depth``, or back."""
    course = depth * (1.0 - (2.0 * np.arange(n) + 1.0) / n)
    return np.sqrt(1.0 + (course if rng.random() < 0.5 else -course))


def _drilled(part: Component, n: int, rng: np.random.Generator) -> FloatArray:
    """(n,) loudness, larger in one stretch: the record's end goes on at its beginning.

    So every sample is as likely to be within, and of unit mean square.
    """
    within = np.mod(np.arange(n) / n + rng.random(), 1.0) < part.rate
    loud = 1.0 + part.depth * (1.0 - part.rate) / part.rate
    return np.sqrt(np.where(within, loud, 1.0 - part.depth))


def _cut_off(step: float, n: int, rng: np.random.Generator) -> FloatArray:
    """(n,) white noise of which nothing is left beyond ``step``/2 turns a sample.

    From sines on a stretch several times as long, whose repetition is out of reach; the last of
    them counts in part.  A recorder that is too slow for them sees only some of the samples.
    """
    finer = 1 + int(step)
    total = 1 << ceil(np.log2(8.0 * n * finer + 400.0 * finer / step))
    last = 0.5 * step / finer * total  # in turns a stretch
    power = np.clip(last + 0.5 - np.arange(total // 2 + 1), 0.0, 1.0)
    white = np.fft.rfft(rng.standard_normal(total))
    x: FloatArray = np.fft.irfft(np.sqrt(power) * white, total)[: n * finer : finer]
    return x * sqrt(total / (power[0] + 2.0 * power[1:].sum()))


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


def _hunting(part: Component, n: int, interval: float, rng: np.random.Generator) -> FloatArray:
    """(n,) a tone whose frequency swings evenly by the share ``depth``, once in ``gust_time``.

    Its phase walks at random besides, so that of the tone exp(-lag/time) is remembered; of the
    swing, begun anywhere, Bessel's J0 is (Abramowitz and Stegun, 1964, Eq. 9.1.18).
    """
    walk = sqrt(2.0 * interval / part.time) * rng.standard_normal(n)
    walk[0] = 2.0 * pi * rng.random()
    at = interval * np.arange(n)
    swing = np.sin(2.0 * pi * (at / part.gust_time + rng.random()))
    phase = 2.0 * pi * part.frequency * at + part.depth * part.frequency * part.gust_time * swing
    tone: FloatArray = sqrt(2.0) * np.cos(phase + np.cumsum(walk))
    return tone


def _beating(part: Component, n: int, interval: float, rng: np.random.Generator) -> FloatArray:
    """(n,) sum of two tones as loud, whose phases walk at random, each for itself."""
    walks = sqrt(2.0 * interval / part.time) * rng.standard_normal((2, n))
    walks[:, 0] = 2.0 * pi * rng.random(2)
    pitches = part.frequency * (1.0 + part.depth * np.array([[-1.0], [1.0]]))
    phases = 2.0 * pi * pitches * interval * np.arange(n) + np.cumsum(walks, axis=1)
    both: FloatArray = np.cos(phases).sum(axis=0)
    return both


def _trains(part: Component, n: int, interval: float, rng: np.random.Generator) -> FloatArray:
    """(n,) trains of pulses, less their mean: heights, and times since the begin, exponential.

    The variance is that of as many pulses at random (Campbell's theorem), and that of the trains'
    mean courses besides (Neyman and Scott, J. R. Stat. Soc. B 20, 1, 1958).
    """
    early = 12.0 * part.gust_time + 20.0 * part.time
    before = ceil(early / interval)
    lasting = (before + n) * interval
    begins = rng.uniform(0.0, lasting, rng.poisson(part.rate * lasting / part.gust_time))
    at = np.repeat(begins, rng.poisson(part.depth, len(begins)))
    at = (at + rng.exponential(part.gust_time, len(at))) / interval  # in samples
    at = at[at < before + n - 1]
    seen = at.astype(np.int64) + 1
    heights = rng.exponential(size=len(at))
    x = _dying_out(seen, (seen - at) * interval, heights, part.time, n, before, interval)
    mean = part.rate * part.depth * part.time / part.gust_time
    return (x - mean) / sqrt(mean / train_shares(part)[0])


def _dimmed(periods: float, n: int, rng: np.random.Generator) -> FloatArray:
    """(n,) 1 or -1: ``periods`` of them an interval, each lit from its begin for a time at random.

    The first sample lies anywhere in its period.
    """
    at = np.arange(n) * periods + rng.random()
    number = at.astype(np.int64)
    return np.where(at - number < rng.random(int(number[-1]) + 1)[number], 1.0, -1.0)


def _teeth(part: Component, n: int, interval: float, rng: np.random.Generator) -> FloatArray:
    """(n,) level of one tooth after the other, each of which remembers itself from turn to turn.

    The first sample lies anywhere in its tooth.
    """
    teeth = round(part.gust_time / part.time)
    at = np.arange(n) * (interval / part.time) + rng.random()
    number = at.astype(np.int64)
    turns = int(number[-1]) // teeth + 1
    levels = _remembering(rng.standard_normal((teeth, turns)), part.depth)
    knocks: FloatArray = levels[number % teeth, number // teeth]
    return knocks


@njit(cache=True)
def _startled(e: FloatArray, depth: float) -> FloatArray:  # pragma: no cover - compiled
    """(n,) white noise whose variance is 1 - ``depth`` and ``depth`` times the last one squared.

    Of independent ``e`` (n,) (Engle, Econometrica 50, 987, 1982); of unit variance in the mean.
    """
    z = e.copy()
    for i in range(1, len(z)):
        z[i] *= sqrt(1.0 - depth + depth * z[i - 1] ** 2)
    return z


@njit(cache=True)
def _kneaded(x: float, turn: float, n: int) -> FloatArray:  # pragma: no cover - compiled
    """(n,) from ``x`` on: what is below ``turn`` is stretched, the rest is stretched and turned.

    The skew tent map, of which anything from 0 to 1 is as likely: the share ``turn`` goes on the
    same way and the rest the other way, hence a correlation of 2 ``turn`` - 1 from one to the next.
    """
    y = np.empty(n)
    for i in range(n):
        y[i] = x
        x = x / turn if x < turn else (1.0 - x) / (1.0 - turn)
    return y


def _flapping(part: Component, n: int, interval: float, rng: np.random.Generator) -> FloatArray:
    """(n,) two levels, of correlation exp(-lag/``gust_time``), behind a lag of ``time``.

    Followed exactly from turn to turn, from long before; of variance gust_time/(gust_time + time)
    where the levels are 1 and -1.
    """
    early, lasting = 30.0 * part.time, n * interval
    count = rng.poisson(0.5 * (lasting + early) / part.gust_time)
    turns = np.concatenate([[-early], np.sort(rng.uniform(-early, lasting, count))])
    levels = np.where((np.arange(count + 1) + rng.integers(2)) % 2 == 0, 1.0, -1.0)
    left = np.exp(-np.diff(turns, prepend=-early) / part.time)
    # at every turn what the level before has made of it
    kicks = np.concatenate([[0.0], levels[:-1] * (1.0 - left[1:])])
    begun = _forgetting(left, kicks)
    at = np.arange(n) * interval
    k = np.searchsorted(turns, at, side="right") - 1
    x: FloatArray = levels[k] + (begun[k] - levels[k]) * np.exp(-(at - turns[k]) / part.time)
    return x * sqrt(1.0 + part.time / part.gust_time)


def _bubbles(part: Component, n: int, interval: float, rng: np.random.Generator) -> FloatArray:
    """(n,) equal pulses that die out in a ``time`` and wait for each other, less their mean."""
    before = ceil(30.0 * part.time / interval)
    lasting = (before + n) * interval / part.time
    stages = 2.0 * part.rate * lasting
    waits = rng.exponential(0.5 / part.rate, ceil(stages + 8.0 * sqrt(stages) + 40.0))
    ends = np.cumsum(waits)[rng.integers(2) :: 2]  # the first one finds itself in either stage
    at = ends[ends < lasting] * part.time / interval  # in samples
    seen = at.astype(np.int64) + 1
    x = _dying_out(seen, (seen - at) * interval, 1.0, part.time, n, before, interval)
    return (x - part.rate) / sqrt(float(bubbling_covariance(part.rate, np.zeros(1))[0]))


def _resting(step: float, n: int, rng: np.random.Generator) -> FloatArray:
    """(n,) height above a stop of what drifts on to it and is thrown about, less its mean.

    Of unit drift and variance it is exponentially distributed, of mean 1/2.
    """
    return 2.0 * _above_a_stop(step, n, rng)[0] - 1.0


def _above_a_stop(
    step: float, n: int, rng: np.random.Generator
) -> tuple[FloatArray, NDArray[np.bool_]]:
    """Height (n,) of what drifts on to a stop, and whether it touched it since the last sample.

    The stop has pushed it up by as much as the free walk would have come below, whose lowest place
    between two samples is drawn exactly: of a bridge from 0 to d, (d - sqrt(d^2 + 2 e step))/2 with
    e exponential.
    """
    free = sqrt(step) * rng.standard_normal(n) - step
    lowest = 0.5 * (free - np.sqrt(free**2 + 2.0 * step * rng.exponential(size=n)))
    free[0] = lowest[0] = 0.0
    begin = rng.exponential(0.5)
    walk = begin + np.cumsum(free)
    below = walk - free + lowest
    pushed = np.minimum(np.minimum.accumulate(below), 0.0)
    return walk - pushed, np.diff(pushed, prepend=0.0) < 0.0


def _dry(step: float, n: int, rng: np.random.Generator) -> FloatArray:
    """(n,) speed that is thrown about and driven to rest by dry friction, the same at any speed.

    Its modulus is that of what drifts on to a stop; whenever that is touched it goes on either way.
    Of unit friction and variance it is exponentially distributed to both sides, of variance 1/2.
    """
    modulus, touched = _above_a_stop(step, n, rng)
    signs = np.where(rng.random(n) < 0.5, 1.0, -1.0)
    touched[0] = True
    speed: FloatArray = modulus * signs[_last_marked(touched)]
    return sqrt(2.0) * speed


def _sinking(step: float, n: int, rng: np.random.Generator) -> FloatArray:
    """(n,) highest of the crests that came at random, each sunk by its age, less its mean.

    Heights above any level are exponential, hence Gumbel's distribution, of variance pi^2/6; after
    a time it is the larger one of what is left and of new crests, and correlated as the
    dilogarithm tells (Tiago de Oliveira, Statistical Extremes and Applications, 1984).
    """
    crests = rng.gumbel(size=n)
    crests[1:] += np.log(-np.expm1(-step))
    age = step * np.arange(n)
    level: FloatArray = np.maximum.accumulate(crests + age) - age
    return (level - np.euler_gamma) / sqrt(pi**2 / 6.0)


def _passing(part: Component, n: int, interval: float, rng: np.random.Generator) -> FloatArray:
    """(n,) what charges of either sign and any size induce that fly past: s exp(-s^2/2) each.

    s is the time from when they are nearest, ``rate`` of them come in a ``time``.
    """
    reach = ceil(6.0 * part.time / interval)
    total = n + 2 * reach
    at = rng.uniform(0.0, total, rng.poisson(part.rate * total * interval / part.time))
    charges = rng.standard_normal(len(at))
    nearest = at.astype(np.int64)
    x = np.zeros(total + 2 * reach + 1)
    for k in range(2 * reach + 1):
        s = (nearest + k - reach - at) * (interval / part.time)
        x += np.bincount(nearest + k, charges * s * np.exp(-0.5 * s**2), len(x))
    # of the mean square, sqrt(pi)/2 a pulse (Campbell's theorem)
    return x[2 * reach : 2 * reach + n] / sqrt(0.5 * sqrt(pi) * part.rate)


def _last_marked(marked: NDArray[np.bool_]) -> NDArray[np.int64]:
    """(n,) index of the last one that is ``marked`` (n,), as the first must be, up to each."""
    last: NDArray[np.int64] = np.maximum.accumulate(np.where(marked, np.arange(len(marked)), 0))
    return last


def _restarted(decay: float, e: FloatArray, rng: np.random.Generator) -> FloatArray:
    """(n,) mean of independent ``e`` (n,) since a restart, as there is none with ``decay``.

    The first one stands for the mean of as many as there would have been.
    """
    n = len(e)
    begins = rng.random(n) >= decay
    begins[0] = True
    at = np.flatnonzero(begins)
    last = _last_marked(begins)
    since = np.arange(n) - last + 1.0
    earlier = float(rng.geometric(1.0 - decay)) - 1.0
    before = sqrt(earlier) * float(rng.standard_normal())
    sums = np.cumsum(e)
    sums -= sums[last] - e[last]
    first = slice(0, at[1] if len(at) > 1 else n)
    sums[first] += before
    since[first] += earlier
    shown: FloatArray = sums / since * sqrt(decay / ((1.0 - decay) * -np.log1p(-decay)))
    return shown


def _slowing(
    part: Component, n: int, interval: float, rng: np.random.Generator, tails: tuple[float, float]
) -> FloatArray:
    """(n,) Ornstein-Uhlenbeck process whose rate goes evenly from one end to the other, or back.

    Its variance stays what it is; only how soon it forgets does not.
    """
    course = (np.arange(n) + 0.5) / n
    if rng.random() < 0.5:
        course = 1.0 - course
    own = (1.0 + (1.0 / part.depth - 1.0) * course) * interval / part.time
    kicks = _innovations(n, rng, tails)
    kicks[1:] *= np.sqrt(-np.expm1(-2.0 * own[1:]))
    x: FloatArray = _forgetting(np.exp(-own), kicks)
    return x


def _loudness(part: Component, n: int, interval: float, rng: np.random.Generator) -> FloatArray:
    """(n,) exponential of an Ornstein-Uhlenbeck process of rms ``depth``, of unit mean square."""
    decay = exp(-interval / part.gust_time)
    level = _remembering(rng.standard_normal(n), decay)
    loudness: FloatArray = np.exp(part.depth * level - part.depth**2)
    return loudness


def _bits(decay: float, n: int, rng: np.random.Generator) -> FloatArray:
    """(n,) sum of steps up or down of equal size, of which ``decay`` is left a sample later."""
    before = ceil(20.0 / -np.log(decay)) if decay > 0.0 else 0
    steps = np.where(rng.random(n + before) < 0.5, 1.0, -1.0)
    x: FloatArray = lfilter([sqrt(1.0 - decay**2)], [1.0, -decay], steps)[before:]
    return x


def _bell(time: float, n: int, interval: float, rng: np.random.Generator) -> FloatArray:
    """(n,) of autocorrelation exp(-(lag/``time``)^2), by circulant embedding.

    On a stretch so long that nothing is left of it at the end, where the embedding is exact but for
    rounding.
    """
    lags = np.arange(max(n, ceil(8.0 * time / interval)) + 1, dtype=float) * interval
    return _embedded(np.exp(-((lags / time) ** 2)), rng)[:n]


def _window(time: float, n: int, interval: float, rng: np.random.Generator) -> FloatArray:
    """(n,) white noise integrated over the ``time`` before each sample.

    Such a window spans m whole intervals and the last part of one more, so that each interval's
    integral is drawn in two parts.
    """
    whole = int(time // interval)
    part = time - whole * interval
    late = sqrt(part) * rng.standard_normal(n + whole)
    both = late + sqrt(max(interval - part, 0.0)) * rng.standard_normal(n + whole)
    sums = np.concatenate([[0.0], np.cumsum(both)])
    moving: FloatArray = (sums[whole + 1 :] - sums[1 : n + 1] + late[:n]) / sqrt(time)
    return moving


def _shot(part: Component, n: int, interval: float, rng: np.random.Generator) -> FloatArray:
    """(n,) pulses that come at random and die out, of exponentially distributed heights.

    Their mean, ``rate`` times the mean height, is taken off (Campbell's theorem: the variance is
    ``rate``/2 times the mean squared height).
    """
    before, seen, late = _arrivals(part, n, interval, rng)
    heights = rng.exponential(size=len(seen))
    x = _dying_out(seen, late, heights, part.time, n, before, interval)
    return (x - part.rate) / sqrt(part.rate)


def _dying_out(
    seen: NDArray[np.int64],
    late: FloatArray,
    heights: FloatArray | float,
    time: float,
    n: int,
    before: int,
    interval: float,
) -> FloatArray:
    """(n,) sum of pulses that die out in a ``time``, from ``before`` samples earlier on.

    ``seen`` (m,): the samples that show them first, so ``late`` (m,) s after they came.
    """
    arriving = np.bincount(seen, heights * np.exp(-late / time), before + n)[: before + n]
    x: FloatArray = lfilter([1.0], [1.0, -exp(-interval / time)], arriving)[before:]
    return x


def _arrivals(
    part: Component, n: int, interval: float, rng: np.random.Generator
) -> tuple[int, NDArray[np.int64], FloatArray]:
    """Samples before the first one, where pulses are seen first (m,), and how late (m,) s."""
    before = ceil(20.0 * part.time / interval)
    total = n + before
    count = rng.poisson(part.rate * total * interval / part.time)
    at = rng.uniform(0.0, total, count)  # in samples; a pulse is seen from the next sample on
    seen = at.astype(np.int64)
    return before, seen, (seen + 1 - at) * interval


def _sparks(part: Component, n: int, interval: float, rng: np.random.Generator) -> FloatArray:
    """(n,) pulses that come at random and ring out, of exponential heights and any phase.

    Campbell's theorem: their variance is ``rate``/4 times the mean squared height.
    """
    before, seen, late = _arrivals(part, n, interval, rng)
    turn = -1.0 / part.time + 2j * pi * part.frequency
    phases = 2j * pi * rng.random(len(seen))
    struck = rng.exponential(size=len(seen)) * np.exp(phases + turn * late)
    arriving = np.zeros(n + before, dtype=complex)
    np.add.at(arriving, seen, struck)
    x: FloatArray = lfilter([1.0], [1.0, -np.exp(turn * interval)], arriving)[before:].real
    return x / sqrt(0.5 * part.rate)


def _echo(
    part: Component, n: int, interval: float, rng: np.random.Generator, tails: tuple[float, float]
) -> FloatArray:
    """(n,) Ornstein-Uhlenbeck process and its echo, whose samples lie between those of the first.

    The process is stepped from each sample to the echo's time between it and the next, and on.
    """
    delay = 1.0 / part.frequency
    whole = int(delay // interval)
    rest = min(max(delay - whole * interval, 0.0), interval)
    first, second = exp(-(interval - rest) / part.time), exp(-rest / part.time)
    e = _innovations(n + whole + 1, rng, tails)
    between = sqrt(1.0 - first**2) * _innovations(n + whole + 1, rng, tails)
    kicks = sqrt(1.0 - second**2) * e
    kicks[1:] += second * between[:-1]
    kicks[0] = e[0]
    x: FloatArray = lfilter([1.0], [1.0, -first * second], kicks)
    echo = first * x + between
    both: FloatArray = x[whole + 1 :] + part.depth * echo[:n]
    return both / sqrt(echo_variance(part))


def _embedded(R: FloatArray, rng: np.random.Generator) -> FloatArray:
    """(n,) by circulant embedding, exact as the autocorrelation ``R`` (n + 1,) is convex

    Dietrich and Newsam, SIAM J. Sci. Comput. 18, 1088, 1997.
    """
    n = len(R) - 1
    spectrum = np.fft.rfft(np.concatenate([R, R[-2:0:-1]])).real
    white = np.fft.rfft(rng.standard_normal(2 * n))
    x: FloatArray = np.fft.irfft(np.sqrt(np.maximum(spectrum, 0.0)) * white, 2 * n)[:n]
    return x


def _zeroed(period: float, n: int, interval: float, rng: np.random.Generator) -> FloatArray:
    """(n,) random walk that starts anew from zero every ``period`` (s), the first time anywhere.

    Its variance is the time since then, period/2 in the mean; walks apart do not correlate, hence
    (1 - lag/period)^2.
    """
    at = np.arange(n) * interval + period * rng.random()
    number = np.floor(at / period)
    first = np.concatenate([[True], np.diff(number) > 0])
    steps = np.where(first, np.sqrt(at - number * period), sqrt(interval)) * rng.standard_normal(n)
    walk = np.cumsum(steps)
    begun = (walk - steps)[first]
    x: FloatArray = (walk - begun[np.cumsum(first) - 1]) / sqrt(0.5 * period)
    return x


def _coupled(
    part: Component, n: int, interval: float, rng: np.random.Generator, tails: tuple[float, float]
) -> FloatArray:
    """(n,) Ornstein-Uhlenbeck process through a high-pass filter of one pole.

    That is a lag of white noise less another, slower lag of the same white noise.
    """
    slow = coupling_time(part)
    a, b = 1.0 / part.time, 1.0 / slow
    rates = np.array([a, b])
    # lags r exp(-r s) of unit white noise: covariance r q/(r + q), and what an interval adds to it
    sums = np.add.outer(rates, rates)
    stationary = np.outer(rates, rates) / sums
    added = stationary * -np.expm1(-sums * interval)
    e = np.array([_innovations(n, rng, tails), rng.standard_normal(n)])
    kicks = np.linalg.cholesky(added) @ e
    kicks[:, 0] = np.linalg.cholesky(stationary) @ e[:, 0]
    fast: FloatArray = lfilter([1.0], [1.0, -exp(-a * interval)], kicks[0])
    late: FloatArray = lfilter([1.0], [1.0, -exp(-b * interval)], kicks[1])
    passed: FloatArray = (fast - late) / sqrt(0.5 * (a - b) ** 2 / (a + b))
    return passed


def _drawn_lines(time: float, n: int, interval: float, rng: np.random.Generator) -> FloatArray:
    """(n,) straight lines between independent readings ``time`` apart, the first one anywhere.

    Between readings two share the work: the variance is 2/3 of theirs in the mean.
    """
    at = np.arange(n) * (interval / time) + rng.random()
    readings = rng.standard_normal(int(at[-1]) + 2)
    lines: FloatArray = np.interp(at, np.arange(len(readings)), readings) / sqrt(2.0 / 3.0)
    return lines


def _fringes(part: Component, n: int, interval: float, rng: np.random.Generator) -> FloatArray:
    """(n,) sum of depth^k cos(k phase) over k = 1, 2, .., with a phase that walks at random.

    Each passage between the faces adds to the phase and takes its share of the light (Airy).  The
    phase's variance grows by 2/``time``, hence exp(-k^2 lag/time); the voltage has its bounds.
    With ``frequency`` the phase turns evenly besides: pulses, all alike.
    """
    walk = sqrt(2.0 * interval / part.time) * rng.standard_normal(n)
    walk[0] = 2.0 * pi * rng.random()
    phase = 2.0 * pi * part.frequency * interval * np.arange(n) + np.cumsum(walk)
    r = part.depth
    light = 0.5 * (1.0 - r**2) / (1.0 - 2.0 * r * np.cos(phase) + r**2) - 0.5
    fringes: FloatArray = light / sqrt(0.5 * r**2 / (1.0 - r**2))
    return fringes


def _motes(part: Component, n: int, interval: float, rng: np.random.Generator) -> FloatArray:
    """(n,) less the number of specks in a round beam, which each cross on a straight line.

    Where they cross is anywhere: their ways through the beam are a disc's chords, and their number
    is Poisson's, of mean and variance pi/4 times ``rate``; at two times it is correlated as two
    discs overlap.
    """
    lasting = n * interval + part.time
    enter = rng.uniform(-part.time, n * interval, rng.poisson(part.rate * lasting / part.time))
    leave = enter + part.time * np.sqrt(1.0 - rng.random(len(enter)) ** 2)
    # the first sample that sees each of them, and the first that no longer does
    edges = [np.clip(np.ceil(at / interval), 0, n).astype(int) for at in (enter, leave)]
    come, gone = (np.bincount(edge, minlength=n + 1)[:n] for edge in edges)
    mean = 0.25 * pi * part.rate
    dimmed: FloatArray = (mean - np.cumsum(come - gone)) / sqrt(mean)
    return dimmed


def _speckle(time: float, n: int, interval: float, rng: np.random.Generator) -> FloatArray:
    """(n,) brightness of light whose field is the sum of many waves, less its mean.

    The field is a complex Ornstein-Uhlenbeck process, its square exponentially distributed and
    correlated as exp(-lag/time) (Goodman, Speckle Phenomena in Optics, 2007).
    """
    field = _remembering(rng.standard_normal((2, n)), exp(-0.5 * interval / time))
    brightness: FloatArray = 0.5 * np.sum(field**2, axis=0) - 1.0
    return brightness


def _whistling(part: Component, n: int, interval: float, rng: np.random.Generator) -> FloatArray:
    """(n,) a tone that breaks off after exponentially distributed times, for one of another pitch.

    The new one begins anywhere in its turn.
    """
    breaks = rng.random(n) < -np.expm1(-interval / part.time)
    breaks[0] = True
    tone = np.cumsum(breaks) - 1
    count = int(tone[-1]) + 1
    pitches = part.frequency * (1.0 + part.depth * rng.uniform(-1.0, 1.0, count))
    since = (np.arange(n) - np.flatnonzero(breaks)[tone]) * interval
    turns = pitches[tone] * since + rng.random(count)[tone]
    whistle: FloatArray = sqrt(2.0) * np.cos(2.0 * pi * turns)
    return whistle


def _notched(
    part: Component, n: int, interval: float, rng: np.random.Generator, tails: tuple[float, float]
) -> FloatArray:
    """(n,) white noise without ``frequency``, where it and what an all-pass makes of it cancel."""
    above, below = all_pass(part, interval)
    before = ceil(20.0 * part.time / interval)
    e = _innovations(n + before, rng, tails)
    both: FloatArray = (e + lfilter(above, below, e))[before:]
    return both / sqrt(2.0 * (1.0 + above[0]))


def _charging(time: float, n: int, interval: float, rng: np.random.Generator) -> FloatArray:
    """(n,) straight rise since the last of the breakdowns, which come at random, less its mean.

    The time since then is exponentially distributed, and correlated as exp(-lag/time): after a
    breakdown nothing is known of before.
    """
    at = np.arange(n) * interval
    breakdowns = np.sort(rng.uniform(0.0, n * interval, rng.poisson(n * interval / time)))
    last = np.concatenate([[-rng.exponential(time)], breakdowns])
    since: FloatArray = at - last[np.searchsorted(breakdowns, at, side="right")]
    return since / time - 1.0


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
    x: FloatArray = lfilter([1.0], [1.0, -2.0 * e, e * e], drive)
    return x
