"""Which kinds of unlisted causes are told: how causes are grouped and counted, and the tables."""

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
    """``study_unlisted_kinds``."""
    return import_study("study_unlisted_kinds")


def truth(rivals: dict[str, float], **shares: float) -> dict[str, Any]:
    """What an oracle says of a cause: distances of listed effects, shares of the phases."""
    visible = [{"experiment": "1", "phase": p, "share": s} for p, s in shares.items()]
    return {"rivals": rivals, "visible": visible}


def test_every_unlisted_cause_is_drawn_once_at_every_level(study: ModuleType) -> None:
    entries = study.entries()
    outside = {n for n, c in CAUSES.items() if not c.listed and not c.reserve}
    for level in study.LEVELS:
        drawn = [e.causes[0] for e in entries if e.level == level]
        assert len(drawn) == len(set(drawn)) and set(drawn) == outside
    assert len({e.seed for e in entries}) == len(entries)


def test_causes_are_grouped_by_what_an_oracle_sees(study: ModuleType) -> None:
    far, near = {"a": 3.1, "b": 7.0}, {"a": 2.9, "b": 7.0}
    assert study.kind_of(truth({})) == "fast"
    assert study.kind_of(truth(near, rise=1.0)) == "alike"
    assert study.kind_of(truth(far, onset=0.1, rise=0.3, fall=0.2, plateau=0.4)) == "switches"
    assert study.kind_of(truth(far, rise=0.4, plateau=0.4, tail=0.2)) == "elsewhere"


def test_verdicts_are_counted_by_kind(study: ModuleType) -> None:
    told = [("fast", 8.0, 8.1, v) for v in ("unlisted", "none", "family", "effect", "unlisted")]
    told += [("alike", 16.0, 15.8, "family"), ("alike", 16.0, 11.9, "unlisted")]  # one too weak
    columns = ["kind", "d_level", "d", "verdict"]
    table = study.by_kind(pd.DataFrame(told, columns=columns)).set_index(["kind", "d"])
    for kind in ("fast", "all"):
        row = table.loc[kind, 8.0]
        assert (row["campaigns"], row["flagged"], row["named"], row["passed for noise"]) == (
            5,
            2,
            2,
            1,
        )
        assert (row["lo95"], row["hi95"]) == pytest.approx(wilson(2, 5))
    assert table.loc[("alike", 16.0), "campaigns"] == 1
    assert table.loc[("alike", 16.0), "flagged"] == 0
    assert table.loc[("switches", 8.0), "campaigns"] == 0


def test_the_tables_say_the_same(study: ModuleType) -> None:
    cases = pd.read_csv(TABLES / "unlisted_kinds_cases.csv", keep_default_na=False)
    table = pd.read_csv(TABLES / "unlisted_kinds.csv")
    again = study.by_kind(cases)
    assert again["what"].tolist() == table["what"].tolist()
    for name in ("campaigns", "flagged", "named", "passed for noise", "share", "lo95", "hi95"):
        assert table[name].tolist() == pytest.approx(again[name].tolist(), abs=6e-4)
    assert not cases["verdict"].eq("failed").any()
    counts = table.set_index(["kind", "d"])
    for d in study.LEVELS:  # what the page says of the kinds
        assert counts.loc[("switches", d), "share"] > 0.5
        alike = counts.loc[("alike", d)]
        assert alike["named"] > 0.5 * alike["campaigns"]
    passed = counts["passed for noise"] / counts["campaigns"]
    assert 0.5 < passed[("elsewhere", 8.0)] < 0.6 and passed[("fast", 8.0)] > 0.8
    assert counts.loc[("elsewhere", 16.0), "share"] > 0.5
    assert 0.35 < passed[("fast", 16.0)] < 0.45
    seen = counts.loc[[("switches", 16.0), ("elsewhere", 16.0)], "campaigns"].sum()
    others = counts.loc[[("fast", 16.0), ("alike", 16.0)], "flagged"].sum()
    n = counts.loc[("all", 16.0), "campaigns"]
    assert (seen + others - 2) / n < 0.85 < (seen + others) / n
