"""Hostile and broken input: refused with one clear message, or read correctly; never anything else.

The inputs come from ``bad_inputs``; ``paper/studies/study_hostile.py`` runs thousands of them.
"""

import os
import subprocess
import sys
import tempfile
from collections import Counter
from pathlib import Path
from typing import IO

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from bayes_sensor.io.readers import read_campaign
from tests.support.bad_inputs import (
    DATA_KINDS,
    DIALECTS,
    GOOD_CSV,
    GOOD_TOML,
    INTERVAL,
    OUTCOMES,
    READERS,
    REFUSED,
    SAME,
    WRITERS,
    BadInput,
    Misjudged,
    N,
    T,
    Y,
    check_in_process,
    entry,
    generate,
    is_clear,
    judge,
    name_of,
    recipes,
    remove,
    table,
    time_limit,
    write,
)

PIECES = 8
FUZZ = settings(max_examples=60, suppress_health_check=list(HealthCheck))


@pytest.fixture
def open_folder(tmp_path: Path) -> Path:
    """A folder that others may read: pytest's own are closed to them."""
    for folder in (tmp_path, *tmp_path.parents):
        if folder.stat().st_uid == os.geteuid() and str(folder).startswith(tempfile.gettempdir()):
            folder.chmod(folder.stat().st_mode | 0o055)
    return tmp_path


@pytest.mark.slow
@pytest.mark.parametrize("piece", range(PIECES))
def test_one_of_every_kind(piece: int, open_folder: Path) -> None:
    n = len(recipes())
    counts: Counter[str] = Counter()
    first, last = piece * n // PIECES, (piece + 1) * n // PIECES
    for i, bad in enumerate(generate(1, last - first, first)):
        case = open_folder / str(i)
        try:
            counts[judge(bad, case / "campaign").kind] += 1
        except Misjudged as error:
            pytest.fail(f"{bad.reader}, {bad.kind} (number {first + i}): {error}")
        finally:
            remove(case)
    assert set(counts) <= set(OUTCOMES)
    assert counts[REFUSED] > (last - first) / 3


@pytest.mark.parametrize("reader", READERS)
def test_the_clean_file_of_every_writer_is_read_as_it_is(reader: str, tmp_path: Path) -> None:
    content = {name_of(reader): WRITERS[reader](t=T, y=Y)}
    bad = BadInput(reader, "nothing", entry(name_of(reader)).encode(), content, None, "read",
                   DIALECTS.get(reader))  # fmt: skip
    assert judge(bad, tmp_path / "case" / "campaign").kind == SAME


def test_the_judge_condemns(tmp_path: Path) -> None:
    good = BadInput("csv", "good", GOOD_TOML.encode(), {"a.csv": GOOD_CSV}, None, "refused")
    with pytest.raises(Misjudged, match="must be refused"):
        judge(good, tmp_path / "1" / "c")
    bad = BadInput("csv", "bad", GOOD_TOML.encode(), {}, None, "read")
    with pytest.raises(Misjudged, match="although it is good"):
        judge(bad, tmp_path / "2" / "c")
    for number, (answer, message) in enumerate(
        (
            ((1, ""), "exit code 1"),
            ((2, "error: no\n"), "characters long"),
            ((2, "Traceback (most recent call last): a.csv: expected; do"), "begins with"),
            (
                (2, "error: experiment '1': it is all wrong and there is nothing to do"),
                "what to do",
            ),
        )
    ):
        with pytest.raises(Misjudged, match=message):
            judge(bad, tmp_path / f"a{number}" / "c", lambda path, answer=answer: answer)

    def breaks(path: Path) -> tuple[int, str]:
        raise KeyError("inside")

    with pytest.raises(Misjudged, match="KeyError: 'inside'"):
        judge(bad, tmp_path / "5" / "c", breaks)
    # another signal than the file's, without a warning
    other = BadInput(
        "csv", "other", GOOD_TOML.encode(), {"a.csv": GOOD_CSV}, dialect=DIALECTS["csv"]
    )

    def forges(path: Path) -> tuple[int, str]:
        (path.parent / "a.csv").write_bytes(table({"t": T, "y": Y + 0.01}).encode())
        return 0, ""

    with pytest.raises(Misjudged, match="written"):
        judge(other, tmp_path / "6" / "c", forges)
    with pytest.raises(Misjudged, match="hangs"), time_limit(0.05):
        _endless()


def _endless() -> None:
    while True:
        sum(range(1000))


def test_a_clear_message_is_recognised() -> None:
    assert is_clear("error: a.csv: expected numbers, but got text; repair row 7\n") == ""
    assert "place" in is_clear("error: expected numbers, but got some text; repair the row\n")


def test_a_file_that_vanishes_while_it_is_read(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = write(
        BadInput("csv", "vanishing", GOOD_TOML.encode(), {"a.csv": GOOD_CSV}), tmp_path / "c"
    )
    data = path.parent / "a.csv"
    stat = Path.stat

    def stat_then_vanish(self: Path, **options: object) -> os.stat_result:
        found = stat(self, **options)  # type: ignore[arg-type]
        if self.name == "a.csv":
            data.unlink(missing_ok=True)
        return found

    monkeypatch.setattr(Path, "stat", stat_then_vanish)
    code, message = check_in_process(path)
    assert code == 2 and "there is no such file" in message and is_clear(message) == ""


def test_a_file_that_grows_while_it_is_read(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    from bayes_sensor.io import readers

    path = write(
        BadInput("csv", "growing", GOOD_TOML.encode(), {"a.csv": GOOD_CSV}), tmp_path / "c"
    )
    monkeypatch.setattr(readers, "LARGEST_FILE", len(GOOD_CSV))
    assert check_in_process(path)[0] == 0
    opened = Path.open

    def grow_then_open(self: Path, *arguments: str) -> IO[bytes]:
        if self.name == "a.csv":
            with opened(self, "ab") as stream:
                stream.write(b"8.0,0.3\n")
        return opened(self, *arguments)

    monkeypatch.setattr(Path, "open", grow_then_open)
    code, message = check_in_process(path)
    assert code == 2 and "the file grew while it was read" in message


@given(data=st.data())
@FUZZ
def test_any_damage_to_any_file(
    tmp_path_factory: pytest.TempPathFactory, data: st.DataObject
) -> None:
    reader = data.draw(st.sampled_from(READERS))
    raw = bytearray(_good(reader))
    for _ in range(data.draw(st.integers(1, 3))):
        at = data.draw(st.integers(0, len(raw) - 1))
        raw[at : at + data.draw(st.integers(0, 4))] = data.draw(st.binary(max_size=6))
    content = {name_of(reader): bytes(raw)}
    bad = BadInput(reader, "damaged", entry(name_of(reader)).encode(), content, None, "either",
                   DIALECTS.get(reader))  # fmt: skip
    assert judge(bad, tmp_path_factory.mktemp("any") / "c").kind in OUTCOMES


def _good(reader: str, made: dict[str, bytes] = {}) -> bytes:  # noqa: B006 - made once
    if reader not in made:
        made[reader] = WRITERS[reader](t=T, y=Y)
    return made[reader]


@given(
    st.sampled_from(READERS),
    st.sampled_from(list(DATA_KINDS)),
    st.integers(0, 2**32 - 1),
)
@FUZZ
def test_any_wrong_numbers(
    tmp_path_factory: pytest.TempPathFactory, reader: str, kind: str, seed: int
) -> None:
    make, must, keys = DATA_KINDS[kind]
    content = {name_of(reader): WRITERS[reader](**make(np.random.default_rng(seed)))}
    bad = BadInput(reader, kind, entry(name_of(reader), **keys).encode(), content, None, must,
                   DIALECTS.get(reader))  # fmt: skip
    assert judge(bad, tmp_path_factory.mktemp("data") / "c").kind in OUTCOMES


def test_slow_sampling_is_remarked_on_as_possible_milliseconds(tmp_path: Path) -> None:
    content = {"a.csv": table({"t": T * 1000.0, "y": Y}).encode()}
    toml = entry("a.csv", commanded_on='"2000 s"', commanded_off='"5500 s"')
    path = write(BadInput("csv", "ms", toml.encode(), content), tmp_path / "c")
    found = read_campaign(path)
    assert len(found["1"].t) == N and found["1"].interval == 1000.0 * INTERVAL
    assert any("if the times are in ms, name the column time_ms" in w for w in found.warnings)


def test_in_a_process_of_its_own_nothing_is_left_behind(tmp_path: Path) -> None:
    # two end to end; the study does more, with a limit on memory
    for i, (toml, content) in enumerate(
        (
            (GOOD_TOML, b"\x89HDF\r\n\x1a\n" + bytes(500)),
            ("x = " + "[" * 5000, GOOD_CSV),
        )
    ):
        path = write(BadInput("csv", "own", toml.encode(), {"a.csv": content}), tmp_path / str(i))
        out = path.parent / "out"
        done = subprocess.run(
            [sys.executable, "-m", "bayes_sensor", "fit", str(path), "--out", str(out)],
            capture_output=True, text=True, timeout=120, check=False,
        )  # fmt: skip
        assert done.returncode == 2 and is_clear(done.stderr) == "" and done.stdout == ""
        assert not out.exists()
