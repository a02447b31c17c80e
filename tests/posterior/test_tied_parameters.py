"""Tied parameters in fit, posterior and bounds, beside problems that say the same without a tie."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy.optimize import least_squares

import bayes_sensor as bs
from bayes_sensor.campaign import Campaign
from bayes_sensor.likelihood.problem import Problem
from bayes_sensor.posterior import load_chains
from bayes_sensor.rig.ties import tie_parameters
from tests.support.other_rigs import CASES, Case, experiment


def _of_one_sensor(campaign: Campaign) -> Problem:
    """The records of several sensors of one lag as those of one sensor."""
    alone = tuple(replace(e, record="", sensor="") for e in campaign)
    one = replace(campaign, experiments=alone, ties=())
    return Problem(one, noise=bs.Noise(per_experiment=True))


@pytest.fixture(scope="module")
def pair() -> list[tuple[Problem, bs.Fit]]:
    """Of two sensors of one lag, and of the same records as those of one sensor, with fits."""
    # a record for each sensor: then one sensor in both is the same problem
    records = tuple(experiment(name, record=name, sensor=name) for name in "AB")
    rig = Campaign("two of one make", records, sensor_is="slower", stages=("valve", "sensor"))
    rig = tie_parameters(rig, {"tau[B]": "tau[A]"}, "tie")
    case = Case(rig, {"tau_s": 5.0, "tau_s[A]": 5.0, "tau_s[B]": 5.0, "tau_v_s": 0.7})
    tied = Problem(case.simulated())
    both = tied, _of_one_sensor(tied.campaign)
    return [(each, bs.fit_least_squares(each, seed=1, swarms=1, euler=False)) for each in both]


def test_the_fit_of_sensors_of_one_lag_is_that_of_one_sensor(
    pair: list[tuple[Problem, bs.Fit]],
) -> None:
    tied, alone = (fit for _, fit in pair)
    np.testing.assert_allclose(tied.theta_hat, alone.theta_hat, rtol=1e-9, atol=1e-9)
    assert tied.parameters["tau_s"] > tied.parameters["tau_v_s"]


@pytest.mark.slow
@pytest.mark.parametrize("sampler", ["independence", "hmc", "emcee"])
def test_the_posterior_of_sensors_of_one_lag_is_that_of_one_sensor(
    pair: list[tuple[Problem, bs.Fit]], sampler: str
) -> None:
    few = bs.Settings(n_chains=2, n_draws=200, max_draws=2000, target_ess=100.0)
    tied, alone = (
        bs.sample_posterior(problem, fit, seed=1, sampler=sampler, settings=few).draws
        for problem, fit in pair
    )
    # one density, one start and one seed: the same draws, but for rounding that chains make larger;
    # 100 draws tell a mean to .1 sd, a difference to .14, and an sd to 7 %
    for i, name in enumerate(pair[1][0].layout.names):
        assert abs(tied[:, i].mean() - alone[:, i].mean()) < 0.4 * alone[:, i].std(), name
        assert tied[:, i].std() == pytest.approx(alone[:, i].std(), rel=0.3), name


@pytest.mark.parametrize("which", ["sensors of lags in proportion", "equal stages"])
def test_the_fit_is_the_least_squares_of_what_is_shared(which: str) -> None:
    case = CASES[which]()
    problem = Problem(case.simulated())
    fit = bs.fit_least_squares(problem, seed=1, swarms=1)
    assert fit.converged
    free = replace(problem.campaign, ties=())
    others = Problem(free).layout
    n = problem.layout.n_mean

    def residuals(values: np.ndarray) -> np.ndarray:
        theta = problem.layout.nested(np.concatenate([values, fit.theta_hat[n:]]), noise=False)
        predicted = bs.predict(free, others.flat(theta))
        return np.concatenate([predicted[e.name] - e.values for e in free])

    best = fit.theta_hat[:n]
    scale = np.maximum(np.abs(best), 0.1)
    other = least_squares(residuals, best + 1e-3 * scale, x_scale=scale, xtol=1e-12, ftol=1e-14)
    assert fit.cost == pytest.approx(2.0 * other.cost, rel=1e-7)
    np.testing.assert_allclose(best, other.x, rtol=2e-3, atol=2e-4)
    for name, value in case.shared.items():
        assert fit.parameters[name] == pytest.approx(value, rel=0.1)


@pytest.mark.parametrize("which", ["sensors of lags in proportion", "equal stages"])
def test_the_bound_is_that_of_the_free_rig_along_the_tie(which: str) -> None:
    case = CASES[which]()
    tied, free = Problem(case.design), Problem(replace(case.design, ties=()))
    n, n_free = tied.layout.n_mean, free.layout.n_mean
    by_tied = np.zeros((n_free, n))  # d theta of the free rig / d theta of the tied one
    for name in free.layout.mean_names:
        source, factor = tied.layout.sources.get(name, (name, 1.0))
        by_tied[free.layout.index(name), tied.layout.index(source)] = factor
    vector = free.layout.flat(tied.layout.nested(case.theta))
    for noise in ("iid", "ar1"):
        sigma = 0.01 if noise == "iid" else None
        here = bs.cramer_rao(tied, case.theta, sigma, noise=noise)
        there = bs.cramer_rao(free, vector, sigma, noise=noise)
        # differences of the free rig have steps of their own
        expected = by_tied.T @ there.information @ by_tied
        scale = np.sqrt(np.outer(np.diag(expected), np.diag(expected)))
        np.testing.assert_allclose(here.information / scale, expected / scale, atol=1e-4)


def test_bounds_and_profile_follow_the_tie() -> None:
    problem = Problem(CASES["sensors of lags in proportion"]().simulated())
    fit = bs.fit_least_squares(problem, seed=1, swarms=1)
    methods = ["crlb_ar1", "profile", "jackknife_experiments"]
    found = bs.compare_bounds(problem, fit, methods=methods, seed=1)
    widths = {method: np.ptp(found[method].intervals["95"]["tau_s[A]"]) for method in methods}
    # many samples and a linear neighbourhood: both agree
    assert widths["profile"] == pytest.approx(widths["crlb_ar1"], rel=0.2)
    assert found["jackknife_experiments"].status == "ok" and widths["jackknife_experiments"] > 0.0
    # the three sensors' noise is alike, so a tie of two tells more than sensor A alone
    free = replace(problem, campaign=replace(problem.campaign, ties=()))
    alone = bs.cramer_rao(free, free.layout.flat(fit.parameters), 0.01)
    assert bs.cramer_rao(problem, fit.theta_hat, 0.01)["tau_s[A]"] < alone["tau_s[A]"]


def test_another_minimum_of_a_tie_is_tried() -> None:
    # equal sensors behind a common lag, tied as if one were slower: two minima, far apart
    data = CASES["sensors of one lag"]().simulated()
    wrong = bs.make_problem(replace(data, ties=()), tie={"tau[B]": "1.2 * tau[A]"})
    few, many = (bs.fit_least_squares(wrong, seed=1, swarms=n, euler=False) for n in (1, 4))
    assert few.cost == pytest.approx(many.cost, rel=1e-6)


@pytest.mark.slow
def test_draws_of_what_is_tied_are_saved_with_the_others(tmp_path: Path) -> None:
    problem = Problem(CASES["sensors of lags in proportion"]().simulated())
    fit = bs.fit_least_squares(problem, seed=1, swarms=1)
    posterior = bs.sample_posterior(problem, fit, seed=1, sampler="independence")
    np.testing.assert_allclose(posterior.of("tau_s[B]"), 2.5 * posterior.of("tau_s[A]"))
    np.testing.assert_array_equal(posterior.of("tau_filter_s"), posterior.of("tau_s[C]"))
    posterior.save(tmp_path / "posterior.nc")
    names, chains = load_chains(tmp_path / "posterior.nc")
    saved = chains[:, :, names.index("tau_s[B]")].ravel()
    np.testing.assert_allclose(saved, posterior.of("tau_s[B]"))
    rows = posterior.summary()
    for key in ("mean", "sd", "q2.5", "q97.5"):
        assert rows.loc["tau_s[B]", key] == pytest.approx(2.5 * rows.loc["tau_s[A]", key])
    assert rows.loc["tau_s[B]", "r_hat"] == rows.loc["tau_s[A]", "r_hat"]
    assert set(rows.index) == {name for name in names if not name.startswith("lag_")}
