"""Which samples of a record are used: what is kept, what is masked, and the gaps in between."""

from __future__ import annotations

import numpy as np

from bayes_sensor.campaign import BoolArray, CampaignError, FloatArray
from bayes_sensor.experiment import runs_of
from bayes_sensor.io.readers.recording import DataFile

LONGEST_GAP = 1.0
"""s; a longer stretch without samples is an error unless it is cropped or masked"""
LARGEST_GAP = 0.02
"""the same as a share of the record; a gap of up to 10 samples is always short"""
MOST_GAPS = 10
"""number of long gaps that one message names"""
MOST_LOST = 0.1
"""share of the record that may be missing or not finite before it is an error"""


def kept_samples(
    keep: tuple[float, float], t: FloatArray, interval: float, where: str
) -> BoolArray:
    slack = 1e-3 * interval
    inside = (t >= keep[0] - slack) & (t <= keep[1] + slack)
    if inside.sum() < 2:
        raise CampaignError(
            f"{where}: keep from {keep[0]:.10g} s to {keep[1]:.10g} s leaves {int(inside.sum())} "
            f"samples; the record runs from {t[0]:.10g} s to {t[-1]:.10g} s: choose within it"
        )
    return np.asarray(inside)


def masked_samples(
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


def check_pauses(
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


def check_gaps(
    file: DataFile, t: FloatArray, missing: BoolArray, interval: float, notes: list[str]
) -> None:
    """Error on a long gap, a note on short ones."""
    if not missing.any():
        return
    starts, ends = runs_of(missing).T
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
