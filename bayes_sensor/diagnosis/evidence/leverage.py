"""What a refit leaves of noise, from its linearisation."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from bayes_sensor.campaign import FloatArray
from bayes_sensor.diagnosis.evidence.block_least_squares import inverted


@dataclass(frozen=True, eq=False)
class Leverage:
    """What a refit leaves of noise, from its linearisation."""

    jacobian: FloatArray
    inner: FloatArray
    """(n, n): P = I - J inner J'"""
    solve: FloatArray
    """(n, n): what the refit takes from a noise e is J solve J'e"""

    @classmethod
    def of(
        cls, jacobian: FloatArray, prior: FloatArray, covariance: FloatArray, at_limit: bool
    ) -> Leverage:
        """Of a refit with the precision ``prior`` (n, n) of its priors, which count as data.

        ``covariance`` (n, n): the inverse of the normal matrix.  ``at_limit``: whether tau is at
        its upper limit, so that its own coordinate, the first, did not move.
        """
        normal = jacobian.T @ jacobian
        solve = covariance
        if at_limit:
            keep = np.arange(1, len(solve))
            solve = np.zeros_like(covariance)
            solve[np.ix_(keep, keep)] = inverted((normal + prior)[np.ix_(keep, keep)])
        inner = np.asarray(2.0 * solve - solve @ normal @ solve, dtype=float)
        return cls(jacobian, inner, solve)

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
