"""The frame: version, order of the rooms, tested versions, Makefile, no traces of a machine."""

import ast
import importlib.metadata
import re
import shutil
import subprocess
import tomllib
from collections.abc import Iterator
from pathlib import Path

import pytest

import bayes_sensor

ROOT = Path(__file__).resolve().parents[2]
PACKAGE = ROOT / "bayes_sensor"

# A room imports only rooms above it. It is a file or a folder of that name in bayes_sensor/.
ROOMS = (
    "compiled",
    "display",
    "names",
    "experiment",
    "campaign",
    "workers",
    "rig",
    "io",
    "likelihood",
    "coating",
    "fit",
    "residuals",
    "posterior",
    "restoration",
    "bounds",
    "checks",
    "design",
    "diagnosis",
    "blind_check",
    "figures",
    "report",
    "analysis",
    "fleet",
    "cli",
)
DRAWING_ROOMS = ("figures", "report")

MAKE_TARGETS = ("install", "demo", "test", "record", "lint", "bench", "study", "coverage", "paper",
                "docs", "screenshot", "data", "dist", "check-dist")  # fmt: skip


def test_version_is_the_same_everywhere() -> None:
    declared = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]["version"]
    assert bayes_sensor.__version__ == declared
    assert importlib.metadata.version("bayes-sensor") == declared
    assert f"## [{declared}]" in (ROOT / "CHANGELOG.md").read_text()
    assert f"\nversion: {declared}\n" in (ROOT / "CITATION.cff").read_text()


def test_citation_file_says_what_is_needed_to_cite() -> None:
    yaml = pytest.importorskip("yaml")
    text = (ROOT / "CITATION.cff").read_text(encoding="utf-8")
    # dates and numbers stay as they are written: a version is a string
    citation = yaml.load(text, Loader=yaml.BaseLoader)
    for key in ("cff-version", "message", "title", "authors"):  # required by the format
        assert citation[key], f"CITATION.cff: {key} is missing"
    assert citation["cff-version"] == "1.2.0"
    assert citation["type"] in ("software", "dataset")
    assert citation["version"] == bayes_sensor.__version__
    assert re.fullmatch(r"\d+\.\d+\.\d+(-[0-9A-Za-z.-]+)?", citation["version"])
    project = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
    assert citation["license"] == project["license"]
    for entry in [citation, *citation["references"]]:
        assert entry["title"] and entry["authors"]
        for author in entry["authors"]:
            assert "name" in author or {"family-names", "given-names"} <= set(author)


# --- the order of the rooms


def room_of(file: Path) -> str:
    """The room that a file of the package belongs to; '' for the package's own __init__."""
    first = file.relative_to(PACKAGE).parts[0]
    return "" if first in ("__init__.py", "__main__.py") else first.removesuffix(".py")


def imported_modules(source: str, package: str) -> Iterator[tuple[int, str]]:
    """Line and absolute name of everything imported anywhere in `source`, functions included.

    `package` is the dotted package that relative imports start from.
    """
    for node in ast.walk(ast.parse(source)):
        if isinstance(node, ast.Import):
            for alias in node.names:
                yield node.lineno, alias.name
        elif isinstance(node, ast.ImportFrom):
            base = node.module or ""
            if node.level:
                above = package.split(".")
                above = above[: len(above) - node.level + 1]
                base = ".".join([*above, base] if base else above)
            for alias in node.names:
                yield node.lineno, f"{base}.{alias.name}"


def misplaced_imports(source: str, room: str, package: str, where: str) -> list[str]:
    """One sentence for each import in `source` that its room may not make."""
    faults = []
    for line, name in imported_modules(source, package):
        parts = name.split(".")
        if parts[0] == "matplotlib" and room not in DRAWING_ROOMS:
            faults.append(f"{where}:{line}: imports matplotlib; only {DRAWING_ROOMS} draw")
        if parts[0] != "bayes_sensor" or parts[1:] in ([room], ["__version__"]):
            continue
        if len(parts) < 2 or parts[1] not in ROOMS:
            faults.append(f"{where}:{line}: imports {name}; import from the room that defines it")
        elif ROOMS.index(parts[1]) > ROOMS.index(room):
            faults.append(f"{where}:{line}: {room} imports {parts[1]}, which stands below it")
    return faults


def test_a_room_imports_only_rooms_above_it() -> None:
    faults = []
    for file in sorted(PACKAGE.rglob("*.py")):
        room, where = room_of(file), file.relative_to(ROOT).as_posix()
        if not room:
            continue  # the top __init__ hands out names from everywhere, lazily
        if room not in ROOMS:
            faults.append(f"{where}: place the room {room!r} in ROOMS in tests/whole/test_frame.py")
            continue
        package = ".".join(file.relative_to(ROOT).parent.parts)
        faults += misplaced_imports(file.read_text(encoding="utf-8"), room, package, where)
    assert not faults, "\n".join(faults)


@pytest.mark.parametrize(
    "source",
    [
        "import bayes_sensor.report",
        "from bayes_sensor import report",
        "from bayes_sensor.report import render",
        "from .report import render",
        "from . import report",
        "def f():\n    from bayes_sensor.report import render",
        "import bayes_sensor as bs",
        "from bayes_sensor import diagnose_gap",
        "import matplotlib.pyplot as plt",
    ],
)
def test_a_misplaced_import_is_seen(source: str) -> None:
    assert len(misplaced_imports(source, "rig", "bayes_sensor", "rig.py")) == 1


@pytest.mark.parametrize(
    ("source", "package"),
    [
        ("from ..campaign import Campaign", "bayes_sensor.diagnosis"),
        ("from .locate import where", "bayes_sensor.diagnosis"),
        ("from bayes_sensor.diagnosis.effects import CATALOGUE", "bayes_sensor.diagnosis"),
        ("from bayes_sensor import __version__", "bayes_sensor.diagnosis"),
        ("import numpy as np", "bayes_sensor.diagnosis"),
    ],
)
def test_a_proper_import_is_left_alone(source: str, package: str) -> None:
    assert misplaced_imports(source, "diagnosis", package, "diagnosis.py") == []


# --- one idea a file: no circle of imports, no name twice, no long file

CIRCLES: dict[frozenset[str], str] = {}
"""circles of imports that are left, modules without the package's name, and why"""

MOST_LINES = 500
LONG_FILES: frozenset[str] = frozenset()
"""files over MOST_LINES; the list only shrinks"""

SAME_NAMES: frozenset[str] = frozenset({"readout.py"})
"""file names that stand in several folders; the list only shrinks"""


def modules() -> dict[str, Path]:
    """Every module of the package by its dotted name without ``bayes_sensor``."""
    found = {}
    for file in sorted(PACKAGE.rglob("*.py")):
        parts = list(file.relative_to(PACKAGE).with_suffix("").parts)
        found[".".join(parts[:-1] if parts[-1] == "__init__" else parts)] = file
    return found


def import_graph(sources: dict[str, tuple[str, str]]) -> dict[str, set[str]]:
    """The modules that each imports, anywhere in it; ``sources``: its package and its text.

    A package that an import only passes through does not count: it hands names on.
    """
    graph: dict[str, set[str]] = {}
    for module, (package, text) in sources.items():
        graph[module] = set()
        for _, name in imported_modules(text, package):
            known = name.removeprefix("bayes_sensor").removeprefix(".")
            if not name.startswith("bayes_sensor"):
                continue
            while known and known not in sources:
                known = known.rpartition(".")[0]
            if known and known != module:
                graph[module].add(known)
    return graph


def circles(graph: dict[str, set[str]]) -> list[frozenset[str]]:
    """Sets of modules that can all be reached from each other (Tarjan's components)."""
    number: dict[str, int] = {}
    lowest: dict[str, int] = {}
    stack: list[str] = []
    found = []

    def visit(module: str) -> None:
        number[module] = lowest[module] = len(number)
        stack.append(module)
        for other in sorted(graph[module]):
            if other not in number:
                visit(other)
            if other in stack:
                lowest[module] = min(lowest[module], lowest[other])
        if lowest[module] == number[module]:
            i = stack.index(module)
            if len(stack) - i > 1:
                found.append(frozenset(stack[i:]))
            del stack[i:]

    for module in graph:
        if module not in number:
            visit(module)
    return found


def test_no_circle_of_imports_is_left() -> None:
    sources = {}
    for module, file in modules().items():
        package = ".".join(file.relative_to(ROOT).parent.parts)
        sources[module] = (package, file.read_text(encoding="utf-8"))
    sources.pop("")  # the top hands out names from everywhere, lazily
    found = circles(import_graph(sources))
    new = [sorted(circle) for circle in found if circle not in CIRCLES]
    assert not new, f"modules that import each other: {new}; part what both need"
    gone = [sorted(circle) for circle in CIRCLES if circle not in found]
    assert not gone, f"take these out of CIRCLES: {gone}"


def test_a_circle_of_imports_is_seen() -> None:
    package = "bayes_sensor.rig"
    sources = {
        "rig.a": (package, "from bayes_sensor.rig.b import f"),
        "rig.b": (package, "def f():\n    from .c import g"),
        "rig.c": (package, "import bayes_sensor.rig.a"),
        "rig.d": (package, "from bayes_sensor.rig import a"),
    }
    assert circles(import_graph(sources)) == [frozenset({"rig.a", "rig.b", "rig.c"})]
    assert not circles(import_graph({k: v for k, v in sources.items() if k != "rig.b"}))


# --- the rig is told, not assumed

KERNELS_OF_THE_PUBLISHED_CHAIN = ("node_response", "cascade_kernels")
"""compiled for one pulse through valve, manifold and sensor, in that rig's order of theta"""


def assumptions_about_the_rig(source: str) -> list[str]:
    """Where `source` counts on a parameter's position in theta, or on one type of model."""
    found = []
    for node in ast.walk(ast.parse(source)):
        if isinstance(node, ast.Subscript):
            owner = node.value
            name = getattr(owner, "id", getattr(owner, "attr", ""))
            inside = node.slice.elts if isinstance(node.slice, ast.Tuple) else [node.slice]
            if name in ("theta", "thetas", "vector") and any(
                isinstance(each, ast.Constant) and isinstance(each.value, int) for each in inside
            ):
                found.append(f"{node.lineno}: {ast.unparse(node)}; take positions from the layout")
        if isinstance(node, (ast.Compare, ast.Call)):
            asks = isinstance(node, ast.Compare) or getattr(node.func, "id", "") == "isinstance"
            words = {getattr(each, "id", "") for each in ast.walk(node)}
            if asks and "Cascade" in words and words & {"type", "isinstance"}:
                found.append(f"{node.lineno}: {ast.unparse(node)}; ask Problem.chain")
    return found


def test_nobody_but_the_rig_knows_positions_in_theta_or_types_of_model() -> None:
    faults = []
    for file in sorted(PACKAGE.rglob("*.py")):
        if room_of(file) in ("rig", "blind_check") or file.stem in KERNELS_OF_THE_PUBLISHED_CHAIN:
            continue  # the examiner has numerics of its own
        where = file.relative_to(ROOT).as_posix()
        faults += [
            f"{where}:{fault}"
            for fault in assumptions_about_the_rig(file.read_text(encoding="utf-8"))
        ]
    assert not faults, "\n".join(faults)


@pytest.mark.parametrize(
    "source",
    [
        "tau = theta[0]",
        "self.theta[1] = 2.0",
        "thetas[:, 0]",
        "a.reference if vector[2] else 0",
        "type(problem.model) is Cascade",
        "if type(model) is not Cascade: pass",
        "isinstance(model, Cascade)",
    ],
)
def test_an_assumption_about_the_rig_is_seen(source: str) -> None:
    assert len(assumptions_about_the_rig(source)) == 1


def test_a_named_place_is_left_alone() -> None:
    source = "theta[layout.tau]; theta[: layout.n_mean]; rows[0]; isinstance(x, Campaign)"
    assert not assumptions_about_the_rig(source)


def test_no_two_files_have_one_name() -> None:
    names = [file.name for file in PACKAGE.rglob("*.py") if file.name != "__init__.py"]
    twice = {name for name in names if names.count(name) > 1}
    assert not twice - SAME_NAMES, f"name these for what they hold: {sorted(twice - SAME_NAMES)}"
    assert not SAME_NAMES - twice, f"take out of SAME_NAMES: {sorted(SAME_NAMES - twice)}"


def test_no_file_is_long() -> None:
    long = {
        file.relative_to(PACKAGE).as_posix(): n
        for file in PACKAGE.rglob("*.py")
        if (n := len(file.read_text(encoding="utf-8").splitlines())) > MOST_LINES
    }
    new = {name: n for name, n in long.items() if name not in LONG_FILES}
    assert not new, f"more than {MOST_LINES} lines: {new}; part them by idea"
    assert not LONG_FILES - set(long), f"take out of LONG_FILES: {sorted(LONG_FILES - set(long))}"


# --- the tests

TESTS = ROOT / "tests"
OTHER_FOLDERS = ("support", "record", "whole")  # helpers, recorded results, what several rooms do


def test_the_tests_mirror_the_rooms() -> None:
    places = {file.relative_to(TESTS).parts[0] for file in TESTS.rglob("*.py")}
    names = {place.removeprefix("test_").removesuffix(".py") for place in places}
    assert names - set(ROOMS) - {*OTHER_FOLDERS, "conftest", "__init__"} == set()
    untested = set(ROOMS) - names - {"campaign"}  # by io/test_readers.py
    assert untested == set()


def private_names(source: str) -> Iterator[tuple[int, str]]:
    """Line and name of everything private that a test imports, looks up or replaces."""
    tree = ast.parse(source)
    ours = {"self", "cls"}
    for node in ast.walk(tree):
        names: list[str] = []
        if isinstance(node, ast.ImportFrom) and (node.module or "").startswith("bayes_sensor"):
            names = [*str(node.module).split("."), *(alias.name for alias in node.names)]
        elif isinstance(node, ast.Import):
            names = [part for alias in node.names for part in alias.name.split(".")]
        elif isinstance(node, ast.Attribute):
            if not (isinstance(node.value, ast.Name) and node.value.id in ours):
                names = [node.attr]
        elif isinstance(node, ast.Call) and isinstance(node.func, ast.Attribute):
            if node.func.attr in ("setattr", "delattr"):
                given = [a.value for a in node.args if isinstance(a, ast.Constant)]
                names = [part for text in map(str, given) for part in text.split(".")]
        for name in names:
            if re.match(r"_[A-Za-z]", name) and not name.endswith("_"):  # _repr_html_ is IPython's
                yield node.lineno, name


def test_the_tests_use_public_names_only() -> None:
    found = []
    for file in sorted(TESTS.rglob("*.py")):
        for line, name in private_names(file.read_text(encoding="utf-8")):
            found.append(f"{file.relative_to(ROOT)}:{line}: {name} is private")
    assert not found, "\n".join(found)


@pytest.mark.parametrize(
    "source",
    [
        "from bayes_sensor.fit import _start",
        "import bayes_sensor._fit",
        "module._start(1)",
        "monkeypatch.setattr(module, '_start', None)",
        "monkeypatch.setattr('bayes_sensor.fit._start', None)",
    ],
)
def test_a_private_name_is_seen(source: str) -> None:
    assert len(list(private_names(source))) == 1


# --- tested versions


@pytest.mark.parametrize("name", ["constraints-3.11.txt", "constraints-3.12.txt"])
def test_constraints_are_names_and_exact_versions_only(name: str) -> None:
    lines = (ROOT / name).read_text().splitlines()
    pins = [line for line in lines if not line.startswith("#")]
    assert len(pins) > 50
    for line in pins:
        assert re.fullmatch(r"[A-Za-z0-9._-]+==[A-Za-z0-9._+!]+", line), f"{name}: {line!r}"


@pytest.mark.parametrize("name", ["constraints-3.11.txt", "constraints-3.12.txt"])
def test_constraints_cover_every_dependency_and_extra(name: str) -> None:
    def normal(text: str) -> str:
        return re.sub(r"[-_.]+", "-", text).lower()

    project = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
    groups = [project["dependencies"], *project["optional-dependencies"].values()]
    names = {normal(re.split(r"[^A-Za-z0-9._-]", entry)[0]) for group in groups for entry in group}
    pinned = {normal(line.split("==")[0]) for line in (ROOT / name).read_text().splitlines()}
    assert names - pinned == {"bayes-sensor"}


# --- Makefile


@pytest.mark.parametrize("target", MAKE_TARGETS)
def test_makefile_has_target(target: str) -> None:
    text = (ROOT / "Makefile").read_text()
    assert re.search(rf"^{target}:", text, flags=re.MULTILINE)
    phony = re.search(r"^\.PHONY:((?:.*\\\n)*.*)$", text, flags=re.MULTILINE)
    assert phony is not None
    assert target in phony[1].split(), f"{target} is not .PHONY: a folder of that name hides it"


def test_ci_script_can_be_run() -> None:
    script = ROOT / ".ci" / "run"
    assert script.stat().st_mode & 0o111
    assert "set -euo pipefail" in script.read_text()


# --- no traces of a machine

MACHINE_TRACES = {
    "package host": re.compile(
        r"pypi\.org|pythonhosted\.org|registry\.npmjs|deb\.debian\.org|conda\.anaconda\.org"
        r"|--(?:extra-)?index-url[ =]|--find-links[ =]|(?:artifactory|devpi|nexus)[\w.-]*[:/]\d*/"
    ),
    "absolute path": re.compile(
        r"(?<![\w.~-])/(?:work|root|home|Users|var/folders)/\w|/tmp/[i]pykernel_|\b[A-Z]:\\+Users\b"
    ),
}


def traces(text: str) -> list[str]:
    """'kind: the text found' for everything in `text` that belongs to one machine."""
    return [f"{kind}: {m[0]!r}" for kind, law in MACHINE_TRACES.items() for m in law.finditer(text)]


def repository_files() -> list[Path]:
    """The files that git tracks; a test of an unpacked archive has none and is skipped."""
    if shutil.which("git") is None or not (ROOT / ".git").exists():
        pytest.skip("not a git checkout")
    listing = subprocess.run(
        ["git", "ls-files", "-z"], cwd=ROOT, check=True, capture_output=True, text=True
    ).stdout
    return [ROOT / name for name in listing.split("\0") if name and (ROOT / name).is_file()]


def test_no_file_names_a_package_host_or_a_path_of_one_machine() -> None:
    found = []
    for file in repository_files():
        content = file.read_bytes()
        if b"\0" in content:
            continue  # binary
        for number, line in enumerate(content.decode("utf-8", errors="replace").split("\n"), 1):
            found += [f"{file.relative_to(ROOT)}:{number}: {trace}" for trace in traces(line)]
    assert not found, "\n".join(found)


def test_traces_of_a_machine_are_seen() -> None:
    # Put together here, so that this file does not hold what it looks for.
    for text in ("https://" + "pypi" + ".org/simple", "open('" + "/home" + "/me/x.csv')"):
        assert len(traces(text)) == 1
    for text in ("https://example.org/home/page", "tests/root/x", "tau_v / V"):
        assert traces(text) == []
