"""Cramer-Rao bounds: converged, by finite steps, and under autocorrelated noise.

Under iid noise the information is J'J / sigma^2 with J the sensitivities of the mean (paper eqs.
16-18; Kay, Fundamentals of Statistical Signal Processing I, 1993, eq. 3.33).  The result depends on
how J is computed: see :func:`cramer_rao`.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from bayes_sensor.bounds.gaussian_intervals import invert
from bayes_sensor.campaign import Campaign, CampaignError, FloatArray
from bayes_sensor.display import record_card
from bayes_sensor.likelihood.density import response_at_samples
from bayes_sensor.likelihood.held_values import refuse_held
from bayes_sensor.likelihood.mesh import above_zero, expected_information, fastest_beside_tau
from bayes_sensor.likelihood.noise import Noise
from bayes_sensor.likelihood.problem import Problem, as_problem
from bayes_sensor.rig.cascade import euler_response, local_parameters
from bayes_sensor.rig.layout import Layout, Theta

if TYPE_CHECKING:
    import pandas as pd

PUBLISHED_SIGMA = 0.0653
"""V, the RMS residual of the paper's fit"""
FEW = 3
"""parameters that a line shows"""
PAPER = "the paper, eqs. 16-18; Kay (1993), eq. 3.33"
"""where the bound under iid noise comes from"""


@dataclass(frozen=True, eq=False)
class CramerRao:
    """A lower bound on the covariance of unbiased estimates."""

    _repr_html_ = record_card

    names: list[str]
    """flat names of the mean's parameters"""
    cov: FloatArray
    """(n, n); zero rows for parameters held fixed, infinite variance for those not identified"""
    information: FloatArray
    """(n, n) from which it was inverted (noise parameters eliminated)"""
    status: str = "ok"

    def __repr__(self) -> str:
        """The first spreads and the status."""
        few = ", ".join(f"{n} {sd:.4g}" for n, sd in zip(self.names[:FEW], self.sd, strict=False))
        return f"CramerRao(sd of {few}, .. ({len(self.names)}); {self.status})"

    @property
    def sd(self) -> FloatArray:
        """(n,) square roots of the diagonal."""
        return np.sqrt(np.diag(self.cov))

    def __getitem__(self, name: str) -> float:
        """sd of one parameter.  Raises KeyError naming the known ones."""
        if name not in self.names:
            raise KeyError(f"no parameter '{name}'; there are {', '.join(self.names)}")
        return float(self.sd[self.names.index(name)])


def cramer_rao(
    campaign: Campaign | Problem,
    theta: Theta,
    sigma: float = PUBLISHED_SIGMA,
    step: float | None = None,
    method: str | None = None,
    difference: str = "forward",
    noise: str = "iid",
    fixed: Sequence[str] = (),
) -> CramerRao:
    """Cramer-Rao bound on tau, tau_v, V and every y0, beta, t0, tf; a design is enough.

    tau is the value of that name in ``theta``, whether it is the shorter or the longer lag.  In a
    flat vector of a fit or a posterior lags are ordered by size; the first two names are those of
    the shorter and the longer lag (``Fit.names``).

    ``step`` None: converged, from closed-form sensitivities.  ``step`` 0.01: forward Euler, forward
    differences, every parameter moved by +1 % of its value.  This reproduces the published bounds
    within 0.2 %; the step is inferred.  It moves t0 and tf by 0.2-0.9 s at the published
    experiments, far beyond the range in which the response is linear in them.  That hides the
    similarity of a lag and a later switch: the published bound of tau is six times narrower than
    the converged one.  The result also depends on the origin of time (the record's own time is
    used): the same data with another origin give another bound.  A parameter whose value is zero is
    moved by ``step`` times 1 (y0, beta) or times the fastest other time constant (tau, t0, tf); a
    tau of zero only upwards, and not by forward Euler, which is unstable there.  Without a step a
    tau of zero is not identified, because it acts like a later switch.  Its variance and those of
    t0 and tf are then infinite.

    ``sigma``: noise (V) for ``noise="iid"``.  ``noise="ar1"``: phi, sigma0, sigma1 of ``theta``,
    estimated with the others.  Parameters that the problem's noise law fixes have their fixed value
    (:meth:`Problem.flat`).  Needs ``step`` None.  ``method``: ``exact`` or ``euler`` for the
    response (default: Euler with a step, exact without).  ``difference``: ``forward`` or
    ``central``.  ``fixed``: names known exactly, flat (``t0_s[1]``) or of a kind (``t0_s``).

    Raises CampaignError for unknown options, a malformed theta, time constants below zero (tau) or
    not above it, noise that no likelihood allows (``sigma`` or sigma0 not above zero, phi not
    between -1 and 1), or an unstable Euler step.
    """
    problem = as_problem(campaign)
    refuse_held(problem, "cramer_rao")
    layout = problem.layout
    vector = problem.flat(theta)
    for label, value, known in (
        ("difference", difference, ("forward", "central")),
        ("noise", noise, ("iid", "ar1")),
        ("method", method, (None, "exact", "euler")),
    ):
        if value not in known:
            raise CampaignError(f"cramer_rao: {label} must be one of {known}, but is '{value}'")
    if noise == "iid":
        _check_sigma(sigma)
    if step is None:
        if method == "euler":
            raise CampaignError(
                "cramer_rao: forward Euler is piecewise constant in t0 and tf, it has no converged "
                "derivative; give a step or method='exact'"
            )
        information = _converged(problem, vector, sigma, noise)
    else:
        if noise == "ar1" or step == 0:
            raise CampaignError(NO_STEP)
        (J2,) = _finite(problem, vector, float(step), method or "euler", (difference,))
        information = J2 / sigma**2
    return bound_of(layout, information, fixed)


NO_STEP = "cramer_rao: a finite step needs noise='iid' and a step not zero"


def _check_sigma(sigma: float) -> None:
    if not 0.0 < sigma < np.inf:
        raise CampaignError(
            f"cramer_rao: sigma is {sigma} V; expected the noise's size, above zero: correct it"
        )


def bound_of(layout: Layout, information: FloatArray, fixed: Sequence[str]) -> CramerRao:
    """The bound from information (n_mean, n_mean), with the parameters ``fixed`` known."""
    names = layout.mean_names
    unknown = set(fixed) - set(names) - {name.split("[")[0] for name in names}
    if unknown:
        raise CampaignError(f"cramer_rao: nothing called {', '.join(sorted(unknown))} to fix")
    known = [name in fixed or name.split("[")[0] in fixed for name in names]
    free = np.flatnonzero(~np.array(known))
    cov = np.zeros((len(names), len(names)))
    part, identified = invert(information[np.ix_(free, free)])
    cov[np.ix_(free, free)] = part
    status = "ok"
    if not identified.all():
        lost = [names[i] for i in free[~identified]]
        status = f"the data do not identify {', '.join(lost)}"
    return CramerRao(names, cov, information, status)


def _converged(problem: Problem, vector: FloatArray, sigma: float, noise: str) -> FloatArray:
    layout = problem.layout
    n = layout.n_mean
    if noise == "iid":
        problem = replace(problem, noise=Noise("constant", "white"))
        layout = problem.layout
        white = np.tile([0.0, sigma, 0.0], len(layout.noise_names) // 3)
        vector = np.concatenate([vector[:n], white])
        if problem.model.extra:
            raise CampaignError("cramer_rao: models with extra parameters are not covered")
        return expected_information(problem, vector)[:n, :n]
    if np.isnan(vector[layout.noise[:, 1]]).any():
        raise CampaignError("cramer_rao: noise='ar1' needs phi, sigma0_V and sigma1_V in theta")
    for i in layout.noise[:, 1:].ravel():
        least = layout.names[i].startswith("sigma0") or problem.noise.fading
        if vector[i] < 0.0 or (vector[i] == 0.0 and least):
            raise CampaignError(
                f"cramer_rao: {layout.names[i]} is {vector[i]:g} V; expected noise of some size, "
                "sigma0 above zero and sigma1 not below it (nor at it, of noise with levels): "
                "correct it"
            )
    information = expected_information(problem, vector)
    rest = [i for i in range(n, len(vector)) if layout.names[i] not in problem.fixed]
    rest = [i for i in rest if information[i, i] > 0]
    # the noise parameters are estimated too: what is left once they are eliminated
    across = information[:n, rest]
    left = np.linalg.solve(information[np.ix_(rest, rest)], across.T)
    return information[:n, :n] - across @ left


def _finite(
    problem: Problem, vector: FloatArray, step: float, method: str, differences: Sequence[str]
) -> FloatArray:
    """J'J (n_differences, n_mean, n_mean) by relative differences of the mean, forward or
    central."""
    layout = problem.layout
    total = np.zeros((len(differences), layout.n_mean, layout.n_mean))
    fastest = fastest_beside_tau(problem, vector)
    for k, e in enumerate(problem.campaign):
        local = layout.local[k]
        index = np.array([*layout.shared[k], *local[local >= 0]])
        beta = vector[local[1]]
        base = _response(problem, vector, k, method)
        J = np.empty((len(differences), len(index), len(e.t)))
        for row, i in enumerate(index):
            if i == local[0]:
                J[:, row] = 1.0
                continue
            if i == local[1]:
                J[:, row] = base
                continue
            move = step * (vector[i] if vector[i] != 0 else fastest)
            moved = vector.copy()
            moved[i] += move
            up = _response(problem, moved, k, method)
            for by, difference in zip(J, differences, strict=True):
                if difference == "central" and not (i == layout.tau and vector[i] == 0.0):
                    moved[i] = vector[i] - move
                    by[row] = beta * (up - _response(problem, moved, k, method)) / (2.0 * move)
                else:
                    by[row] = beta * (up - base) / move
        if not e.used.all():
            J = J[:, :, e.used]
        total[:, index[:, None], index] += J @ J.transpose(0, 2, 1)
    return total


def _response(problem: Problem, vector: FloatArray, k: int, method: str) -> FloatArray:
    e, layout = problem.campaign.experiments[k], problem.layout
    vector = vector.copy()
    tau = vector[layout.tau]
    vector[layout.tau] = above_zero(problem, vector)
    if method == "exact":
        return response_at_samples(problem, vector, k)
    if not layout.is_published:
        raise CampaignError(
            "cramer_rao: forward Euler is for the paper's rig and one pulse a record; use "
            "method='exact'"
        )
    taus = layout.taus(vector, k, e.total_flow)
    if taus.min() <= 0.5 * e.interval:
        least = min(taus.min(), float(tau))
        raise CampaignError(
            f"experiment '{e.name}': forward Euler is unstable for a time constant of "
            f"{least:.3g} s at an interval of {e.interval:g} s; use method='exact'"
        )
    _, _, t0, tf = local_parameters(vector, layout, e.name)
    return euler_response(e.t, e.interval, taus, t0, tf)


def step_study(
    campaign: Campaign | Problem,
    theta: Theta,
    sigma: float = PUBLISHED_SIGMA,
    steps: Sequence[float] | FloatArray | None = None,
) -> pd.DataFrame:
    """Bound on tau, tau_v, V against the relative finite-difference step.

    Columns: ``step``, ``difference`` (forward, central), ``method`` (euler, exact), ``tau_s``,
    ``tau_v_s``, ``V_mL`` (one standard deviation), ``identified`` (whether every switch time
    moved by at least one sample, without which forward Euler sees no effect of it and the bound is
    that of known switch times).  Default: 16 steps from 1e-6 to 0.1.
    """
    import pandas as pd

    steps = np.geomspace(1e-6, 0.1, 16) if steps is None else np.asarray(steps, dtype=float)
    rows, differences = [], ("forward", "central")
    problem = as_problem(campaign)
    refuse_held(problem, "step_study")
    _check_sigma(sigma)
    if not np.all(steps):
        raise CampaignError(NO_STEP)
    vector, n_shared = problem.flat(theta), problem.layout.n_shared
    for step in steps:
        for method in ("euler", "exact"):
            found = _finite(problem, vector, float(step), method, differences) / sigma**2
            for difference, information in zip(differences, found, strict=True):
                bound = bound_of(problem.layout, information, ())
                row = {name: bound[name] for name in bound.names[:n_shared]}
                identified = bool(np.isfinite(bound.sd).all())
                rows.append(
                    {
                        "step": float(step),
                        "difference": difference,
                        "method": method,
                        **row,
                        "identified": identified,
                    }
                )
    return pd.DataFrame(rows)
