"""Posterior summaries and draws, which two sections show."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any

from bayes_sensor import figures
from bayes_sensor.report.parts import Shown, Table, to_spread
from bayes_sensor.report.saved import Saved

if TYPE_CHECKING:
    from matplotlib.figure import Figure


def posterior_table(saved: Saved, shared: bool) -> Table:
    """Posterior summaries of the shared, or of each experiment's own parameters."""
    assert saved.posterior is not None
    percent = ("2.5", "16", "50", "84", "97.5") if shared else ("2.5", "50", "97.5")
    keys = ("mean", "sd", *(f"q{value}" for value in percent))
    rows: list[list[Any]] = []
    parameters = saved.posterior["parameters"]
    for name in figures.told_apart(parameters):
        row, is_local = parameters[name], "[" in name
        if row is None or is_local == shared:
            continue
        symbol, unit, factor = figures.parameter_words(name, saved.unit)
        values = [to_spread(factor * row[key], factor * row["sd"]) for key in keys]
        checks = [
            None if row[key] is None else Shown(row[key], f"{row[key]:.{places}f}")
            for key, places in (("ess_bulk", 0), ("ess_tail", 0), ("r_hat", 3))
        ]
        rows.append([symbol, unit, *values, *checks])
    heads = [f"{value} %" for value in percent]
    return Table(
        "posterior-shared" if shared else "posterior-experiments",
        "Posterior of the shared parameters: mean, standard deviation, percentiles, effective "
        "sample sizes and R-hat."
        if shared
        else "Posterior of each experiment's own parameters.",
        ["parameter", "unit", "mean", "sd", *heads, "ESS bulk", "ESS tail", "R-hat"],
        rows,
    )


def of_draws(make: Callable[..., Figure], draws: Path, unit: str) -> Figure:
    """The figure that ``make`` draws from saved draws of the posterior."""
    from bayes_sensor.posterior import load_chains  # slow to import

    return make(*load_chains(draws), unit=unit)
