"""The diagnosis of the sim-to-real gap: where, which, how far, and what may hide."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import replace
from functools import partial
from itertools import takewhile
from math import exp
from typing import TYPE_CHECKING, Any

import numpy as np

from bayes_sensor.campaign import Campaign, CampaignError, FloatArray
from bayes_sensor.diagnosis.closure import Closure, closure, held_out, taken_away
from bayes_sensor.diagnosis.data.preparation import (
    Prepared,
    fit_base,
    full_rate_residuals,
    prepare,
)
from bayes_sensor.diagnosis.effects import CATALOGUE, check_names
from bayes_sensor.diagnosis.effects.effect import Effect
from bayes_sensor.diagnosis.evidence.explained_excess import explained
from bayes_sensor.diagnosis.evidence.hypotheses import Hypothesis, Weighing, weigh
from bayes_sensor.diagnosis.evidence.refit import Refit
from bayes_sensor.diagnosis.gap import Gap, HiddenEffects, Round, Shrink, nameless, without_tau
from bayes_sensor.diagnosis.hidden import Hidden, what_may_hide
from bayes_sensor.diagnosis.isolability import Separation, confusable, what_would_separate
from bayes_sensor.diagnosis.location import (
    CLEAR,
    Map,
    locate,
    shared_by_explanations,
    shared_by_findings,
)
from bayes_sensor.diagnosis.signals.effect_signatures import courses
from bayes_sensor.diagnosis.signals.events import HEAVY_DOF, look_for_events
from bayes_sensor.diagnosis.signals.local_misfit import look_for_breaks, look_for_patches
from bayes_sensor.diagnosis.signals.plateau_noise import look_for_unsteadiness
from bayes_sensor.diagnosis.signals.ringing import look_for_ringing
from bayes_sensor.diagnosis.signals.spectral_lines import (
    look_for_bursts,
    look_for_lines,
    look_for_mains,
    look_for_swings,
    mains_closure,
    pieces_of_records,
)
from bayes_sensor.diagnosis.signals.tails_and_converter import (
    FOUND,
    LUMPY,
    OF_UNLISTED_ORIGIN,
    FullRate,
    look_at_tails,
    look_for_steps,
    rounds_away,
)
from bayes_sensor.diagnosis.signals.transient_lines import look_for_passing_lines
from bayes_sensor.diagnosis.verdict import NAMED, Standing, Verdict, judge, standing
from bayes_sensor.diagnosis.wording import (
    held_by_commands,
    looks_most,
    notes_on,
    sentence,
    units_of,
    without_a_step,
)
from bayes_sensor.fit.side_information import without_contradicted
from bayes_sensor.likelihood.problem import Problem
from bayes_sensor.rig.cascade import Cascade
from bayes_sensor.rig.layout import NOISE, SHARED, Layout, Theta
from bayes_sensor.workers import one_thread

if TYPE_CHECKING:
    from bayes_sensor.fit import Fit

BOOTSTRAP = 60
"""simulated campaigns behind the calibrated p-values and the interval of the closed fraction"""
MOST_ROUNDS = 3
"""effects added one after the other before the search ends"""
LIKELY = 0.02
"""probability from which an effect's look-alikes are listed"""
UNMOVED = 0.5
"""probability that nothing moves the mean from which no explanation tells where it is moved"""

MANY_HELD = 0.25
"""share of the switch times at their bounds from which commands are in doubt"""

Progress = Callable[[float, str], None]


@one_thread
def diagnose_gap(
    campaign: Campaign,
    fit: Fit | None = None,
    *,
    seed: int = 1,
    without: Iterable[str] = (),
    effects: Mapping[str, Effect] | Iterable[Effect] | None = None,
    nominal: Theta | None = None,
    bootstrap: int = BOOTSTRAP,
    jobs: int = 1,
    hidden: bool = True,
    separate: bool = True,
    follow: bool = True,
    progress: Progress | None = None,
) -> Gap:
    """Where the model misses the measurement, which effect causes it, how far that closes it.

    Parameters
    ----------
    campaign
        A measured campaign.
    fit
        Its least-squares fit, under any noise law, by either method, and with any effects beside
        the model: only what the model without effects has is taken from it.  Made here where none
        is given.
    without
        Names of effects to take out of the catalogue.
    effects
        Further effects of one's own (:func:`bayes_sensor.diagnosis.own_effect`), or a mapping that
        replaces the catalogue.
    nominal
        Parameters of the simulation before calibration, for the budget.
    bootstrap
        Simulated and refitted campaigns behind the p-values; 0: linearised ones.
    jobs
        Processes for what may hide; the numbers do not depend on it.
    hidden, separate
        Whether to work out what may hide, and what would tell look-alikes apart.
    follow
        Whether to look again after what was named has been added; the verdict does not rest on it.

    Raises
    ------
    CampaignError
        For a design without data, a fit of another campaign, unknown names in ``without``, or
        records without any quiet stretch to take the noise from.
    """
    tell = progress or (lambda _share, _text: None)
    if campaign.is_design:
        raise CampaignError(
            "gap: this is a design without data; expected a measured campaign: give every "
            "experiment a file, or simulate it first"
        )
    catalogue = _catalogue(effects, without)
    from bayes_sensor.fit import fit_least_squares
    from bayes_sensor.fit.identifiability import least_noise

    if fit is None:
        fit = fit_least_squares(campaign, seed=seed, euler=False)
    if fit.cannot_tell and fit.rms <= least_noise(campaign):  # a floor of nothing judges nothing
        raise CampaignError(f"gap: {fit.cannot_tell}")
    tell(0.02, "noise floor")
    campaign = without_contradicted(Problem(campaign), fit.side_information).campaign
    prepared = prepare(campaign, _mean_of(campaign, fit), fit.naming)
    sketch = prepared.sketch
    if not sketch.order_known:
        catalogue = {name: effect.nameless for name, effect in catalogue.items()}
    base = fit_base(sketch)
    full_rate = [
        f
        for f in map(partial(_without_mains, catalogue), _samples(prepared))
        if f.name in catalogue or f.name in OF_UNLISTED_ORIGIN
    ]
    tell(0.08, "where")
    located = locate(sketch, base, seed, bootstrap, courses(base, catalogue))
    weighing = weigh(sketch, base, catalogue, lambda s, t: tell(0.15 + 0.4 * s, t))
    full_rate += _events(prepared, weighing, full_rate)
    stand = standing(weighing, full_rate, catalogue)
    kind, named, family, probability = judge(weighing, stand, catalogue)
    best = _best(weighing, kind, named, stand, catalogue)
    located = _shared_out(located, weighing, full_rate, kind)
    tell(0.6, "what is left")
    rounds: list[Round] = []
    if follow and kind == "effect" and best.effects:
        rounds = _look_again(weighing, best, probability, catalogue, seed)
    tell(0.7, "how far")
    closed = closure(base, best.refit, weighing.discrepancies, seed, _others(weighing, best))
    shrink = _shrink(weighing, best, closed, catalogue, seed)
    if kind == "effect" and "mains_pickup" in named and not best.effects:
        shrink = _of_the_mains(shrink, prepared, full_rate)
    tell(0.85, "what may hide")
    accepted = best.refit if kind == "effect" else base
    found: list[Hidden] = []
    if hidden:
        found, envelope = what_may_hide(weighing, accepted, catalogue, jobs)
    else:
        spread = 1.96 * best.sd_log_tau
        envelope = (exp(best.log_tau - spread), exp(best.log_tau + spread))
    tell(0.93, "look-alikes")
    rows, separations = _rows(weighing, stand, full_rate, catalogue, closed, separate, kind, named)
    names, unit = [e.name for e in campaign], campaign.signal_unit
    said = sentence(kind, named, probability, weighing, stand, best, located, catalogue,
                    separations, shrink.closure, full_rate, envelope, unit)  # fmt: skip
    held = [n for n in fit.at_bound if n.startswith(("t0_s", "tf_s"))]
    switches = sum(1 + e.has_fall for e in campaign)
    if len(held) > MANY_HELD * switches:
        said = held_by_commands(len(held), switches, said)
    if not fit.step_seen:
        said = without_a_step(kind, said)
    beside = looks_most(full_rate, names, unit) if kind == "none" else []
    tell(1.0, "done")
    budget = _budget(campaign, prepared, base, located, nominal)
    may_hide = HiddenEffects(tuple(found), envelope)
    if not sketch.order_known:
        rows, budget = [without_tau(row) for row in rows], without_tau(budget)
        found = [nameless(each) for each in found]
        shrink, may_hide = nameless(shrink), nameless(HiddenEffects(tuple(found), envelope))
    return Gap(
        verdict=Verdict(kind, named, family, float(min(max(probability, 0.0), 1.0)), said),
        budget=budget,
        map=located,
        shrink=shrink,
        hidden=may_hide,
        rounds=tuple(rounds),
        separations=tuple(separations),
        full_rate=tuple(full_rate),
        weighing=weighing,
        standing=stand,
        rows=tuple(rows),
        strength_units=units_of(catalogue.values(), sketch.settings[0], unit),
        signal_unit=unit,
        notes=(*notes_on(sketch), *beside),
    )


def _mean_of(campaign: Campaign, fit: Fit) -> FloatArray:
    """The flat vector of a fit's parameters of the mean; noise is the diagnosis's own affair."""
    from bayes_sensor.fit.check_fit_matches import check_data_of_fit

    layout = Layout.of(campaign)
    n = layout.n_mean
    mean = list(takewhile(lambda name: not name.startswith(NOISE), fit.names))
    # the lags' own names depend on what is known of them
    if len(mean) != n or mean[len(SHARED) :] != layout.mean_names[len(SHARED) :]:
        raise CampaignError(
            f"gap: the fit has the parameters {', '.join(fit.names[:4])}, .., the campaign needs "
            f"{', '.join(layout.mean_names[:4])}, ..; fit this campaign first"
        )
    theta = np.asarray(fit.theta_hat, dtype=float)[:n]
    if all(name.startswith(NOISE) for name in fit.names[n:]):  # with effects it fits otherwise
        euler = Problem(campaign, model=Cascade("euler"))
        check_data_of_fit(Problem(campaign), replace(fit, theta_hat=theta), euler)
    return layout.flat(theta)


def _catalogue(
    effects: Mapping[str, Effect] | Iterable[Effect] | None, without: Iterable[str]
) -> dict[str, Effect]:
    if isinstance(effects, Mapping):
        catalogue = dict(effects)
    else:
        catalogue = dict(CATALOGUE)
        for effect in effects or ():
            if effect.name in catalogue:
                raise CampaignError(
                    f"gap: an effect '{effect.name}' is already in the catalogue; give your own "
                    "another name, or replace the catalogue by a mapping"
                )
            catalogue[effect.name] = effect
    for name in [without] if isinstance(without, str) else without:
        if name not in catalogue:
            check_names([name], "gap: without")
        catalogue.pop(name, None)
    return catalogue


# --------------------------------------------------------------------------- explanation


def _without_mains(catalogue: Mapping[str, Effect], found: FullRate) -> FullRate:
    """Where the mains are not in the catalogue, theirs is a line like any other."""
    if found.name != "mains_pickup" or found.name in catalogue:
        return found
    s = found.strength
    return replace(found, name="line", strength={"line_V": s["mains_V"], "line_Hz": s["mains_Hz"]})


def _samples(prepared: Prepared) -> list[FullRate]:
    """The mains, tails and the converter's steps, whatever explains the mean."""
    campaign, stretches = prepared.sketch.campaign, prepared.stretches
    coarse = look_for_steps(campaign, stretches)
    # on a coarse lattice the innovations are lumps, not tails: spread them over the step again
    step = coarse.strength["adc_step"] if coarse.log_bayes_factor > LUMPY else 0.0
    found = [look_at_tails(prepared.raw, step), coarse]
    if rounds_away(stretches, coarse.strength["adc_step"]):
        return found
    records = (campaign, prepared.residuals, prepared.deviations)
    mains = look_for_mains(*records)
    bursts = [b for found_there in mains for b in look_for_bursts(*records, found_there)]
    return [*mains, *bursts, *found]


def _events(
    prepared: Prepared, weighing: Weighing, full_rate: Sequence[FullRate]
) -> list[FullRate]:
    """Lines, events and ringing in what the best complete explanation leaves."""
    campaign = prepared.sketch.campaign
    step = max((f.strength.get("adc_step", 0.0) for f in full_rate), default=0.0)
    heavy = any(f.name == "heavy_tails" and f.probability > FOUND for f in full_rate)
    if rounds_away(prepared.stretches, step):
        return []
    best = weighing.likeliest.refit
    residuals = prepared.residuals_of(best)
    stretches = prepared.stretches_of(residuals)
    events = look_for_events(campaign, stretches, heavy)
    return [
        *look_for_lines(campaign, stretches),
        look_for_patches(best, residuals, prepared.quiet, events.lasting),
        look_for_breaks(best, events.lasting),
        events.found,
        look_for_ringing(campaign, residuals, prepared.quiet),
        *look_for_swings(campaign, residuals, prepared.deviations),
        *look_for_passing_lines(campaign, residuals, prepared.deviations),
        *(look_for_unsteadiness(campaign, stretches) if events.tails[0] >= HEAVY_DOF else []),
    ]


def _shared_out(located: Map, weighing: Weighing, full_rate: Sequence[FullRate], kind: str) -> Map:
    """Where the excess lies by all that explains it, or by what samples tell that nothing does.

    As measured where neither is there; nowhere where the verdict is that nothing exceeds the floor.
    """
    sketch = weighing.sketch
    clear = located.p_value_of_size < CLEAR
    if kind == "none" and not clear:
        return located
    keys = [h.key for h in weighing.hypotheses]
    if weighing.probabilities[keys.index("none")] < UNMOVED:
        return shared_by_explanations(located, sketch, explained(weighing))
    if kind != "unlisted":
        return located
    found = [f for f in full_rate if f.probability > FOUND]
    names = [e.name for e in sketch.campaign]
    places = [(names[p.experiment], p.time, p.size) for f in found for p in f.places]
    for f in found:
        if f.name == "unsteady" and not clear:
            on = [c for c in located.cells if c.phase == "plateau"]
            size = 2.0 * f.log_bayes_factor / sum(c.t_end_s - c.t_start_s for c in on)
            places += [(c.experiment, c.t_start_s, size * (c.t_end_s - c.t_start_s)) for c in on]
    return shared_by_findings(located, places)


def _best(
    weighing: Weighing,
    kind: str,
    named: Sequence[str],
    stand: Standing,
    catalogue: Mapping[str, Effect],
) -> Hypothesis:
    """The explanation that the verdict stands for; for unlisted the best effect, if any."""
    on_mean = {n for n in named if catalogue[n].on_mean}
    complete = weighing.complete
    if kind == "effect":
        # one that shares its response is there beside them, but is not named
        on_mean |= {n for n in catalogue if catalogue[n].same_response and stand.effects[n] > NAMED}
        fitting = [h for h in complete if set(h.effects) == on_mean]
        fitting = fitting or [h for h in complete if on_mean <= set(h.effects)]
        fitting = fitting or [h for h in complete if set(h.effects) & on_mean]
    elif kind == "family":
        fitting = [h for h in complete if h.effects and set(h.effects) <= on_mean]
    elif kind == "none":
        fitting = []
    else:
        fitting = complete
    if not fitting:  # what was named acts on the noise: the mean is the model's own
        fitting = [h for h in complete if not h.effects]
    return max(fitting, key=lambda h: h.log_weight)


def _others(weighing: Weighing, best: Hypothesis) -> list[tuple[Refit, float]]:
    """Every other complete explanation with its odds against ``best``."""
    return [
        (h.refit, exp(min(h.log_weight - best.log_weight, 30.0)))
        for h in weighing.complete
        if h is not best
    ]


def _look_again(
    weighing: Weighing,
    best: Hypothesis,
    probability: float,
    catalogue: Mapping[str, Effect],
    seed: int,
) -> list[Round]:
    """Add what was named and look again, until nothing is left or the rest is unlisted."""
    rounds: list[Round] = []
    sketch = weighing.sketch
    added, p = best.effects, probability
    while True:
        used = {catalogue[n].family for part in best.refit.plan.parts for n in [part.effect.name]}
        others = {n: e for n, e in catalogue.items() if e.family not in used}
        left = locate(sketch, best.refit, seed, courses=courses(best.refit, others))
        again = weigh(sketch, best.refit, others, pairs=False)
        stand = standing(again, [], others)
        rounds.append(Round(tuple(added), float(p), left.d, left.p_value, stand.unlisted))
        name = max(stand.effects, key=lambda n: stand.effects[n]) if stand.effects else None
        if (
            name is None
            or stand.effects[name] < 0.9
            or len(rounds) >= MOST_ROUNDS
            or left.p_value > CLEAR
        ):
            return rounds
        best = again.find(name)
        added, p = (name,), stand.effects[name]


def _shrink(
    weighing: Weighing,
    best: Hypothesis,
    closed: Closure,
    catalogue: Mapping[str, Effect],
    seed: int,
) -> Shrink:
    base = weighing.base
    out = None
    if best.effects and not closed.withheld:
        out = held_out(base, best.refit, seed)
    families = {catalogue[n].family for n in best.effects}
    rivals = [
        h
        for h in weighing.complete
        if len(h.effects) == 1 and catalogue[h.effects[0]].family not in families
    ]
    rival = max(rivals, key=lambda h: h.log_weight) if rivals and best.effects else None
    none = weighing.find()
    tau, low, high = _averaged_tau(weighing)
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
        rival_fraction_closed=_fraction(base, rival.refit, closed) if rival else None,
    )


def _fraction(base: Refit, fitted: Refit, closed: Closure) -> float | None:
    """What another explanation takes away of the gap whose whole size ``closed`` knows."""
    return None if closed.withheld else taken_away(base, fitted) / closed.d_before**2


def _of_the_mains(shrink: Shrink, prepared: Prepared, full_rate: Sequence[FullRate]) -> Shrink:
    """The gap that the mains make is one of power at their frequencies, not of the mean."""
    found = next(f for f in full_rate if f.name == "mains_pickup")
    pieces = pieces_of_records(prepared.sketch.campaign, prepared.residuals, prepared.deviations)
    closed, out = mains_closure(pieces, found)
    return replace(shrink, closure=closed, held_out_fraction_closed=out, explanation="mains_pickup")


def _averaged_tau(weighing: Weighing) -> tuple[float, float, float]:
    """Median and 95 % interval of tau over the explanations that hold 95 % of the probability."""
    p = weighing.probabilities
    order = np.argsort(-p)
    count = int(np.searchsorted(np.cumsum(p[order]), 0.95)) + 1
    kept = order[:count]
    weight = p[kept] / p[kept].sum()
    chosen = [weighing.hypotheses[i] for i in kept]
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


# --------------------------------------------------------------------------- the table


def _rows(
    weighing: Weighing,
    stand: Standing,
    full_rate: Sequence[FullRate],
    catalogue: Mapping[str, Effect],
    closed: Closure,
    separate: bool,
    kind: str,
    named: Sequence[str],
) -> tuple[list[dict[str, Any]], list[Separation]]:
    base = weighing.base
    sketch = weighing.sketch
    by_name = {f.name: f for f in full_rate}
    none = weighing.find()
    made, separations = [], []
    total = sum(stand.rows.values())
    ranked = sorted(stand.effects, key=lambda n: -stand.effects[n])
    looked = [n for n in ranked if catalogue[n].on_mean and stand.effects[n] > LIKELY][:3]
    for key, p in sorted(stand.rows.items(), key=lambda item: -item[1]):
        names = () if key in ("none", "unlisted") else tuple(key.split("+"))
        families = {catalogue[n].family for n in names}
        row: dict[str, Any] = {
            "effect": key,
            "family": families.pop() if len(families) == 1 else None,
            "probability": p / total,
            "d": None,
            "strength": {},
            "tau_s": None,
            "fraction_closed": None,
            "confusable_with": [],
            "rss_V2": None,
            "bic": None,
            "log_evidence_ratio": None,
            "misfit_left_sd": None,
        }
        if key == "none":
            row.update(_measures(none, none, base, closed), d=0.0)
        elif names:
            _fill(row, names, weighing, none, by_name, catalogue, closed)
            if separate and len(names) == 1 and names[0] in looked:
                h = weighing.find(names[0])
                row["confusable_with"] = [
                    n for n, _ in confusable(sketch, h.refit, names[0], catalogue)
                ]
        made.append(row)
    if separate and kind in ("family", "effect") and named:
        first = next((n for n in named if catalogue[n].on_mean), None)
        if first is not None and first in looked:
            alike = next(r["confusable_with"] for r in made if r["effect"] == first)
            if not sketch.order_known:  # no measurement of the response tells whose the lag is
                alike = [n for n in alike if n != catalogue[first].exchanged]
            h = weighing.find(first)
            # nothing tells what is one response apart: the next in likeness is worth a look, too
            most = 2 if alike[:1] == [catalogue[first].same_response] else 1
            separations = [
                what_would_separate(sketch, h.refit, first, rival, catalogue)
                for rival in alike[:most]
            ]
    return made, separations


def _fill(
    row: dict[str, Any],
    names: Sequence[str],
    weighing: Weighing,
    none: Hypothesis,
    by_name: Mapping[str, FullRate],
    catalogue: Mapping[str, Effect],
    closed: Closure,
) -> None:
    on_mean = [n for n in names if catalogue[n].on_mean]
    strength: dict[str, Any] = {}
    if on_mean:
        h = weighing.find(*on_mean)
        row.update(_measures(h, none, weighing.base, closed))
        strength.update(h.refit.strength())
    for n in names:
        if n in by_name:
            strength.update(by_name[n].strength)
            if not on_mean:
                row["d"] = by_name[n].d
                row["log_evidence_ratio"] = by_name[n].log_bayes_factor
                row["tau_s"] = exp(none.log_tau)
    row["strength"] = strength


def _measures(h: Hypothesis, none: Hypothesis, base: Refit, closed: Closure) -> dict[str, Any]:
    sketch = base.plan.sketch
    n = sketch.n_bins
    volts = [
        sketch.floor.cholesky[k] @ h.refit.residual[rows] for k, rows in enumerate(sketch.rows)
    ]
    rss = float(sum(np.sum(b.count * v**2) for b, v in zip(sketch.bins, volts, strict=True)))
    return {
        "d": float(np.sqrt(max(none.refit.misfit - h.refit.misfit, 0.0))),
        "tau_s": exp(h.log_tau),
        "fraction_closed": _fraction(base, h.refit, closed) if h.effects else None,
        "rss_V2": rss,
        "bic": float(n * np.log(max(rss, 1e-300) / n) + h.refit.plan.size * np.log(n)),
        "log_evidence_ratio": h.log_z - none.log_z,
        "misfit_left_sd": h.leftover,
    }


# --------------------------------------------------------------------------- budget


def _budget(
    campaign: Campaign, prepared: Prepared, base: Refit, located: Map, nominal: Theta | None
) -> dict[str, Any]:
    used = [r[e.used] for r, e in zip(prepared.residuals, campaign, strict=True)]
    calibrated = float(np.sqrt(np.mean(np.concatenate([u**2 for u in used]))))
    floor = [float(np.mean(s.samples**2) - np.mean(s.samples) ** 2) for s in prepared.stretches]
    weights = [len(s.samples) for s in prepared.stretches]
    before = None
    if nominal is not None:
        residuals = full_rate_residuals(campaign, Layout.of(campaign).flat(nominal))
        squares = [r[e.used] ** 2 for r, e in zip(residuals, campaign, strict=True)]
        before = float(np.sqrt(np.mean(np.concatenate(squares))))
    return {
        "nominal_rms_V": before,
        "calibrated_rms_V": calibrated,
        "noise_floor_rms_V": float(np.sqrt(np.average(floor, weights=weights))),
        "excess_rms_V": located.excess_rms,
        "excess_d": located.d,
        "p_value": located.p_value,
        "p_value_of_size": located.p_value_of_size,
        "p_value_of_form": located.p_value_of_form,
        "ar1_whiteness_p": ar1_whiteness(used),
        "spikes_replaced": prepared.sketch.floor.spikes,
        "tau_s": base.tau,
    }


def ar1_whiteness(residuals: Sequence[FloatArray], lags: int = 20) -> float:
    """Ljung-Box p-value of the innovations of an AR(1) fitted to every record (for comparison)."""
    from scipy.stats import chi2

    statistic, dof = 0.0, 0
    for r in residuals:
        if len(r) < 5 * lags or not np.any(r):
            continue
        x = r - r.mean()
        phi = float(x[1:] @ x[:-1]) / float(x @ x)
        e = x[1:] - phi * x[:-1]
        n = len(e)
        rho = np.array([float(e[k:] @ e[:-k]) for k in range(1, lags + 1)]) / float(e @ e)
        statistic += n * (n + 2.0) * float(np.sum(rho**2 / (n - np.arange(1, lags + 1))))
        dof += lags - 1
    return float(chi2.sf(statistic, dof)) if dof else 1.0
