"""Which effect: the evidence of none, of every effect, of a discrepancy, and of both together.

Priors are given to families first, then to members, so that look-alikes do not gain by their
number.  A smooth discrepancy stands for an unlisted cause; an effect with a discrepancy beside it
says that the effect does not explain all.  Pairs are tried within families, too: where two members
are nearly the same effect, the second gains nothing and its freedom counts against the pair.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from math import log
from typing import NamedTuple

import numpy as np
from scipy.special import logsumexp

from bayes_sensor.campaign import FloatArray
from bayes_sensor.diagnosis.data.binned_campaign import BinnedCampaign
from bayes_sensor.diagnosis.effects.effect import Effect
from bayes_sensor.diagnosis.effects.effects_of_rig import Possible
from bayes_sensor.diagnosis.evidence.block_least_squares import solved
from bayes_sensor.diagnosis.evidence.compared_hypotheses import (
    LEFT,
    Comparison,
    Hypothesis,
    Term,
    something_left,
)
from bayes_sensor.diagnosis.evidence.coordinate_priors import FASTER, Part
from bayes_sensor.diagnosis.evidence.discrepancy import Discrepancy, make_discrepancies
from bayes_sensor.diagnosis.evidence.laplace_evidence import Linearised
from bayes_sensor.diagnosis.evidence.refit import Refit, refit
from bayes_sensor.diagnosis.evidence.refit_coordinates import Coordinates
from bayes_sensor.diagnosis.evidence.tau_profile import SEEN, has_jump, profile_tau
from bayes_sensor.diagnosis.evidence.varying_parameter import WEIGHT, embedded_rivals

PRIOR_NONE = 0.5
PRIOR_UNLISTED = 0.15
INCOMPLETE = 0.15
"""prior share of an effect's probability for "it is there, and something else with it" """
UNUSUAL = 1.2
"""distance of the shorter lag's logarithm from its plausible value from which fits also start at
that value, and as far below it: the faster optimum of an effect that slows the rise is not reached
from elsewhere"""
BENT = 3.0
"""prior sd that ln V of a fit may be from its plausible value before fits start there, too"""
MOST_FOLLOWED = 3
"""times the search for a pair follows the best one found"""
MOST_PROMISING = 3
"""starts of a grid that are followed"""
ABSORBED = 1e-3
"""share of a start's signature that the refit without it must leave, for it to be followed"""
MOST_FURTHER = 60
"""further steps of a refit that had not converged"""
LITTLE = 3.0
"""ln of evidence that pairs with the best single effect gain at least where there is a second"""
HOPELESS = 0.2
"""share of what something else explains better that a first pair must explain"""
NEAR = 14.0
"""log evidences this far below the best are not looked at more closely"""
SMALL_SHARE = 0.02
"""of a form in its effect, whose tau is not looked at more closely"""
MOST_TERMS = 6
"""of a hypothesis that are kept, the likeliest; their shares are those among them"""

Progress = Callable[[float, str], None]


def family_priors(catalogue: Mapping[str, Effect]) -> dict[str, float]:
    """ln prior of every effect on the mean: families first, then members."""
    members: dict[str, list[str]] = {}
    for name, effect in catalogue.items():
        if effect.on_mean:
            members.setdefault(effect.family, []).append(name)
    rest = 1.0 - PRIOR_NONE - PRIOR_UNLISTED
    return {
        name: float(np.log(rest / len(members) / len(names)))
        for names in members.values()
        for name in names
    }


def fit_effect(
    binned: BinnedCampaign,
    base: Refit,
    parts: Sequence[Part],
    starts: Sequence[Mapping[str, float]],
    most_steps: int = 30,
    enough: float = np.inf,
    faster: bool = True,
) -> Refit:
    """The best refit of the base's parts and further ones, over the starts of the last part.

    ``enough``: objective above which it does not matter how good it is.  ``faster``: whether to
    begin from a faster sensor than usual, too, where the base has a much slower or faster one.
    """
    coords = replace(base.coords, parts=(*base.coords.parts, *parts))
    begun = coords.start_from(base.coords, base.x)
    starts = [*starts, *most_promising_starts(coords, begun, base, parts[-1].form.grid)]
    begins = [coords.with_strengths(begun, start) for start in starts]
    found: list[Refit] = []
    if not coords.n_ordered:
        begins += [coords.with_strengths(x, starts[0]) for x in coords.other_starts(begun)[1:]]
        found = []
        for x in begins:
            found.append(refit(coords, x, most_steps=most_steps, known=found, enough=enough))
        return to_convergence(min(found, key=lambda r: r.objective), enough)
    usual = float(binned.centre[0])
    now = float(begun[1]) - FASTER - float(begun[0])
    if abs(now - usual) >= UNUSUAL and not base.coords.parts:
        # the fit without the effect may have bent tau far away to do the effect's work
        begins += [coords.with_strengths(coords.with_tau(begun, usual), start) for start in starts]
        if faster:
            begins.append(coords.with_strengths(coords.with_tau(begun, usual - UNUSUAL), starts[0]))
    if abs(begun[2] - binned.centre[2]) > BENT * binned.sd[2] and not base.coords.parts:
        # or the volume, where no flow makes any difference: valve and manifold share the lag
        moved = begun.copy()
        moved[1:3] = binned.centre[1] - log(2.0), binned.centre[2]
        begins += [coords.with_strengths(coords.with_tau(moved, usual), start) for start in starts]
    found = []
    for x in begins:
        found.append(refit(coords, x, most_steps=most_steps, known=found, enough=enough))
    best = to_convergence(min(found, key=lambda r: r.objective), enough)
    return profile_tau(best).best if best.objective <= enough and jump_is_seen(best, base) else best


def jump_is_seen(fitted: Refit, base: Refit) -> bool:
    """Whether the mean jumps with a switch, and that is well seen against the base."""
    # what the profile holds is the ratio of two lags
    if not fitted.coords.n_ordered:
        return False
    return has_jump(fitted) and fitted.objective < base.objective - SEEN


def most_promising_starts(
    coords: Coordinates, begun: FloatArray, base: Refit, grid: Sequence[Mapping[str, float]]
) -> list[Mapping[str, float]]:
    """Those of a grid of starts whose linearised gain is largest, each a peak among its neighbours.

    The gain is that of the effect's size alone, everything else refitted linearly; amplitudes
    begin at the size that gains it.
    """
    if not grid:
        return []
    normal = base.normal
    here = base.coords.all_means(base.x)
    amplitudes = {s.name for s in coords.strengths[-1] if s.scaled}
    gains, sizes = np.zeros(len(grid)), np.zeros(len(grid))
    for i, start in enumerate(grid):
        template = coords.signature(begun, here, start)
        inside = base.jacobian.T @ template
        whole = float(template @ template)
        left = whole - float(inside @ solved(normal, inside))
        if left > ABSORBED * whole:
            sizes[i] = float(template @ base.residual) / left
            gains[i] = sizes[i] ** 2 * left
    around = np.concatenate([[-np.inf], gains, [-np.inf]])
    peaks = np.flatnonzero((gains >= around[:-2]) & (gains >= around[2:]))
    return [
        {
            name: v * (sizes[i] if name.rstrip("*") in amplitudes else 1.0)
            for name, v in grid[i].items()
        }
        for i in peaks[np.argsort(-gains[peaks])][:MOST_PROMISING]
    ]


def to_convergence(fitted: Refit, enough: float = np.inf) -> Refit:
    """The refit carried on where it had not converged: an evidence is that of an optimum.

    Above the objective ``enough`` it does not matter, and stays as it is.
    """
    if fitted.converged or fitted.objective > enough:
        return fitted
    return refit(fitted.coords, fitted.x, most_steps=MOST_FURTHER)


class _Average(NamedTuple):
    """Over forms, and over the discrepancies beside them."""

    log_z: float
    best: Refit
    """the best form"""
    log_tau: float
    sd_log_tau: float
    terms: tuple[Term, ...]


def average_over_forms(
    fits: Sequence[tuple[Refit, float]],
    discrepancies: Sequence[Discrepancy] | None,
    base: Refit,
    least: float = -np.inf,
) -> _Average:
    """The evidence averaged over forms (and discrepancies), and where it puts ln tau.

    ``least``: log evidence below which tau does not matter, and is that of the optimum.
    """
    logs, weights, found, owners = [], [], [], []
    for fitted, weight in [(f.loosened, w) for f, w in fits]:
        beside = [None] if discrepancies is None else discrepancies
        for d, made in zip(beside, Linearised(fitted).evidences(beside), strict=True):
            logs.append(made.log_z)
            weights.append(weight * (1.0 if d is None else d.weight))
            found.append(made)
            owners.append((fitted, d))
    total = np.array(logs) + np.log(np.array(weights))
    mass = logsumexp(total)
    p = np.exp(total - mass)
    taus = np.array([(f.log_tau, f.sd_log_tau) for f in found])
    for i in np.flatnonzero(p > SMALL_SHARE) if mass >= least else ():
        fitted, beside_it = owners[i]
        # the profile is that of the shorter lag
        if beside_it is None and jump_is_seen(fitted, base) and not fitted.coords.binned.sensor:
            profile = profile_tau(fitted)
            taus[i] = profile.log_tau, profile.sd_log_tau
    mean = float(p @ taus[:, 0])
    square = float(p @ (taus[:, 1] ** 2 + (taus[:, 0] - mean) ** 2))
    kept = np.argsort(-p, kind="stable")[:MOST_TERMS]
    terms = tuple(Term(float(p[i] / p[kept].sum()), *owners[i]) for i in kept)
    return _Average(float(mass), terms[0].refit, mean, float(np.sqrt(square)), terms)


def compare_hypotheses(
    binned: BinnedCampaign,
    base: Refit,
    catalogue: Mapping[str, Effect],
    progress: Progress | None = None,
    pairs: bool = True,
) -> Comparison:
    """Probabilities of every hypothesis for one campaign."""
    tell = progress or (lambda _share, _text: None)
    discrepancies = make_discrepancies(binned, base)
    shares = normalise_weights(discrepancies, [d.weight for d in discrepancies])
    # in later rounds what was named is beside whatever is left
    by_itself = [d.weight if base.coords.parts else d.alone for d in discrepancies]
    priors = family_priors(catalogue)
    hypotheses: list[Hypothesis] = []

    def add(
        effects: tuple[str, ...],
        log_prior: float,
        fits: Sequence[tuple[Refit, float]],
        ds: Sequence[Discrepancy] | None = None,
        within: str = "",
        least: float = -np.inf,
    ) -> Hypothesis:
        other = ds is not None or bool(within)
        made = Hypothesis(
            effects, other, log_prior, *average_over_forms(fits, ds, base, least), within
        )
        hypotheses.append(made)
        return made

    add((), float(np.log(PRIOR_NONE)), [(base, 1.0)])
    rivals = embedded_rivals(
        [*catalogue.values(), *(part.effect for part in base.coords.parts)],
        several_flows=binned.several_flows,
        has_fall=any(s.height < 0.0 for b in binned.bins for s in b.switches),
        commanded=any(s.commanded is not None for b in binned.bins for s in b.switches),
        stages=Possible.of(binned.campaign).stages,
    )
    inside = WEIGHT if rivals else 0.0
    log_prior = float(np.log(PRIOR_UNLISTED * (1.0 - inside)))
    alone = add((), log_prior, [(base, 1.0)], normalise_weights(discrepancies, by_itself))
    for rival in rivals:
        made = [
            (
                fit_effect(binned, base, [Part(rival, f)], f.starts, 20, faster=False),
                1.0 / len(rival.forms),
            )
            for f in rival.forms
        ]
        log_prior = float(np.log(PRIOR_UNLISTED * inside / len(rivals)))
        add((), log_prior, made, within=rival.name)
    fits: dict[str, list[tuple[Refit, float]]] = {}
    on_mean = {n: e for n, e in catalogue.items() if e.on_mean}
    for i, (name, effect) in enumerate(on_mean.items()):
        tell(0.1 + 0.5 * i / len(on_mean), name)
        weight = sum(form.weight for form in effect.forms)
        fits[name] = [
            (fit_effect(binned, base, [Part(effect, form)], form.starts), form.weight / weight)
            for form in effect.forms
        ]
        log_prior = priors[name] + np.log1p(-INCOMPLETE)
        add((name,), float(log_prior), fits[name])
    singles = {h.effects[0]: h for h in hypotheses if len(h.effects) == 1}
    best = max([h.log_z for h in singles.values()], default=-np.inf)
    near = [n for n, h in singles.items() if h.log_z > max(best, alone.log_z) - NEAR]
    some = _promising(base, shares)
    for i, name in enumerate(near):
        tell(0.6 + 0.15 * i / len(near), f"{name} and something else")
        log_prior = float(priors[name] + np.log(INCOMPLETE))
        add((name,), log_prior, _leading(fits[name]), some)
    if pairs:
        _add_pairs(binned, base, on_mean, fits, singles, hypotheses, priors, some, add, tell)
    tell(1.0, "weighed")
    return Comparison(binned, base, tuple(hypotheses), catalogue, tuple(shares))


def normalise_weights(
    discrepancies: Sequence[Discrepancy], weights: Sequence[float]
) -> list[Discrepancy]:
    """Those with a weight, the weights summing to 1."""
    whole = sum(weights)
    return [replace(d, weight=w / whole) for d, w in zip(discrepancies, weights, strict=True) if w]


def _leading(fits: Sequence[tuple[Refit, float]]) -> list[tuple[Refit, float]]:
    # forms whose optimum is far worse than the best one's add nothing
    least = min(f.objective for f, _ in fits)
    return [(f, w) for f, w in fits if f.objective < least + 2.0 * NEAR]


def _promising(base: Refit, discrepancies: Sequence[Discrepancy]) -> list[Discrepancy]:
    # discrepancies that are not hopeless; their weights stay what they were
    logs = np.array([e.log_z for e in Linearised(base).evidences(discrepancies)])
    order = np.argsort(-logs)
    small = [i for i, d in enumerate(discrepancies) if d.name.split()[-1] in ("0.001", "0.0005")]
    keep = sorted({*order[:8].tolist(), *small})
    return [discrepancies[i] for i in keep]


def _add_pairs(
    binned: BinnedCampaign,
    base: Refit,
    on_mean: Mapping[str, Effect],
    fits: Mapping[str, list[tuple[Refit, float]]],
    singles: Mapping[str, Hypothesis],
    hypotheses: list[Hypothesis],
    priors: Mapping[str, float],
    beside: Sequence[Discrepancy],
    add: Callable[..., Hypothesis],
    tell: Progress,
) -> None:
    none = next(h for h in hypotheses if h.key == "none")
    ranked = sorted(singles.values(), key=lambda h: -h.log_weight)
    leading: list[str] = []
    families: set[str] = set()
    for h in ranked:  # the best member of the three best families
        family = on_mean[h.effects[0]].family
        if h.log_weight > none.log_weight and family not in families and len(leading) < 3:
            leading.append(h.effects[0])
            families.add(family)
    if not leading or not something_left(hypotheses):
        return
    done: set[frozenset[str]] = set()
    found: list[Hypothesis] = []
    best = max(singles.values(), key=lambda h: h.log_z)
    lowest = min(f.objective for f, _ in fits[best.effects[0]])
    single, other = best.log_z, max(h.log_z for h in hypotheses if h.incomplete)

    def gained() -> float:
        return max((h.log_z for h in found), default=single) - single

    def attempt(a: str, b: str) -> None:
        if a == b or frozenset((a, b)) in done:
            return
        done.add(frozenset((a, b)))
        made = []
        first = min(fits[a], key=lambda f: f[0].objective)[0]
        # what is further from the best of all so far weighs nothing, and a refit gains at most half
        # of what the objective loses
        least = single + max(other - single, gained(), 0.0) - NEAR
        enough = lowest - 2.0 * (least - single)
        for form in on_mean[b].forms:
            part = Part(on_mean[b], form)
            fitted = fit_effect(binned, first, [part], form.starts[:3], 15, enough)
            if (
                not base.coords.parts
            ):  # what the first effect has swallowed may belong to the second
                coords = fitted.coords
                start = coords.start(base.x, form.starts[0])
                afresh = refit(coords, start, most_steps=15, known=[fitted], enough=enough)
                fitted = to_convergence(min(fitted, afresh, key=lambda r: r.objective), enough)
            if fitted.converged or fitted.objective <= enough:
                made.append((fitted, form.weight))
        if not made:  # given up in every form
            return
        weight = sum(form.weight for form in on_mean[b].forms)
        log_prior = priors[a] + priors[b] - np.log(PRIOR_NONE)
        names = tuple(sorted((a, b), key=list(on_mean).index))
        forms = [(f, w / weight) for f, w in made]
        pair = add(names, float(log_prior), forms, least=least)
        found.append(pair)
        if pair.leftover > LEFT and pair.log_z > least:
            # what two effects together mimic well, they seldom mimic altogether
            add(names, float(log_prior + np.log(INCOMPLETE)), _leading(forms), beside)

    for i, a in enumerate(leading):
        for j, b in enumerate(on_mean):
            share = (i + j / len(on_mean)) / len(leading)
            tell(0.75 + 0.2 * share, f"{a} with {b}")
            attempt(a, b)
        if other < single and gained() < LITTLE:
            return  # one effect explains it all, and better than anything else does
    if gained() < max(LITTLE, HOPELESS * (other - single)):
        return  # no pair comes near what something else explains
    # the leading single effects need not be the two that go together: follow the best pair
    followed: set[str] = set(leading)
    for _ in range(MOST_FOLLOWED):
        pair = max(found, key=lambda h: h.log_z, default=None)
        if pair is None or pair.log_z < none.log_z:
            return
        new = [name for name in pair.effects if name not in followed]
        if not new:
            return
        tell(0.97, f"look-alikes of {' and '.join(pair.effects)}")
        for kept in new:
            followed.add(kept)
            for b in on_mean:
                attempt(kept, b)
