"""Where the model misses the measurement: experiment, phase and time scale.

The raw excess variance says nothing - a visible gap may be a third of a per cent of the noise -
so the misfit is located in event-locked, noise-whitened bins.  With P the covariance that the
refit leaves of unit noise, the excess of a cell is ``G = z'z - tr P``, of standard deviation
``sqrt(2 tr P^2)``; p-values are those of the largest ratio over all cells, by simulation of the
noise with the refit and with the uncertainty of the floor.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.fft import dct
from scipy.stats import f as f_law

from bayes_sensor.campaign import FREE_SWITCHES, FloatArray
from bayes_sensor.diagnosis.calibration import calibration
from bayes_sensor.diagnosis.data.binned_campaign import BinnedCampaign
from bayes_sensor.diagnosis.data.bins import PHASES
from bayes_sensor.diagnosis.evidence.leverage import Leverage
from bayes_sensor.diagnosis.evidence.refit import Refit, refit
from bayes_sensor.diagnosis.signals.signal import Finding

DRAWS = 2000
"""simulated noises behind the p-values"""
OF_FINDINGS = 0.1
"""share of the whole's level that findings in single samples may use up"""
CLEAR = 0.05
"""p-value below which noise alone would seldom leave as much"""


@dataclass(frozen=True)
class Cell:
    """One experiment in one phase, or one time scale of it."""

    experiment: str
    phase: str
    t_start_s: float
    t_end_s: float
    excess_rms_V: float
    share: float
    p_value: float
    d: float
    """square root of the measured excess, in standard deviations of the noise"""
    measured_excess_rms_V: float
    """above the noise as chance has it; ``excess_rms_V`` is what explanations make of it, if any"""
    scale: str = ""
    scale_s: float | None = None


@dataclass(frozen=True, eq=False)
class ExcessMap:
    """The located excess."""

    cells: tuple[Cell, ...]
    scales: tuple[Cell, ...]
    """the same cells by time scale"""
    left_out: dict[str, float]
    """phase -> detectability of its misfit when it is predicted from a fit without it"""
    p_value: float
    """of the whole: the smallest of the sum's, the largest cell's and the largest signature's,
    times how many of them there are"""
    p_value_of_size: float
    """the same of sum and cells alone"""
    p_value_of_form: float | None
    """of the largest signature of a listed effect among all; None where none was looked for"""
    excess_rms: float
    """V over all samples"""
    d: float
    """square root of the total excess"""
    residuals: tuple[tuple[str, FloatArray, FloatArray, FloatArray, NDArray[np.int64]], ...]
    """per experiment: name, s since the last switch, whitened residual, V, phase of every bin"""
    shared_by: str
    """what the shares rest on: ``measurement``, ``explanations``, ``findings``; ``nothing``: all
    are 0"""


def locate(
    binned: BinnedCampaign,
    base: Refit,
    seed: int = 1,
    bootstrap: int = 0,
    signatures: FloatArray | None = None,
) -> ExcessMap:
    """The excess of a fit over the noise floor, in cells.

    ``bootstrap``: number of simulated campaigns that are refitted nonlinearly; where these leave
    more than the linearised refit, the p-values follow them.  ``signatures`` (n, n_bins in all):
    residual patterns of the effects
    (:func:`~bayes_sensor.diagnosis.signals.effect_signatures.signatures`); a misfit along one may
    be significant although no cell is.
    """
    leverage = base.leverage
    parts = parts_of_cells(binned)
    groups = [part for part in parts if not part.scale]
    whole = len(groups)
    rng = np.random.default_rng(seed)
    noise = rng.standard_normal((binned.n_bins, DRAWS))
    dof = binned.floor.level_dof
    noise *= np.sqrt(dof / rng.chisquare(dof, DRAWS))
    left = leverage.leave(noise)
    z = base.residual
    excess, spread, ratios = [], [], []
    for part in parts:
        rows, transform = part.rows, part.transform
        block = transform @ leverage.block(rows) @ transform.T
        trace, square = float(np.trace(block)), float(np.sum(block**2))
        value = float(np.sum((transform @ z[rows]) ** 2)) - trace
        se = np.sqrt(2.0 * max(square, 1e-12))
        excess.append(value)
        spread.append(se)
        drawn = np.sum((transform @ left[rows]) ** 2, axis=0) - trace
        ratios.append(drawn / se)
    own = np.array(excess) / np.array(spread)
    simulated = np.array(ratios)
    largest = np.sort(simulated[:whole].max(axis=0))
    finest = np.sort(simulated[whole:].max(axis=0)) if len(parts) > whole else largest
    along = np.zeros((0, binned.n_bins)) if signatures is None else signatures
    screened = np.sort(np.max((along @ noise) ** 2, axis=0, initial=0.0))
    of_cells, of_courses = _stretch(
        binned, base, leverage, groups, along, rng, bootstrap, (largest, screened)
    )
    largest, finest, screened = largest * of_cells, finest * of_cells, screened * of_courses

    def p_of(ratio: float, sample: FloatArray) -> float:
        above = len(sample) - int(np.searchsorted(sample, ratio))
        return (above + 1.0) / (len(sample) + 1.0)

    trace = leverage.trace()
    total = base.misfit - trace
    p_sum = float(f_law.sf(base.misfit / trace, trace, dof))
    p_most = p_of(float(own[:whole].max()), largest)
    p_size = min(1.0, 2.0 * min(p_sum, p_most))
    p_form = None
    if len(along):
        most = float(np.max((along @ z) ** 2))
        # beyond the largest simulated value: Bonferroni's bound over all signatures
        at_most = len(along) * float(f_law.sf(most / of_courses, 1, dof))
        p_form = min(p_of(most, screened), at_most)
    p_value = p_size if p_form is None else min(1.0, 1.5 * p_size, 3.0 * p_form)
    clear = p_size < CLEAR
    weight = np.maximum(np.array(excess) - np.array(spread), 0.0) if clear else 0.0 * own
    made = []
    shares = normalised_shares(weight, whole)
    for i, part in enumerate(parts):
        k, rows = part.experiment, part.rows
        b = binned.bins[k]
        local = rows - binned.rows[k].start
        half = 0.5 * b.experiment.interval
        volts = _volts(binned, leverage, z, k, rows) if i < whole else 0.0
        made.append(
            Cell(
                experiment=b.experiment.name,
                phase=PHASES[part.phase],
                t_start_s=float(b.experiment.t[b.first[local[0]]] - half),
                t_end_s=float(b.experiment.t[b.last[local[-1]] - 1] + half),
                excess_rms_V=volts,
                share=float(shares[i]),
                p_value=p_of(float(own[i]), largest if i < whole else finest),
                d=float(np.sqrt(max(excess[i], 0.0))),
                measured_excess_rms_V=volts,
                scale=part.scale,
                scale_s=part.scale_s,
            )
        )
    everywhere = [excess_mean_square(binned, leverage, z, g.experiment, g.rows) for g in groups]
    count = sum(n for _, n in everywhere)
    mean = sum(value * n for value, n in everywhere) / count
    return ExcessMap(
        cells=tuple(made[:whole]),
        scales=tuple(made[whole:]),
        left_out=predict_left_out(binned, base),
        p_value=p_value,
        p_value_of_size=p_size,
        p_value_of_form=p_form,
        excess_rms=float(np.sqrt(max(mean, 0.0))),
        d=float(np.sqrt(max(total, 0.0))),
        residuals=tuple(
            (
                b.experiment.name, b.since, z[rows], binned.floor.cholesky[k] @ z[rows], b.phase,
            )
            for k, (b, rows) in enumerate(zip(binned.bins, binned.rows, strict=True))
        ),
        shared_by="measurement" if np.any(weight) else "nothing",
    )  # fmt: skip


def with_findings(located: ExcessMap, findings: Sequence[Finding]) -> ExcessMap:
    """The map whose p-value takes findings in single samples into account, too.

    Under the null a Bayes factor exceeds b in one of b cases at most (Markov).  With the exponent s
    of the calibration map the largest of n exceeds u^-1 in n u^(1/s) cases, which is less than u
    below .3 for n = 12 and s = .3: its inverse bounds a p-value.  A tenth of the level is spent on
    findings.
    """
    slope = calibration().finding_slope
    logs = [slope * f.log_bayes_factor for f in findings if not f.signal.listed]
    if not logs:
        return located
    of_samples = float(np.exp(-max(logs)))
    p = min(1.0, located.p_value / (1.0 - OF_FINDINGS), of_samples / OF_FINDINGS)
    return replace(located, p_value=p)


def normalised_shares(power: FloatArray, whole: int) -> FloatArray:
    """Of the first ``whole`` cells and of the others, each summing to 1; 0 where there is none."""
    found = np.zeros(len(power))
    for some in (slice(0, whole), slice(whole, None)):
        total = float(np.sum(power[some]))
        if total > 0.0:
            found[some] = power[some] / total
    return found


@dataclass(frozen=True, eq=False)
class CellPart:
    """A cell, or one of its time scales."""

    experiment: int
    phase: int
    rows: NDArray[np.int64]
    """of its bins"""
    transform: FloatArray
    """(n, n_rows) with orthonormal rows, of what is seen there"""
    scale: str = ""
    scale_s: float | None = None


def parts_of_cells(binned: BinnedCampaign) -> list[CellPart]:
    """All cells, then the time scales of each.

    A cell is one phase of one switch; of all switches together where a record has many.
    """
    found = []
    for k, b in enumerate(binned.bins):
        apart = len(b.switches) <= FREE_SWITCHES
        switch = b.segment if apart else np.zeros_like(b.segment)
        for phase in range(len(PHASES)):
            for j in np.unique(switch[b.phase == phase]):
                rows = np.flatnonzero((b.phase == phase) & (switch == j)) + binned.rows[k].start
                found.append(CellPart(k, phase, rows, np.eye(len(rows))))
    for cell in found.copy():
        k, phase, rows = cell.experiment, cell.phase, cell.rows
        cosine = np.asarray(dct(np.eye(len(rows)), axis=0, norm="ortho"))
        b = binned.bins[k]
        local = rows - binned.rows[k].start
        length = float(np.sum(b.count[local])) * b.experiment.interval
        for name, low, high in (("slow", 0, 2), ("middle", 2, 6), ("fast", 6, len(rows))):
            if high > low and len(rows) > low:
                scale_s = length / max(low, 1)
                found.append(CellPart(k, phase, rows, cosine[low:high], name, scale_s))
    return found


def _stretch(
    binned: BinnedCampaign,
    base: Refit,
    leverage: Leverage,
    groups: Sequence[CellPart],
    signatures: FloatArray,
    rng: np.random.Generator,
    bootstrap: int,
    linear: tuple[FloatArray, FloatArray],
) -> tuple[float, float]:
    """How much larger the largest cell and signature are when simulations are refitted nonlinearly.

    ``linear``: both in linearised simulations.
    """
    if bootstrap < 10:
        return 1.0, 1.0
    coords = base.coords
    means = coords.means(base.x)
    cells, along = [], []
    blocks = [leverage.block(group.rows) for group in groups]
    dof = binned.floor.level_dof
    for _ in range(bootstrap):
        scale = np.sqrt(dof / rng.chisquare(dof))
        data = [
            m + scale * c @ rng.standard_normal(len(m))
            for m, c in zip(means, binned.floor.cholesky, strict=True)
        ]
        z = refit(coords, base.x, data=data, most_steps=10, tolerance=0.2).residual
        cells.append(
            max(
                (float(z[rows] @ z[rows]) - float(np.trace(p))) / np.sqrt(2.0 * np.sum(p**2))
                for rows, p in zip((g.rows for g in groups), blocks, strict=True)
            )
        )
        along.append(float(np.max((signatures @ z) ** 2, initial=0.0)))
    of_cells, of_courses = (
        max(1.0, float(np.quantile(found, 0.9)) / max(float(np.quantile(usual, 0.9)), 1e-9))
        for found, usual in zip((cells, along), linear, strict=True)
    )
    return of_cells, of_courses


def excess_mean_square(
    binned: BinnedCampaign, leverage: Leverage, z: FloatArray, k: int, rows: NDArray[np.int64]
) -> tuple[float, int]:
    """Excess mean square (V^2) of a cell over its samples, and their number."""
    b = binned.bins[k]
    local = rows - binned.rows[k].start
    everything = binned.rows[k]
    volts = binned.floor.cholesky[k] @ z[everything]
    # covariance of the residual in volts: L P L' on this cell's rows
    factor = binned.floor.cholesky[k][local]
    seen = factor @ leverage.jacobian[everything]
    expected = np.sum(factor**2, axis=1) - np.sum((seen @ leverage.inner) * seen, axis=1)
    n = b.count[local]
    return float(np.sum(n * (volts[local] ** 2 - expected)) / np.sum(n)), int(np.sum(n))


def _volts(
    binned: BinnedCampaign, leverage: Leverage, z: FloatArray, k: int, rows: NDArray[np.int64]
) -> float:
    return float(np.sqrt(max(excess_mean_square(binned, leverage, z, k, rows)[0], 0.0)))


def predict_left_out(binned: BinnedCampaign, base: Refit) -> dict[str, float]:
    """Detectability of each phase's misfit when the phase is predicted from a fit without it.

    A joint fit smears a misfit over the phases; a prediction does not.  When a switch happened is
    only known from the phases around it, so that t0 (onset, rise) or tf (fall) is fitted to the
    predicted phase itself.
    """
    found = {}
    coords = base.coords
    for phase, name in enumerate(PHASES):
        inside = [b.phase == phase for b in binned.bins]
        rest = [~mask for mask in inside]
        if not any(np.any(mask) for mask in inside) or min(np.sum(mask) for mask in rest) < 8:
            continue
        other = binned.restricted(rest)
        fitted = refit(replace(coords, binned=other), base.x, most_steps=10, tolerance=0.2)
        x = fitted.x
        if name in ("onset", "rise", "fall"):
            free = np.zeros(coords.size, dtype=bool)
            for k, mask in enumerate(inside):
                if np.any(mask):
                    free[coords.switches_of(k, name == "fall")] = True
            only = [m if np.any(m) else np.ones_like(m) for m in inside]
            start = x.copy()
            start[free] = base.x[free]
            some = replace(coords, binned=binned.restricted(only))
            x = refit(some, start, most_steps=15, free=free).x
        excess, means = 0.0, coords.all_means(x)
        derivatives = coords.derivatives(x, means)
        for k, (mask, rows) in enumerate(zip(inside, binned.rows, strict=True)):
            if not np.any(mask):
                continue
            here, columns = means[rows], coords.columns(k)
            jacobian = binned.floor.cholesky[k] @ derivatives[rows, : len(columns)]
            covariance = binned.floor.cholesky[k] @ binned.floor.cholesky[k].T
            inner = fitted.covariance[np.ix_(columns, columns)]
            spread = covariance[np.ix_(mask, mask)] + jacobian[mask] @ inner @ jacobian[mask].T
            away = (binned.data[k] - here)[mask]
            excess += float(away @ np.linalg.solve(spread, away)) - int(np.sum(mask))
        found[name] = float(np.sqrt(max(excess, 0.0)))
    return found
