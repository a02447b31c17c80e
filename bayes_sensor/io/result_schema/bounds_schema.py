"""bounds.json and delays.json."""

from __future__ import annotations

from typing import Annotated, Any, NotRequired

from pydantic import AfterValidator, Field, StrictBool
from typing_extensions import TypedDict

from bayes_sensor.io.result_schema.schema_types import (
    Int,
    MaybeNum,
    MaybeNumbers,
    Name,
    NotNegative,
    Num,
    Numbers,
    Positive,
    Text,
    Texts,
    fail,
    same_length,
)


class BoundRow(TypedDict):
    estimate: MaybeNum
    sd: MaybeNum
    lo68: MaybeNum
    hi68: MaybeNum
    lo95: MaybeNum
    hi95: MaybeNum
    lo997: MaybeNum
    hi997: MaybeNum


class About(TypedDict):
    label: Text
    full_label: NotRequired[Text]
    noise: NotRequired[Text]
    needs_posterior: NotRequired[StrictBool]
    published_recipe: NotRequired[StrictBool]
    against_others: NotRequired[Text]


class Method(TypedDict):
    assumes: Text
    reference: NotRequired[Text]
    status: NotRequired[Text]
    about: About
    parameters: dict[Name, BoundRow | None]


class Roles(TypedDict):
    white: Name
    coloured: Name
    published: Name
    to_quote: list[Name]


class Collinearity(TypedDict):
    switches: Num


class ByTau(TypedDict):
    tau_s: MaybeNumbers
    sd_tau_s: MaybeNumbers
    sd_square_s2: MaybeNumbers


class Profile(TypedDict):
    tau_s: MaybeNumbers
    drop: MaybeNumbers
    gaussian: MaybeNumbers
    square: MaybeNumbers


class Hardness(TypedDict):
    tau_s: Num
    weakest: dict[Name, Num]
    correlation_with_tau: dict[Name, MaybeNum]
    collinearity: Collinearity
    sd_tau_if_known_s: dict[Name, NotNegative | None]
    by_tau: Annotated[ByTau, same_length("tau_s", "sd_tau_s", "sd_square_s2")]
    profile: Annotated[Profile, same_length("tau_s", "drop", "gaussian", "square")]
    sentences: Texts
    status: NotRequired[Text]


class Help(TypedDict):
    change: Text
    gain: NotRequired[MaybeNum]
    lo68_s: MaybeNum
    hi68_s: MaybeNum
    lo95_s: MaybeNum
    hi95_s: MaybeNum
    half_width95_s: MaybeNum


class StepRow(TypedDict):
    method: Text
    difference: Text
    step: Positive
    identified: NotRequired[StrictBool]


def _of_numbers(rows: Any) -> Any:
    for row in rows:
        for name, value in row.items():
            known = name in StepRow.__annotations__ or value is None
            if not (known or (isinstance(value, int | float) and 0.0 <= value < 1e100)):
                raise fail(f"{name}: a standard deviation was expected")
    return rows


def _of_roles(bounds: Any) -> Any:
    """What is compared at one point has that point, and standard deviations of each role."""
    naive, roles = bounds.get("naive"), bounds["roles"]
    if naive is not None and not isinstance(naive.get("at"), dict):
        raise fail("naive: the point at which bounds are compared was expected")
    for role in ("white", "coloured", "published"):
        if naive is not None and not isinstance(naive.get(roles[role]), dict | None):
            raise fail(f"naive: standard deviations by the bound {roles[role][:60]} were expected")
    if naive is not None and None in naive["at"].values():
        raise fail("naive: numbers were expected at the point of comparison")
    return bounds


class _Bounds(TypedDict):
    methods: dict[Name, Method]
    roles: Roles
    naive: NotRequired[dict[Name, dict[Name, MaybeNum] | Num | None] | None]
    step_study: NotRequired[Annotated[list[StepRow], AfterValidator(_of_numbers)] | None]
    what_makes_tau_hard: NotRequired[Hardness | None]
    what_would_help: NotRequired[Annotated[list[Help], Field(min_length=1)] | None]
    not_explained: NotRequired[Text | None]


Bounds = Annotated[_Bounds, AfterValidator(_of_roles)]


class Point(TypedDict):
    experiment: Name
    inverse_flow_s_per_L: Num
    delay_s: Num
    used: StrictBool
    studentised_residual: MaybeNum
    bonferroni_p: MaybeNum


class Band(TypedDict):
    inverse_flow_s_per_L: Numbers
    fit_s: Numbers
    lo95_s: Numbers
    hi95_s: Numbers


class Weighted(TypedDict):
    slope_L: NotRequired[MaybeNum]


class Line(TypedDict):
    intercept_s: MaybeNum
    slope_L: MaybeNum
    r2: MaybeNum
    p_value: MaybeNum
    ci95: dict[Name, tuple[Num, Num]] | None
    outliers: list[Name]
    n: Int
    points: list[Point]
    band: Annotated[Band, same_length("inverse_flow_s_per_L", "fit_s", "lo95_s", "hi95_s")] | None
    weighted: NotRequired[Weighted | None]
    status: Text


def _with_its_numbers(line: Any) -> Any:
    if line["slope_L"] is not None:
        if None in (line["intercept_s"], line["r2"], line["ci95"]):
            raise fail("intercept_s, r2 and ci95 were expected beside the slope")
        if "slope_L" not in line["ci95"]:
            raise fail("ci95: the interval of slope_L was expected")
    return line


class Delays(TypedDict):
    start: Annotated[Line, AfterValidator(_with_its_numbers)]
    end: Annotated[Line, AfterValidator(_with_its_numbers)] | None
