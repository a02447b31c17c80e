"""Where compiled code is kept."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path
from types import ModuleType, SimpleNamespace

import pytest

from bayes_sensor.compiled import VARIABLE, ensure_numba_cache_dir, forget_older, own_folder

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


def test_what_is_older_than_a_function_that_it_calls_is_compiled_anew(tmp_path: Path) -> None:
    called = ModuleType("called")
    called.__file__ = str(tmp_path / "called.py")
    Path(called.__file__).touch()
    kept = [tmp_path / f"caller.{name}-9.py311.nbi" for name in ("value", "values")]
    kept.append(tmp_path / "other.value-9.py311.nbi")

    def caller(name: str) -> SimpleNamespace:
        stats = SimpleNamespace(cache_path=str(tmp_path))
        return SimpleNamespace(__module__="rig.caller", __name__=name, stats=stats)

    def after(changed: float) -> list[bool]:
        for index in kept:
            index.touch()
            os.utime(index, (100.0, 100.0))
        os.utime(str(called.__file__), (changed, changed))
        forget_older([caller("value")], [called])
        return [index.exists() for index in kept]

    assert after(50.0) == [True, True, True]
    assert after(150.0) == [False, True, True]
    forget_older([len], [called])  # compilation is switched off: nothing is kept
