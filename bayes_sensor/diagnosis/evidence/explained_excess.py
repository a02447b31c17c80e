"""The misfit beneath the noise: what the explanations, weighed, take of the base fit's residual.

A visible gap is a small part of the noise, so that what a cell has above it is mostly chance.  An
explanation of a few numbers, or a smooth process, takes little of that.  Averaged over all of them,
something unlisted included, the squares of what they take are the excess to be expected in a cell.
"""

from __future__ import annotations

from math import sqrt

import numpy as np

from bayes_sensor.campaign import FloatArray
from bayes_sensor.diagnosis.evidence.hypotheses import Weighing
from bayes_sensor.diagnosis.evidence.laplace_evidence import Linearised

LEAST = 1e-3
"""probability of an explanation below which it is left out"""


def explained(weighing: Weighing) -> FloatArray:
    """(n_bins in all, n) what each explanation takes, times the root of its probability.

    Whitened as residuals are: a sum of squares is the excess to be expected there, in variances of
    the noise.
    """
    before = weighing.base.residual
    found = [np.zeros_like(before)]
    for h, p in zip(weighing.hypotheses, weighing.probabilities, strict=True):
        if p < LEAST or h.key == "none":
            continue
        for term in h.terms:
            left = Linearised(term.refit).left(term.beside)
            found.append(sqrt(p * term.share) * (before - left))
    return np.column_stack(found)
