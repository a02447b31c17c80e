"""A figure as files among the results."""

from __future__ import annotations

from typing import Any

from bayes_sensor.io.results import StagingFolder


def put_figure(stage: StagingFolder, name: str, figure: Any) -> None:
    """Put a figure as ``name``.svg and ``name``.png."""
    from bayes_sensor import figures

    stage.text(f"{name}.svg", figures.svg(figure))
    stage.binary(f"{name}.png", figures.png(figure))
