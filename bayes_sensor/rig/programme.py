"""What is done to the gas in one record: a programme of switches, or a recorded input."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np

from bayes_sensor.campaign import CampaignError, FloatArray
from bayes_sensor.experiment import check_rising
from bayes_sensor.rig.chain import Drive


@dataclass(frozen=True, eq=False)
class Programme:
    """Switches of the input: u(t) = rest + the sum of the heights of all switches before t.

    Build one with :meth:`pulse`, :meth:`pulses`, :meth:`steps` or :meth:`edges`, which check that
    the times rise.  Times that are estimated may cross.

    >>> Programme.pulse(24.0, 83.0).levels.tolist()
    [1.0, 0.0]
    """

    times: FloatArray
    """(n_switches,) s"""
    heights: FloatArray
    """(n_switches,) share of the test gas"""
    rest: float = 0.0
    """share before the first switch"""

    def __post_init__(self) -> None:
        times = np.ascontiguousarray(self.times, dtype=float)
        heights = np.ascontiguousarray(self.heights, dtype=float)
        if times.ndim != 1 or times.shape != heights.shape or not len(times):
            raise CampaignError(
                "programme: expected as many times as heights, one or more, but got shapes "
                f"{times.shape} and {heights.shape}; give each switch both"
            )
        for label, values in (("time", times), ("height", heights)):
            if not np.isfinite(values).all():
                i = int(np.argmin(np.isfinite(values)))
                raise CampaignError(
                    f"programme: the {label} of switch {i + 1} is {values[i]}; expected a number"
                )
        object.__setattr__(self, "times", times)
        object.__setattr__(self, "heights", heights)

    @classmethod
    def pulse(cls, on: float, off: float | None = None) -> Programme:
        """Up at ``on``, s, and down at ``off``; None: it stays up."""
        return cls.pulses([on], [] if off is None else [off])

    @classmethod
    def pulses(cls, on: Sequence[float], off: Sequence[float]) -> Programme:
        """Up at each ``on``, s, and down at each ``off``; the last pulse may stay up.

        >>> Programme.pulses([1.0, 5.0], [3.0]).heights.tolist()
        [1.0, -1.0, 1.0]
        """
        if len(on) - len(off) not in (0, 1):
            raise CampaignError(
                f"programme: expected an off for every on (but for the last), got {len(on)} on and "
                f"{len(off)} off; pair them"
            )
        times = np.empty(len(on) + len(off))
        times[::2], times[1::2] = on, off
        return cls.edges(times)

    @classmethod
    def edges(cls, times: Sequence[float] | FloatArray, up: bool = True) -> Programme:
        """Up and down in turn at ``times``, s; the first up, or down from full where not ``up``."""
        times = _rising(times)
        heights = np.where(np.arange(len(times)) % 2 == (0 if up else 1), 1.0, -1.0)
        return cls(times, heights, 0.0 if up else 1.0)

    @classmethod
    def steps(cls, steps: Iterable[tuple[float, float]], rest: float = 0.0) -> Programme:
        """A staircase of pairs (at s, to share), from ``rest``.

        >>> Programme.steps([(10.0, 0.4), (70.0, 1.0), (130.0, 0.0)]).heights.round(9).tolist()
        [0.4, 0.6, -1.0]
        """
        pairs = list(steps)
        levels = np.array([rest, *(to for _, to in pairs)], dtype=float)
        for i, (before, to) in enumerate(pairwise(levels.tolist()), 1):
            if to == before:
                raise CampaignError(
                    f"programme: step {i} goes to {to:g}, where it is already; leave it out"
                )
        return cls(_rising([at for at, _ in pairs]), np.diff(levels), rest)

    def at(self, times: Sequence[float] | FloatArray) -> Programme:
        """The same switches at other ``times`` (n_switches,) s, in any order."""
        return replace(self, times=np.asarray(times, dtype=float))

    def later(self, delay: float) -> Programme:
        """All switches ``delay`` s later."""
        return self.at(self.times + delay)

    @property
    def levels(self) -> FloatArray:
        """(n_switches,) share after each switch, in the order of time."""
        return self.rest + self.drive.level

    @property
    def drive(self) -> Drive:
        """The input above its rest."""
        order = np.argsort(self.times, kind="stable")
        return Drive.of(self.times[order], level=np.cumsum(self.heights[order]))

    @property
    def derivative(self) -> Drive:
        """The input's derivative: an impulse at each switch."""
        order = np.argsort(self.times, kind="stable")
        return Drive.of(self.times[order], kicks=self.heights[order])


@dataclass(frozen=True, eq=False)
class RecordedInput:
    """A recorded channel as the input itself: ramps from sample to sample, constant outside.

    >>> recorded = RecordedInput(np.array([0.0, 1.0, 3.0]), np.array([2.0, 2.0, 6.0]))
    >>> recorded.rest, recorded.drive.slope.tolist()
    (2.0, [0.0, 2.0, 0.0])
    """

    times: FloatArray
    """(n_samples,) s, rising"""
    values: FloatArray
    """(n_samples,) in any unit"""

    def __post_init__(self) -> None:
        times = _rising(self.times)
        values = np.ascontiguousarray(self.values, dtype=float)
        if values.shape != times.shape or len(times) < 2:
            raise CampaignError(
                "recorded input: expected two samples or more, a value for every time, got shapes "
                f"{times.shape} and {values.shape}"
            )
        if not np.isfinite(values).all():
            i = int(np.argmin(np.isfinite(values)))
            raise CampaignError(
                f"recorded input: sample {i + 1} (at {times[i]:.10g} s) is {values[i]}; expected a "
                "number: leave it out"
            )
        object.__setattr__(self, "times", times)
        object.__setattr__(self, "values", values)

    def later(self, delay: float) -> RecordedInput:
        """The same ``delay`` s later."""
        return replace(self, times=self.times + delay)

    @property
    def rest(self) -> float:
        """The value before the first sample."""
        return float(self.values[0])

    @property
    def _slope(self) -> FloatArray:
        return np.append(np.diff(self.values) / np.diff(self.times), 0.0)

    @property
    def drive(self) -> Drive:
        """The input above its rest."""
        return Drive.of(self.times, level=self.values - self.rest, slope=self._slope)

    @property
    def derivative(self) -> Drive:
        """The input's derivative, 1/s: a level between samples."""
        return Drive.of(self.times, level=self._slope)


def _rising(times: Sequence[float] | FloatArray) -> FloatArray:
    """The times (n,) s; CampaignError where one does not follow the one before."""
    found = np.ascontiguousarray(times, dtype=float)
    if not np.isfinite(found).all():
        i = int(np.argmin(np.isfinite(found)))
        raise CampaignError(f"time {i + 1} is {found[i]}; expected a number of seconds")
    check_rising(found)
    return found
