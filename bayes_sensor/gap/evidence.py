"""The evidence of a hypothesis: Laplace's approximation around its refit.

The floor's level is itself an estimate, so that the residuals follow a t law with
:data:`bayes_sensor.gap.floor.DOF` degrees of freedom in place of a Gaussian; it costs nothing
where the floor is right and keeps nulls quiet where it is low.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy.special import log_ndtr, logsumexp

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
    def jacobian(self) -> FloatArray:
        return self.refit.jacobian

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
    def promised(self) -> FloatArray | None:
        """(n,) the step by which the linearisation would still gain; None at an optimum.

        A refit that ends where its derivatives promise more than the model keeps (a bend, a kink)
        is credited with what it has reached.
        """
        plan, x = self.refit.plan, self.refit.x
        prior = plan.own_prior_matrix
        slope = self.jacobian.T @ self.refit.residual - prior @ (x - plan.prior_centre)
        free = np.ones(plan.size, dtype=bool)
        free[0] = x[0] > 0.0 or slope[0] > 0.0
        normal = (self.jacobian.T @ self.jacobian + prior)[np.ix_(free, free)]
        step = np.zeros(plan.size)
        step[free] = np.linalg.solve(normal, slope[free])
        return step if float(slope @ step) > AT_REST else None

    def evidence(self, discrepancy: Discrepancy | None) -> Evidence:
        """Average over the prior widths."""
        residual, jacobian = self.refit.residual, self.jacobian
        if discrepancy is None:
            mr, mj, log_det = residual, jacobian, 0.0
        else:
            both = discrepancy.precision_times(np.column_stack([residual, jacobian]))
            mr, mj, log_det = both[:, 0], both[:, 1:], discrepancy.log_determinant()
        normal = jacobian.T @ mj
        gradient = jacobian.T @ mr
        if self.promised is not None:
            gradient = gradient - normal @ self.promised
        square = float(residual @ mr)
        found = [
            _laplace(self.refit, normal, gradient, square, log_det, widths)
            for widths in self.widths
        ]
        logs = np.array([f.log_z for f in found])
        best = found[int(np.argmax(logs))]
        total = float(logsumexp(logs) - np.log(len(logs)))
        return Evidence(total, best.misfit, best.log_tau, best.sd_log_tau)


def _laplace(
    refit: Refit,
    normal: FloatArray,
    gradient: FloatArray,
    square: float,
    log_det: float,
    widths: FloatArray,
) -> Evidence:
    plan = refit.plan
    prior = plan.prior_matrix(widths)
    away = refit.x - plan.prior_centre
    n = len(refit.residual)
    scale, step, misfit = 1.0, np.zeros(plan.size), square
    for _ in range(3):
        matrix = scale * normal + prior
        step[:] = np.linalg.solve(matrix, scale * gradient - prior @ away)
        misfit = square - 2.0 * float(step @ gradient) + float(step @ normal @ step)
        misfit = max(misfit, 1e-9)
        scale = (DOF + n) / (DOF + misfit)
    matrix = scale * normal + prior
    moved = away + step
    sign, log_matrix = np.linalg.slogdet(matrix)
    if sign <= 0:
        return Evidence(-np.inf, misfit, 0.0, np.inf)
    covariance = np.linalg.inv(matrix)
    # ln tau <= ln tau_v - FASTER cuts the Gaussian
    inside = refit.x[0] + step[0]
    sd = float(np.sqrt(covariance[0, 0]))
    cut = float(log_ndtr(inside / sd))
    log_z = (
        -0.5 * (DOF + n) * np.log1p(misfit / DOF)
        - 0.5 * float(moved @ prior @ moved)
        + 0.5 * plan.log_prior_determinant(widths)
        - 0.5 * log_matrix
        - 0.5 * log_det
        + cut
    )
    direction = np.zeros(plan.size)
    direction[0], direction[1] = -1.0, 1.0
    spread = float(np.sqrt(direction @ covariance @ direction))
    log_tau = float(np.log(refit.tau) + direction @ step)
    return Evidence(float(log_z), misfit, log_tau, spread)
