"""Signal: local misfit after the best explanation.

A misfit at one switch that is absent or different at the next has no common shape, and a smooth
discrepancy would need one parameter for each of them.  Two kinds are tested: runs of bins at a
single switch, and bumps shorter than a bin.
"""

from __future__ import annotations

from collections.abc import Hashable, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from bayes_sensor.campaign import FloatArray
from bayes_sensor.diagnosis.data.quiet_stretches import QuietSpans
from bayes_sensor.diagnosis.signals.events import (
    BUMP_SPAN,
    bump,
    known_dof,
    local_size,
    of_places,
    sizes_of_records,
    surprises,
    tail_dof,
)
from bayes_sensor.diagnosis.signals.signal import Finding, Place, Samples, Signal, any_of

if TYPE_CHECKING:
    from bayes_sensor.diagnosis.evidence.refit import Refit

SPAN = (-1.2, 8.0)
"""time scales around a switch"""
RUN_BINS = (1, 2, 3, 4, 6)
"""bins in a run"""

SHORT_BLOCK = 0.01
"""s, means over which patches are looked for that are shorter than bins"""
SHORTEST = 2
"""blocks of the narrowest of them"""
WIDER = 1.6
"""times by which one width exceeds the one before"""
WIDEST = 0.3
"""time scales, from where runs of bins show as much"""
EARLIEST = 0.3
"""time scales before the fitted switch, which a misplaced one may miss by"""
FEWEST = 100
"""positions in quiet spans below which the usual size is not known"""


def look_for_local_misfit(
    found: Refit,
    residuals: Sequence[FloatArray],
    quiet: Sequence[QuietSpans],
    tail: float = np.inf,
) -> Finding:
    """Misfit at single switches, for longer than a bin or shorter.

    ``residuals``: (n_t,) V of every experiment, what the refit leaves; ``tail``: degrees of
    freedom of the noise's own means.
    """
    short = find_short_bumps(found, residuals, quiet, tail)
    return any_of([find_runs_of_bins(found, tail), *([] if short is None else [short])])


def _patch(
    places: Sequence[dict[Hashable, float]], clearest: Sequence[Place], since: Sequence[float]
) -> Finding:
    """What all switches say; ``since`` (n,) s, from the switch to its clearest moment."""
    told = of_places(SIGNAL, places, clearest)
    first = max(range(len(clearest)), key=lambda i: clearest[i].size, default=None)
    after = 0.0 if first is None else since[first]
    return replace(told, strength={**told.strength, "patch_since_s": after})


def find_runs_of_bins(found: Refit, tail: float) -> Finding:
    """Runs of bins around single switches that lie on one side of a refit.

    Per switch, ``ln B`` averages over runs of bins the ratio of densities of their whitened sum,
    wider against usual, the usual with the floor's degrees of freedom, or with those of the noise's
    own ``tail``; runs are averaged over for each switch, or for all together.
    """
    binned = found.coords.binned
    dof = min(binned.floor.level_dof, tail)
    places: list[dict[Hashable, float]] = []
    clearest, since = [], []
    for k, (rows, b) in enumerate(zip(binned.rows, binned.bins, strict=True)):
        z = found.residual[rows]
        number = np.maximum(b.last_switch, 0)
        for switch in range(len(b.switches)):
            here = np.flatnonzero(
                (number == switch)
                & (b.since > SPAN[0] * binned.time_scale)
                & (b.since < SPAN[1] * binned.time_scale)
            )
            if len(here) < max(RUN_BINS):
                continue
            total = np.concatenate([[0.0], np.cumsum(z[here])])
            squares = [(total[m:] - total[:-m]) ** 2 / m for m in RUN_BINS]
            largest = max(squares, key=lambda s: float(s.max()))
            middle = here[int(np.argmax(largest))]
            clearest.append(Place(k, float(b.centre[middle]), float(largest.max())))
            since.append(float(b.since[middle]))
            # bins are counted from the switch: the same number is the same time after it
            first = np.arange(len(here)) - int(np.sum(b.since[here] < 0.0))
            places.append({
                (m, int(at)): value
                for m, square in zip(RUN_BINS, squares, strict=True)
                for at, value in zip(first, surprises(square, dof), strict=False)
            })  # fmt: skip
    return _patch(places, clearest, since)


def find_short_bumps(
    found: Refit, residuals: Sequence[FloatArray], quiet: Sequence[QuietSpans], tail: float
) -> Finding | None:
    """Bumps shorter than bins between a switch and the next quiet span.

    A relay that settles, a valve that bounces: bins average what is shorter than they are, and
    events are looked for only where a record is quiet.  Means over some blocks less those on both
    sides, in units of how much samples change from one to the next there, and of their usual size
    in the record's quiet spans, the louder gas's at all times; ``ln B`` as in
    :func:`find_runs_of_bins`.  None where records are too short to tell what is usual.
    """
    binned = found.coords.binned
    blocks = []
    for e, r, q in zip(binned.campaign, residuals, quiet, strict=True):
        y = r / q.deviation
        size = max(1, round(SHORT_BLOCK / e.interval))
        n = len(y) // size
        means, changes = (
            v[: n * size].reshape(n, size).mean(axis=1) for v in (y, np.diff(y, prepend=y[0]) ** 2)
        )
        changes = changes / max(float(np.mean(changes)), 1e-300)
        blocks.append((means, changes, size * e.interval, float(e.t[0])))
    places: dict[tuple[int, float], dict[Hashable, float]] = {}
    clearest: dict[tuple[int, float], Place] = {}
    for width in _widths(max(step for _, _, step, _ in blocks), binned.time_scale):
        made = [_Bumps.of(*record, width) for record in blocks]
        known = _usual(made, quiet, width)
        if known is None:
            continue
        usual, dof = known
        for k, (bumps, q) in enumerate(zip(made, quiet, strict=True)):
            for switch, until in zip(q.switches, [*q.switches[1:], np.inf], strict=True):
                end = min([until, *(a for a, _ in q.spans if a > switch)])
                since = bumps.middles - switch
                here = (since >= -EARLIEST * binned.time_scale) & (bumps.middles < end)
                if not np.any(here):
                    continue
                square = (bumps.heights[here] / usual[k]) ** 2
                # blocks are counted from the switch: the same number is the same time after it
                kinds = [(width, int(n)) for n in np.rint(since[here] / bumps.step)]
                values = surprises(square, min(dof, tail, binned.floor.level_dof))
                places.setdefault((k, switch), {}).update(zip(kinds, values, strict=True))
                at = int(np.argmax(square))
                place = Place(k, float(bumps.middles[here][at]), float(square[at]))
                if (k, switch) not in clearest or place.size > clearest[k, switch].size:
                    clearest[k, switch] = place
    if not places:
        return None
    since_switch = [clearest[key].time - key[1] for key in places]
    return _patch(list(places.values()), [clearest[key] for key in places], since_switch)


@dataclass(frozen=True, eq=False)
class _Bumps:
    """Bumps of one width in one record."""

    heights: FloatArray
    """(n,) standard deviations of a sample's noise, as loud as it is there"""
    middles: FloatArray
    """(n,) s"""
    step: float
    """s, from one to the next"""
    reach: float
    """s, to the ends of both sides"""

    @classmethod
    def of(
        cls, means: FloatArray, changes: FloatArray, step: float, begin: float, width: float
    ) -> _Bumps:
        """Bumps of ``width`` s in the ``means`` (n,) over blocks of ``step`` s from ``begin`` s.

        ``changes`` (n,): squared, from sample to sample, over those of the whole record.
        """
        m = max(1, round(width / step))
        heights = bump(means, m) / local_size(changes, m, BUMP_SPAN)
        reach = 0.5 * BUMP_SPAN * m * step
        middles = np.asarray(begin + reach + np.arange(len(heights)) * step)
        return cls(heights, middles, step, reach)


def _usual(
    made: Sequence[_Bumps], quiet: Sequence[QuietSpans], width: float
) -> tuple[dict[int, float], float] | None:
    """Usual size of bumps of ``width`` s in every record's quiet spans, at the louder gas; the dof.

    None where neither gas has enough of them.
    """
    sizes: dict[int, float] = {}
    dofs = []
    for plateau in (False, True):
        some = {
            k: np.concatenate([
                b.heights[(b.middles - b.reach >= low) & (b.middles + b.reach <= high)]
                for (low, high), on_plateau in zip(q.spans, q.high, strict=False)
                if on_plateau == plateau
            ] or [np.empty(0)])
            for k, (b, q) in enumerate(zip(made, quiet, strict=True))
        }  # fmt: skip
        if sum(len(x) for x in some.values()) < FEWEST:
            continue
        seconds = {k: len(x) * made[k].step for k, x in some.items()}
        own = sizes_of_records(some, seconds, width)
        if not own:
            continue
        whole = sum(seconds.values())
        told = tail_dof(np.concatenate([np.abs(some[k]) / own[k] for k in own]), whole, width)
        dofs.append(min(known_dof(whole, width), np.inf if told is None else told))
        usual = float(np.exp(np.mean(np.log(list(own.values())))))
        sizes = {k: max(sizes.get(k, 0.0), own.get(k, usual)) for k in range(len(made))}
    return (sizes, min(dofs)) if sizes else None


def _widths(block: float, time_scale: float) -> FloatArray:
    """(n,) s, of bumps from the shortest that blocks show to where bins show as much."""
    first, last = SHORTEST * block, WIDEST * time_scale
    steps = int(np.log(max(last / first, 1.0)) / np.log(WIDER))
    return np.asarray(first * WIDER ** np.arange(steps + 1))


def _words(found: Finding, names: Sequence[str], unit: str) -> str:
    s = found.strength
    side = "after" if s["patch_since_s"] >= 0.0 else "before"
    return (
        "Single switches leave the model for moments, clearest in experiment "
        f"{names[int(s['patch_experiment'])]}, {abs(s['patch_since_s']):.2g} s {side} a switch."
    )


def _look(samples: Samples) -> list[Finding]:
    event = samples.of("event")
    tail = np.inf if event is None else event.lasting
    return [look_for_local_misfit(samples.fitted, samples.residuals, samples.quiet, tail)]


SIGNAL = Signal(
    "patch", 0.025, {"patch_s": "s", "patch_since_s": "s", "patch_ratio": "1"}, _words, _look,
    of_the_mean=True,
)  # fmt: skip
