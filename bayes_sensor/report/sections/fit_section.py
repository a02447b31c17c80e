"""How well the model fits."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from functools import partial
from typing import Any

from bayes_sensor import figures
from bayes_sensor.report.parts import Part, Picture, Section, Table, see
from bayes_sensor.report.saved import Saved
from bayes_sensor.report.words import list_words, number, scaled

MOST_SWITCHES = 6
"""columns of switch times in a table"""


def fitted(saved: Saved) -> Section | None:
    """Overlays, RMS residuals and least-squares values."""
    fit = saved.fit
    if fit is None:
        return None
    shown, factor = saved.small_unit
    n = len(saved.campaign["experiments"])
    answer = (
        f"The model leaves an RMS residual of {number(factor * fit['rms_V'])} {shown} over all "
        f"samples{see('fit-experiments')}. "
    )
    answer += (
        f"In {saved.missed} of {n} experiments it does not describe the trace within the noise; "
        "the figures below show where."
        if saved.missed
        else "No experiment shows a misfit that its noise would not explain."
    )
    if not saved.missed and saved.gap is not None and saved.gap["verdict"]["kind"] != "none":
        answer += f" All of them together do{see('where')}."
    content = [*_overlays(saved), *_tables(fit, saved)]
    paragraphs = list(_remarks(fit, saved.published))
    return Section("fit", "How well does the model fit", answer, paragraphs, content)


def _remarks(fit: Mapping[str, Any], with_published: bool) -> Iterator[str]:
    unseen = [name for name, value in _estimates(fit).items() if value is None]
    if unseen:
        words = list_words([figures.parameter_words(name)[0] for name in unseen])
        sits, its = ("sits", "its") if len(unseen) == 1 else ("sit", "their")
        yield (
            f"The best {words} {sits} at the lower edge of {its} search range. The data do not "
            "exclude smaller values, so no least-squares value is given; the posterior has upper "
            "limits."
        )
    others = [figures.parameter_words(n)[0] for n in fit["at_bound"] if n not in unseen]
    if others:
        yield (
            f"The best value of {list_words(others)} sits on the edge of its search range: widen "
            "it ([fit] bounds in the settings), or do not use it."
        )
    lags = fit.get("n_lags")
    if lags:
        yield (
            f"Number of lags, chains of one to {len(lags['log_evidence'])} compared by their "
            f"evidence: {lags['sentence']}."
        )
    if not fit["swarms"].get("agree", True):
        yield "Independent swarms ended at different minima; the best one is shown."
    elif (n := len(fit["swarms"].get("swarms", []))) > 1:
        yield f"{n} independent particle swarms ended, after refinement, at the same minimum."
    if fit.get("euler") and with_published:
        change = fit["euler"]["difference"]
        moves = [
            f"{words.split()[-1] if name in _SYMBOLS else f'the {words}'} by "
            f"{number(factor * change[name], 2)} {unit}"
            for name, (words, unit, factor) in figures.shared_labels(change).items()
            if name not in unseen
        ]
        yield (
            "Solved by forward Euler instead of exactly, as in the published analysis, the same "
            f"fit moves {list_words(moves)}."
        )


_SYMBOLS = ("tau_s", "tau_v_s", "V_mL")


def _estimates(fit: Mapping[str, Any]) -> dict[str, float | None]:
    """The shared values by name, or by size of the lags; None where one is too small to be seen."""
    return {name: fit["estimates"][name] for name in figures.shared_labels(fit["estimates"])}


def _flow(trace: Any) -> str:
    """Flow and concentration in words; empty where no flow is known."""
    if trace.total_flow != trace.total_flow:
        return ""
    return f"{60e-3 * trace.total_flow:.3g} L/min, {100 * trace.concentration:.3g} % test gas; "


def _overlays(saved: Saved) -> list[Part]:
    shown, factor = saved.small_unit
    return [
        Picture(
            f"overlay_{k + 1}",
            partial(figures.overlay, trace),
            f"Experiment {trace.name}: {_flow(trace)}RMS {number(factor * trace.rms)} "
            f"{shown}. Blue: all samples, as the range in each stretch of time.",
            overlay=k,
        )
        for k, trace in enumerate(saved.traces or [])
    ]


def _tables(fit: Mapping[str, Any], saved: Saved) -> Iterator[Part]:
    """The shared values and the noise; then levels and switch times or delays by experiment."""
    unit, (shown, factor) = saved.unit, saved.small_unit
    parameters, experiments = fit["parameters"], fit["parameters"]["experiments"]
    kinds = ("phi", "sigma0_V", "sigma1_V")
    noise = {name: parameters[name] for name in parameters if name.split("[")[0] in kinds}
    rows: list[list[Any]] = []
    for name, value in (_estimates(fit) | noise).items():
        symbol, unit_shown, scale = figures.parameter_words(name, unit)
        rows.append([symbol, unit_shown, scaled(value, scale)])
    yield Table(
        "fit-shared",
        "Least-squares values of the shared parameters, and the noise of the residuals. For "
        "intervals see the next section.",
        ["parameter", "unit", "value"],
        rows,
        digits=5,
    )
    rms_of = fit.get("rms_per_experiment_V", {})
    times = list(
        dict.fromkeys(kind for own in experiments.values() for kind in own if kind.endswith("_s"))
    )
    title = "Least-squares values of each experiment"
    if len(times) > MOST_SWITCHES:
        title += f"; of {len(times)} switch times the first {MOST_SWITCHES} (all are in fit.json)"
    shown_times = times[:MOST_SWITCHES]
    heads = [f"{figures.parameter_words(kind)[0]} (s)" for kind in shown_times]
    yield Table(
        "fit-experiments",
        f"{title}.",
        ["experiment", f"y₀ ({unit})", f"β ({unit})", *heads, f"RMS ({shown})"],
        [
            [
                name,
                *(own.get(kind) for kind in ("y0_V", "beta_V", *shown_times)),
                scaled(rms_of.get(name), factor),
            ]
            for name, own in experiments.items()
        ],
        digits=5,
    )
