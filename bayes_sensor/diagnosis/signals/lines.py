"""Signal: a line of unlisted origin, as of a pump or a controller."""

from __future__ import annotations

from collections.abc import Sequence

from bayes_sensor.campaign import Campaign
from bayes_sensor.diagnosis.data.quiet_stretches import Stretch
from bayes_sensor.diagnosis.signals.periodograms import (
    LOWEST_LINE,
    LineSearch,
    find_line,
    pieces_of_stretches,
)
from bayes_sensor.diagnosis.signals.signal import Finding, Samples, Signal, any_of

FASTER_THAN_BINS = 1.0
"""Hz from which a line averages out of the bins: what explains the mean has no part in it"""


def look_for_lines(campaign: Campaign, stretches: Sequence[Stretch]) -> list[Finding]:
    """A line in all quiet stretches, or in the plateaus alone (of a pump or a controller)."""
    pieces = pieces_of_stretches(campaign, stretches)
    everywhere = find_line(pieces, LINES)
    plateaus = find_line([p for p in pieces if p.group == 1], LINES)
    if not everywhere or not plateaus:
        return everywhere or plateaus
    return [any_of([everywhere[0], plateaus[0]])]


def _words(found: Finding, names: Sequence[str], unit: str) -> str:
    s = found.strength
    return (
        f"There is a line of unlisted origin at {s['line_Hz']:.4g} Hz with an amplitude "
        f"of {1e3 * s['line_V']:.3g} m{unit}."
    )


def _look(samples: Samples) -> list[Finding]:
    return look_for_lines(samples.campaign, samples.stretches)


SIGNAL = Signal(
    "line", 0.02, {"line_V": "V", "line_Hz": "Hz"}, _words, _look,
    spares_means_from_hz=FASTER_THAN_BINS, by_frequency=True,
)  # fmt: skip
LINES = LineSearch(SIGNAL, "line", slowest=LOWEST_LINE, at_half_rate=True)
