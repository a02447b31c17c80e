"""Caveats of a fit: sentences on whether its first line is valid, which every command repeats."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from bayes_sensor.campaign import FloatArray
from bayes_sensor.fit.misfit import Misfit, warning
from bayes_sensor.fit.side_information import SideComparison
from bayes_sensor.likelihood.problem import Problem
from bayes_sensor.likelihood.rise_time import rise_time
from bayes_sensor.rig.cascade import cascade_response


def caveats(
    problem: Problem,
    vector: FloatArray,
    residuals: list[tuple[FloatArray, FloatArray]],
    misfit: Mapping[str, Misfit],
    compared: Sequence[SideComparison] = (),
    hidden: float | None = None,
) -> list[str]:
    """Sentences that come before the first line; empty if it is valid without them.

    ``vector`` (n_theta,): the fit; ``residuals``: of every experiment r (n_t,) in V and x3 (n_t,);
    ``misfit``: of every experiment by name; ``compared``: side information compared with the
    estimate from the data alone; ``hidden``: the sampling interval (s) that hides the response.
    """
    found = [warning(misfit, problem.campaign.signal_unit)]
    found += [each.sentence() for each in compared if each.contradicts]
    if hidden is not None:
        found.append(
            f"the response is over within one sampling interval ({hidden:g} s), which hides its "
            "course: every lag is an upper limit only; sample faster to see more"
        )
    return [text for text in found if text]


def hiding_interval(problem: Problem, vector: FloatArray) -> float | None:
    """s, the shortest sampling interval where the fitted response rises from 10 to 90 % within one
    interval in every experiment; else None."""
    for k, e in enumerate(problem.campaign):
        taus = problem.layout.taus(vector, k, e.total_flow)
        t = np.linspace(0.0, 8.0 * float(taus.sum()), 4001)
        rise = rise_time(t, cascade_response(t, taus, 0.0))
        if rise is None or rise >= e.interval:
            return None
    return min(e.interval for e in problem.campaign)
