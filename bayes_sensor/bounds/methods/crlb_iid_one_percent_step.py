"""The published Cramer-Rao bound as we infer it: finite differences with steps of +1 %."""

from __future__ import annotations

import numpy as np

from bayes_sensor.bounds.bound import LEVELS, Bound
from bayes_sensor.bounds.context import Evidence
from bayes_sensor.bounds.cramer_rao import PAPER, cramer_rao
from bayes_sensor.bounds.gaussian_intervals import normal_factor
from bayes_sensor.bounds.methods.bound_method import BoundMethod

STEP = 0.01
"""relative, of every parameter"""


def crlb_iid_one_percent_step(evidence: Evidence) -> Bound:
    """The published bound as we infer it: forward Euler, forward differences, +1 % of every value.

    Its sensitivity to tau does not vanish at zero, so the interval is computed in tau itself and
    cut at zero.
    """
    names, campaign = evidence.mean_names, evidence.problem.campaign
    theta = evidence.theta.copy()
    longest = max(e.interval for e in campaign)
    sentences = [
        "moves t0 and tf by 1 % of their value in the record's own time, so it depends on where "
        "time starts"
    ]
    method = "euler"
    problem = evidence.problem
    if not problem.layout.is_published:
        reason = "the paper's recipe is for its own rig, with one pulse a record"
        return Bound.without_values(names, evidence.estimate, reason)
    layout = problem.layout
    tau, tau_v, volume = (layout.index(name) for name in ("tau_s", "tau_v_s", "V_mL"))
    fastest = min(theta[tau_v], *(theta[volume] / e.total_flow for e in campaign))
    if theta[tau] < 2.0 * longest and fastest > 2.0 * longest:
        theta[tau] = 2.0 * longest
        sentences.append("taken at tau of two sampling intervals, below which Euler is unstable")
    elif fastest <= 2.0 * longest:
        method = "exact"
        theta[tau] = max(theta[tau], 1e-3 * fastest)
        sentences.append("closed form in place of Euler, which is unstable at this interval")
    n = layout.n_mean
    bound = cramer_rao(campaign, theta[:n], evidence.fit.rms, STEP, method)
    sd = np.full(len(names), np.nan)
    sd[:n] = np.where(np.isfinite(bound.sd), bound.sd, np.nan)
    z = np.array([normal_factor(level) for level in LEVELS.values()])
    low = evidence.estimate[:, None] - z * sd[:, None]
    high = evidence.estimate[:, None] + z * sd[:, None]
    low[:3] = np.maximum(low[:3], 0.0)
    if evidence.at_bound:
        sd[0] = np.nan
        sentences.append("tau's estimate is at its lower bound: its interval is an upper limit")
    return Bound(
        names,
        evidence.estimate,
        sd,
        low,
        high,
        "; ".join(sentences),
        {"sigma": evidence.fit.rms, "step": STEP},
    )


METHOD = BoundMethod(
    name="crlb_iid_one_percent_step",
    label="the same, 1 % steps (published)",
    full_label="Cramér-Rao, iid noise, 1 % steps (published)",
    assumes="iid Gaussian noise of the fit's RMS; sensitivities from steps of +1 %",
    compute=crlb_iid_one_percent_step,
    reference=PAPER,
    noise="white",
    published_recipe=True,
    cramer_rao={"step": STEP},
)
