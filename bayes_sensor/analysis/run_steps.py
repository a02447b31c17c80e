"""Take the steps of an analysis and write their results: for the command line and for Python."""

from __future__ import annotations

import logging
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import AbstractContextManager, ExitStack, contextmanager, nullcontext
from pathlib import Path
from typing import TYPE_CHECKING, Any

from bayes_sensor.analysis.bounds_step import run_bounds, save_bounds
from bayes_sensor.analysis.delays_step import run_delays, save_delays
from bayes_sensor.analysis.fit_step import (
    run_fit,
    run_lags,
    run_residuals,
    save_fit,
    save_residuals,
)
from bayes_sensor.analysis.gap_step import begin_gap, run_gap, save_gap
from bayes_sensor.analysis.job import CHECKPOINT, SAVES, Bar, Job, no_bar
from bayes_sensor.analysis.job_warnings import warnings_of
from bayes_sensor.analysis.posterior_step import (
    run_fast,
    run_posterior,
    run_predictive,
    save_posterior,
)
from bayes_sensor.analysis.put_report import last_step, put_report
from bayes_sensor.analysis.read_input import check_methods, read_input
from bayes_sensor.analysis.resume import take_up_finished
from bayes_sensor.analysis.saved_records import put_campaign
from bayes_sensor.campaign import Campaign, CampaignError
from bayes_sensor.io.json_files import sha256
from bayes_sensor.io.put_run import CommandClock, put_run
from bayes_sensor.io.results import Results, StagingFolder
from bayes_sensor.io.run_record import campaign_record, digest

if TYPE_CHECKING:
    from bayes_sensor.report import Choice

LOG = logging.getLogger(__name__)
TAKE: dict[str, Callable[[Job], None]] = {
    "fit": run_fit,
    "fast": run_fast,
    "lags": run_lags,
    "residuals": run_residuals,
    "posterior": run_posterior,
    "predictive": run_predictive,
    "bounds": run_bounds,
    "delays": run_delays,
    "gap": run_gap,
}
"""what computes the result of a step"""
SAVE: dict[str, Callable[[Job, StagingFolder], None]] = {
    "fit": save_fit,
    "residuals": save_residuals,
    "posterior": save_posterior,
    "bounds": save_bounds,
    "delays": save_delays,
    "gap": save_gap,
}
"""what writes it"""
DROPPED = ("bounds", "delays", "gap")
"""whose files of an earlier run are dropped where there is no such result now"""


def run_steps(
    command: str,
    given: Path | Campaign,
    overrides: Any,
    label: str,
    results: Results | None,
    *,
    seed: int,
    jobs: int = 1,
    quiet: bool = True,
    resume: bool = False,
    options: Mapping[str, Any] | None = None,
    config: Path | None = None,
    bar: Bar = no_bar,
    muted: Callable[[], AbstractContextManager[None]] = nullcontext,
    patience: float = 0.0,
    command_line: Sequence[str] | None = None,
    notes: Callable[[], Sequence[str]] = tuple,
    report: Choice | None = None,
    quick: bool = False,
    begun: Callable[[Job], None] = lambda job: None,
    finished: Callable[[str, Job], None] = lambda stage, job: None,
) -> Job:
    """Take the steps of ``command`` and write what it saves into ``results``, if there are any.

    Parameters
    ----------
    given
        the campaign, or its file.
    overrides, label
        settings as :func:`bayes_sensor.analysis.overrides.read_overrides` makes them, and what
        messages call them.
    config
        the file that they come from, for its hash.
    patience
        seconds to wait for another run that holds the folder.
    command_line, notes
        for run.json: what was typed, and what was said meanwhile.
    report
        what the report of ``analyze`` shall hold.
    quick
        whether ``analyze`` ends with the fast posterior and a report of it.
    begun, finished
        called before the first stage (:attr:`Job.stages`), and after each with its name, when its
        results are in place.

    Raises
    ------
    CampaignError
        For input that cannot be used, before anything is written.
    """
    from bayes_sensor.analysis.overrides import fit_bounds, make_problem

    clock = CommandClock()
    # everything that can be wrong with the input is found before anything is written
    check_methods(overrides.bounds.methods, label)
    begin = time.perf_counter()
    campaign, table, remarks = read_input(given)
    read_seconds = time.perf_counter() - begin
    if campaign.is_design:
        name = Path(campaign.source).name if campaign.source else campaign.title
        raise CampaignError(
            f"{name}: this is a design without data, but {command} needs measured "
            "experiments; give every experiment a file, or run simulate first"
        )
    problem = make_problem(campaign, overrides, label)
    campaign = problem.campaign  # with the ties of the settings
    fit_bounds(problem, overrides, label)
    if command == "gap" and overrides.noise != type(overrides.noise)():
        LOG.warning(
            "%s: [noise] does not act on gap, which takes the noise of every record from it", label
        )
    job = Job(
        command, problem, overrides, label, seed, jobs, quiet, resume, results,
        seconds={"read": read_seconds},
        options=options or {}, quick=quick, bar=bar, muted=muted,
        compare_published=report is not None and report.compare_published,
    )  # fmt: skip
    job.campaign_json = campaign_record(campaign, remarks, table)
    job.basis = digest(job.campaign_json, overrides.basis())
    files = _files(campaign, config)
    if results is None:
        with _remarks_before_an_error(remarks):
            begun(job)
            for stage, names in job.stages.items():
                if stage != "report":
                    _take(job, names)
                    finished(stage, job)
        job.warnings = tuple(warnings_of(job, remarks))
        return job
    with results.locked(patience, SAVES[command]), ExitStack() as stack:
        if resume:
            results.check_campaign(job.campaign_json)
        results.own_folder(CHECKPOINT)  # refused now rather than after the fit
        stack.enter_context(_remarks_before_an_error(remarks))
        staged = take_up_finished(job)
        begun(job)
        stages, unsaved = job.stages, list[str]()
        last = [stage for stage in stages if stage != "report"][-1]
        for stage, names in stages.items():
            new = [name for name in names if name not in job.done]
            if stage == "posterior" and command == "analyze":
                begin_gap(job, stack)
            _take(job, new)
            unsaved += [name for name in new if name in SAVES[command]]
            if stage == "report":
                put_last(job, results, report)
            elif unsaved and (staged or stage == last):
                job.warnings = tuple(warnings_of(job, remarks))
                parts = unsaved if staged else None
                write_results(job, results, clock, files, command_line, notes, parts)
                unsaved = []
            finished(stage, job)
        job.warnings = tuple(warnings_of(job, remarks))
        if job.exit_code == 0 and not job.quick and job.posterior is not None:
            results.clear(CHECKPOINT)
    return job


def write_results(
    job: Job,
    results: Results,
    clock: CommandClock | None = None,
    files: Mapping[str, str] | None = None,
    command_line: Sequence[str] | None = None,
    notes: Callable[[], Sequence[str]] = tuple,
    parts: Sequence[str] | None = None,
) -> None:
    """Write what a job has found into a folder that is held.

    ``files``: hashes of the input by name; ``notes``: what was said meanwhile; ``parts``: the
    results to write, all where there are none.
    """
    campaign, command = job.problem.campaign, job.command
    record = job.campaign_json
    # the fast posterior is the posterior until there is another
    chosen = {
        "posterior" if name == "fast" else name: None
        for name in (SAVES[command] if parts is None else parts)
    }
    with results.writing() as stage:
        stage.json("campaign.json", record)
        if command != "analyze" or "fit" in chosen:
            put_campaign(stage, job.problem)
        for name in chosen:
            if name in SAVE and (getattr(job, name) is not None or name in DROPPED):
                SAVE[name](job, stage)
        put_run(
            stage,
            command,
            clock or CommandClock(),
            basis=job.basis or digest(record, job.overrides.basis()),
            seed=job.seed,
            settings=job.overrides.record(),
            campaign=campaign.source,
            files=_files(campaign, None) if files is None else files,
            seconds=job.seconds,
            exit_code=job.exit_code,
            warnings=[*job.warnings, *notes()],
            command_line=command_line,
            steps=job.done if command == "analyze" else None,
            signal_unit=campaign.signal_unit,
        )
        if "report" in SAVES[command]:
            stage.drop.append("report.html")  # it speaks of other results


def put_last(job: Job, results: Results, report: Choice | None = None) -> None:
    """Make the report; all else is in place by now, whatever becomes of it."""
    with job.timed("report") as tell, last_step(results):
        put_report(results, tell, report)


@contextmanager
def _remarks_before_an_error(remarks: Sequence[str]) -> Iterator[None]:
    """Log the remarks on a campaign where a step fails: what they say may be the cause."""
    try:
        yield
    except CampaignError:
        for text in remarks:
            LOG.warning("%s", text)
        raise


def _take(job: Job, names: Sequence[str]) -> None:
    for name in names:
        if name in TAKE:
            TAKE[name](job)
            job.done.append(name)


def _files(campaign: Campaign, config: Path | None) -> dict[str, str]:
    path = Path(campaign.source) if campaign.source else None
    files = {}
    if path is not None and path.is_file():
        files[path.name] = sha256(path)
    names = [Path(e.source).name for e in campaign]
    for e, name in zip(campaign, names, strict=True):
        if e.source:  # with their folders where two files are called alike
            files[e.source if names.count(name) > 1 else name] = e.sha256
    if config is not None:
        files[config.name] = sha256(config)
    return files
