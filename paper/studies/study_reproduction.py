"""Tables I to III and Figs. 3 to 8 of the paper, beside what this package finds on the replica.

The replica has the published parameters as its truth, noise that is coloured and grows with
concentration, and one late start (experiment 4), so every published number has a counterpart.
"""

from __future__ import annotations

import json
import math
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from drawing import FIGURES, PAPER, TABLES
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import FancyBboxPatch

from bayes_sensor import figures
from bayes_sensor.bounds import cramer_rao
from bayes_sensor.checks.delays import regress_delays
from bayes_sensor.checks.predictive import check_predictive
from bayes_sensor.figures.colours import BLUE, INK, MIDDLE, PALE, REGIONS
from bayes_sensor.figures.style import panels, style
from bayes_sensor.fit import fit_least_squares
from bayes_sensor.fit.traces import make_traces
from bayes_sensor.io.readers import read_campaign
from bayes_sensor.posterior import Settings, sample_posterior
from bayes_sensor.residuals import diagnose_residuals

REFERENCE = PAPER.parent / "data" / "reference"
SEED = 1
SETTINGS = Settings(n_chains=4, n_draws=8000)
PUBLISHED_RMS_MV = 65.3
PUBLISHED_SHARED = {"tau_s": 48.1, "tau_v_s": 857.7, "V_mL": 58.23}
"""ms, ms, mL (Sec. III-B)"""
PUBLISHED_3SD = {"tau_s": 5.6049, "tau_v_s": 8.6029, "V_mL": 0.6817}
"""ms, ms, mL (Table III)"""
PUBLISHED_DELAYS = {
    "start": {"intercept_s": 0.1340, "slope_L": 0.1125, "r2": 0.9414},
    "end": {"intercept_s": 0.0161, "slope_L": 0.0745, "r2": 0.8976},
}
"""Sec. III-B; the start without experiment 4"""
SCALE = {"tau_s": ("ms", 1e3), "tau_v_s": ("ms", 1e3), "V_mL": ("mL", 1.0)}


def run(
    folder: Path, jobs: int, scheduler: str | None, progress: Callable[[int, int], None]
) -> None:
    """Write reproduction*.csv and the figures reproduction_*."""
    campaign = read_campaign(REFERENCE / "campaign.toml")
    truth = json.loads((REFERENCE / "truth.json").read_text())
    fit = fit_least_squares(campaign, seed=SEED)
    residuals = diagnose_residuals(campaign, fit).to_json()
    posterior = sample_posterior(campaign, fit, SEED, "independence", SETTINGS)
    delays = regress_delays(campaign, fit, posterior).to_json()
    progress(1, 2)
    table_one(campaign).to_csv(TABLES / "reproduction_table1.csv", index=False)
    table_two(truth, fit, posterior).to_csv(
        TABLES / "reproduction_table2.csv", index=False, float_format="%.6g"
    )
    shared(campaign, truth, fit, posterior, delays).to_csv(
        TABLES / "reproduction.csv", index=False, float_format="%.5g"
    )
    priors = pd.DataFrame(posterior.to_json()["tau_under_priors"])
    priors.to_csv(TABLES / "reproduction_priors.csv", index=False, float_format="%.5g")

    traces = make_traces(campaign, fit)
    concentration = {e.name: e.concentration for e in campaign}
    chains = ([*posterior.layout.names], posterior.chains)
    for name, figure in (
        ("responses", figures.responses(traces)),
        ("schematic", schematic()),
        ("overlay", figures.overlay(traces[0])),
        ("histogram", figures.histogram(residuals, fit.rms)),
        ("delays", figures.delays(delays, concentration)),
        ("autocorrelation", figures.autocorrelation(residuals, traces)),
        ("spread", figures.spread(residuals)),
        ("corner", figures.corner(*chains)),
        ("predictive", figures.predictive(check_predictive(posterior).to_json())),
    ):
        (FIGURES / f"reproduction_{name}.png").write_bytes(figures.png(figure))
        (FIGURES / f"reproduction_{name}.svg").write_text(figures.svg(figure), encoding="utf-8")
    progress(2, 2)


def schematic() -> Figure:
    """The model as a chain of first-order lags, with the response of each to a step (paper Fig.
    4)."""
    boxes = (
        ("command", "u(t)", "open at t₀, then shut"),
        ("valve", "x₁′ = (u − x₁)/τᵥ", "same in every experiment"),
        ("manifold", "x₂′ = (Q/V)(x₁ − x₂)", "faster at higher flow"),
        ("sensor", "x₃′ = (x₂ − x₃)/τ", "the lag that is sought"),
        ("readout", "y = y₀ + β x₃", "plus coloured noise"),
    )
    lags = (0.0, 0.35, 0.6, 0.12, 0.0)
    with style():
        figure, ((axes,),) = panels(2.15, left=0.05, right=0.05, top=0.05, bottom=0.05)
        axes.set_axis_off()
        axes.set(xlim=(0.0, 5.0), ylim=(0.0, 1.0))
        kept: list[float] = []
        for i, (name, law, remark) in enumerate(boxes):
            left = i + 0.06
            axes.add_patch(
                FancyBboxPatch(
                    (left, 0.3), 0.82, 0.66, boxstyle="round,pad=0,rounding_size=0.04",
                    facecolor=REGIONS[0] if name == "sensor" else "none", edgecolor=INK, lw=0.9,
                )
            )  # fmt: skip
            axes.text(left + 0.41, 0.89, name, ha="center", va="center", weight="bold", fontsize=9)
            axes.text(left + 0.41, 0.4, law, ha="center", va="center", fontsize=7.6)
            axes.text(left + 0.41, 0.2, remark, ha="center", va="center", fontsize=7, color=MIDDLE)
            kept = [*kept, lags[i]] if lags[i] else kept
            _pulse(axes, left + 0.1, kept)
            if i + 1 < len(boxes):
                axes.annotate(
                    "", (left + 1.0, 0.63), (left + 0.82, 0.63),
                    arrowprops={"arrowstyle": "-|>", "color": INK, "lw": 1.0},
                )  # fmt: skip
    return figure


def _pulse(axes: Axes, left: float, lags: Sequence[float]) -> None:
    """A step up and down after first-order lags, drawn small."""
    t = np.linspace(0.0, 8.0, 400)
    x = ((t > 1.0) & (t < 5.0)).astype(float)
    for lag in lags:
        follow = np.zeros_like(x)
        gain = -np.expm1(-(t[1] - t[0]) / lag)
        for k in range(1, len(t)):
            follow[k] = follow[k - 1] + gain * (x[k] - follow[k - 1])
        x = follow
    axes.plot(left + 0.62 * t / 8.0, np.full_like(t, 0.5), color=PALE, lw=0.7)
    axes.plot(left + 0.62 * t / 8.0, 0.5 + 0.28 * x, color=BLUE, lw=1.4)


def table_one(campaign: Any) -> pd.DataFrame:
    """The experimental conditions, as they were read back from the replica's files."""
    return pd.DataFrame(
        [
            {
                "experiment": e.name,
                "total_flow_L_min": round(0.06 * e.total_flow, 6),
                "N2_L_min": round(0.06 * e.carrier_flow, 6),
                "CO2_L_min": round(0.06 * e.test_gas_flow, 6),
                "CO2_percent": round(100 * e.concentration, 1),
            }
            for e in campaign
        ]
    )


def table_two(truth: dict[str, Any], fit: Any, posterior: Any) -> pd.DataFrame:
    """y0, beta, t0 and tf of each experiment: published, least squares, posterior."""
    summary = posterior.to_json()["parameters"]
    rows = []
    for name, published in truth["experiments"].items():
        for key, value in published.items():
            found = summary[f"{key}[{name}]"]
            rows.append(
                {
                    "experiment": name,
                    "parameter": key,
                    "published": value,
                    "least_squares": fit.parameters["experiments"][name][key],
                    "median": found["q50"],
                    "lo95": found["q2.5"],
                    "hi95": found["q97.5"],
                    "inside": found["q2.5"] <= value <= found["q97.5"],
                }
            )
    return pd.DataFrame(rows)


def shared(
    campaign: Any, truth: dict[str, Any], fit: Any, posterior: Any, delays: dict[str, Any]
) -> pd.DataFrame:
    """Every other published number and its counterpart, with intervals where we give one."""
    summary = posterior.to_json()["parameters"]
    rows: list[dict[str, Any]] = [
        {"quantity": "RMS residual", "unit": "mV", "published": PUBLISHED_RMS_MV,
         "ours": 1e3 * fit.rms}
    ]  # fmt: skip
    for key, published in PUBLISHED_SHARED.items():
        unit, factor = SCALE[key]
        row = summary[key]
        rows.append(
            {"quantity": key, "unit": unit, "published": published,
             "ours": factor * fit.parameters[key], "median": factor * row["q50"],
             "lo95": factor * row["q2.5"], "hi95": factor * row["q97.5"]}
        )  # fmt: skip
    recipe = cramer_rao(campaign, truth, sigma=1e-3 * PUBLISHED_RMS_MV, step=0.01)
    for key, published in PUBLISHED_3SD.items():
        unit, factor = SCALE[key]
        rows.append(
            {"quantity": f"3 sigma of {key}", "unit": unit, "published": published,
             "ours": 3 * factor * recipe[key]}
        )  # fmt: skip
    for side, published_line in PUBLISHED_DELAYS.items():
        line = delays[side]
        for key, published in published_line.items():
            low, high = line["ci95"].get(key) or (math.nan, math.nan)
            rows.append(
                {"quantity": f"{side} delay, {key}", "unit": {"r2": ""}.get(key, key[-1]),
                 "published": published, "ours": line[key], "lo95": low, "hi95": high}
            )  # fmt: skip
    return pd.DataFrame(rows)
