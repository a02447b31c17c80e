"""A first-order lag with one time constant at every flow: tau x' = u - x."""

from __future__ import annotations

from bayes_sensor.rig.stages.stage import Passage, StageKind, Value


def _passage(tau: Value, flow: Value) -> Passage:
    return Passage((tau,))


def _slope(tau: Value, flow: Value) -> Passage:
    return Passage((1.0,))


KIND = StageKind(
    name="lag",
    symbol="tau",
    unit="s",
    depends_on_flow=False,
    passage=_passage,
    slope=_slope,
    words={"valve": "v", "sensor": "", "filter": "filter"},
)
