"""Posterior summaries and draws, which two sections show."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from bayes_sensor import figures
from bayes_sensor.report.parts import Shown, Table, to_spread
from bayes_sensor.report.saved import Saved, read_chains


def posterior_table(saved: Saved, shared: bool) -> Table:
    """Posterior summaries of the shared, or of each experiment's own parameters."""
    assert saved.posterior is not None
    keys = ("mean", "sd", "q2.5", "q16", "q50", "q84", "q97.5")
    rows: list[list[Any]] = []
    parameters = saved.posterior["parameters"]
    for name in figures.told_apart(parameters):
        row, is_local = parameters[name], "[" in name
        if row is None or is_local == shared:
            continue
        symbol, unit, factor = figures.parameter_words(name, saved.unit)
        values = [to_spread(factor * row[key], factor * row["sd"]) for key in keys]
        if not shared:
            values = values[:2] + [values[2], values[4], values[6]]
        checks = [
            None if row[key] is None else Shown(row[key], f"{row[key]:.{places}f}")
            for key, places in (("ess_bulk", 0), ("ess_tail", 0), ("r_hat", 3))
        ]
        rows.append([symbol, unit, *values, *checks])
    percent = ["2.5 %", "16 %", "50 %", "84 %", "97.5 %"] if shared else ["2.5 %", "50 %", "97.5 %"]
    return Table(
        "posterior-shared" if shared else "posterior-experiments",
        "Posterior of the shared parameters: mean, standard deviation, percentiles, effective "
        "sample sizes and R-hat."
        if shared
        else "Posterior of each experiment's own parameters.",
        ["parameter", "unit", "mean", "sd", *percent, "ESS bulk", "ESS tail", "R-hat"],
        rows,
    )


def corner(draws: Path, unit: str) -> Any:
    """The joint posterior of saved draws, as a figure."""
    return figures.corner(*read_chains(draws), unit=unit)


def traces_and_ranks(draws: Path, unit: str) -> Any:
    """The chains of saved draws and their ranks, as a figure."""
    return figures.traces_and_ranks(*read_chains(draws), unit=unit)
