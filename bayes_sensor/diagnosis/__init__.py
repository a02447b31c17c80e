"""The gap between model and data: where it is, which effect explains it, how much that closes."""

from bayes_sensor.diagnosis.catalogue_objects import pickle_by_name
from bayes_sensor.diagnosis.diagnose import diagnose_gap
from bayes_sensor.diagnosis.effects import CATALOGUE
from bayes_sensor.diagnosis.effects.effect import Effect, Form, OnNoise, Strength
from bayes_sensor.diagnosis.effects.rig_view import RigView
from bayes_sensor.diagnosis.effects.setting import Setting
from bayes_sensor.diagnosis.effects.user_effects import own_effect
from bayes_sensor.diagnosis.gap import Gap

pickle_by_name()

__all__ = [
    "CATALOGUE",
    "Effect",
    "Form",
    "Gap",
    "OnNoise",
    "RigView",
    "Setting",
    "Strength",
    "diagnose_gap",
    "own_effect",
]
