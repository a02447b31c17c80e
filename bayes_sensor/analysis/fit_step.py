"""The step of the fit, and those of the number of lags and of the residuals."""

from __future__ import annotations

from dataclasses import replace

from bayes_sensor.analysis.job import SAVES, Job
from bayes_sensor.analysis.saved_records import put_record
from bayes_sensor.io.results import StagingFolder


def run_fit(job: Job) -> None:
    from bayes_sensor.analysis.overrides import fit_bounds
    from bayes_sensor.fit import fit_least_squares

    asked = job.overrides.fit
    with job.timed("fit") as tell:
        job.fit = fit_least_squares(
            job.problem,
            seed=job.seed,
            swarms=asked.swarms,
            particles=asked.particles,
            bounds=fit_bounds(job.problem, job.overrides, job.label),
            euler=asked.euler and "fit" in SAVES[job.command],
            de=asked.differential_evolution,
            progress=tell,
        )


def run_lags(job: Job) -> None:
    from bayes_sensor.fit import count_lags

    with job.timed("lags"):
        job.fit = replace(job.fit, n_lags=count_lags(job.problem, job.fit))


def run_residuals(job: Job) -> None:
    from bayes_sensor.residuals import diagnose_residuals

    with job.timed("residuals"):
        job.residuals = diagnose_residuals(job.problem, job.fit)


def save_fit(job: Job, stage: StagingFolder) -> None:
    """Write fit.json and the samples and curves of its pictures."""
    from bayes_sensor.fit.samples import make_samples, save_samples
    from bayes_sensor.fit.traces import make_traces, save_traces

    _put_fit(job, stage)
    save_traces(stage.path("traces.npz"), make_traces(job.problem, job.fit))
    save_samples(stage.path("samples.npz"), make_samples(job.problem, job.fit))


def save_residuals(job: Job, stage: StagingFolder) -> None:
    """Write residuals.json, and fit.json anew, with what the checks say of the fit."""
    _put_fit(job, stage)
    stage.json("residuals.json", job.residuals.to_json())
    put_record(stage, "residuals", job.residuals, job.problem.campaign)


def _put_fit(job: Job, stage: StagingFolder) -> None:
    record = job.fit.to_json()
    if job.residuals is not None and not job.residuals.adequate:
        record["warnings"] = [*record["warnings"], job.residuals.doubt]
    stage.json("fit.json", record)
    put_record(stage, "fit", job.fit, job.problem.campaign)
