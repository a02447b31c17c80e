"""How often the intervals of each bound method hold the truth, on simulated campaigns.

Every campaign is simulated under a :class:`CoverageSetting`, fitted, sampled and bounded as a
user's would be, always with the default noise law.  In some settings that law is wrong; the study
counts the coverage that each method then has.  The campaigns are small (three of the published
experiments at 100 Hz for 27 s) and their noise is chosen so that tau^2 lies as many standard errors
from zero as at the published rig.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from bayes_sensor.bounds import LEVELS, METHODS, method_of
from bayes_sensor.bounds.context import Evidence
from bayes_sensor.campaign import Campaign, CampaignError, Experiment, FloatArray
from bayes_sensor.checks.counted_coverage import binomial_interval
from bayes_sensor.checks.study_chunks import run_chunks, seed_of, study_key
from bayes_sensor.fit import fit_least_squares
from bayes_sensor.likelihood.density import grid_response, response_at_samples
from bayes_sensor.likelihood.noise import scale_squared, simulate_noise
from bayes_sensor.likelihood.problem import Problem
from bayes_sensor.posterior import FASTEST, Settings, sample_posterior
from bayes_sensor.rig.cascade import local_parameters, time_constants
from bayes_sensor.rig.layout import Layout

if TYPE_CHECKING:
    import pandas as pd

TAU, TAU_V, VOLUME = 0.0481, 0.8577, 58.23
"""s, s, mL: the published estimates"""
RUNS = ((4.0, 0.5, 0.296, 1.78), (5.0, 1.0, 0.175, 2.11), (7.5, 1.5, 0.121, 1.85))
"""carrier and test gas (L/min), y0 and beta (V) of the published experiments 1, 6 and 7"""
START_DELAY, END_DELAY = (0.1340, 0.1125e3), (0.0161, 0.0745e3)
"""s and mL: the published delay lines"""
INTERVAL, DURATION, ON, OFF = 0.01, 27.0, 3.0, 15.0
"""s; between the switches the response settles to 2e-5 of its step"""


@dataclass(frozen=True)
class CoverageSetting:
    """One way to simulate the data."""

    words: str
    phi: float
    """AR(1) coefficient of the autocorrelated part of the noise, at the sampling interval"""
    sigma0: float
    """V"""
    sigma1: float
    """V, extra noise at the highest concentration"""
    white: float = 0.0
    """share of the noise's variance that is white; with phi > 0 the sum is an ARMA(1, 1)"""
    closing: float = 1.0
    """tau_v after the valve was shut, over that after it was opened"""


SETTINGS: dict[str, CoverageSetting] = {
    "iid": CoverageSetting("iid noise of one size", 0.0, 0.014, 0.0),
    "ar1_0.5": CoverageSetting(
        "AR(1), phi = 0.5, variance grows with concentration", 0.5, 0.010, 0.016
    ),
    "ar1_0.9": CoverageSetting(
        "AR(1), phi = 0.9, variance grows with concentration", 0.9, 0.010, 0.016
    ),
    "arma": CoverageSetting(
        "ARMA(1, 1): half white, half AR(1) with phi = 0.9; variance grows with concentration",
        0.9, 0.010, 0.016, white=0.5,
    ),
    "slow_closing": CoverageSetting(
        "as ar1_0.5, but the valve closes with a time constant 3 % longer, which no method knows",
        0.5, 0.010, 0.016, closing=1.03,
    ),
}  # fmt: skip
"""by the name of ``--setting``; a caller may pass another mapping"""


def small_design() -> tuple[Campaign, FloatArray]:
    """Three published experiments, short and at 100 Hz, without data; and the truth (n_mean,)."""
    experiments, theta = [], [TAU, TAU_V, VOLUME]
    t: FloatArray = INTERVAL * np.arange(round(DURATION / INTERVAL), dtype=float)
    for number, (carrier, test_gas, y0, beta) in enumerate(RUNS, 1):
        e = Experiment(
            str(number), t, None, carrier / 0.06, test_gas / 0.06, INTERVAL, ON, OFF
        )  # fmt: skip
        starts = ON + START_DELAY[0] + START_DELAY[1] / e.total_flow
        ends = OFF + END_DELAY[0] + END_DELAY[1] / e.total_flow
        experiments.append(e)
        theta += [y0, beta, starts, ends]
    return Campaign("three short experiments", tuple(experiments), sensor_is="faster"), np.array(
        theta
    )


def simulate_setting(
    design: Campaign, theta: FloatArray, setting: CoverageSetting, seed: int
) -> Campaign:
    """The design with data drawn under a setting; ``theta`` (n_mean,) holds the mean's truth.

    Rise and fall are exact cascade responses; where the valve closes more slowly the fall has its
    own tau_v, which is exact for an experiment at rest when it is shut.
    """
    problem = Problem(design)
    layout = problem.layout
    values = {}
    streams = np.random.SeedSequence(seed).spawn(len(design))
    for e, stream in zip(design, streams, strict=True):
        k = layout.place_of(e.name)
        y0, beta = theta[layout.local[k, :2]]
        if setting.closing == 1.0:
            x = response_at_samples(problem, theta, k)
        else:
            _, _, t0, tf = local_parameters(theta, layout, e.name)
            tau, tau_v, V = (float(v) for v in theta[:3])
            x = grid_response(e, time_constants(tau, tau_v, V, e.total_flow), t0, None)
            if tf is not None:
                slower = time_constants(tau, setting.closing * tau_v, V, e.total_flow)
                x -= grid_response(e, slower, tf, None)
        law = problem.noise.weight(design, e), problem.noise.fading
        scale = np.sqrt(scale_squared(x, setting.sigma0, setting.sigma1, *law))
        rng = np.random.default_rng(stream)
        noise = simulate_noise(np.sqrt(1.0 - setting.white) * scale, setting.phi, rng)
        if setting.white > 0.0:
            noise += simulate_noise(np.sqrt(setting.white) * scale, 0.0, rng)
        values[e.name] = y0 + beta * x + noise
    return replace(design.with_data(values), warnings=())


@dataclass(frozen=True, eq=False)
class BoundsStudy:
    """The task of the study: campaign number i simulated under one setting and bounded."""

    setting: CoverageSetting
    design: Campaign = field(default_factory=lambda: small_design()[0])
    theta: FloatArray = field(default_factory=lambda: small_design()[1])
    """(n_mean,) the truth, by name"""
    methods: tuple[str, ...] = tuple(METHODS)
    n_resamples: int = 200
    """resamples of the bootstrap; the fewest that give a 95 % interval"""
    sampling: Settings = field(
        default_factory=lambda: Settings(
            n_chains=2, n_draws=800, target_ess=400, max_draws=6000, max_steps=600
        )
    )
    seed: int = 1

    def __post_init__(self) -> None:
        unknown = [name for name in self.methods if name not in METHODS]
        if unknown:
            raise CampaignError(f"no bound method '{unknown[0]}'; there are {', '.join(METHODS)}")
        if self.setting.closing != 1.0 and not Layout.of(self.design).is_published:
            raise CampaignError(
                f"{self.design.title}: a valve that closes more slowly is simulated for valve, "
                "manifold and sensor with one pulse in each record only; choose another setting"
            )

    @cached_property
    def names(self) -> list[str]:
        """Flat names of the mean's parameters, in the order of ``truth``; a lag that cannot be
        assigned is named by its size."""
        problem = Problem(self.design)
        return [*problem.naming().names, *problem.layout.mean_names[problem.layout.n_shared :]]

    @cached_property
    def truth(self) -> FloatArray:
        """``theta`` with its lags by size, as the methods hold them."""
        return Problem(self.design).by_size(self.theta)[: len(self.theta)]

    @property
    def key(self) -> str:
        """Everything that the numbers depend on."""
        return study_key(
            "bounds", Problem(self.design), self.setting, self.theta.tolist(), self.methods,
            self.n_resamples, self.sampling, self.seed,
        )  # fmt: skip

    def __call__(self, i: int) -> dict[str, Any]:
        """``low`` and ``high`` (n_methods, n_mean, 3) at the levels of ``LEVELS``; nan where a
        method gave no interval."""
        data, fitting, sampling = np.random.SeedSequence([self.seed, i]).spawn(3)
        campaign = simulate_setting(self.design, self.theta, self.setting, seed_of(data))
        problem = Problem(campaign)
        shape = (len(self.methods), len(self.names), len(LEVELS))
        found = {"low": np.full(shape, np.nan), "high": np.full(shape, np.nan)}
        # the search starts wide and ends in the same minimum with far fewer particles than usual
        fit = fit_least_squares(
            problem, seed=seed_of(fitting), swarms=1, particles=6, euler=False
        )  # fmt: skip
        posterior = None
        if any(METHODS[name].needs_posterior for name in self.methods):
            try:
                posterior = sample_posterior(
                    problem, fit, seed_of(sampling), FASTEST, self.sampling
                )
            except (CampaignError, np.linalg.LinAlgError):
                posterior = None
            if posterior is not None and not posterior.converged:
                posterior = None
        evidence = Evidence(problem, fit, posterior, self.seed + i, self.n_resamples)
        for j, method in enumerate(self.methods):
            if METHODS[method].needs_posterior and posterior is None:
                continue
            try:
                bound = METHODS[method](evidence)
            except (CampaignError, np.linalg.LinAlgError):  # counted as no interval
                continue
            at = [bound.names.index(name) for name in problem.layout.mean_names]
            found["low"][j], found["high"][j] = bound.low[at], bound.high[at]
        return found


def coverage_of_methods(
    setting: str, study: BoundsStudy, results: Mapping[str, np.ndarray]
) -> pd.DataFrame:
    """One row per method, kind of parameter and level, from the results of a study.

    ``coverage`` is the share of the given intervals that hold the truth, ``failures`` the number of
    missing intervals.  Per-experiment parameters of one kind are pooled.  Intervals of one campaign
    are not independent, so their binomial limits use an effective number, from the variance between
    campaigns.  ``median_width`` is in s, mL or V.
    """
    import pandas as pd

    kinds = [name.split("[")[0] for name in study.names]
    rows = []
    for j, method in enumerate(study.methods):
        for kind in dict.fromkeys(kinds):
            at = [i for i, other in enumerate(kinds) if other == kind]
            if method_of(method).shared_only and "[" in study.names[at[0]]:
                continue  # makes no statement about one experiment
            for level, (suffix, nominal) in enumerate(LEVELS.items()):
                low = results["low"][:, j, at, level]
                high = results["high"][:, j, at, level]
                given = np.isfinite(low) & np.isfinite(high)
                inside = given & (low <= study.truth[at]) & (study.truth[at] <= high)
                n, covered = int(given.sum()), int(inside.sum())
                share = covered / n if n else np.nan
                lo, hi = coverage_limits(inside, given)
                rows.append(
                    {
                        "setting": setting, "method": method, "parameter": kind,
                        "level": suffix, "nominal": nominal, "campaigns": len(given), "n": n,
                        "covered": covered, "coverage": share, "coverage_lo95": lo,
                        "coverage_hi95": hi,
                        "median_width": float(np.median((high - low)[given])) if n else np.nan,
                        "failures": given.size - n,
                    }
                )  # fmt: skip
    return pd.DataFrame(rows)


def coverage_limits(inside: np.ndarray, given: np.ndarray) -> tuple[float, float]:
    """95 % limits of the coverage from booleans (n_campaigns, n_pooled)."""
    n, covered = float(given.sum()), float(inside.sum())
    if n == 0:
        return np.nan, np.nan
    share = covered / n
    if given.shape[1] > 1 and 0.0 < share < 1.0:
        # variance of the pooled share between campaigns over that of independent intervals
        off = (inside - share * given).sum(axis=1)
        inflation = max(float(off @ off) / (n * share * (1.0 - share)), 1.0)
        n, covered = n / inflation, covered / inflation
    return binomial_interval(covered, n)


def chosen_settings(
    names: Sequence[str], settings: Mapping[str, CoverageSetting] = SETTINGS
) -> dict[str, CoverageSetting]:
    """The settings of these names, all where there are none; CampaignError for an unknown one."""
    unknown = [name for name in names if name not in settings]
    if unknown:
        raise CampaignError(
            f"no setting '{unknown[0]}'; expected some of {', '.join(settings)}: choose among them"
        )
    return {name: settings[name] for name in (names or settings)}


def run_coverage(
    folder: str | Path,
    settings: Mapping[str, CoverageSetting],
    n_campaigns: int,
    methods: Sequence[str] | None = None,
    seed: int = 1,
    jobs: int = 1,
    scheduler: str | None = None,
    progress: Callable[[int, int], None] | None = None,
    n_resamples: int | None = None,
) -> pd.DataFrame:
    """The table of :func:`coverage_of_methods` for every setting, ``n_campaigns`` each.

    ``n_resamples`` of the bootstrap; None: the default of the study.

    Finished parts are kept in ``folder``; a later call continues from them (see ``run_chunks``).
    All settings draw from the same streams of random numbers.
    """
    import pandas as pd

    total = n_campaigns * len(settings)
    tables = []
    for number, (name, setting) in enumerate(settings.items()):
        study = BoundsStudy(setting, methods=tuple(methods or METHODS), seed=seed)
        if n_resamples is not None:
            study = replace(study, n_resamples=n_resamples)

        def tell(done: int, n: int, before: int = number * n_campaigns) -> None:
            if progress is not None:
                progress(before + done, total)

        results = run_chunks(
            study, n_campaigns, Path(folder) / name, study.key, jobs, chunk=20,
            scheduler=scheduler, progress=tell,
        )  # fmt: skip
        tables.append(coverage_of_methods(name, study, results))
    return pd.concat(tables, ignore_index=True)
