"""The truth of a case: its keys, what each may hold, and one clear message per mistake.

Drawn truths have every key.  A user's own needs ``listed_as`` alone.  Names are checked before a
truth is sealed, because afterwards it cannot be corrected.
"""

from __future__ import annotations

import difflib
import json
from collections.abc import Collection, Mapping
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
_PLACES = [{"experiment": "1", "phase": "fall", "share": 1.0}]
KEYS: Mapping[str, tuple[Any, Any]] = {
    "name": ("mine", ...), "kind": ("withheld", ...), "causes": (["a pocket"], []),
    "near": (["carry_over"], []), "level": (8.0, None), "d": (8.0, None),
    "law": ("ar1", "unknown"), "is_ar1": (True, None), "tau_s": (0.048, None),
    "tau_refit_s": (0.048, None), "rivals": ({"carry_over": 5.0}, {}), "acts": (_PLACES, []),
    "visible": (_PLACES, []), "closed": ({"dead_volume": 0.97}, {}), "size": ("own", "own"),
    "reserve": (True, False),
}  # fmt: skip
"""key beside ``listed_as``: an example, and its default (``...``: follows from the others)"""
MORE = {
    "kind": f"one of {', '.join(KINDS)}", "level": "standard deviations of the noise",
    "d": "standard deviations of the noise", "tau_s": "s, positive", "tau_refit_s": "s, positive",
    "acts": f"phases: {', '.join(PHASES)}", "visible": f"phases: {', '.join(PHASES)}",
}  # fmt: skip
"""what an example does not say"""


def _is_like(value: Any, example: Any) -> bool:
    """Whether a value is built as the example is; numbers are finite and not negative."""
    if isinstance(example, bool | str):
        return isinstance(value, type(example))
    if isinstance(example, list):
        return isinstance(value, list) and all(_is_like(each, example[0]) for each in value)
    if isinstance(example, Mapping):
        if not isinstance(value, Mapping):
            return False
        if "share" not in example:  # names of one's own
            return all(_is_like(each, 1.0) for each in value.values())
        alike = all(_is_like(value.get(name), each) for name, each in example.items())
        return alike and value["phase"] in PHASES
    is_number = isinstance(value, int | float) and not isinstance(value, bool)
    return is_number and 0 <= value <= float_info.max  # JSON has NaN and endless integers


def _holds(key: str, value: Any) -> bool:
    if key == "kind":
        return value in KINDS
    return _is_like(value, KEYS[key][0]) and (value != 0 or not key.startswith("tau"))


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
    if not isinstance(listed, list) or not all(
        isinstance(n, str) or _is_like(n, ["effect"]) for n in listed
    ):
        raise CampaignError(
            f'sealed/{name}.json: expected {{"listed_as": [["effect"], ..]}}, one list of right '
            "names for each cause; [] where nothing is wrong"
        )
    for key, (example, default) in KEYS.items():
        value = content.get(key, default)
        if value is not default and not _holds(key, value):
            more = f" ({MORE[key]})" if key in MORE else ""
            raise CampaignError(
                f"sealed/{name}.json: {key}: expected something like {json.dumps(example)}{more}, "
                f"but got {_short(value)}; correct it or leave it out"
            )
    listed = [[names] if isinstance(names, str) else list(names) for names in listed]
    kind = "null" if not listed else "pair" if len(listed) > 1 else "listed"
    if listed and not any(listed):
        kind = "unlisted"
    defaults = {key: default for key, (_, default) in KEYS.items()}
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
