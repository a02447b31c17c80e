"""What the verdict says, and what it leaves open."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from bayes_sensor.diagnosis.diagnose import diagnose_gap
from bayes_sensor.diagnosis.effects import CATALOGUE
from bayes_sensor.diagnosis.evidence import hypotheses
from bayes_sensor.diagnosis.evidence.compared_hypotheses import Comparison
from bayes_sensor.diagnosis.probabilities import Probabilities
from bayes_sensor.diagnosis.signals.signal import Finding
from bayes_sensor.diagnosis.verdict import OFTEN, Judgement, judge
from bayes_sensor.diagnosis.wording import (
    Conclusion,
    family_words,
    instead_words,
    nearest_finding,
    second_words,
    undecided_words,
)
from tests.support.planted_effects import SIGNALS, measured


def rows_of(none: float, unlisted: float, **rows: float) -> Probabilities:
    """A vector with these rows; what is left of the whole goes to the first effect on the mean."""
    rows = {"none": none, "unlisted": unlisted, **rows}
    return Probabilities({**dict.fromkeys(CATALOGUE, 0.0), **rows}, CATALOGUE)


def joined(none: float, unlisted: float, rows: dict[str, float]) -> Probabilities:
    return rows_of(none, unlisted, **rows)


def test_a_row_is_named_where_its_effects_are_sure_at_its_own_probability() -> None:
    kind, effects, family, p = judge(rows_of(0.02, 0.05, dead_volume=0.93), 0.0)
    assert (kind, effects, family, p) == ("effect", ("dead_volume",), "slow exchange", 0.93)
    two = joined(0.0, 0.05, {"flow_error+carry_over": 0.95})
    assert judge(two, 0.0)[:2] == ("effect", ("flow_error", "carry_over"))
    # just short of it, the family is stated, with its own
    kind, effects, family, p = judge(rows_of(0.02, 0.1, dead_volume=0.88), 0.0)
    assert (kind, family, p) == ("family", "slow exchange", 0.88) and effects[0] == "dead_volume"


def test_what_cannot_be_told_by_its_nature_is_not_named() -> None:
    assert judge(rows_of(0.0, 0.02, slow_sorption=0.98), 0.0).kind == "family"
    twins = joined(0.0, 0.02, {"flow_switching+valve_asymmetry": 0.98})
    kind, effects, family, p = judge(twins, 0.0)
    assert (kind, family, p) == ("family", "asymmetry", 0.98)
    assert set(effects[:2]) == {"flow_switching", "valve_asymmetry"}


@pytest.mark.parametrize(
    ("none", "unlisted", "in_family", "kind"),
    [
        (0.6, 0.2, 0.2, "none"),
        (0.2, 0.2, 0.6, "family"),
        (0.2, 0.6, 0.2, "unlisted"),
        (0.34, 0.33, 0.33, "none"),
        (0.3, 0.3, 0.4, "family"),
    ],
)
def test_otherwise_the_likeliest_is_stated(none, unlisted, in_family, kind) -> None:
    vector = rows_of(none, unlisted, flow_error=in_family)
    said = judge(vector, 0.01)
    assert said.kind == kind
    assert said.probability == {"none": none, "unlisted": unlisted, "family": in_family}[kind]


def test_nothing_is_called_unlisted_where_noise_often_leaves_as_much() -> None:
    vector = rows_of(0.2, 0.7, flow_error=0.1)
    assert judge(vector, OFTEN).kind == "unlisted"
    assert judge(vector, OFTEN + 0.01)[::3] == ("none", 0.2)
    likelier = rows_of(0.05, 0.7, flow_error=0.25)
    assert judge(likelier, 0.5).kind == "family"


def test_an_effect_of_the_noise_is_there_whatever_explains_the_mean() -> None:
    vector = joined(0.0, 0.05, {"heavy_tails": 0.55, "flow_error+heavy_tails": 0.4})
    kind, effects, family, p = judge(vector, 0.01)
    assert (kind, effects, family) == ("effect", ("heavy_tails",), "noise law")
    assert p == 0.55 == vector.unmoved and vector.effects["heavy_tails"] == pytest.approx(0.95)
    # less sure, it is its family
    vector = joined(0.1, 0.15, {"heavy_tails": 0.75})
    assert judge(vector, 0.01)[:3] == ("family", ("heavy_tails",), "noise law")
    mean = joined(0.0, 0.05, {"heavy_tails": 0.4, "flow_error+heavy_tails": 0.55})
    assert judge(mean, 0.01).family == CATALOGUE["flow_error"].family


@pytest.mark.parametrize(
    ("probability", "leading", "other", "said"),
    [
        (0.45, 0.4, "", "above one half in the rise; the likeliest is a (45 %)."),
        (0.45, 0.2, "", "in the rise; the likeliest is one of a, B (45 %)."),
        (0.8, 0.7, "", "One of a, B explains the gap in the rise (80 %), most likely a."),
        (0.8, 0.7, "b", "a, or b, whose response is the same, explains the gap in the rise (80 %)"),
        (0.8, 0.4, "", "One of a, B explains the gap in the rise (80 %); this campaign does not"),
    ],
)
def test_of_a_family_no_more_is_said_than_is_known(probability, leading, other, said) -> None:
    assert said in family_words(["a", "B"], probability, leading, " in the rise", other)


def test_the_likeliest_of_another_family_is_said_where_nothing_unlisted_is_likelier() -> None:
    rows = {"gain_drift": 0.5, "baseline_drift": 0.2, "baseline_drift+heavy_tails": 0.09}
    said = instead_words(["gain_drift"], joined(0.0, 0.21, rows), CATALOGUE)
    assert said == ["If it is not that, baseline_drift (29 %)."]
    assert instead_words(["gain_drift"], joined(0.0, 0.3, rows), CATALOGUE) == []
    # what would stand beside the named one is not instead of it
    beside = {"gain_drift+baseline_drift": 0.6, "gain_drift": 0.35}
    assert instead_words(["gain_drift"], joined(0.0, 0.05, beside), CATALOGUE) == []


def test_what_is_likely_beside_a_name_is_said() -> None:
    vector = joined(0.0, 0.05, {
        "flow_switching+baseline_drift": 0.69, "flow_switching+baseline_step": 0.1,
        "flow_switching": 0.16,
    })  # fmt: skip
    said = "".join(second_words(["flow_switching"], vector, CATALOGUE))
    assert "the family baseline (79 %), most likely baseline_drift" in said
    alone = rows_of(0.0, 0.05, flow_switching=0.95)
    assert second_words(["flow_switching"], alone, CATALOGUE) == []


def test_families_that_are_likely_are_not_denied() -> None:
    vector = joined(0.0, 0.44, {"baseline_drift": 0.55, "gain_drift": 0.01})
    said = undecided_words(" in the fall", vector)
    assert "baseline 55 %" in said and "44 %" in said and "gain" not in said
    said = undecided_words("", joined(0.2, 0.4, {"baseline_drift": 0.4}))
    assert "No answer (no cause, a family" in said and "may be missing" in said


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
