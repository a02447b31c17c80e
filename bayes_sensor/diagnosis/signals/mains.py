"""Signal: the mains, lines at 50 or 60 Hz and their harmonics.

Averaging over bins hides them; they are looked for in the periodograms of whole records, with the
frequency estimated.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

from bayes_sensor.campaign import Campaign, FloatArray
from bayes_sensor.diagnosis.signals import lines
from bayes_sensor.diagnosis.signals.periodograms import (
    LOWEST_LINE,
    LineSearch,
    find_line,
    pieces_of_records,
)
from bayes_sensor.diagnosis.signals.signal import Finding, Samples, Signal


def look_for_mains(
    campaign: Campaign, residuals: Sequence[FloatArray], deviations: Sequence[FloatArray]
) -> list[Finding]:
    """The mains in ``residuals`` (n_t,) V of whole records, over which they keep their phase.

    ``deviations`` (n_t,) V: of the noise.
    """
    return find_line(pieces_of_records(campaign, residuals, deviations), SEARCH)


def _as_a_line(found: Finding) -> Finding:
    """Where the mains are not in the catalogue, theirs is a line like any other."""
    s = found.strength
    return replace(
        found, signal=lines.SIGNAL, strength={"line_V": s["mains_V"], "line_Hz": s["mains_Hz"]}
    )


def _words(found: Finding, names: Sequence[str], unit: str) -> str:
    s = found.strength
    return (
        f"There is a line of the mains at {s['mains_Hz']:.4g} Hz with an amplitude of "
        f"{1e3 * s['mains_V']:.3g} m{unit}."
    )


def _look(samples: Samples) -> list[Finding]:
    return look_for_mains(samples.campaign, samples.residuals, samples.deviations)


SIGNAL = Signal(
    "mains_pickup", 0.03, {"mains_V": "V", "mains_Hz": "Hz"}, _words, _look, listed=True,
    if_not_listed=_as_a_line, by_frequency=True,
)  # fmt: skip
SEARCH = LineSearch(SIGNAL, "mains", of_the_mains=True, slowest=LOWEST_LINE)
