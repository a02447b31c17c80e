"""When the input of a record switches, as parameters: which there are, and the input at them."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from bayes_sensor.campaign import Experiment, FloatArray
from bayes_sensor.rig.chain import Drive
from bayes_sensor.rig.programme import Programme, RecordedInput

PULSE = ("t0_s", "tf_s")
DELAYS = ("delay_on_s", "delay_off_s")
DELAY = "delay_s"


def is_switch_time(kind: str) -> bool:
    """Whether a parameter's name, without its record, is that of a switch time or delay.

    >>> [is_switch_time(kind) for kind in ("tf_s", "t12_s", "delay_s", "tau_s")]
    [True, True, True, False]
    """
    return kind in (*PULSE, *DELAYS, DELAY) or re.fullmatch(r"t\d+_s", kind) is not None


@dataclass(frozen=True)
class Switching:
    """The parameters that move the switches of one record.

    A pulse has ``t0_s`` and, where a step down was recorded, ``tf_s``.  A longer programme has a
    time for each switch, ``t1_s``, ``t2_s``, .., or one delay for all switches up and one for all
    switches down.  A recorded input has one delay.

    >>> Switching.pulse(True).names
    ('t0_s', 'tf_s')
    """

    names: tuple[str, ...]
    """of the parameters, without the record's"""
    moves: tuple[int, ...]
    """(n_switches,) which parameter moves each switch; empty for a recorded input"""
    offsets: tuple[float, ...]
    """(n_switches,) s, what is added to that parameter: 0, or the commanded time"""
    heights: tuple[float, ...]
    """(n_switches,) change of the input at each"""
    rest: float = 0.0
    """input before the first switch"""
    recorded: RecordedInput | None = field(default=None, compare=False)
    """the input itself, where it was recorded"""

    @classmethod
    def pulse(cls, has_fall: bool) -> Switching:
        """One step up and, where ``has_fall``, one down."""
        n = 1 + has_fall
        return cls(PULSE[:n], tuple(range(n)), (0.0,) * n, (1.0, -1.0)[:n])

    @classmethod
    def of(cls, e: Experiment) -> Switching:
        """The switches of an experiment's record."""
        done = e.commands
        if done is None:
            return cls.pulse(e.has_fall)
        if done.recorded:
            return cls((DELAY,), (), (), (), recorded=RecordedInput(done.times, done.levels))
        heights = tuple(done.heights.tolist())
        n = len(heights)
        if done.delays == "free":
            names = tuple(f"t{i}_s" for i in range(1, n + 1))
            return cls(names, tuple(range(n)), (0.0,) * n, heights, done.rest)
        up = [height > 0.0 for height in heights]
        names = tuple(name for name, there in zip(DELAYS, (any(up), not all(up))) if there)
        moves = tuple(names.index(DELAYS[0] if each else DELAYS[1]) for each in up)
        return cls(names, moves, tuple(done.times.tolist()), heights, done.rest)

    @property
    def is_pulse(self) -> bool:
        """Whether it is one step up and at most one down, with times of their own."""
        return self.names == PULSE[: len(self.names)]

    @property
    def level_before(self) -> float:
        """Input before everything."""
        return self.rest if self.recorded is None else self.recorded.rest

    def times(self, values: Sequence[float] | FloatArray) -> FloatArray:
        """(n_switches,) s at ``values`` (n_parameters,) of the parameters."""
        found: FloatArray = np.asarray(self.offsets) + np.asarray(values, dtype=float)[self.places]
        return found

    def drive(self, values: FloatArray) -> Drive:
        """The input above :attr:`level_before` at ``values`` (n_parameters,)."""
        if self.recorded is not None:
            return self.recorded.later(float(values[0])).drive
        if len(self.names) == 1 and self.is_pulse:
            return Drive(np.array(values[:1]), _NOTHING[:1], _UP, _NOTHING[:1])
        if self.is_pulse and values[0] <= values[1]:
            return Drive(np.array(values[:2]), _NOTHING, _UP_DOWN, _NOTHING)
        return self.programme(values).drive

    def derivative(self, values: FloatArray) -> Drive:
        """The input's derivative at ``values`` (n_parameters,)."""
        if self.recorded is not None:
            return self.recorded.later(float(values[0])).derivative
        return self.programme(values).derivative

    def programme(self, values: FloatArray) -> Programme:
        """The switches at ``values`` (n_parameters,)."""
        return Programme(self.times(values), np.asarray(self.heights), self.rest)

    @property
    def places(self) -> NDArray[np.int64]:
        """(n_switches,) which parameter moves each switch."""
        return np.array(self.moves, dtype=np.int64)


def input_range(inputs: Sequence[Switching]) -> tuple[float, float]:
    """Lowest and highest level of several inputs.

    >>> input_range([Switching.pulse(True)])
    (0.0, 1.0)
    """
    levels: list[float] = []
    for each in inputs:
        if each.recorded is not None:
            levels += each.recorded.values.tolist()
        else:
            levels += [each.rest, *(each.rest + np.cumsum(each.heights)).tolist()]
    return min(levels), max(levels)


_NOTHING, _UP, _UP_DOWN = np.zeros(2), np.ones(1), np.array([1.0, 0.0])
