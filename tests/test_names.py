"""Names that look the same are one name, whoever gives them."""

import numpy as np
import pytest

from bayes_sensor.campaign import Campaign, CampaignError
from bayes_sensor.names import acts_on_its_surroundings, appearance


@pytest.mark.parametrize(
    ("one", "other"),
    [
        ("caf\u00e9", "cafe\u0301"),
        ("a b", "a\u00a0 b "),
        ("a", "a\u200b"),
        ("a", "\ufeffa\u2060"),
        ("\u2764", "\u2764\ufe0f"),
    ],
)
def test_two_frames_whose_names_look_the_same_are_refused(one: str, other: str) -> None:
    t = np.arange(100) * 0.1
    frames = {one: (t, np.sin(t)), other: (t, np.cos(t))}
    with pytest.raises(
        CampaignError, match="two experiments are called .*, or look so; rename one"
    ):
        Campaign.from_frames(frames, total_flow="4 L/min", concentration="9 %", commanded_on="2 s")


def test_what_can_be_told_apart_is_two_names() -> None:
    names = ["a", "A", "1", "01", "1.0", "x\u00b2", "x2", "\u05d0 1", "=1", "'=1"]
    assert len({appearance(name) for name in names}) == len(names)
    assert not any(map(acts_on_its_surroundings, names))
    assert all(map(acts_on_its_surroundings, ["a\n", "\x9b2J", "a\u2066b", "\ud800"]))
