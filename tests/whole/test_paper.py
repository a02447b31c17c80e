"""The manuscript: built from the tables, numbers and references real, gaps left out or named."""

import csv
import importlib.util
import json
import re
import shutil
from pathlib import Path
from types import ModuleType

import pytest
import typst

PAPER = Path(__file__).resolve().parents[2] / "paper"


@pytest.fixture
def paper(tmp_path: Path) -> ModuleType:
    """paper/build.py at work in a copy of what it reads."""
    copy = tmp_path / "paper"
    copy.mkdir()
    for name in ("manuscript.typ", "references.bib", "build.py"):
        shutil.copy(PAPER / name, copy / name)
    shutil.copytree(PAPER / "tables", copy / "tables")
    shutil.copytree(PAPER / "figures", copy / "figures", ignore=shutil.ignore_patterns("*.png"))
    spec = importlib.util.spec_from_file_location("paper_build", copy / "build.py")
    assert spec is not None and spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def pages(pdf: Path) -> int:
    content = pdf.read_bytes()
    assert content.startswith(b"%PDF")
    return max(int(n) for n in re.findall(rb"/Count (\d+)", content))


@pytest.mark.tables
def test_the_manuscript_is_built_and_follows_its_tables(paper: ModuleType, tmp_path: Path) -> None:
    paper.build(tmp_path / "a.pdf")
    whole = pages(tmp_path / "a.pdf")
    assert whole >= 8
    for path in (tmp_path / "paper" / "tables").glob("reproduction*.csv"):
        path.unlink()
    paper.build(tmp_path / "b.pdf")  # a section without its tables is left out
    assert pages(tmp_path / "b.pdf") < whole


def labels(folder: Path) -> set[str]:
    """Labels of the figures and tables that the manuscript in ``folder`` has."""
    tables = ",".join(path.stem for path in (folder / "tables").glob("*.csv"))
    found = typst.query(
        folder / "manuscript.typ", "figure", root=folder, sys_inputs={"tables": tables}
    )
    return {figure["label"].strip("<>") for figure in json.loads(found)}


@pytest.mark.tables
def test_what_is_computed_is_shown_and_what_is_not_is_left_out(
    paper: ModuleType, tmp_path: Path
) -> None:
    folder = tmp_path / "paper"
    power = folder / "tables" / "gap_power.csv"
    power.write_text(
        "claim,setting,n,k,value,low,high,goal,met\n"
        "null: a cause is named,ar1,60,0,0,0,0.06,<= 0.02,yes\n"
    )
    every = labels(folder)
    assert {"tab-power", "tab-card", "tab-hidden", "tab-flows", "tab-local"} <= every
    power.unlink()
    assert labels(folder) == every - {"tab-power"}
    for path in (folder / "tables").glob("*.csv"):
        if path.stem not in paper.NEEDED:
            path.unlink()
    assert labels(folder) < every
    paper.build(tmp_path / "least.pdf")


def test_a_missing_table_is_named(
    paper: ModuleType, tmp_path: Path, capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
) -> None:  # fmt: skip
    (tmp_path / "paper" / "tables" / "sbc.csv").unlink()
    monkeypatch.setattr("sys.argv", ["build.py", "--out", str(tmp_path / "c.pdf")])
    assert paper.main() == 2
    error = capsys.readouterr().err
    assert "sbc missing" in error and "make study" in error and error.count("\n") == 1
    assert not (tmp_path / "c.pdf").exists()


@pytest.mark.prose
def test_every_citation_is_in_the_bibliography() -> None:
    text = (PAPER / "manuscript.typ").read_text(encoding="utf-8")
    keys = set(re.findall(r"^@\w+\{(\w+),", (PAPER / "references.bib").read_text(), re.MULTILINE))
    labels = set(re.findall(r"<([\w-]+)>", text)) | {
        f"fig-{path.stem}" for path in (PAPER / "figures").glob("*.svg")
    }
    cited = set(re.findall(r"(?<![\w.])@([\w-]+)", text))
    assert cited <= keys | labels, cited - keys - labels
    assert keys <= cited, f"never cited: {keys - cited}"


@pytest.mark.tables
def test_reproduced_numbers_are_near_the_published_ones() -> None:
    with (PAPER / "tables" / "reproduction.csv").open(newline="") as stream:
        rows = {row["quantity"]: row for row in csv.DictReader(stream)}
    for name, tolerance in (
        ("RMS residual", 0.01), ("3 sigma of tau_s", 0.005), ("3 sigma of tau_v_s", 0.005),
        ("3 sigma of V_mL", 0.005), ("tau_v_s", 0.02), ("V_mL", 0.02),
    ):  # fmt: skip
        row = rows[name]
        assert float(row["ours"]) == pytest.approx(float(row["published"]), rel=tolerance), name
    with (PAPER / "tables" / "reproduction_table2.csv").open(newline="") as stream:
        inside = [row["inside"] == "True" for row in csv.DictReader(stream)]
    # 28 intervals of 95 %: 24 or more hold with probability .997
    assert len(inside) == 28 and sum(inside) >= 24


def test_every_study_can_be_started() -> None:
    # imports all of them: a name that has moved in the package shows here
    studies = importlib.import_module("run_all").STUDIES
    written = {path.stem for path in (PAPER / "studies").glob("study_*.py")}
    # these two have targets of their own in the Makefile
    assert written - {run.__module__ for run in studies.values()} == {
        "study_branches", "study_packaging",
    }  # fmt: skip
