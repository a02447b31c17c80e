"""The record of a whole analysis from a results folder, or from a job that is done."""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from bayes_sensor.analysis.analysis import Analysis
from bayes_sensor.analysis.job import Job
from bayes_sensor.analysis.saved_records import PARTS, file_of, read_problem, read_record
from bayes_sensor.campaign import CampaignError
from bayes_sensor.fit.traces import load_traces
from bayes_sensor.io.results import Results


def analysis_of(job: Job) -> Analysis:
    """The record of what a job has found."""
    compared, record = (None, None) if job.bounds is None else job.bounds
    notes = [f"gap: not diagnosed: {job.no_gap}"] if job.no_gap else []
    notes += job.left_out.values()
    parts: dict[str, Any] = {part: getattr(job, part) for part in PARTS} | {"bounds": compared}
    return Analysis(
        problem=job.problem,
        **parts,
        bounds_json=record,
        warnings=tuple(job.warnings),
        notes=(*notes, *_never_computed(parts, notes)),
        settings=job.overrides.record(),
        seed=job.seed,
        seconds=dict(job.seconds),
    )


def load(folder: str | os.PathLike[str]) -> Analysis:
    """The analysis in a results folder, as :func:`analyze` gave it; nothing is computed again.

    Parameters
    ----------
    folder
        what ``bayes-sensor analyze``, ``fit``, ``posterior``, ``bounds``, ``delays`` or ``gap``
        wrote with ``--out``, :func:`analyze` with ``out=`` or :meth:`Analysis.save`.

    Returns
    -------
    Analysis
        A result that the folder lacks, or that is of other data than its newest, is None, with a
        sentence in ``notes``.

    Raises
    ------
    CampaignError
        If it is not such a folder, or a file in it is damaged.
    """
    place = Path(folder)
    results = Results(place)
    if not place.is_dir():
        raise CampaignError(
            f"{folder}: there is no such folder; expected a results folder: run bayes-sensor "
            "analyze CAMPAIGN.toml --out FOLDER, or bs.analyze(campaign, out=FOLDER)"
        )
    found = read_problem(place)
    run = results.json("run.json")
    if found is None or run is None:
        missing = file_of("campaign") if found is None else "run.json"
        raise CampaignError(
            f"{folder}: expected a results folder with {missing}, as this version writes it; run "
            "bayes-sensor analyze CAMPAIGN.toml --out FOLDER, or bs.analyze(campaign, out=FOLDER)"
        )
    problem, data = found
    parts: dict[str, Any] = {}
    notes = []
    for part in PARTS:
        parts[part] = read_record(place, part, problem.campaign, data)
        if parts[part] is None and results.has(file_of(part)):
            notes.append(f"{part}: that in {folder} is of other data than its newest result")
    entry = run["commands"][run["last"]]
    warnings = tuple(entry["warnings"])
    more: dict[str, Any] = {
        "settings": dict(entry["settings"] or {}),
        "seed": entry["seed"],
        "seconds": {name: float(seconds) for name, seconds in entry["seconds"].items()},
    }
    said = [text for text in warnings if text.startswith("not diagnosed: ")]
    notes += [f"gap: {text}" for text in said if parts["gap"] is None]
    absent = tuple(f"{part}: " for part in PARTS if parts[part] is None)
    notes += [text for text in warnings if text.startswith(absent)]
    traces = place / "traces.npz"
    return Analysis(
        problem=problem,
        bounds_json=None if parts["bounds"] is None else results.json("bounds.json"),
        warnings=warnings,
        notes=(*notes, *_never_computed(parts, notes)),
        saved_traces=tuple(load_traces(traces))
        if parts["fit"] and results.has(traces.name)
        else None,
        **parts,
        **more,
    )


def _never_computed(parts: Mapping[str, Any], notes: Sequence[str]) -> list[str]:
    """A sentence on the parts that are not there and that no note speaks of."""
    silent = [
        part
        for part, found in parts.items()
        if found is None and not any(note.startswith(f"{part}: ") for note in notes)
    ]
    said = f"{', '.join(silent)}: not computed by this run; analyze without quick computes them"
    return [said] if silent else []
