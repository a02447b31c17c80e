"""The sensor and the readout with their imperfections, compiled for the rigs' kernels."""

from __future__ import annotations

from math import exp, log

import numpy as np
from numpy.typing import NDArray

from bayes_sensor.campaign import FloatArray
from bayes_sensor.compiled import compiled
from bayes_sensor.rig.imperfections import (
    BETA,
    COATING,
    CUBIC,
    CURVATURE,
    DRIFT,
    DRIFT_CURVE,
    DRIFT_TWIST,
    GAIN,
    GAIN_CURVE,
    GAIN_OF_ALL,
    GAIN_TWIST,
    MIDDLE,
    SENSOR_FACTOR,
    SLOW_S,
    SLOW_S_SPREAD,
    SLOW_S_TIME,
    STEP,
    STEP_TIME,
    STEP_WIDTH,
    STEP_WITH_FALL,
    T0,
    TAU,
    TF,
    Y0,
)
from bayes_sensor.rig.lag_cells import Cells, advance, lag_states


@compiled(inside=True)
def sensor_modes(
    p: FloatArray, mode_share: FloatArray, mode_ratio: FloatArray
) -> tuple[FloatArray, FloatArray]:
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
        spread = p[SLOW_S_SPREAD]
        for part in range(1 if spread == 1.0 else 3):
            share[used] = p[SLOW_S] * share_of(part, spread)
            tau[used] = p[SLOW_S_TIME] * factor_of(part, spread)
            used += 1
    return share[:used], tau[:used]


@compiled(inside=True)
def share_of(part: int, spread: float) -> float:
    # of a lag that is spread: half of it is as it is, a quarter each slower and faster
    return 1.0 if spread == 1.0 else (0.5 if part == 0 else 0.25)


@compiled(inside=True)
def factor_of(part: int, spread: float) -> float:
    # .. and by how much
    return 1.0 if part == 0 else (spread if part == 1 else 1.0 / spread)


@compiled(inside=True)
def cells_of(times: FloatArray, t: FloatArray) -> tuple[NDArray[np.int64], FloatArray]:
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


@compiled(inside=True)
def sensor_states(
    cells: Cells, tau: float, ratio: float, width: float, rates: FloatArray, states: FloatArray
) -> None:
    # one of the sensor's lags: its rates (n,) in the cells and its states (n + 1,) at their ends.
    # It releases more slowly by ``ratio`` than it takes up, each lag by what drives it: one that
    # is in equilibrium drives itself by rounding alone
    h, a, m, b = cells
    for i in range(len(h)):
        rates[i] = 1.0 / tau
    if ratio == 1.0:
        lag_states(cells, rates, states)
        return
    states[0], log_ratio = 0.0, log(ratio)
    for i in range(len(h)):
        drive = m[i] - states[i]
        if width > 0.0:  # the state half a cell on is nearer to what counts
            slower = _slower(drive, log_ratio, width)
            half_m = 0.375 * a[i] + 0.75 * m[i] - 0.125 * b[i]
            drive = m[i] - advance(states[i], 0.5 * h[i] / (tau * slower), a[i], half_m, m[i])
        rates[i] /= _slower(drive, log_ratio, width)
        states[i + 1] = advance(states[i], h[i] * rates[i], a[i], m[i], b[i])


@compiled(inside=True)
def _slower(drive: float, log_ratio: float, width: float) -> float:
    # factor on the sensor's time constant where what drives it exceeds its state by this much:
    # the ratio to the power (1 - tanh(drive/width))/2
    if width > 0.0:
        return exp(log_ratio / (1.0 + exp(min(2.0 * drive / width, 700.0))))
    return exp(log_ratio) if drive < 0.0 else 1.0


@compiled()
def read_volts(times: FloatArray, p: FloatArray, response: FloatArray, step: float) -> FloatArray:
    # V at the times of a response x3, with a step of the baseline of ``step`` V
    y0, beta, middle, cubic = p[Y0], p[BETA], p[MIDDLE], p[CUBIC]
    # towards the step: a signal upside down bends upside down.  The bend leaves both ends of the
    # step where they are, so that beta stays the height of the plateau
    curvature = p[CURVATURE] if beta >= 0.0 else -p[CURVATURE]
    gain, gain_curve, gain_twist, of_all = p[GAIN], p[GAIN_CURVE], p[GAIN_TWIST], p[GAIN_OF_ALL]
    drift, drift_curve, drift_twist = p[DRIFT], p[DRIFT_CURVE], p[DRIFT_TWIST]
    volts = np.empty(len(times))
    for i in range(len(times)):
        v = beta * response[i]
        v *= 1.0 + (v - beta) * (curvature + cubic * (v + beta))
        since = times[i] - middle
        opened = times[i] - p[T0]
        gained = opened * (gain + opened * (gain_curve + opened * gain_twist))
        v += v * gained + y0 * (1.0 + of_all * gained)
        volts[i] = v + since * (drift + since * (drift_curve + since * drift_twist))
    if step != 0.0:
        step_time = p[STEP_TIME] + (p[TF] if p[STEP_WITH_FALL] > 0.0 else 0.0)
        for i in range(len(times)):
            if times[i] >= step_time:
                settled = 1.0
                if p[STEP_WIDTH] > 0.0:
                    settled -= exp(-(times[i] - step_time) / p[STEP_WIDTH])
                volts[i] += step * settled
    return volts


@compiled(inside=True)
def step_mean(low: float, high: float, p: FloatArray) -> float:
    # V: mean of the baseline's step between ``low`` and ``high`` s; exact, where a few times in a
    # bin would not tell where in it the step is
    begin = p[STEP_TIME] + (p[TF] if p[STEP_WITH_FALL] > 0.0 else 0.0)
    if high <= begin:
        return 0.0
    width, first, last = p[STEP_WIDTH], max(low - begin, 0.0), high - begin
    area = last - first
    if width > 0.0:
        area -= width * (exp(-first / width) - exp(-last / width))
    mean: float = p[STEP] * area / (high - low)
    return mean
