"""The log of a serial monitor: a time of day, an arrow and what the board sent.

``12:00:00.020 -> 1.23`` is how the Arduino IDE writes it; terminal programs put the time in square
brackets.  Labels in the message, as ``CO2: 415 ppm`` or ``CO2=415``, become the columns' names.
"""

from __future__ import annotations

import re

from bayes_sensor.io.readers.stamps import is_stamp
from bayes_sensor.io.readers.table_cells import is_number, lines_of
from bayes_sensor.io.readers.text_encoding import decoded

SNIFFED = 20
"""lines that are looked at"""
_LINE = re.compile(r"\s*(?:\[([^\]]{5,40})\]|([^>]{5,40}?)\s*->)\s*(.*)")
_LABELLED = re.compile(
    r"([A-Za-z][\w .%°]{0,30}?)\s*[:=]\s*([+-]?\d+(?:\.\d+)?(?:[eE][+-]?\d+)?)"
    r"\s*([^\d\s,;|:=][^\s,;|]*)?"
)


def _parts(line: str) -> tuple[str, str] | None:
    """The time and the message of a line; None where it is not of that form."""
    match = _LINE.fullmatch(line)
    if match is None:
        return None
    stamp = (match[1] or match[2]).strip()
    return (stamp, match[3].strip()) if is_stamp(stamp) else None


def is_serial_log(text: bytes) -> bool:
    """Whether most of the first lines are a time, an arrow and a message.

    >>> is_serial_log(b"12:00:00.000 -> 1.23\\n12:00:00.020 -> 1.24\\n")
    True
    """
    lines = []
    for _, raw in lines_of(text[: 1 << 16]):
        if raw.strip():
            lines.append(decoded(raw))
        if len(lines) == SNIFFED:
            break
    return sum(_parts(line) is not None for line in lines) > len(lines) / 2


def plain_table(text: bytes) -> bytes:
    """The log as a table with tabs; a line that is no reading becomes a blank one.

    >>> plain_table(b"12:00:00.000 -> CO2: 415 ppm").decode().split("\\n")
    ['time\\tCO2 (ppm)', '12:00:00.000\\t415']
    """
    rows: list[tuple[str, list[str]]] = []
    names: list[str] | None = None
    for _, raw in lines_of(text):
        parts = _parts(decoded(raw))
        if parts is None:
            rows.append(("", []))
            continue
        stamp, message = parts
        labelled = _LABELLED.findall(message)
        if labelled:
            found = [f"{name.strip()} ({unit})" if unit else name.strip()
                     for name, _, unit in labelled]  # fmt: skip
            names = names or found
            rows.append((stamp, [value for _, value, _ in labelled]))
        else:
            cells = re.split(r"\s*[,;\t]\s*|\s+", message)
            if len(cells) > 1 and not any(is_number(cell) for cell in cells):
                names = names or cells  # the board names its readings itself
                rows.append(("", []))
            else:
                rows.append((stamp, cells))
    body = ["\t".join([stamp, *cells]) if stamp else "" for stamp, cells in rows]
    n = max((len(cells) for stamp, cells in rows if stamp), default=0)
    if names is None or len(names) != n:
        names = [f"column {i}" for i in range(2, n + 2)]
    return "\n".join(["\t".join(["time", *names]), *body]).encode()
