"""The sim-to-real gap: where the model misses, which effect causes it, how far it shrinks."""

from bayes_sensor.diagnosis.diagnose import diagnose_gap
from bayes_sensor.diagnosis.effects import CATALOGUE
from bayes_sensor.diagnosis.effects.effect import (
    Effect,
    Form,
    RigView,
    Setting,
    Strength,
    own_effect,
)
from bayes_sensor.diagnosis.gap import Gap

__all__ = [
    "CATALOGUE",
    "Effect",
    "Form",
    "Gap",
    "RigView",
    "Setting",
    "Strength",
    "diagnose_gap",
    "own_effect",
]
