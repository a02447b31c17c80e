"""Every figure of the report and the paper, in one style: result records in, a Figure out.

One file per subject; everything that a caller needs is here under its own name.
"""

from bayes_sensor.figures.plot_chain import Stage, chain
from bayes_sensor.figures.plot_coating import (
    diffusion,
    diffusion_figure,
    spectra_figure,
)
from bayes_sensor.figures.plot_delays import delays
from bayes_sensor.figures.plot_draws import corner, main_parameters, traces_and_ranks
from bayes_sensor.figures.plot_fleet import forest
from bayes_sensor.figures.plot_gap import (
    effect_words,
    gap_hidden,
    gap_residuals,
    gap_where,
    gap_which,
)
from bayes_sensor.figures.plot_methods import intervals, step_study
from bayes_sensor.figures.plot_noise import autocorrelation, histogram, predictive, spread
from bayes_sensor.figures.plot_overlays import overlay
from bayes_sensor.figures.plot_rig import responses, schematic
from bayes_sensor.figures.plot_tau import coverage, tau_hard, what_would_help
from bayes_sensor.figures.style import (
    BLUE,
    COLOURS,
    DATA,
    GREEN,
    GROUND,
    INK,
    MARKERS,
    MIDDLE,
    MODEL,
    ORANGE,
    PALE,
    REGIONS,
    SHARED_LABELS,
    STYLE,
    WIDTH,
    labels_of_bounds,
    parameter_words,
    pdf,
    png,
    shared_labels,
    style,
    svg,
    told_apart,
)

__all__ = [
    "BLUE",
    "COLOURS",
    "DATA",
    "GREEN",
    "GROUND",
    "INK",
    "MARKERS",
    "MIDDLE",
    "MODEL",
    "ORANGE",
    "PALE",
    "REGIONS",
    "SHARED_LABELS",
    "STYLE",
    "WIDTH",
    "Stage",
    "autocorrelation",
    "chain",
    "corner",
    "coverage",
    "delays",
    "diffusion",
    "diffusion_figure",
    "effect_words",
    "forest",
    "gap_hidden",
    "gap_residuals",
    "gap_where",
    "gap_which",
    "histogram",
    "intervals",
    "labels_of_bounds",
    "main_parameters",
    "overlay",
    "parameter_words",
    "pdf",
    "png",
    "predictive",
    "responses",
    "schematic",
    "shared_labels",
    "spectra_figure",
    "spread",
    "step_study",
    "style",
    "svg",
    "tau_hard",
    "told_apart",
    "traces_and_ranks",
    "what_would_help",
]
