"""The top of the report: tau in one sentence, and what failed."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Any

from bayes_sensor.bounds.methods import PUBLISHED, TO_QUOTE, WHITE, method_of
from bayes_sensor.figures import effect_words
from bayes_sensor.io.run_record import of_other_data
from bayes_sensor.report.saved import Saved
from bayes_sensor.report.words import (
    interval,
    list_words,
    ms,
    number,
    sentence,
    time_unit,
    typeset,
    with_spread,
)
from bayes_sensor.residuals import TAKE_AS_THEY_ARE


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

    def __str__(self) -> str:
        return f"{self.text}; {self.naive}" if self.naive else self.text


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
    posterior: Mapping[str, Any] | None, bounds: Mapping[str, Any] | None, settings: Any = None
) -> Headline | None:
    """The first sentence of the report; None if nothing was estimated."""
    naive = _naive_words(bounds)
    if posterior is not None:
        return _of_posterior(posterior, naive, settings)
    if bounds is not None:
        method = next((m for m in TO_QUOTE if m in bounds["methods"]), None)
        return None if method is None else _of_bounds(bounds["methods"][method], method, naive)
    return None


def _of_posterior(posterior: Mapping[str, Any], naive: str, settings: Any) -> Headline:
    autocorrelation = ((settings or {}).get("noise") or {}).get("autocorrelation", "ar1")
    noise = "AR(1) noise" if autocorrelation == "ar1" else "white noise"
    if posterior.get("with_effects"):
        noise += f"; with {list_words(effect_names(posterior))} in the model"
    if posterior.get("with_discrepancy"):
        noise += "; with a smooth discrepancy in the model"
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
    if posterior.get("order") == "undecided":
        return Headline(f"{_of_lags(posterior)} {source}", "", False, undecided=True)
    row = posterior["parameters"]["tau_s"]
    lo, mid, hi = (row[key] for key in ("q2.5", "q50", "q97.5"))
    text = f"tau = {lag_words(lo, mid, hi)} {source}"
    half_normal = next(
        (r for r in posterior.get("tau_under_priors", []) if r["prior"] == "half_normal"), None
    )
    is_limit = lo < LIMIT * mid
    limit = ""
    if is_limit and half_normal:
        limit = f"{with_spread(1e3 * half_normal['upper95_s'], 1e3 * (hi - lo))} ms"
    return Headline(text, naive, is_limit, limit)


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
    n_limits = _n_limits(lags)
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
    return _n_limits(lags) == 0 and all(a["q97.5"] >= b["q2.5"] for a, b in neighbours)


def _n_limits(lags: Sequence[Mapping[str, float]]) -> int:
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
    n_limits = _n_limits(lags)
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
        is_limit = row["lo95"] is not None and row["lo95"] <= 0
        return Headline(f"tau = {words(row)} ({method})", naive, is_limit)
    lags = [rows[name] for name in rows if name.startswith("lag_") and rows[name]]
    if not lags:
        return None
    lags.sort(key=lambda row: row["estimate"] or 0.0)
    each = ", or ".join(words(row) for row in lags)
    return Headline(f"tau is either {each} ({method}): {SAY_WHICH}", "", False, undecided=True)


def chain_words(posterior: Mapping[str, Any]) -> str:
    """t63 and t90 of the whole chain at the lowest and the highest flow, as a sentence.

    They do not depend on the assignment of the lags; empty for results without them.
    """
    rows = sorted(posterior.get("chain", {}).values(), key=lambda row: -row["t90_s"]["q50"])
    if not rows:
        return ""
    shown = [rows[0], rows[-1]] if rows[0] != rows[-1] else [rows[0]]
    labels = ["at the lowest flow", "at the highest"] if len(shown) > 1 else [""]
    said = []
    for row, label in zip(shown, labels, strict=True):
        times = []
        for key in ("t63", "t90"):
            lo, mid, hi = (row[f"{key}_s"][q] for q in ("q2.5", "q50", "q97.5"))
            factor, unit = time_unit(mid)
            value = with_spread(factor * mid, factor * (hi - lo))
            times.append(f"{key} {value} {unit} {interval(factor * lo, factor * hi)}")
        said.append(f"{', '.join(times)} {label}".rstrip())
    return f"the whole chain, whatever the order of lags: {'; '.join(said)}"


@dataclass(frozen=True)
class Remark:
    """A sentence under the headline, and the section with details."""

    text: str
    section: str


ALIKE = 0.05
"""correlation of neighbouring samples from which the bound for white noise is called wrong"""
TOO_NARROW = 1.3
"""ratio of the converged bound of tau to that with 1 % steps from which the latter is called
wrong"""


def remarks(saved: Saved) -> list[Remark]:
    """Explanations for a newcomer: what tau is, its uncertainty, why the bound misleads."""
    head = headline(saved.posterior, saved.bounds, saved.settings)
    if head is None:
        return [] if saved.gap is None else [Remark(gap_sentence(saved.gap, False), "gap")]
    said = [
        Remark(
            "τ is the sensor's own time constant: how long it takes, without valve and manifold, "
            "to cover 63 % of a step.",
            "tau",
        )
    ]
    times = "" if saved.posterior is None or head.hidden else chain_words(saved.posterior)
    if times:
        said.append(Remark(sentence(typeset(times)), "tau"))
    if head.is_limit and head.limit and not head.hidden:
        said.append(
            Remark(
                f"Zero is not excluded: read it as an upper limit, τ < {head.limit} (95 %). The "
                "data give the largest possible time constant only.",
                "tau",
            )
        )
    if head.naive:
        why = _why_naive_misleads(saved)
        text = naive_sentence(head) + (f" Why that misleads: {why}." if why else "")
        said.append(Remark(text, "tau"))
    if saved.gap is not None:
        words = gap_sentence(saved.gap, head.is_limit)
        verdict = saved.gap["verdict"]
        if verdict["kind"] != "none" and verdict["probability"] >= 0.5:
            words = f"No. {words}"
        text = f"All this assumes that the model is right. Is it? {words} {with_the_effect(saved)}"
        said.append(Remark(text.rstrip(), "gap"))
    return said


def naive_sentence(head: Headline) -> str:
    """The interval by the classical bound alone, as a sentence."""
    return sentence(head.naive).replace("iid Cramer-Rao", "classical Cramér-Rao")


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
    if shrink.get("explanation") == "mains_pickup":  # it moves no estimate of tau
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


def _why_naive_misleads(saved: Saved) -> str:
    """The assumptions of the classical bound that fail here, in words."""
    naive = (saved.bounds or {}).get("naive") or {}
    right, published = naive.get(WHITE) or {}, naive.get(PUBLISHED) or {}
    found = []
    phi = ((saved.residuals or {}).get("ar1") or {}).get("phi")
    if right.get("tau_s") and phi is not None and phi > ALIKE:
        found.append(
            f"it treats the samples as independent, but neighbours are alike (φ = {number(phi, 2)})"
        )
    if right.get("tau_s") and published.get("tau_s"):
        if right["tau_s"] > TOO_NARROW * published["tau_s"]:
            found.append(
                "and steps of 1 % move a switch time by tenths of a second, which hides that a "
                "slower sensor and a later switch give almost the same response"
            )
    return "; ".join(found)


def effect_names(posterior: Mapping[str, Any]) -> list[str]:
    """The effects in a posterior's model, as words."""
    return [effect_words(name) for name in posterior.get("with_effects") or []]


def _naive_words(bounds: Mapping[str, Any] | None) -> str:
    """The interval of tau by the iid bound alone, at 95 %."""
    if bounds is None:
        return ""
    naive = bounds.get("naive") or {}
    right, published = naive.get(WHITE), naive.get(PUBLISHED)
    parts = []
    if right and right.get("tau_s"):
        parts.append(
            "the iid Cramer-Rao bound alone would have said "
            f"± {number(1.96e3 * right['tau_s'], 2)} ms"
        )
    if published and published.get("tau_s"):
        said = f"± {number(1.96e3 * published['tau_s'], 2)} ms"
        parts.append(
            f"or {said} if its derivatives are taken with steps of 1 %"
            if parts
            else (
                "the iid Cramer-Rao bound with derivatives from steps of 1 % would have said "
                f"{said}"
            )
        )
    return ", ".join(parts)


CONCERNED = (
    "This concerns every interval that depends on the noise law: the posterior, the profile and "
    "the Cramér-Rao bounds."
)


def doubts(saved: Saved) -> list[str]:
    """Failed checks of the noise law, as in the warnings of every interval."""
    found = list((saved.posterior or {}).get("doubts", []))
    record = saved.residuals
    if record is not None and not record["adequate"]:
        found.append(f"{record['verdict']} {record.get('recommendation') or TAKE_AS_THEY_ARE}")
    return found


def alerts(saved: Saved) -> list[tuple[str, str]]:
    """(kind, sentence) for the top of the page.

    ``bad`` for caveats of the headline, which the page shows before it; the rest are notes.
    """
    caveats = (saved.fit or {}).get("caveats") or []
    found = [("bad", sentence(typeset(caveat))) for caveat in caveats]
    if saved.fit is not None and not saved.fit["converged"]:
        found.append(("bad", f"The least-squares fit did not converge. {saved.fit['status']}"))
    if saved.posterior is not None and not saved.posterior["converged"]:
        status = saved.posterior.get("convergence", saved.posterior["status"])
        found.append(
            (
                "bad",
                f"The posterior did not converge, so its intervals must not be quoted ({status}). "
                "Continue it with --resume and more steps.",
            )
        )
    n = len(saved.campaign["experiments"])
    missed = saved.missed
    if missed > n / 2:
        found.append(
            (
                "bad",
                f"The model misses {missed} of {n} traces by more than AR(1) noise explains: it "
                "leaves something out, or the noise is another. The intervals below take both as "
                "right; what they leave out is in none of them.",
            )
        )
    if saved.residuals is not None and not saved.residuals["adequate"]:
        found.append(
            (
                "bad",
                f"{saved.residuals['verdict']} {CONCERNED} "
                f"{saved.residuals.get('recommendation') or TAKE_AS_THEY_ARE}",
            )
        )
    elif saved.predictive is not None and saved.predictive["failed"]:
        status = sentence(typeset(saved.predictive["status"]))
        found.append(("bad", f"{status} {CONCERNED} {TAKE_AS_THEY_ARE}"))
    stale = of_other_data(saved.run)
    if stale:
        found.append(
            (
                "bad",
                f"The results of {list_words(stale)} rest on other data or settings than those of "
                f"{saved.run['last']}; run them again before comparing.",
            )
        )
    notes = list(saved.campaign.get("remarks", []))
    for part in (saved.fit, saved.posterior):
        notes += part.get("warnings", []) if part else []
    if saved.bounds:
        for method, entry in saved.bounds["methods"].items():
            status = entry.get("status", "ok")
            for doubt in doubts(saved):  # an alert says it once for all
                status = "; ".join(filter(None, status.replace(doubt, "").split("; "))) or "ok"
            if method_of(method).published_recipe:  # its caveats stand in the table of methods
                continue
            if status != "ok" and "lower bound" not in status and "upper limit" not in status:
                notes.append(f"{method_of(method).label}: {status}")
    seen = set(caveats)
    for note in notes:
        told = sentence(typeset(note))
        if (
            note not in seen
            and note not in doubts(saved)
            and not any(text in (note, told) for _, text in found)
        ):
            seen.add(note)
            found.append(("note", sentence(typeset(note))))
    return found
