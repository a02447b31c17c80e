"""One look for the figures of the studies: small, readable in grey, every axis labelled."""

from __future__ import annotations

from pathlib import Path

import matplotlib

matplotlib.use("Agg")

import matplotlib.pyplot as plt

from bayes_sensor.figures import WIDTH as PRINTED

PAPER = Path(__file__).resolve().parent.parent
TABLES, FIGURES = PAPER / "tables", PAPER / "figures"
WIDTH = PRINTED
"""inches, as wide as the text of the manuscript: a point in a figure is a point in print"""

INK, SHADE, ACCENT = "0.1", "0.82", "#0b5394"
plt.rcParams.update(
    {
        "font.size": 8,
        "axes.labelsize": 8,
        "axes.titlesize": 8,
        "xtick.labelsize": 7.5,
        "ytick.labelsize": 7.5,
        "legend.fontsize": 7.5,
        "legend.frameon": False,
        "axes.spines.top": False,
        "axes.spines.right": False,
        "axes.linewidth": 0.6,
        "lines.linewidth": 1.0,
        "lines.markersize": 3.0,
        "figure.dpi": 100,
        "savefig.dpi": 200,
        "svg.hashsalt": "bayes_sensor",
        "text.hinting": "none",  # hinted letters are narrower than those of a vector drawing
    }
)


def label(name: str) -> str:
    """A flat parameter name as a reader writes it: ``t0_s[1]`` to t0, exp. 1."""
    symbols = {
        "tau_s": r"$\tau$", "tau_v_s": r"$\tau_v$", "V_mL": r"$V$", "phi": r"$\varphi$",
        "sigma0_V": r"$\sigma_0$", "sigma1_V": r"$\sigma_1$", "y0_V": r"$y_0$",
        "beta_V": r"$\beta$", "t0_s": r"$t_0$", "tf_s": r"$t_f$",
    }  # fmt: skip
    kind, bracket, rest = name.partition("[")
    return symbols.get(kind, kind) + (f", exp. {rest[:-1]}" if bracket else "")


def save(figure: plt.Figure, name: str) -> None:
    """Write figures/name.png and .svg, the same bytes for the same figure."""
    FIGURES.mkdir(parents=True, exist_ok=True)
    figure.savefig(FIGURES / f"{name}.png", metadata={"Software": None})
    figure.savefig(FIGURES / f"{name}.svg", metadata={"Date": None})
    plt.close(figure)
