"""Planned experiments, and the parameters that a prediction assumes."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from bayes_sensor.campaign import CampaignError, Experiment, FloatArray
from bayes_sensor.likelihood.noise import Noise
from bayes_sensor.likelihood.problem import Problem
from bayes_sensor.rig.cascade import local_parameters

BEGIN, END = 0.2, 0.6
"""when a proposed experiment's step starts and ends, as fractions of its duration"""


@dataclass(frozen=True)
class Setting:
    """One planned experiment: its design and its own parameters."""

    experiment: Experiment
    y0: float
    beta: float
    t0: float
    tf: float | None
    weight: float
    """of sigma1^2 x3 in the variance (concentration over the campaign's highest)"""


@dataclass(frozen=True)
class Truth:
    """Shared parameters and noise for which a prediction is made; s, mL, V."""

    tau: float
    tau_v: float
    V: float
    phi: float
    sigma0: float
    sigma1: float
    noise: Noise
    interval: float
    """s, that phi refers to"""

    def settles(self, duration: float, total_flow: float) -> bool:
        """Whether the response to a step of a record of ``duration`` s is over at its end."""
        slowest = max(self.tau_v, self.V / total_flow, self.tau)
        return (END - BEGIN) * duration >= 6.0 * slowest


def settings_of(problem: Problem, vector: FloatArray) -> list[Setting]:
    """The campaign's experiments as settings, data left out."""
    settings = []
    for e in problem.campaign:
        y0, beta, t0, tf = local_parameters(vector, problem.layout, e.name)
        weight = problem.noise.weight(problem.campaign, e)
        settings.append(Setting(replace(e, y=None), y0, beta, t0, tf, weight))
    return settings


def truth_of(problem: Problem, vector: FloatArray) -> Truth:
    """Shared parameters of a flat vector; the first experiment's noise where each has its own."""
    phi, sigma0, sigma1 = (float(v) for v in vector[problem.layout.noise[0]])
    if not (np.isfinite(sigma0) and sigma0 > 0):
        raise CampaignError("theta lacks sigma0_V; a prediction needs the noise's size in volts")
    tau, tau_v, V = (float(v) for v in vector[:3])
    law = replace(problem.noise, per_experiment=False)
    return Truth(tau, tau_v, V, phi, sigma0, sigma1, law, problem.campaign.reference_interval)


def planned(
    name: str,
    total_flow: float,
    concentration: float,
    duration: float,
    interval: float,
    y0: float,
    beta: float,
    weight: float,
    delay: float = 0.0,
) -> Setting:
    """A step experiment of ``duration`` s: up at 20 %, down at 60 % of it (mL/s, fraction, s, V).

    The valve answers ``delay`` s after its commands.
    """
    t: FloatArray = interval * np.arange(max(round(duration / interval), 2), dtype=float)
    on, off = BEGIN * duration, END * duration
    e = Experiment(
        name, t, None, (1.0 - concentration) * total_flow, concentration * total_flow, interval,
        on, off,
    )  # fmt: skip
    return Setting(e, y0, beta, on + delay, off + delay, weight)
