"""Exchange of valve and manifold where flows are too similar for the data to separate the two.

At one flow the response does not change when tau_v and V/Q are exchanged.  If all flows of a
campaign are equal this is exact, and the lags are assigned afterwards
(:mod:`bayes_sensor.rig.lags`). If they differ by a few percent, both orders may be equally good,
and ensembles exchange them.
"""

from __future__ import annotations

import numpy as np

from bayes_sensor.campaign import FloatArray
from bayes_sensor.likelihood.density import log_likelihood
from bayes_sensor.likelihood.prior_density import log_prior
from bayes_sensor.likelihood.problem import Problem
from bayes_sensor.rig.cascade import exchanged
from bayes_sensor.rig.rig import PUBLISHED

ALIKE = 0.1
"""relative spread of total flows up to which the two orders may be equally good"""
NEGLIGIBLE = 15.0
"""difference in log posterior density from which an order is left out"""


def flow_of_both(problem: Problem) -> float | None:
    """mL/s, the flow at which tau_v and V/Q may be exchanged; None if the flows separate them, or
    are equal."""
    if problem.flow is not None or problem.fixed.keys() & {"tau_v_s", "V_mL"}:
        return None
    if problem.layout.shared_names != PUBLISHED.names or problem.layout.sensors_are_named:
        return None
    flows = np.array([e.total_flow for e in problem.campaign])
    middle = float(np.median(flows))
    return middle if float(np.ptp(flows)) <= ALIKE * middle else None


def likelier_order(problem: Problem, start: FloatArray) -> tuple[FloatArray, float | None]:
    """``start`` (n_theta,) in the order of higher posterior density; the flow if both orders count.

    None where flows differ, or the other order is far less likely.
    """
    flow = flow_of_both(problem)
    if flow is None:
        return start, None
    other = exchanged(start, flow)
    here, there = (log_likelihood(problem, x) + log_prior(problem, x) for x in (start, other))
    if not (np.isfinite(there) or np.isfinite(here)):
        return start, flow
    return (other if there > here else start), flow if abs(there - here) < NEGLIGIBLE else None
