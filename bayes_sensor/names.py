"""Names that people give: what may not stand in one, and which of them look the same.

A name is shown everywhere beside other text: in a terminal, on the pages, in tables and figures.
"""

from __future__ import annotations

import re
import unicodedata

_TURNING = frozenset(("LRE", "RLE", "LRO", "RLO", "PDF", "LRI", "RLI", "FSI", "PDI"))
"""bidirectional classes of characters that turn the direction of the text around them"""
_UNSEEN = re.compile("[\u034f\u115f\u1160\u17b4\u17b5\u180b-\u180f\u2800\u3164\ufe00-\ufe0f\uffa0]")
"""letters and marks of no ink; format characters have a category of their own"""


def acts_on_its_surroundings(text: str) -> bool:
    """Whether a character ends a line, turns the text around it, or controls a terminal.

    >>> acts_on_its_surroundings("\u05d0\u05d1 12"), acts_on_its_surroundings("a\u202eb")
    (False, True)
    """
    return any(
        unicodedata.category(c) in ("Cc", "Cs", "Zl", "Zp")
        or unicodedata.bidirectional(c) in _TURNING
        for c in text
    )


def appearance(text: str) -> str:
    """The name as a reader sees it; two names that look the same have the same.

    Composed (NFC), without characters of no width, and with one plain blank for several.

    >>> appearance("cafe\u0301 \u00a0 1\u200b") == appearance("caf\u00e9 1"), appearance("\u200b")
    (True, '')
    """
    composed = unicodedata.normalize("NFC", _UNSEEN.sub("", text))
    return " ".join("".join(c for c in composed if unicodedata.category(c) != "Cf").split())
