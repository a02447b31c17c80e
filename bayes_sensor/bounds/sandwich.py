"""Sandwich covariance of least squares: what its spread is when the noise is not iid.

cov = B^-1 M B^-1 with B = J'J and M the long-run covariance of the scores J_i r_i; M either with
Bartlett weights over a bandwidth chosen from the scores (Newey and West, Econometrica 55, 1987;
Andrews, Econometrica 59, 1991, eqs. 6.2 and 6.4), or from a fitted AR(1) with
concentration-dependent scale.  Experiments are independent of one another.
"""

from __future__ import annotations

import numpy as np
from scipy.signal import lfilter

from bayes_sensor.bounds.evidence import Evidence
from bayes_sensor.bounds.gaussian import gaussian_bound, invert
from bayes_sensor.bounds.records import Bound
from bayes_sensor.bounds.sensitivities import local_jacobian
from bayes_sensor.bounds.surface import Surface
from bayes_sensor.campaign import FloatArray
from bayes_sensor.likelihood import Problem, mean_and_variance
from bayes_sensor.noise import lag_coefficient

REFERENCE = "Newey and West, Econometrica 55, 703 (1987); Andrews, Econometrica 59, 817 (1991)"


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


def sandwich_covariance(
    surface: Surface,
    psi: FloatArray,
    fitted: FloatArray,
    coloured: Problem | None = None,
    noise: FloatArray | None = None,
) -> tuple[FloatArray, np.ndarray, dict[str, float]]:
    """Covariance (n, n) of least squares in psi's mean part, (n,) identified, bandwidths.

    Sensitivities are taken at ``psi`` (n_psi,), residuals at the theta ``fitted`` (n_theta,).

    Without ``coloured``: Newey-West.  With it: the AR(1) form, for that problem's noise law at the
    noise parameters of ``noise`` (n_theta,).  One experiment at a time, seven columns each: the
    scores of the whole campaign are never held together.
    """
    problem = surface.problem
    theta = surface.coordinates.theta(psi)
    positions = {name: i for i, name in enumerate(surface.mean_names)}
    n = len(positions)
    slopes = surface.coordinates.slopes(theta)[np.ix_(surface.mean, surface.mean)]
    bread, middle = np.zeros((n, n)), np.zeros((n, n))
    bandwidths: dict[str, float] = {}
    for k, e in enumerate(problem.campaign):
        J, index = local_jacobian(problem, theta, k)
        local = np.array([positions[problem.layout.names[i]] for i in index])
        J = J @ slopes[np.ix_(local, local)]
        if coloured is None:
            mean, _ = mean_and_variance(problem, fitted, k)
            r = np.where(e.used, e.values - mean, 0.0)
            scores = J * r[:, None]
            bandwidths[e.name] = andrews_bandwidth(scores)
            part = newey_west(scores, round(bandwidths[e.name]))
        else:
            assert noise is not None  # given together
            vector = np.where(np.isin(np.arange(len(theta)), coloured.layout.noise), noise, theta)
            _, s2 = mean_and_variance(coloured, vector, k)
            phi = lag_coefficient(float(vector[coloured.layout.noise[k, 0]]), problem.steps(e))
            part = ar1_middle(J * np.sqrt(s2)[:, None], phi)
        bread[np.ix_(local, local)] += J.T @ J
        middle[np.ix_(local, local)] += part
    inverse, identified = invert(bread)
    finite = np.where(np.isfinite(inverse), inverse, 0.0)
    return finite @ middle @ finite, identified, bandwidths


def sandwich(evidence: Evidence, parametric: bool = False) -> Bound:
    """Least squares with the sandwich covariance; ``parametric``: its AR(1) form."""
    surface, psi = evidence.white, evidence.psi_expansion
    fitted = surface.coordinates.theta(evidence.psi_white)
    if parametric:
        cov, identified, _ = sandwich_covariance(
            surface, psi, fitted, evidence.problem, evidence.theta
        )
        assumes = (
            "least squares under AR(1) noise with concentration-dependent scale, whose fitted "
            "parameters stand in the covariance"
        )
        details: dict[str, object] = {}
    else:
        cov, identified, bandwidths = sandwich_covariance(surface, psi, fitted)
        assumes = (
            "least squares; noise stationary in its correlations over short lags but otherwise "
            "unspecified, experiments independent"
        )
        details = {"bandwidth_samples": bandwidths, "kernel": "Bartlett"}
    return gaussian_bound(
        "sandwich_ar1" if parametric else "sandwich",
        assumes,
        REFERENCE,
        surface.mean_names,
        evidence.estimate,
        cov,
        evidence.at_bound,
        identified=identified,
        details=details,
    )
