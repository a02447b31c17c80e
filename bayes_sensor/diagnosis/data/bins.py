"""Event-locked bins: the campaign in a few hundred means, and the phases they belong to.

Around each switch the bins grow with the logarithm of the time since it, so that a fast lag and a
slow drift are both resolved with about seventy numbers per experiment.  A bin's mean voltage is
compared with the model's mean over the same samples, computed from a few quadrature times.
"""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from bayes_sensor.campaign import Campaign, Experiment, FloatArray
from bayes_sensor.rig.cascade import cascade_response

PHASES = ("baseline", "onset", "rise", "plateau", "fall", "tail")

# Edges of the bins after a switch, in time scales (of the slower of valve and manifold).
AFTER = np.array(
    [
        0.0, 0.06, 0.12, 0.18, 0.25, 0.33, 0.42, 0.52, 0.64, 0.78, 0.95, 1.15, 1.4, 1.7, 2.05,
        2.5, 3.0, 3.6, 4.4, 5.4, 6.6, 8.0, 10.0, 13.0, 17.0, 23.0, 31.0, 43.0, 60.0,
    ]
)  # fmt: skip
BEFORE = np.array([-1.2, -0.9, -0.6, -0.45, -0.3, -0.2, -0.12, -0.06])
"""edges before a switch: a delay that the fit misplaced shows there"""
LONGEST = 17.0
"""time scales; no bin is longer, so that drifts stay visible"""
ENOUGH = 100
"""bins of even length that show a drift, however short the time scale is beside the record"""
ROUNDING = 1e-6
"""share of a length by which it may be rounded, on a clock that shows large numbers"""
QUADRATURE = np.polynomial.legendre.leggauss(4)


@dataclass(frozen=True, eq=False)
class ExperimentBins:
    """The bins of one experiment."""

    experiment: Experiment
    first: NDArray[np.int64]
    """(n_bins,) index of each bin's first sample"""
    last: NDArray[np.int64]
    """(n_bins,) index after its last"""
    times: FloatArray
    """(n_times,) s, sorted: where the model is evaluated"""
    weights: FloatArray
    """(n_times,) weight of each time in its bin's mean"""
    starts: NDArray[np.int64]
    """(n_bins,) first time of each bin"""
    phase: NDArray[np.int64]
    """(n_bins,) index into PHASES"""
    since: FloatArray
    """(n_bins,) s, from the last switch to the bin's middle; negative before the first"""
    falling: NDArray[np.bool_]
    """(n_bins,) whether the last switch was the step down"""

    @property
    def centre(self) -> FloatArray:
        """(n_bins,) s, middle of each bin."""
        t = self.experiment.t
        return 0.5 * (t[self.first] + t[self.last - 1])

    @cached_property
    def edges(self) -> tuple[FloatArray, FloatArray]:
        """(n_bins,) s, begins and ends: half a sample before the first to half after the last."""
        t, half = self.experiment.t, 0.5 * self.experiment.interval
        return t[self.first] - half, t[self.last - 1] + half

    @cached_property
    def alone(self) -> AllBins:
        """These bins, as the kernel takes them."""
        return AllBins.of([self])

    @property
    def count(self) -> NDArray[np.int64]:
        """(n_bins,) samples in each bin."""
        return self.last - self.first

    def average(self, samples: FloatArray) -> FloatArray:
        """(n_bins,) means of the samples (n_t,) in each bin."""
        total = np.concatenate([[0.0], np.cumsum(samples)])
        means: FloatArray = (total[self.last] - total[self.first]) / self.count
        return means

    def restricted(self, keep: NDArray[np.bool_]) -> ExperimentBins:
        """Only the bins (n_bins,) that are kept."""
        ends = np.append(self.starts[1:], len(self.times))
        lengths = ends - self.starts
        times = np.repeat(keep, lengths)
        kept = lengths[keep]
        return ExperimentBins(
            experiment=self.experiment,
            first=self.first[keep],
            last=self.last[keep],
            times=self.times[times],
            weights=self.weights[times],
            starts=np.concatenate([[0], np.cumsum(kept)[:-1]]).astype(np.int64),
            phase=self.phase[keep],
            since=self.since[keep],
            falling=self.falling[keep],
        )

    def reduce(self, at_times: FloatArray) -> FloatArray:
        """(n_bins,) bin means of a function given at ``times`` (n_times,)."""
        return np.add.reduceat(at_times * self.weights, self.starts)


class AllBins(NamedTuple):
    """The bins of all experiments, one after the other, as the kernel takes them."""

    times: FloatArray
    """(n_times,) s"""
    weights: FloatArray
    """(n_times,)"""
    starts: NDArray[np.int64]
    """(n_bins,) first time of each bin, counted from its experiment's first"""
    low: FloatArray
    """(n_bins,) s, begins of the bins"""
    high: FloatArray
    """(n_bins,) s, their ends"""
    of_times: NDArray[np.int64]
    """(n_experiments + 1,) first time of each experiment, and how many there are"""
    of_bins: NDArray[np.int64]
    """(n_experiments + 1,) first bin of each experiment, and how many there are"""

    @classmethod
    def of(cls, bins: Sequence[ExperimentBins]) -> AllBins:
        """The bins of these experiments."""
        low, high = zip(*(b.edges for b in bins), strict=True)
        return cls(
            np.concatenate([b.times for b in bins]),
            np.concatenate([b.weights for b in bins]),
            np.concatenate([b.starts for b in bins]),
            np.concatenate(low),
            np.concatenate(high),
            np.cumsum([0, *(len(b.times) for b in bins)]),
            np.cumsum([0, *(len(b.starts) for b in bins)]),
        )


def make_bins(
    campaign: Campaign,
    switches: list[tuple[float, float | None]],
    taus: list[FloatArray],
    time_scale: float,
) -> list[ExperimentBins]:
    """Bins of every experiment.

    ``switches``: t0 and tf (None: no fall) in s, ``taus``: valve, manifold, sensor (3,) s of each
    experiment at the fit without effects; ``time_scale`` s is what :data:`AFTER` is in units of.
    """
    delay = _usual_delay(campaign, switches)
    return [
        _bins(e, t0, tf, tau, time_scale, delay)
        for e, (t0, tf), tau in zip(campaign, switches, taus, strict=True)
    ]


def _usual_delay(campaign: Campaign, switches: list[tuple[float, float | None]]) -> float | None:
    """s, median time from the command to the response; None where too few commands are known."""
    delays = [
        t0 - e.commanded_on
        for e, (t0, _) in zip(campaign, switches, strict=True)
        if e.commanded_on is not None
    ]
    return float(np.median(delays)) if len(delays) >= 3 else None


def _bins(
    e: Experiment,
    t0: float,
    tf: float | None,
    taus: FloatArray,
    scale: float,
    delay: float | None,
) -> ExperimentBins:
    start, end = float(e.t[0]) - 0.5 * e.interval, float(e.t[-1]) + 0.5 * e.interval
    edges = [start, end]
    events = [t0] + ([tf] if tf is not None else [])
    for event, until in zip(events, [*events[1:], end], strict=True):
        inside = event + scale * np.concatenate([BEFORE, AFTER])
        # the bins before the next switch belong to that switch
        stop = until + (scale * BEFORE[0] if until != end else 0.0)
        edges += [x for x in inside if start < x < stop or (x <= event and start < x < end)]
    response = t0
    if delay is not None and e.commanded_on is not None and t0 - e.commanded_on < 0.4 * delay:
        # a fit to a weak step may lock onto a spike at the command; the onset lasts longer
        response = e.commanded_on + delay
    phases = phase_times(e, response, tf, taus)
    edges += [x for x in phases if start < x < end]
    # carried-over gas leaves at the start of the record
    edges += [start + scale * x for x in (0.3, 0.8, 1.6, 3.0, 6.0) if start + scale * x < t0]
    # a third of the shortest after a switch
    merged = limit_lengths(
        np.unique(edges), 0.02 * scale, max(LONGEST * scale, (end - start) / ENOUGH)
    )
    index = np.clip(np.searchsorted(e.t, merged), 0, len(e.t))
    first, last = [], []
    for a, b in itertools.pairwise(index):
        for run_a, run_b in e.runs:
            low, high = max(a, run_a), min(b, run_b)
            if high > low:
                first.append(low)
                last.append(high)
    order = np.argsort(first)
    begin = np.array(first, dtype=np.int64)[order]
    after = np.array(last, dtype=np.int64)[order]
    times: list[float] = []
    weights: list[float] = []
    starts: list[int] = []
    x, w = QUADRATURE
    for a, b in zip(begin, after, strict=True):
        starts.append(len(times))
        if b - a <= 5:
            times += list(e.t[a:b])
            weights += [1.0 / (b - a)] * (b - a)
        else:  # the sum over samples is the integral from half a sample before to half after
            low, high = e.t[a] - 0.5 * e.interval, e.t[b - 1] + 0.5 * e.interval
            times += list(0.5 * (low + high) + 0.5 * (high - low) * x)
            weights += list(0.5 * w)
    centre = 0.5 * (e.t[begin] + e.t[after - 1])
    falling = np.zeros(len(begin), dtype=bool) if tf is None else centre >= tf
    return ExperimentBins(
        experiment=e,
        first=begin,
        last=after,
        times=np.array(times),
        weights=np.array(weights),
        starts=np.array(starts, dtype=np.int64),
        phase=np.searchsorted(phases, centre, side="right"),
        since=np.where(falling, centre - (tf if tf is not None else 0.0), centre - t0),
        falling=falling,
    )


def limit_lengths(edges: FloatArray, shortest: float, longest: float) -> FloatArray:
    """Edges (m,) of bins that are neither ``shortest`` s or shorter nor longer than ``longest``."""
    kept = [float(edges[0])]
    for x in edges[1:]:
        if x - kept[-1] > shortest * (1.0 + ROUNDING):
            # steps of exactly the longest are meant to stay whole, however they are rounded
            n = int(np.ceil((x - kept[-1]) / longest * (1.0 - ROUNDING)))
            kept += list(kept[-1] + (x - kept[-1]) * np.arange(1, n + 1) / n)
    kept[-1] = max(kept[-1], float(edges[-1]))
    return np.array(kept)


def phase_times(e: Experiment, t0: float, tf: float | None, taus: FloatArray) -> FloatArray:
    """(5,) s: when onset, rise, plateau, fall and tail begin; infinity for what is not there.

    The onset lasts from the command (or from a little before the response where none is known)
    until the response has reached a tenth; the rise from there to 99 %; the fall from the step
    down to 1 %.
    """
    lags = float(np.sum(taus))
    grid = np.linspace(0.0, 12.0 * lags, 1200)
    x = cascade_response(grid, taus, 0.0)
    tenth, most = (float(grid[min(int(np.searchsorted(x, s)), 1199)]) for s in (0.1, 0.99))
    onset = t0 - 0.25 * lags
    if e.commanded_on is not None:
        onset = min(onset, e.commanded_on)
    times = [onset, t0 + tenth, t0 + most, np.inf, np.inf]
    if tf is not None:
        fall = tf - 0.25 * lags
        if e.commanded_off is not None:
            fall = min(fall, e.commanded_off)
        times[3], times[4] = fall, tf + most
    return np.maximum.accumulate(times)
