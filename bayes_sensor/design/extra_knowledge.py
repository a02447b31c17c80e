"""What would make tau easy: predicted intervals under extra knowledge or another way to measure."""

from __future__ import annotations

from dataclasses import replace
from math import log10
from typing import TYPE_CHECKING, Any

import numpy as np

from bayes_sensor.campaign import Campaign
from bayes_sensor.design.planned_experiments import (
    PlannedSetting,
    Truth,
    planned,
    settings_of,
    truth_of,
)
from bayes_sensor.design.record_information import Known
from bayes_sensor.design.tau_interval import Prediction, known_beforehand, predict
from bayes_sensor.likelihood.held_values import refuse_held
from bayes_sensor.likelihood.priors import Prior
from bayes_sensor.likelihood.problem import Problem, as_problem
from bayes_sensor.rig.layout import Theta

if TYPE_CHECKING:
    import pandas as pd


def what_if(campaign: Campaign | Problem, theta: Theta, prior: Prior | None = None) -> pd.DataFrame:
    """Predicted interval of tau for extra knowledge or another way to measure.

    Columns: ``change`` (words), ``kind``, ``value`` (in ``unit``), ``sd_tau_s`` (bound under the
    noise law), ``lo68_s``, ``hi68_s``, ``lo95_s``, ``hi95_s``, ``half_width95_s``, ``gain`` (the
    present half width over this one).  ``prior`` on tau: the campaign's own by default.

    A higher sampling rate keeps the noise in continuous time: phi per sample becomes
    phi^(1/factor); a negative phi has no process in continuous time and is set to zero there. A
    pulse train is approximated by as many short experiments as there are pulses (each with its own
    y0, beta and switch times, started from rest).  That is pessimistic, because a real train shares
    them. A design is enough.

    tau is the sensor's lag, be it the shorter or the longer one (:meth:`Problem.by_name`).
    """
    import pandas as pd

    problem = as_problem(campaign)
    refuse_held(problem, "what_if")
    vector = problem.by_name(theta)
    settings, truth = settings_of(problem, vector), truth_of(problem, vector)
    prior = prior or problem.prior_of_tau(vector)
    beforehand = known_beforehand(problem)
    rig, flows = truth.rig, [s.experiment.total_flow for s in settings]
    lags = np.array([rig.lags(np.array(truth.shared), flow) for flow in flows])
    slowest = max(_decade(float(lags.max())), 1.0)  # a millisecond is what a trigger can do
    times = "times the valve" if "tau_v_s" in rig.names else "times the switches"
    volumes = [name for name in rig.names if name.startswith("V_")]
    rows: list[dict[str, Any]] = []
    known: Known = {}

    def add(change: str, kind: str, value: float, unit: str, prediction: Prediction) -> None:
        before = rows[0]["half_width95_s"] if rows else prediction.half_width95
        rows.append(
            {
                "change": change,
                "kind": kind,
                "value": value,
                "unit": unit,
                **prediction.to_json(),
                "gain": before / prediction.half_width95,
            }
        )

    def told(trigger: float | None = None, volume: str = "", sd: float = 0.0) -> Prediction:
        more = beforehand
        if volume:
            more = (*beforehand, (1 + rig.names.index(volume), sd))
        return predict(settings, truth, prior, trigger, more, known=known)

    add("as it is", "none", 0.0, "", told())
    for share in (0.02, 0.01, 0.005, 0.002, 0.001):
        at = share * slowest
        ms = 1e3 * at
        add(f"a trigger that {times} to +-{ms:g} ms", "trigger", ms, "ms", told(at))
    for name in volumes:
        size = max(_decade(truth.shared[rig.names.index(name)]), 100.0)
        symbol = name.removesuffix("_mL")
        for share in (0.02, 0.01, 0.005, 0.001):
            mL = share * size
            found = told(volume=name, sd=mL)
            add(f"{symbol} measured to +-{mL:g} mL", "volume", mL, "mL", found)
        both = told(0.002 * slowest, name, 0.005 * size)
        ms = 2.0 * slowest
        words = f"a trigger to +-{ms:g} ms and {symbol} to +-{0.005 * size:g} mL"
        add(words, "trigger and volume", ms, "ms", both)
    for name in rig.names[1:]:
        if name in volumes:
            continue
        stage = next(stage.name for stage in rig.stages if stage.parameter == name)
        for factor in (2.0, 4.0, 10.0):
            fast = truth.with_value(name, truth.shared[rig.names.index(name)] / factor)
            found = predict(settings, fast, prior, beforehand=beforehand)
            add(f"a {stage} {factor:g} times faster", stage, factor, "x", found)
    for factor in (2.0, 4.0) if rig.needs_flow else ():
        stronger = [_with_flow(setting, factor) for setting in settings]
        found = predict(stronger, truth, prior, beforehand=beforehand)
        add(f"{factor:g} times the flow", "flow", factor, "x", found)
    for factor in (2.0, 4.0, 10.0):
        found = predict(settings, truth, prior, beforehand=beforehand, repeats=factor, known=known)
        add(f"{factor:g} times the experiments", "repeats", factor, "x", found)
    for factor in (2, 10):
        denser = [_with_rate(setting, factor) for setting in settings]
        found = predict(
            denser, replace(truth, phi=max(truth.phi, 0.0)), prior, beforehand=beforehand
        )
        add(f"{factor} times the sampling rate", "rate", float(factor), "x", found)
    for pulses in (3, 6):
        short = [as_pulse(setting, pulses, truth) for setting in settings]
        if all(setting is not None for setting in short):
            each = [setting for setting in short if setting is not None]
            found = predict(each, truth, prior, beforehand=beforehand, repeats=float(pulses))
            add(f"{pulses} pulses in each record", "pulses", float(pulses), "", found)
    return pd.DataFrame(rows)


def _decade(value: float) -> float:
    """The power of ten nearest to a positive value, by ratio.

    >>> _decade(0.86), _decade(58.0)
    (1.0, 100.0)
    """
    return float(10.0 ** round(log10(value)))


def _with_flow(setting: PlannedSetting, factor: float) -> PlannedSetting:
    return replace(setting, experiment=setting.experiment.with_flow(factor))


def _with_rate(setting: PlannedSetting, factor: int) -> PlannedSetting:
    e = setting.experiment
    interval = e.interval / factor
    t = e.t[0] + interval * np.arange(len(e.t) * factor)
    mask = np.repeat(e.used, factor)
    return replace(setting, experiment=replace(e, t=t, interval=interval, mask=mask, drive=None))


def as_pulse(setting: PlannedSetting, pulses: int, truth: Truth) -> PlannedSetting | None:
    """One of ``pulses`` equal parts of the record; None if the response would not settle, or the
    record is no single pulse."""
    e = setting.experiment
    if e.commands is not None:
        return None  # a programme of its own
    n = len(e.t) // pulses
    duration = n * e.interval
    if duration < truth.shortest(e.total_flow):
        return None
    return planned(
        e.name, e.total_flow, e.concentration, duration, e.interval, setting.y0, setting.beta,
        setting.weight,
    )  # fmt: skip
