"""The posterior of a campaign: three samplers behind one call, convergence, and the record.

* ``emcee``: affine-invariant ensembles (Goodman and Weare 2010; differential evolution moves,
  ter Braak 2006) in the coordinates of :mod:`bayes_sensor.posterior.laplace`, with every y0 and
  beta integrated out analytically and redrawn afterwards.
* ``independence``: Metropolis-Hastings whose proposal is the Laplace approximation, refitted to its
  draws where the Pareto k-hat of its weights is large; where that does not help, replaced by
  ``hmc``, if the gradient is compiled, and then ``emcee``.
* ``hmc``: Hamiltonian Monte Carlo (Neal 2011) in whitened coordinates from the analytic gradient.

Convergence is judged between independent runs (for emcee: independent ensembles, since walkers of
one ensemble are not independent chains).
"""

from bayes_sensor.posterior.convergence import ESS_LIMIT, R_HAT_LIMIT
from bayes_sensor.posterior.posterior import Posterior
from bayes_sensor.posterior.sample import fast_posterior, sample_posterior
from bayes_sensor.posterior.samplers import FASTEST, SAMPLERS, Run, Sampler, Target
from bayes_sensor.posterior.save_draws import load_chains
from bayes_sensor.posterior.settings import Progress, Settings

__all__ = [
    "ESS_LIMIT",
    "FASTEST",
    "R_HAT_LIMIT",
    "SAMPLERS",
    "Posterior",
    "Progress",
    "Run",
    "Sampler",
    "Settings",
    "Target",
    "fast_posterior",
    "load_chains",
    "sample_posterior",
]
