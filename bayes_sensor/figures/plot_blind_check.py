"""The score card of the blind check: six panels, each share with its 95 % interval."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import NullLocator

from bayes_sensor.figures.colours import (
    BLUE,
    DATA,
    GREEN,
    INK,
    MARKERS,
    MIDDLE,
    MODEL,
    ORANGE,
    PALE,
)
from bayes_sensor.figures.plot_gap import effect_words
from bayes_sensor.figures.style import SMALLEST, WIDTH, style

Part = Mapping[str, Any]


def score_card(card: Part) -> Figure:
    """Six panels from ``score.json``: false alarms, wrong names, family, unlisted, p, tau."""
    with style():
        figure = Figure(figsize=(WIDTH, 5.2), layout="constrained")
        (alarms, wrong, tau), (family, unlisted, stated) = figure.subplots(2, 3)
        _false_alarms(alarms, card["nulls"])
        _wrong_names(wrong, card["confident_wrong"])
        _tau(tau, card["tau"])
        _against_d(
            family, card["accuracy"], "right family",
            {"family_or_abstained": "or rightly unnamed", "family": "right family",
             "family_bic": "by BIC"},
        )  # fmt: skip
        _against_d(
            unlisted, card["unlisted"]["flagged"], "unlisted cause found",
            {"flagged_or_unnamed": "or rightly unnamed", "flagged": "called unlisted",
             "within_reach": "no look-alike"},
        )  # fmt: skip
        _reliability(stated, card["calibration"]["verdict"])
    return figure


def _rates(parts: Sequence[Part]) -> np.ndarray:
    return np.array([np.nan if p["rate"] is None else p["rate"] for p in parts], dtype=float)


def _errors(parts: Sequence[Part]) -> np.ndarray:
    """(2, n) lengths of the error bars below and above the rates."""
    rates = _rates(parts)
    low, high = (np.array([p[end] for p in parts], dtype=float) for end in ("lo95", "hi95"))
    lengths: np.ndarray = np.nan_to_num(np.maximum(np.stack([rates - low, high - rates]), 0.0))
    return lengths


def _bars(axes: Axes, parts: Mapping[str, Part], colours: Sequence[str], title: str) -> None:
    y = np.arange(len(parts))
    every = list(parts.values())
    axes.barh(y, _rates(every), 0.6, color=colours, lw=0)
    axes.errorbar(_rates(every), y, xerr=_errors(every), fmt="none", ecolor=INK, elinewidth=0.8)
    axes.set_yticks(y, [f"{name} ({part['n']})" for name, part in parts.items()])
    axes.tick_params(axis="y", labelsize=SMALLEST)
    axes.yaxis.grid(False)
    axes.invert_yaxis()
    axes.set(xlim=(0.0, None), title=title)


def _false_alarms(axes: Axes, nulls: Part) -> None:
    parts = {
        "cause named": nulls["all"]["named"], "by BIC": nulls["all"]["bic_named"],
        "AR(1) noise": nulls["ar1"]["alarmed"],
        "other noise": nulls["not_ar1"]["alarmed"],
    }  # fmt: skip
    _bars(axes, parts, [MODEL, MIDDLE, PALE, PALE], "false alarm")
    axes.set_xlabel("share without a cause")


def _wrong_names(axes: Axes, wrong: Part) -> None:
    words = {
        "listed": "listed", "pair": "two listed", "unlisted": "unlisted", "withheld": "taken out",
        "bic_listed": "listed, BIC", "bic_unlisted": "unlisted, BIC",
    }  # fmt: skip
    colours = [MIDDLE if key.startswith("bic") else DATA for key in words]
    _bars(axes, {word: wrong[key] for key, word in words.items()}, colours, "wrong name")
    axes.set_xlabel("share with p > 0.9")


def _tau(axes: Axes, tau: Part) -> None:
    values = [np.nan if tau[key] is None else tau[key] for key in ("before", "after")]
    axes.bar([0, 1], values, 0.6, color=[PALE, DATA], edgecolor=INK, lw=0.6)
    axes.set_xticks([0, 1], ["without", "with"])
    axes.xaxis.grid(False)
    if tau["before"] is None:
        axes.set_xlim(-0.5, 1.5)
        axes.set_yticks([])
        _no_case(axes)
    axes.set(xlabel="cause in model", ylabel="mean error of ln τ", title="error of τ")


def _no_case(axes: Axes, height: float = 0.5) -> None:
    """Say in an empty panel why it is so."""
    axes.text(
        0.5, height, "no case", transform=axes.transAxes, ha="center", va="center", color=MIDDLE,
        fontsize=SMALLEST,
    )  # fmt: skip


def _shares(axes: Axes) -> None:
    axes.set_ylim(-0.03, 1.03)
    axes.set_yticks([0, 0.25, 0.5, 0.75, 1], ["0", "0.25", "0.5", "0.75", "1"])


def _against_d(axes: Axes, table: Sequence[Part], title: str, keys: Mapping[str, str]) -> None:
    """Shares at each detectability; the second has error bars."""
    levels = np.array([row["d"] for row in table])
    colours = BLUE, ORANGE, MIDDLE
    for i, (key, label) in enumerate(keys.items()):
        parts = [row[key] for row in table]
        axes.errorbar(
            levels * 2.0 ** (0.06 * (i - 1)), _rates(parts), yerr=_errors(parts) if i < 2 else None,
            color=colours[i], marker=MARKERS[i], ms=4, lw=1.0, elinewidth=0.8,
            ls="-" if i < 2 else "--", label=label,
        )  # fmt: skip
    axes.set_xscale("log")
    axes.set_xlim(levels[0] / 1.2, levels[-1] * 1.2)
    if not any(row[key]["n"] for row in table for key in keys):
        _no_case(axes, 0.6)
    axes.set_xticks(levels, [f"{level:g}" for level in levels])
    axes.xaxis.set_minor_locator(NullLocator())
    _shares(axes)
    axes.legend(
        loc="upper center", bbox_to_anchor=(0.45, -0.3), fontsize=SMALLEST, handlelength=1.6
    )
    axes.set(xlabel="size d of the misfit (sd)", ylabel="share of campaigns", title=title)


def _reliability(axes: Axes, calibration: Part) -> None:
    axes.plot([0, 1], [0, 1], color=MIDDLE, lw=0.7, ls=":")
    parts = [entry["right"] for entry in calibration["bins"]]
    axes.errorbar(
        [entry["stated"] for entry in calibration["bins"]], _rates(parts), yerr=_errors(parts),
        fmt="o", ms=4, color=BLUE, elinewidth=0.8,
    )  # fmt: skip
    label = "stated probability"
    if calibration["ece"] is None:
        _no_case(axes, 0.2)
    else:
        label += f"\nmean error {calibration['ece']:.3f}\n(chance: {calibration['band95']:.3f})"
    axes.set_xlim(0, 1.02)
    axes.set_xticks([0, 0.5, 1], ["0", "0.5", "1"])
    _shares(axes)
    axes.set(xlabel=label, ylabel="share right", title="verdicts")


def opened_seal(gap: Part, row: Part) -> Figure:
    """What a diagnosis said of a withheld campaign, and what was true.

    ``gap``: gap.json; ``row``: the case's row of ``cases.csv``.
    """
    right = set(str(row["listed_as"]).replace("+", "|").split("|"))
    with style():
        figure = Figure(figsize=(WIDTH, 2.9), layout="constrained")
        left, middle, far = figure.subplots(1, 3, width_ratios=(1.5, 0.8, 0.8))
        best = sorted(gap["which"], key=lambda entry: -(entry["probability"] or 0.0))[:7]
        y = np.arange(len(best))
        colours = [GREEN if set(e["effect"].split("+")) & right else DATA for e in best]
        left.barh(y, [entry["probability"] for entry in best], 0.65, color=colours, lw=0)
        left.set_yticks(y, [effect_words(entry["effect"]) for entry in best])
        left.tick_params(axis="y", labelsize=SMALLEST)
        left.yaxis.grid(False)
        left.invert_yaxis()
        left.set(xlim=(0, 1.02), xlabel="probability", title="cause (green: the truth)")
        closed, oracle = row["closed"], row["closed_oracle"]
        if closed is not None:
            error = np.abs(np.array([[closed - row["closed_lo"]], [row["closed_hi"] - closed]]))
            middle.errorbar([0], [closed], yerr=error, fmt=MARKERS[0], color=BLUE, elinewidth=0.9)
        if oracle is not None:
            middle.axhline(oracle, color=GREEN, lw=1.2, ls="--")
        middle.set_ylim(0, 1.15)
        middle.set_xticks([0], ["gap closed"])
        middle.set(xlim=(-0.6, 0.6), ylabel="share, 95 % interval", title="how far")
        shrink = gap["shrink"]
        values = [1e3 * shrink[key] for key in ("tau_before_s", "tau_after_s")]
        far.plot([0], values[:1], MARKERS[1], color=MIDDLE)
        low, high = shrink.get("tau_after_lo_s"), shrink.get("tau_after_hi_s")
        bar = None if low is None or high is None else [[values[1] - 1e3 * low],
                                                        [1e3 * high - values[1]]]  # fmt: skip
        far.errorbar([1], values[1:], yerr=bar, fmt=MARKERS[0], color=BLUE, elinewidth=0.9)
        if row["tau_true_s"] is not None:
            far.axhline(1e3 * row["tau_true_s"], color=GREEN, lw=1.2, ls="--")
        far.set_xticks([0, 1], ["without", "with"])
        far.set(xlim=(-0.6, 1.6), ylabel="τ (ms), 95 % interval", title="τ")
    return figure
