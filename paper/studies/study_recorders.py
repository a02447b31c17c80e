"""Real records of other rigs: the lag found, its interval, and an independent fit's value.

The files are not part of this repository.  The folder that holds ``recorders/`` is read from the
environment variable ``BAYES_SENSOR_REAL``; where that is not set, the committed table stays as it
is.  Campaigns are written into a temporary folder.  The independent fit is scipy's least squares of
``y0 + beta (1 - exp(-(t - t0) / tau))`` to the same samples, read with pandas.
"""

from __future__ import annotations

import os
import shutil
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
import pandas as pd
from drawing import TABLES
from real_files import write_table

from bayes_sensor.bounds import compare_bounds
from bayes_sensor.campaign import CampaignError, FloatArray
from bayes_sensor.diagnosis import diagnose_gap
from bayes_sensor.fit import fit_least_squares
from bayes_sensor.io.readers import read_campaign
from bayes_sensor.posterior import Settings, sample_posterior

WHERE = "BAYES_SENSOR_REAL"
SEED = 7
SETTINGS = Settings(n_chains=2, n_walkers=40, max_steps=2000)


@dataclass(frozen=True)
class Record:
    """One step of one file, and how to read it without the package."""

    name: str
    file: str
    sensors: Mapping[str, Any]
    """sensor to column, as pandas names it"""
    unit: str
    on: float
    """s of the record's own clock, shortly before the step"""
    keep: tuple[float, float]
    """s"""
    times: Callable[[pd.DataFrame], FloatArray]
    header: int | None = 0
    keys: str = ""
    """further lines of the experiment"""
    source: str = ""

    @property
    def toml(self) -> str:
        """The campaign: a sensor alone, or several on one gas."""
        columns = {
            sensor: column if isinstance(column, str) else f"column {column + 1}"
            for sensor, column in self.sensors.items()
        }
        if len(columns) == 1:
            signal = f'signal = "{next(iter(columns.values()))}"'
        else:
            each = ", ".join(f'{sensor} = "{column}"' for sensor, column in columns.items())
            signal = f"signals = {{{each}}}"
        low, high = self.keep
        return (
            f'title = "{self.name}"\n[rig]\nstages = ["sensor"]\n\n[[experiment]]\nname = "1"\n'
            f'file = "{self.file}"\n{signal}\nsignal_unit = "{self.unit}"\n'
            f'commanded_on = "{self.on} s"\nkeep = ["{low} s", "{high} s"]\n{self.keys}'
        )

    def samples(self, folder: Path, sensor: str) -> tuple[FloatArray, FloatArray]:
        """Times (n_t,) s from the file's first sample and values (n_t,), by pandas alone."""
        frame = pd.read_csv(folder / self.file, header=self.header, skipinitialspace=True)
        t, y = self.times(frame), frame[self.sensors[sensor]].to_numpy(dtype=float)
        used = np.isfinite(y) & (t >= self.keep[0]) & (t <= self.keep[1])
        return t[used], y[used]


def _dates(frame: pd.DataFrame) -> FloatArray:
    dates = pd.to_datetime(frame.iloc[:, 0])
    return (dates - dates[0]).dt.total_seconds().to_numpy()


RECORDS = (
    Record("oxygen optodes RBR", "oxygen_optodes.csv",
           {"first": "rbr210619_O2SAT", "second": "rbr210624_O2SAT"}, "percent", 700.0,
           (600.0, 1360.0), lambda f: (f["UNIXTIME"] - f["UNIXTIME"][0]).to_numpy() / 1e3,
           keys='time = "UNIXTIME"\n', source="ellenrpark/optode_response"),
    Record("oxygen optodes AA", "oxygen_optodes.csv",
           {"AA3412": "AA3412_O2SAT", "AA3827": "AA3827_O2SAT", "AA3413": "AA3413_O2SAT",
            "AA3312": "AA3312_O2SAT"}, "percent", 700.0,
           (600.0, 1360.0), lambda f: (f["UNIXTIME"] - f["UNIXTIME"][0]).to_numpy() / 1e3,
           keys='time = "UNIXTIME"\n', source="ellenrpark/optode_response"),
    Record("CO2 monitors", "co2_monitors.csv",
           {"scd30": "scd30", "s8lp": "s8lp", "sen0220": "sen0220"}, "ppm", 2910.0,
           (1800.0, 4400.0), _dates, source="lata-mas/Monitor_co2_pistas_educativas"),
    Record("cold finger", "dewar_warm_up.csv", {"finger": 3}, "degC", 1.0, (0.0, 1200.0),
           lambda f: (f[2] - f[2][0]).to_numpy(), header=None, keys='time = "column 3"\n',
           source="aceisScope/pidtunning"),
)  # fmt: skip


def alone() -> list[Record]:
    """Every sensor of a record with several by itself, with a switch time of its own."""
    return [
        replace(record, sensors={sensor: column})
        for record in RECORDS
        if len(record.sensors) > 1
        for sensor, column in record.sensors.items()
    ]


def independent(
    samples: list[tuple[FloatArray, FloatArray]], on: float
) -> tuple[FloatArray, FloatArray]:
    """tau (n,) of sensors with one t0, and the rms (n,) of what is left, by scipy.

    The sensors are weighed with the rms that each leaves alone.
    """
    from scipy.optimize import least_squares

    def rest(values: FloatArray, chosen: list[int], weights: FloatArray) -> FloatArray:
        parts = []
        for j, k in enumerate(chosen):
            t, y = samples[k]
            y0, beta, tau = values[1 + 3 * j : 4 + 3 * j]
            at = np.maximum(t - values[0], 0.0)
            parts.append((y - y0 + beta * np.expm1(-at / tau)) * weights[k])
        return np.concatenate(parts)

    def start(k: int) -> list[float]:
        t, y = samples[k]
        return [y[t <= max(on, t[2])].mean(), y[-10:].mean() - y[0], 0.1 * (t[-1] - on)]

    n, none = len(samples), np.ones(len(samples))
    alone = [
        least_squares(rest, [on, *start(k)], x_scale="jac", args=([k], none)) for k in range(n)
    ]
    rms = np.array([np.sqrt(np.mean(each.fun**2)) for each in alone])
    if n == 1:
        return alone[0].x[3:], rms
    first = [np.mean([each.x[0] for each in alone])]
    first += [value for each in alone for value in each.x[1:]]
    best = least_squares(rest, first, x_scale="jac", args=(list(range(n)), 1.0 / rms))
    return best.x[3::3], rms


def found(record: Record, folder: Path) -> list[dict[str, Any]]:
    """One row a sensor."""
    with TemporaryDirectory() as place:
        shutil.copy(folder / record.file, place)
        path = Path(place) / "campaign.toml"
        path.write_text(record.toml, encoding="utf-8")
        campaign = read_campaign(path)
    fit = fit_least_squares(campaign, seed=SEED)
    try:
        posterior = sample_posterior(campaign, fit, SEED, settings=SETTINGS)
        said, intervals = f"{posterior.sampler}, {posterior.convergence}", posterior.rows
    except CampaignError as error:
        said, intervals = str(error), {}
    try:
        gap = diagnose_gap(campaign, fit, seed=SEED, bootstrap=0, hidden=False, separate=False)
        wide = gap.tau_with_discrepancy_s or {}
    except CampaignError:
        wide = {}
    bound = compare_bounds(campaign, fit, methods=["sandwich"])["sandwich"]
    several = len(record.sensors) > 1
    samples = [record.samples(folder, sensor) for sensor in record.sensors]
    taus, rms = independent(samples, record.on)
    rows = []
    for k, sensor in enumerate(record.sensors):
        ending = f"[{sensor}]" if several else ""
        row = intervals.get(f"tau_s{ending}", {})
        beside = bound.interval(f"tau_s{ending}")
        low, high = row.get("q2.5", np.nan), row.get("q97.5", np.nan)
        of_first = wide if k == 0 else {}  # the diagnosis speaks of the first sensor's lag
        wide_low, wide_high = of_first.get("q2.5", np.nan), of_first.get("q97.5", np.nan)
        rows.append({
            "record": record.name, "sensor": sensor,
            "switch_times": "shared" if several else "own", "n_samples": len(samples[k][0]),
            "scipy_tau_s": taus[k], "fit_tau_s": fit.parameters[f"tau_s{ending}"], "lo95_s": low,
            "q50_s": row.get("q50", np.nan), "hi95_s": high,
            "holds_scipy": int(low <= taus[k] <= high),
            "sigma0": intervals.get(f"sigma0_V{ending}", {}).get("q50", np.nan),
            "phi": intervals.get(f"phi{ending}", {}).get("q50", np.nan), "rms": rms[k],
            "sandwich_lo95_s": beside[0], "sandwich_hi95_s": beside[1],
            "sandwich_holds_scipy": int(beside[0] <= taus[k] <= beside[1]),
            "discrepancy_lo95_s": wide_low, "discrepancy_hi95_s": wide_high,
            "discrepancy_holds_scipy": int(wide_low <= taus[k] <= wide_high),
            "unit": record.unit, "misfit": fit.to_json()["misfit"], "said": said,
            "source": record.source,
        })  # fmt: skip
    return rows


def run(
    folder: Path, jobs: int, scheduler: str | None, progress: Callable[[int, int], None]
) -> None:
    """Write recorders.csv and real_files.csv, where the records are at hand."""
    place = os.environ.get(WHERE)
    if not place:
        print(f"{WHERE} is not set: recorders.csv and real_files.csv stay", flush=True)
        return
    rows = []
    whole = [*RECORDS, *alone()]
    for k, record in enumerate(whole):
        rows += found(record, Path(place) / "recorders")
        progress(k + 1, len(whole))
        table = pd.DataFrame(rows)
    table.to_csv(TABLES / "recorders.csv", index=False, float_format="%.4g")
    known: dict[str, str] = {}
    for record in RECORDS:
        known.setdefault(record.file, record.toml)
    write_table(Path(place), known)
