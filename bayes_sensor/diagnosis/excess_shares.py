"""Distribute the excess over the cells, by explanation or by sample-level finding.

A visible gap is a small part of the noise, so that what a cell has above it is mostly chance.  An
explanation of a few numbers, or a smooth process, takes little of that.  Averaged over all of them,
something unlisted included, the squares of what they take are the excess to be expected in a cell.
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
from bayes_sensor.diagnosis.location import CLEAR, ExcessMap, normalised_shares, parts_of_cells
from bayes_sensor.diagnosis.signals.signal import FOUND, Finding

UNMOVED = 0.5
"""probability that nothing moves the mean from which no explanation tells where it is moved"""
LEAST = 1e-3
"""probability of an explanation below which it is left out"""


def distribute_excess(
    located: ExcessMap, comparison: Comparison, findings: Sequence[Finding], kind: str
) -> ExcessMap:
    """The map with the excess shared out by what explains it.

    By all explanations together where something moves the mean; by the findings in single samples
    where the verdict is an unlisted cause; as measured otherwise.
    """
    binned = comparison.binned
    clear = located.p_value_of_size < CLEAR
    if kind == "none" and not clear:
        return located
    keys = [h.key for h in comparison.hypotheses]
    if comparison.probabilities[keys.index("none")] < UNMOVED:
        return shared_by_explanations(located, binned, explained_excess(comparison))
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
    return shared_by_findings(located, places)


def explained_excess(comparison: Comparison) -> FloatArray:
    """(n_bins in all, n) what each explanation takes, times the root of its probability.

    Whitened as residuals are: a sum of squares is the excess to be expected there, in variances of
    the noise.
    """
    before = comparison.base.residual
    found = [np.zeros_like(before)]
    for h, p in zip(comparison.hypotheses, comparison.probabilities, strict=True):
        if p < LEAST or h.key == "none":
            continue
        for term in h.terms:
            left = Linearised(term.refit).left(term.beside)
            found.append(sqrt(p * term.share) * (before - left))
    return np.column_stack(found)


def shared_by_explanations(
    located: ExcessMap, binned: BinnedCampaign, explained: FloatArray
) -> ExcessMap:
    """The map with the excess that explanations put into its cells, in place of the measured one.

    ``explained`` (n_bins in all, n): of :func:`explained_excess`.
    """
    parts = parts_of_cells(binned)
    whole = len(located.cells)
    power = np.array([np.sum((part.transform @ explained[part.rows]) ** 2) for part in parts])
    shares = normalised_shares(power, whole)
    volts = np.zeros(len(parts))
    for i, part in enumerate(parts[:whole]):
        k = part.experiment
        local = part.rows - binned.rows[k].start
        n = binned.bins[k].count[local]
        volts_there = binned.floor.cholesky[k][local] @ explained[binned.rows[k]]
        volts[i] = np.sqrt(n @ np.sum(volts_there**2, axis=1) / np.sum(n))
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
