"""The diagnosis of the gap on the published design: how often its verdict is right.

Nulls under four laws of noise; every listed effect on the mean at two detectabilities; causes that
are not in the catalogue; every listed effect taken out of it.  ``gap_rigs.py`` makes the
campaigns; rates come with Wilson's 95 % intervals beside the goals that were set before.  Then
which effects the published design tells apart, by noise-free refits, and what may hide in it.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from drawing import ACCENT, INK, PAPER, SHADE, TABLES, WIDTH, plt, save
from gap_rigs import (
    LAWS,
    LISTED,
    OUTSIDE,
    REACHED,
    Listed,
    Rig,
    Shape,
    amount_for,
    detectability,
    draw_rig,
    noise_free,
    outside,
)

from bayes_sensor.blind_check import wilson
from bayes_sensor.campaign import CampaignError
from bayes_sensor.checks.study_chunks import run_chunks, study_key
from bayes_sensor.diagnosis import CATALOGUE, Gap, diagnose_gap
from bayes_sensor.diagnosis.data.preparation import base_coordinates, fit_base
from bayes_sensor.diagnosis.evidence.coordinate_priors import Part
from bayes_sensor.diagnosis.evidence.hypotheses import fit_effect
from bayes_sensor.diagnosis.evidence.laplace_evidence import Linearised
from bayes_sensor.diagnosis.evidence.refit import refit
from bayes_sensor.diagnosis.evidence.refit_coordinates import Coordinates
from bayes_sensor.diagnosis.isolability import ISOLATED
from bayes_sensor.figures import effect_words
from bayes_sensor.fit import fit_least_squares
from bayes_sensor.io.readers import read_campaign
from bayes_sensor.rig.layout import Layout

SEED = 700_000
NULLS = {"ar1": 60, "ar1 + 1 s": 20, "heavy tails": 20, "1/f": 20}
DETECTABILITIES = (10.0, 30.0)
REPEATS, REPEATS_OUTSIDE = 3, 2
PHI = 0.9
"""of the published design's noise, for isolability and for what may hide"""


# --------------------------------------------------------------------------- one campaign


@dataclass(frozen=True)
class Case:
    """One campaign to be diagnosed."""

    group: str
    """``null``, ``listed``, ``outside`` or ``withheld``"""
    cause: str
    d: float
    """wanted detectability"""
    law: str = "ar1"


def cases() -> list[Case]:
    """All campaigns, mixed so that an unfinished run holds some of everything."""
    made = [Case("null", "none", 0.0, law) for law, n in NULLS.items() for _ in range(n)]
    for d in DETECTABILITIES:
        made += [Case("listed", name, d) for name in LISTED for _ in range(REPEATS)]
        made += [Case("outside", name, d) for name in OUTSIDE for _ in range(REPEATS_OUTSIDE)]
        made += [Case("withheld", name, d) for name in LISTED]
    return [made[i] for i in np.random.default_rng(SEED).permutation(len(made))]


@dataclass(frozen=True)
class PowerStudy:
    """The task: campaign number i made, fitted and diagnosed."""

    cases: tuple[Case, ...]

    @property
    def key(self) -> str:
        """Everything that the numbers depend on, besides the diagnosis itself."""
        return study_key("gap power", self.cases, SEED)

    def __call__(self, i: int) -> dict[str, Any]:
        """The truth and what was said about it."""
        case = self.cases[i]
        rng = np.random.default_rng(SEED + i)
        rig = draw_rig(rng, case.law)
        shape: Shape | None = None
        listed: Listed | None = None
        amount = d = 0.0
        if case.group == "outside":
            shape, highest = outside(rig, case.cause)
        elif case.group != "null":
            shape = listed = Listed.draw(rig, case.cause, rng)
            highest = listed.highest
        if shape is not None:
            amount, d = amount_for(rig, shape, highest, case.d)
        mean = rig.mean if shape is None else shape(amount)
        campaign = rig.record(mean)
        made: dict[str, Any] = {
            "case": i, "group": case.group, "cause": case.cause, "law": case.law,
            "d_wanted": case.d, "d": d, "amount": amount, "phi": rig.theta["phi"],
            "tau_s": rig.theta["tau_s"], "nearest": np.nan,
        }  # fmt: skip
        if case.group == "outside":
            made["nearest"] = nearest(rig, mean)
        try:
            fit = fit_least_squares(campaign, seed=1, euler=False)
            gap = diagnose_gap(
                campaign, fit, bootstrap=0, hidden=False, separate=False,
                without=[case.cause] if case.group == "withheld" else (),
            )  # fmt: skip
        except (CampaignError, np.linalg.LinAlgError):
            return {**made, **_FAILED}
        known = np.nan
        if case.group == "listed":
            known = tau_of_the_cause(gap, rig, listed, amount)
        return {
            **made, **said(gap, case.cause), "oracle_closed": oracle(gap, mean),
            "tau_known_s": known,
        }  # fmt: skip


_FAILED = {
    "kind": "failed", "named": "", "probability": np.nan, "top": "", "p_top": np.nan,
    "p_none": np.nan, "p_unlisted": np.nan, "p_family": np.nan, "explanation": "",
    "closed": np.nan, "tau_before_s": np.nan, "tau_after_s": np.nan, "oracle_closed": np.nan,
    "tau_known_s": np.nan,
}  # fmt: skip


def said(gap: Gap, cause: str) -> dict[str, Any]:
    """The diagnosis as one row."""
    combined, verdict = gap.probabilities, gap.verdict
    top = max(combined.effects, key=lambda n: combined.effects[n])
    family = CATALOGUE[cause].family if cause in CATALOGUE else ""
    closed = gap.shrink.closure.fraction
    return {
        "kind": verdict.kind,
        "named": "+".join(verdict.effects),
        "probability": verdict.probability,
        "top": top,
        "p_top": combined.effects[top],
        "p_none": combined.none,
        "p_unlisted": combined.unlisted,
        "p_family": combined.families.get(family, 0.0),
        "explanation": gap.shrink.explanation,
        "closed": np.nan if closed is None else closed,
        "tau_before_s": gap.shrink.tau_before_s,
        "tau_after_s": gap.shrink.tau_after_s,
    }


def oracle(gap: Gap, mean: Callable[[int, np.ndarray], np.ndarray]) -> float:
    """What the explanation closes of the gap without noise; nan where it is the model itself."""
    alike = [h for h in gap.comparison.hypotheses if h.key == gap.shrink.explanation and h.effects]
    if not alike:
        return float("nan")
    found = alike[0]
    binned = gap.comparison.binned
    data = noise_free(binned, mean)
    base = gap.comparison.base
    before, after = (
        refit(r.coords, r.x, data=data, most_steps=20).misfit for r in (base, found.refit)
    )
    return 1.0 - after / before


def tau_of_the_cause(gap: Gap, rig: Rig, listed: Listed, amount: float) -> float:
    """tau of a fit that is told the cause, its form and where to start: noise alone is left."""
    binned = gap.comparison.binned
    plan = Coordinates(binned, (Part(CATALOGUE[listed.name], listed.form),))
    truth = base_coordinates(binned.campaign, Layout.of(binned.campaign).flat(rig.theta))
    strengths = listed.strengths(amount, 0)
    starts = [
        plan.start(truth, strengths),
        plan.with_strengths(
            plan.start_from(gap.comparison.base.coords, gap.comparison.base.x), strengths
        ),
    ]
    best = min((refit(plan, x, most_steps=60) for x in starts), key=lambda r: r.objective)
    return float(np.exp(Linearised(best).evidence(None).log_tau))


def nearest(rig: Rig, mean: Callable[[int, np.ndarray], np.ndarray]) -> float:
    """Standard deviations that the listed effect which resembles a cause most leaves of it."""
    binned = rig.binned
    exact = replace(binned, data=tuple(noise_free(binned, mean)))
    base = fit_base(exact)
    left = [
        fit_effect(exact, base, [Part(effect, form)], form.starts, 20).misfit
        for effect in CATALOGUE.values()
        if effect.on_mean
        for form in effect.forms
    ]
    return float(np.sqrt(min(left)))


# --------------------------------------------------------------------------- the score


def scored(rows: pd.DataFrame, alike: Iterable[tuple[float, str, str]]) -> pd.DataFrame:
    """The rows with what counts as right and wrong in each.

    ``alike``: detectability, effect, rival that the published design cannot separate.
    """
    families = {name: effect.family for name, effect in CATALOGUE.items()}
    pairs = {(d, *sorted((a, b))) for d, a, b in alike}
    made = rows.copy()
    columns: dict[str, list[bool]] = {
        name: []
        for name in ("hidden", "alarmed", "wrong", "family_right", "top_right", "top_alike")
    }
    for row in rows.itertuples():
        named = str(row.named).split("+") if row.named else []
        own = families.get(str(row.cause))
        # heavy tails are in the catalogue: naming them where the noise has them is right
        false = [n for n in named if not (row.law == "heavy tails" and n == "heavy_tails")]
        inside = bool(named) and own in {families[n] for n in named}
        right = inside and row.kind in ("effect", "family")
        columns["hidden"].append(row.group != "null" and row.d < REACHED * row.d_wanted)
        columns["alarmed"].append(row.kind != "none" and (row.kind == "unlisted" or bool(false)))
        columns["wrong"].append(row.kind == "effect" and any(families[n] != own for n in false))
        columns["family_right"].append(right)
        columns["top_right"].append(right and row.top == row.cause)
        columns["top_alike"].append(
            right
            and (row.top == row.cause or (row.d_wanted, *sorted((row.top, row.cause))) in pairs)
        )
    for name, values in columns.items():
        made[name] = values
    return made


def power(rows: pd.DataFrame) -> pd.DataFrame:
    """Every claim with its rate or median, Wilson's interval, the goal and whether it is met."""
    made: list[dict[str, Any]] = []

    def rate(claim: str, setting: str, those: pd.Series, goal: str = "") -> None:
        k, n = int(those.sum()), len(those)
        if n == 0:
            return
        low, high = wilson(k, n)
        made.append(_row(claim, setting, n, k / n, low, high, goal, k=k))

    def median(claim: str, setting: str, values: pd.Series, goal: str = "") -> None:
        known = values.dropna()
        if len(known) == 0:
            return
        low, high = np.quantile(known, [0.25, 0.75])
        made.append(_row(claim, setting, len(known), known.median(), low, high, goal))

    rate("all: the diagnosis ended with an error", "any", rows["kind"] == "failed")
    nulls = rows[rows["group"] == "null"]
    for law, goal in zip(LAWS, ("<= 0.02", "<= 0.05", "<= 0.05", "<= 0.15"), strict=True):
        some = nulls[nulls["law"] == law]
        rate("null: a cause is named", law, some["kind"].isin(("effect", "family"))
             & some["alarmed"], goal)  # fmt: skip
        rate("null: a cause is named or called unlisted", law, some["alarmed"])
    listed = rows[rows["group"] == "listed"]
    seen = listed[~listed["hidden"]]
    for d, family, top in zip(DETECTABILITIES, (">= 0.95", ">= 0.98"), (">= 0.88", ">= 0.95"),
                              strict=True):  # fmt: skip
        some, setting = seen[seen["d_wanted"] == d], f"d {d:g}"
        rate("listed: the right family", setting, some["family_right"], family)
        rate("listed: the right effect first", setting, some["top_right"], top)
        rate("listed: the same, inseparable pairs as one", setting, some["top_alike"])
        rate("listed: confident name outside the family", setting, some["wrong"], "<= 0.02")
        named = some[some["family_right"]]
        rate_goal = "<= 0.05" if d == DETECTABILITIES[-1] else ""
        median("listed and named: |closed fraction - oracle|", setting,
               (named["closed"] - named["oracle_closed"]).abs(), rate_goal)  # fmt: skip
        names = ("tau_before_s", "tau_after_s", "tau_known_s")
        before, after, known = (np.log(named[name] / named["tau_s"]).abs() for name in names)
        median("listed and named: |error of ln tau| without the effect", setting, before)
        median("listed and named: |error of ln tau| with it", setting, after)
        median("listed and named: |error of ln tau| of a fit told the cause", setting, known)

        def ratio(claim: str, value: float, goal: str = "", n: int = len(named),
                  setting: str = setting) -> None:  # fmt: skip
            made.append(_row(f"listed and named: {claim}", setting, n, value, np.nan, np.nan, goal))

        if len(named):
            ratio("ratio of these, with it over without", after.median() / before.median(),
                  "<= 0.2")  # fmt: skip
            ratio("ratio of these, told the cause over without", known.median() / before.median())
            ratio("ratio of the means, with it over without", after.mean() / before.mean())
            ratio("ratio of the means, told the cause over without", known.mean() / before.mean())
    hidden = listed[listed["hidden"]]
    rate("hidden: nothing is named", "any d", hidden["kind"].isin(("none", "unlisted")))
    rate("hidden: confident name outside the family", "any d", hidden["wrong"], "<= 0.02")
    others = rows[(rows["group"] == "outside") & ~rows["hidden"]]
    for d, goal in zip(DETECTABILITIES, (">= 0.7", ">= 0.95"), strict=True):
        some = others[others["d_wanted"] == d]
        rate("outside the catalogue: called unlisted", f"d {d:g}", some["kind"] == "unlisted", goal)
        rate("outside the catalogue: confident name", f"d {d:g}", some["kind"] == "effect")
        alone = some[some["nearest"] >= ISOLATED]
        rate("outside, and nothing listed resembles it: called unlisted", f"d {d:g}",
             alone["kind"] == "unlisted")  # fmt: skip
    taken = rows[(rows["group"] == "withheld") & ~rows["hidden"]]
    for d in DETECTABILITIES:
        some = taken[taken["d_wanted"] == d]
        rate("withheld: confident name outside the family", f"d {d:g}", some["wrong"], "<= 0.1")
        rate("withheld: called unlisted", f"d {d:g}", some["kind"] == "unlisted")
        rate("withheld: family or unlisted", f"d {d:g}",
             some["family_right"] | (some["kind"] == "unlisted"))  # fmt: skip
    return pd.DataFrame(made)


def _row(
    claim: str,
    setting: str,
    n: int,
    value: float,
    low: float,
    high: float,
    goal: str,
    k: int | None = None,
) -> dict[str, Any]:
    met = ""
    if goal:
        sign, _, limit = goal.partition(" ")
        kept = value <= float(limit) if sign == "<=" else value >= float(limit)
        met = "yes" if kept else "no"
    return {
        "claim": claim, "setting": setting, "n": n, "k": "" if k is None else k, "value": value,
        "low": low, "high": high, "goal": goal, "met": met,
    }  # fmt: skip


# --------------------------------------------------------------------------- isolability


@dataclass(frozen=True)
class IsolabilityStudy:
    """The task: one effect at one detectability, refitted with every effect, without noise."""

    names: tuple[str, ...] = tuple(LISTED)

    @property
    def key(self) -> str:
        """Everything that the numbers depend on."""
        return study_key("gap isolability", self.names, DETECTABILITIES, PHI, SEED)

    def __call__(self, i: int) -> dict[str, Any]:
        """What is left (n_names,) in standard deviations, with the amount and the d it has."""
        which, level = divmod(i, len(DETECTABILITIES))
        rig = draw_rig(np.random.default_rng(SEED), phi=PHI)
        listed = Listed.draw(rig, self.names[which])
        wanted = DETECTABILITIES[level]
        amount, d = amount_for(rig, listed, listed.highest, wanted)
        mean = listed(amount)
        start = detectability(rig, mean)
        exact = replace(rig.binned, data=tuple(noise_free(rig.binned, mean)))
        base = refit(Coordinates(exact), start.x)
        other = fit_base(exact)
        base = min(base, other, key=lambda r: r.objective)
        left = []
        for name in self.names:
            effect = CATALOGUE[name]
            best = min(
                fit_effect(exact, base, [Part(effect, form)], form.starts).misfit
                for form in effect.forms
            )
            left.append(float(np.sqrt(best)))
        return {"effect": self.names[which], "d_wanted": wanted, "d": d, "amount": amount,
                "left": np.array(left)}  # fmt: skip


def matrix(results: dict[str, np.ndarray], names: tuple[str, ...]) -> pd.DataFrame:
    """One row an effect and detectability, one column a rival: sd left of the noise-free gap."""
    order = np.argsort(results["d_wanted"], kind="stable")
    frame = pd.DataFrame(
        {key: results[key][order] for key in ("effect", "d_wanted", "d", "amount")}
    )
    left = pd.DataFrame(results["left"][order], columns=list(names))
    reached = frame["d"] >= REACHED * frame["d_wanted"]
    alike = [
        " ".join(
            other for other in names if seen and other != effect and left.loc[i, other] < ISOLATED
        )
        for i, (effect, seen) in enumerate(zip(frame["effect"], reached, strict=True))
    ]
    return pd.concat([frame, left, pd.Series(alike, name="not_separated_from")], axis=1)


def inseparable(table: pd.DataFrame) -> list[tuple[float, str, str]]:
    """Detectability, effect and rival that it is not told apart from."""
    return [
        (float(row.d_wanted), str(row.effect), rival)
        for row in table.itertuples()
        for rival in str(row.not_separated_from).split()
        if row.not_separated_from == row.not_separated_from  # nan where read back empty
    ]


# --------------------------------------------------------------------------- what may hide


def what_hides() -> pd.DataFrame:
    """Every effect at plausible strength: d, shift of tau, the envelope; two campaigns."""
    rig = draw_rig(np.random.default_rng(SEED), phi=PHI)
    campaigns = {
        "bundled": read_campaign(PAPER.parent / "data" / "reference" / "campaign.toml"),
        f"published design, phi {PHI:g}": rig.record(rig.mean),
    }
    tables = []
    for name, campaign in campaigns.items():
        fit = fit_least_squares(campaign, seed=1, euler=False)
        gap = diagnose_gap(campaign, fit, bootstrap=0, separate=False)
        table = gap.hidden.table
        table["strength"] = [
            " ".join(f"{key}={value:.4g}" for key, value in s.items()) for s in table["strength"]
        ]
        table.insert(0, "campaign", name)
        table["envelope_low_s"], table["envelope_high_s"] = gap.hidden.tau_envelope_s
        tables.append(table)
    return pd.concat(tables, ignore_index=True)


# --------------------------------------------------------------------------- figures


def draw_power(table: pd.DataFrame, rows: pd.DataFrame) -> None:
    """Rates beside their goals, and every listed campaign's probability of the true family."""
    goals = table[(table["goal"] != "") & (table["k"] != "")].reset_index(drop=True)
    figure, (upper, lower) = plt.subplots(2, 1, figsize=(WIDTH, 6.4), layout="constrained")
    for y, row in enumerate(goals.itertuples()):
        goal = float(str(row.goal).partition(" ")[2])
        if str(row.goal).startswith("<="):
            upper.barh(y, goal, height=0.8, color=SHADE)
        else:
            upper.barh(y, 1.0 - goal, left=goal, height=0.8, color=SHADE)
        upper.plot([row.low, row.high], [y, y], color=INK, lw=0.8)
        upper.plot(row.value, y, "o", color=ACCENT if row.met == "yes" else "white", mec=ACCENT)
    upper.set_yticks(range(len(goals)), [f"{r.claim}, {r.setting}" for r in goals.itertuples()])
    upper.invert_yaxis()
    upper.set_xlim(-0.02, 1.02)
    upper.set_xlabel("rate (goal shaded)")
    listed = rows[rows["group"] == "listed"]
    names = list(LISTED)
    for d, marker, shift in zip(DETECTABILITIES, ("o", "s"), (-0.18, 0.18), strict=True):
        some = listed[listed["d_wanted"] == d]
        y = np.array([names.index(n) for n in some["cause"]]) + shift
        faint = some["hidden"].to_numpy(dtype=bool)
        p = some["p_family"].to_numpy(dtype=float)
        lower.plot(p[~faint], y[~faint], marker, color=ACCENT, ls="", alpha=0.7, label=f"d {d:g}")
        lower.plot(p[faint], y[faint], marker, mfc="none", color="0.6", ls="")
    lower.plot([], [], "o", mfc="none", color="0.6", ls="", label="cannot reach that d")
    lower.set_yticks(range(len(names)), [effect_words(n) for n in names])
    lower.invert_yaxis()
    lower.set_xlabel("probability of the true family")
    lower.legend(loc="lower right", bbox_to_anchor=(1.0, 1.0), ncols=3)
    save(figure, "gap_power")


def draw_isolability(table: pd.DataFrame) -> None:
    """What a rival leaves of an effect's gap, as a share of it; pairs below three are framed."""
    names = [n for n in LISTED if n in table.columns]
    words = [effect_words(n) for n in names]
    figure, axes = plt.subplots(2, 1, figsize=(WIDTH, 7.0), layout="constrained", sharex=True)
    for axis, (d, some) in zip(axes, table.groupby("d_wanted"), strict=True):
        left = some.set_index("effect").loc[names]
        values = left[names].to_numpy(dtype=float)
        share = np.clip(values / left["d"].to_numpy(dtype=float)[:, None], 0.0, 1.0)
        image = axis.imshow(share, cmap="Greys_r", vmin=0.0, vmax=1.0, aspect="auto")
        for i, name in enumerate(names):
            for rival in str(left.loc[name, "not_separated_from"] or "").split():
                if rival in names:
                    j = names.index(rival)
                    axis.text(j, i, f"{values[i, j]:.1f}", ha="center", va="center",
                              fontsize=7, color="white")  # fmt: skip
                    axis.add_patch(plt.Rectangle((j - 0.5, i - 0.5), 1, 1, fill=False, ec=ACCENT))
        axis.set_xticks(range(len(names)), words, rotation=90)
        axis.set_yticks(
            range(len(names)),
            [f"{word}  {v:.0f}" for word, v in zip(words, left["d"], strict=True)],
        )
        axis.set_title(f"wanted d = {d:g}", pad=3)
        axis.set_ylabel("cause, and the d it can reach")
    axes[-1].set_xlabel("explained by")
    figure.colorbar(image, ax=axes, shrink=0.5, label="share of d that is left")
    save(figure, "gap_isolability")


# --------------------------------------------------------------------------- the run


def run(
    folder: Path, jobs: int, scheduler: str | None, progress: Callable[[int, int], None]
) -> None:
    """Compute, then write gap_*.csv and both figures."""
    separate = IsolabilityStudy()
    results = run_chunks(
        separate, len(separate.names) * len(DETECTABILITIES), folder / "gap-isolability",
        separate.key, jobs, chunk=1, scheduler=scheduler, progress=progress,
    )  # fmt: skip
    isolability = matrix(results, separate.names)
    isolability.to_csv(TABLES / "gap_isolability.csv", index=False, float_format="%.4g")
    draw_isolability(isolability)
    what_hides().to_csv(TABLES / "gap_hidden.csv", index=False, float_format="%.4g")
    task = PowerStudy(tuple(cases()))
    results = run_chunks(
        task, len(task.cases), folder / "gap-power", task.key, jobs, chunk=2,
        scheduler=scheduler, progress=progress,
    )  # fmt: skip
    write(pd.DataFrame(results), isolability)


def write(rows: pd.DataFrame, isolability: pd.DataFrame) -> None:
    """Tables and figure from the diagnosed campaigns."""
    rows = scored(rows, inseparable(isolability)).sort_values("case")
    rows.to_csv(TABLES / "gap_cases.csv", index=False, float_format="%.5g")
    table = power(rows)
    table.to_csv(TABLES / "gap_power.csv", index=False, float_format="%.4g")
    draw_power(table, rows)
