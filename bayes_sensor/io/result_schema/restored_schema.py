"""What ``restored.json`` holds."""

from __future__ import annotations

from typing import Annotated

from pydantic import Field
from typing_extensions import TypedDict

from bayes_sensor.io.result_schema.schema_types import (
    Int,
    MaybeNum,
    NotNegative,
    Num,
    Positive,
    Share,
    Text,
    Texts,
    Unit,
)

Percentiles = TypedDict("Percentiles", {"q2.5": Num, "q50": Num, "q97.5": Num})


class RestoredNoise(TypedDict):
    phi: Percentiles
    phi_interval_s: Positive
    sigma: Percentiles
    sigma_at_highest: Percentiles


class InnovationTest(TypedDict):
    n: Int
    sd: NotNegative
    correlation: Num
    p_value: Share
    largest: Num
    largest_at_s: Num
    largest_p_value: Share


class RestoredMoment(TypedDict):
    time_s: Num
    value: Num
    lo68: Num
    hi68: Num
    lo95: Num
    hi95: Num


class RestoredBands(TypedDict):
    lowest: RestoredMoment
    highest: RestoredMoment
    least_known: RestoredMoment
    median_half_width68: NotNegative
    median_half_width95: NotNegative


class RestoredRecord(TypedDict):
    signal_unit: Unit
    resolution_s: MaybeNum
    lag_s: Percentiles
    lags_s: Annotated[list[Percentiles], Field(min_length=1)]
    lag_source: Text
    noise: RestoredNoise
    bands: RestoredBands
    innovations: InnovationTest
    n_samples: Int
    n_draws: Int
    remarks: Texts
    warnings: Texts
