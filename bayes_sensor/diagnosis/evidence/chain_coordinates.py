"""The coordinates of a hypothesis on any rig: a logarithm for each parameter that is shared.

Lags that could swap places keep those that the fit has given them.  What the published rig's
coordinates do with the order of two lags is not needed: priors of a lag's logarithm are proper.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from math import exp, log
from typing import Any

import numpy as np

from bayes_sensor.campaign import FloatArray
from bayes_sensor.diagnosis.data.binned_campaign import BinnedCampaign, ChainOfCampaign
from bayes_sensor.diagnosis.effects.effect import Form
from bayes_sensor.diagnosis.effects.rig_view import RigView, coating_modes
from bayes_sensor.diagnosis.effects.setting import Setting
from bayes_sensor.diagnosis.evidence.refit_coordinates import Coordinates
from bayes_sensor.rig.imperfections import FIRST, NEUTRAL, READOUT_SETTINGS
from bayes_sensor.rig.perturbed_chain import LAGS, chain_bin_means

LONGEST_LOG = 40.0
"""what the kernel can bear"""
OTHER_LAGS = (0.25, 2.5)
"""times the fitted value of the sensor's lag at which fits begin, too, where there are others"""


@dataclass(frozen=True, eq=False)
class ChainCoordinates(Coordinates):
    """The coordinates of a hypothesis on a rig that is a chain of stages, and the means."""

    @cached_property
    def chain(self) -> ChainOfCampaign:
        """The stages and inputs."""
        assert self.binned.chain is not None
        return self.binned.chain

    @property
    def n_ordered(self) -> int:
        """None: no lag is held below another."""
        return 0

    def at_limit(self, x: FloatArray) -> bool:
        """Never: there is no limit."""
        return False

    @property
    def places_of_tau(self) -> tuple[int, int]:
        """The sensor's lag comes first."""
        return 0, 0

    @property
    def tau_is_difference(self) -> float:
        """It has a coordinate of its own."""
        return 0.0

    def tau_of(self, x: FloatArray) -> float:
        """s, the lag of the (first) sensor."""
        return exp(min(float(x[0]), LONGEST_LOG))

    def logarithms(self, x: FloatArray) -> FloatArray:
        """(n_shared,) those of the rig's parameters."""
        return x[: self.first_strength].copy()

    def bent(self, before: FloatArray, after: FloatArray) -> float:
        """0: a lag is a coordinate of its own."""
        return 0.0

    def with_tau(self, x: FloatArray, log_tau: float) -> FloatArray:
        """``x`` (n,) with another lag of the sensor; what it gains the switch times lose."""
        made = x.copy()
        made[0] = log_tau
        made[self.switch_times] -= exp(log_tau) - exp(float(x[0]))
        return made

    def other_starts(self, x: FloatArray) -> list[FloatArray]:
        """``x`` (n,), and with the sensor's lag shorter and longer where there are other lags."""
        if len(self.chain.names) == 1:
            return [x.copy()]
        return [x.copy(), *(self.with_tau(x, float(x[0]) + log(r)) for r in OTHER_LAGS)]

    def rig(
        self, x: FloatArray, k: int
    ) -> tuple[FloatArray, tuple[Form, Mapping[str, float]] | None]:
        """The kernel's parameters of experiment ``k``, and a mean of its own if a form has one."""
        p = self._parameters(x, k)
        return p, self._set(p, self.values(x, k), k) if self.parts else None

    def _parameters(self, x: FloatArray, k: int) -> FloatArray:
        shared = np.exp(np.minimum(x[self.chain.shared[k]], LONGEST_LOG))
        at = self.local[k]
        return self.chain.kernels[k].parameters(shared, x[at : at + self.binned.own_sizes[k]])

    def _view(self, setting: Setting, p: FloatArray) -> RigView:
        k = self._number[setting.experiment.name]
        return RigView(setting, p, self.chain.kernels[k])

    @cached_property
    def _number(self) -> dict[str, int]:
        return {e.name: k for k, e in enumerate(self.binned.campaign)}

    def _mean_of(self, at: FloatArray, p: FloatArray, k: int) -> FloatArray:
        return self.chain.kernels[k].mean(at, p, coating_modes())

    def bin_means(self, x: FloatArray, k: int) -> FloatArray:
        """V (n_bins,), mean of each bin of experiment ``k``."""
        if self.own_mean:
            return self.binned.bins[k].reduce(self.mean(x, k))
        p, _ = self.rig(x, k)
        return self._averaged(p[None], k)[:, 0]

    def all_means(self, x: FloatArray) -> FloatArray:
        """V (n_bins in all,), the same of all experiments, one after the other."""
        return np.concatenate([self.bin_means(x, k) for k in range(len(self.binned.bins))])

    def _averaged(self, rows: FloatArray, k: int) -> FloatArray:
        """(n_bins, n_rows) V of experiment ``k``."""
        b = self.binned.bins[k].alone
        common = rows[:, _BEFORE_THE_READOUT]
        tail = rows[:, LAGS:]
        same = np.all(common == common[0], axis=1) & np.all(tail == tail[0], axis=1)
        made: FloatArray = chain_bin_means(
            b.times, b.weights, b.starts, b.low, b.high, rows, same,
            self.chain.kernels[k].chain, *coating_modes(),
        )  # fmt: skip
        return made

    def derivatives(self, x: FloatArray, here: FloatArray, finer: float = 1.0) -> FloatArray:
        """(n_bins in all, n_columns) whitened derivatives of the bins' means, which are ``here``.

        By every coordinate that an experiment depends on, see :attr:`places`.
        """
        steps = finer * self.steps
        if self.own_mean:
            means = self._moved_own_means(x, steps)
        else:
            means = np.zeros((self.binned.n_bins, self.places.shape[1]))
            for k, rows in enumerate(self.binned.rows):
                columns = self._columns[k]
                means[rows, : len(columns)] = self._averaged(self._moved_rows(x, steps, k), k)
        return self.binned.whitened((means - here[:, None]) / (finer * self._steps_by_bin))

    def _moved_rows(self, x: FloatArray, steps: FloatArray, k: int) -> FloatArray:
        """(n_columns, size) the kernel's parameters with each coordinate moved."""
        columns = self._columns[k]
        p, _ = self.rig(x, k)
        rows = np.repeat(p[None], len(columns), axis=0)
        fitted = {at: (part, s) for part, s, at in self._fitted[k]}
        moved = x.copy()
        for row, c in zip(rows, columns.tolist(), strict=True):
            moved[c] = x[c] + steps[c]
            if c in fitted:
                part, s = fitted[c]
                strengths = self.values(x, k)
                strengths[part][s.name] = s.value(float(moved[c]))
                row[FIRST:LAGS] = NEUTRAL
                self._set(row, strengths, k)
            else:
                made = self._parameters(moved, k)
                made[FIRST:LAGS] = p[FIRST:LAGS]
                row[:] = made
            moved[c] = x[c]
        return rows


_BEFORE_THE_READOUT = np.array(
    [i for i in range(LAGS) if i >= FIRST and i - FIRST not in READOUT_SETTINGS], dtype=np.int64
)
"""the settings of a kernel's parameters that change the response"""


def coordinates_of(binned: BinnedCampaign, *args: Any, **keys: Any) -> Coordinates:
    """The coordinates of a hypothesis on the rig of a campaign; arguments as of the class."""
    kind = Coordinates if binned.chain is None else ChainCoordinates
    return kind(binned, *args, **keys)
