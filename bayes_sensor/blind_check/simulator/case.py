"""What a simulated campaign is made of: the rig, its step experiments, its noise, its faults.

Seconds, volts and mL/s throughout.  All records turn into plain JSON and back.
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field
from typing import Any

from pydantic import TypeAdapter, ValidationError

from bayes_sensor.campaign import CampaignError

MOST_SAMPLES = 50_000_000


PUBLISHED = ("valve", "manifold", "sensor")
"""what the gas passes on the published rig"""


@dataclass(frozen=True)
class Switch:
    """One change of what the valve is told."""

    commanded: float
    """s"""
    at: float
    """s, when the gas really begins to follow"""
    level: float
    """from then on, 1 is open"""


@dataclass(frozen=True)
class Step:
    """One step experiment: how it is set up and what really happens."""

    name: str
    carrier_flow: float
    """mL/s"""
    test_gas_flow: float
    """mL/s"""
    interval: float
    """s"""
    duration: float
    """s"""
    commanded_on: float
    commanded_off: float
    t0: float
    """s, when the gas really begins to switch on"""
    tf: float
    """s, when it begins to switch off"""
    y0: float
    """V"""
    beta: float
    """V, plateau above baseline"""
    programme: tuple[Switch, ...] = ()
    """switches in order, where they are more than one on and off; ``commanded_on`` and ``t0`` are
    then those of the first, ``commanded_off`` and ``tf`` those of the last"""
    shared_delays: bool = False
    """whether one delay holds for all switches up, and one for all switches down"""

    @property
    def switches(self) -> tuple[Switch, ...]:
        """All switches, in order."""
        pulse = (
            Switch(self.commanded_on, self.t0, 1.0),
            Switch(self.commanded_off, self.tf, 0.0),
        )
        return self.programme or pulse

    @property
    def total_flow(self) -> float:
        """mL/s, as set."""
        return self.carrier_flow + self.test_gas_flow

    @property
    def concentration(self) -> float:
        """Test-gas fraction, as set."""
        return self.test_gas_flow / self.total_flow

    @property
    def n_samples(self) -> int:
        """How many samples are recorded."""
        return round(self.duration / self.interval)


@dataclass(frozen=True)
class Component:
    """One part of the noise: its share of the variance, its correlation, its shape.

    ``time`` 0 is white; otherwise the autocorrelation is ``exp(-lag/time) cos(2 pi frequency lag)``
    unless the shape says something else.  The shapes:

    ``gauss``
        An Ornstein-Uhlenbeck process; a damped oscillation where ``frequency`` is not 0.
    ``smooth``
        White noise through two equal lags: ``exp(-lag/time) (1 + lag/time)``.
    ``telegraph``
        Two levels, with random changes from one to the other.
    ``shot``
        One-sided pulses of exponential heights, ``rate`` of them in a ``time``.
    ``gusts``
        Variance that jumps between 1 - ``depth`` and 1 + ``depth``; the correlation of the jumps
        lasts ``gust_time``.
    ``drilled``
        Louder for the share ``rate`` of a record, in one stretch; variance 1 - ``depth`` elsewhere.
    ``turbulent``
        A spectrum that falls as f^(-5/3) above the corner 1/(2 pi ``time``).
    ``settling``
        Long memory: levels that last the longer, the longer they have lasted;
        ``(1 + lag/time)^-depth``.
    ``counts``
        Poisson counts in each sample, ``rate`` in the mean (white).
    ``retuned``
        An Ornstein-Uhlenbeck process with another time in each record, between ``depth`` times
        ``time`` and ``time``.
    ``calming``
        Loud when the record begins: variance in proportion to ``1 - depth + depth exp(-rate i/n)``
        at sample i of n, with a mean of 1.
    ``speckle``
        The product of two independent Ornstein-Uhlenbeck processes, each with 2 ``time``.
    ``shaped``
        White noise less ``depth`` times the sample before: neighbours correlate negatively.
    """

    share: float
    time: float = 0.0
    """s"""
    frequency: float = 0.0
    """Hz"""
    shape: str = "gauss"
    rate: float = 0.0
    depth: float = 0.0
    gust_time: float = 0.0
    """s"""


@dataclass(frozen=True)
class NoiseLaw:
    """Noise ``s_i z_i`` with z the sum of ``components`` and s^2 = sigma0^2 + sigma1^2 (c/c_max) x.

    x is the sensor's normalised response; the shares of the components add up to 1.
    """

    name: str
    sigma0: float
    """V"""
    sigma1: float = 0.0
    """V, extra at the highest concentration of the campaign"""
    components: tuple[Component, ...] = (Component(1.0),)

    @property
    def is_ar1(self) -> bool:
        """Whether one Ornstein-Uhlenbeck or white component makes all of it."""
        first = self.components[0]
        return len(self.components) == 1 and first.frequency == 0.0 and first.shape == "gauss"


@dataclass(frozen=True)
class Case:
    """A campaign to be simulated.

    ``strengths`` turns causes on by name (see ``CAUSES``); what is not named is off.  ``seed``
    decides everything random: the noise, and what a cause draws for itself.
    """

    seed: int
    tau: float
    """s, sensor"""
    tau_v: float
    """s, valve"""
    V: float
    """mL, manifold"""
    steps: tuple[Step, ...]
    noise: NoiseLaw
    strengths: Mapping[str, float] = field(default_factory=dict)
    lsb: float = 0.0
    """V, step of the recorder; 0 records doubles"""
    title: str = "simulated rig"
    stages: tuple[str, ...] = PUBLISHED
    """what the gas passes, in order; ``tau_v`` or ``V`` of what is not there is a scale only"""
    flows_told: bool = True
    """whether the record says the flows"""

    def __post_init__(self) -> None:
        object.__setattr__(self, "steps", tuple(self.steps))
        object.__setattr__(self, "strengths", dict(self.strengths))
        object.__setattr__(self, "stages", tuple(self.stages))
        if not self.steps or min(self.tau, self.tau_v, self.V) <= 0:
            raise CampaignError(
                "case: expected at least one experiment and positive tau, tau_v and V, got "
                f"{len(self.steps)} experiments, {self.tau} s, {self.tau_v} s, {self.V} mL"
            )

    @property
    def highest_concentration(self) -> float:
        """The highest test-gas fraction among the experiments."""
        return max(step.concentration for step in self.steps)

    def relative_concentration(self, step: Step) -> float:
        """The experiment's test-gas fraction over the campaign's highest."""
        return step.concentration / self.highest_concentration

    @property
    def has_valve(self) -> bool:
        """Whether the gas passes a valve with a lag."""
        return "valve" in self.stages

    @property
    def volume(self) -> str:
        """Name of the volume that the gas sweeps; empty where there is none."""
        return next((name for name in self.stages if name not in ("valve", "sensor")), "")

    @property
    def is_published(self) -> bool:
        """Whether the rig is a valve, a manifold and a sensor, and all records are pulses."""
        return self.stages == PUBLISHED and not any(step.programme for step in self.steps)

    @property
    def mean_step(self) -> float:
        """V, the mean height of the campaign's steps."""
        return sum(abs(step.beta) for step in self.steps) / len(self.steps)

    def to_json(self) -> dict[str, Any]:
        """Plain values; ``rate``, ``depth`` and ``gust_time`` of the noise only where not 0, and
        what is said of other rigs only on these."""
        content = asdict(self)
        if self.is_published:
            del content["stages"], content["flows_told"]
        for step in content["steps"]:
            if not step["programme"]:
                del step["programme"], step["shared_delays"]
        for part in content["noise"]["components"]:
            for name in ("rate", "depth", "gust_time"):
                if part[name] == 0.0:
                    del part[name]
        return content

    @classmethod
    def from_json(cls, content: Mapping[str, Any]) -> Case:
        """The record that :meth:`to_json` wrote; CampaignError for anything else."""
        try:
            case = TypeAdapter(cls).validate_json(json.dumps(content, allow_nan=False), strict=True)
            n = sum(step.n_samples for step in case.steps)
        except (ValidationError, ArithmeticError, TypeError, ValueError) as error:
            raise CampaignError(
                "recipe: expected that of a simulated campaign, but got another "
                f"({' '.join(str(error).split())[:160]}); draw the cases again"
            ) from None
        if not 0 < n <= MOST_SAMPLES:
            raise CampaignError(
                f"recipe: expected at most {MOST_SAMPLES} samples, but got {n}; draw cases again"
            )
        return case
