"""Draws of the posterior: joint regions, chains and ranks."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from matplotlib.figure import Figure
from matplotlib.ticker import FixedLocator, MaxNLocator

from bayes_sensor.campaign import FloatArray
from bayes_sensor.figures.colours import BLUE, GREEN, INK, ORANGE, PALE, REGIONS
from bayes_sensor.figures.labels import axis_label, parameter_words, shared_labels, told_apart
from bayes_sensor.figures.style import SMALLEST, WIDTH, Drawing, panels, style


def main_parameters(names: Sequence[str]) -> list[str]:
    """Those of tau, tau_v, V, sigma0, sigma1, phi that are among ``names``.

    Lags that cannot be assigned are named by size.
    """
    known = told_apart(names)
    noise = [name for name in known if name.split("[")[0] in ("sigma0_V", "sigma1_V", "phi")]
    return [*shared_labels(known), *noise]


def _chosen(
    names: Sequence[str], chains: FloatArray, unit: str
) -> tuple[list[tuple[str, str, float]], FloatArray]:
    """Words and scaled chains (n_chain, n_draw, n) of the main parameters that vary; of those that
    are tied the first alone, as the others are multiples of it."""
    kept: list[str] = []
    for name in main_parameters(names):
        values, others = chains[:, :, names.index(name)], [names.index(other) for other in kept]
        if np.ptp(values) > 0 and not any(_in_proportion(values, chains[:, :, i]) for i in others):
            kept.append(name)
    words = [parameter_words(n, unit) for n in kept]
    columns = [chains[:, :, names.index(n)] * w[2] for n, w in zip(kept, words, strict=True)]
    return words, np.stack(columns, axis=-1)


def _in_proportion(values: FloatArray, others: FloatArray) -> bool:
    return bool(np.allclose(values * others.flat[0], others * values.flat[0], rtol=1e-9, atol=0.0))


def named_chains(posterior: Any) -> tuple[list[str], FloatArray]:
    """Flat names and chains (n_chain, n_draw, n) of a posterior's varying parameters, by name."""
    shape, names = posterior.chains.shape[:2], list(posterior.rows)
    return names, np.stack([posterior.of(name).reshape(shape) for name in names], axis=-1)


def corner(names: Sequence[str], chains: FloatArray, unit: str = "V") -> Figure:
    """Joint posterior of the shared parameters: 39, 68 and 95 % regions, 95 % intervals dashed.

    ``chains`` (n_chain, n_draw, n_theta) in the order of ``names``.
    """
    from bayes_sensor.posterior.inference_data import import_quietly  # slow to import

    corner_plot = import_quietly("corner")
    words, values = _chosen(names, chains, unit)
    draws = values.reshape(-1, values.shape[-1])
    draws = draws[:: max(1, len(draws) // 20000)]
    n = len(words)
    with style():
        side = min(WIDTH, 1.3 * n + 0.9)
        figure = Drawing(figsize=(side, side))
        corner_plot.corner(
            draws,
            fig=figure,
            labels=[axis_label(w) for w in words],
            bins=40,
            smooth=1.1,
            quantiles=(0.025, 0.5, 0.975),
            levels=(0.393, 0.68, 0.95),
            plot_datapoints=False,
            plot_density=False,
            fill_contours=True,
            color=BLUE,
            contour_kwargs={"colors": [BLUE], "linewidths": 0.9},
            contourf_kwargs={"colors": ["none", *REGIONS]},
            hist_kwargs={"color": INK, "linewidth": 1.0},
        )
        for axes in figure.axes:
            axes.grid(False)
            axes.tick_params(labelsize=SMALLEST, rotation=0)
            for axis in (axes.xaxis, axes.yaxis):
                if isinstance(axis.get_major_locator(), MaxNLocator):
                    axis.set_major_locator(FixedLocator(_two_ticks(*axis.get_view_interval())))
        left, bottom, right, top = 0.72 / side, 0.5 / side, 0.98, 0.99
        figure.subplots_adjust(left=left, bottom=bottom, right=right, top=top)
        panel = side * (right - left) / (n + 0.05 * (n - 1))  # inches
        for axes in figure.axes:
            axes.xaxis.set_label_coords(0.5, -0.27 / panel)
            axes.yaxis.set_label_coords(-0.5 / panel, 0.5)
    return figure


def _two_ticks(low: float, high: float) -> list[float]:
    """Two round values well inside a range, so that labels of neighbouring panels stay apart."""
    margin = 0.16 * (high - low)
    inside: FloatArray = np.empty(0)
    for n in range(3, 9):
        ticks = np.asarray(MaxNLocator(n, steps=[1, 2, 2.5, 5, 10]).tick_values(low, high))
        inside = ticks[(ticks > low + margin) & (ticks < high - margin)]
        if len(inside) > 1:
            break
    return [float(tick) for tick in (inside[[0, -1]] if len(inside) > 1 else inside)]


def traces_and_ranks(names: Sequence[str], chains: FloatArray, unit: str = "V") -> Figure:
    """Chains and the ranks of their draws: if they agree, all ranks are equally frequent.

    ``chains`` (n_chain, n_draw, n_theta) in the order of ``names``.  The grey band holds 95 % of
    the bars of independent draws.
    """
    from scipy.stats import rankdata

    words, values = _chosen(names, chains, unit)
    n_chain, n_draw, n = values.shape
    every = max(1, n_draw // 400)
    dashes = ("-", (0, (3, 1)), (0, (1, 1)), (0, (5, 1, 1, 1)))
    colours = (BLUE, ORANGE, GREEN, INK)
    bins = 20
    with style():
        figure, grid = panels(1.25 * n + 0.6, n, 2, down=0.15, width_ratios=[1.7, 1])
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
            left.set_ylabel(axis_label(word))
            right.set(ylim=(0, None), ylabel="draws")
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
