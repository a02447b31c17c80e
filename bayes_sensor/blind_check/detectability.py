"""How large a cause is: the squared misfit, over the noise, that the ideal model leaves of it.

The signals have no noise.  They are averaged in bins that are locked to the switches, the
covariance of the bins follows exactly from the noise law, and the ideal model f (three lags, no
cause) is refitted by generalised least squares::

    d^2 = min_theta (m - f(theta))' C^-1 (m - f(theta))

d is the noncentrality, in standard deviations, of the best test against the ideal model.
"""

from __future__ import annotations

import itertools
from collections.abc import Mapping, Sequence
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
from bayes_sensor.rig.chain import Drive, chain_response

GAUSS = np.polynomial.legendre.leggauss(3)
"""nodes and weights"""
FIRST_BIN, GROWTH = 0.015, 0.06
"""width of the bins after a switch: 0.015 s + 0.06 of the time since the switch"""
N_EFFECTIVE = 1500
"""samples that count for causes in the noise: about as many as a campaign has bins"""
SLOWEST = 0.1
"""Hz; the ideal model may imitate what is slower than that"""


def bin_edges(step: Step) -> np.ndarray:
    """(n_bins + 1,) sample indices: narrow bins after each switch, wide ones elsewhere."""
    switches = [each.at for each in step.switches]
    begins = [max(switches[0] - 0.5, 0.0), *(at - 0.3 for at in switches[1:])]
    edges = [*np.linspace(0.0, begins[0], 9)]
    for at, end, switch in zip(begins, [*begins[1:], step.duration], switches, strict=True):
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


@dataclass(frozen=True)
class OtherIdealFit(IdealFit):
    """The same on another rig."""

    with_valve: bool
    """whether there is a valve, whose lag may be the sensor's"""
    slower: bool
    """whether the sensor is the slower of the two"""

    @property
    def tau(self) -> float:
        """s; of sensor and valve the one that the sensor is said to be."""
        lags = [float(np.sqrt(self.theta[0]))]
        if self.with_valve:
            lags.append(float(np.exp(self.theta[1])))
        return max(lags) if self.slower else min(lags)


class IdealModel:
    """The ideal model of one rig in bins, whitened by the rig's true noise.

    Switch times are those that the recorder's clock gave them.
    """

    quadrature = GAUSS

    def __init__(self, case: Case) -> None:
        self.case = case
        self.steps = as_recorded(case).steps
        self.edges = [bin_edges(step) for step in self.steps]
        self.times: dict[str, FloatArray] = {}
        """s, Gauss nodes in each bin"""
        for step, edges in zip(self.steps, self.edges, strict=True):
            # samples i0 .. i1 - 1 lie within half an interval around their first and last
            low, high = (edges[:-1] - 0.5) * step.interval, (edges[1:] - 0.5) * step.interval
            nodes = 0.5 * (low + high) + 0.5 * (high - low) * self.quadrature[0][:, None]
            self.times[step.name] = np.maximum(nodes.T.ravel(), 0.0)
        self.free = np.ones(len(self.truth()), dtype=bool)
        """which coordinates the response depends on"""
        self.free[1:3] = case.has_valve, bool(case.volume)
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
            x = (self._bin_means(levels[step.name]) - step.y0) / step.beta
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
            solve_triangular(factor, self._bin_means(signals[step.name]), lower=True)
            for step, factor in zip(self.steps, self.factors, strict=True)
        ]
        return np.concatenate(parts)

    def signal(self, case: Case) -> FloatArray:
        """(n_bins,) whitened signal, without noise, of a case on this rig."""
        return self.whitened(clean_signals(case, self.times))

    def _bin_means(self, at_nodes: FloatArray) -> FloatArray:
        """Bin means (n_bins, ..) of values at the nodes (n_nodes n_bins, ..)."""
        weights = self.quadrature[1]
        shape = (-1, len(weights), *at_nodes.shape[1:])
        return np.tensordot(0.5 * weights, at_nodes.reshape(shape), axes=(0, 1))

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
            means = self._bin_means(np.column_stack(columns))
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
        low = np.full(len(self.truth()), -np.inf)
        high = np.full(len(low), np.inf)
        low[:3] = shortest**2, np.log(1e-3), np.log(1e-2)
        high[:3] = 100.0, np.log(100.0), np.log(1e4)
        found = []
        for tau in (self.case.tau, 0.2 * self.case.tau, 3.0 * self.case.tau)[:starts]:
            start = self.truth()
            start[0] = tau**2
            found.append(least_squares(
                lambda free: self.response(self._whole(free)) - target,
                np.clip(start, low + 1e-12, high - 1e-12)[self.free],
                lambda free: self.jacobian(self._whole(free))[:, self.free],
                bounds=(low[self.free], high[self.free]),
                x_scale="jac", ftol=1e-8, xtol=1e-9, gtol=1e-8, max_nfev=40,
            ))  # fmt: skip
        best = min(found, key=lambda each: float(each.cost))
        return IdealFit(self._whole(best.x), -best.fun)

    def _whole(self, free: FloatArray) -> FloatArray:
        """theta, with the true values where the response does not depend on it."""
        theta = self.truth()
        theta[self.free] = free
        return theta


class OtherIdealModel(IdealModel):
    """The ideal model of another rig: its lags in a row, and its programme.

    theta: tau^2, ln tau_v, ln V (of what is not there the response does not depend on them), then
    y0, beta, and tau + each switch time, or tau + one delay up and one down, of each experiment.
    """

    quadrature = np.polynomial.legendre.leggauss(12)

    def __init__(self, case: Case) -> None:
        super().__init__(case)
        ends = np.cumsum([3, *(2 + len(self._delays(step)) for step in self.steps)])
        self.own = [slice(a, b) for a, b in itertools.pairwise(ends)]
        """coordinates of each experiment"""

    @staticmethod
    def _delays(step: Step) -> list[float]:
        """s, what the switch times follow from."""
        if not step.shared_delays:
            return [switch.at for switch in step.switches]
        up, down = (next(s for s in step.switches if (s.level > 0.0) == to) for to in (True, False))
        return [up.at - up.commanded, down.at - down.commanded]

    def truth(self) -> FloatArray:
        """The true parameters."""
        theta = [self.case.tau**2, np.log(self.case.tau_v), np.log(self.case.V)]
        for step in self.steps:
            theta += [step.y0, step.beta, *(at + self.case.tau for at in self._delays(step))]
        return np.array(theta)

    def _chain(self, theta: FloatArray, k: int) -> tuple[dict[str, float], FloatArray, FloatArray]:
        """Lags by stage; times of the switches, and which delay moves each."""
        step = self.steps[k]
        lags = {"sensor": float(np.sqrt(theta[0]))}
        if self.case.has_valve:
            lags["valve"] = float(np.exp(theta[1]))
        if self.case.volume:
            lags["volume"] = float(np.exp(theta[2])) / step.total_flow
        delays = theta[self.own[k]][2:] - lags["sensor"]
        if not step.shared_delays:
            return lags, delays, np.eye(len(delays))
        which = np.array([[s.level > 0.0, s.level == 0.0] for s in step.switches], dtype=float)
        return lags, np.array([s.commanded for s in step.switches]) + which @ delays, which

    def _mean(self, k: int, taus: Sequence[float], drive: Drive) -> FloatArray:
        """(n_bins,) means in the bins of what is the response to the derivative of ``drive``."""
        edges = (self.edges[k] - 0.5) * self.steps[k].interval
        return np.diff(chain_response(edges, taus, drive)) / np.diff(edges)

    def _response(self, theta: FloatArray, k: int) -> FloatArray:
        """(n_bins,) normalised response: exact means, as it has a corner at each switch."""
        lags, at, _ = self._chain(theta, k)
        levels = np.array([switch.level for switch in self.steps[k].switches])
        area = np.cumsum(np.append(0.0, levels[:-1] * np.diff(at)))
        return self._mean(k, list(lags.values()), Drive.of(at, level=area, slope=levels))

    def response(self, theta: FloatArray) -> FloatArray:
        """(n_bins,) whitened response of the ideal model."""
        parts = []
        for k, own in enumerate(self.own):
            y0, beta = theta[own][:2]
            y = y0 + beta * self._response(theta, k)
            parts.append(solve_triangular(self.factors[k], y, lower=True))
        return np.concatenate(parts)

    def jacobian(self, theta: FloatArray) -> FloatArray:
        """(n_bins, n) whitened derivatives of :meth:`response`.

        By a lag: less the response of the chain with that lag twice to the input's derivative.
        """
        total = np.zeros((self.rows[-1].stop, len(theta)))
        for k, own in enumerate(self.own):
            beta, levels = theta[own][1], [switch.level for switch in self.steps[k].switches]
            lags, at, which = self._chain(theta, k)
            taus, heights = list(lags.values()), np.diff(levels, prepend=0.0)
            x = self._response(theta, k)
            by_lag = {
                name: -beta * self._mean(k, [*taus, tau], Drive.of(at, level=levels))
                for name, tau in lags.items()
            }
            by_switch = [
                -beta * self._mean(k, taus, Drive.of([time], level=[height]))
                for time, height in zip(at, heights, strict=True)
            ]
            by_delay = np.transpose(by_switch) @ which
            none = np.zeros_like(x)
            columns = [
                # at fixed tau + t the switch comes earlier as tau grows
                (by_lag["sensor"] - by_delay.sum(axis=1)) / (2.0 * lags["sensor"]),
                by_lag.get("valve", none) * lags.get("valve", 0.0),
                by_lag.get("volume", none) * lags.get("volume", 0.0),
                np.ones_like(x), x, *by_delay.T,
            ]  # fmt: skip
            white = solve_triangular(self.factors[k], np.column_stack(columns), lower=True)
            total[self.rows[k], :3] = white[:, :3]
            total[self.rows[k], own] = white[:, 3:]
        return total

    def fit(self, target: FloatArray, starts: int = 3) -> OtherIdealFit:
        """The model nearest to ``target`` (n_bins,), from tau, 0.2 tau and 3 tau."""
        found = super().fit(target, starts)
        slower = self.case.has_valve and self.case.tau > self.case.tau_v
        return OtherIdealFit(found.theta, found.residual, self.case.has_valve, slower)


def ideal_model(case: Case) -> IdealModel:
    """The ideal model of the rig that a case is on."""
    return IdealModel(case) if case.is_published else OtherIdealModel(case)


def ideal_fit(case: Case, model: IdealModel | None = None, starts: int = 3) -> IdealFit:
    """The ideal model fitted to the signal of a case; ``model``: of the same rig, to save time."""
    if model is None or any(CAUSES[name].family == "clock" for name in case.strengths):
        model = ideal_model(case)  # a wrong clock moves the switches, and with them the bins
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
    model = None if cause.fast or cause.noise or cause.family == "clock" else ideal_model(case)

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
