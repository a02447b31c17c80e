"""tau from its profile, for explanations whose mean jumps at a switch.

A jump inside a bin moves the bin's mean in proportion to its place; a jump at the edge moves
another bin.  The objective is therefore bent at every edge of a bin, with an optimum on either
side, and its curvature at one optimum says nothing about the next.  Where the jump is well seen,
the ratio of tau to tau_v is held at one value after the other and everything else is refitted.
"""

from __future__ import annotations

from dataclasses import dataclass
from math import log

import numpy as np

from bayes_sensor.campaign import FloatArray
from bayes_sensor.diagnosis.evidence.coordinate_priors import FASTER
from bayes_sensor.diagnosis.evidence.refit import Refit, refit

SEEN = 25.0
"""what the objective gains by a jump that is well seen"""
COARSE = np.linspace(-2.0, 2.0, 17)
"""of ln(tau_v / tau), about the optimum that was found"""
FINE = 25
"""values across those that the coarse ones leave plausible"""
PLAUSIBLE = 12.0
"""above the least objective"""


@dataclass(frozen=True, eq=False)
class TauProfile:
    """What a profile over tau finds."""

    best: Refit
    log_tau: float
    sd_log_tau: float


def has_jump(fitted: Refit) -> bool:
    """Whether the mean jumps with a switch, wherever the strengths are not nought."""
    return any(part.form.jumps for part in fitted.coords.parts)


def profile_tau(fitted: Refit) -> TauProfile:
    """The best optimum near a refit, and mean and sd of ln tau by the profile."""
    ratio = float(fitted.x[0])
    coarse = _sweep(fitted, np.unique(np.maximum(ratio + COARSE, 0.0)))
    least = min(r.objective for r in coarse)
    good = [float(r.x[0]) for r in coarse if r.objective < least + PLAUSIBLE]
    apart = float(COARSE[1] - COARSE[0])
    low, high = max(min(good) - apart, 0.0), max(good) + apart
    found = _sweep(min(coarse, key=lambda r: r.objective), np.linspace(low, high, FINE))
    objectives = np.array([r.objective for r in found])
    weight = np.exp(-0.5 * (objectives - objectives.min()))
    weight /= weight.sum()
    logs = np.array([log(r.tau) for r in found])
    mean = float(weight @ logs)
    best = min(found, key=lambda r: r.objective)
    best = min((fitted, refit(best.coords, best.x)), key=lambda r: r.objective)
    return TauProfile(best, mean, float(np.sqrt(weight @ (logs - mean) ** 2)))


def _sweep(fitted: Refit, ratios: FloatArray) -> list[Refit]:
    # upwards and downwards, each from the one before: what one way misses the other may find
    coords = fitted.coords
    free = np.ones(coords.size, dtype=bool)
    free[0] = False
    best: dict[float, Refit] = {}
    for way in (ratios, ratios[::-1]):
        x = fitted.x
        for ratio in way.tolist():
            held = refit(coords, coords.with_tau(x, float(x[1]) - FASTER - ratio), free=free)
            x = held.x
            if ratio not in best or held.objective < best[ratio].objective:
                best[ratio] = held
    return [best[ratio] for ratio in ratios.tolist()]
