"""A figure as an element of a page: no scripts or links, own ids, the page's colours.

A drawing contains names that users gave.  It is parsed, and only its elements and attributes are
checked.  A name is text there and stays as it is.
"""

from __future__ import annotations

import re
from collections.abc import Iterator
from xml.etree import ElementTree

from bayes_sensor.figures.colours import COLOURS

SVG, XLINK = "http://www.w3.org/2000/svg", "http://www.w3.org/1999/xlink"
SHAPES = {
    "svg", "g", "defs", "style", "path", "use", "text", "tspan", "title", "desc", "clipPath",
    "mask", "pattern", "marker", "symbol", "rect", "circle", "ellipse", "line", "polyline",
    "polygon", "linearGradient", "radialGradient", "stop",
}  # fmt: skip
"""elements that only draw"""
_COLOUR = re.compile(rf"(^|(?:fill|stroke|color): )({'|'.join(COLOURS)})")


def inline_svg(drawing: str, key: str, label: str) -> str:
    """An SVG element for the page: own ids, colours that follow the page, a label for readers.

    Raises ValueError if the drawing holds a script or a link, which figures never do.
    """
    try:
        root = _compacted(_parsed(drawing))
    except ElementTree.ParseError as error:
        raise ValueError(f"figure {key}: expected an SVG element, got bad XML: {error}") from None
    for element in root.iter():
        if element.tag not in SHAPES or any(_acts(*each) for each in _values(element)):
            raise ValueError(
                f"figure {key}: a drawing must not hold scripts, links or images, but it has "
                f"<{element.tag} {' '.join(element.attrib)}>"
            )
        for name, value in element.attrib.items():
            if name == "id":
                value = f"{key}-{value}"
            elif name.endswith("href"):
                value = f"#{key}-{value[1:]}"
            elif name in ("style", "fill", "stroke", "color"):
                value = _COLOUR.sub(_of_the_page, value)
            element.set(name, value.replace("url(#", f"url(#{key}-"))
    # the page shows no drawing much smaller or larger than it was made
    width = root.attrib.pop("width", None)
    root.attrib.pop("height", None)
    root.attrib = {
        "role": "img",
        "aria-label": label,
        **({} if width is None else {"style": f"--made: {width}"}),
        "xmlns": SVG,
        "xmlns:xlink": XLINK,
        **root.attrib,
    }
    return _text(root)


def _parsed(drawing: str) -> ElementTree.Element:
    """The root; names without namespaces, but for ``xlink:href``."""
    root = ElementTree.fromstring(drawing)
    for element in root.iter():
        element.tag = element.tag.removeprefix(f"{{{SVG}}}")
        element.attrib = {
            name.replace(f"{{{XLINK}}}", "xlink:"): value for name, value in element.attrib.items()
        }
    return root


def _compacted(root: ElementTree.Element) -> ElementTree.Element:
    """The drawing with coordinates to a tenth of a point and without metadata."""
    for element in list(root.iter()):
        for old in element.findall("metadata"):
            element.remove(old)
        if "d" in element.attrib:
            path = " ".join(element.attrib["d"].split())
            element.set("d", re.sub(r"\d+\.\d\d+", _shorter, path))
    return root


def _shorter(match: re.Match[str]) -> str:
    return f"{float(match[0]):.1f}".removesuffix(".0")


def _of_the_page(match: re.Match[str]) -> str:
    return f"{match[1]}var(--f-{match[2][1:]}, {match[2]})"


def _values(element: ElementTree.Element) -> Iterator[tuple[str, str]]:
    """Names and values of attributes; the text of a style sheet as one more."""
    yield from element.attrib.items()
    if element.tag == "style":
        yield "style", element.text or ""


def _acts(name: str, value: str) -> bool:
    """Whether an attribute runs something or refers to something outside."""
    if name.lower().startswith("on") or (name.endswith("href") and not value.startswith("#")):
        return True
    return re.search(r"url\((?!#)|@import|javascript:", value, re.IGNORECASE) is not None


def _text(root: ElementTree.Element) -> str:
    return ElementTree.tostring(root, encoding="unicode")
