"""Independence Metropolis with the Laplace approximation as proposal, if its Pareto k-hat is
small."""

from __future__ import annotations

from typing import Any

import numpy as np

from bayes_sensor.campaign import FloatArray
from bayes_sensor.posterior.convergence import enough
from bayes_sensor.posterior.laplace import log_posteriors_and_likelihoods
from bayes_sensor.posterior.r_hat import pareto_k
from bayes_sensor.posterior.samplers.sampler import Run, Sampler, Target

K_HAT_LIMIT = 0.5


def run_independence(target: Target) -> Run:
    """Chains whose proposals are draws of the Laplace approximation."""
    problem, laplace, settings = target.problem, target.laplace, target.settings
    rngs = [np.random.default_rng(s) for s in target.streams.spawn(settings.n_chains)]
    n_theta = len(problem.layout)
    chains = [np.empty((0, n_theta + len(problem.campaign))) for _ in rngs]
    states: list[Any] = [None] * len(rngs)
    weights: list[FloatArray] = []
    accepted = tried = 0
    n = settings.n_draws
    while True:
        for j, rng in enumerate(rngs):
            extra = 1 if states[j] is None else 0
            thetas, log_q = laplace.draw(n + extra, rng, inflate=1.08)
            density, each = log_posteriors_and_likelihoods(
                target.compressed, laplace.coordinates, thetas, roots=True
            )
            log_w = density - log_q
            # theta and its log-likelihoods travel together
            thetas = np.concatenate([thetas, each], axis=1)
            weights.append(log_w)
            if states[j] is None:
                if not np.isfinite(log_w).any():
                    reason = (
                        "independence Metropolis was given up: no draw of the Laplace "
                        "approximation lies inside the priors"
                    )
                    return Run(np.empty((0, 0, 0)), False, reason, 0.0)
                start = int(np.argmax(np.isfinite(log_w)))
                states[j] = (thetas[start], log_w[start])
                thetas, log_w = np.delete(thetas, start, axis=0), np.delete(log_w, start)
            current, current_w = states[j]
            out = np.empty((n, thetas.shape[1]))
            log_u = np.log(rng.random(n))
            for i in range(n):
                if log_u[i] < log_w[i] - current_w:
                    current, current_w = thetas[i], log_w[i]
                    accepted += 1
                out[i] = current
            tried += n
            states[j] = (current, current_w)
            chains[j] = np.concatenate([chains[j], out])
        k_hat = pareto_k(np.concatenate(weights))
        acceptance = accepted / tried
        target.report(min(0.95, len(chains[0]) / settings.max_draws), "independence Metropolis")
        stacked = np.stack(chains)[:, :, :n_theta]
        if k_hat >= K_HAT_LIMIT or acceptance < 0.1:
            reason = (
                f"independence Metropolis was given up: Pareto k-hat {k_hat:.2f} "
                f"(limit {K_HAT_LIMIT}), acceptance {acceptance:.2f}"
            )
            return Run(stacked, False, reason, acceptance, k_hat)
        done, found = enough(problem, stacked, settings.target_ess)
        if done or len(chains[0]) >= settings.max_draws:
            reason = (
                f"independence Metropolis from the Laplace approximation: acceptance "
                f"{acceptance:.2f}, Pareto k-hat {k_hat:.2f} (trusted below {K_HAT_LIMIT}), "
                f"{settings.n_chains} independent chains compared"
            )
            likelihood = np.stack(chains)[:, :, n_theta:]
            return Run(stacked, True, reason, acceptance, k_hat, found, likelihood)


SAMPLER = Sampler("independence", run_independence, rests_on_laplace=True)
