"""The truth of a case: its keys, what each may hold, and one clear message per mistake.

Drawn truths have every key.  A user's own needs ``listed_as`` alone.  Names are checked before a
truth is sealed, because afterwards it cannot be corrected.
"""

from __future__ import annotations

import difflib
import json
from collections.abc import Callable, Collection, Mapping
from sys import float_info
from typing import Any

from bayes_sensor.blind_check.simulator import PHASES
from bayes_sensor.campaign import CampaignError
from bayes_sensor.diagnosis.effects import CATALOGUE

KINDS = ("null", "listed", "pair", "unlisted", "withheld", "hidden")
OF_DRAWN = ("seed", "diagnosis_seed", "strengths", "cause_families", "recipe")
"""further keys of drawn truths"""
OF_EFFECTS = ("near", "rivals", "closed")
"""keys whose names are those of effects"""

Check = Callable[[Any], bool]


def _number(value: Any, least: float = -float_info.max) -> bool:
    # JSON as Python reads it has NaN and endless integers
    is_number = isinstance(value, int | float) and not isinstance(value, bool)
    return is_number and least <= value <= float_info.max


def _size(value: Any) -> bool:
    return _number(value, 0.0)


def _text(value: Any) -> bool:
    return isinstance(value, str)


def _names(value: Any) -> bool:
    return isinstance(value, list) and all(map(_text, value))


def _map_of(check: Check) -> Check:
    return lambda value: isinstance(value, Mapping) and all(map(check, value.values()))


def _places(value: Any) -> bool:
    return isinstance(value, list) and all(
        isinstance(place, Mapping)
        and _text(place.get("experiment"))
        and place.get("phase") in PHASES
        and _size(place.get("share"))
        for place in value
    )


_TIME = "a positive number of seconds such as 0.048"
_D = "a number from 0 on, in standard deviations of the noise, such as 8.0"
_NAMES = 'a list of names such as ["dead_volume"]'
_PLACES = (
    'a list of places such as [{"experiment": "1", "phase": "fall", "share": 1.0}] with a phase of '
    + ", ".join(PHASES)
)
KEYS: Mapping[str, tuple[Check, str, Any]] = {
    "name": (_text, "the name of the campaign's folder", ...),
    "kind": (lambda value: value in KINDS, f"one of {', '.join(KINDS)}", ...),
    "causes": (_names, 'a list of texts such as ["a pocket"]', []),
    "near": (_names, _NAMES, []),
    "level": (_size, _D, None),
    "d": (_size, _D, None),
    "law": (_text, 'a text such as "ar1"', "unknown"),
    "is_ar1": (lambda value: isinstance(value, bool), "true or false", None),
    "tau_s": (lambda value: _size(value) and value > 0, _TIME, None),
    "tau_refit_s": (lambda value: _size(value) and value > 0, _TIME, None),
    "rivals": (_map_of(_size), 'distances such as {"carry_over": 5.0}', {}),
    "acts": (_places, _PLACES, []),
    "visible": (_places, _PLACES, []),
    "closed": (_map_of(_number), 'shares such as {"dead_volume": 0.97}', {}),
    "size": (_text, 'a text such as "own"', "own"),
    "reserve": (lambda value: isinstance(value, bool), "true or false", False),
}  # fmt: skip
"""key beside ``listed_as``: its check, what it holds in words, and its default (``...``: follows
from the others)"""


def complete_truth(content: Any, name: str) -> dict[str, Any]:
    """A sealed truth with every key filled in.

    ``listed_as``: for each cause the names that are a right answer; ``[]`` for no cause at all and
    ``[[]]`` for one that the catalogue does not list.

    Raises
    ------
    CampaignError
        If a key that is scored holds something else than it must.
    """
    listed = content.get("listed_as") if isinstance(content, Mapping) else None
    if not isinstance(listed, list) or not all(_text(n) or _names(n) for n in listed):
        raise CampaignError(
            f'sealed/{name}.json: expected {{"listed_as": [["effect"], ..]}}, one list of right '
            "names for each cause; [] where nothing is wrong"
        )
    for key, (holds, words, default) in KEYS.items():
        value = content.get(key, default)
        if value is not default and not holds(value):
            unless = ", or null" if default is None else ""
            raise CampaignError(
                f"sealed/{name}.json: {key}: expected {words}{unless}, but got {_short(value)}; "
                "correct it or leave it out"
            )
    listed = [[names] if isinstance(names, str) else list(names) for names in listed]
    kind = "null" if not listed else "pair" if len(listed) > 1 else "listed"
    if listed and not any(listed):
        kind = "unlisted"
    defaults = {key: default for key, (_, _, default) in KEYS.items()}
    return {**defaults, "name": name, "kind": kind, **content, "listed_as": listed}


def check_truth(content: Any, name: str, experiments: Collection[str] | None = None) -> None:
    """Raise CampaignError for a truth that would be scored wrongly, or not at all.

    ``experiments``: names of those of the campaign, None where it is not there.
    """
    truth = complete_truth(content, name)
    listed, kind = truth["listed_as"], truth["kind"]

    def wrong(text: str) -> CampaignError:
        return CampaignError(f"sealed/{name}.json: {text}")

    known = ("listed_as", *KEYS, *(OF_DRAWN if "recipe" in content else ()))
    for key in (key for key in content if key not in known):
        close = difflib.get_close_matches(key, known, n=1)
        hint = f"did you mean '{close[0]}'?" if close else f"known are {', '.join(known)}"
        raise wrong(f"expected keys of a truth, but got '{key[:80]}', which none has; {hint}")
    if truth["name"] != name:
        raise wrong(
            f"name: expected the name of the campaign's folder, '{name}', but got "
            f"{_short(truth['name'])}; correct it or leave it out"
        )
    right = [effect for names in listed for effect in names]
    for key, names in {"listed_as": right, **{k: truth[k] for k in OF_EFFECTS}}.items():
        if unknown := next((effect for effect in names if effect not in CATALOGUE), None):
            outside = " ([[]] for a cause that is none of them)" if key == "listed_as" else ""
            raise wrong(
                f"{key}: expected effects of the catalogue, but got '{unknown[:80]}'; "
                f"known are {', '.join(CATALOGUE)}{outside}"
            )
    if any(listed) and not all(listed):
        raise wrong(
            "listed_as: expected right names for each of several causes, but got "
            f"{_short(listed)}; a cause outside the catalogue is scored alone only, as [[]]"
        )
    fits = {
        "null": not listed,
        "listed": len(listed) == 1 and any(listed),
        "pair": len(listed) > 1 and any(listed),
        "unlisted": bool(listed) and not any(listed),
        "withheld": any(listed),
        "hidden": bool(listed),
    }
    if not fits[kind]:
        raise wrong(
            f"kind: expected one that agrees with listed_as = {_short(listed)}, but got "
            f"'{kind}'; leave it out, and it is told by listed_as"
        )
    for key in ("acts", "visible"):
        for place in truth[key]:
            if experiments is not None and place["experiment"] not in experiments:
                raise wrong(
                    f"{key}: expected experiments of campaigns/{name} "
                    f"({', '.join(experiments)}), but got {_short(place['experiment'])}; correct it"
                )


def _short(value: Any) -> str:
    text = json.dumps(value, ensure_ascii=False)
    return text if len(text) <= 80 else f"{text[:77]}..."
