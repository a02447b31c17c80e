"""Priors and fixed values as a user writes them: ``normal(60, 2) mL``, ``0.86 s``."""

from __future__ import annotations

import difflib
import re
from collections.abc import Mapping
from typing import Any

from bayes_sensor.campaign import CampaignError
from bayes_sensor.io.readers.quantities import (
    TIME,
    VOLUME,
    Kind,
    in_range,
    read_number,
    read_quantity,
    read_spread,
)
from bayes_sensor.likelihood.priors import Prior
from bayes_sensor.rig.layout import Layout
from bayes_sensor.rig.named_values import unit_of

_KINDS = ("half-normal", "log-normal", "normal", "uniform", "log-uniform", "flat")
_CALL = re.compile(r"\s*([A-Za-z_-]+)\s*(?:\(([^()]*)\))?\s*(\S.*)?", re.DOTALL)
_UNIT = re.compile(r"_(s|mL|V)(?=\[|$)")
_NUMBER = re.compile(r"[-+0-9.eE]+")


def _kind_of(name: str, unit: str) -> Kind | None:
    """The kind of a parameter; None for one without a unit, such as phi."""
    own = unit_of(name.split("[")[0], unit)
    if own == "1":
        return None
    if own == "mL":
        return VOLUME
    if own == "s":
        return Kind(TIME.name, TIME.unit, "48 ms")
    return Kind("a signal", own, f"0.05 {own}")


def flat_names(key: str, layout: Layout, where: str) -> list[str]:
    """The flat names that a key stands for: ``tau``, ``t0`` (all experiments) or ``t0[4]``.

    Raises CampaignError, with the nearest known key, if there are none; and for one that is tied.
    """
    short: dict[str, list[str]] = {}
    for name in layout.names:
        kind, bracket, rest = name.partition("[")
        plain = _UNIT.sub("", kind)
        for alias in {plain, kind}:
            short.setdefault(alias, []).append(name)
            if bracket:
                short.setdefault(f"{alias}[{rest}", []).append(name)
    if key in short:
        return short[key]
    for name, (to, _) in layout.sources.items():
        if key in (name, _UNIT.sub("", name)):
            raise CampaignError(
                f"{where}: it is tied to {to}; expected a parameter that is free: write "
                f'"{_UNIT.sub("", to)}" or remove the tie'
            )
    known = sorted({_UNIT.sub("", n.split("[")[0]) for n in layout.names})
    close = difflib.get_close_matches(key, [k for k in short if "_" not in k[-3:]], n=1, cutoff=0.5)
    hint = f'write "{close[0]}"' if close else f"known are {', '.join(known)}"
    raise CampaignError(f"{where}: unknown parameter '{key[:80]}'; {hint}")


def check_by_name(given: Any, where: str) -> None:
    """Raise CampaignError unless what is given is a mapping by the names of parameters."""
    if not isinstance(given, Mapping):
        raise CampaignError(
            f"{where}: expected a mapping by the names of parameters, but got a "
            f'{type(given).__name__}; write for example {{"tau": ..}}'
        )


def read_value(text: str | float, name: str, unit: str, where: str) -> float:
    """The number of a parameter's value as text with its unit; a number is taken as it is.

    ``name``: the flat name; ``unit``: of the signal.

    >>> read_value("860 ms", "tau_v_s", "V", "fix")
    0.86
    """
    if not isinstance(text, str):
        if isinstance(text, bool) or not in_range(text):
            raise CampaignError(
                f"{where}: expected a finite number of a size that occurs, but got "
                f"{str(text)[:40]}; correct it"
            )
        return float(text)
    return _value(text, _kind_of(name, unit), where)


def _value(text: str, kind: Kind | None, where: str) -> float:
    if kind is not None:
        return read_quantity(text, kind, where)
    value = read_number(text)
    if value is None:
        raise CampaignError(
            f"{where}: expected a number of a size that occurs, but got '{text[:60]}'; write 0.5"
        )
    return value


def read_prior(text: str, name: str, unit: str, where: str) -> Prior:
    """The prior that a text such as ``half-normal(200 ms)`` or ``normal(60, 2) mL`` stands for.

    >>> read_prior("log-normal(850 ms, 1.5)", "tau_v_s", "V", "tau_v")
    Prior(kind='log_normal', a=0.85, b=1.5)
    >>> read_prior("normal(60, 2) mL", "V_mL", "V", "V")
    Prior(kind='normal', a=60.0, b=2.0)
    """
    kind = _kind_of(name, unit)
    if kind is not None and ("+-" in text or "+/-" in text or "\N{PLUS-MINUS SIGN}" in text):
        return Prior("normal", *read_spread(text, kind, where))
    match = _CALL.fullmatch(text)
    example = 'half-normal(200 ms)"' if name.endswith("_s") else 'uniform(low, high)"'
    law = "" if match is None else match[1].casefold().replace("_", "-")
    if match is None or law not in _KINDS:
        raise CampaignError(
            f"{where}: expected a prior such as \"{example}, but got '{text[:80]}'; "
            f"known are {', '.join(_KINDS)}"
        )
    parts = [part.strip() for part in (match[2] or "").split(",") if part.strip()]
    wanted = {"flat": 0, "half-normal": 1}.get(law, 2)
    if len(parts) != wanted:
        raise CampaignError(
            f"{where}: {law} takes {wanted} numbers, but got {len(parts)} in '{text[:80]}'; "
            "correct it"
        )
    second = None if law == "log-normal" else kind
    if match[3]:  # the unit of all, behind the brackets
        if kind is None or not all(_NUMBER.fullmatch(part) for part in parts):
            raise CampaignError(
                f"{where}: expected one unit for every number, but got '{text[:80]}'; write "
                '"normal(60, 2) mL" or "normal(60 mL, 2 mL)", and no unit where there is none'
            )
        units = (kind, second)
        parts = [p if k is None else f"{p} {match[3]}" for p, k in zip(parts, units, strict=False)]
    bare = [p for p, k in zip(parts, (kind, second), strict=False) if k and _NUMBER.fullmatch(p)]
    if kind is not None and bare:
        unit = kind.example.split()[-1]
        meant = ", ".join(f"{part} {unit}" if part in bare else part for part in parts)
        raise CampaignError(
            f"{where}: expected {kind.name} with its unit, but got '{bare[0]}' in '{text[:80]}'; "
            f'add the unit that is meant, as in "{match[1]}({meant})"'
        )
    values = [_value(p, k, where) for p, k in zip(parts, (kind, second), strict=False)]
    if law in ("uniform", "log-uniform") and not values[0] < values[1]:
        raise CampaignError(f"{where}: expected low < high, but got '{text[:80]}'; swap them")
    must_be_positive = {"half-normal": 0, "log-normal": 0, "log-uniform": 0, "normal": 1}
    if law in must_be_positive and not min(values[must_be_positive[law] :]) > 0:
        raise CampaignError(
            f"{where}: expected positive numbers, but got '{text[:80]}'; correct it"
        )
    return Prior(law.replace("-", "_"), *values)


def read_bounds(
    given: Mapping[str, Any], layout: Layout, unit: str, where: str
) -> dict[str, tuple[float, float]]:
    """Search bounds by flat name, from pairs of numbers or of texts with units.

    Keys as of :func:`read_priors`; numbers are in s, mL and the signal's ``unit``.

    Raises
    ------
    CampaignError
        For an unknown name, and for anything but a low value and a high one.
    """
    found: dict[str, tuple[float, float]] = {}
    check_by_name(given, where)
    for key, pair in given.items():
        here = f"{where} {key}"
        if isinstance(pair, str) or not hasattr(pair, "__len__") or len(pair) != 2:
            raise CampaignError(
                f"{here}: expected low and high, but got {str(pair)[:80]}; "
                'write for example ["1 ms", "1 s"]'
            )
        for name in flat_names(str(key), layout, here):
            low, high = (read_value(v, name, unit, here) for v in pair)
            if not low < high:
                raise CampaignError(
                    f"{here}: expected low < high, but got {str(pair)[:80]}; swap them"
                )
            found[name] = (low, high)
    return found


def prior_of_law(value: Any) -> Prior | None:
    """The prior that is a frozen distribution of ``scipy.stats``; None for anything else.

    Known are ``norm``, ``halfnorm``, ``lognorm``, ``uniform`` and ``loguniform``, with ``loc`` 0
    where the law of this package has none.

    >>> from scipy import stats
    >>> prior_of_law(stats.norm(60.0, 2.0))
    Prior(kind='normal', a=60.0, b=2.0)
    """
    family = getattr(getattr(value, "dist", None), "name", "")
    if not family or not hasattr(value, "kwds"):
        return None
    shapes, loc, scale = value.dist._parse_args(*value.args, **value.kwds)
    if family == "norm":
        return Prior("normal", float(loc), float(scale))
    if family == "uniform":
        return Prior("uniform", float(loc), float(loc + scale))
    if loc != 0.0:
        return None
    if family == "halfnorm":
        return Prior("half_normal", float(scale))
    if family == "lognorm":
        return Prior("log_normal", float(scale), float(shapes[0]))
    if family in ("loguniform", "reciprocal"):
        return Prior("log_uniform", float(scale * shapes[0]), float(scale * shapes[1]))
    return None


def read_priors(
    given: Mapping[str, Any], layout: Layout, unit: str, where: str
) -> dict[str, Prior]:
    """Priors by flat name, from texts, :class:`Prior` objects or frozen laws of ``scipy.stats``
    (:func:`prior_of_law`).

    Keys are names with or without their unit, ``t0`` for all experiments or ``t0[4]`` for one;
    objects are in s, mL and the signal's ``unit``.

    Raises
    ------
    CampaignError
        For an unknown name, or what is no prior.
    """
    priors: dict[str, Prior] = {}
    check_by_name(given, where)
    # a key for one experiment wins over one for all, whatever their order
    for key in sorted(given, key=lambda k: "[" in str(k)):
        value, here = given[key], f"{where} {key}"
        for name in flat_names(str(key), layout, here):
            if isinstance(value, str):
                priors[name] = read_prior(value, name, unit, here)
                continue
            made = value if isinstance(value, Prior) else prior_of_law(value)
            if made is None:
                raise CampaignError(
                    f"{here}: expected a prior, but got a {type(value).__name__}; write a text "
                    'such as "normal(60, 2) mL", a bayes_sensor.Prior, or a frozen law of '
                    "scipy.stats (norm, halfnorm, lognorm, uniform, loguniform)"
                )
            priors[name] = made
    return priors
