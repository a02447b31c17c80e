"""The step of the delays' regressions."""

from __future__ import annotations

from bayes_sensor.analysis.job import Job
from bayes_sensor.analysis.posterior_step import saved_spreads
from bayes_sensor.analysis.saved_records import put_record
from bayes_sensor.io.results import StagingFolder


def run_delays(job: Job) -> None:
    from bayes_sensor.checks.delays import regress_delays

    if not job.carried("delays"):
        return
    with job.timed("delays"):
        job.delays = regress_delays(job.problem, job.fit, job.posterior or saved_spreads(job))


def save_delays(job: Job, stage: StagingFolder) -> None:
    """Write delays.json; where there are no delays, that of an earlier run is dropped."""
    if job.delays is None:
        put_record(stage, "delays", None, job.problem.campaign)
        stage.drop.append("delays.json")
        return
    unit = job.problem.campaign.signal_unit
    stage.json("delays.json", {**job.delays.to_json(), "signal_unit": unit})
    put_record(stage, "delays", job.delays, job.problem.campaign)
