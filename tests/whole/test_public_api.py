"""What others build on stays: public names with signatures and commands with options are listed.

``tests/whole/public_api.txt`` holds the list.  After a change that is meant, ``python
tests/whole/test_public_api.py`` writes it anew (the package must be installed or on PYTHONPATH),
and ``CHANGELOG.md`` says what changed and why.
"""

import dataclasses
import difflib
import inspect
import subprocess
import sys
from collections.abc import Callable, Iterator
from functools import cached_property
from pathlib import Path
from typing import Any

import pytest
import typer

import bayes_sensor
from bayes_sensor.cli import app

LISTED = Path(__file__).with_name("public_api.txt")
HEAVY = ("numba", "scipy", "pandas", "matplotlib", "arviz", "statsmodels", "skfem", "pint",
         "pydantic", "emcee", "h5py", "joblib", "corner", "typst", "jinja2", "xarray")  # fmt: skip


def signature(value: Callable[..., Any]) -> str:
    """``(a: float, b: int = 1) -> str``, the same on every Python."""

    def annotated(annotation: Any) -> str:
        return annotation if isinstance(annotation, str) else inspect.formatannotation(annotation)

    found = inspect.signature(value)
    parts, kinds = [], inspect.Parameter
    for p in found.parameters.values():
        if p.kind == kinds.KEYWORD_ONLY and "*" not in parts and not any(
            part.startswith("*") for part in parts
        ):  # fmt: skip
            parts.append("*")
        text = {kinds.VAR_POSITIONAL: "*", kinds.VAR_KEYWORD: "**"}.get(p.kind, "") + p.name
        if p.annotation is not p.empty:
            text += f": {annotated(p.annotation)}"
        if p.default is not p.empty:
            text += f" = {p.default!r}"
        parts.append(text)
    returned = found.return_annotation
    told = "" if returned is found.empty else f" -> {annotated(returned)}"
    return f"({', '.join(parts)}){told}"


def lines_of(name: str, value: Any) -> Iterator[str]:
    """A function's line, or a class's with its bases, fields, properties and methods."""
    if not inspect.isclass(value):
        yield f"{name}{signature(value)}"
        return
    if issubclass(value, Exception):
        yield f"{name}: {value.__mro__[1].__name__}"
    else:
        yield f"{name}{signature(value)}"
    fields = dataclasses.fields(value) if dataclasses.is_dataclass(value) else ()
    made_by_init = {field.name for field in fields}
    ours = [
        base
        for base in getattr(value, "__mro__", ())[::-1]
        if base.__module__.startswith("bayes_sensor")
    ]
    members = {member: what for base in ours for member, what in vars(base).items()}
    for member, what in sorted(members.items()):
        if member.startswith("_") or member in made_by_init:
            continue
        if isinstance(what, property | cached_property):
            yield f"{name}.{member}"
        elif isinstance(what, classmethod | staticmethod) or inspect.isfunction(what):
            yield f"{name}.{member}{signature(getattr(value, member))}"


def commands() -> Iterator[str]:
    """``bayes-sensor fit CAMPAIGN --out --seed``: each command with what it takes."""
    known: dict[str, Any] = vars(typer.main.get_command(app))["commands"]
    for name, command in sorted(known.items()):
        taken = []
        for parameter in command.params:
            # an argument has no spelling of its own: its place counts
            options = [*parameter.opts, *parameter.secondary_opts]
            taken += options if options[0].startswith("-") else [parameter.name.upper()]
        yield " ".join(["bayes-sensor", name, *taken])


def public_api() -> str:
    """The text of ``public_api.txt``."""
    names = [name for name in bayes_sensor.__all__ if name != "__version__"]
    found = [line for name in names for line in lines_of(name, getattr(bayes_sensor, name))]
    return "\n".join([*found, "", *commands()]) + "\n"


def test_public_names_and_commands_are_those_that_are_listed() -> None:
    listed = LISTED.read_text(encoding="utf-8").splitlines()
    found = public_api().splitlines()
    changed = list(difflib.unified_diff(listed, found, "listed", "found", n=0, lineterm=""))
    assert not changed, (
        "\n".join(changed)
        + "\nIf this is meant: python tests/whole/test_public_api.py writes the list "
        "anew, and CHANGELOG.md says what changed for whoever uses it"
    )


def test_a_changed_signature_is_seen() -> None:
    def before(a: float, *, seed: int = 1) -> float:
        return a * seed

    def after(a: float, *, seed: int = 2) -> float:
        return a * seed

    assert list(lines_of("f", before)) == ["f(a: float, *, seed: int = 1) -> float"]
    assert list(lines_of("f", before)) != list(lines_of("f", after))


def test_whatever_a_type_checker_asks_for_is_there() -> None:
    """Every public callable says the type of all it takes and returns."""
    bare = []
    for name in bayes_sensor.__all__:
        value = getattr(bayes_sensor, name)
        if not callable(value) or inspect.isclass(value):
            continue
        found = inspect.signature(value)
        told = [found.return_annotation, *(p.annotation for p in found.parameters.values())]
        if inspect.Parameter.empty in told:
            bare.append(name)
    assert not bare
    assert (Path(bayes_sensor.__file__).parent / "py.typed").exists()


# --- what an import brings with it


def loaded_by(code: str) -> set[str]:
    """Top-level names in ``sys.modules`` of a new interpreter after `code`."""
    done = subprocess.run(
        [sys.executable, "-c", f"{code}\nimport sys; print(*sys.modules)"],
        capture_output=True, text=True, check=True,
    )  # fmt: skip
    return {name.split(".")[0] for name in done.stdout.split()}


def test_importing_the_package_loads_nothing_but_python_itself() -> None:
    brought = loaded_by("import bayes_sensor; dir(bayes_sensor)") - loaded_by("")
    foreign = brought - {"bayes_sensor"} - set(sys.stdlib_module_names)
    assert not foreign, f"import bayes_sensor loads {sorted(foreign)}"


@pytest.mark.parametrize("name", ["Campaign", "CampaignError", "progress_bar"])
def test_records_need_numpy_at_most(name: str) -> None:
    loaded = loaded_by(f"from bayes_sensor import {name}")
    assert "bayes_sensor" in loaded
    assert not loaded & set(HEAVY)


def test_what_is_heavy_is_seen_where_it_is_used() -> None:
    assert "numba" in loaded_by("from bayes_sensor import cascade_response")


if __name__ == "__main__":
    LISTED.write_text(public_api(), encoding="utf-8")
    print(f"written: {LISTED}")
