"""All diagnostics of a fit's residuals in one record, and the doubt that follows from them."""

from __future__ import annotations

from dataclasses import dataclass, fields
from math import sqrt
from typing import Any, Protocol

import numpy as np

from bayes_sensor.campaign import Campaign, FloatArray
from bayes_sensor.display import card
from bayes_sensor.likelihood.problem import Problem, as_problem
from bayes_sensor.residuals.autocorrelation import (
    LAGS,
    autocorrelation,
    durbin_watson,
    ljung_box,
)
from bayes_sensor.residuals.noise_law_check import NoiseJudgement, judge
from bayes_sensor.residuals.series import FittedNoise
from bayes_sensor.residuals.spread import breusch_pagan, histogram, of_each, spread


class ResidualFit(Protocol):
    """What is needed of a fit."""

    theta_hat: FloatArray


@dataclass(frozen=True, eq=False)
class Residuals(NoiseJudgement):
    """Diagnostics of a fit's residuals r = y - m, pooled over the experiments in their order."""

    acf: dict[str, list[float]]
    """``lag_s``, ``value``, and ``ar1``, the fitted AR(1)'s curve; thinned at long lags"""
    ljung_box: dict[str, Any]
    """``lags`` (samples), and ``before``, ``after`` whitening: ``statistic``, ``p_value``"""
    ar1: dict[str, float]
    """phi, sigma0_V, sigma1_V and the interval phi refers to"""
    variance_vs_concentration: dict[str, Any]
    """bins of x3 times the test-gas fraction, their sd and count, the law's sd, the test"""
    variance_vs_slope: dict[str, Any]
    """the same against |dx3/dt| over its largest, without a test"""
    durbin_watson: dict[str, float]
    """``before`` and ``after`` whitening; 2 when neighbours are uncorrelated"""
    white_band: float
    """half-width of the 95 % band that white residuals would keep within"""
    histogram: dict[str, Any]
    """``edges_V``, ``count``, ``bin_V``, ``note``"""
    experiments: dict[str, dict[str, float]]
    """per experiment: n, rms_V, lag_one, baseline_sd_V, plateau_sd_V"""
    spectrum: dict[str, float]
    """slow part of the residuals' spectrum over that of the fitted AR(1)"""
    signal_unit: str = "V"

    def __repr__(self) -> str:
        """Whether the noise law fits, and its phi."""
        failed = [name for name, check in self.checks.items() if not check["adequate"]]
        law = f"the noise law fails in {', '.join(failed)}" if failed else "the noise law fits"
        return f"Residuals({law}; phi {self.ar1['phi']:.4g} at {self.ar1['phi_interval_s']:.4g} s)"

    def _repr_html_(self) -> str:
        """HTML for a notebook: the verdict, and each check of the noise law."""
        rows = [
            [name.replace("_", " "), check["adequate"], check["p_value"], check["factor"]]
            for name, check in self.checks.items()
        ]
        columns = ["check", "adequate", "p-value", "measured / law"]
        return card("residuals", [self.verdict, self.recommendation], columns, rows)

    def to_json(self) -> dict[str, Any]:
        """The content of ``residuals.json``."""
        return {field.name: getattr(self, field.name) for field in fields(self)}


def diagnose_residuals(
    campaign: Campaign | Problem, fit: ResidualFit, max_lag: float | None = None
) -> Residuals:
    """Diagnostics of the residuals at ``fit.theta_hat``.

    ``max_lag`` (s) is how far the autocorrelation is shown; default a twentieth of the longest
    record.  Series of experiments are joined in the campaign's order, as in the paper; with
    different sampling intervals lags count samples of the most common one.

    Raises CampaignError for a design without data.
    """
    problem = as_problem(campaign)
    campaign, layout = problem.campaign, problem.layout
    vector = layout.flat(fit)
    noise = FittedNoise.of(problem, vector)
    h = campaign.reference_interval
    r, z, white = (noise.joined(name) for name in ("r", "z", "e"))
    longest = max(float(e.t[-1] - e.t[0]) for e in campaign)
    n_lags = max(int(min((max_lag or longest / 20.0) / h, len(r) // 4)), 1)
    correlation = autocorrelation(r, n_lags, noise.joined("used"))
    kept = _thinned(len(correlation) - 1)
    kept = kept[np.isfinite(correlation[kept])]
    lags = [lag for lag in LAGS if lag < len(z) // 4] or [1]
    phi, sigma0, sigma1 = vector[layout.noise].T
    return Residuals(
        acf={
            "lag_s": [float(v) for v in kept * h],
            "value": [float(v) for v in correlation[kept]],
            "ar1": [float(v) for v in noise.correlation(kept)],
        },
        ljung_box={
            "lags": lags,
            "before": ljung_box(z, lags),
            "after": ljung_box(white, lags, int(problem.noise.autocorrelation == "ar1")),
        },
        ar1={
            **{name: float(vector[layout.index(name)]) for name in layout.noise_names},
            "phi": float(np.mean(phi)),
            "phi_interval_s": h,
            "sigma0_V": float(np.sqrt(np.mean(sigma0**2))),
            "sigma1_V": float(np.sqrt(np.mean(sigma1**2))),
        },
        variance_vs_concentration={
            **spread(noise, "concentration"),
            "breusch_pagan": breusch_pagan(noise.series),
        },
        variance_vs_slope=spread(noise, "slope"),
        durbin_watson={"before": durbin_watson(z), "after": durbin_watson(white)},
        white_band=1.96 / sqrt(len(r)),
        histogram=histogram(r),
        experiments={e.name: of_each(s) for e, s in zip(campaign, noise.series)},
        spectrum=dict(zip(("slow_to_ar1", "expected_sd"), noise.slow_part)),
        signal_unit=campaign.signal_unit,
        **vars(judge(noise, correlation)),
    )


def noise_doubt(problem: Problem, vector: FloatArray) -> str:
    """Why intervals that rest on the noise's own law are not to be trusted at a flat vector.

    As a sentence; empty where the noise law describes the residuals.
    """
    noise = FittedNoise.of(problem, vector)
    r = noise.joined("r")
    longest = max(len(e.t) for e in problem.campaign) // 20
    n_lags = max(min(noise.fades, longest, len(r) // 4), 1)
    return judge(noise, autocorrelation(r, n_lags, noise.joined("used"))).doubt


def _thinned(n_lags: int) -> np.ndarray:
    """Lags 0 .. n_lags: all up to 200, then about 300 in even ratio."""
    if n_lags <= 500:
        return np.arange(n_lags + 1)
    far = np.unique(np.round(np.geomspace(201, n_lags, 300)).astype(int))
    return np.concatenate([np.arange(201), far])
