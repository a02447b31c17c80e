"""The coating behind tau: its response, and what honest intervals leave of the paper's gap.

The paper measures tau = 48.1 ms, its finite element model gives 12.9 ms at the literature
diffusivity of ZIF-8, and with +-5.6 ms the two cannot both be right.  Here the inverse, the
posterior of that diffusivity, for the published bound, for the converged one, for bounds under
coloured noise, and for posteriors of simulated campaigns at the published parameters.
"""

from __future__ import annotations

import json
import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from drawing import ACCENT, FIGURES, INK, TABLES, WIDTH, plt, save
from matplotlib.figure import Figure
from scipy.stats import norm
from study_coverage import REFERENCE, design

from bayes_sensor import figures
from bayes_sensor.bounds import cramer_rao
from bayes_sensor.checks.study_chunks import run_chunks
from bayes_sensor.coating import (
    Coating,
    DiffusivityPosterior,
    infer_d_zif8,
    modal,
    solve,
)
from bayes_sensor.coating.readout import matched_readout
from bayes_sensor.figures import diffusion_figure, spectra_figure
from bayes_sensor.figures.labels import plain
from bayes_sensor.figures.style import logarithmic
from bayes_sensor.io.readers import read_campaign
from bayes_sensor.likelihood.density import simulate
from bayes_sensor.likelihood.problem import Problem
from bayes_sensor.posterior import Settings, sample_posterior
from bayes_sensor.rig.response_times import response_time_table

N, SEED = 24, 61
PHIS = (0.0, 0.5, 0.9)
LOWERED = 2.6e-11
"""m2/s, the diffusivity that the paper lowers ZIF-8's to"""
TAIL_FLOOR = 1e-6
"""smaller tail probabilities would be the assumed shape of the tails; read them as at most"""
SETTINGS = Settings(n_chains=4, n_draws=2000, target_ess=1000)


@dataclass(frozen=True)
class Inverse:
    """One simulated campaign at one phi: its posterior of tau and of the diffusivity."""

    problem: Problem
    truth: Mapping[str, Any]
    phi: float

    @property
    def key(self) -> str:
        """Everything that the numbers depend on, short of the code."""
        return json.dumps([dict(self.truth), self.phi, SEED, str(SETTINGS), 1])

    def __call__(self, i: int) -> dict[str, float]:
        """Numbers of one seed; the same streams at every phi, so that columns compare."""
        data, sampling = np.random.SeedSequence([SEED, i]).generate_state(2)
        theta = self.problem.layout.flat({**self.truth, "phi": self.phi})
        campaign = simulate(self.problem, theta, seed=int(data))
        posterior = sample_posterior(
            replace(self.problem, campaign=campaign), theta, int(sampling), "independence", SETTINGS
        )
        tau = posterior.of("tau_s")
        return {"converged": float(posterior.converged), **numbers(infer_d_zif8(tau, seed=i))}


NUMBERS = (
    "tau_ms", "tau_lo95_ms", "tau_hi95_ms", "d_zif8_m2_per_s", "d_lo95_m2_per_s",
    "d_hi95_m2_per_s", "ratio", "ratio_lo95", "ratio_hi95", "tail_probability",
    "literature_inside",
)  # fmt: skip
"""what :func:`numbers` gives"""


def numbers(found: DiffusivityPosterior) -> dict[str, float]:
    """What the tables keep of an inverse."""
    low, high = found.interval()
    ratio_low, ratio_high = found.ratio_interval()
    tau_low, tau, tau_high = 1e3 * np.quantile(found.tau, [0.025, 0.5, 0.975])
    return {
        "tau_ms": tau,
        "tau_lo95_ms": tau_low,
        "tau_hi95_ms": tau_high,
        "d_zif8_m2_per_s": found.median,
        "d_lo95_m2_per_s": low,
        "d_hi95_m2_per_s": high,
        "ratio": found.ratio,
        "ratio_lo95": ratio_low,
        "ratio_hi95": ratio_high,
        "tail_probability": max(found.tail_probability, found.tail_resolution, TAIL_FLOOR),
        "literature_inside": float(low <= found.d_literature <= high),
    }


OUTER_RADII = (14e-6, 15e-6, 16e-6, 17e-6, 17.4e-6, 18e-6, 20e-6, math.inf)
"""m; the extent of the coating is not published"""


def run(
    folder: Path, jobs: int, scheduler: str | None, progress: Callable[[int, int], None]
) -> None:
    """Compute, then write the tables coating*.csv and the figures coating_*."""
    literature, lowered = solve(), solve(Coating(d_zif8=LOWERED))
    responses([literature, lowered]).to_csv(
        TABLES / "coating.csv", index=False, float_format="%.5g"
    )
    store(diffusion_figure(literature, lowered), "coating_diffusion")
    store(spectra_figure(matched_readout()), "coating_spectra")

    problem = Problem(design())
    truth = json.loads((REFERENCE / "truth.json").read_text())
    rows = bounds(problem, truth)
    for phi in PHIS:
        task = Inverse(problem, truth, phi)
        place = folder / f"coating-{phi:g}"
        results = run_chunks(
            task, N, place, task.key, jobs, chunk=4, scheduler=scheduler, progress=progress
        )
        for i in range(N):
            each = {name: float(values[i]) for name, values in results.items()}
            rows.append({"evidence": "posterior", "phi": phi, "seed": i, **each})
    table = pd.DataFrame(rows)
    table.to_csv(TABLES / "coating_inverse.csv", index=False, float_format="%.4g")
    summary(table).to_csv(TABLES / "coating_inverse_summary.csv", index=False, float_format="%.4g")
    draw(table)

    posterior = sample_posterior(read_campaign(REFERENCE / "campaign.toml"), sampler="independence")
    response_time_table(
        *(posterior.of(name) for name in ("tau_s", "tau_v_s", "V_mL")),
        [e.total_flow for e in problem.campaign],
    ).to_csv(TABLES / "coating_response_times.csv", index=False, float_format="%.4g")


def responses(solved: list[Any]) -> pd.DataFrame:
    """Response times by finite elements, and by modes at other radii, both diffusivities."""
    rows = []
    for each in solved:
        rows.append(
            {
                "route": "finite elements",
                "outer_radius_um": 1e6 * each.coating.outer_radius,
                "d_zif8_m2_per_s": each.coating.d_zif8,
                "t10_ms": 1e3 * each.t10,
                "tau63_ms": 1e3 * each.tau63,
                "t90_ms": 1e3 * each.t90,
                "tau_fit_ms": 1e3 * each.tau_fit,
                "tau_moment_ms": 1e3 * each.tau_moment,
                "lag_max_error": each.lag_max_error,
                "n_dof": each.n_dof,
            }
        )
    for outer_radius in OUTER_RADII:
        for each in solved:
            coating = replace(each.coating, outer_radius=outer_radius)
            response = modal(coating)
            rows.append(
                {
                    "route": "modes",
                    "outer_radius_um": 1e6 * outer_radius,
                    "d_zif8_m2_per_s": coating.d_zif8,
                    "t10_ms": 1e3 * response.time_to(0.1),
                    "tau63_ms": 1e3 * response.tau63,
                    "t90_ms": 1e3 * response.time_to(0.9),
                    "tau_fit_ms": 1e3 * response.tau_fit,
                    "tau_moment_ms": 1e3 * response.tau_moment,
                }
            )
    return pd.DataFrame(rows).astype({"n_dof": "Int64"})


def bounds(problem: Problem, truth: Mapping[str, Any]) -> list[dict[str, Any]]:
    """The inverse of normal laws around 48.1 ms, cut at 0, as wide as each bound says."""
    tau = truth["tau_s"]
    constant = {"sigma0_V": 0.0653, "sigma1_V": 0.0}
    cases: list[tuple[str, float | None, float]] = [("published", None, 0.0056 / 3)]
    cases.append(("1 % step, white", None, cramer_rao(problem, truth, step=0.01)["tau_s"]))
    cases.append(("converged, white", None, cramer_rao(problem, truth)["tau_s"]))
    for label, law in (("converged, AR(1), constant", constant), ("converged, AR(1)", {})):
        for phi in PHIS:
            theta = {**truth, **law, "phi": phi}
            cases.append((label, phi, cramer_rao(problem, theta, noise="ar1")["tau_s"]))
    rows = []
    for label, phi, sd in cases:
        found = infer_d_zif8(norm(tau, sd), seed=SEED, n_draws=100_000)
        row = {"evidence": label, "phi": phi, "three_sigma_ms": 3e3 * sd, **numbers(found)}
        no_side = infer_d_zif8(norm(tau, sd), Coating(outer_radius=math.inf), seed=SEED)
        rows.append({**row, "tail_probability_no_side": max(no_side.tail_probability, TAIL_FLOOR)})
    return rows


def summary(table: pd.DataFrame) -> pd.DataFrame:
    """Medians over the seeds of each phi, and the share that leaves the literature value inside."""
    rows = []
    for phi, some in table[table["evidence"] == "posterior"].groupby("phi"):
        names = [name for name in NUMBERS if name != "literature_inside"]
        low, high = some["tail_probability"].min(), some["tail_probability"].max()
        rows.append(
            {
                "phi": phi,
                "n": len(some),
                "converged": int(some["converged"].sum()),
                # of draws, not of averages: an unbounded diffusivity stays unbounded
                **{name: float(np.quantile(some[name], 0.5, method="lower")) for name in names},
                "tail_probability_min": low,
                "tail_probability_max": high,
                "share_literature_inside": some["literature_inside"].mean(),
            }
        )
    return pd.DataFrame(rows)


def store(figure: Figure, name: str) -> None:
    """Write a figure of the package as PNG and SVG."""
    FIGURES.mkdir(parents=True, exist_ok=True)
    (FIGURES / f"{name}.png").write_bytes(figures.png(figure, dpi=200))
    (FIGURES / f"{name}.svg").write_text(figures.svg(figure), encoding="utf-8")


def draw(table: pd.DataFrame) -> None:
    """95 % intervals of the diffusivity: the bounds above, every simulated campaign below."""
    words = {
        "published": r"published, $\pm$5.6 ms",
        "converged, white": r"converged, white, $\pm$%.1f ms",
        "converged, AR(1)": r"AR(1) bound, $\varphi=$%g, $\pm$%.1f ms",
    }
    figure, axis = plt.subplots(figsize=(WIDTH, 4.6), layout="constrained")
    y, ticks, names = 0.0, [], []
    right = 1e-8
    for evidence, text in words.items():
        for _, row in table[table["evidence"] == evidence].iterrows():
            values = {"published": (), "converged, white": (row["three_sigma_ms"],)}.get(
                evidence, (row["phi"], row["three_sigma_ms"])
            )
            interval(axis, row, y, INK, "s", right)
            ticks.append(y)
            names.append(text % values if values else text)
            y += 1.6
    for phi, some in table[table["evidence"] == "posterior"].groupby("phi"):
        y += 1.0
        inside = int(some["literature_inside"].sum())
        ticks.append(y + 0.25 * (len(some) - 1))
        names.append(
            rf"posteriors, $\varphi={phi:g}$"
            + f"\n(literature value inside\nin {inside} of {len(some)})"
        )
        for _, row in some.sort_values("d_hi95_m2_per_s").iterrows():
            interval(axis, row, y, ACCENT, "o", right)
            y += 0.5
    for value, dash, text in (
        (Coating().d_zif8, "--", "literature"),
        (LOWERED, ":", "lowered by the paper"),
    ):
        axis.axvline(value, color=INK, lw=0.8, ls=dash, label=f"{text}, {plain(value)} m²/s")
    axis.set(xlim=(3e-12, right), xlabel="diffusivity of ZIF-8 (m²/s), 95 % interval")
    logarithmic(axis, "x")
    axis.set_yticks(ticks, names)
    axis.tick_params(axis="y", length=0)
    axis.invert_yaxis()
    axis.legend(loc="upper right")
    save(figure, "coating_inverse")


def interval(
    axis: plt.Axes, row: pd.Series, y: float, colour: str, marker: str, right: float
) -> None:
    """One interval; an arrow where it has no upper end in the picture."""
    low, high = row["d_lo95_m2_per_s"], row["d_hi95_m2_per_s"]
    axis.plot([low, min(high, right)], [y, y], color=colour, lw=0.9)
    if high > right:
        axis.plot(0.96 * right, y, ">", color=colour, clip_on=False)
    face = colour if row["literature_inside"] else "white"
    axis.plot(row["d_zif8_m2_per_s"], y, marker, color=colour, markerfacecolor=face)
