"""The score card: scored cases together, with an oracle and simple methods beside the diagnosis.

Every proportion comes with Wilson's 95 % interval, everything else with one from the bootstrap over
cases.  The card is made from the rows of the cases alone, so that it can be made again from their
table.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from scipy.special import ndtr

from bayes_sensor.blind_check.baselines import WHITENESS_ALARM
from bayes_sensor.blind_check.oracle import SEPARABLE_ABOVE
from bayes_sensor.blind_check.plan import LEVELS
from bayes_sensor.blind_check.score import OUTSIDE, VISIBLE, score_case
from bayes_sensor.blind_check.statistics import (
    Row,
    average,
    calibration,
    drawn_anew,
    f1,
    proportion,
    roc,
)
from bayes_sensor.diagnosis.effects import CATALOGUE
from bayes_sensor.diagnosis.hidden import UNSEEN

if TYPE_CHECKING:
    import pandas as pd

SMALL = 0.05
"""p-value below which a gap counts as found"""
GOALS_AT = (8.0, 16.0)
"""detectabilities that goals are set for"""
TEXTS = (
    "case", "kind", "causes", "listed_as", "law", "size", "verdict", "said", "top", "rss_says",
    "bic_says",
)  # fmt: skip
"""columns of the table of cases that hold words"""


def score(cases: Sequence[tuple[Mapping[str, Any], Mapping[str, Any]]]) -> tuple[Row, list[Row]]:
    """The card and one row a case."""
    rows = [score_case(truth, verdict) for truth, verdict in cases]
    return make_card(rows), rows


def make_card(rows: Sequence[Row]) -> Row:
    """Everything the card says, from the rows of the cases."""
    kinds = list(dict.fromkeys(row["kind"] for row in rows))
    nulls, pairs = _of(rows, "null"), _of(rows, "pair")
    listed, unlisted = _of(rows, "listed"), _of(rows, "unlisted")
    withheld, hidden = _of(rows, "withheld"), _of(rows, "hidden")
    drawn_to_hide = [r for r in rows if r["kind"] == "hidden"]
    visible = [r for r in rows if r["kind"] != "hidden"]
    strong = [r for r in unlisted if (r["d_level"] or 0.0) > 0.0]
    others = [*nulls, *listed, *drawn_to_hide]
    at_fault = [("listed", listed), ("pair", pairs), ("unlisted", unlisted),
                ("withheld", withheld), ("hidden", hidden)]  # fmt: skip
    card: Row = {
        "n": len(rows),
        "kinds": {kind: sum(row["kind"] == kind for row in rows) for kind in kinds},
        "failed": proportion(r["verdict"] == "failed" for r in rows),
        "nulls": _null_part(nulls),
        "accuracy": [_accuracy(listed, level) for level in LEVELS],
        "confident_wrong": {
            **{kind: proportion(r["confident_wrong"] for r in some) for kind, some in at_fault},
            "withheld_outside_family": proportion(
                r["confident_wrong"] and r["wrong_outside_family"] for r in withheld
            ),
            **{f"{kind}_without_near": proportion(_confident_other(r) for r in some)
               for kind, some in at_fault if kind in ("listed", "pair", "unlisted")},
            **{f"bic_{kind}": proportion(_bic_wrong(r) for r in some) for kind, some in at_fault},
            "bic_withheld_outside_family": proportion(
                _bic_wrong(r) and not _of_its_family(r["bic_says"], r) for r in withheld
            ),
        },
        "unlisted": {
            "flagged": [_flagged(unlisted, level) for level in LEVELS],
            "withheld_flagged": [_flagged(withheld, level) for level in LEVELS],
            "withheld_flagged_or_family": proportion(r["verdict_right"] for r in withheld),
            "roc": roc(*([r["p_unlisted"] for r in some] for some in (strong, others))),
            "roc_whiteness": roc(*(map(_not_white, some) for some in (strong, others))),
        },
        "pairs": {
            "both_right": proportion(r["top_right"] for r in pairs),
            "nothing_wrong_named": proportion(not r["wrong_name"] for r in pairs),
            "one_of_them_said": proportion(
                bool(set(r["said"].split("+")) & _answers(r)) for r in pairs
            ),
        },
        "calibration": {
            "verdict": calibration(visible, "p_said", "verdict_right"),
            "top_answer": calibration([r for r in visible if r["kind"] != "pair"],
                                      "p_top", "top_right"),
            "by_verdict": _by_verdict(visible),
        },
        "scores": {
            "all": _scores(visible),
            **{kind: _scores(_of(rows, kind)) for kind in kinds},
        },
        "set95": {
            "coverage": proportion(r["in_set"] for r in visible),
            **average("mean_size", (r["set_size"] for r in visible)),
            "by_kind": {kind: _set_part(_of(rows, kind)) for kind in kinds},
            "listed": [{"d": level, **_set_part(_at(listed, level))} for level in LEVELS],
        },
        "closed_fraction": [_closed(rows, level) for level in LEVELS[1:]],
        "p_value": _p_values(rows, nulls),
        "localisation": _localisation(rows),
        "tau": _tau(listed),
        "envelope": {
            "hidden": proportion(r["envelope_holds"] for r in hidden),
            "drawn_to_hide": len(drawn_to_hide),
            "drawn_stronger": len(drawn_to_hide) - len(hidden),
            "null": proportion(r["envelope_holds"] for r in nulls),
            "d_below_3": proportion(
                r["envelope_holds"] for r in rows if r["d"] is not None and r["d"] < UNSEEN
            ),
        },
    }  # fmt: skip
    card["goals"] = _goals(card)
    return card


def _by_verdict(rows: Sequence[Row]) -> dict[str, Row]:
    """How likely each kind of verdict says that it holds, and how often it does.

    Unlisted is told by the mean or, less surely, by single samples alone.
    """
    found: dict[str, list[Row]] = {}
    for row in rows:
        kind = row["verdict"]
        if kind == "unlisted" and row["unlisted_by_mean"] is not None:
            kind = f"unlisted by {'the mean' if row['unlisted_by_mean'] > 0.5 else 'samples'}"
        if row["p_said"] is not None:
            found.setdefault(kind, []).append(row)
    return {
        kind: {
            **average("said", (row["p_said"] for row in some)),
            "right": proportion(row["verdict_right"] for row in some),
        }
        for kind, some in sorted(found.items())
    }


def _of(rows: Sequence[Row], kind: str) -> list[Row]:
    """The rows of a kind; of those drawn to hide, the ones that do."""
    of_kind = [row for row in rows if row["kind"] == kind]
    if kind != "hidden":
        return of_kind
    return [row for row in of_kind if (row["d"] or 0.0) < UNSEEN]


def _at(rows: Sequence[Row], level: float) -> list[Row]:
    return [row for row in rows if row["d_level"] == level]


def _scores(rows: Sequence[Row]) -> Row:
    return {
        **average("brier", (r["brier"] for r in rows)),
        **average("log_score", (r["log_score"] for r in rows)),
    }


def _set_part(rows: Sequence[Row]) -> Row:
    """How often the 95 % set holds the right answer, and how many it holds in all."""
    return {
        "coverage": proportion(r["in_set"] for r in rows),
        **average("mean_size", (r["set_size"] for r in rows)),
    }


def _null_part(nulls: Sequence[Row]) -> Row:
    def part(rows: Sequence[Row]) -> Row:
        return {
            "named": proportion(r["named"] for r in rows),
            "named_or_family": proportion(r["verdict"] in ("effect", "family") for r in rows),
            "alarmed": proportion(r["verdict"] != "none" for r in rows),
            "bic_named": proportion(r["bic_says"] != "none" for r in rows),
            "whiteness_alarmed": _whiteness(rows),
        }

    laws = list(dict.fromkeys(sorted(row["law"] for row in nulls)))
    return {
        "all": part(nulls),
        "ar1": part([r for r in nulls if r["is_ar1"]]),
        "not_ar1": part([r for r in nulls if r["is_ar1"] is False]),
        "by_law": {law: part([r for r in nulls if r["law"] == law]) for law in laws},
    }


def _whiteness(rows: Sequence[Row]) -> dict[str, Any]:
    return proportion(
        None if r["whiteness_p"] is None else r["whiteness_p"] < WHITENESS_ALARM for r in rows
    )


def _not_white(row: Row) -> float | None:
    """What the whiteness test alone would flag by: higher where the residuals are less white."""
    return None if row["whiteness_p"] is None else -row["whiteness_p"]


def _answers(row: Row) -> set[str]:
    """Every name that is right for one of the causes; none outside the catalogue."""
    return set() if row["kind"] in OUTSIDE else _listed_as(row)


def _listed_as(row: Row) -> set[str]:
    """Every name that is right for one of the causes, or was before it was taken out."""
    return set(row["listed_as"].replace("|", "+").split("+")) - {""}


def _of_its_family(says: str, row: Row) -> bool:
    """Whether an effect is of the family of a cause that is listed, or was before it was taken."""
    families = {CATALOGUE[name].family for name in _listed_as(row) if name in CATALOGUE}
    return says in CATALOGUE and CATALOGUE[says].family in families


def _bic_wrong(row: Row) -> bool:
    return row["bic_says"] != "none" and row["bic_says"] not in _answers(row)


def _confident_other(row: Row) -> bool:
    """A confident name that is no cause's own, be it as near to one as may be."""
    return bool(row["named_confidently"]) and not set(row["said"].split("+")) <= _answers(row)


def oracle_share(d: float | None, apart: float) -> float | None:
    """How often a reader who knows noise and alternatives names the right one of two.

    ``d``: distance of the cause from no cause at all, ``apart``: from its nearest rival, both in
    standard deviations of the noise.  Between two known signals that far apart the likelihood
    ratio errs with probability Phi(-distance/2), and no method errs less (Neyman and Pearson).  The
    nearest alternative alone counts: with all of them the oracle would be right less often, so this
    is a bound from above.  It must choose: it never abstains.

    >>> oracle_share(8.0, 0.0), round(oracle_share(2.0, 5.0), 3)
    (0.5, 0.841)
    """
    return None if d is None else float(ndtr(0.5 * min(d, apart)))


def _or_quiet(row: Row, right: str, apart: str) -> bool:
    """Right, or the verdict is that there is nothing where the oracle cannot separate either."""
    return bool(row[right] or (row["verdict"] == "none" and row[apart] < SEPARABLE_ABOVE))


def _accuracy(listed: Sequence[Row], level: float) -> Row:
    """Shares that are right at a level of d.

    ``.._or_abstained``: every verdict that gives no name abstains, as the goals count;
    ``.._or_quiet``: only one of "none" does, since a family and "unlisted" are claims.
    """
    rows = _at(listed, level)
    return {
        "d": level,
        "top": proportion(r["top_right"] for r in rows),
        "top_or_abstained": proportion(r["top_or_abstained"] for r in rows),
        "top_or_quiet": proportion(_or_quiet(r, "top_right", "isolability") for r in rows),
        "family": proportion(r["family_right"] for r in rows),
        "family_or_abstained": proportion(r["family_or_abstained"] for r in rows),
        "family_or_quiet": proportion(
            _or_quiet(r, "family_right", "isolability_family") for r in rows
        ),
        "quiet": proportion(r["verdict"] == "none" for r in rows),
        **average("top_oracle", (oracle_share(r["d"], r["isolability"]) for r in rows)),
        **average("family_oracle", (oracle_share(r["d"], r["isolability_family"]) for r in rows)),
        "top_rss": proportion(r["rss_says"] in _answers(r) for r in rows),
        "top_bic": proportion(r["bic_says"] in _answers(r) for r in rows),
        "family_rss": proportion(_of_its_family(r["rss_says"], r) for r in rows),
        "family_bic": proportion(_of_its_family(r["bic_says"], r) for r in rows),
        "whiteness_alarmed": _whiteness(rows),
    }


def _flagged(rows: Sequence[Row], level: float) -> Row:
    at = _at(rows, level)
    apart = [r["isolability"] >= SEPARABLE_ABOVE for r in at]
    return {
        "d": level,
        "flagged": proportion(r["verdict"] == "unlisted" for r in at),
        "flagged_where_separable": proportion(
            r["verdict"] == "unlisted" for r, far in zip(at, apart, strict=True) if far
        ),
        # a family is no name: right where the oracle cannot tell the cause from a listed effect
        "flagged_or_unnamed": proportion(
            r["verdict"] == "unlisted" or (r["verdict"] == "family" and not far)
            for r, far in zip(at, apart, strict=True)
        ),
        "within_reach": proportion(apart),
        "beyond_pairs": proportion(
            r["isolability_pair"] >= SEPARABLE_ABOVE
            for r in at
            if r["isolability_pair"] is not None
        ),
        "quiet": proportion(r["verdict"] == "none" for r in at),
    }


def _closed(rows: Sequence[Row], level: float) -> Row:
    at = [
        r for r in _at(rows, level)
        if r["closed"] is not None and r["closed_oracle"] is not None and r["kind"] == "listed"
    ]  # fmt: skip
    held = [r for r in at if r["closed_held_out"] is not None]
    bounds = "closed_held_out_lo", "closed_held_out_hi"
    part = {
        "d": level,
        "n": len(at),
        **average("median_error", (abs(r["closed"] - r["closed_oracle"]) for r in at), median=True),
        **average(
            "median_error_held_out",
            (abs(r["closed_held_out"] - r["closed_oracle"]) for r in held),
            median=True,
        ),
        "coverage": proportion(_holds(r, "closed_lo", "closed_hi") for r in at),
    }
    if any(r.get(bound) is not None for r in rows for bound in bounds):
        part["coverage_held_out"] = proportion(_holds(r, *bounds) for r in held)
    return part


def _holds(row: Row, low: str, high: str) -> bool | None:
    """Whether an interval holds the oracle's closed fraction; None where none was stated."""
    if row.get(low) is None or row.get(high) is None:
        return None
    return bool(row[low] <= row["closed_oracle"] <= row[high])


def _p_values(rows: Sequence[Row], nulls: Sequence[Row]) -> Row:
    """How often the p-value of the gap is small: without a cause, and with one that bins show."""

    def small(some: Sequence[Row], key: str) -> Row:
        return proportion(None if r.get(key) is None else r[key] < SMALL for r in some)

    seen = [r for r in rows if r.get("in_bins")]
    return {
        "null": small(nulls, "gap_p"),
        "seen": [
            {
                "d": level,
                "whole": small(_at(seen, level), "gap_p"),
                "size": small(_at(seen, level), "gap_p_of_size"),
            }
            for level in LEVELS
        ],
    }


def _localisation(rows: Sequence[Row]) -> Row:
    """Of the campaigns ``of`` which a place could be stated, the ``n`` with one."""
    seen = [r for r in rows if r["located"] is not None]
    return {
        "n": len(seen),
        "of": sum(r.get("places") is not None for r in rows) or None,
        **average("share", (r["located"] for r in seen)),
        **average("share_oracle", (r["located_oracle"] for r in seen)),
        **average("precision", (r["place_precision"] for r in seen)),
        **average("recall", (r["place_recall"] for r in seen)),
        **average("f1", (f1(r["place_precision"], r["place_recall"]) for r in seen)),
        **average("f1_oracle", (r.get("place_f1_oracle") for r in seen)),
    }


def _tau(listed: Sequence[Row]) -> Row:
    """Mean error of ln tau before and after the effect is added, where it was seen and named.

    Causes that leave the mean alone (hum, tails, steps of the converter) move no estimate of tau
    and do not count.  ``told``: the error where the true effect is given, over those cases in which
    its own estimate was kept; the rest of it is noise, which no diagnosis takes away.
    """
    named = [
        r
        for r in listed
        if r["verdict"] in ("effect", "family")
        and r["verdict_right"]
        and r["on_mean"]
        and (r["d"] or 0.0) >= VISIBLE
        and r["log_error_before"] is not None
        and r["log_error_after"] is not None
    ]
    if not named:
        nothing = ("before", "after", "told", "ratio", "ratio_lo95", "ratio_hi95", "ratio_told")
        return {"n": 0, **dict.fromkeys(nothing)}
    before = np.array([r["log_error_before"] for r in named])
    after = np.array([r["log_error_after"] for r in named])
    pick = drawn_anew(len(named))
    ratios = after[pick].mean(axis=1) / np.maximum(before[pick].mean(axis=1), 1e-12)
    known = [r for r in named if r["log_error_told"] is not None]
    told = average("told", (r["log_error_told"] for r in known))
    ratio_told = None
    if known:
        at_first = float(np.mean([r["log_error_before"] for r in known]))
        ratio_told = told["told"] / max(at_first, 1e-12)
    return {
        "n": len(named),
        **told,
        "ratio_told": ratio_told,
        **average("before", before),
        **average("after", after),
        **average("median_before", before, median=True),
        **average("median_after", after, median=True),
        "ratio": float(after.mean() / max(before.mean(), 1e-12)),
        "ratio_lo95": float(np.quantile(ratios, 0.025)),
        "ratio_hi95": float(np.quantile(ratios, 0.975)),
    }


def _goals(card: Row) -> list[Row]:
    """What was set out to be reached, and whether it was (by the rate itself)."""

    def at(table: Sequence[Row], d: float) -> Row:
        return next(row for row in table if row["d"] == d)

    flagged = card["unlisted"]["flagged"]
    family, fairly = "family_or_abstained", "flagged_or_unnamed"
    wanted: list[tuple[str, str, float, Row]] = [
        ("nulls named", "<=", 0.02, card["nulls"]["all"]["named"]),
        ("confident wrong name, listed", "<=", 0.02, card["confident_wrong"]["listed"]),
        ("confident wrong name, unlisted", "<=", 0.10, card["confident_wrong"]["unlisted"]),
        ("right family at d = 8", ">=", 0.90, at(card["accuracy"], 8.0)[family]),
        ("right family at d = 16", ">=", 0.97, at(card["accuracy"], 16.0)[family]),
        ("unlisted flagged at d = 8", ">=", 0.60, at(flagged, 8.0)["flagged"]),
        ("unlisted flagged at d = 16", ">=", 0.85, at(flagged, 16.0)["flagged"]),
        ("the same, or rightly unnamed, at d = 8", ">=", 0.60, at(flagged, 8.0)[fairly]),
        ("the same, or rightly unnamed, at d = 16", ">=", 0.85, at(flagged, 16.0)[fairly]),
    ]
    goals = [_goal(name, sign, bound, part["rate"], part) for name, sign, bound, part in wanted]
    calibration = card["calibration"]["verdict"]
    goals.append(
        _goal("calibration error inside its band", "<=", calibration["band95"], calibration["ece"])
    )
    closed = at(card["closed_fraction"], 16.0)
    goals.append(
        _goal("median error of the closed fraction at d = 16", "<=", 0.05, closed["median_error"])
    )
    coverage = closed["coverage"]
    rate = coverage["rate"]
    goals.append(
        {
            "goal": "its interval covers at d = 16",
            "wanted": ".90 to .98",
            "reached": rate,
            "lo95": coverage["lo95"],
            "hi95": coverage["hi95"],
            "met": None if rate is None else 0.90 <= rate <= 0.98,
        }
    )
    tau = card["tau"]
    between = {"lo95": tau["ratio_lo95"], "hi95": tau["ratio_hi95"]}
    goals.append(_goal("error of ln tau, after over before", "<=", 0.5, tau["ratio"], between))
    return goals


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


def table(rows: Sequence[Row]) -> pd.DataFrame:
    """One row a case, in the order of their names."""
    import pandas as pd

    frame = pd.DataFrame(list(rows))
    return frame.sort_values("case", ignore_index=True) if len(frame) else frame


def read_rows(path: Path) -> list[Row]:
    """The rows of a table of cases, as :func:`make_card` takes them."""
    import pandas as pd

    words = {"True": True, "False": False, "": None}

    def value(column: str, cell: str) -> Any:
        if column in TEXTS:
            return cell
        return words[cell] if cell in words else float(cell)

    frame = pd.read_csv(path, dtype=str, keep_default_na=False)
    columns = list(frame)
    return [
        {column: value(column, cell) for column, cell in zip(columns, cells, strict=True)}
        for cells in frame.itertuples(index=False)
    ]


def card_table(card: Row) -> pd.DataFrame:
    """Every number of the card, one a row: where it stands, of how many cases, and its interval.

    Proportions have ``k`` and ``rate``, everything else ``value``; what is no mean of cases (the
    band of the calibration error, the ratio of a told fit) has no interval.
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
            if key in ("d", "n", "goals", "kinds", "bins", "inside", "se", "true", "false"):
                continue
            if isinstance(inner, Mapping):
                walk(dict(inner), name)
            elif isinstance(inner, list):
                for part in inner:
                    if isinstance(part, Mapping):
                        walk(dict(part), name)
            elif not key.endswith(("_n", "_lo95", "_hi95")):
                bounds = {end: value.get(f"{key}_{end}") for end in ("lo95", "hi95")}
                n = value.get(f"{key}_n", value.get("n"))
                found.append({"quantity": name, "n": n, "value": inner, **bounds})

    walk(dict(card), "")
    return pd.DataFrame(found, columns=["quantity", "k", "n", "rate", "value", "lo95", "hi95"])
