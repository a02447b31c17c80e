"""The probability vector: what evidences look like, and what the calibration map makes of it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from bayes_sensor.diagnosis.calibration import Appearance, Calibration, calibration
from bayes_sensor.diagnosis.effects import CATALOGUE
from bayes_sensor.diagnosis.probabilities import FAINT, calibrated, combine, too_small
from bayes_sensor.diagnosis.signals.signal import Finding
from tests.support.planted_effects import SIGNALS, diagnosed

PLAIN = Calibration(0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0)
"""evidences at their word"""


def test_a_cause_too_small_to_be_seen_is_drawn() -> None:
    # |d + noise| < 2, by drawing it
    drawn = np.random.default_rng(1).standard_normal(400_000)
    for d in (0.0, 1.0, 2.5, 5.0):
        assert too_small(d) == pytest.approx((np.abs(d + drawn) < FAINT).mean(), abs=0.004)


def test_evidences_at_their_word_stay_what_they_are() -> None:
    seen = [
        Appearance("none", (), 0.5, 0.0, None),
        Appearance("listed", ("a",), 0.3, 5.0, None),
        Appearance("unlisted", (), 0.2, 5.0, None),
    ]
    assert PLAIN.classes(seen) == pytest.approx((0.5, 0.3, 0.2))
    # a finding takes its share of what it is not excused by
    struck = [Appearance("none", (), 0.5, 0.0, 0.0), *seen[1:]]
    assert PLAIN.classes(struck) == pytest.approx((0.25, 0.3, 0.45))


def test_the_vector_has_the_classes_of_the_map() -> None:
    rng = np.random.default_rng(3)
    masses = rng.dirichlet(np.ones(5))
    seen = [
        Appearance("none", (), masses[0], 0.0, 1.0),
        Appearance("listed", ("a",), masses[1], 9.0, None),
        Appearance("form", ("a",), masses[2], 9.0, 0.5),
        Appearance("listed", ("a", "b"), masses[3], 12.0, None),
        Appearance("unlisted", (), masses[4], 9.0, None),
    ]
    rows, classes = calibrated(seen, ("a",)), calibration().classes(seen)
    assert sum(rows.values()) == pytest.approx(1.0)
    assert rows["none"] == pytest.approx(classes.none)
    assert rows["unlisted"] == pytest.approx(classes.unlisted)
    assert rows["a"] + rows["a+b"] == pytest.approx(classes.listed)


def test_what_only_looks_unlisted_goes_to_the_likeliest() -> None:
    sure = calibrated([Appearance("unlisted", (), 1.0, 30.0, None)], ("dead_volume",))
    table = calibration()
    assert sure["dead_volume"] == pytest.approx(table.unlisted_listed)
    tiny = [
        Appearance("unlisted", (), 1.0, 9.0, None),
        Appearance("listed", ("a",), 5e-324, 9, None),
    ]
    assert calibrated(tiny, ("a",))["a"] == pytest.approx(table.unlisted_listed)


def test_the_map_is_a_map_of_probabilities() -> None:
    table = calibration()
    for look in ("none", "listed", "form", "unlisted", "own"):
        for d in (0.0, 3.0, 10.0, 100.0):
            shares = table.shares(look, d)
            assert sum(shares) == pytest.approx(1.0) and min(shares) >= 0.0
    # the clearer an effect is seen, the surer
    listed = [table.shares("listed", d).listed for d in (3.0, 10.0, 30.0)]
    assert listed == sorted(listed)
    assert 0.0 < table.finding_slope <= 1.0, "samples are trusted no more than their evidence"


@pytest.mark.parametrize(("effect", "strength"), [("none", None), ("flow_error", None)])
def test_effects_and_families_are_sums_of_rows(effect, strength) -> None:
    found = diagnosed(effect, strength).probabilities
    assert sum(found.rows.values()) == pytest.approx(1.0)
    for name in CATALOGUE:
        total = sum(p for row, p in found.rows.items() if name in row.split("+"))
        assert found.effects[name] == pytest.approx(total)
    assert {"none", "unlisted", *CATALOGUE} <= set(found.rows)


@pytest.mark.parametrize(
    ("effect", "strength"), [("none", None), ("flow_error", None), ("heavy_tails", 3.0),
                             ("quantisation", 0.03), ("valve_asymmetry", 1.25)],
)  # fmt: skip
def test_verdict_row_and_sentence_have_one_number(effect, strength) -> None:
    gap = diagnosed(effect, strength)
    said = gap.to_json()
    rows = {row["effect"]: row["probability"] for row in said["which"]}
    assert sum(rows.values()) == pytest.approx(1.0, abs=1e-9)
    verdict = said["verdict"]
    if verdict["kind"] == "effect":
        row = rows["+".join(verdict["effects"])]
    elif verdict["kind"] == "family":
        row = said["families"][verdict["family"]]
    else:
        row = rows[verdict["kind"]]
    assert verdict["probability"] == row
    assert f"{100.0 * row:.0f} %" in verdict["sentence"]


def test_effects_of_the_noise_are_there_or_not_whatever_the_mean_is() -> None:
    comparison = diagnosed("flow_error").comparison
    tails = Finding(SIGNALS["heavy_tails"], 3.0, {"tail_dof": 4.0}, None)
    plain, with_tails = (combine(comparison, f, CATALOGUE) for f in ([], [tails]))
    for row in ("none", "flow_error"):
        own = row if row != "none" else ""
        beside = "+".join(filter(None, [own, "heavy_tails"]))
        assert with_tails.rows[row] == pytest.approx(plain.rows[row] * (1.0 - tails.probability))
        assert with_tails.rows[beside] == pytest.approx(plain.rows[row] * tails.probability)
    assert with_tails.unlisted == pytest.approx(plain.unlisted)


def test_a_finding_is_calibrated_once() -> None:
    event = Finding(SIGNALS["event"], 6.0, {}, 4.0)
    assert event.probability == calibration().of_finding(event.log_odds)
    listed = replace(event, signal=SIGNALS["mains_pickup"])
    odds = np.exp(listed.log_odds)
    assert listed.probability == pytest.approx(odds / (1.0 + odds))
