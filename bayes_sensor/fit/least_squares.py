"""Fit of a campaign: swarms, starts along the valley, refinement on the mesh."""

from __future__ import annotations

import time
from collections.abc import Mapping
from dataclasses import replace
from math import sqrt
from typing import Any

import numpy as np

from bayes_sensor.campaign import Campaign, CampaignError, FloatArray
from bayes_sensor.fit.caveats import caveats, hiding_interval
from bayes_sensor.fit.first_estimates import (
    Look,
    farther_bounds,
    first_look,
    initial_bounds,
    typical_rise,
)
from bayes_sensor.fit.fit import Fit, Progress
from bayes_sensor.fit.fit_warnings import at_bounds, bound_warnings, unseen_lags, warn
from bayes_sensor.fit.fitted_noise import all_residuals, estimate_noise
from bayes_sensor.fit.identifiability import cannot_tell, step_is_seen
from bayes_sensor.fit.inseparable import inseparable, volumes_in_order
from bayes_sensor.fit.misfit import misfits, overall
from bayes_sensor.fit.refinement import around, mesh_points, with_noise
from bayes_sensor.fit.search import Box, Counted, Found, on_mesh, search, search_far
from bayes_sensor.fit.side_information import named_parameters, weigh_names
from bayes_sensor.fit.starts import limits
from bayes_sensor.fit.twin import AS_GOOD
from bayes_sensor.likelihood.prior_text import read_bounds
from bayes_sensor.likelihood.problem import Problem, as_problem
from bayes_sensor.rig.cascade import Cascade
from bayes_sensor.rig.lags import Naming
from bayes_sensor.workers import one_thread


@one_thread
def fit_least_squares(
    campaign: Campaign | Problem,
    seed: int = 1,
    swarms: int = 3,
    particles: int = 40,
    bounds: Mapping[str, Any] | None = None,
    euler: bool = True,
    de: bool = False,
    progress: Progress | None = None,
) -> Fit:
    """The parameters that minimise the summed squared error over all used samples.

    ``swarms`` independent particle swarms of ``particles`` each, then refinement; the same seed
    gives the same fit.  ``bounds`` replaces search bounds, which otherwise come from the records
    and the commanded times (``Fit.bounds``): by name, low and high in s, mL and the signal's unit
    or as texts with units, such as ``{"tau": ("1 ms", "1 s")}``.  ``euler`` repeats the
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
    asked = read_bounds(bounds or {}, problem.layout, problem.campaign.signal_unit, "bounds")
    count = Counted()
    exact = replace(problem, model=Cascade())
    plain = problem.chain is not None

    def found_in(box: Box) -> Found:
        return search(exact, looks, box, seed, swarms, particles, de, tell, count)

    near, late = initial_bounds(problem, looks, asked), any(look.late for look in looks)
    found, box = search_far(exact, near, asked, late, found_in)
    theta, success, record, check, other = found
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
    unseen = unseen_lags(at_bound, vector, problem.layout, box, asked)
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


def fit_or_given(problem: Problem, fit: Any, seed: int, where: str) -> Fit:
    """The fit that is given, or one made here where that is None.

    Raises CampaignError for anything else.
    """
    if fit is None:
        return fit_least_squares(problem, seed=seed, euler=False)
    if not isinstance(fit, Fit):
        raise CampaignError(
            f"{where}: expected the Fit of this campaign, or None to fit it here, but got a "
            f"{type(fit).__name__}; give what fit_least_squares returns"
        )
    return fit


def refit(
    problem: Problem,
    theta: FloatArray,
    box: Box | None = None,
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
        while (farther := farther_bounds(problem, theta, box, ())) is not None:
            box = farther  # the cascade's fit may have gone as far
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
    best, _ = on_mesh(problem, best.theta, low, high, rise, count)
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
    box: Box,
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
    box: Box,
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
