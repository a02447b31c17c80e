"""What causes outside the catalogue look like: the weights of the gap's discrepancies.

Campaigns of the blind check's generator with an unlisted cause, none of them in reserve, and what
every configuration of the smooth discrepancy says of each.  The weights that make these campaigns
likeliest are found by expectation-maximisation, as a product of weights of the part, of how rise
and fall belong together and of what experiments share, and stand beside those that the diagnosis
takes.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from drawing import TABLES
from scipy.special import logsumexp

from bayes_sensor.blind_check.plan import LEVELS, Entry, draw_truth, make_plan
from bayes_sensor.blind_check.simulator import Case, make_campaign
from bayes_sensor.campaign import FloatArray
from bayes_sensor.checks.study_chunks import run_chunks, study_key
from bayes_sensor.diagnosis.data.preparation import fit_base, prepare
from bayes_sensor.diagnosis.evidence.discrepancy import (
    FALL,
    MIRRORED,
    RISE,
    VOLUME,
    Discrepancy,
    make_discrepancies,
)
from bayes_sensor.diagnosis.evidence.laplace_evidence import Linearised
from bayes_sensor.fit import fit_least_squares
from bayes_sensor.rig.layout import Layout

SEED = 71
PLANNED = 1200
"""cases of a plan; those with an unlisted cause that can be seen are taken"""
VISIBLE = (8.0, 16.0)
"""detectabilities"""
STEPS = 200
HELD_BACK = 4.0
"""campaigns that even weights count for"""
SHARED = (" alike", " each", " by concentration")
"""what the names of configurations say; the others follow the flow, if anything"""
COURSES = (VOLUME + MIRRORED, VOLUME, MIRRORED, RISE, FALL)
"""what they say of rise and fall; the others let either take its own course"""


@dataclass(frozen=True)
class LookingAlike:
    """The task: what every configuration says of one campaign."""

    entries: tuple[Entry, ...]

    @property
    def key(self) -> str:
        """Everything that the numbers depend on."""
        return study_key("unlisted", [asdict(e) for e in self.entries], SEED)

    def __call__(self, i: int) -> dict[str, Any]:
        """``log_z``: JSON, ln evidence over that of nothing."""
        line, made = discrepancies_of(self.entries[i])
        nothing = line.evidence(None).log_z
        return {"log_z": json.dumps({d.name: line.evidence(d).log_z - nothing for d in made})}


def discrepancies_of(entry: Entry) -> tuple[Linearised, list[Discrepancy]]:
    """The fit without effects of an entry's campaign, and all configurations around it."""
    campaign = make_campaign(Case.from_json(draw_truth(entry)["recipe"]))
    fit = fit_least_squares(campaign, seed=entry.diagnosis_seed, euler=False, swarms=1)
    binned = prepare(campaign, Layout.of(campaign).flat(fit.theta_hat)).binned
    base = fit_base(binned)
    return Linearised(base), make_discrepancies(binned, base)


def run(folder: Path, jobs: int, scheduler: str | None, progress: Callable[..., None]) -> None:
    """Evidences of all campaigns, the weights that fit them best, and the table."""
    entries = tuple(
        e
        for e in make_plan(PLANNED, SEED, levels=LEVELS)
        if e.kind == "unlisted" and e.level in VISIBLE
    )
    task = LookingAlike(entries)
    found = run_chunks(
        task, len(entries), folder / "unlisted", task.key, jobs, 2, scheduler, progress
    )
    said = [json.loads(text) for text in found["log_z"].tolist()]
    usual = next(e for e in entries if e.size == "paper")
    write_table(said, {d.name: d.alone for d in discrepancies_of(usual)[1]})


def parts_of(name: str) -> tuple[str, str, str]:
    """A configuration's part, its course and what experiments share of it; not its size."""
    if " and drift" in name:
        return "response and drift", "", ""
    words = name.rsplit(" ", 1)[0]
    if words.startswith(("drift", "gain", "herald")):
        return words, "", ""
    shared = next((s for s in SHARED if words.endswith(s)), "")
    words = words.removesuffix(shared)
    signature = next((c for c in COURSES if words.endswith(c)), "")
    words = words.removesuffix(signature)
    if words.startswith(("response", "timing")):
        signature = signature or "apart"
    return words, signature.strip(), shared.strip() or "by flow"


def likeliest(said: Sequence[dict[str, float]]) -> list[dict[str, float]]:
    """Weights of parts, of courses and of what is shared, summing to 1 each."""
    names = sorted({name for each in said for name in each})
    logs = np.array([[each.get(name, -np.inf) for name in names] for each in said])
    kinds = [parts_of(name) for name in names]
    siblings = np.array([kinds.count(kind) for kind in kinds])
    labels = list(zip(*kinds, strict=True))
    weights = [{x: 1.0 / len(set(of) - {""}) for x in of if x} for of in labels]
    for _ in range(STEPS):
        product = np.array([
            np.prod([w.get(x, 1.0) for w, x in zip(weights, kind, strict=True)]) for kind in kinds
        ])  # fmt: skip
        count = _responsible(logs, product / siblings)
        weights = [_even(w, of, count) for w, of in zip(weights, labels, strict=True)]
    return weights


def _responsible(logs: FloatArray, weights: FloatArray) -> FloatArray:
    """(n_configurations,) campaigns that each accounts for."""
    share = logs + np.log(weights)
    count: FloatArray = np.exp(share - logsumexp(share, axis=1, keepdims=True)).sum(axis=0)
    return count


def _even(before: dict[str, float], labels: Sequence[str], count: FloatArray) -> dict[str, float]:
    """New weights by label, leaning on even ones."""
    made = {
        name: HELD_BACK / len(before) + float(count[[x == name for x in labels]].sum())
        for name in before
    }
    whole = sum(made.values())
    return {name: value / whole for name, value in made.items()}


def write_table(said: Sequence[dict[str, float]], taken: dict[str, float]) -> None:
    """The learned weights beside those that the diagnosis takes."""
    learned = likeliest(said)
    now: list[dict[str, float]] = [{} for _ in learned]
    for name, weight in taken.items():
        for found, label in zip(now, parts_of(name), strict=True):
            if label:
                found[label] = found.get(label, 0.0) + weight
    rows = [
        {"of": of, "name": name, "learned": weight, "taken": found[name] / whole}
        for of, weights, found in zip(("part", "course", "shared"), learned, now, strict=True)
        for whole in [sum(found[name] for name in weights)]
        for name, weight in sorted(weights.items())
    ]
    frame = pd.DataFrame(rows)
    frame["campaigns"] = len(said)
    frame.to_csv(TABLES / "unlisted_weights.csv", index=False, float_format="%.3f")
