"""Equal-tailed quantiles of the posterior."""

from __future__ import annotations

import numpy as np

from bayes_sensor.bounds.bound import LEVELS, Bound
from bayes_sensor.bounds.context import Evidence
from bayes_sensor.bounds.methods.bound_method import BoundMethod


def posterior_intervals(evidence: Evidence) -> Bound:
    """Equal-tailed quantiles of the posterior draws; the estimate is their median.

    Its status has the posterior's warnings, lack of convergence first.
    """
    names = evidence.mean_names
    draws = np.asarray(evidence.posterior.draws)
    index = [evidence.problem.layout.index(name) for name in names]
    draws = draws[:, index]
    tails = [0.5 - 0.5 * level for level in LEVELS.values()]
    low = np.quantile(draws, tails, axis=0).T
    high = np.quantile(draws, [1.0 - tail for tail in tails], axis=0).T
    return Bound(
        names,
        np.median(draws, axis=0),
        draws.std(axis=0, ddof=1),
        low,
        high,
        status="; ".join(getattr(evidence.posterior, "warnings", ())) or "ok",
        details={"n_draws": len(draws)},
    )


METHOD = BoundMethod(
    name="posterior",
    label="posterior",
    assumes="{noise} and the priors",
    compute=posterior_intervals,
    reference="Gelman et al., Bayesian Data Analysis (2013), ch. 2",
    noise="averaged",
    least_squares=False,
    both_orders=True,
    needs_posterior=True,
)
