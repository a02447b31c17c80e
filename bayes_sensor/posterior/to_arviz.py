"""A posterior for ArviZ: draws, log-likelihood in blocks, replicated data, prior draws.

Neighbouring samples of a record are correlated, so that one of them left out is told by the next.
The log-likelihood is therefore given in blocks of consecutive samples that are longer than the
noise remembers.  With r_i the log density of sample i given the samples before it,

    log p(block) = sum of r_i over the block,

and the blocks of all records sum to the log-likelihood exactly.  What leave-one-out leaves out is
one block; its first samples still know the last ones of the block before.
"""

from __future__ import annotations

import re
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property
from math import ceil, log
from typing import Any

import numpy as np
from numpy.typing import NDArray

from bayes_sensor.campaign import CampaignError, Experiment, FloatArray
from bayes_sensor.likelihood.density import mean_and_variance, noise_in_range
from bayes_sensor.likelihood.noise import simulate_noise
from bayes_sensor.likelihood.prior_density import log_priors
from bayes_sensor.likelihood.problem import Problem
from bayes_sensor.posterior import inference_data as idata
from bayes_sensor.posterior.posterior import Posterior
from bayes_sensor.rig.named_values import unit_of

FORGOTTEN = 0.05
"""autocorrelation below which noise counts as forgotten"""
MEMORIES = 5
"""memories of the noise in a block, at least"""
MOST_BLOCKS = 200
"""blocks of one record"""
PRIOR_DRAWS = 500
TRIES = 200
"""drawn from the laws of the single parameters for each prior draw"""
Progress = Callable[[float, str], None]


@dataclass(frozen=True, eq=False)
class Blocks:
    """The used samples of one record in blocks."""

    samples: NDArray[np.int64]
    """(n_used,) positions in the record"""
    starts: NDArray[np.int64]
    """(n_blocks,) first of each block among the used samples"""
    steps: FloatArray
    """(n_used - 1,) sampling intervals between used samples"""
    memory: float
    """s, after which the noise is forgotten"""
    duration: float
    """s, of the median block"""

    @cached_property
    def long(self) -> NDArray[np.int64]:
        """Positions of the steps that are not one sampling interval."""
        return np.flatnonzero(self.steps != 1.0)

    @classmethod
    def of(cls, experiment: Experiment, phi: float) -> Blocks:
        """Blocks for noise with ``phi`` over one sampling interval."""
        samples = np.flatnonzero(experiment.used)
        phi = min(abs(phi), 1.0 - 1e-9)
        memory = 1.0 if phi <= FORGOTTEN else log(FORGOTTEN) / log(phi)
        length = max(ceil(MEMORIES * memory), ceil(len(samples) / MOST_BLOCKS))
        starts = np.arange(0, max(len(samples) - length // 2, 1), length)
        t = experiment.t[samples]
        ends = np.append(starts[1:], len(samples)) - 1
        return cls(
            samples,
            starts,
            np.diff(experiment.places[samples]),
            memory * experiment.interval,
            float(np.median(t[ends] - t[starts])) + experiment.interval,
        )

    def means(self, values: FloatArray) -> FloatArray:
        """(n_blocks,) means of values (n_used,)."""
        count = np.diff(np.append(self.starts, len(self.samples)))
        found: FloatArray = np.add.reduceat(values, self.starts) / count
        return found


def to_arviz(
    posterior: Posterior,
    most_draws: int = 1000,
    seed: int = 1,
    progress: Progress | None = None,
) -> Any:
    """ArviZ InferenceData (a DataTree in ArviZ 1.x) of a posterior, for any function of ArviZ.

    Parameters
    ----------
    most_draws
        draws kept, evenly of every chain; all groups have the same ones.  ``posterior.nc`` has all.
    seed
        of replicated data and prior draws.

    Returns
    -------
    InferenceData or DataTree
        ``posterior`` (chain, draw, and ``experiment`` where a parameter is one of each record;
        one that only some records have, such as ``tf``, has a dimension of its own with these);
        ``sample_stats``: ``lp``, the log posterior density; ``log_likelihood``: ``y`` (chain, draw,
        block); ``posterior_predictive``: ``y`` (chain, draw, block), means over blocks of
        replicated data; ``observed_data``: ``y`` (block), those of the data; ``prior``: draws of
        every parameter with a proper law.  Attributes say what is left out: parameters that are
        held, and flat priors.

    Raises
    ------
    CampaignError
        For a number of draws below 4.
    """
    import xarray

    if not most_draws >= 4:
        raise CampaignError(f"to_arviz: expected most_draws of at least 4, but got {most_draws}")
    step = max(1, ceil(posterior.chains.shape[0] * posterior.chains.shape[1] / most_draws))
    kept = slice(None, None, step)
    whole = posterior.chains.shape[:2]
    n_chain, n_draw = posterior.chains[:, kept].shape[:2]
    sampled = {"chain": np.arange(n_chain), "draw": np.arange(n_draw)}
    problem = posterior.problem

    def draws(name: str) -> FloatArray:
        return posterior.of(name).reshape(whole)[:, kept]

    parameters = _dataset(problem, {name: draws(name) for name in posterior.rows}, sampled)
    thetas = posterior.chains[:, kept].reshape(n_chain * n_draw, -1)
    of_blocks, replicated, observed, place = _block_values(problem, thetas, seed, progress)
    each = posterior.log_likelihood[:, kept].sum(axis=-1)
    log_prior = log_priors(problem, thetas).reshape(n_chain, n_draw)
    names = problem.campaign.names_of_experiments
    blocks = {
        "block": np.arange(len(observed)),
        "experiment": ("block", [names[k] for k in place.experiment]),
        "t": ("block", place.t),
    }
    dims, shape = ("chain", "draw", "block"), (n_chain, n_draw, -1)
    groups = {
        "posterior": parameters,
        "sample_stats": xarray.Dataset(
            {"lp": (("chain", "draw"), each + log_prior)}, coords=sampled
        ),
        "log_likelihood": xarray.Dataset(
            {"y": (dims, of_blocks.reshape(shape))}, coords={**sampled, **blocks}
        ),
        "posterior_predictive": xarray.Dataset(
            {"y": (dims, replicated.reshape(shape))}, coords={**sampled, **blocks}
        ),
        "observed_data": xarray.Dataset({"y": (("block",), observed)}, coords=blocks),
    }
    prior, repeated = _prior_draws(posterior, seed)
    flat = sorted({n.split("[")[0] for n in posterior.rows} - {n.split("[")[0] for n in prior})
    if prior:
        one = {"chain": np.arange(1), "draw": np.arange(PRIOR_DRAWS)}
        groups["prior"] = _dataset(problem, prior, one)
    held = [name for name in problem.layout.names if name in problem.fixed]
    return idata.assemble(
        groups,
        {
            "sampler": posterior.sampler,
            "converged": int(posterior.converged),
            "status": posterior.status,
            "thinned_by": step,
            "noise_memory_s": place.memory,
            "block_s": place.duration,
            "left_out": "log_likelihood: the correlation of each block's first samples with the "
            "last of the block before"
            + (f"; posterior: {', '.join(held)}, which are held" if held else "")
            + (f"; prior: {', '.join(flat)}, whose laws are flat" if flat else "")
            + (f"; prior draws repeat, {repeated:.0f} of them count" if repeated else ""),
        },
    )


def _dataset(
    problem: Problem, values: dict[str, FloatArray], sampled: dict[str, NDArray[np.int64]]
) -> Any:
    """Draws (n_chain, n_draw) by flat name as variables; those with brackets along a dimension."""
    import xarray

    unit, names = problem.campaign.signal_unit, problem.campaign.names_of_experiments
    labels: dict[str, list[str]] = {}
    for name in values:
        kind, bracket, rest = name.partition("[")
        labels.setdefault(kind, []).extend([rest.removesuffix("]")] if bracket else [])
    variables: dict[str, Any] = {}
    coordinates: dict[str, Any] = dict(sampled)
    for kind, of in labels.items():
        variable = re.sub(r"_(s|mL|V)$", "", kind)
        about = {"units": unit_of(kind, unit)}
        if not of:
            variables[variable] = (("chain", "draw"), values[kind], about)
            continue
        dimension = "experiment" if of == names else f"{variable}_of"
        coordinates[dimension] = of
        table = np.stack([values[f"{kind}[{label}]"] for label in of], axis=-1)
        variables[variable] = (("chain", "draw", dimension), table, about)
    return xarray.Dataset(variables, coords=coordinates)


@dataclass(frozen=True, eq=False)
class _Place:
    """Where the blocks of all records are."""

    experiment: list[int]
    t: list[float]
    """s, mean time of each"""
    memory: float
    duration: float


def _block_values(
    problem: Problem, thetas: FloatArray, seed: int, progress: Progress | None
) -> tuple[FloatArray, FloatArray, FloatArray, _Place]:
    """(n, n_blocks) log densities and means of replicates, (n_blocks,) means of the data."""
    tell = progress or (lambda fraction, text: None)
    middle = np.median(thetas, axis=0)
    likelihoods, replicates, observed = [], [], []
    experiment: list[int] = []
    times: list[float] = []
    memories, durations = [], []
    streams = np.random.SeedSequence(seed).spawn(len(problem.campaign))
    for k, e in enumerate(problem.campaign):
        noise = noise_in_range(problem, middle, k)
        blocks = Blocks.of(e, 0.0 if noise is None else noise[0])
        rng = np.random.default_rng(streams[k])
        each = np.empty((2, len(thetas), len(blocks.starts)))
        for i, theta in enumerate(thetas):
            each[:, i] = _of_draw(problem, theta, k, blocks, rng)
            if i % 50 == 0:
                tell((k + i / len(thetas)) / len(problem.campaign), f"experiment {e.name}")
        likelihoods.append(each[0])
        replicates.append(each[1])
        observed.append(blocks.means(e.values[blocks.samples]))
        experiment += [k] * len(blocks.starts)
        times += blocks.means(e.t[blocks.samples]).tolist()
        memories.append(blocks.memory)
        durations.append(blocks.duration)
    tell(1.0, "done")
    place = _Place(experiment, times, max(memories), float(np.median(durations)))
    return (
        np.concatenate(likelihoods, axis=1), np.concatenate(replicates, axis=1),
        np.concatenate(observed), place,
    )  # fmt: skip


def _of_draw(
    problem: Problem, theta: FloatArray, k: int, blocks: Blocks, rng: np.random.Generator
) -> tuple[FloatArray, FloatArray]:
    """(n_blocks,) log densities, and means of replicated data, of one draw (n_theta,)."""
    noise = noise_in_range(problem, theta, k)
    if noise is None:
        return np.full(len(blocks.starts), -np.inf), np.full(len(blocks.starts), np.nan)
    phi, phi_reference, _, _ = noise
    e = problem.campaign.experiments[k]
    mean, variance = (v[blocks.samples] for v in mean_and_variance(problem, theta, k))
    scale = np.sqrt(variance)
    z = (e.values[blocks.samples] - mean) / scale
    over: float | FloatArray = phi
    if len(blocks.long):
        over = np.full(len(z) - 1, phi)
        steps = blocks.steps[blocks.long]
        pause = phi**steps if phi_reference < 0 else phi_reference ** (problem.steps(e) * steps)
        over[blocks.long] = pause
    rest = 1.0 - over**2
    squares = z[1:] - over * z[:-1]
    squares *= squares
    squares /= rest
    single = np.log(2.0 * np.pi * variance)
    single[1:] += np.log(rest)
    single[0] += z[0] ** 2
    single[1:] += squares
    single *= -0.5
    replicated = mean + simulate_noise(scale, over, rng)
    return np.add.reduceat(single, blocks.starts), blocks.means(replicated)


def _prior_draws(posterior: Posterior, seed: int) -> tuple[dict[str, FloatArray], float]:
    """Draws (1, PRIOR_DRAWS) by flat name, and how many of them count where they repeat, else 0.

    From the laws of the single parameters, weighed by the prior of all together, which also knows
    the order of the lags and what is known of them by name.  Flat parameters have no draws.
    """
    problem = posterior.problem
    layout, rng = problem.layout, np.random.default_rng([seed, 2])
    n = TRIES * PRIOR_DRAWS
    middle = np.median(posterior.draws, axis=0)
    thetas = np.tile(middle, (n, 1))
    single = np.zeros(n)
    flat = set()
    for i, name in enumerate(layout.names):
        if name in problem.fixed:
            continue
        prior = problem.priors[name]
        if prior.law is None:
            flat.add(name)
            continue
        thetas[:, i] = prior.law.rvs(size=n, random_state=rng)
        single += prior.log_density(thetas[:, i])
    weights = log_priors(problem, thetas) - single
    if not np.isfinite(weights).any():
        return {}, 0.0
    weights = np.exp(weights - weights.max())
    weights /= weights.sum()
    counted = float(1.0 / np.sum(weights**2))
    chosen = rng.choice(n, PRIOR_DRAWS, p=weights)
    drawn = replace(posterior, chains=thetas[chosen][None])
    names = [name for name in posterior.rows if name not in flat]
    found = {name: drawn.of(name)[None] for name in names}
    return found, counted if counted < 10 * PRIOR_DRAWS else 0.0
