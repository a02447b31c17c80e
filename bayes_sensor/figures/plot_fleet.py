"""tau of many campaigns side by side."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from bayes_sensor.figures.colours import BLUE, GREEN, GROUND, INK, MIDDLE, ORANGE
from bayes_sensor.figures.labels import shortened
from bayes_sensor.figures.quoted_tau import has_cause, quoted_tau
from bayes_sensor.figures.style import beside, panels, style

MOST_NAMES = 60
"""campaigns whose names fit beside the figure; more are only ranked"""
LONGEST_NAME = 28


def forest(rows: Sequence[Mapping[str, Any]], median_s: float | None = None) -> Figure:
    """Forest plot of tau, smallest first: median, 68 % thick, 95 % thin.

    Where the diagnosis found a cause that the posterior lacks: with that cause in the model, 95 %.

    ``rows``: the table of a fleet; those without a tau are listed at the bottom with the reason.
    An arrow to the left ends at the one-sided 95 % limit of a campaign that does not exclude zero.
    """
    known = sorted((r for r in rows if r["tau_s"] is not None), key=lambda r: quoted_tau(r)[1])
    lost = [r for r in rows if r["tau_s"] is None]
    named = len(rows) <= MOST_NAMES
    shown = [*known, *(lost if named else [])]
    with style():
        names = [shortened(str(row["campaign"]), LONGEST_NAME) for row in shown] if named else []
        figure, ((axes,),) = panels(
            0.24 * len(shown) + 1.0 if named else 8.0, left=beside(names) if named else 0.4
        )
        thick = (1.3, 4.0) if named else (0.5, 1.4) if len(known) < 400 else (0.2, 0.5)
        handles: dict[str, Any] = {}
        for i, row in enumerate(known):
            kind, colour = _kind(row)
            low, middle, high = quoted_tau(row)
            if row["tau_is_limit"]:
                upper = high if has_cause(row) else row["tau_upper95_s"]
                axes.plot([0.0, 1e3 * upper], [i, i], color=colour, lw=thick[0])
                if named:
                    axes.plot(1e3 * upper, i, "<", color=colour, ms=4.5)
                line = axes.plot(1e3 * middle, i, "|", color=colour, ms=5 if named else 1.5)
            else:
                spans = [(low, high, thick[0])]
                if not has_cause(row):
                    spans.append((row["tau_lo68_s"], row["tau_hi68_s"], thick[1]))
                for begin, end, width in spans:
                    axes.plot(
                        [1e3 * begin, 1e3 * end], [i, i],
                        color=colour, lw=width, solid_capstyle="butt",
                    )  # fmt: skip
                line = axes.plot(
                    1e3 * middle, i, "D", color=GROUND if named else colour, mec=colour,
                    ms=4.2 if named else 0.8, mew=1.1,
                )  # fmt: skip
            handles.setdefault(kind, line[0])
        for i, row in enumerate(lost if named else [], len(known)):
            axes.annotate(
                _why_none(row), (0.5, i), xycoords=("axes fraction", "data"), ha="center",
                va="center", fontsize=7, color=MIDDLE,
            )  # fmt: skip
        if median_s is not None:
            handles["median of the fleet"] = axes.axvline(
                1e3 * median_s, color=GREEN, ls="--", lw=1, zorder=1
            )
        if named:
            axes.set_yticks(range(len(shown)), names)
        else:
            axes.set_ylabel(f"{len(known)} campaigns, smallest τ first")
        axes.set_ylim(max(len(shown), 1) - 0.4, -0.6)
        axes.set_xlim(*_range(known))
        axes.set_xlabel("sensor τ (ms)")
        axes.grid(axis="y", visible=False)
        figure.legend(
            handles.values(), handles.keys(), loc="upper right", ncols=4, borderaxespad=0.1
        )
    return figure


def _why_none(row: Mapping[str, Any]) -> str:
    if row.get("order") != "undecided":
        return str(row["status"])
    lags = " or ".join(f"{row[name]:.3g} s" for name in ("lag_fast_s", "lag_slow_s"))
    return f"which lag is the sensor's is not known: {lags}"


def _kind(row: Mapping[str, Any]) -> tuple[str, str]:
    if row["status"] != "done":
        return "not converged", MIDDLE
    if row["tau_is_limit"]:
        return "upper limit", ORANGE
    if has_cause(row):
        return "with a cause found, 95 %", INK
    if row.get("gap") in (None, "none"):
        return "median, 68 %, 95 %", BLUE
    return "the same, model misses", INK


def _range(known: Sequence[Mapping[str, Any]]) -> tuple[float, float]:
    """Range of all 95 % intervals, without those so wide that the others would vanish."""
    if not known:
        return 0.0, 1.0
    high = np.array([1e3 * max(quoted_tau(r)[2], r["tau_upper95_s"] or 0.0) for r in known])
    low = np.array([0.0 if r["tau_is_limit"] else 1e3 * quoted_tau(r)[0] for r in known])
    top = min(float(high.max()), 4.0 * float(np.median(high)))
    bottom = float(low.min())
    margin = 0.04 * (top - bottom) or 1.0
    return max(0.0, bottom - margin), top + margin
