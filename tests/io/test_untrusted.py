"""Files of a results folder are read within limits, and what is no such file is refused."""

import io
import json
import os
import zipfile
from contextlib import nullcontext
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from bayes_sensor.campaign import CampaignError
from bayes_sensor.io.untrusted import (
    ALWAYS_ALLOWED,
    LARGEST_RATIO,
    check_size,
    parse_json,
    read_arrays,
    read_bytes,
    read_json,
)


def member(array: Any, header: bytes | None = None) -> bytes:
    """One array as NumPy writes it, or with another header of the same length before its bytes."""
    buffer = io.BytesIO()
    np.lib.format.write_array(buffer, np.asanyarray(array), allow_pickle=True)
    if header is None:
        return buffer.getvalue()
    padded = header.ljust(117) + b"\n"
    return b"\x93NUMPY\x01\x00" + len(padded).to_bytes(2, "little") + padded + bytes(80)


def archive(path: Path, *members: tuple[str, bytes], method: int = zipfile.ZIP_STORED) -> Path:
    with zipfile.ZipFile(path, "w", method) as made:
        for name, content in members:
            made.writestr(name, content)
    return path


# --- the file itself


def test_a_file_is_read_up_to_its_limit(tmp_path: Path) -> None:
    path = tmp_path / "a.json"
    path.write_bytes(b"12345")
    assert read_bytes(path, 5) == b"12345"
    with pytest.raises(CampaignError, match=r"it has 5 bytes, and at most 4 are read"):
        read_bytes(path, 4)
    with pytest.raises(CampaignError, match="there is no such file"):
        read_bytes(tmp_path / "b.json", 4)
    with pytest.raises(CampaignError, match="cannot be read"):
        read_bytes(f"{path}\0", 4)


def test_a_file_that_grows_meanwhile_is_refused(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = tmp_path / "a.json"
    path.write_bytes(b"1234567")
    status = os.fstat

    def before(descriptor: int) -> os.stat_result:
        found = [*status(descriptor)]
        found[6] = 3  # its size
        return os.stat_result(found)

    monkeypatch.setattr(os, "fstat", before)
    with pytest.raises(CampaignError, match="it grew while it was read"):
        read_bytes(path, 5)


@pytest.mark.skipif(not hasattr(os, "mkfifo"), reason="the system has no named pipes")
def test_only_a_regular_file_of_its_own_is_opened(tmp_path: Path) -> None:
    (tmp_path / "a.json").write_text("{}")
    (tmp_path / "link.json").symlink_to("a.json")
    os.mkfifo(tmp_path / "pipe.json")
    (tmp_path / "folder.json").mkdir()
    for name, words in (
        ("link", "links inside a results folder are not followed"),
        ("pipe", "it is not a regular file"), ("folder", "cannot be read"),
    ):  # fmt: skip
        with pytest.raises(CampaignError, match=words):
            read_json(tmp_path / f"{name}.json")


# --- JSON


@pytest.mark.parametrize(
    ("content", "words"),
    [
        (b'{"a": 1, "a": 2}', "the key 'a' stands twice"),
        (b'{"b": [{"a": 1, "c": 0, "a": 1}]}', "the key 'a' stands twice"),
        (b"[1e999]", "out of range"),
        (b"[NaN]", "cannot be read"),
        (b"[-Infinity]", "cannot be read"),
        (b"[" * 300 + b"]" * 300, "cannot be read"),
        (b"\xff", "cannot be read"),
        (b"", "cannot be read"),
        ('{"a": 1}'.encode("utf-16"), "cannot be read"),
    ],
)
def test_json_that_is_none_or_says_two_things_is_refused(content: bytes, words: str) -> None:
    with pytest.raises(CampaignError, match=words):
        parse_json(content, "a.json")


def test_json_comes_back_as_it_was() -> None:
    content = {"a": [1, -2.5e-300, None, True, "\u00e9"], "b": {"c": 10**30}}
    assert parse_json(json.dumps(content).encode(), "a.json") == content


# --- archives


@pytest.mark.parametrize(
    "array",
    [
        np.arange(6.0).reshape(2, 3), np.asfortranarray(np.arange(6.0).reshape(2, 3)),
        np.array(3), np.zeros((0, 4)), np.array(["a", "\u00e9"]), np.array([True, False]),
        np.arange(3, dtype=">f8"), np.array([1 + 2j]), np.zeros(2, dtype="u1"),
    ],
    ids=str,
)  # fmt: skip
def test_an_array_comes_back_bit_for_bit(tmp_path: Path, array: np.ndarray) -> None:
    path = archive(tmp_path / "a.npz", ("x.npy", member(array)))
    found = read_arrays(path, "arrays")["x"]
    assert found.dtype == array.dtype and found.shape == array.shape
    np.testing.assert_array_equal(found, array)


HEADER = "{'descr': '%s', 'fortran_order': False, 'shape': %s, }"
DAMAGED = {
    "twice": ([("x.npy", member(1.0)), ("x.npy", member(2.0))], "an array stands twice"),
    "objects": ([("x.npy", member(np.array([{}], dtype=object)))], "numbers or texts belong"),
    "bytes": ([("x.npy", member(np.array([b"a"])))], "numbers or texts belong"),
    "dates": ([("x.npy", member(np.array(["2024"], dtype="M8[Y]")))], "numbers or texts belong"),
    "longer": ([("x.npy", member(0, (HEADER % ("<f8", "(11,)")).encode()))], "another length"),
    "shorter": ([("x.npy", member(0, (HEADER % ("<f8", "(9,)")).encode()))], "another length"),
    "vast": ([("x.npy", member(0, (HEADER % ("<f8", "(10**9,)")).encode()))], "is damaged"),
    "negative": ([("x.npy", member(0, (HEADER % ("<f8", "(-1,-10)")).encode()))], "negative"),
    "not a header": ([("x.npy", member(0, b"{'descr': open}"))], "is damaged"),
    "another format": ([("x.npy", b"\x93NUMPY\x03\x00" + bytes(200))], "another format"),
    "no array": ([("x.npy", b"text")], "cannot be read"),
}


@pytest.mark.parametrize("kind", DAMAGED)
def test_an_archive_that_is_damaged_is_refused(tmp_path: Path, kind: str) -> None:
    members, words = DAMAGED[kind]
    path = tmp_path / "a.npz"
    with pytest.warns(UserWarning, match="Duplicate name") if kind == "twice" else nullcontext():
        archive(path, *members)
    with pytest.raises(CampaignError, match=words) as told:
        read_arrays(path, "arrays")
    assert "pickle" not in str(told.value)


@pytest.mark.parametrize("method", [zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED])
def test_a_checksum_that_is_not_the_contents_is_seen(tmp_path: Path, method: int) -> None:
    path = archive(tmp_path / "a.npz", ("x.npy", member(np.arange(100.0))), method=method)
    with zipfile.ZipFile(path) as made:
        checksum = made.getinfo("x.npy").CRC.to_bytes(4, "little")
    path.write_bytes(path.read_bytes().replace(checksum, bytes(4)))
    with pytest.raises(CampaignError, match="CRC"):
        read_arrays(path, "arrays")


def test_an_archive_may_unpack_to_as_much_as_measurements_do(tmp_path: Path) -> None:
    check_size(ALWAYS_ALLOWED, 1)
    packed = ALWAYS_ALLOWED
    check_size(LARGEST_RATIO * packed, packed)
    for unpacked, size in ((ALWAYS_ALLOWED + 1, 1), (LARGEST_RATIO * packed + 1, packed)):
        with pytest.raises(ValueError, match="would unpack"):
            check_size(unpacked, size)
    zeros = member(np.zeros(ALWAYS_ALLOWED // 4))
    path = archive(tmp_path / "a.npz", ("x.npy", zeros), method=zipfile.ZIP_DEFLATED)
    with pytest.raises(CampaignError, match="would unpack"):
        read_arrays(path, "arrays")
