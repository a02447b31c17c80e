"""Detector: lines that last for a while, or that single records have.

A source that is on for a while (a telephone, a motor nearby) or that depends on the flow (a hose
that flutters) averages out over all quiet stretches, where
:func:`~bayes_sensor.diagnosis.signals.lines.look_for_lines` tests.  This test uses windows of
seconds and compares each with the other records at the same frequency.
"""

from __future__ import annotations

from collections.abc import Sequence
from math import sqrt

import numpy as np
from scipy.ndimage import gaussian_filter1d
from scipy.signal import windows
from scipy.special import logsumexp

from bayes_sensor.campaign import Campaign, FloatArray
from bayes_sensor.diagnosis.signals.lines import FASTER_THAN_BINS
from bayes_sensor.diagnosis.signals.periodograms import (
    HIGHEST_LINE,
    RATIOS,
    Piece,
    mains_bands,
    own_shapes,
    pieces_of_records,
)
from bayes_sensor.diagnosis.signals.signal import Finding, Samples, Signal, any_of, struck

LENGTHS = (2.5, 5.0, 10.0)
"""s, windows in which lines are looked for that pass, or that records have each for itself"""
BLOCK = 1e-3
"""s, means over which they are looked for"""
SLOWEST = 1.0
"""Hz; below, what passes is an event or a swing"""
CYCLES = 4.0
"""within a window; with fewer the slope of its spectrum looks like a line"""
BAND = 10.0
"""native resolutions of a window in which the spectrum of a record has a level of its own"""
ROUGHLY = 60
"""native resolutions that tell how loud a window is there"""
FEWEST = 12
"""windows of all records together below which the usual power is not known"""
MOST = 1000
"""windows that tell the usual power"""
LARGEST = 600.0
"""ln of a ratio of densities beyond which it is not told any more"""
LASTING = (0.3, 0.7, 1.5, 4.0)
"""plausible power of a line over the noise's where a whole record has it"""
INDEPENDENT = 0.95
"""share of overlapping windows that are independent"""
STRUCK = 0.3
"""plausible share of records that have such a line, where there are any"""


def look_for_transient_lines(
    campaign: Campaign, residuals: Sequence[FloatArray], deviations: Sequence[FloatArray]
) -> list[Finding]:
    """A line in some records, for a while or throughout, at one frequency or each at its own.

    Periodograms of
    overlapping windows of ``residuals`` (n_t,) V over the ``deviations`` (n_t,) V of the noise, in
    units of what is usual at their frequency, which a line or a resonance that all records have is
    part of, and of what the record and the window have around it, so that neither another memory
    nor a gust is a line.  ``ln B`` of a record averages over its windows what
    :func:`~bayes_sensor.diagnosis.signals.lines.look_for_lines` says of one, or takes all
    together; the records that are struck share the frequency, or have their own.
    """
    pieces = pieces_of_records(campaign, residuals, deviations)
    told = [_transient_line(pieces, seconds) for seconds in LENGTHS]
    found = [f for f in told if f is not None]
    return [any_of(found)] if found else []


def _transient_line(pieces: Sequence[Piece], seconds: float) -> Finding | None:
    """The finding from windows of ``seconds`` s; None where there are too few."""
    common = float(np.median([p.interval for p in pieces])) if pieces else 1.0
    size = max(1, round(BLOCK / common))
    dt = size * common
    n, step = round(seconds / dt), max(round(0.5 * seconds / dt), 1)
    if n * HIGHEST_LINE < CYCLES:  # no frequency is left between the slowest and the fastest
        return None
    used = [p for p in pieces if abs(p.interval - common) < 1e-9 * common]
    counts = [max((len(p.samples) // size - n) // step + 1, 0) for p in used]
    if sum(counts) < FEWEST:
        return None
    n_fft = 1 << int(np.ceil(np.log2(2 * n)))
    f = np.asarray(np.fft.rfftfreq(n_fft, dt))
    near = mains_bands(f, dt, 2.0 / seconds)[0]
    where = ~near & (f >= max(SLOWEST, CYCLES / seconds)) & (f <= HIGHEST_LINE / dt)
    if not where.any():
        return None
    weight = np.where(where, 1.0 / np.maximum(f, 1.0), 0.0)
    weight /= weight.sum()
    taper = windows.hann(n, sym=False)

    def spectra(p: Piece, thin: int = 1) -> FloatArray:
        scaled = p.samples * np.sqrt(p.weights)  # weights are those of the noise's variance
        means = scaled[: len(scaled) // size * size].reshape(-1, size).mean(axis=1)
        at = np.arange(0, max(len(means) - n + 1, 0), step)[::thin]
        windowed = means[at[:, None] + np.arange(n)] * taper
        return np.asarray(np.abs(np.fft.rfft(windowed, n_fft, axis=1)) ** 2)

    thin = 1 + sum(counts) // MOST
    some = [spectra(p, thin) for p in used]
    middle = np.median(np.concatenate(some), axis=0) / np.log(2.0)
    usual = np.maximum(middle, gaussian_filter1d(middle, 4.0 * n_fft / n))
    usual = np.maximum(usual, 1e-300)
    records = sorted({p.record for p, count in zip(used, counts, strict=True) if count})
    members = [[i for i, p in enumerate(used) if p.record == record] for record in records]
    shapes = own_shapes(
        [np.concatenate([some[i] for i in here]) / usual for here in members],
        [n_fft / n] * len(members),
        BAND,
    )
    logs, best = [], (-np.inf, {"passing_experiment": 0.0, "passing_Hz": 0.0, "passing_V": 0.0})
    for record, here, shape in zip(records, members, shapes, strict=True):
        ratio = np.concatenate([some[i] if thin == 1 else spectra(used[i]) for i in here])
        ratio /= usual * np.maximum(shape, 1.0)
        ratio /= np.maximum(_roughly(ratio, round(ROUGHLY * n_fft / n)), 1.0)
        own = _once_or_throughout(ratio)
        logs.append(own)
        peak = int(np.argmax(np.where(where, own + np.log(np.maximum(weight, 1e-300)), -np.inf)))
        if own[peak] > best[0]:
            there = ratio[:, peak][ratio[:, peak] > 0.5 * float(ratio[:, peak].max())]
            power = max(float(there.mean()) - 1.0, 0.0) * float(usual[peak])
            scale = np.mean(np.sqrt(np.concatenate([used[i].weights for i in here])))
            volts = 2.0 * sqrt(power) / float(taper.sum() * scale)
            at = {"passing_Hz": float(f[peak]), "passing_V": volts}
            best = (float(own[peak]), {"passing_experiment": float(record), **at})
    each = np.array(logs)
    alike = float(logsumexp(struck(each, STRUCK).sum(axis=0), b=weight))
    alone = float(struck(logsumexp(each, b=weight, axis=1), STRUCK).sum())
    value = float(np.logaddexp(alike, alone) - np.log(2.0))
    return Finding(SIGNAL, value, best[1], None)


def _roughly(ratio: FloatArray, size: int) -> FloatArray:
    """(n, n_f) level of each ``ratio`` (n, n_f) of power around a frequency, blind to lines."""
    n_blocks = max(ratio.shape[1] // size, 1)
    blocks = ratio[:, : n_blocks * size].reshape(len(ratio), n_blocks, -1)
    middles = np.median(blocks, axis=2) / np.log(2.0)
    centres = (np.arange(n_blocks) + 0.5) * blocks.shape[2]
    at = np.arange(ratio.shape[1])
    return np.array([np.interp(at, centres, own) for own in middles])


def _once_or_throughout(ratio: FloatArray) -> FloatArray:
    """(n_f,) ln B of a record with a line in one of its windows, or in all of them.

    From the ratios (n_windows, n_f) of its power to the usual.
    """
    once = np.zeros_like(ratio)
    for c in RATIOS:  # far beyond what any noise gives nothing is gained by the exact number
        once += np.exp(np.minimum(ratio * (c / (1.0 + c)), LARGEST)) / (1.0 + c)
    passing = np.log(np.mean(once, axis=0) / len(RATIOS))
    lasts = np.array(LASTING)[:, None]
    total, k = INDEPENDENT * ratio.sum(axis=0), INDEPENDENT * len(ratio)
    lasting = logsumexp(total * lasts / (1.0 + lasts) - k * np.log1p(lasts), axis=0)
    return np.asarray(np.logaddexp(passing, lasting - np.log(len(lasts))) - np.log(2.0))


def _words(found: Finding, names: Sequence[str], unit: str) -> str:
    s = found.strength
    return (
        f"In experiment {names[int(s['passing_experiment'])]} there is, for a while or "
        f"throughout, a line at {s['passing_Hz']:.4g} Hz that others lack, with an amplitude "
        f"of {1e3 * s['passing_V']:.3g} m{unit}."
    )


def _look(samples: Samples) -> list[Finding]:
    return look_for_transient_lines(samples.campaign, samples.residuals, samples.deviations)


SIGNAL = Signal(
    "passing", 0.02, {"passing_V": "V", "passing_Hz": "Hz"}, _words, _look,
    spares_means_from_hz=FASTER_THAN_BINS, by_frequency=True,
)  # fmt: skip
