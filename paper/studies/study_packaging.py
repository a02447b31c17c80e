"""Does what is handed out install and run?  ``make check-dist`` calls this; Python alone is enough.

The archives in ``dist`` are looked into.  For every interpreter found, the sdist must give the
wheel again, file by file, and the wheel goes into a new environment, without extras and with the
tested versions, where ``pip check`` must be content, commands must run away from the sources, and
a missing extra must be named.  Times are CPU seconds, the least of several processes.  A row an
interpreter goes to ``paper/tables/packaging.csv``.
"""

from __future__ import annotations

import argparse
import csv
import hashlib
import json
import os
import shutil
import subprocess
import sys
import tarfile
import tempfile
import zipfile
from collections.abc import Callable, Sequence
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent.parent
MINORS = (11, 12, 13, 14)
IMPORT_SECONDS = 0.5
IN_WHEEL = ("bayes_sensor/py.typed", "bayes_sensor/templates/report.css")
IN_SDIST = ("pyproject.toml", "Makefile", ".ci/run", "LICENSE", "CITATION.cff", "CONTRIBUTING.md",
            "CHANGELOG.md", "constraints-3.11.txt", "constraints-3.12.txt",
            "tests/whole/test_frame.py", "tests/whole/public_api.txt", "docs/conf.py",
            "notebooks/quickstart.ipynb", "data/reference/campaign.toml", "paper/build.py",
            "bayes_sensor/templates/report.css")  # fmt: skip
ALL_NAMES = "import bayes_sensor as b; [getattr(b, name) for name in b.__all__]"
EXTRAS = {"parquet": "pyarrow", "tdms": "nptdms", "cluster": "distributed"}
# what the caller has set for Python or for an environment of its own stays out
OUTSIDE = {k: v for k, v in os.environ.items() if not k.startswith("PYTHON") and k != "VIRTUAL_ENV"}


class Failed(Exception):
    """What does not hold, in one sentence."""


def run(*command: str | Path, cwd: Path, code: int = 0) -> str:
    """What a command writes to both streams; Failed where it ends with another code."""
    done = subprocess.run(
        [*map(str, command)], cwd=cwd, env=OUTSIDE, text=True,
        stdout=subprocess.PIPE, stderr=subprocess.STDOUT,
    )  # fmt: skip
    if done.returncode != code:
        shown = " ".join(Path(part).name if os.sep in str(part) else str(part) for part in command)
        raise Failed(f"'{shown}' ended with {done.returncode}, not {code}: {done.stdout[-2000:]}")
    return done.stdout.strip()


def cpu_seconds(*command: str | Path, cwd: Path, times: int = 5) -> float:
    """CPU seconds of a command: the least of `times` processes."""
    spent = []
    for _ in range(times):
        process = subprocess.Popen(
            [*map(str, command)], cwd=cwd, env=OUTSIDE, stdout=subprocess.DEVNULL
        )
        _, status, usage = os.wait4(process.pid, 0)
        process.returncode = os.waitstatus_to_exitcode(status)
        if process.returncode:
            raise Failed(f"{command} ended with {process.returncode}")
        spent.append(usage.ru_utime + usage.ru_stime)
    return min(spent)


def interpreters() -> dict[str, str]:
    """Command by minor version, of those that run and can make environments."""
    found: dict[str, str] = {}
    question = "import sys, venv, ensurepip; print('%d.%d' % sys.version_info[:2])"
    versions = Path.home() / ".pyenv" / "versions"
    for minor in MINORS:
        names = [f"python3.{minor}", *sorted(map(str, versions.glob(f"3.{minor}.*/bin/python3")))]
        for name in [sys.executable, *names]:
            try:
                told = subprocess.run([name, "-c", question], capture_output=True, text=True)
            except OSError:
                continue
            if told.stdout.strip() == f"3.{minor}":
                found[f"3.{minor}"] = name
                break
    return found


def contents(wheel: Path) -> dict[str, str]:
    """Digest by name of the files in a wheel; its list of itself (RECORD) is left out."""
    with zipfile.ZipFile(wheel) as archive:
        names = [name for name in archive.namelist() if not name.endswith("/RECORD")]
        return {name: hashlib.sha256(archive.read(name)).hexdigest() for name in names}


def wheel_again(python: Path, sdist: Path, wheel: Path, place: Path) -> int:
    """Files of the wheel that pip builds from the sdist; Failed unless they are the wheel's."""
    run(python, "-m", "pip", "wheel", "--quiet", "--disable-pip-version-check", "--no-deps",
        "--wheel-dir", place / "again", sdist, cwd=place)  # fmt: skip
    (built,) = (place / "again").glob("*.whl")
    here, there = contents(wheel), contents(built)
    other = sorted(n for n in here.keys() | there.keys() if here.get(n) != there.get(n))
    if other or built.name != wheel.name:
        raise Failed(f"the sdist gives {built.name}, which differs from {wheel.name} in {other}")
    return len(there)


def look_into(wheel: Path, sdist: Path) -> None:
    """Failed unless the archives hold what belongs there, and the wheel nothing else."""
    inside = zipfile.ZipFile(wheel).namelist()
    missing = [name for name in IN_WHEEL if name not in inside]
    strange = [n for n in inside if not n.startswith("bayes_sensor") or "__pycache__" in n]
    with tarfile.open(sdist) as archive:
        held = {name.partition("/")[2] for name in archive.getnames()}
    missing += [f"{name} (sdist)" for name in IN_SDIST if name not in held]
    if missing or strange:
        raise Failed(f"missing from the archives: {missing}; strange in the wheel: {strange}")


def missing_extra(extra: str, command: Callable[..., str], place: Path, python: Path) -> None:
    """Failed unless a command that needs an absent extra names it and ends with 2.

    ``place/simulated`` holds a campaign of CSV files.
    """
    absent = (
        f"import importlib.util as u, sys; sys.exit(u.find_spec({EXTRAS[extra]!r}) is not None)"
    )
    run(python, "-c", absent, cwd=place)
    if extra == "cluster":
        said = command("coverage", "--out", place / "c", "--scheduler", "tcp://localhost:1", code=2)
    else:
        folder = place / "simulated"
        (folder / f"a.{extra}").write_bytes(b"data")
        text = (folder / "campaign.toml").read_text(encoding="utf-8")
        file = next(word for word in text.split('"') if word.endswith(".csv"))
        (folder / f"{extra}.toml").write_text(text.replace(file, f"a.{extra}"), encoding="utf-8")
        said = command("check", folder / f"{extra}.toml", code=2)
    if f"bayes-sensor[{extra}]" not in said:
        raise Failed(f"the extra {extra} is not named: {said}")


def tried(
    version: str, interpreter: str, wheel: Path, sdist: Path, source: Path, place: Path
) -> dict[str, str]:
    """The row of one interpreter; Failed with the first thing that does not hold.

    ``source`` is the unpacked sdist, ``place`` an empty folder.
    """
    run(interpreter, "-m", "venv", place / "venv", cwd=place)
    python, script = place / "venv/bin/python", place / "venv/bin/bayes-sensor"
    same = wheel_again(python, sdist, wheel, place)
    constraints = f"constraints-{'3.11' if version == '3.11' else '3.12'}.txt"
    # compiled when first imported: most of it never is
    quiet = ("install", "--quiet", "--no-compile", "--disable-pip-version-check")
    run(python, "-m", "pip", *quiet, "-c", source / constraints, wheel, cwd=place)
    content = run(python, "-m", "pip", "check", "--disable-pip-version-check", cwd=place)

    def command(*words: str | Path, code: int = 0) -> str:
        return run(script, *words, cwd=place, code=code)

    said = command("--version")
    if said != f"bayes-sensor {wheel.name.split('-')[1]}":
        raise Failed(f"--version says {said!r}, the wheel is {wheel.name}")
    command("check", source / "data/reference/campaign.toml")
    command("simulate", "--out", place / "simulated", "--experiments", "1,4,6",
            "--duration", "15 s", "--interval", "10 ms", "--seed", "3", "--quiet")  # fmt: skip
    command("fit", place / "simulated/campaign.toml", "--out", place / "fit", "--quiet")
    tau = json.loads((place / "fit/fit.json").read_text())["parameters"]["tau_s"]
    for extra in EXTRAS:
        missing_extra(extra, command, place, python)
    brought = run(
        python, "-c", "import sys; old = set(sys.modules); import bayes_sensor; print(sorted({"
        "m.split('.')[0] for m in set(sys.modules) - old} - {'bayes_sensor'} "
        "- set(sys.stdlib_module_names)))", cwd=place,
    )  # fmt: skip
    importing = cpu_seconds(python, "-c", "import bayes_sensor", cwd=place)
    if importing > IMPORT_SECONDS or brought != "[]":
        raise Failed(f"import bayes_sensor takes {importing:.2f} s and loads {brought}")
    packages = run(python, "-m", "pip", "list", "--format=json", quiet[-1], cwd=place)
    return {
        "python": version,
        "files_from_sdist": str(same),
        "packages": str(len(json.loads(packages))),
        "pip_check": content.rstrip("."),
        "check": "done",
        "fit": "done",
        "tau_s": f"{float(tau):.6f}",
        "extras_named": str(len(EXTRAS)),
        "import_s": f"{importing:.3f}",
        "bare_python_s": f"{cpu_seconds(python, '-c', 'pass', cwd=place):.3f}",
        "all_names_s": f"{cpu_seconds(python, '-c', ALL_NAMES, cwd=place):.2f}",
        "help_s": f"{cpu_seconds(script, '--help', cwd=place):.3f}",
    }


def main(arguments: Sequence[str] | None = None) -> int:
    """Parse, try, tell; 1 where something does not hold."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("dist", type=Path, help="folder with one wheel and one sdist")
    parser.add_argument("--quick", action="store_true", help="this interpreter only, no table")
    given = parser.parse_args(arguments)
    (wheel,), (sdist,) = given.dist.glob("*.whl"), given.dist.glob("*.tar.gz")
    wheel, sdist = wheel.resolve(), sdist.resolve()
    here = "{}.{}".format(*sys.version_info)
    chosen = {here: sys.executable} if given.quick else interpreters()
    rows, failed = [], []
    try:
        look_into(wheel, sdist)
    except Failed as error:
        failed.append(str(error))
    with tempfile.TemporaryDirectory() as folder:
        shutil.unpack_archive(sdist, folder, filter="data")
        (source,) = Path(folder).iterdir()
        for version, interpreter in chosen.items():
            print(f"Python {version}: a new environment", flush=True)
            place = Path(folder) / version
            place.mkdir()
            try:
                rows.append(tried(version, interpreter, wheel, sdist, source, place))
                print("  " + ", ".join(f"{k} {v}" for k, v in rows[-1].items()), flush=True)
            except Failed as error:
                failed.append(f"Python {version}: {error}")
                print("  failed", flush=True)
            shutil.rmtree(place / "venv", ignore_errors=True)
    for sentence in failed:
        print(sentence, file=sys.stderr)
    if rows and not given.quick and not failed:
        table = ROOT / "paper" / "tables" / "packaging.csv"
        with table.open("w", newline="", encoding="utf-8") as stream:
            writer = csv.DictWriter(stream, list(rows[0]), lineterminator="\n")
            writer.writeheader()
            writer.writerows(rows)
    return 1 if failed else 0


if __name__ == "__main__":
    sys.exit(main())
