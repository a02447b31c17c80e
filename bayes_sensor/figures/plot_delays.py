"""Delays of the switches against 1/Q (paper Fig. 7)."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from bayes_sensor.figures.colours import BLUE, INK, MARKERS, MODEL, ORANGE, PALE
from bayes_sensor.figures.labels import shortened
from bayes_sensor.figures.style import WIDTH, content_of, panels, style


def delays(record: Any, concentration: Mapping[str, float]) -> Figure:
    """Delay of start and end against 1/Q with line, prediction band and outliers (paper Fig. 7).

    ``record``: the regressions, or the content of ``delays.json``; ``concentration`` (0..1) by
    experiment.
    """
    record = content_of(record)
    sides = [k for k in ("start", "end") if record.get(k) and record[k]["points"]]
    crowded = 4 < len(_levels(concentration)) <= len(MARKERS)
    with style():
        width = WIDTH if len(sides) > 1 or crowded else 4.4
        right = 1.45 if crowded else 0.12
        figure, (row,) = panels(3.3, 1, max(len(sides), 1), width, right=right)
        for axes, side in zip(row, sides, strict=False):
            delay_panel(axes, record, concentration, side, legend=not crowded)
            if crowded and axes is row[0]:
                handles, labels = axes.get_legend_handles_labels()
                figure.legend(handles, labels, loc="upper right", borderaxespad=0.1)
    return figure


def delay_panel(
    axes: Axes, record: Any, concentration: Mapping[str, float], side: str, legend: bool = True
) -> None:
    """The delay of one ``side``, ``start`` or ``end``, on ``axes``.

    Raises KeyError for a side without points.
    """
    line = content_of(record)[side]
    if not line or not line["points"]:
        raise KeyError(f"no delays of the {side}")
    levels = _levels(concentration)
    many = len(levels) > len(MARKERS)
    with style():
        if line["band"]:
            x = np.asarray(line["band"]["inverse_flow_s_per_L"])
            lo, hi = line["band"]["lo95_s"], line["band"]["hi95_s"]
            axes.fill_between(x, lo, hi, color=PALE, lw=0, label="95 % prediction")
            axes.plot(x, line["band"]["fit_s"], color=MODEL, ls="--", label="line")
        for point in line["points"]:
            level = round(100 * concentration.get(point["experiment"], np.nan), 1)
            index = levels.index(level) if level in levels else 0
            marker = "o" if many else MARKERS[index % len(MARKERS)]
            used = point["used"]
            axes.plot(
                point["inverse_flow_s_per_L"],
                point["delay_s"],
                marker,
                ms=6,
                mfc=BLUE if used else "none",
                mec=INK if used else ORANGE,
                mew=0.6 if used else 1.8,
            )
            if not used:
                axes.annotate(
                    f"{shortened(point['experiment'])}, outlier",
                    (point["inverse_flow_s_per_L"], point["delay_s"]),
                    xytext=(7, -3),
                    textcoords="offset points",
                    fontsize=8,
                    color=ORANGE,
                )
        for marker, level in zip(MARKERS, [] if many else levels, strict=False):
            axes.plot(
                [], [], marker, ms=6, mfc=BLUE, mec=INK, mew=0.6, label=f"{level:g} % test gas"
            )
        if (line["band"] or not many) and legend:
            axes.legend(loc="best", fontsize=7)
        axes.margins(0.08)
        axes.set(xlabel="1/Q (s/L)", ylabel=f"{side} delay (s)")
        r2 = "" if line["r2"] is None else f", R² = {line['r2']:.3f}"
        axes.set_title(f"{side} of the step{r2}")


def _levels(concentration: Mapping[str, float]) -> list[float]:
    """The concentrations (%), each once."""
    return sorted({round(100 * c, 1) for c in concentration.values()})
