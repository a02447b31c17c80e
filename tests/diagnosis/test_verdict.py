"""What the verdict says, and what it leaves open."""

from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pandas as pd
import pytest

from bayes_sensor.diagnosis.diagnose import diagnose_gap
from bayes_sensor.diagnosis.effects import CATALOGUE
from bayes_sensor.diagnosis.evidence import hypotheses
from bayes_sensor.diagnosis.evidence.compared_hypotheses import Comparison
from bayes_sensor.diagnosis.signals.finding import Finding
from bayes_sensor.diagnosis.verdict import (
    AKIN,
    FAINT,
    MIMIC,
    MISTAKEN,
    MISTAKEN_BY_SAMPLES,
    Judgement,
    Probabilities,
    chance_too_small,
    explanation_of,
    give_back_mistaken,
    judge,
)
from bayes_sensor.diagnosis.wording import (
    Conclusion,
    family_words,
    nearest_finding,
    second_words,
    undecided_words,
)
from tests.support.planted_effects import SIGNALS, measured

TABLES = Path(__file__).resolve().parents[2] / "paper" / "tables"

NOTHING = SimpleNamespace(complete=[])


def standing(none: float, unlisted: float, families=None, effects=None) -> Probabilities:
    each = dict.fromkeys(CATALOGUE, 0.0) | (effects or {})
    return Probabilities({}, each, families or {}, none, unlisted, unlisted, unlisted, 0.0)


def test_the_verdict_where_no_effect_stands_out() -> None:
    kinds = [
        judge(NOTHING, standing(none, unlisted), CATALOGUE)[0]
        for none, unlisted in ((0.99, 0.0), (0.25, 0.2), (0.2, 0.25), (0.1, 0.9))
    ]
    assert kinds == ["none", "none", "unlisted", "unlisted"]


@pytest.mark.parametrize(
    ("none", "unlisted", "in_family", "looks", "kind"),
    [
        (0.0, 0.455, 0.545, 0.54, "family"),  # once it is given back, the family is likelier
        (0.0, 0.52, 0.48, 0.61, "unlisted"),
        (0.51, 0.49, 0.0, 0.8, "none"),
        (0.44, 0.56, 0.0, 0.98, "unlisted"),
        (0.0, 0.4, 0.35, 0.45, "unlisted"),  # nothing is likelier than not
    ],
)
def test_unlisted_is_stated_where_it_is_likeliest_after_what_only_looks_so_is_given_back(
    none: float, unlisted: float, in_family: float, looks: float, kind: str
) -> None:
    family = CATALOGUE["flow_error"].family
    combined = replace(standing(none, unlisted, {family: in_family}), looks_unlisted=looks)
    assert judge(NOTHING, combined, CATALOGUE)[0] == kind


def test_some_of_what_looks_unlisted_is_a_mistake() -> None:
    rows = {"none": 0.3, "unlisted": 0.6, "dead_volume": 0.1}
    made = give_back_mistaken(rows, 0.09, "none")
    assert sum(made.values()) == pytest.approx(1.0)
    assert made["unlisted"] == pytest.approx(0.51)
    assert made["none"] / made["dead_volume"] == pytest.approx(3.0)
    sure = give_back_mistaken(
        {"none": 0.0, "unlisted": 1.0, "dead_volume": 0.0}, 0.2, "dead_volume"
    )
    assert sure == pytest.approx({"none": 0.0, "unlisted": 0.8, "dead_volume": 0.2})
    tiny = give_back_mistaken({"none": 5e-324, "unlisted": 1.0, "dead_volume": 0.0}, 0.2, "none")
    assert tiny == pytest.approx({"none": 0.2, "unlisted": 0.8, "dead_volume": 0.0})
    quiet = {"none": 1.0, "unlisted": 0.0, "dead_volume": 0.0}
    assert give_back_mistaken(quiet, 0.0, "none") == quiet


@pytest.mark.tables
def test_shares_of_the_verdict_are_those_that_earlier_blind_checks_counted() -> None:
    counted = pd.read_csv(TABLES / "blind_check_shares.csv")
    near, nearer, by_mean, by_samples, but_one, akin = counted.itertuples(index=False)
    for row in counted.itertuples():
        assert row.count / row.of == pytest.approx(row.share, abs=1e-3)
    assert by_mean.share == pytest.approx(MISTAKEN, abs=1e-3)
    assert but_one.share < MISTAKEN_BY_SAMPLES < by_samples.share
    assert akin.share == pytest.approx(AKIN, abs=2.0 * (AKIN * (1.0 - AKIN) / akin.of) ** 0.5)
    # causes differ from run to run more than campaigns of one cause do
    for d, row in ((8, near), (16, nearer)):
        assert row.taken == pytest.approx(MIMIC / d) == pytest.approx(row.share, abs=0.07)


def test_an_effect_too_small_to_be_seen_counts_as_nothing_seen() -> None:
    base = SimpleNamespace(misfit=100.0)

    def too_small(d: float, *effects: str) -> float:
        fitted = SimpleNamespace(misfit=base.misfit - d**2)
        return chance_too_small(SimpleNamespace(effects=effects, refit=fitted), base)

    assert too_small(0.0) == 0.0
    # |d + noise| < 2, by drawing it
    drawn = np.random.default_rng(1).standard_normal(400_000)
    for d in (0.0, 1.0, 2.5, 5.0):
        assert too_small(d, "a") == pytest.approx((np.abs(d + drawn) < FAINT).mean(), abs=0.004)
    seen = Probabilities({}, dict.fromkeys(CATALOGUE, 0.0), {}, 0.7, 0.1, 0.1, 0.1, 0.15)
    assert judge(NOTHING, seen, CATALOGUE) == ("none", (), None, pytest.approx(0.85))


def test_a_family_is_named_where_its_members_cannot_be_told_apart() -> None:
    name = next(n for n, e in CATALOGUE.items() if e.on_mean)
    family = CATALOGUE[name].family
    combined = standing(0.1, 0.1, {family: 0.8}, {name: 0.4})
    kind, effects, found, p = judge(NOTHING, combined, CATALOGUE)
    assert (kind, found, p) == ("family", family, pytest.approx(0.8 + AKIN * 0.1))
    assert effects[0] == name and all(CATALOGUE[n].family == family for n in effects)


@pytest.mark.parametrize(
    ("none", "unlisted", "mains", "kind"),
    [(0.25, 0.08, 0.59, "family"), (0.35, 0.05, 0.59, "none"), (0.25, 0.3, 0.45, "unlisted")],
)
def test_an_effect_of_the_noise_is_stated_where_it_is_likely(
    none: float, unlisted: float, mains: float, kind: str
) -> None:
    # too unlikely to be named, yet likelier than nothing at all
    combined = standing(none, unlisted, {"interference": mains}, {"mains_pickup": mains})
    found, *said = judge(NOTHING, combined, CATALOGUE)
    assert found == kind
    if kind == "family":  # no unlisted cause acts on the mean as the mains do on the noise
        assert said == [("mains_pickup",), "interference", mains]


def test_of_several_that_are_each_unlikely_the_likeliest_is_stated() -> None:
    families = {"slow exchange": 0.45, "baseline": 0.35}
    kind, effects, found, p = judge(NOTHING, standing(0.05, 0.15, families), CATALOGUE)
    # some unlisted causes act nearly as a member does
    assert (kind, found, p) == ("family", "slow exchange", pytest.approx(0.45 + AKIN * 0.15))
    assert all(CATALOGUE[n].family == "slow exchange" for n in effects)
    # what nothing at all is as likely as, and what less is known of than of an unlisted cause
    assert judge(NOTHING, standing(0.16, 0.15, families), CATALOGUE)[0] == "none"
    assert judge(NOTHING, standing(0.05, 0.4, {"slow exchange": 0.35}), CATALOGUE)[0] == "unlisted"


@pytest.mark.parametrize(
    ("probability", "leading", "other", "said"),
    [
        (0.45, 0.4, "", "No cause is likelier than not in the rise; the likeliest is a (45 %)."),
        (0.45, 0.2, "", "in the rise; the likeliest is one of a, B (45 %)."),
        (0.8, 0.7, "", "Most likely a (70 %) explains the gap in the rise, but a cause outside"),
        (0.8, 0.7, "b", "a, or b, whose response is the same, explains the gap in the rise."),
        (0.8, 0.4, "", "One of a, B explains the gap in the rise; this campaign does not tell"),
    ],
)
def test_of_a_family_no_more_is_said_than_is_known(probability, leading, other, said) -> None:
    assert said in family_words(["a", "B"], probability, leading, " in the rise", other)


def test_what_is_likely_beside_a_name_is_said() -> None:
    effects = {"flow_switching": 0.95, "baseline_step": 0.1, "baseline_drift": 0.7}
    combined = standing(0.0, 0.05, {"asymmetry": 0.95, "baseline": 0.79, "gain": 0.6}, effects)
    said = "".join(second_words(["flow_switching"], combined, CATALOGUE))
    assert "the family baseline (79 %), most likely baseline_drift" in said
    alone = standing(0.0, 0.05, {"asymmetry": 0.95, "baseline": 0.4}, effects)
    assert second_words(["flow_switching"], alone, CATALOGUE) == []


def test_an_effect_that_shares_its_response_is_not_named_beside_another_either() -> None:
    sure = {"optical_nonlinearity": 0.95, "slow_sorption": 0.93}
    families = {CATALOGUE[name].family: p for name, p in sure.items()}
    combined = standing(0.0, 0.05, families, sure)
    judgement = judge(NOTHING, combined, CATALOGUE)
    named = judgement.effects
    assert judgement[:2] == ("effect", ("optical_nonlinearity",)) and judgement[3] == 0.95
    # it is in the explanation all the same, and said
    alone, both = (
        SimpleNamespace(effects=effects, log_weight=weight)
        for effects, weight in ((("optical_nonlinearity",), -50.0), (tuple(sure), 0.0))
    )
    assert (
        explanation_of(SimpleNamespace(complete=[alone, both]), judgement, combined, CATALOGUE)
        is both
    )
    said = "".join(second_words(named, combined, CATALOGUE))
    assert "most likely slow_sorption or two_rate_valve, whose response is the same" in said


def test_families_that_are_likely_are_not_denied() -> None:
    said = undecided_words(" in the fall", standing(0.0, 0.44, {"baseline": 0.56, "gain": 0.1}))
    assert "baseline 56 %" in said and "44 %" in said and "gain" not in said
    said = undecided_words("", standing(0.2, 0.4, {"baseline": 0.4}))
    assert "nor any family" in said and "may be missing" in said


def test_an_effect_of_the_noise_is_named_beside_an_empty_mean() -> None:
    combined = standing(0.0, 0.05, {}, {"heavy_tails": 0.95})
    assert judge(NOTHING, combined, CATALOGUE)[:2] == ("effect", ("heavy_tails",))


def test_a_hypothesis_that_was_not_tried_is_no_answer() -> None:
    comparison = Comparison(SimpleNamespace(), SimpleNamespace(), (), CATALOGUE, ())
    with pytest.raises(KeyError, match="dead_volume"):
        comparison.find("dead_volume")


def test_forms_are_averaged_by_their_evidence(monkeypatch) -> None:
    forms = {"near": (2.0, -3.0, 0.1), "far": (0.5, -2.0, 0.3)}  # ln evidence, ln tau, its sd
    monkeypatch.setattr(
        hypotheses, "Linearised",
        lambda name: SimpleNamespace(evidences=lambda beside: len(beside) * [SimpleNamespace(
            **dict(zip(("log_z", "log_tau", "sd_log_tau"), forms[name])))]),
    )  # fmt: skip
    monkeypatch.setattr(hypotheses, "jump_is_seen", lambda *_: False)

    class Named(str):
        loosened = property(lambda self: self)

    weighted = [(Named("near"), 0.25), (Named("far"), 0.75)]
    log_z, best, mean, sd, terms = hypotheses.average_over_forms(weighted, None, base=None)
    shares = np.array([0.25 * np.exp(2.0), 0.75 * np.exp(0.5)])
    assert log_z == pytest.approx(np.log(shares.sum())) and best == "near"
    shares /= shares.sum()
    assert mean == pytest.approx(shares @ [-3.0, -2.0])
    spread = shares @ [0.1**2 + (-3.0 - mean) ** 2, 0.3**2 + (-2.0 - mean) ** 2]
    assert sd == pytest.approx(np.sqrt(spread))
    kept = {term.refit: term.share for term in terms}
    assert kept == pytest.approx({"near": shares[0], "far": shares[1]})


def test_what_comes_nearest_to_an_unlisted_cause_is_told_where_none_was_stated():
    event = Finding(
        SIGNALS["event"], 1.0, {"event_experiment": 1.0, "event_s": 47.4, "event_ratio": 5.4}, 5.4
    )
    listed = Finding(SIGNALS["mains_pickup"], 1.5, {"mains_V": 1e-3, "mains_Hz": 50.0}, None)

    def told(findings, kind="none"):
        campaign = [SimpleNamespace(name=name) for name in "ab"]
        comparison = SimpleNamespace(binned=SimpleNamespace(campaign=campaign))
        judgement = Judgement(kind, (), None, 0.9)
        return nearest_finding(
            Conclusion(judgement, comparison, *[None] * 4, findings, (), (0.0, 1.0), "V")
        )

    (said,) = told([listed, event])
    assert "experiment b" in said and "47.4 s" in said and "5.4 times" in said
    assert f"put down to the noise ({100.0 * (1.0 - event.probability):.0f} %)" in said
    # what data do not speak for is no news, nor is a listed cause of the noise
    assert told([replace(event, log_bayes_factor=0.5), listed]) == []
    assert told([]) == [] and told([event], "effect") == []


def test_a_bump_that_passes_for_noise_is_in_the_notes_of_none():
    campaign = measured({}, seed=2)
    e = campaign.experiments[1]
    bump = np.where((e.t > 25.0) & (e.t < 27.0), 0.016, 0.0)
    campaign = campaign.with_data({e.name: e.values + bump})
    gap = diagnose_gap(campaign, bootstrap=0, separate=False, hidden=False, follow=False)
    assert gap.verdict.kind == "none"
    assert any("put down to the noise" in note for note in gap.notes)
