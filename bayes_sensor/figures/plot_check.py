"""Every record of a campaign with what was understood of it, before anything is fitted."""

from __future__ import annotations

import numpy as np
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator

from bayes_sensor.campaign import BoolArray, Campaign, Experiment, FloatArray
from bayes_sensor.experiment import runs_of
from bayes_sensor.figures.colours import BLUE, DATA, GREEN, INK, ORANGE, PALE
from bayes_sensor.figures.labels import shortened
from bayes_sensor.figures.style import WIDTH, new_figure, style
from bayes_sensor.io.check import quiet_spans
from bayes_sensor.io.step_remarks import commands_of
from bayes_sensor.io.steps import find_steps

BINS = 900
"""stretches of a record's envelope"""
ROW = 1.75
"""inches of one row of panels"""
MOST_SPANS = 40
"""stretches left out that are marked, the longest: single samples would hide the record"""
MOST = 60
"""experiments that are drawn; more would be a page without end"""


def understood(campaign: Campaign) -> Figure:
    """A panel an experiment: samples, those left out, commands, steps seen and quiet stretches.

    The first :data:`MOST` experiments are drawn.  A design has its commands alone.
    """
    shown = list(campaign)[:MOST]
    n_columns = 1 if len(shown) <= 3 else 2
    n_rows = -(-len(shown) // n_columns)
    with style():
        figure = new_figure(ROW * n_rows + 0.7, WIDTH * (1.0 if n_columns == 1 else 1.5))
        panels = figure.subplots(n_rows, n_columns, squeeze=False)
        for axes, experiment in zip(panels.flat, shown):
            _panel(axes, experiment)
        for axes in panels.flat[len(shown) :]:
            axes.set_axis_off()
        for axes in panels[:, 0]:
            axes.set_ylabel(f"signal ({campaign.signal_unit})")
        for axes in panels.flat[max(len(shown) - n_columns, 0) : len(shown)]:
            axes.set_xlabel("time (s)")
        labels: dict[str, Artist] = {}
        for axes in panels.flat:
            for handle, label in zip(*axes.get_legend_handles_labels()):
                labels.setdefault(label, handle)
        figure.legend(list(labels.values()), list(labels), loc="outside upper left", ncols=4)
    return figure


def _panel(axes: Axes, e: Experiment) -> None:
    flow = "flow not known"
    if e.flow_known:
        flow = f"{60 * e.total_flow / 1e3:.4g} L/min, {100 * e.concentration:.3g} %"
    axes.set_title(f"{shortened(e.name, 30)}   {flow}", fontsize=8)
    if e.y is not None:
        _samples(axes, e.t, e.values, e.used)
        for number, (start, end, level) in enumerate(quiet_spans(e)):
            axes.axvspan(
                start, end, color=GREEN, alpha=0.13, lw=0, label=None if number else "quiet stretch"
            )
            axes.plot([start, end], [level, level], color=GREEN, lw=1.3,
                      label=None if number else "its level")  # fmt: skip
        _steps(axes, e)
        _drive(axes, e)
    for number, (first, last) in enumerate(_spans_left_out(e)):
        axes.axvspan(first, last, color=PALE, alpha=0.7, lw=0, zorder=0.5,
                     label=None if number else "left out")  # fmt: skip
    for time, up in _commands(e):
        label = "commanded on" if up else "commanded off"
        axes.axvline(time, color=ORANGE, lw=1.1, ls="-" if up else "--", label=label)
    axes.set_xlim(e.t[0], e.t[-1])
    axes.xaxis.set_major_locator(MaxNLocator(7))
    axes.yaxis.set_major_locator(MaxNLocator(4))


def _commands(e: Experiment) -> list[tuple[float, bool]]:
    """Time (s) of every command, and whether it lets in more test gas."""
    times = [time for _, time in commands_of(e)]
    if e.commands is not None and times:
        return list(zip(times, (e.commands.heights > 0).tolist(), strict=True))
    return [(time, time == e.commanded_on) for time in times]


def _samples(axes: Axes, t: FloatArray, y: FloatArray, used: BoolArray) -> None:
    """The used samples: as points where there are few, else the range of each stretch."""
    if len(t) <= BINS:
        shown = np.where(used, y, np.nan)  # the line breaks where samples are left out
        axes.plot(t, shown, ".-", color=DATA, ms=2.5, lw=0.6, label="samples in use")
        return
    parts = np.array_split(np.arange(len(t)), BINS)
    some = [used[part].any() for part in parts]
    bounds = [
        (y[part][used[part]].min(), y[part][used[part]].max()) if any_used else (np.nan, np.nan)
        for part, any_used in zip(parts, some, strict=True)
    ]
    middle = np.array([t[part].mean() for part in parts])
    low, high = np.array(bounds).T
    axes.fill_between(middle, low, high, color=DATA, lw=0.8, label="samples in use")


def _steps(axes: Axes, e: Experiment) -> None:
    steps = find_steps(e.t[e.used], e.values[e.used])
    if steps:
        times = [step.half for step in steps]
        heights = np.interp(times, e.t[e.used], _smooth(e.values[e.used]))
        axes.plot(times, heights, ls="", marker="v", ms=5, color=INK, label="step seen (half way)")


def _smooth(y: FloatArray) -> FloatArray:
    n = max(len(y) // 1000, 1)
    total = np.concatenate(([0.0], np.cumsum(y - y[0])))
    i = np.arange(len(y))
    a, b = np.maximum(i - n, 0), np.minimum(i + n + 1, len(y))
    return np.asarray((total[b] - total[a]) / (b - a) + y[0])


def _drive(axes: Axes, e: Experiment) -> None:
    """The drive in the lowest tenth of the panel, as its unit is another."""
    if e.drive is None or not np.isfinite(e.drive).any():
        return
    low, high = float(np.nanmin(e.drive)), float(np.nanmax(e.drive))
    y = e.values[e.used]
    bottom, span = float(y.min()), float(np.ptp(y)) or 1.0
    every = max(len(e.t) // 4000, 1)
    scaled = bottom - 0.2 * span + 0.13 * span * (e.drive[::every] - low) / ((high - low) or 1.0)
    axes.plot(e.t[::every], scaled, color=BLUE, lw=0.8, label="drive (not to scale)")


def _spans_left_out(e: Experiment) -> list[tuple[float, float]]:
    """Start and end (s) of stretches that are not used, near ones joined."""
    least = (float(e.t[-1]) - float(e.t[0])) / 500  # thinner ones could not be seen
    spans: list[tuple[float, float]] = []
    for start, end in runs_of(~e.used):
        first, last = float(e.t[start]), float(e.t[min(end, len(e.t) - 1)])
        last = max(last, first + least)
        if spans and first - spans[-1][1] < least:
            spans[-1] = (spans[-1][0], last)
        else:
            spans.append((first, last))
    return sorted(spans, key=lambda span: span[0] - span[1])[:MOST_SPANS]
