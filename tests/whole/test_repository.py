"""Files beside the package: they parse, agree with pyproject.toml, and call what exists."""

import re
import tomllib
from pathlib import Path
from typing import Any

import pytest
import typer

import bayes_sensor
from bayes_sensor.cli import app

ROOT = Path(__file__).resolve().parents[2]
yaml = pytest.importorskip("yaml")
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
EXTRAS = set(PROJECT["optional-dependencies"])
CONDA_NAMES = {"matplotlib": "matplotlib-base", "typst": "typst-py"}
"""what a requirement is called there, where it is called otherwise"""


def text(name: str) -> str:
    """A file of the repository."""
    return (ROOT / name).read_text(encoding="utf-8")


def load(name: str) -> Any:
    """A YAML file, its scalars as they are written."""
    return yaml.load(text(name), Loader=yaml.BaseLoader)


def test_the_workflow_calls_what_every_change_must_pass() -> None:
    jobs = load(".github/workflows/ci.yml")["jobs"]
    commands = [step["run"] for job in jobs.values() for step in job["steps"] if "run" in step]
    assert ".ci/run" in commands and (ROOT / ".ci" / "run").stat().st_mode & 0o111
    for command in commands:
        target = re.fullmatch(r"make ([\w-]+)", command)
        assert command == ".ci/run" or (target and f"\n{target[1]}:" in text("Makefile"))
    versions = " ".join(
        step["with"]["python-version"]
        for job in jobs.values()
        for step in job["steps"]
        if "python-version" in step.get("with", {})
    ).split()
    declared = [c.rpartition(" ")[2] for c in PROJECT["classifiers"] if "Python :: 3." in c]
    assert sorted(versions) == sorted(declared)


def test_dependabot_looks_after_both_kinds() -> None:
    updates = load(".github/dependabot.yml")["updates"]
    assert {entry["package-ecosystem"] for entry in updates} == {"pip", "github-actions"}
    assert all((ROOT / entry["directory"].lstrip("/")).is_dir() for entry in updates)


FORMS = sorted(p for p in (ROOT / ".github/ISSUE_TEMPLATE").glob("*.yml") if p.stem != "config")


@pytest.mark.parametrize("form", FORMS, ids=lambda form: form.stem)
def test_an_issue_form_is_one(form: Path) -> None:
    content = yaml.load(form.read_text(encoding="utf-8"), Loader=yaml.BaseLoader)
    assert content["name"] and content["description"]
    ids = [field["id"] for field in content["body"]]
    assert len(ids) == len(set(ids))
    for field in content["body"]:
        assert field["type"] in ("input", "textarea", "checkboxes", "dropdown")
        assert field["attributes"]["label"]
    for name in re.findall(r"`bayes-sensor ([a-z][a-z-]+)", form.read_text(encoding="utf-8")):
        assert name in vars(typer.main.get_command(app))["commands"]


def requirements(lines: list[str]) -> dict[str, str]:
    """Name to version, without markers; of two for several Pythons the newer one."""
    found = {}
    for line in lines:
        name, version = re.fullmatch(
            r"([\w-]+)\s*(>=[\d.]+)?[^;]*", line.partition(";")[0]
        ).groups()  # type: ignore[union-attr]
        found[name.casefold()] = version or ""
    return found


def test_the_conda_recipe_has_the_requirements_of_the_package() -> None:
    recipe = text("conda/meta.yaml")
    assert f'set version = "{bayes_sensor.__version__}"' in recipe
    filled = re.sub(r"\{%.*?%\}", "", recipe).replace("{{ version }}", bayes_sensor.__version__)
    content = yaml.load(filled.replace("{{ PYTHON }}", "python"), Loader=yaml.BaseLoader)
    listed = requirements(content["requirements"]["run"])
    listed.pop("python")
    wanted = requirements(PROJECT["dependencies"])
    assert listed == {CONDA_NAMES.get(name, name): v for name, v in wanted.items()}
    build = tomllib.loads(text("pyproject.toml"))["build-system"]["requires"]
    assert build[0].replace(">=", " >=") in content["requirements"]["host"]
    ((name, target),) = PROJECT["scripts"].items()
    assert content["build"]["entry_points"] == [f"{name} = {target}"]
    assert content["about"]["license"] == PROJECT["license"]


def test_the_container_and_binder_take_tested_versions_and_files_that_exist() -> None:
    docker, binder = text("Dockerfile"), text(".binder/postBuild")
    python = text(".binder/runtime.txt").strip().removeprefix("python-")
    assert f"FROM python:{python}-" in docker
    for script in (docker, binder):
        assert f"-c constraints-{python}.txt" in script
        assert (ROOT / f"constraints-{python}.txt").exists()
        (extras,) = re.findall(r'"\.\[([\w,]+)\]"', script)
        assert set(extras.split(",")) <= EXTRAS
    copied = [
        name for line in re.findall(r"^COPY (.*)$", docker, re.M) for name in line.split()[:-1]
    ]
    let_in = re.findall(r"^!(.*)$", text(".dockerignore"), re.M)
    assert sorted(copied) == sorted(let_in)
    # what building a wheel reads: the readme and the licence that pyproject.toml names
    assert {"pyproject.toml", PROJECT["readme"], *PROJECT["license-files"]} <= set(copied)
    assert all((ROOT / name).exists() for name in copied)
    assert (ROOT / ".binder" / "postBuild").stat().st_mode & 0o111


def test_the_paper_has_the_form_of_the_journal() -> None:
    _, header, body = text("paper/paper.md").split("---\n", 2)
    told = yaml.load(header, Loader=yaml.BaseLoader)
    assert {"title", "tags", "authors", "affiliations", "date", "bibliography"} <= set(told)
    indices = {entry["index"] for entry in told["affiliations"]}
    assert all(author["name"] and author["affiliation"] in indices for author in told["authors"])
    sections = re.findall(r"^# (.*)$", body, re.M)
    assert sections[:2] == ["Summary", "Statement of need"] and sections[-1] == "References"
    known = re.findall(r"^@\w+\{(\w+),", text(f"paper/{told['bibliography']}"), re.M)
    cited = re.findall(r"@(\w+)", body)
    assert len(cited) > 5 and set(cited) <= set(known)
    assert 250 <= len(body.split()) <= 1000  # what the journal asks for
