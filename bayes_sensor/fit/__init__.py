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

from bayes_sensor.fit.fit import Fit, Progress
from bayes_sensor.fit.least_squares import fit_least_squares, refit
from bayes_sensor.fit.number_of_lags import count_lags
from bayes_sensor.fit.swarm import Swarm, particle_swarm

__all__ = ["Fit", "Progress", "Swarm", "count_lags", "fit_least_squares", "particle_swarm", "refit"]
