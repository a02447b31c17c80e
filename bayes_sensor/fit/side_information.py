"""What the data alone say of parameters that were measured elsewhere, and whether both agree.

The fit knows nothing of side information.  Its lags are taken as Gaussian with the information
that the data hold under their own noise, the shortest in its square, in which a least-squares lag
near zero is nearly so.
"""

from __future__ import annotations

from dataclasses import dataclass
from math import sqrt
from typing import Any

import numpy as np

from bayes_sensor.campaign import FloatArray
from bayes_sensor.compression import Region, compress
from bayes_sensor.lags import Naming, lags_of, named
from bayes_sensor.laplace import Coordinates
from bayes_sensor.likelihood import Prior, Problem

CONTRADICT = 3.0
"""joint standard deviations from which side information and data contradict each other"""
N_DRAWS = 20000
"""draws over which names of lags are weighed"""
Z95 = 1.6449
"""one-sided 95 % point of a standard normal"""
SYMBOLS = {"tau_s": ("tau", "s"), "tau_v_s": ("tau_v", "s"), "V_mL": ("V", "mL")}


@dataclass(frozen=True, eq=False)
class Estimates:
    """What the data alone say of the lags and the volume, as a Gaussian in (tau_1^2, tau_2, V).

    ``tau_1`` and ``tau_2`` are the shortest and the longest lag, in theta's first two places.
    """

    mean: FloatArray
    """(3,) s^2, s, mL"""
    cov: FloatArray
    """(3, 3)"""

    @classmethod
    def of(cls, problem: Problem, vector: FloatArray) -> Estimates:
        """From the expected information at the fit ``vector`` (n_theta,), noise included."""
        vector = vector.copy()
        mean = np.array([vector[0] ** 2, vector[1], vector[2]])
        # below this the derivative by the square keeps its limit
        flow = max(e.total_flow for e in problem.campaign)
        vector[0] = max(vector[0], 0.02 * min(vector[1], vector[2] / flow))
        low, high = vector - np.inf, vector + np.inf
        low[:3], high[:3] = 0.9 * vector[:3], 1.1 * vector[:3]
        longest = max(e.interval for e in problem.campaign)
        for i in problem.layout.local[:, 2:].ravel():
            if i >= 0:
                low[i], high[i] = vector[i] - 2.0 * longest, vector[i] + 2.0 * longest
        for row in problem.layout.noise:
            low[row], high[row[0]] = (-1.0, 0.0, 0.0), 1.0
        compressed = compress(problem, vector, Region(low, high))
        coordinates = Coordinates(problem)
        slopes, free = coordinates.slopes(vector), coordinates.free
        information = slopes.T @ compressed.information(vector)[np.ix_(free, free)] @ slopes
        return cls(mean, np.array(_inverse(information)[:3, :3]))

    def draw(self, n: int, rng: np.random.Generator) -> FloatArray:
        """(n, 3) shortest lag, longest lag (s) and V (mL), the lags by size."""
        # what the data say nothing of may be anything up to a thousand times its estimate
        known = np.isfinite(np.diag(self.cov))
        cov = np.where(np.outer(known, known), self.cov, 0.0)
        cov += np.diag(np.where(known, 0.0, (1e3 * self.mean) ** 2))
        values, vectors = np.linalg.eigh(cov)
        z = rng.standard_normal((n, 3)) * np.sqrt(np.maximum(values, 0.0))
        drawn: FloatArray = self.mean + z @ vectors.T
        drawn[:, 0] = np.sqrt(np.maximum(drawn[:, 0], 0.0))
        drawn = np.maximum(drawn, 0.0)
        drawn[:, :2] = np.sort(drawn[:, :2], axis=1)
        return drawn


def _inverse(information: FloatArray) -> FloatArray:
    """Covariance (n, n) of an information matrix, by its pseudo-inverse.

    A direction that it holds next to nothing of has a variance 1e12 times that of the others; a
    parameter that it holds nothing of at all an infinite one.
    """
    informed = np.diag(information) > 0.0
    some = np.flatnonzero(informed)
    scale = np.sqrt(np.diag(information)[some])
    values, vectors = np.linalg.eigh(information[np.ix_(some, some)] / np.outer(scale, scale))
    inverse = (vectors / np.maximum(values, 1e-12)) @ vectors.T
    found = np.diag(np.where(informed, 0.0, np.inf))
    found[np.ix_(some, some)] = inverse / np.outer(scale, scale)
    return found


@dataclass(frozen=True)
class Comparison:
    """One piece of side information beside what the data alone say."""

    name: str
    mean: float
    sd: float
    data: float
    """the data's own estimate, in the same unit"""
    data_sd: float
    """its standard deviation"""
    distance: float
    """between the two, in joint standard deviations"""
    known_lag: float | None = None
    """s, V/Q by side information where flows are equal"""

    @property
    def contradicts(self) -> bool:
        """Whether both cannot be right."""
        return self.distance > CONTRADICT

    def sentence(self) -> str:
        """Both values and their distance."""
        symbol, unit = SYMBOLS[self.name]
        data = f"{self.data:.4g} +- {self.data_sd:.2g} {unit}"
        if self.data < 2.0 * self.data_sd:
            data = f"less than {self.data + Z95 * self.data_sd:.3g} {unit} (95 %)"
        symbols = symbol if symbol == "tau" else f"{symbol} and tau"
        lag = ""
        if self.known_lag is not None:
            seen = self.data * self.known_lag / self.mean
            lag = f" (V/Q {self.known_lag:.4g} s expected, a lag of {seen:.4g} s seen)"
        return (
            f"side information and data contradict each other in {symbol}: {self.mean:.4g} +- "
            f"{self.sd:.2g} {unit} is given, the data alone say {data}{lag}, {self.distance:.3g} "
            f"joint standard deviations apart; do not quote {symbols} before one of the two is "
            "found to be wrong"
        )

    def to_json(self) -> dict[str, Any]:
        """Plain numbers."""
        return {
            "name": self.name,
            "mean": self.mean,
            "sd": self.sd,
            "data_mean": self.data,
            "data_sd": self.data_sd,
            "distance_sd": self.distance,
            "contradicts": self.contradicts,
        }


def weigh_names(problem: Problem, vector: FloatArray) -> tuple[Naming, tuple[Comparison, ...]]:
    """What is known of the names of the lags at a fit ``vector`` (n_theta,), lags by size; and each
    piece of side information beside the data's own estimate.

    Where several assignments of names are possible, each piece is compared under the one that
    suits all of them best.
    """
    known = {k: law for k, law in problem.named_laws.items() if law.kind == "normal"}
    if not problem.named_laws:
        return problem.naming(), ()
    estimates = Estimates.of(problem, vector)
    probabilities = None
    if len(problem.name_factors[1]):
        thetas = estimates.draw(N_DRAWS, np.random.default_rng(0))
        if problem.flow is not None:  # three lags by size
            lags = np.sort(lags_of(thetas, problem.flow), axis=1)
            thetas = np.stack([lags[:, 0], lags[:, 2], lags[:, 1] * problem.flow], axis=1)
        log_mean = np.logaddexp.reduce(problem.log_weights(thetas), axis=0)
        if np.isfinite(log_mean).any():
            probabilities = np.exp(log_mean - np.logaddexp.reduce(log_mean))
    return problem.naming(probabilities), _compare(problem, known, estimates)


def _compare(
    problem: Problem, known: dict[str, Prior], estimates: Estimates
) -> tuple[Comparison, ...]:
    best: tuple[Comparison, ...] = ()
    least = np.inf
    for choice in problem.assignments:
        places = {"tau_s": choice.sensor, "tau_v_s": choice.valve, "V_mL": choice.manifold}
        found = tuple(
            _beside(name, law, places[name], problem.flow, estimates) for name, law in known.items()
        )
        total = sum(each.distance**2 for each in found)
        if total < least:
            best, least = found, total
    return best


def _beside(
    name: str, law: Prior, place: int | None, flow: float | None, estimates: Estimates
) -> Comparison:
    """Side information on one parameter beside the lag, or the volume, that it speaks of."""
    # theta's place of a lag, and what makes the parameter of its value there
    position, factor = 2, 1.0
    if place is not None:
        position = (0, 1)[place] if flow is None else (0, 2, 1)[place]
        if flow is not None:
            factor = (1.0 / flow if position == 2 else 1.0) * (flow if name == "V_mL" else 1.0)
    value, sd = float(estimates.mean[position]), sqrt(float(estimates.cov[position, position]))
    if position == 0:  # compared in the square, where a lag near zero is nearly Gaussian
        own = law.a / factor
        joint = sqrt(sd**2 + (2.0 * own * law.b / factor) ** 2)
        distance = abs(value - own**2) / joint
        spread = sqrt(max(value + sd, 0.0)) - sqrt(max(value, 0.0))
        value, sd = sqrt(max(value, 0.0)) * factor, spread * factor
    else:
        value, sd = value * factor, sd * factor
        distance = abs(value - law.a) / sqrt(sd**2 + law.b**2)
    lag = law.a / flow if name == "V_mL" and flow is not None else None
    return Comparison(name, law.a, law.b, value, sd, distance, lag)


def named_parameters(naming: Naming, theta: FloatArray) -> dict[str, float]:
    """tau (s), tau_v (s) and V (mL) of ``theta`` (n_theta,) under the likeliest assignment, the
    sensor being the faster lag where several are equally so."""
    best = int(np.argmax(np.round(naming.probabilities, 9)))
    values = named(theta, naming.flow, naming.choices, best)
    return dict(zip(SYMBOLS, map(float, values), strict=True))
