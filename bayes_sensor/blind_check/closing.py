"""How far an effect of the catalogue can close a gap at all: the noise-free refit with it.

The catalogue's form differs from the cause, so even the right effect need not close everything.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import partial
from math import exp
from operator import itemgetter

import numpy as np
from scipy.linalg import block_diag
from scipy.optimize import least_squares

from bayes_sensor.blind_check.oracle import Oracle, Refit
from bayes_sensor.blind_check.simulator import sample_times
from bayes_sensor.campaign import Campaign, Experiment, FloatArray
from bayes_sensor.diagnosis.effects import CATALOGUE
from bayes_sensor.diagnosis.effects.effect import Form, Setting, Strength
from bayes_sensor.diagnosis.evidence.refit_coordinates import coating_modes
from bayes_sensor.rig.perturbed import (
    BETA,
    CONCENTRATION,
    FIRST,
    INDEX,
    MIDDLE,
    NEUTRAL,
    START,
    T0,
    TAU,
    TAU_M,
    TAU_V,
    TF,
    Y0,
    rig_mean,
)

MOST_STEPS = 60
"""of a refit; stopped too early, the right effect seems to leave something"""
FEW_STEPS = 15
"""enough for a wrong one, where a few hundredths of a standard deviation do not matter"""
PROMISING = 3
"""starts of a form's grid that are followed"""
BRIEF = 8
"""steps after which the better of several starts shows"""
FOLLOWED = 2
"""of these that go on"""
RIDGE = 1e-2
"""penalty on the standard coordinates of the strengths, so that idle ones stay where they are"""


class _Fit:
    """Cascade plus one form of an effect on the oracle's bins.

    Coordinates: those of :class:`~bayes_sensor.blind_check.oracle.Refit`, then the shared
    strengths, then the strengths that differ between experiments, experiment by experiment.
    """

    def __init__(self, oracle: Oracle, form: Form) -> None:
        self.oracle, self.form = oracle, form
        case = oracle.case
        self.experiments = tuple(
            Experiment(
                step.name, sample_times(step), None, step.carrier_flow,
                step.test_gas_flow, step.interval, step.commanded_on, step.commanded_off,
            )
            for step in oracle.steps
        )  # fmt: skip
        self.before = Campaign("", self.experiments).concentrations_before
        flows = [step.total_flow for step in oracle.steps]
        flow = float(np.median(flows))
        self.common = {
            "time_scale": max(case.tau_v, case.V / flow),
            "reference_flow": flow,
            "signal_scale": float(np.median([abs(step.beta) for step in oracle.steps])),
            "duration": float(np.median([step.duration for step in oracle.steps])),
        }
        step = oracle.steps[0]
        strengths = form.strengths(self.setting(0, step.t0, step.tf))
        self.shared: list[Strength] = [s for s in strengths if not s.per_experiment]
        self.own: list[Strength] = [s for s in strengths if s.per_experiment]
        self.n_base = 3 + 4 * len(oracle.steps)
        self.size = self.n_base + len(self.shared) + len(self.own) * len(oracle.steps)

    def setting(self, k: int, t0: float, tf: float) -> Setting:
        before = self.before[k]
        return Setting(self.experiments[k], t0, tf, **self.common, concentration_before=before)

    def start(self, base: FloatArray, chosen: Mapping[str, float]) -> FloatArray:
        """The base fit's coordinates with strengths ``chosen`` (``*``: times the time scale)."""
        given = {
            name.rstrip("*"): value * (self.common["time_scale"] if name.endswith("*") else 1.0)
            for name, value in chosen.items()
        }

        def begin(s: Strength) -> float:
            return s.coordinate(given[s.name]) if s.name in given else 0.0

        own = [begin(s) for s in self.own]
        strengths = [begin(s) for s in self.shared] + own * len(self.experiments)
        return np.concatenate([base, strengths])

    def columns(self, k: int) -> np.ndarray:
        """Coordinates that experiment ``k`` depends on."""
        local = np.arange(3 + 4 * k, 7 + 4 * k)
        shared = self.n_base + np.arange(len(self.shared))
        first = self.n_base + len(self.shared) + k * len(self.own)
        return np.concatenate([np.arange(3), local, shared, first + np.arange(len(self.own))])

    def at_nodes(self, x: FloatArray, k: int) -> FloatArray:
        """(3 n_bins of k,) values at the nodes of experiment ``k``'s bins."""
        step, e = self.oracle.steps[k], self.experiments[k]
        tau = float(np.sqrt(x[0]))
        y0, beta, on, off = x[3 + 4 * k : 7 + 4 * k]
        p = np.empty(FIRST + len(NEUTRAL))
        p[FIRST:] = NEUTRAL
        p[TAU], p[TAU_V], p[TAU_M] = tau, exp(x[1]), exp(x[2]) / step.total_flow
        p[Y0], p[BETA], p[T0], p[TF] = y0, beta, on - tau, off - tau
        p[CONCENTRATION] = step.concentration
        p[START] = -0.5 * step.interval
        p[MIDDLE] = 0.5 * e.t[-1]
        values = {s.name: s.value(x[self.n_base + i]) for i, s in enumerate(self.shared)}
        first = self.n_base + len(self.shared) + k * len(self.own)
        values |= {s.name: s.value(x[first + i]) for i, s in enumerate(self.own)}
        changed = self.form.settings(values, self.setting(k, p[T0], p[TF]))
        for name, value in changed.items():
            p[FIRST + INDEX[name]] = value
        return rig_mean(self.oracle.times[step.name], p, *coating_modes())

    def residual(self, x: FloatArray, target: FloatArray) -> FloatArray:
        """(n_bins + strengths,) misfit and, below it, the ridge."""
        n = len(self.experiments)
        parts = [self.oracle.whitened_one(k, self.at_nodes(x, k)) for k in range(n)]
        return np.concatenate([np.concatenate(parts) - target, RIDGE * x[self.n_base :]])

    def jacobian(self, x: FloatArray) -> FloatArray:
        """Forward differences, each coordinate only where it acts."""
        spans = self.oracle.spans()
        n = spans[-1].stop
        total = np.zeros((n + self.size - self.n_base, self.size))
        for k, span in enumerate(spans):
            here, columns = self.at_nodes(x, k), self.columns(k)
            slopes = np.empty((len(here), len(columns)))
            for i, j in enumerate(columns):
                h = 1e-5 * max(abs(x[j]), 1e-2 if j else 1e-4)
                moved = x.copy()
                moved[j] += h
                slopes[:, i] = (self.at_nodes(moved, k) - here) / h
            total[span, columns] = self.oracle.whitened_one(k, slopes)  # all at once: the dear part
        strengths = np.arange(self.n_base, self.size)
        total[n + strengths - self.n_base, strengths] = RIDGE
        return total


def closed_fraction(
    oracle: Oracle, target: FloatArray, base: Refit, effect: str, thorough: bool = True
) -> float | None:
    """1 - d_effect^2/d^2: the share of a noise-free gap that ``effect`` of the catalogue closes.

    None where the effect does not act on the mean or there is no gap.  ``thorough``: refits go on
    until they settle, and begin wherever the form may; else they tell a wrong effect's distance.
    """
    if effect not in CATALOGUE or not CATALOGUE[effect].on_mean or base.d < 1e-6:
        return None
    best = float("inf")
    for form in CATALOGUE[effect].forms:
        if form.mean is not None:
            continue
        fit = _Fit(oracle, form)
        # the refit may lie at tau = 0, far from where the effect leaves the truth
        grid = form.grid if thorough else ()
        origins = base.theta, oracle.start()
        starts = _promising(fit, origins, target, grid)
        if thorough and len(form.starts) > 1:
            # the least misfit at the start need not lead to the least at the end
            every = [fit.start(o, chosen) for o in origins for chosen in form.starts]
            brief = sorted((_refitted(fit, x, target, BRIEF) for x in every), key=itemgetter(0))
            starts += [x for _, x in brief[:FOLLOWED]]
        steps = MOST_STEPS if thorough else FEW_STEPS
        best = min(best, *(_refitted(fit, x, target, steps)[0] for x in starts))
    return max(0.0, 1.0 - best / base.d**2) if np.isfinite(best) else None


def _refitted(
    fit: _Fit, start: FloatArray, target: FloatArray, most_steps: int
) -> tuple[float, FloatArray]:
    """Squared misfit that a refit from one start leaves, and where it ends."""
    low, high = _limits(fit)
    found = least_squares(
        partial(fit.residual, target=target),
        np.clip(start, low + 1e-12, high - 1e-12),
        fit.jacobian,
        x_scale="jac",
        max_nfev=most_steps,
        bounds=(low, high),
    )
    n = fit.oracle.spans()[-1].stop
    return float(np.sum(found.fun[:n] ** 2)), np.asarray(found.x)


def _promising(
    fit: _Fit,
    origins: Sequence[FloatArray],
    target: FloatArray,
    grid: Sequence[Mapping[str, float]],
) -> list[FloatArray]:
    """From every origin the start of the least misfit, and of a grid what a linear step gains.

    The starts of the grid have next to no size: one step of it, with the cascade refitted, shows
    what each may become.
    """
    found = []
    for origin in origins:
        starts = [fit.start(origin, chosen) for chosen in fit.form.starts]
        found.append(min(starts, key=lambda x: float(np.sum(fit.residual(x, target) ** 2))))
    if not grid:
        return found
    own = any(s.scaled for s in fit.own)
    spans, left = fit.oracle.spans(), []
    n = spans[-1].stop
    for origin in origins:
        without = fit.start(origin, {})
        r = fit.residual(without, target)[:n]
        cascade = fit.jacobian(without)[:n, : fit.n_base]
        for chosen in grid:
            x = fit.start(origin, chosen)
            template = fit.residual(x, target)[:n] - r
            if not np.any(template):  # it would act after the records' end
                continue
            sizes = block_diag(*(template[s, None] for s in spans)) if own else template[:, None]
            j = np.hstack([cascade, sizes / np.linalg.norm(template)])
            left.append((float(np.sum((r - j @ np.linalg.lstsq(j, r)[0]) ** 2)), x))
    return found + [x for _, x in sorted(left, key=itemgetter(0))[:PROMISING]]


def _limits(fit: _Fit) -> tuple[FloatArray, FloatArray]:
    low, high = np.full(fit.size, -np.inf), np.full(fit.size, np.inf)
    low[:3] = 1e-10, np.log(1e-3), np.log(1e-2)
    high[:3] = 100.0, np.log(100.0), np.log(1e4)
    low[fit.n_base :], high[fit.n_base :] = -8.5, 8.5
    return low, high
