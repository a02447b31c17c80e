"""Arguments of public functions: what is accepted in several forms, and what slips are told."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pandas as pd
import pytest

import bayes_sensor as bs
from tests.support.other_rigs import CASES

PROBE = CASES["sensor"]().simulated().without("2")
QUICK = {"n_draws": 60, "target_ess": 60.0}


@pytest.fixture(scope="module")
def fit() -> bs.Fit:
    """Of a probe in one record."""
    return bs.fit_least_squares(PROBE, swarms=1, euler=False)


TAKERS: dict[str, Callable[[Any], Any]] = {
    "fit_least_squares": bs.fit_least_squares,
    "sample_posterior": bs.sample_posterior,
    "diagnose_gap": bs.diagnose_gap,
    "compare_bounds": bs.compare_bounds,
    "regress_delays": lambda c: bs.regress_delays(c, None),
    "diagnose_residuals": lambda c: bs.diagnose_residuals(c, None),
    "simulate": lambda c: bs.simulate(c, {}),
    "predict": lambda c: bs.predict(c, {}),
    "log_likelihood": lambda c: bs.log_likelihood(c, {}),
    "log_prior": lambda c: bs.log_prior(c, {}),
    "compress": lambda c: bs.compress(c, {}),
    "cramer_rao": lambda c: bs.cramer_rao(c, {}),
    "explain_tau": lambda c: bs.explain_tau(c, {}),
    "step_study": lambda c: bs.step_study(c, {}),
    "what_if": lambda c: bs.what_if(c, {}),
    "make_problem": bs.make_problem,
    "check_campaign": bs.check_campaign,
    "Layout.of": bs.Layout.of,
}
"""public functions of a campaign"""


@pytest.mark.parametrize("name", TAKERS)
@pytest.mark.parametrize("given", ["campaign.toml", pd.DataFrame({"t": [0.0, 1.0]}), None])
def test_what_is_no_campaign_is_told_how_to_become_one(name: str, given: Any) -> None:
    with pytest.raises(
        bs.CampaignError, match=r"campaign: expected a Campaign.*, but got a \w+; re"
    ):
        TAKERS[name](given)


def test_a_fit_is_taken_wherever_theta_is(fit: bs.Fit) -> None:
    theta = fit.theta_hat
    np.testing.assert_array_equal(bs.predict(PROBE, fit)["1"], bs.predict(PROBE, theta)["1"])
    np.testing.assert_array_equal(bs.simulate(PROBE, fit)["1"].y, bs.simulate(PROBE, theta)["1"].y)
    assert bs.cramer_rao(PROBE, fit)["tau_s"] == bs.cramer_rao(PROBE, theta)["tau_s"]
    assert bs.log_likelihood(PROBE, fit) == bs.log_likelihood(PROBE, theta)
    two = CASES["sensor"]().simulated()
    with pytest.raises(bs.CampaignError, match="theta has shape"):
        bs.predict(two, fit)


@pytest.mark.parametrize(
    ("theta", "message"),
    [
        ("x", "theta: expected a Fit, a mapping by name .* but got a str"),
        (None, "theta: expected a Fit, a mapping by name .* but got a NoneType"),
        ({"tau_s": "3 s"}, "theta: tau_s: expected a number in s, but got '3 s'"),
        ({"phi": [0.1]}, r"theta: phi: expected a number, but got '\[0.1\]'"),
        ({"experiments": {"1": 3.0}}, "experiments: expected a mapping of values for each"),
    ],
)
def test_what_is_no_theta_is_one_sentence(fit: bs.Fit, theta: Any, message: str) -> None:
    given = {**fit.parameters, **theta} if isinstance(theta, dict) else theta
    with pytest.raises(bs.CampaignError, match=message):
        bs.simulate(PROBE, given)


def test_settings_of_the_sampler_may_be_a_mapping(fit: bs.Fit) -> None:
    common = {"fit": fit, "sampler": "independence"}
    by_name = bs.sample_posterior(PROBE, settings=QUICK, **common)
    record = bs.sample_posterior(PROBE, settings=bs.Settings(**QUICK), **common)
    np.testing.assert_array_equal(by_name.chains, record.chains)


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        ({"n_draw": 100}, "settings: no option 'n_draw' of Settings; did you mean 'n_draws'"),
        ({"zz": 100}, "no option 'zz' of Settings; known are n_chains, "),
        ({"n_draws": "100"}, "settings: n_draws: expected a whole number, but got '100'"),
        ({"n_draws": True}, "settings: n_draws: expected a whole number, but got 'True'"),
        (3, "settings: expected a Settings or a mapping of its options, but got a int"),
    ],
)
def test_slips_in_settings(fit: bs.Fit, settings: Any, message: str) -> None:
    with pytest.raises(bs.CampaignError, match=message):
        bs.sample_posterior(PROBE, fit, settings=settings)


def test_bounds_take_one_method_and_make_the_fit_where_there_is_none() -> None:
    bounds = bs.compare_bounds(PROBE, methods="crlb_iid")
    assert list(bounds.methods) == ["crlb_iid"]
    with pytest.raises(bs.CampaignError, match="no bound method 'crlb'; there are crlb_iid"):
        bs.compare_bounds(PROBE, methods="crlb")
    with pytest.raises(bs.CampaignError, match="compare_bounds: expected the Fit of this campaign"):
        bs.compare_bounds(PROBE, {"tau_s": 1.0})  # type: ignore[arg-type]


def test_what_is_no_effect_stops_a_diagnosis_before_it_begins(fit: bs.Fit) -> None:
    def drift(t: Any, strength: Any, rig: Any) -> Any:
        return rig.mean(t) + strength["slope"] * (t - rig.t0)

    with pytest.raises(bs.CampaignError, match="gap: effects: expected .* but got a function"):
        bs.diagnose_gap(PROBE, fit, effects=[drift])
    with pytest.raises(bs.CampaignError, match="gap: effects: expected .* but got a function"):
        bs.diagnose_gap(PROBE, fit, effects={"drift": drift})
    with pytest.raises(bs.CampaignError, match="analyze: effects: expected .* got a function"):
        bs.analyze(PROBE, effects=drift)
    from bayes_sensor.diagnosis import CATALOGUE, Strength

    with pytest.raises(bs.CampaignError, match="an effect 'flow_error' is already in the catalo"):
        bs.diagnose_gap(PROBE, fit, effects=CATALOGUE["flow_error"])
    own = bs.own_effect("sink", [Strength("slope", "V/s", "normal", 0.0, 1e-3)], drift,
                        plausible={})  # fmt: skip
    quick = {"bootstrap": 0, "hidden": False, "separate": False, "follow": False}
    gap = bs.diagnose_gap(PROBE, fit, effects=own, **quick)
    assert "sink" in {row["effect"] for row in gap.to_json()["which"]}


@pytest.mark.parametrize(
    ("given", "message"),
    [
        ({"sampler": "nuts"}, "analyze: sampler: expected 'emcee', 'independence' or 'hmc', but"),
        ({"settings": {"n_chains": 1}}, "analyze: settings: n_chains: expected greater"),
        ({"noise": {"varience": "signal"}}, r"\[noise\] unknown key 'varience'; .*\"variance\""),
        ({"priors": {"tau": "normal(4, 1)"}}, r"tau: expected a time .* \"normal\(4 ms, 1 ms\)\"$"),
        ({"priors": {"Z": "flat"}}, "unknown parameter 'Z'; known are beta, phi, sigma0, sigma1"),
        ({"fix": {"t0": "20"}}, r"\[fix\] t0: expected .* that is meant, as in t0 = \"20 ms\"$"),
    ],
)  # fmt: skip
def test_slips_in_analyze_are_named_as_python_has_them(given: Any, message: str) -> None:
    with pytest.raises(bs.CampaignError, match=message):
        bs.analyze(PROBE, **given)


def test_parameters_are_given_by_name() -> None:
    expected = "expected a mapping by the names of parameters, but got a str"
    with pytest.raises(bs.CampaignError, match=rf"make_problem: \[priors\]: {expected}"):
        bs.make_problem(PROBE, "flat")  # type: ignore[arg-type]
    with pytest.raises(bs.CampaignError, match=rf"make_problem: \[fix\]: {expected}"):
        bs.make_problem(PROBE, fix="3 s")  # type: ignore[arg-type]
    with pytest.raises(bs.CampaignError, match=f"^bounds: {expected}"):
        bs.fit_least_squares(PROBE, bounds="3 s")  # type: ignore[arg-type]
    with pytest.raises(bs.CampaignError, match=r"^with_effect: no effect 'gain' in the catalogue"):
        bs.sample_posterior(PROBE, with_effect="gain")


def test_an_unknown_option_of_the_noise_law_is_named() -> None:
    with pytest.raises(
        bs.CampaignError, match="noise: no option 'varience' of Noise; did you mean"
    ):
        bs.make_problem(PROBE, noise={"varience": "signal"})


def test_unknown_names_of_a_bound_list_the_known_ones(fit: bs.Fit) -> None:
    bound = bs.compare_bounds(PROBE, fit, methods="crlb_iid")["crlb_iid"]
    with pytest.raises(KeyError, match=r"no parameter 'tau'; there are tau_s, y0_V\[1\]"):
        bound.interval("tau")
    with pytest.raises(KeyError, match=r"no parameter 'tau'; there are tau_s"):
        bound.row("tau")
    with pytest.raises(KeyError, match="no level '90'; there are 68, 95, 997"):
        bound.interval("tau_s", "90")
    with pytest.raises(KeyError, match=r"no parameter 'tau'; there are tau_s, y0_V\[1\]"):
        bs.cramer_rao(PROBE, fit)["tau"]


def test_unknown_names_in_theta_list_those_that_the_rig_has() -> None:
    case = CASES["staircase"]()
    theta = bs.Layout.of(case.design).nested(case.theta)
    with pytest.raises(bs.CampaignError, match="known are tau_s, y0_V, beta_V, t1_s, t2_s, t3_s,"):
        bs.predict(case.design, {**theta, "zzz": 1.0})


def test_lags_to_be_restored_are_called_by_their_argument() -> None:
    record = np.arange(100.0), np.arange(100.0)
    with pytest.raises(bs.CampaignError, match=r'^lags: .* write for example lags = "40 min"$'):
        bs.restore("40 mL", record)
    with pytest.raises(bs.CampaignError, match=r'^lags: .*; write for example lags = "40 min"$'):
        bs.restore("40 +- 2 mL", record)
