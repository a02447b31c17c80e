"""The one interface for what single samples show: a signal, what it looks at, what it finds."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from math import inf
from typing import Any, NamedTuple

import numpy as np
from scipy.special import logsumexp

from bayes_sensor.campaign import Campaign, FloatArray
from bayes_sensor.diagnosis.calibration import calibration
from bayes_sensor.diagnosis.data.quiet_stretches import QuietSpans, Stretch, hides_the_noise

FOUND = 0.5
"""probability from which a finding counts as present in the steps that follow"""


@dataclass(frozen=True, eq=False)
class Samples:
    """What signals look at: samples less the mean of the best explanation, and their noise."""

    campaign: Campaign
    residuals: Sequence[FloatArray]
    """(n_t,) V of every experiment, spikes replaced"""
    deviations: Sequence[FloatArray]
    """(n_t,) V, the noise's standard deviation at every sample"""
    stretches: Sequence[Stretch]
    """quiet parts, spikes replaced"""
    raw: Sequence[Stretch]
    """quiet parts as measured, less the mean of the fit"""
    quiet: Sequence[QuietSpans]
    """switches and quiet spans of every experiment"""
    fitted: Any
    """:class:`~bayes_sensor.diagnosis.evidence.refit.Refit` whose mean was taken off"""
    found: tuple[Finding, ...] = ()
    """of the signals before in the registry"""

    def of(self, name: str) -> Finding | None:
        """The finding of an earlier signal, if it was looked for."""
        return next((f for f in self.found if f.name == name), None)

    @property
    def converter_step(self) -> float:
        """V, step of the converter that was found; 0 where none was."""
        return max((f.strength.get("adc_step", 0.0) for f in self.found), default=0.0)

    @property
    def rounding_hides_the_noise(self) -> bool:
        """Whether the converter makes lines, plateaus and jumps of its own."""
        return hides_the_noise(self.stretches, self.converter_step)


@dataclass(frozen=True)
class Signal:
    """One kind of thing that single samples may show.

    A signal of a listed effect carries that effect's name.  Any other is of unlisted origin: a
    note, and an unlisted cause as far as the calibration map says.
    """

    name: str
    prior: float
    """probability that a campaign has it"""
    units: Mapping[str, str] = field(hash=False)
    """name of a strength -> its unit"""
    sentence: Callable[[Finding, Sequence[str], str], str]
    """what is said of a finding: the names of experiments, and the unit of the signal"""
    look: Callable[[Samples], Sequence[Finding]]
    """its detector; empty where the samples cannot tell"""
    listed: bool = False
    """whether it belongs to an effect of the catalogue"""
    if_not_listed: Callable[[Finding], Finding] | None = None
    """what it is where its effect was taken out of the catalogue; None: it is then ignored"""
    of_the_mean: bool = False
    """whether it is in what an explanation leaves of the mean: it may be the effect's own form"""
    spares_means_from_hz: float = inf
    """frequency from which it averages out of the bins: no effect on the mean explains it"""
    on_quiet_stretches: bool = False
    """whether it is in those phases of a record only in which its places are"""
    phase: str = ""
    """the phase of all records that it is in, where it is in one only"""
    sets_in: bool = False
    """whether its places are moments from which something lasts"""
    by_frequency: bool = False
    """whether it is looked for in spectra, which uneven sampling times do not have"""
    despite_rounding: bool = False
    """whether it is looked for where the converter's steps hide the noise, too"""


class Place(NamedTuple):
    """Where and when a finding is, and how clear."""

    experiment: int
    """counted from 0"""
    time: float
    """s in the record"""
    size: float
    """square of its ratio to the noise's usual size"""


@dataclass(frozen=True)
class Finding:
    """What a detector says of one signal in one campaign."""

    signal: Signal
    log_bayes_factor: float
    strength: dict[str, float]
    d: float | None
    """detectability where there is a signature in the mean, else None"""
    places: tuple[Place, ...] = ()
    """where it is, where that is at single moments"""
    tails: tuple[float, float] = (inf, inf)
    """degrees of freedom of the noise's means that it was judged by, at carrier and plateau; inf
    for those of a Gaussian, or where nothing is told"""

    @property
    def name(self) -> str:
        """The signal's: an effect's, or one of unlisted origin."""
        return self.signal.name

    @property
    def log_odds(self) -> float:
        """By the prior of its signal and the Bayes factor alone."""
        prior = self.signal.prior
        return float(np.log(prior / (1.0 - prior)) + self.log_bayes_factor)

    @property
    def probability(self) -> float:
        """Posterior probability; calibrated where it is of unlisted origin."""
        if not self.signal.listed:
            return calibration().of_finding(self.log_odds)
        return float(1.0 / (1.0 + np.exp(-np.clip(self.log_odds, -60.0, 60.0))))

    @property
    def lasting(self) -> float:
        """Degrees of freedom of the lighter tails of the two gases: those of the noise itself."""
        return max(self.tails)

    @property
    def frequency(self) -> float:
        """Hz, of a line; 0 where it has none."""
        return self.strength.get(f"{self.name}_Hz", 0.0)

    @property
    def beside_the_mean(self) -> bool:
        """Whether it adds to the signal and leaves the means over bins alone."""
        return self.frequency >= self.signal.spares_means_from_hz

    def sentence(self, names: Sequence[str], unit: str) -> str:
        """What is said of it; ``names`` of the experiments, ``unit`` of the signal."""
        if self.log_bayes_factor <= 0.0:
            return "It is not seen: the samples are no likelier with it."
        return self.signal.sentence(self, names, unit)

    def place(self, names: Sequence[str]) -> str:
        """Where it is, in words; ``names`` of the experiments."""
        if self.places:
            first = max(self.places, key=lambda p: p.size)
            return f"experiment {names[first.experiment]}, {moment(first.time)} s"
        record = self.strength.get(f"{self.name}_experiment")
        if record is not None:
            return f"experiment {names[int(record)]}"
        return f"every {self.signal.phase}" if self.signal.phase else "all records"


def struck(log_b: FloatArray, share: float) -> FloatArray:
    """ln B of places of which a ``share`` is affected, from those (..,) of an affected one."""
    return np.asarray(np.logaddexp(np.log1p(-share), np.log(share) + log_b))


def any_of(found: Sequence[Finding]) -> Finding:
    """Several tests of one signal joined: the clearest finding, with the mean Bayes factor."""
    value = float(logsumexp([f.log_bayes_factor for f in found]) - np.log(len(found)))
    return replace(max(found, key=lambda f: f.log_bayes_factor), log_bayes_factor=value)


def moment(t: float) -> str:
    """A time ``t`` s on the record's clock, to a hundredth where four digits do not tell it.

    >>> moment(24.6699), moment(1000024.6699)
    ('24.67', '1000024.67')
    """
    return f"{t:.4g}" if abs(t) < 1e3 else f"{t:.2f}"
