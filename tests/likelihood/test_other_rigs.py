"""Any chain and any programme: mesh, gradient and exact density agree with a dense Gaussian."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy import stats

from bayes_sensor.campaign import Campaign, Commands, FloatArray
from bayes_sensor.likelihood.density import log_likelihood
from bayes_sensor.likelihood.mesh import compress
from bayes_sensor.likelihood.problem import Problem
from bayes_sensor.rig.lags import Commuting
from bayes_sensor.rig.programme import Programme, RecordedInput
from bayes_sensor.rig.rig import Rig
from tests.support.other_rigs import CASES, INTERVAL, Case, T, experiment


@pytest.fixture(params=CASES, scope="module")
def case(request: pytest.FixtureRequest) -> Case:
    return CASES[request.param]()


def _responses(case: Case) -> list[FloatArray]:
    """Of every experiment, by the rig alone: no layout, no switching."""
    found = []
    for e in case.design:
        rig = Rig.parse(case.design.stages)
        shared = np.array(
            [case.shared.get(n, case.shared.get(f"{n}[{e.sensor}]")) for n in rig.names]
        )
        done = e.commands
        programme: Programme | RecordedInput
        if done is None:
            programme = Programme.pulse(20.33, 70.21 if e.has_fall else None)
        elif done.recorded:
            programme = RecordedInput(done.times + 0.3, done.levels)
        else:
            late = 0.3 if done.delays == "shared" else 0.33
            programme = Programme(done.times + late, done.heights)
        found.append(rig.response(e.t, shared, e.total_flow, programme))
    return found


def test_the_density_is_that_of_a_dense_gaussian(case: Case) -> None:
    data, expected = case.simulated(), 0.0
    for e, x in zip(data, _responses(case), strict=True):
        mean = 0.3 + 1.5 * x
        weight = e.concentration / data.reference_concentration
        scale = np.sqrt(case.sigma0**2 + case.sigma1**2 * weight * np.maximum(x, 0.0))
        places = np.arange(len(T))
        cov = np.outer(scale, scale) * case.phi ** np.abs(places[:, None] - places)
        expected += stats.multivariate_normal(mean, cov).logpdf(e.values)
    assert log_likelihood(data, case.theta) == pytest.approx(expected, abs=1e-6)


def test_the_mesh_has_the_density_and_its_gradient(case: Case) -> None:
    data = case.simulated()
    problem, theta = Problem(data), case.theta
    mesh = compress(problem, theta)
    assert mesh.log_likelihood(theta) == pytest.approx(log_likelihood(data, theta), abs=1e-3)
    assert mesh.n_full_passes == 0
    rng = np.random.default_rng(3)
    # beside the samples, at which the response of a single lag bends
    for row in theta * (1.0 + 1e-3 * rng.standard_normal((4, len(theta)))):
        value, gradient = mesh.value_and_gradient(row)
        assert value == pytest.approx(log_likelihood(data, row), abs=1e-3)
        for i in rng.choice(len(theta), 6, replace=False):
            step = 1e-6 * max(abs(row[i]), 1e-2)
            up, down = row.copy(), row.copy()
            up[i] += step
            down[i] -= step
            slope = (log_likelihood(data, up) - log_likelihood(data, down)) / (2.0 * step)
            assert gradient[i] == pytest.approx(slope, rel=2e-3, abs=2e-3 * np.abs(gradient).max())


def test_the_marginal_is_the_integral_over_levels(case: Case) -> None:
    data, theta = case.simulated(), case.theta
    problem = Problem(data)
    mesh = compress(problem, theta)
    value, best, factor = mesh.marginal(theta)
    local = problem.layout.local[:, :2]
    at_best = theta.copy()
    at_best[local] = best
    # a Gaussian integral: the value at its top times sqrt(2 pi)^2 over the factor's determinant
    tops = log_likelihood(data, at_best)
    integral = tops + sum(np.log(2.0 * np.pi) - np.log(f[0] * f[2]) for f in factor)
    assert value == pytest.approx(integral, abs=2e-3)


def test_two_hundred_pulses_cost_no_parameters() -> None:
    t = np.arange(0.0, 2000.0, INTERVAL)
    times = np.sort(np.concatenate([5.0 + 10.0 * np.arange(199), 9.0 + 10.0 * np.arange(199)]))
    pulses = Commands(times, (np.arange(len(times)) % 2 == 0).astype(float), delays="shared")
    one = replace(experiment("1", commands=pulses), t=t, mask=None)
    case = Case(Campaign("pulses", (one,), stages=("sensor",)), {"tau_s": 1.5})
    data = case.simulated()
    problem = Problem(data)
    assert problem.layout.names == [
        "tau_s", "y0_V[1]", "beta_V[1]", "delay_on_s[1]", "delay_off_s[1]", "phi", "sigma0_V",
        "sigma1_V",
    ]  # fmt: skip
    mesh = compress(problem, case.theta)
    assert mesh.log_likelihood(case.theta) == pytest.approx(
        log_likelihood(data, case.theta), abs=1e-3
    )


def test_lags_that_coincide_take_the_stable_form() -> None:
    equal = CASES["four stages"]()
    shared = {**equal.shared, "tau_v_s": 2.0, "tau_probe_s": 2.0}
    case = replace(equal, shared=shared)
    data = case.simulated()
    assert log_likelihood(
        data,
        case.theta,
    ) == pytest.approx(compress(data, case.theta).log_likelihood(case.theta), abs=1e-3)


def test_lags_stand_in_theta_by_size() -> None:
    published = ("tau_s", "tau_v_s", "V_mL")
    assert Commuting.among(published, published, 60.0).places == (0, 2, 1)
    names = ("tau_s", "tau_v_s", "tau_probe_s", "V_mL")
    problem = Problem(CASES["four stages"]().design)
    assert problem.layout.shared_names == names
    assert problem.commuting.names == names[:3] and problem.commuting.places == (0, 1, 2)
    theta = problem.commuting.by_size(CASES["four stages"]().theta)
    assert theta[:4].tolist() == [0.7, 2.0, 6.0, 150.0]
    # the sensor's is the longest: what is left are two ways to name the others
    assert [choice.places for choice in problem.assignments] == [(2, 0, 1), (2, 1, 0)]
    assert Problem(CASES["two sensors"]().design).commuting.names == ("tau_v_s",)
