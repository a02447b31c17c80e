"""The residuals: distribution, autocorrelation, spread (paper Figs. 6 and 8)."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import FuncFormatter

from bayes_sensor.figures.colours import BLUE, DATA, INK, MODEL, PALE
from bayes_sensor.figures.labels import thousands, volts
from bayes_sensor.figures.style import content_of, logarithmic, panels, style
from bayes_sensor.fit.traces import Trace


def histogram(residuals: Any, rms: float, axes: Axes | None = None) -> Figure | Axes:
    """Distribution of all residuals with the normal law of the same RMS (paper Fig. 6).

    ``residuals``: the record, or the content of ``residuals.json``; ``rms`` in V.  Drawn on
    ``axes``, or as a figure of its own.
    """
    residuals = content_of(residuals)
    record = residuals["histogram"]
    unit = residuals.get("signal_unit", "V")
    edges, count = np.asarray(record["edges_V"]), np.asarray(record["count"], dtype=float)
    total, width = count.sum(), float(record["bin_V"])
    centre = 0.5 * (edges[1:] + edges[:-1])
    with style():
        figure = None
        if axes is None:
            figure, ((axes,),) = panels(2.9, width=5.2, top=0.1, left=0.8)
        axes.bar(
            centre, count, width=np.diff(edges), color=DATA, edgecolor=INK, lw=0.5,
            label=f"residuals ({thousands(total)})",
        )  # fmt: skip
        x = np.linspace(edges[0], edges[-1], 300)
        normal = total * width / (rms * np.sqrt(2 * np.pi)) * np.exp(-0.5 * (x / rms) ** 2)
        axes.plot(x, normal, color=MODEL, ls="--", label="normal of the same RMS")
        axes.set(xlabel=f"residual ({unit}), bins of {width:g} {unit}", ylabel="samples per bin")
        axes.yaxis.set_major_formatter(FuncFormatter(lambda value, _: thousands(value)))
        axes.legend()
    return figure or axes


def autocorrelation(residuals: Any, traces: Sequence[Trace] = ()) -> Figure:
    """Autocorrelation of the residuals with the AR(1) curve, and the residuals (paper Fig. 8).

    ``residuals``: the record, or the content of ``residuals.json``.
    """
    residuals = content_of(residuals)
    acf = residuals["acf"]
    lag, value = np.asarray(acf["lag_s"]), np.asarray(acf["value"])
    curve, band = np.asarray(acf["ar1"]), residuals["white_band"]
    with style():
        ratios = [1.7, 1] if traces else [1]
        figure, grid = panels(5.0 if traces else 3.2, len(ratios), 2, height_ratios=ratios)
        left, right = grid[0]
        autocorrelation_panel(left, residuals)
        left.set_title("short lags")
        right.axhspan(-band, band, color=PALE, lw=0)
        right.plot(lag[1:], value[1:], color=BLUE, lw=1.0)
        right.plot(lag[1:], curve[1:], color=MODEL, ls="--")
        logarithmic(right, "x")
        right.set(xlabel="lag (s), logarithmic", ylabel="autocorrelation", title="all lags")
        if traces:
            for axes in grid[1]:
                axes.remove()
            _joined_residuals(figure.add_subplot(grid[1, 0].get_gridspec()[1, :]), traces)
    return figure


def autocorrelation_panel(axes: Axes, residuals: Any) -> None:
    """Autocorrelation at short lags on ``axes``, with the AR(1) curve and the band of white
    noise."""
    residuals = content_of(residuals)
    acf = residuals["acf"]
    lag, value = np.asarray(acf["lag_s"]), np.asarray(acf["value"])
    curve, band = np.asarray(acf["ar1"]), residuals["white_band"]
    fitted = residuals["ar1"]
    own = any(name.startswith("phi[") for name in fitted)
    law = "AR(1), φ of each" if own else f"AR(1), φ = {fitted['phi']:.3f}"
    h = fitted.get("phi_interval_s", lag[1] - lag[0])
    settled = np.flatnonzero(np.abs(curve) < 0.01)
    near = lag[min(settled[0] if len(settled) else len(lag) - 1, len(lag) - 1)]
    near = float(min(max(4 * near, 30 * h), lag[-1]))
    with style():
        axes.axhspan(-band, band, color=PALE, lw=0, label="95 % band, white")
        axes.plot(lag, value, "o", color=BLUE, ms=2.6, label="residuals")
        axes.plot(lag, curve, color=MODEL, ls="--", label=law)
        axes.set(xlim=(-0.02 * near, near), ylim=(min(-0.1, float(np.min(value)) - 0.05), 1.04))
        axes.set(xlabel="lag (s)", ylabel="autocorrelation")
        axes.legend(loc="upper right")


def _joined_residuals(axes: Axes, traces: Sequence[Trace]) -> None:
    """The residuals of all experiments in a row, shades alternating (the paper's inset)."""
    unit, factor = volts(traces[0].signal_unit, 3 * max(trace.rms for trace in traces))
    start = 0.0
    for k, trace in enumerate(traces):
        piece = trace.whole
        t = start + piece.t - piece.t[0]
        axes.fill_between(
            t,
            factor * piece.residual_low,
            factor * piece.residual_high,
            color=(DATA, BLUE)[k % 2],
            lw=0.3,
        )
        start = float(t[-1])
    axes.set(xlim=(0.0, start), xlabel="time, experiments joined (s)", ylabel=f"residual ({unit})")
    axes.set_title("residuals")


def spread(residuals: Any) -> Figure:
    """Standard deviation of the residuals against test-gas concentration, with the noise law.

    ``residuals``: the record, or the content of ``residuals.json``.
    """
    residuals = content_of(residuals)
    record = residuals["variance_vs_concentration"]
    unit = residuals.get("signal_unit", "V")
    low, high = (100 * np.asarray(record[f"concentration_{end}"]) for end in ("low", "high"))
    sd, law = (
        np.array([np.nan if v is None else v for v in record[key]]) for key in ("sd_V", "law_sd_V")
    )
    shown, factor = volts(unit, float(np.nanmax(sd)))
    centre, kept = 0.5 * (low + high), np.isfinite(sd)
    with style():
        figure, ((axes,),) = panels(2.9, width=5.2, top=0.1)
        axes.errorbar(
            centre[kept], factor * sd[kept], xerr=(0.5 * (high - low))[kept], fmt="o", color=BLUE,
            ms=4, lw=1, label="residuals",
        )  # fmt: skip
        axes.plot(centre[kept], factor * law[kept], color=MODEL, ls="--", label="noise law")
        axes.set_ylim(0.0, 1.15 * factor * float(np.nanmax(np.fmax(sd, law))))
        axes.set_xlabel("test-gas concentration in the model (%)")
        axes.set_ylabel(f"standard deviation ({shown})")
        axes.legend(loc="best")
    return figure


_CURVES = ("low", "middle", "high", "observed")


def predictive(record: Any, unit: str = "V") -> Figure:
    """Replicated data against the data: autocorrelation, spread, spectrum, one-step forecasts.

    ``record``: the check, or the content of ``predictive.json``.  Bands hold 95 % of the
    replicates.
    """
    record = content_of(record)
    small, factor = volts(unit, float(np.sqrt(np.max(record["variance"]["observed"]))))
    with style():
        figure, grid = panels(4.6, 2, 2)
        words = {
            "autocorrelation": ("lag (samples)", "autocorrelation"),
            "variance": ("test-gas concentration (%)", f"standard deviation ({small})"),
            "spectrum": ("frequency (Hz)", "power of scaled residuals"),
        }
        for axes, (name, (x_label, y_label)) in zip(grid.ravel(), words.items(), strict=False):
            part = {key: np.asarray(record[name][key]) for key in ("x", *_CURVES)}
            x = (100.0 if name == "variance" else 1.0) * part["x"]
            low, middle, high, seen = (
                factor * np.sqrt(part[key]) if name == "variance" else part[key] for key in _CURVES
            )
            axes.fill_between(x, low, high, color=PALE, lw=0, label="95 % of replicates")
            axes.plot(x, middle, color=MODEL, ls="--", lw=1.0, label="their mean")
            axes.plot(x, seen, "o", color=BLUE, ms=3.6, label="data")
            if name != "variance":
                logarithmic(axes, "x")
            if name == "spectrum":
                logarithmic(axes, "y")
            axes.set(xlabel=x_label, ylabel=y_label)
            axes.set_title(f"{name.replace('variance', 'spread')}, p {_p(record[name]['p_value'])}")
        grid[0, 0].legend(loc="best")
        _pit(grid[1, 1], record["pit"])
    return figure


def _p(value: float) -> str:
    return "< 0.001" if value < 0.001 else f"= {value:.2g}"


def _pit(axes: Axes, pit: Mapping[str, Any]) -> None:
    """Histogram of the one-step-ahead probabilities; flat when the forecasts are right."""
    counts = np.asarray(pit["counts"], dtype=float)
    density = counts / counts.mean()
    half = 1.96 / np.sqrt(counts.mean())
    axes.axhspan(1 - half, 1 + half, color=PALE, lw=0)
    axes.stairs(density, np.linspace(0, 1, len(counts) + 1), color=BLUE, lw=1.2, baseline=None)
    reach = max(0.05, 1.4 * float(np.abs(density - 1).max()), 1.6 * half)
    axes.set(ylim=(1 - reach, 1 + reach), xlabel="probability that the forecast was lower")
    axes.set(ylabel="density", title=f"next-sample forecasts, p {_p(pit['p_uniform'])}")
