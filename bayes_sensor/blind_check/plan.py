"""Which cases a blind check consists of, and how one is drawn.

The plan depends on the number of cases and the seed alone.  The strength of every cause is set by
its detectability d.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace
from math import floor, sqrt
from typing import Any

import numpy as np

from bayes_sensor.blind_check.closed_shares import closed_shares
from bayes_sensor.blind_check.detectability import (
    detectability,
    ideal_fit,
    strength_for,
)
from bayes_sensor.blind_check.simulator import (
    CAUSES,
    HEAVY_TAILED,
    OPEN_LAWS,
    OTHER_RIGS,
    RESERVE_LAWS,
    SIZES,
    acting_places,
    draw_case,
    has_meaning,
    other_rig,
)
from bayes_sensor.campaign import CampaignError

LEVELS = (2.0, 4.0, 8.0, 16.0, 32.0)
"""detectabilities asked for"""
DEALT = tuple(sorted((*LEVELS, 8.0, 16.0)))
"""how often each is asked for: goals are set for 8 and 16, which need more cases"""
DEALT_WITH_RESERVE = (10.0, 30.0)
"""the same of a run with the reserve: those that its goals are set for"""
STRONG = 8.0
"""detectability from which two causes are drawn together, and one is withheld"""
OTHER = "other"
OTHER_SHARE = 0.25
"""of the campaigns of a run with the reserve: those on other rigs than the published one"""
HIDDEN_BELOW = 2.0
"""detectability under which a cause counts as hidden"""
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
    levels: Sequence[float] | None = None,
) -> list[Entry]:
    """``n`` cases in random order.

    ``reserve`` also takes the causes and noise laws that are kept for a final run.  ``size``:
    ``mixed`` (two thirds like the paper's campaign, one third of other lengths and intervals), one
    of :data:`SIZES`, or ``other``: other rigs alone, of which a run with the reserve has a quarter
    in any case.  ``levels``: detectabilities that every cause is drawn with.

    Raises
    ------
    CampaignError
        If ``n`` is not positive or ``size`` is not known.
    """
    if size not in (known := ("mixed", *SIZES, OTHER)):
        raise CampaignError(
            f"--size: expected one of {', '.join(known)}, but got '{size}'; correct it"
        )
    if n < 1:
        raise CampaignError(f"--cases: expected at least one case, got {n}")
    if levels is None:
        levels = DEALT_WITH_RESERVE if reserve else DEALT
    rng = np.random.default_rng([seed, 0xB11D])
    if reserve and size != OTHER and (n_other := round(OTHER_SHARE * n)):
        parts = [_entries(n - n_other, rng, reserve, size, levels)] if n > n_other else []
        parts.append(_entries(n_other, rng, reserve, OTHER, levels))
        entries = [entry for part in parts for entry in part]
    else:
        entries = _entries(n, rng, reserve, size, levels)
    digits = max(4, len(str(n)))
    order = rng.permutation(n)
    return [replace(entries[j], name=f"case-{i + 1:0{digits}d}") for i, j in enumerate(order)]


def _entries(
    n: int, rng: np.random.Generator, reserve: bool, size: str, levels: Sequence[float]
) -> list[Entry]:
    """``n`` cases by kind, without names."""
    number = counts(n)
    possible = {c.name: c for c in CAUSES.values() if size != OTHER or _rigs_for((c.name,))}
    other_laws = [law for law in OPEN_LAWS if law not in AR1_LAWS]
    if reserve and RESERVE_LAWS:  # as often as the others together
        other_laws += [RESERVE_LAWS[i % len(RESERVE_LAWS)] for i in range(len(other_laws))]
    listed = [c.name for c in possible.values() if c.listed]
    drawn: list[tuple[str, tuple[str, ...], float]] = [("null", (), 0.0)] * number["null"]
    open_ones = [name for name in listed if name not in HIDING[:2]]
    drawn += [
        ("listed", (name,), d) for name, d in _dealt(open_ones, levels, number["listed"], rng)
    ]
    outside = [c.name for c in possible.values() if not c.listed and not c.reserve]
    kept = [c.name for c in possible.values() if not c.listed and c.reserve]
    unlisted = _dealt(outside, levels, number["unlisted"], rng)
    if reserve and kept:
        unlisted[::2] = _dealt(kept, levels, len(unlisted[::2]), rng)
    drawn += [("unlisted", (name,), d) for name, d in unlisted]
    strong = sorted({d for d in levels if d >= STRONG}) or [max(levels)]
    for _ in range(number["pair"]):
        drawn.append(("pair", _two_families(rng, size), float(rng.choice(strong))))
    hiding = [name for name in HIDING if name in possible]
    drawn += [("hidden", (hiding[i % len(hiding)],), 1.0) for i in range(number["hidden"])]
    seeds = rng.integers(1, 2**31, size=(n, 2)).tolist()
    entries: list[Entry] = []
    for i, (kind, causes, level) in enumerate(drawn):
        laws: Sequence[str] = AR1_LAWS if rng.random() < 0.7 else other_laws
        law = str(rng.choice(laws))
        if kind == "null":  # each law as often as the others
            laws = AR1_LAWS if i % 2 == 0 else other_laws
            law = laws[(i // 2) % len(laws)]
        mixed = "paper" if rng.random() < 2.0 / 3.0 else "varied"
        its_size = mixed if size == "mixed" else size
        if size == OTHER:
            its_size = str(rng.choice(_rigs_for(causes)))
        entries.append(Entry("", kind, causes, level, law, its_size, *seeds[i]))
    plain = [e for e in entries if e.kind == "listed" and e.level >= STRONG]
    plain = plain or [e for e in entries if e.kind == "listed"]
    for i in range(n - len(entries)):  # listed cases once more, their effects taken out
        seed_of_diagnosis = seeds[len(entries)][1]
        twin = plain[i % len(plain)]
        entries.append(replace(twin, kind="withheld", diagnosis_seed=seed_of_diagnosis))
    return entries


def _rigs_for(causes: Sequence[str]) -> list[str]:
    """Other rigs on which all of the causes have a meaning."""
    return [kind for kind in OTHER_RIGS if all(has_meaning(CAUSES[name], kind) for name in causes)]


def _dealt(
    names: Sequence[str], levels: Sequence[float], n: int, rng: np.random.Generator
) -> list[tuple[str, float]]:
    """``n`` (cause, level), every combination once before any comes again."""
    found: list[tuple[str, float]] = []
    while len(found) < n:
        # deal the causes round by round, so that a short list holds many of them
        columns = [rng.permutation(levels) for _ in names]
        for k in range(len(levels)):
            found += [(names[i], float(columns[i][k])) for i in rng.permutation(len(names))]
    return found[:n]


def _two_families(rng: np.random.Generator, size: str) -> tuple[str, str]:
    listed = [c for c in CAUSES.values() if c.listed and not c.noise and c.family != "delay"]
    while True:
        first, second = (listed[i] for i in rng.choice(len(listed), 2, replace=False))
        names = first.name, second.name
        if first.family != second.family and (size != OTHER or _rigs_for(names)):
            return names


def draw_truth(entry: Entry) -> dict[str, Any]:
    """Everything about a case that is to be sealed, as plain values.

    ``recipe`` makes the campaign; ``d``: its detectability; ``rivals``: standard deviations of
    misfit that each other effect of the catalogue leaves; ``closed``: share of the gap that the
    right effects close; ``acts``: where the causes act.
    """
    causes = [CAUSES[name] for name in entry.causes]
    if entry.size in OTHER_RIGS:
        needs_valve = any(cause.place == "valve" for cause in causes)
        case = other_rig(entry.size, entry.seed, entry.law, needs_valve)
    else:
        case = draw_case(entry.seed, law=entry.law, size=entry.size)
    strengths = {name: strength_for(case, name, entry.level)[0] for name in entry.causes}
    case = replace(case, strengths=strengths)
    near = {name for cause in causes for name in cause.near}
    if entry.law in HEAVY_TAILED:  # its tails are heavy, whatever else is wrong
        near.add("heavy_tails")
    truth: dict[str, Any] = {
        **asdict(entry),
        "causes": list(entry.causes),
        "strengths": dict(case.strengths),
        "listed_as": [list(cause.listed_as) for cause in causes],
        "near": sorted(near),
        "cause_families": [cause.family for cause in causes],
        "reserve": any(cause.reserve for cause in causes) or entry.law in RESERVE_LAWS,
        "is_ar1": case.noise.is_ar1,
        "tau_s": case.tau,
        "recipe": case.to_json(),
        "d": 0.0, "tau_refit_s": case.tau, "rivals": {}, "acts": [], "closed": {},
    }  # fmt: skip
    if causes:
        truth["d"] = detectability(case)
    if not all(cause.noise for cause in causes):
        truth["acts"] = [
            {"experiment": name, "phase": phase, "share": share}
            for (name, phase), share in acting_places(case).items()
            if share > 0
        ]
    if not all(cause.noise or cause.fast for cause in causes):
        fit = ideal_fit(case)
        truth["tau_refit_s"] = fit.tau
        right = {effect for cause in causes for effect in cause.listed_as}
        for effect, share in closed_shares(case).items():
            if effect not in right:
                truth["rivals"][effect] = fit.d * sqrt(1.0 - share)
            elif len(causes) == 1 and fit.d >= HIDDEN_BELOW:
                truth["closed"][effect] = share
    return truth
