"""Intervals of tau under other priors, by reweighting the draws."""

from __future__ import annotations

from math import nan
from typing import TYPE_CHECKING, Any

import numpy as np

from bayes_sensor.likelihood.default_priors import default_priors
from bayes_sensor.likelihood.priors import Prior
from bayes_sensor.likelihood.rise_time import fastest_rise
from bayes_sensor.posterior.quantiles import highest_density, reaches_end, weighted_quantiles

if TYPE_CHECKING:
    import pandas as pd

from bayes_sensor.posterior.draws import NEVER, Draws


def tau_under_priors(posterior: Draws) -> pd.DataFrame:
    """Intervals and upper limits of tau (s) under other priors, by reweighting the draws.

    Rows: flat, half-normal, log-uniform with a floor (a hundredth of the half-normal's scale);
    one set for each lag that may be the sensor's, if that is undecided (``sensor_is``). The
    half-normal is the posterior's own or, where it has another law, the default one. Columns:
    equal-tailed 95 % interval, highest-density 95 % interval, one-sided 95 and 99 % upper
    limits, the effective number of draws that the reweighting leaves, and ``status``.

    Reweighting cannot leave the support of the law that was sampled.  If that support is
    bounded and the draws under another law reach its bound, this law would allow values that
    were never drawn.  Its row then has nan for numbers, no effective draws, and the reason in
    ``status``, which is ``ok`` elsewhere.  ``posterior.json`` lists such laws apart.
    """
    import pandas as pd

    rows = []
    for assignment in posterior.assignments:
        stated = posterior.naming.place("sensor") in (None, assignment["lag"])
        if stated and assignment["probability"] > NEVER:
            rows += _tau_at(posterior, assignment["lag"], assignment["sensor_is"])
    return pd.DataFrame(rows)


def decided_by_prior(posterior: Draws) -> dict[str, float]:
    """The probability without default priors, by flat name, that a shared parameter lies outside
    its 95 % interval, where that is more likely than not: the interval is then the prior's.

    Half-normal and log-normal laws that nobody gave are taken off the draws by reweighting.  It
    cannot say how far beyond the draws the data would go; ends of uniform laws are in
    :attr:`Draws.no_upper_limit`.
    """
    problem, draws = posterior.problem, posterior.draws
    log_w = np.zeros(len(draws))
    for i, name in enumerate(posterior.layout.shared_names):
        law = problem.priors[name]
        usual = name not in problem.given_laws and law.kind in ("half_normal", "log_normal")
        if usual and i in posterior.free:
            log_w -= law.log_density(draws[:, i])
    w = np.exp(log_w - log_w.max())
    w /= w.sum()
    found = {}
    for name in posterior.layout.shared_names:
        x = posterior.of(name)
        low, high = np.quantile(x, [0.025, 0.975])
        outside = float(w[(x < low) | (x > high)].sum())
        if outside > 0.5:
            found[name] = outside
    return found


def _tau_at(posterior: Draws, place: int, sensor_is: str) -> list[dict[str, Any]]:
    """Rows of :func:`tau_under_priors` if the sensor is the lag at this place."""
    current = posterior.problem.lag_priors[place]
    usual = current
    if current.kind != "half_normal":
        problem = posterior.problem
        usual = default_priors(problem.campaign, problem.layout, problem.commuting)["tau_s"]
    if usual.kind == "half_normal":
        scale = usual.a
    else:  # lags without names
        scale = float(f"{fastest_rise(posterior.problem.campaign):.0e}")
    tau = posterior.lags[:, place]
    chosen = [j for j, a in enumerate(posterior.problem.assignments) if a.sensor == place]
    share = posterior.shares[:, chosen].sum(axis=1)
    top = max(float(tau.max()), scale)
    laws = {
        "flat": Prior("flat"),
        "half_normal": Prior("half_normal", scale),
        "log_uniform_floored": Prior("log_uniform", scale / 100.0, 10.0 * top),
    }
    rows = []
    for label, law in laws.items():
        # below the floor the log-uniform law is flat, so that it stays proper at zero
        value = law.log_density(np.maximum(tau, law.a) if law.kind == "log_uniform" else tau)
        log_w = value - current.log_density(tau)
        w = np.exp(log_w - log_w.max()) * share
        w /= w.sum()
        lo, hi, up95, up99 = weighted_quantiles(tau, w, [0.025, 0.975, 0.95, 0.99])
        hdi_lo, hdi_hi = highest_density(tau, w, 0.95)
        n_effective, status = float(1.0 / np.sum(w**2)), "ok"
        if reaches_end(tau, w, *current.support):
            lo = hi = hdi_lo = hdi_hi = up95 = up99 = nan
            n_effective = 0.0
            status = (
                f"the draws were made under {current} and reach its bound: what {law} allows "
                "beyond it was never drawn; sample under that law"
            )
        rows.append(
            {
                "prior": label,
                "law": str(law),
                "sensor_is": sensor_is,
                "lo95_s": lo,
                "hi95_s": hi,
                "hdi_lo95_s": hdi_lo,
                "hdi_hi95_s": hdi_hi,
                "upper95_s": up95,
                "upper99_s": up99,
                "n_effective": n_effective,
                "status": status,
            }
        )
    return rows
