"""The layout of parameters: names, units, and the flat array beside the nested mapping."""

from __future__ import annotations

import difflib
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np

from bayes_sensor.campaign import Campaign, CampaignError, FloatArray
from bayes_sensor.display import record_card
from bayes_sensor.rig.rig import PUBLISHED

Theta = Mapping[str, Any] | Sequence[float] | FloatArray
"""Parameters as the nested mapping of ``fit.json`` or as the flat array of :class:`Layout`."""

SHARED = PUBLISHED.names

LOCAL = ("y0_V", "beta_V", "t0_s", "tf_s")

NOISE = ("phi", "sigma0_V", "sigma1_V")

BESIDE = ("signal_unit", "effects")
"""what a ``truth.json`` holds beside parameters"""

UNITS = {
    "s": "s", "ms": "ms", "V": "V", "V2": "V^2", "mL": "mL", "Hz": "Hz", "K": "K", "s2": "s^2",
}  # fmt: skip
"""at the end of a flat name"""


def unit_of(name: str, signal_unit: str) -> str:
    """The unit at the end of a flat name.

    >>> [unit_of(name, "V") for name in ("tau_s", "drift_V_per_s", "closing_ratio")]
    ['s', 'V/s', '1']
    """
    words = name.split("_")[1:]
    if not words or words[-1] not in UNITS:
        return "1"
    below = UNITS[words[-1]].replace("V", signal_unit)
    if len(words) > 1 and words[-2] == "per":
        above = UNITS.get(words[-3], "1") if len(words) > 2 else "1"
        return f"{above.replace('V', signal_unit)}/{below}"
    return below


@dataclass(frozen=True)
class Layout:
    """Where each parameter stands in the flat vector theta.

    Order: ``tau_s``, ``tau_v_s``, ``V_mL``; per experiment ``y0_V``, ``beta_V``, ``t0_s`` and,
    where a step down was recorded, ``tf_s``; then the noise parameters; then ``extra``
    (parameters that effects bring along).

    >>> Layout(("a",), (False,)).names
    ['tau_s', 'tau_v_s', 'V_mL', 'y0_V[a]', 'beta_V[a]', 't0_s[a]', 'phi', 'sigma0_V', 'sigma1_V']
    """

    _repr_html_ = record_card

    experiments: tuple[str, ...]
    has_fall: tuple[bool, ...]
    noise_per_experiment: bool = False
    extra: tuple[str, ...] = ()

    @classmethod
    def of(
        cls,
        campaign: Campaign,
        noise_per_experiment: bool = False,
        extra: Iterable[str] = (),
    ) -> Layout:
        """The layout of a campaign's parameters."""
        return cls(
            tuple(campaign.names_of_experiments),
            tuple(e.has_fall for e in campaign),
            noise_per_experiment,
            tuple(extra),
        )

    @property
    def mean_names(self) -> list[str]:
        """Names of the parameters of the cascade's mean, in order; a new list."""
        names = list(SHARED)
        for name, fall in zip(self.experiments, self.has_fall, strict=True):
            names += [f"{kind}[{name}]" for kind in (LOCAL if fall else LOCAL[:-1])]
        return names

    @property
    def noise_names(self) -> list[str]:
        """Names of the noise parameters, in order; a new list."""
        if not self.noise_per_experiment:
            return list(NOISE)
        return [f"{kind}[{name}]" for name in self.experiments for kind in NOISE]

    @cached_property
    def _names(self) -> tuple[str, ...]:
        return *self.mean_names, *self.noise_names, *self.extra

    @property
    def names(self) -> list[str]:
        """All names, in the order of the flat vector; a new list."""
        return list(self._names)

    @cached_property
    def n_mean(self) -> int:
        """How many parameters the cascade's mean has."""
        return len(self.mean_names)

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
    def local(self) -> np.ndarray:
        """(n_experiments, 4) positions of y0, beta, t0, tf; -1 where there is no tf."""
        rows = []
        start = len(SHARED)
        for fall in self.has_fall:
            rows.append([start, start + 1, start + 2, start + 3 if fall else -1])
            start += 4 if fall else 3
        return np.array(rows, dtype=np.int64)

    @cached_property
    def noise(self) -> np.ndarray:
        """(n_experiments, 3) positions of phi, sigma0, sigma1."""
        base = self.n_mean + np.arange(3)
        n = len(self.experiments)
        step = 3 if self.noise_per_experiment else 0
        return base[None, :] + step * np.arange(n)[:, None]

    def flat(self, theta: Theta) -> FloatArray:
        """The flat vector (n,) of a mapping or of a vector with or without its noise part.

        A vector without noise parameters, or a mapping without them, gets phi 0, sigma1 0 and
        sigma0 nan, so that a mean can be computed but a likelihood cannot.  A mapping may also hold
        parameters of other experiments, a tf that was not recorded, and what a ``truth.json``
        has beside parameters (``signal_unit``, ``effects``).  The vector is a new one.

        Raises
        ------
        CampaignError
            If the length is wrong, or the mapping lacks a parameter or holds an unknown one.
        """
        if isinstance(theta, Mapping):
            return self._flat_of_mapping(theta)
        vector = np.array(theta, dtype=float)
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
        vector = np.concatenate(
            [np.full(self.n_mean, np.nan), self._no_noise(), np.full(len(self.extra), np.nan)]
        )
        found = dict(theta)
        nested = found.pop("experiments", {})
        for name, values in nested.items():
            found.update({f"{kind}[{name}]": value for kind, value in values.items()})
        for name, position in self._positions.items():
            # a shared noise value also serves a layout with noise per experiment
            value = found.get(name, found.get(name.split("[")[0]) if name[:3] in _NOISE3 else None)
            if value is not None:
                vector[position] = float(value)
        missing = [n for n in self.mean_names + list(self.extra) if np.isnan(vector[self.index(n)])]
        if missing:
            raise CampaignError(
                f"theta lacks {', '.join(missing[:4])}{' ..' if len(missing) > 4 else ''}; "
                "expected the keys of fit.json's parameters"
            )
        for name in found:
            if name not in BESIDE:
                check_name(self, name, "theta")
        return vector

    def nested(self, theta: Theta, noise: bool = True) -> dict[str, Any]:
        """The mapping of ``fit.json`` for a flat vector."""
        vector = self.flat(theta)
        result: dict[str, Any] = {name: float(vector[i]) for i, name in enumerate(SHARED)}
        result["experiments"] = {name: {} for name in self.experiments}
        for name in self.names[len(SHARED) :]:
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
    if name in (*SHARED, *layout.extra) or kind in NOISE:
        return
    if kind in (*LOCAL, *own) and rest.endswith("]"):
        return
    known = [*SHARED, *LOCAL, *NOISE, *dict.fromkeys(n.split("[")[0] for n in layout.extra)]
    close = difflib.get_close_matches(kind, known, n=1)
    if kind in LOCAL:
        hint = f"write '{kind}[{layout.experiments[0]}]' and the like, one for each experiment"
    elif close and close[0] != kind:
        hint = f"did you mean '{close[0]}{bracket}{rest}'?"
    else:
        hint = f"known are {', '.join(known)}"
    raise CampaignError(
        f"{where}: expected names of parameters, but got '{name[:80]}'; {hint}; correct it or "
        "leave it out"
    )
