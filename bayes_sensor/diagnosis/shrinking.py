"""How far the gap shrinks with the explanation that the verdict stands for, and tau with it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from math import exp

import numpy as np

from bayes_sensor.diagnosis.closed_fraction import Closure
from bayes_sensor.diagnosis.closure import held_out, misfit_removed
from bayes_sensor.diagnosis.data.preparation import PreparedCampaign
from bayes_sensor.diagnosis.effects.effect import Effect
from bayes_sensor.diagnosis.evidence.comparison import Comparison, Hypothesis
from bayes_sensor.diagnosis.evidence.refit import Refit
from bayes_sensor.diagnosis.gap import Shrink
from bayes_sensor.diagnosis.signals.finding import Finding


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
        tau_after_s=tau,
        tau_after_low_s=low,
        tau_after_high_s=high,
        explanation=best.key,
        rival=rival.key if rival else None,
        rival_fraction_closed=closed_by(base, rival.refit, closed) if rival else None,
    )


def closed_by(base: Refit, fitted: Refit, closed: Closure) -> float | None:
    """What another explanation takes away of the gap whose whole size ``closed`` knows."""
    return None if closed.withheld else misfit_removed(base, fitted) / closed.d_before**2


def shrinking_of_noise(
    shrink: Shrink,
    named: Sequence[str],
    catalogue: Mapping[str, Effect],
    prepared: PreparedCampaign,
    findings: Sequence[Finding],
) -> Shrink:
    """The same where what is named makes a gap that is not one of the mean, if any does."""
    for name in named:
        noise = catalogue[name].on_noise
        if noise and noise.closure:
            found = next(f for f in findings if f.name == name)
            closed, out = noise.closure(prepared, found)
            return replace(shrink, closure=closed, held_out_fraction_closed=out, explanation=name)
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
