"""Whether the noise model is adequate."""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping
from functools import partial
from typing import Any

from bayes_sensor import figures
from bayes_sensor.report.parts import Part, Picture, Section, Table, p_value, pointing, see
from bayes_sensor.report.saved import Saved
from bayes_sensor.report.words import p_equals, p_words, scaled, sentence, typeset


def noise(saved: Saved) -> Section | None:
    """Residuals against the noise law, and data replicated from the posterior."""
    residuals = saved.residuals
    if residuals is None:
        return None
    failed = saved.predictive is not None and saved.predictive["failed"]
    answer = ("Yes. " if residuals["adequate"] and not failed else "Not fully. ") + sentence(
        typeset(residuals["verdict"])
    )
    if residuals.get("recommendation"):
        answer = f"{answer.removesuffix('.')}. {residuals['recommendation']}"
    test = residuals["variance_vs_concentration"]["breusch_pagan"]
    before, after = (residuals["durbin_watson"][k] for k in ("before", "after"))
    if saved.predictive is not None:
        status = re.sub(r"\(p \S+e-\S+\)", "(p below 0.001)", saved.predictive["status"])
        answer += " " + pointing(typeset(status), "predictive-table")
    paragraphs = [
        "Correlated residuals contain less information than their number suggests. The "
        f"Durbin-Watson statistic, 2 for independent noise, is {before:.2f} before and {after:.2f} "
        f"after the AR(1) part is taken out{see('ljung-box')}.",
    ]
    if test.get("p_value") is not None:
        verb = "does" if test["p_value"] < 0.05 else "does not clearly"
        paragraphs.append(
            f"The spread {verb} change with concentration (Breusch-Pagan test on {test['n']} "
            f"samples far enough apart to be independent, p {p_equals(test['p_value'])})"
            f"{see('spread')}."
        )
    return Section(
        "noise", "Is the noise model adequate", answer, paragraphs, list(_content(residuals, saved))
    )


def _content(residuals: Mapping[str, Any], saved: Saved) -> Iterator[Part]:
    rms = saved.fit["rms_V"] if saved.fit else _rms(residuals)
    yield from (
        Picture(
            "autocorrelation",
            partial(figures.autocorrelation, residuals, saved.traces or []),
            "Autocorrelation of the residuals of all experiments in a row, with the curve of the "
            "fitted AR(1); below, the residuals themselves, shades alternating from experiment to "
            "experiment.",
        ),
        Picture(
            "spread",
            partial(figures.spread, residuals),
            "Standard deviation of the residuals in bins of concentration, with the fitted law.",
        ),
        Picture(
            "histogram",
            partial(figures.histogram, residuals, rms),
            f"Distribution of the residuals ({residuals['histogram']['note']}).",
        ),
    )
    yield _checks_table(residuals.get("checks") or {})
    if saved.predictive is not None:
        yield from _predictive(saved.predictive, saved.unit)
    lb = residuals["ljung_box"]
    tests = [lb[side][key] for side in ("before", "after") for key in ("statistic", "p_value")]
    yield Table(
        "ljung-box",
        "Ljung-Box test for correlation up to a lag, before and after whitening by the AR(1). "
        "With many samples a small p-value also comes from correlations too small to matter.",
        ["lag (samples)", "Q before", "p before", "Q after", "p after"],
        [
            [lag, before, p_value(p_before), after, p_value(p_after)]
            for lag, before, p_before, after, p_after in zip(lb["lags"], *tests, strict=True)
        ],
    )
    unit, factor = saved.small_unit
    yield Table(
        "noise-experiments",
        "Residuals of each experiment.",
        [
            "experiment", f"RMS ({unit})", "lag-one correlation", f"sd, baseline ({unit})",
            f"sd, plateau ({unit})",
        ],
        [
            [
                name, factor * e["rms_V"], e["lag_one"], scaled(e["baseline_sd_V"], factor),
                scaled(e["plateau_sd_V"], factor),
            ]
            for name, e in residuals["experiments"].items()
        ],
        digits=3,
    )  # fmt: skip


OF_THE_LAW = {
    "correlation": ("slow part of the whitened residuals", ""),
    "variance_concentration": ("variance against concentration", "of the highest concentration"),
    "variance_slope": ("variance against the response's slope", "of the largest slope"),
    "rounding": ("the converter's step over the standard deviation", ""),
}


def _checks_table(checks: Mapping[str, Any]) -> Table:
    """The checks of the noise law, and their deviations."""
    rows = []
    for name, check in checks.items():
        words, place = OF_THE_LAW.get(name, (name, ""))
        low, high = check.get("low"), check.get("high")
        if place and low is not None and high is not None:
            words += f", {100.0 * low:.3g} to {100.0 * high:.3g} % {place}"
        p = check.get("p_value")
        verdict = "passes" if check["adequate"] else "fails"
        rows.append([words, check.get("factor"), "" if p is None else p_words(p), verdict])
    return Table(
        "noise-checks",
        "Checks of the noise law: the measured value over the law's, where the difference is "
        "largest. A check fails if the difference is significant and large enough to matter.",
        ["check", "factor", "p-value", "verdict"],
        rows,
        digits=3,
    )


CHECKS = {
    "autocorrelation": "autocorrelation at eight lags",
    "variance": "variance against concentration",
    "spectrum": "spectrum of the residuals",
    "pit_uniform": "forecasts of the next sample: spread",
    "pit_independent": "forecasts of the next sample: independence",
}


def _predictive(record: Mapping[str, Any], unit: str) -> list[Part]:
    """Data replicated from the posterior, compared with the data."""
    return [
        Picture(
            "predictive",
            partial(figures.predictive, record, unit),
            "Comparison of the data with data drawn from the posterior. Bands: 95 % of "
            f"{record['n_draws']} replicates; points: the data. Last: probability of each sample "
            "under the forecast from its past; a right model gives a flat histogram.",
        ),
        Table(
            "predictive-table",
            "Posterior predictive checks: probability of a difference at least as large, were the "
            "model right. A check fails if that is below 1 % after allowing for their number "
            "(Holm).",
            ["check", "p-value", "verdict"],
            [
                [
                    CHECKS.get(name, name),
                    p_words(p),
                    "fails" if name in record["failed"] else "passes",
                ]
                for name, p in record["p_values"].items()
            ],
        ),
    ]


def _rms(residuals: Mapping[str, Any]) -> float:
    rows = residuals["experiments"].values()
    n = sum(e["n"] for e in rows)
    return float((sum(e["n"] * e["rms_V"] ** 2 for e in rows) / n) ** 0.5)
