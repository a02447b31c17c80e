"""What a stage of the rig is: its parameter, and what it puts into the chain at a total flow."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import NamedTuple

from bayes_sensor.campaign import CampaignError, FloatArray

Value = float | FloatArray
"""of a parameter or a flow: a number, or an array of draws"""


class Passage(NamedTuple):
    """First-order lags (s) in a row, and a delay (s); or the derivatives of both."""

    lags: tuple[Value, ...] = ()
    delay: Value = 0.0


LONGEST_NAME = 40
"""characters of a stage's name, which stands in the names of columns and axes"""


@dataclass(frozen=True)
class StageKind:
    """A kind of stage: one parameter, and how the gas passes at a value of it and a total flow.

    ``passage`` and ``slope`` take the value and the total flow in mL/s (nan where no stage of the
    rig depends on it); ``slope`` is the derivative of ``passage`` by the value.

    >>> from bayes_sensor.rig.stages import KINDS
    >>> KINDS["volume"].passage(60.0, 75.0)
    Passage(lags=(0.8,), delay=0.0)
    """

    name: str
    symbol: str
    """of the parameter, with which its name begins"""
    unit: str
    """of the parameter, with which its name ends"""
    depends_on_flow: bool
    passage: Callable[[Value, Value], Passage] = field(repr=False)
    slope: Callable[[Value, Value], Passage] = field(repr=False)
    words: Mapping[str, str] = field(default_factory=dict, repr=False)
    """names of stages that are of this kind without saying so -> what their parameter is called by
    between symbol and unit; '' for nothing"""


@dataclass(frozen=True)
class Stage:
    """A named stage of some kind.

    Raises CampaignError where the name would not make the name of a parameter.

    >>> from bayes_sensor.rig.stages import KINDS
    >>> [Stage(name, KINDS["lag"]).parameter for name in ("sensor", "valve", "probe")]
    ['tau_s', 'tau_v_s', 'tau_probe_s']
    """

    name: str
    kind: StageKind

    def __post_init__(self) -> None:
        name, words = self.name, self.kind.words
        plain = name.isascii() and name.replace("_", "").isalnum() and name[0].isalpha()
        if not plain or len(name) > LONGEST_NAME:
            raise CampaignError(
                f"stage '{name[:LONGEST_NAME]}': expected a name of letters, digits and '_' that "
                f"begins with a letter, of at most {LONGEST_NAME} characters; rename it"
            )
        taken = [word for word, label in words.items() if label == name != word]
        if taken:
            raise CampaignError(
                f"stage '{name}': that is what the {taken[0]}'s parameter is called by; write "
                f"'{taken[0]}' or rename it"
            )

    @property
    def label(self) -> str:
        """What its parameter is called by, between symbol and unit; '' for nothing."""
        return self.kind.words.get(self.name, self.name)

    @property
    def parameter(self) -> str:
        """Flat name of its parameter, with the unit."""
        return "_".join(part for part in (self.kind.symbol, self.label, self.kind.unit) if part)
