"""Every figure of the report and the paper, in one style: result records in, a Figure out.

One file per subject; everything that a caller needs is here under its own name.
"""

from bayes_sensor.figures.labels import (
    labels_of_bounds,
    parameter_words,
    shared_labels,
    told_apart,
)
from bayes_sensor.figures.plot_chain import Box, chain
from bayes_sensor.figures.plot_check import understood
from bayes_sensor.figures.plot_coating import (
    diffusion,
    diffusion_figure,
    spectra_figure,
)
from bayes_sensor.figures.plot_delays import delay_panel, delays
from bayes_sensor.figures.plot_draws import corner, named_chains, traces_and_ranks
from bayes_sensor.figures.plot_fleet import forest
from bayes_sensor.figures.plot_gap import (
    effect_words,
    explanation_panel,
    gap_hidden,
    gap_residuals,
    gap_where,
    gap_which,
)
from bayes_sensor.figures.plot_methods import (
    intervals,
    one_interval,
    step_study,
)
from bayes_sensor.figures.plot_noise import (
    autocorrelation,
    autocorrelation_panel,
    histogram,
    predictive,
    spread,
)
from bayes_sensor.figures.plot_overlays import overlay, overlay_panel
from bayes_sensor.figures.plot_responses import responses
from bayes_sensor.figures.plot_restored import restored
from bayes_sensor.figures.plot_tau import coverage, tau_hard, what_would_help
from bayes_sensor.figures.style import WIDTH, no_data, pdf, png, style, svg

__all__ = [
    "WIDTH",
    "Box",
    "autocorrelation",
    "autocorrelation_panel",
    "chain",
    "corner",
    "coverage",
    "delay_panel",
    "delays",
    "diffusion",
    "diffusion_figure",
    "effect_words",
    "explanation_panel",
    "forest",
    "gap_hidden",
    "gap_residuals",
    "gap_where",
    "gap_which",
    "histogram",
    "intervals",
    "labels_of_bounds",
    "named_chains",
    "no_data",
    "one_interval",
    "overlay",
    "overlay_panel",
    "parameter_words",
    "pdf",
    "png",
    "predictive",
    "responses",
    "restored",
    "shared_labels",
    "spectra_figure",
    "spread",
    "step_study",
    "style",
    "svg",
    "tau_hard",
    "told_apart",
    "traces_and_ranks",
    "understood",
    "what_would_help",
]
