"""One case scored: what was true, what was said, and how the two compare.

The rule of abstention (oracle rule): a verdict without a name counts as right where some wrong
effect, fitted to the noise-free signal, leaves a misfit below :data:`SEPARABLE_ABOVE` standard
deviations, because no data would tell the two apart.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from math import inf, log, sqrt
from typing import Any

from bayes_sensor.blind_check.plan import HIDDEN_BELOW, LEVELS
from bayes_sensor.blind_check.statistics import Row
from bayes_sensor.diagnosis.effects import CATALOGUE

CONFIDENT = 0.9
BIC_MARGIN = 10.0
"""how far below the ideal model's BIC an effect is named (Kass and Raftery 1995)"""
SEPARABLE_ABOVE = 3.0
"""standard deviations of misfit from which two explanations can be told apart"""
VISIBLE = 4.0
"""detectability from which places and tau are scored"""
ACTING = 0.95
"""share of the true difference held by the places that count as those where a cause acts"""
OUTSIDE = ("unlisted", "withheld")
"""kinds whose cause is not in the catalogue"""
Places = set[tuple[str, str]]
"""experiments and phases"""


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
    verdict = _without_tails_of_the_noise(verdict, near - answers)
    rows = {row["effect"]: float(row["probability"] or 0.0) for row in verdict["which"]}
    top = max(rows, key=rows.__getitem__)
    said, shrink = verdict["verdict"], verdict["shrink"]
    named = set(said["effects"]) if said["kind"] == "effect" else set()
    wrong = named - accepted - near
    right_families = families_of(answers)

    def is_right(label: str) -> bool:
        if kind == "null" or outside:
            return label == ("none" if kind == "null" else "unlisted")
        members = set(label.split("+"))
        return members <= answers and len(members) == len(right)

    families = _families(verdict)
    top_family = max(families, key=families.__getitem__)
    if kind == "null" or outside:
        family_right = is_right(top_family) or (kind == "withheld" and top_family in right_families)
    else:
        family_right = top_family in right_families
    apart = min((v for name, v in truth["rivals"].items() if name not in answers), default=inf)
    apart_family = min(
        (v for name, v in truth["rivals"].items() if not families_of([name]) <= right_families),
        default=inf,
    )
    abstains = kind != "null" and said["kind"] not in ("effect", "failed")
    p_right = min(1.0, sum(p for label, p in rows.items() if is_right(label)))
    smallest = _smallest_set(rows)
    envelope, tau = verdict["tau_envelope_s"], truth["tau_s"]
    explanation = shrink.get("explanation") or next(iter(said["effects"] if named else ()), "")
    return {
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
        "p_right": p_right,
        "named": bool(named),
        "named_confidently": bool(named) and said["probability"] > CONFIDENT,
        "wrong_name": bool(wrong),
        "wrong_outside_family": any(not families_of([n]) <= right_families for n in wrong),
        "confident_wrong": bool(wrong) and said["probability"] > CONFIDENT,
        "top_right": is_right(top),
        "family_right": family_right,
        "isolability": apart,
        "isolability_family": apart_family,
        "top_or_abstained": is_right(top) or (abstains and not outside and apart < SEPARABLE_ABOVE),
        "family_or_abstained": family_right or (abstains and apart_family < SEPARABLE_ABOVE),
        "verdict_right": _verdict_right(truth, said, accepted | near, right_families),
        "in_set": any(
            is_right(label) or bool(set(label.split("+")) & accepted) for label in smallest
        ),
        "set_size": len(smallest),
        # Brier 1950: squared distance from certainty about the right answer, over all rows
        "brier": (1.0 - p_right) ** 2 + sum(p * p for n, p in rows.items() if not is_right(n)),
        "log_score": -log(max(p_right, 1e-3)),
        "on_mean": any(CATALOGUE[name].on_mean for name in answers if name in CATALOGUE),
        "bic_says": _by_bic(verdict["which"]),
        "gap_p": verdict["budget"].get("p_value"),
        "closed": shrink.get("fraction_closed"),
        "closed_lo": shrink.get("fraction_closed_lo"),
        "closed_hi": shrink.get("fraction_closed_hi"),
        "closed_held_out": shrink.get("held_out_fraction_closed"),
        "closed_oracle": truth["closed"].get(explanation),
        **_places(truth, verdict),
        "tau_true_s": tau,
        "tau_before_s": shrink.get("tau_before_s"),
        "tau_after_s": shrink.get("tau_after_s"),
        "tau_refit_s": truth["tau_refit_s"],
        "log_error_before": _log_error(shrink.get("tau_before_s"), tau),
        "log_error_after": _log_error(shrink.get("tau_after_s"), tau),
        "envelope_lo_s": envelope[0],
        "envelope_hi_s": envelope[1],
        "envelope_holds": None
        if tau is None or None in envelope
        else bool(envelope[0] <= tau <= envelope[1]),
    }


def families_of(names: Sequence[str] | set[str]) -> set[str]:
    """Families of effects; a name that is not in the catalogue is its own."""
    return {CATALOGUE[name].family if name in CATALOGUE else name for name in names}


def _without_tails_of_the_noise(verdict: Mapping[str, Any], near: set[str]) -> Mapping[str, Any]:
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
            p = min(which["none"]["probability"], 1.0)
            said.update(kind="none", family=None, probability=p)
    return {**verdict, "which": list(which.values()), "verdict": said}


def _families(verdict: Mapping[str, Any]) -> dict[str, float]:
    """Probability of none, unlisted and each family; a row of two families counts for both."""
    found: dict[str, float] = {"none": 0.0, "unlisted": 0.0}
    own = {row["effect"]: row["family"] for row in verdict["which"] if "+" not in row["effect"]}
    for row in verdict["which"]:
        for family in {own.get(name) or name for name in row["effect"].split("+")}:
            found[family] = found.get(family, 0.0) + float(row["probability"] or 0.0)
    return found


def _by_bic(which: Sequence[Mapping[str, Any]]) -> str:
    """What one would name without the diagnosis: the single effect with the least BIC, or none."""
    known = {
        row["effect"]: float(row["bic"])
        for row in which
        if row.get("bic") is not None and "+" not in row["effect"] and row["effect"] != "unlisted"
    }
    best = min(known, key=known.__getitem__, default="none")
    return best if best != "none" and known[best] < known.get("none", inf) - BIC_MARGIN else "none"


def _smallest_set(rows: Mapping[str, float], level: float = 0.95) -> list[str]:
    """The fewest rows that hold ``level`` of the probability."""
    chosen, total = [], 0.0
    for label in sorted(rows, key=lambda name: -rows[name]):
        chosen.append(label)
        total += rows[label]
        if total >= level:
            break
    return chosen


def _verdict_right(
    truth: Mapping[str, Any], said: Mapping[str, Any], there: set[str], families: set[str]
) -> bool:
    """Whether the stated verdict holds: what it names is there, none means nothing to be seen."""
    kind = truth["kind"]
    if said["kind"] == "none":
        return kind == "null" or (truth["d"] is not None and truth["d"] < HIDDEN_BELOW)
    if said["kind"] == "unlisted":
        return kind in OUTSIDE
    if said["kind"] == "family":
        of_it = kind == "withheld" and said["family"] in families
        return bool(set(said["effects"]) & there) or of_it
    return said["kind"] == "effect" and set(said["effects"]) <= there


def _places(truth: Mapping[str, Any], verdict: Mapping[str, Any]) -> Row:
    """Share of the stated excess where the causes act; precision and recall of the places.

    Places are the fewest that hold most of the true difference, and of the excess as stated.
    """
    found: Row = dict.fromkeys(("places", "located", "place_precision", "place_recall"))
    acting = _most_of(truth["acts"])
    if not acting or truth["d"] is None or truth["d"] < VISIBLE:
        return found
    found["places"] = len(acting)
    stated = [{**row, "share": row["share"] or 0.0} for row in verdict["where"]]
    if claimed := _most_of(stated):
        inside = (r["share"] for r in stated if (r["experiment"], r["phase"]) in acting)
        found["located"] = float(sum(inside))
        found["place_precision"] = len(claimed & acting) / len(claimed)
        found["place_recall"] = len(claimed & acting) / len(acting)
    return found


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


def _log_error(value: float | None, truth: float | None) -> float | None:
    if value is None or truth is None or value <= 0:
        return None
    return abs(log(value / truth))
