"""Why tau is hard to measure, what would help, and how often bound methods are right."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from bayes_sensor.figures.colours import BLUE, GREEN, INK, MARKERS, MIDDLE, ORANGE, PALE
from bayes_sensor.figures.labels import parameter_words, shortened
from bayes_sensor.figures.style import beside, logarithmic, panels, show_zero, style

MOST_PARTNERS = 8
"""entries of the weakest direction that are shown"""
KNOWN_WORDS = {
    "nothing": "nothing known",
    "t0": "t₀ known",
    "tf": "t_f known",
    "t0, tf": "t₀, t_f known",
    "V": "V known",
    "tau_v": "τᵥ known",
    "V, tau_v": "V, τᵥ known",
    "t0, tf, V, tau_v": "all of these",
}


def tau_hard(record: Mapping[str, Any]) -> Figure:
    """Profile of tau, its bound against tau and under extra knowledge, the weakest direction.

    ``record``: ``what_makes_tau_hard`` of ``bounds.json``.
    """
    with style():
        names = [KNOWN_WORDS.get(name, name) for name in record["sd_tau_if_known_s"]]
        others = [shortened(parameter_words(name)[0]) for name in record["weakest"]]
        figure, ((profile, against), (known, weakest)) = panels(
            5.6, 2, 2, left=max(0.7, beside(names)), across=max(0.7, beside(others) + 0.1)
        )
        _profile(profile, record["profile"])
        _against_tau(against, record)
        _known(known, record["sd_tau_if_known_s"])
        _weakest(weakest, record["weakest"])
    return figure


def _numbers(values: Sequence[float | None], factor: float = 1.0) -> np.ndarray:
    return np.array([np.nan if v is None else factor * v for v in values], dtype=float)


def _profile(axes: Axes, record: Mapping[str, Any]) -> None:
    tau = _numbers(record["tau_s"], 1e3)
    for key, words, colour, line in (
        ("drop", "profile likelihood", INK, "-"),
        ("square", "Gaussian in τ²", BLUE, "--"),
        ("gaussian", "estimate ± sd", ORANGE, ":"),
    ):
        values = _numbers(record[key])
        if np.isfinite(values).any():
            axes.plot(tau, values, color=colour, ls=line, label=words)
    # half of chi-squared's 95 % quantile at one degree of freedom
    axes.axhline(1.92, color=MIDDLE, lw=0.8)
    axes.annotate("95 %", (0.99, 1.92), xycoords=("axes fraction", "data"), ha="right",
                  va="bottom", fontsize=7, color=MIDDLE)  # fmt: skip
    axes.set(ylim=(0.0, 6.0), xlabel="sensor τ (ms)", ylabel="loss of log-likelihood")
    axes.set_title("how well the data hold τ")
    axes.legend(loc="upper left")


def _against_tau(axes: Axes, record: Mapping[str, Any]) -> None:
    by_tau = record["by_tau"]
    tau, sd = _numbers(by_tau["tau_s"], 1e3), _numbers(by_tau["sd_tau_s"], 1e3)
    root = np.sqrt(_numbers(by_tau["sd_square_s2"], 1e6))
    axes.plot(tau, sd, "o-", ms=3, color=ORANGE, label="bound on τ")
    axes.plot(tau, root, "s--", ms=3, color=BLUE, label="root of the bound on τ²")
    axes.plot(tau, tau, color=MIDDLE, lw=0.8, label="τ itself")
    logarithmic(axes, "x")
    logarithmic(axes, "y")
    axes.set(xlabel="true τ (ms)", ylabel="one standard deviation (ms)")
    axes.set_title("the information is on τ²")
    axes.legend(loc="best")


def _known(axes: Axes, record: Mapping[str, float | None]) -> None:
    labels = list(record)
    sd = _numbers([record[label] for label in labels], 1e3)
    rows = np.arange(len(labels))
    axes.barh(rows, np.nan_to_num(sd), height=0.6, color=PALE, edgecolor=MIDDLE, lw=0.6)
    for row, value in zip(rows, sd, strict=True):
        words = f"{value:.3g} ms" if np.isfinite(value) else "no finite bound"
        axes.annotate(
            words, (np.nan_to_num(value), row), xytext=(3, 0), textcoords="offset points",
            va="center", fontsize=7,
        )  # fmt: skip
    axes.set_yticks(rows, [KNOWN_WORDS.get(label, label) for label in labels])
    axes.invert_yaxis()
    top = float(np.nanmax(sd, initial=0.0))
    axes.set_xlim(0.0, 1.3 * top if top > 0 else 1.0)
    axes.grid(axis="y", visible=False)
    axes.set(xlabel="bound on τ (ms, one standard deviation)", title="if something else were known")


def _weakest(axes: Axes, record: Mapping[str, float]) -> None:
    names = list(record)[:MOST_PARTNERS]
    rows = np.arange(len(names))
    values = [record[name] for name in names]
    colours = [ORANGE if name == "tau_s" else BLUE for name in names]
    axes.barh(rows, values, height=0.6, color=colours)
    axes.axvline(0.0, color=MIDDLE, lw=0.8)
    axes.set_yticks(rows, [shortened(parameter_words(name)[0]) for name in names])
    axes.invert_yaxis()
    axes.grid(axis="y", visible=False)
    axes.set(xlabel="share in the direction (scaled)", title="what the data know least")


def what_would_help(rows: Sequence[Mapping[str, Any]]) -> Figure:
    """Predicted 68 and 95 % intervals of tau for each change, with the gain.

    ``rows``: ``what_would_help`` of ``bounds.json``.
    """
    with style():
        changes = [row["change"].replace("+-", "± ") for row in rows]
        figure, ((axes,),) = panels(
            0.21 * len(rows) + 0.7, left=beside(changes), right=0.5, top=0.1
        )
        for i, row in enumerate(rows):
            colour = INK if i == 0 else BLUE
            for lo, hi, width in (("lo95_s", "hi95_s", 1.4), ("lo68_s", "hi68_s", 4.2)):
                ends = _numbers([row[lo], row[hi]], 1e3)
                axes.plot(ends, [i, i], color=colour, lw=width, solid_capstyle="butt")
            if row["gain"] is not None and i > 0:
                axes.annotate(
                    f"{row['gain']:.3g}×", (1.01, i), xycoords=("axes fraction", "data"),
                    va="center", fontsize=7, color=GREEN if row["gain"] > 1.5 else MIDDLE,
                )  # fmt: skip
        axes.set_yticks(range(len(rows)), changes)
        axes.set_ylim(len(rows) - 0.4, -0.6)
        low, high = (_numbers([row[key] for row in rows]) for key in ("lo95_s", "hi95_s"))
        show_zero(axes, float(np.nanmin(low)), float(np.nanmax(high)))
        axes.set_xlabel("predicted interval of τ (ms): 68 % thick, 95 % thin; at right the gain")
    return figure


def _setting_words(setting: str) -> str:
    """A simulated setting as words.

    >>> _setting_words("ar1_0.9"), _setting_words("slow_closing")
    ('AR(1), φ 0.9', 'slow closing')
    """
    words = {"iid": "white noise", "arma": "ARMA"}.get(setting, setting)
    return words.replace("ar1_", "AR(1), φ ").replace("_", " ")


def coverage(
    rows: Sequence[Mapping[str, Any]], parameters: Sequence[str] = ("tau_s", "tau_v_s", "V_mL")
) -> Figure:
    """Share of the 95 % intervals that hold the truth: one panel a setting, one row a method.

    ``rows``: records of ``coverage_bounds.csv``.
    """
    some = [row for row in rows if str(row["level"]) == "95" and row["parameter"] in parameters]
    settings = list(dict.fromkeys(row["setting"] for row in some))
    methods = list(dict.fromkeys(row["method"] for row in some))
    with style():
        from bayes_sensor.bounds.methods import method_of  # slow to import

        labels = [method_of(method).label for method in methods]
        figure, (row_of_axes,) = panels(
            0.3 * len(methods) + 1.3, 1, len(settings), left=beside(labels), across=0.15,
            bottom=0.7, sharey=True,
        )  # fmt: skip
        for axes, setting in zip(row_of_axes, settings, strict=True):
            for j, name in enumerate(parameters):
                shift = 0.24 * (j - 0.5 * (len(parameters) - 1))
                colour = (ORANGE, BLUE, GREEN)[j % 3]
                for row in some:
                    if (row["setting"], row["parameter"]) != (setting, name):
                        continue
                    at = methods.index(row["method"]) + shift
                    axes.plot(
                        [row["coverage_lo95"], row["coverage_hi95"]], [at, at], color=colour, lw=1.2
                    )
                    axes.plot(row["coverage"], at, MARKERS[j], color=colour, ms=4)
            axes.axvline(0.95, color=MIDDLE, lw=0.8)
            axes.set_xlim(-0.03, 1.03)
            axes.set_xticks([0.0, 0.5, 0.95], ["0", "0.5", "0.95"])
            axes.set_title(_setting_words(setting), fontsize=8.5)
        row_of_axes[0].set_yticks(range(len(methods)), labels)
        row_of_axes[0].invert_yaxis()
        handles = [
            row_of_axes[0].plot([], [], MARKERS[j], color=(ORANGE, BLUE, GREEN)[j % 3], ms=4)[0]
            for j in range(len(parameters))
        ]
        figure.legend(
            handles, [parameter_words(name)[0] for name in parameters], loc="lower center",
            ncols=len(parameters),
        )  # fmt: skip
        middle = row_of_axes[len(settings) // 2]
        middle.set_xlabel("share of 95 % intervals that hold the truth")
    return figure
