"""What an effect is: a cause of misfit, how it changes the rig, and how it changes the noise.

An effect is one file in :mod:`bayes_sensor.diagnosis.effects`, or one function of a user's own
(:func:`~bayes_sensor.diagnosis.effects.user_effects.own_effect`).  On the mean it acts by one or
several *forms*: a drift, for example, may be common to all experiments or different in each.  Every
form declares its strengths with their prior spread, and either changes settings of the rig
(:data:`bayes_sensor.rig.imperfections.SETTINGS`) or computes the mean itself.  On the noise it acts
by an :class:`OnNoise`, which holds its detector, too.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping
from dataclasses import dataclass, field, replace
from math import exp, log

import numpy as np

from bayes_sensor.campaign import CampaignError, FloatArray
from bayes_sensor.diagnosis.closed_fraction import Closure
from bayes_sensor.diagnosis.effects.rig_view import RigView
from bayes_sensor.diagnosis.effects.setting import Setting
from bayes_sensor.diagnosis.signals.signal import Finding, Samples, Signal

KINDS = ("normal", "log_normal")
PUBLISHED_SCALES = (0.8577, 1.88, 120.0)
"""s, V, s: time constant, step height and record length that plausible strengths are for"""


@dataclass(frozen=True)
class Strength:
    """One parameter of an effect: its unit and how large it plausibly is.

    ``normal``: centre + sd q; ``log_normal``: centre exp(sd q); q is the standard coordinate in
    which fits and evidences are computed.

    >>> Strength("closing_ratio", "1", "log_normal", 1.0, 0.25).value(0.0)
    1.0
    """

    name: str
    unit: str
    """``s``, ``V``, ``V/s``, ``1/V``, ``1/s``, or ``1`` for none; V stands for the signal's unit"""
    kind: str
    """``normal`` or ``log_normal``"""
    centre: float
    """in ``unit``: the mean, or the median of a log-normal one"""
    sd: float
    """in ``unit``, or of the natural logarithm (no unit) of a log-normal one"""
    per_experiment: bool = False
    """whether each experiment has a value of its own, a parameter ``name[experiment]``"""
    limits: tuple[float, float] = (-np.inf, np.inf)
    """lowest and highest value, in ``unit``; values outside are moved to the nearer limit"""
    scaled: bool = False
    """an amplitude whose plausible size is itself uncertain: its evidence is averaged over
    spreads a third, one and three times as wide"""
    alike: float = 0.0
    """correlation (0 to below 1) between experiments of a strength ``per_experiment``: what happens
    to all records of a day is of one sign and size rather than not"""

    def __post_init__(self) -> None:
        if self.kind not in KINDS:
            raise CampaignError(
                f"strength {self.name}: kind must be one of {', '.join(KINDS)}, not '{self.kind}'"
            )
        if not 0.0 <= self.alike < 1.0:
            raise CampaignError(
                f"strength {self.name}: expected a correlation between 0 and 1 (1 excluded), "
                f"got {self.alike:g}"
            )
        if not self.sd > 0 or (self.kind == "log_normal" and not self.centre > 0):
            raise CampaignError(
                f"strength {self.name}: expected a positive spread"
                + (" and a positive centre" if self.kind == "log_normal" else "")
                + f", got {self.centre:g} and {self.sd:g}"
            )

    def value(self, q: float) -> float:
        """The strength at standard coordinate ``q``."""
        low, high = self.limits
        raw = (
            self.centre + self.sd * q
            if self.kind == "normal"
            else (self.centre * exp(min(max(self.sd * q, -60.0), 60.0)))
        )
        return low if raw < low else high if raw > high else raw

    def coordinate(self, value: float) -> float:
        """The standard coordinate of a strength, held within +-8.

        Raises CampaignError for a value that a log-normal strength cannot take.
        """
        if self.kind == "normal":
            q = (value - self.centre) / self.sd
        elif value > 0:
            q = log(value / self.centre) / self.sd
        else:
            raise CampaignError(
                f"{self.name}: expected a positive value in {self.unit}, got {value:g}"
            )
        return min(max(q, -8.0), 8.0)


def spread_of_times(name: str) -> Strength:
    """Factor between the time constants of a process that is spread over several of them."""
    return Strength(name, "1", "log_normal", 3.0, 0.4, limits=(1.01, 30.0))


Settings = Callable[[Mapping[str, float], Setting], Mapping[str, float]]


@dataclass(frozen=True)
class Form:
    """One way in which an effect may act."""

    strengths: Callable[[Setting], tuple[Strength, ...]]
    """the strengths, their priors scaled to the campaign (a ``Setting`` of any experiment)"""
    settings: Settings
    """strengths of one experiment -> settings of the rig"""
    name: str = ""
    weight: float = 1.0
    """prior weight among the forms of the effect"""
    starts: tuple[Mapping[str, float], ...] = ({},)
    """strengths from which fits begin; names ending in ``*``: in units of the time scale, or of
    the step's height"""
    grid: tuple[Mapping[str, float], ...] = ()
    """further starts, of which only those are followed that promise most"""
    mean: Callable[[FloatArray, Mapping[str, float], RigView], FloatArray] | None = None
    """a user's own mean; it may call the rig's"""
    jumps: bool = False
    """whether the mean jumps at the very moment of a switch"""


Values = Mapping[str, float]
"""strengths by name"""


@dataclass(frozen=True)
class OnNoise:
    """How an effect acts on the noise of a record, and how samples tell that it does.

    A simulation draws innovations, colours and scales them, passes the noise through
    :attr:`filtered`, adds the mean and passes the sum through :attr:`record`.
    """

    innovations: Callable[[int, Values, np.random.Generator], FloatArray] | None = None
    """(n,) of unit variance, in place of Gaussian ones"""
    filtered: Callable[[FloatArray, float, Values], FloatArray] | None = None
    """noise (n_t,) V and the sampling interval s -> noise (n_t,) V"""
    record: Callable[[FloatArray, FloatArray, Values, np.random.Generator], FloatArray] | None = (
        None
    )
    """signal (n_t,) V and its times (n_t,) s -> what is recorded (n_t,) V"""
    above: Values = field(default_factory=dict)
    """values that strengths must exceed"""
    reason: str = ""
    """why they must, in words that follow the value"""
    signal: Signal | None = None
    """what tells of it in single samples"""
    closure: Callable[[Samples, Finding], tuple[Closure, float | None]] | None = None
    """how far it closes a gap that is not one of the mean, in sample and held out"""


@dataclass(frozen=True)
class Effect:
    """A cause of misfit that the diagnosis can name.

    It acts on the mean by its forms, on the noise by :attr:`on_noise`, or on both.
    """

    name: str
    family: str
    """effects of one family leave nearly the same residual"""
    sentence: str
    """the verdict in plain words; may hold ``{strength}``"""
    plausible: Values
    """strengths of a rig with this fault, for simulation and for what may hide"""
    reference: str
    reveal: str
    """the measurement that shows it"""
    reveal_with_flows: str = ""
    """the same where the campaign has several total flows already, if that is another"""
    forms: tuple[Form, ...] = ()
    """ways in which it may act on the mean"""
    on_noise: OnNoise | None = None
    """how it acts on the noise"""
    affine: bool = True
    """whether the mean stays linear in y0 and beta; no mean of a user's own counts as such"""
    labels: Mapping[str, str] = field(default_factory=dict)
    """what a strength is called in a sentence, where that is not its name"""
    null: Values = field(default_factory=dict)
    """strengths at which nothing is left of it"""
    same_response: str = ""
    """an effect that no measurement of the response can tell from this one: it is not named
    alone"""
    stage: str = ""
    """what it acts on: ``command``, ``valve``, ``flow``, ``manifold``, ``sensor``, ``readout`` or
    ``record``; where nobody knows which lag is the valve's and which the sensor's, what acts on one
    of the two may be an effect of the other"""
    exchanged: str = ""
    """the effect that this one then is, unless :attr:`same_response` says so anyway"""

    names_rivals: tuple[str, ...] = ()
    """dependences of :mod:`~bayes_sensor.diagnosis.evidence.varying_parameter` that it is: they are
    no unlisted causes while it is in the catalogue"""

    def advice(self, several_flows: bool) -> str:
        """The measurement that shows it, which the campaign does not hold already."""
        return (several_flows and self.reveal_with_flows) or self.reveal

    @property
    def on_mean(self) -> bool:
        """Whether it changes the mean."""
        return bool(self.forms)

    def plausible_on(self, setting: Setting) -> dict[str, float]:
        """Plausible strengths on a rig: times scaled with its time constants, volts with its step.

        The strength of a drift is the change over a record.
        """
        time, volt, duration = (
            own / published
            for own, published in zip(
                (setting.time_scale, setting.signal_scale, setting.duration),
                PUBLISHED_SCALES,
                strict=True,
            )
        )
        scale = {
            "s": time, "V": volt, "1/V": 1.0 / volt, "V/s": volt / duration, "1/s": 1.0 / duration,
        }  # fmt: skip
        units = {s.name: s.unit for s in self.strengths(setting)}
        return {
            name: value * scale.get(units.get(name, "1"), 1.0)
            for name, value in self.plausible.items()
        }

    def form_for(self, names: Collection[str], setting: Setting) -> Form:
        """The form that takes strengths of these names; the first where none or several do."""
        for form, own in self._by_form(setting):
            if own and {s.name for s in own} <= set(names):
                return form
        return self.forms[0]

    def strengths(self, setting: Setting) -> list[Strength]:
        """Those of all its forms, one form after the other."""
        return [s for _, own in self._by_form(setting) for s in own]

    def _by_form(self, setting: Setting) -> list[tuple[Form, tuple[Strength, ...]]]:
        return [(form, form.strengths(setting)) for form in self.forms]

    def units(self, setting: Setting) -> dict[str, str]:
        """Name of every strength -> its unit, those of the noise included."""
        of_noise = self.on_noise.signal.units if self.on_noise and self.on_noise.signal else {}
        return {**of_noise, **{s.name: s.unit for s in self.strengths(setting)}}

    @property
    def nameless(self) -> Effect:
        """The effect where the lags cannot be assigned: its counterpart may be the cause."""
        return replace(self, same_response=self.same_response or self.exchanged)

    def __post_init__(self) -> None:
        if not self.forms and self.on_noise is None:
            raise CampaignError(
                f"effect {self.name}: expected at least one form, or how it acts on the noise"
            )
