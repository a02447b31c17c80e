"""How to sample."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

from bayes_sensor.campaign import CampaignError
from bayes_sensor.display import record_card

Progress = Callable[[float, str], None]
"""called with the fraction done and a short text"""


@dataclass(frozen=True)
class Settings:
    """Settings of the samplers.  The defaults suit campaigns of any size."""

    _repr_html_ = record_card

    n_chains: int = 4
    """independent runs (ensembles for emcee)"""
    n_walkers: int = 64
    """walkers of each ensemble; raised to twice the dimension where that is more"""
    chunk: int = 100
    """ensemble steps between checkpoints and convergence checks"""
    burn_in: int = 100
    """ensemble steps dropped at the start (walkers start from the Laplace approximation)"""
    max_steps: int = 3000
    """ensemble steps at which to give up"""
    thin: int = 5
    """ensemble steps from one draw that is kept to the next"""
    n_draws: int = 400
    """draws of each chain of the independence sampler and hmc"""
    max_draws: int = 16000
    """draws of each of their chains at which to give up"""
    target_ess: float = 1000.0
    """bulk ESS at which a run may stop; convergence itself asks for 400 in bulk and tail"""

    def __post_init__(self) -> None:
        for name in ("n_chains", "n_walkers", "chunk", "max_steps", "thin", "n_draws"):
            if getattr(self, name) < (2 if name == "n_chains" else 1):
                raise CampaignError(f"sampler setting {name} is too small: {getattr(self, name)}")
