"""Causes stronger than the blind check's: which are drawn, how they are counted, the tables."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from types import ModuleType
from typing import Any

import pandas as pd
import pytest

from bayes_sensor.blind_check import wilson
from bayes_sensor.blind_check.simulator import CAUSES

TABLES = Path(__file__).resolve().parent.parent / "paper" / "tables"


@pytest.fixture
def study(import_study: Callable[[str], ModuleType]) -> ModuleType:
    """``study_strong``."""
    return import_study("study_strong")


def test_causes_and_pairs_are_drawn_far_beyond_the_blind_check(study: ModuleType) -> None:
    entries = study.entries()
    assert min(study.LEVELS) > 32.0
    for kind in study.KINDS:
        assert {e.level for e in entries if e.kind == kind} == set(study.LEVELS)
    for e in entries:
        assert len(e.causes) == 1 + (e.kind == "pair")
        for name in e.causes:
            assert bool(CAUSES[name].listed) == (e.kind != "unlisted")
            assert not CAUSES[name].reserve
    assert len({e.name for e in entries}) == len(entries)


def case(d: float, verdict: str, right: bool, confident: bool = False) -> dict[str, Any]:
    """What is counted of one campaign."""
    return {
        "kind": "unlisted", "d": d, "verdict": verdict, "verdict_right": right, "p_said": 0.8,
        "wrong_name": confident or (verdict == "effect" and not right),
        "confident_wrong": confident,
    }  # fmt: skip


def test_verdicts_are_counted_by_the_size_that_was_reached(study: ModuleType) -> None:
    weak, strong = study.BANDS
    cases = pd.DataFrame([
        case(47.0, "none", False),  # too weak for either
        case(48.0, "unlisted", True), case(64.0, "effect", False, confident=True),
        case(127.0, "family", True), case(128.0, "unlisted", True), case(256.0, "effect", False),
    ])  # fmt: skip
    table = study.summed(cases).set_index(["kind", "d"])
    row = table.loc[("unlisted", weak)]
    assert row[["campaigns", "effect", "family", "unlisted", "none"]].tolist() == [3, 1, 1, 1, 0]
    assert (row["wrong_name"], row["confident_wrong"]) == (1, 1)
    assert row["said"] == pytest.approx(0.8) and row["held"] == pytest.approx(2 / 3)
    assert (row["lo95"], row["hi95"]) == pytest.approx(wilson(2, 3))
    row = table.loc[("unlisted", strong)]
    assert row[["campaigns", "effect", "unlisted"]].tolist() == [2, 1, 1]
    assert (row["wrong_name"], row["confident_wrong"]) == (1, 0)
    assert table.loc[("listed", strong), "campaigns"] == 0


def test_the_tables_say_the_same(study: ModuleType) -> None:
    cases = pd.read_csv(TABLES / "strong_cases.csv", keep_default_na=False, na_values=[""])
    table = pd.read_csv(TABLES / "strong.csv")
    again = study.summed(cases)
    assert again["kind"].tolist() == table["kind"].tolist()
    numbers = table.columns.difference(["kind", "d"])
    assert again[numbers].to_numpy(float) == pytest.approx(table[numbers].to_numpy(float), rel=1e-3)
    # what the page says of them
    seen = cases[cases["d"] >= min(low for low, _ in study.BANDS.values())]
    inside, outside = seen[seen["kind"] != "unlisted"], seen[seen["kind"] == "unlisted"]
    counts = seen.groupby("kind")["verdict"].agg(lambda said: (said == "unlisted").sum())
    sizes = seen["kind"].value_counts()
    assert [sizes[k] for k in study.KINDS] == [44, 14, 51]
    assert [counts.get(k, 0) for k in study.KINDS] == [0, 0, 45]
    assert not seen["wrong_name"].any()
    assert inside["verdict"].isin(("effect", "family")).all() and inside["verdict_right"].all()
    missed = outside[outside["verdict"] != "unlisted"]
    said = missed.set_index("causes")["verdict"]
    assert said.value_counts().to_dict() == {"family": 4, "effect": 1, "none": 1}
    assert said["slipping_clamp"] == "none" and said["foreign_gas_factor"] == "effect"
    named, family = (missed[missed["verdict"] == word] for word in ("effect", "family"))
    assert named["isolability"].item() < 3.0
    assert (family["isolability"] < family["d"] / 4.0).sum() == 3
