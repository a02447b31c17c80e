"""The gap between model and measurement: its budget, where it lies, what explains it, what hides.

Every function takes a part of ``gap.json``.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from matplotlib.colors import BoundaryNorm, ListedColormap
from matplotlib.figure import Figure

from bayes_sensor.figures.style import (
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
    logarithmic,
    new_figure,
    style,
    volts,
)

PHASES = ("baseline", "onset", "rise", "plateau", "fall", "tail")
VISIBLE = 3.0
"""detectability below which an effect leaves no trace that this campaign could show"""
_SHADES = ListedColormap([GROUND, *REGIONS, BLUE])


def effect_words(name: str) -> str:
    """An effect's name as words.

    >>> effect_words("flow_switching+daq_filter")
    'flow switching + daq filter'
    """
    return name.replace("_", " ").replace("+", " + ")


def _short(text: str, most: int = 26) -> str:
    return text if len(text) <= most else text[: most - 1] + "…"


def gap_budget(gap: Mapping[str, Any], unit: str = "V") -> Figure:
    """Waterfall from the nominal simulation to the noise floor: RMS, and what exceeds the floor.

    ``gap``: ``budget`` and ``shrink`` of ``gap.json``.
    """
    budget, shrink = gap["budget"], gap["shrink"]
    floor = budget["noise_floor_rms_V"]
    nominal = budget.get("nominal_rms_V")
    stages: list[tuple[str, float, float]] = []
    if nominal is not None:
        stages.append(("nominal", nominal, float(np.sqrt(max(nominal**2 - floor**2, 0.0)))))
    stages.append(("calibrated", budget["calibrated_rms_V"], budget["excess_rms_V"]))
    after = shrink.get("after_excess_rms_V")
    if after is not None and not shrink.get("withheld"):
        stages.append(("with the effect", float(np.hypot(floor, after)), after))
    stages.append(("noise floor", floor, 0.0))
    with style():
        figure = new_figure(3.0)
        left, right = figure.subplots(1, 2)
        for axes, column, title in ((left, 1, "RMS residual"), (right, 2, "above the noise floor")):
            heights = [float(stage[column]) for stage in stages]
            shown, factor = volts(unit, max(heights))
            for i, (stage, height) in enumerate(zip(stages, heights, strict=True)):
                is_floor = stage[0] == "noise floor"
                axes.bar(
                    i, factor * height, 0.62, color=PALE if is_floor else DATA, edgecolor=INK,
                    lw=0.6, hatch="//" if is_floor else None,
                )  # fmt: skip
                axes.annotate(
                    f"{factor * height:.3g}", (i, factor * height), xytext=(0, 2),
                    textcoords="offset points", ha="center", fontsize=8,
                )  # fmt: skip
                if i + 1 < len(stages):  # the step down to the next bar
                    axes.plot(
                        [i + 0.31, i + 0.69], [factor * height] * 2, color=MIDDLE, lw=0.8, ls=":"
                    )
            axes.set_xticks(range(len(stages)), [s[0].replace(" ", "\n", 1) for s in stages])
            axes.set_ylim(0.0, 1.15 * factor * max(max(heights), 1e-12))
            axes.set_ylabel(f"RMS ({shown})")
            axes.set_title(title)
            axes.grid(axis="x", visible=False)
    return figure


def gap_map(where: Sequence[Mapping[str, Any]], unit: str = "V") -> Figure:
    """Heat map experiment x phase of the excess, with the share of the whole where it is found.

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
        figure = new_figure(max(2.2, 0.9 + (0.16 if many else 0.3) * len(experiments)), 6.2)
        axes = figure.subplots()
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
        axes.set_yticks(np.arange(size[0]) + 0.5, [_short(e, 18) for e in experiments])
        if many:
            axes.tick_params(axis="y", labelsize=6)
        axes.set_ylim(size[0], 0)
        axes.set_ylabel("experiment")
        axes.set_xlabel("phase of the step")
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


def gap_ranking(which: Sequence[Mapping[str, Any]], most: int = 10) -> Figure:
    """Probabilities of the explanations, the likeliest first, and of their families.

    ``which``: rows of ``gap.json``; what stands apart from the effects (none, unlisted) is hatched.
    """
    rows = sorted(which, key=lambda row: -row["probability"])
    shown = rows[:most]
    families: dict[str, float] = {}
    for row in rows:
        name = row.get("family") or row["effect"]
        families[name] = families.get(name, 0.0) + row["probability"]
    ranked = sorted(families.items(), key=lambda item: -item[1])[:most]
    n = max(len(shown), len(ranked))
    with style():
        figure = new_figure(0.9 + 0.27 * n)
        left, right = figure.subplots(1, 2)
        _bars(left, [(r["effect"], r["probability"]) for r in shown], n, "explanation")
        _bars(right, ranked, n, "family")
    return figure


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
    axes.set_yticks(range(len(rows)), [_short(effect_words(name)) for name, _ in rows])
    axes.set_ylim(n - 0.4, -0.6)
    axes.set_xlim(0, 114)
    axes.set_xticks(range(0, 101, 25))
    axes.set_xlabel("probability (%)")
    axes.set_title(title)
    axes.grid(axis="y", visible=False)


def gap_hidden(hidden: Mapping[str, Any], tau: float | None = None) -> Figure:
    """What may hide: how visible each effect would be, and how far it would move tau.

    ``hidden`` of ``gap.json``; ``tau`` in s draws a line.  Effects left of the line at three could
    not have been seen; the envelope of tau over them is shaded.
    """
    rows = [r for r in hidden["effects"] if r["d"] is not None and r["tau_shift_s"] is not None]
    rows.sort(key=lambda row: row["d"])
    names = [_short(effect_words(row["effect"])) for row in rows]
    d = np.array([max(row["d"], 1e-3) for row in rows])
    shift = np.array([1e3 * row["tau_shift_s"] for row in rows])
    unseen = d < VISIBLE
    place = np.arange(len(rows))
    with style():
        figure = new_figure(1.1 + 0.22 * max(len(rows), 3))
        left, right = figure.subplots(1, 2, sharey=True)
        for axes, values in ((left, d), (right, shift)):
            for kind, colour, marker, label in (
                (unseen, ORANGE, MARKERS[2], "could hide"),
                (~unseen, BLUE, MARKERS[0], "would be seen"),
            ):
                axes.plot(values[kind], place[kind], marker, color=colour, ms=5, label=label)
            axes.set_ylim(len(rows) - 0.4, -0.6)
            axes.grid(axis="y", visible=False)
        left.set_yticks(place, names)
        logarithmic(left, "x")
        left.axvline(VISIBLE, color=INK, lw=0.9, ls="--")
        left.set_xlabel("detectability d (standard deviations)")
        envelope = hidden.get("tau_envelope_s")
        if tau is not None:
            right.axvline(0.0, color=INK, lw=0.9)
            if envelope and None not in envelope:
                low, high = (1e3 * (end - tau) for end in envelope)
                right.axvspan(low, high, color=PALE, lw=0, zorder=0, label="envelope of τ")
        right.set_xlabel("shift of τ (ms)")
        right.hlines(place, 0.0, shift, color=MIDDLE, lw=0.7)
        handles, labels = right.get_legend_handles_labels()
        figure.legend(handles, labels, loc="outside upper right", ncols=3)
    return figure
