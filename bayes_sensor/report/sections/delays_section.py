"""How the delays depend on flow."""

from __future__ import annotations

from functools import partial

from bayes_sensor import figures
from bayes_sensor.report.parts import Part, Picture, Section, Table, p_value, see
from bayes_sensor.report.saved import Saved
from bayes_sensor.report.words import list_words, number, p_equals


def switching(saved: Saved) -> Section | None:
    """Delays of the switches against 1/Q."""
    delays = saved.delays
    if delays is None:
        return None
    said, points = [], []
    paragraphs = [
        "A constant part comes from valve and electronics; the slope is the volume that the gas "
        "has to fill before it reaches the sensor."
    ]
    for side in ("start", "end"):
        line = delays.get(side)
        if not line:
            said.append("No step down was recorded, so there is no delay of the end.")
            continue
        if line["slope_L"] is None:
            said.append(f"Delay of the {side}: {line['status']}")
        else:
            lo, hi = line["ci95"]["slope_L"]
            text = (
                f"Delay of the {side} = {number(line['intercept_s'])} s + "
                f"{number(line['slope_L'])} L / Q (95 % interval of the slope {number(lo)} to "
                f"{number(hi)} L, R² = {line['r2']:.3f}, p {p_equals(line['p_value'])}, "
                f"{line['n']} experiments)"
            )
            if line["outliers"]:
                text += f"; experiment {list_words(line['outliers'])} is an outlier and left out"
            said.append(f"{text}{see('delays-table')}.")
        points += [
            [
                side, p["experiment"], p["inverse_flow_s_per_L"], p["delay_s"],
                p["studentised_residual"], p_value(p["bonferroni_p"]), p["used"],
            ]
            for p in line["points"]
        ]  # fmt: skip
        weighted = (line.get("weighted") or {}).get("slope_L")
        if weighted is not None:
            paragraphs.append(
                "By generalised least squares with the posterior covariance, the "
                f"{side}'s slope is {number(weighted)} L."
            )
    table = Table(
        "delays-table",
        "The delays. Studentised residuals are those of the regression on all experiments.",
        [
            "switch", "experiment", "1/Q (s/L)", "delay (s)", "studentised residual",
            "p (Bonferroni)", "used",
        ],
        points,
    )  # fmt: skip
    picture = Picture(
        "delays",
        partial(figures.delays, delays, saved.concentration),
        "Delay between command and fitted switch against 1/Q, with the regression and its "
        "95 % prediction band. Open orange: outliers, found by their externally "
        "studentised residual and left out.",
    )
    content: list[Part] = [picture, table] if points else []
    title = "How do the delays depend on flow"
    return Section("delays", title, " ".join(said), paragraphs, content)
