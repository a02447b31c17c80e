"""The shape error of an effect: what a listed effect leaves because its form is not exact.

A real effect differs from the catalogue's form by a share of its own size.  At a high
signal-to-noise ratio this shape error is visible, too, and a second effect or an unlisted cause
would explain it.  A leftover therefore counts as another cause only above the largest share that
the form of an effect has been seen to leave.
"""

from __future__ import annotations

from dataclasses import dataclass
from math import sqrt

import numpy as np
from numpy.typing import NDArray

from bayes_sensor.diagnosis.closed_fraction import VISIBLE
from bayes_sensor.diagnosis.data.binned_campaign import BinnedCampaign
from bayes_sensor.diagnosis.data.bins import PHASES
from bayes_sensor.diagnosis.evidence.compared_hypotheses import Comparison, Hypothesis
from bayes_sensor.diagnosis.evidence.laplace_evidence import Linearised
from bayes_sensor.diagnosis.evidence.refit import Refit
from bayes_sensor.diagnosis.signals.signal import FOUND, Finding

OTHER_FORM = 0.2
"""share of an effect's size that its form may leave: by the law of how far
(:data:`~bayes_sensor.diagnosis.closure.INEXACT`) 98 of 100 leave less"""
GATE = 4.0
"""standard deviations of misfit left under listed effects from which something else is there: one
of 30 000 campaigns leaves as much by chance, and the floor's own error does not reach it"""
ELSEWHERE = 0.8
"""share of the misfit that an effect removes, in phases and records without the finding, from which
it does not live by the finding"""


@dataclass(frozen=True)
class SimplerExplanation:
    """An explanation by fewer causes whose form is not exact."""

    effects: tuple[str, ...]
    """those that need no other form"""
    left: float
    """size of what these leave, as a share of the whole's"""


def small_enough(left: float, whole: float) -> bool:
    """Whether a shape error may be so large a part of the whole; both as squared misfits."""
    return left < OTHER_FORM**2 * whole


def simpler_explanation(h: Hypothesis, comparison: Comparison) -> SimplerExplanation | None:
    """Fewer effects, or the same ones without a discrepancy, whose form is not exact.

    None where an explanation has nothing beside an effect, where that is not seen, or where it is
    too much for the effect's form.
    """
    if not h.effects:
        return None
    least = h.refit.misfit - (taken_beside(h) if h.incomplete else 0.0)
    whole = comparison.base.misfit - least
    simpler = [comparison.find(name) for name in h.effects]
    if h.incomplete and len(h.effects) > 1:
        simpler.append(h)
    for one in sorted(simpler, key=lambda one: (len(one.effects), one.refit.misfit)):
        left = one.refit.misfit - least
        if left > VISIBLE**2 and small_enough(left, whole):
            return SimplerExplanation(one.effects, sqrt(left / whole))
    return None


def within_form_mismatch(found: Finding, fitted: Refit, base: Refit) -> bool:
    """Whether a finding in the residual mean is small enough to be the effect's shape error.

    A finding that is improbable takes little from any explanation and is not excused.
    """
    if not found.signal.of_the_mean or found.d is None or found.probability < FOUND:
        return False
    return small_enough(found.d**2, base.misfit - fitted.misfit)


def taken_beside(h: Hypothesis) -> float:
    """By how much the discrepancy beside the effects, or alone, lessens the misfit."""
    taken = 0.0
    for term in h.terms:
        if term.beside is None:
            continue
        left = Linearised(term.refit).left(term.beside)
        taken += term.share * (term.refit.misfit - float(left @ left))
    return taken


def leaves_excess(h: Hypothesis, base: Refit) -> bool:
    """Whether what an explanation leaves is too much for noise, and for the form of its effects."""
    return h.leftover >= GATE and not small_enough(h.excess, base.misfit - h.refit.misfit)


def leaves_explanation_alone(found: Finding, fitted: Refit, base: Refit) -> bool:
    """Whether a finding of unlisted origin is compatible with an explanation of the mean.

    A fast line averages out of the bins, whatever the effect.  An event, or plateaus that are
    unsteady, may be what an effect is fitted to, unless the effect is seen elsewhere, and explains
    most of what it does there.  A short stay off the explanation may be the effect's own, in a form
    that is not quite ours.
    """
    if found.beside_the_mean or within_form_mismatch(found, fitted, base):
        return True
    touched = _touched(found, base.coords.binned)
    if touched is None:
        return False
    gain = base.residual**2 - fitted.residual**2
    elsewhere = float(gain[~touched].sum())
    return elsewhere >= max(VISIBLE**2, ELSEWHERE * float(gain.sum()))


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
