"""The Cramer-Rao bounds as interval methods: converged iid, the inferred published recipe,
AR(1)."""

from __future__ import annotations

import numpy as np

from bayes_sensor.bounds.bound import LEVELS, Bound
from bayes_sensor.bounds.context import Evidence
from bayes_sensor.bounds.cramer_rao import cramer_rao
from bayes_sensor.bounds.gaussian_intervals import gaussian_bound, invert, normal_factor
from bayes_sensor.bounds.likelihood_surface import spread_along_tau
from bayes_sensor.bounds.profile import noise_words

PAPER = "the paper, eqs. 16-18; Kay (1993), eq. 3.33"


def crlb_iid(evidence: Evidence) -> Bound:
    """Converged Cramer-Rao bound under iid noise of the fit's RMS."""
    surface = evidence.white
    information = surface.information(surface.expansion(evidence.psi_white))
    cov, identified = invert(information[np.ix_(surface.mean, surface.mean)])
    return gaussian_bound(
        "crlb_iid",
        "iid Gaussian noise of the fit's RMS; sensitivities in closed form",
        PAPER,
        surface.mean_names,
        evidence.estimate,
        cov,
        evidence.at_bound,
        identified=identified,
        details={"sigma": evidence.fit.rms},
        plain=True,
        along_tau=evidence.white_along_tau,
    )


def crlb_iid_one_percent_step(evidence: Evidence, step: float = 0.01) -> Bound:
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
    fastest = min(theta[1], *(theta[2] / e.total_flow for e in campaign))
    if theta[0] < 2.0 * longest and fastest > 2.0 * longest:
        theta[0] = 2.0 * longest
        sentences.append("taken at tau of two sampling intervals, below which Euler is unstable")
    elif fastest <= 2.0 * longest:
        method = "exact"
        theta[0] = max(theta[0], 1e-3 * fastest)
        sentences.append("closed form in place of Euler, which is unstable at this interval")
    n = len(evidence.problem.layout.mean_names)
    bound = cramer_rao(campaign, theta[:n], evidence.fit.rms, step, method)
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
        "crlb_iid_one_percent_step",
        "iid Gaussian noise of the fit's RMS; sensitivities from steps of +1 %",
        PAPER,
        names,
        evidence.estimate,
        sd,
        low,
        high,
        "; ".join(sentences),
        {"sigma": evidence.fit.rms, "step": step},
    )


def crlb_ar1(evidence: Evidence) -> Bound:
    """Cramer-Rao bound under the problem's own noise, information from the variance included.

    Centred on the maximum of that likelihood; the noise parameters are estimated with the others.
    """
    surface = evidence.coloured
    psi = evidence.coloured_maximum.psi
    cov, identified = invert(surface.information(surface.expansion(psi)))
    names, trouble = surface.mean_names, evidence.coloured_trouble
    theta = evidence.coloured_theta
    noise = {
        name: float(theta[evidence.problem.layout.index(name)])
        for name in evidence.problem.layout.noise_names
    }
    return gaussian_bound(
        "crlb_ar1",
        f"{noise_words(evidence)}, noise parameters estimated with the others",
        "Slepian (1954), Bangs (1971); Kay (1993), eq. 3.31",
        names,
        theta[[evidence.problem.layout.index(name) for name in names]],
        cov[np.ix_(surface.mean, surface.mean)],
        evidence.coloured_at_bound,
        identified=identified[surface.mean],
        status=trouble and f"{trouble}: taken at the best point",
        details={"noise": noise},
        along_tau=spread_along_tau(surface, psi),
    )


def posterior_intervals(evidence: Evidence) -> Bound:
    """Equal-tailed quantiles of the posterior draws; the estimate is their median.

    Its status has the posterior's warnings, lack of convergence first.
    """
    names = evidence.mean_names
    draws = np.asarray(evidence.posterior.draws)
    index = [evidence.problem.layout.index(name) for name in names]
    draws = draws[:, index]
    tails = [0.5 - 0.5 * level for level in LEVELS.values()]
    # Weibull's plotting position: the mass beyond an end is right on average over the draws
    low = np.quantile(draws, tails, axis=0, method="weibull").T
    high = np.quantile(draws, [1.0 - tail for tail in tails], axis=0, method="weibull").T
    return Bound(
        "posterior",
        f"{noise_words(evidence)} and the priors",
        "Gelman et al., Bayesian Data Analysis (2013), ch. 2",
        names,
        np.median(draws, axis=0),
        draws.std(axis=0, ddof=1),
        low,
        high,
        status="; ".join(getattr(evidence.posterior, "warnings", ())) or "ok",
        details={"n_draws": len(draws)},
    )
