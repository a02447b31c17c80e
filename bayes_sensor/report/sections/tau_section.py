"""The sensor's time constant, its posterior interval, and the naive bound."""

from __future__ import annotations

from collections.abc import Collection, Iterator, Mapping, Sequence
from functools import partial
from math import isclose
from typing import Any

from bayes_sensor import figures
from bayes_sensor.figures.method_words import classical_bound, method_words, role_of
from bayes_sensor.report.gap_words import with_the_effect
from bayes_sensor.report.headline import Headline, effect_names
from bayes_sensor.report.parts import Part, Picture, Section, Table, pointing, see, to_spread
from bayes_sensor.report.saved import Saved
from bayes_sensor.report.sections.draws_section import of_draws, posterior_table
from bayes_sensor.report.words import LAG_WORDS, interval, list_words, ms, number, scaled, typeset

PUBLISHED_3SD = {"tau_s": 0.0056049, "tau_v_s": 0.0086029, "V_mL": 0.6817}
"""the paper's Table III"""
PUBLISHED_FLOWS = (
    (4.0, 0.5), (3.0, 0.5), (2.5, 0.5), (8.0, 1.0), (6.0, 1.0), (5.0, 1.0), (7.5, 1.5),
)  # fmt: skip
"""L/min, carrier and test gas: the paper's Table I"""
ALIKE = 0.05
"""correlation of neighbouring samples from which the bound for white noise is called wrong"""
CLOSE = 1.1
"""ratio of two intervals up to which they are called about as wide"""
SAME = 5e-3
"""relative, of flows and concentrations that count as the same"""
PRIOR_WORDS = {
    "flat": "flat",
    "half_normal": "half-normal, the default",
    "log_uniform_floored": "log-uniform, flat below its floor",
}
_QUANTILES = ("q2.5", "q16", "q50", "q84", "q97.5")


def time_constant(saved: Saved) -> Section | None:
    """tau, its posterior interval, and the other methods beside it."""
    if saved.posterior is None and saved.bounds is None:
        return None
    head, answer = saved.headline, ""
    if head is not None:
        source = "posterior-shared" if saved.posterior is not None else "methods"
        answer = pointing(typeset(head.text), source)
        if head.is_limit and head.limit and not head.hidden:
            answer += (
                " Zero is not excluded, so quote it as an upper limit: "
                f"τ < {head.limit} (95 %){see('priors-on-tau')}."
            )
    paragraphs = [*_of_effects(saved), *_of_bounds(saved, head), *_of_priors(saved)]
    title = "What is the sensor's time constant"
    return Section("tau", title, answer, paragraphs, list(_content(saved)))


def _content(saved: Saved) -> Iterator[Part]:
    posterior, bounds = saved.posterior, _bounds(saved)
    if bounds is not None:
        yield Picture(
            "intervals",
            partial(figures.intervals, bounds),
            "Every method side by side: 68 % (thick) and 95 % (thin) intervals; the marker is "
            "each method's estimate. Orange: the classical bounds under iid noise.",
        )
    if posterior is not None:
        yield _prior_table(posterior.get("tau_under_priors", []))
        yield _both_table(saved)
        yield posterior_table(saved, shared=True)
        if saved.draws is not None:
            yield Picture(
                "corner",
                partial(of_draws, figures.corner, saved.draws, saved.unit),
                "Joint posterior of the shared parameters: regions of 39, 68 and 95 %; dashed "
                "lines mark the median and the 95 % interval.",
                on_paper=True,
            )
    if bounds is not None:
        if bounds.get("naive"):
            yield _naive_table(bounds, saved.published)
        yield _method_table(bounds)
        yield _assumption_table(bounds)
        if saved.published and bounds.get("step_study"):
            is_replica = is_published(saved.campaign)
            published = PUBLISHED_3SD if is_replica else None
            yield Picture(
                "step_study",
                partial(figures.step_study, bounds["step_study"], published),
                "The classical bound against the step of the finite difference. It is right only "
                "where the curves are flat: a step of 1 % moves the switch times by tenths of a "
                "second. Open markers: a step so small that forward Euler sees no change of the "
                "switch times at all." + (" Stars: the published bounds." if is_replica else ""),
            )


def _bounds(saved: Saved) -> dict[str, Any] | None:
    """The bounds, with the published recipe only where that is asked for."""
    if saved.bounds is None or saved.published:
        return saved.bounds
    methods = {
        name: entry
        for name, entry in saved.bounds["methods"].items()
        if not method_words(saved.bounds, name).published_recipe
    }
    return {**saved.bounds, "methods": methods}


def is_published(campaign: Mapping[str, Any]) -> bool:
    """Whether the experiments have the published flows and concentrations, to half a percent.

    ``campaign``: ``campaign.json``.  Bounds depend on them for any time constants.
    """
    found = [(e["total_flow_L_min"], e["concentration_percent"]) for e in campaign["experiments"]]
    return len(found) == len(PUBLISHED_FLOWS) and all(
        any(
            isclose(flow, carrier + gas, rel_tol=SAME)
            and isclose(percent, 100.0 * gas / (carrier + gas), rel_tol=SAME)
            for flow, percent in found
        )
        for carrier, gas in PUBLISHED_FLOWS
    )


def _undecided(posterior: Mapping[str, Any] | None) -> bool:
    return posterior is not None and posterior.get("order") == "undecided"


def _of_effects(saved: Saved) -> Iterator[str]:
    """Which effects the posterior has in its model, and tau with one that it leaves out."""
    if instead := with_the_effect(saved):
        yield f"This assumes that the model is right, which it is not{see('which')}. {instead}"
    if saved.posterior_without_effects is not None and saved.posterior is not None:
        yield (
            f"This posterior has {list_words(effect_names(saved.posterior))} in its model; the "
            f"earlier one, without, stands beside it{see('both-posteriors')}."
        )


def _of_bounds(saved: Saved, head: Headline | None) -> Iterator[str]:
    """The classical bounds against the interval that is quoted, and why intervals differ here."""
    white, coloured, published = (
        classical_bound(saved.bounds, role).get("tau_s")
        for role in ("white", "coloured", "published")
    )
    if white and head is not None and head.ends_s is not None:
        half = 1.96e3 * white
        said = (
            "The classical Cramér-Rao bound, which takes the samples as independent, alone would "
            f"have said ± {number(half, 2)} ms{see('naive')}: here it is "
        )
        ratio = 0.5e3 * (head.ends_s[1] - head.ends_s[0]) / half
        if ratio > CLOSE:
            said += f"too narrow, by a factor of {number(ratio, 2)}."
        elif ratio < 1.0 / CLOSE:
            said += f"{number(1.0 / ratio, 2)} times as wide as the interval above."
        else:
            said += "about as wide as the interval above."
        phi = ((saved.residuals or {}).get("ar1") or {}).get("phi")
        if phi is not None and phi > ALIKE and coloured:
            said += (
                f" Neighbouring samples are alike (φ = {number(phi, 2)}); with that in it the "
                f"bound becomes ± {number(1.96e3 * coloured, 2)} ms."
            )
        if head.is_limit:
            said += (
                " Near zero the data see τ through its square, so that no bound from a curvature "
                "describes it, and τ cannot be negative."
            )
        yield said
    if saved.published and saved.bounds is not None and white and published:
        ratio = white / published
        said = (
            "Steps of 1 % in every parameter reproduce the published bounds (the step is "
            "inferred). For the switch times 1 % is tenths of a second and depends on the origin "
            "of time, so the result is not a bound. At τ = "
            f"{number(1e3 * saved.bounds['naive']['at']['tau_s'], 3)} ms "
        )
        if ratio > CLOSE:
            said += (
                f"the bound with correct derivatives is {number(ratio, 2)} times as wide: a slower "
                "sensor and a later switch look almost alike, and a step that large hides it"
            )
        elif ratio < 1.0 / CLOSE:
            said += f"it is {number(1.0 / ratio, 2)} times as wide as with correct derivatives"
        else:
            said += "it happens to be about as wide as with correct derivatives"
        yield f"{said}{see('naive', 'step_study')}."
    reasons = list(_assumptions(saved))
    if len(reasons) > 1:
        yield (
            "The intervals of τ on this page differ because their assumptions differ: "
            f"{'; '.join(reasons)}."
        )


def _assumptions(saved: Saved) -> Iterator[str]:
    """What is assumed for each 95 % interval of tau on the page."""
    if _undecided(saved.posterior):
        return
    if saved.posterior is not None:
        row = saved.posterior["parameters"].get("tau_s")
        if row is None:  # several sensors: each has one of its own
            return
        yield (
            f"the posterior's {interval(1e3 * row['q2.5'], 1e3 * row['q97.5'])} ms counts "
            f"the prior on τ and averages over all other parameters{see('posterior-shared')}"
        )
    bounds = saved.bounds or {}
    for name, entry in bounds.get("methods", {}).items():
        row, method = entry["parameters"].get("tau_s") or {}, method_words(bounds, name)
        if method.against_others and None not in (row.get("lo95"), row.get("hi95")):
            yield (
                f"the {method.label}'s {interval(1e3 * row['lo95'], 1e3 * row['hi95'])} ms "
                f"{method.against_others}{see('methods')}"
            )
    shrink = (saved.gap or {}).get("shrink") or {}
    low, high = shrink.get("tau_after_lo_s"), shrink.get("tau_after_hi_s")
    if low is not None and high is not None:
        yield (
            f"the diagnosis's {interval(1e3 * low, 1e3 * high)} ms averages over what may be wrong "
            "with the model, sees the records in bins over a noise floor that was taken without "
            f"the model, and has a log-normal prior on τ{see('which')}"
        )


def _of_priors(saved: Saved) -> Iterator[str]:
    """Upper limits under each prior, if it is known which lag is the sensor's."""
    rows = (saved.posterior or {}).get("tau_under_priors", [])
    if not rows or _of_several_lags(rows):
        return
    limits, lows = ([row[key] for row in rows] for key in ("upper95_s", "lo95_s"))
    here = ". "
    if max(limits) < 1.05 * min(limits):
        alike = max(lows) < 1.2 * min(lows)
        here = ", but not here. " if alike else "; here only the lower ends show it. "
    each = [
        f"{number(ms(row['upper95_s']), 2)} ms ({PRIOR_WORDS.get(row['prior'], row['prior'])})"
        for row in rows
    ]
    yield (
        f"Because the data see τ mainly through its square, the prior matters near zero{here}"
        f"Under {_how_many(rows)} the one-sided 95 % upper limits are "
        f"{list_words(each)}{see('priors-on-tau')}."
    )


def _of_several_lags(rows: Sequence[Mapping[str, Any]]) -> bool:
    return len({row.get("sensor_is") for row in rows}) > 1


def _how_many(rows: Collection[Any]) -> str:
    """The priors for which the draws are valid; draws under a bounded prior are not valid beyond
    its end."""
    return {1: "one prior", 2: "two priors"}.get(len(rows), "three priors")


def _prior_table(rows: Sequence[Mapping[str, Any]]) -> Table:
    several = _of_several_lags(rows)
    ends = ("lo95_s", "hi95_s", "hdi_lo95_s", "hdi_hi95_s", "upper95_s", "upper99_s")
    return Table(
        "priors-on-tau",
        f"τ under {_how_many({row['prior'] for row in rows})}, from the same draws by reweighting "
        "(ms). A row with fewer than about 400 effective draws is inaccurate.",
        [
            *(["sensor's lag"] if several else []),
            "prior on τ", "95 % low", "95 % high", "densest 95 % low", "densest 95 % high",
            "95 % upper limit", "99 % upper limit", "effective draws",
        ],
        [
            [
                *([LAG_WORDS[row["sensor_is"]]] if several else []),
                PRIOR_WORDS.get(row["prior"], row["prior"]),
                *(ms(row[end]) for end in ends),
                row["n_effective"],
            ]
            for row in rows
        ],
        digits=3,
    )  # fmt: skip


def _both_table(saved: Saved) -> Table:
    """The posteriors of tau with and without the effects."""
    earlier, newest = saved.posterior_without_effects, saved.posterior
    rows = {}
    if earlier and newest and not _undecided(earlier) and not _undecided(newest):
        rows = {"without effects": earlier, f"with {list_words(effect_names(newest))}": newest}
    return Table(
        "both-posteriors",
        "Both posteriors of τ (ms).",
        ["model", *(f"{key.removeprefix('q')} %" for key in _QUANTILES)],
        [
            [label, *(ms(record["parameters"]["tau_s"][key]) for key in _QUANTILES)]
            for label, record in rows.items()
        ],
        digits=3,
    )


def _naive_table(bounds: Mapping[str, Any], with_recipe: bool) -> Table:
    at = bounds["naive"]["at"]
    shown = figures.shared_labels(at)
    rows: list[list[Any]] = []
    for role in ("published", "white", "coloured") if with_recipe else ("white", "coloured"):
        found, words = classical_bound(bounds, role), method_words(bounds, role_of(bounds, role))
        values = [
            scaled(found.get(key), k * factor)
            for key, (_, _, factor) in shown.items()
            for k in (1.0, 1.96)
        ]
        rows.append([words.full_label or words.label, *values])
    place = ", ".join(
        f"{symbol} = {number(factor * at[name])} {unit}"
        for name, (symbol, unit, factor) in shown.items()
    )
    heads = [
        f"{symbol}, {what} ({unit})"
        for symbol, unit, _ in shown.values()
        for what in ("sd", "± 95 %")
    ]
    return Table(
        "naive",
        f"The classical bounds at one common point ({place}), where they can be compared: one "
        "standard deviation, and 1.96 of them.",
        ["bound", *heads],
        rows,
        digits=3,
    )


def _method_table(bounds: Mapping[str, Any]) -> Table:
    rows: list[list[Any]] = []
    marked: list[int] = []
    for name, (symbol, unit, factor) in figures.labels_of_bounds(bounds).items():
        found = [entry["parameters"].get(name) or {} for entry in bounds["methods"].values()]
        widths = [
            row["hi68"] - row["lo68"]
            for row in found
            if None not in (row.get("lo68"), row.get("hi68"))
        ]
        narrowest = factor * min(filter(None, widths), default=0.0)
        for method, row in zip(bounds["methods"], found, strict=True):
            values = [
                None if row.get(key) is None else to_spread(factor * row[key], narrowest)
                for key in ("estimate", "sd", "lo68", "hi68", "lo95", "hi95", "lo997", "hi997")
            ]
            if method_words(bounds, method).needs_posterior:
                marked.append(len(rows))
            rows.append([f"{symbol} ({unit})", method_words(bounds, method).label, *values])
    columns = [
        "parameter", "method", "estimate", "sd", "68 % low", "68 % high", "95 % low", "95 % high",
        "99.7 % low", "99.7 % high",
    ]  # fmt: skip
    return Table(
        "methods",
        "Intervals by every method. No standard deviation is given where the estimate sits at its "
        "limit, because ± has no meaning there.",
        columns,
        rows,
        marked=marked,
    )


def _assumption_table(bounds: Mapping[str, Any]) -> Table:
    rows = [
        [
            method_words(bounds, method).label,
            typeset(entry["assumes"]),
            entry.get("reference", ""),
            "" if entry.get("status", "ok") == "ok" else typeset(entry["status"]),
        ]
        for method, entry in bounds["methods"].items()
    ]
    return Table(
        "assumptions", "What each method assumes.", ["method", "assumes", "source", "remark"], rows
    )
