"""National Instruments TDMS files: waveform channels, or a channel that holds the times."""

from __future__ import annotations

import io
import logging
import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import numpy as np

from bayes_sensor.campaign import FloatArray
from bayes_sensor.io.readers.quantities import known_unit
from bayes_sensor.io.readers.recording import (
    Column,
    DataFile,
    Recording,
    Selection,
    check_counts,
    is_time,
    list_names,
    missing_extra,
    parser_errors,
    split_name,
    time_place,
)
from bayes_sensor.io.readers.sampling import simplest_near
from bayes_sensor.io.readers.vectors import recording_of_vectors, signal_and_drive

_WHAT = "a TDMS file (.tdms)"


def read_tdms(file: DataFile, selection: Selection) -> Recording:
    """The recording in a TDMS file.

    Channels are named by themselves or, where two groups share a name, as ``group/channel``.

    Raises
    ------
    CampaignError
        If the file is damaged, a channel is missing or there is no time.
    """
    try:
        from nptdms import TdmsFile
    except ImportError:
        raise missing_extra(file, ".tdms", "tdms") from None
    with (
        parser_errors(file, _WHAT),
        _complaints_are_errors(file),
        warnings.catch_warnings(),
        TdmsFile.open(io.BytesIO(file.content)) as content,
    ):
        warnings.simplefilter("ignore")
        channels = [channel for group in content.groups() for channel in group.channels()]
        check_counts(file, len(channels), max((len(channel) for channel in channels), default=0))
        channels = [c for c in channels if len(c) and np.dtype(c.dtype).kind in "biufM"]
        if not channels:
            raise file.error("expected channels with numbers, but there are none; export again")
        columns = _name(channels)
        dated = [i for i, c in enumerate(channels) if np.dtype(c.dtype).kind == "M"]
        time = time_place(file, columns, selection)
        if time is None and selection.interval is None and dated:
            time = dated[0]
        others = [
            i
            for i, column in enumerate(columns)
            if i != time and i not in dated and not is_time(column)
        ]
        signal, drive = signal_and_drive(
            file, columns, selection, time, others,
            "expected a signal channel beside the time, but there is only "
            f"{list_names([column.name for column in columns])}; export the signal as well",
        )  # fmt: skip
        y = _values(channels[signal])
        d = None if drive is None else _values(channels[drive])
        written = None if time is None else np.asarray(channels[time][:])
        start, interval = 0.0, selection.interval
        if time is None and interval is None:
            start, interval = _waveform(file, columns[signal], channels[signal])
    return recording_of_vectors(
        file, columns, (time, signal, drive), (written, y, d), called="the {} channel",
        fix="export them together", start=start, interval=interval, channels=others,
    )  # fmt: skip


def _waveform(file: DataFile, column: Column, channel: Any) -> tuple[float, float]:
    """Time of the first sample and sampling interval, s, of a channel that is a waveform."""
    interval = _number(channel.properties.get("wf_increment"))
    start = _number(channel.properties.get("wf_start_offset", 0.0))
    if interval is None or start is None or interval <= 0:
        raise file.error(
            f"channel '{column.name}' has no sampling interval (wf_increment) and there is no "
            'channel named time; export it as a waveform, or write interval = "1 ms"'
        )
    interval = simplest_near(interval, max(1e-9 * interval, 0.01 * interval / len(channel)))
    return simplest_near(start, 1e-3 * interval), interval


@contextmanager
def _complaints_are_errors(file: DataFile) -> Iterator[None]:
    """Raise CampaignError for incomplete segments, which npTDMS cuts short and only logs."""
    complaints: list[str] = []

    def note(record: logging.LogRecord) -> bool:
        complaints.append(" ".join(record.getMessage().split())[:160])
        return False

    loggers = [
        logging.getLogger(name)
        for name in list(logging.root.manager.loggerDict)
        if name.startswith("nptdms.")
    ]
    for logger in loggers:
        logger.addFilter(note)
    try:
        yield
    finally:
        for logger in loggers:
            logger.removeFilter(note)
    if complaints:
        raise file.error(
            f"expected {_WHAT}, but it is incomplete or damaged ({complaints[0]}); export it again"
        )


def _name(channels: list[Any]) -> tuple[Column, ...]:
    names = [str(channel.name) for channel in channels]
    columns = []
    for channel, name in zip(channels, names, strict=True):
        full = f"{channel.group_name}/{name}" if names.count(name) > 1 else name
        column = split_name(full)
        unit = channel.properties.get("unit_string", "")
        if isinstance(unit, str) and unit.strip() and known_unit(unit):
            column = Column(full, column.base, unit.strip())
        columns.append(column)
    return tuple(columns)


def _values(channel: Any) -> FloatArray:
    return np.asarray(channel[:], dtype=np.float64)


def _number(value: object) -> float | None:
    if isinstance(value, int | float | np.number) and np.isfinite(value):
        return float(value)
    return None
