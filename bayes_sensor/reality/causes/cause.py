"""What a cause is, how a place of the rig lists its own, and what several of them need."""

from __future__ import annotations

import zlib
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from bayes_sensor.campaign import FloatArray
from bayes_sensor.reality.knobs import Course, Knobs
from bayes_sensor.reality.records import Case

Rig = dict[str, Knobs]
Apply = Callable[[Rig, float, np.random.Generator, Case], None]


@dataclass(frozen=True)
class Cause:
    """One thing that can go wrong."""

    name: str
    listed_as: tuple[str, ...]
    family: str
    """what it resembles: causes of one family are hard to tell apart"""
    unit: str
    """of the strength"""
    highest: float
    """the largest strength that is still plausible in a laboratory"""
    turn: Apply
    near: tuple[str, ...] = ()
    """names that would not be wrong, although the catalogue's form does not cover the cause"""
    per_experiment: bool = False
    """whether its size differs from experiment to experiment"""
    fast: bool = False
    """whether it oscillates faster than the response moves"""
    noise: bool = False
    """whether it changes the noise and leaves the mean alone"""
    reserve: bool = False
    """kept out of every run but the last"""

    @property
    def listed(self) -> bool:
        """Whether the catalogue has a name for it."""
        return bool(self.listed_as)

    def generator(self, case: Case) -> np.random.Generator:
        """Where its own choices come from."""
        return np.random.default_rng([case.seed, zlib.crc32(self.name.encode())])

    def apply(self, rig: Rig, strength: float, case: Case) -> None:
        """Turn the knobs of ``rig``; nothing happens at strength 0."""
        if strength != 0.0:
            self.turn(rig, float(strength), self.generator(case), case)


class Causes(dict[str, Cause]):
    """Causes by name, in the order in which they are written down."""

    def cause(
        self,
        listed_as: tuple[str, ...],
        family: str,
        unit: str,
        highest: float,
        near: tuple[str, ...] = (),
        **flags: bool,
    ) -> Callable[[Apply], Apply]:
        """Register the decorated function under its own name."""

        def register(turn: Apply) -> Apply:
            name = turn.__name__
            self[name] = Cause(name, listed_as, family, unit, highest, turn, near, **flags)
            return turn

        return register


def _sign(rng: np.random.Generator) -> float:
    return 1.0 if rng.random() < 0.5 else -1.0


def _between(rng: np.random.Generator, low: float, high: float) -> float:
    """Uniform in the logarithm."""
    return float(np.exp(rng.uniform(np.log(low), np.log(high))))


def _begins(case: Case) -> FloatArray:
    """s (n + 1,) at which records begin that follow each other, and the last one's end."""
    return np.cumsum([0.0, *(step.duration for step in case.steps)])


def _mean_step(case: Case) -> float:
    """V, the campaign's mean step."""
    return float(np.mean([abs(step.beta) for step in case.steps]))


def _interpolated(times: FloatArray, values: FloatArray) -> Course:
    return lambda t: np.asarray(np.interp(t, times, values), dtype=float)
