"""The record of the number of lags that a campaign supports."""

from __future__ import annotations

from dataclasses import dataclass
from math import exp
from typing import Any

from bayes_sensor.rig.lags import DECIDED

WORDS = ("no", "one", "two", "three", "four", "five", "six")


@dataclass(frozen=True)
class LagCount:
    """The number of lags that the data support."""

    supported: int
    """the least number against which more do not have odds of 19 to 1"""
    log_evidence: dict[int, float]
    """by number of lags, of the best chain of each; the highest is 0"""
    stages: dict[int, tuple[str, ...]]
    """by number of lags, the best chain as ``[rig] stages``"""
    present: int
    """lags of the campaign's own rig"""
    missed: bool = False
    """whether the campaign's rig misses the data by more than their noise"""

    @property
    def sentence(self) -> str:
        """What the data support, and how to write it."""
        if self.missed and self.supported <= self.present:
            return (
                f"{self._words}; but the model misses the data by more than their noise, so do not "
                "rely on this number before that is mended"
            )
        return self._words

    @property
    def _words(self) -> str:
        n, words = self.supported, WORDS[self.supported]
        stages = ", ".join(f'"{stage}"' for stage in self.stages[n])
        write = f"[rig] stages = [{stages}]"
        lags = f"{words} lag{'s' if n > 1 else ''}"
        suffice = f"{lags} suffice{'' if n > 1 else 's'}"
        if n < self.present:
            rest = "a further one is too short to be seen"
            return f"{suffice} for these data; {rest}. If the rig has no other, write {write}"
        if n > self.present:
            return (
                f"at least {lags} are needed: the rig of the campaign has "
                f"{WORDS[self.present]}; write {write} (another shape of the response may also "
                "be the cause)"
            )
        if n > 1:
            most = n == max(self.log_evidence)
            return f"at least {lags} are needed" + ("" if most else f", and {words} suffice")
        return suffice

    def to_json(self) -> dict[str, Any]:
        """Plain numbers, a text for each number of lags."""
        return {
            "supported": self.supported,
            "log_evidence": {str(n): value for n, value in self.log_evidence.items()},
            "stages": {str(n): list(stages) for n, stages in self.stages.items()},
            "sentence": self.sentence,
        }


def supported(evidence: dict[int, float]) -> int:
    """The least number of lags against which more do not have a probability of ``DECIDED``.

    ``evidence``: log evidence by number of lags.

    >>> supported({1: -40.0, 2: 0.0, 3: -2.0}), supported({1: 0.0, 2: 1.0})
    (2, 1)
    """
    numbers = sorted(evidence)
    highest = max(evidence.values())
    weights = [exp(evidence[n] - highest) for n in numbers]
    for i, n in enumerate(numbers):
        rest = sum(weights[i:])
        if sum(weights[i + 1 :]) < DECIDED * rest:
            return n
    return numbers[-1]
