"""The coupled sensor-and-rig model: valve, manifold and sensor in cascade (paper eqs. 5-12).

::

    x1' = (u - x1)/tau_v      valve            u = H(t - t0) - H(t - tf)
    x2' = (Q/V)(x1 - x2)      manifold
    x3' = (x2 - x3)/tau       sensor           y = y0 + beta*x3

Inference uses the exact response.  With decay rates ``a`` it is a divided difference of
``exp(-a s)`` and needs no case distinction when time constants coincide (see
:func:`divided_exponential`).  Forward Euler is kept as the paper's method.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from math import exp, expm1

import numpy as np
from numba import njit

from bayes_sensor.campaign import Campaign, CampaignError, Experiment, FloatArray
from bayes_sensor.rig.layout import Layout, Theta

SETTLED = 60.0
"""slowest time constants after which a step is over: e^-60 times 60^2 is below rounding"""


@njit(cache=True)
def _series(
    a: FloatArray, i: int, n: int, s: float, h: FloatArray
) -> float:  # pragma: no cover - compiled
    # divided difference over a[i : i + n] where its spread times s is at most 1; h: scratch (24,)
    spread = (a[i + n - 1] - a[i]) * s
    # the terms fall like spread^k / k!: so many reach rounding
    terms = 24 if spread > 0.3 else (14 if spread > 0.01 else 7)
    middle = 0.0
    for j in range(i, i + n):
        middle += a[j] / n
    h[0] = 1.0
    for k in range(1, terms):
        h[k] = 0.0
    for j in range(i, i + n):
        delta = a[j] - middle
        for k in range(1, terms):
            h[k] += delta * h[k - 1]
    factor = exp(-middle * s)
    for k in range(1, n):
        factor *= -s / k
    total = 0.0
    for k in range(terms):
        total += h[k] * factor
        factor *= -s / (n + k)
    return total


@njit(cache=True)
def _divided(
    a: FloatArray, s: float, table: FloatArray, h: FloatArray
) -> float:  # pragma: no cover - compiled
    # divided_exponential with its scratch: table (n,), h (24,)
    n = len(a)
    if n > 1 and (a[n - 1] - a[0]) * s <= 1.0:
        return _series(a, 0, n, s, h)
    for i in range(n):
        table[i] = exp(-a[i] * s)
    for i in range(n - 1):
        gap = a[i + 1] - a[i]
        if gap * s > 0.5:
            table[i] = (table[i + 1] - table[i]) / gap
        elif gap > 0.0:
            table[i] *= expm1(-gap * s) / gap
        else:
            table[i] *= -s
    for k in range(2, n):
        for i in range(n - k):
            spread = a[i + k] - a[i]
            if spread * s > 1.0:
                table[i] = (table[i + 1] - table[i]) / spread
            else:
                table[i] = _series(a, i, k + 1, s, h)
    highest: float = table[0]
    return highest


@njit(cache=True)
def divided_exponential(a: FloatArray, s: float) -> float:  # pragma: no cover - compiled
    """Divided difference f[a_1, .., a_n] of f(a) = exp(-a s) over sorted rates ``a`` (n,), s >= 0.

    Recursion where the rates are spread over more than 1/s; otherwise the series
    exp(-m s) (-s)^(n-1) sum_k h_k(a - m) (-s)^k / (n - 1 + k)! with h_k the complete homogeneous
    symmetric polynomials, which has no cancellation when rates coincide.  (McCurdy, Ng and
    Parlett, Math. Comp. 43, 1984, discuss why both are needed.)
    """
    return _divided(a, s, np.empty(len(a)), np.empty(24))


@njit(cache=True)
def step_response(s: float, rates: FloatArray) -> float:  # pragma: no cover - compiled
    """x_n(s) of a cascade of n first-order lags (sorted ``rates``, 1/s) to a unit step at s = 0."""
    if s <= 0.0:
        return 0.0
    n = len(rates)
    nodes = np.zeros(n + 1)
    nodes[1:] = rates
    value = divided_exponential(nodes, s)
    for i in range(n):
        value *= -rates[i]
    return value


@njit(cache=True)
def impulse_response(s: float, rates: FloatArray) -> float:  # pragma: no cover - compiled
    """dx_n/ds, 1/s, of the same cascade."""
    if s <= 0.0:
        return 0.0
    value: float = divided_exponential(rates, s) * rates[0]
    for i in range(1, len(rates)):
        value *= -rates[i]
    return value


@njit(cache=True, error_model="numpy")
def sorted_apart(taus: FloatArray) -> None:  # pragma: no cover - compiled
    # ascending, at least a thousandth apart so that partial fractions keep ten digits
    taus.sort()
    for j in range(1, 3):
        if taus[j] < taus[j - 1] * 1.001:
            taus[j] = taus[j - 1] * 1.001


@njit(cache=True, error_model="numpy")
def partial_fractions(taus: FloatArray, c: FloatArray) -> None:  # pragma: no cover - compiled
    # c_j of x3 = 1 - sum c_j exp(-s/tau_j), for time constants that are apart
    for j in range(3):
        c[j] = 1.0
        for m in range(3):
            if m != j:
                c[j] *= taus[j] / (taus[j] - taus[m])


@njit(cache=True)
def _cascade(
    t: FloatArray, rates: FloatArray, t0: float, tf: float, out: FloatArray
) -> None:  # pragma: no cover - compiled
    nodes, table, h = np.zeros(4), np.empty(4), np.empty(24)
    nodes[1:] = rates
    scale = -rates[0] * rates[1] * rates[2]
    over = SETTLED / rates[0]
    for i in range(len(t)):
        out[i] = 0.0
        if t[i] > t0:
            out[i] = 1.0 if t[i] > t0 + over else scale * _divided(nodes, t[i] - t0, table, h)
        if t[i] > tf:
            out[i] -= 1.0 if t[i] > tf + over else scale * _divided(nodes, t[i] - tf, table, h)


@njit(cache=True)
def _cascade_sensitivities(
    t: FloatArray, taus: FloatArray, t0: float, tf: float, out: FloatArray
) -> None:  # pragma: no cover - compiled
    # columns: tau_v, manifold, tau, t0, tf.
    # d/dtau_j of H = prod 1/(1 + tau p) is -p/(1 + tau_j p) H: an impulse response with that lag
    # twice
    rates = np.sort(1.0 / taus)
    table, h = np.empty(4), np.empty(24)
    nodes = np.empty((3, 4))
    for j in range(3):
        nodes[j, :3] = rates
        nodes[j, 3] = 1.0 / taus[j]
        nodes[j] = np.sort(nodes[j])
    product = rates[0] * rates[1] * rates[2]
    over = SETTLED / rates[0]
    for i in range(len(t)):
        for edge, sign, column in ((t0, -1.0, 3), (tf, 1.0, 4)):
            s = t[i] - edge
            if 0.0 < s < over:
                for j in range(3):
                    value = _divided(nodes[j], s, table, h)
                    out[i, j] -= sign * product / taus[j] * value
                out[i, column] = sign * product * _divided(rates, s, table, h)


def time_constants(tau: float, tau_v: float, V: float, total_flow: float) -> FloatArray:
    """(3,) s: valve, manifold V/Q, sensor.  Raises CampaignError unless all are positive."""
    taus = np.array([tau_v, V / total_flow, tau], dtype=float)
    if not (np.isfinite(taus).all() and (taus > 0).all()):
        raise CampaignError(
            f"time constants must be positive, but tau_v, V/Q, tau are {taus.tolist()} s"
        )
    return taus


def cascade_response(
    t: FloatArray, taus: Sequence[float] | FloatArray, t0: float, tf: float | None = None
) -> FloatArray:
    """x3 (n_t,) at times ``t`` (n_t,) s for time constants ``taus`` (3,) s, any order (eq. 12).

    Exact, continuous in ``t0`` and ``tf``, zero before ``t0``; ``tf`` None: the step stays up.

    >>> cascade_response(np.array([0.0, 50.0]), [0.8577, 0.388, 0.0481], 1.0).round(6).tolist()
    [0.0, 1.0]
    """
    t = np.ascontiguousarray(t, dtype=float)
    out = np.empty_like(t)
    rates = np.sort(1.0 / np.asarray(taus, dtype=float))
    _cascade(t.ravel(), rates, float(t0), np.inf if tf is None else float(tf), out.ravel())
    return out


def cascade_sensitivities(
    t: FloatArray, taus: Sequence[float] | FloatArray, t0: float, tf: float | None = None
) -> FloatArray:
    """(n_t, 5) derivatives of x3 by the three time constants (in their order), t0 and tf."""
    t = np.ascontiguousarray(t, dtype=float)
    out = np.zeros((len(t), 5))
    taus = np.asarray(taus, dtype=float)
    _cascade_sensitivities(t, taus, float(t0), np.inf if tf is None else float(tf), out)
    return out


@njit(cache=True)
def _euler(
    t: FloatArray, h: float, taus: FloatArray, t0: float, tf: float, out: FloatArray
) -> None:  # pragma: no cover - compiled
    x1 = x2 = x3 = 0.0
    for i in range(len(t)):
        out[i] = x3
        u = 1.0 if (t[i] >= t0 and t[i] < tf) else 0.0
        d1 = (u - x1) / taus[0]
        d2 = (x1 - x2) / taus[1]
        d3 = (x2 - x3) / taus[2]
        x1 += h * d1
        x2 += h * d2
        x3 += h * d3


def euler_response(
    t: FloatArray,
    interval: float,
    taus: Sequence[float] | FloatArray,
    t0: float,
    tf: float | None = None,
) -> FloatArray:
    """x3 (n_t,) by forward Euler at the sampling interval from a zero state (paper Sec. III-B).

    Piecewise constant in t0 and tf: they act through a sample index.
    """
    t = np.ascontiguousarray(t, dtype=float)
    out = np.empty_like(t)
    taus = np.asarray(taus, dtype=float)
    _euler(t, float(interval), taus, float(t0), np.inf if tf is None else float(tf), out)
    return out


@dataclass(frozen=True)
class Cascade:
    """The paper's model: parameters and the response at any time.

    Effects (gap/effects) return objects of the same shape: ``extra`` names of added parameters,
    ``response`` (the test-gas concentration the sensor sees, 0..1) and ``mean`` (V), all taking
    the flat vector of ``layout(campaign)``.
    """

    method: str = field(default="exact")
    """``exact`` (closed form) or ``euler`` (the paper's forward Euler; uniform ``t`` only)"""
    extra: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        if self.method not in ("exact", "euler"):
            raise CampaignError(f"method must be 'exact' or 'euler', but is '{self.method}'")

    def response(
        self, t: FloatArray, theta: FloatArray, layout: Layout, experiment: Experiment
    ) -> FloatArray:
        """x3 (n_t,), between 0 and 1."""
        _, _, t0, tf = local_parameters(theta, layout, experiment.name)
        taus = time_constants(theta[0], theta[1], theta[2], experiment.total_flow)
        if self.method == "euler":
            return euler_response(t, experiment.interval, taus, t0, tf)
        return cascade_response(t, taus, t0, tf)

    def mean(
        self, t: FloatArray, theta: FloatArray, layout: Layout, experiment: Experiment
    ) -> FloatArray:
        """y0 + beta x3 (n_t,), V (paper eq. 11)."""
        y0, beta, _, _ = local_parameters(theta, layout, experiment.name)
        return y0 + beta * self.response(t, theta, layout, experiment)

    def jacobian(
        self, t: FloatArray, theta: FloatArray, layout: Layout, experiment: Experiment
    ) -> FloatArray:
        """(n_t, n_mean) derivatives of the mean by every parameter of the mean; exact method."""
        _, beta, t0, tf = local_parameters(theta, layout, experiment.name)
        taus = time_constants(theta[0], theta[1], theta[2], experiment.total_flow)
        x = cascade_response(t, taus, t0, tf)
        dx = cascade_sensitivities(t, taus, t0, tf)
        jacobian = np.zeros((len(t), layout.n_mean))
        jacobian[:, 0] = beta * dx[:, 2]
        jacobian[:, 1] = beta * dx[:, 0]
        jacobian[:, 2] = beta * dx[:, 1] / experiment.total_flow
        i_y0, i_beta, i_t0, i_tf = layout.local[layout.experiments.index(experiment.name)]
        jacobian[:, i_y0] = 1.0
        jacobian[:, i_beta] = x
        jacobian[:, i_t0] = beta * dx[:, 3]
        if i_tf >= 0:
            jacobian[:, i_tf] = beta * dx[:, 4]
        return jacobian


def exchanged(thetas: FloatArray, flow: float) -> FloatArray:
    """``thetas`` (.., n_theta) with tau_v in the place of V/Q and the other way round.

    ``flow``: Q in mL/s, at which the response stays what it is.  An involution that
    keeps volumes: draws need no weight for it.
    """
    found = np.array(thetas, dtype=float)
    found[..., 1], found[..., 2] = thetas[..., 2] / flow, thetas[..., 1] * flow
    return found


def local_parameters(
    theta: FloatArray, layout: Layout, name: str
) -> tuple[float, float, float, float | None]:
    """y0, beta, t0, tf (None where no step down exists) of one experiment."""
    i_y0, i_beta, i_t0, i_tf = layout.local[layout.experiments.index(name)]
    tf = float(theta[i_tf]) if i_tf >= 0 else None
    return float(theta[i_y0]), float(theta[i_beta]), float(theta[i_t0]), tf


def predict(
    campaign: Campaign, theta: Theta, model: Cascade | None = None
) -> dict[str, FloatArray]:
    """The model's mean (n_t,) V of every experiment, by name."""
    model = model or Cascade()
    layout = Layout.of(campaign, extra=model.extra)
    vector = layout.flat(theta)
    return {e.name: model.mean(e.t, vector, layout, e) for e in campaign}
