"""The step of the gap's diagnosis."""

from __future__ import annotations

from bayes_sensor.analysis.job import Job
from bayes_sensor.analysis.saved_records import put_record
from bayes_sensor.campaign import CampaignError
from bayes_sensor.io.csv_text import csv_text
from bayes_sensor.io.results import Stage


def run_gap(job: Job) -> None:
    from bayes_sensor.diagnosis import diagnose_gap

    if not job.carried("gap"):
        return
    try:
        with job.timed("gap") as tell:
            job.gap = diagnose_gap(
                job.problem.campaign,
                job.fit,
                seed=job.seed,
                jobs=job.jobs,
                progress=tell,
                **{k: v for k, v in job.options.items() if not k.startswith("with_")},
            )
    except CampaignError as error:
        if job.command != "analyze":
            raise
        job.no_gap = str(error)  # records too short for it; what was found before is kept


def save_gap(job: Job, stage: Stage) -> None:
    """Write gap.json with its tables; where there is none, that of an earlier run is dropped."""
    put_record(stage, "gap", job.gap, job.problem.campaign)
    if job.gap is None:
        stage.drop += ["gap.json", "gap_where.csv", "gap_which.csv"]
        return
    stage.json("gap.json", job.gap.to_json())
    for name in ("where", "which"):
        stage.text(f"gap_{name}.csv", csv_text(getattr(job.gap, name)))
