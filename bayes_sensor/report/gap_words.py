"""The verdict of the diagnosis in words, and tau with the effect that it names."""

from __future__ import annotations

import re
from collections.abc import Mapping
from typing import Any

from bayes_sensor.figures import effect_words
from bayes_sensor.figures.plot_gap import lag_of
from bayes_sensor.report.saved import Saved
from bayes_sensor.report.words import (
    interval,
    list_words,
    ms,
    number,
    sentence,
    typeset,
    with_spread,
)


def gap_sentence(gap: Mapping[str, Any], is_limit: bool) -> str:
    """The verdict in words.

    ``is_limit``: zero is not excluded.  The diagnosis works in ln tau, so the lower end of its
    envelope is never zero and has no meaning there.  Only the upper end is stated.
    """
    verdict = gap["verdict"]
    words = verdict["sentence"]
    rows = [row["effect"] for row in gap.get("which") or []]
    for name in {*verdict["effects"], *(row for row in rows if "_" in row and "+" not in row)}:
        words = words.replace(name, effect_words(name))
    low, high = gap["hidden"].get("tau_envelope_s") or (None, None)
    if verdict["kind"] == "none" and low is not None and high is not None:
        upper = f"{number(1e3 * high, 2)} ms"
        reach = f"reach {upper}" if is_limit else f"be from {number(1e3 * low, 2)} to {upper}"
        words = re.sub(r"could be anywhere from \S+ to \S+ m?s\b", f"could {reach}", words)
    return sentence(typeset(re.sub(r"(\d)%", r"\1 %", words)))


def with_the_effect(saved: Saved) -> str:
    """tau with the cause in the model, if the posterior leaves it out; else nothing.

    The cause: the effect that the gap names, or after an unlisted verdict a smooth discrepancy.
    """
    gap, posterior = saved.gap or {}, saved.posterior or {}
    if not gap:
        return ""
    verdict, shrink = gap["verdict"], gap["shrink"]
    of, symbol = lag_of(gap["hidden"])
    if verdict["kind"] == "unlisted" and not posterior.get("with_discrepancy"):
        what = "a smooth discrepancy in the model, which stands for the unlisted cause,"
        option = "--with-discrepancy"
        with_it = gap.get(f"{of}_with_discrepancy_s") or {}
        ends = [ms(with_it.get(key)) for key in ("q2.5", "q50", "q97.5")]
    # what is in the noise moves no estimate of tau
    elif (
        verdict["kind"] == "effect"
        and not shrink.get("withheld")
        and shrink.get("of_mean", True)
        and not posterior.get("with_effects")
    ):
        what = f"{list_words([effect_words(name) for name in verdict['effects']])} in the model"
        option = " ".join(f"--with-effect {name}" for name in verdict["effects"])
        ends = [ms(shrink.get(f"{of}_after{end}_s")) for end in ("_lo", "", "_hi")]
    else:
        return ""
    low, mid, high = ends
    if low is None or mid is None or high is None:
        return ""
    return (
        f"With {what} {symbol} is {with_spread(mid, high - low)} ms, 95 % interval "
        f"{interval(low, high)} ms: quote that, not the interval without it, or sample it with "
        f"bayes-sensor posterior {option}."
    )
