"""The residuals of a fit, and what its noise law says of them."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from math import sqrt
from typing import Any

import numpy as np
from scipy import fft
from scipy.ndimage import uniform_filter1d

from bayes_sensor.campaign import BoolArray, FloatArray
from bayes_sensor.likelihood.density import mean_and_variance, response_at_samples
from bayes_sensor.likelihood.noise import lag_coefficient
from bayes_sensor.likelihood.problem import Problem
from bayes_sensor.residuals.autocorrelation import power, whiten

QUICK_SHARE = 40
"""of a record, as one over this, above which residuals are slow"""


@dataclass(frozen=True, eq=False)
class Series:
    """One experiment's used samples."""

    r: FloatArray  # (n,) V
    z: FloatArray  # (n,) r / s
    e: FloatArray  # (n,) whitened
    x: FloatArray  # (n,) x3
    slope: FloatArray  # (n,) 1/s, |dx3/dt|
    s: FloatArray  # (n,) V
    used: BoolArray  # (n_t,) which samples of the record these are
    concentration: float

    @classmethod
    def of(cls, problem: Problem, vector: FloatArray, k: int) -> Series:
        """Of experiment ``k``."""
        e = problem.campaign.experiments[k]
        mean, s2 = mean_and_variance(problem, vector, k)
        used = np.flatnonzero(e.used)
        r = e.values[used] - mean[used]
        s = np.sqrt(s2[used])
        phi = lag_coefficient(float(vector[problem.layout.noise[k, 0]]), problem.steps(e))
        if problem.chain == "exact":
            x = response_at_samples(problem, vector, k)
        else:
            x = problem.model.response(e.t, vector, problem.layout, e)
        z = r / s
        slope = np.abs(np.gradient(x, e.t)) if len(x) > 1 else np.zeros(len(x))
        if not e.regular:
            phi = max(phi, 0.0)
        white = whiten(z, e.places[used], phi)
        return cls(r, z, white, x[used], slope[used], s, e.used, e.concentration)

    @property
    def quick(self) -> Series:
        """The same residuals without what is slow, which may be a misfit."""
        width = min(max(len(self.r) // QUICK_SHARE, 3), len(self.r))
        return replace(self, r=self.r - uniform_filter1d(self.r, width))

    @property
    def lag_one(self) -> float | None:
        """Correlation of neighbouring samples, about zero; None where no two are used."""
        r = np.zeros(len(self.used))
        r[self.used] = self.r
        pairs = int(np.sum(self.used[1:] & self.used[:-1]))
        if pairs == 0:
            return None
        return float(r[1:] @ r[:-1] / (self.r @ self.r)) * (len(self.r) - 1) / pairs


@dataclass(frozen=True, eq=False)
class FittedNoise:
    """A noise law at a parameter vector, beside the residuals it has to describe."""

    problem: Problem
    vector: FloatArray
    """(n_theta,)"""
    series: list[Series]
    """one an experiment"""

    @classmethod
    def of(cls, problem: Problem, vector: FloatArray) -> FittedNoise:
        """With the residuals of the problem's data."""
        series = [Series.of(problem, vector, k) for k in range(len(problem.campaign))]
        return cls(problem, vector, series)

    def joined(self, name: str) -> Any:
        """A column of all experiments in a row, in the campaign's order."""
        return np.concatenate([getattr(s, name) for s in self.series])

    @property
    def concentrations(self) -> list[FloatArray]:
        """(n,) of every experiment: concentration over the campaign's highest."""
        highest = self.problem.campaign.reference_concentration
        return [s.concentration * np.clip(s.x, 0.0, 1.0) / highest for s in self.series]

    @property
    def slopes(self) -> list[FloatArray]:
        """(n,) of every experiment: |dx3/dt| over the campaign's largest."""
        largest = max((float(s.slope.max()) for s in self.series if len(s.slope)), default=0.0)
        return [s.slope / (largest or 1.0) for s in self.series]

    @cached_property
    def phi(self) -> FloatArray:
        """(n_e,) coefficient of the fitted AR(1) at every experiment's own interval."""
        own = self.vector[self.problem.layout.noise[:, 0]]
        steps = [self.problem.steps(e) for e in self.problem.campaign]
        return np.array([lag_coefficient(float(v), step) for v, step in zip(own, steps)])

    @property
    def slowest(self) -> float:
        """The coefficient of the experiment whose noise remembers for most samples."""
        return float(self.phi[np.argmax(np.abs(self.phi))])

    @property
    def fades(self) -> int:
        """Samples after which the slowest AR(1)'s correlation has fallen below 0.01."""
        phi = abs(self.slowest)
        return 1 if phi < 0.01 else int(np.ceil(np.log(0.01) / np.log(min(phi, 0.999999))))

    def correlation(self, lags: np.ndarray) -> FloatArray:
        """(n_lags,) correlation that all residuals together have under the fitted AR(1).

        ``lags`` in samples.  Of experiments with a coefficient each, the mean, weighted by their
        sums of squares.
        """
        weight = np.array([float(s.r @ s.r) for s in self.series])
        weight = (
            weight / weight.sum() if weight.sum() > 0.0 else np.full(len(weight), 1.0 / len(weight))
        )
        curve: FloatArray = weight @ power(self.phi[:, None], lags)
        return curve

    @cached_property
    def slow_part(self) -> tuple[float, float]:
        """(ratio, sd): slow power of z over what the fitted AR(1) puts there, its chance spread.

        The whitened series of an adequate AR(1) has a flat spectrum of height 1: the ratio is the
        mean of its periodogram below a tenth of the frequency at which the AR(1)'s own spectrum
        bends, at least twenty ordinates per experiment.
        """
        total, n = 0.0, 0
        for s, phi in zip(self.series, self.phi, strict=True):
            m = len(s.e)
            periodogram = np.abs(fft.rfft(s.e)) ** 2 / m
            bend = (1.0 - abs(phi)) / (2.0 * np.pi)  # cycles per sample
            last = int(np.clip(0.1 * bend * m, 20, max(m // 4, 1)))
            chosen = periodogram[1 : last + 1]
            total += float(chosen.sum())
            n += len(chosen)
        return total / max(n, 1), 1.0 / sqrt(max(n, 1))
