"""Run a command on a campaign: read it, take its steps, write their results, say what came out."""

from __future__ import annotations

import logging
import shutil
import time
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from bayes_sensor.campaign import Campaign, CampaignError
from bayes_sensor.cli.bounds_step import run_bounds, save_bounds
from bayes_sensor.cli.delays_step import run_delays, save_delays
from bayes_sensor.cli.fit_step import run_fit, run_residuals, save_fit, save_residuals
from bayes_sensor.cli.gap_step import run_gap, save_gap
from bayes_sensor.cli.job import CHECKPOINT, SAVES, STEPS, Job
from bayes_sensor.cli.logged_notes import noted
from bayes_sensor.cli.make_report import last_step, put_report
from bayes_sensor.cli.posterior_step import run_posterior, run_predictive, save_posterior
from bayes_sensor.cli.put_results import Clock, put_run
from bayes_sensor.cli.read_input import check_methods, load
from bayes_sensor.cli.summary_lines import print_summary, warnings_of
from bayes_sensor.io.json_files import sha256
from bayes_sensor.io.results import Results, Stage
from bayes_sensor.io.run_record import campaign_record, digest

if TYPE_CHECKING:
    from bayes_sensor.report import Choice

LOG = logging.getLogger(__name__)
TAKE: dict[str, Callable[[Job], None]] = {
    "fit": run_fit,
    "residuals": run_residuals,
    "posterior": run_posterior,
    "predictive": run_predictive,
    "bounds": run_bounds,
    "delays": run_delays,
    "gap": run_gap,
}
"""what computes the result of a step"""
SAVE: dict[str, Callable[[Job, Stage], None]] = {
    "fit": save_fit,
    "residuals": save_residuals,
    "posterior": save_posterior,
    "bounds": save_bounds,
    "delays": save_delays,
    "gap": save_gap,
}
"""what writes it"""


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
    patience: float = 0.0,
    command_line: Sequence[str] | None = None,
) -> int:
    """Run a command and write its results; the exit code.

    ``report``: what the report of ``analyze`` shall hold; ``patience``: seconds to wait for another
    run that holds ``out``.
    """
    from bayes_sensor.cli.overrides import fit_bounds, make_problem, read_overrides

    clock = Clock()
    label = config.name if config is not None else "--config"
    # everything that can be wrong with the input is found before anything is written
    overrides = read_overrides(config, posterior)
    check_methods(overrides.bounds.methods, label)
    begin = time.perf_counter()
    campaign, table, remarks = load(campaign_path)
    read_seconds = time.perf_counter() - begin
    if campaign.is_design:
        raise CampaignError(
            f"{campaign_path.name}: this is a design without data, but {command} needs measured "
            "experiments; give every experiment a file, or run simulate first"
        )
    problem = make_problem(campaign, overrides, label)
    fit_bounds(problem, overrides, label)
    record = campaign_record(campaign, remarks, table)
    basis = digest(record, {"noise": overrides.noise.model_dump(), "priors": overrides.priors})
    files = _files(campaign_path, campaign, config)
    results = Results(out)
    if command == "gap" and overrides.noise != type(overrides.noise)():
        LOG.warning(
            "%s: [noise] does not act on gap, which takes the noise of every record from it", label
        )
    with results.locked(patience):
        results.own_folder(CHECKPOINT)  # refused now rather than after the fit
        job = Job(
            command, problem, overrides, label, seed, jobs, quiet, resume, results, basis,
            {"read": read_seconds}, options=options or {},
            compare_published=report is not None and report.compare_published,
        )  # fmt: skip
        for name in STEPS[command]:
            if name in TAKE:
                TAKE[name](job)
        code = exit_code(job)
        with results.writing() as stage:
            stage.json("campaign.json", record)
            for name in SAVES[command]:
                if name in SAVE:
                    SAVE[name](job, stage)
            put_run(
                stage,
                command,
                clock,
                basis=basis,
                seed=seed,
                settings=overrides.record(),
                campaign=str(campaign_path),
                files=files,
                seconds=job.seconds,
                exit_code=code,
                warnings=[*warnings_of(job, remarks), *noted()],
                command_line=command_line,
                signal_unit=campaign.signal_unit,
            )
            if "report" in SAVES[command]:
                stage.drop.append("report.html")  # it speaks of other results
        if "report" in SAVES[command]:  # all else is in place by now, whatever becomes of it
            with job.timed("report") as tell, last_step(results):
                put_report(results, tell, report)
        if code == 0 and job.posterior is not None:
            shutil.rmtree(job.checkpoint, ignore_errors=True)
    print_summary(job, remarks, code)
    return code


def _files(path: Path, campaign: Campaign, config: Path | None) -> dict[str, str]:
    files = {path.name: sha256(path)}
    names = [Path(e.source).name for e in campaign]
    for e, name in zip(campaign, names, strict=True):
        if e.source:  # with their folders where two files are called alike
            files[e.source if names.count(name) > 1 else name] = e.sha256
    if config is not None:
        files[config.name] = sha256(config)
    return files


def exit_code(job: Job) -> int:
    bad = not job.fit.converged
    bad = bad or (job.posterior is not None and not job.posterior.converged)
    return 3 if bad else 0
