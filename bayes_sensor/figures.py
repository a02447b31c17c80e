"""Records in, Figure out: every figure of the report, in one style.

Colours are from Okabe and Ito's palette, chosen so that lines also differ in grey; what matters is
also told apart by line style or marker.  Figures are made without pyplot's global state, and the
same records give the same bytes.
"""

from __future__ import annotations

import io
from collections.abc import Mapping, Sequence
from typing import Any

import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import FuncFormatter, LogLocator, MaxNLocator, NullFormatter

from bayes_sensor.campaign import FloatArray
from bayes_sensor.results import Envelope, Trace

INK = "#1b1b1b"
PALE = "#d4d4d4"
MIDDLE = "#7a7a7a"
DATA = "#8fb4d3"
MODEL = "#a01c1c"
BLUE = "#0072b2"
ORANGE = "#d55e00"
GREEN = "#009e73"
REGIONS = ("#dbe8f2", "#a9cae2", "#6fa6cd")
GROUND = "#ffffff"
COLOURS = (GROUND, INK, PALE, MIDDLE, DATA, MODEL, BLUE, ORANGE, GREEN, *REGIONS)
"""every colour in use; the page gives each its counterpart on a dark ground"""
WIDTH = 7.2
"""inches"""
MARKERS = ("o", "s", "^", "D", "v", "P", "X", "*")

STYLE: dict[str, Any] = {
    "axes.axisbelow": True,
    "axes.edgecolor": MIDDLE,
    "axes.facecolor": "none",
    "axes.formatter.useoffset": False,
    "axes.grid": True,
    "axes.labelcolor": INK,
    "axes.labelsize": 9,
    "axes.linewidth": 0.7,
    "axes.spines.right": False,
    "axes.spines.top": False,
    "axes.titlecolor": INK,
    "axes.titlelocation": "left",
    "axes.titlesize": 9.5,
    "axes.titleweight": "bold",
    "figure.constrained_layout.use": True,
    "figure.facecolor": "none",
    "font.family": ["sans-serif"],
    "font.sans-serif": ["DejaVu Sans"],
    "font.size": 9,
    "grid.color": PALE,
    "grid.linewidth": 0.5,
    "legend.edgecolor": PALE,
    "legend.facecolor": "none",
    "legend.fontsize": 8,
    "legend.frameon": False,
    "lines.linewidth": 1.4,
    "savefig.facecolor": "none",
    "svg.fonttype": "none",
    "svg.hashsalt": "bayes_sensor",
    "text.color": INK,
    "text.parse_math": False,  # a name may hold dollar signs
    "xtick.color": MIDDLE,
    "xtick.labelcolor": INK,
    "xtick.labelsize": 8,
    "ytick.color": MIDDLE,
    "ytick.labelcolor": INK,
    "ytick.labelsize": 8,
}

METHOD_LABELS = {
    "crlb_iid": "Cramér-Rao, iid noise",
    "crlb_iid_one_percent_step": "the same, 1 % steps (published)",
    "crlb_ar1": "Cramér-Rao, AR(1) noise",
    "sandwich": "sandwich",
    "sandwich_ar1": "sandwich, AR(1) noise",
    "block_bootstrap": "block bootstrap",
    "jackknife_experiments": "jackknife, experiments",
    "profile": "profile likelihood",
    "posterior": "posterior",
}
SHARED_LABELS = {
    "tau_s": ("sensor τ", "ms", 1e3),
    "tau_v_s": ("valve τᵥ", "ms", 1e3),
    "V_mL": ("volume V", "mL", 1.0),
}
"""flat name to words, unit shown and the factor to it"""


def style() -> Any:
    """The context in which every figure is made and saved."""
    return mpl.rc_context(STYLE)  # type: ignore[arg-type]  # keys are checked when set


def _figure(height: float, width: float = WIDTH) -> Figure:
    return Figure(figsize=(width, height))


def _settle(figure: Figure) -> None:
    """Lay out once and round the places of the axes.

    The layout's solver is exact to rounding only, which would otherwise show in the bytes.
    """
    if figure.get_layout_engine() is None:
        return
    figure.draw_without_rendering()
    figure.set_layout_engine("none")
    for axes in figure.axes:
        left, bottom, width, height = (round(float(v), 5) for v in axes.get_position().bounds)
        axes.set_position((left, bottom, width, height))


def svg(figure: Figure) -> str:
    """The figure as the text of an SVG element, without date or XML header."""
    stream = io.StringIO()
    with style():
        _settle(figure)
        figure.savefig(stream, format="svg", metadata={"Date": None, "Creator": None})
    text = stream.getvalue()
    return text[text.index("<svg") :]


def png(figure: Figure, dpi: int = 160) -> bytes:
    """The figure as a PNG on white."""
    stream = io.BytesIO()
    with style():
        _settle(figure)
        figure.savefig(
            stream, format="png", dpi=dpi, facecolor="white", metadata={"Software": None}
        )
    return stream.getvalue()


def pdf(figure: Figure) -> bytes:
    """The figure as a PDF page, without a date."""
    stream = io.BytesIO()
    with style():
        _settle(figure)
        figure.savefig(stream, format="pdf", facecolor="white", metadata={"CreationDate": None})
    return stream.getvalue()


def _logarithmic(axes: Axes, which: str) -> None:
    """A logarithmic axis with plain numbers (10 rather than a power in mathematical type)."""
    axes.set(**{f"{which}scale": "log"})
    axis = axes.xaxis if which == "x" else axes.yaxis
    low, high = axis.get_view_interval()
    if high < 30 * low:
        axis.set_major_locator(LogLocator(subs=(1, 2, 3, 5, 7) if high < 5 * low else (1, 2, 5)))
    axis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
    axis.set_minor_formatter(NullFormatter())


def _volts(unit: str, size: float) -> tuple[str, float]:
    """Unit and factor that make values near ``size`` readable."""
    return ("mV", 1e3) if unit == "V" and size < 0.5 else (unit, 1.0)


def parameter_words(name: str, unit: str = "V") -> tuple[str, str, float]:
    """Symbol, unit shown and factor to it, of a flat parameter name.

    >>> parameter_words("t0_s[4]")
    ('t₀[4]', 's', 1.0)
    """
    if name in SHARED_LABELS:
        return SHARED_LABELS[name]
    kind, bracket, rest = name.partition("[")
    symbols = {
        "phi": "φ", "sigma0_V": "σ₀", "sigma1_V": "σ₁",
        "y0_V": "y₀", "beta_V": "β", "t0_s": "t₀", "tf_s": "t_f",
    }  # fmt: skip
    shown, factor = ("", 1.0) if kind == "phi" else ("s", 1.0) if kind.endswith("_s") else (unit, 1)
    if kind.startswith("sigma") and unit == "V":
        shown, factor = "mV", 1e3
    return symbols.get(kind, kind) + bracket + rest, shown, factor


def _axis_label(words: tuple[str, str, float]) -> str:
    return f"{words[0]} ({words[1]})" if words[1] else words[0]


# --------------------------------------------------------------------------- Fig. 5


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
    small, factor = _volts(unit, 3.0 * trace.rms)
    with style():
        figure = _figure(3.5)
        axes = figure.subplots(
            2,
            len(parts),
            sharex="col",
            sharey="row",
            height_ratios=[2.3, 1],
            width_ratios=[1.9] + [1] * (len(parts) - 1),
            squeeze=False,
        )
        for column, (title, piece, edge, commanded) in enumerate(parts):
            upper, lower = axes[:, column]
            upper.fill_between(piece.t, piece.low, piece.high, color=DATA, lw=0.8, label="measured")
            upper.plot(piece.t, piece.model, color=MODEL, lw=1.2, label="model")
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
                    label="± 2 s, noise law" if sign > 0 else None,
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


def _only(axes: Axes, labels: Sequence[str]) -> tuple[list[Any], list[str]]:
    handles, names = axes.get_legend_handles_labels()
    kept = [(h, n) for h, n in zip(handles, names, strict=True) if n in labels]
    return [h for h, _ in kept], [n for _, n in kept]


# --------------------------------------------------------------------------- Figs. 6 and 8


def histogram(residuals: Mapping[str, Any], rms: float) -> Figure:
    """Distribution of all residuals with the normal law of the same RMS (paper Fig. 6).

    ``residuals``: the content of ``residuals.json``; ``rms`` in V.
    """
    record = residuals["histogram"]
    unit = residuals.get("signal_unit", "V")
    edges, count = np.asarray(record["edges_V"]), np.asarray(record["count"], dtype=float)
    total, width = count.sum(), float(record["bin_V"])
    centre = 0.5 * (edges[1:] + edges[:-1])
    with style():
        figure = _figure(2.9, 5.2)
        axes = figure.subplots()
        axes.bar(
            centre, count, width=np.diff(edges), color=DATA, edgecolor=INK, lw=0.5,
            label=f"residuals ({total:.0f})",
        )  # fmt: skip
        x = np.linspace(edges[0], edges[-1], 300)
        normal = total * width / (rms * np.sqrt(2 * np.pi)) * np.exp(-0.5 * (x / rms) ** 2)
        axes.plot(x, normal, color=MODEL, ls="--", label="normal of the same RMS")
        axes.set_xlabel(f"residual ({unit}), bins of {width:g} {unit}")
        axes.set_ylabel("samples per bin")
        axes.ticklabel_format(axis="y", scilimits=(-3, 4), useMathText=False)
        axes.legend()
    return figure


def autocorrelation(residuals: Mapping[str, Any], traces: Sequence[Trace] = ()) -> Figure:
    """Autocorrelation of the residuals with the AR(1) curve, and the residuals (paper Fig. 8)."""
    acf = residuals["acf"]
    lag, value = np.asarray(acf["lag_s"]), np.asarray(acf["value"])
    curve, band = np.asarray(acf["ar1"]), residuals["white_band"]
    phi, h = residuals["ar1"]["phi"], residuals["ar1"].get("phi_interval_s", lag[1] - lag[0])
    settled = np.flatnonzero(np.abs(curve) < 0.01)
    near = lag[min(settled[0] if len(settled) else len(lag) - 1, len(lag) - 1)]
    near = float(min(max(4 * near, 30 * h), lag[-1]))
    with style():
        figure = _figure(5.0 if traces else 3.2)
        ratios = [1.7, 1] if traces else None
        panels = figure.subplot_mosaic("ab;cc" if traces else "ab", height_ratios=ratios)
        left, right = panels["a"], panels["b"]
        left.axhspan(-band, band, color=PALE, lw=0, label="95 % band, white")
        left.plot(lag, value, "o", color=BLUE, ms=2.6, label="residuals")
        left.plot(lag, curve, color=MODEL, ls="--", label=f"AR(1), φ = {phi:.3f}")
        left.set_xlim(-0.02 * near, near)
        left.set_ylim(min(-0.1, float(np.min(value)) - 0.05), 1.04)
        left.set_xlabel("lag (s)")
        left.set_ylabel("autocorrelation")
        left.legend(loc="upper right")
        left.set_title("short lags")
        right.axhspan(-band, band, color=PALE, lw=0)
        right.plot(lag[1:], value[1:], color=BLUE, lw=1.0)
        right.plot(lag[1:], curve[1:], color=MODEL, ls="--")
        _logarithmic(right, "x")
        right.set_xlabel("lag (s), logarithmic")
        right.set_title("all lags")
        if traces:
            _joined_residuals(panels["c"], traces)
    return figure


def _joined_residuals(axes: Axes, traces: Sequence[Trace]) -> None:
    """The residuals of all experiments in a row, shades alternating (the paper's inset)."""
    unit, factor = _volts(traces[0].signal_unit, 3 * max(trace.rms for trace in traces))
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
    axes.set_xlim(0.0, start)
    axes.set_xlabel("time, experiments joined (s)")
    axes.set_ylabel(f"residual ({unit})")
    axes.set_title("residuals")


def spread(residuals: Mapping[str, Any]) -> Figure:
    """Standard deviation of the residuals against test-gas concentration, with the noise law."""
    record = residuals["variance_vs_concentration"]
    unit = residuals.get("signal_unit", "V")
    low, high = (100 * np.asarray(record[f"concentration_{end}"]) for end in ("low", "high"))
    sd, law = (
        np.array([np.nan if v is None else v for v in record[key]]) for key in ("sd_V", "law_sd_V")
    )
    shown, factor = _volts(unit, float(np.nanmax(sd)))
    centre, kept = 0.5 * (low + high), np.isfinite(sd)
    with style():
        figure = _figure(2.9, 5.2)
        axes = figure.subplots()
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


# --------------------------------------------------------------------------- Fig. 7


def delays(record: Mapping[str, Any], concentration: Mapping[str, float]) -> Figure:
    """Delay of start and end against 1/Q with line, prediction band and outliers (paper Fig. 7).

    ``record``: the content of ``delays.json``; ``concentration`` (0..1) by experiment.
    """
    sides = [(k, record[k]) for k in ("start", "end") if record.get(k) and record[k]["points"]]
    levels = sorted({round(100 * c, 1) for c in concentration.values()})
    crowded = 4 < len(levels) <= len(MARKERS)
    with style():
        figure = _figure(3.3, WIDTH if len(sides) > 1 or crowded else 4.4)
        row = figure.subplots(1, max(len(sides), 1), squeeze=False)[0]
        for axes, (side, line) in zip(row, sides, strict=False):
            if line["band"]:
                x = np.asarray(line["band"]["inverse_flow_s_per_L"])
                lo, hi = line["band"]["lo95_s"], line["band"]["hi95_s"]
                axes.fill_between(x, lo, hi, color=PALE, lw=0, label="95 % prediction")
                axes.plot(x, line["band"]["fit_s"], color=MODEL, ls="--", label="line")
            many = len(levels) > len(MARKERS)
            for point in line["points"]:
                level = round(100 * concentration.get(point["experiment"], np.nan), 1)
                index = levels.index(level) if level in levels else 0
                marker = "o" if many else MARKERS[index % len(MARKERS)]
                used = point["used"]
                axes.plot(
                    point["inverse_flow_s_per_L"],
                    point["delay_s"],
                    marker,
                    ms=6,
                    mfc=BLUE if used else "none",
                    mec=INK if used else ORANGE,
                    mew=0.6 if used else 1.8,
                )
                if not used:
                    axes.annotate(
                        f"{point['experiment']}, outlier",
                        (point["inverse_flow_s_per_L"], point["delay_s"]),
                        xytext=(7, -3),
                        textcoords="offset points",
                        fontsize=8,
                        color=ORANGE,
                    )
            for marker, level in zip(MARKERS, [] if many else levels, strict=False):
                axes.plot(
                    [], [], marker, ms=6, mfc=BLUE, mec=INK, mew=0.6, label=f"{level:g} % test gas"
                )
            if (line["band"] or not many) and not crowded:
                axes.legend(loc="best", fontsize=7)
            axes.margins(0.08)
            axes.set_xlabel("1/Q (s/L)")
            axes.set_ylabel(f"{side} delay (s)")
            if crowded and axes is row[0]:
                handles, labels = axes.get_legend_handles_labels()
                figure.legend(handles, labels, loc="outside right upper")
            r2 = "" if line["r2"] is None else f", R² = {line['r2']:.3f}"
            axes.set_title(f"{side} of the step{r2}")
    return figure


# --------------------------------------------------------------------------- posterior


def main_parameters(names: Sequence[str]) -> list[str]:
    """Those of tau, tau_v, V, sigma0, sigma1, phi that are among ``names``."""
    wanted = ("tau_s", "tau_v_s", "V_mL", "sigma0_V", "sigma1_V", "phi")
    return [name for name in wanted if name in names]


def _chosen(
    names: Sequence[str], chains: FloatArray, unit: str
) -> tuple[list[tuple[str, str, float]], FloatArray]:
    """Words and scaled chains (n_chain, n_draw, n) of the main parameters that vary."""
    kept = [n for n in main_parameters(names) if np.ptp(chains[:, :, names.index(n)]) > 0]
    words = [parameter_words(n, unit) for n in kept]
    columns = [chains[:, :, names.index(n)] * w[2] for n, w in zip(kept, words, strict=True)]
    return words, np.stack(columns, axis=-1)


def corner(names: Sequence[str], chains: FloatArray, unit: str = "V") -> Figure:
    """Joint posterior of the shared parameters: 39, 68 and 95 % regions, 95 % intervals dashed.

    ``chains`` (n_chain, n_draw, n_theta) in the order of ``names``.
    """
    import corner as corner_plot

    words, values = _chosen(list(names), chains, unit)
    draws = values.reshape(-1, values.shape[-1])
    draws = draws[:: max(1, len(draws) // 20000)]
    n = len(words)
    with style(), mpl.rc_context({"figure.constrained_layout.use": False}):
        figure = Figure(figsize=(1.2 * n + 0.4, 1.2 * n + 0.4))
        corner_plot.corner(
            draws,
            fig=figure,
            labels=[_axis_label(w) for w in words],
            label_kwargs={"fontsize": 8},
            labelpad=0.12,
            bins=40,
            smooth=1.1,
            quantiles=(0.025, 0.5, 0.975),
            levels=(0.393, 0.68, 0.95),
            plot_datapoints=False,
            plot_density=False,
            fill_contours=True,
            max_n_ticks=4,
            color=BLUE,
            contour_kwargs={"colors": [BLUE], "linewidths": 0.9},
            contourf_kwargs={"colors": ["none", *REGIONS]},
            hist_kwargs={"color": INK, "linewidth": 1.0},
        )
        for axes in figure.axes:
            axes.grid(False)
            axes.tick_params(labelsize=6.5)
        figure.subplots_adjust(left=0.11, bottom=0.11, right=0.99, top=0.98)
    return figure


def traces_and_ranks(names: Sequence[str], chains: FloatArray, unit: str = "V") -> Figure:
    """Chains and the ranks of their draws: when they agree, every rank is as frequent.

    The grey band holds 95 % of the bars of independent draws.
    """
    from scipy.stats import rankdata

    words, values = _chosen(list(names), chains, unit)
    n_chain, n_draw, n = values.shape
    every = max(1, n_draw // 400)
    dashes = ("-", (0, (3, 1)), (0, (1, 1)), (0, (5, 1, 1, 1)))
    colours = (BLUE, ORANGE, GREEN, INK)
    bins = 20
    with style():
        figure = _figure(1.25 * n + 0.4)
        grid = figure.subplots(n, 2, squeeze=False, width_ratios=[1.7, 1])
        for row, word in enumerate(words):
            left, right = grid[row]
            ranks = rankdata(values[:, :, row]).reshape(n_chain, n_draw)
            expected = n_draw / bins
            half = 1.96 * np.sqrt(expected * (1 - 1 / bins))
            right.axhspan(expected - half, expected + half, color=PALE, lw=0)
            for j in range(n_chain):
                kind: Any = dashes[j % len(dashes)]
                colour = colours[j % len(colours)]
                left.plot(
                    np.arange(0, n_draw, every),
                    values[j, ::every, row],
                    color=colour,
                    lw=0.4,
                    label=f"chain {j + 1}",
                )
                count, edges = np.histogram(ranks[j], bins, (0, n_chain * n_draw))
                right.stairs(count, edges, color=colour, lw=1.0, ls=kind, baseline=None)
            left.set_ylabel(_axis_label(word))
            right.set_ylim(0, None)
            right.set_ylabel("draws")
            left.margins(x=0)
            for axes in (left, right):
                axes.yaxis.set_major_locator(MaxNLocator(4))
                if row < n - 1:
                    axes.set_xticklabels([])
        grid[0, 0].set_title("chains")
        grid[0, 1].set_title("ranks, by chain")
        grid[-1, 0].set_xlabel("draw (walkers end to end)")
        grid[-1, 1].set_xlabel("rank among all draws")
    return figure


# --------------------------------------------------------------------------- bounds


def intervals(bounds: Mapping[str, Any], truth: Mapping[str, float] | None = None) -> Figure:
    """Every bound method side by side for tau, tau_v, V: 68 % thick, 95 % thin.

    ``bounds``: the content of ``bounds.json``; ``truth`` by flat name draws a line.
    """
    methods = list(bounds["methods"])
    with style():
        figure = _figure(0.32 * len(methods) + 1.0)
        row = figure.subplots(1, 3, sharey=True)
        for axes, (name, (symbol, unit, factor)) in zip(row, SHARED_LABELS.items(), strict=True):
            rows = [bounds["methods"][m]["parameters"].get(name) or {} for m in methods]
            low, high = _visible(rows, factor)
            for i, method in enumerate(methods):
                entry = bounds["methods"][method]["parameters"].get(name)
                if not entry:
                    axes.annotate(
                        "no value", (0.5, i), xycoords=("axes fraction", "data"), ha="center",
                        va="center", fontsize=7, color=MIDDLE,
                    )  # fmt: skip
                    continue
                colour = _method_colour(method)
                marker = {"posterior": "D"}.get(method, "o")
                for lo, hi, width in (("lo95", "hi95", 1.4), ("lo68", "hi68", 4.2)):
                    a, b = (
                        end if entry[key] is None else factor * entry[key]
                        for key, end in ((lo, -np.inf), (hi, np.inf))
                    )  # fmt: skip
                    shown = [float(np.clip(v, low, high)) for v in (a, b)]
                    axes.plot(shown, [i, i], color=colour, lw=width, solid_capstyle="butt")
                    for end, edge, arrow in ((a < low, low, "<"), (b > high, high, ">")):
                        if end:  # goes on outside the picture
                            axes.plot(edge, i, arrow, color=colour, ms=5, clip_on=False)
                if entry["estimate"] is not None and low <= factor * entry["estimate"] <= high:
                    axes.plot(
                        factor * entry["estimate"], i, marker, color=GROUND, mec=colour, ms=4.5,
                        mew=1.2,
                    )  # fmt: skip
            if truth and name in truth:
                axes.axvline(factor * truth[name], color=GREEN, ls="--", lw=1)
            axes.set_xlim(low, high)
            axes.set_xlabel(f"{symbol} ({unit})")
            axes.grid(axis="y", visible=False)
            axes.xaxis.set_major_locator(MaxNLocator(4))
        row[0].set_yticks(range(len(methods)), [METHOD_LABELS.get(m, m) for m in methods])
        row[0].set_ylim(len(methods) - 0.4, -0.6)
        if row[0].get_xlim()[0] < 0:
            row[0].axvline(0.0, color=MIDDLE, lw=0.8)  # tau cannot be negative
    return figure


def _visible(rows: Sequence[Mapping[str, Any]], factor: float) -> tuple[float, float]:
    """The range shown: every 95 % interval, but none so wide that the others vanish."""
    ends = [
        (factor * row["lo95"], factor * row["hi95"])
        for row in rows
        if row and row["lo95"] is not None and row["hi95"] is not None
    ]
    if not ends:
        return 0.0, 1.0
    widths = sorted(b - a for a, b in ends)
    most = 4.0 * max(widths[len(widths) // 2], 1e-12)
    kept = [pair for pair in ends if pair[1] - pair[0] <= most] or ends
    low, high = min(a for a, _ in kept), max(b for _, b in kept)
    margin = 0.05 * (high - low) or 1.0
    return low - margin, high + margin


def _method_colour(method: str) -> str:
    if method.startswith("crlb_iid"):
        return ORANGE
    return BLUE if method == "posterior" else INK


def step_study(
    rows: Sequence[Mapping[str, Any]], published: Mapping[str, float] | None = None
) -> Figure:
    """Bound of tau, tau_v, V against the relative step of the finite difference (log-log).

    ``rows``: the table of :func:`bayes_sensor.bounds.step_study` as records; ``published``: three
    standard deviations by flat name, drawn as squares at 1 %.
    """
    lines = (
        ("euler", "forward", "Euler, forward", ORANGE, "-", "o"),
        ("euler", "central", "Euler, central", ORANGE, "--", "s"),
        ("exact", "forward", "exact, forward", BLUE, "-", "^"),
        ("exact", "central", "exact, central", INK, "--", "v"),
    )
    with style():
        figure = _figure(3.0)
        row = figure.subplots(1, 3)
        for axes, (name, (symbol, unit, factor)) in zip(row, SHARED_LABELS.items(), strict=True):
            for method, difference, label, colour, dash, marker in lines:
                chosen = [
                    r for r in rows
                    if r["method"] == method and r["difference"] == difference
                    and r[name] is not None and np.isfinite(r[name])
                ]  # fmt: skip
                x = np.array([r["step"] for r in chosen])
                y = np.array([3 * factor * r[name] for r in chosen])
                known = np.array([bool(r.get("identified", True)) for r in chosen], dtype=bool)
                axes.plot(x, y, color=colour, ls=dash, lw=1.1, label=label)
                axes.plot(x[known], y[known], marker, color=colour, ms=3.5)
                axes.plot(x[~known], y[~known], marker, mfc="none", mec=colour, ms=3.5)
            if published and name in published:
                axes.plot(
                    0.01, factor * published[name], "*", color=GREEN, ms=11, mec=INK, mew=0.6,
                    label="published", ls="none",
                )  # fmt: skip
            _logarithmic(axes, "x")
            _logarithmic(axes, "y")
            axes.set_xlabel("relative step")
            axes.set_ylabel(f"3 sd of {symbol} ({unit})")
        handles, names = row[0].get_legend_handles_labels()
        figure.legend(handles, names, loc="outside lower center", ncols=5)
    return figure


def rms_bars(traces: Sequence[Trace]) -> Figure:
    """RMS residual of every experiment beside what the noise law alone would leave."""
    unit, factor = _volts(traces[0].signal_unit, max(trace.rms for trace in traces))
    names = [trace.name for trace in traces]
    rms = [factor * trace.rms for trace in traces]
    law = [factor * float(np.sqrt(np.mean(trace.whole.sd**2))) for trace in traces]
    place = np.arange(len(traces))
    with style():
        figure = _figure(2.6 if len(traces) < 12 else 3.2)
        axes = figure.subplots()
        axes.bar(place, rms, 0.62, color=DATA, edgecolor=INK, lw=0.5, label="RMS residual")
        axes.plot(place, law, "_", color=MODEL, ms=14, mew=2, label="noise law")
        long = len(traces) > 12 or max(len(n) for n in names) > 8
        labels = [n if len(n) <= 18 else n[:17] + "…" for n in names]
        axes.set_xticks(place, labels, rotation=90 if long else 0, fontsize=7 if long else 8)
        axes.set_xlabel("experiment")
        axes.set_ylabel(f"RMS ({unit})")
        axes.grid(axis="x", visible=False)
        figure.legend(loc="outside upper right", ncols=2)
    return figure


# --------------------------------------------------------------------------- coating


def diffusion(record: Mapping[str, Any]) -> Figure:
    """Response of the coating at the probe (paper Fig. 9b) with the times to 63.2 and 90 %.

    ``record``: the content of ``diffusion.json``.
    """
    t, x = np.asarray(record["probe"]["t_ms"]), np.asarray(record["probe"]["response"])
    end = 1.6 * record["t90_ms"]
    lag = record["tau_fit_ms"]
    with style():
        figure = _figure(3.0, 5.2)
        axes = figure.subplots()
        axes.plot(t, 100 * x, color=BLUE, label="finite elements")
        s = np.linspace(0.0, end, 300)
        axes.plot(
            s, 100 * (1 - np.exp(-s / lag)), color=MODEL, ls="--",
            label=f"nearest single lag, {lag:.3g} ms",
        )  # fmt: skip
        for level, key in ((63.2, "tau63_ms"), (90.0, "t90_ms")):
            axes.plot([record[key]], [level], "o", color=INK, ms=4)
            axes.annotate(
                f"{level:g} % after {record[key]:.3g} ms", (record[key], level),
                xytext=(6, -10), textcoords="offset points", fontsize=8,
            )  # fmt: skip
        axes.set_xlim(0, end)
        axes.set_xlabel("time (ms)")
        axes.set_ylabel("concentration at the probe (%)")
        axes.legend(loc="lower right")
    return figure
