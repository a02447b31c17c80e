"""Which column is the time, which the signal: by name, unit and content, for every format."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from bayes_sensor.campaign import FloatArray
from bayes_sensor.io.readers.quantities import conversion_factor
from bayes_sensor.io.readers.recording import (
    DATE_NAMES,
    Column,
    DataFile,
    Selection,
    check_chosen,
    find_column,
    is_time,
    list_names,
    seconds,
)
from bayes_sensor.io.readers.stamps import epoch_unit, read_stamps

_COUNTERS = frozenset(
    "# no no. nr nr. number record rn sample samples index idx scan point points count counter row "
    "sequence sequencenumber seq id line measurement reading n unnamed:0 nummer "
    "番号".split()
)
_FRACTIONS = frozenset("ms msec millis millisecond milliseconds milli".split())
_SET_POINT = re.compile(
    r"(?i)(?:^|[^a-z])(?:set|setpoint|set point|set value|sp|target|command|commanded|demand|soll|"
    r"sollwert|nominal)(?:$|[^a-z])"
)
_ERROR = re.compile(r"(?i)(?:^|[^a-z])(?:err|error|sd|std|stdev|uncertainty|se)(?:$|[^a-z])")
MOSTLY = 0.9
"""share of the steps that must be forward in a column taken as time without its name"""


@dataclass(frozen=True)
class Facts:
    """What is known of a column before it is read in full."""

    column: Column
    kind: str
    """``number``, ``stamp``, ``date``, ``text``, or empty where nothing is in it"""
    values: FloatArray
    """the numbers among some of its cells"""
    cells: Sequence[str] = ()
    """those cells, where they are text"""


@dataclass(frozen=True)
class Roles:
    """Positions of the columns to read."""

    times: tuple[int, ...]
    """candidates, the best first; empty where the interval gives the times"""
    signal: int
    drive: int | None
    date: int | None = None
    """the dates of the times, where they stand in a column of their own"""
    fraction: int | None = None
    """the milliseconds of the times, likewise"""
    notes: tuple[str, ...] = field(default=())
    channels: tuple[int, ...] = ()
    """columns of numbers that are no time and no counter"""


def choose_roles(
    file: DataFile,
    facts: Sequence[Facts],
    selection: Selection,
    stated: float | None = None,
    named: bool = True,
) -> Roles:
    """The columns to read.

    Parameters
    ----------
    facts
        The columns.
    selection
        What the campaign asks for.
    stated
        s, the sampling interval that the file states, if it does.
    named
        Whether the file names its columns.

    Raises
    ------
    CampaignError
        If a column that is asked for is missing, or no signal or no time is left.
    """
    columns = [fact.column for fact in facts]
    names = [column.name.strip() or f"column {i}" for i, column in enumerate(columns, 1)]
    notes: list[str] = []
    first = next((i for i, fact in enumerate(facts) if fact.kind == "number"), 0)
    scores = [_time_score(fact, i == first, named) for i, fact in enumerate(facts)]
    ranked = sorted((i for i in range(len(facts)) if scores[i] > 0), key=lambda i: -scores[i])
    date = next((i for i, f in enumerate(facts) if f.kind == "date"), None)
    fraction = _fraction_column(facts, ranked)
    clocks = {i for i in range(len(facts)) if scores[i] >= 45}
    clocks |= {i for i in (date, fraction) if i is not None}
    counters = {i for i, fact in enumerate(facts) if _counts(fact, i == first, named)}
    times: tuple[int, ...] = ()
    if selection.time is not None:
        times = (find_column(file, columns, selection.time, "time"),)
        if selection.interval is not None:
            raise file.error(
                f"time = '{selection.time}' and interval are both given; expected one of them, as "
                "interval is for files without times: remove one"
            )
    elif selection.interval is not None:
        if clocks & set(ranked):
            best = next(i for i in ranked if i in clocks)
            _check_interval(file, facts[best], names[best], selection.interval)
            notes.append(f"interval was used, not the times in column '{names[best][:60]}'")
    else:
        strong = tuple(i for i in ranked if i in clocks)
        weak = tuple(i for i in ranked if i not in clocks)
        if stated is not None:
            weak = tuple(i for i in weak if _steps_by(facts[i].values, stated))
        times = strong or weak
        if not times and stated is not None:
            notes.append(f"times were counted by the interval that the file states, {stated:.6g} s")
    fraction = fraction if times and facts[times[0]].kind == "stamp" else None
    taken = clocks | counters | set(times[:1])
    signal = (
        find_column(file, columns, selection.signal, "signal")
        if selection.signal is not None
        else _default_signal(file, facts, names, taken, notes, selection.drive)
    )
    if selection.time is None and selection.interval is None and not times and stated is None:
        raise _no_time(file, facts, names, counters)
    times = tuple(i for i in times if i != signal or len(times) == 1)
    drive = None
    if selection.drive is not None:
        drive = find_column(file, columns, selection.drive, "drive")
    others = [name for i, name in enumerate(names) if i not in taken]
    fix = f"which is the time column; choose one of {list_names(others)}"
    time = times[0] if times else None
    check_chosen(file, names, time, signal, drive, fix)
    numbers = (i for i, fact in enumerate(facts) if fact.kind == "number")
    channels = tuple(i for i in numbers if i == signal or i not in taken)
    return Roles(times, signal, drive, date, fraction, tuple(notes), channels)


def _check_interval(file: DataFile, fact: Facts, name: str, interval: float) -> None:
    """Raise CampaignError where a column of times says another interval than the campaign."""
    if fact.kind == "stamp":
        stamps = read_stamps(fact.cells) if len(fact.cells) else 0
        t = np.empty(0) if isinstance(stamps, int) else stamps.ns / 1e9
    else:
        known = epoch_unit(float(np.median(fact.values))) if len(fact.values) else None
        second = seconds(fact.column.unit) if fact.column.unit else known[1] if known else 1.0
        t = fact.values * (second or 1.0)
    step = np.diff(t)
    if not len(step) or not bool((step > 0).all()):
        return  # too coarse, which is why the interval is given
    usual = float(np.median(step))
    if abs(usual / interval - 1) > 0.1:
        raise file.error(
            f"interval = {interval:.6g} s, but the times in column '{name[:60]}' are {usual:.6g} s "
            "apart; expected both to agree, as interval is for files without times: remove interval"
        )


def _time_score(fact: Facts, first: bool, named: bool) -> int:
    """How much a column looks like the time; 0 where it does not."""
    column, values = fact.column, fact.values
    key = re.sub(r"[\s_\-&.]", "", column.base).casefold()
    if fact.kind == "stamp":
        return 85 if is_time(column) else 60
    if fact.kind != "number":
        return 0
    second = seconds(column.unit) if column.unit else None
    if column.unit and second is None:
        return 0
    if is_time(column):
        return 80
    if not _rises(values):
        return 0
    if len(values) and epoch_unit(float(np.median(values))) is not None:
        return 70
    if second is not None:
        return 65
    if key in ("x", "xvalue", "xaxis") or key.startswith(("time", "zeit")) or key.endswith("time"):
        return 50
    if key in DATE_NAMES or key in ("datetime", "datenum"):
        return 48
    if not first or (named and _counts(fact, first, named)):
        return 0
    return 40


def _rises(values: FloatArray) -> bool:
    step = np.diff(values)
    return len(step) > 0 and float((step > 0).mean()) >= MOSTLY


def _steps_by(values: FloatArray, interval: float) -> bool:
    return len(values) > 1 and abs(float(np.median(np.diff(values))) / interval - 1) < 1e-3


def _counts(fact: Facts, first: bool, named: bool) -> bool:
    """Whether a column numbers the samples."""
    key = re.sub(r"[\s_\-]", "", fact.column.base).casefold()
    values = fact.values
    whole = fact.kind == "number" and len(values) > 2 and bool((values == np.rint(values)).all())
    if not whole or not _rises(values):
        return False
    steps = np.diff(values)
    even = bool((steps == steps[0]).all())
    if key in _COUNTERS or (named and first and key == ""):
        return True
    return key == "x" and even and steps[0] == 1


def _fraction_column(facts: Sequence[Facts], ranked: Sequence[int]) -> int | None:
    """The column of milliseconds beside a stamp without a fraction."""
    for i in ranked:
        if facts[i].kind != "stamp" or i + 1 >= len(facts):
            continue
        beside = facts[i + 1]
        key = re.sub(r"[\s_\-.]", "", beside.column.base).casefold()
        v = beside.values
        if beside.kind != "number" or not len(v) or not _are_milliseconds(v):
            continue
        padded = beside.cells and all(
            len(cell.strip()) == 3 for cell in beside.cells if cell.strip()
        )
        if (
            key in _FRACTIONS
            or (beside.column.unit == "ms" and not is_time(beside.column))
            or padded
        ):
            return i + 1
    return None


def _are_milliseconds(values: FloatArray) -> bool:
    return bool(((values == np.rint(values)) & (values >= 0) & (values < 1000)).all())


def _default_signal(
    file: DataFile,
    facts: Sequence[Facts],
    names: Sequence[str],
    taken: set[int],
    notes: list[str],
    drive: str | None,
) -> int:
    """The first measurement: not a time, not a counter, not a set point where there is another."""
    numbers = [i for i, fact in enumerate(facts) if fact.kind == "number" and i not in taken]
    if not numbers:
        others = [i for i in range(len(facts)) if i not in taken]
        if others and len(facts) > 1:  # text, or nothing at all: what it holds is told later
            return next((i for i in others if facts[i].kind), others[0])
        raise file.error(
            f"expected a time column and a signal column, but there is only {list_names(names)}; "
            'export both, in columns of their own, or write interval = "1 ms" for samples without '
            "times"
        )
    measured = [i for i in numbers if not is_set_point(facts[i].column.name)]
    if drive is not None and len(measured) > 1:
        folded = drive.strip().casefold()
        measured = [i for i in measured if names[i].casefold() != folded] or measured
    if not measured:
        notes.append(
            f"'{names[numbers[0]][:60]}' was taken as the signal, but looks like a set point; "
            "name the measured column in signal"
        )
        return numbers[0]
    if measured[0] != numbers[0]:
        notes.append(
            f"'{names[measured[0]][:60]}' was taken as the signal, as "
            f"'{names[numbers[0]][:60]}' looks like a set point or its error; set signal to choose"
        )
    elif len(measured) > 1 and len(measured) < len(numbers):
        notes.append(
            f"'{names[measured[0]][:60]}' was taken as the signal, the first of "
            f"{list_names([names[i] for i in measured], 6)}; set signal to choose"
        )
    return measured[0]


def is_set_point(name: str) -> bool:
    """Whether a column is called a set point, or the error of a value.

    >>> is_set_point("MFC_target"), is_set_point("flow_carrier_error"), is_set_point("offset")
    (True, True, False)
    """
    spaced = re.sub(r"(?<=[a-z])(?=[A-Z])", " ", name)
    return bool(_SET_POINT.search(spaced) or _ERROR.search(spaced))


def _no_time(
    file: DataFile, facts: Sequence[Facts], names: Sequence[str], counters: set[int]
) -> Exception:
    """The error for a file without times."""
    first = facts[0].column
    if counters:
        found = f"column '{names[min(counters)][:60]}' only counts the samples"
    elif first.unit and conversion_factor(first.unit, "s") is None:
        found = f"the first column '{names[0][:60]}' should be time, but its unit is '{first.unit}'"
    else:
        found = f"the columns are {list_names(names)}, and none of them rises throughout"
    return file.error(
        f'there is no time column: {found}; write interval = "1 ms" (the recorder\'s sampling '
        "interval), or time = the name of the column of times"
    )
