"""Hamiltonian Monte Carlo in whitened coordinates."""

from __future__ import annotations

import numpy as np

from bayes_sensor.campaign import FloatArray
from bayes_sensor.likelihood.mesh import Compressed
from bayes_sensor.likelihood.prior_density import log_priors
from bayes_sensor.posterior.convergence import enough, out_of_reach
from bayes_sensor.posterior.laplace import Laplace, prior_gradient
from bayes_sensor.posterior.samplers.sampler import Run, Sampler, Target
from bayes_sensor.posterior.widen_mesh import covered

OUTSIDE = 8
"""points off the mesh after which it is widened"""
MOST_OUTSIDE = 4 * OUTSIDE
"""points off the mesh after which the sampler is given up: each costs ten thousand times another"""
MOST_STEPS = 64
"""of a trajectory; where a quarter turn takes more, the draws are those of a random walk"""
OFF_MESH = "its chains leave the mesh again and again"
_State = tuple[FloatArray, float, FloatArray]  # position, log density, its gradient


class Whitened:
    """The log posterior in whitened coordinates q: psi with signed roots of its squares.

    In (x, ..) with tau = |x| the density is smooth through zero, because the likelihood depends on
    tau^2 there.  No reflection is needed.  If flows differ, the density is also smooth through
    equal lags: a point with the two exchanged represents the point with the lags ordered by size.
    At one flow such a continuation would connect three lags along narrow arcs, which costs more
    than reflections.
    """

    def __init__(self, laplace: Laplace, compressed: Compressed) -> None:
        self.coordinates, self.compressed = laplace.coordinates, compressed
        problem = self.coordinates.problem
        # the two places of lags that are exchanged
        self.pair = list(problem.commuting.places)
        self.folds = problem.flow is None and len(self.pair) == 2 and not problem.held
        self.outside: list[FloatArray] = []
        self.n_outside = 0
        thetas, _ = laplace.draw(2000, np.random.default_rng(12345))
        roots = self._roots(thetas)
        self.pinned = self.coordinates.theta(np.zeros(roots.shape[1]))
        self.centre = roots.mean(axis=0)
        self.factor = np.linalg.cholesky(
            np.cov(roots.T) + 1e-12 * np.diag(roots.var(axis=0) + 1e-300)
        ) * self.coordinates.signs(laplace.theta)

    @property
    def lost(self) -> bool:
        """Whether chains leave the mesh again and again; the density is no longer right there."""
        return self.n_outside > MOST_OUTSIDE

    def _roots(self, thetas: FloatArray) -> FloatArray:
        psi = self.coordinates.psi(thetas)
        psi[..., self.coordinates.squared] = np.sqrt(psi[..., self.coordinates.squared])
        return psi

    def q(self, thetas: FloatArray) -> FloatArray:
        return np.linalg.solve(self.factor, (self._roots(thetas) - self.centre).T).T

    def theta(self, q: FloatArray) -> FloatArray:
        psi = self.centre + q @ self.factor.T
        psi[..., self.coordinates.squared] **= 2
        thetas = self.coordinates.theta(psi)
        if self.folds:
            thetas[..., self.pair] = np.sort(thetas[..., self.pair], axis=-1)
        return thetas

    def value_and_gradient(self, q: FloatArray) -> tuple[float, FloatArray]:
        """Log density (up to a constant) and its gradient (n,) at one point q (n,)."""
        coordinates = self.coordinates
        squared, phi, sigmas = coordinates.squared, coordinates.phi, coordinates.log_sigmas
        logs = coordinates.logs
        roots = self.centre + self.factor @ q
        # the same as coordinates.theta, in fewer steps: this is the innermost loop
        values = roots.copy()
        values[squared] = np.abs(values[squared])
        if coordinates.shifts:
            values[coordinates.switches] -= values[0]
        values[phi] = np.tanh(values[phi])
        values[sigmas] = np.exp(np.minimum(values[sigmas], 300.0))
        values[logs] = np.exp(np.minimum(values[logs], 300.0))
        theta = self.pinned.copy()
        theta[coordinates.free] = values
        exchanged = self.folds and theta[self.pair[0]] > theta[self.pair[1]]
        if exchanged:
            theta[self.pair] = theta[self.pair[::-1]]
        prior = log_priors(coordinates.problem, theta[None])[0]
        if not np.isfinite(prior):
            return -np.inf, np.zeros_like(q)
        if not self.compressed.covers(theta):
            # full passes with difference quotients cost ten thousand times a mesh's gradient
            self.n_outside += 1
            if self.lost:
                return -np.inf, np.zeros_like(q)
            self.outside.append(theta)
            if len(self.outside) == OUTSIDE:
                self.compressed = covered(self.compressed, np.array(self.outside))
                self.outside = []
        value, gradient = self.compressed.value_and_gradient(theta)
        slope = 1.0 - values[phi] ** 2
        value += prior + float(np.log(slope).sum() + np.log(values[sigmas]).sum())
        value += float(np.log(values[logs]).sum())
        gradient = gradient + prior_gradient(coordinates.problem, theta)
        if exchanged:
            gradient[self.pair] = gradient[self.pair[::-1]]
        g = gradient[coordinates.free]
        # t0 = root - tau, and tau = |root|: its derivative is a sign
        if coordinates.shifts:
            g[0] -= g[coordinates.switches].sum()
        g[squared] *= np.sign(roots[squared])
        g[phi] = g[phi] * slope - 2.0 * values[phi]
        g[sigmas] = g[sigmas] * values[sigmas] + 1.0
        g[logs] = g[logs] * values[logs] + 1.0
        return float(value), self.factor.T @ g


def run_hmc(given: Target) -> Run:
    """Chains of Hamiltonian Monte Carlo, step sizes tuned by dual averaging."""
    laplace, settings = given.laplace, given.settings
    target = Whitened(laplace, given.compressed)
    rngs = [np.random.default_rng(s) for s in given.streams.spawn(settings.n_chains)]
    states, sizes = [], []
    for rng in rngs:
        thetas, _ = laplace.draw(1, rng)
        q = target.q(thetas)[0]
        state = (q, *target.value_and_gradient(q))
        if not np.isfinite(state[1]):
            q = target.q(laplace.theta[None])[0]
            state = (q, *target.value_and_gradient(q))
        log_size, average = np.log(0.25), np.log(0.25)
        # dual averaging (Hoffman and Gelman, JMLR 15, 2014, algorithm 5)
        gap, shrink = 0.0, np.log(2.5)
        for i in range(1, 151):
            state, probability = _leapfrog(target, state, np.exp(log_size), rng)
            gap += (0.85 - probability - gap) / (i + 10)
            log_size = shrink - np.sqrt(i) / 0.05 * gap
            # longer steps than that only leave the mesh and are rejected
            log_size = min(max(log_size, -8.0), -0.4)
            weight = i**-0.75
            average = weight * log_size + (1 - weight) * average
        if target.lost:
            return _given_up(OFF_MESH)
        if 0.5 * np.pi / np.exp(average) > MOST_STEPS:
            return _given_up("it needs steps too short for a trajectory to turn")
        states.append(state)
        sizes.append(np.exp(average))
    n_psi = len(laplace.mean)
    chains = [np.empty((0, n_psi)) for _ in rngs]
    accepted = tried = 0.0
    block = max(100, settings.n_draws // 2)
    while True:
        for j, rng in enumerate(rngs):
            out = np.empty((block, n_psi))
            for i in range(block):
                states[j], probability = _leapfrog(target, states[j], sizes[j], rng)
                accepted += probability
                tried += 1
                out[i] = states[j][0]
            chains[j] = np.concatenate([chains[j], out])
            given.report(
                min(0.95, (len(chains[0]) + j * block / len(rngs)) / settings.max_draws), "HMC"
            )
        if target.lost:
            return _given_up(OFF_MESH)
        stacked = target.theta(np.stack(chains))
        done, found = enough(given.problem, stacked, settings.target_ess)
        n, most = len(chains[0]), settings.max_draws // 2
        slow = n >= 4 * block and out_of_reach(found, n / most, settings.target_ess)
        if done or slow or n >= most:
            reason = (
                "Hamiltonian Monte Carlo with the analytic gradient in whitened coordinates: "
                f"mean acceptance {accepted / tried:.2f}, "
                f"{settings.n_chains} independent chains compared"
            )
            if not done:
                reason += "; it did not reach its target and was given up"
            return Run(
                stacked,
                done,
                reason,
                accepted / tried,
                diagnosis=found,
                compressed=target.compressed,
            )


def _given_up(why: str) -> Run:
    return Run(np.empty((0, 0, 0)), False, f"Hamiltonian Monte Carlo was given up: {why}", 0.0)


def _leapfrog(
    target: Whitened, state: _State, size: float, rng: np.random.Generator
) -> tuple[_State, float]:
    q, value, g = state
    p = rng.standard_normal(len(q))
    # a quarter turn makes draws from a Gaussian independent; jittered against resonances
    size = size * rng.uniform(0.8, 1.2)
    steps = max(1, round(0.5 * np.pi * rng.uniform(0.8, 1.2) / size))
    steps = min(steps, MOST_STEPS)
    start = value - 0.5 * float(p @ p)
    new_q, new_g, new_value = q, g, value
    p = p + 0.5 * size * new_g
    for i in range(steps):
        new_q = new_q + size * p
        new_value, new_g = target.value_and_gradient(new_q)
        if not new_value > value - 1000.0:  # diverged, or left the support
            return state, 0.0
        p = p + (size if i < steps - 1 else 0.5 * size) * new_g
    log_ratio = new_value - 0.5 * float(p @ p) - start
    probability = float(np.exp(min(0.0, log_ratio)))
    if rng.random() < probability:
        return (new_q, new_value, new_g), probability
    return state, probability


SAMPLER = Sampler("hmc", run_hmc, by_gradient=True, rests_on_laplace=True)
