"""Delay between command and response against flow: straight lines in 1/Q.

``t0 - commanded_on = a0 + a1/Q`` and ``tf - commanded_off = b0 + b1/Q`` (paper Sec. IV, Fig. 7): a
fixed delay of valve and electronics, and a volume ``a1`` that the gas fills first.  Ordinary least
squares by statsmodels, once on all experiments and once without outliers; and by generalised least
squares with the posterior covariance of the switch times when a posterior is given.

The data determine t0 + tau, so an error of tau shifts all switch times together.  It does not show
in their scatter about the line, on which ordinary standard errors are based.  If the covariance of
the switch times is known, from a posterior or from the Fisher information at a fit, standard
errors, intervals and p-values include both.
"""

from __future__ import annotations

import warnings
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any, Protocol

import numpy as np
import statsmodels.api as sm
from scipy import stats
from scipy.linalg import pinvh

from bayes_sensor.campaign import Campaign, FloatArray
from bayes_sensor.display import card
from bayes_sensor.fit import Fit
from bayes_sensor.io.json_files import plain
from bayes_sensor.likelihood.held_values import refuse_held
from bayes_sensor.likelihood.mesh import compress
from bayes_sensor.likelihood.problem import Problem, as_problem

OUTLIER_LEVEL = 0.05
"""Bonferroni-corrected level at which an experiment is left out"""
LEAST_POINTS = 3
"""fewest points of a line: one more than its parameters, so that its intervals exist"""
LEAST_LEFT = 4
"""fewest points that remain when an outlier is left out"""
NORMAL95 = float(stats.norm.ppf(0.975))


class DelayFit(Protocol):
    """The parts of a fit that the regression needs."""

    theta_hat: FloatArray


@dataclass(frozen=True, eq=False)
class RegressionLine:
    """One regression ``delay = intercept + slope/Q``; None where it cannot be computed."""

    names: list[str]
    """experiments that have this delay"""
    inverse_flow: FloatArray
    """(n,) s/L"""
    delay: FloatArray
    """(n,) s"""
    used: np.ndarray
    """(n,) False for outliers"""
    intercept: float | None
    """s"""
    slope: float | None
    """L"""
    r2: float | None
    p_value: float | None
    """two-sided, of a slope of zero"""
    se: dict[str, float] | None
    """standard errors of ``intercept_s`` and ``slope_L``, with the common error of the switch
    times"""
    ci95: dict[str, list[float]] | None
    """intervals of ``intercept_s`` and ``slope_L``, likewise"""
    outliers: list[str]
    studentised: dict[str, float | None]
    """externally studentised residual of every experiment in the regression on all"""
    bonferroni_p: dict[str, float | None]
    residual_sd: float | None
    """s"""
    band: dict[str, list[float]] | None
    """prediction band: ``inverse_flow_s_per_L``, ``fit_s``, ``lo95_s``, ``hi95_s``"""
    with_outliers: dict[str, Any] | None
    """the regression on all experiments, when some were left out"""
    weighted: dict[str, Any] | None
    """by the posterior covariance of the switch times, when a posterior was given"""
    status: str
    ordinary: dict[str, Any] | None = None
    """``se``, ``ci95`` and ``p_value`` from the scatter about the line alone"""

    def __repr__(self) -> str:
        """Both coefficients, or why there are none."""
        if self.intercept is None or self.slope is None:
            return f"RegressionLine({self.status})"
        return f"RegressionLine({self.intercept:.4g} s + {self.slope:.4g} L / Q; n {self.n})"

    @property
    def n(self) -> int:
        """Experiments in the reported regression."""
        return int(self.used.sum())

    def to_json(self) -> dict[str, Any]:
        """One entry of ``delays.json``."""
        return {
            "intercept_s": self.intercept,
            "slope_L": self.slope,
            "r2": self.r2,
            "p_value": self.p_value,
            "ci95": self.ci95,
            "outliers": list(self.outliers),
            "n": self.n,
            "se": self.se,
            "residual_sd_s": self.residual_sd,
            "points": [
                {
                    "experiment": name,
                    "inverse_flow_s_per_L": float(x),
                    "delay_s": float(y),
                    "used": bool(used),
                    "studentised_residual": self.studentised.get(name),
                    "bonferroni_p": self.bonferroni_p.get(name),
                }
                for name, x, y, used in zip(self.names, self.inverse_flow, self.delay, self.used)
            ],
            "band": self.band,
            "with_outliers": self.with_outliers,
            "weighted": self.weighted,
            "ordinary": self.ordinary,
            "status": self.status,
        }


@dataclass(frozen=True, eq=False)
class Delays:
    """Regressions of start and end delay; ``end`` is None where no step down was recorded."""

    start: RegressionLine
    end: RegressionLine | None

    def __repr__(self) -> str:
        """Both lines."""
        return f"Delays(start {self.start}, end {self.end})"

    def _repr_html_(self) -> str:
        """HTML for a notebook: both lines."""
        lines = [("start", self.start), *([] if self.end is None else [("end", self.end)])]
        rows = [
            [side, line.intercept, line.slope, line.r2, line.n, ", ".join(line.outliers)]
            for side, line in lines
        ]
        columns = ["delay", "intercept (s)", "slope (L)", "R2", "n", "outliers"]
        return card("delays on 1/Q", [line.status for _, line in lines], columns, rows)

    def to_json(self) -> dict[str, Any]:
        """The content of ``delays.json``."""
        return {
            "start": self.start.to_json(),
            "end": None if self.end is None else self.end.to_json(),
        }


def regress_delays(campaign: Campaign | Problem, fit: DelayFit, posterior: Any = None) -> Delays:
    """Regressions of the delays t0 - commanded_on and tf - commanded_off on 1/Q, Q in L/s.

    Outliers are found in one pass over the regression on all experiments: externally studentised
    residuals against Student's t with a Bonferroni correction at 0.05 (Cook and Weisberg, Residuals
    and Influence in Regression, 1982, sec. 2.2.2); the line is then fitted without them and both
    are reported.  There is only one pass, so that a line cannot be improved by dropping one point
    after another.  With ``posterior`` (one of this package, or one whose ``inference_data`` has
    ``t0``, ``tf`` of dimension ``experiment``, or an object with ``sd(flat_name)``) also by
    generalised least squares.

    With too few points, one common flow or unknown commanded times the record has a sentence with
    the reason.
    """
    problem = as_problem(campaign)
    refuse_held(problem, "delays")
    campaign = problem.campaign
    vector = problem.layout.flat(fit)
    everything = None if posterior is not None else _covariance_of_fit(problem, fit, vector)
    lines: list[RegressionLine | None] = []
    for kind, column in (("t0_s", 2), ("tf_s", 3)):
        names, records, x, y, positions = [], [], [], [], []
        recorded = False
        for k, e in enumerate(campaign):
            if not problem.layout.switching[k].is_pulse:
                continue
            commanded = e.commanded_on if kind == "t0_s" else e.commanded_off
            position = problem.layout.local[k, column]
            recorded = recorded or position >= 0
            if commanded is None or position < 0 or not e.flow_known or position in positions:
                continue
            names.append(e.name)
            records.append(e.record_name)  # whose switches these are, where it has several sensors
            x.append(1000.0 / e.total_flow)
            y.append(float(vector[position]) - commanded)
            positions.append(position)
        if kind == "tf_s" and not recorded:
            lines.append(None)
            continue
        covariance = None if everything is None else everything[np.ix_(positions, positions)]
        if posterior is not None and names:
            covariance = _posterior_covariance(posterior, kind, records)
        given = posterior is not None
        lines.append(regress_line(names, np.array(x), np.array(y), covariance, given))
    start, end = lines
    assert start is not None
    if not any(switching.is_pulse for switching in problem.layout.switching):
        start = replace(start, status="No regression: it is of single pulses, and there is none.")
    elif not campaign.flows_known and not start.names:
        start = replace(start, status="No regression: no flow is known.")
    return Delays(start, end)


def _covariance_of_fit(problem: Problem, fit: DelayFit, vector: FloatArray) -> FloatArray | None:
    """(n_theta, n_theta) inverse of the Fisher information at a fit; None where there is none."""
    if not isinstance(fit, Fit) or fit.cannot_tell or not fit.step_seen:
        return None
    free = np.array(
        [i for i, n in enumerate(problem.layout.names) if n not in problem.fixed and vector[i] != 0]
    )
    information = compress(problem, vector).information(vector)[np.ix_(free, free)]
    scale = np.sqrt(np.diag(information))
    if not (np.isfinite(scale).all() and (scale > 0.0).all()):
        return None
    inverse, rank = pinvh(information / np.outer(scale, scale), return_rank=True)
    covariance = np.zeros((len(vector), len(vector)))
    covariance[np.ix_(free, free)] = inverse / np.outer(scale, scale)
    return covariance if rank == len(free) else None


def _posterior_covariance(posterior: Any, kind: str, names: Sequence[str]) -> FloatArray:
    """(n, n) s^2, of the switch times of these records."""
    if hasattr(posterior, "of"):
        draws = np.array([posterior.of(f"{kind}[{name}]") for name in names])
    elif hasattr(posterior, "sd"):
        return np.diag([float(posterior.sd(f"{kind}[{name}]")) ** 2 for name in names])
    else:
        found = posterior.inference_data.posterior[kind.removesuffix("_s")]
        draws = np.array([found.sel({found.dims[-1]: name}).values.ravel() for name in names])
    return np.atleast_2d(np.cov(draws))


def regress_line(
    names: Sequence[str],
    x: FloatArray,
    y: FloatArray,
    covariance: FloatArray | None = None,
    generalised: bool = False,
) -> RegressionLine:
    """The regression of delays ``y`` (n,) s on inverse flows ``x`` (n,) s/L, and its outliers.

    ``covariance`` (n, n) s^2 of the errors of ``y``, as far as it is known; additional scatter
    about the line is estimated.  ``generalised``: also by generalised least squares.
    """
    names = list(names)
    reason = _cannot(names, x)
    if reason:
        return _empty(names, x, y, reason)
    with warnings.catch_warnings():
        warnings.simplefilter("error", RuntimeWarning)
        result = _ols(x, y)
    studentised = _studentised(x, result)
    n = len(x)
    p = np.full(n, np.nan)
    known = np.isfinite(studentised)
    if n > 3:
        p[known] = np.minimum(n * 2.0 * stats.t.sf(np.abs(studentised[known]), n - 3), 1.0)
    outlying = known & (p < OUTLIER_LEVEL)
    used = ~outlying
    status = "All experiments are used."
    with_outliers = None
    left_out = [name for name, out in zip(names, outlying) if out]
    if left_out:
        if used.sum() < LEAST_LEFT or _cannot([names[i] for i in np.flatnonzero(used)], x[used]):
            used[:] = True
            status = (
                f"Experiment {', '.join(left_out)} stands out, but too few would be left without; "
                "all are used."
            )
            left_out = []
        else:
            with_outliers = _summary(result)
            result = _ols(x[used], y[used])
            status = (
                f"Left out as an outlier: experiment {', '.join(left_out)} (externally studentised "
                f"residual, Bonferroni-corrected p below {OUTLIER_LEVEL:g})."
            )
    summary = _summary(result)
    told = _with_shared_errors(summary, result, x, used, covariance)
    return RegressionLine(
        names=names,
        inverse_flow=x,
        delay=y,
        used=used,
        intercept=summary["intercept_s"],
        slope=summary["slope_L"],
        r2=summary["r2"],
        p_value=told["p_value"],
        se=told["se"],
        ci95=told["ci95"],
        outliers=left_out,
        studentised=plain(dict(zip(names, studentised))),
        bonferroni_p=plain(dict(zip(names, p))),
        residual_sd=float(np.sqrt(result.scale)),
        band=_band(result, x),
        with_outliers=with_outliers,
        weighted=_weighted(x, y, used, covariance) if generalised else None,
        status=status,
        ordinary={key: summary[key] for key in ("se", "ci95", "p_value")},
    )


def _cannot(names: Sequence[str], x: FloatArray) -> str:
    """Why there is no regression; empty if there is one."""
    if len(names) == 0:
        return "No regression: no commanded time is known."
    if len(names) < LEAST_POINTS:
        return f"No regression: {len(names)} delays, and a line needs at least {LEAST_POINTS}."
    if np.ptp(x) <= 1e-6 * np.max(x):
        return "No regression: all flows are equal, so the delay's dependence on flow is unknown."
    return ""


def _empty(names: list[str], x: FloatArray, y: FloatArray, reason: str) -> RegressionLine:
    used = np.ones(len(names), dtype=bool)
    return RegressionLine(
        names, x, y, used, None, None, None, None, None, None, [], {}, {}, None, None, None, None,
        reason,
    )  # fmt: skip


def _ols(x: FloatArray, y: FloatArray) -> Any:
    return sm.OLS(y, np.column_stack([np.ones_like(x), x])).fit()


def _studentised(x: FloatArray, result: Any) -> FloatArray:
    """(n,) r_i / (s_(i) sqrt(1 - h_i)), s_(i) the residual sd without point i; nan if undefined.

    A line that is exact without point i makes it infinite; that is reported as nan only when
    point i fits as well.
    """
    X = np.column_stack([np.ones_like(x), x])
    h = np.einsum("ij,jk,ik->i", X, np.linalg.inv(X.T @ X), X)
    r = np.asarray(result.resid)
    n = len(x)
    rounding = 1e-12 * float(np.max(np.abs(result.model.endog)) + 1e-300)
    values = np.full(n, np.nan)
    if n <= 3:  # without one point the others lie on a line
        return values
    for i in range(n):
        if 1.0 - h[i] < 1e-10:  # the point alone decides the line at its flow
            continue
        left = (float(r @ r) - r[i] ** 2 / (1.0 - h[i])) / (n - 3)
        spread = np.sqrt(max(left, 0.0))
        if spread <= rounding and abs(r[i]) <= 10.0 * rounding:
            continue
        values[i] = r[i] / (max(spread, rounding) * np.sqrt(1.0 - h[i]))
    return values


def _summary(result: Any) -> dict[str, Any]:
    interval = np.asarray(result.conf_int(alpha=0.05))
    return {
        "intercept_s": float(result.params[0]),
        "slope_L": float(result.params[1]),
        "r2": plain(result.rsquared),
        "p_value": plain(result.pvalues[1]),
        "se": {"intercept_s": float(result.bse[0]), "slope_L": float(result.bse[1])},
        "ci95": {
            "intercept_s": [float(v) for v in interval[0]],
            "slope_L": [float(v) for v in interval[1]],
        },
        "n": int(result.nobs),
    }


def _band(result: Any, x: FloatArray) -> dict[str, list[float]]:
    grid = np.linspace(0.9 * x.min(), 1.1 * x.max(), 41)
    frame = result.get_prediction(np.column_stack([np.ones_like(grid), grid])).summary_frame(0.05)
    return {
        "inverse_flow_s_per_L": [float(v) for v in grid],
        "fit_s": [float(v) for v in frame["mean"]],
        "lo95_s": [float(v) for v in frame["obs_ci_lower"]],
        "hi95_s": [float(v) for v in frame["obs_ci_upper"]],
    }


def _with_shared_errors(
    summary: dict[str, Any],
    result: Any,
    x: FloatArray,
    used: np.ndarray,
    covariance: FloatArray | None,
) -> dict[str, Any]:
    """Standard errors, intervals and p-value of ordinary least squares whose errors covary.

    With A = (X'X)^-1 X' and errors of covariance C + s^2 I the line's is A (C + s^2 I) A'; s^2 is
    the residual variance beyond tr M C, M = I - X A.  Degrees of freedom by Satterthwaite (1946),
    since only s^2 is estimated.
    """
    if covariance is None or not np.isfinite(covariance).all():
        return summary
    X = np.column_stack([np.ones(int(used.sum())), x[used]])
    known = covariance[np.ix_(used, used)]
    inner = np.linalg.inv(X.T @ X)
    A = inner @ X.T
    left = len(X) - 2
    expected = float(np.trace(known) - np.sum(X.T * (A @ known)))
    scatter = max(float(result.ssr) - expected, 0.0) / left
    shared, own = np.diag(A @ known @ A.T), scatter * np.diag(inner)
    se = np.sqrt(shared + own)
    with np.errstate(divide="ignore", invalid="ignore"):
        dof = np.where(own > 0.0, left * ((shared + own) / own) ** 2, np.inf)
    reach = se * np.where(np.isfinite(dof), stats.t.ppf(0.975, np.minimum(dof, 1e9)), NORMAL95)
    keys = ("intercept_s", "slope_L")
    t = abs(summary["slope_L"]) / se[1] if se[1] > 0.0 else np.inf
    return {
        "se": dict(zip(keys, map(float, se), strict=True)),
        "ci95": {
            key: [float(summary[key] - r), float(summary[key] + r)]
            for key, r in zip(keys, reach, strict=True)
        },
        "p_value": float(2.0 * stats.t.sf(t, min(float(dof[1]), 1e9))),
    }


def _weighted(
    x: FloatArray, y: FloatArray, used: np.ndarray, covariance: FloatArray | None
) -> dict[str, Any] | None:
    """Generalised least squares by the posterior covariance, scaled to the residuals as in OLS."""
    if covariance is None:
        return None
    known = covariance[np.ix_(used, used)]
    if not np.isfinite(known).all() or np.linalg.matrix_rank(known, hermitian=True) < len(known):
        return None
    X = np.column_stack([np.ones_like(x), x])
    result = sm.GLS(y[used], X[used], sigma=known).fit()
    return {
        **_summary(result),
        # 1 when the posterior alone explains the scatter about the line
        "reduced_chi2": float(result.scale),
    }
