"""Files of a results folder, which may come from anyone, read within limits.

A file is opened only where it is a regular file of its own: no link is followed, no pipe waited
for.  Its size is looked at before it is read, its depth before it is parsed, and what an archive
would unpack to before anything is unpacked.
"""

from __future__ import annotations

import errno
import io
import json
import lzma
import os
import stat
import zipfile
import zlib
from pathlib import Path
from typing import Any

import numpy as np

from bayes_sensor.campaign import CampaignError

LARGEST_JSON = 32 << 20
LARGEST_FILE = 2 << 30
"""bytes: those of fifty records of two minutes at 10 kHz fit in"""
LARGEST_RATIO, ALWAYS_ALLOWED = 100, 16 << 20
"""an archive may unpack to so many times its size, or to so many bytes: measurements are noisy, and
zeros in their masks are few beside them"""
KINDS = "biufcU"
"""of NumPy arrays that are read: no objects"""
MADE_AGAIN = "mend it, or run the command that made it again in a new folder"
UNREADABLE = (
    OSError, ValueError, KeyError, IndexError, EOFError, AttributeError, TypeError, SyntaxError,
    OverflowError, MemoryError, RuntimeError, zlib.error, lzma.LZMAError, zipfile.BadZipFile,
)  # fmt: skip
"""what the readers of NumPy, zip and HDF5 raise on damaged bytes"""


def refused(path: str | os.PathLike[str], expected: str, found: object) -> CampaignError:
    """The error for a file of a results folder that cannot be used."""
    said = " ".join(str(found).split())
    said = said if len(said) <= 200 else f"{said[:197]}..."
    return CampaignError(f"{path}: expected {expected}, but {said}; {MADE_AGAIN}")


def read_bytes(path: str | os.PathLike[str], most: int, expected: str = "a saved result") -> bytes:
    """The content of a regular file of at most ``most`` bytes.

    Raises
    ------
    CampaignError
        For anything else in its place: a link, a folder, a pipe, nothing, or too much.
    """
    path = Path(path)
    flags = os.O_RDONLY
    for name in ("O_NOFOLLOW", "O_NONBLOCK", "O_CLOEXEC", "O_BINARY"):  # not on every system
        flags |= getattr(os, name, 0)
    try:
        if path.is_symlink():  # where there is no O_NOFOLLOW
            raise OSError(errno.ELOOP, "a link")
        with os.fdopen(os.open(path, flags), "rb") as stream:
            status = os.fstat(stream.fileno())
            if not stat.S_ISREG(status.st_mode):
                raise refused(path, expected, "it is not a regular file")
            if status.st_size > most:
                told = f"it has {status.st_size} bytes, and at most {most} are read"
                raise refused(path, expected, told)
            content = stream.read(most + 1)
    except FileNotFoundError:
        raise refused(path, expected, "there is no such file") from None
    except (OSError, ValueError) as error:  # no permission; a zero byte in the name
        if isinstance(error, CampaignError):
            raise
        if isinstance(error, OSError) and error.errno == errno.ELOOP:
            what = "it is a symbolic link, and links inside a results folder are not followed"
        else:
            what = f"it cannot be read ({getattr(error, 'strerror', None) or error})"
        raise refused(path, expected, what) from None
    if len(content) > most:
        raise refused(path, expected, "it grew while it was read")
    return content


def _once(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
    content = dict(pairs)
    if len(content) < len(pairs):
        keys = [key for key, _ in pairs]
        twice = next(key for key in keys if keys.count(key) > 1)
        raise ValueError(f"the key '{twice[:60]}' stands twice")
    return content


def _finite(text: str) -> float:
    value = float(text)
    if value - value != 0.0:
        raise ValueError(f"{text[:60]} is out of range")
    return value


def parse_json(content: bytes, path: str | os.PathLike[str]) -> Any:
    """JSON within limits: UTF-8, each key once, finite numbers, at most 200 levels deep."""
    from pydantic_core import from_json  # checks all but keys and range, and never recurses deep

    expected = "a saved result in JSON"
    try:
        from_json(content, allow_inf_nan=False)
        return json.loads(content, object_pairs_hook=_once, parse_float=_finite)
    except (ValueError, RecursionError) as error:
        raise refused(path, expected, f"it cannot be read ({error})") from None


def read_json(path: str | os.PathLike[str]) -> Any:
    """The content of a JSON file; CampaignError says what is wrong with it."""
    return parse_json(read_bytes(path, LARGEST_JSON, "a saved result in JSON"), path)


# --------------------------------------------------------------------------- NumPy archives


def read_arrays(path: str | os.PathLike[str], what: str) -> dict[str, np.ndarray]:
    """All arrays of a NumPy archive by name; ``what`` they are, for the message.

    Raises CampaignError for what is damaged, holds pickled objects or unpacks to too much.
    """
    expected = f"saved {what}"
    content = read_bytes(path, LARGEST_FILE, expected)
    try:
        with zipfile.ZipFile(io.BytesIO(content)) as archive:
            members = archive.infolist()
            check_size(sum(each.file_size for each in members), len(content))
            names = [each.filename.removesuffix(".npy") for each in members]
            if len({*names}) < len(names):
                raise ValueError("an array stands twice in it")
            return {name: _array(archive, each) for name, each in zip(names, members, strict=True)}
    except UNREADABLE as error:
        raise refused(path, expected, f"they cannot be read ({error})") from None


def check_size(unpacked: int, packed: int) -> None:
    """Raise ValueError where an archive would unpack to more than measurements do."""
    if unpacked > max(ALWAYS_ALLOWED, min(LARGEST_RATIO * packed, LARGEST_FILE)):
        raise ValueError(f"{packed} bytes would unpack to {unpacked}")


def _array(archive: zipfile.ZipFile, member: zipfile.ZipInfo) -> np.ndarray:
    stream: Any
    with archive.open(member) as stream:
        header: Any = {
            (1, 0): np.lib.format.read_array_header_1_0,
            (2, 0): np.lib.format.read_array_header_2_0,
        }.get(np.lib.format.read_magic(stream))
        if header is None:
            raise ValueError("an array has another format")
        try:
            shape, fortran, dtype = header(stream)
        except ValueError:  # NumPy's own words advise to load it unsafely
            raise ValueError("the header of an array is damaged") from None
        if dtype.hasobject or dtype.kind not in KINDS:
            raise ValueError(f"an array of {str(dtype)[:40]}, where numbers or texts belong")
        if any(n < 0 for n in shape):
            raise ValueError("an array has a negative length")
        count = int(np.prod(shape, dtype=object)) if shape else 1
        length = count * dtype.itemsize
        if length != member.file_size - stream.tell():
            raise ValueError(f"an array of shape {str(shape)[:60]} has another length")
        content = bytearray(length)
        with memoryview(content) as view:
            at = 0
            while at < length:
                got = stream.readinto(view[at:])
                if not got:
                    raise EOFError("an array is cut off")
                at += got
        stream.read(1)  # at the end its checksum is compared
    array = np.frombuffer(content, dtype) if count and length else np.empty(count, dtype)
    return array.reshape(shape, order="F" if fortran else "C")
