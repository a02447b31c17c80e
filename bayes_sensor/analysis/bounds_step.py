"""The step of the bounds: every method, what makes tau hard and what would help."""

from __future__ import annotations

from typing import Any

import numpy as np

from bayes_sensor.analysis.job import Job
from bayes_sensor.analysis.saved_records import put_record
from bayes_sensor.campaign import CampaignError
from bayes_sensor.io.json_files import plain
from bayes_sensor.io.results import StagingFolder


def run_bounds(job: Job) -> None:
    from bayes_sensor.bounds import compare_bounds

    if not job.carried("bounds"):
        return
    asked = job.overrides.bounds
    with job.timed("bounds") as tell:
        compared = compare_bounds(
            job.problem,
            job.fit,
            job.posterior,
            methods=asked.methods,
            seed=job.seed,
            progress=tell,
            n_resamples=asked.resamples,
        )
        record = compared.to_json()
        record["naive"] = naive_bounds(job)
        record["step_study"] = _study(job) if asked.step_study and job.of_published_sensor else None
        record["what_makes_tau_hard"] = record["what_would_help"] = None
        record["not_explained"] = None
        theta = _named_theta(job) if asked.explain else None
        if asked.explain and theta is None:
            record["not_explained"] = (
                NOT_EXPLAINED if not job.problem.layout.sensors_are_named else SEVERAL_SENSORS
            )
        elif theta is not None:
            tell(0.95, "what makes tau hard")
            record["what_makes_tau_hard"] = _hardness(job, theta, compared)
            record["what_would_help"] = _help(job, theta)
    job.bounds = (compared, record)


NOT_EXPLAINED = (
    "which lag is the sensor's is not known, so what makes tau hard and what would help is not "
    "told; say [rig] sensor_is in the campaign"
)


SEVERAL_SENSORS = "there are several sensors: what makes one tau hard is not told"


def reference_theta(job: Job) -> Any:
    """Point at which the classical bounds are compared, lags by size: the posterior's medians, else
    the fit."""
    vector = np.array(job.fit.theta_hat, dtype=float)
    if job.posterior is not None:
        vector = np.median(job.posterior.draws, axis=0)
    return vector


def naming_of(job: Job) -> Any:
    """The assignment of the lags, from the draws if there are any, else from the fit."""
    return (job.fit if job.posterior is None else job.posterior).naming


def _named_theta(job: Job) -> dict[str, Any] | None:
    """The reference point by name; None if it is not known which lag is the sensor's."""
    from bayes_sensor.fit.side_information import named_parameters

    naming, theta = naming_of(job), reference_theta(job)
    if naming.order == "undecided" or job.problem.layout.sensors_are_named:
        return None
    nested: dict[str, Any] = job.problem.layout.nested(theta)
    return {**nested, **named_parameters(naming, theta)}


def naive_bounds(job: Job) -> dict[str, Any]:
    """One standard deviation of tau, tau_v, V by the classical bounds at one common point.

    The bounds of ``methods`` are computed at each method's estimate, which may be tau = 0.  These
    are computed at the posterior's median, so that they can be compared.
    """
    from bayes_sensor.bounds import METHODS, cramer_rao

    vector, sigma = reference_theta(job), float(job.fit.rms)
    names, factors = zip(*naming_of(job).labels, strict=True)
    found: dict[str, Any] = {
        "at": plain(dict(zip(names, vector[: len(names)] * factors, strict=True))),
        "sigma_V": sigma,
    }
    for name, method in METHODS.items():
        if method.cramer_rao is None:
            continue
        try:
            bound = cramer_rao(job.problem, vector, sigma, **method.cramer_rao)
            found[name] = plain(dict(zip(names, bound.sd[: len(names)] * factors, strict=True)))
        except CampaignError:  # forward Euler is unstable for a tau below half a sample
            found[name] = None
    return found


def _study(job: Job) -> list[dict[str, Any]] | None:
    from bayes_sensor.bounds import step_study

    try:
        table = step_study(job.problem, reference_theta(job), float(job.fit.rms))
    except CampaignError:
        return None
    names, factors = zip(*naming_of(job).labels, strict=True)
    shared = list(job.problem.layout.shared_names)
    table[shared] *= np.array(factors)
    table = table.rename(columns=dict(zip(shared, names, strict=True)))
    rows: list[dict[str, Any]] = table.to_dict(orient="records")
    return rows


def _hardness(job: Job, theta: dict[str, Any], compared: Any) -> dict[str, Any]:
    from bayes_sensor.bounds import explain_tau

    told = explain_tau(job.problem, theta, likelihood=compared.likelihood)
    record: dict[str, Any] = told.to_json()
    return record


def _help(job: Job, theta: dict[str, Any]) -> list[dict[str, Any]]:
    from bayes_sensor.design import what_if

    rows: list[dict[str, Any]] = what_if(job.problem, theta).to_dict("records")
    return rows


def save_bounds(job: Job, stage: StagingFolder) -> None:
    """Write bounds.json and bounds.csv; where there are none, those of earlier are dropped."""
    if job.bounds is None:
        put_record(stage, "bounds", None, job.problem.campaign)
        stage.drop += ["bounds.json", "bounds.csv"]
        return
    compared, record = job.bounds
    stage.json("bounds.json", record)
    compared.to_csv(stage.path("bounds.csv"))
    put_record(stage, "bounds", compared, job.problem.campaign)
