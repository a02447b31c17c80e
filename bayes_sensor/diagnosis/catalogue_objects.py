"""Effects, forms and signals of the package by name: records refer to them, and do not hold them.

They hold functions without a name of their own, and are told by identity.  ``pickle`` writes them
by name, too, so that a :class:`~bayes_sensor.diagnosis.gap.Gap` or a posterior with effects goes to
another process and comes back.
"""

from __future__ import annotations

import copyreg
from collections.abc import Callable
from functools import cache
from typing import Any

from bayes_sensor.diagnosis.effects import CATALOGUE
from bayes_sensor.diagnosis.effects.effect import Effect, Form, OnNoise
from bayes_sensor.diagnosis.evidence.varying_parameter import RIVALS
from bayes_sensor.diagnosis.signals import SIGNALS
from bayes_sensor.diagnosis.signals.signal import Signal


@cache
def catalogue_objects() -> dict[str, Any]:
    """By name, everything that is the same in every process."""
    known: dict[str, Any] = {f"effect {name}": effect for name, effect in CATALOGUE.items()}
    # of an effect that a rig has in some of its forms, or under other words, these are the same
    for name, effect in CATALOGUE.items():
        known |= {f"form {i} of {name}": form for i, form in enumerate(effect.forms)}
        if effect.on_noise is not None:
            known[f"noise of {name}"] = effect.on_noise
    for name, rival in RIVALS.items():
        known |= {f"form {i} of rival {name}": form for i, form in enumerate(rival.forms)}
    return known | {f"signal {signal.name}": signal for signal in SIGNALS}


def catalogue_object(name: str) -> Any:
    """One of :func:`catalogue_objects`."""
    return catalogue_objects()[name]


@cache
def _names() -> dict[int, str]:
    return {id(value): name for name, value in catalogue_objects().items()}


def _reduced(value: Any) -> tuple[Callable[..., Any], Any] | tuple[Any, ...]:
    """What ``pickle`` writes: the name, or the fields of one that is not the package's own."""
    name = _names().get(id(value))
    if name is not None:
        return catalogue_object, (name,)
    found: tuple[Any, ...] = object.__reduce_ex__(value, 2)  # type: ignore[assignment]
    return found


def pickle_by_name() -> None:
    """Let ``pickle`` write the package's own effects, forms and signals by name."""
    for kind in (Effect, Form, OnNoise, Signal):
        copyreg.pickle(kind, _reduced)
