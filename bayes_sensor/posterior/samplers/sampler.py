"""The record of a sampler, what it is given and what it returns."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from bayes_sensor.campaign import FloatArray
from bayes_sensor.likelihood.mesh import Compressed
from bayes_sensor.likelihood.problem import Problem
from bayes_sensor.posterior.laplace import Laplace
from bayes_sensor.posterior.settings import Progress, Settings


@dataclass(frozen=True, eq=False)
class Target:
    """The posterior to sample, and how."""

    problem: Problem
    start: FloatArray
    """(n_theta,) near the maximum, lags by size"""
    laplace: Laplace
    """the Gaussian approximation at the maximum"""
    compressed: Compressed
    """the likelihood on its mesh"""
    settings: Settings
    seed: int
    streams: np.random.SeedSequence
    """of ``seed``; a sampler that takes over goes on with the children that are left"""
    report: Progress
    jobs: int = 1
    """processes allowed; the draws must not depend on it"""
    checkpoint: Path | None = None
    """folder for an unfinished run"""
    resume: bool = False
    begin: FloatArray | None = None
    """(n_chain, n_draw, n_theta) draws of the same posterior to begin from"""
    both: float | None = None
    """flow (mL/s) at which tau_v and V/Q swap, where both orders are likely; else None"""


@dataclass(frozen=True, eq=False)
class Run:
    """The draws of one sampler, and whether they are valid."""

    chains: FloatArray
    """(n_chain, n_draw, n_theta); empty where there was no start"""
    good: bool
    """False: another sampler takes over"""
    reason: str
    """a sentence: how it sampled, or why it was given up"""
    acceptance: float
    k_hat: float | None = None
    diagnosis: tuple[FloatArray, FloatArray, FloatArray] | None = None
    """R-hat, bulk and tail ESS (n_theta,) where the sampler has worked them out"""
    log_likelihood: FloatArray | None = None
    """(n_chain, n_draw, n_experiment) where the sampler has kept it"""
    compressed: Compressed | None = None
    """the mesh at the end, if it changed"""
    between: FloatArray | None = None
    """(n_theta,) R-hat between the draws that it began from and its own, if it compares them"""


@dataclass(frozen=True, eq=False)
class Sampler:
    """A way to draw from a posterior."""

    name: str
    """what ``sampler=`` and ``--sampler`` take, and ``posterior.json`` says"""
    run: Callable[[Target], Run]
    by_gradient: bool = False
    """whether its steps take gradients, so that it takes over only where these are compiled"""
    rests_on_laplace: bool = False
    """whether the Laplace approximation sets its scales, so that it is not tried where no draw of
    that approximation lies inside the priors"""
    exchanges_orders: bool = False
    """whether its chains cross between the two orders of lags that are both likely"""
