"""Values of parameters by name: their units, and the nested mapping of ``fit.json``."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from bayes_sensor.campaign import CampaignError

UNITS = {
    "s": "s", "ms": "ms", "V": "V", "V2": "V^2", "mL": "mL", "Hz": "Hz", "K": "K", "s2": "s^2",
}  # fmt: skip
"""at the end of a flat name"""


def unit_of(name: str, signal_unit: str) -> str:
    """The unit at the end of a flat name.

    >>> [unit_of(name, "V") for name in ("tau_s", "drift_V_per_s", "closing_ratio")]
    ['s', 'V/s', '1']
    """
    words = name.split("_")[1:]
    if not words or words[-1] not in UNITS:
        return "1"
    below = UNITS[words[-1]].replace("V", signal_unit)
    if len(words) > 1 and words[-2] == "per":
        above = UNITS.get(words[-3], "1") if len(words) > 2 else "1"
        return f"{above.replace('V', signal_unit)}/{below}"
    return below


def by_flat_name(theta: Mapping[str, Any]) -> dict[str, Any]:
    """The nested mapping of ``fit.json`` by flat name.

    >>> by_flat_name({"tau_s": 0.05, "experiments": {"1": {"t0_s": 5.0}}})
    {'tau_s': 0.05, 't0_s[1]': 5.0}
    """
    found = dict(theta)
    nested = found.pop("experiments", {})
    if not isinstance(nested, Mapping) or not all(isinstance(v, Mapping) for v in nested.values()):
        raise CampaignError(
            "theta: experiments: expected a mapping of values for each experiment, as "
            "Fit.parameters has it; correct it"
        )
    for name, values in nested.items():
        found.update({f"{kind}[{name}]": value for kind, value in values.items()})
    return found


def number_of(value: Any, name: str) -> float:
    """The value of a parameter; nan for None."""
    if value is None:
        return np.nan
    try:
        return float(value)
    except (TypeError, ValueError):
        unit = unit_of(name.split("[")[0], "V")
        raise CampaignError(
            f"theta: {name}: expected a number{'' if unit == '1' else f' in {unit}'}, but got "
            f"{str(value)[:40]!r}; write it without a unit"
        ) from None
