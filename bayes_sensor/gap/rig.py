"""A rig with every imperfection of the catalogue: one kernel, from the valve to the voltage.

The published model is a cascade of three first-order lags.  Real rigs depart from it stage by
stage, so the stages are computed one after the other on a time grid that starts at each switch
and grows geometrically::

    command -> valve x1 -> manifold x2 -> sensor x3 -> low-pass -> readout y

Every lag is advanced exactly for an input that is quadratic within a cell, so that time constants
far below the grid's steps are no trouble.  With the neutral settings the response is the closed
form of :mod:`bayes_sensor.model` (a test compares them).  An effect only says which settings it
changes; effects on different settings can therefore act together.
"""

from __future__ import annotations

from collections.abc import Mapping
from math import cos, exp, log, sin, sqrt, tanh

import numpy as np
from numba import njit
from numpy.typing import NDArray

from bayes_sensor.campaign import FloatArray

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
    "curvature": (0.0, "1/V, k in v + k v^2 with v = beta x3"),
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
    SLOW_S, SLOW_S_TIME, SLOW_S_SPREAD, COATING, FILTER, CURVATURE, DRIFT, DRIFT_CURVE, DRIFT_TWIST,
    STEP, STEP_TIME, STEP_WITH_FALL, STEP_WIDTH, GAIN, GAIN_CURVE, GAIN_TWIST, GAIN_OF_ALL, CARRY,
    CARRY_TIME, VALVE_FACTOR, SENSOR_FACTOR, EMPTYING, LATE, LATE_RISE, LATE_FALL,
) = range(FIRST, FIRST + len(SETTINGS))  # fmt: skip

OF_THE_READOUT = [
    Y0, BETA, MIDDLE, CURVATURE, DRIFT, DRIFT_CURVE, DRIFT_TWIST, STEP, STEP_TIME, STEP_WITH_FALL,
    STEP_WIDTH, GAIN, GAIN_CURVE, GAIN_TWIST, GAIN_OF_ALL,
]  # fmt: skip
OF_THE_SENSOR = [
    TAU, START, RELEASE, RELEASE_WIDTH, SLOW_S, SLOW_S_TIME, SLOW_S_SPREAD, COATING, FILTER, CARRY,
    CARRY_TIME, SENSOR_FACTOR,
]  # fmt: skip
_of_the_gas = np.setdiff1d(np.arange(FIRST + len(SETTINGS)), OF_THE_READOUT + OF_THE_SENSOR)
_before_the_readout = np.setdiff1d(np.arange(FIRST + len(SETTINGS)), OF_THE_READOUT)

CELLS_PER_TIME_CONSTANT = 14.0
GROWTH = 1.06
"""each cell is this much longer than the one before"""


def settings_vector(settings: Mapping[str, float]) -> FloatArray:
    """(n_settings,) the neutral settings with those given replaced.  Raises KeyError."""
    vector = NEUTRAL.copy()
    for name, value in settings.items():
        vector[INDEX[name]] = value
    return vector


# --------------------------------------------------------------------------- the valve


@njit(cache=True)
def _opening(
    s: float, tau: float, inertia: float, stroke: float, bend: float
) -> float:  # pragma: no cover
    # step response of the valve, s after the command
    if s <= 0.0:
        return 0.0
    if stroke > 0.0:  # the lag's response to a command (1 - bend) q + bend q^2, q = s/stroke
        ramping, late = min(s, stroke), max(s - stroke, 0.0)
        gone = tau * (1.0 - exp(-ramping / tau))
        x = (ramping - gone) / stroke
        if bend != 0.0:
            square = ramping * ramping - 2.0 * tau * (ramping - gone)
            x += bend * (square / (stroke * stroke) - x)
        return 1.0 - (1.0 - x) * exp(-late / tau)
    if inertia > 1e-9:
        gap = 1.0 - 4.0 * inertia
        if gap > 1e-6:
            slow = 0.5 * tau * (1.0 + sqrt(gap))
            fast = inertia * tau * tau / slow
            return 1.0 - (slow * exp(-s / slow) - fast * exp(-s / fast)) / (slow - fast)
        rate = 0.5 / (inertia * tau)
        if gap < -1e-6:
            omega = rate * sqrt(-gap)
            return 1.0 - exp(-rate * s) * (cos(omega * s) + rate / omega * sin(omega * s))
        return 1.0 - exp(-rate * s) * (1.0 + rate * s)
    return 1.0 - exp(-s / tau)


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
    x = np.zeros(len(t))
    tau, share = p[TAU_V] * p[VALVE_FACTOR], p[SLOW_V]
    alike = p[CLOSING] == 1.0 and p[CLOSING_BEND] == 0.0
    if alike and p[INERTIA] <= 1e-9 and p[STROKE] <= 0.0:  # one exponential up, one down
        reached = 1.0 - exp(-max(tf - t0, 0.0) / tau)
        for i in range(len(t)):
            if t[i] > tf:
                x[i] = reached * exp((tf - t[i]) / tau)
            elif t[i] > t0:
                x[i] = 1.0 - exp((t0 - t[i]) / tau)
    else:
        reached = _opening(tf - t0, tau, p[INERTIA], p[STROKE], p[BEND])
        for i in range(len(t)):
            since, after = t[i] - t0, t[i] - tf
            if alike or after <= 0.0:  # linear: opening minus shutting
                x[i] = _opening(since, tau, p[INERTIA], p[STROKE], p[BEND])
                if after > 0.0:
                    x[i] -= _opening(after, tau, p[INERTIA], p[STROKE], p[BEND])
            else:
                shut = _opening(after, tau * p[CLOSING], p[INERTIA], p[STROKE], p[BEND])
                x[i] = reached * _still_open(1.0 - shut, p[CLOSING_BEND])
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


@njit(cache=True, inline="always")
def _moments(r: float) -> tuple[float, float, float]:  # pragma: no cover
    # decay over a step of r time constants, and what a lag makes of inputs q and q^2, q the part
    # of the step
    decay = exp(-r)
    if r < 1e-3:
        m1 = r * (0.5 - r / 6.0 * (1.0 - 0.25 * r))
        m2 = r * (1.0 / 3.0 - r / 12.0 * (1.0 - 0.2 * r))
    else:
        per = 1.0 / r
        m1 = 1.0 - (1.0 - decay) * per
        m2 = 1.0 - 2.0 * m1 * per
    return decay, m1, m2


@njit(cache=True, inline="always")
def _advance(x: float, r: float, a: float, m: float, b: float) -> float:  # pragma: no cover
    # a lag's state after r time constants under an input that passes a, m, b
    return _driven(x, r, a, 4.0 * m - 3.0 * a - b, 2.0 * a - 4.0 * m + 2.0 * b)


@njit(cache=True, inline="always")
def _driven(x: float, r: float, a: float, rise: float, bend: float) -> float:  # pragma: no cover
    # a lag's state after r time constants under an input a + rise q + bend q^2
    decay, m1, m2 = _moments(r)
    return a + decay * (x - a) + m1 * rise + m2 * bend


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
    n = len(t)
    x2 = np.zeros(n)
    slope_a = np.zeros(n)  # dx2/dt at the start and the end of cells (it may jump at a switch)
    slope_b = np.zeros(n)
    filling = p[FLOW] / (p[TAU_M] * (1.0 - p[TANK]))
    lost = p[SWITCHING] * p[CONCENTRATION]
    share, exchange = p[POCKET], 0.0
    if share > 0.0:
        exchange = 1.0 / p[POCKET_TIME]
    pocket = 0.0
    after_fall = filling / p[EMPTYING]
    for i in range(n - 1):
        h = t[i + 1] - t[i]
        rate0 = filling if t[i] < p[TF] else after_fall
        if lost == 0.0 and share <= 0.0:  # a lag
            x2[i + 1] = _advance(x2[i], rate0 * h, x1[i], x1_mid[i], x1[i + 1])
            slope_a[i] = rate0 * (x1[i] - x2[i])
            slope_b[i] = rate0 * (x1[i + 1] - x2[i + 1])
            continue
        # the flow through the manifold follows the valve; what enters is Q x1 where the valve is
        # in the test gas's line, and of concentration x1 where the gases are mixed before it
        ra = rate0 * (1.0 - lost + lost * x1[i])
        rm = rate0 * (1.0 - lost + lost * x1_mid[i])
        rb = rate0 * (1.0 - lost + lost * x1[i + 1])
        a, m, b = x1[i], x1_mid[i], x1[i + 1]
        if p[PREMIXED] == 0.0:
            a, m, b = a * rate0 / ra, m * rate0 / rm, b * rate0 / rb
        rate = (ra + 4.0 * rm + rb) / 6.0
        if share <= 0.0:
            x2[i + 1] = _advance(x2[i], rate * h, a, m, b)
            slope_a[i] = ra * (a - x2[i])
            slope_b[i] = rb * (b - x2[i + 1])
        else:
            # x2' = rate (g - x2) + k (pocket - x2), pocket' = (x2 - pocket)/T, k = share/T:
            # two decaying modes, both driven by g
            k = share * exchange
            trace = rate + k + exchange
            root = sqrt(trace * trace - 4.0 * rate * exchange)
            fast, slow = 0.5 * (trace + root), 2.0 * rate * exchange / (trace + root)
            # left eigenvectors (1, v): v = k/(lambda - exchange) of x2, pocket
            vf = -k / (fast - exchange)
            vs = -k / (slow - exchange)
            zf = x2[i] + vf * pocket
            zs = x2[i] + vs * pocket
            zf = _advance(zf, fast * h, rate / fast * a, rate / fast * m, rate / fast * b)
            zs = _advance(zs, slow * h, rate / slow * a, rate / slow * m, rate / slow * b)
            slope_a[i] = ra * (a - x2[i]) + k * (pocket - x2[i])
            pocket = (zf - zs) / (vf - vs)
            x2[i + 1] = zf - vf * pocket
            slope_b[i] = rb * (b - x2[i + 1]) + k * (pocket - x2[i + 1])
    mid = _middles(t, x2, slope_a, slope_b)
    if p[TANK] > 0.0:
        return _lag(t, x2, mid, p[TAU_M] * p[TANK] / p[FLOW])
    return x2, mid


@njit(cache=True)
def _middles(
    t: FloatArray, x: FloatArray, slope_a: FloatArray, slope_b: FloatArray
) -> FloatArray:  # pragma: no cover
    # values at the middles of the cells, by the cubic through values and slopes; the slopes are
    # limited where a lag is much faster than the cell
    mid = np.empty(len(t) - 1)
    for i in range(len(t) - 1):
        h = t[i + 1] - t[i]
        step = x[i + 1] - x[i]
        bend = 0.125 * h * (slope_a[i] - slope_b[i])
        limit = 0.5 * abs(step)
        mid[i] = 0.5 * (x[i] + x[i + 1]) + min(max(bend, -limit), limit)
    return mid


@njit(cache=True)
def _lag(
    t: FloatArray, x: FloatArray, mid: FloatArray, tau: float
) -> tuple[FloatArray, FloatArray]:  # pragma: no cover
    n = len(t)
    out = np.zeros(n)
    slope_a, slope_b = np.zeros(n), np.zeros(n)
    for i in range(n - 1):
        out[i + 1] = _advance(out[i], (t[i + 1] - t[i]) / tau, x[i], mid[i], x[i + 1])
        slope_a[i] = (x[i] - out[i]) / tau
        slope_b[i] = (x[i + 1] - out[i + 1]) / tau
    return out, _middles(t, out, slope_a, slope_b)


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
    # the sensor's parallel modes: the single lag or the coating's, and slow sites
    n_modes = len(mode_share)
    share = np.zeros(n_modes + 4)
    tau = np.ones(n_modes + 4)
    share[0] = (1.0 - p[COATING]) * (1.0 - p[SLOW_S])
    own_tau = p[TAU] * p[SENSOR_FACTOR]
    tau[0] = own_tau
    used = 1
    if p[COATING] != 0.0:
        for j in range(n_modes):
            share[used] = p[COATING] * (1.0 - p[SLOW_S]) * mode_share[j]
            tau[used] = own_tau * mode_ratio[j]
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
    state = np.zeros(used)
    low_pass = p[FILTER]
    filtered = 0.0
    k = 0
    while k < len(times) and times[k] <= p[T0]:
        k += 1
    n = len(t)
    for i in range(n - 1):
        h = t[i + 1] - t[i]
        a, m, b = x2[i], x2_mid[i], x2[i + 1]
        before, middle, after = 0.0, 0.0, 0.0
        slower = 1.0
        if p[RELEASE] != 1.0:
            slower = _slower(m - state[0], p[RELEASE], p[RELEASE_WIDTH])
            if p[RELEASE_WIDTH] > 0.0:  # the state half a cell on is nearer to what counts
                half_m = 0.375 * a + 0.75 * m - 0.125 * b
                half = _advance(state[0], 0.5 * h / (tau[0] * slower), a, half_m, m)
                slower = _slower(m - half, p[RELEASE], p[RELEASE_WIDTH])
        inside = k
        while inside < len(times) and (times[inside] <= t[i + 1] or i == n - 2):
            inside += 1
        rise, bend = 4.0 * m - 3.0 * a - b, 2.0 * a - 4.0 * m + 2.0 * b
        for j in range(used):
            rate = 1.0 / (tau[j] * slower)
            if low_pass > 0.0:
                before += share[j] * state[j]
                middle += share[j] * _driven(state[j], 0.5 * h * rate, a, 0.5 * rise, 0.25 * bend)
            else:
                for q in range(k, inside):
                    since = times[q] - t[i]
                    part = since / h
                    here = _driven(state[j], since * rate, a, part * rise, part * part * bend)
                    out[q] += share[j] * here
            state[j] = _driven(state[j], h * rate, a, rise, bend)
            after += share[j] * state[j]
        if low_pass > 0.0:
            for q in range(k, inside):
                part = (times[q] - t[i]) / h
                pb = _quadratic(part, before, middle, after)
                pm = _quadratic(0.5 * part, before, middle, after)
                out[q] = _advance(filtered, part * h / low_pass, before, pm, pb)
            filtered = _advance(filtered, h / low_pass, before, middle, after)
        k = inside


@njit(cache=True)
def _slower(drive: float, ratio: float, width: float) -> float:  # pragma: no cover
    # factor on the sensor's time constant where what drives it exceeds its state by this much
    if width > 0.0:
        return float(ratio ** (0.5 * (1.0 - tanh(drive / width))))
    return ratio if drive < 0.0 else 1.0


@njit(cache=True, inline="always")
def _quadratic(q: float, a: float, m: float, b: float) -> float:  # pragma: no cover
    return a + q * ((4.0 * m - 3.0 * a - b) + q * (2.0 * a - 4.0 * m + 2.0 * b))


@njit(cache=True)
def rig_response(
    times: FloatArray, p: FloatArray, mode_share: FloatArray, mode_ratio: FloatArray
) -> FloatArray:  # pragma: no cover
    """x3 (n_t,), the concentration that the readout sees, at sorted ``times`` (n_t,) s."""
    t, x2, x2_mid = _gas(times[-1], p)
    return _sensed(times, p, t, x2, x2_mid, mode_share, mode_ratio)


@njit(cache=True)
def _add_carried(times: FloatArray, p: FloatArray, out: FloatArray) -> None:  # pragma: no cover
    # gas left from before: it leaves with the manifold's time constant and lags in the sensor,
    # which was in equilibrium with it when the record began
    slow = p[CARRY_TIME]
    if slow <= 0.0:
        slow = p[TAU_M] / p[FLOW]
    fast = p[TAU]
    if abs(slow - fast) < 1e-6 * slow:
        fast = slow * (1.0 - 1e-6)
    for i in range(len(times)):
        s = times[i] - p[START]
        if s >= 0.0:
            out[i] += p[CARRY] * (slow * exp(-s / slow) - fast * exp(-s / fast)) / (slow - fast)


@njit(cache=True)
def rig_mean(
    times: FloatArray, p: FloatArray, mode_share: FloatArray, mode_ratio: FloatArray
) -> FloatArray:  # pragma: no cover
    """The mean voltage (n_t,) at sorted ``times`` (n_t,) s."""
    return _read(times, p, rig_response(times, p, mode_share, mode_ratio))


@njit(cache=True)
def _read(times: FloatArray, p: FloatArray, response: FloatArray) -> FloatArray:  # pragma: no cover
    # V at the times of a response x3
    y0, beta, curvature, middle = p[Y0], p[BETA], p[CURVATURE], p[MIDDLE]
    gain, gain_curve, gain_twist, of_all = p[GAIN], p[GAIN_CURVE], p[GAIN_TWIST], p[GAIN_OF_ALL]
    drift, drift_curve, drift_twist = p[DRIFT], p[DRIFT_CURVE], p[DRIFT_TWIST]
    volts = np.empty(len(times))
    for i in range(len(times)):
        v = beta * response[i]
        v *= 1.0 + curvature * v
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
def rig_means(
    times: FloatArray,
    weights: FloatArray,
    starts: NDArray[np.int64],
    low: FloatArray,
    high: FloatArray,
    p: FloatArray,
    mode_share: FloatArray,
    mode_ratio: FloatArray,
) -> FloatArray:  # pragma: no cover
    """(n_rigs - 1, n_bins) V: means of bins for every row of ``p`` but the first.

    Of each bin, from ``low`` to ``high`` (n_bins,) s, the voltage at its ``times`` (n_t,) s, the
    first of them at ``starts`` (n_bins,), is summed with the ``weights`` (n_t,).  What a rig
    (n_parameters,) has in common with that of the first row of ``p`` is computed once.
    """
    made = np.empty((len(p) - 1, len(starts)))
    t, x2, x2_mid = _gas(times[-1], p[0])
    response = _sensed(times, p[0], t, x2, x2_mid, mode_share, mode_ratio)
    for i in range(1, len(p)):
        if _same(p[i], p[0], _before_the_readout):
            x3 = response
        elif _same(p[i], p[0], _of_the_gas):
            x3 = _sensed(times, p[i], t, x2, x2_mid, mode_share, mode_ratio)
        else:
            x3 = rig_response(times, p[i], mode_share, mode_ratio)
        _average(times, weights, starts, low, high, p[i], x3, made[i - 1])
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

    The other arguments are those of :func:`rig_means`, of one experiment after the other:
    ``of_times`` and ``of_bins`` (n_experiments + 1,) say where each begins and the last ends, and
    ``starts`` counts from the first time of an experiment.
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
