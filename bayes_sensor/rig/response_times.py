"""t10, t63, t90 and the rise time of any chain of first-order lags."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from bayes_sensor.campaign import FloatArray
from bayes_sensor.compiled import compiled
from bayes_sensor.display import record_card
from bayes_sensor.rig.chain import impulse_response, step_response

if TYPE_CHECKING:
    import pandas as pd


@dataclass(frozen=True, eq=False)
class ResponseTimes:
    """Times after a step (s), each of the shape of the draws given."""

    _repr_html_ = record_card

    t10: FloatArray
    t63: FloatArray
    t90: FloatArray

    @property
    def rise(self) -> FloatArray:
        """s, from 10 % to 90 %."""
        return self.t90 - self.t10


@compiled(inside=True)
def _time_to_level(level: float, rates: FloatArray) -> float:
    # Newton kept inside a bracket that always holds the root: by Markov's inequality
    # 1 - y(t) <= sum(tau)/t.
    low, high = 0.0, 0.0
    for rate in rates:
        high += 1.0 / rate
    high /= 1.0 - level
    s = high * (1.0 - level)
    for _ in range(100):
        miss = step_response(s, rates) - level
        if miss > 0.0:
            high = s
        else:
            low = s
        slope = impulse_response(s, rates)
        new = s - miss / slope if slope > 0.0 else low - 1.0
        if not low < new < high:
            new = 0.5 * (low + high)
        if abs(new - s) <= 1e-13 * s:
            return new
        s = new
    return s


@compiled()
def _times_to_levels(levels: FloatArray, rates: FloatArray, out: FloatArray) -> None:
    for j in range(rates.shape[0]):
        for i in range(len(levels)):
            out[i, j] = _time_to_level(levels[i], rates[j])


def response_times(taus: Sequence[FloatArray | float] | FloatArray) -> ResponseTimes:
    """t10, t63, t90 of the step response of first-order lags in cascade.

    For one lag -tau ln(1 - p): t90 = 2.303 tau.  For several the exact step response is
    inverted, also where time constants coincide.  The system is linear, so the fall takes as
    long as the rise; where the flow differs between them (``flow_switching``) call it for each.

    Parameters
    ----------
    taus
        (n_lags, ...) s, zero or more, not all zero: lags first, draws behind.  The sensor alone
        is ``[tau]``, the whole chain at total flow Q ``[tau_v, V/Q, tau]`` (arrays of one shape,
        or numbers, broadcast against each other).

    >>> times = response_times([0.0481])
    >>> round(float(times.t90), 4), round(float(times.rise), 4)
    (0.1108, 0.1057)
    >>> response_times([0.8577, 0.0582 / 0.075, np.array([0.01, 0.0481])]).t90.round(2).tolist()
    [3.19, 3.23]

    Raises
    ------
    ValueError
        If there is no lag, one is negative or not finite, or all are zero.
    """
    lags = np.array(np.broadcast_arrays(*(np.asarray(tau, dtype=float) for tau in taus)))
    if lags.size == 0:
        raise ValueError(
            f"response_times: expected (n_lags, ...) time constants, got shape {lags.shape}"
        )
    total = lags.sum(axis=0)
    if not (np.isfinite(lags).all() and (lags >= 0).all() and (total > 0).all()):
        raise ValueError(
            "response_times: time constants must be finite, none negative and not all zero in a "
            f"draw; the smallest is {lags.min():g} s, the largest {lags.max():g} s"
        )
    # A lag of zero passes everything on; one of 1e-9 of the total cannot be told from it.
    lags = np.maximum(lags, 1e-9 * total)
    rates = np.sort(1.0 / lags.reshape(len(lags), -1).T, axis=1)
    out = np.empty((3, rates.shape[0]))
    _times_to_levels(np.array([0.1, 1 - math.exp(-1), 0.9]), rates, out)
    return ResponseTimes(*out.reshape(3, *lags.shape[1:]))


def response_time_table(
    tau: FloatArray,
    tau_v: FloatArray,
    volume: FloatArray,
    flows: Sequence[float] | FloatArray,
    level: float = 0.95,
) -> pd.DataFrame:
    """Response times of the sensor alone and of the whole chain at each flow, with intervals.

    One row for the sensor alone and one per total flow (rising); the chain is the valve, the
    chamber of time constant V/Q and the sensor.  t10, t63, t90 and rise (10 to 90 %) in s, each
    as its posterior median and equal-tailed interval of the given level (``_lo``, ``_hi``).  The
    chain is linear, so the fall takes as long as the rise at the same flow.

    Parameters
    ----------
    tau, tau_v
        (n,) s, posterior draws of the sensor's and the valve's time constant.
    volume
        (n,) mL, draws of the chamber's volume, from the same draws.
    flows
        total flows, mL/s (1 L/min is 16.67 mL/s); each is listed once.

    >>> table = response_time_table([0.0481] * 2, [0.8577] * 2, [58.23] * 2, [75.0, 150.0])
    >>> table[["system", "t63_s", "t90_s"]].round(3).values.tolist()
    [['sensor', 0.048, 0.111], ['chain', 1.802, 3.228], ['chain', 1.36, 2.529]]
    """
    import pandas as pd

    draws = [np.asarray(x, dtype=float) for x in (tau, tau_v, volume)]
    if draws[0].ndim != 1 or len(draws[0]) < 2 or any(x.shape != draws[0].shape for x in draws):
        raise ValueError(
            "response_time_table: expected as many draws (two or more) of tau, tau_v and volume, "
            f"got shapes {', '.join(str(x.shape) for x in draws)}"
        )
    rates = np.unique(np.asarray(flows, dtype=float))
    if rates.size == 0 or not (np.isfinite(rates).all() and rates[0] > 0):
        raise ValueError("response_time_table: flows must be positive numbers in mL/s")
    if not 0 < level < 1:
        raise ValueError(f"response_time_table: level must lie between 0 and 1, got {level}")
    sensor, valve, chamber = draws
    systems: list[tuple[str, float | None, ResponseTimes]] = [
        ("sensor", None, response_times([sensor]))
    ]
    for flow in rates:
        systems.append(("chain", float(flow), response_times([valve, chamber / flow, sensor])))
    return pd.DataFrame(response_time_rows(systems, level))


def response_time_rows(
    systems: Sequence[tuple[str, float | None, ResponseTimes]], level: float = 0.95
) -> list[dict[str, str | float | None]]:
    """Rows of :func:`response_time_table` for systems: what each is, its total flow in mL/s or
    None, and draws of its times."""
    rows = []
    for system, flow, times in systems:
        litres = None if flow is None or math.isnan(flow) else 0.06 * flow
        row: dict[str, str | float | None] = {"system": system, "total_flow_L_per_min": litres}
        for name in ("t10", "t63", "t90", "rise"):
            low, middle, high = np.quantile(
                getattr(times, name), [(1 - level) / 2, 0.5, (1 + level) / 2]
            )
            row |= {f"{name}_s": middle, f"{name}_lo_s": low, f"{name}_hi_s": high}
        rows.append(row)
    return rows
