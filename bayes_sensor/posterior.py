"""The posterior of a campaign: three samplers behind one call, convergence, and the record.

* ``emcee``: affine-invariant ensembles (Goodman and Weare 2010; differential evolution moves,
  ter Braak 2006) in the coordinates of :mod:`bayes_sensor.laplace`, with every y0 and beta
  integrated out analytically and redrawn afterwards.
* ``independence``: Metropolis-Hastings whose proposal is the Laplace approximation; gated by the
  Pareto k-hat of its weights, and replaced by ``hmc`` and then ``emcee`` when that gate shuts.
* ``hmc``: Hamiltonian Monte Carlo (Neal 2011) in whitened coordinates from the analytic gradient.

Convergence is judged between independent runs (for emcee: independent ensembles, since walkers of
one ensemble are not independent chains).
"""

from __future__ import annotations

import hashlib
import json
import os
from collections.abc import Callable
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from time import perf_counter
from typing import TYPE_CHECKING, Any

import numpy as np

from bayes_sensor import inference_data as idata
from bayes_sensor.campaign import Campaign, CampaignError, FloatArray
from bayes_sensor.compression import Compressed, Region
from bayes_sensor.laplace import (
    Coordinates,
    Laplace,
    approximate,
    log_posteriors,
    prior_gradient,
)
from bayes_sensor.likelihood import Prior, Problem, as_problem, log_priors
from bayes_sensor.model import Cascade, Layout
from bayes_sensor.noise import scale_squared

if TYPE_CHECKING:
    import pandas as pd

SAMPLERS = ("emcee", "independence", "hmc")
R_HAT_LIMIT = 1.01
ESS_LIMIT = 400.0
K_HAT_LIMIT = 0.5
SETTLING = 10
"""ensemble steps between looks at the mesh during burn-in"""
QUANTILES = (0.5, 2.5, 16.0, 50.0, 84.0, 97.5, 99.5)

Progress = Callable[[float, str], None]
"""called with the fraction done and a short text"""


@dataclass(frozen=True)
class Settings:
    """How to sample.  The defaults suit campaigns of any size."""

    n_chains: int = 4
    """independent runs (ensembles for emcee)"""
    n_walkers: int = 64
    """walkers of each ensemble; raised to twice the dimension where that is more"""
    chunk: int = 100
    """ensemble steps between checkpoints and convergence checks"""
    burn_in: int = 100
    """ensemble steps dropped at the start (walkers start from the Laplace approximation)"""
    max_steps: int = 3000
    """ensemble steps at which to give up"""
    thin: int = 5
    n_draws: int = 400
    """draws of each chain of the independence sampler and hmc"""
    max_draws: int = 16000
    target_ess: float = 1000.0
    """bulk ESS at which a run may stop; convergence itself asks for 400 in bulk and tail"""

    def __post_init__(self) -> None:
        for name in ("n_chains", "n_walkers", "chunk", "max_steps", "thin", "n_draws"):
            if getattr(self, name) < (2 if name == "n_chains" else 1):
                raise CampaignError(f"sampler setting {name} is too small: {getattr(self, name)}")


@dataclass(frozen=True, eq=False)
class Posterior:
    """Draws of theta and what is needed to trust them."""

    problem: Problem
    chains: FloatArray
    """(n_chain, n_draw, n_theta); for emcee a chain is an ensemble, its walkers end to end"""
    log_likelihood: FloatArray
    """(n_chain, n_draw, n_experiment)"""
    sampler: str
    """which sampler made the draws"""
    reasons: tuple[str, ...]
    """sentences: which sampler was used and why it can be trusted"""
    mesh_error: float
    """largest difference of log L between mesh and full pass over a few draws"""
    r_hat: FloatArray
    ess_bulk: FloatArray
    ess_tail: FloatArray
    settings: Settings = field(default_factory=Settings)
    seed: int = 1
    seconds: float = 0.0
    k_hat: float | None = None
    acceptance: float | None = None

    @property
    def layout(self) -> Layout:
        """Order of the flat vector."""
        return self.problem.layout

    @property
    def names(self) -> list[str]:
        """Flat names, in the order of the last axis of ``chains``."""
        return self.layout.names

    @cached_property
    def draws(self) -> FloatArray:
        """(n, n_theta), all chains together."""
        return self.chains.reshape(-1, self.chains.shape[-1])

    @cached_property
    def free(self) -> np.ndarray:
        """Positions of the parameters that vary."""
        return Coordinates(self.problem).free

    def of(self, name: str) -> FloatArray:
        """(n,) draws of one parameter."""
        return self.draws[:, self.layout.index(name)]

    def mean(self, name: str) -> float:
        """Posterior mean."""
        return float(self.of(name).mean())

    def sd(self, name: str) -> float:
        """Posterior standard deviation."""
        return float(self.of(name).std(ddof=1))

    def quantiles(self, name: str, probabilities: Any) -> FloatArray:
        """Posterior quantiles at ``probabilities`` between 0 and 1."""
        return np.quantile(self.of(name), probabilities)

    @property
    def converged(self) -> bool:
        """R-hat below 1.01 and bulk and tail ESS of at least 400 for every parameter."""
        r_hat, bulk, tail = (a[self.free] for a in (self.r_hat, self.ess_bulk, self.ess_tail))
        return bool(
            np.all(r_hat < R_HAT_LIMIT) and np.all(bulk >= ESS_LIMIT) and np.all(tail >= ESS_LIMIT)
        )

    @property
    def status(self) -> str:
        """One sentence: converged, or what falls short."""
        free = self.free
        worst = free[int(np.nanargmax(self.r_hat[free]))]
        least = free[int(np.nanargmin(np.minimum(self.ess_bulk, self.ess_tail)[free]))]
        ess = min(self.ess_bulk[least], self.ess_tail[least])
        numbers = (
            f"largest R-hat {self.r_hat[worst]:.4f} ({self.names[worst]}), "
            f"smallest effective sample size {ess:.0f} ({self.names[least]})"
        )
        return ("converged: " if self.converged else "NOT converged: ") + numbers

    @property
    def warnings(self) -> tuple[str, ...]:
        """Sentences a reader must see."""
        found = [] if self.converged else [self.status]
        if self.problem.campaign.same_flow:
            found.append(
                "all flows are equal: tau_v and V cannot be told apart by these data, "
                "their intervals come from the priors"
            )
        if self.mesh_error > 1e-3:
            found.append(f"the mesh is off by {self.mesh_error:.1e} in log L, more than 1e-3")
        return tuple(found)

    def summary(self) -> pd.DataFrame:
        """Mean, sd, percentiles and diagnostics of every varying parameter, one row each."""
        import pandas as pd

        rows = {name: self._row(i) for i, name in enumerate(self.names) if i in set(self.free)}
        return pd.DataFrame.from_dict(rows, orient="index")

    def _row(self, i: int) -> dict[str, float]:
        draws = self.draws[:, i]
        row = {"mean": float(draws.mean()), "sd": float(draws.std(ddof=1))}
        for percent, value in zip(QUANTILES, np.percentile(draws, QUANTILES), strict=True):
            row[f"q{percent:g}"] = float(value)
        row["ess_bulk"] = float(self.ess_bulk[i])
        row["ess_tail"] = float(self.ess_tail[i])
        row["r_hat"] = float(self.r_hat[i])
        return row

    def to_json(self) -> dict[str, Any]:
        """The contents of ``posterior.json``; parameters that the noise law pins are null."""
        parameters: dict[str, Any] = {}
        for i, name in enumerate(self.names):
            parameters[name] = self._row(i) if i in set(self.free) else None
        return {
            "parameters": parameters,
            "n_draws": len(self.draws),
            "converged": self.converged,
            "status": self.status,
            "sampler": self.sampler,
            "reasons": list(self.reasons),
            "warnings": list(self.warnings),
            "k_hat": self.k_hat if self.k_hat is not None and np.isfinite(self.k_hat) else None,
            "acceptance": self.acceptance,
            "log_likelihood_error": self.mesh_error,
            "seed": self.seed,
            "seconds": self.seconds,
            "priors": {n: str(self.problem.priors[n]) for n in self.names if n in self._varying},
            "phi_interval_s": self.problem.campaign.reference_interval,
            "signal_unit": self.problem.campaign.signal_unit,
            "tau_under_priors": self.tau_under_priors().to_dict(orient="records"),
        }

    @cached_property
    def _varying(self) -> set[str]:
        return {self.names[i] for i in self.free}

    def tau_under_priors(self) -> pd.DataFrame:
        """Intervals and upper limits of tau (s) under other priors, by reweighting the draws.

        Rows: flat, half-normal, log-uniform with a floor (a hundredth of the half-normal's scale).
        Columns: equal-tailed 95 % interval, highest-density 95 % interval, one-sided 95 and 99 %
        upper limits, and the effective number of draws that the reweighting leaves.
        """
        import pandas as pd

        current = self.problem.priors["tau_s"]
        scale = current.a if current.kind == "half_normal" else 0.2
        tau = self.of("tau_s")
        top = max(float(tau.max()), scale)
        laws = {
            "flat": Prior("flat"),
            "half_normal": Prior("half_normal", scale),
            "log_uniform_floored": Prior("log_uniform", scale / 100.0, 10.0 * top),
        }
        rows = []
        for label, law in laws.items():
            # below the floor the log-uniform law is flat, so that it stays proper at zero
            value = law.log_density(np.maximum(tau, law.a) if law.kind == "log_uniform" else tau)
            log_w = value - current.log_density(tau)
            w = np.exp(log_w - log_w.max())
            w /= w.sum()
            lo, hi, up95, up99 = _weighted_quantiles(tau, w, [0.025, 0.975, 0.95, 0.99])
            hdi_lo, hdi_hi = _highest_density(tau, w, 0.95)
            rows.append(
                {
                    "prior": label,
                    "law": str(law),
                    "lo95_s": lo,
                    "hi95_s": hi,
                    "hdi_lo95_s": hdi_lo,
                    "hdi_hi95_s": hdi_hi,
                    "upper95_s": up95,
                    "upper99_s": up99,
                    "n_effective": float(1.0 / np.sum(w**2)),
                }
            )
        return pd.DataFrame(rows)

    @cached_property
    def inference_data(self) -> Any:
        """ArviZ InferenceData (a DataTree in ArviZ 1.x): posterior, log_likelihood,
        posterior_predictive (a summary on a coarse grid), observed_data, constant_data."""
        return _inference_data(self)

    def save(self, path: str | Path) -> None:
        """Write ``posterior.nc``, under a temporary name first."""
        path = Path(path)
        temporary = path.with_name(f".{path.name}.{os.getpid()}")
        try:
            idata.save(self.inference_data, temporary)
            os.replace(temporary, path)
        finally:
            temporary.unlink(missing_ok=True)


def load_chains(path: str | Path) -> tuple[list[str], FloatArray]:
    """Flat names and chains (n_chain, n_draw, n_theta) of a saved ``posterior.nc``."""
    data = idata.load(Path(path))["posterior"]
    names, columns = [], []
    for kind, flat in _VARIABLES.items():
        if kind not in data:
            continue
        variable = data[kind]
        if "experiment" not in variable.dims:
            names.append(flat)
            columns.append(variable.values)
            continue
        for name in variable["experiment"].values:
            values = variable.sel(experiment=name).values
            if np.isfinite(values).all():
                names.append(f"{flat}[{name}]")
                columns.append(values)
    return names, np.stack(columns, axis=-1)


_VARIABLES = {
    "tau": "tau_s", "tau_v": "tau_v_s", "V": "V_mL", "phi": "phi", "sigma0": "sigma0_V",
    "sigma1": "sigma1_V", "y0": "y0_V", "beta": "beta_V", "t0": "t0_s", "tf": "tf_s",
}  # fmt: skip


def _weighted_quantiles(x: FloatArray, w: FloatArray, probabilities: list[float]) -> list[float]:
    order = np.argsort(x)
    cumulative = np.cumsum(w[order]) - 0.5 * w[order]
    return [float(v) for v in np.interp(probabilities, cumulative, x[order])]


def _highest_density(x: FloatArray, w: FloatArray, level: float) -> tuple[float, float]:
    """Shortest interval that holds ``level`` of the weighted draws."""
    order = np.argsort(x)
    x, cumulative = x[order], np.concatenate([[0.0], np.cumsum(w[order])])
    starts = np.flatnonzero(cumulative[:-1] <= cumulative[-1] - level)
    ends = np.searchsorted(cumulative, cumulative[starts] + level) - 1
    ends = np.minimum(ends, len(x) - 1)
    best = int(np.argmin(x[ends] - x[starts]))
    return float(x[starts[best]]), float(x[ends[best]])


# --------------------------------------------------------------------------- the call


def sample_posterior(
    campaign: Campaign | Problem,
    fit: Any = None,
    seed: int = 1,
    sampler: str = "emcee",
    settings: Settings | None = None,
    jobs: int = 1,
    checkpoint: str | Path | None = None,
    resume: bool = False,
    progress: Progress | None = None,
) -> Posterior:
    """Draw from the posterior of every parameter of a campaign.

    Parameters
    ----------
    fit
        where to start: a Fit (its ``theta_hat``), or anything that ``theta`` may be; None fits
        first.
    sampler
        ``emcee`` (default), ``independence`` or ``hmc``; see the module's text.
    jobs
        processes for emcee's ensembles; the numbers do not depend on it.
    checkpoint, resume
        folder for emcee's unfinished ensembles; with ``resume`` a matching run goes on from there
        and gives the chain that an uninterrupted run would have given.

    Returns a :class:`Posterior`; ``converged`` and ``status`` say whether to trust it.

    Raises CampaignError for a design, an unknown sampler or a malformed start.
    """
    started = perf_counter()
    problem = as_problem(campaign)
    settings = settings or Settings()
    if sampler not in SAMPLERS:
        raise CampaignError(f"sampler must be one of {', '.join(SAMPLERS)}, but is '{sampler}'")
    if problem.campaign.is_design:
        raise CampaignError("a design has no data to condition on; simulate or measure it first")
    report = progress or (lambda fraction, text: None)
    if fit is None:
        from bayes_sensor.fit import fit_least_squares

        fit = fit_least_squares(problem, seed=seed)
    start = problem.layout.flat(getattr(fit, "theta_hat", fit))
    report(0.0, "Laplace approximation")
    laplace, compressed = approximate(problem, start)
    streams = np.random.SeedSequence(seed)
    reasons: list[str] = []
    run = None
    if sampler == "independence":
        run = _independence(problem, laplace, compressed, settings, streams, report)
        reasons.append(run.reason)
        if not run.good:
            sampler = "hmc"
    if sampler == "hmc":
        run = _hmc(problem, laplace, compressed, settings, streams, report)
        reasons.append(run.reason)
        if not run.good:
            sampler = "emcee"
    if sampler == "emcee":
        folder = None if checkpoint is None else Path(checkpoint)
        digest = _digest(problem, start, settings, seed)
        run = _emcee(
            problem, laplace, compressed, settings, seed, jobs, folder, resume, digest, report
        )
        reasons.append(run.reason)
    assert run is not None  # one of the three has run
    chains = run.chains
    r_hat, bulk, tail = run.diagnosis or _diagnose(problem, chains)
    n_chain, n_draw, n_theta = chains.shape
    each = compressed.log_likelihoods(chains.reshape(-1, n_theta))
    few = chains.reshape(-1, n_theta)[:: max(1, n_chain * n_draw // 6)][:6]
    report(1.0, "done")
    return Posterior(
        problem=problem,
        chains=chains,
        log_likelihood=each.reshape(n_chain, n_draw, -1),
        sampler=run.sampler,
        reasons=tuple(reasons),
        mesh_error=compressed.error(few),
        r_hat=r_hat,
        ess_bulk=bulk,
        ess_tail=tail,
        settings=settings,
        seed=seed,
        seconds=perf_counter() - started,
        k_hat=run.k_hat,
        acceptance=run.acceptance,
    )


@dataclass(frozen=True)
class _Run:
    sampler: str
    chains: FloatArray
    good: bool
    reason: str
    acceptance: float
    k_hat: float | None = None
    diagnosis: tuple[FloatArray, FloatArray, FloatArray] | None = None


def _diagnose(problem: Problem, chains: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
    free = Coordinates(problem).free
    out = [np.full(chains.shape[-1], np.nan) for _ in range(3)]
    for target, values in zip(out, idata.diagnostics(chains[:, :, free]), strict=True):
        target[free] = values
    return out[0], out[1], out[2]


def _enough(
    problem: Problem, chains: FloatArray, target: float
) -> tuple[bool, tuple[FloatArray, FloatArray, FloatArray]]:
    """Whether the chains agree and are long enough; also their diagnostics."""
    found = _diagnose(problem, chains)
    free = Coordinates(problem).free
    r_hat, bulk, tail = (values[free] for values in found)
    done = np.all(r_hat < R_HAT_LIMIT) and np.all(bulk >= target) and np.all(tail >= ESS_LIMIT)
    return bool(done), found


# --------------------------------------------------------------------------- independence


def _independence(
    problem: Problem,
    laplace: Laplace,
    compressed: Compressed,
    settings: Settings,
    streams: np.random.SeedSequence,
    report: Progress,
) -> _Run:
    rngs = [np.random.default_rng(s) for s in streams.spawn(settings.n_chains)]
    chains = [np.empty((0, len(problem.layout))) for _ in rngs]
    states: list[Any] = [None] * len(rngs)
    weights: list[FloatArray] = []
    accepted = tried = 0
    n = settings.n_draws
    while True:
        for j, rng in enumerate(rngs):
            extra = 1 if states[j] is None else 0
            thetas, log_q = laplace.draw(n + extra, rng, inflate=1.08)
            log_w = log_posteriors(compressed, laplace.coordinates, thetas, roots=True) - log_q
            weights.append(log_w)
            if states[j] is None:
                if not np.isfinite(log_w).any():
                    reason = (
                        "independence Metropolis was given up: no draw of the Laplace "
                        "approximation lies inside the priors"
                    )
                    return _Run("independence", np.empty((0, 0, 0)), False, reason, 0.0, None)
                start = int(np.argmax(np.isfinite(log_w)))
                states[j] = (thetas[start], log_w[start])
                thetas, log_w = np.delete(thetas, start, axis=0), np.delete(log_w, start)
            current, current_w = states[j]
            out = np.empty((n, thetas.shape[1]))
            log_u = np.log(rng.random(n))
            for i in range(n):
                if log_u[i] < log_w[i] - current_w:
                    current, current_w = thetas[i], log_w[i]
                    accepted += 1
                out[i] = current
            tried += n
            states[j] = (current, current_w)
            chains[j] = np.concatenate([chains[j], out])
        k_hat = idata.pareto_k(np.concatenate(weights))
        acceptance = accepted / tried
        report(min(0.95, len(chains[0]) / settings.max_draws), "independence Metropolis")
        stacked = np.stack(chains)
        if k_hat >= K_HAT_LIMIT or acceptance < 0.1:
            reason = (
                f"independence Metropolis was given up: Pareto k-hat {k_hat:.2f} "
                f"(limit {K_HAT_LIMIT}), acceptance {acceptance:.2f}"
            )
            return _Run("independence", stacked, False, reason, acceptance, k_hat)
        done, found = _enough(problem, stacked, settings.target_ess)
        if done or len(chains[0]) >= settings.max_draws:
            reason = (
                f"independence Metropolis from the Laplace approximation: acceptance "
                f"{acceptance:.2f}, Pareto k-hat {k_hat:.2f} (trusted below {K_HAT_LIMIT}), "
                f"{settings.n_chains} independent chains compared"
            )
            return _Run("independence", stacked, True, reason, acceptance, k_hat, found)


# --------------------------------------------------------------------------- hmc


class _Whitened:
    """The log posterior in whitened coordinates q: psi with signed roots of its squares.

    In (x, ..) with tau = |x| the density continues smoothly through zero, because the likelihood
    depends on tau^2 there; no wall, no reflection.
    """

    def __init__(self, laplace: Laplace, compressed: Compressed) -> None:
        self.coordinates, self.compressed = laplace.coordinates, compressed
        thetas, _ = laplace.draw(2000, np.random.default_rng(12345))
        roots = self._roots(thetas)
        self.pinned = self.coordinates.theta(np.zeros(roots.shape[1]))
        self.centre = roots.mean(axis=0)
        self.factor = np.linalg.cholesky(
            np.cov(roots.T) + 1e-12 * np.diag(roots.var(axis=0) + 1e-300)
        )

    def _roots(self, thetas: FloatArray) -> FloatArray:
        psi = self.coordinates.psi(thetas)
        psi[..., self.coordinates.squared] = np.sqrt(psi[..., self.coordinates.squared])
        return psi

    def q(self, thetas: FloatArray) -> FloatArray:
        return np.linalg.solve(self.factor, (self._roots(thetas) - self.centre).T).T

    def theta(self, q: FloatArray) -> FloatArray:
        psi = self.centre + q @ self.factor.T
        psi[..., self.coordinates.squared] **= 2
        return self.coordinates.theta(psi)

    def value_and_gradient(self, q: FloatArray) -> tuple[float, FloatArray]:
        """Log density (up to a constant) and its gradient (n,) at one point q (n,)."""
        coordinates = self.coordinates
        squared, phi, sigma0 = coordinates.squared, coordinates.phi, coordinates.sigma0
        roots = self.centre + self.factor @ q
        # the same as coordinates.theta, in fewer steps: this is the innermost loop
        values = roots.copy()
        values[squared] = np.abs(values[squared])
        values[coordinates.switches] -= values[0]
        values[phi] = np.tanh(values[phi])
        values[sigma0] = np.exp(np.minimum(values[sigma0], 300.0))
        theta = self.pinned.copy()
        theta[coordinates.free] = values
        prior = log_priors(coordinates.problem, theta[None])[0]
        if not np.isfinite(prior):
            return -np.inf, np.zeros_like(q)
        value, gradient = self.compressed.value_and_gradient(theta)
        slope = 1.0 - values[phi] ** 2
        value += prior + float(np.log(slope).sum() + np.log(values[sigma0]).sum())
        g = (gradient + prior_gradient(coordinates.problem, theta))[coordinates.free]
        # t0 = root - tau, and tau = |root|: its derivative is a sign
        g[0] -= g[coordinates.switches].sum()
        g[squared] *= np.sign(roots[squared])
        g[phi] = g[phi] * slope - 2.0 * values[phi]
        g[sigma0] = g[sigma0] * values[sigma0] + 1.0
        return float(value), self.factor.T @ g


def _hmc(
    problem: Problem,
    laplace: Laplace,
    compressed: Compressed,
    settings: Settings,
    streams: np.random.SeedSequence,
    report: Progress,
) -> _Run:
    target = _Whitened(laplace, compressed)
    rngs = [np.random.default_rng(s) for s in streams.spawn(settings.n_chains)]
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
            report(min(0.95, (len(chains[0]) + j * block / len(rngs)) / settings.max_draws), "HMC")
        stacked = target.theta(np.stack(chains))
        done, found = _enough(problem, stacked, settings.target_ess)
        if done or len(chains[0]) >= settings.max_draws // 2:
            reason = (
                "Hamiltonian Monte Carlo with the analytic gradient in whitened coordinates: "
                f"mean acceptance {accepted / tried:.2f}, "
                f"{settings.n_chains} independent chains compared"
            )
            if not done:
                reason += "; it did not reach its target and was given up"
            return _Run("hmc", stacked, done, reason, accepted / tried, None, found)


_State = tuple[FloatArray, float, FloatArray]  # position, log density, its gradient


def _leapfrog(
    target: _Whitened, state: _State, size: float, rng: np.random.Generator
) -> tuple[_State, float]:
    q, value, g = state
    p = rng.standard_normal(len(q))
    # a quarter turn makes draws from a Gaussian independent; jittered against resonances
    size = size * rng.uniform(0.8, 1.2)
    steps = max(1, round(0.5 * np.pi * rng.uniform(0.8, 1.2) / size))
    steps = min(steps, 64)
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


# --------------------------------------------------------------------------- emcee


class _Marginal:
    """Log posterior of the ensemble's coordinates, vectorised over walkers."""

    def __init__(self, problem: Problem, compressed: Compressed, marginalise: bool) -> None:
        self.coordinates, self.compressed = Coordinates(problem), compressed
        self.marginalise = marginalise
        n_psi = len(self.coordinates.free)
        drop = set(self.coordinates.linear.ravel()) if marginalise else set()
        self.kept = np.array([i for i in range(n_psi) if i not in drop])
        self.reference = self.coordinates.psi(compressed.reference)

    def thetas(self, points: FloatArray) -> FloatArray:
        psi = np.tile(self.reference, (len(points), 1))
        psi[:, self.kept] = points
        return self.coordinates.theta(psi)

    def points(self, thetas: FloatArray) -> FloatArray:
        return self.coordinates.psi(thetas)[:, self.kept]

    def __call__(self, points: FloatArray) -> FloatArray:
        squared = np.flatnonzero(np.isin(self.kept, self.coordinates.squared))
        total = np.where((points[:, squared] > 0).all(axis=1), 0.0, -np.inf)
        good = np.flatnonzero(np.isfinite(total))
        thetas = self.thetas(points[good])
        values = log_priors(self.coordinates.problem, thetas)
        values = values + self.coordinates.log_jacobian(thetas)
        inside = np.isfinite(values)
        if inside.any():
            if self.marginalise:
                values[inside] += self.compressed.marginals(thetas[inside])[0]
            else:
                values[inside] += self.compressed.log_likelihoods(thetas[inside]).sum(axis=1)
        total[good] = values
        return np.where(np.isnan(total), -np.inf, total)

    def cover(self, points: FloatArray) -> None:
        """Widen the mesh where walkers have left it, so that they stay off the full pass."""
        thetas = self.thetas(points)[:, : self.coordinates.problem.layout.n_mean]
        n_mean = thetas.shape[1]
        region = self.compressed.region
        low, high = region.low.copy(), region.high.copy()
        least, most = thetas.min(axis=0), thetas.max(axis=0)
        if (least >= low[:n_mean]).all() and (most <= high[:n_mean]).all():
            return
        room = most - least
        low[:n_mean] = np.minimum(low[:n_mean], least - room)
        high[:n_mean] = np.maximum(high[:n_mean], most + room)
        layout = self.coordinates.problem.layout
        for i in layout.local[:, 2:].ravel():
            prior = self.coordinates.problem.priors[layout.names[i]] if i >= 0 else None
            # a switch time that the data hardly hold goes wherever its prior lets it
            if (
                prior
                and prior.kind == "uniform"
                and most[i] - least[i] > 0.05 * (prior.b - prior.a)
            ):
                low[i], high[i] = prior.a - 1e-9, prior.b + 1e-9
        low[0] = 0.0
        low[1:3] = np.maximum(low[1:3], 0.5 * least[1:3])
        self.compressed = Compressed(
            self.coordinates.problem, self.compressed.reference, Region(low, high)
        )

    def redraw(self, thetas: FloatArray, rng: np.random.Generator) -> FloatArray:
        """``thetas`` with y0 and beta drawn from their exact conditional law."""
        if not self.marginalise:
            return thetas
        _, best, factor = self.compressed.marginals(thetas)
        z = rng.standard_normal(best.shape)
        beta = z[:, :, 1] / factor[:, :, 2]
        y0 = (z[:, :, 0] - factor[:, :, 1] * beta) / factor[:, :, 0]
        local = self.coordinates.problem.layout.local
        thetas = thetas.copy()
        thetas[:, local[:, 0]] = best[:, :, 0] + y0
        thetas[:, local[:, 1]] = best[:, :, 1] + beta
        return thetas


def _ensemble(target: _Marginal, state: Any, n_steps: int) -> tuple[FloatArray, Any, float]:
    """Advance one ensemble: positions (n_steps, n_walkers, n), the new state, mean acceptance."""
    import emcee

    n_walkers, n_dim = state[0].shape
    sampler = emcee.EnsembleSampler(
        n_walkers,
        n_dim,
        target,
        vectorize=True,
        # emcee 3.1.6's DESnookerMove is biased and stays out
        moves=[(emcee.moves.DEMove(), 0.8), (emcee.moves.StretchMove(), 0.2)],
    )
    begin = emcee.State(state[0], log_prob=state[1], random_state=state[2])
    last = sampler.run_mcmc(begin, n_steps, skip_initial_state_check=True, store=True)
    acceptance = float(sampler.acceptance_fraction.mean())
    return sampler.get_chain(), (last.coords, last.log_prob, last.random_state), acceptance


def _emcee(
    problem: Problem,
    laplace: Laplace,
    compressed: Compressed,
    settings: Settings,
    seed: int,
    jobs: int,
    folder: Path | None,
    resume: bool,
    digest: str,
    report: Progress,
) -> _Run:
    names = problem.layout.names
    # exact only for flat priors and a mean y0 + beta x
    flat = type(problem.model).mean is Cascade.mean and all(
        problem.priors[name].kind == "flat" for name in names if name[:4] in ("y0_V", "beta")
    )
    target = _Marginal(problem, compressed, marginalise=flat)
    n_dim = len(target.kept)
    n_walkers = max(settings.n_walkers, 2 * n_dim + 2)
    store = _Checkpoint(folder, digest, resume)
    states: list[Any] = []
    chains: list[list[FloatArray]] = []
    acceptance: list[list[float]] = []
    begins = []
    for j in range(settings.n_chains):
        rng = np.random.default_rng(np.random.SeedSequence([seed, j]))
        points = _start(target, laplace, n_walkers, rng)
        begins.append((points, None, np.random.RandomState(rng.integers(2**32)).get_state()))
    target.cover(np.concatenate([begin[0] for begin in begins]))
    for j in range(settings.n_chains):
        chunks, state, rates = store.read(j) or ([], begins[j], [])
        chains.append(chunks)
        states.append(state)
        acceptance.append(rates)
    # a resumed run sees the meshes that the uninterrupted one saw
    n_covered = min(len(chain) for chain in chains)
    for i in range(n_covered):
        target.cover(np.concatenate([chain[i][-1] for chain in chains]))
    while True:
        # short chunks at first: the mesh follows the walkers while they settle
        chunk = min(len(chain) for chain in chains)
        n_settling = settings.burn_in // SETTLING
        n_steps = SETTLING if chunk < n_settling else settings.chunk
        todo = [j for j in range(settings.n_chains) if len(chains[j]) == chunk]
        for j, (chain, state, rate) in zip(
            todo, _advance(target, [states[j] for j in todo], n_steps, jobs), strict=True
        ):
            chains[j].append(chain)
            states[j] = state
            acceptance[j].append(rate)
            store.write(j, len(chains[j]) - 1, chain, state, rate)
        for i in range(n_covered, len(chains[0])):
            target.cover(np.concatenate([chain[i][-1] for chain in chains]))
        n_covered = len(chains[0])
        steps = sum(len(c) for c in chains[0])
        report(min(0.95, steps / settings.max_steps), f"emcee, {steps} steps")
        if steps < settings.burn_in + 2 * settings.chunk:
            continue
        thinned = [np.concatenate(chain)[settings.burn_in :: settings.thin] for chain in chains]
        # walkers end to end: each walker's own autocorrelation is what ESS must see
        stacked = np.stack([c.transpose(1, 0, 2).reshape(-1, n_dim) for c in thinned])
        thetas = target.thetas(stacked.reshape(-1, n_dim))
        full = steps >= settings.max_steps or _hopeless(stacked, steps, settings)
        quick = stacked[:, :, : min(n_dim, 3)]
        r_hat, bulk, _ = idata.diagnostics(quick)
        if not full and not (np.all(r_hat < R_HAT_LIMIT) and np.all(bulk > settings.target_ess)):
            continue
        rng = np.random.default_rng(np.random.SeedSequence([seed, 10**6, steps]))
        drawn = target.redraw(thetas, rng).reshape(*stacked.shape[:2], -1)
        done, found = _enough(problem, drawn, settings.target_ess)
        if full or done:
            rate = float(np.mean([np.mean(a) for a in acceptance]))
            how = "y0 and beta integrated out exactly and redrawn" if flat else "all parameters"
            reason = (
                f"emcee: {settings.n_chains} independent ensembles of {n_walkers} walkers, "
                f"{steps} steps ({settings.burn_in} dropped), {how}; acceptance {rate:.2f}; "
                "convergence judged between ensembles"
            )
            return _Run("emcee", drawn, True, reason, rate, None, found)


def _hopeless(stacked: FloatArray, steps: int, settings: Settings) -> bool:
    """Whether all steps allowed would leave the effective sample size below half of what is asked.

    Looked at every 500 steps; it saves an hour where the answer is "not converged" anyway.
    """
    if steps < 500 or (steps - settings.burn_in) % 500 != 0:
        return False
    _, bulk, _ = idata.diagnostics(stacked)
    return bool(np.nanmin(bulk) * settings.max_steps / steps < 0.5 * ESS_LIMIT)


def _advance(
    target: _Marginal, states: list[Any], n_steps: int, jobs: int
) -> list[tuple[FloatArray, Any, float]]:
    if jobs in (0, 1) or len(states) == 1:
        return [_ensemble(target, state, n_steps) for state in states]
    from joblib import Parallel, delayed

    return list(
        Parallel(n_jobs=jobs)(delayed(_ensemble)(target, state, n_steps) for state in states)
    )


def _start(target: _Marginal, laplace: Laplace, n: int, rng: np.random.Generator) -> FloatArray:
    """(n, n_dim) walkers of finite density: draws of the Laplace approximation where the priors
    allow them, else draws pulled towards its maximum, which always is allowed."""
    found = np.empty((0, len(target.kept)))
    centre = target.points(laplace.theta[None])
    shrink = 1.0
    for _ in range(60):
        drawn = target.points(laplace.draw(2 * n, rng)[0])
        points = centre + shrink * (drawn - (laplace.mean[target.kept] if shrink < 1 else centre))
        found = np.concatenate([found, points[np.isfinite(target(points))]])
        if len(found) >= n:
            return found[:n]
        shrink *= 0.8
    raise CampaignError(
        "no starting point with a positive posterior density was found; "
        "the priors (side information, commanded times) contradict the data"
    )


class _Checkpoint:
    """Chunks of ensembles on disk, each written whole or not at all."""

    def __init__(self, folder: Path | None, digest: str, resume: bool) -> None:
        self.folder, self.digest = folder, digest
        if folder is None:
            return
        folder.mkdir(parents=True, exist_ok=True)
        marker = folder / "run.json"
        known = json.loads(marker.read_text()) if marker.exists() else None
        if not resume or known != {"digest": digest}:
            for old in folder.glob("ensemble-*.npz"):
                old.unlink()
            _replace(marker, json.dumps({"digest": digest}).encode())

    def _path(self, j: int, i: int) -> Path:
        assert self.folder is not None  # only reached with a folder
        return self.folder / f"ensemble-{j}-{i:05d}.npz"

    def read(self, j: int) -> Any:
        """(chunks, state, acceptances) of ensemble ``j``, or None where nothing is saved."""
        if self.folder is None:
            return None
        chunks: list[FloatArray] = []
        rates: list[float] = []
        state = None
        while self._path(j, len(chunks)).exists():
            with np.load(self._path(j, len(chunks)), allow_pickle=False) as saved:
                chunks.append(saved["chain"])
                rates.append(float(saved["acceptance"]))
                random = ("MT19937", saved["keys"], int(saved["position"]),
                          int(saved["has_gauss"]), float(saved["gauss"]))  # fmt: skip
                state = (saved["coords"], saved["log_prob"], random)
        return None if state is None else (chunks, state, rates)

    def write(self, j: int, i: int, chain: FloatArray, state: Any, rate: float) -> None:
        """Save chunk ``i`` of ensemble ``j`` with the state it ended in."""
        if self.folder is None:
            return
        import io

        coords, log_prob, random = state
        buffer = io.BytesIO()
        np.savez(
            buffer, chain=chain, coords=coords, log_prob=log_prob, acceptance=rate,
            keys=random[1], position=random[2], has_gauss=random[3], gauss=random[4],
        )  # fmt: skip
        _replace(self._path(j, i), buffer.getvalue())


def _replace(path: Path, content: bytes) -> None:
    temporary = path.with_name(f".{path.name}.{os.getpid()}")
    temporary.write_bytes(content)
    os.replace(temporary, path)


def _digest(problem: Problem, start: FloatArray, settings: Settings, seed: int) -> str:
    """Identifies a run: data, model, priors, start, settings and seed."""
    hasher = hashlib.sha256()
    for e in problem.campaign:
        hasher.update(np.ascontiguousarray(e.values[e.used]).tobytes())
        hasher.update(repr((e.name, e.interval, e.total_flow, e.concentration)).encode())
    hasher.update(np.ascontiguousarray(start).tobytes())
    hasher.update(repr((problem.noise, problem.model, sorted(problem.priors.items()))).encode())
    hasher.update(repr((settings, seed)).encode())
    return hasher.hexdigest()


# --------------------------------------------------------------------------- InferenceData


def _inference_data(posterior: Posterior) -> Any:
    import xarray

    from bayes_sensor import __version__

    problem, layout, chains = posterior.problem, posterior.layout, posterior.chains
    campaign = problem.campaign
    names = campaign.names_of_experiments
    n_chain, n_draw, _ = chains.shape
    coordinates: dict[str, Any] = {
        "chain": np.arange(n_chain), "draw": np.arange(n_draw), "experiment": names,
    }  # fmt: skip
    variables: dict[str, Any] = {}
    for variable, flat in _VARIABLES.items():
        if flat in layout.names:
            variables[variable] = (("chain", "draw"), chains[:, :, layout.index(flat)])
            continue
        columns = [
            chains[:, :, layout.index(f"{flat}[{name}]")]
            if f"{flat}[{name}]" in layout.names
            else np.full((n_chain, n_draw), np.nan)
            for name in names
        ]
        if any(f"{flat}[{name}]" in layout.names for name in names):
            variables[variable] = (("chain", "draw", "experiment"), np.stack(columns, axis=-1))
    for name in layout.extra:
        variables[name] = (("chain", "draw"), chains[:, :, layout.index(name)])
    units = {"tau": "s", "tau_v": "s", "V": "mL", "t0": "s", "tf": "s", "phi": "1"}
    group = xarray.Dataset(variables, coords=coordinates)
    for variable in variables:
        group[variable].attrs["units"] = units.get(variable, campaign.signal_unit)
    predictive, observed = _predictive(posterior)
    attributes = {
        "created_by": f"bayes_sensor {__version__}",
        "sampler": posterior.sampler,
        "seed": posterior.seed,
        "converged": int(posterior.converged),
        "status": posterior.status,
        "reasons": " | ".join(posterior.reasons),
        "phi_interval_s": campaign.reference_interval,
        "log_likelihood_error": posterior.mesh_error,
        "priors": json.dumps({n: str(problem.priors[n]) for n in sorted(posterior._varying)}),
        "data_sha256": json.dumps({e.name: e.sha256 for e in campaign}),
    }
    likelihood = xarray.Dataset(
        {"log_likelihood": (("chain", "draw", "experiment"), posterior.log_likelihood)},
        coords=coordinates,
    )
    return idata.assemble(
        {
            "posterior": group,
            "log_likelihood": likelihood,
            "posterior_predictive": predictive,
            "observed_data": observed,
        },
        attributes,
    )


def _predictive(posterior: Posterior, n_times: int = 240, n_draws: int = 120) -> tuple[Any, Any]:
    """Summary of the replicated mean and of the data on a coarse grid of every experiment."""
    import xarray

    problem, layout = posterior.problem, posterior.layout
    campaign = problem.campaign
    some = posterior.draws[:: max(1, len(posterior.draws) // n_draws)][:n_draws]
    shape = (len(campaign), n_times)
    t, low, middle, high, spread, seen = (np.full(shape, np.nan) for _ in range(6))
    for k, e in enumerate(campaign):
        edges = np.linspace(0, len(e.t), n_times + 1).astype(int)
        used = e.used
        for b in range(n_times):
            part = slice(edges[b], max(edges[b + 1], edges[b] + 1))
            t[k, b] = e.t[part].mean()
            if used[part].any():
                seen[k, b] = e.values[part][used[part]].mean()
        means = np.array([problem.model.mean(t[k], row, layout, e) for row in some])
        low[k], middle[k], high[k] = np.quantile(means, [0.025, 0.5, 0.975], axis=0)
        row = some.mean(axis=0)
        x = problem.model.response(t[k], row, layout, e)
        _, sigma0, sigma1 = row[layout.noise[k]]
        weight = problem.noise.weight(campaign, e)
        spread[k] = np.sqrt(scale_squared(x, sigma0, sigma1, weight))
    dims = ("experiment", "bin")
    coordinates = {"experiment": campaign.names_of_experiments, "bin": np.arange(n_times)}
    predictive = xarray.Dataset(
        {
            "t": (dims, t),
            "mean_q2.5": (dims, low),
            "mean_q50": (dims, middle),
            "mean_q97.5": (dims, high),
            "sample_sd": (dims, spread),
        },
        coords=coordinates,
    )
    return predictive, xarray.Dataset({"t": (dims, t), "y": (dims, seen)}, coords=coordinates)
