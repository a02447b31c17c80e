"""Experiments proposed for the exports of a folder: signal, drive or commands, crop and unit."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from decimal import ROUND_CEILING, ROUND_FLOOR, Decimal
from pathlib import Path, PurePosixPath
from typing import Any

import numpy as np

from bayes_sensor.campaign import CampaignError
from bayes_sensor.io.draft.exports import Channel, Export, Unread
from bayes_sensor.io.readers import read_experiment
from bayes_sensor.io.readers.left_open import MARK as OPEN
from bayes_sensor.io.readers.quantities import conversion_factor
from bayes_sensor.io.steps import Step

NEAR = 0.08
"""of the highest level: one as near to the first level is the first"""
SMALLEST = 0.15
"""of a record's largest step: no experiment is proposed for a smaller one"""
_MASK = re.compile(r"mask = (\[\[.*\]\])")
_TRIAL_FLOWS = {"carrier_flow": "1 L/min", "test_gas_flow": "1 L/min"}


@dataclass(frozen=True)
class DraftLine:
    """A key of an experiment, and why it stands there; the mark is ASSUMED, MISSING or empty."""

    key: str
    value: Any
    mark: str = ""
    reason: str = ""


@dataclass(frozen=True)
class Draft:
    """One proposed experiment."""

    name: str
    file: str
    lines: tuple[DraftLine, ...]
    unit: str
    """of its samples; empty where the file gives none"""
    fault: str = ""
    """why it cannot be read so; empty where it can"""

    @property
    def table(self) -> dict[str, Any]:
        """Its keys and values as the campaign file holds them, flows apart."""
        keys = {line.key: line.value for line in self.lines if line.key}
        return {"name": self.name, "file": self.file, **keys}


@dataclass(frozen=True)
class Answers:
    """What a user said beforehand; empty where nothing was asked."""

    signal: Mapping[str, Sequence[str]] = field(default_factory=dict)
    """file to channel, or to the channels of several sensors"""
    interval: Mapping[str, str] = field(default_factory=dict)
    """file to sampling interval, for files without times"""


def propose(
    exports: Sequence[Export], folder: Path, answers: Answers | None = None
) -> tuple[list[Draft], list[Unread]]:
    """Experiments for the exports, and the files that none was proposed for.

    A record of several pulses or of a staircase becomes several experiments, cropped between its
    steps.  Each proposal is read as a campaign would read it; gaps in time are masked.
    """
    answers = answers or Answers()
    drafts: list[Draft] = []
    left: list[Unread] = []
    stems = [PurePosixPath(export.file).stem for export in exports]
    for export, stem in zip(exports, stems, strict=True):
        name = stem if stems.count(stem) == 1 else export.file
        for draft in _of_export(export, name, answers):
            tried = _tried(draft, folder)
            if tried.fault:
                left.append(Unread(export.file, tried.fault))
            else:
                drafts.append(tried)
    return _of_one_unit(drafts, left)


def _of_export(export: Export, name: str, answers: Answers) -> list[Draft]:
    chosen = answers.signal.get(export.file, ())
    signal = export.channel(chosen[0]) if chosen else export.signal
    lines = _signal_lines(export, signal)
    if len(chosen) > 1:
        sensors = {re.sub(r"[\[\],]", " ", column).strip(): column for column in chosen}
        lines = [DraftLine("signals", sensors), *(line for line in lines if line.key != "signal")]
    if not export.timed and export.file not in answers.interval:
        words = "the file has no times: the time from one sample to the next"
        lines.append(DraftLine("interval", f"{OPEN} ms", "MISSING", words))
    elif not export.timed:
        lines.append(DraftLine("interval", answers.interval[export.file]))
    lines += _flow_hints(export)
    drive = export.drive(signal)
    if drive is not None:
        reason = "it jumps as a valve's drive does, before the signal moves"
        lines.append(DraftLine("drive", drive.name, "ASSUMED", reason))
        return [Draft(name, export.file, tuple(lines), signal.unit)]
    seconds = _seconds_a_sample(export, answers)
    programme = _programme(export, signal)
    if programme and seconds is not None:
        more = _programme_lines(export, signal, programme, seconds)
        return [Draft(name, export.file, (*lines, *more), signal.unit)]
    parts = _parts(export, signal)
    if not parts:
        words = "no step is seen in the record: when the valve was told to open"
        lines.append(DraftLine("commanded_on", f"{OPEN} s", "MISSING", words))
        return [Draft(name, export.file, tuple(lines), signal.unit)]
    drafts = []
    for number, part in enumerate(parts, 1):
        called = name if len(parts) == 1 else f"{name}-{number}"
        more = _time_lines(export, part, seconds, len(parts) > 1)
        drafts.append(Draft(called, export.file, (*lines, *more), signal.unit))
    return drafts


def _signal_lines(export: Export, signal: Channel) -> list[DraftLine]:
    lines = []
    if len(export.channels) + export.more > 1:
        others = [channel.name for channel in export.measured if channel is not signal]
        reason = "the first channel that shows a step" if signal.steps else "the first channel"
        if not signal.steps and export.set_point is not None:
            reason = f"no channel shows a clear step; this one follows '{export.set_point.name}'"
        if others:
            shown = ", ".join(others[:6]) + (" and more" if len(others) > 6 else "")
            reason += (
                f"; {shown} {'does' if len(others) == 1 else 'do'}, too; signals takes several"
            )
        lines.append(DraftLine("signal", signal.name, "ASSUMED", reason))
    if not signal.unit:
        lines.append(DraftLine("signal_unit", "V", "ASSUMED", "the file gives no unit"))
    return lines


def _flow_hints(export: Export) -> list[DraftLine]:
    """Lines that say what channels of flows read."""
    hints = []
    for channel in export.channels:
        try:
            is_flow = bool(channel.unit) and conversion_factor(channel.unit, "mL/s") is not None
        except CampaignError:
            continue
        if is_flow and len(channel.y):
            said = (
                f"'{channel.name}' reads {float(np.median(channel.y)):.4g} {channel.unit} (median)"
            )
            hints.append(DraftLine("", "", "", said))
    return hints


def _seconds_a_sample(export: Export, answers: Answers) -> float | None:
    """Factor to seconds of the export's times; None where it is not known."""
    if export.timed:
        return 1.0
    told = answers.interval.get(export.file)
    if told is None:
        return None
    number, unit = re.fullmatch(r"\s*([0-9.eE+-]+)\s*(.*?)\s*", told).groups()  # type: ignore[union-attr]
    return float(number) * (conversion_factor(unit, "s") or 1.0)


def _programme(export: Export, signal: Channel) -> list[tuple[float, float]]:
    """Time (s) and level (share of the highest) of each switch of a record of several.

    Empty where one pulse is all, or where levels lie on both sides of the first.
    """
    commands = _command_channel(export, signal)
    steps = _large(signal.steps if commands is None else commands.steps)
    levels = np.cumsum([step.height for step in steps])
    if len(steps) < 3 and not (len(steps) == 2 and steps[0].height * steps[1].height > 0):
        return []
    shares = np.round(levels / levels[np.argmax(np.abs(levels))], 2)
    shares[np.abs(shares) < NEAR] = 0.0
    alternating = np.abs(np.diff(np.concatenate(([0.0], shares)))) > 0.5
    if alternating.all():
        shares = np.round(shares)  # a train of equal pulses
    if (shares < 0).any() or not np.diff(shares, prepend=0.0).all():
        return []
    first = float(signal.t[0])
    times = (
        _before_steps(steps, first, export.interval)
        if commands is None
        else [step.start for step in steps]
    )
    return list(zip(times, shares.tolist(), strict=True))


def _programme_lines(
    export: Export, signal: Channel, programme: Sequence[tuple[float, float]], seconds: float
) -> list[DraftLine]:
    """The keys of several switches: lists of on and off, or steps where levels differ."""
    commands = _command_channel(export, signal)
    grain = export.interval * seconds
    reason = "shortly before the signal moves"
    if commands is not None:
        reason = f"where '{commands.name}' jumps"
    else:
        gaps = [step.half - time for (time, _), step in zip(programme, _large(signal.steps))]
        grain = max(grain, seconds * min(gaps) / 10)
    at = [f"{_rounded(time * seconds, grain)} s" for time, _ in programme]
    levels = [level for _, level in programme]
    if levels == [float(i % 2 == 0) for i in range(len(levels))]:
        lines = [DraftLine("commanded_on", at[::2], "ASSUMED", reason)]
        return [*lines, DraftLine("commanded_off", at[1::2], "ASSUMED", "likewise")]
    steps = [{"at": time, "to": f"{level:g}"} for time, level in zip(at, levels, strict=True)]
    words = f'{reason}; shares of the highest level seen, write "5 %" and the like where you know'
    return [DraftLine("steps", steps, "ASSUMED", words)]


def _large(steps: Sequence[Step]) -> tuple[Step, ...]:
    """The steps that are large enough to be proposed."""
    least = SMALLEST * max((abs(step.height) for step in steps), default=0.0)
    return tuple(step for step in steps if abs(step.height) >= least)


@dataclass(frozen=True)
class _Part:
    """A stretch of a record with one step up and, where it comes back, one down."""

    start: float
    end: float
    on: float
    off: float | None
    reason: str
    grain: float = 0.0
    """to what its commands are worth being written; 0: to the sampling interval"""


def _parts(export: Export, signal: Channel) -> list[_Part]:
    """The stretches of a record, one an experiment."""
    commands = _command_channel(export, signal)
    steps = _large(signal.steps if commands is None else commands.steps)
    if not steps:
        return []
    first, last = float(signal.t[0]), float(signal.t[-1])
    groups: list[list[Step]] = []
    for step in steps:
        before = groups[-1] if groups else []
        comes_back = len(before) == 1 and before[0].height * step.height < 0
        if comes_back and 0.5 < abs(step.height / before[0].height) < 2.0:
            before.append(step)
        else:
            groups.append([step])
    parts = []
    start = first
    for i, group in enumerate(groups):
        following = groups[i + 1][0] if i + 1 < len(groups) else None
        end = last
        if following is not None:  # most of the way, so that the level before the step is kept
            cut = group[-1].end + 0.6 * (following.start - group[-1].end)
            i = int(np.clip(np.searchsorted(signal.t, cut), 1, len(signal.t) - 1))
            end = float(signal.t[i - 1] + signal.t[i]) / 2  # between two samples
        if commands is None:
            begin = start + export.interval * (start > first)
            times = _before_steps(group, begin, export.interval)
            moves = " and ".join(f"{step.half:.4g}" for step in group)
            reason = f"shortly before the signal moves (half way at {moves} s)"
        else:
            times = [step.start for step in group]
            reason = f"where '{commands.name}' jumps"
        off = times[1] if len(times) > 1 else None
        grain = 0.0 if commands is not None else (group[0].half - times[0]) / 10
        parts.append(_Part(start, end, times[0], off, reason, grain))
        start = end
    return parts


def _command_channel(export: Export, signal: Channel) -> Channel | None:
    """A channel that jumps as often as the signal steps, each time a little before it."""
    for channel in export.channels:
        if channel is signal or not channel.jumps or channel.is_measured:
            continue
        if channel.steps[0].start < channel.t[0] + 3 * export.interval:
            continue  # a first sample that is off
        mine, theirs = channel.steps, signal.steps
        if not theirs and channel is export.set_point:
            return channel
        if len(mine) == len(theirs) and all(
            a.start <= b.half and a.height * mine[0].height * b.height * theirs[0].height > 0
            for a, b in zip(mine, theirs, strict=True)
        ):
            return channel
    return None


def _before_steps(group: Sequence[Step], begin: float, interval: float) -> list[float]:
    """Times surely before each step, at which a command may be assumed.

    A command that is assumed too late makes a lag too small, as it is the earliest switch time that
    is tried; one that is early costs little.
    """
    times = []
    for step in group:
        room = (step.start - begin) / 2  # half of the level before is left
        early = step.start - min(max(step.half - step.start, 3 * interval), room)
        times.append(max(early, begin))
        begin = step.end
    return times


def _time_lines(
    export: Export, part: _Part, seconds: float | None, cropped: bool
) -> list[DraftLine]:
    if seconds is None:
        samples = f"{part.reason.replace(' s)', ')')}, counted in samples"
        lines = [
            DraftLine("commanded_on", f"{OPEN} s", "MISSING", f"{samples}: sample {part.on:.0f}")
        ]
        if part.off is not None:
            words = f"sample {part.off:.0f}"
            lines.append(DraftLine("commanded_off", f"{OPEN} s", "MISSING", words))
        if cropped:
            words = f"samples {part.start:.0f} to {part.end:.0f}"
            lines.append(DraftLine("keep", [f"{OPEN} s", f"{OPEN} s"], "MISSING", words))
        return lines
    step = export.interval * seconds
    coarse = max(step, part.grain * seconds)
    on = _rounded(max(part.on, part.start) * seconds, coarse)
    if float(on) < part.start * seconds:
        on = _rounded(part.on * seconds, step)
    lines = [DraftLine("commanded_on", f"{on} s", "ASSUMED", part.reason)]
    if part.off is not None:
        off = _rounded(part.off * seconds, coarse)
        lines.append(DraftLine("commanded_off", f"{off} s", "ASSUMED", "likewise"))
    if cropped:
        start = _rounded(part.start * seconds, step / 10)
        end = _rounded(part.end * seconds, step / 10, ROUND_CEILING)
        lines.append(
            DraftLine("keep", [f"{start} s", f"{end} s"], "ASSUMED", "the stretch around this step")
        )
    return lines


def _rounded(value: float, step: float, way: str = ROUND_FLOOR) -> str:
    """A time with as many decimals as steps of that size have.

    >>> _rounded(24.98437, 0.01), _rounded(39.0, 1.0)
    ('24.98', '39')
    """
    digits = max(0, -int(np.floor(np.log10(step)))) if step > 0 else 3
    value = round(value, digits + 4)  # 1.4 is 1.3999.. where a floor is taken of a float
    text = str(Decimal(repr(value)).quantize(Decimal(1).scaleb(-digits), rounding=way))
    return text.rstrip("0").rstrip(".") if "." in text else text


def _tried(draft: Draft, folder: Path) -> Draft:
    """The draft, with a mask where gaps ask for one, or with its fault."""
    if any(OPEN in str(line.value) for line in draft.lines if line.key):
        return draft
    for _ in range(2):
        try:
            read_experiment({**draft.table, **_TRIAL_FLOWS}, folder, "campaign.toml")
            return draft
        except CampaignError as error:
            said = " ".join(str(error).split())
        gaps = _MASK.search(said)
        if gaps is None or ", .." in gaps[1] or "mask" in draft.table:
            break
        pairs = re.findall(r'\["([^"]*)", "([^"]*)"\]', gaps[1])
        mask = DraftLine(
            "mask", [list(pair) for pair in pairs], "ASSUMED", "gaps in time are left out"
        )
        draft = Draft(draft.name, draft.file, (*draft.lines, mask), draft.unit)
    _, _, reason = said.partition("): ")
    return Draft(draft.name, draft.file, draft.lines, draft.unit, reason or said)


def _of_one_unit(drafts: list[Draft], left: list[Unread]) -> tuple[list[Draft], list[Unread]]:
    """The experiments of the most common unit; a campaign has one."""
    units = [draft.unit or "V" for draft in drafts]
    if not units:
        return drafts, left
    usual = max(units, key=lambda unit: (sum(_alike(unit, other) for other in units),
                                         -units.index(unit)))  # fmt: skip
    kept = []
    for draft, unit in zip(drafts, units, strict=True):
        if _alike(unit, usual):
            kept.append(draft)
        else:
            reason = f"its signal is in {unit}, that of the others in {usual}; a campaign has one"
            left.append(Unread(draft.file, reason))
    return kept, left


def _alike(unit: str, other: str) -> bool:
    if unit == other:
        return True
    try:
        both_volts = conversion_factor(unit, "V") and conversion_factor(other, "V")
    except CampaignError:
        return False
    return bool(both_volts)
