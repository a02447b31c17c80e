"""Apache Arrow tables: Parquet and Feather (Arrow IPC) files, one column per channel.

Times are numbers, timestamps, dates, times of day or durations; timestamps count from the first
sample.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from bayes_sensor.campaign import FloatArray
from bayes_sensor.io.readers.recording import (
    Clock,
    Column,
    DataFile,
    Recording,
    Selection,
    channel_names,
    check_counts,
    missing_extra,
    parser_errors,
    split_name,
)
from bayes_sensor.io.readers.roles import Facts, choose_roles
from bayes_sensor.io.readers.sampling import grid_times
from bayes_sensor.io.readers.table import MOST_EMPTY, number_times

SAMPLED = 400
"""rows from which the kind of each column is told"""


def read_parquet(file: DataFile, selection: Selection) -> Recording:
    """The recording in a Parquet table.

    Raises
    ------
    CampaignError
        If the file is damaged, a column is missing or is not numeric.
    """
    try:
        import pyarrow as pa
        import pyarrow.parquet as pq
    except ImportError:
        raise missing_extra(file, ".parquet", "parquet") from None
    what = "a Parquet table (.parquet)"
    with parser_errors(file, what), pq.ParquetFile(pa.BufferReader(file.content)) as table:
        names = table.schema_arrow.names
        check_counts(file, len(names), table.metadata.num_rows)
        return _read(file, selection, table.read())


def read_feather(file: DataFile, selection: Selection) -> Recording:
    """The recording in a Feather or Arrow IPC file.

    Raises
    ------
    CampaignError
        If the file is damaged, a column is missing or is not numeric.
    """
    try:
        import pyarrow as pa
        import pyarrow.ipc
    except ImportError:
        raise missing_extra(file, ".feather", "parquet") from None
    with parser_errors(file, "an Arrow table (.feather, .arrow)"):
        stream = pa.BufferReader(file.content)
        if file.content.startswith(b"ARROW1"):
            table = pyarrow.ipc.open_file(stream).read_all()
        else:
            table = pyarrow.ipc.open_stream(stream).read_all()
        check_counts(file, len(table.schema.names), table.num_rows)
        return _read(file, selection, table)


def _read(file: DataFile, selection: Selection, table: Any) -> Recording:
    import pyarrow as pa

    if not table.schema.names or not table.num_rows:
        raise file.error("expected columns with samples, but the table is empty; export again")
    names = table.schema.names
    repeated = next((name for name in names if names.count(name) > 1), None)
    if repeated is not None:
        raise file.error(
            f"expected each column once, but '{repeated[:60]}' is in the table "
            f"{names.count(repeated)} times; give each column its own name"
        )
    facts = [_facts(field, table.column(i)) for i, field in enumerate(table.schema)]
    roles = choose_roles(file, facts, selection)
    for i in (roles.signal, roles.drive):
        if i is not None and facts[i].kind != "number":
            raise file.error(
                f"column '{facts[i].column.name}' has the type "
                f"{str(table.schema.field(i).type)[:60]}; expected numbers: store it as float"
            )
    notes = list(roles.notes)
    signal = _floats(table.column(roles.signal))
    keep = np.ones(len(signal), dtype=bool)
    empty = np.isnan(signal)
    others = [
        i
        for i, fact in enumerate(facts)
        if fact.kind == "number" and i != roles.signal and i not in roles.times
    ]
    if MOST_EMPTY < empty.mean() < 1 and others:
        filled = np.zeros(len(signal), dtype=bool)
        for i in others:
            filled |= np.isfinite(_floats(table.column(i)))
        keep = ~(empty & filled)
        notes.append(
            f"{int((~keep).sum())} of {len(keep)} rows hold no "
            f"'{facts[roles.signal].column.name}' and belong to other channels; left out"
        )
    clock: Clock | None = None
    interval = None
    if not roles.times:
        assert selection.interval is not None  # choose_roles sees to it
        interval = selection.interval if keep.all() else None
        t = grid_times(0.0, selection.interval, len(signal))[keep]
    else:
        time = roles.times[0]
        kind, column = table.schema.field(time).type, table.column(time)
        if _is_clock(pa, kind):
            ns = _nanoseconds(pa, kind, column)[keep]
            if column.null_count:
                raise file.error(
                    f"column '{facts[time].column.name}' has rows without a time; remove them"
                )
            clock = Clock(int(ns[0]), not (pa.types.is_time(kind) or pa.types.is_duration(kind)))
            t = (ns - ns[0]) / 1e9
        elif facts[time].kind == "number":
            whole = np.asarray(column.to_numpy(zero_copy_only=False))[keep]
            t, clock, remark = number_times(file, facts[time].column, whole)
            notes += [remark] if remark else []
        else:
            raise file.error(
                f"column '{facts[time].column.name}' has the type {str(kind)[:60]}; expected "
                "times: store it as timestamp, or as float in seconds"
            )
    rows = np.flatnonzero(keep)
    return Recording(
        t=t,
        y=signal[keep],
        signal=facts[roles.signal].column.name,
        place=lambda i: f"row {int(rows[i]) + 1}",
        drive=None if roles.drive is None else _floats(table.column(roles.drive))[keep],
        drive_name="" if roles.drive is None else facts[roles.drive].column.name,
        unit=facts[roles.signal].column.unit,
        interval=interval,
        clock=clock,
        timed=not roles.times or bool(facts[roles.times[0]].column.unit),
        notes=tuple(notes),
        channels=channel_names([fact.column.name for fact in facts], roles.channels),
    )


def _is_clock(pa: Any, kind: Any) -> bool:
    types = pa.types
    return bool(
        types.is_timestamp(kind) or types.is_date(kind) or types.is_time(kind)
        or types.is_duration(kind)
    )  # fmt: skip


def _facts(field: Any, column: Any) -> Facts:
    import pyarrow as pa

    name = split_name(field.name)
    if _is_clock(pa, field.type):
        # a date alone cannot be the time of samples, unless there is nothing else
        return Facts(name, "stamp", np.empty(0))
    types = pa.types
    if (
        types.is_integer(field.type)
        or types.is_floating(field.type)
        or types.is_decimal(field.type)
    ):
        some = _floats(column.slice(0, SAMPLED))
        some = some[np.isfinite(some)]
        kind = "number" if len(some) or column.null_count < len(column) else ""
        return Facts(name, kind, some)
    return Facts(Column(field.name, name.base, name.unit), "text", np.empty(0))


def _floats(column: Any) -> FloatArray:
    import pyarrow as pa

    values = column.cast(pa.float64(), safe=False).to_numpy(zero_copy_only=False)
    return np.asarray(values, dtype=np.float64)


def _nanoseconds(pa: Any, kind: Any, column: Any) -> np.ndarray:
    """(n,) whole nanoseconds of a column of times."""
    if pa.types.is_date(kind):
        column, kind = column.cast(pa.timestamp("ms")), pa.timestamp("ms")
    per = {"s": 10**9, "ms": 10**6, "us": 10**3, "ns": 1}[kind.unit]
    whole = column.cast(pa.int32()).cast(pa.int64()) if kind.bit_width == 32 else column.cast(
        pa.int64()
    )  # fmt: skip
    return np.asarray(whole.fill_null(0).to_numpy(zero_copy_only=False), dtype=np.int64) * per
