"""Whether two samplers drew from the same law."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from bayes_sensor.campaign import FloatArray
from bayes_sensor.io.json_files import plain
from bayes_sensor.likelihood.coordinates import Coordinates
from bayes_sensor.likelihood.problem import Problem
from bayes_sensor.posterior.convergence import R_HAT_LIMIT
from bayes_sensor.posterior.r_hat import r_hat_of_whole


@dataclass(frozen=True, eq=False)
class Agreement:
    """Draws that a sampler began from, beside its own."""

    sampler: str
    """whose draws it began from"""
    r_hat: FloatArray
    """(n_theta,) of two chains: all that it began from, and all of its own; nan for what does not
    vary"""
    parameters: Mapping[str, Mapping[str, float]]
    """rows of the shared parameters by the draws that it began from, as in posterior.json"""

    @property
    def worst(self) -> float:
        """The largest R-hat."""
        return float(np.nanmax(self.r_hat))

    @property
    def agrees(self) -> bool:
        """Whether no parameter tells the two from each other."""
        return self.worst < R_HAT_LIMIT

    def sentence(self, other: str) -> str:
        """What came out, for the sampler ``other`` that began from these draws."""
        if self.agrees:
            return (
                f"{other} began from draws of {self.sampler} and agrees with them: largest R-hat "
                f"between the two {self.worst:.4f}"
            )
        return (
            f"{other} began from draws of {self.sampler} and does not agree with them: largest "
            f"R-hat between the two {self.worst:.3f}, expected below {R_HAT_LIMIT:g}; the numbers "
            f"are those of {other}, without its first steps"
        )

    def to_json(self) -> dict[str, Any]:
        """What ``posterior.json`` holds of it."""
        return {
            "sampler": self.sampler,
            "agrees": self.agrees,
            "r_hat": plain(self.worst),
            "parameters": {name: dict(row) for name, row in self.parameters.items()},
        }


def r_hat_between(problem: Problem, first: FloatArray, second: FloatArray) -> FloatArray:
    """Rank R-hat (n_theta,) of two sets of draws, each (.., n_theta), as two chains.

    The longer one is thinned evenly to the length of the other.  Equal laws of which n draws count
    have an R-hat of about 1 + 1/(2 n); means a fifth of a standard deviation apart have 1.01.
    """
    rows = [draws.reshape(-1, draws.shape[-1]) for draws in (first, second)]
    n = min(len(draws) for draws in rows)
    even = [draws[np.linspace(0, len(draws) - 1, n).astype(int)] for draws in rows]
    found = np.full(first.shape[-1], np.nan)
    free = Coordinates(problem).free
    found[free] = r_hat_of_whole(np.stack(even)[:, :, free])
    return found
