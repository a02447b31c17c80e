"""Same seed, same numbers: twice, in several processes, from a cold cache, on another Python.

Each command runs on a small campaign; what it leaves is compared file by file, without times of day
and durations.  Where files differ, all numbers of the JSON results are compared and the largest
relative difference is stated, and for the posterior the largest difference of a median in standard
deviations.  The other interpreter is the one that BAYES_SENSOR_OTHER_PYTHON names; where it names
none, that comparison is left out.
"""

from __future__ import annotations

import json
import os
import shutil
import subprocess
import sys
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from typing import Any

import pandas as pd
from drawing import TABLES
from study_faults import prepare, state

OTHER = "BAYES_SENSOR_OTHER_PYTHON"
THREADS = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS")


def run_command(
    arguments: tuple[str, ...], out: Path, python: str = sys.executable, threads: str = "1",
    **variables: str,
) -> Path:  # fmt: skip
    """The results of a command, run by an interpreter; they stay in a folder of their own."""
    place = out.parent / "out"
    for folder in (place, out):
        shutil.rmtree(folder, ignore_errors=True)
    environment = {**os.environ, **dict.fromkeys(THREADS, threads), **variables}
    done = subprocess.run(
        [python, "-m", "bayes_sensor", *arguments, "--out", str(place), "--quiet"],
        env=environment, capture_output=True, text=True,
    )  # fmt: skip
    assert done.returncode in (0, 3), done.stderr
    place.rename(out)
    return out


def numbers(value: Any, where: str = "") -> Iterator[tuple[str, float]]:
    """Every number of a JSON result with its place."""
    if isinstance(value, Mapping):
        for key, entry in value.items():
            yield from numbers(entry, f"{where}.{key}")
    elif isinstance(value, list):
        for i, entry in enumerate(value):
            yield from numbers(entry, f"{where}[{i}]")
    elif isinstance(value, int | float) and not isinstance(value, bool):
        yield where, float(value)


def largest_difference(one: Path, other: Path) -> tuple[float, str]:
    """Largest relative difference of all numbers of two JSON results, and where it is."""
    a, b = (dict(numbers(json.loads(p.read_text()))) for p in (one, other))
    if a.keys() != b.keys():
        return float("inf"), "not the same keys"
    each = ((abs(a[k] - b[k]) / max(abs(a[k]), abs(b[k]), 1e-300), k) for k in a)
    return max(each, default=(0.0, ""))


def in_sd(one: Path, other: Path) -> float:
    """Largest difference of a posterior's medians, in standard deviations."""
    a, b = (json.loads((p / "posterior.json").read_text())["parameters"] for p in (one, other))
    return max(abs(a[k]["q50"] - b[k]["q50"]) / max(a[k]["sd"], 1e-300) for k in a)


def compared(what: str, command: str, one: Path, other: Path) -> dict[str, Any]:
    """One row."""
    a, b = state(one), state(other)
    differ = sorted(k for k in a.keys() | b.keys() if a.get(k) != b.get(k))
    worst, place = 0.0, ""
    for name in (n for n in differ if n.endswith(".json") and n in a and n in b):
        found, key = largest_difference(one / name, other / name)
        if found > worst:
            worst, place = found, f"{name}{key}"
    sd = in_sd(one, other) if (one / "posterior.json").exists() and differ else 0.0
    return {
        "compared": what, "command": command, "files": len(a.keys() | b.keys()),
        "identical": len(a.keys() | b.keys()) - len(differ),
        "largest_relative_difference": float(f"{worst:.2g}"), "where": place,
        "largest_shift_of_a_median_in_sd": float(f"{sd:.2g}"),
    }  # fmt: skip


def run(
    folder: Path, jobs: int, scheduler: str | None, progress: Callable[[int, int], None]
) -> pd.DataFrame:
    """The table."""
    place = Path(folder) / "determinism"
    place.mkdir(parents=True, exist_ok=True)
    prepare(place)
    one, effect = str(place / "a" / "campaign.toml"), str(place / "effect" / "campaign.toml")
    quick = ("--config", str(place / "quick.toml"))
    few = ("--campaigns", "40", "--setting", "iid", "--method", "crlb_ar1", "--method", "sandwich")
    commands: dict[str, tuple[str, ...]] = {
        "fit": ("fit", one, *quick),
        "posterior": ("posterior", one, *quick),
        "bounds": ("bounds", one, *quick),
        "gap": ("gap", effect, *quick),
        "coverage": ("coverage", *few),
    }
    rows = []
    base = {name: run_command(c, place / f"base-{name}") for name, c in commands.items()}
    progress(1, 4)
    for name in ("posterior", "gap", "coverage"):
        other = run_command((*commands[name], "--jobs", "2"), place / "other")
        rows.append(compared("--jobs 2 with --jobs 1", name, base[name], other))
    progress(2, 4)
    for name in ("posterior", "bounds"):
        other = run_command(commands[name], place / "other", threads="2")
        rows.append(compared("two threads of linear algebra with one", name, base[name], other))
    cold = place / "cold-cache"
    shutil.rmtree(cold, ignore_errors=True)
    other = run_command(commands["posterior"], place / "other", NUMBA_CACHE_DIR=str(cold))
    shutil.rmtree(cold, ignore_errors=True)
    what = "first run, which compiles, with a later one"
    rows.append(compared(what, "posterior", base["posterior"], other))
    progress(3, 4)
    python = os.environ.get(OTHER)
    if python:
        show = "import sys, numpy, scipy; print('.'.join(map(str, sys.version_info[:2])), "
        show += "'numpy', numpy.__version__, 'scipy', scipy.__version__)"
        asked = [
            subprocess.run([p, "-c", show], capture_output=True, text=True, check=True).stdout
            for p in (sys.executable, python)
        ]
        what = " with ".join(f"Python {text.strip()}" for text in asked)
        for name in ("fit", "bounds", "gap", "coverage", "posterior"):
            other = run_command(commands[name], place / "other", python=python)
            rows.append(compared(what, name, base[name], other))
    table = pd.DataFrame(rows)
    TABLES.mkdir(parents=True, exist_ok=True)
    table.to_csv(TABLES / "determinism.csv", index=False, lineterminator="\n")
    progress(4, 4)
    return table
