"""A campaign in bins, with its noise floor: what every hypothesis is fitted to."""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from bayes_sensor.campaign import Campaign, FloatArray
from bayes_sensor.diagnosis.data.bins import AllBins, ExperimentBins
from bayes_sensor.diagnosis.data.noise_floor import NoiseFloor
from bayes_sensor.diagnosis.effects.setting import Setting
from bayes_sensor.diagnosis.evidence.block_least_squares import whiten
from bayes_sensor.rig.experiment_kernel import ExperimentKernel

SHARED = 3
"""coordinates shared by all experiments, of the shorter and the longer of tau and tau_v:
ln longer - ln shorter - FASTER, ln longer, ln V"""


@dataclass(frozen=True, eq=False)
class ChainOfCampaign:
    """The stages and inputs of a campaign that is not pulses on the published rig."""

    names: tuple[str, ...]
    """of the parameters that experiments share"""
    shared: tuple[NDArray[np.int64], ...]
    """of each experiment, positions of its rig's parameters among these"""
    kernels: tuple[ExperimentKernel, ...]
    """of each experiment"""
    height: float = 1.0
    """of the input's range in the campaign: beta is what a unit of the input is worth"""

    @property
    def own_sizes(self) -> tuple[int, ...]:
        """Of each experiment: y0, beta and the times of its switches."""
        return tuple(2 + len(kernel.switching.names) for kernel in self.kernels)

    def restricted(self, stay: Sequence[int]) -> ChainOfCampaign:
        """With some experiments alone."""
        return replace(
            self,
            shared=tuple(self.shared[k] for k in stay),
            kernels=tuple(self.kernels[k] for k in stay),
        )

    def times(self, k: int, local: FloatArray) -> tuple[float, float]:
        """s, when experiment ``k`` first switches, and when it last switches down; the end of the
        record where it never does.  ``local``: y0, beta and the times of its switches."""
        first, last = self.kernels[k].first_and_last(local[2:])
        return first, float(self.kernels[k].experiment.t[-1]) if last is None else last


@dataclass(frozen=True, eq=False)
class BinnedCampaign:
    """A campaign in bins, with its noise floor and the priors of the nuisance parameters."""

    campaign: Campaign
    bins: tuple[ExperimentBins, ...]
    data: tuple[FloatArray, ...]
    """(n_bins,) V, mean of each bin"""
    floor: NoiseFloor
    base: FloatArray
    """coordinates of the fit without effects"""
    centre: FloatArray
    """(3,) prior means of the logarithms of the shorter lag, the longer one and V"""
    sd: FloatArray
    """(3,) their prior sds"""
    time_scale: float
    """s, of the slower of valve and manifold"""
    signal_scale: float
    """V, median step height"""
    reference_flow: float
    """mL/s, median total flow"""
    duration: float
    """s, median length of a record"""
    given_before: tuple[float, ...] | None = None
    """concentrations before each experiment where the campaign does not tell: some are left out"""
    chain: ChainOfCampaign | None = None
    """None: pulses on the published rig"""
    lags: tuple[str, str] = ("tau_s", "tau_v_s")
    """names of the shorter and the longer of the sensor's and the valve's lag; by size where
    nobody knows whose is which"""

    @property
    def n_shared(self) -> int:
        """Coordinates that all experiments share, those of strengths aside."""
        return SHARED if self.chain is None else len(self.chain.names)

    @cached_property
    def own_sizes(self) -> tuple[int, ...]:
        """Coordinates that each experiment has for itself, those of strengths aside."""
        if self.chain is not None:
            return self.chain.own_sizes
        return tuple(4 if e.has_fall else 3 for e in self.campaign)

    @property
    def sensor(self) -> int:
        """The sensor's lag: 0, the shorter, also where nobody knows; 1, the longer."""
        return int(self.lags[1] == "tau_s")

    @property
    def order_known(self) -> bool:
        """Whether it is known which of the two lags is the sensor's."""
        return "tau_s" in self.lags

    @property
    def stated_lag(self) -> str:
        """What all that is said of tau is said of: the lag of the sensor, by name the first one's
        where there are several; the shorter lag where nobody knows which is the sensor's."""
        if not self.order_known:
            return "the shorter lag"
        return "tau" if self.chain is None else self.chain.names[0].replace("_s", "", 1)

    def moved_by(self, k: int) -> NDArray[np.int64]:
        """(n_switches,) which of the times of experiment ``k`` moves each switch, in the order of
        its bins'."""
        n = len(self.bins[k].switches)
        if self.chain is None:
            return np.arange(n)
        switching = self.chain.kernels[k].switching
        if switching.recorded is not None:
            return np.zeros(n, dtype=np.int64)
        local = self.base[self.local(self.n_shared)[k] + 2 :][: len(switching.names)]
        return switching.places[np.argsort(switching.times(local), kind="stable")]

    @property
    def several_flows(self) -> bool:
        """Whether the experiments differ in their total flow."""
        return len(self.campaign) > 1 and not self.campaign.same_flow

    @property
    def input_height(self) -> float:
        """Of the input's range: beta times it is the height of the signal."""
        return 1.0 if self.chain is None else self.chain.height

    @cached_property
    def height(self) -> float:
        """V, :attr:`signal_scale` with the sign of the steps: what goes with it turns with them."""
        beta = [float(self.base[at + 1]) for at in self.local(self.n_shared)[:-1]]
        return self.signal_scale if np.median(beta) >= 0.0 else -self.signal_scale

    @cached_property
    def inverse_factors(self) -> tuple[FloatArray, ...]:
        """Inverses of the floor's Cholesky factors."""
        return tuple(np.asarray(np.linalg.inv(c), dtype=float) for c in self.floor.cholesky)

    @cached_property
    def n_bins(self) -> int:
        """Bins in all experiments."""
        return sum(len(d) for d in self.data)

    @cached_property
    def all_bins(self) -> AllBins:
        """The bins of all experiments, one after the other."""
        return AllBins.of(self.bins)

    @cached_property
    def _flat_factors(self) -> FloatArray:
        return np.concatenate([factor.ravel() for factor in self.inverse_factors])

    def whitened(self, differences: FloatArray) -> FloatArray:
        """Differences V (n_bins in all,) or (n_bins in all, m) over the floor."""
        made: FloatArray = whiten(self._flat_factors, self.all_bins.of_bins, differences)
        return made

    @cached_property
    def rows(self) -> list[slice]:
        """Where each experiment's bins stand in a vector over all."""
        ends = np.cumsum([0] + [len(d) for d in self.data])
        return [slice(a, b) for a, b in itertools.pairwise(ends)]

    @property
    def concentrations_before(self) -> tuple[float, ...]:
        """Of the experiment that was run before each, whether it is in these bins or not."""
        return self.given_before or self.campaign.concentrations_before

    @cached_property
    def settings(self) -> tuple[Setting, ...]:
        """What effects may know of every experiment, switch times from the fit without effects."""
        found = []
        first = self.local(self.n_shared)
        for k, (e, before) in enumerate(
            zip(self.campaign, self.concentrations_before, strict=True)
        ):
            at = first[k]
            if self.chain is not None:
                t0, tf = self.chain.times(k, self.base[at : first[k + 1]])
            else:
                t0 = float(self.base[at + 2])
                tf = float(self.base[at + 3]) if e.has_fall else float(e.t[-1])
            found.append(
                Setting(
                    experiment=e,
                    t0=t0,
                    tf=tf,
                    time_scale=self.time_scale,
                    reference_flow=self.reference_flow,
                    signal_scale=self.signal_scale,
                    duration=self.duration,
                    concentration_before=before,
                )
            )
        return tuple(found)

    def restricted(self, keep: Sequence[NDArray[np.bool_]]) -> BinnedCampaign:
        """The binned campaign with only some bins (n_bins,) of every experiment.

        An experiment without any is left out, with its coordinates.
        """
        stay = [k for k, mask in enumerate(keep) if np.any(mask)]
        factors = []
        for k in stay:
            covariance = self.floor.cholesky[k] @ self.floor.cholesky[k].T
            kept = covariance[np.ix_(keep[k], keep[k])]
            factors.append(np.asarray(np.linalg.cholesky(kept), dtype=float))
        experiments = tuple(self.campaign.experiments[k] for k in stay)
        return replace(
            self,
            campaign=replace(self.campaign, experiments=experiments),
            bins=tuple(self.bins[k].restricted(keep[k]) for k in stay),
            data=tuple(self.data[k][keep[k]] for k in stay),
            floor=replace(
                self.floor,
                cholesky=tuple(factors),
                density=self.floor.density[stay],
                loudness=tuple(self.floor.loudness[k][keep[k]] for k in stay),
            ),
            base=self.local_coordinates(self.base, stay),
            chain=None if self.chain is None else self.chain.restricted(stay),
            given_before=tuple(self.concentrations_before[k] for k in stay),
        )

    def local_coordinates(self, x: FloatArray, stay: Sequence[int], own: int = 0) -> FloatArray:
        """Coordinates ``x`` without those of the experiments that do not stay.

        ``own``: strengths that every experiment has for itself.
        """
        at = self.local(len(x) - self.local(0, own)[-1], own)
        return np.concatenate([x[: at[0]], *(x[at[k] : at[k + 1]] for k in stay)])

    def local(self, first: int, own: int = 0) -> list[int]:
        """First coordinate of each experiment, starting at ``first``, and the end of the last.

        ``own``: strengths that every experiment has for itself.
        """
        sizes = (size + own for size in self.own_sizes)
        return list(itertools.accumulate(sizes, initial=first))
