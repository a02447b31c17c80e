"""Values of samples, checked: finite, not clipped, in a likely unit, of likely size."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from bayes_sensor.campaign import BoolArray, FloatArray
from bayes_sensor.io.readers.campaign_file import ExperimentTable
from bayes_sensor.io.readers.recording import DataFile, Recording
from bayes_sensor.io.readers.used_samples import MOST_LOST

MOST_CLIPPED = 0.8
"""share of the record that may be clipped before it is an error"""
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


def largest_of(y: FloatArray) -> float:
    """Largest plausible sample, given samples ``y`` (n,)."""
    sizes = np.abs(y[np.isfinite(y) & (y != 0.0)])
    usual = float(np.median(sizes)) if len(sizes) else 1.0
    return min(OUT_OF_PROPORTION * usual, LARGEST_VALUE)


def check_finite(
    file: DataFile,
    t: FloatArray,
    y: FloatArray,
    used: BoolArray,
    place: Callable[[int], str],
    notes: list[str],
) -> None:
    """Error where a sample is no measurement at all, a note where some are missing."""
    huge = used & np.isfinite(y) & (np.abs(y) > largest_of(y[used]))
    if huge.any():
        i = int(np.argmax(huge))
        raise file.error(
            f"{place(i)}: the signal is {y[i]:.4g}, out of all proportion; expected a measured "
            "value: check the number format or mask it"
        )
    _look_for_one_apart(file, y, used & np.isfinite(y), place, notes)
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


def _look_for_one_apart(
    file: DataFile,
    y: FloatArray,
    used: BoolArray,
    place: Callable[[int], str],
    notes: list[str],
) -> None:
    """A note on one sample that lies further from all others than they from each other."""
    values = np.sort(y[used])
    if len(values) < 4:
        return
    low, high = values[1] - values[0], values[-1] - values[-2]
    if max(low, high) > values[-2] - values[1] > 0:
        i = int(np.flatnonzero(used & (y == (values[0] if low > high else values[-1])))[0])
        notes.append(
            f"{file.where}: {place(i)}: one sample, {y[i]:.4g}, lies far from all others; leave it "
            "out with mask where it was not measured"
        )


def check_clipped(
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


def question_units(
    entry: ExperimentTable, file: DataFile, recording: Recording, largest: float, notes: list[str]
) -> None:
    """Notes on a missing or wrong unit."""
    if not recording.unit and entry.signal_unit is None and largest > _LARGEST_VOLTAGE:
        notes.append(
            f"{file.where}: no unit is given for '{recording.signal}', so {largest:.4g} was taken "
            'as volts; if it is in mV, write signal_unit = "mV"'
        )
    if entry.carrier_flow is None or entry.test_gas_flow is None:
        return
    flow = entry.carrier_flow + entry.test_gas_flow
    if not _USUAL_FLOWS[0] <= flow <= _USUAL_FLOWS[1]:
        notes.append(
            f"{file.where}: the total flow is {flow * 0.06:.3g} L/min ({flow * 60:.4g} mL/min), "
            "unusual for a rig of this kind; check the unit"
        )


def look_for_mistakes(
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
