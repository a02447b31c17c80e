"""Estimates from the data alone of what side information and priors say, and whether both agree.

The fit uses neither. The data determine the squares of all lags, in any order, so
lags near zero and lags that are nearly equal are not Gaussian. The elementary symmetric polynomials
e_1 = z_1 + z_2 (+ z_3), e_2, .. of these squares z have a regular information matrix there, too.
They are therefore taken as Gaussian, with the information of the data under their own noise.  A lag
x is then a root of the polynomial

    P(x^2) = x^(2n) - e_1 x^(2n-2) + e_2 x^(2n-4) - .. = 0,

linear in the e. Its distance from the data is |P(x^2)| / sd(P(x^2)) standard deviations.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from math import sqrt
from typing import Any

import numpy as np
from scipy import optimize

from bayes_sensor.campaign import FloatArray
from bayes_sensor.io.json_files import plain
from bayes_sensor.likelihood.coordinates import Coordinates
from bayes_sensor.likelihood.mesh import expected_information
from bayes_sensor.likelihood.priors import Prior
from bayes_sensor.likelihood.problem import Problem
from bayes_sensor.rig.lags import Commuting, Naming

CONTRADICT = 3.0
"""joint standard deviations from which side information and data contradict each other"""
N_DRAWS = 20000
"""draws over which the assignments of the lags are averaged"""
Z95 = 1.6449
"""one-sided 95 % point of a standard normal"""
LEAST_APART = 0.05
"""relative half distance of two squares below which derivatives keep the limit for equal lags"""
N_GRID = 2001
"""values of a lag at which it is compared with side information"""


@dataclass(frozen=True, eq=False)
class Estimates:
    """Estimates from the data alone: the lags that commute, and the other shared parameters."""

    commuting: Commuting
    lags: FloatArray
    """(n_lags,) s, of the fit, shortest first"""
    others: FloatArray
    """(n_others,) of the fit, in their units, in the order of theta"""
    scale: float
    """s, the longest lag: squares are in units of its square"""
    cov: FloatArray
    """(n_shared, n_shared) of the symmetric polynomials and, behind them, the other parameters"""
    local: Mapping[str, tuple[float, float]]
    """baselines, steps and switch times of the fit by flat name, with standard deviations"""

    @classmethod
    def of(cls, problem: Problem, vector: FloatArray) -> Estimates:
        """From the expected information at the fit ``vector`` (n_theta,), noise included."""
        problem = replace(problem, held={})  # the data alone, whatever is held
        commuting, layout, vector = problem.commuting, problem.layout, vector.copy()
        n, n_lags, places = layout.n_shared, commuting.n_lags, list(commuting.places)
        rest = [i for i in range(n) if i not in places]
        lags, others = commuting.lags(vector), vector[rest].copy()
        scale = float(lags[-1]) if n_lags else 1.0
        if layout.one_sensor and layout.rig.n_lags > 1:
            # below this the derivative by the square keeps its limit
            fastest = min(
                float(np.delete(layout.taus(vector, k, e.total_flow), layout.rig.sensor_lag).min())
                for k, e in enumerate(problem.campaign)
            )
            vector[layout.tau] = max(vector[layout.tau], 0.02 * fastest)
        squares: FloatArray = apart_squares(commuting.lags(vector) ** 2)
        to_lag = np.array(commuting.to_lag)
        vector[places] = np.sqrt(squares) / to_lag
        coordinates = Coordinates(problem)
        slopes: FloatArray = coordinates.slopes(vector)
        free = coordinates.free
        information = slopes.T @ expected_information(problem, vector)[np.ix_(free, free)] @ slopes
        # from (tau_1^2, tau_2, V) to the squares and on to their polynomials
        to_ours = np.zeros((n, n))
        by_value = 2.0 * np.sqrt(squares) * to_lag
        if coordinates.shifts and places[:1] == [0]:
            by_value[0] = 1.0
        to_squares = np.zeros((n_lags, n))
        to_squares[range(n_lags), places] = by_value / scale**2
        to_ours[:n_lags] = polynomial_slopes(squares / scale**2) @ to_squares
        to_ours[range(n_lags, n), rest] = 1.0
        of_psi = covariance_of(information)
        cov = to_ours @ of_psi[:n, :n] @ to_ours.T
        variances = np.einsum("ij,jk,ik->i", slopes, of_psi, slopes)
        local = {
            layout.names[i]: (float(vector[i]), sqrt(variance))
            for i, variance in zip(free, variances, strict=True)
            if n <= i < layout.n_mean
        }
        return cls(commuting, lags, others, scale, cov, local)

    def other(self, name: str) -> tuple[float, float]:
        """A shared parameter whose lag does not commute, and its standard deviation."""
        commuting, n_lags = self.commuting, len(self.lags)
        rest = [i for i in range(len(commuting.shared)) if i not in commuting.places]
        place = rest.index(commuting.shared.index(name))
        variance = float(self.cov[n_lags + place, n_lags + place])
        return float(self.others[place]), sqrt(variance)

    @property
    def polynomials(self) -> FloatArray:
        """(n_lags,) e_1, e_2, .. of the fit."""
        found = np.array(-np.poly((self.lags / self.scale) ** 2)[1:], dtype=float)
        found[1::2] *= -1.0
        return found

    def away(self, lag: FloatArray) -> FloatArray:
        """(n,) standard deviations between the data and a lag (n,) s."""
        z = (np.asarray(lag, dtype=float) / self.scale) ** 2
        n = len(self.lags)
        # of (e_1, e_2, ..) in the polynomial
        factors = np.stack([(-1.0) ** k * z ** (n - k) for k in range(1, n + 1)], axis=-1)
        value = z**n + factors @ self.polynomials
        variance = np.einsum("...i,ij,...j", factors, self.cov[:n, :n], factors)
        found: FloatArray = np.abs(value) / np.sqrt(np.maximum(variance, 1e-300))
        return found

    def range_of(self, place: int) -> tuple[float, float]:
        """s, range of a lag with this place: half way, in squares, to its neighbours."""
        squares = self.lags**2
        ends = np.sqrt(0.5 * (squares[1:] + squares[:-1]))
        return float([0.0, *ends][place]), float([*ends, np.inf][place])

    def lag(self, place: int) -> tuple[float, float]:
        """The lag at this place and its standard deviation, s."""
        value = float(self.lags[place])
        ends = []
        for end in self.range_of(place):
            end = min(end, 10.0 * self.scale)
            if end != value and float(self.away(np.array(end))) > 1.0:
                end = optimize.brentq(lambda x: float(self.away(np.array(x))) - 1.0, value, end)
            ends.append(end)
        return value, 0.5 * (ends[1] - ends[0])

    def distance(self, place: int, law: Prior) -> float:
        """Joint standard deviations between the lag at this place and its ``law`` in s.

        The root of the least sum of both squared distances over all lags. A linearisation about
        the law's mean would reject one in ten pieces of right side information of 50 %.
        """
        low, high = self.range_of(place)
        towards = min(max(_nearest(law, float(self.lags[place])), low), high)
        lag = np.linspace(self.lags[place], towards, N_GRID)
        return sqrt(float(np.min(self.away(lag) ** 2 + law.away(lag) ** 2)))

    def draw(self, n: int, rng: np.random.Generator) -> FloatArray:
        """(n, n_shared) of theta's shared values, lags by size."""
        n_lags = len(self.lags)
        spread = np.sqrt(np.maximum(np.diag(self.cov), 1e-300))
        values, vectors = np.linalg.eigh(self.cov / np.outer(spread, spread))
        z = rng.standard_normal((n, len(self.cov))) * np.sqrt(np.maximum(values, 0.0))
        drawn = spread * (z @ vectors.T)
        found = np.empty((n, len(self.cov)))
        commuting = self.commuting
        rest = [i for i in range(len(self.cov)) if i not in commuting.places]
        found[:, rest] = np.maximum(self.others + drawn[:, n_lags:], 0.0)
        e = self.polynomials + drawn[:, :n_lags]
        companion = np.zeros((n, n_lags, n_lags))
        companion[:, 0] = e * (-1.0) ** np.arange(n_lags)
        companion[:, range(1, n_lags), range(n_lags - 1)] = 1.0
        # a complex pair stands for equal lags, a negative square for a lag of zero
        squares = np.sort(np.maximum(np.linalg.eigvals(companion).real, 0.0), axis=1)
        lags = self.scale * np.sqrt(squares)
        for j, (place, volume) in enumerate(zip(commuting.places, commuting.volumes, strict=True)):
            flow = commuting.flow if volume and commuting.flow is not None else 1.0
            found[:, place] = lags[:, j] * flow
        return found


def _nearest(law: Prior, value: float) -> float:
    """The most likely value of a law, or what is nearest to ``value`` inside one that is even."""
    if law.kind in ("normal", "log_normal"):
        return law.a
    low, high = (0.0, 0.0) if law.kind == "half_normal" else law.support
    return float(np.clip(value, low, high))


def apart_squares(squares: FloatArray) -> FloatArray:
    """Squares (n_lags,) by size, those nearly equal moved apart about their mean."""
    found = squares.copy()
    for i in range(len(found) - 1):
        middle = 0.5 * (found[i] + found[i + 1])
        if found[i + 1] - found[i] < 2.0 * LEAST_APART * middle:
            found[i], found[i + 1] = (1.0 - LEAST_APART) * middle, (1.0 + LEAST_APART) * middle
    return np.sort(found)


def polynomial_slopes(squares: FloatArray) -> FloatArray:
    """(n, n) derivatives of the elementary symmetric polynomials by the squares (n,): e_k without
    that square, one degree lower."""
    n = len(squares)
    found = np.empty((n, n))
    for j in range(n):
        found[:, j] = np.poly(-np.delete(squares, j))
    return found


def covariance_of(information: FloatArray) -> FloatArray:
    """Covariance (n, n) of an information matrix; directions without information have a huge
    variance, of which sums and products are still numbers."""
    scale = np.sqrt(np.maximum(np.diag(information), 1e-150))
    values, vectors = np.linalg.eigh(information / np.outer(scale, scale))
    inverse = (vectors / np.maximum(values, 1e-12)) @ vectors.T
    found: FloatArray = inverse / np.outer(scale, scale)
    return found


@dataclass(frozen=True)
class SideComparison:
    """One piece of side information, or a prior, and the estimate from the data alone."""

    name: str
    law: Prior
    data: float
    """the data's own estimate, in the same unit"""
    data_sd: float
    """its standard deviation"""
    distance: float
    """between the two, in joint standard deviations"""
    known_lag: float | None = None
    """s, V/Q by side information where flows are equal"""
    suits: float | None = None
    """s, another lag that it does not contradict"""

    @property
    def contradicts(self) -> bool:
        """Whether the two contradict each other."""
        return self.distance > CONTRADICT

    def sentence(self) -> str:
        """Both values and their distance."""
        kind, bracket, of = self.name.partition("[")
        symbol, unit = kind.rsplit("_", 1)
        symbol += bracket + of
        data = f"{self.data:.4g} +- {self.data_sd:.2g} {unit}"
        if self.data < 2.0 * self.data_sd:
            data = f"less than {self.data + Z95 * self.data_sd:.3g} {unit} (95 %)"
        symbols = symbol if symbol == "tau" else f"{symbol} and tau"
        other = ""
        if self.suits is not None:
            other = f", but it suits the other lag, of {self.suits:.4g} s: is sensor_is right?"
        lag = ""
        if self.known_lag is not None:
            seen = self.data * self.known_lag / self.law.a
            lag = f" (V/Q {self.known_lag:.4g} s expected, a lag of {seen:.4g} s seen)"
        source, given = "a prior", f"{self.law} {unit}"
        if self.law.kind == "normal":
            source, given = "side information", f"{self.law.a:.4g} +- {self.law.b:.2g} {unit}"
        apart = "for any lag of that place"
        if np.isfinite(self.distance):
            apart = f"{self.distance:.3g} joint standard deviations apart"
        return (
            f"{source} and data contradict each other in {symbol}: {given} is given, the data "
            f"alone say {data}{lag}, {apart}{other}; it is left out of the posterior: do not "
            f"quote {symbols} before one of the two is found to be wrong"
        )

    def to_json(self) -> dict[str, Any]:
        """Plain numbers."""
        return {
            "name": self.name,
            "mean": float(self.law.law.mean()),
            "sd": float(self.law.law.std()),
            "data_mean": self.data,
            "data_sd": self.data_sd,
            "distance_sd": plain(self.distance),
            "contradicts": self.contradicts,
        }


def stated_laws(problem: Problem) -> dict[str, Prior]:
    """What is compared with the data: side information and priors that were given, by flat name."""
    local = problem.layout.mean_names[problem.layout.n_shared :]
    given = {k: law for k, law in problem.given_laws.items() if k in local}
    return {k: law for k, law in {**problem.named_laws, **given}.items() if law.kind != "flat"}


def weigh_names(problem: Problem, vector: FloatArray) -> tuple[Naming, tuple[SideComparison, ...]]:
    """Assignments of the lags at a fit ``vector`` (n_theta,), lags by size, and each piece of side
    information, and each prior that was given, with the data's own estimate.

    If several assignments are possible, each piece is compared under the one that fits all of them
    best.  Priors of noise and of a model's own parameters are not compared.
    """
    known = stated_laws(problem)
    if not known:
        return problem.naming(), ()
    estimates = Estimates.of(problem, vector)
    compared = _compare(problem, known, estimates)
    problem = without_contradicted(problem, compared)  # what is wrong names nothing
    probabilities = None
    if len(problem.name_factors[1]):
        thetas = estimates.draw(N_DRAWS, np.random.default_rng(0))
        log_mean = np.logaddexp.reduce(problem.log_weights(thetas), axis=0)
        if np.isfinite(log_mean).any():
            probabilities = np.exp(log_mean - np.logaddexp.reduce(log_mean))
    return problem.naming(probabilities), compared


def without_contradicted(problem: Problem, compared: Sequence[SideComparison]) -> Problem:
    """The problem without the side information and the priors that the data contradict.

    An average of a right and a wrong value would be wrong.
    """
    wrong = {each.name for each in compared if each.contradicts}
    if not wrong:
        return problem
    known = problem.campaign.side_information
    campaign = replace(
        problem.campaign,
        side_information={name: info for name, info in known.items() if name not in wrong},
    )
    given = {name: law for name, law in problem.given_priors.items() if name not in wrong}
    return replace(problem, campaign=campaign, given_priors=given)


def _compare(
    problem: Problem, known: dict[str, Prior], estimates: Estimates
) -> tuple[SideComparison, ...]:
    best: tuple[SideComparison, ...] = ()
    least = np.inf
    for choice in problem.assignments:
        found = tuple(
            _beside(name, law, None if name in estimates.local else choice.place(name), estimates)
            for name, law in known.items()
        )
        total = sum(each.distance**2 for each in found)
        if not best or total < least:
            best, least = found, total
    return best


def _beside(name: str, law: Prior, place: int | None, estimates: Estimates) -> SideComparison:
    """Side information on one parameter, with the lag or the volume to which it refers."""
    if place is None:
        value, sd = estimates.local[name] if name in estimates.local else estimates.other(name)
        x = np.linspace(value, _nearest(law, value), N_GRID)
        distance = sqrt(float(np.min(((x - value) / sd) ** 2 + law.away(x) ** 2)))
        return SideComparison(name, law, value, sd, distance)
    flow = estimates.commuting.flow
    factor = flow if name.startswith("V_") and flow is not None else 1.0
    value, sd = (factor * each for each in estimates.lag(place))
    distance = estimates.distance(place, law.scaled(1.0 / factor))
    lag = law.a / factor if name.startswith("V_") and law.kind == "normal" else None
    suits = None
    if flow is None and len(estimates.lags) == 2:
        if estimates.distance(1 - place, law) < CONTRADICT:
            suits = float(estimates.lags[1 - place])
    return SideComparison(name, law, value, sd, distance, lag, suits)


def named_parameters(naming: Naming, theta: FloatArray) -> dict[str, float]:
    """The shared parameters of ``theta`` (n_theta,) under the likeliest assignment.

    The sensor is the faster lag where several are equally likely.
    """
    best = int(np.argmax(np.round(naming.probabilities, 9)))
    values = naming.commuting.named(theta, naming.choices, best)
    return dict(zip(naming.commuting.shared, map(float, values), strict=True))
