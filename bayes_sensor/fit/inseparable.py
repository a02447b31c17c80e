"""Parameters that a campaign cannot tell apart, and the measurement that would.

Some exchange their values without a change of the response: lags that commute, two volumes, a lag
of the rig and the common lag of several sensors.  Others are found from the expected information at
the fit.  Its coordinates are those in which it stays regular where lags are equal or vanish:
elementary symmetric polynomials of the squared lags, and switch times plus the chain's mean delay.
Each is counted in its own natural size: powers of the longest lag, the longest lag, the step.
A direction with an eigenvalue below 1 is one along which the data leave a whole natural size open;
the parameters that it alone leaves open so far cannot be told apart.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import permutations
from typing import Any

import numpy as np

from bayes_sensor.campaign import FloatArray
from bayes_sensor.fit.side_information import apart_squares, covariance_of, polynomial_slopes
from bayes_sensor.fit.twin import AS_GOOD, Twin
from bayes_sensor.likelihood.mesh import expected_information
from bayes_sensor.likelihood.problem import Problem
from bayes_sensor.rig.lags import Naming
from bayes_sensor.rig.switching import is_switch_time

SHORTEST = 0.02
"""of the longest lag: a shorter one is raised to it, where derivatives keep their limit"""
LEAST_KNOWN = 1e-4
"""eigenvalue below which a direction counts as not known at all"""


@dataclass(frozen=True)
class Inseparable:
    """Parameters that cannot be told apart."""

    parameters: tuple[str, ...]
    """flat names"""
    measure: str
    """what would tell them apart"""
    sentence: str
    """both, for a warning"""
    kind: str = "warning"
    """``caveat`` of the first line, ``warning``, or ``said``: by the names already"""

    @classmethod
    def of(
        cls, parameters: Sequence[str], why: str, measure: str, kind: str = "warning"
    ) -> Inseparable:
        """With the sentence made of ``why``, a clause."""
        who = _listed([_symbol(name) for name in parameters])
        text = f"these data cannot tell {who} apart: {why}; to tell them apart: {measure}"
        return cls(tuple(parameters), measure, text, kind)

    def to_json(self) -> dict[str, Any]:
        """Names and measurement."""
        return {"parameters": list(self.parameters), "measure": self.measure}


def _symbol(name: str) -> str:
    kind, bracket, rest = name.partition("[")
    return kind.rsplit("_", 1)[0] + bracket + rest


def _listed(words: Sequence[str]) -> str:
    if len(words) > 4:
        words = [*words[:3], f"{len(words) - 3} more"]
    return ", ".join(words[:-1]) + f" and {words[-1]}" if len(words) > 1 else words[0]


def inseparable(
    problem: Problem, vector: FloatArray, naming: Naming, twin: Twin | None
) -> tuple[Inseparable, ...]:
    """All parameters that the campaign cannot tell apart at a fit ``vector`` (n_theta,).

    Where a value may be another parameter's, that is a caveat of the first line.  ``twin``: another
    lag and volume that fit as well.  Other models than the exact chain, and problems with held
    parameters, have only what their names leave open.
    """
    found = [without_names(problem, naming), volumes_without_names(problem)]
    found.append(None if twin is None else exchanged(twin))
    if problem.chain == "exact" and not problem.held:
        found.append(common_to_sensors(problem, vector))
        found += left_open(problem, vector)
    return tuple(each for each in found if each is not None)


def volumes_in_order(problem: Problem, theta: FloatArray) -> FloatArray:
    """``theta`` (n_mean,) with volumes that commute nearest to what is known of them, else by size.

    The response is the same.
    """
    names = volumes_that_commute(problem)
    if len(names) < 2 or problem.commuting.flow is not None or problem.held:
        return theta
    places = [problem.layout.shared_names.index(name) for name in names]

    def away(values: tuple[float, ...]) -> float:
        laws = [problem.named_laws.get(name) for name in names]
        return sum(
            ((value - law.a) / law.b) ** 2
            for value, law in zip(values, laws, strict=True)
            if law is not None and law.kind == "normal"
        )

    found = theta.copy()
    # of equal ones the first: by size
    found[places] = min(permutations(sorted(theta[places].tolist())), key=away)
    return found


def without_names(problem: Problem, naming: Naming) -> Inseparable | None:
    """The lags of which it is not known whose they are; None where there are none."""
    names = [name for name in naming.commuting.names if naming.place(name) is None]
    if len(names) < 2:
        return None
    volumes = [name for name in names if name.startswith("V_")]
    others = [name for name in names if name not in volumes and name != "tau_s"]
    ways = []
    if volumes:
        ways.append(f"a second total flow, or {_symbol(volumes[0])} as side information")
    if others:
        ways.append(f"{_symbol(others[0])} measured elsewhere, as side information")
    if "tau_s" in names:
        ways.append('[rig] sensor_is = "faster" or "slower"')
    said = volumes or "tau_s" in names
    return Inseparable.of(
        names,
        "the response does not depend on their order",
        ", or ".join(ways),
        "said" if said else "warning",
    )


def volumes_without_names(problem: Problem) -> Inseparable | None:
    """Volumes that commute at every flow and of which nothing is known from elsewhere."""
    if problem.commuting.flow is not None:
        return None
    names = [name for name in volumes_that_commute(problem) if name not in problem.named_laws]
    if len(names) < 2 or len(names) < len(volumes_that_commute(problem)):
        return None
    return Inseparable.of(
        names,
        "volumes in a row commute at every flow, so which value is whose is not known; they are "
        "given by size, the smallest first",
        f"{_symbol(names[0])} measured elsewhere, as side information",
        "caveat",
    )


def volumes_that_commute(problem: Problem) -> tuple[str, ...]:
    """Flat names of the volumes with one lag each."""
    layout = problem.layout
    return tuple(
        name
        for name in layout.rig.lags_that_commute(True)
        if name.startswith("V_") and name in layout.shared_names and layout.alone(name)
    )


def common_to_sensors(problem: Problem, vector: FloatArray) -> Inseparable | None:
    """The sensors' lags and one that they share, if the sensors' agree within their errors.

    A common lag of all sensors may then exchange its value with the shared one.  ``vector``
    (n_theta,): the fit.  The squares are compared, whose information is regular.
    """
    layout = problem.layout
    if layout.ties and layout.n_own:  # do the data tell the sensors' lags apart without the ties?
        values = layout.nested(vector)
        problem = replace(problem, campaign=replace(problem.campaign, ties=()))
        layout, vector = problem.layout, problem.layout.flat(values)
    n = layout.n_own
    shared = [name for name in layout.rig.lags_that_commute() if name != "tau_s"]
    known = [name for name in layout.shared_names[:n] if name in problem.named_laws]
    if n < 2 or not shared or known or any(name in problem.named_laws for name in shared):
        return None
    vector = vector.copy()
    longest = float(vector[:n].max())
    vector[:n] = np.maximum(vector[:n], SHORTEST * longest)
    free = np.array([i for i, name in enumerate(layout.names) if name not in problem.fixed])
    information = expected_information(problem, vector)[np.ix_(free, free)]
    size = np.ones(len(free))
    size[:n] = 0.5 / vector[:n]
    cov = covariance_of(information * np.outer(size, size))
    to_first = np.hstack([-np.ones((n - 1, 1)), np.eye(n - 1)])
    difference = to_first @ vector[:n] ** 2
    spread = to_first @ cov[:n, :n] @ to_first.T
    if float(difference @ np.linalg.solve(spread, difference)) >= AS_GOOD:
        return None
    return Inseparable.of(
        (*layout.shared_names[:n], *shared),
        "the sensors' lags agree within their errors, and a common lag of the sensors and one that "
        "they share may exchange their values",
        f"{_symbol(shared[0])} measured elsewhere, as side information, or a sensor of another "
        "speed",
        "caveat",
    )


def exchanged(twin: Twin) -> Inseparable:
    """A lag and a volume of which another pair fits as well."""
    pair = (twin.lag, twin.volume)
    volume = _symbol(twin.volume)
    measure = f"total flows further apart, or {volume} measured elsewhere, as side information"
    return Inseparable(pair, measure, f"{twin.sentence()}; to tell them apart: {measure}")


def left_open(problem: Problem, vector: FloatArray) -> list[Inseparable]:
    """Groups of parameters that the expected information at ``vector`` (n_theta,) leaves open."""
    layout, commuting = problem.layout, problem.commuting
    n = layout.n_mean
    vector = vector.copy()
    flow = float(np.median([e.total_flow for e in problem.campaign]))
    longest = max(layout.slowest(vector, k, e.total_flow) for k, e in enumerate(problem.campaign))
    groups = _groups(problem)
    to_lag = {
        i: 1.0 / (commuting.flow or flow) if name.startswith("V_") else 1.0
        for i, name in enumerate(layout.shared_names)
    }
    for places in groups:
        factors = np.array([to_lag[i] for i in places])
        lags = np.maximum(vector[places] * factors, SHORTEST * longest)
        order = np.argsort(lags)
        lags[order] = np.sqrt(apart_squares(lags[order] ** 2))
        vector[places] = lags / factors
    own = _coordinates(problem, vector, groups, to_lag, longest)
    free = [i for i, name in enumerate(layout.mean_names) if name not in problem.held]
    information = expected_information(problem, vector)[:n, :n]
    scaled = (own.T @ information @ own)[np.ix_(free, free)]
    values, directions = np.linalg.eigh(scaled)
    rounding = len(free) * np.finfo(float).eps * max(float(values[-1]), 0.0)
    known = max(LEAST_KNOWN, rounding)
    names, found = layout.mean_names, dict[tuple[str, ...], None]()
    for value, direction in zip(values, directions.T, strict=True):
        if value >= max(1.0, rounding):
            break
        lost = {free[i] for i in np.flatnonzero(direction**2 > max(float(value), known))}
        for places in groups:  # a polynomial is of all of them
            if lost & set(places):
                lost |= set(places)
        if len(lost) > 1:
            found[tuple(names[i] for i in sorted(lost))] = None
    return [
        Inseparable.of(group, "they leave a whole direction of them open", _measure(group, problem))
        for group in found
    ]


def _groups(problem: Problem) -> list[list[int]]:
    """Positions of parameters with one lag each, those that commute together."""
    layout, commuting = problem.layout, problem.commuting
    places = {name: i for i, name in enumerate(layout.shared_names)}
    groups = [list(commuting.places)] if commuting.places else []
    volumes = [places[name] for name in volumes_that_commute(problem)]
    rest = [i for i in volumes if i not in commuting.places]
    groups += [rest] if rest else []
    return groups + [[i] for i in range(layout.n_own)]


def _coordinates(
    problem: Problem,
    vector: FloatArray,
    groups: list[list[int]],
    to_lag: dict[int, float],
    longest: float,
) -> FloatArray:
    """(n_mean, n_mean) derivatives of theta by the coordinates, in their natural sizes."""
    layout = problem.layout
    n = layout.n_mean
    found = np.zeros((n, n))
    for i, name in enumerate(layout.mean_names):
        kind = name.partition("[")[0]
        if i < layout.n_shared or is_switch_time(kind):
            found[i, i] = longest / to_lag.get(i, 1.0)
    for row in layout.local:
        size = abs(float(vector[row[1]]))
        found[row[0], row[0]] = found[row[1], row[1]] = size
    delays = _delays(problem)
    for places in groups:
        factors = np.array([to_lag[i] for i in places])
        squares = (vector[places] * factors / longest) ** 2
        by_square = 0.5 * longest / np.sqrt(squares)  # of the lag, s
        by_polynomial = by_square[:, None] * np.linalg.inv(polynomial_slopes(squares))
        block = by_polynomial / factors[:, None]
        found[np.ix_(places, places)] = block
        for i in layout.all_switches:
            found[i, places] = -delays[i, places] @ block
    return found


def _delays(problem: Problem) -> FloatArray:
    """(n_mean, n_mean) how far a response is later by each lag or volume, by its switch times."""
    layout = problem.layout
    n = layout.n_mean
    found = np.zeros((n, n))
    for k, e in enumerate(problem.campaign):
        for i in layout.switches(k):
            for j in range(layout.n_own, layout.n_shared):
                volume = layout.shared_names[j].startswith("V_")
                found[i, j] = 1.0 / e.total_flow if volume else 1.0
    return found


def _measure(names: Sequence[str], problem: Problem) -> str:
    """What would tell a group of parameters apart."""
    kinds = [name.partition("[")[0] for name in names]
    volume = any(kind.startswith("V_") for kind in kinds)
    lag = volume or any(kind.startswith("tau") for kind in kinds)
    level = any(kind in ("y0_V", "beta_V") for kind in kinds)
    switch = any(is_switch_time(kind) for kind in kinds)
    if level and lag:
        falls = all(e.has_fall or e.commands is not None for e in problem.campaign)
        return "a longer record, in which the response settles" + (
            "" if falls else ", or a step down"
        )
    if level:
        return "samples well before and well after the step"
    if volume and sum(kind.startswith(("V_", "tau")) for kind in kinds) > 1:
        return "total flows further apart, or the volume measured elsewhere, as side information"
    if switch and lag:
        return "faster sampling, or a switch time known to less than the lag"
    if lag:
        return "faster sampling or more steps, or a lag measured elsewhere, as side information"
    return "a longer time between the switches"
