"""Roughness of the input and noise of the record: their posterior given the lags.

The marginal likelihood is the filter's.  It is maximised for each order of the input, and draws are
made from the Gaussian about the maximum (Laplace).  The draws of the two orders are mixed by the
evidence of each.  The maximum moves with the lags; the draws follow it.  The record does not move
the lags themselves: what it says of them rests on the input assumed, and they were measured.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.optimize import minimize
from scipy.special import expit
from scipy.stats import norm

from bayes_sensor.campaign import FloatArray
from bayes_sensor.restoration.state_space import ORDERS, FilterSamples, Model

MOST_SAMPLES = 10_000
"""samples in the marginal likelihood; of a longer record a part"""
PRIOR_SD = 3.0
"""of the logarithms of all scales: a factor of 20 either way"""
AIC = 1.0
"""gain in log likelihood that a parameter must bring (Akaike)"""
SMALLEST_GROWTH = 1e-3
"""of the noise, over its smallest: none that could be seen"""


@dataclass(frozen=True, eq=False)
class InputFit:
    """The maximum for one order of the input, and the Gaussian about it."""

    order: int
    peak: FloatArray
    """(n_p,) log of input sd, length and sigma, logit of phi and, where noise grows, log growth"""
    cov: FloatArray
    """(n_p, n_p)"""
    moves: FloatArray
    """(n_p, n_lags) by how much the maximum moves with the logarithm of each lag"""
    lags: FloatArray
    """(n_lags,) s, where it was found"""
    log_evidence: float

    def at(self, lags: FloatArray) -> FloatArray:
        """(n_p,) the maximum at ``lags`` (n_lags,)."""
        return np.asarray(self.peak + self.moves @ np.log(lags / self.lags))

    def model(self, lags: FloatArray, z: FloatArray | float = 0.0) -> Model:
        """The model at ``lags`` (n_lags,), ``z`` (n_p,) standard deviations off the maximum."""
        off = _root(self.cov) @ np.broadcast_to(z, self.peak.shape)
        return _model(self.order, self.at(lags) + off, lags)


def _model(order: int, p: FloatArray, lags: FloatArray) -> Model:
    growth = float(np.exp(p[4])) if len(p) > 4 else 0.0
    sd, length, sigma = (float(v) for v in np.exp(p[:3]))
    return Model(order, sd, length, tuple(map(float, lags)), sigma, float(expit(p[3])), growth)


def _root(cov: FloatArray) -> FloatArray:
    values, vectors = np.linalg.eigh(cov)
    return np.asarray(vectors * np.sqrt(np.maximum(values, 0.0)))


def fit_orders(
    samples: FilterSamples, lags: FloatArray, tell: Callable[[float, str], None]
) -> list[InputFit]:
    """The maximum for each order of the input, the best first; ``lags`` (n_lags,) s."""
    some = samples.thinned(MOST_SAMPLES)
    grows = False
    found = []
    for i, order in enumerate(ORDERS):
        tell(0.4 * i / len(ORDERS), "roughness and noise")
        target = InputPosterior(some, order, lags)
        peak, best = target.maximum(target.starts())
        if i == 0 or grows:
            # noise that grows with the signal is one parameter more: asked once
            more, value = target.maximum([np.append(peak, 0.0)])
            if i == 0:
                grows = value > best + AIC
            if grows:
                peak = more
        found.append(target.laplace(peak))
    return sorted(found, key=lambda each: -each.log_evidence)


class InputPosterior:
    """Log posterior of the parameters for one order of the input."""

    def __init__(self, samples: FilterSamples, order: int, lags: FloatArray) -> None:
        self.samples, self.order, self.lags = samples, order, lags
        self.duration = float(samples.t[-1])
        seen = samples.y[np.isfinite(samples.y)]
        # noise from second differences: what is smooth leaves them
        rough = float(np.sqrt(np.mean(np.diff(seen, 2) ** 2) / 6.0)) if len(seen) > 4 else 0.1
        length = np.sqrt(samples.interval * self.duration)
        self.centre = np.array([0.5, np.log(length), np.log(max(rough, 1e-6)), 0.0, 0.0])

    def starts(self) -> list[FloatArray]:
        """Where to begin: short and long inputs, white and coloured noise."""
        slow = float(np.log(max(self.lags.max(), self.samples.interval)))
        first = self.centre[:4].copy()
        return [first + [0.0, slow - first[1] + a, 0.0, b] for a, b in ((-1.0, -1.0), (1.0, 2.0))]

    def log_posterior(self, p: FloatArray, lags: FloatArray | None = None) -> float:
        """Log likelihood and log prior: logarithms of scales wide normal, phi uniform in 0 to 1."""
        free = np.delete(p - self.centre[: len(p)], 3)
        phi = float(expit(p[3]))
        prior = float(norm.logpdf(free, 0.0, PRIOR_SD).sum() + np.log(phi * (1.0 - phi)))
        model = _model(self.order, p, self.lags if lags is None else lags)
        return self.samples.log_likelihood(model) + prior

    def maximum(self, starts: Sequence[FloatArray]) -> tuple[FloatArray, float]:
        """The highest of the maxima reached."""
        best, value = starts[0], -np.inf
        for start in starts:
            width = 3.0 * PRIOR_SD
            centre = self.centre[: len(start)]
            bounds = [(c - width, c + width) for c in centre]
            bounds[3] = (-9.0, 9.0)
            if len(start) > 4:
                bounds[4] = (float(np.log(SMALLEST_GROWTH)), width)
            begin = np.clip(start, [b[0] for b in bounds], [b[1] for b in bounds])
            found = minimize(
                lambda p: -self.log_posterior(p), begin, method="L-BFGS-B", bounds=bounds
            )
            if -found.fun > value:
                best, value = np.asarray(found.x, dtype=float), -float(found.fun)
        return best, value

    def laplace(self, peak: FloatArray) -> InputFit:
        """The Gaussian about a maximum, and how it moves with the lags."""
        n = len(peak)
        value = self.log_posterior(peak)
        width = np.full(n, 0.05)
        for _ in range(2):  # first how narrow the maximum is, then differences over a third of that
            for i in range(n):
                up, down = (self.log_posterior(self._at(peak, i, s * width[i])) for s in (1, -1))
                curvature = max((2.0 * value - up - down) / width[i] ** 2, 1e-2)
                width[i] = np.clip(0.3 / np.sqrt(curvature), 1e-4, 0.5)
        hessian = np.zeros((n, n))
        for i in range(n):
            for j in range(i + 1):
                hessian[i, j] = hessian[j, i] = -self._mixed(peak, i, j, width)
        # a direction that the record says nothing about has its prior
        values, vectors = np.linalg.eigh(hessian)
        values = np.maximum(values, PRIOR_SD**-2)
        cov = (vectors / values) @ vectors.T
        slopes = np.zeros((n, len(self.lags)))
        for j in range(len(self.lags)):
            for i in range(n):
                slopes[i, j] = self._with_lag(peak, i, j, width)
        log_evidence = value + 0.5 * n * np.log(2.0 * np.pi) - 0.5 * float(np.log(values).sum())
        return InputFit(self.order, peak, cov, cov @ slopes, self.lags, log_evidence)

    @staticmethod
    def _at(p: FloatArray, i: int, by: float) -> FloatArray:
        moved = p.copy()
        moved[i] += by
        return moved

    def _mixed(self, p: FloatArray, i: int, j: int, width: FloatArray) -> float:
        total = 0.0
        for a in (1, -1):
            for b in (1, -1):
                moved = self._at(self._at(p, i, a * width[i]), j, b * width[j])
                total += a * b * self.log_posterior(moved)
        return float(total / (4.0 * width[i] * width[j]))

    def _with_lag(self, p: FloatArray, i: int, j: int, width: FloatArray) -> float:
        by, total = 0.02, 0.0
        for a in (1, -1):
            for b in (1, -1):
                lags = self.lags.copy()
                lags[j] *= np.exp(b * by)
                total += a * b * self.log_posterior(self._at(p, i, a * width[i]), lags)
        return float(total / (4.0 * width[i] * by))


def draw_models(
    fitted: Sequence[InputFit], lags: FloatArray, n: int, rng: np.random.Generator
) -> list[Model]:
    """``n`` models: orders by their evidence, ``lags`` (n, n_lags) one each, the rest Gaussian."""
    logs = np.array([each.log_evidence for each in fitted])
    shares = np.exp(logs - np.logaddexp.reduce(logs))
    counts = np.floor(n * shares + 0.5).astype(int)
    counts[0] = n - counts[1:].sum()
    places = rng.permutation(n)
    models, begin = [], 0
    for each, count in zip(fitted, counts, strict=True):
        if count:
            strata = [
                rng.permutation(count) for _ in each.peak
            ]  # one draw in each, Latin hypercube
            z = norm.ppf((np.stack(strata, axis=1) + 0.5) / count)
            some = lags[places[begin : begin + count]]
            models += [each.model(lag, row) for lag, row in zip(some, z, strict=True)]
        begin += count
    return models
