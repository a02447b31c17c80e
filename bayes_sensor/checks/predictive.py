"""Posterior predictive checks: comparison of the data with data drawn from the posterior.

For draws theta of the posterior, a statistic of the data's standardised residuals is compared with
the same statistic of residuals replicated at the same theta (Gelman, Meng and Stern, Statistica
Sinica 6, 733, 1996): autocorrelation at several lags, variance against concentration, spectrum.

The time-series equivalent of LOO-PIT is one step ahead: u_i = P(y_i' < y_i | samples before i),
averaged over draws.  Each sample is predicted from its past alone, so with the right model the u_i
are uniform and independent (Dawid, J. R. Stat. Soc. A 147, 278, 1984; Diebold, Gunther and Tay,
Int. Econ. Rev. 39, 863, 1998).  theta was fitted to y_i, too.  The effect is of order n_theta/n,
1e-4 or less for recordings.  It makes the u_i slightly too central, never too extreme.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np

from bayes_sensor.campaign import CampaignError, Experiment, FloatArray
from bayes_sensor.display import record_card
from bayes_sensor.likelihood.density import mean_and_variance
from bayes_sensor.likelihood.noise import lag_coefficient, simulate_noise
from bayes_sensor.likelihood.problem import Problem
from bayes_sensor.posterior import Posterior
from bayes_sensor.residuals import TAKE_AS_THEY_ARE

LAGS = (1, 2, 3, 5, 10, 20, 50, 100)
N_VARIANCE_BINS = 8
N_BANDS = 12
N_PIT_BINS = 20
N_PIT_DRAWS = 6
ALPHA = 0.01
CHECK_WORDS = {
    "autocorrelation": "autocorrelation",
    "variance": "spread against concentration",
    "spectrum": "spectrum",
    "pit_uniform": "spread of the forecasts of the next sample",
    "pit_independent": "independence of the forecasts of the next sample",
}


@dataclass(frozen=True, eq=False)
class StatisticComparison:
    """One vector-valued statistic of the data against its replicates."""

    name: str
    x_name: str
    x_unit: str
    x: FloatArray
    """(n,) lag, concentration or frequency"""
    observed: FloatArray
    """(n,) mean over draws of the statistic of the data"""
    low: FloatArray
    """(n,) 2.5 % of the replicates"""
    middle: FloatArray
    """(n,) their mean"""
    high: FloatArray
    """(n,) 97.5 %"""
    z: FloatArray
    """(n,) mean of observed minus replicated at the same draw, in its own sd"""
    p_values: FloatArray
    """(n,) two-sided, from z: these statistics are means over many samples"""
    p_value: float
    """of the whole vector: the smallest, times n"""

    def to_json(self) -> dict[str, Any]:
        """Plain numbers, for reports and figures."""
        arrays = ("x", "observed", "low", "middle", "high", "z", "p_values")
        return {
            "x_name": self.x_name,
            "x_unit": self.x_unit,
            **{name: [float(v) for v in getattr(self, name)] for name in arrays},
            "p_value": self.p_value,
        }


@dataclass(frozen=True, eq=False)
class Pit:
    """One-step-ahead probability integral transform of every used sample."""

    counts: np.ndarray
    """(n_bins,) of equal width on [0, 1]"""
    n: int
    ecdf_difference: FloatArray
    """(n_grid,) ECDF minus the diagonal at ``grid``"""
    grid: FloatArray
    ks: float
    """largest distance of the ECDF from the diagonal"""
    p_uniform: float
    """Kolmogorov and Smirnov's"""
    lag_one: float
    """correlation of neighbouring Phi^-1(u)"""
    p_independent: float
    mean_z: float
    sd_z: float
    """of Phi^-1(u): above 1 where forecasts are too narrow"""

    def to_json(self) -> dict[str, Any]:
        """Plain numbers, for reports and figures."""
        return {
            "counts": [int(c) for c in self.counts],
            "n": self.n,
            "grid": [float(v) for v in self.grid],
            "ecdf_difference": [float(v) for v in self.ecdf_difference],
            "ks": self.ks,
            "p_uniform": self.p_uniform,
            "lag_one": self.lag_one,
            "p_independent": self.p_independent,
            "mean_z": self.mean_z,
            "sd_z": self.sd_z,
        }


@dataclass(frozen=True, eq=False)
class PredictiveCheck:
    """Results of the comparison for the noise law and the mean."""

    _repr_html_ = record_card

    autocorrelation: StatisticComparison
    variance: StatisticComparison
    spectrum: StatisticComparison
    pit: Pit
    n_draws: int
    seed: int

    def __repr__(self) -> str:
        """The status."""
        return f"PredictiveCheck({self.status})"

    @cached_property
    def p_values(self) -> dict[str, float]:
        """One p-value a check, each for its whole vector."""
        return {
            "autocorrelation": self.autocorrelation.p_value,
            "variance": self.variance.p_value,
            "spectrum": self.spectrum.p_value,
            "pit_uniform": self.pit.p_uniform,
            "pit_independent": self.pit.p_independent,
        }

    @property
    def failed(self) -> list[str]:
        """Checks whose p-value is below 1 % after allowing for their number (Holm)."""
        order = sorted(self.p_values, key=lambda name: self.p_values[name])
        failed = []
        for i, name in enumerate(order):
            if self.p_values[name] * (len(order) - i) >= ALPHA:
                break
            failed.append(name)
        return failed

    @property
    def status(self) -> str:
        """One sentence."""
        if not self.failed:
            least = min(self.p_values, key=lambda name: self.p_values[name])
            return (
                "Replicated data look like the data in every check "
                f"(smallest p-value {self.p_values[least]:.2g}, {CHECK_WORDS[least]})."
            )
        found = ", ".join(
            f"{CHECK_WORDS[name]} (p {_p_words(self.p_values[name])})" for name in self.failed
        )
        return f"Replicated data do not look like the data: {found}."

    def to_json(self) -> dict[str, Any]:
        """Plain numbers, for reports and figures."""
        return {
            "status": self.status,
            "failed": self.failed,
            "p_values": self.p_values,
            "n_draws": self.n_draws,
            "seed": self.seed,
            "autocorrelation": self.autocorrelation.to_json(),
            "variance": self.variance.to_json(),
            "spectrum": self.spectrum.to_json(),
            "pit": self.pit.to_json(),
        }


def checked(posterior: Posterior, check: PredictiveCheck) -> Posterior:
    """The posterior with the failures of ``check`` added to its doubts."""
    if not check.failed:
        return posterior
    doubt = f"{check.status} Intervals that rest on the noise law are then not to be trusted."
    if not posterior.doubts:  # else it is said already
        doubt = f"{doubt} {TAKE_AS_THEY_ARE}"
    return replace(posterior, doubts=(*posterior.doubts, doubt))


def _p_words(p: float) -> str:
    return "below 0.001" if p < 1e-3 else f"{p:.1g}"


class ResidualStatistics:
    """The three statistics of standardised residuals z, all experiments pooled."""

    def __init__(self, problem: Problem, theta: FloatArray) -> None:
        campaign = problem.campaign
        self.used = [e.used for e in campaign]
        shortest = min(e.n_samples for e in campaign)
        paired = [k for k in LAGS if any((u[k:] & u[:-k]).any() for u in self.used)]
        self.lags = np.array([lag for lag in paired if lag <= max(paired[:1] + [shortest // 10])])
        self._concentration_bins(problem, theta)
        self._bands(problem)

    def _concentration_bins(self, problem: Problem, theta: FloatArray) -> None:
        # equal ranges of concentration, so that plateaus do not crowd out the transients
        levels = []
        for e in problem.campaign:
            # every eighth sample is enough to sort the samples by concentration
            x = problem.model.response(e.t[::8], theta, problem.layout, e)
            x = np.interp(e.t, e.t[::8], x)
            levels.append(e.concentration * np.clip(x, 0.0, 1.0))
        top = max(float(level.max()) for level in levels)
        edges = np.linspace(0.0, top * (1 + 1e-9), N_VARIANCE_BINS + 1)
        where = [np.digitize(level, edges) - 1 for level in levels]
        counts = sum(np.bincount(w[u], minlength=N_VARIANCE_BINS) for w, u in zip(where, self.used))
        # short records: the fullest
        keep = np.flatnonzero(np.asarray(counts) >= min(100, np.max(counts)))
        number = np.full(N_VARIANCE_BINS, len(keep))
        number[keep] = np.arange(len(keep))
        self.bins = [np.where(u, number[w], len(keep)) for w, u in zip(where, self.used)]
        self.bin_counts = np.asarray(counts)[keep]
        sums = sum(np.bincount(b, level, len(keep) + 1)[:-1] for b, level in zip(self.bins, levels))
        self.concentration = np.asarray(sums) / self.bin_counts

    def _bands(self, problem: Problem) -> None:
        campaign = problem.campaign
        lowest = max(1.0 / (len(e.t) * e.interval) for e in campaign)
        highest = max(0.5 / e.interval for e in campaign)
        edges = np.geomspace(0.999 * lowest, 1.001 * highest, N_BANDS + 1)
        self.band = []
        counts, sums = np.zeros(N_BANDS), np.zeros(N_BANDS)
        for e in campaign:
            f = np.fft.rfftfreq(len(e.t), e.interval)
            number = np.clip(np.digitize(f, edges) - 1, 0, N_BANDS - 1)
            number[f < edges[0]] = N_BANDS  # the zero frequency and below every band
            self.band.append(number)
            counts += np.bincount(number, minlength=N_BANDS + 1)[:-1]
            sums += np.bincount(number, np.log(np.maximum(f, 1e-300)), N_BANDS + 1)[:-1]
        self.filled = counts > 0
        self.band_counts = counts[self.filled]
        self.frequency = np.exp(sums[self.filled] / self.band_counts)

    def __call__(self, z: list[FloatArray], s: list[FloatArray]) -> list[FloatArray]:
        """Autocorrelation by lag, variance (V^2) by concentration, spectrum by band."""
        products = np.zeros(len(self.lags))
        n_pairs = np.zeros(len(self.lags))
        square, n = 0.0, 0
        variance = np.zeros(len(self.concentration))
        power = np.zeros(N_BANDS)
        for zk, sk, u, where, band in zip(z, s, self.used, self.bins, self.band):
            masked = not u.all()
            zk = np.where(u, zk, 0.0) if masked else zk
            square += float(zk @ zk)
            n_used = int(u.sum())
            n += n_used
            for j, lag in enumerate(self.lags):
                products[j] += zk[lag:] @ zk[:-lag]
                n_pairs[j] += (u[lag:] & u[:-lag]).sum() if masked else len(u) - lag
            variance += np.bincount(where, (sk * zk) ** 2, len(variance) + 1)[:-1]
            transformed = np.fft.rfft(zk)
            density = (transformed.real**2 + transformed.imag**2) / n_used
            power += np.bincount(band, density, N_BANDS + 1)[:-1]
        return [
            products / n_pairs / (square / n),
            variance / self.bin_counts,
            power[self.filled] / self.band_counts,
        ]


def check_predictive(posterior: Posterior, n_draws: int = 30, seed: int = 1) -> PredictiveCheck:
    """Compare the data with data replicated from ``n_draws`` draws of the posterior.

    Residuals are standardised by the model's own mean and variance at each draw; replicates have
    the draw's AR(1) noise on the same samples, gaps included.  About 3 s for 840 000 samples.

    Raises CampaignError for fewer than two draws, which have no spread.
    """
    if n_draws < 2:
        raise CampaignError(f"n_draws: expected 2 or more draws to compare with, got {n_draws}")
    problem = posterior.problem
    draws = posterior.draws
    some = draws[np.linspace(0, len(draws) - 1, min(n_draws, len(draws))).round().astype(int)]
    statistics = ResidualStatistics(problem, draws.mean(axis=0))
    streams = np.random.SeedSequence(seed).spawn(len(some))
    observed, replicated = [], []
    pit = [np.zeros(e.n_samples) for e in problem.campaign]
    averaged = set(np.linspace(0, len(some) - 1, min(N_PIT_DRAWS, len(some))).round().astype(int))
    for i, (theta, stream) in enumerate(zip(some, streams)):
        rng = np.random.default_rng(stream)
        z, z_rep, s = [], [], []
        for k, e in enumerate(problem.campaign):
            mean, s2 = mean_and_variance(problem, theta, k)
            s.append(np.sqrt(s2))
            z.append((e.values - mean) / s[k])
            phi = _phi(problem, theta, k)
            z_rep.append(simulate_noise(np.ones(len(e.t)), phi, rng))
            if i in averaged:
                pit[k] += _one_step_ahead(z[k], e, phi)
        observed.append(statistics(z, s))
        replicated.append(statistics(z_rep, s))
    axes = (
        ("autocorrelation", "lag", "samples", statistics.lags.astype(float)),
        ("variance", "concentration", "1", statistics.concentration),
        ("spectrum", "frequency", "Hz", statistics.frequency),
    )
    records = [
        compare_statistic(
            *axis, np.array([o[j] for o in observed]), np.array([r[j] for r in replicated])
        )
        for j, axis in enumerate(axes)
    ]
    return PredictiveCheck(
        autocorrelation=records[0],
        variance=records[1],
        spectrum=records[2],
        pit=make_pit([u / len(averaged) for u in pit], problem),
        n_draws=len(some),
        seed=seed,
    )


def _phi(problem: Problem, theta: FloatArray, k: int) -> float:
    e = problem.campaign.experiments[k]
    return lag_coefficient(float(theta[problem.layout.noise[k, 0]]), problem.steps(e))


def _one_step_ahead(z: FloatArray, e: Experiment, phi: float) -> FloatArray:
    """(n_samples,) P(z_i' < z_i | before i) of one experiment's used samples."""
    from scipy.special import ndtr

    index = np.flatnonzero(e.used)
    values = z[index]
    step = np.full(len(index), phi)
    gap = np.flatnonzero(np.diff(index) > 1) + 1
    step[gap] = phi ** (index[gap] - index[gap - 1])
    step[0] = 0.0
    innovation = values.copy()
    innovation[1:] -= step[1:] * values[:-1]
    share: FloatArray = ndtr(innovation / np.sqrt(1.0 - step**2))
    return share


def compare_statistic(
    name: str, x_name: str, x_unit: str, x: FloatArray, observed: FloatArray, replicated: FloatArray
) -> StatisticComparison:
    """A statistic of the data (n_draws, n_x) beside that of as many replicates, point by point."""
    from scipy.special import stdtr

    difference = observed - replicated
    n = len(difference)
    z = difference.mean(axis=0) / np.maximum(difference.std(axis=0, ddof=1), 1e-300)
    # the data are one realisation: z compares it with the spread of replicates, which is itself
    # estimated from n draws (hence Student's t with the predictive factor)
    p_values = 2.0 * stdtr(n - 1, -np.abs(z) / np.sqrt(1.0 + 1.0 / n))
    low, high = np.quantile(replicated, [0.025, 0.975], axis=0)
    return StatisticComparison(
        name, x_name, x_unit, x, observed.mean(axis=0), low, replicated.mean(axis=0), high, z,
        p_values, float(min(1.0, len(p_values) * p_values.min())),
    )  # fmt: skip


def make_pit(parts: list[FloatArray], problem: Problem) -> Pit:
    """Whether probability integral transforms, one array an experiment, are uniform and apart."""
    from scipy import stats
    from scipy.special import ndtri

    u = np.concatenate(parts)
    n = len(u)
    ordered = np.sort(u)
    i = np.arange(1, n + 1)
    ks = float(max((i / n - ordered).max(), (ordered - (i - 1) / n).max()))
    grid = np.linspace(0.0, 1.0, 101)[1:-1]
    products, n_pairs = 0.0, 0
    values = []
    for part, e in zip(parts, problem.campaign):
        z = ndtri(np.clip(part, 1e-16, 1 - 1e-16))
        values.append(z)
        index = np.flatnonzero(e.used)
        neighbours = np.diff(index) == 1
        products += float((z[1:] * z[:-1])[neighbours].sum())
        n_pairs += int(neighbours.sum())
    z = np.concatenate(values)
    lag_one = products / n_pairs / float(np.mean(z**2))
    return Pit(
        counts=np.histogram(u, N_PIT_BINS, (0.0, 1.0))[0],
        n=n,
        ecdf_difference=np.searchsorted(ordered, grid, side="right") / n - grid,
        grid=grid,
        ks=ks,
        p_uniform=float(stats.kstwobign.sf(ks * np.sqrt(n))),
        lag_one=lag_one,
        p_independent=float(2.0 * stats.norm.sf(abs(lag_one) * np.sqrt(n_pairs))),
        mean_z=float(z.mean()),
        sd_z=float(z.std()),
    )
