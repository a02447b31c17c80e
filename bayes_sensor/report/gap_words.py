"""The verdict of the diagnosis in words, and tau with the effect that it names."""

from __future__ import annotations

import re
from collections.abc import Mapping
from typing import Any

from bayes_sensor.display import time_unit
from bayes_sensor.figures import effect_words
from bayes_sensor.report.cause_left_out import left_out
from bayes_sensor.report.headline import lag_words
from bayes_sensor.report.saved import Saved
from bayes_sensor.report.words import number, sentence, typeset


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
        per_s, unit = time_unit(high)
        upper = f"{number(per_s * high, 2)} {unit}"
        reach = f"reach {upper}" if is_limit else f"be from {number(per_s * low, 2)} to {upper}"
        words = re.sub(r"could be anywhere from \S+ to \S+ m?s\b", f"could {reach}", words)
    return sentence(typeset(re.sub(r"(\d)%", r"\1 %", words)))


def with_the_effect(saved: Saved) -> str:
    """tau with the cause in the model, if the posterior leaves it out; else nothing."""
    cause = left_out(saved.gap, saved.posterior)
    if cause is None:
        return ""
    return (
        f"With {cause.what} {cause.lag} is {lag_words(*cause.ends_s)}: quote that, not the "
        f"interval without it, or sample it with bayes-sensor posterior {cause.option}."
    )
