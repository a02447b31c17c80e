"""The perturbed rig of one experiment, whatever its stages and its input are."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from bayes_sensor.campaign import Experiment, FloatArray
from bayes_sensor.rig.imperfections import CONCENTRATION, FIRST, MIDDLE, NEUTRAL, START, T0, TF, Y0
from bayes_sensor.rig.perturbed_chain import (
    FIRST_VOLUME,
    LAGS,
    PLAIN,
    SENSOR,
    VALVE,
    VOLUME,
    Chain,
    chain_mean,
    chain_response_of,
)
from bayes_sensor.rig.rig import Rig
from bayes_sensor.rig.switching import Switching

Modes = tuple[FloatArray, FloatArray]
"""shares and relative time constants of a coating"""
NEVER = 1e30
"""s, time of a step down that is not there"""


@dataclass(frozen=True, eq=False)
class ExperimentKernel:
    """Parameters and response of the perturbed chain in one experiment.

    >>> from bayes_sensor.rig.rig import Rig
    >>> e = Experiment("1", np.arange(0.0, 60.0), None, None, None, 1.0, 10.0, 40.0)
    >>> kernel = ExperimentKernel(Rig.parse(["sensor"]), Switching.of(e), e)
    >>> p = kernel.parameters(np.array([5.0]), np.array([0.0, 2.0, 10.0, 40.0]))
    >>> kernel.mean(np.array([5.0, 15.0]), p, (np.ones(1), np.ones(1))).round(4).tolist()
    [0.0, 1.2642]
    """

    rig: Rig
    switching: Switching
    experiment: Experiment

    @cached_property
    def chain(self) -> Chain:
        """What no parameter changes."""
        codes: list[int] = []
        has_volume = False
        for stage, n in zip(self.rig.stages, self.rig.lags_of_stages, strict=True):
            code = PLAIN
            if stage.name == "sensor":
                code = SENSOR
            elif stage.name == "valve":
                code = VALVE
            elif stage.kind.depends_on_flow:
                code = VOLUME if has_volume else FIRST_VOLUME
                has_volume = True
            codes += [code, *[PLAIN] * (n - 1)][:n]
        input_ = self.switching.recorded
        nothing = np.zeros(0)
        return Chain(
            np.array(codes, dtype=np.int64),
            np.array(self.switching.heights, dtype=float),
            float(self.switching.level_before),
            nothing if input_ is None else input_.times,
            nothing if input_ is None else input_.values,
        )

    @cached_property
    def _blank(self) -> FloatArray:
        e = self.experiment
        n = len(self.chain.codes) + (len(self.switching.heights) or 1)
        p = np.zeros(LAGS + n)
        p[FIRST:LAGS] = NEUTRAL
        p[CONCENTRATION] = e.concentration
        p[START] = e.t[0] - 0.5 * e.interval
        p[MIDDLE] = 0.5 * (e.t[0] + e.t[-1])
        p[TF] = NEVER
        return p

    @property
    def size(self) -> int:
        """How many parameters the kernel has."""
        return len(self._blank)

    def parameters(self, shared: FloatArray, local: FloatArray) -> FloatArray:
        """(size,) of the rig's ``shared`` values and of y0, beta and the switch times ``local``."""
        p = self._blank.copy()
        flow = self.experiment.total_flow
        n = len(self.chain.codes)
        p[LAGS : LAGS + n] = self.rig.lags(shared, flow)
        p[Y0 : Y0 + 2] = local[:2]
        delay = self.rig.delay(shared, flow) if self.rig.has_delay else 0.0
        if self.switching.recorded is not None:
            p[LAGS + n] = local[2] + delay
            p[T0] = self.switching.recorded.times[0] + p[LAGS + n]
            return p
        times = self.switching.times(local[2:]) + delay
        p[LAGS + n :] = times
        heights = self.chain.heights
        p[T0] = times.min()
        falls = times[heights < 0.0]
        p[TF] = falls.max() if len(falls) else NEVER
        return p

    def first_and_last(self, switches: FloatArray) -> tuple[float, float | None]:
        """s, the first switch, and the last one that leads down (None where none does).

        ``switches``: what moves them.
        """
        if self.switching.recorded is not None:
            return float(self.switching.recorded.times[0] + switches[0]), None
        times = self.switching.times(switches)
        falls = times[self.chain.heights < 0.0]
        return float(times.min()), float(falls.max()) if len(falls) else None

    def response(self, times: FloatArray, p: FloatArray, modes: Modes) -> FloatArray:
        """(n_t,) what the readout sees at sorted ``times`` (n_t,) s."""
        return np.asarray(chain_response_of(times, p, self.chain, *modes))

    def mean(self, times: FloatArray, p: FloatArray, modes: Modes) -> FloatArray:
        """(n_t,) V at sorted ``times`` (n_t,) s."""
        return np.asarray(chain_mean(times, p, self.chain, *modes))
