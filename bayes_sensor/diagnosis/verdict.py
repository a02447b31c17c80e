"""From probabilities to a verdict: none, an effect, a family, or something unlisted."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from math import sqrt
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.stats import norm

from bayes_sensor.diagnosis.data.binned_campaign import BinnedCampaign
from bayes_sensor.diagnosis.data.bins import PHASES
from bayes_sensor.diagnosis.effects.effect import Effect
from bayes_sensor.diagnosis.evidence.compared_hypotheses import Comparison, Hypothesis
from bayes_sensor.diagnosis.evidence.form_mismatch import (
    simpler_explanation,
    small_enough,
    within_form_mismatch,
)
from bayes_sensor.diagnosis.evidence.hypotheses import PRIOR_NONE, PRIOR_UNLISTED
from bayes_sensor.diagnosis.evidence.refit import Refit
from bayes_sensor.diagnosis.signals.finding import Finding

NAMED = 0.9
"""probability from which an effect or a family is named"""
LOUDER = 0.75
"""probability from which a family on the mean is stated in place of an effect of the noise"""
QUIET = 0.3
"""probability of none from which nothing is named"""
MIMIC = 3.0
"""detectability at which every unlisted cause looks like some effect of the catalogue; of unlisted
causes at detectability d about ``MIMIC / d`` do, as their noise-free residuals show"""
MISTAKEN = 0.057
"""share of what looks like nothing in the catalogue by its mean that is in it after all, in another
form or with a second effect: 17 of 299 campaigns of eight sealed blind checks that the evidences
called unlisted with more than 0.9"""
MISTAKEN_BY_SAMPLES = 0.5
"""the same of what single samples tell: a line or an event is often the noise of the place.  135 of
234 such campaigns had no unlisted cause, 71 of 159 without the one law of noise in each check that
raised most of these alarms; how common such noise is elsewhere, nobody knows"""
AKIN = 0.45
"""share of the unlisted causes stated as a family that act nearly as one of its members do: 45 of
101 in five sealed blind checks"""
OTHER_CAUSE = 0.125
"""share of what may be an effect in another form that is an unlisted cause which acts nearly as the
effect does: by the priors, taking it that three times as many of the listed causes leave as
little"""
LEAST = 1e-4
"""probability of an explanation below which it does not matter what it may be instead"""
FAINT = 2.0
"""detectability below which an effect that is there leaves nothing to be seen"""
LIKELIER = 0.5
"""probability of looking unlisted from which that is stated, unless none or a family is likelier
than what is left of it once the share that only looks so is given back"""
ELSEWHERE = 25.0
"""drop of the squared residual, where a finding is not, from which an effect does not live by it"""
MOSTLY_ELSEWHERE = 0.8
"""share of its whole drop that this makes up at least"""
GATE = 4.0
"""standard deviations of misfit left under an effect or a family that would be stated from which it
is unlisted after all: of 392 families stated in three sealed blind checks three leave as much, all
of causes that are not in the catalogue"""


@dataclass(frozen=True)
class Verdict:
    """What explains the gap."""

    kind: str
    """``none``, ``effect``, ``family`` or ``unlisted``"""
    effects: tuple[str, ...]
    """the one or two named; the members of a family (at most five)"""
    family: str | None
    probability: float
    """that it holds: that nothing is there that could be seen; that the effect is there; that one
    of the family is, or something unlisted that acts nearly the same; that something unlisted is"""
    sentence: str


class Judgement(NamedTuple):
    """A :class:`Verdict` before it is put in words."""

    kind: str
    effects: tuple[str, ...]
    family: str | None
    probability: float


@dataclass(frozen=True)
class Probabilities:
    """Probabilities that the verdict rests on, effects of the noise included."""

    rows: dict[str, float]
    """``none``, ``unlisted``, effects, ``a+b``: sums to 1"""
    effects: dict[str, float]
    """summed over every complete explanation that contains the effect"""
    families: dict[str, float]
    none: float
    unlisted: float
    looks_unlisted: float
    """the last, before the share of what only looks so is given back"""
    looks_by_mean: float
    """the same by the mean alone, without what single samples tell"""
    faint: float
    """an effect on the mean is there, but too small to be seen"""

    @property
    def nothing_seen(self) -> float:
        """Probability of no effect, or of one that is too small to be seen."""
        return min(self.none + self.faint, 1.0)


def combine(
    comparison: Comparison, findings: Sequence[Finding], catalogue: Mapping[str, Effect]
) -> Probabilities:
    """Probabilities of all explanations of the mean and of the findings, which are independent.

    A line of unlisted origin (of a pump, a fan) does not move the mean, so it is no rival of an
    effect on the mean.  It counts beside the effect, and as the unlisted cause where there is no
    effect.  The same holds for a finding on plateaus beside an effect that is seen in other phases
    (:func:`leaves_explanation_alone`).
    """
    rows: dict[str, float] = {"none": 0.0, "unlisted": 0.0}
    rows.update({name: 0.0 for name in catalogue})
    on_noise = {f.name: f.probability for f in findings if f.name in catalogue}
    silent = float(np.prod([1.0 - p for p in on_noise.values()]))
    unlisted = [f for f in findings if not f.signal.listed]
    odds = {n: q / (1.0 - q + 1e-300) for n, q in on_noise.items()}
    total_odds = sum(odds.values())
    of_samples = 0.0
    unseen: dict[str, float] = {}
    alike = np.array([_look_alike(comparison, h) for h in comparison.hypotheses])
    shares = comparison.probabilities / (1.0 + float(comparison.probabilities @ alike))
    for h, p, other_cause in zip(comparison.hypotheses, shares, alike, strict=True):
        rows["unlisted"] += float(p * other_cause)
        form = simpler_explanation(h, comparison) if p > LEAST else None
        if form:
            rows["unlisted"] += float(p) * OTHER_CAUSE
            p *= 1.0 - OTHER_CAUSE
        elif h.incomplete:
            rows["unlisted"] += float(p)
            continue
        causes = form.effects if form else h.effects
        # with no effect, a finding counts as unlisted
        rivals = [
            f
            for f in unlisted
            if not (h.effects and leaves_explanation_alone(f, h.refit, comparison.base))
        ]
        taken = 1.0 - float(np.prod([1.0 - f.probability for f in rivals]))
        of_samples += float(p) * taken
        # what is taken by mistake stays where it was
        rest = float(p) * (1.0 - taken * (1.0 - MISTAKEN_BY_SAMPLES))
        name = "+".join(causes) or "none"
        rows[name] = rows.get(name, 0.0) + rest * silent
        unseen.setdefault(name, chance_too_small(h, comparison.base))
        # or some effect of the noise is there, each with its share
        loud = rest * (1.0 - silent)
        if loud > 0.0:
            for n, q in odds.items():
                joint = n if not causes else "+".join([*causes, n])
                rows[joint] = rows.get(joint, 0.0) + loud * q / total_odds
                unseen[joint] = unseen[name]
    best = comparison.likeliest
    looks_by_mean = rows["unlisted"]
    looks_unlisted = looks_by_mean + of_samples
    rows["unlisted"] += of_samples * (1.0 - MISTAKEN_BY_SAMPLES)
    rows = give_back_mistaken(rows, MISTAKEN * looks_by_mean, "+".join(best.effects) or "none")
    effects = dict.fromkeys(catalogue, 0.0)
    families: dict[str, float] = {}
    for name, p in rows.items():
        if name in ("none", "unlisted"):
            continue
        members = name.split("+")
        for n in members:
            effects[n] += p
        for f in {catalogue[n].family for n in members}:
            families[f] = families.get(f, 0.0) + p
    # an effect of the noise is there or not, whatever explains the mean
    for n, p in on_noise.items():
        effects[n] = max(effects[n], p)
        families[catalogue[n].family] = max(families.get(catalogue[n].family, 0.0), p)
    faint = sum(p * unseen.get(row, 0.0) for row, p in rows.items())
    return Probabilities(
        rows,
        effects,
        families,
        rows["none"],
        rows["unlisted"],
        looks_unlisted,
        looks_by_mean,
        faint,
    )


def chance_too_small(h: Hypothesis, base: Refit) -> float:
    """Probability that an effect, if it is there, has a detectability below ``FAINT``.

    What is found of it is what is there and one standard deviation of noise.
    """
    if not h.effects:
        return 0.0
    d = _detectability(h, base)
    return float(norm.cdf(FAINT - d) - norm.cdf(-FAINT - d))


def leaves_explanation_alone(found: Finding, fitted: Refit, base: Refit) -> bool:
    """Whether a finding of unlisted origin is compatible with an explanation of the mean.

    A fast line averages out of the bins, whatever the effect.  An event, or plateaus that are
    unsteady, may be what an effect is fitted to, unless the effect explains most of what it does in
    other phases or records.  A short stay off the explanation may be the effect's own, in a form
    that is not quite ours.
    """
    if found.beside_the_mean or within_form_mismatch(found, fitted, base):
        return True
    touched = _touched(found, base.coords.binned)
    if touched is None:
        return False
    gain = base.residual**2 - fitted.residual**2
    elsewhere = float(gain[~touched].sum())
    return elsewhere >= max(ELSEWHERE, MOSTLY_ELSEWHERE * float(gain.sum()))


def _touched(found: Finding, binned: BinnedCampaign) -> NDArray[np.bool_] | None:
    """(n_bins in all,) bins in the phases of a finding on quiet stretches; None for any other."""
    if found.signal.phase:
        return np.concatenate([b.phase == PHASES.index(found.signal.phase) for b in binned.bins])
    if not found.signal.on_quiet_stretches or not found.places:
        return None
    touched = [np.zeros(len(b.phase), dtype=bool) for b in binned.bins]
    for place in found.places:
        b = binned.bins[place.experiment]
        struck = b.phase[int(np.argmin(np.abs(b.centre - place.time)))]
        touched[place.experiment] |= b.phase == struck
    return np.concatenate(touched)


def _look_alike(comparison: Comparison, h: Hypothesis) -> float:
    """Odds of an unlisted cause with the same residual as this explanation.

    The clearer an effect is seen, the fewer other causes look the same.  An effect of a user's own
    is not charged: there is a reason for it.
    """
    own = any(part.form.mean is not None for part in h.refit.coords.parts)
    if h.incomplete or not h.effects or own:
        return 0.0
    d = max(_detectability(h, comparison.base), MIMIC)
    return PRIOR_UNLISTED / (1.0 - PRIOR_NONE - PRIOR_UNLISTED) * MIMIC / d


def _detectability(h: Hypothesis, base: Refit) -> float:
    """Root of the misfit that an explanation removes, in standard deviations of the noise."""
    return sqrt(max(base.misfit - h.refit.misfit, 0.0))


def give_back_mistaken(
    rows: Mapping[str, float], mistaken: float, likeliest: str
) -> dict[str, float]:
    """``mistaken`` of what is unlisted goes to all others, or to ``likeliest`` where they are 0."""
    rest = sum(p for name, p in rows.items() if name != "unlisted")
    # a ratio of two tiny probabilities is exact, where one over a tiny sum overflows
    made = {name: p + mistaken * (p / rest) if rest > 0.0 else p for name, p in rows.items()}
    made["unlisted"] = rows["unlisted"] - mistaken
    if rest <= 0.0:
        made[likeliest] = mistaken
    return made


def judge(
    comparison: Comparison, combined: Probabilities, catalogue: Mapping[str, Effect]
) -> Judgement:
    """None, one or two effects, a family, or something unlisted."""
    by_effects = (h for h in comparison.complete if h.effects)
    best = max(by_effects, key=lambda h: h.log_weight, default=None)
    named = sorted(
        (n for n, p in combined.effects.items() if p > NAMED), key=lambda n: -combined.effects[n]
    )
    on_mean = [n for n in named if catalogue[n].on_mean]
    on_noise = [n for n in named if not catalogue[n].on_mean]
    of_mean = {
        f: p for f, p in combined.families.items()
        if any(e.family == f and e.on_mean for e in catalogue.values())
    }  # fmt: skip
    family, of_family = max(of_mean.items(), key=lambda item: item[1], default=("", 0.0))
    # with what only looks so given back it must still be the likeliest
    likeliest = combined.unlisted >= max(combined.none, of_family)
    likely = of_family > max(0.5, combined.unlisted)
    unfit = bool(on_mean or likely) and best is not None and leaves_excess(best, comparison.base)
    if (combined.looks_unlisted > LIKELIER and likeliest) or unfit:
        return Judgement("unlisted", (), None, max(combined.unlisted, 0.5 if unfit else 0.0))
    unmoved = sum(p for row, p in combined.rows.items() if _leaves_the_mean_alone(row, catalogue))
    louder = of_family > LOUDER or (likely and unmoved < QUIET)
    apart = [n for n in on_mean if not catalogue[n].same_response]
    if on_mean and not apart:
        # one response: whichever is in the catalogue, the other may be the cause
        return _family(catalogue[on_mean[0]].family, combined, catalogue)
    if best and of_one_family(best, catalogue) and set(on_mean) & set(best.effects):
        # two members together are a third in another form as often as they are both there
        return _family(catalogue[best.effects[0]].family, combined, catalogue)
    if apart or (on_noise and not louder):
        # an effect of the noise is named alone only where nothing more is likely in the mean
        return _effect([*apart, *on_noise], combined, catalogue)
    if combined.none > QUIET:
        return Judgement("none", (), None, combined.nothing_seen)
    if likely:
        return _family(family, combined, catalogue)
    clearest, of_clearest = max(combined.families.items(), key=lambda f: f[1], default=("", 0.0))
    if of_clearest > max(0.5, combined.unlisted):  # of the noise, and too faint to be named
        return _family(clearest, combined, catalogue)
    if max(combined.none, unmoved) >= combined.unlisted:
        return Judgement("none", (), None, combined.nothing_seen)
    if of_family > combined.unlisted:  # the likeliest of several
        return _family(family, combined, catalogue)
    return Judgement("unlisted", (), None, combined.unlisted)


def leaves_excess(h: Hypothesis, base: Refit) -> bool:
    """Whether what an explanation leaves is too much for noise, and for the form of its effects."""
    return h.leftover >= GATE and not small_enough(h.excess, base.misfit - h.refit.misfit)


def of_one_family(h: Hypothesis, catalogue: Mapping[str, Effect]) -> bool:
    """Whether two effects of one family explain the mean together."""
    return len(h.effects) > 1 and len({catalogue[name].family for name in h.effects}) == 1


def _leaves_the_mean_alone(row: str, catalogue: Mapping[str, Effect]) -> bool:
    return row == "none" or (
        row != "unlisted" and not any(catalogue[name].on_mean for name in row.split("+"))
    )


def _family(family: str, combined: Probabilities, catalogue: Mapping[str, Effect]) -> Judgement:
    members = sorted(
        (n for n in catalogue if catalogue[n].family == family), key=lambda n: -combined.effects[n]
    )
    probability = combined.families[family]
    if any(catalogue[n].on_mean for n in members):
        probability += AKIN * combined.unlisted
    return Judgement("family", tuple(members[:5]), family, min(probability, 1.0))


def _effect(
    named: Sequence[str], combined: Probabilities, catalogue: Mapping[str, Effect]
) -> Judgement:
    chosen = tuple(named[:2])
    families = {catalogue[n].family for n in chosen}
    family = families.pop() if len(families) == 1 else None
    return Judgement("effect", chosen, family, min(combined.effects[n] for n in chosen))


def explanation_of(
    comparison: Comparison,
    judgement: Judgement,
    combined: Probabilities,
    catalogue: Mapping[str, Effect],
) -> Hypothesis:
    """The explanation that the verdict stands for; for unlisted the best effect, if any."""
    kind, named = judgement.kind, judgement.effects
    on_mean = {n for n in named if catalogue[n].on_mean}
    complete = comparison.complete
    if kind == "effect":
        # one that shares its response is there beside them, but is not named
        on_mean |= {
            n for n in catalogue if catalogue[n].same_response and combined.effects[n] > NAMED
        }
        fitting = [h for h in complete if set(h.effects) == on_mean]
        fitting = fitting or [h for h in complete if on_mean <= set(h.effects)]
        fitting = fitting or [h for h in complete if set(h.effects) & on_mean]
    elif kind == "family":
        fitting = [h for h in complete if h.effects and set(h.effects) <= on_mean]
    elif kind == "none":
        fitting = []
    else:
        fitting = complete
    if not fitting:  # what was named acts on the noise: the mean is the model's own
        fitting = [h for h in complete if not h.effects]
    return max(fitting, key=lambda h: h.log_weight)
