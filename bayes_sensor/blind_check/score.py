"""One case scored: what was true, what was said, and how the two compare.

``d`` of a case is what the oracle found, put to the nearest of 2, 4, 8, 16, 32.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from math import log, sqrt
from typing import Any

from bayes_sensor.blind_check.baselines import by_bic, by_rss
from bayes_sensor.blind_check.oracle import HIDDEN_BELOW, SEPARABLE_ABOVE
from bayes_sensor.blind_check.plan import LEVELS
from bayes_sensor.blind_check.statistics import Row, f1
from bayes_sensor.diagnosis.effects import CATALOGUE

CONFIDENT = 0.9
VISIBLE = 4.0
"""detectability from which localisation and tau are scored"""
ACTING = 0.95
"""share of the true difference that the places hold which count as those where a cause acts"""
OUTSIDE = ("unlisted", "withheld")
"""kinds whose cause is not in the catalogue"""


def level_of(d: float | None) -> float | None:
    """The nearest level (in the logarithm), 0 below 1.4, None where d is not known."""
    if d is None:
        return None
    if d < sqrt(0.5) * LEVELS[0]:
        return 0.0
    return min(LEVELS, key=lambda level: abs(log(d / level)))


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
        "left_sd": _left(verdict),
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


def _of_the_likeliest(rows: Iterable[Mapping[str, Any]], key: str) -> float | None:
    """What the likeliest of the rows has there; None where there is none."""
    best = max(rows, key=lambda row: row["probability"] or 0.0, default=None)
    return None if best is None else float(best[key])


def _left(verdict: Mapping[str, Any]) -> float | None:
    """Standard deviations of misfit under the likeliest explanation by effects of the catalogue."""
    key = "misfit_left_sd"
    effects = (row for row in verdict["which"] if row["effect"] not in ("none", "unlisted"))
    return _of_the_likeliest((row for row in effects if row.get(key) is not None), key)


def _tau_told(verdict: Mapping[str, Any], right: Sequence[set[str]]) -> float | None:
    """s, tau of the likeliest explanation by the true causes alone: what being told would give."""
    which = verdict["which"]
    true = [row for row in which if row.get("tau_s") and _explains(row["effect"], right)]
    return _of_the_likeliest(true, "tau_s")


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
        "place_f1_oracle": f1(*_hits(_most_of(seen), acting)) if seen else None,
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
