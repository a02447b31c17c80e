"""Least squares with the sandwich covariance of AR(1) noise."""

from __future__ import annotations

from bayes_sensor.bounds.bound import Bound
from bayes_sensor.bounds.context import Evidence
from bayes_sensor.bounds.gaussian_intervals import normal_factor
from bayes_sensor.bounds.methods.bound_method import BoundMethod
from bayes_sensor.bounds.sandwich_covariance import REFERENCE, sandwich_bound, sandwich_of


def sandwich_ar1(evidence: Evidence) -> Bound:
    """Least squares with the sandwich covariance, its middle from the fitted AR(1) noise."""
    return sandwich_bound(evidence, sandwich_of(evidence, parametric=True), normal_factor, {})


METHOD = BoundMethod(
    name="sandwich_ar1",
    label="sandwich, AR(1) noise",
    assumes="least squares under AR(1) noise with concentration-dependent scale, whose fitted "
    "parameters give the covariance",
    compute=sandwich_ar1,
    reference=REFERENCE,
    noise="residuals",
)
