"""What a response time tells about the coating: its outer radius, its diffusivity."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import Any, Protocol, runtime_checkable

import numpy as np
from numpy.polynomial import chebyshev
from scipy.optimize import brentq
from scipy.special import ndtr, ndtri

from bayes_sensor.campaign import FloatArray
from bayes_sensor.coating.exponentials import modal
from bayes_sensor.coating.layers import EQUIVALENTS, Coating
from bayes_sensor.display import record_card


def find_outer_radius(tau63: float = 12.9e-3, coating: Coating | None = None) -> float:
    """m, the outer radius at which the probe reaches 63.2 % after tau63 (s).

    The default is the paper's 12.9 ms; the radius it implies is that of ``Coating()``.

    >>> round(1e6 * find_outer_radius(), 1)
    17.4
    """
    coating = Coating() if coating is None else coating

    def excess(log_side: float) -> float:
        outer = coating.ring_radius + math.exp(log_side)
        return modal(replace(coating, outer_radius=outer)).tau63 - tau63

    # Beyond 13 thicknesses the side no longer matters to the probe.
    nearest, farthest = (math.log(f * coating.thickness) for f in (0.02, 13.0))
    if excess(nearest) > 0 or excess(farthest) < 0:
        longest = modal(replace(coating, outer_radius=math.inf)).tau63
        raise ValueError(
            f"find_outer_radius: no radius gives {1e3 * tau63:g} ms; this coating reaches 63.2 % "
            f"after at most {1e3 * longest:.4g} ms, without a side"
        )
    return coating.ring_radius + math.exp(brentq(excess, nearest, farthest, xtol=1e-12))


DEFAULT_TOLERANCES: Mapping[str, float] = {
    "d_pdms": 0.2,
    "thickness_zif8": 0.1,
    "thickness_pdms": 0.1,
    "outer_radius": 0.0,
}
"""relative standard deviation of what is not known exactly about the coating"""

_TRUNCATION = 4.0  # standard deviations at which the tolerances end


@runtime_checkable
class Law(Protocol):
    """A distribution with the methods of a frozen ``scipy.stats`` law that are used here."""

    def cdf(self, x: Any, /) -> Any: ...
    def sf(self, x: Any, /) -> Any: ...
    def ppf(self, q: Any, /) -> Any: ...


@dataclass(frozen=True, eq=False)
class TauMap:
    """A smooth map from diffusivity and dimensions to a response time, for thousands of draws.

    log(tau) is a Chebyshev polynomial in log(D_ZIF8/D_PDMS) and the logarithms of those
    dimensions that have a tolerance; D_PDMS itself only scales time.
    """

    coating: Coating
    names: tuple[str, ...]
    """dimensions that vary"""
    half_width: tuple[float, ...]
    """of log(dimension / nominal), one per name"""
    coefficients: FloatArray
    """(n_x, n_1, ..) Chebyshev coefficients of log(tau / s) at nominal D_PDMS"""
    max_error: float
    """largest relative error of tau against :func:`modal` at points between the nodes"""

    D_RANGE = (1e-13, 1e-7)
    """m2/s at nominal D_PDMS, where the polynomial holds"""

    @property
    def centre_and_half(self) -> tuple[float, float]:
        """Centre and half width of log D_ZIF8 (at nominal D_PDMS)."""
        low, high = np.log(self.D_RANGE)
        return (low + high) / 2, (high - low) / 2

    def at(self, logs: FloatArray) -> FloatArray:
        """(n, n_x) coefficients in D alone, for ``logs`` (n_names, n) of dimension / nominal."""
        result = np.broadcast_to(self.coefficients, (logs.shape[1], *self.coefficients.shape))
        for log, half in zip(logs[::-1], self.half_width[::-1], strict=True):
            vander = chebyshev.chebvander(log / half, result.shape[-1] - 1)
            result = np.einsum("n...k,nk->n...", result, vander)
        return result

    def log_tau(self, log_d: FloatArray, coefficients: FloatArray) -> FloatArray:
        """(n,) log(tau) at log D_ZIF8 (n,), given :meth:`at`; tau goes as 1/D below range."""
        centre, half = self.centre_and_half
        x = np.clip((log_d - centre) / half, -1.0, 1.0)
        value: FloatArray = np.sum(
            chebyshev.chebvander(x, coefficients.shape[1] - 1) * coefficients, axis=1
        )
        # Below the range PDMS takes no time and tau goes as h^2/D.
        value = value + np.maximum(centre - half - log_d, 0.0)
        return value

    def invert(self, log_tau: FloatArray, coefficients: FloatArray) -> FloatArray:
        """(n,) log D_ZIF8 at which log(tau) is met; +inf beyond the top of the range."""
        centre, half = self.centre_and_half
        low = np.full(len(log_tau), centre - half)
        slowest = self.log_tau(low, coefficients)
        low = low - np.maximum(log_tau - slowest, 0.0)
        high = np.full(len(log_tau), centre + half)
        none_left = log_tau <= self.log_tau(high, coefficients)
        for _ in range(48):
            middle = (low + high) / 2
            too_slow = self.log_tau(middle, coefficients) > log_tau
            low, high = np.where(too_slow, middle, low), np.where(too_slow, high, middle)
        return np.where(none_left, np.inf, (low + high) / 2)


DEGREE = 8
"""of the elements across the layers, for times to 1e-8"""


@lru_cache(maxsize=16)
def tau_map(
    coating: Coating, half_width: tuple[tuple[str, float], ...] = (), equivalent: str = "tau63"
) -> TauMap:
    """Build a :class:`TauMap` from modal solves at Chebyshev nodes, and check it between them.

    ``half_width`` lists the dimensions that vary with the half width of their logarithm;
    ``equivalent`` is the response time mapped, one of :data:`EQUIVALENTS`.
    """
    names = tuple(name for name, _ in half_width)
    widths = tuple(width for _, width in half_width)

    def log_tau(log_d: float, logs: Sequence[float]) -> float:
        changed = {
            name: getattr(coating, name) * math.exp(log)
            for name, log in zip(names, logs, strict=True)
        }
        response = modal(replace(coating, d_zif8=math.exp(log_d), **changed), DEGREE)
        return math.log(getattr(response, equivalent))

    blank = TauMap(coating, names, widths, np.zeros(1), 0.0)
    centre, half = blank.centre_and_half
    # Degrees that leave errors near 1e-4: the bend of log tau in log D is sharp, in the
    # dimensions it is close to a straight line.
    sizes = [29] + [5 if width < 0.5 else 8 for width in widths]
    nodes = [chebyshev.chebpts1(size) for size in sizes]
    values = np.empty(sizes)
    for index in np.ndindex(*sizes):
        x = [axis[i] for axis, i in zip(nodes, index, strict=True)]
        logs = [u * width for u, width in zip(x[1:], widths, strict=True)]
        values[index] = log_tau(centre + half * x[0], logs)
    for axis, (points, size) in enumerate(zip(nodes, sizes, strict=True)):
        to_coefficients = np.linalg.inv(chebyshev.chebvander(points, size - 1))
        values = np.moveaxis(np.tensordot(to_coefficients, values, (1, axis)), 0, axis)
    built = replace(blank, coefficients=values)

    between = np.random.default_rng(0).uniform(-1, 1, (40, len(sizes)))
    log_d = centre + half * between[:, 0]
    logs = between[:, 1:].T * np.array(widths)[:, None]
    guess = built.log_tau(log_d, built.at(logs))
    truth = np.array([log_tau(d, row) for d, row in zip(log_d, logs.T, strict=True)])
    return replace(built, max_error=float(np.abs(np.expm1(guess - truth)).max()))


@dataclass(frozen=True, eq=False)
class DiffusivityPosterior:
    """What a posterior of tau says about the diffusivity of ZIF-8; see :func:`infer_d_zif8`."""

    _repr_html_ = record_card

    d_zif8: FloatArray
    """(n_draws,) m2/s; +inf where tau is too short for any resistance of ZIF-8"""
    tau: FloatArray
    """(n_draws,) s, the draws of tau used"""
    tau_literature: FloatArray
    """(n_draws,) s, the response time at the literature value, over the tolerances"""
    d_literature: float
    """m2/s"""
    tail_probability: float
    """two-sided: 2 min(P(D <= D_lit), P(D >= D_lit)), at most 1"""
    tail_resolution: float
    """smallest tail probability the draws of tau can show; 0 for a law"""
    tolerances: Mapping[str, float]
    equivalent: str
    """which response time stands for tau"""
    map_error: float
    """largest relative error of the map from D to tau"""

    @property
    def fraction_unbounded(self) -> float:
        """Share of draws with no finite diffusivity (tau shorter than at the top of the map)."""
        return float(np.mean(np.isinf(self.d_zif8)))

    def interval(self, level: float = 0.95) -> tuple[float, float]:
        """Equal-tailed interval of D_ZIF8, m2/s; an end may be +inf."""
        return _equal_tailed(self.d_zif8, level)

    @property
    def median(self) -> float:
        """m2/s, may be +inf."""
        return float(np.quantile(self.d_zif8, 0.5, method="inverted_cdf"))

    def ratio_interval(self, level: float = 0.95) -> tuple[float, float]:
        """Equal-tailed interval of tau over the response time at the literature value."""
        return _equal_tailed(self.tau / self.tau_literature, level)

    @property
    def ratio(self) -> float:
        """Median of tau over the response time at the literature value; 1 where they agree."""
        return float(np.median(self.tau / self.tau_literature))

    @property
    def sentence(self) -> str:
        """The verdict in words."""
        low, high = self.interval()
        # Farther out the answer is the assumed shape of the tails, not the data.
        floor = max(self.tail_resolution, 1e-6)
        p = max(self.tail_probability, floor)
        at_most = "at most " if self.tail_probability <= floor else ""
        inside = low <= self.d_literature <= high
        upper = f"{high:.2g}" if math.isfinite(high) else "no upper limit"
        return (
            f"D_ZIF8 is {low:.2g} to {upper} m2/s at 95 %; the literature value "
            f"{self.d_literature:.3g} m2/s lies {'inside' if inside else 'outside'} "
            f"(two-sided tail probability {at_most}{p:.2g})."
        )

    def to_json(self) -> dict[str, Any]:
        """Summary with units in the keys; null where an end is unbounded."""

        def finite(x: float) -> float | None:
            return x if math.isfinite(x) else None

        result: dict[str, Any] = {"d_zif8_m2_per_s": {"median": finite(self.median)}}
        for label, level in (("68", 0.68), ("95", 0.95), ("997", 0.997)):
            low, high = self.interval(level)
            result["d_zif8_m2_per_s"] |= {f"lo{label}": finite(low), f"hi{label}": finite(high)}
        low, high = self.ratio_interval()
        literature_low, literature_high = _equal_tailed(self.tau_literature, 0.95)
        return result | {
            "d_literature_m2_per_s": self.d_literature,
            "tau_literature_ms": {
                "median": 1e3 * float(np.median(self.tau_literature)),
                "lo95": 1e3 * literature_low,
                "hi95": 1e3 * literature_high,
            },
            "ratio": {"median": self.ratio, "lo95": low, "hi95": high},
            "tail_probability": self.tail_probability,
            "tail_resolution": self.tail_resolution,
            "fraction_unbounded": self.fraction_unbounded,
            "tolerances": dict(self.tolerances),
            "equivalent": self.equivalent,
            "map_error": self.map_error,
            "sentence": self.sentence,
        }


def _equal_tailed(draws: FloatArray, level: float) -> tuple[float, float]:
    # A draw, not a mix of two: mixing with an infinite one gives NaN.
    ends = np.quantile(draws, [(1 - level) / 2, (1 + level) / 2], method="inverted_cdf")
    return float(ends[0]), float(ends[1])


def infer_d_zif8(
    tau: FloatArray | Law,
    coating: Coating | None = None,
    *,
    tolerances: Mapping[str, float] | None = None,
    equivalent: str = "tau63",
    n_draws: int = 20_000,
    seed: int | np.random.Generator = 0,
) -> DiffusivityPosterior:
    """Posterior of the ZIF-8 diffusivity from a posterior of the sensor's time constant.

    D_PDMS, the thicknesses and the outer radius are log-normal around the coating's values with
    the relative standard deviations in ``tolerances`` (:data:`DEFAULT_TOLERANCES`, truncated at
    four standard deviations), independent of tau.  For every joint draw the equation
    tau63(D_ZIF8, dimensions, D_PDMS) = tau is solved for D_ZIF8.  The prior on D_ZIF8 is thus
    the one that the prior on tau implies.  A draw of tau so short that it would take more than
    1e-7 m2/s (24 times PDMS) counts as an infinite diffusivity.

    The statistic that judges the literature value (the ``d_zif8`` of ``coating``) is the
    two-sided posterior tail probability p = 2 min(P(D <= D_lit), P(D >= D_lit)), equivalently
    2 min(P(tau >= tau_lit), P(tau <= tau_lit)) with tau_lit the response time at D_lit over the
    tolerances.  It is no p-value of a test on fresh data and no probability that D_lit is true.
    It is computed over all pairs of tau and dimensions, so that draws resolve
    ``tail_resolution`` = 2 / number of draws.

    Parameters
    ----------
    tau
        (n,) s, posterior draws; or a frozen ``scipy.stats`` law in seconds, cut at 0.  The
        published 48.1 ms with its 3 sigma bound of 5.6 ms is ``norm(0.0481, 0.0056 / 3)``.
    tolerances
        Replaces single entries of the default.
    equivalent
        Which response time of the coating stands for tau: "tau63" (the paper's), "tau_fit" or
        "tau_moment".

    >>> from scipy.stats import norm
    >>> published = infer_d_zif8(norm(0.0481, 0.0056 / 3), seed=1)
    >>> published.tail_probability < 1e-3
    True

    Raises
    ------
    ValueError
        If tau holds no positive draw, or a tolerance is unknown, negative or too large.
    """
    coating = Coating() if coating is None else coating
    spreads = _checked_tolerances(coating, tolerances)
    if equivalent not in EQUIVALENTS:
        raise ValueError(
            f"infer_d_zif8: equivalent must be one of {', '.join(EQUIVALENTS)}, got '{equivalent}'"
        )
    rng = np.random.default_rng(seed)
    if isinstance(tau, Law):
        below = float(tau.cdf(0.0))
        if not below < 1 - 1e-9:
            raise ValueError(
                "infer_d_zif8: the law of tau has no mass above 0 s; give it in seconds"
            )
        tau_draws = np.asarray(tau.ppf(rng.uniform(below, 1.0, n_draws)), dtype=float)
        tau_draws = np.maximum(tau_draws, 1e-12)
    else:
        given = np.asarray(tau, dtype=float).ravel()
        if len(given) < 2 or not np.isfinite(given).all() or not (given >= 0).all():
            raise ValueError(
                f"infer_d_zif8: expected at least 2 finite draws of tau in s, none negative, got "
                f"{len(given)} with smallest {given.min() if len(given) else 'none'}"
            )
        n_draws = max(n_draws, len(given))
        tau_draws = np.maximum(given[np.arange(n_draws) % len(given)], 1e-12)

    log_sd = {name: math.sqrt(math.log1p(spread**2)) for name, spread in spreads.items()}
    edge = ndtr(-_TRUNCATION)
    logs = {name: sd * ndtri(rng.uniform(edge, 1 - edge, n_draws)) for name, sd in log_sd.items()}
    varying = tuple(
        (name, _TRUNCATION * sd) for name, sd in log_sd.items() if name != "d_pdms" and sd > 0
    )
    table = tau_map(coating, varying, equivalent)
    # Time scales with 1/D_PDMS at a fixed ratio of the diffusivities.
    shift = logs["d_pdms"]
    coefficients = table.at(np.reshape([logs[name] for name in table.names], (-1, n_draws)))
    log_d = table.invert(np.log(tau_draws) + shift, coefficients) + shift
    log_literature = np.full(n_draws, math.log(coating.d_zif8)) - shift
    tau_literature = np.exp(table.log_tau(log_literature, coefficients) - shift)

    if isinstance(tau, Law):
        shorter = float(np.mean((np.asarray(tau.cdf(tau_literature)) - below) / (1 - below)))
        longer = float(np.mean(np.asarray(tau.sf(tau_literature)) / (1 - below)))
        resolution = 0.0
    else:
        ordered = np.sort(given)
        shorter = float(np.mean(np.searchsorted(ordered, tau_literature, "right"))) / len(given)
        longer = 1 - float(np.mean(np.searchsorted(ordered, tau_literature, "left"))) / len(given)
        resolution = 2 / len(given)
    return DiffusivityPosterior(
        d_zif8=np.exp(log_d),
        tau=tau_draws,
        tau_literature=tau_literature,
        d_literature=coating.d_zif8,
        tail_probability=min(2 * min(shorter, longer), 1.0),
        tail_resolution=resolution,
        tolerances=spreads,
        equivalent=equivalent,
        map_error=table.max_error,
    )


def _checked_tolerances(
    coating: Coating, tolerances: Mapping[str, float] | None
) -> dict[str, float]:
    """The default tolerances with those given put in, or a ValueError."""
    spreads = dict(DEFAULT_TOLERANCES)
    for name, value in (tolerances or {}).items():
        if name not in spreads:
            raise ValueError(
                f"infer_d_zif8: there is no tolerance '{name}'; known: {', '.join(spreads)}"
            )
        if not 0 <= value <= 0.5:
            raise ValueError(
                f"infer_d_zif8: the tolerance of {name} must lie between 0 and 0.5 (relative "
                f"standard deviation), got {value}"
            )
        spreads[name] = float(value)
    if math.isinf(coating.outer_radius):
        spreads["outer_radius"] = 0.0
    smallest = coating.outer_radius * math.exp(
        -_TRUNCATION * math.sqrt(math.log1p(spreads["outer_radius"] ** 2))
    )
    if smallest < 1.05 * coating.ring_radius:
        raise ValueError(
            f"infer_d_zif8: with a tolerance of {spreads['outer_radius']:g} the outer radius would "
            f"reach down to {1e6 * smallest:.3g} um, with the ring at "
            f"{1e6 * coating.ring_radius:.3g} um; give a smaller tolerance"
        )
    return spreads
