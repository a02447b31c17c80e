"""Signal: the level of a single record changes, for a while, until the fall, or for good."""

from __future__ import annotations

from collections.abc import Hashable, Sequence
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from bayes_sensor.campaign import FloatArray
from bayes_sensor.diagnosis.data.bins import ExperimentBins
from bayes_sensor.diagnosis.signals.events import of_places, surprises
from bayes_sensor.diagnosis.signals.signal import Finding, Place, Samples, Signal, moment

if TYPE_CHECKING:
    from bayes_sensor.diagnosis.evidence.refit import Refit

CHANGE_LENGTHS = (1, 2, 3, 5, 8, 13, 21)
"""bins that a passing change lasts"""
ABSORBED = 0.1
"""share of a change that a refit must leave of it, for the change to be looked for"""


def look_for_level_changes(found: Refit, tail: float = np.inf) -> Finding:
    """Changes of level in single records: passing, until the fall, or permanent.

    On a plateau what happens once looks like a drift.  A score test per record: a change of so many
    volts between two edges of bins, what the refit's own coordinates would take up of it left out.
    ``ln B`` of a record averages over begins and lengths the ratio of t densities, as in
    :mod:`~bayes_sensor.diagnosis.signals.local_misfit`; they are averaged over for each
    record, or for all together.
    """
    binned, coords = found.coords.binned, found.coords
    dof = min(binned.floor.level_dof, tail)
    covariance = found.covariance
    places: list[dict[Hashable, float]] = []
    clearest = []
    for k, (rows, b) in enumerate(zip(binned.rows, binned.bins, strict=True)):
        shapes, spans = level_changes(b.falling)
        templates = binned.inverse_factors[k] @ shapes
        columns = coords.columns(k)
        inside = found.jacobian[rows, columns].T @ templates
        own = covariance[np.ix_(columns, columns)]
        whole = np.sum(templates**2, axis=0)
        left = whole - np.sum(inside * (own @ inside), axis=0)
        use = left > ABSORBED * whole
        if not np.any(use):
            continue
        square = (found.residual[rows] @ templates[:, use]) ** 2 / left[use]
        edges = _edges(b)
        kinds = [(edges[i], edges[j]) for i, j in spans[use].tolist()]
        places.append(dict(zip(kinds, surprises(square, dof), strict=True)))
        begins = b.first[spans[use][int(np.argmax(square)), 0]]
        clearest.append(Place(k, float(b.experiment.t[begins]), float(square.max())))
    return of_places(SIGNAL, places, clearest)


def _edges(b: ExperimentBins) -> list[tuple[str, int]]:
    """Where each bin begins, counted from the switch before, since records differ in length.

    After the last bin the record's end, ``("end", 0)``.
    """
    number = np.maximum(b.last_switch, 0)
    first = np.searchsorted(b.last_switch, number)
    begins = [
        (f"switch {j}", i - int(at)) for i, (j, at) in enumerate(zip(number, first, strict=True))
    ]
    return [*begins, ("end", 0)]


def level_changes(falling: NDArray[np.bool_]) -> tuple[FloatArray, NDArray[np.int64]]:
    """(n_bins, m) ones where a change lasts, and (m, 2) the bins it begins with and ends before.

    A change lasts for a while, until a later step down, or for good.
    """
    n = len(falling)
    falls = np.flatnonzero(np.diff(falling.astype(int), prepend=0) > 0)
    ends = np.append(falls, n)
    spans = {
        (i, int(j))
        for i in range(1, n)
        for j in (*(i + m for m in CHANGE_LENGTHS), ends[np.searchsorted(ends, i, side="right")], n)
        if i < j <= n
    }
    ordered = np.array(sorted(spans), dtype=np.int64)
    at = np.arange(n)[:, None]
    shapes = (at >= ordered[:, 0]) & (at < ordered[:, 1])
    return shapes.astype(float), ordered


def _words(found: Finding, names: Sequence[str], unit: str) -> str:
    s = found.strength
    return (
        f"In experiment {names[int(s['break_experiment'])]} the level changes at about "
        f"{moment(s['break_s'])} s in a way of its own"
        f" ({s['break_ratio']:.2g} standard deviations)."
    )


def _look(samples: Samples) -> list[Finding]:
    event = samples.of("event")
    return [look_for_level_changes(samples.fitted, np.inf if event is None else event.lasting)]


SIGNAL = Signal(
    "break",
    0.025,
    {"break_s": "s", "break_ratio": "1"},
    _words,
    _look,
    of_the_mean=True,
    sets_in=True,
)
