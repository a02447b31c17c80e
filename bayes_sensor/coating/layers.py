"""The coating over the ring: layers, dimensions, diffusivities."""

from __future__ import annotations

import difflib
import math
from dataclasses import dataclass, fields, replace
from typing import Any

import numpy as np

from bayes_sensor.display import record_card
from bayes_sensor.io.readers.quantities import Kind, read_quantity

LEVEL_63 = 1.0 - math.exp(-1.0)
"""the 63.2 % at which one first-order lag has its time constant"""

GEOMETRIES = ("axisymmetric", "planar")
EQUIVALENTS = ("tau63", "tau_fit", "tau_moment")

_KINDS = {
    "ring_radius": Kind("a length", "m", "10 um"),
    "outer_radius": Kind("a length", "m", "17.4 um"),
    "thickness_zif8": Kind("a length", "m", "1.5 um"),
    "thickness_pdms": Kind("a length", "m", "7.0 um"),
    "d_zif8": Kind("a diffusivity", "m^2/s", "1.71e-10 m^2/s"),
    "d_pdms": Kind("a diffusivity", "m^2/s", "4.2e-9 m^2/s"),
    "probe_height": Kind("a length", "m", "220 nm"),
}
"""of what is written with a unit; the examples are the defaults"""
_MAY_BE_ZERO = ("ring_radius", "probe_height")


@dataclass(frozen=True)
class Coating:
    """Dimensions (m) and diffusivities (m2/s) of the coating; the defaults are the paper's.

    Paper Sec. III-D gives all but ``outer_radius``; 17.4 um is the value at which the finite
    element response reaches 63.2 % after the published 12.9 ms (:func:`find_outer_radius`).
    ``outer_radius=math.inf`` is a coating without a side: diffusion from the top alone.

    >>> Coating(d_zif8=2.6e-11).thickness
    8.5e-06
    >>> Coating().with_quantities(outer_radius="16 um").outer_radius
    1.6e-05

    Raises
    ------
    ValueError
        If a length or diffusivity is not positive or the probe lies outside the coating.
    """

    _repr_html_ = record_card

    ring_radius: float = 10e-6
    """m, distance of the probe from the axis (planar: from the plane of symmetry)"""
    outer_radius: float = 17.4e-6
    """m, where the coating ends sideways; may be ``math.inf``"""
    thickness_zif8: float = 1.5e-6
    """m"""
    thickness_pdms: float = 7.0e-6
    """m"""
    d_zif8: float = 1.71e-10
    """m2/s (paper ref. 21)"""
    d_pdms: float = 4.2e-9
    """m2/s (paper ref. 22)"""
    probe_height: float = 220e-9
    """m above the chip"""
    partition: float = 1.0
    """concentration in ZIF-8 over that in PDMS at equilibrium"""
    geometry: str = "axisymmetric"
    """one of :data:`GEOMETRIES`"""

    def __post_init__(self) -> None:
        for item in fields(self):
            if item.name == "geometry":
                continue
            value = getattr(self, item.name)
            may_be_zero = item.name in _MAY_BE_ZERO
            may_be_infinite = item.name == "outer_radius"
            good = isinstance(value, int | float | np.number) and (
                value >= 0 if may_be_zero else value > 0
            )
            if not good or not (may_be_infinite or math.isfinite(value)):
                sign = "zero or more" if may_be_zero else "positive"
                hint = '; with_quantities reads "1.5 um"' if isinstance(value, str) else ""
                raise ValueError(
                    f"coating: {item.name} must be a {sign} number in SI units, got {value!r}{hint}"
                )
            object.__setattr__(self, item.name, float(value))
        if self.geometry not in GEOMETRIES:
            raise ValueError(
                f"coating: geometry must be one of {', '.join(GEOMETRIES)}, got '{self.geometry}'"
            )
        self._check_probe()

    def _check_probe(self) -> None:
        """Raise ValueError where the probe lies outside the coating."""
        outer, ring, top = self.outer_radius, self.ring_radius, self.thickness
        if outer <= ring:
            raise ValueError(
                f"outer_radius: expected more than ring_radius = {_in_um(ring)}, got "
                f"{_in_um(outer)}, so that the probe lies outside the coating; write for example "
                f'"{_in_um(1.74 * ring)}", or a smaller ring_radius'
            )
        if self.probe_height >= top:
            raise ValueError(
                "probe_height: expected less than thickness_zif8 + thickness_pdms = "
                f"{_in_um(top)}, got {_in_um(self.probe_height)}, so that the probe lies above the "
                f'coating; write for example "{_in_um(0.026 * top)}", or a larger thickness'
            )

    @property
    def thickness(self) -> float:
        """m, both layers together."""
        return self.thickness_zif8 + self.thickness_pdms

    def with_quantities(self, **quantities: str) -> Coating:
        """The coating with fields replaced by text with a unit, such as ``"17.5 um"``.

        Raises
        ------
        ValueError
            If a name is unknown, a unit is missing, unknown or of the wrong dimension, or the
            value is not allowed.
        """
        values: dict[str, Any] = {}
        for name, text in quantities.items():
            if name not in _KINDS:
                near = difflib.get_close_matches(name, _KINDS, n=1)
                hint = f"did you mean {near[0]}?" if near else f"known: {', '.join(_KINDS)}"
                raise ValueError(f"coating: there is no quantity '{name}'; {hint}")
            kind = _KINDS[name]
            values[name] = read_quantity(text, kind, name)
            if values[name] < 0 or (values[name] == 0 and name not in _MAY_BE_ZERO):
                what = kind.name.removeprefix("a ")
                wanted = (
                    f"a {what} of zero or more" if name in _MAY_BE_ZERO else f"a positive {what}"
                )
                raise ValueError(
                    f"{name}: expected {wanted}, got '{text}'; write for example \"{kind.example}\""
                )
        return replace(self, **values)


def _in_um(length: float) -> str:
    return f"{1e6 * length:.4g} um"
