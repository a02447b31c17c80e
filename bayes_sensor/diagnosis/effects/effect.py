"""What an effect is: a cause of misfit with its parameters, and how it changes the rig.

An effect is one file in :mod:`bayes_sensor.diagnosis.effects`, or one function of a user's own
(:func:`own_effect`).  It has one or several *forms* - a drift may be common to all experiments or
different in each - and every form declares its strengths with their prior spread.  A form either
changes settings of the rig (:data:`bayes_sensor.rig.perturbed.SETTINGS`) or computes the mean
itself.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from math import exp, log
from typing import TYPE_CHECKING, Any

import numpy as np

from bayes_sensor.campaign import CampaignError, Experiment, FloatArray
from bayes_sensor.rig.perturbed import SETTINGS

if TYPE_CHECKING:
    pass

KINDS = ("normal", "log_normal")
NEAR = 3.0
"""spreads from the centre within which an effect of one's own must have a mean"""


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
    kind: str
    centre: float
    sd: float
    per_experiment: bool = False
    limits: tuple[float, float] = (-np.inf, np.inf)
    """values outside are moved to the nearer limit"""
    scaled: bool = False
    """an amplitude whose plausible size is itself uncertain: its evidence is averaged over
    spreads a third, one and three times as wide"""
    alike: float = 0.0
    """correlation, between experiments, of a strength that each has for itself: what happens to all
    records of a day is of one sign and size rather than not"""

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


@dataclass(frozen=True)
class Setting:
    """What a form may know of an experiment and its campaign when it sets the rig."""

    experiment: Experiment
    t0: float
    """s, when the response begins"""
    tf: float
    """s, when it begins to fall; the end of the record where no fall was recorded"""
    time_scale: float
    """s, of the slower of valve and manifold, from the fit without effects"""
    reference_flow: float
    """mL/s, median of the campaign's total flows"""
    signal_scale: float
    """V, median step height of the campaign"""
    duration: float
    """s, median record length"""
    concentration_before: float = 0.0
    """of the experiment that the campaign lists before this one; 0 for the first of all"""


def spread_of_times(name: str) -> Strength:
    """By how much half of what is spread over several time constants is slower or faster."""
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


class RigView:
    """The rig of one experiment as a user's own effect sees it."""

    def __init__(
        self,
        setting: Setting,
        y0: float,
        beta: float,
        mean: Callable[[FloatArray, Mapping[str, float]], FloatArray],
        response: Callable[[FloatArray, Mapping[str, float]], FloatArray],
    ) -> None:
        self.setting, self.y0, self.beta = setting, y0, beta
        self.experiment = setting.experiment
        self.t0, self.tf = setting.t0, setting.tf
        self._mean, self._response = mean, response

    def mean(self, t: FloatArray, **settings: float) -> FloatArray:
        """V (n_t,), the mean of the rig with these settings changed."""
        return self._mean(t, settings)

    def response(self, t: FloatArray, **settings: float) -> FloatArray:
        """x3 (n_t,), 0 to 1, of the rig with these settings changed."""
        return self._response(t, settings)


@dataclass(frozen=True)
class Effect:
    """A cause of misfit that the diagnosis can name."""

    name: str
    family: str
    """effects of one family leave nearly the same residual"""
    sentence: str
    """the verdict in plain words; may hold ``{strength}``"""
    forms: tuple[Form, ...]
    plausible: Mapping[str, float]
    """strengths of a rig with this fault, for simulation and for what may hide"""
    reference: str
    reveal: str
    """the measurement that shows it"""
    on_mean: bool = True
    """whether it changes the mean; otherwise it acts on the noise and has its own test"""
    null: Mapping[str, float] = field(default_factory=dict)
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

    @property
    def nameless(self) -> Effect:
        """The effect where nobody knows whose the lags are: its counterpart may be the cause."""
        return replace(self, same_response=self.same_response or self.exchanged)

    def __post_init__(self) -> None:
        if self.on_mean and not self.forms:
            raise CampaignError(f"effect {self.name}: expected at least one form")


def check_settings(effect: str, settings: Mapping[str, float]) -> None:
    """Raise CampaignError where an effect names a setting that the rig does not have."""
    for name in settings:
        if name not in SETTINGS:
            import difflib

            close = difflib.get_close_matches(name, SETTINGS, n=1)
            hint = f"did you mean '{close[0]}'?" if close else f"known are {', '.join(SETTINGS)}"
            raise CampaignError(f"effect {effect}: the rig has no setting '{name}'; {hint}")


def own_effect(
    name: str,
    strengths: Iterable[Strength],
    mean: Callable[[FloatArray, Mapping[str, float], RigView], FloatArray],
    *,
    plausible: Mapping[str, float],
    family: str | None = None,
    sentence: str | None = None,
    starts: Iterable[Mapping[str, float]] | None = None,
    reference: str = "user's own",
) -> Effect:
    """An effect from one function ``mean(t, strength, rig) -> V``.

    ``t`` (n_t,) s is sorted; ``strength`` maps the names of ``strengths`` to values; ``rig``
    (:class:`RigView`) gives ``mean``, ``response``, ``y0``, ``beta``, ``t0``, ``tf`` and the
    ``experiment``.  The function must be smooth in the strengths and take any sorted times.
    ``plausible``: strengths of a rig with this fault.  ``starts``: strengths from which fits
    begin, the others at their centres; where none are given and there are several strengths, those
    that are 0 at their centre begin one spread to either side.

    >>> leak = own_effect(
    ...     "leak", [Strength("leak_V", "V", "normal", 0.0, 0.02)],
    ...     lambda t, s, rig: rig.mean(t) + s["leak_V"] * (t > rig.t0), plausible={"leak_V": 0.02},
    ... )
    >>> leak.family
    'leak'

    Raises
    ------
    CampaignError
        For a name that cannot be one, without a strength, and where ``plausible`` or ``starts``
        name a strength that is not there.  A diagnosis raises it where the function stops or
        returns something else than finite voltages.
    """
    fixed = tuple(strengths)
    if not name.isidentifier() or name in ("none", "unlisted"):
        # tables write a+b for two effects at once
        raise CampaignError(
            f"effect '{name}': expected a name of letters, digits and underscores that is not "
            "'none' or 'unlisted'; rename it"
        )
    if not fixed:
        raise CampaignError(f"effect {name}: expected at least one strength")
    begun = _default_starts(fixed) if starts is None else tuple(starts)
    for where, given in (("plausible", plausible), *(("starts", start) for start in begun)):
        _check_strengths(name, where, given, fixed)
    form = Form(
        strengths=lambda _: fixed,
        settings=lambda _values, _setting: {},
        starts=begun,
        mean=_Checked(name, fixed, mean),
    )
    return Effect(
        name=name,
        family=family or name,
        sentence=sentence or f"The effect '{name}' explains what the model misses.",
        forms=(form,),
        plausible=plausible,
        reference=reference,
        reveal="an experiment in which this effect is switched off",
    )


def _default_starts(strengths: Sequence[Strength]) -> tuple[Mapping[str, float], ...]:
    """At the centres; of several strengths those that are 0 there one spread to either side.

    Where an amplitude is 0 the data say nothing of a place or a width.
    """
    zero = [s for s in strengths if s.value(0.0) == 0.0]
    if len(strengths) < 2 or not zero:
        return ({},)
    sides = [{s.name: s.value(side) for s in zero} for side in (1.0, -1.0)]
    return tuple(side for side in sides if any(side.values()))


def _check_strengths(
    effect: str, where: str, given: Mapping[str, Any], strengths: Sequence[Strength]
) -> None:
    known = [s.name for s in strengths]
    for name, value in given.items():
        if (name.rstrip("*") if where == "starts" else name) not in known:
            raise CampaignError(
                f"effect {effect}: {where}: expected names of its strengths "
                f"({', '.join(known)}), but got '{name[:80]}'; correct it"
            )
        if not isinstance(value, int | float | np.number) or not np.isfinite(value):
            raise CampaignError(
                f"effect {effect}: {where}: expected a number for {name}, but got {value}; "
                "correct it"
            )


@dataclass(frozen=True)
class _Checked:
    """A user's own mean, which tells what is wrong with it rather than spoil the fit."""

    effect: str
    strengths: tuple[Strength, ...]
    function: Callable[[FloatArray, Mapping[str, float], RigView], FloatArray]

    def __call__(self, t: FloatArray, values: Mapping[str, float], rig: RigView) -> FloatArray:
        """V (n_t,), the function's; CampaignError where one is not finite."""
        with np.errstate(all="ignore"):  # what comes of it is told below
            found = np.asarray(self.function(t, values, rig), dtype=float)
        bad = ~np.isfinite(found)
        # others tell of a wrong shape
        if found.shape == np.shape(t) and bad.any() and self._likely(values):
            i = int(np.argmax(bad))
            at = ", ".join(f"{s.name} = {values[s.name]:.4g}" for s in self.strengths)
            raise CampaignError(
                f"effect {self.effect}: expected finite voltages from its function, but got "
                f"{found[i]} at t = {t[i]:.10g} s of experiment '{rig.experiment.name}' with {at}; "
                "correct it"
            )
        return found

    def _likely(self, values: Mapping[str, float]) -> bool:
        """Whether all strengths are near their centres: a fit on its way may try any others."""
        return all(abs(s.coordinate(values[s.name])) <= NEAR for s in self.strengths)
