"""Stationary block bootstrap of the residuals, every resample refitted by least squares.

Blocks of geometric length wrap around each experiment's series (Politis and Romano, J. Amer.
Statist. Assoc. 89, 1994); their mean length follows from the series (Politis and White, Econometric
Reviews 23, 2004, with the correction of Patton, Politis and White, ibid. 28, 2009).  By default the
series are the AR(1) innovations of the standardised residuals, coloured again afterwards.

A resample enters least squares through its sums at the mesh nodes, so a refit needs no pass over
the samples.
"""

from __future__ import annotations

import copy
from dataclasses import dataclass
from math import ceil, log, log10, sqrt
from typing import Any

import numpy as np
from numpy.typing import NDArray

from bayes_sensor.bounds.bound import LEVELS, Bound
from bayes_sensor.bounds.context import Evidence
from bayes_sensor.bounds.gaussian_intervals import gaussian_bound
from bayes_sensor.bounds.likelihood_surface import Surface, curvature_along_tau, maximise
from bayes_sensor.bounds.methods.bound_method import BoundMethod
from bayes_sensor.campaign import CampaignError, FloatArray
from bayes_sensor.compiled import compiled
from bayes_sensor.likelihood.density import mean_and_variance
from bayes_sensor.likelihood.mesh import K, compress, lagrange
from bayes_sensor.likelihood.noise import lag_coefficient
from bayes_sensor.likelihood.problem import Problem

IntArray = NDArray[np.int64]
LEAST_TAIL = 5
"""resamples that must lie beyond an end of an interval for the end to be estimated from them"""
MOST_FAILED = 0.25
"""share of refits that may fail to converge; with more their spread is not used"""


# --------------------------------------------------------------------------- block length


def optimal_block_length(x: FloatArray) -> float:
    """Mean block length of the stationary bootstrap for the mean of a series ``x`` (n,).

    (2 G^2 / D)^(1/3) n^(1/3), G = sum lambda(k/M) |k| R(k), D = 2 (sum lambda(k/M) R(k))^2, with
    the flat-top window lambda and M twice the lag after which correlations are negligible.
    """
    x = np.asarray(x, dtype=float)
    n = len(x)
    x = x - x.mean()
    k_n = max(5, ceil(sqrt(log10(n))))
    m_max = min(ceil(sqrt(n)) + k_n, n - 1)
    size = 1 << (n + m_max).bit_length()
    spectrum = np.abs(np.fft.rfft(x, size)) ** 2
    R = np.fft.irfft(spectrum, size)[: m_max + 1] / n
    if R[0] <= 0:
        return 1.0
    threshold = 2.0 * sqrt(log10(n) / n)
    small = np.abs(R[1:] / R[0]) < threshold
    m = 0
    for start in range(len(small) - k_n + 1):
        if small[start : start + k_n].all():
            m = start
            break
    else:
        m = int(np.flatnonzero(~small)[-1]) + 1 if (~small).any() else 1
    M = min(2 * max(m, 1), m_max)
    k = np.arange(1, M + 1)
    window = np.minimum(1.0, 2.0 * (1.0 - k / M))
    G = 2.0 * np.sum(window * k * R[1 : M + 1])
    g = R[0] + 2.0 * np.sum(window * R[1 : M + 1])
    if g <= 0 or G == 0:
        return 1.0
    length = (2.0 * G**2 / (2.0 * g**2)) ** (1.0 / 3.0) * n ** (1.0 / 3.0)
    return float(np.clip(length, 1.0, ceil(min(3.0 * sqrt(n), n / 3.0))))


# --------------------------------------------------------------------------- kernels


@compiled()
def _indices(n_out: int, n: int, length: float, rng: np.random.Generator, out: IntArray) -> None:
    # positions in a series of n, in blocks of geometric length that wrap around
    stays = 1.0 - 1.0 / length if length > 1.0 else 0.0
    log_stays = log(stays) if stays > 0.0 else 0.0
    left = 0
    at = 0
    for i in range(n_out):
        if left == 0:
            at = int(rng.random() * n)
            left = 1
            if stays > 0.8:
                left += int(log(1.0 - rng.random()) / log_stays)
            elif stays > 0.0:
                # the same whole number, counted: for short blocks faster than a logarithm
                rest, power = 1.0 - rng.random(), stays
                while rest <= power:
                    left += 1
                    power *= stays
        elif at == n:
            at = 0
        out[i] = at
        at += 1
        left -= 1
        if at == n:
            at = 0


@compiled()
def _recolour(
    index: IntArray,
    e: FloatArray,
    scale: FloatArray,
    runs: IntArray,
    across: FloatArray,
    phi: float,
    r: FloatArray,
) -> None:
    # r (n_t,) at used samples: scale times an AR(1) driven by the resampled innovations
    rest = sqrt(1.0 - phi * phi)
    z = 0.0
    j = 0
    for run in range(len(runs)):
        a, b = runs[run, 0], runs[run, 1]
        for i in range(a, b):
            innovation = e[index[j]]
            j += 1
            if i > a:
                z = phi * z + rest * innovation
            else:
                z = across[run] * z + sqrt(1.0 - across[run] ** 2) * innovation
            r[i] = scale[i] * z


@compiled()
def _to_nodes(
    r: FloatArray,
    start: IntArray,
    count: IntArray,
    kind: IntArray,
    coefficients: FloatArray,
    sums: FloatArray,
) -> None:
    # sums (n_blocks, K): filled with the Lagrange-weighted sums of r, from those weighted by powers
    # of the place u in the block, -1 .. 1; a table of weights would not fit the processor's cache
    moments = np.empty(K)
    for b in range(len(start)):
        for q in range(K):
            sums[b, q] = moments[q] = 0.0
        if kind[b] == 0:
            for i in range(count[b]):
                sums[b, i] = r[start[b] + i]
            continue
        width = 2.0 / (8 * 2 ** kind[b])
        for i in range(count[b]):
            u = (i + 0.5) * width - 1.0
            value = r[start[b] + i]
            for q in range(K):
                moments[q] += value
                value *= u
        for j in range(K):
            for q in range(K):
                sums[b, j] += coefficients[q, j] * moments[q]


def stationary_indices(
    n: int, length: float, rng: np.random.Generator, n_out: int | None = None
) -> np.ndarray:
    """(n_out,) positions 0 .. n - 1 of one stationary-bootstrap resample."""
    out = np.empty(n if n_out is None else n_out, dtype=np.int64)
    _indices(len(out), n, float(length), rng, out)
    return out


# --------------------------------------------------------------------------- resampling


@dataclass(frozen=True, eq=False)
class _Series:
    """One experiment's series to resample."""

    e: FloatArray
    scale: FloatArray
    phi: float
    across: FloatArray
    length: float


def residual_series(problem: Problem, vector: FloatArray, k: int, whitened: bool) -> _Series:
    """What is resampled of experiment number k: residuals in units of their noise, or whitened."""
    experiment = problem.campaign.experiments[k]
    mean, s2 = mean_and_variance(problem, vector, k)
    scale = np.sqrt(s2)
    z = (experiment.values - mean) / scale
    runs = experiment.even_runs
    across = np.zeros(len(runs))
    phi_reference = float(vector[problem.layout.noise[k, 0]])
    steps = problem.steps(experiment)
    phi = lag_coefficient(phi_reference, steps) if whitened else 0.0
    parts = []
    for i, (a, b) in enumerate(runs):
        part = z[a:b].copy()
        if i > 0 and whitened:
            across[i] = lag_coefficient(phi_reference, steps * float(experiment.pauses[i]))
            last = z[runs[i - 1, 1] - 1]
            part[0] = (part[0] - across[i] * last) / sqrt(1.0 - across[i] ** 2)
        part[1:] = (z[a + 1 : b] - phi * z[a : b - 1]) / sqrt(1.0 - phi**2)
        parts.append(part)
    e = np.concatenate(parts)
    e -= e.mean()
    return _Series(e, scale, phi, across, optimal_block_length(e))


def resample_and_refit(
    evidence: Evidence, n_resamples: int, whitened: bool = True
) -> tuple[FloatArray, FloatArray, dict[str, Any]]:
    """Least-squares psi of every resample: (n, n_psi) with tau^2 >= 0, the same as if it could be
    negative, and what happened (block lengths, failures)."""
    problem, white = evidence.problem, evidence.white
    theta = white.coordinates.theta(evidence.psi_white)
    compressed = copy.copy(compress(white.problem, theta, white.compressed.region))
    compressed.arrays = compressed.arrays._replace(
        moments=compressed.arrays.moments.copy(), edge_y=compressed.arrays.edge_y.copy()
    )
    surface = Surface(compressed)
    mesh = compressed.arrays
    mesh.moments[1:] = 0.0
    node_sums = mesh.moments[1].reshape(-1, K)
    vector = theta.copy()
    noise = problem.layout.noise
    vector[noise] = evidence.theta[noise]
    # of the powers of u in the Lagrange weights
    u = np.cos(np.pi * (np.arange(K) + 0.5) / K)
    coefficients = np.linalg.solve(np.vander(u, K, increasing=True), lagrange(0.5 * (u + 1.0)))
    series, starts, counts, residuals = [], [], [], []
    ends, ends_of_mean = [], []  # of every run
    for k, e in enumerate(problem.campaign):
        series.append(residual_series(problem, vector, k, whitened))
        part = slice(mesh.blocks[k], mesh.blocks[k + 1])
        start = np.rint((mesh.base[part] - e.t[0]) / e.interval + 0.5).astype(np.int64)
        last = e.even_runs[np.searchsorted(e.even_runs[:, 0], start, side="right") - 1, 1]
        starts.append(start)
        counts.append(np.minimum(8 * 2 ** mesh.kind[part], last - start))
        ends.append(np.stack([e.even_runs[:, 0], e.even_runs[:, 1] - 1], axis=1))
        ends_of_mean.append(mean_and_variance(problem, vector, k)[0][ends[k]] - mesh.setting[k, 5])
        residuals.append(np.zeros(len(e.t)))
    curvature = curvature_along_tau(surface, evidence.psi_white)
    rng = np.random.default_rng(np.random.SeedSequence([evidence.seed, 71]))
    bounded = np.empty((n_resamples, len(evidence.psi_white)))
    free = np.empty_like(bounded)
    n_failed = 0
    # in units of the resamples' own spread, which correlation makes wider than iid noise would
    phi = float(np.abs(evidence.theta[noise[:, 0]]).max())
    unit = (1.0 + phi) / (1.0 - phi)
    for sample in range(n_resamples):
        for k, e in enumerate(problem.campaign):
            own = series[k]
            index = stationary_indices(len(own.e), own.length, rng)
            r = residuals[k]
            _recolour(index, own.e, own.scale, e.even_runs, own.across, own.phi, r)
            part = slice(mesh.blocks[k], mesh.blocks[k + 1])
            _to_nodes(r, starts[k], counts[k], mesh.kind[part], coefficients, node_sums[part])
            runs = slice(mesh.runs[k], mesh.runs[k + 1])
            mesh.edge_y[runs] = ends_of_mean[k] + r[ends[k]]
        found = maximise(
            surface.guarded, curvature, evidence.psi_white, surface.mean,
            *surface.box, tolerance=1e-5 * unit, settled=3e-4 * unit,
        )  # fmt: skip
        n_failed += not found.converged
        bounded[sample], free[sample] = found.psi, found.free
        if sample % 20 == 19:
            evidence.progress((sample + 1) / n_resamples, "block bootstrap")
    lengths = {e.name: own.length for e, own in zip(problem.campaign, series)}
    details: dict[str, Any] = {
        "n_resamples": n_resamples,
        "block_length_samples": lengths,
        "whitened": whitened,
        "n_failed": n_failed,
    }
    return bounded, free, details


def block_bootstrap(evidence: Evidence) -> Bound:
    """Percentile intervals of refitted resamples; normal ones in psi where resamples run out.

    Raises CampaignError for fewer than two resamples, which have no spread.
    """
    if evidence.n_resamples < 2:
        raise CampaignError(
            f"block_bootstrap: n_resamples is {evidence.n_resamples}; expected at least 2 to see a "
            "spread, and some hundred for ends of intervals: ask for more"
        )
    bounded, free, details = resample_and_refit(evidence, evidence.n_resamples)
    surface = evidence.white
    names = surface.mean_names
    cov = np.atleast_2d(np.cov(free[:, surface.mean], rowvar=False))
    n_failed = int(details["n_failed"])
    status = f"{n_failed} of {evidence.n_resamples} refits did not settle" if n_failed else ""
    _, identified = evidence.white_cov
    normal = gaussian_bound(
        names,
        evidence.estimate,
        cov,
        evidence.at_bound,
        identified=identified,
        status=status,
        details=details,
    )
    layout = surface.problem.layout
    floor = surface.floor[0] if surface.coordinates.shifts else -np.inf
    at_floor = bounded[:, 0] <= 1.001 * floor
    draws = surface.coordinates.theta(bounded)
    draws[at_floor, 0] = 0.0
    draws = draws[:, [layout.index(name) for name in names]]
    low, high, sd = normal.low.copy(), normal.high.copy(), draws.std(axis=0, ddof=1)
    for j, level in enumerate(LEVELS.values()):
        if 0.5 * (1.0 - level) * len(draws) >= LEAST_TAIL:
            low[:, j], high[:, j] = np.quantile(
                draws, [0.5 - 0.5 * level, 0.5 + 0.5 * level], axis=0
            )
        elif j:
            low[:, j] = np.minimum(low[:, j], low[:, j - 1])
            high[:, j] = np.maximum(high[:, j], high[:, j - 1])
    sd[np.isnan(normal.sd)] = np.nan
    # refits start at the fit: along a direction without information they would hardly move
    low[~identified], high[~identified] = np.nan, np.nan
    if n_failed > MOST_FAILED * evidence.n_resamples:
        # levels and steps settle at once, whatever becomes of the times
        slow = np.array([not name.startswith(("y0_V", "beta_V")) for name in names])
        sd[slow], low[slow], high[slow] = np.nan, np.nan, np.nan
    return Bound(names, normal.estimate, sd, low, high, normal.status, details)


METHOD = BoundMethod(
    name="block_bootstrap",
    label="block bootstrap",
    assumes="least squares; the AR(1) innovations of the standardised residuals can be exchanged "
    "in blocks",
    compute=block_bootstrap,
    reference="Politis and Romano (1994); Politis and White (2004); Patton, Politis and White "
    "(2009)",
    noise="residuals",
)
