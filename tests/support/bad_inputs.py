"""A generator of hostile and broken campaigns for every reader, and a judge of what happens.

``generate(seed, n)`` yields :class:`BadInput`: the files of a folder and what was done to them.
``judge`` runs ``bayes-sensor check`` on one and says whether it was refused with one clear message
or read correctly; anything else is a :class:`Misjudged`.  Used by the tests and by
``paper/studies/study_hostile.py``.
"""

from __future__ import annotations

import csv
import io
import os
import pickle
import random
import re
import signal
import stat
import struct
import warnings
import zipfile
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager, nullcontext, redirect_stderr, redirect_stdout
from dataclasses import dataclass, field
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np

from bayes_sensor.campaign import Campaign, CampaignError
from bayes_sensor.cli import exit_code
from bayes_sensor.io.check import campaign_remarks
from bayes_sensor.io.readers import read_campaign

N, INTERVAL, ON, OFF = 800, 0.01, 2.0, 5.5
T = np.round(np.arange(N) * INTERVAL, 6)


def _signal() -> np.ndarray:
    noise = 0.01 * np.random.default_rng(5).standard_normal(N)
    rise = 1 - np.exp(-np.clip(T - ON - 0.1, 0, None) / 0.3)
    fall = 1 - np.exp(-np.clip(T - OFF - 0.1, 0, None) / 0.3)
    return np.round(0.3 + 1.8 * (rise - fall) + noise, 5)


Y = _signal()
DRIVE = np.where((T > ON - 1e-9) & (T < OFF - 1e-9), 5.0, 0.0)
READERS = ("csv", "tsv", "mat5", "mat73", "npz", "tdms", "parquet")
SUFFIX = {"mat5": "mat", "mat73": "mat"}


@dataclass(frozen=True)
class BadInput:
    """One folder with a campaign in it that something is wrong with."""

    reader: str
    kind: str
    toml: bytes
    files: Mapping[str, bytes] = field(default_factory=dict)
    prepare: Callable[[Path], None] | None = None
    """what else must be done to the folder: links, permissions, pipes"""
    must: str = "either"
    """``refused``, ``read``, or ``either`` where both are sound"""
    dialect: tuple[str, str, str] | None = None
    """separator, decimal mark and encoding of a text table, for an independent reading"""


# --------------------------------------------------------------------------- writing good files


def entry(file: str, /, **keys: str | None) -> str:
    """The text of a campaign with one experiment; values are TOML, None drops a key."""
    table: dict[str, str | None] = {
        "name": '"1"',
        "file": f'"{file}"',
        "carrier_flow": '"4.0 L/min"',
        "test_gas_flow": '"0.5 L/min"',
        "commanded_on": f'"{ON} s"',
        "commanded_off": f'"{OFF} s"',
    } | keys
    lines = [f"{key} = {value}" for key, value in table.items() if value is not None]
    return "\n".join(["[[experiment]]", *lines, ""])


BY_DRIVE: dict[str, str | None] = {
    "commanded_on": None,
    "commanded_off": None,
    "signal": '"y"',
    "drive": '"d"',
}


def table(
    columns: Mapping[str, np.ndarray], separator: str = ",", decimal: str = ".", end: str = "\n"
) -> str:
    """A text table."""
    lines = [separator.join(columns)]
    for row in zip(*columns.values()):
        lines.append(separator.join(f"{v:.10g}" for v in row).replace(".", decimal))
    return end.join(lines) + end


def npz(**arrays: Any) -> bytes:
    """A NumPy archive."""
    stream = io.BytesIO()
    np.savez(stream, **arrays)
    return stream.getvalue()


def mat5(compress: bool = True, **variables: Any) -> bytes:
    """A MATLAB file, version 5."""
    from scipy.io import savemat

    stream = io.BytesIO()
    savemat(stream, variables, do_compression=compress)
    return stream.getvalue()


def mat73(edit: Callable[[Any], None] | None = None, **variables: Any) -> bytes:
    """A MATLAB file, version 7.3; ``edit`` may change the open HDF5 file."""
    import h5py

    stream = io.BytesIO()
    with h5py.File(stream, "w", userblock_size=512) as content:
        for name, value in variables.items():
            array = np.atleast_2d(value)
            content[name] = array
            content[name].attrs["MATLAB_class"] = np.bytes_(b"double")
        if edit is not None:
            edit(content)
    raw = bytearray(stream.getvalue())
    raw[:128] = b"MATLAB 7.3 MAT-file".ljust(124) + b"\x00\x02IM"
    return bytes(raw)


def tdms(**channels: Any) -> bytes:
    """A TDMS file; a channel is an array, or an array with its properties."""
    from nptdms import ChannelObject, TdmsWriter

    stream = io.BytesIO()
    with TdmsWriter(stream) as writer:
        objects = []
        for name, value in channels.items():
            data, properties = value if isinstance(value, tuple) else (value, {})
            objects.append(ChannelObject("g", name, data, properties))
        writer.write_segment(objects)
    return stream.getvalue()


def parquet(**columns: Any) -> bytes:
    """A Parquet table."""
    import pyarrow as pa
    import pyarrow.parquet as pq

    stream = io.BytesIO()
    pq.write_table(pa.table(columns), stream)
    return stream.getvalue()


WRITERS: dict[str, Callable[..., bytes]] = {
    "csv": lambda **c: table(c).encode(),
    "tsv": lambda **c: table(c, "\t").encode(),
    "mat5": mat5,
    "mat73": mat73,
    "npz": npz,
    "tdms": tdms,
    "parquet": parquet,
}
DIALECTS = {"csv": (",", ".", "utf-8"), "tsv": ("\t", ".", "utf-8")}


def name_of(reader: str) -> str:
    """The data file of a reader."""
    return f"a.{SUFFIX.get(reader, reader)}"


# --------------------------------------------------------------------------- bad data, any format

Rng = np.random.Generator
Columns = dict[str, np.ndarray]


def _at(rng: Rng, low: int = 5, high: int = N - 5) -> int:
    return int(rng.integers(low, high))


def _some(rng: Rng, most: int) -> np.ndarray:
    return rng.choice(np.arange(5, N - 5), int(rng.integers(1, most)), replace=False)


def _put(column: str, values: tuple[float, ...], most: int) -> Callable[[Rng], Columns]:
    def make(rng: Rng) -> Columns:
        c = {"t": T.copy(), "y": Y.copy()}
        at = _some(rng, most)
        c[column][at] = rng.choice(values, len(at))
        return c

    return make


def duplicated(rng: Rng) -> Columns:
    i = np.sort(np.concatenate([np.arange(N), _some(rng, 30)]))
    return {"t": T[i], "y": Y[i]}


def shuffled(rng: Rng) -> Columns:
    i = np.arange(N)
    a, b = sorted(rng.choice(N, 2, replace=False))
    i[a : b + 1] = rng.permutation(i[a : b + 1])
    if (np.diff(i) > 0).all():
        i[[3, 4]] = i[[4, 3]]
    return {"t": T[i], "y": Y[i]}


def jittered(rng: Rng) -> Columns:
    t = T + INTERVAL * rng.uniform(0.02, 1.5) * rng.uniform(-0.5, 0.5, N)
    return {"t": np.sort(np.round(t - t[0], 8)), "y": Y}


def dropped(rng: Rng) -> Columns:
    keep = np.ones(N, dtype=bool)
    if rng.random() < 0.5:
        keep[_some(rng, 200)] = False
    else:
        a = _at(rng)
        keep[a : a + int(rng.integers(1, 150))] = False
    return {"t": T[keep], "y": Y[keep]}


def counter(rng: Rng) -> Columns:
    """Times from a counter of a few bits that overflows."""
    wrap = 2 ** int(rng.integers(5, 10))
    return {"t": np.arange(N) % wrap * INTERVAL, "y": Y}


def signed_counter(rng: Rng) -> Columns:
    half = 2 ** int(rng.integers(5, 10))
    return {"t": ((np.arange(N) + half) % (2 * half) - half) * INTERVAL, "y": Y}


def clipped(rng: Rng) -> Columns:
    return {"t": T, "y": np.minimum(Y, rng.uniform(0.6, 2.0))}


def clipped_below(rng: Rng) -> Columns:
    return {"t": T, "y": np.maximum(Y, rng.uniform(0.4, 1.5))}


def overrange(rng: Rng) -> Columns:
    return {"t": T, "y": np.where(Y > rng.uniform(0.6, 2.05), np.inf, Y)}


def swapped(rng: Rng) -> Columns:
    return {"t": T, "y": DRIVE + 0.001 * rng.integers(0, 2, N), "d": Y}


def inverted(rng: Rng) -> Columns:
    return {"t": T, "y": Y, "d": rng.uniform(1, 20) - DRIVE * rng.uniform(0.1, 4)}


def useless_drive(rng: Rng) -> Columns:
    drive = rng.choice([0.0, 5.0, np.nan, np.inf]) + 0.01 * rng.standard_normal(N)
    return {"t": T, "y": Y, "d": drive}


def many_pulses(rng: Rng) -> Columns:
    return {"t": T, "y": Y, "d": np.where(np.sin(T * rng.uniform(3, 12)) > 0.2, 5.0, 0.0)}


def milliseconds(rng: Rng) -> Columns:
    return {"t": T * 1000.0, "y": Y, "d": DRIVE}


def columns_swapped(rng: Rng) -> Columns:
    return {"t": Y, "y": T}


def constant(rng: Rng) -> Columns:
    return {"t": T, "y": np.full(N, rng.choice([0.0, 0.3, -1e-300, 1e11]))}


def two_samples(rng: Rng) -> Columns:
    n = int(rng.integers(0, 4))
    return {"t": T[:n], "y": Y[:n]}


def reversed_time(rng: Rng) -> Columns:
    return {"t": T[::-1].copy(), "y": Y[::-1].copy()}


def extreme_times(rng: Rng) -> Columns:
    return {"t": T * rng.choice([1e-300, 1e-12, 1e12, 1e300, -1.0, 0.0]), "y": Y}


def far_times(rng: Rng) -> Columns:
    """Times since 1970 or the like, in which floats lose digits."""
    return {"t": T + rng.choice([1.7e9, 3.8e9, 6.3e10, 1e15]), "y": Y}


# kind: how to make it, what must become of it, keys of the campaign
DATA_KINDS: dict[str, tuple[Callable[[Rng], Columns], str, dict[str, str | None]]] = {
    "NaN in the signal": (_put("y", (np.nan,), 400), "either", {}),
    "infinite samples": (_put("y", (np.inf, -np.inf), 300), "either", {}),
    "1e300 in the signal": (_put("y", (1e300, -1e300, 1e308), 5), "refused", {}),
    "NaN in time": (_put("t", (np.nan,), 5), "refused", {}),
    "infinite times": (_put("t", (np.inf, -np.inf), 5), "refused", {}),
    "1e300 in time": (_put("t", (1e300, -1e300), 5), "refused", {}),
    "duplicated times": (duplicated, "refused", {}),
    "shuffled times": (shuffled, "refused", {}),
    "reversed times": (reversed_time, "refused", {}),
    "jittered sampling": (jittered, "either", {}),
    "dropped samples": (dropped, "either", {}),
    "counter overflow": (counter, "refused", {}),
    "signed counter overflow": (signed_counter, "refused", {}),
    "saturated": (clipped, "either", {}),
    "saturated below": (clipped_below, "either", {}),
    "over range": (overrange, "either", {}),
    "swapped channels": (swapped, "either", BY_DRIVE),
    "drive inverted": (inverted, "either", BY_DRIVE),
    "drive useless": (useless_drive, "refused", BY_DRIVE),
    "drive of many pulses": (many_pulses, "either", BY_DRIVE),
    "ms labelled s": (milliseconds, "either", {}),
    "ms labelled s, drive": (milliseconds, "either", BY_DRIVE),
    "time and signal swapped": (columns_swapped, "refused", {}),
    "constant": (constant, "either", {}),
    "hardly any sample": (two_samples, "refused", {}),
    "times out of scale": (extreme_times, "either", {}),
    "times since an epoch": (far_times, "either", {}),
}


def bad_data(reader: str, kind: str, rng: Rng) -> BadInput:
    """A well-formed file whose numbers are wrong."""
    make, must, keys = DATA_KINDS[kind]
    content = WRITERS[reader](**make(rng))
    file = name_of(reader)
    return BadInput(
        reader,
        kind,
        entry(file, **keys).encode(),
        {file: content},
        None,
        must,
        DIALECTS.get(reader),
    )


# --------------------------------------------------------------------------- bad bytes, any format


def truncated(raw: bytes, rng: Rng) -> bytes:
    return raw[: int(rng.integers(0, len(raw)))]


def flipped(raw: bytes, rng: Rng) -> bytes:
    out = bytearray(raw)
    # headers and directories, where the damage matters most, are at both ends
    ends = np.concatenate(
        [np.arange(min(600, len(raw))), np.arange(max(len(raw) - 600, 0), len(raw))]
    )
    for _ in range(int(rng.integers(1, 6))):
        at = int(rng.choice(ends)) if rng.random() < 0.7 else int(rng.integers(len(raw)))
        out[at] ^= 1 << int(rng.integers(8))
    return bytes(out)


def zeroed(raw: bytes, rng: Rng) -> bytes:
    a = int(rng.integers(len(raw)))
    n = int(rng.integers(1, 2000))
    return raw[:a] + bytes(len(raw[a : a + n])) + raw[a + n :]


def inserted(raw: bytes, rng: Rng) -> bytes:
    a = int(rng.integers(len(raw)))
    return raw[:a] + rng.bytes(int(rng.integers(1, 64))) + raw[a:]


def cut_out(raw: bytes, rng: Rng) -> bytes:
    a = int(rng.integers(len(raw)))
    return raw[:a] + raw[a + int(rng.integers(1, 500)) :]


def appended(raw: bytes, rng: Rng) -> bytes:
    return raw + rng.bytes(int(rng.integers(1, 5000)))


def wrong_magic(raw: bytes, rng: Rng) -> bytes:
    magics = [
        b"PK\x03\x04",
        b"\x89HDF\r\n\x1a\n",
        b"PAR1",
        b"TDSm",
        b"\x89PNG\r\n\x1a\n",
        b"%PDF-1.7",
        b"\x1f\x8b\x08",
        b"MATLAB 5.0 MAT-file",
        b"\x80\x04\x95",
        b"SIMPLE  =",
    ]
    magic = magics[int(rng.integers(len(magics)))]
    return magic + raw[len(magic) :]


def noise(raw: bytes, rng: Rng) -> bytes:
    return rng.bytes(int(rng.integers(1, 4000)))


BYTE_KINDS: dict[str, Callable[[bytes, Rng], bytes]] = {
    "truncated": truncated,
    "bits flipped": flipped,
    "stretch of zeros": zeroed,
    "bytes inserted": inserted,
    "bytes cut out": cut_out,
    "garbage appended": appended,
    "wrong magic": wrong_magic,
    "random bytes": noise,
}


def bad_bytes(reader: str, kind: str, rng: Rng) -> BadInput:
    """A good file that was damaged."""
    compress = {"compress": bool(rng.integers(2))} if reader == "mat5" else {}
    raw = WRITERS[reader](t=T, y=Y, **compress)
    file = name_of(reader)
    return BadInput(
        reader,
        kind,
        entry(file).encode(),
        {file: BYTE_KINDS[kind](raw, rng)},
        None,
        "either",
        DIALECTS.get(reader),
    )


def another_format(reader: str, rng: Rng) -> BadInput:
    """A good file of one format under the suffix of another."""
    others = [r for r in READERS if SUFFIX.get(r, r) != SUFFIX.get(reader, reader)]
    other = others[int(rng.integers(len(others)))]
    file = name_of(reader)
    # a table of tabs is a good CSV too
    must = "either" if {reader, other} <= {"csv", "tsv"} else "refused"
    return BadInput(
        reader,
        "another format's file",
        entry(file).encode(),
        {file: WRITERS[other](t=T, y=Y)},
        None,
        must,
    )


# --------------------------------------------------------------------------- text tables


def _rows(separator: str = ",", decimal: str = ".") -> list[str]:
    return table({"t": T, "y": Y}, separator, decimal).split("\n")[:-1]


def mixed_separators(rng: Rng) -> bytes:
    lines = _rows()
    for i in _some(rng, 40):
        lines[i] = lines[i].replace(",", str(rng.choice([";", "\t", " ", "|", ",,", " , ; "])))
    return "\n".join(lines).encode()


def decimal_commas(rng: Rng) -> bytes:
    return table({"t": T, "y": Y}, str(rng.choice([",", ";", "\t", " "])), ",").encode()


def some_decimal_commas(rng: Rng) -> bytes:
    lines = _rows(";")
    for i in _some(rng, 40):
        lines[i] = lines[i].replace(".", ",")
    return "\n".join(lines).encode()


def boms(rng: Rng) -> bytes:
    lines = _rows()
    lines[0] = "\ufeff" * int(rng.integers(1, 4)) + lines[0]
    if rng.random() < 0.5:
        i = _at(rng)
        lines[i] = "\ufeff" + lines[i]
    return "\n".join(lines).encode()


def utf16(rng: Rng) -> bytes:
    code = str(rng.choice(["utf-16", "utf-16-le", "utf-16-be", "utf-32", "utf-32-le", "utf-7"]))
    raw = "\n".join(_rows()).encode(code)
    return raw[: len(raw) - int(rng.integers(0, 3))]


def code_pages(rng: Rng) -> bytes:
    lines = _rows()
    lines[0] = "Zeit (s);Spannung für Küvette µ".replace(";", ",")
    return "\n".join(lines).encode(str(rng.choice(["latin-1", "cp1252", "utf-8", "cp437"])))


def line_ends(rng: Rng) -> bytes:
    ends = ["\n", "\r\n", "\r", "\n\n", "\n\r", "\x0b", "\x0c", "\x85", "\u2028"]
    few = rng.choice(len(ends), 2)
    return "".join(line + ends[few[int(rng.integers(2))]] for line in _rows()).encode()


def huge_header(rng: Rng) -> bytes:
    n = int(10 ** rng.uniform(2, 5))
    line = str(
        rng.choice(["# comment", "%", "made by a recorder", "", '"quoted, text"', "a,b,c,d"])
    )
    return ((line + "\n") * n + "\n".join(_rows())).encode()


def many_columns(rng: Rng) -> bytes:
    n = int(10 ** rng.uniform(3, 6.3))
    if rng.random() < 0.5:
        return ("t,y" + ",c" * n + "\n0,1" + ",2" * n + "\n").encode()
    return ("t,y\n" + "\n".join(_rows()[1:]) + "\n7.99,1" + ",2" * n + "\n").encode()


def endless_line(rng: Rng) -> bytes:
    return bytes(rng.choice([b"1", b" ", b"a", b'"', b"\t", b"1.", b";"])) * int(
        10 ** rng.uniform(4, 6.5)
    )


def odd_cells(rng: Rng) -> bytes:
    cells = [
        "",
        "-",
        "n/a",
        "NaN(ind)",
        "1.#INF",
        "0x1F",
        "1e",
        "1e5000",
        "--1",
        "1,234.5",
        "1'000",
        "½",
        "١٢",
        "TRUE",
        "=A1+1",
        "#DIV/0!",
        '"',
        '""',
        "'0.3",
        "0.3 V",
        "1_000",
        "\x00",
        "\x1b[2J",
        "<b>",
        "None",
        "∞",
        "-∞",
        "1d3",
        "0.3\\",
        "inf",
        "1.7976931348623157e309",
        " ",
        "+.",
        "９",
    ]
    lines = _rows()
    for i in _some(rng, 4):
        column = int(rng.integers(2))
        parts = lines[i].split(",")
        parts[column] = cells[int(rng.integers(len(cells)))]
        lines[i] = ",".join(parts)
    return "\n".join(lines).encode()


def ragged(rng: Rng) -> bytes:
    lines = _rows()
    for i in _some(rng, 5):
        lines[i] = str(
            rng.choice([lines[i] + ",1", lines[i].split(",")[0], ",", lines[i] + ",,", "x"])
        )
    return "\n".join(lines).encode()


def quotes(rng: Rng) -> bytes:
    lines = _rows()
    i = _at(rng)
    lines[i] = str(
        rng.choice(
            ['"' + lines[i], lines[i] + '"', '"' + lines[i] + '"', lines[i].replace(",", '","')]
        )
    )
    return "\n".join(lines).encode()


def headers(rng: Rng) -> bytes:
    lines = _rows()
    heads = [
        "t,t",
        "y,y",
        ",",
        "time (V),y",
        "time_ms,y (s)",
        "t",
        "t,y,z",
        "1,2",
        "a b,c d",
        "(s),(V)",
        "t,y\n(s),(foo)",
        "t,y\n(s)",
        "t,y\n(V),(s)",
        "time,time_s",
        "x" * 5000 + ",y",
        "sep=|",
        "\x00,y",
        "t,y\nt,y",
        "t;y",
        "=cmd(),y",
        "t,🜨",
        "Time,Channel A\n(s),(V)\n\n\n",
    ]
    lines[0] = heads[int(rng.integers(len(heads)))]
    return "\n".join(lines).encode()


TEXT_KINDS: dict[str, Callable[[Rng], bytes]] = {
    "mixed separators": mixed_separators,
    "decimal commas": decimal_commas,
    "decimal commas in some rows": some_decimal_commas,
    "byte order marks": boms,
    "UTF-16 and others": utf16,
    "code pages": code_pages,
    "line ends": line_ends,
    "huge header": huge_header,
    "up to millions of columns": many_columns,
    "endless line": endless_line,
    "odd cells": odd_cells,
    "ragged rows": ragged,
    "quotes": quotes,
    "odd headers": headers,
}


def bad_text(reader: str, kind: str, rng: Rng) -> BadInput:
    """A text table that is hard to read."""
    file = name_of(reader)
    return BadInput(reader, kind, entry(file).encode(), {file: TEXT_KINDS[kind](rng)})


# --------------------------------------------------------------------------- binary formats' own


class Trap:
    """Unpickling this makes a folder."""

    def __reduce__(self) -> tuple[Callable[..., None], tuple[str]]:
        return os.mkdir, (TRAP,)


TRAP = "sprung-by-unpickling"


def npy_claim(shape: Any, descr: str = "<f8", body: bytes = bytes(64)) -> bytes:
    """An array file whose header claims that shape."""
    header = repr({"descr": descr, "fortran_order": False, "shape": shape}).encode()
    header = header.ljust(-(-(len(header) + 11) // 64) * 64 - 11) + b"\n"
    return b"\x93NUMPY\x01\x00" + struct.pack("<H", len(header)) + header + body


def archive(members: list[tuple[str, bytes]], method: int = zipfile.ZIP_STORED) -> bytes:
    """A ZIP archive of any members, repeated names included."""
    stream = io.BytesIO()
    with warnings.catch_warnings(), zipfile.ZipFile(stream, "w", method) as zipped:
        warnings.simplefilter("ignore")
        for name, content in members:
            zipped.writestr(name, content)
    return stream.getvalue()


def _npy(array: np.ndarray) -> bytes:
    stream = io.BytesIO()
    np.save(stream, array)
    return stream.getvalue()


@cache
def npz_bomb() -> bytes:
    """An archive that unpacks to five hundred times its size."""
    zeros = _npy(np.zeros(21_000_000))
    return archive([("t.npy", zeros), ("y.npy", zeros)], zipfile.ZIP_DEFLATED)


@cache
def mat5_bomb() -> bytes:
    """A MATLAB file that unpacks to a thousand times its size."""
    return mat5(t=np.zeros(21_000_000), y=Y)


def encrypted(raw: bytes) -> bytes:
    """The archive with every member marked as encrypted."""
    out = bytearray(raw)
    for mark, offset in ((b"PK\x03\x04", 6), (b"PK\x01\x02", 8)):
        at = raw.find(mark)
        while at >= 0:
            out[at + offset] |= 1
            at = raw.find(mark, at + 4)
    return bytes(out)


NPZ_KINDS: dict[str, tuple[Callable[[Rng], bytes], str]] = {
    "object array": (lambda r: npz(t=T, y=np.array([Trap()] * 3, dtype=object)), "refused"),
    "object times": (lambda r: npz(t=np.array([Trap(), 1.0], dtype=object), y=Y), "refused"),
    "object drive": (lambda r: npz(t=T, y=Y, drive=np.array([Trap()], dtype=object)), "refused"),
    "pickle": (lambda r: pickle.dumps({"t": T, "y": Trap()}), "refused"),
    "pickle as a member": (
        lambda r: archive([("t.npy", _npy(T)), ("y.npy", pickle.dumps(Trap()))]),
        "refused",
    ),
    "pickle in a claimed array": (
        lambda r: archive(
            [("t.npy", _npy(T)), ("y.npy", npy_claim((1,), "|O", pickle.dumps(Trap())))]
        ),
        "refused",
    ),
    "huge claim": (
        lambda r: archive(
            [("t.npy", _npy(T)), ("y.npy", npy_claim((10 ** int(r.integers(5, 300)),)))]
        ),
        "refused",
    ),
    "odd claim": (
        lambda r: archive(
            [
                ("t.npy", _npy(T)),
                (
                    "y.npy",
                    npy_claim(
                        [(-1,), (N, -1), (), (0,), (1.5,), ("a",), (2**63,), None][
                            int(r.integers(8))
                        ]
                    ),
                ),
            ]
        ),
        "refused",
    ),
    "odd type": (
        lambda r: npz(
            t=T,
            y=[
                Y + 1j,
                Y.astype("S8"),
                Y.astype("U8"),
                Y.astype("M8[s]"),
                Y.astype("m8[ms]"),
                np.zeros(N, dtype=[("a", "f8"), ("b", "i4")]),
                np.zeros(N, "V8"),
            ][int(r.integers(7))],
        ),
        "refused",
    ),
    "matrix": (lambda r: npz(t=T, y=np.ones((N, int(r.integers(2, 5))))), "refused"),
    "lengths differ": (lambda r: npz(t=T, y=Y[: int(r.integers(1, N - 1))]), "refused"),
    "repeated members": (
        lambda r: archive([("t.npy", _npy(T)), ("y.npy", _npy(Y)), ("y.npy", _npy(Y * 0))]),
        "refused",
    ),
    "member outside": (
        lambda r: archive(
            [("../t.npy", _npy(T)), ("/etc/y.npy", _npy(Y)), ("../../y.npy", _npy(Y))]
        ),
        "refused",
    ),
    "bomb": (lambda r: npz_bomb(), "refused"),
    "many members": (
        lambda r: archive([(f"c{i}.npy", b"") for i in range(int(r.integers(4097, 9000)))]),
        "refused",
    ),
    "encrypted": (lambda r: encrypted(npz(t=T, y=Y)), "refused"),
    "big endian": (lambda r: npz(t=T.astype(">f8"), y=Y.astype(">f4")), "read"),
    "header that runs code": (
        lambda r: archive(
            [
                ("t.npy", _npy(T)),
                ("y.npy", _npy(Y).replace(b"'<f8'", b"f()  ").replace(b"False", b"exit()"[:5])),
            ]
        ),
        "refused",
    ),
}


CLOCK = {"Tstart": 0.0, "Tinterval": INTERVAL, "Length": N}


def _clock(rng: Rng) -> bytes:
    key = str(rng.choice(list(CLOCK)))
    value = [np.nan, np.inf, -1.0, 0.0, 1e300, "text", np.zeros(3), 1j, 2**63, np.int8(-5)][
        int(rng.integers(10))
    ]
    return mat5(A=Y, **{**CLOCK, key: value})


def _sparse(rng: Rng) -> bytes:
    from scipy.sparse import csc_array

    return mat5(t=T, y=csc_array(Y[:, None]))


MAT5_KINDS: dict[str, tuple[Callable[[Rng], bytes], str]] = {
    "PicoScope clock": (_clock, "either"),
    "cells": (lambda r: mat5(t=T, y=np.array([Y, "x"], dtype=object)), "refused"),
    "structure": (lambda r: mat5(t=T, y={"a": Y, "b": {"c": [1]}}), "refused"),
    "text": (lambda r: mat5(t=T, y="0.1 0.2 0.3"), "refused"),
    "complex": (lambda r: mat5(t=T, y=Y * (1 + 1j)), "refused"),
    "sparse": (_sparse, "refused"),
    "matrix": (lambda r: mat5(t=T, y=np.ones((N, 3))), "refused"),
    "lengths differ": (lambda r: mat5(t=T, y=Y[: int(r.integers(2, N - 1))]), "refused"),
    "bomb": (lambda r: mat5_bomb(), "refused"),
    "many variables": (lambda r: mat5(t=T, y=Y, **{f"v{i}": 1.0 for i in range(4200)}), "refused"),
    "integers": (lambda r: mat5(t=T, y=(Y * 1000).astype("i2")), "either"),
    "false length": (
        lambda r: bytes(
            bytearray(mat5(False, t=T, y=Y)[:132])
            + struct.pack("<I", int(r.integers(0, 2**32)))
            + mat5(False, t=T, y=Y)[136:]
        ),
        "either",
    ),
}


def _links(rng: Rng) -> bytes:
    import h5py

    def edit(content: Any) -> None:
        del content["y"]
        which = int(rng.integers(4))
        if which == 0:
            content["y"] = h5py.ExternalLink("/etc/passwd", "/y")
        elif which == 1:
            content["y"] = h5py.SoftLink("/y")
        elif which == 2:
            content["y"] = h5py.SoftLink("/nowhere")
        else:
            layout = h5py.VirtualLayout((N,), "f8")
            layout[:] = h5py.VirtualSource("/etc/other.h5", "y", (N,))
            content.create_virtual_dataset("y", layout)

    return mat73(edit, t=T, y=Y)


def _odd_dataset(rng: Rng) -> bytes:
    import h5py

    def edit(content: Any) -> None:
        del content["y"]
        which = int(rng.integers(7))
        if which == 0:
            content.create_dataset("y", (10**12,), "f8", chunks=(1024,))
        elif which == 1:
            content.create_dataset("y", data=np.zeros(N, dtype=[("real", "f8"), ("imag", "f8")]))
        elif which == 2:
            content.create_dataset("y", data=[b"text"] * N)
        elif which == 3:
            content.create_dataset("y", data=h5py.Empty("f8"))
        elif which == 4:
            content.create_group("y")["z"] = Y
        elif which == 5:
            references = content.create_dataset("y", (N,), h5py.ref_dtype)
            references[0] = content["t"].ref
        else:
            content.create_dataset("y", data=np.ones((N, 3)))

    return mat73(edit, t=T, y=Y)


def _deep_groups(rng: Rng) -> bytes:
    def edit(content: Any) -> None:
        group = content
        for _ in range(int(rng.integers(50, 400))):
            group = group.create_group("g")
        group["y"] = Y

    return mat73(edit, t=T)


MAT73_KINDS: dict[str, tuple[Callable[[Rng], bytes], str]] = {
    "links elsewhere": (_links, "refused"),
    "odd dataset": (_odd_dataset, "refused"),
    "deep groups": (_deep_groups, "refused"),
    "lengths differ": (lambda r: mat73(t=T, y=Y[: int(r.integers(2, N - 1))]), "refused"),
    "many variables": (
        lambda r: mat73(
            lambda f: [f.create_dataset(f"v{i}", data=1.0) for i in range(4200)] and None, t=T, y=Y
        ),
        "refused",
    ),
    "no time": (lambda r: mat73(y=Y), "refused"),
}


def _waveform(rng: Rng) -> bytes:
    step = [np.nan, np.inf, 0.0, -0.01, 1e300, 1e-300, "0.01", 5][int(rng.integers(8))]
    start = [0.0, np.nan, -np.inf, "x"][int(rng.integers(4))]
    return tdms(y=(Y, {"wf_increment": step, "wf_start_offset": start}))


TDMS_KINDS: dict[str, tuple[Callable[[Rng], bytes], str]] = {
    "odd waveform": (_waveform, "either"),
    "text channel": (lambda r: tdms(t=T, y=np.array(["a"] * N)), "refused"),
    "dates": (lambda r: tdms(t=np.arange(N).astype("M8[ms]"), y=Y), "refused"),
    "lengths differ": (lambda r: tdms(t=T, y=Y[: int(r.integers(1, N - 1))]), "refused"),
    "no channels": (lambda r: tdms(), "refused"),
    "integers": (lambda r: tdms(t=T, y=(Y * 1000).astype("i2")), "either"),
    "complex": (lambda r: tdms(t=T, y=Y + 0j), "refused"),
    "odd names": (
        lambda r: tdms(**{"t": T, str(r.choice(["'", "/", "\x00", "y'/'z", ""])): Y}),
        "either",
    ),
}


def _odd_column(rng: Rng) -> bytes:
    import decimal as dec

    import pyarrow as pa

    column = [
        pa.array(["a"] * N),
        pa.array([[1.0]] * N),
        pa.array([dec.Decimal("1.5")] * N),
        pa.array(np.arange(N).astype("M8[ms]")),
        pa.array([None] * N),
        pa.array([True] * N),
        pa.array([{"a": 1}] * N),
        pa.array(["1.5"] * N).dictionary_encode(),
    ][int(rng.integers(8))]
    return parquet(t=T, y=column)


def _repeated_columns(rng: Rng) -> bytes:
    import pyarrow as pa
    import pyarrow.parquet as pq

    stream = io.BytesIO()
    pq.write_table(
        pa.Table.from_arrays([pa.array(T), pa.array(Y), pa.array(Y * 0)], ["t", "y", "y"]), stream
    )
    return stream.getvalue()


PARQUET_KINDS: dict[str, tuple[Callable[[Rng], bytes], str]] = {
    "odd column": (_odd_column, "refused"),
    "repeated columns": (_repeated_columns, "refused"),
    "missing values": (
        lambda r: parquet(
            t=T, y=[None if v else y for v, y in zip(r.random(N) < r.uniform(0, 0.3), Y)]
        ),
        "either",
    ),
    "no rows": (lambda r: parquet(t=T[:0], y=Y[:0]), "refused"),
    "many columns": (
        lambda r: parquet(t=T[:2], **{f"c{i}": Y[:2] for i in range(4200)}),
        "refused",
    ),
    "integers": (lambda r: parquet(t=T, y=(Y * 1000).astype("i8")), "either"),
    "false footer": (
        lambda r: (lambda raw: raw[:-8] + struct.pack("<I", int(r.integers(0, 2**32))) + b"PAR1")(
            parquet(t=T, y=Y)
        ),
        "refused",
    ),
}
OWN_KINDS = {
    "npz": NPZ_KINDS,
    "mat5": MAT5_KINDS,
    "mat73": MAT73_KINDS,
    "tdms": TDMS_KINDS,
    "parquet": PARQUET_KINDS,
}


def bad_own(reader: str, kind: str, rng: Rng) -> BadInput:
    """What only this format can get wrong."""
    make, must = OWN_KINDS[reader][kind]
    file = name_of(reader)
    return BadInput(reader, kind, entry(file).encode(), {file: make(rng)}, None, must)


# --------------------------------------------------------------------------- campaign.toml

GOOD_TOML = entry("a.csv")
GOOD_CSV = table({"t": T, "y": Y}).encode()
ODD_VALUES = (
    '""',
    '" "',
    "1",
    "-1",
    "0",
    "1.5",
    "true",
    "[]",
    "{}",
    "[[]]",
    '["1 s"]',
    '["5 s", "1 s"]',
    "nan",
    "inf",
    "1979-05-27",
    "0xFF",
    '"4 L/min"',
    '"2 s"',
    '"-4 L/min"',
    '"0 L/min"',
    '"1e999 s"',
    '"1e-999 s"',
    '"nan s"',
    '"4,0 L/min"',
    '"4 furlong"',
    '"9**9**9**9 s"',
    '"1 s**-999999999"',
    "\"__import__('os') s\"",
    '"4 L/min/min"',
    '"1 degC"',
    '"5 dB"',
    '"\\u0000"',
    '"\\u001b[2J"',
    '"' + "9" * 900 + '"',
    '"٣ s"',
    '"½ s"',
    '"4 L\\u2215min"',
    '"a" * 9',
    "'''\n\n'''",
    '"../a.csv"',
    '"/etc/passwd"',
    '"~/a.csv"',
    '"a.csv\\u202e"',
    '"file:///a.csv"',
    '"http://localhost/a.csv"',
    '"CON.csv"',
    '"a.csv/"',
    '"./././a.csv"',
    '"' + "x/" * 300 + 'a.csv"',
    '"C:\\\\a.csv"',
)
KEYS = (
    "name",
    "file",
    "carrier_flow",
    "test_gas_flow",
    "commanded_on",
    "commanded_off",
    "signal",
    "drive",
    "signal_unit",
    "keep",
    "mask",
    "interval",
    "duration",
    "colour",
    '"a b"',
    "carrier-flow",
    "'\\n'",
)


def _toml(text: str | bytes, kind: str, must: str = "either", **more: Any) -> BadInput:
    raw = text if isinstance(text, bytes) else text.encode("utf-8", "surrogatepass")
    files = more.pop("files", {"a.csv": GOOD_CSV})
    return BadInput("toml", kind, raw, files, more.pop("prepare", None), must)


def odd_value(rng: Rng) -> BadInput:
    key = KEYS[int(rng.integers(len(KEYS)))]
    value = ODD_VALUES[int(rng.integers(len(ODD_VALUES)))]
    return _toml(entry("a.csv", **{key: value}), "odd value")


def missing_key(rng: Rng) -> BadInput:
    key = KEYS[int(rng.integers(4))]
    return _toml(entry("a.csv", **{key: None}), "missing key", "refused")


def damaged_toml(rng: Rng) -> BadInput:
    kind = str(rng.choice(list(BYTE_KINDS)))
    return _toml(BYTE_KINDS[kind](GOOD_TOML.encode(), rng), f"campaign file: {kind}")


def encoded_toml(rng: Rng) -> BadInput:
    code = str(rng.choice(["utf-16", "utf-16-le", "utf-16-be", "utf-32", "utf-8-sig", "cp500"]))
    end = str(rng.choice(["\n", "\r\n", "\r"]))
    raw = GOOD_TOML.replace("\n", end).encode(code)
    must = "read" if code == "utf-8-sig" and end != "\r" else "refused"
    return _toml(raw, "campaign file: encodings and line ends", must)


def bomb(rng: Rng) -> BadInput:
    n = int(10 ** rng.uniform(1.5, 4.5))
    texts = [
        "x = " + "[" * n,
        "x = " + "[" * n + "]" * n,
        "x = " + "{a=" * n + "1" + "}" * n,
        ".".join(["a"] * n) + " = 1",
        "[" + ".".join(["a"] * n) + "]",
        "x = " + "9" * n,
        "x = 1e" + "9" * n,
        'x = "' + "\\u0041" * n + '"',
        "\n".join(f"k{i} = 1" for i in range(n)),
        "\n".join(f"[t{i}.a.b.c]" for i in range(n)),
        "[[experiment]]\n" * n,
        GOOD_TOML * min(n, 3000),
        "\n".join(f"a{i}.b.c.d.e.f = {{}}" for i in range(n)),
        "# " + "x" * n,
        '"""' + "\n" * n,
        "experiment = [" + "{}," * n + "]",
        "x = 0x" + "f" * n,
        "x = 0." + "1" * n,
        "\n".join("[a" + ".a" * (i % 15) + "]" for i in range(n)),
        "x = [" + "[],\n" * n + "]",
        "mask = [" + '["1 s","2 s"],\n' * n + "]",
        "title = '" + "x" * n + "'",
    ]
    return _toml(texts[int(rng.integers(len(texts)))] + "\n", "TOML bomb", "refused")


def many_masks(rng: Rng) -> BadInput:
    n = int(10 ** rng.uniform(1, 4))
    ranges = ",\n".join(f'["{i % 7 + 0.001:.3f} s", "{i % 7 + 0.002:.3f} s"]' for i in range(n))
    return _toml(entry("a.csv", mask=f"[\n{ranges}\n]"), "thousands of masks")


def outside(rng: Rng) -> BadInput:
    allowed = bool(rng.integers(2))
    where = int(rng.integers(4))

    def prepare(folder: Path) -> None:
        (folder.parent / "outside.csv").write_bytes(GOOD_CSV)
        if where == 1:
            (folder / "a.csv").symlink_to(folder.parent / "outside.csv")
        elif where == 2:
            (folder / "sub").symlink_to(folder.parent, target_is_directory=True)
        elif where == 3:
            (folder / "b.csv").symlink_to("a.csv")
            (folder / "a.csv").symlink_to("../outside.csv")

    file = ("../outside.csv", "a.csv", "sub/outside.csv", "b.csv")[where]
    head = "allow_outside = true\n" if allowed else ""
    return _toml(
        head + entry(file),
        "path outside, allowed" if allowed else "path outside",
        "read" if allowed else "refused",
        prepare=prepare,
        files={},
    )


def links(rng: Rng) -> BadInput:
    which = int(rng.integers(5))

    def prepare(folder: Path) -> None:
        if which == 0:
            (folder / "a.csv").symlink_to("a.csv")
        elif which == 1:
            (folder / "a.csv").symlink_to("b.csv")
            (folder / "b.csv").symlink_to("a.csv")
        elif which == 2:
            (folder / "a.csv").symlink_to("nowhere.csv")
        elif which == 3:
            (folder / "real").write_bytes(GOOD_CSV)
            (folder / "a.csv").symlink_to("real")
        else:
            (folder / "a.csv").symlink_to("/dev/zero")

    return _toml(GOOD_TOML, "links", "read" if which == 3 else "refused", prepare=prepare, files={})


def not_a_file(rng: Rng) -> BadInput:
    which = int(rng.integers(5))

    def prepare(folder: Path) -> None:
        if which == 0:
            (folder / "a.csv").mkdir()
        elif which == 1:
            os.mkfifo(folder / "a.csv")
        elif which == 2:
            (folder / "a.csv").write_bytes(b"")
        elif which == 3:
            with (folder / "a.csv").open("wb") as sparse:
                sparse.truncate(int(rng.integers(1, 20)) << 30)

    return _toml(GOOD_TOML, "not a regular file", "refused", prepare=prepare, files={})


def unreadable(rng: Rng) -> BadInput:
    target = str(rng.choice(["a.csv", "campaign.toml"]))

    def prepare(folder: Path) -> None:
        (folder / target).chmod(0)

    return _toml(GOOD_TOML, "unreadable", "refused", prepare=prepare)


TOML_KINDS: dict[str, Callable[[Rng], BadInput]] = {
    "odd value": odd_value,
    "missing key": missing_key,
    "campaign file damaged": damaged_toml,
    "campaign file encoded": encoded_toml,
    "TOML bomb": bomb,
    "thousands of masks": many_masks,
    "path outside": outside,
    "links": links,
    "not a regular file": not_a_file,
    "unreadable": unreadable,
}


# --------------------------------------------------------------------------- generating

Recipe = tuple[str, Callable[[Rng], BadInput]]


def recipes() -> list[Recipe]:
    """Every (reader, maker): one for each kind that the reader can meet."""
    found: list[Recipe] = []
    for reader in READERS:
        for kind in DATA_KINDS:
            found.append((reader, lambda r, a=reader, k=kind: bad_data(a, k, r)))
        for kind in BYTE_KINDS:
            found.append((reader, lambda r, a=reader, k=kind: bad_bytes(a, k, r)))
        found.append((reader, lambda r, a=reader: another_format(a, r)))
        for kind in TEXT_KINDS if reader in ("csv", "tsv") else ():
            found.append((reader, lambda r, a=reader, k=kind: bad_text(a, k, r)))
        for kind in OWN_KINDS.get(reader, ()):
            found.append((reader, lambda r, a=reader, k=kind: bad_own(a, k, r)))
    found += [("toml", make) for make in TOML_KINDS.values()]
    return found


def generate(seed: int, n: int, start: int = 0) -> Iterator[BadInput]:
    """Bad inputs number ``start`` to ``start + n``, every recipe in its turn."""
    makers = recipes()
    order = random.Random(seed).sample(range(len(makers)), len(makers))
    for i in range(start, start + n):
        rng = np.random.default_rng([seed, i])
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            yield makers[order[i % len(makers)]][1](rng)


# --------------------------------------------------------------------------- judging


class Misjudged(AssertionError):
    """A bad input that was neither refused with one clear message nor read correctly."""


REFUSED, SAME, FEWER, AS_WRITTEN, WARNED = (
    "refused",
    "same as the clean file",
    "same where there are samples",
    "as the file says",
    "read with a warning",
)
OUTCOMES = (REFUSED, SAME, FEWER, AS_WRITTEN, WARNED)
SECONDS = 20.0
"""of CPU time for one input, before it counts as a hang"""


@dataclass(frozen=True)
class Outcome:
    """What became of a bad input."""

    kind: str
    message: str


@contextmanager
def time_limit(seconds: float) -> Iterator[None]:
    """Raise Misjudged when the block takes so long of CPU time, or fifteen times by the clock."""

    def stop(_signal: int, _frame: Any) -> None:
        raise Misjudged(f"hangs: not done within {seconds:.0f} s")

    # CPU time, so that a busy machine is no hang; waiting for ever, as on a pipe, is one
    timers = ((signal.SIGPROF, signal.ITIMER_PROF, 1.0), (signal.SIGALRM, signal.ITIMER_REAL, 15.0))
    before = [signal.signal(name, stop) for name, _, _ in timers]
    for _, timer, times in timers:
        signal.setitimer(timer, times * seconds)
    try:
        yield
    finally:
        for (name, timer, _), old in zip(timers, before):
            signal.setitimer(timer, 0.0)
            signal.signal(name, old)


@contextmanager
def without_privileges() -> Iterator[None]:
    """As somebody whom permissions bind, where this process is the superuser."""
    root = os.geteuid() == 0
    if root:
        os.seteuid(65534)
    try:
        yield
    finally:
        if root:
            os.seteuid(0)


def write(bad: BadInput, folder: Path) -> Path:
    """The campaign's file in ``folder``, which is made."""
    folder.mkdir(parents=True)
    for name, content in bad.files.items():
        (folder / name).write_bytes(content)
    (folder / "campaign.toml").write_bytes(bad.toml)
    if bad.prepare is not None:
        bad.prepare(folder)
    return folder / "campaign.toml"


def listing(folder: Path) -> list[tuple[str, int]]:
    """Names and sizes of everything in the folder."""
    return sorted((str(p.relative_to(folder)), p.lstat().st_size) for p in folder.rglob("*"))


def is_clear(line: str) -> str:
    """What is wrong with a message; empty where it says where, what and what to do."""
    if "\n" in line.strip() or not line.startswith("error: "):
        return "not one line that begins with 'error: '"
    if "Traceback" in line or "pydantic" in line or "Error(" in line:
        return "shows the inside of the program"
    if not 40 <= len(line) <= 2100:
        return f"{len(line)} characters long"
    if not re.search(r"a\.\w+|b\.csv|campaign\.toml|experiment|outside\.csv", line):
        return "names no place"
    if ";" not in line and line.count(": ") < 3:
        return "does not say what to do"
    if any(not c.isprintable() for c in line.strip("\n")):
        return "has control characters"
    return ""


def judge(
    bad: BadInput, folder: Path, run: Callable[[Path], tuple[int, str]] | None = None
) -> Outcome:
    """What became of it; raises Misjudged.  ``run`` gives exit code and stderr of ``check``."""
    path = write(bad, folder)
    before = listing(folder.parent)
    bound = without_privileges() if bad.kind == "unreadable" else nullcontext()
    try:
        with bound, time_limit(SECONDS):
            code, stderr = (run or check_in_process)(path)
    except Misjudged:
        raise
    except BaseException as error:
        raise Misjudged(f"{type(error).__name__}: {error}") from error
    if listing(folder.parent) != before or Path(TRAP).exists():
        raise Misjudged("something was written, or a pickle was loaded")
    if code == 2:
        trouble = is_clear(stderr)
        if trouble:
            raise Misjudged(f"the message is {trouble}: {stderr!r:.300}")
        if bad.must == "read":
            raise Misjudged(f"refused although it is good: {stderr}")
        return Outcome(REFUSED, stderr.strip())
    if code != 0 or stderr:
        raise Misjudged(f"exit code {code}, stderr {stderr!r:.300}")
    if bad.must == "refused":
        raise Misjudged("read although it must be refused")
    with time_limit(SECONDS):
        return compare(bad, read_campaign(path), path)


def check_in_process(path: Path) -> tuple[int, str]:
    """Exit code and stderr of ``bayes-sensor check`` without a new process."""
    err = io.StringIO()
    with redirect_stdout(io.StringIO()), redirect_stderr(err):
        code = exit_code(["check", str(path)])
    return code, err.getvalue()


def compare(bad: BadInput, campaign: Campaign, path: Path) -> Outcome:
    """Whether what was read is right: the clean numbers, the file's own, or warned about."""
    remarks = campaign_remarks(campaign)
    (e,) = campaign
    y = e.values[e.used]
    if not np.isfinite(e.values).all() or not np.isfinite(e.t).all():
        raise Misjudged("read with numbers that are not finite")
    at = np.rint(e.t[e.used] / INTERVAL).astype(int)
    near = (at >= 0) & (at < N) & (np.abs(e.t[e.used] - at * INTERVAL) < 1e-3 * INTERVAL)
    if near.all() and np.allclose(y, Y[at], rtol=0, atol=2e-6) and e.interval == INTERVAL:
        if len(y) == N:
            return Outcome(SAME, "")
        if len(y) == len(e.t) or remarks:
            return Outcome(FEWER, "; ".join(remarks))
    if remarks:
        return Outcome(WARNED, "; ".join(remarks))
    t_file, y_file = plainly(bad, path.parent / str(e.source))
    if len(t_file) == len(y) and np.allclose(
        e.t[e.used], t_file, rtol=1e-9, atol=0.31 * e.interval
    ):
        scale = max(float(np.abs(y_file).max()), 1e-300)
        if np.allclose(y, y_file, rtol=1e-9, atol=1e-12 * scale):
            return Outcome(AS_WRITTEN, "")
    raise Misjudged(f"read without a warning, but as {len(y)} samples that the file does not hold")


def plainly(bad: BadInput, file: Path) -> tuple[np.ndarray, np.ndarray]:
    """Times and signal of a file by the plainest reader there is."""
    raw = file.read_bytes()
    if file.suffix in (".csv", ".tsv"):
        return plain_table(raw, bad.dialect)
    if file.suffix == ".npz":
        with np.load(file, allow_pickle=False) as content:
            return np.ravel(content["t"]).astype(float), np.ravel(content["y"]).astype(float)
    if file.suffix == ".parquet":
        import pyarrow.parquet as pq

        frame = pq.read_table(file)
        return np.array(frame["t"], dtype=float), np.array(frame["y"], dtype=float)
    if file.suffix == ".tdms":
        from nptdms import TdmsFile

        group = TdmsFile.read(file).groups()[0]
        channels = {c.name: c for c in group.channels()}
        signal_channel = next(c for c in channels.values() if c.name != "t")
        y = np.asarray(signal_channel[:], dtype=float)
        t = (
            np.asarray(channels["t"][:], dtype=float)
            if "t" in channels
            else (
                float(signal_channel.properties["wf_start_offset"])
                + np.arange(len(y)) * float(signal_channel.properties["wf_increment"])
            )
        )
        return t, y
    import h5py

    if b"\x89HDF" in raw[:4096]:
        with h5py.File(file, "r") as content:
            return np.ravel(content["t"][()]).astype(float), np.ravel(content["y"][()]).astype(
                float
            )
    from scipy.io import loadmat

    found = loadmat(file)
    y = np.ravel(found["y"] if "y" in found else found["A"]).astype(float)
    if "t" in found:
        return np.ravel(found["t"]).astype(float), y
    start = float(np.ravel(found.get("Tstart", 0.0))[0])
    return start + np.arange(len(y)) * float(np.ravel(found["Tinterval"])[0]), y


def plain_table(raw: bytes, dialect: tuple[str, str, str] | None) -> tuple[np.ndarray, np.ndarray]:
    """The first two numbers of every row that has two, under the dialect that gives most rows."""
    best: list[tuple[float, float]] = []
    dialects = (
        [dialect]
        if dialect
        else [
            (s, d, c)
            for s in (",", ";", "\t", " ")
            for d in (".", ",")
            for c in ("utf-8", "utf-16", "latin-1")
        ]
    )
    for separator, decimal, code in dialects:
        try:
            text = raw.decode(code)
        except UnicodeError:
            if dialect is None:
                continue
            text = raw.decode("latin-1")
        rows = []
        for line in re.split(r"\r\n|\n|\r", text):
            try:
                cells = next(csv.reader([line], delimiter=separator), [])
                cells = [c.strip().replace(decimal, ".") for c in cells if c.strip()]
                rows.append((float(cells[0]), float(cells[1])))
            except (ValueError, IndexError, csv.Error):
                continue
        if len(rows) > len(best):
            best = rows
    t, y = np.array(best).reshape(-1, 2).T
    return t, y


def remove(folder: Path) -> None:
    """Remove a case's folder, whatever was done to it."""
    import shutil

    for path in (folder, *folder.rglob("*")):
        if not path.is_symlink():
            path.chmod(path.stat().st_mode | stat.S_IRWXU)
    shutil.rmtree(folder)


__all__ = ["OUTCOMES", "BadInput", "CampaignError", "Misjudged", "Outcome", "generate", "judge"]
