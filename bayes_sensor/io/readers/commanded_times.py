"""Commanded times, from the campaign and from the recorded drive, checked with the record."""

from __future__ import annotations

from dataclasses import dataclass
from datetime import datetime, timedelta

from bayes_sensor.campaign import CampaignError, Commands, FloatArray
from bayes_sensor.io.readers.campaign_file import ExperimentTable
from bayes_sensor.io.readers.commanded_programme import (
    check_keys,
    commands_of_edges,
    commands_of_entry,
    single,
)
from bayes_sensor.io.readers.drive import drive_edges
from bayes_sensor.io.readers.recording import Clock, DataFile, Recording
from bayes_sensor.io.readers.sampling import FIRST_EPOCH
from bayes_sensor.io.readers.stamps import DAY, Moment

DISAGREEMENT = 0.05
"""s between commanded time and drive edge from which a warning is given"""


@dataclass(frozen=True)
class EntryTimes:
    """The times of an entry, in s on the record's own axis."""

    on: float | None
    off: float | None
    keep: tuple[float, float] | None
    mask: tuple[tuple[float, float], ...]
    commands: Commands | None = None
    """where it is more than one pulse"""


def times_of_entry(entry: ExperimentTable, where: str, clock: Clock | None) -> EntryTimes:
    """The entry's times on the record's own axis.

    A time of day or a date in the campaign file is a place on the recorder's clock; so is a number
    of seconds since 1970 where the file has those.
    """

    def seconds(value: float | Moment, key: str) -> float:
        if isinstance(value, float | int):
            since = float(value) - clock.ns / 1e9 if clock is not None and clock.dated else 0.0
            return float(round(since, 9)) if abs(value) >= FIRST_EPOCH and since else float(value)
        if clock is None:
            raise CampaignError(
                f"{where}: {key} is the time of day '{value.text}', but the record's times are "
                "no times of day; expected a time on the record's own axis: write it in s"
            )
        start = clock.ns if value.zoned else clock.ns + clock.offset
        if value.dated and not clock.dated:
            raise CampaignError(
                f"{where}: {key} is '{value.text}', but the record's times have no date; expected "
                f"a time of day: write '{value.text.split()[-1]}'"
            )
        if value.dated:
            return (value.ns - start) / 1e9
        # the first such time of day that is not long before the record
        return (value.ns - start + DAY // 2) % DAY / 1e9 - DAY / 2e9

    def pair(value: tuple[float | Moment, float | Moment], key: str) -> tuple[float, float]:
        start, end = seconds(value[0], key), seconds(value[1], key)
        if not start < end:
            raise CampaignError(
                f"{where}: {key}: expected the start before the end, but got {start:.10g} s and "
                f"{end:.10g} s; swap them"
            )
        return start, end

    check_keys(entry, where)
    commands = commands_of_entry(entry, where, seconds)
    on, off = single(entry.commanded_on), single(entry.commanded_off)
    if commands is not None:
        on = off = None
    return EntryTimes(
        None if on is None else seconds(on, "commanded_on"),
        None if off is None else seconds(off, "commanded_off"),
        None if entry.keep is None else pair(entry.keep, "keep"),
        tuple(pair(part, "mask") for part in entry.mask),
        commands,
    )


def drive_commands(
    entry: ExperimentTable,
    told: EntryTimes,
    file: DataFile,
    recording: Recording,
    t: FloatArray,
    drive: FloatArray | None,
    notes: list[str],
) -> tuple[float | None, float | None, Commands | None]:
    """Times of a drive's one pulse, or its programme."""
    if drive is None:
        return None, None, None
    name = recording.drive_name
    try:
        times, high = drive_edges(t, drive, lambda text: file.error(f"drive '{name}': {text}"))
    except CampaignError as error:
        if told.on is None and told.commands is None:
            raise
        notes.append(f"{error} (commanded_on is given, so the drive was not used)")
        return None, None, None
    commands = commands_of_edges(times, high, entry, file.where)
    if high:
        notes.append(
            f"{file.where}: the drive '{name}' starts high and first falls at {times[0]:.10g} s, "
            "so that the record begins with the gas on; if the drive is inverted, the step "
            "has the other sign"
        )
    if commands is None:
        return times[0], times[1] if len(times) == 2 else None, None
    if told.on is not None or told.commands is not None:
        notes.append(
            f"{file.where}: the drive '{name}' has {len(times)} edges; commanded_on is given, so "
            "the drive was not used"
        )
        return None, None, None
    return None, None, commands


def check_times(
    on: float | None,
    off: float | None,
    t: FloatArray,
    where: str,
    notes: list[str],
    clock: Clock | None = None,
) -> tuple[float | None, float | None]:
    """The commanded times of one pulse, checked with the record.

    ``clock``: the recorder's, whose dates are told, too.
    """

    def told(time: float) -> str:
        return f"{time:.10g} s{_date(time, clock)}"

    first, last = float(t[0]), float(t[-1])
    if off is not None and on is None:
        raise CampaignError(
            f"{where}: commanded_off is given without commanded_on; add commanded_on or drive "
            "(where only the fall was recorded, give its command as commanded_on)"
        )
    if on is None:
        return None, None
    if not first <= on < last:
        ratio = on / last if last > 0 else 0.0
        hint = ""
        if 100 < ratio < 1e4:
            hint = " (is time in ms but read as s, or the other way round?)"
        raise CampaignError(
            f"{where}: commanded_on = {told(on)} lies outside the record, which runs from "
            f"{told(first)} to {told(last)}{hint}; expected a time on the record's own "
            "axis: correct commanded_on, or the crop in keep"
        )
    if off is not None and off <= on:
        raise CampaignError(
            f"{where}: commanded_off = {off:.10g} s is not after commanded_on = {on:.10g} s; "
            "expected on before off: swap or correct them"
        )
    if off is not None and off >= last:
        notes.append(
            f"{where}: commanded_off = {off:.10g} s lies beyond the end of the record at "
            f"{last:.10g} s; no step down is recorded"
        )
        off = None
    return on, off


def _date(time: float, clock: Clock | None) -> str:
    """The date of a time (s) in brackets; empty where the recorder's clock has none."""
    if clock is None or not clock.dated:
        return ""
    try:
        since = timedelta(microseconds=round((clock.ns + clock.offset) / 1000 + 1e6 * time))
        return f" ({datetime(1970, 1, 1) + since})"
    except OverflowError:
        return ""


def compare_times(
    told: EntryTimes,
    where: str,
    drive_on: float | None,
    drive_off: float | None,
    notes: list[str],
) -> None:
    for key, time, seen in (
        ("commanded_on", told.on, drive_on),
        ("commanded_off", told.off, drive_off),
    ):
        if time is not None and seen is not None and abs(time - seen) > DISAGREEMENT:
            notes.append(
                f"{where}: {key} = {time:.10g} s, but the drive's edge is at {seen:.10g} s, "
                f"{abs(time - seen) * 1e3:.0f} ms apart; {key} was used"
            )
