"""Refits, evidences and the discrepancy against independent routes."""

import numpy as np
import pytest

from bayes_sensor.gap import CATALOGUE
from bayes_sensor.gap.discrepancy import make_discrepancies, matern32
from bayes_sensor.gap.embedded import embedded_rivals
from bayes_sensor.gap.evidence import Linearised
from bayes_sensor.gap.floor import DOF
from bayes_sensor.gap.refit import FASTER, Part, Plan, refit
from bayes_sensor.gap.sketch import coordinates, fit_base, flat_theta, prepare
from bayes_sensor.gap.where import Leverage
from bayes_sensor.gap.which import family_priors, joined_start, with_start
from bayes_sensor.model import Layout
from tests.gap_cases import measured, theta


@pytest.fixture(scope="module")
def sketch():
    campaign = measured({"valve_asymmetry": 1.15}, seed=3)
    return prepare(campaign, Layout.of(campaign).flat(theta(campaign))).sketch


@pytest.fixture(scope="module")
def base(sketch):
    return fit_base(sketch)


def test_coordinates_and_theta_are_inverse(sketch):
    vector = Layout.of(sketch.campaign).flat(theta(sketch.campaign))
    x = coordinates(sketch.campaign, vector)
    assert np.allclose(flat_theta(sketch.campaign, x), vector[: len(x)])
    # the slower of the two lags that do not depend on the flow is the valve's
    swapped = vector.copy()
    swapped[[0, 1]] = vector[[1, 0]]
    assert np.allclose(coordinates(sketch.campaign, swapped), x)


def test_a_noise_free_refit_finds_the_truth(sketch):
    effect = CATALOGUE["valve_asymmetry"]
    plan = Plan(sketch, (Part(effect, effect.forms[0]),))
    truth = plan.start(sketch.base, {"closing_ratio": 1.2})
    data = [plan.binned(truth, k) for k in range(len(sketch.bins))]
    start = plan.start(sketch.base, {})
    start[0] += 0.5
    start[1] += 0.05
    found = refit(plan, start, data=data, most_steps=60, tolerance=1e-8)
    assert found.converged
    assert found.misfit < 0.5
    assert found.strength()["closing_ratio"] == pytest.approx(1.2, abs=0.01)


def test_derivatives_do_not_depend_on_the_step(sketch, base):
    effect = CATALOGUE["dead_volume"]
    plan = Plan(sketch, (Part(effect, effect.forms[1]),))
    x = plan.start(base.x, {"pocket_share": 0.05})
    here = plan.binned(x, 1)
    forward = plan.jacobian(x, 1, here)
    columns = plan.columns(1)
    for i, c in enumerate(columns):
        up, down = x.copy(), x.copy()
        up[c] += 3 * plan.steps[c]
        down[c] -= 3 * plan.steps[c]
        central = (plan.binned(up, 1) - plan.binned(down, 1)) / (6 * plan.steps[c])
        central = sketch.inverse_factors[1] @ central
        assert np.max(np.abs(forward[:, i] - central)) < 0.03 * np.max(np.abs(central)) + 1e-3


def test_the_sensor_stays_the_faster_lag(sketch):
    plan = Plan(sketch)
    start = sketch.base.copy()
    start[0] = -1.0
    found = refit(plan, start, most_steps=3)
    assert found.x[0] >= 0.0
    assert found.tau <= found.tau_v * np.exp(-FASTER) * (1 + 1e-12)


def test_evidence_is_the_multivariate_t_where_the_model_fits():
    """Laplace against the dense t density of the data, the linearised parameters integrated out."""
    campaign = measured({}, seed=5)
    base = fit_base(prepare(campaign, Layout.of(campaign).flat(theta(campaign))).sketch)
    line = Linearised(base)
    j = line.jacobian
    prior = base.plan.own_prior_matrix
    # dense route: data ~ t with covariance I + J prior^-1 J'
    covariance = np.eye(len(j)) + j @ np.linalg.solve(prior, j.T)
    centre = base.residual + j @ (base.x - base.plan.prior_centre)
    n = len(j)
    _, log_det = np.linalg.slogdet(covariance)
    square = float(centre @ np.linalg.solve(covariance, centre))
    dense = -0.5 * log_det - 0.5 * (DOF + n) * np.log1p(square / DOF)
    made = line.evidence(None).log_z
    assert made == pytest.approx(dense, abs=1.5)


def test_low_rank_discrepancy_is_the_dense_kernel(sketch, base):
    found = {d.name: d for d in make_discrepancies(sketch, base)}
    d = found["response 1 0.01"]
    flows = np.log([e.total_flow for e in sketch.campaign])
    flow = (flows - flows.mean()) / flows.std()
    n = sketch.n_bins
    dense = np.zeros((n, n))
    for falling in (False, True):
        u = [np.log(np.maximum(b.since, 0) / sketch.time_scale + 0.06) for b in sketch.bins]
        s = [
            np.where((b.falling == falling) & (b.since > 0), abs(base.x[base.plan.local[k] + 1]), 0)
            for k, b in enumerate(sketch.bins)
        ]
        for k, rows in enumerate(sketch.rows):
            for m, columns in enumerate(sketch.rows):
                common = 1 + 0.25 * flow[k] * flow[m] + (0.01 if k == m else 0.0)
                kernel = matern32(np.subtract.outer(u[k], u[m]), 1.0) * common
                dense[rows, columns] += 1e-4 * kernel * np.outer(s[k], s[m])
    for k, rows in enumerate(sketch.rows):
        dense[rows] = sketch.inverse_factors[k] @ dense[rows]
    for k, rows in enumerate(sketch.rows):
        dense[:, rows] = dense[:, rows] @ sketch.inverse_factors[k].T
    made = d.basis @ (d.variance[:, None] * d.basis.T)
    # the kernel is interpolated from a grid: up to a tenth of its variance is lost between
    assert np.max(np.abs(made - dense)) < 0.1 * np.max(np.abs(dense))
    _, exact = np.linalg.slogdet(np.eye(n) + made)
    assert d.log_determinant() == pytest.approx(exact, rel=1e-6)
    v = np.random.default_rng(1).standard_normal(n)
    assert np.allclose(d.precision_times(v), np.linalg.solve(np.eye(n) + made, v))


def test_leverage_is_the_projection_of_noise(sketch, base):
    leverage = Leverage.of(base)
    noise = np.random.default_rng(1).standard_normal((sketch.n_bins, 400))
    left = leverage.leave(noise)
    assert np.mean(np.sum(left**2, axis=0)) == pytest.approx(leverage.trace(), rel=0.02)
    rows = np.arange(5, 40)
    sample = left[rows] @ left[rows].T / noise.shape[1]
    assert np.max(np.abs(np.diag(sample) - np.diag(leverage.block(rows)))) < 0.35


def test_priors_go_over_families_first():
    priors = family_priors(CATALOGUE)
    families = {}
    for name, p in priors.items():
        families.setdefault(CATALOGUE[name].family, []).append(np.exp(p))
    totals = [sum(v) for v in families.values()]
    assert np.allclose(totals, totals[0])
    assert sum(totals) == pytest.approx(0.35)


def test_a_joined_start_keeps_what_was_fitted(sketch, base):
    first, second = CATALOGUE["flow_error"], CATALOGUE["baseline_drift"]
    one = Plan(sketch, (Part(first, first.forms[0]),))
    fitted = refit(one, one.start(base.x, {}), most_steps=5)
    two = Plan(sketch, (*one.parts, Part(second, second.forms[1])))
    x = with_start(two, joined_start(two, fitted), {})
    for k in range(len(sketch.bins)):
        assert np.allclose(two.binned(x, k), one.binned(fitted.x, k), atol=1e-9)


def test_a_dependence_that_has_a_name_is_no_rival():
    def names(catalogue, flows=True, fall=True):
        return {r.name for r in embedded_rivals(catalogue, flows, fall)}

    assert "valve by direction" not in names(CATALOGUE)
    fewer = [n for n in CATALOGUE if n != "valve_asymmetry"]
    assert "valve by direction" in names(fewer)
    assert not any("flow" in n for n in names(CATALOGUE, flows=False))
    assert not any("direction" in n for n in names([], fall=False))
