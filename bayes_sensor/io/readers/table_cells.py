"""Lines and cells of a table in text, and what a cell holds."""

from __future__ import annotations

import csv
import re
from collections.abc import Iterator

from bayes_sensor.io.readers.stamps import is_compact_number, is_date, is_stamp

SEPARATOR_NAMES = {"\t": "tabs", ";": "semicolons", ",": "commas", " ": "blanks"}
NA_VALUES = ["", "NaN", "nan", "NAN", "NA", "na", "N/A", "n/a", "NULL", "null", "None", "none"]
NA_VALUES += ["#N/A", "-nan", "-NaN", "1.#QNAN"]
_NOT_A_NUMBER = frozenset(text.casefold() for text in NA_VALUES)
_INFINITE = frozenset(("inf", "-inf", "+inf", "infinity", "-infinity", "+infinity", "∞", "-∞"))
OUT_OF_RANGE = frozenset(
    "ol over overflow overload overrange burnout out ----- --- -- *****".split()
)
"""words that loggers write for a sample that they could not take"""
_FLOAT = re.compile(r"[+-]?\s*(?:\d+\.?\d*|\.\d+)(?:[eEdD][+-]?\d+)?")
_ENDING = re.compile(rb"\r\n|\n|\r")


def lines_of(text: bytes, start: int = 0) -> Iterator[tuple[int, bytes]]:
    """Start and content of each line, without its ending."""
    while start < len(text):
        match = _ENDING.search(text, start)
        if match is None:
            yield start, text[start:]
            return
        yield start, text[start : match.start()]
        start = match.end()


def split_cells(line: str, separator: str) -> list[str]:
    """The cells of a line, without the blanks around them."""
    if '"' not in line:
        if separator == " ":
            return line.split()
        return [cell.strip() for cell in line.split(separator)]
    try:
        rows = list(
            csv.reader([line.strip()], delimiter=separator, skipinitialspace=True)
            if separator == " "
            else csv.reader([line], delimiter=separator, skipinitialspace=separator != "\t")
        )
    except csv.Error:
        return [cell.strip() for cell in line.split(separator)]
    return [cell.strip() for cell in (rows[0] if rows else [])]


def is_number(cell: str, decimal: str = ".") -> bool:
    """Whether a cell is a finite number."""
    cell = cell.strip()
    if decimal == ",":
        cell = cell.replace(",", ".", 1)
    return _FLOAT.fullmatch(cell) is not None


def is_missing(cell: str) -> bool:
    """Whether a cell is empty or says that there is no value."""
    folded = cell.strip().casefold()
    return folded in _NOT_A_NUMBER or folded in OUT_OF_RANGE


def is_value(cell: str, decimal: str = ".") -> bool:
    """Whether a cell is a number, infinite or missing."""
    folded = cell.strip().casefold()
    return folded in _NOT_A_NUMBER or folded in _INFINITE or is_number(cell, decimal)


def kind_of(cell: str, decimal: str = ".") -> str:
    """What a cell holds: ``empty``, ``number``, ``stamp``, ``date`` or ``text``.

    >>> [kind_of(cell) for cell in ("", "1.5", "12:00:01", "2024-03-05", "20240305_090000", "V")]
    ['empty', 'number', 'stamp', 'date', 'stamp', 'text']
    """
    text = cell.strip()
    if is_missing(text):
        return "empty"
    if is_compact_number(text):
        return "stamp"
    if text.casefold() in _INFINITE or is_number(text, decimal):
        return "number"
    if is_stamp(text):
        return "stamp"
    return "date" if is_date(text) else "text"


def looks_measured(cell: str, decimal: str) -> bool:
    """Whether a cell is a number with a decimal mark or exponent, hence no channel's name."""
    return is_number(cell, decimal) and re.search(r"[.,eE]", cell) is not None


def is_comment(line: str) -> bool:
    """Whether a line is a comment."""
    return line.lstrip().startswith(("#", "%", "//"))
