"""Building the mesh of a campaign: where blocks begin, how wide they are, what they store."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from itertools import product
from math import exp, pi

import numpy as np

from bayes_sensor.campaign import Experiment, FloatArray
from bayes_sensor.compiled import compiled
from bayes_sensor.likelihood.density import mean_and_response, mean_on_grid
from bayes_sensor.likelihood.mesh.mesh_arrays import CHEBYSHEV, Arrays, K
from bayes_sensor.likelihood.noise import scale_squared
from bayes_sensor.likelihood.problem import Problem
from bayes_sensor.rig.layout import Layout

# Interpolation tolerance for a decaying exponential of unit amplitude, set by the measured error
# of the likelihood.
TOLERANCE = 1e-7
# Widest block, in slowest time constants, in which a switch time may fall.
WINDOW_BLOCK = 0.03


def lagrange(points: FloatArray) -> FloatArray:
    """(n, K) values of the Lagrange polynomials of the Chebyshev nodes on [0, 1] at ``points``."""
    weights = (-1.0) ** np.arange(K) * np.sin((2 * np.arange(K) + 1) * pi / (2 * K))
    distance = points[:, None] - CHEBYSHEV
    hit = np.abs(distance) < 1e-14
    distance[hit] = 1.0
    terms = weights / distance
    values: FloatArray = terms / terms.sum(axis=1, keepdims=True)
    rows = hit.any(axis=1)
    values[rows] = hit[rows]
    return values


@dataclass(frozen=True)
class Region:
    """Box of the flat vector for which a mesh is built; (n_theta,) each."""

    low: FloatArray
    high: FloatArray
    fineness: float = 1.0
    """how many times narrower than usual the blocks are"""


@compiled(inside=True)
def _width_after(s: float, decays: FloatArray, amplitude: float, fineness: float) -> float:
    # Block width (s) at a time s after the last possible switch, for exponentials given by rows
    # (time constant, coefficient); amplitude: of them as the weights 1/s^2 see them
    factorial = 1.0
    for i in range(1, K + 1):
        factorial *= i
    least = np.inf
    for i in range(len(decays)):
        tau, c = decays[i, 0], decays[i, 1]
        growth = exp(min(s / tau, 600.0))
        reach = (TOLERANCE * factorial * growth / (2.0 * c * amplitude)) ** (1.0 / K)
        least = min(least, 4.0 * tau * reach)
    return least / fineness


@compiled()
def blocks_of_run(
    first: int,
    last: int,
    start: float,
    h: float,
    windows: FloatArray,
    narrow: float,
    decays: FloatArray,
    amplitude: float,
    kinks: FloatArray,
    fineness: float,
) -> list[tuple[int, int, int]]:
    # (start, samples, kind) of the blocks covering samples first .. last - 1 of one run;
    # windows, kinks (n, 2): where a switch may fall, what is wanted sample by sample (s)
    blocks = []
    i = first
    longest = max(8.0, (last - first) / 6.0 / fineness)
    while i < last:
        t = start + i * h
        allowed = longest * h
        latest = -np.inf
        for w in range(len(windows)):
            if t >= windows[w, 1]:
                latest = max(latest, windows[w, 1])
            elif t >= windows[w, 0]:
                allowed = min(allowed, narrow)
        if latest > -np.inf:  # what came earlier has decayed more
            after = _width_after(t - latest, decays, amplitude, fineness)
            allowed = min(allowed, max(narrow, after))
        kind = 0
        # a block may reach up to a window, or into it only when narrow; never into a kink
        while True:
            n = 16 * 2**kind
            end = t + n * h
            if n > last - i or n * h > allowed:
                break
            reaches = False
            for w in range(len(windows)):
                inside = windows[w, 0] < end and t < windows[w, 1]
                reaches = reaches or (inside and n * h > narrow)
            for w in range(len(kinks)):
                reaches = reaches or (kinks[w, 0] < end and t < kinks[w, 1])
            if reaches:
                break
            kind += 1
        n = 8 * 2**kind
        blocks.append((i, min(n, last - i), kind))
        i += n
    return blocks


def _decays(taus: FloatArray) -> FloatArray:
    """(n n_lags, 2) time constants and coefficients of the exponentials of chains ``taus``
    (n, n_lags)."""
    rows = []
    for row in taus:
        n = len(row)
        for j in range(n):
            others = np.prod([row[j] - row[m] for m in range(n) if m != j])
            c = row[j] ** (n - 1) / max(abs(others), (0.05 * row[j]) ** (n - 1))
            rows.append((row[j], c))
    return np.array(rows)


@lru_cache(maxsize=4096)
def _counts(n: int) -> FloatArray:
    """(K,) how many of ``n`` samples each node of their block stands for."""
    return np.asarray(lagrange((np.arange(n) + 0.5) / n).sum(axis=0))


def build(problem: Problem, vector: FloatArray, region: Region, data: bool = True) -> Arrays:
    """The mesh of a campaign (or design) around ``vector`` for all theta inside ``region``.

    ``data=False`` leaves the data out (counts only), as does a design.
    """
    layout, campaign = problem.layout, problem.campaign
    low, high = region.low, region.high
    blocks, runs = [0], [0]
    setting = np.zeros((len(campaign), 11))
    base: list[float] = []
    kinds: list[int] = []
    follows: list[bool] = []
    moments, node_time, reference, reference_s2 = [], [], [], []
    log_s2, edge_t, edge_y, distance, pairs = [], [], [], [], []
    cache: dict[int, FloatArray] = {}
    n_switches = 0
    for k, e in enumerate(campaign):
        h = e.interval
        i_y0, i_beta = layout.local[k, :2]
        level = vector[i_y0]
        decays, amplitude, narrow = _widths(problem, vector, region, k)
        # a sensor faster than this is replaced by a delay: no exponential may overflow
        least = max(16.0 * h, narrow) / 600.0
        windows = _windows(layout, low, high, k) + np.array([-least - h, h])
        kinks = _kinks(problem, region, e, windows)
        setting[k] = (
            h,
            e.total_flow,
            problem.noise.weight(campaign, e),
            problem.steps(e),
            least,
            level,
            vector[i_beta],
            problem.noise.fading,
            layout.switching[k].rest,
            n_switches,
            n_switches + len(layout.switching[k].moves),
        )
        n_switches += len(layout.switching[k].moves)
        with_data = data and e.y is not None
        if with_data:
            d = e.values - mean_on_grid(problem, vector, k)
        n_pairs = 0
        first_block = len(base)
        for (a, b), pause in zip(e.even_runs, e.pauses, strict=True):
            edge_t.append((e.t[a], e.t[b - 1]))
            ends = e.values[[a, b - 1]] - level if with_data else np.zeros(2)
            edge_y.append((ends[0], ends[1]))
            distance.append(pause)
            n_pairs += b - a - 1
            run_start = len(base)
            found = blocks_of_run(
                a + 1, b, e.t[0], h, windows, narrow, decays, amplitude, kinks, region.fineness
            )
            for start, n, kind in found:
                if with_data:
                    now, before = d[start : start + n], d[start - 1 : start + n - 1]
                    if kind > 0 and n not in cache:
                        cache[n] = lagrange((np.arange(n) + 0.5) / n)
                    L = cache[n] if kind > 0 else np.eye(n, K)
                    moments.append(np.stack([np.ones(n), now, before, now**2, now * before]) @ L)
                else:
                    only_counts = np.zeros((5, K))
                    only_counts[0] = _counts(n) if kind > 0 else np.arange(K) < n
                    moments.append(only_counts)
                follows.append(len(base) > run_start)
                base.append(e.t[0] + (start - 0.5) * h)
                kinds.append(kind)
        times = node_times(np.array(base[first_block:]), np.array(kinds[first_block:]), h)
        node_mean, node_s2 = at_times(problem, vector, e, k, times)
        lag_mean, _ = at_times(problem, vector, e, k, times - h)
        node_time.append(times.ravel())
        reference.append(np.stack([node_mean.ravel(), lag_mean.ravel()]) - level)
        reference_s2.append(node_s2.ravel())
        counts = np.array([m[0] for m in moments[first_block:]]).reshape(-1, K)
        log_s2.append(float((counts * np.log(node_s2)).sum()))
        pairs.append(n_pairs)
        blocks.append(len(base))
        runs.append(len(distance))
    stacked = np.array(moments, dtype=float).reshape(-1, 5, K)
    # valve and manifold have no such delay: where they are as fast, the full pass serves, which
    # also refuses a tau of zero
    low = low.copy()
    low[: layout.n_shared] = np.maximum(low[: layout.n_shared], np.finfo(float).tiny)
    if layout.is_published:
        low[1] = max(low[1], setting[:, 4].max())
        low[2] = max(low[2], (setting[:, 4] * setting[:, 1]).max())
    if not all(e.regular for e in campaign):  # a negative phi has no real power over such times
        low[layout.noise[:, 0]] = np.maximum(low[layout.noise[:, 0]], 0.0)
    return Arrays(
        local=layout.local,
        noise=layout.noise,
        blocks=np.array(blocks),
        runs=np.array(runs),
        setting=setting,
        totals=np.stack([[e.n_samples for e in campaign], pairs, log_s2], axis=1).astype(float),
        base=np.array(base, dtype=float),
        kind=np.array(kinds, dtype=np.int64),
        follows=np.array(follows, dtype=bool),
        time=np.concatenate(node_time),
        moments=np.ascontiguousarray(np.moveaxis(stacked, 1, 0).reshape(5, -1)),
        reference=np.ascontiguousarray(np.concatenate(reference, axis=1)),
        reference_s2=np.concatenate(reference_s2),
        edge_t=np.array(edge_t, dtype=float),
        edge_y=np.array(edge_y, dtype=float),
        distance=np.array(distance, dtype=float),
        low=np.ascontiguousarray(low, dtype=float),
        high=np.ascontiguousarray(high, dtype=float),
        n_kinds=max([0, *kinds]) + 1,
        is_pulse=layout.is_published,
        **_of_chain(problem),
    )


def _of_chain(problem: Problem) -> dict[str, np.ndarray]:
    """The arrays of the mesh from which lags and switches are computed, of rigs whose stages have
    one lag each."""
    layout, campaign = problem.layout, problem.campaign
    divided = [kind == "volume" for kind in layout.rig.kinds]
    flows = [
        [(e.total_flow if by else 1.0) / factor for by, (_, factor) in zip(divided, each)]
        for e, each in zip(campaign, layout.stage_sources, strict=True)
    ]
    place = [layout.switches(k)[each.places] for k, each in enumerate(layout.switching)]
    offsets = [s for each in layout.switching for s in each.offsets]
    heights = [h for each in layout.switching for h in each.heights]
    switches = np.array([np.concatenate(place), offsets, heights], dtype=float).T
    return {
        "lags": np.array([
            [(i, flow) for (i, _), flow in zip(each, row, strict=True)]
            for each, row in zip(layout.stage_sources, flows, strict=True)
        ], dtype=float),
        "switches": np.ascontiguousarray(switches),
    }  # fmt: skip


SMOOTH = 3
"""lags from which the response sets in so smoothly that it can be interpolated across a switch"""


def _windows(layout: Layout, low: FloatArray, high: FloatArray, k: int) -> FloatArray:
    """(n_switches, 2) s, where the switches of experiment number ``k`` may fall."""
    switching, places = layout.switching[k], layout.switches(k)
    if switching.recorded is not None:
        return np.empty((0, 2))
    return np.stack([switching.times(low[places]), switching.times(high[places])], axis=1)


def _kinks(problem: Problem, region: Region, e: Experiment, windows: FloatArray) -> FloatArray:
    """(n, 2) stretches (s) that the model wants sample by sample."""
    asked = getattr(problem.model, "kinks", None)
    found = [] if asked is None else asked(region.low, region.high, problem.layout, e)
    kinks = np.array(found, dtype=float).reshape(-1, 2) + e.interval * np.array([-1.0, 1.0])
    layout = problem.layout
    if layout.switching[layout.place_of(e.name)].recorded is not None:
        return np.array([[-np.inf, np.inf]])  # it bends at every sample of the input
    if layout.rig.n_lags < SMOOTH or layout.rig.has_delay:
        kinks = np.concatenate([kinks, windows])
    return kinks


def _widths(
    problem: Problem, vector: FloatArray, region: Region, k: int
) -> tuple[FloatArray, float, float]:
    """The exponentials to resolve, their amplitude, and the width where a switch may fall."""
    low, high = region.low, region.high
    e = problem.campaign.experiments[k]
    _, sigma0, sigma1 = vector[problem.layout.noise[k]]
    # where the variance changes by this factor, 1/s^2 still changes when x3 has all but decayed
    weight, fading = problem.noise.weight(problem.campaign, e), problem.noise.fading
    growth = 1.0 + weight * ((sigma1 / sigma0) ** 2 - fading)
    growth = float(min(max(growth, 1.0 / max(growth, 1e-8)), 1e8)) if np.isfinite(growth) else 1.0
    layout = problem.layout
    # corners of the box, and several values of the sensor's lag, which may be small
    ends = np.stack([low, high])[:, layout.shared[k]]
    of_sensor = np.geomspace(max(ends[0, 0], 1e-3 * ends[1, 0]), ends[1, 0], 5)
    candidates = np.array(
        [layout.rigs[k].taus(np.array(each), e.total_flow)
         for each in product(of_sensor, *ends.T[1:])]
    )  # fmt: skip
    slowest = layout.slowest(vector, k, e.total_flow)
    # x3 starts like the cube of time: s^2 doubles within growth^(-1/3) of the response's own time
    narrow = WINDOW_BLOCK * slowest * (1.0 + growth / 30.0) ** (-1.0 / 3.0)
    return _decays(candidates), growth, narrow / region.fineness


def node_times(base: FloatArray, kind: np.ndarray, h: float) -> FloatArray:
    """(n_blocks, K) s."""
    pointwise = (np.arange(K) + 0.5) * h
    spread = 8.0 * 2.0 ** kind[:, None] * h * CHEBYSHEV
    return base[:, None] + np.where(kind[:, None] == 0, pointwise, spread)


def at_times(
    problem: Problem, vector: FloatArray, e: Experiment, k: int, times: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Mean and variance of one experiment at any times, in the shape of ``times``."""
    _, sigma0, sigma1 = vector[problem.layout.noise[k]]
    mean, x = mean_and_response(problem, vector, e, np.ascontiguousarray(times).ravel())
    law = problem.noise.weight(problem.campaign, e), problem.noise.fading
    s2 = scale_squared(x, sigma0, sigma1, *law)
    return mean.reshape(times.shape), s2.reshape(times.shape)
