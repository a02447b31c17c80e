"""Signal: the noise has heavier tails than a Gaussian.

Bins average them away; the test is made on the innovations of the noise in the quiet stretches.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from scipy.ndimage import uniform_filter1d
from scipy.special import gammaln, logsumexp

from bayes_sensor.campaign import FloatArray
from bayes_sensor.diagnosis.data.quiet_stretches import Stretch, detrended, innovations
from bayes_sensor.diagnosis.signals.signal import Finding, Samples, Signal

TAIL_DOF = (2.5, 3.0, 4.0, 5.0, 7.0, 10.0)
"""degrees of freedom that count as heavy tails"""
LUMPY = -25.0
"""ln Bayes factor of coarse steps from which the test of tails spreads the samples"""
TOO_COARSE = 1.0
"""steps over the innovations' standard deviation from which tails cannot be told"""
AROUND = 400
"""samples over which the size of the innovations is taken"""


def look_at_tails(stretches: Sequence[Stretch], step: float = 0.0) -> Finding:
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
        e = innovations(detrended(samples), 4)
        spread = float(np.std(e))
        if spread > 0:
            width = min(AROUND, len(e))
            around = np.sqrt(uniform_filter1d(e**2, width, mode="reflect"))
            values.append(e / np.maximum(around, 1e-3 * spread))
            spreads.append(spread)
    if not values:
        return Finding(SIGNAL, 0.0, {"tail_dof": float("inf")}, None)
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
    return Finding(SIGNAL, value, {"tail_dof": best}, None)


def _t_likelihood(e: FloatArray, dof: float) -> tuple[float, float]:
    """Largest log-likelihood of a scaled t law, and its scale (a few EM steps)."""
    square = e**2
    s2 = float(np.median(square)) / 0.5
    for _ in range(12):
        s2 = float(np.mean((dof + 1.0) * square / (dof + square / s2)))
    n = len(e)
    constant = gammaln(0.5 * (dof + 1.0)) - gammaln(0.5 * dof) - 0.5 * np.log(dof * np.pi * s2)
    return float(n * constant - 0.5 * (dof + 1.0) * np.sum(np.log1p(square / (dof * s2)))), s2


def _words(found: Finding, names: Sequence[str], unit: str) -> str:
    return (
        "Single samples stray further than a Gaussian lets expect: as of a Student t law with "
        f"about {found.strength['tail_dof']:.3g} degrees of freedom."
    )


def _look(samples: Samples) -> list[Finding]:
    # on a coarse lattice the innovations are lumps, not tails: spread them over the step again
    lattice = samples.of("quantisation")
    coarse = lattice is not None and lattice.log_bayes_factor > LUMPY
    return [look_at_tails(samples.raw, samples.converter_step if coarse else 0.0)]


SIGNAL = Signal(
    "heavy_tails", 0.03, {"tail_dof": "1"}, _words, _look, listed=True, despite_rounding=True
)
