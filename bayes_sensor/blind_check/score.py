"""The score card: verdicts against opened truths, with an oracle and simple methods beside them.

Every proportion comes with Wilson's 95 % interval.  ``d`` of a case is what the oracle found, put
to the nearest of 2, 4, 8, 16, 32.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from math import log, sqrt
from typing import TYPE_CHECKING, Any

import numpy as np

from bayes_sensor.blind_check.baselines import WHITENESS_ALARM, by_bic, by_rss
from bayes_sensor.blind_check.oracle import HIDDEN_BELOW, SEPARABLE_ABOVE
from bayes_sensor.blind_check.plan import LEVELS
from bayes_sensor.gap.effects import CATALOGUE

if TYPE_CHECKING:
    import pandas as pd

CONFIDENT = 0.9
VISIBLE = 4.0
"""detectability from which localisation and tau are scored"""
ACTING = 0.95
"""share of the true difference that the places hold which count as those where a cause acts"""
Row = dict[str, Any]


def wilson(k: int, n: int, z: float = 1.959963984540054) -> tuple[float, float]:
    """95 % interval of a proportion after ``k`` of ``n`` (Wilson, J. Am. Stat. Assoc. 22, 1927).

    >>> [round(v, 4) for v in wilson(0, 200)]
    [0.0, 0.0188]
    """
    if n == 0:
        return 0.0, 1.0
    p = k / n
    centre = (p + z * z / (2 * n)) / (1 + z * z / n)
    half = z / (1 + z * z / n) * sqrt(p * (1 - p) / n + z * z / (4 * n * n))
    return max(0.0, centre - half), min(1.0, centre + half)


def proportion(values: Iterable[Any]) -> dict[str, Any]:
    """k of n with its interval; values that are None do not count."""
    known = [bool(v) for v in values if v is not None]
    k, n = sum(known), len(known)
    low, high = wilson(k, n)
    return {"k": k, "n": n, "rate": k / n if n else None, "lo95": low, "hi95": high}


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
    outside = kind in ("unlisted", "withheld")
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
    abstains = said["kind"] != "effect"
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
        "oracle_right": None
        if not rivals or kind in ("null", "pair") or outside
        else min(rivals, key=rivals.__getitem__) in answers,
        "rss_says": by_rss(verdict["which"]),
        "bic_says": by_bic(verdict["which"]),
        "whiteness_p": verdict.get("whiteness_p"),
        "closed": shrink.get("fraction_closed"),
        "closed_lo": shrink.get("fraction_closed_lo"),
        "closed_hi": shrink.get("fraction_closed_hi"),
        "closed_held_out": shrink.get("held_out_fraction_closed"),
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
            said.update(kind="none", family=None, probability=which["none"]["probability"])
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
    """How much of the excess was put where the causes act; precision and recall of the places."""
    empty = {"located": None, "located_oracle": None, "place_precision": None, "place_recall": None}
    acts = sorted(truth["acts"], key=lambda row: -row["share"])
    if not acts or truth["d"] is None or truth["d"] < VISIBLE:
        return empty
    places: set[tuple[str, str]] = set()
    total = 0.0
    for row in acts:
        places.add((row["experiment"], row["phase"]))
        total += row["share"]
        if total >= ACTING:
            break
    shares = {(r["experiment"], r["phase"]): r["share"] or 0.0 for r in verdict["where"]}
    if sum(shares.values()) <= 0:
        return empty
    flagged = {
        (r["experiment"], r["phase"])
        for r in verdict["where"]
        if r["p_value"] is not None and r["p_value"] < 0.05
    }
    seen = {(r["experiment"], r["phase"]): r["share"] for r in truth["visible"]}
    return {
        "located": sum(share for place, share in shares.items() if place in places),
        "located_oracle": sum(s for place, s in seen.items() if place in places) if seen else None,
        "place_precision": len(flagged & places) / len(flagged) if flagged else None,
        "place_recall": len(flagged & places) / len(places),
    }


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
    nulls = _of(rows, "null")
    listed, unlisted = _of(rows, "listed"), _of(rows, "unlisted")
    withheld, hidden = _of(rows, "withheld"), _of(rows, "hidden")
    card: Row = {
        "n": len(rows),
        "kinds": {kind: len(_of(rows, kind)) for kind in kinds},
        "failed": proportion(r["verdict"] == "failed" for r in rows),
        "nulls": _null_part(nulls),
        "accuracy": [_accuracy(listed, level) for level in LEVELS],
        "confident_wrong": {
            "listed": proportion(r["confident_wrong"] for r in listed),
            "pair": proportion(r["confident_wrong"] for r in _of(rows, "pair")),
            "unlisted": proportion(r["confident_wrong"] for r in unlisted),
            "withheld": proportion(r["confident_wrong"] for r in withheld),
            "withheld_outside_family": proportion(
                r["confident_wrong"] and r["wrong_outside_family"] for r in withheld
            ),
            "hidden": proportion(r["confident_wrong"] for r in hidden),
            "bic_listed": proportion(_bic_wrong(r) for r in listed),
            "bic_unlisted": proportion(r["bic_says"] != "none" for r in unlisted),
            "bic_withheld": proportion(r["bic_says"] != "none" for r in withheld),
        },
        "unlisted": {
            "flagged": [_flagged(unlisted, level) for level in LEVELS],
            "withheld_flagged": [_flagged(withheld, level) for level in LEVELS],
            "withheld_flagged_or_family": proportion(r["verdict_right"] for r in withheld),
            "roc": _roc(unlisted, [*nulls, *listed, *hidden]),
        },
        "pairs": {
            "both_right": proportion(r["top_right"] for r in _of(rows, "pair")),
            "nothing_wrong_named": proportion(not r["wrong_name"] for r in _of(rows, "pair")),
            "one_of_them_said": proportion(
                bool(set(r["said"].split("+")) & set(r["listed_as"].replace("|", "+").split("+")))
                for r in _of(rows, "pair")
            ),
        },
        "calibration": {
            "verdict": calibration([r for r in rows if r["kind"] != "hidden"], "p_said",
                                   "verdict_right"),
            "top_answer": calibration([r for r in rows if r["kind"] not in ("hidden", "pair")],
                                      "p_top", "top_right"),
        },
        "scores": {
            kind: {"brier": _mean(_of(rows, kind), "brier"),
                   "log_score": _mean(_of(rows, kind), "log_score")}
            for kind in kinds
        },
        "set95": {
            "coverage": proportion(r["in_set"] for r in rows if r["kind"] != "hidden"),
            "mean_size": _mean(rows, "set_size"),
            "by_kind": {kind: proportion(r["in_set"] for r in _of(rows, kind)) for kind in kinds},
        },
        "closed_fraction": [_closed(rows, level) for level in LEVELS[1:]],
        "localisation": _localisation(rows),
        "tau": _tau(listed),
        "envelope": {
            "hidden": proportion(r["envelope_holds"] for r in hidden),
            "null": proportion(r["envelope_holds"] for r in nulls),
            "d_below_3": proportion(
                r["envelope_holds"] for r in rows if r["d"] is not None and r["d"] < 3.0
            ),
        },
    }  # fmt: skip
    card["goals"] = _goals(card)
    return card


def _of(rows: Sequence[Row], kind: str) -> list[Row]:
    return [row for row in rows if row["kind"] == kind]


def _at(rows: Sequence[Row], level: float) -> list[Row]:
    return [row for row in rows if row["d_level"] == level]


def _mean(rows: Sequence[Row], key: str) -> float | None:
    values = [row[key] for row in rows if row[key] is not None]
    return float(np.mean(values)) if values else None


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


def _is_right(says: str, row: Row) -> bool:
    return says in set(row["listed_as"].replace("|", "+").split("+"))


def _bic_wrong(row: Row) -> bool:
    return row["bic_says"] != "none" and not _is_right(row["bic_says"], row)


def _accuracy(listed: Sequence[Row], level: float) -> Row:
    rows = _at(listed, level)
    return {
        "d": level,
        "top": proportion(r["top_right"] for r in rows),
        "top_or_abstained": proportion(r["top_or_abstained"] for r in rows),
        "family": proportion(r["family_right"] for r in rows),
        "family_or_abstained": proportion(r["family_or_abstained"] for r in rows),
        "quiet": proportion(r["verdict"] == "none" for r in rows),
        "oracle": proportion(r["oracle_right"] for r in rows),
        "rss": proportion(_is_right(r["rss_says"], r) for r in rows),
        "bic": proportion(_is_right(r["bic_says"], r) for r in rows),
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


def _roc(positive: Sequence[Row], negative: Sequence[Row]) -> Row:
    """Curve of P(unlisted), its area and the area's standard error (Hanley and McNeil 1982)."""
    yes = np.array([r["p_unlisted"] for r in positive if (r["d"] or 0.0) >= HIDDEN_BELOW])
    no = np.array([r["p_unlisted"] for r in negative])
    if len(yes) == 0 or len(no) == 0:
        return {"area": None, "se": None, "false": [], "true": []}
    cuts = np.unique(np.concatenate([yes, no, [0.0]]))[::-1]
    true = [float(np.mean(yes >= cut)) for cut in cuts]
    false = [float(np.mean(no >= cut)) for cut in cuts]
    above = (yes[:, None] > no[None, :]).mean() + 0.5 * (yes[:, None] == no[None, :]).mean()
    area = float(above)
    q1, q2 = area / (2.0 - area), 2.0 * area**2 / (1.0 + area)
    n, m = len(yes), len(no)
    variance = area * (1 - area) + (n - 1) * (q1 - area**2) + (m - 1) * (q2 - area**2)
    return {"area": area, "se": sqrt(max(variance, 0.0) / (n * m)), "false": false, "true": true}


def calibration(rows: Sequence[Row], stated: str, right: str) -> Row:
    """Reliability in ten bins, expected calibration error and its band under calibration.

    The band: 95 % of what the error would be if each answer were right with just the probability
    stated (4000 draws).
    """
    known = [r for r in rows if r[stated] is not None]
    if not known:
        return {"n": 0, "ece": None, "band95": None, "inside": None, "bins": []}
    p = np.array([float(r[stated]) for r in known])
    hit = np.array([bool(r[right]) for r in known])
    bins = np.minimum((p * 10).astype(int), 9)

    def error(outcome: np.ndarray) -> np.ndarray:
        total = np.zeros(outcome.shape[:-1])
        for b in np.unique(bins):
            inside = bins == b
            total += np.abs((outcome[..., inside] - p[inside]).sum(axis=-1))
        return total / len(p)

    rng = np.random.default_rng(20260601)
    drawn = error((rng.random((4000, len(p))) < p).astype(float))
    ece, band = float(error(hit.astype(float))), float(np.quantile(drawn, 0.95))
    table = [
        {"stated": float(p[bins == b].mean()), "right": proportion(hit[bins == b])}
        for b in np.unique(bins)
    ]
    return {"n": len(p), "ece": ece, "band95": band, "inside": ece <= band, "bins": table}


def _closed(rows: Sequence[Row], level: float) -> Row:
    at = [
        r for r in _at(rows, level)
        if r["closed"] is not None and r["closed_oracle"] is not None and r["kind"] == "listed"
    ]  # fmt: skip
    errors = [abs(r["closed"] - r["closed_oracle"]) for r in at]
    held = [
        abs(r["closed_held_out"] - r["closed_oracle"])
        for r in at
        if r["closed_held_out"] is not None
    ]
    return {
        "d": level,
        "n": len(at),
        "median_error": float(np.median(errors)) if errors else None,
        "median_error_held_out": float(np.median(held)) if held else None,
        "coverage": proportion(
            r["closed_lo"] <= r["closed_oracle"] <= r["closed_hi"]
            for r in at
            if r["closed_lo"] is not None and r["closed_hi"] is not None
        ),
    }


def _localisation(rows: Sequence[Row]) -> Row:
    seen = [r for r in rows if r["located"] is not None]
    return {
        "n": len(seen),
        "share": _mean(seen, "located"),
        "share_oracle": _mean(seen, "located_oracle"),
        "precision": _mean(seen, "place_precision"),
        "recall": _mean(seen, "place_recall"),
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
    rng = np.random.default_rng(20260602)
    pick = rng.integers(len(named), size=(2000, len(named)))
    ratios = after[pick].mean(axis=1) / np.maximum(before[pick].mean(axis=1), 1e-12)
    known = [r for r in named if r["log_error_told"] is not None]
    told = ratio_told = None
    if known:
        told = float(np.mean([r["log_error_told"] for r in known]))
        at_first = float(np.mean([r["log_error_before"] for r in known]))
        ratio_told = told / max(at_first, 1e-12)
    return {
        "n": len(named),
        "told": told,
        "ratio_told": ratio_told,
        "before": float(before.mean()),
        "after": float(after.mean()),
        "median_before": float(np.median(before)),
        "median_after": float(np.median(after)),
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


def card_table(card: Row) -> pd.DataFrame:
    """Every proportion of the card, one a row: where it stands, k, n, rate and interval."""
    import pandas as pd

    found: list[Row] = []

    def walk(value: Any, path: str) -> None:
        if isinstance(value, Mapping):
            if {"k", "n", "rate"} <= set(value):
                found.append({"quantity": path, **value})
                return
            label = f" at d = {value['d']:g}" if isinstance(value.get("d"), float) else ""
            for key, inner in value.items():
                if key not in ("d", "bins", "goals", "kinds"):
                    walk(inner, f"{path}{label}.{key}" if path else str(key))
        elif isinstance(value, list):
            for inner in value:
                walk(inner, path)

    walk(card, "")
    return pd.DataFrame(found)
