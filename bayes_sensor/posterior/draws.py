"""Draws of the parameters: lags by size, what may be said of their names, and convergence."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any

import numpy as np

from bayes_sensor.campaign import FloatArray
from bayes_sensor.likelihood.coordinates import Coordinates
from bayes_sensor.likelihood.priors import Prior
from bayes_sensor.likelihood.problem import Problem
from bayes_sensor.posterior.convergence import ESS_LIMIT, R_HAT_LIMIT
from bayes_sensor.posterior.quantiles import reaches_end, weighted_quantiles
from bayes_sensor.posterior.settings import Settings
from bayes_sensor.rig.lags import LAG_NAMES, Naming
from bayes_sensor.rig.layout import Layout

NEVER = 1e-6
"""probability below which an assignment is not mentioned"""


@dataclass(frozen=True, eq=False)
class Draws:
    """Draws of theta with their diagnostics."""

    problem: Problem
    chains: FloatArray
    """(n_chain, n_draw, n_theta); for emcee a chain is an ensemble, its walkers end to end"""
    log_likelihood: FloatArray
    """(n_chain, n_draw, n_experiment)"""
    sampler: str
    """which sampler made the draws"""
    reasons: tuple[str, ...]
    """sentences: which sampler was used and its checks"""
    mesh_error: float
    """largest difference of log L between mesh and full pass over a few draws"""
    r_hat: FloatArray
    ess_bulk: FloatArray
    ess_tail: FloatArray
    settings: Settings = field(default_factory=Settings)
    seed: int = 1
    seconds: float = 0.0
    k_hat: float | None = None
    acceptance: float | None = None
    hidden_by_sampling: float | None = None
    """s, the sampling interval if the whole response is shorter than it"""
    caveats: tuple[str, ...] = ()
    """caveats of the fit"""
    remarks: tuple[str, ...] = ()
    """further sentences of the fit that also apply to the posterior"""
    doubts: tuple[str, ...] = ()
    """sentences on failed checks of the noise law; intervals are then not reliable"""

    @property
    def layout(self) -> Layout:
        """Order of the flat vector."""
        return self.problem.layout

    @cached_property
    def names(self) -> list[str]:
        """Flat names, in the order of the last axis of ``chains``.

        That axis has the lags by size (:mod:`bayes_sensor.rig.lags`).  A lag that cannot be
        assigned is named by its size.
        """
        return [*self.naming.names, *self.layout.names[self.layout.n_shared :]]

    @cached_property
    def draws(self) -> FloatArray:
        """(n, n_theta), all chains together, lags by size."""
        return self.chains.reshape(-1, self.chains.shape[-1])

    @cached_property
    def free(self) -> np.ndarray:
        """Positions of the parameters that vary."""
        return Coordinates(self.problem).free

    @cached_property
    def shares(self) -> FloatArray:
        """(n, n_assignments) probability of every assignment of names to lags, draw by draw."""
        return self.problem.shares(self.draws)

    @cached_property
    def naming(self) -> Naming:
        """The assignment of the lags that may be stated."""
        return self.problem.naming(self.shares.mean(axis=0))

    @cached_property
    def lags(self) -> FloatArray:
        """(n, n_lags) s, draws of the lags that do not depend on flow, shortest first."""
        return self.problem.commuting.lags(self.draws)

    @cached_property
    def named(self) -> FloatArray:
        """(n, n_shared) draws of the shared parameters: tau (s), tau_v (s) and V (mL) of the
        published rig.

        If several assignments are possible, each draw has one, drawn with its probability; tau is
        then either of the lags.  If one assignment is stated, a draw with another one is replaced
        by the last draw that has it.
        """
        choices = self.problem.assignments
        if len(choices) == 1:
            return self.problem.commuting.named(self.draws, choices)
        stated = self.naming.place("sensor")
        allowed = np.array([stated in (None, choice.sensor) for choice in choices])
        rng = np.random.default_rng([self.seed, len(choices)])
        u = rng.random(len(self.draws))
        chosen = (np.cumsum(self.shares, axis=1) < u[:, None]).sum(axis=1).clip(0, len(choices) - 1)
        good = allowed[chosen]
        place = np.maximum.accumulate(np.where(good, np.arange(len(good)), -1))
        place = np.where(place < 0, int(np.argmax(good)), place)
        return self.problem.commuting.named(self.draws[place], choices, chosen[place])

    def of(self, name: str) -> FloatArray:
        """(n,) draws of one parameter; shared ones as in :attr:`named`, tied ones as well."""
        source, factor = self.layout.sources.get(name, (name, 1.0))
        if source != name:
            return factor * self.of(source)
        if name in self.layout.shared_names:
            return self.named[:, self.layout.shared_names.index(name)]
        lag_names = LAG_NAMES.get(self.naming.n_lags, ())
        if name in lag_names:
            return self.lags[:, lag_names.index(name)]
        return self.draws[:, self.layout.index(name)]

    def mean(self, name: str) -> float:
        """Posterior mean."""
        return float(self.of(name).mean())

    def sd(self, name: str) -> float:
        """Posterior standard deviation."""
        return float(self.of(name).std(ddof=1))

    def quantiles(self, name: str, probabilities: Any) -> FloatArray:
        """Posterior quantiles at ``probabilities`` between 0 and 1."""
        found: FloatArray = np.quantile(self.of(name), probabilities)
        return found

    @property
    def converged(self) -> bool:
        """R-hat below 1.01 and bulk and tail ESS of at least 400 for every parameter."""
        r_hat, bulk, tail = (a[self.free] for a in (self.r_hat, self.ess_bulk, self.ess_tail))
        return bool(
            np.all(r_hat < R_HAT_LIMIT) and np.all(bulk >= ESS_LIMIT) and np.all(tail >= ESS_LIMIT)
        )

    @property
    def status(self) -> str:
        """Whether it converged, and which checks of the noise law failed."""
        return "; ".join([self.convergence, *self.doubts])

    @property
    def convergence(self) -> str:
        """One sentence: converged, or what is missing."""
        free = self.free
        worst = free[int(np.nanargmax(self.r_hat[free]))]
        least = free[int(np.nanargmin(np.minimum(self.ess_bulk, self.ess_tail)[free]))]
        ess = min(self.ess_bulk[least], self.ess_tail[least])
        numbers = (
            f"largest R-hat {self.r_hat[worst]:.4f} ({self.names[worst]}), "
            f"smallest effective sample size {ess:.0f} ({self.names[least]})"
        )
        return ("converged: " if self.converged else "NOT converged: ") + numbers

    @cached_property
    def assignments(self) -> list[dict[str, Any]]:
        """For each lag that may be the sensor's: its place, the probability, tau and tau_v."""
        found: list[dict[str, Any]] = []
        choices = self.problem.assignments
        if not self.naming.names_of_lags("sensor"):
            return found  # several sensors: their lags are told by their records
        for place in sorted({choice.sensor for choice in choices if choice.sensor is not None}):
            members = [j for j, choice in enumerate(choices) if choice.sensor == place]
            weights = self.shares[:, members]
            probability = float(weights.sum() / len(self.draws))
            # of the draws, each with the weight of this sensor; of all where that is nil
            if probability <= NEVER:
                weights = np.full(weights.shape, 1.0 / weights.size)
            w = weights.sum(axis=1)
            row = {
                "sensor_is": choices[members[0]].sensor_is,
                "lag": place,
                "probability": probability,
                "tau_s": percentiles(self.lags[:, place], w / w.sum()),
            }
            if self.naming.names_of_lags("valve"):
                valve = np.concatenate([self.lags[:, choices[j].valve] for j in members])
                row["tau_v_s"] = percentiles(valve, weights.T.ravel() / weights.sum())
            found.append(row)
        return found

    @cached_property
    def no_upper_limit(self) -> dict[str, float]:
        """The upper end (s, mL) of the default prior of each lag and volume whose draws reach it,
        by flat name: there the prior decides, since the data do not."""
        return {
            self.names[i]: law.support[1]
            for i, law in self._ended
            if i < self.layout.n_shared
            and self.layout.names[i] not in self.problem.given_laws
            and self._reach(i, 0.0, law)
        }

    @cached_property
    def cut_by_prior(self) -> dict[str, str]:
        """The prior, in words, of each lag, volume and parameter of the noise whose draws reach an
        end of what the user gave, by flat name."""
        return {
            self.names[i]: str(law)
            for i, law in self._ended
            if self.layout.names[i] in self.problem.given_laws
            and self._reach(i, law.support[0], law)
        }

    @property
    def _ended(self) -> Iterator[tuple[int, Prior]]:
        """Places and laws of what varies up to an end: lags, volumes and the noise."""
        layout = self.layout
        for name in (*layout.shared_names, *layout.noise_names):
            i, law = layout.index(name), self.problem.priors[name]
            if i in self.free and np.isfinite(law.support[1]):
                yield i, law

    def _reach(self, i: int, low: float, law: Prior) -> bool:
        n = len(self.draws)
        return reaches_end(self.draws[:, i], np.full(n, 1.0 / n), low, law.support[1])

    @cached_property
    def laws(self) -> dict[str, str]:
        """The prior of every varying parameter in words, by flat name; lags that are not assigned
        by size have theirs beside the side information by name."""
        priors, own = self.problem.priors, self.layout.names
        found = {self.names[i]: str(priors[own[i]]) for i in self.free}
        if len(self.problem.assignments) > 1:
            commuting = self.problem.commuting
            lags = [self.names[i] for i in commuting.places]
            found = {name: law for name, law in found.items() if name not in lags}
            by_size = zip(LAG_NAMES[self.naming.n_lags], self.problem.lag_priors, strict=True)
            found |= {name: str(law) for name, law in by_size}
            found |= {name: str(law) for name, law in self.problem.named_laws.items()}
        return found


def percentiles(draws: FloatArray, weights: FloatArray | None = None) -> dict[str, float]:
    """``q2.5``, ``q50``, ``q95`` and ``q97.5`` of draws (n,), weighted by ``weights`` (n,)."""
    percents = (2.5, 50.0, 95.0, 97.5)
    if weights is None:
        values = [float(v) for v in np.percentile(draws, percents)]
    else:
        values = weighted_quantiles(draws, weights, [0.01 * percent for percent in percents])
    return {f"q{percent:g}": value for percent, value in zip(percents, values, strict=True)}
