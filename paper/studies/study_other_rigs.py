"""Whether 95 % intervals hold the truth on rigs and programmes that are not the paper's.

Small campaigns of 1 to 2 records of 2400 samples; lags, levels, delays and noise are drawn anew for
each, wide enough apart that the lags can be told.  The analysis is the user's: default priors, a
fit from nothing, the posterior started there.  Samples of one design form one part of the study.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pandas as pd
from drawing import TABLES

from bayes_sensor.bounds import compare_bounds
from bayes_sensor.campaign import Campaign, CampaignError, Commands, Experiment, FloatArray
from bayes_sensor.checks.counted_coverage import coverage_row
from bayes_sensor.checks.study_chunks import run_chunks, seed_of, study_key
from bayes_sensor.fit import fit_least_squares
from bayes_sensor.likelihood.density import simulate
from bayes_sensor.likelihood.problem import Problem
from bayes_sensor.posterior import FASTEST, Settings, sample_posterior

N, SEED = 200, 59
INTERVAL, DURATION, ON, OFF = 0.05, 120.0, 20.0, 70.0  # s
SHORT = 25.0
"""s, end of a pulse that is shorter than most of its lags"""
SETTINGS = Settings(n_chains=2, target_ess=500.0, max_draws=3200, max_steps=600)
BOUNDS = ("crlb_ar1", "sandwich")
METHODS = ("posterior", *BOUNDS)


class Part(NamedTuple):
    """A design, and the law of its lags and volumes: each a lower and an upper limit."""

    campaign: Campaign
    laws: Mapping[str, tuple[float, float]]
    """s or mL, drawn log-uniformly; a name of theta"""
    times: Mapping[str, str] = {}
    """values above that are factors of another: by name, what they are to be multiplied with"""


def record(
    name: str, flow: float | None = None, off: float | None = OFF, commands: Commands | None = None,
    sensor: str = "",
) -> Experiment:  # fmt: skip
    """A planned record; ``flow`` mL/s."""
    t = np.arange(round(DURATION / INTERVAL)) * INTERVAL
    carrier, gas = (None, None) if flow is None else (0.9 * flow, 0.1 * flow)
    pulse = (ON, off) if commands is None else (None, None)
    full = f"{name},{sensor}" if sensor else name
    return Experiment(full, t, None, carrier, gas, INTERVAL, *pulse, commands=commands,
                      record=name if sensor else "", sensor=sensor)  # fmt: skip


def parts() -> dict[str, Part]:
    """The designs by name."""
    stairs = Commands(np.array([15.0, 40.0, 65.0, 90.0]), np.array([0.25, 0.6, 1.0, 0.0]))
    times = np.sort(np.concatenate([np.arange(8.0, 110.0, 12.0), np.arange(13.0, 115.0, 12.0)]))
    train = Commands(times, (np.arange(len(times)) % 2 == 0).astype(float), delays="shared")
    filter_of = {"tau_filter_s": "tau_s"}
    return {
        "sensor": Part(
            Campaign("sensor", (record("1", off=None), record("2")), stages=("sensor",)),
            {"tau_s": (2.0, 10.0)},
        ),
        "short pulse": Part(  # the signal still moves when the pulse ends
            Campaign("short pulse", (record("1", off=SHORT),), stages=("sensor",)),
            {"tau_s": (4.0, 40.0)},
        ),
        "short pulse of a chain": Part(  # it is farthest when the pulse is long over
            Campaign("short pulse of a chain",
                     tuple(record(str(q), q, off=SHORT) for q in (50.0, 150.0)),
                     sensor_is="faster"),
            {"tau_s": (4.0, 10.0), "tau_v_s": (1.2, 2.5), "V_mL": (75.0, 200.0)},
            {"tau_v_s": "tau_s", "V_mL": "tau_s"},
        ),
        "filter and sensor": Part(
            Campaign("filter and sensor", (record("1"), record("2")), sensor_is="slower",
                     stages=("filter", "sensor")),
            {"tau_s": (2.0, 10.0), "tau_filter_s": (0.15, 0.6)}, filter_of,
        ),
        "cell and sensor": Part(
            Campaign("cell and sensor", (record("1", 50.0), record("2", 100.0)),
                     stages=("cell", "sensor")),
            {"tau_s": (2.0, 8.0), "V_cell_mL": (50.0, 250.0)},
        ),
        "staircase": Part(
            Campaign("staircase", (record("1", commands=stairs),), stages=("sensor",)),
            {"tau_s": (1.0, 6.0)},
        ),
        "pulse train": Part(
            Campaign("pulse train", (record("1", commands=train),), sensor_is="slower",
                     stages=("filter", "sensor")),
            {"tau_s": (1.0, 2.5), "tau_filter_s": (0.15, 0.5)}, filter_of,
        ),
        "two sensors": Part(
            Campaign("two sensors", tuple(record("1", sensor=s) for s in "AB"),
                     stages=("valve", "sensor")),
            {"tau_s[A]": (1.0, 3.0), "tau_s[B]": (4.0, 12.0), "tau_v_s": (0.2, 0.6)},
            {"tau_v_s": "tau_s[A]"},
        ),
    }  # fmt: skip


def draw_truth(part: Part, rng: np.random.Generator) -> FloatArray:
    """(n_theta,) lags and volumes by their laws; levels, delays of 0.5 to 1.5 s and noise."""
    layout = Problem(part.campaign).layout
    values = {name: np.exp(rng.uniform(*np.log(limits))) for name, limits in part.laws.items()}
    values |= {name: values[name] * values[of] for name, of in part.times.items()}
    step = rng.uniform(0.5, 2.0)
    drawn = {"y0_V": 0.3, "beta_V": step, "phi": rng.uniform(0.0, 0.8),
             "sigma0_V": step * np.exp(rng.uniform(*np.log([0.005, 0.02]))),
             "sigma1_V": step * rng.uniform(0.0, 0.02)}  # fmt: skip
    shared_delay = {"delay_on_s": rng.uniform(0.5, 1.5), "delay_off_s": rng.uniform(0.5, 1.5)}
    theta = np.array(
        [
            values.get(name, {**drawn, **shared_delay}.get(name.split("[")[0], np.nan))
            for name in layout.names
        ]
    )
    for k, e in enumerate(part.campaign):
        own = layout.switches(k)
        if np.isnan(theta[own]).any():
            at = e.commands.times if e.commands else [e.commanded_on, e.commanded_off]
            theta[own] = np.array(at[: len(own)], dtype=float) + rng.uniform(0.5, 1.5, len(own))
    return theta


@dataclass(frozen=True, eq=False)
class OfPart:
    """The task: campaign number i of one design, fitted and sampled as a user would."""

    name: str
    seed: int = SEED

    @property
    def part(self) -> Part:
        """The design."""
        return parts()[self.name]

    @property
    def names(self) -> tuple[str, ...]:
        """What is counted: lags, volumes and phi."""
        layout = Problem(self.part.campaign).layout
        return (*layout.shared_names, *(n for n in layout.noise_names if n.startswith("phi")))

    @property
    def key(self) -> str:
        """Everything that the numbers depend on."""
        part = self.part
        laws = sorted(part.laws.items()), sorted(part.times.items())
        return study_key("other rigs", Problem(part.campaign), part.campaign.stages, self.name,
                         laws, SETTINGS, BOUNDS, self.seed)  # fmt: skip

    def __call__(self, i: int) -> dict[str, Any]:
        """Truth and limits by name; ``failed`` where no interval was given."""
        of_truth, of_data, of_draws = np.random.SeedSequence([self.seed, i]).spawn(3)
        part, names = self.part, self.names
        theta = draw_truth(part, np.random.default_rng(of_truth))
        layout = Problem(part.campaign).layout
        found: dict[str, Any] = {
            "truth": theta[[layout.index(n) for n in names]],
            "limits": np.full((len(METHODS), len(names), 2), np.nan),
            "failed": 1.0, "converged": 0.0, "r_hat": np.nan, "ess": np.nan, "fast": 0.0,
        }  # fmt: skip
        campaign = simulate(part.campaign, theta, seed=seed_of(of_data))
        try:
            fit = fit_least_squares(campaign, seed=seed_of(of_draws))
            posterior = sample_posterior(campaign, fit, seed_of(of_draws), FASTEST, SETTINGS)
            bounds = compare_bounds(campaign, fit, posterior, BOUNDS)
        except (CampaignError, np.linalg.LinAlgError):
            return found
        for j, name in enumerate(names):
            row = posterior.rows[name]
            high = np.inf if name in posterior.no_upper_limit else row["q97.5"]
            found["limits"][0, j] = row["q2.5"], high
            for m, method in enumerate(BOUNDS, start=1):
                if name in bounds[method].names:
                    found["limits"][m, j] = bounds[method].interval(name)
        return found | {
            "failed": 0.0,
            "converged": float(posterior.converged),
            "r_hat": float(np.nanmax(posterior.r_hat)),
            "ess": float(np.nanmin(posterior.ess_bulk)),
            "fast": float(posterior.sampler == FASTEST),
        }


def rows(task: OfPart, results: Mapping[str, np.ndarray]) -> pd.DataFrame:
    """One row a method and parameter: share of intervals that hold the truth, with its spread."""
    found = []
    failed = results["failed"] > 0
    unfinished = ~failed & (results["converged"] == 0)
    for m, method in enumerate(METHODS):
        for j, name in enumerate(task.names):
            low, high = results["limits"][:, m, j].T
            given, truth = ~np.isnan(low), results["truth"][:, j]
            if not given.any():  # the method has no interval of this parameter
                continue
            inside = (low <= truth) & (truth <= high)
            counted = coverage_row(inside[given], 0.95)
            share = counted["coverage"]
            found.append({
                "rig": task.name, "method": method, "parameter": name, "campaigns": len(truth),
                "failed": int(failed.sum()), "not_converged": int(unfinished.sum()),
                "intervals": int(given.sum()), "held": counted["covered"], "share95": share,
                "standard_error": np.sqrt(share * (1.0 - share) / given.sum()),
                "lo95": counted["coverage_lo95"], "hi95": counted["coverage_hi95"],
                "too_high": int((given & (low > truth)).sum()),
                "too_low": int((given & (high < truth)).sum()),
                "median_relative_width": float(np.median(((high - low) / truth)[given])),
            })  # fmt: skip
    return pd.DataFrame(found)


def run(
    folder: Path,
    jobs: int,
    scheduler: str | None,
    progress: Callable[[int, int], None],
    n: int = N,
) -> None:
    """Compute ``n`` campaigns of each design, then write other_rigs.csv."""
    tables, all_parts = [], list(parts())
    for place, name in enumerate(all_parts):
        task = OfPart(name)

        def tell(done: int, _of: int, place: int = place) -> None:
            progress(place * n + done, len(all_parts) * n)

        where = folder / "other_rigs" / name.replace(" ", "_")
        results = run_chunks(
            task, n, where, task.key, jobs, chunk=5, scheduler=scheduler, progress=tell
        )
        tables.append(rows(task, results))
    pd.concat(tables).to_csv(TABLES / "other_rigs.csv", index=False, float_format="%.4g")
