"""What a blind check saves: plan, hashes, verdicts, card and cases.

A truth is checked where it is completed, in the room blind_check.
"""

from __future__ import annotations

from typing import Annotated, Any, Literal, NotRequired

from pydantic import AfterValidator, Field, StrictBool
from typing_extensions import TypedDict

from bayes_sensor.io.result_schema.schema_types import (
    FileName,
    Hash,
    Int,
    MaybeNum,
    Name,
    NotNegative,
    Num,
    Phase,
    Positive,
    Seed,
    Share,
    Text,
    fail,
)


class PlannedCase(TypedDict):
    case: FileName
    seed: Seed
    without: list[Name]


def _each_once(plan: Any) -> Any:
    names = [case["case"].casefold() for case in plan["cases"]]
    if len({*names}) < len(names):
        raise fail("cases: each name once was expected")
    return plan


class _Plan(TypedDict):
    cases: list[PlannedCase]


Plan = Annotated[_Plan, AfterValidator(_each_once)]
Hashes = dict[FileName, Hash]


class DrawnTruth(TypedDict):
    name: FileName
    kind: Name
    listed_as: list[list[Name]]
    diagnosis_seed: Seed
    recipe: dict[Name, Any]


class MadeFrom(TypedDict):
    of: Literal["files", "recipe"]
    sha256: Hash


MadeFromEach = dict[FileName, MadeFrom]


class _Where(TypedDict):
    experiment: Name
    phase: Phase
    share: MaybeNum
    p_value: MaybeNum


class _Which(TypedDict):
    effect: Name
    family: Text | None
    probability: Share | None
    d: NotRequired[MaybeNum]
    tau_s: NotRequired[MaybeNum]
    fraction_closed: NotRequired[MaybeNum]
    bic: NotRequired[MaybeNum]


class _Said(TypedDict):
    kind: Literal["none", "effect", "family", "unlisted", "failed"]
    effects: list[Name]
    family: Text | None
    probability: Share | None


class _Budget(TypedDict):
    excess_d: NotRequired[MaybeNum]
    p_value: NotRequired[MaybeNum]


def _known_probability(said: Any) -> Any:
    if (said["probability"] is None) != (said["kind"] == "failed"):
        raise fail("a probability was expected, unless the diagnosis failed")
    return said


def _known_shrink(shrink: Any) -> Any:
    for key, value in shrink.items():
        if key == "explanation":
            good = value is None or isinstance(value, str)
        elif key.startswith("tau_"):
            is_number = isinstance(value, int | float) and not isinstance(value, bool)
            good = value is None or (is_number and 0.0 < value < 1e100)
        elif "fraction_closed" in key:
            good = value is None or (isinstance(value, int | float) and abs(value) < 1e100)
        else:
            good = not isinstance(value, list | dict)
        if not good:
            raise fail(f"{key}: another value was expected")
    return shrink


def _with_none(which: Any) -> Any:
    if all(row["effect"] != "none" for row in which):
        raise fail("a row of none was expected")
    return which


class Verdict(TypedDict):
    case: FileName
    where: list[_Where]
    which: Annotated[list[_Which], AfterValidator(_with_none)]
    verdict: Annotated[_Said, AfterValidator(_known_probability)]
    shrink: Annotated[dict[Name, Any], AfterValidator(_known_shrink)]
    budget: _Budget
    tau_envelope_s: tuple[Positive | None, Positive | None]


class Proportion(TypedDict):
    k: Int
    n: Int
    rate: Share | None
    lo95: Share
    hi95: Share


class Goal(TypedDict):
    goal: Text
    wanted: Text | None
    reached: MaybeNum
    lo95: MaybeNum
    hi95: MaybeNum
    met: StrictBool | None


class Alarms(TypedDict):
    named: Proportion
    bic_named: Proportion
    alarmed: Proportion


class Nulls(TypedDict):
    all: Alarms
    ar1: Alarms
    not_ar1: Alarms


class Wrong(TypedDict):
    listed: Proportion
    pair: Proportion
    unlisted: Proportion
    withheld: Proportion
    bic_listed: Proportion
    bic_unlisted: Proportion


class Accuracy(TypedDict):
    d: Positive
    family: Proportion
    family_or_abstained: Proportion
    family_bic: Proportion


class Flagged(TypedDict):
    d: Positive
    flagged: Proportion
    flagged_or_unnamed: Proportion
    within_reach: Proportion


class Unlisted(TypedDict):
    flagged: Annotated[list[Flagged], Field(min_length=2)]


class Bin(TypedDict):
    stated: Share
    right: Proportion


class Reliability(TypedDict):
    bins: list[Bin]
    ece: Num | None
    band95: Num | None


def _with_a_band(found: Any) -> Any:
    if (found["ece"] is None) != (found["band95"] is None):
        raise fail("ece and band95 were expected together")
    return found


class Calibration(TypedDict):
    verdict: Annotated[Reliability, AfterValidator(_with_a_band)]


class Tau(TypedDict):
    before: NotNegative | None
    after: NotNegative | None


class Card(TypedDict):
    n: Int
    kinds: dict[Name, Int]
    failed: Proportion
    nulls: Nulls
    confident_wrong: Wrong
    tau: Tau
    accuracy: Annotated[list[Accuracy], Field(min_length=2)]
    unlisted: Unlisted
    calibration: Calibration
    goals: list[Goal]


class CaseRow(TypedDict):
    """A row of cases.csv: texts."""

    case: Text
    kind: Text
    causes: Text
    law: Text
    d: Text
    verdict: Text
    said: Text
    p_said: Text
    confident_wrong: Text
    verdict_right: Text


def _numbers(row: Any) -> Any:
    for key in ("d", "p_said"):
        try:
            good = not row[key] or abs(float(row[key])) < 1e100
        except ValueError:
            good = False
        if not good:
            raise fail(f"{key}: a number was expected, but '{row[key][:40]}' is none")
    return row


Cases = list[Annotated[CaseRow, AfterValidator(_numbers)]]
