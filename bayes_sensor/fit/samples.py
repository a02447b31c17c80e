"""Every sample of a campaign, coded so small that a page can hold them all.

Values are rounded to a sixteenth of the noise, which no picture shows, and only the steps from one
to the next are kept.  The steps are small integers; Rice's code (R. F. Rice, JPL Publication
79-22, 1979) writes one in about five bits, and is undone in a few lines of script.  The model is
smooth and stands as a polygon that stays within half a rounding step of it.
"""

from __future__ import annotations

import base64
import os
from collections.abc import Sequence
from dataclasses import dataclass, replace
from math import ceil, log2
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from bayes_sensor.campaign import Campaign, FloatArray
from bayes_sensor.io.array_archive import check_array, load_archive, save_archive
from bayes_sensor.io.result_schema import check_result
from bayes_sensor.io.untrusted import refused

if TYPE_CHECKING:
    from bayes_sensor.likelihood.problem import Problem

FRACTION = 16.0
"""rounding steps in one standard deviation of the noise"""
FINE = 50
"""parts of the shortest step to which irregular times are shown"""
LONGEST_RUN = 24
"""ones in a row after which a value is written out in 32 bits"""


@dataclass(frozen=True, eq=False)
class Samples:
    """One experiment at full resolution."""

    name: str
    start: float
    """s, time of the first sample of the record"""
    interval: float
    """s"""
    offset: float
    """V, the value that 0 stands for"""
    step: float
    """V, what one unit of ``values`` stands for"""
    runs: np.ndarray
    """(n, 3) first index, number and spacing of each run of samples; a spacing above one means
    the least and the greatest sample of each stretch of two spacings"""
    values: np.ndarray
    """(n_values,) integers, all runs one after the other"""
    model: FloatArray
    """(3, n_nodes): time s, model V and the noise law's standard deviation V"""

    @property
    def t(self) -> FloatArray:
        """(n_values,) s"""
        parts = [first + spacing * np.arange(n) for first, n, spacing in self.runs]
        return self.start + self.interval * np.concatenate(parts)


def polygon(t: FloatArray, y: FloatArray, tolerance: float) -> np.ndarray:
    """Indices of nodes whose polygon stays within ``tolerance`` of y (n,) (Douglas and Peucker).

    >>> polygon(np.arange(5.0), np.array([0.0, 1, 2, 2, 2]), 0.01).tolist()
    [0, 2, 4]
    """
    kept = {0, len(t) - 1}
    open_ends = [(0, len(t) - 1)]
    while open_ends:
        a, b = open_ends.pop()
        if b - a < 2:
            continue
        line = y[a] + (y[b] - y[a]) / (t[b] - t[a]) * (t[a : b + 1] - t[a])
        far = np.abs(y[a : b + 1] - line)
        i = a + int(np.argmax(far))
        if far[i - a] > tolerance:
            kept.add(i)
            open_ends += [(a, i), (i, b)]
    return np.array(sorted(kept))


def make_samples(campaign: Campaign | Problem, fit: Any) -> list[Samples]:
    """Every experiment's samples and the model at ``fit.theta_hat``."""
    from bayes_sensor.likelihood.density import mean_and_variance  # slow to import
    from bayes_sensor.likelihood.problem import as_problem

    problem = as_problem(campaign)
    vector = problem.layout.flat(fit.theta_hat)
    made = []
    for k, e in enumerate(problem.campaign):
        model, variance = mean_and_variance(problem, vector, k)
        sd = np.sqrt(variance)
        index = np.flatnonzero(e.used)
        y = e.values[index]
        smallest = max(float(sd.min()), 1e-7 * float(np.ptp(y)), 1e-300)
        step = smallest / FRACTION
        # one wild sample must not take the code out of its 32 bits
        step = max(step, float(np.abs(y - y[0]).max()) / 2**29)
        values = np.rint((y - y[0]) / step).astype(np.int64)
        nodes = polygon(e.t, model, 0.5 * step)
        interval, place = e.interval, index
        if not e.regular:  # a grid so fine that it shows every time where it is
            interval = float(np.diff(e.t).min()) / FINE
            place = np.rint((e.t[index] - e.t[0]) / interval).astype(np.int64)
        breaks = np.flatnonzero(np.diff(place) > 1) + 1
        runs = [(part[0], len(part), 1) for part in np.split(place, breaks)]
        made.append(
            Samples(
                e.name, float(e.t[0]), interval, float(y[0]), step, np.array(runs), values,
                np.stack([e.t[nodes], model[nodes], sd[nodes]]),
            )
        )  # fmt: skip
    return made


def thinned(samples: Samples, edges: Sequence[float], span: float, most: int) -> Samples:
    """At most about ``most`` values: all of them near the edges, least and greatest elsewhere.

    ``edges`` s, the switches; ``span`` s, how far around them every sample is kept.
    """
    n = len(samples.values)
    if n <= most:
        return samples
    t = samples.t
    near = np.zeros(n, dtype=bool)
    for edge in edges:
        near |= np.abs(t - edge) < span
    if near.sum() > most // 2:
        near[:] = False
    spacing = max(2, ceil((n - near.sum()) / (most - near.sum())))
    runs, values, place = [], [], 0
    for first, count, every in samples.runs:
        part = slice(place, place + count)
        place += count
        cuts = np.flatnonzero(np.diff(near[part])) + 1
        for piece in np.split(np.arange(count), cuts):
            inside = samples.values[part][piece]
            if near[part][piece[0]] or len(piece) < 2 * spacing:
                runs.append((first + every * piece[0], len(piece), every))
                values.append(inside)
                continue
            whole = len(inside) // (2 * spacing)
            blocks = inside[: whole * 2 * spacing].reshape(whole, 2 * spacing)
            pairs = np.stack([blocks.min(axis=1), blocks.max(axis=1)], axis=1)
            runs.append((first + every * piece[0], 2 * whole, every * spacing))
            values.append(pairs.ravel())
    return replace(samples, runs=np.array(runs), values=np.concatenate(values))


# --------------------------------------------------------------------------- codes


def rice(values: np.ndarray) -> tuple[int, bytes]:
    """Parameter and bits of Rice's code of the steps between integers; the first from zero.

    A step s becomes u = 2s or -2s - 1; u >> k ones, a zero and the k low bits of u follow, the
    highest first.  From LONGEST_RUN ones on, u itself follows in 32 bits.

    >>> k, code = rice(np.array([1, 1, 0]))
    >>> k, [f"{b:08b}" for b in code]
    (0, ['11001000'])
    """
    steps = np.diff(np.asarray(values, dtype=np.int64), prepend=0)
    u = np.where(steps >= 0, 2 * steps, -2 * steps - 1)
    mean = float(np.median(u))
    k = max(0, ceil(log2(mean))) if mean > 1 else 0
    ones = u >> k
    long = ones >= LONGEST_RUN
    ones = np.where(long, LONGEST_RUN, ones)
    length = np.where(long, LONGEST_RUN + 32, ones + 1 + k)
    begin = np.concatenate([[0], np.cumsum(length)])
    rise = np.zeros(begin[-1] + 1, dtype=np.int8)
    np.add.at(rise, begin[:-1], 1)
    np.add.at(rise, begin[:-1] + ones, -1)
    bits = np.cumsum(rise[:-1], dtype=np.int8).astype(np.uint8)
    short = np.flatnonzero(~long)
    for j in range(k):
        bits[begin[short] + ones[short] + 1 + j] = (u[short] >> (k - 1 - j)) & 1
    wide = np.flatnonzero(long)
    for j in range(32):
        bits[begin[wide] + LONGEST_RUN + j] = (u[wide] >> (31 - j)) & 1
    return k, np.packbits(bits).tobytes()


def _text(content: bytes) -> str:
    return base64.b64encode(content).decode("ascii")


def coded(samples: Samples) -> dict[str, Any]:
    """What the page's script reads: numbers, and base64 of bits and little-endian floats."""
    k, bits = rice(samples.values)
    t, model, sd = samples.model
    return {
        "start": samples.start,
        "interval": samples.interval,
        "offset": samples.offset,
        "step": samples.step,
        "runs": samples.runs.tolist(),
        "n": len(samples.values),
        "k": k,
        "bits": _text(bits),
        "model_t": _text(((t - samples.start) / samples.interval).round().astype("<u4").tobytes()),
        "model": _text(model.astype("<f4").tobytes()),
        "sd": _text(sd.astype("<f4").tobytes()),
    }


# --------------------------------------------------------------------------- files


def save_samples(path: str | os.PathLike[str], samples: Sequence[Samples]) -> None:
    """Write samples as a NumPy archive."""
    arrays: dict[str, Any] = {}
    facts = []
    for k, each in enumerate(samples):
        names = ("name", "start", "interval", "offset", "step")
        facts.append({name: getattr(each, name) for name in names})
        steps = np.diff(each.values, prepend=0)
        small = np.abs(steps).max() < 2**15
        arrays[f"{k}_steps"] = steps.astype(np.int16 if small else np.int32)
        arrays[f"{k}_runs"] = each.runs
        arrays[f"{k}_model"] = each.model
    save_archive(path, facts, arrays)


def load_samples(path: str | os.PathLike[str]) -> list[Samples]:
    """What :func:`save_samples` wrote."""
    facts, content = load_archive(path, "samples")
    check_result(facts, Path(path))
    made = []
    for k, fact in enumerate(facts):
        runs = check_array(path, content, f"{k}_runs", "i", (None, 3))
        steps = check_array(path, content, f"{k}_steps", "i", (None,))
        model = check_array(path, content, f"{k}_model", "f", (3, None))
        if (runs < 0).any() or (runs[:, 1:] > len(steps)).any() or runs[:, 1].sum() != len(steps):
            raise refused(path, f"runs of {len(steps)} samples", "they are of others")
        values = np.cumsum(steps, dtype=np.int64)
        made.append(Samples(**fact, runs=runs, values=values, model=model))
    return made
