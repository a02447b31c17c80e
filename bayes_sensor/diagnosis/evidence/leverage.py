"""What a refit leaves of noise, from its linearisation."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from bayes_sensor.campaign import FloatArray
from bayes_sensor.diagnosis.evidence.block_least_squares import inverted

if TYPE_CHECKING:
    from bayes_sensor.diagnosis.evidence.refit import Refit


@dataclass(frozen=True, eq=False)
class Leverage:
    """What a refit leaves of noise, from its linearisation."""

    jacobian: FloatArray
    inner: FloatArray
    """(n, n): P = I - J inner J'"""
    solve: FloatArray
    """(n, n): what the refit takes from a noise e is J solve J'e"""

    @classmethod
    def of(cls, fitted: Refit) -> Leverage:
        """Of a refit, its priors counted as data."""
        j = fitted.jacobian
        normal = j.T @ j
        solve = fitted.covariance
        if fitted.x[0] <= 0.0:  # tau at its upper limit: its own coordinate did not move
            keep = np.arange(1, len(solve))
            inverse = np.zeros_like(solve)
            matrix = (normal + fitted.coords.own_prior_matrix)[np.ix_(keep, keep)]
            inverse[np.ix_(keep, keep)] = inverted(matrix)
            solve = np.asarray(inverse, dtype=float)
        inner = np.asarray(2.0 * solve - solve @ normal @ solve, dtype=float)
        return cls(j, inner, solve)

    def block(self, rows: NDArray[np.int64]) -> FloatArray:
        """P on some rows."""
        j = self.jacobian[rows]
        return np.eye(len(rows)) - j @ self.inner @ j.T

    def trace(self) -> float:
        """tr P, the expected squared residual of unit noise."""
        return len(self.jacobian) - float(np.sum((self.jacobian @ self.inner) * self.jacobian))

    def leave(self, noise: FloatArray) -> FloatArray:
        """What is left of noises (n, m) after the refit."""
        return noise - self.jacobian @ (self.solve @ (self.jacobian.T @ noise))
