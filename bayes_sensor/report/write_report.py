"""A results folder in, the report out: one HTML page, a PDF or Markdown, with its figures."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from bayes_sensor.io.disk import own_folder, write_bytes, write_text
from bayes_sensor.report.assemble import assemble
from bayes_sensor.report.parts import draw
from bayes_sensor.report.saved import read_results

FORMATS = {"html": "report.html", "pdf": "report.pdf", "md": "report.md"}
"""file by format"""
FIGURES = "figures"

Progress = Callable[[float, str], None]


@dataclass(frozen=True)
class Choice:
    """What a report shall hold, and how it is made."""

    form: str = "html"
    """a key of :data:`FORMATS`"""
    pages: str = "short"
    """``short``: the answer on two pages, in HTML with the rest folded behind it; ``full``: all of
    it unfolded, with the figures that only paper shows"""
    figures: bool = True
    png: bool = False
    """whether figures are saved as PNG, too"""
    compare_published: bool = False
    """whether to show what concerns the published sensor, whatever the campaign says"""
    jobs: int = 1
    """processes that draw"""


def write_report(
    source: str | Path,
    target: str | Path,
    choice: Choice | None = None,
    progress: Progress | None = None,
) -> Path:
    """Write the report of ``source`` into the folder ``target``, with its figures; the file.

    Raises CampaignError if ``source`` is not a results directory.
    """
    from bayes_sensor.report import html, markdown, pdf

    choice = choice or Choice()
    place = Path(target) / FORMATS[choice.form]
    figure_folder = own_folder(Path(target) / FIGURES)
    figure_folder.mkdir(exist_ok=True)
    saved = read_results(source, choice.compare_published)
    report = assemble(saved, choice.pages, choice.form == "html", choice.figures)
    draw(
        report.to_draw(),
        figure_folder,
        png=choice.png,
        jobs=choice.jobs,
        progress=progress or (lambda fraction, text: None),
    )
    if choice.form == "html":
        write_text(place, html.page(report))
    elif choice.form == "md":
        write_text(place, markdown.document(report, FIGURES))
    else:
        write_bytes(place, pdf.document(report))
    return place
