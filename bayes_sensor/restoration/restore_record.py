"""From lags and a record to the input: fit roughness and noise, draw, smooth, put together."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

import numpy as np

from bayes_sensor.campaign import CampaignError, FloatArray
from bayes_sensor.io.readers.quantities import FLOW, read_quantity
from bayes_sensor.io.record_file import Record, read_record
from bayes_sensor.restoration.hyperparameters import draw_models, fit_orders
from bayes_sensor.restoration.innovations import check_innovations
from bayes_sensor.restoration.lag_draws import LagDraws, posterior_lags, saved_lags, stated_lags
from bayes_sensor.restoration.lower_limit import hold_above
from bayes_sensor.restoration.restored import Restored, resolution_of
from bayes_sensor.restoration.state_space import Model, make_samples

FEWEST = 20
"""samples; fewer tell nothing of noise and roughness"""
MOST_DRAWS, FEWEST_DRAWS = 48, 12
CONTRADICTS = 5.0
"""standard deviations below zero that are no chance at any of a million times"""
WORK = 2_000_000
"""samples times draws, above which fewer draws are made"""


def restore(
    lags: Any,
    record: Any,
    *,
    signal: str | None = None,
    time: str | None = None,
    interval: str | None = None,
    signal_unit: str | None = None,
    at: str = "rig",
    flow: str | float | None = None,
    sensor: str | None = None,
    nonnegative: bool = False,
    seed: int = 1,
    jobs: int = 1,
    progress: Callable[[float, str], None] | None = None,
) -> Restored:
    """The input of a slow sensor over time, with 68 and 95 % bands, from a record of it.

    The record is the input after a chain of first-order lags, plus AR(1) noise that may grow with
    the signal.  The input is a smooth Gaussian process; how smooth, and how large the noise is,
    follows from the record (marginal likelihood of a Kalman filter, exact at irregular times).
    The bands hold the uncertainty of noise, roughness and lags.

    Parameters
    ----------
    lags
        ``"40 +- 2 min"``, a list of such texts (a chain), a posterior or an analysis that has one,
        a folder of results, or :class:`~bayes_sensor.restoration.lag_draws.LagDraws`.
    record
        a file that the readers take, or ``(t, y)``: times (n,) in s and samples (n,), NaN where
        none was taken.
    signal, time, interval, signal_unit
        as in a campaign's experiment: column of the signal, column of times, sampling interval of
        a file without times, unit of the signal.
    at
        with a posterior: ``"rig"`` restores what entered the rig, ``"sensor"`` what reached the
        sensor.
    flow
        with a posterior: the record's total flow; then the volume's lag counts, too.
    sensor
        with a posterior of several sensors: whose record it is.
    nonnegative
        the input is known not to be negative.
    jobs
        threads; the numbers do not depend on it.

    Raises
    ------
    CampaignError
        If the record cannot be read, has too few samples or does not change, or a lag is an upper
        limit only.

    Examples
    --------
    >>> t = np.arange(400.0)
    >>> y = 1 - np.exp(-np.clip(t - 200, 0, None) / 50) + 0.01 * np.random.default_rng(1).normal(
    ...     size=400)
    >>> found = restore("50 +- 1 s", (t, y))
    >>> bool(np.abs(found.value[[100, 350]] - [0, 1]).max() < 0.2)
    True
    """
    tell = progress or (lambda fraction, text: None)
    read = record if isinstance(record, Record) else _record(
        record, signal, time, interval, signal_unit
    )  # fmt: skip
    given = _lags(lags, at, flow, sensor, seed)
    _check(read, given)
    slowest = float(np.median(given.draws.max(axis=1)))
    samples, mean, spread = make_samples(read.t, read.y, slowest)
    centre = np.maximum(np.median(given.draws, axis=0), 1e-6 * slowest)  # no lag of exactly zero
    fitted = fit_orders(samples, centre, tell)
    n_draws = int(np.clip(WORK // len(read.t), FEWEST_DRAWS, MOST_DRAWS))
    rng = np.random.default_rng(seed)
    models = draw_models(fitted, given.spread_out(n_draws), n_draws, rng)

    best = fitted[0].model(centre)
    duration = float(read.t[-1] - read.t[0])
    resolution = resolution_of(models, samples.interval, duration)
    innovations = check_innovations(samples.innovations(best), read.t)
    doubts = [*given.doubts, *_doubts(read, slowest)]
    if nonnegative:
        limit = -mean / spread
        doubts += _below(*samples.smooth(best), limit, read)
        distance = float(np.clip(np.median(resolution), samples.interval, duration))
        samples = hold_above(samples, best, limit, distance)
    first = np.zeros(len(read.t))
    square = np.zeros(len(read.t))
    inner = np.zeros(len(read.t))
    for i, (m, v) in enumerate(_smoothed(samples.smooth, models, jobs)):
        tell(0.4 + 0.6 * i / n_draws, f"draw {i + 1} of {n_draws}")
        step = m - first
        first += step / (i + 1)
        square += step * (m - first)
        inner += (v - inner) / (i + 1)
    return Restored(
        t=read.t,
        recorded=read.y,
        mean=mean + spread * first,
        sd=spread * np.sqrt(inner + square / n_draws),
        nonnegative=nonnegative,
        unit=read.unit,
        resolution=resolution,
        lags=np.array([model.lags for model in models]),
        models=tuple(models),
        spread=spread,
        innovations=innovations,
        interval=samples.interval,
        lag_source=given.source,
        doubts=tuple(doubts),
        remarks=(*given.remarks, *read.notes),
    )


def _smoothed(
    smooth: Callable[[Model], tuple[FloatArray, FloatArray]], models: Sequence[Model], jobs: int
) -> Iterator[tuple[FloatArray, FloatArray]]:
    """Mean and variance of each model, in their order whatever ``jobs`` is."""
    if jobs == 1:
        yield from map(smooth, models)
        return
    with ThreadPoolExecutor(jobs) as pool:  # compiled code runs without the interpreter's lock
        for begin in range(0, len(models), jobs):
            yield from pool.map(smooth, models[begin : begin + jobs])


def _lags(lags: Any, at: str, flow: str | float | None, sensor: str | None, seed: int) -> LagDraws:
    if isinstance(lags, LagDraws):
        return lags
    mL_s = read_quantity(flow, FLOW, "flow") if isinstance(flow, str) else flow
    if isinstance(lags, Path) or (isinstance(lags, str) and Path(lags).is_dir()):
        return saved_lags(Path(lags), at, mL_s, sensor)
    if isinstance(lags, str) or (
        isinstance(lags, Sequence) and all(isinstance(each, str) for each in lags)
    ):
        return stated_lags(lags, seed)
    if hasattr(lags, "posterior") or hasattr(lags, "lags"):
        return posterior_lags(lags, at, mL_s, sensor)
    raise CampaignError(
        f"lags: expected a text such as '40 +- 2 min', a posterior or a folder of results, but got "
        f"{type(lags).__name__}; give one of them"
    )


def _record(
    record: Any, signal: str | None, time: str | None, interval: str | None, unit: str | None
) -> Record:
    if isinstance(record, str | os.PathLike):
        return read_record(
            Path(record), signal=signal, time=time, interval=interval, signal_unit=unit
        )
    t, y = (np.asarray(each, dtype=float) for each in record)
    if t.ndim != 1 or t.shape != y.shape or not np.isfinite(t).all() or (np.diff(t) <= 0).any():
        raise CampaignError(
            f"record: expected times (n,) that increase and samples (n,), but got arrays of shapes "
            f"{t.shape} and {y.shape}; sort by time and drop repeated times"
        )
    return Record(t, y, unit or "", "record", "signal")


def _doubts(record: Record, slowest: float) -> list[str]:
    duration = float(record.t[-1] - record.t[0])
    if duration >= slowest:
        return []
    return [
        f"{record.source}: the record lasts {duration:.4g} s, less than the longest lag of "
        f"{slowest:.4g} s; if that is not so, give the times' unit in the name of their column"
    ]


def _below(mean: FloatArray, variance: FloatArray, limit: float, record: Record) -> list[str]:
    """A doubt where the record contradicts an input that is not negative."""
    distance = (limit - mean) / np.sqrt(variance)
    worst = int(np.argmax(distance))
    if distance[worst] < CONTRADICTS:
        return []
    return [
        f"the record contradicts an input that is not negative: at {record.t[worst]:.4g} s it is "
        f"{distance[worst]:.3g} standard deviations below zero; is there an offset or a drift?"
    ]


def _check(record: Record, lags: LagDraws) -> None:
    seen = record.y[np.isfinite(record.y)]
    if len(seen) < FEWEST:
        raise CampaignError(
            f"{record.source}: expected at least {FEWEST} samples, but got {len(seen)}; give a "
            "longer record"
        )
    if not seen.std() > 1e-14 * np.abs(seen).max():
        raise CampaignError(
            f"{record.source}: every sample is {seen[0]:.6g}; expected a signal that changes: "
            "choose the sensor's column (signal)"
        )
    interval, slowest = float(np.median(np.diff(record.t))), float(np.median(lags.draws.max(1)))
    if slowest < 0.5 * interval:
        raise CampaignError(
            f"{record.source}: the longest lag, {slowest:.4g} s, is shorter than half the sampling "
            f"interval of {interval:.4g} s: there is no lag to undo; sample faster, or check the "
            "units of lag and times"
        )
