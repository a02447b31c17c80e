"""Contents of saved results: checked against their schema and against each other."""

from pathlib import Path
from types import SimpleNamespace
from typing import Annotated, Any

import pytest
from pydantic import TypeAdapter, ValidationError

from bayes_sensor.campaign import CampaignError
from bayes_sensor.io.result_schema import check_result, check_together
from bayes_sensor.io.result_schema.schema_types import FileName, Num, Share, same_length

RUN: dict[str, Any] = {
    "version": 1, "last": "fit",
    "commands": {
        "fit": {
            "started": "", "finished": "", "seconds": {"fit": 1.0}, "exit_code": 0,
            "converged": True, "seed": 1, "settings": {"fit": {"swarms": 2, "bounds": [[0, 1]]}},
            "campaign": "", "files_sha256": {}, "basis_sha256": "", "versions": {},
            "command_line": [], "warnings": [],
        },
    },
}  # fmt: skip


def run(**changes: Any) -> dict[str, Any]:
    return {**RUN, "commands": {"fit": {**RUN["commands"]["fit"], **changes}}}


def test_a_run_as_it_is_written_is_let_through() -> None:
    assert check_result(RUN, Path("run.json")) == RUN
    assert check_result({"any": 1}, Path("not one of ours.json")) == {"any": 1}


@pytest.mark.parametrize(
    ("content", "words"),
    [
        ({**RUN, "version": 2}, "version: input should be 1"),
        ({**RUN, "last": "gap"}, "last: 'gap' is none of the commands"),
        ({k: v for k, v in RUN.items() if k != "last"}, "last: field required"),
        (run(exit_code=True), "commands.fit.exit_code"),
        (run(exit_code=-1), "commands.fit.exit_code"),
        (run(settings={"fit": {"bounds": [{"a": 1}]}}), "a table in a list of settings"),
        (run(settings={"fit": {"bounds": [[{"a": 1}]]}}), "a table in a list of settings"),
        (run(settings={"noise": 1}), "noise: a table of settings was expected"),
        (run(seconds={"fit": -1.0}), "commands.fit.seconds.fit"),
        ({**RUN, "written_sha256": {"a": "0" * 63}}, "written_sha256.a"),
    ],
)
def test_the_place_of_what_is_wrong_is_named(content: Any, words: str) -> None:
    with pytest.raises(CampaignError, match=words):
        check_result(content, Path("run.json"))


@pytest.mark.parametrize(
    ("kind", "good", "bad"),
    [
        (Num, [0.0, -1e100, 1e100, 3], [1e101, -1e101, float("nan"), float("inf"), "1", True]),
        (Share, [0.0, 1.0, 1.0 + 1e-12], [-1e-3, 1.001]),
        (FileName, ["a.svg"], ["", "../a", "a/b", ".hidden", "a\\b", "a\0b"]),
    ],
    ids=["Num", "Share", "FileName"],
)
def test_what_a_type_holds(kind: Any, good: list[Any], bad: list[Any]) -> None:
    adapter: TypeAdapter[Any] = TypeAdapter(kind)
    for value in good:
        adapter.validate_python(value)
    for value in bad:
        with pytest.raises(ValidationError):
            adapter.validate_python(value)


def test_lists_that_belong_together_have_one_length() -> None:
    adapter: TypeAdapter[Any] = TypeAdapter(Annotated[dict[str, Any], same_length("a", "b")])
    for good in ({"a": [1], "b": [2], "c": []}, {"a": [1], "b": None}, {"b": [1]}):
        assert adapter.validate_python(good) == good
    with pytest.raises(ValidationError, match="a 1, b 2"):
        adapter.validate_python({"a": [1], "b": [1, 2]})


@pytest.mark.parametrize(
    ("found", "archive"),
    [
        ({"fit": {"parameters": {"experiments": {"2": {}}}}}, []),
        ({"residuals": {"experiments": ["2"]}}, []),
        ({"delays": {"start": {"points": [{"experiment": "2"}]}, "end": None}}, []),
        ({"gap": {"where": [{"experiment": "2"}]}}, []),
        ({}, ["2"]),
    ],
    ids=["fit", "residuals", "delays", "gap", "archive"],
)
def test_results_of_other_experiments_are_refused(found: Any, archive: list[str]) -> None:
    def check(*names: str) -> None:
        campaign = {"experiments": [{"experiment": name} for name in names]}
        check_together(
            Path("results"), campaign, found, [SimpleNamespace(name=name) for name in archive]
        )

    check("1", "2")
    check("2,A", "2,B")  # two sensors of one record, which is named without them
    with pytest.raises(CampaignError, match="'2' of another result is none of them"):
        check("1", "3")
    with pytest.raises(CampaignError, match="'2' of another result is none of them"):
        check("12,A")
