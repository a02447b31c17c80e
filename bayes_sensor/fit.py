"""Least squares: a particle swarm finds the valley, trust-region refinement its bottom.

The swarm (the paper's method) searches tau, tau_v, V and the switch times; y0 and beta are solved
exactly inside, since the mean is linear in them.  Its best points, and more starts along the flat
valley in which tau and the switch times trade off, are refined with the analytic Jacobian in the
coordinates (tau^2, t0 + tau, tf + tau), where that valley is straight.

The sum of squares is taken on weighted points: averages over short stretches for the search, the
mesh of :mod:`bayes_sensor.compression` for the answer, whose residuals come from all samples.

Only the data decide here.  Side information (a volume measured elsewhere) is a prior and enters
the posterior, not this fit.  The sensor is taken to be the faster lag, tau <= tau_v, because the
cascade is unchanged when the two swap.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from math import exp, inf, log, log1p, sqrt
from typing import Any, NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray
from scipy import optimize, stats

from bayes_sensor.campaign import Campaign, CampaignError, Experiment, FloatArray
from bayes_sensor.compression import Region, compress
from bayes_sensor.likelihood import Problem, as_problem, grid_response, mean_and_variance
from bayes_sensor.model import (
    Cascade,
    Layout,
    cascade_response,
    cascade_sensitivities,
    local_parameters,
    time_constants,
)

# Starts along the valley, as fractions of the rise time (10, 60, 200, 500 ms at the published rig).
TAU_STARTS = (0.005, 0.03, 0.1, 0.25)
LEAST_TAU = 0.1
"""lower bound of tau in sampling intervals: far below anything a sample can tell"""
Progress = Callable[[float, str], None]

# --------------------------------------------------------------------------- the record


@dataclass(frozen=True, eq=False)
class Fit:
    """A least-squares fit of a campaign."""

    names: list[str]
    """flat parameter names"""
    theta_hat: FloatArray
    """(n_theta,) in the order of ``names``, noise parameters estimated from the residuals"""
    parameters: dict[str, Any]
    """the same as the nested mapping of ``fit.json``"""
    rms: float
    """V, of the residuals of all used samples"""
    rms_per_experiment: dict[str, float]
    """V"""
    n_samples: int
    cost: float
    """V^2, the sum of squares"""
    at_bound: list[str]
    """flat names of estimates that sit on a search bound"""
    bounds: dict[str, tuple[float, float]]
    """search bounds by flat name"""
    converged: bool
    status: str
    """one sentence"""
    warnings: list[str]
    swarms: dict[str, Any]
    """``agree`` and, per swarm, its cost before and after refinement and its shared parameters"""
    euler: dict[str, Any] | None
    """the same fit by forward Euler: parameters, rms_V, cost and differences (Euler - exact)"""
    de: dict[str, Any] | None
    """the differential-evolution cross-check, or None when it was not asked for"""
    n_evaluations: int
    seconds: float
    signal_unit: str = "V"
    phi_interval: float = 0.0
    """s, the sampling interval that phi refers to"""
    seed: int = 1

    def to_json(self) -> dict[str, Any]:
        """The content of ``fit.json``."""
        return {
            "rms_V": self.rms,
            "n_samples": self.n_samples,
            "parameters": self.parameters,
            "at_bound": list(self.at_bound),
            "converged": self.converged,
            "warnings": list(self.warnings),
            "status": self.status,
            "rms_per_experiment_V": dict(self.rms_per_experiment),
            "cost_V2": self.cost,
            "phi_interval_s": self.phi_interval,
            "signal_unit": self.signal_unit,
            "bounds": {
                name: [value if np.isfinite(value) else None for value in pair]
                for name, pair in self.bounds.items()
            },
            "swarms": self.swarms,
            "euler": self.euler,
            "differential_evolution": self.de,
            "n_evaluations": self.n_evaluations,
            "seed": self.seed,
        }


# --------------------------------------------------------------------------- particle swarm


@dataclass(frozen=True, eq=False)
class Swarm:
    """Where a swarm ended."""

    best: FloatArray
    """(n,)"""
    cost: float
    n_iterations: int
    n_evaluations: int
    settled: bool
    """whether it stopped improving before it ran out of iterations"""


def particle_swarm(
    cost: Callable[[FloatArray], FloatArray],
    low: FloatArray,
    high: FloatArray,
    rng: np.random.Generator,
    n_particles: int = 40,
    max_iterations: int = 300,
    patience: int = 30,
    tolerance: float = 1e-4,
) -> Swarm:
    """Lowest point of ``cost`` found in a box by an inertia-weight particle swarm.

    ``v <- w v + c (r1 (own best - x) + r2 (swarm's best - x))``, ``x <- x + v`` with w = 0.7298 and
    c = 1.496 (Clerc and Kennedy, IEEE Trans. Evol. Comput. 6, 2002); a particle that leaves the
    box is put on its wall with that component of v reversed and halved.  ``cost`` takes positions
    (n_particles, n) and returns (n_particles,).  It stops when ``patience`` iterations in a row
    improved the best cost by less than ``tolerance`` of its value.
    """
    inertia, pull = 0.7298, 1.496
    width = high - low
    x = low + width * rng.random((n_particles, len(low)))
    v = width * (rng.random(x.shape) - 0.5)
    own, own_cost = x.copy(), cost(x)
    leader = int(np.argmin(own_cost))
    since, mark, iteration = 0, float(own_cost[leader]), 0
    while iteration < max_iterations and since < patience:
        iteration += 1
        r1, r2 = rng.random((2, *x.shape))
        v = inertia * v + pull * (r1 * (own - x) + r2 * (own[leader] - x))
        x = x + v
        outside = (x < low) | (x > high)
        v[outside] *= -0.5
        x = np.clip(x, low, high)
        value = cost(x)
        better = value < own_cost
        own[better], own_cost[better] = x[better], value[better]
        leader = int(np.argmin(own_cost))
        since += 1
        if own_cost[leader] < mark - tolerance * abs(mark):
            since, mark = 0, float(own_cost[leader])
    return Swarm(
        own[leader].copy(),
        float(own_cost[leader]),
        iteration,
        n_particles * (iteration + 1),
        since >= patience,
    )


# --------------------------------------------------------------------------- what the data show


@dataclass(frozen=True)
class _Look:
    """Levels and times read off one record, without a model."""

    on: float  # earliest start, s
    off: float  # earliest end, s, or the end of the record
    start_by: float  # the response is rising by then, s
    end_by: float  # .. and falling by then
    rise: float | None  # 10 to 90 %, s; None where no step is visible
    before: float
    step: float


def _blocks(e: Experiment, start: float, end: float, n: int) -> tuple[FloatArray, FloatArray]:
    """Times and means of up to ``n`` stretches of used samples in [start, end)."""
    a = int(np.searchsorted(e.t, start - 1e-9 * e.interval))
    b = int(np.searchsorted(e.t, end - 1e-9 * e.interval))
    used = e.used[a:b]
    t, y = e.t[a:b][used], e.values[a:b][used]
    size = max(1, len(t) // n)
    m = len(t) // size * size
    return t[:m].reshape(-1, size).mean(axis=1), y[:m].reshape(-1, size).mean(axis=1)


def _split(y: FloatArray) -> int:
    """Where a series is best cut in two constant pieces: first index of the second."""
    n = len(y)
    centred = y - y.mean()
    left = np.cumsum(centred)[:-1]
    i = np.arange(1, n)
    return int(np.argmax(left**2 / i + left**2 / (n - i))) + 1


def _look(e: Experiment) -> _Look:
    first, last = float(e.t[0]), float(e.t[-1]) + e.interval
    on = first if e.commanded_on is None else min(max(e.commanded_on, first), last)
    off = last if e.commanded_off is None else min(max(e.commanded_off, on), last)
    t, y = _blocks(e, on, off, 1000)
    _, quiet = _blocks(e, first, on, 200)
    if len(y) < 8:
        level = float(e.values[e.used].mean())
        return _Look(on, off, off, last, None, level, 0.0)
    cut = _split(y)
    before = float(np.median(quiet)) if len(quiet) >= 5 else float(y[:cut].mean())
    after = y[cut:]
    top = float(np.median(after[-max(1, len(after) // 4) :]))
    step = top - before
    noise = float(np.median(np.abs(np.diff(y)))) / 0.954  # of a block; robust against the rise
    if len(quiet) >= 5:
        noise = max(noise, float(np.std(quiet)))
    end_by = last
    if off < last:
        t_fall, y_fall = _blocks(e, off, last, 1000)
        if len(y_fall) >= 8:
            end_by = float(t_fall[_split(y_fall)])
    if abs(step) < 4.0 * noise:
        return _Look(on, off, 0.5 * (on + off), 0.5 * (off + last), None, before, step)
    x = (y - before) / step
    low = np.flatnonzero(x[:cut] < 0.1)
    high = np.flatnonzero(x[max(cut - 1, 0) :] >= 0.9)
    begin = t[low[-1]] if len(low) else t[0]
    finish = t[max(cut - 1, 0) + high[0]] if len(high) else t[-1]
    width = t[1] - t[0]
    return _Look(on, off, float(t[cut]), end_by, max(float(finish - begin), width), before, step)


def _initial_bounds(
    problem: Problem, looks: list[_Look], given: Mapping[str, tuple[float, float]] | None
) -> dict[str, tuple[float, float]]:
    """Search bounds by flat name, from the records and their commanded times alone."""
    campaign, layout = problem.campaign, problem.layout
    rises = [look.rise for look in looks if look.rise is not None]
    slowest = max(rises) if rises else max(0.25 * (look.off - look.on) for look in looks)
    flow = max(e.total_flow for e in campaign)
    least = LEAST_TAU * min(e.interval for e in campaign)
    slowest = max(slowest, 100.0 * least)
    bounds = {
        "tau_s": (least, slowest),
        "tau_v_s": (least, 3.0 * slowest),
        "V_mL": (least * flow, 3.0 * slowest * flow),
    }
    for e, look in zip(campaign, looks):
        y = e.values[e.used]
        low, high = float(y.min()), float(y.max())
        spread = max(high - low, 1e-12 * max(abs(high), abs(low)), 1e-300)
        bounds[f"y0_V[{e.name}]"] = (low - spread, high + spread)
        bounds[f"beta_V[{e.name}]"] = (-3.0 * spread, 3.0 * spread)
        bounds[f"t0_s[{e.name}]"] = (look.on, max(look.start_by, look.on + 2.0 * e.interval))
        if e.has_fall:
            bounds[f"tf_s[{e.name}]"] = (look.off, max(look.end_by, look.off + 2.0 * e.interval))
    for name in layout.extra:
        law = problem.priors[name].law if name in problem.priors else None
        bounds[name] = (
            (-inf, inf) if law is None else (float(law.ppf(1e-4)), float(law.ppf(1 - 1e-4)))
        )
    bounds = {name: (float(low), float(high)) for name, (low, high) in bounds.items()}
    for name, pair in (given or {}).items():
        if name not in bounds:
            raise CampaignError(
                f"bounds: no parameter '{name}' in the search; there are {', '.join(bounds)}"
            )
        low, high = (float(value) for value in pair)
        if not low < high:
            raise CampaignError(f"bounds of '{name}': expected low < high, got {low} and {high}")
        bounds[name] = (low, high)
    return bounds


# --------------------------------------------------------------------------- sums on points


class _Points(NamedTuple):
    """Weighted points standing for the samples; all experiments in a row."""

    first: NDArray[np.int64]  # (n_exp + 1,)
    t: FloatArray
    weight: FloatArray  # how many samples the point stands for
    y: FloatArray


def _joined(parts: list[tuple[FloatArray, FloatArray, FloatArray]]) -> _Points:
    first = np.concatenate([[0], np.cumsum([len(part[0]) for part in parts])]).astype(np.int64)
    t, count, y = (np.concatenate([part[i] for part in parts]) for i in range(3))
    return _Points(first, t, count, y)


def _scatter(campaign: Campaign, points: _Points) -> float:
    """Sum of squares inside the averages, which no mean can explain, V^2."""
    total = 0.0
    for k, e in enumerate(campaign):
        part = slice(points.first[k], points.first[k + 1])
        y = e.values[e.used]
        origin = float(y.mean())
        within = np.sum((y - origin) ** 2) - points.weight[part] @ (points.y[part] - origin) ** 2
        total += max(float(within), 0.0)
    return total


def _averages(campaign: Campaign, looks: list[_Look], per_rise: int, most: int) -> _Points:
    """Means over stretches: ``per_rise`` to a rise time around the switches, few elsewhere."""
    rises = [look.rise for look in looks if look.rise is not None]
    usual = float(np.median(rises)) if rises else 0.0
    parts = []
    for e, look in zip(campaign, looks):
        rise = look.rise or usual or 0.1 * (look.off - look.on)
        first, last = float(e.t[0]), float(e.t[-1]) + e.interval
        edges = [first]
        for low, high in ((look.on, look.start_by), (look.off, look.end_by))[: 1 + e.has_fall]:
            edges += list(np.linspace(edges[-1], low, 9)[1:])
            high = min(high + 4.0 * rise, last)
            width = max(rise / per_rise, (high - low) / most, e.interval)
            edges += list(np.arange(low, high, width)[1:])
        edges += list(np.linspace(edges[-1], last, 17)[1:])
        index = np.unique(np.searchsorted(e.t, np.array(edges) - 1e-9 * e.interval))
        index = index[index < len(e.t)]
        weight = e.used.astype(float)
        count = np.add.reduceat(weight, index)
        total = np.add.reduceat(np.where(e.used, e.values, 0.0), index)
        times = np.add.reduceat(weight * e.t, index)
        keep = count > 0
        parts.append((times[keep] / count[keep], count[keep], total[keep] / count[keep]))
    return _joined(parts)


@njit(cache=True, error_model="numpy")
def _sorted_apart(taus: FloatArray) -> None:  # pragma: no cover - compiled
    # ascending, at least a thousandth apart so that partial fractions keep ten digits
    taus.sort()
    for j in range(1, 3):
        if taus[j] < taus[j - 1] * 1.001:
            taus[j] = taus[j - 1] * 1.001


@njit(cache=True, error_model="numpy")
def _step(s: float, taus: FloatArray, c: FloatArray) -> float:  # pragma: no cover - compiled
    if s <= 0.0:
        return 0.0
    if s > 30.0 * taus[2]:
        return 1.0
    x = 1.0
    for j in range(3):
        u = s / taus[j]
        if u < 40.0:
            x -= c[j] * exp(-u)
    return x


@njit(cache=True, error_model="numpy")
def _profile(
    z: Any, where: Any, first: Any, t: Any, count: Any, y: Any, flow: Any, linear: Any
) -> float:  # pragma: no cover - compiled
    # Sum of squares at z = (log tau, log tau_v, log V, switch times) with the best y0 and beta,
    # which are left in linear (n_exp, 2).
    taus, c = np.empty(3), np.empty(3)
    total = 0.0
    for k in range(len(flow)):
        taus[0], taus[1], taus[2] = exp(z[0]), exp(z[1]), exp(z[2]) / flow[k]
        _sorted_apart(taus)
        for j in range(3):
            c[j] = 1.0
            for m in range(3):
                if m != j:
                    c[j] *= taus[j] / (taus[j] - taus[m])
        t0 = z[where[k, 0]]
        tf = z[where[k, 1]] if where[k, 1] >= 0 else np.inf
        n = sx = sxx = sy = sxy = syy = 0.0
        origin = y[first[k]]
        for i in range(first[k], first[k + 1]):
            x = _step(t[i] - t0, taus, c)
            if t[i] > tf:
                x -= _step(t[i] - tf, taus, c)
            w = count[i]
            d = y[i] - origin
            n += w
            sx += w * x
            sxx += w * x * x
            sy += w * d
            sxy += w * x * d
            syy += w * d * d
        vxx = sxx - sx * sx / n
        vxy = sxy - sx * sy / n
        beta = vxy / vxx if vxx > 1e-9 * n else 0.0
        linear[k, 0] = origin + (sy - beta * sx) / n
        linear[k, 1] = beta
        total += syy - sy * sy / n - beta * vxy
    return total


@njit(cache=True, error_model="numpy")
def _profiles(
    Z: Any, where: Any, first: Any, t: Any, count: Any, y: Any, flow: Any, linear: Any
) -> FloatArray:  # pragma: no cover - compiled
    costs = np.empty(len(Z))
    for i in range(len(Z)):
        costs[i] = _profile(Z[i], where, first, t, count, y, flow, linear)
    return costs


@njit(cache=True, error_model="numpy")
def _euler_step(
    s: float, h: float, taus: FloatArray, c: FloatArray
) -> float:  # pragma: no cover - compiled
    # Forward Euler's response n = s/h samples after the switch is 1 - sum c_j (1 - h/tau_j)^n with
    # the c_j of the continuous cascade; n is let real, so that switch times can be refined.
    if s <= 0.0:
        return 0.0
    x = 1.0
    for j in range(3):
        x -= c[j] * exp(s / h * log1p(-h / taus[j]))
    return x


@njit(cache=True, error_model="numpy")
def _euler_relaxed(
    t: Any, h: float, given: Any, t0: float, tf: float, out: Any
) -> None:  # pragma: no cover - compiled
    taus, c = np.sort(given), np.empty(3)
    _sorted_apart(taus)
    for j in range(3):
        c[j] = 1.0
        for m in range(3):
            if m != j:
                c[j] *= taus[j] / (taus[j] - taus[m])
    for i in range(len(t)):
        out[i] = _euler_step(t[i] - t0, h, taus, c)
        if t[i] > tf:
            out[i] -= _euler_step(t[i] - tf, h, taus, c)


# --------------------------------------------------------------------------- refinement


class _Squares:
    """Residuals and Jacobian on points in the coordinates of the refinement.

    Coordinates: tau^2, tau_v, V, per experiment y0, beta, t0 + tau, tf + tau, then extra
    parameters; ``straight=False``: theta itself.  Each experiment's block [J r] is replaced by the
    triangular factor of its QR decomposition: same norm, same J'J and J'r, a few rows in place of
    hundreds.
    """

    def __init__(self, problem: Problem, points: _Points, straight: bool = True) -> None:
        self.problem, self.points, self.straight = problem, points, straight
        self.layout: Layout = problem.layout
        self.edges = self.layout.local[:, 2:][self.layout.local[:, 2:] >= 0]
        self.n_evaluations = 0
        self._at: bytes = b""
        self._last: tuple[FloatArray, FloatArray] = (np.empty(0), np.empty((0, 0)))
        model = problem.model
        self.kind = "general" if type(model) is not Cascade else model.method

    def coordinates(self, theta: FloatArray) -> FloatArray:
        """From (tau, .., t0, tf, ..) to the refinement's coordinates."""
        p = np.array(theta, dtype=float)
        if self.straight:
            p[self.edges] += p[0]
            p[0] = p[0] ** 2
        return p

    def theta(self, p: FloatArray) -> FloatArray:
        """Back to (tau, .., t0, tf, ..)."""
        theta = np.array(p, dtype=float)
        if self.straight:
            theta[0] = sqrt(max(theta[0], 0.0))
            theta[self.edges] -= theta[0]
        return theta

    def _block(self, theta: FloatArray, k: int) -> tuple[FloatArray, FloatArray, list[int]]:
        # mean, its derivatives by the columns it depends on, and which those are
        e = self.problem.campaign.experiments[k]
        part = slice(self.points.first[k], self.points.first[k + 1])
        t = self.points.t[part]
        i_y0, i_beta, i_t0, i_tf = (int(i) for i in self.layout.local[k])
        if self.kind == "general":
            return self._block_general(theta, k, e, t)
        y0, beta, t0 = theta[i_y0], theta[i_beta], theta[i_t0]
        tf = float(theta[i_tf]) if i_tf >= 0 else None
        taus = time_constants(theta[0], theta[1], theta[2], e.total_flow)
        if self.kind == "exact":
            x = cascade_response(t, taus, t0, tf)
            dx = cascade_sensitivities(t, taus, t0, tf)
        else:
            x, dx = _euler_sensitivities(t, e.interval, taus, t0, tf)
        columns = [0, 1, 2, i_y0, i_beta, i_t0]
        J = np.empty((len(t), 6 if i_tf < 0 else 7))
        J[:, 0] = beta * dx[:, 2]
        J[:, 1] = beta * dx[:, 0]
        J[:, 2] = beta * dx[:, 1] / e.total_flow
        J[:, 3] = 1.0
        J[:, 4] = x
        J[:, 5] = beta * dx[:, 3]
        if i_tf >= 0:
            columns.append(i_tf)
            J[:, 6] = beta * dx[:, 4]
        if self.straight:
            J[:, 0] = (J[:, 0] - J[:, 5:].sum(axis=1)) / (2.0 * theta[0])
        return y0 + beta * x, J, columns

    def _block_general(
        self, theta: FloatArray, k: int, e: Experiment, t: FloatArray
    ) -> tuple[FloatArray, FloatArray, list[int]]:
        layout, model = self.layout, self.problem.model
        full = _with_noise(layout, theta)
        n_mean = layout.n_mean
        columns = [0, 1, 2, *(int(i) for i in layout.local[k] if i >= 0)]
        columns += list(range(n_mean, n_mean + len(layout.extra)))
        mean = model.mean(t, full, layout, e)
        J = np.empty((len(t), len(columns)))
        for j, column in enumerate(columns):
            i = column if column < n_mean else column - n_mean + len(layout) - len(layout.extra)
            step = 1e-7 * max(abs(full[i]), 1e-2)
            moved = full.copy()
            moved[i] += step
            J[:, j] = (model.mean(t, moved, layout, e) - mean) / step
        return mean, J, columns

    def evaluate(self, p: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Reduced residuals (n_rows,) and Jacobian (n_rows, n) at coordinates ``p`` (n,)."""
        key = p.tobytes()
        if key == self._at:
            return self._last
        self.n_evaluations += 1
        theta = self.theta(p)
        rows, values = [], []
        for k in range(len(self.points.first) - 1):
            part = slice(self.points.first[k], self.points.first[k + 1])
            mean, J, columns = self._block(theta, k)
            weight = np.sqrt(self.points.weight[part])
            block = np.empty((len(mean), J.shape[1] + 1))
            block[:, :-1] = J * weight[:, None]
            block[:, -1] = (mean - self.points.y[part]) * weight
            R: Any = np.linalg.qr(block, mode="r")
            wide = np.zeros((len(R), len(p)))
            wide[:, columns] = R[:, :-1]
            rows.append(wide)
            values.append(R[:, -1])
        self._last = np.concatenate(values), np.concatenate(rows)
        self._at = key
        return self._last

    def cost(self, theta: FloatArray) -> float:
        """Sum of squares on the points (without the scatter inside them)."""
        return float(np.sum(self.evaluate(self.coordinates(theta))[0] ** 2))


def _euler_sensitivities(
    t: FloatArray, h: float, taus: FloatArray, t0: float, tf: float | None
) -> tuple[FloatArray, FloatArray]:
    """Relaxed forward Euler at ``t`` (n_t,) and its (n_t, 5) one-sided difference quotients."""
    arguments = np.array([*taus, t0, inf if tf is None else tf])
    x, dx = np.empty_like(t), np.zeros((len(t), 5))
    _euler_relaxed(t, h, arguments[:3], arguments[3], arguments[4], x)
    for j in range(5 if tf is not None else 4):
        moved = arguments.copy()
        moved[j] += 1e-6 * taus[j] if j < 3 else 1e-6 * float(taus.max())
        _euler_relaxed(t, h, moved[:3], moved[3], moved[4], dx[:, j])
        dx[:, j] = (dx[:, j] - x) / (moved[j] - arguments[j])
    return x, dx


def _with_noise(layout: Layout, theta: FloatArray) -> FloatArray:
    """The flat vector with placeholder noise parameters, from mean and extra parameters."""
    noise = np.tile([0.0, 1.0, 0.0], len(layout.noise_names) // 3)
    return np.concatenate([theta[: layout.n_mean], noise, theta[layout.n_mean :]])


class _Refined(NamedTuple):
    theta: FloatArray
    cost: float
    success: bool
    n_evaluations: int


def _refine(
    problem: Problem,
    points: _Points,
    theta: FloatArray,
    low: FloatArray,
    high: FloatArray,
    free: NDArray[np.bool_] | None = None,
    max_evaluations: int = 60,
    tolerance: float = 1e-10,
) -> _Refined:
    """Trust-region refinement (scipy's ``trf``) inside the box; ``free`` False: held fixed."""
    free = np.ones(len(theta), dtype=bool) if free is None else free
    straight = type(problem.model) is Cascade and bool(free[0])
    squares = _Squares(problem, points, straight)
    box_low, box_high = squares.coordinates(low), squares.coordinates(high)
    result = _trust_region(
        squares, np.clip(theta, low, high), box_low, box_high, free, max_evaluations, tolerance
    )
    edges = squares.edges
    if straight and (
        (result.theta[edges] < low[edges]).any() or (result.theta[edges] > high[edges]).any()
    ):
        # a switch time left its own bounds: those are a box only in theta itself
        squares = _Squares(problem, points, straight=False)
        again = _trust_region(
            squares, np.clip(result.theta, low, high), low, high, free, max_evaluations, tolerance
        )
        return again._replace(n_evaluations=again.n_evaluations + result.n_evaluations)
    return result


def _trust_region(
    squares: _Squares,
    theta: FloatArray,
    low: FloatArray,
    high: FloatArray,
    free: NDArray[np.bool_],
    max_evaluations: int,
    tolerance: float,
) -> _Refined:
    start = squares.coordinates(theta)
    # trf wants an interior start
    inner = 1e-9 * np.where(np.isfinite(high - low), high - low, 1.0)
    start = np.clip(start, low + inner, high - inner)
    p = start.copy()

    def residuals(values: FloatArray) -> FloatArray:
        p[free] = values
        return squares.evaluate(p)[0]

    def jacobian(values: FloatArray) -> FloatArray:
        p[free] = values
        return squares.evaluate(p)[1][:, free]

    result = optimize.least_squares(
        residuals, start[free], jacobian, (low[free], high[free]), method="trf", x_scale="jac",
        ftol=tolerance, xtol=tolerance, gtol=1e-14, max_nfev=max_evaluations,
    )  # fmt: skip
    p[free] = result.x
    return _Refined(
        squares.theta(p), float(2.0 * result.cost), result.status > 0, squares.n_evaluations
    )


def _mesh(problem: Problem, theta: FloatArray, low: FloatArray, high: FloatArray) -> _Points:
    """The compressed mesh around ``theta`` as points."""
    plain = Problem(problem.campaign, noise=problem.noise)
    layout = plain.layout
    vector = layout.flat(theta[: layout.n_mean])
    vector[layout.noise[:, 1]] = 1.0  # sums of squares do not depend on it
    box_low, box_high = vector - 1.0, vector + 1.0
    box_low[: layout.n_mean], box_high[: layout.n_mean] = low, high
    compressed = compress(plain, vector, Region(box_low, box_high))
    nodes = [compressed.nodes(k) for k in range(len(plain.campaign))]
    return _joined([(n.t, n.count, n.y) for n in nodes])


def _around(
    layout: Layout, campaign: Campaign, theta: FloatArray, rise: float
) -> tuple[FloatArray, FloatArray]:
    """A box (n_mean,) about an estimate in which its refinement should stay."""
    n = layout.n_mean
    low, high = theta[:n] - 1.0, theta[:n] + 1.0
    low[:3], high[:3] = 0.5 * theta[:3], 2.0 * theta[:3]
    low[0], high[0] = 0.0, max(2.0 * theta[0], 0.05 * rise)
    edges = layout.local[:, 2:][layout.local[:, 2:] >= 0]
    low[edges] = theta[edges] - max(theta[0], 0.05 * rise)
    high[edges] = theta[edges] + max(theta[0], 0.05 * rise)
    return low, high


# --------------------------------------------------------------------------- noise


def _residuals(problem: Problem, vector: FloatArray, k: int) -> tuple[FloatArray, FloatArray]:
    """r = y - m and x3, both (n_t,), of one experiment from the full pass; r is 0 where masked."""
    e = problem.campaign.experiments[k]
    mean, _ = mean_and_variance(problem, vector, k)
    r = np.where(e.used, e.values - mean, 0.0)
    y0, beta, t0, tf = local_parameters(vector, problem.layout, e.name)
    if type(problem.model) is Cascade:
        if problem.model.method == "exact":
            taus = time_constants(vector[0], vector[1], vector[2], e.total_flow)
            return r, grid_response(e, taus, t0, tf)
        return r, (mean - y0) / beta if beta != 0 else np.zeros_like(mean)
    return r, problem.model.response(e.t, vector, problem.layout, e)


class _Spread(NamedTuple):
    """Sums over one experiment's residuals from which the noise is estimated."""

    r2: FloatArray  # r^2 of the used samples
    x: FloatArray  # weight * x3 there
    r: FloatArray  # (n_t,)
    variable: FloatArray  # (n_t,) weight * x3
    used: NDArray[np.bool_]
    steps: float


def _estimate_noise(
    problem: Problem, residuals: list[tuple[FloatArray, FloatArray]], rms: float
) -> dict[str, float]:
    """phi, sigma0, sigma1 by flat name.

    sigma0^2, sigma1^2: regression of r^2 on (1, weight x3), neither negative, weighted once more
    by the inverse of the fitted variance squared.  phi: maximum of the AR(1) likelihood of r/s,
    with phi^(interval/reference) between neighbours.
    """
    campaign, layout = problem.campaign, problem.layout
    spreads = []
    for e, (r, x) in zip(campaign, residuals):
        variable = problem.noise.weight(campaign, e) * np.maximum(x, 0.0)
        used = e.used
        spreads.append(_Spread(r[used] ** 2, variable[used], r, variable, used, problem.steps(e)))
    values: dict[str, float] = {}
    groups = [[k] for k in range(len(spreads))] if layout.noise_per_experiment else None
    for group in groups or [list(range(len(spreads)))]:
        chosen = [spreads[k] for k in group]
        own = rms
        if layout.noise_per_experiment:
            own = sqrt(sum(s.r2.sum() for s in chosen) / sum(len(s.r2) for s in chosen))
        v0, v1 = _variances(chosen, problem.noise.variance != "constant")
        v0 = max(v0, (1e-3 * own) ** 2, 1e-30)
        phi = 0.0
        if problem.noise.autocorrelation == "ar1":
            phi = _lag_one(chosen, v0, v1)
        estimates = (phi, sqrt(v0), sqrt(v1))
        for kind, value in zip(("phi", "sigma0_V", "sigma1_V"), estimates):
            for k in group[: None if layout.noise_per_experiment else 1]:
                name = f"{kind}[{campaign.experiments[k].name}]" if groups else kind
                values[name] = value
    return values


def _variances(spreads: list[_Spread], grows: bool) -> tuple[float, float]:
    n = sum(len(s.r2) for s in spreads)
    mean = sum(float(s.r2.sum()) for s in spreads) / n
    if not grows or mean <= 0.0:
        return mean, 0.0
    v0, v1 = mean, 0.0
    for _ in range(3):
        A, b = np.zeros((2, 2)), np.zeros(2)
        for s in spreads:
            w = 1.0 / np.square(max(v0, 1e-4 * mean) + v1 * s.x)
            wx = w * s.x
            A += [[w.sum(), wx.sum()], [wx.sum(), wx @ s.x]]
            b += [w @ s.r2, wx @ s.r2]
        scale = np.sqrt(np.maximum(np.diag(A), 1e-300))
        if A[1, 1] <= 0.0:
            return mean, 0.0
        # the square root of a positive semidefinite 2 x 2 system turns it into least squares
        solution, _ = optimize.nnls(A / np.outer(scale, scale), b / scale)
        v0, v1 = (float(v) for v in solution / scale)
    return v0, v1


def _lag_one(spreads: list[_Spread], v0: float, v1: float) -> float:
    sums: dict[float, FloatArray] = {}
    for s in spreads:
        z = s.r / np.sqrt(v0 + v1 * s.variable)
        pairs = s.used[1:] & s.used[:-1]
        a, b = z[1:][pairs], z[:-1][pairs]
        row = np.array([a @ a, a @ b, b @ b, len(a)])
        steps = round(s.steps, 9)
        sums[steps] = sums.get(steps, np.zeros(4)) + row
    if sum(row[3] for row in sums.values()) < 2:
        return 0.0
    if set(sums) == {1.0}:
        aa, ab, bb, _ = sums[1.0]
        return float(np.clip(ab / max(sqrt(aa * bb), 1e-300), -0.99999, 0.99999))

    def misfit(phi: float) -> float:
        total = 0.0
        for steps, (aa, ab, bb, n) in sums.items():
            rho = phi**steps
            rest = 1.0 - rho * rho
            total += (aa - 2.0 * rho * ab + rho * rho * bb) / rest + n * log(rest)
        return total

    found = optimize.minimize_scalar(
        misfit, bounds=(1e-9, 0.99999), method="bounded", options={"xatol": 1e-7}
    )
    return float(found.x)


# --------------------------------------------------------------------------- warnings


def _local_noise(z: FloatArray, used: NDArray[np.bool_]) -> tuple[float, float]:
    """Variance and lag-one coefficient of the fast part of residuals ``z`` (n_t,).

    An AR(1)'s autocovariance differences give both: g0 - g1 = v (1 - phi), g1 - g2 =
    v phi (1 - phi).  Anything slow, such as a mean that misses the trace, drops out of them; their
    medians over sections of the record drop spikes as well.
    """
    n_sections = int(np.clip(len(z) // 200, 1, 40))
    size = len(z) // n_sections
    halves = []
    for start in range(0, n_sections * size, size):
        part, keep = z[start : start + size], used[start : start + size]
        one = keep[1:] & keep[:-1]
        two = keep[2:] & keep[:-2]
        if two.sum() >= 10:
            halves.append(
                (
                    0.5 * np.mean((part[1:] - part[:-1])[one] ** 2),
                    0.5 * np.mean((part[2:] - part[:-2])[two] ** 2),
                )
            )
    if not halves:
        return float(np.mean(z[used] ** 2)), 0.0
    half1, half2 = (float(v) for v in np.median(halves, axis=0))
    if half1 <= 0.0:
        return 0.0, 0.0
    phi = min(max((half2 - half1) / half1, -0.99), 0.999)
    return half1 / (1.0 - phi), phi


def _lack_of_fit(
    e: Experiment, r: FloatArray, scale: FloatArray, rise: float, n_experiments: int
) -> tuple[float, float]:
    """(largest, share): worst miss of the mean in V, and how far the misses exceed the noise.

    Means of r/s over stretches of a quarter of the rise are compared with what noise of the
    residuals' own fast part would leave in them.  ``share`` is the ratio of their mean square to
    that, or 0 where chance explains it (level 1e-3 over all experiments, and a factor 1.5 granted
    because AR(1) noise is an approximation itself).
    """
    size = max(int(rise / 4.0 / e.interval), 8)
    n = len(r) // size
    if n < 8:
        size = max(len(r) // 8, 1)
        n = len(r) // size
    z = np.where(e.used, r / scale, 0.0)
    variance, phi = _local_noise(z, e.used)
    count = e.used[: n * size].reshape(n, size).sum(axis=1)
    full = count >= 0.5 * size
    if full.sum() < 8 or variance <= 0.0:
        return 0.0, 0.0
    means = z[: n * size].reshape(n, size).sum(axis=1)[full] / count[full]
    # variance of a mean of m AR(1) values (e.g. Priestley 1981, eq. 5.3.5)
    m = count[full].astype(float)
    expected = variance / m * ((1 + phi) / (1 - phi) - 2 * phi * (1 - phi**m) / m / (1 - phi) ** 2)
    if phi > 0.95:
        # smooth noise: its correlation cannot be read off neighbours; the blocks' usual scatter can
        expected = np.full(len(means), (1.4826 * float(np.median(np.abs(means)))) ** 2)
        if expected[0] <= 0.0:
            return 0.0, 0.0
    ratio = means**2 / expected
    total = float(ratio.mean())
    level = 1e-3 / n_experiments
    worst = stats.chi2.isf(level / len(ratio), 1)
    if total > 1.5 * stats.chi2.isf(level, len(ratio)) / len(ratio) or ratio.max() > 1.5 * worst:
        volts = means * np.sqrt(np.mean(scale[e.used] ** 2))
        return float(np.abs(volts).max()), max(total, float(ratio.max()) / worst)
    return 0.0, 0.0


def _warn(
    problem: Problem,
    vector: FloatArray,
    residuals: list[tuple[FloatArray, FloatArray]],
    looks: list[_Look],
    unit: str,
) -> list[str]:
    campaign, layout = problem.campaign, problem.layout
    warnings = []
    if campaign.same_flow:
        warnings.append(
            "All experiments share one total flow: the valve's tau_v and the manifold's V/Q enter "
            "alike and cannot be told apart; only the set of time constants is determined (the "
            "smallest is given as tau, the largest as tau_v)."
        )
    rises = [look.rise for look in looks if look.rise is not None]
    usual = (
        float(np.median(rises)) if rises else 0.1 * float(np.median([e.t[-1] for e in campaign]))
    )
    for k, e in enumerate(campaign):
        r, x = residuals[k]
        _, sigma0, sigma1 = vector[layout.noise[k]]
        scale = np.sqrt(
            sigma0**2 + sigma1**2 * problem.noise.weight(campaign, e) * np.maximum(x, 0)
        )
        beta = abs(vector[layout.local[k, 1]])
        error = _step_error(e, r, x)
        if beta < 3.0 * error:
            warnings.append(
                f"Experiment '{e.name}': the step ({beta:.2g} {unit}) is not visible above its own "
                f"error ({error:.2g} {unit}); its switch times mean little."
            )
            continue
        miss, share = _lack_of_fit(e, r, scale, looks[k].rise or usual, len(campaign))
        if share > 0.0 and miss > 0.005 * beta:
            percent = 100.0 * miss / beta
            digits = 0 if percent >= 10.0 else 1
            warnings.append(
                f"Experiment '{e.name}': the model does not describe the trace everywhere; it "
                f"misses by up to {miss:.2g} {unit} ({percent:.{digits}f} % of the step), more "
                "than the noise explains."
            )
    return warnings


def _step_error(e: Experiment, r: FloatArray, x: FloatArray) -> float:
    """Standard error of the step size, V: low against high x3, from the scatter of block means.

    Forty block means carry slow noise; their median deviation leaves out the few blocks in which
    the model misses the trace.
    """
    z = r[e.used]
    size = max(len(z) // 40, 1)
    n = len(z) // size
    means = z[: n * size].reshape(n, size).mean(axis=1)
    high = x[e.used][: n * size].reshape(n, size).mean(axis=1) > 0.5
    spread = 1.4826 * float(np.median(np.abs(means - np.median(means))))
    n_high = max(int(high.sum()), 1)
    return spread * sqrt(1.0 / n_high + 1.0 / max(n - n_high, 1))


# --------------------------------------------------------------------------- the fit


@dataclass
class _Count:
    """Evaluations so far, for the record."""

    n: int = field(default=0)


def fit_least_squares(
    campaign: Campaign | Problem,
    seed: int = 1,
    swarms: int = 3,
    particles: int = 40,
    bounds: Mapping[str, tuple[float, float]] | None = None,
    euler: bool = True,
    de: bool = False,
    progress: Progress | None = None,
) -> Fit:
    """The parameters that minimise the summed squared error over all used samples.

    ``swarms`` independent particle swarms of ``particles`` each, then refinement; the same seed
    gives the same fit.  ``bounds`` (flat name to low, high) replaces search bounds, which
    otherwise come from the records and the commanded times (``Fit.bounds``).  ``euler`` repeats the
    fit with forward Euler, ``de`` cross-checks the swarm by scipy's differential evolution.
    ``progress`` is called with a fraction and a word.

    A problem with a model other than the cascade is fitted from the cascade's own fit and the
    middle of the extra parameters' priors, by refinement alone.

    Raises
    ------
    CampaignError
        For a design without data, or bounds that make no sense.
    """
    begin = time.perf_counter()
    problem = as_problem(campaign)
    for e in problem.campaign:
        e.values  # noqa: B018 - raises CampaignError for a design
    tell = progress or (lambda fraction, word: None)
    looks = [_look(e) for e in problem.campaign]
    box = _initial_bounds(problem, looks, bounds)
    count = _Count()
    exact = replace(problem, model=Cascade())
    plain = type(problem.model) is Cascade
    theta, success, record, check = _search(
        exact, looks, box, seed, swarms, particles, de, tell, count
    )
    if not plain:
        theta, success = _fit_general(problem, theta, box, count)
    elif problem.model.method == "euler":
        theta, success = _fit_euler(problem, theta, box, looks, count)
    vector = _with_noise(problem.layout, theta)
    residuals, squares = _all_residuals(problem, vector)
    tell(0.8, "noise")
    n = problem.campaign.n_samples
    cost = sum(squares)
    rms = sqrt(cost / n)
    for name, value in _estimate_noise(problem, residuals, rms).items():
        vector[problem.layout.index(name)] = value
    unit = problem.campaign.signal_unit
    warnings = _warn(problem, vector, residuals, looks, unit)
    at_bound = _at_bound(problem.layout, vector, box)
    warnings += _bound_warnings(at_bound, box, vector, problem.layout, unit)
    if not record["agree"]:
        warnings.append(
            "Independent particle swarms ended in different places after refinement; "
            "the best is given."
        )
    comparison = None
    if euler and plain and problem.model.method == "exact":
        tell(0.85, "Euler")
        comparison = _compare_euler(problem, theta, box, looks, rms, count)
    tell(1.0, "done")
    status = "Converged." if success else "The refinement stopped before it converged."
    if success and at_bound:
        status = f"Converged, with {', '.join(at_bound)} at a search bound."
    return Fit(
        names=list(problem.layout.names),
        theta_hat=vector,
        parameters=problem.layout.nested(vector),
        rms=rms,
        rms_per_experiment={
            e.name: sqrt(s / e.n_samples) for e, s in zip(problem.campaign, squares)
        },
        n_samples=n,
        cost=cost,
        at_bound=at_bound,
        bounds=box,
        converged=success,
        status=status,
        warnings=warnings,
        swarms=record,
        euler=comparison,
        de=check,
        n_evaluations=count.n,
        seconds=time.perf_counter() - begin,
        signal_unit=unit,
        phi_interval=problem.campaign.reference_interval,
        seed=seed,
    )


def _limits(
    layout: Layout, box: Mapping[str, tuple[float, float]]
) -> tuple[FloatArray, FloatArray]:
    """Bounds as (n,) arrays over the mean's and the extra parameters."""
    pairs = np.array([box[name] for name in layout.mean_names + list(layout.extra)])
    return pairs[:, 0].copy(), pairs[:, 1].copy()


def _swap(campaign: Campaign, theta: FloatArray, high: FloatArray) -> FloatArray:
    """The same cascade with tau <= tau_v (and, at equal flows, tau the smallest of the three)."""
    theta = theta.copy()
    if campaign.same_flow:
        flow = campaign.experiments[0].total_flow
        taus = np.sort([theta[0], theta[1], theta[2] / flow])
        if taus[2] <= high[1] and taus[1] * flow <= high[2]:
            theta[0], theta[1], theta[2] = taus[0], taus[2], taus[1] * flow
    if theta[0] > theta[1]:
        theta[0], theta[1] = theta[1], theta[0]
    return theta


def _search(
    problem: Problem,
    looks: list[_Look],
    box: Mapping[str, tuple[float, float]],
    seed: int,
    swarms: int,
    particles: int,
    de: bool,
    tell: Progress,
    count: _Count,
) -> tuple[FloatArray, bool, dict[str, Any], dict[str, Any] | None]:
    """The exact cascade's least squares: swarms, starts along the valley, mesh."""
    campaign = problem.campaign
    problem = Problem(campaign, noise=problem.noise)
    layout = problem.layout
    low, high = _limits(layout, box)
    coarse = _averages(campaign, looks, 12, 40)
    medium = _averages(campaign, looks, 40, 150)
    cost, z_low, z_high, to_theta = _swarm_problem(problem, coarse, low, high)
    rises = [look.rise for look in looks if look.rise is not None]
    rise = float(np.median(rises)) if rises else 0.3 * float(high[0])
    starts, raw = [], []
    for i, stream in enumerate(np.random.SeedSequence(seed).spawn(swarms)):
        tell(0.1 + 0.4 * i / swarms, "swarm")
        found = particle_swarm(cost, z_low, z_high, np.random.default_rng(stream), particles)
        count.n += found.n_evaluations
        raw.append(found.cost)
        starts.append(to_theta(found.best))
    if de:
        result = optimize.differential_evolution(
            lambda z: cost(np.atleast_2d(z.T)) if z.ndim == 2 else float(cost(z[None])[0]),
            list(zip(z_low, z_high)), rng=np.random.default_rng(seed), vectorized=True,
            updating="deferred", polish=False, maxiter=400, popsize=8, tol=1e-6,
        )  # fmt: skip
        count.n += result.nfev
        starts.append(to_theta(result.x))
    starts.append(_guess(problem, looks, coarse, rise, low, high))
    tell(0.5, "refinement")

    def refine(start: FloatArray) -> _Refined:
        found = _refine(problem, medium, start, low, high, max_evaluations=40, tolerance=1e-7)
        count.n += found.n_evaluations
        return found

    refined = [refine(start) for start in starts]
    best = min(refined, key=lambda found: found.cost)
    for fraction in TAU_STARTS:
        start = best.theta.copy()
        edges = layout.local[:, 2:][layout.local[:, 2:] >= 0]
        start[0] = min(fraction * rise, 0.9 * high[0])
        start[edges] += best.theta[0] - start[0]
        other = refine(start)
        if other.cost < best.cost:
            best = other
    noise = _mean_square(problem, best.theta)
    tell(0.7, "mesh")
    start = _swap(campaign, best.theta, high)
    theta, success = _finish(problem, start, low, high, rise, noise, count)
    inside, inside_coarse = _scatter(campaign, medium), _scatter(campaign, coarse)
    each = []
    for i in range(swarms):
        shared = _swap(campaign, refined[i].theta, high)[:3]
        each.append(
            {
                "cost_V2": raw[i] + inside_coarse,
                "refined_cost_V2": refined[i].cost + inside,
                **dict(zip(layout.names[:3], map(float, shared))),
            }
        )
    # two ends count as one when their difference is small against the noise of one sample
    agree = all(found.cost < best.cost + max(noise, 1e-6 * best.cost) for found in refined[:swarms])
    check = None
    if de:
        other = refined[swarms]
        check = {
            "cost_V2": float(result.fun) + inside_coarse,
            "refined_cost_V2": other.cost + inside,
            "agrees": bool(other.cost < best.cost + max(noise, 1e-6 * best.cost)),
            "n_evaluations": int(result.nfev),
            **dict(zip(layout.names[:3], map(float, _swap(campaign, other.theta, high)[:3]))),
        }
    return theta, success, {"agree": agree, "swarms": each}, check


def _swarm_problem(
    problem: Problem, points: _Points, low: FloatArray, high: FloatArray
) -> tuple[
    Callable[[FloatArray], FloatArray], FloatArray, FloatArray, Callable[[FloatArray], FloatArray]
]:
    """Cost of a swarm's positions, their box, and the way from a position to theta."""
    layout = problem.layout
    edges = layout.local[:, 2:]
    where = np.full(edges.shape, -1, dtype=np.int64)
    where[edges >= 0] = 3 + np.arange(int((edges >= 0).sum()))
    order = edges[edges >= 0]
    flow = np.array([e.total_flow for e in problem.campaign])
    linear = np.empty((len(flow), 2))

    def cost(Z: FloatArray) -> FloatArray:
        Z = np.ascontiguousarray(Z)
        return _profiles(Z, where, *points, flow, linear)

    def to_theta(z: FloatArray) -> FloatArray:
        _profiles(np.ascontiguousarray(z[None]), where, *points, flow, linear)
        theta = np.empty(layout.n_mean)
        theta[:3] = np.exp(z[:3])
        theta[order] = z[3:]
        theta[layout.local[:, :2]] = linear
        return theta

    z_low = np.concatenate([np.log(np.maximum(low[:3], 1e-300)), low[order]])
    z_high = np.concatenate([np.log(high[:3]), high[order]])
    return cost, z_low, z_high, to_theta


def _guess(
    problem: Problem,
    looks: list[_Look],
    points: _Points,
    rise: float,
    low: FloatArray,
    high: FloatArray,
) -> FloatArray:
    """A start read off the records: a third of the rise to valve and manifold each."""
    layout = problem.layout
    _, z_low, z_high, to_theta = _swarm_problem(problem, points, low, high)
    flow = float(np.median([e.total_flow for e in problem.campaign]))
    z = [log(0.03 * rise), log(rise / 3.0), log(flow * rise / 3.0)]
    for look, fall in zip(looks, layout.has_fall):
        own = look.rise or rise
        z.append(look.start_by - 0.5 * own)
        if fall:
            z.append(look.end_by - 0.5 * own)
    return to_theta(np.clip(np.array(z), z_low, z_high))


def _mean_square(problem: Problem, theta: FloatArray) -> float:
    _, squares = _all_residuals(problem, _with_noise(problem.layout, theta))
    return sum(squares) / problem.campaign.n_samples


def _all_residuals(
    problem: Problem, vector: FloatArray
) -> tuple[list[tuple[FloatArray, FloatArray]], list[float]]:
    residuals = [_residuals(problem, vector, k) for k in range(len(problem.campaign))]
    return residuals, [float(r @ r) for r, _ in residuals]


def _finish(
    problem: Problem,
    theta: FloatArray,
    low: FloatArray,
    high: FloatArray,
    rise: float,
    noise: float,
    count: _Count,
) -> tuple[FloatArray, bool]:
    """Refinement on the exact mesh, re-meshed when the answer leaves the mesh's box."""
    layout = problem.layout
    success = False
    for _ in range(4):
        near_low, near_high = _around(layout, problem.campaign, theta, rise)
        points = _mesh(problem, theta, near_low, near_high)
        found = _refine(problem, points, theta, low, high)
        count.n += found.n_evaluations
        theta, success = _swap(problem.campaign, found.theta, high), found.success
        watched = [0, 1, 2, *layout.local[:, 2:][layout.local[:, 2:] >= 0]]
        inside = (theta[watched] >= near_low[watched]) & (theta[watched] <= near_high[watched])
        if inside.all():
            break
    # trf stays inside its box, so an estimate that belongs on the bound stops short of it
    if theta[0] > low[0] and theta[0] < 0.03 * rise:
        held = theta.copy()
        edges = layout.local[:, 2:][layout.local[:, 2:] >= 0]
        held[edges] += held[0] - low[0]
        held[0] = low[0]
        free = np.ones(len(theta), dtype=bool)
        free[0] = False
        bound = _refine(problem, points, np.clip(held, low, high), low, high, free)
        count.n += bound.n_evaluations
        if bound.cost <= found.cost + 1e-4 * noise:
            theta, success = bound.theta, bound.success
            theta[0] = low[0]
    # rounding of the square root
    theta[0] = low[0] if abs(theta[0] - low[0]) < 1e-9 * low[0] else theta[0]
    return theta, success


def _fit_general(
    problem: Problem, theta: FloatArray, box: Mapping[str, tuple[float, float]], count: _Count
) -> tuple[FloatArray, bool]:
    """Refinement of any model from the cascade's fit, with difference quotients."""
    layout = problem.layout
    low, high = _limits(layout, box)
    middle = []
    for name in layout.extra:
        law = problem.priors[name].law if name in problem.priors else None
        middle.append(0.0 if law is None else float(law.median()))
    rise = max(theta[1], theta[2] / max(e.total_flow for e in problem.campaign)) * 2.2
    near_low, near_high = _around(layout, problem.campaign, theta, rise)
    points = _mesh(problem, theta, near_low, near_high)
    found = _refine(problem, points, np.concatenate([theta, middle]), low, high)
    count.n += found.n_evaluations
    return found.theta, found.success


def _fit_euler(
    problem: Problem,
    theta: FloatArray,
    box: Mapping[str, tuple[float, float]],
    looks: list[_Look],
    count: _Count,
) -> tuple[FloatArray, bool]:
    """The fit by forward Euler, from the exact one.

    First with the response continued between samples, so that t0 and tf can be refined; then with
    both set to the nearest sample, where the method has its switches, and the rest refined again.
    """
    campaign = problem.campaign
    layout = problem.layout
    problem = replace(problem, model=Cascade("euler"))
    low, high = _limits(layout, box)
    # the method needs every time constant longer than its step
    interval = max(e.interval for e in campaign)
    flow = max(e.total_flow for e in campaign)
    least = 1.05 * interval * np.array([1.0, 1.0, flow])
    low[:3] = np.maximum(low[:3], least)
    high[:3] = np.maximum(high[:3], 2.0 * low[:3])
    rises = [look.rise for look in looks if look.rise is not None]
    rise = float(np.median(rises)) if rises else 0.3 * float(high[0])
    near_low, near_high = _around(layout, campaign, theta, rise)
    points = _mesh(problem, theta, near_low, near_high)
    start = np.clip(theta, low, high)
    found = _refine(problem, points, start, low, high, max_evaluations=40)
    snapped = found.theta.copy()
    free = np.ones(len(snapped), dtype=bool)
    for k, e in enumerate(campaign):
        for i in layout.local[k, 2:]:
            if i >= 0:
                index = round((snapped[i] - e.t[0]) / e.interval)
                snapped[i] = e.t[min(max(index, 0), len(e.t) - 1)]
                free[i] = False
    edges = ~free
    low[edges] = np.minimum(low[edges], snapped[edges] - interval)
    high[edges] = np.maximum(high[edges], snapped[edges] + interval)
    # tau and the switch times trade off: with those on the grid tau keeps what is left
    final = _refine(problem, points, snapped, low, high, free, max_evaluations=40)
    count.n += found.n_evaluations + final.n_evaluations
    result = final.theta
    result[edges] = snapped[edges]
    if result[0] > result[1]:
        result[0], result[1] = result[1], result[0]
    return result, final.success


def _compare_euler(
    problem: Problem,
    theta: FloatArray,
    box: Mapping[str, tuple[float, float]],
    looks: list[_Look],
    rms: float,
    count: _Count,
) -> dict[str, Any]:
    other = replace(problem, model=Cascade("euler"))
    found, success = _fit_euler(other, theta, box, looks, count)
    vector = _with_noise(problem.layout, found)
    squares = 0.0
    for k, e in enumerate(problem.campaign):
        r = (e.values - mean_and_variance(other, vector, k)[0])[e.used]
        squares += float(r @ r)
    names = problem.layout.mean_names
    own = sqrt(squares / problem.campaign.n_samples)
    return {
        "parameters": problem.layout.nested(vector, noise=False),
        "rms_V": own,
        "rms_difference_V": own - rms,
        "cost_V2": squares,
        "difference": {name: float(d) for name, d in zip(names, found - theta)},
        "converged": bool(success),
        # forward Euler needs tau above its step; the exact fit's bound is lower
        "tau_at_bound": bool(found[0] < 1.051 * max(e.interval for e in problem.campaign)),
    }


def _at_bound(
    layout: Layout, vector: FloatArray, box: Mapping[str, tuple[float, float]]
) -> list[str]:
    names = []
    for name, (low, high) in box.items():
        value = float(vector[layout.index(name)])
        width = min(high - low, 1e3 * max(abs(value), 1e-9))
        near = 1e-6 * width
        if value - low <= near or high - value <= near:
            names.append(name)
    return names


def _bound_warnings(
    at_bound: list[str],
    box: Mapping[str, tuple[float, float]],
    vector: FloatArray,
    layout: Layout,
    unit: str,
) -> list[str]:
    sentences = []
    for name in at_bound:
        low, high = box[name]
        lower = vector[layout.index(name)] - low < high - vector[layout.index(name)]
        if name == "tau_s" and lower:
            sentences.append(
                f"tau is at its lower bound ({low * 1e3:.3g} ms): the data give an upper limit "
                "only; see the posterior's one-sided limits."
            )
        elif name.startswith("t0_s") and lower:
            sentences.append(
                f"{name} is at its lower bound ({low:.6g} s, the commanded time or the start of "
                "the record): the response seems to begin no later than the command."
            )
        else:
            side = "lower" if lower else "upper"
            sentences.append(
                f"{name} is at its {side} bound ({low if lower else high:.6g}); widen the bounds "
                "or distrust it."
            )
    return sentences
