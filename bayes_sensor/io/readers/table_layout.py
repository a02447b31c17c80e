"""Layout of a table in text: preamble, header, units, separator and decimal sign."""

from __future__ import annotations

import re
from dataclasses import dataclass
from itertools import pairwise

from bayes_sensor.io.readers.quantities import known_unit
from bayes_sensor.io.readers.recording import (
    MAX_COLUMNS,
    Column,
    DataFile,
    check_counts,
    split_name,
)
from bayes_sensor.io.readers.table_cells import (
    CLOCK,
    SEPARATOR_NAMES,
    is_comment,
    is_number,
    is_sample,
    is_value,
    lines_of,
    split_cells,
)
from bayes_sensor.io.readers.text_encoding import decoded

HEAD = 1 << 20
"""bytes in which the header must end"""
_MAX_PREAMBLE = 1000
"""lines before the first data row"""


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


def find_layout(file: DataFile, text: bytes) -> Layout:
    """Separator, decimal mark, column names and the start of the data."""
    head = text[:HEAD]
    if len(text) > HEAD and not re.search(rb"[\r\n]", head):
        raise file.error(
            f"expected lines of text, but the first line is longer than {HEAD} bytes; "
            "export a table with one row per sample"
        )
    separator: str | None = None
    header: list[str] | None = None
    header_row = 0
    units: list[str] | None = None
    for row, (start, raw) in enumerate(lines_of(head), 1):
        if row > _MAX_PREAMBLE:
            break
        line = decoded(raw).strip("\ufeff")
        if not line.strip() or is_comment(line):
            continue
        told = re.fullmatch(r"(?i)\s*\"?sep=(.)\"?\s*", line)
        if told and header is None:
            separator = told[1] if told[1] in SEPARATOR_NAMES else None
            continue
        if separator is None:
            separator = _find_separator(line, head[start:])
        if line.count(separator) >= MAX_COLUMNS:
            check_counts(file, line.count(separator) + 1)
        decimal = "." if separator == "," else _find_decimal(head[start:], separator)
        cells = split_cells(line, separator)
        if header is None and not all(is_value(cell, decimal) for cell in cells):
            doubtful = [cell for cell in cells if _looks_measured(cell, decimal)]
            if doubtful:
                below = _under_preamble(file, head, row)
                if below is not None:
                    return below
                culprit = next(c for c in cells if not is_value(c, decimal))
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
        if header is not None and not all(is_sample(cell, decimal) for cell in cells):
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
        (row, start, decoded(raw))
        for (row, (start, raw)) in zip(range(1, _MAX_PREAMBLE), lines_of(head), strict=False)
        if raw.strip() and not is_comment(decoded(raw))
    ]
    for (row, start, line), (_, _, after) in pairwise(lines):
        if row <= top:
            continue
        for separator in SEPARATOR_NAMES:
            decimal = "." if separator == "," else _find_decimal(head[start:], separator)
            cells, more = split_cells(line, separator), split_cells(after, separator)
            if (
                named is not None
                and len(cells) == len(more) > 1
                and all(is_sample(cell, decimal) for cell in [*cells, *more])
                and sum(is_number(cell, decimal) for cell in cells) >= 1
                and cells[0].strip()
            ):
                header = split_cells(named[1], separator)
                if len(header) == len(cells) + 1 and header[-1].casefold() == "comment":
                    header = header[:-1]  # LabVIEW's, empty but for the first row
                if any(_looks_measured(cell, decimal) for cell in header):
                    return None
                given = split_cells(units[1], separator) if units is not None else []
                columns = _name_columns(file, header, named[0], cells, given, row, separator)
                return Layout(separator, decimal, columns, start, row, len(cells), _clocks(cells))
        for separator in SEPARATOR_NAMES:
            cells = split_cells(line, separator)
            if named is not None and len(cells) > 1 and _unit_row(cells) is not None:
                units = (row, line)
                break
        else:
            named, units = (row, line), None
    return None


def _clocks(cells: list[str]) -> frozenset[int]:
    return frozenset(i for i, cell in enumerate(cells) if CLOCK.fullmatch(cell.strip()))


def _looks_measured(cell: str, decimal: str) -> bool:
    """A number with a decimal mark or exponent, which is unlikely as a channel's name."""
    return is_number(cell, decimal) and re.search(r"[.,eE]", cell) is not None


def _find_separator(line: str, rest: bytes) -> str:
    for separator in ("\t", ";"):
        if separator in line:
            return separator
    if "," in line:
        return ","
    # a header of one word says nothing; look at the first lines under it
    sample = [decoded(raw) for _, (_, raw) in zip(range(5), lines_of(rest), strict=False)]
    for separator in ("\t", ";", ","):
        if all(separator in other for other in sample[1:] if other.strip()) and sample[1:]:
            return separator
    return " " if re.search(r"\S\s+\S", line) else ","


def _find_decimal(rest: bytes, separator: str) -> str:
    """Decimal comma if the first rows hold numbers with one and none with a point."""
    for _, (_, raw) in zip(range(50), lines_of(rest), strict=False):
        for cell in split_cells(decoded(raw), separator):
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
            f"separated by {SEPARATOR_NAMES[separator]}; {hint}"
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
