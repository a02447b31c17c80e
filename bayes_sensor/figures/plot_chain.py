"""The chain of stages as boxes with their values, written as SVG without matplotlib."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from xml.sax.saxutils import escape

from bayes_sensor.figures.colours import GROUND, INK, MIDDLE, REGIONS
from bayes_sensor.figures.style import SMALLEST, WIDTH, beside

POINTS = 72.0
"""an inch"""
HEIGHT = 50.0
GAP = 22.0
"""points between boxes, where the arrow is"""
ENDS = 38.0
"""points for the words at both ends"""


@dataclass(frozen=True)
class Box:
    """A box of the drawing."""

    name: str
    lines: tuple[str, ...] = ()
    """its values in words, such as ``tau = 48 ms``"""
    is_sensor: bool = False


def chain(stages: Sequence[Box]) -> str:
    """The SVG element of a chain: the gas from the left, the signal to the right."""
    room = (POINTS * WIDTH - 2 * ENDS - GAP * (len(stages) + 1)) / max(len(stages), 1)
    wanted = max(
        (POINTS * beside([line], size, 0.14) for stage in stages
         for line, size in ((stage.name, 9.0), *((line, 8.0) for line in stage.lines))),
        default=60.0,
    )  # fmt: skip
    box = min(max(wanted, 60.0), room)
    size = max(float(SMALLEST), 8.0 * min(1.0, box / wanted))
    most = max([len(stage.lines) for stage in stages] or [0])
    height = max(HEIGHT, 26.0 + 11.0 * most)
    width = 2 * ENDS + GAP * (len(stages) + 1) + box * len(stages)
    middle = 0.5 * height + 2.0
    parts = [_text("gas", ENDS - 4.0, middle + 3.0, 8.5, MIDDLE, "end")]
    x = ENDS
    for stage in stages:
        parts.append(_arrow(x + 2.0, x + GAP - 2.0, middle))
        x += GAP
        fill = REGIONS[0] if stage.is_sensor else GROUND
        parts.append(
            f'<rect x="{x:.1f}" y="2" width="{box:.1f}" height="{height:.1f}" rx="4" '
            f'style="fill: {fill}; stroke: {INK}; stroke-width: 0.9"/>'
        )
        centre = x + 0.5 * box
        parts.append(_text(stage.name, centre, 16.0, min(9.0, size + 1), INK, "middle", "bold"))
        for i, line in enumerate(stage.lines):
            parts.append(_text(line, centre, 30.0 + 11.0 * i, size, INK, "middle"))
        x += box
    parts.append(_arrow(x + 2.0, x + GAP - 2.0, middle))
    parts.append(_text("signal", x + GAP + 2.0, middle + 3.0, 8.5, MIDDLE, "start"))
    return (
        f'<svg xmlns="http://www.w3.org/2000/svg" width="{width:.0f}pt" height="{height + 4:.0f}pt"'
        f' viewBox="0 0 {width:.0f} {height + 4:.0f}">{"".join(parts)}</svg>'
    )


def _text(
    words: str, x: float, y: float, size: float, colour: str, anchor: str, weight: str = "normal"
) -> str:
    return (
        f'<text x="{x:.1f}" y="{y:.1f}" style="font: {weight} {size:.1f}px \'DejaVu Sans\', '
        f'sans-serif; text-anchor: {anchor}; fill: {colour}">{escape(words)}</text>'
    )


def _arrow(a: float, b: float, y: float) -> str:
    return (
        f'<path d="M {a:.1f} {y:.1f} L {b - 5:.1f} {y:.1f}" style="stroke: {INK}; '
        f'stroke-width: 1; fill: none"/><path d="M {b:.1f} {y:.1f} L {b - 6:.1f} {y - 3:.1f} '
        f'L {b - 6:.1f} {y + 3:.1f} Z" style="fill: {INK}"/>'
    )
