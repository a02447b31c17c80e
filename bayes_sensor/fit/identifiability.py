"""Whether the data determine anything: enough samples, two levels, noise, a visible step."""

from __future__ import annotations

from math import sqrt

import numpy as np

from bayes_sensor.campaign import Campaign, Experiment, FloatArray
from bayes_sensor.likelihood.problem import Problem

FEWEST = 5
"""samples of one experiment; y0, beta, t0 and tf alone are four parameters"""
ROUNDING = 1e-10
"""RMS residual over the range of the samples below which only rounding is left"""
ROUNDINGS = 8.0
"""the same over the rounding of the largest sample; y0 + beta x rounds about as often"""
LEAST_RANGE = 0.02
"""of the response over the used samples, below which y0 and beta cannot be separated"""
SEEN = 8.0
"""step over its standard error above which it is seen.  The fit looks for a step wherever the
commands allow one, and finds up to seven standard errors in pure noise."""
STEADY = 20.0
"""correlation times of the noise that a record must contain for least squares to estimate its
spread"""
WHITE = 1.02
"""factor of a spread up to which correlated noise counts as white"""


def step_error(e: Experiment, r: FloatArray, x: FloatArray) -> float:
    """Standard error of the step size, V: low against high x3, from the scatter of block means.

    Forty block means contain slow noise; their median deviation ignores the few blocks in which the
    model does not fit.
    """
    z = r[e.used]
    size = max(len(z) // 40, 1)
    n = len(z) // size
    means = z[: n * size].reshape(n, size).mean(axis=1)
    spread = 1.4826 * float(np.median(np.abs(means - np.median(means))))
    # in blocks, and not rounded up: a spike of a few samples is no better known than these
    n_high = float(np.clip(x[e.used].sum() / size, 1e-12, n))
    return spread * sqrt(1.0 / n_high + 1.0 / max(n - n_high, 1.0))


def least_noise(campaign: Campaign) -> float:
    """V, the RMS up to which residuals may be rounding alone.

    The model's rounding is proportional to the samples' range, that of the floats to their distance
    from zero.
    """
    ranges = (float(np.ptp(e.values[e.used])) for e in campaign)
    return max(ROUNDING * max(ranges), ROUNDINGS * campaign.rounding)


def cannot_tell(
    problem: Problem, vector: FloatArray, residuals: list[tuple[FloatArray, FloatArray]]
) -> str:
    """Why no interval can be given, as a sentence; empty where one can.

    ``residuals``: of every experiment r (n_t,) in V and x3 (n_t,) at ``vector`` (n_theta,).
    """
    campaign, unit = problem.campaign, problem.campaign.signal_unit
    for e, (_, x) in zip(campaign, residuals):
        if e.n_samples < FEWEST:
            return (
                f"experiment '{e.name}': {e.n_samples} samples are used, fewer than its own "
                f"parameters need; expected at least {FEWEST} and hundreds for a result: shorten "
                "mask and keep, or leave the experiment out"
            )
        x = x[e.used]
        if float(x.max() - x.min()) < LEAST_RANGE:
            return (
                f"experiment '{e.name}': the samples that are used hold less than "
                f"{100 * LEAST_RANGE:.0f} % of the step's response, so baseline, step and lags "
                "cannot be told apart; expected samples before and well after the step: shorten "
                "mask and keep, record longer, or leave the experiment out"
            )
    n_mean = problem.layout.n_mean
    if campaign.n_samples <= n_mean:
        return (
            f"{campaign.n_samples} samples are used for {n_mean} parameters; expected hundreds "
            "for each experiment: shorten mask and keep, or record longer"
        )
    rms = sqrt(sum(float(r @ r) for r, _ in residuals) / campaign.n_samples)
    if rms <= least_noise(campaign):
        return (
            f"the model meets every sample to within rounding (RMS {rms:.1e} {unit}), so there is "
            "no noise by which to judge an interval; expected a measured signal: check that the "
            "right column is read (noise-free simulations can be fitted, not bounded)"
        )
    return ""


def step_is_seen(
    problem: Problem, vector: FloatArray, residuals: list[tuple[FloatArray, FloatArray]]
) -> bool:
    """Whether the step of any experiment exceeds the noise."""
    for k, (e, (r, x)) in enumerate(zip(problem.campaign, residuals)):
        beta = abs(float(vector[problem.layout.local[k, 1]]))
        if beta > SEEN * step_error(e, r, x):
            return True
    return False


def slow_noise(problem: Problem, vector: FloatArray) -> str:
    """A clause if the noise is correlated over too much of the records; else empty."""
    campaign = problem.campaign
    for k, e in enumerate(campaign):
        phi = float(vector[problem.layout.noise[k, 0]])
        if phi <= 0.0:
            continue
        time = campaign.reference_interval / -np.log(phi)
        duration = len(e.t) * e.interval
        if duration < STEADY * time:
            # beyond the record's length the time is no longer measured
            over = f"{time:.2g} s" if time < duration else "all its length"
            return (
                f"the noise of experiment '{e.name}' is correlated over {over}, not short against "
                f"its {duration:.3g} s"
            )
    return ""


def coloured_noise(problem: Problem, vector: FloatArray) -> str:
    """A sentence if the noise at ``vector`` (n_theta,) is not white; empty where it may be.

    A coefficient counts beyond three of its standard errors 1/sqrt(n) under white noise, where
    it changes the spread of slow means, sqrt((1 + phi)/(1 - phi)), by more than ``WHITE``.
    """
    campaign, layout = problem.campaign, problem.layout
    worst, most = 0.0, 1.0
    for k, e in enumerate(campaign):
        phi = float(vector[layout.noise[k, 0]])
        n = e.n_samples if layout.noise_per_experiment else campaign.n_samples
        factor = sqrt((1.0 + phi) / (1.0 - phi))
        if abs(phi) > 3.0 / sqrt(n) and max(factor, 1.0 / factor) > max(most, 1.0 / most, WHITE):
            worst, most = phi, factor
    if worst == 0.0:
        return ""
    side, times = ("narrow", most) if worst > 0.0 else ("wide", 1.0 / most)
    return (
        f"the residuals are not white (phi {worst:.2g}): intervals that take them for white are "
        f"too {side}, by a factor of about {times:.3g}"
    )
