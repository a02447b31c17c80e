"""Does the record behave as the model says? A test of its one-step prediction errors."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.stats import chi2, norm

from bayes_sensor.campaign import FloatArray

N_LAGS = 20
"""samples up to which correlations are tested"""
DOUBTFUL = 1e-3
"""p-value below which a sentence is added"""


@dataclass(frozen=True)
class Innovations:
    """Whether prediction errors (over their standard deviations) are white and of size one."""

    n: int
    sd: float
    """1 where the noise is as fitted"""
    kurtosis: float
    """3 where they are Gaussian, more where the record has spikes or the input jumps"""
    correlation: float
    """the largest autocorrelation, by size, at 1 to :data:`N_LAGS` samples"""
    p_value: float
    """of the test by Ljung and Box (1978)"""

    largest: float
    """the largest error by size, in standard deviations"""
    largest_at: float
    """s, when that was"""

    @property
    def largest_p_value(self) -> float:
        """Probability of an error of that size among so many Gaussian ones."""
        return float(min(1.0, 2.0 * self.n * norm.sf(abs(self.largest))))

    @property
    def sentences(self) -> list[str]:
        """Warnings; empty where there is no reason for one."""
        found = []
        if self.p_value < DOUBTFUL:
            found.append(
                "the record's one-step prediction errors are correlated (up to "
                f"{self.correlation:.2f} between samples, Ljung-Box p = {self.p_value:.1g}): the "
                "noise is not AR(1), or the input is not one smooth process; bands may be too "
                "narrow"
            )
        if self.largest_p_value < DOUBTFUL:
            found.append(
                f"the sample at {self.largest_at:.6g} s is {abs(self.largest):.3g} standard "
                "deviations off what those before predict: a spike of the record or a jump of the "
                "input; do not rely on the band about it"
            )
        return found


def check_innovations(e: FloatArray, t: FloatArray) -> Innovations:
    """The test of ``e`` (n,), prediction errors over their standard deviations, at ``t`` (n,) s."""
    t, e = t[np.isfinite(e)], e[np.isfinite(e)]
    worst = int(np.argmax(np.abs(e)))
    n = len(e)
    centred = e - e.mean()
    power = float(np.mean(centred**2))
    lags = np.arange(1, min(N_LAGS, n // 4) + 1)
    r = np.array([float((centred[k:] * centred[:-k]).sum()) / (n * power) for k in lags])
    q = n * (n + 2.0) * float(np.sum(r**2 / (n - lags)))
    return Innovations(
        n=n,
        sd=float(np.sqrt(np.mean(e**2))),
        kurtosis=float(np.mean(centred**4)) / power**2,
        correlation=float(r[int(np.argmax(np.abs(r)))]),
        p_value=float(chi2.sf(q, len(lags))),
        largest=float(e[worst]),
        largest_at=float(t[worst]),
    )
