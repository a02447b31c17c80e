"""How far the gap shrinks once an effect is added: in sample, held out, and for tau.

The misfit is measured where a gap can be seen, not in every bin: with the weights
``W = K (I + K)^-1`` of the discrepancy that describes the base fit's misfit best.  The closed
fraction is ``1 - (r'Wr - tr WP) / (r0'Wr0 - tr WP0)``, r and r0 the whitened residuals with and
without the effect.  A large closed fraction does not prove a cause: the best wrong effect often
closes most of a gap, so the best rival outside the family is given beside it.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from bayes_sensor.campaign import FloatArray
from bayes_sensor.gap.discrepancy import Discrepancy
from bayes_sensor.gap.evidence import Linearised
from bayes_sensor.gap.floor import DOF
from bayes_sensor.gap.refit import Plan, Refit, Sketch, refit
from bayes_sensor.gap.where import Leverage, _mean_square
from bayes_sensor.workers import in_order

VISIBLE = 3.0
"""standard deviations of the noise's own misfit below which no fraction is given"""


@dataclass(frozen=True)
class Closure:
    """How much of the gap an explanation closes; None where the gap is too small to divide by."""

    fraction: float | None
    low: float | None
    high: float | None
    before_V: float
    after_V: float
    d_before: float
    d_after: float

    @property
    def withheld(self) -> bool:
        """Whether no fraction is given."""
        return self.fraction is None


def best_discrepancy(base: Refit, discrepancies: Sequence[Discrepancy]) -> Discrepancy:
    """The configuration with the highest evidence beside a refit."""
    line = Linearised(base)
    return max(discrepancies, key=lambda d: line.evidence(d).log_z)


def visible_misfit(fitted: Refit, window: Discrepancy) -> tuple[float, float]:
    """Excess of the misfit in a window over what noise leaves there, and its sd under noise."""
    weight = window.variance / (1.0 + window.variance)
    leverage = Leverage.of(fitted)
    inner = window.basis.T @ fitted.residual
    seen = window.basis.T @ leverage.jacobian
    p = np.eye(len(weight)) - seen @ leverage.inner @ seen.T
    excess = float(np.sum(weight * inner**2)) - float(np.sum(weight * np.diag(p)))
    root = np.sqrt(weight)
    spread = np.sqrt(2.0 * float(np.sum((root[:, None] * p * root[None, :]) ** 2)))
    return excess, spread


def closure(
    base: Refit,
    fitted: Refit,
    window: Discrepancy,
    seed: int = 1,
    bootstrap: int = 0,
    jobs: int = 1,
) -> Closure:
    """The closed fraction with its 95 % interval.

    The interval comes from ``bootstrap`` simulated campaigns at the explanation's optimum, both
    refitted; with fewer than 20 from the linearised refits.
    """
    sketch = base.plan.sketch
    before, spread = visible_misfit(base, window)
    after, spread_after = visible_misfit(fitted, window)
    volts = [
        np.sqrt(max(_mean_volts(sketch, r), 0.0)) for r in (base, fitted)
    ]  # fmt: skip
    d = [float(np.sqrt(max(x, 0.0))) for x in (before, after)]
    if before <= VISIBLE * spread:  # both are 0 where nothing at all is left over
        return Closure(None, None, None, float(volts[0]), float(volts[1]), d[0], d[1])
    fraction = 1.0 - after / before
    rng = np.random.default_rng(seed)
    if bootstrap >= 20:
        spread_of = _simulated(base, fitted, window, rng, bootstrap, jobs)
    else:
        # noise in the remaining misfit, the floor's level, and noise in what was there before
        sd = np.sqrt(spread_after**2 + (1.0 - fraction) ** 2 * (spread**2 + 4.0 * before))
        level = np.sqrt(2.0 / DOF) * _expected(fitted, window)
        spread_of = float(np.hypot(sd, level)) / before * rng.standard_normal(2001)
    low, high = np.quantile(fraction + spread_of, [0.025, 0.975])
    return Closure(
        float(fraction), float(low), float(high), float(volts[0]), float(volts[1]), d[0], d[1]
    )


def _expected(fitted: Refit, window: Discrepancy) -> float:
    weight = window.variance / (1.0 + window.variance)
    leverage = Leverage.of(fitted)
    seen = window.basis.T @ leverage.jacobian
    return float(np.sum(weight * (1.0 - np.sum((seen @ leverage.inner) * seen, axis=1))))


def _mean_volts(sketch: Sketch, fitted: Refit) -> float:
    leverage = Leverage.of(fitted)
    pairs = [
        _mean_square(sketch, leverage, fitted.residual, k, np.arange(rows.start, rows.stop))
        for k, rows in enumerate(sketch.rows)
    ]
    count = sum(n for _, n in pairs)
    return sum(v * n for v, n in pairs) / count


def _simulated(
    base: Refit,
    fitted: Refit,
    window: Discrepancy,
    rng: np.random.Generator,
    n: int,
    jobs: int,
) -> FloatArray:
    """Errors (n,) of the closed fraction in campaigns simulated at the explanation's optimum."""
    sketch = base.plan.sketch
    means = [fitted.plan.binned(fitted.x, k) for k in range(len(sketch.bins))]
    campaigns = []
    for _ in range(n):
        scale = np.sqrt(DOF / rng.chisquare(DOF))
        campaigns.append(
            [
                m + scale * c @ rng.standard_normal(len(m))
                for m, c in zip(means, sketch.floor.cholesky, strict=True)
            ]
        )
    # the truth of the simulation is a closed gap
    found = in_order(_closed, [(base, fitted, window, y) for y in campaigns], jobs)
    return np.array(found) - 1.0


def _closed(base: Refit, fitted: Refit, window: Discrepancy, data: Sequence[FloatArray]) -> float:
    pair = [refit(r.plan, r.x, data=data, most_steps=10, tolerance=0.2) for r in (base, fitted)]
    before, after = (visible_misfit(r, window)[0] for r in pair)
    return 1.0 - after / max(before, 1.0)


def held_out(base: Refit, fitted: Refit, window: Discrepancy) -> float | None:
    """Closed fraction of experiments predicted without having been used.

    The shared parameters and strengths are frozen at a fit to the others; only y0, beta, t0 and
    tf of the left-out experiment are refitted.  Strengths of its own are fitted before the fall
    and judged on the fall.  None where there is one experiment, no fall to judge local strengths
    on, or too little to divide by.
    """
    sketch = base.plan.sketch
    n_e = len(sketch.bins)
    local = bool(fitted.plan.own)
    if n_e < 2:
        return None
    before = after = spread = 0.0
    for k in range(n_e):
        if local and not sketch.bins[k].falling.any():
            continue
        pair = [_predicted(r, k, local) for r in (base, fitted)]
        before += pair[0][0]
        after += pair[1][0]
        spread += pair[0][1] ** 2
    if before < VISIBLE * np.sqrt(spread) or before <= 0.0:
        return None
    return float(1.0 - after / before)


def _predicted(fitted: Refit, k: int, local: bool) -> tuple[float, float]:
    """Excess misfit of experiment ``k`` predicted from the others, and its sd under noise."""
    sketch, plan = fitted.plan.sketch, fitted.plan
    n_e = len(sketch.bins)
    others = [j for j in range(n_e) if j != k]
    all_but = sketch.restricted([np.full(len(b.first), j != k) for j, b in enumerate(sketch.bins)])
    own = len(plan.own)
    rest = refit(
        Plan(all_but, plan.parts, plan.held),
        sketch.local_coordinates(fitted.x, others, own),
        most_steps=10,
        tolerance=0.2,
    )
    only = [np.full(len(b.first), j == k) for j, b in enumerate(sketch.bins)]
    alone = sketch.restricted(only)
    one = Plan(alone, plan.parts, plan.held)
    start = sketch.local_coordinates(fitted.x, [k], own)
    n_shared = one.local[0]
    start[:n_shared] = rest.x[:n_shared]
    free = np.zeros(one.size, dtype=bool)
    free[n_shared:] = True
    if not local:
        made = refit(one, start, most_steps=10, tolerance=0.2, free=free)
        j = made.jacobian[:, n_shared:]
        return _excess(made.residual, j)
    # strengths of its own: everything before the fall decides them, the fall judges
    falling = alone.bins[0].falling
    rise = Plan(alone.restricted([~falling]), plan.parts, plan.held)
    first = refit(rise, start, most_steps=10, tolerance=0.2, free=free)
    free[:] = False
    free[n_shared + 3] = True  # tf
    fall = Plan(alone.restricted([falling]), plan.parts, plan.held)
    made = refit(fall, first.x, most_steps=10, tolerance=0.2, free=free)
    return _excess(made.residual, made.jacobian[:, [n_shared + 3]])


def _excess(residual: FloatArray, jacobian: FloatArray) -> tuple[float, float]:
    n = len(residual) - jacobian.shape[1]
    return float(residual @ residual) - n, float(np.sqrt(2.0 * max(n, 1)))
