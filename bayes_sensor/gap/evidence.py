"""The evidence of a hypothesis: Laplace's approximation around its refit.

The floor's level is itself an estimate, so that the residuals follow a t law with
:data:`bayes_sensor.gap.floor.DOF` degrees of freedom in place of a Gaussian; it costs nothing
where the floor is right and keeps nulls quiet where it is low.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy.special import log_ndtr

from bayes_sensor.campaign import FloatArray
from bayes_sensor.gap.discrepancy import Discrepancy
from bayes_sensor.gap.floor import DOF
from bayes_sensor.gap.refit import Refit

WIDTHS = (1.0 / 3.0, 1.0, 3.0)
"""an amplitude's plausible size is averaged over these multiples of its stated spread"""
AT_REST = 2.0
"""gain that the linearisation may promise beyond a refit's end before it is not believed"""


@dataclass(frozen=True)
class Evidence:
    """One hypothesis' evidence and where it puts the time constant."""

    log_z: float
    misfit: float
    """squared whitened residual that is left, discrepancy included"""
    log_tau: float
    sd_log_tau: float


@dataclass(frozen=True, eq=False)
class Linearised:
    """A refit prepared for many discrepancies and prior widths."""

    refit: Refit

    @cached_property
    def both(self) -> FloatArray:
        """(n_bins in all, 1 + n) the residual, and the derivatives of the mean."""
        return np.column_stack([self.refit.residual, self.refit.jacobian])

    @cached_property
    def gram(self) -> FloatArray:
        """(1 + n, 1 + n) of these with each other."""
        return np.asarray(self.both.T @ self.both)

    @cached_property
    def widths(self) -> list[FloatArray]:
        """Per considered width, the factor (n,) on the spread of every strength."""
        plan = self.refit.plan
        scaled = [s.scaled for s in plan.shared]
        own = [s.scaled for s in plan.own]
        made = []
        for width in WIDTHS if any(scaled) or any(own) else (1.0,):
            factor = np.ones(plan.size)
            factor[3 : 3 + len(scaled)] = [width if s else 1.0 for s in scaled]
            for k in range(len(plan.sketch.campaign)):
                end = plan.local[k + 1]
                factor[end - len(own) : end] = [width if s else 1.0 for s in own]
            made.append(factor)
        return made

    @cached_property
    def priors(self) -> list[tuple[FloatArray, float]]:
        """Per considered width, the precision (n, n) of the prior and ln of its determinant."""
        plan = self.refit.plan
        return [(plan.prior_matrix(w), plan.log_prior_determinant(w)) for w in self.widths]

    @cached_property
    def promised(self) -> FloatArray | None:
        """(n,) the step by which the linearisation would still gain; None at an optimum.

        A refit that ends where its derivatives promise more than the model keeps (a bend, a kink)
        is credited with what it has reached.
        """
        plan, x = self.refit.plan, self.refit.x
        prior = plan.own_prior_matrix
        slope = self.gram[1:, 0] - prior @ (x - plan.prior_centre)
        free = np.ones(plan.size, dtype=bool)
        free[0] = x[0] > 0.0 or slope[0] > 0.0
        normal = (self.gram[1:, 1:] + prior)[np.ix_(free, free)]
        step = np.zeros(plan.size)
        step[free] = np.linalg.solve(normal, slope[free])
        return step if float(slope @ step) > AT_REST else None

    def evidence(self, discrepancy: Discrepancy | None) -> Evidence:
        """Average over the prior widths."""
        gram, log_det = self.gram, 0.0
        if discrepancy is not None:
            gram = gram - discrepancy.absorbed(self.both)
            log_det = discrepancy.log_determinant()
        square, gradient, normal = float(gram[0, 0]), gram[1:, 0], gram[1:, 1:]
        if self.promised is not None:
            gradient = gradient - normal @ self.promised
        found = [
            _laplace(self.refit, normal, gradient, square, log_det, prior, log_prior_det)
            for prior, log_prior_det in self.priors
        ]
        logs = np.array([f.log_z for f in found])
        best = found[int(np.argmax(logs))]
        total = float(np.logaddexp.reduce(logs) - np.log(len(logs)))
        return Evidence(total, best.misfit, best.log_tau, best.sd_log_tau)


def _laplace(
    refit: Refit,
    normal: FloatArray,
    gradient: FloatArray,
    square: float,
    log_det: float,
    prior: FloatArray,
    log_prior_det: float,
) -> Evidence:
    away = refit.x - refit.plan.prior_centre
    pulled = prior @ away
    n = len(refit.residual)
    scale, misfit = 1.0, square
    for _ in range(3):
        step = np.linalg.solve(scale * normal + prior, scale * gradient - pulled)
        misfit = square - 2.0 * float(step @ gradient) + float(step @ normal @ step)
        misfit = max(misfit, 1e-9)
        scale = (DOF + n) / (DOF + misfit)
    matrix = scale * normal + prior
    moved = away + step
    sign, log_matrix = np.linalg.slogdet(matrix)
    if sign <= 0:
        return Evidence(-np.inf, misfit, 0.0, np.inf)
    # the covariance of the first two coordinates, in which ln tau is the second minus the first
    covariance = np.linalg.solve(matrix, np.eye(len(step), 2))[:2]
    # ln tau <= ln tau_v - FASTER cuts the Gaussian
    inside = refit.x[0] + step[0]
    sd = float(np.sqrt(covariance[0, 0]))
    cut = float(log_ndtr(inside / sd))
    log_z = (
        -0.5 * (DOF + n) * np.log1p(misfit / DOF)
        - 0.5 * float(moved @ prior @ moved)
        + 0.5 * log_prior_det
        - 0.5 * log_matrix
        - 0.5 * log_det
        + cut
    )
    direction = np.array([-1.0, 1.0])
    spread = float(np.sqrt(direction @ covariance @ direction))
    log_tau = float(np.log(refit.tau) + direction @ step[:2])
    return Evidence(float(log_z), misfit, log_tau, spread)
