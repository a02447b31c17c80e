"""Undoing the lag: how often the bands hold the input, and a slow sensor beside a fast one.

Simulated inputs (steps, bumps, noise of three spectra) pass one to three lags; AR(1) noise is
added.  Each lag is off its stated value by nothing or by 10 % (one standard deviation).  Beside the
band that knows how badly the lags are known stands one that takes them as known.

The real pair is not part of this repository: the folder that holds ``field.mat`` and ``step.csv``
(github.com/KnutOlaD/Deconv_code_data, EUPL-1.2; Dolven et al., Geosci. Instrum. Method. Data Syst.
11, 293, 2022) is read from the environment variable ``BAYES_SENSOR_SLOW_AND_FAST``; where that is
not set, its table and figure stay as they are.  The lag comes from ``step.csv``, in which the fast
sensor shows what the water did: gain, delay and one lag are fitted.  A single lag leaves a misfit
far above the noise, so mean and standard deviation are those of the lags of five pieces of the
record.  The fast sensor of ``field.mat`` is used for the comparison only.
"""

from __future__ import annotations

import os
from collections.abc import Callable
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from time import process_time
from typing import Any

import numpy as np
import pandas as pd
from drawing import ACCENT, INK, SHADE, TABLES, WIDTH, plt, save
from scipy.optimize import least_squares
from scipy.signal import lfilter

import bayes_sensor as bs
from bayes_sensor.campaign import FloatArray
from bayes_sensor.checks.study_chunks import run_chunks, study_key
from bayes_sensor.io.record_file import read_record

WHERE = "BAYES_SENSOR_SLOW_AND_FAST"
INPUTS = ("steps", "bumps", "rough", "smooth", "slow")
LAGS = ((20.0,), (20.0, 8.0), (20.0, 8.0, 4.0))
"""s; samples are 1 s apart"""
PHIS = (0.0, 0.5, 0.9)
OFF = (0.0, 0.1)
"""relative standard deviation of the lags"""
REPEATS, N, FINE, SEED = 10, 600, 10, 64
"""records of each kind, samples of each, steps of the simulation in a sampling interval"""
SIZES = (10_000, 100_000, 1_000_000)
"""samples of the records whose cost is measured"""
PIECES = 5
"""of the step record"""


@dataclass(frozen=True)
class Case:
    """One simulated record and the input behind it."""

    t: FloatArray
    u: FloatArray
    y: FloatArray
    lags: tuple[float, ...]
    """s, as they are stated"""


def _input(kind: str, slowest: float, rng: np.random.Generator) -> FloatArray:
    """(N * FINE,) an input whose changes take about as long as the slowest lag."""
    n = N * FINE
    x = np.arange(n) / FINE
    if kind == "steps":
        found = np.zeros(n)
        for begin in rng.uniform(0, n, rng.integers(3, 8)):
            found[int(begin) :] += rng.normal()
        return found
    if kind == "bumps":
        width = slowest * rng.uniform(0.5, 2.0, 6)
        centre, height = rng.uniform(0.0, N, 6), rng.uniform(0.5, 2.0, 6)
        return (height * np.exp(-0.5 * ((x[:, None] - centre) / width) ** 2)).sum(axis=1)
    order, length = {"rough": (1, 2.0), "smooth": (2, 2.0), "slow": (3, 5.0)}[kind]
    a = np.exp(-np.sqrt(2.0 * order - 1.0) / (length * slowest * FINE))
    before = int(20 * length * slowest * FINE)
    found = rng.standard_normal(n + before)
    for _ in range(order):
        found = lfilter([1.0], [1.0, -a], found)
    return found[-n:] / found.std()


def simulate(number: int) -> tuple[Case, tuple[str, int, float, float]]:
    """The record of this number, and which kind it is of."""
    kinds = [(k, s, p, o) for k in INPUTS for s in LAGS for p in PHIS for o in OFF]
    kind, stated, phi, off = kinds[number % len(kinds)]
    rng = np.random.default_rng([SEED, number])
    u = _input(kind, max(stated), rng)
    y = u
    for lag in stated:
        b = np.exp(-1.0 / (FINE * lag * np.exp(off * rng.standard_normal())))
        y = lfilter([1.0 - b], [1.0, -b], y, zi=[b * y[0]])[0]
    e = lfilter([1.0], [1.0, -phi], rng.standard_normal(N + 200))[200:] * np.sqrt(1.0 - phi**2)
    noise = y.std() * 10.0 ** rng.uniform(-2.3, -1.3)
    case = Case(np.arange(N) * 1.0, u[::FINE], y[::FINE] + noise * e, stated)
    return case, (kind, len(stated), phi, off)


def _shares(found: bs.Restored, u: FloatArray) -> tuple[float, float]:
    q = [found.quantile(p) for p in (0.025, 0.16, 0.84, 0.975)]
    return float(np.mean((q[0] < u) & (u < q[3]))), float(np.mean((q[1] < u) & (u < q[2])))


def count(number: int) -> dict[str, Any]:
    """Shares of the times at which the bands hold the input; with and without the lags' spread."""
    case, (kind, n_lags, phi, off) = simulate(number)
    known = bs.restore([f"{lag} s" for lag in case.lags], (case.t, case.y))
    found = known
    if off:
        found = bs.restore([f"{lag} +- {off * lag} s" for lag in case.lags], (case.t, case.y))
    share95, share68 = _shares(found, case.u)
    return {
        "input": kind, "lags": n_lags, "phi": phi, "lag_sd": off, "share95": share95,
        "share68": share68, "share95_known": _shares(known, case.u)[0],
        "rms_over_sd": np.sqrt(np.mean((found.mean - case.u) ** 2) / np.mean(found.sd**2)),
        "misfit": found.innovations.p_value < 1e-3,
    }  # fmt: skip


def calibration_table(rows: pd.DataFrame) -> pd.DataFrame:
    """Means of the shares: over all, and by each of the things that differ."""
    parts = []
    values = ["share95", "share68", "share95_known", "rms_over_sd", "misfit"]
    for off, some in rows.groupby("lag_sd"):
        for name in ("all", "input", "lags", "phi"):
            groups = [("all", some)] if name == "all" else some.groupby(name)
            for value, group in groups:
                error = group["share95"].std(ddof=1) / np.sqrt(len(group))
                parts.append({"lag_sd": off, "by": name, "value": value, "records": len(group),
                              **group[values].mean(), "share95_error": error})  # fmt: skip
    return pd.DataFrame(parts)


# --------------------------------------------------------------------------- the real pair


def step_record(path: Path) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Times in s, the fast and the slow sensor (n,) of the step."""
    rows = [line.strip().strip('"').split("\t") for line in path.read_text().splitlines()]
    values = np.array([[float(cell) for cell in row] for row in rows[1:]])
    t = 86400.0 * values[:, 0]
    new = np.concatenate([[True], np.diff(t) > 0.1])  # some rows stand twice
    return t[new], values[new, 1], values[new, 2]


def lagged(
    t: FloatArray, u: FloatArray, lag: float, delay: float, first: float | None = None
) -> FloatArray:
    """(n,) ``u`` after a delay and a lag (s), linear between samples; ``first``: its first value,
    that of ``u`` where nothing is given."""
    moved = np.interp(t - delay, t, u)
    found = np.empty(len(t))
    found[0] = moved[0] if first is None else first
    step = np.diff(t)
    left = np.exp(-step / lag)
    mean = 1.0 - lag / step * (1.0 - left)
    for i in range(len(step)):
        found[i + 1] = left[i] * found[i] + (1.0 - left[i]) * moved[i]
        found[i + 1] += mean[i] * (moved[i + 1] - moved[i])
    return found


def fit_step(
    t: FloatArray, fast: FloatArray, slow: FloatArray
) -> tuple[float, float, float, float, float, float]:
    """Lag (s) and its standard deviation, gain, offset (ppm), delay (s), the misfit's RMS (ppm).

    The offset is that of the readings before the step.  The delay is that of the slow sensor after
    the fast one; it is negative where the fast one's own water comes later.  The lag of every piece
    is fitted by itself, with the gain of the whole.  The pieces differ by far more than their
    errors, so that each counts alike (random effects); the lag of another record is as far from
    their mean as they are.
    """
    t, fast, slow = t[::5], fast[::5], slow[::5]  # 5 s are short against half an hour
    before = t < 0.0
    base = fast[before].mean(), slow[before].mean()

    def residual(p: FloatArray) -> FloatArray:
        lag, gain, delay = p
        return gain * (lagged(t, fast, lag, delay) - base[0]) + base[1] - slow

    found = least_squares(
        residual, [1800.0, 0.8, 10.0], x_scale=[1000.0, 1.0, 10.0],
        bounds=([60.0, 0.1, -300.0], [20_000.0, 5.0, 300.0]),
    )  # fmt: skip
    lag, gain, delay = (float(v) for v in found.x)
    offset = float(base[1] - gain * base[0])
    own, errors = [], []
    for begin, end in pairwise(np.linspace(0.0, t[-1], PIECES + 1)):
        some = (t >= begin) & (t < end)
        input_, read = np.interp(t[some] - delay, t, fast), (slow[some] - offset) / gain
        first = float(read[:20].mean())

        def piece(
            p: FloatArray, t: FloatArray = t[some], u: FloatArray = input_, y: FloatArray = read,
            first: float = first,
        ) -> FloatArray:  # fmt: skip
            return first * np.exp(-(t - t[0]) / p[0]) + lagged(t, u, p[0], 0.0, 0.0) - y

        fit = least_squares(piece, [lag], x_scale=[1000.0], bounds=([60.0], [20_000.0]))
        own.append(float(fit.x[0]))
        errors.append(float(np.std(fit.fun) / np.sqrt((fit.jac**2).sum())))
    print(
        f"slow and fast: one lag {lag:.0f} s; of the pieces {np.round(own)} +- {np.round(errors)} s"
    )
    mean, spread = float(np.mean(own)), float(np.std(own, ddof=1))
    return mean, spread, gain, offset, delay, float(np.sqrt(np.mean(found.fun**2)))


def real_pair(folder: Path) -> pd.DataFrame:
    """The comparison with the fast sensor, a row a way of restoring; writes the figure."""
    from scipy.io import loadmat

    t, fast, slow = step_record(folder / "step.csv")
    lag, spread, gain, offset, delay, rms = fit_step(t, fast, slow)
    print(f"slow and fast: lag {lag:.0f} +- {spread:.0f} s, gain {gain:.3f}, "
          f"offset {offset:.2f} ppm, delay {delay:.1f} s, rms {rms:.2f} ppm")  # fmt: skip
    record = read_record(folder / "field.mat", signal="slow", signal_unit="ppm")
    reference = loadmat(folder / "field.mat")["fast"].ravel()
    seen = np.isfinite(reference)
    rows, drawn = [], None
    ways = {
        "as recorded": None,
        "lag as known": f"{lag} s",
        "lag from the step": f"{lag} +- {spread} s",
    }
    for words, text in ways.items():
        for unit in ("sensor's", "fast sensor's"):
            # the authors took the drift, and with it the offset, out of the field record
            k, d = (1.0, 0.0) if unit == "sensor's" else (gain, delay)
            own = record.t - d  # when the fast sensor saw the same
            both = seen & (record.t >= own[0]) & (record.t <= own[-1])

            def at_fast(values: FloatArray, own: FloatArray = own) -> FloatArray:
                return np.interp(record.t, own, values)

            row: dict[str, Any] = {"record": words, "scale": unit}
            y = record.y / k
            if text is None:
                value, inside, resolution = at_fast(y), np.nan, np.nan
            else:
                found = bs.restore(text, (record.t, y), nonnegative=True)
                value, resolution = at_fast(found.value), found.resolution_s
                low, high = at_fast(found.quantile(0.025)), at_fast(found.quantile(0.975))
                inside = float(np.mean(((low < reference) & (reference < high))[both]))
                drawn = (record.t, value, low, high)
            error = (value - reference)[both]
            row |= {
                "lag_s": lag, "lag_sd_s": spread if "step" in words else 0.0,
                "gain": gain, "offset_ppm": offset,
                "delay_s": delay,
                "r2": np.corrcoef(value[both], reference[both])[0, 1] ** 2,
                "share95": inside, "rms_ppm": np.sqrt(np.mean(error**2)),
                "resolution_s": resolution,
            }  # fmt: skip
            rows.append(row)
    assert drawn is not None
    _draw(*drawn, reference)
    return pd.DataFrame(rows)


def _draw(
    t: FloatArray, value: FloatArray, low: FloatArray, high: FloatArray, reference: FloatArray
) -> None:
    figure, axes = plt.subplots(3, 1, figsize=(WIDTH, 5.0), layout="constrained")
    for axis, (begin, end) in zip(axes, ((0.0, 4000.0), (4000.0, 12_000.0), (18_000.0, t[-1]))):
        some = np.flatnonzero((t >= begin) & (t <= end))[::4]  # 8 s, far below the resolution
        axis.fill_between(t[some] / 3600, low[some], high[some], color=SHADE, label="95 % band")
        axis.plot(t[some] / 3600, reference[some], color=INK, lw=0.6, label="fast sensor")
        axis.plot(t[some] / 3600, value[some], color=ACCENT, label="slow sensor, restored")
        axis.set_ylabel("methane (ppm)")
    axes[0].legend(loc="upper right")
    axes[-1].set_xlabel("time (h)")
    save(figure, "slow_and_fast")


def seconds_table() -> pd.DataFrame:
    """Processor seconds of one core by the number of samples, a row a kind of sampling."""
    rows = []
    for n in (1000, *SIZES):  # the first compiles
        rng = np.random.default_rng(SEED)
        u = lfilter([1.0], [1.0, -0.999], rng.standard_normal(n))
        b = np.exp(-1.0 / 500.0)
        y = lfilter([1.0 - b], [1.0, -b], u / u.std())
        quiet = 0.02 * y.std() * lfilter([1.0], [1.0, -0.5], rng.standard_normal(n))
        loud = quiet * (1.0 + 3.0 * (y - y.min()) / np.ptp(y))
        t = np.arange(n) * 1.0
        for words, times, noise in (
            ("regular", t, quiet), ("regular, noise grows with the signal", t, loud),
            ("no two steps alike", np.sort(t + rng.uniform(-0.3, 0.3, n)), quiet),
        ):  # fmt: skip
            begin = process_time()
            bs.restore("500 +- 20 s", (times, y + noise))
            rows.append({"sampling": words, "samples": n, "seconds": process_time() - begin})
    return pd.DataFrame(rows[3:])


def run(
    folder: Path, jobs: int, scheduler: str | None, progress: Callable[[int, int], None]
) -> None:
    """Write restoration.csv, restoration_seconds.csv and, of the pair, slow_and_fast.csv."""
    n = REPEATS * len(INPUTS) * len(LAGS) * len(PHIS) * len(OFF)
    key = study_key("restoration", SEED, INPUTS, LAGS, PHIS, OFF, N, FINE)
    results = run_chunks(
        count, n, folder / "restoration", key, jobs, chunk=30, scheduler=scheduler,
        progress=progress,
    )  # fmt: skip
    table = calibration_table(pd.DataFrame(results))
    table.to_csv(TABLES / "restoration.csv", index=False, float_format="%.3g")
    seconds_table().to_csv(TABLES / "restoration_seconds.csv", index=False, float_format="%.3g")
    place = os.environ.get(WHERE)
    if not place:
        print(f"restoration: {WHERE} is not set (the folder of the pair): its table left alone")
        return
    pair = real_pair(Path(place))
    pair.to_csv(TABLES / "slow_and_fast.csv", index=False, float_format="%.4g")
