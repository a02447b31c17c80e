"""The result of a bound method: estimates, spreads, intervals and assumptions."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from bayes_sensor.campaign import FloatArray
from bayes_sensor.display import record_card
from bayes_sensor.io.json_files import plain

LEVELS: dict[str, float] = {"68": 0.68, "95": 0.95, "997": 0.997}
"""confidence levels by the suffix of their JSON keys"""
COLUMNS = ("estimate", "sd", "lo68", "hi68", "lo95", "hi95", "lo997", "hi997")


@dataclass(frozen=True, eq=False)
class Bound:
    """One method's values for every parameter; nan is "no value".

    Seconds, mL and the campaign's signal unit.
    """

    _repr_html_ = record_card

    names: list[str]
    """flat parameter names"""
    estimate: FloatArray
    """(n,)"""
    sd: FloatArray
    """(n,); nan where a standard deviation would mislead"""
    low: FloatArray
    """(n, 3) lower ends at the levels of :data:`LEVELS`"""
    high: FloatArray
    """(n, 3) upper ends"""
    status: str = "ok"
    """sentences on irregularities; ``ok`` if there were none"""
    details: Mapping[str, Any] = field(default_factory=dict)
    """numbers of interest to this method alone (bandwidth, block length, ..)"""
    method: str = ""
    assumes: str = ""
    """one sentence"""
    reference: str = ""
    """reference of the method"""
    unnamed: tuple[str, ...] = ()
    """shared parameters without a value, because it is not known whose a lag is"""

    def __post_init__(self) -> None:
        n = len(self.names)
        for label, array, shape in (
            ("estimate", self.estimate, (n,)),
            ("sd", self.sd, (n,)),
            ("low", self.low, (n, len(LEVELS))),
            ("high", self.high, (n, len(LEVELS))),
        ):
            if array.shape != shape:
                raise ValueError(f"{self.method}: {label} has shape {array.shape}, not {shape}")

    def __repr__(self) -> str:
        """The first intervals at 95 % and the status."""
        few = ", ".join(
            f"{name} {low:.4g} to {high:.4g}"
            for name, low, high in zip(
                self.names[:3], self.low[:, 1].tolist(), self.high[:, 1].tolist(), strict=False
            )
        )
        return f"Bound({self.method}: 95 % {few}, .. ({len(self.names)}); {self.status})"

    @classmethod
    def without_values(cls, names: list[str], estimate: FloatArray, reason: str) -> Bound:
        """One with estimates (n,) alone; ``reason``: a sentence, why there are no intervals."""
        nothing = np.full((len(names), len(LEVELS)), np.nan)
        return cls(names, estimate, nothing[:, 0], nothing, nothing, reason)

    def interval(self, name: str, level: str | float = "95") -> tuple[float, float]:
        """Lower and upper end for one parameter at ``level``: "68", "95", "997" or .68, .95, .997.

        Raises KeyError for an unknown parameter or level.
        """
        keys = list(LEVELS)
        key = level if isinstance(level, str) else f"{1000 * level:.0f}".rstrip("0")
        if key not in keys:
            raise KeyError(f"{self.method}: no level '{level}'; there are {', '.join(keys)}")
        i, j = self._place(name), keys.index(key)
        return float(self.low[i, j]), float(self.high[i, j])

    def _place(self, name: str) -> int:
        if name not in self.names:
            known = ", ".join(self.names)
            raise KeyError(f"{self.method}: no parameter '{name}'; there are {known}")
        return self.names.index(name)

    @property
    def intervals(self) -> dict[str, dict[str, tuple[float, float]]]:
        """Ends by level and parameter: ``intervals["95"]["tau_s"]``."""
        return {key: {n: self.interval(n, key) for n in self.names} for key in LEVELS}

    def row(self, name: str) -> dict[str, float]:
        """The eight numbers of one parameter by their JSON keys; nan for no value."""
        i = self._place(name)
        values = [self.estimate[i], self.sd[i]]
        for j in range(len(LEVELS)):
            values += [self.low[i, j], self.high[i, j]]
        return {key: float(value) for key, value in zip(COLUMNS, values)}

    def to_json(self) -> dict[str, Any]:
        """``assumes``, ``reference``, ``status`` and ``parameters`` as in ``bounds.json``."""
        parameters: dict[str, Any] = {}
        for name in self.names:
            row = plain(self.row(name))
            said = any(row[key] is not None for key in COLUMNS[1:])
            parameters[name] = row if said else None
        for name in self.unnamed:  # what has no value because it is not known whose a lag is
            parameters.setdefault(name, None)
        return {
            "assumes": self.assumes,
            "reference": self.reference,
            "status": self.status,
            "details": plain(dict(self.details)),
            "parameters": parameters,
        }
