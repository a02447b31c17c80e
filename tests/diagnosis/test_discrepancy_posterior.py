"""tau with a smooth discrepancy in the model: draws against the evidences' own percentiles."""

from __future__ import annotations

import numpy as np
import pytest

import bayes_sensor as bs
from bayes_sensor.campaign import Campaign, CampaignError
from bayes_sensor.diagnosis import diagnose_gap
from bayes_sensor.diagnosis.discrepancy_posterior import with_discrepancy
from bayes_sensor.diagnosis.how_far_words import how_far_lines
from tests.support.planted_effects import measured


@pytest.fixture(scope="module")
def coupled() -> Campaign:
    """A valve that couples into the signal for a moment at both commands."""
    campaign = measured({}, seed=4)
    values = {}
    for e in campaign:
        since = [e.t - e.commanded_on, e.t - e.commanded_off]
        pulse = sum(np.where(s > 0, np.exp(-np.maximum(s, 0) / 0.4), 0.0) for s in since)
        values[e.name] = e.values + 0.06 * pulse
    return campaign.with_data(values)


@pytest.mark.slow
def test_draws_and_evidences_tell_the_same_of_tau(coupled: Campaign) -> None:
    fit = bs.fit_least_squares(coupled, seed=1, euler=False, swarms=1)
    plain = bs.sample_posterior(coupled, fit, seed=1, sampler="independence")
    wide = with_discrepancy(plain, fit, seed=1)
    gap = diagnose_gap(coupled, fit, bootstrap=0, separate=False, hidden=False, follow=False)
    said = gap.to_json()["tau_with_discrepancy_s"]
    low, middle, high = wide.quantiles("tau_s", [0.025, 0.5, 0.975])
    # two routes: draws of discrepancies that move those of the parameters, and Laplace's integral
    assert middle == pytest.approx(said["q50"], rel=0.15)
    assert high == pytest.approx(said["q97.5"], rel=0.15)
    was_low, was_high = plain.quantiles("tau_s", [0.025, 0.975])
    assert high - low > 1.2 * (was_high - was_low)
    assert low < 0.06 < high
    # what is well known stays known, and the draws are those of a posterior
    assert wide.mean("V_mL") == pytest.approx(plain.mean("V_mL"), rel=0.02)
    assert wide.chains.shape == plain.chains.shape and np.all(wide.draws[:, 0] <= wide.draws[:, 1])
    assert wide.to_json()["parameters"]["tau_s"]["q50"] == pytest.approx(middle)
    assert any("discrepancy" in text for text in wide.warnings)
    # after an unlisted verdict the terminal states that interval
    assert gap.verdict.kind == "unlisted"
    closed, tau = how_far_lines(gap.to_json())
    assert closed.startswith("closed: ") and "with a discrepancy in the model" in tau
    again = with_discrepancy(plain, fit, seed=1)
    assert np.array_equal(again.chains, wide.chains)


@pytest.mark.slow
def test_where_nothing_is_missing_no_line_is_said() -> None:
    gap = diagnose_gap(measured({}, seed=1), bootstrap=0, separate=False, hidden=False)
    assert how_far_lines(gap.to_json()) == []
    said = gap.to_json()["tau_with_discrepancy_s"]
    assert said["q2.5"] < 0.06 < said["q97.5"]


@pytest.mark.slow
def test_one_flow_is_refused() -> None:
    campaign = measured({}, seed=1, n=1)
    fit = bs.fit_least_squares(campaign, seed=1, euler=False, swarms=1)
    posterior = bs.sample_posterior(campaign, fit, seed=1, sampler="independence")
    with pytest.raises(CampaignError, match="expected two flows or more"):
        with_discrepancy(posterior, fit)
