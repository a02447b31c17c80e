"""A campaign of what is in memory, with the keys of ``campaign.toml`` as keywords."""

from __future__ import annotations

import difflib
from collections.abc import Mapping, Sequence
from dataclasses import replace
from datetime import datetime, timedelta
from pathlib import Path
from typing import Any

import numpy as np

from bayes_sensor.campaign import Campaign, CampaignError, SideInformation
from bayes_sensor.io.readers.assembly import assemble
from bayes_sensor.io.readers.campaign_file import (
    ExperimentTable,
    read_entry,
    read_rig,
    read_sheet,
    read_side_information,
    side_information_keys,
)
from bayes_sensor.io.readers.flow_settings import MIXTURE, settle_all_flows
from bayes_sensor.io.readers.frame import (
    columns_of,
    content_of_columns,
    is_frame,
    recording_of_frame,
)
from bayes_sensor.io.readers.joined import by_sensor, join, one_line
from bayes_sensor.io.readers.quantities import Kind
from bayes_sensor.io.readers.recording import DataFile, Selection

LABEL = "from_frames"
"""what stands for the file in messages"""
UNITS = {
    "carrier_flow": "mL/s", "test_gas_flow": "mL/s", "total_flow": "mL/s", "commanded_on": "s",
    "commanded_off": "s", "keep": "s", "mask": "s", "interval": "s", "at": "s",
}  # fmt: skip
"""of plain numbers, by key; ``concentration`` is a share between 0 and 1"""
WHOLE = ("keep", "mask", "steps", "stages")
"""keys whose value is a list: one for each experiment is given as a mapping of names"""
_NOT_HERE = {
    "name": "give frames as a mapping of names",
    "file": "read_campaign reads files",
    "duration": "a design is a campaign.toml without files",
    "allow_outside": "leave it out",
}
_OF_RIG = ("stages", "sensor_is", "tie")


def campaign_from_frames(frames: Any, keys: Mapping[str, Any]) -> Campaign:
    """What :meth:`bayes_sensor.Campaign.from_frames` returns."""
    by_name = _named(frames)
    keys = dict(keys)
    for key in keys:
        if key in _NOT_HERE:
            raise CampaignError(
                f"{LABEL}: {key} is a key of campaign.toml that data in memory do not have; "
                f"{_NOT_HERE[key]}"
            )
    head: dict[str, Any] = {k: keys.pop(k) for k in ("title", "conditions") if k in keys}
    rig = {**keys.pop("rig", {}), **{key: keys.pop(key) for key in _OF_RIG if key in keys}}
    rig = {key: list(v) if isinstance(v, tuple) else v for key, v in rig.items()}
    given = keys.pop("side_information", {})

    def known(stages: Sequence[str], sensors: Sequence[str]) -> dict[str, SideInformation]:
        texts, records = _side_information(given, side_information_keys(stages, sensors))
        return {**read_side_information(texts, LABEL, stages, sensors), **records}

    _check_keys(keys)
    tables = [{"name": name} for name in by_name]
    for key, value in keys.items():
        for table, own in zip(tables, _for_each(key, value, list(by_name)), strict=True):
            if own is not None:
                table[key] = _as_text(key, own)
    try:
        sheet = read_sheet({**head, "experiment": tables}, LABEL)
        settled, warnings = settle_all_flows(sheet.experiment, sheet.conditions, LABEL)
        entries = [read_entry(table, i, LABEL) for i, table in enumerate(settled, 1)]
        experiments, units = [], []
        for entry, frame in zip(entries, by_name.values(), strict=True):
            where = f"experiment '{entry.name}'"
            columns, offsets = columns_of(frame, where)
            file = DataFile(Path(), where, content_of_columns(columns))
            for own, record, sensor in by_sensor(entry):
                channel = own.drive or own.input
                if own.signal is None and channel is None and "drive" in columns:
                    channel = "drive"
                selection = Selection(own.signal, channel, own.time, own.interval)
                with np.errstate(over="ignore", invalid="ignore"):
                    recording = recording_of_frame(columns, offsets, file, selection)
                    # numbers without a unit are seconds, as everywhere in Python
                    done = assemble(own, file, replace(recording, timed=True))
                made = replace(done.experiment, source="", record=record, sensor=sensor)
                experiments.append(made)
                units.append((own.name, done.unit))
                warnings = [*warnings, *(t for t in done.warnings if t not in warnings)]
        return join(sheet.title, experiments, units, warnings, read_rig(rig, LABEL), known, LABEL)
    except CampaignError as error:
        raise CampaignError(one_line(str(error))) from None


def _check_keys(keys: Mapping[str, Any]) -> None:
    known = [key for key in (*ExperimentTable.model_fields, *MIXTURE) if key not in _NOT_HERE]
    known += [*_OF_RIG, "rig", "title", "conditions", "side_information"]
    for key in keys:
        if key not in known:
            close = difflib.get_close_matches(key, known, n=1, cutoff=0.5)
            hint = f"write {close[0]}" if close else f"known are {', '.join(known)}"
            raise CampaignError(
                f"{LABEL}: unknown keyword '{key[:80]}'; expected a key of campaign.toml: {hint}"
            )


def _named(frames: Any) -> dict[str, Any]:
    """Frames by experiment; one alone is experiment 1."""
    if is_frame(frames):
        return {"1": frames}
    if isinstance(frames, Mapping) and frames:
        found = {str(name): frame for name, frame in frames.items()}
        if len(found) < len(frames):
            raise CampaignError(f"{LABEL}: two experiments have one name; rename one")
        return found
    if isinstance(frames, list) and frames and not all(np.ndim(v) == 0 for v in frames):
        return {str(i): frame for i, frame in enumerate(frames, 1)}
    empty = isinstance(frames, Mapping | list) and not frames
    got = "none" if empty else f"a {type(frames).__name__}"
    raise CampaignError(
        f"{LABEL}: expected frames by the name of their experiment, but got {got}; give "
        "{'1': frame}, where a frame is a pandas DataFrame, a mapping of arrays or a tuple (t, y)"
    )


def _for_each(key: str, value: Any, names: Sequence[str]) -> list[Any]:
    """The value of every experiment: its own of a mapping or a list, else the same for all."""
    if isinstance(value, Mapping):
        given = {str(name): own for name, own in value.items()}
        unknown = [name for name in given if name not in names]
        if unknown and len(unknown) == len(given) and key in ("signals",):
            return [dict(value)] * len(names)
        if unknown:
            raise CampaignError(
                f"{LABEL}: {key}: there is no experiment '{unknown[0][:80]}'; expected values by "
                f"the names {', '.join(names)}"
            )
        return [given.get(name) for name in names]
    if isinstance(value, np.ndarray | list | tuple) or type(value).__name__ == "Series":
        many = list(value)
        if key in WHOLE:
            return [many] * len(names)
        if len(many) == len(names):
            return many
        if len(names) == 1:
            return [many]
        raise CampaignError(
            f"{LABEL}: {key}: expected one value for each of the {len(names)} experiments, but got "
            f"{len(many)}; give as many, or a mapping by the names {', '.join(names)}"
        )
    return [value] * len(names)


def _as_text(key: str, value: Any) -> Any:
    """A number as the text that campaign.toml would have, with the unit that it is in."""
    if isinstance(value, timedelta):
        return f"{value.total_seconds()!r} s"
    if isinstance(value, np.timedelta64):
        return f"{value / np.timedelta64(1, 's')!r} s"
    if isinstance(value, datetime):  # pandas' Timestamp, too
        return value.isoformat(sep=" ")
    if isinstance(value, np.datetime64):
        return str(value)
    if isinstance(value, np.generic):
        value = value.item()
    if isinstance(value, np.ndarray | list | tuple):
        return [_as_text(key, part) for part in value]
    if isinstance(value, Mapping):
        return {str(inner): _as_text(str(inner), part) for inner, part in value.items()}
    if isinstance(value, bool) or not isinstance(value, int | float):
        return value
    if key == "concentration":
        if not 0 < value < 1:
            raise CampaignError(
                f"{LABEL}: concentration: expected a share between 0 and 1, or a text with its "
                f'unit, but got {value!r}; write "{value!r} %" or "{value!r} ppm"'
            )
        return f"{100.0 * value:.15g} %"
    unit = UNITS.get(key)
    return value if unit is None else f"{value!r} {unit}"


def _side_information(
    given: Mapping[str, Any], known: Mapping[str, tuple[str, Kind]]
) -> tuple[dict[str, Any], dict[str, SideInformation]]:
    """Texts by key of campaign.toml, and records by flat name."""
    texts: dict[str, Any] = {}
    records: dict[str, SideInformation] = {}
    for key, value in given.items():
        name = known[key][0] if key in known else None
        if isinstance(value, SideInformation) and name is not None:
            records[name] = value
        elif isinstance(value, tuple | list) and len(value) == 2 and name is not None:
            texts[key] = f"{value[0]} +- {value[1]} {known[key][1].unit}"
        else:
            texts[key] = value
    return texts, records
