"""Sandwich covariance of least squares: its spread when the noise is not iid.

cov = B^-1 M B^-1 with B = J'J and M the long-run covariance of the scores J_i r_i; M either with
Bartlett weights over a bandwidth chosen from the scores (Newey and West, Econometrica 55, 1987;
Andrews, Econometrica 59, 1991, eqs. 6.2 and 6.4), or from a fitted AR(1) with
concentration-dependent scale.  Experiments are independent of one another.

Two effects make the measured M too small on average: Bartlett weights cut off the correlation, and
residuals are smaller than the noise where few of them determine a parameter, as at a switch.  A
correction is computed for AR(1) noise.  Student's t replaces the normal law, with the degrees of
freedom of the corrected M (Bell and McCaffrey, Survey Methodology 28, 169, 2002; Imbens and
Kolesar, Rev. Econ. Statist. 98, 701, 2016; both for clusters).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from math import log

import numpy as np
from scipy import stats
from scipy.signal import lfilter, oaconvolve

from bayes_sensor.bounds.bound import Bound
from bayes_sensor.bounds.context import Evidence
from bayes_sensor.bounds.gaussian_intervals import SINGULAR, gaussian_bound, invert
from bayes_sensor.bounds.likelihood_surface import Surface
from bayes_sensor.campaign import FloatArray
from bayes_sensor.likelihood.density import mean_and_variance
from bayes_sensor.likelihood.mesh import mean_derivatives
from bayes_sensor.likelihood.noise import lag_coefficient
from bayes_sensor.likelihood.problem import Problem

REFERENCE = (
    "Newey and West, Econometrica 55, 703 (1987); Andrews, Econometrica 59, 817 (1991); "
    "Bell and McCaffrey, Survey Methodology 28, 169 (2002)"
)
BLOCKS = 8
"""blocks in the bandwidth where sums over samples are taken by blocks"""
MOST_MISSED = 0.9
"""largest share of a variance that the correction adds"""


def newey_west(scores: FloatArray, bandwidth: int) -> FloatArray:
    """Sum over lags of autocovariance sums of ``scores`` (n, p) with weights 1 - |j|/(L + 1).

    L = ``bandwidth``; (p, p), not divided by n.  Computed as the mean outer product of all
    overlapping sums of L + 1 scores, which is the same and costs no pass per lag.

    >>> newey_west(np.array([[1.0], [1.0]]), 1).tolist()
    [[3.0]]
    """
    n = len(scores)
    lags = int(min(max(bandwidth, 0), n - 1))
    total = np.concatenate([np.zeros((1, scores.shape[1])), np.cumsum(scores, axis=0)])
    t = np.arange(-lags, n)
    sums = total[np.minimum(t + lags + 1, n)] - total[np.maximum(t, 0)]
    result: FloatArray = sums.T @ sums / (lags + 1)
    return result


def andrews_bandwidth(scores: FloatArray) -> float:
    """Bandwidth of the Bartlett kernel from AR(1) fits to each column of ``scores`` (n, p).

    1.1447 (alpha n)^(1/3), alpha = sum 4 rho^2/((1 - rho)^6 (1 + rho)^2) / sum 1/(1 - rho)^4 for
    columns scaled to unit innovations (Andrews 1991, eqs. 5.3, 6.4).  Columns of zeros are skipped.
    """
    n = len(scores)
    squares = (scores**2).sum(axis=0)
    products = (scores[1:] * scores[:-1]).sum(axis=0)
    there = squares > 0
    rho = np.clip(products[there] / squares[there], -0.97, 0.9999)
    if not len(rho):
        return 0.0
    # columns scaled to unit variance: innovations have variance 1 - rho^2
    sigma4 = (1.0 - rho**2) ** 2
    above = np.sum(4.0 * rho**2 * sigma4 / ((1.0 - rho) ** 6 * (1.0 + rho) ** 2))
    below = np.sum(sigma4 / (1.0 - rho) ** 4)
    return float(1.1447 * (above / below * n) ** (1.0 / 3.0))


def ar1_middle(scaled: FloatArray, phi: float) -> FloatArray:
    """G' R G (p, p) for rows G_i = s_i J_i (n, p) and R_ij = phi^|i - j|; zero rows for gaps."""
    carried = lfilter([1.0], [1.0, -phi], scaled, axis=0)
    cross = scaled.T @ carried
    result: FloatArray = cross + cross.T - scaled.T @ scaled
    return result


@dataclass(frozen=True, eq=False)
class Scores:
    """The covariance of the scores J_i r_i of one experiment, with m parameters."""

    own: np.ndarray
    """(m,) positions of its parameters among the mean's"""
    measured: FloatArray
    """(m, m) by Bartlett weights"""
    unfitted: FloatArray
    """(m, m) their average under the AR(1) law with the noise in place of the residuals"""
    squares: FloatArray
    """(n_blocks, m, m) sum of J_i J_i' over a block short against the bandwidth"""
    follows: FloatArray
    """(n_blocks, m, m) sum of J_i (Sigma J)_i', Sigma the covariance of the noise"""
    noisy: FloatArray
    """(n_blocks, m, m) sum of s_i^2 J_i J_i'"""
    weights: FloatArray
    """(n_lags,) Bartlett weights of blocks 0, 1, .. apart"""

    def expected(self, inverse: FloatArray, spread_of_fit: FloatArray) -> FloatArray:
        """(m, m) average of ``measured`` under the AR(1) law, for residuals of a fit.

        They are u - J b with b = B^-1 J'u.  The covariance of noise and fit, twice, and that of the
        fit are added to the average without a fit.  ``inverse`` B^-1 (n, n) of the campaign, on
        what is identified; ``spread_of_fit`` (n, n): covariance of b.
        """
        here = np.ix_(self.own, self.own)
        spread = _smoothed(self.squares, self.weights)
        both = ([0, 2], [0, 2])
        cross = np.tensordot(self.follows @ inverse[here], spread, both)
        fit: FloatArray = np.tensordot(spread @ spread_of_fit[here], self.squares, both)
        return self.unfitted - cross - cross.T + fit

    def tally(self, inverse: FloatArray) -> tuple[FloatArray, FloatArray]:
        """(n,) mean and half the variance of every parameter's measured variance, by blocks."""
        own = inverse[self.own]
        v = ((self.noisy @ own) * own).sum(axis=1)
        return v.sum(axis=0), (v * _smoothed(v, self.weights**2)).sum(axis=0)


def _smoothed(values: FloatArray, weights: FloatArray) -> FloatArray:
    """sum_j weights[|i - j|] values[j] along the first axis."""
    flat = values.reshape(len(values), -1)
    both = np.concatenate([weights[:0:-1], weights])
    found = oaconvolve(flat, both[:, None], mode="full", axes=0)
    start = len(weights) - 1
    result: FloatArray = found[start : start + len(values)].reshape(values.shape)
    return result


def scores_of(
    J: FloatArray, r: FloatArray, scale: FloatArray, phi: float, lags: int, own: np.ndarray
) -> Scores:
    """The record of scores J_i r_i (n, m), weighted over ``lags``.

    ``scale`` (n,) and ``phi``: the AR(1) law of the correction; rows of zeros for gaps.
    """
    n, m = J.shape
    lags = min(max(lags, 0), n - 1)
    scaled = J * scale[:, None]
    forward = lfilter([1.0], [1.0, -phi], scaled, axis=0)
    backward = lfilter([1.0], [1.0, -phi], scaled[::-1], axis=0)[::-1]
    noise = (forward + backward - scaled) * scale[:, None]  # Sigma J
    # Bartlett weights times phi^d, until nothing is left of it
    reach = lags if abs(phi) < 1e-9 else min(lags, int(log(1e-9) / log(abs(phi))))
    d = np.arange(reach + 1)
    kernel = (1.0 - d / (lags + 1.0)) * phi**d
    mixed = scaled.T @ oaconvolve(scaled, kernel[:, None], axes=0)[:n]
    size = max((lags + 1) // BLOCKS, 1)
    rows = -(-n // size) * size

    def by_block(left: FloatArray, right: FloatArray) -> FloatArray:
        padded = np.zeros((2, rows, m))
        padded[0, :n], padded[1, :n] = left, right
        parts = padded.reshape(2, -1, size, m)
        found: FloatArray = parts[0].transpose(0, 2, 1) @ parts[1]
        return found

    apart = np.arange(-(-(lags + 1) // size))
    return Scores(
        own,
        newey_west(J * r[:, None], lags),
        mixed + mixed.T - scaled.T @ scaled,
        by_block(J, J),
        by_block(J, noise),
        by_block(scaled, scaled),
        1.0 - apart * size / (lags + 1.0),
    )


@dataclass(frozen=True, eq=False)
class Sandwich:
    """Covariance of least squares in psi's mean part."""

    cov: FloatArray
    """(n, n)"""
    identified: np.ndarray
    """(n,)"""
    degrees: FloatArray
    """(n,) of freedom of every variance; infinite in the AR(1) form"""
    bandwidths: dict[str, float]
    """samples, by experiment; empty in the AR(1) form"""

    def factor(self, level: float) -> FloatArray:
        """(n,) quantile of Student's t at a two-sided ``level``."""
        found: FloatArray = stats.t.ppf(0.5 + 0.5 * level, self.degrees)
        return found


def judged(
    records: list[Scores], bread: FloatArray, middle: FloatArray, bandwidths: dict[str, float]
) -> Sandwich:
    """The measured covariance B^-1 M B^-1, corrected, with degrees of freedom.

    ``bread`` B and ``middle``, M of the AR(1) law (n, n).  Degrees of freedom: Satterthwaite's
    (Biometrics Bull. 2, 110, 1946).
    """
    n = len(bread)
    found, identified = invert(bread)
    inverse = np.where(np.isfinite(found), found, 0.0)
    # a fit takes out every direction that is identified, also those no single parameter owns
    scale = 1.0 / np.sqrt(np.maximum(np.diag(bread), 1e-300))
    unit = np.outer(scale, scale)
    removed = np.linalg.pinv(bread * unit, rcond=SINGULAR, hermitian=True) * unit
    spread_of_fit = removed @ middle @ removed
    measured, expected = np.zeros((n, n)), np.zeros((n, n))
    mean, half = np.zeros(n), np.zeros(n)
    for record in records:
        here = np.ix_(record.own, record.own)
        measured[here] += record.measured
        expected[here] += record.expected(removed, spread_of_fit)
        own_mean, own_half = record.tally(inverse)
        mean, half = mean + own_mean, half + own_half
    target = np.diag(inverse @ middle @ inverse)
    there = np.maximum(np.diag(inverse @ expected @ inverse), (1.0 - MOST_MISSED) * target)
    some = there > 0.0
    missed = np.sqrt(np.divide(target, there, out=np.ones(n), where=some))
    cov = inverse @ measured @ inverse * np.outer(missed, missed)
    degrees = np.divide(mean**2, half, out=np.full(n, np.inf), where=half > 0.0)
    return Sandwich(cov, identified, np.maximum(degrees, 1.0), bandwidths)


def sandwich_covariance(
    surface: Surface,
    psi: FloatArray,
    fitted: FloatArray,
    coloured: Problem,
    noise: FloatArray,
    parametric: bool = False,
) -> Sandwich:
    """The spread of least squares.

    Sensitivities are taken at ``psi`` (n_psi,), residuals at the theta ``fitted`` (n_theta,).  The
    AR(1) law is that of the problem ``coloured`` at the noise parameters of ``noise`` (n_theta,):
    it is the result if ``parametric``, and otherwise gives the correction of the measured one.
    Experiments are processed one at a time, with seven columns each, to save memory.
    """
    problem = surface.problem
    theta = surface.coordinates.theta(psi)
    positions = {name: i for i, name in enumerate(surface.mean_names)}
    n = len(positions)
    slopes = surface.coordinates.slopes(theta)[np.ix_(surface.mean, surface.mean)]
    vector = np.where(np.isin(np.arange(len(theta)), coloured.layout.noise), noise, theta)
    bread, middle = np.zeros((n, n)), np.zeros((n, n))
    bandwidths: dict[str, float] = {}
    records: list[Scores] = []
    for k, e in enumerate(problem.campaign):
        grid = e.interval if e.regular else None
        _, _, index, slopes_of_mean, _ = mean_derivatives(problem, theta, k, e.t, grid)
        J = np.where(e.used, slopes_of_mean, 0.0).T
        own = np.array([positions[problem.layout.names[i]] for i in index])
        here = np.ix_(own, own)
        J = J @ slopes[here]
        scale = np.sqrt(mean_and_variance(coloured, vector, k)[1])
        phi = lag_coefficient(float(vector[coloured.layout.noise[k, 0]]), problem.steps(e))
        bread[here] += J.T @ J
        if parametric:
            middle[here] += ar1_middle(J * scale[:, None], phi)
            continue
        r = np.where(e.used, e.values - mean_and_variance(problem, fitted, k)[0], 0.0)
        bandwidths[e.name] = andrews_bandwidth(J * r[:, None])
        records.append(scores_of(J, r, scale, phi, round(bandwidths[e.name]), own))
        middle[here] += records[-1].follows.sum(axis=0)
    if not parametric:
        return judged(records, bread, middle, bandwidths)
    found, identified = invert(bread)
    inverse = np.where(np.isfinite(found), found, 0.0)
    return Sandwich(inverse @ middle @ inverse, identified, np.full(n, np.inf), {})


def sandwich_of(evidence: Evidence, parametric: bool) -> Sandwich:
    """The covariance of the evidence's least-squares fit."""
    fitted = evidence.white.coordinates.theta(evidence.psi_white)
    return sandwich_covariance(
        evidence.white,
        evidence.psi_expansion,
        fitted,
        evidence.problem,
        evidence.theta,
        parametric,
    )


def sandwich_bound(
    evidence: Evidence,
    found: Sandwich,
    factor: Callable[[float], float | FloatArray],
    details: dict[str, object],
) -> Bound:
    """Intervals from a sandwich covariance; ``factor``: z or t of a level."""
    along_tau = evidence.white_along_tau
    if along_tau is not None:
        # least squares' tau^2 scatters along tau as it does under white noise, times one factor
        taus, spreads = along_tau
        tau = float(np.sqrt(evidence.psi_expansion[0]))
        along_tau = None
        if tau <= taus[-1] and np.isfinite(spreads).all():
            here = np.sqrt(found.cov[0, 0]) / np.interp(tau, taus, spreads)
            along_tau = taus, spreads * here
    return gaussian_bound(
        evidence.white.mean_names,
        evidence.estimate,
        found.cov,
        evidence.at_bound,
        factor,
        identified=found.identified,
        details=details,
        along_tau=along_tau,
    )
