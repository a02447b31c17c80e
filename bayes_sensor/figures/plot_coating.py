"""Figures of the coating and the readout: diffusion to the ring (paper Fig. 9), spectra (Fig. 3).

Lines differ by dash and marker, maps by lightness.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.colors import LinearSegmentedColormap
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator

from bayes_sensor.campaign import FloatArray
from bayes_sensor.figures.colours import (
    BLUE,
    GREEN,
    INK,
    MARKERS,
    MIDDLE,
    MODEL,
    ORANGE,
    PALE,
    REGIONS,
)
from bayes_sensor.figures.labels import plain
from bayes_sensor.figures.style import WIDTH, panels, style

if TYPE_CHECKING:  # both compile or load much that other figures do without
    from bayes_sensor.coating import Response
    from bayes_sensor.coating.readout import Readout

_DASHES: tuple[Any, ...] = ("-", (0, (6, 2)), (0, (3, 1.5)), (0, (6, 1.5, 1, 1.5)), (0, (1, 1.2)))
_LEVELS = np.linspace(0.0, 1.0, 11)
UPTAKE_MAP = LinearSegmentedColormap.from_list("uptake", ["#ffffff", *REGIONS, BLUE, "#00334f"])
_MARK: dict[str, Any] = {"mec": "white", "mew": 0.6, "ms": 6, "zorder": 4}
_HALO = {"facecolor": "white", "edgecolor": "none", "pad": 1.0, "alpha": 0.8}


# --------------------------------------------------------------------------- Fig. 9


def diffusion_figure(response: Response, other: Response | None = None) -> Figure:
    """Concentration in the cross-section at the snapshot times, and the responses at the probe.

    Above, the mesh on the concentration map of ``response``, with the interface and the probe;
    below, the response curves with the time to 63.2 %, and the single lag closest to the first.
    ``other``: a second coating for comparison, such as the one with the lowered diffusivity.
    """
    n = len(response.snapshot_times)
    if n == 0:
        raise ValueError("diffusion_figure: the response holds no snapshots to draw")
    columns = min(n, 4)
    rows = math.ceil(n / columns)
    with style():
        figure = Figure(figsize=(WIDTH, 2.9 + 1.35 * rows), layout="constrained")
        parts: Any = figure.subfigures(2, 1, height_ratios=[1.35 * rows, 2.9])
        above, below = parts
        maps = above.subplots(rows, columns, sharex=True, sharey=True, squeeze=False)
        for panel in maps.ravel()[n:]:
            panel.set_visible(False)
        shown = list(maps.ravel()[:n])
        for panel, t, concentration in zip(
            shown, response.snapshot_times, response.snapshots, strict=True
        ):
            filled = _cross_section(panel, response, concentration)
            panel.set_title(f"{1e3 * t:.3g} ms")
        across = "radius" if response.coating.geometry == "axisymmetric" else "distance"
        for panel in maps[-1]:
            panel.set_xlabel(f"{across} (µm)")
        for panel in maps[:, 0]:
            panel.set_ylabel("height (µm)")
        bar = above.colorbar(filled, ax=shown, ticks=_LEVELS[::5], pad=0.01, aspect=12)
        bar.set_label("CO₂ (%)")
        bar.set_ticklabels(["0", "50", "100"])
        bar.outline.set_visible(False)
        _curves(below.subplots(), response, other)
    return figure


def _cross_section(axes: Axes, response: Response, concentration: FloatArray) -> Any:
    """Map, mesh, interface and probe of one snapshot."""
    coating = response.coating
    r, z = 1e6 * response.r, 1e6 * response.z
    filled = axes.contourf(r, z, concentration, levels=_LEVELS, cmap=UPTAKE_MAP)
    axes.vlines(r, z[0], z[-1], color=MIDDLE, lw=0.2)
    axes.hlines(z, r[0], r[-1], color=MIDDLE, lw=0.2)
    axes.axhline(1e6 * coating.thickness_zif8, color=INK, lw=0.9)
    probe = 1e6 * coating.ring_radius if math.isfinite(coating.outer_radius) else 0.0
    axes.plot(
        probe, 1e6 * coating.probe_height, "o", ms=5, mfc=ORANGE, mec="white", mew=0.8,
        clip_on=False, zorder=5,
    )  # fmt: skip
    axes.set(xlim=(r[0], r[-1]), ylim=(z[0], z[-1]), aspect="equal")
    axes.grid(False)
    return filled


def _curves(axes: Axes, response: Response, other: Response | None) -> None:
    """Response at the probe against time; 63.2 % and the time to it."""
    from bayes_sensor.coating import LEVEL_63

    both = [response] if other is None else [response, other]
    end = 1.35 * max(each.t90 for each in both)
    t = np.linspace(0.0, end, 600)
    axes.axhline(100 * LEVEL_63, color=MIDDLE, lw=0.8, ls=":")
    axes.text(
        1e3 * end, 100 * LEVEL_63 - 1.5, "63.2 %", ha="right", va="top", fontsize=8, color=INK
    )
    for each, colour, dash, marker in zip(both, (BLUE, MODEL), _DASHES, MARKERS, strict=False):
        words = f"D(ZIF-8) = {plain(each.coating.d_zif8)} m²/s"
        axes.plot(1e3 * t, 100 * each.step(t), color=colour, ls=dash, label=words)
        tau = 1e3 * each.tau63
        axes.plot([tau, tau], [0.0, 100 * LEVEL_63], color=colour, lw=0.8, ls=":")
        axes.plot(tau, 100 * LEVEL_63, marker, color=colour, ms=6)
        axes.annotate(
            f"{tau:.3g} ms",
            (tau, 3.0),
            xytext=(4, 0),
            textcoords="offset points",
            color=colour,
            fontsize=8.5,
            bbox=_HALO,
        )
    lag = 100 * (1 - np.exp(-t / both[-1].tau_fit))
    axes.plot(
        1e3 * t,
        lag,
        color=INK,
        lw=0.8,
        ls=_DASHES[3],
        label=f"single lag of {1e3 * both[-1].tau_fit:.3g} ms",
    )
    axes.set(xlim=(0.0, 1e3 * end), ylim=(0.0, 103.0))
    axes.set(xlabel="time after the step (ms)", ylabel="CO₂ at the probe (%)")
    axes.legend(loc="center right", bbox_to_anchor=(1.0, 0.33))


def diffusion(record: Mapping[str, Any]) -> Figure:
    """Response of the coating at the probe (paper Fig. 9b) with the times to 63.2 and 90 %.

    ``record``: the content of ``diffusion.json``.
    """
    t, x = np.asarray(record["probe"]["t_ms"]), np.asarray(record["probe"]["response"])
    end = 1.6 * record["t90_ms"]
    lag = record["tau_fit_ms"]
    with style():
        figure, ((axes,),) = panels(3.0, width=5.2, top=0.1)
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
        axes.set(xlim=(0, end), xlabel="time (ms)", ylabel="concentration at the probe (%)")
        axes.legend(loc="lower right")
    return figure


# --------------------------------------------------------------------------- Fig. 3


def spectra_figure(
    readout: Readout,
    concentrations: Sequence[float] = (0.0, 1 / 9, 1 / 7, 1 / 6),
    wanted: float = 0.01,
) -> Figure:
    """Transmission spectra at several test-gas fractions, and voltage against concentration.

    The excitation wavelength is marked in the spectra.  On the right the range around the steepest
    point whose end-point nonlinearity is at most ``wanted`` is shaded; it is left out if the laser
    is beyond that point without gas.
    """
    levels = np.array(concentrations, dtype=float)
    if levels.size == 0 or not (np.isfinite(levels).all() and (levels >= 0).all()):
        raise ValueError(
            "spectra_figure: expected at least one concentration, a fraction of zero or more"
        )
    with style():
        figure = Figure(figsize=(WIDTH, 3.0), layout="constrained")
        left, right = figure.subplots(1, 2, width_ratios=[1.25, 1])
        _spectra(left, readout, levels)
        _transfer(right, readout, levels, wanted)
    return figure


def _looks(n: int) -> list[tuple[Any, Any, str]]:
    """Colour, dash and marker of each of n lines: light to dark."""
    shades = [UPTAKE_MAP(x) for x in np.linspace(0.45, 1.0, n)] if n > 1 else [INK]
    return [(c, _DASHES[i % 5], MARKERS[i % 8]) for i, c in enumerate(shades)]


def _spectra(axes: Axes, readout: Readout, levels: FloatArray) -> None:
    width = readout.ring.width
    shift = 100 * levels.max() * readout.cladding.redshift_per_percent
    low = min(readout.wavelength, readout.ring.resonance) - 1.3 * width
    high = readout.ring.resonance + shift + 1.3 * width
    wavelength = np.linspace(low, high, 801)
    axes.axvline(
        1e9 * readout.wavelength, 0.0, 0.8, color=ORANGE, lw=1.1, ls="--"
    )  # below the legend
    for c, (colour, dash, marker) in zip(levels, _looks(len(levels)), strict=True):
        volts = readout.spectrum(wavelength, float(c))
        axes.plot(1e9 * wavelength, volts, color=colour, ls=dash, lw=1.2)
        at = float(readout.voltage(float(c)))
        axes.plot(1e9 * readout.wavelength, at, marker, color=colour, **_MARK)
        axes.plot([], [], color=colour, ls=dash, marker=marker, ms=4.5, label=f"{100 * c:.3g} %")
    axes.annotate(
        f"laser\n{1e9 * readout.wavelength:.3f} nm",
        (1e9 * readout.wavelength, 0.02),
        xycoords=("data", "axes fraction"),
        xytext=(-5, 0),
        textcoords="offset points",
        ha="right",
        fontsize=8,
        color=ORANGE,
    )
    axes.set(xlim=(1e9 * low, 1e9 * high), ylim=(0.0, 1.3 * readout.full_scale))
    axes.set(xlabel="wavelength (nm)", ylabel="photoreceiver (V)", title="spectra")
    axes.xaxis.set_major_locator(MaxNLocator(4))
    axes.legend(title="CO₂", ncols=4, loc="upper center", columnspacing=1.0, handlelength=2.2)


def _transfer(axes: Axes, readout: Readout, levels: FloatArray, wanted: float) -> None:
    from bayes_sensor.coating.readout import linear_range

    try:
        linear = linear_range(readout, wanted)
    except ValueError:
        linear = None
    top = max(levels.max(), 0.0 if linear is None else linear.high)
    c = np.linspace(0.0, 1.15 * top if top > 0 else 0.2, 401)
    if linear is not None:
        axes.axvspan(
            100 * linear.low,
            100 * linear.high,
            color=PALE,
            alpha=0.6,
            lw=0,
            label=f"linear within {100 * wanted:g} %",
        )
        ends = np.array([linear.low, linear.high])
        start = float(readout.voltage(linear.low))
        reach = 0.5 * (linear.high - linear.low)
        wide = np.array([max(ends[0] - reach, 0.0), ends[1] + reach])
        axes.plot(
            100 * wide,
            start + linear.slope * (wide - linear.low),
            color=GREEN,
            lw=1.0,
            ls="--",
            label=f"{linear.slope / 100:.3g} V per % CO₂",
        )
    axes.plot(100 * c, readout.voltage(c), color=INK)
    for level, (colour, _, marker) in zip(levels, _looks(len(levels)), strict=True):
        at = float(readout.voltage(float(level)))
        axes.plot(100 * level, at, marker, color=colour, clip_on=False, **_MARK)
    axes.set(xlim=(0.0, 100 * c[-1]), ylim=(0.0, None), title="at the laser's wavelength")
    axes.set(xlabel="CO₂ in the test gas mixture (%)", ylabel="photoreceiver (V)")
    if linear is not None:
        axes.legend(loc="lower right")
