"""The whole report before any format: the first page, and the sections behind it."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

from bayes_sensor.report.first_page import FirstPage, first_page
from bayes_sensor.report.parts import Part, Picture, Section, Table, numbering
from bayes_sensor.report.saved import Saved

PAGES = ("short", "full")


@dataclass
class Report:
    """What every format is made from."""

    saved: Saved
    first: FirstPage
    sections: list[Section]
    full: bool
    """whether the sections are shown unfolded, with every figure"""
    folded: bool
    """whether what is folded can be unfolded, as in HTML"""

    @property
    def title(self) -> str:
        """The campaign's title."""
        return self.saved.name

    @property
    def version(self) -> str:
        """The version that made the results."""
        return str(self.saved.last["versions"].get("bayes-sensor", ""))

    @property
    def finished(self) -> str:
        """When they were finished."""
        return str(self.saved.last["finished"])

    @property
    def with_details(self) -> bool:
        """Whether tables and figures of the sections are in the report."""
        return self.full or self.folded

    @property
    def listed(self) -> list[tuple[int, Section]]:
        """The sections that are told, with the numbers that they have in every format; without
        details those that the first page does not answer."""
        told = {"tau", *(fact.section for fact in self.first.facts)} if self.first.tau else set()
        numbered = enumerate(self.sections, 1)
        return [(i, s) for i, s in numbered if self.with_details or s.key not in told]

    @property
    def numbers(self) -> dict[str, str]:
        """``Table 3`` or ``Figure 2`` by key, of what is in the report."""
        return numbering(self.parts)

    @property
    def zoomable(self) -> bool:
        """Whether the page draws its overlays from the samples when they are opened."""
        samples, traces = self.saved.samples or [], self.saved.traces or []
        return self.folded and len(samples) == len(traces) > 0

    @property
    def parts(self) -> list[Part]:
        """Every table and picture in the report."""
        sections = self.sections if self.with_details else []
        return [*self.first.content, *(part for s in sections for part in s.content)]

    def pictures(self) -> Iterator[Picture]:
        """Every picture in the report."""
        return (part for part in self.parts if isinstance(part, Picture))

    def to_draw(self) -> list[Picture]:
        """The pictures that are drawn now.

        In the short report those of the draws are left to paper, and overlays behind the first page
        to the page itself.
        """
        return [
            picture
            for picture in self.pictures()
            if self.full
            or picture in self.first.content
            or not (picture.on_paper or (picture.overlay is not None and self.zoomable))
        ]


def assemble(
    saved: Saved, pages: str = "short", folded: bool = True, figures: bool = True
) -> Report:
    """The report of saved results, nothing of it drawn yet.

    ``pages``: one of :data:`PAGES`; ``folded``: whether the format can fold sections; ``figures``:
    without them only the chain is drawn, which costs nothing.
    """
    from bayes_sensor.report.sections import make_sections

    sections = make_sections(saved)
    first = first_page(saved, sections)
    if not figures:
        content = [first.content, *(section.content for section in sections)]
        for parts in content:
            parts[:] = [part for part in parts if isinstance(part, Table) or part.drawing]
    # nothing is folded behind an empty page, as that of a blind check
    full = pages == "full" or not (first.tau or first.facts)
    return Report(saved, first, sections, full, folded)
