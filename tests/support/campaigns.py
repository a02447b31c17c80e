"""Designs and small simulated campaigns that several tests share."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from bayes_sensor.campaign import Campaign, Experiment, FloatArray
from bayes_sensor.likelihood.density import simulate
from bayes_sensor.likelihood.noise import Noise
from bayes_sensor.likelihood.problem import Problem

LITRES_PER_MINUTE = 1000.0 / 60.0  # mL/s

# Tables I and II of the paper: N2 and CO2 flow (L/min), y0 and beta (V), t0 and tf (s).
PUBLISHED = {
    "1": (4.0, 0.5, 0.296, 1.78, 24.6699, 83.8527),
    "2": (3.0, 0.5, 0.267, 1.92, 20.3555, 79.3072),
    "3": (2.5, 0.5, 0.263, 2.13, 25.3647, 84.7885),
    "4": (8.0, 1.0, 0.219, 1.41, 31.0635, 89.5093),
    "5": (6.0, 1.0, 0.194, 1.88, 29.3724, 88.9165),
    "6": (5.0, 1.0, 0.175, 2.11, 30.1734, 89.9908),
    "7": (7.5, 1.5, 0.121, 1.85, 24.5127, 84.1776),
}


def paper_design(interval: float = 1e-3) -> Campaign:
    """The paper's seven experiments, 120 s each, without data; commanded half a second early."""
    t = np.arange(round(120.0 / interval)) * interval
    experiments = [
        Experiment(
            name=name,
            t=t,
            y=None,
            carrier_flow=carrier * LITRES_PER_MINUTE,
            test_gas_flow=test_gas * LITRES_PER_MINUTE,
            interval=interval,
            commanded_on=t0 - 0.5,
            commanded_off=tf - 0.5,
        )
        for name, (carrier, test_gas, _, _, t0, tf) in PUBLISHED.items()
    ]
    return Campaign("published design", tuple(experiments), sensor_is="faster")


def paper_theta(phi: float = 0.0, sigma0: float = 0.0653, sigma1: float = 0.0) -> dict[str, Any]:
    """The published estimates with noise parameters."""
    return {
        "tau_s": 0.0481,
        "tau_v_s": 0.8577,
        "V_mL": 58.23,
        "phi": phi,
        "sigma0_V": sigma0,
        "sigma1_V": sigma1,
        "experiments": {
            name: {"y0_V": y0, "beta_V": beta, "t0_s": t0, "tf_s": tf}
            for name, (_, _, y0, beta, t0, tf) in PUBLISHED.items()
        },
    }


def small_design(
    n: int = 2,
    interval: float | Sequence[float] = 0.01,
    duration: float = 12.0,
    fall: bool | Sequence[bool] = True,
    masked: Sequence[tuple[float, float]] = (),
) -> Campaign:
    """A rig ten times smaller: V/Q of 0.1 to 0.2 s, steps at 2 s and 7 s of every record."""
    intervals = [interval] * n if isinstance(interval, float) else list(interval)
    falls = [fall] * n if isinstance(fall, bool) else list(fall)
    experiments = []
    for k in range(n):
        t = np.arange(round(duration / intervals[k])) * intervals[k]
        used = np.ones(len(t), dtype=bool)
        for low, high in masked:
            used &= ~((t >= low) & (t < high))
        experiments.append(
            Experiment(
                name="abcdefgh"[k],
                t=t,
                y=None,
                carrier_flow=60.0 + 30.0 * k,
                test_gas_flow=10.0 + 10.0 * k,
                interval=intervals[k],
                commanded_on=1.8,
                commanded_off=6.8 if falls[k] else None,
                mask=used,
            )
        )
    return Campaign("small", tuple(experiments), sensor_is="faster")


def small_theta(
    campaign: Campaign,
    phi: float = 0.5,
    sigma0: float = 0.02,
    sigma1: float = 0.02,
    tau: float = 0.1,
) -> dict[str, Any]:
    """Parameters for :func:`small_design`; switch times off the sampling grid."""
    experiments = {}
    for k, e in enumerate(campaign):
        values = {"y0_V": 0.1 + 0.05 * k, "beta_V": 1.5 - 0.2 * k, "t0_s": 2.0037 + 0.02 * k}
        if e.has_fall:
            values["tf_s"] = 7.0011 + 0.03 * k
        experiments[e.name] = values
    return {
        "tau_s": tau,
        "tau_v_s": 0.3,
        "V_mL": 14.0,
        "phi": phi,
        "sigma0_V": sigma0,
        "sigma1_V": sigma1,
        "experiments": experiments,
    }


def small_problem(
    phi: float = 0.5,
    seed: int = 1,
    noise: Noise | None = None,
    tau: float = 0.1,
    sigma: float = 0.02,
    sigma1: float | None = None,
    **design: Any,
) -> tuple[Problem, FloatArray]:
    """A simulated small campaign as a Problem, and the flat vector it was drawn at.

    One experiment alone does not tell tau_v from V; a posterior wants two flows at least.
    """
    campaign = small_design(**design)
    problem = Problem(campaign, noise=noise or Noise())
    theta = small_theta(campaign, phi, sigma, sigma if sigma1 is None else sigma1, tau)
    theta.update(problem.noise.fixed)
    problem = replace(problem, campaign=simulate(problem, theta, seed=seed))
    return problem, problem.layout.flat(theta)


def dense_covariance(problem: Problem, theta: FloatArray, k: int) -> FloatArray:
    """(n_used, n_used) covariance of experiment number ``k``, from the definition of the noise."""
    e = problem.campaign.experiments[k]
    phi, sigma0, sigma1 = theta[problem.layout.noise[k]]
    x = problem.model.response(e.t[e.used], theta, problem.layout, e)
    weight = {
        "concentration": e.concentration / max(o.concentration for o in problem.campaign),
        "signal": 1.0,
        "constant": 0.0,
        "levels": e.concentration / max(o.concentration for o in problem.campaign),
    }[problem.noise.variance]
    share = weight * np.maximum(x, 0.0)
    rest = 1.0 - share if problem.noise.variance == "levels" else 1.0
    s = np.sqrt(sigma0**2 * rest + sigma1**2 * share)
    lags = np.abs(np.subtract.outer(e.t[e.used], e.t[e.used])) / problem.campaign.reference_interval
    if phi < 0:  # a real power exists for whole lags only
        correlation = np.where(np.round(lags) % 2 == 0, 1.0, -1.0) * abs(phi) ** np.round(lags)
    else:
        correlation = phi**lags
    return correlation * np.outer(s, s)
