"""The gap between model and measurement: its budget, place, explanations and unseen effects.

Every function takes a part of ``gap.json``.
"""

from __future__ import annotations

import itertools
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.colors import BoundaryNorm, ListedColormap
from matplotlib.figure import Figure

from bayes_sensor.figures.colours import (
    BLUE,
    DATA,
    GROUND,
    INK,
    MARKERS,
    MIDDLE,
    MODEL,
    ORANGE,
    PALE,
    REGIONS,
)
from bayes_sensor.figures.labels import shortened, volts
from bayes_sensor.figures.style import SMALLEST, beside, content_of, logarithmic, panels, style

PHASES = ("baseline", "onset", "rise", "plateau", "fall", "tail")
VISIBLE = 3.0
"""detectability below which this campaign cannot show an effect"""
_SHADES = ListedColormap([GROUND, *REGIONS, BLUE])


def effect_words(name: str) -> str:
    """An effect's name as words.

    >>> effect_words("flow_switching+daq_filter")
    'flow switching + daq filter'
    """
    return name.replace("_", " ").replace("+", " + ")


def gap_where(where: Sequence[Mapping[str, Any]], unit: str = "V") -> Figure:
    """Heat map of the excess by experiment and phase, with the share of the whole.

    ``where``: rows of ``gap.json``; a frame marks cells whose p-value is below 5 %.
    """
    experiments = list(dict.fromkeys(row["experiment"] for row in where))
    phases = [p for p in PHASES if any(row["phase"] == p for row in where)]
    size = (len(experiments), len(phases))
    excess, share, p_value = np.full(size, np.nan), np.zeros(size), np.ones(size)
    for row in where:
        place = experiments.index(row["experiment"]), phases.index(row["phase"])
        value = row["excess_rms_V"]
        before = excess[place]
        # several time scales of one cell: their powers add
        excess[place] = np.sqrt(np.nansum([before**2, (value or 0.0) ** 2]))
        share[place] += row["share"] or 0.0
        if row["p_value"] is not None:
            p_value[place] = min(p_value[place], row["p_value"])
    top = float(np.nanmax(excess)) if np.isfinite(excess).any() else 0.0
    shown, factor = volts(unit, top)
    many = len(experiments) > 16
    with style():
        names = [shortened(name) for name in experiments]
        height = max(2.2, 0.7 + (0.16 if many else 0.3) * len(experiments))
        figure, ((axes,),) = panels(height, width=6.2, left=beside(names, more=0.4), top=0.1)
        levels = np.linspace(0.0, factor * top or 1.0, _SHADES.N + 1)
        image = axes.pcolormesh(
            factor * excess, cmap=_SHADES, norm=BoundaryNorm(levels, _SHADES.N),
            edgecolors=PALE, lw=0.6,
        )  # fmt: skip
        for i in range(size[0]):
            for j in range(size[1]):
                if p_value[i, j] < 0.05:
                    axes.add_patch(_frame(j, i))
                if share[i, j] >= 0.01 and not many:
                    dark = factor * excess[i, j] > levels[-2]
                    axes.annotate(
                        f"{100 * share[i, j]:.0f} %", (j + 0.5, i + 0.5), ha="center", va="center",
                        fontsize=7.5, color=GROUND if dark else INK,
                    )  # fmt: skip
        axes.set_xticks(np.arange(size[1]) + 0.5, phases)
        axes.set_yticks(np.arange(size[0]) + 0.5, names)
        if many:
            axes.tick_params(axis="y", labelsize=SMALLEST)
        axes.set(ylim=(size[0], 0), ylabel="experiment", xlabel="phase of the step")
        axes.grid(False)
        bar = figure.colorbar(image, ax=axes, pad=0.02, aspect=14, ticks=levels)
        bar.set_ticklabels([f"{level:.2g}" for level in levels])
        bar.set_label(f"excess RMS ({shown})")
        bar.outline.set_visible(False)
    return figure


def _frame(x: float, y: float) -> Any:
    from matplotlib.patches import Rectangle

    return Rectangle(
        (x + 0.04, y + 0.04), 0.92, 0.92, facecolor="none", edgecolor=MODEL, linewidth=1.6
    )


FEW = 5
"""explanations that are always drawn"""


def gap_which(gap: Any, most: int = 10) -> Figure:
    """Probabilities of the explanations, the likeliest first, and of their families.

    ``gap``: the diagnosis, or ``which`` and ``families`` of ``gap.json``.  None and unlisted are
    hatched.  Pairs count for both their families.
    """
    gap = content_of(gap)
    rows, worth = _ranked(gap)
    families = dict(gap.get("families") or {})
    for row in rows:
        if row["effect"] in ("none", "unlisted") or not gap.get("families"):
            name = row.get("family") or row["effect"]
            families[name] = families.get(name, 0.0) + row["probability"]
    ranked = sorted(families.items(), key=lambda item: -item[1])[: min(most, max(worth, FEW))]
    shown = [(row["effect"], row["probability"]) for row in rows[: min(most, max(worth, FEW))]]
    n = max(len(shown), len(ranked))
    with style():
        of_effects, of_families = (
            [shortened(effect_words(name), 32) for name, _ in each] for each in (shown, ranked)
        )
        figure, ((left, right),) = panels(
            0.8 + 0.27 * n, 1, 2, left=beside(of_effects), across=beside(of_families) + 0.1
        )
        _bars(left, shown, n, "explanation")
        _bars(right, ranked, n, "family")
    return figure


def explanation_panel(axes: Axes, gap: Any, most: int = 10) -> None:
    """Probabilities of the explanations, the likeliest first, on ``axes``."""
    rows, worth = _ranked(content_of(gap))
    shown = [(row["effect"], row["probability"]) for row in rows[: min(most, max(worth, FEW))]]
    with style():
        _bars(axes, shown, len(shown), "explanation")


def _ranked(gap: Mapping[str, Any]) -> tuple[list[Mapping[str, Any]], int]:
    """The explanations, the likeliest first, and how many are worth a bar."""
    rows = sorted(gap["which"], key=lambda row: -row["probability"])
    return rows, sum(row["probability"] >= 5e-4 for row in rows)  # others would all read "<0.1"


def _bars(axes: Any, rows: Sequence[tuple[str, float]], n: int, title: str) -> None:
    for i, (name, probability) in enumerate(rows):
        apart = name in ("none", "unlisted")
        axes.barh(
            i, 100 * probability, 0.66, color=PALE if apart else DATA, edgecolor=INK, lw=0.5,
            hatch="//" if apart else None,
        )  # fmt: skip
        text = f"{100 * probability:.1f}" if probability >= 5e-4 else "<0.1"
        axes.annotate(
            text, (100 * probability, i), xytext=(3, 0), textcoords="offset points", va="center",
            fontsize=7.5,
        )  # fmt: skip
    axes.set_yticks(range(len(rows)), [shortened(effect_words(name), 32) for name, _ in rows])
    axes.set(ylim=(n - 0.4, -0.6), xlim=(0, 114))
    axes.set_xticks(range(0, 101, 25))
    axes.set(xlabel="probability (%)", title=title)
    axes.grid(axis="y", visible=False)


def gap_residuals(residuals: Sequence[Mapping[str, Any]], most: int = 10) -> Figure:
    """Whitened residuals in event-locked bins, one strip an experiment; noise is within +-2.

    ``residuals`` of ``gap.json``; of many experiments those with the largest residuals are shown.
    """
    order = sorted(
        range(len(residuals)),
        key=lambda k: -float(np.mean(np.square(residuals[k]["whitened"]))),
    )[:most]
    rows = [residuals[k] for k in sorted(order)]
    reach = max(3.5, 1.1 * max(float(np.max(np.abs(row["whitened"]))) for row in rows))
    with style():
        names = [shortened(row["experiment"], 9) for row in rows]
        figure, grid = panels(
            max(1.9, 0.7 + 0.48 * len(rows)), len(rows), left=beside(names, 8.5) + 0.4, bottom=0.3,
            down=0.08,
        )  # fmt: skip
        strips = grid[:, 0]
        for axes, row in zip(strips, rows, strict=True):
            values, phase = np.asarray(row["whitened"]), np.asarray(row["phase"])
            place = np.arange(len(values))
            axes.axhspan(-2, 2, color=PALE, lw=0, alpha=0.6)
            axes.vlines(place, 0.0, values, color=BLUE, lw=1.1)
            axes.plot(place, values, "o", color=BLUE, ms=2.0)
            edges = [0, *(np.flatnonzero(np.diff(phase)) + 1), len(values)]
            for begin, end in itertools.pairwise(edges):
                if begin:
                    axes.axvline(begin - 0.5, color=MIDDLE, lw=0.7)
                if axes is strips[0]:
                    axes.annotate(
                        PHASES[phase[begin]], (0.5 * (begin + end - 1), 1.02), ha="center",
                        xycoords=("data", "axes fraction"), va="bottom", fontsize=8, color=INK,
                    )  # fmt: skip
            axes.set(xlim=(-0.7, len(values) - 0.3), ylim=(-reach, reach))
            axes.set_xticks([])
            axes.set_yticks([0], [""])  # a number there would read as part of the name
            axes.grid(axis="x", visible=False)
            axes.set_ylabel(shortened(row["experiment"], 9), rotation=0, ha="right", va="center")
        strips[-1].set_xlabel("bins, from the baseline to the tail (they widen after a switch)")
        figure.supylabel(f"whitened residual (sd)\nstrips of ± {reach:.2g}", fontsize=8.5)
    return figure


def lag_of(hidden: Mapping[str, Any]) -> tuple[str, str]:
    """Key and words of the lag to which a diagnosis refers, from ``hidden`` of ``gap.json``.

    Tau, that of the first of several sensors, or the shorter lag if it cannot be assigned.
    """
    of = "lag_fast" if "lag_fast_envelope_s" in hidden else "tau"
    return of, hidden["lag"].replace("tau", "τ")


def gap_hidden(hidden: Mapping[str, Any], tau: float | None = None) -> Figure:
    """What may hide: how visible each effect would be, and tau with it.

    ``hidden`` of ``gap.json``; ``tau`` in s draws a line.  Effects to the left of the line at three
    would not be seen; the envelope of tau over them is shaded.  Dotted lines are the intervals with
    the strength left free.
    """
    of, lag = lag_of(hidden)
    rows = [r for r in hidden["effects"] if r["d"] is not None and r[f"{of}_shift_s"] is not None]
    rows.sort(key=lambda row: row["d"])
    d = np.array([max(row["d"], 1e-2) for row in rows])
    place = np.arange(len(rows))
    whole = all(row.get(f"{of}_with_it_s") is not None for row in rows)
    shift = [row[f"{of}_with_it_s"] if whole else row[f"{of}_shift_s"] for row in rows]
    envelope = hidden.get(f"{of}_envelope_s") or (None, None)
    with style():
        names = [shortened(effect_words(row["effect"]), 26) for row in rows]
        figure, ((left, right),) = panels(
            0.8 + 0.22 * max(len(rows), 3), 1, 2, left=beside(names), across=0.2, sharey=True
        )
        kinds = [_kind(row) for row in rows]
        for kind, (colour, marker, face) in _KINDS.items():
            chosen = [k == kind for k in kinds]
            if not any(chosen):
                continue
            for axes, values in ((left, d), (right, 1e3 * np.array(shift))):
                axes.plot(
                    values[chosen], place[chosen], marker, color=colour, ms=5, label=kind,
                    mfc=colour if face else GROUND, zorder=3,
                )  # fmt: skip
        left.set_ylim(len(rows) - 0.4, -0.6)
        left.set_yticks(place, names)
        logarithmic(left, "x")
        left.axvline(VISIBLE, color=INK, lw=0.9, ls="--")
        left.set_xlabel("detectability d (sd)")
        if whole:
            label: str | None = "strength left free"
            for i, row in enumerate(rows):
                ends = [1e3 * row[f"{of}_low_s"], 1e3 * row[f"{of}_high_s"]]
                right.plot(ends, [i, i], color=MIDDLE, lw=1.1)
                if row.get(f"{of}_free_low_s") is not None:
                    ends = [1e3 * row[f"{of}_free_low_s"], 1e3 * row[f"{of}_free_high_s"]]
                    right.plot(ends, [i + 0.25, i + 0.25], color=INK, lw=1.0, ls=":", label=label)
                    label = None
            right.set_xlabel(f"{lag} with it (ms), 95 % intervals")
        else:
            right.hlines(place, 0.0, 1e3 * np.array(shift), color=MIDDLE, lw=0.7)
            right.set_xlabel(f"shift of {lag} (ms)")
        origin = 0.0 if whole or tau is None else tau
        low, high = envelope
        if low is not None and high is not None and (whole or tau is not None):
            right.axvspan(
                1e3 * (low - origin), 1e3 * (high - origin), color=PALE, lw=0, zorder=0,
                label=f"envelope of {lag}",
            )  # fmt: skip
        if tau is not None:
            right.axvline(1e3 * (tau - origin), color=INK, lw=0.9)
        for axes in (left, right):
            axes.grid(axis="y", visible=False)
        handles, labels = right.get_legend_handles_labels()
        figure.legend(handles, labels, loc="upper right", ncols=4, borderaxespad=0.1)
    return figure


_KINDS = {
    "could hide": (ORANGE, MARKERS[2], True),
    "would be seen": (BLUE, MARKERS[0], True),
    "contradicted by the data": (INK, MARKERS[1], False),
}
"""colour, marker, filled"""


def _kind(row: Mapping[str, Any]) -> str:
    if row.get("contradicted"):
        return "contradicted by the data"
    return "could hide" if row["d"] < VISIBLE else "would be seen"
