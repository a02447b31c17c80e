"""Commanded times, from the campaign and from the recorded drive, checked with the record."""

from __future__ import annotations

from bayes_sensor.campaign import CampaignError, FloatArray
from bayes_sensor.io.readers.campaign_file import Entry
from bayes_sensor.io.readers.drive import commanded_times
from bayes_sensor.io.readers.recording import DataFile, Recording

DISAGREEMENT = 0.05
"""s between commanded time and drive edge from which a warning is given"""


def drive_times(
    entry: Entry,
    file: DataFile,
    recording: Recording,
    t: FloatArray,
    drive: FloatArray | None,
    notes: list[str],
) -> tuple[float | None, float | None]:
    if drive is None:
        return None, None
    name = recording.drive_name
    try:
        return commanded_times(t, drive, lambda text: file.error(f"drive '{name}': {text}"))
    except CampaignError as error:
        if entry.commanded_on is None:
            raise
        notes.append(f"{error} (commanded_on is given, so the drive was not used)")
        return None, None


def check_times(
    on: float | None, off: float | None, t: FloatArray, where: str, notes: list[str]
) -> tuple[float | None, float | None]:
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
            f"{where}: commanded_on = {on:.10g} s lies outside the record, which runs from "
            f"{first:.10g} s to {last:.10g} s{hint}; expected a time on the record's own "
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


def _compare(
    entry: Entry,
    where: str,
    drive_on: float | None,
    drive_off: float | None,
    notes: list[str],
) -> None:
    for key, told, seen in (
        ("commanded_on", entry.commanded_on, drive_on),
        ("commanded_off", entry.commanded_off, drive_off),
    ):
        if told is not None and seen is not None and abs(told - seen) > DISAGREEMENT:
            notes.append(
                f"{where}: {key} = {told:.10g} s, but the drive's edge is at {seen:.10g} s, "
                f"{abs(told - seen) * 1e3:.0f} ms apart; {key} was used"
            )
