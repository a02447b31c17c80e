"""Formulas as MathML, converted when the pages are built: nothing is loaded to show them."""

from __future__ import annotations

from html import escape
from typing import Any
from xml.etree import ElementTree

from docutils import nodes
from latex2mathml.converter import convert
from sphinx.application import Sphinx
from sphinx.errors import SphinxError
from sphinx.util.math import get_node_equation_number


def _converted(node: nodes.Element, display: str) -> str:
    """The formula of a node as a <math> element; SphinxError quotes one that is not understood."""
    source = " ".join(node.astext().split())
    try:
        made = convert(source, display=display)
        ElementTree.fromstring(made)  # what it does not know it hands through, as a bare &
    except Exception as error:  # the converter raises many kinds, all of them about the source
        raise SphinxError(f"{node.source}:{node.line}: formula '{source}': {error!r}") from error
    return made.replace("<math ", f'<math aria-label="{escape(source)}" ', 1)


def inline(writer: Any, node: nodes.math) -> None:
    """A formula within a line."""
    writer.body.append(_converted(node, "inline"))
    raise nodes.SkipNode


def block(writer: Any, node: nodes.math_block) -> None:
    """A formula of its own, with its number where it has a label."""
    writer.body.append(writer.starttag(node, "div", CLASS="formula"))
    writer.body.append(_converted(node, "block"))
    if node["number"]:
        number = get_node_equation_number(writer, node)
        writer.body.append(f'<span class="eqno">({number})</span>')
    writer.body.append("</div>\n")
    raise nodes.SkipNode


def setup(app: Sphinx) -> dict[str, Any]:
    """Register the renderer under the name that conf.py asks for."""
    app.add_html_math_renderer("mathml", inline_renderers=(inline, None),
                               block_renderers=(block, None))  # fmt: skip
    return {"version": "1", "parallel_read_safe": True, "parallel_write_safe": True}
