"""The steps of the posterior and of its predictive check; the posterior of an earlier run."""

from __future__ import annotations

import logging
from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

from bayes_sensor.analysis.job import Job, Progress
from bayes_sensor.analysis.response_time_record import response_time_record
from bayes_sensor.analysis.saved_records import put_record
from bayes_sensor.io.results import StagingFolder

if TYPE_CHECKING:
    from bayes_sensor.fit import Fit
    from bayes_sensor.likelihood.problem import Problem

LOG = logging.getLogger(__name__)


def run_fast(job: Job) -> None:
    """The posterior by a fast sampler, where that can be trusted."""
    from bayes_sensor.posterior import fast_posterior

    with job.timed("fast") as tell:
        job.fast = job.posterior = fast_posterior(
            job.problem,
            job.fit,
            seed=job.seed,
            settings=job.overrides.sampler_settings(),
            progress=tell,
        )


def run_posterior(job: Job) -> None:
    from bayes_sensor.posterior import FASTEST, sample_posterior

    methods = job.overrides.bounds.methods
    if job.command == "bounds" and methods is not None:
        from bayes_sensor.bounds import METHODS

        if not any(METHODS[name].needs_posterior for name in methods):
            return
    problem, asked = job.problem, job.overrides.posterior
    with job.timed("posterior") as tell, job.muted():
        if job.options.get("with_effects"):
            problem, job.fit = _with_effects_asked(job, tell)
        # bounds needs an interval to set beside the others, which the fastest sampler gives where
        # it can be trusted; a value of a model with effects costs forty times one of the chain's
        hurry = job.command == "bounds" or problem is not job.problem
        chosen = "sampler" in asked.model_fields_set or not hurry
        sampler = asked.sampler if chosen else FASTEST
        job.posterior = sample_posterior(
            problem,
            job.fit,
            seed=job.seed,
            sampler=sampler,
            settings=job.overrides.sampler_settings(),
            jobs=job.jobs if job.ahead is None else 1,  # the other process diagnoses the gap
            checkpoint=job.checkpoint,
            resume=job.resume,
            progress=watching(job, tell),
            begin=job.fast,
        )
        if job.options.get("with_discrepancy"):
            from bayes_sensor.diagnosis.discrepancy_posterior import with_discrepancy

            job.posterior = with_discrepancy(job.posterior, job.fit, job.seed)


def watching(job: Job, tell: Progress) -> Progress:
    """``tell``, with a message if ``--resume`` finds ensembles that cannot be continued."""
    from bayes_sensor.posterior.checkpoints import MARKER

    checkpoint = job.checkpoint
    if not job.resume or checkpoint is None:
        return tell
    marker = checkpoint / MARKER
    if not (marker.is_file() and any(checkpoint.glob("ensemble-*.npz"))):
        return tell
    before = [marker.read_bytes()]

    def watched(fraction: float, text: str) -> None:
        if before and marker.read_bytes() != before[0]:  # the sampler has begun anew
            before.clear()
            LOG.warning(
                "--resume: the unfinished run in %s is of other data or settings, such as another "
                "--seed, and is not used", checkpoint,
            )  # fmt: skip
        tell(fraction, text)

    return watched


def run_predictive(job: Job) -> None:
    from bayes_sensor.checks.predictive import check_predictive, checked

    if job.options.get("with_effects") or job.options.get("with_discrepancy"):
        return  # replicates are drawn from the cascade
    with job.timed("predictive"):
        job.predictive = check_predictive(job.posterior, seed=job.seed)
    job.posterior = checked(job.posterior, job.predictive)


class SavedSpreads:
    """Posterior standard deviations read back from ``posterior.json``."""

    def __init__(self, parameters: Mapping[str, Any]) -> None:
        self.parameters = parameters

    def sd(self, name: str) -> float:
        """Posterior standard deviation of a flat name."""
        return float(self.parameters[name]["sd"])


def saved_posterior(job: Job) -> dict[str, Any] | None:
    """``posterior.json`` of the results folder, if it has the same data and settings."""
    if job.results is None:
        return None
    run = job.results.json("run.json")
    saved: dict[str, Any] | None = job.results.json("posterior.json")
    commands = {} if run is None else run["commands"]
    entries = [commands[name] for name in ("posterior", "analyze") if name in commands]
    if saved is None or not entries:
        return None
    newest = max(entries, key=lambda entry: entry["finished"])  # which has written it
    return saved if newest["basis_sha256"] == job.basis else None


def saved_spreads(job: Job) -> SavedSpreads | None:
    """Spreads of a posterior that was saved and had converged."""
    saved = saved_posterior(job)
    return SavedSpreads(saved["parameters"]) if saved is not None and saved["converged"] else None


def _with_effects_asked(job: Job, tell: Progress) -> tuple[Problem, Fit]:
    """The problem with the effects that were asked for in its model, and its own fit: misfit and
    noise are then judged with the effects in."""
    from bayes_sensor.diagnosis.effects.effect_model import with_effects
    from bayes_sensor.fit import fit_least_squares
    from bayes_sensor.rig.layout import Layout

    theta = Layout.of(job.problem.campaign).flat(job.fit.theta_hat[: job.problem.layout.n_mean])
    problem = with_effects(job.problem, job.options["with_effects"].values(), theta)
    asked = job.overrides.fit
    fit = fit_least_squares(
        problem, job.seed, asked.swarms, asked.particles, euler=False, progress=tell
    )
    return problem, fit


def save_posterior(job: Job, stage: StagingFolder) -> None:
    """Write posterior.json, posterior.nc, predictive.json and coating.json."""
    unit = {"signal_unit": job.problem.campaign.signal_unit}
    record = job.posterior.to_json()
    record.pop("seconds", None)  # times are in run.json: the same run gives the same file
    effects = list(job.options.get("with_effects") or ())
    record["with_effects"] = effects
    record["with_discrepancy"] = bool(job.options.get("with_discrepancy"))
    before = saved_posterior(job)
    if not (effects or record["with_discrepancy"]) or before is None:
        stage.drop.append("posterior_without_effects.json")  # nothing to stand beside
    elif not (before.get("with_effects") or before.get("with_discrepancy")):
        # the posterior without effects is kept, so that both can be compared
        stage.json("posterior_without_effects.json", before)
    stage.json("posterior.json", record)
    job.posterior.save(stage.path("posterior.nc"))
    if job.predictive is not None:
        stage.json("predictive.json", {**job.predictive.to_json(), **unit})
    else:
        stage.drop.append("predictive.json")  # it speaks of another posterior
    stage.json("coating.json", {**response_time_record(job), **unit})
    put_record(stage, "posterior", job.posterior, job.problem.campaign)
    put_record(stage, "predictive", job.predictive, job.problem.campaign)
