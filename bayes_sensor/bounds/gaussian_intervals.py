"""From a Gaussian in psi = (tau^2, .., t0 + tau, tf + tau) to intervals of the parameters.

The data determine tau through tau^2, and tau is correlated with the switch times.  The covariance
of an estimator is therefore computed in psi, where it stays finite as tau goes to zero. tau^2 +- z
sd is transformed back and cut at zero; t0 and tf are the quantiles of (t0 + tau) - sqrt(tau^2).
Far from zero this is the usual estimate +- z sd.  The textbook bound uses that form when tau is
above three of its standard deviations.

The information on tau^2 falls as tau grows.  A fit that happens to be low would give too small an
upper limit, and a fit that is high too low a lower limit.  Where the spread is known as a function
of tau, tau^2 is therefore measured in units of its local spread: integral dx/sd(x) is nearly normal
with unit variance for any truth (Bartlett, Biometrics 3, 39, 1947; it is the distance of Rao, Bull.
Calcutta Math. Soc. 37, 81, 1945).
"""

from __future__ import annotations

from collections.abc import Callable
from math import erfc, sqrt
from typing import Any

import numpy as np
from scipy import special, stats

from bayes_sensor.bounds.bound import LEVELS, Bound
from bayes_sensor.campaign import FloatArray
from bayes_sensor.compiled import compiled
from bayes_sensor.likelihood.coordinates import Coordinates
from bayes_sensor.likelihood.mesh import Compressed, fastest_beside_tau
from bayes_sensor.rig.switching import is_switch_time

FAR = 3.0
"""tau in standard deviations above which estimate +- z sd is used"""
SINGULAR = 1e-10
"""smallest eigenvalue of scaled information that counts as information"""


def normal_factor(level: float) -> float:
    """z with P(|Z| < z) = level for a standard normal.

    >>> round(normal_factor(0.95), 3)
    1.96
    """
    return float(stats.norm.ppf(0.5 + 0.5 * level))


def invert(information: FloatArray) -> tuple[FloatArray, np.ndarray]:
    """Inverse of an information matrix (n, n), and (n,) whether each parameter is identified.

    Parameters that the data do not determine, alone or in a combination, get infinite variance.
    The variance of the others does not depend on them.
    """
    diagonal = np.diag(information)
    informed = diagonal > 0
    cov = np.zeros_like(information)
    cov[np.diag_indices(len(cov))] = np.inf
    some = np.flatnonzero(informed)
    if not len(some):
        return cov, informed
    scale = 1.0 / np.sqrt(diagonal[some])
    values, vectors = np.linalg.eigh(information[np.ix_(some, some)] * np.outer(scale, scale))
    lost = values < SINGULAR
    kept = (vectors[:, ~lost] / values[~lost]) @ vectors[:, ~lost].T
    cov[np.ix_(some, some)] = kept * np.outer(scale, scale)
    if lost.any():
        # a direction without information spoils every parameter that takes part in it
        spoiled = some[(np.abs(vectors[:, lost]) > 1e-4).any(axis=1)]
        informed[spoiled] = False
        cov[spoiled, spoiled] = np.inf
    return cov, informed


def least_tau(compressed: Compressed) -> float:
    """s, the smallest tau at which derivatives by tau^2 are taken on this mesh.

    Below it the sensor is a pure delay to rounding, and the derivative by tau^2 has its limit.
    """
    fastest = fastest_beside_tau(compressed.problem, compressed.reference)
    return float(max(1e-3 * fastest, 2.0 * compressed.arrays.setting[:, 4].max()))


def square_ends(
    q: float, z: FloatArray, taus: FloatArray, spreads: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Ends (n_levels,) of the values x >= 0 within z of q >= 0 as integral dx/sd(x) measures it.

    ``spreads`` (m,): sd(x) of estimates of tau^2 where tau is one of the rising ``taus`` (m,);
    linear in tau between and above them, constant below.

    >>> low, high = square_ends(4.0, np.array([1.0]), np.array([1.0, 2.0]), np.array([0.5, 0.5]))
    >>> [round(float(v), 2) for v in (low[0], high[0])]
    [3.5, 4.5]
    """
    slope = max((spreads[-1] - spreads[-2]) / (taus[-1] - taus[-2]), 0.0)
    middle = sqrt(max(q, 0.0))
    top = max(float(taus[-1]), 1.1 * middle)
    while True:
        tau = np.linspace(0.0, top, 2001)
        sd = np.interp(tau, taus, spreads) + slope * np.maximum(tau - taus[-1], 0.0)
        rate = 2.0 * tau / sd
        step = 0.5 * (rate[1:] + rate[:-1]) * (tau[1] - tau[0])
        distance = np.concatenate([[0.0], np.cumsum(step)])
        centre = float(np.interp(middle, tau, distance))
        if distance[-1] > centre + z.max():
            break
        top *= 1.5
    low: FloatArray = np.interp(centre - z, distance, tau) ** 2
    high: FloatArray = np.interp(centre + z, distance, tau) ** 2
    return low, high


def mean_positions(coordinates: Coordinates) -> np.ndarray:
    """Positions in psi of everything but the noise parameters."""
    noise = set(coordinates.problem.layout.noise_names)
    return np.array([i for i, name in enumerate(coordinates.names) if name not in noise])


def gaussian_bound(
    names: list[str],
    estimate: FloatArray,
    cov_psi: FloatArray,
    at_bound: bool = False,
    factor: Callable[[float], float | FloatArray] = normal_factor,
    identified: np.ndarray | None = None,
    status: str = "",
    details: dict[str, Any] | None = None,
    plain: bool = False,
    along_tau: tuple[FloatArray, FloatArray] | None = None,
) -> Bound:
    """Intervals for a Gaussian estimator with covariance ``cov_psi`` (n, n) of psi.

    ``names`` (n) flat names of the mean's parameters, ``estimate`` (n,) theta; ``at_bound``: tau's
    estimate is at its lower bound, so tau gets an upper limit and no sd; ``factor``: z of a level,
    one number or (n,); ``plain``: state estimate +- z sd for tau and the switch times where tau is
    far from zero; ``along_tau``: taus (m,) and the sd (m,) of tau^2 there, in the same measure as
    ``cov_psi``.
    """
    n = len(names)
    kinds = [name.split("[")[0] for name in names]
    identified = np.ones(n, dtype=bool) if identified is None else identified
    sentences = [status] if status else []
    sd = np.sqrt(np.diag(cov_psi))
    # (n, n_levels)
    z = np.stack([np.broadcast_to(factor(level), n) for level in LEVELS.values()], axis=1)
    in_square = False
    if names[0] == "tau_s":  # of several sensors psi holds the lags themselves
        tau, q, sd_q = float(estimate[0]), float(estimate[0]) ** 2, float(sd[0])
        switches = [i for i, kind in enumerate(kinds) if is_switch_time(kind)]
        if at_bound or sd_q > 2.0 * tau**2:
            sd[[0, *switches]] = np.nan
        else:
            slope = 1.0 / (2.0 * tau)
            for i in switches:
                variance = cov_psi[i, i] - 2.0 * slope * cov_psi[0, i] + slope**2 * cov_psi[0, 0]
                sd[i] = np.sqrt(max(variance, 0.0))
            sd[0] = sd_q / (2.0 * tau)
        far = plain and tau > FAR * sd[0]  # False for nan
        in_square = bool(identified[0]) and not far
    low, high = estimate[:, None] - z * sd[:, None], estimate[:, None] + z * sd[:, None]
    if in_square:
        square_low, square_high = np.maximum(q - z[0] * sd_q, 0.0), q + z[0] * sd_q
        below = above = np.ones(len(LEVELS))
        if along_tau is not None and np.isfinite(along_tau[1]).all():
            square_low, square_high = square_ends(q, z[0], *along_tau)
            # how much wider tau^2 is towards either end than about the estimate
            above = (square_high - q) / (z[0] * sd_q)
            below = np.where(square_low > 0.0, (q - square_low) / (z[0] * sd_q), 1.0)
        low[0], high[0] = np.sqrt(square_low), np.sqrt(square_high)
        for i in switches:
            low[i], high[i] = switch_quantiles(
                estimate[i] + tau, q, sd_q, cov_psi[i, i], cov_psi[0, i], z[i], below, above
            )
        if np.isnan(sd[0]):
            where = "at its lower bound" if at_bound else "within a spread of zero"
            sentences.append(
                f"tau's estimate is {where}: its interval is an upper limit, taken in tau^2"
            )
        elif plain:
            sentences.append("tau is within three spreads of zero: intervals taken in tau^2")
    lost = ~identified
    if lost.any():
        sd[lost], low[lost], high[lost] = np.nan, np.nan, np.nan
        missing = [name for name, gone in zip(names, lost) if gone]
        sentences.append(f"the data do not identify {', '.join(missing)}")
    sd, low, high = (np.where(np.isfinite(values), values, np.nan) for values in (sd, low, high))
    positive = [kind.startswith(("tau_", "V_")) for kind in kinds]
    low[positive] = np.maximum(low[positive], 0.0)
    return Bound(
        list(names), np.array(estimate, dtype=float), sd, low, high, "; ".join(sentences) or "ok",
        details or {},
    )  # fmt: skip


def switch_quantiles(
    centre: float,
    q: float,
    sd_q: float,
    variance: float,
    covariance: float,
    z: FloatArray,
    below: FloatArray | None = None,
    above: FloatArray | None = None,
) -> tuple[FloatArray, FloatArray]:
    """Quantiles at +-z of A - sqrt(max(X, 0)) for a Gaussian pair X (mean q), A (mean centre).

    ``below`` and ``above`` (n_levels,): factors of X's spread towards its low and high values,
    by level; a high X goes with a low quantile.
    """
    u = np.linspace(-7.0, 7.0, 701)
    weight = np.exp(-0.5 * u**2)
    weight /= weight.sum()
    slope = covariance / sd_q
    rest = np.sqrt(max(variance - slope**2, 1e-6 * variance, 1e-300))
    target = special.ndtr(np.concatenate([-z, z]))
    x = np.empty(len(target))
    factors = np.ones(len(target))
    if above is not None and below is not None:
        factors[: len(z)], factors[len(z) :] = above, below
    for factor in np.unique(factors):
        same = factors == factor
        found = np.empty(int(same.sum()))
        middle = centre + slope * u - np.sqrt(np.maximum(q + factor * sd_q * u, 0.0))
        _mixture_quantiles(middle, weight, rest, target[same], found)
        x[same] = found
    return x[: len(z)], x[len(z) :]


@compiled()
def _mixture_quantiles(
    middle: FloatArray, weight: FloatArray, rest: float, target: FloatArray, x: FloatArray
) -> None:
    # quantiles x of a mixture of normals of one spread, by bisection
    lowest, highest = middle[0], middle[0]
    for i in range(len(middle)):
        lowest, highest = min(lowest, middle[i]), max(highest, middle[i])
    lowest, highest = lowest - 9.0 * rest, highest + 9.0 * rest
    for k in range(len(target)):
        a, b = lowest, highest
        for _ in range(45):
            x[k] = 0.5 * (a + b)
            below = 0.0
            for i in range(len(middle)):
                distance = (x[k] - middle[i]) / rest
                if distance > 8.0:
                    below += weight[i]
                elif distance > -8.0:
                    below += weight[i] * 0.5 * erfc(-distance / sqrt(2.0))
            if below < target[k]:
                a = x[k]
            else:
                b = x[k]
