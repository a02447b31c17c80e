"""Experiments and campaigns: what was measured, with units settled.

Everything here is in seconds, volts (or the campaign's ``signal_unit``) and mL/s.
Files are read in :mod:`bayes_sensor.io.readers`; this room only holds and checks the records.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property
from importlib import import_module
from typing import Any, NamedTuple

import numpy as np

from bayes_sensor.display import card, record_card
from bayes_sensor.experiment import (
    FREE_SWITCHES,
    MOST_JITTER,
    MOST_OFF,
    BoolArray,
    CampaignError,
    Commands,
    Experiment,
    FloatArray,
    counted,
)
from bayes_sensor.names import appearance

__all__ = [
    "FREE_SWITCHES",
    "MOST_JITTER",
    "MOST_OFF",
    "ORDERS",
    "STAGES",
    "ZIF8",
    "BoolArray",
    "Campaign",
    "CampaignError",
    "Commands",
    "Experiment",
    "FloatArray",
    "SideInformation",
    "Tie",
    "counted",
    "not_a_campaign",
]

ORDERS = ("faster", "slower", "unknown")
"""what is known of the sensor's lag among those that do not depend on flow"""
STAGES = ("valve", "manifold", "sensor")
"""what the gas passes, in order"""
ZIF8 = "zif8"
"""the coating of the published sensor, the only one that is modelled"""


@dataclass(frozen=True)
class SideInformation:
    """A parameter measured elsewhere, used as a normal prior: mean and sd in the internal unit."""

    _repr_html_ = record_card

    mean: float
    sd: float

    def __post_init__(self) -> None:
        if not (np.isfinite(self.mean) and self.sd > 0):
            raise CampaignError(
                "side information must be finite with a positive spread, "
                f"got {self.mean} +- {self.sd}"
            )


class Tie(NamedTuple):
    """The lag or volume ``name`` is ``factor`` times ``to``; both are flat names."""

    name: str
    to: str
    factor: float


@dataclass(frozen=True, eq=False)
class Campaign:
    """Step experiments on one rig with one sensor.

    Raises
    ------
    CampaignError
        If there is no experiment, two share a name or ``sensor_is`` is none of :data:`ORDERS`.
    """

    title: str
    experiments: tuple[Experiment, ...]
    side_information: Mapping[str, SideInformation] = field(default_factory=dict)
    """keyed by flat parameter name, e.g. ``V_mL``"""
    signal_unit: str = "V"
    warnings: tuple[str, ...] = ()
    """what the reader noticed, in sentences"""
    source: str = ""
    sensor_is: str = "unknown"
    """``faster`` or ``slower`` than the valve where the user says so, else ``unknown``: lags in a
    row commute, so the data give their values and not their names"""
    stages: tuple[str, ...] = STAGES
    """what the gas passes, in order, as ``[rig] stages`` has them"""
    ties: tuple[Tie, ...] = ()
    """lags and volumes that are another one, or a multiple of it
    (:func:`bayes_sensor.rig.ties.tie_parameters`)"""
    coating: str = ""
    """``zif8`` where the sensor has the published coating: then tau is compared with its diffusion,
    and the report with what was published"""

    def __post_init__(self) -> None:
        object.__setattr__(self, "experiments", tuple(self.experiments))
        object.__setattr__(self, "stages", tuple(self.stages))
        if self.sensor_is not in ORDERS:
            raise CampaignError(
                f"{self.source or 'campaign'}: sensor_is must be one of {', '.join(ORDERS)}, but "
                f"is '{self.sensor_is}'; say which of the lags is the sensor's, or 'unknown'"
            )
        if self.coating not in ("", ZIF8):
            raise CampaignError(
                f"{self.source or 'campaign'}: coating must be '{ZIF8}' or left out, but is "
                f"'{self.coating}'; leave it out for any other coating"
            )
        self._check_order()
        if not self.experiments:
            raise CampaignError(f"{self.source or 'campaign'}: expected at least one experiment")
        seen: dict[str, str] = {}
        for name in self.names_of_experiments:
            shown = appearance(name)
            if shown in seen:
                alike = "" if name == seen[shown] else ", or look so"
                raise CampaignError(
                    f"{self.source or 'campaign'}: two experiments are called '{name}'{alike}; "
                    "rename one"
                )
            seen[shown] = name

    def _check_order(self) -> None:
        """Raise CampaignError where side information says the other order than ``sensor_is``."""
        known = self.side_information
        if self.sensor_is == "unknown" or not {"tau_s", "tau_v_s"} <= known.keys():
            return
        tau, tau_v = known["tau_s"], known["tau_v_s"]
        away = (tau.mean - tau_v.mean) / np.hypot(tau.sd, tau_v.sd)
        if (away if self.sensor_is == "faster" else -away) > 3.0:
            raise CampaignError(
                f"{self.source or 'campaign'}: sensor_is is '{self.sensor_is}', but by side "
                f"information tau is {tau.mean:g} +- {tau.sd:g} s and tau_v {tau_v.mean:g} +- "
                f"{tau_v.sd:g} s; expected both to agree: correct one, or leave sensor_is out"
            )

    @classmethod
    def from_frames(cls, frames: Any, **keys: Any) -> Campaign:
        """The campaign of samples that are in memory.

        Parameters
        ----------
        frames
            by the name of their experiment, or a list (names "1", "2", ..): pandas DataFrames (the
            times may be the index), mappings of arrays such as ``{"t": t, "y": y, "drive": d}``,
            tuples ``(t, y)`` or ``(t, y, drive)`` of arrays, or xarray Datasets of one dimension.
            Times are in s, datetimes or durations; columns may say their units, such as
            ``time_ms``.
        keys
            the keys of ``campaign.toml``: those of an experiment (``total_flow`` and
            ``concentration``, or ``carrier_flow`` and ``test_gas_flow``, ``commanded_on``,
            ``commanded_off``, ``signal``, ``drive``, ``signal_unit``, ``time``, ``interval``,
            ``keep``, ``mask``), each for all experiments, a mapping by their names or a list in
            their order (lists such as ``keep`` by mapping only); and ``title``, ``stages``,
            ``sensor_is``, ``tie``, ``side_information``, ``conditions``.  Quantities are texts with
            units or numbers in s and mL/s; ``concentration`` as a number is a share from 0 to 1.

        Raises
        ------
        CampaignError
            As :func:`read_campaign`, with which the checks are shared.

        Examples
        --------
        >>> t = np.arange(2000) * 0.01
        >>> y = np.where(t > 5.0, 1.0 - np.exp(5.0 - t), 0.0) + 0.01 * np.sin(40.0 * t)
        >>> campaign = Campaign.from_frames(
        ...     {"1": (t, y)}, total_flow="4.5 L/min", concentration="20 %", commanded_on=4.8
        ... )
        >>> campaign["1"].total_flow, campaign["1"].commanded_on, campaign["1"].n_samples
        (75.0, 4.8, 2000)
        """
        # imported when called: the readers need this room first
        made: Campaign = import_module("bayes_sensor.io.frames").campaign_from_frames(frames, keys)
        return made

    def __iter__(self) -> Iterator[Experiment]:
        return iter(self.experiments)

    def __len__(self) -> int:
        return len(self.experiments)

    def __getitem__(self, name: str) -> Experiment:
        for experiment in self.experiments:
            if experiment.name == name:
                return experiment
        raise KeyError(f"no experiment '{name}'; there are {', '.join(self.names_of_experiments)}")

    @property
    def names_of_experiments(self) -> list[str]:
        """Names in the campaign's order."""
        return [experiment.name for experiment in self.experiments]

    @property
    def n_samples(self) -> int:
        """Used samples in all experiments."""
        return sum(experiment.n_samples for experiment in self.experiments)

    @property
    def is_design(self) -> bool:
        """Whether any experiment has no data yet."""
        return any(experiment.y is None for experiment in self.experiments)

    @cached_property
    def rounding(self) -> float:
        """V, the largest :attr:`Experiment.rounding`: no noise is told below it."""
        return max(experiment.rounding for experiment in self.experiments)

    @cached_property
    def reference_interval(self) -> float:
        """s, the most common sampling interval (the smaller one at a tie); phi refers to it."""
        intervals = [round(experiment.interval, 12) for experiment in self.experiments]
        return min(set(intervals), key=lambda h: (-intervals.count(h), h))

    @cached_property
    def reference_concentration(self) -> float:
        """c_ref, the highest test-gas fraction in the campaign."""
        return max(experiment.concentration for experiment in self.experiments)

    @property
    def concentrations_before(self) -> tuple[float, ...]:
        """Of the experiment listed before each one; 0 for the first, before which none is known."""
        return (0.0, *(experiment.concentration for experiment in self.experiments[:-1]))

    @property
    def same_flow(self) -> bool:
        """Whether all experiments share one total flow: then tau_v and V cannot be told apart.

        Flows that are not given do not differ.
        """
        if not self.flows_known:
            return True
        flows = np.array([experiment.total_flow for experiment in self.experiments])
        return bool(np.ptp(flows) <= 1e-6 * flows.max())

    @property
    def flows_known(self) -> bool:
        """Whether the flows of all experiments are given."""
        return all(e.flow_known for e in self.experiments)

    @property
    def same_interval(self) -> bool:
        """Whether all experiments are sampled at one interval, but for rounding."""
        intervals = np.array([experiment.interval for experiment in self.experiments])
        return bool(np.ptp(intervals) < 1e-9 * intervals.max())

    def __repr__(self) -> str:
        """The experiments, a line each."""
        return "\n  ".join([f"Campaign({self.title!r}:", *map(repr, self.experiments)]) + ")"

    def _repr_html_(self) -> str:
        """What a notebook shows of it."""
        rows = [
            [
                e.name, e.n_samples, 1e3 * e.interval, len(e.t) * e.interval, 0.06 * e.total_flow,
                100.0 * e.concentration, e.commanded_on, e.commanded_off,
                "planned" if e.y is None else e.source,
            ]
            for e in self.experiments
        ]  # fmt: skip
        columns = ["experiment", "samples", "interval (ms)", "length (s)", "flow (L/min)",
                   "test gas (%)", "on (s)", "off (s)", "file"]  # fmt: skip
        return card(self.title, self.warnings, columns, rows)

    def without(self, name: str) -> Campaign:
        """The campaign with one experiment left out."""
        self[name]
        left = tuple(e for e in self.experiments if e.name != name)
        return replace(self, experiments=left)

    def with_data(self, values: Mapping[str, FloatArray]) -> Campaign:
        """The campaign with the measurement of each named experiment replaced."""
        replaced = tuple(
            replace(e, y=np.asarray(values[e.name], dtype=float)) if e.name in values else e
            for e in self.experiments
        )
        return replace(self, experiments=replaced)


def not_a_campaign(given: Any, expected: str = "a Campaign") -> CampaignError:
    """The error where something else is given."""
    return CampaignError(
        f"campaign: expected {expected}, but got a {type(given).__name__}; read a campaign.toml "
        "with read_campaign, or make one of data in memory with Campaign.from_frames"
    )
