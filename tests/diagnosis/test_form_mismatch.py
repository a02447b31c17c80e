"""Effects in a form of their own: what they leave of themselves is no other cause."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from bayes_sensor.diagnosis.calibration import calibration
from bayes_sensor.diagnosis.closed_fraction import VISIBLE
from bayes_sensor.diagnosis.effects import CATALOGUE
from bayes_sensor.diagnosis.evidence.form_mismatch import (
    GATE,
    OTHER_FORM,
    leaves_explanation_alone,
    simpler_explanation,
    within_form_mismatch,
)
from bayes_sensor.diagnosis.probabilities import combine
from bayes_sensor.diagnosis.signals.signal import FOUND, Finding
from bayes_sensor.diagnosis.verdict import NAMED, judge
from bayes_sensor.diagnosis.wording import form_words
from tests.support.planted_effects import SIGNALS

WHOLE = 10_000.0
"""of the misfit that there is to explain: d = 100"""
A, B = "carry_over", "baseline_step"
FORM_STATED = "effect" if 1.0 - calibration().form_unlisted > NAMED else "family"
"""what is stated of an effect that leaves what may be another form of it, by the map"""


class Taking:
    """A discrepancy that takes so much of the misfit, all of it in the first bin."""

    def __init__(self, taken: float):
        self.taken = taken
        self.name = "drift"


def refit(misfit: float) -> Any:
    """A refit that leaves so much."""
    residual = np.array([np.sqrt(misfit), 0.0])
    return SimpleNamespace(
        misfit=misfit, residual=residual, coords=SimpleNamespace(parts=[], binned=None, size=0)
    )


def hypothesis(effects: tuple[str, ...], misfit: float, p: float, beside: float = 0.0) -> Any:
    """What explains all but ``misfit``, of which something beside it takes ``beside``."""
    made = refit(misfit)
    term = SimpleNamespace(share=1.0, refit=made, beside=Taking(beside) if beside else None)
    return SimpleNamespace(
        effects=effects, incomplete=beside > 0.0, refit=made, terms=(term,), within="",
        log_weight=np.log(p), leftover=0.0, excess=0.0, key="+".join(effects) or "none", p=p,
    )  # fmt: skip


def weighed(*hypotheses: Any) -> Any:
    """A comparison of these, and of what is in none of them with next to no probability."""
    made = list(hypotheses)
    for effects in ((), (A,), (B,)):
        if not any(h.effects == effects and not h.incomplete for h in made):
            made.append(hypothesis(effects, WHOLE + 100.0, 1e-12))
    complete = [h for h in made if not h.incomplete]

    def find(*names: str) -> Any:
        return next(h for h in complete if h.effects == names)

    return SimpleNamespace(
        base=refit(WHOLE + 100.0), hypotheses=made, complete=complete, find=find,
        probabilities=np.array([h.p for h in made]) / sum(h.p for h in made),
        likeliest=max(complete, key=lambda h: h.log_weight),
    )  # fmt: skip


@pytest.fixture(autouse=True)
def taking(monkeypatch: pytest.MonkeyPatch) -> None:
    """Discrepancies of this file take what they say."""
    import bayes_sensor.diagnosis.evidence.form_mismatch as form

    def linearised(fitted: Any) -> Any:
        return SimpleNamespace(
            left=lambda beside: np.array([np.sqrt(fitted.misfit - beside.taken), 0.0])
        )

    monkeypatch.setattr(form, "Linearised", linearised)


def pair(left: float, p: float = 0.99) -> Any:
    """A pair whose first effect alone leaves ``left`` of the whole's size."""
    return weighed(
        hypothesis((A, B), 100.0, p), hypothesis((A,), 100.0 + left**2 * WHOLE, 1e-12),
    )  # fmt: skip


@pytest.mark.parametrize("left", [0.04, 0.12, 0.19])
def test_a_small_second_effect_may_be_the_form_of_the_first(left: float) -> None:
    comparison = pair(left)
    form = simpler_explanation(comparison.hypotheses[0], comparison)
    assert form is not None and form.effects == (A,)
    assert form.left == pytest.approx(left)


@pytest.mark.parametrize("left", [0.021, OTHER_FORM + 0.01, 0.6])
def test_what_is_not_seen_or_too_much_is_no_form(left: float) -> None:
    assert (left * 100.0 < VISIBLE) or left > OTHER_FORM
    comparison = pair(left)
    assert simpler_explanation(comparison.hypotheses[0], comparison) is None


def test_something_small_beside_an_effect_may_be_its_form() -> None:
    for left, found in ((0.02, False), (0.1, True), (0.3, False)):
        h = hypothesis((A,), 100.0 + left**2 * WHOLE, 0.9, beside=left**2 * WHOLE)
        form = simpler_explanation(h, weighed(h, hypothesis((A,), h.refit.misfit, 1e-9)))
        assert (form is not None) == found
        if form:
            assert form.effects == (A,) and form.left == pytest.approx(left)


def test_two_effects_with_little_beside_them_are_both_there() -> None:
    h = hypothesis((A, B), 200.0, 0.9, beside=100.0)
    comparison = weighed(h, hypothesis((A, B), 200.0, 1e-9), hypothesis((A,), 3000.0, 1e-9))
    form = simpler_explanation(h, comparison)
    assert form is not None and form.effects == (A, B)
    assert form.left == pytest.approx(0.1, rel=0.01)
    # unless the second mends little of the first
    comparison = weighed(h, hypothesis((A, B), 200.0, 1e-9), hypothesis((A,), 350.0, 1e-9))
    form = simpler_explanation(h, comparison)
    assert form is not None and form.effects == (A,)


def test_none_single_effects_and_something_else_have_no_other_form() -> None:
    plain = hypothesis((A,), 300.0, 0.5)
    other = hypothesis((), WHOLE, 0.4, beside=WHOLE - 100.0)
    comparison = weighed(plain, other)
    for h in (plain, other, comparison.find()):
        assert simpler_explanation(h, comparison) is None


def test_a_second_effect_that_may_be_a_form_is_not_named() -> None:
    small, large = pair(0.12), pair(0.5)
    for comparison, both in ((small, False), (large, True)):
        combined = combine(comparison, [], CATALOGUE)
        assert sum(combined.rows.values()) == pytest.approx(1.0)
        assert (combined.effects[B] > 0.9) == both
        kind, named, _, probability = judge(combined, 0.0)
        if both:
            assert kind == "effect" and set(named) == {A, B}
        else:
            assert kind == FORM_STATED and named[0] == A and B not in named
            assert combined.unlisted == pytest.approx(calibration().form_unlisted, abs=0.02)
            assert 0.8 < probability < 1.0


def test_an_effect_with_its_form_beside_it_is_not_called_unlisted() -> None:
    for left, kind in ((0.12, FORM_STATED), (0.4, "unlisted")):
        h = hypothesis((A,), 100.0 + left**2 * WHOLE, 0.99, beside=left**2 * WHOLE)
        comparison = weighed(h, hypothesis((A,), h.refit.misfit, 1e-6))
        assert judge(combine(comparison, [], CATALOGUE), 0.0)[0] == kind


def off_for_a_while(left: float, name: str = "break", log_b: float = 50.0) -> Finding:
    """A finding of ``left`` of the whole's size in what an explanation leaves."""
    return Finding(SIGNALS[name], log_b, {}, left * np.sqrt(WHOLE))


@pytest.mark.parametrize("name", ["patch", "break"])
def test_a_short_stay_off_an_effect_may_be_its_form(name: str) -> None:
    fitted, base = refit(100.0), refit(WHOLE + 100.0)
    for left, may_be in ((0.1, True), (0.19, True), (0.21, False), (0.8, False)):
        assert within_form_mismatch(off_for_a_while(left, name), fitted, base) == may_be
        assert leaves_explanation_alone(off_for_a_while(left, name), fitted, base) == may_be
    # what is hardly there is left to take the little that it takes
    faint = off_for_a_while(0.1, name, log_b=1.0)
    assert faint.probability < FOUND and not within_form_mismatch(faint, fitted, base)


def test_other_findings_are_no_form_of_an_effect() -> None:
    fitted, base = refit(100.0), refit(WHOLE + 100.0)
    for name in ("ringing", "swing", "unsteady", "event"):
        assert not within_form_mismatch(off_for_a_while(0.1, name), fitted, base)


def test_a_small_break_takes_nothing_from_a_strong_effect() -> None:
    for left, kind in ((0.1, "effect"), (0.3, "unlisted")):
        comparison = weighed(hypothesis((A,), 100.0, 0.999))
        combined = combine(comparison, [off_for_a_while(left)], CATALOGUE)
        assert judge(combined, 0.0)[0] == kind
    # and from no effect it takes all that it can: nothing has no form
    comparison = weighed(hypothesis((), WHOLE + 100.0, 0.999))
    combined = combine(comparison, [off_for_a_while(0.1)], CATALOGUE)
    assert combined.unlisted > off_for_a_while(0.1).probability - 0.05


@pytest.mark.parametrize("members", [(A,), ("slow_sorption", "two_rate_valve")])
def test_what_leaves_too_much_for_noise_and_for_a_form_is_unlisted(
    members: tuple[str, ...],
) -> None:
    stated = "effect" if len(members) == 1 else "family"  # one response: neither is named alone
    for leftover, share, kind in (
        (GATE - 0.1, 0.5, stated), (GATE, 0.5, "unlisted"),
        (10.0 * GATE, OTHER_FORM - 0.01, stated), (10.0 * GATE, OTHER_FORM + 0.01, "unlisted"),
    ):  # fmt: skip
        made = [hypothesis((name,), 100.0, 0.98 / len(members)) for name in members]
        for h in made:
            h.leftover, h.excess = leftover, share**2 * WHOLE
        comparison = weighed(*made)
        found, _, _, p = judge(combine(comparison, [], CATALOGUE), 0.0)
        assert found == kind and p >= 0.5


def test_the_sentence_says_what_is_left_and_what_it_may_be() -> None:
    (said,) = form_words(pair(0.12), [A])
    assert "carry_over leaves, 12 % of the gap's size, may be baseline_step beside it" in said
    assert form_words(pair(0.5), [A, B]) == []
    assert form_words(pair(0.12), [B]) == []
    h = hypothesis((A,), 200.0, 0.9, beside=100.0)
    (said,) = form_words(weighed(h, hypothesis((A,), 200.0, 1e-9)), [A])
    assert "may be something else beside it" in said
