"""What an effect may know of an experiment and its campaign."""

from __future__ import annotations

from dataclasses import dataclass

from bayes_sensor.campaign import Experiment


@dataclass(frozen=True)
class Setting:
    """What a form may know of an experiment and its campaign when it sets the rig."""

    experiment: Experiment
    t0: float
    """s, when the response begins"""
    tf: float
    """s, when it begins to fall; the end of the record where no fall was recorded"""
    time_scale: float
    """s, of the slower of valve and manifold, from the fit without effects"""
    reference_flow: float
    """mL/s, median of the campaign's total flows"""
    signal_scale: float
    """V, median step height of the campaign"""
    duration: float
    """s, median record length"""
    concentration_before: float = 0.0
    """of the experiment that the campaign lists before this one; 0 for the first of all"""
