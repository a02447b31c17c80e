"""How far an explanation goes, in lines for the terminal: share of the gap closed, and tau."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from bayes_sensor.display import shown, time_unit


def how_far_lines(said: Mapping[str, Any]) -> list[str]:
    """Two lines after a verdict: what closes, in sample and held out; tau.

    ``said``: the content of gap.json.  Neither where nothing is missing.
    """
    kind, shrink = said["verdict"]["kind"], said["shrink"]
    if kind == "none":
        return []
    return [_closed(kind, shrink), _tau(said, kind == "unlisted")]


def _closed(kind: str, shrink: Mapping[str, Any]) -> str:
    fraction = shrink["fraction_closed"]
    if fraction is None:
        return "closed: not given, because the gap is not clearly above the noise"
    nearest = "the nearest of the catalogue, " if kind == "unlisted" else ""
    if shrink["explanation"] == "none":
        return "closed: no effect of the catalogue closes any of the gap"
    said = f"closed: {_share(shrink, 'fraction_closed')} of the gap with {nearest}"
    said += str(shrink["explanation"])
    if shrink["held_out_fraction_closed"] is not None:
        said += f"; {_share(shrink, 'held_out_fraction_closed')} on data left out of the fit"
    return said


def _share(shrink: Mapping[str, Any], key: str) -> str:
    low, high = shrink.get(f"{key}_lo"), shrink.get(f"{key}_hi")
    words = f"{100.0 * shrink[key]:.0f} %"
    if low is None or high is None:
        return words
    return f"{words} (95 %: {100.0 * low:.0f} to {100.0 * high:.0f} %)"


def _tau(said: Mapping[str, Any], unlisted: bool) -> str:
    shrink = said["shrink"]
    key = "lag_fast" if "lag_fast_before_s" in shrink else "tau"
    told = [value for k, value in shrink.items() if k.startswith(f"{key}_") and k.endswith("_s")]
    per_s, unit = time_unit(max(v for v in told if v))
    each = []
    for when, words in (("before", "without an effect"), ("after", "with the explanations")):
        middle, low, high = (shrink.get(f"{key}_{when}{end}_s") for end in ("", "_lo", "_hi"))
        if middle is None:
            continue
        span = ""
        if low is not None and high is not None:
            span = f" (95 %: {shown(per_s * low, 3)} to {shown(per_s * high, 3)} {unit})"
        each.append(f"{shown(per_s * middle, 3)} {unit}{span} {words}")
    wide = said.get(f"{key}_with_discrepancy_s")
    if unlisted and wide is not None:
        low, middle, high = (shown(per_s * wide[q], 3) for q in ("q2.5", "q50", "q97.5"))
        each[1:] = [
            f"{middle} {unit} (95 %: {low} to {high} {unit}) with a discrepancy in the model"
        ]
    return f"{said['hidden']['lag'].removeprefix('the ')}: {', '.join(each)}"
