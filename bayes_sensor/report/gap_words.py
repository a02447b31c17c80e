"""The verdict of the diagnosis in words, and tau with the effect that it names."""

from __future__ import annotations

import re
from collections.abc import Mapping
from typing import Any

from bayes_sensor.figures import effect_words
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
        reach = f"reach {upper}" if is_limit else f"lie from {number(1e3 * low, 2)} to {upper}"
        words = re.sub(r"(tau could) lie anywhere from \S+ to \S+ ms", rf"\1 {reach}", words)
    return sentence(typeset(re.sub(r"(\d)%", r"\1 %", words)))


def with_the_effect(saved: Saved) -> str:
    """tau with the named effect in the model, if the posterior leaves it out; else nothing."""
    if saved.gap is None:
        return ""
    verdict, shrink = saved.gap["verdict"], saved.gap["shrink"]
    if verdict["kind"] == "unlisted":
        return _with_discrepancy(saved)
    low, mid, high = (ms(shrink.get(f"tau_after{end}_s")) for end in ("_lo", "", "_hi"))
    if verdict["kind"] != "effect" or shrink.get("withheld"):
        return ""
    if not shrink.get("of_mean", True):  # what is in the noise moves no estimate of tau
        return ""
    if low is None or mid is None or high is None:
        return ""
    if saved.posterior is not None and saved.posterior.get("with_effects"):
        return ""
    return (
        f"With {list_words([effect_words(name) for name in verdict['effects']])} in the model "
        f"τ is {with_spread(mid, high - low)} ms, 95 % interval {interval(low, high)} ms: quote "
        "that, not the interval without it, or sample it with bayes-sensor posterior --with-effect "
        f"{' --with-effect '.join(verdict['effects'])}."
    )


def _with_discrepancy(saved: Saved) -> str:
    """tau with a smooth discrepancy in the model, after an unlisted verdict."""
    gap, posterior = saved.gap or {}, saved.posterior or {}
    if posterior.get("with_discrepancy"):
        return ""
    symbol = "τ" if gap.get("tau_with_discrepancy_s") else "the shorter lag"
    found = gap.get("tau_with_discrepancy_s") or gap.get("lag_fast_with_discrepancy_s")
    if not found:
        return ""
    low, mid, high = (1e3 * found[key] for key in ("q2.5", "q50", "q97.5"))
    return (
        f"With a smooth discrepancy in the model, which stands for the unlisted cause, {symbol} is "
        f"{with_spread(mid, high - low)} ms, 95 % interval {interval(low, high)} ms: quote that, "
        "not the interval without it, or sample it with bayes-sensor posterior --with-discrepancy."
    )
