"""Causes that bins cannot show: heavy tails and the converter's steps, at full rate.

They leave the mean over a bin alone (or nearly so) and act on single samples; each has a test of
its own on the quiet stretches, and each adds its probability to whatever explains the mean.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from scipy.ndimage import uniform_filter1d
from scipy.signal import lfilter
from scipy.special import gammaln, logsumexp

from bayes_sensor.campaign import Campaign, FloatArray
from bayes_sensor.diagnosis.data.noise_floor import Stretch, detrended
from bayes_sensor.residuals.converter_step import lattice_step

TAIL_DOF = (2.5, 3.0, 4.0, 5.0, 7.0, 10.0)
"""degrees of freedom that count as heavy tails"""
COARSE = 0.02
"""share of the sample-to-sample variance from which the converter's steps are called coarse"""
LUMPY = -25.0
"""ln Bayes factor of coarse steps from which the test of tails spreads the samples"""
COARSE_OF_ALL = 0.001
"""share of the noise's whole variance below which the steps do not matter, fine as they may look"""
TOO_COARSE = 1.0
"""steps over the innovations' standard deviation from which tails cannot be told"""
PRIOR = {
    "mains_pickup": 0.03, "heavy_tails": 0.03, "quantisation": 0.03,
    "line": 0.02, "swing": 0.02, "event": 0.025, "patch": 0.025, "break": 0.025, "ringing": 0.01,
    "unsteady": 0.04, "passing": 0.02, "bursts": 0.01,
}  # fmt: skip
FOUND = 0.5
"""probability from which a finding is there for what rests on it"""
AROUND = 400
"""samples over which the size of the innovations is taken"""
HARDLY_CROSSED = 0.7
"""steps over the noise's standard deviation from which it hardly crosses them"""
UNITS = {
    "mains_V": "V", "mains_Hz": "Hz", "adc_step": "V", "tail_dof": "1", "line_V": "V",
    "line_Hz": "Hz", "swing_V": "V", "swing_Hz": "Hz", "ringing_Hz": "Hz",
    "patch_s": "s", "patch_since_s": "s", "patch_ratio": "1", "break_s": "s", "break_ratio": "1",
    "event_s": "s", "event_ratio": "1",
    "unsteady_excess": "1", "unsteady_Hz": "Hz",
    "passing_V": "V", "passing_Hz": "Hz", "bursts_Hz": "Hz",
}  # fmt: skip
"""of the strengths that are found here"""
OF_UNLISTED_ORIGIN = (
    "line", "swing", "event", "patch", "break", "ringing", "unsteady", "passing", "bursts"
)  # fmt: skip
"""findings that have no name in the catalogue"""
FASTER_THAN_BINS = 1.0
"""Hz from which a line averages out of the bins: what explains the mean has no part in it"""


class Place(NamedTuple):
    """Where something strikes once."""

    experiment: int
    """counted from 0"""
    time: float
    """s in the record"""
    size: float
    """square of its ratio to the noise's usual size"""


@dataclass(frozen=True)
class FullRate:
    """What the samples themselves say."""

    name: str
    """an effect's name, or one of :data:`OF_UNLISTED_ORIGIN`"""
    log_bayes_factor: float
    strength: dict[str, float]
    d: float | None
    """detectability where there is a signature in the mean, else None"""
    places: tuple[Place, ...] = ()
    """where it strikes, of what does so here and there"""

    @property
    def probability(self) -> float:
        """Given its prior, whatever explains the rest."""
        prior = PRIOR[self.name]
        odds = np.log(prior / (1.0 - prior)) + self.log_bayes_factor
        return float(1.0 / (1.0 + np.exp(-np.clip(odds, -60.0, 60.0))))

    @property
    def beside_the_mean(self) -> bool:
        """Whether it is a line that adds to the signal and leaves its mean alone."""
        hertz = self.strength.get(f"{self.name}_Hz", 0.0)
        fast = self.name in ("line", "passing") and hertz >= FASTER_THAN_BINS
        return fast or self.name == "bursts"


def struck(log_b: FloatArray, share: float) -> FloatArray:
    """ln B of places that something strikes or spares, from those (..,) where it strikes.

    ``share`` of them are struck, where there is anything.
    """
    return np.asarray(np.logaddexp(np.log1p(-share), np.log(share) + log_b))


def any_of(found: Sequence[FullRate]) -> FullRate:
    """What tests that look for the same in several ways say together: the clearest, their mean B.

    ``found``: one at least.
    """
    value = float(logsumexp([f.log_bayes_factor for f in found]) - np.log(len(found)))
    return replace(max(found, key=lambda f: f.log_bayes_factor), log_bayes_factor=value)


def rounds_away(stretches: Sequence[Stretch], step: float) -> bool:
    """Whether the converter's step V is so coarse that the noise hardly crosses it.

    Rounding then makes lines, plateaus and jumps of its own.
    """
    spreads = [float(np.std(s.samples)) for s in stretches]
    return bool(spreads) and step > HARDLY_CROSSED * min(spreads)


def look_at_tails(stretches: Sequence[Stretch], step: float = 0.0) -> FullRate:
    """Student-t against Gaussian innovations of an AR(4) fitted to each stretch.

    In units of their size around, so that noise that swells and fades is not taken for wild.
    ``step`` V: the samples are spread evenly over the converter's step first.
    """
    values, spreads = [], []
    rng = np.random.default_rng(1)  # the same dither in every run
    for s in stretches:
        if len(s.samples) < 200:
            continue
        samples = s.samples + step * (rng.random(len(s.samples)) - 0.5) if step else s.samples
        e = _innovations(detrended(samples), 4)
        spread = float(np.std(e))
        if spread > 0:
            width = min(AROUND, len(e))
            around = np.sqrt(uniform_filter1d(e**2, width, mode="reflect"))
            values.append(e / np.maximum(around, 1e-3 * spread))
            spreads.append(spread)
    if not values:
        return FullRate("heavy_tails", 0.0, {"tail_dof": float("inf")}, None)
    e = np.concatenate(values)
    if len(e) > 200_000:  # evenly thinned: more changes nothing
        e = e[:: len(e) // 200_000]
    n = len(e)
    gaussian = -0.5 * n * (np.log(2.0 * np.pi * np.mean(e**2)) + 1.0)
    logs, scales = [], []
    for dof in TAIL_DOF:
        log_like, scale = _t_likelihood(e, dof)
        logs.append(log_like)
        scales.append(scale)
    best = TAIL_DOF[int(np.argmax(logs))]
    value = float(logsumexp(logs) - np.log(len(logs)) - gaussian)
    if step > TOO_COARSE * float(np.median(spreads)):
        value = min(value, 0.0)
    return FullRate("heavy_tails", value, {"tail_dof": best}, None)


def _innovations(x: FloatArray, order: int) -> FloatArray:
    n = len(x)
    gamma = np.array([float(x[: n - k] @ x[k:]) / n for k in range(order + 1)])
    if gamma[0] <= 0:
        return x
    toeplitz = gamma[np.abs(np.subtract.outer(np.arange(order), np.arange(order)))]
    a = np.linalg.solve(toeplitz + 1e-9 * gamma[0] * np.eye(order), gamma[1:])
    whitened: FloatArray = lfilter(np.concatenate([[1.0], -a]), [1.0], x)
    return whitened[order:]


def _t_likelihood(e: FloatArray, dof: float) -> tuple[float, float]:
    """Largest log-likelihood of a scaled t law, and its scale (a few EM steps)."""
    square = e**2
    s2 = float(np.median(square)) / 0.5
    for _ in range(12):
        s2 = float(np.mean((dof + 1.0) * square / (dof + square / s2)))
    n = len(e)
    constant = gammaln(0.5 * (dof + 1.0)) - gammaln(0.5 * dof) - 0.5 * np.log(dof * np.pi * s2)
    return float(n * constant - 0.5 * (dof + 1.0) * np.sum(np.log1p(square / (dof * s2)))), s2


# --------------------------------------------------------------------------- the converter


def look_for_steps(campaign: Campaign, stretches: Sequence[Stretch]) -> FullRate:
    """Coarse steps: a lattice whose rounding makes up a share of the sample-to-sample variance."""
    steps = [lattice_step(e.values[e.used]) for e in campaign]
    known = [s for s in steps if s > 0]
    if not known or not stretches:
        return FullRate("quantisation", -5.0, {"adc_step": 0.0}, None)
    step = float(np.median(known))
    innovations = [float(np.var(_innovations(detrended(s.samples), 4))) for s in stretches]
    share = step**2 / 12.0 / max(float(np.median(innovations)), 1e-300)
    whole = float(np.median([np.var(s.samples) for s in stretches]))
    of_all = step**2 / 12.0 / max(whole, 1e-300)
    # the lattice itself is certain; what is judged is whether it matters
    value = 8.0 * np.log(min(share / COARSE, of_all / COARSE_OF_ALL))
    value = float(np.clip(value, -30.0, 30.0))
    return FullRate("quantisation", value, {"adc_step": step}, None)
