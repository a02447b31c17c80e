"""Particle swarm: the minimum of a function in a box."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from bayes_sensor.campaign import FloatArray


@dataclass(frozen=True, eq=False)
class Swarm:
    """Where a swarm ended."""

    best: FloatArray
    """(n,)"""
    cost: float
    n_iterations: int
    n_evaluations: int
    settled: bool
    """whether it stopped improving before it ran out of iterations"""


def particle_swarm(
    cost: Callable[[FloatArray], FloatArray],
    low: FloatArray,
    high: FloatArray,
    rng: np.random.Generator,
    n_particles: int = 40,
    max_iterations: int = 300,
    patience: int = 30,
    tolerance: float = 1e-4,
) -> Swarm:
    """Lowest point of ``cost`` found in a box by an inertia-weight particle swarm.

    ``v <- w v + c (r1 (own best - x) + r2 (swarm's best - x))``, ``x <- x + v`` with w = 0.7298 and
    c = 1.496 (Clerc and Kennedy, IEEE Trans. Evol. Comput. 6, 2002); a particle that leaves the
    box is put on its wall with that component of v reversed and halved.  ``cost`` takes positions
    (n_particles, n) and returns (n_particles,).  It stops when ``patience`` iterations in a row
    improved the best cost by less than ``tolerance`` of its value.
    """
    inertia, pull = 0.7298, 1.496
    width = high - low
    x = low + width * rng.random((n_particles, len(low)))
    v = width * (rng.random(x.shape) - 0.5)
    own, own_cost = x.copy(), cost(x)
    leader = int(np.argmin(own_cost))
    since, mark, iteration = 0, float(own_cost[leader]), 0
    while iteration < max_iterations and since < patience:
        iteration += 1
        r1, r2 = rng.random((2, *x.shape))
        v = inertia * v + pull * (r1 * (own - x) + r2 * (own[leader] - x))
        x = x + v
        outside = (x < low) | (x > high)
        v[outside] *= -0.5
        x = np.clip(x, low, high)
        value = cost(x)
        better = value < own_cost
        own[better], own_cost[better] = x[better], value[better]
        leader = int(np.argmin(own_cost))
        since += 1
        if own_cost[leader] < mark - tolerance * abs(mark):
            since, mark = 0, float(own_cost[leader])
    return Swarm(
        own[leader].copy(),
        float(own_cost[leader]),
        iteration,
        n_particles * (iteration + 1),
        since >= patience,
    )
