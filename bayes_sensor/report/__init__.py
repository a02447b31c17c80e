"""The report: saved results in; one HTML page, a PDF or Markdown out.

Everything is read from a results directory, so the report can be rebuilt without the data.  Every
text from a file or a user is escaped.
"""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

from bayes_sensor.io.disk import own_folder, write_bytes, write_text
from bayes_sensor.report.headline import Headline, alerts, chain_words, headline
from bayes_sensor.report.parts import Picture, Pictures, Section, Table
from bayes_sensor.report.saved import Saved, read_results
from bayes_sensor.report.words import list_words, number, p_words, time_words, with_spread

__all__ = [
    "FORMATS",
    "Headline",
    "Picture",
    "Saved",
    "Section",
    "Table",
    "alerts",
    "build_report",
    "chain_words",
    "headline",
    "list_words",
    "number",
    "p_words",
    "read_results",
    "time_words",
    "with_spread",
    "write_report",
]

FORMATS = {"html": "report.html", "pdf": "report.pdf", "md": "report.md"}
"""file by format"""
FIGURES = "figures"

Progress = Callable[[float, str], None]


def build_report(
    folder: str | Path,
    figure_folder: str | Path | None = None,
    progress: Progress | None = None,
) -> str:
    """The HTML page of a results directory, as text.

    ``figure_folder``: where to put every figure as SVG and PNG as well.

    Raises CampaignError if ``folder`` is not a results directory.
    """
    from bayes_sensor.report import html  # the drawing rooms are slow to import

    saved, sections = _read(folder, figure_folder, progress)
    return html.page(saved, sections)


def write_report(
    source: str | Path, target: str | Path, form: str = "html", progress: Progress | None = None
) -> Path:
    """Write the report of ``source`` into the folder ``target``, with its figures; the file.

    ``form``: ``html``, ``pdf`` or ``md``.
    """
    from bayes_sensor.report import html, markdown, pdf

    place = Path(target) / FORMATS[form]
    figure_folder = own_folder(Path(target) / FIGURES)
    figure_folder.mkdir(exist_ok=True)
    saved, sections = _read(source, figure_folder, progress)
    if form == "html":
        write_text(place, html.page(saved, sections))
    elif form == "md":
        write_text(place, markdown.document(saved, sections, FIGURES))
    else:
        write_bytes(place, pdf.document(saved, sections))
    return place


def _read(
    folder: str | Path, figure_folder: str | Path | None, progress: Progress | None
) -> tuple[Saved, list[Section]]:
    from bayes_sensor.report import html
    from bayes_sensor.report.sections import make_sections

    saved = read_results(folder)
    pictures = Pictures(
        None if figure_folder is None else Path(figure_folder),
        progress or (lambda fraction, text: None),
        total=len(saved.traces or []) + 20,
        most_vectors=html.MOST_VECTORS,
    )
    return saved, make_sections(saved, pictures)
