"""Detector: a damped oscillation after the switches.

Stationary noise of *any* spectrum oscillates after the switches as much as elsewhere, and with
random phases.  The two tests look for more power after the switches, and for a common phase.  A
finding counts as an unlisted cause.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter1d
from scipy.special import logsumexp

from bayes_sensor.campaign import Campaign, FloatArray
from bayes_sensor.diagnosis.data.quiet_stretches import QuietSpans
from bayes_sensor.diagnosis.signals.signal import Finding, Samples, Signal, any_of

RINGING_BLOCK = 0.005
"""s"""
DAMPING = (0.15, 0.4, 1.0, 2.0)
"""s, times in which a ringing dies away"""
BEGINS = np.arange(-7, 8) * 0.05
"""s, when it may begin, from the fitted switch"""
RINGING_HZ = (3.5, 60.0)
RINGING_RATIOS = (0.5, 1.0, 2.5, 6.0, 15.0, 40.0)
TILT = 1.0
"""Hz, over which the slope of a spectrum may change from one window to the next"""
IN_PHASE_BLOCK = 0.01
"""s"""
FEWEST_SWITCHES = 6
IN_PHASE_HZ = (0.7, 25.0)
IN_PHASE_DAMPING = (0.4, 1.0, 2.5, 6.0)
"""s, of a ringing that has the same phase after every switch"""
IN_PHASE_BEGINS = (0.0, 0.3, 0.8, 1.5)
"""s after the fitted switch; later ones leave out a misfit of the rise itself"""
IN_PHASE_CYCLES = 1.2
"""within one damping time, below which an oscillation is only a misfit that fades"""
IN_PHASE_RATIOS = (4.0, 16.0, 64.0)
"""a common amplitude's plausible variance over that of its estimate"""
FEWEST_WINDOWS = 10
"""quiet windows below which the usual power at a frequency is not known"""


def look_for_ringing(
    campaign: Campaign, residuals: Sequence[FloatArray], quiet: Sequence[QuietSpans]
) -> Finding:
    """A damped oscillation that follows the switches, with one phase or with any."""
    return any_of([
        _ringing_of_any_phase(campaign, residuals, quiet),
        _ringing_in_phase(campaign, residuals, quiet),
    ])  # fmt: skip


def _ringing(logs: Sequence[float], frequency: float, power: float) -> Finding:
    """What the ``logs``, each ln B of one kind of window, say together."""
    if not logs:
        return Finding(SIGNAL, 0.0, {"ringing_Hz": 0.0}, None)
    value = float(np.logaddexp.reduce(logs) - np.log(len(logs)))
    return Finding(SIGNAL, value, {"ringing_Hz": frequency}, float(np.sqrt(2.0 * power)))


def _frequencies(length: int, dt: float) -> tuple[int, FloatArray]:
    """Length of the transform of a window of ``length`` samples, and its frequencies Hz."""
    n_fft = 1 << int(np.ceil(np.log2(2 * max(length, 2))))
    return n_fft, np.asarray(np.fft.rfftfreq(n_fft, dt))


def _ringing_of_any_phase(
    campaign: Campaign, residuals: Sequence[FloatArray], quiet: Sequence[QuietSpans]
) -> Finding:
    """A damped oscillation after the switches, of any phase.

    Exponentially fading windows that begin near the switches, Fourier transformed; their power
    over that of the same windows in the quiet spans is exponential under noise of any spectrum
    and ``1 + c`` times as large on average with a ringing of any phase.
    """
    records = []
    for e, r, q in zip(campaign, residuals, quiet, strict=True):
        size = max(1, round(RINGING_BLOCK / e.interval))
        n = len(r) // size
        y = (r / q.deviation)[: n * size].reshape(n, size).mean(axis=1)
        dt = size * e.interval
        # what is slower than the slowest ringing is the model's misfit
        smooth = gaussian_filter1d(y, 0.28 / RINGING_HZ[0] / dt, mode="nearest")
        records.append((y - smooth, dt, float(e.t[0])))
    steps = {round(dt, 9) for _, dt, _ in records}
    if len(steps) != 1:
        return _ringing([], 0.0, 0.0)
    dt = records[0][1]
    logs: list[float] = []
    best, frequency, power = -np.inf, 0.0, 0.0
    for damping in DAMPING:
        length = round(3.0 * damping / dt)
        n_fft, f = _frequencies(length, dt)
        keep = (f >= RINGING_HZ[0]) & (f <= min(RINGING_HZ[1], 0.45 / dt))
        if int(keep.sum()) < 3:
            continue
        fading = np.exp(-np.arange(length) * dt / damping)
        fading /= np.sqrt(np.sum(fading**2))

        def spectra(
            y: FloatArray,
            at: NDArray[np.int64],
            w: FloatArray = fading,
            n: int = n_fft,
            keep: NDArray[np.bool_] = keep,
        ) -> FloatArray:
            at = at[(at >= 0) & (at + len(w) <= len(y))]
            windows = y[at[:, None] + np.arange(len(w))] * w
            return np.asarray(np.abs(np.fft.rfft(windows, n, axis=1)[:, keep]) ** 2)

        usual = []
        for (y, _, begin), q in zip(records, quiet, strict=True):
            for low, high in q.spans:
                last = (high - begin) / dt - length
                at = np.arange((low - begin) / dt, last, max(1.0, 2.0 * damping / dt))
                usual.append(spectra(y, at.astype(np.int64)))
        n_usual = sum(len(u) for u in usual)
        if n_usual < FEWEST_WINDOWS:
            continue
        # smoothed within the windows' own resolution only: a resonance of the noise stays one
        native = 0.25 / (np.pi * damping) / float(f[1])
        powers = np.concatenate(usual)
        level = np.maximum(gaussian_filter1d(powers.mean(axis=0), native), 1e-300)
        wild = _wildness(_over_its_median(powers / level), TILT / float(f[1]))
        for begins in BEGINS:
            made = [
                spectra(y, np.rint((np.array(q.switches) + begins - t0) / dt).astype(np.int64))
                for (y, _, t0), q in zip(records, quiet, strict=True)
            ]
            ratio = _over_its_median(np.concatenate(made) / level)
            if len(ratio) == 0:
                continue
            # windows whose power varies more than by chance say as much as fewer of them
            total = ratio.sum(axis=0) / wild
            k, rest = len(ratio) / wild, n_usual / wild
            c = np.array(RINGING_RATIOS)[:, None]
            # ratio of F densities: the usual power is a mean over windows, too
            usually = np.log1p(total / rest) - np.log1p(total / rest / (1.0 + c))
            each = np.logaddexp.reduce((k + rest) * usually - k * np.log1p(c), axis=0)
            each = each - np.log(len(RINGING_RATIOS))
            logs.append(float(np.logaddexp.reduce(each) - np.log(len(each))))
            if logs[-1] > best:
                best, peak = logs[-1], int(np.argmax(each))
                frequency = float(f[keep][peak])
                power = max(float(wild[peak] * (total[peak] - k[peak])), 0.0)
    return _ringing(logs, frequency, power)


def _wildness(ratio: FloatArray, smooth: float) -> FloatArray:
    """(n_f,) variance of power ``ratio`` (n, n_f) over that of exponential ordinates, at least one.

    ``smooth``: ordinates over which it is averaged.
    """
    first, second = (gaussian_filter1d(np.mean(ratio**p, axis=0), smooth) for p in (1, 2))
    return np.asarray(np.maximum(second / np.maximum(first, 1e-300) ** 2 - 1.0, 1.0))


def _over_its_median(ratio: FloatArray) -> FloatArray:
    """``ratio`` (n, n_f) of power: what is stronger for a while is so at all frequencies."""
    return np.asarray(
        ratio / np.maximum(np.median(ratio, axis=1, keepdims=True) / np.log(2.0), 0.3)
    )


def _ringing_in_phase(
    campaign: Campaign, residuals: Sequence[FloatArray], quiet: Sequence[QuietSpans]
) -> Finding:
    """A damped oscillation with one phase after all switches of all records.

    What swings because the valve has moved (a bench, a bubbler's water, a pressure controller)
    starts anew with every switch.  The Fourier amplitudes ``x_k`` of fading windows are added up
    with weights ``a_k``, the oscillation's size there; the power of the sum over that of the noise
    at frequencies beside is exponential without ringing and ``1 + g`` times as large on average
    with it.  The size is the same in volts or that of the step, with the same sign after opening
    and shutting or the other.  A misfit in phase at all frequencies is the model's own, and is
    divided out.
    """
    records = []
    for e, r, q in zip(campaign, residuals, quiet, strict=True):
        size = max(1, round(IN_PHASE_BLOCK / e.interval))
        n = len(r) // size
        y, deviation = (
            v[: n * size].reshape(n, size).mean(axis=1) for v in (r, np.asarray(q.deviation))
        )
        dt = size * e.interval
        smooth = gaussian_filter1d(y, 0.28 / IN_PHASE_HZ[0] / dt, mode="nearest")
        records.append(((y - smooth) / deviation, deviation, dt, float(e.t[0])))
    steps = {round(dt, 9) for _, _, dt, _ in records}
    if len(steps) != 1:
        return _ringing([], 0.0, 0.0)
    dt = records[0][2]
    logs: list[float] = []
    best, frequency, power = -np.inf, 0.0, 0.0
    for damping in IN_PHASE_DAMPING:
        length = round(2.0 * damping / dt)
        n_fft, f = _frequencies(length, dt)
        lowest = max(IN_PHASE_HZ[0], IN_PHASE_CYCLES / damping)
        keep = (f >= lowest) & (f <= min(IN_PHASE_HZ[1], 0.45 / dt))
        beside = np.rint(np.array([1.0, 4.0]) / (2.0 * damping) / float(f[1])).astype(np.int64)
        if int(keep.sum()) < 8 or 2 * beside[1] + 1 > len(f):
            continue
        weight = keep / np.maximum(f, IN_PHASE_HZ[0])  # even in ln f
        fading = np.exp(-np.arange(length) * dt / damping)
        for begins in IN_PHASE_BEGINS:
            amplitudes, sizes = [], []
            for (y, deviation, _, t0), q in zip(records, quiet, strict=True):
                ends = [*q.switches[1:], np.inf]
                for which, (switch, end) in enumerate(zip(q.switches, ends, strict=True)):
                    at = round((switch + begins - t0) / dt)
                    last = min(at + length, len(y), int(min((end - t0) / dt, 1e9)))
                    if at < 0 or last - at < 0.7 * length:
                        continue
                    spectrum = np.fft.rfft(y[at:last] * fading[: last - at], n_fft)
                    amplitudes.append(spectrum)
                    volts = 1.0 / float(deviation[at])
                    sizes.append((volts, q.step * volts, -1.0 if which else 1.0))
            if len(amplitudes) < FEWEST_SWITCHES:
                continue
            x, (volts_, steps_, signs) = np.array(amplitudes), np.array(sizes).T
            for a in (volts_, steps_, volts_ * signs, steps_ * signs):
                if not a.any():
                    continue
                value, at_f, found = _in_phase(x, a, beside, weight)
                logs.append(value)
                if value > best:
                    best, frequency, power = value, float(f[at_f]), found
    return _ringing(logs, frequency, power)


def _in_phase(
    x: NDArray[np.complex128], a: FloatArray, beside: NDArray[np.int64], weight: FloatArray
) -> tuple[float, int, float]:
    """ln B of one amplitude for all windows, averaged over frequency, where it is largest.

    ``x`` (K, n_f), ``a`` (K,), ``weight`` (n_f,) of the frequencies; ``beside``: how many
    ordinates away the noise is looked at, which is no smaller than what does not add up here.
    """
    k, n_f = x.shape
    kernel = np.zeros(2 * beside[1] + 1)
    kernel[: beside[1] - beside[0] + 1] = kernel[beside[1] + beside[0] :] = 1.0
    usual = np.mean(np.abs(x) ** 2, axis=0)
    level = np.convolve(usual, kernel, "same") / np.convolve(np.ones(n_f), kernel, "same")
    added = np.abs(a @ x) ** 2 / np.sum(a**2)
    level = np.maximum(level, (k * usual - added) / (k - 1))
    where = np.flatnonzero(weight)
    power = added[where] / np.maximum(level[where], 1e-300)
    power /= max(float(np.median(power)) / np.log(2.0), 1.0)
    g = np.array(IN_PHASE_RATIOS)[:, None]
    n = 4.0 * k  # ordinates that the level rests on, as far as they are independent
    usually = np.log1p(power / n) - np.log1p(power / n / (1.0 + g))
    each = np.logaddexp.reduce((1.0 + n) * usually - np.log1p(g), axis=0) - np.log(len(g))
    peak = int(np.argmax(each))
    value = float(logsumexp(each, b=weight[where] / np.sum(weight)))
    return value, int(where[peak]), float(power[peak])


def _words(found: Finding, names: Sequence[str], unit: str) -> str:
    return f"After the switches the signal rings at about {found.strength['ringing_Hz']:.3g} Hz."


def _look(samples: Samples) -> list[Finding]:
    return [look_for_ringing(samples.campaign, samples.residuals, samples.quiet)]


SIGNAL = Signal("ringing", 0.01, {"ringing_Hz": "Hz"}, _words, _look, by_frequency=True)
