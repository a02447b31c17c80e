"""How likely one sealed run is to meet all of its goals: of the diagnosis, and at the very best.

A run of the blind check has some forty campaigns for a goal, so that even a diagnosis whose rates
are all as wanted misses some of them by chance.  Runs are drawn from the campaigns of all sealed
runs that are kept, with replacement, and scored as those were: once as the verdicts stand, once as
the best would be that can be told from the data, the oracle's.  The latter flags every unlisted
cause that lies three standard deviations or more from any listed effect (and says a family else),
finds every family, errs in tau as a fit does that is told the cause, and says probabilities that
come true as often as they say.  What is left of its misses is what no method can help.
"""

from __future__ import annotations

import hashlib
from collections.abc import Callable
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import study_blind_check
from drawing import TABLES

from bayes_sensor.blind_check import make_card, read_rows
from bayes_sensor.blind_check.oracle import SEPARABLE_ABOVE
from bayes_sensor.blind_check.statistics import proportion
from bayes_sensor.checks.study_chunks import run_chunks, study_key

RUNS, CAMPAIGNS, SEED = 1000, 600, 41
KEPT = study_blind_check.EARLIER, TABLES / "blind_check_first.csv"
"""every case of the sealed runs since the oracle is the present one"""
DIAGNOSES = ("as it stands", "as good as the oracle")
OUTRIGHT, BY_THE_RULE = "unlisted flagged at d = ", "the same, or rightly unnamed, at d = "
"""goals for causes outside the catalogue, of which either kind is one too many"""
WITHHELD = "no confident name from another family where the effect was taken out"
ALL = {
    "all, unlisted ones outright": {BY_THE_RULE, WITHHELD},
    "all, unlisted ones by the rule": {OUTRIGHT, WITHHELD},
    "all by the rule, and no name where the effect was taken out": {OUTRIGHT},
}
"""goals of a run that are asked together: all but those that begin so"""


@cache
def campaigns() -> list[dict[str, Any]]:
    """One row a campaign of every sealed run that is kept."""
    return [row for path in KEPT for row in read_rows(path)]


def at_best(row: dict[str, Any], rng: np.random.Generator) -> dict[str, Any]:
    """What would stand in its row, had the oracle been asked."""
    best = dict(row)
    if row["kind"] == "unlisted":
        apart = row["isolability"] >= SEPARABLE_ABOVE
        best |= {"verdict": "unlisted" if apart else "family", "confident_wrong": False}
    elif row["kind"] == "listed":
        best |= {"family_or_abstained": True, "confident_wrong": False}
        if row["log_error_told"] is not None:
            best["log_error_after"] = row["log_error_told"]
    elif row["kind"] == "withheld":
        best["confident_wrong"] = best["wrong_outside_family"] = False
    if row["p_said"] is not None:
        best["verdict_right"] = bool(rng.random() < row["p_said"])
    return best


def met(rows: list[dict[str, Any]]) -> dict[str, bool]:
    """Which goals a run of these campaigns meets, singly and together."""
    goals = {goal["goal"]: bool(goal["met"]) for goal in make_card(rows)["goals"]}
    goals[WITHHELD] = not any(
        row["confident_wrong"] and row["wrong_outside_family"]
        for row in rows
        if row["kind"] == "withheld"
    )
    return goals | {
        name: all(hit for goal, hit in goals.items() if not goal.startswith(tuple(left_out)))
        for name, left_out in ALL.items()
    }


@dataclass(frozen=True)
class Drawing:
    """The task: one run drawn anew and scored, as the verdicts stand and at best."""

    size: int = CAMPAIGNS
    seed: int = SEED

    @property
    def key(self) -> str:
        """Everything that the numbers depend on."""
        kept = [hashlib.sha256(path.read_bytes()).hexdigest() for path in KEPT]
        return study_key("odds", kept, self.size, self.seed)

    def __call__(self, i: int) -> dict[str, Any]:
        """``goal``: their names; one flag a goal for each of ``DIAGNOSES``."""
        rng = np.random.default_rng([self.seed, i])
        every = campaigns()
        drawn = [every[k] for k in rng.integers(len(every), size=self.size)]
        stands, best = met(drawn), met([at_best(row, rng) for row in drawn])
        return {"goal": list(stands), "stands": list(stands.values()), "best": list(best.values())}


def run(
    folder: Path, jobs: int, scheduler: str | None, progress: Callable[[int, int], None]
) -> None:
    """Draw the runs, then write blind_check_odds.csv, and what is said of it into the pages."""
    task = Drawing()
    found = run_chunks(task, RUNS, folder / "odds", task.key, jobs, 20, scheduler, progress)
    rows = []
    for who, name in zip(("stands", "best"), DIAGNOSES, strict=True):
        for goal, hits in zip(found["goal"][0], found[who].T, strict=True):
            share = proportion(hits.tolist())
            rows.append({"diagnosis": name, "goal": goal, "runs": RUNS, "met_in": share["rate"],
                         "lo95": share["lo95"], "hi95": share["hi95"]})  # fmt: skip
    pd.DataFrame(rows).to_csv(TABLES / "blind_check_odds.csv", index=False, float_format="%.4g")
    study_blind_check.write_pages()
