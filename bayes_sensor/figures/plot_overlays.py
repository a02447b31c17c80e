"""Measurement against model, trace by trace (paper Fig. 5)."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator

from bayes_sensor.figures.colours import DATA, GREEN, INK, MIDDLE, MODEL, ORANGE
from bayes_sensor.figures.labels import shortened, volts
from bayes_sensor.figures.style import panels, style
from bayes_sensor.fit.traces import Envelope, Trace


def overlay(trace: Trace) -> Figure:
    """Measurement and model of one experiment with the residuals below (paper Fig. 5).

    Left the whole record, then the start and, where one was recorded, the end of the step.
    """
    parts: list[tuple[str, Envelope, float | None, float | None]] = [
        ("whole record", trace.whole, None, None),
        ("start", trace.rise, trace.t0, trace.commanded_on),
    ]
    if trace.fall is not None:
        parts.append(("end", trace.fall, trace.tf, trace.commanded_off))
    unit = trace.signal_unit
    small, factor = volts(unit, 3.0 * trace.rms)
    with style():
        figure, axes = panels(
            3.5, 2, len(parts), across=0.15, down=0.12, sharex="col", sharey="row",
            height_ratios=[2.3, 1], width_ratios=[1.9] + [1] * (len(parts) - 1),
        )  # fmt: skip
        for column, (title, piece, edge, commanded) in enumerate(parts):
            upper, lower = axes[:, column]
            _record(upper, piece)
            lower.fill_between(
                piece.t,
                factor * piece.residual_low,
                factor * piece.residual_high,
                color=DATA,
                lw=0.8,
            )
            lower.plot(piece.t, factor * piece.residual, color=INK, lw=0.7, label="mean of stretch")
            for sign in (-2, 2):
                lower.plot(
                    piece.t,
                    sign * factor * piece.sd,
                    color=ORANGE,
                    lw=0.9,
                    ls=(0, (4, 2)),
                    label="± 2 sd, noise law" if sign > 0 else None,
                )
            if commanded is not None and piece.t[0] <= commanded <= piece.t[-1]:
                upper.axvline(commanded, color=MIDDLE, lw=0.9, ls=":", label="commanded")
            if edge is not None and piece.t[0] <= edge <= piece.t[-1]:
                upper.axvline(edge, color=GREEN, lw=0.9, ls="--", label="fitted switch")
            upper.set_title(title)
            lower.set_xlabel("time (s)")
            lower.xaxis.set_major_locator(MaxNLocator(4 if column else 6))
            upper.set_xlim(piece.t[0], piece.t[-1])
        low, high = axes[1, 0].get_ylim()
        axes[1, 0].set_ylim(low, high + 0.3 * (high - low))  # room for the legend
        axes[0, 0].set_ylabel(f"signal ({unit})")
        axes[1, 0].set_ylabel(f"residual ({small})")
        axes[0, 0].legend(loc="best", handlelength=1.6)
        axes[0, 1].legend(
            *_only(axes[0, 1], ("commanded", "fitted switch")), loc="best", handlelength=1.6
        )
        axes[1, 0].legend(loc="upper right", ncols=2, fontsize=7, borderaxespad=0.1)
    return figure


def overlay_panel(axes: Axes, trace: Trace) -> None:
    """Measurement and model of one experiment, the whole record, on ``axes``."""
    with style():
        _record(axes, trace.whole)
        axes.set(xlabel="time (s)", ylabel=f"signal ({trace.signal_unit})")
        axes.set_title(f"experiment {shortened(trace.name)}")
        axes.legend(loc="best", handlelength=1.6)


def _record(axes: Axes, piece: Envelope) -> None:
    axes.fill_between(piece.t, piece.low, piece.high, color=DATA, lw=0.8, label="measured")
    axes.plot(piece.t, piece.model, color=MODEL, lw=1.2, label="model")


def _only(axes: Axes, labels: Sequence[str]) -> tuple[list[Any], list[str]]:
    handles, names = axes.get_legend_handles_labels()
    kept = [(h, n) for h, n in zip(handles, names, strict=True) if n in labels]
    return [h for h, _ in kept], [n for _, n in kept]
