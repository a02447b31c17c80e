"""The exact Gaussian log-likelihood of a campaign, and simulated campaigns.

With r = (y - m)/s, AR(1) coefficient phi over one sample and phi_i over the step to sample i
(phi^(m + 1) across m missing samples, phi^(step/interval) over any step), a stationary first
sample gives::

    log L = -1/2 sum_i [log 2 pi + log s_i^2]
            -1/2 r_1^2 - 1/2 sum_(i>1) [(r_i - phi_i r_(i-1))^2 / (1 - phi_i^2) + log(1 - phi_i^2)]

(Brockwell and Davis, Time Series: Theory and Methods, 1991, eq. 8.7.4 for the AR(1) case.)
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from math import log, pi, sqrt

import numpy as np
from numpy.typing import NDArray

from bayes_sensor.campaign import Campaign, CampaignError, Experiment, FloatArray
from bayes_sensor.compiled import compiled
from bayes_sensor.likelihood.noise import (
    check_phi,
    lag_coefficient,
    scale_squared,
    simulate_noise,
)
from bayes_sensor.likelihood.problem import Problem, as_problem
from bayes_sensor.rig.cascade import pulse, response
from bayes_sensor.rig.chain import chain_response
from bayes_sensor.rig.layout import Theta


def grid_response(
    experiment: Experiment, taus: FloatArray, t0: float, tf: float | None
) -> FloatArray:
    """Response (n_t,) of lags ``taus`` (n_lags,) s to one pulse, at the experiment's own times."""
    interval = experiment.interval if experiment.regular else None
    return chain_response(experiment.t, taus, pulse(t0, tf), interval)


def response_at_samples(problem: Problem, vector: FloatArray, k: int) -> FloatArray:
    """Response (n_t,) of experiment number ``k`` at its own times, on a grid by recurrence, which
    is fast."""
    e = problem.campaign.experiments[k]
    interval = e.interval if e.regular else None
    return response(e.t, vector, problem.layout, k, e.total_flow, interval)


@compiled()
def _log_density(
    y: FloatArray,
    m: FloatArray,
    s2: FloatArray,
    runs: NDArray[np.int64],
    pauses: FloatArray,
    phi: float,
    phi_reference: float,
    steps: float,
) -> float:
    # runs (n_runs, 2) with pauses (n_runs,) before them, in samples; phi over one sample; across a
    # pause phi_reference ** (steps * pause)
    total = 0.0
    n = 0
    last = 0.0
    innovation = 1.0 - phi * phi
    log_innovation = log(innovation)
    for run in range(len(runs)):
        a, b = runs[run, 0], runs[run, 1]
        n += b - a
        z = (y[a] - m[a]) / sqrt(s2[a])
        if run == 0:
            total += z * z
        else:
            distance = pauses[run]
            across = phi**distance if phi_reference < 0 else phi_reference ** (steps * distance)
            rest = 1.0 - across * across
            e = z - across * last
            total += e * e / rest + log(rest)
        product = 1.0
        squares = 0.0
        unit = 1.0 / s2[a]  # of the variance, whatever the volts are
        total -= (b - a) * log(unit)
        for i in range(a + 1, b):
            z_next = (y[i] - m[i]) / sqrt(s2[i])
            e = z_next - phi * z
            squares += e * e
            z = z_next
            product *= s2[i] * unit
            # products leave the range of doubles long after 8 factors of any sensible variance
            if (i - a) & 7 == 0:
                total += log(product)
                product = 1.0
        total += log(product) + squares / innovation + (b - a - 1) * log_innovation
        last = z
    return -0.5 * (total + n * log(2.0 * pi))


def noise_in_range(
    problem: Problem, vector: FloatArray, k: int
) -> tuple[float, float, float, float] | None:
    """phi over one sample, phi, sigma0, sigma1 (V) of experiment number ``k``; None where one of
    them or a time constant has a value that no likelihood allows.

    Raises CampaignError where the flat vector (n_theta,) has no sigma0.
    """
    phi_reference, sigma0, sigma1 = (float(v) for v in vector[problem.layout.noise[k]])
    if np.isnan(sigma0):
        raise CampaignError("theta lacks sigma0_V; a likelihood needs the noise's size in volts")
    if not (abs(phi_reference) < 1.0 and sigma0 > 0.0 and sigma1 >= 0.0):
        return None
    if problem.noise.fading and sigma1 == 0.0:
        return None  # no noise at all is left at the highest concentration
    e = problem.campaign.experiments[k]
    if phi_reference < 0.0 and not e.regular:
        return None  # it has no real power over such times
    phi = lag_coefficient(phi_reference, problem.steps(e))
    if not (abs(phi) < 1.0 and (vector[: problem.layout.n_shared] > 0).all()):
        return None
    return phi, phi_reference, sigma0, sigma1


def experiment_log_likelihood(
    problem: Problem, vector: FloatArray, k: int, y: FloatArray | None = None
) -> float:
    """Log density of experiment number ``k`` at the flat vector; -inf outside the noise's range."""
    e = problem.campaign.experiments[k]
    noise = noise_in_range(problem, vector, k)
    if noise is None:
        return -np.inf
    phi, phi_reference, _, _ = noise
    values, steps = e.values if y is None else y, problem.steps(e)
    if problem.is_affine:  # from its own level a signal far from zero keeps its digits
        i_y0 = problem.layout.local[k, 0]
        values, vector = values - vector[i_y0], vector.copy()
        vector[i_y0] = 0.0
    mean, s2 = mean_and_variance(problem, vector, k)
    return float(_log_density(values, mean, s2, e.even_runs, e.pauses, phi, phi_reference, steps))


def over_levels(
    problem: Problem, vector: FloatArray, k: int, unit: float
) -> Callable[[float, float], float]:
    """Log density of experiment number ``k`` by moves of y0 and beta in ``unit``, where the mean is
    affine in both: the response is computed once."""
    e, (i_y0, i_beta) = problem.campaign.experiments[k], problem.layout.local[k, :2]
    noise = noise_in_range(problem, vector, k)
    if noise is None:
        return lambda u, w: -np.inf
    phi, phi_reference, _, _ = noise
    own, raised = vector.copy(), vector.copy()
    own[i_y0] = raised[i_y0] = 0.0  # from its own level a signal far from zero keeps its digits
    raised[i_beta] += unit
    mean, s2 = mean_and_variance(problem, own, k)
    if problem.has_plain_mean and own[i_beta] != 0.0:
        slope = unit / own[i_beta] * mean
    else:
        slope = mean_on_grid(problem, raised, k) - mean
    values, steps = e.values - vector[i_y0], problem.steps(e)

    def moved(u: float, w: float) -> float:
        shifted = mean + (u * unit + w * slope)
        return float(
            _log_density(values, shifted, s2, e.even_runs, e.pauses, phi, phi_reference, steps)
        )

    return moved


def mean_and_response(
    problem: Problem, vector: FloatArray, e: Experiment, t: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Mean (n_t,) V and response (n_t,) of any model at any times ``t`` (n_t,) s."""
    layout, model = problem.layout, problem.model
    together = getattr(model, "mean_and_response", None)
    if together is not None:
        mean, x = together(t, vector, layout, e)
        return mean, x
    x = model.response(t, vector, layout, e)
    if problem.has_plain_mean:
        y0, beta = vector[layout.local[layout.place_of(e.name), :2]]
        return y0 + beta * x, x
    return model.mean(t, vector, layout, e), x


def mean_on_grid(problem: Problem, vector: FloatArray, k: int) -> FloatArray:
    """Mean (n_t,) V of experiment number ``k`` on its grid."""
    e = problem.campaign.experiments[k]
    if problem.chain == "exact":
        y0, beta = vector[problem.layout.local[k, :2]]
        mean = response_at_samples(problem, vector, k)
        mean *= beta
        mean += y0
        return mean
    return mean_and_response(problem, vector, e, e.t)[0]


def mean_and_variance(
    problem: Problem, vector: FloatArray, k: int
) -> tuple[FloatArray, FloatArray]:
    """Mean (n_t,) V and noise variance (n_t,) V^2 of experiment number ``k`` on its grid."""
    layout = problem.layout
    e = problem.campaign.experiments[k]
    _, sigma0, sigma1 = vector[layout.noise[k]]
    law = problem.noise.weight(problem.campaign, e), problem.noise.fading
    if problem.chain == "exact":
        y0, beta = vector[layout.local[k, :2]]
        x = response_at_samples(problem, vector, k)
        return y0 + beta * x, scale_squared(x, sigma0, sigma1, *law)
    mean, x = mean_and_response(problem, vector, e, e.t)
    return mean, scale_squared(x, sigma0, sigma1, *law)


def log_likelihood(campaign: Campaign | Problem, theta: Theta) -> float:
    """Exact Gaussian log-likelihood of all samples at ``theta``; -inf outside its range.

    What the problem's noise law pins has its pinned value there (:meth:`Problem.flat`).

    Raises CampaignError for a malformed ``theta`` or a design without data.
    """
    problem = as_problem(campaign)
    vector = problem.flat(theta)
    return sum(experiment_log_likelihood(problem, vector, k) for k in range(len(problem.campaign)))


def _check_noise(problem: Problem, vector: FloatArray, k: int) -> None:
    """Raise CampaignError where experiment number ``k`` cannot have such noise."""
    e = problem.campaign.experiments[k]
    phi = float(vector[problem.layout.noise[k, 0]])
    check_phi(phi, problem.steps(e), e.name)
    if phi < 0.0 and not e.regular:
        raise CampaignError(
            f"experiment '{e.name}': phi is {phi:g}, but its sampling is irregular, and a negative "
            "phi has no real power over such times; expected phi of at least 0: correct it"
        )
    for i in problem.layout.noise[k, 1:]:
        if vector[i] < 0.0:
            raise CampaignError(
                f"theta: {problem.layout.names[i]} is {vector[i]:g}; expected a size of noise, "
                "zero or more: correct it"
            )


def simulate(campaign: Campaign | Problem, theta: Theta, seed: int = 1) -> Campaign:
    """A campaign of the same design with data drawn from the model at ``theta``.

    Noise is that of the problem's noise law with theta's phi, sigma0, sigma1 (absent: white,
    constant; sigma0 absent: no noise); what the law pins has its pinned value
    (:meth:`Problem.flat`).  One seed gives one campaign; every experiment has its own stream by its
    place.  Leaving out the last one does not change the others as long as the highest concentration
    and the most common interval, to which sigma1 and phi refer, remain the same.

    Raises CampaignError for a malformed ``theta``, and where it holds nan, a size of noise below
    zero or a phi that an experiment's noise cannot have.
    """
    problem = as_problem(campaign)
    layout = problem.layout
    vector = problem.flat(theta)
    i_sigma0 = layout.noise[:, 1]
    vector[i_sigma0] = np.where(np.isnan(vector[i_sigma0]), 0.0, vector[i_sigma0])
    if not np.isfinite(vector).all():
        i = int(np.argmin(np.isfinite(vector)))
        raise CampaignError(
            f"theta: {layout.names[i]} is {vector[i]}; a simulation needs a number: give one"
        )
    for k in range(len(problem.campaign)):
        _check_noise(problem, vector, k)
    streams = np.random.SeedSequence(seed).spawn(len(problem.campaign))
    values = {}
    for k, (e, stream) in enumerate(zip(problem.campaign, streams, strict=True)):
        mean, s2 = mean_and_variance(problem, vector, k)
        phi = float(vector[layout.noise[k, 0]])
        if e.regular:
            over: float | FloatArray = lag_coefficient(phi, problem.steps(e))
        else:
            over = phi ** (np.diff(e.t) / problem.campaign.reference_interval)
        rng = np.random.default_rng(stream)
        values[e.name] = mean + simulate_noise(np.sqrt(s2), over, rng)
    return replace(problem.campaign.with_data(values), warnings=())
