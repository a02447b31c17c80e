"""What may hide: effects that this campaign cannot see, and what they do to tau.

Fast effects are absorbed by the switch times and tau, leave almost no residual and may double
tau.  For each effect at plausible strength: its detectability after the refit, the shift of the
refitted tau, and tau refitted with the effect in place.  What is absorbed so well may be many times
as strong as is plausible, so tau is stated for each effect with its strength left free, too.  The
envelope is the union over everything that could not have been seen.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from math import exp, log
from typing import Any

import numpy as np

from bayes_sensor.diagnosis.data.binned_campaign import Sketch
from bayes_sensor.diagnosis.effects.effect import Effect, Form, Strength
from bayes_sensor.diagnosis.evidence.hypotheses import Weighing, joined_start
from bayes_sensor.diagnosis.evidence.laplace_evidence import Linearised
from bayes_sensor.diagnosis.evidence.refit import Refit, base_starts, refit, with_tau
from bayes_sensor.diagnosis.evidence.refit_coordinates import FASTER, Part, Plan
from bayes_sensor.workers import in_order

UNSEEN = 3.0
"""detectability below which an effect counts as hidden"""
PUBLISHED_SCALES = {"s": 0.8577, "V": 1.88, "duration": 120.0}
"""time constant, step height and record length that the catalogue's plausible strengths are for"""
CONTRADICTED = 9.0
"""rise of the misfit from which the data contradict an effect at this strength"""


@dataclass(frozen=True)
class Hidden:
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


def plausible(effect: Effect, sketch: Sketch) -> dict[str, float]:
    """Plausible strengths on this rig: times scaled with its time constants, volts with its step.

    The strength of a drift is the change over a record.
    """
    time = sketch.time_scale / PUBLISHED_SCALES["s"]
    volt = sketch.signal_scale / PUBLISHED_SCALES["V"]
    duration = sketch.duration / PUBLISHED_SCALES["duration"]
    scale = {
        "s": time, "V": volt, "1/V": 1.0 / volt, "V/s": volt / duration, "1/s": 1.0 / duration,
    }  # fmt: skip
    units = {}
    setting = sketch.settings[0]
    for form in effect.forms:
        units.update({s.name: s.unit for s in form.strengths(setting)})
    return {
        name: value * scale.get(units.get(name, "1"), 1.0)
        for name, value in effect.plausible.items()
    }


def form_for(effect: Effect, sketch: Sketch, given: Mapping[str, float]) -> Form:
    """The form that takes the given strengths; the first where several do."""
    setting = sketch.settings[0]
    for form in effect.forms:
        names = {s.name for s in form.strengths(setting)}
        if names and names <= set(given):
            return form
    return effect.forms[0]


def _all_strengths(effect: Effect, sketch: Sketch) -> list[Strength]:
    setting = sketch.settings[0]
    return [s for form in effect.forms for s in form.strengths(setting)]


def what_may_hide(
    weighing: Weighing, base: Refit, catalogue: Mapping[str, Effect], jobs: int = 1
) -> tuple[list[Hidden], tuple[float, float]]:
    """Every effect on the mean at plausible strength, and the envelope of tau, s.

    ``base``: the explanation that was accepted, with or without effects.
    """
    sketch = weighing.sketch
    exact = base.plan.means(base.x)
    none = refit(base.plan, base.x, data=exact, most_steps=10)
    line = Linearised(base).evidence(None)
    low = line.log_tau - 1.96 * line.sd_log_tau
    high = line.log_tau + 1.96 * line.sd_log_tau
    already = {part.effect.family for part in base.plan.parts}
    each = [
        (sketch, base, none, name, effect, plausible(effect, sketch))
        for name, effect in catalogue.items()
        if effect.on_mean and effect.family not in already
    ]
    free = _with_strength_free(weighing)
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
    return found, (exp(low), exp(high))


def _with_strength_free(weighing: Weighing) -> dict[str, tuple[float, float]]:
    """95 % interval of ln tau for every single effect that the data do not contradict.

    They do where the likeliest explanation fits them better by ``CONTRADICTED``.
    """
    best = weighing.likeliest.refit.misfit
    return {
        h.effects[0]: (h.log_tau - 1.96 * h.sd_log_tau, h.log_tau + 1.96 * h.sd_log_tau)
        for h in weighing.complete
        if len(h.effects) == 1 and h.refit.misfit - best <= CONTRADICTED
    }


def one_hidden(
    sketch: Sketch,
    base: Refit,
    none: Refit,
    name: str,
    effect: Effect,
    given: Mapping[str, float],
) -> Hidden:
    """An effect at one strength: detectability, shift of tau, tau with the effect in place.

    ``none``: the base refitted to its own noise-free mean.
    """
    form = form_for(effect, sketch, given)
    own = {s.name for s in _all_strengths(effect, sketch) if s.per_experiment}
    part = Part(effect, form)
    parts = (*base.plan.parts, part)
    held = replace(base.plan, parts=parts, held={**base.plan.held, **given})
    x = held.start(base.x, {}) if not base.plan.parts else joined_start(held, base)
    data = []
    for k in range(len(sketch.bins)):
        plan = held
        if own:  # strengths of each experiment's own: alternating signs around the null
            plan = replace(held, held={**held.held, **_alternating(effect, given, own, k)})
        data.append(plan.binned(x, k))
    blind = min(
        (
            refit(base.plan, start, data=data, most_steps=20)
            for start in ([base.x] if base.plan.parts else base_starts(sketch, base.x)[:3:2])
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
    return Hidden(
        effect=name,
        strength=dict(given),
        d=float(np.sqrt(max(excess, 0.0))),
        tau_shift_s=blind.tau - none.tau,
        tau_with_it_s=exp(line.log_tau),
        tau_low_s=exp(line.log_tau - 1.96 * line.sd_log_tau),
        tau_high_s=exp(line.log_tau + 1.96 * line.sd_log_tau),
        contradicted=bool(with_it.misfit - base.misfit > CONTRADICTED),
    )


def _starts(plan: Plan, x: np.ndarray) -> list[np.ndarray]:
    """As it is, and with a sensor three times as slow where the valve allows it."""
    slower = min(3.0 * exp(x[1] - FASTER - x[0]), 0.7 * exp(x[1]))
    return [x, with_tau(plan, x, log(slower))]


def _alternating(
    effect: Effect, given: Mapping[str, float], own: set[str], k: int
) -> dict[str, float]:
    made = {}
    for name in own & set(given):
        null = effect.null.get(name, 0.0)
        sign = 1.0 if k % 2 == 0 else -1.0
        made[name] = null * (given[name] / null) ** sign if null > 0 else null + sign * given[name]
    return made
