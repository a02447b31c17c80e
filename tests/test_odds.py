"""How likely one sealed run is to meet all of its goals: what is drawn, and what the table says."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np
import pandas as pd
import pytest
from scipy.stats import binom

from bayes_sensor.blind_check import read_rows

TABLES = Path(__file__).resolve().parent.parent / "paper" / "tables"


@pytest.fixture
def study(import_study: Callable[[str], ModuleType]) -> ModuleType:
    """``study_odds``."""
    return import_study("study_odds")


@pytest.fixture
def odds() -> pd.DataFrame:
    """The table: one row a goal for either diagnosis."""
    return pd.read_csv(TABLES / "blind_check_odds.csv").set_index(["diagnosis", "goal"])


def by_chance(hits: list[bool], of: int, low: float, high: float = 1.0) -> float:
    """How likely ``low <= k / n <= high`` is in 600 campaigns drawn from ``of``.

    ``hits``: of those that count for the goal.  Both n and k are binomial then.
    """
    n = np.arange(1, 601)[:, None]
    k = np.arange(601)[None, :]
    fits = (k <= n) & (k >= low * n) & (k <= high * n)
    chance = (binom.pmf(k, n, np.mean(hits)) * fits).sum(axis=1)
    return float(binom.pmf(n[:, 0], 600, len(hits) / of) @ chance)


def test_runs_meet_a_goal_as_often_as_the_binomial_says(
    study: ModuleType, odds: pd.DataFrame
) -> None:
    rows = study.campaigns()
    for level in (8.0, 16.0):
        at = [row for row in rows if row["d_level"] == level]
        unlisted = [row for row in at if row["kind"] == "unlisted"]
        listed = [row for row in at if row["kind"] == "listed"]
        flagged = [row["verdict"] == "unlisted" for row in unlisted]
        apart = [row["isolability"] >= 3.0 for row in unlisted]
        family = [row["family_or_abstained"] for row in listed]
        wanted = {8.0: (0.60, 0.90), 16.0: (0.85, 0.97)}[level]
        for name, hits, goal, bound in (
            ("as it stands", flagged, f"unlisted flagged at d = {level:g}", wanted[0]),
            ("as good as the oracle", apart, f"unlisted flagged at d = {level:g}", wanted[0]),
            ("as it stands", family, f"right family at d = {level:g}", wanted[1]),
        ):
            row = odds.loc[(name, goal)]
            chance = by_chance(hits, len(rows), bound)
            spread = np.sqrt(max(chance * (1.0 - chance), 1e-3) / row["runs"])
            assert row["met_in"] == pytest.approx(chance, abs=4.0 * spread), (name, goal)


def test_a_run_is_scored_as_sealed_runs_are(study: ModuleType) -> None:
    goals = pd.read_csv(TABLES / "blind_check_first_goals.csv").set_index("goal")
    rows = read_rows(TABLES / "blind_check_first.csv")
    found = study.met(rows)
    assert {goal: found[goal] for goal in goals.index} == goals["met"].to_dict()
    wrong = [row["confident_wrong"] and row["wrong_outside_family"] for row in rows
             if row["kind"] == "withheld"]  # fmt: skip
    assert found[study.WITHHELD] == (not any(wrong))
    assert set(found) == {*goals.index, study.WITHHELD, *study.ALL}


def test_goals_are_asked_together_with_one_way_of_counting_unlisted_causes(
    study: ModuleType, monkeypatch: pytest.MonkeyPatch
) -> None:
    named = {"kind": "withheld", "confident_wrong": True, "wrong_outside_family": True}
    outright, by_the_rule, withheld_too = study.ALL

    def told(*missed: str, rows: list[dict[str, Any]] | None = None) -> list[bool]:
        every = ("nulls named", *(f"{start}{d}" for d in (8, 16)
                                  for start in (study.OUTRIGHT, study.BY_THE_RULE)))  # fmt: skip
        goals = [{"goal": goal, "met": goal not in missed} for goal in every]
        monkeypatch.setattr(study, "make_card", lambda rows: {"goals": goals})
        found = study.met(rows or [])
        return [found[name] for name in (outright, by_the_rule, withheld_too)]

    assert told() == [True, True, True]
    assert told(f"{study.OUTRIGHT}16") == [False, True, True]
    assert told(f"{study.BY_THE_RULE}8") == [True, False, False]
    assert told("nulls named") == [False, False, False]
    assert told(rows=[named]) == [True, True, False]
    assert told(rows=[{**named, "wrong_outside_family": False}]) == [True, True, True]


def test_at_best_a_verdict_is_what_the_oracle_can_tell(study: ModuleType) -> None:
    rng = np.random.default_rng(3)
    row = {"verdict": "none", "p_said": None, "verdict_right": True, "confident_wrong": True,
           "wrong_outside_family": True, "family_or_abstained": False,
           "log_error_after": 1.0, "log_error_told": None}  # fmt: skip
    near, far = ({**row, "kind": "unlisted", "isolability": apart} for apart in (2.9, 3.0))
    assert study.at_best(near, rng)["verdict"] == "family"
    assert study.at_best(far, rng)["verdict"] == "unlisted"
    assert not study.at_best(far, rng)["confident_wrong"]
    listed = study.at_best({**row, "kind": "listed"}, rng)
    assert listed["family_or_abstained"] and listed["log_error_after"] == 1.0
    told = study.at_best({**row, "kind": "listed", "log_error_told": 0.2}, rng)
    assert told["log_error_after"] == 0.2 and not told["confident_wrong"]
    withheld = study.at_best({**row, "kind": "withheld"}, rng)
    assert not withheld["confident_wrong"] and withheld["verdict"] == "none"
    assert row["confident_wrong"]  # what is given is left as it is
    # probabilities come true as often as they say
    said = {**row, "kind": "null", "p_said": 0.8}
    assert np.mean([study.at_best(said, rng)["verdict_right"] for _ in range(4000)]) == (
        pytest.approx(0.8, abs=0.03)
    )


def test_a_run_is_the_same_whenever_it_is_drawn(study: ModuleType) -> None:
    task = study.Drawing(size=200, seed=5)
    one, again, other = task(0), task(0), task(1)
    assert one == again
    assert len(one["goal"]) == len(one["stands"]) == len(one["best"])
    assert one["goal"] == other["goal"] and one != other
    assert task.key != study.Drawing(size=200, seed=6).key


def test_the_page_says_what_the_table_does(odds: pd.DataFrame) -> None:
    page = (TABLES.parent.parent / "docs" / "blind_check.md").read_text(encoding="utf-8")
    best = odds.met_in["as good as the oracle"]
    assert "all goals in one run of six" in " ".join(page.split())
    assert best["all, unlisted ones outright"] == pytest.approx(1 / 6, abs=0.015)
    assert 0.55 < best["unlisted flagged at d = 16"] < 0.65  # two in five have not enough of them
    assert 0.45 < best["error of ln tau, after over before"] < 0.55
    assert (best >= odds.met_in["as it stands"] - 0.04).all()
