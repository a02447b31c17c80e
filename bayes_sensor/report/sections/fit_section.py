"""How well the model fits."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from bayes_sensor import figures
from bayes_sensor.report.parts import Part, Pictures, Section, Table, see
from bayes_sensor.report.saved import Saved
from bayes_sensor.report.words import list_words, number


def fitted(saved: Saved, pictures: Pictures) -> Section | None:
    """Overlays, RMS residuals and least-squares values."""
    fit = saved.fit
    if fit is None:
        return None
    shown, factor = saved.small_unit
    n = len(saved.campaign["experiments"])
    answer = (
        f"The model leaves an RMS residual of {number(factor * fit['rms_V'])} {shown} over all "
        f"samples{see('rms', 'fit-experiments')}. "
    )
    answer += (
        f"In {saved.missed} of {n} experiments it does not describe the trace within the noise; "
        "the figures below show where."
        if saved.missed
        else "No experiment shows a misfit that its noise would not explain."
    )
    if not saved.missed and saved.gap is not None and saved.gap["verdict"]["kind"] != "none":
        answer += f" All of them together do{see('where')}."
    content: list[Part] = list(_overlays(saved, pictures))
    traces = saved.traces or []
    if len(traces) > 1:
        content.append(
            pictures.add(
                "rms",
                figures.rms_bars(traces),
                "RMS residual of each experiment, with the RMS of the noise law alone.",
            )
        )
    content += _tables(saved)
    return Section("fit", "How well does the model fit", answer, _remarks(saved), content)


def _remarks(saved: Saved) -> list[str]:
    fit = saved.fit
    assert fit is not None
    said = []
    unseen = [name for name, value in _estimates(fit).items() if value is None]
    if unseen:
        words = list_words([figures.parameter_words(name)[0] for name in unseen])
        said.append(
            f"The best {words} {'sits' if len(unseen) == 1 else 'sit'} at the lower edge of "
            f"{'its' if len(unseen) == 1 else 'their'} search range. The data do not exclude "
            "smaller values, so no least-squares value is given; the posterior has upper limits."
        )
    others = [figures.parameter_words(n)[0] for n in fit["at_bound"] if n not in unseen]
    if others:
        said.append(
            f"The best value of {list_words(others)} sits on the edge of its search range: widen "
            "it ([fit] bounds in the settings), or do not use it."
        )
    lags = fit.get("n_lags")
    if lags:
        said.append(
            f"Number of lags, chains of one to {len(lags['log_evidence'])} compared by their "
            f"evidence: {lags['sentence']}."
        )
    if not fit["swarms"].get("agree", True):
        said.append("Independent swarms ended at different minima; the best one is shown.")
    else:
        n = len(fit["swarms"].get("swarms", []))
        said.append(
            f"{n} independent particle swarms ended, after refinement, at the same minimum."
        )
    if fit.get("euler"):
        change = fit["euler"]["difference"]
        moves = [
            f"{words.split()[-1] if name in _SYMBOLS else f'the {words}'} by "
            f"{number(factor * change[name], 2)} {unit}"
            for name, (words, unit, factor) in figures.shared_labels(change).items()
            if name not in unseen
        ]
        said.append(
            "Solved by forward Euler instead of exactly, as in the published analysis, the same "
            f"fit moves {list_words(moves)}."
        )
    return said


_SYMBOLS = ("tau_s", "tau_v_s", "V_mL")


def _estimates(fit: Mapping[str, Any]) -> dict[str, float | None]:
    """The shared values by name, or by size of the lags; None where one is too small to be seen."""
    found = fit.get("estimates")
    if found is None:  # results of an older version
        p = fit["parameters"]
        found = {name: p[name] for name in _SYMBOLS if name in p}
        if "tau_s" in fit["at_bound"]:
            found["tau_s"] = None
    return {name: found[name] for name in figures.shared_labels(found)}


def _overlays(saved: Saved, pictures: Pictures) -> list[Part]:
    shown, factor = saved.small_unit
    return [
        pictures.add(
            f"overlay_{k + 1}",
            figures.overlay(trace),
            f"Experiment {trace.name}: {60e-3 * trace.total_flow:.3g} L/min, "
            f"{100 * trace.concentration:.3g} % test gas; RMS {number(factor * trace.rms)} "
            f"{shown}. Blue: all samples, as the range in each stretch of time.",
            overlay=k,
        )
        for k, trace in enumerate(saved.traces or [])
    ]


def _tables(saved: Saved) -> list[Part]:
    assert saved.fit is not None
    unit, (shown, factor) = saved.unit, saved.small_unit
    p = saved.fit["parameters"]
    noise = {name: p[name] for name in ("phi", "sigma0_V", "sigma1_V") if name in p}
    rows: list[list[Any]] = []
    for name, value in (_estimates(saved.fit) | noise).items():
        symbol, unit_shown, scale = figures.parameter_words(name, unit)
        rows.append([symbol, unit_shown, None if value is None else scale * value])
    rms_of = saved.fit.get("rms_per_experiment_V", {})
    return [
        Table(
            "fit-shared",
            "Least-squares values of the shared parameters, and the noise of the residuals. For "
            "intervals see the next section.",
            ["parameter", "unit", "value"],
            rows,
            digits=5,
        ),
        Table(
            "fit-experiments",
            "Least-squares values of each experiment.",
            ["experiment", f"y₀ ({unit})", f"β ({unit})", "t₀ (s)", "t_f (s)", f"RMS ({shown})"],
            [
                [
                    name, values.get("y0_V"), values.get("beta_V"), values.get("t0_s"),
                    values.get("tf_s"), factor * rms_of[name] if name in rms_of else None,
                ]
                for name, values in p["experiments"].items()
            ],
            digits=5,
        ),
    ]  # fmt: skip
