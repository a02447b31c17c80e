"""Profile likelihood: where the likelihood-ratio test at a level does not reject a value."""

from __future__ import annotations

from math import nan, sqrt

import numpy as np

from bayes_sensor.bounds.bound import LEVELS, Bound
from bayes_sensor.bounds.context import Evidence
from bayes_sensor.bounds.gaussian_intervals import normal_factor
from bayes_sensor.bounds.methods.bound_method import BoundMethod
from bayes_sensor.bounds.methods.crlb_ar1 import crlb_ar1
from bayes_sensor.bounds.profile import Profiler
from bayes_sensor.campaign import FloatArray
from bayes_sensor.likelihood.mesh import sizes


def profile(evidence: Evidence) -> Bound:
    """Likelihood-ratio intervals of every parameter of the mean."""
    surface, maximum = evidence.coloured, evidence.coloured_maximum
    theta = evidence.coloured_theta
    names, estimate = evidence.of_mean(theta)
    if not maximum.converged:
        reason = f"{evidence.coloured_trouble}: no profile about it"
        return Bound.without_values(names, estimate, reason)
    profiler = Profiler.of(surface, maximum)
    rough = crlb_ar1(evidence)
    targets = [normal_factor(level) for level in LEVELS.values()]
    low, high = np.full((len(names), 3), nan), np.full((len(names), 3), nan)
    at_zero = False
    size = sizes(evidence.problem, theta)
    for row, name in enumerate(names):
        i = int(surface.mean[row])
        centre = float(estimate[row])
        below, above = rough.low[row], rough.high[row]
        if not np.isfinite([below, above]).all():  # not identified to first order
            width = 0.02 * size[surface.coordinates.free[i]] * np.array(targets)
            below, above = centre - width, centre + width
            if name in evidence.problem.layout.shared_names:
                below = np.maximum(below, 0.5 * centre)
        # an asymmetric interval need not hold the estimate: look on either side of it all the same
        width = above - below
        below = np.where(below < centre, below, centre - 0.5 * width)
        above = np.where(above > centre, above, centre + 0.5 * width)
        if name == "tau_s":
            low[row], high[row] = _tau_ends(profiler, below, above, targets)
            at_zero = bool(low[row, 1] == 0.0)
        else:
            low[row] = profiler.ends(i, centre, below.tolist(), targets)
            high[row] = profiler.ends(i, centre, above.tolist(), targets)
        evidence.progress((row + 1) / len(names), "profile likelihood")
    sentences = []
    if at_zero:
        sentences.append("the data do not exclude tau = 0: its interval is an upper limit")
    lost = [n for n, a, b in zip(names, low, high) if not np.isfinite([a, b]).all()]
    if lost:
        sentences.append(f"no end found for {', '.join(lost)}")
    sd = np.full(len(names), nan)
    return Bound(names, estimate, sd, low, high, "; ".join(sentences) or "ok")


def _tau_ends(
    profiler: Profiler, below: FloatArray, above: FloatArray, targets: list[float]
) -> tuple[list[float], list[float]]:
    centre = float(profiler.maximum.psi[0])
    floor = float(profiler.surface.floor[0])
    guesses = [max(value**2, 1.5 * floor) for value in above]
    up = profiler.ends(0, centre, guesses, targets)
    high = [sqrt(value) for value in up]
    to_floor = profiler.drop(0, floor)
    low = []
    inside = [j for j, target in enumerate(targets) if target < to_floor]
    guesses = [max(float(below[j]) ** 2, floor) for j in inside]
    guesses = [g if g < centre else 0.5 * (centre + floor) for g in guesses]
    found = profiler.ends(0, centre, guesses, [targets[j] for j in inside])
    low = [sqrt(max(value, 0.0)) for value in found] + [0.0] * (len(targets) - len(inside))
    return low, high


METHOD = BoundMethod(
    name="profile",
    label="profile likelihood",
    assumes="{noise}, every other parameter at its best",
    compute=profile,
    reference="Venzon and Moolgavkar (1988); Self and Liang (1987)",
    noise="fitted",
    least_squares=False,
    both_orders=True,
    against_others="has no prior and maximises over all other parameters at every τ",
)
