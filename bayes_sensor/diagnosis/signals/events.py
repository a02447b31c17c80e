"""Detector: single events while a record is quiet.

The noise floor is estimated from the quiet stretches, so an event in one of them raises the floor
that it is judged by.  This test at full rate looks for what stationary Gaussian noise of *any*
spectrum does not do: a difference of means much larger than usual at the same time scale.  A
finding counts as an unlisted cause.
"""

from __future__ import annotations

from collections.abc import Hashable, Mapping, Sequence
from dataclasses import replace
from math import sqrt
from typing import TypeVar

import numpy as np
from scipy.stats import norm
from scipy.stats import t as student_t

from bayes_sensor.campaign import Campaign, FloatArray
from bayes_sensor.diagnosis.data.quiet_stretches import Stretch, detrended
from bayes_sensor.diagnosis.signals.signal import (
    FOUND,
    Finding,
    Place,
    Samples,
    Signal,
    moment,
    struck,
)

BLOCK = 0.05
"""s, means over which events are looked for"""
WIDTHS = (0.15, 0.25, 0.42, 0.7, 1.15, 1.9, 3.1, 5.0)
"""s, of a bump or of the means on either side of a jump"""
EVENT_RATIOS = (4.0, 16.0, 64.0)
"""an event's plausible variance over the noise's"""
LOCAL = 20
"""blocks over which the local size of the noise is taken"""
STRUCK = 0.3
"""plausible share of stretches with an event, where there are any"""
BUMP_SPAN = 5
"""widths that a bump and its sides take"""
MEDIAN_SIZE = float(norm.ppf(0.75))
"""median of a standard Gaussian's absolute values"""
MEDIAN_EFFICIENCY = 0.37
"""of a spread taken from the median of absolute values (Hampel 1974)"""
TAIL_CAUTION = 1.5
"""standard errors of the tails' length that are given to a Gaussian"""
TAIL_LEVELS = (0.95, 0.99)
TAIL_DOFS = np.array([2.0, 2.5, 3.0, 4.0, 5.0, 7.0, 10.0, 15.0, 25.0, 50.0, 100.0])
HEAVY_DOF = 8.0
"""degrees of freedom where single samples are heavy-tailed"""
FOOTPRINT = 5.0
"""widths over which an event is seen"""
SPARE = 0.2
"""share of what lies beyond a quantile that one event may make up"""
_HALF = [0.5 + 0.5 * level for level in TAIL_LEVELS]
_RATIOS = [student_t.ppf(h, TAIL_DOFS) / student_t.ppf(0.75, TAIL_DOFS) for h in _HALF]
_SLOPES = [2.0 * float(norm.pdf(norm.ppf(h)) * norm.ppf(h)) for h in _HALF]


Key = TypeVar("Key", bound=Hashable)


def look_for_events(
    campaign: Campaign, stretches: Sequence[Stretch], heavy_tailed: bool = False
) -> Finding:
    """Bumps and jumps in single stretches.

    Differences of means (a bump against both its sides, after against before) are taken in units
    of how much samples change from one to the next there, so that gusts of noise are none, and of
    the size of the shortest bumps in their record, since a converter's range and the sampling
    interval are a record's own.  They are scaled by their median absolute value over all stretches
    with the same gas, so that the noise's spectrum does not matter and an event that is rare in
    time does not hide itself; the tails of that noise are measured on either side.
    ``heavy_tailed``: single samples are, and so means over a few of them may be.
    ``ln B`` of a stretch averages, over positions and the amplitude's plausible spread, the ratio
    of t densities; widths and shapes are averaged over for each stretch, or for all together,
    since what strikes again lasts as long again.  ``strength``: the clearest event's experiment
    (counted from 0), time in s and ratio to the usual.
    """
    cut = [event_blocks(campaign, s) for s in stretches]
    use = [(s, *made) for s, made in zip(stretches, cut, strict=True) if made is not None]
    sizes = _own_sizes([(s, x, q, dt) for s, (x, q), dt in use])
    use = [(s, (x / size, q), dt) for (s, (x, q), dt), size in zip(use, sizes, strict=True)]
    found: list[dict[Hashable, float]] = [{} for _ in use]
    clearest = [Place(u[0].experiment, 0.0, 0.0) for u in use]
    tails: dict[tuple[str, int], tuple[float, float]] = {}
    for width in WIDTHS:
        for shape, span in ((bump, BUMP_SPAN), (_jump, 2)):
            blocks = [max(1, round(width / dt)) for _, _, dt in use]
            made = [
                shape(x, m) / local_size(q, m, span)
                for (_, (x, q), _), m in zip(use, blocks, strict=True)
            ]
            for level in (0, 1):
                here = [k for k, u in enumerate(use) if u[0].level == level and len(made[k]) > 0]
                if not here:
                    continue
                values = np.concatenate([made[k] for k in here])
                usual = usual_size(values)
                if usual <= 0.0:
                    continue
                seconds = sum(len(made[k]) * use[k][2] for k in here)
                last = tails.get((shape.__name__, level), (np.inf, np.inf))
                below, above = _tails(values / usual, seconds, width, last)
                tails[shape.__name__, level] = below, above
                known = min(known_dof(seconds, width), HEAVY_DOF if heavy_tailed else np.inf)
                for k in here:
                    square = (made[k] / usual) ** 2
                    dof = np.minimum(np.where(made[k] > 0.0, above, below), known)
                    found[k][width, shape.__name__] = _surprise(square, dof)
                    # brought to a Gaussian's tails, so that widths compare
                    clear = dof * np.log1p(square / dof)
                    at = int(np.argmax(clear))
                    if clear[at] > clearest[k].size:
                        stretch, _, dt = use[k]
                        when = stretch.begin + (at + 0.5 * span * blocks[k]) * dt
                        clearest[k] = Place(stretch.experiment, when, float(clear[at]))
    found_event = of_places(SIGNAL, found, clearest)
    baseline, plateau = (
        min((min(d) for (_, level), d in tails.items() if level == gas), default=np.inf)
        for gas in (0, 1)
    )
    return replace(found_event, tails=(baseline, plateau))


def _own_sizes(records: Sequence[tuple[Stretch, FloatArray, FloatArray, float]]) -> FloatArray:
    """(n,) usual size of the shortest bumps of every stretch: itself, means, changes, step s.

    Stretches of one record with the same gas go together.  What they tell leans on the other
    records as far as these are no more unlike than chance makes them.
    """
    made: dict[tuple[int, int], list[FloatArray]] = {}
    seconds: dict[tuple[int, int], float] = {}
    for stretch, means, changes, dt in records:
        m = max(1, round(WIDTHS[0] / dt))
        bumps = bump(means, m) / local_size(changes, m, BUMP_SPAN)
        key = (stretch.experiment, stretch.level)
        made.setdefault(key, []).append(bumps)
        seconds[key] = seconds.get(key, 0.0) + len(bumps) * dt
    told = {key: np.concatenate(x) for key, x in made.items() if seconds[key] > 0.0}
    found: dict[tuple[int, int], float] = {}
    for level in (0, 1):
        here = {key: x for key, x in told.items() if key[1] == level}
        found |= sizes_of_records(here, {key: seconds[key] for key in here}, WIDTHS[0])
    return np.array([found.get((s.experiment, s.level), 1.0) for s, *_ in records])


def sizes_of_records(
    made: Mapping[Key, FloatArray], seconds: Mapping[Key, float], width: float
) -> dict[Key, float]:
    """Usual size of the ``made`` (n,) of every record, over so many ``seconds`` s.

    That of all together, times what a record's own differs from the others' by, as far as records
    are less alike than the errors of ``width`` s wide differences leave them.
    """
    own = {key: usual_size(x) for key, x in made.items() if len(x) > 0}
    own = {key: size for key, size in own.items() if size > 0.0}
    if not own:
        return {}
    together = usual_size(np.concatenate([made[key] for key in own]))
    logs = np.log(list(own.values()))
    error = np.array([0.5 / known_dof(seconds[key], width) for key in own])
    unlike = max(float(np.mean((logs - logs.mean()) ** 2 - error)), 0.0)
    away = unlike / (unlike + error) * (logs - logs.mean())
    return dict(zip(own, together * np.exp(away), strict=True))


def event_blocks(
    campaign: Campaign, s: Stretch
) -> tuple[tuple[FloatArray, FloatArray], float] | None:
    """Detrended means (n,) over BLOCK, mean squared changes (n,) from sample to sample, step (s).

    Both in units of the changes in the whole stretch.
    """
    h = campaign.experiments[s.experiment].interval
    size = max(1, round(BLOCK / h))
    n = len(s.samples) // size
    if n < 40:
        return None
    x = detrended(s.samples[: n * size])
    change = np.diff(x, prepend=x[0]) ** 2
    scale = float(np.sqrt(np.mean(change)))
    if scale <= 0.0:
        return None
    means = x.reshape(n, size).mean(axis=1) / scale
    return (means, change.reshape(n, size).mean(axis=1) / scale**2), size * h


def bump(x: FloatArray, m: int) -> FloatArray:
    """(n - 5 m + 1,) means over m blocks of ``x`` (n,) minus those of 2 m on both sides.

    Empty where the record is short.
    """
    if len(x) < 6 * m:
        return np.empty(0)
    c = np.concatenate([[0.0], np.cumsum(x, dtype=float)])
    i = np.arange(len(x) - BUMP_SPAN * m + 1)
    sides = (c[i + 2 * m] - c[i]) + (c[i + 5 * m] - c[i + 3 * m])
    return np.asarray((c[i + 3 * m] - c[i + 2 * m]) / m - sides / (4 * m))


def _jump(x: FloatArray, m: int) -> FloatArray:
    """(n - 2 m + 1,) means over the m blocks after minus those before."""
    if len(x) < 6 * m:
        return np.empty(0)
    c = np.concatenate([[0.0], np.cumsum(x)])
    j = np.arange(len(x) - 2 * m + 1)
    return np.asarray((c[j + 2 * m] - 2.0 * c[j + m] + c[j]) / m)


def local_size(changes: FloatArray, m: int, span: int) -> FloatArray:
    """(n - span m + 1,) root mean square of the changes within ``span`` m blocks.

    Over LOCAL of them at least, and not below that of the whole stretch: where noise moves more
    slowly for a while its changes are small and its means are not.  Empty where the record is
    short.
    """
    if len(changes) < 6 * m:
        return np.empty(0)
    length = span * m
    begins = np.arange(len(changes) - length + 1)
    total = np.concatenate([[0.0], np.cumsum(changes)])
    wider = max(LOCAL - length, 0) // 2
    low = np.maximum(begins - wider, 0)
    high = np.minimum(begins + length + wider, len(changes))
    local: FloatArray = np.sqrt(np.maximum((total[high] - total[low]) / (high - low), 1.0))
    return local


def usual_size(made: FloatArray) -> float:
    """Standard deviation of a Gaussian with the median size of ``made`` (n,)."""
    return float(np.median(np.abs(made))) / MEDIAN_SIZE


def known_dof(seconds: float, width: float) -> float:
    """Degrees of freedom of :func:`usual_size` over ``seconds`` s, of what is ``width`` s wide."""
    return max(MEDIAN_EFFICIENCY * seconds / width, 3.0)


def tail_dof(sizes: FloatArray, seconds: float, width: float) -> float | None:
    """Degrees of freedom of the t law that is as long-tailed as ``sizes`` (n,), median .6745.

    Gusts and shots lengthen the tails at every time scale they act on; without that, each of them
    would be an event.  From ratios of quantiles to the median, less what the number of independent
    values leaves open, and none that a single event would move; None where no quantile is left.
    """
    found = []
    for level, ratios, slope in zip(TAIL_LEVELS, _RATIOS, _SLOPES, strict=True):
        if FOOTPRINT * width > SPARE * (1.0 - level) * seconds:
            continue
        ratio = float(np.quantile(sizes, level)) / MEDIAN_SIZE
        error = sqrt(level * (1.0 - level) / max(seconds / width, 1.0)) / slope
        ratio *= 1.0 - TAIL_CAUTION * error
        longer = ratio > ratios[-1]
        found.append(float(np.interp(-ratio, -ratios, TAIL_DOFS)) if longer else np.inf)
    return min(found, default=None)


def _tails(
    values: FloatArray, seconds: float, width: float, last: tuple[float, float]
) -> tuple[float, float]:
    """Degrees of freedom of differences (n,) of median size .6745 below 0 and above it.

    Noise that is squared on its way has a long tail on one side only; where both have one, both
    together tell it best.  Where records are too short to tell a side's, it is that of the ``last``
    width that was told.
    """
    both = tail_dof(np.abs(values), seconds, width)
    sides = []
    for side, before in zip((values < 0.0, values > 0.0), last, strict=True):
        own = tail_dof(np.abs(values[side]), seconds * float(side.mean()), width)
        sides.append(min(before if own is None else own, np.inf if both is None else both))
    below, above = sides
    return below, above


def _surprise(square: FloatArray, dof: FloatArray) -> float:
    """ln of the mean over positions and spreads of the ratio of t densities."""
    return float(np.logaddexp.reduce(surprises(square, dof)) - np.log(len(square)))


def surprises(square: FloatArray, dof: float | FloatArray) -> FloatArray:
    """(n,) ln of the mean over spreads of the ratio of t densities, per position."""
    wider = 1.0 + np.array(EVENT_RATIOS)[:, None]
    logs = 0.5 * (dof + 1.0) * (np.log1p(square / dof) - np.log1p(square / dof / wider))
    logs -= 0.5 * np.log(wider)
    return np.asarray(np.logaddexp.reduce(logs, axis=0) - np.log(len(wider)))


def of_places(
    signal: Signal, found: Sequence[Mapping[Hashable, float]], clearest: Sequence[Place]
) -> Finding:
    """The finding of several places (records, switches), each with ln B for every kind of event.

    Affected places have a kind each, or all the same.  Reported are the ``clearest`` moment of all
    and those of the places that are more likely affected than not.
    """
    each = np.array(
        [np.logaddexp.reduce(list(x.values())) - np.log(len(x)) if x else 0.0 for x in found]
    )
    alone = float(struck(each, STRUCK).sum())
    alike: dict[Hashable, float] = {}
    for logs in found:
        spared_or_not = struck(np.array(list(logs.values())), STRUCK).tolist()
        for kind, value in zip(logs, spared_or_not, strict=True):
            alike[kind] = alike.get(kind, 0.0) + value
    together = (
        float(np.logaddexp.reduce(list(alike.values()))) - np.log(len(alike)) if alike else 0.0
    )
    first = max(clearest, key=lambda p: p.size, default=Place(0, 0.0, 0.0))
    odds = each + np.log(STRUCK / (1.0 - STRUCK))
    kept = (p for p, o in zip(clearest, odds, strict=True) if o > 0.0 or p is first)
    ratio = first.size**0.5
    strength = {
        f"{signal.name}_experiment": float(first.experiment),
        f"{signal.name}_s": first.time,
        f"{signal.name}_ratio": ratio,
    }
    value = float(np.logaddexp(alone, together) - np.log(2.0))
    return Finding(signal, value, strength, ratio, tuple(p for p in kept if p.size > 0.0))


def _words(found: Finding, names: Sequence[str], unit: str) -> str:
    s = found.strength
    return (
        f"In experiment {names[int(s['event_experiment'])]} something happens once, near "
        f"{moment(s['event_s'])} s: {s['event_ratio']:.2g} times the noise's usual size at "
        "that time scale."
    )


def _look(samples: Samples) -> list[Finding]:
    tails = samples.of("heavy_tails")
    heavy = tails is not None and tails.probability > FOUND
    return [look_for_events(samples.campaign, samples.stretches, heavy)]


SIGNAL = Signal(
    "event", 0.025, {"event_s": "s", "event_ratio": "1"}, _words, _look, on_quiet_stretches=True
)
