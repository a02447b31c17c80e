"""The kinds of stages that the gas passes, one a file: a file here with a ``KIND`` is known."""

from __future__ import annotations

from importlib import import_module
from pkgutil import iter_modules

from bayes_sensor.rig.stages.stage import Stage, StageKind

__all__ = ["KINDS", "Stage", "StageKind"]

KINDS: dict[str, StageKind] = {
    kind.name: kind
    for kind in (
        getattr(import_module(f"{__name__}.{module.name}"), "KIND", None)
        for module in iter_modules(__path__)
    )
    if kind is not None
}
"""by name; pass another mapping to :meth:`bayes_sensor.rig.rig.Rig.parse` to add to it"""
