"""Signal: a slow swing, as of a thermostat or a pressure controller."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

from bayes_sensor.campaign import Campaign, FloatArray
from bayes_sensor.diagnosis.signals.periodograms import LineSearch, find_line, pieces_of_records
from bayes_sensor.diagnosis.signals.signal import Finding, Samples, Signal

FASTEST_SWING = 1.0
"""Hz; whole records are looked at below, where stretches are too short"""
SWING_BLOCK = 0.05
"""s, means over which swings are looked for"""


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


def _words(found: Finding, names: Sequence[str], unit: str) -> str:
    s = found.strength
    return (
        f"The signal swings slowly, once in {1.0 / s['swing_Hz']:.3g} s, with an amplitude of "
        f"{1e3 * s['swing_V']:.3g} m{unit}."
    )


def _look(samples: Samples) -> list[Finding]:
    return look_for_slow_lines(samples.campaign, samples.residuals, samples.deviations)


SIGNAL = Signal("swing", 0.02, {"swing_V": "V", "swing_Hz": "Hz"}, _words, _look, by_frequency=True)
SLOW_LINES = LineSearch(SIGNAL, "swing", fastest=FASTEST_SWING, sloping=True)
