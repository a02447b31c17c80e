"""Simulation-based calibration: campaigns drawn from the prior, ranks of the truth.

Smaller campaigns than the paper's (three experiments of 40 s at 5 ms), because every one is drawn
anew; the priors are explicit and proper for every parameter, and the noise may be anything from
nearly absent to hundreds of millivolts correlated over twenty samples.  Once more for short records
of a slow logger, where the posterior has longer tails than a Gaussian, so that the independence
sampler refits its proposal or hands over.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from pathlib import Path

import numpy as np
import pandas as pd
from drawing import ACCENT, INK, SHADE, TABLES, WIDTH, label, plt, save
from posterior_calibration import Ranks, RankStudy

from bayes_sensor.campaign import Campaign, Experiment
from bayes_sensor.checks.study_chunks import run_chunks
from bayes_sensor.likelihood.priors import Prior
from bayes_sensor.likelihood.problem import Problem
from bayes_sensor.posterior import SAMPLERS, Settings

N, N_RANKS, SEED = 512, 127, 31
INTERVAL, DURATION, ON, OFF = 5e-3, 40.0, 8.0, 24.0  # s
FLOWS = ((4.0, 0.5), (8.0, 1.0), (2.5, 0.5))  # L/min


def of_each(experiments: Iterable[Experiment], late: float) -> dict[str, Prior]:
    """Priors of every record's own parameters; switches up to ``late`` s after their commands."""
    priors = {}
    for e in experiments:
        priors[f"y0_V[{e.name}]"] = Prior("normal", 0.25, 0.05)
        priors[f"beta_V[{e.name}]"] = Prior("normal", 1.9, 0.3)
        for name, at in (("t0_s", e.commanded_on), ("tf_s", e.commanded_off)):
            if at is not None:
                priors[f"{name}[{e.name}]"] = Prior("uniform", at, at + late)
    return priors


def problem() -> Problem:
    """The design and its priors."""
    t = np.arange(round(DURATION / INTERVAL)) * INTERVAL
    experiments = tuple(
        Experiment(str(k + 1), t, None, carrier * 1000 / 60, gas * 1000 / 60, INTERVAL, ON, OFF)
        for k, (carrier, gas) in enumerate(FLOWS)
    )
    priors = {
        "tau_s": Prior("half_normal", 0.2),
        "tau_v_s": Prior("log_normal", 0.8577, 0.3),
        "V_mL": Prior("log_normal", 58.23, 0.3),
        "phi": Prior("uniform", -0.5, 0.95),
        "sigma0_V": Prior("half_normal", 0.02),
        "sigma1_V": Prior("half_normal", 0.03),
    }
    priors |= of_each(experiments, late=1.0)
    return Problem(
        Campaign("calibration design", experiments, sensor_is="faster"), given_priors=priors
    )


def short_problem() -> Problem:
    """Two records of two minutes at 1 Hz of a sensor alone, and their priors."""
    t = np.arange(120.0)
    experiments = tuple(
        Experiment(name, t, None, None, None, 1.0, 20.0, 70.0 if name == "1" else None)
        for name in "12"
    )
    priors = {
        "tau_s": Prior("half_normal", 12.0),
        "phi": Prior("uniform", -0.5, 0.9),
        "sigma0_V": Prior("half_normal", 0.2),
        "sigma1_V": Prior("half_normal", 0.2),
    }
    priors |= of_each(experiments, late=6.0)
    campaign = Campaign("short records", experiments, stages=("sensor",), sensor_is="faster")
    return Problem(campaign, given_priors=priors)


def study(design: Problem | None = None) -> RankStudy:
    """The task, one call a campaign."""
    settings = Settings(n_chains=2, n_draws=1000, target_ess=300, max_draws=3000, max_steps=600)
    return RankStudy(design or problem(), settings=settings, n_ranks=N_RANKS, seed=SEED)


def run(
    folder: Path, jobs: int, scheduler: str | None, progress: Callable[[int, int], None]
) -> None:
    """Compute, then write sbc.csv, sbc_ranks.csv, sbc_samplers.csv and the figure."""
    draw(_ranked("sbc", study(), folder, jobs, scheduler, progress))


def run_short(
    folder: Path, jobs: int, scheduler: str | None, progress: Callable[[int, int], None]
) -> None:
    """The same for short records: sbc_short.csv, sbc_short_ranks.csv, sbc_short_samplers.csv."""
    _ranked("sbc_short", study(short_problem()), folder, jobs, scheduler, progress)


def _ranked(
    name: str,
    task: RankStudy,
    folder: Path,
    jobs: int,
    scheduler: str | None,
    progress: Callable[[int, int], None],
) -> Ranks:
    """The ranks of one design; its tables are written."""
    results = run_chunks(
        task, N, folder / name, task.key, jobs, chunk=8, scheduler=scheduler, progress=progress
    )
    names = tuple(task.problem.layout.names)
    good = (results["ranks"] >= 0).all(axis=1)
    ranks = Ranks(names, results["ranks"][good], N_RANKS)
    table = ranks.table()
    table["p_chi2_bonferroni"] = np.minimum(1.0, len(table) * table["p_chi2"])
    table["p_ecdf_bonferroni"] = np.minimum(1.0, len(table) * table["p_ecdf"])
    table.to_csv(TABLES / f"{name}.csv", index=False, float_format="%.4g")
    pd.DataFrame(ranks.ranks, columns=list(names)).to_csv(TABLES / f"{name}_ranks.csv", index=False)
    samplers(results).to_csv(TABLES / f"{name}_samplers.csv", index=False, float_format="%.4g")
    return ranks


def samplers(results: dict[str, np.ndarray]) -> pd.DataFrame:
    """Which sampler answered, how often, and the worst of what it said about itself."""
    rows = []
    for number in sorted(set(results["sampler"].astype(int))):
        those = results["sampler"] == number
        rows.append(
            {
                "sampler": list(SAMPLERS)[number] if number >= 0 else "failed",
                "n": int(those.sum()),
                "refitted": int(results["refitted"][those].sum()),
                "not_converged": int((results["converged"][those] == 0).sum()),
                "largest_r_hat": np.max(results["r_hat"][those]),
                "smallest_ess": np.min(results["ess"][those]),
                "median_mesh_error": np.median(results["mesh_error"][those]),
                "largest_mesh_error": np.max(results["mesh_error"][those]),
            }
        )
    return pd.DataFrame(rows)


def draw(ranks: Ranks) -> None:
    """A rank histogram and an ECDF difference with its simultaneous band for every parameter."""
    from scipy import stats

    n_bins = 16
    low_count, high_count = stats.binom.ppf([0.025, 0.975], ranks.n, 1.0 / n_bins)
    low, high = ranks.ecdf_band()
    x = np.arange(1, ranks.n_ranks + 1) / (ranks.n_ranks + 1)
    counts = ranks.histogram(n_bins)
    n_columns = 6
    n_rows = -(-len(ranks.names) // n_columns)
    figure, axes = plt.subplots(
        2 * n_rows, n_columns, figsize=(WIDTH, 0.95 * 2 * n_rows), sharex=True, layout="constrained"
    )
    for axis in axes.ravel():
        axis.set_visible(False)
    top = 1.05 * max(np.abs(ranks.ecdf_difference).max(), high.max())
    for i, name in enumerate(ranks.names):
        row, column = divmod(i, n_columns)
        upper, lower = axes[2 * row, column], axes[2 * row + 1, column]
        for axis in (upper, lower):
            axis.set_visible(True)
        upper.axhspan(low_count, high_count, color=SHADE, lw=0)
        upper.stairs(counts[i], np.linspace(0, 1, n_bins + 1), color=INK)
        upper.set_ylim(0, 1.15 * counts.max())
        upper.set_title(label(name), pad=2)
        lower.fill_between(x, low, high, color=SHADE, lw=0)
        lower.plot(x, ranks.ecdf_difference[i], color=ACCENT)
        lower.set_ylim(-top, top)
        lower.set_xticks([0, 0.5, 1], ["0", "0.5", "1"])
        if column:
            upper.set_yticklabels([])
            lower.set_yticklabels([])
        else:
            upper.set_ylabel("campaigns")
            lower.set_ylabel("ECDF diff.")
        if row == n_rows - 1:
            lower.set_xlabel("rank / maximum")
    save(figure, "sbc")
