"""Quantities with units: text such as ``"4.5 L/min"`` in, floats in the internal unit out.

The number is split off here.  Only the unit is passed to pint, after a check against a small
grammar, because pint evaluates what it parses, and ``"9**9**9**9 s"`` must not hang.
"""

from __future__ import annotations

import re
from dataclasses import dataclass
from functools import cache, lru_cache
from math import isfinite
from tokenize import TokenError
from typing import TYPE_CHECKING, Any

from bayes_sensor.campaign import CampaignError

if TYPE_CHECKING:
    from pint import UnitRegistry

NUMBER = r"[+-]?(?:\d+\.?\d*|\.\d+)(?:[eE][+-]?\d+)?"
_QUANTITY = re.compile(rf"({NUMBER})\s*(.*)")
_SPREAD = re.compile(rf"\(?\s*({NUMBER})\s*(?:\+-|\+/-|±)\s*({NUMBER})\s*\)?\s*(.*)")
_SYMBOL = r"[A-Za-zµμΩ\u2126%°][A-Za-z_0-9µμΩ\u2126%°]*(?:\*\*-?[1-9])?"
_UNIT = re.compile(rf"\(?{_SYMBOL}\)?(?:\s*[*/\s]\s*\(?{_SYMBOL}\)?)*")
STANDARD_FLOW = re.compile(r"(?i)sccm|sccs|slm|slpm|sl/min|sml/min|nl/min|nml/min|ln/min|mln/min")
"""units of a flow that is given as the volume at standard conditions"""
_LONGEST = 80
"""characters, of a quantity's text"""
_LEAST, _MOST = 1e-150, 1e150
"""size of a number that is not 0: its square, which every density takes, is a float, too"""
_RANGES = {"s": (1e-15, 1e12), "mL/s": (1e-12, 1e6), "mL": (1e-12, 1e12), "m": (1e-10, 1.0),
           "m^2/s": (1e-30, 1.0), "Pa": (1e-9, 1e12)}  # fmt: skip
"""size of a quantity in its internal unit, far wider than any rig"""


@dataclass(frozen=True)
class Kind:
    """The kind of a quantity, its internal unit and an example for messages."""

    name: str
    unit: str
    example: str


FLOW = Kind("a volume flow", "mL/s", "4.0 L/min")
TIME = Kind("a time", "s", "24.0 s")
VOLUME = Kind("a volume", "mL", "60 mL")


# What most campaigns are written in: pint takes a quarter of a second to start.
COMMON_FACTORS = {
    **{(u, "mL/s"): f for u, f in (("mL/s", 1.0), ("cm^3/s", 1.0), ("L/s", 1e3),
                                   ("L/min", 1e3 / 60), ("mL/min", 1 / 60))},
    **{(u, "s"): f for u, f in (("s", 1.0), ("ms", 1e-3), ("min", 60.0))},
    **{(u, "mL"): f for u, f in (("mL", 1.0), ("cm^3", 1.0), ("L", 1e3))},
    **{(u, "V"): f for u, f in (("V", 1.0), ("mV", 1e-3))},
}  # fmt: skip


@cache
def _registry() -> UnitRegistry[Any]:
    from pint import UnitRegistry  # slow to import and to build, so only where a unit is read

    registry: UnitRegistry[Any] = UnitRegistry()
    registry.define("part_per_billion = 1e-9 = ppb")
    return registry


@lru_cache(maxsize=1024)
def conversion_factor(unit: str, target: str) -> float | None:
    """Factor that takes a number in ``unit`` to ``target``; None where the dimensions differ.

    >>> round(conversion_factor("L/min", "mL/s"), 6)
    16.666667
    >>> conversion_factor("s", "mL/s") is None
    True

    Raises
    ------
    CampaignError
        If ``unit`` is not a unit.
    """
    if (unit, target) in COMMON_FACTORS:
        return COMMON_FACTORS[unit, target]
    from pint.errors import PintError

    registry = _registry()
    parsed = _parse_unit(unit)
    wanted = registry.Unit(_normal_form(target))
    if parsed == wanted:
        return 1.0
    if parsed.dimensionality != wanted.dimensionality:
        return None
    try:
        factor = float(registry.Quantity(1.0, parsed).to(wanted).magnitude)
    except (PintError, ArithmeticError, ValueError, TypeError):  # units with an offset, as degC
        return None
    return factor if isfinite(factor) and factor > 0 else None


def known_unit(text: str) -> bool:
    """Whether the text is a unit that can be read.

    >>> known_unit("mV"), known_unit("Channel A")
    (True, False)
    """
    try:
        _parse_unit(text)
    except CampaignError:
        return False
    return True


def unit_text(text: str) -> str:
    """The unit as the user wrote it, without blanks around it; CampaignError if it is none."""
    _parse_unit(text)
    return text.strip()


def read_quantity(value: object, kind: Kind, key: str) -> float:
    """The number of a quantity, in the kind's internal unit.

    >>> read_quantity("4.5 L/min", FLOW, "carrier_flow")
    75.0

    Raises
    ------
    CampaignError
        If the value is not a text with a number and a unit of the right dimension.
    """
    text = _text_of(value, kind, key)
    match = _QUANTITY.fullmatch(text)
    if match is None or match[2].startswith(","):
        raise CampaignError(
            f"{key}: expected {kind.name} such as \"{kind.example}\", but got '{_shorten(text)}'; "
            f"write a number (with a decimal point) and a unit"
        )
    return _scaled(match[1], match[2], kind, key, text)


def read_spread(value: object, kind: Kind, key: str) -> tuple[float, float]:
    """Mean and standard deviation of ``"60 +- 2 mL"``, in the kind's internal unit.

    >>> read_spread("60 +- 2 mL", VOLUME, "V")
    (60.0, 2.0)

    Raises
    ------
    CampaignError
        If the text is not of that form, the unit is wrong or a number is not positive.
    """
    number = kind.example.split()[0]
    example = kind.example.replace(number, f"{number} +- {float(number) / 30:g}", 1)
    text = _text_of(value, Kind(kind.name, kind.unit, example), key)
    match = _SPREAD.fullmatch(text)
    if match is None:
        raise CampaignError(
            f'{key}: expected {kind.name} with its standard deviation such as "{example}", '
            f"but got '{_shorten(text)}'; write mean +- sd and a unit"
        )
    mean = _scaled(match[1], match[3], kind, key, text)
    sd = _scaled(match[2], match[3], kind, key, text)
    if not (mean > 0 and sd > 0):
        raise CampaignError(
            f"{key}: expected a positive mean and a positive standard deviation, "
            f"but got '{_shorten(text)}'; write for example \"{example}\""
        )
    return mean, sd


def in_range(value: float) -> bool:
    """Whether a number is 0 or of a size that can be computed with.

    >>> in_range(0.0), in_range(-2.5), in_range(1e-310), in_range(float("nan")), in_range(10**400)
    (True, True, False, False, False)
    """
    return value == 0 or _LEAST <= abs(value) <= _MOST


def read_number(text: str) -> float | None:
    """The number of a text without a unit; None where it is none, or out of range.

    >>> read_number("0.5"), read_number("1e-400"), read_number("nan")
    (0.5, None, None)
    """
    text = text.strip()
    if re.fullmatch(NUMBER, text) is None:
        return None
    value = float(text)
    return value if in_range(value) and (value != 0.0 or _is_zero(text)) else None


def _is_zero(number: str) -> bool:
    """Whether a number is written as 0, and not so small that no float holds it."""
    return not re.search("[1-9]", re.split("[eE]", number)[0])


def _text_of(value: object, kind: Kind, key: str) -> str:
    if isinstance(value, bool) or not isinstance(value, int | float | str):
        raise CampaignError(
            f"{key}: expected {kind.name} as text with a unit, but got {_shorten(str(value))}; "
            f"write {_written(key, kind.example)}"
        )
    if not isinstance(value, str) and not in_range(value):
        got = (
            f"a number of about {int(value.bit_length() * 0.30103) + 1} digits"
            if isinstance(value, int)
            else f"the number {value:.12g}"
        )
        raise CampaignError(
            f'{key}: expected {kind.name} such as "{kind.example}", but got {got}, which is out of '
            "range; write the value that was set, with its unit"
        )
    if not isinstance(value, str):
        unit = kind.example.split(" ", 1)[1].split()[-1]
        raise CampaignError(
            f"{key}: expected {kind.name} with its unit, but got the bare number "
            f"{value:.12g}; write {_written(key, f'{value:.12g} {unit}')}"
        )
    text = value.strip()
    if len(text) > _LONGEST:
        raise CampaignError(
            f'{key}: expected {kind.name} such as "{kind.example}", but got {len(text)} '
            "characters; write a number and a unit"
        )
    return text


def _written(key: str, text: str) -> str:
    """How a quantity is given: an option of the command, or the last part of what ``key`` says."""
    if key.startswith("--"):
        return f'{key} "{text}"'
    name = re.sub(r"^\[\w+\] ", "", key.rpartition(": ")[2])
    return f'{name} = "{text}"'


def _scaled(number: str, unit: str, kind: Kind, key: str, text: str) -> float:
    if not unit.strip():
        written = _written(key, f"{_shorten(text)} {kind.example.split()[-1]}")
        raise CampaignError(
            f"{key}: expected {kind.name} with its unit, but got '{_shorten(text)}' without one; "
            f"add the unit that is meant, as in {written}"
        )
    try:
        factor = conversion_factor(unit.strip(), kind.unit)
    except CampaignError as error:
        raise CampaignError(f"{key}: {error}") from None
    if factor is None:
        fix = f"write for example {_written(key, kind.example)}"
        if kind is FLOW and conversion_factor(unit.strip(), "dimensionless") is not None:
            fix = (
                "write a concentration as concentration, beside total_flow, in place of the two "
                "flows"
            )
        raise CampaignError(
            f"{key}: expected {kind.name}, but '{_shorten(text)}' is in '{_shorten(unit)}', which "
            f"is not one; {fix}"
        )
    value = float(number) * factor
    least, most = _RANGES.get(kind.unit, (_LEAST, _MOST))
    if not (least <= abs(value) <= most or (value == 0.0 and _is_zero(number))):
        raise CampaignError(
            f"{key}: expected {kind.name} such as \"{kind.example}\", but '{_shorten(text)}' is "
            f"out of range ({least:g} to {most:g} {kind.unit}); write the value that was set"
        )
    # a decimal number such as "12 ms" must become the float 0.012, not 0.012000000000000002
    short = float(f"{value:.12g}")
    return short if abs(short - value) <= 1e-15 * abs(value) else value


def _normal_form(text: str) -> str:
    text = text.strip().replace("·", "*").replace("^", "**")
    text = text.replace("²", "**2").replace("³", "**3")
    # in small letters: MLPM is on many a controller, and ML would be megalitres
    text = re.sub(r"(?i)\b(l|ml)pm\b", lambda match: f"{match[1].lower()}/min", text)
    return re.sub(r"\b([cdm]?m)([23])\b", r"\1**\2", text)


@lru_cache(maxsize=1024)
def _parse_unit(text: str) -> Any:
    from pint.errors import PintError

    normal = _normal_form(text)
    if STANDARD_FLOW.fullmatch(normal):
        raise CampaignError(
            f"'{normal}' is a flow at standard conditions; give the volume flow at the rig's own "
            'temperature and pressure, such as "500 mL/min"'
        )
    if len(normal) <= _LONGEST and _UNIT.fullmatch(normal):
        try:
            return _registry().parse_units(normal)
        except (
            PintError,
            ArithmeticError,
            AssertionError,
            AttributeError,
            KeyError,
            RecursionError,
            SyntaxError,
            TokenError,
            TypeError,
            ValueError,
        ):
            pass  # all that pint's parser is known to raise on text that is no unit
    raise CampaignError(
        f"'{_shorten(text)}' is not a unit that is known; write one such as L/min, cm^3/s, s, ms, "
        "V, mV, ppm, ohm, or dimensionless"
    )


def _shorten(text: str, longest: int = 60) -> str:
    return text if len(text) <= longest else text[: longest - 3] + "..."
