"""The comparison of hypotheses: records of each one's evidence, and their probabilities."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from math import exp, sqrt

import numpy as np
from scipy.special import logsumexp

from bayes_sensor.campaign import FloatArray
from bayes_sensor.diagnosis.data.binned_campaign import BinnedCampaign
from bayes_sensor.diagnosis.effects.effect import Effect
from bayes_sensor.diagnosis.evidence.discrepancy import Discrepancy
from bayes_sensor.diagnosis.evidence.refit import Refit

LEFT = 2.5
"""standard deviations of misfit that an explanation leaves, from which something else is looked for
beside it"""


@dataclass(frozen=True, eq=False)
class Term:
    """One form of a cause, with one configuration of the discrepancy or with none."""

    share: float
    """of the probability of all that are kept"""
    refit: Refit
    beside: Discrepancy | None = field(repr=False)


@dataclass(frozen=True, eq=False)
class Hypothesis:
    """A cause, or several, with or without a discrepancy beside them."""

    effects: tuple[str, ...]
    incomplete: bool
    """whether a discrepancy is part of it; alone it is "something else" """
    log_prior: float
    log_z: float
    refit: Refit
    """in the best of the forms"""
    log_tau: float
    sd_log_tau: float
    terms: tuple[Term, ...] = field(repr=False)
    """the likeliest of the forms and discrepancies that it is averaged over"""
    within: str = ""
    """the unlisted dependence inside the model, where it is that"""

    @property
    def log_weight(self) -> float:
        """ln of prior times evidence."""
        return self.log_prior + self.log_z

    @property
    def excess(self) -> float:
        """Misfit that it leaves beyond what noise does, the discrepancy aside."""
        return float(self.refit.misfit - (self.refit.coords.binned.n_bins - self.refit.coords.size))

    @property
    def leftover(self) -> float:
        """The same in standard deviations of what noise does."""
        return self.excess / sqrt(2.0 * self.refit.coords.binned.n_bins)

    @property
    def tau_interval(self) -> tuple[float, float]:
        """s, 95 % interval of tau."""
        spread = 1.96 * self.sd_log_tau
        return exp(self.log_tau - spread), exp(self.log_tau + spread)

    @property
    def key(self) -> str:
        """``none``, ``unlisted``, ``a``, ``a+b``; with a discrepancy ``a, unlisted``."""
        name = "+".join(self.effects)
        if self.incomplete:
            other = f"unlisted ({self.within})" if self.within else "unlisted"
            return f"{name}, {other}" if name else other
        return name or "none"


@dataclass(frozen=True, eq=False)
class Comparison:
    """All hypotheses with their probabilities."""

    binned: BinnedCampaign
    base: Refit
    hypotheses: tuple[Hypothesis, ...]
    catalogue: Mapping[str, Effect]
    discrepancies: tuple[Discrepancy, ...] = field(repr=False)

    @property
    def probabilities(self) -> FloatArray:
        """(n_hypotheses,) summing to 1."""
        logs = np.array([h.log_weight for h in self.hypotheses])
        shares: FloatArray = np.exp(logs - logsumexp(logs))
        return shares

    @property
    def complete(self) -> list[Hypothesis]:
        """Those without a discrepancy: none, single effects, and pairs."""
        return [h for h in self.hypotheses if not h.incomplete]

    @property
    def likeliest(self) -> Hypothesis:
        """Of the complete ones."""
        return max(self.complete, key=lambda h: h.log_weight)

    def others(self, best: Hypothesis) -> list[tuple[Refit, float]]:
        """Every other complete explanation with its odds against ``best``."""
        return [
            (h.refit, exp(min(h.log_weight - best.log_weight, 30.0)))
            for h in self.complete
            if h is not best
        ]

    def find(self, *effects: str) -> Hypothesis:
        """The hypothesis of exactly these effects (none given: of none) and nothing else.

        Raises KeyError.
        """
        for h in self.complete:
            if h.effects == effects:
                return h
        raise KeyError("+".join(effects))


def something_left(hypotheses: Sequence[Hypothesis]) -> bool:
    """Whether the best explanations by one effect leave something for another."""
    logs = np.array([h.log_weight for h in hypotheses])
    p = np.exp(logs - logsumexp(logs))
    left = sum(q for q, h in zip(p, hypotheses, strict=True) if h.incomplete)
    best = max((h for h in hypotheses if h.effects), key=lambda h: h.log_weight)
    return bool(left > 0.02 or best.leftover > LEFT)
