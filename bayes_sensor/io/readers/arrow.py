"""Apache Arrow tables: Parquet and Feather (Arrow IPC) files, one column per channel.

Times are numbers, timestamps, dates, times of day or durations; timestamps count from the first
sample.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from bayes_sensor.io.readers.frame import offset_of, recording_of_frame
from bayes_sensor.io.readers.recording import (
    DataFile,
    Recording,
    Selection,
    check_counts,
    missing_extra,
    parser_errors,
)

NOT_A_TIME = np.iinfo(np.int64).min
"""the whole number that stands for a missing time in NumPy"""


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
    if not table.schema.names or not table.num_rows:
        raise file.error("expected columns with samples, but the table is empty; export again")
    names = table.schema.names
    repeated = next((name for name in names if names.count(name) > 1), None)
    if repeated is not None:
        raise file.error(
            f"expected each column once, but '{repeated[:60]}' is in the table "
            f"{names.count(repeated)} times; give each column its own name"
        )
    columns = {name: _values(column) for name, column in zip(names, table.columns, strict=True)}
    offsets = {}
    for name, column in zip(names, table.columns, strict=True):
        if getattr(column.type, "tz", None) and len(there := column.drop_null()):
            offsets[name] = offset_of(there[0].as_py())
    return recording_of_frame(columns, offsets, file, selection)


def _values(column: Any) -> NDArray[Any]:
    """(n,) numbers as floats, times as datetime64 or timedelta64, anything else as objects."""
    import pyarrow as pa

    types = pa.types
    if types.is_date(column.type):
        column = column.cast(pa.timestamp("ms"))
    kind = column.type
    if types.is_timestamp(kind) or types.is_time(kind) or types.is_duration(kind):
        counts = column.cast(pa.int32()).cast(pa.int64()) if kind.bit_width == 32 else column.cast(
            pa.int64()
        )  # fmt: skip
        whole = counts.fill_null(NOT_A_TIME).to_numpy(zero_copy_only=False)
        return np.asarray(whole).view(f"{'M' if types.is_timestamp(kind) else 'm'}8[{kind.unit}]")
    if types.is_integer(kind) and not column.null_count:
        return np.asarray(column.to_numpy(zero_copy_only=False))
    if types.is_integer(kind) or types.is_floating(kind) or types.is_decimal(kind):
        floats = column.cast(pa.float64(), safe=False).to_numpy(zero_copy_only=False)
        return np.asarray(floats, dtype=np.float64)
    return np.empty(len(column), dtype=object)
