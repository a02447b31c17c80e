"""The text of a table: its encoding, lines and cells."""

from __future__ import annotations

import codecs
import csv
import re
from collections.abc import Iterator

from bayes_sensor.io.readers.recording import DataFile
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


def as_utf8(file: DataFile) -> bytes:
    """The content as UTF-8 without byte order mark.

    Raises
    ------
    CampaignError
        If the content is no text.
    """
    raw = file.content
    if raw.startswith(codecs.BOM_UTF8):
        raw = raw[len(codecs.BOM_UTF8) :]
    elif raw.startswith((codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE)):
        raw = _transcode(file, raw, "utf-16")
    elif b"\0" in raw[:4096]:
        even, odd, half = raw[0:4096:2].count(0), raw[1:4096:2].count(0), len(raw[:4096]) // 2
        if odd > half // 2 > 4 * even:
            raw = _transcode(file, raw, "utf-16-le")
        elif even > half // 2 > 4 * odd:
            raw = _transcode(file, raw, "utf-16-be")
        else:
            raise file.error(
                "expected a text table, but the content is binary; "
                "check the suffix or export as CSV"
            )
    nul = raw.find(b"\0")
    if nul >= 0:
        row = len(_ENDING.findall(raw[:nul])) + 1
        raise file.error(
            f"row {row} holds a zero byte, so the file is damaged there; export it again"
        )
    if b"\xe2\x88\x9e" in raw:
        raw = raw.replace(b"\xe2\x88\x9e", b"inf")
    if not raw.strip():
        raise file.error(
            "expected a table with a header and numbers, but the file is empty; export it again"
        )
    return raw


def _transcode(file: DataFile, raw: bytes, encoding: str) -> bytes:
    try:
        return raw.decode(encoding).lstrip("\ufeff").encode("utf-8")
    except UnicodeError as error:
        raise file.error(
            f"expected {encoding.upper()} text, but it cannot be decoded ({error}); "
            "the file may be truncated: export it again"
        ) from None


def decode(raw: bytes) -> str:
    """The text of a line, in UTF-8 or else in Latin-1."""
    try:
        return raw.decode("utf-8")
    except UnicodeDecodeError:
        return raw.decode("latin-1")


def lines_of(text: bytes, start: int = 0) -> Iterator[tuple[int, bytes]]:
    """Start and content of each line, without its ending."""
    while start < len(text):
        match = _ENDING.search(text, start)
        if match is None:
            yield start, text[start:]
            return
        yield start, text[start : match.start()]
        start = match.end()


def split_line(line: str, separator: str) -> list[str]:
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
