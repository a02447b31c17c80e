"""Whether posteriors can be believed: rank statistics and coverage.

Simulation-based calibration (Talts, Betancourt, Simpson, Vehtari and Gelman, arXiv:1804.06788):
draw theta from the prior and data from theta; then the rank of theta among draws of the posterior
is uniform if, and for practical purposes only if, the posterior is right.  Uniformity is tested by
chi-squared and by simultaneous bands of the ECDF (Säilynoja, Bürkner and Vehtari, Stat. Comput. 32,
32, 2022).

Coverage at a fixed truth differs: a Bayesian interval has its level on average over the prior, and
near a boundary it may cover more or less; :class:`CoverageStudy` measures it.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import TYPE_CHECKING, Any

import numpy as np

from bayes_sensor.campaign import CampaignError, FloatArray
from bayes_sensor.checks.counted_coverage import coverage_row
from bayes_sensor.checks.study_chunks import seed_of, study_key
from bayes_sensor.likelihood.density import simulate
from bayes_sensor.likelihood.prior_density import log_priors
from bayes_sensor.likelihood.problem import Problem
from bayes_sensor.posterior import FASTEST, SAMPLERS, Posterior, Settings, sample_posterior

if TYPE_CHECKING:
    import pandas as pd

IntArray = np.ndarray
LEVELS = (0.68, 0.95, 0.997)
TAU_COLUMNS = (
    "lo95_s", "hi95_s", "hdi_lo95_s", "hdi_hi95_s", "upper95_s", "upper99_s", "n_effective",
)  # fmt: skip


def draw_prior(problem: Problem, rng: np.random.Generator) -> FloatArray:
    """One theta (n_theta,) from the problem's prior, with tau <= tau_v.

    Raises CampaignError if a prior is improper, or refers to a name while lags have none, because
    it cannot be drawn from.
    """
    if len(problem.name_factors[1]):
        raise CampaignError(
            "the prior weighs names of lags by what is known of them, so nothing can be drawn from "
            "it; say in the campaign which lag is the sensor's (sensor_is)"
        )
    names = problem.layout.names
    flat = [n for n in names if n not in problem.fixed and problem.priors[n].law is None]
    if flat:
        raise CampaignError(
            f"the prior of {flat[0]} is flat, so nothing can be drawn from it; "
            "give a proper one in Problem.given_priors"
        )
    while True:
        theta = np.array(
            [
                problem.fixed[n]
                if n in problem.fixed
                else float(problem.priors[n].law.rvs(random_state=rng))
                for n in names
            ]
        )
        # the whole vector again: lags stand in it by size
        if np.isfinite(log_priors(problem, theta[None])[0]):
            return theta


def ranks_of(truth: FloatArray, draws: FloatArray, n_ranks: int) -> IntArray:
    """(n_theta,) how many of ``n_ranks`` evenly spaced draws (n, n_theta) lie below the truth.

    >>> ranks_of(np.array([0.5]), np.arange(4.0)[:, None], 4).tolist()
    [1]
    """
    if len(draws) < n_ranks:
        raise CampaignError(f"{n_ranks} ranks need as many draws, but there are {len(draws)}")
    some = draws[np.linspace(0, len(draws) - 1, n_ranks).round().astype(int)]
    ranks: np.ndarray = (some < truth).sum(axis=0)
    return ranks


@dataclass(frozen=True, eq=False)
class Ranks:
    """Ranks of true values among posterior draws, and the tests of their uniformity."""

    names: tuple[str, ...]
    ranks: IntArray
    """(n, n_names), each 0 .. n_ranks"""
    n_ranks: int

    def __post_init__(self) -> None:
        inside = (self.ranks >= 0) & (self.ranks <= self.n_ranks)
        if self.ranks.ndim != 2 or self.ranks.shape[1] != len(self.names) or not inside.all():
            raise CampaignError(
                f"ranks must have shape (n, {len(self.names)}) and lie in 0 .. {self.n_ranks}"
            )

    @property
    def n(self) -> int:
        """How many campaigns."""
        return len(self.ranks)

    def histogram(self, n_bins: int = 16) -> IntArray:
        """(n_names, n_bins) counts; ``n_bins`` must divide ``n_ranks + 1``."""
        if (self.n_ranks + 1) % n_bins:
            raise CampaignError(f"{n_bins} bins do not divide {self.n_ranks + 1} possible ranks")
        width = (self.n_ranks + 1) // n_bins
        return np.stack([np.bincount(r // width, minlength=n_bins) for r in self.ranks.T])

    def chi_squared(self, n_bins: int = 16) -> tuple[FloatArray, FloatArray]:
        """Pearson's statistic against uniformity and its p-value, (n_names,) each."""
        from scipy import stats

        expected = self.n / n_bins
        statistic = ((self.histogram(n_bins) - expected) ** 2 / expected).sum(axis=1)
        return statistic, stats.chi2.sf(statistic, n_bins - 1)

    @cached_property
    def ecdf_difference(self) -> FloatArray:
        """(n_names, n_ranks) ECDF of the ranks minus the uniform one, at ranks 0 .. n_ranks - 1."""
        return self._counts / self.n - self._uniform

    @property
    def _uniform(self) -> FloatArray:
        return np.arange(1, self.n_ranks + 1) / (self.n_ranks + 1)

    @property
    def _counts(self) -> IntArray:
        each = [np.bincount(r, minlength=self.n_ranks + 1).cumsum()[:-1] for r in self.ranks.T]
        return np.stack(each)

    @cached_property
    def _simulated(self) -> tuple[FloatArray, FloatArray]:
        """Pointwise p-values of all counts (n_ranks, n + 1), their least along 4000 uniforms."""
        from scipy import stats

        counts = np.arange(self.n + 1)
        below = stats.binom.cdf(counts, self.n, self._uniform[:, None])
        above = stats.binom.sf(counts - 1, self.n, self._uniform[:, None])
        p = np.minimum(1.0, 2.0 * np.minimum(below, above))
        rng = np.random.default_rng(20220601)
        cells = np.full(self.n_ranks + 1, 1.0 / (self.n_ranks + 1))
        drawn = rng.multinomial(self.n, cells, size=4000).cumsum(axis=1)[:, :-1]
        return p, np.sort(p[np.arange(self.n_ranks), drawn].min(axis=1))

    def ecdf_band(self, level: float = 0.95) -> tuple[FloatArray, FloatArray]:
        """Lower and upper difference (n_ranks,) that hold a whole uniform ECDF with ``level``."""
        from scipy import stats

        gamma = float(np.quantile(self._simulated[1], 1.0 - level))
        low = stats.binom.ppf(0.5 * gamma, self.n, self._uniform)
        high = stats.binom.ppf(1.0 - 0.5 * gamma, self.n, self._uniform)
        return low / self.n - self._uniform, high / self.n - self._uniform

    def ecdf_p_values(self) -> FloatArray:
        """(n_names,) probability that a uniform ECDF has as large a difference anywhere."""
        p, simulated = self._simulated
        smallest = np.array([p[np.arange(self.n_ranks), c].min() for c in self._counts])
        # the simulated minima are discrete: allow for rounding at equality
        beaten = np.searchsorted(simulated, smallest * (1.0 + 1e-9), side="right")
        return np.asarray((beaten + 1.0) / (len(simulated) + 1.0), dtype=float)

    def table(self, n_bins: int = 16) -> pd.DataFrame:
        """One row a parameter: mean rank over its maximum, both tests, largest ECDF difference."""
        import pandas as pd

        statistic, p_chi2 = self.chi_squared(n_bins)
        return pd.DataFrame(
            {
                "parameter": list(self.names),
                "n": self.n,
                "n_ranks": self.n_ranks,
                "mean_rank": self.ranks.mean(axis=0) / self.n_ranks,
                "chi2": statistic,
                "chi2_bins": n_bins,
                "p_chi2": p_chi2,
                "largest_ecdf_difference": np.abs(self.ecdf_difference).max(axis=1),
                "p_ecdf": self.ecdf_p_values(),
            }
        )


@dataclass(frozen=True, eq=False)
class RankStudy:
    """The task of simulation-based calibration: campaign number i drawn, sampled and ranked."""

    problem: Problem
    """a design whose every prior is proper and explicit"""
    sampler: str = FASTEST
    settings: Settings = field(default_factory=Settings)
    n_ranks: int = 127
    seed: int = 1
    start: str = "truth"
    """``truth`` starts the Laplace approximation at the drawn theta, ``fit`` fits first"""

    @property
    def key(self) -> str:
        """Everything that the numbers depend on."""
        return study_key("ranks", self.problem, self.sampler, self.settings, self.n_ranks,
                         self.seed, self.start)  # fmt: skip

    def __call__(self, i: int) -> dict[str, Any]:
        """``theta``, ``ranks`` (-1: the sampler raised) and the sampler's message."""
        prior, data, sampling = np.random.SeedSequence([self.seed, i]).spawn(3)
        theta = draw_prior(self.problem, np.random.default_rng(prior))
        campaign = simulate(self.problem, theta, seed=seed_of(data))
        problem = replace(self.problem, campaign=campaign)
        start = theta if self.start == "truth" else None
        try:
            posterior = sample_posterior(
                problem, start, seed_of(sampling), self.sampler, self.settings
            )
            ranks = ranks_of(theta, posterior.draws, self.n_ranks)
        except (CampaignError, np.linalg.LinAlgError):
            return {"theta": theta, "ranks": np.full(len(theta), -1), **_SILENT}
        return {"theta": theta, "ranks": ranks, **_said(posterior)}


@dataclass(frozen=True, eq=False)
class CoverageStudy:
    """The task of a coverage study: campaign number i simulated at one theta and sampled."""

    problem: Problem
    theta: FloatArray
    """(n_theta,) the truth, as the draws of a posterior: lags by size"""
    sampler: str = FASTEST
    settings: Settings = field(default_factory=Settings)
    levels: tuple[float, ...] = LEVELS
    seed: int = 1
    start: str = "truth"

    def __post_init__(self) -> None:
        if self.problem.naming().place("sensor") is None:
            raise CampaignError(
                "CoverageStudy: expected a campaign that says which lag is the sensor's, but it is "
                "unknown, so tau has no interval to count; give it sensor_is"
            )
        object.__setattr__(self, "theta", self.problem.by_size(self.theta))

    @property
    def key(self) -> str:
        """Everything that the numbers depend on."""
        return study_key("coverage", self.problem, self.theta.tolist(), self.sampler, self.settings,
                         self.levels, self.seed, self.start)  # fmt: skip

    def __call__(self, i: int) -> dict[str, Any]:
        """Equal-tailed limits ``low`` and ``high`` (n_levels, n_theta), mean, sd, and ``tau``.

        ``tau`` (3, 7): the rows and columns of :meth:`Posterior.tau_under_priors`.
        """
        data, sampling = np.random.SeedSequence([self.seed, i]).spawn(2)
        campaign = simulate(self.problem, self.theta, seed=seed_of(data))
        problem = replace(self.problem, campaign=campaign)
        start = self.theta if self.start == "truth" else None
        posterior = sample_posterior(problem, start, seed_of(sampling), self.sampler, self.settings)
        tails = np.array([0.5 * (1.0 - level) for level in self.levels])
        # Weibull's plotting position: the mass beyond the limit is right on average over draws
        low, high = (
            np.quantile(posterior.draws, p, axis=0, method="weibull") for p in (tails, 1.0 - tails)
        )
        return {
            "low": low,
            "high": high,
            "mean": posterior.draws.mean(axis=0),
            "sd": posterior.draws.std(axis=0, ddof=1),
            "tau": posterior.tau_under_priors()[list(TAU_COLUMNS)].to_numpy(dtype=float),
            **_said(posterior),
        }


def _said(posterior: Posterior) -> dict[str, float]:
    return {
        "sampler": float(list(SAMPLERS).index(posterior.sampler)),
        "k_hat": np.nan if posterior.k_hat is None else float(posterior.k_hat),
        "refitted": float(posterior.sampler == FASTEST and "refitted" in posterior.reasons[0]),
        "mesh_error": posterior.mesh_error,
        "converged": float(posterior.converged),
        "r_hat": float(np.nanmax(posterior.r_hat)),
        "ess": float(np.nanmin(posterior.ess_bulk)),
    }


_SILENT = {
    "sampler": -1.0, "k_hat": np.nan, "refitted": 0.0, "mesh_error": np.nan, "converged": 0.0,
    "r_hat": np.nan, "ess": np.nan,
}  # fmt: skip


def coverage_table(
    names: tuple[str, ...] | list[str],
    truth: FloatArray,
    results: Mapping[str, np.ndarray],
    levels: tuple[float, ...] = LEVELS,
) -> pd.DataFrame:
    """One row a parameter and level, from the results of a :class:`CoverageStudy`."""
    import pandas as pd

    rows = []
    for i, name in enumerate(names):
        for j, level in enumerate(levels):
            low, high = results["low"][:, j, i], results["high"][:, j, i]
            inside = (low <= truth[i]) & (truth[i] <= high)
            row = {"parameter": name, "truth": truth[i], **coverage_row(inside, level)}
            rows.append({**row, "median_width": float(np.median(high - low))})
    return pd.DataFrame(rows)


TAU_CLAIMS = (
    ("interval 95 %", 0.95, "lo95_s", "hi95_s"),
    ("highest density 95 %", 0.95, "hdi_lo95_s", "hdi_hi95_s"),
    ("upper limit 95 %", 0.95, None, "upper95_s"),
    ("upper limit 99 %", 0.99, None, "upper99_s"),
)
TAU_PRIORS = ("flat", "half_normal", "log_uniform_floored")


def tau_table(truth: float, results: Mapping[str, np.ndarray]) -> pd.DataFrame:
    """Coverage of tau's intervals and upper limits under three priors, one row each."""
    import pandas as pd

    rows = []
    for j, prior in enumerate(TAU_PRIORS):
        values = dict(zip(TAU_COLUMNS, results["tau"][:, j].T))
        for claim, nominal, lower, upper in TAU_CLAIMS:
            low = values[lower] if lower else np.zeros(len(values[upper]))
            high = values[upper]
            rows.append(
                {
                    "prior": prior,
                    "claim": claim,
                    "tau_ms": 1e3 * truth,
                    **coverage_row((low <= truth) & (truth <= high), nominal),
                    "median_low_ms": 1e3 * float(np.median(low)),
                    "median_high_ms": 1e3 * float(np.median(high)),
                    "missed_below": int((high < truth).sum()),
                    "missed_above": int((low > truth).sum()),
                    "least_n_effective": float(values["n_effective"].min()),
                }
            )
    return pd.DataFrame(rows)
