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

SETTINGS: dict[str, tuple[float, str]] = {
    "closing_ratio": (1.0, "valve time constant when shutting over that when opening"),
    "closing_bend": (0.0, "how much that constant falls from the first of the way to the last"),
    "inertia": (0.0, "kappa in kappa tau_v^2 x'' + tau_v x' + x = u"),
    "stroke": (0.0, "s, time in which the valve's command goes from shut to open"),
    "stroke_bend": (0.0, "0: evenly .. 1: accelerating evenly, from rest"),
    "slow_valve_share": (0.0, "share of the valve's opening that follows slowly"),
    "slow_valve_time": (1.0, "s, time constant of that share"),
    "settling_share": (0.0, "inlet concentration is low by this share right after opening"),
    "settling_time": (1.0, "s, in which that deficit decays"),
    "settling_swing": (0.0, "rad/s, with which it swings while it decays"),
    "flow_switching": (0.0, "share of the test-gas flow that stops when the valve shuts"),
    "premixed": (0.0, "1: what then enters keeps the concentration that the valve gives it"),
    "flow_factor": (1.0, "true total flow over the set one"),
    "pocket_share": (0.0, "volume of a stagnant pocket over V"),
    "pocket_time": (1.0, "s, exchange time of the pocket"),
    "tank_share": (0.0, "share of V that forms a second tank in series"),
    "release_ratio": (1.0, "sensor time constant of release over that of uptake"),
    "release_width": (0.0, "distance from equilibrium, of the step, over which that changes"),
    "slow_site_share": (0.0, "share of the sensor's response that follows slowly"),
    "slow_site_time": (1.0, "s, time constant of that share"),
    "slow_site_spread": (1.0, "half of that share is this much slower or faster, in equal parts"),
    "coating": (0.0, "0 single lag .. 1 diffusion through the layered coating"),
    "filter": (0.0, "s, time constant of a low-pass before the converter"),
    "curvature": (0.0, "1/V, k in v + k v^2 + m v^3 with v = beta x3"),
    "cubic": (0.0, "1/V^2, m in the same"),
    "drift": (0.0, "V/s, slope of the baseline"),
    "drift_curve": (0.0, "V/s^2, bend of the baseline"),
    "drift_twist": (0.0, "V/s^3, change of that bend"),
    "step": (0.0, "V, step of the baseline"),
    "step_time": (0.0, "s, when it begins"),
    "step_with_fall": (0.0, "1: that time counts from the step down"),
    "step_width": (0.0, "s, time constant with which it settles"),
    "gain_drift": (0.0, "1/s, relative change of beta with time"),
    "gain_curve": (0.0, "1/s^2, bend of that change"),
    "gain_twist": (0.0, "1/s^3, change of that bend"),
    "gain_of_all": (0.0, "1: what changes is the whole voltage, y0 included"),
    "carry_over": (0.0, "share of beta still in the manifold when the record starts"),
    "carry_time": (0.0, "s, in which it leaves; 0: the manifold's own V/Q"),
    "carry_spread": (1.0, "half of it leaves this much slower or faster, in equal parts"),
    "valve_factor": (1.0, "valve time constant over the common one"),
    "sensor_factor": (1.0, "sensor time constant over the common one"),
    "emptying_ratio": (1.0, "manifold time constant after the step down over that before"),
    "late_share": (0.0, "share of the gas that comes later, and goes later, than the rest"),
    "late_rise": (0.0, "s, by which it comes later"),
    "late_fall": (0.0, "s, by which it goes later"),
}
"""name -> (neutral value, what it is)"""

INDEX = {name: i for i, name in enumerate(SETTINGS)}
NEUTRAL = np.array([value for value, _ in SETTINGS.values()])

# the first entries of the kernel's parameter vector, before the settings
TAU, TAU_V, TAU_M, Y0, BETA, T0, TF, CONCENTRATION, START, MIDDLE = range(10)
FIRST = 10

(
    CLOSING, CLOSING_BEND, INERTIA, STROKE, BEND, SLOW_V, SLOW_V_TIME, SETTLING, SETTLING_TIME,
    SETTLING_SWING, SWITCHING, PREMIXED, FLOW, POCKET, POCKET_TIME, TANK, RELEASE, RELEASE_WIDTH,
    SLOW_S, SLOW_S_TIME, SLOW_S_SPREAD, COATING, FILTER, CURVATURE, CUBIC, DRIFT, DRIFT_CURVE,
    DRIFT_TWIST, STEP, STEP_TIME, STEP_WITH_FALL, STEP_WIDTH, GAIN, GAIN_CURVE, GAIN_TWIST,
    GAIN_OF_ALL, CARRY, CARRY_TIME, CARRY_SPREAD, VALVE_FACTOR, SENSOR_FACTOR, EMPTYING, LATE,
    LATE_RISE, LATE_FALL,
) = range(FIRST, FIRST + len(SETTINGS))  # fmt: skip

OF_THE_READOUT = [
    Y0, BETA, MIDDLE, CURVATURE, CUBIC, DRIFT, DRIFT_CURVE, DRIFT_TWIST, STEP, STEP_TIME,
    STEP_WITH_FALL, STEP_WIDTH, GAIN, GAIN_CURVE, GAIN_TWIST, GAIN_OF_ALL,
]  # fmt: skip
OF_THE_SENSOR = [
    TAU, START, RELEASE, RELEASE_WIDTH, SLOW_S, SLOW_S_TIME, SLOW_S_SPREAD, COATING, FILTER, CARRY,
    CARRY_TIME, CARRY_SPREAD, SENSOR_FACTOR,
]  # fmt: skip
_of_the_gas = np.setdiff1d(np.arange(FIRST + len(SETTINGS)), OF_THE_READOUT + OF_THE_SENSOR)
_before_the_readout = np.setdiff1d(np.arange(FIRST + len(SETTINGS)), OF_THE_READOUT)

CELLS_PER_TIME_CONSTANT = 14.0
GROWTH = 1.06
"""each cell is this much longer than the one before"""
SHORT = 1e-3
"""time constants below which a step's moments come from their series"""


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


# --------------------------------------------------------------------------- lags


class Cells(NamedTuple):
    """The cells of a grid, and the input of a lag in them: quadratic in each."""

    h: FloatArray
    """(n,) s, their lengths"""
    a: FloatArray
    """(n,) input at their begins"""
    m: FloatArray
    """(n,) in their middles"""
    b: FloatArray
    """(n,) at their ends; it may jump to the next begin"""


@njit(cache=True, inline="always")
def _moments(r: float, decay: float) -> tuple[float, float]:  # pragma: no cover
    # what a lag makes, over a step of r time constants in which it decays by the factor ``decay``,
    # of inputs q and q^2, q the part of the step
    per = 1.0 / max(r, SHORT)
    m1 = 1.0 - (1.0 - decay) * per
    m2 = 1.0 - 2.0 * m1 * per
    if r < SHORT:
        return _short_moments(r)
    return m1, m2


@njit(cache=True, inline="always")
def _short_moments(r: float) -> tuple[float, float]:  # pragma: no cover
    # the same by their series
    return (
        r * (0.5 - r / 6.0 * (1.0 - 0.25 * r)),
        r * (1.0 / 3.0 - r / 12.0 * (1.0 - 0.2 * r)),
    )


@njit(cache=True, inline="always")
def _curve(a: float, m: float, b: float) -> tuple[float, float]:  # pragma: no cover
    # rise and bend of the quadratic a + rise q + bend q^2 that passes a, m, b at q = 0, 1/2, 1
    return 4.0 * m - 3.0 * a - b, 2.0 * a - 4.0 * m + 2.0 * b


@njit(cache=True, inline="always")
def _advance(x: float, r: float, a: float, m: float, b: float) -> float:  # pragma: no cover
    # a lag's state after r time constants under an input that passes a, m, b
    decay = exp(-r)
    m1, m2 = _moments(r, decay)
    rise, bend = _curve(a, m, b)
    return a + decay * (x - a) + m1 * rise + m2 * bend


@njit(cache=True, error_model="numpy")
def _lag(cells: Cells, rates: FloatArray) -> FloatArray:  # pragma: no cover
    # a lag's states (n + 1,) at the ends of n cells, its rate another one in each
    h, a, m, b = cells
    n = len(h)
    decay = -rates * h
    exponentials(decay)
    driven = np.empty(n)
    for i in range(n):
        m1, m2 = _moments(rates[i] * h[i], decay[i])
        rise, bend = _curve(a[i], m[i], b[i])
        driven[i] = a[i] * (1.0 - decay[i]) + m1 * rise + m2 * bend
    states = np.zeros(n + 1)
    for i in range(n):
        states[i + 1] = decay[i] * states[i] + driven[i]
    return states


@njit(cache=True, error_model="numpy")
def _add_within(
    share: float,
    places: NDArray[np.int64],
    since: FloatArray,
    cells: Cells,
    rates: FloatArray,
    states: FloatArray,
    out: FloatArray,
) -> None:  # pragma: no cover
    # adds a share of the states that a lag (see :func:`_lag`) has at times (n_t,) ``since`` the
    # begins of the cells at these ``places`` (n_t,)
    h, a, m, b = cells
    n = len(h)
    of_cell = np.empty((n, 6))
    for i in range(n):
        rise, bend = _curve(a[i], m[i], b[i])
        per = 1.0 / h[i]
        of_cell[i, 0] = share * a[i]
        of_cell[i, 1] = share * (states[i] - a[i])
        of_cell[i, 2] = share * rise * per
        of_cell[i, 3] = share * bend * per * per
        of_cell[i, 4] = rates[i]
        of_cell[i, 5] = 1.0 / rates[i]
    decay = -rates[places] * since
    exponentials(decay)
    for q in range(len(places)):
        start, away, rise, bend, rate, tau = of_cell[places[q]]
        s = since[q]
        r = rate * s
        s1 = s - (1.0 - decay[q]) * tau  # what the lag makes of inputs s and s^2
        s2 = s * s - 2.0 * s1 * tau
        if r < SHORT:
            m1, m2 = _short_moments(r)
            s1, s2 = s * m1, s * s * m2
        out[q] += start + decay[q] * away + rise * s1 + bend * s2


@njit(cache=True)
def _grid(start: float, end: float, first: float) -> FloatArray:  # pragma: no cover
    n = 1
    step, s = first, 0.0
    while s < end - start:
        s += step
        step *= GROWTH
        n += 1
    grid = np.empty(n)
    grid[0] = start
    step = first
    for i in range(1, n):
        grid[i] = grid[i - 1] + step
        step *= GROWTH
    grid[n - 1] = end
    if n > 2 and grid[n - 1] - grid[n - 2] < 0.3 * (grid[n - 2] - grid[n - 3]):
        grid[n - 2] = 0.5 * (grid[n - 1] + grid[n - 3])  # no sliver before the next switch
    return grid


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
        x2 = _lag(Cells(h, a, m, b), rates)
    else:  # what the pocket gives back is a second input
        x2, pocket = _with_pocket(Cells(h, a, m, b), rates, p[POCKET], p[POCKET_TIME])
        k = p[POCKET] / p[POCKET_TIME]
        a = (rates_a * a + k * pocket[:-1]) / (rates_a + k)
        b = (rates_b * b + k * pocket[1:]) / (rates_b + k)
        rates_a, rates_b = rates_a + k, rates_b + k
    mid = _middles(h, x2, a, b, rates_a, rates_b)
    if p[TANK] > 0.0:
        rates = np.full(len(h), p[FLOW] / (p[TAU_M] * p[TANK]))
        a, b = x2[:-1], x2[1:]
        x2 = _lag(Cells(h, a, mid, b), rates)
        mid = _middles(h, x2, a, b, rates, rates)
    return x2, mid


@njit(cache=True)
def _with_pocket(
    cells: Cells, rates: FloatArray, share: float, time: float
) -> tuple[FloatArray, FloatArray]:  # pragma: no cover
    # x2 (n + 1,) and the concentration in a stagnant pocket (n + 1,) at the ends of n cells:
    # x2' = rate (g - x2) + k (pocket - x2), pocket' = (x2 - pocket)/time, k = share/time:
    # two decaying modes, both driven by g
    h, a, m, b = cells
    x2, pocket = np.zeros(len(h) + 1), np.zeros(len(h) + 1)
    exchange = 1.0 / time
    k = share * exchange
    for i in range(len(h)):
        rate = rates[i]
        trace = rate + k + exchange
        root = sqrt(trace * trace - 4.0 * rate * exchange)
        fast, slow = 0.5 * (trace + root), 2.0 * rate * exchange / (trace + root)
        # left eigenvectors (1, v): v = k/(lambda - exchange) of x2, pocket
        vf, vs = -k / (fast - exchange), -k / (slow - exchange)
        zf, zs = x2[i] + vf * pocket[i], x2[i] + vs * pocket[i]
        gf, gs = rate / fast, rate / slow
        zf = _advance(zf, fast * h[i], gf * a[i], gf * m[i], gf * b[i])
        zs = _advance(zs, slow * h[i], gs * a[i], gs * m[i], gs * b[i])
        pocket[i + 1] = (zf - zs) / (vf - vs)
        x2[i + 1] = zf - vf * pocket[i + 1]
    return x2, pocket


@njit(cache=True)
def _middles(
    h: FloatArray,
    x: FloatArray,
    a: FloatArray,
    b: FloatArray,
    rates_a: FloatArray,
    rates_b: FloatArray,
) -> FloatArray:  # pragma: no cover
    # states (n,) of a lag in the middles of n cells, from those at their ends (n + 1,): by the
    # cubic through values and slopes, which jump where input (a, b) or rate do at a switch; the
    # slopes are limited where the lag is much faster than the cell
    mid = np.empty(len(h))
    for i in range(len(h)):
        step = x[i + 1] - x[i]
        slopes = rates_a[i] * (a[i] - x[i]) - rates_b[i] * (b[i] - x[i + 1])
        bend, limit = 0.125 * h[i] * slopes, 0.5 * abs(step)
        mid[i] = 0.5 * (x[i] + x[i + 1]) + min(max(bend, -limit), limit)
    return mid


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
            t = np.concatenate((t, _grid(t[-1], until, first)[1:]))
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
    low_pass = p[FILTER]
    # a low-pass takes all that the lags make, at the ends and in the middles of the cells
    x3 = np.zeros(len(t))
    at, after, made = places, since, out[k:]
    if low_pass > 0.0:
        at, after, made = np.arange(len(h)), 0.5 * h, np.zeros(len(h))
    for j in range(len(share)):
        rates, states = _sensor(gas, tau[j], p[RELEASE], p[RELEASE_WIDTH])
        _add_within(share[j], at, after, gas, rates, states, made)
        if low_pass > 0.0:
            x3 += share[j] * states
    if low_pass > 0.0:
        sensed = Cells(h, x3[:-1], made, x3[1:])
        rates = np.full(len(h), 1.0 / low_pass)
        _add_within(1.0, places, since, sensed, rates, _lag(sensed, rates), out[k:])


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
        return rates, _lag(cells, rates)
    states, log_ratio = np.zeros(len(h) + 1), log(ratio)
    for i in range(len(h)):
        slower = _slower(m[i] - states[i], log_ratio, width)
        if width > 0.0:  # the state half a cell on is nearer to what counts
            half_m = 0.375 * a[i] + 0.75 * m[i] - 0.125 * b[i]
            half = _advance(states[i], 0.5 * h[i] / (tau * slower), a[i], half_m, m[i])
            slower = _slower(m[i] - half, log_ratio, width)
        rates[i] /= slower
        states[i + 1] = _advance(states[i], h[i] * rates[i], a[i], m[i], b[i])
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
