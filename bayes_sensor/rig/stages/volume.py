"""A swept volume, well mixed: (V/Q) x' = u - x at the total flow Q (paper eq. 6)."""

from __future__ import annotations

from bayes_sensor.rig.stages.stage import Passage, StageKind

KIND = StageKind(
    name="volume",
    symbol="V",
    unit="mL",
    depends_on_flow=True,
    passage=lambda volume, flow: Passage((volume / flow,)),
    slope=lambda volume, flow: Passage((1.0 / flow,)),
    words={"manifold": "", "line": "line", "cell": "cell", "trap": "trap"},
)
