"""Check that a fit belongs to the campaign with which it is used."""

from __future__ import annotations

from math import sqrt

import numpy as np

from bayes_sensor.campaign import CampaignError
from bayes_sensor.fit.fit import Fit
from bayes_sensor.fit.fitted_noise import mean_square
from bayes_sensor.fit.refinement import with_noise
from bayes_sensor.likelihood.problem import Problem

ANOTHER = 1e-5
"""relative difference of the RMS of residuals from which a fit is of other data"""


def check_data_of_fit(problem: Problem, fit: Fit, *others: Problem) -> None:
    """Raise CampaignError if the fit has the problem's names but other data.

    ``others``: the same data under other models that the fit may be of.
    """
    n = problem.campaign.n_samples
    if fit.n_samples != n:
        raise CampaignError(
            f"the fit is of {fit.n_samples} samples, the campaign has {n}; fit this campaign first"
        )
    found = []
    for each in (problem, *others):
        theta = np.array(fit.theta_hat, dtype=float)
        if len(theta) == each.layout.n_mean:
            theta = with_noise(each.layout, theta)
        found.append(sqrt(mean_square(each, theta)))
        if abs(found[-1] - fit.rms) <= ANOTHER * fit.rms:
            return
    raise CampaignError(
        f"at the fit's parameters the residuals have an RMS of {found[0]:.6g}, the fit says "
        f"{fit.rms:.6g}: it is of other data; fit this campaign first"
    )
