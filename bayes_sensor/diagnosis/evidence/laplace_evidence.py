"""The evidence of a hypothesis: Laplace's approximation around its refit.

The floor's level is itself an estimate, so that the residuals follow a t law with its degrees of
freedom (:attr:`~bayes_sensor.diagnosis.data.noise_floor.NoiseFloor.level_dof`) in place of a
Gaussian; it costs nothing where the floor is right and keeps nulls quiet where it is low.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np
from scipy.special import log_ndtr

from bayes_sensor.campaign import FloatArray
from bayes_sensor.diagnosis.evidence.block_least_squares import own_units, solved
from bayes_sensor.diagnosis.evidence.discrepancy import Discrepancy
from bayes_sensor.diagnosis.evidence.refit import Refit

WIDTHS = (1.0 / 3.0, 1.0, 3.0)
"""an amplitude's plausible size is averaged over these multiples of its stated spread"""
STRONG = (10.0, 30.0)
"""the same where the spreads hold an amplitude back that the data put far outside of them"""
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
        coords = self.refit.coords
        if not coords.amplitudes:
            return [np.ones(coords.size)]
        usual = [coords.widths(dict.fromkeys(coords.amplitudes, width)) for width in WIDTHS]
        strong = STRONG if coords.loose else ()
        return [*usual, *(coords.widths(dict.fromkeys(coords.loose, width)) for width in strong)]

    @cached_property
    def priors(self) -> list[tuple[FloatArray, float]]:
        """Per considered width, the precision (n, n) of the prior and ln of its determinant."""
        coords = self.refit.coords
        return [(coords.prior_matrix(w), coords.log_prior_determinant(w)) for w in self.widths]

    @cached_property
    def promised(self) -> FloatArray | None:
        """(n,) the step by which the linearisation would still gain; None at an optimum.

        A refit that ends where its derivatives promise more than the model keeps (a bend, a kink)
        is credited with what it has reached.
        """
        coords, x = self.refit.coords, self.refit.x
        prior = coords.own_prior_matrix
        slope = self.gram[1:, 0] - prior @ (x - coords.prior_centre)
        # a strength at its limit counts as free: what it promises beyond is then not credited
        free = np.ones(coords.size, dtype=bool)
        free[0] = not coords.at_limit(x) or slope[0] > 0.0
        normal = (self.gram[1:, 1:] + prior)[np.ix_(free, free)]
        step = np.zeros(coords.size)
        step[free] = solved(normal, slope[free])
        return step if float(slope @ step) > AT_REST else None

    def _at_rest(self, gram: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Gradient (.., n) and normal matrix (.., n, n), without what is only promised.

        ``gram`` (.., 1 + n, 1 + n): of residual and derivatives, with a discrepancy or without.
        """
        gradient, normal = gram[..., 1:, 0], gram[..., 1:, 1:]
        if self.promised is not None:
            gradient = gradient - normal @ self.promised
        return gradient, normal

    def left(self, discrepancy: Discrepancy | None) -> FloatArray:
        """(n_bins in all,) the noise: what neither the mean nor the discrepancy takes up."""
        if discrepancy is None:
            return self.refit.residual
        return discrepancy.leave(self._beside(discrepancy))

    def discrepancy(self, discrepancy: Discrepancy) -> FloatArray:
        """(n_bins in all,) whitened, what the discrepancy itself takes up."""
        whole = self._beside(discrepancy)
        return np.asarray(whole - discrepancy.leave(whole))

    def _beside(self, discrepancy: Discrepancy) -> FloatArray:
        """(n_bins in all,) what the mean leaves once it makes way for the discrepancy."""
        coords = self.refit.coords
        gradient, normal = self._at_rest(self.gram - discrepancy.absorbed(self.both))
        prior = coords.own_prior_matrix
        pulled = prior @ (self.refit.x - coords.prior_centre)
        step = solved(normal + prior, gradient - pulled)
        return np.asarray(self.refit.residual - self.refit.jacobian @ step)

    def evidence(self, discrepancy: Discrepancy | None) -> Evidence:
        """Average over the prior widths."""
        return self.evidences([discrepancy])[0]

    def evidences(self, discrepancies: Sequence[Discrepancy | None]) -> list[Evidence]:
        """Average over the prior widths, with every discrepancy in turn."""
        # (n_discrepancies, n_widths) and what each is of; at once, as the matrices are small
        gram = np.array(
            [self.gram if d is None else self.gram - d.absorbed(self.both) for d in discrepancies]
        )
        log_det = np.array([0.0 if d is None else d.log_determinant() for d in discrepancies])
        gradient, normal = self._at_rest(gram)
        found = _laplace(self.refit, normal, gradient, gram[:, 0, 0], log_det, self.priors)
        best = np.argmax(found.log_z, axis=1)
        total = np.logaddexp.reduce(found.log_z, axis=1) - np.log(len(self.priors))
        return [
            Evidence(*map(float, (log_z, found.misfit[k, i], found.log_tau[k, i], found.sd[k, i])))
            for k, (i, log_z) in enumerate(zip(best, total, strict=True))
        ]


class _Laplace(NamedTuple):
    """What :class:`Evidence` says, (n_discrepancies, n_widths) each."""

    log_z: FloatArray
    misfit: FloatArray
    log_tau: FloatArray
    sd: FloatArray


def _laplace(
    refit: Refit,
    normal: FloatArray,
    gradient: FloatArray,
    square: FloatArray,
    log_det: FloatArray,
    priors: Sequence[tuple[FloatArray, float]],
) -> _Laplace:
    # axes: discrepancies, prior widths, coordinates
    prior = np.array([matrix for matrix, _ in priors])
    log_prior_det = np.array([log for _, log in priors])
    away = refit.x - refit.coords.prior_centre
    pulled = prior @ away
    n = len(refit.residual)
    normal, gradient = normal[:, None], gradient[:, None]
    square = square[:, None]
    scale = np.ones((len(square), len(priors)))
    dof = refit.coords.binned.floor.level_dof
    for _ in range(3):
        matrix = scale[..., None, None] * normal + prior
        step = solved(matrix, (scale[..., None] * gradient - pulled)[..., None])[..., 0]
        bent = (normal @ step[..., None])[..., 0]
        misfit = square + np.sum(step * (bent - 2.0 * gradient), axis=-1)
        misfit = np.maximum(misfit, 1e-9)
        scale = (dof + n) / (dof + misfit)
    matrix = scale[..., None, None] * normal + prior
    moved = away + step
    unit = own_units(matrix)
    sign, log_matrix = np.linalg.slogdet(matrix * unit[..., :, None] * unit[..., None, :])
    log_matrix = log_matrix - 2.0 * np.sum(np.log(unit), axis=-1)
    sound = sign > 0
    # the covariance of two coordinates: ln tau is the second minus the first where the sensor's is
    # the shorter lag, else the second
    places, minus = refit.coords.places_of_tau, refit.coords.tau_is_difference
    both = np.broadcast_to(np.eye(len(away))[:, places], (*matrix.shape[:-1], 2))
    covariance = solved(matrix, both)[..., places, :]
    # that the shorter lag is below the longer by FASTER cuts the Gaussian
    inside = refit.x[0] + step[..., 0]
    cut = 0.0
    with np.errstate(invalid="ignore"):  # of a matrix that is not positive definite
        sd = np.sqrt(covariance[..., 0, 0])
        spread = np.sqrt(
            minus * (covariance[..., 0, 0] - 2.0 * covariance[..., 0, 1]) + covariance[..., 1, 1]
        )
        if refit.coords.n_ordered:
            cut = log_ndtr(inside / sd)
    drawn = np.sum(moved * (prior @ moved[..., None])[..., 0], axis=-1)
    log_z = (
        -0.5 * (dof + n) * np.log1p(misfit / dof)
        - 0.5 * drawn
        + 0.5 * log_prior_det
        - 0.5 * log_matrix
        - 0.5 * log_det[:, None]
        + cut
    )
    log_tau = np.log(refit.tau) + step[..., places[1]] - minus * step[..., places[0]]
    return _Laplace(
        np.where(sound, log_z, -np.inf),
        misfit,
        np.where(sound, log_tau, 0.0),
        np.where(sound, spread, np.inf),
    )
