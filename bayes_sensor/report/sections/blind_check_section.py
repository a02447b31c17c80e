"""How often the diagnosis is right: the blind check of a folder, and the published one."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from functools import partial
from importlib import resources
from typing import Any

from bayes_sensor.figures import effect_words
from bayes_sensor.report.parts import Part, Picture, Section, Table, see
from bayes_sensor.report.saved import Saved
from bayes_sensor.report.words import list_words

FEW = 200
"""campaigns below which the text calls intervals wide"""


def blind_check(saved: Saved) -> Section | None:
    """Goals, score card and cases of a blind check."""
    card = saved.score
    if card is None:
        return None
    from bayes_sensor.figures.plot_blind_check import score_card

    judged = [goal for goal in card["goals"] if goal["met"] is not None]
    met = sum(goal["met"] for goal in judged)
    answer = (
        f"{met} of the {len(judged)} goals that these cases can judge were met, on {card['n']} "
        f"campaigns whose causes were sealed until the verdicts were recorded"
        f"{see('blind-goals', 'blind-card')}."
    )
    kinds = [f"{n} {kind}" for kind, n in card["kinds"].items()]
    paragraphs = [
        f"Of the campaigns {list_words(kinds)}{see('blind-cases')}. Withheld: the true effect was "
        "taken out of the catalogue first. The size d is the misfit that the refit leaves, in "
        "standard deviations of the noise."
    ]
    if refused := card["failed"]["k"]:
        paragraphs.append(f"The diagnosis refused {refused} of them, which counts as wrong.")
    if card["n"] < FEW:
        paragraphs.append("The number of campaigns is small: read the intervals, not the shares.")
    picture = Picture(
        "blind-card",
        partial(score_card, card),
        "The score card, with 95 % intervals. Top: false alarms on faultless campaigns, "
        "wrong names given with confidence, and the error of tau. Bottom, against the size "
        "d: how often the right family is the likeliest, and how often something unlisted "
        "is found, in blue where a verdict without a name counts if no data would tell; "
        "and stated against true probabilities.",
    )
    goals = goals_table("blind-goals", "Goals and results.", card["goals"])
    content: list[Part] = [goals, picture, _cases_table(saved.cases or [])]
    return Section("blind-check", "How often is the diagnosis right", answer, paragraphs, content)


def goals_table(key: str, caption: str, goals: Sequence[Mapping[str, Any]]) -> Table:
    """Every goal with the result; missed goals are marked."""
    return Table(
        key,
        f"{caption} Intervals hold 95 %: Wilson's, the last from the bootstrap.",
        ["goal", "wanted", "reached", "95 % low", "95 % high", "met"],
        [
            [goal["goal"], goal["wanted"] or "", goal["reached"], goal["lo95"], goal["hi95"],
             goal["met"]]
            for goal in goals
        ],
        digits=3,
        marked=[i for i, goal in enumerate(goals) if goal["met"] is False],
    )  # fmt: skip


def published_goals() -> Table:
    """The goals of the sealed run that came with this version."""
    place = resources.files("bayes_sensor") / "templates" / "blind_check.json"
    published = json.loads(place.read_text(encoding="utf-8"))
    return goals_table(
        "gap-right",
        f"How often diagnoses are right: {published['campaigns']} campaigns of an independent "
        "simulator, their causes sealed until the verdicts were recorded; goals set before.",
        published["goals"],
    )


def _cases_table(rows: Sequence[Mapping[str, str]]) -> Table:
    def words(names: str) -> str:
        return names.replace("+", ", ").replace("_", " ")

    def value(text: str) -> float | None:
        return float(text) if text else None

    return Table(
        "blind-cases",
        "The cases: truth and verdict. Marked: a wrong name given with a probability above 0.9.",
        ["case", "kind", "true cause", "noise", "d", "verdict", "said", "probability", "right"],
        [
            [
                row["case"], row["kind"], words(row["causes"]), words(row["law"]), value(row["d"]),
                row["verdict"], list_words([effect_words(n) for n in row["said"].split("+") if n]),
                value(row["p_said"]), row["verdict_right"] == "True",
            ]
            for row in rows
        ],
        digits=3,
        marked=[i for i, row in enumerate(rows) if row["confident_wrong"] == "True"],
    )  # fmt: skip
