"""What a notebook shows: records as small HTML tables, and progress while they are computed.

Records call :func:`card` in their ``_repr_html_``; every text is escaped, since names come from
files.  :func:`progress_bar` is handed to anything that takes ``progress``.
"""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import fields
from html import escape
from math import floor, isfinite, log10
from time import monotonic
from typing import Any

PAUSE = 0.2
"""s between two drawings of a bar"""
PATIENCE = 1.0
"""s before a bar appears: what is done by then needs none"""
LONGEST = 100
"""characters of a field in a card"""
FEW = 8
"""entries of a field that are listed in a card"""


SECONDS_FROM = 1.0
"""s; a lag is given in seconds from here on, below in ms"""


def time_unit(seconds: float) -> tuple[float, str]:
    """The factor and the unit for a lag of so many seconds.

    >>> time_unit(0.048), time_unit(20.0)
    ((1000.0, 'ms'), (1.0, 's'))
    """
    return (1.0, "s") if seconds >= SECONDS_FROM else (1e3, "ms")


def shown(value: object, digits: int = 4) -> str:
    """A cell's text: numbers with ``digits`` significant digits, what does not exist as a dash.

    >>> shown(0.0481234), shown(None), shown(float("nan")), shown("a"), shown(840000), shown(True)
    ('0.04812', '–', '–', 'a', '840000', 'yes')
    """
    if isinstance(value, bool):
        return "yes" if value else "no"
    if value is None or (isinstance(value, float) and not isfinite(value)):
        return "–"
    if not isinstance(value, float):
        return str(value)
    if value == 0.0:
        return "0"
    exponent = floor(log10(abs(value)))
    if not -5 < exponent < 7:
        return f"{value:.{digits - 1}e}"
    return f"{value:.{max(0, digits - 1 - exponent)}f}"


def card(
    title: str,
    sentences: Iterable[str] = (),
    columns: Sequence[str] = (),
    rows: Iterable[Sequence[object]] = (),
) -> str:
    """HTML of a title, sentences and a table; numbers stand to the right.

    >>> card("<fit>", ["RMS 2 mV"], ["name", "ms"], [["tau", 48.1]])[:61]
    '<div><p><strong>&lt;fit&gt;</strong></p><p>RMS 2 mV</p><table'
    """
    parts = [f"<div><p><strong>{escape(title)}</strong></p>"]
    parts += [f"<p>{escape(text)}</p>" for text in sentences]
    if columns:
        head = "".join(f'<th style="text-align:left">{escape(name)}</th>' for name in columns)
        parts.append(f"<table><thead><tr>{head}</tr></thead><tbody>")
        for row in rows:
            cells = (
                f'<td style="text-align:{"left" if isinstance(cell, str) else "right"}">'
                f"{escape(shown(cell))}</td>"
                for cell in row
            )
            parts.append(f"<tr>{''.join(cells)}</tr>")
        parts.append("</tbody></table>")
    return "".join([*parts, "</div>"])


def record_card(record: Any) -> str:
    """HTML of a record for a notebook: its fields, arrays by their shape.

    A class takes it as its ``_repr_html_``.
    """
    rows = [[f.name, _said(getattr(record, f.name))] for f in fields(record)]
    return card(type(record).__name__, columns=["field", "value"], rows=rows)


def _said(value: object) -> object:
    if value is None or isinstance(value, bool | int | float):
        return value
    if isinstance(value, str):
        return value if len(value) <= LONGEST else value[: LONGEST - 1] + "\N{HORIZONTAL ELLIPSIS}"
    shape = getattr(value, "shape", None)
    if isinstance(shape, tuple):
        return shown(float(value)) if shape == () else f"array {shape}"  # type: ignore[arg-type]
    if isinstance(value, Mapping):
        few = ", ".join(map(str, list(value)[:FEW]))
        return f"{few}, .. ({len(value)})" if len(value) > FEW else few
    if isinstance(value, list | tuple):
        if len(value) <= FEW and all(isinstance(v, str | int | float) for v in value):
            return ", ".join(shown(v) for v in value)
        return f"{len(value)} {'entry' if len(value) == 1 else 'entries'}"
    said = repr(value)
    return said if len(said) <= LONGEST else type(value).__name__


def in_kernel() -> bool:
    """Whether this runs in a kernel that can show HTML (not IPython in a terminal)."""
    if "IPython" not in sys.modules:
        return False
    from IPython import get_ipython

    shell = get_ipython()
    return shell is not None and shell.__class__.__name__ == "ZMQInteractiveShell"


def progress_bar(label: str = "") -> Callable[[float, str], None]:
    """A callable for ``progress=``: a bar in a notebook, nothing elsewhere.

    It appears after a second, is redrawn five times a second at most and says when all is done.

    >>> tell = progress_bar("fit")
    >>> tell(0.5, "swarm 2 of 3")
    """
    if not in_kernel():
        return lambda fraction, text: None
    from IPython import display

    screen: Any = display  # its functions carry no types
    begun = drawn = monotonic()
    handle: Any = None

    def tell(fraction: float, text: str) -> None:
        nonlocal drawn, handle
        now, share = monotonic(), min(max(float(fraction), 0.0), 1.0)
        done = share >= 1.0
        if (now - begun < PATIENCE) if handle is None else (now - drawn < PAUSE and not done):
            return
        drawn = now
        words = f"{label} done in {now - begun:.0f} s" if done else f"{label} {text}"
        bar = "" if done else f'<progress value="{share:.3f}" max="1"></progress> '
        content = screen.HTML(f"{bar}<span>{escape(words.strip())}</span>")
        if handle is None:
            handle = screen.display(content, display_id=True)
        else:
            handle.update(content)

    return tell
