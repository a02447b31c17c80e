"""A cause that is not in the catalogue: a smooth Gaussian-process discrepancy as competitor.

Residual tests cannot say "none of the listed causes"; a rival that explains any smooth,
event-locked misfit can (Kennedy and O'Hagan 2001; Brynjarsdottir and O'Hagan 2014).  Matern-3/2
parts:

- *response*: in the logarithm of the time since a switch reached the sensor, scaled by beta;
- *herald*: in linear time around the switch, scaled by beta: what runs ahead of the gas;
- *timing*: in the logarithm of the time since a switch, scaled by the slope of the mean: what runs
  early or late by a part of a time scale, ever more or ever less;
- *readout*: in the voltage itself, in volts: what a readout that is not linear does to all alike;
- *drift*: in linear time, in volts;
- *gain*: in linear time, scaled by what the signal stands above its baseline;
- *switching*: in the logarithm of the time since the command, in volts.

Each is a common function of all experiments, one that follows their flow (or, in configurations of
their own, their concentration), and a small own one; or common to all and nothing else; or as much
another one in each as common.  Drift and gain, which no switch sets off, take a course of their own
in every experiment.  Response and timing are of rise and fall apart; or of one of the two alone; or
one course for both, upside down at the fall, as everything linear has it; or follow the volume of
gas that has flowed in place of the time, as what happens on the way of the gas does.  A misfit that
has such a form is explained with half the freedom, and gains by it.  Kernels are factored once per
campaign; evidences then need only small matrices.

The shape error of an effect differs from the misfit of an unlisted cause: a configuration has one
weight beside an effect and another alone.  The latter are rounded from those that
``paper/studies/study_unlisted.py`` finds in campaigns with unlisted causes; half of the weight goes
to what is the same in all experiments.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from math import sqrt

import numpy as np
from scipy.linalg import block_diag

from bayes_sensor.campaign import FloatArray
from bayes_sensor.diagnosis.data.binned_campaign import BinnedCampaign
from bayes_sensor.diagnosis.data.bins import ExperimentBins
from bayes_sensor.diagnosis.evidence.refit import Refit

OWN = 0.1
"""standard deviation of an experiment's own part beside the common one"""
TREND = 0.5
"""of the part that follows the logarithm of flow or concentration, for one standard deviation"""
ALIKE = 0.9
"""correlation of flow and concentration from which there is no telling which of them it follows"""
NEGLIGIBLE = 1e-3
"""variance in units of the noise below which a direction of the discrepancy is dropped"""
MANY = 250
"""bins and features beyond which what experiments hold is brought together first"""

MIRRORED, RISE, FALL, VOLUME = " mirrored", " rise", " fall", " by volume"
"""what the names of configurations say where rise and fall do not take courses of their own"""

RESPONSE_LENGTHS = (0.3, 1.0, 2.5)
RESPONSE_SHARES = (0.001, 0.003, 0.01, 0.03, 0.1)
HERALD_SHARES = (0.003, 0.01, 0.03)
HERALD = (-1.2, 0.5)
"""time scales around a switch"""
HERALD_LENGTH = 0.15
TIMING_LENGTHS = (0.5, 1.0)
TIMING_SHARES = (0.01, 0.03, 0.1)
"""of the time scale"""
READOUT_LENGTHS = (0.05, 0.2)
"""of the median step height"""
DRIFT_SECONDS = 8.0
GAIN_SECONDS = (8.0, 2.0)
USUAL_SECONDS = 120.0
"""length of a record that these are for"""
VOLT_SHARES = (0.0005, 0.0015, 0.005, 0.015)
"""of the median step height: 1 to 30 mV for a 2 V step"""


@dataclass(frozen=True, eq=False)
class Discrepancy:
    """One configuration of the process, in whitened bins."""

    name: str
    weight: float
    """prior weight among the configurations"""
    alone: float
    """the same where nothing listed is beside it"""
    basis: FloatArray
    """(n_bins in all, rank) orthonormal directions"""
    variance: FloatArray
    """(rank,) along them, in units of the noise"""

    def log_determinant(self) -> float:
        """ln |I + K|."""
        return float(np.sum(np.log1p(self.variance)))

    def absorbed(self, values: FloatArray) -> FloatArray:
        """(m, m) by how much values' (I + K)^-1 values is less than values' values; (n, m)."""
        inner = np.sqrt(self.variance / (1.0 + self.variance))[:, None] * (self.basis.T @ values)
        return np.asarray(inner.T @ inner)

    def leave(self, values: FloatArray) -> FloatArray:
        """(n,) values less what the process most likely is, (I + K)^-1 values."""
        share = self.variance / (1.0 + self.variance)
        return np.asarray(values - self.basis @ (share * (self.basis.T @ values)))


def matern32(distance: FloatArray, length: float) -> FloatArray:
    """Matern-3/2 correlation, (1 + r) exp(-r) with r = sqrt(3) |d|/length."""
    r = sqrt(3.0) * np.abs(distance) / length
    return (1.0 + r) * np.exp(-r)


def _features(position: list[FloatArray], length: float, resolution: float) -> list[FloatArray]:
    # low-rank factor of the kernel: eigenvectors on a common grid, interpolated to the bins
    everywhere = np.concatenate(position)
    low, high = float(np.min(everywhere)), float(np.max(everywhere))
    n = max(int(np.ceil((high - low) / (resolution * length))) + 1, 2)
    grid = np.linspace(low, high, n)
    values, vectors = np.linalg.eigh(matern32(np.subtract.outer(grid, grid), length))
    keep = values > 1e-4 * values[-1]
    factor = vectors[:, keep] * np.sqrt(values[keep])
    found = []
    for at in position:
        place = np.clip((at - low) / (high - low) * (n - 1), 0, n - 1) if high > low else 0.0 * at
        left = np.minimum(place.astype(int), n - 2)
        part = place - left
        found.append(factor[left] * (1.0 - part)[:, None] + factor[left + 1] * part[:, None])
    return found


Parts = list[list[FloatArray]]
"""whitened features (n_bins, rank) of every experiment: of rise and fall apart, or of both"""


@dataclass(frozen=True)
class _Spread:
    """How much of a function experiments share; standard deviations beside the common part's 1."""

    trend: FloatArray
    """(n_experiments,) of the part that goes with a condition"""
    own: float
    """of every experiment's own part"""

    def over(self, parts: Parts) -> FloatArray:
        """(n_bins in all, m): common, following and own copies of every part's features."""
        made = []
        for features in parts:
            made.append(np.vstack(features))
            if np.any(self.trend):
                made.append(np.vstack([w * f for w, f in zip(self.trend, features, strict=True)]))
            if self.own > 0:
                made.append(block_diag(*(self.own * f for f in features)))
        return np.hstack(made)


@dataclass(frozen=True)
class _Weight:
    """Of a configuration, beside an effect and alone."""

    beside: float
    alone: float

    def __mul__(self, other: _Weight) -> _Weight:
        return _Weight(self.beside * other.beside, self.alone * other.alone)

    def shared(self, n: int) -> _Weight:
        """One of ``n`` equal shares."""
        return _Weight(self.beside / n, self.alone / n)


def _spreads(binned: BinnedCampaign) -> dict[str, tuple[_Weight, _Spread]]:
    """Weights and spreads of what comes again in every experiment, by name."""
    known = binned.campaign.flows_known
    flow = _standardised([e.total_flow if known else 1.0 for e in binned.campaign])
    concentration = _standardised([e.concentration for e in binned.campaign])
    if len(flow) == 1:
        return {"": (_Weight(1.0, 1.0), _Spread(flow, 0.0))}
    found = {
        "": (_Weight(0.5, 0.18), _Spread(TREND * flow, OWN)),
        " alike": (_Weight(0.25, 0.5), _Spread(0.0 * flow, 0.0)),
        " each": (_Weight(0.0, 0.25), _Spread(0.0 * flow, 1.0)),
    }
    if np.any(concentration) and abs(float(flow @ concentration)) < ALIKE * len(flow):
        trend = _Spread(TREND * concentration, OWN)
        found[" by concentration"] = (_Weight(0.25, 0.07), trend)
    weights = [weight for weight, _ in found.values()]
    whole = _Weight(1.0 / sum(w.beside for w in weights), 1.0 / sum(w.alone for w in weights))
    return {name: (weight * whole, spread) for name, (weight, spread) in found.items()}


def _standardised(values: list[float]) -> FloatArray:
    """(n,) logarithms with mean 0 and standard deviation 1; zeros where all are the same."""
    logs = np.log(values)
    spread = float(np.std(logs))
    made: FloatArray = (logs - logs.mean()) / spread if spread > 1e-6 else np.zeros(len(logs))
    return made


def make_discrepancies(binned: BinnedCampaign, base: Refit) -> list[Discrepancy]:
    """All configurations for a campaign, around the fit without effects.

    Where that fit has effects already, only those with a weight beside an effect.
    """
    high = binned.input_height
    beta = [
        abs(float(base.x[base.coords.local[k] + 1])) * high for k in range(len(binned.campaign))
    ]
    spreads = _spreads(binned)
    usual = spreads[""][1]
    made: list[Discrepancy] = []

    def add(name: str, weight: _Weight, factor: FloatArray, sizes: tuple[float, ...]) -> None:
        made.extend(_configurations(name, weight, factor, sizes, binned.rows))

    add("herald", _Weight(0.09, 0.03), usual.over(_herald_parts(binned, beta)), HERALD_SHARES)
    apart = _Spread(usual.trend, 1.0 if len(binned.campaign) > 1 else 0.0)
    wandering = _wandering(binned, base)
    for name, (weight, part) in wandering.items():
        add(name, weight, apart.over([part]), VOLT_SHARES)
    repeating = _repeating(binned, base, beta)
    for shared, (weight, spread) in spreads.items():
        for name, (of_all, parts, sizes) in repeating.items():
            if _counts(weight * of_all, base):
                add(f"{name}{shared}", weight * of_all, spread.over(parts), sizes)
    response, drift = usual.over(repeating["response 1"][1]), apart.over([wandering["drift"][1]])
    for size, volts in ((0.003, 0.0015), (0.01, 0.0015), (0.01, 0.005), (0.03, 0.005)):
        joined = np.hstack([response * size, drift * volts])
        found = _configurations("", _Weight(0.2, 0.0).shared(4), joined, (1.0,), binned.rows)
        made += [replace(d, name=f"response {size:g} and drift {volts:g}") for d in found]
    return made


def _wandering(binned: BinnedCampaign, base: Refit) -> dict[str, tuple[_Weight, list[FloatArray]]]:
    """What takes another course in every experiment, in its time: weight and part, by name."""
    at = [b.centre - float(b.experiment.t[0]) for b in binned.bins]
    means = _means(binned, base)
    volts = [np.full(len(m), binned.signal_scale) for m in means]
    above = [m - base.x[base.coords.local[k]] for k, m in enumerate(means)]
    drift, (slow, fast) = DRIFT_SECONDS, GAIN_SECONDS
    if binned.chain is not None:  # records may last for seconds or for days
        drift, slow, fast = (x * binned.duration / USUAL_SECONDS for x in (drift, slow, fast))
    return {
        "drift": (_Weight(0.12, 0.02), _part(binned, at, volts, drift)),
        f"gain {slow:g} s": (_Weight(0.04, 0.04), _part(binned, at, above, slow)),
        f"gain {fast:g} s": (_Weight(0.04, 0.01), _part(binned, at, above, fast)),
    }


def _counts(weight: _Weight, base: Refit) -> bool:
    return weight.beside > 0.0 or (weight.alone > 0.0 and not base.coords.parts)


Repeating = dict[str, tuple[_Weight, Parts, tuple[float, ...]]]


def _repeating(binned: BinnedCampaign, base: Refit, beta: list[float]) -> Repeating:
    """What comes again in every experiment: weight, parts and sizes, by name and length."""
    readout = _readout_parts(binned, base)
    found: Repeating = {
        "readout 0.05": (_Weight(0.075, 0.05), readout[0], VOLT_SHARES),
        "readout 0.2": (_Weight(0.075, 0.19), readout[1], VOLT_SHARES),
    }
    courses = _courses(binned)
    whole = sum(weight.alone for weight in courses.values())
    response, timing = _after_a_switch(binned, beta), _slopes(binned, base)
    for course, weight in courses.items():
        if not _counts(weight, base):
            continue
        each = weight * _Weight(1.0, 1.0 / whole)
        by_volume = VOLUME in course
        for length, alone in zip(RESPONSE_LENGTHS, (0.01, 0.09, 0.17), strict=True):
            parts = _along(binned, course, response, length)
            found[f"response {length:g}{course}"] = (
                each * _Weight(0.15, alone), parts, RESPONSE_SHARES
            )  # fmt: skip
        volts = [s / _flow(binned, k) if by_volume else s for k, s in enumerate(timing)]
        for length, usual, alone in zip(TIMING_LENGTHS, (0.0, 0.2), (0.03, 0.3), strict=True):
            parts = _along(binned, course, volts, length)
            found[f"timing {length:g}{course}"] = (
                each * _Weight(usual, alone), parts, TIMING_SHARES
            )  # fmt: skip
    commanded = _switching_parts(binned)
    if commanded:
        found["switching"] = (_Weight(0.15, 0.06), commanded, VOLT_SHARES)
    return found


def _courses(binned: BinnedCampaign) -> dict[str, _Weight]:
    """How rise and fall belong together, with weights.

    Each its own course; or one course for both, the fall's upside down, as of everything linear,
    in time or in the volume that has flowed; or one of the two alone.
    """
    if _sides(binned) == (False,):
        return {"": _Weight(1.0, 1.0)}
    found = {
        "": _Weight(1.0, 0.15),
        MIRRORED: _Weight(0.0, 0.2),
        RISE: _Weight(0.0, 0.3),
        FALL: _Weight(0.0, 0.15),
    }
    if not binned.campaign.same_flow:
        found[VOLUME] = _Weight(0.0, 0.1)
        found[VOLUME + MIRRORED] = _Weight(0.0, 0.1)
    return found


def _flow(binned: BinnedCampaign, k: int) -> float:
    """Of experiment ``k``, over the campaign's."""
    return binned.campaign.experiments[k].total_flow / binned.reference_flow


def _along(binned: BinnedCampaign, course: str, volts: list[FloatArray], length: float) -> Parts:
    """A function of the logarithm of the time since a switch, scaled by ``volts``."""
    since = []
    for k, b in enumerate(binned.bins):
        passed = b.since * _flow(binned, k) if VOLUME in course else b.since
        since.append(_log_time(passed, binned.time_scale))
    if MIRRORED in course:
        return [_part(binned, since, volts, length)]
    rise = [np.where(b.falling, 0.0, v) for b, v in zip(binned.bins, volts, strict=True)]
    fall = [np.where(b.falling, v, 0.0) for b, v in zip(binned.bins, volts, strict=True)]
    blocks = {RISE: [rise], FALL: [fall]}.get(course, [rise, fall][: len(_sides(binned))])
    return [_part(binned, since, v, length) for v in blocks]


def _sides(binned: BinnedCampaign) -> tuple[bool, ...]:
    """Whether falling: the rise, and the fall where one was recorded."""
    return (False, True) if any(b.falling.any() for b in binned.bins) else (False,)


def _after_a_switch(binned: BinnedCampaign, beta: list[float]) -> list[FloatArray]:
    """V (n_bins,) of every experiment: the step's height, negative at the fall."""
    return [
        np.where(b.since > 0.0, b.heights * v, 0.0) for b, v in zip(binned.bins, beta, strict=True)
    ]


def _herald_parts(binned: BinnedCampaign, beta: list[float]) -> Parts:
    blocks = []
    for falling in _sides(binned):
        since, volts = [], []
        for b, size in zip(binned.bins, beta, strict=True):
            switches = [s.at for s in b.switches if (s.height < 0.0) == falling]
            away = np.subtract.outer(b.centre, switches or [float(b.experiment.t[-1])])
            nearest = np.argmin(np.abs(away), axis=1)
            at = away[np.arange(len(away)), nearest] / binned.time_scale
            near = (at > HERALD[0]) & (at < HERALD[1])
            since.append(np.clip(at, *HERALD))
            volts.append(np.where(near, size, 0.0))
        blocks.append(_part(binned, since, volts, HERALD_LENGTH))
    return blocks


def _means(binned: BinnedCampaign, base: Refit) -> list[FloatArray]:
    """V (n_bins,) of every experiment: what the fit without effects says."""
    return [b.reduce(base.coords.mean(base.x, k, b.times)) for k, b in enumerate(binned.bins)]


def _slopes(binned: BinnedCampaign, base: Refit) -> list[FloatArray]:
    """V (n_bins,) in a time scale: what a time that runs ahead or behind does where it moves."""
    h = 0.02 * binned.time_scale
    found = []
    for k, b in enumerate(binned.bins):
        before, after = (b.reduce(base.coords.mean(base.x, k, b.times + d)) for d in (-h, h))
        found.append((after - before) / (2.0 * h) * binned.time_scale)
    return found


def _readout_parts(binned: BinnedCampaign, base: Refit) -> list[Parts]:
    """A readout that is off by a function of what it reads, for each of the lengths."""
    means = _means(binned, base)
    read = [m / binned.height for m in means]
    volts = [np.full(len(m), binned.signal_scale) for m in means]
    return [[_part(binned, read, volts, w)] for w in READOUT_LENGTHS]


def _log_time(since: FloatArray, scale: float) -> FloatArray:
    return np.log(np.maximum(since, 0.0) / scale + 0.06)


def _switching_parts(binned: BinnedCampaign) -> Parts:
    blocks = []
    for falling in (False, True):
        if not all(_commands(b, falling) for b in binned.bins):
            continue
        since, volts = [], []
        for b in binned.bins:
            told = np.array(_commands(b, falling))
            other = np.array([-np.inf, *_commands(b, not falling)])
            before = [np.append(-np.inf, told), other]
            last, against = (
                np.max(np.where(x < b.centre[:, None], x, -np.inf), axis=1) for x in before
            )
            here = last > against
            since.append(b.centre - np.where(here, last, told[0]))
            volts.append(np.where(here, binned.signal_scale, 0.0))
        blocks.append(_part(binned, [_log_time(s, binned.time_scale) for s in since], volts, 1.0))
    return blocks


def _commands(b: ExperimentBins, falling: bool) -> list[float]:
    """s, when switches up, or down, were commanded; empty where that is not known."""
    return [
        s.commanded for s in b.switches if (s.height < 0.0) == falling and s.commanded is not None
    ]


def _part(
    binned: BinnedCampaign,
    position: list[FloatArray],
    scale: list[FloatArray],
    length: float,
) -> list[FloatArray]:
    features = _features(position, length, 0.35)
    return [
        whiten @ (f * s[:, None])
        for whiten, f, s in zip(binned.inverse_factors, features, scale, strict=True)
    ]


def _configurations(
    name: str,
    weight: _Weight,
    factor: FloatArray,
    sizes: tuple[float, ...],
    rows: Sequence[slice],
) -> list[Discrepancy]:
    """One for each of the sizes; they share the weight, and the directions of K = F F'."""
    each = weight.shared(len(sizes))
    factor = factor[:, np.any(factor != 0.0, axis=0)]
    least = NEGLIGIBLE / max(sizes) ** 2
    if len(rows) > 1 and min(factor.shape) > MANY:
        within = _within(factor, rows, 1e-3 * least)
        core = np.vstack([q.T @ factor[at] for q, at in zip(within, rows, strict=True)])
        values, inner = _directions(core, least)
        parts = np.split(inner, np.cumsum([q.shape[1] for q in within])[:-1])
        basis = np.vstack([q @ part for q, part in zip(within, parts, strict=True)])
    else:
        values, basis = _directions(factor, least)
    made = []
    for size in sizes:
        variance = values * size**2  # ascending
        first = int(np.searchsorted(variance, NEGLIGIBLE, side="right"))
        kept = (basis[:, first:], variance[first:])
        made.append(Discrepancy(f"{name} {size:g}", each.beside, each.alone, *kept))
    return made


def _directions(factor: FloatArray, least: float) -> tuple[FloatArray, FloatArray]:
    """Eigenvalues of F F' above ``least``, ascending, and their eigenvectors (n, rank)."""
    # from the smaller of the two Gram matrices
    if factor.shape[0] < factor.shape[1]:
        values, basis = np.linalg.eigh(factor @ factor.T)
        seen = values > least
        return values[seen], basis[:, seen]
    values, vectors = np.linalg.eigh(factor.T @ factor)
    seen = values > least
    return values[seen], factor @ vectors[:, seen] / np.sqrt(values[seen])


def _within(factor: FloatArray, rows: Sequence[slice], least: float) -> list[FloatArray]:
    """(n_bins, rank) directions of every experiment alone, which hold all that is in F.

    The whole has far fewer of them than bins where it acts in a part of the time only.
    """
    found = []
    for at in rows:
        part = factor[at]
        part = part[:, np.any(part != 0.0, axis=0)]
        values, vectors = np.linalg.eigh(part @ part.T)
        found.append(vectors[:, values > least])
    return found
