"""How large a cause is: the squared misfit, over the noise, that the ideal model leaves of it.

The signals have no noise.  They are averaged in bins that are locked to the switches, the
covariance of the bins follows exactly from the noise law, and the ideal model f (three lags, no
cause) is refitted by generalised least squares::

    d^2 = min_theta (m - f(theta))' C^-1 (m - f(theta))

d is the noncentrality, in standard deviations, of the best test against the ideal model.
"""

from __future__ import annotations

import itertools
from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from scipy.linalg import cholesky, solve_triangular
from scipy.optimize import least_squares

from bayes_sensor.blind_check.simulator import (
    CAUSES,
    Case,
    Step,
    as_recorded,
    autocorrelation,
    clean_signals,
    converter_step,
    noise_scale,
    tail_mixture,
)
from bayes_sensor.campaign import FloatArray
from bayes_sensor.rig.cascade import cascade_response, cascade_sensitivities

GAUSS, WEIGHTS = np.polynomial.legendre.leggauss(3)
FIRST_BIN, GROWTH = 0.015, 0.06
"""width of the bins after a switch: 0.015 s + 0.06 of the time since the switch"""
N_EFFECTIVE = 1500
"""samples that count for causes in the noise: about as many as a campaign has bins"""
SLOWEST = 0.1
"""Hz; the ideal model may imitate what is slower than that"""


def bin_edges(step: Step) -> np.ndarray:
    """(n_bins + 1,) sample indices: narrow bins after each switch, wide ones elsewhere."""
    on = max(step.t0 - 0.5, 0.0)
    edges = [*np.linspace(0.0, on, 9)]
    for begin, end in ((on, step.tf - 0.3), (step.tf - 0.3, step.duration)):
        switch = step.t0 if begin == on else step.tf
        at = begin
        while at < end:
            edges.append(at)
            since = max(at - switch, 0.0)
            at += min(max(FIRST_BIN + GROWTH * since, 0.1 if at < switch else 0.0), 3.0)
    index = np.unique(np.round(np.array([*edges, step.duration]) / step.interval).astype(np.int64))
    return index[index <= step.n_samples]


def bin_covariance(edges: np.ndarray, correlation: FloatArray) -> FloatArray:
    """(n_bins, n_bins) exact covariance of bin means of noise with unit variance.

    The sum of R(j - i) over two bins is a difference of F at their four distances, where F is even
    and F(k + 1) - 2 F(k) + F(k - 1) = R(k).
    """
    F = np.concatenate([[0.0], np.cumsum(np.cumsum(correlation) - 0.5 * correlation[0])])
    first, last = edges[:-1], edges[1:]

    def at(a: np.ndarray, b: np.ndarray) -> FloatArray:
        values: FloatArray = F[np.abs(np.subtract.outer(a, b))]
        return values

    total = at(first, last) - at(last, last) - at(first, first) + at(last, first)
    n = np.diff(edges).astype(float)
    return np.asarray(total / np.outer(n, n))


@dataclass(frozen=True)
class IdealFit:
    """The ideal model that comes nearest to a signal."""

    theta: FloatArray
    """(3 + 4 n,) tau^2, ln tau_v, ln V, then y0, beta, t0 + tau, tf + tau of each experiment"""
    residual: FloatArray
    """(n_bins,) whitened"""

    @property
    def d(self) -> float:
        """Norm of the residual."""
        return float(np.linalg.norm(self.residual))

    @property
    def tau(self) -> float:
        """s; the faster of sensor and valve, which the model cannot tell apart."""
        return float(min(np.sqrt(self.theta[0]), np.exp(self.theta[1])))


class IdealModel:
    """The ideal model of one rig in bins, whitened by the rig's true noise.

    Switch times are those that the recorder's clock gave them.
    """

    def __init__(self, case: Case) -> None:
        self.case = case
        self.steps = as_recorded(case).steps
        self.edges = [bin_edges(step) for step in self.steps]
        self.times: dict[str, FloatArray] = {}
        """s, three Gauss nodes in each bin"""
        for step, edges in zip(self.steps, self.edges, strict=True):
            # samples i0 .. i1 - 1 lie within half an interval around their first and last
            low, high = (edges[:-1] - 0.5) * step.interval, (edges[1:] - 0.5) * step.interval
            nodes = 0.5 * (low + high) + 0.5 * (high - low) * GAUSS[:, None]
            self.times[step.name] = np.maximum(nodes.T.ravel(), 0.0)
        ends = np.cumsum([0, *(len(edges) - 1 for edges in self.edges)])
        self.rows = [slice(a, b) for a, b in itertools.pairwise(ends)]
        """bins of each experiment among all"""
        self.factors = self._factors()

    def _factors(self) -> list[FloatArray]:
        levels = clean_signals(replace(self.case, strengths={}, steps=self.steps), self.times)
        correlations: dict[tuple[int, float], FloatArray] = {}
        factors = []
        for step, edges in zip(self.steps, self.edges, strict=True):
            kind = step.n_samples, step.interval
            if kind not in correlations:
                correlations[kind] = autocorrelation(self.case.noise, *kind)
            x = (_bin_means(levels[step.name]) - step.y0) / step.beta
            s = noise_scale(self.case, step, x)
            covariance = bin_covariance(edges, correlations[kind]) * np.outer(s, s)
            # rounding is white: it keeps narrow bins of smooth noise from being singular
            rounding = self.case.lsb**2 / 12.0 + (1e-4 * s) ** 2
            covariance[np.diag_indices(len(s))] += rounding / np.diff(edges)
            factors.append(cholesky(covariance, lower=True))
        return factors

    def whitened(self, signals: Mapping[str, FloatArray]) -> FloatArray:
        """(n_bins,) or (n_bins, k) of signals (n_nodes,) or (n_nodes, k) of each experiment."""
        parts = [
            solve_triangular(factor, _bin_means(signals[step.name]), lower=True)
            for step, factor in zip(self.steps, self.factors, strict=True)
        ]
        return np.concatenate(parts)

    def signal(self, case: Case) -> FloatArray:
        """(n_bins,) whitened signal, without noise, of a case on this rig."""
        return self.whitened(clean_signals(case, self.times))

    def truth(self) -> FloatArray:
        """The true parameters in the coordinates of :class:`IdealFit`."""
        case = self.case
        theta = [case.tau**2, np.log(case.tau_v), np.log(case.V)]
        for step in self.steps:
            theta += [step.y0, step.beta, step.t0 + case.tau, step.tf + case.tau]
        return np.array(theta)

    def response(self, theta: FloatArray) -> FloatArray:
        """(n_bins,) whitened response of the ideal model."""
        signals = {}
        for k, step in enumerate(self.steps):
            taus, y0, beta, t0, tf = self._local(theta, k)
            signals[step.name] = y0 + beta * cascade_response(self.times[step.name], taus, t0, tf)
        return self.whitened(signals)

    def jacobian(self, theta: FloatArray) -> FloatArray:
        """(n_bins, 3 + 4 n) whitened derivatives of :meth:`response`."""
        total = np.zeros((self.rows[-1].stop, len(theta)))
        for k, step in enumerate(self.steps):
            taus, _, beta, t0, tf = self._local(theta, k)
            t = self.times[step.name]
            x = cascade_response(t, taus, t0, tf)
            dx = beta * cascade_sensitivities(t, taus, t0, tf)
            columns = [
                # at fixed t0 + tau the switch comes earlier as tau grows
                (dx[:, 2] - dx[:, 3] - dx[:, 4]) / (2.0 * taus[2]),
                dx[:, 0] * taus[0], dx[:, 1] * taus[1], np.ones_like(t), x, dx[:, 3], dx[:, 4],
            ]  # fmt: skip
            means = _bin_means(np.column_stack(columns))
            white = solve_triangular(self.factors[k], means, lower=True)
            total[self.rows[k], :3] = white[:, :3]
            total[self.rows[k], 3 + 4 * k : 7 + 4 * k] = white[:, 3:]
        return total

    def _local(self, theta: FloatArray, k: int) -> tuple[Any, ...]:
        tau = float(np.sqrt(theta[0]))
        y0, beta, on, off = theta[3 + 4 * k : 7 + 4 * k]
        taus = np.array([np.exp(theta[1]), np.exp(theta[2]) / self.steps[k].total_flow, tau])
        return taus, y0, beta, on - tau, off - tau

    def fit(self, target: FloatArray, starts: int = 3) -> IdealFit:
        """The model nearest to ``target`` (n_bins,), from tau, 0.2 tau and 3 tau."""
        shortest = 0.05 * min(step.interval for step in self.steps)
        low = np.full(3 + 4 * len(self.steps), -np.inf)
        high = np.full(len(low), np.inf)
        low[:3] = shortest**2, np.log(1e-3), np.log(1e-2)
        high[:3] = 100.0, np.log(100.0), np.log(1e4)
        found = []
        for tau in (self.case.tau, 0.2 * self.case.tau, 3.0 * self.case.tau)[:starts]:
            start = self.truth()
            start[0] = tau**2
            found.append(least_squares(
                lambda theta: self.response(theta) - target,
                np.clip(start, low + 1e-12, high - 1e-12), self.jacobian, bounds=(low, high),
                x_scale="jac", ftol=1e-8, xtol=1e-9, gtol=1e-8, max_nfev=40,
            ))  # fmt: skip
        best = min(found, key=lambda each: float(each.cost))
        return IdealFit(best.x, -best.fun)


def _bin_means(at_nodes: FloatArray) -> FloatArray:
    """Bin means (n_bins, ..) of values at the nodes (3 n_bins, ..)."""
    shape = (-1, 3, *at_nodes.shape[1:])
    return np.tensordot(0.5 * WEIGHTS, at_nodes.reshape(shape), axes=(0, 1))


def ideal_fit(case: Case, model: IdealModel | None = None, starts: int = 3) -> IdealFit:
    """The ideal model fitted to the signal of a case; ``model``: of the same rig, to save time."""
    if model is None or any(CAUSES[name].family == "clock" for name in case.strengths):
        model = IdealModel(case)  # a wrong clock moves the switches, and with them the bins
    return model.fit(model.signal(case), starts)


def detectability(case: Case, model: IdealModel | None = None, starts: int = 3) -> float:
    """d of everything that is wrong with a rig; 0 where nothing is."""
    kinds = [CAUSES[name] for name, strength in case.strengths.items() if strength]
    slow = {c.name: case.strengths[c.name] for c in kinds if not c.noise and not c.fast}
    fast = {c.name: case.strengths[c.name] for c in kinds if c.fast}
    squares = _of_noise(case) ** 2
    if fast:
        squares += _of_oscillations(replace(case, strengths=fast)) ** 2
    if slow:
        squares += ideal_fit(replace(case, strengths=slow), model, starts).d ** 2
    return float(np.sqrt(squares))


def _of_oscillations(case: Case) -> float:
    """d of causes faster than the response: the squared spectrum over that of the noise."""
    with_causes, ideal = clean_signals(case), clean_signals(replace(case, strengths={}))
    total = 0.0
    for step in case.steps:
        n = step.n_samples
        x = (ideal[step.name] - step.y0) / step.beta
        z = (with_causes[step.name] - ideal[step.name]) / noise_scale(case, step, x)
        R = autocorrelation(case.noise, n // 2 + 1, step.interval)
        # the transform of the autocorrelation, extended periodically, is the spectrum
        spectrum = np.fft.rfft(np.concatenate([R, R[1 : n - n // 2][::-1]])).real
        power = np.abs(np.fft.rfft(z)) ** 2 / n
        k = np.arange(len(power))
        weight = np.where((k == 0) | (2 * k == n), 1.0, 2.0)
        keep = k / (n * step.interval) > SLOWEST
        total += float((weight * power / np.maximum(spectrum, 1e-6))[keep].sum())
    return float(np.sqrt(total))


def _of_noise(case: Case) -> float:
    """d of causes that change the noise alone.

    Tails: the score test of the fourth cumulant, sqrt(n/24) times the excess kurtosis (Jarque and
    Bera, Int. Stat. Rev. 55, 1987).  A coarse converter: sqrt(n/2) times the added variance
    step^2/12 over that of the noise.
    """
    n = min(sum(step.n_samples for step in case.steps), N_EFFECTIVE)
    share, times = tail_mixture(case)
    variance = 1.0 - share + share * times**2
    kurtosis = 3.0 * ((1.0 - share + share * times**4) / variance**2 - 1.0)
    tails = np.sqrt(n / 24.0) * kurtosis * case.noise.components[0].share ** 2
    coarse = 0.0
    if case.strengths.get("coarse_range"):
        coarse = np.sqrt(n / 2.0) * (converter_step(case) / case.noise.sigma0) ** 2 / 12.0
    return float(np.hypot(tails, coarse))


def strength_for(case: Case, name: str, d: float) -> tuple[float, float]:
    """Strength at which cause ``name``, alone on the rig, has detectability ``d``; and the d met.

    Where ``d`` is out of reach, the largest plausible strength.  Found by regula falsi in
    logarithms, to 5 % of d.
    """
    cause = CAUSES[name]
    model = None if cause.fast or cause.noise or cause.family == "clock" else IdealModel(case)

    def at(strength: float, starts: int = 1) -> float:
        return detectability(replace(case, strengths={name: strength}), model, starts)

    high = cause.highest
    d_high = at(high, 3)
    if d_high <= 1.05 * d:
        return high, d_high
    low, d_low = high, d_high
    while d_low > d and low > 1e-6 * cause.highest:
        high, d_high = low, d_low
        low = max(0.02 * low, low * 0.7 * d / d_low)
        d_low = at(low)
    strength, met = low, d_low
    for _ in range(8):
        if abs(np.log(max(met, 1e-9) / d)) < 0.05:
            break
        slope = np.log(d_high / max(d_low, 1e-9)) / np.log(high / low)
        guess = low * np.exp(np.log(d / max(d_low, 1e-9)) / slope)
        strength = float(np.clip(guess, low * 1.001, high * 0.999))
        met = at(strength)
        if met > d:
            high, d_high = strength, met
        else:
            low, d_low = strength, met
    return strength, at(strength, 3)
