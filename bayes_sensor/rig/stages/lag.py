"""A first-order lag with one time constant at every flow: tau x' = u - x."""

from __future__ import annotations

from bayes_sensor.rig.stages.stage import Passage, StageKind

KIND = StageKind(
    name="lag",
    symbol="tau",
    unit="s",
    depends_on_flow=False,
    passage=lambda tau, flow: Passage((tau,)),
    slope=lambda tau, flow: Passage((1.0,)),
    words={"valve": "v", "sensor": "", "filter": "filter"},
)
