"""Campaigns with known effects: the model with them, and the noise they change."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from typing import Any, cast

import numpy as np
from scipy.signal import lfilter

from bayes_sensor.campaign import Campaign, CampaignError, FloatArray
from bayes_sensor.diagnosis.effects import CATALOGUE
from bayes_sensor.diagnosis.effects.effect import OnNoise, Strength
from bayes_sensor.diagnosis.effects.effect_model import (
    EffectModel,
    Scales,
    find_form,
    parse_effect,
    with_effects,
)
from bayes_sensor.diagnosis.effects.setting import Setting
from bayes_sensor.likelihood.noise import lag_coefficient, scale_squared
from bayes_sensor.likelihood.problem import Problem
from bayes_sensor.rig.layout import Theta

BURN_IN = 2000
"""samples before the record in which coloured noise becomes stationary"""


def default_strengths(name: str, scales: Scales, form: str | None = None) -> dict[str, float]:
    """Plausible strengths of an effect on a rig of these scales.

    Of one of its forms those that this one has, at their centres where nothing else is known.
    Raises CampaignError where it has no such form.
    """
    effect = CATALOGUE[name]
    if form is not None and not effect.forms:
        raise CampaignError(f"{name} acts on the noise and has no forms; give it alone")
    plausible = effect.plausible_on(_blank_setting(scales))
    if form is None:
        return plausible
    return {s.name: plausible.get(s.name, s.value(0.0)) for s in _strengths(name, scales, form)}


def _blank_setting(scales: Scales) -> Setting:
    from bayes_sensor.campaign import Experiment

    blank = Experiment("blank", np.array([0.0, 1.0]), None, 1.0, 1.0, 1.0)
    return scales.setting(blank, 0.0, None)


def _strengths(name: str, scales: Scales, form: str | None = None) -> list[Strength]:
    # of one form, or of all
    effect, setting = CATALOGUE[name], _blank_setting(scales)
    if form is None:
        return effect.strengths(setting)
    return list(find_form(effect, form).strengths(setting))


def read_strength(text: str) -> tuple[str, float | None]:
    """``NAME[:FORM]`` or that ``=STRENGTH`` of the command line.  Raises CampaignError."""
    which, equals, value = text.partition("=")
    name, form = parse_effect(which, "--effect")
    scales = Scales(1.0, 1.0, 1.0, 1.0)
    try:
        strengths = default_strengths(name, scales, form)
    except CampaignError as error:
        raise CampaignError(f"--effect {which[:80]}: {error}") from None
    if not equals:
        return which, None
    first = next(iter(strengths), None)
    if first is None:
        raise CampaignError(
            f"--effect {text[:80]}: this form has no strength; give {which[:60]} alone"
        )
    own = {s.name: s.unit for s in _strengths(name, scales)}.get(first, "1")
    amount, _, unit = value.strip().partition(" ")
    if unit.strip() not in ("", own):
        raise CampaignError(
            f"--effect {text[:80]}: {first} is in {own if own != '1' else 'no unit'}, not in "
            f"'{unit.strip()[:40]}'; give the number alone"
        )
    try:
        number = float(amount)
    except ValueError:
        raise CampaignError(
            f"--effect {text[:80]}: expected NAME=NUMBER such as {which[:60]}="
            f"{strengths[first]:g}, but '{amount[:40]}' is no number"
        ) from None
    if not np.isfinite(number):
        raise CampaignError(f"--effect {text[:80]}: expected a finite number")
    return which, number


def simulate_with_effects(
    campaign: Campaign | Problem,
    theta: Theta,
    effects: Mapping[str, float | None],
    seed: int = 1,
) -> tuple[Campaign, dict[str, dict[str, Any]]]:
    """A campaign in which effects of the catalogue act, and their strengths.

    ``effects`` maps names, ``NAME`` or ``NAME:FORM``, to the first strength of each (None: a
    plausible one).  Strengths that every experiment has for itself are drawn with that size as
    their spread.

    Raises CampaignError for unknown names, one that is given twice, and malformed parameters.
    """
    from bayes_sensor.likelihood.problem import as_problem

    problem = as_problem(campaign)
    layout = problem.layout
    vector = layout.flat(theta)
    vector = np.where(np.isnan(vector), 0.0, vector)
    scales = Scales.of(problem.campaign, vector)
    chosen: dict[str, dict[str, Any]] = {}
    forms: dict[str, str | None] = {}
    for text, first in effects.items():
        name, form = parse_effect(text)
        if name in chosen:
            raise CampaignError(f"--effect {text[:80]}: {name} is given twice; leave one out")
        strengths = default_strengths(name, scales, form)
        if first is not None:
            strengths[next(iter(strengths))] = first
        _check(name, strengths, scales)
        chosen[name], forms[name] = strengths, form
    rng = np.random.default_rng(np.random.SeedSequence([seed, 7]))
    model, extended = _mean_model(problem, vector, chosen, forms, scales, rng)
    # in the order of the catalogue: what adds to the signal comes before what rounds it
    on_noise = [
        (effect.on_noise, chosen[name])
        for name, effect in CATALOGUE.items()
        if name in chosen and effect.on_noise
    ]
    streams = np.random.SeedSequence(seed).spawn(len(problem.campaign))
    values = {}
    for k, (e, stream) in enumerate(zip(problem.campaign, streams, strict=True)):
        mean, x = model(k)
        _, sigma0, sigma1 = vector[layout.noise[k]]
        law = problem.noise.weight(problem.campaign, e), problem.noise.fading
        scale = np.sqrt(scale_squared(x, sigma0, sigma1, *law))
        phi = lag_coefficient(float(vector[layout.noise[k, 0]]), problem.steps(e))
        generator = np.random.default_rng(stream)
        noise = scale * _unit_noise(len(e.t), phi, on_noise, generator)
        for act, own in on_noise:
            noise = act.filtered(noise, e.interval, own) if act.filtered else noise
        y = mean + noise
        for act, own in on_noise:
            y = act.record(y, e.t, own, generator) if act.record else y
        values[e.name] = y
    simulated = replace(problem.campaign.with_data(values), warnings=())
    chosen = {name: extended.get(name, strengths) for name, strengths in chosen.items()}
    return simulated, chosen


def _check(name: str, strengths: Mapping[str, float], scales: Scales) -> None:
    known = {s.name: s for s in _strengths(name, scales)}
    noise = CATALOGUE[name].on_noise
    for key, value in strengths.items():
        if noise and key in noise.above and value <= noise.above[key]:
            least = f"more than {noise.above[key]:g}"
            what = noise.reason or f"as {key}"
            raise CampaignError(f"--effect {name}={value:g}: expected {least} {what}")
        if key not in known:
            continue
        low, high = known[key].limits
        positive = known[key].kind == "log_normal"
        low = max(low, 0.0) if positive else low
        if not low <= value <= high or (positive and value <= 0.0):
            raise CampaignError(
                f"--effect {name}={value:g}: expected {key} between {low:g} and {high:g}"
            )


def _mean_model(
    problem: Problem,
    vector: FloatArray,
    chosen: Mapping[str, Mapping[str, float]],
    forms: Mapping[str, str | None],
    scales: Scales,
    rng: np.random.Generator,
) -> tuple[Callable[[int], tuple[FloatArray, FloatArray]], dict[str, dict[str, Any]]]:
    """A function k -> (mean, x3) (n_t,), and the strengths, by experiment where they are own."""
    names = [n for n in chosen if CATALOGUE[n].on_mean]
    campaign = problem.campaign
    extended: dict[str, dict[str, Any]] = {}
    if not names:
        from bayes_sensor.likelihood.density import mean_and_variance

        def plain(k: int) -> tuple[FloatArray, FloatArray]:
            y0, beta = (float(vector[i]) for i in problem.layout.local[k, :2])
            mean, _ = mean_and_variance(problem, vector, k)
            return mean, (mean - y0) / beta if beta else np.zeros_like(mean)

        return plain, extended
    texts = []
    setting = scales.setting(campaign.experiments[0], 0.0, None)
    for n in names:
        effect, keys = CATALOGUE[n], set(chosen[n])
        alike = (f for f in effect.forms if {s.name for s in f.strengths(setting)} == keys)
        name = forms[n] or next(alike, effect.forms[0]).name
        texts.append(f"{n}:{name}" if name else n)
    made = with_effects(Problem(campaign, noise=problem.noise), texts, vector)
    # a truth says by name whose its lags are
    model = replace(cast(EffectModel, made.model), assignment=None)
    layout = made.layout
    full = np.zeros(len(layout))
    full[: layout.n_mean] = vector[: layout.n_mean]
    for c, strengths in zip(model.chosen, model.strengths, strict=True):
        extended[c.effect] = dict(chosen[c.effect])
        for s in strengths:
            from bayes_sensor.diagnosis.effects.effect_model import parameter_name

            value = chosen[c.effect][s.name]
            if not s.per_experiment:
                full[layout.index(parameter_name(s))] = value
                continue
            drawn = {}
            for e in campaign:
                q = rng.standard_normal()
                drawn[e.name] = float(value**q if s.kind == "log_normal" else value * q)
                full[layout.index(f"{parameter_name(s)}[{e.name}]")] = drawn[e.name]
            extended[c.effect][s.name] = drawn

    def with_them(k: int) -> tuple[FloatArray, FloatArray]:
        e = campaign.experiments[k]
        return model.mean_and_response(e.t, full, layout, e)

    return with_them, extended


def _unit_noise(
    n: int,
    phi: float,
    on_noise: Sequence[tuple[OnNoise, Mapping[str, float]]],
    rng: np.random.Generator,
) -> FloatArray:
    """Stationary AR(1) noise (n,) of unit variance; its innovations are an effect's, if any."""
    for act, own in on_noise:
        if act.innovations:
            e = act.innovations(n + BURN_IN, own, rng)
            coloured: FloatArray = lfilter([np.sqrt(1.0 - phi**2)], [1.0, -phi], e)
            return coloured[BURN_IN:]
    e = rng.standard_normal(n)
    e[1:] *= np.sqrt(1.0 - phi**2)
    noise: FloatArray = lfilter([1.0], [1.0, -phi], e)
    return noise
