"""The swarm's search space, and a first guess."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from math import log

import numpy as np

from bayes_sensor.campaign import FloatArray
from bayes_sensor.fit.block_averages import Points, profiles
from bayes_sensor.fit.first_estimates import Look
from bayes_sensor.likelihood.problem import Problem
from bayes_sensor.rig.layout import Layout


def limits(layout: Layout, box: Mapping[str, tuple[float, float]]) -> tuple[FloatArray, FloatArray]:
    """Bounds as (n,) arrays over the mean's and the extra parameters."""
    pairs = np.array([box[name] for name in layout.mean_names + list(layout.extra)])
    return pairs[:, 0].copy(), pairs[:, 1].copy()


def swarm_problem(
    problem: Problem, points: Points, low: FloatArray, high: FloatArray
) -> tuple[
    Callable[[FloatArray], FloatArray], FloatArray, FloatArray, Callable[[FloatArray], FloatArray]
]:
    """Cost of a swarm's positions, their box, and the way from a position to theta."""
    layout = problem.layout
    edges = layout.local[:, 2:]
    where = np.full(edges.shape, -1, dtype=np.int64)
    where[edges >= 0] = 3 + np.arange(int((edges >= 0).sum()))
    order = edges[edges >= 0]
    flow = np.array([e.total_flow for e in problem.campaign])
    linear = np.empty((len(flow), 2))

    def cost(Z: FloatArray) -> FloatArray:
        Z = np.ascontiguousarray(Z)
        return profiles(Z, where, *points, flow, linear)

    def to_theta(z: FloatArray) -> FloatArray:
        profiles(np.ascontiguousarray(z[None]), where, *points, flow, linear)
        theta = np.empty(layout.n_mean)
        theta[:3] = np.exp(z[:3])
        theta[order] = z[3:]
        theta[layout.local[:, :2]] = linear
        return theta

    z_low = np.concatenate([np.log(np.maximum(low[:3], 1e-300)), low[order]])
    z_high = np.concatenate([np.log(high[:3]), high[order]])
    return cost, z_low, z_high, to_theta


def guess(
    problem: Problem,
    looks: list[Look],
    points: Points,
    rise: float,
    low: FloatArray,
    high: FloatArray,
) -> FloatArray:
    """A start from the records: valve and manifold each get a third of the rise."""
    layout = problem.layout
    _, z_low, z_high, to_theta = swarm_problem(problem, points, low, high)
    flow = float(np.median([e.total_flow for e in problem.campaign]))
    z = [log(0.03 * rise), log(rise / 3.0), log(flow * rise / 3.0)]
    for look, fall in zip(looks, layout.has_fall):
        own = look.rise or rise
        z.append(look.start_by - 0.5 * own)
        if fall:
            z.append(look.end_by - 0.5 * own)
    return to_theta(np.clip(np.array(z), z_low, z_high))
