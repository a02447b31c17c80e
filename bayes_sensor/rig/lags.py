"""Which lag is the sensor's: the lags by size, and the ways in which they may be named.

Lags commute: the response of first-order lags in a row does not depend on their order. The data
therefore know the lags that do not depend on flow as a set of values, and where all experiments
have one total flow the manifold's V/Q belongs to that set as well. The calculation keeps them by
size: theta holds the shortest in the place of ``tau_s``, the longest in that of ``tau_v_s`` and, at
one flow, the middle one in that of ``V_mL`` (times the flow). An :class:`Assignment` gives them
names.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import permutations

import numpy as np
from numpy.typing import NDArray

from bayes_sensor.campaign import Campaign, FloatArray

DECIDED = 0.95
"""probability from which one assignment is stated alone"""
LAG_NAMES = {2: ("lag_fast_s", "lag_slow_s"), 3: ("lag_fast_s", "lag_between_s", "lag_slow_s")}
"""flat names of the lags, shortest first, by how many there are"""


@dataclass(frozen=True)
class Assignment:
    """Whose each lag is, by its place among the lags: 0 is the shortest."""

    sensor: int
    valve: int
    manifold: int | None = None
    """None where the flows tell V/Q from the other lags"""

    @property
    def n_lags(self) -> int:
        """How many lags there are to name."""
        return 2 if self.manifold is None else 3

    @property
    def sensor_is(self) -> str:
        """``faster``, ``between`` or ``slower``.

        >>> Assignment(1, 0).sensor_is, Assignment(1, 0, 2).sensor_is
        ('slower', 'between')
        """
        if self.sensor == 0:
            return "faster"
        return "slower" if self.sensor == self.n_lags - 1 else "between"


def common_flow(campaign: Campaign) -> float | None:
    """mL/s, the total flow where all experiments share one; None where flows differ."""
    return campaign.experiments[0].total_flow if campaign.same_flow else None


def assignments(
    sensor_is: str, one_flow: bool, volume_known: bool = False
) -> tuple[Assignment, ...]:
    """The assignments that are possible, all of the same prior probability.

    ``one_flow``: all experiments share one total flow, so that V/Q is one of three lags.  Then
    ``faster`` is the shortest and ``slower`` the longest of the three, unless the volume is known
    from elsewhere (``volume_known``): that tells which of them is V/Q, and the sensor is compared
    with the valve alone.

    >>> assignments("unknown", False)
    (Assignment(sensor=0, valve=1, manifold=None), Assignment(sensor=1, valve=0, manifold=None))
    >>> [len(assignments(order, True)) for order in ("faster", "slower", "unknown")]
    [2, 2, 6]
    """
    if one_flow:
        found = [Assignment(*places) for places in permutations(range(3))]
    else:
        found = [Assignment(0, 1), Assignment(1, 0)]
    if sensor_is == "unknown":
        return tuple(found)
    if one_flow and not volume_known:
        place = 0 if sensor_is == "faster" else 2
        return tuple(a for a in found if a.sensor == place)
    return tuple(a for a in found if (a.sensor < a.valve) == (sensor_is == "faster"))


def places_of_lags(flow: float | None) -> tuple[int, ...]:
    """Where the lags stand in theta, shortest first; the middle one as V where ``flow`` is one."""
    return (0, 1) if flow is None else (0, 2, 1)


def lags_of(thetas: FloatArray, flow: float | None) -> FloatArray:
    """(.., n_lags) s, shortest first, of ``thetas`` (.., n_theta) that hold them by size.

    ``flow``: the common total flow in mL/s, or None where flows differ.

    >>> lags_of(np.array([0.1, 0.9, 30.0]), 60.0).tolist()
    [0.1, 0.5, 0.9]
    """
    if flow is None:
        return thetas[..., :2]
    return np.stack([thetas[..., 0], thetas[..., 2] / flow, thetas[..., 1]], axis=-1)


def by_size(theta: FloatArray, flow: float | None) -> FloatArray:
    """``theta`` (n_theta,) with its lags in the places that they have by size: the same response.

    >>> by_size(np.array([2.0, 0.1, 30.0]), None).tolist()
    [0.1, 2.0, 30.0]
    """
    found = np.array(theta, dtype=float)
    if flow is None:
        found[:2] = np.sort(found[:2])
    else:
        found[0], middle, found[1] = np.sort([found[0], found[2] / flow, found[1]])
        if middle != found[2] / flow:  # dividing and multiplying again would cost a rounding
            found[2] = middle * flow
    return found


def named(
    thetas: FloatArray,
    flow: float | None,
    choices: Sequence[Assignment],
    chosen: NDArray[np.int64] | int = 0,
) -> FloatArray:
    """(.., 3) tau, tau_v (s) and V (mL) of ``thetas`` (.., n_theta) that hold lags by size.

    ``chosen`` (..): the place in ``choices`` of each one's assignment.
    """
    lags = lags_of(thetas, flow)
    chosen = np.broadcast_to(np.asarray(chosen), lags.shape[:-1])[..., None]

    def of(places: list[int]) -> FloatArray:
        return np.take_along_axis(lags, np.array(places)[chosen], axis=-1)[..., 0]

    volume = thetas[..., 2]
    if flow is not None:
        volume = flow * of([a.manifold or 0 for a in choices])
    return np.stack([of([a.sensor for a in choices]), of([a.valve for a in choices]), volume], -1)


@dataclass(frozen=True)
class Naming:
    """What may be said of the names of a campaign's lags."""

    sensor_is: str
    """what the campaign says: ``faster``, ``slower`` or ``unknown``"""
    choices: tuple[Assignment, ...]
    probabilities: tuple[float, ...]
    """of the choices"""
    flow: float | None
    """mL/s, the common total flow, where V/Q is one of the lags"""

    @property
    def n_lags(self) -> int:
        """How many lags there are to name."""
        return self.choices[0].n_lags

    def shares(self, role: str) -> FloatArray:
        """(n_lags,) probability of each place among the lags for ``sensor``, ``valve``, ..

        >>> choices = assignments("unknown", False)
        >>> Naming("unknown", choices, (0.2, 0.8), None).shares("sensor").tolist()
        [0.2, 0.8]
        """
        found = np.zeros(self.n_lags)
        for choice, probability in zip(self.choices, self.probabilities, strict=True):
            found[getattr(choice, role)] += probability
        return found

    def place(self, role: str) -> int | None:
        """The place among the lags that may be stated of ``sensor``, ``valve`` or ``manifold``."""
        shares = self.shares(role)
        best = int(np.argmax(shares))
        return best if shares[best] >= DECIDED else None

    @property
    def exchanged(self) -> Assignment | None:
        """The likeliest assignment, where it may be stated that the sensor's is not the shortest.

        >>> Naming("slower", assignments("slower", False), (1.0,), None).exchanged
        Assignment(sensor=1, valve=0, manifold=None)
        """
        return self.choices[int(np.argmax(self.probabilities))] if self.place("sensor") else None

    @property
    def order(self) -> str:
        """``given``, ``decided`` (by what is known beside the data) or ``undecided``."""
        if self.place("sensor") is None:
            return "undecided"
        return "decided" if self.sensor_is == "unknown" else "given"

    @property
    def labels(self) -> tuple[tuple[str, float], ...]:
        """Name and factor of theta's first three values: what each is, and what makes it so.

        A lag whose owner is not known is called by its size.

        >>> Naming("slower", assignments("slower", False), (1.0,), None).labels
        (('tau_v_s', 1.0), ('tau_s', 1.0), ('V_mL', 1.0))
        """
        names = list(LAG_NAMES[self.n_lags])
        roles = {"sensor": "tau_s", "valve": "tau_v_s"}
        if self.flow is not None:
            roles["manifold"] = "V_mL"
        for role, name in roles.items():
            place = self.place(role)
            if place is not None:
                names[place] = name
        if self.flow is None:
            return (names[0], 1.0), (names[1], 1.0), ("V_mL", 1.0)
        volumes = [self.flow if name == "V_mL" else 1.0 for name in names]
        return (
            (names[0], volumes[0]),
            (names[2], volumes[2]),
            (names[1], volumes[1] / self.flow),
        )

    @property
    def names(self) -> tuple[str, str, str]:
        """Names of theta's first three values as they stand, in s, s and mL.

        At one flow the third is the volume that the middle lag would be of.
        """
        sizes = LAG_NAMES[2]
        first, second = (
            size if name == "V_mL" else name
            for (name, _), size in zip(self.labels[:2], sizes, strict=True)
        )
        return first, second, "V_mL"
