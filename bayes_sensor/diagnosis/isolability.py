"""Which effects this campaign cannot tell apart, and which measurement would.

The isolability of a pair is the detectability that is left when the one's noise-free mean is
refitted with the other; below three the pair is confusable.  It is computed anew with something
known or measured in addition.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from bayes_sensor.campaign import FloatArray
from bayes_sensor.diagnosis.data.binned_campaign import Sketch
from bayes_sensor.diagnosis.effects.effect import Effect
from bayes_sensor.diagnosis.evidence.hypotheses import fit_effect
from bayes_sensor.diagnosis.evidence.refit import Refit, refit
from bayes_sensor.diagnosis.evidence.refit_coordinates import Part, Plan

ISOLATED = 3.0
"""isolability from which a pair is told apart"""
FLOW_FACTORS = (0.4, 2.5)
"""the second flow that is tried, over each experiment's own"""


@dataclass(frozen=True)
class Separation:
    """A pair that this campaign confuses, and the addition that helps most."""

    effect: str
    rival: str
    isolability: float
    addition: str
    """in words; empty where nothing that was tried separates the two"""
    isolability_with_it: float


def isolability(sketch: Sketch, truth: Refit, rival: Effect, given: Sequence[Part] = ()) -> float:
    """Detectability left when ``truth``'s noise-free mean is refitted with ``rival``."""
    data = tuple(truth.plan.means(truth.x))
    # priors lie where the truth is, or its own distance from them would count against every rival
    exact = replace(sketch, data=data, centre=np.log([*truth.lags, truth.V]))
    base = refit(
        Plan(exact, tuple(given), loose=truth.plan.loose), _bare(truth, len(given)), most_steps=15
    )
    best = min(
        fit_effect(exact, base, [Part(rival, form)], form.starts[:2], 12).misfit
        for form in rival.forms[:2]
    )
    return float(np.sqrt(max(best, 0.0)))


def _bare(fitted: Refit, n_parts: int) -> FloatArray:
    # coordinates of the same optimum without the parts after the first n_parts
    plan = fitted.plan
    smaller = replace(plan, parts=plan.parts[:n_parts])
    x = np.zeros(smaller.size)
    first = 3 + len(smaller.shared)
    x[:first] = fitted.x[:first]
    for k, e in enumerate(plan.sketch.campaign):
        m = 4 if e.has_fall else 3
        n = m + len(smaller.own)
        x[smaller.local[k] : smaller.local[k] + n] = fitted.x[plan.local[k] : plan.local[k] + n]
    return x


def confusable(
    sketch: Sketch,
    truth: Refit,
    name: str,
    catalogue: Mapping[str, Effect],
    rivals: Sequence[str] | None = None,
) -> list[tuple[str, float]]:
    """Rivals of an effect with isolability below three, most alike first."""
    given = truth.plan.parts[:-1]
    made = []
    for other, effect in catalogue.items():
        if other == name or not effect.on_mean or (rivals is not None and other not in rivals):
            continue
        value = isolability(sketch, truth, effect, given)
        if value < ISOLATED:
            made.append((other, value))
    return sorted(made, key=lambda x: x[1])


def what_would_separate(
    sketch: Sketch, truth: Refit, name: str, rival: str, catalogue: Mapping[str, Effect]
) -> Separation:
    """The addition to the campaign that tells a confusable pair apart best."""
    effect = catalogue[rival]
    given = truth.plan.parts[:-1]
    now = isolability(sketch, truth, effect, given)
    tried = {
        "V measured to 1 %": _known_volume(sketch),
        "four times as many repeats": _repeated(sketch, 4),
        **{
            f"the same steps at {f:g} times the flow": _second_flow(sketch, f) for f in FLOW_FACTORS
        },
    }
    best, most = "", max(now * 1.2, ISOLATED)
    for words, other in tried.items():
        moved = _moved(truth, other)
        value = isolability(other, moved, effect, given)
        if value > most:
            best, most = words, value
    return Separation(name, rival, now, best, most if best else now)


def _known_volume(sketch: Sketch) -> Sketch:
    sd = sketch.sd.copy()
    sd[2] = min(sd[2], 0.01)
    return replace(sketch, sd=sd)


def _repeated(sketch: Sketch, n: int) -> Sketch:
    quieter = tuple(c / np.sqrt(n) for c in sketch.floor.cholesky)
    return replace(sketch, floor=replace(sketch.floor, cholesky=quieter))


def _second_flow(sketch: Sketch, factor: float) -> Sketch:
    more = tuple(
        replace(
            e,
            name=f"{e.name} at {factor:g} Q",
            carrier_flow=e.carrier_flow * factor,
            test_gas_flow=e.test_gas_flow * factor,
        )
        for e in sketch.campaign
    )
    return replace(
        sketch,
        campaign=replace(sketch.campaign, experiments=(*sketch.campaign.experiments, *more)),
        bins=sketch.bins * 2,
        data=sketch.data * 2,
        base=np.concatenate([sketch.base, sketch.base[3:]]),
        floor=replace(
            sketch.floor,
            cholesky=sketch.floor.cholesky * 2,
            density=np.concatenate([sketch.floor.density] * 2),
            loudness=sketch.floor.loudness * 2,
        ),
    )


def _moved(truth: Refit, sketch: Sketch) -> Refit:
    """The same truth in another sketch: added experiments have the local values of the first."""
    plan = replace(truth.plan, sketch=sketch)
    n_old = len(truth.plan.sketch.bins)
    x = np.zeros(plan.size)
    x[: plan.local[0]] = truth.x[: plan.local[0]]
    for k in range(len(sketch.bins)):
        j = k % n_old
        a, b = truth.plan.local[j], truth.plan.local[j + 1]
        x[plan.local[k] : plan.local[k] + b - a] = truth.x[a:b]
    return replace(truth, plan=plan, x=x)
