"""The findings of an analysis into a results folder."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from bayes_sensor.analysis.findings import Findings
from bayes_sensor.analysis.job import Job
from bayes_sensor.io.results import Results


def save_findings(analysis: Findings, folder: Path) -> Path:
    """Write what there is of an analysis, with the report of it; the folder."""
    from bayes_sensor.analysis.run_steps import put_last, write_results

    results = Results(folder)
    bounds = None if analysis.bounds is None else (analysis.bounds, analysis.bounds_json)
    job = Job(
        "analyze", analysis.problem, _Settings(analysis.settings), "", analysis.seed, 1, True,
        False, results, "", dict(analysis.seconds), analysis.fit, analysis.residuals,
        analysis.posterior, analysis.predictive, bounds, analysis.delays, analysis.gap,
        "; ".join(note.partition("gap: not diagnosed: ")[2] for note in analysis.notes),
    )  # fmt: skip
    job.warnings = analysis.warnings
    with results.locked():
        write_results(job, results, command_line=("Analysis.save",))
        put_last(job, results)
    return folder


class _Settings:
    """Settings of a run that is done, as run.json has them."""

    def __init__(self, settings: Mapping[str, Any]) -> None:
        self._settings = dict(settings)

    def record(self) -> dict[str, Any]:
        """All of them."""
        return self._settings

    def basis(self) -> dict[str, Any]:
        """Those that say what is computed."""
        return {k: self._settings[k] for k in ("noise", "priors", "fix") if k in self._settings}
