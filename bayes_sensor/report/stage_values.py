"""The stages of the rig with what was found of each, for the drawing of the chain."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any

from bayes_sensor.display import time_unit
from bayes_sensor.figures import Box
from bayes_sensor.figures.method_words import quoted
from bayes_sensor.report.headline import LIMIT, count_limits, stated_set
from bayes_sensor.report.saved import Saved
from bayes_sensor.report.words import interval, number, time_words, with_spread

SYMBOLS = {"sensor": ("tau_s",), "valve": ("tau_v_s",), "manifold": ("V_mL",)}
"""parameters that are not called after their stage"""


def stage_values(saved: Saved) -> list[Box]:
    """Each stage with its lag or its volume; a value that is not known is left out.

    Lags that cannot be assigned to stages are given at each stage that may have them.
    """
    stages = saved.campaign.get("stages") or []
    found = _estimates(saved)
    made = []
    for text in stages:
        name = str(text).partition(":")[0].strip()
        keys = SYMBOLS.get(name, (f"tau_{name}_s", f"V_{name}_mL"))
        rows = [(key, row) for key, row in found.items() if key.partition("[")[0] in keys]
        words = [line for key, row in rows for line in _lines(key, row, saved)]
        is_volume = any(key.startswith("V") for key in keys) and name not in SYMBOLS
        if not words and not is_volume and name != "manifold":
            words = _unassigned(saved.posterior)
        made.append(Box(name, tuple(words), is_sensor=name == "sensor"))
    return made


def _estimates(saved: Saved) -> dict[str, Mapping[str, Any]]:
    """Percentiles by name: of the posterior, else the fitted values."""
    if saved.posterior is not None:
        rows = saved.posterior["parameters"]
        if saved.posterior.get("hidden_by_sampling_s") is not None:
            return {}
        if saved.posterior.get("order") == "undecided":
            rows = {name: row for name, row in rows.items() if not name.startswith("tau")}
        return {name: row for name, row in rows.items() if row}
    method = quoted(saved.bounds)
    if saved.bounds is not None and method is not None:
        rows = saved.bounds["methods"][method]["parameters"]
        ends = {"q2.5": "lo95", "q50": "estimate", "q97.5": "hi95"}
        return {
            name: {key: row[end] for key, end in ends.items()}
            for name, row in rows.items()
            if row and row["estimate"] is not None
        }
    fit = saved.fit or {}
    values = fit.get("estimates") or fit.get("parameters") or {}
    return {name: {"q50": v} for name, v in values.items() if isinstance(v, float | int)}


def _unassigned(posterior: Mapping[str, Any] | None) -> list[str]:
    """The lags that do not depend on flow, which nobody can assign, as one may have each; one range
    where they may be equal, or are over within one sampling interval."""
    lags = (posterior or {}).get("lags_s") or []
    if not lags or posterior is None:
        return []
    ranges = stated_set(posterior)
    if len(ranges) == 1 and len(lags) > 1:
        low, high = ranges[0]
        factor, unit = time_unit(high)
        ends = interval(factor * low, factor * high)
        return [f"in {ends} {unit}" if low > 0.0 else f"< {with_spread(high, high)} s"]
    n = count_limits(lags)
    words = [f"< {time_words(lags[n - 1]['q95'])}"] if n else []
    words += [time_words(row["q50"]) for row in lags[n:]]
    return [text if i == 0 else f"or {text}" for i, text in enumerate(words)]


def _lines(key: str, row: Mapping[str, Any], saved: Saved) -> Iterator[str]:
    """The value; of a volume also the time that it takes, at the lowest and the highest flow."""
    middle, low, high = row["q50"], row.get("q2.5"), row.get("q97.5")
    head = saved.headline
    if key == "tau_s" and head is not None and head.is_limit and head.limit:
        yield f"τ < {head.limit}"
        return
    is_volume = key.startswith("V")
    of = key.partition("[")[2].removesuffix("]")
    label = f"{of}: " if of else ""
    label += "V" if is_volume else "τᵥ" if key == "tau_v_s" else "τ"
    if low is not None and key in ((saved.posterior or {}).get("no_upper_limit") or {}):
        factor, unit = (1.0, "mL") if is_volume else time_unit(low)
        yield f"{label} > {with_spread(factor * low, factor * low)} {unit}"
        return
    if low is not None and high and low < LIMIT * middle:
        factor, unit = (1.0, "mL") if is_volume else time_unit(high)
        yield f"{label} < {with_spread(factor * high, factor * high)} {unit}"
        return
    factor, unit = (1.0, "mL") if is_volume else time_unit(middle)
    spread = None if low is None or high is None else factor * (high - low)
    shown = with_spread(factor * middle, spread) if spread else number(factor * middle)
    yield f"{label} = {shown} {unit}"
    flows = [e.get("total_flow_L_min") for e in saved.campaign["experiments"]]
    times = sorted(60e-3 * middle / flow for flow in flows if flow)
    if is_volume and times:
        alike = len({time_words(time) for time in times}) == 1
        ends = f"{number(times[0], 2)} to {number(times[-1], 2)} s"
        yield time_words(times[0]) if alike else ends
