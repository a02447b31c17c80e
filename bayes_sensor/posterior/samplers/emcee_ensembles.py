"""emcee: affine-invariant ensembles, with every y0 and beta integrated out where priors permit."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np

from bayes_sensor.campaign import CampaignError, FloatArray
from bayes_sensor.likelihood.coordinates import Coordinates
from bayes_sensor.likelihood.mesh import Compressed
from bayes_sensor.likelihood.prior_density import log_priors
from bayes_sensor.likelihood.problem import Problem
from bayes_sensor.posterior.agreement import r_hat_between
from bayes_sensor.posterior.checkpoints import Checkpoint, digest
from bayes_sensor.posterior.convergence import ESS_LIMIT, R_HAT_LIMIT, enough, out_of_reach
from bayes_sensor.posterior.laplace import NO_START, Laplace
from bayes_sensor.posterior.r_hat import diagnostics
from bayes_sensor.posterior.samplers.sampler import Run, Sampler, Target
from bayes_sensor.posterior.settings import Settings
from bayes_sensor.posterior.widen_mesh import covered
from bayes_sensor.rig.cascade import exchanged
from bayes_sensor.workers import in_order

SETTLING = 10
"""ensemble steps between checks of the mesh during burn-in"""
MOST_POINTS = 5 * 10**10
"""of meshes that the likelihoods of a run may visit in all: some five minutes of a processor"""
LOOK = 500
"""steps between looks at whether the steps that are left would do"""


class Marginal:
    """Log posterior of the ensemble's coordinates, vectorised over walkers."""

    def __init__(
        self,
        problem: Problem,
        compressed: Compressed,
        marginalise: bool,
        both: float | None = None,
        roots: bool = False,
    ) -> None:
        self.coordinates, self.compressed = Coordinates(problem), compressed
        self.marginalise, self.both = marginalise, both
        n_psi = len(self.coordinates.free)
        drop = set(self.coordinates.linear.ravel()) if marginalise else set()
        self.kept = np.array([i for i in range(n_psi) if i not in drop])
        self.reference = self.coordinates.psi(compressed.reference)
        self.squared = np.flatnonzero(np.isin(self.kept, self.coordinates.squared))
        # walkers have tau, the first of the squares, itself where ``roots`` says so
        self.rooted = self.squared[:1] if roots else self.squared[:0]

    def thetas(self, points: FloatArray) -> FloatArray:
        psi = np.tile(self.reference, (len(points), 1))
        psi[:, self.kept] = points
        psi[:, self.kept[self.rooted]] **= 2
        return self.coordinates.theta(psi)

    def points(self, thetas: FloatArray) -> FloatArray:
        return self.of_psi(self.coordinates.psi(thetas))

    def of_psi(self, psi: FloatArray) -> FloatArray:
        """Walkers (.., n_dim) at ``psi`` (.., n_psi)."""
        points: FloatArray = psi[..., self.kept]
        points[..., self.rooted] = np.sqrt(np.maximum(points[..., self.rooted], 0.0))
        return points

    def __call__(self, points: FloatArray) -> FloatArray:
        total = np.where((points[:, self.squared] > 0).all(axis=1), 0.0, -np.inf)
        good = np.flatnonzero(np.isfinite(total))
        thetas = self.thetas(points[good])
        values = log_priors(self.coordinates.problem, thetas)
        values = values + self.coordinates.log_jacobian(thetas)
        values = values + np.log(2.0 * points[good][:, self.rooted]).sum(axis=1)
        inside = np.isfinite(values)
        if inside.any():
            if self.marginalise:
                values[inside] += self.compressed.marginals(thetas[inside])[0]
            else:
                values[inside] += self.compressed.log_likelihoods(thetas[inside]).sum(axis=1)
        total[good] = values
        return np.where(np.isnan(total), -np.inf, total)

    def exchange(self, points: FloatArray, random: Any) -> tuple[FloatArray, FloatArray]:
        """``points`` (n, n_dim) with valve and manifold exchanged, for a Metropolis move."""
        assert self.both is not None
        # tau_v and V are coordinates themselves, and tau stays: volumes do too
        return self.points(exchanged(self.thetas(points), self.both)), np.zeros(len(points))

    def cover(self, points: FloatArray) -> None:
        """Widen the mesh where walkers have left it, to avoid full passes."""
        thetas = self.thetas(points)
        if self.both is not None:  # as where they may jump to
            thetas = np.concatenate([thetas, exchanged(thetas, self.both)])
        self.compressed = covered(self.compressed, thetas)

    def redraw(self, thetas: FloatArray, rng: np.random.Generator) -> FloatArray:
        """``thetas`` with y0 and beta drawn from their exact conditional law."""
        if not self.marginalise:
            return thetas
        _, best, factor = self.compressed.marginals(thetas)
        # a signal upside down has its draws upside down
        z = rng.standard_normal(best.shape) * np.where(best[:, :, 1:] < 0.0, -1.0, 1.0)
        beta = z[:, :, 1] / factor[:, :, 2]
        y0 = (z[:, :, 0] - factor[:, :, 1] * beta) / factor[:, :, 0]
        local = self.coordinates.problem.layout.local
        thetas = thetas.copy()
        thetas[:, local[:, 0]] = best[:, :, 0] + y0
        thetas[:, local[:, 1]] = best[:, :, 1] + beta
        return thetas


def _ensemble(target: Marginal, state: Any, n_steps: int) -> tuple[FloatArray, Any, float]:
    """Advance one ensemble: positions (n_steps, n_walkers, n), the new state, mean acceptance."""
    import emcee

    n_walkers, n_dim = state[0].shape
    # emcee 3.1.6's DESnookerMove is biased and stays out
    moves = [(emcee.moves.DEMove(), 0.8), (emcee.moves.StretchMove(), 0.2)]
    if target.both is not None:
        moves.append((emcee.moves.MHMove(target.exchange), 0.1))
    sampler = emcee.EnsembleSampler(
        n_walkers,
        n_dim,
        target,
        vectorize=True,
        moves=moves,
    )
    begin = emcee.State(state[0], log_prob=state[1], random_state=state[2])
    last = sampler.run_mcmc(begin, n_steps, skip_initial_state_check=True, store=True)
    acceptance = float(sampler.acceptance_fraction.mean())
    return sampler.get_chain(), (last.coords, last.log_prob, last.random_state), acceptance


def run_emcee(given: Target) -> Run:
    """Independent ensembles of emcee, which exchange valve and manifold where both orders are
    likely."""
    problem, settings, seed = given.problem, given.settings, given.seed
    names = problem.layout.names
    # exact only for flat priors and a mean y0 + beta x
    flat = problem.is_affine and all(
        problem.priors[name].kind == "flat" for name in names if name[:4] in ("y0_V", "beta")
    )
    target = Marginal(
        problem, given.compressed, marginalise=flat, both=given.both, roots=bends(given.laplace)
    )
    n_dim = len(target.kept)
    settings = in_bounded_time(settings, n_dim, given.compressed.n_points)
    n_walkers = settings.n_walkers
    begin = given.begin
    identity = digest(
        problem, given.start, given.settings, seed, given.compressed.region.fineness, begin
    )
    store = Checkpoint(given.checkpoint, identity, given.resume)
    begins = []
    for j in range(settings.n_chains):
        rng = np.random.default_rng(np.random.SeedSequence([seed, j]))
        points = _start(target, given.laplace, n_walkers, rng, _of_chain(begin, j))
        begins.append((points, None, np.random.RandomState(rng.integers(2**32)).get_state()))
    target.cover(np.concatenate([begin[0] for begin in begins]))

    def steps_of(i: int) -> int:
        # short chunks at first: the mesh follows the walkers while they settle
        settles = begin is None and i < settings.burn_in // SETTLING
        return SETTLING if settles else settings.chunk

    saved = [
        store.read(j, lambda i: (steps_of(i), n_walkers, n_dim)) for j in range(settings.n_chains)
    ]
    chains: list[list[FloatArray]] = [[] for _ in saved]
    acceptance: list[list[float]] = [[] for _ in saved]
    states: list[Any] = list(begins)
    # who begins from draws of the posterior has nothing to settle, unless it turns out otherwise
    burn_in = settings.burn_in if begin is None else 0
    while True:
        i = len(chains[0])
        n_steps = steps_of(i)
        # a resumed run takes the steps that it finds, sees the meshes and the looks at convergence
        # that the uninterrupted one saw, and so ends where that would have ended
        todo = [j for j, chunks in enumerate(saved) if i >= len(chunks)]
        made = dict(
            zip(todo, _advance(target, [states[j] for j in todo], n_steps, given.jobs), strict=True)
        )
        for j, chain in enumerate(chains):
            points, states[j], rate = made[j] if j in made else saved[j][i]
            chain.append(points)
            acceptance[j].append(rate)
            if j in made:
                store.write(j, i, points, states[j], rate)
        target.cover(np.concatenate([chain[i][-1] for chain in chains]))
        steps = sum(len(c) for c in chains[0])
        given.report(min(0.95, steps / settings.max_steps), f"emcee, {steps} steps")
        if steps < burn_in + 2 * settings.chunk:
            continue
        thinned = [np.concatenate(chain)[burn_in :: settings.thin] for chain in chains]
        # walkers end to end: each walker's own autocorrelation is what ESS must see
        stacked = np.stack([c.transpose(1, 0, 2).reshape(-1, n_dim) for c in thinned])
        thetas = target.thetas(stacked.reshape(-1, n_dim))
        look = steps >= LOOK and (steps - burn_in) % LOOK == 0
        full = steps >= settings.max_steps or (
            look and out_of_reach(diagnostics(stacked), steps / settings.max_steps, ESS_LIMIT)
        )
        quick = stacked[:, :, : min(n_dim, 3)]
        r_hat, bulk, _ = diagnostics(quick)
        if not full and not (np.all(r_hat < R_HAT_LIMIT) and np.all(bulk > settings.target_ess)):
            continue
        rng = np.random.default_rng(np.random.SeedSequence([seed, 10**6, steps]))
        drawn = target.redraw(thetas, rng).reshape(*stacked.shape[:2], -1)
        done, found = enough(problem, drawn, settings.target_ess)
        between = None
        if begin is not None:
            between = r_hat_between(problem, begin, later_half(drawn, thinned[0].shape[1]))
            left = not np.nanmax(between) < R_HAT_LIMIT
            if left and burn_in < settings.burn_in and not full:
                burn_in = settings.burn_in
                continue
        if full or done:
            rate = float(np.mean([np.mean(a) for a in acceptance]))
            how = "y0 and beta integrated out exactly and redrawn" if flat else "all parameters"
            reason = (
                f"emcee: {settings.n_chains} independent ensembles of {n_walkers} walkers, "
                f"{steps} steps ({burn_in} dropped), {how}; acceptance {rate:.2f}; "
                "convergence judged between ensembles"
            )
            if not done and settings.max_steps < given.settings.max_steps:
                reason += (
                    "; more steps would take too long, since one likelihood of these records "
                    f"visits {target.compressed.n_points} points (max_steps above "
                    f"{Settings.max_steps} takes them)"
                )
            return Run(
                drawn, True, reason, rate, diagnosis=found, compressed=target.compressed,
                between=between,
            )  # fmt: skip


def bends(laplace: Laplace) -> bool:
    """Whether the valley along tau bends in (tau^2, t0 + tau) by more than its own width.

    A lag longer than its step leaves t0 known and t0 + tau not, so that in psi the valley is a
    root, on which walkers creep; it is straight in (tau, t0 + tau).  At one standard deviation of
    tau^2 the root of slope c departs from its chord by c / (4 tau^2), c their covariance.
    """
    switches = laplace.coordinates.switches
    if not len(switches):
        return False
    width = 1.0 / np.sqrt(np.diag(np.linalg.inv(laplace.cov))[switches])
    squares = max(float(laplace.mean[0]), float(np.sqrt(laplace.cov[0, 0])))
    return bool((np.abs(laplace.cov[switches, 0]) > 4.0 * squares * width).any())


def in_bounded_time(settings: Settings, n_dim: int, n_points: int) -> Settings:
    """The settings with as many walkers as ``n_dim`` coordinates need at least, and with fewer
    walkers and steps where one likelihood visits so many points that a run would take too long.

    Steps never become fewer than a judgement of convergence needs.  Who asks for more steps than
    the default gets them.
    """
    fewest = 2 * n_dim + 2
    walkers, steps = max(settings.n_walkers, fewest), settings.max_steps
    if steps <= Settings.max_steps:
        least = settings.burn_in + 2 * settings.chunk
        of_a_walker = MOST_POINTS // (settings.n_chains * n_points)  # steps
        walkers = max(fewest, min(walkers, of_a_walker // least))
        steps = min(steps, max(least, of_a_walker // walkers))
    return replace(settings, n_walkers=walkers, max_steps=steps)


def later_half(drawn: FloatArray, n_walkers: int) -> FloatArray:
    """The later half of every walker's draws; ``drawn`` (n_chain, n_draw, n), walkers end to
    end."""
    each = drawn.reshape(len(drawn), n_walkers, -1, drawn.shape[-1])
    return each[:, :, each.shape[2] // 2 :]


def _of_chain(begin: FloatArray | None, j: int) -> FloatArray | None:
    """Draws (n, n_theta) for ensemble ``j``: those of a chain of its own, as far as there are."""
    return None if begin is None else begin[j % len(begin)]


def _advance(
    target: Marginal, states: list[Any], n_steps: int, jobs: int
) -> list[tuple[FloatArray, Any, float]]:
    found: list[tuple[FloatArray, Any, float]] = in_order(
        _ensemble, [(target, state, n_steps) for state in states], jobs
    )
    return found


def _start(
    target: Marginal,
    laplace: Laplace,
    n: int,
    rng: np.random.Generator,
    given: FloatArray | None = None,
) -> FloatArray:
    """(n, n_dim) walkers of finite density: draws that are ``given`` (.., n_theta), draws of the
    Laplace approximation where the priors allow them, else draws pulled towards its maximum, else
    draws moved into the priors."""
    found = np.empty((0, len(target.kept)))
    if given is not None:
        # a Metropolis chain repeats draws, and walkers at one place span nothing
        points = np.unique(target.points(given), axis=0)
        found = rng.permutation(points)[:n]
        found = found[np.isfinite(target(found))]
        if len(found) == n:
            return found
    centre = target.points(laplace.theta[None])
    shrink = 1.0
    for _ in range(60):
        drawn = target.points(laplace.draw(2 * n, rng)[0])
        points = centre + shrink * (drawn - (target.of_psi(laplace.mean) if shrink < 1 else centre))
        found = np.concatenate([found, points[np.isfinite(target(points))]])
        if len(found) >= n:
            return found[:n]
        shrink *= 0.8
    # the Gaussian has no overlap with the priors, as where the data say almost nothing
    drawn = into_priors(target.coordinates.problem, laplace.draw(8 * n, rng)[0], rng)
    points = target.points(drawn)
    found = np.concatenate([found, points[np.isfinite(target(points))]])
    if len(found) >= n:
        return found[:n]
    raise CampaignError(NO_START)


def into_priors(problem: Problem, thetas: FloatArray, rng: np.random.Generator) -> FloatArray:
    """``thetas`` (n, n_theta) with everything outside its prior's support drawn from that prior."""
    thetas = thetas.copy()
    for i, name in enumerate(problem.layout.names):
        law = problem.priors[name].law
        if name in problem.fixed or law is None:
            continue
        # the far tails too: they are as good as outside
        low, high = law.ppf([1e-9, 1.0 - 1e-9])
        outside = ~((thetas[:, i] > low) & (thetas[:, i] < high))
        thetas[outside, i] = law.rvs(int(outside.sum()), random_state=rng)
    commuting = problem.commuting
    lags = commuting.lags(thetas)
    if lags.shape[1] < 2:
        return thetas
    # the ends first, then what does not lie between them
    wrong = lags[:, 0] > lags[:, -1]
    lags[wrong, 0] = lags[wrong, -1] * rng.random(int(wrong.sum()))
    low, high = lags[:, :1], lags[:, -1:]
    inner = lags[:, 1:-1]
    wrong = ~((low <= inner) & (inner <= high))
    inner = np.sort(np.where(wrong, low + (high - low) * rng.random(inner.shape), inner), axis=1)
    ordered = np.concatenate([low, inner], axis=1)
    for j in range(ordered.shape[1]):
        thetas[:, commuting.places[j]] = ordered[:, j] / commuting.to_lag[j]
    return thetas


SAMPLER = Sampler("emcee", run_emcee, exchanges_orders=True)
