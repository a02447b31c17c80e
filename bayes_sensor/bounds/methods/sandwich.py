"""Least squares with the sandwich covariance, from the residuals as they are."""

from __future__ import annotations

from bayes_sensor.bounds.bound import Bound
from bayes_sensor.bounds.context import Evidence
from bayes_sensor.bounds.methods.bound_method import BoundMethod
from bayes_sensor.bounds.sandwich_covariance import REFERENCE, sandwich_bound, sandwich_of


def sandwich(evidence: Evidence) -> Bound:
    """Least squares with the sandwich covariance, Bartlett weights over a bandwidth."""
    found = sandwich_of(evidence, parametric=False)
    details: dict[str, object] = {
        "bandwidth_samples": found.bandwidths,
        "kernel": "Bartlett",
        "degrees_of_freedom": dict(
            zip(evidence.white.mean_names, found.degrees.tolist(), strict=True)
        ),
    }
    return sandwich_bound(evidence, found, found.factor, details)


METHOD = BoundMethod(
    name="sandwich",
    label="sandwich",
    assumes="least squares; noise stationary in its correlations over short lags but otherwise "
    "unspecified, experiments independent",
    compute=sandwich,
    reference=REFERENCE,
    noise="residuals",
)
