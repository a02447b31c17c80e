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

from bayes_sensor.campaign import FloatArray
from bayes_sensor.diagnosis.data.binned_campaign import Sketch
from bayes_sensor.diagnosis.data.bins import PHASES
from bayes_sensor.diagnosis.data.noise_floor import DOF
from bayes_sensor.diagnosis.evidence.block_least_squares import inverted
from bayes_sensor.diagnosis.evidence.refit import Refit, refit

DRAWS = 2000
"""simulated noises behind the p-values"""
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
class Map:
    """The located excess."""

    cells: tuple[Cell, ...]
    scales: tuple[Cell, ...]
    """the same cells by time scale"""
    left_out: dict[str, float]
    """phase -> detectability of its misfit when it is predicted from a fit without it"""
    p_value: float
    """of the whole: the smallest of the sum's, the largest cell's and the largest course's, times
    how many of them there are"""
    p_value_of_size: float
    """the same of sum and cells alone"""
    p_value_of_form: float | None
    """of the largest course of a listed effect, of all of them; None where none was looked for"""
    excess_rms: float
    """V over all samples"""
    d: float
    """square root of the total excess"""
    residuals: tuple[tuple[str, FloatArray, FloatArray, FloatArray, NDArray[np.int64]], ...]
    """per experiment: name, s since the last switch, whitened residual, V, phase of every bin"""
    shared_by: str
    """what the shares rest on: ``measurement``, ``explanations``, ``findings``; ``nothing``: all
    are 0"""


@dataclass(frozen=True, eq=False)
class Leverage:
    """What a refit leaves of noise, from its linearisation."""

    jacobian: FloatArray
    inner: FloatArray
    """(n, n): P = I - J inner J'"""
    solve: FloatArray
    """(n, n): what the refit takes from a noise e is J solve J'e"""

    @classmethod
    def of(cls, fitted: Refit) -> Leverage:
        """Of a refit, its priors counted as data."""
        j = fitted.jacobian
        normal = j.T @ j
        solve = inverted(normal + fitted.plan.own_prior_matrix)
        if fitted.x[0] <= 0.0:  # tau at its upper limit: its own coordinate did not move
            keep = np.arange(1, len(solve))
            inverse = np.zeros_like(solve)
            matrix = (normal + fitted.plan.own_prior_matrix)[np.ix_(keep, keep)]
            inverse[np.ix_(keep, keep)] = inverted(matrix)
            solve = np.asarray(inverse, dtype=float)
        inner = np.asarray(2.0 * solve - solve @ normal @ solve, dtype=float)
        return cls(j, inner, solve)

    def block(self, rows: NDArray[np.int64]) -> FloatArray:
        """P on some rows."""
        j = self.jacobian[rows]
        return np.eye(len(rows)) - j @ self.inner @ j.T

    def trace(self) -> float:
        """tr P, the expected squared residual of unit noise."""
        return len(self.jacobian) - float(np.sum((self.jacobian @ self.inner) * self.jacobian))

    def leave(self, noise: FloatArray) -> FloatArray:
        """What is left of noises (n, m) after the refit."""
        return noise - self.jacobian @ (self.solve @ (self.jacobian.T @ noise))


def locate(
    sketch: Sketch,
    base: Refit,
    seed: int = 1,
    bootstrap: int = 0,
    courses: FloatArray | None = None,
) -> Map:
    """The excess of a fit over the noise floor, in cells.

    ``bootstrap``: number of simulated campaigns that are refitted nonlinearly; where these leave
    more than the linearised refit, the p-values follow them.  ``courses`` (n, n_bins in all): as of
    :func:`~bayes_sensor.diagnosis.signals.effect_signatures.courses`, along which a misfit may be
    seen that cells do not show.
    """
    leverage = Leverage.of(base)
    parts = _parts(sketch)
    groups = [part for part in parts if not part.scale]
    whole = len(groups)
    rng = np.random.default_rng(seed)
    noise = rng.standard_normal((sketch.n_bins, DRAWS))
    noise *= np.sqrt(DOF / rng.chisquare(DOF, DRAWS))
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
    along = np.zeros((0, sketch.n_bins)) if courses is None else courses
    screened = np.sort(np.max((along @ noise) ** 2, axis=0, initial=0.0))
    of_cells, of_courses = _stretch(
        sketch, base, leverage, groups, along, rng, bootstrap, (largest, screened)
    )
    largest, finest, screened = largest * of_cells, finest * of_cells, screened * of_courses

    def p_of(ratio: float, sample: FloatArray) -> float:
        above = len(sample) - int(np.searchsorted(sample, ratio))
        return (above + 1.0) / (len(sample) + 1.0)

    trace = leverage.trace()
    total = base.misfit - trace
    p_sum = float(f_law.sf(base.misfit / trace, trace, DOF))
    p_most = p_of(float(own[:whole].max()), largest)
    p_size = min(1.0, 2.0 * min(p_sum, p_most))
    p_form = None
    if len(along):
        most = float(np.max((along @ z) ** 2))
        # where simulations end: at most the sum over all courses
        at_most = len(along) * float(f_law.sf(most / of_courses, 1, DOF))
        p_form = min(p_of(most, screened), at_most)
    p_value = p_size if p_form is None else min(1.0, 1.5 * p_size, 3.0 * p_form)
    clear = p_size < CLEAR
    weight = np.maximum(np.array(excess) - np.array(spread), 0.0) if clear else 0.0 * own
    made = []
    shares = _shares(weight, whole)
    for i, part in enumerate(parts):
        k, rows = part.experiment, part.rows
        b = sketch.bins[k]
        local = rows - sketch.rows[k].start
        half = 0.5 * b.experiment.interval
        volts = _volts(sketch, leverage, z, k, rows) if i < whole else 0.0
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
    everywhere = [_mean_square(sketch, leverage, z, g.experiment, g.rows) for g in groups]
    count = sum(n for _, n in everywhere)
    mean = sum(value * n for value, n in everywhere) / count
    return Map(
        cells=tuple(made[:whole]),
        scales=tuple(made[whole:]),
        left_out=predict_left_out(sketch, base),
        p_value=p_value,
        p_value_of_size=p_size,
        p_value_of_form=p_form,
        excess_rms=float(np.sqrt(max(mean, 0.0))),
        d=float(np.sqrt(max(total, 0.0))),
        residuals=tuple(
            (
                b.experiment.name, b.since, z[rows], sketch.floor.cholesky[k] @ z[rows], b.phase,
            )
            for k, (b, rows) in enumerate(zip(sketch.bins, sketch.rows, strict=True))
        ),
        shared_by="measurement" if np.any(weight) else "nothing",
    )  # fmt: skip


def shared_by_explanations(located: Map, sketch: Sketch, explained: FloatArray) -> Map:
    """The map with the excess that explanations put into its cells, in place of the measured one.

    ``explained`` (n_bins in all, n): as of
    :func:`~bayes_sensor.diagnosis.evidence.explained_excess.explained`.
    """
    parts = _parts(sketch)
    whole = len(located.cells)
    power = np.array([np.sum((part.transform @ explained[part.rows]) ** 2) for part in parts])
    shares = _shares(power, whole)
    volts = np.zeros(len(parts))
    for i, part in enumerate(parts[:whole]):
        k = part.experiment
        local = part.rows - sketch.rows[k].start
        n = sketch.bins[k].count[local]
        course = sketch.floor.cholesky[k][local] @ explained[sketch.rows[k]]
        volts[i] = np.sqrt(n @ np.sum(course**2, axis=1) / np.sum(n))
    cells = [
        replace(cell, share=float(shares[i]), excess_rms_V=float(volts[i]))
        for i, cell in enumerate([*located.cells, *located.scales])
    ]
    return replace(
        located,
        cells=tuple(cells[:whole]), scales=tuple(cells[whole:]), shared_by="explanations",
    )  # fmt: skip


def shared_by_findings(located: Map, found: Sequence[tuple[str, float, float]]) -> Map:
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
    shares = _shares(power, len(power))
    cells = [replace(c, share=float(s)) for c, s in zip(located.cells, shares, strict=True)]
    return replace(located, cells=tuple(cells), shared_by="findings")


def _shares(power: FloatArray, whole: int) -> FloatArray:
    """Of the first ``whole`` cells and of the others, each summing to 1; 0 where there is none."""
    found = np.zeros(len(power))
    for some in (slice(0, whole), slice(whole, None)):
        total = float(np.sum(power[some]))
        if total > 0.0:
            found[some] = power[some] / total
    return found


@dataclass(frozen=True, eq=False)
class _Part:
    """A cell, or one of its time scales."""

    experiment: int
    phase: int
    rows: NDArray[np.int64]
    """of its bins"""
    transform: FloatArray
    """(n, n_rows) with orthonormal rows, of what is seen there"""
    scale: str = ""
    scale_s: float | None = None


def _parts(sketch: Sketch) -> list[_Part]:
    """All cells, then the time scales of each."""
    found = []
    for k, b in enumerate(sketch.bins):
        for phase in range(len(PHASES)):
            rows = np.flatnonzero(b.phase == phase) + sketch.rows[k].start
            if len(rows):
                found.append(_Part(k, phase, rows, np.eye(len(rows))))
    for cell in found.copy():
        k, phase, rows = cell.experiment, cell.phase, cell.rows
        cosine = np.asarray(dct(np.eye(len(rows)), axis=0, norm="ortho"))
        b = sketch.bins[k]
        local = rows - sketch.rows[k].start
        length = float(np.sum(b.count[local])) * b.experiment.interval
        for name, low, high in (("slow", 0, 2), ("middle", 2, 6), ("fast", 6, len(rows))):
            if high > low and len(rows) > low:
                scale_s = length / max(low, 1)
                found.append(_Part(k, phase, rows, cosine[low:high], name, scale_s))
    return found


def _stretch(
    sketch: Sketch,
    base: Refit,
    leverage: Leverage,
    groups: Sequence[_Part],
    courses: FloatArray,
    rng: np.random.Generator,
    bootstrap: int,
    linear: tuple[FloatArray, FloatArray],
) -> tuple[float, float]:
    """How much larger the largest cell and course are when simulations are refitted nonlinearly.

    ``linear``: both in linearised simulations.
    """
    if bootstrap < 10:
        return 1.0, 1.0
    plan = base.plan
    means = plan.means(base.x)
    cells, along = [], []
    blocks = [leverage.block(group.rows) for group in groups]
    for _ in range(bootstrap):
        scale = np.sqrt(DOF / rng.chisquare(DOF))
        data = [
            m + scale * c @ rng.standard_normal(len(m))
            for m, c in zip(means, sketch.floor.cholesky, strict=True)
        ]
        z = refit(plan, base.x, data=data, most_steps=10, tolerance=0.2).residual
        cells.append(
            max(
                (float(z[rows] @ z[rows]) - float(np.trace(p))) / np.sqrt(2.0 * np.sum(p**2))
                for rows, p in zip((g.rows for g in groups), blocks, strict=True)
            )
        )
        along.append(float(np.max((courses @ z) ** 2, initial=0.0)))
    of_cells, of_courses = (
        max(1.0, float(np.quantile(found, 0.9)) / max(float(np.quantile(usual, 0.9)), 1e-9))
        for found, usual in zip((cells, along), linear, strict=True)
    )
    return of_cells, of_courses


def _mean_square(
    sketch: Sketch, leverage: Leverage, z: FloatArray, k: int, rows: NDArray[np.int64]
) -> tuple[float, int]:
    """Excess mean square (V^2) of a cell over its samples, and their number."""
    b = sketch.bins[k]
    local = rows - sketch.rows[k].start
    everything = sketch.rows[k]
    volts = sketch.floor.cholesky[k] @ z[everything]
    # covariance of the residual in volts: L P L' on this cell's rows
    factor = sketch.floor.cholesky[k][local]
    seen = factor @ leverage.jacobian[everything]
    expected = np.sum(factor**2, axis=1) - np.sum((seen @ leverage.inner) * seen, axis=1)
    n = b.count[local]
    return float(np.sum(n * (volts[local] ** 2 - expected)) / np.sum(n)), int(np.sum(n))


def _volts(
    sketch: Sketch, leverage: Leverage, z: FloatArray, k: int, rows: NDArray[np.int64]
) -> float:
    return float(np.sqrt(max(_mean_square(sketch, leverage, z, k, rows)[0], 0.0)))


def predict_left_out(sketch: Sketch, base: Refit) -> dict[str, float]:
    """Detectability of each phase's misfit when the phase is predicted from a fit without it.

    A joint fit smears a misfit over the phases; a prediction does not.  When a switch happened is
    only known from the phases around it, so that t0 (onset, rise) or tf (fall) is fitted to the
    predicted phase itself.
    """
    found = {}
    plan = base.plan
    for phase, name in enumerate(PHASES):
        inside = [b.phase == phase for b in sketch.bins]
        rest = [~mask for mask in inside]
        if not any(np.any(mask) for mask in inside) or min(np.sum(mask) for mask in rest) < 8:
            continue
        other = sketch.restricted(rest)
        fitted = refit(replace(plan, sketch=other), base.x, most_steps=10, tolerance=0.2)
        normal = fitted.jacobian.T @ fitted.jacobian
        posterior = inverted(normal + fitted.plan.own_prior_matrix)
        x = fitted.x
        switch = {"onset": 2, "rise": 2, "fall": 3}.get(name)
        if switch is not None:
            free = np.zeros(plan.size, dtype=bool)
            for k, e in enumerate(sketch.campaign):
                if (switch == 2 or e.has_fall) and np.any(inside[k]):
                    free[plan.local[k] + switch] = True
            only = [m if np.any(m) else np.ones_like(m) for m in inside]
            start = x.copy()
            start[free] = base.x[free]
            some = replace(plan, sketch=sketch.restricted(only))
            x = refit(some, start, most_steps=15, free=free).x
        excess, means = 0.0, plan.all_means(x)
        derivatives = plan.derivatives(x, means)
        for k, (mask, rows) in enumerate(zip(inside, sketch.rows, strict=True)):
            if not np.any(mask):
                continue
            here, columns = means[rows], plan.columns(k)
            jacobian = sketch.floor.cholesky[k] @ derivatives[rows, : len(columns)]
            covariance = sketch.floor.cholesky[k] @ sketch.floor.cholesky[k].T
            inner = posterior[np.ix_(columns, columns)]
            spread = covariance[np.ix_(mask, mask)] + jacobian[mask] @ inner @ jacobian[mask].T
            away = (sketch.data[k] - here)[mask]
            excess += float(away @ np.linalg.solve(spread, away)) - int(np.sum(mask))
        found[name] = float(np.sqrt(max(excess, 0.0)))
    return found
