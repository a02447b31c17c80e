"""From a checked entry and its recording to an :class:`Experiment`: grid, crop, mask, times."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from bayes_sensor.campaign import CampaignError, Experiment, FloatArray
from bayes_sensor.io.readers.campaign_file import ExperimentTable
from bayes_sensor.io.readers.commanded_programme import commands_of_input, within_record
from bayes_sensor.io.readers.commanded_times import (
    check_times,
    compare_times,
    drive_commands,
    times_of_entry,
)
from bayes_sensor.io.readers.fill_codes import without_fill_codes
from bayes_sensor.io.readers.quantities import conversion_factor
from bayes_sensor.io.readers.recording import MAX_SAMPLES, DataFile, Recording, check_counts
from bayes_sensor.io.readers.sample_values import (
    check_clipped,
    check_finite,
    largest_of,
    look_for_mistakes,
    question_units,
)
from bayes_sensor.io.readers.sampling import (
    MOST_JITTER,
    NOTED_JITTER,
    Grid,
    grid_through,
    grid_times,
)
from bayes_sensor.io.readers.saturation import clipped_samples
from bayes_sensor.io.readers.used_samples import (
    check_gaps,
    check_pauses,
    kept_samples,
    masked_samples,
)


@dataclass(frozen=True, eq=False)
class Assembled:
    """An experiment, the unit of its samples and remarks."""

    experiment: Experiment
    unit: str
    warnings: tuple[str, ...]


def design(entry: ExperimentTable, label: str) -> Experiment:
    """The planned experiment of an entry without a file."""
    where = f"experiment '{entry.name}' ({label})"
    for key, value in (("interval", entry.interval), ("duration", entry.duration)):
        if value is None:
            example = {"interval": '"1 ms"', "duration": '"120 s"'}[key]
            raise CampaignError(
                f"{where}: the key {key} is missing; a measured experiment needs file, a design "
                f"needs interval and duration: add {key} = {example}"
            )
    for key in ("signal", "drive", "input"):
        if getattr(entry, key) is not None:
            raise CampaignError(
                f"{where}: {key} belongs to a measured experiment, but there is no file; "
                f"add file or remove {key}"
            )
    assert entry.interval is not None and entry.duration is not None
    n = entry.duration / entry.interval
    if not 2 <= round(n) <= MAX_SAMPLES:
        raise CampaignError(
            f"{where}: duration over interval gives {n:.4g} samples; expected 2 to {MAX_SAMPLES}: "
            "change one of them"
        )
    t = grid_times(0.0, entry.interval, round(n))
    used = np.ones(len(t), dtype=bool)
    told = times_of_entry(entry, where, None)
    if told.keep is not None:
        inside = kept_samples(told.keep, t, entry.interval, where)
        t, used = t[inside], used[inside]
    notes: list[str] = []
    used &= ~masked_samples(told.mask, t, entry.interval, where, notes)
    on, off = check_times(told.on, told.off, t, where, notes)
    commands = None if told.commands is None else within_record(told.commands, t, where, notes)
    if notes:
        raise CampaignError(f"{notes[0]}: correct the design")
    return Experiment(
        name=entry.name,
        t=t,
        y=None,
        carrier_flow=entry.carrier_flow,
        test_gas_flow=entry.test_gas_flow,
        interval=entry.interval,
        commanded_on=on,
        commanded_off=off,
        mask=used,
        commands=commands,
    )


def assemble(entry: ExperimentTable, file: DataFile, recording: Recording) -> Assembled:
    """The experiment of an entry and its recording.

    Raises
    ------
    CampaignError
        If times, gaps, samples or commanded times do not make an experiment.
    """
    where = file.where
    told = times_of_entry(entry, where, recording.clock)
    notes = [f"{where}: {text}" for text in recording.notes]
    check_counts(file, 0, len(recording.t))
    if len(recording.t) < 2:
        raise file.error(f"expected at least 2 samples, but got {len(recording.t)}; record longer")
    grid = _grid(file, recording)
    if NOTED_JITTER < grid.jitter <= MOST_JITTER and not grid.rounded:
        notes.append(
            f"{where}: times are up to {100 * grid.jitter:.0f} % of the interval off a uniform "
            f"grid of {grid.interval:.6g} s; the samples were taken as uniform"
        )
    n = int(grid.index[-1]) + 1
    t = grid.t
    irregular = grid.times is not None
    if irregular:
        step = np.diff(t)
        notes.append(
            f"{where}: the sampling is irregular, one sample every {step.min():.4g} to "
            f"{step.max():.4g} s (median {grid.interval:.4g} s); the times were used as they are"
        )
    scale, unit = _unit(entry, file, recording)
    present = np.zeros(n, dtype=bool)
    samples, codes = without_fill_codes(recording.y, recording.place)
    notes += [f"{where}: {text}" for text in codes]
    present[grid.index] = ~np.isnan(samples) | np.isnan(recording.y)
    y = _on_grid(samples, grid, n) * scale
    drive = None if recording.drive is None else _on_grid(recording.drive, grid, n)
    written = grid.index

    if told.keep is not None:
        inside = kept_samples(told.keep, t, grid.interval, where)
        first = int(np.argmax(inside))
        t, y, present = t[inside], y[inside], present[inside]
        drive = None if drive is None else drive[inside]
        written = written - first
    excluded = masked_samples(told.mask, t, grid.interval, where, notes, irregular)

    def place(i: int) -> str:
        return recording.place(int(np.searchsorted(written, i)))

    if irregular:
        check_pauses(file, t, told.mask, grid.interval)
    else:
        check_gaps(file, t, ~present & ~excluded, grid.interval, notes)
    commands = told.commands
    if entry.input is not None and drive is not None:
        commands = commands_of_input(t, drive, where, recording.drive_name)
        drive = None
    drive_on, drive_off, switched = drive_commands(entry, told, file, recording, t, drive, notes)
    commands = switched if commands is None else commands
    if commands is not None:
        commands = within_record(commands, t, where, notes)
    on = told.on if told.on is not None else drive_on
    off = told.off if told.off is not None else drive_off
    on, off = check_times(on, off, t, where, notes, recording.clock)
    compare_times(told, where, drive_on, drive_off, notes)

    used = present & ~excluded
    check_finite(file, t, y, used, place, notes)
    used &= ~np.isnan(y)
    clipped = clipped_samples(y, used)
    if clipped.any():
        check_clipped(file, t, y, used, clipped, on, off, notes)
        used &= ~clipped
    if not used.any():
        raise file.error("no sample is left to use; widen keep or drop the mask")
    unusable = ~used & ~(np.abs(y) <= largest_of(y[used]))
    if unusable.any():  # never looked at, but figures and sums want finite numbers
        y = np.where(unusable, np.interp(t, t[used], y[used]), y)
    timed = recording.timed or recording.clock is not None or recording.interval is not None
    look_for_mistakes(where, t, y, used, unit, drive, timed, notes)
    question_units(entry, file, recording, float(np.abs(y[used]).max()), notes)
    experiment = Experiment(
        name=entry.name,
        t=t,
        y=y,
        carrier_flow=entry.carrier_flow,
        test_gas_flow=entry.test_gas_flow,
        interval=grid.interval,
        commanded_on=on,
        commanded_off=off,
        mask=used,
        drive=drive,
        source=str(entry.file),
        sha256=file.sha256,
        commands=commands,
    )
    return Assembled(experiment, unit, tuple(notes))


def _grid(file: DataFile, recording: Recording) -> Grid:
    if recording.interval is None:
        return grid_through(recording.t, recording.place, file.error)
    index = np.arange(len(recording.t), dtype=np.int64)
    return Grid(float(recording.t[0]), recording.interval, index, 0.0, True)


def _on_grid(values: FloatArray, grid: Grid, n: int) -> FloatArray:
    """(n,) the values on the grid, NaN where no sample was written."""
    if len(values) == n:
        return values
    full = np.full(n, np.nan)
    full[grid.index] = values
    return full


def _unit(entry: ExperimentTable, file: DataFile, recording: Recording) -> tuple[float, str]:
    """Factor to the internal unit of the samples, and that unit: V for every voltage."""
    stated, wanted = recording.unit or entry.signal_unit or "V", entry.signal_unit
    if wanted is not None:
        factor = conversion_factor(stated, wanted)
        if factor is None:
            raise file.error(
                f"signal_unit is '{wanted}', but the file gives '{stated}' for "
                f"'{recording.signal}', which is another quantity; correct one of them"
            )
        if settled_unit(wanted) != "V":
            return factor, wanted
    to_volts = conversion_factor(stated, "V")
    return (1.0, stated) if to_volts is None else (to_volts, "V")


def settled_unit(unit: str) -> str:
    """The internal unit of the samples: V for every voltage, any other unchanged."""
    return unit if conversion_factor(unit, "V") is None else "V"
