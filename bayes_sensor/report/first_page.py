"""The first page: the answer, its reasons in one sentence each, the chain, and one overlay."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from bayes_sensor import figures
from bayes_sensor.figures import effect_words
from bayes_sensor.figures.method_words import method_words, quoted
from bayes_sensor.report.gap_words import gap_sentence, with_the_effect
from bayes_sensor.report.headline import SAY_WHICH, Headline, any_order, chain_times
from bayes_sensor.report.notices import alerts
from bayes_sensor.report.parts import Part, Picture, Section, see
from bayes_sensor.report.saved import Saved
from bayes_sensor.report.stage_values import stage_values
from bayes_sensor.report.words import number, sentence, time_words, typeset

ALIKE = 0.05
"""correlation of neighbouring samples below which they count as independent"""


@dataclass(frozen=True)
class Fact:
    """One sentence of the first page, and the section with its details."""

    label: str
    text: str
    section: str


@dataclass
class FirstPage:
    """What a reader takes home."""

    tau: str
    """in one sentence; empty where nothing was estimated"""
    why: str
    """what tau is, and why this interval"""
    facts: list[Fact]
    alerts: list[str]
    """what decides whether the first sentence stands; shown before it"""
    notes: list[str]
    content: list[Part] = field(default_factory=list)
    """the chain and one overlay"""


def first_page(saved: Saved, sections: Sequence[Section]) -> FirstPage:
    """The first page; takes its overlay out of ``sections``."""
    head = saved.headline
    told = alerts(saved)
    facts = (_limit(head), _chain(saved, head), _noise(saved), _model(saved, head), _next(sections))
    page = FirstPage(
        "" if head is None else _without_stop(typeset(head.text.replace(f": {SAY_WHICH}", ""))),
        "" if head is None else _why(saved, head),
        [fact for fact in facts if fact is not None],
        [text for kind, text in told if kind == "bad"],
        [text for kind, text in told if kind != "bad"],
    )
    if stages := stage_values(saved):
        caption = (
            "The chain as understood, with the medians of what was estimated; shaded, the sensor."
        )
        page.content.append(Picture("chain", None, caption, drawing=figures.chain(stages)))
    if saved.traces:  # the one that the model describes worst, measured in its noise
        misfit = [t.rms / float(np.sqrt(np.mean(t.whole.sd**2))) for t in saved.traces]
        for section in sections:
            for part in section.content:
                if isinstance(part, Picture) and part.overlay == int(np.argmax(misfit)):
                    section.content.remove(part)
                    page.content.append(part)
                    return page
    return page


def _without_stop(text: str) -> str:
    return sentence(text).removesuffix(".")


def _why(saved: Saved, head: Headline) -> str:
    said = (
        "τ is the sensor's own time constant: how long it takes, without the rest of the chain, to "
        "cover 63 % of a step."
    )
    if head.hidden or head.undecided:
        return f"{said} {sentence(typeset(SAY_WHICH)) if SAY_WHICH in head.text else ''}".rstrip()
    bounds = saved.bounds or {}
    rows = [
        entry["parameters"].get("tau_s") or {}
        for name, entry in (bounds.get("methods") or {}).items()
        if saved.published or not method_words(bounds, name).published_recipe
    ]
    n = sum(row.get("lo95") is not None or row.get("hi95") is not None for row in rows)
    among = f"of {n} intervals, " if n > 1 else ""
    if head.without:
        reason = (
            "the model misses the measurement, and what it lacks changes τ. Without that: "
            f"{typeset(head.without)}. To sample with it: bayes-sensor posterior {head.option}; "
            "details"
        )
    elif saved.posterior is not None:
        reason = (
            f"{among}the posterior's alone averages over all that was estimated beside τ, and over "
            "the noise law"
        )
    else:
        label = method_words(bounds, quoted(bounds) or "").label
        reason = f"{among}it is that of the {label}; no posterior was sampled"
    return f"{said} Why this interval: {reason}{see('intervals', 'methods')}."


def _limit(head: Headline | None) -> Fact | None:
    if head is None or head.hidden or not (head.is_limit and head.limit):
        return None
    words = f"Zero is not excluded: read it as an upper limit, τ < {head.limit} (95 %)."
    return Fact("Limit", words, "tau")


def _chain(saved: Saved, head: Headline | None) -> Fact | None:
    if saved.posterior is None or head is None or head.hidden:
        return None
    flows = {e["experiment"]: e.get("total_flow_L_min") for e in saved.campaign["experiments"]}
    words = chain_times(saved.posterior, flows)
    if not words:
        return None
    order = any_order(saved.posterior, "of its lags")
    without = ", without what the model lacks" if head.without else ""
    return Fact("Whole chain", f"{typeset(words)} (95 %){order}{without}.", "tau")


def _noise(saved: Saved) -> Fact | None:
    """The noise in one sentence."""
    residuals, fit = saved.residuals, saved.fit or {}
    if residuals is None:
        return None
    shown, factor = saved.small_unit
    floor = fit.get("noise_V") or fit.get("rms_V")
    size = "" if floor is None else f"{number(factor * floor)} {shown} rms, "
    ar1 = residuals.get("ar1") or {}
    phi, own = ar1.get("phi"), any(name.startswith("phi[") for name in ar1)
    if phi is None or abs(phi) < ALIKE:
        words = "independent from sample to sample"
    else:
        about = "about " if own else ""
        after = ar1.get("phi_interval_s")
        apart = f" after {time_words(after)}" if after else ""
        words = f"neighbouring samples alike (correlation {about}{number(phi, 2)}{apart})"
    failed = saved.predictive is not None and saved.predictive["failed"]
    good = residuals["adequate"] and not failed
    law = "the noise law passes its checks" if good else "the noise law fails a check, see above"
    return Fact("Noise", f"{_without_stop(size + words)}; {law}.", "noise")


def _model(saved: Saved, head: Headline | None) -> Fact | None:
    """The verdict, and tau with the effect that it names."""
    gap = saved.gap
    if gap is None:
        return None
    words = gap_sentence(gap, head is not None and head.is_limit)
    shrink, verdict = gap["shrink"], gap["verdict"]
    closed = shrink.get("fraction_closed")
    if verdict["kind"] != "none" and closed is not None and "close" not in words:
        effect = effect_words(shrink.get("explanation") or "the best explanation")
        words += f" With {effect} in the model {100.0 * closed:.0f} % of the gap closes."
    if verdict["kind"] != "none" and verdict["probability"] >= 0.5:
        words = f"No. {words}"
    if head is None or not head.without:  # else the page begins with it
        words = f"{words} {with_the_effect(saved)}".rstrip()
    return Fact("Model right?", words, "gap")


def _next(sections: Sequence[Section]) -> Fact | None:
    """The answer of the section on what to measure next."""
    answer = next((section.answer for section in sections if section.key == "next"), "")
    return Fact("Measure next", answer, "next") if answer else None
