"""Compiled Kalman filter and smoother of one record, exact at any sampling times.

The state holds the input, the lags and the noise; one sample is a weighted sum of the state without
any error of its own.  Filter and smoother are those of Durbin and Koopman, *Time Series Analysis
by State Space Methods* (2012), chapter 4: the backward pass needs no inverse of a matrix, and only
two vectors a sample are kept.  Cost and memory grow in proportion to the number of samples.

Where sampling and noise do not change, the covariances settle, and only means are carried on.
"""

from __future__ import annotations

import numpy as np

from bayes_sensor.campaign import BoolArray, FloatArray
from bayes_sensor.compiled import compiled

SETTLED = 1e-12
"""change of a correlation from one sample to the next below which covariances have settled"""


@compiled(nogil=True)
def _times(a: FloatArray, b: FloatArray, found: FloatArray) -> None:
    n = a.shape[0]
    for i in range(n):
        for j in range(n):
            total = 0.0
            for k in range(n):
                total += a[i, k] * b[k, j]
            found[i, j] = total


@compiled(nogil=True)
def discretise(
    drift: FloatArray, diffusion: FloatArray, steps: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Transition and noise covariance (n_steps, d, d) of dx = drift x dt + noise over each step.

    ``diffusion`` (d, d) is the spectral density of the noise.  Both are Taylor series over a step
    halved until it is short, doubled again by Q(2h) = Q(h) + Phi(h) Q(h) Phi(h)'.  No difference
    of large numbers is taken, so that Q keeps its accuracy for short steps, and stiff lags do not
    overflow.
    """
    d = drift.shape[0]
    n = len(steps)
    transitions = np.empty((n, d, d))
    covariances = np.empty((n, d, d))
    norm = 0.0
    for i in range(d):
        row = 0.0
        for j in range(d):
            row += abs(drift[i, j])
        norm = max(norm, row)
    term = np.empty((d, d))
    work = np.empty((d, d))
    c = np.empty((d, d))
    for s in range(n):
        h = steps[s]
        halvings = 0
        while norm * h > 0.25:
            h *= 0.5
            halvings += 1
        phi, q = transitions[s], covariances[s]
        for i in range(d):
            for j in range(d):
                phi[i, j] = term[i, j] = 1.0 if i == j else 0.0
                c[i, j] = diffusion[i, j] * h
                q[i, j] = c[i, j]
        size = 1.0
        for order in range(1, 20):
            size *= norm * h / order
            if size < 1e-18:
                break
            _times(drift, term, work)
            for i in range(d):
                for j in range(d):
                    term[i, j] = work[i, j] * h / order
                    phi[i, j] += term[i, j]
            _times(drift, c, work)
            for i in range(d):
                for j in range(i + 1):
                    value = (work[i, j] + work[j, i]) * h / (order + 1)
                    c[i, j] = value
                    c[j, i] = value
            for i in range(d):
                for j in range(d):
                    q[i, j] += c[i, j]
        for _ in range(halvings):
            _times(phi, q, work)
            _times(work, phi.T, c)
            for i in range(d):
                for j in range(d):
                    q[i, j] += c[i, j]
            _times(phi, phi, work)
            for i in range(d):
                for j in range(d):
                    phi[i, j] = work[i, j]
    return transitions, covariances


@compiled(nogil=True)
def one_after_the_other(
    first: np.ndarray,
    transitions: FloatArray,
    covariances: FloatArray,
    second: np.ndarray,
    then: FloatArray,
    and_covariances: FloatArray,
) -> tuple[FloatArray, FloatArray]:
    """What :func:`discretise` gives (n, d, d) for the sums of steps ``first`` and ``second`` (n,),
    which are places in the ``transitions`` and ``covariances`` of each.

    Q(g + h) = Phi(h) Q(g) Phi(h)' + Q(h), a sum without differences as well.
    """
    n, d = len(first), transitions.shape[1]
    found = np.empty((n, d, d))
    spread = np.empty((n, d, d))
    work = np.empty((d, d))
    for i in range(n):
        phi, q = then[second[i]], and_covariances[second[i]]
        _times(phi, transitions[first[i]], found[i])
        _times(phi, covariances[first[i]], work)
        for j in range(d):
            for k in range(j + 1):
                total = q[j, k]
                for l in range(d):
                    total += work[j, l] * phi[k, l]
                spread[i, j, k] = total
                spread[i, k, j] = total
    return found, spread


@compiled(nogil=True)
def run_filter(
    y: FloatArray,
    scale: FloatArray,
    which: np.ndarray,
    transitions: FloatArray,
    covariances: FloatArray,
    start: FloatArray,
    states: tuple[int, ...],
    direct: BoolArray,
    keep: bool,
) -> tuple[float, FloatArray, FloatArray, FloatArray, FloatArray, FloatArray]:
    """Log likelihood, innovations (n,) with variances, and what the smoother needs.

    ``y`` (n,): the samples, NaN where none was taken.  Each is the last but one of the ``states``
    (0, .., d - 1) + ``scale`` times the last.  Where ``direct`` (n,) it is the first state, the
    input, with an error of its own of standard deviation ``scale``.  ``which`` (n,): the step that
    leads to each sample (the first is not used).
    ``start`` (d, d): covariance of the state at the first sample, its mean is 0.  Without ``keep``
    only the log likelihood and the innovations are filled.
    """
    n, d = len(y), len(states)
    v = np.full(n, np.nan)
    spread = np.full(n, np.nan)
    kept = n if keep else 1
    mean = np.empty(kept)
    row = np.empty((kept, d))
    gains = np.zeros((kept, d))
    a = np.zeros(d)
    filtered = np.zeros(d)
    p = start.copy()
    after = np.empty((d, d))
    work = np.empty((d, d))
    new = np.empty((d, d))
    pz = np.empty(d)
    gain = np.zeros(d)
    s = 1.0
    log_s = 0.0
    settled = False
    log_likelihood = 0.0
    said, noise = d - 2, d - 1
    for i in range(n):
        seen = not np.isnan(y[i])
        if i > 0:
            was_seen = not np.isnan(y[i - 1])
            same = settled and seen and was_seen and which[i] == which[i - 1]
            same = same and scale[i] == scale[i - 1] and direct[i] == direct[i - 1]
            phi = transitions[which[i]]
            for j in range(noise):
                total = 0.0
                for k in range(noise):
                    total += phi[j, k] * filtered[k]
                a[j] = total
            a[noise] = phi[noise, noise] * filtered[noise]
            if not same:
                q = covariances[which[i]]
                for k in range(d):  # the noise passes nothing on, and nothing passes on to it
                    for j in range(noise):
                        total = 0.0
                        for l in range(noise):
                            total += phi[j, l] * after[l, k]
                        work[j, k] = total
                    work[noise, k] = phi[noise, noise] * after[noise, k]
                settled = i > 1 and which[i] == which[i - 1] and seen and was_seen
                settled = settled and scale[i] == scale[i - 1] and direct[i] == direct[i - 1]
                for j in range(noise):
                    for k in range(j + 1):
                        total = q[j, k]
                        for l in range(noise):
                            total += work[j, l] * phi[k, l]
                        new[j, k] = new[k, j] = total
                for k in range(noise):
                    new[noise, k] = new[k, noise] = work[k, noise] * phi[noise, noise]
                new[noise, noise] = q[noise, noise] + work[noise, noise] * phi[noise, noise]
                if settled:
                    for j in range(d):
                        for k in range(j + 1):
                            if abs(new[j, k] - p[j, k]) > SETTLED * np.sqrt(new[j, j] * new[k, k]):
                                settled = False
                for j in range(d):
                    for k in range(d):
                        p[j, k] = new[j, k]
        else:
            same = False
        if keep:
            mean[i] = a[0]
            for j in range(d):
                row[i, j] = p[0, j]
        if not seen:
            for j in range(d):
                filtered[j] = a[j]
                for k in range(d):
                    after[j, k] = p[j, k]
            continue
        if not same:
            if direct[i]:
                for j in range(d):
                    pz[j] = p[j, 0]
                s = p[0, 0] + scale[i] * scale[i]
            else:
                for j in range(d):
                    pz[j] = p[j, said] + scale[i] * p[j, noise]
                s = pz[said] + scale[i] * pz[noise]
            log_s = np.log(2.0 * np.pi * s)
            for j in range(d):
                gain[j] = pz[j] / s
            for j in range(d):
                for k in range(d):
                    after[j, k] = p[j, k] - gain[j] * pz[k]
        if direct[i]:
            v[i] = y[i] - a[0]
        else:
            v[i] = y[i] - a[said] - scale[i] * a[noise]
        spread[i] = s
        log_likelihood -= 0.5 * (log_s + v[i] * v[i] / s)
        for j in range(d):
            filtered[j] = a[j] + gain[j] * v[i]
        if keep:
            for j in range(d):
                gains[i, j] = gain[j]
    return log_likelihood, v, spread, mean, row, gains


@compiled(nogil=True)
def run_smoother(
    v: FloatArray,
    spread: FloatArray,
    mean: FloatArray,
    row: FloatArray,
    gains: FloatArray,
    scale: FloatArray,
    which: np.ndarray,
    transitions: FloatArray,
    states: tuple[int, ...],
    direct: BoolArray,
) -> tuple[FloatArray, FloatArray]:
    """Mean and variance (n,) of the first state given all samples, from what the filter kept."""
    n, d = len(row), len(states)
    smoothed = np.empty(n)
    variance = np.empty(n)
    r = np.zeros(d)
    back = np.zeros(d)
    m = np.zeros((d, d))
    moved = np.zeros((d, d))
    work = np.empty((d, d))
    mk = np.empty(d)
    z = np.zeros(d)
    said, noise = d - 2, d - 1
    settled = False
    value = 0.0
    for i in range(n - 1, -1, -1):
        seen = not np.isnan(v[i])
        same = False
        if i < n - 1:
            phi = transitions[which[i + 1]]
            for j in range(noise):
                total = 0.0
                for k in range(noise):
                    total += phi[k, j] * r[k]
                back[j] = total
            back[noise] = phi[noise, noise] * r[noise]
            same = (
                settled
                and seen
                and i < n - 2
                and which[i + 1] == which[i + 2]
                and scale[i] == scale[i + 1]
                and direct[i] == direct[i + 1]
                and spread[i] == spread[i + 1]
                and row[i, 0] == row[i + 1, 0]
            )
            if not same:
                for j in range(d):
                    for k in range(noise):
                        total = 0.0
                        for l in range(noise):
                            total += m[j, l] * phi[l, k]
                        work[j, k] = total
                for j in range(noise):
                    for k in range(j + 1):
                        total = 0.0
                        for l in range(noise):
                            total += phi[l, j] * work[l, k]
                        moved[j, k] = moved[k, j] = total
                for k in range(noise):
                    moved[noise, k] = moved[k, noise] = phi[noise, noise] * work[noise, k]
                moved[noise, noise] = phi[noise, noise] ** 2 * m[noise, noise]
        if seen:
            for j in range(d):
                z[j] = 0.0
            if direct[i]:
                z[0] = 1.0
            else:
                z[said], z[noise] = 1.0, scale[i]
            kr = 0.0
            for j in range(d):
                kr += gains[i, j] * back[j]
            step = v[i] / spread[i] - kr
            for j in range(d):
                r[j] = back[j] + z[j] * step
            if not same:
                kmk = 0.0
                for j in range(d):
                    total = 0.0
                    for k in range(d):
                        total += moved[j, k] * gains[i, k]
                    mk[j] = total
                for j in range(d):
                    kmk += gains[i, j] * mk[j]
                settled = True
                for j in range(d):
                    for k in range(j + 1):
                        total = moved[j, k] - z[j] * mk[k] - mk[j] * z[k]
                        total += z[j] * z[k] * (kmk + 1.0 / spread[i])
                        work[j, k] = total
                for j in range(d):
                    for k in range(j + 1):
                        size = np.sqrt(abs(work[j, j] * work[k, k]))
                        if abs(work[j, k] - m[j, k]) > SETTLED * size:
                            settled = False
                        m[j, k] = work[j, k]
                        m[k, j] = work[j, k]
        else:
            settled = False
            for j in range(d):
                r[j] = back[j]
                for k in range(d):
                    m[j, k] = moved[j, k]
        total = mean[i]
        for j in range(d):
            total += row[i, j] * r[j]
        smoothed[i] = total
        if not same:
            value = row[i, 0]
            for j in range(d):
                for k in range(d):
                    value -= row[i, j] * m[j, k] * row[i, k]
        variance[i] = max(value, 0.0)
    return smoothed, variance
