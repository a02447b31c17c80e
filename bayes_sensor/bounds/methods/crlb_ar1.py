"""The Cramer-Rao bound under the problem's own noise law."""

from __future__ import annotations

import numpy as np

from bayes_sensor.bounds.bound import Bound
from bayes_sensor.bounds.context import Evidence
from bayes_sensor.bounds.gaussian_intervals import gaussian_bound, invert
from bayes_sensor.bounds.likelihood_surface import spread_along_tau
from bayes_sensor.bounds.methods.bound_method import BoundMethod


def crlb_ar1(evidence: Evidence) -> Bound:
    """Cramer-Rao bound under the problem's own noise, information from the variance included.

    Centred on the maximum of that likelihood; the noise parameters are estimated with the others.
    """
    surface = evidence.coloured
    psi = evidence.coloured_maximum.psi
    cov, identified = invert(surface.information(surface.expansion(psi)))
    layout, theta, trouble = (
        evidence.problem.layout,
        evidence.coloured_theta,
        evidence.coloured_trouble,
    )
    noise = {name: float(theta[layout.index(name)]) for name in layout.noise_names}
    return gaussian_bound(
        *evidence.of_mean(theta),
        cov[np.ix_(surface.mean, surface.mean)],
        evidence.coloured_at_bound,
        identified=identified[surface.mean],
        status=trouble and f"{trouble}: taken at the best point",
        details={"noise": noise},
        along_tau=spread_along_tau(surface, psi),
    )


METHOD = BoundMethod(
    name="crlb_ar1",
    label="Cramér-Rao, AR(1) noise",
    assumes="{noise}, noise parameters estimated with the others",
    compute=crlb_ar1,
    reference="Slepian (1954), Bangs (1971); Kay (1993), eq. 3.31",
    noise="fitted",
    least_squares=False,
    cramer_rao={"noise": "ar1"},
)
