"""What the diagnosis starts from on a rig that is a chain of stages: around its fit, as records."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from math import log

import numpy as np
from numpy.typing import NDArray

from bayes_sensor.campaign import Campaign, FloatArray
from bayes_sensor.diagnosis.data.binned_campaign import ChainOfCampaign
from bayes_sensor.diagnosis.data.bins import ExperimentBins, bins_of
from bayes_sensor.diagnosis.data.switch_times import SwitchTimes, programme_times, recorded_times
from bayes_sensor.likelihood.density import response_at_samples
from bayes_sensor.likelihood.problem import Problem
from bayes_sensor.rig.cascade import response
from bayes_sensor.rig.experiment_kernel import ExperimentKernel
from bayes_sensor.rig.lags import Naming
from bayes_sensor.rig.layout import Layout
from bayes_sensor.rig.switching import input_range

LAG_SD, LONGEST_SD, VOLUME_SD = 1.0, 0.7, 0.3
"""sd of the logarithms of a lag, of the longest one, and of a volume around plausible values"""
LEAST = 0.03
"""of the longest lag: a shorter one is as plausible as one of this length"""


@dataclass(frozen=True, eq=False)
class FittedChain:
    """The fit of a campaign on a chain of stages."""

    campaign: Campaign
    theta: FloatArray
    """flat, the shared parameters by name where that is known"""
    by_size: FloatArray
    """the same with lags by size: the response is the same"""

    @classmethod
    def of(cls, campaign: Campaign, theta: FloatArray, naming: Naming) -> FittedChain:
        """From a fit, whose lags are by size."""
        named = np.array(theta, dtype=float)
        if naming.exchanged is not None:
            n = len(naming.commuting.shared)
            named[:n] = naming.commuting.named(named, [naming.exchanged])
        return cls(campaign, named, np.array(theta, dtype=float))

    @cached_property
    def layout(self) -> Layout:
        """Of theta."""
        return Layout.of(self.campaign)

    @cached_property
    def chain(self) -> ChainOfCampaign:
        """Stages and inputs."""
        layout = self.layout
        kernels = tuple(
            ExperimentKernel(rig, switching, e)
            for e, rig, switching in zip(self.campaign, layout.rigs, layout.switching, strict=True)
        )
        return ChainOfCampaign(layout.shared_names, tuple(layout.shared), kernels, self.height)

    def local(self, k: int) -> NDArray[np.int64]:
        """Positions of y0, beta and the switch times of experiment ``k``."""
        places = self.layout.local[k]
        found: NDArray[np.int64] = places[places >= 0]
        return found

    @cached_property
    def coordinates(self) -> FloatArray:
        """Those of the fit without effects."""
        shared = np.log(np.maximum(self.theta[: self.layout.n_shared], 1e-12))
        each = [self.theta[self.local(k)] for k in range(len(self.campaign))]
        return np.concatenate([shared, *each])

    @cached_property
    def residuals(self) -> list[FloatArray]:
        """(n_t,) V per experiment: measurement minus the fit."""
        return residuals_of_chain(self.campaign, self.theta)

    def taus(self, k: int) -> FloatArray:
        """(n_lags,) s of experiment ``k``."""
        e = self.campaign.experiments[k]
        return self.layout.rigs[k].lags(self.theta[self.layout.shared[k]], e.total_flow)

    @cached_property
    def time_scale(self) -> float:
        """s, the longest lag."""
        return max(float(self.taus(k).max()) for k in range(len(self.campaign)))

    @cached_property
    def _range(self) -> tuple[float, float]:
        """Lowest and highest level of the input in the campaign."""
        return input_range(self.layout.switching)

    @property
    def height(self) -> float:
        """Of the input's range."""
        low, high = self._range
        return high - low

    def level(self, k: int, t: FloatArray) -> FloatArray:
        """(n_t,) the response over the input's range, 0 to 1, at any times."""
        e = self.campaign.experiments[k]
        x = response(t, self.theta, self.layout, k, e.total_flow)
        return np.asarray((x - self._range[0]) / self.height)

    @cached_property
    def steps(self) -> list[float]:
        """V of every experiment: what the input's range is worth."""
        places = [self.layout.local[k, 1] for k in range(len(self.campaign))]
        return [abs(float(self.theta[place])) * self.height for place in places]

    def switches(self, k: int) -> list[SwitchTimes]:
        """Of experiment ``k``."""
        e, switching = self.campaign.experiments[k], self.layout.switching[k]
        if switching.recorded is not None:
            return recorded_times(e.t, self.level(k, e.t), e.interval)
        times = switching.times(self.theta[self.layout.switches(k)])
        heights = np.array(switching.heights)
        order = np.argsort(times, kind="stable")
        levels = np.empty(len(times))
        levels[order] = (switching.rest + np.cumsum(heights[order]) - self._range[0]) / self.height
        commanded: list[float | None]
        if e.commands is not None:
            commanded = [float(t) for t in e.commands.times]
        else:
            commanded = [e.commanded_on, e.commanded_off][: len(times)]
        return programme_times(times, heights / self.height, levels, commanded, self.taus(k))

    def bins(self) -> list[ExperimentBins]:
        """Of every experiment."""
        return [bins_of(e, self.switches(k), self.time_scale) for k, e in enumerate(self.campaign)]

    @cached_property
    def priors(self) -> tuple[FloatArray, FloatArray]:
        """(n_shared,) means and sds of the logarithms of the shared parameters."""
        names, longest = self.layout.shared_names, self.time_scale
        beforehand = Problem(self.campaign).named_laws
        centre, sd = np.empty(len(names)), np.empty(len(names))
        lags = [float(v) for n, v in zip(names, self.theta, strict=False) if n.startswith("tau")]
        for i, name in enumerate(names):
            value = float(self.theta[i])
            if name.startswith("tau"):
                centre[i] = log(max(value, LEAST * longest))
                sd[i] = LONGEST_SD if value >= max(lags) else LAG_SD
            else:
                flow = float(np.median([e.total_flow for e in self.campaign]))
                centre[i] = log(max(value, LEAST * longest * flow))
                sd[i] = VOLUME_SD if value > LEAST * longest * flow else LAG_SD
            known = beforehand.get(name)
            if known is not None and known.a > 0.0:
                centre[i], sd[i] = log(known.a), max(known.b / known.a, 1e-4)
        return centre, sd


def residuals_of_chain(campaign: Campaign, theta: FloatArray) -> list[FloatArray]:
    """(n_t,) V per experiment: measurement minus the chain's mean at a flat ``theta``."""
    problem = Problem(campaign)
    vector = problem.layout.flat(theta)
    found = []
    for k, e in enumerate(campaign):
        i_y0, i_beta = problem.layout.local[k, :2]
        mean = vector[i_y0] + vector[i_beta] * response_at_samples(problem, vector, k)
        found.append(np.where(e.used, e.values - mean, 0.0))
    return found
