"""The sensor's time constant, its posterior interval, and the naive bound."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from functools import partial
from math import isclose
from typing import Any

from bayes_sensor import figures
from bayes_sensor.figures.method_words import classical_bound, method_words, quoted, role_of
from bayes_sensor.report.gap_words import with_the_effect
from bayes_sensor.report.headline import Headline, effect_names, headline
from bayes_sensor.report.parts import Part, Pictures, Section, Table, see, to_spread
from bayes_sensor.report.saved import Saved
from bayes_sensor.report.sections.draws_section import corner, posterior_table
from bayes_sensor.report.words import interval, list_words, ms, number, sentence, typeset

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
LAG_WORDS = {"faster": "shorter", "between": "middle", "slower": "longer"}
PRIOR_WORDS = {
    "flat": "flat",
    "half_normal": "half-normal, the default",
    "log_uniform_floored": "log-uniform, flat below its floor",
}


def time_constant(saved: Saved, pictures: Pictures) -> Section | None:
    """tau, its posterior interval, and the other methods beside it."""
    posterior, bounds = saved.posterior, _bounds(saved)
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
    if saved.posterior_without_effects is not None and posterior is not None:
        paragraphs.append(
            f"This posterior has {list_words(effect_names(posterior))} in its model; the earlier "
            f"one, without, stands beside it{see('both-posteriors')}."
        )
    paragraphs += _classical(saved, head)
    if saved.published:
        paragraphs += _one_percent(saved)
    paragraphs += _why_they_differ(saved)
    content: list[Part] = []
    if bounds is not None:
        content.append(
            pictures.add(
                "intervals",
                partial(figures.intervals, bounds),
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
                f"{list_words([_limit(r) for r in rows])}{see('priors-on-tau')}."
            )
            content.append(_prior_table(rows))
        content += _both(saved)
        content.append(posterior_table(saved, shared=True))
        if saved.draws is not None:
            content.append(
                pictures.add(
                    "corner",
                    partial(corner, saved.draws, saved.unit),
                    "Joint posterior of the shared parameters: regions of 39, 68 and 95 %; dashed "
                    "lines mark the median and the 95 % interval.",
                    on_paper=True,
                )
            )
    if bounds is not None:
        if bounds.get("naive"):
            content.append(_naive_table(bounds, saved.published))
        content.append(_method_table(bounds))
        content.append(_assumption_table(bounds))
        content += _steps(saved, pictures)
    return Section("tau", "What is the sensor's time constant", answer, paragraphs, content)


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


def _both(saved: Saved) -> list[Part]:
    """The posteriors of tau with and without the effects."""
    earlier, newest = saved.posterior_without_effects, saved.posterior
    if earlier is None or newest is None or "undecided" in (_order(earlier), _order(newest)):
        return []
    rows = {
        "without effects": earlier,
        f"with {list_words(effect_names(newest))}": newest,
    }
    return [
        Table(
            "both-posteriors",
            "Both posteriors of τ (ms).",
            ["model", *(f"{key.removeprefix('q')} %" for key in _QUANTILES)],
            [
                [label, *(ms(record["parameters"]["tau_s"][key]) for key in _QUANTILES)]
                for label, record in rows.items()
            ],
            digits=3,
        )
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


def _steps(saved: Saved, pictures: Pictures) -> list[Part]:
    study = (saved.bounds or {}).get("step_study")
    if not study or not saved.published:
        return []
    is_replica = is_published(saved.campaign)
    return [
        pictures.add(
            "step_study",
            partial(figures.step_study, study, PUBLISHED_3SD if is_replica else None),
            "The classical bound against the step of the finite difference. It is right only "
            "where the curves are flat: a step of 1 % moves the switch times by tenths of a "
            "second. Open markers: a step so small that forward Euler sees no change of the "
            "switch times at all." + (" Stars: the published bounds." if is_replica else ""),
        )
    ]


def _naive_table(bounds: Mapping[str, Any], with_recipe: bool) -> Table:
    naive = bounds["naive"]
    rows: list[list[Any]] = []
    shown = figures.shared_labels(naive["at"])
    for role in ("published", "white", "coloured") if with_recipe else ("white", "coloured"):
        found, words = classical_bound(bounds, role), method_words(bounds, role_of(bounds, role))
        rows.append(
            [
                words.full_label or words.label,
                *(
                    None if found.get(key) is None else k * factor * found[key]
                    for key, (_, _, factor) in shown.items()
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


def _classical(saved: Saved, head: Headline | None) -> list[str]:
    """The classical bound against the interval that is quoted, and why they differ here."""
    right, coloured = (classical_bound(saved.bounds, role) for role in ("white", "coloured"))
    row = _quoted(saved)
    if head is None or head.undecided or head.hidden or not right.get("tau_s") or row is None:
        return []
    half = 1.96e3 * right["tau_s"]
    ratio = 0.5e3 * (row[1] - row[0]) / half
    said = (
        "The classical Cramér-Rao bound, which takes the samples as independent, alone would have "
        f"said ± {number(half, 2)} ms{see('naive')}: "
    )
    if ratio > CLOSE:
        said += f"here it is too narrow, by a factor of {number(ratio, 2)}."
    elif ratio < 1.0 / CLOSE:
        said += f"here it is {number(1.0 / ratio, 2)} times as wide as the interval above."
    else:
        said += "here it is about as wide as the interval above."
    phi = ((saved.residuals or {}).get("ar1") or {}).get("phi")
    if phi is not None and phi > ALIKE and coloured.get("tau_s"):
        said += (
            f" Neighbouring samples are alike (φ = {number(phi, 2)}); with that in it the bound "
            f"becomes ± {number(1.96e3 * coloured['tau_s'], 2)} ms."
        )
    if head.is_limit:
        said += (
            " Near zero the data see τ through its square, so that no bound from a curvature "
            "describes it, and τ cannot be negative."
        )
    return [said]


def _quoted(saved: Saved) -> tuple[float, float] | None:
    """Ends (s) of the 95 % interval of tau in the headline."""
    if saved.posterior is not None:
        row = saved.posterior["parameters"].get("tau_s")
        return None if row is None else (row["q2.5"], row["q97.5"])
    name = quoted(saved.bounds)
    row = (saved.bounds or {})["methods"][name]["parameters"].get("tau_s") if name else None
    if not row or row["lo95"] is None or row["hi95"] is None:
        return None
    return row["lo95"], row["hi95"]


def _one_percent(saved: Saved) -> list[str]:
    """What steps of 1 % do to the classical bound, which reproduces the published ones."""
    right, published = (classical_bound(saved.bounds, role) for role in ("white", "published"))
    if not (right.get("tau_s") and published.get("tau_s")):
        return []
    ratio = right["tau_s"] / published["tau_s"]
    tau = 1e3 * (saved.bounds or {})["naive"]["at"]["tau_s"]
    said = (
        "Steps of 1 % in every parameter reproduce the published bounds (the step is inferred). "
        "For the switch times 1 % is tenths of a second and depends on the origin of time, so the "
        f"result is not a bound. At τ = {number(tau, 3)} ms "
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
    return [f"{said}{see('naive', 'step_study')}."]


def _why_they_differ(saved: Saved) -> list[str]:
    """The assumptions of each 95 % interval of tau on the page, if there are several."""
    found = []
    if _order(saved.posterior) == "undecided":
        return []
    if saved.posterior is not None:
        row = saved.posterior["parameters"].get("tau_s")
        if row is None:  # several sensors: each has one of its own
            return []
        found.append(
            f"the posterior's {interval(1e3 * row['q2.5'], 1e3 * row['q97.5'])} ms counts "
            f"the prior on τ and averages over all other parameters{see('posterior-shared')}"
        )
    methods = (saved.bounds or {}).get("methods") or {}
    for name, entry in methods.items():
        row = entry["parameters"].get("tau_s") or {}
        method = method_words(saved.bounds or {}, name)
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


def _is_bounded(row: Mapping[str, Any]) -> bool:
    return row.get("lo68") is not None and row.get("hi68") is not None


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
