"""How often a fit that is right is called a misfit, and how often one that is wrong is.

Campaigns of one to five experiments, lags, flows, lengths, sampling and noise drawn broadly, are
fitted with one swarm.  Four noise laws, each with noise under gas as at the baseline or up to three
times more or less; and four faults that the model does not hold.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from drawing import TABLES

from bayes_sensor.blind_check import wilson
from bayes_sensor.campaign import Campaign, Experiment, FloatArray
from bayes_sensor.checks.study_chunks import run_chunks, study_key
from bayes_sensor.fit import fit_least_squares
from bayes_sensor.likelihood.density import grid_response
from bayes_sensor.likelihood.noise import simulate_noise

SEED = 89
N = 400
"""faultless campaigns for each noise law"""
N_FAULTY = 120
"""campaigns for each fault"""
NOISES = ("white", "ar1", "one_second", "one_over_f")
FAULTS = ("staircase", "two_sensors", "resistance", "slow_release")
INTERVALS = (1e-3, 1e-2, 0.1, 1.0)  # s
ROUGHEST, FINEST = 0.05, 0.0005
"""sd of the noise at the baseline, of the step, in faultless campaigns"""
FAULTY = (0.0005, 0.003)
"""and in faulty ones"""
LEAST_BASELINE = 20
"""samples before the command in faulty campaigns; faultless ones may have two"""


def noise(law: str, scale: FloatArray, interval: float, rng: np.random.Generator) -> FloatArray:
    """(n_t,) V: stationary noise of sd ``scale`` (n_t,), sampled every ``interval`` s."""
    if law == "one_over_f":
        # from an eighth of the record's frequency, so that it is slower than the record, too
        n = 1 << int(np.ceil(np.log2(8 * len(scale))))
        frequency = np.arange(1, n // 2 + 1)
        line = rng.standard_normal((2, n // 2)) / np.sqrt(frequency)
        z = np.fft.irfft(np.concatenate([[0.0], line[0] + 1j * line[1]]), n)[: len(scale)]
        return scale * z * n / np.sqrt(4.0 * np.sum(1.0 / frequency))
    phi = {"white": 0.0, "ar1": 0.9, "one_second": float(np.exp(-interval))}[law]
    return simulate_noise(scale, phi, rng)


def draw(law: str, fault: str, rng: np.random.Generator) -> Campaign:
    """A simulated campaign; ``fault`` is one of FAULTS, or empty."""

    def between(low: float, high: float) -> float:
        return float(np.exp(rng.uniform(np.log(low), np.log(max(high, low)))))

    n = int(rng.integers(1, 6))
    if fault == "two_sensors":
        n = max(n, 3)  # of two flows V/Q may stand in for the second sensor
    interval = float(rng.choice(INTERVALS))
    duration = between(max(15.0, (100.0 if fault else 15.0) * interval), 200.0)
    slowest = duration / 25.0
    tau_v, lag_v = (between(duration / 300.0, slowest) for _ in range(2))
    tau = between(0.5 * interval, tau_v)
    if fault:  # the sensor is the slowest, as elsewhere mostly
        tau, tau_v, lag_v = slowest * rng.uniform(0.4, 1.0), 0.3 * tau_v, 0.3 * lag_v
    flow = between(5.0, 200.0)
    fall = fault != "staircase" and (rng.random() < 0.7 or fault in ("slow_release", "resistance"))
    on = between(LEAST_BASELINE * interval if fault else 2.0, 0.25 * duration)
    off = on + rng.uniform(0.35, 0.6) * (duration - on)
    if fault == "slow_release":
        off = on + 0.3 * (duration - on)
    t = np.arange(round(duration / interval)) * interval
    sd = between(*(FAULTY if fault else (FINEST, ROUGHEST)))
    under_gas = between(1.0 / 3.0, 3.0) if rng.random() < 0.5 else 1.0
    experiments = []
    for k in range(n):
        own = flow * between(0.4, 2.5)
        share = between(0.02, 0.5)
        taus = np.array([tau, tau_v, lag_v * flow / own])
        if fault == "two_sensors" and k % 2:
            taus[0] *= 2.75
        e = Experiment(
            str(k + 1), t, np.zeros(len(t)), own * (1.0 - share), own * share, interval, on,
            off if fall else None,
        )  # fmt: skip
        delay = on + rng.uniform(0.0, 0.01) * duration
        x = grid_response(e, taus, delay, None)
        if fault == "staircase":
            rest = duration - delay
            x = sum(grid_response(e, taus, delay + j * rest / 3.0, None) for j in range(3)) / 3.0
        if fall:
            slower = 8.0 if fault == "slow_release" else 1.0
            end = off + rng.uniform(0.0, 0.01) * duration
            x = x - grid_response(e, slower * taus, end, None)
        shown = x if fault != "resistance" else 1.0 / (1.0 + 3.0 * x) / 0.75
        scale = sd * np.sqrt(np.maximum(1.0 + (under_gas**2 - 1.0) * x, 0.0))
        y = rng.uniform(-1.0, 1.0) + shown + noise(law, scale, interval, rng)
        experiments.append(
            Experiment(e.name, t, y, e.carrier_flow, e.test_gas_flow, interval, on, e.commanded_off)
        )
    return Campaign(f"{fault or 'faultless'}, {law}", tuple(experiments))


@dataclass(frozen=True)
class MisfitStudy:
    """The task: campaign number i with a noise law and a fault."""

    law: str
    fault: str = ""

    @property
    def key(self) -> str:
        """Everything that the numbers depend on."""
        return study_key(
            "misfit",
            self.law,
            self.fault,
            SEED,
            INTERVALS,
            ROUGHEST,
            FINEST,
            FAULTY,
            LEAST_BASELINE,
        )

    def __call__(self, i: int) -> dict[str, Any]:
        """``misfit`` (NaN where it is not told), ``warned``, ``interval`` and ``seconds``."""
        # one noise law after the other for a fault
        law = self.law or NOISES[i % len(NOISES)]
        place = (*NOISES, "").index(self.law), (*FAULTS, "").index(self.fault)
        rng = np.random.default_rng([SEED, *place, i])
        campaign = draw(law, self.fault, rng)
        begin = time.perf_counter()
        fit = fit_least_squares(campaign, seed=i + 1, swarms=1, euler=False)
        return {
            "misfit": np.nan if fit.misfit is None else fit.misfit,
            "ratio": fit.rms / fit.noise if fit.noise else np.nan,
            "warned": any("times its noise" in sentence for sentence in fit.caveats),
            "interval": campaign.reference_interval,
            "seconds": time.perf_counter() - begin,
        }


def row(task: MisfitStudy, results: Mapping[str, np.ndarray]) -> dict[str, Any]:
    """A line of the table."""
    warned, misfit = results["warned"].astype(bool), results["misfit"]
    n, k = len(warned), int(warned.sum())
    low, high = wilson(k, n)
    told = np.isfinite(misfit)
    middle = np.quantile(misfit[told], [0.05, 0.5, 0.95]) if told.any() else [np.nan] * 3
    return {
        "fault": task.fault or "none", "noise": task.law or "all", "campaigns": n,
        "told": int(told.sum()), "warned": k, "share": k / n, "low": low, "high": high,
        "misfit_5": middle[0], "misfit_50": middle[1], "misfit_95": middle[2],
    }  # fmt: skip


def run(
    folder: Path, jobs: int, scheduler: str | None, progress: Callable[[int, int], None]
) -> None:
    """Compute, then write misfit.csv."""
    tasks = [MisfitStudy(law) for law in NOISES] + [MisfitStudy("", fault) for fault in FAULTS]
    rows = []
    for number, task in enumerate(tasks):
        results = run_chunks(
            task, N_FAULTY if task.fault else N, folder / f"misfit-{task.fault or task.law}",
            task.key, jobs, chunk=10, scheduler=scheduler,
        )  # fmt: skip
        rows.append(row(task, results))
        progress(number + 1, len(tasks))
    pd.DataFrame(rows).to_csv(TABLES / "misfit.csv", index=False, float_format="%.3g")
