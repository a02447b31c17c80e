"""The input, the lags that it passes, and the noise, as one linear state space model.

The state is [input and its derivative, lag 1 .. lag k, noise].  The input is a stationary Gaussian
process of the Matern family.  On times short against its length it is as rough as a random walk
(order 1, Matern 1/2) or as smooth as an integrated random walk (order 2, Matern 3/2).  Särkkä and
Solin, *Applied Stochastic Differential Equations* (2019), section 12.3.  The noise is AR(1).
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from scipy.linalg import solve_continuous_lyapunov
from scipy.ndimage import uniform_filter1d

from bayes_sensor.campaign import BoolArray, FloatArray
from bayes_sensor.restoration.kalman import (
    discretise,
    one_after_the_other,
    run_filter,
    run_smoother,
)

FINE = 128
"""units of time, of which a long step has a multiple and a rest"""
ORDERS = (1, 2)
"""orders of the input"""
TIME_DIGITS = 1e-4, 1e-2
"""times are rounded to the smaller of these shares, of the usual and of the shortest step: records
without a clock's jitter then have few distinct steps, and no error adds up"""


@dataclass(frozen=True)
class Model:
    """Input, chain and noise; signals in the record's standard deviations, times in s."""

    order: int
    """1 or 2"""
    input_sd: float
    """standard deviation of the input about its mean"""
    length: float
    """s, over which the input changes"""
    lags: tuple[float, ...]
    """s"""
    sigma: float
    """standard deviation of the noise where the signal is lowest"""
    phi: float
    """AR(1) coefficient at the reference interval"""
    growth: float = 0.0
    """extra noise where the signal is highest, over ``sigma``"""

    @property
    def rate(self) -> float:
        """1/s, of the input's own process."""
        return float(np.sqrt(2.0 * self.order - 1.0) / self.length)

    def matrices(self) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Drift, spectral density of the noise and stationary covariance (m, m) of input and lags.

        The derivative of the input is divided by the rate: all states have one unit.
        """
        m, rate = self.order + len(self.lags), self.rate
        drift, diffusion = np.zeros((m, m)), np.zeros((m, m))
        if self.order == 1:
            drift[0, 0] = -rate
            diffusion[0, 0] = 2.0 * rate * self.input_sd**2
        else:
            drift[0, 1], drift[1, 0], drift[1, 1] = rate, -rate, -2.0 * rate
            diffusion[1, 1] = 4.0 * rate * self.input_sd**2
        for j, lag in enumerate(self.lags):
            place = self.order + j
            drift[place, 0 if j == 0 else place - 1] = 1.0 / lag
            drift[place, place] = -1.0 / lag
        stationary = solve_continuous_lyapunov(drift, -diffusion)
        return drift, diffusion, 0.5 * (stationary + stationary.T)

    def input_spectrum(self, frequencies: FloatArray) -> FloatArray:
        """One-sided spectral density of the input at ``frequencies`` (n,) in Hz."""
        w = 2.0 * np.pi * frequencies / self.rate
        power = 4.0 * self.order * self.input_sd**2 / self.rate
        return np.asarray(power / (1.0 + w**2) ** self.order)

    def gain_squared(self, frequencies: FloatArray) -> FloatArray:
        """Squared modulus of the chain's frequency response at ``frequencies`` (n,) in Hz."""
        found = np.ones_like(frequencies)
        for lag in self.lags:
            found = found / (1.0 + (2.0 * np.pi * frequencies * lag) ** 2)
        return found

    def noise_spectrum(self, frequencies: FloatArray, interval: float) -> FloatArray:
        """One-sided spectral density of the noise sampled every ``interval`` s (that of phi)."""
        w = 2.0 * np.pi * frequencies * interval
        power = 2.0 * interval * self.sigma**2 * (1.0 - self.phi**2)
        return np.asarray(power / (1.0 - 2.0 * self.phi * np.cos(w) + self.phi**2))


@dataclass(frozen=True, eq=False)
class FilterSamples:
    """The samples of a record, ready for the filter."""

    y: FloatArray
    """(n,) less the record's mean and over its standard deviation; NaN where none was taken"""
    unit: float
    """s, of which every time between neighbours is a multiple"""
    counts: np.ndarray
    """(n_steps,) of units, the distinct times between neighbours"""
    which: np.ndarray
    """(n,) the place in ``counts`` of the time before each sample; 0 for the first"""
    level: FloatArray
    """(n,) 0 where the signal is lowest to 1 where it is highest"""
    interval: float
    """s, the most common time between neighbours; that of phi"""
    direct: BoolArray
    """(n,) whether a value is one of the input itself, with an error of its own"""
    error: FloatArray
    """(n,) standard deviation of that error"""

    @cached_property
    def steps(self) -> FloatArray:
        """(n_steps,) s, the distinct times between neighbours."""
        return np.asarray(self.counts * self.unit)

    @property
    def _places(self) -> np.ndarray:
        """(n,) units since the first sample."""
        return np.concatenate([[0], np.cumsum(self.counts[self.which[1:]])])

    @property
    def t(self) -> FloatArray:
        """(n,) s since the first sample."""
        return np.asarray(self._places * self.unit)

    def with_input(
        self, places: np.ndarray, values: FloatArray, errors: FloatArray
    ) -> FilterSamples:
        """The samples, and ``values`` of the input of known errors right after those at ``places``.

        All (n_values,); ``places`` increase.
        """
        return FilterSamples(
            y=np.insert(self.y, places + 1, values),
            unit=self.unit,
            counts=np.append(self.counts, 0),
            which=np.insert(self.which, places + 1, len(self.counts)),
            level=np.insert(self.level, places + 1, 0.0),
            interval=self.interval,
            direct=np.insert(self.direct, places + 1, True),
            error=np.insert(self.error, places + 1, errors),
        )

    def thinned(self, most: int) -> FilterSamples:
        """About ``most`` samples in evenly spread bursts of neighbours; all where there are fewer.

        The likelihood of a part of the samples is exact as well, because times may be irregular.
        Bursts keep what is needed for the noise, their distance what is needed for the input.
        """
        n = len(self.y)
        if n <= most:
            return self
        period = int(np.ceil(n * BURST / most))
        kept = np.flatnonzero(np.arange(n) % period < BURST)
        counts, which = distinct_steps(self._places[kept])
        return FilterSamples(
            self.y[kept], self.unit, counts, which, self.level[kept], self.interval,
            self.direct[kept], self.error[kept],
        )  # fmt: skip

    @cached_property
    def _parts(self) -> list[tuple[np.ndarray, np.ndarray]]:
        """Distinct multiples of :data:`FINE` units and distinct rests, and which of them make up
        each of the steps."""
        return [np.unique(part, return_inverse=True) for part in np.divmod(self.counts, FINE)]

    def over_steps(self, drift: FloatArray, diffusion: FloatArray) -> tuple[FloatArray, FloatArray]:
        """:func:`discretise` over all distinct steps, in two parts where these are many."""
        (long, which_long), (short, which_short) = self._parts
        if len(long) + len(short) >= len(self.counts):
            return discretise(drift, diffusion, self.steps)
        return one_after_the_other(
            which_long, *discretise(drift, diffusion, long * (FINE * self.unit)),
            which_short, *discretise(drift, diffusion, short * self.unit),
        )  # fmt: skip

    def _system(self, model: Model) -> tuple[Any, ...]:
        drift, diffusion, stationary = model.matrices()
        m = len(drift)
        transitions = np.zeros((len(self.counts), m + 1, m + 1))
        covariances = np.zeros((len(self.counts), m + 1, m + 1))
        transitions[:, :m, :m], covariances[:, :m, :m] = self.over_steps(drift, diffusion)
        phi = model.phi ** (self.steps / self.interval)
        transitions[:, m, m], covariances[:, m, m] = phi, 1.0 - phi**2
        start = np.zeros((m + 1, m + 1))
        start[:m, :m] = stationary
        places = np.arange(model.order, m)
        start[places, places] += 1.0  # a record may begin with the sensor out of balance
        start[m, m] = 1.0
        scale = model.sigma * np.sqrt(1.0 + (model.growth * self.level) ** 2)
        scale = np.where(self.direct, self.error, scale)
        return scale, transitions, covariances, start, tuple(range(m + 1))

    def _filter(self, model: Model, keep: bool = False) -> tuple[Any, tuple[Any, ...]]:
        """What :func:`run_filter` finds, and the system that it ran on."""
        system = self._system(model)
        scale, transitions, covariances, start, states = system
        found = run_filter(
            self.y, scale, self.which, transitions, covariances, start, states, self.direct, keep
        )
        return found, system

    def log_likelihood(self, model: Model) -> float:
        """Log density of the samples."""
        (value, *_), _ = self._filter(model)
        return float(value)

    def innovations(self, model: Model) -> FloatArray:
        """(n,) prediction errors over their standard deviations; NaN where no sample was taken."""
        (_, v, spread, *_), _ = self._filter(model)
        return np.asarray(v / np.sqrt(spread))

    def smooth(self, model: Model) -> tuple[FloatArray, FloatArray]:
        """Mean and variance (n,) of the input at the record's times, given all samples."""
        (_, v, spread, mean, row, gains), system = self._filter(model, keep=True)
        scale, transitions, _, _, states = system
        m, variance = run_smoother(
            v, spread, mean, row, gains, scale, self.which, transitions, states, self.direct
        )
        recorded = ~self.direct
        return m[recorded], variance[recorded]


BURST = 16
"""neighbours in a burst"""


def unit_of_times(t: FloatArray, interval: float) -> float:
    """s, to which times ``t`` (n,) s are rounded; ``interval``: s, the usual step."""
    return min(TIME_DIGITS[0] * interval, TIME_DIGITS[1] * float(np.diff(t).min()))


def distinct_steps(places: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Distinct steps of ``places`` (n,), and which of them (n,) comes before each sample.

    The first sample has no step before it and stands as 0.

    >>> distinct_steps(np.array([0, 1, 3, 4]))
    (array([1, 2]), array([0, 0, 1, 0]))
    """
    found, which = np.unique(np.diff(places), return_inverse=True)
    return found, np.concatenate([[0], which.ravel()]).astype(np.int64)


def make_samples(
    t: FloatArray, y: FloatArray, slowest: float
) -> tuple[FilterSamples, float, float]:
    """Samples of a record ``t``, ``y`` (n,), with its mean and standard deviation.

    ``slowest``: s, the longest lag.  What the sensor says changes little over a quarter of it; the
    mean over that time is the level that noise may grow with.
    """
    seen = np.isfinite(y)
    mean, spread = float(y[seen].mean()), float(y[seen].std())
    interval = float(np.median(np.diff(t)))
    unit = unit_of_times(t, interval)
    counts, which = distinct_steps(np.rint((t - t[0]) / unit).astype(np.int64))
    filled = np.interp(t, t[seen], y[seen])
    width = int(np.clip(0.25 * slowest / interval, 1, max(1, len(t) // 8)))
    smooth = uniform_filter1d(filled, width)
    low, high = float(smooth.min()), float(smooth.max())
    level = (smooth - low) / (high - low) if high > low else np.zeros(len(t))
    none = np.zeros(len(t))
    samples = FilterSamples(
        (y - mean) / spread, unit, counts, which, level, interval, none > 0.0, none
    )
    return samples, mean, spread
