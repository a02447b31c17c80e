"""The lags of the published rig, as the calculation keeps and names them."""

from __future__ import annotations

from bayes_sensor.rig.lags import Assignment, Commuting
from bayes_sensor.rig.rig import PUBLISHED

TWO, THREE = PUBLISHED.names[:2], PUBLISHED.names


def commuting(flow: float | None) -> Commuting:
    """Where flows differ (None), or at one ``flow`` in mL/s."""
    return Commuting.among(TWO if flow is None else THREE, THREE, flow)


def assigned(*places: int) -> Assignment:
    """Places of the lags of sensor, valve and, at one flow, manifold."""
    return Assignment(THREE[: len(places)], places)
