"""Independence Metropolis with the Laplace approximation as proposal, if its Pareto k-hat is
small, or can be made so by fitting it to its own draws."""

from __future__ import annotations

from typing import Any

import numpy as np

from bayes_sensor.campaign import FloatArray
from bayes_sensor.posterior.convergence import enough, out_of_reach
from bayes_sensor.posterior.laplace import Laplace, log_posteriors_and_likelihoods
from bayes_sensor.posterior.r_hat import pareto_k
from bayes_sensor.posterior.samplers.sampler import Run, Sampler, Target

K_HAT_LIMIT = 0.5
WIDER = 1.08
"""times the covariance, for the weights to be bounded"""
WIDER_REFITTED = 1.35
"""the same where k-hat was too large: the posterior has longer tails than a Gaussian"""
MOST_REFITS = 5
"""of the proposal; each costs the draws of one round"""


def run_independence(target: Target) -> Run:
    """Chains whose proposals are draws of the Laplace approximation, or of one fitted to its draws.

    Where k-hat is too large the approximation is refitted to its own draws by their weights, and
    the chains begin anew (adaptive importance sampling: Cappe et al., J. Comput. Graph. Stat. 13,
    2004); each run of chains has one fixed proposal.
    """
    proposal = target.laplace
    for refits in range(MOST_REFITS + 1):
        run, thetas, log_weights = _chains(target, proposal, refits)
        if run.good or not np.isfinite(log_weights).any():
            break
        proposal = proposal.refitted(thetas, log_weights)
    return run


def _chains(target: Target, proposal: Laplace, refits: int) -> tuple[Run, FloatArray, FloatArray]:
    """Chains by one proposal; also all that was proposed (n, n_theta) and its log weights (n,)."""
    problem, settings = target.problem, target.settings
    rngs = [np.random.default_rng(s) for s in target.streams.spawn(settings.n_chains)]
    n_theta = len(problem.layout)
    chains = [np.empty((0, n_theta + len(problem.campaign))) for _ in rngs]
    states: list[Any] = [None] * len(rngs)
    proposed: list[FloatArray] = []
    weights: list[FloatArray] = []
    accepted = tried = looked = 0
    n = settings.n_draws
    while True:
        for j, rng in enumerate(rngs):
            extra = 1 if states[j] is None else 0
            thetas, log_q = proposal.draw(n + extra, rng, WIDER_REFITTED if refits else WIDER)
            density, each = log_posteriors_and_likelihoods(
                target.compressed, proposal.coordinates, thetas, roots=True
            )
            log_w = density - log_q
            proposed.append(thetas)
            weights.append(log_w)
            # theta and its log-likelihoods travel together
            thetas = np.concatenate([thetas, each], axis=1)
            if states[j] is None:
                if not np.isfinite(log_w).any():
                    reason = (
                        "independence Metropolis was given up: no draw of the Laplace "
                        "approximation lies inside the priors"
                    )
                    return Run(np.empty((0, 0, 0)), False, reason, 0.0), thetas, log_w
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
        drawn = len(chains[0])
        # a look costs as much as all draws so far: later ones come a quarter further apart
        if drawn < min(1.25 * looked, settings.max_draws):
            continue
        looked = drawn
        every, every_w = np.concatenate(proposed), np.concatenate(weights)
        k_hat = pareto_k(every_w)
        acceptance = accepted / tried
        target.report(min(0.95, drawn / settings.max_draws), "independence Metropolis")
        stacked = np.stack(chains)[:, :, :n_theta]
        if k_hat >= K_HAT_LIMIT or acceptance < 0.1:
            reason = (
                f"independence Metropolis was given up{_refitted(refits)}: Pareto k-hat "
                f"{k_hat:.2f} (limit {K_HAT_LIMIT}), acceptance {acceptance:.2f}"
            )
            return Run(stacked, False, reason, acceptance, k_hat), every, every_w
        done, found = enough(problem, stacked, settings.target_ess)
        share = drawn / settings.max_draws
        slow = drawn >= 4 * n and out_of_reach(found, share, settings.target_ess)
        if done or slow or share >= 1.0:
            reason = (
                f"independence Metropolis from the Laplace approximation{_refitted(refits)}: "
                f"acceptance {acceptance:.2f}, Pareto k-hat {k_hat:.2f} (trusted below "
                f"{K_HAT_LIMIT}), {settings.n_chains} independent chains compared"
            )
            if not done:
                reason += "; it did not reach its target and was given up"
            likelihood = np.stack(chains)[:, :, n_theta:]
            run = Run(stacked, done, reason, acceptance, k_hat, found, likelihood)
            return run, every, every_w


def _refitted(times: int) -> str:
    return f", refitted {times} time{'s' if times > 1 else ''} to its draws" if times else ""


SAMPLER = Sampler("independence", run_independence, rests_on_laplace=True)
