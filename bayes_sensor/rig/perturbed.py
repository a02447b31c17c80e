"""A rig with every imperfection of the catalogue: one kernel, from the valve to the voltage.

The published model is a cascade of three first-order lags.  Real rigs depart from it stage by
stage, so the stages are computed one after the other on a time grid that starts at each switch
and grows geometrically::

    command -> valve x1 -> manifold x2 -> sensor x3 -> low-pass -> readout y

Every lag is advanced exactly for an input that is quadratic within a cell, so that time constants
far below the grid's steps are no trouble.  With the neutral settings the response is the closed
form of :mod:`bayes_sensor.rig.cascade` (a test compares them).  An effect only says which settings
it changes; effects on different settings can therefore act together.
"""

from __future__ import annotations

from collections.abc import Mapping
from math import cos, exp, log, sqrt
from typing import NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from bayes_sensor.campaign import FloatArray
from bayes_sensor.rig.exponential import exponentials
from bayes_sensor.rig.lag_cells import (
    Cells,
    add_butterworth,
    add_within,
    advance,
    growing_grid,
    lag_states,
    middles,
    with_pocket,
)

GAS, SENSOR, READOUT = "gas", "sensor", "readout"
"""stages: what one of them changes leaves those before it as they are"""

# the first entries of the kernel's parameter vector, before the settings
TAU, TAU_V, TAU_M, Y0, BETA, T0, TF, CONCENTRATION, START, MIDDLE = range(10)
FIRST = 10
_stages = [SENSOR, GAS, GAS, READOUT, READOUT, GAS, GAS, GAS, SENSOR, READOUT]


class RigSetting(NamedTuple):
    """One imperfection that the rig may have."""

    neutral: float
    """the value at which it has none"""
    stage: str
    meaning: str
    """with its unit"""


SETTINGS: dict[str, RigSetting] = {}
"""by name, in the order of the kernel's parameter vector"""


def _setting(name: str, neutral: float, stage: str, meaning: str) -> int:
    """The place in the kernel's parameter vector of a setting that is new in the table."""
    SETTINGS[name] = RigSetting(neutral, stage, meaning)
    _stages.append(stage)
    return len(_stages) - 1


# A setting with new physics is one line here and what the kernel does with it.
CLOSING = _setting(
    "closing_ratio", 1.0, GAS, "valve time constant when shutting over that when opening"
)
CLOSING_BEND = _setting(
    "closing_bend", 0.0, GAS, "how much that constant falls from the first of the way to the last"
)
INERTIA = _setting("inertia", 0.0, GAS, "kappa in kappa tau_v^2 x'' + tau_v x' + x = u")
STROKE = _setting("stroke", 0.0, GAS, "s, time in which the valve's command goes from shut to open")
BEND = _setting("stroke_bend", 0.0, GAS, "0: evenly .. 1: accelerating evenly, from rest")
SLOW_V = _setting("slow_valve_share", 0.0, GAS, "share of the valve's opening that follows slowly")
SLOW_V_TIME = _setting("slow_valve_time", 1.0, GAS, "s, time constant of that share")
SETTLING = _setting(
    "settling_share", 0.0, GAS, "inlet concentration is low by this share right after opening"
)
SETTLING_TIME = _setting("settling_time", 1.0, GAS, "s, in which that deficit decays")
SETTLING_SWING = _setting("settling_swing", 0.0, GAS, "rad/s, with which it swings while it decays")
SWITCHING = _setting(
    "flow_switching", 0.0, GAS, "share of the test-gas flow that stops when the valve shuts"
)
PREMIXED = _setting(
    "premixed", 0.0, GAS, "1: what then enters keeps the concentration that the valve gives it"
)
FLOW = _setting("flow_factor", 1.0, GAS, "true total flow over the set one")
POCKET = _setting("pocket_share", 0.0, GAS, "volume of a stagnant pocket over V")
POCKET_TIME = _setting("pocket_time", 1.0, GAS, "s, exchange time of the pocket")
TANK = _setting("tank_share", 0.0, GAS, "share of V that forms a second tank in series")
RELEASE = _setting(
    "release_ratio", 1.0, SENSOR, "sensor time constant of release over that of uptake"
)
RELEASE_WIDTH = _setting(
    "release_width", 0.0, SENSOR, "distance from equilibrium, of the step, over which that changes"
)
SLOW_S = _setting(
    "slow_site_share", 0.0, SENSOR, "share of the sensor's response that follows slowly"
)
SLOW_S_TIME = _setting("slow_site_time", 1.0, SENSOR, "s, time constant of that share")
SLOW_S_SPREAD = _setting(
    "slow_site_spread",
    1.0,
    SENSOR,
    "half of that share is this much slower or faster, in equal parts",
)
COATING = _setting(
    "coating", 0.0, SENSOR, "0 single lag .. 1 diffusion through the layered coating"
)
FILTER = _setting("filter", 0.0, SENSOR, "s, time constant of a low-pass before the converter")
FILTER_SECOND = _setting(
    "filter_second", 0.0, SENSOR, "s, time constant of that low-pass' second pole; 0: it has one"
)
FILTER_BUTTERWORTH = _setting(
    "filter_butterworth", 0.0, SENSOR, "s, 1/omega of a Butterworth low-pass of two poles there"
)
CURVATURE = _setting("curvature", 0.0, READOUT, "1/V, k in v + k v^2 + m v^3 with v = beta x3")
CUBIC = _setting("cubic", 0.0, READOUT, "1/V^2, m in the same")
DRIFT = _setting("drift", 0.0, READOUT, "V/s, slope of the baseline")
DRIFT_CURVE = _setting("drift_curve", 0.0, READOUT, "V/s^2, bend of the baseline")
DRIFT_TWIST = _setting("drift_twist", 0.0, READOUT, "V/s^3, change of that bend")
STEP = _setting("step", 0.0, READOUT, "V, step of the baseline")
STEP_TIME = _setting("step_time", 0.0, READOUT, "s, when it begins")
STEP_WITH_FALL = _setting("step_with_fall", 0.0, READOUT, "1: that time counts from the step down")
STEP_WIDTH = _setting("step_width", 0.0, READOUT, "s, time constant with which it settles")
GAIN = _setting("gain_drift", 0.0, READOUT, "1/s, relative change of beta with time")
GAIN_CURVE = _setting("gain_curve", 0.0, READOUT, "1/s^2, bend of that change")
GAIN_TWIST = _setting("gain_twist", 0.0, READOUT, "1/s^3, change of that bend")
GAIN_OF_ALL = _setting(
    "gain_of_all", 0.0, READOUT, "1: what changes is the whole voltage, y0 included"
)
CARRY = _setting(
    "carry_over", 0.0, SENSOR, "share of beta still in the manifold when the record starts"
)
CARRY_TIME = _setting("carry_time", 0.0, SENSOR, "s, in which it leaves; 0: the manifold's own V/Q")
CARRY_SPREAD = _setting(
    "carry_spread", 1.0, SENSOR, "half of it leaves this much slower or faster, in equal parts"
)
VALVE_FACTOR = _setting("valve_factor", 1.0, GAS, "valve time constant over the common one")
SENSOR_FACTOR = _setting("sensor_factor", 1.0, SENSOR, "sensor time constant over the common one")
EMPTYING = _setting(
    "emptying_ratio", 1.0, GAS, "manifold time constant after the step down over that before"
)
LATE = _setting(
    "late_share", 0.0, GAS, "share of the gas that comes later, and goes later, than the rest"
)
LATE_RISE = _setting("late_rise", 0.0, GAS, "s, by which it comes later")
LATE_FALL = _setting("late_fall", 0.0, GAS, "s, by which it goes later")

INDEX = {name: i for i, name in enumerate(SETTINGS)}
NEUTRAL = np.array([setting.neutral for setting in SETTINGS.values()])
_of_the_gas = np.flatnonzero(np.array(_stages) == GAS)
_before_the_readout = np.flatnonzero(np.array(_stages) != READOUT)

CELLS_PER_TIME_CONSTANT = 14.0


def settings_vector(settings: Mapping[str, float]) -> FloatArray:
    """(n_settings,) the neutral settings with those given replaced.  Raises KeyError."""
    vector = NEUTRAL.copy()
    for name, value in settings.items():
        vector[INDEX[name]] = value
    return vector


# --------------------------------------------------------------------------- the valve


@njit(cache=True, error_model="numpy")
def _opening(
    since: FloatArray, tau: float, inertia: float, stroke: float, bend: float
) -> FloatArray:  # pragma: no cover
    # step response (n,) of the valve, s after the command; 0 before it
    s = np.maximum(since, 0.0)
    if stroke > 0.0:  # the lag's response to a command (1 - bend) q + bend q^2, q = s/stroke
        ramping = np.minimum(s, stroke)
        late = (ramping - s) / tau
        exponentials(late)
        gone = -ramping / tau
        exponentials(gone)
        for i in range(len(s)):
            left = ramping[i] - tau * (1.0 - gone[i])
            x = left / stroke
            square = ramping[i] * ramping[i] - 2.0 * tau * left
            x += bend * (square / (stroke * stroke) - x)
            s[i] = 1.0 - (1.0 - x) * late[i]
        return s
    if inertia > 1e-9:
        gap = 1.0 - 4.0 * inertia
        if gap > 1e-6:
            slow = 0.5 * tau * (1.0 + sqrt(gap))
            fast = inertia * tau * tau / slow
            slowly, quickly = -s / slow, -s / fast
            exponentials(slowly)
            exponentials(quickly)
            return 1.0 - (slow * slowly - fast * quickly) / (slow - fast)
        rate = 0.5 / (inertia * tau)
        decay = -rate * s
        exponentials(decay)
        if gap < -1e-6:
            omega = rate * sqrt(-gap)
            return 1.0 - decay * (np.cos(omega * s) + rate / omega * np.sin(omega * s))
        return 1.0 - decay * (1.0 + rate * s)
    decay = -s / tau
    exponentials(decay)
    return 1.0 - decay


@njit(cache=True)
def _still_open(even: float, bend: float) -> float:  # pragma: no cover
    # y of tau (1 + bend (y - 1/2)) y' = -y where without the bend it would be ``even``:
    # (1 - bend/2) ln y + bend (y - 1) = ln even, by Newton's method
    if bend == 0.0 or even <= 1e-12:
        return even
    end = log(even)
    u = end
    for _ in range(30):
        y = exp(u)
        step = ((1.0 - 0.5 * bend) * u + bend * (y - 1.0) - end) / (1.0 - 0.5 * bend + bend * y)
        u = min(u - step, 0.0)
        if abs(step) < 1e-12:
            break
    return exp(u)


@njit(cache=True)
def _valve(t: FloatArray, p: FloatArray) -> FloatArray:  # pragma: no cover
    # x1 (n,) at times (n,); a way that is longer for a part of the gas is a valve that opens late
    # for it
    x = _one_valve(t, p, p[T0], p[TF])
    if p[LATE] != 0.0:
        x += p[LATE] * (_one_valve(t, p, p[T0] + p[LATE_RISE], p[TF] + p[LATE_FALL]) - x)
    return x


@njit(cache=True)
def _one_valve(
    t: FloatArray, p: FloatArray, t0: float, tf: float
) -> FloatArray:  # pragma: no cover
    # x1 (n,) at times (n,) of a valve commanded at t0 and tf
    tau, share = p[TAU_V] * p[VALVE_FACTOR], p[SLOW_V]
    inertia, stroke, bend = p[INERTIA], p[STROKE], p[BEND]
    alike = p[CLOSING] == 1.0 and p[CLOSING_BEND] == 0.0
    if alike and inertia <= 1e-9 and stroke <= 0.0:  # one exponential up, one down
        reached = 1.0 - exp(-max(tf - t0, 0.0) / tau)
        x = np.empty(len(t))
        rate = 1.0 / tau
        for i in range(len(t)):
            x[i] = rate * (tf - t[i] if t[i] > tf else min(t0 - t[i], 0.0))
        exponentials(x)
        for i in range(len(t)):
            x[i] = reached * x[i] if t[i] > tf else 1.0 - x[i]
    else:
        x = _opening(t - t0, tau, inertia, stroke, bend)
        if alike:  # linear: opening minus shutting
            x -= _opening(t - tf, tau, inertia, stroke, bend)
        else:
            reached = _opening(np.array([tf - t0]), tau, inertia, stroke, bend)[0]
            shut = _opening(t - tf, tau * p[CLOSING], inertia, stroke, bend)
            for i in range(len(t)):
                if t[i] > tf:
                    x[i] = reached * _still_open(1.0 - shut[i], p[CLOSING_BEND])
    for i in range(len(t)):
        since, after = t[i] - t0, t[i] - tf
        if share != 0.0 and since > 0.0:
            slow = -exp(-since / p[SLOW_V_TIME])
            slow += exp(-after / p[SLOW_V_TIME]) if after > 0.0 else 1.0
            x[i] += share * (slow - x[i])
        if p[SETTLING] != 0.0 and since > 0.0:
            gone = exp(-since / p[SETTLING_TIME])
            x[i] *= 1.0 - p[SETTLING] * gone * cos(p[SETTLING_SWING] * since)
    return x


@njit(cache=True)
def _manifold(
    t: FloatArray, x1: FloatArray, x1_mid: FloatArray, p: FloatArray
) -> tuple[FloatArray, FloatArray]:  # pragma: no cover
    # x2 (n,) and its middles (n - 1,) on the grid
    h = t[1:] - t[:-1]
    a, m, b = x1[:-1], x1_mid, x1[1:]
    filling = p[FLOW] / (p[TAU_M] * (1.0 - p[TANK]))
    rates = np.full(len(h), filling)
    rates[np.searchsorted(t[:-1], p[TF]) :] /= p[EMPTYING]
    rates_a, rates_b = rates, rates
    lost = p[SWITCHING] * p[CONCENTRATION]
    if lost != 0.0:
        # the flow through the manifold follows the valve; what enters is Q x1 where the valve is
        # in the test gas's line, and of concentration x1 where the gases are mixed before it
        rates_a = rates * (1.0 - lost + lost * a)
        rates_m = rates * (1.0 - lost + lost * m)
        rates_b = rates * (1.0 - lost + lost * b)
        if p[PREMIXED] == 0.0:
            a, m, b = a * rates / rates_a, m * rates / rates_m, b * rates / rates_b
        rates = (rates_a + 4.0 * rates_m + rates_b) / 6.0
    if p[POCKET] <= 0.0:
        x2 = lag_states(Cells(h, a, m, b), rates)
    else:  # what the pocket gives back is a second input
        x2, pocket = with_pocket(Cells(h, a, m, b), rates, p[POCKET], p[POCKET_TIME])
        k = p[POCKET] / p[POCKET_TIME]
        a = (rates_a * a + k * pocket[:-1]) / (rates_a + k)
        b = (rates_b * b + k * pocket[1:]) / (rates_b + k)
        rates_a, rates_b = rates_a + k, rates_b + k
    mid = middles(h, x2, a, b, rates_a, rates_b)
    if p[TANK] > 0.0:
        rates = np.full(len(h), p[FLOW] / (p[TAU_M] * p[TANK]))
        a, b = x2[:-1], x2[1:]
        x2 = lag_states(Cells(h, a, mid, b), rates)
        mid = middles(h, x2, a, b, rates, rates)
    return x2, mid


# --------------------------------------------------------------------------- from gas to volts


@njit(cache=True)
def _gas(
    last: float, p: FloatArray
) -> tuple[FloatArray, FloatArray, FloatArray]:  # pragma: no cover
    # a grid (n,) s from t0 to the last time, x2 (n,) on it and (n - 1,) in the middles of its cells
    t0, tf = p[T0], p[TF]
    first = min(p[TAU_V] * p[VALVE_FACTOR], p[TAU_M] / p[FLOW] * min(1.0, p[EMPTYING]))
    if p[CLOSING] < 1.0 or p[CLOSING_BEND] != 0.0:
        first = min(first, p[CLOSING] * p[TAU_V] * (1.0 - 0.5 * abs(p[CLOSING_BEND])))
    if p[INERTIA] > 0.0:
        first = min(first, 2.0 * p[TAU_V] * sqrt(p[INERTIA]) + 0.2 * p[TAU_V])
    if p[STROKE] > 0.0:
        first = min(first, 2.0 * p[STROKE] + 0.2 * p[TAU_V])
    if p[TANK] > 0.0:
        first = min(first, 2.0 * p[TAU_M] * p[TANK] + 0.3 * first)
    if p[SETTLING] != 0.0:
        first = min(first, 2.0 * p[SETTLING_TIME])
    first /= CELLS_PER_TIME_CONSTANT
    # the valve's motion breaks off at these times: a new grid begins at each
    events = np.array([t0, tf, t0 + p[LATE_RISE], tf + p[LATE_FALL]])
    events = np.sort(events if p[LATE] != 0.0 else events[:2])
    t = np.array([t0])
    for i in range(len(events)):
        until = min(events[i + 1], last) if i + 1 < len(events) else last
        if until - t[-1] > 1e-3 * first:
            t = np.concatenate((t, growing_grid(t[-1], until, first)[1:]))
    x1, x1_mid = _valve(t, p), _valve(0.5 * (t[:-1] + t[1:]), p)
    x2, x2_mid = _manifold(t, x1, x1_mid, p)
    return t, x2, x2_mid


@njit(cache=True)
def _sensed(
    times: FloatArray,
    p: FloatArray,
    t: FloatArray,
    x2: FloatArray,
    x2_mid: FloatArray,
    mode_share: FloatArray,
    mode_ratio: FloatArray,
) -> FloatArray:  # pragma: no cover
    # x3 at sorted times, of the gas x2 on the grid t
    out = np.zeros(len(times))
    if times[-1] > p[T0]:
        _add_response(times, p, t, x2, x2_mid, mode_share, mode_ratio, out)
    if p[CARRY] != 0.0:
        _add_carried(times, p, out)
    return out


@njit(cache=True)
def _add_response(
    times: FloatArray,
    p: FloatArray,
    t: FloatArray,
    x2: FloatArray,
    x2_mid: FloatArray,
    mode_share: FloatArray,
    mode_ratio: FloatArray,
    out: FloatArray,
) -> None:  # pragma: no cover
    if len(t) < 2:
        return
    share, tau = _modes(p, mode_share, mode_ratio)
    h = t[1:] - t[:-1]
    gas = Cells(h, x2[:-1], x2_mid, x2[1:])
    k = 0
    while times[k] <= p[T0]:
        k += 1
    places, since = _places(times[k:], t)
    low_pass = max(p[FILTER], p[FILTER_BUTTERWORTH])
    # a low-pass takes all that the lags make, at the ends and in the middles of the cells
    x3 = np.zeros(len(t))
    at, after, made = places, since, out[k:]
    if low_pass > 0.0:
        at, after, made = np.arange(len(h)), 0.5 * h, np.zeros(len(h))
    for j in range(len(share)):
        rates, states = _sensor(gas, tau[j], p[RELEASE], p[RELEASE_WIDTH])
        add_within(share[j], at, after, gas, rates, states, made)
        if low_pass > 0.0:
            x3 += share[j] * states
    if low_pass > 0.0:
        sensed = Cells(h, x3[:-1], made, x3[1:])
        if p[FILTER_BUTTERWORTH] > 0.0:
            add_butterworth(places, since, sensed, low_pass, out[k:])
            return
        rates = np.full(len(h), 1.0 / low_pass)
        passed = lag_states(sensed, rates)
        if p[FILTER_SECOND] > 0.0:
            middles = np.zeros(len(h))
            add_within(1.0, at, after, sensed, rates, passed, middles)
            sensed = Cells(h, passed[:-1], middles, passed[1:])
            rates = np.full(len(h), 1.0 / p[FILTER_SECOND])
            passed = lag_states(sensed, rates)
        add_within(1.0, places, since, sensed, rates, passed, out[k:])


@njit(cache=True)
def _modes(
    p: FloatArray, mode_share: FloatArray, mode_ratio: FloatArray
) -> tuple[FloatArray, FloatArray]:  # pragma: no cover
    # shares (n_modes,) and time constants (n_modes,) s of the sensor's parallel lags: the single
    # one, those of the coating, and slow sites
    n_modes = len(mode_share)
    share, tau = np.zeros(n_modes + 4), np.ones(n_modes + 4)
    share[0] = (1.0 - p[COATING]) * (1.0 - p[SLOW_S])
    tau[0] = p[TAU] * p[SENSOR_FACTOR]
    used = 1
    if p[COATING] != 0.0:
        for j in range(n_modes):
            share[used] = p[COATING] * (1.0 - p[SLOW_S]) * mode_share[j]
            tau[used] = tau[0] * mode_ratio[j]
            used += 1
    if p[SLOW_S] != 0.0:
        share[used] = p[SLOW_S]
        tau[used] = p[SLOW_S_TIME]
        used += 1
        if p[SLOW_S_SPREAD] != 1.0:
            share[used - 1] *= 0.5
            for factor in (p[SLOW_S_SPREAD], 1.0 / p[SLOW_S_SPREAD]):
                share[used] = 0.25 * p[SLOW_S]
                tau[used] = p[SLOW_S_TIME] * factor
                used += 1
    return share[:used], tau[:used]


@njit(cache=True)
def _places(
    times: FloatArray, t: FloatArray
) -> tuple[NDArray[np.int64], FloatArray]:  # pragma: no cover
    # the cell of the grid t in which each of the sorted times (n_t,) lies, what is after the last
    # in the last, and the time since its begin
    places, since = np.empty(len(times), dtype=np.int64), np.empty(len(times))
    i, last = 0, len(t) - 2
    for q in range(len(times)):
        while i < last and times[q] > t[i + 1]:
            i += 1
        places[q] = i
        since[q] = times[q] - t[i]
    return places, since


@njit(cache=True)
def _sensor(
    cells: Cells, tau: float, ratio: float, width: float
) -> tuple[FloatArray, FloatArray]:  # pragma: no cover
    # one of the sensor's lags: its rates (n,) in the cells and its states (n + 1,) at their ends.
    # It releases more slowly by ``ratio`` than it takes up, each lag by what drives it: one that
    # is in equilibrium drives itself by rounding alone
    h, a, m, b = cells
    rates = np.full(len(h), 1.0 / tau)
    if ratio == 1.0:
        return rates, lag_states(cells, rates)
    states, log_ratio = np.zeros(len(h) + 1), log(ratio)
    for i in range(len(h)):
        slower = _slower(m[i] - states[i], log_ratio, width)
        if width > 0.0:  # the state half a cell on is nearer to what counts
            half_m = 0.375 * a[i] + 0.75 * m[i] - 0.125 * b[i]
            half = advance(states[i], 0.5 * h[i] / (tau * slower), a[i], half_m, m[i])
            slower = _slower(m[i] - half, log_ratio, width)
        rates[i] /= slower
        states[i + 1] = advance(states[i], h[i] * rates[i], a[i], m[i], b[i])
    return rates, states


@njit(cache=True, inline="always")
def _slower(drive: float, log_ratio: float, width: float) -> float:  # pragma: no cover
    # factor on the sensor's time constant where what drives it exceeds its state by this much:
    # the ratio to the power (1 - tanh(drive/width))/2
    if width > 0.0:
        return exp(log_ratio / (1.0 + exp(min(2.0 * drive / width, 700.0))))
    return exp(log_ratio) if drive < 0.0 else 1.0


@njit(cache=True)
def rig_response(
    times: FloatArray, p: FloatArray, mode_share: FloatArray, mode_ratio: FloatArray
) -> FloatArray:  # pragma: no cover
    """x3 (n_t,), the concentration that the readout sees, at sorted ``times`` (n_t,) s."""
    t, x2, x2_mid = _gas(times[-1], p)
    return _sensed(times, p, t, x2, x2_mid, mode_share, mode_ratio)


@njit(cache=True)
def _add_carried(times: FloatArray, p: FloatArray, out: FloatArray) -> None:  # pragma: no cover
    # gas left from before: it leaves with the manifold's time constant, or with one of its own or
    # a spread of them, and lags in the sensor, which was in equilibrium with it when the record
    # began
    slow = p[CARRY_TIME]
    if slow <= 0.0:
        slow = p[TAU_M] / p[FLOW]
    spread = p[CARRY_SPREAD]
    if spread == 1.0:
        _add_leaving(times, p[START], p[CARRY], slow, p[TAU], out)
    else:
        _add_leaving(times, p[START], 0.5 * p[CARRY], slow, p[TAU], out)
        for factor in (spread, 1.0 / spread):
            _add_leaving(times, p[START], 0.25 * p[CARRY], slow * factor, p[TAU], out)


@njit(cache=True)
def _add_leaving(
    times: FloatArray, start: float, share: float, slow: float, tau: float, out: FloatArray
) -> None:  # pragma: no cover
    fast = tau
    if abs(slow - fast) < 1e-6 * slow:
        fast = slow * (1.0 - 1e-6)
    for i in range(len(times)):
        s = times[i] - start
        if s >= 0.0:
            out[i] += share * (slow * exp(-s / slow) - fast * exp(-s / fast)) / (slow - fast)


@njit(cache=True)
def rig_mean(
    times: FloatArray, p: FloatArray, mode_share: FloatArray, mode_ratio: FloatArray
) -> FloatArray:  # pragma: no cover
    """The mean voltage (n_t,) at sorted ``times`` (n_t,) s."""
    return _read(times, p, rig_response(times, p, mode_share, mode_ratio))


@njit(cache=True)
def _read(times: FloatArray, p: FloatArray, response: FloatArray) -> FloatArray:  # pragma: no cover
    # V at the times of a response x3
    y0, beta, middle, cubic = p[Y0], p[BETA], p[MIDDLE], p[CUBIC]
    # towards the step: a signal upside down bends upside down
    curvature = p[CURVATURE] if beta >= 0.0 else -p[CURVATURE]
    gain, gain_curve, gain_twist, of_all = p[GAIN], p[GAIN_CURVE], p[GAIN_TWIST], p[GAIN_OF_ALL]
    drift, drift_curve, drift_twist = p[DRIFT], p[DRIFT_CURVE], p[DRIFT_TWIST]
    volts = np.empty(len(times))
    for i in range(len(times)):
        v = beta * response[i]
        v *= 1.0 + v * (curvature + cubic * v)
        since = times[i] - middle
        gained = since * (gain + since * (gain_curve + since * gain_twist))
        v += v * gained + y0 * (1.0 + of_all * gained)
        volts[i] = v + since * (drift + since * (drift_curve + since * drift_twist))
    if p[STEP] != 0.0:
        step_time = p[STEP_TIME] + (p[TF] if p[STEP_WITH_FALL] > 0.0 else 0.0)
        for i in range(len(times)):
            if times[i] >= step_time:
                settled = 1.0
                if p[STEP_WIDTH] > 0.0:
                    settled -= exp(-(times[i] - step_time) / p[STEP_WIDTH])
                volts[i] += p[STEP] * settled
    return volts


@njit(cache=True)
def step_means(low: FloatArray, high: FloatArray, p: FloatArray) -> FloatArray:  # pragma: no cover
    """(n_bins,) V: means of the baseline's step between ``low`` and ``high`` (n_bins,) s.

    Exact, where a few times in a bin would not tell where in it the step is.
    """
    made = np.zeros(len(low))
    if p[STEP] == 0.0:
        return made
    begin = p[STEP_TIME] + (p[TF] if p[STEP_WITH_FALL] > 0.0 else 0.0)
    width = p[STEP_WIDTH]
    for i in range(len(low)):
        if high[i] > begin:
            first = max(low[i] - begin, 0.0)
            last = high[i] - begin
            area = last - first
            if width > 0.0:
                area -= width * (exp(-first / width) - exp(-last / width))
            made[i] = p[STEP] * area / (high[i] - low[i])
    return made


@njit(cache=True)
def campaign_means(
    times: FloatArray,
    weights: FloatArray,
    starts: NDArray[np.int64],
    low: FloatArray,
    high: FloatArray,
    of_times: NDArray[np.int64],
    of_bins: NDArray[np.int64],
    p: FloatArray,
    mode_share: FloatArray,
    mode_ratio: FloatArray,
) -> FloatArray:  # pragma: no cover
    """(n_bins,) V: means of the bins of all experiments, each with its own row of ``p``.

    Of each bin, from ``low`` to ``high`` (n_bins,) s, the voltage at its ``times`` (n_times,) s is
    summed with the ``weights`` (n_times,).  One experiment comes after the other: ``of_times`` and
    ``of_bins`` (n_experiments + 1,) say where each begins and the last ends, and ``starts``
    (n_bins,) which of its experiment's times is a bin's first.
    """
    made = np.empty(len(starts))
    for k in range(len(p)):
        here = slice(of_bins[k], of_bins[k + 1])
        at = times[of_times[k] : of_times[k + 1]]
        weight = weights[of_times[k] : of_times[k + 1]]
        x3 = rig_response(at, p[k], mode_share, mode_ratio)
        _average(at, weight, starts[here], low[here], high[here], p[k], x3, made[here])
    return made


@njit(cache=True)
def moved_means(
    times: FloatArray,
    weights: FloatArray,
    starts: NDArray[np.int64],
    low: FloatArray,
    high: FloatArray,
    of_times: NDArray[np.int64],
    of_bins: NDArray[np.int64],
    p: FloatArray,
    of_rigs: NDArray[np.int64],
    mode_share: FloatArray,
    mode_ratio: FloatArray,
) -> FloatArray:  # pragma: no cover
    """(n_bins, most rows of an experiment less one) V: the same for several rigs of each.

    The rows of experiment k begin at ``of_rigs[k]`` (n_experiments + 1,), with a rig that is not
    asked for: what the others have in common with it is computed once.  Where an experiment has
    fewer rigs than another, zeros fill up.
    """
    most = 0
    for k in range(len(of_rigs) - 1):
        most = max(most, of_rigs[k + 1] - of_rigs[k] - 1)
    made = np.zeros((len(starts), most))
    for k in range(len(of_rigs) - 1):
        here = slice(of_bins[k], of_bins[k + 1])
        at = times[of_times[k] : of_times[k + 1]]
        weight = weights[of_times[k] : of_times[k + 1]]
        common = p[of_rigs[k]]
        t, x2, x2_mid = _gas(at[-1], common)
        response = _sensed(at, common, t, x2, x2_mid, mode_share, mode_ratio)
        column = np.empty(of_bins[k + 1] - of_bins[k])
        for i in range(of_rigs[k] + 1, of_rigs[k + 1]):
            if _same(p[i], common, _before_the_readout):
                x3 = response
            elif _same(p[i], common, _of_the_gas):
                x3 = _sensed(at, p[i], t, x2, x2_mid, mode_share, mode_ratio)
            else:
                x3 = rig_response(at, p[i], mode_share, mode_ratio)
            _average(at, weight, starts[here], low[here], high[here], p[i], x3, column)
            made[here, i - of_rigs[k] - 1] = column
    return made


@njit(cache=True)
def _average(
    times: FloatArray,
    weights: FloatArray,
    starts: NDArray[np.int64],
    low: FloatArray,
    high: FloatArray,
    p: FloatArray,
    response: FloatArray,
    made: FloatArray,
) -> None:  # pragma: no cover
    # means (n_bins,) of the voltage of a response x3, into ``made``
    step, p = p[STEP], p.copy()
    p[STEP] = 0.0
    volts = _read(times, p, response)
    for b in range(len(starts)):
        end = starts[b + 1] if b + 1 < len(starts) else len(times)
        total = 0.0
        for k in range(starts[b], end):
            total += weights[k] * volts[k]
        made[b] = total
    if step != 0.0:
        p[STEP] = step
        made += step_means(low, high, p)


@njit(cache=True)
def _same(p: FloatArray, q: FloatArray, which: NDArray[np.int64]) -> bool:  # pragma: no cover
    for i in which:
        if p[i] != q[i]:
            return False
    return True
