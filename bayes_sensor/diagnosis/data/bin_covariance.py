"""The covariance of means over bins, from the noise's spectra and from the converter's rounding."""

from __future__ import annotations

import numpy as np

from bayes_sensor.campaign import Experiment, FloatArray
from bayes_sensor.diagnosis.data.bins import ExperimentBins
from bayes_sensor.diagnosis.data.noise_memory import Shape
from bayes_sensor.residuals.converter_step import lattice_step

LAGS_PER_BIN = 24.0
"""lags of the covariance within the shortest bin"""


def rounding_bias(
    e: Experiment, bins: ExperimentBins, edges: FloatArray, density: FloatArray, fit: FloatArray
) -> FloatArray | None:
    """(n_bins, m) V, factor of the covariance that rounding to a converter's step gives bin means.

    Gaussian noise of standard deviation sigma around y rounds, on average, to y plus
    sum_m (-1)^m step/(pi m) exp(-2 (pi m sigma/step)^2) sin(2 pi m y/step): nothing where the
    noise crosses several steps, a bias that follows the signal where it does not (Widrow, Kollar
    and Liu 1996).  The phase is taken for unknown.  None where the bias is negligible.  ``density``
    (2, n_bands) V^2/Hz is that of the record, which holds the step^2/12 that rounding adds.
    """
    step = lattice_step(e.values[e.used])
    if step <= 0.0:
        return None
    recorded = float(np.min(density @ np.diff(edges)))
    sigma = float(np.sqrt(max(recorded - step**2 / 12.0, 0.01 * recorded)))
    columns = []
    for m in (1, 2, 3):
        size = step / (np.pi * m) * np.exp(-2.0 * (np.pi * m * sigma / step) ** 2)
        if size > 1e-3 * sigma:
            angle = 2.0 * np.pi * m * fit / step
            columns += [size * bins.average(np.cos(angle)), size * bins.average(np.sin(angle))]
    return np.column_stack(columns) / np.sqrt(2.0) if columns else None


def bin_cholesky(
    e: Experiment,
    bins: ExperimentBins,
    edges: FloatArray,
    density: FloatArray,
    level: FloatArray,
    shape: Shape,
    extra: FloatArray | None = None,
) -> FloatArray:
    """Lower factor (n_bins, n_bins) of the covariance of bin means of one experiment.

    ``extra`` (n_bins, m) V: factor of what is added to it.
    """
    # lags are needed on a grid that is fine beside the shortest bin only; the bins' ends are moved
    # onto it, so that what follows is the covariance of a real process and positive definite
    shortest = float(np.min(bins.count)) * e.interval
    step = e.interval * max(1, int(shortest / (LAGS_PER_BIN * e.interval)))
    n = 1 << int(np.ceil(np.log2(2.2 * len(e.t) * e.interval / step)))
    f = np.asarray(np.fft.rfftfreq(n, step), dtype=float)
    low = _density_at(f, edges, density[0], shape)
    high = _density_at(f, edges, density[1], shape)
    a = np.rint(bins.first * e.interval / step).astype(np.int64)
    b = np.maximum(np.rint(bins.last * e.interval / step).astype(np.int64), a + 1)
    index = [np.abs(np.subtract.outer(p, q)) for p, q in ((b, a), (a, b), (b, b), (a, a))]
    norm = np.outer(b - a, b - a)

    def covariance(spectrum: FloatArray) -> FloatArray:
        # G with second differences equal to the autocovariance: then
        # cov(mean over [a, b), mean over [c, d)) n m = G(b - c) + G(a - d) - G(b - d) - G(a - c)
        gamma = np.fft.irfft(spectrum, n)[: n // 2] / (2.0 * step)
        slope = np.cumsum(gamma) - 0.5 * gamma[0]
        second = np.concatenate([[0.0], np.cumsum(slope)])
        made = second[index[0]] + second[index[1]] - second[index[2]] - second[index[3]]
        return np.asarray(made / norm, dtype=float)

    level = np.clip(level, 0.0, 1.0)
    ratio = max(
        float(np.sum(density[1] * np.diff(edges)) / np.sum(density[0] * np.diff(edges))), 1e-6
    )
    if abs(ratio - 1.0) < 1e-6:
        w = level
    else:
        w = (np.sqrt(1.0 - level + level * ratio) - 1.0) / (np.sqrt(ratio) - 1.0)
    total = (
        np.outer(1.0 - w, 1.0 - w) * covariance(low)
        + np.outer(w, w) * covariance(high)
        + (np.outer(1.0 - w, w) + np.outer(w, 1.0 - w)) * covariance(np.sqrt(low * high))
    )
    # white beyond the grid of lags: what single samples keep of it
    total = 0.5 * (total + total.T)
    floor = np.maximum(np.diag(total), 0.0)
    white = _white_variance(e, edges, density, w) / bins.count
    total[np.diag_indices_from(total)] = np.maximum(floor, white)
    if extra is not None:
        total += extra @ extra.T
    # rounding alone may take the smallest eigenvalue below zero
    total[np.diag_indices_from(total)] *= 1.0 + 1e-9
    return np.asarray(np.linalg.cholesky(total), dtype=float)


def _white_variance(
    e: Experiment, edges: FloatArray, density: FloatArray, w: FloatArray
) -> FloatArray:
    # variance of one sample if its spectrum were flat at the level of the highest band: a bin of
    # n samples cannot do better than this over n
    top = 0.5 / e.interval
    band = min(max(int(np.searchsorted(edges, top)) - 2, 0), density.shape[1] - 1)
    root: FloatArray = (1.0 - w) * np.sqrt(density[0, band]) + w * np.sqrt(density[1, band])
    return 0.5 * root**2 * top


def _density_at(f: FloatArray, edges: FloatArray, density: FloatArray, shape: Shape) -> FloatArray:
    """One-sided density (n_f,) V^2/Hz, in log frequency between the bands' centres.

    Below the first band it grows as 1/f as far as the first band exceeds those at .5-4 Hz, by at
    most a factor of nine, or as noise of this ``shape`` does, where that is more.
    """
    centre = np.sqrt(edges[:-1] * edges[1:])
    logs = np.log(np.maximum(f, 1e-12))
    made = np.exp(np.interp(logs, np.log(centre), np.log(density)))
    low = f < edges[0]
    if low.any():
        mid = (centre > 0.5) & (centre < 4.0)
        above = float(density[0] - np.mean(density[mid])) if mid.any() else 0.0
        lowest = 0.5 * f[1] if len(f) > 1 else 1e-9  # the constant stands for half a spacing
        grow = np.clip(edges[0] / np.maximum(f[low], lowest) - 1.0, 0.0, 8.0)
        made[low] = density[0] + max(above, 0.0) * grow
        as_shaped = shape(np.maximum(f[low], lowest)) / shape(centre[:1])
        made[low] = np.maximum(made[low], density[0] * as_shaped)
    return made
