"""How well chains agree and how much they hold: R-hat, effective sample sizes, Pareto k-hat.

Rank-normalised split R-hat, bulk and tail effective sample size: Vehtari, Gelman, Simpson,
Carpenter and Bürkner, Bayesian Analysis 16, 667 (2021), with Geyer's initial monotone sequence
(Statist. Sci. 7, 473, 1992).  The same numbers as ArviZ's, for all parameters at once and without
ArviZ's start-up time of two seconds.
"""

from __future__ import annotations

from math import ceil, log10, sqrt

import numpy as np

from bayes_sensor.campaign import FloatArray
from bayes_sensor.compiled import compiled


def diagnostics(chains: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Rank R-hat, bulk and tail ESS (n_parameters,) of chains (n_chain, n_draw, n_parameters).

    A parameter that does not vary has R-hat nan and as many effective draws as draws.
    """
    draws = np.ascontiguousarray(np.moveaxis(chains, -1, 0))  # (n_parameters, n_chain, n_draw)
    flat = draws.reshape(len(draws), -1)
    split = _split(draws)
    scores = _normal_scores(split)
    r_hat = np.maximum(_r_hat(scores), _r_hat(_normal_scores(_folded(split))))
    low, high = np.quantile(flat, [0.05, 0.95], axis=1)[:, :, None, None]
    tails = [_effective(_split((draws <= level).astype(float))) for level in (low, high)]
    return r_hat, _effective(scores), np.minimum(*tails)


def r_hat_of_whole(chains: FloatArray) -> FloatArray:
    """Rank R-hat (n_parameters,) of chains (n_chain, n_draw, n_parameters) that are not cut in two.

    For draws whose order says nothing: sets of them are compared with each other.
    """
    draws = np.ascontiguousarray(np.moveaxis(chains, -1, 0))
    scores = _normal_scores(draws)
    found: FloatArray = np.maximum(_r_hat(scores), _r_hat(_normal_scores(_folded(draws))))
    return found


def _folded(draws: FloatArray) -> FloatArray:
    """Distances from the median of all chains: what they say is about spread."""
    found: FloatArray = np.abs(draws - np.median(draws, axis=(1, 2), keepdims=True))
    return found


def _split(draws: FloatArray) -> FloatArray:
    """(n_parameters, 2 n_chain, n_draw // 2): every chain cut in two."""
    half = draws.shape[2] // 2
    return np.concatenate([draws[:, :, :half], draws[:, :, draws.shape[2] - half :]], axis=1)


def _normal_scores(draws: FloatArray) -> FloatArray:
    """Normal quantiles of the draws' ranks among all chains; equal draws share their mean rank."""
    from scipy.special import ndtri

    flat = draws.reshape(len(draws), -1)
    n = flat.shape[1]
    ranks = np.empty(flat.shape)
    order = np.argsort(flat, axis=1)
    for row, place, rank in zip(flat, order, ranks):
        ordered = row[place]
        starts = np.flatnonzero(np.concatenate([[True], ordered[1:] != ordered[:-1]]))
        ends = np.append(starts[1:], n)
        rank[place] = np.repeat(0.5 * (starts + ends + 1), ends - starts)
    # Blom's offset (Vehtari et al., eq. 14)
    scores: FloatArray = ndtri((ranks - 0.375) / (n + 0.25))
    return scores.reshape(draws.shape)


def _r_hat(draws: FloatArray) -> FloatArray:
    n = draws.shape[2]
    within = draws.var(axis=2, ddof=1).mean(axis=1)
    between = draws.mean(axis=2).var(axis=1, ddof=1)
    with np.errstate(divide="ignore", invalid="ignore"):
        ratio: FloatArray = np.sqrt((n - 1) / n + between / within)
    return ratio


def _effective(draws: FloatArray) -> FloatArray:
    """Effective sample size (n_parameters,) of chains (n_parameters, n_chain, n_draw)."""
    _, n_chain, n = draws.shape
    centred = draws - draws.mean(axis=2, keepdims=True)
    size = 1 << (2 * n - 1).bit_length()
    sums = np.empty((len(draws), n))
    for total, chains in zip(sums, centred):
        power = np.abs(np.fft.rfft(chains, size)) ** 2
        total[:] = np.fft.irfft(power.mean(axis=0), size)[:n] / n
    spread = draws.mean(axis=2).var(axis=1, ddof=1) if n_chain > 1 else np.zeros(len(draws))
    least = np.ptp(draws.reshape(len(draws), -1), axis=1)
    found = np.empty(len(draws))
    for i in range(len(draws)):
        if least[i] < np.finfo(float).resolution:
            found[i] = n_chain * n
        else:
            tau = _correlation_time(sums[i], spread[i])
            found[i] = n_chain * n / max(tau, 1.0 / log10(n_chain * n))
    return found


@compiled()
def _correlation_time(covariance: FloatArray, between: float) -> float:
    # 1 + 2 sum of autocorrelations, up to the last pair of lags whose sum is positive and with
    # these sums made to fall (Vehtari et al., eqs. 9-11); covariance (n,): mean over the chains
    n = len(covariance)
    within = covariance[0] * n / (n - 1.0)
    total = covariance[0] + between
    previous = 1.0 + 1.0 - (within - covariance[1]) / total  # the pair of lags 0 and 1
    tau = -1.0
    t = 1
    pair = previous
    even = 1.0
    while t < n - 3 and pair > 0.0:
        tau += 2.0 * min(pair, previous)
        previous = min(pair, previous)
        even = 1.0 - (within - covariance[t + 1]) / total
        pair = even + 1.0 - (within - covariance[t + 2]) / total
        t += 2
    return tau + max(even, 0.0)


def pareto_k(log_weights: FloatArray) -> float:
    """Shape of the generalised Pareto law fitted to the largest of the weights (n,).

    Below .5 the weights have a finite variance and the proposal may be trusted (Vehtari et al.,
    Pareto smoothed importance sampling, JMLR 25, 2024).  The fit is that of Zhang and Stephens
    (Technometrics 51, 316, 2009), drawn to .5 with the weight of ten observations.
    """
    log_weights = np.asarray(log_weights)[np.isfinite(log_weights)]
    n = len(log_weights)
    if n < 100:
        return float("inf")
    if np.ptp(log_weights) < 1e-12:
        return float("-inf")
    n_tail = ceil(min(0.2 * n, 3.0 * sqrt(n)))
    ordered = np.sort(np.exp(log_weights - log_weights.max()))
    if ordered[-n_tail - 1] < 1e-280:  # nothing beside the largest; inverses would overflow
        return float("inf")
    excess = ordered[-n_tail:] - ordered[-n_tail - 1]
    excess = excess[excess > 0.0]
    if len(excess) <= 4:
        return float("inf")
    n = len(excess)
    m = 30 + int(sqrt(n))
    # the grid of inverse scales and their profile likelihood (eqs. 8 and 9 there)
    theta = (1.0 - np.sqrt(m / (np.arange(m) + 0.5))) / (3.0 * excess[int(0.25 * n + 0.5) - 1])
    theta += 1.0 / excess[-1]
    shape = np.log1p(-theta[:, None] * excess).mean(axis=1)
    profile = n * (np.log(-theta / shape) - shape - 1.0)
    weights = np.exp(profile - profile.max())
    best = float(weights @ theta / weights.sum())
    k = float(np.log1p(-best * excess).mean())
    return (n * k + 10.0 * 0.5) / (n + 10.0)
