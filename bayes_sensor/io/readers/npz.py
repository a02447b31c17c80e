"""NumPy archives: ``t``, ``y`` and optionally ``drive``.  Pickled objects are not read."""

from __future__ import annotations

import io
import warnings
import zipfile

import numpy as np

from bayes_sensor.campaign import FloatArray
from bayes_sensor.io.readers.recording import (
    DataFile,
    Recording,
    Selection,
    check_chosen,
    check_counts,
    drive_place,
    find_column,
    list_names,
    parser_errors,
    recording_of_vectors,
    scale_time,
    split_name,
    time_place,
)

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
        time = time_place(columns)
        if time is None:
            raise file.error(
                f"expected an array 't' with the times, but it has {list_names(members)}; "
                "save with numpy.savez(path, t=t, y=y)"
            )
        if selection.signal is not None:
            signal = find_column(file, columns, selection.signal, "signal")
        elif "y" in members:
            signal = members.index("y")
        else:
            others = [i for i, column in enumerate(columns) if i != time and column.base != "drive"]
            if not others:
                raise file.error(
                    "expected an array 'y' with the signal beside the times; "
                    "save with numpy.savez(path, t=t, y=y)"
                )
            signal = others[0]
        drive = drive_place(file, columns, selection)
        if drive is None and selection.signal is None and "drive" in members:
            drive = members.index("drive")
        check_chosen(file, members, time, signal, drive)
        t, y = _array(file, archive, members[time]), _array(file, archive, members[signal])
        d = None if drive is None else _array(file, archive, members[drive])
    return recording_of_vectors(
        file, columns, signal, drive, (scale_time(file, columns[time], t), y, d), called="'{}'",
        fix="save them with the same length", time_name=members[time],
    )  # fmt: skip


def _array(file: DataFile, archive: zipfile.ZipFile, name: str) -> FloatArray:
    """One vector; its header is read before memory is allocated."""
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
    if dtype.kind not in "biuf":
        raise file.error(
            f"array '{name}' has the type {str(dtype)[:60]}; expected real numbers: save floats"
        )
    if sum(n != 1 for n in shape) > 1:
        raise file.error(f"array '{name}' has shape {shape}; expected one dimension: save a vector")
    size = int(np.prod(shape, dtype=object)) if shape else 1
    check_counts(file, 0, size)
    with archive.open(f"{name}.npy") as stream:
        values = np.lib.format.read_array(stream, allow_pickle=False)
    return np.asarray(values, dtype=np.float64).reshape(-1)
