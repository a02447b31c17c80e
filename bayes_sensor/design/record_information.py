"""What the record of one planned experiment tells of tau, the rest of the rig and the noise."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from bayes_sensor.campaign import Campaign, FloatArray
from bayes_sensor.design.planned_experiments import PlannedSetting, Truth
from bayes_sensor.likelihood.mesh import expected_information
from bayes_sensor.likelihood.noise import lag_coefficient
from bayes_sensor.likelihood.problem import Problem
from bayes_sensor.rig.rig import Rig

EXACT = 1e-6
"""s, sd of a switch time that counts as known exactly"""


def common_names(rig: Rig) -> tuple[str, ...]:
    """What all records of a rig inform on: tau^2, tau, the other shared parameters, the noise.

    >>> common_names(Rig.parse(["valve", "manifold", "sensor"]))
    ('tau^2', 'tau', 'tau_v_s', 'V_mL', 'phi', 'sigma0', 'sigma1')
    """
    return ("tau^2", "tau", *rig.names[1:], "phi", "sigma0", "sigma1")


def record_information(setting: PlannedSetting, truth: Truth, tau: float) -> FloatArray:
    """Information (n, n) of one experiment's record on (tau^2, tau, the other shared parameters,
    y0, beta, t0 + tau, tf + tau or other switches plus tau, phi, sigma0, sigma1), sensitivities
    taken at ``tau`` (s, positive).

    Rows of tau itself are zero: see :func:`information_of`.
    """
    e = setting.experiment
    # one lag of each: nothing to tell apart
    alone = Campaign("one", (e,), sensor_is="faster", stages=truth.stages)
    problem = Problem(alone, noise=truth.noise)
    steps = e.interval / truth.interval
    phi = lag_coefficient(truth.phi, steps)
    own = truth.noise.weight(alone, e)
    times = setting.weight / own if own > 0 else 0.0
    sigma1 = truth.noise.referred(truth.sigma0, truth.sigma1, times)
    switches = [at + truth.tau - tau for at in setting.switches]
    local = [setting.y0, setting.beta, *switches]
    vector = np.array([tau, *truth.shared[1:], *local, phi, truth.sigma0, sigma1])
    information = expected_information(problem, vector)
    n, n_shared = len(vector), len(truth.shared)
    # theta by (tau^2, others, y0, beta, t0 + tau, tf + tau, noise), and a column for tau itself
    slopes = np.eye(n)
    slopes[0, 0] = 0.5 / tau
    slopes[n_shared + 2 : n_shared + len(local), 0] = -0.5 / tau
    slopes[-3, -3] = steps * phi / truth.phi if truth.phi != 0 else float(steps == 1.0)
    slopes[-1, -2:] = truth.noise.referred_slopes(truth.sigma0, truth.sigma1, times)
    full = np.zeros((n + 1, n + 1))
    place = np.array([0, *range(2, n + 1)])
    full[np.ix_(place, place)] = slopes.T @ information @ slopes
    return full


Known = dict[tuple[PlannedSetting, Truth, float], FloatArray]
"""informations of records that were computed before"""


def information_of(
    setting: PlannedSetting,
    truth: Truth,
    tau: float,
    trigger: float | None = None,
    known: Known | None = None,
) -> FloatArray:
    """Information (n, n) of one experiment on :func:`common_names`, its y0, beta, t0, tf
    eliminated.

    ``tau`` (s, positive): where sensitivities are taken.  ``trigger``: sd (s) with which the switch
    times are known beforehand.
    """
    known = {} if known is None else known
    key = (setting, truth, tau)
    if key not in known:
        known[key] = record_information(setting, truth, tau)
    full = known[key].copy()
    n, n_shared = len(full), len(truth.shared)
    if trigger is not None:
        precision = 1.0 / max(trigger, EXACT) ** 2
        for i in range(n_shared + 3, n - 3):  # t0 + tau - tau is normal about the triggered time
            full[i, i] += precision
            full[1, 1] += precision
            full[1, i] -= precision
            full[i, 1] -= precision
    return eliminate(full, [*range(n_shared + 1), n - 3, n - 2, n - 1])


def eliminate(information: FloatArray, keep: Sequence[int]) -> FloatArray:
    """Information on ``keep`` once the other parameters are estimated too (Schur complement)."""
    keep = list(keep)
    rest = [i for i in range(len(information)) if i not in keep and information[i, i] > 0]
    if not rest:
        return information[np.ix_(keep, keep)]
    scale = 1.0 / np.sqrt(np.diag(information)[rest])
    inner = information[np.ix_(rest, rest)] * np.outer(scale, scale)
    across = information[np.ix_(keep, rest)] * scale
    result: FloatArray = information[np.ix_(keep, keep)] - across @ np.linalg.solve(inner, across.T)
    return result


def sum_information(
    settings: Sequence[PlannedSetting],
    truth: Truth,
    tau: float,
    trigger: float | None = None,
    known: Known | None = None,
) -> FloatArray:
    """Information (n, n) of independent experiments on :func:`common_names`."""
    parts = [information_of(setting, truth, tau, trigger, known) for setting in settings]
    total: FloatArray = np.sum(parts, axis=0)
    return total
