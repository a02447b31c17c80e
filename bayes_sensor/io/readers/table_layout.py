"""The layout of a text table: where its samples begin, what its columns are called, their units.

One mechanism serves all recorders.  The last lines of the file's head tell the separator and what
each column holds; the samples begin at the first line of that kind.  The lines above are looked
through for names, for units and for a sampling interval.
"""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass

from bayes_sensor.io.readers.quantities import conversion_factor, known_unit
from bayes_sensor.io.readers.recording import (
    MAX_COLUMNS,
    Column,
    DataFile,
    check_counts,
    is_time,
    split_name,
)
from bayes_sensor.io.readers.table_cells import (
    SEPARATOR_NAMES,
    is_comment,
    is_number,
    is_value,
    kind_of,
    lines_of,
    looks_measured,
    split_cells,
)
from bayes_sensor.io.readers.text_encoding import decoded

HEAD = 1 << 20
"""bytes in which the samples must begin"""
PROBE = 60
"""lines from which separator and kinds of columns are told"""
AHEAD, MOSTLY = 12, 0.75
"""rows that follow the first sample, and the share of them that must be samples, too"""
MOST_HEADER_ROWS = 8
"""rows above the samples among which names and units are sought"""
_PROCESSING = frozenset("smp avg max min tot std med mmin mmax wvc".split())
"""what a Campbell logger did to a column, in the last row of its header"""
_INTERVALS = frozenset(
    "sampleinterval samplinginterval samplingperiod sampleperiod increment xincrement xincr xinc "
    "tinc timeincrement timestep timeinterval horizontalinterval hresolution deltax deltat dt "
    "scaninterval logginginterval loginterval logperiod interval period".split()
)
_RATES = frozenset("samplerate samplingrate samplingfrequency samplefrequency scanrate fs".split())
_STARTS = frozenset("start t0 tstart xorigin xstart x0 hoffset xzero".split())
_NUMBER = r"[+-]?(?:\d+\.?\d*|\.\d+)(?:[eE][+-]?\d+)?"
_TOLD = re.compile(rf"({_NUMBER})\s*\(?([A-Za-zµμ]+(?:/[A-Za-z]+)?)?\)?")


@dataclass(frozen=True)
class TableLayout:
    """The layout of a table, found from its first lines."""

    separator: str
    decimal: str
    columns: tuple[Column, ...]
    body: int
    """byte at which the data rows start"""
    body_row: int
    """row number, from 1, of the first data row"""
    n_cells: int
    """cells of a data row"""
    named: bool
    """whether the file names its columns"""
    interval: float | None = None
    """s, where a line above the samples states it"""
    start: float = 0.0
    """s, time of the first sample, as stated with the interval"""


@dataclass(frozen=True)
class _Line:
    row: int
    start: int
    text: str


def find_layout(file: DataFile, text: bytes) -> TableLayout:
    """Separator, decimal mark, column names, units, stated interval and the start of the data.

    Raises
    ------
    CampaignError
        If there are no rows of numbers, or their names or units cannot be settled.
    """
    head = text[:HEAD]
    if len(text) > HEAD and not re.search(rb"[\r\n]", head):
        raise file.error(
            f"expected lines of text, but the first line is longer than {HEAD} bytes; "
            "export a table with one row per sample"
        )
    lines = [
        _Line(row, start, decoded(raw).strip("\ufeff"))
        for row, (start, raw) in enumerate(lines_of(head), 1)
        if raw.strip()
    ]
    if len(text) > HEAD:
        lines = lines[:-1]  # cut in the middle
    comments = [line for line in lines if is_comment(line.text) and not _is_numbered(line.text)]
    told = [re.fullmatch(r"(?i)\s*\"?sep=(.)\"?\s*", line.text) for line in lines[:1]]
    separator = told[0][1] if told and told[0] and told[0][1] in SEPARATOR_NAMES else None
    skip = {line.row for line in comments} | ({lines[0].row} if told and told[0] else set())
    rows = [line for line in lines if line.row not in skip]
    nothing = file.error(
        "expected rows of numbers after the header, but there are none; export the samples as well"
    )
    if not rows:
        raise nothing
    for mark in "\t;,":
        if rows[0].text.count(mark) >= MAX_COLUMNS:
            check_counts(file, rows[0].text.count(mark) + 1)
    found = _probe(rows[-PROBE:], separator)
    if found is None:
        raise nothing
    separator, decimal, n, kinds = found
    first = _first_sample(rows, separator, decimal, n, kinds)
    if first is None:
        raise nothing
    if first and not kinds[-1] and n > 1:
        # a separator at the end of each row, or a column that is empty throughout
        above = split_cells(rows[first - 1].text, separator)
        if len(above) == n - 1:
            kinds = kinds[:-1]
    names, units, first = _header(file, rows, first, separator, decimal, kinds, comments)
    preamble = [line for line in lines if line.row < rows[first].row]
    interval, start = _stated_interval(preamble, rows[first : first + 3], separator)
    columns = _columns(file, names, units, n, rows[first].row)
    return TableLayout(
        separator,
        decimal,
        columns,
        rows[first].start,
        rows[first].row,
        max(n, len(columns), len(split_cells(rows[first].text, separator))),
        names is not None,
        interval,
        start,
    )


def _is_numbered(line: str) -> bool:
    """Whether a line with # in front is a row of a table, as a header ``#,Date Time,..``."""
    return re.match(r'\s*"?#"?\s*[,;\t]', line) is not None


# --------------------------------------------------------------------------- samples


def _probe(
    rows: Sequence[_Line], separator: str | None
) -> tuple[str, str, int, tuple[str, ...]] | None:
    """Separator, decimal mark, number of cells and kind of each column, from some lines."""
    best: tuple[float, str, str, int, tuple[str, ...]] | None = None
    for mark in SEPARATOR_NAMES if separator is None else (separator,):
        decimal = "." if mark == "," else _find_decimal(rows, mark)
        table = [split_cells(line.text, mark) for line in rows]
        counts = Counter(len(cells) for cells in table)
        n = max(counts, key=lambda count: (counts[count] * (count > 1), count))
        chosen = [cells for cells in table if len(cells) == n]
        kinds = [[kind_of(cell, decimal) for cell in cells] for cells in chosen]
        columns = tuple(_main_kind([row[i] for row in kinds]) for i in range(n))
        if "number" not in columns:
            continue
        flat = [kind for row in kinds for kind in row if kind]
        sound = sum(kind != "text" for kind in flat) / max(len(flat), 1)
        share = len(chosen) / len(table)
        score = sound * share * (1.0 if n > 1 else 0.5)
        if best is None or score > best[0] + 1e-9:
            best = score, mark, decimal, n, columns
    return None if best is None else best[1:]


def _main_kind(kinds: Sequence[str]) -> str:
    """The kind of most cells that are not empty; '' where all are."""
    counts = Counter(kind for kind in kinds if kind != "empty")
    return max(counts, key=lambda kind: (counts[kind], kind != "text")) if counts else ""


def _find_decimal(rows: Sequence[_Line], separator: str) -> str:
    """Decimal comma if the first rows hold numbers with one and none with a point."""
    for line in rows:
        for cell in split_cells(line.text, separator):
            if re.fullmatch(r"[+-]?\d*,\d+(?:[eE][+-]?\d+)?", cell):
                return ","
            if re.fullmatch(r"[+-]?\d*\.\d+(?:[eE][+-]?\d+)?", cell):
                return "."
    return "."


def _first_sample(
    rows: Sequence[_Line], separator: str, decimal: str, n: int, kinds: tuple[str, ...]
) -> int | None:
    """The place of the first line with samples."""
    measured = [i for i, kind in enumerate(kinds) if kind in ("number", "stamp", "date")]
    least = min(measured[-1] + 1, n)
    key = measured[0] - 1 if measured[0] > 0 and kinds[measured[0] - 1] == "" else None

    def holds_samples(line: _Line) -> bool:
        cells = split_cells(line.text, separator)
        if len(cells) < least or len(cells) > n + 1 or (key is not None and cells[key]):
            return False  # a text before the first measured column is a key with its value
        found = [kind_of(cells[i], decimal) for i in measured]
        filled = [kind for kind in found if kind != "empty"]
        return bool(filled) and "text" not in filled

    for i, line in enumerate(rows):
        if not holds_samples(line):
            continue
        ahead = [holds_samples(other) for other in rows[i : i + AHEAD]]
        if sum(ahead) >= MOSTLY * len(ahead) or (
            len(ahead) < AHEAD and len(ahead) - sum(ahead) < 2
        ):
            return i
    return None


# --------------------------------------------------------------------------- names and units


def _header(
    file: DataFile,
    rows: Sequence[_Line],
    first: int,
    separator: str,
    decimal: str,
    kinds: tuple[str, ...],
    comments: Sequence[_Line],
) -> tuple[list[str] | None, list[str], int]:
    """The columns' names (None where there are none), their units and the place of the first
    sample, which is moved up over rows that are broken."""
    n = len(kinds)
    candidates: list[tuple[int, list[str]]] = []  # from the samples upwards
    broken = first
    starts = [split_cells(line.text, separator)[0] for line in rows[first : first + 3]]
    whole = [int(cell) for cell in starts if re.fullmatch(r"\d{1,9}", cell)]
    numbered = len(whole) == 3 and whole[2] - whole[1] == whole[1] - whole[0] == 1
    # a comma before the milliseconds, which separates columns, too
    body = [split_cells(line.text, separator) for line in rows[first : first + 3]]
    split_off = next(
        (
            i + 1
            for i, kind in enumerate(kinds[:-1])
            if kind == "stamp"
            and all(len(c) > i + 1 and re.fullmatch(r"\d{3}", c[i + 1]) for c in body)
        ),
        None,
    )
    for i in range(first - 1, max(first - 1 - MOST_HEADER_ROWS, -1), -1):
        cells = _fit_header(_cells_above(rows[i].text, separator, n), kinds)
        if len(cells) == n - 1 and n > 2 and numbered:
            cells = ["", *cells]  # no name for the rows' numbers
        if len(cells) == n - 1 and split_off is not None:
            cells = [*cells[:split_off], "ms", *cells[split_off:]]
        if len(cells) != n and i == first - 1 - len(candidates) and _brackets(cells):
            raise file.error(
                f"row {rows[i].row}: expected one unit for each of the {n} columns, but "
                f"got {len(cells)}; repair the header"
            )
        if len(cells) != n:
            break
        if kinds[0] and is_value(cells[0], decimal) and cells[0] and not candidates:
            if any(looks_measured(cell, decimal) for cell in cells):
                broken = i
                continue
        in_use = [cell for cell, kind in zip(cells, kinds, strict=True) if kind]
        if any(looks_measured(cell, decimal) for cell in in_use) or "stamp" in map(kind_of, in_use):
            break
        candidates.append((i, cells))
    names_at = _names_row(candidates)
    if names_at is None:
        if broken < first:
            cells = split_cells(rows[broken].text, separator)
            culprit = next((c for c in cells if kind_of(c, decimal) == "text"), cells[-1])
            raise file.error(
                f"row {rows[broken].row}: expected a header or numbers, but got the text "
                f"'{culprit[:60]}' beside the number {cells[0]}; name the columns in the "
                "first row, for example time_s,voltage_V"
            )
        if first == 1 and not _told(rows[0].text):
            cells = [cell for cell in split_cells(rows[0].text, separator)]
            hint = (
                "decimal commas need semicolons or tabs between the columns"
                if separator == "," and n == 2 * len(cells)
                else "give every column a name and every row the same columns"
            )
            raise file.error(
                f"row {rows[0].row} names {len(cells)} columns, but row {rows[1].row} has {n} "
                f"cells separated by {SEPARATOR_NAMES[separator]}; {hint}"
            )
        for line in reversed(comments):
            if line.row < rows[first].row:
                cells = _fit_header(split_cells(line.text.lstrip("#%/ \t"), separator), kinds)
                if len(cells) == n and all(cells) and not any(is_number(c) for c in cells):
                    return cells, [], first
                break
        return None, [], first
    names = candidates[names_at][1]
    units = [""] * n
    for _, cells in candidates[:names_at]:
        if _unit_share(cells) > 0:
            units = [_bare(cell) for cell in cells]
    return names, units, broken


def _cells_above(line: str, separator: str, n: int) -> list[str]:
    cells = split_cells(line, separator)
    if separator == " " and len(cells) != n:
        apart = re.split(r"\s{2,}|\t", line.strip())
        if len(apart) == n:
            return apart
    return cells


def _fit_header(cells: list[str], kinds: tuple[str, ...]) -> list[str]:
    """The cells of a header, matched to the columns where a separator more or less stands."""
    n = len(kinds)
    while len(cells) > n and cells[-1] == "":
        cells = cells[:-1]
    if len(cells) == n + 1 and cells[-1].casefold() == "comment":
        return cells[:-1]  # LabVIEW's, empty but for the first row
    if len(cells) == n - 1 and kinds[0] == "":
        return ["", *cells]  # a separator in front of each row
    if len(cells) == n - 1 and kinds[-1] == "" and n > 2:
        return [*cells, ""]
    return cells


def _brackets(cells: Sequence[str]) -> bool:
    inner = [re.fullmatch(r"[(\[]\s*(.*?)\s*[)\]]", cell) for cell in cells]
    return bool(cells) and all(inner) and any(known_unit(m[1]) for m in inner if m)


def _bare(cell: str) -> str:
    inner = re.fullmatch(r"[(\[]\s*(.*?)\s*[)\]]", cell)
    if inner:
        return f"({inner[1]})" if inner[1] and not known_unit(inner[1]) else inner[1]
    return cell if cell and known_unit(cell) else ""


def _unit_share(cells: Sequence[str]) -> float:
    """Share of the cells with text that are units."""
    filled = [cell for cell in cells if cell]
    units = [c for c in filled if re.fullmatch(r"[(\[].*[)\]]", c) or known_unit(c)]
    return len(units) / len(filled) if filled else 0.0


def _names_row(candidates: Sequence[tuple[int, list[str]]]) -> int | None:
    """Which of the rows above the samples, the nearest first, holds the names."""
    fits = []
    for k, (_, cells) in enumerate(candidates):
        filled = [cell for cell in cells if cell]
        if not filled or {cell.casefold() for cell in filled} <= _PROCESSING:
            continue
        if len(filled) < len(cells) - 2 and len(filled) < len(cells) / 2:
            continue
        if all(is_number(cell) for cell in filled):
            continue
        below_units = any(_unit_share(c) >= 0.5 for _, c in candidates[:k])
        if any(is_number(cell) for cell in filled) and not (
            below_units or _has_time(cells) or len(cells) > 2
        ):
            continue
        fits.append(k)
    if not fits:
        return None
    for k in fits:
        cells = candidates[k][1]
        above = next((j for j in fits if j > k), None)
        if _unit_share(cells) >= 0.5 and (above is not None or _brackets(cells)):
            if above is not None and not (_has_time(cells) and not _has_time(candidates[above][1])):
                continue
            if _brackets(cells):
                continue
        if above is not None and _unit_share(cells) > _unit_share(candidates[above][1]):
            if _has_time(candidates[above][1]) and candidates[above][0] == candidates[k][0] - 1:
                continue
        return k
    return fits[-1]


def _has_time(cells: Sequence[str]) -> bool:
    return any(is_time(split_name(cell)) for cell in cells) or cells[0].casefold() in (
        "x",
        "x-axis",
        "x_value",
        "scan",
    )


def _columns(
    file: DataFile, names: list[str] | None, units: list[str], n: int, row: int
) -> tuple[Column, ...]:
    if names is None:
        return tuple(Column(f"column {i}", f"column {i}") for i in range(1, n + 1))
    columns = []
    for i, name in enumerate(names):
        column = split_name(name)
        unit = units[i] if i < len(units) else ""
        if unit.startswith("("):
            raise file.error(
                f"row {row - 1}: the unit '{unit[1:-1][:40]}' of column '{name.strip()[:60]}' "
                "is not known; write one such as (s), (ms), (V), (mV)"
            )
        columns.append(Column(name, column.base, unit) if unit else column)
    return tuple(columns)


# --------------------------------------------------------------------------- interval


def _key(text: str) -> str:
    return re.sub(r"[^a-z0-9]", "", re.sub(r"[(\[].*?[)\]]", "", text).casefold())


def _told(line: str) -> bool:
    """Whether a line says something about the measurement, as ``Model: X``."""
    return ":" in line or "=" in line or "***" in line


def _stated_interval(
    above: Sequence[_Line], body: Sequence[_Line], separator: str
) -> tuple[float | None, float]:
    """Interval and start in s, where a line above the samples or beside the first ones says it.

    A number stands behind its key in the same cell, in the next cell, or in the cell below.
    """
    table = [split_cells(line.text.lstrip("#%/ \t"), separator) for line in [*above, *body]]
    interval, start = None, 0.0
    for i, cells in enumerate(table):
        for j, cell in enumerate(cells):
            match = re.fullmatch(r"([^=:]{1,40}?)\s*[=:]\s*(.*)", cell)
            key = _key(match[1] if match else cell)
            if key not in _INTERVALS | _RATES | _STARTS:
                continue
            told = [match[2]] if match else cells[j + 1 : j + 2]
            if not match and i + 1 < len(table) and j < len(table[i + 1]):
                told.append(table[i + 1][j])
            brackets = re.search(r"[(\[]\s*(\S+?)\s*[)\]]", cell)
            value = next(
                (v for v in (_seconds(t, brackets, key) for t in told) if v is not None), None
            )
            if value is None:
                continue
            if key in _STARTS:
                start = value
            elif value > 0 and interval is None:
                interval = value
    return interval, start if interval is not None else 0.0


def _seconds(text: str, brackets: re.Match[str] | None, key: str) -> float | None:
    match = _TOLD.fullmatch(text.strip())
    if match is None:
        return None
    unit = match[2] or (brackets[1] if brackets else "")
    value = float(match[1])
    if key in _RATES:
        factor = {"": 1.0, "hz": 1.0, "khz": 1e3, "mhz": 1e6, "s/s": 1.0, "sa/s": 1.0}.get(
            unit.casefold()
        )
        return 1.0 / (value * factor) if factor and value > 0 else None
    if not unit:
        return value
    if not known_unit(unit):
        return None
    factor = conversion_factor(unit, "s")
    return None if factor is None else value * factor
