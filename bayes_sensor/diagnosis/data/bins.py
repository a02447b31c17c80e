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
from bayes_sensor.diagnosis.data.switch_times import SwitchTimes, pulse_times

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
    """(n_bins,) whether the last switch was a step down"""
    segment: NDArray[np.int64]
    """(n_bins,) the switch whose phases these are, from 0; -1 for the baseline before all"""
    switches: tuple[SwitchTimes, ...]
    """of the record"""
    last_switch: NDArray[np.int64]
    """(n_bins,) number of the last switch, -1 before all"""

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
            segment=self.segment[keep],
            switches=self.switches,
            last_switch=self.last_switch[keep],
        )

    @cached_property
    def heights(self) -> FloatArray:
        """(n_bins,) change of the input at the last switch, over the largest level; of the first
        before it."""
        each = np.array([s.height for s in self.switches])
        return np.asarray(each[np.maximum(self.last_switch, 0)])

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
    found = []
    for e, (t0, tf), tau in zip(campaign, switches, taus, strict=True):
        response = t0
        if delay is not None and e.commanded_on is not None and t0 - e.commanded_on < 0.4 * delay:
            # a fit to a weak step may lock onto a spike at the command; the onset lasts longer
            response = e.commanded_on + delay
        found.append(bins_of(e, pulse_times(e, t0, tf, tau, response), time_scale))
    return found


def _usual_delay(campaign: Campaign, switches: list[tuple[float, float | None]]) -> float | None:
    """s, median time from the command to the response; None where too few commands are known."""
    delays = [
        t0 - e.commanded_on
        for e, (t0, _) in zip(campaign, switches, strict=True)
        if e.commanded_on is not None
    ]
    return float(np.median(delays)) if len(delays) >= 3 else None


def bins_of(e: Experiment, switches: Sequence[SwitchTimes], scale: float) -> ExperimentBins:
    """The bins of one experiment around its ``switches``; ``scale`` s: see :func:`make_bins`."""
    start, end = float(e.t[0]) - 0.5 * e.interval, float(e.t[-1]) + 0.5 * e.interval
    edges = [start, end]
    events = [s.at for s in switches]
    for event, until in zip(events, [*events[1:], end], strict=True):
        inside = event + scale * np.concatenate([BEFORE, AFTER])
        # the bins before the next switch belong to that switch
        stop = until + (scale * BEFORE[0] if until != end else 0.0)
        edges += [x for x in inside if start < x < stop or (x <= event and start < x < end)]
    phases, labels, of_switch = _phases(switches)
    edges += [x for x in phases if start < x < end]
    # carried-over gas leaves at the start of the record
    edges += [start + scale * x for x in (0.3, 0.8, 1.6, 3.0, 6.0) if start + scale * x < events[0]]
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
    numbers = np.arange(len(events))
    last_switch = np.max(np.where(centre[:, None] >= events, numbers, -1), axis=1)
    place = np.searchsorted(phases, centre, side="right")
    since = centre - np.array(events)[np.maximum(last_switch, 0)]
    falls = np.array([s.height < 0.0 for s in switches])
    return ExperimentBins(
        experiment=e,
        first=begin,
        last=after,
        times=np.array(times),
        weights=np.array(weights),
        starts=np.array(starts, dtype=np.int64),
        phase=labels[place],
        since=since,
        falling=(last_switch >= 0) & falls[np.maximum(last_switch, 0)],
        segment=of_switch[place],
        switches=tuple(switches),
        last_switch=last_switch,
    )


def _phases(
    switches: Sequence[SwitchTimes],
) -> tuple[FloatArray, NDArray[np.int64], NDArray[np.int64]]:
    """s, when phases begin, (n,); and of each, after the baseline before all, its index into PHASES
    and its switch, (n + 1,) both."""
    begins, labels, of_switch = [], [0], [-1]
    for j, s in enumerate(switches):
        here = [(s.onset, 1), (s.risen, 2), (s.reached, 3)] if s.height > 0.0 else [
            (s.onset, 4), (s.reached, 5)
        ]  # fmt: skip
        begins += [at for at, _ in here]
        labels += [label for _, label in here]
        of_switch += [j] * len(here)
    return (
        np.maximum.accumulate(begins),
        np.array(labels, dtype=np.int64),
        np.array(of_switch, dtype=np.int64),
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
