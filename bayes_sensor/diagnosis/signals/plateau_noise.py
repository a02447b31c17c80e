"""Detector: excess slow noise on the plateaus.

The noise on the plateaus is part of the noise floor, so unsteady gas (drops that boil off, eddies,
light on the cell) is taken for noise there.  Noise of the light source and of the receiver is
present on the baseline, too, with the same spectrum at another level.  Fluctuations that come with
the gas pass the manifold and the sensor and are slow.  The test compares the low-frequency power of
plateaus and baseline, each relative to its own power at higher frequencies.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from bayes_sensor.campaign import Campaign, FloatArray
from bayes_sensor.diagnosis.data.quiet_stretches import Stretch, detrended, periodogram
from bayes_sensor.diagnosis.signals.events import HEAVY_DOF
from bayes_sensor.diagnosis.signals.signal import Finding, Samples, Signal, struck

EDGES = np.array([0.0, 0.125, 0.25, 0.5, 1.0, 2.0, 4.0, 8.0])
"""Hz, bands of the baseline's spectrum"""
REFERENCE = (8.0, 16.0)
"""Hz, where baseline and plateaus are compared"""
FEWEST = 8
"""ordinates in the reference band below which a record's level is not known"""
FIRST = 2.6
"""periods in a stretch from which detrending leaves a frequency alone"""
INDEPENDENT = 0.85
"""share of a tapered spectrum's ordinates that are independent"""
EXCESSES = np.array([0.6, 1.2, 2.5, 5.0, 10.0, 20.0, 40.0])
"""plausible excess of power at the lowest frequencies, over the noise's"""
CUTOFFS = np.array([0.1, 0.2, 0.4, 0.8])
"""Hz, above which the excess falls off as the square of the frequency"""
STRUCK = 0.5
"""plausible share of records with an excess, where it differs between them"""
LEAN = 6.0
"""ordinates that known bands above are worth in a band of the baseline's spectrum"""
BASELINE_SD = 0.12
"""of the logarithm of the baseline's spectrum below a hertz or so, besides its ordinates' own"""
RECORDS = ((0.4, 1.0, 0.8), (1.0, 1.0, 0.05), (2.0, 1.0, 0.05), (1.0, 4.0, 0.05), (2.0, 4.0, 0.05))
"""how noise that is not stationary differs from record to record: standard deviation of its
logarithm, Hz below which it does, and how plausible that is"""
STEP = 0.35
"""of the logarithm of a record's slow noise, from node to node"""
# close enough together for spectra of hundreds of ordinates, between which Gauss's nodes would fall
_NODES = np.linspace(-3.0, 3.0, 9)
_LOG_WEIGHTS = -0.5 * _NODES**2 - np.logaddexp.reduce(-0.5 * _NODES**2)


@dataclass(frozen=True)
class Ordinates:
    frequency: FloatArray
    """(n,) Hz"""
    power: FloatArray
    """(n,) over the mean in the reference band of the same record and level"""

    @cached_property
    def band(self) -> NDArray[np.int64]:
        """(n,) indices among the bands."""
        found: NDArray[np.int64] = np.searchsorted(EDGES, self.frequency, side="right") - 1
        return found

    @cached_property
    def more(self) -> FloatArray:
        """(n, n_excesses, n_cutoffs) power with each excess over that without."""
        shape = 1.0 / (1.0 + (self.frequency[:, None] / CUTOFFS) ** 2)
        found: FloatArray = 1.0 + EXCESSES[None, :, None] * shape[:, None, :]
        return found

    @cached_property
    def explained(self) -> tuple[FloatArray, FloatArray]:
        """(n, n_more) share of the power that each excess makes up, (n_more,) what it costs."""
        flat = self.more.reshape(len(self.power), -1)
        return 1.0 - 1.0 / flat, np.log(flat).sum(axis=0)


def look_for_plateau_noise(campaign: Campaign, stretches: Sequence[Stretch]) -> list[Finding]:
    """Excess slow power on the plateaus over the baseline; empty where one of them is too short.

    Ordinates of the spectra are exponential about their mean (Whittle).  ``ln B`` averages over the
    excess and its cutoff, alike in all records or different in each; with and without it, over
    how far off the baseline's spectrum is, over each record's own slow noise, and over how unlike
    records are, of which the baseline has its say.  ``strength``: excess over the noise's power,
    and the cutoff in Hz, at the likeliest.
    """
    carrier, plateaus = _ordinates(campaign, stretches)
    plateaus = _as_slow_as(carrier, plateaus)
    if not plateaus:
        return []
    spectrum, spread = _baseline(carrier)
    without, alike, apart = [], [], []
    for sd, slow, plausible in RECORDS:
        # the baseline tells how unlike records are
        usual = np.log(plausible) + sum(
            float(np.logaddexp.reduce(_without(o, spectrum[o.band], sd, slow)[0])) for o in carrier
        )
        for node, log_weight in zip(_NODES, _LOG_WEIGHTS, strict=True):
            level = spectrum * np.exp(node * spread)
            told = [record_evidence(o, level[o.band], sd, slow) for o in plateaus]
            nothing = float(usual + log_weight) + sum(n for n, _ in told)
            gains = np.array([g for _, g in told])  # (n_records, n_excesses, n_cutoffs)
            without.append(nothing)
            alike.append(nothing + gains.sum(axis=0))
            in_each = struck(np.logaddexp.reduce(gains, axis=1) - np.log(len(EXCESSES)), STRUCK)
            apart.append(nothing + in_each.sum(axis=0))
    same = np.logaddexp.reduce(alike, axis=0)
    value = np.logaddexp(_mean(same), _mean(np.logaddexp.reduce(apart, axis=0))) - np.log(2.0)
    i, j = np.unravel_index(int(np.argmax(same)), same.shape)
    strength = {"unsteady_excess": float(EXCESSES[i]), "unsteady_Hz": float(CUTOFFS[j])}
    return [Finding(SIGNAL, float(value - np.logaddexp.reduce(without)), strength, None)]


def _mean(logs: FloatArray) -> float:
    return float(np.logaddexp.reduce(logs, axis=None) - np.log(logs.size))


def _ordinates(
    campaign: Campaign, stretches: Sequence[Stretch]
) -> tuple[list[Ordinates], list[Ordinates]]:
    """Of the carrier gas alone and of the plateaus, record by record."""
    spectra: dict[tuple[int, int], list[tuple[FloatArray, FloatArray, float]]] = {}
    for s in stretches:
        interval = campaign.experiments[s.experiment].interval
        f, power = periodogram(detrended(s.samples, 4), interval)
        seconds = len(s.samples) * interval
        spectra.setdefault((s.level, s.experiment), []).append((f, power, FIRST / seconds))
    carrier: list[Ordinates] = []
    plateaus: list[Ordinates] = []
    for (level, _), found in sorted(spectra.items()):
        high = np.concatenate([p[(f >= REFERENCE[0]) & (f < REFERENCE[1])] for f, p, _ in found])
        if len(high) < FEWEST or high.mean() <= 0.0:
            continue
        low = [(f >= first) & (f < EDGES[-1]) for f, _, first in found]
        made = Ordinates(
            np.concatenate([f[m] for (f, _, _), m in zip(found, low, strict=True)]),
            np.concatenate([p[m] for (_, p, _), m in zip(found, low, strict=True)]) / high.mean(),
        )
        (plateaus if level else carrier).append(made)
    return carrier, plateaus


def _as_slow_as(carrier: Sequence[Ordinates], plateaus: Sequence[Ordinates]) -> list[Ordinates]:
    """The plateaus as far down as the baseline shows: below, its noise may rise."""
    lowest = min((float(o.frequency.min()) for o in carrier if len(o.frequency)), default=np.inf)
    shown = [o.frequency >= lowest for o in plateaus]
    return [
        Ordinates(o.frequency[m], o.power[m])
        for o, m in zip(plateaus, shown, strict=True) if m.any()
    ]  # fmt: skip


def _baseline(carrier: Sequence[Ordinates]) -> tuple[FloatArray, FloatArray]:
    """(n_bands,) the baseline's spectrum, and the standard deviation of its logarithm.

    Where a band holds few ordinates it leans on those above it, continued at their slope: noise
    with a 1/f spectrum rises further, while noise that is correlated for a while has levelled off.
    """
    n = len(EDGES) - 1
    band = np.concatenate([o.band for o in carrier])
    each = np.concatenate([o.power for o in carrier])
    count, power = np.bincount(band, minlength=n), np.bincount(band, each, minlength=n)
    spectrum, variance = np.ones(n), np.zeros(n)
    above, slope, uncertain = 1.0, 1.0, 0.0  # of the band above
    for b in reversed(range(n)):
        lean = 1.0 / (1.0 / LEAN + uncertain)
        spectrum[b] = (power[b] + lean * above * slope) / (count[b] + lean)
        uncertain = variance[b] = 1.0 / (count[b] + lean)
        above, slope = spectrum[b], max(spectrum[b] / above, 1.0)
    return spectrum, np.sqrt(variance + BASELINE_SD**2)


def _without(
    o: Ordinates, expected: FloatArray, sd: float, slow: float
) -> tuple[FloatArray, FloatArray]:
    """(n_nodes,) ln likelihood of a record and each size of its slow noise, (n_nodes, n) ratios.

    ``expected`` (n,); its noise below ``slow`` Hz has another size, by a normal law of ``sd`` for
    the logarithm.  Ratios are of its power to what is then expected.
    """
    nodes = np.linspace(-4.0, 4.0, 2 * int(np.ceil(4.0 * sd / STEP)) + 1)
    log_weights = -0.5 * nodes**2 - np.logaddexp.reduce(-0.5 * nodes**2)
    lifts = nodes[:, None] * sd / (1.0 + (o.frequency / slow) ** 2)  # (n_nodes, n)
    ratio = o.power / expected * np.exp(-lifts)
    here = log_weights - INDEPENDENT * np.sum(np.log(expected) + lifts + ratio, axis=1)
    return here, ratio


def record_evidence(
    o: Ordinates, expected: FloatArray, sd: float, slow: float
) -> tuple[float, FloatArray]:
    """ln likelihood of one record without an excess, and what each excess and cutoff adds."""
    here, ratio = _without(o, expected, sd, slow)
    share, cost = o.explained
    nothing = float(np.logaddexp.reduce(here))
    within = (
        np.logaddexp.reduce(here[:, None] + INDEPENDENT * (ratio @ share - cost), axis=0) - nothing
    )
    return nothing, within.reshape(o.more.shape[1:])


def _words(found: Finding, names: Sequence[str], unit: str) -> str:
    s = found.strength
    return (
        "With gas the signal is less steady than its noise on the baseline lets expect: below "
        f"about {s['unsteady_Hz']:.2g} Hz it has {1.0 + s['unsteady_excess']:.2g} times the "
        "power."
    )


def _look(samples: Samples) -> list[Finding]:
    event = samples.of("event")
    if event is not None and event.tails[0] < HEAVY_DOF:
        return []  # gusts make unsteady plateaus, too
    return look_for_plateau_noise(samples.campaign, samples.stretches)


SIGNAL = Signal(
    "unsteady", 0.04, {"unsteady_excess": "1", "unsteady_Hz": "Hz"}, _words, _look, phase="plateau"
)
