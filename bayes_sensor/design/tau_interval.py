"""The interval of tau to expect from planned experiments.

Predictions are posterior-like.  Data are expected at the truth and their information is Gaussian in
(tau^2, tau_v, V, t0 + tau, tf + tau, ..), so that with everything else integrated out::

    p(tau) ~ exp(-D(tau)/2) half-normal(tau),   D = (dq, dtau) M (dq, dtau)',
    dq = tau^2 - tau_true^2,  dtau = tau - tau_true

where M_qq is the information of the records on tau^2.  The other entries come from knowledge of t0,
such as a trigger.  The interval is that density's equal-tailed one.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from bayes_sensor.campaign import FloatArray
from bayes_sensor.design.planned_experiments import PlannedSetting, Truth
from bayes_sensor.design.record_information import Known, eliminate, sum_information
from bayes_sensor.likelihood.priors import Prior
from bayes_sensor.likelihood.problem import Problem

Beforehand = tuple[tuple[int, float], ...]
"""places in :func:`common_names` with the standard deviation to which each is known, s or mL"""
NOTHING: Beforehand = ()


@dataclass(frozen=True)
class Prediction:
    """The expected interval of tau."""

    sd: float
    """s, the Cramer-Rao bound at the true tau"""
    sd_square: float
    """s^2, of tau^2 without knowledge of the switch times"""
    low68: float
    high68: float
    low95: float
    high95: float

    @property
    def half_width95(self) -> float:
        """s, half the length of the 95 % interval."""
        return 0.5 * (self.high95 - self.low95)

    def to_json(self) -> dict[str, float]:
        """Spread, ends and half width in seconds, by their JSON keys."""
        return {
            "sd_tau_s": self.sd,
            "lo68_s": self.low68,
            "hi68_s": self.high68,
            "lo95_s": self.low95,
            "hi95_s": self.high95,
            "half_width95_s": self.half_width95,
        }


def predict_tau(
    common: FloatArray, tau: float, prior: Prior | None = None, beforehand: Beforehand = NOTHING
) -> Prediction:
    """Interval of tau (s) from information (n, n) on :func:`common_names`, expected at the true
    ``tau``.

    ``prior`` on tau (default flat on tau > 0); ``beforehand``: what is known without the records.
    """
    common = common.copy()
    for place, sd in beforehand:
        common[place, place] += 1.0 / max(sd, 1e-9) ** 2
    M = eliminate(common, [0, 1])
    q = tau**2
    sd_square = float(1.0 / np.sqrt(M[0, 0])) if M[0, 0] > 0 else np.inf
    slope = np.array([2.0 * tau, 1.0])
    information = float(slope @ M @ slope)
    top = float(np.sqrt(q + 9.0 * sd_square)) if np.isfinite(sd_square) else 10.0 * max(tau, 1.0)
    bottom = 0.0
    for _ in range(3):  # look where the density is
        taus = np.linspace(bottom, top, 4001)
        d = np.stack([taus**2 - q, taus - tau])
        log_density = -0.5 * np.einsum("in,ij,jn->n", d, M, d)
        if prior is not None:
            log_density += prior.log_density(taus)
        inside = np.flatnonzero(log_density > log_density.max() - 30.0)
        width = taus[1] - taus[0]
        bottom, top = max(taus[inside[0]] - width, 0.0), taus[inside[-1]] + width
    density = np.exp(log_density - log_density.max())
    mass = np.concatenate([[0.0], np.cumsum(0.5 * (density[1:] + density[:-1]))])
    ends = np.interp(np.array([0.16, 0.84, 0.025, 0.975]) * mass[-1], mass, taus)
    sd = 1.0 / np.sqrt(information) if information > 0 else np.inf
    return Prediction(float(sd), sd_square, *(float(end) for end in ends))


def known_beforehand(problem: Problem) -> Beforehand:
    """What side information says of shared parameters other than tau."""
    found = []
    for place, name in enumerate(problem.layout.rig.names[1:], 2):
        prior = problem.named_laws.get(name)
        if prior is not None and prior.kind == "normal":
            found.append((place, prior.b))
    return tuple(found)


def predict(
    settings: Sequence[PlannedSetting],
    truth: Truth,
    prior: Prior | None = None,
    trigger: float | None = None,
    beforehand: Beforehand = NOTHING,
    repeats: float = 1.0,
    known: Known | None = None,
) -> Prediction:
    """Expected interval of tau from these experiments, each done ``repeats`` times.

    Sensitivities are taken at the true tau or, if that cannot be distinguished from zero, at the
    root of one spread of tau^2.
    """
    fastest = truth.fastest(settings)
    tau = max(truth.tau, 2e-3 * fastest)
    for _ in range(2):
        common = sum_information(settings, truth, tau, trigger, known) * repeats
        prediction = predict_tau(common, truth.tau, prior, beforehand)
        raised = min(float(np.sqrt(prediction.sd_square)), prediction.high68, 0.5 * fastest)
        if raised <= 1.02 * tau:
            break
        tau = raised
    return prediction
