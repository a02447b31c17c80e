"""Sampling of a posterior: which sampler runs, and which one replaces it."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import replace
from pathlib import Path
from time import perf_counter
from typing import Any

import numpy as np

from bayes_sensor.campaign import Campaign, CampaignError, FloatArray
from bayes_sensor.fit import Fit, fit_least_squares, refit
from bayes_sensor.fit.fitted_noise import all_residuals
from bayes_sensor.fit.identifiability import cannot_tell
from bayes_sensor.fit.side_information import without_contradicted
from bayes_sensor.likelihood.problem import Problem, as_problem
from bayes_sensor.posterior.convergence import MESH_ERROR_LIMIT, diagnose
from bayes_sensor.posterior.laplace import approximate
from bayes_sensor.posterior.posterior import Posterior
from bayes_sensor.posterior.samplers import (
    DEFAULT,
    SAMPLERS,
    TAKE_OVER,
    Run,
    Sampler,
    Target,
)
from bayes_sensor.posterior.settings import Progress, Settings
from bayes_sensor.posterior.valve_manifold_swap import flow_of_both, likelier_order
from bayes_sensor.residuals import noise_doubt
from bayes_sensor.workers import one_thread

MESHES = 3
"""how often a run may be repeated with narrower blocks if the mesh is too coarse"""


@one_thread
def sample_posterior(
    campaign: Campaign | Problem,
    fit: Any = None,
    seed: int = 1,
    sampler: str = DEFAULT,
    settings: Settings | None = None,
    jobs: int = 1,
    checkpoint: str | Path | None = None,
    resume: bool = False,
    progress: Progress | None = None,
    with_effect: Iterable[Any] = (),
) -> Posterior:
    """Draws from the posterior of every parameter, with ``converged`` and ``status``.

    Parameters
    ----------
    fit
        where to start: a Fit (its ``theta_hat``), or anything that ``theta`` may be; None fits
        first.  A fit of the cascade also serves a model with further parameters: these are
        fitted from there.
    sampler
        a key of :data:`SAMPLERS`; :mod:`bayes_sensor.posterior` describes each.
    jobs
        processes for emcee's ensembles; the numbers do not depend on it.
    checkpoint, resume
        folder for emcee's unfinished ensembles; with ``resume`` a matching run goes on from there
        and gives the chain that an uninterrupted run would have given.
    with_effect
        objects whose ``apply(problem)`` returns a changed Problem, applied in this order.

    Raises
    ------
    CampaignError
        For a design, an unknown sampler, a malformed start, or data that allow no interval at all:
        too few samples, one level only, no noise.
    """
    started = perf_counter()
    problem = as_problem(campaign)
    for effect in with_effect:
        problem = effect.apply(problem)
    settings = settings or Settings()
    if sampler not in SAMPLERS:
        raise CampaignError(f"sampler must be one of {', '.join(SAMPLERS)}, but is '{sampler}'")
    if problem.campaign.is_design:
        raise CampaignError("a design has no data to condition on; simulate or measure it first")
    report = progress or (lambda fraction, text: None)
    if fit is None:
        fit = fit_least_squares(problem, seed=seed)
    # side information that the data contradict is reported and left out
    problem = without_contradicted(problem, getattr(fit, "side_information", ()))
    problem.prior_table  # noqa: B018 - raises CampaignError where a parameter has no prior
    start = problem.by_size(start_vector(problem, getattr(fit, "theta_hat", fit)))
    mute = fit.cannot_tell if isinstance(fit, Fit) else _cannot_tell(problem, start)
    if mute:
        raise CampaignError(f"no interval can be given: {mute}")
    # at equal flows lags have no names yet, at flows that are nearly so ensembles exchange them
    apart = problem.flow is None and flow_of_both(problem) is None
    twin = fit.twin if isinstance(fit, Fit) and apart else ""
    start, both = likelier_order(problem, start)
    report(0.0, "Laplace approximation")
    laplace, compressed = approximate(problem, start)
    for _ in range(MESHES):
        target = Target(
            problem, start, laplace, compressed, settings, seed, np.random.SeedSequence(seed),
            report, jobs, None if checkpoint is None else Path(checkpoint), resume, both,
        )  # fmt: skip
        drew, run, reasons = _run(SAMPLERS[sampler], target)
        compressed = run.compressed or compressed
        draws = run.chains.reshape(-1, len(problem.layout))
        few = draws[:: max(1, len(draws) // 6)][:6]
        error = compressed.error(few)
        if error <= MESH_ERROR_LIMIT:
            break
        compressed = compressed.accurate(few, MESH_ERROR_LIMIT)
    chains = run.chains
    r_hat, bulk, tail = run.diagnosis or diagnose(problem, chains)
    n_chain, n_draw, n_theta = chains.shape
    each = run.log_likelihood
    if each is None:
        each = compressed.log_likelihoods(chains.reshape(-1, n_theta))
    report(1.0, "done")
    return Posterior(
        problem=problem,
        chains=chains,
        log_likelihood=each.reshape(n_chain, n_draw, -1),
        sampler=drew,
        reasons=tuple(reasons),
        mesh_error=error,
        r_hat=r_hat,
        ess_bulk=bulk,
        ess_tail=tail,
        settings=settings,
        seed=seed,
        seconds=perf_counter() - started,
        k_hat=run.k_hat,
        acceptance=run.acceptance,
        caveats=getattr(fit, "caveats", ()),
        hidden_by_sampling=getattr(fit, "hidden_by_sampling", None),
        remarks=(f"{twin}; the draws are about one of the two",) if twin else (),
        doubts=tuple(text for text in [noise_doubt(problem, start)] if text),
    )


def _run(chosen: Sampler, target: Target) -> tuple[str, Run, list[str]]:
    """The name and the draws of ``chosen``, or of its replacement, and the reasons in sentences."""
    reasons: list[str] = []
    if target.both is not None:
        reasons.append(
            "valve and manifold may be either way round by data and priors: ensembles exchange them"
        )
        chosen = chosen if chosen.exchanges_orders else TAKE_OVER[-1]
    run = chosen.run(target)
    reasons.append(run.reason)
    later = TAKE_OVER[TAKE_OVER.index(chosen) + 1 :] if chosen in TAKE_OVER else TAKE_OVER
    for other in later:
        if run.good:
            break
        # where the Laplace approximation has no overlap with the priors, its scales mislead
        if other.rests_on_laplace and not len(run.chains):
            continue
        chosen, run = other, other.run(target)
        reasons.append(run.reason)
    return chosen.name, run, reasons


def _cannot_tell(problem: Problem, start: FloatArray) -> str:
    """Why no interval can be given, from the residuals at ``start`` (n_theta,)."""
    return cannot_tell(problem, start, all_residuals(problem, start)[0])


def start_vector(problem: Problem, given: Any) -> FloatArray:
    """The flat vector to start from; a model's own parameters are fitted where it lacks them."""
    layout = problem.layout
    bare = replace(layout, extra=())
    if isinstance(given, Mapping):
        lacks = any(name not in given for name in layout.extra if not name.endswith("]"))
    else:
        lacks = np.shape(given) != (len(layout),)
    if not layout.extra or not lacks:
        return layout.flat(given)
    if isinstance(given, Mapping):
        theta = layout.flat({**dict.fromkeys(layout.extra, 0.0), **given})[: len(bare)]
    else:
        theta = bare.flat(given)
    vector = np.concatenate([theta, np.zeros(len(layout.extra))])
    found, _ = refit(problem, theta)
    vector[: layout.n_mean] = found[: layout.n_mean]
    vector[len(bare) :] = found[layout.n_mean :]
    return vector
