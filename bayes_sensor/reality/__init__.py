"""An independent reality: a time-stepping simulator of the rig for checking the diagnosis blind.

It imports nothing of the package but the records of :mod:`bayes_sensor.campaign`: no model, no
noise law, no effect.  With nothing wrong it agrees with the cascade; its causes are built from the
physics, differ in form from the catalogue's effects, and some have no counterpart there.
"""

from bayes_sensor.reality.causes import CAUSES, Cause
from bayes_sensor.reality.draw import SIZES, draw_case
from bayes_sensor.reality.noise import (
    HEAVY_TAILED,
    OPEN_LAWS,
    RESERVE_LAWS,
    autocorrelation,
    draw_law,
)
from bayes_sensor.reality.records import Case, Component, NoiseLaw, Step
from bayes_sensor.reality.simulator import (
    PHASES,
    acting_places,
    as_recorded,
    clean_signals,
    make_campaign,
    noise_scale,
    phase_edges,
    sample_times,
    without_causes,
)

__all__ = [
    "CAUSES", "HEAVY_TAILED", "OPEN_LAWS", "PHASES", "RESERVE_LAWS", "SIZES", "Case", "Cause",
    "Component", "NoiseLaw", "Step", "acting_places", "as_recorded", "autocorrelation",
    "clean_signals", "draw_case", "draw_law", "make_campaign", "noise_scale", "phase_edges",
    "sample_times", "without_causes",
]  # fmt: skip
