"""Lines and cells of a table in text, and what a cell holds."""

from __future__ import annotations

import csv
import re
from collections.abc import Iterator

NOT_A_NUMBER = frozenset(("", "nan", "na", "n/a", "null", "none", "#n/a", "-nan", "1.#qnan"))
INFINITE = frozenset(("inf", "-inf", "+inf", "infinity", "-infinity", "+infinity", "∞", "-∞"))
FLOAT = re.compile(r"[+-]?(?:\d+\.?\d*|\.\d+)(?:[eE][+-]?\d+)?")
CLOCK = re.compile(
    r"(?:[\d./-]{6,10}[T ]\s*)?(?:(\d{1,2}):)?(\d{1,2}):(\d{2}(?:[.,]\d+)?)"
    r"\s*([AaPp])?\.?[Mm]?\.?(?:Z|[+-]\d{2}:?\d{2})?"
)
"""hours (where they are given), minutes, seconds and a or p; a date before them is not read"""
DATE = re.compile(r"\d{1,4}[./-]\d{1,2}[./-]\d{1,4}")
SEPARATOR_NAMES = {",": "commas", ";": "semicolons", "\t": "tabs", " ": "blanks"}


def lines_of(text: bytes, start: int = 0) -> Iterator[tuple[int, bytes]]:
    """Start and content of each line, without its ending."""
    ending = re.compile(rb"\r\n|\n|\r")
    while start < len(text):
        match = ending.search(text, start)
        if match is None:
            yield start, text[start:]
            return
        yield start, text[start : match.start()]
        start = match.end()


def split_cells(line: str, separator: str) -> list[str]:
    if separator == " ":
        return line.split()
    if '"' not in line:
        return [cell.strip() for cell in line.split(separator)]
    try:
        rows = list(csv.reader([line], delimiter=separator))
    except csv.Error:
        return [cell.strip() for cell in line.split(separator)]
    return [cell.strip() for cell in (rows[0] if rows else [])]


def is_number(cell: str, decimal: str) -> bool:
    cell = cell.strip()
    if decimal == ",":
        cell = cell.replace(",", ".", 1)
    return FLOAT.fullmatch(cell) is not None


def is_value(cell: str, decimal: str) -> bool:
    folded = cell.strip().casefold()
    return folded in NOT_A_NUMBER or folded in INFINITE or is_number(cell, decimal)


def is_sample(cell: str, decimal: str) -> bool:
    """A value, a time of day or a date, as in a row of samples."""
    text = cell.strip()
    return (
        is_value(text, decimal)
        or CLOCK.fullmatch(text) is not None
        or DATE.fullmatch(text) is not None
    )


def is_comment(line: str) -> bool:
    return line.lstrip().startswith(("#", "%", "//"))
