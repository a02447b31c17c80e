"""An effect in the full model: for the posterior, for fits and for simulated campaigns.

The diagnosis works on bins; :class:`EffectModel` puts the same rig behind
:class:`bayes_sensor.likelihood.problem.Problem`, with the strengths as further parameters.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field, fields, replace
from functools import cached_property
from typing import Any

import numpy as np

from bayes_sensor.campaign import Campaign, CampaignError, Experiment, FloatArray
from bayes_sensor.diagnosis.effects import CATALOGUE, check_names
from bayes_sensor.diagnosis.effects.effect import Effect, Form, Strength
from bayes_sensor.diagnosis.effects.effects_of_rig import Possible
from bayes_sensor.diagnosis.effects.rig_view import RigView, check_settings, coating_modes
from bayes_sensor.diagnosis.effects.setting import Setting
from bayes_sensor.likelihood.priors import Prior
from bayes_sensor.likelihood.problem import Problem, as_problem
from bayes_sensor.rig.cascade import local_parameters
from bayes_sensor.rig.experiment_kernel import NEVER, ExperimentKernel
from bayes_sensor.rig.imperfections import FIRST, INDEX, NEUTRAL, T0, TF
from bayes_sensor.rig.lags import Assignment, Commuting
from bayes_sensor.rig.layout import Layout
from bayes_sensor.rig.perturbed import rig_mean, rig_response
from bayes_sensor.rig.switching import input_range

SUFFIX = {"1": "", "s": "_s", "V": "_V", "V/s": "_V_per_s", "1/V": "_per_V", "1/s": "_per_s"}
"""unit -> ending of a parameter's name"""


def parameter_name(strength: Strength) -> str:
    """The strength's name among the parameters, its unit at the end.

    >>> parameter_name(Strength("stroke", "s", "log_normal", 0.3, 1.0))
    'stroke_s'
    """
    ending = SUFFIX.get(strength.unit, "")
    return strength.name if strength.name.endswith(ending) else strength.name + ending


def prior_of(strength: Strength) -> Prior:
    """The strength's prior law; uniform where its limits are what bounds it."""
    low, high = strength.limits
    if strength.kind == "log_normal":
        return Prior("log_normal", strength.centre, strength.sd)
    if np.isfinite([low, high]).all() and high - low < 6.0 * strength.sd:
        return Prior("uniform", low, min(high, 1.0) if low == 0.0 else high)
    if low == strength.centre == 0.0:
        return Prior("half_normal", strength.sd)
    return Prior("normal", strength.centre, strength.sd)


def find_form(effect: Effect, name: str | None = None) -> Form:
    """A form by name; the first where none is given.  Raises CampaignError."""
    if not effect.forms:
        raise CampaignError(
            f"effect {effect.name} acts on the noise, not on the mean; expected an effect that "
            "has parameters of the model: leave it out"
        )
    if name is None:
        return effect.forms[0]
    for form in effect.forms:
        if form.name == name:
            return form
    known = ", ".join(f"'{f.name}'" for f in effect.forms if f.name)
    if not known:
        hint = f"it has one only: give {effect.name} alone"
    elif all(f.name for f in effect.forms):
        hint = f"known are {known}"
    else:
        hint = f"known are {known} and, given alone, {effect.name}"
    raise CampaignError(f"effect {effect.name} has no form '{name}'; {hint}")


@dataclass(frozen=True)
class Chosen:
    """An effect in one form, by name where it is in the catalogue."""

    effect: str
    form: str
    own: Effect | None = field(default=None, repr=False, compare=False)

    def __getstate__(self) -> dict[str, Any]:
        # forms hold functions without a name; the catalogue has them on the other side too
        return {"effect": self.effect, "form": self.form, "own": self.own}

    @cached_property
    def entry(self) -> Effect:
        """The effect."""
        return self.own if self.own is not None else CATALOGUE[self.effect]

    @cached_property
    def body(self) -> Form:
        """Its form."""
        return find_form(self.entry, self.form)


@dataclass(frozen=True)
class Scales:
    """What priors and forms are scaled with; fixed once for a campaign."""

    time_scale: float
    reference_flow: float
    signal_scale: float
    duration: float
    concentrations_before: Mapping[str, float] = field(default_factory=dict, hash=False)
    """by experiment"""

    @classmethod
    def of(cls, campaign: Campaign, theta: FloatArray | None = None) -> Scales:
        """From a fit (flat theta) or, without one, from the records themselves."""
        flow = float(np.median([e.total_flow for e in campaign])) if campaign.flows_known else 1.0
        duration = float(np.median([len(e.t) * e.interval for e in campaign]))
        names = campaign.names_of_experiments
        before = dict(zip(names, campaign.concentrations_before, strict=True))
        if theta is not None:
            layout = Layout.of(campaign)
            if not layout.is_published:
                return cls._of_chain(layout, theta, campaign, duration, before)
            tau, tau_v, volume = theta[layout.shared[0]].tolist()
            steps = [abs(float(theta[row[1]])) for row in layout.local]
            time_scale, signal = max(tau, tau_v, volume / flow), float(np.median(steps))
            return cls(time_scale, flow, signal, duration, before)
        from bayes_sensor.likelihood.rise_time import fastest_rise

        measured = [np.ptp(e.values[e.used]) for e in campaign if e.y is not None]
        signal = float(np.median(measured)) if measured else 1.88
        return cls(fastest_rise(campaign) / 2.2, flow, signal, duration, before)

    @classmethod
    def _of_chain(
        cls,
        layout: Layout,
        theta: FloatArray,
        campaign: Campaign,
        duration: float,
        before: Mapping[str, float],
    ) -> Scales:
        flow = float(np.median([e.total_flow for e in campaign])) if campaign.flows_known else 1.0
        slow = max(layout.slowest(theta, k, e.total_flow) for k, e in enumerate(campaign))
        low, high = input_range(layout.switching)
        steps = [abs(float(theta[row[1]])) * (high - low) for row in layout.local]
        return cls(slow, flow, float(np.median(steps)), duration, before)

    def setting(self, e: Experiment, t0: float, tf: float | None) -> Setting:
        """What a form may know of an experiment."""
        return Setting(
            experiment=e,
            t0=t0,
            tf=float(e.t[-1]) if tf is None else tf,
            time_scale=self.time_scale,
            reference_flow=self.reference_flow,
            signal_scale=self.signal_scale,
            duration=self.duration,
            concentration_before=self.concentrations_before.get(e.name, 0.0),
        )


@dataclass(frozen=True)
class EffectModel:
    """The cascade with effects, with the operations of ``Cascade``."""

    chosen: tuple[Chosen, ...]
    scales: Scales
    experiments: tuple[str, ...]
    reference: tuple[float, float]
    """t0 and tf of the first experiment, s: only for strengths that ask for them"""
    held: tuple[tuple[str, float], ...] = ()
    """strengths that are held at a value, not parameters"""
    assignment: Assignment | None = None
    """whose the lags are that theta holds by size; None: tau, tau_v and V stand there by name"""
    flow: float | None = None
    """mL/s, the common total flow, where V/Q is one of those lags"""

    def __getstate__(self) -> dict[str, Any]:
        return {f.name: getattr(self, f.name) for f in fields(self)}

    @cached_property
    def strengths(self) -> tuple[tuple[Strength, ...], ...]:
        """Per effect, its strengths."""
        # strengths depend on the scales alone
        blank = Experiment(
            "blank", np.array([0.0, self.scales.duration]), None, 1.0, 1.0, self.scales.duration
        )
        setting = self.scales.setting(blank, *self.reference)
        return tuple(tuple(c.body.strengths(setting)) for c in self.chosen)

    @cached_property
    def extra(self) -> tuple[str, ...]:
        """Names of the parameters that the effects bring along."""
        held = {name for name, _ in self.held}
        names = []
        for strengths in self.strengths:
            for s in strengths:
                if s.name in held:
                    continue
                name = parameter_name(s)
                names += [f"{name}[{e}]" for e in self.experiments] if s.per_experiment else [name]
        return tuple(names)

    @cached_property
    def priors(self) -> dict[str, Prior]:
        """Prior law of every extra parameter."""
        laws = {parameter_name(s): prior_of(s) for part in self.strengths for s in part}
        return {name: laws[name.split("[")[0]] for name in self.extra}

    @cached_property
    def affine(self) -> bool:
        """Whether the mean is linear in y0 and beta."""
        return all(c.body.mean is None and c.entry.affine for c in self.chosen)

    def values(self, theta: FloatArray, layout: Layout, name: str) -> list[dict[str, float]]:
        """Per effect, the strengths of one experiment."""
        held = dict(self.held)
        found = []
        for strengths in self.strengths:
            made = {}
            for s in strengths:
                if s.name in held:
                    made[s.name] = held[s.name]
                    continue
                key = parameter_name(s)
                key = f"{key}[{name}]" if s.per_experiment else key
                value = float(theta[layout.index(key)])
                made[s.name] = min(max(value, s.limits[0]), s.limits[1])
            found.append(made)
        return found

    def rig(
        self, theta: FloatArray, layout: Layout, e: Experiment
    ) -> tuple[FloatArray, list[tuple[Form, dict[str, float], Setting]]]:
        """The kernel's parameters, and the forms with a mean of their own."""
        shared = theta[: layout.n_shared]
        if self.assignment is not None:
            commuting = Commuting.among(self.assignment.names, layout.shared_names, self.flow)
            shared = commuting.named(theta, [self.assignment])
        kernel = kernel_of(layout, e)
        if kernel is None:
            p, t0, tf = _of_pulse(shared, theta, layout, e)
        else:
            k = layout.place_of(e.name)
            places = layout.local[k]
            p = kernel.parameters(shared[layout.shared[k]], theta[places[places >= 0]])
            t0, tf = float(p[T0]), float(p[TF]) if p[TF] < NEVER else None
        setting = self.scales.setting(e, t0, tf)
        own = []
        for c, values in zip(self.chosen, self.values(theta, layout, e.name), strict=True):
            settings = c.body.settings(values, setting)
            check_settings(c.effect, settings)
            for name, value in settings.items():
                p[FIRST + INDEX[name]] = value
            if c.body.mean is not None:
                own.append((c.body, values, setting))
        return p, own

    def mean_and_response(
        self, t: FloatArray, theta: FloatArray, layout: Layout, experiment: Experiment
    ) -> tuple[FloatArray, FloatArray]:
        """Mean (n_t,) V and x3 (n_t,) at any times."""
        t = np.asarray(t, dtype=float)
        order = np.argsort(t, kind="stable")
        at = np.ascontiguousarray(t[order])
        p, own = self.rig(theta, layout, experiment)
        modes = coating_modes()
        if len(at) == 0:
            return np.zeros(0), np.zeros(0)
        kernel = kernel_of(layout, experiment)
        if kernel is None:
            x, m = rig_response(at, p, *modes), rig_mean(at, p, *modes)
        else:
            x, m = kernel.response(at, p, modes), kernel.mean(at, p, modes)
        for form, values, setting in own:
            assert form.mean is not None
            m = np.asarray(form.mean(at, values, RigView(setting, p, kernel)), dtype=float)
        mean, response = np.empty_like(m), np.empty_like(x)
        mean[order], response[order] = m, x
        return mean, response

    def response(
        self, t: FloatArray, theta: FloatArray, layout: Layout, experiment: Experiment
    ) -> FloatArray:
        """x3 (n_t,), which scales the noise."""
        return self.mean_and_response(t, theta, layout, experiment)[1]

    def mean(
        self, t: FloatArray, theta: FloatArray, layout: Layout, experiment: Experiment
    ) -> FloatArray:
        """V (n_t,)."""
        return self.mean_and_response(t, theta, layout, experiment)[0]

    def kinks(
        self, low: FloatArray, high: FloatArray, layout: Layout, experiment: Experiment
    ) -> list[tuple[float, float]]:
        """Stretches (s) in which the baseline may jump for theta between ``low`` and ``high``."""
        found = []
        for i, c in enumerate(self.chosen):
            ends = []
            for theta in (low, high):
                setting = self.scales.setting(experiment, *_switches(theta, layout, experiment))
                values = self.values(theta, layout, experiment.name)[i]
                made = c.body.settings(values, setting)
                if "step" not in made:
                    break
                after = setting.tf if made.get("step_with_fall") else 0.0
                ends.append(after + made.get("step_time", 0.0))
            if ends:
                found.append((min(ends) - experiment.interval, max(ends) + experiment.interval))
        return found


def kernel_of(layout: Layout, e: Experiment) -> ExperimentKernel | None:
    """The kernel of an experiment; None for pulses on the published rig, which have one alone."""
    if layout.is_published:
        return None
    k = layout.place_of(e.name)
    return ExperimentKernel(layout.rigs[k], layout.switching[k], e)


def _of_pulse(
    shared: FloatArray, theta: FloatArray, layout: Layout, e: Experiment
) -> tuple[FloatArray, float, float | None]:
    """The published kernel's parameters, t0 and tf (None where no step down exists)."""
    y0, beta, t0, tf = local_parameters(theta, layout, e.name)
    p = np.empty(FIRST + len(NEUTRAL))
    p[FIRST:] = NEUTRAL
    tau, tau_v, volume = shared
    p[:FIRST] = (
        tau, tau_v, volume / e.total_flow, y0, beta, t0,
        NEVER if tf is None else tf, e.concentration, e.t[0] - 0.5 * e.interval,
        0.5 * (e.t[0] + e.t[-1]),
    )  # fmt: skip
    return p, t0, tf


def _switches(theta: FloatArray, layout: Layout, e: Experiment) -> tuple[float, float | None]:
    """s, when an experiment first switches, and when it last switches down."""
    kernel = kernel_of(layout, e)
    if kernel is None:
        return local_parameters(theta, layout, e.name)[2:]
    k = layout.place_of(e.name)
    return kernel.first_and_last(theta[layout.switches(k)])


def parse_effect(text: str, where: str = "effect") -> tuple[str, str | None]:
    """``NAME`` or ``NAME:FORM``.  Raises CampaignError for a name that is not in the catalogue."""
    name, _, form = text.partition(":")
    check_names([name], where)
    return name, form or None


def chosen_effects(
    texts: Iterable[str], own: Iterable[Effect], where: str
) -> dict[str, str | Effect]:
    """What every ``NAME[:FORM]`` stands for: itself for one of the catalogue, else one of ``own``.

    Raises CampaignError for one that cannot be put into the model, and where none is chosen.
    """
    mine = {effect.name: effect for effect in own}
    chosen: dict[str, str | Effect] = {}
    for text in texts:
        if text in chosen:
            raise CampaignError(f"effect {text} is given twice; name it once")
        if text in mine:
            find_form(mine[text])
            chosen[text] = mine[text]
            continue
        name, form = parse_effect(text, where)
        find_form(CATALOGUE[name], form)
        chosen[text] = text
    if not chosen:
        raise CampaignError(f"{where}: expected one of your own effects: {', '.join(mine)}")
    return chosen


Given = str | Effect | Form
"""an effect as a user gives it: ``NAME`` or ``NAME:FORM`` of the catalogue, an effect of one's own,
or one of its forms"""


def listed(given: Given | Iterable[Given], where: str) -> list[str | Effect]:
    """One effect or several, as names and effects.

    Raises CampaignError for what is no effect, and for a name that is not in the catalogue.
    """
    if isinstance(given, Given) or not isinstance(given, Iterable):
        given = [given]
    return [_name_or_effect(each, where) for each in given]


def _name_or_effect(given: Given, where: str) -> str | Effect:
    if isinstance(given, str):
        parse_effect(given, where)
    if isinstance(given, str | Effect):
        return given
    if not isinstance(given, Form):
        raise CampaignError(
            f"{where}: expected a name of the catalogue or an effect of one's own, but got a "
            f"{type(given).__name__}; make an effect with bayes_sensor.own_effect"
        )
    for effect in CATALOGUE.values():
        if given in effect.forms:
            return f"{effect.name}:{given.name}" if given.name else effect.name
    name = given.name or "own"
    return Effect(name, name, "", {}, "user's own", "", forms=(given,))


def with_effects(
    problem: Campaign | Problem,
    effects: Given | Iterable[Given],
    theta: FloatArray | None = None,
    held: Mapping[str, float] | None = None,
) -> Problem:
    """The problem with effects in its model and priors on their strengths.

    ``effects``: names (``NAME`` or ``NAME:FORM``), effects of one's own or forms, one or several;
    ``theta``: flat parameters of a fit that scale the priors.  Where nobody knows whose the lags
    are, the shorter one is taken for the sensor's.

    Raises
    ------
    CampaignError
        For unknown names and for effects that act on the noise.
    """
    problem = as_problem(problem)
    campaign = problem.campaign
    chosen: list[Chosen] = []
    if isinstance(problem.model, EffectModel):
        chosen += problem.model.chosen
    elif problem.chain is None:
        raise CampaignError("effects can only be added to the cascade; this problem has a model of "
                            "its own: start from Problem(campaign)")  # fmt: skip
    for effect in listed(effects, "effects"):
        name, form = parse_effect(effect) if isinstance(effect, str) else (effect.name, None)
        own = None if isinstance(effect, str) or effect is CATALOGUE.get(name) else effect
        body = find_form(own or CATALOGUE[name], form)
        if name in [c.effect for c in chosen]:
            raise CampaignError(f"effect {name} is given twice; name it once")
        chosen.append(Chosen(name, body.name, own))
    scales = Scales.of(campaign, theta)
    possible = Possible.of(campaign)
    for c in chosen:
        possible.check(c.entry, c.body, scales.setting(campaign.experiments[0], 0.0, None))
    first = campaign.experiments[0]
    on = first.commanded_on if first.commanded_on is not None else float(first.t[0])
    off = first.commanded_off if first.commanded_off is not None else float(first.t[-1])
    naming = problem.naming(None if theta is None else problem.shares(theta))
    model = EffectModel(
        chosen=tuple(chosen),
        scales=scales,
        experiments=tuple(campaign.names_of_experiments),
        reference=(on, off),
        held=tuple(sorted((held or {}).items())),
        assignment=naming.exchanged,
        flow=naming.flow,
    )
    given = {**problem.given_priors, **model.priors}
    return replace(problem, model=model, given_priors=given)  # type: ignore[arg-type]
