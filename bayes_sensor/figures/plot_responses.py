"""The recorded responses (paper Fig. 3b, d, f)."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from bayes_sensor.figures.colours import BLUE, GREEN, INK, MIDDLE, MODEL, ORANGE
from bayes_sensor.figures.style import panels, style
from bayes_sensor.fit.traces import Trace

MOST_PANELS = 6
_LOOKS: tuple[tuple[str, Any], ...] = (
    (BLUE, "-"),
    (ORANGE, (0, (4, 1.5))),
    (INK, (0, (1.5, 1))),
    (GREEN, (0, (5, 1.5, 1, 1.5))),
    (MODEL, (0, (2, 1.5))),
)


def responses(traces: Sequence[Trace]) -> Figure:
    """Measured responses of each test-gas concentration, one line a flow, with the drive's edges.

    The line is the middle of each stretch of samples, from 5 s before the command (or the fitted
    switch if none is known), so that flows and delays can be compared.
    """
    levels = sorted({round(100 * trace.concentration, 1) for trace in traces})[:MOST_PANELS]
    unit = traces[0].signal_unit
    with style():
        columns = min(len(levels), 3)
        rows = -(-len(levels) // columns)
        figure, grid = panels(
            0.3 + 2.9 * rows, rows, columns, bottom=1.0, across=0.15, down=1.0, sharey=True
        )
        for axes in grid.ravel()[len(levels) :]:
            axes.set_visible(False)
        for axes, level in zip(grid.ravel(), levels, strict=False):
            chosen = [t for t in traces if round(100 * t.concentration, 1) == level]
            for trace, (colour, dash) in zip(chosen, _LOOKS, strict=False):
                start = trace.t0 if trace.commanded_on is None else trace.commanded_on
                piece = trace.whole
                axes.plot(
                    piece.t - start, 0.5 * (piece.low + piece.high), color=colour, ls=dash, lw=1.0,
                    label=trace.name if np.isnan(trace.total_flow)
                    else f"{60e-3 * trace.total_flow:.3g} L/min",
                )  # fmt: skip
                if trace.commanded_on is not None:
                    axes.axvline(0.0, color=MIDDLE, lw=0.8, ls=":")
                    if trace.commanded_off is not None:
                        axes.axvline(trace.commanded_off - start, color=MIDDLE, lw=0.8, ls=":")
            axes.set_xlim(left=-5.0)
            if not any(np.isnan(trace.total_flow) for trace in chosen):
                axes.set_title(f"{level:g} % test gas")
            axes.legend(loc="upper center", bbox_to_anchor=(0.5, -0.2), ncols=2, columnspacing=1.2)
        for axes in grid[:, 0]:
            axes.set_ylabel(f"signal ({unit})")
        for axes in grid[-1]:
            axes.set_xlabel("time after the command (s)")
    return figure
