"""From probabilities to a verdict: three rules on the one vector.

1. The likeliest row of the vector is named if each of its effects has a probability above
   :data:`NAMED`, unless other effects give the same response.
2. Otherwise the likeliest of these is stated: nothing moves the mean, a family, an unlisted cause.
3. Nothing is called unlisted if noise alone often leaves as much (:data:`OFTEN`).
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, NamedTuple

from bayes_sensor.diagnosis.evidence.compared_hypotheses import Comparison, Hypothesis
from bayes_sensor.diagnosis.probabilities import Probabilities

NAMED = 0.9
"""probability from which an effect is named: one wrong name in ten at most, if the probabilities
are right"""
NAMED_ELSEWHERE = 0.95
"""the same on other rigs and programmes than the calibration map was fitted to"""
OFTEN = 0.2
"""p-value of the excess above which nothing is called unlisted: one in five campaigns without any
cause leaves as much"""
MOST = 5
"""members of a family that are listed"""


@dataclass(frozen=True)
class Verdict:
    """What explains the gap."""

    kind: str
    """``none``, ``effect``, ``family`` or ``unlisted``"""
    effects: tuple[str, ...]
    """the one or two named; the members of a family (at most five)"""
    family: str | None
    probability: float
    """of the row of that name (none, unlisted, the effects named), or of the family"""
    sentence: str
    sets_in: tuple[dict[str, Any], ...] = ()
    """``experiment``, ``phase`` and ``time_s`` where an effect with a time of its own begins"""


class Judgement(NamedTuple):
    """A :class:`Verdict` before it is put in words."""

    kind: str
    effects: tuple[str, ...]
    family: str | None
    probability: float


def judge(probabilities: Probabilities, p_value: float, least: float = NAMED) -> Judgement:
    """None, one or two effects, a family, or something unlisted; ``p_value`` of the excess.

    ``least``: probability from which an effect is named.
    """
    catalogue, rows = probabilities.catalogue, probabilities.rows
    named = max(rows, key=lambda row: rows[row])
    effects = Probabilities.members(named)
    sure = min((_chance(n, probabilities) for n in effects), default=0.0) > least
    if sure and _nameable(effects, probabilities):
        families = {catalogue[n].family for n in effects}
        family = families.pop() if len(families) == 1 else None
        return Judgement("effect", effects, family, rows[named])
    on_mean = {e.family for e in catalogue.values() if e.on_mean}
    families_of_mean = {f: p for f, p in probabilities.families.items() if f in on_mean}
    family, of_family = max(families_of_mean.items(), key=lambda f: f[1], default=("", 0.0))
    unlisted = probabilities.unlisted if p_value <= OFTEN else -1.0
    if unlisted > max(of_family, probabilities.unmoved):
        return Judgement("unlisted", (), None, probabilities.unlisted)
    if of_family > probabilities.unmoved:
        return _family(family, probabilities)
    of_noise = {f: p for f, p in probabilities.families.items() if f not in on_mean}
    family, of_family = max(of_noise.items(), key=lambda f: f[1], default=("", 0.0))
    if of_family > probabilities.none:
        return _family(family, probabilities)
    return Judgement("none", (), None, probabilities.none)


def _chance(name: str, probabilities: Probabilities) -> float:
    """Probability that an effect is there; of one of the noise among the rows that tell of it.

    An unlisted cause of the mean says nothing about the noise.
    """
    p = probabilities.effects[name]
    if probabilities.catalogue[name].on_mean:
        return p
    return p / max(1.0 - probabilities.unlisted, 1e-300)


def _nameable(effects: tuple[str, ...], probabilities: Probabilities) -> bool:
    """Whether effects can be told from others by their nature.

    Two that share one response cannot, whichever of them is in the catalogue; and two members of
    one family together are a third in another form as often as they are both there.
    """
    catalogue = probabilities.catalogue
    if any(catalogue[n].same_response for n in effects):
        return False
    on_mean = [catalogue[n].family for n in effects if catalogue[n].on_mean]
    return len(on_mean) == len(set(on_mean)) and len(effects) <= 2


def _family(family: str, probabilities: Probabilities) -> Judgement:
    catalogue, effects = probabilities.catalogue, probabilities.effects
    members = sorted((n for n in catalogue if catalogue[n].family == family),
                     key=lambda n: -effects[n])  # fmt: skip
    return Judgement("family", tuple(members[:MOST]), family, probabilities.families[family])


def explanation_of(comparison: Comparison, judgement: Judgement) -> Hypothesis:
    """The explanation that the verdict stands for; for unlisted the best effect, if any."""
    kind, catalogue = judgement.kind, comparison.catalogue
    on_mean = {n for n in judgement.effects if catalogue[n].on_mean}
    complete = comparison.complete
    fitting: list[Hypothesis] = []
    if kind == "effect":
        fitting = [h for h in complete if set(h.effects) == on_mean]
        fitting = fitting or [h for h in complete if set(h.effects) & on_mean]
    elif kind == "family":
        fitting = [h for h in complete if h.effects and set(h.effects) & on_mean]
    elif kind == "unlisted":
        fitting = complete
    if not fitting:  # what was named acts on the noise: the mean is the model's own
        fitting = [h for h in complete if not h.effects]
    return max(fitting, key=lambda h: h.log_weight)


def of_one_family(h: Hypothesis, catalogue: Mapping[str, Any]) -> bool:
    """Whether two effects of one family explain the mean together."""
    return len(h.effects) > 1 and len({catalogue[name].family for name in h.effects}) == 1
