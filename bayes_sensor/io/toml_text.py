"""The tables of a TOML text, whatever it holds: one message for each way it can be wrong."""

from __future__ import annotations

import re
import tomllib
from typing import Any

from bayes_sensor.campaign import CampaignError

LARGEST = 1 << 20
"""bytes of a campaign file or of settings"""
LONGEST_LINE = 100_000
"""characters; longer lines and deeply dotted keys would slow the parser down"""


def read_toml(
    content: bytes, label: str, what: str = "a campaign file", most: int = LARGEST
) -> dict[str, Any]:
    """The tables of a TOML file.

    ``label``: its name in messages; ``what`` it should be; ``most``: bytes.

    >>> read_toml(b'title = "x"', "campaign.toml")
    {'title': 'x'}

    Raises
    ------
    CampaignError
        If it is not UTF-8, too large or not TOML; the message has the line.
    """
    if len(content) > most:
        raise CampaignError(
            f"{label}: expected {what} of at most {most >> 20} MB, but it has {len(content)} "
            "bytes; point to the TOML file, not to data"
        )
    if content.startswith((b"\xff\xfe", b"\xfe\xff")):
        raise CampaignError(f"{label}: expected UTF-8 text, but it is UTF-16; save it as UTF-8")
    try:
        text = content.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        line = content.count(b"\n", 0, error.start) + 1
        raise CampaignError(
            f"{label}: line {line} is not UTF-8 text (byte {content[error.start]:#04x}); "
            f"expected {what} in TOML: save it as UTF-8"
        ) from None
    for number, line_text in enumerate(text.splitlines(), 1):
        dotted = re.sub(r"[\w\"'-]+", "k", line_text).replace(" ", "").replace("\t", "")
        if len(line_text) > LONGEST_LINE or "k." * 16 in dotted:
            raise CampaignError(
                f"{label}: line {number} is too long or too deeply dotted ({len(line_text)} "
                f"characters); expected {what} with one key a line: break it up"
            )
        if re.search(r"(?<![\w\"'])0x[0-9a-fA-F_]{300,}", line_text):
            raise CampaignError(
                f"{label}: line {number} holds a number of more than 300 digits, which is out of "
                "range; expected a quantity as text with a unit: write the value that was set"
            )
    try:
        return tomllib.loads(text)
    except ValueError as error:  # TOMLDecodeError, and numbers with thousands of digits
        raise CampaignError(f"{label}: expected TOML, but {_problem(str(error), text)}") from None
    except RecursionError:
        raise CampaignError(
            f"{label}: expected {what}, but its brackets are nested too deeply; remove the nesting"
        ) from None


_WELL_FORMED = re.compile(r"\"[^\"]*\"|'[^']*'|#.*|[\w.-]+\s*=")
"""texts in quotes, a remark and keys, in what follows a key's sign of equality"""


def _problem(message: str, text: str) -> str:
    said = " ".join(message.split())[:200]
    said = said[:1].lower() + said[1:]
    if "unescaped" in said or "hex value" in said:
        # as in "C:\data\exp1.csv": the escapes of TOML's double quotes
        return f"{said}: a backslash in double quotes begins an escape; write / between folders"
    place = re.search(r"at line (\d+)", said)
    line = text.splitlines()[int(place[1]) - 1 : int(place[1])] if place is not None else []
    value = "".join(line).partition("=")[2]
    if re.search(r"[^\W\d_]|[%\u2018\u2019\u201c\u201d]", _WELL_FORMED.sub("", value)):
        return (
            f"{said}; texts, and values with a unit, stand in straight quotes, as in "
            'carrier_flow = "4.0 L/min": correct that line'
        )
    return f"{said}; correct that line"
