"""The samplers, one per file, and the registry that names them.

A sampler of your own is a :class:`Sampler`; ``SAMPLERS[SAMPLER.name] = SAMPLER`` lets
``sample_posterior`` and ``--sampler`` take it.
"""

from __future__ import annotations

from bayes_sensor.posterior.samplers import emcee_ensembles, hmc, independence
from bayes_sensor.posterior.samplers.sampler import Run, Sampler, Target

__all__ = ["DEFAULT", "FASTEST", "SAMPLERS", "TAKE_OVER", "Run", "Sampler", "Target"]

SAMPLERS: dict[str, Sampler] = {
    module.SAMPLER.name: module.SAMPLER for module in (emcee_ensembles, independence, hmc)
}
"""every sampler by name"""
DEFAULT = emcee_ensembles.SAMPLER.name
FASTEST = independence.SAMPLER.name
"""for studies that sample hundreds of posteriors"""
TAKE_OVER = (hmc.SAMPLER, emcee_ensembles.SAMPLER)
"""what replaces a sampler that was given up, the most robust last"""
