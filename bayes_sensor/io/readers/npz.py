"""NumPy archives: ``t``, ``y`` and optionally ``drive``.  Pickled objects are not read."""

from __future__ import annotations

import io
import warnings
import zipfile
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from bayes_sensor.io.readers.recording import (
    DataFile,
    Recording,
    Selection,
    check_counts,
    is_time,
    list_names,
    parser_errors,
    seconds,
    split_name,
    time_place,
)
from bayes_sensor.io.readers.vectors import recording_of_vectors, signal_and_drive

_WHAT = "a NumPy archive (.npz)"


def read_npz(file: DataFile, selection: Selection) -> Recording:
    """The recording in an NPZ archive.

    Raises
    ------
    CampaignError
        If the archive is damaged, holds pickled objects or lacks an array.
    """
    with (
        parser_errors(file, _WHAT),
        zipfile.ZipFile(io.BytesIO(file.content)) as archive,
    ):
        members = [
            member.removesuffix(".npy") for member in archive.namelist() if member.endswith(".npy")
        ]
        check_counts(file, len(members))
        repeated = [member for member in members if members.count(member) > 1]
        if repeated:
            raise file.error(
                f"expected each array once, but '{repeated[0][:60]}' is in the archive "
                f"{len(repeated)} times; save with numpy.savez(path, t=t, y=y)"
            )
        columns = [split_name(member) for member in members]
        if not columns:
            raise file.error(
                "expected arrays 't' and 'y', but the archive has none; "
                "save with numpy.savez(path, t=t, y=y)"
            )
        time = time_place(file, columns, selection)
        if time is None and selection.interval is None:
            raise file.error(
                f"expected an array 't' with the times, but it has {list_names(members)}; "
                'save with numpy.savez(path, t=t, y=y), or write interval = "1 ms"'
            )
        if selection.signal is None and selection.drive is None and "drive" in members:
            selection = replace(selection, drive="drive")
        candidates = [
            i
            for i, column in enumerate(columns)
            if i != time and column.base != "drive" and not is_time(column)
            and not (column.unit and seconds(column.unit))
        ]  # fmt: skip
        if "y" in members:
            candidates = [members.index("y")]
        signal, drive = signal_and_drive(
            file, columns, selection, time, candidates,
            "expected an array 'y' with the signal beside the times; "
            "save with numpy.savez(path, t=t, y=y)",
        )  # fmt: skip
        y = _array(file, archive, members[signal])
        written = None if time is None else _array(file, archive, members[time], True)
        d = None if drive is None else _array(file, archive, members[drive])
    return recording_of_vectors(
        file, columns, (time, signal, drive), (written, y, d), called="'{}'",
        fix="save them with the same length", time_name="time" if time is None else members[time],
        interval=selection.interval,
        channels=[i for i, c in enumerate(columns) if i != time and not is_time(c)],
    )  # fmt: skip


def _array(
    file: DataFile, archive: zipfile.ZipFile, name: str, times: bool = False
) -> NDArray[Any]:
    """One vector, of floats or as times are stored; its header is read before memory is taken."""
    with archive.open(f"{name}.npy") as stream, warnings.catch_warnings():
        warnings.simplefilter("ignore")
        version = np.lib.format.read_magic(stream)
        header = {
            (1, 0): np.lib.format.read_array_header_1_0,
            (2, 0): np.lib.format.read_array_header_2_0,
        }.get(version)
        if header is None:
            raise file.error(
                f"array '{name}' has the format version {version}; expected 1.0 or 2.0: "
                "save it with numpy.savez"
            )
        shape, _, dtype = header(stream)
    if dtype.hasobject:
        raise file.error(
            f"array '{name}' holds pickled Python objects, which are never loaded because they "
            "can run code; save plain numbers: numpy.savez(path, t=t, y=y)"
        )
    if dtype.kind not in ("biufMm" if times else "biuf"):
        raise file.error(
            f"array '{name}' has the type {str(dtype)[:60]}; expected real numbers: save floats"
        )
    if sum(n != 1 for n in shape) > 1:
        raise file.error(f"array '{name}' has shape {shape}; expected one dimension: save a vector")
    size = int(np.prod(shape, dtype=object)) if shape else 1
    check_counts(file, 0, size)
    with archive.open(f"{name}.npy") as stream:
        values = np.lib.format.read_array(stream, allow_pickle=False)
    if times:
        return np.asarray(values).reshape(-1)
    return np.asarray(values, dtype=np.float64).reshape(-1)
