"""How much of it do the tests see?  Statements and branches by room: ``make coverage``.

The suite runs twice under coverage.py: as it is, and with ``NUMBA_DISABLE_JIT=1`` for the test
files of the rooms with compiled functions, which no tracer sees into when they are compiled; there
a test is left after ``LIMIT`` seconds.  Left out are the tests that work in other processes
(``ELSEWHERE``): what they see is not counted, so the shares are lower limits.  The measurement,
which also holds which test runs which line, stays in build/studies/branches.  Remove that folder
to measure anew.
"""

from __future__ import annotations

import argparse
import json
import os
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import pandas as pd

ROOT = Path(__file__).resolve().parent.parent.parent
TABLES = ROOT / "paper" / "tables"
COMPUTING = (
    "rig", "likelihood", "fit", "posterior", "residuals", "bounds", "checks", "design", "coating",
    "diagnosis", "blind_check",
)  # fmt: skip
"""the rooms that compute"""
UNCOMPILED = (
    "whole/test_without_compilation.py", "rig", "likelihood/test_noise.py",
    "likelihood/test_density.py", "posterior/test_r_hat.py", "coating/test_readout.py",
    "bounds/test_newton.py", "fit/test_fit.py",
)  # fmt: skip
ELSEWHERE = (
    "whole/test_faults.py", "whole/test_determinism.py", "whole/test_docs.py",
    "whole/test_frame.py", "whole/test_paper.py", "whole/test_notebooks.py", "fleet",
    "io/test_bad_input.py",
)  # fmt: skip
LIMIT = 3.0
"""seconds for a test without compilation"""
SETTINGS = """[run]
branch = true
source = bayes_sensor
[report]
exclude_lines =
    if TYPE_CHECKING:
    pragma: no cover - only
"""


def files_of(room: str) -> list[Path]:
    """The modules of a room, relative to the project."""
    folder = ROOT / "bayes_sensor" / room
    found = sorted(folder.rglob("*.py")) if folder.is_dir() else [folder.with_suffix(".py")]
    return [f.relative_to(ROOT) for f in found]


def measure(folder: Path, name: str, files: list[str], **variables: str) -> None:
    """One run of the tests in ``files``; its data and notes go to ``folder``."""
    data = folder / f"seen-{name}"
    if (folder / f"notes-{name}.json").exists():
        return
    settings = folder / "settings"
    settings.write_text(SETTINGS, encoding="utf-8")
    environment = {
        **os.environ, **variables, "COVERAGE_FILE": str(data),
        "COVERING_NOTES": str(folder / f"notes-{name}.json"),
        "PYTHONPATH": os.pathsep.join([str(ROOT), str(Path(__file__).parent)]),
        **dict.fromkeys(("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"), "1"),
    }  # fmt: skip
    command = [sys.executable, "-m", "coverage", "run", f"--rcfile={settings}", "-m", "pytest",
               "-q", "-p", "covering", "-p", "no:cacheprovider", *files]  # fmt: skip
    code = subprocess.run(command, cwd=ROOT, env=environment).returncode
    # without compilation some tests fail for their own reasons: numpy warns where numba does not
    if code not in ((0, 1) if variables else (0,)):
        raise SystemExit(f"the tests ended with {code}, so nothing is measured; run 'make test'")


def by_room(folder: Path) -> pd.DataFrame:
    """Statements and branches of every room that computes, and how many were run."""
    from coverage import Coverage

    rows = []
    data = folder / "together"
    both = Coverage(data_file=str(data), config_file=str(folder / "settings"))
    both.combine(
        [str(folder / f"seen-{p.stem[6:]}") for p in folder.glob("notes-*.json")], keep=True
    )
    for room in COMPUTING:
        counts = dict.fromkeys(("statements", "run", "branches", "taken"), 0)
        for file in files_of(room):
            report = folder / "report.json"
            both.json_report([str(ROOT / file)], outfile=str(report))
            totals = json.loads(report.read_text(encoding="utf-8"))["totals"]
            for key, name in (
                ("statements", "num_statements"), ("run", "covered_lines"),
                ("branches", "num_branches"), ("taken", "covered_branches"),
            ):  # fmt: skip
                counts[key] += totals[name]
        rows.append({"room": room, **counts})
    table = pd.DataFrame(rows)
    table.loc[len(table)] = ["all", *table.drop(columns="room").sum()]
    table["share_of_statements"] = table["run"] / table["statements"]
    table["share_of_branches"] = table["taken"] / table["branches"].clip(lower=1)
    return table


def run(
    folder: Path, jobs: int, scheduler: str | None, progress: Callable[[int, int], None]
) -> pd.DataFrame:
    """The table; the tests run in one process, because a test's lines are noted as it runs."""
    place = Path(folder) / "branches"
    place.mkdir(parents=True, exist_ok=True)
    tests = {p.relative_to(ROOT / "tests"): p for p in sorted(ROOT.glob("tests/**/test_*.py"))}
    parts = [
        (f"compiled-{'.'.join(name.parts)}", [str(file)], {})
        for name, file in tests.items()
        if not any(name.is_relative_to(left_out) for left_out in ELSEWHERE)
    ]
    parts.append(("compiled-examples", ["bayes_sensor"], {}))
    without = {"NUMBA_DISABLE_JIT": "1", "COVERING_LIMIT": str(LIMIT)}
    parts += [
        (f"uncompiled-{name.replace('/', '.')}", [f"tests/{name}"], without) for name in UNCOMPILED
    ]
    for i, (name, files, variables) in enumerate(parts):
        progress(i, len(parts))
        measure(place, name, files, **variables)
    progress(len(parts), len(parts))
    table = by_room(place)
    TABLES.mkdir(parents=True, exist_ok=True)
    table.to_csv(TABLES / "branches.csv", index=False, lineterminator="\n", float_format="%.4f")
    return table


def main() -> None:
    """Measure and count; test files that are measured already are not run again."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--folder", type=Path, default=ROOT / "build" / "studies")
    arguments = parser.parse_args()

    def tell(done: int, n: int) -> None:
        print(f"test file {done} of {n}", flush=True)

    print(run(arguments.folder, 1, None, tell).to_string(index=False))


if __name__ == "__main__":
    main()
