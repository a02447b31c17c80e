"""What is handed out: optional packages stay away until asked for, and are named where missing."""

import importlib.util
import re
import subprocess
import sys
import tomllib
from functools import cache
from pathlib import Path
from types import ModuleType

import pytest

from bayes_sensor.cli import exit_code

ROOT = Path(__file__).resolve().parents[2]
STUDIES = ROOT / "paper" / "studies"
# what each extra brings, as it is imported; the environment of the tests itself is none of them
EXTRAS = {
    "parquet": ("pyarrow",),
    "tdms": ("nptdms",),
    "xlsx": ("openpyxl",),
    "cluster": ("dask", "distributed"),
    "bench": ("pints",),
    "docs": ("sphinx", "myst_nb", "furo", "latex2mathml"),
}
OPTIONAL = sorted({module for modules in EXTRAS.values() for module in modules})
# pydantic is not among them: newer versions of typer load it themselves
SLOW_TO_IMPORT = ("scipy", "numba", "pandas", "matplotlib", "arviz", "xarray", "pint", "emcee",
                  "statsmodels", "skfem", "h5py", "joblib", "typst", "jinja2")  # fmt: skip
CAMPAIGN = """
[[experiment]]
name = "1"
file = "FILE"
carrier_flow = "4.0 L/min"
test_gas_flow = "0.5 L/min"
"""
# put before code: imports of what it names fail as if it were not installed
BLOCKED = """
import sys
class Absent:
    def find_spec(self, name, path=None, target=None):
        if name.partition(".")[0] in {names!r}:
            raise ModuleNotFoundError(f"No module named {name!r}", name=name)
sys.meta_path.insert(0, Absent())
""".replace("{names!r}", repr(OPTIONAL))


@cache
def study(name: str) -> ModuleType:
    """A script of paper/studies as a module."""
    spec = importlib.util.spec_from_file_location(f"studied_{name}", STUDIES / f"{name}.py")
    assert spec is not None and spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    sys.modules[spec.name] = module  # dataclasses look for their module there
    spec.loader.exec_module(module)
    return module


def without(monkeypatch: pytest.MonkeyPatch, extra: str) -> None:
    """From here on an import of what the extra brings fails as if it were not installed."""
    for module in EXTRAS[extra]:
        monkeypatch.setitem(sys.modules, module, None)


def python(code: str) -> str:
    """What a new interpreter prints."""
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    return done.stdout


# --- extras: away until asked for


def test_every_extra_is_known_here_and_to_the_study() -> None:
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    declared = set(project["optional-dependencies"])
    assert declared == {*EXTRAS, "formats", "test"}
    # what a user of an installed wheel can run into
    assert {extra: EXTRAS[extra][-1] for extra in ("parquet", "tdms", "cluster")} == study(
        "study_packaging"
    ).EXTRAS


@pytest.mark.slow
def test_every_module_can_be_imported_without_any_extra() -> None:
    printed = python(
        BLOCKED + "import importlib, pkgutil, warnings; warnings.simplefilter('ignore')\n"
        "import bayes_sensor\n"
        "names = [m.name for m in pkgutil.walk_packages(bayes_sensor.__path__, 'bayes_sensor.')]\n"
        "for name in names:\n"
        "    if not name.endswith('__main__'): importlib.import_module(name)\n"
        "for name in bayes_sensor.__all__: getattr(bayes_sensor, name)\n"
        "print(len(names))"
    )
    assert int(printed) > 100


@pytest.mark.parametrize("module", OPTIONAL)
def test_what_is_blocked_above_cannot_be_imported(module: str) -> None:
    done = subprocess.run(
        [sys.executable, "-c", f"{BLOCKED}\nimport {module}"], capture_output=True, text=True
    )
    assert f"ModuleNotFoundError: No module named '{module}'" in done.stderr


def test_help_and_version_load_neither_extras_nor_numerics() -> None:
    asked = (["--version"], ["--help"], ["fit", "--help"], ["fleet", "--help"], ["gap", "--help"])
    printed = python(
        "import sys\nfrom bayes_sensor.cli import exit_code\n"
        f"for words in {asked!r}: assert exit_code(words) == 0\n"
        "print('loaded:', *{m.partition('.')[0] for m in sys.modules})"
    )
    assert "bayes-sensor" in printed and "Usage" in printed
    loaded = set(printed.rpartition("loaded:")[2].split())
    assert "bayes_sensor" in loaded
    assert not loaded & {*OPTIONAL, *SLOW_TO_IMPORT}


def test_import_takes_less_than_half_a_second() -> None:
    spent = "time.process_time()"
    code = f"import time; s = {spent}; import bayes_sensor; print({spent} - s)"
    assert min(float(python(code)) for _ in range(3)) < 0.5


# --- extras: named where missing


def assert_names(extra: str, said: str) -> None:
    """One line that ends with how to get the extra."""
    assert said.startswith("error: ") and said.count("\n") == 1
    assert "Traceback" not in said
    assert f"pip install 'bayes-sensor[{extra}]'" in said


@pytest.mark.parametrize("extra", ["parquet", "tdms", "xlsx"])
@pytest.mark.parametrize("command", ["check", "fit"])
def test_a_file_format_names_its_extra(
    command: str, extra: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:  # fmt: skip
    (tmp_path / f"a.{extra}").write_bytes(b"anything")
    (tmp_path / "campaign.toml").write_text(CAMPAIGN.replace("FILE", f"a.{extra}"))
    without(monkeypatch, extra)
    out = ["--out", str(tmp_path / "out")] if command == "fit" else []
    assert exit_code([command, str(tmp_path / "campaign.toml"), *out]) == 2
    said = capsys.readouterr().err
    assert_names(extra, said)
    assert f"a.{extra}" in said
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize("command", ["coverage", "blind-check", "fleet"])
def test_a_scheduler_names_its_extra(
    command: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:  # fmt: skip
    without(monkeypatch, "cluster")
    listing = [str(ROOT / "data" / "reference")] if command == "fleet" else []
    out, scheduler = ["--out", str(tmp_path / "out")], ["--scheduler", "tcp://localhost:1"]
    assert exit_code([command, *listing, *out, *scheduler]) == 2
    assert_names("cluster", capsys.readouterr().err)


def test_every_command_with_a_scheduler_is_tried_above() -> None:
    text = (ROOT / "tests" / "whole" / "public_api.txt").read_text(encoding="utf-8")
    found = re.findall(r"^bayes-sensor (\S+) .*--scheduler", text, flags=re.MULTILINE)
    assert found == ["blind-check", "coverage", "fleet"]


def test_the_benchmark_goes_on_without_pints_and_names_its_extra(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    without(monkeypatch, "bench")
    # the look for PINTS comes before anything else, so that no problem is needed
    assert study("benchmark").pints_log_likelihoods(None) is None
    assert "pip install 'bayes-sensor[bench]'" in capsys.readouterr().err


@pytest.mark.parametrize("absent", ["myst_nb", "furo", "latex2mathml"])
def test_the_pages_name_their_extra(absent: str, monkeypatch: pytest.MonkeyPatch) -> None:
    errors = pytest.importorskip("sphinx.errors")
    monkeypatch.setitem(sys.modules, absent, None)
    code = compile((ROOT / "docs" / "conf.py").read_text(encoding="utf-8"), "conf.py", "exec")
    monkeypatch.setattr(sys, "path", [*sys.path])
    with pytest.raises(errors.ConfigError, match=rf"{absent}.*pip install '.*\[docs\]'"):
        exec(code, {"__file__": str(ROOT / "docs" / "conf.py"), "__name__": "conf"})
