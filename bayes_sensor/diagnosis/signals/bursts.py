"""Detector of bursts: the mains come and go, as a heater's do that is fired in bursts."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from scipy.special import logsumexp

from bayes_sensor.campaign import Campaign, FloatArray
from bayes_sensor.diagnosis.signals.periodograms import (
    FEWEST_CYCLES,
    MAINS,
    Piece,
    commonest,
    leakage_reach,
    log_bayes_factors,
    mains_bands,
    pieces_of_records,
    sum_over_pieces,
)
from bayes_sensor.diagnosis.signals.signal import FOUND, Finding, Samples, Signal

ALL_HARMONICS = 20
"""of the mains that are no sign of bursts"""
BURSTS = (0.2, 5.0)
"""Hz; how often the mains may come and go"""
LEAKED = 0.1
"""of the noise's power; what a window may leave of the mains where their bursts are looked for"""


def look_for_bursts(
    campaign: Campaign,
    residuals: Sequence[FloatArray],
    deviations: Sequence[FloatArray],
    mains: Finding,
) -> list[Finding]:
    """Whether the ``mains`` that were found are switched on and off periodically.

    A modulated line has side bands at equal distances above and below.  The Bayes factor of a line,
    for both side bands together, is averaged over distances with the weight 1/distance.  Empty
    where no mains were found or records are too short.
    """
    if mains.probability < FOUND:
        return []
    return find_bursts(pieces_of_records(campaign, residuals, deviations))


def find_bursts(pieces: Sequence[Piece]) -> list[Finding]:
    used, n, f = commonest(pieces)
    total, _ = sum_over_pieces(used, n)
    near, nominal, _ = mains_bands(f, used[0].interval)
    k = len(used)
    at = int(np.argmax(np.where(near, total, 0.0)))
    seconds = max(len(p.samples) for p in used) * used[0].interval
    least = max(2.0 / seconds, leakage_reach(float(total[at]) / k / LEAKED, seconds))
    first = max(BURSTS[0], FEWEST_CYCLES / seconds, least)
    away = np.arange(int(np.ceil(first / f[1])), int(BURSTS[1] / f[1]) + 1)
    away = away[away < at]
    below, above = at - away, at + away
    above = np.where(above < len(f), above, 2 * (len(f) - 1) - above)  # folded at half the rate
    rate = 1.0 / used[0].interval
    harmonics = _harmonics(float(f[at]), float(nominal[at]), rate)
    clear = [np.abs(f[there, None] - harmonics) > least for there in (below, above)]
    seen = np.all(clear[0] & clear[1], axis=1)
    away, below, above = away[seen], below[seen], above[seen]
    if not len(away):
        return []
    apart = np.abs(above - below) * f[1] * seconds > 1.0  # where they fold onto each other, one
    # one alone would be another line
    power = np.where(apart, 2.0 * np.minimum(total[below], total[above]), total[below])
    count = k * (1 + apart)
    each = log_bayes_factors(power, count)
    weight = (1.0 / away) / np.sum(1.0 / away)
    value, most = float(logsumexp(each, b=weight)), int(np.argmax(each + np.log(weight)))
    return [Finding(SIGNAL, value, {"bursts_Hz": float(f[away[most]])}, None)]


def _harmonics(found: float, nominal: float, rate: float) -> FloatArray:
    """Hz (n,) where the mains and their harmonics fold at half the sampling ``rate`` Hz.

    ``found``: Hz of the line that is at ``nominal`` Hz where the mains are at 50 or 60 Hz.
    """
    turns = round(nominal / rate)
    line = rate * turns + (found if nominal >= rate * turns else -found)
    made = [line * h / round(nominal / m) for m in MAINS for h in range(1, ALL_HARMONICS + 1)
            if nominal % m == 0.0]  # fmt: skip
    true = np.array(made)
    folded: FloatArray = np.abs(true - rate * np.round(true / rate))
    return folded


def _words(found: Finding, names: Sequence[str], unit: str) -> str:
    return (
        f"The mains come and go, once in {1.0 / found.strength['bursts_Hz']:.3g} s, as of a heater "
        "that is fired in bursts."
    )


def _look(samples: Samples) -> list[Finding]:
    mains = samples.of("mains_pickup")
    if mains is None:
        return []
    return look_for_bursts(samples.campaign, samples.residuals, samples.deviations, mains)


SIGNAL = Signal(
    "bursts", 0.01, {"bursts_Hz": "Hz"}, _words, _look, spares_means_from_hz=0.0, by_frequency=True
)
