"""Text tables: plain CSV with a header, and PicoScope's CSV export.

Accepted: comma, semicolon, tab or blanks between columns; decimal commas where the comma is not the
separator; UTF-8 with or without byte order mark, UTF-16, Latin-1; any line ending; comment lines
before the header; a row of units under it, as ``(ms),(mV),(V)``; blank lines; PicoScope's ∞ for
samples out of range; lines about the measurement above the header, as LabVIEW writes them; times of
day, with or without a date, counted from the first sample.
"""

from __future__ import annotations

import codecs
import csv
import io
import re
from collections.abc import Iterator
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from bayes_sensor.campaign import CampaignError, FloatArray
from bayes_sensor.io.readers.quantities import known_unit
from bayes_sensor.io.readers.recording import (
    MAX_COLUMNS,
    Column,
    DataFile,
    Recording,
    Selection,
    check_counts,
    choose_columns,
    scale_time,
    split_name,
)

_HEAD = 1 << 20
"""bytes in which the header must end"""
_MAX_PREAMBLE = 1000
"""lines before the first data row"""
_NOT_A_NUMBER = frozenset(("", "nan", "na", "n/a", "null", "none", "#n/a", "-nan", "1.#qnan"))
_INFINITE = frozenset(("inf", "-inf", "+inf", "infinity", "-infinity", "+infinity", "∞", "-∞"))
_NA_VALUES = ["", "NaN", "nan", "NAN", "NA", "na", "N/A", "n/a", "NULL", "null", "None", "none"]
_NA_VALUES += ["#N/A", "-nan", "-NaN", "1.#QNAN"]
_FLOAT = re.compile(r"[+-]?(?:\d+\.?\d*|\.\d+)(?:[eE][+-]?\d+)?")
_CLOCK = re.compile(
    r"(?:[\d./-]{6,10}[T ]\s*)?(?:(\d{1,2}):)?(\d{1,2}):(\d{2}(?:[.,]\d+)?)"
    r"\s*([AaPp])?\.?[Mm]?\.?(?:Z|[+-]\d{2}:?\d{2})?"
)
"""hours (where they are given), minutes, seconds and a or p; a date before them is not read"""
_DATE = re.compile(r"\d{1,4}[./-]\d{1,2}[./-]\d{1,4}")
_THOUSANDS = re.compile(r"[+-]?\d{1,3}(?:([.,' ])\d{3})(?:\1\d{3})*(?:[.,]\d+)?")
_SEPARATOR_NAMES = {",": "commas", ";": "semicolons", "\t": "tabs", " ": "blanks"}


@dataclass(frozen=True)
class Layout:
    """The layout of a table, found from its first lines."""

    separator: str
    decimal: str
    columns: tuple[Column, ...]
    body: int
    """byte at which the data rows start"""
    body_row: int
    """row number, from 1, of the first data row"""
    n_cells: int
    """cells of the first data row"""
    clocks: frozenset[int] = frozenset()
    """columns that hold times of day"""


def read_table(file: DataFile, selection: Selection) -> Recording:
    """The recording in a text table.

    Raises
    ------
    CampaignError
        If the text is no table of numbers; the message names row and column.
    """
    text = _as_utf8(file)
    layout = _find_layout(file, text)
    columns = layout.columns
    time, signal, drive = choose_columns(file, columns, selection)
    use = sorted({time, signal} | ({drive} if drive is not None else set()))
    values = dict(zip(use, _parse_body(file, text, layout, use), strict=True))
    check_counts(file, len(columns), len(values[time]))
    if time in layout.clocks:
        times = _since_first(file, text, layout, time, values[time])
    else:
        times = scale_time(file, columns[time], values[time])

    def place(i: int) -> str:
        return f"row {_row_number(text, layout, i)}"

    return Recording(
        t=times,
        y=values[signal],
        signal=columns[signal].name.strip(),
        place=place,
        drive=None if drive is None else values[drive],
        drive_name="" if drive is None else columns[drive].name.strip(),
        unit=columns[signal].unit,
    )


# --------------------------------------------------------------------------- text


def _as_utf8(file: DataFile) -> bytes:
    """The content as UTF-8 without byte order mark."""
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
        row = len(re.findall(rb"\r\n|\n|\r", raw[:nul])) + 1
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


def _decode(raw: bytes) -> str:
    try:
        return raw.decode("utf-8")
    except UnicodeDecodeError:
        return raw.decode("latin-1")


def _lines(text: bytes, start: int = 0) -> Iterator[tuple[int, bytes]]:
    """Start and content of each line, without its ending."""
    ending = re.compile(rb"\r\n|\n|\r")
    while start < len(text):
        match = ending.search(text, start)
        if match is None:
            yield start, text[start:]
            return
        yield start, text[start : match.start()]
        start = match.end()


def _split(line: str, separator: str) -> list[str]:
    if separator == " ":
        return line.split()
    if '"' not in line:
        return [cell.strip() for cell in line.split(separator)]
    try:
        rows = list(csv.reader([line], delimiter=separator))
    except csv.Error:
        return [cell.strip() for cell in line.split(separator)]
    return [cell.strip() for cell in (rows[0] if rows else [])]


def _is_number(cell: str, decimal: str) -> bool:
    cell = cell.strip()
    if decimal == ",":
        cell = cell.replace(",", ".", 1)
    return _FLOAT.fullmatch(cell) is not None


def _is_value(cell: str, decimal: str) -> bool:
    folded = cell.strip().casefold()
    return folded in _NOT_A_NUMBER or folded in _INFINITE or _is_number(cell, decimal)


def _is_sample(cell: str, decimal: str) -> bool:
    """A value, a time of day or a date, as in a row of samples."""
    text = cell.strip()
    return (
        _is_value(text, decimal)
        or _CLOCK.fullmatch(text) is not None
        or _DATE.fullmatch(text) is not None
    )


def _is_comment(line: str) -> bool:
    return line.lstrip().startswith(("#", "%", "//"))


def _unit_row(cells: list[str]) -> list[str] | None:
    """The units if every cell that is not empty is one, else None."""
    units = []
    for cell in cells:
        inner = re.fullmatch(r"[\(\[]\s*(.*?)\s*[\)\]]", cell)
        if inner:
            units.append(inner[1])
        elif cell == "" or known_unit(cell):
            units.append(cell)
        else:
            return None
    return units if any(units) else None


# --------------------------------------------------------------------------- layout


def _find_layout(file: DataFile, text: bytes) -> Layout:
    """Separator, decimal mark, column names and the start of the data."""
    head = text[:_HEAD]
    if len(text) > _HEAD and not re.search(rb"[\r\n]", head):
        raise file.error(
            f"expected lines of text, but the first line is longer than {_HEAD} bytes; "
            "export a table with one row per sample"
        )
    separator: str | None = None
    header: list[str] | None = None
    header_row = 0
    units: list[str] | None = None
    for row, (start, raw) in enumerate(_lines(head), 1):
        if row > _MAX_PREAMBLE:
            break
        line = _decode(raw).strip("\ufeff")
        if not line.strip() or _is_comment(line):
            continue
        told = re.fullmatch(r"(?i)\s*\"?sep=(.)\"?\s*", line)
        if told and header is None:
            separator = told[1] if told[1] in _SEPARATOR_NAMES else None
            continue
        if separator is None:
            separator = _find_separator(line, head[start:])
        if line.count(separator) >= MAX_COLUMNS:
            check_counts(file, line.count(separator) + 1)
        decimal = "." if separator == "," else _find_decimal(head[start:], separator)
        cells = _split(line, separator)
        if header is None and not all(_is_value(cell, decimal) for cell in cells):
            doubtful = [cell for cell in cells if _looks_measured(cell, decimal)]
            if doubtful:
                below = _under_preamble(file, head, row)
                if below is not None:
                    return below
                culprit = next(c for c in cells if not _is_value(c, decimal))
                raise file.error(
                    f"row {row}: expected a header or numbers, but got the text "
                    f"'{culprit[:60]}' beside the number {doubtful[0]}; name the columns in the "
                    "first row, for example time_s,voltage_V"
                )
            header, header_row = cells, row
            continue
        if header is not None and units is None:
            units = _unit_row(cells)
            if units is not None:
                if len(units) != len(header):
                    raise file.error(
                        f"row {row}: expected one unit for each of the {len(header)} columns, but "
                        f"got {len(units)}; repair the header"
                    )
                continue
            units = []
        if header is not None and not all(_is_sample(cell, decimal) for cell in cells):
            below = _under_preamble(file, head, header_row)
            if below is not None:
                return below
        columns = _name_columns(file, header, header_row, cells, units or [], row, separator)
        return Layout(separator, decimal, columns, start, row, len(cells), _clocks(cells))
    raise file.error(
        "expected rows of numbers after the header, but there are none; export the samples as well"
    )


def _under_preamble(file: DataFile, head: bytes, top: int) -> Layout | None:
    """The layout of a table that begins below row ``top``, under lines about the measurement.

    It begins at two consecutive rows of samples.  The row above them, or above their units, must be
    names without a number.  None if there is no such place.
    """
    named: tuple[int, str] | None = None  # the last row that could name columns
    units: tuple[int, str] | None = None
    lines = [
        (row, start, _decode(raw))
        for (row, (start, raw)) in zip(range(1, _MAX_PREAMBLE), _lines(head), strict=False)
        if raw.strip() and not _is_comment(_decode(raw))
    ]
    for (row, start, line), (_, _, after) in pairwise(lines):
        if row <= top:
            continue
        for separator in _SEPARATOR_NAMES:
            decimal = "." if separator == "," else _find_decimal(head[start:], separator)
            cells, more = _split(line, separator), _split(after, separator)
            if (
                named is not None
                and len(cells) == len(more) > 1
                and all(_is_sample(cell, decimal) for cell in [*cells, *more])
                and sum(_is_number(cell, decimal) for cell in cells) >= 1
                and cells[0].strip()
            ):
                header = _split(named[1], separator)
                if len(header) == len(cells) + 1 and header[-1].casefold() == "comment":
                    header = header[:-1]  # LabVIEW's, empty but for the first row
                if any(_looks_measured(cell, decimal) for cell in header):
                    return None
                given = _split(units[1], separator) if units is not None else []
                columns = _name_columns(file, header, named[0], cells, given, row, separator)
                return Layout(separator, decimal, columns, start, row, len(cells), _clocks(cells))
        for separator in _SEPARATOR_NAMES:
            cells = _split(line, separator)
            if named is not None and len(cells) > 1 and _unit_row(cells) is not None:
                units = (row, line)
                break
        else:
            named, units = (row, line), None
    return None


def _clocks(cells: list[str]) -> frozenset[int]:
    return frozenset(i for i, cell in enumerate(cells) if _CLOCK.fullmatch(cell.strip()))


def _looks_measured(cell: str, decimal: str) -> bool:
    """A number with a decimal mark or exponent, which is unlikely as a channel's name."""
    return _is_number(cell, decimal) and re.search(r"[.,eE]", cell) is not None


def _find_separator(line: str, rest: bytes) -> str:
    for separator in ("\t", ";"):
        if separator in line:
            return separator
    if "," in line:
        return ","
    # a header of one word says nothing; look at the first lines under it
    sample = [_decode(raw) for _, (_, raw) in zip(range(5), _lines(rest), strict=False)]
    for separator in ("\t", ";", ","):
        if all(separator in other for other in sample[1:] if other.strip()) and sample[1:]:
            return separator
    return " " if re.search(r"\S\s+\S", line) else ","


def _find_decimal(rest: bytes, separator: str) -> str:
    """Decimal comma if the first rows hold numbers with one and none with a point."""
    for _, (_, raw) in zip(range(50), _lines(rest), strict=False):
        for cell in _split(_decode(raw), separator):
            if re.fullmatch(r"[+-]?\d*,\d+(?:[eE][+-]?\d+)?", cell):
                return ","
            if re.fullmatch(r"[+-]?\d*\.\d+(?:[eE][+-]?\d+)?", cell):
                return "."
    return "."


def _name_columns(
    file: DataFile,
    header: list[str] | None,
    header_row: int,
    cells: list[str],
    units: list[str],
    row: int,
    separator: str,
) -> tuple[Column, ...]:
    n = len(cells)
    if header is None:
        header = ["time"] + [f"column {i}" for i in range(2, n + 1)]
    while len(header) > n and header[-1] == "":
        header = header[:-1]
    if n == len(header) + 1 and cells[-1] == "":
        n -= 1  # a separator at the end of each row
    if n != len(header):
        hint = (
            "decimal commas need semicolons or tabs between the columns"
            if separator == "," and n == 2 * len(header)
            else "give every column a name and every row the same columns"
        )
        raise file.error(
            f"row {header_row} names {len(header)} columns, but row {row} has {n} cells "
            f"separated by {_SEPARATOR_NAMES[separator]}; {hint}"
        )
    columns = []
    for i, name in enumerate(header):
        column = split_name(name)
        if i < len(units) and units[i]:
            if not known_unit(units[i]):
                raise file.error(
                    f"row {row - 1}: the unit '{units[i][:40]}' of column '{name.strip()[:60]}' "
                    "is not known; write one such as (s), (ms), (V), (mV)"
                )
            column = Column(name, column.base, units[i])
        columns.append(column)
    return tuple(columns)


# --------------------------------------------------------------------------- numbers


def _parse_body(file: DataFile, text: bytes, layout: Layout, use: list[int]) -> list[FloatArray]:
    """The chosen columns as float arrays."""
    import pandas as pd  # slow to import

    separator = r"\s+" if layout.separator == " " else layout.separator
    body = io.BytesIO(text)
    body.seek(layout.body)
    try:
        frame = pd.read_csv(
            body,
            sep=separator,
            decimal=layout.decimal,
            header=None,
            names=list(range(layout.n_cells)),
            index_col=False,
            # no usecols: with it, cells beyond the last column are dropped in silence
            dtype={
                i: np.float64 if i in use and i not in layout.clocks else object
                for i in range(layout.n_cells)
            },
            na_values=_NA_VALUES,
            keep_default_na=False,
            skipinitialspace=True,
            low_memory=False,
            encoding_errors="replace",
        )
    except (ValueError, OverflowError) as error:  # pandas' ParserError is a ValueError
        raise _blame(file, text, layout, use, str(error)) from None
    return [frame[i].to_numpy(dtype=None if i in layout.clocks else np.float64) for i in use]


def _since_first(
    file: DataFile, text: bytes, layout: Layout, time: int, cells: FloatArray
) -> FloatArray:
    """(n,) s since the first sample, from times of day; they may pass midnight (or the hour)."""
    import pandas as pd  # slow to import

    parts = pd.Series(cells, dtype="object").astype(str).str.strip()
    parts = parts.str.extract(f"^{_CLOCK.pattern}$")
    minutes = pd.to_numeric(parts[1], errors="coerce")
    wrong = minutes.isna().to_numpy()
    if wrong.any():
        i = int(np.argmax(wrong))
        raise file.error(
            f"row {_row_number(text, layout, i)}, column "
            f"'{layout.columns[time].name.strip()[:60]}': expected a time of day as above, but got "
            f"'{str(cells[i])[:60]}'; repair or remove that row"
        )
    hours = pd.to_numeric(parts[0], errors="coerce").fillna(0).to_numpy(dtype=float)
    half = parts[3].str.casefold()
    hours = np.where(half.notna(), hours % 12, hours) + np.where(half == "p", 12, 0)
    seconds = pd.to_numeric(parts[2].str.replace(",", ".")).to_numpy(dtype=float)
    t: FloatArray = 3600 * hours + 60 * minutes.to_numpy(dtype=float) + seconds
    period = 86400.0 if parts[0].notna().any() else 3600.0
    around = np.diff(t) < -period / 2
    t[1:] += period * np.cumsum(around)
    # three decimals of the clock must give 0.01 s, not 0.010000000002
    return np.asarray(np.round(t - t[0], 9))


def _blame(
    file: DataFile, text: bytes, layout: Layout, use: list[int], reason: str
) -> CampaignError:
    """The error that names the row and column at which pandas failed."""
    columns = layout.columns
    for row, (_, raw) in enumerate(_lines(text, layout.body), layout.body_row):
        line = _decode(raw)
        if not line.strip():
            continue
        cells = _split(line, layout.separator)
        for i in use:
            if i < len(cells) and not _is_value(cells[i], layout.decimal):
                mark = {".": "point", ",": "comma"}[layout.decimal]
                fix = "repair or remove that row"
                if _THOUSANDS.fullmatch(cells[i]):
                    fix = "export the numbers without marks between the thousands"
                return file.error(
                    f"row {row}, column '{columns[i].name.strip()[:60]}': expected a number "
                    f"(decimal {mark}), but got '{cells[i][:60]}'; {fix}"
                )
        if len(cells) > layout.n_cells:
            return file.error(
                f"row {row}: expected {layout.n_cells} cells separated by "
                f"{_SEPARATOR_NAMES[layout.separator]} as above, but got {len(cells)}; "
                "repair or remove that row"
            )
    reason = " ".join(reason.split())[:160]
    return file.error(
        f"expected rows of numbers from row {layout.body_row} on, but they cannot be read "
        f"({reason}); export the file again"
    )


def _row_number(text: bytes, layout: Layout, i: int) -> int:
    """Row, counted from 1 with blank rows, of sample i."""
    seen = -1
    for row, (_, raw) in enumerate(_lines(text, layout.body), layout.body_row):
        seen += bool(raw.strip())
        if seen == i:
            return row
    return layout.body_row + i
