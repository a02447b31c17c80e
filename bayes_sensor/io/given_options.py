"""Options that are given as a mapping or as the record that holds them."""

from __future__ import annotations

import difflib
from collections.abc import Mapping
from dataclasses import fields
from typing import Any, TypeVar

from bayes_sensor.campaign import CampaignError

R = TypeVar("R")


def record_of(kind: type[R], given: R | Mapping[str, Any] | None, where: str) -> R:
    """The record of options: as it is, from a mapping by field, or with its defaults for None.

    ``kind``: a dataclass whose fields all have defaults; ``where``: words that begin a message.

    Raises
    ------
    CampaignError
        For an unknown option, with the nearest known one, and for a value of another type than the
        default's; a whole number also serves where the default has decimals.
    """
    if given is None:
        return kind()
    if isinstance(given, kind):
        return given
    if not isinstance(given, Mapping):
        raise CampaignError(
            f"{where}: expected a {kind.__name__} or a mapping of its options, but got a "
            f"{type(given).__name__}; give one of them"
        )
    defaults = {f.name: f.default for f in fields(kind)}  # type: ignore[arg-type]
    for name, value in given.items():
        if name not in defaults:
            close = difflib.get_close_matches(str(name), defaults, n=1)
            hint = f"did you mean '{close[0]}'?" if close else f"known are {', '.join(defaults)}"
            raise CampaignError(f"{where}: no option '{str(name)[:80]}' of {kind.__name__}; {hint}")
        wanted = type(defaults[name])
        if type(value) is not wanted and not (wanted is float and type(value) is int):
            raise CampaignError(
                f"{where}: {name}: expected {_WORDS[wanted]}, but got {str(value)[:40]!r}; "
                "correct it"
            )
    return kind(**given)


_WORDS: dict[type, str] = {
    bool: "True or False", int: "a whole number", float: "a number", str: "a text",
}  # fmt: skip
