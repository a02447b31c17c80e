"""Bound methods: all on the bundled campaign, and how often their intervals hold the truth.

The first is a figure and a table; the second simulates 1000 small campaigns in each of five
settings (``bayes_sensor/checks/coverage.py`` says which); ``docs/choose_a_bound.md`` shows its
table.
"""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path

import pandas as pd
from drawing import FIGURES, PAPER, TABLES
from matplotlib.figure import Figure

from bayes_sensor import figures
from bayes_sensor.bounds import compare_bounds
from bayes_sensor.checks.coverage import SETTINGS, run_coverage
from bayes_sensor.fit import fit_least_squares
from bayes_sensor.io.readers import read_campaign
from bayes_sensor.posterior import sample_posterior

SEED, CAMPAIGNS = 53, 1000
REFERENCE = PAPER.parent / "data" / "reference"


def run(
    folder: Path, jobs: int, scheduler: str | None, progress: Callable[[int, int], None]
) -> None:
    """Compute both; write tables and figures."""
    compare()
    table = run_coverage(
        folder / "coverage-bounds", SETTINGS, CAMPAIGNS, None, SEED, jobs, scheduler, progress
    )
    path = TABLES / "coverage_bounds.csv"
    table.to_csv(path, index=False, float_format="%.5g")
    rows = pd.read_csv(path, dtype={"level": str})
    save(figures.coverage(rows.to_dict("records")), "coverage_bounds")


def compare() -> None:
    """Every method on the bundled campaign: bounds_methods.csv and the figure."""
    campaign = read_campaign(REFERENCE / "campaign.toml")
    truth = json.loads((REFERENCE / "truth.json").read_text(encoding="utf-8"))
    fit = fit_least_squares(campaign, seed=1)
    posterior = sample_posterior(campaign, fit, seed=1)
    bounds = compare_bounds(campaign, fit, posterior, seed=1)
    table = bounds.table().loc[["tau_s", "tau_v_s", "V_mL"]]
    table.to_csv(TABLES / "bounds_methods.csv", float_format="%.5g")
    save(figures.intervals(bounds.to_json(), truth), "bounds_methods")


def save(figure: Figure, name: str) -> None:
    """figures/name.png and .svg in the report's style."""
    (FIGURES / f"{name}.png").write_bytes(figures.png(figure))
    (FIGURES / f"{name}.svg").write_text(figures.svg(figure), encoding="utf-8")
