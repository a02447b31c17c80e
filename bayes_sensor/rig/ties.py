"""Ties as a user writes them: a lag or volume that is another one, or a multiple of it."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import replace
from math import isfinite

from bayes_sensor.campaign import Campaign, CampaignError, Tie
from bayes_sensor.rig.layout import Layout

_TEXT = re.compile(r"\s*(?:([-+0-9.eE]+)\s*\*)?\s*(.*\S)\s*", re.DOTALL)


def tie_parameters(campaign: Campaign, given: Mapping[str, str], where: str) -> Campaign:
    """The campaign with lags and volumes tied as texts say, in place of its own ties.

    ``given``: such as ``{"tau[B]": "2 * tau[A]"}``, names with or without their unit.  Of those
    that are tied together the first stays; of sensors that all have one lag, ``tau``.

    Raises
    ------
    CampaignError
        For an unknown name, a lag tied to a volume, a factor that is no positive number, a circle,
        or ties that leave values to be exchanged.
    """
    layout = Layout.of(replace(campaign, ties=()))
    ties = read_ties(given, layout.value_names, where)
    own = layout.value_names[: len(layout.sensor_names)]
    to = {tie.name: (tie.to, tie.factor) for tie in ties}
    if len(own) > 1 and len({to.get(name, (name, 1.0)) for name in own}) == 1:
        common = layout.rig.names[0]
        ties = (
            Tie(own[0], common, 1.0),
            *(tie._replace(to=common) if tie.to == own[0] else tie for tie in ties),
        )
    tied = replace(campaign, ties=ties)
    _check_exchange(Layout.of(tied), campaign.same_flow, where)
    return tied


def read_ties(given: Mapping[str, str], names: Sequence[str], where: str) -> tuple[Tie, ...]:
    """What texts say of lags and volumes ``names``.

    >>> read_ties({"tau[A]": "2 * tau[B]"}, ("tau_s[A]", "tau_s[B]"), "tie")
    (Tie(name='tau_s[B]', to='tau_s[A]', factor=0.5),)

    Raises CampaignError as :func:`tie_parameters`.
    """
    known = {alias: name for name in names for alias in (name, _short(name))}
    links: dict[str, tuple[str, float]] = {}
    for key, text in given.items():
        here = f"{where} {key[:80]}"
        match = _TEXT.fullmatch(str(text))
        if match is None:
            raise CampaignError(
                f"{here}: expected the name of a parameter, but got nothing; write for example "
                f"{_example(names)}"
            )
        for word in (key, match[2]):
            if word not in known:
                raise CampaignError(
                    f"{here}: expected a lag or a volume of the rig "
                    f"({', '.join(map(_short, names))}), but got '{word[:80]}'; write for example "
                    f"{_example(names)}"
                )
        name, to, factor = known[key], known[match[2]], _factor(match[1], here)
        if _unit(name) != _unit(to):
            raise CampaignError(
                f"{here}: expected a parameter in {_unit(name)}, but {match[2]} is in {_unit(to)}; "
                "tie a lag to a lag, a volume to a volume"
            )
        if name in links:
            raise CampaignError(f"{here}: it is tied twice; expected one tie: remove one")
        links[name] = to, factor
    found: dict[str, tuple[str, float]] = {}
    for name in names:
        at, times, passed = name, 1.0, [name]
        while at in links:
            at, own = links[at]
            times *= own
            if at in passed:
                raise CampaignError(
                    f"{where} {_short(name)}: the ties go in a circle "
                    f"({', '.join(map(_short, passed))}); expected one of them to be free: remove "
                    "a tie"
                )
            passed.append(at)
        found[name] = at, times
    first: dict[str, tuple[str, float]] = {}
    for name, (at, times) in found.items():
        first.setdefault(at, (name, times))
    return tuple(
        Tie(name, first[at][0], times / first[at][1])
        for name, (at, times) in found.items()
        if name != first[at][0]
    )


def _check_exchange(layout: Layout, same_flow: bool, where: str) -> None:
    """Raise CampaignError where lags are tied to each other in one chain so that the values of its
    parameters may be exchanged."""
    for stages in layout.stage_sources:
        groups: dict[str, dict[int, list[float]]] = {}
        for (place, factor), kind in zip(stages, layout.rig.kinds, strict=True):
            group = groups.setdefault("" if same_flow else kind, {})
            group.setdefault(place, []).append(factor)
        for group in groups.values():
            several = [factors for factors in group.values() if len(factors) > 1]
            equal = len(several) == 1 and len(set(several[0])) == 1
            if several and not equal and len(group) > 1:
                names = ", ".join(_short(layout.shared_names[place]) for place in group)
                raise CampaignError(
                    f"{where}: with these ties the values of {names} may be exchanged without a "
                    "change of the response; expected at most one group of equal lags in a chain "
                    "with others: leave out the factor, or a tie"
                )


def tie_texts(ties: Sequence[Tie]) -> dict[str, str]:
    """The ties as :func:`tie_parameters` reads them.

    >>> tie_texts((Tie("tau_s[A]", "tau_s", 1.0), Tie("tau_s[B]", "tau_s", 1.0)))
    {'tau[B]': 'tau[A]'}
    """
    common = {tie.to: tie.name for tie in reversed(ties) if tie.name.startswith(f"{tie.to}[")}
    texts = {}
    for name, to, factor in ties:
        if common.get(to) != name:
            times = "" if factor == 1.0 else f"{factor!r} * "
            texts[_short(name)] = f"{times}{_short(common.get(to, to))}"
    return texts


def refuse_ties(campaign: Campaign, what: str) -> None:
    """Raise CampaignError where parameters are tied, which ``what`` does not carry."""
    if campaign.ties:
        said = ", ".join(f"{name} = {to}" for name, to in tie_texts(campaign.ties).items())
        raise CampaignError(
            f"{what}: not computed where parameters are tied ({said}); expected all to vary: leave "
            "tie out"
        )


def _factor(text: str | None, here: str) -> float:
    try:
        value = 1.0 if text is None else float(text)
    except ValueError:
        value = 0.0
    if not (value > 0.0 and isfinite(value)):
        raise CampaignError(f"{here}: expected a positive factor, but got '{text}'; correct it")
    return value


def _short(name: str) -> str:
    """A flat name as settings write it, without the unit."""
    kind, bracket, rest = name.partition("[")
    return f"{kind.rpartition('_')[0]}{bracket}{rest}"


def _unit(name: str) -> str:
    return name.partition("[")[0].rpartition("_")[2]


def _example(names: Sequence[str]) -> str:
    """A tie that these names allow."""
    alike = [name for name in names if _unit(name) == _unit(names[0])]
    pair = alike if len(alike) > 1 else ("tau_s[A]", "tau_s[B]")
    return f'"{_short(pair[1])}" = "{_short(pair[0])}"'
