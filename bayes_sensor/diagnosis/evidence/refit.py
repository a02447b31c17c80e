"""Refits of the binned campaign under a hypothesis: the model, with none, one or more effects.

Levenberg-Marquardt in the coordinates of a plan, on whitened bin means.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from math import exp, inf, isfinite, log

import numpy as np
from numpy.typing import NDArray
from scipy.linalg.lapack import dposv

from bayes_sensor.campaign import FloatArray
from bayes_sensor.diagnosis.data.binned_campaign import BinnedCampaign
from bayes_sensor.diagnosis.evidence.block_least_squares import (
    broyden_update,
    inverted,
    normal_equations,
)
from bayes_sensor.diagnosis.evidence.chain_coordinates import coordinates_of
from bayes_sensor.diagnosis.evidence.coordinate_priors import FASTER
from bayes_sensor.diagnosis.evidence.leverage import Leverage
from bayes_sensor.diagnosis.evidence.refit_coordinates import Coordinates

STRAIGHT = 0.25
"""share of the promised gain that a step must make for the derivatives to be carried on"""
ALIKE = 0.5
"""distance, squared and in standard deviations, below which two optima are taken for one"""
PATIENCE, FAR = 4, 60.0
"""steps after which a refit that expects to end so far above another one is given up"""
FINER = 0.01
"""factor on the differences' steps where the usual ones lead nowhere"""
BEYOND, HELD_BACK = 3.0, 1.0
"""spreads of its prior that an amplitude must have, and standard deviations, squared, by which that
prior must pull it, to be sought again under a looser one"""


@dataclass(frozen=True, eq=False)
class Refit:
    """The optimum of one hypothesis, with its linearisation."""

    coords: Coordinates
    x: FloatArray
    residual: FloatArray
    """(n_bins in all,) whitened"""
    objective: float
    """residual'residual + prior"""
    converged: bool

    @property
    def misfit(self) -> float:
        """Q, squared whitened residual."""
        return float(self.residual @ self.residual)

    @cached_property
    def derivatives(self) -> FloatArray:
        """(n_bins in all, n_columns) :meth:`Coordinates.derivatives`, worked out when asked for.

        Always by the usual differences, which smooth over the bins' nodes: evidences rest on them.
        """
        return self.coords.derivatives(self.x, self.coords.all_means(self.x))

    @cached_property
    def jacobian(self) -> FloatArray:
        """(n_bins in all, n) dense."""
        made = np.zeros((len(self.residual), self.coords.size))
        for k, rows in enumerate(self.coords.binned.rows):
            columns = self.coords.columns(k)
            made[rows, columns] = self.derivatives[rows, : len(columns)]
        return made

    @property
    def normal(self) -> FloatArray:
        """(n, n) normal matrix, of the data and of the priors at their stated spreads."""
        made: FloatArray = self.jacobian.T @ self.jacobian + self.coords.own_prior_matrix
        return made

    @cached_property
    def covariance(self) -> FloatArray:
        """(n, n) inverse of the normal matrix."""
        return inverted(self.normal)

    @cached_property
    def leverage(self) -> Leverage:
        """What the refit leaves of noise."""
        prior, at_limit = self.coords.own_prior_matrix, self.coords.at_limit(self.x)
        return Leverage.of(self.jacobian, prior, self.covariance, at_limit)

    @cached_property
    def loosened(self) -> Refit:
        """The refit with wider priors for those amplitudes that theirs hold back.

        An amplitude far beyond its plausible size is pulled back by its prior, by a small share of
        itself that may be many standard deviations: a trace of the effect stays in the residual,
        and other parameters make up for the rest of it.
        """
        loose = self.coords.loose | self._held_back()
        if loose == self.coords.loose:
            return self
        return refit(replace(self.coords, loose=loose), self.x, most_steps=60)

    def _held_back(self) -> set[str]:
        away, prior = self.x - self.coords.prior_centre, self.coords.own_prior_matrix
        far = [
            (name, here)
            for name, here in self.coords.amplitudes.items()
            if np.mean(away[here] ** 2) >= BEYOND**2
        ]
        if not far:  # as a rule; the covariance is not needed then
            return set()
        covariance = self.covariance
        found = set()
        for name, here in far:
            pull = prior[np.ix_(here, here)] @ away[here]
            if float(pull @ covariance[np.ix_(here, here)] @ pull) > HELD_BACK:
                found.add(name)
        return found

    @property
    def tau(self) -> float:
        """s"""
        return self.coords.tau_of(self.x)

    @property
    def lags(self) -> tuple[float, float]:
        """s, the shorter and the longer of tau and tau_v of the published rig."""
        return self.coords.lags_of(self.x)

    @property
    def tau_v(self) -> float:
        """s, of the published rig."""
        return self.lags[1 - self.coords.binned.sensor]

    def strength(self) -> dict[str, float | dict[str, float]]:
        """The fitted strengths by name; per-experiment ones as a mapping."""
        made: dict[str, float | dict[str, float]] = {}
        campaign = self.coords.binned.campaign
        for part, strengths in enumerate(self.coords.strengths):
            for s in strengths:
                if s.per_experiment:
                    made[s.name] = {
                        e.name: self.coords.values(self.x, k)[part][s.name]
                        for k, e in enumerate(campaign)
                    }
                else:
                    made[s.name] = self.coords.values(self.x, 0)[part][s.name]
            if not strengths:  # a form at full strength
                effect = self.coords.parts[part].effect
                made.update(effect.plausible)
        return made


def refit(
    coords: Coordinates,
    start: FloatArray,
    data: Sequence[FloatArray] | None = None,
    most_steps: int = 30,
    tolerance: float = 0.02,
    free: NDArray[np.bool_] | None = None,
    known: Sequence[Refit] = (),
    enough: float = inf,
) -> Refit:
    """Levenberg-Marquardt from ``start`` (n,) until the objective falls by < ``tolerance``.

    ``data``: bin means (n_bins,) V of each experiment in place of the measured ones.  ``free``
    (n,): coordinates that may move.  None goes below :attr:`Coordinates.lowest`.  ``known``: other
    refits of the same coordinates to the same data.  If this refit approaches the optimum of one
    of them, that one is returned; if it stays far above the best, it stops early, unconverged.
    ``enough``: objective above which an optimum does not matter; a refit that expects to end there
    is given up, too.

    Derivatives are updated by Broyden's rule while a step gains more than a set share of the
    predicted gain; else they are computed again.
    """
    binned = coords.binned
    of_bins = binned.all_bins.of_bins
    measured = np.concatenate(binned.data if data is None else data)
    centre, prior = coords.prior_centre, coords.own_prior_matrix
    x = np.maximum(start, coords.lowest)

    def evaluate(at: FloatArray) -> tuple[FloatArray, FloatArray, float]:
        means, away = coords.all_means(at), at - centre
        residual = binned.whitened(measured - means)
        total = float(residual @ residual) + float(away @ prior @ away)
        return means, residual, total if isfinite(total) else inf

    means, residual, objective = evaluate(x)
    damping, converged, finer = 1e-3, False, 1.0
    derivatives: FloatArray | None = None
    hopeless = min([enough, *(other.objective + FAR for other in known)])
    for taken in range(most_steps):
        fresh = derivatives is None
        if derivatives is None:
            derivatives = coords.derivatives(x, means, finer)
        normal, gradient = normal_equations(derivatives, residual, of_bins, coords.places, len(x))
        gradient -= prior @ (x - centre)
        normal += prior
        movable = (x > coords.lowest) | (gradient > 0.0)
        if free is not None:
            movable &= free
        index = np.flatnonzero(movable)
        within = np.ix_(index, index)
        squares = normal.diagonal().copy()
        accepted = False
        for _ in range(8):
            damped = normal[within]
            # what neither data nor prior hold must have some damping, too
            own = squares[index]
            damped[np.diag_indices_from(damped)] += damping * np.where(own > 0.0, own, 1e-12)
            step = _solved(damped, gradient[index])
            if step is None:
                damping = max(damping, 1e-6) * 10.0
                continue
            if damping <= 1e-3:
                ahead = objective - float(step @ gradient[index])
                if taken >= PATIENCE and ahead > hopeless:
                    return Refit(coords, x, residual, objective, False)
                for other in known:
                    if other.converged and abs(ahead - other.objective) < ALIKE:
                        apart = x - other.x
                        apart[index] += step
                        if float(apart @ normal @ apart) < ALIKE:
                            return other
            trial = _stepped(coords, x, index, step)
            t_means, t_residual, t_objective = evaluate(trial)
            if t_objective < objective:
                accepted = True
                break
            if not fresh:
                break
            damping = max(damping, 1e-6) * 8.0
        if not accepted:
            if not fresh:
                derivatives = None
                continue
            offered = 0.0 if step is None else float(step @ gradient[index])
            if finer == 1.0 and offered > 0.1 * tolerance:
                # where the model bends within the steps of the differences, they mislead
                finer, damping, derivatives = FINER, 1e-3, None
                continue
            converged = True
            break
        gained, moved = objective - t_objective, trial - x
        promised = float(moved @ (2.0 * gradient - normal @ moved))
        if gained > STRAIGHT * promised:
            broyden_update(
                derivatives, residual - t_residual, moved, squares, of_bins, coords.places
            )
        else:
            derivatives = None
        x, means, residual, objective = trial, t_means, t_residual, t_objective
        damping = max(damping * 0.2, 1e-9)
        if gained < tolerance and (fresh or promised < 2.0 * tolerance):
            converged = True
            break
    return Refit(coords, x, residual, objective, converged)


def _solved(matrix: FloatArray, right: FloatArray) -> FloatArray | None:
    """Solution (n,) of a symmetric system, None where its matrix is not positive definite."""
    _, solution, wrong = dposv(matrix.T, right, overwrite_a=True)
    return None if wrong else solution


def _stepped(
    coords: Coordinates, x: FloatArray, index: NDArray[np.int64], step: FloatArray
) -> FloatArray:
    """Coordinates (n,) after a ``step`` of those in ``index``, none of them too long.

    A lag delays the response by itself, so that what the shorter one gains the switch times lose.
    It is exponential in the coordinates: they make up for what it gains beyond the linear.
    """
    most = coords.longest_steps[index]
    moved = x.copy()
    moved[index] += np.clip(step, -most, most)
    moved = np.maximum(moved, coords.lowest)
    movable = np.zeros(coords.size, dtype=bool)
    movable[index] = True
    moved[coords.switch_times[movable[coords.switch_times]]] -= coords.bent(x, moved)
    return moved


def base_starts(binned: BinnedCampaign, base: FloatArray) -> list[FloatArray]:
    """Starts of the fit without effects: tau moved over two decades, t0 and tf with it."""
    coords = coordinates_of(binned)
    if not coords.n_ordered:
        return coords.other_starts(base)
    log_tau_v = float(base[1])
    ratios = (min(ratio, exp(-FASTER) * 0.999) for ratio in (0.012, 0.07, 0.23, 0.58))
    return [base.copy(), *(coords.with_tau(base, log_tau_v + log(ratio)) for ratio in ratios)]
