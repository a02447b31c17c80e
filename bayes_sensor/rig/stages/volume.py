"""A swept volume, well mixed: (V/Q) x' = u - x at the total flow Q (paper eq. 6)."""

from __future__ import annotations

from bayes_sensor.rig.stages.stage import Passage, StageKind, Value


def _passage(volume: Value, flow: Value) -> Passage:
    return Passage((volume / flow,))


def _slope(volume: Value, flow: Value) -> Passage:
    return Passage((1.0 / flow,))


KIND = StageKind(
    name="volume",
    symbol="V",
    unit="mL",
    depends_on_flow=True,
    passage=_passage,
    slope=_slope,
    words={"manifold": "", "line": "line", "cell": "cell", "trap": "trap"},
)
