"""How far the gap shrinks once an effect is added: in sample, held out, and for tau.

What an effect closes and what it leaves are measured each in its own way.  The misfit that it
takes away is the difference of two nested refits to the same noise, beyond what its freedom
takes from noise alone; its error is small.  What it leaves hides in the noise of hundreds of bins:
it is the squared size of "something else" beside the effect, averaged over the discrepancies by
their evidence, and nothing as far as the evidence says that the effect is the whole story.  The
closed fraction is the first over the sum of both.  A large closed fraction does not prove a cause:
the best wrong effect often closes most of a gap, so the best rival outside the family is given
beside it.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from math import exp

import numpy as np
from numpy.typing import NDArray
from scipy.special import logsumexp

from bayes_sensor.campaign import FloatArray
from bayes_sensor.diagnosis.closed_fraction import VISIBLE, Closure, HeldOut
from bayes_sensor.diagnosis.data.binned_campaign import BinnedCampaign
from bayes_sensor.diagnosis.effects.effect import Effect
from bayes_sensor.diagnosis.evidence.block_least_squares import inverted, solved
from bayes_sensor.diagnosis.evidence.compared_hypotheses import Comparison, Hypothesis
from bayes_sensor.diagnosis.evidence.discrepancy import Discrepancy
from bayes_sensor.diagnosis.evidence.hypotheses import INCOMPLETE
from bayes_sensor.diagnosis.evidence.laplace_evidence import Linearised
from bayes_sensor.diagnosis.evidence.refit import Refit, refit
from bayes_sensor.diagnosis.gap import Shrink
from bayes_sensor.diagnosis.location import excess_mean_square
from bayes_sensor.diagnosis.signals.signal import Finding, Samples

RULED_OUT = 0.05
"""chance of a full closing below which it is"""
DRAWS = 2000
"""of what may be left, behind an interval"""
INEXACT, INEXACT_DOF = 0.045, 3.0
"""scale and degrees of freedom of a half-t law of what the form of a right effect leaves of it, as
a share of its size in standard deviations: noise-free, the forms of the catalogue leave .03 of the
listed causes of the blind check in the median, and .12 of one in twenty"""
NEGLIGIBLE = 1e-4
"""share of the evidence below which a discrepancy is not drawn from"""


def misfit_removed(base: Refit, fitted: Refit) -> float:
    """By how much ``fitted`` lowers the squared misfit of ``base``, in units of the noise.

    Less what its further freedom takes from noise alone.
    """
    excess = [r.misfit - r.leverage.trace() for r in (base, fitted)]
    return max(excess[0] - excess[1], 0.0)


def draw_remaining_misfit(
    fitted: Refit, discrepancies: Sequence[Discrepancy], seed: int = 1
) -> tuple[float, FloatArray]:
    """The chance that an explanation leaves something, and how much then.

    Returns
    -------
    The posterior probability of something else beside the effect, from the prior odds that the
    verdict gives it, and :data:`DRAWS` draws of the squared misfit, in units of the noise, that it
    would be after the refit.  Misfit that no discrepancy describes is added as measured, where it
    exceeds the noise and the error of the noise floor.
    """
    rng = np.random.default_rng(seed)
    line = Linearised(fitted)
    each = zip(line.evidences(discrepancies), discrepancies, strict=True)
    logs = np.array([e.log_z + np.log(d.weight) for e, d in each])
    complete = line.evidence(None).log_z + np.log1p(-INCOMPLETE)
    any_of_them = float(logsumexp(logs))
    some = any_of_them + np.log(INCOMPLETE)
    chance = float(np.exp(some - np.logaddexp(some, complete)))
    weights = np.exp(logs - any_of_them)
    weights[weights < NEGLIGIBLE] = 0.0
    counts = rng.multinomial(DRAWS, weights / weights.sum())
    drawn = [
        _squared_sizes(fitted, d, rng, n)
        for d, n in zip(discrepancies, counts, strict=True)
        if n > 0
    ]
    sizes = np.concatenate(drawn)
    rough = fitted.misfit - fitted.leverage.trace() - chance * float(np.mean(sizes))
    n = len(fitted.residual)
    spread = np.sqrt(2.0 * n + 2.0 * n**2 / fitted.coords.binned.floor.level_dof)
    if rough < VISIBLE * spread:
        return chance, sizes
    sizes[rng.random(len(sizes)) > chance] = 0.0
    return 1.0, sizes + np.maximum(rough + spread * rng.standard_normal(len(sizes)), 0.0)


def _squared_sizes(
    fitted: Refit, discrepancy: Discrepancy, rng: np.random.Generator, n: int
) -> FloatArray:
    # (n,) draws of |P U a|^2: U a the discrepancy given the residual, the parameters integrated
    # out under their priors, and P what a refit without the discrepancy leaves of it
    at_limit = int(fitted.coords.at_limit(fitted.x))  # tau there: its own coordinate does not move
    jacobian = fitted.jacobian[:, at_limit:]
    coords = fitted.coords
    prior = coords.own_prior_matrix[at_limit:, at_limit:]
    pull = (coords.own_prior_matrix @ (fitted.x - coords.prior_centre))[at_limit:]
    basis, variance = discrepancy.basis, discrepancy.variance
    shrink = variance / (1.0 + variance)
    normal = jacobian.T @ jacobian
    seen = basis.T @ jacobian
    inner = basis.T @ fitted.residual
    beside = inverted(normal - seen.T @ (shrink[:, None] * seen) + prior)
    gradient = jacobian.T @ fitted.residual - seen.T @ (shrink * inner) - pull
    mean = shrink * (inner - seen @ (beside @ gradient))
    part = shrink[:, None] * seen
    covariance = np.diag(shrink) + part @ beside @ part.T
    a = mean[:, None] + np.linalg.cholesky(covariance) @ rng.standard_normal((len(mean), n))
    slope = seen.T @ a
    step = solved(normal + prior, slope)
    sizes = np.sum(a * a, axis=0) - 2.0 * np.sum(slope * step, axis=0)
    made: FloatArray = np.maximum(sizes + np.sum(step * (normal @ step), axis=0), 0.0)
    return made


def closure(
    base: Refit,
    fitted: Refit,
    discrepancies: Sequence[Discrepancy],
    seed: int = 1,
    others: Sequence[tuple[Refit, float]] = (),
) -> Closure:
    """The closed fraction with its 95 % interval.

    Where nothing else is left a right effect still leaves what its form lacks (:data:`INEXACT`),
    but not more than would be seen.  ``others``: explanations that may be right in its place, with
    their odds against it; then what lies between the two is left.  Where a full closing is not
    ruled out (a chance of 5 %) the interval is one-sided and reaches up to one; elsewhere it is
    equal-tailed.
    """
    volts = [np.sqrt(max(_mean_volts(base.coords.binned, r), 0.0)) for r in (base, fitted)]
    taken = misfit_removed(base, fitted)
    chance, sizes = draw_remaining_misfit(fitted, discrepancies, seed)
    left = chance * float(np.mean(sizes))
    d = float(np.sqrt(taken + left)), float(np.sqrt(left))
    nothing = volts[0] <= 0.0 or base.misfit <= base.leverage.trace()
    if nothing or d[0] < VISIBLE:  # what is no excess cannot be closed
        return Closure(None, None, None, float(volts[0]), float(volts[1]), *d)
    rng = np.random.default_rng(seed + 1)
    lacking = taken * (INEXACT * rng.standard_t(INEXACT_DOF, len(sizes))) ** 2
    lacking = np.minimum(lacking, VISIBLE**2)
    odds = np.array([1.0, *(o for _, o in others)])
    apart = np.array([0.0, *(np.sum((fitted.residual - r.residual) ** 2) for r, _ in others)])
    lacking += rng.choice(apart, len(sizes), p=odds / odds.sum())
    beside = np.where(rng.random(len(sizes)) < chance, sizes, lacking)
    # noise beside a misfit of size d changes its square by 2 d standard deviations
    shares = np.maximum(taken + 2.0 * np.sqrt(taken) * rng.standard_normal(len(sizes)), 0.0)
    shares /= np.maximum(shares + beside, 1e-300)
    low, high = np.quantile(shares, [0.025, 0.975])
    if taken > 0.0 and chance < 1.0 - RULED_OUT:
        low, high = np.quantile(shares, RULED_OUT), 1.0
    fraction = taken / (taken + left)
    # the mean counts a chance that the interval may leave out
    low, high = min(float(low), fraction), max(float(high), fraction)
    return Closure(fraction, low, high, float(volts[0]), float(volts[1]), *d)


def _mean_volts(binned: BinnedCampaign, fitted: Refit) -> float:
    leverage = fitted.leverage
    pairs = [
        excess_mean_square(binned, leverage, fitted.residual, k, np.arange(rows.start, rows.stop))
        for k, rows in enumerate(binned.rows)
    ]
    count = sum(n for _, n in pairs)
    return sum(v * n for v, n in pairs) / count


def held_out(base: Refit, fitted: Refit, seed: int = 1) -> HeldOut | None:
    """Closed fraction of experiments predicted without having been used.

    The shared parameters and strengths are frozen at a fit to the others; only y0, beta, t0 and
    tf of the left-out experiment are refitted.  Strengths of its own are fitted before the fall
    and judged on the fall.  None where there is one experiment, no fall to judge local strengths
    on, or too little to divide by.
    """
    binned = base.coords.binned
    n_e = len(binned.bins)
    local = bool(fitted.coords.own)
    if n_e < 2:
        return None
    before = after = 0.0
    n = 0
    unsure: list[list[FloatArray]] = [[], []]
    for k in range(n_e):
        if local and not binned.bins[k].falling.any():
            continue
        pair = [_predicted(r, k, local) for r in (base, fitted)]
        before += pair[0].excess
        after += pair[1].excess
        n += pair[0].freedom
        for found, one in zip(unsure, pair, strict=True):
            found.append(one.unsure)
    if before < VISIBLE * np.sqrt(2.0 * n) or before <= 0.0:
        return None
    fraction = 1.0 - after / before
    rng = np.random.default_rng(seed)
    # noise and an error of its floor are in both, so that they leave the difference alone, but for
    # the noise beside what the effect takes away; and either was predicted with some error
    both = np.sqrt(2.0 * n + 2.0 * n**2 / binned.floor.level_dof) * rng.standard_normal(DRAWS)
    error = [rng.chisquare(1.0, (DRAWS, len(u))) @ u for u in map(np.concatenate, unsure)]
    taken = before - after
    taken = taken + 2.0 * np.sqrt(max(taken, 0.0)) * rng.standard_normal(DRAWS)
    taken = np.maximum(taken - error[0] + error[1], 0.0)
    shares = taken / np.maximum(taken + np.maximum(after + both - error[1], 0.0), 1e-300)
    low, high = np.quantile(shares, [0.025, 0.975])
    return HeldOut(float(fraction), min(float(low), fraction), max(float(high), fraction))


@dataclass(frozen=True)
class _Prediction:
    """Of one experiment, from the others."""

    excess: float
    """misfit beyond that of noise"""
    freedom: int
    unsure: FloatArray
    """(m,) what errors of the predicting parameters add to it: squares of standard normals with
    these weights"""


def _predicted(fitted: Refit, k: int, local: bool) -> _Prediction:
    """Experiment ``k`` predicted from the others; with ``local`` its fall from all before it."""
    binned, coords = fitted.coords.binned, fitted.coords
    n_e = len(binned.bins)
    others = [j for j in range(n_e) if j != k]
    all_but = binned.restricted([np.full(len(b.first), j != k) for j, b in enumerate(binned.bins)])
    own = len(coords.own)
    rest = refit(
        replace(coords, binned=all_but),
        binned.local_coordinates(fitted.x, others, own),
        most_steps=10,
        tolerance=0.2,
    )
    only = [np.full(len(b.first), j == k) for j, b in enumerate(binned.bins)]
    alone = binned.restricted(only)
    one = replace(coords, binned=alone)
    start = binned.local_coordinates(fitted.x, [k], own)
    n_shared = one.local[0]
    start[:n_shared] = rest.x[:n_shared]
    free = np.zeros(one.size, dtype=bool)
    free[n_shared:] = True
    covariance = np.zeros((one.size, one.size))
    covariance[:n_shared, :n_shared] = rest.covariance[:n_shared, :n_shared]
    if not local:
        made = refit(one, start, most_steps=10, tolerance=0.2, free=free)
        return _prediction(made, free, covariance)
    # strengths of its own: everything before the fall decides them, the fall judges
    falling = alone.bins[0].falling
    rise = replace(coords, binned=alone.restricted([~falling]))
    first = refit(rise, start, most_steps=10, tolerance=0.2, free=free)
    covariance[n_shared:, n_shared:] = first.covariance[n_shared:, n_shared:]
    free[:] = False
    free[one.switches_of(0, falling=True)] = True
    fall = replace(coords, binned=alone.restricted([falling]))
    made = refit(fall, first.x, most_steps=10, tolerance=0.2, free=free)
    return _prediction(made, free, covariance)


def _prediction(made: Refit, free: NDArray[np.bool_], covariance: FloatArray) -> _Prediction:
    """``covariance`` (n, n) of the coordinates that were not ``free``."""
    loose, given = made.jacobian[:, free], made.jacobian[:, ~free]
    unit = np.linalg.norm(loose, axis=0)
    loose = loose / np.where(unit > 0.0, unit, 1.0)
    given = given - loose @ np.linalg.lstsq(loose, given, rcond=None)[0]
    n = len(made.residual) - loose.shape[1]
    seen = given @ covariance[np.ix_(~free, ~free)] @ given.T
    unsure = np.linalg.eigvalsh(seen)[-given.shape[1] :]
    return _Prediction(float(made.residual @ made.residual) - n, max(n, 1), np.maximum(unsure, 0.0))


def shrinking(comparison: Comparison, best: Hypothesis, closed: Closure, seed: int) -> Shrink:
    """How far the gap shrinks with ``best``, which closes it as ``closed`` says."""
    base, catalogue = comparison.base, comparison.catalogue
    out = None
    if best.effects and not closed.withheld:
        out = held_out(base, best.refit, seed)
    families = {catalogue[n].family for n in best.effects}
    rivals = [
        h
        for h in comparison.complete
        if len(h.effects) == 1 and catalogue[h.effects[0]].family not in families
    ]
    rival = max(rivals, key=lambda h: h.log_weight) if rivals and best.effects else None
    none = comparison.find()
    tau, low, high = _averaged_tau(comparison)
    return Shrink(
        closure=closed,
        held_out_fraction_closed=out.fraction if out else None,
        held_out_interval=(out.low, out.high) if out else None,
        tau_before_s=exp(none.log_tau),
        tau_before_low_s=none.tau_interval[0],
        tau_before_high_s=none.tau_interval[1],
        tau_after_s=tau,
        tau_after_low_s=low,
        tau_after_high_s=high,
        explanation=best.key,
        rival=rival.key if rival else None,
        rival_fraction_closed=closed_by(base, rival.refit, closed) if rival else None,
    )


def closed_by(base: Refit, fitted: Refit, closed: Closure) -> float | None:
    """Fraction of the gap, whose size ``closed`` holds, that an explanation closes."""
    return None if closed.withheld else misfit_removed(base, fitted) / closed.d_before**2


def shrinking_of_noise(
    shrink: Shrink,
    named: Sequence[str],
    catalogue: Mapping[str, Effect],
    samples: Samples,
    findings: Sequence[Finding],
) -> Shrink:
    """``shrink`` with the closed fraction of a named effect on the noise, if one has its own."""
    for name in named:
        noise = catalogue[name].on_noise
        if noise and noise.closure:
            found = next(f for f in findings if f.name == name)
            closed, out = noise.closure(samples, found)
            return replace(
                shrink, closure=closed, held_out_fraction_closed=out, explanation=name,
                of_mean=False,
            )  # fmt: skip
    return shrink


def _averaged_tau(comparison: Comparison) -> tuple[float, float, float]:
    """Median and 95 % interval of tau over the explanations that hold 95 % of the probability."""
    p = comparison.probabilities
    order = np.argsort(-p)
    count = int(np.searchsorted(np.cumsum(p[order]), 0.95)) + 1
    kept = order[:count]
    weight = p[kept] / p[kept].sum()
    chosen = [comparison.hypotheses[i] for i in kept]
    from scipy.special import ndtr

    grid = np.linspace(
        min(h.log_tau - 4 * h.sd_log_tau for h in chosen),
        max(h.log_tau + 4 * h.sd_log_tau for h in chosen),
        4001,
    )
    total = sum(
        w * ndtr((grid - h.log_tau) / h.sd_log_tau) for w, h in zip(weight, chosen, strict=True)
    )
    low, mid, high = (float(np.exp(np.interp(q, total, grid))) for q in (0.025, 0.5, 0.975))
    return mid, low, high
