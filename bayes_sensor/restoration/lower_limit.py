"""An input that is known not to fall below a limit, such as a concentration below zero.

The condition holds at many times together.  Expectation propagation (Minka 2001; Rasmussen and
Williams, *Gaussian Processes for Machine Learning*, section 3.6) puts a Gaussian in the place of
each condition, so that mean and variance of the input become those of the truncated law.  They act
in the filter as values of the input with known errors.
"""

from __future__ import annotations

import numpy as np
from scipy.special import log_ndtr

from bayes_sensor.campaign import FloatArray
from bayes_sensor.restoration.state_space import FilterSamples, Model

PER_RESOLUTION = 3.0
"""conditions within the resolution; what lies between them follows"""
MOST_SWEEPS, ENOUGH = 40, 1e-3
"""sweeps, which end once means move by less than this share of their standard deviation"""
DAMPING = 0.5
"""share of a sweep's change that is made; all of it would overshoot"""
UNSEEN = 1e-9
"""precision, over that of the input, below which a condition has no effect"""


def hold_above(
    samples: FilterSamples, model: Model, limit: float, resolution: float
) -> FilterSamples:
    """The samples with values of the input that hold it above ``limit``.

    ``limit`` is in standard deviations of the record; ``resolution`` in s.
    """
    t = samples.t
    sites = max(2, int(np.ceil(PER_RESOLUTION * t[-1] / resolution)) + 1)
    places = np.unique(np.searchsorted(t, np.linspace(0.0, t[-1], sites)).clip(0, len(t) - 1))
    precision, shift = np.zeros(len(places)), np.zeros(len(places))
    mean, variance = (each[places] for each in samples.smooth(model))
    held = samples
    for _ in range(MOST_SWEEPS):
        # what all others say of the input at each place
        others = 1.0 / variance - precision
        usable = others > UNSEEN / variance
        others = np.where(usable, others, 1.0 / variance)
        centre = (mean / variance - shift) / others
        m, v = _truncated(centre, 1.0 / others, limit)
        new_precision = np.maximum(1.0 / v - others, 0.0)
        new_shift = m / v - centre * others
        precision += np.where(usable, DAMPING * (new_precision - precision), 0.0)
        shift += np.where(usable, DAMPING * (new_shift - shift), 0.0)
        acts = precision > UNSEEN / model.input_sd**2
        held = samples.with_input(
            places[acts], shift[acts] / precision[acts], 1.0 / np.sqrt(precision[acts])
        )
        before = mean
        mean, variance = (each[places] for each in held.smooth(model))
        if np.max(np.abs(mean - before) / np.sqrt(variance)) < ENOUGH:
            break
    return held


def _truncated(
    mean: FloatArray, variance: FloatArray, limit: float
) -> tuple[FloatArray, FloatArray]:
    """Mean and variance (n,) of Gaussians of ``mean`` and ``variance`` (n,) above ``limit``."""
    sd = np.sqrt(variance)
    a = (limit - mean) / sd
    hazard = np.exp(-0.5 * a**2 - 0.5 * np.log(2.0 * np.pi) - log_ndtr(-a))
    # far below the limit the difference of large numbers is 1/a^2
    shrink = np.where(a < 20.0, 1.0 - hazard * (hazard - a), 1.0 / np.maximum(a, 1.0) ** 2)
    return mean + sd * hazard, variance * np.clip(shrink, 1e-6, 1.0)
