"""The share of a gap that an explanation closes, with its interval."""

from __future__ import annotations

from dataclasses import dataclass

VISIBLE = 3.0
"""size of a gap, in standard deviations of the noise, below which no fraction is given"""


@dataclass(frozen=True)
class Closure:
    """How much of the gap an explanation closes; None where the gap is too small to divide by."""

    fraction: float | None
    low: float | None
    high: float | None
    """of the 95 % interval"""
    before_V: float
    after_V: float
    d_before: float
    d_after: float

    @property
    def withheld(self) -> bool:
        """Whether no fraction is given."""
        return self.fraction is None


@dataclass(frozen=True)
class HeldOut:
    """Closed fraction of data that were not fitted to, with its 95 % interval.

    The fraction may pass one, since noise is only taken off on average; nothing closes more than
    a gap, so that the interval ends at one then, or at the fraction.
    """

    fraction: float
    low: float
    high: float
