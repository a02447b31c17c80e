"""Effects in a form that is not quite the catalogue's.

Nature's effects are a little other than ours, by a share of their size that does not depend on how
well they are seen.  Once an effect is seen far above the noise so is that, and two effects together
explain it, or an effect and something else: a cause that is not there, stated with confidence.
What an effect leaves of itself counts for another cause only from a share on that no effect's form
has been seen to leave.
"""

from __future__ import annotations

from dataclasses import dataclass
from math import sqrt

from bayes_sensor.diagnosis.closure import VISIBLE
from bayes_sensor.diagnosis.evidence.hypotheses import Hypothesis, Weighing
from bayes_sensor.diagnosis.evidence.laplace_evidence import Linearised
from bayes_sensor.diagnosis.evidence.refit import Refit
from bayes_sensor.diagnosis.signals.tails_and_converter import FOUND, FullRate

OTHER_FORM = 0.2
"""share of an effect's size that its form may leave: by the law of how far
(:data:`~bayes_sensor.diagnosis.closure.INEXACT`) 98 of 100 leave less"""
OFF_FOR_A_WHILE = ("patch", "break")
"""findings in what an explanation leaves of the mean"""


@dataclass(frozen=True)
class AnotherForm:
    """What an explanation may be instead."""

    effects: tuple[str, ...]
    """those that need no other form"""
    left: float
    """size of what these leave, as a share of the whole's"""


def small_enough(left: float, whole: float) -> bool:
    """Whether a form may leave so much of what is explained; both as squared misfits."""
    return left < OTHER_FORM**2 * whole


def another_form(h: Hypothesis, weighing: Weighing) -> AnotherForm | None:
    """Fewer effects, or the same without something else beside them, in a form of their own.

    None where an explanation has nothing beside an effect, where that is not seen, or where it is
    too much for the effect's form.
    """
    if not h.effects:
        return None
    least = h.refit.misfit - (_taken_beside(h) if h.incomplete else 0.0)
    whole = weighing.base.misfit - least
    simpler = [weighing.find(name) for name in h.effects]
    if h.incomplete and len(h.effects) > 1:
        simpler.append(h)
    for one in sorted(simpler, key=lambda one: (len(one.effects), one.refit.misfit)):
        left = one.refit.misfit - least
        if left > VISIBLE**2 and small_enough(left, whole):
            return AnotherForm(one.effects, sqrt(left / whole))
    return None


def of_its_form(found: FullRate, fitted: Refit, base: Refit) -> bool:
    """Whether a finding in what is left is small enough for what an effect's form may leave.

    What is hardly there takes little from any explanation, and is left to.
    """
    if found.name not in OFF_FOR_A_WHILE or found.d is None or found.probability < FOUND:
        return False
    return small_enough(found.d**2, base.misfit - fitted.misfit)


def _taken_beside(h: Hypothesis) -> float:
    """By how much what is beside the effects lessens the misfit."""
    taken = 0.0
    for term in h.terms:
        left = Linearised(term.refit).left(term.beside)
        taken += term.share * (term.refit.misfit - float(left @ left))
    return taken
