"""Experiments: what was measured in one record, with units settled.

Everything here is in seconds, volts (or the campaign's ``signal_unit``) and mL/s.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from bayes_sensor.display import record_card

FloatArray = NDArray[np.float64]
BoolArray = NDArray[np.bool_]


class CampaignError(ValueError):
    """Input that cannot be used.  The message says where, what was expected, what came, the fix."""


MOST_JITTER = 0.3
"""of the interval: where a time is further than this from its place on a grid, the sampling is
irregular"""
MOST_OFF = 0.05
"""share by which the interval of irregular sampling may differ from the median step"""


def counted(n: int, noun: str) -> str:
    """The number with its noun.

    >>> counted(1, "experiment"), counted(7, "experiment")
    ('1 experiment', '7 experiments')
    """
    return f"{n} {noun}{'' if n == 1 else 's'}"


FREE_SWITCHES = 4
"""switches in a record up to which each has a time of its own unless the campaign says otherwise"""


def check_rising(times: FloatArray, where: str = "") -> None:
    """Raise CampaignError if one of ``times`` (n,) s does not follow the one before it.

    ``where``: words that begin the message.
    """
    late = np.flatnonzero(np.diff(times) <= 0.0)
    if late.size:
        i = int(late[0])
        raise CampaignError(
            f"{where}times must rise, but time {i + 2} ({times[i + 1]:.10g} s) follows time "
            f"{i + 1} ({times[i]:.10g} s); put them in order and drop repeated ones"
        )


def runs_of(flags: BoolArray) -> NDArray[np.int64]:
    """(n_runs, 2) start and end (exclusive) of each stretch of ``flags`` (n,) that are True.

    >>> runs_of(np.array([True, True, False, True])).tolist()
    [[0, 2], [3, 4]]
    """
    edges = np.flatnonzero(np.diff(np.concatenate(([False], flags, [False])).astype(np.int8)))
    return edges.reshape(-1, 2).astype(np.int64)


@dataclass(frozen=True, eq=False)
class Commands:
    """What was done to the gas in a record that is more than one step up and one down.

    Either a programme of switches, or a recorded channel that is the input itself.

    Raises
    ------
    CampaignError
        If times do not rise, a level is not finite, levels are not as many as times or all are
        the same, or ``delays`` is unknown.
    """

    times: FloatArray
    """(n,) s, rising: commanded times of the switches, or times of the recorded samples"""
    levels: FloatArray
    """(n,) input after each switch, or at each sample; 1 is the record's highest"""
    rest: float = 0.0
    """input before the first switch"""
    delays: str = "free"
    """``free``: each switch has a time of its own; ``shared``: one delay for all switches up, one
    for all switches down"""
    recorded: bool = False
    """whether the levels are a recorded input, with ramps between its samples"""

    def __post_init__(self) -> None:
        times = np.ascontiguousarray(self.times, dtype=float)
        levels = np.ascontiguousarray(self.levels, dtype=float)
        if times.ndim != 1 or times.shape != levels.shape or len(times) < 1 + self.recorded:
            raise CampaignError(
                "commands: expected as many levels as times, got shapes "
                f"{times.shape} and {levels.shape}; give each switch both"
            )
        for label, values in (("time", times), ("level", levels)):
            if not np.isfinite(values).all():
                i = int(np.argmin(np.isfinite(values)))
                raise CampaignError(f"commands: {label} {i + 1} is {values[i]}; expected a number")
        check_rising(times, "commands: ")
        if self.delays not in ("free", "shared"):
            raise CampaignError(
                f"delays: expected 'free' or 'shared', but got '{self.delays}'; correct it"
            )
        steps = np.diff(levels, prepend=levels[0] if self.recorded else self.rest)
        if self.recorded and not steps.any():
            raise CampaignError(
                f"input: all samples are {levels[0]:g}; expected an input that changes: choose "
                "another channel"
            )
        if not self.recorded and not steps.all():
            i = int(np.argmin(np.abs(steps)))
            raise CampaignError(
                f"steps: step {i + 1} goes to the level that the input has already; leave it out"
            )
        object.__setattr__(self, "times", times)
        object.__setattr__(self, "levels", levels)

    @property
    def heights(self) -> FloatArray:
        """(n,) change of the input at each switch."""
        return np.diff(self.levels, prepend=self.rest)


@dataclass(frozen=True, eq=False)
class Experiment:
    """One step experiment, sampled uniformly or at times of its own.

    Raises
    ------
    CampaignError
        If the arrays disagree in length, a flow is not positive, the interval is not positive and
        finite, times do not increase strictly, the step down is not commanded after the step up, a
        used sample is not finite or no sample is used.
    """

    _repr_html_ = record_card

    name: str
    """what parameters and messages call it: ``t0_s[name]``"""
    t: FloatArray
    """(n_t,) s, increasing; where :attr:`regular`, ``t[i] = t[0] + i * interval``."""
    y: FloatArray | None
    """(n_t,) in the campaign's ``signal_unit``, or None for a design (an experiment that is planned
    but not measured)"""
    carrier_flow: float | None
    """mL/s, or None where it is not known"""
    test_gas_flow: float | None
    """mL/s, or None where it is not known"""
    interval: float
    """s, sampling interval; where the sampling is irregular, the median step"""
    commanded_on: float | None = None
    """s, when the valve was told to open, or None when unknown"""
    commanded_off: float | None = None
    """s, when the valve was told to shut; None when no step down was recorded"""
    mask: BoolArray | None = None
    """(n_t,) True where the sample is used; None means all"""
    drive: FloatArray | None = None
    """(n_t,) the valve's recorded drive signal in any unit, or None"""
    source: str = ""
    """the file the samples came from, for messages"""
    sha256: str = ""
    """hash of that file, for the record"""
    commands: Commands | None = None
    """the programme of the input, where it is more than the one pulse of ``commanded_on`` and
    ``commanded_off``"""
    record: str = ""
    """name of the record, where several sensors were recorded together; they share its switches"""
    sensor: str = ""
    """which sensor of several this is"""

    def __post_init__(self) -> None:
        where = f"experiment '{self.name}'" + (f" ({self.source})" if self.source else "")
        n_t = len(self.t)
        if n_t < 2:
            raise CampaignError(f"{where}: expected at least 2 samples, got {n_t}; record longer")
        if not 0 < self.interval < np.inf:
            raise CampaignError(
                f"{where}: expected a positive sampling interval, got {self.interval} s"
            )
        self._check_times(where)
        for label, flow, least in (
            ("carrier_flow", self.carrier_flow, 0.0),
            ("test_gas_flow", self.test_gas_flow, 0.0),
        ):
            if flow is not None and (not np.isfinite(flow) or flow <= least):
                raise CampaignError(
                    f"{where}: {label} must be a positive flow, but is {flow * 0.06:g} L/min; "
                    "give the flow that was set"
                )
        if (self.carrier_flow is None) != (self.test_gas_flow is None):
            got, lacks = "carrier_flow", "test_gas_flow"
            if self.carrier_flow is None:
                got, lacks = lacks, got
            raise CampaignError(
                f"{where}: got {got} alone; expected both flows, or neither where no stage needs "
                f'them: add {lacks} = "4.0 L/min" with the value that was set'
            )
        if self.commands is not None and self.commanded_on is None and not self.commands.recorded:
            object.__setattr__(self, "commanded_on", float(self.commands.times[0]))
        if self.mask is None:
            object.__setattr__(self, "mask", np.ones(n_t, dtype=bool))
        for label, array in (("y", self.y), ("mask", self.mask), ("drive", self.drive)):
            if array is not None and array.shape != (n_t,):
                raise CampaignError(
                    f"{where}: {label} has shape {array.shape}, expected ({n_t},) like t"
                )
        if not self.used.any():
            raise CampaignError(f"{where}: no sample is left to use; widen keep or drop the mask")
        if self.y is not None and not np.isfinite(self.y[self.used]).all():
            raise CampaignError(
                f"{where}: a sample that is used is not finite; mask it or repair the file"
            )

    def _check_times(self, where: str) -> None:
        t, on, off = np.asarray(self.t, dtype=float), self.commanded_on, self.commanded_off
        if not np.isfinite(t).all():
            i = int(np.argmin(np.isfinite(t)))
            raise CampaignError(
                f"{where}: t[{i}] is {t[i]}; expected a time in s for every sample, and a mask for "
                "those not to be used"
            )
        falls = np.diff(t) <= 0
        if falls.any():
            i = int(np.argmax(falls)) + 1
            raise CampaignError(
                f"{where}: t[{i}] is {t[i]:.10g} s and follows {t[i - 1]:.10g} s; expected times "
                "that increase strictly: sort the samples, and leave repeated ones out"
            )
        median = float(np.median(np.diff(t)))
        if not self.regular and abs(self.interval / median - 1.0) > MOST_OFF:
            raise CampaignError(
                f"{where}: interval is {self.interval:.10g} s, but the times are {median:.10g} s "
                "apart (median); expected both to agree: correct the interval"
            )
        for label, value in (("commanded_on", on), ("commanded_off", off)):
            if value is not None and not np.isfinite(value):
                raise CampaignError(
                    f"{where}: {label} is {value}; expected a time in s, or None where it is not "
                    "known"
                )
        if on is not None and off is not None and not on < off:
            raise CampaignError(
                f"{where}: commanded_off = {off:.10g} s is not after commanded_on = {on:.10g} s; "
                "expected on before off: swap or correct them"
            )

    def __repr__(self) -> str:
        """One line, without the samples."""
        what = "planned" if self.y is None else f"{self.n_samples} samples used"
        about = "" if self.regular else "about "
        flow = "flow unknown"
        if self.flow_known:
            flow = f"{self.total_flow * 0.06:.4g} L/min, {100 * self.concentration:.3g} % test gas"
        return f"Experiment({self.name!r}: {what}, one every {about}{self.interval:.4g} s, {flow})"

    @cached_property
    def regular(self) -> bool:
        """Whether the samples lie on a uniform grid, each within :data:`MOST_JITTER` of it."""
        away = np.abs(self.t - self.t[0] - self.interval * np.arange(len(self.t)))
        return bool(away.max() <= MOST_JITTER * self.interval)

    @property
    def used(self) -> BoolArray:
        """(n_t,) True where the sample is used."""
        assert self.mask is not None  # set in __post_init__
        return self.mask

    @property
    def flow_known(self) -> bool:
        """Whether the flows are given."""
        return self.carrier_flow is not None

    @property
    def total_flow(self) -> float:
        """Q = Q_N2 + Q_CO2 (paper eq. 1), mL/s; nan where it is not known."""
        if self.carrier_flow is None or self.test_gas_flow is None:
            return np.nan
        return self.carrier_flow + self.test_gas_flow

    @property
    def concentration(self) -> float:
        """Test-gas fraction Q_CO2 / Q, between 0 and 1; 1 where no flow is known."""
        return 1.0 if self.test_gas_flow is None else self.test_gas_flow / self.total_flow

    def with_flow(self, factor: float) -> Experiment:
        """The same at ``factor`` times its total flow, where that is known."""
        if self.carrier_flow is None or self.test_gas_flow is None:
            return self
        return replace(
            self,
            carrier_flow=factor * self.carrier_flow,
            test_gas_flow=factor * self.test_gas_flow,
        )

    @property
    def record_name(self) -> str:
        """Name of the record: the experiment's own, unless several sensors share one."""
        return self.record or self.name

    @property
    def has_fall(self) -> bool:
        """Whether a step down was recorded, so that ``tf`` exists."""
        return self.commanded_off is not None

    @property
    def n_samples(self) -> int:
        """How many samples are used."""
        return int(self.used.sum())

    @property
    def values(self) -> FloatArray:
        """(n_t,) V, the measurement; raises CampaignError for a design."""
        if self.y is None:
            raise CampaignError(
                f"experiment '{self.name}': this is a design without data; "
                "expected a measured (or simulated) experiment"
            )
        return self.y

    @property
    def rounding(self) -> float:
        """V, what a float as large as the largest used sample is rounded to; of 1 V where all
        samples are zero."""
        return float(np.finfo(float).eps * (np.abs(self.values[self.used]).max() or 1.0))

    @cached_property
    def runs(self) -> NDArray[np.int64]:
        """(n_runs, 2) start and end (exclusive) index of each stretch of used samples."""
        return runs_of(self.used)

    @cached_property
    def places(self) -> FloatArray:
        """(n_t,) sampling intervals from the first sample to each: 0, 1, .. where regular."""
        if self.regular:
            return np.arange(len(self.t), dtype=float)
        return np.asarray((self.t - self.t[0]) / self.interval)

    @cached_property
    def even_runs(self) -> NDArray[np.int64]:
        """(n_even, 2) as :attr:`runs`, of samples that are one interval apart.

        Where the sampling is irregular each used sample is a run of its own.
        """
        if self.regular:
            return self.runs
        places = np.flatnonzero(self.used)
        return np.stack([places, places + 1], axis=1).astype(np.int64)

    @cached_property
    def pauses(self) -> FloatArray:
        """(n_even,) sampling intervals from the last used sample to the start of each even run.

        A noise with coefficient phi over one interval has phi^pause across it.  The first is 0.
        """
        starts, ends = self.even_runs[1:, 0], self.even_runs[:-1, 1] - 1
        return np.concatenate(([0.0], self.places[starts] - self.places[ends]))
