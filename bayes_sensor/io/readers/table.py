"""Text tables: CSV and the exports of oscilloscopes, loggers, analysers and serial monitors.

Accepted: comma, semicolon, tab or blanks between columns; decimal commas where the comma is not the
separator; UTF-8 with or without byte order mark, UTF-16, Latin-1; any line ending; comment lines;
lines about the measurement above the samples or in the first columns beside them; rows of units, as
``(ms),(mV),(V)``; blank lines; PicoScope's ∞ for samples out of range.  Times are numbers, times of
day, dates, compact stamps or seconds since an epoch; or the campaign or the file states the
sampling interval.
"""

from __future__ import annotations

import io
import re
from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from bayes_sensor.campaign import BoolArray, CampaignError, FloatArray
from bayes_sensor.io.readers.recording import (
    Clock,
    Column,
    DataFile,
    Recording,
    Selection,
    channel_names,
    check_counts,
    is_date_name,
    scale_time,
    several_times,
)
from bayes_sensor.io.readers.roles import Facts, Roles, choose_roles
from bayes_sensor.io.readers.sampling import FIRST_EPOCH, grid_times
from bayes_sensor.io.readers.serial_monitor import is_serial_log, plain_table
from bayes_sensor.io.readers.stamps import (
    LATEST_EPOCH,
    Stamps,
    epoch_unit,
    read_long_numbers,
    read_stamps,
)
from bayes_sensor.io.readers.table_cells import (
    NA_VALUES,
    OUT_OF_RANGE,
    SEPARATOR_NAMES,
    is_comment,
    is_value,
    kind_of,
    lines_of,
    split_cells,
)
from bayes_sensor.io.readers.table_layout import TableLayout, find_layout
from bayes_sensor.io.readers.text_encoding import as_utf8, decoded, without_quotes_of_rows

SAMPLED = 400
"""rows from which the kind of each column is told"""
FEWEST, BESIDE = 50, 0.3
"""rows from which, and share of them up to which, a column only holds remarks on the record"""
FIRST_DAY, LAST_DAY, DAY_S = 2e4, 8e4, 86400.0
"""days since 1900 (1954 to 2119), as spreadsheets write a date; s in one"""
DAYS_TO_1970 = 25569
MOST_EMPTY = 0.1
"""share of the rows without a signal above which they belong to other channels"""
_THOUSANDS = re.compile(r"[+-]?\d{1,3}(?:([.,' ])\d{3})(?:\1\d{3})*(?:[.,]\d+)?")


def read_table(file: DataFile, selection: Selection) -> Recording:
    """The recording in a text table.

    Raises
    ------
    CampaignError
        If the text is no table of numbers; the message names row and column.
    """
    text = without_quotes_of_rows(as_utf8(file))
    if is_serial_log(text):  # the line of names is ours, and no row of the file
        return read_text(file, plain_table(text), selection, -1)
    return read_text(file, text, selection)


def read_text(file: DataFile, text: bytes, selection: Selection, shift: int = 0) -> Recording:
    """The recording in a table in UTF-8; ``shift`` is added to the numbers of its rows."""
    text = _without_footer(text)
    layout = find_layout(file, text)
    layout = replace(layout, body_row=layout.body_row + shift)
    facts = _facts(text, layout)
    roles = choose_roles(file, facts, selection, layout.interval, layout.named)
    body = _Body(file, text, layout, facts, roles)
    check_counts(file, len(layout.columns), body.n)
    signal = body.numbers(roles.signal)
    keep = _own_rows(body, roles, signal)
    notes = list(roles.notes)
    if not keep.all():
        notes.append(
            f"{int((~keep).sum())} of {len(keep)} rows hold no "
            f"'{layout.columns[roles.signal].name.strip()[:60]}' and belong to other channels; "
            "left out"
        )
    t, clock, interval = _times(body, roles, selection, keep, notes)
    rows = np.flatnonzero(keep)
    y = signal[keep]
    drive = None if roles.drive is None else _beside(body.numbers(roles.drive), keep)
    if len(t) > 2 and interval is None and t[1] == t[0] and y[1] == y[0]:
        notes.append(f"row {_row_number(text, layout, int(rows[1]))} repeats the first; left out")
        t, y, rows = t[1:], y[1:], rows[1:]
        drive = None if drive is None else drive[1:]

    def place(i: int) -> str:
        return f"row {_row_number(text, layout, int(rows[min(i, len(rows) - 1)]))}"

    return Recording(
        t=t,
        y=y,
        signal=layout.columns[roles.signal].name.strip(),
        place=place,
        drive=drive,
        drive_name="" if roles.drive is None else layout.columns[roles.drive].name.strip(),
        unit=layout.columns[roles.signal].unit,
        interval=interval,
        clock=clock,
        timed=not roles.times or any(layout.columns[i].unit for i in roles.times),
        notes=tuple(notes),
        channels=channel_names([column.name for column in layout.columns], roles.channels),
        times=several_times([column.name for column in layout.columns], roles.times),
    )


def _without_footer(text: bytes) -> bytes:
    """The text without comment lines after the last sample."""
    while True:
        kept = text.rstrip()
        start = max(kept.rfind(b"\n"), kept.rfind(b"\r")) + 1
        if start == 0 or not is_comment(decoded(kept[start:])):
            return text
        text = text[:start]


def _facts(text: bytes, layout: TableLayout) -> list[Facts]:
    """The kind of each column, from rows at the beginning."""
    cells: list[list[str]] = [[] for _ in layout.columns]
    last = [0] * len(cells)
    n = 0
    for k, (_, raw) in enumerate(lines_of(text, layout.body)):
        if k >= SAMPLED:
            break
        row = split_cells(decoded(raw), layout.separator)
        n = k + 1
        for i in range(min(len(row), len(cells))):
            if row[i]:
                cells[i].append(row[i])
                last[i] = n
    facts = []
    for column, found, end in zip(layout.columns, cells, last, strict=True):
        if n >= FEWEST and end < BESIDE * n:  # what is known of the record, beside its first rows
            found = []
        kinds = [kind_of(cell, layout.decimal) for cell in found]
        filled = [kind for kind in kinds if kind != "empty"]
        kind = max(set(filled), key=lambda k: (filled.count(k), k)) if filled else ""
        values = [
            _float(cell, layout.decimal)
            for cell, k in zip(found, kinds, strict=True)
            if k == "number"
        ]
        facts.append(Facts(column, kind, np.array(values, dtype=float), found))
    return facts


def _float(cell: str, decimal: str) -> float:
    text = cell.strip().replace("∞", "inf")
    text = text.replace(",", ".", 1) if decimal == "," else text
    return float(re.sub(r"^([+-])\s+", r"\1", text.replace("D", "E").replace("d", "e")))


# --------------------------------------------------------------------------- the samples' rows


class _Body:
    """The rows of samples, parsed once: numbers of the columns in use, text of the others."""

    def __init__(
        self, file: DataFile, text: bytes, layout: TableLayout, facts: Sequence[Facts], roles: Roles
    ) -> None:
        self.file, self.text, self.layout, self.facts = file, text, layout, facts
        wanted = {roles.signal, *roles.times} | (
            {roles.drive} if roles.drive is not None else set()
        )
        self.plain = {
            i for i in wanted if not (i in roles.times and _is_written(facts[i]))
        }  # read as numbers at once
        self.frame = self._read(self.plain)
        self.n = len(self.frame)

    def _read(self, plain: set[int]) -> Any:
        import pandas as pd  # slow to import

        body = io.BytesIO(self.text)
        body.seek(self.layout.body)
        try:
            return pd.read_csv(
                body,
                sep=r"\s+" if self.layout.separator == " " else self.layout.separator,
                decimal=self.layout.decimal,
                header=None,
                names=list(range(self.layout.n_cells)),
                index_col=False,
                # no usecols: with it, cells beyond the last column are dropped in silence
                dtype={i: np.float64 if i in plain else object for i in range(self.layout.n_cells)},
                na_values={
                    i: NA_VALUES if i in plain else [""] for i in range(self.layout.n_cells)
                },
                keep_default_na=False,
                skipinitialspace=True,
                low_memory=False,
                encoding_errors="replace",
            )
        except (ValueError, OverflowError) as error:  # pandas' ParserError is a ValueError
            if plain and not isinstance(error, pd.errors.ParserError):
                self.plain = set()
                return self._read(set())
            raise _blame(self, plain, str(error)) from None

    def written(self, i: int) -> NDArray[np.object_]:
        """(n,) the texts of a column."""
        return np.asarray(self.frame[i].fillna("").to_numpy(dtype=object))

    def numbers(self, i: int) -> FloatArray:
        """(n,) the numbers of a column; NaN where there is none."""
        if i in self.plain:
            return np.asarray(self.frame[i].to_numpy(dtype=np.float64))
        import pandas as pd  # slow to import

        texts = self.frame[i].fillna("").astype(str).str.strip()
        folded = texts.str.casefold()
        missing = folded.isin([*OUT_OF_RANGE, *(text.casefold() for text in NA_VALUES)])
        clean = texts.where(~missing, "nan").str.replace(r"^([+-])\s+", r"\1", regex=True)
        if self.layout.decimal == ",":
            clean = clean.str.replace(",", ".", n=1, regex=False)
        values = pd.to_numeric(clean, errors="coerce")
        wrong = values.isna() & ~missing
        if wrong.any():
            raise _blame(self, {i}, "")
        return np.asarray(values.to_numpy(dtype=np.float64))

    def row(self, i: int) -> int:
        """Row, counted from 1, of sample i."""
        return _row_number(self.text, self.layout, i)


def _is_written(fact: Facts) -> bool:
    """Whether a column of times must be read as text to keep all its digits."""
    return fact.kind == "stamp" or (
        len(fact.values) > 0 and float(np.median(np.abs(fact.values))) >= FIRST_EPOCH
    )


def _own_rows(body: _Body, roles: Roles, signal: FloatArray) -> BoolArray:
    """(n,) True but for rows that hold other channels instead of the signal."""
    keep: BoolArray = np.ones(len(signal), dtype=bool)
    empty = np.isnan(signal)
    apart = {roles.signal, roles.date, roles.fraction, *roles.times}
    others = [
        i
        for i, fact in enumerate(body.facts)
        if i not in apart and fact.kind == "number" and i < body.layout.n_cells
    ]
    if empty.mean() <= MOST_EMPTY or empty.all() or not others:
        return keep
    filled = np.zeros(len(signal), dtype=bool)
    for i in others:
        filled |= body.frame[i].notna().to_numpy(dtype=bool)
    return np.asarray(~(empty & filled))


def _beside(drive: FloatArray, keep: BoolArray) -> FloatArray:
    """The drive at the rows that are kept; from the row before where it stands in others."""
    known = np.isfinite(drive)
    if keep.all() or not known.any() or known[keep].mean() > 0.5:
        return drive[keep]
    last = np.maximum.accumulate(np.where(known, np.arange(len(drive)), -1))
    held = np.where(last >= 0, drive[np.maximum(last, 0)], drive[int(np.argmax(known))])
    return np.asarray(held[keep])


# --------------------------------------------------------------------------- times


def _times(
    body: _Body, roles: Roles, selection: Selection, keep: BoolArray, notes: list[str]
) -> tuple[FloatArray, Clock | None, float | None]:
    """(n,) s, the clock they count from, and the interval where there are no times."""
    if not roles.times:
        stated, start = body.layout.interval, body.layout.start
        if selection.interval is not None:
            stated, start = selection.interval, 0.0
        assert stated is not None
        return grid_times(start, stated, body.n)[keep], None, stated if keep.all() else None
    found: list[tuple[FloatArray, Clock | None, str]] = []
    for i in roles.times:
        try:
            t, clock, remark = _time_of(body, roles, i, keep)
        except CampaignError:
            if i == roles.times[0] and len(roles.times) == 1:
                raise
            continue
        if len(t) > 1 and bool((np.diff(t) > 0).all()):
            if found:
                first = body.layout.columns[roles.times[0]].name.strip()[:60]
                notes.append(
                    f"time is column '{body.layout.columns[i].name.strip()[:60]}', as '{first}' "
                    "does not increase strictly"
                )
            notes += [remark] if remark else []
            return t, clock, None
        found.append((t, clock, remark))
    if not found:
        t, clock, remark = _time_of(body, roles, roles.times[0], keep)
        found.append((t, clock, remark))
    t, clock, remark = found[0]
    stated = body.layout.interval
    if stated is not None and len(t) > 1 and (np.diff(t) >= 0).all() and clock is not None:
        # whole seconds of a fast recorder, which states its interval
        notes.append(
            f"times were counted by the interval that the file states, {stated:.6g} s, as those "
            f"in column '{body.layout.columns[roles.times[0]].name.strip()[:60]}' repeat"
        )
        return grid_times(0.0, stated, len(t)), clock, stated
    notes += [remark] if remark else []
    return t, clock, None


def _time_of(
    body: _Body, roles: Roles, i: int, keep: BoolArray
) -> tuple[FloatArray, Clock | None, str]:
    """(n,) s of one column of times, the clock they count from, and a remark."""
    fact = body.facts[i]
    column = fact.column
    if fact.kind == "stamp":
        dates = None if roles.date is None else list(body.written(roles.date)[keep])
        stamps = _known(body, i, keep, lambda cells: read_stamps(cells, dates), "time of day")
        assert isinstance(stamps, Stamps)
        ns = stamps.ns
        if roles.fraction is not None and i != roles.fraction and stamps.whole:
            ns = ns + np.rint(body.numbers(roles.fraction)[keep] * 1e6).astype(np.int64)
        clock = Clock(int(ns[0]), stamps.dated, stamps.offset)
        remark = ""
        if stamps.relabelled is not None:
            row = body.row(int(np.flatnonzero(keep)[stamps.relabelled]))
            remark = (
                f"the offset from UTC changes at row {row}, but the time of day goes on; the "
                "elapsed time was taken from the time of day"
            )
        return (ns - ns[0]) / 1e9, clock, remark
    if not _is_written(fact):
        return number_times(body.file, column, body.numbers(i)[keep])
    return _epoch_times(body, i, keep)


def _epoch_times(body: _Body, i: int, keep: BoolArray) -> tuple[FloatArray, Clock | None, str]:
    """(n,) s of long numbers, which count from 1970 or another epoch."""
    fact = body.facts[i]
    second, remark = _unit_of(body.file, fact.column, float(np.median(fact.values)))
    known = _known(body, i, keep, lambda cells: read_long_numbers(cells, second), "number")
    ns, numbers = known
    if ns is None or abs(numbers[0]) * second < FIRST_EPOCH:  # long numbers, but no epoch
        return scale_time(body.file, fact.column, numbers), None, remark
    return (ns - ns[0]) / 1e9, Clock(int(ns[0]), True), remark


def _unit_of(file: DataFile, column: Column, typical: float) -> tuple[float, str]:
    """Seconds in the unit of a column of times, by its name or by its size, and a remark."""
    if column.unit:
        return float(scale_time(file, column, np.ones(1))[0]), ""
    told = epoch_unit(typical)
    name = column.name.strip()[:60]
    if told is None and FIRST_DAY <= typical <= LAST_DAY and is_date_name(column):
        return DAY_S, f"column '{name}' was read in days, as spreadsheets count them"
    if told is None:
        return 1.0, ""
    unit, second = told
    return (
        second,
        "" if unit == "s" else f"column '{name}' was read in {unit} since 1970, by its size",
    )


def number_times(
    file: DataFile, column: Column, values: NDArray[Any]
) -> tuple[FloatArray, Clock | None, str]:
    """(n,) s of a column of numbers, or of NumPy's datetime64 and timedelta64.

    Where they count from an epoch, from its first, which the clock has.
    """
    if values.dtype.kind in "Mm":
        missing = np.isnat(values)
        if missing.any():
            raise file.error(
                f"row {int(np.argmax(missing)) + 1} of '{column.name.strip()[:60]}' has no time; "
                "expected one for each sample: leave it out"
            )
        ns = values.astype(f"{values.dtype.kind}8[ns]").astype(np.int64)
        return (ns - ns[0]) / 1e9, Clock(int(ns[0]), values.dtype.kind == "M"), ""
    numbers = np.asarray(values, dtype=np.float64)
    finite = numbers[np.isfinite(numbers)]
    typical = float(np.median(finite)) if len(finite) else 0.0
    second, remark = _unit_of(file, column, typical)
    most = float(np.abs(finite).max()) if len(finite) else 0.0
    if second == DAY_S and not column.unit:
        since = round((float(numbers[0]) - DAYS_TO_1970) * second * 1e9)
        return np.round((numbers - numbers[0]) * second, 4), Clock(since, True), remark
    if not (FIRST_EPOCH <= abs(typical) * second and most * second < LATEST_EPOCH) or len(
        finite
    ) < len(numbers):
        return scale_time(file, column, numbers), None, ""
    per = round(second * 1e9)
    if values.dtype.kind in "iu" and per >= 1:
        ns = values.astype(np.int64) * per
    else:
        # floats keep a second since 1970 to a few tenths of a microsecond
        away = (numbers - numbers[0]) * second
        ns = round(float(numbers[0]) * second * 1e9) + np.rint(away * 1e9).astype(np.int64)
    return (ns - ns[0]) / 1e9, Clock(int(ns[0]), True), remark


def _known(body: _Body, i: int, keep: BoolArray, read: Callable[[Any], Any], what: str) -> Any:
    """What ``read`` makes of a column's texts, with the error for the first it does not know."""
    cells = body.written(i)[keep]
    found = read(cells)
    if isinstance(found, int):
        row = body.row(int(np.flatnonzero(keep)[found]))
        name = body.layout.columns[i].name.strip()[:60]
        got = str(cells[found]).strip()
        if not got or got.casefold() == "nan":
            raise body.file.error(
                f"row {row}: the time is {got or 'missing'}; expected a {what} as above: repair or "
                "remove that row"
            )
        raise body.file.error(
            f"row {row}, column '{name}': expected a {what} as above, but got '{got[:60]}'; "
            "repair or remove that row"
        )
    return found


# --------------------------------------------------------------------------- faults


def _blame(body: _Body, use: set[int], reason: str) -> CampaignError:
    """The error that names the row and column at which the parser failed."""
    layout, columns = body.layout, body.layout.columns
    for row, (_, raw) in enumerate(lines_of(body.text, layout.body), layout.body_row):
        line = decoded(raw)
        if not line.strip():
            continue
        cells = split_cells(line, layout.separator)
        for i in sorted(use):
            if i < len(cells) and not (
                is_value(cells[i], layout.decimal) or cells[i].casefold() in OUT_OF_RANGE
            ):
                mark = {".": "point", ",": "comma"}[layout.decimal]
                fix = "repair or remove that row"
                if _THOUSANDS.fullmatch(cells[i]):
                    fix = "export the numbers without marks between the thousands"
                return body.file.error(
                    f"row {row}, column '{columns[i].name.strip()[:60]}': expected a number "
                    f"(decimal {mark}), but got '{cells[i][:60]}'; {fix}"
                )
        if len(cells) > layout.n_cells:
            return body.file.error(
                f"row {row}: expected {layout.n_cells} cells separated by "
                f"{SEPARATOR_NAMES[layout.separator]} as above, but got {len(cells)}; "
                "repair or remove that row"
            )
    reason = " ".join(reason.split())[:160]
    return body.file.error(
        f"expected rows of numbers from row {layout.body_row} on, but they cannot be read "
        f"({reason}); export the file again"
    )


def _row_number(text: bytes, layout: TableLayout, i: int) -> int:
    """Row, counted from 1 with blank rows, of sample i."""
    seen = -1
    for row, (_, raw) in enumerate(lines_of(text, layout.body), layout.body_row):
        seen += bool(raw.strip())
        if seen == i:
            return row
    return layout.body_row + i
