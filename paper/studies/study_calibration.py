"""The calibration map of the diagnosis, fitted to simulated campaigns whose truth is known.

Campaigns of the blind check's generator in its own mix of causes, none of them in reserve, in the
quick size.  Each is diagnosed, and what its evidences look like is kept before calibration.  The
map's numbers are those that make the truths likeliest (nothing that could be seen, a listed cause,
an unlisted one); they are written to ``bayes_sensor/diagnosis/calibration.json``.  The check: the
map is fitted to one half of the campaigns and scored on the other, and the reverse, beside the
evidences as they are and the map in use; ``paper/tables/calibration.csv`` holds all.  A map in use
that does better than those fitted to halves stays: what has changed since it was fitted does not
ask for another.  The factor on the interval of tau is fitted anew in any case.  How often tau lies
in its intervals with and without a discrepancy, where a cause is not listed, is in
``paper/tables/tau_with_discrepancy.csv``.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass, fields, replace
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from drawing import TABLES
from scipy.optimize import minimize
from scipy.special import expit, logit

from bayes_sensor.blind_check.plan import Entry, draw_truth, make_plan
from bayes_sensor.blind_check.simulator import CAUSES, Case, make_campaign
from bayes_sensor.campaign import CampaignError
from bayes_sensor.checks.study_chunks import run_chunks, study_key
from bayes_sensor.diagnosis import diagnose_gap
from bayes_sensor.diagnosis.calibration import Appearance, Calibration, calibration
from bayes_sensor.diagnosis.probabilities import FAINT
from bayes_sensor.fit import fit_least_squares

SEED = 815
PLANNED = 600
TAKEN = 136
"""of these, the first ones are taken for the map: a share is then known to some hundredths"""
TAKEN_FOR_TAU = 285
"""of these, the unlisted and the withheld ones are taken for tau"""
SIZE = "small"
SEEN = (6.0, 40.0)
"""detectabilities of unlisted causes that tau is judged at: asked for are 8, 16 and 32"""
CLASSES = ("none", "listed", "unlisted")
LEAST = 1e-4
"""mass of an appearance that is left out"""
HELD_BACK = 2.0
"""campaigns that the starting values count for, in the logarithm of odds of one"""
EARLIER, EARLIER_RIGHT, AT = 40.0, 0.42, 7.0
"""findings of long records, which these short ones hardly have: of 234 campaigns of eight sealed
blind checks that single samples showed as unlisted, 99 were; they count for so many campaigns, at a
log odds that is typical of such findings"""
HELD = 0.9
"""share of the 95 % intervals of tau that shall hold it at least: a few causes move tau by what
no smooth discrepancy tells of, and a factor that covers these makes all others useless"""
AS_IT_IS = Calibration(1e-9, 1e-9, 1e-9, 1e-9, 1e-9, 1e-9, 1e-9, 0.0, 1.0)
"""the evidences taken at their word"""
BEGIN = Calibration(0.05, 0.5, 0.125, 0.05, 0.05, 0.02, 0.02, -1.0, 0.3)
MAP = Path(__file__).resolve().parents[2] / "bayes_sensor" / "diagnosis" / "calibration.json"

Told = tuple[int, list[Appearance]]
"""number of the true class, what the evidences look like"""


@dataclass(frozen=True)
class LookingAt:
    """The task: what one campaign looks like, and what it is."""

    entries: tuple[Entry, ...]

    @property
    def key(self) -> str:
        """Everything that the numbers depend on."""
        return study_key("calibration", [asdict(e) for e in self.entries], SEED)

    def __call__(self, i: int) -> dict[str, Any]:
        """``told``: JSON, the true class and the appearances; null where nothing can be told.

        ``tau``: JSON, d and tau of an unlisted cause, and both intervals of tau; else null.
        """
        truth = draw_truth(self.entries[i])
        true = class_of(truth)
        if true is None:
            return {"told": "null", "tau": "null"}
        campaign = make_campaign(Case.from_json(truth["recipe"]))
        taken_out = truth["listed_as"] if truth["kind"] == "withheld" else []
        without = sorted({name for names in taken_out for name in names})
        seed = self.entries[i].diagnosis_seed
        try:
            fit = fit_least_squares(campaign, seed=seed, euler=False, swarms=1)
            gap = diagnose_gap(
                campaign, fit, seed=seed, without=without, bootstrap=0, separate=False,
                follow=False, hidden=False,
            )  # fmt: skip
        except CampaignError:
            return {"told": "null", "tau": "null"}
        tau = None
        if true == CLASSES.index("unlisted") and gap.tau_with_discrepancy_s is not None:
            wide, plain = gap.tau_with_discrepancy_s, gap.shrink
            tau = [truth["d"], truth["tau_s"], wide["q2.5"], wide["q97.5"],
                   plain.tau_before_low_s, plain.tau_before_high_s]  # fmt: skip
        seen = [list(a) for a in gap.probabilities.appearances if a.mass > LEAST]
        return {"told": json.dumps([true, seen]), "tau": json.dumps(tau)}


def class_of(truth: dict[str, Any]) -> int | None:
    """Number of the true class of the mean; None where a cause of the noise was taken out."""
    causes = [CAUSES[name] for name in truth["causes"]]
    on_noise = bool(causes) and all(c.noise for c in causes)
    if on_noise and truth["kind"] == "withheld":
        return None
    if not causes or truth["d"] < FAINT:
        return 0
    if truth["kind"] in ("unlisted", "withheld"):
        return 2
    return 0 if on_noise else 1


def run(folder: Path, jobs: int, scheduler: str | None, progress: Callable[..., None]) -> None:
    """Diagnose all campaigns, fit the map, write it and its check."""
    plan = make_plan(PLANNED, SEED, size=SIZE)
    of_tau = [e for e in plan[TAKEN:TAKEN_FOR_TAU] if e.kind in ("unlisted", "withheld")]
    entries = (*plan[:TAKEN], *(e for e in of_tau if SEEN[0] <= e.level <= SEEN[1]))
    task = LookingAt(entries)
    found = run_chunks(
        task, len(entries), folder / "calibration", task.key, jobs, 4, scheduler, progress
    )
    told = [
        (content[0], [Appearance(*a[:1], tuple(a[1]), *a[2:]) for a in content[1]])
        for content in map(json.loads, found["told"][:TAKEN].tolist())
        if content is not None
    ]
    taus = [row for row in map(json.loads, found["tau"].tolist()) if row is not None]
    seen = np.array([row for row in taus if SEEN[0] <= row[0] <= SEEN[1]])
    write(told, widening(seen))
    write_tau(seen)


def widening(seen: np.ndarray) -> float:
    """The factor on the spread of ln tau with which a share ``HELD`` of the intervals hold tau.

    ``seen`` (n, 6): d, tau, and both intervals of tau, that with a discrepancy widened by the map's
    factor.  The quantile is that of split conformal prediction (Vovk et al. 2005), for campaigns
    like these.
    """
    tau, low, high = np.log(seen[:, 1:4]).T
    needed = calibration().tau_widening * np.abs(tau - 0.5 * (low + high)) / (0.5 * (high - low))
    at = min(int(np.ceil(HELD * (len(needed) + 1))), len(needed)) - 1
    return max(float(np.sort(needed)[at]), 1.0)


def write_tau(seen: np.ndarray) -> None:
    """How often both intervals of tau hold it, where a cause is not listed and clearly seen."""
    d, tau, low, high, plain_low, plain_high = seen.T
    middle, half = np.sqrt(low * high), np.sqrt(high / low)
    half = half ** (widening(seen) / calibration().tau_widening)
    low, high = middle / half, middle * half
    table = []
    for name, ends in (("without", (plain_low, plain_high)), ("with", (low, high))):
        held = (ends[0] <= tau) & (tau <= ends[1])
        lo, hi = wilson(int(held.sum()), len(d))
        table.append({
            "discrepancy": name, "campaigns": len(d), "held": int(held.sum()),
            "share": held.mean(), "lo95": lo, "hi95": hi,
            "median_width": np.median(np.log(ends[1] / ends[0])),
        })  # fmt: skip
    pd.DataFrame(table).to_csv(
        TABLES / "tau_with_discrepancy.csv", index=False, float_format="%.4g"
    )


def wilson(k: int, n: int) -> tuple[float, float]:
    """95 % interval of a proportion (Wilson 1927)."""
    z = 1.96
    centre, half = (k + z * z / 2) / (n + z * z), z * np.sqrt(k * (n - k) / n + z * z / 4)
    return float(centre - half / (n + z * z)), float(centre + half / (n + z * z))


def write(told: Sequence[Told], tau_widening: float) -> None:
    """The map, and the table of its check."""
    fitted, in_use = fitted_map(told), calibration()
    halves = [told[::2], told[1::2]]
    crossed = [(fitted_map(a), b) for a, b in (halves, halves[::-1])]
    scores = {
        "evidences as they are": score([(AS_IT_IS, told)]),
        "in use": score([(in_use, told)]),
        "fitted to the other half": score(crossed),
        "fitted to all": score([(fitted, told)]),
    }
    stays = scores["in use"]["log_score"] <= scores["fitted to the other half"]["log_score"]
    chosen = replace(in_use if stays else fitted, tau_widening=tau_widening)
    rounded = {f.name: float(f"{getattr(chosen, f.name):.2g}") for f in fields(chosen)}
    MAP.write_text(json.dumps(rounded, indent=2) + "\n", encoding="utf-8")
    rows = [{"map": name, **found} for name, found in scores.items()]
    pd.DataFrame(rows).to_csv(TABLES / "calibration.csv", index=False, float_format="%.4g")


def fitted_map(told: Sequence[Told]) -> Calibration:
    """The map that makes the truths likeliest, leaning a little on where it begins."""
    begin = _free(BEGIN)

    def loss(x: np.ndarray) -> float:
        table = _map(x)
        logs = [np.log(max(table.classes(seen)[true], 1e-12)) for true, seen in told]
        right = table.of_finding(AT)
        logs.append(EARLIER * EARLIER_RIGHT * np.log(right))
        logs.append(EARLIER * (1.0 - EARLIER_RIGHT) * np.log1p(-right))
        return -float(np.sum(logs)) + 0.5 * HELD_BACK * float(np.sum((x - begin) ** 2)) / 4.0

    return _map(minimize(loss, begin, method="L-BFGS-B", options={"maxiter": 60}).x)


def _free(table: Calibration) -> np.ndarray:
    """Unbounded coordinates: ln of odds and of the slope, ln(p / (1 - p)) of shares."""
    t = table
    shares = (t.form_unlisted, t.unlisted_none, t.unlisted_listed, t.none_listed, t.none_unlisted)
    return np.array([
        np.log(t.listed_none), np.log(t.listed_unlisted), *logit(2.0 * np.array(shares)),
        t.finding_offset, np.log(t.finding_slope),
    ])  # fmt: skip


def _map(x: np.ndarray) -> Calibration:
    # no share above one half: two of them may not exceed the whole
    return Calibration(
        float(np.exp(x[0])), float(np.exp(x[1])), *(0.5 * expit(x[2:7])).tolist(), float(x[7]),
        float(np.exp(x[8])),
    )  # fmt: skip


def score(fits: Sequence[tuple[Calibration, Sequence[Told]]]) -> dict[str, float]:
    """Mean log score, Brier score and calibration error of maps on campaigns."""
    p = np.array([t.classes(seen) for t, told in fits for _, seen in told])
    true = np.array([k for _, told in fits for k, _ in told])
    hit = np.eye(3)[true]
    log_score = -np.mean(np.log(np.maximum(p[np.arange(len(true)), true], 1e-12)))
    stated, right = p.max(axis=1), hit[np.arange(len(true)), p.argmax(axis=1)]
    edges = np.quantile(stated, np.linspace(0.0, 1.0, 11))
    of = np.clip(np.searchsorted(edges, stated, side="right") - 1, 0, 9)
    apart = [
        np.mean(of == k) * abs(stated[of == k].mean() - right[of == k].mean())
        for k in range(10) if np.any(of == k)
    ]  # fmt: skip
    found: dict[str, float] = {
        "campaigns": len(true), "log_score": float(log_score),
        "brier": float(np.mean(np.sum((p - hit) ** 2, axis=1))),
        "stated": float(stated.mean()), "right": float(right.mean()),
        "calibration_error": float(np.sum(apart)),
    }  # fmt: skip
    for k, name in enumerate(CLASSES):
        found[f"mean_p_{name}"], found[f"share_{name}"] = p[:, k].mean(), hit[:, k].mean()
    return found
