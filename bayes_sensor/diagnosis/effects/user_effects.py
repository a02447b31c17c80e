"""A user's own effects, read from a Python file that the user names."""

from __future__ import annotations

import importlib.util
from pathlib import Path

from bayes_sensor.campaign import CampaignError
from bayes_sensor.diagnosis.effects.effect import Effect


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
