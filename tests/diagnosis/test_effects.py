"""Effects: what is refused, how they join the model, strengths on the command line."""

import numpy as np
import pytest

from bayes_sensor.campaign import CampaignError
from bayes_sensor.diagnosis.effects import CATALOGUE
from bayes_sensor.diagnosis.effects.effect import Effect, Strength
from bayes_sensor.diagnosis.effects.effect_model import (
    EffectModel,
    chosen_effects,
    find_form,
    with_effects,
)
from bayes_sensor.diagnosis.effects.simulate_effects import read_strength
from bayes_sensor.diagnosis.effects.user_effects import own_effect
from bayes_sensor.likelihood.problem import Problem
from bayes_sensor.rig.cascade import Cascade
from tests.support.campaigns import small_design, small_problem


@pytest.mark.parametrize(
    ("numbers", "message"),
    [
        (("s", "uniform", 0.0, 1.0), "kind must be one of"),
        (("s", "normal", 0.0, 0.0), "expected a positive spread, got 0 and 0"),
        (("s", "log_normal", 0.0, 1.0), "a positive spread and a positive centre, got 0 and 1"),
    ],
)
def test_a_strength_says_what_is_wrong_with_it(numbers, message: str) -> None:
    with pytest.raises(CampaignError, match=message):
        Strength("leak_s", *numbers)


def test_a_positive_strength_takes_positive_values_only() -> None:
    strength = Strength("leak_s", "s", "log_normal", 0.2, 0.5)
    assert strength.value(strength.coordinate(0.3)) == pytest.approx(0.3)
    assert strength.coordinate(1e-9) == -8.0
    with pytest.raises(CampaignError, match="leak_s: expected a positive value in s, got -1"):
        strength.coordinate(-1.0)


def test_an_effect_on_the_mean_needs_a_form_and_strengths() -> None:
    with pytest.raises(CampaignError, match="effect leak: expected at least one form"):
        Effect("leak", "leak", "", (), {}, "", "")
    with pytest.raises(CampaignError, match="effect leak: expected at least one strength"):
        own_effect("leak", [], lambda t, s, rig: t, plausible={})


def test_forms_are_found_by_name_or_refused() -> None:
    effect = next(e for e in CATALOGUE.values() if len(e.forms) > 1 and e.forms[1].name)
    assert find_form(effect) is effect.forms[0]
    assert find_form(effect, effect.forms[1].name) is effect.forms[1]
    with pytest.raises(CampaignError, match=f"no form 'odd'; known are '{effect.forms[0].name}"):
        find_form(effect, "odd")
    lone = next(e for e in CATALOGUE.values() if len(e.forms) == 1 and not e.forms[0].name)
    with pytest.raises(CampaignError, match=f"it has one only: give {lone.name} alone"):
        chosen_effects([f"{lone.name}:odd"], [], "--with-effect")
    with pytest.raises(CampaignError, match="acts on the noise, not on the mean"):
        chosen_effects(["heavy_tails"], [], "--with-effect")


class Faster(Cascade):
    """A model that is not the cascade."""


def test_effects_join_the_cascade_once() -> None:
    design = small_design()
    problem = with_effects(design, ["flow_switching"])
    both = with_effects(problem, ["dead_volume"])
    assert isinstance(both.model, EffectModel)
    assert [c.effect for c in both.model.chosen] == ["flow_switching", "dead_volume"]
    with pytest.raises(CampaignError, match="effect flow_switching is given twice"):
        with_effects(problem, ["flow_switching"])
    with pytest.raises(CampaignError, match="effects can only be added to the cascade"):
        with_effects(Problem(design, model=Faster()), ["flow_switching"])


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("dead_volume=3 furlong", "not in 'furlong'; give the number alone"),
        ("valve_asymmetry=much", "'much' is no number"),
        ("valve_asymmetry=inf", "expected a finite number"),
    ],
)
def test_a_strength_on_the_command_line_is_a_number(text: str, message: str) -> None:
    with pytest.raises(CampaignError, match=message):
        read_strength(text)


def test_a_strength_may_be_left_out_or_carry_its_own_unit() -> None:
    assert read_strength("valve_asymmetry") == ("valve_asymmetry", None)
    assert read_strength("valve_asymmetry=0.3") == ("valve_asymmetry", 0.3)


def test_a_response_at_no_times_is_empty() -> None:
    problem, theta = small_problem(n=1, interval=0.05)
    joined = with_effects(problem, ["flow_switching"])
    assert isinstance(joined.model, EffectModel)
    vector = np.concatenate([theta, np.zeros(len(joined.layout) - len(theta))])
    e = problem.campaign.experiments[0]
    for part in joined.model.mean_and_response(np.zeros(0), vector, joined.layout, e):
        assert part.shape == (0,)


def test_a_low_pass_of_two_poles_is_that_of_a_state_space() -> None:
    from scipy.signal import lsim, lti

    from bayes_sensor.rig.lag_cells import Cells, add_butterworth

    h = np.array([0.3, 0.2, 0.7, 1.0, 0.05])
    a, b = np.array([0.0, 0.3, 0.5, 0.1, 1.0]), np.array([0.3, 0.5, 0.1, 1.0, 1.2])
    m = 0.5 * (a + b) + np.array([0.1, -0.2, 0.0, 0.3, 0.0])
    edges = np.concatenate([[0.0], np.cumsum(h)])
    t = np.linspace(0.0, edges[-1], 50_001)
    i = np.minimum(np.searchsorted(edges, t, side="right") - 1, len(h) - 1)
    s = (t - edges[i]) / h[i]
    u = a[i] + (4.0 * m - 3.0 * a - b)[i] * s + (2.0 * a - 4.0 * m + 2.0 * b)[i] * s**2
    for time in (0.05, 0.15, 2.0):
        _, said, _ = lsim(lti([1.0], [time**2, np.sqrt(2.0) * time, 1.0]), u, t)
        out = np.zeros(len(t))
        add_butterworth(i, t - edges[i], Cells(h, a, m, b), time, out)
        # lsim holds the input linear between its times
        assert out == pytest.approx(said, abs=1e-7)
