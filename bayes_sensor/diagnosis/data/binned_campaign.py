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

SHARED = 3
"""coordinates shared by all experiments, of the shorter and the longer of tau and tau_v:
ln longer - ln shorter - FASTER, ln longer, ln V"""


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
    lags: tuple[str, str] = ("tau_s", "tau_v_s")
    """names of the shorter and the longer of the sensor's and the valve's lag; by size where
    nobody knows whose is which"""

    @property
    def sensor(self) -> int:
        """The sensor's lag: 0, the shorter, also where nobody knows; 1, the longer."""
        return int(self.lags[1] == "tau_s")

    @property
    def order_known(self) -> bool:
        """Whether it is known which of the two lags is the sensor's."""
        return "tau_s" in self.lags

    @cached_property
    def height(self) -> float:
        """V, :attr:`signal_scale` with the sign of the steps: what goes with it turns with them."""
        beta = [float(self.base[at + 1]) for at in self.local(SHARED)[:-1]]
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
        first = self.local(SHARED)[:-1]
        for e, at, before in zip(self.campaign, first, self.concentrations_before, strict=True):
            found.append(
                Setting(
                    experiment=e,
                    t0=float(self.base[at + 2]),
                    tf=float(self.base[at + 3]) if e.has_fall else float(e.t[-1]),
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
        sizes = ((4 if e.has_fall else 3) + own for e in self.campaign)
        return list(itertools.accumulate(sizes, initial=first))
