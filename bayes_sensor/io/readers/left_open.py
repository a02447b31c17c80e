"""Values that a campaign file still leaves open: texts that begin with a question mark.

``bayes-sensor init`` writes ``carrier_flow = "? L/min"  # MISSING`` where it cannot know a value.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any

from bayes_sensor.campaign import CampaignError

MARK = "?"
"""what a value that is missing begins with"""


def check_filled_in(tables: Mapping[str, Any], label: str) -> None:
    """Raise one CampaignError that names every value that is left open.

    >>> check_filled_in({"experiment": [{"name": "1", "carrier_flow": "? L/min"}]}, "campaign.toml")
    Traceback (most recent call last):
    ...
    bayes_sensor.campaign.CampaignError: campaign.toml: carrier_flow of experiment '1' is still
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
    said = []
    for name, places in left.items():
        shown = ", ".join(places[:8]) + (f" and {len(places) - 8} more" if len(places) > 8 else "")
        of = f" of experiment{'s' if len(places) > 1 else ''} {shown}" if places else ""
        said.append(f"{name}{of}")
    unit = example.removeprefix(MARK).strip()
    number = "4.0" if "/" in unit or not unit else "24.0"
    are = "is" if len(said) == 1 and all(len(p) < 2 for p in left.values()) else "are"
    raise CampaignError(
        f"{label}: {'; '.join(said)} {are} still missing; expected a value in place of '{MARK}': "
        f'write what was set, such as "{f"{number} {unit}".strip()}"'
    )


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
