"""The published bounds (Table III) and what they become with converged derivatives."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path

import pandas as pd
from drawing import FIGURES, PAPER, TABLES

from bayes_sensor import figures
from bayes_sensor.bounds import cramer_rao, step_study
from bayes_sensor.io.readers import read_campaign
from bayes_sensor.likelihood.problem import Problem

REFERENCE = PAPER.parent / "data" / "reference"
PUBLISHED = {"tau_s": 5.6049e-3, "tau_v_s": 8.6029e-3, "V_mL": 0.6817}  # three sigma, Table III
SIGMA = 0.0653  # V, the published RMS residual


def run(
    folder: Path, jobs: int, scheduler: str | None, progress: Callable[[int, int], None]
) -> None:
    """Write published_bounds.csv, bound_against_step.csv and the figure."""
    campaign = read_campaign(REFERENCE / "campaign.toml")
    truth = json.loads((REFERENCE / "truth.json").read_text())
    layout = Problem(campaign).layout
    switches = [n for n in layout.mean_names if n.startswith(("t0_s", "tf_s"))]
    rows = [("Table III as published", PUBLISHED)]
    for text, options in (
        ("forward Euler, forward difference, +1 % of every parameter", {"step": 0.01}),
        ("the same with -1 %", {"step": -0.01}),
        ("the same, central", {"step": 0.01, "difference": "central"}),
        ("converged, closed form", {}),
        ("converged, t0 and tf known", {"fixed": switches}),
    ):
        bound = cramer_rao(campaign, truth, sigma=SIGMA, **options)
        rows.append((text, {n: 3.0 * s for n, s in zip(bound.names, bound.sd, strict=True)}))
    for phi in (0.0, 0.5, 0.9):
        bound = cramer_rao(campaign, {**truth, "phi": phi}, noise="ar1")
        rows.append(
            (
                f"converged, AR(1) phi {phi:g} with concentration-dependent variance",
                {n: 3.0 * s for n, s in zip(bound.names, bound.sd, strict=True)},
            )
        )
    table = pd.DataFrame(
        [
            {
                "how": text,
                "tau_3sigma_ms": 1e3 * values["tau_s"],
                "tau_v_3sigma_ms": 1e3 * values["tau_v_s"],
                "V_3sigma_mL": values["V_mL"],
            }
            for text, values in rows
        ]
    )
    table.to_csv(TABLES / "published_bounds.csv", index=False, float_format="%.5g")
    steps = step_study(campaign, truth, sigma=SIGMA)
    steps.to_csv(TABLES / "bound_against_step.csv", index=False, float_format="%.5g")
    figure = figures.step_study(steps.to_dict(orient="records"), PUBLISHED)
    (FIGURES / "bound_against_step.png").write_bytes(figures.png(figure))
    (FIGURES / "bound_against_step.svg").write_text(figures.svg(figure))
    progress(1, 1)
