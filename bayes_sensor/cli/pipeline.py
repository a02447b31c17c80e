"""Run a command on a campaign: read the settings, take its steps, say what came out."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from contextlib import AbstractContextManager
from pathlib import Path
from typing import TYPE_CHECKING, Any

from bayes_sensor.analysis.job import Progress
from bayes_sensor.analysis.run_steps import run_steps
from bayes_sensor.cli.logged_notes import noted
from bayes_sensor.cli.stage_lines import StageLines
from bayes_sensor.cli.summary_lines import print_summary
from bayes_sensor.cli.terminal import muted, progress_bar
from bayes_sensor.io.results import Results

if TYPE_CHECKING:
    from bayes_sensor.report import Choice


def run_command(
    command: str,
    campaign_path: Path,
    out: Path,
    *,
    seed: int,
    jobs: int,
    quiet: bool,
    config: Path | None,
    resume: bool = False,
    posterior: Mapping[str, Any] | None = None,
    options: Mapping[str, Any] | None = None,
    report: Choice | None = None,
    quick: bool = False,
    patience: float = 0.0,
    command_line: Sequence[str] | None = None,
) -> int:
    """Run a command and write its results; the exit code.

    ``report``: what the report of ``analyze`` shall hold; ``quick``: whether it ends with the fast
    posterior; ``patience``: seconds to wait for another run that holds ``out``.
    """
    from bayes_sensor.analysis.overrides import read_overrides

    def bar(name: str) -> AbstractContextManager[Progress]:
        return progress_bar(name, quiet)

    label = config.name if config is not None else "--config"
    results = Results(out)
    lines = StageLines(results)
    job = run_steps(
        command,
        campaign_path,
        read_overrides(config, posterior),
        label,
        results,
        seed=seed,
        jobs=jobs,
        quiet=quiet,
        resume=resume,
        options=options,
        config=config,
        bar=bar,
        muted=muted,
        patience=patience,
        report=report,
        command_line=command_line,
        notes=noted,
        quick=quick,
        begun=lines.begun,
        finished=lines.finished,
    )
    print_summary(job, results)
    return job.exit_code
