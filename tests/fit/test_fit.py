"""Least squares: the swarm on known functions, the Jacobian, recovery, and what it warns about."""

import json
from dataclasses import dataclass, replace

import numpy as np
import pytest

from bayes_sensor.campaign import Campaign, CampaignError, Experiment
from bayes_sensor.fit import fit_least_squares, particle_swarm
from bayes_sensor.fit.block_averages import averages
from bayes_sensor.fit.euler import euler_relaxed
from bayes_sensor.fit.first_estimates import first_look, initial_bounds, split
from bayes_sensor.fit.fit_warnings import local_noise, warn
from bayes_sensor.fit.fitted_noise import all_residuals
from bayes_sensor.fit.refinement import Squares, mesh_points
from bayes_sensor.fit.starts import SwarmProblem
from bayes_sensor.likelihood.density import simulate
from bayes_sensor.likelihood.mesh import compress
from bayes_sensor.likelihood.noise import Noise, simulate_noise
from bayes_sensor.likelihood.priors import Prior
from bayes_sensor.likelihood.problem import Problem
from bayes_sensor.rig.cascade import Cascade, cascade_response, euler_response, predict
from tests.support.campaigns import small_problem

FLOWS = ((4.0, 0.5), (3.0, 0.5), (2.5, 0.5), (8.0, 1.0), (6.0, 1.0), (5.0, 1.0), (7.5, 1.5))
TRUTH = {"tau_s": 0.15, "tau_v_s": 0.8577, "V_mL": 58.23, "phi": 0.5, "sigma0_V": 0.02}


def design(n=7, interval=0.005, duration=20.0, fall=True, flows=FLOWS):
    """Experiments with the command at 2.5 s and, with ``fall``, at 11 s."""
    t = interval * np.arange(round(duration / interval))
    return Campaign(
        "small",
        tuple(
            Experiment(
                str(k + 1), t, None, carrier / 0.06, test / 0.06, interval,
                commanded_on=2.5, commanded_off=11.0 if fall else None,
            )
            for k, (carrier, test) in enumerate(flows[:n])
        ),
        sensor_is="faster",
    )  # fmt: skip


def truth(campaign, sigma1=0.02, **changes):
    own = {
        e.name: {
            "y0_V": 0.2 + 0.02 * k,
            "beta_V": 1.4 + 0.1 * k,
            "t0_s": 2.8 + 0.0471 * k,
            **({"tf_s": 11.2 + 0.0333 * k} if e.has_fall else {}),
        }
        for k, e in enumerate(campaign)
    }
    return {**TRUTH, "sigma1_V": sigma1, "experiments": own, **changes}


@pytest.fixture(scope="module")
def measured():
    plan = design()
    return simulate(plan, truth(plan), seed=11)


@pytest.fixture(scope="module")
def fitted(measured):
    return fit_least_squares(measured, seed=1)


# ----------------------------------------------------------------- particle swarm


def sphere(x):
    return np.sum((x - 0.3) ** 2, axis=1)


def rosenbrock(x):
    return np.sum(100.0 * (x[:, 1:] - x[:, :-1] ** 2) ** 2 + (1 - x[:, :-1]) ** 2, axis=1)


def rastrigin(x):
    return np.sum(x**2 - 10.0 * np.cos(2 * np.pi * x) + 10.0, axis=1)


@pytest.mark.parametrize(
    ("function", "n", "where", "near"),
    [(sphere, 10, 0.3, 1e-3), (rosenbrock, 2, 1.0, 1e-2), (rastrigin, 3, 0.0, 1e-3)],
)
def test_swarm_finds_known_minima(function, n, where, near):
    found = particle_swarm(
        function, np.full(n, -5.0), np.full(n, 5.0), np.random.default_rng(3), max_iterations=600
    )
    assert np.max(np.abs(found.best - where)) < near
    assert found.cost == function(found.best[None])[0]
    assert found.n_evaluations == 40 * (found.n_iterations + 1)


def test_swarm_stays_in_its_box_and_finds_a_corner():
    seen = []

    def slope(x):
        seen.append(x.copy())
        return x.sum(axis=1)

    low, high = np.array([-1.0, 2.0]), np.array([1.0, 4.0])
    found = particle_swarm(slope, low, high, np.random.default_rng(0))
    everything = np.concatenate(seen)
    assert (everything >= low).all() and (everything <= high).all()
    assert found.best == pytest.approx(low, abs=1e-6)


def test_swarm_without_time_says_it_has_not_settled():
    found = particle_swarm(
        rastrigin, np.full(5, -5.0), np.full(5, 5.0), np.random.default_rng(0), max_iterations=3
    )
    assert not found.settled and found.n_iterations == 3


# ----------------------------------------------------------------- pieces


def test_split_finds_a_step():
    y = np.r_[np.zeros(37), np.ones(63)] + 0.1 * np.random.default_rng(1).standard_normal(100)
    assert split(y) == 37


def test_bounds_come_from_the_record_and_hold_the_truth(measured):
    looks = [first_look(e) for e in measured]
    bounds = initial_bounds(Problem(measured), looks, None)
    true = Problem(measured).layout.flat(truth(measured))
    for name, value in zip(Problem(measured).layout.mean_names, true):
        low, high = bounds[name]
        assert low < value < high, name
    # the start lies between the command and the middle of the rise
    assert bounds["t0_s[1]"][0] == 2.5 and bounds["t0_s[1]"][1] < 6.0


def test_profile_solves_y0_and_beta_exactly(measured):
    # closed form: weighted straight-line regression of y on x3
    looks = [first_look(e) for e in measured]
    points = averages(measured, looks, 12, 40)
    flow = np.array([e.total_flow for e in measured])
    z = np.r_[np.log([0.2, 0.7, 61.0]), np.tile([2.9, 11.3], 7)]
    swarm = SwarmProblem(Problem(measured), points)
    cost, theta = swarm.cost(z[None])[0], swarm.theta(z)
    linear = theta[Problem(measured).layout.local[:, :2]]
    expected = 0.0
    for k in range(7):
        part = slice(points.first[k], points.first[k + 1])
        x = cascade_response(points.t[part], [0.2, 0.7, 61.0 / flow[k]], 2.9, 11.3)
        root = np.sqrt(points.weight[part])
        A = np.column_stack([np.ones_like(x), x]) * root[:, None]
        solution, rest, *_ = np.linalg.lstsq(A, points.y[part] * root)
        assert linear[k] == pytest.approx(solution, rel=1e-8)
        expected += float(rest[0])
    assert cost == pytest.approx(expected, rel=1e-9)


def test_relaxed_euler_is_euler_on_the_grid():
    h = 0.01
    t = h * np.arange(1500)
    # switches between samples act at the next one, with n whole from there
    taus, times = np.array([0.8, 0.4, 0.05]), t[[200, 900]]
    x = euler_relaxed(t, h, taus, times, np.array([1.0, -1.0]))
    assert np.abs(x - euler_response(t, h, [0.8, 0.4, 0.05], t[200], t[900])).max() < 1e-12


@pytest.mark.parametrize("method", ["exact", "euler"])
@pytest.mark.parametrize("straight", [True, False])
def test_jacobian_against_differences(measured, method, straight):
    problem = Problem(measured, model=Cascade(method))
    points = averages(measured, [first_look(e) for e in measured], 40, 150)
    squares = Squares(problem, points, straight)
    theta = problem.layout.flat(truth(measured))[: problem.layout.n_mean]
    theta = theta * 1.003
    p = squares.coordinates(theta)
    assert squares.theta(p) == pytest.approx(theta, rel=1e-14)
    r, J = squares.evaluate(p)
    gradient = 2.0 * J.T @ r
    for i in range(len(p)):
        step = 1e-5 * max(abs(p[i]), 0.01)
        up, down = p.copy(), p.copy()
        up[i] += step
        down[i] -= step
        difference = np.sum(squares.evaluate(up)[0] ** 2) - np.sum(squares.evaluate(down)[0] ** 2)
        scale = np.linalg.norm(J[:, i]) * np.linalg.norm(r)
        # central differences of a sum near 1 at this step keep about five digits
        assert abs(difference / (2 * step) - gradient[i]) < 1e-4 * scale, i


def test_reduced_rows_keep_the_normal_equations(measured):
    problem = Problem(measured)
    points = averages(measured, [first_look(e) for e in measured], 40, 150)
    squares = Squares(problem, points, straight=False)
    theta = problem.layout.flat(truth(measured))[: problem.layout.n_mean] * 1.01
    r, J = squares.evaluate(squares.coordinates(theta))
    # in volts: the levels count in the signal's own unit, as the residuals do
    r = r * squares.unit
    J[:, np.setdiff1d(np.arange(len(theta)), problem.layout.local[:, :2])] *= squares.unit
    assert len(r) == 7 * 8 < len(points.t)
    full_J, full_r = [], []
    vector = np.r_[theta, 0.0, 1.0, 0.0]
    for k, e in enumerate(measured):
        part = slice(points.first[k], points.first[k + 1])
        root = np.sqrt(points.weight[part])
        t = points.t[part]
        jacobian = Cascade().jacobian(t, vector, problem.layout, e)
        full_J.append(jacobian * root[:, None])
        full_r.append((Cascade().mean(t, vector, problem.layout, e) - points.y[part]) * root)
    A, b = np.concatenate(full_J), np.concatenate(full_r)
    assert J.T @ J == pytest.approx(A.T @ A, rel=1e-9, abs=1e-9)
    assert J.T @ r == pytest.approx(A.T @ b, rel=1e-8, abs=1e-8)
    assert r @ r == pytest.approx(b @ b, rel=1e-12)


def full_cost(campaign, theta):
    mean = predict(campaign, theta)
    return sum(float(np.sum((e.values - mean[e.name])[e.used] ** 2)) for e in campaign)


def test_mesh_gives_the_sum_over_all_samples(measured):
    problem = Problem(measured)
    n = problem.layout.n_mean
    theta = problem.layout.flat(truth(measured))[:n]
    box = np.full(n, 0.05)
    points = mesh_points(problem, theta, np.maximum(theta - box, 0.01), theta + box)
    squares = Squares(problem, points)
    rng = np.random.default_rng(5)
    base = squares.cost(theta) - full_cost(measured, theta)
    for _ in range(5):
        other = theta + 0.04 * rng.uniform(-1, 1, n)
        # the scatter inside points is one constant for all theta
        assert squares.cost(other) - full_cost(measured, other) == pytest.approx(base, abs=2e-4)


def test_local_noise_ignores_what_is_slow():
    rng = np.random.default_rng(8)
    n = 40_000
    z = simulate_noise(np.full(n, 0.3), 0.7, rng)
    slow = 2.0 * np.sin(np.arange(n) / 3000.0)
    slow[12_000:12_050] += 30.0
    variance, phi = local_noise(z + slow, np.ones(n, dtype=bool))
    # 40 sections of 1000 samples: a few per cent
    assert phi == pytest.approx(0.7, abs=0.03)
    assert variance == pytest.approx(0.09, rel=0.1)


# ----------------------------------------------------------------- whole fits


def test_truth_lies_within_three_coloured_standard_errors(measured, fitted):
    problem = Problem(measured)
    true = problem.layout.flat(truth(measured))
    sd = np.sqrt(np.diag(np.linalg.inv(compress(measured, true).information(true))))
    deviation = (fitted.theta_hat - true) / sd
    assert np.abs(deviation).max() < 3.0
    # and they are not all zero either: the fit saw the noise
    assert np.abs(deviation[: problem.layout.n_mean]).mean() > 0.2
    assert fitted.converged and fitted.swarms["agree"] and not fitted.at_bound
    assert fitted.warnings == []


def test_numbers_are_those_of_all_samples(measured, fitted):
    cost = full_cost(measured, fitted.theta_hat)
    assert fitted.cost == pytest.approx(cost, rel=1e-10)
    assert fitted.rms == pytest.approx(np.sqrt(cost / measured.n_samples), rel=1e-10)
    assert fitted.n_samples == 7 * 4000
    squares = sum(4000 * rms**2 for rms in fitted.rms_per_experiment.values())
    assert squares == pytest.approx(cost, rel=1e-10)
    # no neighbour is better: the gradient of the full sum vanishes against its curvature
    problem = Problem(measured)
    for i in range(problem.layout.n_mean):
        step = 1e-4 * max(abs(fitted.theta_hat[i]), 0.1)
        up, down = fitted.theta_hat.copy(), fitted.theta_hat.copy()
        up[i] += step
        down[i] -= step
        high, low = full_cost(measured, up), full_cost(measured, down)
        curvature = (high + low - 2 * cost) / step**2
        newton = (high - low) / (2 * step) / curvature
        assert curvature > 0
        assert abs(newton) < 1e-4, problem.layout.names[i]


def test_json_follows_the_contract(fitted):
    result = json.loads(json.dumps(fitted.to_json(), allow_nan=False))
    assert {"rms_V", "n_samples", "parameters", "at_bound", "converged", "warnings"} <= set(result)
    parameters = result["parameters"]
    assert {"tau_s", "tau_v_s", "V_mL", "experiments", "phi", "sigma0_V", "sigma1_V"} == set(
        parameters
    )
    assert set(parameters["experiments"]["3"]) == {"y0_V", "beta_V", "t0_s", "tf_s"}
    assert parameters["experiments"]["3"]["tf_s"] == fitted.theta_hat[fitted.names.index("tf_s[3]")]
    assert result["bounds"]["tau_s"][0] < parameters["tau_s"] < result["bounds"]["tau_s"][1]


def test_one_seed_gives_one_fit(measured, fitted):
    again = fit_least_squares(measured, seed=1)
    assert json.dumps(again.to_json()) == json.dumps(fitted.to_json())
    other = fit_least_squares(measured, seed=2, euler=False)
    # another seed ends in the same minimum by another way
    assert other.swarms != fitted.swarms
    assert other.cost == pytest.approx(fitted.cost, rel=1e-9)


def test_differential_evolution_agrees(measured, fitted):
    checked = fit_least_squares(measured, euler=False, de=True, swarms=1)
    assert checked.de is not None and checked.de["agrees"]
    assert checked.de["tau_v_s"] == pytest.approx(fitted.theta_hat[1], rel=1e-3)
    assert checked.de["V_mL"] == pytest.approx(fitted.theta_hat[2], rel=1e-3)


def test_exact_data_give_the_truth_back():
    plan = design(4)
    clean = truth(plan, sigma1=0.0, sigma0_V=0.0)
    found = fit_least_squares(simulate(plan, clean), swarms=1, euler=False)
    true = Problem(plan).layout.flat(clean)[: Problem(plan).layout.n_mean]
    assert found.theta_hat[: len(true)] == pytest.approx(true, rel=2e-5)
    assert found.rms < 1e-5


def test_euler_fits_its_own_data_and_the_comparison_shows_its_bias():
    plan = design(4, interval=0.02)
    clean = truth(plan, sigma1=0.0, sigma0_V=0.0)
    grid = {k: dict(v) for k, v in clean["experiments"].items()}
    for own in grid.values():  # Euler's switches are samples
        own["t0_s"] = float(plan.experiments[0].t[round(own["t0_s"] / 0.02)])
        own["tf_s"] = float(plan.experiments[0].t[round(own["tf_s"] / 0.02)])
    clean["experiments"] = grid
    problem = Problem(plan, model=Cascade("euler"))
    data = simulate(problem, clean)
    found = fit_least_squares(replace(problem, campaign=data))
    true = problem.layout.flat(clean)[: problem.layout.n_mean]
    assert found.theta_hat[: len(true)] == pytest.approx(true, rel=1e-3)
    assert found.rms < 1e-4 and found.euler is None
    # the exact cascade explains Euler's data less well, and says by how much
    exact = fit_least_squares(data)
    assert exact.euler is not None
    assert exact.euler["rms_V"] < 0.2 * exact.rms
    assert exact.euler["rms_difference_V"] == pytest.approx(exact.euler["rms_V"] - exact.rms)
    assert exact.euler["difference"]["V_mL"] == pytest.approx(58.23 - exact.theta_hat[2], abs=0.1)


# ----------------------------------------------------------------- what it must say


def test_sensor_faster_than_any_bound_is_an_upper_limit():
    plan = design(5)
    data = simulate(plan, truth(plan, tau_s=1e-6, sigma0_V=0.0, sigma1_V=0.0))
    found = fit_least_squares(data, swarms=1, euler=False)
    assert found.at_bound == ["tau_s"]
    assert found.theta_hat[0] == found.bounds["tau_s"][0] == pytest.approx(5e-4)
    assert found.converged and "upper limit only" in " ".join(found.warnings)


def test_switch_before_the_command_sits_on_its_bound():
    plan = design(3)
    theta = truth(plan, sigma0_V=0.001, sigma1_V=0.0)
    theta["experiments"]["2"]["t0_s"] = 2.2
    found = fit_least_squares(simulate(plan, theta), swarms=1, euler=False)
    assert "t0_s[2]" in found.at_bound
    assert any("t0_s[2]" in sentence for sentence in found.warnings)
    assert found.theta_hat[found.names.index("t0_s[2]")] == pytest.approx(2.5, abs=1e-4)


def test_step_up_only_has_no_tf():
    plan = design(5, duration=12.0, fall=False)
    found = fit_least_squares(simulate(plan, truth(plan)), swarms=1, euler=False)
    assert not any(name.startswith("tf") for name in found.names)
    assert "tf_s" not in found.parameters["experiments"]["1"]
    assert found.theta_hat[2] == pytest.approx(58.23, rel=0.05)


def test_equal_flows_are_said():
    plan = design(3, flows=((4.0, 0.5), (3.5, 1.0), (3.0, 1.5)))
    found = fit_least_squares(simulate(plan, truth(plan)), swarms=1, euler=False)
    assert any("cannot be told apart" in sentence for sentence in found.warnings)
    taus = [found.theta_hat[0], found.theta_hat[2] / 75.0, found.theta_hat[1]]
    assert taus == sorted(taus)
    assert sum(taus) == pytest.approx(0.15 + 0.8577 + 58.23 / 75.0, rel=0.05)


def test_invisible_step_is_named_and_the_fit_finishes():
    plan = design(5)
    theta = truth(plan)
    theta["experiments"]["3"]["beta_V"] = 0.0
    found = fit_least_squares(simulate(plan, theta, seed=4), swarms=1, euler=False)
    named = [sentence for sentence in found.warnings if "not visible" in sentence]
    assert len(named) == 1 and "'3'" in named[0]
    assert found.theta_hat[1] == pytest.approx(0.8577, rel=0.05)


def test_a_trace_the_model_misses_is_named():
    plan = design(5)
    data = simulate(plan, truth(plan), seed=4)
    e = data["4"]
    bump = 0.3 * np.exp(-(((e.t - 5.0) / 0.4) ** 2))
    found = fit_least_squares(data.with_data({"4": e.values + bump}), swarms=1, euler=False)
    named = [sentence for sentence in found.warnings if "does not describe" in sentence]
    assert any("'4'" in sentence for sentence in named)


def on_another_clock(campaign, later):
    """The campaign with every time ``later`` s later."""
    return replace(
        campaign,
        experiments=tuple(
            replace(
                e, t=e.t + later, commanded_on=e.commanded_on + later,
                commanded_off=e.commanded_off + later,
            )
            for e in campaign
        ),
    )  # fmt: skip


def test_seconds_since_an_epoch_give_the_same_fit():
    plan = design(3, interval=0.01)
    data = simulate(plan, truth(plan, tau_s=0.05, sigma0_V=0.05, sigma1=0.05), seed=4)
    later = 1.7e9
    here, there = (
        fit_least_squares(campaign, swarms=1, euler=False)
        for campaign in (data, on_another_clock(data, later))
    )
    # doubles have steps of 0.24 us there; with a tolerance that grows with the clock it is 12 %
    np.testing.assert_allclose(there.theta_hat[:3], here.theta_hat[:3], rtol=1e-3)
    assert there.parameters["experiments"]["3"]["t0_s"] - later == pytest.approx(
        here.parameters["experiments"]["3"]["t0_s"], abs=1e-4
    )
    assert there.cost == pytest.approx(here.cost, rel=1e-9)


def test_what_is_warned_of_does_not_depend_on_the_clock():
    plan = design(3)
    data = simulate(plan, truth(plan), seed=4)
    e = data["2"]
    data = data.with_data({"2": e.values + 0.1 * np.exp(-(((e.t - 6.0) / 0.2) ** 2))})
    found = []
    for later in (0.0, 1e6):
        campaign = on_another_clock(data, later)
        vector = Problem(campaign).layout.flat(truth(plan))
        vector[Problem(campaign).layout.local[:, 2:]] += later
        residuals, _ = all_residuals(Problem(campaign), vector)
        unseen = [replace(first_look(e), rise=None) for e in campaign]
        found.append(warn(Problem(campaign), vector, residuals, unseen, "V"))
    assert found[0] == found[1] and "does not describe" in found[0][0]
    assert "more than AR(1) noise explains" in found[0][0]


def test_given_bounds_are_kept_and_reported(measured):
    found = fit_least_squares(measured, bounds={"V": ("60 mL", 80.0)}, swarms=1, euler=False)
    assert found.bounds["V_mL"] == (60.0, 80.0)
    assert found.theta_hat[2] == pytest.approx(60.0, abs=1e-3)
    assert "V_mL" in found.at_bound and any("V_mL" in sentence for sentence in found.warnings)


@pytest.mark.parametrize(
    ("bounds", "message"),
    [
        ({"W": (1.0, 2.0)}, "unknown parameter 'W'"),
        ({"phi": (0, 1)}, "no parameter 'phi' in the"),
        ({"tau_s": "1 s"}, "tau_s: expected low and high, but got 1 s; write"),
        ({"t0": (1.0, "1 mL")}, "bounds t0: expected a time"),
        ({"V_mL": (2.0, 1.0)}, "low < high"),
    ],
)
def test_bad_bounds_are_errors(measured, bounds, message):
    with pytest.raises(CampaignError, match=message):
        fit_least_squares(measured, bounds=bounds)


def test_a_design_cannot_be_fitted():
    with pytest.raises(CampaignError, match="design without data"):
        fit_least_squares(design(2))


# ----------------------------------------------------------------- noise


def noise_of(problem, theta, seed=3):
    data = simulate(problem, theta, seed=seed)
    found = fit_least_squares(replace(problem, campaign=data), swarms=1, euler=False)
    return dict(zip(found.names, found.theta_hat))


@pytest.mark.parametrize("phi", [-0.3, 0.0, 0.9])
def test_noise_is_estimated(phi):
    plan = design(7, duration=40.0)
    found = noise_of(Problem(plan), truth(plan, phi=phi, sigma1=0.03))
    # 56 000 samples: phi to its asymptotic sd; sizes to a few per cent of effective samples
    assert found["phi"] == pytest.approx(phi, abs=5 * np.sqrt((1 - phi**2) / 56_000) + 0.003)
    assert found["sigma0_V"] == pytest.approx(0.02, rel=0.06)
    assert found["sigma1_V"] == pytest.approx(0.03, rel=0.08)


@pytest.mark.parametrize("sigma1", [0.005, 0.05])
def test_levels_of_noise_are_estimated(sigma1):
    plan = design(7, duration=40.0)
    found = noise_of(Problem(plan, noise=Noise("levels")), truth(plan, phi=0.5, sigma1=sigma1))
    assert found["phi"] == pytest.approx(0.5, abs=0.02)
    assert found["sigma0_V"] == pytest.approx(0.02, rel=0.06)
    # some 9 000 samples are on the plateau of the highest concentration, 5 000 independent ones
    assert found["sigma1_V"] == pytest.approx(sigma1, rel=0.15)


def test_pinned_noise_stays_pinned():
    plan = design(3)
    found = noise_of(Problem(plan, noise=Noise("constant", "white")), truth(plan))
    assert found["phi"] == 0.0 and found["sigma1_V"] == 0.0
    assert 0.02 < found["sigma0_V"] < 0.03


def test_noise_per_experiment():
    plan = design(3)
    layout_noise = {
        f"{kind}[{name}]": value * (1 + 0.5 * k if kind == "sigma0_V" else 1)
        for k, name in enumerate("123")
        for kind, value in (("phi", 0.5), ("sigma0_V", 0.02), ("sigma1_V", 0.0))
    }
    problem = Problem(plan, noise=Noise("constant", per_experiment=True))
    theta = {k: v for k, v in truth(plan).items() if k not in ("phi", "sigma0_V", "sigma1_V")}
    found = noise_of(problem, {**theta, **layout_noise})
    for name, expected in (("1", 0.02), ("2", 0.03), ("3", 0.04)):
        assert found[f"sigma0_V[{name}]"] == pytest.approx(expected, rel=0.1)
        assert found[f"phi[{name}]"] == pytest.approx(0.5, abs=0.05)


def test_unequal_intervals_and_masked_samples():
    fast, slow = design(5), design(5, interval=0.01)
    t = fast.experiments[0].t
    mask = ~((t > 5.0) & (t < 5.5)) & (np.arange(len(t)) % 977 != 0)
    members = [replace(e, mask=mask) for e in fast.experiments[:4]]
    plan = Campaign("mixed", (*members, slow.experiments[4]), sensor_is="faster")
    theta = truth(plan, phi=0.6)
    data = simulate(plan, theta, seed=2)
    spoiled = {}
    for e in data.experiments[:4]:
        y = e.values.copy()
        y[~mask] = np.nan
        spoiled[e.name] = y
    found = fit_least_squares(data.with_data(spoiled), swarms=1, euler=False)
    assert found.n_samples == 4 * int(mask.sum()) + 2000
    assert found.phi_interval == 0.005
    assert found.theta_hat[found.names.index("phi")] == pytest.approx(0.6, abs=0.03)
    assert found.theta_hat[1] == pytest.approx(0.8577, rel=0.03)
    assert np.isfinite(found.theta_hat).all()


# ----------------------------------------------------------------- other models


@dataclass(frozen=True)
class Drifting(Cascade):
    """The cascade with a baseline that drifts at one rate, V/s."""

    extra: tuple[str, ...] = ("rate_V_per_s",)

    def mean(self, t, theta, layout, experiment):
        return super().mean(t, theta, layout, experiment) + theta[-1] * t


def test_a_model_with_extra_parameters_is_refined():
    plan = design(5)
    prior = {"rate_V_per_s": Prior("normal", 0.0, 0.05)}
    problem = Problem(plan, model=Drifting(), given_priors=prior)
    data = simulate(problem, truth(plan, rate_V_per_s=0.01))
    found = fit_least_squares(replace(problem, campaign=data), swarms=1)
    assert found.names[-1] == "rate_V_per_s"
    assert found.theta_hat[-1] == pytest.approx(0.01, abs=5e-4)
    assert found.theta_hat[1] == pytest.approx(0.8577, rel=0.03)
    assert found.rms == pytest.approx(0.0245, rel=0.1)
    json.dumps(found.to_json(), allow_nan=False)


def test_progress_is_told(measured):
    told = []
    fit_least_squares(
        measured, swarms=1, euler=False, progress=lambda f, word: told.append((f, word))
    )
    fractions = [fraction for fraction, _ in told]
    assert fractions == sorted(fractions) and told[-1] == (1.0, "done")


def test_a_rise_ends_where_nine_tenths_are_first_reached() -> None:
    problem, theta = small_problem(n=1, interval=0.01, sigma=0.002)
    e = problem.campaign.experiments[0]
    t = np.arange(0.0, 5.0, 1e-3)
    taus = [theta[0], theta[1], theta[2] / e.total_flow]
    x = cascade_response(t, taus, 0.0)
    expected = t[x >= 0.9][0] - t[x >= 0.1][0]
    assert first_look(e).rise == pytest.approx(expected, abs=0.03)


@pytest.mark.parametrize(("lags", "settled"), [(1.0, False), (2.0, False), (6.0, True)])
def test_a_step_of_few_lags_does_not_reach_its_plateau(lags: float, settled: bool) -> None:
    t = np.arange(0.0, 3.0 + lags, 0.01)
    y = np.where(t < 2.0, 0.0, 1.0 - np.exp(-(t - 2.0)))
    y += 1e-3 * np.random.default_rng(1).standard_normal(len(t))
    e = Experiment("a", t, y, 60.0, 10.0, 0.01, 2.0, 2.0 + lags)
    assert first_look(e).settled == settled
