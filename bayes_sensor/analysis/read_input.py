"""What an analysis reads before it begins: the campaign, and settings that fit it."""

from __future__ import annotations

import difflib
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from bayes_sensor.campaign import Campaign, CampaignError


def read_input(given: Path | Campaign) -> tuple[Campaign, Any, tuple[str, ...]]:
    """Campaign (read, where a file is given), rows of its understood content, and remarks."""
    from bayes_sensor.io.check import campaign_remarks, campaign_rows
    from bayes_sensor.io.readers import read_campaign

    campaign = given if isinstance(given, Campaign) else read_campaign(given)
    remarks = campaign_remarks(campaign)
    return campaign, campaign_rows(campaign, remarks), remarks


def check_methods(methods: Sequence[str] | None, label: str) -> None:
    """Raise CampaignError for an unknown method of bounds; ``label``: the file of settings."""
    if methods is None:
        return
    from bayes_sensor.bounds import METHODS

    for name in methods:
        if name not in METHODS:
            close = difflib.get_close_matches(name, list(METHODS), n=1)
            hint = f'write "{close[0]}"' if close else f"known are {', '.join(METHODS)}"
            raise CampaignError(f"{label}: [bounds] methods: unknown method '{name[:80]}'; {hint}")
