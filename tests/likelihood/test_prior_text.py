"""Priors and held values as a user writes them."""

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy import stats

import bayes_sensor as bs
from bayes_sensor.analysis.overrides import make_problem, read_overrides
from bayes_sensor.likelihood.prior_text import prior_of_law, read_prior
from tests.support.campaigns import small_problem


@pytest.fixture(scope="module")
def campaign() -> bs.Campaign:
    problem, _ = small_problem(n=2, interval=0.02, fall=[True, False])
    return problem.campaign


@pytest.mark.parametrize(
    ("text", "name", "prior"),
    [
        ("normal(60, 2) mL", "V_mL", ("normal", 60.0, 2.0)),
        ("normal(60 mL, 2 mL)", "V_mL", ("normal", 60.0, 2.0)),
        ("60 +- 2 mL", "V_mL", ("normal", 60.0, 2.0)),
        ("half_normal(200) ms", "tau_s", ("half_normal", 0.2, 1.0)),
        ("half-normal(200 ms)", "tau_s", ("half_normal", 0.2, 1.0)),
        ("Log_Normal(850, 1.5) ms", "tau_v_s", ("log_normal", 0.85, 1.5)),
        ("log_uniform(1, 1000) ms", "tau_s", ("log_uniform", 1e-3, 1.0)),
        ("uniform(0.1, 0.9)", "phi", ("uniform", 0.1, 0.9)),
        ("uniform(1, 3) mV", "sigma0_V", ("uniform", 1e-3, 3e-3)),
        ("flat", "tau_s", ("flat", 0.0, 1.0)),
    ],
)
def test_texts(text: str, name: str, prior: tuple[str, float, float]) -> None:
    found = read_prior(text, name, "V", "here")
    assert found.kind == prior[0]
    np.testing.assert_allclose((found.a, found.b), prior[1:], rtol=1e-15)


@pytest.mark.parametrize(
    "law",
    [
        stats.norm(60.0, 2.0), stats.norm(loc=60.0, scale=2.0), stats.halfnorm(scale=0.2),
        stats.lognorm(s=1.5, scale=0.85), stats.lognorm(1.5, 0.0, 0.85), stats.uniform(1.0, 2.0),
        stats.loguniform(1e-3, 1.0),
    ],
)  # fmt: skip
def test_laws_of_scipy_keep_their_density(law: Any) -> None:
    prior = prior_of_law(law)
    assert prior is not None
    x = law.ppf([0.01, 0.3, 0.5, 0.8, 0.99])
    np.testing.assert_allclose(prior.log_density(x), law.logpdf(x), rtol=1e-12)


def test_laws_that_have_no_counterpart() -> None:
    for law in (stats.gamma(2.0), stats.halfnorm(0.1, 2.0), stats.norm, 3, "normal"):
        assert prior_of_law(law) is None


def test_both_doors_make_the_same_problem(campaign: bs.Campaign, tmp_path: Path) -> None:
    path = tmp_path / "settings.toml"
    path.write_text(
        '[priors]\nV = "normal(14, 1) mL"\nt0 = "uniform(1.9, 2.2) s"\n"t0[b]" = "2 +- 0.1 s"\n'
        '[fix]\ntau_v = "300 ms"\n'
    )
    by_file = make_problem(campaign, read_overrides(path), path.name)
    by_call = bs.make_problem(
        campaign,
        {
            "V": stats.norm(14, 1),
            "t0[b]": bs.Prior("normal", 2.0, 0.1),
            "t0": "uniform(1.9, 2.2) s",
        },
        {"tau_v": 0.3},
    )
    assert by_file.given_priors == by_call.given_priors and by_file.held == by_call.held
    assert by_file.priors["t0_s[b]"].kind == "normal" and by_file.priors["t0_s[a]"].a == 1.9
    assert by_file.fixed == {"tau_v_s": 0.3}


@pytest.mark.parametrize(
    ("priors", "message"),
    [
        ({"V": "norml(60, 2) mL"}, "expected a prior such as"),
        ({"V": "normal(60, 2)"}, "expected a volume with its unit, but got '60'"),
        ({"V": "normal(60 mL, 2) mL"}, "one unit for every number"),
        ({"V": "normal(60, 2) s"}, "expected a volume, but '60 s'"),
        ({"phi": "uniform(0, 0.9) s"}, "no unit where there is none"),
        ({"V": 60}, "expected a prior, but got a int; write a text such as"),
        ({"V": stats.gamma(2.0)}, "a frozen law of scipy.stats"),
        ({"W": "flat"}, "unknown parameter 'W'"),
        ({"tau": "uniform(-5, -2) s"}, r"\[priors\] tau: .* values above 0, .* uniform\(-5, -2\)"),
        ({"V": "normal(-60, 2) mL"}, r"\[priors\] V: expected a prior with values above 0"),
        ({"sigma0": bs.Prior("uniform", -2.0, -1.0)}, r"\[priors\] sigma0: .* values above 0"),
        ({"phi": "uniform(2, 3)"}, r"\[priors\] phi: .* values between -1 and 1, which is the"),
    ],
)
def test_mistakes_in_priors(campaign: bs.Campaign, priors: dict[str, Any], message: str) -> None:
    with pytest.raises(bs.CampaignError, match=message):
        bs.make_problem(campaign, priors)


def test_a_problem_made_by_hand_names_priors_without_support_too(campaign: bs.Campaign) -> None:
    for name, law in {"phi": ("uniform", 2.0, 3.0), "tau_v_s": ("normal", -1.0, 0.01)}.items():
        problem = bs.Problem(campaign, given_priors={name: bs.Prior(*law)})
        with pytest.raises(bs.CampaignError, match=f"Problem.given_priors: {name}: expected a pri"):
            problem.priors  # noqa: B018
    # part of a law is enough, and phi may be below 0 only where all intervals are the same
    assert bs.make_problem(campaign, {"tau": "normal(-0.01, 0.1) s", "phi": "uniform(-0.5, 2)"})
    (first, *rest) = campaign.experiments
    other = replace(first, t=2.0 * first.t, interval=2.0 * first.interval)
    mixed = replace(campaign, experiments=(other, *rest))
    with pytest.raises(bs.CampaignError, match="values between 0 and 1"):
        bs.make_problem(mixed, {"phi": "uniform(-0.9, -0.1)"})


@pytest.mark.parametrize(
    ("fix", "message"),
    [
        ({"tau": 0.1}, "tau is what is measured"),
        ({"y0": "1 V"}, "expected a lag, a volume or a switch time"),
        ({"sigma0": "1 mV"}, "expected a lag, a volume or a switch time"),
        ({"V": "14 s"}, "expected a volume, but '14 s'"),
        ({"tau_v": -1}, "expected a positive value"),
        ({"tau_v": float("nan")}, "expected a finite number"),
        ({"t0[z]": 2.0}, "unknown parameter"),
        ({"t0[a]": "99 s"}, "outside the record, which runs from 0 to 11.98 s"),
        ({"tf[b]": "7 s"}, "unknown parameter"),
    ],
)
def test_mistakes_in_held_values(campaign: bs.Campaign, fix: Any, message: str) -> None:
    with pytest.raises(bs.CampaignError, match=message):
        bs.make_problem(campaign, fix=fix)


def test_what_is_known_twice_is_refused(campaign: bs.Campaign) -> None:
    with pytest.raises(bs.CampaignError, match="held, and has a prior or side information as well"):
        bs.make_problem(campaign, {"V": "14 +- 1 mL"}, {"V": "14 mL"})


def test_a_lag_that_has_no_name_cannot_be_held(campaign: bs.Campaign) -> None:
    unknown = bs.Campaign("unknown order", campaign.experiments)
    with pytest.raises(bs.CampaignError, match="not known which of the lags that is.*sensor_is"):
        bs.make_problem(unknown, fix={"tau_v": "0.3 s"})
    assert bs.make_problem(unknown, fix={"V": "14 mL"}).held == {"V_mL": 14.0}
