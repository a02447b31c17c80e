"""The flows of an experiment as a user sets them: two flows, or a total flow and a concentration.

A flow in standard units says how much gas passes.  The rig's lags depend on the volume that passes,
so it is converted with the gas law, ``Q = Q_std (T / T_std) (p_std / p)``, from the temperature and
pressure that the unit stands for to those of the rig.
"""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from bayes_sensor.campaign import CampaignError
from bayes_sensor.io.readers.quantities import (
    FLOW,
    NUMBER,
    STANDARD_FLOW,
    Kind,
    conversion_factor,
    read_number,
    read_quantity,
)

FLOWS = ("carrier_flow", "test_gas_flow")
MIXTURE = ("total_flow", "concentration")
"""what may stand for the two flows"""
CONDITIONS = ("temperature", "pressure", "standard_temperature", "standard_pressure")
"""the keys of ``[conditions]``; the last two have defaults"""
_PRESSURE = Kind("an absolute pressure", "Pa", "1.0 bar")
_SHARE = Kind("a concentration", "dimensionless", "11.1 %")
STANDARD_TEMPERATURE, STANDARD_PRESSURE = 273.15, 101325.0
"""K, Pa: what sccm, slm and nL/min stand for where the campaign does not say otherwise"""
_COLDEST, _HOTTEST = 100.0, 2000.0  # K
_TEMPERATURE = re.compile(
    rf"({NUMBER})\s*(?:(K|kelvin)|(degC|°C|C|celsius|deg_C)|(degF|°F|F|fahrenheit|deg_F))"
)
_EXAMPLE = 'add [conditions] with temperature = "21 degC" and pressure = "1.0 bar"'


@dataclass(frozen=True)
class Conditions:
    """Temperature (K) and pressure (Pa) of the gas in the rig, and those of standard units."""

    temperature: float | None = None
    pressure: float | None = None
    standard_temperature: float = STANDARD_TEMPERATURE
    standard_pressure: float = STANDARD_PRESSURE
    stated: bool = False
    """whether the campaign says what its standard units stand for"""

    @property
    def expansion(self) -> float | None:
        """Volume in the rig over volume at standard conditions; None where it is not known."""
        if self.temperature is None or self.pressure is None:
            return None
        cold = self.temperature / self.standard_temperature
        return cold * self.standard_pressure / self.pressure


def read_conditions(table: Mapping[str, Any], label: str) -> Conditions:
    """The table ``[conditions]``, checked; CampaignError names the key.

    >>> rig = read_conditions({"temperature": "21 degC", "pressure": "1.0 bar"}, "campaign.toml")
    >>> round(rig.expansion, 4)
    1.0911
    """
    where = f"{label}: [conditions]"
    for key in table:
        if key not in CONDITIONS:
            raise CampaignError(
                f"{where} unknown key '{key[:80]}'; expected one of {', '.join(CONDITIONS)}"
            )
    found: dict[str, float] = {}
    for key, value in table.items():
        try:
            found[key] = (_kelvin if "temperature" in key else _pascal)(value, key)
        except CampaignError as error:
            raise CampaignError(f"{where} {error}") from None
    stated = "standard_temperature" in found or "standard_pressure" in found
    return Conditions(**found, stated=stated)


def _kelvin(value: object, key: str) -> float:
    match = _TEMPERATURE.fullmatch(value.strip()) if isinstance(value, str) else None
    if match is None:
        raise CampaignError(
            f"{key}: expected a temperature with its unit (degC, K or degF), but got "
            f"'{str(value)[:60]}'; write for example {key} = \"21 degC\""
        )
    number = float(match[1])
    kelvin = number if match[2] else number + 273.15
    if match[4]:
        kelvin = (number - 32.0) / 1.8 + 273.15
    if not _COLDEST <= kelvin <= _HOTTEST:
        raise CampaignError(
            f"{key}: '{value}' is {kelvin - 273.15:.4g} degC, which no gas in a rig has; expected "
            f'the temperature of the gas: write for example {key} = "21 degC"'
        )
    return kelvin


def _pascal(value: object, key: str) -> float:
    pascal = read_quantity(value, _PRESSURE, key)
    if not pascal > 0:
        raise CampaignError(
            f"{key}: expected an absolute pressure above zero, but got '{value}'; where a gauge "
            'reads zero at ambient pressure, write that pressure, such as "1.0 bar"'
        )
    return pascal


def settle_all_flows(
    tables: Sequence[Mapping[str, Any]], conditions: Mapping[str, Any], label: str
) -> tuple[list[dict[str, Any]], list[str]]:
    """Every experiment's table with its flows in mL/s, and remarks on standard units.

    See :func:`settle_flows`, which raises CampaignError.
    """
    known = read_conditions(conditions, label)
    settled, said = [], []
    for number, table in enumerate(tables, 1):
        name = table.get("name")
        which = f"experiment '{name}'" if isinstance(name, str) else f"experiment number {number}"
        flows, how = settle_flows(table, known, f"{which} ({label})")
        settled.append(flows)
        said += [how] if how else []
    remarks = []
    if said and not known.stated:
        remarks.append(
            f"{label}: {said[0]}; makers differ, so write standard_temperature (0, 20 or 25 degC) "
            "in [conditions] as the flow controllers' manual says"
        )
    return settled, remarks


def settle_flows(
    table: Mapping[str, Any], conditions: Conditions, where: str
) -> tuple[dict[str, Any], str]:
    """An experiment's table with its two flows in mL/s, and how standard units were converted.

    The text is empty where the flows are volume flows.  A table without any of the keys
    :data:`FLOWS` and :data:`MIXTURE`, or with only one or two of :data:`FLOWS`, keeps them.

    >>> mixture = {"total_flow": "4.5 L/min", "concentration": "20 %"}
    >>> settle_flows(mixture, Conditions(), "experiment '1'")[0]
    {'carrier_flow': '60.0 mL/s', 'test_gas_flow': '15.0 mL/s'}

    Raises
    ------
    CampaignError
        If a flow is in standard units and the conditions are not known, a mixture is given in part,
        or the flows and the mixture contradict each other.
    """
    settled = dict(table)
    standard = [key for key in (*FLOWS, "total_flow") if is_standard(settled.get(key))]
    for key in standard:
        settled[key] = f"{_volume_flow(str(settled[key]), key, conditions, where)!r} mL/s"
    given = [key for key in MIXTURE if key in settled]
    if given:
        mixture = {key: settled.pop(key) for key in given}
        carrier, test_gas = _unmixed(mixture, table, where)
        if set(FLOWS) <= settled.keys():
            _compare(settled, mixture, table, where)
        else:
            settled["carrier_flow"] = f"{carrier!r} mL/s"
            settled["test_gas_flow"] = f"{test_gas!r} mL/s"
    if not standard:
        return settled, ""
    said = (
        f"a litre in {', '.join(standard)} was taken at "
        f"{conditions.standard_temperature - 273.15:.4g} degC and "
        f"{conditions.standard_pressure / 1e5:.6g} bar, and fills {conditions.expansion:.4g} L in "
        "the rig"
    )
    return settled, said


def _unmixed(
    mixture: Mapping[str, Any], table: Mapping[str, Any], where: str
) -> tuple[float, float]:
    """Carrier and test-gas flow (mL/s) of a total flow and a concentration."""
    missing = [key for key in MIXTURE if key not in mixture]
    alone = [key for key in FLOWS if key in table]
    if missing and len(alone) < 2:
        example = {"total_flow": '"4.5 L/min"', "concentration": '"11.1 %"'}[missing[0]]
        got = ", ".join([*mixture, *alone])
        raise CampaignError(
            f"{where}: got {got}; expected total_flow and concentration together, or "
            f"carrier_flow and test_gas_flow: add {missing[0]} = {example}"
            + (f" and remove {alone[0]}" if alone else "")
        )
    if len(alone) == 1:
        raise CampaignError(
            f"{where}: {', '.join([*mixture, *alone])} given; expected total_flow and "
            f"concentration, or carrier_flow and test_gas_flow: remove {alone[0]}"
        )
    total = _flow(mixture["total_flow"], "total_flow", where) if "total_flow" in mixture else 1.0
    share = _share(mixture["concentration"], where) if "concentration" in mixture else 0.5
    test_gas = total * share
    return float(f"{total - test_gas:.15g}"), float(f"{test_gas:.15g}")


def read_flow(value: object, key: str) -> float:
    """A flow (mL/s) that gas can have; CampaignError for any other."""
    flow = read_quantity(value, FLOW, key)
    if not flow > 0:
        raise CampaignError(
            f"{key}: expected a positive flow, but got '{value}'; give the flow that was set, such "
            f'as "{FLOW.example}"'
        )
    return flow


def _flow(value: object, key: str, where: str) -> float:
    try:
        return read_flow(value, key)
    except CampaignError as error:
        raise CampaignError(f"{where}: {error}") from None


def _share(value: object, where: str) -> float:
    key = "concentration"
    number = value if isinstance(value, int | float) and not isinstance(value, bool) else None
    if isinstance(value, str) and re.fullmatch(NUMBER, value.strip()):
        number = float(value)
    if number is not None:
        percent = f"{100 * number:.12g} %" if abs(number) < 1 else f"{number:.12g} %"
        raise CampaignError(
            f"{where}: {key}: expected a concentration with its unit (% or ppm), but got the bare "
            f'number {number:.12g}; write {key} = "{percent}"'
        )
    try:
        share = read_quantity(value, _SHARE, key)
    except CampaignError as error:
        raise CampaignError(f"{where}: {error}") from None
    if not 0 < share < 1:
        raise CampaignError(
            f"{where}: {key}: expected the share of the test gas in the total flow, between 0 and "
            f"100 %, but got '{value}'; write for example {key} = \"{_SHARE.example}\""
        )
    return share


def _compare(
    settled: Mapping[str, Any], mixture: Mapping[str, Any], table: Mapping[str, Any], where: str
) -> None:
    """Raise CampaignError where flows and mixture disagree by more than the digits written."""
    carrier, test_gas = (_flow(settled[key], key, where) for key in FLOWS)
    for key, told in (
        ("total_flow", carrier + test_gas),
        ("concentration", test_gas / (carrier + test_gas)),
    ):
        if key not in mixture:
            continue
        value = mixture[key]
        given = _share(value, where) if key == "concentration" else _flow(value, key, where)
        written = str(table[key])
        if abs(given - told) > _half_a_digit(written) * given + 1e-9 * given:
            shown = f"{100 * told:.4g} %" if key == "concentration" else f"{told * 0.06:.4g} L/min"
            raise CampaignError(
                f"{where}: {key} = '{written}', but carrier_flow and test_gas_flow make {shown}; "
                f"expected both to agree: correct one, or remove {key}"
            )


def _half_a_digit(text: str) -> float:
    """Half of the last written digit, as a share of the number."""
    match = re.match(r"\s*[+-]?(\d*)\.?(\d*)(?:[eE][+-]?\d+)?", text)
    digits = "" if match is None else match[1] + match[2]
    if match is not None and not match[2]:
        digits = digits.rstrip("0")  # the zeros of 5000 ppm may be none that were measured
    number = float(digits or 0)
    return 0.5 / number if number else 0.0


def is_standard(value: object) -> bool:
    """Whether a text is a flow in standard units.

    >>> is_standard("500 sccm"), is_standard("0.5 L/min")
    (True, False)
    """
    if not isinstance(value, str):
        return False
    return STANDARD_FLOW.fullmatch(re.sub(rf"^\s*{NUMBER}\s*", "", value).strip()) is not None


def _volume_flow(text: str, key: str, conditions: Conditions, where: str) -> float:
    """mL/s in the rig, of a flow in standard units."""
    expansion = conditions.expansion
    if expansion is None:
        missing = [k for k in ("temperature", "pressure") if getattr(conditions, k) is None]
        raise CampaignError(
            f"{where}: {key} = '{text[:60]}' is in standard units, which need the "
            f"{' and '.join(missing)} of the gas in the rig; expected them in [conditions]: "
            f"{_EXAMPLE}, or write the volume flow in the rig"
        )
    match = re.match(rf"\s*({NUMBER})\s*(.*?)\s*$", text)
    assert match is not None  # looked at by is_standard
    unit = match[2].casefold()
    per = "s" if unit == "sccs" else "min"
    small = re.match(r"scc|sml|nml|mln", unit) is not None
    factor = conversion_factor(f"{'mL' if small else 'L'}/{per}", "mL/s")
    assert factor is not None
    number = read_number(match[1])
    if number is None:
        raise CampaignError(
            f"{where}: {key} = '{text[:60]}' is out of range; write the flow that was set"
        )
    return float(f"{number * factor * expansion:.15g}")
