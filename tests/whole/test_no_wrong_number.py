"""What was stated wrongly, converged and without a word: each kind on data made here.

Misfit, noise laws, scale and the odds of names have tests of their own (test_misfit,
test_residuals, test_scale_free, test_order).
"""

from __future__ import annotations

import re
from typing import Any

import numpy as np
import pytest

from bayes_sensor import compare_bounds, fit_least_squares, sample_posterior, simulate
from bayes_sensor.campaign import Campaign, CampaignError, Experiment, SideInformation
from bayes_sensor.posterior import Settings
from bayes_sensor.report import headline
from bayes_sensor.report.headline import chain_words, stated_set

FLOWS = (40.0, 75.0, 135.0)  # mL/s
QUICK = Settings(n_draws=400, target_ess=400)


def campaign(
    tau: float, tau_v: float, volume: float, flows: Any = FLOWS, interval: float = 0.02,
    duration: float = 40.0, seed: int = 1, **options: Any,
) -> Campaign:  # fmt: skip
    """Steps up after an eighth of the record and down after a half, noise of 1 % of the step."""
    t = interval * np.arange(round(duration / interval))
    on, off = duration / 8.0, duration / 2.0
    experiments = [
        Experiment(str(k + 1), t, None, 0.8 * q, 0.2 * q, interval, on, off)
        for k, q in enumerate(flows)
    ]
    design = Campaign("made here", tuple(experiments), **options)
    own = {"y0_V": 0.3, "beta_V": 1.5, "t0_s": on + 0.317, "tf_s": off + 0.291}
    theta = {
        "tau_s": tau, "tau_v_s": tau_v, "V_mL": volume, "phi": 0.5, "sigma0_V": 0.015,
        "sigma1_V": 0.0, "experiments": {e.name: own for e in experiments},
    }  # fmt: skip
    return simulate(design, theta, seed=seed)


def answered(data: Campaign, sampler: str = "independence") -> tuple[Any, Any, dict[str, Any]]:
    fit = fit_least_squares(data, seed=1, swarms=1, euler=False)
    posterior = sample_posterior(data, fit, seed=1, sampler=sampler, settings=QUICK)
    return fit, posterior, posterior.to_json()


def test_a_sensor_slower_than_the_valve_is_one_of_two_lags() -> None:
    fit, posterior, record = answered(campaign(2.0, 0.3, 30.0))
    assert fit.order == record["order"] == "undecided"
    assert [row["probability"] for row in record["assignments"]] == pytest.approx([0.5, 0.5])
    for row, true in zip(record["lags_s"], (0.3, 2.0), strict=True):
        assert row["q2.5"] < true < row["q97.5"]
    text = str(headline(record, None))
    assert text.startswith("tau is either") and text.count("(50 %)") == 2 and "2.0" in text
    bounds = compare_bounds(posterior.problem, fit, posterior, methods=["crlb_ar1", "posterior"])
    for method in bounds.to_json()["methods"].values():
        assert method["parameters"]["tau_s"] is method["parameters"]["tau_v_s"] is None
        for name, true in (("lag_fast_s", 0.3), ("lag_slow_s", 2.0)):
            row = method["parameters"][name]
            assert row["lo997"] < true < row["hi997"]
    assert record["chain"]["1"]["t63_s"]["q50"] > record["chain"]["3"]["t63_s"]["q50"]
    assert chain_words(record).startswith("the whole chain")


def test_the_valve_measured_beside_it_decides_and_sensor_is_says_it() -> None:
    known = {"tau_v_s": SideInformation(0.3, 0.05)}
    for options, order in (
        ({"side_information": known}, "decided"),
        ({"sensor_is": "slower"}, "given"),
    ):
        fit, posterior, record = answered(campaign(2.0, 0.3, 30.0, **options))
        assert fit.order == record["order"] == order and not fit.caveats
        low, high = posterior.quantiles("tau_s", [0.005, 0.995])
        assert low < 2.0 < high and low > 1.5
        assert re.match(r"tau = (1\.9|2\.0)\d* s", str(headline(record, None)))
        assert fit.parameters["tau_v_s"] == pytest.approx(0.3, abs=0.05)


@pytest.mark.slow
def test_one_lag_and_nothing_else_is_one_lag() -> None:
    data = campaign(20.0, 1e-3, 1e-2, flows=(25.0,), interval=1.0, duration=500.0, seed=2)
    fit, _, record = answered(data, "emcee")
    text = str(headline(record, None))
    assert text.startswith("one lag of ") and "any other is shorter than" in text
    slow = record["lags_s"][-1]
    assert slow["q2.5"] < 20.0 < slow["q97.5"] and len(fit.unseen) == 2
    # what the search ended at is nowhere a value
    assert all(fit.estimates()[name] is None for name in ("lag_fast_s", "lag_between_s"))
    assert "too short" in repr(fit) or "too small" in repr(fit)


def test_a_volume_that_the_data_contradict_is_said_first_and_left_out() -> None:
    known = {"V_mL": SideInformation(60.0, 0.5)}
    data = campaign(0.3, 1.0, 40.0, sensor_is="faster", side_information=known)
    fit, posterior, record = answered(data)
    (sentence,) = fit.caveats
    assert "60 +- 0.5 mL is given" in sentence and "joint standard deviations" in sentence
    assert record["caveats"] == [sentence] and record["warnings"][0] == sentence
    low, high = posterior.quantiles("V_mL", [0.005, 0.995])
    assert low < 40.0 < high < 50.0  # not an average of both
    bounds = compare_bounds(data, fit, posterior, methods=["crlb_ar1"])
    assert bounds.to_json()["warnings"][0] == sentence
    right = {"V_mL": SideInformation(40.5, 1.0)}
    agreed = campaign(0.3, 1.0, 40.0, sensor_is="faster", side_information=right)
    assert not fit_least_squares(agreed, seed=1, swarms=1, euler=False).caveats


def test_a_chamber_that_is_not_swept_as_it_should_is_said() -> None:
    known = {"V_mL": SideInformation(1500.0, 10.0)}  # V/Q 60 s; the record has one lag of 35 s
    data = campaign(
        1e-3, 1e-3, 25.0 * 35.0, flows=(25.0,), interval=1.0, duration=900.0,
        side_information=known,
    )  # fmt: skip
    fit = fit_least_squares(data, seed=1, swarms=1, euler=False)
    (sentence,) = fit.caveats
    assert "V/Q 60 s expected" in sentence and re.search(r"a lag of 3[45]\.\d* s seen", sentence)


def test_what_suits_the_other_lag_is_said_to() -> None:
    known = {"tau_s": SideInformation(0.3, 0.02)}
    data = campaign(2.0, 0.3, 30.0, sensor_is="slower", side_information=known)
    (sentence,) = fit_least_squares(data, seed=1, swarms=1, euler=False).caveats
    assert "it suits the other lag" in sentence and "is sensor_is right?" in sentence
    both = {**known, "tau_v_s": SideInformation(2.0, 0.1)}
    with pytest.raises(CampaignError, match="expected both to agree"):
        campaign(2.0, 0.3, 30.0, sensor_is="slower", side_information=both)


def test_a_response_within_one_sample_is_an_upper_limit() -> None:
    data = campaign(0.05, 0.08, 2.0, flows=(40.0, 80.0), interval=1.0, duration=160.0)
    fit = fit_least_squares(data, seed=1, swarms=1, euler=False)
    assert fit.hidden_by_sampling == 1.0
    assert any("within one sampling interval (1 s)" in text for text in fit.caveats)
    slow = campaign(2.0, 0.3, 30.0)
    assert fit_least_squares(slow, seed=1, swarms=1, euler=False).hidden_by_sampling is None
    record = {"hidden_by_sampling_s": 1.0, "lags_s": [{"q95": 9.0}], "parameters": {}}
    text = str(headline(record, None))
    assert "an upper limit only" in text and "longer than" in text and "455 ms" in text
    assert stated_set(record) == [(0.0, 1.0 / 2.2)]


def test_bounds_survive_what_is_too_small_to_be_seen() -> None:
    data = campaign(2.0, 1e-3, 1e-2, sensor_is="slower")
    fit = fit_least_squares(data, seed=1, swarms=1, euler=False)
    assert fit.unseen
    bounds = compare_bounds(data, fit, methods=["crlb_iid", "sandwich"])
    for bound in bounds.methods.values():
        low, high = bound.interval("tau_s", "997")
        assert low < 2.0 < high < 2.2


@pytest.mark.parametrize("third", [False, True])
def test_lags_that_may_be_equal_are_stated_together(third: bool) -> None:
    lags = [{"q2.5": 1.6, "q50": 1.85, "q95": 1.98, "q97.5": 2.0},
            {"q2.5": 2.0, "q50": 2.15, "q95": 2.3, "q97.5": 2.33}]  # fmt: skip
    if third:  # one that is told apart from both
        lags.insert(0, {"q2.5": 0.9, "q50": 1.0, "q95": 1.09, "q97.5": 1.1})
    rows = [{"lag": i, "probability": 1.0 / len(lags)} for i in range(len(lags))]
    record = {"order": "undecided", "lags_s": lags, "assignments": rows, "parameters": {}}
    text, stated = str(headline(record, None)), stated_set(record)
    if third:
        assert text.startswith("tau is either 1.00 s") and text.count("(33 %)") == 3
        assert len(stated) == 3
    else:
        assert "may be equal, all in [1.60, 2.33] s" in text and stated == [(1.6, 2.33)]
