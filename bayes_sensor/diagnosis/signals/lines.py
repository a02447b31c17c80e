"""Detectors of lines of unlisted origin: a pump's or a controller's, and slow ones."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

from bayes_sensor.campaign import Campaign, FloatArray
from bayes_sensor.diagnosis.data.quiet_stretches import Stretch
from bayes_sensor.diagnosis.signals.finding import Finding, Signal, any_of
from bayes_sensor.diagnosis.signals.periodograms import (
    LOWEST_LINE,
    LineSearch,
    find_line,
    pieces_of_records,
    pieces_of_stretches,
)

FASTEST_SWING = 1.0
"""Hz; whole records are looked at below, where stretches are too short"""
SWING_BLOCK = 0.05
"""s, means over which swings are looked for"""
FASTER_THAN_BINS = 1.0
"""Hz from which a line averages out of the bins: what explains the mean has no part in it"""


def _of_a_line(found: Finding, names: Sequence[str], unit: str) -> str:
    s = found.strength
    return (
        f"There is a line of unlisted origin at {s['line_Hz']:.4g} Hz with an amplitude "
        f"of {1e3 * s['line_V']:.3g} m{unit}."
    )


def _of_a_slow_line(found: Finding, names: Sequence[str], unit: str) -> str:
    s = found.strength
    return (
        f"The signal swings slowly, once in {1.0 / s['swing_Hz']:.3g} s, with an amplitude of "
        f"{1e3 * s['swing_V']:.3g} m{unit}."
    )


LINE = Signal(
    "line", 0.02, {"line_V": "V", "line_Hz": "Hz"}, _of_a_line,
    spares_means_from_hz=FASTER_THAN_BINS,
)  # fmt: skip
SLOW_LINE = Signal("swing", 0.02, {"swing_V": "V", "swing_Hz": "Hz"}, _of_a_slow_line)

LINES = LineSearch(LINE, "line", slowest=LOWEST_LINE, at_half_rate=True)
SLOW_LINES = LineSearch(SLOW_LINE, "swing", fastest=FASTEST_SWING, sloping=True)


def look_for_lines(campaign: Campaign, stretches: Sequence[Stretch]) -> list[Finding]:
    """A line in all quiet stretches, or in the plateaus alone (of a pump or a controller)."""
    pieces = pieces_of_stretches(campaign, stretches)
    everywhere = find_line(pieces, LINES)
    plateaus = find_line([p for p in pieces if p.group == 1], LINES)
    if not everywhere or not plateaus:
        return everywhere or plateaus
    return [any_of([everywhere[0], plateaus[0]])]


def look_for_slow_lines(
    campaign: Campaign, residuals: Sequence[FloatArray], deviations: Sequence[FloatArray]
) -> list[Finding]:
    """A slow line (of a thermostat or a pressure controller) in the residual of an explanation.

    ``residuals`` (n_t,) V and ``deviations`` (n_t,) V of whole records: a quiet stretch holds too
    few cycles of it, and its floor includes them.
    """
    found = []
    for piece in pieces_of_records(campaign, residuals, deviations):
        size = max(1, round(SWING_BLOCK / piece.interval))
        n = len(piece.samples) // size
        samples, weights = (
            v[: n * size].reshape(n, size).mean(axis=1) for v in (piece.samples, piece.weights)
        )
        found.append(replace(piece, samples=samples, weights=weights,
                             interval=size * piece.interval))  # fmt: skip
    return find_line(found, SLOW_LINES)
