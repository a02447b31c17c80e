"""What every file of a results folder must hold before anything is made of it.

One table, :data:`SCHEMAS`, says which file has which content; :func:`read_result` is the way in.
Numbers are finite and of a size that still has a square; a key that is not ``NotRequired`` must be
there; further keys are let through.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import cache
from pathlib import Path
from typing import Any

from pydantic import TypeAdapter, ValidationError

from bayes_sensor.io.result_schema import (
    blind_check_schema,
    bounds_schema,
    fit_schema,
    gap_schema,
    restored_schema,
    run_schema,
)
from bayes_sensor.io.untrusted import read_json, refused

SCHEMAS: Mapping[str, Any] = {
    "run.json": run_schema.Run,
    "campaign.json": fit_schema.CampaignRecord,
    "fit.json": fit_schema.Fit,
    "residuals.json": fit_schema.ResidualRecord,
    "posterior.json": fit_schema.PosteriorRecord,
    "posterior_without_effects.json": fit_schema.PosteriorRecord,
    "predictive.json": fit_schema.Predictive,
    "bounds.json": bounds_schema.Bounds,
    "delays.json": bounds_schema.Delays,
    "gap.json": gap_schema.Gap,
    "coating.json": gap_schema.Coating,
    "restored.json": restored_schema.RestoredRecord,
    "traces.npz": fit_schema.Traces,
    "samples.npz": fit_schema.SampledRecords,
    "outcome.json": run_schema.Outcome,
    "checkpoint.json": run_schema.Chunks,
    "study.json": run_schema.Study,
    ".lock": run_schema.Owner,
    ".drop.json": run_schema.Dropped,
    "plan.json": blind_check_schema.Plan,
    "sealed.json": blind_check_schema.Hashes,
    "verdicts.json": blind_check_schema.Hashes,
    "campaigns.json": blind_check_schema.MadeFromEach,
    "verdicts/*.json": blind_check_schema.Verdict,
    "a drawn truth": blind_check_schema.DrawnTruth,
    "parameters": fit_schema.Parameters,
    "score.json": blind_check_schema.Card,
    "cases.csv": blind_check_schema.Cases,
}
"""by the name of the file; with a folder where every file in that has the same content"""


@cache
def _adapter(name: str) -> TypeAdapter[Any]:
    return TypeAdapter(SCHEMAS[name])


def check_result(content: Any, path: Path, name: str = "") -> Any:
    """The content itself; CampaignError names the place where it is not that of such a file.

    ``name`` of :data:`SCHEMAS`, where it is not the file's.
    """
    every = f"{path.parent.name}/*{path.suffix}"
    name = name or (every if every in SCHEMAS else path.name)
    if name not in SCHEMAS:
        return content
    try:
        _adapter(name).validate_python(content)
    except ValidationError as error:
        first = error.errors(include_url=False, include_input=False)[0]
        place = ".".join(str(part)[:60] for part in first["loc"]) or "its content"
        told = f"{place}: {first['msg'][:1].lower()}{first['msg'][1:]}"
        raise refused(path, f"the content of {name}", told) from None
    return content


def read_result(path: Path) -> Any:
    """The content of a saved result, checked; CampaignError if it is another."""
    return check_result(read_json(path), path)


def check_together(
    folder: Path,
    campaign: Mapping[str, Any],
    found: Mapping[str, Any],
    *archives: Sequence[Any],
) -> None:
    """Raise CampaignError where results speak of experiments that the campaign does not have.

    ``found``: the content of files by their names without ending; ``archives``: records with a
    ``name`` each.
    """
    known = {row["experiment"] for row in campaign["experiments"]}
    known |= {name.rpartition(",")[0] for name in known}  # the record that several sensors share
    named = [each.name for archive in archives for each in archive]
    if fit := found.get("fit"):
        named += fit["parameters"]["experiments"]
    if residuals := found.get("residuals"):
        named += residuals["experiments"]
    for line in (found.get("delays") or {}).values():
        named += [point["experiment"] for point in line["points"]] if isinstance(line, dict) else []
    if (gap := found.get("gap")) is not None:
        named += [row["experiment"] for row in gap["where"]]
    if unknown := sorted({*named} - known):
        told = f"'{unknown[0][:60]}' of another result is none of them"
        raise refused(folder / "campaign.json", "the experiments of all results", told)
