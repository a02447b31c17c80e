"""What was measured."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import partial
from typing import Any

from bayes_sensor import figures
from bayes_sensor.campaign import counted
from bayes_sensor.figures.labels import thousands
from bayes_sensor.report.parts import Part, Picture, Section, Table, see
from bayes_sensor.report.saved import Saved
from bayes_sensor.report.words import list_words, scaled, sentence


def measured(saved: Saved) -> Section | None:
    """The experiments, as they were understood."""
    campaign = saved.campaign
    rows = campaign["experiments"]
    if not rows:  # a blind check has many campaigns
        return None
    intervals = sorted({e["interval_s"] for e in rows})
    n_fall = sum(e["commanded_off_s"] is not None for e in rows)
    answer = (
        f"{counted(len(rows), 'step experiment')} with "
        f"{thousands(campaign['n_samples'])} samples in use, one every "
        f"{list_words([f'{1e3 * h:g} ms' for h in intervals])}{_flows(rows)}{see('experiments')}."
    )
    paragraphs = []
    programmes = [e for e in rows if e.get("switches", 1) > 2 or e.get("switches") == 0]
    if programmes:
        paragraphs.append(_of_programmes(programmes))
    elif n_fall == 0:
        paragraphs.append(
            "Only the step up was recorded: there is no end of the step, so no end time is "
            "estimated."
        )
    elif n_fall < len(rows):
        paragraphs.append(f"{n_fall} of {len(rows)} experiments also recorded the step down.")
    if campaign.get("same_flow") and len(rows) > 1:
        paragraphs.append(
            "All experiments share one total flow. Lags that do not depend on it and the volumes' "
            "V/Q then act alike and cannot be separated by these data."
        )
    if "sensor_is" in campaign:
        paragraphs.append(_of_rig(campaign))
    if ties := campaign.get("ties"):
        said = list_words([f"{name} = {to}" for name, to in ties.items()])
        paragraphs.append(f"Tied, so not estimated apart: {said}.")
    for name, info in campaign.get("side_information", {}).items():
        symbol, unit, factor = figures.parameter_words(name, saved.unit)
        paragraphs.append(
            f"Known beforehand and used as a prior: {symbol} = {factor * info['mean']:g} ± "
            f"{factor * info['sd']:g} {unit}."
        )
    unit, (small, factor) = saved.unit, saved.small_unit
    table = Table(
        "experiments",
        "The experiments as understood. On and off are the commanded times; noise is that of the "
        "baseline.",
        [
            "experiment", "samples used", "interval (ms)", "length (s)", "flow (L/min)",
            "test gas (%)", "on (s)", "off (s)", f"baseline ({unit})", f"step ({unit})",
            f"noise ({small})", "file",
        ],
        [
            [
                e["experiment"], e["used"], 1e3 * e["interval_s"], e["duration_s"],
                e["total_flow_L_min"], e["concentration_percent"], e["commanded_on_s"],
                e["commanded_off_s"], e["baseline_V"], e["step_V"],
                scaled(e["noise_V"], factor), e["file"],
            ]
            for e in rows
        ],
    )  # fmt: skip
    content: list[Part] = [table]
    if saved.traces:
        content.append(
            Picture(
                "responses",
                partial(figures.responses, saved.traces),
                "The recorded responses by test-gas concentration, one line a flow; dotted, the "
                "commanded times.",
            )
        )
    return Section("measured", "What was measured", answer, paragraphs, content)


def _of_rig(campaign: Mapping[str, Any]) -> str:
    """The rig as a sentence."""
    said = f"The gas passes {list_words(campaign['stages'])}"
    if campaign["sensor_is"] == "unknown":
        return (
            f"{said}. Lags in a row commute, and the campaign does not say which of those that do "
            'not depend on flow is the sensor\'s ([rig] sensor_is = "faster" or "slower").'
        )
    lag = {"faster": "shortest", "slower": "longest"}[campaign["sensor_is"]]
    return f"{said}; the sensor is said to be the {lag} of the lags that do not depend on flow."


def _flows(rows: Sequence[Mapping[str, Any]]) -> str:
    """Flows and concentrations in words; empty where no flow is known."""
    known = [row for row in rows if row["total_flow_L_min"] is not None]
    if not known:
        return "; no flow is known"
    return (
        f"; total flow {_span(known, 'total_flow_L_min')} L/min, test gas "
        f"{_span(known, 'concentration_percent')} %"
    )


def _of_programmes(rows: Sequence[Mapping[str, Any]]) -> str:
    """What was done to the gas where it is more than one pulse, in sentences."""
    said = []
    for row in rows:
        n = row["switches"]
        what = "a recorded channel is the input" if n == 0 else f"the input switches {n} times"
        said.append(f"in experiment '{row['experiment']}' {what}")
    return sentence(list_words(said))


def _span(rows: Sequence[Mapping[str, Any]], key: str) -> str:
    values = [row[key] for row in rows]
    low, high = f"{min(values):.3g}", f"{max(values):.3g}"
    return low if low == high else f"{low} to {high}"
