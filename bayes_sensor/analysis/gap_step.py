"""The step of the gap's diagnosis."""

from __future__ import annotations

from contextlib import ExitStack
from typing import TYPE_CHECKING, Any

from bayes_sensor.analysis.job import Job
from bayes_sensor.analysis.saved_records import known_objects, put_record, shortened
from bayes_sensor.campaign import Campaign, CampaignError
from bayes_sensor.io.csv_text import csv_text
from bayes_sensor.io.results import StagingFolder
from bayes_sensor.workers import beside, packed, unpacked

if TYPE_CHECKING:
    from bayes_sensor.diagnosis import Gap
    from bayes_sensor.fit import Fit


def begin_gap(job: Job, stack: ExitStack) -> None:
    """Let another process diagnose the gap meanwhile, where there may be one: only the fit is
    needed.  A user's own effects stay in this process."""
    if job.jobs < 2 or job.options or "gap" not in job.stages or "gap" in job.done:
        return
    if not job.carried("gap"):
        return
    given = (job.problem.campaign, job.fit, job.seed, {"jobs": 1})
    wait = stack.enter_context(beside(_sent, given))
    # effects and signals are told by identity: this process's own stand in their places
    job.ahead = lambda: unpacked(wait(), known_objects("gap", job.problem.campaign))


def _sent(*given: Any) -> bytes:
    return packed(shortened("gap", diagnosed(*given)), known_objects("gap", given[0]))


def diagnosed(campaign: Campaign, fit: Fit, seed: int, options: dict[str, Any]) -> Gap:
    """The gap; imported here, because the diagnosis takes long to import."""
    from bayes_sensor.diagnosis import diagnose_gap

    return diagnose_gap(campaign, fit, seed=seed, **options)


def run_gap(job: Job) -> None:
    """Diagnose the gap, or wait for the process that does."""
    if not job.carried("gap"):
        return
    try:
        with job.timed("gap") as tell:
            if job.ahead is not None:
                job.gap = job.ahead()
                return
            options = {**job.options, "jobs": job.jobs, "progress": tell}
            job.gap = diagnosed(job.problem.campaign, job.fit, job.seed, options)
    except CampaignError as error:
        if job.command != "analyze":
            raise
        job.no_gap = str(error)  # records too short for it; what was found before is kept


def save_gap(job: Job, stage: StagingFolder) -> None:
    """Write gap.json with its tables; where there is none, that of an earlier run is dropped."""
    put_record(stage, "gap", job.gap, job.problem.campaign)
    if job.gap is None:
        stage.drop += ["gap.json", "gap_where.csv", "gap_which.csv"]
        return
    stage.json("gap.json", job.gap.to_json())
    for name in ("where", "which"):
        stage.text(f"gap_{name}.csv", csv_text(getattr(job.gap, name)))
