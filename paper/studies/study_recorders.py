"""Real records of other rigs: the lag found, its interval, and an independent fit's value.

The files are not part of this repository.  The folder that holds ``recorders/`` is read from the
environment variable ``BAYES_SENSOR_REAL``; where that is not set, the committed table stays as it
is.  Campaigns are written into a temporary folder.  The independent fit is scipy's ``curve_fit`` of
``y0 + beta (1 - exp(-(t - t0) / tau))`` to the same samples, read with pandas.
"""

from __future__ import annotations

import os
import shutil
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
import pandas as pd
from drawing import TABLES

from bayes_sensor.campaign import CampaignError, FloatArray
from bayes_sensor.fit import fit_least_squares
from bayes_sensor.io.readers import read_campaign
from bayes_sensor.posterior import FASTEST, sample_posterior

WHERE = "BAYES_SENSOR_REAL"
SEED = 7


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
           (600.0, 1000.0), lambda f: (f["UNIXTIME"] - f["UNIXTIME"][0]).to_numpy() / 1e3,
           keys='time = "UNIXTIME"\n', source="ellenrpark/optode_response"),
    Record("oxygen optodes AA", "oxygen_optodes.csv",
           {"AA3412": "AA3412_O2SAT", "AA3827": "AA3827_O2SAT", "AA3413": "AA3413_O2SAT",
            "AA3312": "AA3312_O2SAT"}, "percent", 700.0,
           (600.0, 1000.0), lambda f: (f["UNIXTIME"] - f["UNIXTIME"][0]).to_numpy() / 1e3,
           keys='time = "UNIXTIME"\n', source="ellenrpark/optode_response"),
    Record("CO2 monitors", "co2_monitors.csv",
           {"scd30": "scd30", "s8lp": "s8lp", "sen0220": "sen0220"}, "ppm", 2910.0,
           (2600.0, 3400.0), _dates, source="lata-mas/Monitor_co2_pistas_educativas"),
    Record("cold finger", "dewar_warm_up.csv", {"finger": 3}, "degC", 1.0, (0.0, 1200.0),
           lambda f: (f[2] - f[2][0]).to_numpy(), header=None, keys='time = "column 3"\n',
           source="aceisScope/pidtunning"),
)  # fmt: skip


def independent(t: FloatArray, y: FloatArray, on: float) -> tuple[float, float, float]:
    """tau, its standard error under white noise, and the rms of the rest, by scipy."""
    from scipy.optimize import curve_fit

    def model(at: FloatArray, y0: float, beta: float, t0: float, tau: float) -> FloatArray:
        return y0 + beta * -np.expm1(-np.maximum(at - t0, 0.0) / tau)

    start = y[t <= max(on, t[2])].mean(), y[-10:].mean() - y[0], on, 0.1 * (t[-1] - on)
    best, cov = curve_fit(model, t, y, start, maxfev=20000)
    return float(best[3]), float(np.sqrt(cov[3, 3])), float(np.std(y - model(t, *best)))


def found(record: Record, folder: Path) -> list[dict[str, Any]]:
    """One row a sensor."""
    base = {"record": record.name, "source": record.source, "unit": record.unit}
    rows = []
    with TemporaryDirectory() as place:
        shutil.copy(folder / record.file, place)
        path = Path(place) / "campaign.toml"
        path.write_text(record.toml, encoding="utf-8")
        campaign = read_campaign(path)
        fit = fit_least_squares(campaign, seed=SEED)
        try:
            posterior = sample_posterior(campaign, fit, SEED, FASTEST)
            said, intervals = posterior.convergence, posterior.rows
        except CampaignError as error:
            said, intervals = str(error), {}
    summary = fit.to_json()
    for sensor in record.sensors:
        t, y = record.samples(folder, sensor)
        tau, error, rms = independent(t, y, record.on)
        name = f"tau_s[{sensor}]" if len(record.sensors) > 1 else "tau_s"
        row = intervals.get(name, {})
        sigma = f"sigma0_V[{sensor}]" if len(record.sensors) > 1 else "sigma0_V"
        low, high = row.get("q2.5", np.nan), row.get("q97.5", np.nan)
        rows.append({
            **base, "sensor": sensor, "n_samples": len(t), "scipy_tau_s": tau,
            "scipy_standard_error_s": error, "fit_tau_s": fit.parameters[name],
            "lo95_s": low, "q50_s": row.get("q50", np.nan), "hi95_s": high,
            "holds_scipy": int(low <= tau <= high),
            "sigma0": intervals.get(sigma, {}).get("q50", np.nan), "scipy_rms": rms,
            "misfit": summary["misfit"], "said": said,
        })  # fmt: skip
    return rows


def run(
    folder: Path, jobs: int, scheduler: str | None, progress: Callable[[int, int], None]
) -> None:
    """Write recorders.csv, where the records are at hand."""
    place = os.environ.get(WHERE)
    if not place:
        print(f"{WHERE} is not set: recorders.csv stays as it is", flush=True)
        return
    rows = []
    for k, record in enumerate(RECORDS):
        rows += found(record, Path(place) / "recorders")
        progress(k + 1, len(RECORDS))
    pd.DataFrame(rows).to_csv(TABLES / "recorders.csv", index=False, float_format="%.4g")
