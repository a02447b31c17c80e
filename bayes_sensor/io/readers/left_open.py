"""Values that a campaign file still leaves open: texts that begin with a question mark.

``bayes-sensor init`` writes ``carrier_flow = "? L/min"  # MISSING`` where it cannot know a value.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any

from bayes_sensor.campaign import CampaignError

MARK = "?"
"""what a value that is missing begins with"""
_NUMBERS = {"s": "24.0", "ms": "1.0", "bar": "1.0", "degC": "21", "%": "11.1"}


def check_filled_in(tables: Mapping[str, Any], label: str) -> None:
    """Raise one CampaignError that names every value that is left open.

    >>> check_filled_in({"experiment": [{"name": "1", "carrier_flow": "? L/min"}]}, "campaign.toml")
    Traceback (most recent call last):
    ...
    bayes_sensor.experiment.CampaignError: campaign.toml: carrier_flow of experiment '1' is still
    missing; expected a value in place of '?': write what was set, such as "4.0 L/min"
    """
    left: dict[str, list[str]] = {}
    example = ""
    for key, value in tables.items():
        if key == "experiment" and isinstance(value, list):
            continue
        for name, text in _open_in(key, value):
            left.setdefault(name, [])
            example = example or text
    experiments = tables.get("experiment")
    for number, table in enumerate(experiments if isinstance(experiments, list) else [], 1):
        if not isinstance(table, Mapping):
            continue
        for key, value in table.items():
            for name, text in _open_in(key, value):
                left.setdefault(name, []).append(f"'{str(table.get('name', number))[:60]}'")
                example = example or text
    if not left:
        return
    together: dict[tuple[str, ...], list[str]] = {}
    for name, places in left.items():
        together.setdefault(tuple(places), []).append(name)
    said = [f"{', '.join(names)}{_of(where)}" for where, names in together.items()]
    unit = example.removeprefix(MARK).strip()
    example = f"{_NUMBERS.get(unit, '4.0')} {unit}".strip()
    are = "is" if len(left) == 1 else "are"
    raise CampaignError(
        f"{label}: {'; '.join(said)} {are} still missing; expected a value in place of '{MARK}': "
        f'write what was set, such as "{example}"'
    )


def _of(experiments: tuple[str, ...], most: int = 8) -> str:
    """Words for the experiments of a key; empty for the keys of no experiment."""
    if not experiments:
        return ""
    more = f" and {len(experiments) - most} more" if len(experiments) > most else ""
    s = "s" if len(experiments) > 1 else ""
    return f" of experiment{s} {', '.join(experiments[:most])}{more}"


def _open_in(key: str, value: object) -> Iterator[tuple[str, str]]:
    """Key and text of each value that is left open."""
    if isinstance(value, str):
        if value.lstrip().startswith(MARK) and key not in ("name", "title", "file"):
            yield key, value.strip()
    elif isinstance(value, Mapping):
        for inner, content in value.items():
            yield from _open_in(str(inner), content)
    elif isinstance(value, list):
        for part in value:
            yield from _open_in(key, part)
