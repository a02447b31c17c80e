"""The search for the least squares: swarms, starts along the valley, refinement on the mesh."""

from __future__ import annotations

from collections.abc import Callable, Container, Mapping
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from scipy import optimize

from bayes_sensor.campaign import FloatArray
from bayes_sensor.fit.block_averages import Points, averages, scatter
from bayes_sensor.fit.first_estimates import Look, farther_bounds, typical_rise
from bayes_sensor.fit.fit import Progress
from bayes_sensor.fit.fitted_noise import mean_square
from bayes_sensor.fit.refinement import Refined, around, mesh_points, refine, with_noise
from bayes_sensor.fit.starts import SwarmProblem, limits
from bayes_sensor.fit.swarm import particle_swarm
from bayes_sensor.fit.twin import Twin, apart, other_orders, sensors_exchanged
from bayes_sensor.likelihood.problem import Problem

Box = Mapping[str, tuple[float, float]]
"""search bounds by flat name"""
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


class Found(NamedTuple):
    """What a search has found."""

    theta: FloatArray
    """(n_mean,)"""
    success: bool
    """whether the last refinement converged"""
    record: dict[str, Any]
    """of the swarms"""
    check: dict[str, Any] | None
    """by differential evolution"""
    twin: Twin | None


def search_far(
    problem: Problem,
    box: Box,
    given: Container[str],
    late: bool,
    search_in: Callable[[Box], Found],
) -> tuple[Found, Box]:
    """What ``search_in`` finds in a box, and the box: farther out as long as lags end at its upper
    end and the fit gets better there.

    ``given``: flat names whose bounds stay.  ``late``: whether a signal moves on after its step, so
    that the search goes farther at least once.
    """

    def squares(found: Found) -> float:
        return mean_square(problem, with_noise(problem.layout, found.theta))

    found = search_in(box)
    farther = farther_bounds(problem, found.theta, box, given, late)
    while farther is not None:
        again = search_in(farther)
        beyond = farther_bounds(problem, again.theta, farther, given)
        before, now = squares(found), squares(again)
        # by more than one sample's noise, or as good at an end: a lag that the data do not tell
        # from an endless one stays where it is
        better = now < before * (1.0 - 1.0 / problem.campaign.n_samples)
        if better or (beyond is None and now <= before):
            found, box = again, farther
        farther = beyond if better else None
    return found, box


def _swap(problem: Problem, theta: FloatArray, high: FloatArray) -> FloatArray:
    """The same chain with its lags by size; volumes stay where the search has no room for that."""
    commuting, n = problem.commuting, problem.layout.n_shared
    ordered = commuting.by_size(theta)
    if (ordered[1:n] <= high[1:n]).all():
        return ordered
    return commuting.without_volumes.by_size(theta)


def search(
    problem: Problem,
    looks: list[Look],
    box: Box,
    seed: int,
    swarms: int,
    particles: int,
    de: bool,
    tell: Progress,
    count: Counted,
) -> Found:
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
    return Found(theta, success, record, check, twin)


def on_mesh(
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
    found, points = on_mesh(
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
