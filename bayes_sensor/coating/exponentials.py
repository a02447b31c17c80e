"""The response at the probe as a sum of exponentials, by separation of variables."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from functools import cached_property, lru_cache

import numpy as np
from numpy.polynomial import legendre
from scipy.optimize import brentq, least_squares
from scipy.special import j0, j1, jn_zeros

from bayes_sensor.campaign import FloatArray
from bayes_sensor.coating.layers import LEVEL_63, Coating

MOST_WAVES = 512
"""most modes across the coating"""


@dataclass(frozen=True, eq=False)
class ReducedResponse:
    """A step response that is a sum of exponentials.

    y(t) = 1 - sum_k a_k exp(-lambda_k t),  sum_k a_k = 1.  Its transfer function is
    sum_k a_k / (1 + s/lambda_k): behind any input, the sensor's output is the sum over k of a_k
    times the output of one first-order lag with time constant 1/lambda_k.

    >>> lag = ReducedResponse(np.array([1.0]), np.array([20.0]), 0.0)
    >>> round(lag.tau63, 9), round(lag.tau_fit, 9), round(lag.tau_moment, 9)
    (0.05, 0.05, 0.05)
    """

    amplitude: FloatArray
    """(n,) a_k, of either sign"""
    rate: FloatArray
    """(n,) lambda_k, 1/s, positive"""
    max_error: float
    """largest |y - y_modal| on a grid of times, 0 where the sum is the modal one"""

    def __post_init__(self) -> None:
        amplitude, rate = (np.array(a, dtype=float) for a in (self.amplitude, self.rate))
        if amplitude.ndim != 1 or amplitude.shape != rate.shape or not (rate > 0).all():
            raise ValueError(
                "reduced response: expected as many positive rates as amplitudes, got shapes "
                f"{rate.shape} and {amplitude.shape}"
            )
        for name, array in (("amplitude", amplitude), ("rate", rate)):
            array.flags.writeable = False
            object.__setattr__(self, name, array)

    def step(self, t: FloatArray | float) -> FloatArray:
        """Step response at t (s), of the shape of t; 0 before the step."""
        elapsed = np.maximum(np.asarray(t, dtype=float), 0.0)
        risen: FloatArray = 1.0 - np.exp(-elapsed[..., None] * self.rate) @ self.amplitude
        return risen

    def scaled(self, factor: float) -> ReducedResponse:
        """The same shape, ``factor`` times slower (all diffusivities divided by it)."""
        return replace(self, rate=self.rate / factor)

    def with_tau63(self, tau: float) -> ReducedResponse:
        """The same shape, slowed until 63.2 % is reached at tau (s)."""
        return self.scaled(tau / self.tau63)

    def time_to(self, level: float) -> float:
        """s, when the response reaches ``level``, a fraction between 0 and 1."""
        if not 0 < level < 1:
            raise ValueError(f"time_to: level must lie between 0 and 1, got {level}")
        latest = math.log(2 * np.abs(self.amplitude).sum() / (1 - level)) / self.rate.min()
        return float(brentq(lambda t: float(self.step(t)) - level, 0.0, latest, xtol=1e-9 * latest))

    @cached_property
    def tau63(self) -> float:
        """s, time to 63.2 %."""
        return self.time_to(LEVEL_63)

    @cached_property
    def tau_moment(self) -> float:
        """s, integral of 1 - y = sum a_k / lambda_k: the lag that delays as much on average."""
        return float(np.sum(self.amplitude / self.rate))

    @cached_property
    def tau_fit(self) -> float:
        """s, the single lag closest to y in least squares over all t > 0.

        Setting the derivative of the integral of (y - 1 + exp(-t/tau))^2 to zero gives
        sum_k a_k / (1 + lambda_k tau)^2 = 1/4.
        """

        def slope(tau: float) -> float:
            return float(np.sum(self.amplitude / (1 + self.rate * tau) ** 2)) - 0.25

        return float(brentq(slope, 0.02 / self.rate.max(), 50 / self.rate.min(), rtol=1e-12))


@lru_cache(maxsize=128)
def modal(coating: Coating, degree: int = 16) -> ReducedResponse:
    """The response by separation of variables, exact to about seven digits after 0.1 tau63.

    Across the coating the solution is a series of J0(beta r) with J0(beta R) = 0 (planar:
    cos(beta x) with cos(beta R) = 0); for each beta the rest is a layered slab that loses
    s D beta^2 mu sideways, solved by one Legendre element of the given degree per layer.  The
    series is damped at its end by exp(-36 (m/n)^8), which only touches times before the front
    arrives.  Layers whose diffusivities differ a thousandfold leave three digits.  (Crank, The
    Mathematics of Diffusion, 2nd ed., eq. 5.22 for the Bessel series.)

    >>> round(1e3 * modal(Coating()).tau63, 1)
    12.9
    """
    nodes, weights, derivative, barycentric = _legendre_element(degree)
    size = 2 * degree + 1
    stiffness, storage, loss = np.zeros((size, size)), np.zeros(size), np.zeros(size)
    layers = (
        (coating.thickness_zif8, coating.partition, coating.d_zif8),
        (coating.thickness_pdms, 1.0, coating.d_pdms),
    )
    for layer, (height, capacity, diffusivity) in enumerate(layers):
        i = slice(layer * degree, (layer + 1) * degree + 1)
        conductivity = capacity * diffusivity
        stiffness[i, i] += conductivity * 2 / height * (derivative.T * weights) @ derivative
        storage[i] += capacity * height / 2 * weights
        loss[i] += conductivity * height / 2 * weights

    # The last node is the top, where 1 - mu vanishes.
    stiffness, storage, loss = stiffness[:-1, :-1], storage[:-1], loss[:-1]
    root = np.sqrt(storage)
    beta, across = _lateral_modes(coating)
    matrices = stiffness / np.outer(root, root) + beta[:, None, None] ** 2 * np.diag(loss / storage)
    rate, vectors = np.linalg.eigh(matrices)

    z, bottom = coating.probe_height, coating.thickness_zif8
    layer, local = (
        (0, 2 * z / bottom - 1)
        if z <= bottom
        else (1, 2 * (z - bottom) / coating.thickness_pdms - 1)
    )
    at_probe = np.zeros(size)
    at_probe[layer * degree : (layer + 1) * degree + 1] = _interpolation_row(
        nodes, barycentric, local
    )
    seen = np.einsum("i,mij->mj", at_probe[:-1] / root, vectors)
    filled = np.einsum("i,mij->mj", root, vectors)
    return ReducedResponse((across[:, None] * seen * filled).ravel(), rate.ravel(), 0.0)


@lru_cache(maxsize=8)
def _legendre_element(degree: int) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
    """Gauss-Lobatto nodes and weights on [-1, 1], differentiation matrix, barycentric weights."""
    last = np.zeros(degree + 1)
    last[degree] = 1.0
    # newer numpy hands the roots on as complex numbers, though all are real
    inner = np.sort(np.real(legendre.legroots(legendre.legder(last))))
    nodes = np.concatenate(([-1.0], inner, [1.0]))
    weights = 2 / (degree * (degree + 1) * legendre.legval(nodes, last) ** 2)
    gaps = nodes[:, None] - nodes[None, :] + np.eye(degree + 1)
    barycentric = 1 / gaps.prod(axis=1)
    derivative = barycentric[None, :] / barycentric[:, None] / gaps
    np.fill_diagonal(derivative, 0.0)
    np.fill_diagonal(derivative, -derivative.sum(axis=1))
    return nodes, weights, derivative, barycentric


def _interpolation_row(nodes: FloatArray, barycentric: FloatArray, x: float) -> FloatArray:
    """Values at x of the Lagrange polynomials on ``nodes``."""
    distance = x - nodes
    if np.abs(distance).min() < 1e-14:
        return (np.abs(distance) < 1e-14).astype(float)
    row: FloatArray = barycentric / distance
    row /= row.sum()
    return row


@lru_cache(maxsize=1)
def _bessel_zeros() -> FloatArray:
    """(MOST_WAVES,) zeros of J0; finding them takes as long as a response."""
    return np.asarray(jn_zeros(0, MOST_WAVES), dtype=np.float64)


def _lateral_modes(coating: Coating) -> tuple[FloatArray, FloatArray]:
    """Wave numbers beta (1/m) across the coating and the weight of each at the probe."""
    h1, h2 = coating.thickness_zif8, coating.thickness_pdms
    side = coating.outer_radius - coating.ring_radius
    # What enters from the side dies out within the thickness, or farther where ZIF-8 conducts so
    # well under a poor PDMS that gas spreads along it.
    spread = math.sqrt(coating.partition * coating.d_zif8 * h1 * h2 / coating.d_pdms)
    if side > 12 * max(coating.thickness, spread):
        return np.zeros(1), np.ones(1)
    delay = h1**2 / (2 * coating.d_zif8) + h2 * (2 * coating.partition * h1 + h2) / (
        2 * coating.d_pdms
    )
    shortest = min(side, math.sqrt(coating.d_zif8 * delay))
    waves = coating.outer_radius * max(16 / (math.pi * shortest), 25 / side)
    n = int(min(max(math.ceil(waves), 32), MOST_WAVES))
    damping = np.exp(-36 * (np.arange(n) / n) ** 8)
    x = coating.ring_radius / coating.outer_radius
    if coating.geometry == "planar":
        zeros = (np.arange(n) + 0.5) * math.pi
        across = 2 * np.sin(zeros) / zeros * np.cos(zeros * x)
    else:
        zeros = _bessel_zeros()[:n]
        across = 2 / (zeros * j1(zeros)) * j0(zeros * x)
    beta = np.asarray(zeros / coating.outer_radius, dtype=np.float64)
    return beta, across * damping


@lru_cache(maxsize=256)
def reduced(coating: Coating, n: int = 6) -> ReducedResponse:
    """The response of a coating as n exponentials that start at 0 with slope 0 and end at 1.

    Amplitudes and rates minimise the squared distance from :func:`modal` over 0.01 to 12 mean
    delays; the two conditions at the start are met exactly.  Neighbouring rates keep a ratio of
    at least 1.3, so that the amplitudes stay small and lose no digits in a convolution.
    ``max_error`` states what was left.

    >>> response = reduced(Coating())
    >>> bool(response.max_error < 3e-4 and abs(response.amplitude.sum() - 1) < 1e-12)
    True
    """
    if not 2 <= n <= 12:
        raise ValueError(f"reduced: n must lie between 2 and 12, got {n}")
    full = modal(coating)
    delay = full.tau_moment
    t = np.concatenate((np.geomspace(0.01, 12, 150), np.linspace(0.02, 4, 150)))
    remaining = 1 - full.step(t * delay)

    def rates(u: FloatArray) -> FloatArray:
        steps = math.log(1.3) + np.exp(u[1:])
        rate: FloatArray = np.exp(u[0] + np.concatenate(([0.0], np.cumsum(steps))))
        return rate

    def amplitudes(rate: FloatArray) -> FloatArray:
        conditions = np.stack((np.ones(n), rate))
        basis, triangle = np.linalg.qr(conditions.T, mode="complete")
        amplitude = basis[:, :2] @ np.linalg.solve(triangle[:2].T, [1.0, 0.0])
        if n > 2:
            free = np.exp(-t[:, None] * rate) @ basis
            rest = remaining - np.exp(-t[:, None] * rate) @ amplitude
            amplitude = amplitude + basis[:, 2:] @ np.linalg.lstsq(free[:, 2:], rest)[0]
        return amplitude

    def misfit(u: FloatArray) -> FloatArray:
        rate = rates(u)
        return np.exp(-t[:, None] * rate) @ amplitudes(rate) - remaining

    start = np.concatenate(([math.log(full.rate.min() * delay)], np.full(n - 1, math.log(0.7))))
    lowest = np.concatenate(([-5.0], np.full(n - 1, -12.0)))
    highest = np.concatenate(([5.0], np.full(n - 1, 1.5)))
    u = least_squares(misfit, start, bounds=(lowest, highest)).x
    return ReducedResponse(amplitudes(rates(u)), rates(u) / delay, float(np.abs(misfit(u)).max()))
