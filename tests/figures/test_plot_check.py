"""The drawing of a campaign before it is fitted."""

from __future__ import annotations

import re
from dataclasses import replace

import numpy as np

from bayes_sensor import figures
from bayes_sensor.campaign import Campaign, Experiment

T = np.round(0.01 * np.arange(6000), 6)
Y = 0.2 + np.where((T > 15.0) & (T < 40.0), 1.0, 0.0)
Y = Y + np.random.default_rng(1).normal(0.0, 0.02, len(T))
MASK = ~((T > 50.0) & (T < 55.0))
PULSE = Experiment("first", T, Y, 60.0, 10.0, 0.01, 14.0, 39.0, MASK, drive=5.0 * (T > 14.0))


def texts(campaign: Campaign) -> set[str]:
    """Every text of the drawing."""
    return set(re.findall(r">([^<>]+)</text>", figures.svg(figures.understood(campaign))))


def test_a_record_is_drawn_with_all_that_was_understood() -> None:
    shown = texts(Campaign("c", (PULSE,), signal_unit="ppm"))
    labels = ("samples in use", "quiet stretch", "its level", "step seen (half way)", "left out",
              "commanded on", "commanded off", "drive (not to scale)", "signal (ppm)")  # fmt: skip
    assert set(labels) <= shown
    assert any(text.startswith("first") and "4.2 L/min" in text for text in shown)


def test_places_in_the_drawing_are_those_of_the_record() -> None:
    (axes,) = figures.understood(Campaign("c", (PULSE,))).axes
    lines = {line.get_label(): line for line in axes.lines}
    assert list(lines["commanded on"].get_xdata()) == [14.0, 14.0]
    assert list(lines["commanded off"].get_xdata()) == [39.0, 39.0]
    seen = np.asarray(lines["step seen (half way)"].get_xdata(), dtype=float)
    np.testing.assert_allclose(seen, [15.0, 40.0], atol=0.05)
    level = lines["its level"]
    np.testing.assert_allclose(level.get_ydata(), 0.2, atol=0.01)
    (gray,) = [patch for patch in axes.patches if patch.get_label() == "left out"]
    box = gray.get_path().get_extents(gray.get_patch_transform())
    np.testing.assert_allclose([box.x0, box.x1], [50.01, 55.0], atol=0.02)


def test_designs_few_samples_and_many_experiments_are_drawn() -> None:
    planned = replace(PULSE, name="planned", y=None, drive=None)
    assert "commanded on" in texts(Campaign("c", (planned,)))
    few = replace(PULSE, t=T[:50], y=Y[:50], mask=None, drive=None, commanded_on=None,
                  commanded_off=None)  # fmt: skip
    assert "commanded on" not in texts(Campaign("c", (few,)))
    many = tuple(replace(few, name=str(i)) for i in range(5))
    assert len(figures.understood(Campaign("c", many)).axes) == 6  # the last one is empty
