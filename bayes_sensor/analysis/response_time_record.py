"""Response times that the posterior implies, for coating.json."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from bayes_sensor.analysis.job import Job

MOST_DRAWS = 4000
"""number of draws for the summary of response times"""
WHOSE_COATING = "which lag is the sensor's is not known, so no diffusivity can be told from it"
TAKES_LONG = (
    "the diffusivity that follows from tau takes some seconds and comes with the posterior that "
    "follows the fast one"
)


def response_time_record(job: Job) -> dict[str, Any]:
    """Response times of sensor and chain; for ``analyze`` of a sensor with the published coating
    also the diffusivity that follows from tau.

    If it is not known which lag is the sensor's, there is a row for each, with its probability.
    """
    from bayes_sensor.rig.response_times import response_time_rows

    undecided = job.posterior.naming.order == "undecided"
    rows: list[dict[str, Any]] = [*response_time_rows(_systems(job))]
    if undecided:
        rows[:1] = [_sensor_row(each) for each in job.posterior.assignments]
    record: dict[str, Any] = {"response_times": rows, "d_zif8": None}
    if not job.of_published_sensor or job.command != "analyze":
        return record
    if undecided:
        record["d_zif8_left_out"] = WHOSE_COATING
    elif job.posterior is job.fast:
        record["d_zif8_left_out"] = TAKES_LONG
    else:
        from bayes_sensor.coating import infer_d_zif8

        record["d_zif8"] = infer_d_zif8(job.posterior.of("tau_s"), seed=job.seed).to_json()
    return record


def _systems(job: Job) -> list[tuple[str, float | None, Any]]:
    """Each sensor alone, and the whole chain to it at each total flow, with draws of their times.

    The chain's times do not depend on which lag is whose.
    """
    from bayes_sensor.rig.response_times import response_times

    posterior, layout = job.posterior, job.problem.layout
    every = slice(None, None, max(1, len(posterior.draws) // MOST_DRAWS))
    named, draws = posterior.named[every], posterior.draws[every]
    sensors: list[tuple[str, float | None, Any]] = []
    chains: dict[tuple[str, float], Any] = {}
    for k, e in enumerate(job.problem.campaign):
        name = f"sensor {e.sensor}".strip()
        if name not in [known for known, _, _ in sensors]:
            place, factor = layout.stage_sources[k][0]
            sensors.append((name, None, response_times([named[:, place] * factor])))
        flow = e.total_flow if layout.rig.needs_flow else float("nan")
        where = (f"chain to {e.sensor}" if e.sensor else "chain", flow if flow == flow else -1.0)
        if where not in chains:
            taus = layout.rigs[k].taus(draws[:, layout.shared[k]].T, flow)
            chains[where] = (where[0], flow, response_times(taus))
    return [*sensors, *(chains[where] for where in sorted(chains))]


def _sensor_row(assignment: Mapping[str, Any]) -> dict[str, Any]:
    """Response times of the sensor, if its lag is that of an assignment of the posterior."""
    from bayes_sensor.rig.response_times import response_times

    ends = {"": "q50", "_lo": "q2.5", "_hi": "q97.5"}
    # of one lag they rise with it, so that their quantiles are those of its quantiles
    found = response_times([np.array([assignment["tau_s"][key] for key in ends.values()])])
    times = {
        f"{name}{end}_s": float(value)
        for name in ("t10", "t63", "t90", "rise")
        for end, value in zip(ends, getattr(found, name), strict=True)
    }
    about = {key: assignment[key] for key in ("sensor_is", "probability")}
    return {"system": "sensor", "total_flow_L_per_min": None, **about, **times}
