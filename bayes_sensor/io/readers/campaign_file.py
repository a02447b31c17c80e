"""The text of ``campaign.toml``: its keys, their kinds, and one message per mistake."""

from __future__ import annotations

import difflib
import re
from collections.abc import Sequence
from datetime import datetime
from datetime import time as clock_time
from typing import Annotated, Any, NamedTuple

from pydantic import BaseModel, BeforeValidator, ConfigDict, Field, ValidationError, ValidationInfo

from bayes_sensor.campaign import ORDERS, STAGES, ZIF8, CampaignError, SideInformation
from bayes_sensor.io.readers.flow_settings import MIXTURE, read_flow
from bayes_sensor.io.readers.quantities import (
    TIME,
    VOLUME,
    Kind,
    in_range,
    read_number,
    read_quantity,
    read_spread,
    unit_text,
)
from bayes_sensor.io.readers.stamps import Moment, read_moment
from bayes_sensor.names import acts_on_its_surroundings, appearance
from bayes_sensor.rig.rig import Rig

Span = tuple[float | Moment, float | Moment]

SHARE = Kind("a concentration", "dimensionless", "5 %")

_EXAMPLES = {
    "name": 'name = "1"',
    "file": 'file = "exp1.csv"',
    "carrier_flow": 'carrier_flow = "4.0 L/min"',
    "test_gas_flow": 'test_gas_flow = "0.5 L/min"',
    "commanded_on": 'commanded_on = "24.0 s"',
    "commanded_off": 'commanded_off = "83.6 s"',
    "signal": 'signal = "A"',
    "drive": 'drive = "B"',
    "signal_unit": 'signal_unit = "V"',
    "keep": 'keep = ["0 s", "120 s"]',
    "mask": 'mask = [["6.3 s", "7.2 s"]]',
    "time": 'time = "UTCTIME"',
    "interval": 'interval = "1 ms"',
    "duration": 'duration = "120 s"',
    "title": 'title = "seven step experiments"',
    "allow_outside": "allow_outside = true",
    "coating": 'coating = "zif8"',
    "experiment": '[[experiment]] with name = "1" and its keys',
    "side_information": '[side_information] with V = "60 +- 2 mL"',
    "steps": 'steps = [{at = "10 s", to = "5 %"}, {at = "70 s", to = "0 %"}]',
    "delays": 'delays = "shared"',
    "signals": 'signals = {A = "column 1", B = "column 2"}',
    "input": 'input = "C"',
    "rig": '[rig] with sensor_is = "faster"',
    "stages": 'stages = ["valve", "manifold", "sensor"]',
    "sensor_is": 'sensor_is = "faster"',
    "tie": 'tie = {"tau[B]" = "tau[A]"}',
    "conditions": '[conditions] with temperature = "21 degC" and pressure = "1.0 bar"',
}


def _key(info: ValidationInfo) -> str:
    return info.field_name or "value"


def _flow(value: object, info: ValidationInfo) -> float:
    return read_flow(value, _key(info))


def _time(value: object, info: ValidationInfo) -> float:
    return read_quantity(value, TIME, _key(info))


def _clock(value: object, info: ValidationInfo) -> float | Moment:
    """A time in s, or a place on the recorder's own clock."""
    if isinstance(value, datetime | clock_time):  # TOML has these without quotes
        value = value.isoformat()
    if isinstance(value, str):
        moment = read_moment(value)
        if moment is not None:
            return moment
    return _time(value, info)


def _clocks(value: object, info: ValidationInfo) -> float | Moment | tuple[float | Moment, ...]:
    """One time, or a list of them: a pulse train."""
    if not isinstance(value, list):
        return _clock(value, info)
    if not value:
        raise CampaignError(
            f"{_key(info)}: expected a time or a list of times, but got an empty list; leave the "
            "key out where nothing was commanded"
        )
    return tuple(_clock(each, info) for each in value)


class StepTable(NamedTuple):
    """One step of a staircase: when, s or on the recorder's clock, and to which share."""

    at: float | Moment
    to: float
    percent: bool


def _steps(value: object, info: ValidationInfo) -> tuple[StepTable, ...]:
    key = _key(info)
    fix = f"write for example {_EXAMPLES[key]}"
    if not isinstance(value, list) or not value:
        raise CampaignError(f"{key}: expected a list of steps, but got {_shorten(value)}; {fix}")
    found = []
    for each in value:
        if not isinstance(each, dict) or each.keys() != {"at", "to"}:
            raise CampaignError(
                f"{key}: expected each step as {{at = .., to = ..}}, but got {_shorten(each)}; "
                f"{fix}"
            )
        level, percent = _level(each["to"], key, fix)
        found.append(StepTable(_clock(each["at"], info), level, percent))
    if len({step.percent for step in found if step.to != 0.0}) > 1:
        raise CampaignError(
            f"{key}: expected all steps in % (or ppm) or all as shares from 0 to 1, but got both; "
            f"{fix}"
        )
    return tuple(found)


def _level(value: object, key: str, fix: str) -> tuple[float, bool]:
    """The share of a step's ``to``, and whether it was written with a unit."""
    if isinstance(value, int | float) and not isinstance(value, bool):
        share, percent = float(value), False
    elif isinstance(value, str) and (number := read_number(value)) is not None:
        share, percent = number, False
    else:
        share, percent = read_quantity(value, SHARE, f"{key}: to"), True
    if not (0.0 <= share <= 1.0 and in_range(share)):
        raise CampaignError(
            f"{key}: expected a concentration between 0 and 100 %, or a share from 0 to 1, but got "
            f"{_shorten(value)}; {fix}"
        )
    return share, percent


def _delays(value: object, info: ValidationInfo) -> str | None:
    if value not in ("free", "shared"):
        raise CampaignError(
            f'delays: expected "free" (each switch has a time of its own) or "shared" (one start '
            f"and one end delay for the record), but got {_shorten(value)}; correct it"
        )
    return str(value)


def _signals(value: object, info: ValidationInfo) -> dict[str, str]:
    key = _key(info)
    if not isinstance(value, dict) or not value:
        raise CampaignError(
            f"{key}: expected the column of each sensor by its name, but got {_shorten(value)}; "
            f"write for example {_EXAMPLES[key]}"
        )
    for name in value:
        if not appearance(name) or acts_on_its_surroundings(name) or any(c in name for c in "[],"):
            raise CampaignError(
                f"{key}: expected a name without brackets and commas for each sensor, but got "
                f"'{name[:40]}'; rename it"
            )
    if len({appearance(name) for name in value}) < len(value):
        raise CampaignError(
            f"{key}: expected a name of its own for each sensor, but two look the same in "
            f"{_shorten(list(value))}; rename one"
        )
    return {name: _plain_text(column, info) for name, column in value.items()}


def _positive_time(value: object, info: ValidationInfo) -> float:
    time = _time(value, info)
    if time <= 0:
        raise CampaignError(
            f"{_key(info)}: expected a positive time, but got '{value}'; "
            f"write for example {_EXAMPLES[_key(info)]}"
        )
    return time


def _range(value: object, info: ValidationInfo) -> tuple[float | Moment, float | Moment]:
    key = _key(info)
    if not isinstance(value, list) or len(value) != 2:
        raise CampaignError(
            f"{key}: expected two times, start and end, but got {_shorten(value)}; "
            f"write for example {_EXAMPLES[key]}"
        )
    try:
        start, end = _clock(value[0], info), _clock(value[1], info)
    except CampaignError as error:
        problem = str(error).split("; write ")[0]
        raise CampaignError(f"{problem}; write for example {_EXAMPLES[key]}") from None
    if not isinstance(start, Moment) and not isinstance(end, Moment) and not start < end:
        raise CampaignError(
            f"{key}: expected the start before the end, but got {_shorten(value)}; swap them"
        )
    return start, end


def _ranges(value: object, info: ValidationInfo) -> tuple[Span, ...]:
    key = _key(info)
    if not isinstance(value, list) or not all(isinstance(part, list) for part in value):
        raise CampaignError(
            f"{key}: expected a list of pairs of times, but got {_shorten(value)}; "
            f"write for example {_EXAMPLES[key]}"
        )
    return tuple(_range(part, info) for part in value)


def _plain_text(value: object, info: ValidationInfo) -> str:
    key = _key(info)
    if not isinstance(value, str):
        if isinstance(value, bool | int | float):
            fix = f'{key} = "{value}"'
        else:
            fix = _EXAMPLES[key]
        raise CampaignError(
            f"{key}: expected text in quotes, but got {_shorten(value)}; write {fix}"
        )
    if not appearance(value) or len(value) > 1000:
        raise CampaignError(
            f"{key}: expected 1 to 1000 characters, but got {len(value)}"
            f"{' (none that can be seen)' if value and not appearance(value) else ''}; "
            f"write for example {_EXAMPLES[key]}"
        )
    if acts_on_its_surroundings(value):
        fix = "remove them"
        if key == "file" and re.search(r"[\a\b\t\n\f\r\x1b]", value):
            fix = "in double quotes \\t, \\n and their like are such: write / between folders"
        raise CampaignError(
            f"{key}: expected plain text, but {value!r:.80} holds control characters; {fix}"
        )
    return value


def _unit(value: object, info: ValidationInfo) -> str:
    text = _plain_text(value, info)
    try:
        return unit_text(text)
    except CampaignError as error:
        raise CampaignError(f"{_key(info)}: {error}") from None


Text = Annotated[str, BeforeValidator(_plain_text)]
Flow = Annotated[float, BeforeValidator(_flow)]
OnClocks = Annotated[float | Moment | tuple[float | Moment, ...], BeforeValidator(_clocks)]
PositiveTime = Annotated[float, BeforeValidator(_positive_time)]


class ExperimentTable(BaseModel):
    """One ``[[experiment]]``: flows in mL/s, times in s or on the recorder's clock."""

    model_config = ConfigDict(extra="forbid", frozen=True, strict=True)

    name: Text
    file: Text | None = None
    carrier_flow: Flow | None = None
    test_gas_flow: Flow | None = None
    commanded_on: OnClocks | None = None
    commanded_off: OnClocks | None = None
    steps: Annotated[tuple[StepTable, ...], BeforeValidator(_steps)] = ()
    delays: Annotated[str | None, BeforeValidator(_delays)] = None
    signal: Text | None = None
    signals: Annotated[dict[str, str], BeforeValidator(_signals)] = Field(default_factory=dict)
    drive: Text | None = None
    input: Text | None = None
    time: Text | None = None
    signal_unit: Annotated[str, BeforeValidator(_unit)] | None = None
    keep: Annotated[Span, BeforeValidator(_range)] | None = None
    mask: Annotated[tuple[Span, ...], BeforeValidator(_ranges)] = ()
    interval: PositiveTime | None = None
    duration: PositiveTime | None = None


def _stages(value: object, info: ValidationInfo) -> tuple[str, ...]:
    if not isinstance(value, list) or not all(isinstance(each, str) for each in value):
        raise CampaignError(
            f"stages: expected a list of what the gas passes, in order, but got {_shorten(value)}; "
            f"write for example {_EXAMPLES['stages']}"
        )
    Rig.parse(value)
    return tuple(value)


def _order(value: object, info: ValidationInfo) -> str:
    if value not in ORDERS:
        raise CampaignError(
            f"sensor_is: expected one of {', '.join(ORDERS)}, among the lags that do not depend "
            f"on flow, but got {_shorten(value)}; write for example {_EXAMPLES['sensor_is']}"
        )
    return str(value)


class RigTable(BaseModel):
    """``[rig]``: the stages that the gas passes, which of the lags is the sensor's, and what is
    tied."""

    model_config = ConfigDict(extra="forbid", frozen=True, strict=True)

    stages: Annotated[tuple[str, ...] | None, BeforeValidator(_stages)] = None
    sensor_is: Annotated[str, BeforeValidator(_order)] = "unknown"
    tie: dict[str, str] = Field(default_factory=dict)


def _coating(value: object) -> str:
    if value != ZIF8:
        raise CampaignError(
            f"coating: expected '{ZIF8}', the only one that is modelled, but got "
            f"{_shorten(value)}; leave the key out for any other coating"
        )
    return ZIF8


class Sheet(BaseModel):
    """The top level of a campaign file, with its tables as written."""

    model_config = ConfigDict(extra="forbid", frozen=True, strict=True)

    title: Text = "untitled campaign"
    allow_outside: bool = False
    coating: Annotated[str, BeforeValidator(_coating)] = ""
    rig: dict[str, Any] = Field(default_factory=dict)
    side_information: dict[str, Any] = Field(default_factory=dict)
    conditions: dict[str, Any] = Field(default_factory=dict)
    experiment: list[dict[str, Any]] = Field(min_length=1)


def read_sheet(tables: dict[str, Any], label: str) -> Sheet:
    """The top level, checked; CampaignError names the key."""
    try:
        return Sheet.model_validate(tables)
    except ValidationError as error:
        raise CampaignError(f"{label}: {_first_problem(error, Sheet)}") from None


def read_entry(table: dict[str, Any], number: int, label: str) -> ExperimentTable:
    """One experiment, checked; CampaignError names it and the key."""
    name = table.get("name")
    which = f"experiment '{name}'" if isinstance(name, str) else f"experiment number {number}"
    try:
        return ExperimentTable.model_validate(table)
    except ValidationError as error:
        raise CampaignError(
            f"{which} ({label}): {_first_problem(error, ExperimentTable)}"
        ) from None


def read_rig(table: dict[str, Any], label: str) -> RigTable:
    """The rig, checked; CampaignError names the key."""
    try:
        return RigTable.model_validate(table)
    except ValidationError as error:
        raise CampaignError(f"{label}: [rig] {_first_problem(error, RigTable)}") from None


def side_information_keys(
    stages: Sequence[str], sensors: Sequence[str] = ()
) -> dict[str, tuple[str, Kind]]:
    """Flat parameter name and kind of every key of side information.

    ``stages``: the rig's; ``sensors``: their names where there are several.
    """
    known: dict[str, tuple[str, Kind]] = {}
    for name in Rig.parse(stages).names:
        key, _, unit = name.rpartition("_")
        kind = VOLUME if unit == "mL" else Kind("a time", "s", "48 ms")
        if name == "tau_s" and sensors:
            known |= {f"{key}[{each}]": (f"{name}[{each}]", kind) for each in sensors}
        else:
            known[key] = name, kind
    return known


def read_side_information(
    table: dict[str, Any], label: str, stages: Sequence[str] = STAGES, sensors: Sequence[str] = ()
) -> dict[str, SideInformation]:
    """Parameters measured elsewhere, by flat parameter name and in its unit.

    See :func:`side_information_keys`.
    """
    known = side_information_keys(stages, sensors)
    found = {}
    for key, value in table.items():
        where = f"{label}: [side_information]"
        if key not in known:
            raise CampaignError(f"{where} {_unknown(key, list(known))}")
        name, kind = known[key]
        try:
            found[name] = SideInformation(*read_spread(value, kind, key))
        except CampaignError as error:
            raise CampaignError(f"{where} {error}") from None
    return found


def _unknown(key: str, known: list[str]) -> str:
    close = difflib.get_close_matches(key.casefold(), known, n=1, cutoff=0.5)
    hint = f'write "{close[0]}"' if close else f"known are {', '.join(known)}"
    return f"unknown key '{key[:80]}'; expected one that is known: {hint}"


def _first_problem(error: ValidationError, model: type[BaseModel]) -> str:
    """The sentence for the most useful of pydantic's errors: a misspelt key before a missing
    one."""
    problems = error.errors(include_url=False)
    rank = {"extra_forbidden": 0, "value_error": 1}
    first = min(problems, key=lambda problem: rank.get(problem["type"], 2))
    key = str(first["loc"][0]) if first["loc"] else ""
    if first["type"] == "extra_forbidden":
        return _unknown(key, [*model.model_fields, *(MIXTURE if model is ExperimentTable else ())])
    if first["type"] == "value_error":
        return str(first["ctx"]["error"])
    example = _EXAMPLES.get(key, key)
    if first["type"] == "missing":
        return f"the key {key} is missing; add {example}"
    if first["type"] == "too_short":
        return f"expected at least one experiment, but there is none; add {example}"
    if key == "experiment" and isinstance(first["input"], dict):
        return "experiment: expected [[experiment]], but got [experiment]; double the brackets"
    return f"{key}: expected {example}, but got {_shorten(first['input'])}; correct it"


def _shorten(value: object, longest: int = 60) -> str:
    text = f"'{value}'" if isinstance(value, str) else str(value)
    return text if len(text) <= longest else text[: longest - 3] + "..."
