"""The sensor's time constant, its posterior interval, and the naive bound."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from math import isclose
from typing import Any

from bayes_sensor import figures
from bayes_sensor.bounds.methods import COLOURED, METHODS, PUBLISHED, WHITE, method_of
from bayes_sensor.report.headline import (
    effect_names,
    headline,
    naive_sentence,
    with_the_effect,
)
from bayes_sensor.report.parts import Part, Pictures, Section, Table, see, to_spread
from bayes_sensor.report.saved import Saved
from bayes_sensor.report.sections.draws_section import posterior_table
from bayes_sensor.report.words import interval, list_words, ms, number, sentence, typeset

PUBLISHED_3SD = {"tau_s": 0.0056049, "tau_v_s": 0.0086029, "V_mL": 0.6817}
"""the paper's Table III"""
PUBLISHED_FLOWS = (
    (4.0, 0.5), (3.0, 0.5), (2.5, 0.5), (8.0, 1.0), (6.0, 1.0), (5.0, 1.0), (7.5, 1.5),
)  # fmt: skip
"""L/min, carrier and test gas: the paper's Table I"""
SAME = 5e-3
"""relative, of flows and concentrations that count as the same"""
LAG_WORDS = {"faster": "shorter", "between": "middle", "slower": "longer"}
PRIOR_WORDS = {
    "flat": "flat",
    "half_normal": "half-normal, the default",
    "log_uniform_floored": "log-uniform, flat below its floor",
}


def time_constant(saved: Saved, pictures: Pictures) -> Section | None:
    """tau, its posterior interval, and the classical bound."""
    posterior, bounds = saved.posterior, saved.bounds
    if posterior is None and bounds is None:
        return None
    head = headline(posterior, bounds, saved.settings)
    source = "posterior-shared" if posterior is not None else "methods"
    answer = (
        "" if head is None else f"{sentence(typeset(head.text)).removesuffix('.')}{see(source)}."
    )
    if head is not None and head.is_limit and head.limit and not head.hidden:
        answer += (
            " Zero is not excluded, so quote it as an upper limit: "
            f"τ < {head.limit} (95 %){see('priors-on-tau')}."
        )
    paragraphs = []
    if instead := with_the_effect(saved):
        paragraphs.append(
            f"This assumes that the model is right, which it is not{see('which')}. {instead}"
        )
    if head is not None and head.naive:
        paragraphs.append(naive_sentence(head).removesuffix(".") + see("naive") + ".")
    if saved.posterior_without_effects is not None and posterior is not None:
        paragraphs.append(
            f"This posterior has {list_words(effect_names(posterior))} in its model; the earlier "
            f"one, without, stands beside it{see('both-posteriors')}."
        )
    paragraphs += _why(saved)
    paragraphs += _why_they_differ(saved)
    content: list[Part] = []
    if bounds is not None:
        content.append(
            pictures.add(
                "intervals",
                figures.intervals(bounds),
                "Every method side by side: 68 % (thick) and 95 % (thin) intervals; the marker is "
                "each method's estimate. Orange: the classical bounds under iid noise.",
            )
        )
    if posterior is not None:
        rows = posterior.get("tau_under_priors", [])
        if len({row.get("sensor_is") for row in rows}) > 1:  # one lag or the other
            content.append(_prior_table(rows))
        elif rows:
            limits = [row["upper95_s"] for row in rows]
            lows = [row["lo95_s"] for row in rows]
            here = ". "
            if max(limits) < 1.05 * min(limits):
                alike = max(lows) < 1.2 * min(lows)
                here = ", but not here. " if alike else "; here only the lower ends show it. "
            paragraphs.append(
                "Because the data see τ mainly through its square, the prior matters near zero"
                + here
                + f"Under {_how_many(rows)} the one-sided 95 % upper limits are "
                f"{list_words([_limit(r) for r in rows])}{see('priors-on-tau', 'priors-figure')}."
            )
            content.append(
                pictures.add(
                    "priors-figure",
                    figures.priors_on_tau(rows, PRIOR_WORDS),
                    f"τ under {_how_many(rows)}: equal-tailed 95 % interval (thin) and densest "
                    "95 % (thick), with the one-sided 95 % and 99 % upper limits.",
                )
            )
            content.append(_prior_table(rows))
        content += _both(saved, pictures)
        content.append(posterior_table(saved, shared=True))
        if saved.chains is not None:
            content.append(
                pictures.add(
                    "corner",
                    figures.corner(*saved.chains, unit=saved.unit),
                    "Joint posterior of the shared parameters: regions of 39, 68 and 95 %; dashed "
                    "lines mark the median and the 95 % interval.",
                )
            )
    if bounds is not None:
        if bounds.get("naive"):
            content.append(_naive_table(bounds["naive"]))
        content.append(_method_table(bounds))
        content.append(_assumption_table(bounds))
        content += _steps(bounds, saved.campaign, pictures)
    return Section("tau", "What is the sensor's time constant", answer, paragraphs, content)


def _both(saved: Saved, pictures: Pictures) -> list[Part]:
    """The posteriors of tau with and without the effects."""
    earlier, newest = saved.posterior_without_effects, saved.posterior
    if earlier is None or newest is None or "undecided" in (_order(earlier), _order(newest)):
        return []
    rows = [
        {"model": label, **{key: record["parameters"]["tau_s"][key] for key in _QUANTILES}}
        for label, record in (
            ("without effects", earlier),
            (f"with {list_words(effect_names(newest))}", newest),
        )
    ]
    return [
        pictures.add(
            "both-posteriors-figure",
            figures.posteriors_of_tau(rows),
            "τ without and with the effects in the model: median, 68 % (thick) and 95 % (thin).",
        ),
        Table(
            "both-posteriors",
            "Both posteriors of τ (ms).",
            ["model", *(f"{key.removeprefix('q')} %" for key in _QUANTILES)],
            [[row["model"], *(ms(row[key]) for key in _QUANTILES)] for row in rows],
            digits=3,
        ),
    ]


def _order(posterior: Mapping[str, Any] | None) -> str:
    return str((posterior or {}).get("order", "given"))


_QUANTILES = ("q2.5", "q16", "q50", "q84", "q97.5")


def _limit(row: Mapping[str, Any]) -> str:
    return f"{number(ms(row['upper95_s']), 2)} ms ({PRIOR_WORDS.get(row['prior'], row['prior'])})"


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


def _steps(
    bounds: Mapping[str, Any], campaign: Mapping[str, Any], pictures: Pictures
) -> list[Part]:
    study = bounds.get("step_study")
    if not study:
        return []
    is_replica = is_published(campaign)
    return [
        pictures.add(
            "step_study",
            figures.step_study(study, PUBLISHED_3SD if is_replica else None),
            "The classical bound against the step of the finite difference. It is right only "
            "where the curves are flat: a step of 1 % moves the switch times by tenths of a "
            "second. Open markers: a step so small that forward Euler sees no change of the "
            "switch times at all." + (" Stars: the published bounds." if is_replica else ""),
        )
    ]


def _naive_table(naive: Mapping[str, Any]) -> Table:
    rows: list[list[Any]] = []
    shown = figures.shared_labels(naive["at"])
    classical = [method for method in METHODS.values() if method.cramer_rao is not None]
    for method in sorted(classical, key=lambda method: not method.published_recipe):
        found = naive.get(method.name) or {}
        rows.append(
            [
                method.full_label or method.label,
                *(
                    None if found.get(name) is None else k * factor * found[name]
                    for name, (_, _, factor) in shown.items()
                    for k in (1.0, 1.96)
                ),
            ]
        )
    at = naive["at"]
    place = ", ".join(
        f"{symbol} = {number(factor * at[name])} {unit}"
        for name, (symbol, unit, factor) in shown.items()
    )
    return Table(
        "naive",
        f"The classical bounds at one common point ({place}), where they can be compared: one "
        "standard deviation, and 1.96 of them.",
        [
            "bound",
            *(
                f"{symbol}, {what} ({unit})"
                for symbol, unit, _ in shown.values()
                for what in ("sd", "± 95 %")
            ),
        ],
        rows,
        digits=3,
    )


def _why(saved: Saved) -> list[str]:
    """Why the classical bound misleads here, in numbers of this campaign."""
    naive = (saved.bounds or {}).get("naive") or {}
    right, published = naive.get(WHITE) or {}, naive.get(PUBLISHED) or {}
    said = []
    if right.get("tau_s") and published.get("tau_s"):
        ratio = right["tau_s"] / published["tau_s"]
        if ratio < 1.3:
            said.append(
                "Steps of 1 % in every parameter reproduce the published bounds (the step is "
                "inferred). For the switch times such a step depends on the origin of time, so "
                f"the result is not a bound: here it gives {number(1 / ratio, 2)} times the value "
                f"with correct derivatives{see('naive')}."
            )
        else:
            said.append(
                f"At τ = {number(1e3 * naive['at']['tau_s'], 3)} ms the classical bound for white "
                f"noise, with its derivatives taken correctly, is {number(ratio, 2)} times that "
                "with steps of 1 % in every parameter, which reproduce the published bounds. For "
                "the switch times 1 % is tenths of a second, far too much: a slower sensor and a "
                "later switch look almost alike, and a step that large hides "
                f"it{see('naive', 'step_study')}."
            )
    coloured = naive.get(COLOURED) or {}
    if right.get("tau_v_s") and coloured.get("tau_v_s"):
        ratio = coloured["tau_v_s"] / right["tau_v_s"]
        phi = (saved.residuals or {}).get("ar1", {}).get("phi")
        said.append(
            (
                "White noise is the second assumption that fails: neighbouring residuals are "
                "correlated"
            )
            + (f" (φ = {number(phi, 3)})" if phi is not None else "")
            + f", which makes the bound of τᵥ {number(ratio, 2)} times wider{see('naive')}."
        )
    return said


def _why_they_differ(saved: Saved) -> list[str]:
    """The assumptions of each 95 % interval of tau on the page, if there are several."""
    found = []
    if _order(saved.posterior) == "undecided":
        return []
    if saved.posterior is not None:
        row = saved.posterior["parameters"]["tau_s"]
        found.append(
            f"the posterior's {interval(1e3 * row['q2.5'], 1e3 * row['q97.5'])} ms counts "
            f"the prior on τ and averages over all other parameters{see('posterior-shared')}"
        )
    methods = (saved.bounds or {}).get("methods") or {}
    for name, entry in methods.items():
        row, method = entry["parameters"].get("tau_s") or {}, method_of(name)
        if method.against_others and row.get("lo95") is not None and row.get("hi95") is not None:
            found.append(
                f"the {method.label}'s {interval(1e3 * row['lo95'], 1e3 * row['hi95'])} ms "
                f"{method.against_others}{see('methods')}"
            )
    shrink = (saved.gap or {}).get("shrink") or {}
    low, high = shrink.get("tau_after_lo_s"), shrink.get("tau_after_hi_s")
    if low is not None and high is not None:
        found.append(
            f"the diagnosis's {interval(1e3 * low, 1e3 * high)} ms averages over what may be wrong "
            "with the model, sees the records in bins over a noise floor that was taken without "
            f"the model, and has a log-normal prior on τ{see('which')}"
        )
    if len(found) < 2:
        return []
    return ["The intervals of τ on this page differ because their assumptions differ: "
            f"{'; '.join(found)}."]  # fmt: skip


def _method_table(bounds: Mapping[str, Any]) -> Table:
    rows: list[list[Any]] = []
    marked: list[int] = []
    for name, (symbol, unit, factor) in figures.labels_of_bounds(bounds).items():
        found = [entry["parameters"].get(name) or {} for entry in bounds["methods"].values()]
        widths = [row["hi68"] - row["lo68"] for row in found if _is_bounded(row)]
        narrowest = factor * min(filter(None, widths), default=0.0)
        for method, row in zip(bounds["methods"], found, strict=True):
            values = [
                None if row.get(key) is None else to_spread(factor * row[key], narrowest)
                for key in ("estimate", "sd", "lo68", "hi68", "lo95", "hi95", "lo997", "hi997")
            ]
            if method_of(method).needs_posterior:
                marked.append(len(rows))
            rows.append([f"{symbol} ({unit})", method_of(method).label, *values])
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


def _is_bounded(row: Mapping[str, Any]) -> bool:
    return row.get("lo68") is not None and row.get("hi68") is not None


def _assumption_table(bounds: Mapping[str, Any]) -> Table:
    rows = [
        [
            method_of(method).label,
            typeset(entry["assumes"]),
            entry.get("reference", ""),
            "" if entry.get("status", "ok") == "ok" else typeset(entry["status"]),
        ]
        for method, entry in bounds["methods"].items()
    ]
    return Table(
        "assumptions", "What each method assumes.", ["method", "assumes", "source", "remark"], rows
    )


def _how_many(rows: Collection[Any]) -> str:
    """The priors for which the draws are valid; draws under a bounded prior are not valid beyond
    its end."""
    return {1: "one prior", 2: "two priors"}.get(len(rows), "three priors")


def _prior_table(rows: Sequence[Mapping[str, Any]]) -> Table:
    several = len({row.get("sensor_is") for row in rows}) > 1
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
                *([LAG_WORDS[r["sensor_is"]]] if several else []),
                PRIOR_WORDS.get(r["prior"], r["prior"]),
                *(
                    ms(r[key])
                    for key in (
                        "lo95_s", "hi95_s", "hdi_lo95_s", "hdi_hi95_s", "upper95_s", "upper99_s",
                    )
                ),
                r["n_effective"],
            ]
            for r in rows
        ],
        digits=3,
    )  # fmt: skip
