"""Files in which each channel is a vector by itself: NumPy archives, MATLAB and TDMS files."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from numpy.typing import NDArray

from bayes_sensor.campaign import FloatArray
from bayes_sensor.io.readers.recording import (
    Clock,
    Column,
    DataFile,
    Recording,
    Selection,
    check_chosen,
    find_column,
    is_time,
)
from bayes_sensor.io.readers.sampling import grid_times
from bayes_sensor.io.readers.table import number_times


def signal_and_drive(
    file: DataFile,
    columns: Sequence[Column],
    selection: Selection,
    time: int | None,
    candidates: Sequence[int],
    missing: str,
) -> tuple[int, int | None]:
    """Positions of the signal and the drive; where no signal is asked for, the first candidate.

    Raises CampaignError, with the sentence ``missing`` where there is no candidate.
    """
    if selection.signal is not None:
        signal = find_column(file, columns, selection.signal, "signal")
    elif candidates:
        signal = candidates[0]
    else:
        raise file.error(missing)
    drive = None
    if selection.drive is not None:
        drive = find_column(file, columns, selection.drive, "drive")
    check_chosen(file, [column.name for column in columns], time, signal, drive)
    return signal, drive


def recording_of_vectors(
    file: DataFile,
    columns: Sequence[Column],
    places: tuple[int | None, int, int | None],
    vectors: tuple[NDArray[Any] | None, FloatArray, FloatArray | None],
    *,
    called: str,
    fix: str,
    time_name: str = "time",
    start: float = 0.0,
    interval: float | None = None,
    channels: Sequence[int] = (),
) -> Recording:
    """The recording of times as written, signal and drive; ``places``: their columns.

    Without times the samples are ``interval`` s apart from ``start`` s on.  ``called``: a vector in
    the words of the format, ``"the {} channel"``; ``fix``: what to do where lengths differ, which
    raises CampaignError.
    """
    (time, signal, drive), (written, y, d) = places, vectors
    name = columns[signal].name
    for other, values in (("drive", d), (time_name, written)):
        if values is not None and len(values) != len(y):
            raise file.error(
                f"expected {called.format(other)} to have the {len(y)} samples of '{name}', "
                f"but it has {len(values)}; {fix}"
            )
    clock: Clock | None = None
    remark = ""
    if time is not None and written is not None:
        t, clock, remark = number_times(file, columns[time], written)
    else:
        assert interval is not None  # every reader sees to it
        t = grid_times(start, interval, len(y))
    return Recording(
        t=t,
        y=y,
        signal=name,
        place=lambda i: f"sample {i + 1} of '{name}'",
        drive=d,
        drive_name="" if drive is None else columns[drive].name,
        unit=columns[signal].unit,
        interval=interval,
        clock=clock,
        timed=time is None or bool(columns[time].unit),
        notes=(remark,) if remark else (),
        channels=tuple(columns[i].name for i in channels),
        times=tuple(c.name for i, c in enumerate(columns) if i != time and is_time(c)),
    )
