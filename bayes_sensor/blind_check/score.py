"""The score card: verdicts against opened truths, with an oracle and simple methods beside them.

Every proportion comes with Wilson's 95 % interval, everything else with one from the bootstrap over
cases.  ``d`` of a case is what the oracle found, put to the nearest of 2, 4, 8, 16, 32.  The card
is made from the rows of the cases alone, so that it can be made again from their table.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from math import log, sqrt
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from scipy.special import ndtr

from bayes_sensor.blind_check.baselines import WHITENESS_ALARM, by_bic, by_rss
from bayes_sensor.blind_check.oracle import HIDDEN_BELOW, SEPARABLE_ABOVE
from bayes_sensor.blind_check.plan import LEVELS
from bayes_sensor.blind_check.statistics import (
    Row,
    average,
    calibration,
    drawn_anew,
    proportion,
    roc,
)
from bayes_sensor.gap.effects import CATALOGUE
from bayes_sensor.gap.hidden import UNSEEN

if TYPE_CHECKING:
    import pandas as pd

CONFIDENT = 0.9
VISIBLE = 4.0
"""detectability from which localisation and tau are scored"""
SMALL = 0.05
"""p-value below which a gap counts as found"""
ACTING = 0.95
"""share of the true difference that the places hold which count as those where a cause acts"""
GOALS_AT = (8.0, 16.0)
"""detectabilities that goals are set for"""
OUTSIDE = ("unlisted", "withheld")
"""kinds whose cause is not in the catalogue"""
TEXTS = (
    "case", "kind", "causes", "listed_as", "law", "size", "verdict", "said", "top", "rss_says",
    "bic_says",
)  # fmt: skip
"""columns of the table of cases that hold words"""


def level_of(d: float | None) -> float | None:
    """The nearest level (in the logarithm), 0 below 1.4, None where d is not known."""
    if d is None:
        return None
    if d < sqrt(0.5) * LEVELS[0]:
        return 0.0
    return min(LEVELS, key=lambda level: abs(log(d / level)))


# --------------------------------------------------------------------------- one case


def score_case(truth: Mapping[str, Any], verdict: Mapping[str, Any]) -> Row:
    """One flat row: what was true, what was said, and how that compares."""
    kind = truth["kind"]
    right = [set(names) for names in truth["listed_as"]]
    answers = set().union(*right) if right else set()
    outside = kind in OUTSIDE
    accepted = set() if outside else answers
    near = set(truth["near"])
    verdict = _without_the_noise_s_own(verdict, near - answers)
    rows = {row["effect"]: float(row["probability"] or 0.0) for row in verdict["which"]}
    top = max(rows, key=rows.__getitem__)
    families = _families(verdict)
    right_families = {CATALOGUE[name].family for name in answers if name in CATALOGUE}
    said = verdict["verdict"]
    named = list(said["effects"]) if said["kind"] == "effect" else []
    wrong = [name for name in named if name not in accepted and name not in near]
    chosen_set = _smallest_set(rows)
    rivals = truth["rivals"]
    apart = _distance(rivals, lambda name: name not in answers)
    apart_family = _distance(
        rivals, lambda name: name in CATALOGUE and CATALOGUE[name].family not in right_families
    )

    def answer_is_right(label: str) -> bool:
        if kind == "null":
            return label == "none"
        if outside:
            return label == "unlisted"
        return _explains(label, right)

    top_family = max(families, key=families.__getitem__)
    if kind == "null":
        family_right = top_family == "none"
    elif outside:
        family_right = top_family == "unlisted" or (
            kind == "withheld" and top_family in right_families
        )
    else:
        family_right = top_family in right_families
    abstains = said["kind"] not in ("effect", "failed")
    p_right = _probability_of(rows, answer_is_right)
    shrink = verdict["shrink"]
    closed = truth["closed"].get(shrink.get("explanation") or (named[0] if named else ""))
    places = _places(truth, verdict)
    envelope = verdict["tau_envelope_s"]
    tau = truth["tau_s"]
    told = _tau_told(verdict, right)
    row: Row = {
        "case": truth["name"],
        "kind": kind,
        "causes": "+".join(truth["causes"]),
        "listed_as": "+".join("|".join(sorted(names)) for names in right),
        "law": truth["law"],
        "is_ar1": truth["is_ar1"],
        "size": truth["size"],
        "reserve": truth["reserve"],
        "d": truth["d"],
        "d_level": level_of(truth["d"]) if kind != "null" else 0.0,
        "d_found": verdict["budget"].get("excess_d"),
        "verdict": said["kind"],
        "said": "+".join(said["effects"]),
        "p_said": said["probability"],
        "top": top,
        "p_top": rows[top],
        "p_none": rows.get("none", 0.0),
        "p_unlisted": rows.get("unlisted", 0.0),
        "looks_unlisted": _looks_unlisted(verdict, "looks"),
        "unlisted_by_mean": _looks_unlisted(verdict, "by_mean"),
        "p_right": p_right,
        "named": bool(named),
        "named_confidently": bool(named) and said["probability"] > CONFIDENT,
        "wrong_name": bool(wrong),
        "wrong_outside_family": any(
            name not in CATALOGUE or CATALOGUE[name].family not in right_families for name in wrong
        ),
        "confident_wrong": bool(wrong) and said["probability"] > CONFIDENT,
        "top_right": answer_is_right(top),
        "family_right": family_right,
        "isolability": apart,
        "isolability_family": apart_family,
        "isolability_pair": truth.get("pair_rival", None if rivals else float("inf")),
        "top_or_abstained": answer_is_right(top)
        or (abstains and not outside and apart < SEPARABLE_ABOVE),
        "family_or_abstained": family_right
        or (abstains and kind != "null" and apart_family < SEPARABLE_ABOVE),
        "verdict_right": _verdict_right(truth, said, accepted, near, right_families),
        "in_set": any(_contains(label, kind, outside, accepted) for label in chosen_set),
        "set_size": len(chosen_set),
        "brier": _brier(rows, p_right, answer_is_right),
        "log_score": -log(max(p_right, 1e-3)),
        "on_mean": any(CATALOGUE[name].on_mean for name in answers if name in CATALOGUE),
        "rss_says": by_rss(verdict["which"]),
        "bic_says": by_bic(verdict["which"]),
        "in_bins": bool(truth["visible"]),
        "gap_p": verdict["budget"].get("p_value"),
        "gap_p_of_size": verdict["budget"].get("p_value_of_size"),
        "whiteness_p": verdict.get("whiteness_p"),
        "closed": shrink.get("fraction_closed"),
        "closed_lo": shrink.get("fraction_closed_lo"),
        "closed_hi": shrink.get("fraction_closed_hi"),
        "closed_held_out": shrink.get("held_out_fraction_closed"),
        "closed_held_out_lo": shrink.get("held_out_fraction_closed_lo"),
        "closed_held_out_hi": shrink.get("held_out_fraction_closed_hi"),
        "closed_oracle": closed,
        **places,
        "tau_true_s": tau,
        "tau_before_s": shrink.get("tau_before_s"),
        "tau_after_s": shrink.get("tau_after_s"),
        "tau_told_s": told,
        "tau_refit_s": truth["tau_refit_s"],
        "log_error_before": _log_error(shrink.get("tau_before_s"), tau),
        "log_error_after": _log_error(shrink.get("tau_after_s"), tau),
        "log_error_told": _log_error(told, tau),
        "envelope_lo_s": envelope[0],
        "envelope_hi_s": envelope[1],
        "envelope_holds": None
        if tau is None or None in envelope
        else bool(envelope[0] <= tau <= envelope[1]),
    }
    return row


def _looks_unlisted(verdict: Mapping[str, Any], how: str) -> float | None:
    """Before any share is given back; None where the verdict does not say, as those of users."""
    said = verdict.get("unlisted") or {}
    return None if said.get(how) is None else float(said[how])


def _tau_told(verdict: Mapping[str, Any], right: Sequence[set[str]]) -> float | None:
    """s, tau of the likeliest explanation by the true causes alone: what being told would give."""
    which = verdict["which"]
    true = [row for row in which if row.get("tau_s") and _explains(row["effect"], right)]
    return max(true, key=lambda row: row["probability"] or 0.0)["tau_s"] if true else None


def _explains(label: str, right: Sequence[set[str]]) -> bool:
    members = set(label.split("+"))
    return members <= set().union(*right) and len(members) == len(right)


def _without_the_noise_s_own(verdict: Mapping[str, Any], near: set[str]) -> Mapping[str, Any]:
    """The verdict on the mean, where the noise itself is what an effect of the noise describes.

    Heavy tails that the noise law has are neither right nor wrong: ``a+heavy_tails`` counts as
    ``a``, and ``heavy_tails`` alone as nothing found.
    """
    there = {name for name in near if name in CATALOGUE and not CATALOGUE[name].on_mean}
    if not there:
        return verdict
    which: dict[str, dict[str, Any]] = {}
    for row in verdict["which"]:
        label = "+".join(n for n in row["effect"].split("+") if n not in there) or "none"
        kept = which.setdefault(label, {**row, "effect": label, "probability": 0.0})
        if row["effect"] == label:
            kept.update({k: v for k, v in row.items() if k != "probability"})
        kept["probability"] += float(row["probability"] or 0.0)
    said = dict(verdict["verdict"])
    if said["kind"] == "effect":
        said["effects"] = [name for name in said["effects"] if name not in there]
        if not said["effects"]:
            nothing_seen = which["none"]["probability"] + float(verdict.get("faint") or 0.0)
            said.update(kind="none", family=None, probability=min(nothing_seen, 1.0))
    return {**verdict, "which": list(which.values()), "verdict": said}


def _families(verdict: Mapping[str, Any]) -> dict[str, float]:
    """Probability of none, unlisted and each family; a row of two families counts for both."""
    found: dict[str, float] = {"none": 0.0, "unlisted": 0.0}
    own = {row["effect"]: row["family"] for row in verdict["which"] if "+" not in row["effect"]}
    for row in verdict["which"]:
        p = float(row["probability"] or 0.0)
        if row["effect"] in found:
            found[row["effect"]] += p
            continue
        for family in {own.get(name) or name for name in row["effect"].split("+")}:
            found[family] = found.get(family, 0.0) + p
    return found


def _distance(rivals: Mapping[str, float], counts: Callable[[str], bool]) -> float:
    """Of the nearest rival that counts; infinite where there is none."""
    return min((float(v) for name, v in rivals.items() if counts(name)), default=float("inf"))


def _smallest_set(rows: Mapping[str, float], level: float = 0.95) -> list[str]:
    """The fewest rows that hold ``level`` of the probability."""
    chosen, total = [], 0.0
    for label in sorted(rows, key=lambda name: -rows[name]):
        chosen.append(label)
        total += rows[label]
        if total >= level:
            break
    return chosen


def _contains(label: str, kind: str, outside: bool, accepted: set[str]) -> bool:
    if kind == "null":
        return label == "none"
    if outside:
        return label == "unlisted"
    return bool(set(label.split("+")) & accepted)


def _probability_of(rows: Mapping[str, float], right: Callable[[str], bool]) -> float:
    return min(1.0, sum(p for label, p in rows.items() if right(label)))


def _brier(rows: Mapping[str, float], p_right: float, right: Callable[[str], bool]) -> float:
    """Squared distance from certainty about the right answer, over all rows (Brier 1950)."""
    return (1.0 - p_right) ** 2 + sum(p * p for label, p in rows.items() if not right(label))


def _verdict_right(
    truth: Mapping[str, Any],
    said: Mapping[str, Any],
    accepted: set[str],
    near: set[str],
    families: set[str],
) -> bool:
    """Whether the stated verdict holds: what it names is there, none means nothing to be seen."""
    kind = truth["kind"]
    if said["kind"] == "failed":
        return False
    if said["kind"] == "none":
        return kind == "null" or (truth["d"] is not None and truth["d"] < HIDDEN_BELOW)
    if said["kind"] == "unlisted":
        return kind in ("unlisted", "withheld")
    if said["kind"] == "family":
        return bool(set(said["effects"]) & (accepted | near)) or (
            kind == "withheld" and said["family"] in families
        )
    return set(said["effects"]) <= accepted | near


def _places(truth: Mapping[str, Any], verdict: Mapping[str, Any]) -> Row:
    """How much of the excess was put where the causes act; precision and recall of the places.

    Places are those that hold most of a difference: of the causes' own, of the excess as stated,
    and of what an oracle sees after the refit.
    """
    names = ("places", "located", "located_oracle")
    found: Row = dict.fromkeys((*names, "place_precision", "place_recall", "place_f1_oracle"))
    acting = _most_of(truth["acts"])
    if not acting or truth["d"] is None or truth["d"] < VISIBLE:
        return found
    found["places"] = len(acting)
    stated = [{**row, "share": row["share"] or 0.0} for row in verdict["where"]]
    claimed = _most_of(stated)
    if not claimed:
        return found
    precision, recall = _hits(claimed, acting)
    seen = truth["visible"]
    return found | {
        "located": _within(stated, acting),
        "located_oracle": _within(seen, acting) if seen else None,
        "place_precision": precision,
        "place_recall": recall,
        "place_f1_oracle": _f1(*_hits(_most_of(seen), acting)) if seen else None,
    }


Places = set[tuple[str, str]]
"""experiments and phases"""


def _most_of(rows: Sequence[Mapping[str, Any]]) -> Places:
    """The fewest places that hold :data:`ACTING` of what the shares add up to; none of nothing."""
    whole = sum(row["share"] for row in rows)
    places: Places = set()
    held = 0.0
    for row in sorted(rows, key=lambda row: -row["share"]):
        if whole <= 0.0 or held >= ACTING * whole:
            break
        places.add((row["experiment"], row["phase"]))
        held += row["share"]
    return places


def _within(rows: Sequence[Mapping[str, Any]], places: Places) -> float:
    return float(sum(r["share"] for r in rows if (r["experiment"], r["phase"]) in places))


def _hits(stated: Places, acting: Places) -> tuple[float, float]:
    """Precision and recall."""
    return len(stated & acting) / len(stated), len(stated & acting) / len(acting)


def _log_error(value: float | None, truth: float | None) -> float | None:
    if value is None or truth is None or value <= 0:
        return None
    return abs(log(value / truth))


# --------------------------------------------------------------------------- the card


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
        **average("f1", (_f1(r["place_precision"], r["place_recall"]) for r in seen)),
        **average("f1_oracle", (r.get("place_f1_oracle") for r in seen)),
    }


def _f1(precision: float | None, recall: float) -> float:
    """Harmonic mean; 0 where no place was stated, or none of the right ones."""
    return 2.0 * precision * recall / (precision + recall) if precision and recall else 0.0


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
