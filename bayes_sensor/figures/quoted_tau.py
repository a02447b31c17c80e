"""tau of one campaign of a fleet, as its report quotes it."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any


def has_cause(row: Mapping[str, Any]) -> bool:
    """Whether the diagnosis found a cause that the posterior lacks."""
    return row.get("tau_with_cause_s") is not None


def quoted_tau(row: Mapping[str, Any]) -> tuple[float, float, float]:
    """Low end, middle and high end of the 95 % interval of tau, s; None where a ``row`` has none.

    With the cause of a misfit in the model where the diagnosis found one, else the posterior's.
    """
    kind = "tau_with_cause" if has_cause(row) else "tau"
    return row[f"{kind}_lo95_s"], row[f"{kind}_s"], row[f"{kind}_hi95_s"]
