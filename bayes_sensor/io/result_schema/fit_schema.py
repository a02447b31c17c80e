"""What fit, residuals and posterior save of a campaign."""

from __future__ import annotations

from itertools import pairwise
from typing import Annotated, Any, Literal, NotRequired

from pydantic import AfterValidator, Field, StrictBool, with_config
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
    Seed,
    SensorIs,
    Share,
    Text,
    Texts,
    Unit,
    fail,
    same_length,
)

# --------------------------------------------------------------------------- campaign and fit


class ExperimentRow(TypedDict):
    experiment: Name
    used: Int
    interval_s: Positive
    duration_s: Positive
    total_flow_L_min: MaybeNum
    concentration_percent: MaybeNum
    commanded_on_s: MaybeNum
    commanded_off_s: MaybeNum
    baseline_V: MaybeNum
    step_V: MaybeNum
    noise_V: MaybeNum
    switches: NotRequired[Int]
    file: Text
    sha256: Text


class Known(TypedDict):
    mean: Num
    sd: Num


class CampaignRecord(TypedDict):
    title: Text
    source: Text
    sha256: Text
    signal_unit: Unit
    reference_interval_s: Positive
    same_flow: StrictBool
    stages: Annotated[list[Name], Field(min_length=1)]
    sensor_is: NotRequired[Literal["faster", "slower", "unknown"]]
    ties: NotRequired[dict[Text, Text]]
    coating: NotRequired[Text]
    n_samples: Int
    side_information: dict[Name, Known]
    remarks: Texts
    experiments: Annotated[list[ExperimentRow], Field(min_length=1)]


Values = dict[Name, MaybeNum]


def _of_experiments(parameters: Any) -> Any:
    """Flat values, ``experiments`` with those of each, and at most a ``signal_unit`` in words."""
    if any(isinstance(v, str) and name != "signal_unit" for name, v in parameters.items()):
        raise fail("numbers were expected, and text for signal_unit only")
    experiments = parameters.get("experiments")
    good = isinstance(experiments, dict) and all(isinstance(v, dict) for v in experiments.values())
    if not good or any(
        isinstance(value, bool) or not isinstance(value, int | float | None)
        for own in experiments.values()
        for value in own.values()
    ):
        raise fail("experiments with the numbers of each were expected")
    return parameters


Parameters = Annotated[
    dict[Name, MaybeNum | Text | dict[Name, Values]], AfterValidator(_of_experiments)
]


class Swarms(TypedDict):
    agree: NotRequired[StrictBool]
    swarms: NotRequired[list[Any]]


class Euler(TypedDict):
    difference: dict[Name, Num]


class LagCount(TypedDict):
    log_evidence: dict[Text, Any] | list[Any]
    sentence: Text


class Fit(TypedDict):
    order: Text
    noise_V: MaybeNum
    misfit: MaybeNum
    rms_V: NotNegative
    n_samples: Int
    parameters: Parameters
    estimates: NotRequired[Values]
    at_bound: list[Name]
    converged: StrictBool
    caveats: NotRequired[Texts]
    warnings: Texts
    status: Text
    rms_per_experiment_V: NotRequired[dict[Name, Num]]
    n_lags: NotRequired[LagCount | None]
    swarms: Swarms
    euler: NotRequired[Euler | None]


# --------------------------------------------------------------------------- residuals


class _Acf(TypedDict):
    lag_s: Annotated[Numbers, Field(min_length=2)]
    value: Numbers
    ar1: Numbers


class _Test(TypedDict):
    statistic: MaybeNumbers
    p_value: MaybeNumbers


class _LjungBox(TypedDict):
    lags: list[Int]
    before: Annotated[_Test, same_length("statistic", "p_value")]
    after: Annotated[_Test, same_length("statistic", "p_value")]


def _as_many_tests(found: Any) -> Any:
    if any(len(found[key]["statistic"]) != len(found["lags"]) for key in ("before", "after")):
        raise fail("as many tests as lags were expected")
    return found


class _BreuschPagan(TypedDict):
    p_value: NotRequired[MaybeNum]
    n: NotRequired[Int]


class _Spread(TypedDict):
    concentration_low: Annotated[Numbers, Field(min_length=1)]
    concentration_high: Numbers
    sd_V: MaybeNumbers
    law_sd_V: MaybeNumbers
    breusch_pagan: _BreuschPagan


class _Histogram(TypedDict):
    edges_V: Annotated[Numbers, Field(min_length=2)]
    count: Annotated[list[NotNegative], Field(min_length=1)]
    bin_V: Positive
    note: Text


def _one_edge_more(found: Any) -> Any:
    edges = found["edges_V"]
    rising = all(a < b for a, b in pairwise(edges))
    if len(edges) != len(found["count"]) + 1 or not rising:
        raise fail("increasing edges, one more than counts, were expected")
    return found


class _Check(TypedDict):
    adequate: StrictBool
    p_value: NotRequired[MaybeNum]
    factor: NotRequired[MaybeNum]
    low: NotRequired[MaybeNum]
    high: NotRequired[MaybeNum]


class _DurbinWatson(TypedDict):
    before: Num
    after: Num


class _ResidualsOf(TypedDict):
    n: Annotated[int, Field(strict=True, ge=1, le=10**15)]
    rms_V: NotNegative
    lag_one: MaybeNum
    baseline_sd_V: MaybeNum
    plateau_sd_V: MaybeNum


class _Ar1(TypedDict):
    phi: Num
    phi_interval_s: NotRequired[Positive]


class ResidualRecord(TypedDict):
    adequate: StrictBool
    verdict: Text
    recommendation: NotRequired[Text | None]
    acf: Annotated[_Acf, same_length("lag_s", "value", "ar1")]
    ljung_box: Annotated[_LjungBox, AfterValidator(_as_many_tests)]
    ar1: _Ar1
    variance_vs_concentration: Annotated[
        _Spread, same_length("concentration_low", "concentration_high", "sd_V", "law_sd_V")
    ]
    durbin_watson: _DurbinWatson
    white_band: Num
    histogram: Annotated[_Histogram, AfterValidator(_one_edge_more)]
    experiments: Annotated[dict[Name, _ResidualsOf], Field(min_length=1)]
    checks: NotRequired[dict[Name, _Check] | None]
    signal_unit: NotRequired[Unit]


# --------------------------------------------------------------------------- posterior


Percentiles = TypedDict("Percentiles", {"q2.5": Num, "q50": Num, "q97.5": Num})
LagPercentiles = TypedDict("LagPercentiles", {"q2.5": Num, "q50": Num, "q95": Num, "q97.5": Num})
Row = TypedDict(
    "Row",
    {
        "mean": Num, "sd": NotNegative, "q2.5": Num, "q16": Num, "q50": Num, "q84": Num,
        "q97.5": Num, "ess_bulk": MaybeNum, "ess_tail": MaybeNum, "r_hat": MaybeNum,
    },
)  # fmt: skip


class Assignment(TypedDict):
    sensor_is: SensorIs
    lag: Int
    probability: Share


class ChainTimes(TypedDict):
    t63_s: Percentiles
    t90_s: Percentiles


class UnderPrior(TypedDict):
    prior: Text
    sensor_is: NotRequired[SensorIs]
    lo95_s: Num
    hi95_s: Num
    hdi_lo95_s: MaybeNum
    hdi_hi95_s: MaybeNum
    upper95_s: Num
    upper99_s: Num
    n_effective: MaybeNum


class PosteriorRecord(TypedDict):
    parameters: dict[Name, Row | None]
    order: NotRequired[Literal["given", "decided", "undecided"]]
    assignments: list[Assignment]
    lags_s: Annotated[list[LagPercentiles], Field(min_length=1)]
    chain: NotRequired[dict[Name, ChainTimes]]
    hidden_by_sampling_s: NotRequired[Positive | None]
    no_upper_limit: NotRequired[dict[Name, Positive]]
    decided_by_prior: NotRequired[dict[Name, Share]]
    n_draws: Int
    converged: StrictBool
    status: Text
    convergence: NotRequired[Text]
    doubts: NotRequired[Texts]
    reasons: NotRequired[Texts]
    caveats: NotRequired[Texts]
    warnings: Texts
    priors: NotRequired[dict[Name, Text]]
    tau_under_priors: NotRequired[list[UnderPrior]]
    with_effects: NotRequired[list[Name]]
    with_discrepancy: NotRequired[StrictBool]
    seed: Seed


class _Compared(TypedDict):
    x: Annotated[Numbers, Field(min_length=1)]
    observed: Numbers
    low: Numbers
    middle: Numbers
    high: Numbers
    p_value: Num


class _Squares(TypedDict):
    x: Annotated[Numbers, Field(min_length=1)]
    observed: list[NotNegative]
    low: list[NotNegative]
    middle: list[NotNegative]
    high: list[NotNegative]
    p_value: Num


class _Pit(TypedDict):
    counts: Annotated[list[Int], Field(min_length=1)]
    p_uniform: Num


_CURVES = same_length("x", "observed", "low", "middle", "high")


class Predictive(TypedDict):
    status: Text
    failed: list[Name]
    p_values: dict[Name, Num]
    n_draws: Int
    autocorrelation: Annotated[_Compared, _CURVES]
    variance: Annotated[_Squares, _CURVES]
    spectrum: Annotated[_Compared, _CURVES]
    pit: _Pit


# ----------------------------------------------------------------- facts of the archives


@with_config(extra="forbid")
class TraceFacts(TypedDict):
    name: Name
    total_flow: MaybeNum
    concentration: MaybeNum
    t0: Num
    tf: MaybeNum
    commanded_on: MaybeNum
    commanded_off: MaybeNum
    rms: NotNegative
    signal_unit: NotRequired[Unit]


Traces = Annotated[list[TraceFacts], Field(min_length=1)]


@with_config(extra="forbid")
class SampleFacts(TypedDict):
    name: Name
    start: Num
    interval: Positive
    offset: Num
    step: Positive


SampledRecords = Annotated[list[SampleFacts], Field(min_length=1)]
