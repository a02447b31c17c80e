"""tau with the cause of a misfit in the model, where the posterior leaves that cause out."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from bayes_sensor.figures import effect_words
from bayes_sensor.figures.plot_gap import lag_of
from bayes_sensor.report.words import list_words


@dataclass(frozen=True)
class Cause:
    """What the verdict says is missing, and the lag with it in the model."""

    lag: str
    """symbol of the lag"""
    what: str
    """what is in the model, and stands for the cause"""
    option: str
    """of ``bayes-sensor posterior``, which samples it"""
    ends_s: tuple[float, float, float]
    """2.5, 50 and 97.5 %"""


def left_out(gap: Mapping[str, Any] | None, posterior: Mapping[str, Any] | None) -> Cause | None:
    """The cause that the verdict names and the posterior lacks; None where there is none.

    After an unlisted verdict a smooth discrepancy stands for it (Kennedy and O'Hagan, J. R. Stat.
    Soc. B 63, 425, 2001).  Where a family is named, the interval is averaged over explanations.
    What is in the noise moves no estimate of a lag.
    """
    if not gap:
        return None
    posterior = posterior or {}
    verdict, shrink = gap["verdict"], gap["shrink"]
    of, symbol = lag_of(gap["hidden"])
    names = list_words([effect_words(name) for name in verdict["effects"]])
    if verdict["kind"] == "unlisted" and not posterior.get("with_discrepancy"):
        what = "a smooth discrepancy in the model in place of the unlisted cause"
        option = "--with-discrepancy"
        row = gap.get(f"{of}_with_discrepancy_s") or {}
        ends = [row.get(key) for key in ("q2.5", "q50", "q97.5")]
    elif (
        verdict["kind"] in ("effect", "family")
        and not shrink.get("withheld")
        and shrink.get("of_mean", True)
        and not posterior.get("with_effects")
    ):
        one = verdict["kind"] == "effect"
        what = f"{names} in the model" if one else "the likely explanations of the misfit in turn"
        named = verdict["effects"] if one else verdict["effects"][:1]
        option = " ".join(f"--with-effect {name}" for name in named)
        ends = [shrink.get(f"{of}_after{end}_s") for end in ("_lo", "", "_hi")]
    else:
        return None
    low, middle, high = ends
    if low is None or middle is None or high is None:
        return None
    return Cause(symbol, what, option, (low, middle, high))
