"""MATLAB files, version 4 to 7.3: PicoScope's export and plain vectors.

A PicoScope export has ``A``, ``B``, ... with ``Tstart``, ``Tinterval`` and ``Length``; any other
file needs vectors and a time vector ``t`` or ``time``.  Only the vectors that are needed are read,
never structures, cells or objects.
"""

from __future__ import annotations

import warnings
import zlib
from typing import Any

import numpy as np

from bayes_sensor.campaign import CampaignError, FloatArray
from bayes_sensor.readers.recording import (
    MAX_SAMPLES,
    Column,
    DataFile,
    Recording,
    Selection,
    check_counts,
    find_column,
    is_time,
    list_names,
    parser_errors,
    scale_time,
    split_name,
)
from bayes_sensor.readers.sampling import grid_times, simplest_near

_NUMERIC = frozenset(
    "double single int8 uint8 int16 uint16 int32 uint32 int64 uint64 logical".split()
)
_CLOCK = ("Tstart", "Tinterval", "Length")
_WHAT = "a MATLAB file (.mat)"
_HDF5_MAGIC = b"\x89HDF\r\n\x1a\n"


def read_matlab(file: DataFile, selection: Selection) -> Recording:
    """The recording in a MATLAB file.

    Raises
    ------
    CampaignError
        If the file cannot be read, a variable is missing or lengths disagree.
    """
    import pymatreader  # slow to import

    if _HDF5_MAGIC in file.content[:4096]:
        _check_hdf5(file)
    else:
        _check_version5(file)
    with parser_errors(file, _WHAT), warnings.catch_warnings():
        warnings.simplefilter("ignore")
        listing = [
            (str(name), tuple(int(n) for n in shape), str(kind))
            for name, shape, kind in pymatreader.whosmat(file.path)
        ]
    check_counts(file, len(listing))
    sizes = {name: int(np.prod(shape)) for name, shape, kind in listing if kind in _NUMERIC}
    if any(size > MAX_SAMPLES for size in sizes.values()):
        check_counts(file, 0, max(sizes.values()))
    vectors = [
        name
        for name, shape, kind in listing
        if kind in _NUMERIC and sum(n != 1 for n in shape) == 1 and max(shape) > 1
    ]
    columns = [split_name(name) for name in vectors]
    time = next((i for i, column in enumerate(columns) if is_time(column)), None)
    has_clock = sizes.get("Tinterval") == 1
    if time is None and not has_clock:
        names = [name for name, _, _ in listing]
        raise file.error(
            "expected a time vector 't' or PicoScope's 'Tinterval', but it has "
            f"{list_names(names) if names else 'no variables'}; save time as well"
        )
    if has_clock:
        time = None
    signal, drive = _choose(file, columns, vectors, time, sizes, selection)
    wanted = [vectors[i] for i in (time, signal, drive) if i is not None]
    wanted += [name for name in _CLOCK if has_clock and sizes.get(name) == 1]
    with parser_errors(file, _WHAT), warnings.catch_warnings():
        warnings.simplefilter("ignore")
        content: dict[str, Any] = pymatreader.read_mat(file.path, variable_names=wanted)
    y = _vector(file, content, vectors[signal])
    d = None if drive is None else _vector(file, content, vectors[drive])
    interval = None
    if time is not None:
        t = scale_time(file, columns[time], _vector(file, content, vectors[time]))
    else:
        start, interval = _clock(file, content, len(y))
        t = grid_times(start, interval, len(y))
    for name, values in (("drive", d), ("time", t)):
        if values is not None and len(values) != len(y):
            raise file.error(
                f"expected the {name} vector to have the {len(y)} samples of "
                f"'{vectors[signal]}', but it has {len(values)}; save them with the same length"
            )

    def place(i: int) -> str:
        return f"sample {i + 1} of '{vectors[signal]}'"

    return Recording(
        t=t,
        y=y,
        signal=vectors[signal],
        place=place,
        drive=d,
        drive_name="" if drive is None else vectors[drive],
        unit=columns[signal].unit,
        interval=interval,
    )


def _choose(
    file: DataFile,
    columns: list[Column],
    vectors: list[str],
    time: int | None,
    sizes: dict[str, int],
    selection: Selection,
) -> tuple[int, int | None]:
    """Positions of signal and drive among the vectors."""
    others = [i for i in range(len(columns)) if i != time]
    if selection.signal is not None:
        signal = find_column(file, columns, selection.signal, "signal")
    else:
        if time is not None:
            others = [i for i in others if sizes[vectors[i]] == sizes[vectors[time]]] or others
        for usual in ("A", "y"):
            if usual in vectors and vectors.index(usual) in others:
                others = [vectors.index(usual)]
        if not others:
            raise file.error(
                "expected a vector with the signal beside the time, but there is none; "
                "save the signal as a row or column vector of numbers"
            )
        signal = others[0]
    drive = None
    if selection.drive is not None:
        drive = find_column(file, columns, selection.drive, "drive")
    for key, chosen in (("signal", signal), ("drive", drive)):
        if chosen is not None and chosen == time:
            raise file.error(f"{key} is '{vectors[chosen]}', which is the time; choose another")
    return signal, drive


def _vector(file: DataFile, content: dict[str, Any], name: str) -> FloatArray:
    value = content.get(name)
    if isinstance(value, np.ndarray) and value.dtype.kind == "c":
        raise file.error(
            f"variable '{name}' holds complex numbers; expected real ones: save its real part"
        )
    if not isinstance(value, np.ndarray) or value.ndim != 1 or value.dtype.kind not in "biuf":
        raise file.error(
            f"variable '{name}' is not a vector of real numbers as its header says; "
            "the file may be damaged: export it again"
        )
    return value.astype(np.float64)


def _scalar(content: dict[str, Any], name: str) -> float | None:
    value = content.get(name)
    if isinstance(value, bool | int | float | np.generic) or (
        isinstance(value, np.ndarray) and value.size == 1 and value.dtype.kind in "biuf"
    ):
        return float(np.asarray(value).real.reshape(-1)[0])
    return None


def _clock(file: DataFile, content: dict[str, Any], n: int) -> tuple[float, float]:
    """Start and interval in s from PicoScope's variables."""
    start, interval, length = (_scalar(content, name) for name in _CLOCK)
    if interval is None or not np.isfinite(interval) or interval <= 0:
        raise file.error(
            f"Tinterval: expected a positive sampling interval in s, but it is {interval}; "
            "export the recording again"
        )
    if start is None:
        start = 0.0
    if not np.isfinite(start):
        raise file.error(f"Tstart: expected a finite time in s, but it is {start}; export again")
    if length is not None and length != n:
        raise file.error(
            f"Length says {length:.12g} samples, but the signal has {n}; "
            "the file may be truncated: export it again"
        )
    # single-precision intervals such as 0.0010000000475 mean 0.001
    interval = simplest_near(interval, max(1e-7 * interval, 0.01 * interval / n))
    return simplest_near(start, 1e-3 * interval), interval


# --------------------------------------------------------------------------- hostile files


def _check_version5(file: DataFile) -> None:
    """Raise CampaignError on a truncated file or one that unpacks to far more than it should.

    Walks the top-level elements of a version 5 file (Mathworks, "MAT-File Format", 2-3 ff.):
    a tag of two 32-bit numbers, type and length, then that many bytes; type 15 is compressed.
    """
    raw = file.content
    if len(raw) < 128 or raw[126:128] not in (b"IM", b"MI"):
        return  # version 4 or no MATLAB file at all: the reader will tell
    order = "little" if raw[126:128] == b"IM" else "big"
    most = 8 * MAX_SAMPLES
    at = 128
    while at < len(raw):
        if not raw[at : at + 8].strip(b"\0"):
            break  # padding
        if at + 8 > len(raw):
            raise _truncated(file)
        kind = int.from_bytes(raw[at : at + 4], order)  # type: ignore[arg-type]
        length = int.from_bytes(raw[at + 4 : at + 8], order)  # type: ignore[arg-type]
        at += 8
        if at + length > len(raw):
            raise _truncated(file)
        if kind == 15:
            packed = zlib.decompressobj()
            size, chunk = 0, raw[at : at + length]
            with parser_errors(file, _WHAT):
                while chunk and not packed.eof:
                    size += len(packed.decompress(chunk, 1 << 22))
                    chunk = packed.unconsumed_tail
                    if size > most:
                        raise file.error(
                            f"a variable unpacks to more than {most >> 20} MB; "
                            "expected one experiment: save only time, signal and drive"
                        )
        at += length


def _truncated(file: DataFile) -> CampaignError:
    return file.error(
        "the MATLAB file ends in the middle of a variable, so it is truncated; export it again"
    )


def _check_hdf5(file: DataFile) -> None:
    """Raise CampaignError if a variable of a version 7.3 file lives in another file."""
    import h5py

    with parser_errors(file, _WHAT), h5py.File(file.path, "r") as content:
        for name in content:
            link = content.get(name, getlink=True)
            item = None if isinstance(link, h5py.ExternalLink) else content.get(name)
            if item is None or (
                isinstance(item, h5py.Dataset) and (item.external or item.is_virtual)
            ):
                raise file.error(
                    f"variable '{name}' points into another file, which is refused; "
                    "save the samples themselves"
                )
