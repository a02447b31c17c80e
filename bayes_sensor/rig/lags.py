"""Which lag is the sensor's: the lags by size, and the ways in which they may be named.

Lags commute: the response of first-order lags in a row does not depend on their order. The data
therefore know the lags that do not depend on flow as a set of values, and where all experiments
have one total flow the volumes' V/Q belong to that set as well. The calculation keeps them by
size in the places that their parameters have in theta: the shortest in the sensor's, then those
of volumes (times the flow), then the others. For the published rig that is ``tau_s``, at one flow
``V_mL``, ``tau_v_s``. An :class:`Assignment` gives them names.
"""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import dataclass
from itertools import pairwise, permutations

import numpy as np
from numpy.typing import NDArray

from bayes_sensor.campaign import Campaign, FloatArray
from bayes_sensor.rig.layout import Layout

DECIDED = 0.95
"""probability from which one assignment is stated alone"""
LAG_NAMES = {
    1: ("lag_s",),
    2: ("lag_fast_s", "lag_slow_s"),
    3: ("lag_fast_s", "lag_between_s", "lag_slow_s"),
    **{n: tuple(f"lag_{i}_s" for i in range(1, n + 1)) for n in range(4, 7)},
}
"""flat names of the lags, shortest first, by how many there are"""
ROLES = {"sensor": "tau_s", "valve": "tau_v_s", "manifold": "V_mL"}
"""parameters of the published rig's stages"""


@dataclass(frozen=True)
class Assignment:
    """Whose each lag is.

    >>> Assignment(("tau_s", "tau_v_s"), (1, 0)).sensor
    1
    """

    names: tuple[str, ...]
    """parameters of the lags that commute"""
    places: tuple[int, ...]
    """of each of them, its place among the lags: 0 is the shortest"""

    def place(self, name: str) -> int | None:
        """Place of a parameter's lag; None where it is none of those that commute."""
        return self.places[self.names.index(name)] if name in self.names else None

    @property
    def sensor(self) -> int | None:
        """Place of the sensor's lag."""
        return self.place("tau_s")

    @property
    def valve(self) -> int | None:
        """Place of the valve's lag."""
        return self.place("tau_v_s")

    @property
    def manifold(self) -> int | None:
        """Place of the manifold's V/Q; None where the flows tell it from the other lags."""
        return self.place("V_mL")

    @property
    def n_lags(self) -> int:
        """How many lags there are to name."""
        return len(self.names)

    @property
    def sensor_is(self) -> str:
        """``faster``, ``between`` or ``slower``.

        >>> Assignment(("tau_s", "tau_v_s"), (1, 0)).sensor_is
        'slower'
        """
        if self.sensor == 0:
            return "faster"
        return "slower" if self.sensor == self.n_lags - 1 else "between"


@dataclass(frozen=True)
class Commuting:
    """The lags of a campaign that commute, and where they stand in theta."""

    names: tuple[str, ...]
    """of their parameters, in the order of theta"""
    places: tuple[int, ...]
    """(n_lags,) positions in theta, for the shortest lag first"""
    flow: float | None
    """mL/s, the common total flow, where volumes are among them"""
    shared: tuple[str, ...]
    """names of all shared parameters, in the order of theta"""

    @classmethod
    def of(cls, campaign: Campaign, layout: Layout) -> Commuting:
        """Of a campaign. Several sensors tell their own lags from those that they share."""
        rig = layout.rig
        one_flow = rig.needs_flow and campaign.same_flow
        names = tuple(
            name
            for name in rig.lags_that_commute(one_flow)
            if name in layout.shared_names and layout.alone(name)
        )
        flow = None
        if one_flow and any(name.startswith("V_") for name in names):
            flow = campaign.experiments[0].total_flow
        return cls.among(names, layout.shared_names, flow)

    @classmethod
    def among(cls, names: Sequence[str], shared: Sequence[str], flow: float | None) -> Commuting:
        """Of parameters ``names`` among ``shared``."""

        def rank(name: str) -> tuple[bool, bool, int]:
            return name != "tau_s", not name.startswith("V_"), shared.index(name)

        places = tuple(shared.index(name) for name in sorted(names, key=rank))
        return cls(tuple(names), places, flow, tuple(shared))

    @property
    def n_lags(self) -> int:
        """How many there are."""
        return len(self.names)

    @property
    def without_volumes(self) -> Commuting:
        """Those that do not depend on flow."""
        names = [name for name in self.names if not name.startswith("V_")]
        return Commuting.among(names, self.shared, None)

    @property
    def volumes(self) -> tuple[bool, ...]:
        """(n_lags,) whether theta has a volume in that lag's place, shortest lag first."""
        return tuple(self.shared[place].startswith("V_") for place in self.places)

    @property
    def to_lag(self) -> tuple[float, ...]:
        """(n_lags,) what makes a lag (s) of theta's value in its place, shortest first."""
        return tuple(
            1.0 / self.flow if volume and self.flow is not None else 1.0 for volume in self.volumes
        )

    def lags(self, thetas: FloatArray) -> FloatArray:
        """(.., n_lags) s, shortest first, of ``thetas`` (.., n_theta) that hold them by size.

        >>> published = ("tau_s", "tau_v_s", "V_mL")
        >>> one_flow = Commuting.among(published, published, 60.0)
        >>> one_flow.lags(np.array([0.1, 0.9, 30.0])).tolist()
        [0.1, 0.5, 0.9]
        """
        if not self.names:
            return thetas[..., :0]
        found: FloatArray = np.stack(
            [
                thetas[..., place] / self.flow
                if volume and self.flow is not None
                else thetas[..., place]
                for place, volume in zip(self.places, self.volumes, strict=True)
            ],
            axis=-1,
        )
        return found

    def by_size(self, theta: FloatArray) -> FloatArray:
        """``theta`` (n_theta,) with its lags in the places that they have by size: the same
        response.

        >>> two = Commuting.among(("tau_s", "tau_v_s"), ("tau_s", "tau_v_s", "V_mL"), None)
        >>> two.by_size(np.array([2.0, 0.1, 30.0])).tolist()
        [0.1, 2.0, 30.0]
        """
        found = np.array(theta, dtype=float)
        lags = self.lags(found)
        for place, volume, lag, before in zip(
            self.places, self.volumes, np.sort(lags), lags, strict=True
        ):
            if lag != before:  # dividing and multiplying again would cost a rounding
                found[place] = lag * self.flow if volume and self.flow is not None else lag
        return found

    def in_order(self, theta: FloatArray) -> bool:
        """Whether ``theta`` (n_theta,) holds its lags by size."""
        return all(a <= b for a, b in pairwise(self.lags(theta).tolist()))

    def named(
        self,
        thetas: FloatArray,
        choices: Sequence[Assignment],
        chosen: NDArray[np.int64] | int = 0,
    ) -> FloatArray:
        """(.., n_shared) the shared parameters by name, of ``thetas`` (.., n_theta) that hold lags
        by size.

        ``chosen`` (..): the place in ``choices`` of each one's assignment.
        """
        lags = self.lags(thetas)
        chosen = np.broadcast_to(np.asarray(chosen), lags.shape[:-1])[..., None]
        found = np.array(thetas[..., : len(self.shared)], dtype=float)
        for name in self.names:
            places = np.array([choice.place(name) for choice in choices])[chosen]
            lag = np.take_along_axis(lags, places, axis=-1)[..., 0]
            if name.startswith("V_") and self.flow is not None:
                lag = self.flow * lag
            found[..., self.shared.index(name)] = lag
        return found


def assignments(
    sensor_is: str, names: Sequence[str], known: Collection[str] = ()
) -> tuple[Assignment, ...]:
    """The assignments of lags to parameters ``names`` that are possible, all of one prior
    probability.

    ``faster`` is the shortest and ``slower`` the longest of the lags. Where volumes are among them
    and one is ``known`` from elsewhere, that tells which is its V/Q, and the sensor is compared
    with the others alone.

    >>> [a.places for a in assignments("unknown", ("tau_s", "tau_v_s"))]
    [(0, 1), (1, 0)]
    >>> three = ("tau_s", "tau_v_s", "V_mL")
    >>> [len(assignments(order, three)) for order in ("faster", "slower", "unknown")]
    [2, 2, 6]
    """
    names = tuple(names)
    found = tuple(Assignment(names, places) for places in permutations(range(len(names))))
    if sensor_is == "unknown" or "tau_s" not in names:
        return found
    others = [name for name in names if name != "tau_s" and name not in known]

    def possible(choice: Assignment) -> bool:
        own = choice.places[names.index("tau_s")]
        rest = [choice.places[names.index(name)] for name in others]
        if sensor_is == "faster":
            return all(own < place for place in rest)
        return all(own > place for place in rest)

    return tuple(filter(possible, found))


@dataclass(frozen=True)
class Naming:
    """What may be said of the names of a campaign's lags."""

    sensor_is: str
    """what the campaign says: ``faster``, ``slower`` or ``unknown``"""
    choices: tuple[Assignment, ...]
    probabilities: tuple[float, ...]
    """of the choices"""
    commuting: Commuting
    """the lags that are named"""

    @property
    def flow(self) -> float | None:
        """mL/s, the common total flow, where volumes are among the lags."""
        return self.commuting.flow

    @property
    def n_lags(self) -> int:
        """How many lags there are to name."""
        return self.commuting.n_lags

    def shares(self, role: str) -> FloatArray:
        """(n_lags,) probability of each place among the lags for a parameter, or for ``sensor``,
        ``valve``, ``manifold``."""
        found = np.zeros(self.n_lags)
        for choice, probability in zip(self.choices, self.probabilities, strict=True):
            place = choice.place(ROLES.get(role, role))
            if place is not None:
                found[place] += probability
        return found

    def names_of_lags(self, role: str) -> bool:
        """Whether a role's or parameter's lag is one of those that commute."""
        return ROLES.get(role, role) in self.commuting.names

    def place(self, role: str) -> int | None:
        """The place among the lags that may be stated of a parameter, or of ``sensor``, ``valve``
        or ``manifold``; None where it is not known, or its lag does not commute."""
        if not self.names_of_lags(role):
            return None
        shares = self.shares(role)
        best = int(np.argmax(shares))
        return best if shares[best] >= DECIDED else None

    @property
    def exchanged(self) -> Assignment | None:
        """The likeliest assignment, if it may be stated that the sensor's is not the shortest."""
        return self.choices[int(np.argmax(self.probabilities))] if self.place("sensor") else None

    @property
    def order(self) -> str:
        """``given``, ``decided`` (by what is known beside the data) or ``undecided``."""
        if not self.names_of_lags("sensor"):
            return "given"
        if self.place("sensor") is None:
            return "undecided"
        return "decided" if self.sensor_is == "unknown" and self.n_lags > 1 else "given"

    @property
    def labels(self) -> tuple[tuple[str, float], ...]:
        """Name and factor of theta's shared values: what each is, and what makes it so.

        A lag whose owner is not known is called by its size.
        """
        found = [(name, 1.0) for name in self.commuting.shared]
        sizes = list(LAG_NAMES.get(self.n_lags, ()))
        for name in self.commuting.names:
            place = self.place(name)
            if place is not None:
                sizes[place] = name
        for name, place, volume in zip(
            sizes, self.commuting.places, self.commuting.volumes, strict=True
        ):
            flow = self.flow or 1.0
            factor = flow if name.startswith("V_") else 1.0
            found[place] = (name, factor / flow if volume else factor)
        return tuple(found)

    @property
    def names(self) -> tuple[str, ...]:
        """Names of theta's shared values as they stand, in the unit of their place.

        At one flow the place of a volume holds the volume that its lag would be of.
        """
        found = []
        sizes = LAG_NAMES.get(self.n_lags, ())
        for place, (label, _) in enumerate(self.labels):
            own = self.commuting.shared[place]
            if own.startswith("V_"):
                found.append(own)
            elif label.startswith("V_"):
                found.append(sizes[self.commuting.places.index(place)])
            else:
                found.append(label)
        return tuple(found)
