"""A record, its restored input with bands, and the resolution."""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING

import numpy as np
from matplotlib.figure import Figure
from numpy.typing import NDArray

from bayes_sensor.campaign import FloatArray
from bayes_sensor.figures.colours import DATA, GREEN, INK, MIDDLE, MODEL, REGIONS
from bayes_sensor.figures.style import new_figure, style

if TYPE_CHECKING:
    from bayes_sensor.restoration import Restored

MOST_POINTS = 4000
"""stretches that are drawn; of a longer record the least and greatest of each, or the mean"""
UNITS = ((2 * 86400.0, 86400.0, "d"), (2 * 3600.0, 3600.0, "h"), (300.0, 60.0, "min"))
"""s from which a unit of time is used, its length and its name"""


def restored(found: Restored) -> Figure:
    """Above the record; below the input with 68 and 95 % bands and a bar of the resolution."""
    duration = float(found.t[-1] - found.t[0])
    length, unit = next(
        (n, name) for least, n, name in (*UNITS, (0.0, 1.0, "s")) if duration >= least
    )
    starts = np.unique(
        np.linspace(0, len(found.t), min(MOST_POINTS, len(found.t)) + 1).astype(int)
    )[:-1]
    t = _of_each(np.nanmean, found.t, starts) / length
    of_unit = f" ({found.unit})" if found.unit else ""
    with style():
        figure = new_figure(4.4)
        upper, lower = figure.subplots(2, 1, sharex=True, height_ratios=[1, 1.6])
        upper.fill_between(
            t,
            _of_each(np.nanmin, found.recorded, starts),
            _of_each(np.nanmax, found.recorded, starts),
            color=DATA,
            lw=0.8,
        )
        upper.set_ylabel(f"record{of_unit}")
        for level, colour, words in ((0.025, REGIONS[0], "95 %"), (0.16, REGIONS[1], "68 %")):
            low, high = (
                _of_each(np.nanmean, found.quantile(p), starts) for p in (level, 1.0 - level)
            )
            lower.fill_between(t, low, high, color=colour, lw=0, label=words)
        lower.plot(t, _of_each(np.nanmean, found.value, starts), color=MODEL, lw=1.0, label="input")
        lower.set(ylabel=f"restored input{of_unit}", xlabel=f"time ({unit})", xlim=(t[0], t[-1]))
        low, high = lower.get_ylim()
        lower.set_ylim(low, high + 0.22 * (high - low))  # room for the legend
        resolution = found.resolution_s
        if resolution is None:
            lower.text(
                0.02, 0.94, "nothing is resolved", transform=lower.transAxes, color=INK, va="top"
            )
        else:
            place = high + 0.12 * (high - low)
            begin = t[0] + 0.02 * (t[-1] - t[0])
            lower.plot(
                [begin, begin + resolution / length], [place, place], color=GREEN, lw=2.5,
                marker="|", ms=7, label=f"resolution {resolution:.3g} s",
            )  # fmt: skip
        gaps = np.isnan(_of_each(np.nanmean, found.recorded, starts))
        if gaps.any():
            lower.fill_between(
                t, 0, 1, where=gaps, transform=lower.get_xaxis_transform(), color=MIDDLE,
                alpha=0.15, lw=0, label="no samples",
            )  # fmt: skip
        lower.legend(loc="upper right", ncols=5, fontsize=7)
    return figure


def _of_each(
    function: Callable[[FloatArray], float], values: FloatArray, starts: NDArray[np.int64]
) -> FloatArray:
    """A value for each stretch between ``starts``; NaN where a stretch is empty."""
    parts = np.split(values, starts[1:])
    return np.array([function(p) if np.isfinite(p).any() else np.nan for p in parts])
