"""The rig: its chain of lags (paper Fig. 4) and the recorded responses (paper Fig. 3b, d, f)."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import FancyBboxPatch

from bayes_sensor.figures.style import (
    BLUE,
    GREEN,
    INK,
    MIDDLE,
    MODEL,
    ORANGE,
    PALE,
    REGIONS,
    panels,
    style,
)
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


def schematic() -> Figure:
    """The model as a chain of first-order lags, with the response of each to a step (paper Fig.
    4)."""
    boxes = (
        ("command", "u(t)", "open at t₀, then shut"),
        ("valve", "x₁′ = (u − x₁)/τᵥ", "same in every experiment"),
        ("manifold", "x₂′ = (Q/V)(x₁ − x₂)", "faster at higher flow"),
        ("sensor", "x₃′ = (x₂ − x₃)/τ", "the lag that is sought"),
        ("readout", "y = y₀ + β x₃", "plus coloured noise"),
    )
    lags = (0.0, 0.35, 0.6, 0.12, 0.0)
    with style():
        figure, ((axes,),) = panels(2.15, left=0.05, right=0.05, top=0.05, bottom=0.05)
        axes.set_axis_off()
        axes.set(xlim=(0.0, 5.0), ylim=(0.0, 1.0))
        kept: list[float] = []
        for i, (name, law, remark) in enumerate(boxes):
            left = i + 0.06
            axes.add_patch(
                FancyBboxPatch(
                    (left, 0.3), 0.82, 0.66, boxstyle="round,pad=0,rounding_size=0.04",
                    facecolor=REGIONS[0] if name == "sensor" else "none", edgecolor=INK, lw=0.9,
                )
            )  # fmt: skip
            axes.text(left + 0.41, 0.89, name, ha="center", va="center", weight="bold", fontsize=9)
            axes.text(left + 0.41, 0.4, law, ha="center", va="center", fontsize=7.6)
            axes.text(left + 0.41, 0.2, remark, ha="center", va="center", fontsize=7, color=MIDDLE)
            kept = [*kept, lags[i]] if lags[i] else kept
            _pulse(axes, left + 0.1, kept)
            if i + 1 < len(boxes):
                axes.annotate(
                    "", (left + 1.0, 0.63), (left + 0.82, 0.63),
                    arrowprops={"arrowstyle": "-|>", "color": INK, "lw": 1.0},
                )  # fmt: skip
    return figure


def _pulse(axes: Axes, left: float, lags: Sequence[float]) -> None:
    """A step up and down after first-order lags, drawn small."""
    t = np.linspace(0.0, 8.0, 400)
    x = ((t > 1.0) & (t < 5.0)).astype(float)
    for lag in lags:
        follow = np.zeros_like(x)
        gain = -np.expm1(-(t[1] - t[0]) / lag)
        for k in range(1, len(t)):
            follow[k] = follow[k - 1] + gain * (x[k] - follow[k - 1])
        x = follow
    axes.plot(left + 0.62 * t / 8.0, np.full_like(t, 0.5), color=PALE, lw=0.7)
    axes.plot(left + 0.62 * t / 8.0, 0.5 + 0.28 * x, color=BLUE, lw=1.4)
