"""Excel workbooks (.xlsx): the sheet with the most numbers, read as a text table."""

from __future__ import annotations

import datetime
import io
import warnings
from typing import Any

from bayes_sensor.io.readers.recording import (
    MAX_COLUMNS,
    MAX_SAMPLES,
    DataFile,
    Recording,
    Selection,
    check_counts,
    missing_extra,
    parser_errors,
)
from bayes_sensor.io.readers.table import read_text

_WHAT = "an Excel workbook (.xlsx)"


def read_xlsx(file: DataFile, selection: Selection) -> Recording:
    """The recording in an Excel workbook.

    Raises
    ------
    CampaignError
        If the file is damaged or no sheet is a table of numbers.
    """
    try:
        import openpyxl
    except ImportError:
        raise missing_extra(file, ".xlsx", "xlsx") from None
    with parser_errors(file, _WHAT), warnings.catch_warnings():
        warnings.simplefilter("ignore")
        book = openpyxl.load_workbook(
            io.BytesIO(file.content), read_only=True, data_only=True, keep_links=False
        )
        sheets = [_rows(file, sheet) for sheet in book.worksheets]
        book.close()
    most = max(sheets, key=lambda rows: sum(map(_numbers, rows)), default=[])
    if not any(map(_numbers, most)):
        raise file.error(
            "expected a sheet with columns of numbers, but there is none; enter the samples as "
            "numbers, or save as CSV"
        )
    width = max(len(row) for row in most)
    lines = ["\t".join([_text(value) for value in row] + [""] * (width - len(row))) for row in most]
    return read_text(file, "\n".join(lines).encode(), selection)


def _rows(file: DataFile, sheet: Any) -> list[tuple[Any, ...]]:
    """The rows of a sheet, without empty cells at their ends."""
    rows: list[tuple[Any, ...]] = []
    for row in sheet.iter_rows(values_only=True):
        cells = list(row)
        while cells and cells[-1] is None:
            cells.pop()
        if len(cells) > MAX_COLUMNS or len(rows) > MAX_SAMPLES:
            check_counts(file, len(cells), len(rows))
        rows.append(tuple(cells))
    return rows


def _numbers(row: tuple[Any, ...]) -> int:
    return sum(isinstance(value, int | float) and not isinstance(value, bool) for value in row)


def _text(value: object) -> str:
    """A cell as a text table would have it."""
    if value is None:
        return ""
    if isinstance(value, datetime.datetime | datetime.date):
        return value.isoformat(*([" "] if isinstance(value, datetime.datetime) else []))
    if isinstance(value, datetime.time):
        return value.isoformat()
    if isinstance(value, datetime.timedelta):
        seconds, rest = divmod(value // datetime.timedelta(microseconds=1), 10**6)
        return f"{seconds // 3600:02d}:{seconds // 60 % 60:02d}:{seconds % 60:02d}.{rest:06d}"
    if isinstance(value, float):
        return repr(value)
    return " ".join(str(value).split())
