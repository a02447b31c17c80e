"""The coupled sensor-and-rig model: valve, manifold and sensor in cascade (paper eqs. 5-12).

::

    x1' = (u - x1)/tau_v      valve            u = H(t - t0) - H(t - tf)
    x2' = (Q/V)(x1 - x2)      manifold
    x3' = (x2 - x3)/tau       sensor           y = y0 + beta*x3

Inference uses the exact response of :mod:`bayes_sensor.rig.chain`.  Forward Euler is kept as the
paper's method.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from bayes_sensor.campaign import Campaign, CampaignError, Experiment, FloatArray
from bayes_sensor.compiled import compiled
from bayes_sensor.display import record_card
from bayes_sensor.rig.chain import (
    Drive,
    chain_response,
    lag_sensitivities,
    switch_sensitivities,
)
from bayes_sensor.rig.layout import Layout, Theta
from bayes_sensor.rig.rig import PUBLISHED


def time_constants(tau: float, tau_v: float, V: float, total_flow: float) -> FloatArray:
    """(3,) s: valve, manifold V/Q, sensor.  Raises CampaignError unless all are positive."""
    return PUBLISHED.taus(np.array([tau, tau_v, V], dtype=float), total_flow)


_NOTHING, _UP, _UP_DOWN, _DOWN_UP = np.zeros(2), np.ones(1), np.array([1.0, 0]), np.array([-1.0, 0])


def pulse(t0: float, tf: float | None) -> Drive:
    """The published input: up at ``t0`` and, unless ``tf`` is None, down at ``tf``, s."""
    if tf is None:
        return Drive(np.array([t0]), _NOTHING[:1], _UP, _NOTHING[:1])
    if tf < t0:
        return Drive(np.array([tf, t0]), _NOTHING, _DOWN_UP, _NOTHING)
    return Drive(np.array([t0, tf]), _NOTHING, _UP_DOWN, _NOTHING)


def cascade_response(
    t: FloatArray, taus: Sequence[float] | FloatArray, t0: float, tf: float | None = None
) -> FloatArray:
    """x3 (n_t,) at times ``t`` (n_t,) s for time constants ``taus`` (3,) s, any order (eq. 12).

    Exact, continuous in ``t0`` and ``tf``, zero before ``t0``; ``tf`` None: the step stays up.

    >>> cascade_response(np.array([0.0, 50.0]), [0.8577, 0.388, 0.0481], 1.0).round(6).tolist()
    [0.0, 1.0]
    """
    return chain_response(t, taus, pulse(t0, tf))


def cascade_sensitivities(
    t: FloatArray,
    taus: Sequence[float] | FloatArray,
    t0: float,
    tf: float | None = None,
    interval: float | None = None,
) -> FloatArray:
    """(n_t, 5) derivatives of x3 by the three time constants (in their order), t0 and tf.

    ``interval``: s, where ``t`` is uniform: many times faster.
    """
    times, _, level, none = pulse(t0, tf)
    heights = level.copy()
    heights[1:] -= level[:-1]
    out = np.zeros((len(t), 5))
    out[:, :3] = lag_sensitivities(t, taus, Drive(times, heights, none, none), interval)
    by_switches = switch_sensitivities(t, taus, times, heights, interval)
    out[:, 3 : 3 + len(times)] = by_switches if tf is None or t0 <= tf else by_switches[:, ::-1]
    return out


@compiled()
def _euler(
    t: FloatArray, h: float, taus: FloatArray, t0: float, tf: float, out: FloatArray
) -> None:
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

    _repr_html_ = record_card

    method: str = field(default="exact")
    """``exact`` (closed form) or ``euler`` (the paper's forward Euler; uniform ``t`` only)"""
    extra: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        if self.method not in ("exact", "euler"):
            raise CampaignError(f"method must be 'exact' or 'euler', but is '{self.method}'")

    def response(
        self, t: FloatArray, theta: FloatArray, layout: Layout, experiment: Experiment
    ) -> FloatArray:
        """Response of the whole chain (n_t,): x3 of the published rig, between 0 and 1."""
        if self.method == "euler":
            _, _, t0, tf = local_parameters(theta, layout, experiment.name)
            taus = time_constants(theta[0], theta[1], theta[2], experiment.total_flow)
            return euler_response(t, experiment.interval, taus, t0, tf)
        return response(t, theta, layout, layout.place_of(experiment.name), experiment.total_flow)

    def mean(
        self, t: FloatArray, theta: FloatArray, layout: Layout, experiment: Experiment
    ) -> FloatArray:
        """y0 + beta x3 (n_t,), V (paper eq. 11)."""
        i_y0, i_beta = layout.local[layout.place_of(experiment.name), :2]
        y0, beta = float(theta[i_y0]), float(theta[i_beta])
        return y0 + beta * self.response(t, theta, layout, experiment)

    def jacobian(
        self, t: FloatArray, theta: FloatArray, layout: Layout, experiment: Experiment
    ) -> FloatArray:
        """(n_t, n_mean) derivatives of the mean by every parameter of the mean; exact method."""
        k = layout.place_of(experiment.name)
        i_y0, i_beta = layout.local[k, :2]
        x, index, slopes = response_slopes(t, theta, layout, k, experiment.total_flow)
        jacobian = np.zeros((len(t), layout.n_mean))
        jacobian[:, index] = theta[i_beta] * slopes
        jacobian[:, i_y0] = 1.0
        jacobian[:, i_beta] = x
        return jacobian


def has_own_mean(model: Any) -> bool:
    """Whether a model's mean is another one than :meth:`Cascade.mean`."""
    return type(model).mean is not Cascade.mean


def method_of_chain(model: Any) -> str | None:
    """The method of a model that is a :class:`Cascade` and no more; None for any other."""
    return model.method if type(model) is Cascade else None


def response(
    t: FloatArray,
    theta: FloatArray,
    layout: Layout,
    k: int,
    flow: float,
    interval: float | None = None,
) -> FloatArray:
    """Response (n_t,) of the chain to the input of experiment number ``k``, exact.

    ``interval``: s, where ``t`` is ``t[0] + i * interval``; then by recurrence, many times faster.
    """
    rig, switching = layout.rigs[k], layout.switching[k]
    shared = theta[layout.shared[k]]
    x = rig.passed(t, shared, flow, switching.drive(theta[layout.switches(k)]), interval)
    return switching.level_before + x if switching.level_before else x


def response_slopes(
    t: FloatArray,
    theta: FloatArray,
    layout: Layout,
    k: int,
    flow: float,
    interval: float | None = None,
) -> tuple[FloatArray, NDArray[np.int64], FloatArray]:
    """:func:`response` (n_t,), positions in theta (m,) of what moves it, and the derivatives by
    these (n_t, m)."""
    rig, switching = layout.rigs[k], layout.switching[k]
    shared, places = theta[layout.shared[k]], layout.switches(k)
    values = theta[places]
    x = rig.passed(t, shared, flow, switching.drive(values), interval)
    derivative, by_delay = switching.derivative(values), None
    if switching.recorded is not None or rig.has_delay:
        by_delay = -rig.passed(t, shared, flow, derivative, interval)
    slopes = np.zeros((len(t), len(shared) + len(places)))
    rig.add_slopes(slopes, t, shared, flow, derivative, by_delay, interval)
    if by_delay is not None and switching.recorded is not None:
        slopes[:, -1] = by_delay
    else:
        programme = switching.programme(values)
        if len(switching.moves) == len(places):
            slopes[:, len(shared) :] = rig.switch_sensitivities(
                t, shared, flow, programme, interval
            )
        else:  # all the switches that one parameter moves, together
            for j in range(len(places)):
                own = switching.places == j
                part = Drive.of(programme.times[own], kicks=-programme.heights[own])
                slopes[:, len(shared) + j] = rig.passed(t, shared, flow, part, interval)
    x = switching.level_before + x if switching.level_before else x
    return x, np.concatenate([layout.shared[k], places]), slopes


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
    """y0, beta, t0, tf (None where no step down exists) of one experiment that is a pulse."""
    i_y0, i_beta, i_t0, i_tf = layout.local[layout.place_of(name), :4]
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
