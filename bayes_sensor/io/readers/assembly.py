"""From a checked entry and its recording to an :class:`Experiment`: grid, crop, mask, times."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from bayes_sensor.campaign import BoolArray, CampaignError, Experiment, FloatArray
from bayes_sensor.io.readers.campaign_file import Entry
from bayes_sensor.io.readers.drive import commanded_times
from bayes_sensor.io.readers.quantities import conversion_factor
from bayes_sensor.io.readers.recording import (
    MAX_SAMPLES,
    Clock,
    DataFile,
    Recording,
    check_counts,
)
from bayes_sensor.io.readers.sampling import (
    FIRST_EPOCH,
    MOST_JITTER,
    NOTED_JITTER,
    Grid,
    grid_through,
    grid_times,
)
from bayes_sensor.io.readers.saturation import clipped_samples
from bayes_sensor.io.readers.stamps import DAY, Moment

LONGEST_GAP = 1.0
"""s; a longer stretch without samples is an error unless it is cropped or masked"""
LARGEST_GAP = 0.02
"""the same as a share of the record; a gap of up to 10 samples is always short"""
MOST_GAPS = 10
"""number of long gaps that one message names"""
MOST_LOST = 0.1
"""share of the record that may be missing or not finite before it is an error"""
MOST_CLIPPED = 0.8
"""share of the record that may be clipped before it is an error"""
DISAGREEMENT = 0.05
"""s between commanded time and drive edge from which a warning is given"""
OUT_OF_PROPORTION = 1e12
"""times the median size of the samples; above it a sample is not a measurement"""
LARGEST_VALUE = 1e100
"""largest value whose square and cube are finite"""
_LARGEST_VOLTAGE = 20.0
"""V; samples above were probably recorded in mV"""
_USUAL_FLOWS = (0.5, 5000.0)
"""mL/s; outside this range the unit is probably wrong"""
_LONG_RECORD = 2 * 3600.0  # s
_SLOW_SAMPLING = 1.0  # s


@dataclass(frozen=True, eq=False)
class Assembled:
    """An experiment, the unit of its samples and remarks."""

    experiment: Experiment
    unit: str
    warnings: tuple[str, ...]


def design(entry: Entry, label: str) -> Experiment:
    """The planned experiment of an entry without a file."""
    where = f"experiment '{entry.name}' ({label})"
    for key, value in (("interval", entry.interval), ("duration", entry.duration)):
        if value is None:
            example = {"interval": '"1 ms"', "duration": '"120 s"'}[key]
            raise CampaignError(
                f"{where}: the key {key} is missing; a measured experiment needs file, a design "
                f"needs interval and duration: add {key} = {example}"
            )
    for key in ("signal", "drive"):
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
        inside = _kept(told.keep, t, entry.interval, where)
        t, used = t[inside], used[inside]
    notes: list[str] = []
    used &= ~_masked(told.mask, t, entry.interval, where, notes)
    on, off = _check_times(told.on, told.off, t, where, notes)
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
    )


def assemble(entry: Entry, file: DataFile, recording: Recording) -> Assembled:
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
    present[grid.index] = True
    y = _on_grid(recording.y, grid, n) * scale
    drive = None if recording.drive is None else _on_grid(recording.drive, grid, n)
    written = grid.index

    if told.keep is not None:
        inside = _kept(told.keep, t, grid.interval, where)
        first = int(np.argmax(inside))
        t, y, present = t[inside], y[inside], present[inside]
        drive = None if drive is None else drive[inside]
        written = written - first
    excluded = _masked(told.mask, t, grid.interval, where, notes, irregular)

    def place(i: int) -> str:
        return recording.place(int(np.searchsorted(written, i)))

    if irregular:
        _check_pauses(file, t, told.mask, grid.interval)
    else:
        _check_gaps(file, t, ~present & ~excluded, grid.interval, notes)
    drive_on, drive_off = _drive_times(told, file, recording, t, drive, notes)
    on = told.on if told.on is not None else drive_on
    off = told.off if told.off is not None else drive_off
    on, off = _check_times(on, off, t, where, notes)
    _compare(told, where, drive_on, drive_off, notes)

    used = present & ~excluded
    _check_finite(file, t, y, used, place, notes)
    used &= ~np.isnan(y)
    clipped = clipped_samples(y, used)
    if clipped.any():
        _check_clipped(file, t, y, used, clipped, on, off, notes)
        used &= ~clipped
    if not used.any():
        raise file.error("no sample is left to use; widen keep or drop the mask")
    unusable = ~used & ~(np.abs(y) <= _largest_of(y[used]))
    if unusable.any():  # never looked at, but figures and sums want finite numbers
        y = np.where(unusable, np.interp(t, t[used], y[used]), y)
    timed = recording.timed or recording.clock is not None or recording.interval is not None
    _look_for_mistakes(where, t, y, used, unit, drive, timed, notes)
    _question_units(entry, file, recording, float(np.abs(y[used]).max()), notes)
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
    )
    return Assembled(experiment, unit, tuple(notes))


@dataclass(frozen=True)
class EntryTimes:
    """The times of an entry, in s on the record's own axis."""

    on: float | None
    off: float | None
    keep: tuple[float, float] | None
    mask: tuple[tuple[float, float], ...]


def times_of_entry(entry: Entry, where: str, clock: Clock | None) -> EntryTimes:
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

    on, off = entry.commanded_on, entry.commanded_off
    return EntryTimes(
        None if on is None else seconds(on, "commanded_on"),
        None if off is None else seconds(off, "commanded_off"),
        None if entry.keep is None else pair(entry.keep, "keep"),
        tuple(pair(part, "mask") for part in entry.mask),
    )


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


def _unit(entry: Entry, file: DataFile, recording: Recording) -> tuple[float, str]:
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


# --------------------------------------------------------------------------- time ranges


def _kept(keep: tuple[float, float], t: FloatArray, interval: float, where: str) -> BoolArray:
    slack = 1e-3 * interval
    inside = (t >= keep[0] - slack) & (t <= keep[1] + slack)
    if inside.sum() < 2:
        raise CampaignError(
            f"{where}: keep from {keep[0]:.10g} s to {keep[1]:.10g} s leaves {int(inside.sum())} "
            f"samples; the record runs from {t[0]:.10g} s to {t[-1]:.10g} s: choose within it"
        )
    return np.asarray(inside)


def _masked(
    ranges: tuple[tuple[float, float], ...],
    t: FloatArray,
    interval: float,
    where: str,
    notes: list[str],
    irregular: bool = False,
) -> BoolArray:
    """(n,) True where a sample is left out by the campaign's mask."""
    excluded = np.zeros(len(t), dtype=bool)
    slack = 1e-3 * interval
    for start, end in ranges:
        inside = (t >= start - slack) & (t <= end + slack)
        if not inside.any() and not (irregular and t[0] < start < t[-1]):
            notes.append(
                f"{where}: the mask from {start:.10g} s to {end:.10g} s holds no sample (the "
                f"record runs from {t[0]:.10g} s to {t[-1]:.10g} s)"
            )
        excluded |= inside
    if excluded.all():
        raise CampaignError(f"{where}: the mask leaves no sample to use; shorten it")
    return excluded


def _longest_pause(interval: float, n: int) -> float:
    """s, up to which a stretch without samples is accepted."""
    return max(10 * interval, min(LONGEST_GAP, LARGEST_GAP * n * interval))


def _check_pauses(
    file: DataFile, t: FloatArray, masks: tuple[tuple[float, float], ...], interval: float
) -> None:
    """Error on a long pause between two samples of irregular times, unless it is masked."""
    step = np.diff(t)
    limit = _longest_pause(interval, len(t))
    for i in np.flatnonzero(step > limit * (1 + 1e-9)):
        slack = 1e-3 * interval
        if any(a <= t[i] + slack and b >= t[i + 1] - slack for a, b in masks):
            continue
        ends = f'["{t[i]:.10g} s", "{t[i + 1]:.10g} s"]'
        raise file.error(
            f"there is a gap of {step[i]:.4g} s in time between {t[i]:.10g} s and "
            f"{t[i + 1]:.10g} s; expected gaps of at most {limit:.3g} s (the median step is "
            f"{interval:.4g} s): crop with keep or accept it with mask = [{ends}]"
        )


def _check_gaps(
    file: DataFile, t: FloatArray, missing: BoolArray, interval: float, notes: list[str]
) -> None:
    """Error on a long gap, a note on short ones."""
    if not missing.any():
        return
    starts, ends = _runs(missing)
    lengths = ends - starts
    long = int(np.argmax(lengths))
    duration = lengths[long] * interval
    limit = _longest_pause(interval, len(t))
    too_long = np.flatnonzero(lengths * interval > limit * (1 + 1e-9))
    if too_long.size:
        some = too_long[:MOST_GAPS]
        ends_of = [(t[max(starts[i] - 1, 0)], t[min(ends[i], len(t) - 1)]) for i in some]
        masks = ", ".join(f'["{before:.10g} s", "{after:.10g} s"]' for before, after in ends_of)
        found, it = f"is a gap of {duration:.4g} s in time", "it"
        said = ["between {:.10g} s and {:.10g} s".format(*ends) for ends in ends_of]
        if len(too_long) > 1:
            found, it = f"are {len(too_long)} gaps in time of up to {duration:.4g} s,", "them"
        if len(too_long) > len(some):
            said[-1] += " and further on"
            masks += ", .."
        raise file.error(
            f"there {found} {', '.join(said)}; expected samples every {interval:.6g} s (gaps up to "
            f"{limit:.3g} s are left out): crop with keep or accept {it} with mask = [{masks}]"
        )
    if missing.mean() > MOST_LOST:
        raise file.error(
            f"{int(missing.sum())} of {len(t)} samples are missing ({100 * missing.mean():.0f} %); "
            f"expected one every {interval:.6g} s: record again or crop with keep"
        )
    count = "one gap" if len(lengths) == 1 else f"{len(lengths)} gaps"
    notes.append(
        f"{file.where}: {count} in time, {int(missing.sum())} missing samples, the longest "
        f"{duration:.4g} s at {t[starts[long]]:.10g} s; left out"
    )


def _runs(flags: BoolArray) -> tuple[np.ndarray, np.ndarray]:
    edges = np.flatnonzero(np.diff(np.concatenate(([False], flags, [False])).astype(np.int8)))
    return edges[::2], edges[1::2]


# --------------------------------------------------------------------------- commanded times


def _drive_times(
    told: EntryTimes,
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
        if told.on is None:
            raise
        notes.append(f"{error} (commanded_on is given, so the drive was not used)")
        return None, None


def _check_times(
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


# --------------------------------------------------------------------------- samples


def _largest_of(y: FloatArray) -> float:
    """Largest plausible sample, given samples ``y`` (n,)."""
    sizes = np.abs(y[np.isfinite(y) & (y != 0.0)])
    usual = float(np.median(sizes)) if len(sizes) else 1.0
    return min(OUT_OF_PROPORTION * usual, LARGEST_VALUE)


def _check_finite(
    file: DataFile,
    t: FloatArray,
    y: FloatArray,
    used: BoolArray,
    place: object,
    notes: list[str],
) -> None:
    assert callable(place)
    huge = used & np.isfinite(y) & (np.abs(y) > _largest_of(y[used]))
    if huge.any():
        i = int(np.argmax(huge))
        raise file.error(
            f"{place(i)}: the signal is {y[i]:.4g}, out of all proportion; expected a measured "
            "value: check the number format or mask it"
        )
    bad = used & np.isnan(y)
    lost = used & ~np.isfinite(y)
    if not lost.any():
        return
    i = int(np.argmax(lost))
    at = f"the first at {place(i)} ({t[i]:.10g} s)"
    if lost.all() or lost.sum() == used.sum():
        raise file.error(
            f"none of the {int(used.sum())} samples is a finite number ({at} is {y[i]}); "
            "expected measured values: choose another signal or export again"
        )
    if bad.sum() > MOST_LOST * len(t):
        raise file.error(
            f"{int(bad.sum())} of {len(t)} samples are not a number, {at}; expected at most "
            f"{100 * MOST_LOST:.0f} %: repair the file, crop with keep or leave them out with mask"
        )
    if bad.any():
        i = int(np.argmax(bad))
        s = "s are" if bad.sum() > 1 else " is"
        notes.append(
            f"{file.where}: {int(bad.sum())} sample{s} not a number, the first at {place(i)} "
            f"({t[i]:.10g} s); left out"
        )


def _check_clipped(
    file: DataFile,
    t: FloatArray,
    y: FloatArray,
    used: BoolArray,
    clipped: BoolArray,
    on: float | None,
    off: float | None,
    notes: list[str],
) -> None:
    """Error if too few samples are not clipped, else a note."""
    i = int(np.argmax(clipped))
    share = clipped.sum() / used.sum()
    finite = y[clipped & np.isfinite(y)]
    level = f"the end of the range (marked {y[i]})"
    if len(finite):  # the rail that more samples lie at; others were caught among them
        rail = max(finite.max(), finite.min(), key=lambda edge: np.count_nonzero(finite == edge))
        level = f"{rail:.4g}"
    begins = f"{t[i]:.10g} s"
    fix = "record again with a wider input range"
    unseen = ""
    if on is not None:
        end = off if off is not None else float(t[-1])
        late = used & (t >= (on + end) / 2) & (t < end)
        if late.any() and (clipped & late).sum() > 0.95 * late.sum():
            unseen = (
                "; the plateau is not seen, so the step's height is known only from the samples "
                f"below the rail: {fix}"
            )
    if share > MOST_CLIPPED:
        raise file.error(
            f"{100 * share:.0f} % of the samples are clipped at {level}, the first at {begins}; "
            f"expected a signal within the input range: {fix}"
        )
    notes.append(
        f"{file.where}: {int(clipped.sum())} samples ({100 * share:.1f} %) are clipped at {level} "
        f"or among clipped ones, the first at {begins}; left out{unseen}"
    )


def _question_units(
    entry: Entry, file: DataFile, recording: Recording, largest: float, notes: list[str]
) -> None:
    """Notes on a missing or wrong unit."""
    if not recording.unit and entry.signal_unit is None and largest > _LARGEST_VOLTAGE:
        notes.append(
            f"{file.where}: no unit is given for '{recording.signal}', so {largest:.4g} was taken "
            'as volts; if it is in mV, write signal_unit = "mV"'
        )
    flow = entry.carrier_flow + entry.test_gas_flow
    if not _USUAL_FLOWS[0] <= flow <= _USUAL_FLOWS[1]:
        notes.append(
            f"{file.where}: the total flow is {flow * 0.06:.3g} L/min ({flow * 60:.4g} mL/min), "
            "unusual for a rig of this kind; check the unit"
        )


def _look_for_mistakes(
    where: str,
    t: FloatArray,
    y: FloatArray,
    used: BoolArray,
    unit: str,
    drive: FloatArray | None,
    timed: bool,
    notes: list[str],
) -> None:
    """Notes on input that can be read but is probably a mistake."""
    values = y[used]
    low, high = float(values.min()), float(values.max())
    if high == low:
        notes.append(f"{where}: the signal never changes (always {low:.6g} {unit})")
    elif drive is not None and len(values) > 100:
        between = (values > low + 0.1 * (high - low)) & (values < high - 0.1 * (high - low))
        finite = drive[used & np.isfinite(drive)]
        if between.sum() <= 4 and len(finite):
            d_low, d_high = float(finite.min()), float(finite.max())
            inner = (finite > d_low + 0.1 * (d_high - d_low)) & (
                finite < d_high - 0.1 * (d_high - d_low)
            )
            if inner.sum() > 20:
                notes.append(
                    f"{where}: the signal jumps like a valve drive and the drive moves like a "
                    "sensor; signal and drive may be swapped"
                )
    if not timed and (t[-1] - t[0] > _LONG_RECORD or t[1] - t[0] >= _SLOW_SAMPLING):
        notes.append(
            f"{where}: the record lasts {_duration(t[-1] - t[0])} with a sample every "
            f"{t[1] - t[0]:.4g} s; if the times are in ms, name the column time_ms"
        )


def _duration(seconds: float) -> str:
    """A length of time in s, min or h.

    >>> _duration(90.0), _duration(299.0), _duration(7200.0)
    ('90 s', '4.98 min', '2 h')
    """
    if seconds < 120:
        return f"{seconds:.3g} s"
    return f"{seconds / 60:.3g} min" if seconds < 3600 else f"{seconds / 3600:.3g} h"
