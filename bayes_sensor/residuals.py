"""What the residuals of a fit look like: correlation in time, spread against concentration, slope.

The classical bounds take residuals as white and of one size.  Here both are tested: the sample
autocorrelation beside that of the fitted AR(1), Ljung-Box and Durbin-Watson before and after
whitening, the spread in bins of concentration with a Breusch-Pagan test, and whether AR(1) says
enough about the slow part, which is what widens intervals.

``adequate`` asks of the noise law all that intervals rest on: its correlation, its variance against
concentration and against the slope of the response, and that rounding does not stand for noise.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from math import log, sqrt
from typing import Any, Protocol

import numpy as np
from scipy import fft
from scipy.ndimage import uniform_filter1d
from scipy.special import chdtrc, erfc

from bayes_sensor.campaign import BoolArray, Campaign, FloatArray
from bayes_sensor.fit.fitted_noise import Spread, fitted_variances, rough_places
from bayes_sensor.lattice import lattice_step
from bayes_sensor.likelihood.density import grid_response, mean_and_variance
from bayes_sensor.likelihood.noise import VARIANCES, lag_coefficient
from bayes_sensor.likelihood.problem import Problem, as_problem
from bayes_sensor.rig.cascade import Cascade, local_parameters, time_constants
from bayes_sensor.variance_check import FACTOR, VarianceCheck, check_variance, local_squares

HISTOGRAM_BIN = 0.05
"""V, the paper's Fig. 6"""
LAGS = (1, 2, 3, 5, 10, 20, 50, 100)
"""lags of the portmanteau test, in samples"""
FEWEST_PAIRS = 0.01
"""share of the samples that have another one at a lag, below which that lag is not told"""


QUICK_SHARE = 40
"""of a record, as one over this, above which residuals are slow"""
MEMORIES_APART = 2.0
"""times by which the memories of two experiments differ before noise of their own is advised"""

TAKE_AS_THEY_ARE = "Sandwich, block bootstrap and jackknife take the residuals as they are."
"""what to compare with where the noise law does not describe them"""
CONCENTRATION_EDGES = np.array([0.0, 0.02, 0.2, 0.4, 0.6, 0.8, 1.0])
"""of the highest concentration: bins in which the variance is checked"""
SLOPE_EDGES = np.array([0.0, 0.05, 0.2, 0.4, 0.7, 1.0])
"""of the largest |dx3/dt|: the same"""
COARSE = sqrt(6.0)
"""standard deviations of the residuals in a converter's step at which rounding, of variance
step^2/12, makes up half of their variance"""
NEGLIGIBLE = 1e-4
"""of the larger level's variance, below which no level is taken to be"""


class Fitted(Protocol):
    """What is needed of a fit."""

    theta_hat: FloatArray


@dataclass(frozen=True, eq=False)
class Residuals:
    """Diagnostics of a fit's residuals r = y - m, pooled over the experiments in their order."""

    acf: dict[str, list[float]]
    """``lag_s``, ``value``, and ``ar1``, the fitted AR(1)'s curve; thinned at long lags"""
    white_band: float
    """half-width of the 95 % band that white residuals would keep within"""
    ljung_box: dict[str, Any]
    """``lags`` (samples), and ``before``, ``after`` whitening: ``statistic``, ``p_value``"""
    durbin_watson: dict[str, float]
    """``before`` and ``after`` whitening; 2 when neighbours are uncorrelated"""
    ar1: dict[str, float]
    """phi, sigma0_V, sigma1_V and the interval phi refers to"""
    variance_vs_concentration: dict[str, Any]
    """bins of x3 times the test-gas fraction, their sd and count, the law's sd, the test"""
    variance_vs_slope: dict[str, Any]
    """the same against |dx3/dt| over its largest, without a test"""
    checks: dict[str, dict[str, Any]]
    """``correlation``, ``variance_concentration``, ``variance_slope``, ``rounding``: each with
    ``adequate``, ``p_value`` and ``factor`` (measured over what the law says), and its numbers"""
    histogram: dict[str, Any]
    """``edges_V``, ``count``, ``bin_V``, ``note``"""
    experiments: dict[str, dict[str, float]]
    """per experiment: n, rms_V, lag_one, baseline_sd_V, plateau_sd_V"""
    spectrum: dict[str, float]
    """slow part of the residuals' spectrum over that of the fitted AR(1)"""
    adequate: bool
    """whether the noise law passes every check"""
    verdict: str
    """the same as a sentence with its numbers"""
    recommendation: str
    """what to compare with where it does not; else empty"""
    signal_unit: str = "V"

    @property
    def doubt(self) -> str:
        """Why intervals that rest on the noise law are not to be trusted; empty where they are."""
        return "" if self.adequate else f"{self.verdict} {self.recommendation}"

    def to_json(self) -> dict[str, Any]:
        """The content of ``residuals.json``."""
        return {
            "acf": self.acf,
            "ljung_box": self.ljung_box,
            "ar1": self.ar1,
            "variance_vs_concentration": self.variance_vs_concentration,
            "variance_vs_slope": self.variance_vs_slope,
            "checks": self.checks,
            "durbin_watson": self.durbin_watson,
            "white_band": self.white_band,
            "histogram": self.histogram,
            "experiments": self.experiments,
            "spectrum": self.spectrum,
            "adequate": self.adequate,
            "verdict": self.verdict,
            "recommendation": self.recommendation,
            "signal_unit": self.signal_unit,
        }


@dataclass(frozen=True, eq=False)
class _Series:
    """One experiment's used samples."""

    r: FloatArray  # (n,) V
    z: FloatArray  # (n,) r / s
    e: FloatArray  # (n,) whitened
    x: FloatArray  # (n,) x3
    slope: FloatArray  # (n,) 1/s, |dx3/dt|
    s: FloatArray  # (n,) V
    used: BoolArray  # (n_t,) which samples of the record these are
    concentration: float


def autocorrelation(r: FloatArray, n_lags: int, used: BoolArray | None = None) -> FloatArray:
    """(n_lags + 1,) sample autocorrelation of a series about its mean, by FFT.

    ``sum_i (r_i - mean)(r_(i+k) - mean) / sum_i (r_i - mean)^2``, the biased form, as plotted in
    the paper's Fig. 8.  Zero for a constant series beyond lag 0.  With ``used`` (n_t,) ``r`` (n,)
    are the samples that are used of n_t: lags are then those between the samples, gaps included,
    sums stand for as many pairs as there would be without gaps, and a lag with hardly any is nan.

    >>> autocorrelation(np.array([1.0, -1.0, 1.0, -1.0]), 2).tolist()
    [1.0, -0.75, 0.5]
    >>> autocorrelation(np.array([1.0, -1.0]), 2, np.array([True, False, True])).tolist()[1]
    nan
    """
    gaps = used is not None and not used.all()
    d = r - r.mean()
    if used is not None and gaps:
        d, whole = np.zeros(len(used)), d
        d[used] = whole
    n_lags = min(n_lags, len(d) - 1)
    sums = _lagged_products(d, n_lags)
    impulse = np.r_[1.0, np.zeros(n_lags)]
    rho: FloatArray = impulse if sums[0] <= 0.0 else sums / sums[0]
    if used is None or not gaps:
        return rho
    pairs = np.rint(_lagged_products(used.astype(float), n_lags))
    share = pairs / (len(d) - np.arange(n_lags + 1)) / (pairs[0] / len(d))
    told = pairs > FEWEST_PAIRS * pairs[0]
    return np.where(told, rho / np.where(told, share, 1.0), np.nan)


def _lagged_products(d: FloatArray, n_lags: int) -> FloatArray:
    """(n_lags + 1,) sum_i d_i d_(i+k)."""
    length = fft.next_fast_len(len(d) + n_lags, real=True)
    power = fft.rfft(d, length)
    return np.asarray(fft.irfft(power.real**2 + power.imag**2, length)[: n_lags + 1])


def whiten(z: FloatArray, index: np.ndarray, phi: float) -> FloatArray:
    """(n,) innovations of an AR(1) ``z`` (n,), scaled to unit variance.

    ``index`` (n,) are sample numbers, or times in sampling intervals: across m missing samples the
    coefficient is phi^(m + 1).

    >>> whiten(np.array([1.0, 0.5]), np.array([0, 1]), 0.5).tolist()
    [1.0, 0.0]
    """
    distance = np.diff(index).astype(float)
    rho = np.sign(phi) ** distance * np.abs(phi) ** distance
    e = z.copy()
    e[1:] = (z[1:] - rho * z[:-1]) / np.sqrt(1.0 - rho**2)
    return e


def diagnose_residuals(
    campaign: Campaign | Problem, fit: Fitted, max_lag: float | None = None
) -> Residuals:
    """Diagnostics of the residuals at ``fit.theta_hat``.

    ``max_lag`` (s) is how far the autocorrelation is shown; default a twentieth of the longest
    record.  Series of experiments are joined in the campaign's order, as in the paper; with
    different sampling intervals lags count samples of the most common one.

    Raises CampaignError for a design without data.
    """
    problem = as_problem(campaign)
    campaign = problem.campaign
    vector = problem.layout.flat(fit.theta_hat)
    series = [_series(problem, vector, k) for k in range(len(campaign))]
    h = campaign.reference_interval
    r = np.concatenate([s.r for s in series])
    z = np.concatenate([s.z for s in series])
    white = np.concatenate([s.e for s in series])
    longest = max(float(e.t[-1] - e.t[0]) for e in campaign)
    n_lags = int(min((max_lag or longest / 20.0) / h, len(r) // 4))
    n_lags = max(n_lags, 1)
    correlation = autocorrelation(r, n_lags, np.concatenate([s.used for s in series]))
    whitened = autocorrelation(white, max(LAGS))
    noise = {name: float(vector[problem.layout.index(name)]) for name in problem.layout.noise_names}
    phi = float(np.mean(vector[problem.layout.noise[:, 0]]))
    kept = _thinned(len(correlation) - 1)
    kept = kept[np.isfinite(correlation[kept])]
    ratio, expected_sd = _slow_part(problem, vector, series)
    found = _judge(problem, vector, series, (ratio, expected_sd), correlation, whitened)
    return Residuals(
        acf={
            "lag_s": [float(v) for v in kept * h],
            "value": [float(v) for v in correlation[kept]],
            "ar1": [float(v) for v in _of_the_fit(problem, vector, series, kept)],
        },
        white_band=1.96 / sqrt(len(r)),
        ljung_box=_ljung_box(z, white, int(problem.noise.autocorrelation == "ar1")),
        durbin_watson={"before": _durbin_watson(z), "after": _durbin_watson(white)},
        ar1={**noise, "phi": phi, "phi_interval_s": h, **_shared(problem, vector)},
        variance_vs_concentration={
            **_spread(problem, series, "concentration"),
            "breusch_pagan": _breusch_pagan(series),
        },
        variance_vs_slope=_spread(problem, series, "slope"),
        checks=found.checks,
        histogram=_histogram(r),
        experiments={e.name: _own_noise(s) for e, s in zip(campaign, series)},
        spectrum={"slow_to_ar1": ratio, "expected_sd": expected_sd},
        adequate=found.adequate,
        verdict=found.verdict,
        recommendation=found.recommendation,
        signal_unit=campaign.signal_unit,
    )


def noise_doubt(problem: Problem, vector: FloatArray) -> str:
    """Why intervals that rest on the noise's own law are not to be trusted at a flat vector.

    As a sentence; empty where the noise law describes the residuals.
    """
    series = [_series(problem, vector, k) for k in range(len(problem.campaign))]
    r, used, white = (
        np.concatenate([getattr(s, name) for s in series]) for name in ("r", "used", "e")
    )
    longest = max(len(e.t) for e in problem.campaign) // 20
    n_lags = max(min(_fades(_slowest(problem, vector)), longest, len(r) // 4), 1)
    slow = _slow_part(problem, vector, series)
    found = _judge(
        problem, vector, series, slow, autocorrelation(r, n_lags, used), autocorrelation(white, 5)
    )
    return "" if found.adequate else f"{found.verdict} {found.recommendation}"


def _shared(problem: Problem, vector: FloatArray) -> dict[str, float]:
    _, sigma0, sigma1 = (np.sqrt(np.mean(column**2)) for column in vector[problem.layout.noise].T)
    return {"sigma0_V": float(sigma0), "sigma1_V": float(sigma1)}


def _series(problem: Problem, vector: FloatArray, k: int) -> _Series:
    e = problem.campaign.experiments[k]
    mean, s2 = mean_and_variance(problem, vector, k)
    used = np.flatnonzero(e.used)
    r = e.values[used] - mean[used]
    s = np.sqrt(s2[used])
    phi = lag_coefficient(float(vector[problem.layout.noise[k, 0]]), problem.steps(e))
    if type(problem.model) is Cascade and problem.model.method == "exact":
        _, _, t0, tf = local_parameters(vector, problem.layout, e.name)
        x = grid_response(e, time_constants(vector[0], vector[1], vector[2], e.total_flow), t0, tf)
    else:
        x = problem.model.response(e.t, vector, problem.layout, e)
    z = r / s
    slope = np.abs(np.gradient(x, e.t)) if len(x) > 1 else np.zeros(len(x))
    if not e.regular:
        phi = max(phi, 0.0)
    return _Series(
        r, z, whiten(z, e.places[used], phi), x[used], slope[used], s, e.used, e.concentration
    )


def _thinned(n_lags: int) -> np.ndarray:
    """Lags 0 .. n_lags: all up to 200, then about 300 in even ratio."""
    if n_lags <= 500:
        return np.arange(n_lags + 1)
    far = np.unique(np.round(np.geomspace(201, n_lags, 300)).astype(int))
    return np.concatenate([np.arange(201), far])


def _ljung_box(z: FloatArray, white: FloatArray, n_fitted: int) -> dict[str, Any]:
    """Before and after whitening, of which ``n_fitted`` correlations were fitted."""
    lags = [lag for lag in LAGS if lag < len(z) // 4] or [1]
    table: dict[str, Any] = {"lags": lags}
    for label, series, fitted in (("before", z, 0), ("after", white, n_fitted)):
        tested = _portmanteau(series, lags, fitted)
        table[label] = {"statistic": tested[0], "p_value": tested[1]}
    return table


def _portmanteau(
    series: FloatArray, lags: list[int], n_fitted: int = 0
) -> tuple[list[float], list[float | None]]:
    """Statistic and p-value up to each lag; no p-value up to as many lags as were fitted."""
    if np.ptp(series) == 0.0:
        return [0.0] * len(lags), [1.0] * len(lags)
    # Ljung and Box, Biometrika 65, 297 (1978), eq. 3; statsmodels would do, and take a second to
    # start
    n = len(series)
    lag = np.arange(1, max(lags) + 1)
    correlation = autocorrelation(series, max(lags))[1:]
    statistic = n * (n + 2) * np.cumsum(correlation**2 / (n - lag))
    # what was fitted to the series takes as many degrees of freedom (Box and Pierce 1970)
    p_value = chdtrc(np.maximum(lag - n_fitted, 1), statistic)
    told = [float(p_value[k - 1]) if k > n_fitted else None for k in lags]
    return [float(statistic[k - 1]) for k in lags], told


def _durbin_watson(series: FloatArray) -> float:
    return float(np.sum(np.diff(series) ** 2) / (series @ series)) if np.any(series) else 2.0


def _concentrations(problem: Problem, series: list[_Series]) -> list[FloatArray]:
    """(n,) of every experiment: concentration over the campaign's highest."""
    highest = problem.campaign.reference_concentration
    return [s.concentration * np.clip(s.x, 0.0, 1.0) / highest for s in series]


def _slopes(series: list[_Series]) -> list[FloatArray]:
    """(n,) of every experiment: |dx3/dt| over the campaign's largest."""
    largest = max((float(s.slope.max()) for s in series if len(s.slope)), default=0.0)
    return [s.slope / (largest or 1.0) for s in series]


def _spread(problem: Problem, series: list[_Series], against: str) -> dict[str, Any]:
    """Spread of r in ten bins of concentration or of ``slope``, against the fitted law."""
    highest = problem.campaign.reference_concentration if against == "concentration" else 1.0
    places = _concentrations(problem, series) if against == "concentration" else _slopes(series)
    c = highest * np.concatenate(places)
    r = np.concatenate([s.r for s in series])
    law = np.concatenate([s.s for s in series])
    edges = np.linspace(0.0, highest, 11)
    edges = np.insert(edges, 1, 0.02 * edges[-1])  # a narrow first bin: pure carrier gas, plateaus
    place = np.clip(np.searchsorted(edges, c, side="right") - 1, 0, len(edges) - 2)
    count = np.bincount(place, minlength=len(edges) - 1)
    squares = np.bincount(place, weights=r**2, minlength=len(edges) - 1)
    squares_law = np.bincount(place, weights=law**2, minlength=len(edges) - 1)
    filled = count > 0
    sd, sd_law = np.zeros(len(count)), np.zeros(len(count))
    sd[filled] = np.sqrt(squares[filled] / count[filled])
    sd_law[filled] = np.sqrt(squares_law[filled] / count[filled])
    return {
        f"{against}_low": [float(v) for v in edges[:-1]],
        f"{against}_high": [float(v) for v in edges[1:]],
        "sd_V": [float(v) if ok else None for v, ok in zip(sd, filled)],
        "law_sd_V": [float(v) if ok else None for v, ok in zip(sd_law, filled)],
        "count": [int(v) for v in count],
    }


def _breusch_pagan(series: list[_Series]) -> dict[str, Any]:
    """Koenker's form of the test of r^2 against concentration, on samples far enough apart.

    The test takes observations as independent, so only every m-th sample enters, m being where
    the correlation has died away (at least one in 2001 is kept).
    """
    lag = 1
    for s in series:
        # of the samples that are used, one after the other, since these are thinned
        acf = autocorrelation(s.z, min(2000, len(s.z) // 10 + 1))
        small = np.flatnonzero(np.abs(acf) < 0.05)
        lag = max(lag, int(small[0]) if len(small) else len(acf))
    r = np.concatenate([s.r[::lag] for s in series])
    c = np.concatenate([s.concentration * s.x[::lag] for s in series])
    if len(r) < 20 or np.ptp(c) == 0.0 or not np.any(r):
        return {"statistic": None, "p_value": None, "every": lag, "n": len(r)}
    # n R^2 of the regression of r^2 on c (Koenker, J. Econometrics 17, 107, 1981)
    statistic = len(r) * float(np.corrcoef(r**2, c)[0, 1]) ** 2
    return {
        "statistic": statistic,
        "p_value": float(chdtrc(1, statistic)),
        "every": lag,
        "n": len(r),
    }


def _round_near(value: float) -> float:
    """The nearest of 1, 2 and 5 times the powers of ten.

    >>> _round_near(0.0502), _round_near(8e-13)
    (0.05, 1e-12)
    """
    k = int(np.floor(np.log10(value)))
    near = [float(f"{digit}e{power}") for power in (k, k + 1) for digit in (1, 2, 5)]
    return min(near, key=lambda width: abs(log(width / value)))


def _histogram(r: FloatArray) -> dict[str, Any]:
    """Counts in bins of 1, 2 or 5 times a power of ten, the nearest to three quarters of the
    spread: 0.05 V in the paper's data."""
    spread = float(np.std(r))
    width = _round_near(spread / 1.3) if spread > 0.0 else HISTOGRAM_BIN
    note = f"bins of {width:g} as in the paper"
    if width != HISTOGRAM_BIN:
        note = (
            f"bins of {width:g}: the paper's {HISTOGRAM_BIN:g} does not suit a spread of "
            f"{spread:.3g}"
        )
    low, high = float(r.min()), float(r.max())
    # a spike must not make a million bins; what lies beyond is counted in the outermost ones
    low, high = max(low, -100.0 * width), min(high, 100.0 * width)
    first, last = int(np.floor(low / width)), int(np.floor(high / width)) + 1
    edges = width * np.arange(first, last + 1)
    count, _ = np.histogram(np.clip(r, edges[0], np.nextafter(edges[-1], -np.inf)), edges)
    return {
        "bin_V": width,
        "edges_V": [float(v) for v in edges],
        "count": [int(v) for v in count],
        "note": note,
    }


def _own_noise(s: _Series) -> dict[str, Any]:
    square = float(s.r @ s.r)
    low, high = s.r[s.x < 0.02], s.r[s.x > 0.9]
    return {
        "n": len(s.r),
        "rms_V": sqrt(square / len(s.r)),
        "mean_V": float(s.r.mean()),
        "lag_one": _lag_one(s) if square > 0.0 else 0.0,
        "baseline_sd_V": float(np.sqrt(np.mean(low**2))) if len(low) else None,
        "plateau_sd_V": float(np.sqrt(np.mean(high**2))) if len(high) else None,
    }


def _lag_one(s: _Series) -> float | None:
    """Correlation of neighbouring samples, about zero; None where no two are used."""
    r = np.zeros(len(s.used))
    r[s.used] = s.r
    pairs = int(np.sum(s.used[1:] & s.used[:-1]))
    if pairs == 0:
        return None
    return float(r[1:] @ r[:-1] / (s.r @ s.r)) * (len(s.r) - 1) / pairs


def _quick(s: _Series) -> _Series:
    """The same residuals without what is slow, which may be a misfit."""
    width = min(max(len(s.r) // QUICK_SHARE, 3), len(s.r))
    return replace(s, r=s.r - uniform_filter1d(s.r, width))


def _slow_part(problem: Problem, vector: FloatArray, series: list[_Series]) -> tuple[float, float]:
    """(ratio, sd): slow power of z over what the fitted AR(1) puts there, and its chance spread.

    The whitened series of an adequate AR(1) has a flat spectrum of height 1: the ratio is the mean
    of its periodogram below a tenth of the frequency at which the AR(1)'s own spectrum bends, at
    least twenty ordinates per experiment.
    """
    total, n = 0.0, 0
    for s, phi in zip(series, _from_sample_to_sample(problem, vector), strict=True):
        m = len(s.e)
        power = np.abs(fft.rfft(s.e)) ** 2 / m
        bend = (1.0 - abs(phi)) / (2.0 * np.pi)  # cycles per sample
        last = int(np.clip(0.1 * bend * m, 20, max(m // 4, 1)))
        chosen = power[1 : last + 1]
        total += float(chosen.sum())
        n += len(chosen)
    return total / max(n, 1), 1.0 / sqrt(max(n, 1))


def _from_sample_to_sample(problem: Problem, vector: FloatArray) -> FloatArray:
    """(n_e,) coefficient of the fitted AR(1) at every experiment's own interval."""
    return np.array([
        lag_coefficient(float(vector[problem.layout.noise[k, 0]]), problem.steps(e))
        for k, e in enumerate(problem.campaign)
    ])  # fmt: skip


def _slowest(problem: Problem, vector: FloatArray) -> float:
    """The coefficient of the experiment whose noise remembers for most samples."""
    phi = _from_sample_to_sample(problem, vector)
    return float(phi[np.argmax(np.abs(phi))])


def _of_the_fit(
    problem: Problem, vector: FloatArray, series: list[_Series], lags: np.ndarray
) -> FloatArray:
    """(n_lags,) correlation that all residuals together have under the fitted AR(1).

    ``lags`` in samples.  Of experiments with a coefficient each, the mean, weighted by their sums
    of squares.
    """
    phi = _from_sample_to_sample(problem, vector)
    weight = np.array([float(s.r @ s.r) for s in series])
    weight = weight / weight.sum() if weight.sum() > 0.0 else np.full(len(phi), 1.0 / len(phi))
    curves = np.sign(phi)[:, None] ** lags * np.abs(phi)[:, None] ** lags
    curve: FloatArray = weight @ curves
    return curve


def _fades(phi: float) -> int:
    """Samples after which the AR(1)'s correlation has fallen below 0.01."""
    if abs(phi) < 0.01:
        return 1
    return int(np.ceil(np.log(0.01) / np.log(min(abs(phi), 0.999999))))


def _long_lag(correlation: FloatArray, phi: float) -> int:
    """First lag at which the AR(1)'s correlation has fallen below 0.01, of those that are known."""
    known = np.flatnonzero(np.isfinite(correlation))
    return int(known[min(int(np.searchsorted(known, _fades(phi))), len(known) - 1)])


@dataclass(frozen=True)
class _Judgement:
    """What all checks say together."""

    adequate: bool
    verdict: str
    recommendation: str
    checks: dict[str, dict[str, Any]]


def _judge(
    problem: Problem,
    vector: FloatArray,
    series: list[_Series],
    slow_part: tuple[float, float],
    correlation: FloatArray,
    whitened: FloatArray,
) -> _Judgement:
    """Correlation, variance and rounding: what fails, with its numbers and what helps."""
    correlated = _correlation_check(problem, vector, series, slow_part, correlation, whitened)
    by_gas, by_slope = _variance_checks(problem, series)
    rounding = _rounding_check(problem, series)
    failing = [
        *([] if correlated["adequate"] else [correlated["sentence"]]),
        *_variance_sentences(problem, series, by_gas, by_slope),
        *([] if rounding["adequate"] else [rounding["sentence"]]),
    ]
    beyond = "" if rounding["adequate"] else f" {TOO_COARSE}"
    checks = {
        "correlation": correlated,
        "variance_concentration": by_gas.to_json(),
        "variance_slope": by_slope.to_json(),
        "rounding": rounding,
    }
    verdict = " ".join(failing) or correlated["sentence"] + _variances_agree(by_gas, by_slope)
    recommendation = f"{TAKE_AS_THEY_ARE}{beyond}" if failing else ""
    return _Judgement(not failing, verdict, recommendation, checks)


def _at_the_laws_best(problem: Problem, series: list[_Series]) -> list[FloatArray]:
    """(n,) whitened residuals of every experiment, by the variance law at its own best.

    The law is on trial here, not one estimate of its parameters: squares of correlated residuals
    tell them less well than those of whitened ones, less what is slow.
    """
    law, campaign = problem.noise, problem.campaign
    spreads, variables = [], []
    for e, s in zip(campaign, series, strict=True):
        variable = law.weight(campaign, e) * np.maximum(s.x, 0.0)
        variable = np.minimum(variable, 1.0) if law.fading else variable
        r2 = local_squares(s.e) * s.s[2 : len(s.e) - 2] ** 2
        x = variable[2 : len(s.e) - 2]
        spreads.append(
            Spread(r2, x, s.r, variable, s.used, problem.steps(e), law.fading, rough_places(e))
        )
        variables.append(variable)
    whites = []
    for k, (s, variable) in enumerate(zip(series, variables, strict=True)):
        own = spreads[k : k + 1] if law.per_experiment else spreads
        if sum(len(spread.r2) for spread in own) == 0:
            whites.append(s.e)
            continue
        v0, v1 = fitted_variances(own, law.variance != "constant")
        mean = max(v0, v1)
        least = NEGLIGIBLE * mean
        s2 = spreads[k].law(max(v0, least), max(v1, law.fading * least), variable)
        whites.append(s.e * s.s / np.sqrt(s2) if mean > 0.0 else s.e)
    return whites


def _variance_checks(
    problem: Problem, series: list[_Series]
) -> tuple[VarianceCheck, VarianceCheck]:
    """The variance law against concentration, and against the slope of the response."""
    whites = _at_the_laws_best(problem, series)
    return (
        check_variance(whites, _concentrations(problem, series), CONCENTRATION_EDGES),
        check_variance(whites, _slopes(series), SLOPE_EDGES, each=True),
    )


def _variance_sentences(
    problem: Problem, series: list[_Series], by_gas: VarianceCheck, by_slope: VarianceCheck
) -> list[str]:
    """What the variance law fails in, and what helps; empty where it does not."""
    told, falls = [], False
    if not by_gas.adequate:
        low, high = float(by_gas.factor[0]), float(by_gas.factor[-1])
        place = "of the highest concentration"
        ends = (
            f"the measured variance is {low:.2g} times the law's at {_range(by_gas, 0)} {place} "
            f"and {high:.2g} times at {_range(by_gas, -1)}"
        )
        if low > 1.0 > high and low > FACTOR * high:
            told.append(f"the noise falls with gas: {ends}")
            falls = True
        elif high > 1.0 > low and high > FACTOR * low:
            told.append(f"the noise rises with gas by more than it says: {ends}")
        else:
            told.append(f"against concentration {_one_bin(by_gas, place)}")
    if not by_slope.adequate:
        word = "rises" if by_slope.trend > 1.0 else "falls"
        told.append(
            f"the noise {word} with the slope of the response: {_one_bin(by_slope, STEEPEST)}"
        )
    if not told:
        return []
    law = f'variance = "{problem.noise.variance}"'
    return [
        f"The variance law ({law}) does not describe the residuals: {'; '.join(told)}; intervals "
        f"that rest on it are then not to be trusted.{_better_law(problem, series, falls)}"
    ]


def _variances_agree(*found: VarianceCheck) -> str:
    factors = [float(v) for check in found if check.p_value is not None for v in check.factor]
    if not factors:
        return ""
    return (
        " In bins of concentration and of the response's slope their variance is "
        f"{min(factors):.2g} to {max(factors):.2g} times the law's."
    )


STEEPEST = "of the largest slope"
TOO_COARSE = (
    "Here sandwich and block bootstrap fail as well: the converter's step exceeds the noise, and "
    "rounding is neither independent of the signal nor averaged out (with steps of 8 to 16 times "
    "the noise their 95 % intervals held the truth in 20 to 75 % of simulated campaigns). Record "
    "with a finer range."
)


def _range(check: VarianceCheck, i: int) -> str:
    return f"{100.0 * check.low[i]:.3g} to {100.0 * check.high[i]:.3g} %"


def _one_bin(check: VarianceCheck, place: str) -> str:
    i = check.worst
    assert i is not None  # a check that fails has bins
    return (
        f"the measured variance is {check.factor[i]:.2g} times the law's at {_range(check, i)} "
        f"{place}"
    )


def _better_law(problem: Problem, series: list[_Series], falls: bool) -> str:
    """A variance law that describes the residuals, or may at least fall with gas as they do."""
    for law in VARIANCES:
        other = replace(problem, noise=replace(problem.noise, variance=law))
        fits = all(check.adequate for check in _variance_checks(other, series))
        if law != problem.noise.variance and fits:
            return f" The law {law!r} describes them: {_ask_for(law)}"
    if falls and not problem.noise.fading:
        return f" Noise that falls with gas can be fitted, if not exactly: {_ask_for('levels')}"
    return ""


def _ask_for(law: str) -> str:
    return f'write `variance = "{law}"` under [noise] of --config, or Noise("{law}").'


def _rounding_check(problem: Problem, series: list[_Series]) -> dict[str, Any]:
    """The converter's step against the residuals, slow misfit left out, where it is largest."""
    found = []
    for e, s in zip(problem.campaign, series, strict=True):
        step, sd = lattice_step(e.values[e.used]), float(np.std(_quick(s).r))
        if step > 0.0 and sd > 0.0:
            found.append((step / sd, step, e.name))
    ratio, step, name = max(found, default=(0.0, 0.0, ""))
    adequate = ratio <= COARSE
    unit = problem.campaign.signal_unit
    return {
        "adequate": adequate,
        "p_value": None,
        "factor": ratio or None,
        "step_V": step or None,
        "sentence": ""
        if adequate
        else (
            f"The converter's step in experiment {name} ({step:.3g} {unit}) is {ratio:.2g} times "
            "the residuals' standard deviation: they are rounding errors more than noise."
        ),
    }


def _correlation_check(
    problem: Problem,
    vector: FloatArray,
    series: list[_Series],
    slow_part: tuple[float, float],
    correlation: FloatArray,
    whitened: FloatArray,
) -> dict[str, Any]:
    """Whether AR(1) is adequate, and why, from the residuals' autocorrelation and the whitened."""
    phi = _slowest(problem, vector)
    h, n = problem.campaign.reference_interval, problem.campaign.n_samples
    (ratio, expected_sd), lag = slow_part, _long_lag(correlation, phi)
    expected = float(_of_the_fit(problem, vector, series, np.array([lag]))[0])
    # a third more slow power widens intervals by a sixth: what is smaller does not matter
    slow = abs(ratio - 1.0) > max(4.0 * expected_sd, 0.33)
    # sd of a sample autocorrelation of AR(1) data at long lags (Bartlett)
    sd = sqrt((1.0 + phi**2) / max(1.0 - phi**2, 1e-9) / n)
    excess = abs(float(correlation[lag]) - expected)
    far = excess > max(5.0 * sd, 0.05)
    short = float(np.max(np.abs(whitened[1:6]))) if len(whitened) > 5 else 0.0
    near = short > max(5.0 / sqrt(n), 0.05)
    numbers = {
        "adequate": not (slow or far or near),
        "p_value": float(erfc(abs(ratio - 1.0) / expected_sd / sqrt(2.0))),
        "factor": ratio,
        "lag_s": lag * h,
        "at_lag": float(correlation[lag]),
        "law_at_lag": expected,
        "left_after_whitening": short,
    }
    if numbers["adequate"]:
        return {
            **numbers,
            "sentence": (
                f"AR(1) with {_coefficients(problem, vector)} describes the residuals: whitened, "
                f"their slow part is {ratio:.2f} times that of white noise and no correlation at "
                f"short lags exceeds {max(short, 0.005):.2g}."
            ),
        }
    reasons = []
    if slow:
        word = "more" if ratio > 1.0 else "less"
        reasons.append(
            f"they hold {ratio:.3g} times the slow power it allows ({word} than it says)"
        )
    if far:
        reasons.append(
            f"their correlation at {lag * h * 1e3:.3g} ms is {correlation[lag]:.2f}, not "
            f"{expected:.2f}"
        )
    if near:
        reasons.append(f"correlation up to {short:.2f} is left after whitening")
    ending = (
        "intervals that rest on AR(1) are then too narrow."
        if ratio > 1.0
        else "intervals that rest on AR(1) are then not exact."
    )
    return {
        **numbers,
        "sentence": (
            f"AR(1) with {_coefficients(problem, vector)} does not describe the residuals: "
            f"{'; '.join(reasons)}; {ending}{_own_each(problem, series)}"
        ),
    }


def _coefficients(problem: Problem, vector: FloatArray) -> str:
    phi = vector[problem.layout.noise[:, 0]]
    low, high = (f"{v:.3g}" for v in (phi.min(), phi.max()))
    span = low if low == high else f"{low} to {high}"
    return f"phi = {span} at {problem.campaign.reference_interval * 1e3:g} ms"


def _own_each(problem: Problem, series: list[_Series]) -> str:
    """What to do where one coefficient stands for experiments that differ; else empty."""
    if problem.noise.per_experiment or problem.noise.autocorrelation != "ar1":
        return ""
    if not problem.campaign.same_interval:
        return ""  # neighbours are not as far apart in all of them
    loudest = max(float(np.std(s.r)) for s in series)
    found = {
        e.name: (phi, len(s.r))
        for e, s in zip(problem.campaign, series, strict=True)
        if np.std(s.r) > 1e-6 * loudest and (phi := _lag_one(_quick(s))) is not None
    }
    if len(found) < 2:
        return ""
    named = sorted(found, key=lambda name: found[name])
    low, high = named[0], named[-1]
    (least, n_least), (most, n_most) = found[low], found[high]
    error = sqrt(max(1.0 - least**2, 0.0) / n_least + max(1.0 - most**2, 0.0) / n_most)
    if most - least < 5.0 * error or 1.0 - least < MEMORIES_APART * (1.0 - most):
        return ""
    return (
        f" Neighbouring samples correlate by {least:.2f} in experiment {low} and by "
        f"{most:.2f} in {high}: with `per_experiment = true` under [noise] of --config, or "
        "Noise(per_experiment=True), each has noise of its own."
    )
