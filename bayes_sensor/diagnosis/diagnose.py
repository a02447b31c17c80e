"""The diagnosis of the sim-to-real gap: where, which, how far, and what may hide."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from dataclasses import replace
from itertools import takewhile
from typing import TYPE_CHECKING

import numpy as np

from bayes_sensor.campaign import Campaign, CampaignError, FloatArray
from bayes_sensor.diagnosis.budget import gap_budget
from bayes_sensor.diagnosis.closure import closure, shrinking, shrinking_of_noise
from bayes_sensor.diagnosis.data.preparation import fit_base, prepare
from bayes_sensor.diagnosis.discrepancy_posterior import tau_with_discrepancy
from bayes_sensor.diagnosis.effects import CATALOGUE, check_names
from bayes_sensor.diagnosis.effects.effect import Effect
from bayes_sensor.diagnosis.effects.effect_model import listed, parse_effect
from bayes_sensor.diagnosis.effects.effects_of_rig import Possible
from bayes_sensor.diagnosis.evidence.compared_hypotheses import Comparison, Hypothesis
from bayes_sensor.diagnosis.evidence.hypotheses import compare_hypotheses
from bayes_sensor.diagnosis.excess_shares import distribute_excess
from bayes_sensor.diagnosis.explanations_table import explanation_rows
from bayes_sensor.diagnosis.gap import Gap, Round, without_lag_names
from bayes_sensor.diagnosis.isolability import look_alikes, separate_pairs
from bayes_sensor.diagnosis.location import CLEAR, locate, with_findings
from bayes_sensor.diagnosis.onset_times import onset_times
from bayes_sensor.diagnosis.probabilities import combine
from bayes_sensor.diagnosis.signals import look_for_signals
from bayes_sensor.diagnosis.signals.effect_signatures import signatures
from bayes_sensor.diagnosis.unseen_effects import HiddenEffects, hidden_effects
from bayes_sensor.diagnosis.verdict import NAMED, NAMED_ELSEWHERE, Verdict, explanation_of, judge
from bayes_sensor.diagnosis.wording import Conclusion, notes, units_of, verdict_sentence
from bayes_sensor.fit.side_information import without_contradicted
from bayes_sensor.likelihood.held_values import refuse_held
from bayes_sensor.likelihood.problem import Problem, as_problem
from bayes_sensor.rig.cascade import Cascade
from bayes_sensor.rig.layout import NOISE, Layout, Theta
from bayes_sensor.workers import one_thread

if TYPE_CHECKING:
    from bayes_sensor.fit import Fit

BOOTSTRAP = 60
"""simulated campaigns behind the calibrated p-values and the interval of the closed fraction"""
MOST_SWITCHES = 60
"""in a record: bins are made around each of them"""
MOST_ROUNDS = 3
"""effects added one after the other before the search ends"""

Progress = Callable[[float, str], None]


def cannot_diagnose(campaign: Campaign) -> str:
    """Why the diagnosis knows no effects for a campaign's rig; empty where it does."""
    layout = Layout.of(campaign)
    most = max(len(each.heights) for each in layout.switching)
    if most > MOST_SWITCHES:
        return (
            f"a record has {most} switches, and at most {MOST_SWITCHES} are diagnosed; expected "
            "fewer: take a part of the record (keep); fit, posterior, bounds and report serve all"
        )
    return ""


@one_thread
def diagnose_gap(
    campaign: Campaign | Problem,
    fit: Fit | None = None,
    *,
    seed: int = 1,
    without: Iterable[str] = (),
    effects: Mapping[str, Effect] | Effect | Iterable[Effect] | None = None,
    nominal: Theta | None = None,
    bootstrap: int = BOOTSTRAP,
    jobs: int = 1,
    hidden: bool = True,
    separate: bool = True,
    follow: bool = True,
    progress: Progress | None = None,
) -> Gap:
    """Where the model misses the measurement, which effect explains it, how much that closes.

    Parameters
    ----------
    campaign
        A measured campaign, or a Problem.  Of a Problem's own priors and noise law only the fit
        that is made here knows; the diagnosis takes the noise from the records.
    fit
        Its least-squares fit, under any noise law, by either method, and with any effects beside
        the model: only the parameters of the model without effects are used.  None: the fit is
        made here.
    without
        Names of effects to take out of the catalogue.
    effects
        A further effect of one's own (:func:`bayes_sensor.own_effect`) or several, or a mapping
        that replaces the catalogue.
    nominal
        Parameters of the simulation before calibration, for the budget.
    bootstrap
        Number of campaigns that are simulated and refitted to calibrate the p-values; 0 uses the
        linearised refit.
    jobs
        Number of processes for the unseen effects; the numbers do not depend on it.
    hidden, separate
        Whether to compute the unseen effects, and which measurement would separate look-alikes.
    follow
        Whether to repeat the search with the named effect in the model; the verdict does not rest
        on it.

    Raises
    ------
    CampaignError
        For a design without data, a Problem in which parameters are held, a fit of another
        campaign, unknown names in ``without``, or records without any quiet stretch to take the
        noise from.
    """
    tell = progress or (lambda _share, _text: None)
    problem = as_problem(campaign)
    refuse_held(problem, "gap")
    campaign = problem.campaign
    if campaign.is_design:
        raise CampaignError(
            "gap: this is a design without data; expected a measured campaign: give every "
            "experiment a file, or simulate it first"
        )
    refused = cannot_diagnose(campaign)
    if refused:
        raise CampaignError(f"gap: {refused}")
    catalogue = _catalogue(effects, without)
    fit = _usable_fit(problem, fit, seed)

    tell(0.02, "noise floor")
    campaign = without_contradicted(Problem(campaign), fit.side_information).campaign
    prepared = prepare(campaign, _mean_of(campaign, fit), fit.naming)
    binned = prepared.binned
    catalogue = Possible.of(campaign).effects(catalogue, binned.settings[0])
    if not binned.order_known:
        catalogue = {name: effect.nameless for name, effect in catalogue.items()}
    base = fit_base(binned)

    tell(0.08, "where")
    excess = locate(binned, base, seed, bootstrap, signatures(base, catalogue))
    comparison = compare_hypotheses(binned, base, catalogue, lambda s, t: tell(0.15 + 0.4 * s, t))
    samples = prepared.samples(comparison.likeliest.refit)
    findings = look_for_signals(samples, catalogue)
    probabilities = combine(comparison, findings, catalogue)
    excess = with_findings(excess, findings)
    least = NAMED if binned.chain is None else NAMED_ELSEWHERE
    judgement = judge(probabilities, excess.p_value, least)
    best = explanation_of(comparison, judgement)
    excess = distribute_excess(excess, comparison, samples, findings, judgement.kind)

    tell(0.6, "what is left")
    named = judgement.kind == "effect"
    rounds: list[Round] = []
    if follow and named and best.effects:
        rounds = _look_again(comparison, best, judgement.probability, catalogue, seed)

    tell(0.7, "how far")
    closed = closure(base, best.refit, comparison.discrepancies, seed, comparison.others(best))
    shrink = shrinking(comparison, best, closed, seed)
    if judgement.effects and not best.effects:
        shrink = shrinking_of_noise(shrink, judgement.effects, catalogue, samples, findings)

    tell(0.85, "what may hide")
    hides = HiddenEffects((), best.tau_interval, binned.stated_lag)
    if hidden:
        hides = hidden_effects(comparison, best.refit if named else base, catalogue, jobs)

    tell(0.93, "look-alikes")
    alike = look_alikes(comparison, probabilities, catalogue) if separate else {}
    separations = separate_pairs(comparison, judgement, alike) if separate else []
    rows = explanation_rows(comparison, probabilities, findings, closed, alike)
    conclusion = Conclusion(
        judgement, comparison, probabilities, best, excess, shrink.closure, findings, separations,
        hides.tau_envelope_s or (0.0, 0.0), campaign.signal_unit,
    )  # fmt: skip
    tell(1.0, "done")
    kind, effects_named, family, probability = judgement
    gap = Gap(
        verdict=Verdict(
            kind,
            effects_named,
            family,
            probability,
            verdict_sentence(conclusion, fit),
            onset_times(judgement, best.refit, base, findings),
        ),
        budget=gap_budget(campaign, prepared, base, excess, nominal),
        map=excess,
        shrink=shrink,
        hidden=hides,
        rounds=tuple(rounds),
        separations=tuple(separations),
        findings=tuple(findings),
        comparison=comparison,
        probabilities=probabilities,
        rows=tuple(rows),
        strength_units=units_of(catalogue.values(), binned.settings[0], campaign.signal_unit),
        tau_with_discrepancy_s=tau_with_discrepancy(comparison),
        signal_unit=campaign.signal_unit,
        notes=tuple(notes(conclusion)),
        experiments=tuple(e.name for e in binned.campaign),
    )
    return gap if binned.order_known else without_lag_names(gap)


def _usable_fit(problem: Problem, fit: Fit | None, seed: int) -> Fit:
    """The fit, made where none is given.  Raises CampaignError where it leaves no noise."""
    from bayes_sensor.fit.identifiability import least_noise
    from bayes_sensor.fit.least_squares import fit_or_given

    fit = fit_or_given(problem, fit, seed, "gap")
    if fit.cannot_tell and fit.rms <= least_noise(problem.campaign):  # no floor, no misfit
        raise CampaignError(f"gap: {fit.cannot_tell}")
    return fit


def _mean_of(campaign: Campaign, fit: Fit) -> FloatArray:
    """The flat vector of a fit's parameters of the mean; noise is the diagnosis's own affair."""
    from bayes_sensor.fit.check_fit_matches import check_data_of_fit

    layout = Layout.of(campaign)
    n = layout.n_mean
    mean = list(takewhile(lambda name: not name.startswith(NOISE), fit.names))
    # the lags' own names depend on what is known of them
    first = layout.n_shared
    if len(mean) != n or mean[first:] != layout.mean_names[first:]:
        raise CampaignError(
            f"gap: the fit has the parameters {', '.join(fit.names[:4])}, .., the campaign needs "
            f"{', '.join(layout.mean_names[:4])}, ..; fit this campaign first"
        )
    theta = np.asarray(fit.theta_hat, dtype=float)[:n]
    if all(name.startswith(NOISE) for name in fit.names[n:]):  # with effects it fits otherwise
        both = [Problem(campaign)]
        if layout.is_published:
            both.append(Problem(campaign, model=Cascade("euler")))
        check_data_of_fit(both[0], replace(fit, theta_hat=theta), *both[1:])
    return layout.flat(theta)


def _catalogue(
    effects: Mapping[str, Effect] | Effect | Iterable[Effect] | None, without: Iterable[str]
) -> dict[str, Effect]:
    if isinstance(effects, Mapping):
        listed(effects.values(), "gap: effects")
        catalogue = dict(effects)
    else:
        catalogue = dict(CATALOGUE)
        for effect in listed(effects or (), "gap: effects"):
            name = parse_effect(effect)[0] if isinstance(effect, str) else effect.name
            if isinstance(effect, str) or name in catalogue:
                raise CampaignError(
                    f"gap: an effect '{name}' is already in the catalogue; give your own "
                    "another name, or replace the catalogue by a mapping"
                )
            catalogue[name] = effect
    for name in [without] if isinstance(without, str) else without:
        if name not in catalogue:
            check_names([name], "gap: without")
        catalogue.pop(name, None)
    return catalogue


def _look_again(
    comparison: Comparison,
    best: Hypothesis,
    probability: float,
    catalogue: Mapping[str, Effect],
    seed: int,
) -> list[Round]:
    """Add what was named and look again, until nothing is left or the rest is unlisted."""
    rounds: list[Round] = []
    binned = comparison.binned
    added, p = best.effects, probability
    while True:
        used = {catalogue[n].family for part in best.refit.coords.parts for n in [part.effect.name]}
        others = {n: e for n, e in catalogue.items() if e.family not in used}
        left = locate(binned, best.refit, seed, signatures=signatures(best.refit, others))
        again = compare_hypotheses(binned, best.refit, others, pairs=False)
        combined = combine(again, [], others)
        rounds.append(Round(tuple(added), float(p), left.d, left.p_value, combined.unlisted))
        name = (
            max(combined.effects, key=lambda n: combined.effects[n]) if combined.effects else None
        )
        if (
            name is None
            or combined.effects[name] < NAMED
            or len(rounds) >= MOST_ROUNDS
            or left.p_value > CLEAR
        ):
            return rounds
        best = again.find(name)
        added, p = (name,), combined.effects[name]
