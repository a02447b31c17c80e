"""A user's own effects: made from one function, or read from a Python file that the user names."""

from __future__ import annotations

import importlib.util
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from bayes_sensor.campaign import CampaignError, FloatArray
from bayes_sensor.diagnosis.effects.effect import Effect, Form, Strength
from bayes_sensor.diagnosis.effects.rig_view import RigView
from bayes_sensor.diagnosis.effects.setting import Setting

NEAR = 3.0
"""spreads from the centre within which an effect of one's own must have a mean"""


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
        returns something else than finite values.
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
        strengths=_Fixed(fixed),
        settings=_no_settings,
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


@dataclass(frozen=True)
class _Fixed:
    """The same strengths for every campaign; a function would not go to another process."""

    strengths: tuple[Strength, ...]

    def __call__(self, setting: Setting) -> tuple[Strength, ...]:
        return self.strengths


def _no_settings(values: Mapping[str, float], setting: Setting) -> Mapping[str, float]:
    return {}


def _default_starts(strengths: Sequence[Strength]) -> tuple[Mapping[str, float], ...]:
    """The centres; with several strengths, amplitudes centred at 0 start at +-1 sd.

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
                f"effect {self.effect}: expected finite values from its function, but got "
                f"{found[i]} at t = {t[i]:.10g} s of experiment '{rig.experiment.name}' with {at}; "
                "correct it"
            )
        return found

    def _likely(self, values: Mapping[str, float]) -> bool:
        """Whether all strengths are near their centres: a fit on its way may try any others."""
        return all(abs(s.coordinate(values[s.name])) <= NEAR for s in self.strengths)


def read_effects(path: str | Path) -> list[Effect]:
    """All effects that a Python file defines at its top level (``EFFECT = own_effect(..)``).

    The file is executed, so only name files you trust.

    Raises
    ------
    CampaignError
        If the file cannot be read or run, or defines no effect.
    """
    path = Path(path)
    if not path.is_file():
        raise CampaignError(f"{path}: there is no such file; expected Python code with an effect")
    spec = importlib.util.spec_from_file_location(f"own_effects_{path.stem}", path)
    if spec is None or spec.loader is None:
        raise CampaignError(f"{path}: expected a Python file with the ending .py; rename it")
    module = importlib.util.module_from_spec(spec)
    try:
        spec.loader.exec_module(module)
    except CampaignError:
        raise
    except Exception as error:  # whatever the user's code raises is the user's to see
        raise CampaignError(
            f"{path}: the code of the effect stops with {type(error).__name__}: {error}; correct it"
        ) from error
    found = [v for name, v in vars(module).items() if isinstance(v, Effect) and name[:1] != "_"]
    if not found:
        raise CampaignError(
            f"{path}: it defines no effect; expected a line such as EFFECT = own_effect(..)"
        )
    return found
