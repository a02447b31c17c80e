"""Planned experiments, and the parameters that a prediction assumes."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from bayes_sensor.campaign import STAGES, Campaign, CampaignError, Experiment, FloatArray
from bayes_sensor.io.readers.recording import MAX_SAMPLES
from bayes_sensor.likelihood.noise import Noise
from bayes_sensor.likelihood.problem import Problem
from bayes_sensor.rig.rig import Rig
from bayes_sensor.rig.ties import refuse_ties

BEGIN, END = 0.2, 0.6
"""when a proposed experiment's step starts and ends, as fractions of its duration"""
SETTLED = 6.0
"""times its slowest lag, after which a response is over"""


@dataclass(frozen=True)
class PlannedSetting:
    """One planned experiment: its design and its own parameters."""

    experiment: Experiment
    y0: float
    beta: float
    switches: tuple[float, ...]
    """its switch times or delays, as in theta (t0 and tf of a pulse)"""
    weight: float
    """of sigma1^2 x3 in the variance (concentration over the campaign's highest)"""


@dataclass(frozen=True)
class Truth:
    """Shared parameters and noise for which a prediction is made; s, mL, V."""

    shared: tuple[float, ...]
    """in the order of the rig's names: tau first"""
    phi: float
    sigma0: float
    sigma1: float
    noise: Noise
    interval: float
    """s, that phi refers to"""
    stages: tuple[str, ...] = STAGES
    """the rig's"""

    @property
    def tau(self) -> float:
        """s, the sensor's lag."""
        return self.shared[0]

    @cached_property
    def rig(self) -> Rig:
        """What the stages are."""
        return Rig.parse(self.stages)

    def with_value(self, name: str, value: float) -> Truth:
        """With another value of a shared parameter."""
        shared = list(self.shared)
        shared[self.rig.names.index(name)] = value
        return replace(self, shared=tuple(shared))

    def other_lags(self, total_flow: float) -> FloatArray:
        """(n,) s, the lags but for the sensor's; none for a sensor alone."""
        lags = self.rig.lags(np.array(self.shared), total_flow)
        return np.delete(lags, self.rig.sensor_lag)

    def fastest(self, settings: Sequence[PlannedSetting]) -> float:
        """s, the shortest of the other lags in any experiment; tau itself for a sensor alone."""
        found = [self.other_lags(setting.experiment.total_flow) for setting in settings]
        return min((float(lags.min()) for lags in found if lags.size), default=self.tau)

    def shortest(self, total_flow: float) -> float:
        """s, the shortest record in which the response to a step is over at its end."""
        slowest = float(self.rig.lags(np.array(self.shared), total_flow).max())
        return SETTLED * slowest / (END - BEGIN)


def refuse_several_sensors(campaign: Campaign) -> None:
    """Raise CampaignError where there is more than one sensor."""
    sensors = list(dict.fromkeys(e.sensor for e in campaign))
    if len(sensors) > 1:
        raise CampaignError(
            f"{campaign.source or campaign.title}: a prediction of tau's interval is for one "
            f"sensor, but there are {len(sensors)}; give signal in place of signals, for the one "
            "to plan for"
        )


def settings_of(problem: Problem, vector: FloatArray) -> list[PlannedSetting]:
    """The campaign's experiments as settings, data left out."""
    settings, layout = [], problem.layout
    for k, e in enumerate(problem.campaign):
        y0, beta = (float(v) for v in vector[layout.local[k, :2]])
        switches = tuple(float(v) for v in vector[layout.switches(k)])
        weight = problem.noise.weight(problem.campaign, e)
        settings.append(PlannedSetting(replace(e, y=None), y0, beta, switches, weight))
    return settings


def truth_of(problem: Problem, vector: FloatArray) -> Truth:
    """Shared parameters of a flat vector; the first experiment's noise where each has its own.

    Raises CampaignError for several sensors or tied parameters, or where the noise is not given.
    """
    layout = problem.layout
    refuse_several_sensors(problem.campaign)
    refuse_ties(problem.campaign, "planning")
    phi, sigma0, sigma1 = (float(v) for v in vector[layout.noise[0]])
    if not (np.isfinite(sigma0) and sigma0 > 0):
        raise CampaignError("theta lacks sigma0_V; a prediction needs the noise's size in volts")
    shared = tuple(float(v) for v in vector[: layout.n_shared])
    law = replace(problem.noise, per_experiment=False)
    interval, stages = problem.campaign.reference_interval, problem.campaign.stages
    return Truth(shared, phi, sigma0, sigma1, law, interval, stages)


def planned(
    name: str,
    total_flow: float,
    concentration: float,
    duration: float,
    interval: float,
    y0: float,
    beta: float,
    weight: float,
    delay: float = 0.0,
) -> PlannedSetting:
    """A step experiment of ``duration`` s: up at 20 %, down at 60 % of it (mL/s, fraction, s, V).

    The valve answers ``delay`` s after its commands.  ``total_flow`` is nan where it is not known.
    """
    if not duration / interval <= MAX_SAMPLES:
        raise CampaignError(
            f"design: a record of {duration:.4g} s with a sample every {interval:.4g} s has more "
            f"than the {MAX_SAMPLES} samples of an experiment; allow shorter records"
        )
    t: FloatArray = interval * np.arange(max(round(duration / interval), 2), dtype=float)
    on, off = BEGIN * duration, END * duration
    carrier, test_gas = (1.0 - concentration) * total_flow, concentration * total_flow
    known = np.isfinite(total_flow)
    e = Experiment(
        name, t, None, carrier if known else None, test_gas if known else None, interval, on, off
    )
    return PlannedSetting(e, y0, beta, (on + delay, off + delay), weight)
