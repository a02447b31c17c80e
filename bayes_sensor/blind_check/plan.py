"""Which cases a blind check consists of, and how one is drawn and sealed.

The plan depends on the number of cases and the seed alone.  Cases are drawn by
:mod:`bayes_sensor.blind_check.simulator`; the strength of every cause is set by its detectability.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace
from math import floor, sqrt
from typing import Any

import numpy as np

from bayes_sensor.blind_check.closing import closed_fraction
from bayes_sensor.blind_check.oracle import (
    HIDDEN_BELOW,
    Oracle,
    detectability,
    listed_rivals,
    pair_distance,
    places_after_refit,
    rival_distances,
    strength_for,
)
from bayes_sensor.blind_check.simulator import (
    CAUSES,
    HEAVY_TAILED,
    OPEN_LAWS,
    RESERVE_LAWS,
    SIZES,
    Case,
    Cause,
    acting_places,
    draw_case,
)
from bayes_sensor.campaign import CampaignError

LEVELS = (2.0, 4.0, 8.0, 16.0, 32.0)
"""detectabilities asked for"""
DEALT = tuple(sorted((*LEVELS, 8.0, 16.0)))
"""the same as often as they are asked for: goals are set for 8 and 16, which need the cases"""
SHARES = {
    "null": 0.335, "listed": 0.265, "unlisted": 0.205, "withheld": 0.1, "pair": 0.055,
    "hidden": 0.04,
}  # fmt: skip
"""kinds of cases; half of the nulls have noise that is not AR(1)"""
AR1_LAWS = ("ar1", "ar1", "ar1", "white")
HIDING = (
    "layered_coating", "anti_alias_filter", "heavy_plunger", "plunger_stroke", "back_mixing",
    "gated_pores", "controller_settling",
)  # fmt: skip
"""causes that can act strongly and leave next to nothing"""
NEAREST = 3
"""rivals, nearest first, whose refits go on until they settle and begin wherever they may"""


@dataclass(frozen=True)
class Entry:
    """One case of the plan."""

    name: str
    kind: str
    causes: tuple[str, ...]
    level: float
    """detectability asked for; 0 for nulls"""
    law: str
    size: str
    seed: int
    """of the case; a withheld case has that of the listed case it repeats"""
    diagnosis_seed: int


def counts(n: int) -> dict[str, int]:
    """How many cases of each kind, ``n`` in all (largest remainders)."""
    whole = {kind: floor(share * n) for kind, share in SHARES.items()}
    rest = sorted(SHARES, key=lambda kind: whole[kind] - SHARES[kind] * n)
    for kind in rest[: n - sum(whole.values())]:
        whole[kind] += 1
    return whole


def make_plan(
    n: int,
    seed: int,
    reserve: bool = False,
    size: str = "mixed",
    levels: Sequence[float] = DEALT,
) -> list[Entry]:
    """``n`` cases.

    ``reserve`` also takes the causes and noise laws that are kept for a final run.  ``size``:
    ``mixed`` (two thirds like the paper's campaign, one third of other lengths and intervals) or
    one of :data:`bayes_sensor.blind_check.simulator.SIZES`.  ``levels``: detectabilities that every
    listed and every unlisted cause is drawn with.

    Raises
    ------
    CampaignError
        If ``n`` is not positive or ``size`` is not known.
    """
    if size not in ("mixed", *SIZES):
        raise CampaignError(
            f"--size: expected one of mixed, {', '.join(SIZES)}, but got '{size}'; correct it"
        )
    if n < 1:
        raise CampaignError(f"--cases: expected at least one case, got {n}")
    rng = np.random.default_rng([seed, 0xB11D])
    seeds = rng.integers(1, 2**31, size=2 * n)
    number = counts(n)
    other_laws = [law for law in OPEN_LAWS if law not in AR1_LAWS]
    if reserve:  # as often as the others together
        other_laws += [RESERVE_LAWS[i % len(RESERVE_LAWS)] for i in range(len(other_laws))]
    listed = _pairs_of(
        [c for c in CAUSES.values() if c.listed and c.name not in HIDING[:2]],
        rng,
        number["listed"],
        levels,
    )
    outside = [c for c in CAUSES.values() if not c.listed and not c.reserve]
    kept = [c for c in CAUSES.values() if not c.listed and c.reserve]
    unlisted = _pairs_of(outside, rng, number["unlisted"], levels)
    if reserve:
        unlisted[::2] = _pairs_of(kept, rng, len(unlisted[::2]), levels)

    def one(kind: str, i: int, causes: tuple[str, ...], level: float, law: str) -> Entry:
        which = size
        if size == "mixed":
            which = "paper" if rng.random() < 2.0 / 3.0 else "varied"
        k = len(entries)
        return Entry("", kind, causes, level, law, which, int(seeds[2 * k]), int(seeds[2 * k + 1]))

    entries: list[Entry] = []
    for i in range(number["null"]):
        law = AR1_LAWS[(i // 2) % 4] if i % 2 == 0 else other_laws[(i // 2) % len(other_laws)]
        entries.append(one("null", i, (), 0.0, law))

    def any_law() -> str:
        laws = AR1_LAWS if rng.random() < 0.7 else tuple(other_laws)
        return str(rng.choice(laws))

    for kind, drawn in (("listed", listed), ("unlisted", unlisted)):
        for i, (cause, level) in enumerate(drawn):
            entries.append(one(kind, i, (cause.name,), level, any_law()))
    visible = [e for e in entries if e.kind == "listed" and e.level >= 8.0]
    for i in range(number["withheld"]):
        if visible:
            twin = visible[i % len(visible)]
        else:
            cause, level = _pairs_of([c for c in CAUSES.values() if c.listed], rng, 1, levels)[0]
            twin = one("withheld", i, (cause.name,), max(level, 8.0), any_law())
        entries.append(
            replace(twin, kind="withheld", diagnosis_seed=int(seeds[2 * len(entries) + 1]))
        )
    for i in range(number["pair"]):
        first, second = _two_families(rng)
        level = float(rng.choice(LEVELS[2:]))
        entries.append(one("pair", i, (first, second), level, any_law()))
    for i in range(number["hidden"]):
        entries.append(one("hidden", i, (HIDING[i % len(HIDING)],), 1.0, any_law()))
    order = rng.permutation(len(entries))
    digits = max(4, len(str(n)))
    return [replace(entries[j], name=f"case-{i + 1:0{digits}d}") for i, j in enumerate(order)]


def _pairs_of(
    causes: list[Cause], rng: np.random.Generator, n: int, levels: Sequence[float]
) -> list[tuple[Cause, float]]:
    """``n`` (cause, level), every combination once before any comes again."""
    every = [(cause, level) for cause in causes for level in levels]
    found: list[tuple[Cause, float]] = []
    while len(found) < n:
        # deal the causes round by round, so that a short list holds many of them
        columns = [rng.permutation(len(levels)) for _ in causes]
        for round_ in range(len(levels)):
            for k in rng.permutation(len(causes)):
                found.append(every[k * len(levels) + columns[k][round_]])
    return found[:n]


def _two_families(rng: np.random.Generator) -> tuple[str, str]:
    listed = [c for c in CAUSES.values() if c.listed and not c.noise and c.family != "delay"]
    while True:
        first, second = (listed[i] for i in rng.choice(len(listed), 2, replace=False))
        if first.family != second.family:
            return first.name, second.name


# --------------------------------------------------------------------------- truths


def draw_truth(entry: Entry) -> dict[str, Any]:
    """Everything about a case that is to be sealed, as plain values.

    ``recipe`` makes the campaign; ``d`` is what an oracle sees; ``rivals`` how far each listed
    explanation stays behind the truth, and ``pair_rival`` the nearest two together where none is
    right; ``acts`` where the causes act; ``closed`` what share of the gap the right effects of the
    catalogue could close.
    """
    case = draw_case(entry.seed, law=entry.law, size=entry.size)
    strengths: dict[str, float] = {}
    for name in entry.causes:
        if entry.kind == "hidden":
            rng = np.random.default_rng([entry.seed, 5])
            strength = CAUSES[name].highest * rng.uniform(0.4, 1.0)
            if detectability(replace(case, strengths={name: strength})) >= HIDDEN_BELOW:
                strength, _ = strength_for(case, name, 0.5 * HIDDEN_BELOW)
        else:
            strength, _ = strength_for(case, name, entry.level)
        strengths[name] = strength
    case = replace(case, strengths=strengths)
    near = {name for cause in entry.causes for name in CAUSES[cause].near}
    if entry.law in HEAVY_TAILED:  # its tails are heavy, whatever else is wrong
        near.add("heavy_tails")
    truth: dict[str, Any] = {
        **asdict(entry),
        "strengths": strengths,
        "listed_as": [list(CAUSES[name].listed_as) for name in entry.causes],
        "near": sorted(near),
        "cause_families": [CAUSES[name].family for name in entry.causes],
        "reserve": any(CAUSES[name].reserve for name in entry.causes) or entry.law in RESERVE_LAWS,
        "is_ar1": case.noise.is_ar1,
        "tau_s": case.tau,
        "recipe": case.to_json(),
    }
    truth["causes"] = list(entry.causes)
    truth |= _seen_by_an_oracle(case)
    return truth


def _seen_by_an_oracle(case: Case) -> dict[str, Any]:
    seen: dict[str, Any] = {
        "d": 0.0, "tau_refit_s": case.tau, "rivals": {}, "acts": [], "visible": [], "closed": {},
    }  # fmt: skip
    if not case.strengths:
        return seen
    seen["d"] = detectability(case)
    if not all(CAUSES[name].noise for name in case.strengths):
        seen["acts"] = _as_rows(acting_places(case))
    if all(CAUSES[name].noise or CAUSES[name].fast for name in case.strengths):
        return seen
    oracle = Oracle(case)
    target = oracle.signal(case)
    fit = oracle.refit(target, oracle.several_starts(oracle.start()))
    seen["tau_refit_s"] = fit.tau
    seen["visible"] = _as_rows(places_after_refit(case, fit, oracle))
    rivals = listed_rivals(case, fit, oracle)
    seen["rivals"] = rival_distances(fit, rivals)
    answers = {effect for name in case.strengths for effect in CAUSES[name].listed_as}
    others = seen["rivals"].keys() - answers
    for thorough in (False, True):  # settled by refits of the catalogue's forms
        for name in sorted(others, key=seen["rivals"].__getitem__)[: NEAREST if thorough else None]:
            closed = closed_fraction(oracle, target, fit, name, thorough=thorough)
            if closed is not None:
                seen["rivals"][name] = min(seen["rivals"][name], fit.d * sqrt(1.0 - closed))
    if not answers:
        seen["pair_rival"] = min(pair_distance(fit, rivals), *seen["rivals"].values())
    if len(case.strengths) == 1 and fit.d >= HIDDEN_BELOW:
        name = next(iter(case.strengths))
        seen["closed"] = {
            effect: closed
            for effect in CAUSES[name].listed_as
            if (closed := closed_fraction(oracle, target, fit, effect)) is not None
        }
    return seen


def _as_rows(shares: dict[tuple[str, str], float]) -> list[dict[str, Any]]:
    return [
        {"experiment": name, "phase": phase, "share": share}
        for (name, phase), share in shares.items()
        if share > 0
    ]
