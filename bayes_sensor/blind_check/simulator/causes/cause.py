"""What a cause is, and how a place of the rig lists its own."""

from __future__ import annotations

import zlib
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.random import Generator

from bayes_sensor.blind_check.simulator.case import Case
from bayes_sensor.blind_check.simulator.simulated_rig import Rig

Turn = Callable[[Rig, float, Generator, Generator], None]
"""Changes the rig of one experiment, given the strength and where random choices come from: first
those that all experiments share (the same numbers for each), then the experiment's own."""


@dataclass(frozen=True)
class Cause:
    """One thing that can go wrong."""

    name: str
    listed_as: tuple[str, ...]
    """names in the catalogue of effects that are a right answer, most fitting first"""
    family: str
    """what it resembles: causes of one family are hard to tell apart"""
    unit: str
    """of the strength"""
    highest: float
    """the largest strength that is still plausible in a laboratory"""
    turn: Turn
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

    @property
    def place(self) -> str:
        """Part of the rig where it acts: valve, flow, manifold, sensor, readout, electronics."""
        return self.turn.__module__.rsplit(".", 1)[-1]

    def generator(self, case: Case, *number: int) -> Generator:
        """Where its choices come from: the shared ones, or with a ``number`` (> 0) others."""
        return np.random.default_rng([case.seed, zlib.crc32(self.name.encode()), *number])

    def apply(self, rig: Rig, strength: float) -> None:
        """Change the rig of one experiment; nothing happens at strength 0."""
        if strength != 0.0:
            shared, own = self.generator(rig.case), self.generator(rig.case, 1 + rig.number)
            self.turn(rig, float(strength), shared, own)


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
    ) -> Callable[[Turn], Turn]:
        """Register the decorated function under its own name."""

        def register(turn: Turn) -> Turn:
            name = turn.__name__
            self[name] = Cause(name, listed_as, family, unit, highest, turn, near, **flags)
            return turn

        return register


def random_sign(rng: Generator) -> float:
    """1 or -1."""
    return 1.0 if rng.random() < 0.5 else -1.0


def log_uniform(rng: Generator, low: float, high: float) -> float:
    """Uniform in the logarithm."""
    return float(np.exp(rng.uniform(np.log(low), np.log(high))))
