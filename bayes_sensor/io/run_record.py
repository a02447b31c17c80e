"""What a run was made with: versions, campaign, settings, digests; the content of run.json."""

from __future__ import annotations

import hashlib
import json
import os
import platform
import sys
from collections.abc import Mapping, Sequence
from datetime import UTC, datetime
from importlib import metadata
from pathlib import Path
from typing import Any

from bayes_sensor import __version__
from bayes_sensor.campaign import Campaign
from bayes_sensor.io.json_files import plain, sha256

RUN_VERSION = 1


def versions() -> dict[str, str]:
    """Versions of Python and of everything that the numbers depend on."""
    found = {"python": platform.python_version(), "bayes-sensor": __version__}
    for name in (
        "numpy", "scipy", "numba", "pandas", "statsmodels", "emcee", "arviz",
        "scikit-fem", "matplotlib", "pydantic", "typer",
    ):  # fmt: skip
        try:
            found[name] = metadata.version(name)
        except metadata.PackageNotFoundError:
            continue
    return found


def now() -> str:
    """The time in UTC, to the second."""
    return datetime.now(UTC).isoformat(timespec="seconds").replace("+00:00", "Z")


def _ties(campaign: Campaign) -> dict[str, Any]:
    if not campaign.ties:
        return {}
    from bayes_sensor.rig.ties import tie_texts  # slow to load, and a report needs none of it

    return {"ties": tie_texts(campaign.ties)}


def campaign_record(
    campaign: Campaign, remarks: Sequence[str], rows: Sequence[Mapping[str, Any]]
) -> dict[str, Any]:
    """The content of ``campaign.json``: what was understood of the input, with file hashes.

    ``rows``: one per experiment, as check.campaign_rows makes them.
    """
    source = Path(campaign.source) if campaign.source else None
    return {
        "title": campaign.title,
        "source": str(source) if source else "",
        "sha256": sha256(source) if source and source.is_file() else "",
        "signal_unit": campaign.signal_unit,
        "reference_interval_s": campaign.reference_interval,
        "same_flow": campaign.same_flow,
        "stages": list(campaign.stages),
        "sensor_is": campaign.sensor_is,
        **_ties(campaign),
        **({"coating": campaign.coating} if campaign.coating else {}),
        "n_samples": campaign.n_samples,
        "side_information": {
            name: {"mean": info.mean, "sd": info.sd}
            for name, info in campaign.side_information.items()
        },
        "remarks": list(remarks),
        "experiments": [
            {**row, "file": Path(e.source).name if e.source else "", "sha256": e.sha256}
            for row, e in zip(rows, campaign, strict=True)
        ],
    }


def digest(campaign: Mapping[str, Any], settings: Any) -> str:
    """One hash of the data files, the campaign file and the settings: what a result rests on."""
    parts = {
        "campaign": campaign.get("sha256"),
        "files": [e.get("sha256") for e in campaign.get("experiments", [])],
        "settings": settings,
    }
    text = json.dumps(plain(parts), sort_keys=True, allow_nan=False)
    return hashlib.sha256(text.encode("utf-8")).hexdigest()


def is_other_campaign(earlier: Mapping[str, Any], campaign: Mapping[str, Any]) -> bool:
    """Whether two contents of ``campaign.json`` are of two campaigns, not of two states of one.

    One campaign has a data file in common with its earlier state; or, where all files were
    recorded anew, the place of the campaign file and the name of an experiment.
    """

    def common(key: str) -> bool:
        mine, others = ({e.get(key) for e in each["experiments"]} for each in (campaign, earlier))
        return bool(mine & others - {"", None})

    places = {os.path.abspath(each["source"] or "?") for each in (campaign, earlier)}
    return not common("sha256") and not (len(places) == 1 and common("experiment"))


def of_other_data(run: Mapping[str, Any]) -> list[str]:
    """Commands in ``run.json`` whose results rest on other data or settings than the newest's."""
    bases = {name: entry["basis_sha256"] for name, entry in run["commands"].items()}
    newest = bases.get(run["last"])
    # what rests on no data (a simulation, a design) has no basis
    return [name for name, basis in bases.items() if newest and basis not in ("", newest)]


def run_record(
    earlier: Any,
    command: str,
    *,
    basis: str,
    seed: int,
    settings: Any,
    campaign: str,
    files: Mapping[str, str],
    started: str,
    seconds: Mapping[str, float],
    exit_code: int,
    warnings: Sequence[str],
    command_line: Sequence[str] | None = None,
    steps: Sequence[str] | None = None,
) -> dict[str, Any]:
    """The content of ``run.json`` after a command: one entry per command, the newest of each.

    ``command_line``: where it is not that of this process; ``steps``: those that are done, of a
    command that writes as it goes on.
    """
    commands = dict(earlier.get("commands", {})) if isinstance(earlier, Mapping) else {}
    commands[command] = {
        "started": started,
        "finished": now(),
        "seconds": {k: round(float(v), 3) for k, v in seconds.items()},
        "exit_code": exit_code,
        "converged": exit_code == 0,
        "seed": seed,
        "settings": settings,
        "campaign": campaign,
        "files_sha256": dict(files),
        "basis_sha256": basis,
        "versions": versions(),
        "platform": f"{platform.system()} {platform.machine()}",
        "command_line": list(command_line or ["bayes-sensor", *sys.argv[1:]]),
        "warnings": list(warnings),
        **({} if steps is None else {"steps": list(steps)}),
    }
    return {"version": RUN_VERSION, "last": command, "commands": commands}
