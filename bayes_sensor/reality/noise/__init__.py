"""Noise of the simulated rig: sums of processes that are each drawn by their own recursion.

A law names its components, and each component has a shape: ``correlation`` says what that does to
the autocorrelation, ``processes`` draws it.
"""

from bayes_sensor.reality.noise.correlation import autocorrelation
from bayes_sensor.reality.noise.laws import HEAVY_TAILED, OPEN_LAWS, RESERVE_LAWS, draw_law
from bayes_sensor.reality.noise.processes import draw_noise

__all__ = [
    "HEAVY_TAILED", "OPEN_LAWS", "RESERVE_LAWS", "autocorrelation", "draw_law", "draw_noise",
]  # fmt: skip
