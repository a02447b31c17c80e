"""Posterior predictive checks of the bundled campaign: the right noise law and two wrong ones."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pandas as pd
from drawing import ACCENT, INK, PAPER, SHADE, TABLES, WIDTH, plt, save

from bayes_sensor.checks.predictive import PredictiveCheck, check_predictive
from bayes_sensor.figures.style import logarithmic
from bayes_sensor.io.readers import read_campaign
from bayes_sensor.likelihood.noise import Noise
from bayes_sensor.likelihood.problem import Problem
from bayes_sensor.posterior import sample_posterior

LAWS = {
    "AR(1), variance grows": Noise("concentration", "ar1"),
    "white, variance grows": Noise("concentration", "white"),
    "AR(1), constant variance": Noise("constant", "ar1"),
}
"""the first is the law that the bundled campaign was simulated with"""


def run(
    folder: Path, jobs: int, scheduler: str | None, progress: Callable[[int, int], None]
) -> None:
    """Compute, then write predictive.csv and the figure."""
    campaign = read_campaign(PAPER.parent / "data" / "reference" / "campaign.toml")
    checks = {}
    for i, (law, noise) in enumerate(LAWS.items()):
        progress(i, len(LAWS))
        posterior = sample_posterior(Problem(campaign, noise=noise), sampler="independence")
        checks[law] = check_predictive(posterior)
    rows = [
        {"noise": law, "check": check, "p_value": p, "failed": int(check in record.failed)}
        for law, record in checks.items()
        for check, p in record.p_values.items()
    ]
    pd.DataFrame(rows).to_csv(TABLES / "predictive.csv", index=False, float_format="%.3g")
    draw(checks)


def p_text(p: float) -> str:
    """A p-value as a title shows it."""
    return "p < 0.001" if p < 1e-3 else f"p = {p:.2g}"


def draw(checks: dict[str, PredictiveCheck]) -> None:
    """Observed statistics on the band of replicates, one row a noise law."""
    figure, axes = plt.subplots(len(checks), 4, figsize=(WIDTH, 4.8), layout="constrained")
    for row, (law, check) in zip(axes, checks.items()):
        records = (check.autocorrelation, check.variance, check.spectrum)
        for axis, record, unit in zip(row, records, (1.0, 1e-3, 1.0)):
            low, high = record.low / unit, record.high / unit
            axis.fill_between(record.x, low, high, color=SHADE, lw=0)
            axis.plot(record.x, record.middle / unit, color="0.5", lw=0.7)
            axis.plot(record.x, record.observed / unit, "o", color=ACCENT)
            axis.set_title(p_text(record.p_value), pad=2)
        logarithmic(row[0], "x")
        row[0].set_ylabel(f"{law}\n\nautocorrelation")
        row[1].set_ylabel("variance ($10^{-3}$ V$^2$)")
        logarithmic(row[2], "x")
        logarithmic(row[2], "y")
        row[2].set_ylabel("spectrum (1/sample)")
        pit = check.pit
        edges = np.linspace(0, 1, len(pit.counts) + 1)
        expected = pit.n / len(pit.counts)
        spread = 1.96 / np.sqrt(expected)
        row[3].axhspan(1 - spread, 1 + spread, color=SHADE, lw=0)
        row[3].stairs(pit.counts / expected, edges, color=INK)
        row[3].set_ylim(0.65, 1.25)
        row[3].set_ylabel("density of PIT")
        row[3].set_title(p_text(pit.p_uniform), pad=2)
        row[3].text(
            0.5, 0.06, f"lag 1: {p_text(pit.p_independent)}", fontsize=7.5, ha="center",
            transform=row[3].transAxes,
        )  # fmt: skip
    for axis, text in zip(
        axes[-1], ("lag (samples)", "concentration", "frequency (Hz)", "one-step-ahead PIT")
    ):
        axis.set_xlabel(text)
    save(figure, "predictive")
