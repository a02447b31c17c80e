"""Effects that stay unseen in this campaign, and what they do to tau.

Fast effects are absorbed by the switch times and tau, leave almost no residual and may double tau.
For each effect at plausible strength this file computes the detectability after the refit, the
shift of the refitted tau, and tau refitted with the effect in place.  An absorbed effect may be
many times stronger than plausible, so tau is also given with the strength left free.  The envelope
of tau is the union over all effects that could not have been seen.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property
from math import exp, log
from typing import TYPE_CHECKING, Any

import numpy as np

from bayes_sensor.diagnosis.data.binned_campaign import BinnedCampaign
from bayes_sensor.diagnosis.effects.effect import Effect
from bayes_sensor.diagnosis.evidence.compared_hypotheses import Comparison
from bayes_sensor.diagnosis.evidence.coordinate_priors import FASTER, Part
from bayes_sensor.diagnosis.evidence.laplace_evidence import Linearised
from bayes_sensor.diagnosis.evidence.refit import Refit, base_starts, refit
from bayes_sensor.diagnosis.evidence.refit_coordinates import Coordinates
from bayes_sensor.workers import in_order

if TYPE_CHECKING:
    import pandas as pd

UNSEEN = 3.0
"""detectability below which an effect counts as hidden"""
CONTRADICTED = 9.0
"""rise of the misfit from which the data contradict an effect at this strength"""


@dataclass(frozen=True)
class HiddenEffect:
    """One effect at plausible strength."""

    effect: str
    strength: dict[str, float]
    d: float
    """detectability after the refit of the model without it"""
    tau_shift_s: float | None
    """refitted minus true tau when the model ignores it; None, as all of tau, where nobody knows
    which lag is the sensor's"""
    tau_with_it_s: float | None
    """tau refitted to the measurement with the effect held at this strength"""
    tau_low_s: float | None
    tau_high_s: float | None
    """its 95 % interval"""
    contradicted: bool
    """whether the measurement speaks against the effect at this strength"""
    tau_free_low_s: float | None = None
    tau_free_high_s: float | None = None
    """the 95 % interval of tau with the effect alone in the model, its strength left to data and
    prior; None where another explanation fits the data clearly better"""
    lag_fast: Mapping[str, Any] = field(default_factory=dict)
    """what is then said of the shorter lag in place of tau, by key of gap.json"""

    def to_json(self) -> dict[str, Any]:
        """The keys of gap.json."""
        return {**{k: v for k, v in vars(self).items() if k != "lag_fast"}, **self.lag_fast}


@dataclass(frozen=True)
class HiddenEffects:
    """What this campaign could not have seen."""

    effects: tuple[HiddenEffect, ...]
    tau_envelope_s: tuple[float, float] | None
    """None where nobody knows which lag is the sensor's"""
    lag: str = "tau"
    """the lag that this and all else of tau is said of: ``tau[A]`` with several sensors"""
    lag_fast: Mapping[str, Any] = field(default_factory=dict)
    """what is then said of the shorter lag in place of tau, by key of gap.json"""

    def to_json(self) -> dict[str, Any]:
        """The keys of gap.json."""
        effects = [h.to_json() for h in self.effects]
        envelope = {"tau_envelope_s": self.tau_envelope_s, **self.lag_fast}
        return {"lag": self.lag, "effects": effects, **envelope}

    @cached_property
    def table(self) -> pd.DataFrame:
        """One row per effect: d, shift of tau, tau with it in place."""
        import pandas as pd

        return pd.DataFrame([e.to_json() for e in self.effects])


def hidden_effects(
    comparison: Comparison, base: Refit, catalogue: Mapping[str, Effect], jobs: int = 1
) -> HiddenEffects:
    """Every effect on the mean at plausible strength, and the envelope of tau, s.

    ``base``: the explanation that was accepted, with or without effects.
    """
    binned = comparison.binned
    exact = base.coords.means(base.x)
    none = refit(base.coords, base.x, data=exact, most_steps=10)
    line = Linearised(base).evidence(None)
    low = line.log_tau - 1.96 * line.sd_log_tau
    high = line.log_tau + 1.96 * line.sd_log_tau
    already = {part.effect.family for part in base.coords.parts}
    each = [
        (binned, base, none, name, effect, effect.plausible_on(binned.settings[0]))
        for name, effect in catalogue.items()
        if effect.on_mean and effect.family not in already
    ]
    free = _with_strength_free(comparison)
    found = []
    for made in in_order(one_hidden, each, jobs):
        if made.d < UNSEEN and not made.contradicted:
            low = min(low, log(max(made.tau_low_s, 1e-12)))
            high = max(high, log(max(made.tau_high_s, 1e-12)))
        if made.effect in free:
            begin, end = free[made.effect]
            low, high = min(low, begin), max(high, end)
            made = replace(made, tau_free_low_s=exp(begin), tau_free_high_s=exp(end))
        found.append(made)
    return HiddenEffects(tuple(found), (exp(low), exp(high)), binned.stated_lag)


def _with_strength_free(comparison: Comparison) -> dict[str, tuple[float, float]]:
    """95 % interval of ln tau for every single effect that the data do not contradict.

    They do where the likeliest explanation fits them better by ``CONTRADICTED``.
    """
    best = comparison.likeliest.refit.misfit
    return {
        h.effects[0]: (h.log_tau - 1.96 * h.sd_log_tau, h.log_tau + 1.96 * h.sd_log_tau)
        for h in comparison.complete
        if len(h.effects) == 1 and h.refit.misfit - best <= CONTRADICTED
    }


def one_hidden(
    binned: BinnedCampaign,
    base: Refit,
    none: Refit,
    name: str,
    effect: Effect,
    given: Mapping[str, float],
) -> HiddenEffect:
    """An effect at one strength: detectability, shift of tau, tau with the effect in place.

    ``none``: the base refitted to its own noise-free mean.
    """
    form = effect.form_for(given, binned.settings[0])
    own = {s.name for s in effect.strengths(binned.settings[0]) if s.per_experiment}
    part = Part(effect, form)
    parts = (*base.coords.parts, part)
    held = replace(base.coords, parts=parts, held={**base.coords.held, **given})
    x = held.start(base.x, {}) if not base.coords.parts else held.start_from(base.coords, base.x)
    data = []
    for k in range(len(binned.bins)):
        coords = held
        if own:  # strengths of each experiment's own: alternating signs around the null
            coords = replace(held, held={**held.held, **_alternating(effect, given, own, k)})
        data.append(coords.bin_means(x, k))
    blind = min(
        (
            refit(base.coords, start, data=data, most_steps=20)
            for start in ([base.x] if base.coords.parts else base_starts(binned, base.x)[:3:2])
        ),
        key=lambda r: r.objective,
    )
    excess = blind.misfit - none.misfit
    if own:
        with_it = base
    else:
        with_it = min(
            (refit(held, start, most_steps=25) for start in _starts(held, x)),
            key=lambda r: r.objective,
        )
    line = Linearised(with_it).evidence(None)
    return HiddenEffect(
        effect=name,
        strength=dict(given),
        d=float(np.sqrt(max(excess, 0.0))),
        tau_shift_s=blind.tau - none.tau,
        tau_with_it_s=exp(line.log_tau),
        tau_low_s=exp(line.log_tau - 1.96 * line.sd_log_tau),
        tau_high_s=exp(line.log_tau + 1.96 * line.sd_log_tau),
        contradicted=bool(with_it.misfit - base.misfit > CONTRADICTED),
    )


def _starts(coords: Coordinates, x: np.ndarray) -> list[np.ndarray]:
    """As it is, and with a sensor three times as slow where the valve allows it."""
    if not coords.n_ordered:
        return [x]
    slower = min(3.0 * exp(x[1] - FASTER - x[0]), 0.7 * exp(x[1]))
    return [x, coords.with_tau(x, log(slower))]


def _alternating(
    effect: Effect, given: Mapping[str, float], own: set[str], k: int
) -> dict[str, float]:
    made = {}
    for name in own & set(given):
        null = effect.null.get(name, 0.0)
        sign = 1.0 if k % 2 == 0 else -1.0
        made[name] = null * (given[name] / null) ** sign if null > 0 else null + sign * given[name]
    return made
