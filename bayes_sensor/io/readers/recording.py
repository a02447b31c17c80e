"""The result of a reader, and the choice and names of columns for all formats."""

from __future__ import annotations

import difflib
import hashlib
import re
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

from bayes_sensor.campaign import CampaignError, FloatArray
from bayes_sensor.io.readers.quantities import conversion_factor, known_unit

MAX_COLUMNS = 4096
"""columns, channels or variables in one file"""
MAX_SAMPLES = 20_000_000
"""samples of one experiment"""

_TIME_NAMES = frozenset(
    "t time times zeit temps tiempo tid hora heure uhrzeit timestamp timestamps tstamp elapsed "
    "second seconds sec secs millisecond milliseconds elapsedtime timeelapsed reltime relativetime "
    "timeaxis timeutc utctime utc unixtime epoch epochtime epochutc posixtime systemtime clock "
    "clocktime localtime datetime dateandtime datetimestamp localdatetime scantime testtime "
    "runtime ts".split()
)
DATE_NAMES = frozenset("date datum day fecha".split())
_SUFFIX_UNITS = frozenset(
    "s sec ms us µs μs ns min h V mV uV µV μV kV ppm ppb ohm kohm Mohm Ω kΩ "
    "mW uW µW μW nW pW mA uA µA μA nA pA percent % Pa kPa hPa mbar bar dB dBm degC degF "
    "°C °F".split()
)


@dataclass(frozen=True)
class DataFile:
    """A data file that was read into memory once, so that its hash belongs to the parsed
    content."""

    path: Path
    where: str
    """its name in messages, such as ``experiment '3' (exp3.csv)``"""
    content: bytes

    @cached_property
    def sha256(self) -> str:
        """Hash of the content, in hexadecimal."""
        return hashlib.sha256(self.content).hexdigest()

    def error(self, problem: str) -> CampaignError:
        """The error with the place and then the problem."""
        return CampaignError(f"{self.where}: {problem}")


@dataclass(frozen=True)
class Selection:
    """The columns the campaign asks for; None means the format's default."""

    signal: str | None = None
    drive: str | None = None
    time: str | None = None
    interval: float | None = None
    """s, for files without times"""


@dataclass(frozen=True)
class Clock:
    """The time of the first sample on the recorder's own clock."""

    ns: int
    """nanoseconds since 1970, or since midnight where no date is written"""
    dated: bool
    offset: int = 0
    """ns, its own offset from UTC, already subtracted"""


@dataclass(frozen=True, eq=False)
class Recording:
    """One experiment's samples as written in the file, time in seconds."""

    t: FloatArray
    """(n,) s, as written"""
    y: FloatArray
    """(n,) in ``unit``"""
    signal: str
    """name of the column y came from"""
    place: Callable[[int], str]
    """words for the place of sample i in the file, such as ``row 17``"""
    drive: FloatArray | None = None
    """(n,)"""
    drive_name: str = ""
    unit: str = ""
    """the unit the file gives for y; empty when it gives none"""
    interval: float | None = None
    """s, if the file states it instead of listing times"""
    clock: Clock | None = None
    """where the times are counted from the first sample of a clock"""
    timed: bool = False
    """whether the file says the unit of its times"""
    notes: tuple[str, ...] = ()
    """remarks of the reader, without the place"""
    channels: tuple[str, ...] = ()
    """what may be chosen as signal, as ``signal`` or ``drive`` may write it, in the file's order"""
    times: tuple[str, ...] = ()
    """what else may be chosen as ``time``; where a table has several, all of them"""


@dataclass(frozen=True)
class Column:
    """A column's name, split into base name and unit."""

    name: str
    base: str
    unit: str = ""


@contextmanager
def parser_errors(file: DataFile, what: str) -> Iterator[None]:
    """Turn any exception of a third-party parser into one message about the file.

    Parsers of binary files raise nearly any exception on damaged ones (struct, zlib, Unicode,
    index and memory errors among them), so here, and nowhere else, all are caught.
    """
    try:
        yield
    except CampaignError:
        raise
    except Exception as error:
        reason = " ".join(str(error).split())[:160] or type(error).__name__
        raise file.error(
            f"expected {what}, but it cannot be read as one ({reason}); it may be damaged, "
            "truncated or of another format: export it again"
        ) from None


def missing_extra(file: DataFile, suffix: str, extra: str) -> CampaignError:
    """The error for a format whose package is not installed."""
    return file.error(
        f"{suffix} files need an optional package that is not installed; "
        f"run: pip install 'bayes-sensor[{extra}]'"
    )


def split_name(name: str) -> Column:
    """The column's base name and unit.

    >>> split_name("time (ms)"), split_name("voltage_mV").unit
    (Column(name='time (ms)', base='time', unit='ms'), 'mV')
    """
    text = name.strip()
    match = re.fullmatch(r"(.*?)\s*[\(\[]\s*([^()\[\]]{1,40}?)\s*[\)\]]", text)
    if match:
        base, unit = match[1].strip(), match[2]
        a_channel = re.fullmatch(r"(?i)(channel|chan|ch|input|signal|ai)", base) and len(unit) == 1
        if not a_channel and known_unit(unit):
            return Column(name, base, unit)
        return Column(name, text)
    match = re.fullmatch(r"(?:(.*?)\s+)?in\s+(\S{1,12})", text)
    if match and known_unit(match[2]):
        return Column(name, match[1] or text, match[2])
    match = re.fullmatch(r"(.+?)(?:_|\s*/\s*|,\s+)([^\s_/,]{1,12})", text)
    if match and match[2] in _SUFFIX_UNITS:
        return Column(name, match[1].strip(), match[2])
    return Column(name, text)


def is_time(column: Column) -> bool:
    """Whether the column is time, by its name."""
    key = re.sub(r"[\s_\-&/#,]", "", column.base).casefold()
    return key in _TIME_NAMES and (not column.unit or seconds(column.unit) is not None)


def is_date_name(column: Column) -> bool:
    """Whether a column without a unit is called a date."""
    key = re.sub(r"[\s_\-&/#,]", "", column.base).casefold()
    return not column.unit and (
        key in DATE_NAMES or key in ("datetime", "timestamp", "serialdate", "exceltime")
    )


def seconds(unit: str) -> float | None:
    """Seconds in one ``unit``; None where it is not a time."""
    if not unit:
        return 1.0
    return conversion_factor(unit, "s")


def find_column(file: DataFile, columns: Sequence[Column], wanted: str, key: str) -> int:
    """Position of the column the campaign names.

    Tried in turn: the name as written, the name ignoring case, the name without its unit,
    PicoScope's ``Channel A`` for ``A``, and ``column 3`` for the third.
    """
    folded = wanted.strip().casefold()
    tests: tuple[Callable[[Column], bool], ...] = (
        lambda column: column.name == wanted,
        lambda column: column.name.strip().casefold() == folded,
        lambda column: column.base.casefold() == folded,
        lambda column: column.base.casefold() == f"channel {folded}",
    )
    for test in tests:
        hits = [i for i, column in enumerate(columns) if test(column)]
        if len(hits) == 1:
            return hits[0]
        if hits:
            full = [columns[i].name.strip() for i in hits]
            fix = "give each column its own name"
            if len(set(full)) == len(full):
                fix = f"write it in full: {list_names(full, 6)}"
            raise file.error(f'{key} = "{wanted}" fits {len(hits)} columns of that name; {fix}')
    place = re.fullmatch(r"column (\d{1,4})", folded)
    if place and 1 <= int(place[1]) <= len(columns):
        return int(place[1]) - 1
    names = [column.name.strip() for column in columns]
    close = difflib.get_close_matches(wanted, names, n=1, cutoff=0.6)
    hint = f' (did you mean "{close[0]}"?)' if close else ""
    raise file.error(
        f'{key} = "{wanted}" is not in the file{hint}; it has {list_names(names)}; '
        f"set {key} to one of them"
    )


def check_chosen(
    file: DataFile,
    names: Sequence[str],
    time: int | None,
    signal: int,
    drive: int | None,
    fix: str = "which is the time; choose another",
) -> None:
    """Raise CampaignError if signal or drive is the time, or both are the same column."""
    for key, chosen in (("signal", signal), ("drive", drive)):
        if chosen is not None and chosen == time:
            raise file.error(f"{key} is '{names[chosen][:60]}', {fix}")
    if drive == signal:
        raise file.error(
            f"signal and drive are both '{names[signal][:60]}'; expected two columns: set signal "
            "to the sensor's and drive to the valve's"
        )


def time_place(file: DataFile, columns: Sequence[Column], selection: Selection) -> int | None:
    """Position of the vector of times: the one asked for, else the first that is called time.

    None where the campaign gives the interval.
    """
    if selection.time is not None:
        if selection.interval is not None:
            raise file.error(
                f"time = '{selection.time}' and interval are both given; expected one of them, as "
                "interval is for files without times: remove one"
            )
        return find_column(file, columns, selection.time, "time")
    if selection.interval is not None:
        return None
    return next((i for i, column in enumerate(columns) if is_time(column)), None)


def scale_time(file: DataFile, column: Column, t: FloatArray) -> FloatArray:
    """The times in seconds."""
    second = seconds(column.unit)
    if second is None:
        raise file.error(
            f"column '{column.name.strip()[:60]}' should be time, but its unit is "
            f"'{column.unit}'; put time (in s, ms, ...) into the first column"
        )
    per_second = round(1.0 / second) if second < 1 else 0
    if per_second and abs(per_second * second - 1) < 1e-9:
        # dividing by 1000 rounds once and gives the nearest float to 12 ms; times 0.001 does not
        return t / per_second
    return t * second


def list_names(names: Sequence[str], most: int = 12) -> str:
    """The names in quotes, the first few of them."""
    shown = ", ".join(f"'{name[:60]}'" for name in names[:most])
    return shown + (f" and {len(names) - most} more" if len(names) > most else "")


def channel_names(names: Sequence[str], chosen: Sequence[int]) -> tuple[str, ...]:
    """The chosen of all columns, each by its name where that is its own, else by its place.

    >>> channel_names(["t", "A", "A", ""], [1, 2, 3])
    ('column 2', 'column 3', 'column 4')
    """
    shown = [name.strip() for name in names]
    return tuple(
        shown[i] if shown[i] and shown.count(shown[i]) == 1 else f"column {i + 1}" for i in chosen
    )


def several_times(names: Sequence[str], chosen: Sequence[int]) -> tuple[str, ...]:
    """The columns of times as ``time`` may write them, where there are several."""
    return channel_names(names, chosen) if len(chosen) > 1 else ()


def check_counts(file: DataFile, n_columns: int, n_samples: int = 0) -> None:
    """Raise CampaignError if the file is too large for one experiment."""
    if n_columns > MAX_COLUMNS:
        raise file.error(
            f"expected at most {MAX_COLUMNS} columns, but it has {n_columns}; "
            "export only time, signal and drive"
        )
    if n_samples > MAX_SAMPLES:
        raise file.error(
            f"expected at most {MAX_SAMPLES} samples, but it has {n_samples}; "
            "record shorter or average"
        )
