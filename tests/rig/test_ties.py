"""Tied lags and volumes: what texts say, and one message for each mistake."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

import bayes_sensor as bs
from bayes_sensor.campaign import Tie
from bayes_sensor.io.writers import campaign_text
from bayes_sensor.likelihood.problem import Problem
from bayes_sensor.rig.ties import read_ties, tie_parameters, tie_texts
from tests.support.other_rigs import CASES, experiment

NAMES = ("tau_s[A]", "tau_s[B]", "tau_s[C]", "tau_v_s", "V_mL")


def test_ties_follow_one_another_to_the_first_that_stays() -> None:
    found = read_ties({"tau[C]": "2 * tau_s[B]", "tau_s[A]": " 0.5*tau[C] "}, NAMES, "tie")
    assert found == (Tie("tau_s[B]", "tau_s[A]", 1.0), Tie("tau_s[C]", "tau_s[A]", 2.0))
    texts = {"tau[B]": "tau[A]", "tau[C]": "2.0 * tau[A]"}
    assert tie_texts(found) == texts and read_ties(texts, NAMES, "tie") == found
    sensor_first = read_ties({"tau": "4 * tau_v"}, ("tau_s", "tau_v_s"), "tie")
    assert sensor_first == (Tie("tau_v_s", "tau_s", 0.25),)


@pytest.mark.parametrize(
    ("tie", "message"),
    [
        ({"tau[D]": "tau[A]"}, r"expected a lag or a volume of the rig \(tau\[A\], .* 'tau\[D\]'"),
        (
            {"tau[B]": "tau[D]"},
            r"but got 'tau\[D\]'; write for example \"tau\[B\]\" = \"tau\[A\]\"",
        ),
        ({"delay[1]": "tau[A]"}, "expected a lag or a volume"),
        ({"t0[1]": "t0[2]"}, "expected a lag or a volume"),
        ({"phi[B]": "phi[A]"}, "expected a lag or a volume"),
        ({"V": "tau_v"}, "expected a parameter in mL, but tau_v is in s"),
        ({"tau[B]": "0 * tau[A]"}, "expected a positive factor, but got '0'"),
        ({"tau[B]": "1e999 * tau[A]"}, "expected a positive factor"),
        ({"tau[B]": ""}, "but got nothing"),
        ({"tau[B]": "tau[A] * 2"}, r"but got 'tau\[A\] \* 2'"),
        ({"tau[B]": "tau[A]", "tau[A]": "tau[B]"}, r"circle \(tau\[A\], tau\[B\]\)"),
        ({"tau_v": "2 * tau_v"}, "circle"),
        ({"tau[B]": "tau[A]", "tau_s[B]": "tau[C]"}, "tied twice"),
    ],
)
def test_mistakes_have_one_message(tie: dict[str, Any], message: str) -> None:
    with pytest.raises(bs.CampaignError, match=message):
        read_ties(tie, NAMES, "tie")


def test_what_is_tied_is_not_held_and_has_no_prior() -> None:
    data = CASES["sensors of lags in proportion"]().design
    for settings in ({"fix": {"tau_filter": "1 s"}}, {"priors": {"tau[B]": "half-normal(5 s)"}}):
        with pytest.raises(bs.CampaignError, match="it is tied to tau_s.*expected a parameter tha"):
            bs.make_problem(data, **settings)
    alike = replace(data, stages=("filter", "probe: lag", "sensor"), ties=())
    held = bs.make_problem(alike, fix={"tau_filter": "1 s"}, tie={"tau_probe": "tau_filter"})
    assert held.layout.tied_values(held.flat(np.ones(len(held.layout)))) == {"tau_probe_s": 1.0}


def test_side_information_on_what_is_tied_is_of_what_stays() -> None:
    case = CASES["sensors of lags in proportion"]()
    known = {"tau_s[B]": bs.SideInformation(7.5, 0.5)}
    problem = Problem(replace(case.design, side_information=known))
    law = problem.priors["tau_s[A]"]
    assert (law.kind, law.a, law.b) == ("normal", 3.0, 0.2)
    both = {**known, "tau_s[A]": bs.SideInformation(3.0, 0.1)}
    with pytest.raises(bs.CampaignError, match="expected one of them"):
        Problem(replace(case.design, side_information=both)).named_laws  # noqa: B018


@pytest.mark.parametrize(
    ("stages", "tie", "fine"),
    [
        (("filter", "probe: lag", "sensor"), {"tau_probe": "tau_filter"}, True),
        (("filter", "probe: lag", "sensor"), {"tau_probe": "2 * tau_filter"}, False),
        (("filter", "sensor"), {"tau_filter": "0.2 * tau"}, True),
        (("filter", "valve", "probe: lag", "sensor"), {"tau": "tau_v", "tau_probe": "tau_filter"},
         False),
        # at one flow a volume is one more lag
        (("filter", "cell", "sensor"), {"tau_filter": "0.2 * tau"}, False),
    ],
)  # fmt: skip
def test_ties_that_leave_values_to_be_exchanged_are_refused(
    stages: tuple[str, ...], tie: dict[str, str], fine: bool
) -> None:
    campaign = bs.Campaign("one chain", (experiment("1", 50.0),), stages=stages)
    if fine:
        tied = Problem(tie_parameters(campaign, tie, "tie"))
        assert len(tied.layout.shared_names) < len(stages)
        return
    with pytest.raises(bs.CampaignError, match="may be exchanged without a change of the respons"):
        tie_parameters(campaign, tie, "tie")


def test_a_theta_that_breaks_a_tie_is_refused() -> None:
    case = CASES["equal stages"]()
    layout = Problem(case.design).layout
    nested = layout.nested(case.theta)
    assert nested["V_line_mL"] == 80.0 and nested["tau_probe_s"] == 0.9
    np.testing.assert_array_equal(layout.flat(nested), case.theta)
    with pytest.raises(bs.CampaignError, match="V_line_mL is 81, but it is tied"):
        layout.flat({**nested, "V_line_mL": 81.0})


def test_sensors_of_one_lag_have_one_tau_and_lags_that_commute() -> None:
    problem = Problem(CASES["sensors of one lag"]().design)
    assert problem.layout.shared_names == ("tau_s", "tau_v_s")
    assert problem.commuting.names == ("tau_s", "tau_v_s")
    # sensors of other lags tell these from those that they share
    assert Problem(CASES["sensors of lags in proportion"]().design).commuting.names == (
        "V_cell_mL",
    )
    # a lag that is there twice is told from the one that is there once
    assert Problem(CASES["equal stages"]().design).commuting.names == ("tau_s",)


def test_a_part_of_the_campaign_keeps_the_names() -> None:
    # as where experiments are left out one by one
    for which in ("sensors of one lag", "sensors of lags in proportion"):
        whole = CASES[which]().design
        names = Problem(whole).layout.names
        for e in whole:
            assert set(Problem(replace(whole, experiments=(e,))).layout.names) <= set(names)


def test_ties_are_written_as_they_are_read() -> None:
    for which in ("sensors of one lag", "sensors of lags in proportion", "equal stages"):
        campaign = CASES[which]().design
        untied = replace(campaign, ties=())
        assert tie_parameters(untied, tie_texts(campaign.ties), "tie").ties == campaign.ties
        assert campaign_text(campaign, {}).count("tie = {") == 1
