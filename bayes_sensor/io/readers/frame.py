"""Recordings that are in memory: data frames, mappings and tuples of arrays, xarray."""

from __future__ import annotations

import hashlib
from collections.abc import Mapping
from dataclasses import replace
from datetime import datetime, timedelta
from typing import Any

import numpy as np
from numpy.typing import NDArray

from bayes_sensor.campaign import CampaignError
from bayes_sensor.io.readers.recording import (
    Clock,
    Column,
    DataFile,
    Recording,
    Selection,
    channel_names,
    check_counts,
    is_time,
    several_times,
    split_name,
)
from bayes_sensor.io.readers.roles import Facts, choose_roles
from bayes_sensor.io.readers.sampling import grid_times
from bayes_sensor.io.readers.table import MOST_EMPTY, SAMPLED, number_times

VECTORS = ("t", "y", "drive")
"""what the arrays of a tuple are"""
_GIVE = (
    "give a pandas DataFrame, a mapping of names to arrays such as {'t': t, 'y': y}, a tuple "
    "(t, y) or (t, y, drive) of arrays, or an xarray Dataset"
)


def columns_of(frame: Any, where: str) -> tuple[dict[str, NDArray[Any]], dict[str, int]]:
    """The columns of a frame as arrays (n,), times first where they are its index, and the offset
    from UTC (ns) at the first time of those that have a zone; they are in UTC.

    What is masked in a masked array is nan.

    >>> list(columns_of((np.arange(3.0), np.ones(3)), "experiment '1'")[0])
    ['t', 'y']

    Raises
    ------
    CampaignError
        If it is nothing that holds columns of one length.
    """
    columns = _columns(frame, where)
    found: dict[str, NDArray[Any]] = {}
    offsets: dict[str, int] = {}
    for name, values in columns.items():
        if isinstance(values, np.ma.MaskedArray) and values.dtype.kind in "biuf":
            values = np.ma.filled(values.astype(float), np.nan)
        if getattr(getattr(values, "dtype", None), "tz", None) is not None:
            there = values[values.notna()]
            if len(there):
                offsets[str(name)] = offset_of(there.iloc[0])
            values = values.dt.tz_convert("UTC").dt.tz_localize(None)
        array = np.asarray(values)
        if array.dtype.kind == "O":
            array = _of_objects(array)
        if array.ndim != 1:
            raise CampaignError(
                f"{where}: '{str(name)[:60]}' has shape {array.shape}; expected one dimension: "
                "give a vector"
            )
        found[str(name)] = array
    lengths = {len(array) for array in found.values()}
    if len(lengths) > 1:
        told = ", ".join(f"'{name[:40]}' {len(array)}" for name, array in found.items())
        raise CampaignError(f"{where}: expected vectors of one length, but got {told}")
    if not found or lengths == {0}:
        raise CampaignError(f"{where}: expected samples, but there are none; {_GIVE}")
    return found, offsets


def offset_of(moment: datetime) -> int:
    """ns, the offset from UTC of a time; 0 where it has no zone."""
    return (moment.utcoffset() or timedelta()) // timedelta(microseconds=1) * 1000


def is_frame(thing: Any) -> bool:
    """Whether it is the samples of one experiment rather than several by name.

    >>> is_frame({"t": [0.0, 1.0], "y": [0.1, 0.2]}), is_frame({"1": ([0.0, 1.0], [0.1, 0.2])})
    (True, False)
    """
    if type(thing).__module__.partition(".")[0] in ("pandas", "xarray"):
        return True
    if isinstance(thing, Mapping):
        return any(is_time(split_name(str(name))) for name in thing)
    return isinstance(thing, tuple) and len(thing) in (2, 3) and _vectors(thing)


def _columns(frame: Any, where: str) -> Mapping[Any, Any]:
    family = type(frame).__module__.partition(".")[0]
    if family == "xarray":
        return _columns(_table_of_xarray(frame, where), where)
    if family != "pandas" and hasattr(frame, "to_pandas"):
        frame = frame.to_pandas()
    if type(frame).__module__.partition(".")[0] == "pandas":
        return _columns_of_pandas(frame, where)
    if isinstance(frame, Mapping):
        return frame
    if isinstance(frame, tuple | list) and len(frame) in (2, 3) and _vectors(frame):
        return dict(zip(VECTORS, frame, strict=False))
    if isinstance(frame, np.ndarray) and frame.ndim == 1 and frame.dtype.kind in "biuf":
        return {"y": frame}
    raise CampaignError(f"{where}: expected samples, but got a {type(frame).__name__}; {_GIVE}")


def _vectors(parts: Any) -> bool:
    return all(isinstance(part, np.ndarray | list) and np.ndim(part) == 1 for part in parts)


def _table_of_xarray(frame: Any, where: str) -> Any:
    if len(frame.dims) != 1:
        raise CampaignError(
            f"{where}: the xarray object has the dimensions {', '.join(map(str, frame.dims))}; "
            "expected one, of the samples: select a record first"
        )
    if hasattr(frame, "to_dataset"):
        frame = frame.to_dataset(name=frame.name or "y")
    return frame.to_dataframe()


def _columns_of_pandas(frame: Any, where: str) -> dict[str, Any]:
    if not hasattr(frame, "columns"):  # a Series
        frame = frame.to_frame(frame.name or "y")
    names = [str(name) for name in frame.columns]
    repeated = next((name for name in names if names.count(name) > 1), None)
    if repeated is not None:
        raise CampaignError(
            f"{where}: expected each column once, but '{repeated[:60]}' is in the frame "
            f"{names.count(repeated)} times; give each column its own name"
        )
    columns = {name: _plain_values(frame.iloc[:, i]) for i, name in enumerate(names)}
    index = frame.index
    counts = type(index).__name__ == "RangeIndex"
    timed = any(is_time(split_name(name)) or columns[name].dtype.kind in "Mm" for name in names)
    if counts or (timed and index.name is None) or str(index.name) in names:
        return columns
    values = _plain_values(index.to_series())
    if getattr(values.dtype, "kind", "O") not in "Mmiuf":
        return columns
    return {str(index.name or "time"): values, **columns}


def _plain_values(series: Any) -> Any:
    """Numbers as floats or whole numbers; times with a zone stay a series."""
    if getattr(series.dtype, "tz", None) is not None:
        return series
    kind = getattr(series.dtype, "kind", "O")
    if kind in "Mm":
        return np.asarray(series.to_numpy())
    if kind in "iufb" and series.isna().any():
        return np.asarray(series.to_numpy(dtype=float, na_value=np.nan))
    return np.asarray(series.to_numpy())


def _of_objects(array: NDArray[Any]) -> NDArray[Any]:
    """Numbers that are kept as objects as floats; what is none stays as it is."""
    try:
        return np.asarray(array, dtype=float)
    except (TypeError, ValueError):
        return array


def recording_of_frame(
    columns: Mapping[str, NDArray[Any]],
    offsets: Mapping[str, int],
    file: DataFile,
    selection: Selection,
) -> Recording:
    """The recording of columns with their ``offsets`` (see :func:`columns_of`); ``file`` stands for
    them in messages.

    Raises
    ------
    CampaignError
        If a column is missing, or is no number.
    """
    names = list(columns)
    values = list(columns.values())
    check_counts(file, len(names), len(values[0]))
    facts = [_facts(name, array) for name, array in columns.items()]
    roles = choose_roles(file, facts, selection)
    signal, drive = roles.signal, roles.drive
    for i in (signal, drive):
        if i is not None and facts[i].kind != "number":
            raise file.error(
                f"column '{names[i][:60]}' has the type {values[i].dtype}; expected numbers"
            )
    y = np.asarray(values[signal], dtype=float)
    notes = list(roles.notes)
    keep, note = _own_rows(y, facts, values, signal, roles.times)
    notes += [note] if note else []
    clock: Clock | None = None
    interval = None
    if not roles.times:
        assert selection.interval is not None  # choose_roles sees to it
        interval = selection.interval if keep.all() else None
        t = grid_times(0.0, selection.interval, len(y))[keep]
    else:
        time = roles.times[0]
        if facts[time].kind not in ("stamp", "number"):
            raise file.error(
                f"column '{names[time][:60]}' has the type {values[time].dtype}; expected times: "
                "numbers in s, datetime64 or timedelta64"
            )
        t, clock, remark = number_times(file, facts[time].column, values[time][keep])
        if clock is not None:
            clock = replace(clock, offset=offsets.get(names[time], 0))
        notes += [remark] if remark else []
    rows = np.flatnonzero(keep)
    return Recording(
        t=t,
        y=y[keep],
        signal=names[signal],
        place=lambda i: f"row {int(rows[i]) + 1}",
        drive=None if drive is None else np.asarray(values[drive], dtype=float)[keep],
        drive_name="" if drive is None else names[drive],
        unit=facts[signal].column.unit,
        interval=interval,
        clock=clock,
        timed=not roles.times or bool(facts[roles.times[0]].column.unit),
        notes=tuple(notes),
        channels=channel_names(names, roles.channels),
        times=several_times(names, roles.times),
    )


def _facts(name: str, array: NDArray[Any]) -> Facts:
    column = split_name(name)
    if array.dtype.kind in "Mm":
        return Facts(column, "stamp", np.empty(0))
    if array.dtype.kind in "biuf":
        some = np.asarray(array[:SAMPLED], dtype=float)
        some = some[np.isfinite(some)]
        there = len(some) > 0 or bool(np.isfinite(np.asarray(array, dtype=float)).any())
        return Facts(column, "number" if there else "", some)
    return Facts(Column(name, column.base, column.unit), "text", np.empty(0))


def _own_rows(
    y: NDArray[np.float64],
    facts: list[Facts],
    values: list[NDArray[Any]],
    signal: int,
    times: tuple[int, ...],
) -> tuple[NDArray[np.bool_], str]:
    """Rows that belong to the signal, where several channels share one frame, and a remark."""
    empty = np.isnan(y)
    filled = np.zeros(len(y), dtype=bool)
    for i, fact in enumerate(facts):
        if fact.kind == "number" and i != signal and i not in times:
            filled |= np.isfinite(np.asarray(values[i], dtype=float))
    if not MOST_EMPTY < empty.mean() < 1 or not filled.any():
        return np.ones(len(y), dtype=bool), ""
    keep = ~(empty & filled)
    return keep, (
        f"{int((~keep).sum())} of {len(keep)} rows hold no '{facts[signal].column.name}' and "
        "belong to other channels; left out"
    )


def content_of_columns(columns: Mapping[str, NDArray[Any]]) -> bytes:
    """Bytes that stand for the columns, for the hash of what was read."""
    digest = hashlib.sha256()
    for name, array in columns.items():
        digest.update(f"{name}:{array.dtype.str}:{array.shape}".encode())
        digest.update(repr(array.tolist()).encode() if array.dtype.hasobject else array.tobytes())
    return digest.digest()
