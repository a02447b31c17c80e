"""How large residuals are: against concentration and slope, in all, experiment by experiment."""

from __future__ import annotations

from math import log, sqrt
from typing import Any

import numpy as np

from bayes_sensor.campaign import FloatArray
from bayes_sensor.residuals.autocorrelation import autocorrelation
from bayes_sensor.residuals.series import FittedNoise, Series

HISTOGRAM_BIN = 0.05
"""V, the paper's Fig. 6"""


def spread(noise: FittedNoise, against: str) -> dict[str, Any]:
    """Root mean squares of r and of the law in bins of ``concentration`` or ``slope``."""
    gas = against == "concentration"
    highest = noise.problem.campaign.reference_concentration if gas else 1.0
    c = highest * np.concatenate(noise.concentrations if gas else noise.slopes)
    edges = np.linspace(0.0, highest, 11)
    edges = np.insert(edges, 1, 0.02 * edges[-1])  # a narrow first bin: pure carrier gas, plateaus
    place = np.clip(np.searchsorted(edges, c, side="right") - 1, 0, len(edges) - 2)
    count = np.bincount(place, minlength=len(edges) - 1)

    def root_mean_squares(values: FloatArray) -> list[float | None]:
        sums = np.bincount(place, values**2, len(count))
        return [sqrt(total / n) if n else None for total, n in zip(sums, count)]

    return {
        f"{against}_low": edges[:-1].tolist(),
        f"{against}_high": edges[1:].tolist(),
        "sd_V": root_mean_squares(noise.joined("r")),
        "law_sd_V": root_mean_squares(noise.joined("s")),
        "count": count.tolist(),
    }


def breusch_pagan(series: list[Series]) -> dict[str, Any]:
    """Koenker's form of the test of r^2 against concentration, on samples far enough apart.

    The test takes observations as independent, so only every m-th sample enters, m being where
    the correlation has died away (at least one in 2001 is kept).
    """
    from statsmodels.stats.diagnostic import het_breuschpagan

    lag = 1
    for s in series:
        # of the samples that are used, one after the other, since these are thinned
        acf = autocorrelation(s.z, min(2000, len(s.z) // 10 + 1))
        small = np.flatnonzero(np.abs(acf) < 0.05)
        lag = max(lag, int(small[0]) if len(small) else len(acf))
    r = np.concatenate([s.r[::lag] for s in series])
    c = np.concatenate([s.concentration * s.x[::lag] for s in series])
    statistic, p_value = None, None
    if len(r) >= 20 and np.ptp(c) > 0.0 and np.any(r):
        statistic, p_value, *_ = map(float, het_breuschpagan(r, np.stack([np.ones(len(c)), c], 1)))
    return {"statistic": statistic, "p_value": p_value, "every": lag, "n": len(r)}


def histogram(r: FloatArray) -> dict[str, Any]:
    """Counts in bins of 1, 2 or 5 times a power of ten, the nearest to three quarters of the
    spread: 0.05 V in the paper's data."""
    sd = float(np.std(r))
    width = _round_near(sd / 1.3) if sd > 0.0 else HISTOGRAM_BIN
    note = f"bins of {width:g} as in the paper"
    if width != HISTOGRAM_BIN:
        note = (
            f"bins of {width:g}: the paper's {HISTOGRAM_BIN:g} does not suit a spread of {sd:.3g}"
        )
    # a spike must not make a million bins; what lies beyond is counted in the outermost ones
    low, high = max(float(r.min()), -100.0 * width), min(float(r.max()), 100.0 * width)
    first, last = int(np.floor(low / width)), int(np.floor(high / width)) + 1
    edges = width * np.arange(first, last + 1)
    count, _ = np.histogram(np.clip(r, edges[0], np.nextafter(edges[-1], -np.inf)), edges)
    return {"bin_V": width, "edges_V": edges.tolist(), "count": count.tolist(), "note": note}


def _round_near(value: float) -> float:
    """The nearest of 1, 2 and 5 times the powers of ten.

    >>> _round_near(0.0502), _round_near(8e-13)
    (0.05, 1e-12)
    """
    k = int(np.floor(np.log10(value)))
    near = [float(f"{digit}e{power}") for power in (k, k + 1) for digit in (1, 2, 5)]
    return min(near, key=lambda width: abs(log(width / value)))


def of_each(s: Series) -> dict[str, Any]:
    """One experiment's own numbers."""

    def root_mean_square(r: FloatArray) -> float | None:
        return float(np.sqrt(np.mean(r**2))) if len(r) else None

    return {
        "n": len(s.r),
        "rms_V": root_mean_square(s.r),
        "mean_V": float(s.r.mean()),
        "lag_one": s.lag_one if np.any(s.r) else 0.0,
        "baseline_sd_V": root_mean_square(s.r[s.x < 0.02]),
        "plateau_sd_V": root_mean_square(s.r[s.x > 0.9]),
    }
