"""gap.json, and coating.json with the response times."""

from __future__ import annotations

from typing import Annotated, Any, Literal, NotRequired

from pydantic import AfterValidator, Field, StrictBool
from typing_extensions import TypedDict

from bayes_sensor.io.result_schema.schema_types import (
    Int,
    MaybeNum,
    Name,
    NotNegative,
    Num,
    Numbers,
    Phase,
    Positive,
    SensorIs,
    Share,
    Text,
    Texts,
    fail,
    same_length,
)

Ends = tuple[MaybeNum, MaybeNum]
Strength = dict[Name, Num | Text | dict[Name, MaybeNum] | None]


class Budget(TypedDict):
    calibrated_rms_V: MaybeNum
    noise_floor_rms_V: MaybeNum
    excess_rms_V: MaybeNum
    excess_d: Num
    p_value: MaybeNum
    p_value_of_size: NotRequired[MaybeNum]
    p_value_of_form: NotRequired[MaybeNum]
    nominal_rms_V: NotRequired[MaybeNum]


class Where(TypedDict):
    experiment: Name
    phase: Phase
    t_start_s: MaybeNum
    t_end_s: MaybeNum
    excess_rms_V: MaybeNum
    share: MaybeNum
    p_value: MaybeNum


class Which(TypedDict):
    effect: Name
    family: Text | None
    probability: Share
    d: MaybeNum
    strength: NotRequired[Strength | None]
    tau_s: NotRequired[MaybeNum]
    lag_fast_s: NotRequired[MaybeNum]
    fraction_closed: MaybeNum
    confusable_with: NotRequired[list[Name] | None]


class Verdict(TypedDict):
    kind: Literal["none", "effect", "family", "unlisted"]
    effects: list[Name]
    family: Text | None
    probability: Share
    sentence: Text


class Shrink(TypedDict):
    before_excess_rms_V: MaybeNum
    after_excess_rms_V: MaybeNum
    fraction_closed: MaybeNum
    fraction_closed_lo: NotRequired[MaybeNum]
    fraction_closed_hi: NotRequired[MaybeNum]
    held_out_fraction_closed: NotRequired[MaybeNum]
    held_out_fraction_closed_lo: NotRequired[MaybeNum]
    held_out_fraction_closed_hi: NotRequired[MaybeNum]
    tau_before_s: NotRequired[MaybeNum]
    tau_after_s: NotRequired[MaybeNum]
    tau_after_lo_s: NotRequired[MaybeNum]
    tau_after_hi_s: NotRequired[MaybeNum]
    lag_fast_before_s: NotRequired[MaybeNum]
    lag_fast_after_s: NotRequired[MaybeNum]
    lag_fast_after_lo_s: NotRequired[MaybeNum]
    lag_fast_after_hi_s: NotRequired[MaybeNum]
    withheld: StrictBool
    explanation: NotRequired[Text | None]
    rival: NotRequired[Text | None]
    rival_fraction_closed: NotRequired[MaybeNum]
    of_mean: NotRequired[StrictBool]


def _whole_closure(found: Any) -> Any:
    """What belongs together is there together."""
    for key in ("fraction_closed", "held_out_fraction_closed"):
        ends = [found.get(f"{key}_{end}") is None for end in ("lo", "hi")]
        if ends[0] != ends[1]:
            raise fail(f"{key}: both ends of its interval were expected, or none")
    closes = found["fraction_closed"] is not None and not found["withheld"]
    if closes and None in (found["before_excess_rms_V"], found["after_excess_rms_V"]):
        raise fail("the excess before and after were expected beside fraction_closed")
    return found


class HiddenEffect(TypedDict):
    effect: Name
    strength: NotRequired[Strength | None]
    d: MaybeNum
    contradicted: NotRequired[StrictBool]
    tau_shift_s: NotRequired[MaybeNum]
    tau_with_it_s: NotRequired[MaybeNum]
    tau_low_s: NotRequired[MaybeNum]
    tau_high_s: NotRequired[MaybeNum]
    tau_free_low_s: NotRequired[MaybeNum]
    tau_free_high_s: NotRequired[MaybeNum]
    lag_fast_shift_s: NotRequired[MaybeNum]
    lag_fast_with_it_s: NotRequired[MaybeNum]
    lag_fast_low_s: NotRequired[MaybeNum]
    lag_fast_high_s: NotRequired[MaybeNum]
    lag_fast_free_low_s: NotRequired[MaybeNum]
    lag_fast_free_high_s: NotRequired[MaybeNum]


class Hidden(TypedDict):
    lag: Text
    effects: list[HiddenEffect]
    tau_envelope_s: NotRequired[Ends | None]
    lag_fast_envelope_s: NotRequired[Ends | None]


class Round(TypedDict):
    added: list[Name]
    probability: Share
    d_left: MaybeNum
    p_left: MaybeNum
    unlisted_left: MaybeNum | StrictBool


class Separation(TypedDict):
    effect: Name
    rival: Name
    isolability: MaybeNum
    addition: Text | None
    isolability_with_it: MaybeNum


class FullRate(TypedDict):
    name: Name
    log_bayes_factor: MaybeNum
    probability: MaybeNum
    strength: NotRequired[Strength | None]
    experiment: NotRequired[Text | None]
    d: MaybeNum


class Residual(TypedDict):
    experiment: Name
    since_switch_s: Numbers
    whitened: Annotated[Numbers, Field(min_length=1)]
    phase: list[Text | Int]


WithDiscrepancy = TypedDict("WithDiscrepancy", {"q2.5": Num, "q50": Num, "q97.5": Num})


class _Gap(TypedDict):
    budget: Budget
    where: Annotated[list[Where], Field(min_length=1)]
    where_shared_by: NotRequired[Text]
    where_left_out_d: NotRequired[dict[Name, MaybeNum] | None]
    which: Annotated[list[Which], Field(min_length=1)]
    strength_units: NotRequired[dict[Name, Text]]
    verdict: Verdict
    families: NotRequired[dict[Name, Share] | None]
    shrink: Annotated[Shrink, AfterValidator(_whole_closure)]
    tau_with_discrepancy_s: NotRequired[WithDiscrepancy | None]
    lag_fast_with_discrepancy_s: NotRequired[WithDiscrepancy | None]
    hidden: Hidden
    rounds: NotRequired[list[Round] | None]
    separate: NotRequired[list[Separation] | None]
    full_rate: NotRequired[list[FullRate] | None]
    residuals: NotRequired[
        list[Annotated[Residual, same_length("since_switch_s", "whitened", "phase")]] | None
    ]
    notes: NotRequired[Texts | None]


def _of_one_lag(gap: Any) -> Any:
    """Rows speak of tau, or all of the shorter lag."""
    of = "lag_fast" if "lag_fast_envelope_s" in gap["hidden"] else "tau"
    if any(f"{of}_s" not in row for row in gap["which"]):
        raise fail(f"which: {of}_s was expected in every row")
    for row in gap["hidden"]["effects"]:
        if f"{of}_shift_s" not in row:
            raise fail(f"hidden: {of}_shift_s was expected of every effect")
        for low, high in (("low", "high"), ("free_low", "free_high")):
            wanted = row.get(f"{of}_with_it_s") is not None if low == "low" else False
            ends = [row.get(f"{of}_{end}_s") is None for end in (low, high)]
            if ends[0] != ends[1] or (wanted and ends[0]):
                raise fail(f"hidden: both ends of {of}_{low}_s to {of}_{high}_s were expected")
    return gap


Gap = Annotated[_Gap, AfterValidator(_of_one_lag)]


# --------------------------------------------------------------------------- response times


class ResponseTimes(TypedDict):
    system: Annotated[str, Field(strict=True, pattern="^(sensor|chain)")]
    total_flow_L_per_min: MaybeNum
    sensor_is: NotRequired[SensorIs]
    probability: NotRequired[Share]
    t10_s: NotNegative
    t10_lo_s: NotNegative
    t10_hi_s: NotNegative
    t63_s: NotNegative
    t63_lo_s: NotNegative
    t63_hi_s: NotNegative
    t90_s: NotNegative
    t90_lo_s: NotNegative
    t90_hi_s: NotNegative
    rise_s: NotNegative
    rise_lo_s: NotNegative
    rise_hi_s: NotNegative


class Limits(TypedDict):
    median: MaybeNum
    lo95: MaybeNum
    hi95: MaybeNum


class Known(TypedDict):
    median: Num
    lo95: Num
    hi95: Num


class Diffusivity(TypedDict):
    d_zif8_m2_per_s: Limits
    d_literature_m2_per_s: Positive
    tau_literature_ms: Known
    ratio: Limits
    tail_probability: Num
    tail_resolution: Num
    tolerances: dict[Name, MaybeNum]


def _with_a_chain(rows: Any) -> Any:
    if not any(row["system"].startswith("chain") for row in rows):
        raise fail("a row of the chain was expected")
    if any(("sensor_is" in row) != ("probability" in row) for row in rows):
        raise fail("sensor_is and its probability were expected together")
    return rows


class Coating(TypedDict):
    response_times: Annotated[list[ResponseTimes], AfterValidator(_with_a_chain)]
    d_zif8: NotRequired[Diffusivity | None]
    d_zif8_left_out: NotRequired[Text]
