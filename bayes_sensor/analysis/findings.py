"""What an analysis has found: its results and words on what is missing."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cached_property
from typing import TYPE_CHECKING, Any

from bayes_sensor.campaign import Campaign
from bayes_sensor.fit.traces import Trace, make_traces
from bayes_sensor.likelihood.problem import Problem

if TYPE_CHECKING:
    from bayes_sensor.bounds.bounds_table import Bounds
    from bayes_sensor.checks.delays import Delays
    from bayes_sensor.checks.predictive import PredictiveCheck
    from bayes_sensor.diagnosis import Gap
    from bayes_sensor.fit import Fit
    from bayes_sensor.posterior import Posterior
    from bayes_sensor.residuals.residual_record import Residuals


@dataclass(frozen=True, eq=False)
class Findings:
    """The results of an analysis; what there is none of is None."""

    problem: Problem
    """the campaign with its model, noise law and priors"""
    fit: Fit | None = None
    posterior: Posterior | None = None
    bounds: Bounds | None = None
    delays: Delays | None = None
    gap: Gap | None = None
    residuals: Residuals | None = None
    predictive: PredictiveCheck | None = None
    """replicated data against the data"""
    bounds_json: Mapping[str, Any] | None = None
    """the content of ``bounds.json``: with what makes tau hard, and what would help"""
    warnings: tuple[str, ...] = ()
    """sentences, what concerns the answer first"""
    notes: tuple[str, ...] = ()
    """why a result is missing, in sentences"""
    settings: Mapping[str, Any] = field(default_factory=dict)
    """the settings of the run, as in run.json"""
    seed: int = 1
    seconds: Mapping[str, float] = field(default_factory=dict)
    """how long every step took"""
    saved_traces: tuple[Trace, ...] | None = None
    """of a results folder: what its figures of the fit show"""

    @property
    def campaign(self) -> Campaign:
        """The campaign."""
        return self.problem.campaign

    @property
    def converged(self) -> bool:
        """Whether fit and posterior have converged, as far as there are any."""
        found = [part.converged for part in (self.fit, self.posterior) if part is not None]
        return bool(found) and all(found)

    @cached_property
    def traces(self) -> list[Trace]:
        """Measurement and model of every experiment, as envelopes for figures."""
        if self.saved_traces is not None:
            return list(self.saved_traces)
        return [] if self.fit is None else make_traces(self.problem, self.fit)
