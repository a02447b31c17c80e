"""Fit of a campaign: swarms, starts along the valley, refinement on the mesh."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from math import sqrt
from typing import Any

import numpy as np
from scipy import optimize

from bayes_sensor.campaign import Campaign, FloatArray
from bayes_sensor.fit.block_averages import Points, averages, scatter
from bayes_sensor.fit.caveats import caveats, hiding_interval
from bayes_sensor.fit.first_estimates import Look, first_look, initial_bounds, typical_rise
from bayes_sensor.fit.fit import Fit, Progress
from bayes_sensor.fit.fit_warnings import at_bounds, bound_warnings, unseen_lags, warn
from bayes_sensor.fit.fitted_noise import all_residuals, estimate_noise, mean_square
from bayes_sensor.fit.identifiability import cannot_tell, step_is_seen
from bayes_sensor.fit.inseparable import inseparable, volumes_in_order
from bayes_sensor.fit.misfit import misfits, overall
from bayes_sensor.fit.refinement import Refined, around, mesh_points, refine, with_noise
from bayes_sensor.fit.side_information import named_parameters, weigh_names
from bayes_sensor.fit.starts import SwarmProblem, limits
from bayes_sensor.fit.swarm import particle_swarm
from bayes_sensor.fit.twin import AS_GOOD, Twin, apart, other_orders, sensors_exchanged
from bayes_sensor.likelihood.problem import Problem, as_problem
from bayes_sensor.rig.cascade import Cascade
from bayes_sensor.rig.lags import Naming
from bayes_sensor.workers import one_thread

# Starts along the valley, as fractions of the rise time (10, 60, 200, 500 ms at the published rig).
TAU_STARTS = (0.005, 0.03, 0.1, 0.25)
GUESSES = (0.03, 0.1, 0.3, 1.0)
"""shares of the rise from which all lags start where no swarm searches"""


@dataclass
class Counted:
    """Refinements, with their evaluations counted for the record."""

    n: int = 0

    def refine(self, *args: Any, **options: Any) -> Refined:
        """What :func:`bayes_sensor.fit.refinement.refine` gives."""
        found = refine(*args, **options)
        self.n += found.n_evaluations
        return found


@one_thread
def fit_least_squares(
    campaign: Campaign | Problem,
    seed: int = 1,
    swarms: int = 3,
    particles: int = 40,
    bounds: Mapping[str, tuple[float, float]] | None = None,
    euler: bool = True,
    de: bool = False,
    progress: Progress | None = None,
) -> Fit:
    """The parameters that minimise the summed squared error over all used samples.

    ``swarms`` independent particle swarms of ``particles`` each, then refinement; the same seed
    gives the same fit.  ``bounds`` (flat name to low, high) replaces search bounds, which
    otherwise come from the records and the commanded times (``Fit.bounds``).  ``euler`` repeats the
    fit with forward Euler, ``de`` cross-checks the swarm by scipy's differential evolution.
    ``progress`` is called with a fraction and a word.

    A problem with another model than the cascade is fitted by refinement alone. It starts at the
    cascade's fit and the middle of the extra parameters' priors.

    Raises
    ------
    CampaignError
        For a design without data, or bounds that make no sense.
    """
    begin = time.perf_counter()
    problem = as_problem(campaign)
    for e in problem.campaign:
        e.values  # noqa: B018 - raises CampaignError for a design
    tell = progress or (lambda fraction, word: None)
    looks = [first_look(e) for e in problem.campaign]
    box = initial_bounds(problem, looks, bounds)
    count = Counted()
    exact = replace(problem, model=Cascade())
    plain = problem.chain is not None
    theta, success, record, check, other = _search(
        exact, looks, box, seed, swarms, particles, de, tell, count
    )
    theta = volumes_in_order(problem, theta)
    if not plain:
        other = None
        theta, success = refit(problem, theta, box, count)
    elif problem.chain == "euler":
        theta, success = _fit_euler(problem, theta, box, looks, count)
    vector = with_noise(problem.layout, theta)
    residuals, squares = all_residuals(problem, vector)
    tell(0.8, "noise")
    n = problem.campaign.n_samples
    cost = sum(squares)
    rms = sqrt(cost / n)
    for name, value in estimate_noise(problem, residuals, rms).items():
        vector[problem.layout.index(name)] = value
    unit = problem.campaign.signal_unit
    mute = cannot_tell(problem, vector, residuals)
    seen = step_is_seen(problem, vector, residuals)
    can_tell = seen and not mute
    vector = problem.flat(vector)
    box = {name: ends for name, ends in box.items() if name not in problem.held}
    naming, compared = weigh_names(problem, vector) if can_tell else (problem.naming(), ())
    shared = problem.layout.shared_names
    labels = dict(zip(shared, naming.names, strict=True))
    hidden = hiding_interval(problem, vector) if can_tell else None
    warnings = warn(problem, vector, residuals, looks, unit)
    at_bound = at_bounds(problem.layout, vector, box)
    unseen = unseen_lags(at_bound, vector, problem.layout, box, bounds or {})
    words = {name: label for name, (label, _) in zip(shared, naming.labels, strict=True)}
    warnings += bound_warnings(at_bound, box, vector, problem.layout, unit, words, unseen)
    if not record["agree"]:
        warnings.append(
            "Independent particle swarms ended in different places after refinement; "
            "the best is given."
        )
    comparison = None
    compares = euler and plain and not problem.held and problem.layout.is_published
    if compares and problem.model.method == "exact":
        tell(0.85, "Euler")
        comparison = _compare_euler(problem, theta, box, looks, rms, count, naming)
    tell(1.0, "done")
    status = "Converged." if success else "The refinement stopped before it converged."
    if success and at_bound:
        status = (
            f"Converged, with {', '.join(map(labels.get, at_bound, at_bound))} at a search bound."
        )
    if other is not None:
        phi = max(float(vector[problem.layout.noise[0, 0]]), 0.0)
        if other.excess >= AS_GOOD * rms**2 * (1.0 + phi) / (1.0 - phi):
            other = None
    one = inseparable(problem, vector, naming, other) if can_tell else ()
    warnings += [
        f"{each.sentence[:1].upper()}{each.sentence[1:]}." for each in one if each.kind == "warning"
    ]
    missed = misfits(problem, residuals, looks)
    noise, misfit = overall(problem, missed)
    if mute:
        warnings.insert(0, f"No interval can be given: {mute}.")
    if not seen:
        success = False
        status = (
            "No step is seen beyond what the model misses, in any experiment, so the time "
            "constants mean nothing."
        )
    return Fit(
        names=[labels.get(name, name) for name in problem.layout.names],
        theta_hat=vector,
        parameters={**problem.layout.nested(vector), **named_parameters(naming, vector)},
        rms=rms,
        rms_per_experiment={
            e.name: sqrt(s / e.n_samples) for e, s in zip(problem.campaign, squares)
        },
        n_samples=n,
        cost=cost,
        at_bound=[labels.get(name, name) for name in at_bound],
        bounds={labels.get(name, name): ends for name, ends in box.items()},
        converged=success,
        status=status,
        warnings=warnings,
        swarms=record,
        euler=comparison,
        de=check,
        n_evaluations=count.n,
        seconds=time.perf_counter() - begin,
        signal_unit=unit,
        phi_interval=problem.campaign.reference_interval,
        seed=seed,
        cannot_tell=mute,
        twin="" if other is None else other.sentence(),
        step_seen=seen,
        unseen=tuple(labels[name] for name in unseen),
        naming=naming,
        side_information=compared,
        hidden_by_sampling=hidden,
        caveats=(
            *caveats(problem, vector, residuals, missed, compared, hidden),
            *(each.sentence for each in one if each.kind == "caveat"),
        ),
        inseparable=one,
        noise=noise,
        misfit=misfit,
        misfit_per_experiment={name: each.ratio for name, each in missed.items()},
    )


def _swap(problem: Problem, theta: FloatArray, high: FloatArray) -> FloatArray:
    """The same chain with its lags by size; volumes stay where the search has no room for that."""
    commuting, n = problem.commuting, problem.layout.n_shared
    ordered = commuting.by_size(theta)
    if (ordered[1:n] <= high[1:n]).all():
        return ordered
    return commuting.without_volumes.by_size(theta)


def _search(
    problem: Problem,
    looks: list[Look],
    box: Mapping[str, tuple[float, float]],
    seed: int,
    swarms: int,
    particles: int,
    de: bool,
    tell: Progress,
    count: Counted,
) -> tuple[FloatArray, bool, dict[str, Any], dict[str, Any] | None, Twin | None]:
    """The exact cascade's least squares: swarms, starts along the valley, mesh; and its twin."""
    campaign = problem.campaign
    problem = Problem(campaign, noise=problem.noise, held=problem.held)
    layout = problem.layout
    low, high = limits(layout, box)
    coarse = averages(campaign, looks, 12, 40)
    medium = averages(campaign, looks, 40, 150)
    swarm = SwarmProblem(problem, coarse)
    z_low, z_high = swarm.box(low, high)
    rise = typical_rise(looks, 0.3 * float(high[layout.tau]))
    starts, raw = [], []
    swarms, de = (swarms, de) if swarm.searchable else (0, False)
    for i, stream in enumerate(np.random.SeedSequence(seed).spawn(swarms)):
        tell(0.1 + 0.4 * i / swarms, "swarm")
        found = particle_swarm(swarm.cost, z_low, z_high, np.random.default_rng(stream), particles)
        count.n += found.n_evaluations
        raw.append(found.cost)
        starts.append(swarm.theta(found.best))
    if de:
        result = optimize.differential_evolution(
            lambda z: (
                swarm.cost(np.atleast_2d(z.T)) if z.ndim == 2 else float(swarm.cost(z[None])[0])
            ),
            list(zip(z_low, z_high)), rng=np.random.default_rng(seed), vectorized=True,
            updating="deferred", polish=False, maxiter=400, popsize=8, tol=1e-6,
        )  # fmt: skip
        count.n += result.nfev
        starts.append(swarm.theta(result.x))
    scales = (1.0,) if swarm.searchable else GUESSES
    starts += [swarm.guess(looks, scale * rise, low, high) for scale in scales]
    tell(0.5, "refinement")

    def refined_from(start: FloatArray) -> Refined:
        return count.refine(problem, medium, start, low, high, max_evaluations=40, tolerance=1e-7)

    refined = [refined_from(start) for start in starts]
    best = min(refined, key=lambda found: found.cost)
    for fraction in TAU_STARTS if layout.one_sensor and layout.rig.n_lags > 1 else ():
        start = best.theta.copy()
        start[layout.tau] = min(fraction * rise, 0.9 * high[layout.tau])
        start[layout.all_switches] += best.theta[layout.tau] - start[layout.tau]
        other = refined_from(start)
        if other.cost < best.cost:
            best = other
    for start in sensors_exchanged(problem, best.theta):
        other = refined_from(start)
        if other.cost < best.cost:
            best = other
    twin = None
    for lag, volume, start in other_orders(problem, best.theta):
        other = refined_from(start)
        if other.cost < best.cost:
            best, other = other, best
        if apart(other.theta, best.theta, (lag, volume)):
            names = layout.shared_names
            nearest = Twin(
                names[lag], names[volume], float(other.theta[lag]), float(other.theta[volume]),
                other.cost - best.cost,
            )  # fmt: skip
            twin = nearest if twin is None or nearest.excess < twin.excess else twin
    noise = mean_square(problem, with_noise(problem.layout, best.theta))
    tell(0.7, "mesh")
    start = _swap(problem, best.theta, high)
    theta, success = _finish(problem, start, low, high, rise, noise, count)
    inside, inside_coarse = scatter(campaign, medium), scatter(campaign, coarse)

    def told(cost: float, end: Refined) -> dict[str, Any]:
        shared = _swap(problem, end.theta, high)
        return {
            "cost_V2": cost + inside_coarse,
            "refined_cost_V2": end.cost + inside,
            **dict(zip(layout.shared_names, map(float, shared))),
        }

    def as_good(end: Refined) -> bool:
        # two ends count as one when their difference is small against the noise of one sample
        return bool(end.cost < best.cost + max(noise, 1e-6 * best.cost))

    ends = refined[:swarms]
    record = {"agree": all(map(as_good, ends)), "swarms": list(map(told, raw, ends))}
    check = None
    if de:
        end = refined[swarms]
        check = told(float(result.fun), end)
        check |= {"agrees": as_good(end), "n_evaluations": int(result.nfev)}
    return theta, success, record, check, twin


def _on_mesh(
    problem: Problem,
    theta: FloatArray,
    low: FloatArray,
    high: FloatArray,
    rise: float,
    count: Counted,
    arranged: Callable[[FloatArray], FloatArray] = lambda theta: theta,
) -> tuple[Refined, Points]:
    """Refinement on the exact mesh, which is rebuilt where the result leaves its box; the mesh.

    ``arranged`` puts the parameters of a result in order.
    """
    layout = problem.layout
    watched = [*range(layout.n_shared), *layout.all_switches]
    for _ in range(4):
        near_low, near_high = around(layout, theta, rise)
        points = mesh_points(problem, theta, near_low, near_high)
        found = count.refine(problem, points, theta, low, high)
        theta = arranged(found.theta)
        at = theta[watched]
        if ((at >= near_low[watched]) & (at <= near_high[watched])).all():
            break
    return found._replace(theta=theta), points


def _finish(
    problem: Problem,
    theta: FloatArray,
    low: FloatArray,
    high: FloatArray,
    rise: float,
    noise: float,
    count: Counted,
) -> tuple[FloatArray, bool]:
    """Refinement on the exact mesh, lags by size, with tau at its lower bound where it may be."""
    layout = problem.layout
    found, points = _on_mesh(
        problem, theta, low, high, rise, count, lambda theta: _swap(problem, theta, high)
    )
    theta, success = found.theta, found.success
    # trf stays inside its box, so an estimate that belongs on the bound stops short of it
    tau, least = layout.tau, low[layout.tau]
    if layout.one_sensor and least < theta[tau] < 0.03 * rise:
        held = theta.copy()
        held[layout.all_switches] += held[tau] - least
        held[tau] = least
        free = np.ones(len(theta), dtype=bool)
        free[tau] = False
        bound = count.refine(problem, points, np.clip(held, low, high), low, high, free)
        if bound.cost <= found.cost + 1e-4 * noise:
            theta, success = bound.theta, bound.success
            theta[tau] = least
    # rounding of the square root
    theta[tau] = least if abs(theta[tau] - least) < 1e-9 * least else theta[tau]
    return theta, success


def refit(
    problem: Problem,
    theta: FloatArray,
    box: Mapping[str, tuple[float, float]] | None = None,
    count: Counted | None = None,
) -> tuple[FloatArray, bool]:
    """Mean and extra parameters of any model from the cascade's fit, and whether that converged.

    ``theta`` (n_mean, ..): the cascade's fit; entries after its mean's parameters are not used.
    Starts at the middle of the extra parameters' priors and, one at a time, towards both of their
    ends. The best is refined on the mesh, which is rebuilt around it.  ``box``: search bounds by
    flat name.
    """
    layout, count = problem.layout, count or Counted()
    if box is None:
        box = initial_bounds(problem, [first_look(e) for e in problem.campaign], None)
    low, high = limits(layout, box)
    theta = np.clip(theta[: layout.n_mean], low[: layout.n_mean], high[: layout.n_mean])
    rise = 2.2 * _other_lags(problem, theta)
    laws = [problem.priors[name].law if name in problem.priors else None for name in layout.extra]
    middle = [0.0 if law is None else float(law.median()) for law in laws]
    starts = [np.concatenate([theta, middle])]
    for i, law in enumerate(laws):
        if law is not None:
            for value in law.ppf([0.1, 0.9]):
                start = starts[0].copy()
                start[layout.n_mean + i] = value
                starts.append(start)
    points = mesh_points(problem, starts[0], *around(layout, theta, rise))
    found = [
        count.refine(problem, points, start, low, high, max_evaluations=15, tolerance=1e-5)
        for start in starts
    ]
    best = min(found, key=lambda each: each.cost)
    # the cascade is not assumed to be unchanged when tau and tau_v swap: an effect may tell the two
    # apart
    best, _ = _on_mesh(problem, best.theta, low, high, rise, count)
    return best.theta, best.success


def _other_lags(problem: Problem, theta: FloatArray) -> float:
    """s, the longest lag but for the sensor's, at the highest flow; the sensor's where there is no
    other."""
    layout, found = problem.layout, []
    for k, e in enumerate(problem.campaign):
        taus = layout.taus(theta, k, e.total_flow)
        others = np.delete(taus, layout.rig.sensor_lag)
        found.append(float(others.max() if others.size else taus.max()))
    return min(found)


def _fit_euler(
    problem: Problem,
    theta: FloatArray,
    box: Mapping[str, tuple[float, float]],
    looks: list[Look],
    count: Counted,
) -> tuple[FloatArray, bool]:
    """The fit by forward Euler, from the exact one.

    First the response is interpolated between samples, so that t0 and tf can be refined. Then both
    are set to the nearest sample, where the method has its switches, and the rest is refined again.
    """
    campaign = problem.campaign
    layout = problem.layout
    problem = replace(problem, model=Cascade("euler"))
    low, high = limits(layout, box)
    # the method needs every time constant longer than its step
    interval = max(e.interval for e in campaign)
    flow = max(e.total_flow for e in campaign)
    least = 1.05 * interval * np.array([1.0, 1.0, flow])
    shared = layout.shared[0]
    low[shared] = np.maximum(low[shared], least)
    high[shared] = np.maximum(high[shared], 2.0 * low[shared])
    rise = typical_rise(looks, 0.3 * float(high[layout.tau]))
    points = mesh_points(problem, theta, *around(layout, theta, rise))
    start = np.clip(theta, low, high)
    found = count.refine(problem, points, start, low, high, max_evaluations=40)
    snapped = found.theta.copy()
    free = np.ones(len(snapped), dtype=bool)
    for k, e in enumerate(campaign):
        for i in layout.switches(k):
            index = round((snapped[i] - e.t[0]) / e.interval)
            snapped[i] = e.t[min(max(index, 0), len(e.t) - 1)]
            free[i] = False
    edges = ~free
    low[edges] = np.minimum(low[edges], snapped[edges] - interval)
    high[edges] = np.maximum(high[edges], snapped[edges] + interval)
    # tau and the switch times trade off: with those on the grid tau keeps what is left
    final = count.refine(problem, points, snapped, low, high, free, max_evaluations=40)
    result = final.theta
    result[edges] = snapped[edges]
    lags = [layout.tau, layout.index("tau_v_s")]
    result[lags] = np.sort(result[lags])
    return result, final.success


def _compare_euler(
    problem: Problem,
    theta: FloatArray,
    box: Mapping[str, tuple[float, float]],
    looks: list[Look],
    rms: float,
    count: Counted,
    naming: Naming,
) -> dict[str, Any]:
    other = replace(problem, model=Cascade("euler"))
    found, success = _fit_euler(other, theta, box, looks, count)
    vector = with_noise(problem.layout, found)
    squares = sum(all_residuals(other, vector)[1])
    names = [*naming.names, *problem.layout.mean_names[problem.layout.n_shared :]]
    own = sqrt(squares / problem.campaign.n_samples)
    return {
        "parameters": {
            **problem.layout.nested(vector, noise=False),
            **named_parameters(naming, vector),
        },
        "rms_V": own,
        "rms_difference_V": own - rms,
        "cost_V2": squares,
        "difference": {name: float(d) for name, d in zip(names, found - theta)},
        "converged": bool(success),
        # forward Euler needs tau above its step; the exact fit's bound is lower
        "tau_at_bound": bool(found[0] < 1.051 * max(e.interval for e in problem.campaign)),
    }
