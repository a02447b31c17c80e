"""What ``bounds.json`` says of its methods: labels, and what tells one from another."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any


@dataclass(frozen=True)
class MethodWords:
    """A bound method as figures and report show it; see BoundMethod for the fields."""

    label: str
    full_label: str = ""
    noise: str = "any"
    needs_posterior: bool = False
    published_recipe: bool = False
    against_others: str = ""


def method_words(bounds: Mapping[str, Any], name: str) -> MethodWords:
    """Those of one method in the content of ``bounds.json``."""
    about = ((bounds.get("methods") or {}).get(name) or {}).get("about")
    if about is None:  # results of an older version
        from bayes_sensor.bounds.methods import method_of

        about = method_of(name).about()
    return MethodWords(**{key: about[key] for key in about if key in MethodWords.__annotations__})


def role_of(bounds: Mapping[str, Any], role: str) -> Any:
    """The name of the method that is the ``white``, ``coloured`` or ``published`` Cramer-Rao bound;
    for ``to_quote`` those whose interval to state without a posterior, in order."""
    roles = bounds.get("roles")
    if roles is None:  # results of an older version
        from bayes_sensor.bounds.methods import ROLES

        roles = ROLES
    return roles[role]


def quoted(bounds: Mapping[str, Any] | None) -> str | None:
    """The method whose interval is stated where there is no posterior; None if there is none."""
    methods = (bounds or {}).get("methods") or {}
    wanted = role_of(bounds, "to_quote") if bounds else []
    return next((name for name in wanted if name in methods), None)


def classical_bound(bounds: Mapping[str, Any] | None, role: str) -> Mapping[str, Any]:
    """Standard deviations by parameter of a Cramer-Rao bound at one common point; may be empty."""
    naive = (bounds or {}).get("naive") or {}
    return naive.get(role_of(bounds or {}, role)) or {} if naive else {}
