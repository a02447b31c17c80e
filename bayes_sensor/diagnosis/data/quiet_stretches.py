"""The quiet parts of records, glitches replaced, and what is computed from one such stretch."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import median_filter
from scipy.signal import lfilter, windows

from bayes_sensor.campaign import Campaign, Experiment, FloatArray
from bayes_sensor.diagnosis.data.bins import ExperimentBins

SPIKE = 6.5
"""robust standard deviations beyond which a sample is taken for a glitch"""
LONG, SHORT, FEW = 64, 24, 12
"""samples of a stretch that tell a spectrum in several bands; that tell it in one or two, in
records of a sample a second; and that tell little more than a size"""
WIDTH, NARROW = 5, 2
"""samples on either side of one that tell whether it is a glitch; and where a lag lasts for few"""
SPELL = 200
"""samples in a row that tell whether all of them are large, and none of them a glitch"""
MUCH = 1.5
"""times the usual spread from which they are"""


@dataclass(frozen=True, eq=False)
class Stretch:
    """A quiet part of one record."""

    experiment: int
    level: int
    """0 carrier gas alone, 1 plateau"""
    samples: FloatArray
    """(n,) V, residual of the fit, spikes replaced"""
    begin: float = 0.0
    """s, time of the first sample"""


@dataclass(frozen=True)
class QuietSpans:
    """Where one record is quiet, and what to scale it by."""

    switches: tuple[float, ...]
    """s"""
    spans: tuple[tuple[float, float], ...]
    """s, from settling to the next switch"""
    deviation: FloatArray
    """(n_t,) V, the noise's standard deviation at every sample"""
    step: float = 1.0
    """V, height of the plateau over the baseline"""
    high: tuple[bool, ...] = (False, True, False)
    """whether each span is on a plateau"""


def clean(
    residual: FloatArray, used: NDArray[np.bool_], resolution: float = 0.0, width: int = WIDTH
) -> tuple[FloatArray, int]:
    """The residual with unused samples and spikes set to the local median, and how many spikes.

    ``resolution`` V: the converter's step.  Where the noise hardly crosses it most samples are
    equal, and a median would take every sample a step away for a spike.  ``width``: samples on
    either side that make the median; where few samples make up a rise a misfit is as short.
    """
    out = np.where(used, residual, 0.0)
    values = out[used]
    if len(values) < 8:
        return out, 0
    centre = np.median(values)
    # differences see spikes even where the model misses the trace
    step = np.diff(values)
    spread = float(spread_of(step))
    scale = 1.4826 * np.median(np.abs(values - centre))
    if scale <= 0.0 or spread <= 0.0:
        return out, 0
    padded = np.pad(out, width, mode="edge")
    local = (
        np.median(np.lib.stride_tricks.sliding_window_view(padded, 2 * width + 1)[::1], axis=1)
        if len(out) <= 20000
        else _running_median(out, width)
    )
    usual = max(spread, scale, 0.5 * resolution)
    away = np.abs(out - local) > SPIKE * np.maximum(usual, _spread_nearby(out, spread))
    return np.where(away & used, local, out), int(np.sum(away & used))


def spread_of(steps: FloatArray) -> FloatArray:
    """(..,) standard deviation of values that differ by ``steps`` (.., n) from their neighbours.

    By the median, which neither glitches nor a misfit move.
    """
    return np.asarray(1.4826 * np.median(np.abs(steps), axis=-1) / np.sqrt(2.0), dtype=float)


def _spread_nearby(values: FloatArray, usual: float) -> FloatArray:
    """(n,) V, spread of the noise where it is much louder than ``usual`` for a while; or zero."""
    n = len(values) // SPELL
    if n < 2:
        return np.zeros(len(values))
    nearby = spread_of(np.diff(values, append=values[-1])[: n * SPELL].reshape(n, SPELL))
    nearby = np.where(nearby > MUCH * usual, nearby, 0.0)
    return np.asarray(nearby[np.minimum(np.arange(len(values)) // SPELL, n - 1)], dtype=float)


def _running_median(values: FloatArray, width: int) -> FloatArray:
    median: FloatArray = median_filter(values, size=2 * width + 1, mode="nearest")
    return median


def quiet_stretches(
    campaign: Campaign,
    residuals: Sequence[FloatArray],
    bins: Sequence[ExperimentBins],
    settle: Sequence[float] | None = None,
) -> list[Stretch]:
    """The quiet parts of all records; what settles after a switch is left out.

    ``settle`` s of every experiment; None: of every switch what its response needs.  Short
    stretches count where no record has a long one.  Where there is none even so and ``settle`` is
    None, the response is left out in part only, or not at all: the residual of a fit holds the
    noise there, too, beside what the model misses.
    """
    tries = [(LONG, 1.0), (SHORT, 1.0)]
    if settle is None:
        tries += [(SHORT, 0.5), (FEW, 1.0), (FEW, 0.5), (FEW, 0.25), (FEW, 0.0)]
    for fewest, share in tries:
        found = _quiet_stretches(campaign, residuals, bins, settle, fewest, share)
        if found:
            break
    return found


def _quiet_stretches(
    campaign: Campaign,
    residuals: Sequence[FloatArray],
    bins: Sequence[ExperimentBins],
    settle: Sequence[float] | None,
    fewest: int,
    share: float,
) -> list[Stretch]:
    found = []
    for k, (e, r, b) in enumerate(zip(campaign, residuals, bins, strict=True)):
        for low, high, level in spans_of(e, b, None if settle is None else settle[k], share):
            a, z = np.searchsorted(e.t, (low, high))
            for run_a, run_b in e.runs:
                i, j = max(a, run_a), min(z, run_b)
                if (j - i) >= fewest:
                    found.append(Stretch(k, level, np.asarray(r[i:j], dtype=float), float(e.t[i])))
    return found


def spans_of(
    e: Experiment, b: ExperimentBins, settle: float | None = None, share: float = 1.0
) -> list[tuple[float, float, int]]:
    """s, begin and end of every quiet span, and whether it is on a plateau."""
    end = float(e.t[-1]) + e.interval
    begins = [
        float(e.t[b.first[b.segment >= j].min()]) if np.any(b.segment >= j) else None
        for j in range(len(b.switches))
    ]
    first = begins[0] if begins and begins[0] is not None else float(e.t[-1])
    before = b.switches[0].height < 0.0 if b.switches else False
    spans = [(float(e.t[0]), first, int(before))]
    for j, (at, s) in enumerate(zip(begins, b.switches, strict=True)):
        if at is None and j > 0:
            continue
        start = float(e.t[-1]) if at is None else at
        after = next((x for x in begins[j + 1 :] if x is not None), end)
        spans.append((start + (share * s.settle if settle is None else settle), after, int(s.high)))
    return spans


def detrended(samples: FloatArray, degree: int = 2) -> FloatArray:
    """The samples (n,) minus their least-squares polynomial."""
    x = np.linspace(-1.0, 1.0, len(samples))
    basis = np.polynomial.legendre.legvander(x, degree)
    # Legendre polynomials are nearly orthogonal on a grid: the normal equations are harmless
    coefficients = np.linalg.solve(basis.T @ basis, basis.T @ samples)
    return np.asarray(samples - basis @ coefficients, dtype=float)


def periodogram(noise: FloatArray, interval: float) -> tuple[FloatArray, FloatArray]:
    """Frequencies Hz above 0, and the one-sided spectral density V^2/Hz of tapered samples (n,)."""
    n = len(noise)
    taper = windows.tukey(n, 0.2)
    spectrum = np.fft.rfft(noise * taper)
    power = 2.0 * interval * np.abs(spectrum) ** 2 / np.sum(taper**2)
    return np.asarray(np.fft.rfftfreq(n, interval)[1:], dtype=float), power[1:]


HARDLY_CROSSED = 0.7
"""steps over the noise's standard deviation from which it hardly crosses them"""


def innovations(x: FloatArray, order: int) -> FloatArray:
    n = len(x)
    gamma = np.array([float(x[: n - k] @ x[k:]) / n for k in range(order + 1)])
    if gamma[0] <= 0:
        return x
    toeplitz = gamma[np.abs(np.subtract.outer(np.arange(order), np.arange(order)))]
    a = np.linalg.solve(toeplitz + 1e-9 * gamma[0] * np.eye(order), gamma[1:])
    whitened: FloatArray = lfilter(np.concatenate([[1.0], -a]), [1.0], x)
    return whitened[order:]


def hides_the_noise(stretches: Sequence[Stretch], step: float) -> bool:
    """Whether the converter's step V is so coarse that the noise hardly crosses it.

    Rounding then makes lines, plateaus and jumps of its own.
    """
    spreads = [float(np.std(s.samples)) for s in stretches]
    return bool(spreads) and step > HARDLY_CROSSED * min(spreads)
