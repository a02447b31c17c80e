"""MATLAB files, version 4 to 7.3: PicoScope's export and plain vectors.

A PicoScope export has ``A``, ``B``, ... with ``Tstart``, ``Tinterval`` and ``Length``; any other
file needs vectors and a time vector ``t`` or ``time``.  Only the vectors that are needed are read,
never structures, cells or objects.  Versions 4 and 5 are read by SciPy, 7.3 by pymatreader.
"""

from __future__ import annotations

import io
import warnings
import zlib
from dataclasses import dataclass, replace
from typing import Any, Literal

import numpy as np

from bayes_sensor.campaign import CampaignError, FloatArray
from bayes_sensor.io.readers.recording import (
    MAX_SAMPLES,
    Clock,
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
from bayes_sensor.io.readers.sampling import LATEST, simplest_near
from bayes_sensor.io.readers.vectors import recording_of_vectors, signal_and_drive

_NUMERIC = frozenset(
    "double single int8 uint8 int16 uint16 int32 uint32 int64 uint64 logical".split()
)
_CLOCK = ("Tstart", "Tinterval", "Length")
_WHAT = "a MATLAB file (.mat)"
_MOST_BYTES = 8 * MAX_SAMPLES
"""bytes to which the compressed variables of a file may unpack"""
DATE_NUMBERS = (6.5e5, 8.0e5)
"""days, MATLAB's numbers of the years 1779 to 2190"""
DAYS_TO_1970 = 719529
LONGEST_STEP = 0.5
"""days between samples, up to which times are taken as date numbers"""
_HDF5_MAGIC = b"\x89HDF\r\n\x1a\n"


def read_matlab(file: DataFile, selection: Selection) -> Recording:
    """The recording in a MATLAB file.

    Raises
    ------
    CampaignError
        If the file cannot be read, a variable is missing or lengths disagree.
    """
    variables = _list_variables(file)
    names = [v.name for v in variables]
    repeated = next((name for name in names if names.count(name) > 1), None)
    if repeated is not None:
        raise file.error(
            f"expected each variable once, but '{repeated[:60]}' is in the file "
            f"{names.count(repeated)} times; save it again with one of each"
        )
    check_counts(file, len(variables))
    sizes = {v.name: int(np.prod(v.shape, dtype=object)) for v in variables if v.numeric}
    check_counts(file, 0, max(sizes.values(), default=0))
    vectors = [
        v.name
        for v in variables
        if v.numeric and sum(n != 1 for n in v.shape) == 1 and max(v.shape) > 1
    ]
    columns = [split_name(name) for name in vectors]
    time = time_place(file, columns, selection)
    given = selection.interval is not None
    has_clock = sizes.get("Tinterval") == 1 and selection.time is None and not given
    if time is None and not has_clock and not given:
        other = [v.name for v in variables if not v.numeric]
        fix = 'save time as well, or write interval = "1 ms"'
        if other:
            fix = (
                f"'{other[0][:60]}' is no vector of numbers, and structures, cells and objects are "
                "never read: save the fields of a structure s as vectors, in MATLAB "
                "save('flat.mat', '-struct', 's')"
            )
        raise file.error(
            "expected a time vector 't' or PicoScope's 'Tinterval', but it has "
            f"{list_names(names) if names else 'no variables'}; {fix}"
        )
    if has_clock:
        time = None
    candidates = [
        i
        for i, column in enumerate(columns)
        if i != time and not is_time(column) and not (column.unit and seconds(column.unit))
    ]
    if time is not None:
        as_long = [i for i in candidates if sizes[vectors[i]] == sizes[vectors[time]]]
        candidates = as_long or candidates
    usual = [i for name in ("A", "y") for i in candidates if vectors[i] == name]
    signal, drive = signal_and_drive(
        file, columns, selection, time, usual or candidates,
        "expected a vector with the signal beside the time, but there is none; save the signal as "
        "a row or column vector of numbers",
    )  # fmt: skip
    wanted = {vectors[i] for i in (time, signal, drive) if i is not None}
    wanted |= {name for name in _CLOCK if has_clock and sizes.get(name) == 1}
    content = _read_variables(file, [v for v in variables if v.name in wanted])
    y = _vector(file, content, vectors[signal])
    d = None if drive is None else _vector(file, content, vectors[drive])
    written = None if time is None else _vector(file, content, vectors[time])
    start, interval = 0.0, selection.interval
    if has_clock:
        start, interval = _clock(file, content, len(y))
    n = sizes[vectors[signal]]
    recording = recording_of_vectors(
        file, columns, (time, signal, drive), (written, y, d), called="the {} vector",
        fix="save them with the same length", start=start, interval=interval,
        channels=[
            i
            for i, column in enumerate(columns)
            if i != time and not is_time(column) and sizes[vectors[i]] == n
        ],
    )  # fmt: skip
    return _in_seconds(recording) if _are_date_numbers(recording) else recording


def _are_date_numbers(recording: Recording) -> bool:
    """Whether the times are MATLAB's ``datenum``: days since the year 0, without a unit."""
    t = recording.t
    if recording.interval is not None or recording.timed or len(t) < 2 or not np.isfinite(t).all():
        return False
    return bool(DATE_NUMBERS[0] < t[0] < DATE_NUMBERS[1] and np.median(np.diff(t)) < LONGEST_STEP)


def _in_seconds(recording: Recording) -> Recording:
    """The recording with date numbers as seconds from the first, which the clock has."""
    first = float(recording.t[0])
    told = "times are MATLAB's days and were taken as such, from the first sample"
    return replace(
        recording,
        t=np.round(86400.0 * (recording.t - first), 4),  # datenum resolves 10 us
        clock=Clock(round((first - DAYS_TO_1970) * 86_400_000) * 1_000_000, True),
        notes=(*recording.notes, told),
    )


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
    for name, value in (("Tstart", start), ("Tinterval", interval * n)):
        if not abs(value) < LATEST:
            raise file.error(
                f"{name}: expected a finite time in s, as clocks have it, but it is "
                f"{value if name == 'Tstart' else interval}; export the recording again"
            )
    if length is not None and length != n:
        raise file.error(
            f"Length says {length:.12g} samples, but the signal has {n}; "
            "the file may be truncated: export it again"
        )
    # single-precision intervals such as 0.0010000000475 mean 0.001
    interval = simplest_near(interval, max(1e-7 * interval, 0.01 * interval / n))
    return simplest_near(start, 1e-3 * interval), interval


# --------------------------------------------------------------------------- variables


@dataclass(frozen=True)
class Variable:
    """A variable's entry in the file."""

    name: str
    shape: tuple[int, ...]
    numeric: bool
    element: bytes = b""
    """version 5: the checked element itself"""


def _list_variables(file: DataFile) -> list[Variable]:
    """The variables in the file, read as little as possible."""
    raw = file.content
    if _HDF5_MAGIC in raw[:4096]:
        return _list_hdf5(file)
    if len(raw) >= 128 and raw[126:128] in (b"IM", b"MI") and raw[124:126] in (b"\0\1", b"\1\0"):
        return _list_version5(file)
    if not raw[:4].count(0):
        raise file.error(
            f"expected {_WHAT}, but it does not begin like one; it may be damaged or of another "
            "format: export it again"
        )
    with parser_errors(file, _WHAT):  # version 4
        listing = _scipy_io().whosmat(io.BytesIO(raw))
        return [Variable(name, shape, kind in _NUMERIC) for name, shape, kind in listing]


def _read_variables(file: DataFile, variables: list[Variable]) -> dict[str, Any]:
    """The variables as arrays without axes of length 1."""
    raw = file.content
    names = [v.name for v in variables]
    with parser_errors(file, _WHAT), warnings.catch_warnings():
        warnings.simplefilter("ignore")
        if _HDF5_MAGIC in raw[:4096]:
            import pymatreader  # slow to import

            return dict(pymatreader.read_mat(file.path, variable_names=names))
        if any(v.element for v in variables):
            raw = raw[:128] + b"".join(v.element for v in variables)
        return dict(_scipy_io().loadmat(io.BytesIO(raw), squeeze_me=True, variable_names=names))


def _scipy_io() -> Any:
    """The module scipy.io, which is slow to import."""
    import scipy.io

    return scipy.io


def _list_hdf5(file: DataFile) -> list[Variable]:
    """The variables of a version 7.3 file; links to another file are refused."""
    import h5py  # slow to import

    variables = []
    with parser_errors(file, _WHAT), h5py.File(file.path, "r") as content:
        for name in content:
            link = content.get(name, getlink=True)
            item = content.get(name) if isinstance(link, h5py.HardLink) else None
            if item is None or (
                isinstance(item, h5py.Dataset) and (item.external or item.is_virtual)
            ):
                raise file.error(
                    f"variable '{name}' points into another file or place, which is refused; "
                    "save the samples themselves"
                )
            if isinstance(item, h5py.Dataset):
                numeric = item.dtype.kind in "biuf" and "MATLAB_empty" not in item.attrs
                variables.append(Variable(str(name), tuple(item.shape), numeric))
            elif not str(name).startswith("#"):  # a structure
                variables.append(Variable(str(name), (), False))
    return variables


# --------------------------------------------------------------------------- version 5
#
# SciPy's compiled reader follows the lengths and type codes in the file without checking them
# all, and a damaged file can crash the interpreter.  So every element is checked here before any
# is handed on.  Layout: MathWorks, "MAT-File Format".

_TYPE_SIZES = {1: 1, 2: 1, 3: 2, 4: 2, 5: 4, 6: 4, 7: 4, 9: 8, 12: 8, 13: 8}
"""bytes of one number, by the code of a numeric data type"""
_MATRIX, _COMPRESSED = 14, 15
_NUMERIC_CLASSES = range(6, 16)
_COMPLEX = 0x0800


def _list_version5(file: DataFile) -> list[Variable]:
    """The variables of a version 5 file, those with numbers checked to the last byte."""
    raw = file.content
    order: Literal["little", "big"] = "little" if raw[126:128] == b"IM" else "big"
    variables = []
    at, unpacked = 128, 0
    while raw[at : at + 8].strip(b"\0"):
        kind, length = _tag(raw, at, order)
        if at + 8 + length > len(raw) or len(raw) < at + 8:
            raise file.error(
                "the MATLAB file ends in the middle of a variable, so it is truncated; "
                "export it again"
            )
        element = raw[at : at + 8 + length]
        at += 8 + length
        if kind == _COMPRESSED:
            element = _unpack(file, element[8:], _MOST_BYTES - unpacked)
            unpacked += len(element)
            kind, length = _tag(element, 0, order)
            if len(element) < 8 + length:
                raise _damaged(file)
        if kind == _MATRIX:
            variable = _variable(file, element[: 8 + length], order)
            if variable is not None:
                variables.append(variable)
    return variables


def _variable(file: DataFile, element: bytes, order: Literal["little", "big"]) -> Variable | None:
    """The variable in a matrix element; None for objects, which have another layout."""
    parts: list[tuple[int, bytes]] = []
    at = 8
    while len(parts) < 5 and at < len(element):
        kind, length = _tag(element, at, order)
        if kind >> 16:  # a small element: up to four bytes inside the tag
            kind, length, start, at = kind & 0xFFFF, kind >> 16, at + 4, at + 8
            if length > 4:
                raise _damaged(file)
        else:
            start = at + 8
            at = start + -(-length // 8) * 8
        if start + length > len(element):
            raise _damaged(file)
        parts.append((kind, element[start : start + length]))
    if not parts or parts[0][0] != 6 or len(parts[0][1]) != 8:
        raise _damaged(file)
    flags = int.from_bytes(parts[0][1][:4], order)
    kind_of_array = flags & 0xFF
    if kind_of_array > 15:
        return None
    if len(parts) < 3 or parts[1][0] != 5 or parts[2][0] != 1 or not 8 <= len(parts[1][1]) <= 128:
        raise _damaged(file)
    sizes = np.frombuffer(
        parts[1][1][: len(parts[1][1]) // 4 * 4], "<i4" if order == "little" else ">i4"
    )
    shape = tuple(int(n) for n in sizes)
    name = parts[2][1].decode("latin-1")
    if min(shape) < 0 or not name.isprintable():
        raise _damaged(file)
    if kind_of_array not in _NUMERIC_CLASSES:
        return Variable(name, shape, False)
    count = int(np.prod(shape, dtype=object))
    data = parts[3:]
    if len(data) != (2 if flags & _COMPLEX else 1) or any(
        kind not in _TYPE_SIZES or len(values) != count * _TYPE_SIZES[kind] for kind, values in data
    ):
        raise _damaged(file)
    return Variable(name, shape, True, element)


def _tag(raw: bytes, at: int, order: Literal["little", "big"]) -> tuple[int, int]:
    return int.from_bytes(raw[at : at + 4], order), int.from_bytes(raw[at + 4 : at + 8], order)


def _unpack(file: DataFile, packed: bytes, most: int) -> bytes:
    """The inflated bytes, at most that many."""
    inflate = zlib.decompressobj()
    try:
        element = inflate.decompress(packed, most + 1)
    except zlib.error as error:
        raise _damaged(file, f" ({error})") from None
    if len(element) > most:
        raise file.error(
            f"its variables unpack to more than {_MOST_BYTES >> 20} MB; expected one experiment: "
            "save only time, signal and drive"
        )
    if not inflate.eof:
        raise _damaged(file, " (it ends too early)")
    return element


def _damaged(file: DataFile, reason: str = "") -> CampaignError:
    return file.error(
        f"expected {_WHAT}, but a variable in it cannot be read{reason}; it is damaged: "
        "export it again"
    )
