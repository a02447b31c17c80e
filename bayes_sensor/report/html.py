"""The report as one self-contained HTML page.

The page needs no network; without scripts it loses sorting and copying of tables and the zoom of
the overlays.  The sections are folded behind the first page.
"""

from __future__ import annotations

import json
from importlib import resources
from typing import Any

from markupsafe import Markup, escape

from bayes_sensor.fit.samples import coded, thinned
from bayes_sensor.report.assemble import Report
from bayes_sensor.report.drawing import inline_svg
from bayes_sensor.report.parts import Table, pieces
from bayes_sensor.report.saved import Saved

MOST_VECTORS = 6 << 20
"""bytes of overlays in a page; beyond, they are only saved beside it"""
MOST_SAMPLES = 6 << 20
"""bytes of samples for the zoom; beyond, samples far from the switches are thinned"""
WHEN_OPENED = "Every sample, drawn when opened."
FOR_PAPER = "Drawn by bayes-sensor report DIR --pages full."


def _drawings(report: Report) -> dict[str, Markup]:
    """The element of the page for each picture, or words where it is not drawn."""
    found: dict[str, Markup] = {}
    size = 0
    for picture in report.pictures():
        if picture.drawing:
            body = inline_svg(picture.drawing, picture.key, picture.caption)
            size += len(body) if picture.overlay is not None else 0
            if picture.overlay is not None and size > MOST_VECTORS:
                body = f"<p>Drawn in figures/{picture.key}.svg, to keep this page small.</p>"
        elif picture.overlay is not None and report.zoomable:
            body = f"<p>{WHEN_OPENED}</p>"
        else:
            body = f"<p>{FOR_PAPER}</p>"
        found[picture.key] = Markup(body)
    return found


def zoom_data(saved: Saved) -> list[dict[str, Any]]:
    """The data for the zoom of each overlay, within the page's budget."""
    samples, traces = saved.samples or [], saved.traces or []
    if len(samples) != len(traces):
        return []
    n_values = sum(len(each.values) for each in samples)
    # one value takes about a byte: an eighth of 6.4 bits of code, by a third more in base64
    most = int(0.9 * MOST_SAMPLES / max(len(samples), 1))
    made = []
    for each, trace in zip(samples, traces, strict=True):
        edges = [edge for edge in (trace.t0, trace.tf) if edge is not None]
        span = float(trace.rise.t[-1] - trace.rise.t[0])
        whole = each if n_values < 0.9 * MOST_SAMPLES else thinned(each, edges, span, most)
        fall = trace.fall
        made.append(
            {
                **coded(whole),
                "thinned": whole is not each,
                "unit": saved.unit,
                "edges": edges,
                "commanded": [
                    c for c in (trace.commanded_on, trace.commanded_off) if c is not None
                ],
                "views": {
                    "start": [float(trace.rise.t[0]), float(trace.rise.t[-1])],
                    **({"end": [float(fall.t[0]), float(fall.t[-1])]} if fall is not None else {}),
                },
            }
        )
    return made


def _script_json(content: Any) -> Markup:
    """JSON whose content cannot end its script element."""
    text = json.dumps(content, allow_nan=False, separators=(",", ":"))
    return Markup(text.replace("<", "\\u003c").replace("&", "\\u0026"))


def page(report: Report) -> str:
    """The page as text."""
    from jinja2 import Environment, StrictUndefined

    numbers = report.numbers
    kinds = {key: "t" if label.startswith("Table") else "f" for key, label in numbers.items()}

    def linked(text: str) -> Markup:
        return Markup("").join(
            Markup('<a class="see" href="#{}-{}">{}</a>').format(kinds[key], key, piece)
            if key
            else escape(piece)
            for piece, key in pieces(text, numbers)
        )

    places = resources.files("bayes_sensor") / "templates"

    def asset(name: str) -> Markup:
        return Markup((places / name).read_text(encoding="utf-8"))

    environment = Environment(autoescape=True, undefined=StrictUndefined, trim_blocks=True)
    template = environment.from_string(asset("report.html.j2"))
    return template.render(
        report=report,
        first=report.first,
        numbers=numbers,
        drawings=_drawings(report),
        linked=linked,
        zoom=[_script_json(each) for each in zoom_data(report.saved)],
        css=asset("report.css"),
        script=asset("report.js"),
        zoom_script=asset("zoom.js"),
        is_table=lambda item: isinstance(item, Table),
    )
