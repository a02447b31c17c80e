"""Campaigns at the edge of what can be told: what is said of them, and how often it is right.

Every case of ``tests/support/extreme_cases.py`` is drawn again and again, fitted, sampled and
bounded; an interval counts as plain where nothing is printed beside it, as warned where a warning,
a status or exit code 3 is.  The last case is measured instead: fifty experiments of two minutes at
10 kHz.
"""

from __future__ import annotations

import json
import subprocess
import sys
import time
import warnings
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from drawing import PAPER, TABLES

from bayes_sensor.blind_check import wilson
from bayes_sensor.campaign import CampaignError
from bayes_sensor.checks.study_chunks import run_chunks, study_key

sys.path.insert(0, str(PAPER.parent))
from tests.support.extreme_cases import CASES, METHODS, QUICK, SHARED, VERDICTS, ask, diagnose

SEED = 61
STATED = ("posterior", *METHODS)
DRAWS = {
    "ordinary": 100, "only the fall": 100, "tau below the interval": 100, "one level in one": 12,
    "equal time constants": 20, "step not seen": 4, "noise above the step": 4,
    "tau above the record": 4,
}  # fmt: skip
"""how many of each case where not ``USUAL``; posteriors that wander take up to a minute each"""
USUAL = 40
PLAIN, WARNED, NONE = 0, 1, 2
GAP_DRAWS = 20
"""of each case, for the gap"""
CONFIDENT = 0.9
"""probability above which a verdict names an effect"""


@dataclass(frozen=True)
class ExtremeStudy:
    """The task: draw number i of one case."""

    case: str

    @property
    def key(self) -> str:
        """Everything that the numbers depend on."""
        return study_key("extremes", self.case, STATED, QUICK, SEED)

    def __call__(self, i: int) -> dict[str, Any]:
        """``kind`` and ``inside`` (n_methods, 3), ``width`` relative to the truth, ``crashed``."""
        shape = (len(STATED), len(SHARED))
        found = {
            "kind": np.full(shape, NONE), "inside": np.zeros(shape, dtype=bool),
            "width": np.full(shape, np.nan), "crashed": 0, "seconds": 0.0,
        }  # fmt: skip
        begin = time.perf_counter()
        problem, theta = CASES[self.case].make(1000 * SEED + i)
        truth = theta[:3]
        try:
            told = ask(problem, seed=i + 1, sampler=CASES[self.case].sampler)
        except (ArithmeticError, IndexError, ValueError, np.linalg.LinAlgError) as error:
            if isinstance(error, CampaignError):
                raise
            found["crashed"] = 1
            return found
        for j, method in enumerate(STATED):
            ends = told.intervals.get(method)
            if ends is None:
                continue
            given = np.isfinite(ends).all(axis=1)
            found["kind"][j, given] = WARNED if told.warned[method] else PLAIN
            found["inside"][j] = given & (ends[:, 0] <= truth) & (truth <= ends[:, 1])
            found["width"][j, given] = ((ends[:, 1] - ends[:, 0]) / truth)[given]
        found["seconds"] = time.perf_counter() - begin
        return found


@dataclass(frozen=True)
class ExtremeGap:
    """The task: the gap's verdict on draw number i of one case."""

    case: str

    @property
    def key(self) -> str:
        """Everything that the numbers depend on."""
        return study_key("extremes-gap", self.case, VERDICTS, SEED)

    def __call__(self, i: int) -> dict[str, Any]:
        """``kind``, as a position in ``VERDICTS`` (-1: a crash), and ``probability``."""
        problem, _ = CASES[self.case].make(1000 * SEED + i)
        try:
            with warnings.catch_warnings(), np.errstate(all="ignore"):
                warnings.simplefilter("ignore")
                kind, _, probability = diagnose(problem, seed=i + 1)
        except (ArithmeticError, IndexError, ValueError, np.linalg.LinAlgError):
            return {"kind": -1, "probability": 0.0}
        return {"kind": VERDICTS.index(kind), "probability": probability}


def tabulate_gap(
    folder: Path, jobs: int, scheduler: str | None, progress: Callable[[int, int], None]
) -> None:
    """Compute, then write extremes_gap.csv: nothing is wrong, so every name is a false one."""
    rows = []
    for number, (case, extreme) in enumerate(CASES.items()):
        task = ExtremeGap(case)
        results = run_chunks(
            task, GAP_DRAWS, folder / f"extremes-gap-{case.replace(' ', '-')}", task.key, jobs,
            chunk=1, scheduler=scheduler,
        )  # fmt: skip
        kind, probability = results["kind"], results["probability"]
        row: dict[str, Any] = {"case": case, "what": extreme.words, "draws": len(kind)}
        for i, name in enumerate(VERDICTS):
            row[name] = int((kind == i).sum())
        named = kind == VERDICTS.index("effect")
        confident = named & (probability > CONFIDENT)
        row["confident"] = int(confident.sum())
        row["crashed"] = int((kind < 0).sum())
        rows.append(row)
        progress(number + 1, len(CASES))
    pd.DataFrame(rows).to_csv(TABLES / "extremes_gap.csv", index=False)


def rows_of(case: str, results: Mapping[str, np.ndarray]) -> list[dict[str, Any]]:
    """One row per method and parameter."""
    rows = []
    n = len(results["crashed"])
    for j, method in enumerate(STATED):
        for i, name in enumerate(SHARED):
            kind, inside = results["kind"][:, j, i], results["inside"][:, j, i]
            plain, warned = kind == PLAIN, kind == WARNED
            wrong = int((plain & ~inside).sum())
            low, high = wilson(n - wrong, n)
            widths = results["width"][kind != NONE, j, i]
            rows.append(
                {
                    "case": case, "what": CASES[case].words, "method": method, "parameter": name,
                    "draws": n, "plain": int(plain.sum()),
                    "plain_covered": int((plain & inside).sum()), "warned": int(warned.sum()),
                    "warned_covered": int((warned & inside).sum()),
                    "no_value": int((kind == NONE).sum()), "not_misled": (n - wrong) / n,
                    "not_misled_lo95": low, "not_misled_hi95": high,
                    "median_relative_width": np.median(widths) if len(widths) else np.nan,
                    "crashed": int(results["crashed"].sum()),
                }
            )  # fmt: skip
    return rows


def run(
    folder: Path, jobs: int, scheduler: str | None, progress: Callable[[int, int], None]
) -> None:
    """Compute, then write extremes.csv, extremes_summary.csv and extremes_large.csv."""
    rows = []
    total = sum(DRAWS.get(case, USUAL) for case in CASES)
    done = 0
    for case in CASES:
        task, n = ExtremeStudy(case), DRAWS.get(case, USUAL)

        def tell(part: int, _: int, before: int = done) -> None:
            progress(before + part, total)

        results = run_chunks(
            task, n, folder / f"extremes-{case.replace(' ', '-')}", task.key, jobs, chunk=4,
            scheduler=scheduler, progress=tell,
        )  # fmt: skip
        done += n
        rows += rows_of(case, results)
    table = pd.DataFrame(rows)
    table.to_csv(TABLES / "extremes.csv", index=False, float_format="%.4g")
    summary(table).to_csv(TABLES / "extremes_summary.csv", index=False)
    tabulate_gap(folder, jobs, scheduler, lambda _done, _total: None)
    large = TABLES / "extremes_large.csv"
    measure_large(folder / "extremes-large").to_csv(large, index=False, float_format="%.4g")


def summary(table: pd.DataFrame) -> pd.DataFrame:
    """A row a case, a column a method: plain intervals that hold the truth of plain ones, then how
    many draws came with a warning and without a value, tau, tau_v and V together."""
    rows = []
    for _, some in table.groupby("case", sort=False):
        row = {"case": some["what"].iloc[0], "draws": int(some["draws"].iloc[0])}
        for method in ("posterior", "profile", "crlb_ar1", "block_bootstrap"):
            of = some[some["method"] == method]
            plain, covered = int(of["plain"].sum()), int(of["plain_covered"].sum())
            row[method] = (
                f"{covered}/{plain}; {int(of['warned'].sum())} w; {int(of['no_value'].sum())} n"
            )
        row["crashed"] = int(some["crashed"].iloc[0])
        rows.append(row)
    return pd.DataFrame(rows)


# --------------------------------------------------------------------------- 10 kHz, 50 experiments

LARGE = """
import json, resource, sys, time
import numpy as np
from bayes_sensor.bounds import compare_bounds
from bayes_sensor.campaign import Campaign, Experiment
from bayes_sensor.fit import fit_least_squares
from bayes_sensor.likelihood import Problem, simulate
from bayes_sensor.posterior import sample_posterior

n, interval, duration = int(sys.argv[1]), float(sys.argv[2]), float(sys.argv[3])
t = interval * np.arange(round(duration / interval))
flows = np.linspace(3.0, 9.0, n) / 0.06
experiments = tuple(
    Experiment(str(i), t, None, 0.85 * q, 0.15 * q, interval, 0.2 * duration, 0.7 * duration)
    for i, q in enumerate(flows)
)
theta = {"tau_s": 0.0481, "tau_v_s": 0.8577, "V_mL": 58.23, "phi": 0.95, "sigma0_V": 0.045,
         "sigma1_V": 0.07, "experiments": {e.name: {"y0_V": 0.2, "beta_V": 1.9,
         "t0_s": 0.2 * duration + 0.7, "tf_s": 0.7 * duration + 0.3} for e in experiments}}

def gigabytes():
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 2**20

def measure(step, call):
    begin = time.perf_counter()
    result = call()
    row = {"step": step, "seconds": time.perf_counter() - begin, "peak_GB": gigabytes()}
    print(json.dumps(row), flush=True)
    return result

problem = Problem(Campaign("large", experiments, sensor_is="faster"))
campaign = measure("simulate (the data alone)", lambda: simulate(problem, theta, seed=1))
fit = measure("fit", lambda: fit_least_squares(campaign, seed=1, euler=False))
posterior = measure("posterior", lambda: sample_posterior(campaign, fit, 1, "independence"))
methods = ["crlb_iid", "crlb_ar1", "sandwich", "profile", "posterior"]
bounds = measure("bounds", lambda: compare_bounds(campaign, fit, posterior, methods))
for name in ("tau_s", "tau_v_s", "V_mL"):
    low, high = bounds["profile"].interval(name)
    print(json.dumps({"step": name, "low": low, "high": high, "truth": theta[name]}), flush=True)
"""
N_LARGE, INTERVAL, DURATION = 50, 1e-4, 120.0


def measure_large(folder: Path) -> pd.DataFrame:
    """Seconds and peak memory of every step at 10 kHz, in a process of its own; and its answer."""
    arguments = [str(N_LARGE), str(INTERVAL), str(DURATION)]
    found = folder / "measured.jsonl"
    if not found.exists():
        folder.mkdir(parents=True, exist_ok=True)
        done = subprocess.run(
            [sys.executable, "-c", LARGE, *arguments],
            capture_output=True, text=True, check=True, timeout=3600, cwd=PAPER.parent,
        )  # fmt: skip
        found.write_text(done.stdout)
    rows = [json.loads(line) for line in found.read_text().splitlines()]
    for row in rows:
        row["samples"] = N_LARGE * round(DURATION / INTERVAL)
        if "truth" in row:
            row["covered"] = int(row["low"] <= row["truth"] <= row["high"])
    return pd.DataFrame(rows)
