"""What a reader who knew rig, noise and causes could see: detectability, rivals, true places.

Everything here is free of noise.  Signals are averaged in bins locked to the switches, the bins'
covariance follows exactly from the noise law's autocorrelation, and the cascade is refitted by
generalised least squares::

    d^2 = min_theta (m - f(theta))' C^-1 (m - f(theta))

the noncentrality of the best test that there is anything besides the cascade.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
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
    noise_scale,
    phase_edges,
)
from bayes_sensor.blind_check.simulator.causes import converter_step, tail_mixture
from bayes_sensor.campaign import FloatArray
from bayes_sensor.rig.cascade import cascade_response, cascade_sensitivities

GAUSS, WEIGHTS = np.polynomial.legendre.leggauss(3)
FIRST_BIN, GROWTH = 0.015, 0.06
"""s and s/s: width of the bins after a switch, 0.015 s + 0.06 (time since)"""
SAMPLES_THAT_COUNT = 1500
"""about the number of bins of a campaign, so that d of the noise compares with d of the mean"""
HIDDEN_BELOW = 2.0
"""detectability under which an effect counts as hidden"""
SEPARABLE_ABOVE = 3.0
"""distance (in units of d) from which the oracle tells two explanations apart"""


def bin_edges(step: Step) -> np.ndarray:
    """(n_bins + 1,) sample indices: fine after each switch, coarse elsewhere."""
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
    """(n_bins, n_bins) covariance of means over bins of unit-variance noise, exact.

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
class Refit:
    """The cascade that comes nearest to a signal."""

    theta: FloatArray
    """(3 + 4 n,) tau^2, ln tau_v, ln V, then y0, beta, t0 + tau, tf + tau of each experiment"""
    residual: FloatArray
    """(n_bins,) whitened"""
    jacobian: FloatArray
    """(n_bins, 3 + 4 n) whitened"""

    @property
    def d(self) -> float:
        """Norm of the residual."""
        return float(np.linalg.norm(self.residual))

    @property
    def tau(self) -> float:
        """s; the faster of sensor and valve, because the cascade does not know which is which."""
        return float(min(np.sqrt(self.theta[0]), np.exp(self.theta[1])))

    @cached_property
    def nuisance(self) -> FloatArray:
        """(n_bins, k) orthonormal basis of what the cascade's parameters can mimic."""
        scale = np.linalg.norm(self.jacobian, axis=0)
        u, s, _ = np.linalg.svd(
            self.jacobian / np.where(scale > 0, scale, 1.0), full_matrices=False
        )
        return u[:, s > 1e-9 * s[0]]

    def projected(self, columns: FloatArray) -> FloatArray:
        """``columns`` (n_bins, ..) without what the cascade's parameters can mimic."""
        return np.asarray(columns - self.nuisance @ (self.nuisance.T @ columns))


class Oracle:
    """Bins, noise and cascade of one rig.

    Switch times are those that the recorder's clock gave them.
    """

    def __init__(self, case: Case) -> None:
        self.case = case
        self.steps = as_recorded(case).steps
        self.edges = [bin_edges(step) for step in self.steps]
        self.times: dict[str, FloatArray] = {}
        for step, edges in zip(self.steps, self.edges, strict=True):
            # samples i0 .. i1 - 1 lie within half an interval around their first and last
            low, high = (edges[:-1] - 0.5) * step.interval, (edges[1:] - 0.5) * step.interval
            nodes = 0.5 * (low + high) + 0.5 * (high - low) * GAUSS[:, None]
            self.times[step.name] = np.maximum(nodes.T.ravel(), 0.0)
        self.factors = self._factors()

    def _factors(self) -> list[FloatArray]:
        ideal = replace(self.case, strengths={}, steps=self.steps)
        levels = clean_signals(ideal, self.times)
        correlations: dict[tuple[int, float], FloatArray] = {}
        factors = []
        for step, edges in zip(self.steps, self.edges, strict=True):
            kind = step.n_samples, step.interval
            if kind not in correlations:
                correlations[kind] = autocorrelation(self.case.noise, *kind)
            x = (self._means(levels[step.name]) - step.y0) / step.beta
            s = noise_scale(self.case, step, x)
            covariance = bin_covariance(edges, correlations[kind]) * np.outer(s, s)
            # the converter's rounding, white, keeps narrow bins of smooth noise from singularity
            rounding = self.case.lsb**2 / 12.0 + (1e-4 * s) ** 2
            covariance[np.diag_indices(len(s))] += rounding / np.diff(edges)
            factors.append(cholesky(covariance, lower=True))
        return factors

    @staticmethod
    def _means(at_nodes: FloatArray) -> FloatArray:
        """Bin means (n_bins, ..) of values at the nodes (3 n_bins, ..)."""
        shape = (-1, 3, *at_nodes.shape[1:])
        return np.tensordot(0.5 * WEIGHTS, at_nodes.reshape(shape), axes=(0, 1))

    def whitened(self, signals: Mapping[str, FloatArray]) -> FloatArray:
        """(n_bins,) all experiments' bin means, whitened, from values at the nodes."""
        return np.concatenate(
            [self.whitened_one(k, signals[step.name]) for k, step in enumerate(self.steps)]
        )

    def whitened_one(self, k: int, at_nodes: FloatArray) -> FloatArray:
        """(n_bins of k, ..) whitened bin means of experiment ``k``, from values at its nodes."""
        means = self._means(at_nodes)
        return np.asarray(solve_triangular(self.factors[k], means, lower=True))

    def spans(self) -> list[slice]:
        """Where each experiment's bins stand among all."""
        ends = np.cumsum([len(edges) - 1 for edges in self.edges])
        return [slice(end - len(e) + 1, end) for end, e in zip(ends, self.edges, strict=True)]

    # ------------------------------------------------------------------ the cascade

    def start(self) -> FloatArray:
        """The truth, in the coordinates of :class:`Refit`."""
        case = self.case
        theta = [case.tau**2, np.log(case.tau_v), np.log(case.V)]
        for step in self.steps:
            theta += [step.y0, step.beta, step.t0 + case.tau, step.tf + case.tau]
        return np.array(theta)

    def _local(self, theta: FloatArray, k: int) -> tuple[Any, ...]:
        tau = float(np.sqrt(theta[0]))
        y0, beta, on, off = theta[3 + 4 * k : 7 + 4 * k]
        taus = np.array([np.exp(theta[1]), np.exp(theta[2]) / self.steps[k].total_flow, tau])
        return taus, y0, beta, on - tau, off - tau

    def cascade(self, theta: FloatArray) -> FloatArray:
        """(n_bins,) whitened bin means of the cascade."""
        signals = {}
        for k, step in enumerate(self.steps):
            taus, y0, beta, t0, tf = self._local(theta, k)
            signals[step.name] = y0 + beta * cascade_response(self.times[step.name], taus, t0, tf)
        return self.whitened(signals)

    def jacobian(self, theta: FloatArray) -> FloatArray:
        """(n_bins, 3 + 4 n) whitened derivatives of the cascade."""
        spans = self.spans()
        total = np.zeros((spans[-1].stop, len(theta)))
        for k, step in enumerate(self.steps):
            taus, _, beta, t0, tf = self._local(theta, k)
            t = self.times[step.name]
            x = cascade_response(t, taus, t0, tf)
            dx = beta * cascade_sensitivities(t, taus, t0, tf)
            tau = taus[2]
            local = np.column_stack(
                [
                    # at fixed t0 + tau the switch comes earlier as tau grows
                    (dx[:, 2] - dx[:, 3] - dx[:, 4]) / (2.0 * tau),
                    dx[:, 0] * taus[0],
                    dx[:, 1] * taus[1],
                    np.ones_like(t), x, dx[:, 3], dx[:, 4],
                ]
            )  # fmt: skip
            white = solve_triangular(self.factors[k], self._means(local), lower=True)
            total[spans[k], :3] = white[:, :3]
            total[spans[k], 3 + 4 * k : 7 + 4 * k] = white[:, 3:]
        return total

    def refit(self, target: FloatArray, starts: Sequence[FloatArray]) -> Refit:
        """The cascade nearest to ``target`` (n_bins,) whitened, from the best of the starts."""
        smallest = (0.05 * min(step.interval for step in self.steps)) ** 2
        low = np.full(len(starts[0]), -np.inf)
        high = np.full(len(low), np.inf)
        low[:3] = smallest, np.log(1e-3), np.log(1e-2)
        high[:3] = 100.0, np.log(100.0), np.log(1e4)
        best = None
        for start in starts:
            found = least_squares(
                lambda theta: self.cascade(theta) - target,
                np.clip(start, low + 1e-12, high - 1e-12),
                self.jacobian,
                bounds=(low, high),
                x_scale="jac",
                ftol=1e-8,
                xtol=1e-9,
                gtol=1e-8,
                max_nfev=40,
            )
            if best is None or found.cost < best.cost:
                best = found
        assert best is not None
        return Refit(best.x, -best.fun, self.jacobian(best.x))

    def several_starts(self, first: FloatArray) -> list[FloatArray]:
        """Starts along the valley of tau, besides ``first``."""
        starts = [first]
        for tau in (0.2 * self.case.tau, 3.0 * self.case.tau):
            other = first.copy()
            other[0] = tau**2
            starts.append(other)
        return starts

    # ------------------------------------------------------------------ what can be seen

    def signal(self, case: Case) -> FloatArray:
        """(n_bins,) whitened noise-free signal of a case on this rig."""
        return self.whitened(clean_signals(case, self.times))


def fast_detectability(case: Case) -> float:
    """d of causes that oscillate faster than the response moves, at full rate.

    The squared spectrum of the difference over that of the noise; the cascade can mimic nothing of
    it, and frequencies below 0.1 Hz, where it might, are left out.
    """
    with_causes, ideal = clean_signals(case), clean_signals(replace(case, strengths={}))
    total = 0.0
    for step in case.steps:
        n = step.n_samples
        x = (ideal[step.name] - step.y0) / step.beta
        z = (with_causes[step.name] - ideal[step.name]) / noise_scale(case, step, x)
        R = autocorrelation(case.noise, n // 2 + 1, step.interval)
        # periodic extension of the autocorrelation: its transform is the spectrum
        even = np.concatenate([R, R[1 : n - n // 2][::-1]])
        spectrum = np.maximum(np.fft.rfft(even).real, 1e-6)
        power = np.abs(np.fft.rfft(z)) ** 2 / n
        weight = np.where((np.arange(len(power)) == 0) | (2 * np.arange(len(power)) == n), 1.0, 2.0)
        frequency = np.arange(len(power)) / (n * step.interval)
        keep = frequency > 0.1
        total += float((weight * power / spectrum)[keep].sum())
    return float(np.sqrt(total))


def noise_detectability(case: Case) -> float:
    """d of causes that change the noise alone.

    Tails: the score test of the fourth cumulant, sqrt(n/24) times the excess kurtosis (Jarque and
    Bera, Int. Stat. Rev. 55, 1987).  Coarse steps: the added variance step^2/12 over that of the
    noise, sqrt(n/2) times.  n is at most :data:`SAMPLES_THAT_COUNT`: with all of a long record,
    tails and steps far too small to matter would count as strong.
    """
    n = min(sum(step.n_samples for step in case.steps), SAMPLES_THAT_COUNT)
    share, times = tail_mixture(case)
    variance = 1.0 - share + share * times**2
    kurtosis = 3.0 * ((1.0 - share + share * times**4) / variance**2 - 1.0)
    first = case.noise.components[0].share
    tails = np.sqrt(n / 24.0) * kurtosis * first**2
    coarse = 0.0
    if case.strengths.get("coarse_range"):
        coarse = np.sqrt(n / 2.0) * (converter_step(case) / case.noise.sigma0) ** 2 / 12.0
    return float(np.hypot(tails, coarse))


def detectability(case: Case, oracle: Oracle | None = None, starts: int = 3) -> float:
    """d of everything that is wrong with a rig; 0 where nothing is."""
    kinds = [CAUSES[name] for name, strength in case.strengths.items() if strength]
    slow = {c.name: case.strengths[c.name] for c in kinds if not c.noise and not c.fast}
    fast = {c.name: case.strengths[c.name] for c in kinds if c.fast}
    squares = noise_detectability(case) ** 2
    if fast:
        squares += fast_detectability(replace(case, strengths=fast)) ** 2
    if slow:
        squares += refitted(replace(case, strengths=slow), oracle, starts).d ** 2
    return float(np.sqrt(squares))


def refitted(case: Case, oracle: Oracle | None = None, starts: int = 3) -> Refit:
    """The cascade nearest to a rig's noise-free signal."""
    if oracle is None or any(CAUSES[name].family == "clock" for name in case.strengths):
        oracle = Oracle(case)  # a clock moves the switches, and with them the bins
    first = oracle.start()
    return oracle.refit(oracle.signal(case), oracle.several_starts(first)[:starts])


def strength_for(case: Case, name: str, d: float) -> tuple[float, float]:
    """Strength at which cause ``name``, alone on the rig, has detectability ``d``; and the d met.

    Where ``d`` is out of reach, the largest plausible strength and its d.  Found by regula falsi in
    logarithms, to 5 % of d.
    """
    cause = CAUSES[name]
    oracle = None if cause.fast or cause.noise or cause.family == "clock" else Oracle(case)

    def at(strength: float, starts: int = 1) -> float:
        return detectability(replace(case, strengths={name: strength}), oracle, starts)

    high = cause.highest
    d_high = at(high, 3)
    if d_high <= 1.05 * d:
        return high, d_high
    low, d_low = high, d_high
    while d_low > d:
        high, d_high = low, d_low
        low = max(0.02 * low, low * 0.7 * d / d_low)
        d_low = at(low)
        if low < 1e-6 * cause.highest:
            break
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


@dataclass(frozen=True)
class Rival:
    """What a listed cause could explain of a misfit, by its secant."""

    effect: str
    """its name in the catalogue"""
    family: str
    """the cause's"""
    basis: FloatArray
    """(n_bins, k) orthonormal, without what the cascade can mimic"""

    def leaves(self, columns: FloatArray) -> FloatArray:
        """``columns`` (n_bins, ..) without what it explains."""
        return np.asarray(columns - self.basis @ (self.basis.T @ columns))


def listed_rivals(case: Case, fit: Refit, oracle: Oracle, seeds: int = 2) -> list[Rival]:
    """The differences that every listed cause makes on the same rig.

    At a weak and a strong strength, with ``seeds`` draws of its own choices; one direction, or one
    an experiment where the cause differs between them.  Secants, not refits: good to some tens of
    per cent for strong effects.
    """
    ideal_case = replace(case, strengths={}, steps=oracle.steps)
    ideal = oracle.signal(ideal_case)
    spans = oracle.spans()
    found = []
    for cause in CAUSES.values():
        if not cause.listed or cause.noise or cause.fast:
            continue
        for share in (0.08, 0.6):
            for seed in range(seeds):
                rival = replace(
                    ideal_case, seed=case.seed + seed, strengths={cause.name: share * cause.highest}
                )
                difference = oracle.signal(rival) - ideal
                columns = [difference]
                if cause.per_experiment:
                    columns = []
                    for span in spans:
                        own = np.zeros_like(difference)
                        own[span] = difference[span]
                        columns.append(own)
                free = fit.projected(np.column_stack(columns))
                size = np.linalg.norm(free, axis=0)
                keep = size > max(1e-6 * float(size.max()), 1e-9)
                basis, _ = np.linalg.qr(free[:, keep] / size[keep])
                found.append(Rival(cause.listed_as[0], cause.family, basis))
    return found


def rival_distances(fit: Refit, rivals: Sequence[Rival]) -> dict[str, float]:
    """How far every listed explanation stays from the true signal, in units of d, by effect name.

    Each is scaled to fit the true misfit best; the least distance found counts.
    """
    distances: dict[str, float] = {}
    for rival in rivals:
        distance = min(float(np.linalg.norm(rival.leaves(fit.residual))), fit.d)
        distances[rival.effect] = min(distances.get(rival.effect, np.inf), distance)
    return distances


def pair_distance(fit: Refit, rivals: Sequence[Rival]) -> float:
    """How far the nearest two listed explanations of different families stay from it, together."""
    best = fit.d
    for i, one in enumerate(rivals):
        left = one.leaves(fit.residual)
        for other in rivals[i + 1 :]:
            if other.family == one.family or not other.basis.size:
                continue
            basis, size, _ = np.linalg.svd(one.leaves(other.basis), full_matrices=False)
            basis = basis[:, size > 1e-6]
            gone = basis.T @ left
            best = min(best, float(np.sqrt(max(float(left @ left - gone @ gone), 0.0))))
    return best


def places_after_refit(case: Case, fit: Refit, oracle: Oracle) -> dict[tuple[str, str], float]:
    """Share of d^2 by (experiment, phase): where a perfect reader would see the misfit."""
    shares = {}
    for k, (step, span) in enumerate(zip(oracle.steps, oracle.spans(), strict=True)):
        middle = 0.5 * (oracle.edges[k][1:] + oracle.edges[k][:-1]) * step.interval
        energy = fit.residual[span] ** 2
        for phase, (low, high) in phase_edges(case, step).items():
            shares[step.name, phase] = float(energy[(middle >= low) & (middle < high)].sum())
    total = sum(shares.values())
    return {place: value / total if total > 0 else 0.0 for place, value in shares.items()}
