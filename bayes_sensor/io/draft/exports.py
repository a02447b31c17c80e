"""The exports in a folder, read with the reader of their format, and what their channels show."""

from __future__ import annotations

import re
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

import numpy as np

from bayes_sensor.campaign import CampaignError, FloatArray
from bayes_sensor.io.readers import FORMATS, read_recording
from bayes_sensor.io.readers.drive import commanded_times
from bayes_sensor.io.readers.recording import Clock, Recording, Selection, split_name
from bayes_sensor.io.readers.roles import is_set_point
from bayes_sensor.io.steps import Step, find_steps

MOST_FILES = 1000
"""data files of one folder"""
MOST_CHANNELS = 16
"""channels of a file that are looked at; a file of more is a log of everything"""
BETWEEN = 4
"""samples that may lie in the middle of a jump"""
FEWEST_VALUES = 10
"""of a measurement; one of fewer flickers between codes, or counts"""
FEWEST_SAMPLES = 16
"""of an export; less is a table of something else"""


@dataclass(frozen=True, eq=False)
class Channel:
    """One channel of a file."""

    name: str
    """as ``signal`` and ``drive`` may write it"""
    unit: str
    """empty where the file gives none"""
    t: FloatArray
    """(n,) s, of the samples that are numbers"""
    y: FloatArray
    """(n,)"""

    @property
    def constant(self) -> bool:
        """Whether it never changes."""
        return len(self.y) == 0 or bool(self.y.min() == self.y.max())

    @cached_property
    def steps(self) -> tuple[Step, ...]:
        """Its steps, in time."""
        return find_steps(self.t, self.y)

    @cached_property
    def jumps(self) -> bool:
        """Whether it jumps between levels, as a valve's command or a set point does."""
        return jumps(self.t, self.y, self.steps)

    @property
    def is_set_point(self) -> bool:
        """Whether it is called a set point or the error of one."""
        return is_set_point(self.name)

    @property
    def is_measured(self) -> bool:
        """Whether it shows steps in many values, and is no command."""
        many = len(np.unique(self.y[:: max(len(self.y) // 10_000, 1)])) >= FEWEST_VALUES
        return bool(self.steps) and many and not self.jumps and not self.is_set_point


def jumps(t: FloatArray, y: FloatArray, steps: Sequence[Step]) -> bool:
    """Whether all steps are jumps: nearly no sample lies in the middle of any.

    >>> t = np.arange(150.0)
    >>> valve = np.repeat([0.0, 5.0, 0.0], 50)
    >>> jumps(t, valve, find_steps(t, valve))
    True
    """
    for step in steps:
        first, last = np.searchsorted(t, [step.start, step.end + (step.end - step.start)])
        before = float(np.median(y[max(first - BETWEEN, 0) : first + 1]))
        way = (y[first : last + 1] - before) / step.height
        if int(((way > 0.25) & (way < 0.75)).sum()) > BETWEEN:
            return False
    return bool(steps)


def follows(channel: Channel, command: Channel) -> float:
    """Squared correlation of a channel with a command, both averaged to a thousand stretches."""
    if len(channel.y) < FEWEST_SAMPLES:
        return 0.0
    parts = np.array_split(np.arange(len(channel.y)), min(1000, len(channel.y)))
    y = np.array([channel.y[part].mean() for part in parts])
    u = np.interp([channel.t[part].mean() for part in parts], command.t, command.y)
    spread = float(y.std() * u.std())
    return float(np.cov(y, u, ddof=0)[0, 1] / spread) ** 2 if spread > 0 else 0.0


@dataclass(frozen=True, eq=False)
class Export:
    """One data file."""

    file: str
    """its path in the folder, with / between folders"""
    channels: tuple[Channel, ...]
    default: str
    """the channel that the reader takes where none is named"""
    interval: float
    """s, the median step; 1 where the file has no times, so that times count the samples"""
    timed: bool
    """whether the file has times or states its interval"""
    clock: Clock | None = None
    more: int = 0
    """how many channels were not looked at"""

    def channel(self, name: str) -> Channel:
        """The channel of a name; KeyError where there is none."""
        for channel in self.channels:
            if channel.name == name:
                return channel
        raise KeyError(name)

    @property
    def measured(self) -> list[Channel]:
        """Channels that show steps and are no command."""
        return [channel for channel in self.channels if channel.is_measured]

    @property
    def signal(self) -> Channel:
        """The channel to fit: the reader's where it shows a step, else the first that does.

        A channel that only jumps is taken where no other shows a step: it may be a sensor that is
        faster than the sampling.
        """
        default, measured = self.channel(self.default), self.measured
        jumping = [c for c in self.channels if c.jumps and not c.is_set_point]
        told = self.set_point
        if told is not None and not measured:
            free = [c for c in self.channels if not (c.constant or c.is_set_point or c.jumps)]
            return max(free or [default], key=lambda c: follows(c, told))
        if default in measured or not (measured or default.constant or default.is_set_point):
            return default
        moving = [c for c in self.channels if not (c.constant or c.is_set_point)]
        return (measured or jumping or moving or [default])[0]

    @property
    def set_point(self) -> Channel | None:
        """The first channel that is called a set point and steps."""
        for c in self.channels:
            if c.is_set_point and c.jumps and "err" not in c.name.casefold():
                return c
        return None

    def drive(self, signal: Channel) -> Channel | None:
        """The channel of the valve's drive: one pulse, begun before the signal's first step."""
        for channel in self.channels:
            if channel is signal or not channel.jumps or len(channel.steps) > 2:
                continue
            try:
                on, off = commanded_times(channel.t, channel.y, CampaignError)
            except CampaignError:
                continue
            if signal.steps and on > signal.steps[0].half:
                continue
            if off is not None and len(signal.steps) > 1 and off > signal.steps[1].half:
                continue
            return channel
        return None


@dataclass(frozen=True)
class Unread:
    """A data file that cannot be read, and why."""

    file: str
    reason: str


def find_exports(folder: Path) -> tuple[list[Export], list[Unread]]:
    """The data files of a folder, by name; of its folders where it has none itself.

    Raises
    ------
    CampaignError
        If there is no such folder, no data file in it, or too many.
    """
    if not folder.is_dir():
        what = "it is a file" if folder.exists() else "there is none of that name"
        raise CampaignError(
            f"{folder}: expected a folder with exports of a recorder, but {what}; give the folder"
        )
    paths = _data_files(folder.iterdir())
    if not paths:
        paths = _data_files(folder.rglob("*"))
    if not paths:
        raise CampaignError(
            f"{folder}: expected data files ending in {', '.join(FORMATS)}, but there is none; "
            "put the exports of the recorder there"
        )
    if len(paths) > MOST_FILES:
        raise CampaignError(
            f"{folder}: expected at most {MOST_FILES} data files, but there are {len(paths)}; "
            "give the folder of one campaign"
        )
    exports: list[Export] = []
    unread: list[Unread] = []
    for path in paths:
        file = path.relative_to(folder).as_posix()
        try:
            exports.append(read_export(path, file))
        except CampaignError as error:
            reason = " ".join(str(error).split()).removeprefix(f"{file}: ")
            unread.append(Unread(file, reason))
    return exports, unread


def _data_files(paths: Iterable[Path]) -> list[Path]:
    found = [
        path
        for path in paths
        if path.suffix.casefold() in FORMATS and path.is_file() and not path.name.startswith(".")
    ]
    return sorted(found, key=lambda path: _natural(path.as_posix()))


def _natural(text: str) -> list[tuple[int, int, str]]:
    """A key by which exp2 stands before exp10."""
    return [
        (0, int(part), "") if part.isdigit() else (1, 0, part.casefold())
        for part in re.split(r"(\d{1,18})", text)
    ]


def read_export(path: Path, file: str) -> Export:
    """One data file with its channels; CampaignError where it cannot be read."""
    interval: float | None = None
    try:
        first = read_recording(path, file, Selection())
    except CampaignError as error:
        if 'write interval = "' not in str(error):
            raise
        interval = 1.0
        first = read_recording(path, file, Selection(interval=interval))
    if len(first.t) < FEWEST_SAMPLES:
        raise CampaignError(
            f"{file}: expected a record of at least {FEWEST_SAMPLES} samples, but it has "
            f"{len(first.t)}; it was taken for something else"
        )
    names = list(first.channels) or [first.signal]
    default = first.signal if first.signal in names else names[0]
    looked = _looked_at(names, default)
    channels = [_channel(path, file, name, interval, first, default) for name in looked]
    return Export(
        file=file,
        channels=tuple(channel for channel in channels if channel is not None),
        default=default,
        interval=float(np.median(np.diff(first.t))) if len(first.t) > 1 else 1.0,
        timed=interval is None,
        clock=first.clock,
        more=len(names) - len(looked),
    )


def _looked_at(names: Sequence[str], default: str) -> list[str]:
    some = list(names[:MOST_CHANNELS])
    return some if default in some else [default, *some[:-1]]


def _channel(
    path: Path, file: str, name: str, interval: float | None, first: Recording, default: str
) -> Channel | None:
    """One channel; None where it cannot be read as numbers."""
    recording = first
    if name != default:
        try:
            recording = read_recording(path, file, Selection(signal=name, interval=interval))
        except CampaignError:
            return None
    known = np.isfinite(recording.y) & np.isfinite(recording.t)
    unit = recording.unit or split_name(name).unit
    return Channel(name, unit, recording.t[known], recording.y[known])
