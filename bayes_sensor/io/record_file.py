"""One record of a sensor from any file that the readers take, gaps and irregular times included."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from bayes_sensor.campaign import CampaignError, FloatArray
from bayes_sensor.io.readers import FORMATS, LARGEST_FILE, read_bytes
from bayes_sensor.io.readers.assembly import settled_unit
from bayes_sensor.io.readers.fill_codes import without_fill_codes
from bayes_sensor.io.readers.quantities import TIME, conversion_factor, read_quantity, unit_text
from bayes_sensor.io.readers.recording import DataFile, Recording, Selection
from bayes_sensor.io.readers.sampling import grid_through, grid_times

MOST_EMPTY = 2.0
"""places of the grid over samples written; with more, a gap is one long step"""


@dataclass(frozen=True, eq=False)
class Record:
    """Samples of one sensor over time."""

    t: FloatArray
    """(n,) s, increasing"""
    y: FloatArray
    """(n,) in ``unit``; NaN where no sample was taken"""
    unit: str
    source: str
    """its name in messages"""
    signal: str
    """name of the column"""
    notes: tuple[str, ...] = ()
    """remarks of the reader"""
    sha256: str = ""


def read_record(
    path: Path,
    *,
    signal: str | None = None,
    time: str | None = None,
    interval: str | None = None,
    signal_unit: str | None = None,
) -> Record:
    """The record of a file; the keywords are those of an experiment in a campaign.

    A gap of any length is accepted: its samples are NaN, or it is one long step.

    Raises
    ------
    CampaignError
        If the file cannot be read, the column is not there or times do not increase.
    """
    where = path.name or str(path)
    if path.suffix.casefold() not in FORMATS:
        raise CampaignError(
            f"{where}: expected a data file ending in {', '.join(FORMATS)}, but it ends in "
            f"'{path.suffix}'; export it so"
        )
    shown = where if path.exists() else str(path)
    file = DataFile(path, where, read_bytes(path, shown, LARGEST_FILE, "a data file"))
    step = None if interval is None else read_quantity(interval, TIME, "--interval")
    if step is not None and step <= 0.0:
        raise CampaignError(f"--interval: expected a positive time, but got '{interval}'; give one")
    wanted = None if signal_unit is None else unit_text(signal_unit)
    with np.errstate(over="ignore", invalid="ignore"):
        recording = FORMATS[path.suffix.casefold()](file, Selection(signal, None, time, step))
        factor, unit = _unit(file, recording, wanted)
        samples, codes = without_fill_codes(recording.y, recording.place)
        recording = replace(recording, y=samples, notes=(*recording.notes, *codes))
        t, y = _on_times(file, recording)
        y = y * factor
    notes = [f"{where}: {text}" for text in recording.notes]
    missing = int((~np.isfinite(y)).sum())
    if missing:
        y = np.where(np.isfinite(y), y, np.nan)
        told = f"{missing} of {len(y)} samples are missing ({where})"
        notes.append(f"{told}; the band is wider there")
    return Record(t, y, unit, where, recording.signal, tuple(notes), file.sha256)


def _unit(file: DataFile, recording: Recording, wanted: str | None) -> tuple[float, str]:
    """Factor to the unit of the result, and that unit: the one asked for, else the file's own."""
    stated = recording.unit or wanted or "V"
    if wanted is None:
        return 1.0, stated
    factor = conversion_factor(stated, wanted)
    if factor is None:
        raise file.error(
            f"the unit asked for is '{settled_unit(wanted)}', but the file gives '{stated}' for "
            f"'{recording.signal}', which is another quantity; correct --signal-unit"
        )
    return factor, wanted


def _on_times(file: DataFile, recording: Recording) -> tuple[FloatArray, FloatArray]:
    """Times and samples: on the grid with its empty places where that is not much longer."""
    y = np.asarray(recording.y, dtype=float)
    if recording.interval is not None:
        return grid_times(float(recording.t[0]), recording.interval, len(y)), y
    grid = grid_through(recording.t, recording.place, file.error)
    if grid.times is not None:
        return grid.times, y
    if len(grid.t) <= MOST_EMPTY * len(y):
        full = np.full(len(grid.t), np.nan)
        full[grid.index] = y
        return grid.t, full
    t: FloatArray = grid.start + grid.interval * grid.index.astype(np.float64)
    return t, y
