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

from bayes_sensor.io.result_schema import analysis, blind_check, bounds, gap, run
from bayes_sensor.io.untrusted import read_json, refused

SCHEMAS: Mapping[str, Any] = {
    "run.json": run.Run,
    "campaign.json": analysis.CampaignRecord,
    "fit.json": analysis.Fit,
    "residuals.json": analysis.ResidualRecord,
    "posterior.json": analysis.PosteriorRecord,
    "posterior_without_effects.json": analysis.PosteriorRecord,
    "predictive.json": analysis.Predictive,
    "bounds.json": bounds.Bounds,
    "delays.json": bounds.Delays,
    "gap.json": gap.Gap,
    "coating.json": gap.Coating,
    "traces.npz": analysis.Traces,
    "samples.npz": analysis.SampledRecords,
    "outcome.json": run.Outcome,
    "checkpoint.json": run.Chunks,
    "study.json": run.Study,
    ".lock": run.Owner,
    ".drop.json": run.Dropped,
    "plan.json": blind_check.Plan,
    "sealed.json": blind_check.Hashes,
    "verdicts.json": blind_check.Hashes,
    "campaigns.json": blind_check.MadeFromEach,
    "verdicts/*.json": blind_check.Verdict,
    "a drawn truth": blind_check.DrawnTruth,
    "parameters": analysis.Parameters,
    "score.json": blind_check.Card,
    "cases.csv": blind_check.Cases,
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
