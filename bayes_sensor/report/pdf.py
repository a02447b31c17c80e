"""The report as PDF, set by typst.

Texts are passed to the typesetter as data, so nothing in a name can be a command.
"""

from __future__ import annotations

import json
import tempfile
from collections.abc import Sequence
from importlib import resources
from pathlib import Path
from typing import Any

from bayes_sensor.report.headline import alerts, headline, remarks
from bayes_sensor.report.parts import Section, Table, numbering, pieces
from bayes_sensor.report.saved import Saved
from bayes_sensor.report.words import typeset

MOST_ROWS = 200
"""rows of a table on paper"""


def content(saved: Saved, sections: Sequence[Section]) -> dict[str, Any]:
    """Everything that the PDF says, as plain data."""
    numbers = numbering(sections)

    def spans(text: str) -> list[dict[str, str]]:
        return [{"text": piece, "key": key} for piece, key in pieces(text, numbers)]

    head = headline(saved.posterior, saved.bounds, saved.settings)
    return {
        "title": saved.name,
        "version": saved.last["versions"].get("bayes-sensor", ""),
        "finished": saved.last["finished"],
        "tau": "" if head is None else typeset(head.text),
        "remarks": [remark.text for remark in remarks(saved)],
        "alerts": [{"kind": kind, "text": text} for kind, text in alerts(saved)],
        "sections": [
            {
                "key": section.key,
                "title": section.title,
                "answer": spans(section.answer),
                "paragraphs": [spans(text) for text in section.paragraphs],
                "content": [_part(part, numbers[part.key]) for part in section.content],
            }
            for section in sections
        ],
    }


def _part(part: Any, label: str) -> dict[str, Any]:
    record = {"key": part.key, "label": label, "caption": part.caption}
    if not isinstance(part, Table):
        return {**record, "kind": "figure"}
    rows = [[cell["text"] for cell in part.cells(row)] for row in part.rows[:MOST_ROWS]]
    left_out = len(part.rows) - len(rows)
    if left_out > 0:
        record["caption"] += f" {left_out} more rows are in the saved results."
    return {
        **record,
        "kind": "table",
        "columns": part.columns,
        "numeric": part.numeric,
        "rows": rows,
        "marked": part.marked,
    }


def document(saved: Saved, sections: Sequence[Section]) -> bytes:
    """The PDF."""
    import matplotlib
    import typst

    with tempfile.TemporaryDirectory() as folder:
        root = Path(folder)
        for section in sections:
            for part in section.content:
                if not isinstance(part, Table):
                    (root / f"{part.key}.svg").write_text(part.drawing, encoding="utf-8")
        (root / "report.json").write_text(
            json.dumps(content(saved, sections), ensure_ascii=False, allow_nan=False),
            encoding="utf-8",
        )
        template = resources.files("bayes_sensor") / "templates" / "report.typ"
        (root / "report.typ").write_text(template.read_text(encoding="utf-8"), encoding="utf-8")
        # the figures' own fonts, whatever this machine has
        fonts = Path(matplotlib.get_data_path()) / "fonts" / "ttf"
        made = typst.compile(root / "report.typ", root=root, font_paths=[fonts])
    assert isinstance(made, bytes)
    return made
