"""Where it is not known which lag is the sensor's, no door says one name alone."""

from dataclasses import replace

import matplotlib.pyplot as plt
import numpy as np
import pytest

import bayes_sensor as bs
from tests.support.campaigns import small_problem

pytestmark = pytest.mark.slow


@pytest.fixture(scope="module", params=["two flows", "one flow"])
def result(request: pytest.FixtureRequest) -> bs.Analysis:
    problem, _ = small_problem(n=2, interval=0.02)
    experiments = problem.campaign.experiments
    if request.param == "one flow":  # V/Q is a third lag then
        first = experiments[0]
        flows = {"carrier_flow": first.carrier_flow, "test_gas_flow": first.test_gas_flow}
        design = replace(problem.campaign, experiments=(first, replace(experiments[1], **flows)))
        theta = problem.layout.nested(problem.flat(_theta(problem)))
        experiments = bs.simulate(design, theta, seed=2).experiments
    campaign = bs.Campaign("order unknown", experiments)
    problem = bs.Problem(campaign)
    fit = bs.fit_least_squares(problem, seed=1, swarms=1, euler=False)
    posterior = bs.sample_posterior(problem, fit, seed=1)
    bounds = bs.compare_bounds(problem, fit, posterior, ["crlb_ar1", "posterior"])
    return bs.Analysis(problem, fit, posterior, bounds, bounds_json=bounds.to_json())


def _theta(problem: bs.Problem) -> np.ndarray:
    return bs.fit_least_squares(problem, seed=1, swarms=1, euler=False).theta_hat


def test_the_summary_names_lags_by_size(result: bs.Analysis) -> None:
    text = result.summary()
    parameters = text.split("[[Parameters]]")[1].split("[[")[0]
    assert "lag_fast:" in parameters and "lag_slow:" in parameters
    assert " tau:" not in parameters and " tau_v:" not in parameters
    assert "tau =" not in text.split("[[Answer]]")[1].splitlines()[1]
    assert "lag_fast_s" in text.split("[[Bounds of tau]]")[1]


def test_figures_and_arviz_have_them_too(result: bs.Analysis) -> None:
    result.plot.corner()
    labels = [ax.get_xlabel() for ax in result.plot.intervals().axes]
    assert "shorter lag (s)" in labels and not any("sensor" in label for label in labels)
    figure, ax = plt.subplots()
    assert result.plot.intervals(ax=ax) is ax
    plt.close(figure)
    data = result.to_arviz(most_draws=40)
    group = data["posterior"]
    assert {"lag_fast", "lag_slow", "tau", "tau_v"} <= set(group.data_vars)
    assert (group["lag_fast"].values <= group["lag_slow"].values).all()
    prior = data["prior"]
    # either lag may be the sensor's, with equal prior odds
    share = float(np.mean(prior["tau"].values == prior["lag_fast"].values))
    n_lags = 3 if "lag_between" in group else 2
    assert abs(share - 1.0 / n_lags) < 4.0 * np.sqrt(0.25 / prior["tau"].size)
