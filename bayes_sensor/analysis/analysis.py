"""The record of a whole analysis: every result, its text, its figures, and its files."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any

from bayes_sensor.analysis.plots import Plots
from bayes_sensor.analysis.summary_text import answer_lines, summary_text
from bayes_sensor.campaign import Campaign
from bayes_sensor.display import card
from bayes_sensor.fit.traces import Trace, make_traces
from bayes_sensor.likelihood.problem import Problem

if TYPE_CHECKING:
    import os

    from bayes_sensor.bounds.bounds_table import Bounds
    from bayes_sensor.checks.delays import Delays
    from bayes_sensor.checks.predictive import PredictiveCheck
    from bayes_sensor.diagnosis import Gap
    from bayes_sensor.fit import Fit
    from bayes_sensor.posterior import Posterior
    from bayes_sensor.residuals.residual_record import Residuals


@dataclass(frozen=True, eq=False)
class Analysis:
    """What :func:`analyze` found, or :func:`load` read; what there is none of is None."""

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
        """Whether the fit and, where there is one, the posterior have converged."""
        good = self.fit is not None and self.fit.converged
        return good and (self.posterior is None or self.posterior.converged)

    @cached_property
    def traces(self) -> list[Trace]:
        """Measurement and model of every experiment, as envelopes for figures."""
        if self.saved_traces is not None:
            return list(self.saved_traces)
        return [] if self.fit is None else make_traces(self.problem, self.fit)

    @property
    def plot(self) -> Plots:
        """Figures: ``plot.fit()``, ``plot.corner()``, .. (see :class:`Plots`)."""
        return Plots(self)

    def summary(self) -> str:
        """The results as text: answer, statistics of the fit, parameters, correlations, bounds of
        tau, gap and warnings."""
        return summary_text(self)

    def to_arviz(self, most_draws: int = 2000, seed: int = 1) -> Any:
        """ArviZ InferenceData (a DataTree in ArviZ 1.x) of the posterior.

        See :func:`bayes_sensor.posterior.to_arviz.to_arviz`.  Raises CampaignError where there is
        no posterior.
        """
        from bayes_sensor.campaign import CampaignError
        from bayes_sensor.posterior.to_arviz import to_arviz

        if self.posterior is None:
            raise CampaignError(
                "to_arviz: these results have no posterior; run analyze, or bayes-sensor posterior"
            )
        return to_arviz(self.posterior, most_draws, seed)

    def save(self, folder: str | os.PathLike[str]) -> Path:
        """Write a results folder, as ``bayes-sensor analyze --out`` does, with its report; the
        folder.

        Raises CampaignError where it cannot be written.
        """
        from bayes_sensor.analysis.save_analysis import save_analysis

        return save_analysis(self, Path(folder))

    def __repr__(self) -> str:
        """Campaign and answer."""
        answer = answer_lines(self)
        return f"Analysis({self.campaign.title!r}: {answer[0] if answer else 'no result'})"

    def _repr_html_(self) -> str:
        """HTML for a notebook: answer, parameters and warnings."""
        from bayes_sensor.analysis.summary_text import parameter_rows

        columns = ["parameter", "median", "sd", "95 % low", "95 % high", "unit"]
        if self.posterior is None:
            columns[1] = "estimate"
        rows = [row.cells for row in parameter_rows(self)]
        sentences = [*answer_lines(self), *self.notes, *self.warnings]
        return card(self.campaign.title, sentences, columns, rows)
