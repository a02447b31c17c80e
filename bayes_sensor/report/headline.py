"""tau in one sentence: an interval, an upper limit, or the lags that it may be."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import Any

from bayes_sensor.display import time_unit
from bayes_sensor.figures import effect_words
from bayes_sensor.figures.method_words import classical_bound, quoted
from bayes_sensor.report.cause_left_out import Cause, left_out
from bayes_sensor.report.words import (
    interval,
    list_words,
    number,
    with_spread,
)


@dataclass(frozen=True)
class Headline:
    """tau in one sentence, with the naive bound."""

    text: str
    """``tau = 24.3 ms, 95 % interval [1.1, 60.5] ms (posterior, AR(1) noise)``"""
    naive: str
    """``± 46 ms``, or empty"""
    is_limit: bool
    """whether tau is only bounded from above"""
    limit: str = ""
    undecided: bool = False
    """whether the sensor's lag is one of several"""
    hidden: bool = False
    """whether the response is over within one sampling interval"""
    ends_s: tuple[float, float] | None = None
    """the 95 % interval of tau, where one is stated"""
    without: str = ""
    """what would have been said without the cause of a misfit in the model; else empty"""
    option: str = ""
    """of ``bayes-sensor posterior``, which samples with that cause"""

    def __str__(self) -> str:
        without = f"without it {self.without}" if self.without else ""
        return "; ".join(filter(None, (self.text, without, self.naive)))


LIMIT = 0.15
"""share of the median; if the lower end of a 95 % interval is below it, zero is not excluded.  For
a lag with k shorter ones that are limits, too, its k-th root is used, because the lower end of the
k-th smallest of undetermined values has that size."""
SAY_WHICH = (
    'lags in a row commute, so say which is the sensor\'s: [rig] sensor_is = "faster" or "slower", '
    "or side information on tau or tau_v"
)


def lag_words(low: float, middle: float, high: float) -> str:
    """A lag (s) with its 95 % interval, in the unit that suits it.

    >>> lag_words(0.0986, 0.13755, 0.1735), lag_words(1.9917, 2.0021, 2.013)
    ('138 ms, 95 % interval [99, 174] ms', '2.002 s, 95 % interval [1.992, 2.013] s')
    """
    factor, unit = time_unit(middle)
    value = with_spread(factor * middle, factor * (high - low))
    return f"{value} {unit}, 95 % interval {interval(factor * low, factor * high)} {unit}"


def upper_words(high: float, low: float = 0.0) -> str:
    """An upper limit (s) in the unit that suits it, to two digits of its distance from ``low``."""
    factor, unit = time_unit(high)
    return f"{with_spread(factor * high, factor * (high - low))} {unit}"


def headline(
    posterior: Mapping[str, Any] | None,
    bounds: Mapping[str, Any] | None,
    settings: Any = None,
    gap: Mapping[str, Any] | None = None,
) -> Headline | None:
    """The first sentence of the report; None if nothing was estimated.

    If ``gap`` says that the model misses the measurement, tau is that with the cause in the model.
    """
    naive = _naive_words(bounds)
    if posterior is not None:
        found = _of_posterior(posterior, naive, settings)
        cause = left_out(gap, posterior)
        # of lags that are not assigned, and of several sensors, the diagnosis has one only
        return found if found is None or not found.ends_s or not cause else _with(cause, found)
    if bounds is not None:
        method = quoted(bounds)
        return None if method is None else _of_bounds(bounds["methods"][method], method, naive)
    return None


def _of_posterior(posterior: Mapping[str, Any], naive: str, settings: Any) -> Headline | None:
    autocorrelation = ((settings or {}).get("noise") or {}).get("autocorrelation", "ar1")
    noise = "AR(1) noise" if autocorrelation == "ar1" else "white noise"
    if posterior.get("with_effects"):
        noise += f"; with {list_words(effect_names(posterior))} in the model"
    if posterior.get("with_discrepancy"):
        noise += "; with a smooth discrepancy in the model"
    if by_prior := posterior.get("decided_by_prior"):
        names = [re.sub(r"_(s|mL)(?=\[|$)", "", name) for name in by_prior]
        noise += f"; default priors decide {list_words(names)}"
    if not posterior.get("converged", True):
        noise += "; NOT CONVERGED, do not quote"
    source = f"(posterior, {noise})"
    if (hidden := posterior.get("hidden_by_sampling_s")) is not None:
        most = _longest_hidden(posterior)
        text = (
            f"the response is over within one sampling interval ({number(hidden)} s), which hides "
            f"it: an upper limit only, no lag is longer than {upper_words(most)} {source}"
        )
        return Headline(text, "", True, upper_words(most), hidden=True)
    ends = posterior.get("no_upper_limit") or {}
    if posterior.get("order") == "undecided":
        open_end = (
            f"; of the longest {_open_end(ends['lag_slow_s'])}" if "lag_slow_s" in ends else ""
        )
        return Headline(f"{_of_lags(posterior)}{open_end} {source}", "", False, undecided=True)
    rows = [
        (name, [row[key] for key in ("q2.5", "q50", "q97.5")])
        for name, row in posterior["parameters"].items()
        if name.partition("[")[0] == "tau_s" and row is not None
    ]
    if not rows:
        return None
    each = "; ".join(
        f"{name.replace('tau_s', 'tau')} is longer than {upper_words(row[0])} (97.5 %), "
        f"{_open_end(ends[name])}"
        if name in ends
        else f"{name.replace('tau_s', 'tau')} = {lag_words(*row)}"
        for name, row in rows
    )
    text = f"{each} {source}"
    if len(rows) > 1 or rows[0][0] in ends:  # several sensors on one gas, or no interval
        return Headline(text, "", False)
    lo, mid, hi = rows[0][1]
    half_normal = next(
        (r for r in posterior.get("tau_under_priors", []) if r["prior"] == "half_normal"), None
    )
    is_limit = lo < LIMIT * mid
    limit = ""
    if is_limit and half_normal:
        limit = f"{with_spread(1e3 * half_normal['upper95_s'], 1e3 * (hi - lo))} ms"
    return Headline(text, naive, is_limit, limit, ends_s=(lo, hi))


def _open_end(end: float) -> str:
    return f"the data give no upper limit: its prior ends at {upper_words(end)}"


def _with(cause: Cause, found: Headline) -> Headline:
    """``found`` with the cause of the misfit in the model."""
    low, middle, high = cause.ends_s
    return replace(
        found,
        text=f"tau = {lag_words(*cause.ends_s)} (with {cause.what})",
        is_limit=low < LIMIT * middle,
        limit=upper_words(high, low),
        ends_s=(low, high),
        without=found.text,
        option=cause.option,
    )


def stated_set(posterior: Mapping[str, Any]) -> list[tuple[float, float]]:
    """Intervals (s), one of which contains tau with 95 %, as the headline states them.

    One interval if the lags can be assigned.  Else that of every lag; the shortest ones run from
    zero to their upper limit if zero is not excluded.
    """
    lags = posterior["lags_s"]
    if posterior.get("hidden_by_sampling_s") is not None:
        return [(0.0, _longest_hidden(posterior))]
    if posterior.get("order") != "undecided":
        row = posterior["parameters"]["tau_s"]
        return [(row["q2.5"], row["q97.5"])]
    n_limits = count_limits(lags)
    found = [(row["q2.5"], row["q97.5"]) for row in lags[n_limits:]]
    if _may_all_be_equal(lags):
        found = [(found[0][0], found[-1][1])]
    return [(0.0, lags[n_limits - 1]["q95"]), *found] if n_limits else found


def _longest_hidden(posterior: Mapping[str, Any]) -> float:
    """s, the upper limit of all lags if the response is shorter than one sampling interval."""
    # a lag alone rises from 10 to 90 % in 2.2 of it
    return float(min(posterior["lags_s"][-1]["q95"], posterior["hidden_by_sampling_s"] / 2.2))


def _may_all_be_equal(lags: Sequence[Mapping[str, float]]) -> bool:
    """Whether all lags differ from zero and none from its neighbour.  Intervals by size do not
    contain equal lags, so one interval is stated for all."""
    neighbours = pairwise(lags)
    return count_limits(lags) == 0 and all(a["q97.5"] >= b["q2.5"] for a, b in neighbours)


def count_limits(lags: Sequence[Mapping[str, float]]) -> int:
    """Number of lags, shortest first, that are not distinguished from zero."""
    n = 0
    for row in lags:
        ratio = row["q2.5"] / row["q50"] if row["q50"] > 0 else 0.0
        if ratio >= LIMIT ** (1.0 / (n + 1)):
            break
        n += 1
    return n


def _of_lags(posterior: Mapping[str, Any]) -> str:
    """The lags by size as a sentence, if it is not known which is the sensor's."""
    lags = posterior["lags_s"]
    n_limits = count_limits(lags)
    seen = lags[n_limits:]
    if not seen:
        return (
            "no lag can be distinguished from zero: all are shorter than "
            f"{upper_words(lags[-1]['q95'])} (95 %); {SAY_WHICH}"
        )
    shares = {row["lag"]: row["probability"] for row in posterior["assignments"]}

    def share(place: int) -> str:
        return f" ({100.0 * shares.get(place, 0.0):.0f} %)"

    if _may_all_be_equal(lags):
        ((low, high),) = stated_set(posterior)
        factor, unit = time_unit(high)
        ends = interval(factor * low, factor * high)
        return f"tau is one of lags that may be equal, all in {ends} {unit} (95 %): {SAY_WHICH}"
    words = [lag_words(row["q2.5"], row["q50"], row["q97.5"]) for row in seen]
    if n_limits == 0:
        each = [f"{text}{share(place)}" for place, text in enumerate(words)]
        return f"tau is either {', or '.join(each)}: {SAY_WHICH}"
    other = upper_words(lags[n_limits - 1]["q95"])
    if len(seen) == 1:
        own = shares.get(len(lags) - 1, 0.0)
        return (
            f"one lag of {words[0]}; any other is shorter than {other} (95 %); the sensor's is the "
            f"long one with {100.0 * own:.0f} %, a short one with {100.0 * (1.0 - own):.0f} %: "
            f"{SAY_WHICH}"
        )
    each = [f"{text}{share(n_limits + i)}" for i, text in enumerate(words)]
    return (
        f"tau is either {', or '.join(each)}, or shorter than {other} (95 %)"
        f"{share(0) if n_limits == 1 else ''}: {SAY_WHICH}"
    )


def _of_bounds(entry: Mapping[str, Any], method: str, naive: str) -> Headline | None:
    """From intervals of one method, where no posterior was sampled."""
    rows = entry["parameters"]

    def words(row: Mapping[str, Any]) -> str:
        scale, unit = time_unit(row["estimate"] or 0.0)
        low, middle, high = (
            number(None if row[key] is None else scale * row[key])
            for key in ("lo95", "estimate", "hi95")
        )
        return f"{middle} {unit}, 95 % interval [{low}, {high}] {unit}"

    if rows.get("tau_s"):
        row = rows["tau_s"]
        low, high = row["lo95"], row["hi95"]
        is_limit = low is not None and low <= 0
        ends = None if None in (low, high) else (low, high)
        return Headline(f"tau = {words(row)} ({method})", naive, is_limit, ends_s=ends)
    lags = [rows[name] for name in rows if name.startswith("lag_") and rows[name]]
    if not lags:
        return None
    lags.sort(key=lambda row: row["estimate"] or 0.0)
    each = ", or ".join(words(row) for row in lags)
    return Headline(f"tau is either {each} ({method}): {SAY_WHICH}", "", False, undecided=True)


def chain_words(posterior: Mapping[str, Any], without: bool = False) -> str:
    """t63 and t90 of the whole chain, as a sentence; empty for results without them.

    ``without``: the cause of a misfit, with which tau was said.
    """
    times = chain_times(posterior)
    what = f"the whole chain{', without it' if without else ''}{any_order(posterior)}"
    return f"{what}: {times}" if times else ""


def any_order(posterior: Mapping[str, Any], of: str = "of lags") -> str:
    """That the chain's times hold for every assignment of the lags; empty where one is all."""
    return "" if len(posterior.get("lags_s") or ()) == 1 else f", whatever the order {of}"


def chain_times(posterior: Mapping[str, Any], flows: Mapping[str, float] | None = None) -> str:
    """t63 and t90 of the whole chain at the lowest and the highest flow; empty without them.

    ``flows``: L/min by experiment, which are then said.
    """
    found = posterior.get("chain", {})
    names = sorted(found, key=lambda name: -found[name]["t90_s"]["q50"])
    if not names:
        return ""
    shown = [names[0], names[-1]] if found[names[0]] != found[names[-1]] else [names[0]]
    labels = [" at the lowest flow", " at the highest"] if len(shown) > 1 else [""]
    if flows and all(flows.get(name) for name in shown):
        labels = [f" at {flows[name]:.3g} L/min" for name in shown]
    sensors = [n[6:-1] for n in posterior["parameters"] if n.startswith("tau_s[")]
    if sensors:  # each has a chain of its own, slowest record first
        pairs = [(s, next(n for n in names if n.endswith(f",{s}"))) for s in sensors]
        shown, labels = [name for _, name in pairs], [f" to sensor {s}" for s, _ in pairs]
    said = []
    for name, label in zip(shown, labels, strict=True):
        times = []
        for key in ("t63", "t90"):
            lo, mid, hi = (found[name][f"{key}_s"][q] for q in ("q2.5", "q50", "q97.5"))
            factor, unit = time_unit(mid)
            value = with_spread(factor * mid, factor * (hi - lo))
            times.append(f"{key} {value} {unit} {interval(factor * lo, factor * hi)}")
        said.append(f"{', '.join(times)}{label}")
    return "; ".join(said)


def effect_names(posterior: Mapping[str, Any]) -> list[str]:
    """The effects in a posterior's model, as words."""
    return [effect_words(name) for name in posterior.get("with_effects") or []]


def _naive_words(bounds: Mapping[str, Any] | None) -> str:
    """The interval of tau by the iid bound alone, at 95 %."""
    sd = classical_bound(bounds, "white").get("tau_s")
    if not sd:
        return ""
    factor, unit = time_unit(sd)
    return (
        f"the iid Cramer-Rao bound alone would have said ± {number(1.96 * factor * sd, 2)} {unit}"
    )
