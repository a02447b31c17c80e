"""Real measurements from another rig: what the diagnosis finds, and whether its cure holds.

Two campaigns of a photo-ionisation detector behind valves, flow controllers and tubing
(github.com/raacampbell/airdilutionolfactometer, LGPL-3.0), which are not part of this repository:
the folder that holds ``pid_dilution_steps/`` and ``pid_flow_matrix/`` is read from the environment
variable ``BAYES_SENSOR_REAL``; where that is not set, the committed tables stay as they are.

Every other concentration, with all its flows, serves to choose: the traces are diagnosed, and an
effect is put together from physically motivated pieces, one after the other, as long as the
evidence grows.  The remaining traces judge: tau, tau_v, V and all shared strengths are frozen, and
only what belongs to a trace (y0, beta, t0, tf and, where chosen, when its pulse arrives) is fitted.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import product
from math import exp
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from drawing import ACCENT, INK, TABLES, WIDTH, plt, save

from bayes_sensor.campaign import Campaign, FloatArray
from bayes_sensor.diagnosis import CATALOGUE, Effect, RigView, Strength, diagnose_gap, own_effect
from bayes_sensor.diagnosis.closure import closure
from bayes_sensor.diagnosis.data.binned_campaign import BinnedCampaign
from bayes_sensor.diagnosis.data.bins import PHASES, QUADRATURE, ExperimentBins
from bayes_sensor.diagnosis.data.noise_floor import estimate_floor
from bayes_sensor.diagnosis.data.preparation import (
    PreparedCampaign,
    fit_base,
    full_rate_residuals,
    prepare,
)
from bayes_sensor.diagnosis.data.quiet_stretches import quiet_stretches
from bayes_sensor.diagnosis.evidence.coordinate_priors import Part
from bayes_sensor.diagnosis.evidence.hypotheses import compare_hypotheses, fit_effect
from bayes_sensor.diagnosis.evidence.laplace_evidence import Linearised
from bayes_sensor.diagnosis.evidence.refit import Refit, refit
from bayes_sensor.diagnosis.evidence.refit_coordinates import Coordinates
from bayes_sensor.diagnosis.location import locate
from bayes_sensor.diagnosis.probabilities import combine
from bayes_sensor.diagnosis.signals.effect_signatures import signatures
from bayes_sensor.diagnosis.verdict import judge
from bayes_sensor.fit import fit_least_squares
from bayes_sensor.io.readers import read_campaign
from bayes_sensor.rig.cascade import cascade_response
from bayes_sensor.rig.layout import Layout

WHERE = "BAYES_SENSOR_REAL"
SHOWN = {
    "pid_dilution_steps": ("f0.1585", "f0.0501", "f0.2818", "f0.0282"),
    "pid_flow_matrix": ("f0.125_q0.25", "f0.025_q0.25", "f0.1_q0.25", "f0.05_q1"),
}
"""campaign -> traces of the figure"""
LOWEST_FLOW = 250.0 / 60.0
"""mL/s, the lowest total flow of the flow matrix"""
ENOUGH = 5.0
"""gain of ln evidence below which no further piece is added"""
VISIBLE_STEP = 0.02
"""of the largest step: the delay of a smaller one says nothing"""
MOST_STEPS = 80
"""of a refit: an evidence is only one at an optimum"""
CLEAR = 100.0
"""excess of a held-out trace from which its own closed fraction is counted"""
RESAMPLES = 4000
SEED = 5


# --------------------------------------------------------------------------- pieces of an effect


@dataclass(frozen=True)
class Piece:
    """Something that may be wrong with the rig; effects are put together from these."""

    name: str
    words: str
    strengths: tuple[Strength, ...]
    kind: str = ""
    """of one kind only one piece may be chosen"""
    needs: str = ""
    """the kind that must have been chosen before"""


def _log(name: str, unit: str, centre: float, sd: float) -> Strength:
    # beyond three spreads a piece would no longer be what its words say
    limits = centre * exp(-3.0 * sd), centre * exp(3.0 * sd)
    return Strength(name, unit, "log_normal", centre, sd, limits=limits)


PULSE = (
    _log("pulse_delay", "s", 0.4, 0.3), _log("pulse_rise", "s", 0.04, 0.7),
    _log("pulse_decay", "s", 0.2, 0.7),
)  # fmt: skip
LINE = Piece("line", "a mixing volume in the odour's own line", (_log("line_mL", "mL", 0.1, 1.5),),
             "line")  # fmt: skip
LINE_POWER = Piece("power", "whose lag follows another power of the odour's flow",
                   (Strength("line_power", "1", "normal", 1.0, 0.4),), needs="line")  # fmt: skip
DISPERSION = Piece(
    "tank", "part of the volume in a second tank",
    (Strength("second_tank", "1", "normal", 0.15, 0.15, limits=(0.0, 0.9)),),
)  # fmt: skip
PIECES = {
    "pid_dilution_steps": (
        Piece("same", "a pulse of vapour after the command, alike in all traces",
              (_log("pulse_V", "V", 1.0, 1.0), *PULSE), "pulse"),
        Piece("step", "a pulse of vapour after the command, in proportion to the step",
              (_log("pulse_share", "1", 0.5, 1.0), *PULSE), "pulse"),
        Piece("saturating", "a pulse of vapour after the command that saturates with the flow",
              (_log("pulse_V", "V", 1.0, 1.0), _log("half_flow", "mL/s", 0.3, 1.5), *PULSE),
              "pulse"),
        Piece("tail", "with a slow tail",
              (Strength("tail_share", "1", "normal", 0.2, 0.2, limits=(0.0, 1.0)),
               _log("tail_decay", "s", 1.0, 0.7)), needs="pulse"),
        Piece("arrival", "that arrives a little early or late in each trace",
              (Strength("arrival", "s", "normal", 0.0, 0.03, per_experiment=True),),
              needs="pulse"),
        LINE, DISPERSION,
    ),
    "pid_flow_matrix": (
        Piece("bolus", "vapour collected before the step that arrives with it at low flow",
              (_log("bolus_V", "V", 0.1, 1.0), _log("bolus_decay", "s", 0.6, 0.7),
               _log("flow_power", "1", 4.0, 0.7)), "overshoot"),
        Piece("settling", "an odour flow that overshoots and settles at low total flow",
              (_log("overshoot", "1", 0.3, 1.0), _log("bolus_decay", "s", 0.6, 0.7),
               _log("flow_power", "1", 4.0, 0.7)), "overshoot"),
        LINE, LINE_POWER, DISPERSION,
    ),
}  # fmt: skip


def pulse(t: FloatArray, s: Mapping[str, float], rig: RigView) -> FloatArray:
    """V (n_t,): a pulse locked to the command, height (1 - exp -(s/rise)^2) times its decay."""
    e = rig.experiment
    on = e.commanded_on if e.commanded_on is not None else rig.t0
    since = np.maximum(t - on - s["pulse_delay"] - s.get("arrival", 0.0), 0.0)
    share = s.get("tail_share", 0.0)
    decay = (1.0 - share) * np.exp(-since / s["pulse_decay"])
    if share > 0.0:
        decay = decay + share * np.exp(-since / s["tail_decay"])
    if "pulse_share" in s:
        height = s["pulse_share"] * rig.beta
    else:
        height = s["pulse_V"]
        if "half_flow" in s:
            height *= e.test_gas_flow / (e.test_gas_flow + s["half_flow"])
    return height * decay * (1.0 - np.exp(-((since / s["pulse_rise"]) ** 2)))


def mean(t: FloatArray, s: Mapping[str, float], rig: RigView) -> FloatArray:
    """V (n_t,): the rig with all the pieces whose strengths are given."""
    e = rig.experiment
    settings: dict[str, float] = {}
    if "line_mL" in s:
        settings["filter"] = s["line_mL"] * e.test_gas_flow ** -s.get("line_power", 1.0)
    if "second_tank" in s:
        settings["tank_share"] = s["second_tank"]
    scale = (LOWEST_FLOW / e.total_flow) ** s.get("flow_power", 0.0)
    if "overshoot" in s:
        settings["settling_share"] = -s["overshoot"] * scale
        settings["settling_time"] = s["bolus_decay"]
    made = rig.mean(t, **settings)
    if "bolus_V" in s:
        since = np.maximum(t - rig.t0, 0.0)
        passing = rig.response(t, **settings) * np.exp(-since / s["bolus_decay"])
        made = made + s["bolus_V"] * scale * passing
    if "pulse_delay" in s:
        made = made + pulse(t, s, rig)
    return made


def effect_of(pieces: Sequence[Piece], start: Mapping[str, float]) -> Effect:
    """The pieces as one effect, from whose strengths fits begin at ``start``."""
    return own_effect(
        "_".join(p.name for p in pieces),
        [s for p in pieces for s in p.strengths],
        mean,
        plausible={s.name: s.value(0.0) for p in pieces for s in p.strengths},
        starts=(dict(start),),
        sentence="; ".join(p.words for p in pieces) + ": {strength}.",
    )


# --------------------------------------------------------------------------- the two halves


def halves(campaign: Campaign) -> tuple[Campaign, Campaign]:
    """The choosing and the held-out half: concentrations alternate, from the highest."""
    level = {e.name: round(e.concentration, 5) for e in campaign}
    order = sorted(set(level.values()), reverse=True)
    return tuple(
        replace(
            campaign,
            experiments=tuple(e for e in campaign if order.index(level[e.name]) % 2 == side),
        )
        for side in (0, 1)
    )  # type: ignore[return-value]


def finer(prepared: PreparedCampaign) -> BinnedCampaign:
    """The sketch with bins after the command of at most 40 ms or a tenth of the time since it.

    The usual bins are fine around the step alone; here it comes up to seconds after the command.
    """
    binned, theta = prepared.binned, prepared.theta
    campaign = binned.campaign
    layout = Layout.of(campaign)
    raw = full_rate_residuals(campaign, theta)
    bins, data, levels = [], [], []
    for k, (e, b, r) in enumerate(zip(campaign, binned.bins, prepared.residuals)):
        made = _cut(b, e.commanded_on if e.commanded_on is not None else float(e.t[0]))
        taus = np.array([theta[1], theta[2] / e.total_flow, theta[0]])
        _, _, i_t0, i_tf = layout.local[k]
        x = cascade_response(
            made.times, taus, float(theta[i_t0]), float(theta[i_tf]) if i_tf >= 0 else None
        )
        bins.append(made)
        data.append(made.average(np.where(e.used, e.values - raw[k] + r, 0.0)))
        levels.append(made.reduce(x))
    fits = [e.values - r for e, r in zip(campaign, raw)]
    stretches = quiet_stretches(campaign, prepared.residuals, bins, prepared.settle)
    floor = estimate_floor(
        campaign, prepared.residuals, bins, stretches, levels, binned.floor.spikes, fits
    )
    return replace(binned, bins=tuple(bins), data=tuple(data), floor=floor)


def _cut(b: ExperimentBins, command: float) -> ExperimentBins:
    t = b.experiment.t
    first, last, source = [], [], []
    for i, (a, z) in enumerate(zip(b.first, b.last)):
        since = float(t[a]) - command
        longest = max(0.04, 0.1 * since) if since > -0.04 else np.inf
        n = max(int(np.ceil(float(t[z - 1] - t[a]) / longest)), 1)
        edges = np.unique(np.rint(np.linspace(a, z, n + 1)).astype(int))
        first += list(edges[:-1])
        last += list(edges[1:])
        source += [i] * (len(edges) - 1)
    begin, end = np.array(first), np.array(last)
    x, w = QUADRATURE
    half = 0.5 * b.experiment.interval
    times, weights, starts = [], [], []
    at = 0
    for a, z in zip(begin, end):
        starts.append(at)
        if z - a <= len(x) + 1:
            times.append(t[a:z])
            weights.append(np.full(z - a, 1.0 / (z - a)))
        else:
            low, high = t[a] - half, t[z - 1] + half
            times.append(0.5 * (low + high) + 0.5 * (high - low) * x)
            weights.append(0.5 * w)
        at += len(times[-1])
    index = np.array(source)
    moved = 0.5 * (t[begin] + t[end - 1]) - b.centre[index]
    return replace(
        b, first=begin, last=end, times=np.concatenate(times), weights=np.concatenate(weights),
        starts=np.array(starts), phase=b.phase[index], since=b.since[index] + moved,
        falling=b.falling[index],
    )  # fmt: skip


# --------------------------------------------------------------------------- choosing


def choose(
    binned: BinnedCampaign, base: Refit, pieces: Sequence[Piece]
) -> tuple[list[Any], Refit, Effect]:
    """Pieces added one by one while the evidence grows: all that was tried, the best, its effect.

    Raises ValueError where no piece helps.
    """
    chosen: list[Piece] = []
    best, effect = base, None
    log_z = Linearised(base).evidence(None).log_z
    tried: list[Any] = [("none", log_z, base.misfit, True)]
    while True:
        kinds = {p.kind for p in chosen if p.kind}
        open_ = [
            p for p in pieces
            if p not in chosen and p.kind not in kinds and (not p.needs or p.needs in kinds)
        ]  # fmt: skip
        known = {k: v for k, v in best.strength().items() if not isinstance(v, Mapping)}
        found = []
        for p in open_:
            candidate = effect_of([*chosen, p], known)
            form = candidate.forms[0]
            parts = [Part(candidate, form)]
            fitted = fit_effect(binned, base, parts, form.starts)
            fitted = min(
                (refit(fitted.coords, x, most_steps=MOST_STEPS)
                 for x in (fitted.x, continued(fitted.coords, best, base, known))),
                key=lambda r: r.objective,
            )  # fmt: skip
            gained = Linearised(fitted).evidence(None).log_z
            found.append((gained, p, fitted, candidate))
            tried.append((candidate.name, gained, fitted.misfit, False))
        if not found:
            break
        gained, piece, fitted, candidate = max(found, key=lambda f: f[0])
        if gained < log_z + ENOUGH:
            break
        log_z, best, effect = gained, fitted, candidate
        chosen.append(piece)
        tried = [(n, z, q, n == candidate.name or was) for n, z, q, was in tried]
    if effect is None:
        raise ValueError("no piece raises the evidence: the campaign shows none of them")
    return tried, best, effect


def continued(
    plan: Coordinates, best: Refit, base: Refit, known: Mapping[str, float]
) -> FloatArray:
    """Coordinates of a plan with one more piece, from the best refit so far."""
    x = plan.start(base.x, known)
    x[: Coordinates(plan.binned).local[0]] = best.x[: Coordinates(plan.binned).local[0]]
    for k in range(len(plan.binned.bins)):
        here = best.x[best.coords.local[k] : best.coords.local[k + 1]]
        x[plan.local[k] : plan.local[k] + len(here)] = here
    return x


# --------------------------------------------------------------------------- judging


def frozen(binned: BinnedCampaign, base: Refit, source: Refit) -> Refit:
    """A refit of other traces with tau, tau_v, V and the shared strengths of ``source``.

    Begun from the model's own fit and without any step, because the fit without the effect may have
    taken something else for a weak step; strengths of each trace around their mean in ``source``.
    Traces do not depend on each other: each keeps its best.
    """
    plan, old = Coordinates(binned, source.coords.parts), source.coords
    first = plan.start(base.x, {})
    n_shared, n_own = plan.local[0], len(plan.own)
    first[:n_shared] = source.x[:n_shared]
    free = np.arange(plan.size) >= n_shared
    usual = [
        np.mean([source.x[end - n_own + i] for end in old.local[1:]]) for i in range(n_own)
    ]  # fmt: skip
    made = []
    for step, shift in product((1.0, 0.0), (-1.0, 0.0, 1.0) if n_own else (0.0,)):
        start = first.copy()
        for k in range(len(binned.bins)):
            if not step:
                start[plan.local[k]] = binned.data[k][0]
                start[plan.local[k] + 1] = 0.0
            start[plan.local[k + 1] - n_own : plan.local[k + 1]] = np.array(usual) + shift
        made.append(refit(plan, start, most_steps=60, free=free))
    best = first.copy()
    for k, rows in enumerate(binned.rows):
        here = slice(plan.local[k], plan.local[k + 1])
        left = [float(np.sum(r.residual[rows] ** 2)) for r in made]
        best[here] = made[int(np.argmin(left))].x[here]
    return refit(plan, best, most_steps=60, free=free)


def excess(fitted: Refit, local_only: bool) -> FloatArray:
    """(n_experiments, n_phases) squared whitened residual beyond what noise leaves there."""
    binned, coords = fitted.coords.binned, fitted.coords
    made = np.zeros((len(binned.bins), len(PHASES)))
    shared = 0.0 if local_only else coords.local[0] / len(binned.bins)
    for k, (b, rows) in enumerate(zip(binned.bins, binned.rows)):
        z = fitted.residual[rows]
        fitted_here = coords.local[k + 1] - coords.local[k] + shared
        expected = 1.0 - fitted_here / len(z)
        np.add.at(made[k], b.phase, z**2 - expected)
    return made


def excess_volts(fitted: Refit) -> float:
    """V, rms of the residual's bin means beyond the floor, weighted by samples."""
    binned = fitted.coords.binned
    total, count = 0.0, 0
    for k, (b, rows) in enumerate(zip(binned.bins, binned.rows)):
        volts = binned.floor.cholesky[k] @ fitted.residual[rows]
        total += float(b.count @ (volts**2 - binned.floor.deviation(k) ** 2))
        count += int(b.count.sum())
    return float(np.sqrt(max(total / count, 0.0)))


def closed(before: FloatArray, after: FloatArray) -> tuple[float, float, float]:
    """The closed fraction of the excess and its 95 % interval over traces drawn again."""
    b, a = before.sum(axis=1), after.sum(axis=1)
    rng = np.random.default_rng(SEED)
    index = rng.integers(0, len(b), (RESAMPLES, len(b)))
    low, high = np.quantile(1.0 - a[index].sum(axis=1) / b[index].sum(axis=1), [0.025, 0.975])
    return float(1.0 - a.sum() / b.sum()), float(low), float(high)


def delays(fitted: Refit) -> tuple[FloatArray, FloatArray]:
    """Terms (n, 2 or 3) 1, 1/(odour flow), 1/(total flow), and delays (n,) s of visible steps."""
    plan = fitted.coords
    campaign = plan.binned.campaign
    beta = np.abs([fitted.x[plan.local[k] + 1] for k in range(len(campaign))])
    rows, found = [], []
    for k, e in enumerate(campaign):
        if beta[k] < VISIBLE_STEP * beta.max() or e.commanded_on is None:
            continue
        row = [1.0, 1.0 / e.test_gas_flow]
        rows.append(row if campaign.same_flow else [*row, 1.0 / e.total_flow])
        found.append(fitted.x[plan.local[k] + 2] - e.commanded_on)
    return np.array(rows), np.array(found)


def tau_of(fitted: Refit) -> dict[str, float]:
    """ms: tau in Laplace's approximation, with its 95 % interval given the explanation."""
    made = Linearised(fitted).evidence(None)
    ends = {"": 0.0, "_low": -1.96, "_high": 1.96}
    return {k: 1e3 * float(np.exp(made.log_tau + z * made.sd_log_tau)) for k, z in ends.items()}


@dataclass(frozen=True, eq=False)
class Found:
    """All about one campaign."""

    row: dict[str, Any]
    where: list[dict[str, Any]]
    tried: list[dict[str, Any]]
    before: tuple[Refit, Refit]
    """of the choosing and the held-out half"""
    after: tuple[Refit, Refit]


def study(name: str, campaign: Campaign, progress: Callable[[str], None]) -> Found:
    """Diagnose one half, choose an effect, judge it on the other."""
    chosen, held = halves(campaign)
    fits = [fit_least_squares(half, seed=1, euler=False) for half in (chosen, held)]
    progress("diagnosis")
    gap = diagnose_gap(chosen, fits[0], bootstrap=0, hidden=False, separate=False)
    best = gap.shrink
    sketches = [
        finer(prepare(half, Layout.of(half).flat(fit.theta_hat)))
        for half, fit in zip((chosen, held), fits)
    ]
    base = fit_base(sketches[0])
    progress("choosing")
    tried, fitted, effect = choose(sketches[0], base, PIECES[name])
    progress("verdict")
    catalogue = {**CATALOGUE, effect.name: effect}
    comparison = compare_hypotheses(sketches[0], base, catalogue, pairs=False)
    combined = combine(comparison, [], catalogue)
    excess = locate(sketches[0], base, signatures=signatures(base, catalogue))
    kind, named, _, probability = judge(combined, excess.p_value)
    own = comparison.find(effect.name)
    inside = closure(base, fitted, comparison.discrepancies)
    progress("held out")
    free_base = fit_base(sketches[1])
    before = (base, frozen(sketches[1], free_base, base))
    after = (fitted, frozen(sketches[1], free_base, fitted))
    row: dict[str, Any] = {
        "campaign": name,
        "traces": len(chosen.experiments),
        "held_out_traces": len(held.experiments),
        "verdict": gap.verdict.kind,
        "probability": gap.verdict.probability,
        "listed": best.explanation,
        "listed_closed": best.closure.fraction,
        "effect": effect.sentence.split(": {")[0],
        "pieces": effect.name,
        "strengths": "; ".join(
            f"{k} {v:.3g}" for k, v in fitted.strength().items() if not isinstance(v, Mapping)
        ),
        "verdict_with": "+".join(named) or kind,
        "probability_with": probability,
        "left_sd": own.leftover,
        "closure": inside.fraction,
        "closure_low": inside.low,
        "closure_high": inside.high,
    }
    where = []
    for side, (b, a) in {"": (before[0], after[0]), "held_": (before[1], after[1])}.items():
        parts = [excess(r, bool(side)) for r in (b, a)]
        fraction = closed(*parts)
        row.update(zip((f"{side}closed{end}" for end in ("", "_low", "_high")), fraction))
        b_k, a_k = (p.sum(axis=1) for p in parts)
        clear = b_k > CLEAR
        row[f"{side}clear_traces"] = int(clear.sum())
        row[f"{side}closed_median"] = float(np.median(1.0 - a_k[clear] / b_k[clear]))
        worst = int(np.argmax(a_k))
        row[f"{side}worst_trace"] = b.coords.binned.campaign.experiments[worst].name
        row[f"{side}worst_share"] = float(a_k[worst] / a_k.sum())
        for when, part, r in zip(("before", "after"), parts, (b, a)):
            row[f"{side}d_{when}"] = float(np.sqrt(max(part.sum(), 0.0)))
            row[f"{side}mV_{when}"] = 1e3 * excess_volts(r)
        positive = [np.maximum(p.sum(axis=0), 0.0) for p in parts]
        for i, phase in enumerate(PHASES):
            if any(np.any(s.phase == i) for s in b.coords.binned.bins):
                where.append({
                    "campaign": name, "half": "held out" if side else "choosing", "phase": phase,
                    **{f"share_{w}": p[i] / p.sum() for w, p in zip(("before", "after"), positive)},
                    **{f"d_{w}": np.sqrt(p[i]) for w, p in zip(("before", "after"), positive)},
                })  # fmt: skip
    for when, r in (("before", base), ("after", fitted)):
        row.update({f"tau_{when}_ms{end}": v for end, v in tau_of(r).items()})
    terms, late = delays(after[0])
    solution = np.linalg.lstsq(terms, late, rcond=None)[0]
    others, seen = delays(after[1])
    missed = seen - others @ solution
    row.update(
        delay_s=solution[0], odour_line_mL=solution[1],
        common_line_mL=solution[2] if len(solution) > 2 else np.nan,
        delay_spread_s=np.std(seen), delay_error_s=np.sqrt(np.mean(missed**2)),
        delay_traces=len(seen),
    )  # fmt: skip
    for finding in gap.findings:
        if finding.probability > 0.5 and finding.name in ("line", "mains_pickup"):
            volts, hertz = (
                ("line_V", "line_Hz") if finding.name == "line" else ("mains_V", "mains_Hz")
            )
            row[f"{finding.name}_mV"] = 1e3 * finding.strength[volts]
            row[f"{finding.name}_Hz"] = finding.strength[hertz]
    listing = [
        {"campaign": name, "pieces": n, "log_evidence": z, "misfit": q, "taken": taken}
        for n, z, q, taken in tried
    ]
    return Found(row, where, listing, before, after)


# --------------------------------------------------------------------------- tables and figure


def run(
    folder: Path, jobs: int, scheduler: str | None, progress: Callable[[int, int], None]
) -> None:
    """Compute, then write real_pid.csv, real_pid_where.csv, real_pid_pieces.csv and the figure."""
    place = os.environ.get(WHERE)
    if not place:
        print(f"real: {WHERE} is not set (the folder of the measurements): tables left alone")
        return
    found = {}
    for i, name in enumerate(PIECES):
        progress(i, len(PIECES))
        campaign = read_campaign(Path(place) / name / "campaign.toml")
        found[name] = study(
            name, campaign, lambda what, name=name: print(f"{name}: {what}", flush=True)
        )
    digits = {"index": False, "float_format": "%.5g"}
    pd.DataFrame([f.row for f in found.values()]).to_csv(TABLES / "real_pid.csv", **digits)
    pd.DataFrame([w for f in found.values() for w in f.where]).to_csv(
        TABLES / "real_pid_where.csv", **digits
    )
    pd.DataFrame([t for f in found.values() for t in f.tried]).to_csv(
        TABLES / "real_pid_pieces.csv", index=False, float_format="%.1f"
    )
    draw(found)


def draw(found: Mapping[str, Found]) -> None:
    """A few traces around the switch: measured, the model, the model with the effect."""
    figure, axes = plt.subplots(len(found), 4, figsize=(WIDTH, 4.1), layout="constrained")
    for row, (name, f) in zip(axes, found.items()):
        for axis, trace in zip(row, SHOWN[name]):
            for side in (0, 1):
                binned = f.before[side].coords.binned
                names = [e.name for e in binned.campaign]
                if trace in names:
                    k = names.index(trace)
                    e = binned.campaign.experiments[k]
                    break
            on = e.commanded_on if e.commanded_on is not None else float(e.t[0])
            inside = (e.t > on - 0.2) & (e.t < on + 4.0)
            t = e.t[inside][::8]
            axis.plot(t - on, e.values[inside][::8], color="0.6", lw=1.6, label="measured")
            for r, style in ((f.before[side], {"color": INK, "ls": "--"}),
                             (f.after[side], {"color": ACCENT})):  # fmt: skip
                axis.plot(t - on, r.coords.mean(r.x, k, t), lw=0.8, **style)
            half = "held out" if side else "used to choose"
            what = f"{100 * e.concentration:.3g} % at {0.06 * e.total_flow:.3g} L/min"
            axis.set_title(f"{what}\n{half}", color=ACCENT if side else INK)
        row[0].set_ylabel("voltage (V)")
    for axis in axes[-1]:
        axis.set_xlabel("time (s)")
    handles = [
        plt.Line2D([], [], color="0.6", lw=1.6), plt.Line2D([], [], color=INK, ls="--", lw=0.8),
        plt.Line2D([], [], color=ACCENT, lw=0.8),
    ]  # fmt: skip
    figure.legend(handles, ["measured", "model", "model with the effect"], ncols=3,
                  loc="outside lower center")  # fmt: skip
    save(figure, "real_pid")
