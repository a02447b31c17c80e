"""Coverage of posterior intervals at the paper's size, and of tau near its boundary.

Seven experiments of 120 s at 1 ms (the design of the bundled campaign), default priors, published
parameters; phi .5 and .9, and at phi .9 also tau = 20 and 5 ms.
"""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pandas as pd
from drawing import ACCENT, INK, PAPER, SHADE, TABLES, WIDTH, label, plt, save
from posterior_calibration import LEVELS, CoverageStudy, coverage_table, tau_table

from bayes_sensor.campaign import Campaign
from bayes_sensor.checks.counted_coverage import binomial_interval
from bayes_sensor.checks.study_chunks import run_chunks
from bayes_sensor.io.readers import read_campaign
from bayes_sensor.likelihood.problem import Problem
from bayes_sensor.posterior import SAMPLERS, Settings

SEED = 47
REFERENCE = PAPER.parent / "data" / "reference"
CASES = ((0.5, 0.0481, 300), (0.9, 0.0481, 300), (0.9, 0.020, 120), (0.9, 0.005, 300))
"""phi, tau (s) and how many campaigns, all with the same streams of random numbers; the first two
give the table of every parameter, the last three that of tau"""


def design() -> Campaign:
    """The bundled campaign without its data."""
    campaign = read_campaign(REFERENCE / "campaign.toml")
    # times from the grid itself, so that the design does not hang on a recorder's rounding
    bare = tuple(replace(e, y=None, drive=None, mask=None) for e in campaign)
    return replace(campaign, experiments=bare, warnings=())


def study(problem: Problem, phi: float, tau: float) -> CoverageStudy:
    """The task of one case."""
    truth = json.loads((REFERENCE / "truth.json").read_text())
    theta = problem.layout.flat({**truth, "phi": phi, "tau_s": tau})
    settings = Settings(n_chains=2, n_draws=1000, target_ess=400, max_draws=6000, max_steps=600)
    return CoverageStudy(problem, theta, settings=settings, seed=SEED)


def run(
    folder: Path, jobs: int, scheduler: str | None, progress: Callable[[int, int], None]
) -> None:
    """Compute, then write coverage_posterior.csv, coverage_tau.csv and the figures."""
    problem = Problem(design())
    names = problem.layout.names
    every, taus, samplers = [], [], []
    for phi, tau, n in CASES:
        task = study(problem, phi, tau)
        place = folder / f"coverage-{phi:g}-{1e3 * tau:g}ms"
        results = run_chunks(
            task, n, place, task.key, jobs, chunk=10, scheduler=scheduler, progress=progress
        )
        if tau == CASES[0][1]:
            table = coverage_table(names, task.theta, results)
            table.insert(0, "phi", phi)
            every.append(table)
        if phi == 0.9:
            table = tau_table(tau, results)
            table.insert(0, "phi", phi)
            taus.append(table)
        samplers.append(
            {
                "phi": phi,
                "tau_ms": 1e3 * tau,
                "n": n,
                **{s: int((results["sampler"] == i).sum()) for i, s in enumerate(SAMPLERS)},
                "not_converged": int((results["converged"] == 0).sum()),
                "largest_k_hat": np.nanmax(results["k_hat"]),
                "largest_r_hat": results["r_hat"].max(),
                "smallest_ess": results["ess"].min(),
                "largest_mesh_error": results["mesh_error"].max(),
            }
        )
    parameters, tau_rows = pd.concat(every), pd.concat(taus)
    parameters.to_csv(TABLES / "coverage_posterior.csv", index=False, float_format="%.5g")
    tau_rows.to_csv(TABLES / "coverage_tau.csv", index=False, float_format="%.5g")
    pd.DataFrame(samplers).to_csv(
        TABLES / "coverage_samplers.csv", index=False, float_format="%.4g"
    )
    draw_parameters(parameters)
    draw_tau(tau_rows)


def draw_parameters(table: pd.DataFrame) -> None:
    """Coverage of every parameter at every level, with the band in which chance would leave it."""
    phis = sorted(set(table["phi"]))
    names = list(dict.fromkeys(table["parameter"]))
    figure, axes = plt.subplots(
        1, len(LEVELS), figsize=(WIDTH, 0.14 * len(names) + 0.9), sharey=True, layout="constrained"
    )
    for axis, level in zip(axes, LEVELS):
        some = table[table["nominal"] == level]
        n = int(some["n"].iloc[0])
        low, high = binomial_interval(round(level * n), n)
        axis.axvspan(low, high, color=SHADE, lw=0)
        axis.axvline(level, color=INK, lw=0.6)
        for phi, marker, colour, shift in zip(phis, "os", (INK, ACCENT), (-0.15, 0.15)):
            of = some[some["phi"] == phi].set_index("parameter").loc[names]
            face = colour if marker == "o" else "white"
            axis.plot(
                of["coverage"], np.arange(len(names)) + shift, marker, color=colour,
                markerfacecolor=face, label=rf"$\varphi = {phi:g}$",
            )  # fmt: skip
        axis.set_xlabel(f"coverage of the\n{100 * level:g} % interval")
    axes[0].set_yticks(range(len(names)), [label(name) for name in names])
    axes[0].set_ylim(-0.7, len(names) - 0.3)
    axes[0].invert_yaxis()
    handles, labels = axes[0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside lower center", ncols=2)
    save(figure, "coverage_posterior")


def draw_tau(table: pd.DataFrame) -> None:
    """Coverage of tau's intervals and limits under three priors, at three truths."""
    claims = list(dict.fromkeys(table["claim"]))
    truths = sorted(set(table["tau_ms"]))
    looks = {
        "half_normal": ("o", ACCENT, ACCENT),
        "flat": ("s", INK, "white"),
        "log_uniform_floored": ("^", "0.45", "0.45"),
    }
    figure, axes = plt.subplots(
        1, len(claims), figsize=(WIDTH, 2.3), sharey=True, layout="constrained"
    )
    for axis, claim in zip(axes, claims):
        for j, (prior, (marker, colour, face)) in enumerate(looks.items()):
            of = table[(table["claim"] == claim) & (table["prior"] == prior)].sort_values("tau_ms")
            x = np.arange(len(truths)) + 0.2 * (j - 1)
            errors = [
                of["coverage"] - of["coverage_lo95"],
                of["coverage_hi95"] - of["coverage"],
            ]
            axis.errorbar(
                x, of["coverage"], errors, fmt=marker, color=colour, markerfacecolor=face,
                elinewidth=0.8, label=prior.replace("_", "-").replace("-floored", ", floored"),
            )  # fmt: skip
        nominal = float(of["nominal"].iloc[0])
        axis.axhline(nominal, color=INK, lw=0.6, ls="--")
        axis.set_xticks(range(len(truths)), [f"{v:g}" for v in truths])
        axis.set_xlabel(r"true $\tau$ (ms)")
        axis.set_title(claim, pad=3)
    axes[0].set_ylabel("coverage")
    handles, labels = axes[0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside lower center", ncols=3)
    save(figure, "coverage_tau")
