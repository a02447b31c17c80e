"""The report as one self-contained HTML page.

The page needs no network; without scripts it loses sorting and copying of tables and the zoom of
the overlays, which are then drawings.
"""

from __future__ import annotations

import base64
import html
import json
from collections.abc import Sequence
from importlib import resources
from typing import Any

from markupsafe import Markup, escape

from bayes_sensor.fit.samples import coded, thinned
from bayes_sensor.report.drawing import inline_svg
from bayes_sensor.report.headline import alerts, headline, remarks
from bayes_sensor.report.parts import Picture, Section, Table, numbering, pieces
from bayes_sensor.report.saved import Saved
from bayes_sensor.report.words import typeset

MOST_VECTORS = 4 << 20
"""bytes of vector overlays in a page; beyond, they are embedded as pixels"""
MOST_PIXELS = 2 << 20
"""bytes of overlays as pixels; beyond, they are only saved beside the page"""
MOST_SAMPLES = 6 << 20
"""bytes of samples for the zoom; beyond, samples far from the switches are thinned"""


def _drawings(sections: Sequence[Section]) -> dict[str, Markup]:
    """The element of the page for each picture."""
    found, pixels = {}, 0
    for section in sections:
        for part in section.content:
            if not isinstance(part, Picture):
                continue
            if part.pixels is None:
                body = inline_svg(part.drawing, part.key, part.caption)
            else:
                data = base64.b64encode(part.pixels).decode("ascii")
                pixels += len(data)
                safe = html.escape(part.caption, quote=True)
                body = f'<img alt="{safe}" src="data:image/png;base64,{data}">'
                if pixels > MOST_PIXELS:
                    body = f"<p>Drawn in figures/{part.key}.svg, to keep this page small.</p>"
            found[part.key] = Markup(body)
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


def page(saved: Saved, sections: Sequence[Section]) -> str:
    """The page as text."""
    from jinja2 import Environment, StrictUndefined

    numbers = numbering(sections)
    kinds = {
        part.key: "t" if isinstance(part, Table) else "f" for s in sections for part in s.content
    }

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
    environment.filters["typeset"] = typeset
    template = environment.from_string(asset("report.html.j2"))
    return template.render(
        saved=saved,
        title=saved.name,
        version=saved.last["versions"].get("bayes-sensor", ""),
        finished=saved.last["finished"],
        head=headline(saved.posterior, saved.bounds, saved.settings),
        remarks=remarks(saved),
        alerts=alerts(saved),
        sections=sections,
        numbers=numbers,
        drawings=_drawings(sections),
        linked=linked,
        zoom=[_script_json(each) for each in zoom_data(saved)],
        css=asset("report.css"),
        script=asset("report.js"),
        zoom_script=asset("zoom.js"),
        is_table=lambda item: isinstance(item, Table),
    )
