"""Bounds on the parameters by every method, side by side: see :func:`compare_bounds`."""

from bayes_sensor.bounds.bound import LEVELS, Bound
from bayes_sensor.bounds.bounds_table import Bounds
from bayes_sensor.bounds.compare import compare_bounds
from bayes_sensor.bounds.cramer_rao import CramerRao, cramer_rao, step_study
from bayes_sensor.bounds.hardness import TauExplained, explain_tau
from bayes_sensor.bounds.methods import METHODS, BoundMethod, method_of
from bayes_sensor.bounds.profile import Profiler, profile_curve

__all__ = [
    "LEVELS",
    "METHODS",
    "Bound",
    "BoundMethod",
    "Bounds",
    "CramerRao",
    "Profiler",
    "TauExplained",
    "compare_bounds",
    "cramer_rao",
    "explain_tau",
    "method_of",
    "profile_curve",
    "step_study",
]
