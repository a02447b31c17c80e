"""Traces for figures: each record as an envelope beside the model, saved with the results."""

from __future__ import annotations

import os
from collections.abc import Sequence
from dataclasses import dataclass, fields
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from bayes_sensor.campaign import Campaign, FloatArray
from bayes_sensor.io.array_archive import check_array, load_archive, save_archive
from bayes_sensor.io.json_files import plain
from bayes_sensor.io.result_schema import check_result

if TYPE_CHECKING:
    from bayes_sensor.likelihood.problem import Problem

BINS_WHOLE = 600
"""stretches of an envelope over a whole record"""

BINS_SWITCH = 260
"""stretches of an envelope around a switch"""


@dataclass(frozen=True, eq=False)
class Envelope:
    """A stretch of a trace in ``n`` bins; where there are few samples, each is its own bin."""

    t: FloatArray
    """(n,) s, middle of each bin"""
    low: FloatArray
    """(n,) V, least used sample"""
    high: FloatArray
    """(n,) V, greatest"""
    model: FloatArray
    """(n,) V, mean of the fitted model"""
    residual_low: FloatArray
    """(n,) V"""
    residual_high: FloatArray
    """(n,) V"""
    residual: FloatArray
    """(n,) V, mean of measurement minus model"""
    sd: FloatArray
    """(n,) V, the noise law's standard deviation"""


@dataclass(frozen=True, eq=False)
class Trace:
    """What the figures of one experiment need."""

    name: str
    total_flow: float
    """mL/s"""
    concentration: float
    """between 0 and 1"""
    t0: float
    """s, fitted start of the step"""
    tf: float | None
    commanded_on: float | None
    commanded_off: float | None
    rms: float
    """V"""
    whole: Envelope
    rise: Envelope
    fall: Envelope | None
    signal_unit: str = "V"


_PARTS = ("whole", "rise", "fall")
"""the envelopes of a trace"""


def envelope(
    t: FloatArray, y: FloatArray, model: FloatArray, sd: FloatArray, n_bins: int
) -> Envelope:
    """Least, greatest and mean of samples (n_t,) in at most ``n_bins`` bins of equal duration.

    >>> t = np.arange(6.0)
    >>> envelope(t, t, np.zeros(6), np.ones(6), 3).high.tolist()
    [1.0, 3.0, 5.0]
    """
    if len(t) <= n_bins:
        start = np.arange(len(t))
    else:
        place = ((t - t[0]) / (t[-1] - t[0]) * n_bins).astype(int).clip(0, n_bins - 1)
        start = np.flatnonzero(np.diff(place, prepend=-1))
    count = np.diff(np.append(start, len(t)))
    r = y - model
    means = [np.add.reduceat(v, start) / count for v in (t, model, r, sd)]
    return Envelope(
        means[0],
        np.minimum.reduceat(y, start),
        np.maximum.reduceat(y, start),
        means[1],
        np.minimum.reduceat(r, start),
        np.maximum.reduceat(r, start),
        means[2],
        means[3],
    )


def make_traces(campaign: Campaign | Problem, fit: Any) -> list[Trace]:
    """The traces of every experiment at ``fit.theta_hat``."""
    from bayes_sensor.likelihood.density import mean_and_variance  # slow to import
    from bayes_sensor.likelihood.problem import as_problem

    problem = as_problem(campaign)
    layout = problem.layout
    vector = layout.flat(fit.theta_hat)
    traces = []
    for k, e in enumerate(problem.campaign):
        model, variance = mean_and_variance(problem, vector, k)
        switching = layout.switching[k]
        t0, tf = float(e.t[0]), None
        if switching.moves:
            times = switching.times(vector[layout.switches(k)])
            t0 = float(times[0])
            tf = float(times[1]) if len(times) > 1 else None
        span = float(2.2 * layout.taus(vector, k, e.total_flow).sum())
        used = e.used
        samples = (e.t[used], e.values[used], model[used], np.sqrt(variance[used]))

        traces.append(
            Trace(
                e.name,
                e.total_flow,
                e.concentration,
                t0,
                tf,
                e.commanded_on,
                e.commanded_off,
                float(np.sqrt(np.mean((samples[1] - samples[2]) ** 2))),
                envelope(*samples, BINS_WHOLE),
                _around(samples, t0, e.commanded_on, span),
                None if tf is None else _around(samples, tf, e.commanded_off, span),
                problem.campaign.signal_unit,
            )
        )
    return traces


def _around(
    samples: tuple[FloatArray, ...], edge: float, commanded: float | None, span: float
) -> Envelope:
    """The stretch around a switch, from the command where that is near."""
    t = samples[0]
    begin = edge - 0.35 * span
    if commanded is not None and 0.0 <= edge - commanded < 1.5 * span:
        begin = min(begin, commanded - 0.1 * span)
    a, b = (int(v) for v in np.searchsorted(t, [begin, edge + 1.9 * span]))
    if b - a < 8:
        a, b = max(0, min(a, len(t) - 8)), len(t)
    y, model, sd = (values[a:b] for values in samples[1:])
    return envelope(t[a:b], y, model, sd, BINS_SWITCH)


def save_traces(path: str | os.PathLike[str], traces: Sequence[Trace]) -> None:
    """Write traces as a NumPy archive in single precision."""
    arrays: dict[str, Any] = {}
    facts = []
    for k, trace in enumerate(traces):
        content = dict(vars(trace))
        for part in _PARTS:
            piece = content.pop(part)
            if piece is not None:
                table = np.stack(list(vars(piece).values()))
                # seven digits do not hold the time of day, nor that since an epoch
                arrays[f"{k}_{part}_start"] = start = table[0, :1].copy()
                table[0] -= start
                arrays[f"{k}_{part}"] = table.astype(np.float32)
        facts.append(content)
    save_archive(path, plain(facts), arrays)


def load_traces(path: str | os.PathLike[str]) -> list[Trace]:
    """What :func:`save_traces` wrote."""
    facts, content = load_archive(path, "traces")
    check_result(facts, Path(path))
    traces = []
    for k, fact in enumerate(facts):
        parts: dict[str, Any] = dict.fromkeys(_PARTS)
        for part in parts:
            if part != "fall" or f"{k}_{part}" in content:
                shape = (len(fields(Envelope)), None)
                table = check_array(path, content, f"{k}_{part}", "f", shape).astype(float)
                table[0] += check_array(path, content, f"{k}_{part}_start", "f", (1,))
                parts[part] = Envelope(*table)
        if fact["total_flow"] is None:  # which JSON has in place of nan
            fact["total_flow"] = float("nan")
        traces.append(Trace(**fact, **parts))
    return traces
