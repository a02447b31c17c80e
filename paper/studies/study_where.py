"""Whether the phase that the diagnosis finds most of a cause in is the one where it acts.

Causes of the blind check's generator that act in one phase mainly, at a detectability of 32, in the
quick size with AR(1) noise.  The truth is the squared difference that the cause makes to the
noise-free signal, by phase.  ``paper/tables/where.csv`` has one row a campaign.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pandas as pd
from drawing import TABLES

from bayes_sensor.blind_check.plan import Entry, draw_truth
from bayes_sensor.blind_check.simulator import CAUSES, Case, make_campaign
from bayes_sensor.checks.study_chunks import run_chunks, study_key
from bayes_sensor.diagnosis import diagnose_gap
from bayes_sensor.fit import fit_least_squares

SEEDS = (7,)
LEVEL = 32.0
LOCAL = 0.7
"""share of what a cause does that is in one phase, from which it counts as local"""
NAMES = tuple(name for name, cause in CAUSES.items() if not cause.noise)


@dataclass(frozen=True)
class Locating:
    """The task: one cause in one campaign, its phase and the one that is stated."""

    @property
    def key(self) -> str:
        """Everything that the numbers depend on."""
        return study_key("where", NAMES, SEEDS, LEVEL)

    def __call__(self, i: int) -> dict[str, Any]:
        """Phases and shares; empty names where the cause is not local."""
        name, seed = NAMES[i % len(NAMES)], SEEDS[i // len(NAMES)]
        kind = "listed" if CAUSES[name].listed else "unlisted"
        truth = draw_truth(Entry(f"{name} {seed}", kind, (name,), LEVEL, "ar1", "small", seed, 1))
        true, share = largest(truth["acts"])
        if share < LOCAL or truth["d"] < 0.5 * LEVEL:
            return {"true": "", "share": share, "stated": "", "stated_share": 0.0, "d": truth["d"]}
        campaign = make_campaign(Case.from_json(truth["recipe"]))
        fit = fit_least_squares(campaign, seed=1, euler=False, swarms=1)
        gap = diagnose_gap(
            campaign, fit, bootstrap=0, separate=False, follow=False, hidden=False
        )  # fmt: skip
        cells = [{"phase": c.phase, "share": c.share} for c in gap.map.cells]
        stated, of_it = largest(cells)
        return {
            "true": true, "share": share, "stated": stated, "stated_share": of_it, "d": truth["d"],
        }  # fmt: skip


def largest(rows: Sequence[Mapping[str, Any]]) -> tuple[str, float]:
    """The phase with the largest share over all experiments, and the share; "nowhere" of none."""
    shares = pd.DataFrame(rows, columns=["phase", "share"]).groupby("phase")["share"].sum()
    if not shares.sum() > 0.0:
        return "nowhere", 0.0
    return str(shares.idxmax()), float(shares.max())


def run(folder: Path, jobs: int, scheduler: str | None, progress: Callable[..., None]) -> None:
    """Locate all causes and write the table."""
    task = Locating()
    n = len(NAMES) * len(SEEDS)
    found = run_chunks(task, n, folder / "where", task.key, jobs, 2, scheduler, progress)
    rows = pd.DataFrame({
        "cause": [NAMES[i % len(NAMES)] for i in range(n)],
        "seed": [SEEDS[i // len(NAMES)] for i in range(n)],
        **{key: found[key] for key in ("d", "true", "share", "stated", "stated_share")},
    })  # fmt: skip
    rows = rows[rows["true"] != ""]
    rows["right"] = rows["true"] == rows["stated"]
    rows.to_csv(TABLES / "where.csv", index=False, float_format="%.3g")
