"""Campaigns are diagnosed without their truths, and the verdicts are recorded."""

from __future__ import annotations

import json
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from bayes_sensor.blind_check.sealing import (
    CAMPAIGNS,
    PLAN,
    SEALED,
    VERDICTS,
    contents,
    digest,
    files_digest,
    seal_truths,
    task_key,
    write_hashes,
)
from bayes_sensor.blind_check.simulator import Case, make_campaign
from bayes_sensor.blind_check.truth import complete_truth
from bayes_sensor.campaign import Campaign, CampaignError
from bayes_sensor.checks.study_chunks import run_chunks
from bayes_sensor.io.json_files import json_text, plain, read_json, write_json
from bayes_sensor.io.results import Results

Diagnose = Callable[[Campaign, int, Sequence[str], str], Mapping[str, Any]]
"""campaign, seed, effects taken out, setting -> content of gap.json"""
SETTINGS = ("full", "study")
KEPT = {
    "where": ("experiment", "phase", "share", "p_value"),
    "which": ("effect", "family", "probability", "d", "tau_s", "fraction_closed", "bic"),
}
"""columns that are kept of the tables of gap.json"""


def diagnose(campaign: Campaign, seed: int, without: Sequence[str], setting: str) -> dict[str, Any]:
    """gap.json of a campaign.

    ``full`` is what ``bayes-sensor gap`` does.  ``study`` is quicker: it leaves out what only the
    report shows and takes linearised intervals instead of bootstrapped ones.
    """
    from bayes_sensor.diagnosis import diagnose_gap
    from bayes_sensor.fit import fit_least_squares

    if setting == "full":
        fit = fit_least_squares(campaign, seed=seed, euler=False)
        gap = diagnose_gap(campaign, fit, seed=seed, without=without)
    else:
        fit = fit_least_squares(campaign, seed=seed, euler=False, swarms=1)
        gap = diagnose_gap(
            campaign, fit, seed=seed, without=without, bootstrap=0, separate=False, follow=False
        )
    return gap.to_json()


def trimmed(gap: Mapping[str, Any]) -> dict[str, Any]:
    """The parts of gap.json that are scored."""
    kept: dict[str, Any] = {
        name: [{key: row.get(key) for key in keys} for row in gap[name]]
        for name, keys in KEPT.items()
    }
    verdict = gap["verdict"]
    kept["verdict"] = {k: verdict[k] for k in ("kind", "effects", "family", "probability")}
    kept["shrink"] = {
        k: v
        for k, v in gap["shrink"].items()
        if v is None or isinstance(v, bool | int | float | str)
    }
    kept["budget"] = {k: gap["budget"].get(k) for k in ("excess_d", "p_value")}
    kept["tau_with_discrepancy_s"] = gap.get("tau_with_discrepancy_s")
    kept["tau_envelope_s"] = gap["hidden"]["tau_envelope_s"] or [None, None]
    result: dict[str, Any] = plain(kept)
    return result


def no_verdict(reason: str) -> dict[str, Any]:
    """What is recorded where the diagnosis refused a campaign."""
    rows = [{"effect": name, "probability": 0.0, "family": None} for name in ("none", "unlisted")]
    return {
        "where": [],
        "which": rows,
        "verdict": {"kind": "failed", "effects": [], "family": None, "probability": None},
        "shrink": {},
        "budget": {},
        "tau_envelope_s": [None, None],
        "reason": reason,
    }


@dataclass(frozen=True)
class Diagnosing:
    """The task that diagnoses case number i.

    Only the campaign, the seed and the names taken out reach the diagnosis.
    """

    cases: tuple[tuple[str, int, tuple[str, ...]], ...]
    """name, seed, effects taken out"""
    sources: tuple[str, ...]
    """path of a campaign.toml, or a recipe as JSON"""
    setting: str
    diagnose: Diagnose = diagnose
    digest: str = ""
    """of the campaigns"""

    @property
    def key(self) -> str:
        """Everything that the verdicts depend on, beside the code."""
        name = getattr(self.diagnose, "__qualname__", repr(self.diagnose))
        return task_key("diagnosing", self.cases, self.setting, self.digest, name)

    def __call__(self, i: int) -> dict[str, Any]:
        """``verdict``: JSON; ``seconds``: processor time of the diagnosis."""
        name, seed, without = self.cases[i]
        source = self.sources[i]
        if source.startswith("{"):
            campaign = make_campaign(Case.from_json(json.loads(source)))
        else:
            from bayes_sensor.io.readers import read_campaign

            campaign = read_campaign(source)
        begin = time.process_time()
        try:
            verdict = trimmed(self.diagnose(campaign, seed, without, self.setting))
        except CampaignError as error:  # counts as a wrong answer
            verdict = no_verdict(str(error))
        seconds = time.process_time() - begin
        record = {"case": name, "seed": seed, "without": list(without), "setting": self.setting}
        return {"verdict": json_text({**record, **verdict}), "seconds": seconds}


def diagnose_cases(
    folder: Path,
    target: Path,
    parts: Path,
    setting: str = "full",
    *,
    diagnosis: Diagnose = diagnose,
    jobs: int = 1,
    scheduler: str | None = None,
    chunk: int = 4,
    progress: Callable[[int, int], None] | None = None,
) -> np.ndarray:
    """Diagnose every case of the plan and every campaign found; returns the seconds of each (n,).

    Truths in ``folder`` that have no hash yet get one first.  Verdicts, their hashes, those of the
    campaigns and the seconds go to ``target``.  Campaigns that a user put into ``campaigns/`` are
    diagnosed with the full catalogue unless plan.json says otherwise.

    Raises
    ------
    CampaignError
        If there is nothing to diagnose, the setting is not known or a truth is none.
    """
    if setting not in SETTINGS:
        raise CampaignError(f"--setting: expected one of {', '.join(SETTINGS)}, got '{setting}'")
    planned = list((Results(folder).json(PLAN) or {"cases": []})["cases"])
    names = {case["case"] for case in planned}
    planned += [
        {"case": path.parent.name, "seed": 1, "without": []}
        for path in sorted((folder / CAMPAIGNS).glob("*/campaign.toml"))
        if path.parent.name not in names
    ]
    if not planned:
        raise CampaignError(
            f"{folder}: expected cases to diagnose, but there is neither {PLAN} nor "
            "campaigns/NAME/campaign.toml; draw cases with --cases-only or put campaigns there"
        )
    seal_truths(folder)
    sources: list[str] = []
    made_from: dict[str, dict[str, str]] = {}
    for name in (case["case"] for case in planned):
        toml = folder / CAMPAIGNS / name / "campaign.toml"
        if toml.is_file():
            sources.append(str(toml))
            made_from[name] = {"of": "files", "sha256": files_digest(toml)}
            continue
        truth = read_json(folder / SEALED / f"{name}.json")
        if "recipe" not in complete_truth(truth, name):
            raise CampaignError(
                f"campaigns/{name}: expected campaign.toml there, because the sealed truth has no "
                "recipe to make the campaign from; put the campaign back"
            )
        sources.append(json.dumps(truth["recipe"]))
        made_from[name] = {"of": "recipe", "sha256": digest(truth["recipe"])}
    task = Diagnosing(
        tuple((case["case"], int(case["seed"]), tuple(case["without"])) for case in planned),
        tuple(sources), setting, diagnosis, digest(made_from),
    )  # fmt: skip
    done = run_chunks(
        task, len(planned), parts / "diagnosing", task.key, jobs, chunk, scheduler, progress
    )
    verdicts = target / VERDICTS
    verdicts.mkdir(parents=True, exist_ok=True)
    told = contents(done, "verdict", parts, "verdicts/*.json")
    for case, verdict in zip(planned, told, strict=True):
        write_json(verdicts / f"{case['case']}.json", verdict)
    write_hashes(target, VERDICTS)
    write_json(target / f"{CAMPAIGNS}.json", made_from)
    seconds = np.asarray(done["seconds"], dtype=float)
    each = {case["case"]: s for case, s in zip(planned, seconds, strict=True)}
    write_json(target / "seconds.json", {"setting": setting, "seconds": each})
    return seconds
