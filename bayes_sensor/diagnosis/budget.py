"""The sizes of the gap: root mean squares of the residual and of the noise, and the p-values."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from bayes_sensor.campaign import Campaign, FloatArray
from bayes_sensor.diagnosis.data.preparation import PreparedCampaign, full_rate_residuals
from bayes_sensor.diagnosis.evidence.refit import Refit
from bayes_sensor.diagnosis.location import ExcessMap
from bayes_sensor.rig.layout import Layout, Theta


def gap_budget(
    campaign: Campaign,
    prepared: PreparedCampaign,
    base: Refit,
    located: ExcessMap,
    nominal: Theta | None,
) -> dict[str, Any]:
    used = [r[e.used] for r, e in zip(prepared.residuals, campaign, strict=True)]
    calibrated = float(np.sqrt(np.mean(np.concatenate([u**2 for u in used]))))
    floor = [float(np.mean(s.samples**2) - np.mean(s.samples) ** 2) for s in prepared.stretches]
    weights = [len(s.samples) for s in prepared.stretches]
    before = None
    if nominal is not None:
        residuals = full_rate_residuals(campaign, Layout.of(campaign).flat(nominal))
        squares = [r[e.used] ** 2 for r, e in zip(residuals, campaign, strict=True)]
        before = float(np.sqrt(np.mean(np.concatenate(squares))))
    return {
        "nominal_rms_V": before,
        "calibrated_rms_V": calibrated,
        "noise_floor_rms_V": float(np.sqrt(np.average(floor, weights=weights))),
        "excess_rms_V": located.excess_rms,
        "excess_d": located.d,
        "p_value": located.p_value,
        "p_value_of_size": located.p_value_of_size,
        "p_value_of_form": located.p_value_of_form,
        "ar1_whiteness_p": ar1_whiteness(used),
        "spikes_replaced": prepared.binned.floor.spikes,
        "tau_s": base.tau,
    }


def ar1_whiteness(residuals: Sequence[FloatArray], lags: int = 20) -> float:
    """Ljung-Box p-value of the innovations of an AR(1) fitted to every record (for comparison)."""
    from scipy.stats import chi2

    statistic, dof = 0.0, 0
    for r in residuals:
        if len(r) < 5 * lags or not np.any(r):
            continue
        x = r - r.mean()
        phi = float(x[1:] @ x[:-1]) / float(x @ x)
        e = x[1:] - phi * x[:-1]
        n = len(e)
        rho = np.array([float(e[k:] @ e[:-k]) for k in range(1, lags + 1)]) / float(e @ e)
        statistic += n * (n + 2.0) * float(np.sum(rho**2 / (n - np.arange(1, lags + 1))))
        dof += lags - 1
    return float(chi2.sf(statistic, dof)) if dof else 1.0
