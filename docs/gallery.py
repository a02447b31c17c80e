"""The directive ``gallery``: a card for each notebook that the page's table of contents lists.

A card has the first figure of the executed notebook, its title and its first two sentences, and
leads to the notebook.  The cards are made when all notebooks have been read.
"""

from __future__ import annotations

from typing import Any

from docutils import nodes
from sphinx.application import Sphinx
from sphinx.errors import SphinxError
from sphinx.util.docutils import SphinxDirective


class cards(nodes.General, nodes.Element):
    """Stands where the cards will be."""


class Gallery(SphinxDirective):
    """See the module."""

    def run(self) -> list[nodes.Node]:
        """The place of the cards."""
        return [cards()]


def first_sentences(text: str, count: int = 2) -> str:
    """Up to the full stop, with a space behind it, of the last of them."""
    return ". ".join(text.split(". ")[:count]).rstrip(".") + "."


def card(app: Sphinx, page: str, name: str) -> nodes.container:
    """The card of the notebook ``name`` on ``page``; SphinxError for one without a figure."""
    notebook = app.env.get_doctree(name)
    figure = next(iter(notebook.findall(nodes.image)), None)
    if figure is None:
        raise SphinxError(f"{name}: expected a figure for the gallery, and there is none")
    title, words = next(notebook.findall(nodes.title)), next(notebook.findall(nodes.paragraph))
    target = app.builder.get_relative_uri(page, name)
    picture = figure.deepcopy()
    picture.attributes.update(alt="", width="100%")
    head = nodes.paragraph("", "", nodes.reference("", title.astext(), refuri=target))
    return nodes.container(
        "",
        nodes.reference("", "", picture, refuri=target, internal=True),
        head,
        nodes.paragraph(text=first_sentences(words.astext().replace("\n", " "))),
        classes=["card"],
    )


def fill(app: Sphinx, tree: nodes.document, page: str) -> None:
    """Put the cards in their place."""
    for place in list(tree.findall(cards)):
        names = app.env.toctree_includes.get(page, [])
        place.replace_self(
            nodes.container("", *(card(app, page, name) for name in names), classes=["cards"])
        )


def setup(app: Sphinx) -> dict[str, Any]:
    """Register the directive."""
    app.add_node(cards)
    app.add_directive("gallery", Gallery)
    app.connect("doctree-resolved", fill)
    return {"version": "1", "parallel_read_safe": True, "parallel_write_safe": True}
