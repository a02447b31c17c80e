"""The rig: the stages that the gas passes, their parameters and the exact response.

Nobody else needs to know which stages there are: the flat vector of shared parameters has the order
of :attr:`Rig.names`, and lags the order of the stages.
"""

from __future__ import annotations

import difflib
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np

from bayes_sensor.campaign import ORDERS, STAGES, CampaignError, FloatArray
from bayes_sensor.rig.chain import Drive, chain_response, lag_sensitivities, switch_sensitivities
from bayes_sensor.rig.programme import Programme, RecordedInput
from bayes_sensor.rig.stages import KINDS, Stage, StageKind
from bayes_sensor.rig.stages.stage import Passage

MOST_STAGES = 6


class Sensitivities(NamedTuple):
    """Derivatives of the response."""

    parameters: FloatArray
    """(n_t, n_parameters) by each shared parameter, in its unit"""
    delay: FloatArray
    """(n_t,) 1/s, by a delay of the whole programme"""


@dataclass(frozen=True)
class Rig:
    """What the gas passes on its way to the signal, in order.

    Shared parameters, one of each stage: the sensor's, then of other stages that do not depend on
    flow, then of those that do, in the order of the stages.

    Raises
    ------
    CampaignError
        If there are not one to six stages, two have one parameter, not exactly one is called
        ``sensor`` or ``sensor_is`` is unknown.

    >>> Rig.parse(["valve", "line", "filter", "probe: lag", "sensor"]).names
    ('tau_s', 'tau_v_s', 'tau_filter_s', 'tau_probe_s', 'V_line_mL')
    """

    stages: tuple[Stage, ...]
    sensor_is: str = "unknown"
    """which of the lags that do not depend on flow is the sensor's: ``faster`` (the shortest),
    ``slower`` (the longest) or ``unknown``"""
    ties: tuple[tuple[int, float], ...] = ()
    """where parameters are tied: of the stages in the order of :attr:`names`, the place of each
    one's value among the values given, and a factor"""

    def __post_init__(self) -> None:
        object.__setattr__(self, "stages", tuple(self.stages))
        if not 1 <= len(self.stages) <= MOST_STAGES:
            raise CampaignError(
                f"stages: expected one to {MOST_STAGES}, got {len(self.stages)}; join stages that "
                "act as one"
            )
        if self.sensor_is not in ORDERS:
            raise CampaignError(
                f"sensor_is: expected one of {', '.join(ORDERS)}, but got '{self.sensor_is}'"
            )
        for i, stage in enumerate(self.stages):
            for other in self.stages[:i]:
                if stage.parameter == other.parameter:
                    raise CampaignError(
                        f"stages: '{other.name}' and '{stage.name}' would both have the parameter "
                        f"{stage.parameter}; rename one, as in '{stage.name}2: {stage.kind.name}'"
                    )
        sensors = [stage.name for stage in self.stages].count("sensor")
        if sensors != 1:
            raise CampaignError(
                f"stages: expected exactly one called 'sensor', got {sensors} among "
                f"{', '.join(stage.name for stage in self.stages)}; say which is the sensor"
            )

    def __repr__(self) -> str:
        """The stages by name, with the kind of those whose name does not say it."""
        said = [
            stage.name if stage.name in stage.kind.words else f"{stage.name}: {stage.kind.name}"
            for stage in self.stages
        ]
        return f"Rig({', '.join(map(repr, said))})"

    @classmethod
    def parse(
        cls,
        texts: Sequence[str],
        sensor_is: str = "unknown",
        kinds: Mapping[str, StageKind] = KINDS,
    ) -> Rig:
        """The rig of the stages of ``campaign.toml``: known words, or ``"NAME: KIND"``."""
        return cls(tuple(_parsed(text, kinds) for text in texts), sensor_is)

    @cached_property
    def _order(self) -> tuple[int, ...]:
        """Places in the stages of the stages in the order of the parameters."""

        def rank(i: int) -> tuple[bool, bool, int]:
            stage = self.stages[i]
            return stage.name != "sensor", stage.kind.depends_on_flow, i

        return tuple(sorted(range(len(self.stages)), key=rank))

    @cached_property
    def _places(self) -> tuple[int, ...]:
        """Place of each stage's parameter among the parameters."""
        return tuple(self._order.index(i) for i in range(len(self.stages)))

    @cached_property
    def _sources(self) -> tuple[tuple[int, float], ...]:
        """Of each stage, the place of its value among the values given, and a factor."""
        return tuple(self.ties[i] if self.ties else (i, 1.0) for i in self._places)

    @cached_property
    def names(self) -> tuple[str, ...]:
        """Flat names of the shared parameters."""
        return tuple(self.stages[i].parameter for i in self._order)

    @cached_property
    def units(self) -> tuple[str, ...]:
        """Units of the shared parameters."""
        return tuple(self.stages[i].kind.unit for i in self._order)

    @cached_property
    def kinds(self) -> tuple[str, ...]:
        """Kinds of the stages, in the order of the parameters."""
        return tuple(self.stages[i].kind.name for i in self._order)

    @cached_property
    def needs_flow(self) -> bool:
        """Whether the total flow must be known."""
        return any(stage.kind.depends_on_flow for stage in self.stages)

    @cached_property
    def lags_of_stages(self) -> tuple[int, ...]:
        """How many lags each stage has."""
        return tuple(len(stage.kind.passage(1.0, 1.0).lags) for stage in self.stages)

    @property
    def n_lags(self) -> int:
        """How many lags the whole chain has."""
        return sum(self.lags_of_stages)

    @cached_property
    def sensor_lag(self) -> int:
        """Place of the sensor's (first) lag in :meth:`taus`."""
        names = [stage.name for stage in self.stages]
        return sum(self.lags_of_stages[: names.index("sensor")])

    @cached_property
    def has_delay(self) -> bool:
        """Whether a stage delays the gas in addition to its lags."""
        passages = [stage.kind.passage(1.0, 1.0) for stage in self.stages]
        return any(passage.delay != 0.0 for passage in passages)

    def lags_that_commute(self, one_flow: bool = False) -> tuple[str, ...]:
        """Parameters of the lags that the data know as a set, not by name.

        Those of stages with one lag that does not depend on flow, or, where all experiments share
        ``one_flow``, of all stages with one lag.

        >>> published = Rig.parse(["valve", "manifold", "sensor"])
        >>> published.lags_that_commute()
        ('tau_s', 'tau_v_s')
        >>> published.lags_that_commute(one_flow=True)
        ('tau_s', 'tau_v_s', 'V_mL')
        """
        found = []
        for i in self._order:
            stage = self.stages[i]
            if self.lags_of_stages[i] == 1 and (one_flow or not stage.kind.depends_on_flow):
                found.append(stage.parameter)
        return tuple(found)

    def _passages(self, shared: FloatArray, flow: float | None) -> list[Passage]:
        at = self._flow(flow)
        return [
            stage.kind.passage(shared[i] * factor, at)
            for stage, (i, factor) in zip(self.stages, self._sources, strict=True)
        ]

    def _flow(self, flow: float | None) -> float:
        if flow is not None:
            return flow
        if self.needs_flow:
            stage = next(stage for stage in self.stages if stage.kind.depends_on_flow)
            raise CampaignError(
                f"stage '{stage.name}' depends on the total flow, but none is given; give "
                "carrier_flow and test_gas_flow"
            )
        return np.nan

    def lags(self, shared: FloatArray, flow: float | None = None) -> FloatArray:
        """:meth:`taus` without a check: a lag may be zero."""
        return np.array(
            [lag for passage in self._passages(shared, flow) for lag in passage.lags], dtype=float
        )

    def taus(self, shared: FloatArray, flow: float | None = None) -> FloatArray:
        """(n_lags, ..) s, the lags in the order of the stages.

        Parameters
        ----------
        shared
            (n_parameters, ..) in the order of :attr:`names`, or as :attr:`ties` have them; draws
            behind.
        flow
            total flow, mL/s; None where no stage depends on it.

        Raises CampaignError unless all are positive.
        """
        taus = self.lags(shared, flow)
        if not (taus.min() > 0.0 and taus.max() < np.inf):
            raise CampaignError(
                f"time constants must be positive, but those of "
                f"{', '.join(stage.name for stage in self.stages)} are {taus.tolist()} s"
            )
        return taus

    def delay(self, shared: FloatArray, flow: float | None = None) -> float:
        """s, of all stages together."""
        return float(sum(passage.delay for passage in self._passages(shared, flow)))

    def response(
        self,
        t: FloatArray,
        shared: FloatArray,
        flow: float | None,
        programme: Programme | RecordedInput,
        interval: float | None = None,
    ) -> FloatArray:
        """Test-gas share (n_t,) at the end of the chain, exact.

        ``interval``: s, where ``t`` is ``t[0] + i * interval``; then by recurrence, many times
        faster.

        >>> rig, programme = Rig.parse(["valve", "manifold", "sensor"]), Programme.pulse(1.0, 60.0)
        >>> shared = np.array([0.0481, 0.8577, 58.23])
        >>> rig.response(np.array([0.5, 3.0, 60.0]), shared, 75.0, programme).round(4).tolist()
        [0.0, 0.6891, 1.0]
        """
        return programme.rest + self.passed(t, shared, flow, programme.drive, interval)

    def passed(
        self,
        t: FloatArray,
        shared: FloatArray,
        flow: float | None,
        drive: Drive,
        interval: float | None = None,
    ) -> FloatArray:
        """What the stages make (n_t,) of an input that is zero before its events."""
        if self.has_delay:
            drive = drive.later(self.delay(shared, flow))
        return chain_response(t, self.taus(shared, flow), drive, interval)

    def sensitivities(
        self,
        t: FloatArray,
        shared: FloatArray,
        flow: float | None,
        programme: Programme | RecordedInput,
        interval: float | None = None,
    ) -> Sensitivities:
        """Derivatives of :meth:`response` by every shared parameter and by a delay."""
        by_delay = -self.passed(t, shared, flow, programme.derivative, interval)
        found = np.zeros((len(t), len(shared)))
        self.add_slopes(found, t, shared, flow, programme.derivative, by_delay, interval)
        return Sensitivities(found, by_delay)

    def add_slopes(
        self,
        found: FloatArray,
        t: FloatArray,
        shared: FloatArray,
        flow: float | None,
        derivative: Drive,
        by_delay: FloatArray | None,
        interval: float | None = None,
    ) -> None:
        """Add to ``found`` (n_t, ..) the derivatives by the shared parameters, in its first
        columns; ``by_delay`` (n_t,): that by a delay of the input, where a stage has one."""
        if self.has_delay:
            derivative = derivative.later(self.delay(shared, flow))
        by_lag = lag_sensitivities(t, self.taus(shared, flow), derivative, interval)
        place = 0
        for stage, (i, factor) in zip(self.stages, self._sources, strict=True):
            slope = stage.kind.slope(shared[i] * factor, self._flow(flow))
            for lag in slope.lags:
                found[:, i] += factor * lag * by_lag[:, place]
                place += 1
            if by_delay is not None:
                found[:, i] += factor * slope.delay * by_delay

    def switch_sensitivities(
        self,
        t: FloatArray,
        shared: FloatArray,
        flow: float | None,
        programme: Programme,
        interval: float | None = None,
    ) -> FloatArray:
        """(n_t, n_switches) derivatives of :meth:`response` by the switch times, 1/s."""
        times = programme.times + self.delay(shared, flow)
        taus = self.taus(shared, flow)
        return switch_sensitivities(t, taus, times, programme.heights, interval)


def _parsed(text: str, kinds: Mapping[str, StageKind]) -> Stage:
    """The stage of one text; CampaignError with what may be meant."""
    words = {word: kind for kind in kinds.values() for word in kind.words}
    name, colon, of_kind = (part.strip() for part in str(text).partition(":"))
    if not colon:
        if name in words:
            return Stage(name, words[name])
        raise CampaignError(
            f"stages: '{name[:40]}' is no known stage; {_nearest(name, words)}; any other is "
            f'written with its kind, as in "{name[:40] or "probe"}: lag"'
        )
    if of_kind not in kinds:
        raise CampaignError(
            f"stages: '{text[:60]}' has the kind '{of_kind[:40]}'; {_nearest(of_kind, kinds)}"
        )
    if name in words and words[name] is not kinds[of_kind]:
        raise CampaignError(
            f"stages: '{text[:60]}', but a {name} is a {words[name].name}; write '{name}' or "
            "rename it"
        )
    return Stage(name, kinds[of_kind])


def _nearest(word: str, known: Iterable[str]) -> str:
    close = difflib.get_close_matches(word, list(known), n=1)
    return f"did you mean '{close[0]}'?" if close else f"known are {', '.join(known)}"


PUBLISHED = Rig.parse(STAGES)
"""valve, manifold and sensor, as in the paper"""
