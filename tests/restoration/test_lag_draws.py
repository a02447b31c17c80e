"""Where lags come from, and when they restore nothing."""

from types import SimpleNamespace

import numpy as np
import pytest

from bayes_sensor.campaign import CampaignError
from bayes_sensor.likelihood.problem import Problem
from bayes_sensor.restoration.lag_draws import LagDraws, posterior_lags, stated_lags
from bayes_sensor.rig.layout import Layout
from tests.support.other_rigs import CASES


def test_stated_lags_are_positive_with_the_mean_and_spread_that_were_given() -> None:
    found = stated_lags(["40 +- 10 min", "30 s"]).draws
    assert found.shape == (4096, 2) and (found > 0).all()
    # standard errors of 4096 draws: 0.4 % of the mean, 2 % of the spread (skewed)
    assert found[:, 0].mean() == pytest.approx(2400.0, rel=0.015)
    assert found[:, 0].std() == pytest.approx(600.0, rel=0.06)
    assert (found[:, 1] == 30.0).all()


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("< 5 min", "upper limit"),
        ("5 +- 3 min", "upper limit"),
        ("40", "without one"),
        ("40 +- 2", "without one"),
        ("-3 s", "positive"),
        ("40 +- 2 mL", "mL"),
    ],
)
def test_a_lag_that_cannot_be_used_is_refused_with_the_reason(text: str, words: str) -> None:
    with pytest.raises(CampaignError, match=words):
        stated_lags(text)


def test_an_upper_limit_restores_nothing_but_a_short_lag_beside_a_long_one_may_be_zero() -> None:
    rng = np.random.default_rng(1)
    short = np.abs(rng.normal(0.0, 1.0, 500))
    with pytest.raises(CampaignError, match="an upper limit restores nothing"):
        LagDraws(short[:, None], "here")
    both = LagDraws(np.column_stack([short, rng.normal(50.0, 1.0, 500)]), "here")
    assert (both.spread_out(20) > 0).all()


def test_spread_out_draws_keep_the_law_of_the_longest_lag() -> None:
    lags = LagDraws(np.random.default_rng(2).normal(50.0, 4.0, (4000, 1)), "here")
    few = lags.spread_out(40)[:, 0]
    assert few.mean() == pytest.approx(lags.draws.mean(), abs=0.2)
    assert few.std() == pytest.approx(lags.draws.std(), rel=0.1)


def test_lags_of_a_posterior_by_place_and_flow() -> None:
    rng = np.random.default_rng(3)
    lags = np.sort(rng.normal([1.0, 9.0], 0.1, (300, 2)), axis=1)
    volume = rng.normal(60.0, 1.0, 300)
    posterior = SimpleNamespace(
        lags=lags,
        of=lambda name: {"tau_s": lags[:, 0], "V_mL": volume}[name],
        naming=SimpleNamespace(order="undecided"),
        problem=SimpleNamespace(
            flow=None,
            layout=Layout(("1",), (True,)),
            commuting=SimpleNamespace(names=("tau_s", "tau_v_s")),
        ),
    )
    whole = posterior_lags(SimpleNamespace(posterior=posterior))
    np.testing.assert_array_equal(whole.draws, lags)
    assert "makes no difference" in whole.remarks[0]
    np.testing.assert_allclose(posterior_lags(posterior, flow=30.0).draws[:, 2], volume / 30.0)
    sensor = posterior_lags(posterior, at="sensor")
    np.testing.assert_array_equal(sensor.draws[:, 0], lags[:, 0])
    assert "undecided" in sensor.remarks[0]
    posterior.problem.commuting.names = ("tau_s", "tau_v_s", "V_mL")
    posterior.problem.flow = 75.0  # all experiments at one flow: V/Q is one of the lags
    np.testing.assert_array_equal(posterior_lags(posterior, flow=75.0).draws, lags)
    with pytest.raises(CampaignError, match="which lag changes with the flow"):
        posterior_lags(posterior, flow=30.0)
    with pytest.raises(CampaignError, match="'rig' or 'sensor'"):
        posterior_lags(posterior, at="valve")


def _posterior(which: str) -> SimpleNamespace:
    """Draws at the truth of a case, lags by size."""
    case = CASES[which]()
    problem = Problem(case.design)
    layout, theta = problem.layout, problem.by_size(case.theta)
    return SimpleNamespace(
        lags=np.tile(problem.commuting.lags(theta), (10, 1)),
        of=lambda name: np.full(10, case.theta[layout.index(name)]),
        naming=problem.naming(),
        problem=problem,
    )


@pytest.mark.parametrize(
    ("which", "sensor", "flow", "lags"),
    [
        ("two sensors", "A", None, [0.7, 2.0]),
        ("two sensors", "B", None, [0.7, 9.0]),
        ("sensors of one lag", "B", None, [0.7, 5.0]),
        ("sensors of lags in proportion", "B", 80.0, [0.75, 1.2, 7.5]),
        ("equal stages", None, None, [0.9, 0.9, 6.0]),
        ("equal stages", None, 100.0, [0.8, 0.8, 0.9, 0.9, 6.0]),
        ("four stages", None, 200.0, [0.7, 0.75, 2.0, 6.0]),
    ],
)
def test_the_chain_of_one_sensor_has_all_its_stages(
    which: str, sensor: str | None, flow: float | None, lags: list[float]
) -> None:
    posterior = _posterior(which)
    found = posterior_lags(posterior, flow=flow, sensor=sensor).draws
    np.testing.assert_allclose(np.sort(found[0]), lags)
    if sensor is not None:
        own = posterior_lags(posterior, "sensor", sensor=sensor).draws[0]
        np.testing.assert_allclose(own, [lags[-1]])


def test_a_sensor_that_is_not_said_or_not_there_is_refused() -> None:
    with pytest.raises(CampaignError, match=r"2 sensors \(A, B\).*give --sensor A"):
        posterior_lags(_posterior("two sensors"))
    with pytest.raises(CampaignError, match="got 'C'; those are A, B"):
        posterior_lags(_posterior("two sensors"), sensor="C")
    with pytest.raises(CampaignError, match="it has one sensor, without a name"):
        posterior_lags(_posterior("equal stages"), sensor="A")


def test_a_misfit_of_the_step_experiments_is_told() -> None:
    posterior = SimpleNamespace(**vars(_posterior("equal stages")), caveats=("The fit misses.",))
    assert "The fit misses." in posterior_lags(posterior).doubts[0]
