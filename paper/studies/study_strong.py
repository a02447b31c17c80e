"""What is said of causes stronger than any of the blind check's, as on a rig that is plainly off.

The blind check stops at d = 32, where a wrong answer is still a matter of power.  Far beyond, the
form of the catalogue's effects decides: nature's is never quite theirs, and the better a cause is
seen the better is the difference.  Campaigns are drawn, diagnosed at the study setting and scored
as there: listed causes, pairs of them, and such as no effect describes.
"""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import asdict, dataclass, replace
from itertools import cycle
from pathlib import Path
from typing import Any

import pandas as pd
from drawing import TABLES

from bayes_sensor.blind_check import table
from bayes_sensor.blind_check.check import verdict_on
from bayes_sensor.blind_check.plan import Entry, draw_truth, make_plan
from bayes_sensor.blind_check.score import score_case
from bayes_sensor.blind_check.statistics import proportion
from bayes_sensor.blind_check.truth import complete_truth
from bayes_sensor.checks.study_chunks import run_chunks, study_key
from bayes_sensor.reality import Case, make_campaign

PLANNED, SEED = 280, 36
"""campaigns of a whole plan, of which the kinds below are taken"""
KINDS = ("listed", "pair", "unlisted")
LEVELS = (64.0, 256.0)
"""detectabilities asked for; some causes cannot be made that strong"""
BANDS = {"48 to 128": (48.0, 128.0), "128 and more": (128.0, float("inf"))}
"""detectabilities reached, by what the table says"""


VERDICTS = ("effect", "family", "unlisted", "none", "failed")


def entries() -> tuple[Entry, ...]:
    """Causes at every level, each with a rig, a law of noise and a record of its own."""
    levels = cycle(LEVELS)  # of pairs, which a plan gives those of a blind check
    return tuple(
        replace(entry, level=next(levels)) if entry.kind == "pair" else entry
        for entry in make_plan(PLANNED, SEED, levels=LEVELS)
        if entry.kind in KINDS
    )


@dataclass(frozen=True)
class Scoring:
    """The task: one campaign drawn, diagnosed and scored as the blind check's are."""

    entries: tuple[Entry, ...]

    @property
    def key(self) -> str:
        """Everything that the numbers depend on."""
        return study_key("strong", [asdict(e) for e in self.entries], SEED)

    def __call__(self, i: int) -> dict[str, Any]:
        """``row``: JSON, what was true, what was said, and how that compares."""
        entry = self.entries[i]
        truth = complete_truth(draw_truth(entry), entry.name)
        campaign = make_campaign(Case.from_json(truth["recipe"]))
        verdict = verdict_on(campaign, entry.diagnosis_seed, (), "study")
        return {"row": json.dumps({"asked": entry.level, **score_case(truth, verdict)})}


def run(folder: Path, jobs: int, scheduler: str | None, progress: Callable[..., None]) -> None:
    """All campaigns, the table of them and the one of what was said."""
    task = Scoring(entries())
    found = run_chunks(
        task, len(task.entries), folder / "strong", task.key, jobs, 2, scheduler, progress
    )
    cases = table([json.loads(row) for row in found["row"].tolist()])
    cases.to_csv(TABLES / "strong_cases.csv", index=False, float_format="%.5g")
    summed(cases).to_csv(TABLES / "strong.csv", index=False, float_format="%.4g")


def summed(cases: pd.DataFrame) -> pd.DataFrame:
    """One row per kind of cause and detectability: what was said of it, and how often rightly."""
    rows = []
    for kind in KINDS:
        for band, (low, high) in BANDS.items():
            here = cases[(cases["kind"] == kind) & (cases["d"] >= low) & (cases["d"] < high)]
            said = here["verdict"].value_counts()
            held = proportion(here["verdict_right"].astype(bool).tolist())
            rows.append({
                "kind": kind, "d": band, "campaigns": len(here),
                **{word: int(said.get(word, 0)) for word in VERDICTS},
                "wrong_name": int(here["wrong_name"].sum()),
                "confident_wrong": int(here["confident_wrong"].sum()),
                "said": here["p_said"].mean(), "held": held["rate"],
                "lo95": held["lo95"], "hi95": held["hi95"],
            })  # fmt: skip
    return pd.DataFrame(rows)
