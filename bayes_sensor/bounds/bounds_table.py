"""Every method's bound, side by side."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

from bayes_sensor.bounds.bound import COLUMNS, Bound
from bayes_sensor.bounds.methods import ROLES, method_of
from bayes_sensor.display import card

if TYPE_CHECKING:
    import pandas as pd

    from bayes_sensor.bounds.likelihood_surface import Maximum, Surface


@dataclass(frozen=True, eq=False)
class Bounds:
    """Every method's bound, side by side."""

    methods: dict[str, Bound]
    signal_unit: str = "V"
    seconds: Mapping[str, float] = field(default_factory=dict)
    """how long each method took"""
    caveats: tuple[str, ...] = ()
    """caveats of the fit"""
    likelihood: tuple[Surface, Maximum] | None = None
    """the likelihood under the campaign's own noise with its maximum, where a method needed it"""

    def __getitem__(self, method: str) -> Bound:
        try:
            return self.methods[method]
        except KeyError:
            raise KeyError(f"no method '{method}'; there are {', '.join(self.methods)}") from None

    def __repr__(self) -> str:
        """The methods; :meth:`table` has their numbers."""
        return f"Bounds({', '.join(self.methods)})"

    def _repr_html_(self) -> str:
        """HTML for a notebook: the shared parameters; :meth:`table` has all."""
        rows = []
        shown = dict.fromkeys(name for bound in self.methods.values() for name in bound.names[:3])
        for name in shown:
            for method, bound in self.methods.items():
                row = bound.row(name) if name in bound.names else {}
                ends = [row.get(key) for key in ("estimate", "sd", "lo95", "hi95")]
                rows.append([name, method, *ends, bound.assumes])
        columns = ["parameter", "method", "estimate", "sd", "95 % low", "95 % high", "assumes"]
        return card("bounds", self.caveats, columns, rows)

    def table(self) -> pd.DataFrame:
        """One row per parameter and method (a MultiIndex), columns as in ``bounds.json``."""
        import pandas as pd

        names: list[str] = []
        for bound in self.methods.values():
            names += [name for name in bound.names if name not in names]
        rows, index = [], []
        for name in names:
            for method, bound in self.methods.items():
                if name in bound.names:
                    index.append((name, method))
                    rows.append(bound.row(name))
        keys = pd.MultiIndex.from_tuples(index, names=["parameter", "method"])
        return pd.DataFrame(rows, index=keys, columns=list(COLUMNS))

    def to_json(self) -> dict[str, Any]:
        """The content of ``bounds.json``."""
        return {
            "methods": {
                name: bound.to_json() | {"about": method_of(name).about()}
                for name, bound in self.methods.items()
            },
            "roles": ROLES,
            "signal_unit": self.signal_unit,
            "caveats": list(self.caveats),
            "warnings": list(self.caveats),
        }

    def to_csv(self, path: str | Path | None = None) -> str | None:
        """Write the table as ``bounds.csv``; without a path, return its text."""
        text: str | None = self.table().to_csv(path, lineterminator="\n")
        return text
