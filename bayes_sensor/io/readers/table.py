"""Text tables: plain CSV with a header, and PicoScope's CSV export.

Accepted: comma, semicolon, tab or blanks between columns; decimal commas where the comma is not the
separator; UTF-8 with or without byte order mark, UTF-16, Latin-1; any line ending; comment lines
before the header; a row of units under it, as ``(ms),(mV),(V)``; blank lines; PicoScope's ∞ for
samples out of range; lines about the measurement above the header, as LabVIEW writes them; times of
day, with or without a date, counted from the first sample.
"""

from __future__ import annotations

import io
import re

import numpy as np

from bayes_sensor.campaign import CampaignError, FloatArray
from bayes_sensor.io.readers.recording import (
    DataFile,
    Recording,
    Selection,
    check_counts,
    choose_columns,
    scale_time,
)
from bayes_sensor.io.readers.table_cells import (
    CLOCK,
    SEPARATOR_NAMES,
    is_value,
    lines_of,
    split_cells,
)
from bayes_sensor.io.readers.table_layout import Layout, find_layout
from bayes_sensor.io.readers.text_encoding import as_utf8, decoded

_NA_VALUES = ["", "NaN", "nan", "NAN", "NA", "na", "N/A", "n/a", "NULL", "null", "None", "none"]


_NA_VALUES += ["#N/A", "-nan", "-NaN", "1.#QNAN"]


_THOUSANDS = re.compile(r"[+-]?\d{1,3}(?:([.,' ])\d{3})(?:\1\d{3})*(?:[.,]\d+)?")


def read_table(file: DataFile, selection: Selection) -> Recording:
    """The recording in a text table.

    Raises
    ------
    CampaignError
        If the text is no table of numbers; the message names row and column.
    """
    text = as_utf8(file)
    layout = find_layout(file, text)
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
    parts = parts.str.extract(f"^{CLOCK.pattern}$")
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
    for row, (_, raw) in enumerate(lines_of(text, layout.body), layout.body_row):
        line = decoded(raw)
        if not line.strip():
            continue
        cells = split_cells(line, layout.separator)
        for i in use:
            if i < len(cells) and not is_value(cells[i], layout.decimal):
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
                f"{SEPARATOR_NAMES[layout.separator]} as above, but got {len(cells)}; "
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
    for row, (_, raw) in enumerate(lines_of(text, layout.body), layout.body_row):
        seen += bool(raw.strip())
        if seen == i:
            return row
    return layout.body_row + i
