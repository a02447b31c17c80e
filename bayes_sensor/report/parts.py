"""The parts of a report, before any format: sections of text, tables and pictures.

A text may point to a table or a picture: ``see("methods")`` is replaced by its number, which every
format turns into a link.  Texts have no other markup.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from bayes_sensor.io.disk import write_bytes, write_text
from bayes_sensor.report.words import number, p_words, sentence, with_spread
from bayes_sensor.workers import WorkerDied, completed

FEW = 16
"""figures for which a further process is not worth its start"""
_OPEN, _CLOSE = "\x02", "\x03"
"""names contain no control characters"""


def see(*keys: str) -> str:
    """Numbers of tables or pictures in brackets, placed after the text that refers to them."""
    return " (" + ", ".join(f"{_OPEN}{key}{_CLOSE}" for key in keys) + ")"


def pointing(text: str, *keys: str) -> str:
    """``text`` as a sentence that names tables or pictures before its stop."""
    return f"{sentence(text).removesuffix('.')}{see(*keys)}."


def pieces(text: str, numbers: dict[str, str]) -> Iterator[tuple[str, str]]:
    """(text, key) of each stretch of a text; the key is empty unless it points somewhere.

    >>> list(pieces("so" + see("methods") + ".", {"methods": "Table 2"}))
    [('so (', ''), ('Table 2', 'methods'), (').', '')]

    What points to a part that this report leaves out is left out with its brackets.
    """
    text = re.sub(
        f" \\((?:(?:, )?{_OPEN}[^{_CLOSE}]*{_CLOSE})+\\)",
        lambda m: see(*known) if (known := [k for k in _keys(m[0]) if k in numbers]) else "",
        text,
    )
    for i, part in enumerate(re.split(f"{_OPEN}([^{_CLOSE}]*){_CLOSE}", text)):
        if i % 2 and part in numbers:
            yield numbers[part], part
        elif part:
            yield part, ""


def _keys(text: str) -> list[str]:
    return re.findall(f"{_OPEN}([^{_CLOSE}]*){_CLOSE}", text)


@dataclass(frozen=True)
class Shown:
    """A number in a table with its own words; sorted and copied by its value."""

    value: float
    text: str


def to_spread(value: float, spread: float) -> Shown:
    """A number rounded to two digits of its spread."""
    return Shown(value, with_spread(value, spread))


def p_value(p: float | None) -> Shown | None:
    """A p-value or a probability in words, without false precision."""
    return None if p is None else Shown(p, p_words(p))


@dataclass
class Table:
    """A table that can be sorted and copied."""

    key: str
    caption: str
    columns: list[str]
    rows: list[list[Any]]
    """texts, or numbers, which are rounded when shown and copied in full"""
    digits: int = 4
    marked: list[int] = field(default_factory=list)
    """rows to emphasise"""

    @property
    def numeric(self) -> list[bool]:
        """Which columns hold numbers."""
        return [
            any(isinstance(v, int | float | Shown) and not isinstance(v, bool) for v in column)
            for column in zip(*self.rows, strict=True)
        ] or [False] * len(self.columns)

    def cells(self, row: Sequence[Any]) -> list[dict[str, Any]]:
        """What to show and what to sort by, for one row."""
        made = []
        for value in row:
            if isinstance(value, bool) or value is None or isinstance(value, str):
                shown = {True: "yes", False: "no", None: "–"}.get(value, value)  # type: ignore[arg-type]
                made.append({"text": shown, "full": "" if value is None else shown, "num": False})
            elif isinstance(value, Shown):
                made.append({"text": value.text, "full": repr(value.value), "num": True})
            else:
                shown = f"{value:d}" if isinstance(value, int) else number(value, self.digits)
                if isinstance(value, float) and abs(float(shown) - value) <= 1e-9 * abs(value):
                    shown = f"{value:.{self.digits + 2}g}"
                made.append({"text": shown, "full": repr(value), "num": True})
        return made


@dataclass
class Picture:
    """A figure with its caption; drawn only where the report shows it."""

    key: str
    make: Callable[[], Any] | None
    """makes the matplotlib figure; None where it is drawn already"""
    caption: str
    overlay: int | None = None
    """number of the trace that it shows, from 0, where it can be zoomed"""
    on_paper: bool = False
    """whether it is drawn for the full report alone"""
    drawing: str = ""
    """SVG element; empty until it is drawn"""


Part = Table | Picture


@dataclass
class Section:
    """One question with its answer."""

    key: str
    title: str
    answer: str
    """one or two sentences that answer the question"""
    paragraphs: list[str] = field(default_factory=list)
    content: list[Part] = field(default_factory=list)
    """tables without rows are left out"""

    def __post_init__(self) -> None:
        self.content = [part for part in self.content if isinstance(part, Picture) or part.rows]


def numbering(parts: Iterable[Part]) -> dict[str, str]:
    """``Table 3`` or ``Figure 2`` by key, in the order of the report."""
    numbers: dict[str, str] = {}
    counts = {"Table": 0, "Figure": 0}
    for part in parts:
        kind = "Table" if isinstance(part, Table) else "Figure"
        if part.key in numbers:
            raise ValueError(f"two parts of the report are called '{part.key}'")
        counts[kind] += 1
        numbers[part.key] = f"{kind} {counts[kind]}"
    return numbers


def draw(
    pictures: Sequence[Picture],
    folder: Path | None = None,
    *,
    png: bool = False,
    jobs: int = 1,
    progress: Callable[[float, str], None] = lambda fraction, text: None,
) -> None:
    """Draw each picture once, in ``jobs`` processes, and save it in ``folder`` as well.

    ``png``: also as pixels.
    """
    waiting = [picture for picture in pictures if picture.make is not None]
    # a process of its own is worth its start only for many figures
    calls = [(picture.make, png and folder is not None) for picture in waiting]
    done = completed(_drawn, calls, min(jobs, 1 + len(waiting) // FEW))
    for count, (i, result) in enumerate(done, 1):
        if isinstance(result, WorkerDied):
            raise result
        picture = waiting[i]
        picture.drawing, pixels = result
        progress(min(0.99, count / len(waiting)), f"figure {picture.key}")
        if folder is not None and pixels is not None:
            write_bytes(folder / f"{picture.key}.png", pixels)
    for picture in pictures:
        if folder is not None and picture.drawing:
            write_text(folder / f"{picture.key}.svg", picture.drawing)


def _drawn(call: tuple[Callable[[], Any], bool]) -> tuple[str, bytes | None]:
    """The figure as SVG, and as PNG if asked for."""
    from bayes_sensor import figures  # slow to import

    make, png = call
    figure = make()
    return figures.svg(figure), figures.png(figure) if png else None
