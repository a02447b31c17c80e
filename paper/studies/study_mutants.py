"""Would the tests notice?  Single changes to the rooms that compute, each tried on its tests.

A mutant is the package with one operator, number, condition or loop changed (the operators of
Cosmic Ray).  Places are drawn at random from every room, then one change among those possible
there; left out are changes that no caller could see (annotations, decorators) or that raise on
the first float (bit operations), which would only flatter the score.  A mutant meets the tests
that run the changed line, the quickest first, as many as fit into ``BUDGET`` seconds; if it
survives and nobody has reviewed it, those of up to ``BUDGET_MORE``.  What the tests run is known
from ``make coverage``.

There are several draws of ``PER_ROOM`` mutants a room, one after the other: a later one meets the
tests that the review of the earlier ones added, and so tells what that review was worth.  A change
of the code elsewhere leaves a draw as it is.  ``paper/tables/mutants_tried.csv`` is the record of
what was tried; what it holds is not tried again.

Survivors are reviewed by hand in ``mutants_reviewed.csv``: ``equivalent`` (no result changes;
``remark`` says why), ``test added`` (``tests`` names them; they are kept out of the first verdict
of their draw and must kill the mutant) or ``open``.  ``python paper/studies/study_mutants.py``
goes on where it stopped; results are in build/studies/mutants.
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
TRIED = TABLES / "mutants_tried.csv"
REVIEWED = Path(__file__).with_name("mutants_reviewed.csv")
COMPUTING = (
    "model", "noise", "likelihood", "compression", "laplace", "mixing", "fit",
    "diffusion", "readout", "posterior", "predictive", "residuals", "bounds", "delays", "design",
    "calibration", "coverage", "gap", "blind_check",
)  # fmt: skip
"""the rooms that compute"""

SEEDS = (11, 12)
"""one a draw"""
PER_ROOM = 5
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
    """One change: in which draw, where, which operator, the line before and after."""

    draw: int
    room: str
    file: str
    line: int
    operator: str
    before: str
    after: str

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


def is_compiled(mutant: Mutant) -> bool:
    """Whether the change is in a compiled function."""
    source = (ROOT / mutant.file).read_text(encoding="utf-8")
    return mutant.line in compiled_lines(ast.parse(source))


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


def changed_line(file: str, operator: str, occurrence: int) -> tuple[int, str, str] | None:
    """The first line that a change alters, before and after; None for 1 -> 1.0 and the like."""
    lines = (ROOT / file).read_text(encoding="utf-8").splitlines()
    after = mutated(Path(file), f"core/{operator}", occurrence).splitlines()
    for k, (a, b) in enumerate(zip(lines, after), 1):
        if a != b:
            return k, a.strip(), b.strip()
    return None


def sample(room: str, draw: int, n: int) -> list[Mutant]:
    """``n`` mutants of a room, at different places, in random order.

    The order is that of hashes of the line's text, so it stays where other lines change.
    """

    def rank(*words: object) -> bytes:
        return hashlib.sha1("\n".join(map(str, (SEEDS[draw - 1], *words))).encode()).digest()

    every = []
    for file in files_of(room):
        lines = (ROOT / file).read_text(encoding="utf-8").splitlines()
        for line, column in places(file):
            text = lines[line - 1]
            of_equal = lines[: line - 1].count(text)
            every.append((rank(file, text, of_equal, column), file, (line, column)))
    mutants: list[Mutant] = []
    for own, file, place in sorted(every):
        choices = list(enumerate(places(file)[place]))
        operator, occurrence = min(choices, key=lambda c: rank(own.hex(), c[0], c[1][0]))[1]
        operator = operator.split("/")[-1]
        changed = changed_line(file.as_posix(), operator, occurrence)
        if changed is not None:
            mutants.append(Mutant(draw, room, file.as_posix(), changed[0], operator, *changed[1:]))
        if len(mutants) == n:
            break
    return mutants


# --------------------------------------------------------------------------- the tests of a line


class Seen:
    """Which tests run which line, from the measurement of ``make coverage``."""

    def __init__(self, folder: Path) -> None:
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
            name: note for name, note in self.notes.items() if note["outcome"] == "passed"
        }  # fmt: skip
        known = {c for data in self.data for c in data.measured_contexts()}
        self.shared = {
            name: {(name.split("::")[0], f) for f in note["fixtures"] if f"fixture {f}" in known}
            for name, note in self.notes.items()
        }
        self.cost: dict[tuple[str, str], float] = {}
        for fixture in set().union(*self.shared.values()):
            users = [self.notes[n]["seconds"] for n, own in self.shared.items() if fixture in own]
            self.cost[fixture] = max(users) - float(np.median(users))

    def seconds(self, name: str, made: frozenset[tuple[str, str]] = frozenset()) -> float:
        """What a test takes, with those of the fixtures it shares that are not ``made`` yet.

        The note of the first test that asked for a fixture holds what that costs.
        """
        own, shared = self.notes[name]["seconds"], self.shared[name]
        every = sum(self.cost[f] for f in shared)
        new = sum(self.cost[f] for f in shared - made)
        return float(new + (own if own < every else own - every))

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

    def tests(self, mutant: Mutant, kept_out: set[str]) -> list[str]:
        """Tests that run the line, quickest first, without those to be kept out.

        Of a line that runs on import those that run any line of its file, first those of the
        room.  Of a compiled line, which is seen by the tests without compilation only, those
        behind the ones that are known to run it.
        """
        by_line = self.contexts(mutant.file)
        known, own = by_line.get(mutant.line, set()), f"tests/test_{mutant.room}"
        names = known
        if is_compiled(mutant) or (not known and mutant.line in by_line):
            names = set().union(*by_line.values())

        def order(name: str) -> tuple[bool, bool, float, str]:
            new = name not in known
            return new, new and not name.startswith(own), self.seconds(name), name

        return sorted(names - kept_out, key=order)

    def within(self, names: list[str], low: float, high: float) -> list[str]:
        """Those whose running total of seconds is in (low, high]; at least one from 0 on."""
        total, found, made = 0.0, [], frozenset[tuple[str, str]]()
        for name in names:
            total += self.seconds(name, made)
            made |= self.shared[name]
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
    compiled = mutant is not None and is_compiled(mutant)
    if compiled:
        used = place / "numba-mutant"
        shutil.rmtree(used, ignore_errors=True)
        shutil.copytree(cache_folder, used, copy_function=os.link)
    stamp(tree, dependents(mutant.file) if mutant and compiled else set(),
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
    """The file's text with the change in it; ValueError where the line is not what it was."""
    file, changed = Path(mutant.file), (mutant.line, mutant.before, mutant.after)
    for at in sorted(places(file), key=lambda at: abs(at[0] - mutant.line)):
        for operator, occurrence in places(file)[at]:
            name = operator.split("/")[-1]
            if name == mutant.operator and changed_line(mutant.file, name, occurrence) == changed:
                return mutated(file, operator, occurrence)
    raise ValueError(f"{mutant.file}:{mutant.line} is no longer what {mutant} changes")


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


def recorded() -> tuple[list[Mutant], dict[str, dict[str, Any]]]:
    """What was tried before: the mutants, at the lines where they are now, and what became of them.

    The line is 0 where it was rewritten since.
    """
    mutants, known = [], {}
    if not TRIED.exists():
        return mutants, known
    with TRIED.open(newline="", encoding="utf-8") as stream:
        for row in csv.DictReader(stream):
            path = ROOT / row["file"]
            lines = path.read_text(encoding="utf-8").splitlines() if path.exists() else []
            here = [k for k, line in enumerate(lines, 1) if line.strip() == row["before"]]
            old = int(row["line"])
            line = min(here, key=lambda k: abs(k - old), default=0)
            mutant = Mutant(int(row["draw"]), row["room"], row["file"], line, row["operator"],
                            row["before"], row["after"])  # fmt: skip
            mutants.append(mutant)
            known[mutant.key] = {"first": row["outcome"]}
            if row["tests"]:
                known[mutant.key] |= {"again": row["again"], "again_tests": row["tests"].split()}
    return mutants, known


def drawn(room: str, draw: int, place: Path, n: int, tried: list[Mutant]) -> list[Mutant]:
    """``n`` mutants of a draw: those on record, then more of :func:`sample`."""
    own = [m for m in tried if (m.room, m.draw) == (room, draw)]
    if len(own) >= n:
        return own[:n]
    texts = b"".join((ROOT / f).read_bytes() for f in files_of(room))
    wanted = n + sum(m.room == room for m in tried)
    name = f"sample-{room}-{hashlib.sha1(texts).hexdigest()[:10]}-{SEEDS[draw - 1]}-{wanted}.json"
    path = place / name
    if not path.exists():
        path.write_text(json.dumps([asdict(m) for m in sample(room, draw, wanted)]))
    more = [Mutant(**m) for m in json.loads(path.read_text(encoding="utf-8"))]
    new = {m.key: m for m in more} | {m.key: None for m in tried}  # none twice
    return [*own, *filter(None, new.values())][:n]


def in_turn(rooms: tuple[str, ...], place: Path, n: int, tried: list[Mutant]) -> Iterator[Mutant]:
    """Draw by draw, the first of every room, then the second of every room, ... up to ``n``."""
    for draw in range(1, len(SEEDS) + 1):
        samples = [drawn(room, draw, place, n, tried) for room in rooms]
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

    ``until``: time.time() after which no trial is begun; ``each``: how many of every room, in
    every draw.
    """
    place = Path(folder) / "mutants"
    prepare(place)
    log = place / "results.jsonl"
    reviewed = reviews()
    seen = Seen(Path(folder) / "branches")
    tried, known = recorded()
    for key, facts in records(log).items():
        known[key] = known.get(key, {}) | facts

    def note(mutant: Mutant, **facts: Any) -> None:
        with log.open("a", encoding="utf-8") as stream:
            stream.write(json.dumps({"key": mutant.key, **facts}) + "\n")
        known.setdefault(mutant.key, {}).update(facts)

    mutants = list(in_turn(rooms, place, each, tried))
    everything = list({m.key: m for m in (*tried, *mutants)}.values())
    draw_of = {m.key: m.draw for m in everything}
    added: dict[int, set[str]] = {draw: set() for draw in range(1, len(SEEDS) + 1)}
    for key, row in reviewed.items():
        added[draw_of.get(key, 1)].update(row["tests"].split())
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
            earlier = set().union(*(added[d] for d in added if d < mutant.draw))
            later = set().union(*(added[d] for d in added if d >= mutant.draw))
            every = seen.tests(mutant, later - earlier)
            tests = seen.within(every, low, high)
            seconds = sum(seen.seconds(t) for t in tests)
            begin = time.time()
            if tests:
                outcome, said = trial(mutant, tests, place, seconds)
            else:
                outcome, said = (SURVIVED if every else NOT_RUN), ""
            note(mutant, **asdict(mutant), **{stage: outcome, f"{stage}_tests": len(tests),
                 f"{stage}_seconds": round(time.time() - begin, 1)}, said=said)  # fmt: skip
    for mutant in everything:
        tests = reviewed.get(mutant.key, {}).get("tests", "").split()
        row = known.get(mutant.key, {})
        dead = row.get("again") in (KILLED, TIMED_OUT) and row["again_tests"] == tests
        if tests and not dead and mutant.line > 0 and time.time() < until:
            outcome, said = trial(mutant, tests, place, 60.0)
            note(mutant, again=outcome, again_tests=tests, said=said)
    progress(len(mutants), len(mutants))
    return tables(everything, known, reviewed)


def counts(
    mutants: list[Mutant], known: dict[str, dict[str, Any]], left: list[str]
) -> dict[str, Any]:
    """How many were noticed, of those that change something, before and after the review.

    ``left``: the verdicts on those that survived.
    """
    n, equivalent, added = len(mutants), left.count("equivalent"), left.count("test added")
    timed = sum(known[m.key].get("more", known[m.key]["first"]) == TIMED_OUT for m in mutants)
    low0, high0 = wilson(n - len(left), n - equivalent)
    low1, high1 = wilson(n - len(left) + added, n - equivalent)
    return {
        "mutants": n, "killed": n - len(left) - timed, "timed_out": timed, "survived": len(left),
        "equivalent": equivalent, "killed_by_new_tests": added,
        "open": len(left) - equivalent - added,
        "score_before": (n - len(left)) / (n - equivalent), "before_lo95": low0,
        "before_hi95": high0, "score": (n - len(left) + added) / (n - equivalent),
        "lo95": low1, "hi95": high1,
    }  # fmt: skip


def tables(
    mutants: list[Mutant], known: dict[str, dict[str, Any]], reviewed: dict[str, dict[str, str]]
) -> pd.DataFrame:
    """``mutants.csv`` by room, which is returned, and by draw, all that were tried, survivors."""
    tried = sorted((m for m in mutants if "first" in known.get(m.key, {})), key=lambda m: m.draw)
    survivors, record = [], []
    for mutant in tried:
        row = known[mutant.key]
        outcome = row.get("more", row["first"])
        note = asdict(mutant)
        tests = " ".join(row.get("again_tests", ()))
        record.append({**note, "outcome": outcome, "again": row.get("again", ""), "tests": tests})
        if outcome in (KILLED, TIMED_OUT):
            continue
        review = reviewed.get(mutant.key, {"verdict": "not reviewed", "remark": "", "tests": ""})
        verdict = review["verdict"]
        if verdict == "test added" and (
            row.get("again") not in (KILLED, TIMED_OUT) or tests != review["tests"]
        ):
            verdict = "open"
        survivors.append(
            {**note, "verdict": verdict, "remark": review["remark"], "tests": review["tests"],
             "key": mutant.key}
        )  # fmt: skip

    def row_of(**wanted: Any) -> dict[str, Any]:
        def fits(m: dict[str, Any]) -> bool:
            return all(m[k] == v for k, v in wanted.items())

        return counts([m for m in tried if fits(asdict(m))], known,
                      [s["verdict"] for s in survivors if fits(s)])  # fmt: skip

    rooms = [r for r in COMPUTING if any(m.room == r for m in tried)]
    by_room = [{"room": room, **row_of(room=room)} for room in rooms]
    by_room.append({"room": "all", **row_of()})
    draws = sorted({m.draw for m in tried})
    by_draw = [{"draw": draw, **row_of(draw=draw)} for draw in draws]
    TABLES.mkdir(parents=True, exist_ok=True)
    for name, each in (("mutants", by_room), ("mutants_by_draw", by_draw),
                       ("mutants_survived", survivors), ("mutants_tried", record)):  # fmt: skip
        pd.DataFrame(each).to_csv(
            TABLES / f"{name}.csv", index=False, lineterminator="\n", float_format="%.4f"
        )
    return pd.DataFrame(by_room)


def main() -> None:
    """Parse, run, tell."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument(
        "--room", choices=COMPUTING, action="append", help="try new mutants of this room only"
    )
    parser.add_argument("--minutes", type=float, default=float("inf"), help="begin nothing later")
    parser.add_argument("--each", type=int, default=PER_ROOM, help="how many of every room, a draw")
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
