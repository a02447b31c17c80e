"""Which causes outside the catalogue are told from noise and from listed effects, and which not.

Every unlisted cause of the blind check's generator, those that earlier sealed runs had kept
included, once at either detectability, under AR(1) or white noise; the verdicts are those of the
blind check's study setting.  Causes are grouped by what an oracle sees of them, before any verdict.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from drawing import TABLES

from bayes_sensor.blind_check import wilson
from bayes_sensor.blind_check.check import verdict_on
from bayes_sensor.blind_check.oracle import SEPARABLE_ABOVE
from bayes_sensor.blind_check.plan import AR1_LAWS, Entry, draw_truth
from bayes_sensor.checks.study_chunks import run_chunks, study_key
from bayes_sensor.reality import CAUSES, Case, make_campaign

SEED = 83
LEVELS = (8.0, 16.0)
"""detectabilities"""
REACHED = 0.75
"""share of the detectability asked for below which a cause cannot be made that strong"""
SWITCHING = ("onset", "rise", "fall")
"""phases that the valve sets off"""
KINDS = {
    "switches": "acts mostly while the signal rises or falls",
    "elsewhere": "acts mostly on plateaus and baselines",
    "fast": "swings or crackles faster than the response",
    "alike": "lies nearer than three standard deviations to a listed effect",
}
"""kinds of causes; one is alike before it is anything else"""


def entries() -> tuple[Entry, ...]:
    """Every cause at every level, with a rig, a law of noise and a record of its own."""
    rng = np.random.default_rng(SEED)
    found = []
    for level in LEVELS:
        for name in sorted(n for n, c in CAUSES.items() if not c.listed and not c.reserve):
            seeds = rng.integers(1, 2**31, size=2)
            law = str(rng.choice(AR1_LAWS))
            size = "paper" if rng.random() < 2.0 / 3.0 else "varied"
            found.append(Entry(f"{name}-{level:g}", "unlisted", (name,), level, law, size,
                               int(seeds[0]), int(seeds[1])))  # fmt: skip
    return tuple(found)


def kind_of(truth: Mapping[str, Any]) -> str:
    """One of :data:`KINDS`, from what the oracle sees of a sealed truth."""
    if not truth["rivals"]:
        return "fast"
    if min(truth["rivals"].values()) < SEPARABLE_ABOVE:
        return "alike"
    at_switches = sum(v["share"] for v in truth["visible"] if v["phase"] in SWITCHING)
    return "switches" if at_switches > 0.5 else "elsewhere"


@dataclass(frozen=True)
class Telling:
    """The task: one campaign with a cause outside the catalogue, drawn and diagnosed."""

    entries: tuple[Entry, ...]

    @property
    def key(self) -> str:
        """Everything that the numbers depend on."""
        return study_key("unlisted-kinds", [asdict(e) for e in self.entries], SEED)

    def __call__(self, i: int) -> dict[str, Any]:
        """Cause, kind and d; verdict, what it names and the probability of something unlisted."""
        entry = self.entries[i]
        truth = draw_truth(entry)
        campaign = make_campaign(Case.from_json(truth["recipe"]))
        record = verdict_on(campaign, entry.diagnosis_seed, (), "study")
        verdict = record["verdict"]
        unlisted = [r["probability"] for r in record["which"] if r["effect"] == "unlisted"]
        return {
            "cause": entry.causes[0],
            "d_level": entry.level,
            "d": truth["d"],
            "isolability": min(truth["rivals"].values(), default=float("inf")),
            "kind": kind_of(truth),
            "verdict": verdict["kind"],
            "said": "+".join(verdict["effects"]),
            "p_unlisted": sum(unlisted),
        }


def run(folder: Path, jobs: int, scheduler: str | None, progress: Callable[..., None]) -> None:
    """All campaigns, the table of them and the one by kind."""
    task = Telling(entries())
    found = run_chunks(
        task, len(task.entries), folder / "unlisted-kinds", task.key, jobs, 2, scheduler, progress
    )
    cases = pd.DataFrame({name: np.asarray(values) for name, values in found.items()})
    cases.to_csv(TABLES / "unlisted_kinds_cases.csv", index=False, float_format="%.4g")
    by_kind(cases).to_csv(TABLES / "unlisted_kinds.csv", index=False, float_format="%.3f")


def by_kind(cases: pd.DataFrame) -> pd.DataFrame:
    """One row per kind and detectability, and one for all kinds together."""
    reached = cases[cases["d"] > REACHED * cases["d_level"]]
    rows = []
    for level in LEVELS:
        here = reached[reached["d_level"] == level]
        groups: Sequence[tuple[str, pd.DataFrame]] = [
            *((kind, here[here["kind"] == kind]) for kind in KINDS), ("all", here)
        ]  # fmt: skip
        for kind, some in groups:
            n, flagged = len(some), int((some["verdict"] == "unlisted").sum())
            low, high = wilson(flagged, n)
            rows.append({
                "kind": kind, "d": level, "campaigns": n, "flagged": flagged,
                "share": flagged / max(n, 1), "lo95": low, "hi95": high,
                "named": int(some["verdict"].isin(("effect", "family")).sum()),
                "passed for noise": int((some["verdict"] == "none").sum()),
                "what": KINDS.get(kind, "all of them"),
            })  # fmt: skip
    return pd.DataFrame(rows)
