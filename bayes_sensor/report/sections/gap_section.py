"""The gap between model and measurement: its place, its explanation, unseen effects."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from functools import partial
from typing import Any

from bayes_sensor import figures
from bayes_sensor.display import time_unit
from bayes_sensor.figures import effect_words
from bayes_sensor.figures.plot_gap import lag_of
from bayes_sensor.report.gap_words import gap_sentence
from bayes_sensor.report.parts import Part, Picture, Section, pointing, see
from bayes_sensor.report.saved import Saved
from bayes_sensor.report.sections.blind_check_section import published_goals
from bayes_sensor.report.sections.gap_tables import (
    CLEAR,
    UNSEEN,
    budget_table,
    hidden_table,
    other_tables,
    where_table,
    which_table,
)
from bayes_sensor.report.words import list_words, number, p_equals, sentence

_MEASURED = "Without a frame a shade is no more than noise makes."
_SHADES = {
    "explanations": "Shades and shares are what the explanations put there, each by its "
    "probability, something unlisted included: of a cell's own excess most may be noise.",
    "findings": "Shares are those of findings in single samples, which the bins average.",
}
"""words for what is drawn, by the origin of the shares, if that is not the measurement"""


def gap(saved: Saved) -> Section | None:
    """Budget, where, which, how far, and what may hide."""
    record = saved.gap
    if record is None:
        return None
    budget, verdict = record["budget"], record["verdict"]
    shown, factor = saved.small_unit
    is_limit = saved.headline is not None and saved.headline.is_limit
    answer = pointing(gap_sentence(record, is_limit), "which")
    paragraphs = [_size(budget, shown, factor)]
    if verdict["kind"] == "effect":
        who = list_words([effect_words(name) for name in verdict["effects"]])
        paragraphs.append(
            f"Named: {who}, with a probability of {number(verdict['probability'], 2)}"
            f"{see('which')}."
        )
    if verdict["kind"] != "none":
        paragraphs += _left_out(record.get("where_left_out_d") or {})
    paragraphs += shrink_sentences(record, shown, factor)
    paragraphs += _more(record)
    paragraphs += envelope_sentences(record, is_limit)
    paragraphs += [sentence(note) for note in record.get("notes") or []]
    paragraphs.append(
        "Causes outside the catalogue are the weak point of such a verdict: they may pass for "
        f"noise, or for a similar effect{see('gap-right')}."
    )
    title = "Where is the gap, and what causes it"
    return Section("gap", title, answer, paragraphs, list(_content(record, saved)))


def _content(record: Mapping[str, Any], saved: Saved) -> Iterator[Part]:
    shown, factor = saved.small_unit
    yield budget_table(record, shown, factor)
    yield Picture(
        "gap-where",
        partial(figures.gap_where, record["where"], saved.unit),
        "Where the gap lies: excess over the noise floor by experiment and phase of the step. "
        "Numbers: share of the whole; framed: p of the measured excess below 5 %, as the "
        f"largest of all cells. {_SHADES.get(record.get('where_shared_by', ''), _MEASURED)}",
    )
    if record.get("residuals"):
        yield Picture(
            "gap-residuals",
            partial(figures.gap_residuals, record["residuals"]),
            "Residuals in bins locked to the switches and whitened by the noise floor. Noise "
            "alone is within the grey strip of ± 2 in nineteen of twenty bins.",
        )
    yield where_table(record, shown, factor)
    yield Picture(
        "gap-which",
        partial(figures.gap_which, record),
        "What explains it: probabilities of the explanations and of their families. Hatched: "
        "no effect at all, and something that is not in the catalogue.",
    )
    yield which_table(record)
    if record["hidden"]["effects"]:
        of, lag = lag_of(record["hidden"])
        tau = record["shrink"].get(f"{of}_before_s")
        yield Picture(
            "gap-hidden",
            partial(figures.gap_hidden, record["hidden"], tau),
            "What may hide: how visible each effect would be at its plausible strength, and "
            f"what {lag} would be with it in the model. To the left of the dashed line this "
            f"campaign cannot show it; dotted, {lag} with the strength left to the data; "
            f"shaded, the envelope of {lag} over all that may hide.",
        )
    yield hidden_table(record)
    yield from other_tables(record)
    if saved.published:
        yield published_goals()


def _size(budget: Mapping[str, Any], shown: str, factor: float) -> str:
    """The difference between model and measurement, and whether noise alone explains it."""
    p, of_form = budget["p_value"], budget.get("p_value_of_form")
    of_size = budget.get("p_value_of_size", p)
    by_noise = of_size is not None and of_size > CLEAR
    size = "" if by_noise else f"d = {number(budget['excess_d'])} standard deviations, "
    words = (
        f"Model and measurement differ by {number(factor * budget['excess_rms_V'])} {shown} RMS "
        f"above the noise floor of {number(factor * budget['noise_floor_rms_V'])} {shown} "
        f"({size}p {p_equals(of_size)}){see('budget-table', 'where')}"
    )
    if not by_noise:
        return f"{words}."
    if of_form is None or of_form > CLEAR:
        return f"{words}, no more than noise alone would leave."
    return (
        f"{words}. By its size that is no more than noise alone would leave, but along the course "
        f"of a listed effect it is (p {p_equals(of_form)} for the largest of all courses)."
    )


def _left_out(left_out: Mapping[str, float | None]) -> list[str]:
    """The phase that a fit to the others predicts worst."""
    found = {phase: d for phase, d in left_out.items() if d is not None}
    if not found:
        return []
    worst = max(found, key=lambda phase: found[phase])
    return [
        f"A fit to all other phases predicts the {worst} worst (d = {number(found[worst])}): a "
        "joint fit smears a misfit over the phases, this does not."
    ]


def _more(record: Mapping[str, Any]) -> Iterator[str]:
    """What is left with the named effects in the model, and how to tell pairs apart."""
    for row in record.get("rounds") or []:
        names = list_words([effect_words(name) for name in row["added"]])
        yield (
            f"With {names} in the model, d = {number(row['d_left'])} is left (p "
            f"{p_equals(row['p_left'])}){see('gap-rounds')}."
        )
    for row in record.get("separate") or []:
        if row["addition"]:
            yield (
                f"To tell {effect_words(row['effect'])} from {effect_words(row['rival'])}: "
                f"{row['addition']}{see('gap-separate')}."
            )


def shrink_sentences(record: Mapping[str, Any], shown: str, factor: float) -> list[str]:
    """How far the best explanation closes the gap, and what tau is with it."""
    shrink = record["shrink"]
    if shrink.get("withheld") or shrink.get("fraction_closed") is None:
        return [
            "The gap is too small, or nothing was named, so no fraction of it can be said to close."
        ]
    of_mean = shrink.get("of_mean", True)
    effect = effect_words(shrink.get("explanation") or "the effect")
    what = "the excess" if of_mean else "its part of the noise"

    def percent(*keys: str) -> str:
        return " to ".join(f"{100 * shrink[key]:.0f}" for key in keys) + " %"

    said = (
        f"Once {effect} is {'in the model' if of_mean else 'taken off every record'}, {what} falls "
        f"from {number(factor * shrink['before_excess_rms_V'])} to "
        f"{number(factor * shrink['after_excess_rms_V'])} {shown}{'' if of_mean else ' RMS'}: "
        f"{percent('fraction_closed')} of the gap closes"
    )
    if shrink.get("fraction_closed_lo") is not None:
        said += f" (95 % interval {percent('fraction_closed_lo', 'fraction_closed_hi')})"
    if shrink.get("held_out_fraction_closed") is not None:
        said += f", and {percent('held_out_fraction_closed')} on data that were left out"
        if shrink.get("held_out_fraction_closed_lo") is not None:
            ends = ("held_out_fraction_closed_lo", "held_out_fraction_closed_hi")
            said += f" ({percent(*ends)})"
    said += see("budget-table") + "."
    of, lag = lag_of(record["hidden"])
    before, after = shrink.get(f"{of}_before_s"), shrink.get(f"{of}_after_s")
    if before is not None and after is not None and of_mean:
        moves = f"{lag.replace('the', 'The')} moves"
        said += f" {moves} from {number(1e3 * before)} to {number(1e3 * after)} ms"
        low, high = shrink.get(f"{of}_after_lo_s"), shrink.get(f"{of}_after_hi_s")
        if low is not None and high is not None:
            said += f" (95 % interval {number(1e3 * low)} to {number(1e3 * high)} ms)"
        said += (
            f", by what was weighed here: the cause is not known, and {lag} may lie outside."
            if record["verdict"]["kind"] == "unlisted"
            else "."
        )
    if shrink.get("rival") and shrink.get("rival_fraction_closed") is not None:
        said += (
            f" The best rival outside the family, {effect_words(shrink['rival'])}, closes "
            f"{percent('rival_fraction_closed')}."
        )
    return [
        said,
        "The fraction is of the squared misfit in units of the noise, bin by bin, not of the "
        "volts: long quiet bins count more. The interval reaches 100 % unless there is "
        "evidence that something is left; held out, where noise is only taken off on average, the "
        "fraction itself may pass 100 %. A large one alone proves no cause: a wrong effect often "
        "closes most of a gap. The ranking weighs the explanations against each other.",
    ]


def envelope_sentences(record: Mapping[str, Any], is_limit: bool) -> list[str]:
    """Effects that would leave no trace, and the range of tau over them."""
    hidden = record["hidden"]
    unseen = [
        row
        for row in hidden["effects"]
        if row["d"] is not None and row["d"] < UNSEEN and not row.get("contradicted")
    ]
    if not unseen:
        return []
    of, lag = lag_of(hidden)
    unseen.sort(key=lambda row: -abs(row[f"{of}_shift_s"] or 0.0))
    names = list_words([effect_words(row["effect"]) for row in unseen], most=5)
    said = f"Present at plausible strength, {names} would leave no trace that these data could show"
    low, high = hidden.get(f"{of}_envelope_s") or (None, None)
    if low is not None and high is not None:
        per_s, unit = time_unit(high)
        said += (
            f"; over all that may hide, {lag} lies between {number(per_s * low, 2)} and "
            f"{number(per_s * high, 2)} {unit}"
        )
    said += see("hidden") + "."
    if is_limit:
        said += (
            " The diagnosis works with ln τ, so its values of τ stay above zero and its lower end "
            "excludes nothing; read the upper one."
        )
    return [said]
