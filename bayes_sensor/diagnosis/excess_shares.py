"""Distribute the excess over the cells: what the explanations themselves add, or findings show.

A visible gap is a small part of the noise, so the measured excess of one cell is mostly chance. A
joint fit also spreads a misfit over the phases, because the other parameters move. So the excess
is distributed by what the explanations add. What an effect adds is the model with the effect minus
the model without it, at the same parameters: a step after the pulse lies in the tail, and a jump
on the plateau on the plateau. A discrepancy adds its own mean. Each explanation distributes what
it takes of the excess in proportion to the square of what it adds; the result is the mean over all
explanations, weighted by their probabilities.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from math import sqrt

import numpy as np

from bayes_sensor.campaign import FloatArray
from bayes_sensor.diagnosis.data.binned_campaign import BinnedCampaign
from bayes_sensor.diagnosis.evidence.compared_hypotheses import Comparison
from bayes_sensor.diagnosis.evidence.laplace_evidence import Linearised
from bayes_sensor.diagnosis.evidence.refit import Refit
from bayes_sensor.diagnosis.isolability import without_parts
from bayes_sensor.diagnosis.location import (
    CLEAR,
    Cell,
    ExcessMap,
    normalised_shares,
    parts_of_cells,
)
from bayes_sensor.diagnosis.probabilities import LEAST
from bayes_sensor.diagnosis.signals.signal import FOUND, Finding, Samples

REWEIGHTED, ROUGH = 30, 1e-3
"""steps of the least absolute deviations, and the share of the largest deviation that is one of 0:
the shares have two digits"""
UNMOVED = 0.5
"""probability that nothing moves the mean from which no explanation tells where it is moved"""


def distribute_excess(
    located: ExcessMap,
    comparison: Comparison,
    samples: Samples,
    findings: Sequence[Finding],
    kind: str,
) -> ExcessMap:
    """The map with the excess shared out by what explains it.

    By all explanations together where something moves the mean; by the findings in single samples
    where the verdict is an unlisted cause; as measured otherwise.  A line without a place of its
    own lies where ``samples`` have its power.
    """
    binned = comparison.binned
    clear = located.p_value_of_size < CLEAR
    if kind == "none" and not clear:
        return located
    keys = [h.key for h in comparison.hypotheses]
    if comparison.probabilities[keys.index("none")] < UNMOVED:
        return shared_by_explanations(located, binned, *explained_excess(comparison))
    if kind != "unlisted":
        return located
    found = [f for f in findings if f.probability > FOUND]
    names = [e.name for e in binned.campaign]
    places = [(names[p.experiment], p.time, p.size) for f in found for p in f.places]
    for f in found:
        if f.signal.phase and not clear:
            on = [c for c in located.cells if c.phase == f.signal.phase]
            size = 2.0 * f.log_bayes_factor / sum(c.t_end_s - c.t_start_s for c in on)
            places += [(c.experiment, c.t_start_s, size * (c.t_end_s - c.t_start_s)) for c in on]
    for hz in {f.frequency for f in found if f.frequency and not f.places}:
        places += [
            (names[k], cell.t_start_s, power)
            for k in range(len(names))
            for cell in located.cells
            if cell.experiment == names[k]
            for power in [_line_power(samples, k, cell, hz)]
        ]
    return shared_by_findings(located, places)


def _line_power(samples: Samples, k: int, cell: Cell, hz: float) -> float:
    # V^2 s of the Fourier component at ``hz`` in a cell of experiment k, above what the noise has
    # beside it, four native resolutions away; never negative
    e = samples.campaign.experiments[k]
    inside = slice(*np.searchsorted(e.t, (cell.t_start_s, cell.t_end_s)))
    t, r = e.t[inside] - e.t[0], samples.residuals[k][inside]
    if len(t) < 2:
        return 0.0
    beside = 4.0 / (t[-1] - t[0])
    at = np.array([hz, hz + beside, max(hz - beside, 0.0)])
    power = np.abs(np.exp(-2j * np.pi * at[:, None] * t) @ r) ** 2 / len(t)
    return float(max(power[0] - power[1:].mean(), 0.0)) * e.interval


def added_by(fitted: Refit, base: Refit) -> FloatArray:
    """V (n_bins in all,), what the parts of a refit add to the mean at its own parameters."""
    n = len(base.coords.parts)
    without = replace(fitted.coords, parts=fitted.coords.parts[:n])
    made: FloatArray = fitted.coords.all_means(fitted.x) - without.all_means(
        without_parts(fitted, n)
    )
    return made


def explained_excess(comparison: Comparison) -> tuple[FloatArray, FloatArray]:
    """What each explanation takes of the misfit, and where it adds it, (n_bins in all, n) V each.

    Times the root of its probability, so that sums of squares are expectations.  Both have the same
    sum of squares over samples: an effect may add much that other parameters take back.
    """
    binned, base = comparison.binned, comparison.base
    count = np.concatenate([b.count for b in binned.bins]).astype(float)
    before = base.residual
    taken, added = [np.zeros_like(before)], [np.zeros_like(before)]
    for h, p in zip(comparison.hypotheses, comparison.probabilities, strict=True):
        if p < LEAST or h.key == "none":
            continue
        for term in h.terms:
            share = sqrt(p * term.share)
            line = Linearised(term.refit)
            gone = share * in_volts(binned, before - line.left(term.beside))
            whole = added_by(term.refit, base)
            if term.beside is not None:
                whole = whole + most_local(term.refit, line.discrepancy(term.beside))
            size = float(count @ whole**2)
            if size > 0.0:
                taken.append(gone)
                added.append(whole * sqrt(float(count @ gone**2) / size))
    return np.column_stack(taken), np.column_stack(added)


def most_local(fitted: Refit, whitened: FloatArray) -> FloatArray:
    """V (n_bins in all,), a discrepancy with what the other parameters could take of it moved.

    A discrepancy is only told up to what y0, beta or a switch time may make: the version with the
    smallest absolute deviation over all samples is the most local one, 0 where it can be (least
    absolute deviations, by reweighting; Schlossmacher 1973).
    """
    binned = fitted.coords.binned
    count = np.concatenate([b.count for b in binned.bins]).astype(float)
    columns = np.column_stack([in_volts(binned, column) for column in fitted.jacobian.T])
    size = np.sqrt(count @ columns**2)
    columns = columns / np.where(size > 0.0, size, 1.0)
    whole = in_volts(binned, whitened)
    left = whole
    least = ROUGH * float(np.max(np.abs(whole)))
    for _ in range(REWEIGHTED if least > 0.0 else 0):
        weight = count / np.maximum(np.abs(left), least)
        normal = columns.T @ (weight[:, None] * columns)
        normal[np.diag_indices_from(normal)] += 1e-9 * np.trace(normal) / len(normal)
        left = whole - columns @ np.linalg.solve(normal, columns.T @ (weight * whole))
    return left


def in_volts(binned: BinnedCampaign, whitened: FloatArray) -> FloatArray:
    """V (n_bins in all,) of whitened bins (n_bins in all,)."""
    each = zip(binned.floor.cholesky, binned.rows, strict=True)
    return np.concatenate([factor @ whitened[rows] for factor, rows in each])


def shared_by_explanations(
    located: ExcessMap, binned: BinnedCampaign, taken: FloatArray, added: FloatArray
) -> ExcessMap:
    """The map with the excess that explanations take, where they add something.

    ``taken``, ``added``: of :func:`explained_excess`.
    """
    parts = parts_of_cells(binned)
    whole = len(located.cells)
    count = np.concatenate([b.count for b in binned.bins])
    squares = np.sum(added**2, axis=1)
    energy = np.array([float(count[part.rows] @ squares[part.rows]) for part in parts[:whole]])
    by_scale = [np.sum((part.transform @ added[part.rows]) ** 2) for part in parts[whole:]]
    shares = normalised_shares(np.array([*energy, *by_scale]), whole)
    total = float(count @ np.sum(taken**2, axis=1))
    volts = [
        sqrt(total * share / float(np.sum(count[part.rows]))) if i < whole else 0.0
        for i, (share, part) in enumerate(zip(shares, parts, strict=True))
    ]
    cells = [
        replace(cell, share=float(shares[i]), excess_rms_V=float(volts[i]))
        for i, cell in enumerate([*located.cells, *located.scales])
    ]
    return replace(
        located,
        cells=tuple(cells[:whole]), scales=tuple(cells[whole:]), shared_by="explanations",
    )  # fmt: skip


def shared_by_findings(located: ExcessMap, found: Sequence[tuple[str, float, float]]) -> ExcessMap:
    """The map with shares where samples tell something: experiment, s and size."""
    power = np.array([
        sum(
            size for name, at, size in found
            if name == cell.experiment and cell.t_start_s <= at < cell.t_end_s
        )
        for cell in located.cells
    ])  # fmt: skip
    if not np.any(power):
        return located
    shares = normalised_shares(power, len(power))
    cells = [replace(c, share=float(s)) for c, s in zip(located.cells, shares, strict=True)]
    return replace(located, cells=tuple(cells), shared_by="findings")
