"""The score card: scored cases together, with BIC beside the diagnosis.

Proportions have Wilson's 95 % interval, everything else one from the bootstrap over cases.  The
card is made from the rows of the cases alone, so that it can be made again from their table.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from bayes_sensor.blind_check.plan import LEVELS
from bayes_sensor.blind_check.score import (
    OUTSIDE,
    SEPARABLE_ABOVE,
    VISIBLE,
    families_of,
    score_case,
)
from bayes_sensor.blind_check.statistics import (
    Row,
    area,
    average,
    calibration,
    drawn_anew,
    proportion,
)
from bayes_sensor.diagnosis.unseen_effects import UNSEEN

if TYPE_CHECKING:
    import pandas as pd

SMALL = 0.05
"""p-value below which a gap counts as found"""
GOALS_AT = (8.0, 16.0)
"""detectabilities that goals are set for"""


def score(cases: Sequence[tuple[Mapping[str, Any], Mapping[str, Any]]]) -> tuple[Row, list[Row]]:
    """The card and one row a case."""
    rows = [score_case(truth, verdict) for truth, verdict in cases]
    return make_card(rows), rows


def make_card(rows: Sequence[Row]) -> Row:
    """Everything the card says, from the rows of the cases."""
    kinds = list(dict.fromkeys(row["kind"] for row in rows))
    of = {
        kind: [row for row in rows if row["kind"] == kind]
        for kind in ("null", "listed", "pair", "unlisted", "withheld", "hidden")
    }
    drawn_to_hide = of["hidden"]
    of["hidden"] = [row for row in drawn_to_hide if (row["d"] or 0.0) < UNSEEN]
    visible = [row for row in rows if row["kind"] != "hidden"]
    others = [*of["null"], *of["listed"], *drawn_to_hide]
    strong = [row for row in of["unlisted"] if row["d_level"]]
    nulls, pairs, withheld = of["null"], of["pair"], of["withheld"]
    at_fault = {kind: some for kind, some in of.items() if kind != "null"}
    card: Row = {
        "n": len(rows),
        "kinds": {kind: sum(row["kind"] == kind for row in rows) for kind in kinds},
        "failed": _stated(rows, "failed"),
        "nulls": {
            "all": _alarms(nulls),
            "ar1": _alarms([r for r in nulls if r["is_ar1"]]),
            "not_ar1": _alarms([r for r in nulls if r["is_ar1"] is False]),
            "by_law": {
                law: _alarms([r for r in nulls if r["law"] == law])
                for law in sorted({r["law"] for r in nulls})
            },
        },
        "accuracy": [_accuracy(of["listed"], level) for level in LEVELS],
        "confident_wrong": {
            **{k: _share(some, "confident_wrong") for k, some in at_fault.items()},
            "withheld_outside_family": _share(
                withheld, lambda r: r["confident_wrong"] and r["wrong_outside_family"]
            ),
            # names that are near the cause, and not charged above, count as wrong here
            **{f"{k}_without_near": _share(of[k], _confident_other)
               for k in ("listed", "pair", "unlisted")},
            **{f"bic_{k}": _share(some, _bic_wrong) for k, some in at_fault.items()},
        },
        "unlisted": {
            "flagged": [_flagged(of["unlisted"], level) for level in LEVELS],
            "withheld_flagged": [_flagged(withheld, level) for level in LEVELS],
            "withheld_flagged_or_family": _share(withheld, "verdict_right"),
            "roc": area(*([r["p_unlisted"] for r in some] for some in (strong, others))),
        },
        "pairs": {
            "both_right": _share(pairs, "top_right"),
            "nothing_wrong_named": _share(pairs, lambda r: not r["wrong_name"]),
            "one_of_them_said": _share(pairs, lambda r: bool(_said(r) & _answers(r))),
        },
        "calibration": {
            "verdict": calibration(visible, "p_said", "verdict_right"),
            "top_answer": calibration([r for r in visible if r["kind"] != "pair"],
                                      "p_top", "top_right"),
            "by_verdict": _by_verdict(visible),
        },
        "scores": {
            "all": _scores(visible),
            **{kind: _scores(of.get(kind, [])) for kind in kinds},
        },
        "set95": {
            **_set_part(visible), "by_kind": {kind: _set_part(of.get(kind, [])) for kind in kinds},
        },
        "closed_fraction": [_closed(of["listed"], level) for level in LEVELS[1:]],
        "p_value": {
            "null": proportion(None if r["gap_p"] is None else r["gap_p"] < SMALL for r in nulls)
        },
        "localisation": _localisation(rows),
        "tau": _tau(of["listed"]),
        "envelope": {
            "hidden": _share(of["hidden"], "envelope_holds"),
            "drawn_to_hide": len(drawn_to_hide),
            "drawn_stronger": len(drawn_to_hide) - len(of["hidden"]),
            "null": _share(nulls, "envelope_holds"),
            "d_below_3": _share(
                [r for r in rows if r["d"] is not None and r["d"] < UNSEEN],
                "envelope_holds",
            ),
        },
    }  # fmt: skip
    card["goals"] = _goals(card)
    return card


def _share(rows: Sequence[Row], of: str | Callable[[Row], Any]) -> Row:
    """Share of the rows in which a column, or a function of the row, is true."""
    return proportion(row[of] if isinstance(of, str) else of(row) for row in rows)


def _stated(rows: Sequence[Row], verdict: str) -> Row:
    return proportion(row["verdict"] == verdict for row in rows)


def _at(rows: Sequence[Row], level: float) -> list[Row]:
    return [row for row in rows if row["d_level"] == level]


def _said(row: Row) -> set[str]:
    return set(row["said"].split("+"))


def _listed_as(row: Row) -> set[str]:
    """Every name that is right for one of the causes, or was before it was taken out."""
    return set(row["listed_as"].replace("|", "+").split("+")) - {""}


def _answers(row: Row) -> set[str]:
    """Every name that is right; none outside the catalogue."""
    return set() if row["kind"] in OUTSIDE else _listed_as(row)


def _bic_wrong(row: Row) -> bool:
    return row["bic_says"] != "none" and row["bic_says"] not in _answers(row)


def _confident_other(row: Row) -> bool:
    """A confident name that is no right answer, be it as near as may be."""
    return bool(row["named_confidently"]) and not _said(row) <= _answers(row)


def _alarms(nulls: Sequence[Row]) -> Row:
    return {
        "named": _share(nulls, "named"),
        "named_or_family": _share(nulls, lambda r: r["verdict"] in ("effect", "family")),
        "alarmed": _share(nulls, lambda r: r["verdict"] != "none"),
        "bic_named": _share(nulls, lambda r: r["bic_says"] != "none"),
    }


def _by_verdict(rows: Sequence[Row]) -> dict[str, Row]:
    """How likely each kind of verdict says that it holds, and how often it does."""
    found: dict[str, list[Row]] = {}
    for row in rows:
        if row["p_said"] is not None:
            found.setdefault(row["verdict"], []).append(row)
    return {
        kind: {
            **average("said", (row["p_said"] for row in some)),
            "right": _share(some, "verdict_right"),
        }
        for kind, some in sorted(found.items())
    }


def _scores(rows: Sequence[Row]) -> Row:
    return {
        **average("brier", (r["brier"] for r in rows)),
        **average("log_score", (r["log_score"] for r in rows)),
    }


def _set_part(rows: Sequence[Row]) -> Row:
    """How often the 95 % set holds the right answer, and how many rows it holds."""
    return {
        "coverage": _share(rows, "in_set"),
        **average("mean_size", (r["set_size"] for r in rows)),
    }


def _accuracy(listed: Sequence[Row], level: float) -> Row:
    """Shares that are right at a level of d, with and without the rule of abstention."""
    rows = _at(listed, level)
    return {
        "d": level,
        "top": _share(rows, "top_right"),
        "top_or_abstained": _share(rows, "top_or_abstained"),
        "family": _share(rows, "family_right"),
        "family_or_abstained": _share(rows, "family_or_abstained"),
        "quiet": _stated(rows, "none"),
        "top_bic": _share(rows, lambda r: r["bic_says"] in _answers(r)),
        "family_bic": _share(
            rows, lambda r: families_of([r["bic_says"]]) <= families_of(_listed_as(r))
        ),
    }


def _flagged(rows: Sequence[Row], level: float) -> Row:
    """Shares called unlisted; a family is right where an effect looks like the cause."""
    at = _at(rows, level)
    apart = [r for r in at if r["isolability"] >= SEPARABLE_ABOVE]
    return {
        "d": level,
        "flagged": _stated(at, "unlisted"),
        "flagged_where_separable": _stated(apart, "unlisted"),
        "flagged_or_unnamed": _share(
            at,
            lambda r: (
                r["verdict"] == "unlisted"
                or (r["verdict"] == "family" and r["isolability"] < SEPARABLE_ABOVE)
            ),
        ),
        "within_reach": _share(at, lambda r: r["isolability"] >= SEPARABLE_ABOVE),
        "quiet": _stated(at, "none"),
    }


def _closed(listed: Sequence[Row], level: float) -> Row:
    at = [r for r in _at(listed, level) if None not in (r["closed"], r["closed_oracle"])]

    def error(row: Row, key: str) -> float | None:
        return None if row[key] is None else abs(row[key] - row["closed_oracle"])

    def covers(row: Row) -> bool | None:
        low, high = row["closed_lo"], row["closed_hi"]
        return None if None in (low, high) else bool(low <= row["closed_oracle"] <= high)

    held_out = (error(r, "closed_held_out") for r in at)
    return {
        "d": level,
        "n": len(at),
        **average("median_error", (error(r, "closed") for r in at), median=True),
        **average("median_error_held_out", held_out, median=True),
        "coverage": _share(at, covers),
    }


def _localisation(rows: Sequence[Row]) -> Row:
    """Of the campaigns ``of`` which a place could be stated, the ``n`` with one."""
    seen = [r for r in rows if r["located"] is not None]

    def f1(row: Row) -> float:
        p, r = row["place_precision"], row["place_recall"]
        return 2.0 * p * r / (p + r) if p and r else 0.0

    return {
        "n": len(seen),
        "of": sum(r["places"] is not None for r in rows) or None,
        **average("share", (r["located"] for r in seen)),
        **average("precision", (r["place_precision"] for r in seen)),
        **average("recall", (r["place_recall"] for r in seen)),
        **average("f1", map(f1, seen)),
    }


def _tau(listed: Sequence[Row]) -> Row:
    """Mean error of ln tau before and after the effect is added, where it was seen and named.

    Causes that leave the mean alone move no estimate of tau and do not count.
    """
    errors = [
        (r["log_error_before"], r["log_error_after"])
        for r in listed
        if r["verdict"] in ("effect", "family") and r["verdict_right"] and r["on_mean"]
        and (r["d"] or 0.0) >= VISIBLE
        and None not in (r["log_error_before"], r["log_error_after"])
    ]  # fmt: skip
    if not errors:
        return {"n": 0, **dict.fromkeys(("before", "after", "ratio", "ratio_lo95", "ratio_hi95"))}
    before, after = np.array(errors).T
    pick = drawn_anew(len(errors))
    ratios = after[pick].mean(axis=1) / np.maximum(before[pick].mean(axis=1), 1e-12)
    return {
        "n": len(errors),
        **average("before", before),
        **average("after", after),
        "ratio": float(after.mean() / max(before.mean(), 1e-12)),
        "ratio_lo95": float(np.quantile(ratios, 0.025)),
        "ratio_hi95": float(np.quantile(ratios, 0.975)),
    }


# --------------------------------------------------------------------------- goals


def _goals(card: Row) -> list[Row]:
    """What was set out to be reached, and whether it was (by the rate itself)."""

    def at(table: Sequence[Row], d: float) -> Row:
        return next(row for row in table if row["d"] == d)

    flagged, accuracy, wrong = card["unlisted"]["flagged"], card["accuracy"], "confident_wrong"
    wanted: list[tuple[str, str, float, Row]] = [
        ("nulls named", "<=", 0.02, card["nulls"]["all"]["named"]),
        ("confident wrong name, listed", "<=", 0.02, card[wrong]["listed"]),
        ("confident wrong name, unlisted", "<=", 0.10, card[wrong]["unlisted"]),
    ]
    for key, name, table, least in (
        ("family_or_abstained", "right family", accuracy, (0.90, 0.97)),
        ("flagged", "unlisted flagged", flagged, (0.60, 0.85)),
        ("flagged_or_unnamed", "the same, or rightly unnamed,", flagged, (0.60, 0.85)),
    ):
        wanted += [
            (f"{name} at d = {d:g}", ">=", bound, at(table, d)[key])
            for d, bound in zip(GOALS_AT, least, strict=True)
        ]
    goals = [_goal(name, sign, bound, part["rate"], part) for name, sign, bound, part in wanted]
    verdict, closed, tau = card["calibration"]["verdict"], card["closed_fraction"], card["tau"]
    closed = at(closed, 16.0)
    covers = closed["coverage"]
    rate = covers["rate"]
    between = {"lo95": tau["ratio_lo95"], "hi95": tau["ratio_hi95"]}
    return [
        *goals,
        _goal("calibration error inside its band", "<=", verdict["band95"], verdict["ece"]),
        _goal("median error of the closed fraction at d = 16", "<=", 0.05, closed["median_error"]),
        {
            **_goal("its interval covers at d = 16", ">=", 0.90, rate, covers),
            "wanted": ".90 to .98",
            "met": None if rate is None else 0.90 <= rate <= 0.98,
        },
        _goal("error of ln tau, after over before", "<=", 0.5, tau["ratio"], between),
    ]


def _goal(
    name: str, sign: str, bound: float | None, reached: float | None, part: Row | None = None
) -> Row:
    met = None
    if reached is not None and bound is not None:
        met = reached <= bound if sign == "<=" else reached >= bound
    return {
        "goal": name,
        "wanted": None if bound is None else f"{sign} {bound:.3g}",
        "reached": reached,
        "lo95": part["lo95"] if part else None,
        "hi95": part["hi95"] if part else None,
        "met": met,
    }


# --------------------------------------------------------------------------- tables


def table(rows: Sequence[Row]) -> pd.DataFrame:
    """One row a case, in the order of their names."""
    import pandas as pd

    frame = pd.DataFrame(list(rows))
    return frame.sort_values("case", ignore_index=True) if len(frame) else frame


def card_table(card: Row) -> pd.DataFrame:
    """Every number of the card, one a row: where it stands, of how many cases, and its interval.

    Proportions have ``k`` and ``rate``, everything else ``value``.
    """
    import pandas as pd

    found: list[Row] = []

    def walk(value: Row, path: str) -> None:
        if {"k", "n", "rate"} <= set(value):
            found.append({"quantity": path, **value})
            return
        label = f" at d = {value['d']:g}" if "d" in value else ""
        for key, inner in value.items():
            name = f"{path}{label}.{key}" if path else key
            if key in ("d", "n", "goals", "kinds", "bins", "inside"):
                continue
            if isinstance(inner, Mapping):
                walk(dict(inner), name)
            elif isinstance(inner, list):
                for part in inner:
                    walk(dict(part), name)
            elif not key.endswith(("_n", "_lo95", "_hi95")):
                bounds = {end: value.get(f"{key}_{end}") for end in ("lo95", "hi95")}
                n = value.get(f"{key}_n", value.get("n"))
                found.append({"quantity": name, "n": n, "value": inner, **bounds})

    walk({k: v for k, v in card.items() if k != "sealed_late"}, "")
    return pd.DataFrame(found, columns=["quantity", "k", "n", "rate", "value", "lo95", "hi95"])
