"""The comparison of a fleet: its table, common mean and spread of tau, figure and page."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from importlib import resources
from typing import TYPE_CHECKING, Any

import numpy as np

from bayes_sensor.figures.quoted_tau import has_cause, quoted_tau
from bayes_sensor.fleet.outcome import COLUMNS, DONE, FAILED, NOT_CONVERGED
from bayes_sensor.io.csv_text import csv_text
from bayes_sensor.io.json_files import json_text
from bayes_sensor.io.results import StagingFolder

if TYPE_CHECKING:
    import pandas as pd

Row = Mapping[str, Any]


def table(rows: Sequence[Row]) -> pd.DataFrame:
    """One row a campaign, in the order of the list."""
    import pandas as pd

    frame = pd.DataFrame([[row.get(name) for name in COLUMNS] for row in rows], columns=COLUMNS)
    return frame.astype({"experiments": "Int64", "samples": "Int64", "tau_is_limit": "boolean"})


def comparison(rows: Sequence[Row]) -> dict[str, Any]:
    """Counts of campaigns by status, and whether their tau differ by more than their intervals.

    If three campaigns or more bound tau from both sides: Cochran's Q of tau against its common
    mean, its p-value, and the spread between sensors by DerSimonian and Laird's moments (Control.
    Clin. Trials 7, 177, 1986); weights are one over the posterior's variance.  Where the diagnosis
    found a cause, tau and its spread are those with the cause in the model.
    """
    from scipy import stats

    count = {
        state: sum(r["status"] == state for r in rows) for state in (DONE, NOT_CONVERGED, FAILED)
    }
    done = [r for r in rows if r["status"] == DONE]
    known = [r for r in done if not r["tau_is_limit"] and r["tau_sd_s"]]
    found: dict[str, Any] = {
        "n": len(rows), "done": count[DONE], "not_converged": count[NOT_CONVERGED],
        "failed": count[FAILED],
        "limits": sum(bool(r["tau_is_limit"]) for r in done),
        "undecided": sum(r.get("order") == "undecided" for r in done),
        "median_tau_s": None, "mean_tau_s": None, "mean_tau_sd_s": None,
        "between_sensors_sd_s": None, "cochran_q": None, "p_value": None, "n_compared": len(known),
    }  # fmt: skip
    shown = [quoted_tau(r)[1] for r in done if r["tau_s"] is not None]
    if shown:
        found["median_tau_s"] = float(np.median(shown))
    if len(known) >= 3:
        tau = np.array([quoted_tau(r)[1] for r in known])
        weight = np.array([_sd(r) for r in known]) ** -2.0
        q = float(weight @ (tau - weight @ tau / weight.sum()) ** 2)
        n = len(known)
        between = (q - (n - 1)) / (weight.sum() - (weight @ weight) / weight.sum())
        between = max(0.0, float(between))
        widened = 1.0 / (1.0 / weight + between)
        found.update(
            mean_tau_s=float(widened @ tau / widened.sum()),
            mean_tau_sd_s=float(widened.sum() ** -0.5),
            between_sensors_sd_s=between**0.5,
            cochran_q=q,
            p_value=float(stats.chi2.sf(q, n - 1)),
        )
    return found


def _sd(row: Row) -> float:
    """s, of :func:`quoted_tau`; from the width of the interval where no draws stand behind it."""
    from bayes_sensor.bounds.gaussian_intervals import normal_factor

    if not has_cause(row):
        return float(row["tau_sd_s"])
    low, _, high = quoted_tau(row)
    return (high - low) / (2.0 * normal_factor(0.95))


def sentences(found: Mapping[str, Any]) -> list[str]:
    """The comparison in words."""
    from bayes_sensor.report import number, p_words

    said = [
        f"{found['n']} campaigns: {found['done']} done, {found['not_converged']} not converged, "
        f"{found['failed']} failed."
    ]
    if found["limits"]:
        said.append(f"Of those done {found['limits']} know τ only as an upper limit.")
    if found.get("undecided"):
        said.append(
            f"Of those done {found['undecided']} do not say which lag is the sensor's ([rig] "
            "sensor_is): they have no τ and are left out of what is said of it."
        )
    if found["p_value"] is not None:
        p = p_words(found["p_value"])
        differ = found["p_value"] < 0.05
        said.append(
            f"{'Sensors differ' if differ else 'Sensors agree'}: over the {found['n_compared']} "
            f"that know τ from both sides its mean is {number(1e3 * found['mean_tau_s'])} ± "
            f"{number(1e3 * found['mean_tau_sd_s'], 2)} ms, the spread between them "
            f"{number(1e3 * found['between_sensors_sd_s'], 2)} ms beyond their own errors "
            f"(Cochran's Q, p {p if p.startswith('below') else '= ' + p})."
        )
    return said


def write_comparison(stage: StagingFolder, rows: Sequence[Row], version: str) -> dict[str, Any]:
    """Write fleet.csv, fleet.json, the figure and index.html to a temporary folder; the
    comparison."""
    from bayes_sensor import figures

    found = comparison(rows)
    frame = table(rows)
    stage.text("fleet.csv", csv_text(frame))
    stage.text("fleet.json", json_text({"comparison": found, "campaigns": list(rows)}))
    drawing = None
    if any(row["status"] != FAILED for row in rows):
        figure = figures.forest(rows, found["median_tau_s"])
        drawing = figures.svg(figure)
        stage.text("fleet.svg", drawing)
        stage.binary("fleet.png", figures.png(figure))
    else:
        stage.drop += ["fleet.svg", "fleet.png"]
    stage.text("index.html", page(rows, found, drawing, version))
    return found


SHOWN = (
    ("sensor τ (ms)", "tau_s", 1e3), ("low 95 %", "tau_lo95_s", 1e3),
    ("high 95 %", "tau_hi95_s", 1e3), ("upper limit 95 %", "tau_upper95_s", 1e3),
    ("valve τᵥ (ms)", "tau_v_s", 1e3), ("volume V (mL)", "V_mL", 1.0), ("φ", "phi", 1.0),
    ("residual RMS", "rms_V", 1.0),
)  # fmt: skip
"""numbers of the page's table; all others are in fleet.csv"""


def _shown(row: Row) -> list[float | None]:
    values = dict(row)
    values["tau_lo95_s"], values["tau_s"], values["tau_hi95_s"] = quoted_tau(row)
    return [None if values[key] is None else factor * values[key] for _, key, factor in SHOWN]


def page(rows: Sequence[Row], found: Mapping[str, Any], drawing: str | None, version: str) -> str:
    """The index page: self-contained, with a link to each campaign's report."""
    from urllib.parse import quote

    from jinja2 import Environment, StrictUndefined
    from markupsafe import Markup

    from bayes_sensor.report.drawing import inline_svg
    from bayes_sensor.report.parts import Table

    places = resources.files("bayes_sensor") / "templates"

    def asset(name: str) -> Markup:
        return Markup((places / name).read_text(encoding="utf-8"))

    columns = [
        "campaign", "status", *(words for words, _, _ in SHOWN), "unit", "gap", "message or title",
    ]  # fmt: skip
    shown = Table(
        "campaigns",
        "Every campaign: posterior medians and 95 % limits; the upper limit is one-sided, under "
        "the half-normal prior. Where the diagnosis found a cause, τ and its limits are those "
        "with the cause in the model.",
        columns,
        [
            [
                row["campaign"],
                row["status"],
                *_shown(row),
                row["signal_unit"],
                (row["gap_effects"] or row["gap"] or "").replace("_", " ") or None,
                row["message"] or row["title"],
            ]
            for row in rows
        ],
        marked=[i for i, row in enumerate(rows) if row["status"] != DONE],
    )
    label = "tau of every campaign with its intervals"
    environment = Environment(autoescape=True, undefined=StrictUndefined, trim_blocks=True)
    return environment.from_string(asset("fleet.html.j2")).render(
        version=version,
        said=sentences(found),
        table=shown,
        links=[quote(row["report"]) if row["report"] else "" for row in rows],
        drawing=None if drawing is None else Markup(inline_svg(drawing, "forest", label)),
        css=asset("report.css"),
        script=asset("report.js"),
    )
