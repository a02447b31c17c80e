"""Effects of a user's own: where their fits begin, and what is told of those that are wrong."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from bayes_sensor.campaign import CampaignError
from bayes_sensor.diagnosis import Strength, diagnose_gap, own_effect
from bayes_sensor.diagnosis.effects.effect import Effect, OnNoise
from bayes_sensor.diagnosis.signals.signal import Finding, Signal
from tests.support.planted_effects import measured

HEIGHT = Strength("bump_V", "V", "normal", 0.0, 0.03)
PLACE = Strength("bump_at", "s", "log_normal", 10.0, 0.3)
WIDTH = Strength("bump_width", "s", "log_normal", 2.5, 0.5)


def bump(t: Any, strength: Any, rig: Any) -> Any:
    """A bump on the plateau."""
    at = (t - rig.t0 - strength["bump_at"]) / strength["bump_width"]
    return rig.mean(t) + strength["bump_V"] * np.exp(-0.5 * at**2)


def effect(mean: Callable[..., Any] = bump, **more: Any) -> Effect:
    """The bump, with another function or other words."""
    return own_effect("bump", [HEIGHT, PLACE, WIDTH], mean, **{"plausible": {}, **more})


def test_a_strength_that_begins_at_nothing_begins_to_either_side_of_it() -> None:
    assert effect().forms[0].starts == ({"bump_V": 0.03}, {"bump_V": -0.03})
    assert effect(starts=({},)).forms[0].starts == ({},)
    one = own_effect("one", [HEIGHT], bump, plausible={})
    assert one.forms[0].starts == ({},)  # the mean is as good as linear in it
    bounded = Strength("bump_V", "V", "normal", 0.0, 0.03, limits=(0.0, 1.0))
    assert own_effect("up", [bounded, PLACE], bump, plausible={}).forms[0].starts == (
        {"bump_V": 0.03},
    )
    assert own_effect("no", [PLACE, WIDTH], bump, plausible={}).forms[0].starts == ({},)


@pytest.mark.slow
@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_place_and_width_of_a_bump_are_found_without_starts(sign: float) -> None:
    campaign = measured({}, seed=9)
    values = {}
    for e in campaign:
        at = (e.t - e.commanded_on - 0.8 - 12.0) / 1.5
        values[e.name] = e.values + sign * 0.05 * np.exp(-0.5 * at**2)
    campaign = campaign.with_data(values)
    told = {"bump_V": sign * 0.05, "bump_at": 12.0, "bump_width": 1.5}
    rows = []
    for own in (effect(), effect(starts=[told])):
        gap = diagnose_gap(campaign, effects=[own], bootstrap=0, hidden=False, separate=False)
        assert gap.verdict.effects == ("bump",)
        rows.append(next(row for row in gap.to_json()["which"] if row["effect"] == "bump"))
    found, best = (row["strength"] for row in rows)
    assert found == pytest.approx(best, rel=0.02)  # as of fits that begin at the truth
    assert found["bump_V"] == pytest.approx(told["bump_V"], rel=0.15)
    assert found["bump_at"] == pytest.approx(12.0, abs=0.3)
    assert rows[0]["fraction_closed"] == pytest.approx(rows[1]["fraction_closed"], abs=0.01)


@pytest.mark.parametrize(
    ("more", "message"),
    [
        ({"plausible": {"bump": 0.03}},
         r"bump: plausible: expected names of its strengths \(bump_V, .*\), but got 'bump'"),
        ({"plausible": {"bump_V": np.nan}}, "plausible: expected a number for bump_V, but got nan"),
        ({"plausible": {"bump_V": "much"}}, "expected a number for bump_V, but got much"),
        ({"starts": [{}, {"bump_where": 8.0}]}, "starts: .* but got 'bump_where'; correct it"),
        ({"plausible": {"bump_at*": 3.0}}, r"plausible: .* but got 'bump_at\*'"),
    ],
)  # fmt: skip
def test_a_strength_that_is_not_there_is_told(more: dict[str, Any], message: str) -> None:
    with pytest.raises(CampaignError, match=message):
        effect(**more)
    assert effect(starts=[{"bump_at*": 3.0}]).forms[0].starts == ({"bump_at*": 3.0},)


@pytest.mark.filterwarnings("error")
@pytest.mark.parametrize(
    ("mean", "value"),
    [(lambda t, s, rig: rig.mean(t) * np.nan, "nan"),
     (lambda t, s, rig: rig.mean(t) + s["bump_V"] * np.log(np.minimum(t, rig.t0) - rig.t0), "nan"),
     (lambda t, s, rig: rig.mean(t) + 1.0 / (t < 0.0), "inf")],
)  # fmt: skip
def test_a_mean_that_is_not_finite_is_told(mean: Callable[..., Any], value: str) -> None:
    campaign = measured({}, seed=9, n=2)
    message = (
        f"effect bump: expected finite values from its function, but got {value} at t = .* s of "
        "experiment '1' with bump_V = .*, bump_at = .*; correct it"
    )
    with pytest.raises(CampaignError, match=message):
        diagnose_gap(campaign, effects=[effect(mean)], bootstrap=0, hidden=False, separate=False)


def test_what_a_fit_tries_far_away_may_be_anything() -> None:
    checked = effect(lambda t, s, rig: t * np.nan).forms[0].mean
    assert checked is not None
    values = {"bump_V": 0.03, "bump_at": 10.0 * np.exp(0.3 * 4.0), "bump_width": 2.5}
    assert np.isnan(checked(np.ones(3), values, None)).all()  # type: ignore[arg-type]


def test_an_effect_of_ones_own_on_the_noise_is_found_by_its_own_detector() -> None:
    def look(samples):
        return [Finding(signal, 2.0 * len(samples.residuals), {"tick_V": 0.01}, None)]

    signal = Signal(
        "ticking", 0.03, {"tick_V": "V"}, lambda found, names, unit: "It ticks.", look, listed=True
    )
    ticking = Effect(
        name="ticking", family="clock", sentence="A clock ticks: {strength}.",
        plausible={"tick_V": 0.01}, reference="test", reveal="a record without the clock",
        labels={"tick_V": "height"},
        on_noise=OnNoise(signal=signal),
    )  # fmt: skip
    gap = diagnose_gap(
        measured({}, n=4), effects=[ticking], bootstrap=0, hidden=False, separate=False
    )
    assert gap.verdict.kind == "effect" and gap.verdict.effects == ("ticking",)
    assert "A clock ticks: height 0.01 V." in gap.verdict.sentence
    assert gap.strength_units["tick_V"] == "V"


def test_an_effect_acts_on_something() -> None:
    with pytest.raises(CampaignError, match="at least one form, or how it acts on the noise"):
        Effect("idle", "idle", "", {}, "", "")
