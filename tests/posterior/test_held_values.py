"""Held parameters have no dimension in fit and posterior; nothing else carries them silently."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.optimize import least_squares

import bayes_sensor as bs
from bayes_sensor.likelihood.coordinates import Coordinates
from tests.support.campaigns import small_problem

HELD = [{"tau_v": "0.32 s"}, {"V": "13 mL", "t0[a]": "2.01 s"}, {"tf": 7.02}]


def held_problem(fix: dict[str, str], sensor_is: str = "faster", n: int = 2) -> bs.Problem:
    problem, _ = small_problem(n=n, interval=0.02 if n == 2 else 0.01)
    return bs.make_problem(replace(problem.campaign, sensor_is=sensor_is), fix=fix)


@pytest.mark.parametrize("fix", HELD)
def test_the_fit_is_the_least_squares_of_what_varies(fix: dict[str, str]) -> None:
    problem = held_problem(fix)
    fit = bs.fit_least_squares(problem, seed=1, swarms=1)
    layout, held = problem.layout, problem.held
    assert fit.converged and fit.euler is None and not set(fit.at_bound) & held.keys()
    for name, value in held.items():
        assert fit.theta_hat[layout.index(name)] == value
    free = [i for i, name in enumerate(layout.mean_names) if name not in held]
    theta = fit.theta_hat.copy()

    def residuals(values: np.ndarray) -> np.ndarray:
        theta[free] = values
        predicted = [bs.predict(problem.campaign, theta)[e.name] for e in problem.campaign]
        return np.concatenate([m - e.values for m, e in zip(predicted, problem.campaign)])

    best = fit.theta_hat[free].copy()
    scale = np.maximum(np.abs(best), 0.1)
    other = least_squares(residuals, best + 1e-3 * scale, x_scale=scale, xtol=1e-12, ftol=1e-14)
    # both stop where the sum of squares is flat to rounding
    assert fit.cost == pytest.approx(2.0 * other.cost, rel=1e-7)
    np.testing.assert_allclose(best, other.x, rtol=2e-3, atol=2e-4)


def test_a_valve_that_is_the_faster_lag_may_be_held() -> None:
    # then the held lag stands first in theta, where tau does else
    problem = held_problem({"tau_v": "0.1 s"}, "slower")
    assert problem.held == {"tau_s": 0.1}
    assert "tau_s" not in Coordinates(problem).names and len(Coordinates(problem).switches) == 0
    fit = bs.fit_least_squares(problem, seed=1, swarms=1)
    assert fit.parameters["tau_v_s"] == 0.1 and fit.parameters["tau_s"] > 0.2
    posterior = bs.sample_posterior(problem, fit, seed=1, sampler="independence")
    assert posterior.converged
    assert np.ptp(posterior.of("tau_v_s")) == 0.0 and posterior.sd("tau_s") > 1e-3


@pytest.mark.slow
@pytest.mark.parametrize("sampler", ["independence", "hmc", "emcee"])
def test_the_posterior_is_that_of_a_narrow_prior(sampler: str) -> None:
    problem = held_problem({"tau_v": "0.3 s"}, n=3)
    fit = bs.fit_least_squares(problem, seed=1, swarms=1)
    posterior = bs.sample_posterior(problem, fit, seed=1, sampler=sampler)
    assert posterior.sampler == sampler and posterior.converged
    assert np.ptp(posterior.of("tau_v_s")) == 0.0
    assert len(Coordinates(problem).free) == len(problem.layout) - 1
    narrow = bs.make_problem(problem.campaign, {"tau_v": bs.Prior("normal", 0.3, 3e-4)})
    other = bs.sample_posterior(narrow, fit, seed=2, sampler="independence")
    for name in ("tau_s", "V_mL", "t0_s[a]", "beta_V[b]", "phi"):
        # 400 independent draws of each tell the mean to .07 sd, and the sd to 5 %
        assert abs(posterior.mean(name) - other.mean(name)) < 0.25 * other.sd(name), name
        assert posterior.sd(name) == pytest.approx(other.sd(name), rel=0.2), name
    assert posterior.to_json()["parameters"]["tau_v_s"]["sd"] < 1e-12


def test_a_held_switch_time_is_not_drawn() -> None:
    problem = held_problem({"t0[a]": "2.0 s"})
    posterior = bs.sample_posterior(problem, seed=1, sampler="independence")
    assert "t0_s[a]" not in posterior.rows and "t0_s[b]" in posterior.rows
    assert np.ptp(posterior.of("t0_s[a]")) == 0.0
    data = posterior.problem.flat(posterior.draws[3])
    assert data[problem.layout.index("t0_s[a]")] == 2.0


@pytest.mark.parametrize(
    "call",
    [
        lambda problem, fit: bs.compare_bounds(problem, fit, methods=["crlb_ar1"]),
        lambda problem, fit: bs.cramer_rao(problem, fit.theta_hat, sigma=0.02),
        lambda problem, fit: bs.regress_delays(problem, fit),
        lambda problem, fit: bs.explain_tau(problem, fit.theta_hat),
        lambda problem, fit: bs.what_if(problem, fit.theta_hat),
        lambda problem, fit: bs.step_study(problem, fit.theta_hat, 0.02),
    ],
)
def test_what_does_not_carry_them_says_so(call) -> None:
    problem = held_problem({"tau_v": "0.3 s"})
    fit = bs.fit_least_squares(replace(problem, held={}), seed=1, swarms=1, euler=False)
    with pytest.raises(bs.CampaignError, match=r"parameters are held \(tau_v = 0.3 s\)"):
        call(problem, fit)
