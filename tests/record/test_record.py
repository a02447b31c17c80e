"""The results of a recorded version stay what they were: ``tests/record/results.json``.

A part of the campaigns, in a size for the suite; ``make record`` compares all of them.  Where a
difference is meant, ``python tests/record/make.py`` writes the record anew, and CHANGELOG.md says
what changed.
"""

from __future__ import annotations

import copy
from collections.abc import Iterator
from typing import Any

import pytest

from tests.record.make import (
    RECORD,
    RELATIVE,
    ROOT,
    SIMULATED,
    campaigns,
    differences,
    main,
    provenance,
    read_record,
    results_of,
    text_of,
)

COMPARED = (
    "data/reference",
    "data/withheld",
    "simulated/mains_pickup",
)
"""the bundled ones, the second with an effect on the mean, and one with an effect on the noise"""
LIBRARIES = ("python", "numpy", "scipy", "numba")


@pytest.mark.slow
@pytest.mark.parametrize("name", COMPARED)
def test_results_are_those_that_were_recorded(name: str) -> None:
    made_with, now = read_record()["made_with"], provenance()
    other = [f"{key} {now[key]}" for key in LIBRARIES if now[key] != made_with[key]]
    if other:
        # chains are chaotic: the last digit of another library's exp() moves whole draws
        pytest.skip(f"recorded with other versions than {', '.join(other)}")
    found = results_of(campaigns()[name])
    said = list(differences(read_record()["campaigns"][name], found, name))
    assert not said, "\n".join(said)


def test_the_record_holds_every_campaign_of_this_checkout() -> None:
    recorded = read_record()["campaigns"]
    assert set(campaigns()) <= set(recorded)
    assert set(COMPARED) <= set(recorded)
    for name in ("read", "fit", "posterior", "bounds", "delays", "residuals", "gap"):
        assert "error" not in recorded["data/reference"][name]
    effects = {effect for one in SIMULATED.values() for effect in one.effects}
    assert len(effects) == 21
    assert {one.sensor_is for one in SIMULATED.values()} == {"faster", "slower", "unknown"}


def test_the_record_is_compact_and_names_no_place() -> None:
    text = RECORD.read_text(encoding="utf-8")
    assert len(text.encode()) < 350_000
    assert text == text_of(read_record()), "it was changed by hand"
    assert str(ROOT) not in text


# --- the comparison itself: it must see one number in thousands, and nothing where nothing is


def places(value: Any, path: tuple[Any, ...] = ()) -> Iterator[tuple[Any, ...]]:
    """The way to every number, text and truth value of a record."""
    if isinstance(value, dict):
        for key, entry in value.items():
            yield from places(entry, (*path, key))
    elif isinstance(value, list):
        for i, entry in enumerate(value):
            yield from places(entry, (*path, i))
    else:
        yield path


def changed(record: dict[str, Any], path: tuple[Any, ...], factor: float) -> dict[str, Any]:
    """A copy in which the number at ``path`` is another, or the text or truth value is."""
    copied = copy.deepcopy(record)
    inside: Any = copied
    for key in path[:-1]:
        inside = inside[key]
    value = inside[path[-1]]
    if isinstance(value, bool):
        inside[path[-1]] = not value
    elif isinstance(value, int | float):
        inside[path[-1]] = value * factor if value else factor - 1.0
    else:
        inside[path[-1]] = f"{value}." if isinstance(value, str) else 1.0
    return copied


def test_any_one_change_is_seen_and_named() -> None:
    for name in ("data/reference", "simulated/valve_asymmetry"):
        record = read_record()["campaigns"][name]
        assert list(differences(record, record)) == []
        unseen = []
        for path in places(record):
            said = list(differences(record, changed(record, path, 1.01)))
            if len(said) != 1 or not said[0].startswith("/" + "/".join(map(str, path)) + ": "):
                unseen.append((path, said))
        # what has no unit may be too small to count: a p-value of 1e-40
        for path, said in unseen:
            value: Any = record
            for key in path:
                value = value[key]
            assert said == [] and abs(value) < 1e-6, path


def test_rounding_is_no_difference() -> None:
    record = read_record()["campaigns"]["data/reference"]
    for path in places(record):
        value: Any = record
        for key in path:
            value = value[key]
        if isinstance(value, float) and value:
            assert list(differences(record, changed(record, path, 1.0 + RELATIVE / 10))) == []


def test_what_is_missing_or_new_is_a_difference() -> None:
    record = read_record()["campaigns"]["data/reference"]
    without = {key: value for key, value in record.items() if key != "gap"}
    assert next(differences(record, without)).startswith("/gap: recorded")
    assert next(differences(without, record)).startswith("/gap: not recorded")
    assert next(differences([1, 2], [1]))
    assert next(differences(1.0, float("nan")))
    assert next(differences(True, 1))


def test_the_script_fails_on_another_number(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    record = read_record()["campaigns"]["simulated/none"]
    found = changed(record, ("fit", "rms_V"), 1.0001)
    monkeypatch.setattr("tests.record.make.results_of", lambda make: found)
    before = RECORD.read_bytes()
    assert main(["--check", "--only", "simulated/none"]) == 1
    assert "simulated/none/fit/rms_V: recorded" in capsys.readouterr().out
    monkeypatch.setattr("tests.record.make.results_of", lambda make: record)
    assert main(["--check", "--only", "simulated/none"]) == 0
    assert "no difference" in capsys.readouterr().out
    assert RECORD.read_bytes() == before
