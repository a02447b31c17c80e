"""The fit with the roles of a lag and a volume exchanged, which may be as good."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from bayes_sensor.campaign import FloatArray
from bayes_sensor.likelihood.problem import Problem

TWINS_APART = 0.3
"""distance in the logarithms of a lag and of a volume above which two fits are different answers"""
AS_GOOD = 9.0
"""rise of the sum of squares, in noise variances, up to which another fit is as good (3 sd)"""


@dataclass(frozen=True)
class Twin:
    """The best fit with the roles of a lag and a volume exchanged (valve and manifold)."""

    lag: str
    volume: str
    """flat names of the two"""
    lag_s: float
    volume_mL: float
    excess: float  # V^2, its sum of squares less that of the fit

    def sentence(self) -> str:
        """That both fits are as good."""
        stages = {"tau_v_s": "valve", "V_mL": "manifold"}
        lag, volume = self.lag.removesuffix("_s"), self.volume.removesuffix("_mL")
        return (
            f"{stages.get(self.lag, lag)} and {stages.get(self.volume, volume)} cannot be told "
            f"apart by these data: a fit with {lag} = {1e3 * self.lag_s:.4g} ms and {volume} = "
            f"{self.volume_mL:.4g} mL is as good"
        )


def other_orders(problem: Problem, theta: FloatArray) -> list[tuple[int, int, FloatArray]]:
    """Positions of a lag and a volume, and ``theta`` (n_mean,) with their roles exchanged at the
    typical flow; the longest lag that does not depend on flow, with each volume."""
    layout, commuting = problem.layout, problem.commuting
    if not layout.rig.needs_flow or commuting.flow is not None or not commuting.names:
        return []
    flow, lag = float(np.median([e.total_flow for e in problem.campaign])), commuting.places[-1]
    found = []
    for volume, name in enumerate(layout.shared_names):
        if name.startswith("V_"):
            other = theta.copy()
            other[lag], other[volume] = theta[volume] / flow, theta[lag] * flow
            found.append((lag, volume, commuting.by_size(other)))
    return found


def sensors_exchanged(problem: Problem, theta: FloatArray) -> list[FloatArray]:
    """``theta`` (n_mean,) with the sensors' lags in place of each lag that they share and the other
    way round, where sensors are tied: that may be another minimum.  Without a tie each sensor's
    lag finds its own way."""
    layout, n = problem.layout, problem.layout.n_own
    found = []
    for name in layout.rig.lags_that_commute() if layout.ties and n else ():
        if name in layout.shared_names[n:]:
            place, other = layout.shared_names.index(name), theta.copy()
            other[:n], other[place] = theta[place], theta[:n].mean()
            found.append(other)
    return found


def apart(a: FloatArray, b: FloatArray, places: tuple[int, int]) -> bool:
    """Whether two answers (n_mean,) differ in a lag and in a volume."""
    pair = list(places)
    return bool((np.abs(np.log(a[pair] / b[pair])) > TWINS_APART).all())
