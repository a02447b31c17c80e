"""The noise floor, estimated without the model, and what it means for means over bins.

Quiet stretches - baseline, plateau, tail - are detrended and their spectra averaged in bands,
separately for the carrier gas alone and for the plateaus.  The covariance of bin means follows
from these spectra, not from an AR(1) law: a little slow noise under fast noise makes an AR(1)
floor far too low where an effect would show.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import solve_triangular

from bayes_sensor.campaign import Campaign, CampaignError, FloatArray
from bayes_sensor.diagnosis.data.bin_covariance import bin_cholesky, rounding_bias
from bayes_sensor.diagnosis.data.bins import ExperimentBins
from bayes_sensor.diagnosis.data.loudness import loudness, plateau_over_carrier
from bayes_sensor.diagnosis.data.noise_memory import (
    ar1_shape,
    check_memory,
    common_correlation,
    like_a_walk,
    own_memory,
)
from bayes_sensor.diagnosis.data.quiet_stretches import (
    Stretch,
    detrended,
    periodogram,
)

SHRINK = 20.0
"""degrees of freedom of the neighbouring band, or of the common shape, in a band's estimate"""
DOF, LEAST_DOF = 60.0, 4.0
"""degrees of freedom of the floor's level, at most and at least: evidences use a t law with so
many"""


@dataclass(frozen=True, eq=False)
class NoiseFloor:
    """Spectral densities of the noise per experiment and level, and the bins' covariance."""

    edges: FloatArray
    """(n_bands + 1,) Hz"""
    density: FloatArray
    """(n_experiments, 2, n_bands) V^2/Hz, one-sided, at carrier and plateau"""
    dof: FloatArray
    """(n_bands,) degrees of freedom of each band"""
    cholesky: tuple[FloatArray, ...]
    """(n_bins, n_bins) V, lower factor of each experiment's covariance of bin means"""
    spikes: int
    """samples replaced"""
    loudness: tuple[FloatArray, ...]
    """(n_bins,) of each experiment: times by which its noise is louder there than usual, or one"""
    level_dof: float = DOF
    """degrees of freedom of the floor's level"""

    def whiten(self, k: int, values: FloatArray) -> FloatArray:
        """Bin values (n_bins,) or (n_bins, m) of experiment ``k`` in standard deviations."""
        e: FloatArray = solve_triangular(self.cholesky[k], values, lower=True, check_finite=False)
        return e

    def deviation(self, k: int) -> FloatArray:
        """(n_bins,) V, standard deviation of each bin mean of experiment ``k``."""
        deviation: FloatArray = np.sqrt(np.sum(self.cholesky[k] ** 2, axis=1))
        return deviation

    def rms(self) -> float:
        """V, of the noise itself, averaged over experiments and levels."""
        width = np.diff(self.edges)
        return float(np.sqrt(np.mean(self.density @ width)))


def band_edges(campaign: Campaign, stretches: Sequence[Stretch]) -> FloatArray:
    """Octave bands from what the longest stretch resolves to half the sampling rate, Hz."""
    longest = max(len(s.samples) * campaign.experiments[s.experiment].interval for s in stretches)
    top = 0.5 / min(e.interval for e in campaign)
    low = 3.0 / longest
    n = max(int(np.ceil(np.log2(top / low))), 1)
    return np.asarray(top / 2.0 ** np.arange(n, -1, -1), dtype=float)


def estimate_floor(
    campaign: Campaign,
    residuals: Sequence[FloatArray],
    bins: Sequence[ExperimentBins],
    stretches: Sequence[Stretch],
    level_of_bins: Sequence[FloatArray],
    spikes: int = 0,
    fits: Sequence[FloatArray] | None = None,
) -> NoiseFloor:
    """The floor of a campaign from the residuals (n_t,) V of its fit and their quiet stretches.

    ``level_of_bins``: the normalised concentration (n_bins,) in 0..1 of every bin.  ``fits``
    (n_t,) V: the fitted means, for the bias of a coarse converter's rounding.

    Raises
    ------
    CampaignError
        If no stretch of any record is quiet and long enough, or the noise outlasts them all.
    """
    if not stretches:
        raise CampaignError(
            "gap: no stretch of 24 samples lies outside the switching, so that the noise floor "
            "cannot be estimated; expected a baseline or a plateau: record longer"
        )
    edges = band_edges(campaign, stretches)
    n_e, n_b = len(campaign), len(edges) - 1
    power = np.zeros((n_e, 2, n_b))
    count = np.zeros((n_e, 2, n_b))
    intervals = [campaign.experiments[s.experiment].interval for s in stretches]
    noises = [detrended(s.samples) for s in stretches]
    for s, h, noise in zip(stretches, intervals, noises, strict=True):
        f, p = periodogram(noise, h)
        keep = f >= 1.6 / (len(s.samples) * h)
        band = np.searchsorted(edges, f[keep], side="right") - 1
        inside = (band >= 0) & (band < n_b)
        np.add.at(power[s.experiment, s.level], band[inside], p[keep][inside])
        np.add.at(count[s.experiment, s.level], band[inside], 1.0)
    missing = len({s.level for s in stretches}) < 2
    louder = plateau_over_carrier(campaign, residuals, bins, level_of_bins) if missing else 1.0
    check_memory(noises)
    shape = ar1_shape(noises, intervals)
    below = shape if like_a_walk(noises) else np.ones_like
    middles = np.sqrt(edges[:-1] * edges[1:])
    density, dof = _shrunk(power, count, edges, shape(middles), louder)
    own = density * own_memory(campaign, stretches, noises, middles, count)
    width = np.diff(edges)
    density = own * ((density @ width) / (own @ width))[:, :, None]  # as loud as before
    louder_bins = tuple(
        loudness(e, r, b, level)
        for e, r, b, level in zip(campaign, residuals, bins, level_of_bins, strict=True)
    )
    factors = tuple(
        louder_bins[k][:, None] * bin_cholesky(
            e, b, edges, density[k], level, below,
            None if fits is None else rounding_bias(e, b, edges, density[k], fits[k]),
        )
        for k, (e, b, level) in enumerate(zip(campaign, bins, level_of_bins, strict=True))
    )  # fmt: skip
    return NoiseFloor(edges, density, dof, factors, spikes, louder_bins, _level_dof(noises))


def _level_dof(noises: Sequence[FloatArray]) -> float:
    """Degrees of freedom of the floor's level: of an AR(1)'s samples, less a parabola's each.

    At most :data:`DOF`, as if so many samples had told it: noise of one record is not quite that of
    the next.
    """
    phi = common_correlation(noises)
    independent = (1.0 - phi) / (1.0 + phi) * sum(len(x) for x in noises) - 3.0 * len(noises)
    return float(min(DOF, max(independent, LEAST_DOF)))


def _shrunk(
    power: FloatArray,
    count: FloatArray,
    edges: FloatArray,
    correlated: FloatArray,
    louder: float,
) -> tuple[FloatArray, FloatArray]:
    """Densities (n_e, 2, n_b): a level per experiment, a spectral shape per level.

    The shape of a level is pooled over experiments; where a band holds few ordinates it leans on
    the common shape of both levels, and below a few hertz on the band above it, as a noise
    ``correlated`` (n_b,) from sample to sample continues from there.  Where one level has no
    quiet stretch, the plateaus are ``louder`` than the carrier by this factor.
    """
    n_e, _, n_b = power.shape
    width = np.diff(edges)
    # scale of each experiment and level: broad-band, where ordinates abound
    seen = count.sum(axis=2)
    mean = np.divide(power, count, out=np.zeros_like(power), where=count > 0)
    pooled = power.sum(axis=(0, 1)) / np.maximum(count.sum(axis=(0, 1)), 1.0)
    pooled = _filled(pooled, count.sum(axis=(0, 1)) > 0)
    scale = np.ones((n_e, 2))
    for k in range(n_e):
        for level in range(2):
            if seen[k, level] > 0:
                have = count[k, level] > 0
                scale[k, level] = np.sum((mean[k, level] * width)[have]) / np.sum(
                    (pooled * width)[have]
                )
    for level in range(2):  # a level that a record lacks: as in the others
        have = seen[:, level] > 0
        if not have.any():
            scale[:, level] = scale[:, 1 - level] * (louder if level else 1.0 / louder)
        elif not have.all():
            scale[~have, level] = np.mean(scale[have, level])
    scale = np.maximum(scale, 1e-12)
    relative = power / scale[:, :, None]
    n_all = count.sum(axis=(0, 1))
    common = _filled(relative.sum(axis=(0, 1)) / np.maximum(n_all, 1.0), n_all > 0)
    common = _lean_down(common, n_all, edges, correlated)
    shapes = np.empty((2, n_b))
    for level in range(2):
        n_l = count[:, level].sum(axis=0)
        own = relative[:, level].sum(axis=0) / np.maximum(n_l, 1.0)
        shapes[level] = (n_l * own + SHRINK * common) / (n_l + SHRINK)
    density = np.maximum(scale[:, :, None] * shapes[None], 1e-300)
    return density, np.maximum(n_all, 1.0) * 2.0


def _filled(values: FloatArray, have: NDArray[np.bool_]) -> FloatArray:
    index = np.arange(len(values))
    return np.interp(index, index[have], values[have]) if have.any() else np.ones_like(values)


def _lean_down(
    common: FloatArray, count: FloatArray, edges: FloatArray, correlated: FloatArray
) -> FloatArray:
    out = common.copy()
    for b in range(len(out) - 2, -1, -1):
        if edges[b + 1] <= 8.0:
            expected = out[b + 1] * correlated[b] / correlated[b + 1]
            out[b] = (count[b] * common[b] + SHRINK * expected) / (count[b] + SHRINK)
    return out
