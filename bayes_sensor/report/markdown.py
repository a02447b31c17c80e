"""The report as Markdown, with the figures beside it."""

from __future__ import annotations

import re

from bayes_sensor.report.assemble import Report
from bayes_sensor.report.parts import Part, Table, pieces
from bayes_sensor.report.words import sentence


def escaped(text: str) -> str:
    """Text that no Markdown reader interprets as markup.

    >>> escaped("<b> *a* | b\\n# c")
    '&lt;b&gt; \\\\*a\\\\* \\\\| b \\\\# c'
    """
    text = " ".join(text.split())
    text = text.replace("&", "&amp;").replace("<", "&lt;").replace(">", "&gt;")
    text = re.sub(r"([\\`*_{}\[\]#|~$!])", r"\\\1", text)
    # some readers make links of bare addresses, and pictures of words between colons
    text = re.sub(r":(?=//|\w+:)|@|(?<=\bwww)\.", r"\\\g<0>", text)
    return re.sub(r"^([-+]|\d+[.)])(?=\s)", r"\\\1", text)


def document(report: Report, figure_folder: str = "figures") -> str:
    """The report as text; pictures point to the SVG files in ``figure_folder``."""
    numbers, first = report.numbers, report.first

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

    def shown(part: Part) -> list[str]:
        label = f'<a id="{part.key}"></a>**{numbers[part.key]}.** {escaped(part.caption)}'
        if isinstance(part, Table):
            return [label, "", *_table(part), ""]
        return [f"![{numbers[part.key]}]({figure_folder}/{part.key}.svg)", "", label, ""]

    lines = [f"# {escaped(report.title)}", ""]
    lines += [f"bayes-sensor {escaped(report.version)}, {escaped(report.finished)}", ""]
    # what decides whether the headline stands comes before it
    lines += [f"> **Attention.** {escaped(text)}\n" for text in first.alerts]
    if first.tau:
        lines += [f"**{escaped(first.tau)}**", "", linked(first.why), ""]
    for fact in first.facts:
        lines += [f"**{escaped(sentence(fact.label))}** {linked(fact.text)}", ""]
    for part in first.content:
        lines += shown(part)
    lines += [f"> {escaped(text)}\n" for text in first.notes]
    for i, section in report.listed:
        lines += [f"## {i}. {escaped(section.title)}", "", f"**{linked(section.answer)}**", ""]
        if report.full:
            for text in section.paragraphs:
                lines += [linked(text), ""]
            for part in section.content:
                lines += shown(part)
    return "\n".join(lines)


def _table(table: Table) -> list[str]:
    rule = ["---:" if numeric else "---" for numeric in table.numeric]
    lines = [[escaped(name) for name in table.columns], rule]
    lines += [[escaped(cell["text"]) for cell in table.cells(row)] for row in table.rows]
    return ["| " + " | ".join(line) + " |" for line in lines]
