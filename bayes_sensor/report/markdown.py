"""The report as Markdown, with the figures beside it."""

from __future__ import annotations

import re
from collections.abc import Sequence

from bayes_sensor.report.headline import alerts, headline, remarks
from bayes_sensor.report.parts import Section, Table, numbering, pieces
from bayes_sensor.report.saved import Saved
from bayes_sensor.report.words import typeset


def escaped(text: str) -> str:
    """Text that no Markdown reader interprets as markup.

    >>> escaped("<b> *a* | b\\n# c")
    '&lt;b&gt; \\\\*a\\\\* \\\\| b \\\\# c'
    """
    text = " ".join(text.split())
    text = text.replace("&", "&amp;").replace("<", "&lt;").replace(">", "&gt;")
    text = re.sub(r"([\\`*_{}\[\]#|~$!])", r"\\\1", text)
    return re.sub(r"^([-+]|\d+[.)])(?=\s)", r"\\\1", text)


def document(saved: Saved, sections: Sequence[Section], figure_folder: str = "figures") -> str:
    """The report as text; pictures point to PNG files in ``figure_folder``."""
    numbers = numbering(sections)

    def linked(text: str) -> str:
        return "".join(
            f"[{piece}](#{key})" if key else escaped_piece(piece)
            for piece, key in pieces(text, numbers)
        )

    def escaped_piece(piece: str) -> str:
        # a stretch keeps the blanks at its ends
        inner = escaped(piece)
        lead = " " if piece[:1].isspace() else ""
        trail = " " if piece[-1:].isspace() and inner else ""
        return lead + inner + trail

    lines = [f"# {escaped(saved.name)}", ""]
    last = saved.last
    version = last["versions"].get("bayes-sensor", "")
    lines += [f"bayes-sensor {escaped(version)}, {escaped(last['finished'])}", ""]
    told = alerts(saved)
    # what decides whether the headline stands comes before it
    lines += [f"> **Attention.** {escaped(text)}\n" for kind, text in told if kind == "bad"]
    head = headline(saved.posterior, saved.bounds, saved.settings)
    if head is not None:
        lines += [f"**{escaped(typeset(head.text))}**", ""]
    for remark in remarks(saved):
        lines += [escaped(remark.text), ""]
    lines += [f"> {escaped(text)}\n" for kind, text in told if kind != "bad"]
    for i, section in enumerate(sections, 1):
        lines += [f"## {i}. {escaped(section.title)}", "", f"**{linked(section.answer)}**", ""]
        for text in section.paragraphs:
            lines += [linked(text), ""]
        for part in section.content:
            label = f'<a id="{part.key}"></a>**{numbers[part.key]}.** {escaped(part.caption)}'
            if isinstance(part, Table):
                lines += [label, "", *_table(part), ""]
            else:
                lines += [f"![{numbers[part.key]}]({figure_folder}/{part.key}.png)", "", label, ""]
    return "\n".join(lines)


def _table(table: Table) -> list[str]:
    rule = ["---:" if numeric else "---" for numeric in table.numeric]
    lines = [[escaped(name) for name in table.columns], rule]
    lines += [[escaped(cell["text"]) for cell in table.cells(row)] for row in table.rows]
    return ["| " + " | ".join(line) + " |" for line in lines]
