"""An independent simulator of the rig, for checking the diagnosis blind.

It imports nothing of the package but the records of :mod:`bayes_sensor.campaign`: no model, no
noise law, no effect.  With nothing wrong it agrees with the cascade; its causes are built from the
physics, differ in form from the catalogue's effects, and some have no counterpart there.
"""

from bayes_sensor.blind_check.simulator.case import Case, Component, NoiseLaw, Step, Switch
from bayes_sensor.blind_check.simulator.causes import (
    CAUSES,
    Cause,
    converter_step,
    tail_mixture,
)
from bayes_sensor.blind_check.simulator.draw import SIZES, draw_case
from bayes_sensor.blind_check.simulator.noise_laws import (
    HEAVY_TAILED,
    OPEN_LAWS,
    RESERVE_LAWS,
    autocorrelation,
    draw_law,
    draw_noise,
)
from bayes_sensor.blind_check.simulator.other_rigs import OTHER_RIGS, has_meaning, other_rig
from bayes_sensor.blind_check.simulator.simulated_campaign import (
    PHASES,
    acting_places,
    as_recorded,
    clean_signals,
    make_campaign,
    noise_scale,
    phase_spans,
    prepared_rigs,
    sample_times,
    without_causes,
)

__all__ = [
    "CAUSES",
    "HEAVY_TAILED",
    "OPEN_LAWS",
    "OTHER_RIGS",
    "PHASES",
    "RESERVE_LAWS",
    "SIZES",
    "Case",
    "Cause",
    "Component",
    "NoiseLaw",
    "Step",
    "Switch",
    "acting_places",
    "as_recorded",
    "autocorrelation",
    "clean_signals",
    "converter_step",
    "draw_case",
    "draw_law",
    "draw_noise",
    "has_meaning",
    "make_campaign",
    "noise_scale",
    "other_rig",
    "phase_spans",
    "prepared_rigs",
    "sample_times",
    "tail_mixture",
    "without_causes",
]  # fmt: skip
