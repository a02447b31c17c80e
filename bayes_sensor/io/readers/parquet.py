"""Parquet tables: one column per channel, time by name or first."""

from __future__ import annotations

import numpy as np

from bayes_sensor.campaign import FloatArray
from bayes_sensor.io.readers.recording import (
    DataFile,
    Recording,
    Selection,
    check_counts,
    choose_columns,
    missing_extra,
    parser_errors,
    scale_time,
    split_name,
)

_WHAT = "a Parquet table (.parquet)"


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
    with (
        parser_errors(file, _WHAT),
        pq.ParquetFile(pa.BufferReader(file.content)) as table,
    ):
        schema = table.schema_arrow
        check_counts(file, len(schema.names), table.metadata.num_rows)
        if not schema.names or not table.metadata.num_rows:
            raise file.error("expected columns with samples, but the table is empty; export again")
        columns = tuple(split_name(name) for name in schema.names)
        time, signal, drive = choose_columns(file, columns, selection)
        chosen = [i for i in (time, signal, drive) if i is not None]
        for i in chosen:
            kind = schema.field(i).type
            if not (pa.types.is_integer(kind) or pa.types.is_floating(kind)):
                raise file.error(
                    f"column '{columns[i].name}' has the type {str(kind)[:60]}; expected numbers: "
                    "store it as float (times in seconds)"
                )
        content = table.read(columns=[schema.names[i] for i in chosen])
        values: dict[int, FloatArray] = {
            i: content.column(schema.names[i])
            .cast(pa.float64(), safe=False)
            .to_numpy()
            .astype(np.float64)
            for i in chosen
        }
    return Recording(
        t=scale_time(file, columns[time], values[time]),
        y=values[signal],
        signal=columns[signal].name,
        place=lambda i: f"row {i + 1}",
        drive=None if drive is None else values[drive],
        drive_name="" if drive is None else columns[drive].name,
        unit=columns[signal].unit,
    )
