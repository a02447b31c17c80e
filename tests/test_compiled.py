"""Where compiled code is kept."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest

from bayes_sensor.compiled import VARIABLE, ensure_numba_cache_dir, own_folder

ROOT = Path(__file__).resolve().parent.parent
NOBODY = 65534


def test_usual_places_are_left_alone(tmp_path: Path) -> None:
    for environ, package in (
        ({VARIABLE: "elsewhere"}, Path("/nonexistent/package")),
        ({}, tmp_path),
        ({"HOME": str(tmp_path)}, Path("/dev/null/package")),
        ({"HOME": "/dev/null/me", "XDG_CACHE_HOME": str(tmp_path)}, Path("/dev/null/package")),
    ):
        before = dict(environ)
        ensure_numba_cache_dir(environ, package)
        assert environ == before


@pytest.mark.parametrize("home", [None, "/dev/null/me"])
def test_there_is_a_place_where_the_usual_ones_cannot_be_written_to(
    home: str | None, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("tempfile.tempdir", str(tmp_path))
    for _ in range(2):  # the second time it is there
        environ = {} if home is None else {"HOME": home}
        ensure_numba_cache_dir(environ, Path("/dev/null/package"))
        place = Path(environ[VARIABLE])
        assert place.parent == tmp_path and os.access(place, os.W_OK)
        assert place.stat().st_mode & 0o077 == 0
    assert len(list(tmp_path.iterdir())) == 1


def test_a_place_that_others_may_write_to_is_not_used(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    own = own_folder(tmp_path)
    assert own is not None and own_folder(tmp_path) == own
    own.chmod(0o777)
    assert own_folder(tmp_path) is None
    own.rmdir()
    own.symlink_to(tmp_path)
    assert own_folder(tmp_path) is None
    own.unlink()
    own.write_text("a file")
    assert own_folder(tmp_path) is None
    monkeypatch.setattr("tempfile.tempdir", str(tmp_path))
    environ: dict[str, str] = {}
    ensure_numba_cache_dir(environ, Path("/dev/null/package"))
    assert Path(environ[VARIABLE]).is_dir() and Path(environ[VARIABLE]) != own


@pytest.mark.skipif(
    not hasattr(os, "getuid") or os.getuid() != 0, reason="only root can become another account"
)
def test_an_account_without_a_home_can_compile(tmp_path: Path) -> None:
    tmp_path.chmod(0o777)
    for folder in tmp_path.parents:  # pytest's own folders are for root alone
        if folder.stat().st_uid == 0 and folder.name.startswith("pytest"):
            folder.chmod(folder.stat().st_mode | 0o055)
    environ = {"PATH": os.environ["PATH"], "HOME": "/", "TMPDIR": str(tmp_path)}
    command = [sys.executable, "-c", "import bayes_sensor.likelihood.mesh; print('done')"]
    probe = [sys.executable, "-c", "import bayes_sensor"]
    given = {"env": environ, "cwd": ROOT, "user": NOBODY, "group": NOBODY, "extra_groups": []}
    try:
        subprocess.run(probe, capture_output=True, check=True, **given)
    except (OSError, subprocess.CalledProcessError):
        pytest.skip("another account may not read the package or the interpreter")
    done = subprocess.run(command, capture_output=True, text=True, check=False, **given)
    assert done.stdout == "done\n", done.stderr
    assert list(tmp_path.glob("bayes_sensor-*"))


CALLED = """
from bayes_sensor.compiled import compiled
@compiled(inside=True)
def called(x):
    return x + 1.0
"""
CALLER = """
from bayes_sensor.compiled import compiled
from called import called
FACTOR = 2.0
@compiled()
def caller(x):
    return FACTOR * called(x)
if __name__ == "__main__":
    print(caller(1.0), sum(caller.stats.cache_hits.values()))
"""


NAMED = """
from typing import NamedTuple
from bayes_sensor.compiled import compiled
class Pair(NamedTuple):
    a: float
@compiled()
def caller(pair):
    return pair.a
if __name__ == "__main__":
    import caller
    print(caller.caller(caller.Pair(4.0)), sum(caller.caller.stats.cache_hits.values()))
"""


def runs(folder: Path, **texts: str) -> str:
    """What ``caller.py`` says, once files have these texts."""
    for name, text in texts.items():
        (folder / f"{name}.py").write_text(text)
        os.utime(folder / f"{name}.py", (100.0, 100.0))  # dates say nothing
    environ = os.environ | {"PYTHONPATH": f"{ROOT}{os.pathsep}{folder}"}
    environ |= {VARIABLE: str(folder / "kept"), "PYTHONDONTWRITEBYTECODE": "1"}
    command = [sys.executable, str(folder / "caller.py")]
    done = subprocess.run(command, capture_output=True, text=True, check=False, env=environ)
    return done.stdout or done.stderr


def test_what_is_kept_is_used_until_the_text_of_what_it_calls_changes(tmp_path: Path) -> None:
    assert runs(tmp_path, called=CALLED, caller=CALLER) == "4.0 0\n"
    assert runs(tmp_path) == "4.0 1\n"
    os.utime(tmp_path / "called.py")
    assert runs(tmp_path) == "4.0 1\n"
    assert runs(tmp_path, called=CALLED.replace("1.0", "3.0")) == "8.0 0\n"
    assert runs(tmp_path, caller=CALLER.replace("2.0", "5.0")) == "20.0 0\n"
    assert runs(tmp_path, called=CALLED, caller=CALLER) == "4.0 0\n"


def test_kept_code_that_takes_a_class_which_is_no_more_is_compiled_again(tmp_path: Path) -> None:
    assert runs(tmp_path, caller=NAMED) == "4.0 0\n"
    assert runs(tmp_path) == "4.0 1\n"
    assert runs(tmp_path, caller=NAMED.replace("Pair", "Couple")) == "4.0 0\n"
    assert runs(tmp_path) == "4.0 1\n"


def test_a_run_says_once_that_it_compiles(tmp_path: Path) -> None:
    code = (
        "from bayes_sensor.compiled import say_when_compiling\nsay_when_compiling(print)\n"
        "import numpy as np\nfrom bayes_sensor.likelihood.noise import simulate_noise\n"
        "for phi in (0.5, np.full(2, 0.5)):\n"
        "    simulate_noise(np.ones(3), phi, np.random.default_rng(1))\n"
    )
    environ = os.environ | {VARIABLE: str(tmp_path), "PYTHONPATH": str(ROOT)}
    said = [
        subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, env=environ)
        for _ in range(2)
    ]
    assert said[0].stdout.startswith("compiling numerical functions")
    assert said[0].stdout.count("\n") == 1 and said[1].stdout == "", said
