"""Parameters that are held at a value: read, checked, and refused where they are not carried."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

from bayes_sensor.campaign import CampaignError
from bayes_sensor.likelihood.prior_text import check_by_name, flat_names, read_value
from bayes_sensor.likelihood.problem import Problem
from bayes_sensor.rig.layout import NOISE
from bayes_sensor.rig.named_values import unit_of

_FREE = ("y0_V", "beta_V", *NOISE)
"""kinds of parameters that cannot be held"""


def held_values(problem: Problem, given: Mapping[str, str | float], where: str) -> Problem:
    """The problem with parameters held at a value, which have no dimension in fit and posterior.

    Parameters
    ----------
    given
        by name with or without its unit, ``t0`` for all experiments or ``t0[4]`` for one: texts
        with units, or numbers in s and mL.  The lags and volumes of the rig can be held, but for
        the sensor's, and switch times.

    Raises
    ------
    CampaignError
        For an unknown name, a value that cannot be, a parameter that cannot be held, or a lag of
        which it is not known which one it is.
    """
    held: dict[str, float] = {}
    check_by_name(given, where)
    for key in sorted(given, key=lambda k: "[" in k):
        here = f"{where} {key}"
        for name in flat_names(key, problem.layout, here):
            held[_place(problem, name, here)] = _value(problem, given[key], name, here)
    return replace(problem, held=held)


def _place(problem: Problem, name: str, here: str) -> str:
    kind = name.split("[")[0]
    if kind == "tau_s":
        raise CampaignError(
            f"{here}: tau is what is measured, and cannot be held; give it a prior, or side "
            "information"
        )
    if kind in _FREE or name in problem.layout.extra:
        raise CampaignError(
            f"{here}: expected a lag, a volume or a switch time, which can be held; give "
            f"{key_of(kind)} a prior"
        )
    if name in problem.named_laws:
        raise CampaignError(
            f"{here}: it is held, and has a prior or side information as well; expected one of "
            "them: remove the other"
        )
    place = problem.place_of(name)
    if place is None:
        raise CampaignError(
            f"{here}: it is not known which of the lags that is; expected [rig] sensor_is = "
            '"faster" or "slower", and experiments at more than one flow: say it, or give side '
            "information in place of a held value"
        )
    return place


def _value(problem: Problem, given: str | float, name: str, here: str) -> float:
    value = read_value(given, name, problem.campaign.signal_unit, here)
    rest = name.partition("[")[2]
    if not rest and not value > 0.0:
        raise CampaignError(f"{here}: expected a positive value, but got '{given}'; correct it")
    if rest:
        e = problem.campaign[rest.removesuffix("]")]
        if not e.t[0] <= value <= e.t[-1]:
            raise CampaignError(
                f"{here}: {value:.10g} s lies outside the record, which runs from {e.t[0]:.10g} to "
                f"{e.t[-1]:.10g} s; expected a time on the record's own axis"
            )
    return value


def key_of(name: str) -> str:
    """A flat name as settings write it, without the unit."""
    kind, bracket, rest = name.partition("[")
    short = kind if unit_of(kind, "V") == "1" else kind.rpartition("_")[0]
    return f"{short}{bracket}{rest}"


def held_words(problem: Problem) -> str:
    """What is held, in words; empty where nothing is.

    The names are those of places in theta, which hold lags by size.
    """
    unit = problem.campaign.signal_unit
    names = {problem.place_of(name) or name: name for name in problem.layout.names}
    return ", ".join(
        f"{key_of(names[place])} = {value:g} {unit_of(place.split('[')[0], unit)}"
        for place, value in problem.held.items()
    )


def refuse_held(problem: Problem, what: str) -> None:
    """Raise CampaignError where parameters are held, which ``what`` does not carry."""
    if problem.held:
        raise CampaignError(
            f"{what}: not computed where parameters are held ({held_words(problem)}), which act on "
            "fit and posterior alone; expected all to vary: leave fix out, or give side information"
        )
