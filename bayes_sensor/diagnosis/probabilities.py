"""One probability vector over what may be wrong; everything that is stated is read from it.

1. Each hypothesis on the mean is put into a class: no cause, listed effects, or an unlisted cause.
   Its posterior probability is added to that class.  A cause too small to be seen counts as no
   cause: *none* means that nothing is missing that this campaign could show.
2. The calibration map corrects the classes: it knows how often each is mistaken for another.
3. Findings in single samples raise the probability of an unlisted cause.
4. Effects of the noise multiply the vector: they are there or not, whatever explains the mean.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from itertools import product
from math import sqrt

from scipy.stats import norm

from bayes_sensor.diagnosis.calibration import Appearance, calibration
from bayes_sensor.diagnosis.effects.effect import Effect
from bayes_sensor.diagnosis.evidence.compared_hypotheses import Comparison, Hypothesis
from bayes_sensor.diagnosis.evidence.form_mismatch import (
    leaves_excess,
    leaves_explanation_alone,
    simpler_explanation,
    taken_beside,
)
from bayes_sensor.diagnosis.evidence.refit import Refit
from bayes_sensor.diagnosis.signals.signal import Finding

FAINT = 2.0
"""detectability below which a cause that is there leaves nothing to be seen: two standard
deviations of the noise"""
LEAST = 1e-4
"""probability of an explanation below which it is not looked at closely; it bounds the error of
every stated probability, which has two digits"""


@dataclass(frozen=True)
class Probabilities:
    """The vector, and its sums over effects and families."""

    rows: Mapping[str, float]
    """``none``, ``unlisted``, effects, ``a+b``; sums to 1"""
    catalogue: Mapping[str, Effect] = field(repr=False)
    appearances: tuple[Appearance, ...] = field(default=(), repr=False)
    """what the evidences say, before calibration"""

    @property
    def none(self) -> float:
        """Nothing is missing that could be seen."""
        return self.rows["none"]

    @property
    def unlisted(self) -> float:
        """Something that is not in the catalogue is there."""
        return self.rows["unlisted"]

    @cached_property
    def effects(self) -> dict[str, float]:
        """Every effect -> probability that it is there, alone or with another."""
        return {
            name: sum(p for row, p in self.rows.items() if name in row.split("+"))
            for name in self.catalogue
        }

    @cached_property
    def families(self) -> dict[str, float]:
        """Every family -> probability that a member is there."""
        found: dict[str, float] = {}
        for row, p in self.rows.items():
            for family in {self.catalogue[n].family for n in self.members(row)}:
                found[family] = found.get(family, 0.0) + p
        return found

    @cached_property
    def unmoved(self) -> float:
        """Nothing moves the mean that could be seen: none, or effects of the noise alone."""
        return sum(
            p
            for row, p in self.rows.items()
            if row != "unlisted" and not any(self.catalogue[n].on_mean for n in self.members(row))
        )

    def looks(self, look: str) -> float:
        """Share of the evidence of the mean that looks so, before calibration."""
        return sum(a.mass for a in self.appearances if a.look == look)

    @staticmethod
    def members(row: str) -> tuple[str, ...]:
        """The effects of a row."""
        return () if row in ("none", "unlisted") else tuple(row.split("+"))


def combine(
    comparison: Comparison, findings: Sequence[Finding], catalogue: Mapping[str, Effect]
) -> Probabilities:
    """The probability vector of one campaign."""
    seen = tuple(appearances(comparison, findings))
    likeliest = max(
        (h for h in comparison.complete if h.effects), key=lambda h: h.log_weight, default=None
    )
    on_mean = calibrated(seen, likeliest.effects if likeliest else ())
    rows = {"none": 0.0, "unlisted": 0.0, **dict.fromkeys(catalogue, 0.0)}
    for h in comparison.complete:
        rows.setdefault("+".join(h.effects) or "none", 0.0)
    on_noise = {f.name: f.probability for f in findings if f.name in catalogue}
    for there, share in _subsets(on_noise):
        for causes, p in on_mean.items():
            # what is unlisted is that, whatever the noise is
            key = causes if causes == "unlisted" else "+".join(
                [*([] if causes == "none" else [causes]), *there]
            ) or "none"  # fmt: skip
            if key in rows or p * share > 0.0:
                rows[key] = rows.get(key, 0.0) + p * share
    return Probabilities(rows, catalogue, seen)


def calibrated(seen: Sequence[Appearance], likeliest: tuple[str, ...]) -> dict[str, float]:
    """``none``, ``unlisted`` and every explanation of the mean, summing to 1.

    By the calibration map a part of what looks like no cause, or like an unlisted one, is due to
    listed effects.  It is divided among them in proportion to their probabilities, or given to the
    ``likeliest`` where none has any.
    """
    table = calibration()
    rows = {"none": 0.0, "unlisted": 0.0}
    listed: dict[str, float] = {}
    astray = 0.0
    for a in seen:
        taken = 0.0 if a.finding is None else table.of_finding(a.finding)
        rest, shares = a.mass * (1.0 - taken), table.shares(a.look, a.d)
        rows["none"] += rest * shares.none
        rows["unlisted"] += a.mass * taken + rest * shares.unlisted
        if a.causes:
            key = "+".join(a.causes)
            listed[key] = listed.get(key, 0.0) + rest * shares.listed
        else:
            astray += rest * shares.listed
    known = sum(listed.values())
    if known > 0.0:
        # a ratio of two tiny probabilities is exact, where one over a tiny sum overflows
        listed = {key: p + astray * (p / known) for key, p in listed.items()}
    else:
        key = "+".join(likeliest) or "unlisted"
        (rows if key == "unlisted" else listed)[key] = rows.get(key, 0.0) + astray
    made = {**rows, **listed}
    whole = sum(made.values())
    return {key: p / whole for key, p in made.items()}


def _subsets(there: Mapping[str, float]) -> list[tuple[list[str], float]]:
    """Every set of effects of the noise with its probability; they are independent."""
    found = []
    for chosen in product((False, True), repeat=len(there)):
        share = 1.0
        for yes, p in zip(chosen, there.values(), strict=True):
            share *= p if yes else 1.0 - p
        found.append(([n for n, yes in zip(there, chosen, strict=True) if yes], share))
    return found


def appearances(comparison: Comparison, findings: Sequence[Finding]) -> list[Appearance]:
    """What every hypothesis looks like, with its share of the posterior."""
    found: list[Appearance] = []
    unlisted = [f for f in findings if not f.signal.listed]
    anything = max((f.log_odds for f in unlisted), default=None)
    for h, p in zip(comparison.hypotheses, comparison.probabilities.tolist(), strict=True):
        d = detectability(h, comparison.base)
        left_open = anything
        if h.effects and not h.incomplete and p > LEAST:
            rivals = [
                f.log_odds
                for f in unlisted
                if not leaves_explanation_alone(f, h.refit, comparison.base)
            ]
            left_open = max(rivals, default=None)
        for look, causes, share in _looks(h, comparison, p > LEAST):
            said = anything if look == "none" else None if look == "unlisted" else left_open
            if share > 0.0:
                found.append(Appearance(look, causes, p * share, d, said))
    return found


def _looks(
    h: Hypothesis, comparison: Comparison, closely: bool
) -> list[tuple[str, tuple[str, ...], float]]:
    """The looks of one hypothesis, with causes and shares that sum to 1."""
    base = comparison.base
    if not h.effects and not h.incomplete:
        return [("none", (), 1.0)]
    listed = "own" if any(part.form.mean for part in h.refit.coords.parts) else "listed"
    if not closely:
        return [("unlisted", (), 1.0) if h.incomplete else (listed, h.effects, 1.0)]
    if not h.effects:
        unseen = too_small(sqrt(max(base.misfit - h.refit.misfit + taken_beside(h), 0.0)))
        return [("none", (), unseen), ("unlisted", (), 1.0 - unseen)]
    form = simpler_explanation(h, comparison)
    if form:
        return [("form", form.effects, 1.0)]
    if h.incomplete:
        unseen = too_small(sqrt(max(taken_beside(h), 0.0)))
        return [(listed, h.effects, unseen), ("unlisted", (), 1.0 - unseen)]
    if leaves_excess(h, base):
        return [("unlisted", (), 1.0)]
    none = too_small(detectability(h, base))
    looks: list[tuple[str, tuple[str, ...], float]] = [("none", (), none)]
    seen = [h.effects]
    if len(h.effects) == 2:
        alone = [comparison.find(name) for name in h.effects]
        # each is too small to be seen beside the other
        first, second = (too_small(_gain(one, h)) for one in reversed(alone))
        better = int(alone[1].log_weight > alone[0].log_weight)
        only = [second * (1.0 - first), first * (1.0 - second)]
        only[better] += first * second
        looks += [(listed, (n,), (1.0 - none) * s) for n, s in zip(h.effects, only, strict=True)]
        none += (1.0 - none) * sum(only)
    return [*looks, *((listed, causes, 1.0 - none) for causes in seen)]


def too_small(d: float) -> float:
    """Probability that a cause found at detectability ``d`` truly has one below ``FAINT``.

    What is found of it is what is there and one standard deviation of noise.
    """
    return float(norm.cdf(FAINT - d) - norm.cdf(-FAINT - d))


def detectability(h: Hypothesis, base: Refit) -> float:
    """Root of the misfit that an explanation removes, in standard deviations of the noise."""
    return sqrt(max(base.misfit - h.refit.misfit, 0.0))


def _gain(smaller: Hypothesis, whole: Hypothesis) -> float:
    return sqrt(max(smaller.refit.misfit - whole.refit.misfit, 0.0))
