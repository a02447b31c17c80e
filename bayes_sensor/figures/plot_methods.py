"""Bound methods side by side, and the published bound against its step."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator

from bayes_sensor.figures.colours import BLUE, GREEN, GROUND, INK, MIDDLE, ORANGE
from bayes_sensor.figures.labels import labels_of_bounds, shared_labels
from bayes_sensor.figures.method_words import MethodWords, method_words
from bayes_sensor.figures.style import beside, content_of, logarithmic, panels, style


def intervals(bounds: Any, truth: Mapping[str, float] | None = None) -> Figure:
    """Every bound method side by side for tau, tau_v, V: 68 % thick, 95 % thin.

    A lag that cannot be assigned is placed by size.  ``bounds``: the record, or the content of
    ``bounds.json``; ``truth`` by flat name draws a line.
    """
    bounds = content_of(bounds)
    n, shown_labels = len(bounds["methods"]), labels_of_bounds(bounds)
    with style():
        labels = [method_words(bounds, method).label for method in bounds["methods"]]
        figure, (row,) = panels(
            0.32 * n + 0.65, 1, len(shown_labels), left=beside(labels), top=0.1, across=0.2,
            sharey=True,
        )  # fmt: skip
        for axes, name in zip(row, shown_labels, strict=True):
            one_interval(bounds, name, axes, truth)
        if row[0].get_xlim()[0] < 0:
            row[0].axvline(0.0, color=MIDDLE, lw=0.8)  # tau cannot be negative
    return figure


def one_interval(
    bounds: Any,
    name: str,
    axes: Axes | None = None,
    truth: Mapping[str, float] | None = None,
) -> Figure | Axes:
    """Every bound method of the parameter ``name`` (flat), on ``axes`` or as a figure of its own.

    Raises KeyError for a parameter that has none.
    """
    bounds = content_of(bounds)
    methods = list(bounds["methods"])
    symbol, unit, factor = labels_of_bounds(bounds)[name]
    rows = [bounds["methods"][m]["parameters"].get(name) or {} for m in methods]
    low, high = _visible(rows, factor)
    words = {method: method_words(bounds, method) for method in methods}
    with style():
        figure = None
        if axes is None:
            left = beside(method.label for method in words.values())
            figure, ((axes,),) = panels(0.32 * len(words) + 0.65, width=4.6, left=left, top=0.1)
        for i, method in enumerate(methods):
            entry = bounds["methods"][method]["parameters"].get(name)
            if not entry:
                axes.annotate(
                    "no value", (0.5, i), xycoords=("axes fraction", "data"), ha="center",
                    va="center", fontsize=7, color=MIDDLE,
                )  # fmt: skip
                continue
            colour = _method_colour(words[method])
            marker = "D" if words[method].needs_posterior else "o"
            for lo, hi, width in (("lo95", "hi95", 1.4), ("lo68", "hi68", 4.2)):
                a, b = (
                    end if entry[key] is None else factor * entry[key]
                    for key, end in ((lo, -np.inf), (hi, np.inf))
                )  # fmt: skip
                shown = [float(np.clip(v, low, high)) for v in (a, b)]
                axes.plot(shown, [i, i], color=colour, lw=width, solid_capstyle="butt")
                for end, edge, arrow in ((a < low, low, "<"), (b > high, high, ">")):
                    if end:  # goes on outside the picture
                        axes.plot(edge, i, arrow, color=colour, ms=5, clip_on=False)
            if entry["estimate"] is not None and low <= factor * entry["estimate"] <= high:
                axes.plot(
                    factor * entry["estimate"], i, marker, color=GROUND, mec=colour, ms=4.5,
                    mew=1.2,
                )  # fmt: skip
        if truth and name in truth:
            axes.axvline(factor * truth[name], color=GREEN, ls="--", lw=1)
        axes.set(xlim=(low, high), xlabel=f"{symbol} ({unit})")
        axes.grid(axis="y", visible=False)
        axes.xaxis.set_major_locator(MaxNLocator(4))
        axes.set_yticks(range(len(methods)), [words[m].label for m in methods])
        axes.set_ylim(len(methods) - 0.4, -0.6)
    return figure or axes


def _visible(rows: Sequence[Mapping[str, Any]], factor: float) -> tuple[float, float]:
    """The range shown: all 95 % intervals, without those so wide that the others would vanish."""
    ends = [
        (factor * row["lo95"], factor * row["hi95"])
        for row in rows
        if row and row["lo95"] is not None and row["hi95"] is not None
    ]
    if not ends:
        return 0.0, 1.0
    widths = sorted(b - a for a, b in ends)
    most = 4.0 * max(widths[len(widths) // 2], 1e-12)
    kept = [pair for pair in ends if pair[1] - pair[0] <= most] or ends
    low, high = min(a for a, _ in kept), max(b for _, b in kept)
    margin = 0.05 * (high - low) or 1.0
    return low - margin, high + margin


def _method_colour(method: MethodWords) -> str:
    if method.noise == "white":
        return ORANGE
    return BLUE if method.needs_posterior else INK


def step_study(
    rows: Sequence[Mapping[str, Any]], published: Mapping[str, float] | None = None
) -> Figure:
    """Bound of tau, tau_v, V against the relative step of the finite difference (log-log).

    ``rows``: the table of :func:`bayes_sensor.bounds.step_study` as records; ``published``: three
    standard deviations by flat name, drawn as squares at 1 %.
    """
    lines = (
        ("euler", "forward", "Euler, forward", ORANGE, "-", "o"),
        ("euler", "central", "Euler, central", ORANGE, "--", "s"),
        ("exact", "forward", "exact, forward", BLUE, "-", "^"),
        ("exact", "central", "exact, central", INK, "--", "v"),
    )
    with style():
        shown = shared_labels(rows[0])
        figure, (row,) = panels(3.0, 1, len(shown), top=0.1, bottom=0.75)
        for axes, (name, (symbol, unit, factor)) in zip(row, shown.items(), strict=True):
            for method, difference, label, colour, dash, marker in lines:
                chosen = [
                    r for r in rows
                    if r["method"] == method and r["difference"] == difference
                    and r[name] is not None and 0.0 < r[name] < np.inf
                ]  # fmt: skip
                x = np.array([r["step"] for r in chosen])
                y = np.array([3 * factor * r[name] for r in chosen])
                known = np.array([bool(r.get("identified", True)) for r in chosen], dtype=bool)
                axes.plot(x, y, color=colour, ls=dash, lw=1.1)
                axes.plot([], [], color=colour, ls=dash, marker=marker, lw=1.1, ms=3.5, label=label)
                axes.plot(x[known], y[known], marker, color=colour, ms=3.5)
                axes.plot(x[~known], y[~known], marker, mfc="none", mec=colour, ms=3.5)
            if published and name in published:
                axes.plot(
                    0.01, factor * published[name], "*", color=GREEN, ms=11, mec=INK, mew=0.6,
                    label="published", ls="none",
                )  # fmt: skip
            logarithmic(axes, "x")
            logarithmic(axes, "y")
            axes.set(xlabel="relative step", ylabel=f"3 sd of {symbol} ({unit})")
        handles, names = row[0].get_legend_handles_labels()
        figure.legend(handles, names, loc="lower center", ncols=5, borderaxespad=0.1)
    return figure
