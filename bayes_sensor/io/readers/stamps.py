"""Times as recorders write them: dates, times of day, compact stamps, seconds since an epoch.

Everything is counted in whole nanoseconds, so that differences of long numbers lose no digit.
Dates count from 1970, times of day from midnight; an offset from UTC is subtracted.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass
from datetime import date
from functools import cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from bayes_sensor.campaign import FloatArray

IntArray = NDArray[np.int64]

DAY, _HOUR, _MINUTE, _SECOND = 86_400_000_000_000, 3_600_000_000_000, 60_000_000_000, 1_000_000_000
_MONTHS = ("jan", "feb", "mar", "apr", "may", "jun", "jul", "aug", "sep", "oct", "nov", "dec")

_DATE = (
    r"(?P<date>\d{4}[-/.]\d{1,2}[-/.]\d{1,2}"  # 2024-03-05
    r"|\d{1,2}[-/.]\d{1,2}[-/.](?:\d{4}|\d{2})"  # 5.3.2024, 3/5/24
    r"|\d{1,2}[- ][A-Za-z]{3,9}[- ,]{1,2}(?:\d{4}|\d{2})"  # 05-Mar-2024
    r"|[A-Za-z]{3,9}[ .]{1,2}\d{1,2},? {1,2}\d{4})"  # Mar 5, 2024
)
_TIME = (
    r"(?:(?:(?P<days>\d{1,5}) days?,? +|(?P<dotted>\d{1,5})\.(?=\d\d:\d\d:))?(?P<h>\d{1,5}):)?"
    r"(?P<m>\d{1,2}):(?P<s>\d{2})(?:[.,:](?P<f>\d{1,12}))?"
    r"(?:\s*(?P<half>[AaPp])\.?[Mm]\.?)?"
)
_OFFSET = r"(?:\s*(?P<off>Z|UTC|GMT|[+-]\d{2}(?::?\d{2})?))?"
_WRITTEN = re.compile(rf"\[?\s*(?:{_DATE}(?:[ T_,]\s*|\s+at\s+))?{_TIME}{_OFFSET}\s*\]?")
_ONLY_DATE = re.compile(rf"{_DATE}")
_COMPACT = re.compile(
    r"(?P<date>(?:19|20)\d{2}(?:0[1-9]|1[0-2])(?:0[1-9]|[12]\d|3[01]))[ T_-]?"
    r"(?P<h>[01]\d|2[0-3])(?P<m>[0-5]\d)(?P<s>[0-5]\d)(?:[.,]?(?P<f>\d{1,9}))?"
    rf"{_OFFSET}"
)

EPOCH_UNITS = (("s", 1.0, 3e8, 1e10), ("ms", 1e-3, 3e11, 1e13), ("us", 1e-6, 3e14, 1e16),
               ("ns", 1e-9, 3e17, 1e19))  # fmt: skip
"""unit, seconds, and the range in which a number is taken as the time since 1970 (1979 to 2286)"""


@dataclass(frozen=True)
class Stamps:
    """Written times in nanoseconds."""

    ns: IntArray
    """(n,) since 1970, or since the midnight before the first sample"""
    dated: bool
    offset: int = 0
    """ns, the first sample's own offset from UTC, already subtracted"""
    whole: bool = False
    """whether no fraction of a second is written"""
    relabelled: int | None = None
    """the first sample at which the offset from UTC changes although the time of day goes on"""


@dataclass(frozen=True)
class Moment:
    """One time on a recorder's clock, as written in a campaign file."""

    ns: int
    dated: bool
    zoned: bool
    """whether it states its offset from UTC"""
    text: str


def is_stamp(cell: str) -> bool:
    """Whether the text is a time of day, a date with a time, or a compact stamp.

    >>> is_stamp("12:00:00.5 PM"), is_stamp("20240305_090000"), is_stamp("1.5")
    (True, True, False)
    """
    return _match(cell.strip()) is not None


def is_date(cell: str) -> bool:
    """Whether the text is a date without a time.

    >>> is_date("2024-03-05"), is_date("2024-03-05 09:00")
    (True, False)
    """
    return _ONLY_DATE.fullmatch(cell.strip()) is not None


def _match(text: str) -> re.Match[str] | None:
    return _WRITTEN.fullmatch(text) or _COMPACT.fullmatch(text)


def read_moment(text: str) -> Moment | None:
    """The time of a text such as ``09:00:39`` or ``2024-03-05 09:00:39``; None where it is none.

    >>> read_moment("00:00:01.5").ns
    1500000000
    """
    stamps = read_stamps([text])
    if not isinstance(stamps, Stamps):
        return None
    match = _match(text.strip())
    zoned = bool(match is not None and match["off"])
    return Moment(int(stamps.ns[0]), stamps.dated, zoned, text.strip())


def read_stamps(cells: Sequence[Any], dates: Sequence[Any] | None = None) -> Stamps | int:
    """The times of written cells, or the place of the first that is not understood.

    Parameters
    ----------
    cells
        (n,) texts.
    dates
        (n,) texts with the dates, where they stand in a column of their own.
    """
    import pandas as pd  # slow to import

    texts = pd.Series(cells, dtype="object").astype(str).str.strip()
    compact = _COMPACT.fullmatch(texts.iloc[0]) is not None
    pattern = _COMPACT if compact else _WRITTEN
    parts = texts.str.extract(f"^(?:{pattern.pattern})$")
    wrong = parts["m"].isna().to_numpy()
    if wrong.any():
        return int(np.argmax(wrong))
    fraction = parts["f"].fillna("")
    ns = pd.to_numeric(fraction.str.slice(0, 9).str.ljust(9, "0")).to_numpy(np.int64)
    written = parts["date"].notna().to_numpy()
    minute, second = _whole(parts["m"]), _whole(parts["s"])
    hour_given = parts["h"].notna().to_numpy()
    # 9:55 after a date is hours and minutes, without one minutes and seconds past the hour
    short = written & ~hour_given
    hour = np.where(short, minute, _whole(parts["h"]))
    minute, second = np.where(short, second, minute), np.where(short, 0, second)
    if not compact:
        half = parts["half"].str.casefold()
        hour = np.where(half.notna(), hour % 12, hour) + np.where(half == "p", 12, 0)
        hour = hour + 24 * (_whole(parts["days"]) + _whole(parts["dotted"]))
    ns = ns + hour * _HOUR + minute * _MINUTE + second * _SECOND
    day_texts = None
    if written.any():
        if not written.all():
            return int(np.argmax(~written))
        day_texts = parts["date"]
    elif dates is not None:
        day_texts = pd.Series(dates, dtype="object").astype(str).str.strip()
    whole = bool((fraction.str.strip("0") == "").all())
    if day_texts is not None:
        codes, unique = pd.factorize(day_texts)
        days = _day_numbers([str(text) for text in unique], codes)
        if isinstance(days, int):
            return int(np.argmax(codes == days))
        ns = ns + days[codes] * DAY
        offsets = _offsets(parts["off"])
        return _zoned(ns, offsets, True, whole)
    period = DAY if hour_given.any() else _HOUR
    ns[1:] += period * np.cumsum(np.diff(ns) < -period // 2)
    return _zoned(ns, _offsets(parts["off"]), False, whole)


def _zoned(local: IntArray, offsets: IntArray, dated: bool, whole: bool) -> Stamps:
    """The times less their offsets from UTC.

    Where an offset changes and the time of day goes on as if nothing had happened, the offset is a
    label that was wrong before or after, and the elapsed time is that of the time of day.
    """
    first = int(offsets[0])
    ns = local - offsets
    changes = np.flatnonzero(np.diff(offsets)) + 1
    if len(changes):
        usual = np.median(np.diff(local))
        step, true_step = np.diff(local)[changes - 1], np.diff(ns)[changes - 1]
        if bool(((np.abs(step - usual) < np.abs(true_step - usual)) & (step > 0)).all()):
            return Stamps(local - first, dated, first, whole, int(changes[0]))
    return Stamps(ns, dated, first, whole)


def _whole(column: Any) -> IntArray:
    import pandas as pd  # slow to import

    return np.asarray(pd.to_numeric(column).fillna(0).to_numpy(dtype=np.int64))


def _offsets(column: Any) -> IntArray:
    import pandas as pd  # slow to import

    codes, unique = pd.factorize(column)
    known = np.array([_offset(str(text)) for text in unique] + [0], dtype=np.int64)
    return np.asarray(known[codes])  # code -1, the last entry: none written


def _offset(text: str) -> int:
    if text[:1] not in "+-":
        return 0
    digits = text[1:].replace(":", "").ljust(4, "0")
    size = int(digits[:2]) * _HOUR + int(digits[2:4]) * _MINUTE
    return -size if text[0] == "-" else size


def _day_numbers(texts: list[str], codes: IntArray) -> IntArray | int:
    """(n_unique,) days since 1970, or the place of a text that is no date.

    Whether 3/5/24 is in March, in May or in 2003 is settled by a number that no month or day has,
    else by the order in which the shortest time passes.
    """
    found: list[IntArray] = []
    wrong = 0
    for order in ("dmy", "mdy", "ymd") if "." in texts[0] else ("mdy", "dmy", "ymd"):
        numbers = []
        for i, text in enumerate(texts):
            number = _day_number(text, order)
            if number is None:
                wrong = i
                break
            numbers.append(number)
        else:
            found.append(np.array(numbers, dtype=np.int64))
    if not found:
        return wrong
    return min(found, key=lambda days: int(np.abs(np.diff(days[codes])).sum()))


@cache
def _day_number(text: str, order: str) -> int | None:
    try:
        if re.fullmatch(r"\d{8}", text):
            parts = [int(text[:4]), int(text[4:6]), int(text[6:])]
        elif re.search(r"[A-Za-z]", text):
            fields = re.findall(r"[A-Za-z]+|\d+", text)
            word = next(f for f in fields if f.isalpha())
            numbers = [int(f) for f in fields if f.isdigit()]
            parts = [numbers[1], _MONTHS.index(word[:3].casefold()) + 1, numbers[0]]
        else:
            parts = [int(part) for part in re.split(r"[-/.]", text)]
            if parts[0] < 1000:
                parts = [parts[order.index(each)] for each in "ymd"]
        year = parts[0] + 2000 if parts[0] < 100 else parts[0]
        return date(year, parts[1], parts[2]).toordinal() - date(1970, 1, 1).toordinal()
    except (ValueError, IndexError, StopIteration):
        return None


# --------------------------------------------------------------------------- numbers


def epoch_unit(value: float) -> tuple[str, float] | None:
    """Unit, by magnitude, of a number that counts from 1970, and its seconds; None for others.

    >>> epoch_unit(1.7e12), epoch_unit(24.0)
    (('ms', 0.001), None)
    """
    for unit, second, low, high in EPOCH_UNITS:
        if low <= abs(value) < high:
            return unit, second
    return None


def is_compact_number(cell: str) -> bool:
    """Whether a number of 14 or more digits is a date and a time.

    >>> is_compact_number("20240305090000"), is_compact_number("1700000000000")
    (True, False)
    """
    return _COMPACT.fullmatch(cell.strip()) is not None


LATEST_EPOCH = 9.2e9
"""s; the last time since 1970 that whole nanoseconds can count"""


def read_long_numbers(
    cells: Sequence[Any], second: float
) -> tuple[IntArray | None, FloatArray] | int:
    """Whole nanoseconds of long numbers in a unit of ``second`` seconds, and the numbers.

    Floats would round the last digits, so whole numbers and fractions are read apart.  There are no
    nanoseconds where a number is beyond :data:`LATEST_EPOCH`.  The place of the first cell that is
    no number is returned where there is one.
    """
    import pandas as pd  # slow to import

    texts = pd.Series(cells, dtype="object").astype(str).str.strip().str.replace(",", ".")
    numbers = pd.to_numeric(texts, errors="coerce").to_numpy(dtype=np.float64)
    plain = texts.str.fullmatch(r"[+-]?\d{1,19}(?:\.\d*)?").to_numpy(dtype=bool)
    if not np.isfinite(numbers).all():
        return int(np.argmin(np.isfinite(numbers)))
    per = round(second * 1e9)
    if not np.abs(numbers).max() * second < LATEST_EPOCH:
        return None, numbers
    if not plain.all():
        return np.rint(numbers * per).astype(np.int64), numbers
    parts = texts.str.partition(".")
    whole = parts[0].astype("int64").to_numpy()
    fraction = pd.to_numeric("0." + parts[2].replace("", "0")).to_numpy(dtype=np.float64)
    sign = np.where(parts[0].str.startswith("-"), -1, 1)
    return whole * per + sign * np.rint(fraction * per).astype(np.int64), numbers
