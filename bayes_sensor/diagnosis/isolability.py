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
from bayes_sensor.diagnosis.data.binned_campaign import BinnedCampaign
from bayes_sensor.diagnosis.effects.effect import Effect
from bayes_sensor.diagnosis.evidence.chain_coordinates import coordinates_of
from bayes_sensor.diagnosis.evidence.compared_hypotheses import Comparison
from bayes_sensor.diagnosis.evidence.coordinate_priors import Part
from bayes_sensor.diagnosis.evidence.hypotheses import fit_effect
from bayes_sensor.diagnosis.evidence.refit import Refit, refit
from bayes_sensor.diagnosis.probabilities import Probabilities
from bayes_sensor.diagnosis.verdict import Judgement

LIKELY = 0.02
"""probability from which an effect's look-alikes are listed"""
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


def isolability(
    binned: BinnedCampaign, truth: Refit, rival: Effect, given: Sequence[Part] = ()
) -> float:
    """Detectability left when ``truth``'s noise-free mean is refitted with ``rival``."""
    data = tuple(truth.coords.means(truth.x))
    # priors lie where the truth is, or its own distance from them would count against every rival
    exact = replace(binned, data=data, centre=truth.coords.logarithms(truth.x))
    base = refit(
        coordinates_of(exact, tuple(given), loose=truth.coords.loose),
        without_parts(truth, len(given)),
        most_steps=15,
    )
    best = min(
        fit_effect(exact, base, [Part(rival, form)], form.starts[:2], 12).misfit
        for form in rival.forms[:2]
    )
    return float(np.sqrt(max(best, 0.0)))


def without_parts(fitted: Refit, n_parts: int) -> FloatArray:
    """Coordinates of the same optimum without the parts after the first ``n_parts``."""
    coords = fitted.coords
    smaller = replace(coords, parts=coords.parts[:n_parts])
    x = np.zeros(smaller.size)
    first = smaller.first_strength + len(smaller.shared)
    x[:first] = fitted.x[:first]
    for k, m in enumerate(coords.binned.own_sizes):
        n = m + len(smaller.own)
        x[smaller.local[k] : smaller.local[k] + n] = fitted.x[coords.local[k] : coords.local[k] + n]
    return x


def look_alikes(
    comparison: Comparison, probabilities: Probabilities, catalogue: Mapping[str, Effect]
) -> dict[str, list[str]]:
    """Rivals that this campaign confuses with each of the likeliest effects, most alike first."""
    ranked = sorted(probabilities.effects, key=lambda n: -probabilities.effects[n])
    likely = [n for n in ranked if catalogue[n].on_mean and probabilities.effects[n] > LIKELY]
    return {
        name: [
            rival
            for rival, _ in confusable(
                comparison.binned, comparison.find(name).refit, name, catalogue
            )
        ]
        for name in likely[:3]
    }


def separate_pairs(
    comparison: Comparison, judgement: Judgement, alike: Mapping[str, Sequence[str]]
) -> list[Separation]:
    """The additions that separate the first effect of a verdict from those most like it.

    ``alike``: of :func:`look_alikes`.
    """
    catalogue, binned = comparison.catalogue, comparison.binned
    first = next((n for n in judgement.effects if catalogue[n].on_mean), None)
    if judgement.kind not in ("family", "effect") or first is None or first not in alike:
        return []
    rivals = list(alike[first])
    if not binned.order_known:  # no measurement of the response tells whose the lag is
        rivals = [n for n in rivals if n != catalogue[first].exchanged]
    truth = comparison.find(first).refit
    # nothing tells what is one response apart: the next in likeness is worth a look, too
    most = 2 if rivals[:1] == [catalogue[first].same_response] else 1
    return [what_would_separate(binned, truth, first, n, catalogue) for n in rivals[:most]]


def confusable(
    binned: BinnedCampaign,
    truth: Refit,
    name: str,
    catalogue: Mapping[str, Effect],
    rivals: Sequence[str] | None = None,
) -> list[tuple[str, float]]:
    """Rivals of an effect with isolability below three, most alike first."""
    given = truth.coords.parts[:-1]
    made = []
    for other, effect in catalogue.items():
        if other == name or not effect.on_mean or (rivals is not None and other not in rivals):
            continue
        value = isolability(binned, truth, effect, given)
        if value < ISOLATED:
            made.append((other, value))
    return sorted(made, key=lambda x: x[1])


def what_would_separate(
    binned: BinnedCampaign, truth: Refit, name: str, rival: str, catalogue: Mapping[str, Effect]
) -> Separation:
    """The addition to the campaign that tells a confusable pair apart best."""
    effect = catalogue[rival]
    given = truth.coords.parts[:-1]
    now = isolability(binned, truth, effect, given)
    tried = {"four times as many repeats": _repeated(binned, 4)}
    if binned.chain is None:
        tried = {"V measured to 1 %": _known_volume(binned), **tried}
    if binned.chain is None and binned.campaign.same_flow:
        tried |= {
            f"the same steps at {f:g} times the flow": _second_flow(binned, f) for f in FLOW_FACTORS
        }
    best, most = "", max(now * 1.2, ISOLATED)
    for words, other in tried.items():
        moved = _moved(truth, other)
        value = isolability(other, moved, effect, given)
        if value > most:
            best, most = words, value
    return Separation(name, rival, now, best, most if best else now)


def _known_volume(binned: BinnedCampaign) -> BinnedCampaign:
    sd = binned.sd.copy()
    sd[2] = min(sd[2], 0.01)
    return replace(binned, sd=sd)


def _repeated(binned: BinnedCampaign, n: int) -> BinnedCampaign:
    quieter = tuple(c / np.sqrt(n) for c in binned.floor.cholesky)
    return replace(binned, floor=replace(binned.floor, cholesky=quieter))


def _second_flow(binned: BinnedCampaign, factor: float) -> BinnedCampaign:
    more = tuple(
        replace(e.with_flow(factor), name=f"{e.name} at {factor:g} Q") for e in binned.campaign
    )
    return replace(
        binned,
        campaign=replace(binned.campaign, experiments=(*binned.campaign.experiments, *more)),
        bins=binned.bins * 2,
        data=binned.data * 2,
        base=np.concatenate([binned.base, binned.base[3:]]),
        floor=replace(
            binned.floor,
            cholesky=binned.floor.cholesky * 2,
            density=np.concatenate([binned.floor.density] * 2),
            loudness=binned.floor.loudness * 2,
        ),
    )


def _moved(truth: Refit, binned: BinnedCampaign) -> Refit:
    """The same truth in another campaign: added experiments have the local values of the first."""
    coords = replace(truth.coords, binned=binned)
    n_old = len(truth.coords.binned.bins)
    x = np.zeros(coords.size)
    x[: coords.local[0]] = truth.x[: coords.local[0]]
    for k in range(len(binned.bins)):
        j = k % n_old
        a, b = truth.coords.local[j], truth.coords.local[j + 1]
        x[coords.local[k] : coords.local[k] + b - a] = truth.x[a:b]
    return replace(truth, coords=coords, x=x)
