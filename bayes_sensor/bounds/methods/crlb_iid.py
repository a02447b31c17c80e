"""The converged Cramer-Rao bound under iid noise, from sensitivities in closed form."""

from __future__ import annotations

from bayes_sensor.bounds.bound import Bound
from bayes_sensor.bounds.context import Evidence
from bayes_sensor.bounds.cramer_rao import PAPER
from bayes_sensor.bounds.gaussian_intervals import gaussian_bound
from bayes_sensor.bounds.methods.bound_method import BoundMethod


def crlb_iid(evidence: Evidence) -> Bound:
    """Converged Cramer-Rao bound under iid noise of the fit's RMS."""
    cov, identified = evidence.white_cov
    return gaussian_bound(
        evidence.mean_names,
        evidence.estimate,
        cov,
        evidence.at_bound,
        identified=identified,
        details={"sigma": evidence.fit.rms},
        plain=True,
        along_tau=evidence.white_along_tau,
    )


METHOD = BoundMethod(
    name="crlb_iid",
    label="Cramér-Rao, iid noise",
    assumes="iid Gaussian noise of the fit's RMS; sensitivities in closed form",
    compute=crlb_iid,
    reference=PAPER,
    noise="white",
    cramer_rao={},
)
