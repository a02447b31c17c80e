"""The layout of parameters: names, units, and the flat array beside the nested mapping."""

from __future__ import annotations

import difflib
from collections.abc import Iterable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from functools import cached_property
from math import isclose
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from bayes_sensor.campaign import (
    STAGES,
    Campaign,
    CampaignError,
    FloatArray,
    Tie,
    not_a_campaign,
)
from bayes_sensor.display import record_card
from bayes_sensor.rig.named_values import by_flat_name, number_of
from bayes_sensor.rig.rig import PUBLISHED, Rig
from bayes_sensor.rig.switching import Switching


class Fitted(Protocol):
    """What is needed of a fit."""

    theta_hat: FloatArray


Theta = Mapping[str, Any] | Sequence[float] | FloatArray | Fitted
"""Parameters as the nested mapping of ``fit.json``, as the flat array of :class:`Layout`, or as a
:class:`bayes_sensor.Fit`."""

SHARED = PUBLISHED.names

LOCAL = ("y0_V", "beta_V", "t0_s", "tf_s")

NOISE = ("phi", "sigma0_V", "sigma1_V")

BESIDE = ("signal_unit", "effects")
"""what a ``truth.json`` holds beside parameters"""


@dataclass(frozen=True)
class Layout:
    """Where each parameter stands in the flat vector theta.

    Order: the shared parameters of the rig (``tau_s``, ``tau_v_s``, ``V_mL`` for the published
    one; a ``tau_s`` for each of several sensors); per experiment ``y0_V``, ``beta_V`` and the
    times of its record's switches (``t0_s`` and, where a step down was recorded, ``tf_s``); then
    the noise parameters; then ``extra`` (parameters that effects bring along).  Several sensors
    of one record are experiments of their own here and share its switches.  What is tied to
    another parameter has no place of its own; sensors that all have one lag share ``tau_s``.

    >>> Layout(("a",), (False,)).names
    ['tau_s', 'tau_v_s', 'V_mL', 'y0_V[a]', 'beta_V[a]', 't0_s[a]', 'phi', 'sigma0_V', 'sigma1_V']
    """

    _repr_html_ = record_card

    experiments: tuple[str, ...]
    has_fall: tuple[bool, ...]
    noise_per_experiment: bool = False
    extra: tuple[str, ...] = ()
    rig: Rig = PUBLISHED
    switching: tuple[Switching, ...] = ()
    """of each experiment; where empty, all are pulses"""
    records: tuple[str, ...] = ()
    """name of each experiment's record; where empty, its own"""
    sensors: tuple[str, ...] = ()
    """each experiment's sensor; where empty, there is one"""
    ties: tuple[Tie, ...] = ()
    """lags and volumes that are another one, or a multiple of it"""

    def __post_init__(self) -> None:
        n = len(self.experiments)
        pulses = tuple(map(Switching.pulse, self.has_fall))
        object.__setattr__(self, "switching", self.switching or pulses)
        object.__setattr__(self, "records", self.records or self.experiments)
        object.__setattr__(self, "sensors", self.sensors or ("",) * n)

    @classmethod
    def of(
        cls,
        campaign: Campaign,
        noise_per_experiment: bool = False,
        extra: Iterable[str] = (),
    ) -> Layout:
        """The layout of a campaign's parameters.

        Raises CampaignError where stages are not known, a flow that they need is missing.
        """
        if not isinstance(campaign, Campaign):
            raise not_a_campaign(campaign)
        rig = PUBLISHED if campaign.stages == STAGES else Rig.parse(campaign.stages)
        if rig.needs_flow:
            for e in campaign:
                if not e.flow_known:
                    stage = next(each for each in rig.stages if each.kind.depends_on_flow)
                    raise CampaignError(
                        f"experiment '{e.name}': the stage '{stage.name}' depends on the total "
                        "flow, but none is given; give carrier_flow and test_gas_flow, or leave "
                        "the stage out of [rig] stages"
                    )
        return cls(
            tuple(campaign.names_of_experiments),
            tuple(e.has_fall for e in campaign),
            noise_per_experiment,
            tuple(extra),
            rig,
            tuple(Switching.of(e) for e in campaign),
            tuple(e.record_name for e in campaign),
            tuple(e.sensor for e in campaign),
            campaign.ties,
        )

    @cached_property
    def sensor_names(self) -> tuple[str, ...]:
        """The sensors, each once; one empty name where there is one."""
        return tuple(dict.fromkeys(self.sensors))

    @property
    def sensors_are_named(self) -> bool:
        """Whether a record has several sensors, so that they have names."""
        return self.sensor_names != ("",)

    @cached_property
    def value_names(self) -> tuple[str, ...]:
        """Names of the lags and volumes of all stages, a sensor's own for each sensor; those that
        are tied as well."""
        if not self.sensors_are_named:
            return self.rig.names
        own = [f"{self.rig.names[0]}[{sensor}]" for sensor in self.sensor_names]
        return (*own, *self.rig.names[1:])

    @cached_property
    def sources(self) -> dict[str, tuple[str, float]]:
        """By the name of every lag and volume: the parameter that gives it, and the factor."""
        ties = {tie.name: (tie.to, tie.factor) for tie in self.ties}
        return {name: ties.get(name, (name, 1.0)) for name in self.value_names}

    @cached_property
    def shared_names(self) -> tuple[str, ...]:
        """Names of the parameters that all experiments, or all of one sensor, share."""
        return tuple(dict.fromkeys(source for source, _ in self.sources.values()))

    @cached_property
    def n_own(self) -> int:
        """How many of the shared parameters are lags of one sensor and not of all."""
        return sum(name.startswith(f"{self.rig.names[0]}[") for name in self.shared_names)

    @cached_property
    def n_shared(self) -> int:
        """How many parameters are shared."""
        return len(self.shared_names)

    @cached_property
    def stage_sources(self) -> tuple[tuple[tuple[int, float], ...], ...]:
        """By experiment, in the order of the rig's names: the position in theta of what gives the
        stage's value, and the factor."""
        own = dict(zip(self.sensor_names, self.value_names, strict=False))
        places = {
            name: (self.shared_names.index(source), factor)
            for name, (source, factor) in self.sources.items()
        }
        rest = [places[name] for name in self.rig.names[1:]]
        return tuple((places[own[sensor]], *rest) for sensor in self.sensors)

    @cached_property
    def shared(self) -> tuple[NDArray[np.int64], ...]:
        """By experiment, (n,) positions of what gives the rig's values, each once; the sensor's
        first."""
        return tuple(
            np.array(list(dict.fromkeys(place for place, _ in stages)), dtype=np.int64)
            for stages in self.stage_sources
        )

    @cached_property
    def rigs(self) -> tuple[Rig, ...]:
        """By experiment, the rig as a function of theta at :attr:`shared`."""
        if not self.ties:
            return (self.rig,) * len(self.experiments)
        return tuple(
            replace(
                self.rig, ties=tuple((own.tolist().index(place), factor) for place, factor in each)
            )
            for own, each in zip(self.shared, self.stage_sources, strict=True)
        )

    def alone(self, name: str) -> bool:
        """Whether a shared parameter is the value of one stage in every experiment."""
        place = self.shared_names.index(name)
        return all(
            [factor for i, factor in stages if i == place] == [1.0] for stages in self.stage_sources
        )

    @property
    def is_published(self) -> bool:
        """Whether this is the published rig with one sensor, and all records are pulses."""
        return (
            self.rig.names == PUBLISHED.names
            and self.rig.kinds == PUBLISHED.kinds
            and not self.sensors_are_named
            and not self.ties
            and all(each.is_pulse for each in self.switching)
        )

    def taus(self, theta: FloatArray, k: int, flow: float) -> FloatArray:
        """(n_lags,) s of experiment number ``k`` at the flat vector, in the order of the stages.

        ``flow``: total flow, mL/s; nan where it is not known.
        """
        return self.rigs[k].taus(theta[self.shared[k]], flow)

    def lags(self, theta: FloatArray, k: int, flow: float) -> FloatArray:
        """:meth:`taus` without a check: a lag may be zero."""
        return self.rigs[k].lags(theta[self.shared[k]], flow)

    def slowest(self, theta: FloatArray, k: int, flow: float) -> float:
        """s, the longest of :meth:`lags`."""
        return float(self.lags(theta, k, flow).max())

    @property
    def tau(self) -> int:
        """Position in theta of the first lag: ``tau_s``, or the first sensor's where each has its
        own; in a fit or a posterior the shortest of the lags that may be exchanged."""
        return 0

    @property
    def one_sensor(self) -> bool:
        """Whether there is one sensor, or several that all have one lag: that is then theta's first
        value."""
        return self.shared_names[0] == self.rig.names[0]

    def place_of(self, experiment: str) -> int:
        """Number of an experiment."""
        return self.experiments.index(experiment)

    @cached_property
    def _mean_names(self) -> tuple[str, ...]:
        names = list(self.shared_names)
        seen: set[str] = set()
        for name, record, switches in zip(
            self.experiments, self.records, self.switching, strict=True
        ):
            names += [f"y0_V[{name}]", f"beta_V[{name}]"]
            if record not in seen:
                names += [f"{kind}[{record}]" for kind in switches.names]
            seen.add(record)
        return tuple(names)

    @property
    def mean_names(self) -> list[str]:
        """Names of the parameters of the chain's mean, in order; a new list."""
        return list(self._mean_names)

    @property
    def noise_names(self) -> list[str]:
        """Names of the noise parameters, in order; a new list."""
        if self.noise_per_experiment:
            return [f"{kind}[{name}]" for name in self.experiments for kind in NOISE]
        if not self.sensors_are_named:
            return list(NOISE)
        return [f"{kind}[{sensor}]" for sensor in self.sensor_names for kind in NOISE]

    @cached_property
    def switch_kinds(self) -> tuple[str, ...]:
        """Names of switch times without their record, each once."""
        return tuple(dict.fromkeys(name for each in self.switching for name in each.names))

    @cached_property
    def _names(self) -> tuple[str, ...]:
        return *self._mean_names, *self.noise_names, *self.extra

    @property
    def names(self) -> list[str]:
        """All names, in the order of the flat vector; a new list."""
        return list(self._names)

    @cached_property
    def n_mean(self) -> int:
        """How many parameters the chain's mean has."""
        return len(self._mean_names)

    def __len__(self) -> int:
        return len(self._names)

    def index(self, name: str) -> int:
        """Position of a parameter; raises KeyError naming the known ones."""
        try:
            return self._positions[name]
        except KeyError:
            raise KeyError(f"no parameter '{name}'; there are {', '.join(self.names)}") from None

    @cached_property
    def _positions(self) -> dict[str, int]:
        return {name: i for i, name in enumerate(self._names)}

    @cached_property
    def local(self) -> NDArray[np.int64]:
        """(n_experiments, 2 + n_switches) positions of y0, beta and the switch times (t0, tf for a
        pulse); -1 where an experiment has fewer of them, at least two columns of switches."""
        most = max(2, *(len(each.names) for each in self.switching))
        found = np.full((len(self.experiments), 2 + most), -1, dtype=np.int64)
        for k, (name, record, switches) in enumerate(
            zip(self.experiments, self.records, self.switching, strict=True)
        ):
            kinds = [f"y0_V[{name}]", f"beta_V[{name}]"]
            kinds += [f"{kind}[{record}]" for kind in switches.names]
            found[k, : len(kinds)] = [self._positions[kind] for kind in kinds]
        return found

    def switches(self, k: int) -> NDArray[np.int64]:
        """(n,) positions of the switch times of experiment number ``k``."""
        return self.local[k, 2 : 2 + len(self.switching[k].names)]

    @cached_property
    def all_switches(self) -> NDArray[np.int64]:
        """(n,) positions of all switch times, each once."""
        edges = self.local[:, 2:]
        return np.unique(edges[edges >= 0])

    @cached_property
    def noise(self) -> NDArray[np.int64]:
        """(n_experiments, 3) positions of phi, sigma0, sigma1."""
        if self.noise_per_experiment:
            group = np.arange(len(self.experiments))
        else:
            group = np.array([self.sensor_names.index(sensor) for sensor in self.sensors])
        found: NDArray[np.int64] = self.n_mean + np.arange(3)[None, :] + 3 * group[:, None]
        return found

    def flat(self, theta: Theta) -> FloatArray:
        """The flat vector (n,) of a mapping, a fit, or a vector with or without its noise part.

        A vector without noise parameters, or a mapping without them, gets phi 0, sigma1 0 and
        sigma0 nan, so that a mean can be computed but a likelihood cannot.  A mapping may also hold
        parameters of other experiments, a tf that was not recorded, and what a ``truth.json``
        has beside parameters (``signal_unit``, ``effects``).  The vector is a new one.

        Raises
        ------
        CampaignError
            If the length is wrong, the mapping lacks a parameter or holds an unknown one, or a
            value is no number.
        """
        if isinstance(theta, Mapping):
            return self._flat_of_mapping(theta)
        try:
            vector = np.array(getattr(theta, "theta_hat", theta), dtype=float)
        except (TypeError, ValueError):
            vector = np.array(np.nan)
        if not vector.ndim:
            raise CampaignError(
                "theta: expected a Fit, a mapping by name as Fit.parameters is, or a vector of "
                f"{len(self)} numbers, but got a {type(theta).__name__}; give one of them"
            )
        if vector.shape == (len(self),):
            return vector
        if vector.shape == (self.n_mean,) and not self.extra:
            return np.concatenate([vector, self._no_noise()])
        raise CampaignError(
            f"theta has shape {vector.shape}; expected ({len(self)},) in the order "
            f"{', '.join(self.names[:5])}, .. or ({self.n_mean},) without noise parameters"
        )

    def _no_noise(self) -> FloatArray:
        return np.tile([0.0, np.nan, 0.0], len(self.noise_names) // 3)

    def _flat_of_mapping(self, theta: Mapping[str, Any]) -> FloatArray:
        found = by_flat_name(theta)
        if found.keys() == self._positions.keys():  # the usual case, once per evaluation
            with suppress(TypeError, ValueError):  # below it is said which is no number
                vector = np.array([found[name] for name in self._names], dtype=float)
                if not np.isnan(vector).any():
                    return vector
        vector = np.concatenate(
            [np.full(self.n_mean, np.nan), self._no_noise(), np.full(len(self.extra), np.nan)]
        )
        for name, position in self._positions.items():
            # a shared noise value also serves a layout with noise per experiment or sensor
            value = found.get(name, found.get(name.split("[")[0]) if name[:3] in _NOISE3 else None)
            if value is not None:
                vector[position] = number_of(value, name)
        missing = [n for n in self.mean_names + list(self.extra) if np.isnan(vector[self.index(n)])]
        if missing:
            raise CampaignError(
                f"theta lacks {', '.join(missing[:4])}{' ..' if len(missing) > 4 else ''}; "
                "expected the keys of fit.json's parameters"
            )
        for name in found:
            if name not in BESIDE:
                check_name(self, name, "theta")
        for name, value in self.tied_values(vector).items():
            if name in found and not isclose(float(found[name]), value, rel_tol=1e-9):
                raise CampaignError(
                    f"theta: {name} is {found[name]:.10g}, but it is tied, and its tie makes it "
                    f"{value:.10g}; expected the same: correct it or leave it out"
                )
        return vector

    @cached_property
    def tied(self) -> dict[str, tuple[str, float]]:
        """By the name of every lag and volume that has no place of its own in theta: the parameter
        that gives it, and the factor; sensors that all have one lag are not among them."""
        common = self.value_names[: len(self.sensor_names)] if self.one_sensor else ()
        return {
            name: (source, factor)
            for name, (source, factor) in self.sources.items()
            if source != name and name not in common
        }

    def tied_values(self, theta: FloatArray) -> dict[str, float]:
        """By flat name, the values of :attr:`tied` at ``theta`` (n_theta,)."""
        return {
            name: float(theta[self.shared_names.index(source)]) * factor
            for name, (source, factor) in self.tied.items()
        }

    def nested(self, theta: Theta, noise: bool = True) -> dict[str, Any]:
        """The mapping of ``fit.json`` for a flat vector."""
        vector = self.flat(theta)
        result: dict[str, Any] = {
            name: float(vector[i]) for i, name in enumerate(self.shared_names)
        }
        result |= self.tied_values(vector)
        whose = (*self.experiments, *self.records)
        result["experiments"] = {name: {} for name in whose}
        for name in self.names[self.n_shared :]:
            kind, bracket, rest = name.partition("[")
            is_noise = kind in NOISE
            if is_noise and (not noise or np.isnan(vector[self.index(name)])):
                continue
            if bracket and rest[:-1] in result["experiments"]:
                result["experiments"][rest[:-1]][kind] = float(vector[self.index(name)])
            else:
                result[name] = float(vector[self.index(name)])
        return result


_NOISE3 = {name[:3] for name in NOISE}


def check_name(layout: Layout, name: str, where: str) -> None:
    """Raise CampaignError unless a parameter of ``layout``, or of the same with other experiments,
    has this flat name; noise parameters with or without an experiment."""
    kind, bracket, rest = name.partition("[")
    own = {extra.split("[")[0] for extra in layout.extra if "[" in extra}
    if name in (*layout.shared_names, *layout.value_names, *layout.extra) or kind in NOISE:
        return
    if kind in (*LOCAL, *layout.switch_kinds, *own) and rest.endswith("]"):
        return
    own_kinds = (*LOCAL[:2], *layout.switch_kinds)
    known = [
        *layout.shared_names,
        *own_kinds,
        *NOISE,
        *dict.fromkeys(n.split("[")[0] for n in layout.extra),
    ]
    close = difflib.get_close_matches(kind, known, n=1)
    if kind in own_kinds:
        hint = f"write '{kind}[{layout.experiments[0]}]' and the like, one for each experiment"
    elif close and close[0] != kind:
        hint = f"did you mean '{close[0]}{bracket}{rest}'?"
    else:
        hint = f"known are {', '.join(known)}"
    raise CampaignError(
        f"{where}: expected names of parameters, but got '{name[:80]}'; {hint}; correct it or "
        "leave it out"
    )
