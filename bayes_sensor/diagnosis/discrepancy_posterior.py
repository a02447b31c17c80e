"""tau where the cause is not listed: the posterior with the smooth discrepancy in the model.

An unlisted cause bends tau by an unknown amount, and the plain posterior knows nothing of it.  With
a discrepancy in the model (Kennedy and O'Hagan 2001) the interval holds what such a cause may do.
Its amplitudes and lengths are averaged by their evidence.  The discrepancy is drawn given the data,
and every draw of the parameters moves as a refit would if the drawn discrepancy were taken off the
data; for a linear model with Gaussian noise that is the joint posterior, and what a drawn
discrepancy shares with the parameters is theirs (Plumlee 2017).  Real causes are less smooth than
the process, so that spreads are widened by the factor of the calibration map.
"""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np
from scipy.special import logsumexp, ndtr

from bayes_sensor.campaign import CampaignError, FloatArray
from bayes_sensor.diagnosis.calibration import calibration
from bayes_sensor.diagnosis.closure import NEGLIGIBLE
from bayes_sensor.diagnosis.data.preparation import fit_base, prepare
from bayes_sensor.diagnosis.evidence.block_least_squares import inverted, solved
from bayes_sensor.diagnosis.evidence.compared_hypotheses import Comparison
from bayes_sensor.diagnosis.evidence.discrepancy import Discrepancy, make_discrepancies
from bayes_sensor.diagnosis.evidence.laplace_evidence import Linearised
from bayes_sensor.diagnosis.evidence.refit import Refit
from bayes_sensor.posterior.convergence import diagnose
from bayes_sensor.rig.lags import Naming
from bayes_sensor.rig.layout import Layout

if TYPE_CHECKING:
    from bayes_sensor.fit import Fit
    from bayes_sensor.posterior import Posterior

PERCENT = (2.5, 50.0, 97.5)


def tau_with_discrepancy(comparison: Comparison) -> dict[str, float]:
    """Percentiles of tau (s) with the discrepancy in the model, by its evidences."""
    return _percentiles(comparison.base, comparison.discrepancies)


def _percentiles(base: Refit, discrepancies: tuple[Discrepancy, ...]) -> dict[str, float]:
    found = Linearised(base).evidences(discrepancies)
    weights = _weights(base, discrepancies)
    centre = np.array([e.log_tau for e in found])
    spread = calibration().tau_widening * np.array([e.sd_log_tau for e in found])
    keep = weights > NEGLIGIBLE
    weights, centre, spread = weights[keep] / weights[keep].sum(), centre[keep], spread[keep]
    grid = np.linspace(np.min(centre - 5.0 * spread), np.max(centre + 5.0 * spread), 4001)
    below = ndtr((grid[:, None] - centre) / spread) @ weights
    at = np.exp(np.interp(np.array(PERCENT) / 100.0, below, grid))
    return {f"q{percent:g}": float(tau) for percent, tau in zip(PERCENT, at, strict=True)}


def _weights(base: Refit, discrepancies: tuple[Discrepancy, ...]) -> FloatArray:
    """(n,) probability of every configuration, given that one of them is there alone."""
    logs = np.array([e.log_z for e in Linearised(base).evidences(discrepancies)])
    prior = np.array([d.weight if base.coords.parts else d.alone for d in discrepancies])
    with np.errstate(divide="ignore"):
        total = logs + np.log(prior)
    made: FloatArray = np.exp(total - logsumexp(total))
    return made


def with_discrepancy(posterior: Posterior, fit: Fit, seed: int = 1) -> Posterior:
    """The posterior with the smooth discrepancy in the model.

    ``posterior`` is that of the model without effects; its draws are moved one by one.

    Raises
    ------
    CampaignError
        Where all flows are equal, so that a volume's lag cannot be told from the others and a
        discrepancy would move an unknown one, or where no record has a quiet stretch.
    """
    problem = posterior.problem
    if problem.flow is not None:
        raise CampaignError(
            "posterior --with-discrepancy: all experiments share one total flow, so that the "
            "volume's lag is one of several that have no names; expected two flows or more: record "
            "another flow, or use posterior without it"
        )
    layout = Layout.of(problem.campaign)
    theta = layout.flat(np.asarray(fit.theta_hat, dtype=float)[: layout.n_mean])
    base = fit_base(prepare(problem.campaign, theta, fit.naming).binned)
    discrepancies = tuple(make_discrepancies(base.coords.binned, base))
    rng = np.random.default_rng([seed, 0xD15C])
    n_chain, n_draw, n_theta = posterior.chains.shape
    steps = _steps(base, discrepancies, n_chain * n_draw, rng)
    draws = posterior.chains.reshape(-1, n_theta).copy()
    if base.coords.binned.chain is None:
        # the first coordinate is how far the shorter lag's logarithm lies below the longer one's
        steps[:, 0] = steps[:, 1] - steps[:, 0]
    else:
        steps = _of_theta(steps, base, layout, fit.naming)
    here, n_shared = draws[:, : layout.n_mean], layout.n_shared
    here[:, :n_shared] = np.log(here[:, :n_shared])
    here -= steps
    here[:] = here.mean(axis=0) + calibration().tau_widening * (here - here.mean(axis=0))
    here[:, :n_shared] = np.exp(here[:, :n_shared])
    by_size = list(problem.commuting.places)
    here[:, by_size] = np.sort(here[:, by_size], axis=1)
    chains = draws.reshape(posterior.chains.shape)
    r_hat, bulk, tail = diagnose(problem, chains)
    return replace(
        posterior, chains=chains, r_hat=r_hat, ess_bulk=bulk, ess_tail=tail,
        remarks=(*posterior.remarks,
                 "a smooth discrepancy is in the model: the intervals hold what an unlisted cause "
                 "may do to the parameters"),
    )  # fmt: skip


def _of_theta(steps: FloatArray, base: Refit, layout: Layout, naming: Naming) -> FloatArray:
    """(n, n_mean) steps of theta, from those of the coordinates of a chain of stages.

    In theta lags are by size, and several sensors of one record share its switches.
    """
    made, count = np.zeros((len(steps), layout.n_mean)), np.zeros(layout.n_mean)
    choice = naming.exchanged
    for i, name in enumerate(layout.shared_names):
        place = None if choice is None else choice.place(name)
        at = i if place is None else naming.commuting.places[place]
        made[:, at], count[at] = steps[:, i], 1.0
    for k in range(len(layout.experiments)):
        places = layout.local[k][layout.local[k] >= 0]
        first = base.coords.local[k]
        made[:, places] += steps[:, first : first + len(places)]
        count[places] += 1.0
    return made / count


def _steps(
    base: Refit, discrepancies: tuple[Discrepancy, ...], n: int, rng: np.random.Generator
) -> FloatArray:
    """(n, n_coordinates): by how much a refit moves for each drawn discrepancy, in random order."""
    weights = _weights(base, discrepancies)
    weights[weights < NEGLIGIBLE] = 0.0
    counts = rng.multinomial(n, weights / weights.sum())
    drawn = [
        _steps_of(base, d, rng, count)
        for d, count in zip(discrepancies, counts, strict=True) if count
    ]  # fmt: skip
    made = np.concatenate(drawn)
    return np.asarray(made[rng.permutation(n)])


def _steps_of(base: Refit, d: Discrepancy, rng: np.random.Generator, n: int) -> FloatArray:
    # (n, n_coordinates) (J'J + P)^-1 J' U a, with U a the discrepancy given the residual, the
    # parameters integrated out under their priors
    jacobian, prior = base.jacobian, base.coords.own_prior_matrix
    pull = prior @ (base.x - base.coords.prior_centre)
    shrink = d.variance / (1.0 + d.variance)
    normal = jacobian.T @ jacobian
    seen = d.basis.T @ jacobian
    inner = d.basis.T @ base.residual
    beside = inverted(normal - seen.T @ (shrink[:, None] * seen) + prior)
    gradient = jacobian.T @ base.residual - seen.T @ (shrink * inner) - pull
    mean = shrink * (inner - seen @ (beside @ gradient))
    part = shrink[:, None] * seen
    covariance = np.diag(shrink) + part @ beside @ part.T
    a = mean[:, None] + np.linalg.cholesky(covariance) @ rng.standard_normal((len(mean), n))
    made: FloatArray = solved(normal + prior, seen.T @ a).T
    return made
