"""The truth of a case: its keys, what each may hold, and one clear message per mistake.

Drawn truths have every key; a user's own needs ``listed_as`` alone.  Types are checked whenever a
truth is read; names are checked before it is sealed, since afterwards it cannot be mended.
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
OF_DRAWN = (
    "seed", "diagnosis_seed", "strengths", "cause_families", "recipe", "pair_rival",
)  # fmt: skip
"""further keys of drawn truths, which a user's own has no use for"""

OF_EFFECTS = ("near", "rivals", "closed")
"""keys whose names are those of effects"""


def _is_number(value: Any) -> bool:
    if isinstance(value, bool) or not isinstance(value, int | float):
        return False
    return abs(value) <= float_info.max  # JSON as Python reads it has NaN and endless integers


def _is_positive(value: Any) -> bool:
    return _is_number(value) and value > 0


def _is_size(value: Any) -> bool:
    return _is_number(value) and value >= 0


def _is_text(value: Any) -> bool:
    return isinstance(value, str)


def _are_names(value: Any) -> bool:
    return isinstance(value, list) and all(isinstance(name, str) for name in value)


def _maps(check: Callable[[Any], bool]) -> Callable[[Any], bool]:
    return lambda value: isinstance(value, Mapping) and all(check(v) for v in value.values())


def _is_place(value: Any) -> bool:
    return (
        isinstance(value, Mapping)
        and {"experiment", "phase", "share"} <= set(value)
        and _is_text(value["experiment"])
        and value["phase"] in PHASES
        and _is_size(value["share"])
    )


def _are_places(value: Any) -> bool:
    return isinstance(value, list) and all(map(_is_place, value))


_TIME = "a positive number of seconds such as 0.048"
_D = "a number from 0 on, in standard deviations of the noise, such as 8.0"
_NAMES = 'a list of names such as ["dead_volume"]'
_PLACES = (
    'a list of places such as [{"experiment": "1", "phase": "fall", "share": 1.0}] with a phase of '
    + ", ".join(PHASES)
)
KEYS: Mapping[str, tuple[Callable[[Any], bool], str, Any]] = {
    "name": (_is_text, "the name of the campaign's folder", ...),
    "kind": (lambda value: value in KINDS, f"one of {', '.join(KINDS)}", ...),
    "causes": (_are_names, 'a list of texts such as ["a pocket"]', []),
    "near": (_are_names, _NAMES, []),
    "level": (_is_size, _D, None),
    "d": (_is_size, _D, None),
    "law": (_is_text, 'a text such as "ar1"', "unknown"),
    "is_ar1": (lambda value: isinstance(value, bool), "true or false", None),
    "tau_s": (_is_positive, _TIME, None),
    "tau_refit_s": (_is_positive, _TIME, None),
    "rivals": (_maps(_is_size), 'distances such as {"carry_over": 5.0}', {}),
    "acts": (_are_places, _PLACES, []),
    "visible": (_are_places, _PLACES, []),
    "closed": (_maps(_is_number), 'shares such as {"dead_volume": 0.97}', {}),
    "size": (_is_text, 'a text such as "own"', "own"),
    "reserve": (lambda value: isinstance(value, bool), "true or false", False),
}  # fmt: skip
"""key beside ``listed_as``: its check, what it holds in words, and what it is where it is not
given (``...``: told by the others)"""


def complete_truth(content: Any, name: str) -> dict[str, Any]:
    """A sealed truth with every key: a user's own needs ``listed_as`` alone.

    ``listed_as``: for each cause the names that are a right answer; ``[]`` for no cause at all and
    ``[[]]`` for one that the catalogue does not list.

    Raises
    ------
    CampaignError
        If a key that is scored holds something else than it must.
    """
    listed = content.get("listed_as") if isinstance(content, Mapping) else None
    if not isinstance(listed, list) or not all(isinstance(n, str) or _are_names(n) for n in listed):
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
    where = f"sealed/{name}.json"
    known = ("listed_as", *KEYS, *(OF_DRAWN if "recipe" in content else ()))
    for key in content:
        if key not in known:
            close = difflib.get_close_matches(key, known, n=1)
            hint = f"did you mean '{close[0]}'?" if close else f"known are {', '.join(known)}"
            raise CampaignError(
                f"{where}: expected keys of a truth, but got '{key[:80]}', which none has; {hint}"
            )
    if truth["name"] != name:
        raise CampaignError(
            f"{where}: name: expected the name of the campaign's folder, '{name}', but got "
            f"{_short(truth['name'])}; correct it or leave it out"
        )
    right = [effect for names in truth["listed_as"] for effect in names]
    for key, names in {"listed_as": right, **{k: truth[k] for k in OF_EFFECTS}}.items():
        if wrong := next((effect for effect in names if effect not in CATALOGUE), None):
            outside = " ([[]] for a cause that is none of them)" if key == "listed_as" else ""
            raise CampaignError(
                f"{where}: {key}: expected effects of the catalogue, but got '{wrong[:80]}'; "
                f"known are {', '.join(CATALOGUE)}{outside}"
            )
    _check_kind(truth, where)
    for key in ("acts", "visible"):
        for place in truth[key]:
            if experiments is not None and place["experiment"] not in experiments:
                raise CampaignError(
                    f"{where}: {key}: expected experiments of campaigns/{name} "
                    f"({', '.join(experiments)}), but got {_short(place['experiment'])}; correct it"
                )


def _check_kind(truth: Mapping[str, Any], where: str) -> None:
    """Whether kind and causes agree, which decides what counts as a right answer."""
    listed, kind = truth["listed_as"], truth["kind"]
    if any(listed) and not all(listed):
        raise CampaignError(
            f"{where}: listed_as: expected right names for each of several causes, but got "
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
        raise CampaignError(
            f"{where}: kind: expected one that agrees with listed_as = {_short(listed)}, but got "
            f"'{kind}'; leave it out, and it is told by listed_as"
        )


def _short(value: Any) -> str:
    text = json.dumps(value, ensure_ascii=False)
    return text if len(text) <= 80 else f"{text[:77]}..."
