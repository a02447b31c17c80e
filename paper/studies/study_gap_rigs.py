"""The diagnosis of the gap on other rigs: how often its verdict is right.

The designs of ``study_other_rigs.py``, their parameters drawn anew, with AR(1) noise: nulls,
effects that the rig can have, and causes that the catalogue does not hold, at the detectabilities
of ``study_gap.py``.  ``paper/tables/gap_other_rigs.csv`` counts the verdicts, with Wilson's 95 %
intervals.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from drawing import TABLES
from gap_rigs import EITHER_SIGN, LISTED, REACHED, Shape, amount_for
from study_other_rigs import draw_truth, parts

from bayes_sensor.blind_check import wilson
from bayes_sensor.campaign import Campaign, CampaignError, FloatArray
from bayes_sensor.checks.study_chunks import run_chunks, seed_of, study_key
from bayes_sensor.diagnosis import CATALOGUE, diagnose_gap
from bayes_sensor.diagnosis.data.binned_campaign import BinnedCampaign
from bayes_sensor.diagnosis.data.preparation import prepare
from bayes_sensor.diagnosis.effects.effect_model import Scales, parameter_name, with_effects
from bayes_sensor.diagnosis.effects.effects_of_rig import Possible
from bayes_sensor.diagnosis.effects.simulate_effects import default_strengths
from bayes_sensor.fit import fit_least_squares
from bayes_sensor.likelihood.density import simulate
from bayes_sensor.likelihood.problem import Problem
from bayes_sensor.rig.cascade import response
from bayes_sensor.rig.layout import Layout

SEED = 60_815
RIGS = ("sensor", "cell and sensor", "staircase", "pulse train", "two sensors")
NULLS, LISTED_EACH, OUTSIDE_EACH = 8, 4, 3
"""campaigns of a rig: nulls, and causes at each detectability"""
RUN = 32
"""of all these, mixed, the first ones are diagnosed"""
DETECTABILITIES = (10.0, 30.0)
AMOUNTS = (12.0, 8.0, 6.0, 4.0, 3.0, 2.0, 1.0)
"""largest amounts of an effect, in its plausible strength; the first that its limits allow"""

Mean = Callable[[int, FloatArray], FloatArray]
"""number of an experiment, times (n_times,) s -> V (n_times,)"""


@dataclass(frozen=True)
class Case:
    """One campaign to be diagnosed."""

    rig: str
    group: str
    """``null``, ``listed`` or ``outside``"""
    number: int
    """of the case in its group: which cause acts"""
    d: float
    """wanted detectability"""


def cases() -> list[Case]:
    """The campaigns, mixed so that a part of them holds some of everything."""
    made = [Case(rig, "null", i, 0.0) for rig in RIGS for i in range(NULLS)]
    for group, n in (("listed", LISTED_EACH), ("outside", OUTSIDE_EACH)):
        made += [Case(rig, group, i, d) for rig in RIGS for d in DETECTABILITIES for i in range(n)]
    return [made[i] for i in np.random.default_rng(SEED).permutation(len(made))[:RUN]]


# --------------------------------------------------------------------------- one campaign


@dataclass(frozen=True, eq=False)
class OtherRig:
    """A record of a rig in which nothing is wrong, and its truth."""

    campaign: Campaign
    theta: FloatArray
    """flat, lags by name"""

    @cached_property
    def layout(self) -> Layout:
        """Of theta."""
        return Layout.of(self.campaign)

    @cached_property
    def binned(self) -> BinnedCampaign:
        """Bins and floor around the truth."""
        by_size = Problem(self.campaign).commuting.by_size(self.theta)
        return prepare(self.campaign, by_size[: self.layout.n_mean]).binned

    @cached_property
    def scales(self) -> Scales:
        """What priors of effects are scaled with."""
        return Scales.of(self.campaign, self.theta)

    def response(self, k: int, t: FloatArray) -> FloatArray:
        """(n_times,) of the sensor, in units of the input."""
        flow = self.campaign.experiments[k].total_flow
        return np.asarray(response(t, self.theta, self.layout, k, flow))

    def mean(self, k: int, t: FloatArray) -> FloatArray:
        """V (n_times,) of the model."""
        y0, beta = self.theta[self.layout.local[k, :2]]
        return y0 + beta * self.response(k, t)

    def step(self, k: int) -> float:
        """V, what a unit of the input is worth."""
        return float(self.theta[self.layout.local[k, 1]])

    def record(self, mean: Mean) -> Campaign:
        """The campaign as it is measured with this mean."""
        return self.campaign.with_data({
            e.name: e.values - self.mean(k, e.t) + mean(k, e.t)
            for k, e in enumerate(self.campaign)
        })  # fmt: skip


def draw_rig(name: str, seed: np.random.SeedSequence) -> OtherRig:
    """A rig of a design with parameters drawn anew."""
    of_truth, of_noise = seed.spawn(2)
    part = parts()[name]
    theta = draw_truth(part, np.random.default_rng(of_truth))
    return OtherRig(simulate(part.campaign, theta, seed=seed_of(of_noise)), theta)


def listed_causes(rig: OtherRig) -> list[str]:
    """Effects of the catalogue on the mean that the rig can have."""
    setting = rig.scales.setting(rig.campaign.experiments[0], 20.0, 70.0)
    possible = Possible.of(rig.campaign).effects(CATALOGUE, setting)
    return [name for name, effect in possible.items() if effect.on_mean and name in LISTED]


def listed(rig: OtherRig, name: str, rng: np.random.Generator) -> tuple[Shape, float]:
    """An effect of the catalogue, its amount in its plausible strength, and the largest amount."""
    plausible = default_strengths(name, rig.scales)
    first = LISTED[name][0]
    setting = rig.scales.setting(rig.campaign.experiments[0], 20.0, 70.0)
    form = next(
        f for f in CATALOGUE[name].forms if {s.name for s in f.strengths(setting)} == {*plausible}
    )
    varied = next(s for s in form.strengths(setting) if s.name == first)
    null = CATALOGUE[name].null[first]
    sign = float(rng.choice([-1.0, 1.0])) if name in EITHER_SIGN else 1.0
    sizes = rng.standard_normal(len(rig.campaign)) if varied.per_experiment else np.ones(1)
    text = f"{name}:{form.name}" if form.name else name
    problem = with_effects(Problem(rig.campaign), [text], rig.theta)
    model = replace(problem.model, assignment=None)  # a truth says by name whose its lags are
    layout = problem.layout
    fixed = np.zeros(len(layout))
    fixed[: rig.layout.n_mean] = rig.theta[: rig.layout.n_mean]
    for s in form.strengths(setting):
        if not s.per_experiment:
            fixed[layout.index(parameter_name(s))] = plausible[s.name]

    def value(amount: float, size: float) -> float:
        if null == 1.0:
            return float(plausible[first] ** (sign * amount * size))
        return float(null + sign * amount * size * (plausible[first] - null))

    def mean_of(amount: float) -> Mean:
        theta, key = fixed.copy(), parameter_name(varied)
        if varied.per_experiment:
            for e, size in zip(rig.campaign, sizes, strict=True):
                theta[layout.index(f"{key}[{e.name}]")] = value(amount, size)
        else:
            theta[layout.index(key)] = value(amount, 1.0)
        experiments = rig.campaign.experiments
        return lambda k, t: model.mean(t, theta, layout, experiments[k])

    low, high = varied.limits
    allowed = [a for a in AMOUNTS if all(low <= value(a, s) <= high for s in sizes)]
    return mean_of, allowed[0] if allowed else AMOUNTS[-1]


def _later(rig: OtherRig, amount: float) -> Mean:
    # a part of the gas takes a longer way
    late = 3.0 * rig.scales.time_scale

    def mean(k: int, t: FloatArray) -> FloatArray:
        return rig.mean(k, t) + amount * rig.step(k) * (
            rig.response(k, t - late) - rig.response(k, t)
        )

    return mean


def _warms(rig: OtherRig, amount: float) -> Mean:
    # the gas warms the sensor for some time after each switch, in proportion to what changes
    slow = 4.0 * rig.scales.time_scale

    def mean(k: int, t: FloatArray) -> FloatArray:
        # the response less its own running mean over the exponential past
        x, past = rig.response(k, t), np.empty(len(t))
        past[0] = x[0]
        for i, gap in enumerate(np.diff(t), start=1):
            past[i] = x[i] + (past[i - 1] - x[i]) * np.exp(-gap / slow)
        return rig.mean(k, t) + amount * rig.step(k) * (x - past)

    return mean


def _pump(rig: OtherRig, amount: float) -> Mean:
    # the concentration swings with a pump
    period = 2.5 * rig.scales.time_scale

    def mean(k: int, t: FloatArray) -> FloatArray:
        swing = np.sin(2.0 * np.pi * t / period + k)
        return rig.mean(k, t) + amount * rig.step(k) * rig.response(k, t) * swing

    return mean


def _wanders(rig: OtherRig, amount: float) -> Mean:
    # the baseline wanders, in every record in its own way
    orders = np.arange(1, 31)

    def mean(k: int, t: FloatArray) -> FloatArray:
        e = rig.campaign.experiments[k]
        rng = np.random.default_rng([SEED, k, int(1e6 * rig.theta[0])])
        sizes, phases = rng.standard_normal(30) / orders, rng.uniform(0.0, 2.0 * np.pi, 30)
        turns = 2.0 * np.pi * 1.3 * t[:, None] * orders / float(np.ptp(e.t))
        return rig.mean(k, t) + amount * rig.step(k) * np.sin(turns + phases) @ sizes

    return mean


# name -> mean for an amount of it, largest amount
OUTSIDE: Mapping[str, tuple[Callable[[OtherRig, float], Mean], float]] = {
    "part of the gas comes later": (_later, 0.9),
    "gas warms the sensor": (_warms, 0.9),
    "pump swings": (_pump, 0.3),
    "baseline wanders": (_wanders, 0.3),
}


@dataclass(frozen=True)
class Diagnosing:
    """The task: campaign number i made, fitted and diagnosed."""

    cases: tuple[Case, ...]

    @property
    def key(self) -> str:
        """Everything that the numbers depend on, besides the diagnosis itself."""
        return study_key("gap on other rigs", self.cases, SEED)

    def __call__(self, i: int) -> dict[str, Any]:
        """The truth and what was said about it."""
        case = self.cases[i]
        of_rig, of_cause = np.random.SeedSequence([SEED, i]).spawn(2)
        rig, rng = draw_rig(case.rig, of_rig), np.random.default_rng(of_cause)
        cause, d, mean = "none", 0.0, rig.mean
        if case.group != "null":
            if case.group == "listed":
                causes = listed_causes(rig)
                # in an order of the rig's own, so that a rig's cases differ in their cause
                order = np.random.default_rng([SEED, RIGS.index(case.rig)]).permutation(len(causes))
                later = LISTED_EACH if case.d == DETECTABILITIES[-1] else 0
                cause = causes[order[(case.number + later) % len(causes)]]
                shape, highest = listed(rig, cause, rng)
            else:
                cause = [*OUTSIDE][case.number % len(OUTSIDE)]
                make, highest = OUTSIDE[cause]

                def shape(amount: float) -> Mean:
                    return make(rig, amount)

            amount, d = amount_for(rig, shape, highest, case.d)
            mean = shape(amount)
        made = {
            "rig": case.rig, "group": case.group, "cause": cause, "d_wanted": case.d, "d": d,
        }  # fmt: skip
        campaign = rig.record(mean)
        try:
            fit = fit_least_squares(campaign, seed=1, euler=False)
            gap = diagnose_gap(campaign, fit, bootstrap=0, hidden=False, separate=False,
                               follow=False)  # fmt: skip
        except (CampaignError, np.linalg.LinAlgError):
            return {**made, "kind": "failed", "named": "", "probability": np.nan, "top": "",
                    "closed": np.nan}  # fmt: skip
        effects, closed = gap.probabilities.effects, gap.shrink.closure.fraction
        return {
            **made, "kind": gap.verdict.kind, "named": "+".join(gap.verdict.effects),
            "probability": gap.verdict.probability, "top": max(effects, key=lambda n: effects[n]),
            "closed": np.nan if closed is None else closed,
        }  # fmt: skip


# --------------------------------------------------------------------------- the score


def scored(rows: pd.DataFrame) -> pd.DataFrame:
    """Every claim with its count, share and Wilson's interval, by rig and over all rigs."""
    families = {name: effect.family for name, effect in CATALOGUE.items()}
    seen = rows[(rows["group"] == "null") | (rows["d"] >= REACHED * rows["d_wanted"])].copy()
    named = [str(text).split("+") if text else [] for text in seen["named"]]
    own = [families.get(cause, "") for cause in seen["cause"]]
    inside = [o in {families[n] for n in those} for o, those in zip(own, named, strict=True)]
    outside = [any(families[n] != o for n in those) for o, those in zip(own, named, strict=True)]
    seen["family"] = np.array(inside) & seen["kind"].isin(("effect", "family"))
    seen["first"] = seen["family"] & (seen["top"] == seen["cause"])
    seen["wrong"] = np.array(outside) & (seen["kind"] == "effect")
    seen["unlisted"], seen["none"] = seen["kind"] == "unlisted", seen["kind"] == "none"
    claims = {
        "null": {"none": "nothing is missing", "wrong": "a cause is named",
                 "unlisted": "called unlisted"},
        "listed": {"family": "the right family", "first": "the right effect first",
                   "wrong": "confident name outside the family", "unlisted": "called unlisted",
                   "none": "nothing is missing"},
        "outside": {"unlisted": "called unlisted", "wrong": "confident name",
                    "none": "nothing is missing"},
    }  # fmt: skip
    made = []
    for rig in ("all", *RIGS):
        of_rig = seen if rig == "all" else seen[seen["rig"] == rig]
        for group, said in claims.items():
            for d, some in of_rig[of_rig["group"] == group].groupby("d_wanted"):
                for column, words in said.items():
                    k, n = int(some[column].sum()), len(some)
                    low, high = wilson(k, n)
                    made.append({
                        "rig": rig, "truth": group, "d": d, "claim": words, "campaigns": n,
                        "count": k, "share": k / n, "lo95": low, "hi95": high,
                    })  # fmt: skip
    return pd.DataFrame(made)


def run(folder: Path, jobs: int, scheduler: str | None, progress: Callable[..., None]) -> None:
    """Diagnose all campaigns; write the counts, and the verdicts one by one."""
    task = Diagnosing(tuple(cases()))
    n = len(task.cases)
    found = run_chunks(task, n, folder / "gap_rigs", task.key, jobs, 4, scheduler, progress)
    rows = pd.DataFrame({name: found[name] for name in found})
    rows.sort_values(["rig", "group", "d_wanted", "cause"], kind="stable").to_csv(
        TABLES / "gap_other_rigs_campaigns.csv", index=False, float_format="%.3g"
    )
    scored(rows).to_csv(TABLES / "gap_other_rigs.csv", index=False, float_format="%.3g")
