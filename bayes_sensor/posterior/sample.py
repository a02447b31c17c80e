"""Sampling of a posterior: which sampler runs, and which one replaces it."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from importlib import import_module
from pathlib import Path
from time import perf_counter
from typing import Any

import numpy as np

from bayes_sensor.campaign import Campaign, CampaignError, FloatArray
from bayes_sensor.fit import Fit, fit_least_squares, refit
from bayes_sensor.fit.fitted_noise import all_residuals
from bayes_sensor.fit.identifiability import cannot_tell
from bayes_sensor.fit.side_information import stated_laws, weigh_names, without_contradicted
from bayes_sensor.io.given_options import record_of
from bayes_sensor.likelihood.problem import Problem, as_problem
from bayes_sensor.posterior.agreement import Agreement, r_hat_between
from bayes_sensor.posterior.convergence import MESH_ERROR_LIMIT, diagnose
from bayes_sensor.posterior.laplace import approximate
from bayes_sensor.posterior.posterior import Posterior
from bayes_sensor.posterior.samplers import (
    DEFAULT,
    FASTEST,
    SAMPLERS,
    TAKE_OVER,
    Run,
    Sampler,
    Target,
)
from bayes_sensor.posterior.settings import Progress, Settings
from bayes_sensor.posterior.valve_manifold_swap import flow_of_both, likelier_order
from bayes_sensor.residuals import noise_doubt
from bayes_sensor.rig.layout import Layout
from bayes_sensor.rig.named_values import by_flat_name
from bayes_sensor.workers import one_thread

MESHES = 3
"""how often a run may be repeated with narrower blocks if the mesh is too coarse"""


@one_thread
def sample_posterior(
    campaign: Campaign | Problem,
    fit: Any = None,
    seed: int = 1,
    sampler: str = DEFAULT,
    settings: Settings | Mapping[str, Any] | None = None,
    jobs: int = 1,
    checkpoint: str | Path | None = None,
    resume: bool = False,
    progress: Progress | None = None,
    with_effect: Any = (),
    begin: Posterior | None = None,
) -> Posterior:
    """Draws from the posterior of every parameter, with ``converged`` and ``status``.

    Parameters
    ----------
    fit
        where to start: a Fit (its ``theta_hat``), or anything that ``theta`` may be; None fits
        first.  A vector of the cascade also serves a model with further parameters: these are
        fitted from there.  A Fit of another model is replaced by one of this.
    sampler
        a key of :data:`SAMPLERS`; :mod:`bayes_sensor.posterior` describes each.
    settings
        a :class:`Settings`, or its options by name: ``{"n_draws": 100}``.
    jobs
        processes for emcee's ensembles; the numbers do not depend on it.
    checkpoint, resume
        folder for emcee's unfinished ensembles; with ``resume`` a matching run goes on from there
        and gives the chain that an uninterrupted run would have given.
    with_effect
        effects that the model gets, each with its strengths as further parameters: a name of the
        catalogue (``"baseline_drift"``, or ``"baseline_drift:own"`` for one of its forms), an
        Effect of one's own (:func:`bayes_sensor.own_effect`) or one of its forms; one, or a list.
        Their priors are scaled to the fit.  A model of another kind is given as a Problem.
    begin
        a converged posterior of the same problem by another sampler: emcee begins from its draws,
        drops none of its own, and says whether it agrees with them (``agreement``).

    Raises
    ------
    CampaignError
        For a design, an unknown sampler or effect, a malformed start, or data that allow no
        interval at all: too few samples, one level only, no noise.
    """
    problem = as_problem(campaign)
    if sampler not in SAMPLERS:
        raise CampaignError(f"sampler must be one of {', '.join(SAMPLERS)}, but is '{sampler}'")
    if with_effect:
        if fit is None:
            fit = fit_least_squares(problem, seed=seed, euler=False)
        problem = _with_effects(problem, with_effect, getattr(fit, "theta_hat", fit))
    found = _sampled(
        problem, fit, seed, _replaced, SAMPLERS[sampler], settings, jobs,
        None if checkpoint is None else Path(checkpoint), resume, progress, begin,
    )  # fmt: skip
    assert found is not None  # the last of the samplers takes anything
    return found


@one_thread
def fast_posterior(
    campaign: Campaign | Problem,
    fit: Any = None,
    seed: int = 1,
    settings: Settings | Mapping[str, Any] | None = None,
    progress: Progress | None = None,
) -> Posterior | None:
    """Draws by independence Metropolis, else by Hamiltonian Monte Carlo; None where both were given
    up.

    Parameters and errors as of :func:`sample_posterior`, which then takes emcee.
    """
    return _sampled(
        as_problem(campaign), fit, seed, _fast, SAMPLERS[FASTEST], settings, progress=progress,
    )  # fmt: skip


def _sampled(
    problem: Problem,
    fit: Any,
    seed: int,
    run_by: Callable[[Sampler, Target], tuple[str, Run, list[str]]],
    chosen: Sampler,
    given: Settings | Mapping[str, Any] | None,
    jobs: int = 1,
    checkpoint: Path | None = None,
    resume: bool = False,
    progress: Progress | None = None,
    begin: Posterior | None = None,
) -> Posterior | None:
    """The posterior as ``run_by`` draws it; None where that draws nothing good."""
    started = perf_counter()
    settings = record_of(Settings, given, "settings")
    if problem.campaign.is_design:
        raise CampaignError("a design has no data to condition on; simulate or measure it first")
    report = progress or (lambda fraction, text: None)
    if fit is None or (isinstance(fit, Fit) and len(fit.theta_hat) != len(problem.layout)):
        fit = fit_least_squares(problem, seed=seed)  # misfit and noise are those of this model
    problem.prior_table  # noqa: B018 - raises CampaignError where a parameter has no prior
    start = problem.by_size(start_vector(problem, getattr(fit, "theta_hat", fit)))
    mute = fit.cannot_tell if isinstance(fit, Fit) else _cannot_tell(problem, start)
    if mute:
        raise CampaignError(f"no interval can be given: {mute}")
    caveats = list(getattr(fit, "caveats", ()))
    compared = getattr(fit, "side_information", ())
    if isinstance(fit, Fit) and fit.step_seen:
        if {each.name: each.law for each in compared} != stated_laws(problem):
            _, compared = weigh_names(problem, start)  # the fit knew of other priors
            said = [each.sentence() for each in compared if each.contradicts]
            caveats += [sentence for sentence in said if sentence not in caveats]
    # what the data contradict is reported and left out
    problem = without_contradicted(problem, compared)
    # at equal flows lags have no names yet, at flows that are nearly so ensembles exchange them
    apart = problem.flow is None and flow_of_both(problem) is None
    twin = fit.twin if isinstance(fit, Fit) and apart else ""
    start, both = likelier_order(problem, start)
    report(0.0, "Laplace approximation")
    laplace, compressed = approximate(problem, start)
    usable = begin is not None and begin.converged and begin.layout.names == problem.layout.names
    chains = begin.chains if begin is not None and usable else None
    for _ in range(MESHES):
        target = Target(
            problem, start, laplace, compressed, settings, seed, np.random.SeedSequence(seed),
            report, jobs, checkpoint, resume, chains, both,
        )  # fmt: skip
        drew, run, reasons = run_by(chosen, target)
        if not run.good:
            return None
        compressed = run.compressed or compressed
        draws = run.chains.reshape(-1, len(problem.layout))
        few = draws[:: max(1, len(draws) // 6)][:6]
        error = compressed.error(few)
        if error <= MESH_ERROR_LIMIT:
            break
        finer = compressed.accurate(few, MESH_ERROR_LIMIT)
        if finer.error(few) > MESH_ERROR_LIMIT:
            break  # narrower blocks do not help, so another run would not; it is said
        compressed = finer
    agreement = None
    if begin is not None and chains is not None:
        between = run.between
        if between is None:
            between = r_hat_between(problem, chains, run.chains)
        local = begin.names[begin.layout.n_shared :]
        rows = {name: row for name, row in begin.rows.items() if name not in local}
        agreement = Agreement(begin.sampler, between, rows)
        reasons.append(agreement.sentence(drew))
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
        caveats=tuple(caveats),
        hidden_by_sampling=getattr(fit, "hidden_by_sampling", None),
        remarks=(f"{twin}; the draws are about one of the two",) if twin else (),
        doubts=tuple(text for text in [noise_doubt(problem, start)] if text),
        agreement=agreement,
    )


def _fast(chosen: Sampler, target: Target) -> tuple[str, Run, list[str]]:
    """As :func:`_replaced`, without the last and slowest; no good where two orders of lags are both
    likely, which the fast ones do not exchange."""
    if target.both is not None:
        return chosen.name, Run(np.empty((0, 0, 0)), False, "", 0.0), []
    return _first_good([chosen, *TAKE_OVER[:-1]], target, [])


def _replaced(chosen: Sampler, target: Target) -> tuple[str, Run, list[str]]:
    """The name and the draws of ``chosen``, or of its replacement, and the reasons in sentences."""
    reasons: list[str] = []
    if target.both is not None:
        reasons.append(
            "valve and manifold may be either way round by data and priors: ensembles exchange them"
        )
        chosen = chosen if chosen.exchanges_orders else TAKE_OVER[-1]
    later = TAKE_OVER[TAKE_OVER.index(chosen) + 1 :] if chosen in TAKE_OVER else TAKE_OVER
    return _first_good([chosen, *later], target, reasons)


def _first_good(
    samplers: Sequence[Sampler], target: Target, reasons: list[str]
) -> tuple[str, Run, list[str]]:
    """The name and the draws of the first that is not given up, or of the last, with reasons."""
    chosen, run = samplers[0], samplers[0].run(target)
    reasons.append(run.reason)
    for other in samplers[1:]:
        if run.good:
            break
        # where the Laplace approximation has no overlap with the priors, its scales mislead
        if other.rests_on_laplace and not len(run.chains):
            continue
        if other.by_gradient and not target.compressed.has_compiled_gradient:
            continue
        chosen, run = other, other.run(target)
        reasons.append(run.reason)
    return chosen.name, run, reasons


def _cannot_tell(problem: Problem, start: FloatArray) -> str:
    """Why no interval can be given, from the residuals at ``start`` (n_theta,)."""
    return cannot_tell(problem, start, all_residuals(problem, start)[0])


def _with_effects(problem: Problem, effects: Any, given: Any) -> Problem:
    """The problem with effects in its model, their priors scaled to what is given of theta."""
    # imported when called: the catalogue needs this room first
    room = import_module("bayes_sensor.diagnosis.effects.effect_model")
    effects = room.listed(effects, "with_effect")
    made: Problem = room.with_effects(problem, effects)
    theta = made.by_size(_complete(made.layout, given))
    made = room.with_effects(problem, effects, theta)
    return made


def _complete(layout: Layout, given: Any) -> FloatArray:
    """The flat vector (n_theta,); zero for a model's own parameters where they are not given."""
    if isinstance(given, Mapping):
        return layout.flat({**dict.fromkeys(layout.extra, 0.0), **given})
    if np.shape(given) == (len(layout),):
        return layout.flat(given)
    return np.concatenate([replace(layout, extra=()).flat(given), np.zeros(len(layout.extra))])


def start_vector(problem: Problem, given: Any) -> FloatArray:
    """The flat vector to start from; a model's own parameters are fitted where it lacks them."""
    layout = problem.layout
    if isinstance(given, Mapping):
        lacks = not by_flat_name(given).keys() >= set(layout.extra)
    else:
        lacks = np.shape(given) != (len(layout),)
    if not layout.extra or not lacks:
        return layout.flat(given)
    vector = _complete(layout, given)
    n = len(layout) - len(layout.extra)
    found, _ = refit(problem, vector[:n])
    vector[: layout.n_mean] = found[: layout.n_mean]
    vector[n:] = found[layout.n_mean :]
    return vector
