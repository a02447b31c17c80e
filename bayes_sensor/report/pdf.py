"""The report as PDF, set by typst.

Texts are passed to the typesetter as data, so nothing in a name can be a command.
"""

from __future__ import annotations

import json
import tempfile
from importlib import resources
from pathlib import Path
from typing import Any

from bayes_sensor.report.assemble import Report
from bayes_sensor.report.parts import Part, Table, pieces

MOST_ROWS = 200
"""rows of a table on paper"""


def content(report: Report) -> dict[str, Any]:
    """Everything that the PDF says, as plain data."""
    numbers, first = report.numbers, report.first

    def spans(text: str) -> list[dict[str, str]]:
        return [{"text": piece, "key": key} for piece, key in pieces(text, numbers)]

    def parts(content: list[Part]) -> list[dict[str, Any]]:
        return [_part(part, numbers[part.key]) for part in content]

    return {
        "title": report.title,
        "version": report.version,
        "finished": report.finished,
        "full": report.full,
        "tau": first.tau,
        "why": spans(first.why),
        "facts": [{"label": fact.label, "text": spans(fact.text)} for fact in first.facts],
        "content": parts(first.content),
        "alerts": first.alerts,
        "notes": first.notes,
        "sections": [
            {
                "title": section.title,
                "answer": spans(section.answer),
                "paragraphs": [spans(text) for text in section.paragraphs if report.full],
                "content": parts(section.content if report.full else []),
            }
            for _, section in report.listed
        ],
    }


def _part(part: Part, label: str) -> dict[str, Any]:
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


def document(report: Report) -> bytes:
    """The PDF."""
    import matplotlib
    import typst

    with tempfile.TemporaryDirectory() as folder:
        root = Path(folder)
        for picture in report.pictures():
            (root / f"{picture.key}.svg").write_text(picture.drawing, encoding="utf-8")
        (root / "report.json").write_text(
            json.dumps(content(report), ensure_ascii=False, allow_nan=False), encoding="utf-8"
        )
        template = resources.files("bayes_sensor") / "templates" / "report.typ"
        (root / "report.typ").write_text(template.read_text(encoding="utf-8"), encoding="utf-8")
        # the figures' own fonts, whatever this machine has
        fonts = Path(matplotlib.get_data_path()) / "fonts" / "ttf"
        made = typst.compile(root / "report.typ", root=root, font_paths=[fonts])
    assert isinstance(made, bytes)
    return made
