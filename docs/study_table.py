"""The directive ``study-table``: rows of a table in ``paper/tables``, read when pages are built.

::

    ```{study-table} coverage_bounds
    :columns: method, coverage, coverage_lo95=from, coverage_hi95=to
    :where: setting=iid, parameter=tau_s, level=95
    :digits: 3
    :caption: How often the interval of tau holds the truth.
    ```

``columns`` chooses, orders and (after ``=``) renames columns; ``where`` keeps the rows whose cells
are as given; ``pivot: setting=coverage`` spreads the values of ``coverage`` over one column per
``setting``; ``first`` keeps the first rows.  A table that no study has written yet is replaced by
a sentence that says so; an unknown column, or a condition that no row meets, is an error.
"""

from __future__ import annotations

import csv
from math import floor, isfinite, log10
from pathlib import Path
from typing import Any, ClassVar

from docutils import nodes
from docutils.parsers.rst import directives
from sphinx.application import Sphinx
from sphinx.util.docutils import SphinxDirective

ROUNDING = 1e-15
"""what is smaller is a zero that was computed"""
SHORT = 12
"""characters of a cell that is kept on one line"""
TABLES = Path(__file__).resolve().parent.parent / "paper" / "tables"


def shown(cell: str, digits: int) -> str:
    """A cell as the page shows it: numbers with ``digits`` significant digits, empty as a dash."""
    try:
        value = float(cell)
    except ValueError:
        words = {"": "–", "True": "yes", "False": "no"}.get(cell, cell)
        words = words.replace("<=", "≤").replace(">=", "≥")
        return words.replace("+", "+\u200b")  # joined names may break there
    if not isfinite(value):
        return "–"
    # integers, seeds and counts stand as they are written
    if cell.lstrip("+-").isdigit() or value == 0:
        return str(int(value))
    if abs(value) < ROUNDING:
        return "0"
    exponent = floor(log10(abs(value)))
    if not -5 < exponent < 7:
        return f"{value:.{digits - 1}e}"
    return f"{value:.{max(0, digits - 1 - exponent)}f}"


def pairs(text: str) -> list[tuple[str, str]]:
    """``a=b, c`` as [("a", "b"), ("c", "c")]."""
    cut = (part.strip().partition("=") for part in text.split(","))
    return [(name.strip(), value.strip() or name.strip()) for name, _, value in cut if name]


def read(name: str) -> list[dict[str, str]]:
    """The rows of a table; FileNotFoundError where no study has written it."""
    with (TABLES / f"{name}.csv").open(newline="", encoding="utf-8") as stream:
        return list(csv.DictReader(stream))


def choose(rows: list[dict[str, str]], columns: str, where: str, pivot: str, first: int | None,
           digits: int) -> tuple[list[str], list[list[str]]]:  # fmt: skip
    """Header and body as text; ValueError says what does not fit the table."""
    known = list(rows[0]) if rows else []
    wanted, kept = pairs(columns), pairs(where)
    spread = pairs(pivot)[0] if pivot else None
    for column in [*(c for c, _ in [*wanted, *kept]), *(spread or ())]:
        if column not in known:
            raise ValueError(f"there is no column '{column}' in {', '.join(known)}")
    rows = [row for row in rows if all(row[column] == value for column, value in kept)]
    if not rows:
        raise ValueError(f"there is no row with {where}")
    wanted = wanted or [(column, column.replace("_", " ")) for column in known]
    header = [title for _, title in wanted]
    if spread is None:
        body = [[shown(row[column], digits) for column, _ in wanted] for row in rows]
        return header, body[:first]
    by, value = spread
    titles = list(dict.fromkeys(row[by] for row in rows))
    lines: dict[tuple[str, ...], dict[str, str]] = {}
    for row in rows:
        key = tuple(shown(row[column], digits) for column, _ in wanted)
        lines.setdefault(key, {})[row[by]] = shown(row[value], digits)
    body = [[*key, *(cells.get(title, "–") for title in titles)] for key, cells in lines.items()]
    return header + [title.replace("_", " ") for title in titles], body[:first]


class StudyTable(SphinxDirective):
    """See the module."""

    required_arguments = 1
    option_spec: ClassVar[dict[str, Any]] = {
        "columns": directives.unchanged,
        "where": directives.unchanged,
        "pivot": directives.unchanged,
        "first": directives.positive_int,
        "digits": directives.positive_int,
        "caption": directives.unchanged,
    }

    def run(self) -> list[nodes.Node]:
        """The table, or the sentence that stands for it."""
        name = self.arguments[0]
        path = TABLES / f"{name}.csv"
        self.env.note_dependency(str(path))
        if not path.exists():
            text = f"The table paper/tables/{name}.csv is not there yet; make study writes it."
            return [nodes.note("", nodes.paragraph(text=text))]
        try:
            header, rows = choose(
                read(name), *(self.options.get(key, "") for key in ("columns", "where", "pivot")),
                self.options.get("first"), self.options.get("digits", 3),
            )  # fmt: skip
        except ValueError as error:
            raise self.error(f"{name}.csv: {error}") from None
        table = nodes.table(classes=["study"])
        if "caption" in self.options:
            words, _ = self.state.inline_text(self.options["caption"], self.lineno)
            table += nodes.title("", "", *words)
        group = nodes.tgroup(cols=len(header))
        table += group
        group += [nodes.colspec(colwidth=1) for _ in header]
        group += nodes.thead("", _row(header))
        group += nodes.tbody("", *[_row(cells) for cells in rows])
        source = nodes.paragraph(classes=["source"])
        source += [nodes.Text("From "), nodes.literal(text=f"paper/tables/{name}.csv")]
        return [table, source]


def _row(cells: list[str]) -> nodes.row:
    return nodes.row("", *[
        nodes.entry("", nodes.paragraph(text=cell), classes=["short"] if len(cell) <= SHORT else [])
        for cell in cells
    ])  # fmt: skip


def setup(app: Sphinx) -> dict[str, Any]:
    """Register the directive."""
    app.add_directive("study-table", StudyTable)
    return {"version": "1", "parallel_read_safe": True, "parallel_write_safe": True}
