"""The records of an analysis among its results, so that nothing is computed again to read them.

Beside ``fit.json`` there is ``fit_record.npz``, and so on; ``campaign_record.npz`` holds the data,
the model and the priors.  Seconds are left out, so that the same run gives the same file; they are
in ``run.json``.
"""

from __future__ import annotations

import hashlib
import os
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

from bayes_sensor.campaign import Campaign
from bayes_sensor.io.record_archive import load_record, save_record
from bayes_sensor.io.results import StagingFolder
from bayes_sensor.io.untrusted import refused
from bayes_sensor.likelihood.problem import Problem

CAMPAIGN = "campaign"
KINDS = {
    "fit": "Fit", "residuals": "Residuals", "posterior": "Posterior",
    "predictive": "PredictiveCheck", "bounds": "Bounds", "delays": "Delays", "gap": "Gap",
}  # fmt: skip
"""results that have a record, and what that is called"""
PARTS = tuple(KINDS)
_SHORTER: dict[str, Callable[[Any], Any]] = {
    "fit": lambda fit: replace(fit, seconds=0.0),
    "posterior": lambda posterior: replace(posterior, seconds=0.0),
    # what was needed on the way to the result, and is as large as the data
    "bounds": lambda bounds: replace(bounds, seconds={}, likelihood=None),
    "gap": lambda gap: replace(gap, comparison=None),
}


def file_of(part: str) -> str:
    """Name of the file of a record."""
    return f"{part}_record.npz"


def data_digest(campaign: Campaign) -> str:
    """One hash of all samples with their times, names and flows."""
    digest = hashlib.sha256()
    for e in campaign:
        digest.update(repr((e.name, e.carrier_flow, e.test_gas_flow, e.interval)).encode())
        digest.update(repr((e.commanded_on, e.commanded_off)).encode())
        for array in (e.t, e.values, e.used):
            digest.update(array.tobytes())
    return digest.hexdigest()


def put_campaign(stage: StagingFolder, problem: Problem) -> None:
    """Put the campaign with its model, noise law and priors."""
    record = {"data": data_digest(problem.campaign), "record": problem}
    save_record(stage.path(file_of(CAMPAIGN)), record)


def put_record(stage: StagingFolder, part: str, record: Any, campaign: Campaign) -> None:
    """Put a record; where there is none, or it holds a user's own code, drop that of earlier."""
    name = file_of(part)
    if record is not None:
        content = {"data": data_digest(campaign), "record": shortened(part, record)}
        try:
            save_record(stage.path(name), content, known_objects(part, campaign))
        except TypeError:
            stage.path(name).unlink(missing_ok=True)
        else:
            return
    stage.drop.append(name)


def shortened(part: str, record: Any) -> Any:
    """A record without what was needed on the way to it."""
    return _SHORTER.get(part, lambda each: each)(record)


def known_objects(part: str, campaign: Campaign) -> dict[str, Any]:
    """Objects by name that reader and writer both have: the data; effects and signals."""
    known: dict[str, Any] = {"experiments": campaign.experiments}
    if part == "gap":
        from bayes_sensor.diagnosis.catalogue_objects import catalogue_objects

        known |= catalogue_objects()
    return known


def read_problem(folder: Path) -> tuple[Problem, str] | None:
    """The problem of a results folder and the hash of its data; None where it has none."""
    path = folder / file_of(CAMPAIGN)
    if not os.path.lexists(path):
        return None
    found = load_record(path, "campaign")
    problem = found.get("record") if isinstance(found, dict) else None
    if not isinstance(problem, Problem) or found.get("data") != data_digest(problem.campaign):
        raise refused(path, "a saved campaign with its samples", "it holds something else")
    return problem, str(found["data"])


def read_record(folder: Path, part: str, campaign: Campaign, data: str) -> Any:
    """A record of a results folder; None where there is none, or it is of other data."""
    path = folder / file_of(part)
    if not os.path.lexists(path):
        return None
    found = load_record(path, part, known_objects(part, campaign))
    kind = type(found.get("record")).__name__ if isinstance(found, dict) else ""
    if kind != KINDS[part]:
        raise refused(path, f"a saved {part}", "it holds something else")
    return found["record"] if found.get("data") == data else None
