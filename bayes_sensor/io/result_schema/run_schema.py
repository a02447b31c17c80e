"""run.json: what each command was run with."""

from __future__ import annotations

from typing import Annotated, Any, Literal, NotRequired

from pydantic import AfterValidator, StrictBool
from typing_extensions import TypedDict

from bayes_sensor.io.result_schema.schema_types import (
    Hash,
    Int,
    MaybeNum,
    Name,
    NotNegative,
    Num,
    Seed,
    Share,
    Text,
    Texts,
    Unit,
    fail,
)

Setting = StrictBool | int | Num | Text | None
Settings = dict[Text, Setting | list[Any] | dict[Text, Any]]


def _flat_settings(settings: Any) -> Any:
    """Settings are nested in tables only; a list holds plain values or lists of such."""

    def plain(value: Any) -> bool:
        if isinstance(value, list):
            return all(plain(each) for each in value)
        return not isinstance(value, dict)

    for value in settings.values():
        if isinstance(value, dict):
            _flat_settings(value)
        elif not plain(value):
            raise fail("a table in a list of settings")
    noise = settings.get("noise")
    if not isinstance(noise, dict | None):
        raise fail("noise: a table of settings was expected")
    return settings


class Command(TypedDict):
    started: Text
    finished: Text
    seconds: dict[Text, NotNegative]
    exit_code: Int
    converged: StrictBool
    seed: Seed
    settings: Annotated[Settings, AfterValidator(_flat_settings)] | None
    campaign: Text
    files_sha256: dict[Text, Text]
    basis_sha256: Text
    versions: dict[Text, Text]
    command_line: Texts
    warnings: Texts
    steps: NotRequired[list[Name]]


def _newest_is_there(run: Any) -> Any:
    if run["last"] not in run["commands"]:
        raise fail(f"last: '{run['last'][:60]}' is none of the commands")
    return run


class _Run(TypedDict):
    version: Literal[1]
    last: Name
    commands: dict[Name, Command]
    written_sha256: NotRequired[dict[Name, Hash]]


Run = Annotated[_Run, AfterValidator(_newest_is_there)]


# ----------------------------------------------------------------- fleets, locks, stages


class FleetRow(TypedDict):
    campaign: Name
    file: Text
    title: Text
    status: Literal["done", "not converged"]
    message: Text
    experiments: Int
    samples: Int
    signal_unit: Unit
    tau_s: MaybeNum
    tau_sd_s: NotNegative | None
    tau_lo95_s: MaybeNum
    tau_hi95_s: MaybeNum
    tau_lo68_s: MaybeNum
    tau_hi68_s: MaybeNum
    tau_upper95_s: MaybeNum
    tau_is_limit: StrictBool | None
    gap: Text | None
    gap_effects: Text | None
    gap_probability: Share | None
    report: Text
    order: Literal["given", "decided", "undecided"] | None
    lag_fast_s: MaybeNum
    lag_slow_s: MaybeNum


class Outcome(TypedDict):
    row: FleetRow
    cost: dict[Name, Num | Text]
    key: Text
    files: dict[Name, Hash]


class Owner(TypedDict):
    pid: Int
    host: Text
    since: NotRequired[Text]
    command: NotRequired[Text]


Dropped = list[Name]


class Chunks(TypedDict):
    digest: Text


class Study(TypedDict):
    key: Text
    chunk: Int
    code: Text
