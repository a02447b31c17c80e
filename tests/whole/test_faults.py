"""Killed, disk full, read-only, in use: results whole or untouched, and one message."""

import errno
import json
import os
import platform
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest

from bayes_sensor.campaign import CampaignError
from bayes_sensor.cli import exit_code
from bayes_sensor.cli.interruption import advice
from bayes_sensor.io import folder_lock
from bayes_sensor.io.folder_lock import Lock
from bayes_sensor.io.json_files import read_json
from bayes_sensor.io.put_run import CommandClock, put_run
from bayes_sensor.io.results import Results

QUICK = """
[fit]
swarms = 1
particles = 10
euler = false
[posterior]
n_chains = 2
n_walkers = 32
burn_in = 40
chunk = 20
max_steps = 120
"""


def run(*arguments: str | Path) -> int:
    return exit_code([str(a) for a in arguments])


@pytest.fixture(scope="module")
def place(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A small campaign and settings under which every command takes a second or two."""
    place = tmp_path_factory.mktemp("faults")
    small = ["--experiments", "1,6", "--duration", "12 s", "--interval", "20 ms", "--quiet"]
    noise = ["--sigma0", "5 mV", "--sigma1", "3 mV", "--tau", "150 ms"]
    assert run("simulate", "--out", place / "c", *small, *noise) == 0
    (place / "quick.toml").write_text(QUICK)
    return place


def contents(folder: Path) -> dict[str, bytes]:
    """What a run left, without its own record, which holds times of day."""
    return {
        p.relative_to(folder).as_posix(): p.read_bytes()
        for p in sorted(folder.rglob("*"))
        if p.is_file() and p.name != "run.json" and "checkpoint" not in p.parts
    }


# --- killed


def test_a_killed_run_resumes_to_the_same_bytes(
    place: Path, tmp_path: Path, whole: dict[str, bytes]
) -> None:
    """By the system; runs stopped at other places are in ``tests/posterior``."""
    out = tmp_path / "out"
    options = ["posterior", place / "c" / "campaign.toml", "--config", place / "quick.toml"]
    arguments = [*map(str, options), "--out", str(out), "--quiet"]
    with subprocess.Popen(
        [sys.executable, "-m", "bayes_sensor", *arguments],
        stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL,
    ) as process:  # fmt: skip
        deadline = time.monotonic() + 120
        while process.poll() is None and time.monotonic() < deadline:
            if len(list((out / "checkpoint").glob("ensemble-*.npz"))) >= 7:
                break
            time.sleep(0.002)
        process.send_signal(signal.SIGKILL)
    assert (out / ".lock").exists() and not (out / "posterior.json").exists()
    assert run(*arguments, "--resume") == 3  # 120 steps are too few, and it says so
    assert contents(out) == whole
    assert sorted(p.name for p in out.iterdir() if p.name.startswith(".")) == []


@pytest.fixture(scope="module")
def whole(place: Path) -> dict[str, bytes]:
    out = place / "whole"
    options = ["--config", place / "quick.toml", "--out", out, "--quiet"]
    assert run("posterior", place / "c" / "campaign.toml", *options) == 3
    return contents(out)


class Killed(BaseException):
    """Stands for a process that ends here."""


@pytest.mark.parametrize("moves", range(7))
def test_results_are_old_or_new_wherever_the_run_ends(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, moves: int
) -> None:
    folder = Results(tmp_path / "out")

    def save(text: str) -> None:
        with folder.locked(), folder.writing() as stage:
            for name in ("a.json", "b.json"):
                stage.json(name, text)
            put_run(stage, text, CommandClock(), seed=1, settings={})
            stage.path("figures").mkdir()
            (stage.path("figures") / f"{text}.svg").write_text(text)
            stage.drop.append("gap.json")

    save("old")
    with folder.writing() as stage:
        stage.json("gap.json", "old")
    replace, done = os.replace, 0

    def stops(source: Any, target: Any) -> None:
        nonlocal done
        if Path(target).parent == folder.folder:  # moves into place, not onto the stage
            done += 1
            if done > moves:
                raise Killed
        replace(source, target)

    with monkeypatch.context() as patch:
        patch.setattr(os, "replace", stops)
        try:
            save("new")
        except Killed:
            pass
    with folder.locked():  # whoever comes next
        pass
    names = [name for name in ("a.json", "b.json", "gap.json") if folder.has(name)]
    found = {name: read_json(folder.path(name)) for name in names}
    found["run.json"] = folder.json("run.json")["last"]
    expected = "old" if moves == 0 else "new"  # the first move makes the stage complete
    kept = {"gap.json": "old"} if moves == 0 else {}
    assert found == {"a.json": expected, "b.json": expected, "run.json": expected, **kept}
    assert {*folder.written()} == {*found, f"figures/{expected}.svg"} - {"run.json"}
    assert [p.name for p in folder.path("figures").iterdir()] == [f"{expected}.svg"]
    assert not [p.name for p in folder.folder.iterdir() if p.name.startswith(".")]


# --- nowhere to write


@pytest.mark.parametrize(("call", "code"), [(1, errno.ENOSPC), (2, errno.EROFS), (4, errno.EDQUOT)])
def test_no_room_is_one_message_and_leaves_what_was(
    place: Path,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
    code: int,
    call: int,
) -> None:
    out = tmp_path / "out"
    out.mkdir()
    (out / "mine.json").write_text('"earlier"')
    write, calls = Path.write_text, 0

    def full(self: Path, *arguments: Any, **more: Any) -> int:
        nonlocal calls
        calls += 1
        if calls == call:
            raise OSError(code, os.strerror(code), str(self))
        return write(self, *arguments, **more)

    options = ["--config", place / "quick.toml", "--out", out, "--quiet"]
    with monkeypatch.context() as patch:
        patch.setattr(Path, "write_text", full)
        assert run("fit", place / "c" / "campaign.toml", *options) == 2
    assert calls == call
    said = capsys.readouterr()
    assert said.err.count("\n") == 1 and os.strerror(code) in said.err and said.out == ""
    assert "check the free space and the permissions" in said.err
    assert [(p.name, p.read_text()) for p in out.iterdir()] == [("mine.json", '"earlier"')]


@pytest.fixture
def mounted(tmp_path: Path) -> Iterator[Callable[..., Path]]:
    """A small file system in memory, where this process may mount one."""
    made: list[Path] = []

    def mount(kilobytes: int, read_only: bool = False) -> Path:
        disk = tmp_path / f"disk{len(made)}"
        disk.mkdir()
        command = ["mount", "-t", "tmpfs", "-o", f"size={kilobytes}k", "tmpfs", str(disk)]
        try:
            if subprocess.run(command, capture_output=True).returncode:
                pytest.skip("this process may not mount file systems")
        except FileNotFoundError:
            pytest.skip("there is no mount here")
        made.append(disk)
        if read_only:
            subprocess.run(["mount", "-o", "remount,ro", str(disk)], check=True)
        return disk

    yield mount
    for disk in made:
        subprocess.run(["umount", "-l", str(disk)], check=True)


def test_a_full_and_a_read_only_disk_are_one_message_each(
    place: Path, mounted: Callable[..., Path], capsys: pytest.CaptureFixture[str]
) -> None:
    options = ["--config", str(place / "quick.toml"), "--quiet"]
    for disk, words in (
        (mounted(16), "No space left on device"),
        (mounted(64, read_only=True), "Read-only file system"),
    ):
        assert run("fit", place / "c" / "campaign.toml", "--out", disk / "out", *options) == 2
        said = capsys.readouterr().err
        assert words in said and said.count("\n") == 1, said
        assert list(disk.iterdir()) == []


# --- in use


def test_who_holds_a_folder_is_named(tmp_path: Path) -> None:
    with (
        Results(tmp_path).locked(),
        pytest.raises(CampaignError, match=rf"process {os.getpid()} on .*, since 20\d\d-") as told,
        Results(tmp_path).locked(),
    ):
        pass
    assert platform.node() in str(told.value)


def test_a_lock_whose_owner_ended_holds_nobody_up(tmp_path: Path) -> None:
    code = (
        "import os, sys; from bayes_sensor.io.results import Results\n"
        "with Results(sys.argv[1]).locked():\n    os.kill(os.getpid(), 9)"
    )
    subprocess.run([sys.executable, "-c", code, str(tmp_path)])
    assert (tmp_path / ".lock").exists()
    with Results(tmp_path).locked():
        pass
    assert not (tmp_path / ".lock").exists()


def test_one_waits_for_a_folder_as_long_as_asked(tmp_path: Path) -> None:
    held = Lock(tmp_path / ".lock")
    begin = time.monotonic()
    with (
        pytest.raises(CampaignError, match="is writing there"),
        Results(tmp_path).locked(patience=0.5),
    ):
        pass
    assert time.monotonic() - begin >= 0.5
    held.release()
    with Results(tmp_path).locked(patience=0.5):
        pass


def no_locks(descriptor: int, blocking: bool = True) -> bool:
    raise OSError(errno.ENOLCK, "No locks available")


@pytest.mark.parametrize(
    ("host", "alive", "held"), [("", False, True), ("", True, False), ("elsewhere", False, False)]
)
def test_without_locks_of_the_system_the_owner_is_looked_for(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, host: str, alive: bool, held: bool
) -> None:
    with subprocess.Popen([sys.executable, "-c", "input()"], stdin=subprocess.PIPE) as other:
        if not alive:
            other.communicate(b"\n")
        record = {"pid": other.pid, "host": host or platform.node(), "command": "bayes-sensor fit"}
        (tmp_path / ".lock").write_text(json.dumps(record))
        monkeypatch.setattr(folder_lock, "lock_descriptor", no_locks)
        if held:
            with Results(tmp_path).locked():
                assert json.loads((tmp_path / ".lock").read_text())["pid"] == os.getpid()
        else:
            with (
                pytest.raises(CampaignError, match=rf"process {other.pid} on .*remove .*\.lock"),
                Results(tmp_path).locked(),
            ):
                pass
        if alive:
            other.communicate(b"\n")


def test_a_lock_is_closed_before_it_is_removed_where_open_files_stay(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    removed = Path.unlink

    def unlink(path: Path, missing_ok: bool = False) -> None:
        if lock.handle is not None and not lock.handle.closed:
            raise PermissionError(13, "the file is in use", str(path))
        removed(path, missing_ok=missing_ok)

    monkeypatch.setattr(folder_lock, "OPEN_FILES_STAY", True)
    lock = Lock(tmp_path / ".lock")
    assert lock.held
    monkeypatch.setattr(Path, "unlink", unlink)
    lock.release()
    assert not (tmp_path / ".lock").exists()


# --- interrupted


@pytest.mark.parametrize(
    ("command", "words"),
    [
        ("fleet", "continue with: bayes-sensor fleet x --resume"),
        ("coverage", "continue with: bayes-sensor coverage x --resume"),
        ("gap", "run the same command again"),
    ],
)
def test_after_an_interruption_one_is_told_how_to_go_on(command: str, words: str) -> None:
    assert words in advice([command, "x"])
