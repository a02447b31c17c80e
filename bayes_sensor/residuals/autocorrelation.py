"""Correlation of a series in time, by statsmodels; gaps and whitening beside it.

``acorr_ljungbox`` and ``acf(adjusted=True)`` with gaps form all n^2 products, five minutes for a
million samples.  The same numbers come from ``acovf`` with few lags and ``q_stat`` in 0.05 s.
statsmodels is imported where it is used: it takes half a second, and workers do without.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from scipy.special import chdtrc

from bayes_sensor.campaign import BoolArray, FloatArray

LAGS = (1, 2, 3, 5, 10, 20, 50, 100)
"""lags of the portmanteau test, in samples"""
FEWEST_PAIRS = 0.01
"""share of the samples that have another one at a lag, below which that lag is not told"""
DIRECT_LAGS = 1000
"""lags up to which products are summed one lag after the other, which is then faster than FFT"""


def autocorrelation(r: FloatArray, n_lags: int, used: BoolArray | None = None) -> FloatArray:
    """(n_lags + 1,) sample autocorrelation of a series about its mean.

    ``sum_i (r_i - mean)(r_(i+k) - mean) / sum_i (r_i - mean)^2``, the biased form, as plotted in
    the paper's Fig. 8.  Zero for a constant series beyond lag 0.  With ``used`` (n_t,) ``r`` (n,)
    are the samples that are used of n_t: lags are then those between the samples, gaps included,
    sums stand for as many pairs as there would be without gaps, and a lag with hardly any is nan.

    >>> autocorrelation(np.array([1.0, -1.0, 1.0, -1.0]), 2).tolist()
    [1.0, -0.75, 0.5]
    >>> autocorrelation(np.array([1.0, -1.0]), 2, np.array([True, False, True])).tolist()[1]
    nan
    """
    if used is None:
        used = np.ones(len(r), dtype=bool)
    gaps = not used.all()
    series = np.full(len(used), np.nan)
    series[used] = r
    rho = _covariance(series, n_lags, missing="conservative" if gaps else "none")
    rho = rho / rho[0] if rho[0] > 0.0 else np.eye(1, len(rho))[0]
    if gaps:
        n, lag = len(used), np.arange(len(rho))
        pairs = np.rint(n * _covariance(used.astype(float), n_lags, demean=False))
        share = pairs / (n - lag) / (pairs[0] / n)
        told = pairs > FEWEST_PAIRS * pairs[0]
        rho = np.where(told, rho / np.where(told, share, 1.0), np.nan)
    return rho


def _covariance(series: FloatArray, n_lags: int, **options: Any) -> FloatArray:
    from statsmodels.tsa.stattools import acovf

    n_lags = min(n_lags, len(series) - 1)
    found: FloatArray = acovf(series, fft=n_lags > DIRECT_LAGS, nlag=n_lags, **options)
    return found


def whiten(z: FloatArray, index: np.ndarray, phi: float) -> FloatArray:
    """(n,) innovations of an AR(1) ``z`` (n,), scaled to unit variance.

    ``index`` (n,) are sample numbers, or times in sampling intervals: across m missing samples the
    coefficient is phi^(m + 1).

    >>> whiten(np.array([1.0, 0.5]), np.array([0, 1]), 0.5).tolist()
    [1.0, 0.0]
    """
    rho = power(phi, np.diff(index))
    e = z.copy()
    e[1:] = (z[1:] - rho * z[:-1]) / np.sqrt(1.0 - rho**2)
    return e


def power(phi: float | FloatArray, lag: np.ndarray) -> FloatArray:
    """phi^lag for whole lags, also where phi is negative."""
    raised: FloatArray = np.sign(phi) ** lag.astype(float) * np.abs(phi) ** lag
    return raised


def ljung_box(series: FloatArray, lags: list[int], n_fitted: int = 0) -> dict[str, Any]:
    """``statistic`` and ``p_value`` of Ljung and Box (Biometrika 65, 297, 1978) up to each lag.

    The ``n_fitted`` correlations that were fitted take as many degrees of freedom (Box and Pierce
    1970); up to as many lags the p-value is None.
    """
    from statsmodels.tsa.stattools import q_stat

    if np.ptp(series) == 0.0:
        return {"statistic": [0.0] * len(lags), "p_value": [1.0] * len(lags)}
    sums = q_stat(autocorrelation(series, max(lags))[1:], len(series))[0]
    found = [float(sums[lag - 1]) for lag in lags]
    freedom = [lag - n_fitted for lag in lags]
    p_value = [float(chdtrc(nu, q)) if nu > 0 else None for nu, q in zip(freedom, found)]
    return {"statistic": found, "p_value": p_value}


def durbin_watson(series: FloatArray) -> float:
    """2 when neighbours are uncorrelated, and for a series of zeros."""
    from statsmodels.stats.stattools import durbin_watson as statistic

    return float(statistic(series)) if np.any(series) else 2.0
