"""The record of a whole analysis: every result, its text, its figures, and its files."""

from __future__ import annotations

import os
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from bayes_sensor.analysis.findings import Findings
from bayes_sensor.analysis.plots import Plots
from bayes_sensor.analysis.summary_text import answer_lines, parameter_rows, summary_text
from bayes_sensor.campaign import CampaignError
from bayes_sensor.display import card, progress_bar


@dataclass(frozen=True, eq=False, repr=False)
class Analysis(Findings):
    """What :func:`analyze` found, or :func:`load` read; what there is none of is None."""

    @property
    def plot(self) -> Plots:
        """Figures: ``plot.fit()``, ``plot.corner()``, .. (see :class:`Plots`)."""
        return Plots(self)

    def summary(self) -> str:
        """The results as text: answer, statistics of the fit, parameters, correlations, bounds of
        tau, gap and warnings."""
        return summary_text(self)

    def to_arviz(self, most_draws: int = 1000, seed: int = 1) -> Any:
        """ArviZ InferenceData (a DataTree in ArviZ 1.x) of the posterior.

        See :func:`bayes_sensor.posterior.to_arviz.to_arviz`.  Raises CampaignError where there is
        no posterior.
        """
        from bayes_sensor.posterior.to_arviz import to_arviz

        if self.posterior is None:
            raise CampaignError(
                "to_arviz: these results have no posterior; run analyze, or bayes-sensor posterior"
            )
        return to_arviz(self.posterior, most_draws, seed, progress_bar("to_arviz"))

    def save(self, folder: str | os.PathLike[str]) -> Path:
        """Write a results folder, as ``bayes-sensor analyze --out`` does, with its report; the
        folder.

        Raises CampaignError where it cannot be written.
        """
        from bayes_sensor.analysis.save_findings import save_findings

        return save_findings(self, Path(folder))

    def __repr__(self) -> str:
        """Campaign and answer."""
        answer = [*answer_lines(self), "no result"][0].split("; ")[0]
        return f"Analysis({self.campaign.title!r}: {answer})"

    def _repr_html_(self) -> str:
        """HTML for a notebook: answer, parameters and warnings."""
        columns = ["parameter", "median", "sd", "95 % low", "95 % high", "unit"]
        if self.posterior is None:
            columns[1] = "estimate"
        rows = [row.cells for row in parameter_rows(self)]
        sentences = [*answer_lines(self), *self.notes, *self.warnings]
        return card(self.campaign.title, sentences, columns, rows)
