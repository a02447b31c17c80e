"""The text of a table as UTF-8, whatever it was written in."""

from __future__ import annotations

import codecs
import re

from bayes_sensor.io.readers.recording import (
    DataFile,
)

_QUOTED_ROW = re.compile(rb'^"([^"\r\n]*[\t;][^"\r\n]*)"', re.MULTILINE)


def as_utf8(file: DataFile) -> bytes:
    """The content as UTF-8 without byte order mark."""
    raw = file.content
    if raw.startswith(codecs.BOM_UTF8):
        raw = raw[len(codecs.BOM_UTF8) :]
    elif raw.startswith((codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE)):
        raw = _transcode(file, raw, "utf-16")
    elif b"\0" in raw[:4096]:
        even, odd, half = raw[0:4096:2].count(0), raw[1:4096:2].count(0), len(raw[:4096]) // 2
        if odd > half // 2 > 4 * even:
            raw = _transcode(file, raw, "utf-16-le")
        elif even > half // 2 > 4 * odd:
            raw = _transcode(file, raw, "utf-16-be")
        else:
            raise file.error(
                "expected a text table, but the content is binary; "
                "check the suffix or export as CSV"
            )
    nul = raw.find(b"\0")
    if nul >= 0:
        row = len(re.findall(rb"\r\n|\n|\r", raw[:nul])) + 1
        raise file.error(
            f"row {row} holds a zero byte, so the file is damaged there; export it again"
        )
    if b"\xe2\x88\x9e" in raw:
        raw = raw.replace(b"\xe2\x88\x9e", b"inf")
    if not raw.strip():
        raise file.error(
            "expected a table with a header and numbers, but the file is empty; export it again"
        )
    return raw


def _transcode(file: DataFile, raw: bytes, encoding: str) -> bytes:
    try:
        return raw.decode(encoding).lstrip("\ufeff").encode("utf-8")
    except UnicodeError as error:
        raise file.error(
            f"expected {encoding.upper()} text, but it cannot be decoded ({error}); "
            "the file may be truncated: export it again"
        ) from None


def decoded(raw: bytes) -> str:
    try:
        return raw.decode("utf-8")
    except UnicodeDecodeError:
        return raw.decode("latin-1")


def without_quotes_of_rows(text: bytes) -> bytes:
    """The text without a quotation mark before and behind every row, as some exports write it.

    A row that is quoted as a whole holds separators; a comma may be that of a decimal number.
    """
    first = [line for line in text[:8192].splitlines()[:-1] if line.strip()][:5]
    if len(first) < 2 or not all(_QUOTED_ROW.fullmatch(line) for line in first):
        return text
    return _QUOTED_ROW.sub(rb"\1", text)
