"""Profile likelihood under the campaign's own noise: asymmetric intervals that respect tau > 0.

The interval at a level holds the values v with 2 (max log L - max over the rest at v) below that
quantile of chi-squared with one degree of freedom (Venzon and Moolgavkar, Appl. Statist. 37, 1988;
Pawitan, In All Likelihood, 2001, ch. 3).  If tau = 0 is not excluded, the interval starts at zero,
and the chi-squared quantile is conservative (Self and Liang, J. Amer. Statist. Assoc. 82, 1987).

The response does not change when tau and tau_v are exchanged; the sensor is taken to be the faster
one.  The profile of either is therefore over the other with tau <= tau_v.  For every other
parameter both orders give the same.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from math import inf, nan, sqrt

import numpy as np

from bayes_sensor.bounds.gaussian_intervals import invert
from bayes_sensor.bounds.likelihood_surface import (
    Curvature,
    Maximum,
    Surface,
    curvature_along_tau,
    maximise,
)
from bayes_sensor.campaign import FloatArray

CLOSE = 2e-3
"""tolerance of sqrt(2 (drop in log L)) at its target"""


@dataclass(frozen=True, eq=False)
class Profiler:
    """Profiles of one likelihood about its maximum."""

    surface: Surface
    maximum: Maximum
    curvature: Curvature
    """expected information (n_psi, n_psi) at any psi"""
    cov: FloatArray
    """(n_psi, n_psi) inverse of the information near the maximum"""

    @classmethod
    def of(cls, surface: Surface, maximum: Maximum) -> Profiler:
        """Of a surface and its maximum."""
        information = surface.information(surface.expansion(maximum.psi))
        cov = invert(information)[0]
        curvature = curvature_along_tau(surface, maximum.psi)
        return cls(surface, maximum, curvature, np.where(np.isfinite(cov), cov, 0.0))

    def best(self, i: int, value: float, near: FloatArray | None = None) -> Maximum:
        """Maximum over everything else with psi's parameter ``i`` held at ``value``.

        ``value`` is tau^2 for tau, and t0 or tf themselves (not t0 + tau) for the switch times;
        there tau is exchanged for t0, and t0 + tau changes with it. tau stays below tau_v if one of
        the two is held.  The search starts at the Gaussian approximation, or at ``near`` (n_psi,),
        the maximum at another value.
        """
        psi, surface = self.maximum.psi, self.surface
        rest = np.array([j for j in range(len(psi)) if j != i])
        if i in surface.coordinates.switches:
            return self._best_switch(i, value, rest, near)
        start = psi + self._slope(i) * (value - psi[i]) if near is None else near.copy()
        start[i] = value
        low, high = self._box(i)
        self._keep_in_order(i, value, low, high)
        if (low > high).any():  # the mesh covers no point in that order
            return Maximum(start, -inf, start, False)
        return maximise(
            surface.guarded, self.curvature, start, rest, low, high, n_iterations=25,
            tolerance=1e-5,
        )  # fmt: skip

    def _keep_in_order(self, i: int, value: float, low: FloatArray, high: FloatArray) -> None:
        """Narrow the box so that lags stay by size where one of them is held at ``value``."""
        places = list(self.surface.problem.commuting.without_volumes.places)
        if i not in places or not self.surface.coordinates.shifts:
            return
        own = places.index(i)
        lag = sqrt(max(value, 0.0)) if i == 0 else value
        for longer in places[own + 1 :]:
            low[longer] = max(low[longer], lag)
        for shorter in places[:own]:
            high[shorter] = min(high[shorter], lag**2 if shorter == 0 else lag)

    def _slope(self, i: int) -> FloatArray:
        # (n_psi,) how a Gaussian's best rest follows psi's parameter i; 0 where nothing is known
        own = self.cov[i, i]
        return self.cov[:, i] / own if own > 0.0 else np.zeros(len(self.cov))

    def _box(self, i: int) -> tuple[FloatArray, FloatArray]:
        # what is held may stand anywhere
        low, high = (bound.copy() for bound in self.surface.box)
        low[i], high[i] = -inf, inf
        return low, high

    def _best_switch(
        self, i: int, value: float, rest: np.ndarray, near: FloatArray | None
    ) -> Maximum:
        # phi = psi, but tau in the place of tau^2 and the switch time itself in that of t0 + tau
        psi, surface = self.maximum.psi, self.surface
        floor, ceiling = self._box(i)
        floor[0], ceiling[0] = sqrt(floor[0]), sqrt(ceiling[0])
        tau = max(psi[i] - value, floor[0])

        def to_psi(phi: FloatArray) -> FloatArray:
            point = phi.copy()
            point[0] = phi[0] ** 2
            point[i] = phi[i] + phi[0]
            return point

        def objective(phi: FloatArray) -> tuple[float, FloatArray]:
            found, g = surface.guarded(to_psi(phi))
            g = g.copy()
            g[0] = 2.0 * phi[0] * g[0] + g[i]
            return found, g

        def curvature(phi: FloatArray) -> FloatArray:
            matrix = self.curvature(to_psi(phi))
            # T'MT with T the identity but T_00 = 2 tau and T_i0 = 1
            matrix[0] = 2.0 * phi[0] * matrix[0] + matrix[i]
            matrix[:, 0] = 2.0 * phi[0] * matrix[:, 0] + matrix[:, i]
            return matrix

        if near is None:
            start = psi + self._slope(0) * (tau**2 - psi[0])
            start[0] = tau
        else:
            start = near.copy()
            start[0] = sqrt(max(near[0], floor[0] ** 2))
        start[i] = value
        found = maximise(
            objective, curvature, start, rest, floor, ceiling, n_iterations=25, tolerance=1e-5
        )
        return replace(found, psi=to_psi(found.psi))

    def at(self, i: int, value: float, near: FloatArray | None = None) -> Point:
        """The profile at ``value``, see :meth:`best`."""
        best = self.best(i, value, near)
        fall = 2.0 * (self.maximum.value - best.value)
        drop = sqrt(max(fall, 0.0)) if np.isfinite(fall) else inf
        return Point(value, drop, best.psi)

    def drop(self, i: int, value: float) -> float:
        """sqrt(2 (max log L - profile)) at ``value``; infinite outside the mesh."""
        return self.at(i, value).drop

    def ends(
        self, i: int, centre: float, guesses: list[float], targets: list[float]
    ) -> list[float]:
        """Where :meth:`drop` reaches each target (rising), on the side of ``guesses``; nan where it
        cannot be found.

        The likelihood may have two maxima over the other parameters (tau at zero and above).  If
        the profile seems to jump, each is followed from its neighbour, and the higher one counts.
        """
        if not self.cov[i, i] > 0.0:  # the data hold nothing about it: there is no end
            return [nan] * len(targets)
        known = [Point(centre, 0.0, self.maximum.psi)]
        found = []
        for guess, target in zip(guesses, targets):
            end = nan
            for attempt in range(20):
                below, above = _bracket(known, target)
                if above is not None and attempt >= 4:
                    again = self.at(i, above.value, below.psi)
                    if again.drop < above.drop - CLOSE:
                        known[known.index(above)] = again
                        below, above = _bracket(known, target)
                value = next_value(centre, below, above, guess, target)
                if value is None:
                    break
                point = self.at(i, value)
                if attempt >= 4:
                    point = min(point, self.at(i, value, below.psi), key=lambda p: p.drop)
                known.append(point)
                known.sort(key=lambda p: abs(p.value - centre))
                if abs(point.drop - target) < CLOSE:
                    end = value
                    break
            found.append(end)
        return found


@dataclass(frozen=True, eq=False)
class Point:
    """One value of a profiled parameter."""

    value: float
    drop: float
    """sqrt(2 (max log L - profile))"""
    psi: FloatArray
    """(n_psi,) with the other parameters at their maximum"""


def _bracket(known: list[Point], target: float) -> tuple[Point, Point | None]:
    """The farthest point whose drop is below the target, and the nearest beyond it above it."""
    centre = known[0].value
    below = max((p for p in known if p.drop < target), key=lambda p: abs(p.value - centre))
    beyond = [
        p for p in known if p.drop >= target and abs(p.value - centre) > abs(below.value - centre)
    ]
    return below, min(beyond, key=lambda p: abs(p.value - centre), default=None)


def next_value(
    centre: float, below: Point, above: Point | None, guess: float, target: float
) -> float | None:
    """The next value to try; None where the bracket has closed."""
    if above is None:
        if below.value == centre:
            return guess
        stretch = min(max(1.02 * target / max(below.drop, 1e-9), 1.05), 3.0)
        return float(centre + stretch * (below.value - centre))
    if abs(above.value - below.value) < 1e-9 * abs(above.value - centre):
        return None
    share = (
        0.5 if not np.isfinite(above.drop) else (target - below.drop) / (above.drop - below.drop)
    )
    return float(below.value + min(max(share, 0.02), 0.98) * (above.value - below.value))


def profile_curve(profiler: Profiler, taus: FloatArray, place: int = 0) -> FloatArray:
    """(n,) drop in log-likelihood (max log L - profile) at each value (n,) s of the lag that stands
    at ``place`` in theta (0: the shortest)."""
    values = np.asarray(taus, dtype=float)
    if place == 0:
        values = np.maximum(values**2, profiler.surface.floor[0])
    return np.array([0.5 * profiler.drop(place, float(value)) ** 2 for value in values])
