"""Response times as in data sheets, and the diffusivity of the coating that follows from tau."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from bayes_sensor.report.gap_words import with_the_effect
from bayes_sensor.report.parts import Part, Section, Table, see
from bayes_sensor.report.saved import Saved
from bayes_sensor.report.words import LAG_WORDS, interval, number, powers, sentence, with_spread

TOLERANCE_WORDS = {
    "d_pdms": "diffusivity of PDMS",
    "thickness_zif8": "thickness of ZIF-8",
    "thickness_pdms": "thickness of PDMS",
    "outer_radius": "outer radius",
}


def _at(row: Mapping[str, Any]) -> str:
    """The total flow of a row in words; empty where none is known."""
    flow = row["total_flow_L_per_min"]
    return "" if flow is None else f" at {flow:.3g} L/min"


def coating(saved: Saved) -> Section | None:
    """t10, t63, t90 of sensor and chain; the diffusivity that follows from tau."""
    record = saved.coating
    if record is None:
        return None
    rows = record["response_times"]
    sensors = [row for row in rows if row["system"].startswith("sensor")]
    chain = [row for row in rows if row["system"].startswith("chain")]
    fast, slow = chain[-1], chain[0]
    if len(sensors) == 1:
        alone = f"The sensor alone reaches 90 % within {_time(sensors[0], 't90', 1e3)} ms"
    else:
        alone = "How long the sensor alone takes depends on which lag is its, and that is not known"
    answer = f"{alone}; the whole {slow['system']} takes {_time(slow, 't90', 1.0)} s{_at(slow)}"
    same_flow = fast["system"] == slow["system"] and _at(fast) == _at(slow)
    if fast is not slow and not same_flow:
        to = "" if fast["system"] == slow["system"] else f", the {fast['system']}"
        answer += f"{to or ' and'} {_time(fast, 't90', 1.0)} s{_at(fast)}"
    answer += f" (median and 95 % interval){see('response-times')}."
    paragraphs = [
        "The chain is linear, so a fall takes as long as the rise at the same flow. Should the "
        "flow drop when the valve shuts, or the sensor release more slowly than it takes up, the "
        "section on the gap says so."
    ]
    if saved.published and record.get("d_zif8") is None and "d_zif8_left_out" not in record:
        paragraphs.append(
            "The diffusivity of the coating was not computed: run bayes-sensor analyze with "
            "--compare-published."
        )
    if saved.published and record.get("d_zif8_left_out"):
        paragraphs.append(sentence(record["d_zif8_left_out"]))
    if with_the_effect(saved):
        paragraphs.append(
            f"All this uses the posterior without the effect that the gap names{see('which')}; "
            "sample it with the effect before quoting."
        )
    content: list[Part] = [_times_table(rows)]
    found = record.get("d_zif8") if saved.published else None
    if found is not None:
        paragraphs += _inverse(found)
        content.append(_diffusivity_table(found))
    title = "Response times and the coating" if saved.published else "Response times"
    return Section("coating", title, answer, paragraphs, content)


def _time(row: dict[str, Any], name: str, factor: float) -> str:
    low, middle, high = (factor * row[f"{name}{end}_s"] for end in ("_lo", "", "_hi"))
    return f"{with_spread(middle, high - low)} {interval(low, high)}"


def _times_table(rows: list[dict[str, Any]]) -> Table:
    made = []
    for row in rows:
        values = [
            1e3 * row[f"{name}{end}_s"]
            for name in ("t10", "t63", "t90", "rise")
            for end in ("", "_lo", "_hi")
        ]
        label = _sensor_words(row) if row["system"] == "sensor" else "chain"
        made.append([label, row["total_flow_L_per_min"], *values])
    columns = ["system", "flow (L/min)"]
    for name in ("t10", "t63", "t90", "t90 − t10"):
        columns += [f"{name} (ms)", "2.5 %", "97.5 %"]
    return Table(
        "response-times",
        "Times to 10, 63.2 and 90 % of a step, and from 10 to 90 %, rising or falling: posterior "
        "medians with 95 % intervals (ms).",
        columns,
        made,
        digits=3,
    )


def _sensor_words(row: dict[str, Any]) -> str:
    """What a row of the sensor is called; where its lag is not known, which it would be."""
    if "sensor_is" not in row:
        return "sensor"
    lag = LAG_WORDS[row["sensor_is"]]
    return f"sensor, if it has the {lag} lag ({100 * row['probability']:.0f} %)"


def _inverse(found: dict[str, Any]) -> list[str]:
    d = found["d_zif8_m2_per_s"]
    upper = "no upper limit" if d["hi95"] is None else f"{powers(d['hi95'], 2)} m²/s"
    inside = (
        d["lo95"] is not None
        and d["lo95"] <= found["d_literature_m2_per_s"]
        and (d["hi95"] is None or found["d_literature_m2_per_s"] <= d["hi95"])
    )
    p = max(found["tail_probability"], found["tail_resolution"])
    literature = found["tau_literature_ms"]
    said = (
        f"For the coating of the paper (ZIF-8 under PDMS on the ring), τ implies a diffusivity of "
        f"ZIF-8 between {powers(d['lo95'], 2)} m²/s and {upper} (95 %). The literature value, "
        f"{powers(found['d_literature_m2_per_s'])} m²/s, would give "
        f"{number(literature['median'], 3)} ms and lies {'inside' if inside else 'outside'}: "
        f"{'it explains these data' if inside else 'it does not explain these data'} (two-sided "
        f"tail probability {p:.2g}){see('diffusivity')}."
    )
    return [
        said,
        "This applies to a sensor with that coating only; thicknesses, the diffusivity of PDMS "
        "and the outer radius are uncertain by the tolerances in the table.",
    ]


def _diffusivity_table(found: dict[str, Any]) -> Table:
    d, ratio, literature = found["d_zif8_m2_per_s"], found["ratio"], found["tau_literature_ms"]
    rows: list[list[Any]] = [
        ["diffusivity of ZIF-8 (m²/s)", d["median"], d["lo95"], d["hi95"]],
        ["the same, literature (m²/s)", found["d_literature_m2_per_s"], None, None],
        ["response time at the literature value (ms)", literature["median"], literature["lo95"],
         literature["hi95"]],
        ["τ over that", ratio["median"], ratio["lo95"], ratio["hi95"]],
        ["two-sided tail probability of the literature value", found["tail_probability"], None,
         None],
    ]  # fmt: skip
    rows += [
        [f"relative tolerance of the {TOLERANCE_WORDS.get(name, name)}", value, None, None]
        for name, value in found["tolerances"].items()
    ]
    return Table(
        "diffusivity",
        "The coating of the paper, from τ; an empty end means no limit.",
        ["quantity", "value", "95 % low", "95 % high"],
        rows,
        digits=3,
    )
