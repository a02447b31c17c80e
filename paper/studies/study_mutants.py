"""Would the tests notice?  Single changes to the rooms that compute, each tried on its tests.

A mutant is the package with one operator, number, condition or loop changed (the operators of
Cosmic Ray).  Places are drawn at random from every room, then one change among those possible
there; left out are changes that no caller could see (annotations, decorators) or that raise on
the first float (bit operations), which would only flatter the score.  A mutant meets the tests
that run the changed line, the quickest first, as many as fit into ``BUDGET`` seconds; if it
survives and nobody has reviewed it, those of up to ``BUDGET_MORE``.  What the tests run is known
from ``make coverage``.

Survivors are reviewed by hand in ``mutants_reviewed.csv``: ``equivalent`` (no result changes;
``remark`` says why), ``test added`` (``tests`` names them; they are kept out of the first verdict
and must kill the mutant) or ``open``.  ``python paper/studies/study_mutants.py`` goes on where it
stopped; results are in build/studies/mutants.
"""

from __future__ import annotations

import argparse
import ast
import csv
import hashlib
import importlib
import json
import os
import resource
import shutil
import signal
import sys
import time
import traceback
from collections.abc import Callable, Iterator
from dataclasses import asdict, dataclass
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from bayes_sensor.blind_check import wilson

ROOT = Path(__file__).resolve().parent.parent.parent
TABLES = ROOT / "paper" / "tables"
REVIEWED = Path(__file__).with_name("mutants_reviewed.csv")
COMPUTING = (
    "reality", "model", "noise", "likelihood", "compression", "laplace", "mixing", "fit",
    "diffusion", "readout", "posterior", "predictive", "residuals", "bounds", "delays", "design",
    "calibration", "coverage", "gap", "blind_check",
)  # fmt: skip
"""the rooms that compute"""

SEED = 11
PER_ROOM = 15
BUDGET, BUDGET_MORE = 8.0, 40.0
SECONDS_TO_COMPILE = 90.0
MOST_BYTES = 8 << 30
"""of addresses, so that a mutant that asks for a huge array fails by itself"""
LEFT_OUT = ("RemoveDecorator", "ExceptionReplacer", "_BitOr", "_BitAnd", "_BitXor",
            "_LShift", "_RShift", "_Is", "_IsNot")  # fmt: skip
COPIED = ("bayes_sensor", "tests", "data", "docs", "paper/tables", "paper/studies",
          "pyproject.toml", "CHANGELOG.md", "README.md", "Makefile")  # fmt: skip
LOADED_ONCE = ("pytest", "numpy", "scipy.stats", "scipy.optimize", "scipy.signal", "scipy.sparse",
               "scipy.interpolate", "scipy.integrate", "numba", "pandas", "statsmodels.api",
               "statsmodels.tsa.stattools", "emcee", "arviz", "skfem", "joblib", "pydantic",
               "matplotlib.pyplot", "typer", "h5netcdf")  # fmt: skip
KILLED, TIMED_OUT, SURVIVED, NOT_RUN = "killed", "timed out", "survived", "no test"


@dataclass(frozen=True)
class Mutant:
    """One change: where, which operator, which of its occurrences in the file."""

    room: str
    file: str
    line: int
    operator: str
    occurrence: int
    before: str
    after: str
    compiled: bool

    @property
    def key(self) -> str:
        """The same for the same change, also when lines are added above it."""
        text = "\n".join((self.file, self.operator, self.before, self.after))
        return hashlib.sha1(text.encode()).hexdigest()[:10]


# --------------------------------------------------------------------------- the sample


def cosmic_ray() -> Any:
    """The package, or a sentence that names the extra."""
    try:
        importlib.import_module("cosmic_ray.mutating")
        importlib.import_module("cosmic_ray.plugins")
        return importlib.import_module("cosmic_ray")
    except ImportError:
        raise SystemExit(
            "mutants are made by cosmic-ray, which is not installed: pip install "
            "'bayes-sensor[mutation]'"
        ) from None


def files_of(room: str) -> list[Path]:
    """The modules of a room, relative to the project."""
    folder = ROOT / "bayes_sensor" / room
    found = sorted(folder.rglob("*.py")) if folder.is_dir() else [folder.with_suffix(".py")]
    return [f.relative_to(ROOT) for f in found]


def compiled_lines(tree: ast.Module) -> set[int]:
    """The lines of functions that are compiled."""
    lines: set[int] = set()
    for node in ast.walk(tree):
        if isinstance(node, ast.FunctionDef) and any(
            "njit" in ast.unparse(d) for d in node.decorator_list
        ):
            lines.update(range(node.lineno, (node.end_lineno or node.lineno) + 1))
    return lines


def annotation_places(tree: ast.Module) -> list[tuple[tuple[int, int], tuple[int, int]]]:
    """Stretches (line, column) of annotations, which are never evaluated."""
    nodes = [getattr(n, key, None) for n in ast.walk(tree) for key in ("annotation", "returns")]
    return [
        ((n.lineno, n.col_offset), (n.end_lineno or n.lineno, n.end_col_offset or 0))
        for n in nodes
        if n is not None
    ]


@cache
def places(file: Path) -> dict[tuple[int, int], list[tuple[str, int]]]:
    """Places (line, column) of a file with the changes possible there: operator, occurrence."""
    cosmic_ray()
    from cosmic_ray.ast import ast_nodes, get_ast
    from cosmic_ray.plugins import get_operator, operator_names

    source = (ROOT / file).read_text(encoding="utf-8")
    stretches = annotation_places(ast.parse(source))
    nodes = list(ast_nodes(get_ast(source)))
    found: dict[tuple[int, int], list[tuple[str, int]]] = {}
    for name in sorted(operator_names()):
        left_out = name.endswith(LEFT_OUT) or "_BitOr_" in name
        if left_out or get_operator(name).arguments():
            continue
        operator = get_operator(name)()
        each = (p for node in nodes for p in operator.mutation_positions(node))
        for occurrence, (start, _) in enumerate(each):
            if not any(a <= tuple(start) < b for a, b in stretches):
                found.setdefault(tuple(start), []).append((name, occurrence))
    return found


def mutated(file: Path, operator: str, occurrence: int) -> str:
    """The text of a file after a change."""
    from cosmic_ray.mutating import mutate_code
    from cosmic_ray.plugins import get_operator

    text = mutate_code(
        (ROOT / file).read_text(encoding="utf-8"), get_operator(operator)(), occurrence
    )
    assert text is not None
    return text


def sample(room: str, n: int = PER_ROOM) -> list[Mutant]:
    """``n`` mutants of a room, at different places, in random order."""
    rng = np.random.default_rng([SEED, COMPUTING.index(room)])
    every = [(file, place) for file in files_of(room) for place in sorted(places(file))]
    mutants = []
    for i in rng.permutation(len(every)):
        file, place = every[i]
        choices = places(file)[place]
        operator, occurrence = choices[rng.integers(len(choices))]
        source = (ROOT / file).read_text(encoding="utf-8")
        text = mutated(file, operator, occurrence)
        changed = [
            (k, a, b)
            for k, (a, b) in enumerate(zip(source.splitlines(), text.splitlines()), 1)
            if a != b
        ]
        if not changed:
            continue  # 1 -> 1.0 and the like
        k, before, after = changed[0]
        compiled = k in compiled_lines(ast.parse(source))
        mutants.append(
            Mutant(room, file.as_posix(), k, operator.split("/")[-1], occurrence, before.strip(),
                   after.strip(), compiled)
        )  # fmt: skip
        if len(mutants) == n:
            break
    return mutants


# --------------------------------------------------------------------------- the tests of a line


class Seen:
    """Which tests run which line, from the measurement of ``make coverage``."""

    def __init__(self, folder: Path, kept_out: set[str]) -> None:
        """Raises FileNotFoundError where coverage was not measured."""
        from coverage import CoverageData

        # notes are written when a run is complete
        notes = sorted(folder.glob("notes-*.json"), reverse=True)
        if not notes:
            raise FileNotFoundError(f"{folder} holds no measurement; run 'make coverage' first")
        self.data = [CoverageData(str(folder / f"seen-{p.stem[6:]}")) for p in notes]
        for data in self.data:
            data.read()
        self.notes: dict[str, dict[str, Any]] = {}
        for path in notes:
            self.notes |= json.loads(path.read_text(encoding="utf-8"))
        self.notes = {
            name: note for name, note in self.notes.items()
            if note["outcome"] == "passed" and name not in kept_out
        }  # fmt: skip

    @cache  # noqa: B019 - lives as long as the study
    def contexts(self, file: str) -> dict[int, set[str]]:
        """Tests by line of a file."""
        found: dict[int, set[str]] = {}
        for data in self.data:
            for path in data.measured_files():
                if path.endswith("/" + file):
                    for line, names in data.contexts_by_lineno(path).items():
                        found.setdefault(line, set()).update(names)
        users: dict[str, set[str]] = {}
        for name, note in self.notes.items():
            for fixture in note["fixtures"]:
                users.setdefault(f"fixture {fixture}", set()).add(name)
        return {
            line: set().union(*({n} & self.notes.keys() | users.get(n, set()) for n in names))
            for line, names in found.items()
        }

    def tests(self, mutant: Mutant) -> list[str]:
        """Tests that run the line, quickest first.

        Of a line that runs on import, or compiled and never without compilation, those that run
        any line of its file, first those of the room.
        """
        by_line = self.contexts(mutant.file)
        names, own = by_line.get(mutant.line, set()), f"tests/test_{mutant.room}"
        if names:
            own = ""
        elif mutant.compiled or mutant.line in by_line:
            names = set().union(*by_line.values())
        return sorted(names, key=lambda n: (not n.startswith(own), self.notes[n]["seconds"], n))

    def within(self, names: list[str], low: float, high: float) -> list[str]:
        """Those whose running total of seconds is in (low, high]; at least one from 0 on."""
        total, found = 0.0, []
        for name in names:
            total += self.notes[name]["seconds"]
            if low < total <= high or (low == 0.0 and not found):
                found.append(name)
        return found


# --------------------------------------------------------------------------- one trial


def dependents(file: str) -> set[str]:
    """Names of modules whose compiled code may hold that of ``file``: its importers, itself."""
    imports: dict[str, set[str]] = {}
    for path in sorted((ROOT / "bayes_sensor").rglob("*.py")):
        module = ".".join(path.relative_to(ROOT).with_suffix("").parts)
        imports[module] = {
            name
            for node in ast.walk(ast.parse(path.read_text(encoding="utf-8")))
            if isinstance(node, ast.ImportFrom) and node.module
            for name in (node.module, *(f"{node.module}.{a.name}" for a in node.names))
        }
    found = {".".join(Path(file).with_suffix("").parts)}
    while True:
        more = {m for m, used in imports.items() if used & found} - found
        if not more:
            return found
        found |= more


def stamp(tree: Path, fresh: set[str], label: str) -> None:
    """Compiled code is taken from the cache unless the change may be in it.

    numba asks for the text of the function's own file only: it would compile a whole file anew for
    a change outside its compiled functions, and miss one in what they call from another file.
    """
    from numba.core import caching

    def get_source_stamp(self: Any) -> str:
        try:
            path = Path(self._py_file).relative_to(tree)
        except ValueError:
            return "elsewhere"
        text = (ROOT / path).read_bytes()
        own = label if ".".join(path.with_suffix("").parts) in fresh else ""
        return hashlib.sha1(text).hexdigest() + own

    caching._SourceFileBackedLocatorMixin.get_source_stamp = get_source_stamp


def child(tree: Path, numba_cache: Path, tests: list[str], said: Path, seconds: float) -> None:
    """Run the tests in this process and end it with pytest's code."""
    os.setsid()
    out = os.open(said, os.O_WRONLY | os.O_CREAT | os.O_TRUNC)
    os.dup2(out, 1)
    os.dup2(out, 2)
    resource.setrlimit(resource.RLIMIT_CPU, (int(seconds), int(seconds) + 5))
    resource.setrlimit(resource.RLIMIT_AS, (MOST_BYTES, MOST_BYTES))
    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
    os.environ |= {"NUMBA_CACHE_DIR": str(numba_cache), "PYTHONPATH": str(tree)}
    for name in [m for m in sys.modules if m.split(".")[0] in ("bayes_sensor", "tests")]:
        del sys.modules[name]
    sys.path[:0] = [str(tree)]
    sys.path_importer_cache.clear()
    os.chdir(tree)
    import numba
    import pytest

    numba.config.reload_config()
    options = ["-x", "-q", "-p", "no:cacheprovider", "-p", "no:xdist", "--no-header", "--tb=line"]
    code = pytest.main([*options, *tests])
    sys.stdout.flush()
    os._exit(int(code))


def trial(mutant: Mutant | None, tests: list[str], place: Path, seconds: float) -> tuple[str, str]:
    """What became of a mutant (None: the package as it is), and the last lines that were said.

    ``seconds``: how long the tests take by themselves.
    """
    tree, cache_folder, said = place / "tree", place / "numba", place / "said.txt"
    limit = SECONDS_TO_COMPILE + 4 * seconds
    used = cache_folder
    target = None
    if mutant is not None:
        target = tree / mutant.file
        target.write_text(mutated_of(mutant), encoding="utf-8")
    if mutant is not None and mutant.compiled:
        used = place / "numba-mutant"
        shutil.rmtree(used, ignore_errors=True)
        shutil.copytree(cache_folder, used, copy_function=os.link)
    stamp(tree, dependents(mutant.file) if mutant and mutant.compiled else set(),
          mutant.key if mutant else "")  # fmt: skip
    try:
        process = os.fork()
        if process == 0:
            try:
                child(tree, used, tests, said, limit)
            except BaseException:
                traceback.print_exc()
            finally:
                sys.stderr.flush()
                os._exit(70)  # not reached by a child whose tests ran
        end = time.monotonic() + 8 * limit
        status = None
        while status is None:
            found, code = os.waitpid(process, os.WNOHANG)
            if found:
                status = code
            elif time.monotonic() > end:
                os.killpg(process, signal.SIGKILL)
                os.waitpid(process, 0)
                return TIMED_OUT, ""
            else:
                time.sleep(0.02)
    finally:
        if target is not None:
            shutil.copyfile(ROOT / mutant.file, target)
    tail = "\n".join(said.read_text(errors="replace").splitlines()[-6:])
    if os.WIFSIGNALED(status):
        return (TIMED_OUT if os.WTERMSIG(status) == signal.SIGXCPU else KILLED), tail
    code = os.WEXITSTATUS(status)
    if code in (1, 2, 3):
        return KILLED, tail
    if code != 0:
        raise RuntimeError(f"pytest ended with {code} for {mutant}:\n{tail}")
    return SURVIVED, tail


def mutated_of(mutant: Mutant) -> str:
    """The file's text with the change in it."""
    return mutated(Path(mutant.file), f"core/{mutant.operator}", mutant.occurrence)


def prepare(place: Path) -> None:
    """A copy of the project to change, and the libraries that every trial needs."""
    tree = place / "tree"
    shutil.rmtree(tree, ignore_errors=True)
    (place / "numba").mkdir(parents=True, exist_ok=True)
    skip = shutil.ignore_patterns("__pycache__", "*.nbi", "*.nbc")
    for name in COPIED:
        target = tree / name
        target.parent.mkdir(parents=True, exist_ok=True)
        if (ROOT / name).is_dir():
            shutil.copytree(ROOT / name, target, ignore=skip)
        else:
            shutil.copyfile(ROOT / name, target)
    os.environ["PYTHONDONTWRITEBYTECODE"] = "1"
    sys.dont_write_bytecode = True
    for name in LOADED_ONCE:
        importlib.import_module(name)


# --------------------------------------------------------------------------- the study


def reviews() -> dict[str, dict[str, str]]:
    """What the reviewer wrote, by mutant."""
    if not REVIEWED.exists():
        return {}
    with REVIEWED.open(newline="", encoding="utf-8") as stream:
        return {row["key"]: row for row in csv.DictReader(stream)}


def records(path: Path) -> dict[str, dict[str, Any]]:
    """What is known of every mutant so far; a line cut off by a kill does not count."""
    found = {}
    for line in path.read_text(encoding="utf-8").splitlines() if path.exists() else []:
        try:
            row = json.loads(line)
        except json.JSONDecodeError:
            continue
        found[row["key"]] = {**found.get(row["key"], {}), **row}
    return found


def drawn(room: str, place: Path) -> list[Mutant]:
    """:func:`sample`, kept in ``place`` as long as the room's files stay as they are."""
    texts = b"".join((ROOT / f).read_bytes() for f in files_of(room))
    path = place / f"sample-{room}-{hashlib.sha1(texts).hexdigest()[:10]}-{SEED}-{PER_ROOM}.json"
    if not path.exists():
        path.write_text(json.dumps([asdict(m) for m in sample(room)]), encoding="utf-8")
    return [Mutant(**m) for m in json.loads(path.read_text(encoding="utf-8"))]


def in_turn(rooms: tuple[str, ...], place: Path, n: int) -> Iterator[Mutant]:
    """The first of every room, then the second of every room, ... up to ``n`` of each."""
    samples = [drawn(room, place) for room in rooms]
    for i in range(n):
        for mutants in samples:
            if i < len(mutants):
                yield mutants[i]


def run(
    folder: Path,
    jobs: int,
    scheduler: str | None,
    progress: Callable[[int, int], None],
    rooms: tuple[str, ...] = COMPUTING,
    until: float = float("inf"),
    each: int = PER_ROOM,
) -> pd.DataFrame:
    """The tables; one process whatever ``jobs`` is, because every trial changes the same copy.

    ``until``: time.time() after which no trial is begun; ``each``: how many of every room.
    """
    place = Path(folder) / "mutants"
    prepare(place)
    log = place / "results.jsonl"
    reviewed = reviews()
    added = {t for row in reviewed.values() for t in row["tests"].split()}
    seen = Seen(Path(folder) / "branches", added)
    known = records(log)

    def note(mutant: Mutant, **facts: Any) -> None:
        with log.open("a", encoding="utf-8") as stream:
            stream.write(json.dumps({"key": mutant.key, **facts}) + "\n")
        known.setdefault(mutant.key, {}).update(facts)

    mutants = list(in_turn(rooms, place, each))
    for stage, low, high in (("first", 0.0, BUDGET), ("more", BUDGET, BUDGET_MORE)):
        for i, mutant in enumerate(mutants):
            progress(i, len(mutants))
            row = known.get(mutant.key, {})
            if stage in row:
                continue
            if stage == "more" and (row.get("first") != SURVIVED or mutant.key in reviewed):
                continue
            if time.time() > until:
                continue
            every = seen.tests(mutant)
            tests = seen.within(every, low, high)
            seconds = sum(seen.notes[t]["seconds"] for t in tests)
            begin = time.time()
            if tests:
                outcome, said = trial(mutant, tests, place, seconds)
            else:
                outcome, said = (SURVIVED if every else NOT_RUN), ""
            note(mutant, **asdict(mutant), **{stage: outcome, f"{stage}_tests": len(tests),
                 f"{stage}_seconds": round(time.time() - begin, 1)}, said=said)  # fmt: skip
    for mutant in mutants:
        tests = reviewed.get(mutant.key, {}).get("tests", "").split()
        row = known.get(mutant.key, {})
        if tests and row.get("again_tests") != tests and time.time() < until:
            outcome, said = trial(mutant, tests, place, 60.0)
            note(mutant, again=outcome, again_tests=tests, said=said)
    progress(len(mutants), len(mutants))
    return tables(mutants, known, reviewed)


def tables(
    mutants: list[Mutant], known: dict[str, dict[str, Any]], reviewed: dict[str, dict[str, str]]
) -> pd.DataFrame:
    """``mutants.csv`` by room, which is returned, and ``mutants_survived.csv``."""
    tried = [(m, known[m.key]) for m in mutants if "first" in known.get(m.key, {})]
    survivors, rows = [], []
    for mutant, row in tried:
        if row.get("more", row["first"]) in (KILLED, TIMED_OUT):
            continue
        review = reviewed.get(mutant.key, {"verdict": "not reviewed", "remark": "", "tests": ""})
        verdict = review["verdict"]
        if verdict == "test added" and row.get("again") not in (KILLED, TIMED_OUT):
            verdict = "open"
        survivors.append(
            {"room": mutant.room, "file": mutant.file, "line": mutant.line,
             "operator": mutant.operator, "before": mutant.before, "after": mutant.after,
             "verdict": verdict, "remark": review["remark"], "tests": review["tests"],
             "key": mutant.key}
        )  # fmt: skip
    for room in (*dict.fromkeys(m.room for m, _ in tried), "all"):
        here = [r for m, r in tried if room in (m.room, "all")]
        left = [s["verdict"] for s in survivors if room in (s["room"], "all")]
        n, equivalent, added = len(here), left.count("equivalent"), left.count("test added")
        timed = sum(r.get("more", r["first"]) == TIMED_OUT for r in here)
        low0, high0 = wilson(n - len(left), n - equivalent)
        low1, high1 = wilson(n - len(left) + added, n - equivalent)
        rows.append(
            {"room": room, "mutants": n, "killed": n - len(left) - timed, "timed_out": timed,
             "survived": len(left), "equivalent": equivalent, "killed_by_new_tests": added,
             "open": len(left) - equivalent - added,
             "score_before": (n - len(left)) / (n - equivalent), "before_lo95": low0,
             "before_hi95": high0, "score": (n - len(left) + added) / (n - equivalent),
             "lo95": low1, "hi95": high1}
        )  # fmt: skip
    TABLES.mkdir(parents=True, exist_ok=True)
    for name, each in (("mutants", rows), ("mutants_survived", survivors)):
        pd.DataFrame(each).to_csv(
            TABLES / f"{name}.csv", index=False, lineterminator="\n", float_format="%.4f"
        )
    return pd.DataFrame(rows)


def main() -> None:
    """Parse, run, tell."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--room", choices=COMPUTING, action="append", help="only this room")
    parser.add_argument("--minutes", type=float, default=float("inf"), help="begin nothing later")
    parser.add_argument("--each", type=int, default=PER_ROOM, help="how many of every room")
    parser.add_argument("--folder", type=Path, default=ROOT / "build" / "studies")
    arguments = parser.parse_args()
    begin = time.time()

    def tell(done: int, n: int) -> None:
        print(f"{done} of {n}, {time.time() - begin:.0f} s", flush=True)

    rooms = tuple(arguments.room or COMPUTING)
    until = begin + 60 * arguments.minutes
    print(run(arguments.folder, 1, None, tell, rooms, until, arguments.each).to_string())


if __name__ == "__main__":
    main()
