"""Least squares: a particle swarm finds the basin, a trust region its minimum.

The swarm (the paper's method) searches tau, tau_v, V and the switch times; y0 and beta are solved
exactly inside, since the mean is linear in them.  Its best points are refined, and so are more
starts along the flat valley of tau against the switch times. The refinement uses the analytic
Jacobian in the coordinates (tau^2, t0 + tau, tf + tau), where that valley is straight.

The sum of squares is taken on weighted points: averages over short stretches for the search, the
mesh of :mod:`bayes_sensor.likelihood.mesh` for the result. The residuals of the result come from
all samples.

The estimates use the data alone. Side information (a volume measured elsewhere) is compared with
them and may name the lags; the posterior uses it as a prior. Inside, the lags are sorted by size,
because the response does not depend on their order. The result names them as the campaign says
(:mod:`bayes_sensor.rig.lags`).
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from bayes_sensor.fit.fit import Fit, Progress
    from bayes_sensor.fit.least_squares import fit_least_squares, refit
    from bayes_sensor.fit.number_of_lags import count_lags
    from bayes_sensor.fit.swarm import Swarm, particle_swarm

__all__ = ["Fit", "Progress", "Swarm", "count_lags", "fit_least_squares", "particle_swarm", "refit"]

_PLACES = {
    "Fit": "fit", "Progress": "fit", "fit_least_squares": "least_squares",
    "refit": "least_squares", "count_lags": "number_of_lags", "Swarm": "swarm",
    "particle_swarm": "swarm",
}  # fmt: skip


def __getattr__(name: str) -> Any:
    """Loaded when first used: a report reads saved traces without what computes them."""
    if name not in _PLACES:
        raise AttributeError(f"module '{__name__}' has no attribute '{name}'")
    value = getattr(import_module(f"{__name__}.{_PLACES[name]}"), name)
    globals()[name] = value
    return value
